"""Schemas of vehicle.yaml about the tyres. Their laws are in :mod:`mirdrake.tyres`."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from mirdrake.core.yaml_io import Force, Length, Schema


class _AnyTyres(Schema):
    """What all kinds have."""

    rolling_resistance: float = Field(ge=0, lt=1, description="[-] rolling moment / (load x radius)")


class CoulombTyres(_AnyTyres):
    """Tyre forces come from the contact's Coulomb friction alone; plus rolling resistance."""

    kind: Literal["coulomb"] = "coulomb"


class _SlipTyres(_AnyTyres):
    """What tyres with slip have."""

    rolling_ratio: float = Field(
        default=0.97,
        gt=0.5,
        le=1,
        description="[-] effective rolling radius over the unloaded one; radial tyres of cars have 0.97 by ETRTO: a "
        "rolling circumference of 3.05 diameters (recalled)",
    )
    lateral_damping: float = Field(
        default=0.0,
        ge=0,
        description="[N s/m] damper of a tyre and its bushings to the side, beside the spring that makes the "
        "relaxation length",
    )


class BrushAxle(Schema):
    """The tyres of an axle as brush tyres; each number is for one tyre."""

    nominal_load: Force = Field(gt=0, description="[N] load at which the others hold")
    longitudinal_stiffness: Force = Field(gt=0, description="[N] dFx/dkappa at zero slip")
    cornering_stiffness: Force = Field(gt=0, description="[N/rad] -dFy/dalpha at zero slip")
    friction: float = Field(gt=0, description="[-] on dry asphalt")
    friction_by_load: float = Field(
        default=0.0, gt=-1, lt=1, description="[-] relative change of the friction by (load - nominal) / nominal"
    )
    peak_load: Force = Field(gt=0, description="[N] load of the largest cornering stiffness")
    half_length: Length = Field(gt=0, description="[m] half the length of the contact patch")
    relaxation_x: Length = Field(gt=0, description="[m] relaxation length of longitudinal slip")
    relaxation_y: Length = Field(gt=0, description="[m] relaxation length of lateral slip")


class BrushTyres(_SlipTyres):
    """Tyre forces from a brush model (Fiala) with relaxation: few numbers, each with a meaning."""

    kind: Literal["brush"]
    front: BrushAxle
    rear: BrushAxle | None = Field(default=None, description="empty: as front")

    def axles(self) -> tuple[BrushAxle, BrushAxle]:
        """Front and rear."""
        return self.front, self.rear or self.front


_Scale = Annotated[float, Field(gt=0)]
_Part = Annotated[float, Field(ge=0)]


class TyreScale(Schema):
    """Scale factors of a Magic Formula tyre, as in the section [SCALING_COEFFICIENTS] of a .tir file, over the file's.

    What is left out stays as it is in the file.
    """

    lfzo: _Scale = Field(default=1.0, description="[-] nominal load")
    lcx: _Scale = Field(default=1.0, description="[-] shape of Fx")
    lmux: _Scale = Field(default=1.0, description="[-] peak friction of Fx")
    lex: _Part = Field(default=1.0, description="[-] curvature of Fx")
    lkx: _Scale = Field(default=1.0, description="[-] slip stiffness of Fx")
    lhx: _Part = Field(default=1.0, description="[-] horizontal shift of Fx")
    lvx: _Part = Field(default=1.0, description="[-] vertical shift of Fx")
    lcy: _Scale = Field(default=1.0, description="[-] shape of Fy")
    lmuy: _Scale = Field(default=1.0, description="[-] peak friction of Fy")
    ley: _Part = Field(default=1.0, description="[-] curvature of Fy")
    lky: _Scale = Field(default=1.0, description="[-] cornering stiffness")
    lkyc: _Part = Field(default=1.0, description="[-] camber stiffness of Fy")
    lkzc: _Part = Field(default=1.0, description="[-] camber stiffness of Mz")
    lhy: _Part = Field(default=1.0, description="[-] horizontal shift of Fy")
    lvy: _Part = Field(default=1.0, description="[-] vertical shift of Fy")
    ltr: _Part = Field(default=1.0, description="[-] pneumatic trail")
    lres: _Part = Field(default=1.0, description="[-] residual moment")
    lxal: _Part = Field(default=1.0, description="[-] influence of alpha on Fx")
    lyka: _Part = Field(default=1.0, description="[-] influence of kappa on Fy")
    lvyka: _Part = Field(default=1.0, description="[-] Fy made by kappa")
    ls: _Part = Field(default=1.0, description="[-] arm of Fx in Mz")
    lsgkp: _Scale = Field(default=1.0, description="[-] relaxation length of Fx, 5.2 only")
    lsgal: _Scale = Field(default=1.0, description="[-] relaxation length of Fy, 5.2 only")

    def given(self) -> dict[str, float]:
        """The factors that are set, by name."""
        return {name: getattr(self, name) for name in type(self).model_fields if name in self.model_fields_set}


class MagicFormulaTyres(_SlipTyres):
    """Tyre forces from the Magic Formula 5.2, 6.1 or 6.2 with relaxation, parameters from .tir files."""

    kind: Literal["magic_formula"]
    file: str = Field(min_length=1, description="a .tir file in the vehicle folder, else in models/tyres")
    rear_file: str | None = Field(default=None, min_length=1, description="of the rear tyres; empty: as in front")
    scale: TyreScale = Field(default_factory=TyreScale, description="factors over those of the file")
    rear_scale: TyreScale | None = Field(default=None, description="of the rear tyres; empty: as in front")

    @field_validator("file", "rear_file")
    @classmethod
    def _is_tir(cls, name: str | None) -> str | None:
        if name is not None and not name.lower().endswith(".tir"):
            raise ValueError(f"'{name[:80]}' is no tyre property file; name a .tir file")
        return name

    def files(self) -> tuple[str, str]:
        """Front and rear."""
        return self.file, self.rear_file or self.file

    def scales(self) -> tuple[TyreScale, TyreScale]:
        """Front and rear."""
        return self.scale, self.rear_scale or self.scale


def _kind(value: Any) -> Any:
    return value.get("kind", "coulomb") if isinstance(value, Mapping) else getattr(value, "kind", None)


TyreSpec = Annotated[
    Annotated[CoulombTyres, Tag("coulomb")]
    | Annotated[BrushTyres, Tag("brush")]
    | Annotated[MagicFormulaTyres, Tag("magic_formula")],
    Discriminator(_kind),
]
"""The tyres of a vehicle; without a kind, coulomb."""

"""Magic Formula tyres of a vehicle, from .tir files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.maths import Value, atan, sin
from mirdrake.core.paths import search_folders
from mirdrake.core.yaml_io import Schema
from mirdrake.tyres.base import SlipTyres, SteadyLaw, TyreAtLoad, TyreLaw
from mirdrake.tyres.magic_formula import (
    MAGIC_FORMULA_PARTS,
    MagicFormulaCurve,
    curve_at,
    lengths_at,
    magic_formula_on,
    operating_point,
    overturning_moment,
    pure_slip,
)
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.relaxation import Contact
from mirdrake.tyres.tir import TirFile, read_tir
from mirdrake.tyres.vertical import VerticalTyre, vertical_of_file

_Scale = Annotated[float, Field(gt=0)]
_Part = Annotated[float, Field(ge=0)]


class TyreScale(Schema):
    """Scale factors of a Magic Formula tyre, as in the section [SCALING_COEFFICIENTS] of a .tir file.

    They multiply the factors of the file.
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


def magic_formula_lateral_force(
    tan_alpha: Value, stiffness: Value, limit: Value, shape: Value, curvature: Value
) -> Value:
    """Return the lateral force of the Magic Formula in pure lateral slip, without shifts [N].

    Equation (4.E19) of H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., for a given stiffness and peak.

    Args:
        tan_alpha: tangent of the slip angle [1].
        stiffness: cornering stiffness [N/rad].
        limit: largest force [N], positive.
        shape: shape factor C [1].
        curvature: curvature factor E [1].
    """
    bx = stiffness / (shape * limit) * tan_alpha
    return -limit * sin(shape * atan(bx - curvature * (bx - atan(bx))))


class MagicFormulaTyres(SlipTyres):
    """Tyre forces from the Magic Formula 5.2, 6.1 or 6.2 with relaxation, parameters from .tir files."""

    law: ClassVar = SteadyLaw(MagicFormulaCurve, magic_formula_on, MAGIC_FORMULA_PARTS)
    lateral_force: ClassVar = magic_formula_lateral_force

    kind: Literal["magic_formula"]
    file: str = Field(min_length=1, description="a .tir file in the vehicle folder, else in models/tyres")
    rear_file: str | None = Field(default=None, min_length=1, description="file of the rear tyres; empty: as in front")
    scale: TyreScale = Field(default_factory=TyreScale, description="scale factors, multiplied with those of the file")
    rear_scale: TyreScale | None = Field(
        default=None, description="scale factors of the rear tyres; empty: as in front"
    )

    @field_validator("file", "rear_file")
    @classmethod
    def _is_tir(cls, name: str | None) -> str | None:
        if name is not None and not name.lower().endswith(".tir"):
            raise ValueError(f"'{name[:80]}' is not a tyre property file; name a .tir file")
        return name

    def property_files(self, folder: Path, where: Callable[[str], str] | None = None) -> tuple[Path, ...]:
        """Return the .tir files of front and rear tyres.

        A name is looked up in the vehicle's folder, then in the folder ``tyres`` of every ``models`` folder.

        Args:
            folder: folder of the vehicle.
            where: returns the place of a key in vehicle.yaml, for error messages.

        Raises:
            ConfigError: the file does not exist.
        """
        # The vehicle's own file comes before a common one of the same name.
        folders = [folder, *(models / "tyres" for models in search_folders("models"))]
        rear = ("rear_file", self.rear_file) if self.rear_file else ("file", self.file)
        files = []
        for key, name in (("file", self.file), rear):
            path = next((other / name for other in folders if _is_file(other / name)), None)
            if path is None:
                known = [other.name for parent in folders for other in sorted(parent.glob("*.tir"))]
                prefix = where(key) if where else f"tyres.{key}"
                raise ConfigError(f"no file '{name}'; {did_you_mean(name, known)}", where=prefix)
            files.append(path)
        return tuple(files)

    def lateral_shape(self, tyre: TyreAtLoad) -> tuple[float, float]:
        """Return shape and curvature factor of a tyre; the latter is the mean of both sides."""
        formula = tyre.curve.fy_pure
        return float(formula.c), float(0.5 * (formula.e_positive + formula.e_negative))

    def axle_laws(self, folder: Path) -> tuple[TyreLaw, TyreLaw]:
        """Return the laws of front and rear tyres; see the base class."""
        scales = self.scale, self.rear_scale or self.scale
        front, rear = (
            make_law(_scaled(read_tir(path).parameters, scale))
            for path, scale in zip(self.property_files(folder), scales, strict=True)
        )
        return front, rear

    def vertical_tyres(self, folder: Path) -> tuple[VerticalTyre | None, VerticalTyre | None]:
        """Return vertical stiffness and damping of front and rear tyres; see the base class."""
        front, rear = (_vertical_tyre(read_tir(path)) for path in self.property_files(folder))
        return front, rear


def make_law(parameters: MagicFormulaParameters) -> TyreLaw:
    """Return the tyre law of one tyre."""

    def law(load: float, inclination: float, friction: float) -> TyreAtLoad:
        point = operating_point(parameters, load, inclination, None, friction)
        slopes, scale = pure_slip(parameters, point), point.scale
        lengths = lengths_at(parameters, point, slopes)
        peak_x, peak_y = abs(slopes.dx) * scale, abs(slopes.dy) * scale
        # kya is negative in ISO axes; the slip stiffness of the relaxation is positive.
        # The overturning moment is approximated by a straight line over Fy through its values at half of both peaks.
        half = 0.5 * abs(slopes.dy)
        left, right = (overturning_moment(parameters, point, side) for side in (half, -half))
        contact = Contact(
            slopes.kxk * scale,
            -slopes.kya * scale,
            lengths.x,
            lengths.y,
            peak_x,
            peak_y,
            0.5 * (left + right) * scale,
            (left - right) / (2.0 * half) if half > 0.0 else 0.0,
        )
        return TyreAtLoad(contact, curve_at(parameters, point, slopes), MagicFormulaTyres.law)

    return law


def _vertical_tyre(file: TirFile) -> VerticalTyre | None:
    """Return the vertical behaviour in a .tir file, with its place in errors."""
    try:
        return vertical_of_file(file.parameters)
    except ConfigError as error:
        # Only a file with QFZ2 can fail.
        lines = [entries["QFZ2"].line for entries in file.sections.values() if "QFZ2" in entries]
        raise ConfigError(f"{error}", file=file.name, line=lines[0]) from None


def _scaled(parameters: MagicFormulaParameters, scale: TyreScale) -> MagicFormulaParameters:
    """Return the parameters with scale factors multiplied."""
    given = scale.given()
    return replace(parameters, **{name: getattr(parameters, name) * factor for name, factor in given.items()})


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # the name is too long or has a zero byte, or the folder is not readable
        return False

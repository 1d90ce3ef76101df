"""Base classes of tyre models. A kind of tyres is one class in one file, and one line of the registry.

The class is both the schema of the entry ``tyres`` of vehicle.yaml and the tyre law. To add a kind, derive it from
:class:`SlipTyres`, set ``kind`` and ``law``, implement :meth:`SlipTyres.axle_laws`, and add a line to
:data:`mirdrake.tyres.registry.TYRES`. :mod:`mirdrake.tyres.brush` is the shortest example.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from pydantic import Field

from mirdrake.core.maths import Value
from mirdrake.core.yaml_io import Schema
from mirdrake.tyres.relaxation import Contact
from mirdrake.tyres.vertical import VerticalTyre


class SteadyLaw(NamedTuple):
    """Tyre law in steady state, as functions of floats that :mod:`mirdrake.core.compiled` compiles.

    Attributes:
        curve: class of the record of a tyre at a load: a named tuple, nested or not, of what depends on load,
            inclination and friction. Its fields are floats, as records are interpolated between loads.
        forces: (curve, kappa, tan alpha, vx [m/s]) -> (Fx [N], Fy [N], Mz [N m]).
        parts: functions that `forces` calls.
    """

    curve: type[Any]
    forces: Callable[[Any, float, float, float], tuple[float, float, float]]
    parts: tuple[Callable[..., Any], ...] = ()


class TyreAtLoad(NamedTuple):
    """Tyre at a load.

    Attributes:
        contact: stiffnesses, relaxation lengths, largest forces.
        curve: record of its law.
        law: its law.
    """

    contact: Contact
    curve: Any
    law: SteadyLaw

    def forces(self, kappa: float, tan_alpha: float, vx: float) -> tuple[float, float, float]:
        """Return Fx [N], Fy [N], Mz [N m] in steady state; arguments as in :class:`SteadyLaw`."""
        return self.law.forces(self.curve, kappa, tan_alpha, vx)


TyreLaw = Callable[[float, float, float], TyreAtLoad]
"""(load [N], inclination [rad], friction of the road relative to dry asphalt [1]) -> the tyre at this load."""


class FittedEntry(NamedTuple):
    """Entry of vehicle.yaml that an identified parameter is written to.

    Attributes:
        path: dotted path below ``tyres``.
        unit: unit of the identified value.
        factor: value in the file over identified value.
    """

    path: str
    unit: str
    factor: float = 1.0


class Tyres(Schema):
    """Tyres of a vehicle, of any kind.

    Attributes:
        has_slip: whether forces follow from slip; if not, they are Coulomb friction (:mod:`mirdrake.tyres.coulomb`).
        fitted: entries that identified parameters are written to, by parameter.
    """

    has_slip: ClassVar[bool] = False
    fitted: ClassVar[Mapping[str, FittedEntry]] = {}

    kind: str
    rolling_resistance: float = Field(ge=0, lt=1, description="[-] rolling moment / (load x radius)")

    def property_files(self, folder: Path, where: Callable[[str], str] | None = None) -> tuple[Path, ...]:
        """Return the files with tyre data, of front and rear tyres; none if the kind has no files.

        Args:
            folder: folder of the vehicle.
            where: returns the place of a key in vehicle.yaml, for error messages.

        Raises:
            ConfigError: the file does not exist.
        """
        _ = folder, where
        return ()

    def vertical_tyres(self, folder: Path) -> tuple[VerticalTyre | None, VerticalTyre | None]:
        """Return vertical stiffness and damping of front and rear tyres; None where the data have none.

        Args:
            folder: folder of the vehicle.

        Raises:
            ConfigError: a file with tyre data is missing or wrong.
        """
        _ = folder
        return None, None


class SlipTyres(Tyres):
    """Tyres whose forces follow from slip.

    Attributes:
        law: the law in steady state.
        lateral_force: (tan alpha, cornering stiffness [N/rad], largest force [N], shape factor, curvature factor) ->
            Fy [N] in pure lateral slip, for the single-track model; None if the law is not available there.
    """

    has_slip: ClassVar[bool] = True
    law: ClassVar[SteadyLaw]
    lateral_force: ClassVar[Callable[[Value, Value, Value, Value, Value], Value] | None] = None

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
        description="[N s/m] damper of a tyre and its bushings in the lateral direction, parallel to the spring that "
        "makes the relaxation length",
    )

    def lateral_shape(self, tyre: TyreAtLoad) -> tuple[float, float]:  # noqa: ARG002
        """Return shape and curvature factor of the lateral force of a tyre [1], for the single-track model.

        The default is for laws without them: 1.3 and 0, after E. Bakker, L. Nyborg, H. B. Pacejka, SAE 870421 (side
        force of a passenger car tyre).
        """
        return 1.3, 0.0

    def axle_laws(self, folder: Path) -> tuple[TyreLaw, TyreLaw]:
        """Return the laws of front and rear tyres; each kind defines it.

        Args:
            folder: folder of the vehicle.

        Raises:
            ConfigError: a file with tyre data is missing or wrong.
        """
        raise NotImplementedError

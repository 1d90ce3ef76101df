"""The tyre law of each wheel of a vehicle, as vehicle.yaml names it, worked out at a load."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from mirdrake.tyres.brush import BrushCurve, BrushTyre, brush_at_load, brush_on
from mirdrake.tyres.magic_formula import lengths_at, operating_point, pure_slip
from mirdrake.tyres.magic_formula_curve import MAGIC_FORMULA_PARTS, MagicFormulaCurve, curve_at, magic_formula_on
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.maths import FLOAT
from mirdrake.tyres.relaxation import Contact
from mirdrake.tyres.tir import read_tir
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.tyre_files import find_tyre_files
from mirdrake.vehicles.tyre_spec import BrushAxle, BrushTyres, MagicFormulaTyres, TyreScale


class SteadyLaw(NamedTuple):
    """A law of steady state, as functions of floats that :mod:`mirdrake.core.compiled` can turn into machine code.

    Attributes:
        curve: kind of record of a tyre at a load.
        forces: (curve, kappa, tan alpha, vx [m/s]) -> (Fx [N], Fy [N], Mz [N m]).
        parts: functions that it calls.
    """

    curve: type[Any]
    forces: Callable[[Any, float, float, float], tuple[float, float, float]]
    parts: tuple[Callable[..., Any], ...] = ()


BRUSH = SteadyLaw(BrushCurve, brush_on)
MAGIC_FORMULA = SteadyLaw(MagicFormulaCurve, magic_formula_on, MAGIC_FORMULA_PARTS)


class TyreAtLoad(NamedTuple):
    """A tyre at its present load.

    Attributes:
        contact: stiffnesses, relaxation lengths, largest forces.
        curve: record of its law.
        law: its law.
    """

    contact: Contact
    curve: Any
    law: SteadyLaw

    def forces(self, kappa: float, tan_alpha: float, vx: float) -> tuple[float, float, float]:
        """Fx [N], Fy [N], Mz [N m] in steady state; arguments as of :class:`SteadyLaw`."""
        return self.law.forces(self.curve, kappa, tan_alpha, vx)


TyreLaw = Callable[[float, float, float], TyreAtLoad]
"""(load [N], inclination [rad], friction of the road relative to dry asphalt [1]) -> the tyre there."""


def make_tyre_laws(vehicle: Vehicle) -> tuple[TyreLaw, TyreLaw] | None:
    """The laws of front and rear tyres; None where contact friction does it all.

    Raises:
        ConfigError: a .tir file is missing or wrong.
    """
    tyres = vehicle.spec.tyres
    if isinstance(tyres, BrushTyres):
        front, rear = map(brush_law, tyres.axles())
        return front, rear
    if isinstance(tyres, MagicFormulaTyres):
        files = find_tyre_files(vehicle.spec, vehicle.folder)
        front, rear = (
            magic_formula_law(_scaled(read_tir(path).parameters, scale))
            for path, scale in zip(files, tyres.scales(), strict=True)
        )
        return front, rear
    return None


def steady_law(vehicle: Vehicle) -> SteadyLaw:
    """The law that all tyres of a vehicle with a tyre model follow."""
    return BRUSH if isinstance(vehicle.spec.tyres, BrushTyres) else MAGIC_FORMULA


def brush_law(axle: BrushAxle) -> TyreLaw:
    """The law of :mod:`mirdrake.tyres.brush`."""
    data = axle.model_dump()
    length_x, length_y = data.pop("relaxation_x"), data.pop("relaxation_y")
    tyre = BrushTyre(**data)

    def law(load: float, inclination: float, friction: float) -> TyreAtLoad:  # noqa: ARG001 - laws are alike
        curve = brush_at_load(tyre, load, friction=friction)
        contact = Contact(curve.longitudinal, curve.cornering, length_x, length_y, curve.limit, curve.limit)
        return TyreAtLoad(contact, curve, BRUSH)

    return law


def magic_formula_law(parameters: MagicFormulaParameters) -> TyreLaw:
    """The law of :mod:`mirdrake.tyres.magic_formula`."""

    def law(load: float, inclination: float, friction: float) -> TyreAtLoad:
        at = operating_point(parameters, load, inclination, None, friction, FLOAT)
        curve, scale = pure_slip(parameters, at), at.scale
        length_x, length_y = lengths_at(parameters, at, curve)
        peak_x, peak_y = abs(curve.dx) * scale, abs(curve.dy) * scale
        contact = Contact(curve.kxk * scale, -curve.kya * scale, length_x, length_y, peak_x, peak_y)
        return TyreAtLoad(contact, curve_at(parameters, at, curve), MAGIC_FORMULA)

    return law


def _scaled(parameters: MagicFormulaParameters, scale: TyreScale) -> MagicFormulaParameters:
    given = scale.given()
    return replace(parameters, **{name: getattr(parameters, name) * factor for name, factor in given.items()})

"""The tyre law of each wheel of a vehicle, as vehicle.yaml names it, worked out at a load."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from mirdrake.tyres.brush import BrushTyre, brush_at_load, brush_forces_on
from mirdrake.tyres.magic_formula import lengths_at, operating_point, pure_slip
from mirdrake.tyres.magic_formula_curve import SteadyForces, curve_at
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.maths import FLOAT
from mirdrake.tyres.relaxation import Contact
from mirdrake.tyres.tir import read_tir
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.tyre_files import find_tyre_files
from mirdrake.vehicles.tyre_spec import BrushAxle, BrushTyres, MagicFormulaTyres, TyreScale

BRUSH_LOW = 1.0
"""Speed below which the aligning moment of a brush tyre fades, as that of the Magic Formula does [m/s]."""


class TyreAtLoad(NamedTuple):
    """A tyre at its present load.

    Attributes:
        contact: stiffnesses, relaxation lengths, largest forces.
        forces: (kappa, tan alpha, vx [m/s]) -> (Fx [N], Fy [N], Mz [N m]) in steady state.
    """

    contact: Contact
    forces: SteadyForces


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


def brush_law(axle: BrushAxle) -> TyreLaw:
    """The law of :mod:`mirdrake.tyres.brush`; its aligning moment turns round with the direction, and fades between."""
    data = axle.model_dump()
    length_x, length_y = data.pop("relaxation_x"), data.pop("relaxation_y")
    tyre = BrushTyre(**data)

    def law(load: float, inclination: float, friction: float) -> TyreAtLoad:  # noqa: ARG001 - laws are alike
        curve = brush_at_load(tyre, load, friction=friction)

        def forces(kappa: float, tan_alpha: float, vx: float) -> tuple[float, float, float]:
            fx, fy, mz = brush_forces_on(curve, kappa, tan_alpha, FLOAT)
            return fx, fy, mz * FLOAT.direction(vx, BRUSH_LOW)

        contact = Contact(curve.longitudinal, curve.cornering, length_x, length_y, curve.limit, curve.limit)
        return TyreAtLoad(contact, forces)

    return law


def magic_formula_law(parameters: MagicFormulaParameters) -> TyreLaw:
    """The law of :mod:`mirdrake.tyres.magic_formula`."""

    def law(load: float, inclination: float, friction: float) -> TyreAtLoad:
        at = operating_point(parameters, load, inclination, None, friction, FLOAT)
        curve, scale = pure_slip(parameters, at), at.scale
        length_x, length_y = lengths_at(parameters, at, curve)
        peak_x, peak_y = abs(curve.dx) * scale, abs(curve.dy) * scale
        contact = Contact(curve.kxk * scale, -curve.kya * scale, length_x, length_y, peak_x, peak_y)
        return TyreAtLoad(contact, curve_at(parameters, at, curve))

    return law


def _scaled(parameters: MagicFormulaParameters, scale: TyreScale) -> MagicFormulaParameters:
    given = scale.given()
    return replace(parameters, **{name: getattr(parameters, name) * factor for name, factor in given.items()})

"""Vertical force of a tyre from its deflection.

The Magic Formula 6.1 has, without the small effects of Fx, Fy, camber and pressure (I. J. M. Besselink, A. J. C.
Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can handle inflation pressure changes, Vehicle
System Dynamics 48, 2010)::

    Fz = (1 + qV2 R0 |ω| / V0) (qFz1 d / R0 + qFz2 (d / R0)²) Fz0,    qFz1 = √((Cz R0 / Fz0)² - 4 qFz2)

with the vertical stiffness Cz at the nominal load Fz0, the free radius R0 and the speed V0 of the measurements. The
damping is proportional to the force, F (1 + χ d'), as in Hunt and Crossley's contact model: the force is continuous at
touchdown and lift-off, and the road never pulls.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters


@dataclass(frozen=True, slots=True)
class VerticalTyre:
    """Vertical stiffness and damping of a tyre: F = (k d + k2 d²) (1 + g |ω|) (1 + χ d').

    Attributes:
        stiffness: k [N/m].
        hardening: k2 [N/m²].
        damping: χ [s/m].
        growth: g [s/rad].
    """

    stiffness: float
    hardening: float = 0.0
    damping: float = 0.0
    growth: float = 0.0

    def __call__(self, load: float) -> float:
        """Return the deflection at rest [m] under a load [N].

        Raises:
            ConfigError: the tyre softens with the deflection, and its force never reaches the load.
        """
        load = max(load, 0.0)
        square = self.stiffness**2 + 4.0 * self.hardening * load
        if square < 0.0:
            largest = -(self.stiffness**2) / (4.0 * self.hardening)
            raise ConfigError(
                f"a tyre has a load of {load:.0f} N at rest, but carries {largest:.0f} N at most (QFZ2 < 0)"
            )
        # The root of the quadratic equation in the form that also holds for a linear spring, without cancellation.
        return 2.0 * load / (self.stiffness + sqrt(square))


def vertical_force(tyre: Any, deflection: float, rate: float, spin: float) -> float:
    """Return the vertical force [N]; :mod:`mirdrake.core.compiled` can compile it.

    Args:
        tyre: :class:`VerticalTyre`.
        deflection: [m]; not positive: no contact.
        rate: rate of the deflection [m/s].
        spin: spin of the wheel [rad/s].
    """
    if deflection <= 0.0:
        return 0.0
    force: float = deflection * (tyre.stiffness + tyre.hardening * deflection)
    growth: float = 1.0 + tyre.growth * abs(spin)
    # Rubber cannot pull at the road, however fast the tyre rebounds.
    damping: float = 1.0 + tyre.damping * rate
    return force * growth * max(damping, 0.0)


def vertical_of_file(parameters: MagicFormulaParameters) -> VerticalTyre | None:
    """Return the vertical behaviour in a .tir file; None if it has no vertical stiffness.

    Raises:
        ConfigError: the force does not rise with the deflection from 0 to the free radius.
    """
    p = parameters
    if p.vertical_stiffness <= 0.0:
        return None
    # qFz1 of the head of the module; the stiffness in the file is the slope at the nominal load.
    square = (p.vertical_stiffness * p.unloaded_radius / p.fnomin) ** 2 - 4.0 * p.qfz2
    linear = sqrt(max(square, 0.0))
    # The slope is linear in the deflection, so both ends of 0 to R0 suffice; a wheel cannot deflect further.
    if min(linear, linear + 2.0 * p.qfz2) <= 0.0:
        raise ConfigError(
            f"QFZ2 = {p.qfz2:g} does not fit VERTICAL_STIFFNESS, UNLOADED_RADIUS and FNOMIN: the vertical force does "
            "not rise with the deflection; correct it, or leave QFZ2 out"
        )
    return VerticalTyre(
        linear * p.fnomin / p.unloaded_radius,
        p.qfz2 * p.fnomin / p.unloaded_radius**2,
        p.vertical_damping / p.fnomin,
        p.qv2 * p.unloaded_radius / p.longvl,
    )

"""Brush tyre: bristles that stick at the front of the contact patch and slide at its rear, under a parabolic pressure.

Inputs and axes are those of :mod:`mirdrake.tyres.magic_formula`: forces of the road on the tyre in the tyre axes of
ISO 8855 (x ahead in the wheel plane, y left, z up), kappa = -Vsx / |Vx|, tan alpha = Vy / |Vx|; so a wheel that moves
to its left has a positive slip angle and gets a negative Fy and a positive (aligning) Mz.

The model (H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 3.2; E. Fiala 1954 for pure side slip; R.
Rajamani, Vehicle Dynamics and Control, 2nd ed., chapter 13). With the theoretical slips s = (kappa, tan alpha) / |1 +
kappa|, the stiffnesses C, the load N, the friction μ and half the length a of the patch::

    G = (Cx sx, Cy sy)                           force if every bristle stuck
    λ = max(0, 1 - |G| / (3 μ N))                share of the patch that sticks
    F = G λ² + μ N (1 - λ)² (1 + 2 λ) s / |s|    sticking along G, sliding against the slip
    M = a { Gy (λ² - 4 λ³ / 3) - 3 μ N λ² (1 - λ)² sy / |s| }

with Fx = F_x, Fy = -F_y and Mz as the tyre gets it turned round: Mz = -M. For equal stiffnesses both parts are parallel
and this is the book's |F| = μ N (1 - λ³), |Mz| = μ N a λ³ (1 - λ) (sections 3.2.1 and 3.2.3). For different ones the
two parts have the directions of M. Gäfvert and J. Svendenius, Construction of Novel Semi-Empirical Tire Models for
Combined Braking and Cornering, Lund 2003, section 2; |F| never exceeds μ N (1 - λ³). Left out, as in the book's first
step: the moment of Fx about the deflected patch, camber, and a difference of static and sliding friction.

The load enters the friction linearly, the longitudinal stiffness proportionally, the patch as a square root (a circle
pressed onto a plane), and the cornering stiffness as in the Magic Formula, sin(2 atan(N / P)) (eq. 4.E25): it is
largest at the load P.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

from mirdrake.core.checks import check_number
from mirdrake.tyres.maths import Maths, Value, maths_for

_TINY = 1e-12
"""Slip below which directions fade, so that derivatives exist at zero [1]."""

_LOCKED = 1e-6
"""Smallest |1 + kappa|: a locked wheel slides on its whole patch long before."""

LOW = 1.0
"""Speed below which the aligning moment of a wheel fades, as that of the Magic Formula does [m/s]."""

_LEAST_FRICTION = 0.1
"""Least part of the nominal friction that the load may leave."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BrushTyre:
    """Parameters of a brush tyre.

    Attributes:
        nominal_load: load N0 at which the others hold [N].
        longitudinal_stiffness: dFx/dkappa at zero slip and nominal load [N].
        cornering_stiffness: -dFy/dalpha at zero slip and nominal load [N/rad].
        friction: coefficient at nominal load on the reference road [1].
        friction_by_load: change of the friction by (N - N0) / N0, relative [1]; -0.1 to -0.2 for cars.
        peak_load: load P of the largest cornering stiffness [N].
        half_length: half the length of the contact patch at nominal load [m].

    Raises:
        ConfigError: not a finite number, or not positive where it must be.
    """

    nominal_load: float
    longitudinal_stiffness: float
    cornering_stiffness: float
    friction: float
    friction_by_load: float = 0.0
    peak_load: float
    half_length: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            signed = field.name == "friction_by_load"
            check_number("BrushTyre", field.name, value, above=-math.inf if signed else 0.0)


class BrushForces(NamedTuple):
    """What the road does to the tyre, in tyre axes.

    Attributes:
        fx: longitudinal force [N].
        fy: lateral force [N].
        mz: aligning moment [N m].
    """

    fx: Value
    fy: Value
    mz: Value


class BrushCurve(NamedTuple):
    """The parameters at a load, of any kind of number.

    Attributes:
        longitudinal: longitudinal stiffness [N].
        cornering: cornering stiffness [N/rad].
        limit: friction force μ N [N].
        half_length: half the length of the contact patch [m].
    """

    longitudinal: Value
    cornering: Value
    limit: Value
    half_length: Value


def brush_at_load(tyre: BrushTyre, load: Value, *, friction: Value = 1.0) -> BrushCurve:
    """Stiffnesses, friction force and patch at a load.

    Args:
        tyre: parameters.
        load: normal load [N]; below zero is taken as zero.
        friction: of the road, relative to that of the tyre's data [1].
    """
    maths = maths_for(load, friction)
    load = maths.at_least(load, 0.0)
    ratio = load / tyre.nominal_load
    change = maths.at_least(1.0 + tyre.friction_by_load * (ratio - 1.0), _LEAST_FRICTION)
    # sin(2 atan x) = 2 x / (1 + x²), relative to its value at the nominal load.
    nominal, now = tyre.nominal_load / tyre.peak_load, load / tyre.peak_load
    return BrushCurve(
        longitudinal=tyre.longitudinal_stiffness * ratio,
        cornering=tyre.cornering_stiffness * ratio * (1.0 + nominal * nominal) / (1.0 + now * now),
        limit=tyre.friction * change * friction * load,
        half_length=tyre.half_length * maths.sqrt(ratio + _TINY),
    )


def brush_forces(tyre: BrushTyre, kappa: Value, tan_alpha: Value, load: Value, *, friction: Value = 1.0) -> BrushForces:
    """Steady-state forces of a brush tyre; equations in the head of the module.

    Floats, arrays that broadcast, or AutoDiffXd.

    Args:
        tyre: parameters.
        kappa: longitudinal slip -Vsx / |Vx| [1]; -1: locked.
        tan_alpha: Vy / |Vx|, tangent of the slip angle [1].
        load: normal load [N]; without any, there is no force.
        friction: of the road, relative to that of the tyre's data [1].
    """
    maths = maths_for(kappa, tan_alpha, load, friction)
    return brush_forces_on(brush_at_load(tyre, load, friction=friction), kappa, tan_alpha, maths)


def brush_forces_on(curve: BrushCurve, kappa: Value, tan_alpha: Value, maths: Maths) -> BrushForces:
    """The same at a load that is worked out already.

    Args:
        curve: of :func:`brush_at_load`.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        maths: functions of the kind of number of both.
    """
    longitudinal, cornering, limit, half_length = curve
    rolling = 1.0 + kappa
    forward = maths.sign(rolling)
    scale = maths.at_least(forward * rolling, _LOCKED)
    slip_x, slip_y = kappa / scale, tan_alpha / scale
    slip = maths.sqrt(slip_x * slip_x + slip_y * slip_y + _TINY * _TINY)
    stuck_x, stuck_y = longitudinal * slip_x, cornering * slip_y
    stuck = maths.sqrt(stuck_x * stuck_x + stuck_y * stuck_y + _TINY * _TINY)

    sliding_share = maths.at_most(stuck / (3.0 * limit + _TINY), 1.0)
    share = 1.0 - sliding_share
    square = share * share
    slide = limit * sliding_share * sliding_share * (1.0 + 2.0 * share) / slip
    arm = stuck_y * (square - 4.0 / 3.0 * square * share)
    back = 3.0 * limit * square * sliding_share * sliding_share * slip_y / slip
    return BrushForces(
        fx=stuck_x * square + slide * slip_x,
        fy=-(stuck_y * square + slide * slip_y),
        mz=forward * half_length * (back - arm),
    )


def brush_on(curve: BrushCurve, kappa: float, tan_alpha: float, vx: float) -> tuple[float, float, float]:
    """:func:`brush_forces_on` for floats, simple enough for machine code (:mod:`mirdrake.core.compiled`).

    The aligning moment turns round with the direction of rolling, and fades below :data:`LOW` between both.

    Args:
        curve: of :func:`brush_at_load`.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        vx: longitudinal speed [m/s].

    Returns:
        Fx [N], Fy [N], Mz [N m].
    """
    forward = -1.0 if kappa < -1.0 else 1.0
    scale = max(forward * (1.0 + kappa), _LOCKED)
    slip_x, slip_y = kappa / scale, tan_alpha / scale
    slip = math.sqrt(slip_x * slip_x + slip_y * slip_y + _TINY * _TINY)
    stuck_x, stuck_y = curve.longitudinal * slip_x, curve.cornering * slip_y
    stuck = math.sqrt(stuck_x * stuck_x + stuck_y * stuck_y + _TINY * _TINY)

    sliding_share = min(stuck / (3.0 * curve.limit + _TINY), 1.0)
    share = 1.0 - sliding_share
    square = share * share
    slide = curve.limit * sliding_share * sliding_share * (1.0 + 2.0 * share) / slip
    arm = stuck_y * (square - 4.0 / 3.0 * square * share)
    back = 3.0 * curve.limit * square * sliding_share * sliding_share * slip_y / slip
    fx, fy = stuck_x * square + slide * slip_x, -(stuck_y * square + slide * slip_y)
    rolling = math.sin(0.5 * math.pi / LOW * min(max(vx, -LOW), LOW))
    return fx, fy, forward * curve.half_length * (back - arm) * rolling

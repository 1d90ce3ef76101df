"""Brush tyre: bristles stick at the front of the contact patch and slide at its rear, under a parabolic pressure.

Inputs and axes are those of :mod:`mirdrake.tyres.magic_formula`: forces of the road on the tyre in the tyre axes of
ISO 8855 (x ahead in the wheel plane, y left, z up), kappa = -Vsx / |Vx|, tan alpha = Vy / |Vx|. A wheel that moves to
its left thus has a positive slip angle, a negative Fy and a positive (aligning) Mz.

Sources: H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 3.2; E. Fiala 1954 for pure lateral slip; R.
Rajamani, Vehicle Dynamics and Control, 2nd ed., chapter 13. With the theoretical slips s = (kappa, tan alpha) / |1 +
kappa|, the stiffnesses C, the load N, the friction μ and half the length a of the patch::

    G = (Cx sx, Cy sy)                           force if every bristle stuck
    λ = max(0, 1 - |G| / (3 μ N))                share of the patch that sticks
    F = G λ² + μ N (1 - λ)² (1 + 2 λ) s / |s|    sticking along G, sliding against the slip
    M = a { Gy (λ² - 4 λ³ / 3) - 3 μ N λ² (1 - λ)² sy / |s| }

with Fx = F_x, Fy = -F_y and Mz = -M. For equal stiffnesses both parts are parallel, and this is the book's
|F| = μ N (1 - λ³), |Mz| = μ N a λ³ (1 - λ) (sections 3.2.1 and 3.2.3). For different ones the two parts have the
directions of M. Gäfvert and J. Svendenius, Construction of Novel Semi-Empirical Tire Models for Combined Braking and
Cornering, Lund 2003, section 2; |F| never exceeds μ N (1 - λ³). Not modelled, as in the book's first step: the moment
of Fx about the deflected patch, and a difference between static and sliding friction.

Camber bends the path of the tread in the patch to a parabola, symmetric about the middle (Pacejka, section 3.3). It
has a lateral force but no moment. Here it acts on the forces as a lateral slip Cγ γ / Cy with the camber stiffness Cγ,
and M is that of the slip without camber, at the λ of both: exact while all bristles stick, and F keeps its limit μ N.
Fy = -Cγ γ at zero slip: a wheel with its top to the right is pushed to the right.

Effect of the load: it changes the friction linearly, the longitudinal stiffness proportionally, and the length of the
patch by a square root (a circle pressed onto a plane). The cornering stiffness follows the Magic Formula,
sin(2 atan(N / P)) (eq. 4.E25): it is largest at the load P.
"""

from dataclasses import dataclass, fields
from math import inf, pi
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

from pydantic import Field

from mirdrake.core.checks import check_number
from mirdrake.core.json_io import Json
from mirdrake.core.maths import Value, absolute, choose, larger, sin, smaller, sqrt
from mirdrake.core.yaml_io import Force, Length, Schema
from mirdrake.tyres.base import FittedEntry, SlipTyres, SteadyLaw, TyreAtLoad, TyreLaw
from mirdrake.tyres.relaxation import Contact

_TINY = 1e-12
"""Added to slips under a root, so that derivatives exist at zero slip [1]."""

_LOCKED = 1e-6
"""Smallest |1 + kappa| [1]: well before it, a locked wheel slides on its whole patch."""

FADE_SPEED = 1.0
"""Speed below which the aligning moment fades, as that of the Magic Formula does [m/s]."""

_LEAST_FRICTION = 0.1
"""Smallest share of the nominal friction at high loads [1]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BrushTyre:
    """Parameters of a brush tyre.

    Attributes:
        nominal_load: load N0 at which the other parameters hold [N].
        longitudinal_stiffness: dFx/dkappa at zero slip and nominal load [N].
        cornering_stiffness: -dFy/dalpha at zero slip and nominal load [N/rad].
        friction: coefficient at nominal load on the reference road [1].
        friction_by_load: relative change of the friction by (N - N0) / N0 [1]; -0.1 to -0.2 for cars.
        peak_load: load P of the largest cornering stiffness [N].
        half_length: half the length of the contact patch at nominal load [m].
        camber_stiffness: -dFy/dγ at zero slip and nominal load [N/rad]; proportional to the load.

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
    camber_stiffness: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            signed = field.name in ("friction_by_load", "camber_stiffness")
            check_number("BrushTyre", field.name, value, above=-inf if signed else 0.0)


class BrushForces(NamedTuple):
    """Forces and moment of the road on the tyre, in tyre axes.

    Attributes:
        fx: longitudinal force [N].
        fy: lateral force [N].
        mz: aligning moment [N m].
    """

    fx: Value
    fy: Value
    mz: Value


class BrushCurve(NamedTuple):
    """Parameters of a brush tyre at a load.

    Attributes:
        longitudinal: longitudinal stiffness [N].
        cornering: cornering stiffness [N/rad].
        limit: friction force μ N [N].
        half_length: half the length of the contact patch [m].
        camber: lateral slip of equal force as the camber [1].
    """

    longitudinal: Value
    cornering: Value
    limit: Value
    half_length: Value
    camber: Value = 0.0


def brush_at_load(tyre: BrushTyre, load: Value, *, friction: Value = 1.0, inclination: Value = 0.0) -> BrushCurve:
    """Return stiffnesses, friction force and patch length at a load.

    Args:
        tyre: parameters.
        load: normal load [N]; a negative load counts as zero.
        friction: friction of the road relative to that of the tyre's data [1].
        inclination: γ, positive when the top of the wheel is inclined to the right [rad].
    """
    load = larger(load, 0.0)
    ratio = load / tyre.nominal_load
    # The linear change of the friction over the load would become negative at very high loads.
    change = larger(1.0 + tyre.friction_by_load * (ratio - 1.0), _LEAST_FRICTION)
    # sin(2 atan x) = 2 x / (1 + x²), relative to its value at the nominal load.
    nominal, now = tyre.nominal_load / tyre.peak_load, load / tyre.peak_load
    by_load = (1.0 + nominal * nominal) / (1.0 + now * now)
    return BrushCurve(
        longitudinal=tyre.longitudinal_stiffness * ratio,
        cornering=tyre.cornering_stiffness * ratio * by_load,
        limit=tyre.friction * change * friction * load,
        half_length=tyre.half_length * sqrt(ratio + _TINY),
        camber=tyre.camber_stiffness / (tyre.cornering_stiffness * by_load) * inclination,
    )


def brush_forces(tyre: BrushTyre, kappa: Value, tan_alpha: Value, load: Value, *, friction: Value = 1.0) -> BrushForces:
    """Return the steady-state forces of a brush tyre that rolls ahead; equations in the head of the module.

    Arguments are floats, arrays that broadcast, or AutoDiffXd.

    Args:
        tyre: parameters.
        kappa: longitudinal slip -Vsx / |Vx| [1]; -1: locked.
        tan_alpha: Vy / |Vx|, tangent of the slip angle [1].
        load: normal load [N]; forces are zero without load.
        friction: friction of the road relative to that of the tyre's data [1].
    """
    return BrushForces(*brush_on(brush_at_load(tyre, load, friction=friction), kappa, tan_alpha, FADE_SPEED))


def brush_on(curve: BrushCurve, kappa: Value, tan_alpha: Value, vx: Value) -> tuple[Value, Value, Value]:
    """Return the steady-state forces of a brush tyre at a load; :mod:`mirdrake.core.compiled` can compile it.

    The aligning moment changes its sign with the direction of rolling. It and the force of camber fade between
    -:data:`FADE_SPEED` and :data:`FADE_SPEED`.

    Args:
        curve: curve from :func:`brush_at_load`.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        vx: longitudinal speed [m/s].

    Returns:
        Fx [N], Fy [N], Mz [N m].
    """
    # Theoretical slips, and the force if every bristle stuck.
    # The theoretical slips refer to the speed of the tread, which runs backwards beyond kappa = -1.
    forward = choose(kappa < -1.0, -1.0, 1.0)
    scale = larger(forward * (1.0 + kappa), _LOCKED)
    rolling = sin(0.5 * pi / FADE_SPEED * smaller(larger(vx, -FADE_SPEED), FADE_SPEED))
    slip_x, upright_y = kappa / scale, tan_alpha / scale
    slip_y = upright_y + curve.camber * rolling * rolling
    slip = sqrt(slip_x * slip_x + slip_y * slip_y + _TINY * _TINY)
    stuck_x, stuck_y = curve.longitudinal * slip_x, curve.cornering * slip_y
    stuck = sqrt(stuck_x * stuck_x + stuck_y * stuck_y + _TINY * _TINY)

    # Sticking and sliding part of the patch.
    sliding_share = smaller(stuck / (3.0 * curve.limit + _TINY), 1.0)
    share = 1.0 - sliding_share
    square = share * share
    slide = curve.limit * sliding_share * sliding_share * (1.0 + 2.0 * share) / slip

    # Moments of the sticking and of the sliding part about the middle of the patch.
    arm = curve.cornering * upright_y * (square - 4.0 / 3.0 * square * share)
    back = 3.0 * curve.limit * square * sliding_share * sliding_share * upright_y / slip
    fx, fy = stuck_x * square + slide * slip_x, -(stuck_y * square + slide * slip_y)
    return fx, fy, forward * curve.half_length * (back - arm) * rolling


def brush_lateral_force(
    tan_alpha: Value,
    stiffness: Value,
    limit: Value,
    shape: Value = 0.0,  # noqa: ARG001
    curvature: Value = 0.0,  # noqa: ARG001
) -> Value:
    """Return the lateral force of a brush tyre in pure lateral slip [N].

    It is the formula above without a division by the slip and without a branch, so that it also takes symbolic
    Expressions. Its first derivative is continuous, also at zero slip and where the whole patch begins to slide.

    Args:
        tan_alpha: tangent of the slip angle [1].
        stiffness: cornering stiffness [N/rad].
        limit: largest force [N], positive.
        shape: not used, like `curvature`.
        curvature: see there.
    """
    # Below full sliding the cubic of Fiala; beyond it the quotient leaves ±limit.
    share = stiffness * absolute(tan_alpha) / (3.0 * limit)
    sticking = smaller(share, 1.0)
    return -stiffness * tan_alpha * (1.0 - sticking + sticking * sticking / 3.0) / larger(share, 1.0)


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
    camber_stiffness: Force = Field(default=0.0, ge=0, description="[N/rad] -dFy/dgamma at zero slip: camber thrust")
    relaxation_x: Length = Field(gt=0, description="[m] relaxation length of longitudinal slip")
    relaxation_y: Length = Field(gt=0, description="[m] relaxation length of lateral slip")

    def make_law(self) -> TyreLaw:
        """Return the tyre law of one tyre."""
        data: Json = self.model_dump(exclude={"relaxation_x", "relaxation_y"})
        tyre = BrushTyre(**data)

        def law(load: float, inclination: float, friction: float) -> TyreAtLoad:
            curve = brush_at_load(tyre, load, friction=friction, inclination=inclination)
            contact = Contact(
                curve.longitudinal, curve.cornering, self.relaxation_x, self.relaxation_y, curve.limit, curve.limit
            )
            return TyreAtLoad(contact, curve, BrushTyres.law)

        return law


class BrushTyres(SlipTyres):
    """Tyre forces from a brush model (Fiala) with relaxation: few parameters, each with a physical meaning."""

    law: ClassVar = SteadyLaw(BrushCurve, brush_on)
    lateral_force: ClassVar = brush_lateral_force
    fitted: ClassVar = {  # the cornering stiffness of an axle is that of two tyres
        "cornering_stiffness_front": FittedEntry("front.cornering_stiffness", "N/rad", 0.5),
        "cornering_stiffness_rear": FittedEntry("rear.cornering_stiffness", "N/rad", 0.5),
        "friction_front": FittedEntry("front.friction", "1"),
        "friction_rear": FittedEntry("rear.friction", "1"),
    }

    kind: Literal["brush"]
    front: BrushAxle = Field(description="tyres of the front axle")
    rear: BrushAxle | None = Field(default=None, description="tyres of the rear axle; empty: as front")

    def axle_laws(self, folder: Path) -> tuple[TyreLaw, TyreLaw]:  # noqa: ARG002 - no files
        """Return the laws of front and rear tyres."""
        return self.front.make_law(), (self.rear or self.front).make_law()

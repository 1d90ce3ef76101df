"""Relaxation: from slip velocities to the slips that determine the tyre forces, down to standstill.

The contact patch is attached to the elastic carcass, and forces build up as the tyre rolls. Single-point model of H. B.
Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 7.2.1 (stretched string at its leading edge) with the additions of
section 8.6 for low speed (after Besselink). With the deflections u (along) and v (across) and relaxation lengths σ::

    u' = -Vsx - |Vx| u / σx        kappa'     = u / σx - (k / Cx) Vsx
    v' =  Vy  - |Vx| v / σy        tan alpha' = v / σy + (k / Cy) Vy

Carcass and bushings may have a lateral damper d parallel to the spring C / σy, at all speeds (Kelvin-Voigt):
C tan alpha' = (C / σy) v + d v'. The patch follows the rim, v' = Vy - |Vx| tan alpha'. Together, with
g = C / (C + d |Vx|)::

    v' = g (Vy - |Vx| v / σy)      tan alpha' = g (v / σy + (d / C) Vy)

In steady rolling this is exactly kappa = -Vsx / |Vx| and tan alpha = Vy / |Vx|. At standstill u and v are deflections
of springs of stiffness C / σ, so that a vehicle at rest on a slope does not creep; k is their damper, which fades
between standstill and the speed `low`: k = k0 (1 + cos(π Vx / low)) / 2.

A wheel that spins or slides at standstill must not increase the deflection without limit, nor may the deflection of a
locked wheel remain after the stop. The book freezes the state in this case. Here, below `low` and with the same weight
w as k, a motion that increases the deflection becomes sliding (P. Dahl's friction law); L = 1.5 μ N / C is a slip just
below the peak of the force::

    u' = -Vsx - { |Vx| / σx + w f(n) |Vsx| / |u| } u,    n = |u| / (σx L),    f = n⁴ to 1, then 4 n - 3

so |u| stays below σx L at standstill; with the book's limit of 3 μ N / C a car would roll back more than twice as far
after a locked stop. A step solves the equation exactly for a constant bracket and a linear slip velocity; where the
patch slides by more than a quarter of its limit, the step is divided.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

from mirdrake.core.checks import check_number

_SMALL = 1e-9
DEFLECTION_LIMIT = 1.5  # limit of the deflection over that at linear slip stiffness, μ N / C [1]
_MAX_SLIDING = 0.25  # sliding in a part of a step, over the limit of the deflection [1]
_MAX_PARTS = 64
_SHORT = 1e-3  # λ dt below which a series of the response to a ramp is exact to 2e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaxationSettings:
    """Damping, and behaviour at low speed.

    Attributes:
        low: speed below which damping and sliding act [m/s].
        damping: k0, damping between patch and rim at standstill [N s/m]; about 4 % of critical for a car on its tyres,
            a quarter of critical for the spin of a wheel.
        lateral_damping: d, damping parallel to the lateral spring at all speeds [N s/m].
        lasting_damping: part of k that does not fade [N s/m]; it adds to the slip stiffness its product with the speed.

    Raises:
        ConfigError: not a finite number, or negative; low not positive.
    """

    low: float = 1.0
    damping: float = 1000.0
    lateral_damping: float = 0.0
    lasting_damping: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            check_number("RelaxationSettings", field.name, value, above=0.0 if field.name == "low" else -_SMALL)


DEFAULTS = RelaxationSettings()


class Deflection(NamedTuple):
    """Deflection of a tyre.

    Attributes:
        along: u, longitudinal distance of the rim behind the patch [m], positive for positive kappa.
        across: v, lateral distance of the rim to the left of the patch [m], positive for positive alpha.
    """

    along: float = 0.0
    across: float = 0.0


class Motion(NamedTuple):
    """Motion of the contact point.

    Attributes:
        vx: longitudinal speed of the contact centre [m/s].
        slip_x: Vsx = Vx - ω Re [m/s], negative when driving.
        vy: lateral speed of the contact centre [m/s], positive to the left.
    """

    vx: float
    slip_x: float
    vy: float


class Contact(NamedTuple):
    """Contact of a tyre at its present load.

    Attributes:
        stiffness_x: slip stiffness dFx/dkappa [N]; zero or negative: no contact, deflections are zero.
        stiffness_y: slip stiffness -dFy/d tan alpha [N].
        length_x: relaxation length of longitudinal slip [m].
        length_y: relaxation length of lateral slip [m].
        friction_x: largest longitudinal force [N].
        friction_y: largest lateral force [N].
        overturning: overturning moment without a lateral force [N m].
        overturning_by_fy: its change by the lateral force [m].
    """

    stiffness_x: float
    stiffness_y: float
    length_x: float
    length_y: float
    friction_x: float
    friction_y: float
    overturning: float = 0.0
    overturning_by_fy: float = 0.0


def low_speed_weight(vx: float, low: float) -> float:
    """Return (1 + cos(π Vx / low)) / 2 below `low`, zero above; once differentiable."""
    return 0.5 * (1.0 + math.cos(math.pi * vx / low)) if abs(vx) < low else 0.0


def relaxed_slip(
    state: Deflection, motion: Motion, contact: Contact, settings: RelaxationSettings = DEFAULTS
) -> tuple[float, float]:
    """Return the slips kappa' and tan alpha' [1] for the law in steady state, with damping at low speed."""
    if contact.stiffness_x <= 0.0 or contact.stiffness_y <= 0.0:
        return 0.0, 0.0
    # Without damping the tyre is an undamped spring at standstill, where relaxation does not decay.
    damping = settings.damping * low_speed_weight(motion.vx, settings.low) + settings.lasting_damping
    kappa = state.along / contact.length_x - damping / contact.stiffness_x * motion.slip_x
    tan_alpha = state.across / contact.length_y
    if settings.lateral_damping:
        share = _share_of_spring(motion, contact, settings)
        tan_alpha = share * (tan_alpha + settings.lateral_damping / contact.stiffness_y * motion.vy)
    return kappa, tan_alpha + damping / contact.stiffness_y * motion.vy


def _share_of_spring(motion: Motion, contact: Contact, settings: RelaxationSettings) -> float:
    """Return g, the share of a lateral velocity that deflects the spring [1]; the patch follows the rest at once."""
    return contact.stiffness_y / (contact.stiffness_y + settings.lateral_damping * abs(motion.vx))


def deflect_along(
    deflection: float,
    motion: Motion,
    contact: Contact,
    period: float,
    settings: RelaxationSettings = DEFAULTS,
    change: float = 0.0,
) -> float:
    """Return the longitudinal deflection after a step [m]; equations in the head of the module.

    Args:
        deflection: deflection now [m].
        motion: motion of the contact point in the middle of the step.
        contact: the tyre at its load.
        period: length of the step [s], positive.
        settings: behaviour at low speed.
        change: change of the slip velocity during the step [m/s].
    """
    if contact.stiffness_x <= 0.0 or contact.stiffness_y <= 0.0:
        return 0.0
    limit = DEFLECTION_LIMIT * contact.friction_x / contact.stiffness_x * contact.length_x
    decay, weight = abs(motion.vx) / contact.length_x, low_speed_weight(motion.vx, settings.low)
    return relaxation_step(deflection, -motion.slip_x, decay, limit, weight, period, -change)


def deflect_across(
    deflection: float,
    motion: Motion,
    contact: Contact,
    period: float,
    settings: RelaxationSettings = DEFAULTS,
    change: float = 0.0,
) -> float:
    """Return the lateral deflection after a step [m]; arguments as in :func:`deflect_along`."""
    if contact.stiffness_x <= 0.0 or contact.stiffness_y <= 0.0:
        return 0.0
    limit = DEFLECTION_LIMIT * contact.friction_y / contact.stiffness_y * contact.length_y
    share = _share_of_spring(motion, contact, settings) if settings.lateral_damping else 1.0
    decay, weight = share * abs(motion.vx) / contact.length_y, low_speed_weight(motion.vx, settings.low)
    return relaxation_step(deflection, share * motion.vy, decay, limit, weight, period, share * change)


def deflection_rates(
    state: Deflection, motion: Motion, contact: Contact, settings: RelaxationSettings = DEFAULTS
) -> tuple[float, float]:
    """Return the rates u' and v' [m/s], for an external integrator."""
    if contact.stiffness_x <= 0.0 or contact.stiffness_y <= 0.0:
        return 0.0, 0.0
    weight = low_speed_weight(motion.vx, settings.low)
    limit_x = DEFLECTION_LIMIT * contact.friction_x / contact.stiffness_x * contact.length_x
    limit_y = DEFLECTION_LIMIT * contact.friction_y / contact.stiffness_y * contact.length_y
    speed = abs(motion.vx)
    decay_x = speed / contact.length_x + sliding_rate(state.along, -motion.slip_x, limit_x, weight)
    share = _share_of_spring(motion, contact, settings)
    across = share * motion.vy
    decay_y = share * speed / contact.length_y + sliding_rate(state.across, across, limit_y, weight)
    return -motion.slip_x - decay_x * state.along, across - decay_y * state.across


def sliding_rate(deflection: float, velocity: float, limit: float, weight: float) -> float:
    """Return the decay w f(n) |V| / |u| [1/s] of a motion that increases the deflection, else 0."""
    if weight == 0.0 or deflection * velocity <= 0.0:
        return 0.0
    limit = max(limit, _SMALL)
    n = abs(deflection) / limit
    # f(n) is n⁴ up to the limit and its tangent 4 n - 3 beyond it, so λ has no kink.
    share = n**3 if n < 1.0 else 4.0 - 3.0 / n  # f(n) / n
    return weight * share * abs(velocity) / limit


def relaxation_step(
    deflection: float,
    velocity: float,
    decay: float,
    limit: float,
    weight: float,
    period: float,
    change: float = 0.0,
) -> float:
    """Return the solution of u' = V - λ u, with V linear over the step.

    Sliding changes λ with the deflection. Where the patch slides far, the step is divided, and λ is that in the middle
    of each part.

    Args:
        deflection: u at the beginning of the step.
        velocity: V in the middle of the step.
        decay: λ without sliding [1/s].
        limit: largest deflection of a patch that slides.
        weight: weight of sliding [1].
        period: length of the step [s].
        change: change of V during the step.
    """
    ramp = change * _response_to_ramp(decay * period) * period
    if weight == 0.0:
        return _advance(deflection, velocity, decay, period) + ramp
    parts = min(_MAX_PARTS, 1 + int(abs(velocity) * period / (_MAX_SLIDING * max(limit, _SMALL))))
    period /= parts
    for _ in range(parts):
        ahead = _advance(deflection, velocity, decay + sliding_rate(deflection, velocity, limit, weight), 0.5 * period)
        deflection = _advance(deflection, velocity, decay + sliding_rate(ahead, velocity, limit, weight), period)
    return deflection + ramp


def _advance(deflection: float, velocity: float, decay: float, period: float) -> float:
    # Exact for constant V and λ; the series of (1 - e^-p) / p where the quotient would lose digits.
    passed = decay * period
    gone = -math.expm1(-passed)
    mean = gone / passed if passed > _SMALL else 1.0 - 0.5 * passed
    return deflection * (1.0 - gone) + velocity * period * mean


def _response_to_ramp(passed: float) -> float:
    """Return u / dt after a step with V from -1/2 to 1/2, for p = λ dt: (1 - m) / p - m / 2 with m = (1 - e^-p) / p."""
    if passed < _SHORT:  # series, where the difference would lose digits
        return passed / 12.0 * (1.0 - 0.5 * passed)
    mean = -math.expm1(-passed) / passed
    return (1.0 - mean) / passed - 0.5 * mean


STEP_PARTS = (
    low_speed_weight,
    relaxed_slip,
    _share_of_spring,
    deflect_along,
    deflect_across,
    sliding_rate,
    relaxation_step,
    _advance,
    _response_to_ramp,
)
"""Functions that :mod:`mirdrake.core.compiled` compiles for a step."""

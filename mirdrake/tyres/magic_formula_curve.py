"""The Magic Formula at a load: what depends on load, inclination, pressure and friction only, worked out once.

A wheel asks for forces in every step of a simulation, while its load is measured less often. The functions here give
Fx, Fy and Mz of :func:`mirdrake.tyres.magic_formula.magic_formula` for floats, in a third of its time, and are simple
enough for machine code (:mod:`mirdrake.core.compiled`); the equations and their numbers are there.
"""

from math import atan, cos, pi, sin, sqrt
from typing import NamedTuple

from mirdrake.tyres.magic_formula import OperatingPoint, SlipCurve, operating_point, pure_slip
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.maths import FLOAT


class Wave(NamedTuple):
    """D sin(C atan(B x - E (B x - atan B x))) + Sv at x = slip + Sh; E for x from zero on and for x below."""

    b: float
    c: float
    d: float
    e_ahead: float
    e_back: float
    shift_h: float
    shift_v: float


class Weight(NamedTuple):
    """What the other slip leaves of a force: cos(C atan(B x - E (B x - atan B x))) at x = other slip + Sh.

    B is `stiff` cos(atan(`flat` (own slip - `start`))).
    """

    stiff: float
    flat: float
    start: float
    shape: float
    bend: float
    shift: float


class Swing(NamedTuple):
    """Lateral force by kappa, S sin(C atan(K kappa)) cos(atan(A tan alpha)), S in N."""

    size: float
    alpha: float
    shape: float
    kappa: float


class Trail(NamedTuple):
    """Pneumatic trail [m], a cosine at x = tan alpha + Sh; its E has a slope with the sign of x."""

    shift: float
    b: float
    c: float
    d: float
    e: float
    slope: float


class Rest(NamedTuple):
    """Residual moment [N m], d cos(atan(b x)) at x = tan alpha + Sh."""

    shift: float
    b: float
    d: float


class MagicFormulaCurve(NamedTuple):
    """The Magic Formula at a load.

    Attributes:
        along: longitudinal force of pure slip [N].
        across: lateral force of pure slip [N].
        upright: the same without inclination, for the trail.
        leans: whether that differs.
        weight_along: of the lateral slip on the longitudinal force.
        weight_across: of the longitudinal slip on the lateral force.
        swing: lateral force by kappa.
        trail: pneumatic trail.
        rest: residual moment.
        ratio: of the slip stiffnesses, longitudinal by lateral [1].
        arm: of Fx about the vertical [m].
        arm_by_force: its change by Fy [m/N].
        low: speed below which the direction of rolling fades [m/s].
        scale: true load by that of the coefficients [1].
        friction: of the road, relative to that of the data [1].
    """

    along: Wave
    across: Wave
    upright: Wave
    leans: bool
    weight_along: Weight
    weight_across: Weight
    swing: Swing
    trail: Trail
    rest: Rest
    ratio: float
    arm: float
    arm_by_force: float
    low: float
    scale: float
    friction: float


def _longitudinal(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> Wave:
    dfz, shape = at.dfz, p.pcx1 * p.lcx
    bend = p.pex1 + p.pex2 * dfz + p.pex3 * dfz * dfz
    return Wave(
        curve.kxk / (shape * curve.dx),
        shape,
        curve.dx,
        min(bend * (1.0 - p.pex4) * p.lex, 1.0),
        min(bend * (1.0 + p.pex4) * p.lex, 1.0),
        (p.phx1 + p.phx2 * dfz) * p.lhx,
        at.load * (p.pvx1 + p.pvx2 * dfz) * (p.lvx * p.lmux) * at.mu,
    )


def _lateral(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> Wave:
    dfz, camber, shape = at.dfz, at.camber, p.pcy1 * p.lcy
    by_camber = at.load * (p.pvy3 + p.pvy4 * dfz) * camber * (p.lkyc * p.lmuy) * at.mu
    if p.version == "5.2":
        lean = p.phy3 * camber * p.lkyc
    else:
        thrust = at.load * (p.pky6 + p.pky7 * dfz) * (1.0 + p.ppy5 * at.dpi) * p.lkyc
        lean = (thrust * camber - by_camber) / curve.kya
    bend, middle = p.pey1 + p.pey2 * dfz, 1.0 + p.pey5 * camber * camber
    turned = p.pey3 + p.pey4 * camber
    return Wave(
        curve.kya / (shape * curve.dy),
        shape,
        curve.dy,
        min(bend * (middle - turned) * p.ley, 1.0),
        min(bend * (middle + turned) * p.ley, 1.0),
        (p.phy1 + p.phy2 * dfz) * p.lhy + lean,
        at.load * (p.pvy1 + p.pvy2 * dfz) * (p.lvy * p.lmuy) * at.mu + by_camber,
    )


def curve_at_load(
    p: MagicFormulaParameters,
    load: float,
    *,
    gamma: float = 0.0,
    pressure: float | None = None,
    friction: float = 1.0,
) -> MagicFormulaCurve:
    """What forces of combined slip at a load need.

    Args:
        p: parameters.
        load: normal load [N]; without any, there is no force.
        gamma: inclination angle [rad].
        pressure: inflation pressure [Pa]; that of the parameters if None.
        friction: of the road, relative to that of the tyre's data [1]; taken as 0.001 at least.
    """
    at = operating_point(p, load, gamma, pressure, friction, FLOAT)
    return curve_at(p, at, pure_slip(p, at))


def curve_at(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> MagicFormulaCurve:
    """The same where operating point and :func:`mirdrake.tyres.magic_formula.pure_slip` are known."""
    gamma, dfz, camber, mu = at.gamma, at.dfz, at.camber, at.mu
    along, across = _longitudinal(p, at, curve), _lateral(p, at, curve)
    leans = p.version != "5.2" and gamma != 0.0
    upright = across
    if leans:
        level = at._replace(gamma=0.0, camber=0.0)
        upright = _lateral(p, level, pure_slip(p, level))
    radius, of_friction = p.unloaded_radius, p.lky / (mu * p.lmuy)
    lean = (p.qdz8 + p.qdz9 * dfz) * (1.0 + p.ppz2 * at.dpi) + (p.qdz10 + p.qdz11 * dfz) * abs(camber)
    return MagicFormulaCurve(
        along=along,
        across=across,
        upright=upright,
        leans=leans,
        weight_along=Weight(
            stiff=(p.rbx1 + p.rbx3 * camber * camber) * p.lxal,
            flat=p.rbx2,
            start=0.0,
            shape=p.rcx1,
            bend=min(p.rex1 + p.rex2 * dfz, 1.0),
            shift=p.rhx1,
        ),
        weight_across=Weight(
            stiff=(p.rby1 + p.rby4 * camber * camber) * p.lyka,
            flat=p.rby2,
            start=p.rby3,
            shape=p.rcy1,
            bend=min(p.rey1 + p.rey2 * dfz, 1.0),
            shift=p.rhy1 + p.rhy2 * dfz,
        ),
        swing=Swing(
            size=curve.dy * (p.rvy1 + p.rvy2 * dfz + p.rvy3 * camber) * p.lvyka,
            alpha=p.rvy4,
            shape=p.rvy5,
            kappa=p.rvy6,
        ),
        trail=Trail(
            shift=p.qhz1 + p.qhz2 * dfz + (p.qhz3 + p.qhz4 * dfz) * camber,
            b=(p.qbz1 + p.qbz2 * dfz + p.qbz3 * dfz * dfz) * (1.0 + p.qbz4 * gamma + p.qbz5 * abs(gamma)) * of_friction,
            c=p.qcz1,
            d=(p.qdz1 + p.qdz2 * dfz)
            * (1.0 - p.ppz1 * at.dpi)
            * (1.0 + p.qdz3 * gamma + p.qdz4 * gamma * gamma)
            * (at.load * (radius / (p.lfzo * p.fnomin)) * p.ltr),
            e=p.qez1 + p.qez2 * dfz + p.qez3 * dfz * dfz,
            slope=(p.qez4 + p.qez5 * camber) * (2.0 / pi),
        ),
        rest=Rest(
            shift=across.shift_h + across.shift_v / curve.kya,
            b=p.qbz9 * of_friction + p.qbz10 * across.b * (p.pcy1 * p.lcy),
            d=at.load * radius * ((p.qdz6 + p.qdz7 * dfz) * p.lres + lean * camber * p.lkzc) * (mu * p.lmuy),
        ),
        ratio=curve.kxk / curve.kya,
        arm=radius * (p.ssz1 + (p.ssz3 + p.ssz4 * dfz) * gamma) * p.ls,
        arm_by_force=radius * p.ssz2 / p.fnomin * p.ls,
        low=p.vxlow,
        scale=at.scale,
        friction=mu,
    )


def magic_formula_on(curve: MagicFormulaCurve, kappa: float, tan_alpha: float, vx: float) -> tuple[float, float, float]:
    """Forces of combined slip in steady state, equal to those of :func:`mirdrake.tyres.magic_formula.magic_formula`.

    Args:
        curve: of :func:`curve_at_load`.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        vx: longitudinal speed [m/s].

    Returns:
        Fx [N], Fy [N], Mz [N m].
    """
    direction = 1.0 if vx >= curve.low else -1.0 if vx <= -curve.low else sin(0.5 * pi / curve.low * vx)
    fade = direction * direction
    like_kappa, like_slip = kappa / curve.friction, tan_alpha / curve.friction

    fx = _left(curve.weight_along, like_kappa, like_slip) * _wave(curve.along, kappa, fade)
    left = _left(curve.weight_across, like_slip, like_kappa)
    pure = left * _wave(curve.across, tan_alpha, fade)
    fy, swing = pure, curve.swing
    if swing.size != 0.0:
        flat = swing.alpha * like_slip
        fy += swing.size / sqrt(1.0 + flat * flat) * sin(swing.shape * atan(swing.kappa * like_kappa)) * fade
    for_trail = left * _wave(curve.upright, tan_alpha, fade) if curve.leans else pure

    along = direction / sqrt(1.0 + tan_alpha * tan_alpha)
    by_kappa = curve.ratio * kappa
    by_kappa = by_kappa * by_kappa + 1e-24
    trail, rest = curve.trail, curve.rest
    at_trail = tan_alpha + trail.shift
    slope = trail.b * sqrt(at_trail * at_trail + by_kappa)
    bend = min(trail.e * (1.0 + trail.slope * atan(trail.b * trail.c * at_trail)), 1.0)
    arm = trail.d * _cosine(slope, bend, trail.c) * along
    at_rest = tan_alpha + rest.shift * fade
    flat = rest.b * sqrt(at_rest * at_rest + by_kappa)
    mz = rest.d * along / sqrt(1.0 + flat * flat) - arm * for_trail + (curve.arm + curve.arm_by_force * fy) * fx
    return fx * curve.scale, fy * curve.scale, mz * curve.scale


def _wave(wave: Wave, slip: float, fade: float) -> float:
    x = slip + wave.shift_h * fade
    slope = wave.b * x
    bent = slope - (wave.e_back if x < 0.0 else wave.e_ahead) * (slope - atan(slope))
    return wave.d * sin(wave.c * atan(bent)) + wave.shift_v * fade


def _left(weight: Weight, own: float, other: float) -> float:
    """Part of a force that the other slip leaves [1]; cos(atan x) = 1 / sqrt(1 + x²)."""
    flat = weight.flat * (own - weight.start)
    stiff = weight.stiff / sqrt(1.0 + flat * flat)
    share = _cosine(stiff * (other + weight.shift), weight.bend, weight.shape)
    if weight.shift != 0.0:
        share /= _cosine(stiff * weight.shift, weight.bend, weight.shape)
    return max(share, 0.0)


def _cosine(slope: float, bend: float, shape: float) -> float:
    return cos(shape * atan(slope - bend * (slope - atan(slope))))


MAGIC_FORMULA_PARTS = (_wave, _left, _cosine)
"""What :func:`magic_formula_on` calls."""

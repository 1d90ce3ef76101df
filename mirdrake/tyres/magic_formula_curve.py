"""The Magic Formula at a load: what depends on load, inclination, pressure and friction only, worked out once.

A wheel asks for forces in every step of a simulation, while its load is measured less often. The function made here
gives Fx, Fy and Mz of :func:`mirdrake.tyres.magic_formula.magic_formula` for floats, in a third of its time; the
equations and their numbers are there.
"""

from collections.abc import Callable
from math import atan, cos, pi, sin, sqrt
from typing import NamedTuple

from mirdrake.tyres.magic_formula import OperatingPoint, SlipCurve, operating_point, pure_slip
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.maths import FLOAT

SteadyForces = Callable[[float, float, float], tuple[float, float, float]]
"""(kappa, tan alpha, vx [m/s]) -> (Fx [N], Fy [N], Mz [N m])."""


class _Wave(NamedTuple):
    """D sin(C atan(B x - E (B x - atan B x))) + Sv at x = slip + Sh; E for x from zero on and for x below."""

    b: float
    c: float
    d: float
    e_ahead: float
    e_back: float
    shift_h: float
    shift_v: float

    def at(self, slip: float, fade: float) -> float:
        b, c, d, e_ahead, e_back, shift_h, shift_v = self
        x = slip + shift_h * fade
        slope = b * x
        bent = slope - (e_back if x < 0.0 else e_ahead) * (slope - atan(slope))
        return d * sin(c * atan(bent)) + shift_v * fade


def _longitudinal(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> _Wave:
    dfz, shape = at.dfz, p.pcx1 * p.lcx
    bend = p.pex1 + p.pex2 * dfz + p.pex3 * dfz * dfz
    return _Wave(
        curve.kxk / (shape * curve.dx),
        shape,
        curve.dx,
        min(bend * (1.0 - p.pex4) * p.lex, 1.0),
        min(bend * (1.0 + p.pex4) * p.lex, 1.0),
        (p.phx1 + p.phx2 * dfz) * p.lhx,
        at.load * (p.pvx1 + p.pvx2 * dfz) * (p.lvx * p.lmux) * at.mu,
    )


def _lateral(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> _Wave:
    dfz, camber, shape = at.dfz, at.camber, p.pcy1 * p.lcy
    by_camber = at.load * (p.pvy3 + p.pvy4 * dfz) * camber * (p.lkyc * p.lmuy) * at.mu
    if p.version == "5.2":
        lean = p.phy3 * camber * p.lkyc
    else:
        thrust = at.load * (p.pky6 + p.pky7 * dfz) * (1.0 + p.ppy5 * at.dpi) * p.lkyc
        lean = (thrust * camber - by_camber) / curve.kya
    bend, middle = p.pey1 + p.pey2 * dfz, 1.0 + p.pey5 * camber * camber
    turned = p.pey3 + p.pey4 * camber
    return _Wave(
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
) -> SteadyForces:
    """Forces of combined slip at a load, as a function of slip and speed.

    Args:
        p: parameters.
        load: normal load [N]; without any, there is no force.
        gamma: inclination angle [rad].
        pressure: inflation pressure [Pa]; that of the parameters if None.
        friction: of the road, relative to that of the tyre's data [1]; taken as 0.001 at least.

    Returns:
        (kappa, tan alpha, vx) -> (Fx, Fy, Mz), equal to those of :func:`mirdrake.tyres.magic_formula.magic_formula`.
    """
    at = operating_point(p, load, gamma, pressure, friction, FLOAT)
    return curve_at(p, at, pure_slip(p, at))


def curve_at(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> SteadyForces:
    """The same where operating point and :func:`mirdrake.tyres.magic_formula.pure_slip` are known."""
    gamma = at.gamma
    dfz, camber, scale, mu = at.dfz, at.camber, at.scale, at.mu
    wave_x, wave_y = _longitudinal(p, at, curve), _lateral(p, at, curve)
    old = p.version == "5.2"
    upright = wave_y
    if not old and gamma != 0.0:
        level = at._replace(gamma=0.0, camber=0.0)
        upright = _lateral(p, level, pure_slip(p, level))

    # Weights of combined slip; cos(atan x) = 1 / sqrt(1 + x²).
    stiff_x, flat_x, shift_x = (p.rbx1 + p.rbx3 * camber * camber) * p.lxal, p.rbx2, p.rhx1
    shape_x, bend_x = p.rcx1, min(p.rex1 + p.rex2 * dfz, 1.0)
    stiff_y, flat_y, start_y = (p.rby1 + p.rby4 * camber * camber) * p.lyka, p.rby2, p.rby3
    shape_y, bend_y, shift_y = p.rcy1, min(p.rey1 + p.rey2 * dfz, 1.0), p.rhy1 + p.rhy2 * dfz
    swing, swing_alpha = curve.dy * (p.rvy1 + p.rvy2 * dfz + p.rvy3 * camber) * p.lvyka, p.rvy4
    swing_shape, swing_kappa = p.rvy5, p.rvy6

    # Trail, residual moment, arm of Fx.
    radius, ratio = p.unloaded_radius, curve.kxk / curve.kya
    shift_t = p.qhz1 + p.qhz2 * dfz + (p.qhz3 + p.qhz4 * dfz) * camber
    b_t = (p.qbz1 + p.qbz2 * dfz + p.qbz3 * dfz * dfz) * (1.0 + p.qbz4 * gamma + p.qbz5 * abs(gamma))
    b_t *= p.lky / (mu * p.lmuy)
    c_t = p.qcz1
    d_t = (p.qdz1 + p.qdz2 * dfz) * (1.0 - p.ppz1 * at.dpi) * (1.0 + p.qdz3 * gamma + p.qdz4 * gamma * gamma)
    d_t *= at.load * (radius / (p.lfzo * p.fnomin)) * p.ltr
    e_t = p.qez1 + p.qez2 * dfz + p.qez3 * dfz * dfz
    e_slope = (p.qez4 + p.qez5 * camber) * (2.0 / pi)
    shift_r = wave_y.shift_h + wave_y.shift_v / curve.kya
    b_r = p.qbz9 * p.lky / (mu * p.lmuy) + p.qbz10 * wave_y.b * (p.pcy1 * p.lcy)
    lean = (p.qdz8 + p.qdz9 * dfz) * (1.0 + p.ppz2 * at.dpi) + (p.qdz10 + p.qdz11 * dfz) * abs(camber)
    d_r = at.load * radius * ((p.qdz6 + p.qdz7 * dfz) * p.lres + lean * camber * p.lkzc) * (mu * p.lmuy)
    arm_0 = radius * (p.ssz1 + (p.ssz3 + p.ssz4 * dfz) * gamma) * p.ls
    arm_y = radius * p.ssz2 / p.fnomin * p.ls
    low, turn = p.vxlow, 0.5 * pi / p.vxlow

    def weight(slope: float, bend: float, shape: float) -> float:
        return cos(shape * atan(slope - bend * (slope - atan(slope))))

    def forces(kappa: float, slip: float, vx: float) -> tuple[float, float, float]:
        direction = 1.0 if vx >= low else -1.0 if vx <= -low else sin(turn * vx)
        fade = direction * direction
        like_kappa, like_slip = kappa / mu, slip / mu

        flat = flat_x * like_kappa
        stiff = stiff_x / sqrt(1.0 + flat * flat)
        g_x = weight(stiff * (like_slip + shift_x), bend_x, shape_x)
        if shift_x:
            g_x /= weight(stiff * shift_x, bend_x, shape_x)
        g_x = max(g_x, 0.0)
        fx = g_x * wave_x.at(kappa, fade)

        flat = flat_y * (like_slip - start_y)
        stiff = stiff_y / sqrt(1.0 + flat * flat)
        g_y = weight(stiff * (like_kappa + shift_y), bend_y, shape_y)
        if shift_y:
            g_y /= weight(stiff * shift_y, bend_y, shape_y)
        g_y = max(g_y, 0.0)
        pure = g_y * wave_y.at(slip, fade)
        fy = pure
        if swing:
            flat = swing_alpha * like_slip
            fy += swing / sqrt(1.0 + flat * flat) * sin(swing_shape * atan(swing_kappa * like_kappa)) * fade
        for_trail = pure if upright is wave_y else g_y * upright.at(slip, fade)

        along = direction / sqrt(1.0 + slip * slip)
        by_kappa = ratio * kappa
        by_kappa = by_kappa * by_kappa + 1e-24
        at_trail = slip + shift_t
        slope = b_t * sqrt(at_trail * at_trail + by_kappa)
        bend = min(e_t * (1.0 + e_slope * atan(b_t * c_t * at_trail)), 1.0)
        trail = d_t * weight(slope, bend, c_t) * along
        at_rest = slip + shift_r * fade
        flat = b_r * sqrt(at_rest * at_rest + by_kappa)
        rest = d_r * along / sqrt(1.0 + flat * flat)
        mz = rest - trail * for_trail + (arm_0 + arm_y * fy) * fx
        return fx * scale, fy * scale, mz * scale

    return forces

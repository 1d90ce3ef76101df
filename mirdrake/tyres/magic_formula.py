"""Magic Formula 5.2, 6.1 and 6.2 in steady state: forces and moments of the road on a tyre.

Axes and signs are those of ISO 8855 at the contact point: x ahead along the wheel plane, y left, z up; forces and
moments act on the tyre. The W axes of TYDEX (ISO-W), in which .tir files are written, are the same axes, so the numbers
of a file are used unchanged. The book's main text has y to the right and z down ("adapted SAE"): there alpha, gamma,
kappa, Fx and Mx are the same, Fy, My and Mz have the other sign, and PKY1 and PDY1 are positive.

Inputs: kappa = -Vsx / |Vx| (positive when driving, -1 when locked), tan alpha = Vy / |Vx| (positive when the wheel
moves to its left, so Fy is negative), load, inclination gamma about x (positive when the top is to the right),
speed, pressure and friction of the road relative to that of the tyre's data (λμ in both directions).

Source: H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 4.3.2, equations (4.E1) to (4.E78), numbered below;
turn slip is not modelled (every ζ is 1). Where .tir files mean something else than the book, the equations are those of
I. J. M. Besselink, A. J. C. Schmeitz and H. B. Pacejka, An improved Magic Formula/Swift tyre model that can handle
inflation pressure changes, Vehicle System Dynamics 48 (2010), appendix, numbered (A..) below. MFeval (M. Furlan), which
was compared with the solver of the files' maker, does the same. Further choices:

- The digressive friction factor of the shifts (4.E8) has Aμ = 1: λ'μ = λμ.
- The friction of the road acts by the similarity method (section 4.2): forces are those of the data's road at slips
  larger by 1 / λμ, times λμ. In pure slip this is the factor λμ of the formulas themselves. In combined slip the
  formulas leave the weights unchanged, and forces at low friction would leave the friction ellipse.
- The weights of combined slip are zero where their cosines would be negative: the book asks for positive ones (4.E51),
  (4.E59). A wheel that spins at standstill would otherwise be accelerated in the direction in which it slides.
- Outside fzmin..fzmax (and below a hundredth of the nominal load) the coefficients keep the values of the nearest
  bound, and forces and moments are proportional to the load, so they vanish with it.
- Below the speed vxlow the shifts fade with d², trail and residual moment with d, where d = sin(π Vx / 2 vxlow), in
  place of the ε of (4.E6), (4.E18), (4.E29): from vxlow on the formulas hold exactly, and backwards the moment has the
  other sign, as the patch trails on the other side. At standstill Fx and Fy follow the slip alone.
- Rolling resistance has the direction of the wheel's spin, with the same d.

A simulation asks for forces in every step, but for a new load much less often. :func:`curve_at` therefore computes what
depends on load, inclination, pressure and friction only, and :func:`magic_formula_on` the forces at a slip. Both are
functions of floats that :mod:`mirdrake.core.compiled` can compile; :func:`magic_formula` combines them.
"""

from math import pi
from typing import NamedTuple

from mirdrake.core.maths import Value, atan, choose, cos, exp, larger, sin, smaller, sqrt
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters

_LEAST_LOAD = 0.01
"""Smallest load, relative to the nominal load, at which the coefficients are evaluated [1]."""

_LEAST_FRICTION = 1e-3
"""Smallest friction of the road, relative to that of the tyre's data [1]."""

_TINY = 1e-24
"""Added to slips under a root, so that derivatives exist at zero slip [1]."""


# --- results and records -----------------------------------------------------------------------------------------


class TyreForces(NamedTuple):
    """Forces and moments of the road on the tyre, in tyre axes of ISO 8855.

    Attributes:
        fx: longitudinal force [N].
        fy: lateral force [N].
        mx: overturning moment [N m].
        my: rolling resistance moment [N m], negative when rolling ahead.
        mz: aligning moment [N m].
    """

    fx: Value
    fy: Value
    mx: Value
    my: Value
    mz: Value


class SlipCurve(NamedTuple):
    """Slopes and peaks of the pure-slip curves.

    Attributes:
        kxk: dFx/dkappa at zero force [N].
        kya: dFy/d tan alpha at zero force [N], negative.
        dx: peak longitudinal force without the vertical shift [N].
        dy: peak lateral force without the vertical shift [N], negative.
    """

    kxk: Value
    kya: Value
    dx: Value
    dy: Value


class RelaxationLengths(NamedTuple):
    """Relaxation lengths of longitudinal (x) and lateral (y) slip [m]."""

    x: Value
    y: Value


class OperatingPoint(NamedTuple):
    """Operating point of a tyre.

    Attributes:
        load: load within the range of the coefficients [N].
        scale: true load relative to that load [1].
        dfz: relative change of the load (4.E2a) [1].
        dpi: relative change of the pressure (4.E2b) [1].
        pressure: pressure relative to the nominal pressure [1].
        gamma: inclination angle [rad].
        camber: its sine [1].
        mu: friction of the road relative to that of the data [1].
    """

    load: Value
    scale: Value
    dfz: Value
    dpi: Value
    pressure: Value
    gamma: Value
    camber: Value
    mu: Value


class SineFormula(NamedTuple):
    """Force D sin(C atan(B x - E (B x - atan B x))) + Sv at x = slip + Sh [N]; E depends on the sign of x."""

    b: Value
    c: Value
    d: Value
    e_positive: Value
    e_negative: Value
    shift_h: Value
    shift_v: Value


class SlipWeight(NamedTuple):
    """Share of a pure-slip force that remains under the other slip [1].

    It is cos(C atan(B x - E (B x - atan B x))), relative to its value without the other slip, at x = other slip + Sh
    with B = b cos(atan(b_own (own slip - own_shift))). Sh is zero if `shifted` is.
    """

    b: Value
    b_own: Value
    own_shift: Value
    c: Value
    e: Value
    shift_h: Value
    shifted: Value


class KappaInducedForce(NamedTuple):
    """Lateral force d sin(c atan(b kappa)) cos(atan(b_alpha tan alpha)) due to longitudinal slip [N]."""

    d: Value
    b_alpha: Value
    c: Value
    b: Value


class PneumaticTrail(NamedTuple):
    """Trail d cos(c atan(b x - E (b x - atan b x))) [m] at x = tan alpha + Sh, with E = e (1 + e_slope atan(b c x))."""

    shift_h: Value
    b: Value
    c: Value
    d: Value
    e: Value
    e_slope: Value


class ResidualMoment(NamedTuple):
    """Moment d cos(atan(b x)) at x = tan alpha + Sh [N m]."""

    shift_h: Value
    b: Value
    d: Value


class MagicFormulaCurve(NamedTuple):
    """The Magic Formula at a load, an inclination, a pressure and a friction.

    Attributes:
        fx_pure: longitudinal force in pure slip.
        fy_pure: lateral force in pure slip.
        fy_upright: the same without inclination, for the trail.
        cambered: 1 if fy_upright differs from fy_pure, else 0.
        fx_weight: effect of lateral slip on the longitudinal force.
        fy_weight: effect of longitudinal slip on the lateral force.
        induced: 1 if longitudinal slip causes a lateral force, else 0.
        kappa_induced: this force.
        trail: pneumatic trail.
        residual: residual moment.
        stiffness_ratio: longitudinal over lateral slip stiffness [1].
        arm: moment arm of Fx about the vertical axis [m].
        arm_by_fy: its change by Fy [m/N].
        vxlow: speed below which shifts, trail and residual moment fade [m/s].
        scale: true load relative to that of the coefficients [1].
        friction: friction of the road relative to that of the data [1].
    """

    fx_pure: SineFormula
    fy_pure: SineFormula
    fy_upright: SineFormula
    cambered: Value
    fx_weight: SlipWeight
    fy_weight: SlipWeight
    induced: Value
    kappa_induced: KappaInducedForce
    trail: PneumaticTrail
    residual: ResidualMoment
    stiffness_ratio: Value
    arm: Value
    arm_by_fy: Value
    vxlow: Value
    scale: Value
    friction: Value


# --- what depends on the load ------------------------------------------------------------------------------------


def operating_point(
    p: MagicFormulaParameters, load: Value, gamma: Value, pressure: Value, friction: Value
) -> OperatingPoint:
    """Return the operating point of arguments as in :func:`magic_formula`."""
    load = larger(load, 0.0)
    # Coefficients hold between FZMIN and FZMAX; outside, forces are scaled with the load from the nearer limit.
    inside = smaller(larger(load, max(p.fzmin, _LEAST_LOAD * p.fnomin)), p.fzmax)
    nominal = p.lfzo * p.fnomin  # (4.E1)
    used = (p.inflpres or p.nompres) if pressure is None else pressure
    ratio = used / p.nompres if p.nompres else 1.0
    return OperatingPoint(
        load=inside,
        scale=load / inside,
        dfz=(inside - nominal) / nominal,  # (4.E2a)
        dpi=ratio - 1.0,  # (4.E2b)
        pressure=ratio,
        gamma=gamma,
        camber=sin(gamma),  # (4.E4)
        mu=larger(friction, _LEAST_FRICTION),
    )


def pure_slip(p: MagicFormulaParameters, point: OperatingPoint) -> SlipCurve:
    """Return slip stiffnesses and peak forces at the load of the operating point, without its scale."""
    # Peak friction first, since both peak forces follow from it; the scale of the load at hand comes later.
    load, dfz, dpi, camber = point.load, point.dfz, point.dpi, point.camber
    nominal = p.lfzo * p.fnomin
    mux = (p.pdx1 + p.pdx2 * dfz) * (1.0 + p.ppx3 * dpi + p.ppx4 * dpi * dpi)
    mux = mux * (1.0 - p.pdx3 * point.gamma * point.gamma)  # (4.E13)
    muy = (p.pdy1 + p.pdy2 * dfz) * (1.0 + p.ppy3 * dpi + p.ppy4 * dpi * dpi)
    muy = muy * (1.0 - p.pdy3 * camber * camber)  # (4.E23)
    by_load = load / nominal / ((p.pky2 + p.pky5 * camber * camber) * (1.0 + p.ppy2 * dpi))
    return SlipCurve(
        kxk=load
        * (p.pkx1 + p.pkx2 * dfz)
        * exp(p.pkx3 * dfz)
        * ((1.0 + p.ppx1 * dpi + p.ppx2 * dpi * dpi) * p.lkx),  # (4.E15)
        kya=p.pky1
        * nominal
        * (1.0 + p.ppy1 * dpi)
        * (1.0 - p.pky3 * abs(camber))
        * sin(p.pky4 * atan(by_load))
        * p.lky,  # (4.E25)
        dx=mux * load * (point.mu * p.lmux),  # (4.E12)
        dy=muy * load * (point.mu * p.lmuy),  # (4.E22)
    )


def slip_curve(
    p: MagicFormulaParameters, load: Value, *, gamma: Value = 0.0, pressure: Value = None, friction: Value = 1.0
) -> SlipCurve:
    """Return slip stiffnesses and peak forces at a load; arguments as in :func:`magic_formula`."""
    point = operating_point(p, load, gamma, pressure, friction)
    return SlipCurve(*(value * point.scale for value in pure_slip(p, point)))


def relaxation_lengths(
    p: MagicFormulaParameters, load: Value, *, gamma: Value = 0.0, pressure: Value = None
) -> RelaxationLengths:
    """Return the relaxation lengths: slip stiffness over stiffness of the carcass.

    Besselink et al. (2010), equations (17) to (19) for 6.1 and 6.2; PTX and PTY of the MF-Tyre manual for 5.2. If the
    file has no stiffnesses, both are the unloaded radius, the order of magnitude for cars.
    """
    point = operating_point(p, load, gamma, pressure, 1.0)
    return lengths_at(p, point, pure_slip(p, point))


def lengths_at(p: MagicFormulaParameters, point: OperatingPoint, slopes: SlipCurve) -> RelaxationLengths:
    """Return the relaxation lengths at an operating point.

    Args:
        p: parameters.
        point: operating point.
        slopes: slopes from :func:`pure_slip`.
    """
    dfz, dpi = point.dfz, point.dpi
    # The sum gives the result the type and shape of the load (array or AutoDiff).
    fallback = p.unloaded_radius + 0.0 * point.load
    if p.version == "5.2":
        length_x = (p.ptx1 + p.ptx2 * dfz) * exp(-p.ptx3 * dfz) * p.lsgkp * p.unloaded_radius * point.load / p.fnomin
        length_y = fallback
        if p.pty1 and p.pty2:
            by_load = sin(2.0 * atan(point.load / (p.pty2 * p.lfzo * p.fnomin)))
            length_y = p.pty1 * by_load * (1.0 - p.pky3 * abs(point.camber)) * p.unloaded_radius * p.lfzo * p.lsgal
        return RelaxationLengths(length_x if p.ptx1 else fallback, length_y)
    length_x = length_y = fallback
    if p.longitudinal_stiffness:
        by_load = (1.0 + p.pcfx1 * dfz + p.pcfx2 * dfz * dfz) * (1.0 + p.pcfx3 * dpi)
        length_x = slopes.kxk / (p.longitudinal_stiffness * by_load)
    if p.lateral_stiffness:
        by_load = (1.0 + p.pcfy1 * dfz + p.pcfy2 * dfz * dfz) * (1.0 + p.pcfy3 * dpi)
        length_y = -slopes.kya / (p.lateral_stiffness * by_load)
    return RelaxationLengths(length_x, length_y)


def _longitudinal(p: MagicFormulaParameters, point: OperatingPoint, slopes: SlipCurve) -> SineFormula:
    """Return Fx in pure slip (4.E9)."""
    dfz, shape = point.dfz, p.pcx1 * p.lcx  # (4.E11)
    curvature = p.pex1 + p.pex2 * dfz + p.pex3 * dfz * dfz
    return SineFormula(
        b=slopes.kxk / (shape * slopes.dx),  # (4.E16)
        c=shape,
        d=slopes.dx,
        e_positive=smaller(curvature * (1.0 - p.pex4) * p.lex, 1.0),  # (4.E14)
        e_negative=smaller(curvature * (1.0 + p.pex4) * p.lex, 1.0),
        shift_h=(p.phx1 + p.phx2 * dfz) * p.lhx,  # (4.E17)
        shift_v=point.load * (p.pvx1 + p.pvx2 * dfz) * (p.lvx * p.lmux) * point.mu,  # (4.E18)
    )


def _lateral(p: MagicFormulaParameters, point: OperatingPoint, slopes: SlipCurve) -> SineFormula:
    """Return Fy in pure slip (4.E19)."""
    dfz, camber, shape = point.dfz, point.camber, p.pcy1 * p.lcy  # (4.E21)
    by_camber = point.load * (p.pvy3 + p.pvy4 * dfz) * camber * (p.lkyc * p.lmuy) * point.mu  # (4.E28)
    # 5.2 has camber as a shift of the slip, 6.1 and 6.2 as a stiffness of its own.
    if p.version == "5.2":
        camber_shift = p.phy3 * camber * p.lkyc
    else:
        stiffness = point.load * (p.pky6 + p.pky7 * dfz) * (1.0 + p.ppy5 * point.dpi) * p.lkyc  # (4.E30)
        camber_shift = (stiffness * camber - by_camber) / slopes.kya
    curvature, mean = p.pey1 + p.pey2 * dfz, 1.0 + p.pey5 * camber * camber
    difference = p.pey3 + p.pey4 * camber
    return SineFormula(
        b=slopes.kya / (shape * slopes.dy),  # (4.E26)
        c=shape,
        d=slopes.dy,
        e_positive=smaller(curvature * (mean - difference) * p.ley, 1.0),  # (4.E24)
        e_negative=smaller(curvature * (mean + difference) * p.ley, 1.0),
        shift_h=(p.phy1 + p.phy2 * dfz) * p.lhy + camber_shift,  # (4.E27)
        shift_v=point.load * (p.pvy1 + p.pvy2 * dfz) * (p.lvy * p.lmuy) * point.mu + by_camber,  # (4.E29)
    )


def curve_at(p: MagicFormulaParameters, point: OperatingPoint, slopes: SlipCurve) -> MagicFormulaCurve:
    """Return what :func:`magic_formula_on` needs at an operating point.

    Args:
        p: parameters.
        point: operating point.
        slopes: slopes from :func:`pure_slip`.
    """
    gamma, dfz, camber, mu = point.gamma, point.dfz, point.camber, point.mu
    fx_pure, fy_pure = _longitudinal(p, point, slopes), _lateral(p, point, slopes)
    # The trail acts on the lateral force without camber (4.E74), except in 5.2.
    # Arrays and AutoDiff values count as inclined: a zero may have a derivative.
    cambered = p.version != "5.2" and not (isinstance(gamma, float) and gamma == 0.0)
    fy_upright = fy_pure
    if cambered:
        upright = point._replace(gamma=0.0, camber=0.0)
        fy_upright = _lateral(p, upright, pure_slip(p, upright))
    # Coefficients of the aligning moment scale with the cornering stiffness over friction, (A58).
    radius, stiffness_over_friction = p.unloaded_radius, p.lky / (mu * p.lmuy)
    by_camber = (p.qdz8 + p.qdz9 * dfz) * (1.0 + p.ppz2 * point.dpi) + (p.qdz10 + p.qdz11 * dfz) * abs(camber)
    return MagicFormulaCurve(
        fx_pure=fx_pure,
        fy_pure=fy_pure,
        fy_upright=fy_upright,
        cambered=1.0 if cambered else 0.0,
        fx_weight=SlipWeight(  # (4.E51) to (4.E57)
            b=(p.rbx1 + p.rbx3 * camber * camber) * p.lxal,
            b_own=p.rbx2,
            own_shift=0.0,
            c=p.rcx1,
            e=smaller(p.rex1 + p.rex2 * dfz, 1.0),
            shift_h=p.rhx1,
            shifted=float(p.rhx1 != 0.0),
        ),
        fy_weight=SlipWeight(  # (4.E59) to (4.E65)
            b=(p.rby1 + p.rby4 * camber * camber) * p.lyka,
            b_own=p.rby2,
            own_shift=p.rby3,
            c=p.rcy1,
            e=smaller(p.rey1 + p.rey2 * dfz, 1.0),
            shift_h=p.rhy1 + p.rhy2 * dfz,
            shifted=float(p.rhy1 != 0.0 or p.rhy2 != 0.0),
        ),
        induced=float(p.rvy1 != 0.0 or p.rvy2 != 0.0 or p.rvy3 != 0.0),
        kappa_induced=KappaInducedForce(  # (4.E66), (4.E67)
            d=slopes.dy * (p.rvy1 + p.rvy2 * dfz + p.rvy3 * camber) * p.lvyka,
            b_alpha=p.rvy4,
            c=p.rvy5,
            b=p.rvy6,
        ),
        trail=PneumaticTrail(
            shift_h=p.qhz1 + p.qhz2 * dfz + (p.qhz3 + p.qhz4 * dfz) * camber,  # (4.E35)
            b=(p.qbz1 + p.qbz2 * dfz + p.qbz3 * dfz * dfz)
            * (1.0 + p.qbz4 * gamma + p.qbz5 * abs(gamma))
            * stiffness_over_friction,  # (A58)
            c=p.qcz1,
            d=(p.qdz1 + p.qdz2 * dfz)
            * (1.0 - p.ppz1 * point.dpi)
            * (1.0 + p.qdz3 * gamma + p.qdz4 * gamma * gamma)
            * (point.load * (radius / (p.lfzo * p.fnomin)) * p.ltr),  # (A60)
            e=p.qez1 + p.qez2 * dfz + p.qez3 * dfz * dfz,
            e_slope=(p.qez4 + p.qez5 * camber) * (2.0 / pi),  # (4.E44)
        ),
        residual=ResidualMoment(
            shift_h=fy_pure.shift_h + fy_pure.shift_v / slopes.kya,  # (4.E38)
            b=p.qbz9 * stiffness_over_friction + p.qbz10 * fy_pure.b * (p.pcy1 * p.lcy),  # (4.E45)
            d=point.load
            * radius
            * ((p.qdz6 + p.qdz7 * dfz) * p.lres + by_camber * camber * p.lkzc)
            * (mu * p.lmuy),  # (4.E47)
        ),
        stiffness_ratio=slopes.kxk / slopes.kya,
        arm=radius * (p.ssz1 + (p.ssz3 + p.ssz4 * dfz) * gamma) * p.ls,  # (A56)
        arm_by_fy=radius * p.ssz2 / p.fnomin * p.ls,
        vxlow=p.vxlow,
        scale=point.scale,
        friction=mu,
    )


# --- forces at a slip --------------------------------------------------------------------------------------------


def magic_formula_on(curve: MagicFormulaCurve, kappa: Value, tan_alpha: Value, vx: Value) -> tuple[Value, Value, Value]:
    """Return forces and aligning moment of combined slip in steady state; arguments as in :func:`magic_formula`.

    Args:
        curve: curve from :func:`curve_at`.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        vx: longitudinal speed [m/s].

    Returns:
        Fx [N], Fy [N], Mz [N m].
    """
    fx, fy, mz = _combined_slip(curve, kappa, tan_alpha, vx)
    return fx * curve.scale, fy * curve.scale, mz * curve.scale


def _combined_slip(curve: MagicFormulaCurve, kappa: Value, tan_alpha: Value, vx: Value) -> tuple[Value, Value, Value]:
    """Return Fx, Fy and Mz at the load of the coefficients."""
    # Shifts would push a vehicle at standstill; the square is 1 in both directions of rolling and 0 there.
    direction = _direction(vx, curve.vxlow)
    fade = direction * direction
    # Slips of equal effect on the road of the data, by similarity.
    similar_kappa, similar_slip = kappa / curve.friction, tan_alpha / curve.friction

    # Forces: pure slip, weighted by the other slip.
    fx = _weight(curve.fx_weight, similar_kappa, similar_slip) * _sine_formula(curve.fx_pure, kappa, fade)  # (4.E50)
    fy_weight = _weight(curve.fy_weight, similar_slip, similar_kappa)
    weighted = fy_weight * _sine_formula(curve.fy_pure, tan_alpha, fade)
    fy = weighted
    if curve.induced > 0.0:
        induced = curve.kappa_induced
        bx = induced.b_alpha * similar_slip
        fy = fy + induced.d / sqrt(1.0 + bx * bx) * sin(induced.c * atan(induced.b * similar_kappa)) * fade  # (4.E58)
    for_trail = fy_weight * _sine_formula(curve.fy_upright, tan_alpha, fade) if curve.cambered > 0.0 else weighted

    # Aligning moment (4.E71): trail, residual moment, and Fx on its arm.
    cosine = direction / sqrt(1.0 + tan_alpha * tan_alpha)  # cos α', (4.E6)
    by_kappa = curve.stiffness_ratio * kappa
    # The small term keeps the derivative of the root finite at zero slip (AutoDiff).
    by_kappa = by_kappa * by_kappa + _TINY
    trail, residual = curve.trail, curve.residual
    trail_slip = tan_alpha + trail.shift_h  # (4.E34)
    bx = trail.b * sqrt(trail_slip * trail_slip + by_kappa)  # (4.E77)
    e = smaller(trail.e * (1.0 + trail.e_slope * atan(trail.b * trail.c * trail_slip)), 1.0)  # (4.E44)
    length = trail.d * _cosine_formula(bx, e, trail.c) * cosine  # (4.E73)
    residual_slip = tan_alpha + residual.shift_h * fade  # (4.E37)
    bx = residual.b * sqrt(residual_slip * residual_slip + by_kappa)  # (4.E78)
    moment = residual.d * cosine / sqrt(1.0 + bx * bx)  # (4.E75)
    return fx, fy, moment - length * for_trail + (curve.arm + curve.arm_by_fy * fy) * fx


def _direction(speed: Value, low: Value) -> Value:
    """Return the direction of rolling: ±1 from the speed `low` [m/s] on, sin(π v / 2 low) below."""
    return choose(speed >= low, 1.0, choose(speed <= -low, -1.0, sin(0.5 * pi / low * speed)))


def _sine_formula(formula: SineFormula, slip: Value, fade: Value) -> Value:
    """Return a force in pure slip [N]; its shifts are multiplied by `fade`."""
    x = slip + formula.shift_h * fade
    bx = formula.b * x
    e = choose(x < 0.0, formula.e_negative, formula.e_positive)
    return formula.d * sin(formula.c * atan(bx - e * (bx - atan(bx)))) + formula.shift_v * fade


def _weight(weight: SlipWeight, own: Value, other: Value) -> Value:
    """Return the share of a force that remains under the other slip [1], not negative."""
    # cos(atan x) = 1 / sqrt(1 + x²)
    bx = weight.b_own * (own - weight.own_shift)
    b = weight.b / sqrt(1.0 + bx * bx)
    # Normalised to 1 without the other slip, also with a horizontal shift.
    share = _cosine_formula(b * (other + weight.shift_h), weight.e, weight.c)
    if weight.shifted > 0.0:
        share = share / _cosine_formula(b * weight.shift_h, weight.e, weight.c)
    return larger(share, 0.0)


def _cosine_formula(bx: Value, e: Value, c: Value) -> Value:
    return cos(c * atan(bx - e * (bx - atan(bx))))


MAGIC_FORMULA_PARTS = (_combined_slip, _direction, _sine_formula, _weight, _cosine_formula)
"""Functions that :func:`magic_formula_on` calls."""


def magic_formula(
    p: MagicFormulaParameters,
    kappa: Value,
    tan_alpha: Value,
    load: Value,
    *,
    vx: Value,
    gamma: Value = 0.0,
    pressure: Value = None,
    friction: Value = 1.0,
) -> TyreForces:
    """Return forces and moments of combined slip in steady state; conventions in the head of the module.

    Arguments are floats, arrays that broadcast, or AutoDiffXd.

    Args:
        p: parameters.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        load: normal load [N]; forces are zero without load.
        vx: longitudinal speed of the contact centre [m/s].
        gamma: inclination angle [rad].
        pressure: inflation pressure [Pa]; that of the parameters if None.
        friction: friction of the road relative to that of the tyre's data [1]; values below 0.001 count as 0.001.
    """
    point = operating_point(p, load, gamma, pressure, friction)
    curve = curve_at(p, point, pure_slip(p, point))
    fx, fy, mz = _combined_slip(curve, kappa, tan_alpha, vx)
    tread_speed = vx + kappa * abs(vx)  # (2.5) with (4.E5)
    mx = overturning_moment(p, point, fy)
    my = _rolling_resistance(p, point, fx, vx) * _direction(tread_speed, p.vxlow)
    return TyreForces(*(value * point.scale for value in (fx, fy, mx, my, mz)))


def overturning_moment(p: MagicFormulaParameters, point: OperatingPoint, fy: Value) -> Value:
    """Return Mx (4.E69), with QSX12 to QSX14 of the MF-Tyre manual."""
    gamma, load, side = point.gamma, point.load / p.fnomin, fy / p.fnomin
    mixed = cos(p.qsx5 * atan((p.qsx6 * load) ** 2))
    mixed = p.qsx4 * mixed * sin(p.qsx7 * gamma + p.qsx8 * atan(p.qsx9 * side))
    by_camber = p.qsx10 * atan(p.qsx11 * load) * gamma - p.qsx2 * gamma * (1.0 + p.ppmx1 * point.dpi)
    first = point.load * (p.qsx1 * p.lvmx + by_camber + p.qsx3 * side + mixed)
    second = fy * (p.qsx13 + p.qsx14 * abs(gamma)) - point.load * p.qsx12 * gamma * abs(gamma)
    return p.unloaded_radius * p.lmx * (first + second)


def _rolling_resistance(p: MagicFormulaParameters, point: OperatingPoint, fx: Value, vx: Value) -> Value:
    """Return My of a wheel that rolls ahead: (A48) for 6.1 and 6.2, the MF-Tyre manual for 5.2."""
    speed, load = vx / p.longvl, point.load / p.fnomin
    factor = p.qsy1 + p.qsy2 * (fx / p.fnomin) + p.qsy3 * abs(speed) + p.qsy4 * speed**4
    if p.version == "5.2":
        return -p.unloaded_radius * point.load * p.lmy * factor
    factor = factor + (p.qsy5 + p.qsy6 * load) * point.gamma * point.gamma
    return -p.unloaded_radius * p.fnomin * p.lmy * factor * (load**p.qsy7 * point.pressure**p.qsy8)

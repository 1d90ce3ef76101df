"""Magic Formula 5.2, 6.1 and 6.2 in steady state: forces and moments of the road on a tyre.

Axes and signs are those of ISO 8855 at the contact point: x ahead along the wheel plane, y left, z up; forces and
moments act on the tyre. The W axes of TYDEX (ISO-W), in which .tir files are written, are the same axes, so their
numbers are used as they stand. The book's main text has y to the right and z down ("adapted SAE"): there alpha, gamma,
kappa, Fx and Mx are the same, Fy, My and Mz have the other sign, and PKY1 and PDY1 are positive.

Inputs: kappa = -Vsx / |Vx| (positive when driving, -1 when locked), tan alpha = Vy / |Vx| (positive when the wheel
moves to its left, so Fy is negative), load, inclination gamma about x (positive when the top leans to the right),
speed, pressure and friction of the road relative to that of the tyre's data (λμ in both directions).

Source: H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 4.3.2, equations (4.E1) to (4.E78), named below; turn
slip is off (every ζ is 1). Where .tir files mean something else than the book, the equations of I. J. M. Besselink,
A. J. C. Schmeitz and H. B. Pacejka, An improved Magic Formula/Swift tyre model that can handle inflation pressure
changes, Vehicle System Dynamics 48 (2010), appendix, are taken, (A..) below; so does MFeval (M. Furlan), which was
compared with the solver of the files' maker. Further choices:

- The digressive friction factor of the shifts (4.E8) has Aμ = 1: λ'μ = λμ.
- The friction of the road acts by the similarity method (section 4.2): forces are those of the data's road at slips
  larger by 1 / λμ, times λμ. In pure slip this is the factor λμ of the formulas itself; in combined slip those leave
  the weights as they are, and the forces of low friction would come out of the friction ellipse.
- The weights of combined slip are zero where their cosines would be negative: the book asks for positive ones (4.E51),
  (4.E59), and a wheel that spins on the spot would else be pushed along to the side that it slides to.
- Outside fzmin..fzmax (and below a hundredth of the nominal load) the coefficients stay those of the nearest bound and
  forces and moments go on in proportion to the load, so they vanish with it.
- Below the speed vxlow the shifts fade with d², trail and residual moment with d, where d = sin(π Vx / 2 vxlow), in
  place of the ε of (4.E6), (4.E18), (4.E29): from vxlow on the formulas hold exactly, and backwards the moment has the
  other sign, as the patch trails on the other side. At standstill Fx and Fy follow the slip alone.
- Rolling resistance has the direction of the wheel's spin, with the same d.
"""

from math import pi
from typing import NamedTuple

from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.maths import Maths, Value, maths_for

_LEAST_LOAD = 0.01  # of the nominal load; coefficients are not asked below
_LEAST_FRICTION = 1e-3  # of the tyre's own


class TyreForces(NamedTuple):
    """What the road does to the tyre, in tyre axes of ISO 8855.

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
        dx: peak longitudinal force, less the shift [N].
        dy: peak lateral force, less the shift [N], negative.
    """

    kxk: Value
    kya: Value
    dx: Value
    dy: Value


class OperatingPoint(NamedTuple):
    """What several formulas need of an operating point.

    Attributes:
        maths: functions of its kind of number.
        load: within the range of the coefficients [N].
        scale: true load by that load [1].
        dfz: change of load (4.E2a) [1].
        dpi: change of pressure (4.E2b) [1].
        pressure: by the nominal one [1].
        gamma: inclination angle [rad].
        camber: its sine [1].
        mu: friction of the road relative to that of the data [1].
    """

    maths: Maths
    load: Value
    scale: Value
    dfz: Value
    dpi: Value
    pressure: Value
    gamma: Value
    camber: Value
    mu: Value


def operating_point(
    p: MagicFormulaParameters, load: Value, gamma: Value, pressure: Value, friction: Value, maths: Maths
) -> OperatingPoint:
    """The operating point of arguments as of :func:`magic_formula`."""
    load = maths.at_least(load, 0.0)
    inside = maths.at_most(maths.at_least(load, max(p.fzmin, _LEAST_LOAD * p.fnomin)), p.fzmax)
    nominal = p.lfzo * p.fnomin  # (4.E1)
    used = (p.inflpres or p.nompres) if pressure is None else pressure
    ratio = used / p.nompres if p.nompres else 1.0
    return OperatingPoint(
        maths,
        inside,
        load / inside,
        (inside - nominal) / nominal,  # (4.E2a)
        ratio - 1.0,  # (4.E2b)
        ratio,
        gamma,
        maths.sin(gamma),  # (4.E4)
        maths.at_least(friction, _LEAST_FRICTION),
    )


def pure_slip(p: MagicFormulaParameters, at: OperatingPoint) -> SlipCurve:
    """Slip stiffnesses and peak forces at the operating point's load, before its scale."""
    maths, load, dfz, dpi, camber = at.maths, at.load, at.dfz, at.dpi, at.camber
    nominal = p.lfzo * p.fnomin
    mux = (p.pdx1 + p.pdx2 * dfz) * (1.0 + p.ppx3 * dpi + p.ppx4 * dpi * dpi) * (1.0 - p.pdx3 * at.gamma * at.gamma)
    muy = (p.pdy1 + p.pdy2 * dfz) * (1.0 + p.ppy3 * dpi + p.ppy4 * dpi * dpi) * (1.0 - p.pdy3 * camber * camber)
    by_load = load / nominal / ((p.pky2 + p.pky5 * camber * camber) * (1.0 + p.ppy2 * dpi))
    return SlipCurve(
        kxk=load
        * (p.pkx1 + p.pkx2 * dfz)
        * maths.exp(p.pkx3 * dfz)
        * ((1.0 + p.ppx1 * dpi + p.ppx2 * dpi * dpi) * p.lkx),  # (4.E15)
        kya=p.pky1
        * nominal
        * (1.0 + p.ppy1 * dpi)
        * (1.0 - p.pky3 * abs(camber))
        * maths.sin(p.pky4 * maths.atan(by_load))
        * p.lky,  # (4.E25)
        dx=mux * load * (at.mu * p.lmux),  # (4.E12), (4.E13)
        dy=muy * load * (at.mu * p.lmuy),  # (4.E22), (4.E23)
    )


def slip_curve(
    p: MagicFormulaParameters, load: Value, *, gamma: Value = 0.0, pressure: Value = None, friction: Value = 1.0
) -> SlipCurve:
    """Slip stiffnesses and peak forces at a load; arguments as of :func:`magic_formula`."""
    at = operating_point(
        p, load, gamma, pressure, friction, maths_for(load, gamma, 0.0 if pressure is None else pressure, friction)
    )
    return SlipCurve(*(value * at.scale for value in pure_slip(p, at)))


def relaxation_lengths(
    p: MagicFormulaParameters, load: Value, *, gamma: Value = 0.0, pressure: Value = None
) -> tuple[Value, Value]:
    """Relaxation lengths of longitudinal and lateral slip [m], slip stiffness by stiffness of the carcass.

    Besselink et al. (2010), equations (17) to (19) for 6.1 and 6.2; for 5.2 the PTX and PTY of the MF-Tyre manual.
    Without stiffnesses in the file it is the unloaded radius for both, the order of magnitude for cars.
    """
    maths = maths_for(load, gamma, 0.0 if pressure is None else pressure)
    at = operating_point(p, load, gamma, pressure, 1.0, maths)
    return lengths_at(p, at, pure_slip(p, at))


def lengths_at(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve) -> tuple[Value, Value]:
    """The same where operating point and :func:`pure_slip` are known."""
    maths, dfz, dpi = at.maths, at.dfz, at.dpi
    fallback = p.unloaded_radius + 0.0 * at.load
    if p.version == "5.2":
        along = (p.ptx1 + p.ptx2 * dfz) * maths.exp(-p.ptx3 * dfz) * p.lsgkp * p.unloaded_radius * at.load / p.fnomin
        across = fallback
        if p.pty1 and p.pty2:
            bend = maths.sin(2.0 * maths.atan(at.load / (p.pty2 * p.lfzo * p.fnomin)))
            across = p.pty1 * bend * (1.0 - p.pky3 * abs(at.camber)) * p.unloaded_radius * p.lfzo * p.lsgal
        return along if p.ptx1 else fallback, across
    along = across = fallback
    if p.longitudinal_stiffness:
        by_load = (1.0 + p.pcfx1 * dfz + p.pcfx2 * dfz * dfz) * (1.0 + p.pcfx3 * dpi)
        along = curve.kxk / (p.longitudinal_stiffness * by_load)
    if p.lateral_stiffness:
        by_load = (1.0 + p.pcfy1 * dfz + p.pcfy2 * dfz * dfz) * (1.0 + p.pcfy3 * dpi)
        across = -curve.kya / (p.lateral_stiffness * by_load)
    return along, across


def _shape(maths: Maths, b: Value, c: Value, e: Value, x: Value) -> Value:
    """The angle C atan(B x - E (B x - atan B x)): its sine is the Magic Formula, its cosine the weighting and trail."""
    slope = b * x
    return c * maths.atan(slope - e * (slope - maths.atan(slope)))


def _fx0(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve, kappa: Value, fade: Value) -> Value:
    maths, dfz = at.maths, at.dfz
    shape = p.pcx1 * p.lcx  # (4.E11)
    shifted = kappa + (p.phx1 + p.phx2 * dfz) * p.lhx * fade  # (4.E10), (4.E17)
    shift = at.load * (p.pvx1 + p.pvx2 * dfz) * (p.lvx * p.lmux) * at.mu * fade  # (4.E18)
    bend = (p.pex1 + p.pex2 * dfz + p.pex3 * dfz * dfz) * (1.0 - p.pex4 * maths.sign(shifted)) * p.lex  # (4.E14)
    stiff = curve.kxk / (shape * curve.dx)  # (4.E16)
    return curve.dx * maths.sin(_shape(maths, stiff, shape, maths.at_most(bend, 1.0), shifted)) + shift  # (4.E9)


class _Lateral(NamedTuple):
    force: Value
    shift_h: Value
    shift_v: Value
    stiff: Value  # By


def _fy0(p: MagicFormulaParameters, at: OperatingPoint, curve: SlipCurve, slip: Value, fade: Value) -> _Lateral:
    maths, dfz, camber = at.maths, at.dfz, at.camber
    by_camber = at.load * (p.pvy3 + p.pvy4 * dfz) * camber * (p.lkyc * p.lmuy) * at.mu  # (4.E28)
    if p.version == "5.2":
        lean = p.phy3 * camber * p.lkyc
    else:
        thrust = at.load * (p.pky6 + p.pky7 * dfz) * (1.0 + p.ppy5 * at.dpi) * p.lkyc  # (4.E30)
        lean = (thrust * camber - by_camber) / curve.kya
    shift_h = ((p.phy1 + p.phy2 * dfz) * p.lhy + lean) * fade  # (4.E27)
    shift_v = (at.load * (p.pvy1 + p.pvy2 * dfz) * (p.lvy * p.lmuy) * at.mu + by_camber) * fade  # (4.E29)
    shifted = slip + shift_h  # (4.E20)
    shape = p.pcy1 * p.lcy  # (4.E21)
    turned = 1.0 + p.pey5 * camber * camber - (p.pey3 + p.pey4 * camber) * maths.sign(shifted)
    bend = (p.pey1 + p.pey2 * dfz) * turned * p.ley  # (4.E24)
    stiff = curve.kya / (shape * curve.dy)  # (4.E26)
    angle = _shape(maths, stiff, shape, maths.at_most(bend, 1.0), shifted)
    return _Lateral(curve.dy * maths.sin(angle) + shift_v, shift_h, shift_v, stiff)  # (4.E19)


def _weight_x(p: MagicFormulaParameters, at: OperatingPoint, kappa: Value, slip: Value) -> Value:
    """Gxα (4.E51) to (4.E57), not below zero."""
    maths = at.maths
    stiff = (p.rbx1 + p.rbx3 * at.camber * at.camber) * maths.cos(maths.atan(p.rbx2 * kappa)) * p.lxal
    bend = maths.at_most(p.rex1 + p.rex2 * at.dfz, 1.0)
    free = maths.cos(_shape(maths, stiff, p.rcx1, bend, p.rhx1))
    return maths.at_least(maths.cos(_shape(maths, stiff, p.rcx1, bend, slip + p.rhx1)) / free, 0.0)


def _weight_y(p: MagicFormulaParameters, at: OperatingPoint, kappa: Value, slip: Value) -> Value:
    """Gyκ (4.E59) to (4.E65), not below zero."""
    maths = at.maths
    turned = maths.cos(maths.atan(p.rby2 * (slip - p.rby3)))
    stiff = (p.rby1 + p.rby4 * at.camber * at.camber) * turned * p.lyka
    bend = maths.at_most(p.rey1 + p.rey2 * at.dfz, 1.0)
    shift = p.rhy1 + p.rhy2 * at.dfz
    free = maths.cos(_shape(maths, stiff, p.rcy1, bend, shift))
    return maths.at_least(maths.cos(_shape(maths, stiff, p.rcy1, bend, kappa + shift)) / free, 0.0)


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
    """Forces and moments of combined slip in steady state; conventions in the head of the module.

    Floats, arrays that broadcast, or AutoDiffXd.

    Args:
        p: parameters.
        kappa: longitudinal slip [1].
        tan_alpha: tangent of the slip angle [1].
        load: normal load [N]; without any, there is no force.
        vx: longitudinal speed of the contact centre [m/s].
        gamma: inclination angle [rad].
        pressure: inflation pressure [Pa]; that of the parameters if None.
        friction: of the road, relative to that of the tyre's data [1]; taken as 0.001 at least.
    """
    given = 0.0 if pressure is None else pressure
    maths = maths_for(kappa, tan_alpha, load, vx, gamma, given, friction)
    at = operating_point(p, load, gamma, pressure, friction, maths)
    curve = pure_slip(p, at)
    direction = maths.direction(vx, p.vxlow)
    fade = direction * direction

    like_kappa, like_alpha = kappa / at.mu, tan_alpha / at.mu  # on the road of the data, by similarity
    fx = _weight_x(p, at, like_kappa, like_alpha) * _fx0(p, at, curve, kappa, fade)  # (4.E50)
    pure = _fy0(p, at, curve, tan_alpha, fade)
    weight = _weight_y(p, at, like_kappa, like_alpha)
    by_slip = curve.dy * (p.rvy1 + p.rvy2 * at.dfz + p.rvy3 * at.camber) * maths.cos(maths.atan(p.rvy4 * like_alpha))
    shift = by_slip * maths.sin(p.rvy5 * maths.atan(p.rvy6 * like_kappa)) * p.lvyka * fade  # (4.E66), (4.E67)
    fy = weight * pure.force + shift  # (4.E58)

    if p.version == "5.2":
        for_trail = fy - shift
    else:  # (4.E74): without camber, except in the weight
        upright = at._replace(gamma=0.0, camber=0.0)
        for_trail = weight * _fy0(p, upright, pure_slip(p, upright), tan_alpha, fade).force
    mz = _aligning(p, at, curve, pure, kappa, tan_alpha, (fx, fy, for_trail), direction)
    rolling = vx + kappa * abs(vx)  # speed of the tread, (2.5) with (4.E5)
    return TyreForces(
        fx * at.scale,
        fy * at.scale,
        _overturning(p, at, fy) * at.scale,
        _resistance(p, at, fx, vx) * maths.direction(rolling, p.vxlow) * at.scale,
        mz * at.scale,
    )


def _aligning(
    p: MagicFormulaParameters,
    at: OperatingPoint,
    curve: SlipCurve,
    pure: _Lateral,
    kappa: Value,
    slip: Value,
    forces: tuple[Value, Value, Value],
    direction: Value,
) -> Value:
    """Mz of combined slip (4.E71); forces are Fx, Fy and the Fy that acts with the trail."""
    maths, load, dfz, gamma, camber = at.maths, at.load, at.dfz, at.gamma, at.camber
    fx, fy, for_trail = forces
    mu = at.mu * p.lmuy
    radius = p.unloaded_radius
    along = direction / maths.sqrt(1.0 + slip * slip)  # cos α', (4.E6)
    by_kappa = (curve.kxk / curve.kya * kappa) ** 2
    # Trail.
    at_trail = slip + p.qhz1 + p.qhz2 * dfz + (p.qhz3 + p.qhz4 * dfz) * camber  # (4.E34), (4.E35)
    both = maths.sqrt(at_trail * at_trail + by_kappa + 1e-24)  # (4.E77)
    stiff = (p.qbz1 + p.qbz2 * dfz + p.qbz3 * dfz * dfz) * (1.0 + p.qbz4 * gamma + p.qbz5 * abs(gamma))
    stiff = stiff * p.lky / mu  # (A58)
    peak = (p.qdz1 + p.qdz2 * dfz) * (1.0 - p.ppz1 * at.dpi) * (1.0 + p.qdz3 * gamma + p.qdz4 * gamma * gamma)
    peak = peak * load * (radius / (p.lfzo * p.fnomin)) * p.ltr  # (A60)
    bend = (p.qez1 + p.qez2 * dfz + p.qez3 * dfz * dfz) * (
        1.0 + (p.qez4 + p.qez5 * camber) * (2.0 / pi) * maths.atan(stiff * p.qcz1 * at_trail)
    )  # (4.E44)
    trail = peak * maths.cos(_shape(maths, stiff, p.qcz1, maths.at_most(bend, 1.0), both)) * along  # (4.E73)
    # Residual moment.
    at_rest = slip + pure.shift_h + pure.shift_v / curve.kya  # (4.E37), (4.E38)
    both = maths.sqrt(at_rest * at_rest + by_kappa + 1e-24)  # (4.E78)
    stiff = p.qbz9 * p.lky / mu + p.qbz10 * pure.stiff * (p.pcy1 * p.lcy)  # (4.E45)
    lean = (p.qdz8 + p.qdz9 * dfz) * (1.0 + p.ppz2 * at.dpi) + (p.qdz10 + p.qdz11 * dfz) * abs(camber)
    peak = load * radius * ((p.qdz6 + p.qdz7 * dfz) * p.lres + lean * camber * p.lkzc) * mu * along  # (4.E47)
    rest = peak * maths.cos(maths.atan(stiff * both))  # (4.E75)
    arm = radius * (p.ssz1 + p.ssz2 * (fy / p.fnomin) + (p.ssz3 + p.ssz4 * dfz) * gamma) * p.ls  # (A56)
    return -trail * for_trail + rest + arm * fx


def _overturning(p: MagicFormulaParameters, at: OperatingPoint, fy: Value) -> Value:
    """Mx (4.E69), with QSX12 to QSX14 of the MF-Tyre manual."""
    maths, gamma, load = at.maths, at.gamma, at.load / p.fnomin
    side = fy / p.fnomin
    mixed = maths.cos(p.qsx5 * maths.atan((p.qsx6 * load) ** 2))
    mixed = p.qsx4 * mixed * maths.sin(p.qsx7 * gamma + p.qsx8 * maths.atan(p.qsx9 * side))
    lean = p.qsx10 * maths.atan(p.qsx11 * load) * gamma - p.qsx2 * gamma * (1.0 + p.ppmx1 * at.dpi)
    first = at.load * (p.qsx1 * p.lvmx + lean + p.qsx3 * side + mixed)
    second = fy * (p.qsx13 + p.qsx14 * abs(gamma)) - at.load * p.qsx12 * gamma * abs(gamma)
    return p.unloaded_radius * p.lmx * (first + second)


def _resistance(p: MagicFormulaParameters, at: OperatingPoint, fx: Value, vx: Value) -> Value:
    """My of a wheel that rolls ahead: (A48) for 6.1 and 6.2, the MF-Tyre manual for 5.2."""
    speed, load = vx / p.longvl, at.load / p.fnomin
    factor = p.qsy1 + p.qsy2 * (fx / p.fnomin) + p.qsy3 * abs(speed) + p.qsy4 * speed**4
    if p.version == "5.2":
        return -p.unloaded_radius * at.load * p.lmy * factor
    factor = factor + (p.qsy5 + p.qsy6 * load) * at.gamma * at.gamma
    return -p.unloaded_radius * p.fnomin * p.lmy * factor * (load**p.qsy7 * at.pressure**p.qsy8)

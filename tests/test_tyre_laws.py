"""Tyre laws against closed forms, integration along the patch, published values and symmetries."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydrake.autodiffutils import AutoDiffXd

from mirdrake.core.errors import ConfigError
from mirdrake.tyres.brush import BrushTyre, brush_at_load, brush_forces, brush_on
from mirdrake.tyres.magic_formula import TyreForces, magic_formula, relaxation_lengths, slip_curve
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters, Version
from mirdrake.tyres.relaxation import (
    DEFAULTS,
    Contact,
    Deflection,
    Motion,
    RelaxationSettings,
    deflect_across,
    deflect_along,
    deflection_rates,
    low_speed_weight,
    relaxed_slip,
)
from mirdrake.tyres.tir import read_tir

CAR = read_tir(Path(__file__).resolve().parent.parent / "models" / "tyres" / "215_50R17.tir").parameters

# H. B. Pacejka, Tyre and Vehicle Dynamics, 2nd ed. (2006), table A3.1: 205/60R15 91V, 2.2 bar, ISO signs.
BOOK = MagicFormulaParameters(
    fnomin=4000.0, unloaded_radius=0.313, longvl=16.67, nompres=220000.0,
    pcx1=1.685, pdx1=1.210, pdx2=-0.037, pex1=0.344, pex2=0.095, pex3=-0.020, pkx1=21.51, pkx2=-0.163, pkx3=0.245,
    phx1=-0.002, phx2=0.002, rbx1=12.35, rbx2=-10.77, rcx1=1.092, rhx1=0.007,
    pcy1=1.193, pdy1=-0.990, pdy2=0.145, pdy3=-11.23, pey1=-1.003, pey2=-0.537, pey3=-0.083, pey4=-4.787,
    pky1=-14.95, pky2=2.130, pky3=-0.028, pky6=-0.92, pky7=-0.24, phy1=0.003, phy2=-0.001,
    pvy1=0.045, pvy2=-0.024, pvy3=-0.532, pvy4=0.039, rby1=6.461, rby2=4.196, rby3=-0.015, rcy1=1.081, rhy1=0.009,
    rvy1=0.053, rvy2=-0.073, rvy3=0.517, rvy4=35.44, rvy5=1.9, rvy6=-10.71,
    qbz1=8.964, qbz2=-1.106, qbz3=-0.842, qbz5=-0.227, qbz9=18.47, qcz1=1.180, qdz1=0.100, qdz2=-0.001,
    qdz3=0.007, qdz4=13.05, qdz6=-0.008, qdz8=-0.296, qdz9=-0.009, qez1=-1.609, qez2=-0.359, qez4=0.174, qez5=-0.896,
    qhz1=0.007, qhz2=-0.002, qhz3=0.147, qhz4=0.004, ssz1=0.043, ssz2=0.001, ssz3=0.731, ssz4=-0.238, qsy1=0.01,
)  # fmt: skip

# Every term is in it: pressure, camber, load, 6.1.
FULL = replace(
    BOOK, inflpres=200000.0, lmux=0.95, lmuy=0.97, pex4=0.05, pdx3=0.3, pvx1=0.001, ppx1=-0.3, ppx2=0.4, ppx3=-0.1,
    ppx4=0.06, rbx3=0.5, rex1=-0.4, rex2=-0.4, pey5=0.4, pky5=0.3, ppy1=-0.6, ppy2=-0.06, ppy3=-0.16, ppy4=0.28,
    ppy5=0.4, rby4=0.3, rey1=0.3, rey2=-0.2, rhy2=0.002, qbz4=0.1, qbz10=0.2, qdz7=0.001, qdz10=-0.2, qdz11=0.1,
    qez3=0.1, ppz1=-0.4, ppz2=0.2, qsx1=-0.008, qsx2=0.9, qsx3=0.02, qsx4=0.12, qsx5=1.0, qsx6=2.0, qsx7=0.3,
    qsx8=-0.04, qsx9=0.6, qsx10=0.14, qsx11=0.35, qsx12=0.9, qsx13=0.06, qsx14=0.3, ppmx1=0.8, qsy2=0.02, qsy3=0.0009,
    qsy4=8e-5, qsy5=0.05, qsy6=0.02, qsy7=0.9, qsy8=-0.4, lfzo=1.05,
)  # fmt: skip

BRUSH = BrushTyre(
    nominal_load=4000.0,
    longitudinal_stiffness=88000.0,
    cornering_stiffness=54000.0,
    friction=1.0,
    friction_by_load=-0.15,
    peak_load=8000.0,
    half_length=0.075,
)

KAPPA = st.floats(-1.5, 1.5)
TAN = st.floats(-2.0, 2.0)
LOAD = st.floats(0.0, 12000.0, allow_subnormal=False)  # forces of subnormal loads are rounded to zero
MU = st.floats(0.05, 1.2)
SPEED = st.floats(-60.0, 60.0)


# --- brush -------------------------------------------------------------------------------------------------------


def integrated(tyre: BrushTyre, kappa: float, tan_alpha: float, load: float) -> tuple[float, float, float]:
    """Fx, Fy, Mz of bristles that adhere up to the friction limit, summed over the patch."""
    loaded = brush_at_load(tyre, load)
    a, count = loaded.half_length, 200_000
    behind = (np.arange(count) + 0.5) * 2.0 * a / count  # way from the leading edge
    sx, sy = kappa / (1.0 + kappa), tan_alpha / (1.0 + kappa)
    qx, qy = loaded.longitudinal * sx / (2.0 * a * a) * behind, loaded.cornering * sy / (2.0 * a * a) * behind
    most = 0.75 * loaded.limit / a * (1.0 - ((behind - a) / a) ** 2)
    slides = np.hypot(qx, qy) > most
    slip = math.hypot(sx, sy)
    qx, qy = np.where(slides, most * sx / slip, qx), np.where(slides, most * sy / slip, qy)
    width = 2.0 * a / count
    return float(qx.sum() * width), float(-qy.sum() * width), float((-qy * (a - behind)).sum() * width)


@pytest.mark.parametrize(
    ("kappa", "tan_alpha"), [(0.0, 0.05), (0.03, 0.0), (0.02, 0.03), (-0.06, 0.02), (0.05, -0.1), (-0.5, 0.3)]
)
@pytest.mark.parametrize("load", [1000.0, 4000.0, 7000.0])
def test_brush_equals_the_sum_over_its_bristles(kappa: float, tan_alpha: float, load: float) -> None:
    forces = brush_forces(BRUSH, kappa, tan_alpha, load)
    assert forces == pytest.approx(integrated(BRUSH, kappa, tan_alpha, load), rel=1e-6, abs=1e-6 * load)


def test_brush_of_pure_side_slip_is_fiala() -> None:
    """E. Fiala: F = C s - C² |s| s / (3 μ N) + C³ s³ / (27 μ² N²), and the trail a / 3 at zero slip."""
    for slip in (-0.2, -0.05, 0.001, 0.05, 0.2):
        c, most = 54000.0, 4000.0
        fiala = c * slip - c**2 * abs(slip) * slip / (3.0 * most) + c**3 * slip**3 / (27.0 * most**2)
        assert brush_forces(BRUSH, 0.0, slip, 4000.0).fy == pytest.approx(-fiala, rel=1e-9)
    small = brush_forces(BRUSH, 0.0, 1e-6, 4000.0)
    assert small.mz / -small.fy == pytest.approx(0.075 / 3.0, rel=1e-4)


def test_brush_limits_slope_at_zero_and_sliding_at_friction() -> None:
    assert brush_forces(BRUSH, 1e-7, 0.0, 4000.0).fx == pytest.approx(88000e-7, rel=1e-5)
    assert brush_forces(BRUSH, 0.0, 1e-7, 4000.0).fy == pytest.approx(-54000e-7, rel=1e-5)
    # Locked at a slip angle: μ N against the velocity, without moment.
    forces = brush_forces(BRUSH, -1.0, 0.5, 4000.0)
    assert forces.fx == pytest.approx(-4000.0 / math.hypot(1.0, 0.5))
    assert forces.fy == pytest.approx(-4000.0 * 0.5 / math.hypot(1.0, 0.5))
    assert forces.mz == 0.0


def test_brush_parameters_follow_the_load() -> None:
    loaded = brush_at_load(BRUSH, 8000.0)
    assert loaded.cornering == pytest.approx(54000.0 / math.sin(2.0 * math.atan(0.5)))  # largest at peak_load
    assert loaded.longitudinal == pytest.approx(2.0 * 88000.0)
    assert loaded.limit == pytest.approx(8000.0 * (1.0 - 0.15))
    assert loaded.half_length == pytest.approx(0.075 * math.sqrt(2.0))
    assert brush_at_load(BRUSH, 9000.0).cornering < loaded.cornering > brush_at_load(BRUSH, 7000.0).cornering
    assert brush_at_load(BRUSH, 4000.0, friction=0.3).limit == pytest.approx(1200.0)


@pytest.mark.parametrize("load", [2000.0, 4000.0])
def test_camber_of_a_brush_tyre_is_a_parabolic_deflection_of_its_bristles(load: float) -> None:
    tyre = replace(BRUSH, camber_stiffness=4500.0)
    gamma, slip = 0.002, 0.001  # all bristles stick: the largest deflection is far below the friction
    loaded = brush_at_load(tyre, load, inclination=gamma)
    fx, fy, mz = brush_on(loaded, 0.0, slip, 20.0)
    # Force per length: Cy slip / (2 a²) times the way from the leading edge, and a parabola with the force Cγ γ.
    a, count = loaded.half_length, 20_000
    behind = (np.arange(count) + 0.5) * 2.0 * a / count
    parabola = 0.75 * 4500.0 * load / 4000.0 * gamma / a * (1.0 - ((behind - a) / a) ** 2)
    force = loaded.cornering * slip / (2.0 * a * a) * behind + parabola
    width = 2.0 * a / count
    assert fx == 0.0
    assert fy == pytest.approx(-force.sum() * width, rel=0.02)
    assert mz == pytest.approx((-force * (a - behind)).sum() * width, rel=0.04)
    # The sides are mirror images; camber never exceeds friction, and fades at standstill.
    assert brush_on(brush_at_load(tyre, load, inclination=-gamma), 0.0, -slip, 20.0) == pytest.approx((0.0, -fy, -mz))
    steep = brush_on(brush_at_load(tyre, load, inclination=1.2), 0.0, 0.3, 20.0)
    assert -steep[1] == pytest.approx(loaded.limit)
    assert brush_on(loaded, 0.0, 0.0, 0.0)[1] == 0.0


@given(KAPPA, TAN, LOAD, MU)
def test_brush_never_exceeds_friction_and_is_symmetric(kappa: float, tan_alpha: float, load: float, mu: float) -> None:
    forces = brush_forces(BRUSH, kappa, tan_alpha, load, friction=mu)
    limit = brush_at_load(BRUSH, load, friction=mu).limit
    assert math.hypot(forces.fx, forces.fy) <= limit * (1.0 + 1e-9) + 1e-9
    mirrored = brush_forces(BRUSH, kappa, -tan_alpha, load, friction=mu)
    assert (mirrored.fx, mirrored.fy, mirrored.mz) == (forces.fx, -forces.fy, -forces.mz)
    # Friction takes power, never gives it: F · (slip velocity) <= 0 with (-kappa, tan alpha).
    assert -kappa * forces.fx + tan_alpha * forces.fy <= 1e-9


@given(st.floats(0.0, 0.5), st.floats(0.0, 0.5), st.floats(100.0, 9000.0))
def test_brush_force_grows_with_slip(slip_a: float, slip_b: float, load: float) -> None:
    low, high = sorted((slip_a, slip_b))
    assert brush_forces(BRUSH, 0.0, high, load).fy <= brush_forces(BRUSH, 0.0, low, load).fy + 1e-9
    assert brush_forces(BRUSH, high, 0.0, load).fx >= brush_forces(BRUSH, low, 0.0, load).fx - 1e-9


def test_brush_rejects_invalid_parameters() -> None:
    with pytest.raises(ConfigError, match="BrushTyre: friction must be > 0 and finite, got 0"):
        replace(BRUSH, friction=0.0)
    with pytest.raises(ConfigError, match="BrushTyre: half_length must be > 0 and finite, got nan"):
        replace(BRUSH, half_length=math.nan)


# --- Magic Formula -----------------------------------------------------------------------------------------------

# kappa, alpha [rad], load, Fx, Fy, Mz of table A3.1 at 16.67 m/s without camber: values of an independent transcription
# of the book's second edition, published with the tests of the open-source library MiniEngine (me::tyre). It has
# cos α' = Vx / (V + 0.1 m/s).
PUBLISHED = [
    (-0.5, 0.0, 2000.0, -1986.1194085661953, -88.25461910604399, -27.07868352989113),
    (0.05, 0.0, 2000.0, 1543.8019246602173, 172.27695673672477, 17.587996260837457),
    (0.0, -0.2617993877991494, 2000.0, -21.05363784744802, 2238.9944928922255, -1.5698088558476873),
    (0.0, 0.008726646259971648, 2000.0, -112.52805437941703, -209.6934420968626, -3.21510609484087),
    (-0.1, 0.0, 4000.0, -4681.078533444123, -174.51678517797131, -65.85290785141677),
    (0.0, 0.0, 4000.0, -172.00946110146887, 41.99718332234983, -13.573589310153654),
    (1.0, 0.0, 4000.0, 3193.9197411244863, 70.38087199204708, 42.728813087217645),
    (0.0, 0.10471975511965978, 4000.0, -88.61698738891505, -3346.4349571737075, 39.682185638630685),
    (-0.02, 0.0, 6000.0, -2881.740919765317, 21.745716094432417, -51.90718407848796),
    (0.3, 0.0, 6000.0, 6336.258084037392, 81.64060876908262, 84.47780333816699),
    (0.0, -0.10471975511965978, 6000.0, -83.4902881081162, 4751.3902844544045, -136.99200734264997),
    (0.05, 0.03490658503988659, 4000.0, 3026.296411329449, -1291.3060220469745, 57.64499334529745),
    (-0.1, 0.06981317007977318, 4000.0, -3799.446092908455, -2385.4748885373065, -46.947824740532766),
    (-0.3, -0.13962634015954636, 4000.0, -3852.5413913017182, 1712.9103114386708, -44.10867792328077),
    (0.2, -0.20943951023931956, 4000.0, 2970.4907661809034, 2684.4585867385267, 49.3506641569585),
]


@pytest.mark.parametrize(("kappa", "alpha", "load", "fx", "fy", "mz"), PUBLISHED)
def test_magic_formula_equals_published_values(
    kappa: float, alpha: float, load: float, fx: float, fy: float, mz: float
) -> None:
    ours = magic_formula(BOOK, kappa, math.tan(alpha), load, vx=16.67)
    assert ours.fx == pytest.approx(fx, rel=1e-8, abs=1e-6)
    assert ours.fy == pytest.approx(fy, rel=1e-8, abs=1e-6)
    # The arm of Fx apart, theirs has the factor V / (V + 0.1).
    speed = 16.67 / math.cos(alpha)
    arm = 0.313 * (0.043 + 0.001 * fy / 4000.0)
    assert (ours.mz - arm * fx) * speed / (speed + 0.1) + arm * fx == pytest.approx(mz, rel=1e-7, abs=1e-6)


# The same tyre by teasit/magic-formula-tyre-library @ e9f0354, as published in KMoula30/outlap (golden values). It
# takes the angle, not its tangent, for Fy, and adds 0.1 N in the denominator of By.
def test_magic_formula_equals_a_second_library() -> None:
    camber = 0.06981317008
    assert magic_formula(BOOK, 0.0, 0.21, 8000.0, vx=16.67, gamma=camber).fy == pytest.approx(-7187.058678, rel=1e-9)
    for kappa, alpha, fx in ((-0.25, -0.17, -3563.509474), (0.05, 0.102, 1966.664759), (-0.1, -0.034, -4552.06983)):
        ours = magic_formula(BOOK, kappa, math.tan(alpha), 4000.0, vx=16.67, gamma=-camber)
        assert ours.fx == pytest.approx(fx, rel=1e-9)
        assert ours.my == pytest.approx(-12.52 * 1.0)


def test_magic_formula_equals_commonroad() -> None:
    """The tyre of commonroad-vehicle-models (PAC2002, no load dependence), if it is installed."""
    tire_model = pytest.importorskip("vehiclemodels.utils.tire_model")

    class Theirs:
        p_cx1, p_dx1, p_dx3, p_ex1, p_kx1, p_hx1, p_vx1 = 1.6411, 1.1739, 0.0, 0.46403, 22.303, 0.0012297, 0.0
        r_bx1, r_bx2, r_cx1, r_ex1, r_hx1 = 13.276, -13.778, 1.2568, 0.65225, 0.0050722
        p_cy1, p_dy1, p_dy3, p_ey1, p_ky1, p_hy1, p_hy3 = 1.3507, 1.0489, -2.8821, -0.0074722, -21.92, 0.0, 0.0
        p_vy1, p_vy3 = 0.0, 0.0
        r_by1, r_by2, r_by3, r_cy1, r_ey1, r_hy1 = 7.1433, 9.1916, -0.027856, 1.0719, -0.27572, 5.7448e-06
        r_vy1, r_vy3, r_vy4, r_vy5, r_vy6 = -0.027825, -0.27568, 12.12, 1.9, -10.704

    wide = 1e7  # stiffness in proportion to the load
    ours = MagicFormulaParameters(
        fnomin=4000.0, unloaded_radius=0.3, pcx1=1.6411, pdx1=1.1739, pex1=0.46403, pkx1=22.303, phx1=0.0012297,
        rbx1=13.276, rbx2=-13.778, rcx1=1.2568, rex1=0.65225, rhx1=0.0050722, pcy1=1.3507, pdy1=-1.0489,
        pey1=-0.0074722, pky1=-21.92 * wide, pky2=wide, pky4=1.0, rby1=7.1433, rby2=9.1916, rby3=-0.027856,
        rcy1=1.0719, rey1=-0.27572, rhy1=5.7448e-06, rvy1=-0.027825, rvy4=12.12, rvy5=1.9, rvy6=-10.704,
    )  # fmt: skip
    for kappa, slip, load in ((0.03, 0.05, 3000.0), (-0.2, 0.1, 5000.0), (0.1, -0.02, 4000.0), (0.0, 0.2, 6000.0)):
        fx0 = tire_model.formula_longitudinal(-kappa, 0.0, load, Theirs)
        fy0, mu = tire_model.formula_lateral(slip, 0.0, load, Theirs)
        fx = tire_model.formula_longitudinal_comb(kappa, slip, fx0, Theirs)
        fy = tire_model.formula_lateral_comb(kappa, slip, 0.0, -mu, load, fy0, Theirs)
        forces = magic_formula(ours, kappa, slip, load, vx=20.0)
        assert (forces.fx, forces.fy) == pytest.approx((fx, fy), rel=1e-9)


def written_again(p: MagicFormulaParameters, k: float, t: float, n: float, g: float, v: float) -> list[float]:
    """Return forces by an independent implementation in the order of the manual, forwards, above the low speed.

    MF 6.1, and where its own manual differs MF 5.2. Rolling resistance is against the spin of the tread, also where
    the wheel is locked or turns backwards.
    """
    old = p.version == "5.2"
    sin, cos, atan = math.sin, math.cos, math.atan

    def mf(b: float, c: float, e: float, x: float) -> float:
        return c * atan(b * x - min(e, 1.0) * (b * x - atan(b * x)))

    def sg(x: float) -> int:
        return 1 if x >= 0 else -1

    f0 = p.fnomin * p.lfzo
    d, q, s = (n - f0) / f0, (p.inflpres - p.nompres) / p.nompres, sin(g)
    mux = (p.pdx1 + p.pdx2 * d) * (1 + p.ppx3 * q + p.ppx4 * q**2) * (1 - p.pdx3 * g**2) * p.lmux
    kxk = n * (p.pkx1 + p.pkx2 * d) * math.exp(p.pkx3 * d) * (1 + p.ppx1 * q + p.ppx2 * q**2) * p.lkx
    kx = k + (p.phx1 + p.phx2 * d) * p.lhx
    ex = (p.pex1 + p.pex2 * d + p.pex3 * d**2) * (1 - p.pex4 * sg(kx)) * p.lex
    fx0 = mux * n * sin(mf(kxk / (p.pcx1 * mux * n), p.pcx1, ex, kx)) + n * (p.pvx1 + p.pvx2 * d) * p.lvx * p.lmux
    bxa, exa = (p.rbx1 + p.rbx3 * s**2) * cos(atan(p.rbx2 * k)) * p.lxal, p.rex1 + p.rex2 * d
    fx = fx0 * max(0.0, cos(mf(bxa, p.rcx1, exa, t + p.rhx1)) / cos(mf(bxa, p.rcx1, exa, p.rhx1)))

    def lateral(s: float) -> tuple[float, float, float, float, float, float]:
        muy = (p.pdy1 + p.pdy2 * d) * (1 + p.ppy3 * q + p.ppy4 * q**2) * (1 - p.pdy3 * s**2) * p.lmuy
        kya = p.pky1 * f0 * (1 + p.ppy1 * q) * (1 - p.pky3 * abs(s)) * p.lky
        kya *= sin(p.pky4 * atan(n / f0 / ((p.pky2 + p.pky5 * s**2) * (1 + p.ppy2 * q))))
        svg = n * (p.pvy3 + p.pvy4 * d) * s * p.lkyc * p.lmuy
        kyg = n * (p.pky6 + p.pky7 * d) * (1 + p.ppy5 * q) * p.lkyc
        sh = (p.phy1 + p.phy2 * d) * p.lhy + (p.phy3 * s * p.lkyc if old else (kyg * s - svg) / kya)
        sv = n * (p.pvy1 + p.pvy2 * d) * p.lvy * p.lmuy + svg
        ey = (p.pey1 + p.pey2 * d) * (1 + p.pey5 * s**2 - (p.pey3 + p.pey4 * s) * sg(t + sh)) * p.ley
        by = kya / (p.pcy1 * muy * n)
        return muy * n * sin(mf(by, p.pcy1, ey, t + sh)) + sv, muy, kya, sh, sv, by

    fy0, muy, kya, sh, sv, by = lateral(s)
    byk = (p.rby1 + p.rby4 * s**2) * cos(atan(p.rby2 * (t - p.rby3))) * p.lyka
    eyk, shk = p.rey1 + p.rey2 * d, p.rhy1 + p.rhy2 * d
    gyk = max(0.0, cos(mf(byk, p.rcy1, eyk, k + shk)) / cos(mf(byk, p.rcy1, eyk, shk)))
    dvk = muy * n * (p.rvy1 + p.rvy2 * d + p.rvy3 * s) * cos(atan(p.rvy4 * t))
    svk = dvk * sin(p.rvy5 * atan(p.rvy6 * k)) * p.lvyka
    fy = gyk * fy0 + svk

    r, f1, cosa = p.unloaded_radius, p.fnomin, 1 / math.hypot(1, t)
    att = t + p.qhz1 + p.qhz2 * d + (p.qhz3 + p.qhz4 * d) * s
    bt = (p.qbz1 + p.qbz2 * d + p.qbz3 * d**2) * (1 + p.qbz4 * g + p.qbz5 * abs(g)) * p.lky / p.lmuy
    dt = n * r / f0 * (p.qdz1 + p.qdz2 * d) * (1 - p.ppz1 * q) * (1 + p.qdz3 * g + p.qdz4 * g**2) * p.ltr
    et = (p.qez1 + p.qez2 * d + p.qez3 * d**2) * (1 + (p.qez4 + p.qez5 * s) * 2 / math.pi * atan(bt * p.qcz1 * att))
    trail = dt * cos(mf(bt, p.qcz1, et, math.hypot(att, kxk / kya * k))) * cosa
    br = p.qbz9 * p.lky / p.lmuy + p.qbz10 * by * p.pcy1
    dr = (p.qdz6 + p.qdz7 * d) * p.lres + ((p.qdz8 + p.qdz9 * d) * (1 + p.ppz2 * q)) * s * p.lkzc
    dr = n * r * (dr + (p.qdz10 + p.qdz11 * d) * abs(s) * s * p.lkzc) * p.lmuy * cosa
    rest = dr * cos(atan(br * math.hypot(t + sh + sv / kya, kxk / kya * k)))
    arm = r * (p.ssz1 + p.ssz2 * fy / f1 + (p.ssz3 + p.ssz4 * d) * g) * p.ls
    mz = -trail * (fy - svk if old else gyk * lateral(0.0)[0]) + rest + arm * fx

    mx = p.qsx1 * p.lvmx - p.qsx2 * g * (1 + p.ppmx1 * q) + p.qsx3 * fy / f1
    mx += p.qsx4 * cos(p.qsx5 * atan((p.qsx6 * n / f1) ** 2)) * sin(p.qsx7 * g + p.qsx8 * atan(p.qsx9 * fy / f1))
    mx += p.qsx10 * atan(p.qsx11 * n / f1) * g - p.qsx12 * g * abs(g)
    mx = r * p.lmx * (n * mx + fy * (p.qsx13 + p.qsx14 * abs(g)))
    my = p.qsy1 + p.qsy2 * fx / f1 + p.qsy3 * abs(v / p.longvl) + p.qsy4 * (v / p.longvl) ** 4
    my += 0.0 if old else (p.qsy5 + p.qsy6 * n / f1) * g**2
    my *= -r * n * p.lmy if old else -r * f1 * p.lmy * (n / f1) ** p.qsy7 * (p.inflpres / p.nompres) ** p.qsy8
    my *= sin(0.5 * math.pi * max(-1.0, min(1.0, v * (1 + k) / p.vxlow)))
    return [fx, fy, mx, my, mz]


@pytest.mark.parametrize("version", ["5.2", "6.1", "6.2"])
@settings(max_examples=100)
@given(st.floats(-2.5, 2.5), st.floats(-1.0, 1.0), st.floats(100.0, 9000.0), st.floats(-0.2, 0.2), st.floats(1.0, 60.0))
@example(kappa=-1.0, slip=0.3, load=4000.0, gamma=0.1, vx=20.0)
@example(kappa=-0.8000000000000009, slip=0.0, load=100.0, gamma=0.0, vx=5.0)
def test_magic_formula_equals_a_second_writing(
    version: Version, kappa: float, slip: float, load: float, gamma: float, vx: float
) -> None:
    """Rolling, spinning, locked at -1 and, below, turning backwards on a car that goes ahead."""
    tyre = replace(FULL, version=version, phy3=0.04)
    ours = magic_formula(tyre, kappa, slip, load, vx=vx, gamma=gamma)
    assert list(ours) == pytest.approx(written_again(tyre, kappa, slip, load, gamma, vx), rel=1e-9, abs=1e-9 * load)


@settings(max_examples=300)
@given(st.floats(-10.0, 10.0), TAN, st.floats(0.01, 60.0))
@example(kappa=-1.5, slip=0.05, vx=20.0)  # turns backwards: the cosine of the weight of Fy is negative there
@example(kappa=2.0, slip=-0.05, vx=0.5)  # spins at the start
def test_no_slip_and_no_spin_gives_power_to_the_car(kappa: float, slip: float, vx: float) -> None:
    """Each force is against its own slip, and rolling resistance against the spin of the tread, vx (1 + kappa)."""
    for direction in (1.0, -1.0):
        forces = magic_formula(CAR, kappa, slip, 4000.0, vx=direction * vx)
        assert forces.fx * kappa >= 0.0
        assert forces.fy * slip <= 0.0
        assert forces.my * (direction * vx + kappa * vx) <= 0.0


def test_version_5_2_differs_where_its_manual_does() -> None:
    """SHy by PHY3, the trail with all of Fy less SVyk, rolling resistance in proportion to the load."""
    old = replace(BOOK, version="5.2", pky6=0.0, pky7=0.0, phy3=0.05, qsy7=1.0)
    new = replace(BOOK, pky6=0.0, pky7=0.0)
    for_shift = 0.05 * math.sin(0.03)  # with PVY3 and PVY4 away, SHy differs by PHY3 gamma alone
    plain = {"pvy3": 0.0, "pvy4": 0.0}
    left = magic_formula(replace(old, **plain), 0.0, 0.02, 3000.0, vx=20.0, gamma=0.03).fy  # type: ignore[arg-type]
    right = magic_formula(replace(new, **plain), 0.0, 0.02 + for_shift, 3000.0, vx=20.0, gamma=0.03).fy  # type: ignore[arg-type]
    assert left == pytest.approx(right, rel=1e-12)
    assert magic_formula(old, 0.0, 0.0, 2000.0, vx=20.0).my == pytest.approx(-0.313 * 2000.0 * 0.01)
    # Without camber and kappa both trails act on the same force.
    assert magic_formula(old, 0.0, 0.05, 4000.0, vx=20.0).mz == pytest.approx(
        magic_formula(new, 0.0, 0.05, 4000.0, vx=20.0).mz
    )


@pytest.mark.parametrize("load", [1000.0, 4000.0, 8000.0])
def test_slope_and_peak_are_those_of_the_curve(load: float) -> None:
    curve, step = slip_curve(CAR, load), 1e-6
    up, down = magic_formula(CAR, step, 0.0, load, vx=20.0), magic_formula(CAR, -step, 0.0, load, vx=20.0)
    assert (up.fx - down.fx) / (2.0 * step) == pytest.approx(curve.kxk, rel=1e-6)
    up, down = magic_formula(CAR, 0.0, step, load, vx=20.0), magic_formula(CAR, 0.0, -step, load, vx=20.0)
    assert (up.fy - down.fy) / (2.0 * step) == pytest.approx(curve.kya, rel=1e-6)
    slips = np.linspace(0.0, 2.0, 4001)
    assert magic_formula(CAR, slips, 0.0, load, vx=20.0).fx.max() == pytest.approx(curve.dx, rel=1e-5)
    assert magic_formula(CAR, 0.0, slips, load, vx=20.0).fy.min() == pytest.approx(curve.dy, rel=1e-5)


def test_more_load_gives_more_force_but_less_per_load() -> None:
    loads = np.linspace(500.0, 9000.0, 18)
    curve = slip_curve(CAR, loads)
    assert (np.diff(curve.dx) > 0.0).all()
    assert (np.diff(-curve.dy) > 0.0).all()
    assert (np.diff(curve.dx / loads) < 0.0).all()
    assert (np.diff(-curve.dy / loads) < 0.0).all()
    assert (np.diff(-curve.kya / loads) < 0.0).all()
    assert slip_curve(CAR, 4000.0).dx == pytest.approx(1.10 * 4000.0)
    assert slip_curve(CAR, 4000.0).dy == pytest.approx(-0.95 * 4000.0)


@given(st.floats(0.0, 0.05), st.floats(0.0, 0.05), st.floats(300.0, 9000.0))
def test_force_grows_with_slip_up_to_the_peak(slip_a: float, slip_b: float, load: float) -> None:
    low, high = sorted((slip_a, slip_b))
    assert magic_formula(CAR, 0.0, high, load, vx=20.0).fy <= magic_formula(CAR, 0.0, low, load, vx=20.0).fy + 1e-9
    assert magic_formula(CAR, high, 0.0, load, vx=20.0).fx >= magic_formula(CAR, low, 0.0, load, vx=20.0).fx - 1e-9


@settings(max_examples=300)
@given(KAPPA, TAN, LOAD, MU, SPEED)
def test_the_car_tyre_never_leaves_its_friction_ellipse(
    kappa: float, slip: float, load: float, mu: float, vx: float
) -> None:
    forces = magic_formula(CAR, kappa, slip, load, vx=vx, friction=mu)
    curve = slip_curve(CAR, load, friction=mu)
    if load == 0.0:
        assert all(value == 0.0 for value in forces)
    else:
        assert math.hypot(forces.fx / curve.dx, forces.fy / curve.dy) <= 1.0 + 1e-6
    assert abs(forces.my) <= 0.0073 * 0.3234 * load * 1.0001


def test_the_ellipse_at_a_fine_grid() -> None:
    kappa, slip = np.linspace(-1.0, 1.0, 401)[:, None], np.linspace(-1.0, 1.0, 401)[None, :]
    for load in (300.0, 1000.0, 4000.0, 8000.0):
        forces, curve = magic_formula(CAR, kappa, slip, load, vx=20.0), slip_curve(CAR, load)
        assert np.hypot(forces.fx / curve.dx, forces.fy / curve.dy).max() == pytest.approx(1.0, abs=1e-4)


@given(KAPPA, TAN, LOAD, st.floats(-0.1, 0.1), SPEED)
def test_the_car_tyre_is_symmetric_to_both_sides_and_in_both_directions(
    kappa: float, slip: float, load: float, gamma: float, vx: float
) -> None:
    forces = magic_formula(CAR, kappa, slip, load, vx=vx, gamma=gamma)
    mirrored = magic_formula(CAR, kappa, -slip, load, vx=vx, gamma=-gamma)
    assert list(mirrored) == pytest.approx(
        [forces.fx, -forces.fy, -forces.mx, forces.my, -forces.mz], rel=1e-9, abs=1e-6
    )
    # Turned by half a turn about z: x and y change their signs, also of moments.
    turned = magic_formula(CAR, -kappa, -slip, load, vx=-vx, gamma=-gamma)
    assert list(turned) == pytest.approx(
        [-forces.fx, -forces.fy, -forces.mx, -forces.my, forces.mz], rel=1e-9, abs=1e-6
    )


@pytest.mark.parametrize("tyre", [CAR, BOOK, FULL])
def test_forces_are_continuous_at_zero_speed(tyre: MagicFormulaParameters) -> None:
    speeds = np.linspace(-2.0, 2.0, 4001)
    forces = magic_formula(tyre, 0.02, 0.03, 4000.0, vx=speeds, gamma=0.02)
    for values in forces:
        steps = np.abs(np.diff(values))
        assert steps.max() <= 0.005 * max(np.ptp(values), 1e-9) + 1e-9
    still = magic_formula(tyre, 0.0, 0.0, 4000.0, vx=0.0)
    assert list(still)[:2] == [0.0, 0.0]  # shifts do not push a parked car
    assert still.my == 0.0
    below, above = (magic_formula(tyre, 0.02, 0.03, 4000.0, vx=vx) for vx in (1.0 - 1e-9, 1.0 + 1e-9))
    assert list(below) == pytest.approx(list(above), rel=1e-7)


def test_rolling_resistance_follows_the_spin() -> None:
    ahead = magic_formula(CAR, 0.0, 0.0, 4000.0, vx=10.0).my
    assert ahead == pytest.approx(-0.0073 * 0.3234 * 4000.0)
    assert magic_formula(CAR, 0.0, 0.0, 4000.0, vx=-10.0).my == pytest.approx(-ahead)
    assert magic_formula(CAR, -1.0, 0.0, 4000.0, vx=10.0).my == 0.0  # locked
    assert magic_formula(CAR, -1.5, 0.0, 4000.0, vx=10.0).my == pytest.approx(-ahead)  # turns backwards
    half = magic_formula(CAR, -0.95, 0.0, 4000.0, vx=10.0).my  # tread of 0.5 m/s, half of vxlow
    assert half == pytest.approx(ahead * math.sin(math.pi / 4.0))


@given(st.floats(1e-3, 300.0))
def test_below_the_range_of_loads_forces_go_in_proportion(load: float) -> None:
    if load < CAR.fzmin:
        forces, whole = (magic_formula(CAR, 0.05, 0.05, n, vx=20.0) for n in (load, CAR.fzmin))
        assert list(forces) == pytest.approx([value * load / CAR.fzmin for value in whole], rel=1e-9)
    assert magic_formula(CAR, 0.05, 0.05, -load, vx=20.0) == TyreForces(0.0, 0.0, 0.0, 0.0, 0.0)


def test_friction_of_the_road_scales_the_peaks_and_leaves_the_stiffness() -> None:
    dry, ice = slip_curve(CAR, 4000.0), slip_curve(CAR, 4000.0, friction=0.1)
    assert (ice.dx, ice.dy) == pytest.approx((0.1 * dry.dx, 0.1 * dry.dy))
    assert (ice.kxk, ice.kya) == (dry.kxk, dry.kya)
    assert magic_formula(CAR, 0.0, 0.3, 4000.0, vx=20.0, friction=0.1).fy == pytest.approx(0.1 * dry.dy, rel=0.25)


def test_relaxation_lengths_are_slip_stiffness_by_stiffness() -> None:
    assert relaxation_lengths(CAR, 4000.0) == pytest.approx((88000.0 / 400000.0, 54400.0 / 140000.0))
    assert relaxation_lengths(BOOK, 4000.0) == (0.313, 0.313)  # nothing is known
    old = replace(BOOK, version="5.2", ptx1=2.0, ptx2=0.5, pty1=2.1, pty2=2.0)
    assert relaxation_lengths(old, 4000.0) == pytest.approx((2.0 * 0.313, 2.1 * 0.8 * 0.313))


# --- floats, arrays, derivatives ---------------------------------------------------------------------------------


def test_arrays_give_the_results_of_floats() -> None:
    kappa, slip = np.array([-0.3, 0.0, 0.02, 0.5]), np.array([0.1, 0.02, -0.3, 0.0])
    load, vx = np.array([0.0, 150.0, 4000.0, 12000.0]), np.array([20.0, 0.3, -0.5, -20.0])
    many = magic_formula(FULL, kappa, slip, load, vx=vx, gamma=0.03)
    brushes = brush_forces(BRUSH, kappa, slip, load)
    for i in range(4):
        numbers = float(kappa[i]), float(slip[i]), float(load[i])
        forces = magic_formula(FULL, *numbers, vx=float(vx[i]), gamma=0.03)
        assert [values[i] for values in many] == pytest.approx(list(forces), rel=1e-12, abs=1e-12)
        assert [values[i] for values in brushes] == pytest.approx(list(brush_forces(BRUSH, *numbers)), rel=1e-12)


@pytest.mark.parametrize(
    ("kappa", "slip", "vx"), [(0.02, 0.03, 20.0), (0.0, 0.0, 20.0), (-0.3, 0.2, 0.4), (1.6, 0.05, 20.0)]
)
def test_derivatives_are_those_of_differences(kappa: float, slip: float, vx: float) -> None:
    step = 1e-6
    gradients = np.eye(3)
    numbers = [AutoDiffXd(v, g) for v, g in zip((kappa, slip, 4000.0), gradients, strict=True)]

    def both(k: object, t: object, n: object) -> list[object]:
        return [*magic_formula(CAR, k, t, n, vx=vx), *brush_forces(BRUSH, k, t, n)]

    exact = both(*numbers)
    for axis, size in enumerate((step, step, 1.0)):
        moved = [[v + sign * size * (i == axis) for i, v in enumerate((kappa, slip, 4000.0))] for sign in (1, -1)]
        up, down = (both(*point) for point in moved)
        for value, high, low in zip(exact, up, down, strict=True):
            slope = (high - low) / (2.0 * size)  # type: ignore[operator]
            assert value.derivatives()[axis] == pytest.approx(slope, rel=1e-4, abs=0.05)  # type: ignore[attr-defined]


# --- relaxation --------------------------------------------------------------------------------------------------


def contact_of(load: float) -> Contact:
    curve, (along, across) = slip_curve(CAR, load), relaxation_lengths(CAR, load)
    return Contact(curve.kxk, -curve.kya, along, across, curve.dx, -curve.dy)


CONTACT = contact_of(4000.0)


def deflection_step(
    state: Deflection, motion: Motion, contact: Contact, period: float, settings: RelaxationSettings = DEFAULTS
) -> Deflection:
    """Return both deflections after a step."""
    return Deflection(
        deflect_along(state.along, motion, contact, period, settings),
        deflect_across(state.across, motion, contact, period, settings),
    )


def test_steady_rolling_gives_the_slips_themselves() -> None:
    for vx in (20.0, -20.0, 3.0):
        motion, state = Motion(vx, -0.04 * abs(vx), 0.07 * abs(vx)), Deflection()
        for _ in range(2000):
            state = deflection_step(state, motion, CONTACT, period=1e-2)
        assert relaxed_slip(state, motion, CONTACT) == pytest.approx((0.04, 0.07), rel=1e-9)


@pytest.mark.parametrize("period", [1e-4, 2e-3, 1e-2, 5e-2])
def test_a_slip_velocity_that_changes_linearly_is_solved_exactly(period: float) -> None:
    """u' = a t - λ u from rest: u = a (t - (1 - exp(-λ t)) / λ) / λ."""
    vx, rate, steps = 20.0, 3.0, 7
    states = {"along": 0.0, "across": 0.0}
    for i in range(steps):
        middle = rate * (i + 0.5) * period
        motion = Motion(vx, -middle, middle)
        states["along"] = deflect_along(states["along"], motion, CONTACT, period, change=-rate * period)
        states["across"] = deflect_across(states["across"], motion, CONTACT, period, change=rate * period)
    for name, length in (("along", CONTACT.length_x), ("across", CONTACT.length_y)):
        decay, end = vx / length, steps * period
        exact = rate * (end + math.expm1(-decay * end) / decay) / decay
        assert states[name] == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("frequency", [2.0, 5.0])
def test_the_lag_of_a_leap_frog_step_is_that_of_the_relaxation(frequency: float) -> None:
    """Slip velocities at the ends of 10 ms steps, deflections in their middle: 1 / (λ + i ω) within 0.02 ms of lag."""
    vx, period, omega = 28.0, 0.01, 2.0 * math.pi * frequency
    count = round(2.0 / period)
    times, states = period * np.arange(count), [0.0]
    velocities = np.sin(omega * times)
    for i in range(1, count):
        motion, change = Motion(vx, 0.0, velocities[i]), velocities[i] - velocities[i - 1]
        states.append(deflect_across(states[-1], motion, CONTACT, period, change=change))
    last = times >= 1.0  # whole periods
    wave = np.exp(-1j * omega * (times[last] + 0.5 * period))
    found = 2j * np.mean(wave * np.array(states)[last])
    exact = 1.0 / (vx / CONTACT.length_y + 1j * omega)
    assert np.angle(found / exact) / omega == pytest.approx(0.0, abs=2e-5)
    assert abs(found / exact) == pytest.approx(1.0, rel=0.01)


def test_a_step_of_steer_has_63_percent_after_the_relaxation_length() -> None:
    motion, state = Motion(10.0, 0.0, 0.1), Deflection()
    for _ in range(100):
        state = deflection_step(state, motion, CONTACT, period=CONTACT.length_y / 10.0 / 100)
    assert relaxed_slip(state, motion, CONTACT)[1] == pytest.approx(0.01 * (1.0 - math.exp(-1.0)), rel=1e-9)


DAMPED = RelaxationSettings(lateral_damping=5000.0)


def test_lateral_damping_of_a_tyre_does_not_change_steady_slip() -> None:
    for vx in (20.0, -20.0, 3.0):
        motion, state = Motion(vx, 0.0, 0.07 * abs(vx)), Deflection()
        for _ in range(2000):
            state = deflection_step(state, motion, CONTACT, period=1e-2, settings=DAMPED)
        assert relaxed_slip(state, motion, CONTACT, DAMPED)[1] == pytest.approx(0.07, rel=1e-9)


@pytest.mark.parametrize("frequency", [0.5, 2.0, 8.0])
def test_lateral_damping_of_a_tyre_leads_as_a_kelvin_voigt_body(frequency: float) -> None:
    # Spring k and damper d give F = (k + i w d) v, the tyre F = C tan alpha, rolling i w v = Vy - Vx tan alpha.
    vx, period, omega = 20.0, 1e-3, 2.0 * math.pi * frequency
    spring = CONTACT.stiffness_y / CONTACT.length_y + 1j * omega * DAMPED.lateral_damping
    expected = 1.0 / (vx + 1j * omega * CONTACT.stiffness_y / spring)
    times = period * np.arange(round(6.0 / frequency / period))
    state, slips = Deflection(), []
    for t in times.tolist():
        slips.append(relaxed_slip(state, Motion(vx, 0.0, math.cos(omega * t)), CONTACT, DAMPED)[1])
        middle = math.cos(omega * (t + 0.5 * period))
        state = deflection_step(state, Motion(vx, 0.0, middle), CONTACT, period=period, settings=DAMPED)
    last = times > 3.0 / frequency - 0.5 * period
    phasor = 2.0 * np.mean(np.exp(-1j * omega * times[last]) * np.array(slips)[last])
    assert phasor == pytest.approx(expected, rel=1e-3)


def test_lateral_damping_acts_at_standstill() -> None:
    still = Motion(0.0, 0.0, 0.01)
    damping = DAMPED.damping + DAMPED.lateral_damping
    _, slip = relaxed_slip(Deflection(0.0, 0.002), still, CONTACT, DAMPED)
    force = CONTACT.stiffness_y / CONTACT.length_y * 0.002 + damping * 0.01
    assert CONTACT.stiffness_y * slip == pytest.approx(force)


@pytest.mark.parametrize("settings", [RelaxationSettings(), DAMPED])
@given(
    vx=st.floats(-3.0, 3.0),
    slip=st.floats(-3.0, 3.0),
    vy=st.floats(-3.0, 3.0),
    along=st.floats(-0.02, 0.02),
    across=st.floats(-0.02, 0.02),
)
def test_a_short_step_follows_the_rates(
    settings: RelaxationSettings, vx: float, slip: float, vy: float, along: float, across: float
) -> None:
    state, motion, step = Deflection(along, across), Motion(vx, slip, vy), 1e-7
    after = deflection_step(state, motion, CONTACT, step, settings)
    rates = deflection_rates(state, motion, CONTACT, settings)
    changes = [(new - old) / step for new, old in zip(after, state, strict=True)]
    assert changes == pytest.approx(list(rates), rel=1e-3, abs=1e-4)


@given(st.floats(-5.0, 5.0), st.floats(1e-4, 0.05))
def test_a_wheel_that_slides_at_standstill_keeps_its_deflection_limited(slip: float, period: float) -> None:
    state = Deflection()
    for _ in range(50):
        state = deflection_step(state, Motion(0.0, slip, -slip), CONTACT, period=period)
    limit_x, limit_y = (1.5 * f / c * s for f, c, s in ((4400.0, 88000.0, 0.22), (3800.0, 54400.0, 54.4 / 140.0)))
    assert abs(state.along) <= limit_x * 1.1
    assert abs(state.across) <= limit_y * 1.1


def test_without_contact_the_deflection_is_zero() -> None:
    lifted = CONTACT._replace(stiffness_x=0.0)
    assert deflection_step(Deflection(0.1, 0.1), Motion(1.0, 0.0, 0.0), lifted, period=0.01) == Deflection()
    assert relaxed_slip(Deflection(0.1, 0.1), Motion(1.0, 0.0, 0.0), lifted) == (0.0, 0.0)
    assert deflection_rates(Deflection(0.1, 0.1), Motion(1.0, 0.0, 0.0), lifted) == (0.0, 0.0)


def test_damping_fades_with_speed() -> None:
    assert [low_speed_weight(v, 2.0) for v in (0.0, 1.0, -1.0, 2.0, 9.0)] == pytest.approx([1.0, 0.5, 0.5, 0.0, 0.0])
    with pytest.raises(ConfigError, match="RelaxationSettings: low must be > 0"):
        RelaxationSettings(low=0.0)


def quarter_car(
    *,
    steps: int,
    period: float,
    pull: float = 0.0,
    speed: float = 0.0,
    locked: bool = False,
    brake_at: float = math.inf,
) -> np.ndarray:
    """Position, speed and Fx of 400 kg on one wheel (1.046 kg m², 0.3234 m), pulled along; semi-implicit Euler."""
    mass, inertia, radius, load = 400.0, 1.046, 0.3234, 4000.0
    x, v, spin, state, rows = 0.0, speed, speed / radius, Deflection(), []
    for i in range(steps):
        held = locked or i * period >= brake_at
        spin = 0.0 if held else spin
        motion = Motion(v, v - spin * radius, 0.0)
        state = deflection_step(state, motion, CONTACT, period=period)
        kappa, _ = relaxed_slip(state, motion, CONTACT)
        fx = magic_formula(CAR, kappa, 0.0, load, vx=v).fx
        v += period * (fx + pull) / mass
        spin -= 0.0 if held else period * fx * radius / inertia
        x += period * v
        rows.append((x, v, fx))
    return np.array(rows)


@pytest.mark.parametrize("period", [1e-3, 5e-3])
def test_a_parked_car_does_not_creep_on_a_slope_of_5_degrees(period: float) -> None:
    pull = 400.0 * 9.81 * math.sin(math.radians(5.0))
    rows = quarter_car(steps=round(20.0 / period), period=period, pull=-pull, locked=True)
    settled, end = rows[len(rows) // 2], rows[-1]
    assert abs(end[0] - settled[0]) < 1e-4
    assert end[2] == pytest.approx(pull, rel=1e-3)
    assert end[0] == pytest.approx(-pull / 400e3, rel=0.1)  # it hangs in the spring of the carcass, less what it swung


@pytest.mark.parametrize("period", [1e-3, 5e-3])
def test_no_limit_cycle_at_walking_pace(period: float) -> None:
    rows = quarter_car(steps=round(10.0 / period), period=period, speed=0.1)
    last = rows[len(rows) // 2 :]
    assert np.ptp(last[:, 1]) < 1e-9
    assert np.abs(last[:, 2]).max() < 1e-6
    assert last[-1, 1] == pytest.approx(0.1, rel=1e-6)


def test_a_locked_stop_ends_without_running_back() -> None:
    rows = quarter_car(steps=10_000, period=1e-3, speed=5.0, brake_at=0.0)
    stop = int(np.argmax(rows[:, 1] <= 0.0))
    sliding = -magic_formula(CAR, -1.0, 0.0, 4000.0, vx=5.0).fx / 400.0
    assert rows[stop, 0] == pytest.approx(25.0 / (2.0 * sliding), rel=0.06)  # at the very end the patch slides less
    assert rows[:, 0].max() - rows[-1, 0] < 0.03  # springs back by its deflection only
    assert np.ptp(rows[-2000:, 0]) < 1e-4


def test_damping_opposes_the_motion_in_both_directions() -> None:
    kappa, tan_alpha = relaxed_slip(Deflection(), Motion(0.0, 0.1, 0.1), CONTACT, RelaxationSettings(damping=1000.0))
    forces = magic_formula(CAR, kappa, tan_alpha, 4000.0, vx=0.0)
    assert forces.fx == pytest.approx(-100.0, rel=1e-3)  # 1000 N s/m × 0.1 m/s
    assert forces.fy == pytest.approx(-100.0, rel=1e-3)


def test_a_tread_that_runs_backwards_turns_the_brush_moment_round() -> None:
    ahead, back = brush_forces(BRUSH, 0.01, 0.02, 4000.0), brush_forces(BRUSH, -2.01, 0.02 * 0.5, 4000.0)
    assert ahead.mz > 0.0
    assert back.mz == 0.0  # so much slip that the whole patch slides
    soft = replace(BRUSH, longitudinal_stiffness=10.0)  # hardly anything along, so the patch still sticks
    ahead, back = brush_forces(soft, 0.0, 0.02, 4000.0), brush_forces(soft, -2.0, 0.02, 4000.0)
    assert ahead.mz > 0.0 > back.mz

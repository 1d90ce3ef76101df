"""Files in the form of PAC2002 against a second implementation of its equations."""

import math
import random
import re
from itertools import product

import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.tyres.magic_formula import magic_formula
from mirdrake.tyres.tir import parse_tir

HEAD = """[MDI_HEADER]
FILE_TYPE                ='tir'
COMMENT                  =
TEST_DEVICE              = FLAT TRAC 2, left
TEST_LOAD                = nan
[UNITS]
LENGTH                   ='meter'
FORCE                    ='newton'
ANGLE                    ='radians'
MASS                     ='kg'
TIME                     ='second'
[MODEL]
FITTYP                   = 5
USE_MODE                 = 14                   $Tyre use switch
VXLOW                    = 1
LONGVL                   = 16.6
[SHAPE]
 1.0    0.0
 1.0    0.4
 0.9  , 1.0e0
[DIMENSION]
UNLOADED_RADIUS          = 0.344
[VERTICAL]
VERTICAL_STIFFNESS       = 2.1e+005
FNOMIN                   = 4850
[DIMENSION]
UNLOADED_RADIUS          = 0.3440
WIDTH                    = 0.235
[BOTTOMING_CURVE]
{pen fz}
 0.0 0.0
"""

# Typical value and spread of each coefficient; PDY1 is positive beside a negative PKY1.
LONGITUDINAL = {
    "PCX1": (1.6, 0.1), "PDX1": (1.1, 0.2), "PDX2": (-0.1, 0.05), "PDX3": (0.5, 0.5), "PEX1": (0.3, 0.3),
    "PEX2": (0.1, 0.1), "PEX3": (0.05, 0.05), "PEX4": (0.0, 0.1), "PKX1": (20.0, 5.0), "PKX2": (0.0, 2.0),
    "PKX3": (0.1, 0.1), "PHX1": (0.0, 0.002), "PHX2": (0.0, 0.002), "PVX1": (0.0, 0.01), "PVX2": (0.0, 0.01),
    "RBX1": (12.0, 4.0), "RBX2": (-10.0, 4.0), "RCX1": (1.1, 0.1), "REX1": (0.2, 0.4), "REX2": (0.0, 0.1),
    "RHX1": (0.0, 0.01),
}  # fmt: skip
LATERAL = {
    "PCY1": (1.35, 0.1), "PDY1": (1.0, 0.2), "PDY2": (-0.15, 0.05), "PDY3": (-1.0, 2.0), "PEY1": (-0.2, 0.3),
    "PEY2": (0.0, 0.1), "PEY3": (0.0, 0.3), "PEY4": (0.0, 5.0), "PKY1": (-18.0, 4.0), "PKY2": (2.0, 0.4),
    "PKY3": (0.0, 0.5), "PHY1": (0.0, 0.004), "PHY2": (0.0, 0.002), "PHY3": (0.03, 0.02), "PVY1": (0.0, 0.04),
    "PVY2": (0.0, 0.02), "PVY3": (-0.3, 0.1), "PVY4": (-0.2, 0.3), "RBY1": (7.0, 2.0), "RBY2": (6.0, 3.0),
    "RBY3": (0.0, 0.03), "RCY1": (1.05, 0.05), "REY1": (0.0, 0.3), "REY2": (0.0, 0.1), "RHY1": (0.0, 0.02),
    "RHY2": (0.0, 0.005), "RVY1": (0.0, 0.05), "RVY2": (0.0, 0.05), "RVY3": (0.0, 0.3), "RVY4": (5.0, 8.0),
    "RVY5": (1.9, 0.0), "RVY6": (-8.0, 6.0),
}  # fmt: skip
ALIGNING = {
    "QBZ1": (9.0, 2.0), "QBZ2": (-1.5, 0.5), "QBZ3": (-0.5, 0.5), "QBZ4": (0.0, 0.3), "QBZ5": (0.0, 0.5),
    "QBZ9": (9.0, 4.0), "QBZ10": (0.0, 0.5), "QCZ1": (1.2, 0.1), "QDZ1": (0.1, 0.03), "QDZ2": (0.0, 0.01),
    "QDZ3": (0.0, 0.3), "QDZ4": (0.0, 4.0), "QDZ6": (0.0, 0.006), "QDZ7": (0.0, 0.004), "QDZ8": (-0.15, 0.05),
    "QDZ9": (0.0, 0.03), "QEZ1": (-2.0, 1.0), "QEZ2": (0.0, 0.5), "QEZ3": (0.0, 0.1), "QEZ4": (0.2, 0.1),
    "QEZ5": (-2.0, 1.0), "QHZ1": (0.0, 0.005), "QHZ2": (0.0, 0.003), "QHZ3": (0.1, 0.05), "QHZ4": (0.0, 0.1),
    "SSZ1": (0.0, 0.02), "SSZ2": (0.0, 0.02), "SSZ3": (0.0, 0.3), "SSZ4": (0.0, 0.3),
}  # fmt: skip


def file_of(seed: int) -> str:
    """Return a file with random coefficients."""
    random_of = random.Random(seed)
    text = HEAD
    for section, table in (("LONGITUDINAL", LONGITUDINAL), ("LATERAL", LATERAL), ("ALIGNING", ALIGNING)):
        text += f"[{section}_COEFFICIENTS]\n"
        for name, (middle, spread) in table.items():
            text += f"{name:24} = {random_of.uniform(middle - spread, middle + spread):.6g}   $with a comment\n"
    return text


def by_the_book(text: str, kappa: float, slip: float, load: float, gamma: float) -> tuple[float, float, float]:
    """Fx, Fy, Mz of PAC2002 for tan(slip angle) with the signs of the file as they are; all scale factors are 1."""
    q = {name: float(value) for name, value in re.findall(r"(?m)^([A-Z]\w+) *= *([-+\d.e]+) *(?:\$.*)?$", text)}
    fz0, radius, c = q["FNOMIN"], q["UNLOADED_RADIUS"], math.sin(gamma)
    d = (load - fz0) / fz0

    def angle(b: float, shape: float, e: float, x: float) -> float:
        return shape * math.atan(b * x - e * (b * x - math.atan(b * x)))

    # Longitudinal force.
    x = kappa + q["PHX1"] + q["PHX2"] * d
    kx = load * (q["PKX1"] + q["PKX2"] * d) * math.exp(q["PKX3"] * d)
    dx = load * (q["PDX1"] + q["PDX2"] * d) * (1 - q["PDX3"] * gamma**2)
    ex = (q["PEX1"] + q["PEX2"] * d + q["PEX3"] * d**2) * (1 - q["PEX4"] * math.copysign(1, x))
    fx0 = dx * math.sin(angle(kx / (q["PCX1"] * dx), q["PCX1"], min(ex, 1), x)) + load * (q["PVX1"] + q["PVX2"] * d)
    b, e = q["RBX1"] * math.cos(math.atan(q["RBX2"] * kappa)), min(q["REX1"] + q["REX2"] * d, 1)
    weight = [math.cos(angle(b, q["RCX1"], e, s + q["RHX1"])) for s in (slip, 0.0)]
    fx = max(weight[0] / weight[1], 0.0) * fx0

    # Lateral force: muy and By with the signs of the file.
    muy = (q["PDY1"] + q["PDY2"] * d) * (1 - q["PDY3"] * c**2)
    ky = q["PKY1"] * fz0 * math.sin(2 * math.atan(load / (q["PKY2"] * fz0))) * (1 - q["PKY3"] * abs(c))
    by = ky / (q["PCY1"] * muy * load)
    shy = q["PHY1"] + q["PHY2"] * d + q["PHY3"] * c
    svy = load * (q["PVY1"] + q["PVY2"] * d + (q["PVY3"] + q["PVY4"] * d) * c)
    y = slip + shy
    ey = (q["PEY1"] + q["PEY2"] * d) * (1 - (q["PEY3"] + q["PEY4"] * c) * math.copysign(1, y))
    fy0 = muy * load * math.sin(angle(by, q["PCY1"], min(ey, 1), y)) + svy
    b, e = q["RBY1"] * math.cos(math.atan(q["RBY2"] * (slip - q["RBY3"]))), min(q["REY1"] + q["REY2"] * d, 1)
    shift = q["RHY1"] + q["RHY2"] * d
    weight = [math.cos(angle(b, q["RCY1"], e, s + shift)) for s in (kappa, 0.0)]
    pure = max(weight[0] / weight[1], 0.0) * fy0
    side = muy * load * (q["RVY1"] + q["RVY2"] * d + q["RVY3"] * c) * math.cos(math.atan(q["RVY4"] * slip))
    fy = pure + side * math.sin(q["RVY5"] * math.atan(q["RVY6"] * kappa))

    # Aligning moment.
    shifted_slip = slip + q["QHZ1"] + q["QHZ2"] * d + (q["QHZ3"] + q["QHZ4"] * d) * c
    bt = (q["QBZ1"] + q["QBZ2"] * d + q["QBZ3"] * d**2) * (1 + q["QBZ4"] * gamma + q["QBZ5"] * abs(gamma))
    dt = load * radius / fz0 * (q["QDZ1"] + q["QDZ2"] * d) * (1 + q["QDZ3"] * gamma + q["QDZ4"] * gamma**2)
    et = q["QEZ1"] + q["QEZ2"] * d + q["QEZ3"] * d**2
    et *= 1 + (q["QEZ4"] + q["QEZ5"] * c) * 2 / math.pi * math.atan(bt * q["QCZ1"] * shifted_slip)
    cosine = 1 / math.hypot(1, slip)
    trail = dt * math.cos(angle(bt, q["QCZ1"], min(et, 1), math.hypot(shifted_slip, kx / ky * kappa))) * cosine
    ar = math.hypot(slip + shy + svy / ky, kx / ky * kappa)
    dr = load * radius * (q["QDZ6"] + q["QDZ7"] * d + (q["QDZ8"] + q["QDZ9"] * d) * c) * cosine
    rest = dr * math.cos(math.atan((q["QBZ9"] + q["QBZ10"] * by * q["PCY1"]) * ar))
    arm = radius * (q["SSZ1"] + q["SSZ2"] * fy / fz0 + (q["SSZ3"] + q["SSZ4"] * d) * gamma)
    return fx, fy, -trail * pure + rest + arm * fx


GRID = tuple(
    product((-0.5, -0.05, 0.0, 0.02, 0.2), (-0.3, -0.04, 0.0, 0.03, 0.2), (1500.0, 4850.0, 8000.0), (0.0, 0.06))
)


@pytest.mark.parametrize("seed", range(20))
def test_a_file_with_a_positive_pdy1_is_the_tyre_of_its_own_equations(seed: int) -> None:
    text = file_of(seed)
    tyre = parse_tir(text).parameters
    assert tyre.pky1 < 0.0
    assert tyre.pdy1 < 0.0
    for kappa, slip, load, gamma in GRID:
        expected = pytest.approx(by_the_book(text, kappa, slip, load, gamma), rel=1e-9, abs=1e-6)
        ours = magic_formula(tyre, kappa, slip, load, vx=20.0, gamma=gamma)
        assert (ours.fx, ours.fy, ours.mz) == expected


@pytest.mark.parametrize("seed", range(5))
def test_the_sign_of_pdy1_does_not_change_the_tyre(seed: int) -> None:
    text = file_of(seed)
    turned = text
    for name in ("PDY1", "PDY2", "RVY1", "RVY2", "RVY3", "QBZ10"):
        turned = re.sub(rf"(?m)^({name} *=) ([-\d.e]+)", lambda m: f"{m[1]} {-float(m[2])!r}", turned)
    assert parse_tir(turned).parameters == parse_tir(text).parameters


def test_forces_have_the_signs_of_a_tyre() -> None:
    tyre = parse_tir(file_of(3)).parameters
    assert magic_formula(tyre, 0.1, 0.0, 4000.0, vx=20.0).fx > 0.0
    assert magic_formula(tyre, -0.1, 0.0, 4000.0, vx=20.0).fx < 0.0
    assert magic_formula(tyre, 0.0, 0.1, 4000.0, vx=20.0).fy < 0.0
    assert magic_formula(tyre, 0.0, -0.1, 4000.0, vx=20.0).fy > 0.0
    assert magic_formula(tyre, 0.0, 0.05, 4000.0, vx=20.0).mz > 0.0


def test_unused_entries_may_have_any_value_and_are_kept() -> None:
    file = parse_tir(file_of(0))
    assert file.parameters.version == "5.2"
    assert {"COMMENT", "TEST_DEVICE", "TEST_LOAD", "WIDTH"} <= set(file.unused)
    assert file.sections["MDI_HEADER"]["TEST_DEVICE"].value == "FLAT TRAC 2, left"
    assert file.sections["DIMENSION"]["WIDTH"].value == 0.235


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("UNLOADED_RADIUS = 0.35", "[DIMENSION] UNLOADED_RADIUS: has another value in line 22; keep one of them"),
        ("FNOMIN =", "[DIMENSION] FNOMIN: expected a finite number, got ''"),
        ("FNOMIN = about 4000", "[DIMENSION] FNOMIN: expected a finite number, got 'about 4000'"),
    ],
)
def test_used_entries_must_be_valid(line: str, message: str) -> None:
    text = file_of(0).replace("WIDTH                    = 0.235", line)
    with pytest.raises(ConfigError) as caught:
        parse_tir(text, name="t.tir")
    assert message in str(caught.value)

"""Tyre property files of other programs: one tyre in three dialects, and faults in them.

The texts follow the descriptions of the formats (TeimOrbit of Adams/Tire, and the MF-Tyre/MF-Swift manual), not files
of mirdrake; every number is repeated here in SI units.
"""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.tyres.magic_formula import magic_formula
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.tir import TirFile, parse_tir, read_tir

TYRE = MagicFormulaParameters(
    unloaded_radius=0.3175, fnomin=4000.0, fzmin=200.0, fzmax=9000.0, longvl=16.5, vxlow=1.0,
    pcx1=1.685, pdx1=1.21, pdx2=-0.037, pkx1=21.51, pkx2=-0.163, pcy1=1.193, pdy1=-0.99, pdy2=0.145, pky1=-14.95,
    pky2=2.13, qbz1=8.964, qcz1=1.18, qdz1=0.1, qsy1=0.01, lmuy=0.9,
)  # fmt: skip

ADAMS = """$---------------------------------------------------------------------MDI_HEADER
[MDI_HEADER]
FILE_TYPE     =  'tir'
FILE_VERSION  =  3.0
FILE_FORMAT   =  'ASCII'
(COMMENTS)
{comment_string}
'Tire 205/60 R15, 2.2 bar = 220 kPa'
made by: a program that writes FNOMIN here, too
$--------------------------------------------------------------------------UNITS
[UNITS]
LENGTH                   = 'mm'
FORCE                    = 'kilo_newton'
ANGLE                    = 'radians'
MASS                     = 'kg'
TIME                     = 'millisecond'
[MODEL]
! use mode  1  2  3  4
PROPERTY_FILE_FORMAT     = 'PAC2002'
USE_MODE                 = 14            $Tyre use switch (IUSED)
VXLOW                    = 1
LONGVL                   = 16.5          $mm/ms = m/s
TYRESIDE                 = 'SYMMETRIC'
[DIMENSION]
UNLOADED_RADIUS          = 317.5         $Free tyre radius
[SHAPE]
{radial width}
 1.0    0.0
 1.0    0.4
[VERTICAL]
VERTICAL_STIFFNESS       = 0.2           $kN/mm
FNOMIN                   = 4             $Nominal wheel load
[VERTICAL_FORCE_RANGE]
FZMIN                    = 0.2
FZMAX                    = 9.0
[SCALING_COEFFICIENTS]
LMUY                     = 0.9
[LONGITUDINAL_COEFFICIENTS]
PCX1                     =  1.685        $Shape factor Cfx for longitudinal force
PDX1                     =  1.21
PDX2                     = -3.7D-02
PKX1                     =  21.51
PKX2                     = -0.163
PTX1                     =  2.0
[LATERAL_COEFFICIENTS]
PCY1                     =  1.193
PDY1                     = -0.99
PDY2                     =  0.145
PKY1                     = -14.95
PKY2                     =  2.13
PHY3                     =  0.03
PTY1                     =  2.1
[ALIGNING_COEFFICIENTS]
QBZ1                     =  8.964
QCZ1                     =  1.18
QDZ1                     =  0.1
[ROLLING_COEFFICIENTS]
QSY1                     =  0.01
"""

# Tabs, lower case, inches and pounds, comments after an exclamation mark, a quote with another, hardly any section.
POUNDS = """! tyre property file\twritten by a fit\r
[units]\t! imperial\r
\tlength\t=\t"inch"\r
\tforce=\t"pound_force"\r
\tangle\t=\t"rad"\r
\ttime\t=\t"s"\r
[model]\r
\tfittyp\t=\t61\t! MF-Tyre 6.1\r
\tlongvl=649.6062992125984\r
\tvxlow=39.37007874015748\r
[dimension]\r
\tunloaded_radius\t=\t12.5\r
[vertical]\r
\tfnomin\t=\t899.2357723988\r
[vertical_force_range]\r
\tfzmin = 44.96178861994\r
\tfzmax = 2023.280487897\r
[scaling_coefficients]\r
\tlmuy=.9\r
[longitudinal_coefficients]\r
\tpcx1=1.685\r
\tpdx1=+1.21\r
\tpdx2=-.037\r
\tpkx1=2.151e1\r
\tpkx2=-1.63E-1\r
[lateral_coefficients]\r
\tpcy1=1.193\r
\tpdy1=-0.99\r
\tpdy2=0.145\r
\tpky1=-14.95\r
\tpky2=2.13\r
\tqbz1=8.964\t! fits of this program have one section for all of the side\r
\tqcz1=1.18\r
\tqdz1=0.1\r
\tqsy1=0.01\r
"""

# MF 6.2 with pressure, the sections in another order, PROPERTY_FILE_FORMAT beside FITTYP, much that is not used here.
SWIFT = """[MODEL]
FITTYP               = 62               $Magic Formula Version number
PLUS                 = 1                $Moment representation 0=ground frame 1=wheel frame
PROPERTY_FILE_FORMAT ='USER'
FUNCTION_NAME        ='Lib::TYR900'
TYRESIDE             ='LEFT'            $Position of tyre during measurements
LONGVL               = 16.5             $Reference speed
VXLOW                = 1                $Lower boundary velocity in slip calculation
ROAD_INCREMENT       = 0.01
[OPERATING_CONDITIONS]
INFLPRES             = 2.4              $Tyre inflation pressure
NOMPRES              = 2.2              $Nominal pressure used in (MF) equations
[UNITS]
LENGTH               ='meter'
FORCE                ='newton'
ANGLE                ='radian'
MASS                 ='gram'
TIME                 ='second'
PRESSURE             ='bar'
[DIMENSION]
UNLOADED_RADIUS      = 0.3175
WIDTH                = 0.205
[INERTIA]
MASS                 = 9300
[VERTICAL]
FNOMIN               = 4000
Q_FZ2                = 15.4
[STRUCTURAL]
LATERAL_STIFFNESS    = 140000
PCFY3                = 0.2
[VERTICAL_FORCE_RANGE]
FZMIN                = 200
FZMAX                = 9000
[TURNSLIP_COEFFICIENTS]
PDXP1                = 0.4
[SCALING_COEFFICIENTS]
LMUY                 = 0.9
LGYR                 = 1
[LONGITUDINAL_COEFFICIENTS]
PCX1                 = 1.685
PDX1                 = 1.21
PDX2                 = -0.037
PKX1                 = 21.51
PKX2                 = -0.163
PPX1                 = -0.35
[LATERAL_COEFFICIENTS]
PCY1                 = 1.193
PDY1                 = -0.99
PDY2                 = 0.145
PKY1                 = -14.95
PKY2                 = 2.13
[ALIGNING_COEFFICIENTS]
QBZ1                 = 8.964
QCZ1                 = 1.18
QDZ1                 = 0.1
[ROLLING_COEFFICIENTS]
QSY1                 = 0.01
"""

EXPECTED = {
    "adams.tir": replace(TYRE, version="5.2", ptx1=2.0, pty1=2.1, phy3=0.03, vertical_stiffness=200e3),
    "pounds.tir": replace(TYRE, version="6.1"),
    "swift.tir": replace(
        TYRE, version="6.2", inflpres=2.4e5, nompres=2.2e5, lateral_stiffness=140e3, pcfy3=0.2, ppx1=-0.35
    ),
}
TEXTS = {"adams.tir": ADAMS, "pounds.tir": POUNDS, "swift.tir": SWIFT}


def read(folder: Path, name: str, text: str) -> TirFile:
    (folder / name).write_bytes(text.encode())
    return read_tir(folder / name)


@pytest.mark.parametrize("name", TEXTS)
def test_a_tyre_is_the_same_in_every_dialect(tmp_path: Path, name: str) -> None:
    parameters, expected = read(tmp_path, name, TEXTS[name]).parameters, EXPECTED[name]
    for field in MagicFormulaParameters.__dataclass_fields__:
        value = getattr(expected, field)
        assert getattr(parameters, field) == (value if isinstance(value, str) else pytest.approx(value, rel=1e-9)), (
            field
        )
    ours, theirs = (
        magic_formula(tyre, 0.05, math.tan(0.04), 3500.0, vx=20.0, gamma=0.02, pressure=220e3)
        for tyre in (parameters, replace(TYRE, version=expected.version, phy3=expected.phy3, nompres=220e3))
    )
    if name == "swift.tir":  # at the nominal pressure
        assert list(ours) == pytest.approx(list(theirs), rel=1e-8)
        harder = magic_formula(parameters, 0.05, 0.0, 3500.0, vx=20.0)
        assert harder.fx < ours.fx  # PPX1 softens at 2.4 bar
    else:
        assert list(ours) == pytest.approx(list(theirs), rel=1e-8)


@pytest.mark.parametrize("end", ["\x1a", "\n\x1a\n", "\0\0"])
def test_a_file_may_end_as_old_programs_end_it(end: str) -> None:
    assert parse_tir(ADAMS + end).parameters == parse_tir(ADAMS).parameters


def test_unused_keys_and_sections_of_a_file_are_kept(tmp_path: Path) -> None:
    adams, swift = (read(tmp_path, name, TEXTS[name]) for name in ("adams.tir", "swift.tir"))
    assert {"FILE_TYPE", "USE_MODE", "TYRESIDE"} <= set(adams.unused)
    assert {"PDXP1", "PLUS", "TYRESIDE", "MASS", "LGYR"} <= set(swift.unused)
    assert swift.sections["INERTIA"]["MASS"].value == 9300.0


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("adams.tir", "'mm'", "'mile'", "[UNITS] LENGTH: unknown unit 'mile'"),
        ("adams.tir", "'radians'", "'degrees'", "[UNITS] ANGLE: unknown unit 'degrees'; the coefficients are"),
        ("adams.tir", "'PAC2002'", "'PAC89'", "[MODEL] PROPERTY_FILE_FORMAT: unknown 'PAC89' without FITTYP"),
        ("adams.tir", "-3.7D-02", "-3.7X-02", "[LONGITUDINAL_COEFFICIENTS] PDX2: expected a finite number"),
        ("adams.tir", "= -14.95", "=  14.95", "[LATERAL_COEFFICIENTS] PKY1: must be negative, got 14.95"),
        ("adams.tir", "FNOMIN                   = 4 ", "FNOMIN  4 ", "expected NAME = value, got 'FNOMIN"),
        ("pounds.tir", "=\t61", "=\t6.1", "[MODEL] FITTYP: unknown '6.1'; known: 5, 6, 21, 52 (MF 5.2), 61"),
        ("swift.tir", "='bar'", "='torr'", "[UNITS] PRESSURE: unknown unit 'torr'"),
        ("swift.tir", "= 62 ", "= 60 ", "[MODEL] FITTYP: unknown '60'"),
        ("swift.tir", "= 1.18", "= 'flat'", "[ALIGNING_COEFFICIENTS] QCZ1: expected a finite number, got 'flat'"),
        ("swift.tir", "LGYR", "LMUY", "[SCALING_COEFFICIENTS] LMUY: has another value in line"),
    ],
)  # fmt: skip
def test_faults_of_a_file_are_reported_with_their_line(
    tmp_path: Path, name: str, old: str, new: str, expected: str
) -> None:
    before, separator, after = TEXTS[name].partition(old)
    assert separator
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, name, before + new + after)
    (message,) = str(caught.value).splitlines()
    assert f"{name}:{before.count(chr(10)) + 1}: {expected}" in message


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ("[vertical]", "[vertical_f", "1: [VERTICAL]: missing section"),
        ("\ttime", "[model]", "2: [UNITS] TIME: missing"),
    ],
)
def test_missing_parameters_are_reported(tmp_path: Path, start: str, end: str, expected: str) -> None:
    before, rest = POUNDS[: POUNDS.index(start)], POUNDS[POUNDS.index(end) :]
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, "pounds.tir", before + rest)
    assert f"pounds.tir:{expected}" in str(caught.value)

"""Tyre property files: accepted content, rejected content and the error messages."""

from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirdrake.core.errors import ConfigError
from mirdrake.tyres.magic_formula import magic_formula, slip_curve
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.tir import parse_tir, read_tir
from tests.tir_files import write_tir

TYRES = sorted((Path(__file__).resolve().parent.parent / "models" / "tyres").glob("*.tir"))

SMALL = """[UNITS]
LENGTH = 'meter'
FORCE = 'newton'
ANGLE = 'radians'
MASS = 'kg'
TIME = 'second'
[MODEL]
FITTYP = 61
[DIMENSION]
UNLOADED_RADIUS = 0.3
[VERTICAL]
FNOMIN = 4000
[LONGITUDINAL_COEFFICIENTS]
PCX1 = 1.6
PDX1 = 1.1
PKX1 = 22
[LATERAL_COEFFICIENTS]
PCY1 = 1.3
PDY1 = -0.95
PKY1 = -17
PKY2 = 2
"""


def fault(text: str) -> str:
    with pytest.raises(ConfigError) as error:
        parse_tir(text, name="t.tir")
    return str(error.value)


def without(line: str) -> str:
    assert f"{line}\n" in SMALL
    return SMALL.replace(f"{line}\n", "")


def instead(line: str, other: str) -> str:
    assert f"{line}\n" in SMALL
    return SMALL.replace(f"{line}\n", f"{other}\n")


def test_omitted_entries_of_a_file_are_neutral() -> None:
    tyre = parse_tir(SMALL).parameters
    assert tyre == MagicFormulaParameters(
        unloaded_radius=0.3, fnomin=4000.0, pcx1=1.6, pdx1=1.1, pkx1=22.0, pcy1=1.3, pdy1=-0.95, pky1=-17.0, pky2=2.0
    )
    assert (tyre.lmux, tyre.lmy, tyre.pky4, tyre.qsy7, tyre.rbx1) == (1.0, 1.0, 2.0, 1.0, 0.0)


def test_comments_case_quotes_tables_and_fortran_numbers() -> None:
    text = SMALL.replace("PKX1 = 22", "  pkx1=2.2D+01   $ slip stiffness = 22 ! really")
    text = "! A comment = no entry\n$--------\n" + text.replace("[MODEL]", "[model]  $ which")
    text += "[SHAPE]\n{radial width}\n 1.0 0.0\n 1.0 0.4\n[INERTIA]\nMASS = 9.3\nNOTE = '5 $ a ! piece'\n"
    file = parse_tir(text)
    assert file.parameters == parse_tir(SMALL).parameters
    assert file.sections["INERTIA"]["NOTE"].value == "5 $ a ! piece"
    assert file.sections["INERTIA"]["MASS"] == (9.3, 29)
    assert file.unused == ("MASS", "NOTE")


def test_units_become_si_and_coefficients_stay() -> None:
    text = SMALL.replace("'meter'", "'mm'").replace("'newton'", "'kilo_newton'").replace("'second'", "'millisecond'")
    text = text.replace("= 0.3\n", "= 300\n").replace("= 4000\n", "= 4\nFZMAX = 9\n")
    text = text.replace("FITTYP = 61", "FITTYP = 61\nLONGVL = 16.7\nVXLOW = 1")
    text = text.replace("'kg'", "'kg'\nPRESSURE = 'bar'") + "[STRUCTURAL]\nLATERAL_STIFFNESS = 0.14\nNOMPRES = 2.5\n"
    tyre = parse_tir(text).parameters
    assert (tyre.unloaded_radius, tyre.fnomin, tyre.fzmax) == pytest.approx((0.3, 4000.0, 9000.0))
    assert (tyre.longvl, tyre.vxlow) == pytest.approx((16.7, 1.0))
    assert (tyre.lateral_stiffness, tyre.nompres) == pytest.approx((140e3, 2.5e5))
    assert tyre.pky1 == -17.0


@pytest.mark.parametrize(
    ("model", "version"),
    [
        ("FITTYP = 6", "5.2"),
        ("FITTYP = 21", "5.2"),
        ("FITTYP = 62", "6.2"),
        ("PROPERTY_FILE_FORMAT = 'PAC2002'", "5.2"),
    ],
)
def test_versions(model: str, version: str) -> None:
    assert parse_tir(instead("FITTYP = 61", model)).parameters.version == version


def test_old_names_of_version_5_2() -> None:
    text = instead("FITTYP = 61", "FITTYP = 6") + "[SCALING_COEFFICIENTS]\nLGAY = 0.5\nLGAZ = 0.25\n"
    tyre = parse_tir(text).parameters
    assert (tyre.lkyc, tyre.lkzc) == (0.5, 0.25)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (without("[VERTICAL]"), "t.tir:1: [VERTICAL]: missing section; the Magic Formula needs it"),
        (without("PCY1 = 1.3"), "t.tir:1: PCY1: missing; the Magic Formula needs it"),
        (instead("PCY1 = 1.3", "PCY2 = 1.3"), "t.tir:1: PCY1: missing; the Magic Formula needs it; is 'PCY2' meant?"),
        (instead("PKX1 = 22", "PKX1 = nan"),
         "t.tir:16: [LONGITUDINAL_COEFFICIENTS] PKX1: expected a finite number, got 'nan'"),
        (instead("PKX1 = 22", "PKX1 = 1e999"),
         "t.tir:16: [LONGITUDINAL_COEFFICIENTS] PKX1: expected a finite number, got '1e999'"),
        (instead("PKX1 = 22", "PKX1 = much"),
         "t.tir:16: [LONGITUDINAL_COEFFICIENTS] PKX1: expected a finite number, got 'much'"),
        (instead("PKX1 = 22", "PKX1 = '22'"),
         "t.tir:16: [LONGITUDINAL_COEFFICIENTS] PKX1: expected a finite number, got '22'"),
        (instead("PKX1 = 22", "PKX1 ="),
         "t.tir:16: [LONGITUDINAL_COEFFICIENTS] PKX1: expected a finite number, got ''"),
        (instead("PKX1 = 22", "PKX1 22"), "t.tir:16: expected NAME = value, got 'PKX1 22'"),
        (instead("PKX1 = 22", "PKX1 = 22\nPKX1 = 23"),
         "t.tir:17: [LONGITUDINAL_COEFFICIENTS] PKX1: has another value in line 16; keep one of them"),
        (SMALL + "[EXTRA]\nPKX1 = 23\n", "t.tir:23: [EXTRA] PKX1: has another value in line 16; keep one of them"),
        ("PCX1 = 1\n" + SMALL, "t.tir:1: 'PCX1 = 1' is before the first [SECTION]"),
        (instead("LENGTH = 'meter'", "LENGTH = 'furlong'"),
         "t.tir:2: [UNITS] LENGTH: unknown unit 'furlong'; "
         "allowed: cm, foot, inch, km, m, meter, millimeter, mm"),
        (instead("ANGLE = 'radians'", "ANGLE = 'degree'"),
         "t.tir:4: [UNITS] ANGLE: unknown unit 'degree'; the coefficients are defined for radians only; "
         "allowed: rad, radian, radians"),
        (without("TIME = 'second'"),
         "t.tir:1: [UNITS] TIME: missing; allowed: hour, millisecond, minute, s, sec, second"),
        (instead("FITTYP = 61", "FITTYP = 70"),
         "t.tir:8: [MODEL] FITTYP: unknown '70'; known: 5, 6, 21, 52 (MF 5.2), 61, 62"),
        (instead("FITTYP = 61", "FITTYP = 'new'"),
         "t.tir:8: [MODEL] FITTYP: unknown 'new'; known: 5, 6, 21, 52 (MF 5.2), 61, 62"),
        (without("FITTYP = 61"), "t.tir:1: [MODEL] FITTYP: missing; give 61, 62 or, for MF 5.2, 6"),
        (instead("PKY1 = -17", "PKY1 = 17"),
         "t.tir:20: [LATERAL_COEFFICIENTS] PKY1: must be negative, got 17; files in ISO-W axes have it negative; "
         "a positive one is for y to the right (adapted SAE)"),
        (instead("FNOMIN = 4000", "FNOMIN = 0"), "t.tir:12: [VERTICAL] FNOMIN: must be positive, got 0"),
        (instead("FNOMIN = 4000", "FNOMIN = 4000\nFZMIN = -1"),
         "t.tir:13: [VERTICAL] FZMIN: must not be negative, got -1"),
        (instead("FNOMIN = 4000", "FNOMIN = 4000\nFZMIN = 90\nFZMAX = 80"),
         "t.tir:14: FZMAX: must be larger than FZMIN, 90 N"),
    ],
)  # fmt: skip
def test_every_fault_is_one_line_with_its_place(text: str, message: str) -> None:
    assert fault(text) == message


def test_an_entry_without_a_value_counts_as_left_out_if_it_has_a_default() -> None:
    text = instead("FNOMIN = 4000", "FNOMIN = 4000\nFZMIN =\nFZMAX = $ none\nVERTICAL_STIFFNESS =")
    assert parse_tir(text).parameters == parse_tir(SMALL).parameters


def test_a_comment_broken_into_lines_and_a_version_in_quotes_are_read() -> None:
    text = instead("PKX1 = 22", "PKX1 = 22 $ stiffness over the\nload\nPKX2 = 3 ! its change\nwith the load squared")
    assert parse_tir(text).parameters == parse_tir(instead("PKX1 = 22", "PKX1 = 22\nPKX2 = 3")).parameters
    assert parse_tir(instead("FITTYP = 61", "FITTYP = '62'")).parameters.version == "6.2"
    # An entry without = is a fault after a comment, too, and so are words after an entry without one.
    assert "expected NAME = value, got 'PKX2 3'" in fault(instead("PKX1 = 22", "PKX1 = 22 $ x\nPKX2 3"))
    assert "expected NAME = value, got 'load'" in fault(instead("PKX1 = 22", "PKX1 = 22\nload"))


def test_another_tyre_model_is_one_fault_whatever_its_units_and_sections_are() -> None:
    text = "[UNITS]\nANGLE = 'deg'\n[MODEL]\nPROPERTY_FILE_FORMAT = 'SPRINGS'\n[BELT]\nMASS = 1\n"
    assert fault(text) == (
        "t.tir:4: [MODEL] PROPERTY_FILE_FORMAT: unknown 'SPRINGS' without FITTYP; only the Magic Formula is read: "
        "MF-TYRE, MF52, MF_05, PAC2002"
    )


def test_an_empty_file_names_all_it_lacks() -> None:
    lines = fault("").splitlines()
    assert len(lines) == 6
    assert lines[0] == "t.tir:1: [UNITS]: missing section; the Magic Formula needs it"


def test_several_faults_come_together() -> None:
    text = instead("PKX1 = 22", "PKX1 = -22").replace("'newton'", "'stone'").replace("PKY2 = 2\n", "")
    assert [line.split(":")[1] for line in fault(text).splitlines()] == ["3", "16", "1"]


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.tir: cannot be read: No such file or directory$"):
        read_tir(tmp_path / "none.tir")
    with pytest.raises(ConfigError, match=r"cannot be read: Is a directory$"):
        read_tir(tmp_path)


def test_comments_of_older_tools_are_latin_1(tmp_path: Path) -> None:
    file = tmp_path / "old.tir"
    file.write_bytes("! Reifen für Übungen\n".encode("latin-1") + SMALL.replace("\n", "\r\n").encode())
    assert read_tir(file).parameters == parse_tir(SMALL).parameters


@given(st.text(alphabet="[]=$!'{} \nPKXFNOMI1-.e9ß\x00", max_size=80))
def test_any_text_is_read_or_rejected(noise: str) -> None:
    for text in (noise, SMALL + noise):
        try:
            parse_tir(text)
        except ConfigError as error:
            assert all(line.startswith("<text>:") for line in str(error).splitlines())  # noqa: PT017


FIXED = {
    "fzmin", "nompres", "inflpres", "longitudinal_stiffness", "lateral_stiffness", "vertical_stiffness",
    "vertical_damping",
}  # fmt: skip
NUMBERS = {
    field.name: st.floats(-20.0, 20.0)
    for field in fields(MagicFormulaParameters)
    if field.default == 0.0 and field.name not in FIXED
}


@given(st.fixed_dictionaries({}, optional=NUMBERS), st.sampled_from(["5.2", "6.1", "6.2"]), st.floats(100.0, 1e5))
def test_round_trip(coefficients: dict[str, float], version: str, stiffness: float) -> None:
    tyre = replace(
        parse_tir(SMALL).parameters,
        version=version,  # type: ignore[arg-type]
        fzmax=stiffness,
        nompres=2.2e5,
        lateral_stiffness=stiffness,
        vertical_stiffness=stiffness,
        **coefficients,
    )
    file = parse_tir(write_tir(tyre))
    assert file.parameters == tyre
    assert file.unused == ()


@pytest.mark.parametrize("path", TYRES, ids=lambda path: path.name)
def test_bundled_tyres_are_read_and_are_tyres(path: Path) -> None:
    text = path.read_text()
    assert "! Grade" in text
    assert "Sources" in text
    tyre = read_tir(path).parameters
    assert parse_tir(write_tir(tyre)).parameters == tyre
    curve = slip_curve(tyre, tyre.fnomin)
    assert 0.6 < curve.dx / tyre.fnomin < 1.3
    assert 0.6 < -curve.dy / tyre.fnomin < 1.3
    assert 10.0 < curve.kxk / tyre.fnomin < 40.0
    assert 8.0 < -curve.kya / tyre.fnomin < 30.0
    still = magic_formula(tyre, 0.0, 0.0, tyre.fnomin, vx=20.0)
    assert (still.fx, still.fy, still.mz) == (0.0, 0.0, 0.0)


def test_there_are_bundled_tyres() -> None:
    assert TYRES

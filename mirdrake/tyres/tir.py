"""Tyre property files (.tir) of the Magic Formula 5.2, 6.1 and 6.2: read, checked, written.

A file has sections in brackets and lines ``NAME = value``, with comments after ``$`` or ``!``. Below a name in braces
or round brackets, as ``{radial width}`` or ``(COMMENTS)``, there are rows of a table or text, which are passed over
unless they are such lines; so are rows of numbers anywhere. Sections of one name are joined. A name that the formulas
use may be repeated with an equal value only. The units of the section [UNITS] hold for sizes, loads, stiffnesses and
speeds, which become SI; the coefficients have none.
Which formulas: FITTYP 5 (MF 5.0, without a difference in what is used here), 6, 21 or 52 for 5.2, 61, 62; without
FITTYP a PROPERTY_FILE_FORMAT of PAC2002 or MF_05 means 5.2.

Axes: PKY1 decides. It is negative in ISO-W axes (:mod:`mirdrake.tyres.magic_formula`), where a positive slip angle has
a negative side force; a positive one means other axes and is rejected. The sign of PDY1 has no meaning of its own: with
By = Kya / (Cy Dy), Fy = Dy sin(Cy atan(By x - ...)) is odd in Dy twice. PAC2002 files give PDY1 > 0 beside PKY1 < 0;
they are read as the equal tyre with PDY1 < 0. This negates muy and By, so what is multiplied by them is negated, too:
PDY2, RVY1 to RVY3 and QBZ10.

Names that the laws here do not use (inertia, contact patch, vertical behaviour, turn slip) are kept in the sections
whatever their values are, and their names in ``unused``.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import NamedTuple

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import shown
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters, Version

Text = str | float

_FIELDS = {field.name.upper(): field for field in fields(MagicFormulaParameters) if field.name != "version"}
_OLD_NAMES = {"LGAY": "LKYC", "LGAZ": "LKZC"}  # of 5.2
_VERSIONS: dict[float, Version] = {5: "5.2", 6: "5.2", 21: "5.2", 52: "5.2", 61: "6.1", 62: "6.2"}
_FORMATS = {"PAC2002", "MF_05", "MF-TYRE", "MF52"}

_UNITS: dict[str, dict[str, float]] = {
    "LENGTH": {
        "meter": 1.0,
        "m": 1.0,
        "mm": 1e-3,
        "millimeter": 1e-3,
        "cm": 1e-2,
        "km": 1e3,
        "inch": 0.0254,
        "foot": 0.3048,
    },
    "FORCE": {
        "newton": 1.0,
        "n": 1.0,
        "kilo_newton": 1e3,
        "kn": 1e3,
        "kg_force": GRAVITY,
        "pound_force": 4.4482216152605,
    },
    "MASS": {"kg": 1.0, "gram": 1e-3, "pound_mass": 0.45359237, "slug": 14.59390294},
    "TIME": {"second": 1.0, "sec": 1.0, "s": 1.0, "millisecond": 1e-3, "minute": 60.0, "hour": 3600.0},
    "ANGLE": {"radian": 1.0, "radians": 1.0, "rad": 1.0},
    "PRESSURE": {"pascal": 1.0, "pa": 1.0, "kpa": 1e3, "bar": 1e5, "psi": 6894.757293168},
}
_REQUIRED_UNITS = ("LENGTH", "FORCE", "TIME", "ANGLE")

# Dimension of the names that have one: powers of length, force, time, pressure.
_DIMENSIONS: dict[str, tuple[int, int, int, int]] = {
    "UNLOADED_RADIUS": (1, 0, 0, 0),
    "LONGVL": (1, 0, -1, 0),
    "VXLOW": (1, 0, -1, 0),
    "FNOMIN": (0, 1, 0, 0),
    "FZMIN": (0, 1, 0, 0),
    "FZMAX": (0, 1, 0, 0),
    "LONGITUDINAL_STIFFNESS": (-1, 1, 0, 0),
    "LATERAL_STIFFNESS": (-1, 1, 0, 0),
    "NOMPRES": (0, 0, 0, 1),
    "INFLPRES": (0, 0, 0, 1),
}
_SECTIONS = ("UNITS", "MODEL", "DIMENSION", "VERTICAL", "LONGITUDINAL_COEFFICIENTS", "LATERAL_COEFFICIENTS")
_POSITIVE = (
    "UNLOADED_RADIUS",
    "FNOMIN",
    "LONGVL",
    "VXLOW",
    "PCX1",
    "PDX1",
    "PKX1",
    "PCY1",
    "PKY2",
    "LMUX",
    "LMUY",
    "LFZO",
)
_NEGATIVE = ("PKY1",)
_TURNED_WITH_PDY1 = ("pdy1", "pdy2", "rvy1", "rvy2", "rvy3", "qbz10")
_NOT_NEGATIVE = ("FZMIN", "NOMPRES", "INFLPRES", "LONGITUDINAL_STIFFNESS", "LATERAL_STIFFNESS")

_HEADER = re.compile(r"\[\s*([^\]]+?)\s*\]\s*$")
_NUMBERS = re.compile(r"[-+\d.][-+\d.eEdD\s,]*$")
_ENTRY = re.compile(r"([A-Za-z_][\w.\-]*)\s*=\s*(.*)$")


class Entry(NamedTuple):
    """One line of a file.

    Attributes:
        value: number, or text of any other value, as it is in the file.
        line: its line, from 1.
    """

    value: Text
    line: int


@dataclass(frozen=True)
class TirFile:
    """A tyre property file.

    Attributes:
        name: what messages call it.
        sections: entries by section and name, both in upper case, in the order and the units of the file.
        parameters: what the Magic Formula needs, in SI units.
        unused: names of entries that no law here uses.
    """

    name: str
    sections: Mapping[str, Mapping[str, Entry]]
    parameters: MagicFormulaParameters
    unused: tuple[str, ...]


def read_tir(path: Path) -> TirFile:
    """Read and check a .tir file.

    Raises:
        ConfigError: it cannot be read, or something in it is wrong; one line for each fault, ``file:line: [SECTION]
            NAME: what is wrong``.
    """
    name = shown(path)
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise ConfigError(f"{name}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # comments of older tools
    return parse_tir(text, name=name)


def parse_tir(text: str, *, name: str = "<text>") -> TirFile:
    """The same from text."""
    faults: list[str] = []
    sections, lines = _parse(text, name, faults)
    _fail(faults)
    scales = _scales(sections, lines, name, faults)
    version = _version(sections, name, faults)
    missing = [section for section in _SECTIONS if section not in sections]
    faults += [f"{name}:1: [{section}]: missing section; the Magic Formula needs it" for section in missing]
    values: dict[str, float] = {}
    unused: list[str] = []
    seen: dict[str, int] = {}
    for section, key, entry in _entries(sections):
        known = _OLD_NAMES.get(key, key) if version == "5.2" else key
        if section == "UNITS" or key in {"FITTYP", "PROPERTY_FILE_FORMAT"}:
            continue
        if known not in _FIELDS:
            unused.append(key)
            continue
        place = f"{name}:{entry.line}: [{section}] {key}"
        if isinstance(entry.value, str):
            faults.append(f"{place}: expected a finite number, got '{_short(entry.value)}'")
        elif known in seen:
            if values.get(known.lower(), 0.0) != entry.value * _scale(known, scales):
                faults.append(f"{place}: has another value in line {seen[known]}; keep one of them")
            continue
        else:
            values[known.lower()] = entry.value * _scale(known, scales)
            faults += _range_fault(place, known, entry.value)
        seen[known] = entry.line
    if not missing:
        needed = (name for name, field in _FIELDS.items() if field.default is MISSING and name not in seen)
        faults += [f"{name}:1: {key}: missing; the Magic Formula needs it{_near(key, unused)}" for key in needed]
    _fail(faults)
    if values["pdy1"] > 0.0:
        values |= {key: -values[key] for key in _TURNED_WITH_PDY1 if key in values}
    parameters = MagicFormulaParameters(version=version, **values)
    if not parameters.fzmin < parameters.fzmax:
        _fail([f"{name}:{seen['FZMAX']}: FZMAX: must be larger than FZMIN, {parameters.fzmin:g} N"])
    return TirFile(name, sections, parameters, tuple(unused))


def write_tir(parameters: MagicFormulaParameters, *, comments: tuple[str, ...] = ()) -> str:
    """The text of a .tir file in SI units; :func:`parse_tir` gives equal parameters back.

    Args:
        parameters: what to write.
        comments: lines for the head of the file: source, grade, date.
    """
    lines = [f"! {comment}" for comment in comments]
    lines += ["[UNITS]", "LENGTH = 'meter'", "FORCE = 'newton'", "ANGLE = 'radians'", "MASS = 'kg'", "TIME = 'second'"]
    fittyp = {"5.2": 6, "6.1": 61, "6.2": 62}[parameters.version]
    opened = "UNITS"
    entries = [("MODEL", "FITTYP", float(fittyp))]
    entries += [(_section_of(key), key, getattr(parameters, key.lower())) for key in _FIELDS]
    order = list(dict.fromkeys(section for section, _, _ in entries))
    for section, key, value in sorted(entries, key=lambda entry: order.index(entry[0])):
        if not math.isfinite(value):
            continue  # FZMAX without a limit
        if section != opened:
            lines.append(f"[{section}]")
            opened = section
        lines.append(f"{key} = {value!r}")
    return "\n".join(lines) + "\n"


# --- lines -------------------------------------------------------------------------------------------------------


def _parse(text: str, name: str, faults: list[str]) -> tuple[dict[str, dict[str, Entry]], dict[str, int]]:
    """Entries by section, and the lines of the sections."""
    sections: dict[str, dict[str, Entry]] = {}
    lines: dict[str, int] = {}
    section, table = "", False
    for number, raw in enumerate(text.splitlines(), start=1):
        line = _without_comment(raw).strip()
        if not line:
            continue
        place = f"{name}:{number}"
        if header := _HEADER.match(line):
            section, table = header[1].upper(), False
            sections.setdefault(section, {})
            lines.setdefault(section, number)
        elif line[0] in "{(":
            table = True  # rows of numbers or text follow: shapes, load curves, comments
        elif not section:
            faults.append(f"{place}: '{_short(line)}' stands before the first [SECTION]")
        elif entry := _ENTRY.match(line):
            key, found = entry[1].upper(), Entry(_value(entry[2].strip()), number)
            first = sections[section].setdefault(key, found)
            used = key in _FIELDS or section in {"UNITS", "MODEL"}
            if used and str(first.value) != str(found.value):
                faults.append(f"{place}: [{section}] {key}: has another value in line {first.line}; keep one of them")
        elif not table and not _NUMBERS.match(line):
            faults.append(f"{place}: expected NAME = value, got '{_short(line)}'")
    return sections, lines


def _without_comment(line: str) -> str:
    """The line up to $ or !, unless they stand in quotes."""
    quote = ""
    for index, character in enumerate(line):
        if character in "'\"":
            quote = "" if character == quote else quote or character
        elif character in "$!" and not quote:
            return line[:index]
    return line


def _value(text: str) -> Text:
    """Return the number of a line, or its text without quotes if it is not a finite number."""
    if len(text) > 1 and text[0] in "'\"" and text[-1] == text[0]:
        return text[1:-1].strip()
    number = _number(text)
    return number if math.isfinite(number) and "_" not in text else text


def _number(text: str) -> float:
    """Return the number of a text, also with the exponent of Fortran (1.0D-3); infinity if it is not a number."""
    try:
        return float(re.sub(r"(?<=[\d.])[dD](?=[+-]?\d)", "e", text))
    except ValueError:
        return math.inf


def _short(text: str) -> str:
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 40 else f"{text[:39]}…"


def _entries(sections: Mapping[str, Mapping[str, Entry]]) -> Iterator[tuple[str, str, Entry]]:
    for section, entries in sections.items():
        for key, entry in entries.items():
            yield section, key, entry


# --- meaning -----------------------------------------------------------------------------------------------------


def _scales(
    sections: Mapping[str, Mapping[str, Entry]], lines: Mapping[str, int], name: str, faults: list[str]
) -> dict[str, float]:
    """SI value of each unit of the file."""
    scales = {"PRESSURE": 1.0}
    units = sections.get("UNITS", {})
    for kind, allowed in _UNITS.items():
        entry = units.get(kind)
        if entry is None:
            if kind in _REQUIRED_UNITS and "UNITS" in sections:
                faults.append(f"{name}:{lines['UNITS']}: [UNITS] {kind}: missing; {did_you_mean('', allowed)}")
            continue
        word = str(entry.value).lower()
        if word not in allowed:
            why = "; the coefficients are defined for radians only" if kind == "ANGLE" else ""
            told = f"unknown unit '{_short(str(entry.value))}'{why}; {did_you_mean(word, allowed)}"
            faults.append(f"{name}:{entry.line}: [UNITS] {kind}: {told}")
        else:
            scales[kind] = allowed[word]
    return scales


def _scale(key: str, scales: Mapping[str, float]) -> float:
    powers = _DIMENSIONS.get(key, (0, 0, 0, 0))
    kinds = ("LENGTH", "FORCE", "TIME", "PRESSURE")
    return math.prod(scales.get(kind, 1.0) ** power for kind, power in zip(kinds, powers, strict=True))


def _version(sections: Mapping[str, Mapping[str, Entry]], name: str, faults: list[str]) -> Version:
    model = sections.get("MODEL", {})
    if entry := model.get("FITTYP"):
        if isinstance(entry.value, float) and entry.value in _VERSIONS:
            return _VERSIONS[entry.value]
        told = entry.value if isinstance(entry.value, str) else f"{entry.value:g}"
        faults.append(f"{name}:{entry.line}: [MODEL] FITTYP: unknown '{told}'; known: 5, 6, 21, 52 (MF 5.2), 61, 62")
    elif entry := model.get("PROPERTY_FILE_FORMAT"):
        if str(entry.value).upper() in _FORMATS:
            return "5.2"
        told = f"unknown '{_short(str(entry.value))}' without FITTYP; {did_you_mean(entry.value, _FORMATS)}"
        faults.append(f"{name}:{entry.line}: [MODEL] PROPERTY_FILE_FORMAT: {told}")
    elif "MODEL" in sections:
        faults.append(f"{name}:1: [MODEL] FITTYP: missing; give 61, 62 or, for MF 5.2, 6")
    return "6.1"


def _range_fault(place: str, key: str, value: float) -> list[str]:
    if key in _POSITIVE and value <= 0.0:
        return [f"{place}: must be positive, got {value:g}"]
    if key in _NOT_NEGATIVE and value < 0.0:
        return [f"{place}: must not be negative, got {value:g}"]
    if key in _NEGATIVE and value >= 0.0:
        why = "files in ISO-W axes have it negative; a positive one is for y to the right (adapted SAE)"
        return [f"{place}: must be negative, got {value:g}; {why}"]
    return []


def _near(key: str, unused: list[str]) -> str:
    close = [
        name for name in unused if len(name) == len(key) and sum(a != b for a, b in zip(name, key, strict=True)) == 1
    ]
    return f"; is '{close[0]}' meant?" if close else ""


def _section_of(key: str) -> str:
    """The section in which :func:`write_tir` puts a name, as MF-Tyre does."""
    fixed = {
        "UNLOADED_RADIUS": "DIMENSION",
        "LONGVL": "MODEL",
        "VXLOW": "MODEL",
        "FNOMIN": "VERTICAL",
        "NOMPRES": "OPERATING_CONDITIONS",
        "INFLPRES": "OPERATING_CONDITIONS",
        "FZMIN": "VERTICAL_FORCE_RANGE",
        "FZMAX": "VERTICAL_FORCE_RANGE",
    }
    starts = {
        "L": "SCALING_COEFFICIENTS",
        "QSX": "OVERTURNING_COEFFICIENTS",
        "PPM": "OVERTURNING_COEFFICIENTS",
        "QSY": "ROLLING_COEFFICIENTS",
        "Q": "ALIGNING_COEFFICIENTS",
        "S": "ALIGNING_COEFFICIENTS",
        "PPZ": "ALIGNING_COEFFICIENTS",
        "PCF": "STRUCTURAL",
        "PTX": "STRUCTURAL",
        "PTY": "STRUCTURAL",
    }
    if key.endswith("_STIFFNESS"):
        return "STRUCTURAL"
    if key in fixed:
        return fixed[key]
    for start in sorted(starts, key=len, reverse=True):
        if key.startswith(start):
            return starts[start]
    along = "X" in key[:3] or key in {"RHX1", "REX1", "REX2", "RCX1"}
    return "LONGITUDINAL_COEFFICIENTS" if along else "LATERAL_COEFFICIENTS"


def _fail(faults: list[str]) -> None:
    if faults:
        raise ConfigError("\n".join(faults))

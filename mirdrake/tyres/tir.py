"""Tyre property files (.tir) of the Magic Formula 5.2, 6.1 and 6.2: read, check and write.

A file has sections in brackets and lines ``NAME = value``, with comments after ``$`` or ``!``. Rows of a table or text
follow a name in braces or round brackets, as ``{radial width}`` or ``(COMMENTS)``; they are ignored, and so are rows of
numbers anywhere. Sections of the same name are merged. A name that the formulas use may be repeated with an equal value
only. An entry without a value counts as left out if the formulas have a default for it; a line of words after a comment
continues that comment. The units of the section [UNITS] hold for sizes, loads, stiffnesses and speeds, which are
converted to SI; coefficients have no units. FITTYP selects the version of the formulas: 5 (MF 5.0, without a difference
in the formulas used here), 6, 21 or 52 for 5.2; 61; 62. Without FITTYP a PROPERTY_FILE_FORMAT of PAC2002 or MF_05 means
5.2.

Axes: PKY1 decides. It is negative in ISO-W axes (:mod:`mirdrake.tyres.magic_formula`), where a positive slip angle has
a negative side force; a positive one means other axes and is rejected. The sign of PDY1 has no meaning: with
By = Kya / (Cy Dy), Fy = Dy sin(Cy atan(By x - ...)) does not change with the sign of Dy. PAC2002 files have PDY1 > 0
with PKY1 < 0; they are read as the equal tyre with PDY1 < 0. This negates muy and By, so their factors are negated,
too: PDY2, RVY1 to RVY3 and QBZ10.

Names that the model does not use (inertia, contact patch, turn slip, effects on the vertical force) are kept in the
sections, whatever their values are, and listed in ``unused``.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import NamedTuple

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, did_you_mean, printable
from mirdrake.core.yaml_io import display_path
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters, Version

Text = str | float

_FIELDS = {field.name.upper(): field for field in fields(MagicFormulaParameters) if field.name != "version"}
_OLD_NAMES = {"LGAY": "LKYC", "LGAZ": "LKZC"}  # names in 5.2
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

# Dimensions of names with units: powers of length, force, time, pressure.
_DIMENSIONS: dict[str, tuple[int, int, int, int]] = {
    "UNLOADED_RADIUS": (1, 0, 0, 0),
    "LONGVL": (1, 0, -1, 0),
    "VXLOW": (1, 0, -1, 0),
    "FNOMIN": (0, 1, 0, 0),
    "FZMIN": (0, 1, 0, 0),
    "FZMAX": (0, 1, 0, 0),
    "LONGITUDINAL_STIFFNESS": (-1, 1, 0, 0),
    "LATERAL_STIFFNESS": (-1, 1, 0, 0),
    "VERTICAL_STIFFNESS": (-1, 1, 0, 0),
    "VERTICAL_DAMPING": (-1, 1, 1, 0),
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
_NEGATED_WITH_PDY1 = ("pdy1", "pdy2", "rvy1", "rvy2", "rvy3", "qbz10")
_NOT_NEGATIVE = (
    "FZMIN",
    "NOMPRES",
    "INFLPRES",
    "LONGITUDINAL_STIFFNESS",
    "LATERAL_STIFFNESS",
    "VERTICAL_STIFFNESS",
    "VERTICAL_DAMPING",
)

_HEADER = re.compile(r"\[\s*([^\]]+?)\s*\]\s*$")
_NUMBERS = re.compile(r"[-+\d.][-+\d.eEdD\s,]*$")
_WORDS = re.compile(r"[^\W\d][^\d=\[\]{}()]*$")
_ENTRY = re.compile(r"([A-Za-z_][\w.\-]*)\s*=\s*(.*)$")


class Entry(NamedTuple):
    """Entry of a file.

    Attributes:
        value: number, or text of any other value, as in the file.
        line: line number, from 1.
    """

    value: Text
    line: int


@dataclass(frozen=True)
class TirFile:
    """Tyre property file.

    Attributes:
        name: name for messages.
        sections: entries by section and name, both in upper case, in the order and units of the file.
        parameters: parameters of the Magic Formula, in SI units.
        unused: names of entries that the model does not use.
    """

    name: str
    sections: Mapping[str, Mapping[str, Entry]]
    parameters: MagicFormulaParameters
    unused: tuple[str, ...]


def read_tir(path: Path) -> TirFile:
    """Read and check a .tir file.

    Raises:
        ConfigError: the file cannot be read, or has errors; one line for each, ``file:line: [SECTION]
            NAME: what is wrong``.
    """
    name = display_path(path)
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise ConfigError(f"cannot be read: {getattr(error, 'strerror', None) or error}", where=name) from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # comments of older tools
    return parse_tir(text, name=name)


def parse_tir(text: str, *, name: str = "<text>") -> TirFile:
    """Parse and check the text of a .tir file; see :func:`read_tir`."""
    # Sections, units and version.
    # Broken lines are reported first, since everything below would only repeat them.
    faults: list[ConfigError] = []
    sections, lines = _parse(text, name, faults)
    _raise_faults(faults)
    # Other tyre models have other sections and units: nothing else about them helps.
    version = _version(sections, name, faults)
    _raise_faults(faults)
    scales = _scales(sections, lines, name, faults)
    missing = [section for section in _SECTIONS if section not in sections]
    faults += [_fault("missing section; the Magic Formula needs it", name, 1, section) for section in missing]
    # Values of known names in SI units; errors are collected.
    values: dict[str, float] = {}
    unused: list[str] = []
    seen: dict[str, int] = {}
    for section, key, entry in _entries(sections):
        known = _OLD_NAMES.get(key, key) if version == "5.2" else key
        # Keys without a coefficient, which are read for units and version.
        if section == "UNITS" or key in {"FITTYP", "PROPERTY_FILE_FORMAT"}:
            continue
        if known not in _FIELDS:
            unused.append(key)
            continue
        location = name, entry.line, section, key
        if entry.value == "" and _FIELDS[known].default is not MISSING:
            continue
        if isinstance(entry.value, str):
            faults.append(_fault(f"expected a finite number, got '{_short(entry.value)}'", *location))
        elif known in seen:
            if values.get(known.lower(), 0.0) != entry.value * _scale(known, scales):
                faults.append(_fault(f"has another value in line {seen[known]}; keep one of them", *location))
            continue
        else:
            values[known.lower()] = entry.value * _scale(known, scales)
            faults += [_fault(text, *location) for text in _range_fault(known, entry.value)]
        seen[known] = entry.line
    # Coefficients without a default must be in the file.
    if not missing:
        needed = (name for name, field in _FIELDS.items() if field.default is MISSING and name not in seen)
        faults += [
            _fault(f"missing; the Magic Formula needs it{_near(key, unused)}", name, 1, key=key) for key in needed
        ]
    _raise_faults(faults)
    # PAC2002 files have a positive PDY1; see the head of the module.
    if values["pdy1"] > 0.0:
        values |= {key: -values[key] for key in _NEGATED_WITH_PDY1 if key in values}
    parameters = MagicFormulaParameters(version=version, **values)
    if not parameters.fzmin < parameters.fzmax:
        raise _fault(f"must be larger than FZMIN, {parameters.fzmin:g} N", name, seen["FZMAX"], key="FZMAX")
    return TirFile(name, sections, parameters, tuple(unused))


# --- lines -------------------------------------------------------------------------------------------------------


_ENDS = "\x1a\0"  # Ctrl-Z or zeros that old programs write at the end of a file


def _parse(text: str, name: str, faults: list[ConfigError]) -> tuple[dict[str, dict[str, Entry]], dict[str, int]]:
    """Return the entries by section, and the lines of the sections."""
    sections: dict[str, dict[str, Entry]] = {}
    lines: dict[str, int] = {}
    section, table, remark = "", False, False
    # The grammar is loose: many tools write these files, so that only keys that are used are checked.
    for number, raw in enumerate(text.splitlines(), start=1):
        bare = _without_comment(raw)
        line = bare.strip(_ENDS).strip()
        # A long comment may have been broken into lines.
        if remark and _WORDS.match(line):
            continue
        remark = len(bare) < len(raw)
        if not line:
            continue
        if header := _HEADER.match(line):
            section, table = header[1].upper(), False
            sections.setdefault(section, {})
            lines.setdefault(section, number)
        elif line[0] in "{(":
            table = True  # rows of numbers or text follow: shapes, load curves, comments
        elif not section:
            faults.append(_fault(f"'{_short(line)}' is before the first [SECTION]", name, number))
        elif entry := _ENTRY.match(line):
            key, new_entry = entry[1].upper(), Entry(_value(entry[2].strip()), number)
            first = sections[section].setdefault(key, new_entry)
            # The first value wins; a repeated key matters only if it is used.
            used = key in _FIELDS or section in {"UNITS", "MODEL"}
            if used and str(first.value) != str(new_entry.value):
                text = f"has another value in line {first.line}; keep one of them"
                faults.append(_fault(text, name, number, section, key))
        elif not table and not _NUMBERS.match(line):
            faults.append(_fault(f"expected NAME = value, got '{_short(line)}'", name, number))
    return sections, lines


def _without_comment(line: str) -> str:
    """Return a line up to $ or ! outside of quotes."""
    # Quoted texts, such as file names, may contain $ and !.
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
    # Python accepts 1_000 as a number, the format does not.
    number = _number(text)
    return number if math.isfinite(number) and "_" not in text else text


def _number(text: str) -> float:
    """Return the number of a text, also with the exponent of Fortran (1.0D-3); infinity if it is not a number."""
    try:
        return float(re.sub(r"(?<=[\d.])[dD](?=[+-]?\d)", "e", text))
    except ValueError:
        return math.inf


def _short(text: str) -> str:
    text = printable(text, "?")
    return text if len(text) <= 40 else f"{text[:39]}…"


def _entries(sections: Mapping[str, Mapping[str, Entry]]) -> Iterator[tuple[str, str, Entry]]:
    for section, entries in sections.items():
        for key, entry in entries.items():
            yield section, key, entry


# --- meaning -----------------------------------------------------------------------------------------------------


def _scales(
    sections: Mapping[str, Mapping[str, Entry]], lines: Mapping[str, int], name: str, faults: list[ConfigError]
) -> dict[str, float]:
    """Return the SI value of each unit of the file."""
    # A file without a unit of pressure is in SI.
    scales = {"PRESSURE": 1.0}
    units = sections.get("UNITS", {})
    for kind, allowed in _UNITS.items():
        entry = units.get(kind)
        if entry is None:
            if kind in _REQUIRED_UNITS and "UNITS" in sections:
                faults.append(_fault(f"missing; {did_you_mean('', allowed)}", name, lines["UNITS"], "UNITS", kind))
            continue
        word = str(entry.value).lower()
        if word not in allowed:
            why = "; the coefficients are defined for radians only" if kind == "ANGLE" else ""
            message = f"unknown unit '{_short(str(entry.value))}'{why}; {did_you_mean(word, allowed)}"
            faults.append(_fault(message, name, entry.line, "UNITS", kind))
        else:
            scales[kind] = allowed[word]
    return scales


def _scale(key: str, scales: Mapping[str, float]) -> float:
    powers = _DIMENSIONS.get(key, (0, 0, 0, 0))
    kinds = ("LENGTH", "FORCE", "TIME", "PRESSURE")
    return math.prod(scales.get(kind, 1.0) ** power for kind, power in zip(kinds, powers, strict=True))


def _version(sections: Mapping[str, Mapping[str, Entry]], name: str, faults: list[ConfigError]) -> Version:
    model = sections.get("MODEL", {})
    # FITTYP is the reliable statement; the format of the file is only a hint.
    if entry := model.get("FITTYP"):
        number = entry.value if isinstance(entry.value, float) else _number(entry.value)
        if number in _VERSIONS:
            return _VERSIONS[number]
        given = entry.value if isinstance(entry.value, str) else f"{entry.value:g}"
        message = f"unknown '{given}'; known: 5, 6, 21, 52 (MF 5.2), 61, 62"
        faults.append(_fault(message, name, entry.line, "MODEL", "FITTYP"))
    elif entry := model.get("PROPERTY_FILE_FORMAT"):
        if str(entry.value).upper() in _FORMATS:
            return "5.2"
        known = ", ".join(sorted(_FORMATS))
        message = f"unknown '{_short(str(entry.value))}' without FITTYP; only the Magic Formula is read: {known}"
        faults.append(_fault(message, name, entry.line, "MODEL", "PROPERTY_FILE_FORMAT"))
    elif "MODEL" in sections:
        faults.append(_fault("missing; give 61, 62 or, for MF 5.2, 6", name, 1, "MODEL", "FITTYP"))
    return "6.1"


def _range_fault(key: str, value: float) -> list[str]:
    if key in _POSITIVE and value <= 0.0:
        return [f"must be positive, got {value:g}"]
    if key in _NOT_NEGATIVE and value < 0.0:
        return [f"must not be negative, got {value:g}"]
    if key in _NEGATIVE and value >= 0.0:
        why = "files in ISO-W axes have it negative; a positive one is for y to the right (adapted SAE)"
        return [f"must be negative, got {value:g}; {why}"]
    return []


def _near(key: str, unused: list[str]) -> str:
    # One wrong character: the usual misprint of a coefficient.
    close = [
        name for name in unused if len(name) == len(key) and sum(a != b for a, b in zip(name, key, strict=True)) == 1
    ]
    return f"; is '{close[0]}' meant?" if close else ""


def _fault(text: str, name: str, line: int, section: str = "", key: str = "") -> ConfigError:
    """Return the error of an entry, whose path in messages is ``[SECTION] KEY``."""
    path = " ".join(filter(None, [section and f"[{section}]", key]))
    return ConfigError(text, file=name, line=line, path=(path,) if path else ())


def _raise_faults(faults: list[ConfigError]) -> None:
    if faults:
        raise ConfigError(faults=faults)

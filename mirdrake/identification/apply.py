"""Write fitted parameters into the vehicle.yaml of a vehicle: the value, and its source in ``sources``."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from mirdrake.core.errors import ConfigError, printable
from mirdrake.core.yaml_edit import REMOVED, Edit, value_at
from mirdrake.core.yaml_io import any_to_si, display_path, parse_tree, parse_yaml, read_text, validate
from mirdrake.identification.fit import Fit, FittedParameter
from mirdrake.tyres import TYRES
from mirdrake.vehicles.file_change import FileChange, change_file
from mirdrake.vehicles.spec import ControlSpec, VariantSpec, VehicleSpec
from mirdrake.vehicles.vehicle import find_vehicle, load_part, load_variant, variants

DIGITS = 5
"""Number of significant digits written."""


@dataclass(frozen=True)
class YamlEntry:
    """Entry of a parameter in vehicle.yaml.

    Attributes:
        path: dotted path.
        unit: unit that the fit must have.
        factor: value in the file over fitted value.
        tyres: kinds of tyres that have the entry; empty for any.
        periods: whether the value must be a whole number of controller periods.
    """

    path: str
    unit: str
    factor: float = 1.0
    tyres: tuple[str, ...] = ()
    periods: bool = False


YAML_ENTRIES = {
    "rolling_resistance": YamlEntry("tyres.rolling_resistance", "1"),
    "drag_area": YamlEntry("aerodynamics.drag_area", "m^2"),
    "steering_ratio": YamlEntry("steering.ratio", "1"),
    "steering_lag": YamlEntry("actuators.steering.time_constant", "s"),
    "steering_delay": YamlEntry("actuators.steering.delay", "s", periods=True),
    "drive_lag": YamlEntry("actuators.throttle.time_constant", "s"),
    "drive_delay": YamlEntry("actuators.throttle.delay", "s", periods=True),
    "brake_lag": YamlEntry("actuators.brake.time_constant", "s"),
    "brake_delay": YamlEntry("actuators.brake.delay", "s", periods=True),
}
"""Parameters with an entry in vehicle.yaml, without those of a kind of tyres (:attr:`mirdrake.tyres.Tyres.fitted`)."""

URDF_PARAMETERS = {
    "mass": "follows from the bodies of the URDF; change them in the xacro files",
    "yaw_inertia": "follows from the bodies of the URDF; change them in the xacro files",
    "front_length": "follows from the bodies of the URDF; change them in the xacro files",
    "rear_length": "follows from the bodies of the URDF; change them in the xacro files",
    "wheelbase": "follows from the joints of the URDF; change them in the xacro files",
}
"""Parameters that follow from the URDF."""


@dataclass(frozen=True)
class FitChange:
    """Changes of a vehicle folder by a fit.

    Attributes:
        files: one change per file.
        skipped: parameters that are not written, with the reason, a line each.
        notes: remarks on those that are written, a line each.
    """

    files: tuple[FileChange, ...]
    skipped: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def changes(self) -> bool:
        """Whether there is anything to write."""
        return any(change.changes for change in self.files)


def plan_apply(fit: Fit, vehicle: str, *, today: date | None = None, force: bool = False) -> FitChange:
    """Return the changes of the files of a vehicle by a fit.

    Parameters that were fixed, are only weakly identified, are not identifiable, are at a bound, or have no entry in
    vehicle.yaml are skipped and listed in :attr:`FitChange.skipped`.

    Args:
        fit: the fit.
        vehicle: name or folder; with ``@<variant>``, entries of the variant are changed in its own file.
        today: date for the source; by default the current date, UTC.
        force: write weakly identified parameters as well.

    Raises:
        ConfigError: unknown vehicle, its files do not load, or an entry does not fit.
    """
    folder = _Folder(vehicle)
    left: list[str] = []
    notes: list[str] = []
    edits: dict[Path, list[Edit]] = {}
    # Values that are fixed, uncertain or without a place in the files stay as they are, each with its reason.
    for parameter in fit.parameters:
        reason = _skip_reason(parameter, folder, force=force)
        if reason:
            left.append(f"{parameter.name}: not written: {reason}")
            continue
        entry = find_entry(parameter.name, folder.tyres)
        assert entry is not None  # or there would be a reason
        # Controllers apply delays in whole periods.
        value = entry.factor * parameter.value
        if entry.periods:
            rounded = round(value * folder.rate) / folder.rate
            period = 1.0 / folder.rate
            notes.append(f"{parameter.name}: {value:.4g} s is rounded to {rounded:g} s, whole periods of {period:g} s")
            value = rounded
        # More digits than the interval supports would only suggest an accuracy that the fit does not have.
        value = float(f"{value:.{DIGITS}g}")
        path, prefix, current = folder.find(entry.path)
        # Nothing is written for an equal value, so that its source and comments stay.
        if isinstance(current, int | float) and math.isclose(current, value, rel_tol=1e-12):
            continue
        # A verdict other than "identified" goes into the notes, so that the user decides with it in view.
        if parameter.verdict != "identified":
            notes.append(
                f"{parameter.name}: {parameter.verdict}{f' ({parameter.explanation})' if parameter.explanation else ''}"
            )
        # A number without its source would lose where it came from: both are written together.
        keys = entry.path.split(".")
        edits.setdefault(path, []).extend(
            [
                Edit((*prefix, *keys), value),
                Edit(
                    (*prefix, "sources", entry.path),
                    source_text(fit, parameter, entry, today or datetime.now(UTC).date()),
                ),
            ]
        )
    changes = [change_file(path, file_edits, check=folder.checker(path)) for path, file_edits in edits.items()]
    return FitChange(tuple(changes), tuple(left), tuple(notes))


def find_entry(parameter: str, tyres: str) -> YamlEntry | None:
    """Return the entry of a parameter in vehicle.yaml; None if it has none.

    Args:
        parameter: name of the parameter.
        tyres: kind of tyres of the vehicle; its entries come first.
    """
    for kind in sorted(TYRES, key=lambda kind: kind != tyres):
        if entry := TYRES[kind].fitted.get(parameter):
            kinds = tuple(other for other in TYRES if parameter in TYRES[other].fitted)
            return YamlEntry(f"tyres.{entry.path}", entry.unit, entry.factor, kinds)
    return YAML_ENTRIES.get(parameter)


def source_text(fit: Fit, parameter: FittedParameter, place: YamlEntry, today: date) -> str:
    """Return the text for ``sources`` of a fitted value."""
    parts = [f"identified {today.isoformat()}: fit {fit.name}"]
    if parameter.low is not None and parameter.high is not None:
        parts.append(f"95 % interval {place.factor * parameter.low:.4g} to {place.factor * parameter.high:.4g}")
    if parameter.verdict != "identified":
        parts.append(parameter.verdict)
    if fit.data_sha256:
        parts.append(f"data sha256 {fit.data_sha256[:16]}")
    # Names from a study may have line breaks, which would break the YAML text.
    return printable(", ".join(parts), " ")


def _skip_reason(parameter: FittedParameter, folder: "_Folder", *, force: bool) -> str:
    """Return why a parameter is not written; empty if it is."""
    # The order matters: the first reason is the most fundamental one.
    if parameter.kind == "fixed":
        return "it was fixed"
    if parameter.verdict == "not identifiable":
        return f"not identifiable from these data{f' ({parameter.explanation})' if parameter.explanation else ''}"
    if parameter.at_bound is not None:
        return f"the estimate is at its {'lower' if parameter.at_bound == 'low' else 'upper'} bound"
    if parameter.name in URDF_PARAMETERS:
        return URDF_PARAMETERS[parameter.name]
    entry = find_entry(parameter.name, folder.tyres)
    if entry is None:
        return "vehicle.yaml has no entry for it"
    if _unit(parameter.unit) != _unit(entry.unit):
        return f"its unit is {parameter.unit or '1'}, that of {entry.path} is {entry.unit}; fit with a known mass"
    if entry.tyres and folder.tyres not in entry.tyres:
        return f"the tyres are of kind {folder.tyres}; only {' and '.join(entry.tyres)} has {entry.path}"
    if not math.isfinite(parameter.value) or (entry.periods and parameter.value < 0.0):
        return f"{parameter.value:g} is not possible there"
    if folder.find(entry.path.rpartition(".")[0])[2] is None and entry.tyres:
        return f"{entry.path.rpartition('.')[0]} is missing in the file and needs further values"
    # Last, as it is the only reason that --force overrides.
    if parameter.verdict == "weakly identified" and not force:
        value = f"{parameter.value:.4g} {entry.unit}{_interval(parameter)}"
        why = f" ({parameter.explanation})" if parameter.explanation else ""
        return f"only weakly identified: {value}{why}; --force writes it"
    return ""


def _interval(parameter: FittedParameter) -> str:
    """Return the 95 % interval of a parameter in words; empty without one."""
    if parameter.low is None or parameter.high is None:
        return ""
    return f", 95 % interval {parameter.low:.4g} to {parameter.high:.4g}"


def _unit(text: str) -> str:
    return (text or "1").replace("²", "^2").replace("-", "1").replace(" ", "")


class _Folder:
    """Files of a vehicle, and which of them holds an entry."""

    def __init__(self, name: str) -> None:
        self.folder, self.variant = find_vehicle(name)
        self.change = load_variant(self.folder, self.variant)
        self.base = self.folder / "vehicle.yaml"
        self.tyres = load_part(self.folder, "vehicle", VehicleSpec, self.change).tyres.kind
        self.rate = load_part(self.folder, "control", ControlSpec, self.change).rate
        self.data, _ = parse_tree(read_text(self.base), display_path(self.base))

    def find(self, path: str) -> tuple[Path, tuple[str, ...], Any]:
        """Return file, prefix in it, and value in SI units of an entry; None if it has no value yet."""
        keys = path.split(".")
        over = value_at(self.change.vehicle, keys)
        under = value_at(self.data, keys)
        section = self.change.vehicle.get(keys[0])
        # A variant with another kind of a section replaces it as a whole, so its entries belong to the variant's file.
        replaced = isinstance(section, dict) and section.get("kind") not in {None, _kind(self.data.get(keys[0]))}
        if self.variant is not None and (over is not REMOVED or replaced):
            return variants(self.folder)[self.variant], ("vehicle",), None if over is REMOVED else _si(over)
        return self.base, (), None if under is REMOVED else _si(under)

    def checker(self, path: Path) -> Callable[[str], None]:
        """Return a function that rejects a text of a file with which the vehicle would not load."""

        def check(text: str) -> None:
            name = display_path(path)
            if path == self.base:
                data, source = parse_tree(text, name)
                validate(data, VehicleSpec, source)
            else:
                load_part(self.folder, "vehicle", VehicleSpec, parse_yaml(text, VariantSpec, name=name))

        return check


def _kind(data: Any) -> Any:
    return data.get("kind") if isinstance(data, dict) else None


def _si(value: Any) -> Any:
    return any_to_si(value) if isinstance(value, str) else value


def describe(change: FitChange) -> Sequence[str]:
    """Return notes and skipped parameters as lines."""
    return [*(f"note: {note}" for note in change.notes), *change.skipped]


def read_fit(path: Path | str) -> Fit:
    """Load a saved fit from its folder or the fit.json in it.

    Raises:
        ConfigError: the file does not exist, or is invalid.
    """
    from mirdrake.identification.fit import load_fit

    path = Path(path)
    if not path.exists():
        raise ConfigError(
            "no such folder; give the folder that mirdrake identify has written", where=display_path(path)
        )
    return load_fit(path.parent if path.name == "fit.json" else path)

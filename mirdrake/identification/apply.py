"""Fitted parameters into the vehicle.yaml of a vehicle: the value, and in ``sources`` where it is from."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_edit import REMOVED, Edit, value_at
from mirdrake.core.yaml_io import any_to_si, parse_tree, parse_yaml, read_text, shown, validate
from mirdrake.identification.fit import Fit, FittedParameter
from mirdrake.vehicles.file_change import FileChange, change_file
from mirdrake.vehicles.spec import ControlSpec, VariantSpec, VehicleSpec
from mirdrake.vehicles.vehicle import find_vehicle, load_part, load_variant, variants

DIGITS = 5
"""Significant digits that are written."""


@dataclass(frozen=True)
class Place:
    """Where a parameter stands in vehicle.yaml.

    Attributes:
        path: dotted path.
        unit: that the fit must have.
        factor: value there over fitted value.
        tyres: kind of tyres that has it; empty: any.
        periods: whether it must be a whole number of periods of the controllers.
    """

    path: str
    unit: str
    factor: float = 1.0
    tyres: str = ""
    periods: bool = False


YAML_ENTRIES = {
    "cornering_stiffness_front": Place("tyres.front.cornering_stiffness", "N/rad", 0.5, "brush"),
    "cornering_stiffness_rear": Place("tyres.rear.cornering_stiffness", "N/rad", 0.5, "brush"),
    "friction_front": Place("tyres.front.friction", "1", 1.0, "brush"),
    "friction_rear": Place("tyres.rear.friction", "1", 1.0, "brush"),
    "rolling_resistance": Place("tyres.rolling_resistance", "1"),
    "drag_area": Place("aerodynamics.drag_area", "m^2"),
    "steering_ratio": Place("steering.ratio", "1"),
    "steering_lag": Place("actuators.steering.time_constant", "s"),
    "steering_delay": Place("actuators.steering.delay", "s", periods=True),
    "drive_lag": Place("actuators.throttle.time_constant", "s"),
    "drive_delay": Place("actuators.throttle.delay", "s", periods=True),
    "brake_lag": Place("actuators.brake.time_constant", "s"),
    "brake_delay": Place("actuators.brake.delay", "s", periods=True),
}
"""Of the parameters that vehicle.yaml has words for; a stiffness of an axle is that of two tyres."""

URDF_PARAMETERS = {
    "mass": "follows from the bodies of the URDF; change them in the xacro files",
    "yaw_inertia": "follows from the bodies of the URDF; change them in the xacro files",
    "front_length": "follows from the bodies of the URDF; change them in the xacro files",
    "rear_length": "follows from the bodies of the URDF; change them in the xacro files",
}
"""Parameters that stand in the model itself."""


@dataclass(frozen=True)
class FitChange:
    """What a fit changes in a vehicle folder.

    Attributes:
        files: one change a file.
        skipped: what is not written, and why, a line each.
        notes: of what is written, a line each.
    """

    files: tuple[FileChange, ...]
    skipped: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def changes(self) -> bool:
        """Whether there is anything to write."""
        return any(change.changes for change in self.files)


def plan_apply(fit: Fit, vehicle: str, *, today: date | None = None) -> FitChange:
    """The change to the files of a vehicle that a fit asks for.

    Parameters that were fixed, are not identifiable, stand at a bound, or have no place in vehicle.yaml are left out;
    :attr:`FitChange.skipped` says so.

    Args:
        fit: the fit.
        vehicle: name or folder, with ``@<variant>`` for what the variant's own file says.
        today: for the source; by default the date of now, UTC.

    Raises:
        ConfigError: no such vehicle, its files do not load, or an entry does not fit.
    """
    folder = _Folder(vehicle)
    left: list[str] = []
    notes: list[str] = []
    edits: dict[Path, list[Edit]] = {}
    for one in fit.parameters:
        reason = _skip_reason(one, folder)
        if reason:
            left.append(f"{one.name}: not written: {reason}")
            continue
        place = YAML_ENTRIES[one.name]
        value = place.factor * one.value
        if place.periods:
            rounded = round(value * folder.rate) / folder.rate
            notes.append(f"{one.name}: {value:.4g} s becomes {rounded:g} s: whole periods of {1.0 / folder.rate:g} s")
            value = rounded
        value = float(f"{value:.{DIGITS}g}")
        path, prefix, stands = folder.find(place.path)
        if isinstance(stands, int | float) and math.isclose(stands, value, rel_tol=1e-12):
            continue
        if one.verdict != "identified":
            notes.append(f"{one.name}: {one.verdict}{f' ({one.explanation})' if one.explanation else ''}")
        keys = place.path.split(".")
        edits.setdefault(path, []).extend(
            [
                Edit((*prefix, *keys), value),
                Edit((*prefix, "sources", place.path), source_text(fit, one, place, today or datetime.now(UTC).date())),
            ]
        )
    changes = [change_file(path, found, check=folder.checker(path)) for path, found in edits.items()]
    return FitChange(tuple(changes), tuple(left), tuple(notes))


def source_text(fit: Fit, one: FittedParameter, place: Place, today: date) -> str:
    """What ``sources`` says of a fitted value."""
    parts = [f"identified {today.isoformat()}: fit {fit.name}"]
    if one.low is not None and one.high is not None:
        parts.append(f"95 % interval {place.factor * one.low:.4g} to {place.factor * one.high:.4g}")
    if one.verdict != "identified":
        parts.append(one.verdict)
    if fit.data_sha256:
        parts.append(f"data sha256 {fit.data_sha256[:16]}")
    return "".join(letter if letter.isprintable() else " " for letter in ", ".join(parts))


def _skip_reason(one: FittedParameter, folder: "_Folder") -> str:
    """Why a parameter is not written; empty if it is."""
    if one.kind == "fixed":
        return "it was fixed"
    if one.verdict == "not identifiable":
        return f"not identifiable from these data{f' ({one.explanation})' if one.explanation else ''}"
    if one.at_bound is not None:
        return f"the estimate stands at its {one.at_bound}er bound".replace("higher", "upper")
    if one.name in URDF_PARAMETERS:
        return URDF_PARAMETERS[one.name]
    place = YAML_ENTRIES.get(one.name)
    if place is None:
        return "vehicle.yaml has no entry for it"
    if _unit(one.unit) != _unit(place.unit):
        return f"it is in {one.unit or '1'}, and {place.path} is in {place.unit}; give the fit the mass"
    if place.tyres and folder.tyres != place.tyres:
        return f"the tyres are of kind {folder.tyres}, and only {place.tyres} has {place.path}"
    if not math.isfinite(one.value) or (place.periods and one.value < 0.0):
        return f"{one.value:g} is not possible there"
    if folder.find(place.path.rpartition(".")[0])[2] is None and place.tyres:
        return f"{place.path.rpartition('.')[0]} is left out in the file, and other numbers are needed with it"
    return ""


def _unit(text: str) -> str:
    return (text or "1").replace("²", "^2").replace("-", "1").replace(" ", "")


class _Folder:
    """The files of a vehicle, and which of them holds what."""

    def __init__(self, name: str) -> None:
        self.folder, self.variant = find_vehicle(name)
        self.change = load_variant(self.folder, self.variant)
        self.base = self.folder / "vehicle.yaml"
        self.tyres = load_part(self.folder, "vehicle", VehicleSpec, self.change).tyres.kind
        self.rate = load_part(self.folder, "control", ControlSpec, self.change).rate
        self.data, _ = parse_tree(read_text(self.base), shown(self.base))

    def find(self, path: str) -> tuple[Path, tuple[str, ...], Any]:
        """File, prefix in it, and value in SI units of an entry; None if it is nowhere yet."""
        keys = path.split(".")
        over = value_at(self.change.vehicle, keys)
        under = value_at(self.data, keys)
        section = self.change.vehicle.get(keys[0])
        replaced = isinstance(section, dict) and section.get("kind") not in {None, _kind(self.data.get(keys[0]))}
        if self.variant is not None and (over is not REMOVED or replaced):
            return variants(self.folder)[self.variant], ("vehicle",), None if over is REMOVED else _si(over)
        return self.base, (), None if under is REMOVED else _si(under)

    def checker(self, path: Path) -> Callable[[str], None]:
        """Refuses a text of a file with which the vehicle would not load."""

        def check(text: str) -> None:
            name = shown(path)
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
    """Notes and what is left out, as lines."""
    return [*(f"note: {note}" for note in change.notes), *change.skipped]


def read_fit(path: Path | str) -> Fit:
    """A saved fit: its folder, or the fit.json in it.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    from mirdrake.identification.fit import load_fit

    path = Path(path)
    if not path.exists():
        raise ConfigError(f"{shown(path)}: no such folder; give the folder that mirdrake identify has written")
    return load_fit(path.parent if path.name == "fit.json" else path)

"""The gains of a tuning result into the control.yaml of its vehicle."""

import math
from datetime import UTC, date, datetime
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_edit import REMOVED, Edit, value_at
from mirdrake.core.yaml_io import parse_tree, parse_yaml, read_text, shown, where
from mirdrake.tuning.result_folder import TuningResult
from mirdrake.vehicles.file_change import FileChange, change_file
from mirdrake.vehicles.joint_control import JOINT_CONTROLS
from mirdrake.vehicles.spec import ControlSpec, VariantSpec
from mirdrake.vehicles.vehicle import find_vehicle, load_part, load_variant, variants

DIGITS = 6
"""Significant digits that are written."""

Values = dict[str, float | str | tuple[float, ...]]
"""What to write, by dotted path in control.yaml."""

_PROVENANCE = "tuned "


def plan_apply(
    result: TuningResult, *, candidate: str | None = None, vehicle: str | None = None, today: date | None = None
) -> FileChange:
    """The change to control.yaml that a candidate asks for; write it with its ``write()``.

    A study with a schedule gives gains over speed unless a candidate is named: the gains of the best, and a
    ``schedule`` in the same section of control.yaml, whose rows count. Any other gains take such a schedule away.

    Args:
        result: of the study.
        candidate: its name; by default the best, with the schedule if the study has one.
        vehicle: name or folder of the vehicle; by default that of the study. With ``@<variant>`` the gains go into
            the variant's file if it has an entry for this loop's controller, else to control.yaml.
        today: for the provenance line; by default the date of now, UTC.

    Raises:
        ConfigError: no such candidate, it is not feasible, its gains have no place in control.yaml, or the file does
            not fit.
    """
    chosen = result.candidate(candidate)
    _check_feasible(result, chosen)
    schedule = result.data.get("schedule") if candidate is None else None
    if candidate is None and not schedule and (result.data.get("spec") or {}).get("schedule"):
        raise ConfigError(
            f"{_place(result)}: schedule: the study found none that holds; name the candidate whose gains shall serve "
            "every speed with --candidate"
        )
    values = _values(result, chosen) | _schedule_values(result, schedule or [])
    name = vehicle or result.data.get("vehicle")
    if not name:
        raise ConfigError(f"{_place(result)}: vehicle: the study names none; say which with --vehicle")
    target = _Target(str(name), values)
    comment = provenance(result, chosen, today or datetime.now(UTC).date())
    if schedule:
        comment += f", schedule over {len(schedule)} speeds"
    return change_file(
        target.path,
        _edits(values, target.dropped(values), comment, target.prefix),
        check=target.check,
        notes=_notes(result, chosen, target),
    )


def provenance(result: TuningResult, candidate: dict[str, Any], today: date) -> str:
    """The line that says where gains are from."""
    parts = [f"{_PROVENANCE}{today.isoformat()}: study {result.name}, candidate {candidate['name']}"]
    sha256 = str(result.data.get("spec_sha256") or "")
    if sha256:
        parts.append(f"sha256 {sha256[:16]}")
    cost = candidate.get("cost")
    if cost is not None:
        baseline = next((one for one in result.candidates if one["name"] == result.data["baseline"]), {})
        before = baseline.get("cost")
        compared = f" (baseline {before:.4g})" if before is not None and baseline["name"] != candidate["name"] else ""
        parts.append(f"cost {cost:.4g}{compared}")
    text = ", ".join(parts)
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _check_feasible(result: TuningResult, chosen: dict[str, Any]) -> None:
    place = f"{_place(result)}: candidate '{chosen['name']}'"
    status = chosen.get("status", "ok")
    if status != "ok":
        raise ConfigError(f"{place} is {status}{_because(chosen)}; choose another with --candidate")
    if not chosen.get("feasible", False):
        raise ConfigError(
            f"{place} does not meet the constraints of the study{_because(chosen)}; choose another with --candidate"
        )


def _because(chosen: dict[str, Any]) -> str:
    return f" ({chosen['reason']})" if chosen.get("reason") else ""


def _values(result: TuningResult, chosen: dict[str, Any]) -> Values:
    """What to write, by dotted path in control.yaml: settings that the gains need, then the gains."""
    values: Values = dict(result.loop.get("settings") or {})
    for gain, value in chosen["gains"].items():
        values[_path(result, gain)] = _digits(value, f"{_place(result)}: candidate '{chosen['name']}': {gain}")
    return values


def _schedule_values(result: TuningResult, rows: list[dict[str, Any]]) -> Values:
    """Gains over speed, by dotted path in control.yaml."""
    if not rows:
        return {}
    place, values = f"{_place(result)}: schedule", Values()
    for gain in result.loop["gains"]:
        section, _, name = _path(result, gain).rpartition(".")
        values[f"{section}.schedule.speeds"] = tuple(_digits(row["speed"], f"{place}: speed") for row in rows)
        values[f"{section}.schedule.{name}"] = tuple(
            _digits(row["gains"].get(gain), f"{place}: {gain} at {row['speed']:g} m/s") for row in rows
        )
    return values


def _path(result: TuningResult, gain: str) -> str:
    """Dotted path of a gain in control.yaml."""
    path = result.loop["gains"].get(gain, {}).get("path")
    if not path:
        raise ConfigError(
            f"{_place(result)}: loop.gains.{gain}: has no place in control.yaml (a loop of a diagram?); "
            "write the gains into the diagram by hand"
        )
    return str(path)


def _digits(value: Any, what: str) -> float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{what} is {value}, not a finite number")
    return float(f"{float(value):.{DIGITS}g}")


class _Target:
    """The file that the gains go into: control.yaml, or a variant's file that has the section itself."""

    def __init__(self, name: str, values: Values) -> None:
        self.folder, self.variant = find_vehicle(name)
        self.change = load_variant(self.folder, self.variant)
        self.sections = {path.split(".")[0] for path in values}
        self.in_variant = self.variant is not None and bool(self.sections & set(self.change.control))
        self.prefix = ("control",) if self.in_variant else ()
        self.path = variants(self.folder)[str(self.variant)] if self.in_variant else self.folder / "control.yaml"

    def dropped(self, values: Values) -> list[str]:
        """Keys of the file that go, because a loop gets another kind of controller.

        Raises:
            ConfigError: the gains need another kind of controller than is there, and the study does not say so.
        """
        control = load_part(self.folder, "control", ControlSpec, self.change)
        data, _ = parse_tree(read_text(self.path), shown(self.path))
        dropped = []
        for section in sorted(self.sections):
            given = values.get(f"{section}.kind", getattr(getattr(control, section, None), "kind", None))
            schema = JOINT_CONTROLS.get(section, {}).get(str(given))
            if schema is None:
                continue
            for path in values:
                group, field = path.split(".")[:2]
                if group == section and field not in schema.model_fields:
                    raise ConfigError(
                        f"{where(control, section, 'kind')}: is {given}, which has no {field}; the study tuned another "
                        "kind of controller, so set the kind in the file, or run the study again"
                    )
            inside = value_at(data, (*self.prefix, section))
            if isinstance(inside, dict):
                dropped += [f"{section}.{field}" for field in inside if field not in schema.model_fields]
                dropped += self._old_schedule(section, inside, values)
        return dropped

    def _old_schedule(self, section: str, inside: dict[str, Any], values: Values) -> list[str]:
        """What is there of a schedule and does not fit the new gains: all of it, or single gains."""
        new = [path for path in values if path.startswith(f"{section}.schedule.")]
        given = inside.get("schedule")
        if not new:
            self._check_below(section)
            return [f"{section}.schedule"] if "schedule" in inside else []
        if not isinstance(given, dict):
            return []
        return [f"{section}.schedule.{key}" for key in given if f"{section}.schedule.{key}" not in new]

    def _check_below(self, section: str) -> None:
        """Refuse constant gains of a variant whose control.yaml has a schedule."""
        if self.in_variant:
            below = load_part(self.folder, "control", ControlSpec, VariantSpec(description="none"))
            if getattr(getattr(below, section), "schedule", None) is not None:
                raise ConfigError(
                    f"{where(below, section, 'schedule')}: would act over these gains of the variant "
                    f"'{self.variant}'; take it out first"
                )

    def check(self, text: str) -> None:
        """Refuse a text of the file with which the controllers would not load."""
        name = shown(self.path)
        if self.in_variant:
            change = parse_yaml(text, VariantSpec, name=name)
            load_part(self.folder, "control", ControlSpec, change)
        else:
            parse_yaml(text, ControlSpec, name=name)


def _edits(values: Values, dropped: list[str], comment: str, prefix: tuple[str, ...]) -> list[Edit]:
    edits: list[Edit] = []
    sections: set[str] = set()
    for path, value in values.items():
        section = path.partition(".")[0]
        above = {} if section in sections else {"comment": comment, "replaces": _PROVENANCE}
        sections.add(section)
        edits.append(Edit((*prefix, *path.split(".")), value, **above))
    return [*edits, *(Edit((*prefix, *path.split(".")), REMOVED) for path in dropped)]


def _notes(result: TuningResult, chosen: dict[str, Any], target: _Target) -> tuple[str, ...]:
    notes = []
    if target.variant is not None and not target.in_variant:
        notes.append(f"tuned for the variant '{target.variant}'; control.yaml serves every variant of the vehicle")
    unmet = [str(one["what"]) for one in result.data.get("acceptance") or [] if not one.get("met")]
    if unmet and chosen["name"] == result.data["best"]:
        notes.append(f"not met by the study: {'; '.join(unmet)}")
    spread = ((result.data.get("robustness") or {}).get("candidates") or {}).get(chosen["name"])
    if spread and spread.get("failures"):
        runs = result.data["robustness"]["runs"]
        notes.append(f"{spread['failures']} of {runs} runs of the Monte Carlo failed with these gains")
    return tuple(notes)


def _place(result: TuningResult) -> str:
    return shown(result.folder / "tuning.json")

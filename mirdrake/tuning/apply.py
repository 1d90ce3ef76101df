"""Writes the gains of a tuning result to the control.yaml of its vehicle."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime

from pydantic import BaseModel

from mirdrake.core.errors import ConfigError, printable
from mirdrake.core.yaml_edit import REMOVED, Edit, value_at
from mirdrake.core.yaml_io import display_path, parse_tree, parse_yaml, read_text, where
from mirdrake.tuning.loops.base import Evaluation
from mirdrake.tuning.loops.evaluate import LoopEvaluator
from mirdrake.tuning.result import FILE, CandidateResult, ScheduleRow, TuningResult
from mirdrake.vehicles.file_change import FileChange, change_file
from mirdrake.vehicles.joint_control import JOINT_CONTROLS
from mirdrake.vehicles.spec import ControlSpec, VariantSpec
from mirdrake.vehicles.vehicle import find_vehicle, load_part, load_variant, variants

DIGITS = 6
"""Significant digits of a written value."""

Values = dict[str, float | str | tuple[float, ...]]
"""Values to write, by dotted path in control.yaml."""

CONTROL_PATH = re.compile(r"\w+(\.\w+)+")
"""Dotted path in control.yaml."""

_PROVENANCE = "tuned "


def plan_apply(
    result: TuningResult,
    *,
    candidate: str | None = None,
    vehicle: str | None = None,
    today: date | None = None,
    force: bool = False,
) -> FileChange:
    """Return the change of control.yaml for a candidate; its ``write()`` writes it.

    The schedule of a study is written unless a candidate is named: the gains of the best candidate, and a ``schedule``
    in the same section of control.yaml, which has precedence. Other gains remove such a schedule.

    Args:
        result: of the study.
        candidate: its name; by default the best, with the schedule if the study has one.
        vehicle: name or folder of the vehicle; by default that of the study. With ``@<variant>`` the gains are written
            to the variant's file if that has an entry for the loop's controller, otherwise to control.yaml.
        today: for the provenance line; by default the present date, UTC.
        force: write gains that do not meet the criteria of the study.

    Raises:
        ConfigError: no such candidate, it does not meet the criteria, its gains are not in control.yaml, or the file
            does not fit.
    """
    chosen = result.candidate(candidate)
    if not force:
        _check_feasible(result, chosen)
        _check_criteria(result, chosen)
    # A named candidate has constant gains; only the study's own choice has the schedule.
    rows = result.schedule.rows if result.schedule is not None and candidate is None else ()
    if candidate is None and result.schedule is not None and not rows:
        raise ConfigError(
            f"{_place(result)}: schedule: the study found no gains for one of the speeds; choose constant gains with "
            "--candidate"
        )
    values = _values(result, chosen) | _schedule_values(result, rows)
    target = _Target(vehicle or result.vehicle, values)
    comment = provenance(result, chosen, today or datetime.now(UTC).date())
    # The provenance line states for which study and how many speeds the values hold.
    if rows:
        comment += f", schedule over {len(rows)} speeds"
    notes = []
    if target.variant is not None and not target.in_variant:
        notes.append(f"tuned for the variant '{target.variant}'; control.yaml is used by all variants of the vehicle")
    edits = _edits(values, target.dropped(values), comment, target)
    return change_file(target.path, edits, check=target.check, notes=notes)


def provenance(result: TuningResult, candidate: CandidateResult, today: date) -> str:
    """Return the line that states the origin of gains."""
    parts = [f"{_PROVENANCE}{today.isoformat()}: study {result.name}, candidate {candidate.name}"]
    if result.spec_sha256:
        parts.append(f"sha256 {result.spec_sha256[:16]}")
    if candidate.cost is not None:
        before = next((entry.cost for entry in result.candidates if entry.name == result.baseline), None)
        compared = before is not None and result.baseline != candidate.name
        parts.append(f"cost {candidate.cost:.4g}" + (f" (baseline {before:.4g})" if compared else ""))
    return printable(", ".join(parts), " ")


def _check_feasible(result: TuningResult, chosen: CandidateResult) -> None:
    place, reason = f"{_place(result)}: candidate '{chosen.name}'", f" ({chosen.reason})" if chosen.reason else ""
    if chosen.status != "ok":
        raise ConfigError(f"{place} is {chosen.status}{reason}; choose another with --candidate")
    if not chosen.feasible:
        # All broken limits are listed, as choosing another candidate needs them all.
        broken = [
            f"{rejection.figure} {rejection.value:.4g}, limit {rejection.limit:.4g}"
            for rejection in chosen.rejections
            if rejection.value is not None and rejection.limit is not None
        ]
        reason = f" ({'; '.join(broken)})" if broken else reason
        raise ConfigError(
            f"{place} does not meet the constraints of the study{reason}; choose another with --candidate"
        )


def _check_criteria(result: TuningResult, chosen: CandidateResult) -> None:
    """Reject the best candidate if a criterion of the study is not met, and another one that a check rejected."""
    place, known = f"{_place(result)}: candidate '{chosen.name}'", "tuning.html states which; --force writes it"
    unmet = sum(not criterion.met for criterion in result.acceptance)
    if chosen.name == result.best and unmet:
        raise ConfigError(f"{place} does not meet {unmet} of {len(result.acceptance)} criteria of the study; {known}")
    if chosen.rejections:
        raise ConfigError(f"{place} was rejected by a check of the study; {known}")


@dataclass(frozen=True)
class Comparison:
    """Test manoeuvre of a study with the present control of a vehicle, and with gains of the study.

    Attributes:
        before: with control.yaml as it is.
        after: with the gains.
    """

    before: Evaluation
    after: Evaluation

    def cost(self, weights: Mapping[str, float]) -> tuple[float, float]:
        """Return the costs before and after; infinite if not stable."""
        # An unstable test has figures without meaning, so its cost is infinite.
        before, after = (
            sum(weight * test.figures[name] for name, weight in weights.items()) if test.status == "ok" else math.inf
            for test in (self.before, self.after)
        )
        return before, after


def compare(result: TuningResult, *, candidate: str | None = None, vehicle: str | None = None) -> Comparison:
    """Drive the test manoeuvre of a study with a vehicle as it is, and with a candidate.

    Args:
        result: of the study.
        candidate: its name; by default the best.
        vehicle: name or folder of the vehicle; by default that of the study.
    """
    loop = result.loop
    if vehicle is not None:
        vehicles = loop.diagram["vehicles"]
        changed = {**vehicles, loop.vehicle: {**vehicles[loop.vehicle], "model": vehicle}}
        loop = replace(loop, diagram={**loop.diagram, "vehicles": changed})
    evaluate = LoopEvaluator(loop)
    return Comparison(evaluate({}), evaluate(result.candidate(candidate).gains))


def _values(result: TuningResult, chosen: CandidateResult) -> Values:
    """Return the values to write, by dotted path: settings that the gains need, then the gains."""
    # Settings first: the kind of controller decides which gains a section may have.
    values: Values = dict(result.loop.settings)
    for gain, value in chosen.gains.items():
        values[_path(result, gain)] = _digits(value, f"{_place(result)}: candidate '{chosen.name}': {gain}")
    return values


def _schedule_values(result: TuningResult, rows: Sequence[ScheduleRow]) -> Values:
    """Return the gains over speed, by dotted path."""
    place, values = f"{_place(result)}: schedule", Values()
    for gain in result.loop.gains if rows else ():
        section, _, name = _path(result, gain).rpartition(".")
        values[f"{section}.schedule.speeds"] = tuple(_digits(row.speed, f"{place}: speed") for row in rows)
        values[f"{section}.schedule.{name}"] = tuple(
            _digits(row.gains.get(gain, math.nan), f"{place}: {gain} at {row.speed:g} m/s") for row in rows
        )
    return values


def _path(result: TuningResult, gain: str) -> str:
    """Return the dotted path of a gain in control.yaml."""
    if gain not in result.loop.gains or not CONTROL_PATH.fullmatch(result.loop.gains[gain].path):
        raise ConfigError(
            f"{_place(result)}: loop.gains.{gain}: is not a path in control.yaml (a loop of a diagram?); "
            "write the gains to the diagram by hand"
        )
    return result.loop.gains[gain].path


def _digits(value: float, what: str) -> float:
    if not math.isfinite(value):
        raise ConfigError(f"{what} is {value}, not a finite number")
    return float(f"{value:.{DIGITS}g}")


class _Target:
    """File to which gains are written: control.yaml, or a variant's file if that has the section."""

    def __init__(self, name: str, values: Values) -> None:
        self.folder, self.variant = find_vehicle(name)
        self.change = load_variant(self.folder, self.variant)
        self.sections = {path.split(".")[0] for path in values}
        self.in_variant = self.variant is not None and bool(self.sections & set(self.change.control))
        self.prefix = ("control",) if self.in_variant else ()
        self.path = variants(self.folder)[str(self.variant)] if self.in_variant else self.folder / "control.yaml"

    def dropped(self, values: Values) -> list[str]:
        """Return the keys that are removed since the controller of a loop becomes one of another kind.

        Raises:
            ConfigError: the gains need another kind of controller than the file has, and the study does not set it.
        """
        # With the variant's changes applied, as the vehicle loads it; `data` is the file itself, whose keys are
        # removed.
        control = load_part(self.folder, "control", ControlSpec, self.change)
        data, _ = parse_tree(read_text(self.path), display_path(self.path))
        dropped = []
        for section in sorted(self.sections):
            # The kind after the change: that of the study, or else the present one.
            given = values.get(f"{section}.kind", getattr(getattr(control, section, None), "kind", None))
            schema = JOINT_CONTROLS.get(section, {}).get(str(given))
            if schema is None:
                continue
            # Gains that need another kind of controller are rejected before anything is changed.
            for path in values:
                group, field = path.split(".")[:2]
                if group == section and field not in schema.model_fields:
                    raise ConfigError(
                        f"{where(control, section, 'kind')}: is {given}, which has no {field}; the study tuned another "
                        "kind of controller, so set the kind in the file, or run the study again"
                    )
            inside = value_at(data, (*self.prefix, section))
            # Keys of the old kind would be unknown keys of the new one, and the file would not load.
            if isinstance(inside, dict):
                dropped += [f"{section}.{field}" for field in inside if field not in schema.model_fields]
                dropped += self._old_schedule(section, inside, values)
        return dropped

    def unit(self, path: str, values: Values) -> str:
        """Return the unit of a value, for the comment behind a new key; "" without one."""
        section, *keys = path.split(".")
        if path.endswith(".schedule.speeds"):
            return "m/s"
        keys = keys[1:] if keys[0] == "schedule" else keys
        control = load_part(self.folder, "control", ControlSpec, self.change)
        given = values.get(f"{section}.kind", getattr(getattr(control, section, None), "kind", None))
        schema: type[BaseModel] | None = JOINT_CONTROLS.get(section, {}).get(str(given))
        if schema is None or keys[0] not in schema.model_fields:
            return ""
        # The units of the gains of a PID controller depend on its joint.
        stated = re.match(r"\[([^\]]+)\]", schema.model_fields[keys[0]].description or "")
        return str(getattr(schema, "gains", {}).get(keys[0], stated[1] if stated else ""))

    def _old_schedule(self, section: str, inside: Mapping[str, object], values: Values) -> list[str]:
        """Return the keys of a schedule that do not belong to the new gains: all of it, or single gains."""
        new = [path for path in values if path.startswith(f"{section}.schedule.")]
        given = inside.get("schedule")
        if not new:
            self._check_below(section)
            return [f"{section}.schedule"] if "schedule" in inside else []
        if not isinstance(given, dict):
            return []
        return [f"{section}.schedule.{key}" for key in given if f"{section}.schedule.{key}" not in new]

    def _check_below(self, section: str) -> None:
        """Reject constant gains of a variant whose control.yaml has a schedule."""
        if self.in_variant:
            # control.yaml alone: a change by an empty variant.
            below = load_part(self.folder, "control", ControlSpec, VariantSpec(description="none"))
            if getattr(getattr(below, section), "schedule", None) is not None:
                raise ConfigError(
                    f"{where(below, section, 'schedule')}: has precedence over these gains of the variant "
                    f"'{self.variant}'; remove it first"
                )

    def check(self, text: str) -> None:
        """Reject a text of the file that does not load."""
        name = display_path(self.path)
        if self.in_variant:
            change = parse_yaml(text, VariantSpec, name=name)
            load_part(self.folder, "control", ControlSpec, change)
        else:
            parse_yaml(text, ControlSpec, name=name)


def _edits(values: Values, dropped: list[str], comment: str, target: _Target) -> list[Edit]:
    prefix = target.prefix
    # One provenance line per section, which replaces that of an earlier study.
    edits: list[Edit] = []
    sections: set[str] = set()
    for path, value in values.items():
        section = path.partition(".")[0]
        above = {} if section in sections else {"comment": comment, "replaces": _PROVENANCE}
        sections.add(section)
        edits.append(Edit((*prefix, *path.split(".")), value, remark=target.unit(path, values), **above))
    return [*edits, *(Edit((*prefix, *path.split(".")), REMOVED) for path in dropped)]


def _place(result: TuningResult) -> str:
    return display_path(result.folder / FILE)

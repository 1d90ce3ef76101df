"""Rules of a world: constraints on random props, and conditions that a finished world must satisfy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, WorldError, did_you_mean
from mirdrake.core.yaml_io import file_line, where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.regions import NamedAreas, make_region
from mirdrake.worlds.rules_spec import DrivableSpec, KeepClearSpec, PlacementRuleSpec, RuleSpec
from mirdrake.worlds.tracks import find_track
from mirdrake.worlds.world import Goal, Start

_SLACK = 1e-9  # [m]


@dataclass(frozen=True)
class _AreaRule:
    """An area in which props must be, or must not be.

    Attributes:
        area: polygon in W [m].
        props: pattern of their names.
        inside: whether they must be inside.
        where: ``file:line: path`` of the rule.
        file_line: ``file:line`` of the rule.
        fault: what is wrong with a prop that breaks it.
        bumps: whether props that vehicles drive over count.
    """

    area: BaseGeometry
    props: str
    inside: bool
    where: str
    file_line: str
    fault: str
    bumps: bool = True

    def holds(self, prop: PlacedProp) -> bool:
        if not prop.is_called(self.props) or (prop.prop.driven_over and not self.bumps):
            return True
        if self.inside:
            # With a small tolerance, because props are often placed exactly on the edge of a region.
            return bool(self.area.buffer(_SLACK).covers(prop.footprint))
        return not self.area.intersects(prop.footprint)


@dataclass(frozen=True)
class GroundTolerance:
    """Largest gap or depth of props that must stand on the ground.

    Attributes:
        props: pattern of their names.
        tolerance: [m].
        where: ``file:line: path`` of the rule.
    """

    props: str
    tolerance: float
    where: str


class Rules:
    """The rules of a world.

    Attributes:
        min_gap: smallest distance between any two props [m].
        gap_file_line: ``file:line`` of that rule.
        drivable: paths that vehicles must have.
        on_ground: tolerances of props that must stand on the ground.
        clear: areas of `keep_clear`, in which no props may be [m].

    Args:
        specs: specs of the file.
        areas: tracks and patches.
        starts: starts by name.
        goals: goals by name.
        draw: evaluates values.

    Raises:
        ConfigError: a rule refers to a name that does not exist.
    """

    def __init__(
        self,
        specs: Sequence[RuleSpec],
        areas: NamedAreas,
        starts: Mapping[str, Start],
        goals: Mapping[str, Goal],
        draw: Draw,
    ) -> None:
        # The largest of several gaps holds for all pairs.
        self.min_gap = max((spec.min_gap for spec in specs if spec.min_gap is not None), default=0.0)
        # The rule with the largest gap is the one that a prop breaks.
        self.gap_file_line = next((file_line(spec, "min_gap") for spec in specs if spec.min_gap == self.min_gap), "")
        self.drivable: list[DrivableSpec] = []
        self.on_ground: list[GroundTolerance] = []
        self.clear: list[BaseGeometry] = []
        self._areas: list[_AreaRule] = []
        self._pairs: list[tuple[str, str, str]] = []
        for index, spec in enumerate(specs):
            below = draw.below(f"rules.{index}")
            # Areas of keep_clear are kept twice: as a rule for placing props, and for the checks of the finished world.
            if spec.keep_clear is not None:
                rule = _keep_clear(spec.keep_clear, areas, starts, goals)
                self._areas.append(rule)
                self.clear.append(rule.area)
            for part, inside in ((spec.inside, True), (spec.outside, False)):
                if part is not None:
                    self._areas.append(_placement_rule(part, areas, below, inside=inside))
            if spec.on_ground is not None:
                ground = spec.on_ground
                self.on_ground.append(GroundTolerance(ground.props, ground.tolerance, where(ground)))
            if spec.allow_overlap is not None:
                self._pairs.append((spec.allow_overlap[0], spec.allow_overlap[1], where(spec, "allow_overlap")))
            if spec.drivable is not None:
                _check_drivable(spec.drivable, starts, goals)
                self.drivable.append(spec.drivable)
        # Prepared once: every attempt of a random prop is checked against all areas.
        for area in self._areas:
            shapely.prepare(area.area)

    def allow(self, prop: PlacedProp) -> bool:
        """Return whether a prop may stand where it does."""
        return all(area.holds(prop) for area in self._areas)

    def may_overlap(self, a: PlacedProp, b: PlacedProp) -> bool:
        """Return whether two props may touch each other."""
        return any(
            (a.is_called(first) and b.is_called(second)) or (a.is_called(second) and b.is_called(first))
            for first, second, _ in self._pairs
        )

    def broken(self, props: Sequence[PlacedProp]) -> list[WorldError]:
        """Return an error for each prop that breaks a rule, and for each name that matches no prop."""
        faults = [
            WorldError(f"'{prop.name}' {area.fault} ({area.file_line})", where=prop.where)
            for area in self._areas
            for prop in props
            if not area.holds(prop)
        ]
        # A pattern that matches nothing is a misspelt name.
        patterns = [(area.props, area.where) for area in self._areas]
        patterns += [(rule.props, rule.where) for rule in self.on_ground]
        patterns += [(name, location) for *pair, location in self._pairs for name in pair]
        names = sorted({prop.name.partition("[")[0] for prop in props})
        faults += [
            WorldError(f"no prop is called '{pattern}'; {did_you_mean(pattern, names)}", where=location)
            for pattern, location in patterns
            if props and not any(prop.is_called(pattern) for prop in props)
        ]
        return faults


# --- the inner parts ----------------------------------------------------------------------------------------------


def _check_drivable(spec: DrivableSpec, starts: Mapping[str, Start], goals: Mapping[str, Goal]) -> None:
    for name in sorted(set(starts) & set(goals) & {spec.from_, spec.to}):
        raise ConfigError(f"'{name}' is a start and a goal; rename one of them", where=where(spec))
    _point(spec.from_, starts, goals, where(spec, "from"))
    _point(spec.to, starts, goals, where(spec, "to"))


def _point(name: str, starts: Mapping[str, Start], goals: Mapping[str, Goal], location: str) -> tuple[float, float]:
    """Return the centre of a start or goal [m]."""
    if name in starts:
        return starts[name].x, starts[name].y
    goal = goals.get(name)
    if goal is not None and goal.area is not None:
        centre = goal.area.centroid
        return centre.x, centre.y
    known = [*starts, *(name for name, goal in goals.items() if goal.area is not None)]
    raise ConfigError(f"no start or goal with an area is called '{name}'; {did_you_mean(name, known)}", where=location)


def _keep_clear(
    spec: KeepClearSpec, areas: NamedAreas, starts: Mapping[str, Start], goals: Mapping[str, Goal]
) -> _AreaRule:
    area: BaseGeometry
    if spec.around is not None:
        # One of three kinds, as the schema has checked.
        assert spec.radius is not None
        area = shapely.Point(_point(spec.around, starts, goals, where(spec, "around"))).buffer(spec.radius)
        fault = f"is within {spec.radius:g} m of '{spec.around}'"
    elif spec.along is not None:
        assert spec.width is not None
        ends = [
            _point(getattr(spec.along, key), starts, goals, where(spec.along, key.strip("_")))
            for key in ("from_", "to")
        ]
        area = shapely.LineString(ends).buffer(spec.width / 2.0, cap_style="flat")
        fault = f"is between '{spec.along.from_}' and '{spec.along.to}'"
    else:
        track = find_track(spec.track or "", areas.tracks, where=where(spec, "track"))
        margin = spec.margin or 0.0
        area = track.band(lambda s: -track.right_width(s) - margin, lambda s: track.left_width(s) + margin)
        fault = f"is on track '{spec.track}'"
    return _AreaRule(area, "*", inside=False, where=where(spec), file_line=file_line(spec), fault=fault, bumps=False)


def _placement_rule(spec: PlacementRuleSpec, areas: NamedAreas, draw: Draw, *, inside: bool) -> _AreaRule:
    area = make_region(spec.region, areas, draw, location=where(spec, "region"))
    fault = "is not inside its region" if inside else "is not outside its region"
    return _AreaRule(area, spec.props, inside=inside, where=where(spec), file_line=file_line(spec), fault=fault)

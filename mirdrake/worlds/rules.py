"""Rules of a world: what random props keep to, and what a finished world is checked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import shapely
from shapely.geometry.base import BaseGeometry

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.worlds.draw import Draw
from mirdrake.worlds.props import PlacedProp
from mirdrake.worlds.props_spec import DrivableSpec, RuleSpec, WhereSpec
from mirdrake.worlds.regions import Places, make_region
from mirdrake.worlds.tracks import Track
from mirdrake.worlds.world import Goal, Start

_SLACK = 1e-9  # [m]


@dataclass(frozen=True)
class _Area:
    """An area that props keep out of, or in."""

    area: BaseGeometry
    props: str
    inside: bool
    where: str
    what: str
    bumps: bool = True
    """whether what is made to be driven over counts"""

    def holds(self, prop: PlacedProp) -> bool:
        if not prop.is_called(self.props) or (prop.prop.driven_over and not self.bumps):
            return True
        if self.inside:
            return bool(self.area.buffer(_SLACK).covers(prop.footprint))
        return not self.area.intersects(prop.footprint)


class Rules:
    """The rules of a world.

    Attributes:
        min_gap: smallest distance between any two props [m].
        drivable: ways that a vehicle shall have.
        on_ground: (names, tolerance [m], place) of props that stand on the ground.

    Args:
        specs: of the file.
        places: tracks and patches.
        starts: by name.
        goals: by name.
        draw: finds the values.

    Raises:
        ConfigError: a rule names something that does not exist.
    """

    def __init__(
        self,
        specs: Sequence[RuleSpec],
        places: Places,
        starts: Mapping[str, Start],
        goals: Mapping[str, Goal],
        draw: Draw,
    ) -> None:
        self.min_gap = max((spec.min_gap for spec in specs if spec.min_gap is not None), default=0.0)
        self.gap_where = next((where(spec, "min_gap") for spec in specs if spec.min_gap == self.min_gap), "")
        self.drivable: list[DrivableSpec] = []
        self.on_ground: list[tuple[str, float, str]] = []
        self._areas: list[_Area] = []
        self._pairs: list[tuple[str, str]] = []
        for index, spec in enumerate(specs):
            below = draw.below(f"rules.{index}")
            if spec.keep_clear is not None:
                self._areas.append(_keep_clear(spec, places, starts, goals))
            for part, inside in ((spec.inside, True), (spec.outside, False)):
                if part is not None:
                    self._areas.append(_where_area(part, places, below, inside=inside))
            if spec.on_ground is not None:
                self.on_ground.append((spec.on_ground.props, spec.on_ground.tolerance, where(spec.on_ground)))
            if spec.allow_overlap is not None:
                self._pairs.append((spec.allow_overlap[0], spec.allow_overlap[1]))
            if spec.drivable is not None:
                trip, both = spec.drivable, set(starts) & set(goals) & {spec.drivable.from_, spec.drivable.to}
                for name in sorted(both):
                    raise ConfigError(f"{where(trip)}: '{name}' is a start and a goal; give one of them another name")
                _point(trip.from_, starts, goals, where(trip, "from"))
                _point(trip.to, starts, goals, where(trip, "to"))
                self.drivable.append(spec.drivable)
        for area in self._areas:
            shapely.prepare(area.area)

    def allow(self, prop: PlacedProp) -> bool:
        """Whether a prop may stand where it does."""
        return all(area.holds(prop) for area in self._areas)

    def may_overlap(self, a: PlacedProp, b: PlacedProp) -> bool:
        """Whether two props may touch each other."""
        return any(
            (a.is_called(one) and b.is_called(other)) or (a.is_called(other) and b.is_called(one))
            for one, other in self._pairs
        )

    def broken(self, props: Sequence[PlacedProp]) -> list[str]:
        """Props in areas where they must not be, and names that mean nothing; one line each."""
        faults = [
            f"{prop.where}: '{prop.name}' {area.what} ({area.where.rpartition(': ')[0] or 'rules'})"
            for area in self._areas
            for prop in props
            if not area.holds(prop)
        ]
        named = [(area.props, area.where) for area in self._areas]
        named += [(pattern, place) for pattern, _, place in self.on_ground]
        faults += [
            f"{place}: no prop is called '{pattern}'; {_known(pattern, props)}"
            for pattern, place in named
            if props and not any(prop.is_called(pattern) for prop in props)
        ]
        return faults


# --- the inner parts ----------------------------------------------------------------------------------------------


def _known(pattern: str, props: Sequence[PlacedProp]) -> str:
    return did_you_mean(pattern, sorted({prop.name.partition("[")[0] for prop in props}))


def _point(name: str, starts: Mapping[str, Start], goals: Mapping[str, Goal], place: str) -> tuple[float, float]:
    """The middle of a start or goal [m]."""
    if name in starts:
        return starts[name].x, starts[name].y
    goal = goals.get(name)
    if goal is not None and goal.area is not None:
        centre = goal.area.centroid
        return centre.x, centre.y
    known = [*starts, *(name for name, goal in goals.items() if goal.area is not None)]
    raise ConfigError(f"{place}: no start or goal with a place is called '{name}'; {did_you_mean(name, known)}")


def _keep_clear(spec: RuleSpec, places: Places, starts: Mapping[str, Start], goals: Mapping[str, Goal]) -> _Area:
    clear = spec.keep_clear
    assert clear is not None
    area: BaseGeometry
    if clear.around is not None:
        assert clear.radius is not None
        area = shapely.Point(_point(clear.around, starts, goals, where(clear, "around"))).buffer(clear.radius)
        what = f"stands within {clear.radius:g} m of '{clear.around}'"
    elif clear.along is not None:
        assert clear.width is not None
        ends = [
            _point(getattr(clear.along, key), starts, goals, where(clear.along, key.strip("_")))
            for key in ("from_", "to")
        ]
        area = shapely.LineString(ends).buffer(clear.width / 2.0, cap_style="flat")
        what = f"stands between '{clear.along.from_}' and '{clear.along.to}'"
    else:
        track = _track(clear.track or "", places.tracks, where(clear, "track"))
        margin = clear.margin or 0.0
        area = track.band(lambda s: -track.right_width(s) - margin, lambda s: track.left_width(s) + margin)
        what = f"stands on track '{clear.track}'"
    return _Area(area, "*", inside=False, where=where(clear), what=what, bumps=False)


def _track(name: str, tracks: Mapping[str, Track], place: str) -> Track:
    if name not in tracks:
        raise ConfigError(
            f"{place}: unknown track '{name}'; {did_you_mean(name, tracks) if tracks else 'there are none'}"
        )
    return tracks[name]


def _where_area(spec: WhereSpec, places: Places, draw: Draw, *, inside: bool) -> _Area:
    area = make_region(spec.region, places, draw, place=where(spec, "region"))
    what = "is not inside its region" if inside else "is not outside its region"
    return _Area(area, spec.props, inside=inside, where=where(spec), what=what)

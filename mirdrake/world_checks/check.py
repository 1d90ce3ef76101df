"""All that is wrong with a world, before anything is simulated.

::

    load_world ──► rules, homeless props ──► overlaps, standing ──► starts, ways, goals ──► tests ──► first steps

Each step looks at what the steps before it left sound: a world that cannot be laid out has only those faults.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.yaml_io import parse_tree, where
from mirdrake.vehicles import load_vehicle
from mirdrake.world_checks.faults import Fault, Kind
from mirdrake.world_checks.first_steps import find_first_step_fault
from mirdrake.world_checks.obstacles import Body, Obstacle, obstacles_for
from mirdrake.world_checks.overlaps import Neighbours, find_overlaps
from mirdrake.world_checks.places import find_bad_start, find_walled_in
from mirdrake.world_checks.search import SEARCH_TIME
from mirdrake.world_checks.standing import find_gaps, find_unsettled
from mirdrake.world_checks.ways import Way, find_way, goal_area
from mirdrake.worlds import World, load_world
from mirdrake.worlds.clearance import Volume

_CAR = "bolt"  # the standard car


@dataclass(frozen=True)
class Examination:
    """What was found in a world.

    Attributes:
        world: laid out; None if it cannot be.
        faults: all of them.
        ways: that vehicles have, one for each rule `drivable` and each test with a goal that has one.
    """

    world: World | None
    faults: list[Fault] = field(default_factory=list)
    ways: list[Way] = field(default_factory=list)


def check_world(
    name_or_world: str | World,
    *,
    overrides: Iterable[str] = (),
    vehicle: str | None = None,
    patience: float = SEARCH_TIME,
    first_steps: bool = False,
) -> list[Fault]:
    """All faults of a world; none if it is sound.

    Args:
        name_or_world: a name below worlds/, a path, or a world that is laid out already.
        overrides: of the file, see :func:`mirdrake.worlds.load_world`; they do not change a world laid out already.
        vehicle: name of a vehicle for which all starts must have room, beside those of the tests and rules.
        patience: computing time after which the search for one way is given up [s], which is a fault.
        first_steps: build the plant and make a few steps with the vehicle, or the standard car, at the first start.

    Returns:
        one fault for each thing that is wrong.
    """
    return examine(
        name_or_world, overrides=overrides, vehicle=vehicle, patience=patience, first_steps=first_steps
    ).faults


def examine(
    name_or_world: str | World,
    *,
    overrides: Iterable[str] = (),
    vehicle: str | None = None,
    patience: float = SEARCH_TIME,
    first_steps: bool = False,
) -> Examination:
    """The world, its faults, and the ways that vehicles have; see :func:`check_world`."""
    overrides = tuple(overrides)
    if isinstance(name_or_world, World):
        world = name_or_world
    else:
        try:
            world = load_world(name_or_world, overrides=overrides)
        except MirdrakeError as error:
            return Examination(None, _lines("file", error))
    faults = [Fault("unplaced", line) for line in world.unplaced_props]
    if world.rules is not None:
        faults += [Fault("rule", line) for line in world.rules.broken(world.props)]
    near = Neighbours(world.props)
    overlaps = find_overlaps(near, world.rules.may_overlap if world.rules is not None else lambda _a, _b: False)
    faults += overlaps
    faults += find_gaps(near, world.rules, {fault.names for fault in overlaps})
    faults += find_unsettled(near, world.rules)
    drives = _Drives(world, near, faults, patience)
    drives.follow(vehicle)
    if world.path is not None and world.spec.tests:
        faults += _test_faults(world, overrides, {fault.text for fault in faults})
    if first_steps and not any(fault.kind in {"file", "start"} for fault in faults):
        faults += find_first_step_fault(world, overrides, vehicle or _CAR)
    return Examination(world, faults, drives.ways)


# --- the inner parts ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Trip:
    """What a rule or a test wants of a vehicle."""

    vehicle: str
    vehicle_where: str
    start: str
    goal: str | None
    margin: float
    where: str


class _Drives:
    """Starts, goals and ways of the vehicles that rules, tests and the caller name."""

    def __init__(self, world: World, near: Neighbours, faults: list[Fault], patience: float) -> None:
        self._world, self._near, self._faults, self._patience = world, near, faults, patience
        self.ways: list[Way] = []
        self._bodies: dict[str, tuple[Body, Volume, list[Obstacle]] | None] = {}
        self._starts: dict[tuple[str, str], bool] = {}
        self._found: dict[tuple[Any, ...], Way | str] = {}

    def follow(self, vehicle: str | None) -> None:
        """Look at all trips, then at the places that none has used."""
        world = self._world
        for trip in self._trips(vehicle):
            self._follow(trip)
        tried = {start for _, start in self._starts}
        reached = {way.goal for way in self.ways}
        self._faults += find_walled_in(
            world,
            self._near,
            starts=[name for name in world.spec.start if name not in tried],
            goals=[name for name in world.goals if name not in reached],
        )

    def _trips(self, vehicle: str | None) -> Iterable[_Trip]:
        world = self._world
        for rule in world.rules.drivable if world.rules is not None else ():
            if rule.from_ in world.starts:
                yield _Trip(rule.vehicle, where(rule, "vehicle"), rule.from_, rule.to, rule.margin, where(rule))
            else:
                text = f"{where(rule, 'from')}: '{rule.from_}' is a goal; a way begins at a start, which has a heading"
                self._faults.append(Fault("rule", text))
        for test in world.spec.tests:
            start = test.start if test.start is not None else next(iter(world.starts))
            if start in world.starts and (test.goal is None or test.goal in world.goals):
                place = where(test, "goal" if test.goal is not None else "start")
                yield _Trip(test.vehicle, where(test, "vehicle"), start, test.goal, 0.0, place)
        if vehicle is not None:
            for start in world.starts:
                yield _Trip(vehicle, "--vehicle", start, None, 0.0, where(world.spec, "start", start))

    def _follow(self, trip: _Trip) -> None:
        known = self._body(trip)
        if known is None:
            return
        body, volume, obstacles = known
        key = trip.vehicle, trip.start
        if key not in self._starts:
            bad = find_bad_start(self._world, self._near, trip.start, body, volume)
            self._faults += bad
            self._starts[key] = not bad
        if trip.goal is None or not self._starts[key] or goal_area(self._world, trip.goal) is None:
            return
        route = (*key, trip.goal, trip.margin)
        if route not in self._found:
            self._found[route] = find_way(
                self._world, body, obstacles, trip.start, trip.goal, margin=trip.margin, patience=self._patience
            )
            if isinstance(self._found[route], Way):
                self.ways.append(self._found[route])  # type: ignore[arg-type]
        found = self._found[route]
        if isinstance(found, str):
            self._faults.append(Fault("way", f"{trip.where}: {found}"))

    def _body(self, trip: _Trip) -> tuple[Body, Volume, list[Obstacle]] | None:
        """The vehicle, what it can touch something with, and what is in its way; None if it cannot be loaded."""
        if trip.vehicle not in self._bodies:
            try:
                vehicle = load_vehicle(trip.vehicle, where=trip.vehicle_where)
                body, volume = Body.of(vehicle, name=trip.vehicle), volume_of(vehicle)
            except MirdrakeError as error:
                self._faults += _lines("file", error)
                self._bodies[trip.vehicle] = None
            else:
                self._bodies[trip.vehicle] = body, volume, obstacles_for(self._near, volume)
        return self._bodies[trip.vehicle]


def _test_faults(world: World, overrides: Iterable[str], known: set[str]) -> list[Fault]:
    """Faults of the tests of a world, but for those that are known already."""
    from mirdrake.suites.cases import collect_cases

    assert world.path is not None
    try:
        collect_cases([world.path], values=_values(overrides))
    except ConfigError as error:
        return [fault for fault in _lines("test", error) if fault.text not in known]
    return []


def _values(overrides: Iterable[str]) -> Mapping[str, Any]:
    """The seed and the parameters among overrides."""
    values = {}
    for override in overrides:
        key, _, text = override.partition("=")
        name = key.strip().removeprefix("params.")
        if name == "seed" or name != key.strip():
            values[name] = parse_tree(text, "--set")[0]
    return values


def _lines(kind: Kind, error: MirdrakeError) -> list[Fault]:
    return [Fault(kind, line) for line in dict.fromkeys(str(error).splitlines()) if line.strip()]

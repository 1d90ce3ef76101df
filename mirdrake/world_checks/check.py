"""Checks of a world before a simulation.

::

    load_world ──► unplaced props, rules ──► overlaps, support ──► starts, paths, goals ──► tests ──► first steps

A world that cannot be laid out has only the faults of the first step.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mirdrake.controllers.behaviours.outline import volume_of
from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.yaml_io import parse_tree, where
from mirdrake.vehicles import load_vehicle
from mirdrake.world_checks import sentences
from mirdrake.world_checks.actor_starts import Standing, find_actor_overlaps, find_actors_at, place_actors
from mirdrake.world_checks.faults import Fault, Kind
from mirdrake.world_checks.first_steps import find_first_step_fault
from mirdrake.world_checks.obstacles import Body, Obstacle, obstacles_for
from mirdrake.world_checks.overlaps import Neighbours, find_overlaps
from mirdrake.world_checks.paths import VehiclePath, find_path, goal_area
from mirdrake.world_checks.search import SEARCH_TIME
from mirdrake.world_checks.starts import find_bad_start, find_inside_props
from mirdrake.world_checks.support import find_gaps, find_unsupported
from mirdrake.worlds import World, load_world
from mirdrake.worlds.actors_spec import conditions
from mirdrake.worlds.case_spec import CaseSpec, OtherSpec
from mirdrake.worlds.clearance import Volume

_CAR = "bolt"  # the default car of the first steps


@dataclass(frozen=True)
class Examination:
    """Result of the checks of a world.

    Attributes:
        world: the world; None if it cannot be laid out.
        faults: all faults.
        paths: a path for each rule `drivable` and each test with a goal that is reachable.
        remarks: what could not be checked, a line each.
    """

    world: World | None
    faults: list[Fault] = field(default_factory=list)
    paths: list[VehiclePath] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def check_world(
    name_or_world: str | World,
    *,
    overrides: Iterable[str] = (),
    vehicle: str | None = None,
    time_limit: float = SEARCH_TIME,
    first_steps: bool = False,
) -> list[Fault]:
    """Return all faults of a world.

    Args:
        name_or_world: a name below worlds/, a path, or a world.
        overrides: overrides of the file, see :func:`mirdrake.worlds.load_world`; not used for a world.
        vehicle: name of a vehicle that must be free at all starts, in addition to those of the tests and rules.
        time_limit: computing time of the search for one path [s]; a path that is not found within it is a fault.
        first_steps: also simulate a few steps with the vehicle, or the Bolt, at the first start.
    """
    return examine(
        name_or_world, overrides=overrides, vehicle=vehicle, time_limit=time_limit, first_steps=first_steps
    ).faults


def examine(
    name_or_world: str | World,
    *,
    overrides: Iterable[str] = (),
    vehicle: str | None = None,
    time_limit: float = SEARCH_TIME,
    first_steps: bool = False,
    trust: bool = False,
) -> Examination:
    """Return a world, its faults, and the paths of vehicles.

    Args:
        name_or_world: see :func:`check_world`; likewise the other arguments.
        overrides: overrides of the file.
        vehicle: name of a vehicle.
        time_limit: computing time of the search for one path [s].
        first_steps: whether to simulate a few steps.
        trust: whether user classes that are drivers of tests are executed and checked; otherwise a remark names them.
    """
    overrides = tuple(overrides)
    if isinstance(name_or_world, World):
        world = name_or_world
    else:
        try:
            world = load_world(name_or_world, overrides=overrides)
        except MirdrakeError as error:
            return Examination(None, _faults_of("file", error))
    faults = [_fault_of("unplaced", error) for error in world.unplaced_props]
    if world.rules is not None:
        faults += [_fault_of("rule", error) for error in world.rules.broken(world.props)]

    # Props against each other and the ground.
    near = Neighbours(world.props)
    overlaps = find_overlaps(near, world.rules.may_overlap if world.rules is not None else lambda _a, _b: False)
    faults += overlaps
    faults += find_gaps(near, world.rules, {fault.names for fault in overlaps})
    faults += find_unsupported(near, world.rules, world.ground.terrain)

    # Vehicles, tests, first steps.
    actors = place_actors(world, lambda error: faults.extend(_faults_of("file", error)))
    faults += find_actor_overlaps(actors)
    trips = _Trips(world, near, actors, time_limit)
    trips.check(vehicle)
    faults += trips.faults
    remarks = _condition_remarks(world)
    if world.path is not None and world.spec.tests:
        faults += _test_faults(world, overrides, {fault.text for fault in faults}, trust=trust)
        if not trust:
            remarks += _unchecked_drivers(world)
    # The steps need a world that can be loaded and a free start.
    if first_steps and not any(fault.kind in {"file", "start"} for fault in faults):
        faults += find_first_step_fault(world, overrides, vehicle or _CAR)
    return Examination(world, faults, trips.paths, remarks)


# --- the inner parts ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Trip:
    """A requirement of a rule or test on a vehicle: free at a start, with a path to a goal; rules ignore actors."""

    vehicle: str
    vehicle_where: str
    start: str
    goal: str | None
    margin: float
    where: str
    with_actors: bool = True


@dataclass(frozen=True)
class _Subject:
    """A vehicle: its box, its collision volume, and its obstacles."""

    body: Body
    volume: Volume
    obstacles: list[Obstacle]


class _Trips:
    """Checks of starts, goals and paths for the vehicles of rules, tests and the caller.

    Attributes:
        faults: faults that were found.
        paths: paths that were found.
    """

    def __init__(self, world: World, near: Neighbours, actors: Sequence[Standing], time_limit: float) -> None:
        self._world, self._near, self._actors, self._time_limit = world, near, actors, time_limit
        self.faults: list[Fault] = []
        self.paths: list[VehiclePath] = []
        self._subjects: dict[str, _Subject | None] = {}
        self._starts: dict[tuple[str, str], bool] = {}
        self._met: set[tuple[str, str]] = set()
        self._results: dict[tuple[str, str, str, float], VehiclePath | str] = {}

    def check(self, vehicle: str | None) -> None:
        """Check all trips, then the starts and goals that none of them used."""
        world = self._world
        for trip in self._trips(vehicle):
            self._check_trip(trip)
        used = {start for _, start in self._starts}
        reached = {path.goal for path in self.paths}
        self.faults += find_inside_props(
            world,
            self._near,
            starts=[name for name in world.spec.start if name not in used],
            goals=[name for name in world.goals if name not in reached],
        )

    def _trips(self, vehicle: str | None) -> Iterable[_Trip]:
        # Paths come from rules, tests and the vehicle of the command line, each with its place for messages.
        world = self._world
        for rule in world.rules.drivable if world.rules is not None else ():
            if rule.from_ in world.starts:
                yield _Trip(rule.vehicle, where(rule, "vehicle"), rule.from_, rule.to, rule.margin, where(rule), False)
            else:
                self.faults.append(Fault("rule", sentences.goal_as_start(rule.from_), where(rule, "from")))
        cars: list[CaseSpec | OtherSpec] = []
        for test in world.spec.tests:
            cars += [test, *test.others.values()]
        for car in cars:
            start = car.start if car.start is not None else next(iter(world.starts))
            if start in world.starts and (car.goal is None or car.goal in world.goals):
                location = where(car, "goal" if car.goal is not None else "start")
                yield _Trip(car.vehicle, where(car, "vehicle"), start, car.goal, 0.0, location)
        if vehicle is not None:
            for start in world.starts:
                yield _Trip(vehicle, "--vehicle", start, None, 0.0, where(world.spec, "start", start))

    def _check_trip(self, trip: _Trip) -> None:
        subject = self._subject(trip)
        if subject is None:
            return
        key = trip.vehicle, trip.start
        # Tests often share start and goal: each start and each path is examined once.
        if key not in self._starts:
            bad = find_bad_start(self._world, self._near, trip.start, subject.body, subject.volume)
            self.faults += bad
            self._starts[key] = not bad
        # The actors are there only when a vehicle is driven, not for a rule about the world.
        if trip.with_actors and key not in self._met:
            self._met.add(key)
            start = self._world.starts[trip.start]
            text, pose = f"{subject.body.name} at '{trip.start}'", np.array([start.x, start.y, start.yaw])
            standing = Standing(text, where(self._world.spec, "start", trip.start), subject.volume, pose)
            self.faults += find_actors_at(standing, self._actors)
        # From a bad start no path can be found, and its fault is reported already.
        if trip.goal is None or not self._starts[key] or goal_area(self._world, trip.goal) is None:
            return
        route = (*key, trip.goal, trip.margin)
        if route not in self._results:
            result = find_path(
                self._world, subject.body, subject.obstacles, trip.start, trip.goal,
                margin=trip.margin, time_limit=self._time_limit,
            )  # fmt: skip
            self._results[route] = result
            if isinstance(result, VehiclePath):
                self.paths.append(result)
        message = self._results[route]
        if isinstance(message, str):
            self.faults.append(Fault("unreachable", message, trip.where))

    def _subject(self, trip: _Trip) -> _Subject | None:
        """Return the vehicle with its obstacles; None if it cannot be loaded."""
        if trip.vehicle not in self._subjects:
            try:
                vehicle = load_vehicle(trip.vehicle, where=trip.vehicle_where)
                body, volume = Body.of(vehicle, name=trip.vehicle), volume_of(vehicle)
            except MirdrakeError as error:
                self.faults += _faults_of("file", error)
                self._subjects[trip.vehicle] = None
            else:
                self._subjects[trip.vehicle] = _Subject(body, volume, obstacles_for(self._near, volume))
        return self._subjects[trip.vehicle]


def _condition_remarks(world: World) -> list[str]:
    """Return a line for each name of a condition that only a diagram can explain: no test has such a vehicle."""
    if world.spec.tests:  # their vehicles are known: another name is a fault of the test
        return []
    known = {"ego", *(actor.name for actor in world.moving)}
    return [
        f"{location}: no actor is called '{condition.of}'; each diagram of this world needs a vehicle of this name"
        for location, _, condition in conditions(world.spec.actors, world.spec.scenario)
        if condition.of is not None and condition.of not in known
    ]


def _unchecked_drivers(world: World) -> list[str]:
    """Return a line for each driver of a test that is a user class, which is not executed here."""
    lines = []
    for test in world.spec.tests:
        drivers = [(where(test, "behaviour"), test.behaviour)]
        drivers += [(where(other, "behaviour"), other.behaviour) for other in test.others.values()]
        for location, given in drivers:
            kind = given if isinstance(given, str) else str(given.get("kind", ""))
            if ":" in kind:
                lines.append(
                    f"not checked: {location} ({kind}): mirdrake world check executes user modules only with --trust"
                )
    return lines


def _test_faults(world: World, overrides: Iterable[str], known: set[str], *, trust: bool) -> list[Fault]:
    """Return the faults of the tests of a world that are not known already.

    Args:
        world: the world, from a file.
        overrides: overrides of the file.
        known: texts of faults that were found.
        trust: whether user classes that are drivers are executed: they are checked by the diagram of the test.
    """
    from mirdrake.assembly.diagram import assemble
    from mirdrake.suites.cases import collect_cases

    assert world.path is not None
    faults = []
    try:
        cases = collect_cases([world.path], values=_values(overrides))
    except ConfigError as error:
        faults = _faults_of("test", error)
    else:
        tests = {test.name: test for test in world.spec.tests}
        # Variations have the same drivers: the first case of each test is enough.
        firsts = {case.test: case for case in reversed(cases)} if trust else {}
        for case in firsts.values():
            if not any(":" in driver["kind"] for driver in case.diagram["control"].values()):
                continue
            try:
                assemble(case.diagram)
            except MirdrakeError as error:
                faults += _faults_of("test", error.under(where(tests[case.test], "behaviour")))
    return [fault for fault in faults if fault.text not in known]


def _values(overrides: Iterable[str]) -> Mapping[str, float | str | bool | None]:
    """Return the seed and the parameters among overrides."""
    values = {}
    for override in overrides:
        key, _, text = override.partition("=")
        name = key.strip().removeprefix("params.")
        if name == "seed" or name != key.strip():
            values[name] = parse_tree(text, "--set")[0]
    return values


def _faults_of(kind: Kind, error: MirdrakeError) -> list[Fault]:
    return [_fault_of(kind, fault) for fault in error.faults]


def _fault_of(kind: Kind, error: MirdrakeError) -> Fault:
    return Fault(kind, error.text, error.where)

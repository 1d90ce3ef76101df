"""Cases: variations of the tests of a world file as plain data, and their results."""

import json
import math
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Literal

from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.assembly.inputs import input_digest
from mirdrake.core.digest import digest_data
from mirdrake.core.errors import ConfigError, MirdrakeError, WorldError, did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import read_tree, shortest_name, where
from mirdrake.requirements import Requirement, parse_requirement
from mirdrake.requirements.observation import LAP_SIGNALS, TRACK_SIGNALS
from mirdrake.requirements.surroundings import GAP
from mirdrake.vehicles.vehicle import find_vehicle
from mirdrake.worlds import World, load_world
from mirdrake.worlds.actors_spec import conditions
from mirdrake.worlds.case_spec import CaseSpec, OtherSpec, SearchSpec

Verdict = Literal["pass", "fail", "error", "invalid"]
Value = float | str | bool | None
"""Value of a parameter of a world."""

Values = Mapping[str, Value]

_MARKS = ("$", "..", "+-", "|")  # of values that are computed or drawn by chance, see mirdrake.worlds.values

VEHICLE = "ego"
"""Name of the vehicle under test in its diagram."""


@dataclass(frozen=True)
class OtherExpectations:
    """Requirements on another vehicle of a test.

    Attributes:
        vehicle: its name.
        expect: requirements, each with its place in the file.
        goal: meaning of ``at goal`` for it.
    """

    vehicle: str
    expect: tuple[tuple[str, str], ...]
    goal: str | None = None


@dataclass(frozen=True)
class Case:
    """One variation of a test; plain data, so that it can be sent to another process and written down.

    Attributes:
        name: ``test#number``, unique in a suite.
        test: name of the test.
        world: path of the world file.
        values: values of the seed and the parameters that vary.
        diagram: data of the diagram to simulate.
        expect: requirements, each with its place in the file.
        goal: meaning of ``at goal``.
        content: SHA-256 of the files of the world and the vehicles, and of modules of behaviours beside the world.
        pinned: those of the values that do not stand in the world file.
        others: requirements on the other vehicles.
    """

    name: str
    test: str
    world: str
    values: Values
    diagram: Json
    expect: tuple[tuple[str, str], ...]
    goal: str | None = None
    content: str = ""
    pinned: Values = field(default_factory=dict)
    others: tuple[OtherExpectations, ...] = ()

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return float(self.diagram["duration"])

    @property
    def slug(self) -> str:
        """The name of the case as a file name."""
        return self.name.replace("#", "-")

    @property
    def command(self) -> str:
        """The command that runs the case again, in this working directory."""
        number = self.name.rpartition("#")[2]
        # When values for all variations are pinned, there is only one variation left, which needs no number.
        name = self.test if self.pinned.keys() >= self.values.keys() and self.pinned else f"{self.test}#{number}"
        pins = "".join(f" -p {key}={shlex.quote(str(value))}" for key, value in self.pinned.items())
        return f"mirdrake world test {shlex.quote(shortest_name('worlds', Path(self.world)))} --case {name}{pins}"

    def digest(self) -> str:
        """Return the digest of the case; equal cases have equal digests."""
        return digest_data(self.data())

    def data(self) -> Json:
        """Return plain data for JSON."""
        data = asdict(self) | {"expect": [list(pair) for pair in self.expect]}
        others = [asdict(other) | {"expect": [list(pair) for pair in other.expect]} for other in self.others]
        # Without others the key is left out, so that digests of earlier results remain valid.
        return data | {"others": others} if others else {key: data[key] for key in data if key != "others"}


@dataclass(frozen=True)
class Judgement:
    """Judgement of a requirement, as stored in the results.

    Attributes:
        text: text of the requirement.
        passed: whether it holds.
        margin: distance from the limit [unit]; None if it is infinite.
        unit: unit of the margin.
        share: the margin over a usual size, in searches its quantile, so that margins of all units can be compared [1];
            None if it is infinite.
        worst_time: time of the smallest margin [s].
        decided_by: signal that decides.
    """

    text: str
    passed: bool
    margin: float | None
    unit: str
    share: float | None
    worst_time: float
    decided_by: str

    @property
    def rank(self) -> tuple[bool, float]:
        """Sorts the worst judgement first: failures, then by share."""
        return self.passed, math.inf if self.share is None else self.share


@dataclass(frozen=True)
class Result:
    """The result of a case.

    Attributes:
        name: name of the case.
        verdict: pass, fail, error or invalid.
        reason: one line; empty for a pass.
        findings: judgement of each requirement; none if the case could not be judged.
        simulated: simulated time [s].
        wall: computing time [s].
        folder: run folder of a case that did not pass, below that of the suite.
        digest: digest of the case.
    """

    name: str
    verdict: Verdict
    reason: str = ""
    findings: tuple[Judgement, ...] = ()
    simulated: float = 0.0
    wall: float = 0.0
    folder: str | None = None
    digest: str = ""

    @property
    def worst(self) -> Judgement | None:
        """The judgement with the smallest share; one that failed comes before one that holds."""
        return min(self.findings, key=lambda finding: finding.rank, default=None)

    @property
    def margin(self) -> float:
        """The margin of the worst finding, in its unit; infinite if there is none."""
        worst = self.worst
        return math.inf if worst is None or worst.margin is None else worst.margin

    @property
    def share(self) -> float:
        """The share of the worst finding [-]; infinite if there is none."""
        worst = self.worst
        return math.inf if worst is None else worst.rank[1]

    @property
    def place(self) -> tuple[float, ...]:
        """Sorts the worst case first: errors, invalid worlds, failures and passes, each by their smallest share."""
        # Errors first: what could not be judged may hide anything.
        return ({"error": 0, "invalid": 1, "fail": 2, "pass": 3}[self.verdict], self.share)

    def data(self) -> Json:
        """Return plain data for JSON."""
        return asdict(self)


def collect_cases(
    files: Iterable[str | Path], *, only: Collection[str] = (), values: Values | None = None
) -> list[Case]:
    """Return all variations of all tests of some worlds, in the order of the files.

    Args:
        files: names or paths of world files.
        only: names of cases (``test#2``) or of tests; all of them if empty.
        values: values of parameters or of the seed, in place of their variations.

    Raises:
        ConfigError: a file, a test or a requirement has faults, one per line; or a name of `only` is unknown.
    """
    faults: list[MirdrakeError] = []
    collected: list[tuple[str, Case]] = []
    for name in files:
        try:
            path = find("worlds", str(name))
            world = load_world(str(path))
        except MirdrakeError as error:
            faults.append(error)
            continue
        if not world.spec.tests:
            text = "there is nothing to test; add tests to the file"
            faults.append(ConfigError(text, where=where(world.spec, "tests")))

        # Cases of a test with faults are not made: its diagrams would fail with a less helpful message.
        test_faults = [fault for test in world.spec.tests for fault in _faults(world, test, values or {}, path)]
        faults += test_faults
        if not test_faults:
            collected += [
                (world.name, case) for test in world.spec.tests for case in _cases(world, test, path, values or {})
            ]
    if faults:
        raise ConfigError(faults=faults)
    cases = _distinct(collected)
    # Names are checked last, because they may be prefixed by the world's name.
    known = {name for case in cases for name in (case.name, case.name.split("#")[0])}
    for name in only:
        if name not in known:
            raise ConfigError(f"unknown case '{name}'; {did_you_mean(name, known)}")
    return [case for case in cases if not only or {case.name, case.name.split("#")[0]} & set(only)]


def collect_searches(
    file: str | Path, *, only: Collection[str] = (), values: Values | None = None
) -> list[tuple[Case, SearchSpec]]:
    """Return the tests of a world that have a search, each with the first of its variations.

    Args:
        file: name or path of a world file.
        only: names of tests or cases; all tests with `search` if empty.
        values: values of parameters or of the seed, in place of their variations.

    Raises:
        ConfigError: see :func:`collect_cases`; or no test has a search.
    """
    cases = collect_cases([file], only=only, values=values)
    spec = load_world(cases[0].world).spec
    searched = {test.name: test.search for test in spec.tests if test.search is not None}
    # Reversed, so that the first case of each test is the one that remains.
    firsts = {case.test: case for case in reversed(cases)}
    for name in dict.fromkeys(case.test for case in cases if only and case.test not in searched):
        hint = f"these do: {', '.join(searched)}" if searched else "add search: {over: {NAME: [LOW, HIGH]}}"
        raise ConfigError(f"'{name}' has no search; {hint}", where=where(spec, "tests"))
    if not searched:
        raise ConfigError(
            "no test has a search; add search: {over: {NAME: [LOW, HIGH]}} to one", where=where(spec, "tests")
        )
    return [(firsts[name], searched[name]) for name in dict.fromkeys(case.test for case in cases) if name in searched]


def vary(case: Case, values: Values, *, name: str | None = None) -> Case:
    """Return the same case with other values of parameters or of the seed."""
    merged, path = {**case.values, **values}, Path(case.world)

    # The test itself is evaluated again only if it depends on the values, since that lays out the whole world.
    seed = _seed(merged, case.diagram["seed"])
    test = _varied(case.test, path, merged) if _varies(case.test, path) else None
    diagram = case.diagram | {"world": _world_entry(case.world, merged), "seed": max(0, seed)}
    if test is not None:
        diagram = _diagram(test, path, merged, seed)
    return replace(case, name=name or case.name, values=merged, diagram=diagram, pinned=merged)


def _cases(world: World, test: CaseSpec, path: Path, values: Values) -> Iterator[Case]:
    """Yield the variations of one test: all combinations, the last key varies fastest."""
    axes = {key: _axis(key, given, world.spec.seed) for key, given in test.variations.items()}
    # A pinned value replaces the variation of its parameter by a single one, or adds an axis of length one.
    axes |= {key: [value] for key, value in values.items()}
    expect = tuple((text, where(test, "expect", index)) for index, text in enumerate(test.expect))
    others = tuple(
        OtherExpectations(
            name, tuple((text, where(other, "expect", index)) for index, text in enumerate(other.expect)), other.goal
        )
        for name, other in test.others.items()
    )
    varies, content = _varies(test.name, path), _content(world, test, path)
    for number, chosen in enumerate(product(*axes.values()), start=1):
        picked = dict(zip(axes, chosen, strict=True))
        own = _varied(test.name, path, picked) if varies and picked else None
        # None: the world cannot be laid out with these values; its run then reports the verdict invalid.
        diagram = _diagram(own or test, path, picked, _seed(picked, world.spec.seed))
        yield Case(
            f"{test.name}#{number}", test.name, str(path), picked, diagram, expect, test.goal, content, dict(values),
            others,
        )  # fmt: skip


def _content(world: World, test: CaseSpec, path: Path) -> str:
    """Return the digest of the files that the test consists of."""
    cars: list[CaseSpec | OtherSpec] = [test, *test.others.values()]
    full = world.full_actors
    folders = [find_vehicle(name)[0] for name in (*(car.vehicle for car in cars), *(actor.model for actor in full))]
    return input_digest(world, folders, [car.behaviour for car in cars], path.parent)


def _varies(name: str, path: Path) -> bool:
    """Return whether the behaviour of a test depends on parameters or random values."""
    # The raw text decides, because the loaded world has only the evaluated values.
    tree, _ = read_tree(path)
    raw = [test for test in tree.get("tests", ()) if test.get("name") == name]
    return any(
        mark in f"{test.get('behaviour')} {test.get('duration')} {test.get('others')}"
        for test in raw
        for mark in _MARKS
    )


def _varied(name: str, path: Path, values: Values) -> CaseSpec | None:
    """Return a test with other values; None if the world cannot be laid out, which its run will report."""
    try:
        world = load_world(str(path), overrides=overrides(values))
    except WorldError:
        return None
    return next(other for other in world.spec.tests if other.name == name)


def overrides(values: Values) -> list[str]:
    """Return values as overrides of the world file, see :func:`mirdrake.worlds.load_world`."""
    return [f"{key if key == 'seed' else f'params.{key}'}={json.dumps(value)}" for key, value in values.items()]


def _seed(values: Values, usual: int) -> int:
    """Return the seed among some values; the usual one if it is not among them."""
    return int(str(values.get("seed", usual)))


def _axis(key: str, given: int | Sequence[Value], seed: int) -> list[Value]:
    """Return the values of a variation; a number of seeds counts up from the seed of the world."""
    if isinstance(given, int):
        return [seed + index for index in range(given)] if key == "seed" else [given]
    return list(given)


def _diagram(test: CaseSpec, path: Path, values: Values, seed: int) -> Json:
    drivers = {VEHICLE: test.behaviour} | {name: other.behaviour for name, other in test.others.items()}
    control = {name: {"kind": given} if isinstance(given, str) else dict(given) for name, given in drivers.items()}
    others = {name: {"model": other.vehicle, "start": other.start} for name, other in test.others.items()}
    return {
        "name": test.name,
        # Plain data instead of objects: the case is sent to worker processes and written to JSON.
        "world": _world_entry(str(path), values),
        "vehicles": {VEHICLE: {"model": test.vehicle} | ({"start": test.start} if test.start else {})} | others,
        "control": control,
        "plant": {"contact": test.contact},
        # Thousands of runs: no visualisation and no report per run.
        "record": {"meshcat": False, "report": False},
        "duration": test.duration,
        "seed": max(0, seed),
        "folder": str(path.parent),
    }


def _world_entry(path: str, values: Values) -> str | Json:
    if not values:
        return path
    parameters = {key: value for key, value in values.items() if key != "seed"}
    return {"name": path, "params": parameters} | ({"seed": _seed(values, 0)} if "seed" in values else {})


def _distinct(collected: Sequence[tuple[str, Case]]) -> list[Case]:
    """Make the names of cases unique: the world's name precedes tests that have the same name in two files."""
    worlds: dict[str, set[str]] = {}
    for _, case in collected:
        worlds.setdefault(case.test, set()).add(case.world)
    # Only names that occur in several files are prefixed, so that others remain as short as in the file.
    shared = {test for test, files in worlds.items() if len(files) > 1}
    cases = [replace(case, name=f"{world}.{case.name}") if case.test in shared else case for world, case in collected]
    taken: set[str] = set()
    for case in cases:
        if case.name in taken:
            raise ConfigError(f"two cases are called '{case.name}'; give the tests or the worlds other names")
        taken.add(case.name)
    return cases


# --- faults that are found before anything runs -----------------------------------------------------------------------


def _faults(world: World, test: CaseSpec, values: Values, path: Path) -> Iterator[MirdrakeError]:
    """Yield the faults of a test."""
    spec = world.spec
    first_at: dict[str, str] = {}
    cars: dict[str, CaseSpec | OtherSpec] = {VEHICLE: test, **test.others}
    for name, car in cars.items():
        yield from _vehicle_faults(world, car)
        first = first_at.setdefault(car.start or next(iter(world.starts)), name)
        if first != name:
            location = where(car, "start")
            yield ConfigError(
                f"'{name}' starts at the place of '{first}'; give each vehicle a start of its own", where=location
            )
    # Every place that names a parameter, with its location.
    named = [(key, where(test, "variations", key)) for key in test.variations]
    named += [(key, where(spec, "params")) for key in values]
    if test.search is not None:
        named += [(key, where(test.search, "over", key)) for key in test.search.over]
    for key, location in named:
        if key != "seed" and key not in spec.params:
            yield ConfigError(f"unknown parameter '{key}'; {did_you_mean(key, ['seed', *spec.params])}", where=location)

    # Each check is independent, so that all faults of a test are reported at once.
    try:
        # Loaded for its faults only; faults of the world itself, not of the values, are left to the runs.
        load_world(str(path), overrides=overrides(values)) if values else None
    except WorldError:
        pass  # its runs will report it
    except ConfigError as error:
        yield error
    try:
        # The diagram is validated with nominal values, to report faults of the behaviour at its place in the file.
        make_spec(_diagram(test, path, {}, spec.seed))
    except ConfigError as error:
        yield error.under(where(test, "behaviour"))
    expected: list[tuple[CaseSpec | OtherSpec, str, int]] = [(test, text, row) for row, text in enumerate(test.expect)]
    for name, other in test.others.items():
        expected += [(other, text, row) for row, text in enumerate(other.expect)]
        if name == VEHICLE:
            yield ConfigError(
                f"'{name}' is the vehicle under test; choose another name", where=where(test, "others", name)
            )
    for actor in world.moving:
        if actor.name in (VEHICLE, *test.others):
            location = where(actor.spec, "name")
            yield ConfigError(
                f"'{actor.name}' is the name of a vehicle of the test '{test.name}'; rename the actor", where=location
            )
    names = [*(actor.name for actor in world.moving), VEHICLE, *test.others]
    for location, _, condition in conditions(spec.actors, spec.scenario):
        if condition.of is not None and condition.of not in names:
            hint = did_you_mean(condition.of, names)
            yield ConfigError(
                f"there is no vehicle or actor '{condition.of}' in the test '{test.name}'; {hint}", where=location
            )
    for owner, text, index in expected:
        try:
            requirement = parse_requirement(text, where=where(owner, "expect", index))
        except ConfigError as error:
            yield error
        else:
            for fault in _unfit(requirement, world, test, owner.goal):
                yield ConfigError(f"'{requirement}': {fault}", where=requirement.where)


def _vehicle_faults(world: World, car: CaseSpec | OtherSpec) -> Iterator[MirdrakeError]:
    """Yield the names that a vehicle of a test has and its world has not."""
    for key, name, known in (("start", car.start, world.starts), ("goal", car.goal, world.goals)):
        if name is not None and name not in known:
            yield ConfigError(f"unknown {key} '{name}'; {did_you_mean(name, known)}", where=where(car, key))
    try:
        find_vehicle(car.vehicle, where=where(car, "vehicle"))
    except MirdrakeError as error:
        yield error


def _unfit(requirement: Requirement, world: World, test: CaseSpec, own_goal: str | None) -> Iterator[str]:
    # A requirement can be well-formed and still ask for something that this world does not have.
    """Yield what a requirement needs that the world or the test does not have; `own_goal` is that of the vehicle."""
    # `red` stands for the red light of the vehicle, unless the world has a goal of that name.
    for goal in requirement.goals:
        if goal == "red" and goal not in world.goals:
            if not world.lights:
                yield "the world has no traffic lights; add them under signals"
        elif goal == "goal" and own_goal is None and "goal" not in world.goals:
            yield "the test has no goal; add goal: NAME to it, or write the name after 'at'"
        elif goal != "goal" and goal not in world.goals:
            hint = did_you_mean(goal, world.goals) if world.goals else "the world has none; add them under goals"
            yield f"unknown goal '{goal}'; {hint}"
    for signal in requirement.signals:
        name = signal.removeprefix(GAP)
        names = [*(actor.name for actor in world.moving), VEHICLE, *test.others]
        if name != signal and name not in names:
            yield f"there is no vehicle or actor '{name}'; {did_you_mean(name, names)}"
        if signal in TRACK_SIGNALS and not world.tracks:
            yield f"'{signal}' needs a track, and the world has none"
        elif signal in LAP_SIGNALS and not any(track.closed for track in world.tracks.values()):
            yield f"'{signal}' needs a closed track, and the world has none"
    if requirement.after >= test.duration:
        yield f"nothing is after {requirement.after:g} s; the test lasts {test.duration:g} s"
    # The tolerance allows limits that end exactly with the test, up to rounding of their sum.
    elif math.isfinite(requirement.within) and requirement.after + requirement.within > test.duration + 1e-9:
        late = requirement.after + requirement.within
        yield f"it may take until {late:g} s, but the test lasts {test.duration:g} s; make its duration longer"

"""Studies of the single-track model: shards of many runs, each simulated as one batch.

A shard is plain data, so that a worker process or another computer can run it. Its size does not depend on the workers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.batched import Batch, BatchControl, BatchRun, PathDriver
from mirdrake.batched.arrays import Floats
from mirdrake.controllers.path_tracking import PathGains, PathTrackingSpec
from mirdrake.controllers.schedule import ConstantSpec, ScheduleSpec
from mirdrake.core.errors import ConfigError, did_you_mean, one_line
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import where
from mirdrake.execution.job import Outcome
from mirdrake.runs.summary import drive_figures
from mirdrake.single_track import estimate_parameters
from mirdrake.single_track.dynamics import Variant
from mirdrake.single_track.from_vehicle import tyres_of
from mirdrake.studies.plan import Plan, Shard
from mirdrake.vehicles import Vehicle

STEP = 0.005
"""Longest step of the integration [s]."""

LARGEST = 1000
"""Most runs of a shard."""

VALUES = 2e7
"""Most values of the signals of a shard, 160 MB."""

SIGNALS = ("vx", "speed_command", "lateral", "progress", "laps")
"""Signals from which the metrics are computed."""

FIGURES = ("laps", "max_abs_lateral_error_m", "mean_speed_error_percent", "distance_m", "max_speed_mps")
"""Figures of the vehicle that are metrics here."""

MASSES = ("mass", "yaw_inertia", "rotating_mass")
"""Parameters that are proportional to the mass scale."""


@dataclass(frozen=True, kw_only=True)
class BatchShard(Shard):
    """Runs of one batch.

    Attributes:
        diagram: data of the diagram.
        duration: simulated time [s].
    """

    diagram: Json
    duration: float


def make_shards(plan: Plan) -> list[BatchShard]:
    """Divide a study into shards."""
    rate = _vehicle(assemble(make_spec(plan.diagram))).control.rate
    # The signals of a batch are in memory at once; their number is that of periods, the start included.
    size = int(min(max(VALUES / (len(SIGNALS) * (plan.duration * rate + 1.0)), 1.0), LARGEST))
    metrics, shards = tuple(plan.spec.metrics), []
    for number, first in enumerate(range(0, len(plan.rows), size)):
        # Transposed: the batch is simulated by columns, one array per parameter.
        values = zip(*plan.rows[first : first + size], strict=True)
        columns = {
            name: [float(value) for value in column] for name, column in zip(plan.spec.parameters, values, strict=True)
        }
        shards.append(
            BatchShard(
                number=number, first=first, columns=columns, metrics=metrics,
                diagram=plan.diagram, duration=plan.duration
            )
        )  # fmt: skip
    return shards


def check_single_track(plan: Plan) -> None:
    """Check that the single-track model can simulate a study.

    Raises:
        ConfigError: it cannot; with the place in the file.
    """
    # Whatever the reduced model lacks is rejected, since it would be left out without a message.
    spec, diagram = plan.spec, make_spec(plan.diagram)
    if len(diagram.vehicles) != 1 or diagram.systems or diagram.connect:
        raise ConfigError(
            "single_track is for a diagram with one vehicle and without systems; write model: plant",
            where=where(spec, "model"),
        )
    name = next(iter(diagram.vehicles))
    driver = diagram.control.get(name)
    if not isinstance(driver, PathTrackingSpec | ConstantSpec | ScheduleSpec):
        raise ConfigError(
            "single_track is for the drivers path_tracking, constant and schedule; write model: plant",
            where=where(spec, "model"),
        )

    # Parameters and metrics are checked by name here; the values are checked when a shard is built.
    known = set(_appliers(name, driver, plan.diagram))
    for parameter in spec.parameters:
        if parameter not in known and not _gain_of(name, parameter):
            raise ConfigError(
                f"the single-track model cannot vary it; {did_you_mean(parameter, known)}",
                where=where(spec, "parameters", parameter),
            )
    for column, metric in enumerate(spec.metrics):
        allowed = ["simulated_s", *(f"{name}.{figure}" for figure in FIGURES)]
        if metric not in allowed:
            raise ConfigError(
                f"not a metric of the single-track model; {did_you_mean(metric, allowed)}",
                where=where(spec, "metrics", column),
            )
    # A trial batch of one run: faults of the vehicle or the driver are reported before any worker starts.
    try:
        _Model(plan.diagram, {}, 1)
    except ConfigError as error:
        raise error.under(where(spec, "model")) from None


def run_shard(shard: BatchShard) -> list[Outcome]:
    """Simulate the runs of a shard as one batch; after an error all of them have failed."""
    try:
        # Runs that diverge overflow on purpose; they are reported as unstable.
        with np.errstate(all="ignore"):
            model = _Model(shard.diagram, {name: np.array(values) for name, values in shard.columns.items()},
                           shard.count)  # fmt: skip
            return model.outcomes(shard, model.run(shard.duration))
    except Exception as error:
        return shard.lost(one_line(error))


class _Model:
    """Cars, control units and driver of a shard.

    Args:
        diagram: data of the diagram.
        columns: values of each run by parameter.
        count: number of runs.

    Raises:
        ConfigError: a value is out of range, or the vehicle cannot be simulated in a batch.
    """

    def __init__(self, diagram: Json, columns: Mapping[str, Floats], count: int) -> None:
        self._assembly = assembly = assemble(make_spec(diagram))
        self.name = next(iter(assembly.parts.vehicles))
        self._vehicle, spec = _vehicle(assembly), assembly.spec
        self._driver = spec.control[self.name]
        self._count, self._laps = count, spec.laps
        self._gains: dict[str, Floats] = {}
        self._settings: dict[str, Floats] = {}  # of the driver

        # Friction columns scale parameters for a friction of one: the value is the coefficient of the road itself.
        world = assembly.parts.world
        nominal = estimate_parameters(self._vehicle, gravity=world.ground.gravity)
        road = estimate_parameters(self._vehicle, friction=1.0, gravity=world.ground.gravity)
        self._parameters: dict[str, Floats] = {}
        self._speed: Floats = np.full(count, float(assembly.spec.vehicles[self.name].speed or 0.0))
        appliers = _appliers(self.name, self._driver, diagram)
        for name, values in columns.items():
            if (gain := _gain_of(self.name, name)) is not None:
                self._gains[gain] = values
            elif appliers[name] == "mass":
                self._parameters |= {key: getattr(nominal, key) * values for key in MASSES}
            elif appliers[name] == "friction":
                for key in ("front_friction", "rear_friction"):
                    self._parameters[key] = getattr(road, key) * values
            elif appliers[name] == "start":
                self._speed = values
            else:
                self._settings[appliers[name]] = values

        # Cars at the start of the diagram.
        period = 1.0 / self._vehicle.control.rate
        # The largest step that divides the control period evenly; the tolerance absorbs rounding of the quotient.
        step = period / np.ceil(period / STEP - 1e-9)
        variant = Variant(tyres_of(self._vehicle), relaxation=True, actuators=True)
        cars = Batch(nominal, variant, columns=self._parameters, count=count, step=step)
        start = assembly.starts[self.name]
        cars.reset(x=start.x, y=start.y, yaw=start.yaw, vx=self._speed)
        self._control = BatchControl(cars, self._vehicle, gains=self._gains)
        self.period = period

    def run(self, duration: float) -> BatchRun:
        """Simulate all runs."""
        periods = round(duration / self.period) + 1
        driver = self._driver
        if isinstance(driver, PathTrackingSpec):
            track = self._assembly.parts.world.tracks[driver.track]
            tracker = PathDriver(
                track, self._vehicle.geometry, driver.gains(), columns=self._settings, period=driver.period,
                limits=driver.limits(),
            )  # fmt: skip
            return self._control.follow(tracker, periods=periods, outputs=SIGNALS)
        if isinstance(driver, ConstantSpec):
            commands = np.empty((self._count, periods, 2))
            # Constant over the run, but possibly different between runs.
            commands[:, :, 0] = self._settings.get("speed", np.full(self._count, driver.speed))[:, None]
            commands[:, :, 1] = self._settings.get("steering", np.full(self._count, driver.steering))[:, None]
            return self._control.run(commands, outputs=SIGNALS)
        assert isinstance(driver, ScheduleSpec)
        schedule = driver.schedule()
        rows = np.array([schedule.at(k * self.period) for k in range(periods)])
        return self._control.run(rows, outputs=SIGNALS)

    def outcomes(self, shard: BatchShard, run: BatchRun) -> list[Outcome]:
        """Return the outcome of each run."""
        curvature = None
        if isinstance(self._driver, PathTrackingSpec):
            curvature = self._curvature(run)
        outcomes = []

        # All runs of a batch have the same length; each is cut where it would have ended alone.
        for k in range(self._count):
            index = shard.first + k
            if k in run.diverged:
                outcomes.append(Outcome(index, "unstable", "the state is not finite"))
                continue
            # A run ends after its laps.
            last = len(run.time)
            if self._laps is not None and curvature is not None:
                done = np.flatnonzero(run["laps"][k] >= self._laps)
                # The sample in which the last lap is complete belongs to the run.
                last = int(done[0]) + 1 if len(done) else last
            signals = {"vx": run["vx"][k, :last], "speed_command": run["speed_command"][k, :last]}
            if curvature is not None:
                signals |= {
                    "lap": run["laps"][k, :last],
                    "lateral_error": run["lateral"][k, :last],
                    "curvature": curvature[k, :last],
                }
            figures = drive_figures(run.time[:last], signals)
            simulated = float(run.time[last - 1])
            values = {f"{self.name}.{name}": value for name, value in figures.items()} | {"simulated_s": simulated}
            metrics = tuple(_number(values[name]) for name in shard.metrics)
            outcomes.append(Outcome(index, "ok", "", simulated, metrics))
        return outcomes

    def _curvature(self, run: BatchRun) -> Floats:
        """Return the curvature of the track at each car (n, t) [1/m]."""
        assert isinstance(self._driver, PathTrackingSpec)
        track = self._assembly.parts.world.tracks[self._driver.track]
        return np.asarray(track.curvature(run["progress"]), dtype=np.float64)


def _vehicle(assembly: Assembly) -> Vehicle:
    return next(iter(assembly.parts.vehicles.values())).vehicle


def _appliers(name: str, driver: object, diagram: Mapping[str, Any]) -> dict[str, str]:
    """Return what each parameter of a study changes: mass, friction, start, or a setting of the driver."""
    del diagram
    known = {f"{name}.mass_scale": "mass", "road.friction": "friction", f"vehicles.{name}.speed": "start"}
    settings: tuple[str, ...] = ()
    if isinstance(driver, PathTrackingSpec):
        settings = tuple(field.name for field in fields(PathGains))
    elif isinstance(driver, ConstantSpec):
        settings = ("speed", "steering")
    return known | {f"control.{name}.{setting}": setting for setting in settings}


def _gain_of(name: str, parameter: str) -> str | None:
    """Return the gain of the control unit that a parameter of a study is; None if it is another parameter."""
    head, _, rest = parameter.partition(".")
    return rest if head == name and rest.split(".")[0] in ("speed", "wheel_speed") else None


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)

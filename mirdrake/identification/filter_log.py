"""Filter bank along a recorded log."""

from collections.abc import Mapping

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.estimation import Estimates, FilterBank, FilterSpec
from mirdrake.estimation.spec import SENSORS
from mirdrake.identification.channels import quantity
from mirdrake.identification.data import Array, Log
from mirdrake.identification.relations import make_grid
from mirdrake.single_track.parameters import SingleTrackParameters


def log_sensors(log: Log) -> dict[str, str]:
    """Return the channel of a log for each sensor of a filter; the first of several sources."""
    found: dict[str, str] = {}
    for name in log.channels:
        sensor = {"road_wheel_angle": "steering", "speed": "vx"}.get(quantity(name), quantity(name))
        if sensor in SENSORS:
            found.setdefault(sensor, name)
    # A hand wheel angle or the speed over ground serve where nothing better is recorded.
    hand_wheel = next((name for name in log.channels if quantity(name) == "steering_wheel_angle"), None)
    if "steering" not in found and hand_wheel is not None:
        found["steering"] = hand_wheel
    forward = next((name for name in log.channels if quantity(name) == "vx"), None)
    return found if forward is None else found | {"vx": forward}


def filter_log(log: Log, car: SingleTrackParameters, spec: FilterSpec, *, ratio: float = 1.0) -> Estimates:
    """Run a filter bank over a log.

    The period is the step of the log. Missing values stay missing; the spec's sensors that the log lacks are an error.

    Args:
        log: checked log.
        car: parameters of the car.
        spec: settings; its period is replaced.
        ratio: steering wheel angle over road wheel angle, for a log without a road wheel angle [1].

    Raises:
        ConfigError: the log lacks a sensor, or the settings do not fit the car.
    """
    channels = log_sensors(log)
    missing = [name for name in spec.sensors if name not in channels]
    if missing:
        raise ConfigError(
            f"log {log.name}: no channel for the sensor '{missing[0]}'; it has {', '.join(sorted(log.channels))}"
        )
    grid = make_grid(log)
    bank = FilterBank(car, spec.model_copy(update={"period": grid.step}))
    columns = [_column(log, grid.channels, channels[name], ratio) for name in spec.sensors]
    return bank.run(np.stack(columns, axis=1))


def _column(log: Log, grid: Mapping[str, Array], name: str, ratio: float) -> Array:
    """Return the samples of a channel on the grid; NaN where the log has none."""
    values = np.array(grid[name])
    recorded = log.channels[name]
    # The grid bridges missing values, which a filter does not need.
    if len(recorded) == len(values):
        values[~np.isfinite(recorded)] = np.nan
    return values / ratio if quantity(name) == "steering_wheel_angle" else values

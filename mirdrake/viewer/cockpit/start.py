"""The diagram of a manual drive, and the limits of manual driving."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import yaml

from mirdrake.assembly.diagram_spec import DiagramSpec, make_spec
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.viewer.cockpit.driver import KIND
from mirdrake.viewer.cockpit.manual import ManualLimits

NAME = "ego"
"""Name of the driven vehicle."""

TOP_SPEED = 40.0
"""Largest speed command, if the wheels do not limit it further [m/s]."""


def drive_spec(data: Mapping[str, Any], *, overrides: Sequence[str] = ()) -> DiagramSpec:
    """Return a diagram whose vehicle "ego" is driven manually.

    Args:
        data: data of a diagram file, with no driver for "ego".
        overrides: ``"dotted.path=value"`` texts, applied over it.

    Raises:
        ConfigError: the data have faults.
    """
    given = dict(data)
    given["control"] = {**given.get("control", {}), NAME: {"kind": KIND}}
    if not overrides:
        return make_spec(given)
    return parse_yaml(yaml.safe_dump(given, sort_keys=False), DiagramSpec, name="drive", overrides=overrides)


def manual_limits(part: VehicleInPlant) -> ManualLimits:
    """Return the limits of manual driving, from the wheels, control.yaml and the steering of a vehicle."""
    geometry, loop = part.vehicle.geometry, part.vehicle.control.speed
    fastest = min(
        float(joint.velocity_upper_limits()[0]) * radius
        for joint, radius in zip(part.wheels, geometry.wheel_radii, strict=True)
    )
    # A margin of 5 % to the velocity limits of the wheel joints.
    forward = min(TOP_SPEED, 0.95 * fastest) if isfinite(fastest) and fastest > 0.0 else TOP_SPEED
    return ManualLimits(
        forward=forward,
        backward=min(0.25 * forward, 5.0),
        acceleration=min(loop.max_acceleration, 4.0),
        braking=min(loop.max_deceleration, 7.0),
        steering=0.95 * geometry.steering_limit,
        wheelbase=geometry.wheelbase,
    )

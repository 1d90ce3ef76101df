"""What is done with a data file when no study says it: the model that its channels allow, and a part held out."""

from collections.abc import Iterable
from pathlib import Path

import yaml

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import load_yaml, parse_yaml, shown, where
from mirdrake.identification.channels import CHANNELS
from mirdrake.identification.models.single_track import SPEED
from mirdrake.identification.models.steer import STEERING
from mirdrake.identification.spec import DataSpec
from mirdrake.identification.study import StudySpec

HELD_OUT = 0.3
"""Part of the drives that is held out when none of them is for validation."""

_SIDEWAYS = ("yaw_rate", "lateral_acceleration", "vy")


def default_study(path: Path, *, overrides: Iterable[str] = ()) -> StudySpec:
    """A study for a data file.

    Args:
        path: file of format ``mirdrake: data/1``.
        overrides: ``"dotted.path=value"`` texts for the study.

    Raises:
        ConfigError: the file has faults, or no model can be fitted to its channels; one line per fault.
    """
    spec = load_yaml(path, DataSpec)
    shared = set.intersection(*({*spec.channels, *entry.channels} for entry in spec.logs))
    kind = _kind(spec, shared)
    about = f"no study is given: model {kind} by the channels there"
    content: dict[str, object] = {
        "mirdrake": "identification/1", "name": path.stem, "data": path.name, "model": {"kind": kind},
    }  # fmt: skip
    if not any(entry.use == "validation" for entry in spec.logs):
        content["validation_fraction"] = HELD_OUT
        about += f", {100.0 * HELD_OUT:.0f} % of the drives held out"
    if spec.wheelbase is None and kind == "single_track":
        about += ", a usual wheelbase for such bends; add 'wheelbase' to the data file"
    text = yaml.safe_dump({**content, "about": about}, sort_keys=False)
    return parse_yaml(text, StudySpec, name=shown(path), overrides=overrides)


def _kind(spec: DataSpec, shared: set[str]) -> str:
    """The model that the most can be learnt from."""
    if {"road_wheel_angle", *SPEED}.isdisjoint(shared) and not {*STEERING}.isdisjoint(shared):
        raise ConfigError(
            f"{where(spec, 'channels')}: no speed is mapped; add vx or speed to fit a model to the steering"
        )
    fast, turning = not {*SPEED}.isdisjoint(shared), not {*_SIDEWAYS}.isdisjoint(shared)
    if fast and turning and not {*STEERING}.isdisjoint(shared):
        return "single_track"
    if "road_wheel_angle" in shared and not {*STEERING[1:]}.isdisjoint(shared):
        return "steering"
    if fast and not {"throttle", "brake", "drive_torque", "brake_torque"}.isdisjoint(shared):
        return "longitudinal"
    missing = "the steering (road_wheel_angle, steering_wheel_angle or steering_command)"
    if not fast:
        missing = "a speed (vx or speed)"
    elif not {*STEERING}.isdisjoint(shared):
        missing = "yaw_rate, lateral_acceleration or vy"
    known = ", ".join(sorted(shared & set(CHANNELS))) or "none"
    raise ConfigError(
        f"{where(spec, 'channels')}: no model can be fitted to what all logs share ({known}); map {missing} too"
    )

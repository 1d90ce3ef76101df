"""Study for a data file on its own: the model that its channels allow, and a part of the logs for validation."""

from collections.abc import Iterable
from pathlib import Path

import yaml

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path, load_yaml, parse_yaml, where
from mirdrake.identification.channels import CHANNELS
from mirdrake.identification.derived import available
from mirdrake.identification.models.base import SPEED
from mirdrake.identification.models.registry import default_models, model_class
from mirdrake.identification.models.steer import STEERING
from mirdrake.identification.spec import DataSpec
from mirdrake.identification.study import StudySpec

VALIDATION_FRACTION = 0.3
"""Share of the recorded time used for validation when no log is marked for it."""


def default_study(path: Path, *, overrides: Iterable[str] = ()) -> StudySpec:
    """Return a study for a data file.

    Args:
        path: file of format ``mirdrake: data/1``.
        overrides: ``"dotted.path=value"`` texts for the study.

    Raises:
        ConfigError: the file has faults, or no model can be fitted to its channels; one line per fault.
    """
    spec = load_yaml(path, DataSpec)
    # Only channels that all logs have can be inputs or outputs of one fit.
    shared = set.intersection(*(available({*spec.channels, *entry.channels}) for entry in spec.logs))
    kind = next(default_models(shared), None)
    if kind is None or (_needs_speed(shared) and "road_wheel_angle" not in shared):
        raise ConfigError(f"{_missing(shared)}", where=where(spec, "channels"))
    about = f"no study is given: model {kind}, chosen by the channels"
    content: dict[str, object] = {
        "mirdrake": "identification/1", "name": path.stem, "data": path.name, "model": {"kind": kind},
    }  # fmt: skip
    if not any(entry.use == "validation" for entry in spec.logs):
        content["validation_fraction"] = VALIDATION_FRACTION
        about += f", {100.0 * VALIDATION_FRACTION:.0f} % of the recorded time for validation"
    known = {name: getattr(spec, name) for name in model_class(kind).data_parameters}
    content["parameters"] = {
        name: {"fixed": value, "source": "data file"} for name, value in known.items() if value is not None
    }
    if spec.wheelbase is None and model_class(kind).uses_steering_guess:
        about += ", an assumed wheelbase that suits the turns; add 'wheelbase' to the data file"
    text = yaml.safe_dump({**content, "about": about}, sort_keys=False)
    return parse_yaml(text, StudySpec, name=display_path(path), overrides=overrides)


def _needs_speed(shared: set[str]) -> bool:
    return shared.isdisjoint(SPEED) and not shared.isdisjoint(STEERING)


def _missing(shared: set[str]) -> str:
    """Return which channel to map so that a model can be fitted."""
    if _needs_speed(shared) and "road_wheel_angle" not in shared:
        return "no speed is mapped; add vx or speed to fit a model to the steering"
    missing = "the steering (road_wheel_angle, steering_wheel_angle or steering_command)"
    if shared.isdisjoint(SPEED):
        missing = "a speed (vx or speed)"
    elif not shared.isdisjoint(STEERING):
        missing = "yaw_rate, lateral_acceleration or vy"
    known = ", ".join(sorted(shared & set(CHANNELS))) or "none"
    return f"no model can be fitted to what all logs share ({known}); map {missing} too"

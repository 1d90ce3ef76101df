"""The models by name."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.identification.data import DataSet
from mirdrake.identification.models.base import Model, ModelSpec
from mirdrake.identification.models.direct import JointLoopModel, KinematicModel, SteeringModel
from mirdrake.identification.models.first_guess import SteeringGuess, guess_steering, with_guess
from mirdrake.identification.models.longitudinal import LongitudinalModel
from mirdrake.identification.models.single_track import SingleTrackModel
from mirdrake.identification.models.steer import STEERING


def _plant(*arguments: Any, **options: Any) -> Model:
    """The full plant; Drake's plant and its world are only loaded for it."""
    from mirdrake.identification.models.plant import PlantModel

    return PlantModel(*arguments, **options)


MODELS: dict[str, Callable[..., Model]] = {
    "kinematic": KinematicModel,
    "single_track": SingleTrackModel,
    "single_track_roll": partial(SingleTrackModel, roll=True),
    "longitudinal": LongitudinalModel,
    "steering": SteeringModel,
    "joint_loop": JointLoopModel,
    "plant": _plant,
}
"""Each is called with the shared channels, known values, the wheelbase, and its options."""

TURNING = frozenset({"kinematic", "single_track", "single_track_roll"})
"""Models whose steering gets its first guess from slow bends."""


def make_model(spec: ModelSpec, data: DataSet, given: Mapping[str, float]) -> Model:
    """A model for a data set.

    Args:
        spec: which.
        data: what it will be fitted to.
        given: what is known of its parameters.

    Raises:
        ConfigError: unknown kind or option, or a channel is missing.
    """
    if spec.kind not in MODELS:
        raise ConfigError(f"model: unknown model '{spec.kind}'; {did_you_mean(spec.kind, MODELS)}")
    offered = set.intersection(*(set(log.channels) for log in data.logs)) if data.logs else set()
    options: dict[str, Any] = dict(spec.options)
    guess, steer = None, next((name for name in STEERING if name in offered), "")
    if spec.kind in TURNING and steer:
        guess = guess_steering(data.train or data.logs, steer)
        if guess is not None and data.wheelbase is None:
            given = {"assumed_wheelbase": _wheelbase(guess, steer), **given}
    try:
        model = MODELS[spec.kind](offered, given, data.wheelbase, **options)
    except TypeError as error:
        if "unexpected keyword" in str(error):
            name = str(error).split("'")[1]
            raise ConfigError(f"model.{name}: {spec.kind} has no such option; leave it out") from None
        raise
    if guess is not None:
        p = {info.name: info.guess for info in model.parameters}
        wheelbase = p["wheelbase"] if "wheelbase" in p else p["front_length"] + p["rear_length"]
        model.parameters = with_guess(model.parameters, steer, guess, wheelbase)
    return model


def _wheelbase(guess: SteeringGuess, steer: str) -> float:
    """The wheelbase that fits a measured angle of the wheels, or one that is usual for such bends [m]."""
    return 1.0 / guess.gain if steer == "road_wheel_angle" else guess.wheelbase

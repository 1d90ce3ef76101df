"""Registry of the models: a new model is one class in a file of its own and one line here."""

from collections.abc import Iterator, Mapping
from importlib import import_module

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import Key, Source, validate
from mirdrake.identification.data import DataSet
from mirdrake.identification.models.base import Model, ModelOptions, ModelSpec
from mirdrake.identification.models.direct import JointLoopModel, KinematicModel, SteeringModel
from mirdrake.identification.models.first_guess import SteeringGuess, guess_steering, with_guess
from mirdrake.identification.models.longitudinal import LongitudinalModel
from mirdrake.identification.models.single_track import SingleTrackModel, SingleTrackRollModel
from mirdrake.identification.models.steer import STEERING

MODELS: dict[str, type[Model] | str] = {
    "kinematic": KinematicModel,
    "single_track": SingleTrackModel,
    "single_track_roll": SingleTrackRollModel,
    "steering": SteeringModel,
    "longitudinal": LongitudinalModel,
    "joint_loop": JointLoopModel,
    "ride": "mirdrake.identification.models.ride:RideModel",
    "plant": "mirdrake.identification.models.plant:PlantModel",
}
"""Class of each kind, or ``module:class`` of one that is imported when it is used; in the order of their preference
where no study is given."""


def model_class(kind: str) -> type[Model]:
    """Return the class of a kind.

    Raises:
        ConfigError: the kind is unknown.
    """
    entry = MODELS.get(kind)
    if entry is None:
        raise ConfigError(f"unknown model '{kind}'; {did_you_mean(kind, MODELS)}", path=("model",))
    if isinstance(entry, str):
        module, _, name = entry.partition(":")
        model_class: type[Model] = getattr(import_module(module), name)
        return model_class
    return entry


def default_models(channels: set[str]) -> Iterator[str]:
    """Yield the kinds that suit these channels where no study names one, the preferred one first."""
    for kind, entry in MODELS.items():
        if not isinstance(entry, str) and entry.is_default_for(channels):
            yield kind


def check_options(spec: ModelSpec) -> ModelOptions:
    """Return the options of a model as its class declares them.

    Raises:
        ConfigError: unknown kind or option, or a value that is not allowed.
    """
    options = dict(spec.options)
    lines: dict[Key, int] = {("model", name): 1 for name in options}
    source = spec.source or Source("<options>", lines, ("model",))
    return validate(options, model_class(spec.kind).Options, source)


def make_model(spec: ModelSpec, data: DataSet, known: Mapping[str, float]) -> Model:
    """Return a model for a data set.

    Args:
        spec: kind and options.
        data: logs that the model will be fitted to.
        known: known parameter values.

    Raises:
        ConfigError: unknown kind or option, or a channel is missing.
    """
    kind, options = model_class(spec.kind), check_options(spec)
    # Only channels of all logs: one model must be able to simulate and compare every log.
    channels = set.intersection(*(set(log.channels) for log in data.logs)) if data.logs else set()
    guess: SteeringGuess | None = None
    steer = next((name for name in STEERING if name in channels), "")
    if kind.uses_steering_guess and steer:
        # A tenth of a second for 90 s at 200 Hz, and a study makes dozens of models.
        if steer not in data.kept:
            data.kept[steer] = guess_steering(data.train or data.logs, steer)
        guess = data.kept[steer]
        if guess is not None and data.wheelbase is None:
            # Known values come last and override the assumption.
            known = {"assumed_wheelbase": _assumed_wheelbase(guess, steer), **known}
    model = kind(channels, known, data.wheelbase, options)
    if guess is not None:
        p = {info.name: info.guess for info in model.parameters}
        wheelbase = p["wheelbase"] if "wheelbase" in p else p["front_length"] + p["rear_length"]
        model.parameters = with_guess(model.parameters, steer, guess, wheelbase)
    return model


def _assumed_wheelbase(guess: SteeringGuess, steer: str) -> float:
    """Return the wheelbase that fits a measured road wheel angle, or the usual one for such turns [m]."""
    return 1.0 / guess.gain if steer == "road_wheel_angle" else guess.wheelbase

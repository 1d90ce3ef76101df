"""Identification study: data, data check, stages, final fit; results written into a folder."""

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import Source, to_si, where
from mirdrake.identification.check import check_data
from mirdrake.identification.data import DataSet, load_data, make_data
from mirdrake.identification.estimators import EstimatorOptions, fit
from mirdrake.identification.estimators.structure import choose_structure
from mirdrake.identification.findings import DataReport
from mirdrake.identification.fit import Fit, Verdict
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.models.base import Model
from mirdrake.identification.models.registry import check_options, model_class
from mirdrake.identification.parameters import Parameter, Setting
from mirdrake.identification.plausibility import STANDSTILL, STEERING
from mirdrake.identification.rejection import reject_faults
from mirdrake.identification.study import ParameterSpec, StudySpec, Value, embedded_data, locate_in_study
from mirdrake.identification.validation_split import split_validation
from mirdrake.vehicles import load_vehicle

Progress = Callable[[str], None]

MIN_FIT, FAIR_FIT = 25.0, 70.0
"""Fit of the best training channel below which the estimates are not valid for the vehicle, and below which none is
called identified if the noise allows a better one [%]."""

ROOM = 15.0
"""Difference between that fit and the largest one that the noise allows, from which the model lacks an effect [%]."""


@dataclass(frozen=True)
class Identification:
    """Result of a study.

    Attributes:
        name: name of the study.
        about: its description.
        check: findings and repairs of the data check; its data set is what the model was fitted to.
        fit: final fit.
        stages: fits before it.
        vehicle: name of the vehicle; "" without one.
        given: values of the vehicle by name of the parameter.
        seconds: duration of the study [s].
    """

    name: str
    about: str
    check: DataReport
    fit: Fit
    stages: tuple[Fit, ...] = ()
    vehicle: str = ""
    given: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    def save(self, folder: Path) -> None:
        """Write fit.json, traces.parquet, profiles.parquet, data_check.csv, and a folder for each stage.

        Raises:
            RunError: the file cannot be written.
        """
        self.fit.save(folder)
        for number, stage in enumerate(self.stages, start=1):
            stage.save(folder / f"stage_{number}")
        write_file(folder / "data_check.csv", self.check.to_pandas().to_csv(index=False).encode())


def identify(spec: StudySpec, folder: Path, *, progress: Progress | None = None) -> Identification:
    """Run a study.

    Args:
        spec: the study.
        folder: folder that its files are relative to.
        progress: called with a description of each step.

    Raises:
        ConfigError: data, model or parameters have faults; one line per fault.
    """
    began = time.monotonic()
    progress = progress or _silent
    try:
        model_spec, vehicle_name = _model_spec(spec, folder)
    except ConfigError as error:
        raise locate_in_study(spec, error) from None

    # Data, and the known values of the vehicle.
    progress("reading")
    data = make_data(embedded_data(spec), folder) if isinstance(spec.data, dict) else _load(spec, folder, spec.data)
    vehicle, given = ("", {}) if vehicle_name is None else _given(spec, model_spec, vehicle_name, data)
    # The wheelbase of the vehicle's files also serves the data check of the steering.
    if data.wheelbase is None and {"front_length", "rear_length"} <= given.keys():
        data = replace(data, wheelbase=given["front_length"] + given["rear_length"])
    if not data.train:
        raise ConfigError(f"{where(spec, 'data')}: no log is for training; set 'use: train' of at least one")
    progress("checking the data")
    check = check_data(data)
    _check_alive(check.data)
    drives = check.data if spec.validation_fraction is None else split_validation(check.data, spec.validation_fraction)

    # Errors below name keys of the study; their lines are added at the end.
    try:
        model = make_model(model_spec, drives, {**given, **_fixed_numbers(spec)})
        _check_moves(drives, model)
        # After making the model, as only faults of its own channels matter.
        if not spec.force:
            reject_faults(check, {*model.inputs, *model.outputs})
        settings = make_settings(spec, model, given, vehicle)
        # Stages change the settings: their results are guesses or fixed values of the final fit.
        stages = _run_stages(spec, model_spec, model, drives, settings, progress)
        progress("fitting")
        chosen = choose_structure(drives, model_spec, settings, _options(spec))
        final = fit(
            drives, chosen.model, parameters=chosen.settings, options=_options(spec), name=spec.name,
            start=chosen.start, rivals=chosen.rivals,
        )  # fmt: skip
        # Intervals describe the noise around a model; a model that follows no channel makes them meaningless.
        final = reject_poor_fit(replace(final, notes=(*chosen.notes, *final.notes)))
    except ConfigError as error:
        raise locate_in_study(spec, error) from None
    return Identification(spec.name, spec.about, check, final, tuple(stages), vehicle, given, time.monotonic() - began)


def _silent(text: str) -> None:
    del text


def make_settings(spec: StudySpec, model: Model, given: Mapping[str, float], vehicle: str) -> dict[str, Setting]:
    """Return the settings of the parameters of a model by a study and a vehicle.

    Raises:
        ConfigError: unknown parameter, or a unit does not fit; all faults together.
    """
    known = {info.name: info for info in model.parameters}
    # All faults of the study are reported together.
    faults = [
        ConfigError(f"{model.title} has no such parameter; {did_you_mean(name, known)}", path=("parameters", name))
        for name in spec.parameters
        if name not in known
    ]
    settings: dict[str, Setting] = {}
    for name, info in known.items():
        # A value of the vehicle alone fixes nothing: it is the guess, and what the estimate is compared with.
        entry = spec.parameters.get(name)
        value = given.get(name)
        if entry is None:
            if value is not None:
                settings[name] = Setting(given=value, source=vehicle)
            continue
        try:
            settings[name] = _setting(entry, info, value, vehicle)
        except ConfigError as error:
            faults.append(error)
    if faults:
        raise ConfigError(faults=faults)
    return settings


def _setting(entry: ParameterSpec, info: Parameter, given: float | None, vehicle: str) -> Setting:
    """Return the setting of one parameter, in SI units."""

    def number(value: Value | None, *path: str) -> float | None:
        return None if value is None else to_number(value, info.unit, ("parameters", info.name, *path))

    values = {key: number(getattr(entry, key), key) for key in ("fixed", "sigma", "guess", "low", "high", "given")}
    prior = None
    if entry.prior is not None:
        mean, sigma = number(entry.prior.mean, "prior", "mean"), number(entry.prior.sigma, "prior", "sigma")
        assert mean is not None
        assert sigma is not None
        prior = (mean, sigma)
    own = values.pop("given")
    # A value given in the study has precedence over that of the vehicle's files, and then also its source.
    source = entry.source or (vehicle if own is None and given is not None else "")
    return Setting(**values, prior=prior, free=entry.free, given=given if own is None else own, source=source)


def to_number(value: Value, unit: str, path: tuple[str, ...]) -> float:
    """Return a number that may carry the unit of its parameter.

    Args:
        value: number or text.
        unit: unit of the parameter.
        path: keys of the value in the study.

    Raises:
        ConfigError: the value is not a number, or has another unit.
    """
    if not isinstance(value, str):
        return float(value)
    # Units of parameters such as N/rad are not all known to the converter, so an equal unit is accepted as text.
    bare, _, given = value.strip().partition(" ")
    try:
        if given.strip() in {unit, ""}:
            return float(bare)
        number = to_si(value, unit)
    except KeyError:  # no other unit is known for this quantity
        raise ConfigError(f"'{value}': {unit} is expected", path=path) from None
    except ValueError as error:
        raise ConfigError(f"'{value}': {error if given else f'{unit} is expected'}", path=path) from None
    if isinstance(number, str):
        raise ConfigError(f"'{value}' is not a number in {unit}", path=path)
    return float(number)


def _fixed_numbers(spec: StudySpec) -> dict[str, float]:
    """Return the plain numbers that the study fixes, which a model may need before its parameters are known."""
    values: dict[str, float] = {}
    for name, entry in spec.parameters.items():
        value = entry.fixed if entry.fixed is not None else entry.given
        if isinstance(value, str):
            value = value.strip().partition(" ")[0]
        try:
            values |= {} if value is None else {name: float(value)}
        except ValueError:
            continue  # reported by make_settings, where the unit is known
    return values


def _load(spec: StudySpec, folder: Path, file: str) -> DataSet:
    path = folder / file
    if not path.is_file():
        raise ConfigError(f"{where(spec, 'data')}: no data file '{file}' beside the study")
    return load_data(path)


def _model_spec(spec: StudySpec, folder: Path) -> tuple[ModelSpec, str | None]:
    """Return kind and options of the model, checked, and the name or folder of the vehicle."""
    vehicle = spec.vehicle
    # A folder beside the study comes before a vehicle of that name in the library.
    if vehicle is not None and (folder / vehicle).is_dir():
        vehicle = str(folder / vehicle)
    kind, options = str(spec.model["kind"]), {key: value for key, value in spec.model.items() if key != "kind"}
    if vehicle is not None and "vehicle" in model_class(kind).Options.model_fields:
        options = {"vehicle": vehicle, **options}
    source = spec._source or Source("study", {})
    model = ModelSpec(kind, options, source._replace(prefix=(*source.prefix, "model")))
    check_options(model)
    return model, vehicle


def _given(spec: StudySpec, model: ModelSpec, name: str, data: DataSet) -> tuple[str, dict[str, float]]:
    """Return the name of a vehicle and the values of its files by name of the parameter."""
    vehicle = load_vehicle(name, where=where(spec, "vehicle"))
    # With measured wheel angles, the lag of the actuator is not between the channel and the wheels.
    measured = all("road_wheel_angle" in log.channels for log in data.logs)
    values = model_class(model.kind).vehicle_values(vehicle, check_options(model), measured=measured)
    return vehicle.name, values


def _check_alive(data: DataSet) -> None:
    """Reject a log in which nothing changes.

    Raises:
        ConfigError: all channels of a log are constant.
    """
    for log in data.logs:
        if all(np.nanmax(values) == np.nanmin(values) for values in log.channels.values()):
            raise ConfigError(f"{log.name}: every channel is constant; there is nothing to identify")


def _check_moves(data: DataSet, model: Model) -> None:
    """Reject training logs in which the speed is zero or the steering does not move, if they are inputs of the model.

    Raises:
        ConfigError: one line for each such channel.
    """
    lines = []
    for name in model.inputs:
        values = np.concatenate([log.channels[name] for log in data.train if name in log.channels] or [np.zeros(0)])
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        if name in {"vx", "speed"} and np.max(np.abs(values)) < STANDSTILL:
            lines.append(f"{name}: the vehicle is at rest in all training logs; there is nothing to identify")
        if name in STEERING and not np.any(values):
            lines.append(f"{name}: does not move in any training log; map the column that does, or drive turns")
    if lines:
        raise ConfigError("\n".join(lines))


def reject_poor_fit(found: Fit) -> Fit:
    """Return the fit, with weaker verdicts if the model fits no channel of the training logs well.

    One channel with a good fit shows that the model describes the vehicle; poor fits may be due to the sensors.
    """
    trained = [channel for channel in found.channels if channel.part == "train"]
    best = max(trained, key=lambda channel: channel.nrmse_percent, default=None)
    if best is None or best.nrmse_percent >= FAIR_FIT:
        return found
    fit, limit = max(best.nrmse_percent, 0.0), best.noise_limit_percent
    if fit < MIN_FIT:
        text = f"the model fits no channel by more than {fit:.0f} %: its values are not valid for the vehicle"
        return _weakened(
            found, {"identified", "weakly identified", "contradicts the given value"}, "not identifiable", text
        )
    # The noise limits what any model can reach.
    if limit - fit > ROOM:
        text = f"the model fits no channel by more than {fit:.0f} %, the noise allows {limit:.0f} %: it lacks an effect"
        return _weakened(found, {"identified", "contradicts the given value"}, "weakly identified", text)
    return found


def _weakened(found: Fit, verdicts: Collection[Verdict], verdict: Verdict, text: str) -> Fit:
    """Return the fit with a note, and with another verdict in place of some."""
    parameters = tuple(
        replace(parameter, verdict=verdict, explanation=f"{text}; {parameter.explanation}")
        if parameter.verdict in verdicts
        else parameter
        for parameter in found.parameters
    )
    return replace(found, parameters=parameters, notes=(text, *found.notes))


def _options(spec: StudySpec) -> EstimatorOptions:
    return EstimatorOptions(**spec.estimator.model_dump())


def _run_stages(
    spec: StudySpec, kind: ModelSpec, model: Model, data: DataSet, settings: dict[str, Setting], progress: Progress
) -> list[Fit]:
    """Return the fits before the final one; their results become guesses, or fixed values, in `settings`."""
    known = {info.name: info for info in model.parameters}
    names = [log.name for log in data.logs]
    fits: list[Fit] = []
    for index, stage in enumerate(spec.stages):
        for name in stage.free:
            if name not in known:
                hint = did_you_mean(name, known)
                raise ConfigError(f"unknown parameter '{name}'; {hint}", path=("stages", index, "free"))
        chosen = names if stage.logs is None else []
        for name in stage.logs or ():
            # The data check may have cut a log at gaps into parts with numbered names.
            parts = [part for part in names if part == name or part.startswith(f"{name}, part ")]
            if not parts:
                raise ConfigError(f"no log '{name}'; {did_you_mean(name, names)}", path=("stages", index, "logs"))
            chosen = [*chosen, *parts]
        progress(f"stage {stage.name}")
        # A stage estimates only its parameters; the others keep their values so far.
        part = replace(data, logs=tuple(log for log in data.logs if log.name in chosen))
        if not part.train:
            raise ConfigError("none of these logs is for training", path=("stages", index, "logs"))
        # Uncertainty is only reported for the final fit.
        options = replace(_options(spec), bootstrap=0, profile=False)
        own = {name: _in_stage(settings.get(name, Setting()), known[name], free=name in stage.free) for name in known}
        result = fit(part, kind, parameters=own, options=options, name=f"{spec.name}, stage {stage.name}")
        fits.append(result)
        for name in stage.free:
            settings[name] = _after_stage(
                settings.get(name, Setting()), result[name].value, stage.name, keep=stage.keep
            )
    return fits


def _in_stage(setting: Setting, info: Parameter, *, free: bool) -> Setting:
    """Return the setting within a stage: free, or fixed to its value so far."""
    if free:
        return replace(setting, free=True, fixed=None)
    if setting.fixed is not None:
        return setting
    value = setting.guess if setting.guess is not None else setting.given
    if value is None:
        value = setting.prior[0] if setting.prior is not None else info.guess
    return Setting(fixed=value, given=setting.given, source=setting.source or "its value before this stage")


def _after_stage(setting: Setting, value: float, stage: str, *, keep: bool) -> Setting:
    """Return the setting after a stage: fixed to the estimate, or starting from it."""
    if keep:
        return Setting(fixed=value, given=setting.given, source=f"stage {stage}")
    return replace(setting, guess=value, free=True)

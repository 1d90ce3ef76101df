"""A study from its file to its result: data, check, stages, the last fit; written into a folder."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import to_si, where
from mirdrake.identification.check import check_data
from mirdrake.identification.data import DataSet, load_data, make_data
from mirdrake.identification.estimators import EstimatorOptions, fit
from mirdrake.identification.estimators.structure import choose_structure
from mirdrake.identification.findings import DataReport
from mirdrake.identification.fit import Fit
from mirdrake.identification.models import ModelSpec, make_model
from mirdrake.identification.models.base import Model
from mirdrake.identification.models.vehicle_values import vehicle_values
from mirdrake.identification.parameters import Parameter, Setting
from mirdrake.identification.plausibility import STANDSTILL, STEERING
from mirdrake.identification.rejection import reject_faults
from mirdrake.identification.study import ParameterSpec, StudySpec, Value, embedded_data, locate_in_study
from mirdrake.identification.validation_split import split_validation
from mirdrake.runs.logs import write_file
from mirdrake.vehicles import load_vehicle

Tell = Callable[[str], None]

FOLLOWS = 25.0
"""Fit of the best channel of the training drives from which on a model has to do with them [%]."""


@dataclass(frozen=True)
class Identification:
    """What a study gave.

    Attributes:
        name: of the study.
        about: what it is, for people.
        check: what was found in the data, and done about it; its data set is what the model was fitted to.
        fit: the last fit.
        stages: the fits before it.
        vehicle: name of the vehicle; "" when none was given.
        given: values of the vehicle by name of the parameter.
        seconds: that all of it took [s].
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
            RunError: it cannot be written.
        """
        self.fit.save(folder)
        for number, stage in enumerate(self.stages, start=1):
            stage.save(folder / f"stage_{number}")
        write_file(folder / "data_check.csv", self.check.to_pandas().to_csv(index=False).encode())


def identify(spec: StudySpec, folder: Path, *, tell: Tell | None = None) -> Identification:
    """Do a study.

    Args:
        spec: the study.
        folder: that its files are relative to.
        tell: is told what is done.

    Raises:
        ConfigError: data, model or parameters have faults; one line per fault.
    """
    began = time.monotonic()
    tell = tell or _silent
    tell("reading")
    data = make_data(embedded_data(spec), folder) if isinstance(spec.data, dict) else _load(spec, folder, spec.data)
    vehicle, given = ("", {}) if spec.vehicle is None else _given(spec, folder, spec.vehicle, data)
    if data.wheelbase is None and given:
        data = replace(data, wheelbase=given["front_length"] + given["rear_length"])
    if not data.train:
        raise ConfigError(f"{where(spec, 'data')}: no drive is for training; set 'use: train' of at least one")
    tell("checking the data")
    check = check_data(data)
    _check_alive(check.data)
    drives = check.data if spec.validation_fraction is None else split_validation(check.data, spec.validation_fraction)
    kind, options = str(spec.model["kind"]), {key: value for key, value in spec.model.items() if key != "kind"}
    if kind == "plant" and spec.vehicle is not None:
        options = {"vehicle": _vehicle_of(folder, spec.vehicle), **options}
    model_spec, asked = ModelSpec(kind, options), {**given, **_fixed_numbers(spec)}
    try:
        model = make_model(model_spec, drives, asked)
        _check_moves(drives, model)
        if not spec.force:
            reject_faults(check, {*model.inputs, *model.outputs})
        settings = make_settings(spec, model, given, vehicle)
        stages = _run_stages(spec, model_spec, model, drives, settings, tell)
        tell("fitting")
        chosen = choose_structure(drives, model_spec, settings, _options(spec))
        final = fit(
            drives, chosen.model, parameters=chosen.settings, options=_options(spec), name=spec.name,
            start=chosen.start,
        )  # fmt: skip
        final = reject_poor_fit(replace(final, notes=(*chosen.notes, *final.notes)))
    except ConfigError as error:
        raise locate_in_study(spec, error) from None
    return Identification(spec.name, spec.about, check, final, tuple(stages), vehicle, given, time.monotonic() - began)


def _silent(text: str) -> None:
    del text


def make_settings(spec: StudySpec, model: Model, given: Mapping[str, float], vehicle: str) -> dict[str, Setting]:
    """What a study and a vehicle say of the parameters of a model.

    Raises:
        ConfigError: there is no such parameter, a unit does not fit, or bounds contradict; one line per fault.
    """
    known = {info.name: info for info in model.parameters}
    faults = [
        f"{where(spec, 'parameters', name)}: {model.title} has no such parameter; {did_you_mean(name, known)}"
        for name in spec.parameters
        if name not in known
    ]
    settings: dict[str, Setting] = {}
    for name, info in known.items():
        entry = spec.parameters.get(name)
        value = given.get(name)
        if entry is None:
            if value is not None:
                settings[name] = Setting(given=value, source=vehicle)
            continue
        try:
            settings[name] = _choice(spec, entry, info, value, vehicle)
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("\n".join(faults))
    return settings


def _choice(spec: StudySpec, entry: ParameterSpec, info: Parameter, given: float | None, vehicle: str) -> Setting:
    def number(value: Value | None, *path: str) -> float | None:
        place = where(spec, "parameters", info.name, *path)
        return None if value is None else to_number(value, info.unit, place)

    values = {key: number(getattr(entry, key), key) for key in ("fixed", "sigma", "guess", "low", "high", "given")}
    prior = None
    if entry.prior is not None:
        mean, sigma = number(entry.prior.mean, "prior", "mean"), number(entry.prior.sigma, "prior", "sigma")
        assert mean is not None
        assert sigma is not None
        prior = (mean, sigma)
    low, high, guess = values["low"], values["high"], values["guess"]
    place = where(spec, "parameters", info.name)
    if low is not None and high is not None and low >= high:
        raise ConfigError(f"{place}: bounds conflict: low {low:g} is not below high {high:g} {info.unit}")
    if guess is not None and not (-np.inf if low is None else low) <= guess <= (np.inf if high is None else high):
        raise ConfigError(f"{place}: the guess {guess:g} {info.unit} lies outside of its bounds")
    own = values.pop("given")
    source = entry.source or (vehicle if own is None and given is not None else "")
    return Setting(**values, prior=prior, free=entry.free, given=given if own is None else own, source=source)


def to_number(value: Value, unit: str, place: str) -> float:
    """A number that may carry the unit of its parameter.

    Raises:
        ConfigError: it is none, or has another unit.
    """
    if not isinstance(value, str):
        return float(value)
    bare, _, said = value.strip().partition(" ")
    try:
        if said.strip() in {unit, ""}:
            return float(bare)
        number = to_si(value, unit)
        if isinstance(number, str):
            raise ConfigError(f"{place}: '{value}' is not a number in {unit}")
        return float(number)
    except (KeyError, ValueError) as error:
        text = str(error) if isinstance(error, ValueError) and "allowed" in str(error) else f"{unit} is expected"
        raise ConfigError(f"{place}: '{value}': {text}") from None


def _fixed_numbers(spec: StudySpec) -> dict[str, float]:
    """Values of the study that a model may want before its parameters are known: plain numbers that are fixed."""
    found: dict[str, float] = {}
    for name, entry in spec.parameters.items():
        value = entry.fixed if entry.fixed is not None else entry.given
        if isinstance(value, str):
            value = value.strip().partition(" ")[0]
        try:
            found |= {} if value is None else {name: float(value)}
        except ValueError:
            continue  # told with its place when the parameter is known
    return found


def _load(spec: StudySpec, folder: Path, file: str) -> DataSet:
    path = folder / file
    if not path.is_file():
        raise ConfigError(f"{where(spec, 'data')}: no data file '{file}' beside the study")
    return load_data(path)


def _given(spec: StudySpec, folder: Path, name: str, data: DataSet) -> tuple[str, dict[str, float]]:
    """Name of a vehicle, and values of its files by name of the parameter."""
    vehicle = load_vehicle(_vehicle_of(folder, name), where=where(spec, "vehicle"))
    measured = all("road_wheel_angle" in log.channels for log in data.logs)
    relaxation = spec.model.get("relaxation") is not False
    return vehicle.name, vehicle_values(vehicle, str(spec.model["kind"]), relaxation=relaxation, measured=measured)


def _vehicle_of(folder: Path, name: str) -> str:
    """A folder beside the study, or a name."""
    return str(folder / name) if (folder / name).is_dir() else name


def _check_alive(data: DataSet) -> None:
    """Refuse a drive in which nothing moves.

    Raises:
        ConfigError: all channels of a log are constant.
    """
    for log in data.logs:
        if all(np.nanmax(values) == np.nanmin(values) for values in log.channels.values()):
            raise ConfigError(f"{log.name}: every channel is constant; there is nothing to identify")


def _check_moves(data: DataSet, model: Model) -> None:
    """Refuse training drives in which the speed is zero or the steering does not move, if the model has them.

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
            lines.append(f"{name}: the vehicle stands in all training drives; there is nothing to identify")
        if name in STEERING and np.ptp(values) == 0.0:
            lines.append(f"{name}: does not move in any training drive; map the column that does, or drive bends")
    if lines:
        raise ConfigError("\n".join(lines))


def reject_poor_fit(found: Fit) -> Fit:
    """A fit of a model that does not follow what it was fitted to: then no parameter of it is identified."""
    best = max((one.nrmse_percent for one in found.channels if one.part == "train"), default=100.0)
    if best >= FOLLOWS:
        return found
    words = f"the model follows no channel by more than {max(best, 0.0):.0f} %: its values say nothing of the vehicle"
    parameters = tuple(
        one if one.kind == "fixed" else replace(one, verdict="not identifiable", words=words)
        for one in found.parameters
    )
    return replace(found, parameters=parameters, notes=(words, *found.notes))


def _options(spec: StudySpec) -> EstimatorOptions:
    return EstimatorOptions(**spec.estimator.model_dump())


def _run_stages(
    spec: StudySpec, kind: ModelSpec, model: Model, data: DataSet, settings: dict[str, Setting], tell: Tell
) -> list[Fit]:
    """The fits before the last one; their results become guesses, or fixed values, in `settings`."""
    known = {info.name: info for info in model.parameters}
    names = [log.name for log in data.logs]
    found: list[Fit] = []
    for index, stage in enumerate(spec.stages):
        for name in stage.free:
            if name not in known:
                place = where(spec, "stages", index, "free")
                raise ConfigError(f"{place}: unknown parameter '{name}'; {did_you_mean(name, known)}")
        chosen = names if stage.logs is None else []
        for name in stage.logs or ():
            parts = [one for one in names if one == name or one.startswith(f"{name}, part ")]
            if not parts:
                raise ConfigError(
                    f"{where(spec, 'stages', index, 'logs')}: no log '{name}'; {did_you_mean(name, names)}"
                )
            chosen = [*chosen, *parts]
        tell(f"stage {stage.name}")
        part = replace(data, logs=tuple(log for log in data.logs if log.name in chosen))
        if not part.train:
            raise ConfigError(f"{where(spec, 'stages', index, 'logs')}: none of these logs is for training")
        options = replace(_options(spec), bootstrap=0, profile=False)
        own = {name: _in_stage(settings.get(name, Setting()), known[name], free=name in stage.free) for name in known}
        result = fit(part, kind, parameters=own, options=options, name=f"{spec.name}, stage {stage.name}")
        found.append(result)
        for name in stage.free:
            settings[name] = _after_stage(
                settings.get(name, Setting()), result[name].value, stage.name, keep=stage.keep
            )
    return found


def _in_stage(choice: Setting, info: Parameter, *, free: bool) -> Setting:
    if free:
        return replace(choice, free=True, fixed=None)
    if choice.fixed is not None:
        return choice
    value = choice.guess if choice.guess is not None else choice.given
    if value is None:
        value = choice.prior[0] if choice.prior is not None else info.guess
    return Setting(fixed=value, given=choice.given, source=choice.source or "as it was before this stage")


def _after_stage(choice: Setting, value: float, stage: str, *, keep: bool) -> Setting:
    if keep:
        return Setting(fixed=value, given=choice.given, source=f"stage {stage}")
    changes: dict[str, Any] = {"guess": value, "free": True}
    return replace(choice, **changes)

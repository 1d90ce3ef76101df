"""Format ``mirdrake: identification/1``: which model is fitted to which logs, and what is known of its parameters.

::

    mirdrake: identification/1
    data: drives.yaml                       # format data/1, or the same as an embedded mapping
    vehicle: bolt                           # optional: initial values, and references for the results
    model: {kind: single_track, tyres: linear}
    parameters:
      mass: {fixed: 1616 kg, source: scales}
      yaw_inertia: {prior: {mean: 2500, sigma: 500}}
      cornering_stiffness_front: {low: 3e4, high: 3e5}
    estimator: {loss: huber, profile: true, bootstrap: 0}
    stages:                                 # optional; the final fit, with everything free, follows by itself
      - {name: steering, logs: [slalom.csv], free: [steering_ratio, steering_offset], keep: true}

Numbers of parameters may carry the unit of the parameter.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Duration, Schema, Source, load_yaml, read_tree, validate
from mirdrake.identification.spec import DataSpec

Value = float | str


class PriorSpec(Schema):
    """Prior knowledge of a parameter, as a normal distribution."""

    mean: Value = Field(description="mean [of the parameter]")
    sigma: Value = Field(description="standard deviation [of the parameter]")


class ParameterSpec(Schema):
    """Setting of a parameter."""

    fixed: Value | None = Field(default=None, description="value that is not estimated [of the parameter]")
    sigma: Value | None = Field(default=None, description="standard deviation of the fixed value [of the parameter]")
    guess: Value | None = Field(default=None, description="initial value of the fit [of the parameter]")
    low: Value | None = Field(default=None, description="lower bound [of the parameter]")
    high: Value | None = Field(default=None, description="upper bound [of the parameter]")
    prior: PriorSpec | None = Field(default=None, description="prior knowledge [-]")
    free: bool | None = Field(default=None, description="whether it is estimated; the model's choice if left out [-]")
    given: Value | None = Field(default=None, description="value of the data sheet, to compare with [of the parameter]")
    source: str = Field(default="", description="source of the values [-]")


class EstimatorSpec(Schema):
    """Options of the estimator."""

    loss: Literal["huber", "linear", "soft_l1"] = Field(
        default="huber", description="loss function of the residuals [-]"
    )
    shooting: Duration | None = Field(
        default=None,
        gt=0.0,
        description="length of pieces with own initial states; whole logs if left out [s]",
    )
    continuity: float | None = Field(
        default=None,
        gt=0.0,
        description="standard deviation of gaps between pieces over the scale of the states; free if left out [1]",
    )
    offsets: bool = Field(default=True, description="whether sensor offsets are estimated [-]")
    bootstrap: int = Field(default=0, ge=0, le=10_000, description="draws of a block bootstrap [-]")
    profile: bool = Field(default=False, description="whether profile likelihoods are computed [-]")
    iterations: int = Field(default=60, ge=1, le=10_000, description="most evaluations of one optimisation [-]")
    seed: int = Field(default=0, ge=0, description="seed of the bootstrap [-]")


class StageSpec(Schema):
    """Fit of some parameters to some of the logs, before the final fit."""

    name: str = Field(min_length=1, description="name in reports [-]")
    logs: list[str] | None = Field(default=None, min_length=1, description="names of the logs; all if left out [-]")
    free: list[str] = Field(min_length=1, description="parameters that are estimated; others keep their value [-]")
    keep: bool = Field(default=False, description="whether the estimates are fixed from then on [-]")


class StudySpec(Schema):
    """An identification study."""

    mirdrake: Literal["identification/1"] = Field(description="format and version [-]")
    name: str = Field(default="", description="name in reports; that of the file if left out [-]")
    about: str = Field(default="", description="description for people [-]")
    data: str | Json = Field(description="data file, relative to this file, or its content [-]")
    vehicle: str | None = Field(default=None, description="name or path of the vehicle, for given values [-]")
    model: Json = Field(
        default={}, validate_default=True, description="kind of the model and its options, or only its kind [-]"
    )
    parameters: dict[str, ParameterSpec] = Field(default={}, description="settings by name of the parameter [-]")
    estimator: EstimatorSpec = Field(default=EstimatorSpec(), description="options of the estimator [-]")
    stages: list[StageSpec] = Field(default=[], description="fits before the final one, in order [-]")
    validation_fraction: float | None = Field(
        default=None, gt=0.0, lt=0.9, description="share of the training time used for validation instead [1]"
    )
    force: bool = Field(default=False, description="whether data with a wrong unit or sign are fitted anyway [-]")

    @field_validator("model", mode="before")
    @classmethod
    def _short(cls, model: Any) -> Any:
        return {"kind": model} if isinstance(model, str) else model

    @field_validator("model")
    @classmethod
    def _has_kind(cls, model: Json) -> Json:
        if not isinstance(model.get("kind"), str):
            from mirdrake.identification.models.registry import MODELS

            raise ValueError(f"a model needs a kind: {', '.join(MODELS)}; for example {{kind: single_track}}")
        return model


def load_identification(path: Path | str, *, overrides: Iterable[str] = ()) -> StudySpec:
    """Load an identification study.

    Args:
        path: YAML file of format ``mirdrake: identification/1``.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: the file cannot be read, or has faults; one line per fault.
    """
    path, overrides = Path(path), list(overrides)
    if any(text.strip().startswith("model.") for text in overrides):
        tree, _ = read_tree(path)
        if isinstance(tree, dict) and isinstance(tree.get("model"), str):
            overrides.insert(0, f"model={{kind: {tree['model']}}}")  # the short form has no keys to override
    spec = load_yaml(path, StudySpec, overrides=overrides)
    if not spec.name:
        spec.name = path.stem
    if isinstance(spec.data, dict):
        embedded_data(spec)  # its faults are those of the study
    return spec


def embedded_data(spec: StudySpec) -> DataSpec:
    """Return the data set embedded in the study.

    Raises:
        ConfigError: the data set has faults; one line per fault.
    """
    assert isinstance(spec.data, dict)
    source = spec._source or Source("study", {})
    content: Mapping[str, Any] = {"mirdrake": "data/1", **spec.data}
    return validate(dict(content), DataSpec, source._replace(prefix=(*source.prefix, "data")))


def locate_in_study(spec: StudySpec, error: ConfigError) -> ConfigError:
    """Return an error with file and line of the study before every fault that names a key of it."""
    source = spec._source or Source("study", {})
    return ConfigError(
        faults=[
            source.error(fault.text, *fault.path, code=fault.code) if fault.path else fault for fault in error.faults
        ]
    )

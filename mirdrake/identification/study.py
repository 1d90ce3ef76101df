"""Format ``mirdrake: identification/1``: which model is fitted to which drives, and what is known of its parameters.

::

    mirdrake: identification/1
    data: drives.yaml                       # format data/1, or the same as a mapping, right here
    vehicle: bolt                           # optional: its values are starts, and what results are compared with
    model: {kind: single_track, tyres: linear}
    parameters:
      mass: {fixed: 1616 kg, source: scales}
      yaw_inertia: {prior: {mean: 2500, sigma: 500}}
      cornering_stiffness_front: {low: 3e4, high: 3e5}
    estimator: {loss: huber, profile: true, bootstrap: 0}
    stages:                                 # optional; the last fit, with everything free, comes by itself
      - {name: steering, logs: [slalom.csv], free: [steering_ratio, steering_offset], keep: true}

Numbers of parameters may carry the unit of the parameter.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Duration, Schema, Source, load_yaml, read_tree, validate, where
from mirdrake.identification.spec import DataSpec

Value = float | str


class PriorSpec(Schema):
    """What is known of a parameter before the fit, as a normal distribution."""

    mean: Value = Field(description="mean [of the parameter]")
    sigma: Value = Field(description="standard deviation [of the parameter]")


class ParameterSpec(Schema):
    """What a study says of a parameter."""

    fixed: Value | None = Field(default=None, description="value that is not estimated [of the parameter]")
    sigma: Value | None = Field(default=None, description="standard deviation of the fixed value [of the parameter]")
    guess: Value | None = Field(default=None, description="where the fit starts [of the parameter]")
    low: Value | None = Field(default=None, description="lower bound [of the parameter]")
    high: Value | None = Field(default=None, description="upper bound [of the parameter]")
    prior: PriorSpec | None = Field(default=None, description="what is known before the fit [-]")
    free: bool | None = Field(default=None, description="whether it is estimated; the model's choice if left out [-]")
    given: Value | None = Field(default=None, description="data sheet's value, to compare with [of the parameter]")
    source: str = Field(default="", description="where the values are from [-]")

    @model_validator(mode="after")
    def _one_way(self) -> "ParameterSpec":
        if self.fixed is not None:
            others = [name for name in ("guess", "low", "high", "prior", "free") if getattr(self, name) is not None]
            if others:
                raise ValueError(f"is fixed, and has {', '.join(others)} as well; leave out one or the other")
        return self


class EstimatorSpec(Schema):
    """How parameters are estimated."""

    loss: Literal["huber", "linear", "soft_l1"] = Field(default="huber", description="weight of large residuals [-]")
    shooting: Duration | None = Field(
        default=None, gt=0.0, description="length of pieces with first states of their own [s]; none: whole logs"
    )
    continuity: float | None = Field(
        default=None, gt=0.0, description="gap between pieces over the usual size of the states [1]; none: free"
    )
    offsets: bool = Field(default=True, description="whether offsets of the sensors are estimated [-]")
    bootstrap: int = Field(default=0, ge=0, le=10_000, description="draws of a block bootstrap [-]")
    profile: bool = Field(default=False, description="whether profile likelihoods are worked out [-]")
    iterations: int = Field(default=60, ge=1, le=10_000, description="most evaluations of one least squares [-]")
    seed: int = Field(default=0, ge=0, description="of the bootstrap [-]")


class StageSpec(Schema):
    """A fit of some parameters to some of the drives, before the last one."""

    name: str = Field(min_length=1, description="in reports [-]")
    logs: list[str] | None = Field(default=None, min_length=1, description="names of the drives; all if left out [-]")
    free: list[str] = Field(min_length=1, description="parameters that are estimated; others keep their value [-]")
    keep: bool = Field(default=False, description="whether they are fixed to it from then on [-]")


class StudySpec(Schema):
    """An identification study."""

    mirdrake: Literal["identification/1"] = Field(description="format and version [-]")
    name: str = Field(default="", description="in reports; the file's own if left out [-]")
    about: str = Field(default="", description="what this is, for people [-]")
    data: str | dict[str, Any] = Field(description="data file, relative to this one, or its content [-]")
    vehicle: str | None = Field(default=None, description="name or path of the vehicle, for given values [-]")
    model: dict[str, Any] = Field(description="kind of the model and its options, or its kind alone [-]")
    parameters: dict[str, ParameterSpec] = Field(default={}, description="what is known of them, by name [-]")
    estimator: EstimatorSpec = Field(default=EstimatorSpec(), description="how they are estimated [-]")
    stages: list[StageSpec] = Field(default=[], description="fits before the last one, in order [-]")
    validation_fraction: float | None = Field(
        default=None, gt=0.0, lt=0.9, description="part of the training drives that is held out [1]"
    )
    force: bool = Field(default=False, description="whether data with a wrong unit or sign are fitted all the same [-]")

    @field_validator("model", mode="before")
    @classmethod
    def _short(cls, model: Any) -> Any:
        return {"kind": model} if isinstance(model, str) else model

    @field_validator("model")
    @classmethod
    def _has_kind(cls, model: dict[str, Any]) -> dict[str, Any]:
        if not isinstance(model.get("kind"), str):
            raise ValueError("needs a kind, for example {kind: single_track}")
        return model


def load_identification(path: Path | str, *, overrides: Iterable[str] = ()) -> StudySpec:
    """An identification study.

    Args:
        path: YAML file of format ``mirdrake: identification/1``.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: it cannot be read, or has faults; one line per fault.
    """
    path, overrides = Path(path), list(overrides)
    if any(text.strip().startswith("model.") for text in overrides):
        tree, _ = read_tree(path)
        if isinstance(tree, dict) and isinstance(tree.get("model"), str):
            overrides.insert(0, f"model={{kind: {tree['model']}}}")  # the short form has no keys to be set
    spec = load_yaml(path, StudySpec, overrides=overrides)
    if not spec.name:
        spec.name = path.stem
    return spec


def embedded_data(spec: StudySpec) -> DataSpec:
    """The data set that stands in the study itself.

    Raises:
        ConfigError: it has faults; one line per fault.
    """
    assert isinstance(spec.data, dict)
    source = spec._source or Source("study", {})
    content: Mapping[str, Any] = {"mirdrake": "data/1", **spec.data}
    return validate(dict(content), DataSpec, source._replace(prefix=(*source.prefix, "data")))


def locate_in_study(spec: StudySpec, error: ConfigError) -> ConfigError:
    """An error whose lines begin with a dotted path of the study, with file and line before it."""
    lines = []
    for line in str(error).splitlines():
        path = line.split(":")[0].split(" ")[0].split(".")
        known = path[0] in StudySpec.model_fields and len(path) <= 4
        rest = line[len(".".join(path)) :]
        lines.append(f"{where(spec, *path)}: {rest.lstrip(': ')}" if known and rest[:1] in {":", " "} else line)
    return ConfigError("\n".join(lines))

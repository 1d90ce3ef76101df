"""The study file: a diagram, the parameters that vary, how they are sampled, and the metrics."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import Duration, Schema, Source, any_to_si, display_path, load_yaml, validate

Value = int | float | str | bool


def _si(value: Any) -> Any:
    return any_to_si(value) if isinstance(value, str) else value


Number = Annotated[float, BeforeValidator(_si, json_schema_input_type=float | str)]
Choice = Annotated[Value, BeforeValidator(_si)]


class ParameterSpec(Schema):
    """Values of one parameter: a list of them, or a range."""

    values: list[Choice] | None = Field(None, min_length=1, description="each of these [of the parameter]")
    low: Number | None = Field(None, description="lower end of a range [of the parameter]")
    high: Number | None = Field(None, description="upper end of a range [of the parameter]")
    scale: Literal["linear", "log"] = Field("linear", description="how a range is divided [-]")
    count: int | None = Field(None, ge=2, le=100_000, description="values of a range in a grid, ends included [-]")

    @model_validator(mode="after")
    def _one_way(self) -> "ParameterSpec":
        # Two ways to state a parameter, of which exactly one is to be used: a file with both is ambiguous.
        if (self.values is None) == (self.low is None and self.high is None):
            raise ValueError("needs either values, or low and high")
        if self.values is not None:
            return self
        if self.low is None or self.high is None:
            raise ValueError(f"a range needs low and high; {'low' if self.low is None else 'high'} is missing")
        if not self.low < self.high:
            raise ValueError(f"the range from {self.low:g} to {self.high:g} is empty; low must be below high")
        if self.scale == "log" and self.low <= 0.0:
            raise ValueError(f"a range on a log scale needs low above 0, not {self.low:g}")
        return self

    def ends(self) -> list[Any]:
        """Return the values that bound all others, for checks."""
        return list(self.values) if self.values is not None else [self.low, self.high]


class ListSampling(Schema):
    """The first values of all parameters together, then the second ones, and so on."""

    kind: Literal["list"] = Field("list", description="[-]")


class GridSampling(Schema):
    """Full factorial design: all combinations of the values; the last parameter varies fastest."""

    kind: Literal["grid"] = Field("grid", description="[-]")


class DrawnSampling(Schema):
    """Drawn with the study's seed: at random, as a Latin hypercube, or as a scrambled Sobol sequence."""

    kind: Literal["random", "latin_hypercube", "sobol"] = Field(description="[-]")
    runs: int = Field(ge=1, le=10_000_000, description="number of runs [-]")


Sampling = Annotated[ListSampling | GridSampling | DrawnSampling, Field(discriminator="kind")]


class StudySpec(Schema):
    """A study file."""

    mirdrake: Literal["study/1"] = Field("study/1", description="format of this file [-]")
    name: str = Field("study", min_length=1, description="default: that of the file [-]")
    diagram: str | Json | None = Field(None, description="name of a diagram, a path, or the diagram itself [-]")
    manoeuvre: str | None = Field(None, description="name of a manoeuvre, in place of a diagram [-]")
    vehicle: str | None = Field(None, description="vehicle that drives the manoeuvre [-]")
    model: Literal["plant", "single_track"] = Field(
        "plant", description="the full plant, or the single-track model in batches of many runs [-]"
    )
    overrides: Json = Field(
        default_factory=dict, description="values of the diagram or of the manoeuvre for all runs, by dotted path [-]"
    )
    parameters: dict[str, ParameterSpec] = Field(
        min_length=1,
        description="dotted paths of the diagram, and context parameters such as ego.speed.kp; of a manoeuvre: its "
        "settings such as step_steer.speed, friction, single_track.NAME and gains.NAME [-]",
    )
    sampling: Sampling = Field(default_factory=GridSampling, description="how values are combined [-]")
    metrics: list[str] = Field(
        min_length=1,
        description="figures of a run such as ego.distance_m or of the manoeuvre, or functions as module:name [-]",
    )
    duration: Duration | None = Field(
        None, gt=0.0, le=1e6, description="simulated time [s]; default: that of the diagram"
    )
    seed: int = Field(0, ge=0, description="seed of the drawn values [-]; the runs use the seed of the diagram")
    time_limit: Duration | None = Field(
        None, gt=0.0, description="wall time of a run [s]; default: 60 s and ten times its simulated time"
    )
    folder: str | None = Field(None, description="folder of the modules of metrics; default: that of the file [-]")

    @model_validator(mode="after")
    def _one_kind(self) -> "StudySpec":
        if (self.diagram is None) == (self.manoeuvre is None):
            raise ValueError("needs either diagram, or manoeuvre and vehicle")
        if (self.manoeuvre is None) != (self.vehicle is None):
            raise ValueError("manoeuvre and vehicle belong together; give both or neither")
        if self.manoeuvre is not None and self.duration is not None:
            raise ValueError("duration: a manoeuvre ends by itself; leave it out")
        return self


def load_study(path: Path | str, *, overrides: Iterable[str] = ()) -> StudySpec:
    """Load a study file, checked as far as possible without its diagram.

    Args:
        path: the file.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: the file cannot be read, or has faults.
    """
    path = Path(path)
    spec = load_yaml(path, StudySpec, overrides=overrides)
    if "name" not in spec.model_fields_set:
        spec.name = path.stem
    if spec.folder is None:
        spec.folder = str(resolved(path).parent)
    if isinstance(spec.diagram, str) and (beside := path.parent / spec.diagram).is_file():
        spec.diagram = str(resolved(beside))
    return spec


def make_study(study: StudySpec | Mapping[str, Any] | Path | str) -> StudySpec:
    """Return a study spec from a spec, its data or its file.

    Raises:
        ConfigError: the study has faults.
    """
    if isinstance(study, StudySpec):
        return study
    if isinstance(study, Mapping):
        return validate(dict(study), StudySpec, Source("study", {}))
    if not Path(study).suffix:
        raise ConfigError("not a study file, whose name ends in .yaml", where=display_path(Path(study)))
    return load_study(study)

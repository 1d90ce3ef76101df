"""The tuning file ``mirdrake: tuning/1``: which loop, how it is tried, searched, judged, and shaken."""

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import Angle, Duration, Schema, Source, Speed, load_yaml, shown, validate
from mirdrake.plant.plant import PlantSpec
from mirdrake.studies.spec import Number

PUBLISHED = {"kp": 100.0, "ki": 0.01, "kd": 10.0}
"""Untuned gains of the vehicles of the papers, to compare with.

They stand on every joint in the control files of *Software-in-the-loop Modeling and Simulation Framework for Autonomous
Vehicles* (``bulldogbolt_control.yaml`` of the Bolt) and of the CAT Vehicle; *Avrora Unior Car-like Robot in Gazebo
Environment* calls the tuning of its joints future work and prints no values. In the Bolt's file the controllers are of
kinds that read no gains, so there they never acted: see README.md of each vehicle, Variants.

On a steered joint they are N m/rad, N m/(rad s) and N m s/rad, on a driven wheel N m s/rad, N m/rad and N m s²/rad, for
each joint by itself: the joint's torque from the error of its own angle or speed.
"""

LOOPS = ("wheel_speed", "steering", "speed", "path")

FIGURES = (
    "iae", "itae", "ise", "overshoot_percent", "rise_time", "settling_time", "steady_error", "peak_effort",
    "rms_effort", "total_variation", "saturation_time", "rms_jerk", "peak_jerk", "ms", "mt", "gain_margin",
    "phase_margin_deg", "delay_margin_s", "disk_margin",
)  # fmt: skip
"""What a trial gives, and costs and constraints are made of."""

AT_LEAST = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
"""Figures of which more is better: a constraint on them is a lower bound, on all others an upper one."""


class RangeSpec(Schema):
    """Range of a gain."""

    low: float = Field(ge=0.0, description="lower end [of the gain]")
    high: float = Field(gt=0.0, description="upper end [of the gain]")
    scale: Literal["linear", "log"] = Field("log", description="how it is divided [-]")

    @model_validator(mode="after")
    def _not_empty(self) -> "RangeSpec":
        if not self.low < self.high:
            raise ValueError(f"the range from {self.low:g} to {self.high:g} is empty; low must be below high")
        if self.scale == "log" and self.low <= 0.0:
            raise ValueError(f"a range on a log scale needs low above 0, not {self.low:g}; or write scale: linear")
        return self


class SearchSpec(Schema):
    """How gains are searched."""

    method: Literal["tpe", "cma", "nsga2", "grid", "sobol", "latin_hypercube"] = Field("tpe", description="[-]")
    trials: int = Field(100, ge=1, le=1_000_000, description="candidates on the reduced model [-]")
    confirm: int = Field(5, ge=1, le=1000, description="best of them that are tried on the plant [-]")
    ranges: dict[str, RangeSpec] = Field(
        default_factory=dict, description="of each gain; around those of the rules if left out [-]"
    )


def _part(value: Any) -> Any:
    """``20 %`` as 0.2."""
    if isinstance(value, str) and value.strip().endswith("%"):
        try:
            return float(value.strip()[:-1]) / 100.0
        except ValueError:
            return value
    return value


Part = Annotated[float, BeforeValidator(_part, json_schema_input_type=float | str)]


class RobustnessSpec(Schema):
    """What is varied in the Monte Carlo, evenly distributed."""

    runs: int = Field(100, ge=0, le=1_000_000, description="runs of each candidate; 0: none [-]")
    mass: Part = Field(0.2, ge=0.0, lt=1.0, description="part by which mass and inertia differ, to both sides [1]")
    friction: tuple[float, float] = Field((0.3, 1.0), description="of the road [1]")
    delay: tuple[Duration, Duration] = Field((0.0, 0.1), description="of the actuator [s]")
    grade: tuple[Angle, Angle] = Field(
        (-math.radians(5.0), math.radians(5.0)), description="of the road, positive uphill [rad]"
    )
    noise: Number = Field(0.0, ge=0.0, description="largest standard deviation of the measurement [of the output]")

    @model_validator(mode="after")
    def _ranges(self) -> "RobustnessSpec":
        for name in ("friction", "delay", "grade"):
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name}: the range from {low:g} to {high:g} is empty; write the lower end first")
        if self.friction[0] <= 0.0:
            raise ValueError(f"friction: {self.friction[0]:g} is not allowed; it must be above 0")
        if self.delay[0] < 0.0 or self.delay[1] > 0.5:
            raise ValueError("delay: must be from 0 to 0.5 s")
        if max(map(abs, self.grade)) > 0.5:
            raise ValueError("grade: must be from -0.5 to 0.5 rad")
        return self


class CourseSpec(Schema):
    """The trial that judges: a step of the set-point, later a load; what is left out depends on the loop."""

    speed: Speed | None = Field(None, ge=0.0, le=60.0, description="of the car before the step [m/s]")
    step: Number | None = Field(None, description="of the set-point [of the output]")
    slope: Number | None = Field(
        None,
        gt=0.0,
        le=20.0,
        description="of the speed's set-point; 0.6 if left out, which 0.3 of friction allows [m/s²]",
    )
    load: float | None = Field(None, description="added to the effort from load_time on [of the effort]")
    step_time: Duration = Field(0.5, gt=0.0, description="of the step [s]")
    load_time: Duration | None = Field(
        None, gt=0.0, description="of the load; after 60 % of the duration if left out [s]"
    )
    duration: Duration = Field(10.0, ge=1.0, le=600.0, description="of a trial [s]")
    delay: Duration = Field(0.05, ge=0.0, le=0.2, description="of the actuator, nominally [s]")
    filter: Duration | None = Field(None, ge=0.0, le=1.0, description="of the derivative; two periods if left out [s]")


class DiagramLoop(Schema):
    """A loop in a user's diagram, by the names of its signals as a run logs them, and its knobs."""

    diagram: str = Field(description="name of a diagram, or a path [-]")
    reference: str | float = Field(description="signal, or a number if it stands still [-]")
    output: str = Field(description="signal that shall follow [-]")
    effort: str = Field(description="signal that makes it follow [-]")
    knobs: list[str] = Field(min_length=1, description="gains: of a block of kind pid as block.kp, or of a vehicle [-]")


class ScheduleSpec(Schema):
    """Gains over speed."""

    speeds: list[Speed] = Field(min_length=2, description="where the loop is tuned anew, rising [m/s]")

    @model_validator(mode="after")
    def _rise(self) -> "ScheduleSpec":
        if self.speeds[0] < 0.0 or any(low >= high for low, high in pairwise(self.speeds)):
            raise ValueError(f"speeds: must rise from 0 or more, got {', '.join(f'{v:g}' for v in self.speeds)}")
        return self


def _word_or_mapping(value: Any) -> str:
    """What a value is meant as, so that a fault in it is told once."""
    return "word" if isinstance(value, str) else "mapping"


LoopChoice = Annotated[
    Annotated[Literal["wheel_speed", "steering", "speed", "path"], Tag("word")]
    | Annotated[DiagramLoop, Tag("mapping")],
    Discriminator(_word_or_mapping),
]
Baseline = Annotated[
    Annotated[Literal["published"], Tag("word")] | Annotated[dict[str, float], Tag("mapping")],
    Discriminator(_word_or_mapping),
]


class TuningSpec(Schema):
    """A tuning file."""

    mirdrake: Literal["tuning/1"] = Field("tuning/1", description="format of this file [-]")
    name: str = Field("tuning", min_length=1, description="the file's own if left out [-]")
    vehicle: str | None = Field(None, description="name of a vehicle, or a path; of a loop of its own [-]")
    world: str = Field("empty", description="flat, with the same friction everywhere [-]")
    loop: LoopChoice = Field(description="what is tuned [-]")
    plant: PlantSpec = Field(default_factory=lambda: PlantSpec(contact="point"), description="step and contact [-]")
    test: CourseSpec = Field(default_factory=CourseSpec, description="the trial that judges [-]")
    baseline: Baseline = Field("published", description="gains to compare with; published: 100, 0.01, 10 [-]")
    search: SearchSpec = Field(default_factory=SearchSpec, description="[-]")
    cost: dict[str, float] = Field(default_factory=lambda: {"iae": 1.0}, min_length=1, description="weights [-]")
    constraints: dict[str, float] = Field(
        default_factory=lambda: {"overshoot_percent": 5.0, "ms": 1.6}, description="bounds of figures [-]"
    )
    robustness: RobustnessSpec = Field(default_factory=RobustnessSpec, description="[-]")
    schedule: ScheduleSpec | None = Field(None, description="gains over speed, if wanted [-]")
    seed: int = Field(0, ge=0, description="of everything random [-]")
    folder: str | None = Field(None, description="of the file [-]")

    @model_validator(mode="after")
    def _has_a_plant(self) -> "TuningSpec":
        if isinstance(self.loop, str) and self.vehicle is None:
            raise ValueError(f"the loop '{self.loop}' needs a vehicle; write vehicle: bolt, say")
        return self


def load_tuning(path: Path | str, *, overrides: Iterable[str] = ()) -> TuningSpec:
    """A tuning file, checked as far as it can be without its vehicle.

    Args:
        path: the file.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: it cannot be read, or has faults.
    """
    path = Path(path)
    if not path.suffix and not path.exists():
        raise ConfigError(f"{shown(path)}: no such file; a tuning file ends with .yaml")
    spec = load_yaml(path, TuningSpec, overrides=overrides)
    if "name" not in spec.model_fields_set:
        spec.name = path.stem
    spec.folder = spec.folder or str(resolved(path).parent)
    return spec


def make_tuning(study: TuningSpec | Mapping[str, Any] | Path | str) -> TuningSpec:
    """A tuning spec from itself, its data or its file.

    Raises:
        ConfigError: it has faults.
    """
    if isinstance(study, TuningSpec):
        return study
    if isinstance(study, Mapping):
        return validate(dict(study), TuningSpec, Source("tuning", {}))
    return load_tuning(study)

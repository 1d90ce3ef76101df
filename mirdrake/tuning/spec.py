"""The tuning file ``mirdrake: tuning/1``: the loop, its test, the search, the criteria and the Monte Carlo."""

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import Angle, Duration, Schema, Source, Speed, display_path, load_yaml, validate
from mirdrake.plant.plant import PlantSpec
from mirdrake.studies.spec import Number
from mirdrake.tuning.search_range import Range

PUBLISHED = {"kp": 100.0, "ki": 0.01, "kd": 10.0}
"""Untuned gains of the papers' vehicles, used for comparison.

They are set on every joint in the control files of *Software-in-the-loop Modeling and Simulation Framework for
Autonomous Vehicles* (``bulldogbolt_control.yaml`` of the Bolt) and of the CAT Vehicle; *Avrora Unior Car-like Robot in
Gazebo Environment* names the tuning of its joints as future work and prints no values. The controllers in the Bolt's
file are of kinds that read no gains, so they had no effect there: see the README.md of each vehicle, Variants.

On a steered joint they are N m/rad, N m/(rad s) and N m s/rad, on a driven wheel N m s/rad, N m/rad and N m s²/rad.
Each joint has its own controller, from the error of its angle or speed to its torque.
"""

MARGINS = ("ms", "mt", "gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
"""Figures that follow from the model of a loop alone."""

FIGURES = (
    "iae", "itae", "ise", "overshoot_percent", "rise_time", "settling_time", "steady_error", "peak_effort",
    "rms_effort", "total_variation", "saturation_time", "rms_jerk", "peak_jerk", *MARGINS,
)  # fmt: skip
"""Figures of a test, of which costs and constraints are made."""

AT_LEAST = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
"""Figures of which larger is better: a constraint on them is a lower bound, on all others an upper bound."""


PRINTED = 4
"""Significant digits in which figures, costs and limits are printed and compared."""


def printed(value: float) -> float:
    """Return a number as it is printed, so that numbers that print equal are equal."""
    return float(f"{value:.{PRINTED}g}")


def breaks_limit(name: str, value: float, limit: float) -> bool:
    """Return whether a figure breaks its constraint; nan does, a value that prints as the limit does not."""
    value, limit = printed(value), printed(limit)
    return not (value >= limit if name in AT_LEAST else value <= limit)


class RangeSpec(Schema):
    """Range in which a gain is searched."""

    low: float = Field(ge=0.0, description="lower end [of the gain]")
    high: float = Field(gt=0.0, description="upper end [of the gain]")
    scale: Literal["linear", "log"] = Field("log", description="division of the range [-]")

    @model_validator(mode="after")
    def _not_empty(self) -> "RangeSpec":
        if not self.low < self.high:
            raise ValueError(f"the range from {self.low:g} to {self.high:g} is empty; low must be below high")
        if self.scale == "log" and self.low <= 0.0:
            raise ValueError(f"a range on a log scale needs low above 0, not {self.low:g}; or write scale: linear")
        return self

    def range(self) -> Range:
        """Return the range as plain data."""
        return Range(self.low, self.high, self.scale)


class SearchSpec(Schema):
    """Search of the gains."""

    method: Literal["tpe", "cma", "nsga2", "grid", "sobol", "latin_hypercube"] = Field(
        "tpe", description="sampler on the reduced model [-]"
    )
    trials: int | None = Field(
        None,
        ge=1,
        le=1_000_000,
        description="candidates tested in the first search [-]; by default 300 on the reduced model, or 100 on the "
        "plant if the loop has none",
    )
    confirm: int = Field(12, ge=1, le=1000, description="candidates tested on the plant, near the best of them [-]")
    ranges: dict[str, RangeSpec] = Field(
        default_factory=dict, description="range of each gain; by default around those of the rules [-]"
    )


def _fraction(value: Any) -> Any:
    """Convert ``20 %`` to 0.2."""
    if isinstance(value, str) and value.strip().endswith("%"):
        try:
            return float(value.strip()[:-1]) / 100.0
        except ValueError:
            return value
    return value


Fraction = Annotated[float, BeforeValidator(_fraction, json_schema_input_type=float | str)]


class RobustnessSpec(Schema):
    """Monte Carlo: parameters that vary, with uniform distributions."""

    runs: int = Field(100, ge=0, le=1_000_000, description="runs of each candidate; 0: no Monte Carlo [-]")
    mass: Fraction = Field(
        0.2, ge=0.0, lt=1.0, description="largest relative deviation of mass and inertia, up and down [1]"
    )
    friction: tuple[float, float] = Field((0.3, 1.0), description="of the road [1]")
    delay: tuple[Duration, Duration] | None = Field(
        None, description="whole delay of the actuator, in place of test.delay; by default 0 to twice that [s]"
    )
    grade: tuple[Angle, Angle] = Field(
        (-math.radians(5.0), math.radians(5.0)), description="of the road, positive uphill [rad]"
    )
    step: tuple[float, float] = Field((0.3, 1.5), description="factor on the step of the test [1]")
    noise: Number = Field(0.0, ge=0.0, description="largest standard deviation of the measurement [of the output]")

    @model_validator(mode="after")
    def _ranges(self) -> "RobustnessSpec":
        # Without a range of the delay the kind of loop decides.
        # Ranges are checked here and not by their type, since the message is to say which end is wrong.
        for name in ("friction", "delay", "grade", "step"):
            if getattr(self, name) is None:
                continue
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name}: the range from {low:g} to {high:g} is empty; write the lower end first")
        for name in ("friction", "step"):
            if getattr(self, name)[0] <= 0.0:
                raise ValueError(f"{name}: {getattr(self, name)[0]:g} is not allowed; it must be above 0")
        if self.delay is not None and (self.delay[0] < 0.0 or self.delay[1] > 0.5):
            raise ValueError("delay: must be from 0 to 0.5 s")
        if max(map(abs, self.grade)) > 0.5:
            raise ValueError("grade: must be from -0.5 to 0.5 rad")
        return self


class CourseSpec(Schema):
    """Test manoeuvre: a step of the set-point and a later load; the defaults depend on the loop."""

    speed: Speed | None = Field(None, ge=0.0, le=60.0, description="of the car before the step [m/s]")
    step: Number | None = Field(None, description="of the set-point [of the output]")
    slope: Number | None = Field(
        None,
        gt=0.0,
        le=20.0,
        description="of the speed's set-point; default 0.6, which a friction of 0.3 allows [m/s²]",
    )
    load: float | None = Field(None, description="added to the effort from load_time on [of the effort]")
    step_time: Duration = Field(0.5, gt=0.0, description="of the step [s]")
    load_time: Duration | None = Field(None, gt=0.0, description="of the load; default 60 % of the duration [s]")
    duration: Duration | None = Field(
        None, ge=1.0, le=600.0, description="of the test; default by loop: 10 s for the speed of a car [s]"
    )
    delay: Duration = Field(0.05, ge=0.0, le=0.2, description="nominal delay of the actuator [s]")
    filter: Duration | None = Field(
        None, ge=0.0, le=1.0, description="time constant of the derivative's filter; default two periods [s]"
    )


class DiagramLoop(Schema):
    """A loop in a user's diagram, by the names of its logged signals and parameters."""

    diagram: str = Field(description="name of a diagram, or a path [-]")
    reference: str | float = Field(description="signal of the set-point, or its constant value [-]")
    output: str = Field(description="controlled signal [-]")
    effort: str = Field(description="control signal [-]")
    parameters: list[str] = Field(
        min_length=1, description="gains: numbers of a block, such as block.kp, or of a vehicle [-]"
    )
    roles: dict[str, Literal["kp", "ki", "kd"]] = Field(
        default_factory=dict, description="gains of a PID controller with other names, as {block.gain: kp} [-]"
    )


class ScheduleSpec(Schema):
    """Gain schedule over speed."""

    speeds: list[Speed] = Field(min_length=2, description="speeds at which the loop is tuned, increasing [m/s]")

    @model_validator(mode="after")
    def _increase(self) -> "ScheduleSpec":
        if self.speeds[0] < 0.0 or any(low >= high for low, high in pairwise(self.speeds)):
            raise ValueError(f"speeds: must increase from 0 or more, got {', '.join(f'{v:g}' for v in self.speeds)}")
        return self


def _selectable_loops() -> list[str]:
    from mirdrake.tuning.loops.registry import LOOP_KINDS  # whose kinds read studies

    return [name for name, kind in LOOP_KINDS.items() if kind.selectable]


def _known_loop(name: str) -> str:
    names = _selectable_loops()
    if name not in names:
        raise ValueError(f"no loop '{name}'; {did_you_mean(name, names)}")
    return name


def _word_or_mapping(value: Any) -> str:
    """Discriminate a name from a mapping, so that a fault is reported once."""
    return "word" if isinstance(value, str) else "mapping"


LoopChoice = Annotated[
    Annotated[str, AfterValidator(_known_loop), Tag("word")] | Annotated[DiagramLoop, Tag("mapping")],
    Discriminator(_word_or_mapping),
]
Baseline = Annotated[
    Annotated[Literal["present", "published"], Tag("word")] | Annotated[dict[str, float], Tag("mapping")],
    Discriminator(_word_or_mapping),
]


class TuningSpec(Schema):
    """A tuning file."""

    mirdrake: Literal["tuning/1"] = Field("tuning/1", description="format of this file [-]")
    name: str = Field("tuning", min_length=1, description="of the study; default: that of the file [-]")
    vehicle: str | None = Field(None, description="name of a vehicle, or a path; not for a loop of a diagram [-]")
    world: str = Field("empty", description="flat, with the same friction everywhere [-]")
    loop: LoopChoice = Field(description="loop to tune: wheel_speed, steering, speed, path, or signals [-]")
    plant: PlantSpec = Field(default_factory=PlantSpec, description="step and contact; default by loop [-]")
    test: CourseSpec = Field(default_factory=CourseSpec, description="test manoeuvre [-]")
    baseline: Baseline = Field(
        "present", description="to compare with: present, the controller of the vehicle; published, 100, 0.01, 10 [-]"
    )
    search: SearchSpec = Field(default_factory=SearchSpec, description="[-]")
    cost: dict[str, float] = Field(
        default_factory=lambda: {"iae": 1.0}, min_length=1, description="weights of figures [-]"
    )
    constraints: dict[str, float] = Field(
        default_factory=lambda: {"overshoot_percent": 5.0, "ms": 1.6}, description="limits of figures [-]"
    )
    robustness: RobustnessSpec = Field(default_factory=RobustnessSpec, description="[-]")
    schedule: ScheduleSpec | None = Field(None, description="gain schedule over speed [-]")
    seed: int = Field(0, ge=0, description="of all random numbers [-]")
    folder: str | None = Field(None, description="of the file [-]")

    @property
    def delays(self) -> tuple[float, float]:
        """Smallest and largest delay of the actuator in the Monte Carlo [s]."""
        return self.robustness.delay or (0.0, 2.0 * self.test.delay)

    @model_validator(mode="after")
    def _has_a_plant(self) -> "TuningSpec":
        if isinstance(self.loop, str) and self.vehicle is None:
            raise ValueError(f"the loop '{self.loop}' needs a vehicle; write for example vehicle: bolt")
        return self


def load_tuning(path: Path | str, *, overrides: Iterable[str] = ()) -> TuningSpec:
    """Load a tuning file and check it as far as possible without its vehicle.

    Args:
        path: the file.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: it cannot be read, or has faults.
    """
    path = Path(path)
    if not path.suffix and not path.exists():
        raise ConfigError(f"{display_path(path)}: no such file; a tuning file ends with .yaml")
    spec = load_yaml(path, TuningSpec, overrides=overrides)
    if "name" not in spec.model_fields_set:
        spec.name = path.stem
    spec.folder = spec.folder or str(resolved(path).parent)
    return spec


def make_tuning(study: TuningSpec | Mapping[str, Any] | Path | str) -> TuningSpec:
    """Return a tuning spec, made from its data or its file if need be.

    Raises:
        ConfigError: it has faults.
    """
    if isinstance(study, TuningSpec):
        return study
    if isinstance(study, Mapping):
        return validate(dict(study), TuningSpec, Source("tuning", {}))
    return load_tuning(study)

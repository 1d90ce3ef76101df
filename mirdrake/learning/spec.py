"""The learning file: a diagram with an expert, and how a network learns to steer from it."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from mirdrake.core.json_io import Json
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import Angle, Duration, Length, Schema, load_yaml
from mirdrake.learning.preparation import CropSpec


class PictureSpec(Schema):
    """Preparation of the pictures: cropped, then resized."""

    crop: CropSpec = Field(default_factory=CropSpec, description="pixels to cut off each side [-]")
    size: tuple[int, int] | None = Field(None, description="width and height after cropping; as cropped [pixel]")


class CollectSpec(Schema):
    """Runs of the expert with injected errors."""

    runs: int = Field(4, ge=1, le=1000, description="runs in each world [-]")
    duration: Duration | None = Field(
        None, gt=0.0, le=1e5, description="simulated time of a run [s]; by default one lap"
    )
    rate: float = Field(10.0, gt=0.0, le=200.0, description="recorded pictures per second [Hz]")
    errors: Angle = Field(
        0.12,
        ge=0.0,
        le=0.5,
        description="root mean square of the error added to the steering in the last run [rad]; "
        "it increases from zero in the first run",
    )
    where: str | None = Field(
        "abs lateral_error < 1 m", description="condition on the vehicle; other pictures are not learnt [-]"
    )


class TrainSpec(Schema):
    """Training of the network."""

    epochs: int = Field(10, ge=1, le=1000, description="[-]")
    batch: int = Field(64, ge=1, le=4096, description="pictures of a step [-]")
    learning_rate: float = Field(1e-3, gt=0.0, le=1.0, description="largest learning rate of Adam [-]")
    huber: Angle = Field(0.1, gt=0.0, description="error from which the loss grows linearly [rad]")
    balance: bool = Field(False, description="weight pictures by the rarity of their labels [-]")
    mirror: bool = Field(True, description="mirror half of the pictures; their labels change signs [-]")
    brightness: float = Field(0.2, ge=0.0, lt=1.0, description="largest change of the brightness [-]")
    noise: float = Field(0.01, ge=0.0, le=1.0, description="standard deviation of noise, full scale 1 [-]")
    validation: float = Field(0.1, gt=0.0, lt=0.9, description="share of the track for validation [-]")
    gap: Length = Field(20.0, ge=0.0, description="least distance of training and validation along the track [m]")


class DriveSpec(Schema):
    """The drive of the network."""

    laps: float = Field(1.0, gt=0.0, le=1000.0, description="[-]")
    worlds: list[str | Json] = Field(
        default_factory=list, description="worlds to drive in; by default that of the diagram [-]"
    )
    intervention: Length = Field(1.0, gt=0.0, description="lateral error that counts as an intervention [m]")


class RoundSpec(Schema):
    """Rounds of DAgger: the network drives, and the expert labels what it sees."""

    count: int = Field(0, ge=0, le=100, description="rounds after the first training [-]")
    runs: int = Field(1, ge=1, le=1000, description="runs of the network in each round and world [-]")
    lateral: Length = Field(1.0, gt=0.0, description="pictures farther off than this are not learnt [m]")
    label: Angle = Field(0.2, gt=0.0, description="nor are pictures whose label differs more from the network [rad]")


class LearningSpec(Schema):
    """A learning file."""

    mirdrake: Literal["learning/1"] = Field("learning/1", description="format of this file [-]")
    name: str = Field("learning", min_length=1, description="default: that of the file [-]")
    diagram: str | Json = Field(description="name of a diagram with an expert, a path, or the diagram [-]")
    overrides: Json = Field(default_factory=dict, description="values of the diagram, nested or by dotted path [-]")
    vehicle: str = Field("ego", description="vehicle of the diagram that the network drives [-]")
    camera: str = Field("front_camera", description="its camera [-]")
    inputs: list[str] = Field(default_factory=list, description="signals that the network takes besides, as vx [-]")
    rate: float = Field(20.0, gt=0.0, le=200.0, description="pictures per second when the network drives [Hz]")
    latency: Duration = Field(0.0, ge=0.0, le=2.0, description="time from a picture to the command [s]")
    lead: Duration | None = Field(
        None,
        ge=0.0,
        le=2.0,
        description="time after the exposure at which a label is read [s]; by default the delay "
        "of the loop: latency and half a period",
    )
    worlds: list[str | Json] = Field(
        default_factory=list, description="worlds to learn in; by default that of the diagram [-]"
    )
    picture: PictureSpec = Field(default_factory=PictureSpec, description="preparation of the pictures [-]")
    collect: CollectSpec = Field(default_factory=CollectSpec, description="runs of the expert [-]")
    train: TrainSpec = Field(default_factory=TrainSpec, description="training [-]")
    drive: DriveSpec = Field(default_factory=DriveSpec, description="drive of the network [-]")
    rounds: RoundSpec = Field(default_factory=RoundSpec, description="rounds of DAgger [-]")
    seed: int = Field(0, ge=0, description="of errors, weights and the order of pictures [-]")

    @field_validator("overrides")
    @classmethod
    def _by_path(cls, value: Json) -> Json:
        return dict(_leaves(value))

    @field_validator("rounds", mode="before", json_schema_input_type=RoundSpec | int)
    @classmethod
    def _count(cls, value: Any) -> Any:
        return {"count": value} if isinstance(value, int) and not isinstance(value, bool) else value

    @property
    def delay(self) -> float:
        """Mean time from the exposure of a picture to the action of its command, in the loop of the network [s]."""
        return self.latency + 0.5 / self.rate

    @property
    def label_lead(self) -> float:
        """Time after the exposure at which labels are read [s]."""
        return self.delay if self.lead is None else self.lead


def _leaves(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings by dotted path."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def load_learning(path: Path | str, *, overrides: Iterable[str] = ()) -> LearningSpec:
    """Load a learning file.

    Args:
        path: the file.
        overrides: ``"dotted.path=value"`` texts, applied over the file.

    Raises:
        ConfigError: the file cannot be read, or has faults.
    """
    path = Path(path)
    spec = load_yaml(path, LearningSpec, overrides=overrides)
    if "name" not in spec.model_fields_set:
        spec.name = path.stem
    if isinstance(spec.diagram, str) and (beside := path.parent / spec.diagram).is_file():
        spec.diagram = str(resolved(beside))
    return spec

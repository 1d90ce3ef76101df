"""Format ``mirdrake: data/1``: which logs form a data set, and the meaning of their columns.

::

    mirdrake: data/1
    wheelbase: 2.827 m                                 # optional; with it the steering is checked too
    mass: 1616 kg                                      # optional, as front_length, front_drive, front_brake
    time: {column: t_s, unit: s}                       # or {step: 10 ms} without such a column
    channels:
      vx: {column: v_kmh, unit: km/h}
      yaw_rate: {column: "gyro z", unit: deg/s, sign: -1}
      steering_wheel_angle: Steering                   # the unit is in the header: "Steering [deg]"
    logs:
      - {file: lap_1.csv, use: train, start: 2 s, end: 40 s}
      - {file: lap_2.csv, use: validation}
      - {file: runs/slalom, use: validation, channels: {vx: ego.vx}}
"""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from mirdrake.core.errors import did_you_mean
from mirdrake.core.yaml_io import Duration, Length, Mass, Schema
from mirdrake.identification.channels import channel
from mirdrake.readers import CsvLayout
from mirdrake.readers.units import plain_unit, unit_factor

Repair = Literal["timestamps", "gaps", "held_values", "glitches", "sample_time", "delays"]
REPAIRS: tuple[Repair, ...] = ("timestamps", "gaps", "held_values", "glitches", "sample_time", "delays")


class Column(Schema):
    """Column of a channel: value = sign · scale · column in its unit + offset."""

    column: str = Field(description="name of the column or variable; in a MAT file struct.field [-]")
    unit: str | None = Field(default=None, description="unit of the column, if the file does not state it [-]")
    sign: Literal[1, -1] = Field(default=1, description="-1 for a channel against the axes of ISO 8855 [-]")
    scale: float = Field(default=1.0, description="factor of a scaled signal [-]")
    offset: float = Field(default=0.0, description="offset, added last [SI unit of the channel]")


class TimeColumn(Schema):
    """Clock of a log: a column, or a fixed step."""

    column: str | None = Field(default=None, description="name of the column [-]")
    unit: str | None = Field(default=None, description="unit of the column; that of the file, or s, if left out [-]")
    step: Duration | None = Field(default=None, gt=0.0, description="sample time, if no column has the time [s]")

    @field_validator("unit")
    @classmethod
    def _of_time(cls, unit: str | None) -> str | None:
        if unit is not None and plain_unit(unit) not in {"us", "ns"}:
            unit_factor(unit, "s")
        return unit

    @model_validator(mode="after")
    def _one_clock(self) -> "TimeColumn":
        if (self.column is None) == (self.step is None):
            raise ValueError("needs either a column or a step")
        return self


def _short(value: Any) -> Any:
    return {"column": value} if isinstance(value, str) else value


Mapped = Annotated[Column, BeforeValidator(_short)]


def _checked(channels: dict[str, Column]) -> dict[str, Column]:
    used: dict[str, str] = {}
    for name, column in channels.items():
        si = channel(name).unit
        if column.unit is not None:
            try:
                unit_factor(column.unit, si)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        if column.column in used:
            raise ValueError(f"column '{column.column}' is given twice, as {used[column.column]} and as {name}")
        used[column.column] = name
    return channels


class LogSpec(Schema):
    """One recorded log."""

    file: str = Field(description="CSV, MAT or Parquet file or a run folder, relative to the data file [-]")
    use: Literal["train", "validation"] = Field(default="train", description="training or validation [-]")
    name: str | None = Field(default=None, description="name in reports; that of the file if left out [-]")
    start: Duration | None = Field(default=None, description="time of the first row to use [s]")
    end: Duration | None = Field(default=None, description="time of the last row to use [s]")
    time: TimeColumn | None = Field(default=None, description="instead of the setting for all logs [-]")
    channels: dict[str, Mapped] = Field(default={}, description="columns that replace those of all logs [-]")
    csv: CsvLayout | None = Field(default=None, description="instead of the setting for all logs [-]")

    _channels = field_validator("channels")(_checked)

    @model_validator(mode="after")
    def _forward(self) -> "LogSpec":
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ValueError(f"ends at {self.end:g} s, before it starts at {self.start:g} s")
        return self


class DataSpec(Schema):
    """Data set: several logs of one vehicle."""

    mirdrake: Literal["data/1"] = Field(description="format and version [-]")
    about: str = Field(default="", description="description for people [-]")
    wheelbase: Length | None = Field(default=None, gt=0.0, description="front to rear axle [m]")
    mass: Mass | None = Field(default=None, gt=0.0, description="mass, fixed in a fit without a study [kg]")
    front_length: Length | None = Field(
        default=None, gt=0.0, description="centre of mass to front axle, fixed in a fit without a study [m]"
    )
    front_drive: float | None = Field(
        default=None, ge=0.0, le=1.0,
        description="front axle's share of the drive force, fixed in a fit without a study; 1: front-wheel drive [1]",
    )  # fmt: skip
    front_brake: float | None = Field(
        default=None, ge=0.0, le=1.0,
        description="front axle's share of the braking force, fixed in a fit without a study [1]",
    )  # fmt: skip
    time: TimeColumn = Field(default=TimeColumn(column="time"), description="clock of all logs [-]")
    channels: dict[str, Mapped] = Field(default={}, description="columns of all logs, by name of the channel [-]")
    csv: CsvLayout = Field(default=CsvLayout(), description="layout of CSV files [-]")
    clock: str | None = Field(
        default=None, description="channel without delay, that others are shifted to; found if left out [-]"
    )
    repairs: list[Repair] = Field(default=list(REPAIRS), description="repairs that the data check may make [-]")
    logs: list[LogSpec] = Field(min_length=1, description="the recorded logs [-]")

    _channels = field_validator("channels")(_checked)

    @model_validator(mode="after")
    def _known_clock(self) -> "DataSpec":
        names = sorted({*self.channels, *(name for log in self.logs for name in log.channels)})
        if self.clock is not None and self.clock not in names:
            raise ValueError(f"clock: no channel '{self.clock}' is mapped; {did_you_mean(self.clock, names)}")
        return self

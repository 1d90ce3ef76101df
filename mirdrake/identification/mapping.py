"""Data set of a single log without a data file: columns by their names and by command-line options."""

from collections.abc import Sequence
from pathlib import Path

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import Source, display_path, to_si, validate
from mirdrake.identification.channels import CHANNELS
from mirdrake.identification.run_vehicle import vehicle_of_run
from mirdrake.identification.spec import DataSpec
from mirdrake.readers import CsvLayout, read_table
from mirdrake.readers.formats import is_bag
from mirdrake.readers.tables import Table
from mirdrake.readers.units import unit_factor

ALIASES = {
    "vx": ("v_x", "vel_x", "velocity_x"),
    "vy": ("v_y", "vel_y", "velocity_y"),
    "yaw_rate": ("wz", "yawrate", "gyro_z", "yaw_rate_z"),
    "speed": ("v", "velocity"),
    "longitudinal_acceleration": ("ax", "acc_x", "a_x"),
    "lateral_acceleration": ("ay", "acc_y", "a_y"),
    "roll_rate": ("wx",),
    "pitch_rate": ("wy",),
    "yaw": ("heading",),
}
"""Other column names of channels, used if the column states a fitting unit."""


def map_log(
    path: Path, mapped: Sequence[str], clock: str | None, step: str | None, wheelbase: float | None
) -> DataSpec:
    """Return a data set of one log.

    Args:
        path: path of the log.
        mapped: ``"CHANNEL=COLUMN[:UNIT]"`` texts.
        clock: ``"COLUMN[:UNIT]"``; None for the column time.
        step: sample time of a log without a clock; None if it has one.
        wheelbase: [m]; None for that of the vehicle of a run, and if unknown.

    Raises:
        ConfigError: the file cannot be read, or no column is mapped.
    """
    channels: Json = {}
    for text in mapped:
        name, equals, column = text.partition("=")
        if not equals or not column:
            raise ConfigError("write CHANNEL=COLUMN or CHANNEL=COLUMN:UNIT, as vx=v_kmh:km/h", where=f"--map {text}")
        if name.partition("@")[0] not in CHANNELS:
            raise ConfigError(f"unknown channel '{name}'; {did_you_mean(name, CHANNELS)}", where=f"--map {text}")
        channels[name] = _column(column)
    if clock is not None and step is not None:
        raise ConfigError("--time names a clock already; leave out one of them", where="--step")
    time: Json = {"column": "time"} if clock is None else _column(clock)
    if step is not None:
        time = {"step": to_si(step, "s")}
    # Columns of a bag cannot be listed without reading it, so they have no aliases.
    columns = [entry["column"] for entry in channels.values()] + [time.get("column", "time")]
    if not is_bag(path):
        table = read_table(path, columns, CsvLayout())
        used = {entry["column"] for entry in channels.values()}
        for name in table.names:
            found = _channel_of(name)
            # A name alone is not enough: ax could be in g. Columns are guessed only if they also state a unit.
            if found is not None and _has_unit(table, name, found) and found not in channels and name not in used:
                channels[found] = {"column": name}
        names = ", ".join(table.names[:20]) + (", …" if len(table.names) > 20 else "")
        if time == {"column": "time"} and "time" not in table.names:
            raise ConfigError(
                f"has no column 'time'; name the clock with --time COLUMN:UNIT, or give --step; columns are {names}",
                where=display_path(path),
            )
        if not channels:
            raise ConfigError(
                f"no column is mapped; give --map CHANNEL=COLUMN:UNIT; columns are {names}", where=display_path(path)
            )
    elif not channels:
        raise ConfigError("no topic is mapped; give --map CHANNEL=/topic:field:UNIT", where=display_path(path))
    content: Json = {"mirdrake": "data/1", "time": time, "channels": channels, "logs": [{"file": path.name}]}
    if wheelbase is None and (vehicle := vehicle_of_run(path)) is not None:
        wheelbase = vehicle.wheelbase
    content |= {} if wheelbase is None else {"wheelbase": wheelbase}
    return validate(content, DataSpec, Source("command line", {}))


def _column(text: str) -> dict[str, str]:
    """Return column and unit of ``"COLUMN:UNIT"``; the last colon counts, as a topic has one of its own."""
    # Topics contain a colon between topic and field; a second one separates the unit.
    topic = text.startswith("/")
    head, colon, tail = text.rpartition(":")
    if not colon or (topic and ":" not in head):
        return {"column": text}
    return {"column": head, "unit": tail}


def _has_unit(table: Table, column: str, channel: str) -> bool:
    """Whether a column states a unit that fits the channel; a pure number needs none."""
    si = CHANNELS[channel].unit
    if column not in table.units:
        return si == "1"
    try:
        unit_factor(table.units[column], si)
    except ValueError:
        return False
    return True


def _channel_of(column: str) -> str | None:
    """Return the channel that a column is by its name, such as vx for ``ego.vx``."""
    # The last part of a dotted name, as recorders put the vehicle or device before it.
    last = column.rpartition(".")[2].strip().lower()
    if last in CHANNELS:
        return last
    return next((name for name, others in ALIASES.items() if last in others), None)

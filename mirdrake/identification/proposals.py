"""Proposal of a data file for a log that nobody has described: columns by their names and values, units by kinematics.

The name of a column gives its channel, the file or the name its unit. Units and signs that nobody states are those with
which the kinematic relations between the channels hold (:mod:`mirdrake.identification.relations`); the steering turns
to the side of the yaw rate, and its size distinguishes a hand wheel from the road wheels.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path
from mirdrake.identification.channels import channel
from mirdrake.identification.column_names import TIME, channel_by_name, channels_of_run, fits, plain_name, unit_by_name
from mirdrake.identification.data import Log
from mirdrake.identification.derived import DERIVATIONS, add_derived, available
from mirdrake.identification.message_types import fields_of
from mirdrake.identification.plausibility import STEERING, estimate_gains, exchanged_axes, steering_sign
from mirdrake.identification.relations import relation_effect
from mirdrake.identification.run_vehicle import KnownVehicle, vehicle_of_run
from mirdrake.readers import read_table
from mirdrake.readers.bags import list_topics
from mirdrake.readers.formats import is_bag
from mirdrake.readers.tables import Table
from mirdrake.readers.time_columns import MIN_ROWS
from mirdrake.readers.units import QUANTITIES, unit_factor

Array = NDArray[np.float64]

_UNITS = {
    "m/s": ("m/s", "km/h", "mph"), "rad/s": ("rad/s", "deg/s"), "rad": ("rad", "deg"), "m/s^2": ("m/s^2", "g"),
    "1": ("-", "%"), "N": ("N", "kN"), "m": ("m",), "N m": ("N m",),
}  # fmt: skip
"""Usual units by SI unit, the most usual first."""

HAND_WHEEL = 10.0
"""Length v δ / r above which δ is the angle of a hand wheel, as no road vehicle has this wheelbase [m]."""

MAX_ROAD_ANGLE = 1.5
"""Largest angle of a road wheel about its steering axis [rad]; the joints of vehicles allow less."""

MAX_NAMES = 200
"""Largest number of different cells of a column with names of channels."""

_ROAD_WHEELS = ("road_wheel_angle_left", "road_wheel_angle_right")

_SIGN_COST = {"speed": 3.0, "vx": 3.0, "yaw": 0.8}
"""Cost of a negative sign: a speed is seldom negative, a compass turns to the right."""

_USUAL = {"m/s": 70.0, "rad/s": 4.0, "rad": 2.0 * math.pi, "m/s^2": 25.0, "1": 1.5}
"""Sizes beyond which a value is rather one in another unit [SI]."""


@dataclass(frozen=True)
class Proposal:
    """Column of a channel, as far as it can be guessed.

    Attributes:
        channel: canonical name.
        column: name of the column.
        unit: unit of the column.
        sign: 1 or -1.
        reasons: why, for the comment.
        is_stated: whether the unit is certain: in the file, in the name, or by the type of a message.
        unit_in_file: whether the reader of the file returns the unit.
    """

    channel: str
    column: str
    unit: str
    sign: int
    reasons: tuple[str, ...]
    is_stated: bool
    unit_in_file: bool = False

    @property
    def factor(self) -> float:
        """SI value of one [unit]."""
        return self.sign * unit_factor(self.unit, channel(self.channel).unit)


class Other(NamedTuple):
    """Column without a channel: name, unit and range."""

    column: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class DataProposal:
    """Proposed data file.

    Attributes:
        file: the log.
        time: column of the clock; None without one.
        time_unit: its unit.
        time_reason: why.
        channels: proposals.
        others: columns without a channel.
        notes: what was detected about the file.
        vehicle: dimensions of the vehicle, in a run of mirdrake.
    """

    file: Path
    time: str | None
    time_unit: str
    time_reason: str
    channels: tuple[Proposal, ...]
    others: tuple[Other, ...]
    notes: tuple[str, ...]
    vehicle: KnownVehicle | None = None


def propose_data(path: Path) -> DataProposal:
    """Propose a data file for a log.

    Args:
        path: file of any known format, bag, or run folder.

    Raises:
        ConfigError: the file cannot be read, or has no column of numbers.
    """
    stated: list[Proposal] = []
    if is_bag(path):
        stated = _proposals_of_bag(path)
        # Only proposed columns are read: a bag has hundreds of others.
        table = read_table(path, [proposal.column for proposal in stated])
    else:
        table = read_table(path)
    numbers = _numeric_columns(table)
    if not numbers:
        raise ConfigError("has no column of numbers", where=display_path(path))
    time, unit, reason = _clock(table, numbers)
    seconds = _seconds(numbers, time, unit)
    channels = stated or _proposals_by_name(table, numbers, time)
    if not channels and (names := _column_of_names(table)) is not None:
        raise ConfigError(
            f"the cells of column '{names}' are names of channels, with a value for each in "
            "another column; write a column for each channel first, for example with pivot_table of pandas",
            where=display_path(path),
        )
    # The steering needs the units of speed and yaw rate, and its sign needs to know which steering it is.
    channels = _solve_units(_exchange_axes(channels, numbers, seconds), numbers, seconds)
    channels = _solve_steering(channels, numbers, seconds)
    used = {proposal.column for proposal in channels} | {time}
    others = tuple(
        Other(name, table.units.get(name, ""), float(np.nanmin(values)), float(np.nanmax(values)))
        for name, values in numbers.items()
        if name not in used
    )
    return DataProposal(path, time, unit, reason, tuple(channels), others, tuple(table.notes), vehicle_of_run(path))


def missing_channels(proposal: DataProposal) -> list[str]:
    """Return what a fit needs and the proposal lacks, one line each."""
    names = available({item.channel for item in proposal.channels})
    needs = {
        "a speed (vx or speed)": {"vx", "speed"},
        f"the steering ({', '.join(STEERING)})": set(STEERING),
        "a response (yaw_rate, lateral_acceleration or vy)": {"yaw_rate", "lateral_acceleration", "vy"},
    }
    return [f"missing for a fit of the steering: {quantity}" for quantity, some in needs.items() if not names & some]


def _numeric_columns(table: Table) -> dict[str, Array]:
    """Return the columns with numbers, by name."""
    columns = {}
    for name in table.names:
        try:
            values = table.numbers(name, table.name)
        except ConfigError:
            continue  # text, such as a name of a driver
        if np.isfinite(values).sum() >= MIN_ROWS:
            columns[name] = values
    return columns


def _column_of_names(table: Table) -> str | None:
    """Return the column whose cells are names of channels, of which each row has the value of one; None without."""
    for name in table.names:
        cells = pd.Series(np.asarray(table.columns[name]).ravel())
        if pd.api.types.is_numeric_dtype(cells):
            continue
        texts = cells.dropna().astype(str)
        kinds = list(texts.unique()[: MAX_NAMES + 1])
        known = {found for kind in kinds if (found := channel_by_name(kind)) is not None}
        if len(known) > 1 and len(kinds) <= min(MAX_NAMES, len(texts) // 2):
            return name
    return None


def _clock(table: Table, numbers: Mapping[str, Array]) -> tuple[str | None, str, str]:
    """Return column, unit and reason of the clock; None if no column increases."""
    increasing = [name for name, values in numbers.items() if _increases(values)]
    named = [name for name in increasing if TIME.search(plain_name(name))]
    # A distance or a longitude may increase as well.
    first = next(iter(numbers))
    if not named and (first not in increasing or _is_no_clock(table, first)):
        return None, "", "no column increases from row to row: state the sample time"
    name = named[0] if named else first
    reason = "by its name" if named else "the first column, which increases"
    stated = table.units.get(name) or unit_by_name(name, "s")
    if stated and (fits(stated, "s") or stated in {"us", "ns", "µs"}):
        return name, stated, f"{reason}; unit as stated"
    # Loggers have steps of 0.5 ms to 0.5 s.
    step = float(np.nanmedian(np.diff(numbers[name])))
    unit = next((unit for unit, max_step in (("s", 0.5), ("ms", 500.0), ("us", 5e5)) if step <= max_step), "ns")
    return name, unit, f"{reason}; unit guessed from steps of {step:.4g}"


def _is_no_clock(table: Table, column: str) -> bool:
    """Whether a column is another quantity than time, by its name or unit."""
    unit = table.units.get(column, "")
    if channel_by_name(column, unit) is not None:
        return True
    return (
        not fits(unit, "s")
        and any(fits(unit, si) or unit_by_name(column, si) for si in QUANTITIES if si != "s")
        and unit_by_name(column, "s") is None
    )


def _increases(values: Array) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return bool(len(steps) >= MIN_ROWS - 1 and np.mean(steps > 0.0) > 0.9 and np.mean(steps < 0.0) < 0.01)


def _seconds(numbers: Mapping[str, Array], time: str | None, unit: str) -> Array:
    if time is None:
        return np.arange(len(next(iter(numbers.values()))), dtype=np.float64) * 0.01
    size = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}.get(unit.lower(), 1.0)
    values = numbers[time]
    return np.asarray((values - values[np.isfinite(values)][0]) * size, dtype=np.float64)


def _proposals_by_name(table: Table, numbers: Mapping[str, Array], time: str | None) -> list[Proposal]:
    """Return proposals by the names of columns; of several columns of a channel, further ones are other sources."""
    proposals: dict[str, Proposal] = {}
    own = channels_of_run(table.names)
    for column, values in numbers.items():
        found = own.get(column) if own is not None else channel_by_name(column, table.units.get(column, ""))
        # A constant column has neither unit nor sign that could be recognised.
        if column == time or found is None or np.nanmin(values) == np.nanmax(values):
            continue
        name = "road_wheel_angle" if found == "steering" else found
        si = channel(name).unit
        # Truth values are the state of something, such as steeringPressed, and no size.
        if si != "1" and np.isin(values[np.isfinite(values)], (0.0, 1.0)).all():
            continue
        stated = table.units.get(column)
        if stated and not fits(stated, si):
            # A steering in percent is a command, not an angle.
            if found != "steering" or stated not in {"%", "-"}:
                continue  # a pressure of the brakes is not a pedal
            name, si = "steering_command", "1"
        # The spin angle of a wheel grows without a limit.
        if name in _ROAD_WHEELS and stated and np.nanmax(np.abs(values)) * unit_factor(stated, si) > MAX_ROAD_ANGLE:
            continue
        unit = stated or unit_by_name(column, si)
        source = "name" if own is None else "signal of mirdrake"
        reasons = (source, "unit in the file" if stated else "unit in the name" if unit else "")
        if name in proposals:
            number = 2 + sum(key.startswith(f"{name}@") for key in proposals)
            name = f"{name}@{number}"
        proposals[name] = Proposal(
            name, column, unit or _UNITS[si][0], 1, tuple(filter(None, reasons)), _is_certain(name, unit), bool(stated)
        )
    return list(proposals.values())


def _proposals_of_bag(path: Path) -> list[Proposal]:
    """Return proposals by the types of messages, and by the names of fields for other types.

    Raises:
        ConfigError: no topic has a channel.
    """
    proposals: dict[str, Proposal] = {}
    topics = list_topics(path)
    for topic in topics:
        known = fields_of(topic.kind)
        for key in topic.fields:
            column = f"{topic.name}:{key}"
            if known and key not in known:
                continue
            # A field called data or value has the name of its topic.
            by_name = channel_by_name(key) or (channel_by_name(topic.name) if len(topic.fields) == 1 else None)
            name, unit = known.get(key, (by_name, None))
            if name is None:
                continue
            name = "road_wheel_angle" if name == "steering" else name
            reasons = (f"field of {topic.kind}" if known else f"name; type {topic.kind}",)
            si = channel(name).unit
            unit = unit or unit_by_name(key, si)
            # Several topics may carry the same quantity; further ones get the name of their topic.
            if name in proposals:
                name = f"{name}@{plain_name(topic.name)}"
            if name not in proposals:
                proposals[name] = Proposal(name, column, unit or _UNITS[si][0], 1, reasons, _is_certain(name, unit))
    if not proposals:
        listed = ", ".join(f"{topic.name} ({topic.kind})" for topic in topics[:8]) or "none"
        raise ConfigError(f"no topic has a known type or name; topics: {listed}", where=display_path(path))
    return list(proposals.values())


def _is_certain(name: str, unit: str | None) -> bool:
    """Whether no unit has to be guessed: it is stated, or the channel is a code or a command of any size."""
    known = channel(name)
    return unit is not None or (known.unit == "1" and known.limit > 10.0)


def _log(proposals: list[Proposal], numbers: Mapping[str, Array], seconds: Array) -> Log:
    """Return the log of proposals in SI units."""
    values = {item.channel: item.factor * numbers[item.column] for item in proposals}
    rows = np.isfinite(seconds)
    rows[1:] &= np.diff(seconds, prepend=seconds[:1])[1:] > 0.0
    channels, _ = add_derived({name: series[rows] for name, series in values.items()})
    return Log("proposal", "train", seconds[rows], channels)


def _exchange_axes(proposals: list[Proposal], numbers: Mapping[str, Array], seconds: Array) -> list[Proposal]:
    """Return proposals in which x and y of an accelerometer turned by 90 degrees are those of the vehicle."""
    if exchanged_axes(_log(proposals, numbers, seconds)) is None:
        return proposals
    other = {
        "longitudinal_acceleration": "lateral_acceleration", "lateral_acceleration": "longitudinal_acceleration",
    }  # fmt: skip
    why = "axis by the relations to other channels"
    return [
        replace(item, channel=other[item.channel], reasons=(*item.reasons, why)) if item.channel in other else item
        for item in proposals
    ]


def _solve_units(proposals: list[Proposal], numbers: Mapping[str, Array], seconds: Array) -> list[Proposal]:
    """Return proposals with the units and signs at the least cost: relations that fail, and unusual choices."""
    log = _log(proposals, numbers, seconds)
    gains = [(gain.relation, gain.gain) for gain in estimate_gains(log)]
    turns = {name: sign for name in STEERING if (sign := steering_sign(log, name)) is not None}
    sizes = {item.channel: float(np.nanpercentile(np.abs(numbers[item.column]), 99.0)) for item in proposals}
    # Units that the file states are certain; signs are not, because conventions differ.
    options = [
        [(unit, sign) for unit in ((item.unit,) if item.is_stated else _UNITS[channel(item.channel).unit])
         for sign in (1, -1)]
        for item in proposals
    ]  # fmt: skip
    base = {item.channel: item.factor for item in proposals}

    def cost(chosen: list[Proposal]) -> float:
        # Effects on the relations are products of powers, so that one estimate of the gains serves all candidates.
        ratios = {item.channel: item.factor / base[item.channel] for item in chosen}
        # A derived channel scales with its sources.
        derived = [item for item in DERIVATIONS if set(item.sources) <= ratios.keys()]
        ratios = {target: ratios[item.sources[0]] for item in derived for target in item.targets} | ratios
        total = 0.0
        for relation, gain in gains:
            value: float = gain * math.prod(relation_effect(relation, name, ratio) for name, ratio in ratios.items())
            # A factor of 1.25 costs 1, more than 2.4 no more than 4; a wrong sign costs 6.
            total += min(abs(math.log(abs(value))) / math.log(1.25), 4.0) + 6.0 * (value < 0.0)
        # The yaw rate follows speed times steering: the sign of their correlation changes with each of the three.
        speed = next((ratios[name] for name in ("vx", "speed") if name in ratios), 1.0)
        total += sum(6.0 * (sign * ratios[name] * ratios["yaw_rate"] * speed < 0.0) for name, sign in turns.items())
        # Small costs decide where the relations do not: usual magnitudes, the first unit of the list, no negative sign.
        for item, own in zip(chosen, options, strict=True):
            usual = _USUAL.get(channel(item.channel).unit, math.inf)
            total += 2.0 * (abs(item.factor) * sizes[item.channel] > usual) + 0.25 * own.index((item.unit, 1))
            total += (item.sign < 0) * _SIGN_COST.get(item.channel, 1.0)
        return total

    # One channel or two at a time, until no change helps: a wrong unit of one shows in several relations.
    best, min_cost, better = list(proposals), cost(list(proposals)), True
    while better:
        better = False
        for first, second in combinations_with_replacement(range(len(best)), 2):
            for first_choice, second_choice in product(options[first], options[second]):
                tried = list(best)
                for index, (unit, sign) in ((first, first_choice), (second, second_choice)):
                    tried[index] = replace(tried[index], unit=unit, sign=sign)
                if (value := cost(tried)) < min_cost - 1e-9:
                    best, min_cost, better = tried, value, True
    related = {name for relation, _ in gains for name in (relation.measured, *relation.others)}
    return [_with_reasons(item, related | set(turns)) for item in best]


def _with_reasons(item: Proposal, related: Collection[str]) -> Proposal:
    """Return a proposal with the reasons of its unit and sign."""
    found = " and ".join([*([] if item.is_stated else ["unit"]), *(["sign"] if item.sign < 0 else [])])
    how = "by the relations to other channels" if item.channel in related else "guessed by the size of its values"
    return replace(item, reasons=(*item.reasons, f"{found} {how}") if found else item.reasons)


def _solve_steering(proposals: list[Proposal], numbers: Mapping[str, Array], seconds: Array) -> list[Proposal]:
    """Return proposals in which a steering angle is that of the hand wheel or of the road wheels, by its size."""
    log = _log(proposals, numbers, seconds)
    result = []
    for item in proposals:
        if item.channel != "road_wheel_angle" or channel_by_name(item.column) == "road_wheel_angle":
            result.append(item)
            continue
        size = float(np.nanpercentile(np.abs(numbers[item.column]), 99.0))
        unit = item.unit if item.is_stated or size < MAX_ROAD_ANGLE else "deg"
        factor = unit_factor(unit, "rad")
        length = _steering_length(log, factor / item.factor)
        is_hand = size * factor > 0.9 if length is None else length > HAND_WHEEL
        reason = f"angle over curvature is {length:.3g} m" if length is not None else f"up to {size * factor:.2g} rad"
        name = "steering_wheel_angle" if is_hand else "road_wheel_angle"
        result.append(replace(item, channel=name, unit=unit, is_stated=True, reasons=(*item.reasons, reason)))
    return result


def _steering_length(log: Log, factor: float) -> float | None:
    """Return the length v δ / r by regression, for a factor on the road wheel angle [m]; None without yaw rate."""
    speed = log.channels.get("vx", log.channels.get("speed"))
    if speed is None or "yaw_rate" not in log.channels:
        return None
    turn, angle = log.channels["yaw_rate"], factor * log.channels["road_wheel_angle"]
    good = np.isfinite(speed) & np.isfinite(turn) & np.isfinite(angle)
    turn, sweep = turn[good], (speed * angle)[good]
    return float(abs(turn @ sweep) / (turn @ turn)) if turn @ turn > 0.0 else None

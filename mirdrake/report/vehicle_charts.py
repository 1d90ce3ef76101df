"""The charts of one vehicle: signals, units and captions."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas
from markupsafe import Markup

from mirdrake.manoeuvres.record import bicycle_angles
from mirdrake.report.figures import Array, Curve, Panel, draw_chart
from mirdrake.report.words import format_quantity, format_time

_AXLES = ("front", "rear")
_NO_ERROR = 1e-3  # [m]: below this a lateral error is not worth a close look
_SIDES = ("left", "right")
_WIDTHS = {"left": 2.1, "right": 1.3}  # [px]: both are visible where they coincide

_LEAST_ANGLE = 0.1  # [°] a panel of steering angles shows at least this range


@dataclass(frozen=True)
class Chart:
    """A chart with its title, caption and legend; `legend` has (name, colour, "dashed" or "") of each curve once."""

    slug: str
    title: str
    caption: str
    picture: Markup
    legend: list[tuple[str, str, str]]


class VehicleSignals:
    """The signals of one vehicle: columns by their short names, NaN where a value is not finite.

    Args:
        frame: all signals, one row per stamp.
        name: name of the vehicle, the first part of its column names.
    """

    def __init__(self, frame: pandas.DataFrame, name: str) -> None:
        self.name = name
        self.frame = frame
        self.time: Array = numbers(frame.index)

    def __contains__(self, column: str) -> bool:
        return f"{self.name}.{column}" in self.frame.columns

    def __getitem__(self, column: str) -> Array:
        return numbers(self.frame[f"{self.name}.{column}"])

    def has(self, *columns: str) -> bool:
        """Whether all columns exist and each has at least one finite value."""
        return all(column in self and bool(np.isfinite(self[column]).any()) for column in columns)


def numbers(values: Any) -> Array:
    """Return a column as floats; other values, and those that are not finite, are NaN."""
    # Anything from a damaged file may be in a column; Matplotlib needs floats with NaN as gaps.
    array = np.array(pandas.to_numeric(pandas.Series(values), errors="coerce"), dtype=np.float64)
    array[~np.isfinite(array)] = np.nan
    return array


def make_charts(
    signals: VehicleSignals,
    prefix: str,
    *,
    road_width: float | None = None,
    road_edges: tuple[Array, Array] | None = None,
    geometry: Mapping[str, float] | None = None,
    marks: Sequence[float] = (),
) -> list[Chart]:
    """Return the charts for which there are signals, in reading order.

    Args:
        signals: signals of the vehicle.
        prefix: prefix of ids, unique in the page.
        road_width: width of the track [m], if any.
        road_edges: lateral places [m] of its left and its right edge at every stamp, if its width varies.
        geometry: "wheelbase" [m] and "body_width" [m] over the wheels, as far as they are known.
        marks: times of events [s].
    """
    geometry = geometry or {}
    # The order is that of a reader's questions: how fast, where to, how far off, and why. Plans without signals are
    # None.
    plans = [
        _plan_speed(signals),
        _plan_steering(signals),
        _plan_lateral_error(signals, road_width, geometry.get("body_width"), road_edges),
        _plan_yaw_rate(signals, geometry.get("wheelbase")),
        _plan_wheels(signals, "wheel_torque", "Wheel torques", "torque", "N m", "torques", 1.0),
        _plan_loads(signals),
        _plan_wheels(
            signals,
            "wheel_contact_torque",
            "Contact: rolling resistance",
            "resistance torque",
            "N m",
            "rolling-resistance torques",
            1.0,
        ),
    ]
    charts: list[Chart] = []
    for plan in plans:
        if plan is None:
            continue
        slug, title, panels, caption = plan
        # The legend of the first panel suffices where the others show differences.
        shown = panels[:1] if slug in {"speed", "lateral-error"} else panels
        legend = list(
            dict.fromkeys(
                (curve.name, curve.colour, "dashed" if curve.dashed else "")
                for panel in shown
                for curve in panel.curves
            )
        )
        picture = draw_chart(signals.time, panels, f"{prefix}{slug}-", f"{title} against time. {caption}", marks=marks)
        charts.append(Chart(slug, title, caption, picture, legend))
    return charts


Plan = tuple[str, str, list[Panel], str]


def _plan_speed(signals: VehicleSignals) -> Plan | None:
    if not signals.has("vx"):
        return None
    speed = signals["vx"]
    if signals.has("vy"):
        # Speed over ground with the sign of the longitudinal velocity; a sliding vehicle also moves sideways.
        speed = np.hypot(speed, np.nan_to_num(signals["vy"])) * np.where(speed < 0.0, -1.0, 1.0)
    curves = [Curve("driven", speed, "main")]
    panels = [Panel("Speed", "m/s", curves, zero=True)]
    low, high, mean = (
        format_quantity(float(value), "m/s") for value in (np.nanmin(speed), np.nanmax(speed), np.nanmean(speed))
    )
    caption = f"Between {low} and {high}, {mean} on average"
    # The control follows its own set-point: a block between driver and control, or a slope, changes the command.
    source = next((name for name in ("speed_setpoint", "speed_command") if signals.has(name)), None)
    if source is not None:
        command = signals[source]
        curves.append(Curve("set-point", command, "ink", dashed=True))
        gap = np.abs(speed - command)
        if np.isfinite(gap).any():
            # The median, as the mean would be dominated by the start; a captioned zero would claim exact equality.
            within = format_quantity(max(float(np.nanmedian(gap)), 1e-4), "m/s", digits=2)
            caption += f"; half of the time within {within} of the set-point"
            error = Curve("speed − set-point", speed - command, "main")
            # Spikes at changes of the set-point are cut, or they would hide the steady error.
            panels.append(Panel("Speed minus set-point", "m/s", [error], zero=True, trim=3.0, relative_height=0.62))
    return "speed", "Speed and set-point", panels, caption + "."


def _plan_steering(signals: VehicleSignals) -> Plan | None:
    curves = [
        Curve(f"{side} wheel", np.degrees(signals[f"steering_angle.{side}"]), side, width=_WIDTHS[side])
        for side in _SIDES
        if signals.has(f"steering_angle.{side}")
    ]
    if signals.has("steering_command"):
        curves.append(Curve("command", np.degrees(signals["steering_command"]), "ink", dashed=True))
    if not curves:
        return None
    furthest = max(float(np.nanmax(np.abs(curve.values))) for curve in curves)
    caption = f"Positive is to the left; the largest is {format_quantity(furthest, '°')}. "
    caption += "The command is the angle of a single wheel at the middle of the front axle."
    # Numerical noise of a straight drive does not fill the panel.
    limits = (-_LEAST_ANGLE, _LEAST_ANGLE) if furthest < _LEAST_ANGLE else None
    return "steering", "Steering", [Panel("Steering angle", "°", curves, limits=limits, zero=True)], caption


def _plan_lateral_error(
    signals: VehicleSignals,
    road_width: float | None,
    body_width: float | None,
    road_edges: tuple[Array, Array] | None = None,
) -> Plan | None:
    if not signals.has("lateral_error"):
        return None
    error = signals["lateral_error"]
    # The caption states the worst value, which a reader looks for first.
    worst = int(np.nanargmax(np.abs(error)))
    size = abs(float(error[worst]))
    side = "left" if error[worst] > 0.0 else "right"
    caption = "Positive is to the left of the line. "
    if size < _NO_ERROR:
        caption += f"Below {format_quantity(1e3 * _NO_ERROR, 'mm', digits=1)} throughout."
    else:
        largest = format_quantity(size, "m", digits=2)
        caption += f"Largest: {largest} to the {side} at {format_time(float(signals.time[worst]))}; "
        caption += f"root mean square {format_quantity(float(np.sqrt(np.nanmean(error**2))), 'm', digits=2)}."
    curve = Curve("lateral error", error, "main")
    panels = [Panel("Lateral error", "m", [curve], zero=True)]
    # A small error would be a flat line on the scale of the road, so a second panel shows it across the road.
    across = "The same across the road"
    if road_edges is not None:
        edges = [
            Curve(f"{side} edge", values, "ink", dashed=True) for side, values in zip(_SIDES, road_edges, strict=True)
        ]
        # Distance of the vehicle's middle to the nearer edge; negative beyond it.
        room = float(np.nanmin([road_edges[0] - error, error - road_edges[1]]))
        smallest = format_quantity(room, "m", digits=2)
        caption += f" Dashed: the edges of the road; the middle of the car is at least {smallest} from them."
        panels.append(Panel(across, "m", [curve, *edges], zero=True, relative_height=0.62))
    elif road_width:
        edge = road_width / 2.0
        # Half a body inside the edge, a wheel leaves the road.
        room = edge - body_width / 2.0 if body_width and body_width < road_width else edge
        top = max(1.15 * edge, 1.1 * size)
        limits = sorted({room, edge})
        bands = [(low, 2.0 * top, "right") for low in limits] + [(-2.0 * top, -low, "right") for low in limits]
        caption += f" Shaded: beyond {format_quantity(room, 'm', digits=2)} a wheel, " if room < edge else " Shaded: "
        width = format_quantity(road_width, "m")
        caption += f"beyond {format_quantity(edge, 'm')} the middle of the car leaves the {width} wide road."
        # A large error is seen well on the scale of the road; a tiny one is not worth a panel.
        if size > 0.5 * room or size < _NO_ERROR:
            panels = [Panel("Lateral error", "m", [curve], limits=(-top, top), bands=bands)]
        else:
            panels.append(Panel(across, "m", [curve], limits=(-top, top), bands=bands, relative_height=0.62))
    return "lateral-error", "Lateral error", panels, caption


def _plan_yaw_rate(signals: VehicleSignals, wheelbase: float | None) -> Plan | None:
    if not signals.has("wz"):
        return None
    rate = np.degrees(signals["wz"])
    curves = [Curve("measured", rate, "main")]
    caption = f"Up to {format_quantity(float(np.nanmax(np.abs(rate))), '°/s')}."
    if wheelbase and signals.has("vx", "steering_angle.left", "steering_angle.right"):
        # Kinematic yaw rate of the single-track model without side slip.
        tangent = np.tan(bicycle_angles(signals["steering_angle.left"], signals["steering_angle.right"]))
        curves.append(Curve("v·tan δ / L", np.degrees(signals["vx"] * tangent / wheelbase), "ink", dashed=True))
        caption += f" Dashed: kinematic yaw rate, without sideslip; wheelbase L\u00a0=\u00a0{wheelbase:.2f}\u00a0m."
    return "yaw-rate", "Yaw rate", [Panel("Yaw rate", "°/s", curves, zero=True)], caption


def _plan_loads(signals: VehicleSignals) -> Plan | None:
    names = [f"wheel_load.{axle}_{side}" for axle in _AXLES for side in _SIDES]
    usual = max((float(np.nanmedian(signals[name])) for name in names if signals.has(name)), default=0.0)
    unit, factor = ("kN", 1e-3) if usual >= 1000.0 else ("N", 1.0)
    return _plan_wheels(signals, "wheel_load", "Contact: wheel loads", "load", unit, "loads", factor)


def _plan_wheels(
    signals: VehicleSignals, stem: str, title: str, what: str, unit: str, plural: str, factor: float
) -> Plan | None:
    panels: list[Panel] = []
    constant: list[Panel] = []  # the first is drawn if all are constant; else the caption suffices
    ranges: list[str] = []
    for axle in _AXLES:
        curves = [
            Curve(side, factor * signals[f"{stem}.{axle}_{side}"], side, width=_WIDTHS[side])
            for side in _SIDES
            if signals.has(f"{stem}.{axle}_{side}")
        ]
        if not curves:
            continue
        lowest = min(float(np.nanmin(curve.values)) for curve in curves)
        highest = max(float(np.nanmax(curve.values)) for curve in curves)
        # Short peaks of contact forces would flatten the rest of the curve.
        panel = Panel(f"{axle.capitalize()} {what}", unit, curves, zero=True, trim=0.5, relative_height=0.8)
        if lowest == highest:
            ranges.append(f"{axle} {format_quantity(lowest, unit)} throughout")
            constant.append(panel)
        else:
            ranges.append(f"{axle} {format_quantity(lowest)} to {format_quantity(highest, unit)}")
            panels.append(panel)
    panels = panels or constant[:1]
    if not panels:
        return None
    return stem.replace("_", "-"), title, panels, f"Range of the {plural}: {'; '.join(ranges)}."


def distance(signals: VehicleSignals) -> float:
    """Return the length of the path [m] of the vehicle's origin; 0 without a position."""
    if not signals.has("x", "y"):
        return 0.0
    points = np.column_stack((signals["x"], signals["y"]))
    points = points[np.isfinite(points).all(axis=1)]
    # fsum: thousands of short distances without accumulated rounding errors.
    return math.fsum(np.hypot(*np.diff(points, axis=0).T)) if len(points) > 1 else 0.0

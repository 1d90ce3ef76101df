"""Sentences of the data check: a template, or a function of the figures, for each code."""

from collections.abc import Callable, Mapping
from string import Formatter
from typing import Any

from mirdrake.core.wording import plural
from mirdrake.readers.units import format_unit

Figures = Mapping[str, float | str]
Text = str | Callable[[Figures], str]


class _Formatter(Formatter):
    """Formatter with counts of a noun: ``{rows:|row}`` is "1 row" or "2 rows"."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as text, by the noun behind a bar if there is one."""
        bar, _, noun = format_spec.partition("|")
        return plural(value, noun) if noun and not bar else str(super().format_field(value, format_spec))


def render(texts: Mapping[str, Text], code: str, figures: Figures) -> str:
    """Return the sentence of a code."""
    text = texts[code]
    return format_unit(text(figures) if callable(text) else _Formatter().format(text, **figures))


def _sense(delay: float | str) -> str:
    """Return whether a channel lags or leads."""
    return "lags" if float(delay) > 0.0 else "leads"


def _ordinal(number: float | str) -> str:
    return {2: "second", 3: "third"}.get(int(number), f"{int(number)}th")


def _unit(figures: Figures) -> str:
    """Return the unit behind a number; none for a pure number."""
    return "" if figures["unit"] == "1" else f" {figures['unit']}"


def _milliseconds(figures: Figures) -> str:
    return f"{1e3 * abs(float(figures['delay'])):.3g} ± {2e3 * float(figures['sigma']):.2g} ms"


def _samples(figures: Figures) -> str:
    return f"({abs(float(figures['delay'])) / float(figures['step']):.3g} samples, correlation "


def _sparse(f: Figures) -> str:
    return f"has a value in every {_ordinal(f['every'])} row: its own rate is about {f['rate']:.4g} Hz"


def _copied(f: Figures) -> str:
    rows = f"{f['least']:.0f} rows" if f["least"] == f["most"] else (
        f"{f['least']} to {f['most']} rows, {f['factor']:.4g} on average"
    )  # fmt: skip
    return (
        f"every value is held over {rows}: the log was copied at {f['factor']:.4g} times its rate; the true step is "
        f"{f['step']:.6g} s on the clock of the log"
    )


def _held(f: Figures) -> str:
    average = "" if f["exact"] else " on average"
    return (
        f"is held over {f['factor']:.3g} rows{average} while it moves: its true rate is about {f['rate']:.3g} Hz "
        f"({f['percent']:.2g} % of those rows repeat the one before)"
    )


def _constant(f: Figures) -> str:
    return f"is {f['value']:.4g} {f['unit']} all the time" + (": the vehicle is at rest" if f["at_rest"] else "")


def _quantised(f: Figures) -> str:
    text = f"has a resolution of {f['quantum']:.3g} {f['unit']}: {f['levels']} different values from {f['low']:.4g} "
    text += f"to {f['high']:.4g}"
    return text + (", the resolution of single precision at this magnitude" if f["single_precision"] else "")


def _lateral_velocity(f: Figures) -> str:
    gain = float(f["gain"])
    text = f"lateral_acceleration and yaw_rate give {gain:.2g} times the change of vy: vy is too "
    text += "small by that factor" if gain > 1.0 else f"large by the factor {1.0 / gain:.2g}"
    if not f["is_step"]:
        return f"{text}; write a scale"
    true = f"{float(f['true_step']):.3g} s instead of {float(f['step']):.3g} s"
    return f"{text}, or the true step is {true}; write a scale, or 'time: {{step: …}}'"


def _true_step(f: Figures) -> str:
    text = f"the true step is {f['step']:.5g} s, {f['factor']:.4g} times the stated {f['stated']:.5g} s: {f['reasons']}"
    return text + (f": a clock {f['clock']}?" if f["clock"] else "")


def _bias(f: Figures) -> str:
    number = f"{f['bias']:+.3g} ± {2.0 * float(f['sigma']):.2g}" + _unit(f)
    return f"{f['channel']} is {number} where the vehicle drives straight: estimate an offset"


def _steering_scale(f: Figures) -> str:
    if f["length"]:
        return (
            f"the yaw rate is speed · {f['channel']} / {f['scale']:.3g} m: wheelbase times ratio, with the slip of "
            "the tyres"
        )
    text = f"the yaw rate is {f['scale']:.3g} times speed · {f['channel']} / wheelbase"
    if f["channel"] == "steering_wheel_angle":
        text += f": a steering ratio of about {1.0 / float(f['scale']):.3g}, with the slip of the tyres"
        return text + (": deg as rad, or the road wheel angle?" if f["odd"] else "")
    if f["odd"]:
        text += ": deg as rad?" if abs(float(f["scale"])) < 0.05 else ": a scaled signal, or the hand wheel angle?"
    return text


def _position(f: Figures) -> str:
    return f"{abs(float(f['distance'])):.3g} ± {2.0 * float(f['sigma']):.2g} m " + (
        "ahead of" if float(f["distance"]) > 0.0 else "behind"
    )


def _tilt(f: Figures) -> str:
    text = f"contains {f['part']:.3g} ± {2.0 * float(f['sigma']):.2g} m/s² times the sine of {f['angle']}: gravity"
    return text + (f", and {f['angle']} has the opposite sign of ISO 8855" if f["opposite"] else "")


def _relative_delay(f: Figures) -> str:
    return (
        f"{f['channel']} {_sense(f['delay'])} the value computed from {f['other']} by {_milliseconds(f)} "
        f"{_samples(f)}{f['correlation']:.3f})"
        + (f"; {f['speed']} {_sense(f['delay'])} by as much" if f.get("speed") else "")
    )


def _ambiguous_delay(f: Figures) -> str:
    return (
        f"{f['channel']} {_sense(f['delay'])} the value computed from {f['other']} by {_milliseconds(f)}; without a "
        "measured vy, its rate of change is a part of this: not shifted"
    )


def _accelerometer_position(f: Figures) -> str:
    return f"the accelerometer is {_position(f)} the point whose velocity is logged"


FINDINGS: dict[str, Text] = {
    "note": "{text}",
    "coarse_clock": "the time stamps have steps of {tick:.4g} s, shared by {rows:g} rows each: the true step is "
    "{step:.5g} s",
    "reversed_time": "time goes back in {rows:|row}, first after {time:.6g} s",
    "repeated_time": "the time of the row before is repeated in {rows:|row} (to 5 % of a step), first at {time:.6g} s",
    "step": "median step {step:.6g} s ({rate:.5g} Hz); 90 % of the steps are within {jitter:.2g} % of it",
    "gaps": "{gaps:|gap}, with about {lost:|sample} missing; the longest is {longest:.4g} s after {time:.6g} s",
    "long_gaps": "{gaps:|gap} longer than {limit:.3g} s: the log has {stretches:|stretch}",
    "sparse": _sparse,
    "missing": "{missing:|value} of {rows} missing ({percent:.3g} %)",
    "first_rows": "{rows:|row} without measurements at the beginning: {channel} is {first:.4g} there, then {then:.4g} "
    "{unit}",
    "copied": _copied,
    "repeated_by_chance": "{percent:.2g} % of the rows repeat the one before while it moves, as often as values of "
    "this resolution do by chance: not taken for held",
    "held": _held,
    "wrapped": "{count:|jump} by a whole turn, as headings have: unwrapped",
    "not_measured": "not measured in {rows:|row} at the beginning: 0 there, then {then:.4g} {unit}",
    "glitches": "{count:|sample} far from the neighbours, at {times} s; the largest is {worst:.4g} {unit}",
    "all_constant": "every channel is constant: there is nothing to identify",
    "constant": _constant,
    "out_of_range": "reaches {value:.4g} {unit}; no vehicle exceeds {limit:g}: another unit?",
    "gear_codes": "has the codes {codes}: those outside of 0 to 10 are not known",
    "quantised": _quantised,
    "clipped": "looks clipped at {value:.4g} {unit}: {count} samples have this value, in several visits",
    "unknown_step": "a step of {step:.4g} s is not usual for a recorder, and no channels determine the true one: give "
    "the clock's unit",
    "true_step": _true_step,
    "scale": "{channel} is {gain:.4g} ± {width:.2g} times the value computed from {others}, with an offset of "
    "{offset:+.3g} {unit}",
    "speed_ratio": "speed is {speed:.3g} m/s where vx is {vx:.3g} m/s (medians in motion): one of them has another "
    "unit, or is another quantity",
    "mistakes": "would be explained by: {mistakes}",
    "impossible_turn": "speed times yaw rate reaches {value:.3g} m/s², more than tyres can hold: deg as rad, km/h as "
    "m/s?",
    "exchanged_axes": "longitudinal_acceleration follows speed times yaw rate (correlation {longitudinal:.2f}), and "
    "lateral_acceleration does not ({lateral:.2f}): their columns are exchanged",
    "steering_sign": "{channel} to the left turns the vehicle to the right (correlation {correlation:.2f}): wrong sign",
    "steering_bias": _bias,
    "steering_scale": _steering_scale,
    "gyro_bias": "reads {value:+.3g} rad/s at standstill: the bias of a gyro, estimate an offset",
    "velocity_position": lambda f: f"vy is measured {_position(f)} the rear axle, if tyres slip linearly",
    "lateral_velocity": _lateral_velocity,
    "velocity_sign": "vy changes against lateral_acceleration and yaw_rate (correlation {correlation:.2f}): wrong sign",
    "path_direction": "the path turns right where the yaw rate is to the left (correlation {correlation:.2f}): wrong "
    "sign of x or of y",
    "gravity_at_rest": "reads {value:.3g} m/s² at standstill, as gravity does at a tilt of {tilt:.2g} deg",
    "gravity_with_tilt": _tilt,
    "response": lambda f: (
        f"the yaw rate follows {f['channel']} by {1e3 * float(f['delay']):.3g} ms, including the "
        "response of the vehicle"
        + ("; a response cannot precede its cause: the clocks of both channels differ" if f["early"] else "")
    ),
    "relative_delay": _relative_delay,
    "ambiguous_delay": _ambiguous_delay,
    "no_delay": lambda f: (
        f"no delay of {f['channel']} against yaw_rate is found; the logs determine it to "
        f"{1e3 * float(f['low']):.3g} to {1e3 * float(f['high']):.3g} ms"
    ),
    "accelerometer_position": _accelerometer_position,
    "common_source": lambda f: (
        f"{f['channel']} changes on the same rows as channels with a delay of "
        f"{1e3 * float(f['delay']):.3g} ms: it comes from the same source"
    ),
    "clock_drift": lambda f: (
        f"the delay of {f['channel']} against {f['other']} changes by "
        f"{1e6 * float(f['drift']):.3g} µs per second: two clocks"
    ),
}
"""Sentences of findings by code."""

REPAIRS: dict[str, Text] = {
    "rows_spread": "rows spread evenly between the time stamps",
    "rows_removed": "{rows:|row} removed",
    "cut": lambda f: (
        (f"cut into {f['parts']} parts" if float(f["parts"]) > 1 else "one stretch kept")
        + (f", {plural(int(f['lost']), 'row')} of short stretches removed" if f["lost"] else "")
    ),
    "rows_kept": "{kept} of {rows} rows kept, those with new values",
    "interpolated_holds": "interpolated linearly between new values",
    "first_value": "replaced by the first measured value",
    "interpolated": "replaced by linear interpolation",
    "scaled_time": "time multiplied by {factor:.5g}",
    "shifted": "shifted {shifts}{together}",
    "stretched": "{channels}",
}
"""Sentences of repairs by code."""


def _lateral(f: Figures) -> str:
    text = f"lateral acceleration to {f['largest']:.2g} m/s², {f['channel']} to {f['bandwidth']:.2g} Hz, turning at "
    text += f"{f['speed']:.3g} m/s ± {f['spread']:.2g}"
    if f["moves"] and not f["varied"]:
        text += "; one speed only: front and rear stiffness will be strongly correlated, add another speed"
    if float(f["largest"]) <= 2.0:
        text += "; little lateral acceleration: noise will matter"
    if f["moves"] and float(f["bandwidth"]) <= 0.8:
        text += "; slow steering: add a step or a sweep to 2 Hz"
    return text


def _turning(f: Figures) -> str:
    text = f"turning at {f['speed']:.3g} m/s ± {f['spread']:.2g}"
    return text + ("" if f["varied"] else ": ratio and understeer gradient are not separable at one speed")


def _friction(f: Figures) -> str:
    far = ": far from the limit of the tyres" if float(f["largest"]) < 4.0 else ""
    return f"lateral acceleration to {f['largest']:.2g} m/s²{far}"


def _coasting(f: Figures) -> str:
    text = f"{f['duration']:.3g} s of coasting over {f['span']:.3g} m/s"
    return text + ("; add a coast-down from a high speed" if float(f["span"]) < 8.0 else "")


EXCITATION: dict[str, Text] = {
    "lateral": _lateral,
    "turning": _turning,
    "friction": _friction,
    "coasting": _coasting,
    "pedal": "{duration:.3g} s of {pedal}, {steps:.0f} quick changes, {levels:.0f} levels",
}
"""Sentences of the excitation by code."""

"""Figures that drive plugins state: steering limit, rate and torque, drive and brake torque, maximum speed, ratio."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import isfinite, pi, radians

from mirdrake.importing.values import to_number
from mirdrake.importing.vehicles.model import Plugin

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_MAXIMUM = {"max", "maximum", "limit", "lim"}
_SPEED = {"speed", "velocity", "vel"}
_TORQUE = {"torque", "effort"}
_ENDS = {"front": "front", "rear": "rear", "back": "rear"}
_OTHER = {"gain", "pid", "p", "i", "d", "kp", "ki", "kd", "min", "minimum", "topic", "name", "frame", "joint", "noise",
          "motor", "engine", "accel", "acceleration", "decel", "deceleration", "jerk", "time", "range", "feed",
          "feedforward", "coefficient", "constant", "yaw", "angular", "lateral", "turn"}  # fmt: skip


@dataclass(frozen=True)
class Stated:
    """A figure of a plugin.

    Attributes:
        figure: steering_limit, hand_wheel_limit, steering_ratio, steering_rate, steering_effort, torque, brake_torque
            or max_speed.
        end: front or rear; "" if the figure is not of one axle.
        value: SI.
        key: name of the parameter in the plugin.
        where: ``file:line`` of the plugin.
    """

    figure: str
    end: str
    value: float
    key: str
    where: str


def read_stated(plugins: Iterable[Plugin]) -> list[Stated]:
    """Return the figures that plugins state."""
    figures = [item for plugin in plugins for item in _of_plugin(plugin)]
    # Beside a limit at the road wheel, a larger one is that of the hand wheel; alone it is beyond a right angle.
    # Steering limits beyond a right angle are those of the hand wheel.
    road = [item.value for item in figures if item.figure == "steering_limit" and item.value < 0.5 * pi]
    hand = [item for item in figures if item.figure == "steering_limit" and item.value >= 0.5 * pi]
    ratios = [
        Stated("steering_ratio", "", item.value / min(road), item.key, item.where)
        for item in hand
        if road and item.value <= 50.0
    ]
    stated = {item.figure for item in figures}
    return [item for item in figures if item not in hand] + ([] if "steering_ratio" in stated else ratios)


def _of_plugin(plugin: Plugin) -> Iterator[Stated]:
    for key, text in plugin.values.items():
        # Keys of plugins have no units by themselves: words in them state some.
        leaf = key.rpartition(".")[2].partition("[")[0]
        words = {word.lower() for word in _WORD.findall(leaf)}
        figure = _figure(words)
        value = to_number(text)
        if figure is None or value is None or not isfinite(value):
            continue
        value = abs(value) if figure != "torque" else value
        if words & {"deg", "degree", "degrees"}:
            value = radians(value)
        if words & {"kmh", "kph"}:
            value /= 3.6
        end = next((_ENDS[word] for word in sorted(words) if word in _ENDS), "")
        if value >= 0.0:
            yield Stated(figure, end, value, key, plugin.where)


def _figure(words: set[str]) -> str | None:
    """Return the quantity that a key denotes, recognised by its words."""
    steers = any(word.startswith("steer") for word in words)
    brakes = any(word.startswith("brak") for word in words)
    # Words such as "gain" or "topic" mark keys that are not limits.
    if words & _OTHER:
        return None
    if steers:
        if words & _TORQUE:
            return "steering_effort"
        if words & {"rate", *_SPEED}:
            return "steering_rate"
        if "ratio" in words:
            return "steering_ratio"
        return "steering_limit" if words & _MAXIMUM else None
    if words & _TORQUE:
        return "brake_torque" if brakes else "torque"
    if words & _SPEED and words & _MAXIMUM and not brakes and "wheel" not in words:
        return "max_speed"
    return None

"""Excitation: which groups of parameters a log can determine, by simple figures."""

import numpy as np

from mirdrake.identification.alignment import smooth
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Excitation, Verdict, statement
from mirdrake.identification.plausibility import STEERING
from mirdrake.identification.relations import Grid, make_grid

STRAIGHT = 0.5
"""Lateral acceleration, by yaw rate and speed, below which driving counts as straight [m/s²]."""


def check_excitation(log: Log) -> list[Excitation]:
    """Return figures and a verdict for each group of parameters that the channels of a log could give."""
    grid, ratings = make_grid(log), []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward not in grid.channels:
        return []
    speed = smooth(grid, forward)
    steering = next((name for name in STEERING if name in grid.channels), None)
    if "yaw_rate" in grid.channels:
        rate = smooth(grid, "yaw_rate")
        # v r is the lateral acceleration of a quasi-steady turn, without the bank of the road and the rate of vy.
        lateral = speed * rate if "lateral_acceleration" not in grid.channels else smooth(grid, "lateral_acceleration")
        ratings += _lateral(log.name, grid, speed, lateral, steering)
    ratings += _longitudinal(log.name, grid, speed)
    return ratings


def _rated(good: bool, weak: bool) -> Verdict:
    return "good" if good else "weak" if weak else "none"


def _lateral(name: str, grid: Grid, speed: Array, lateral: Array, steering: str | None) -> list[Excitation]:
    ratings = []
    # A percentile, as a single shock is not an excitation.
    largest = float(np.percentile(np.abs(lateral), 99.5))
    # Stiffness and ratio are separable only if turns are driven at different speeds.
    turning = np.abs(lateral) > 0.3 * max(largest, 0.3)
    spread = float(np.ptp(np.percentile(speed[turning], (5, 95)))) if turning.any() else 0.0
    mean = float(np.mean(speed[turning])) if turning.any() else 0.0
    varied = spread > 0.3 * max(mean, 1e-9)
    if steering is not None:
        band = bandwidth(grid.channels[steering], grid.step)
        moves = largest > 1.0
        figures = {"lateral_acceleration": largest, "bandwidth": band, "speed": mean, "speed_spread": spread}
        words = {"speed": mean, "spread": 0.5 * spread, "varied": varied}
        verdict = _rated(largest > 2.0 and band > 0.8 and varied, moves and band > 0.3)
        text = statement("lateral", largest=largest, channel=steering, bandwidth=band, moves=moves, **words)
        ratings.append(Excitation(name, "cornering stiffness, yaw inertia", verdict, figures, text))
        verdict = _rated(largest > 2.0 and varied, moves)
        text = statement("turning", **words)
        ratings.append(Excitation(name, "steering ratio, understeer gradient", verdict, figures, text))
    verdict = _rated(largest > 6.0, largest > 4.0)
    text = statement("friction", largest=largest)
    ratings.append(Excitation(name, "friction, tyre curve", verdict, {"lateral_acceleration": largest}, text))
    return ratings


def _longitudinal(name: str, grid: Grid, speed: Array) -> list[Excitation]:
    ratings = []
    pedals = {pedal: grid.channels[pedal] for pedal in ("throttle", "brake") if pedal in grid.channels}
    # In turns the tyres' side forces also slow the car, which would count as drag.
    straight = np.abs(grid.channels["yaw_rate"] * speed) < STRAIGHT if "yaw_rate" in grid.channels else speed > -1e9
    if len(pedals) == 2:
        coast = (pedals["throttle"] < 0.01) & (pedals["brake"] < 0.01) & (speed > 0.5) & straight
        duration = float(coast.sum()) * grid.step
        span = float(np.ptp(speed[coast])) if coast.any() else 0.0
        verdict = _rated(duration > 10.0 and span > 8.0, duration > 2.0 and span > 1.0)
        text = statement("coasting", duration=duration, span=span)
        ratings.append(
            Excitation(name, "drag, rolling resistance", verdict, {"coasting": duration, "span": span}, text)
        )
    for pedal, values in pedals.items():
        # Steps determine delay and lag, levels the gain.
        change = np.abs(np.diff(values)) > 0.1
        # A step over several rows counts once.
        jumps = int(np.sum(change & ~np.append(False, change[:-1])))
        levels = len(np.unique(np.round(values[(speed > 0.5) & (values > 0.02)], 1)))
        duration = float(np.sum((values > 0.02) & (speed > 0.5))) * grid.step
        verdict = _rated(jumps >= 2 and levels >= 3 and duration > 2.0, duration > 0.5)
        figures = {"duration": duration, "steps": float(jumps), "levels": float(levels)}
        text = statement("pedal", pedal=pedal, **figures)
        ratings.append(Excitation(name, f"{pedal} gain, lag, delay", verdict, figures, text))
    return ratings


def bandwidth(values: Array, step: float) -> float:
    """Return the frequency below which 80 % of the power of a signal's derivative lie [Hz], up to 10 Hz."""
    # The derivative emphasises fast motion; the window suppresses leakage of the jump between the ends of the log.
    rate = np.gradient(values - values.mean(), step)
    power = np.abs(np.fft.rfft(rate * np.hanning(len(rate)))) ** 2
    frequency = np.fft.rfftfreq(len(rate), step)
    power = power[frequency < 10.0]
    total = np.cumsum(power)
    return float(frequency[np.searchsorted(total, 0.8 * total[-1])]) if total[-1] > 0.0 else 0.0

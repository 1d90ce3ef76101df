"""What a drive offers for each group of parameters, by simple figures."""

import numpy as np

from mirdrake.identification.alignment import smooth
from mirdrake.identification.data import Array, Log
from mirdrake.identification.findings import Excitation, Verdict
from mirdrake.identification.plausibility import STEERING
from mirdrake.identification.relations import Grid, make_grid


def check_excitation(log: Log) -> list[Excitation]:
    """Figures and a verdict for each group of parameters that the channels of a log could give."""
    grid, found = make_grid(log), []
    forward = "vx" if "vx" in grid.channels else "speed"
    if forward not in grid.channels:
        return []
    speed = smooth(grid, forward)
    steering = next((name for name in STEERING if name in grid.channels), None)
    if "yaw_rate" in grid.channels:
        rate = smooth(grid, "yaw_rate")
        side = speed * rate if "lateral_acceleration" not in grid.channels else smooth(grid, "lateral_acceleration")
        found += _lateral(log.name, grid, speed, side, steering)
    found += _longitudinal(log.name, grid, speed)
    return found


def _rated(good: bool, weak: bool) -> Verdict:
    return "good" if good else "weak" if weak else "none"


def _lateral(name: str, grid: Grid, speed: Array, side: Array, steering: str | None) -> list[Excitation]:
    found = []
    most = float(np.percentile(np.abs(side), 99.5))
    turning = np.abs(side) > 0.3 * max(most, 0.3)
    spread = float(np.ptp(np.percentile(speed[turning], (5, 95)))) if turning.any() else 0.0
    mean = float(np.mean(speed[turning])) if turning.any() else 0.0
    varied = spread > 0.3 * max(mean, 1e-9)
    if steering is not None:
        band = bandwidth(grid.channels[steering], grid.step)
        text = (
            f"lateral acceleration to {most:.2g} m/s^2, {steering} to {band:.2g} Hz, turning at {mean:.3g} m/s "
            f"± {0.5 * spread:.2g}"
        )
        moves = most > 1.0
        figures = {"lateral_acceleration": most, "bandwidth": band, "speed": mean, "speed_spread": spread}
        verdict = _rated(most > 2.0 and band > 0.8 and varied, moves and band > 0.3)
        if moves and not varied:
            text += "; one speed only: front and rear stiffness will be strongly correlated, add another speed"
        if most <= 2.0:
            text += "; little lateral acceleration: noise will count"
        if moves and band <= 0.8:
            text += "; slow steering: add a step or a sweep to 2 Hz"
        found.append(Excitation(name, "cornering stiffness, yaw inertia", verdict, figures, text))
        text = f"turning at {mean:.3g} m/s ± {0.5 * spread:.2g}"
        if not varied:
            text += ": ratio and understeer gradient cannot be told apart at one speed"
        verdict = _rated(most > 2.0 and varied, moves)
        found.append(Excitation(name, "steering ratio, understeer gradient", verdict, figures, text))
    text = f"lateral acceleration to {most:.2g} m/s^2" + (": far from the limit of the tyres" if most < 4.0 else "")
    verdict = _rated(most > 6.0, most > 4.0)
    found.append(Excitation(name, "friction, tyre curve", verdict, {"lateral_acceleration": most}, text))
    return found


def _longitudinal(name: str, grid: Grid, speed: Array) -> list[Excitation]:
    found = []
    pedals = {pedal: grid.channels[pedal] for pedal in ("throttle", "brake") if pedal in grid.channels}
    straight = np.abs(grid.channels["yaw_rate"] * speed) < 0.5 if "yaw_rate" in grid.channels else speed > -1e9
    if len(pedals) == 2:
        coast = (pedals["throttle"] < 0.01) & (pedals["brake"] < 0.01) & (speed > 0.5) & straight
        lasts = float(coast.sum()) * grid.step
        span = float(np.ptp(speed[coast])) if coast.any() else 0.0
        text = f"{lasts:.3g} s of coasting over {span:.3g} m/s"
        if span < 8.0:
            text += "; a coast-down from a high speed is wanted"
        verdict = _rated(lasts > 10.0 and span > 8.0, lasts > 2.0 and span > 1.0)
        found.append(Excitation(name, "drag, rolling resistance", verdict, {"coasting": lasts, "span": span}, text))
    for pedal, values in pedals.items():
        change = np.abs(np.diff(values)) > 0.1
        jumps = int(np.sum(change & ~np.append(False, change[:-1])))
        levels = len(np.unique(np.round(values[(speed > 0.5) & (values > 0.02)], 1)))
        lasts = float(np.sum((values > 0.02) & (speed > 0.5))) * grid.step
        text = f"{lasts:.3g} s of {pedal}, {jumps} quick changes, {levels} levels"
        verdict = _rated(jumps >= 2 and levels >= 3 and lasts > 2.0, lasts > 0.5)
        figures = {"duration": lasts, "steps": float(jumps), "levels": float(levels)}
        found.append(Excitation(name, f"{pedal} gain, lag, delay", verdict, figures, text))
    return found


def bandwidth(values: Array, step: float) -> float:
    """The frequency below which 80 % of the power of a signal's derivative lie [Hz], up to 10 Hz."""
    rate = np.gradient(values - values.mean(), step)
    power = np.abs(np.fft.rfft(rate * np.hanning(len(rate)))) ** 2
    frequency = np.fft.rfftfreq(len(rate), step)
    power = power[frequency < 10.0]
    total = np.cumsum(power)
    return float(frequency[np.searchsorted(total, 0.8 * total[-1])]) if total[-1] > 0.0 else 0.0

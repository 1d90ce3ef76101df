"""Overlays and table of docs/validation.md: ``python -m tests.commonroad_figure docs/multibody.png``."""

import sys
import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

from mirdrake.vehicles import load_vehicle
from tests.commonroad_car import centre_of_sprung_mass, plant_trace, single_track_trace, write_car
from tests.commonroad_rig import (
    CARS,
    GRAVITY,
    MANOEUVRES,
    Reference,
    Trace,
    car,
    fits,
    manoeuvre,
    reference_trace,
)

TITLES = {"step": "step, 0.4 g", "sweep": "sine sweep, 0.2 to 2 Hz, 0.3 g", "ramp": "ramp to 0.5 g"}


def main(file: Path) -> None:
    """Run everything, write the figure, print the table."""
    figure, axes = plt.subplots(6, 3, figsize=(13.0, 13.0), layout="constrained", sharex="col")
    heads = ("wheel slip", "published", "as read", "reduced, wheel slip", "reduced, published")
    rows = ["| car | manoeuvre | " + " | ".join(heads) + " |", "|---" * 7 + "|"]
    for index, name in enumerate(CARS):
        p = car(name)
        for column, steering in enumerate(MANOEUVRES):
            steer = manoeuvre(steering, p.a + p.b)
            reference = {kind: reference_trace(name, steer, kind=kind) for kind in ("wheel_slip", "published")}
            ours = _ours(name, steering, "wheel_slip")
            reduced = single_track_trace(p, steer)
            pairs = [
                fits(reference["wheel_slip"], ours),
                fits(reference["published"], _ours(name, steering, "published")),
                fits(reference["published"], _ours(name, steering, "published", mapped=False)),
                fits(reference["wheel_slip"], reduced),
                fits(reference["published"], reduced),
            ]
            numbers = " | ".join(f"{yaw:.1f} / {side:.1f}" for yaw, side in pairs)
            rows.append(f"| {name} | {steering} | {numbers} |")
            curves = [
                (reference["published"], "package as published", {"color": "0.65", "lw": 1.0}),
                (reference["wheel_slip"], "package, slip at the wheels", {"color": "black", "lw": 2.0}),
                (reduced, "our single track", {"color": "tab:blue", "lw": 1.0, "ls": ":"}),
                (ours, "our full model", {"color": "tab:red", "lw": 1.0, "ls": "--"}),
            ]
            for trace, label, style in curves:
                axes[2 * index, column].plot(trace.time, trace.yaw_rate, label=label, **style)
                axes[2 * index + 1, column].plot(trace.time, trace.lateral_acceleration / GRAVITY, label=label, **style)
            if index == 0:
                axes[0, column].set_title(TITLES[steering])
        axes[2 * index, 0].set_ylabel(f"{name}\nyaw rate [rad/s]")
        axes[2 * index + 1, 0].set_ylabel(f"{name}\nlateral acceleration [g]")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.savefig(file, dpi=75)
    sys.stdout.write("\n".join(rows) + "\n")


def _ours(name: str, steering: str, kind: Reference, *, mapped: bool = True) -> Trace:
    p = car(name)
    with tempfile.TemporaryDirectory() as folder:
        vehicle = load_vehicle(str(write_car(Path(folder) / "car", p, kind=kind, mapped=mapped)))
        return plant_trace(vehicle, manoeuvre(steering, p.a + p.b), centre_of_sprung_mass(p))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

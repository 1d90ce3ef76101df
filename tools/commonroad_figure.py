"""Overlays and table of docs/validation.md: ``python -m tools.commonroad_figure docs/multibody.png``."""

import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

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

TITLES = {"step": "Step to 0.4 g", "sweep": "Sine sweep, 0.3 g, 0.2 to 2 Hz", "ramp": "Ramp to 0.5 g"}
HEADS = ("no jump", "slip only", "published", "as read", "reduced, no jump", "reduced, published")


class Case(NamedTuple):
    """Traces of a car in a manoeuvre: of the package in its three forms, of our full model in three, of our reduced."""

    published: Trace
    slip_only: Trace
    wheel_slip: Trace
    ours: Trace
    ours_published: Trace
    ours_as_read: Trace
    reduced: Trace

    def fits(self) -> tuple[tuple[float, float], ...]:
        """Return the fits of yaw rate and lateral acceleration [%], in the order of :data:`HEADS`."""
        return (
            fits(self.wheel_slip, self.ours),
            fits(self.slip_only, self.ours),
            fits(self.published, self.ours_published),
            fits(self.wheel_slip, self.ours_as_read),
            fits(self.wheel_slip, self.reduced),
            fits(self.published, self.reduced),
        )


def run(name: str, steering: str) -> Case:
    """Return all traces of a car in a manoeuvre."""
    p = car(name)
    steer = manoeuvre(steering, p.a + p.b)

    def package(kind: Reference) -> Trace:
        return reference_trace(name, steer, kind=kind)

    def ours(kind: Reference, *, mapped: bool = True) -> Trace:
        with tempfile.TemporaryDirectory() as folder:
            vehicle = load_vehicle(str(write_car(Path(folder) / "car", p, kind=kind, mapped=mapped)))
            return plant_trace(vehicle, steer, centre_of_sprung_mass(p))

    def reduced() -> Trace:
        with tempfile.TemporaryDirectory() as folder:
            return single_track_trace(load_vehicle(str(write_car(Path(folder) / "car", p))), steer)

    return Case(
        package("published"),
        package("slip_only"),
        package("wheel_slip"),
        ours("wheel_slip"),
        ours("published"),
        ours("wheel_slip", mapped=False),
        reduced(),
    )


def table(cases: dict[tuple[str, str], Case]) -> str:
    """Return all fits as a table in Markdown."""
    rows = ["| car | manoeuvre | " + " | ".join(HEADS) + " |", "|---" * (2 + len(HEADS)) + "|"]
    for (name, steering), case in cases.items():
        numbers = " | ".join(f"{yaw:.1f} / {side:.1f}" for yaw, side in case.fits())
        rows.append(f"| {name} | {steering} | {numbers} |")
    return "\n".join(rows) + "\n"


def draw(cases: dict[tuple[str, str], Case], file: Path) -> None:
    """The overlays, with the fits to the package with slip at the wheels in their corners."""
    figure, axes = plt.subplots(6, 3, figsize=(13.0, 14.0), layout="constrained", sharex="col")
    for (name, steering), case in cases.items():
        row, column = 2 * list(CARS).index(name), MANOEUVRES.index(steering)
        yaw, side = axes[row, column], axes[row + 1, column]
        curves = [
            (case.published, "package as published", {"color": "0.72", "lw": 1.2}),
            (case.wheel_slip, "package, slip at the wheels, no jump", {"color": "black", "lw": 2.4}),
            (case.reduced, "our single track", {"color": "tab:blue", "lw": 1.0, "ls": ":"}),
            (case.ours, "our full model", {"color": "tab:orange", "lw": 1.2, "ls": "--"}),
        ]
        for trace, label, style in curves:
            yaw.plot(trace.time, trace.yaw_rate, label=label, **style)
            side.plot(trace.time, trace.lateral_acceleration / GRAVITY, label=label, **style)
        for axis, number in zip((yaw, side), case.fits()[0], strict=True):
            _mark(axis, f"{number:.1f} %", low=steering != "sweep")
        if row == 0:
            yaw.set_title(TITLES[steering])
        if column == 0:
            yaw.set_ylabel(f"{name}\nyaw rate [rad/s]")
            side.set_ylabel(f"{name}\nlateral acc. [g]")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
        axis.margins(x=0.01)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.align_ylabels(axes[:, 0])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.savefig(file, dpi=80)
    plt.close(figure)


def _mark(axis: Axes, text: str, *, low: bool) -> None:
    """The fit, where the curves leave room."""
    if not low:
        axis.margins(y=0.28)
    axis.text(
        0.97,
        0.08 if low else 0.93,
        f"fit {text}",
        transform=axis.transAxes,
        ha="right",
        va="bottom" if low else "top",
        color="tab:orange",
        fontweight="bold",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )


def main(file: Path) -> None:
    """Run everything, write the figure, print the table."""
    cases = {(name, steering): run(name, steering) for name in CARS for steering in MANOEUVRES}
    draw(cases, file)
    sys.stdout.write(table(cases))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Figure of docs/tyres.md: ``python -m tools.tyre_figure docs/tyres.png``."""

import sys
from math import degrees, radians, tan
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
from matplotlib import pyplot as plt

from mirdrake.core.paths import data_root
from mirdrake.tyres.magic_formula import magic_formula
from mirdrake.tyres.tir import read_tir

TYRE = "215_50R17.tir"
LOADS = (2000.0, 4000.0, 6000.0)
"""[N]"""

SLIPPERY = 0.5
"""Friction of the other road relative to dry asphalt."""

SPEED = 16.67
"""[m/s]"""


def main(file: Path) -> None:
    """Draw the longitudinal and the lateral force over slip, and the combined force limit."""
    tyre = read_tir(data_root() / "models" / "tyres" / TYRE).parameters
    figure, (along, across, both) = plt.subplots(
        1, 3, figsize=(12.0, 4.0), layout="constrained", width_ratios=(1.0, 1.0, 1.35)
    )
    slips, angles = np.linspace(-0.6, 0.6, 241), np.linspace(-0.35, 0.35, 241)

    def force(kappa: float, alpha: float, load: float, friction: float = 1.0) -> tuple[float, float]:
        forces = magic_formula(tyre, kappa, tan(alpha), load, vx=SPEED, friction=friction)
        return float(forces.fx) / 1e3, float(forces.fy) / 1e3

    cases = [(load, 1.0, "-") for load in LOADS] + [(LOADS[1], SLIPPERY, "--")]
    colours = ("tab:green", "tab:blue", "tab:red", "tab:blue")
    for (load, friction, line), colour in zip(cases, colours, strict=True):
        label = f"{load / 1e3:g} kN" + (f", friction x {friction:g}" if friction != 1.0 else "")
        style: dict[str, Any] = {"color": colour, "ls": line, "label": label}
        along.plot(slips, [force(kappa, 0.0, load, friction)[0] for kappa in slips], **style)
        across.plot(np.degrees(angles), [force(0.0, alpha, load, friction)[1] for alpha in angles], **style)

    # Longitudinal slip from locked to spinning at some slip angles; on the right road and on the slippery one.
    sweep = np.concatenate([-np.geomspace(1.0, 1e-3, 120), np.geomspace(1e-3, 1.0, 120)])
    shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, 5))
    for alpha, shade in zip((1.0, 2.0, 4.0, 8.0, 16.0), shades, strict=True):
        for sign in (1.0, -1.0):
            points = [force(kappa, sign * radians(alpha), LOADS[1]) for kappa in sweep]
            name = f"α = {alpha:g}°" if sign > 0 else None
            both.plot([p[0] for p in points], [p[1] for p in points], color=shade, lw=1.1, label=name)
    round_trip = np.linspace(0.0, 2.0 * np.pi, 200)
    for friction, line in ((1.0, "-"), (SLIPPERY, "--")):
        most_x = max(force(kappa, 0.0, LOADS[1], friction)[0] for kappa in slips)
        most_y = max(force(0.0, alpha, LOADS[1], friction)[1] for alpha in angles)
        style = {"color": "black", "lw": 1.0, "ls": line}
        label = "ellipse" if friction == 1.0 else f"friction x {friction:g}"
        both.plot(most_x * np.cos(round_trip), most_y * np.sin(round_trip), label=label, **style)

    along.set(xlabel="longitudinal slip κ [-]", ylabel="Fx [kN]", title="α = 0")
    across.set(xlabel="slip angle α [°]", ylabel="Fy [kN]", title="κ = 0", xlim=(-degrees(0.35), degrees(0.35)))
    both.set(xlabel="Fx [kN]", ylabel="Fy [kN]", title="4 kN, κ from -1 to 1", aspect="equal")
    for axis in (along, across, both):
        axis.grid(alpha=0.3)
    along.legend(loc="lower right", fontsize=8)
    both.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    figure.savefig(file, dpi=85)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Uncertainty of friction by the tyre law: how far another law would explain the same forces by another friction.

Below the limit a filter knows the friction by the softening of the tyres only: with the linear lateral force x = C σ
and the limit P = μ N, the force over x is s(x / P), a function of the law. Another law with s' explains the same force
with the limit P' at s'(x / P') = s(x / P). The difference d = ln (P' / P) is large at small slips, where laws soften by
different powers of it, and vanishes at the limit. An estimate of the variance σ² has the share 1 - σ² / σ0² from the
measurements, and the rest from its prior σ0², so that another law would move it by (1 - σ² / σ0²) d.
"""

from collections.abc import Mapping
from functools import cache
from math import log

import numpy as np
import scipy  # it imports its parts when they are first used

from mirdrake.batched.arrays import Floats
from mirdrake.single_track.dynamics import LateralForce, lateral_forces
from mirdrake.single_track.parameters import SingleTrackParameters

AXLES = {"friction": ("front", "rear"), "front_friction": ("front",), "rear_friction": ("rear",)}
"""Axles whose tyres determine each friction that a filter can estimate."""

_GRID = np.geomspace(0.02, 5.0, 60)
"""Uses x / P at which laws are compared; beyond the last one all tyres slide."""

_SHAPE, _CURVATURE = 1.193, -1.003
"""Lateral shape p_Cy1 and curvature p_Ey1 of the Magic Formula if it is the other law: of a car tyre 205/60R15 91V at
2.2 bar (H. B. Pacejka, Tyre and Vehicle Dynamics, 2nd ed. (2006), table A3.1; the 3rd edition has other parameters)."""

_LARGEST = 100.0  # use at which every law has softened more than at the last one of the grid


def friction_difference(tyres: str, use: Floats, parameters: SingleTrackParameters) -> Floats:
    """Return the largest difference d between a tyre law and the others, at uses x / P of the tyres.

    Args:
        tyres: law of the filter.
        use: linear lateral force over the limit.
        parameters: of the filter; the front axle has the shape of its law.
    """
    table = _table(tyres, parameters.front_shape, parameters.front_curvature)
    values: Floats = np.interp(use, _GRID, table)
    return values


@cache
def _table(tyres: str, shape: float, curvature: float) -> Floats:
    laws = {name: law for name, law in lateral_forces().items() if name != "linear"}
    own = laws.pop(tyres, None)
    if own is None:  # linear tyres have no limit
        return np.zeros(len(_GRID))
    differences = []
    for use in _GRID.tolist():
        softening = _softening(use, own, shape, curvature, 0.0)
        others = [
            scipy.optimize.brentq(_softening, 1e-9, _LARGEST, args=(law, _SHAPE, _CURVATURE, softening))
            for law in laws.values()
        ]
        differences.append(max(abs(log(other / use)) for other in others))
    return np.array(differences)


def _softening(use: float, law: LateralForce, shape: float, curvature: float, less: float) -> float:
    """Return force over linear force, minus `less`."""
    return -float(law(use, 1.0, 1.0, shape, curvature)) / use - less


def uses_of(names: tuple[str, ...], means: Floats, parameters: SingleTrackParameters) -> Mapping[str, Floats]:
    """Return the use x / P of the tyres of each axle over time, from the estimates of a filter (t, names)."""
    column = {name: means[:, k] for k, name in enumerate(names)}
    p = parameters
    uses = {}
    for axle, share, arm in (("front", p.rear_length, p.front_length), ("rear", p.front_length, -p.rear_length)):
        slip = column.get(f"{axle}_slip")
        if slip is None:
            slip = (column["vy"] + arm * column["yaw_rate"]) / np.maximum(np.abs(column["vx"]), p.blend_start)
            slip = slip - column["steering"] if axle == "front" else slip
        factors = {}
        for quantity in ("stiffness", "friction"):
            element = column.get(f"{axle}_{quantity}", column.get(quantity))
            factors[quantity] = getattr(p, f"{axle}_{quantity}") * (1.0 if element is None else np.exp(element))
        load = -p.mass * p.gravity_z * share / p.wheelbase
        uses[axle] = factors["stiffness"] * np.abs(slip) / (factors["friction"] * load)
    return uses

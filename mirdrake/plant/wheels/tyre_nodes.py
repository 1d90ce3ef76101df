"""Curves of tyres at their loads, between nodes of load and inclination, in Python or compiled.

Loads change in every step, and a law in Python takes longer than the step. A law is therefore evaluated at nodes
only, when a wheel first comes near them: loads in the ratio exp(:data:`LOAD_STEP`), inclinations in steps of
:data:`INCLINATION_STEP`, the friction of each ground. Between nodes the numbers of a curve and its contact are
bilinear, so forces are continuous; the error is of second order in the steps.
"""

from collections.abc import Sequence
from math import ceil, exp, isfinite, log
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mirdrake.core.compiled import Records, plain, record_type
from mirdrake.tyres import SteadyLaw, TyreLaw
from mirdrake.tyres.relaxation import Contact

LOAD_STEP = 0.05
"""Logarithm of the ratio of neighbouring loads [1]."""

INCLINATION_STEP = 0.01
"""Distance of neighbouring inclinations [rad]."""

LEAST_LOAD = 1e-3
"""Smallest load of a curve over the smallest static load [1]; a tyre has no slip forces below."""

_LARGEST_LOAD = 30.0  # over the largest static load [1]; larger forces are proportional to the load
_LARGEST_INCLINATION = 0.3  # [rad]; the curve does not change beyond
_TABLES = 8  # pairs of a law and a friction that are kept

Numbers = npt.NDArray[np.float64]


class TyreNodes(NamedTuple):
    """Nodes of the curves of the tyres of a vehicle.

    Attributes:
        rows: numbers of the curves; zeros where not evaluated (tables, loads, inclinations, numbers).
        lowest: load of the first node [N].
        highest: load of the last node [N].
        tables: table of each wheel.
        frictions: friction of the ground in this table, relative to dry asphalt [1].
        tyres: numbers of the present curve of each wheel (wheels, numbers), overwritten.
        wanted: load and inclination of each wheel (wheels, 2) [N, rad], overwritten.
    """

    rows: Numbers
    lowest: float
    highest: float
    tables: npt.NDArray[np.int64]
    frictions: Numbers
    tyres: Numbers
    wanted: Numbers


def node_place(load: float, inclination: float, lowest: float, loads: int, inclinations: int) -> tuple[int, float, int]:
    """Return the node of next lower load and inclination.

    Args:
        load: load [N], at least `lowest`.
        inclination: inclination [rad].
        lowest: load of the first node [N].
        loads: number of loads.
        inclinations: number of inclinations.

    Returns:
        Index of the load; weight of the next load [1]; index of the inclination.
    """
    # Comparisons with NaN are false: its place is the first one.
    k = log(load / lowest) / LOAD_STEP
    k = min(k, loads - 2.0) if k > 0.0 else 0.0
    row = int(k)
    j = inclination / INCLINATION_STEP + 0.5 * (inclinations - 1)
    j = min(j, inclinations - 2.0) if j > 0.0 else 0.0
    return row, (load / lowest * exp(-LOAD_STEP * row) - 1.0) / (exp(LOAD_STEP) - 1.0), int(j)


def find_tyre(nodes: TyreNodes, wheel: int, load: float, inclination: float, friction: float) -> bool:
    """Interpolate the curve of a wheel.

    Args:
        nodes: the nodes; `tyres` and `wanted` are overwritten.
        wheel: number of the wheel.
        load: load from `lowest` to `highest` [N].
        inclination: inclination [rad].
        friction: friction of the ground, relative to dry asphalt [1].

    Returns:
        Whether all nodes around are known.
    """
    nodes.wanted[wheel, 0], nodes.wanted[wheel, 1] = load, inclination
    if nodes.frictions[wheel] != friction:
        return False
    table = nodes.rows[nodes.tables[wheel]]
    loads, inclinations, numbers = table.shape
    k, a, j = node_place(load, inclination, nodes.lowest, loads, inclinations)
    b = min(max(inclination / INCLINATION_STEP + 0.5 * (inclinations - 1) - j, 0.0), 1.0)
    if table[k, j, 0] * table[k + 1, j, 0] * table[k, j + 1, 0] * table[k + 1, j + 1, 0] == 0.0:
        return False
    w00, w10, w01, w11 = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    for m in range(numbers):
        nodes.tyres[wheel, m] = (
            w00 * table[k, j, m] + w10 * table[k + 1, j, m] + w01 * table[k, j + 1, m] + w11 * table[k + 1, j + 1, m]
        )
    return True


NODE_PARTS = (node_place, find_tyre)
"""Functions that :mod:`mirdrake.core.compiled` compiles for a step."""


class TyreCurves:
    """Curves of the tyres of a vehicle between nodes.

    Args:
        law: law in steady state.
        laws: tyre law of each wheel.
        static_loads: load of each wheel at rest [N].

    Attributes:
        curves: present curve of each wheel: contact and curve.
        nodes: the nodes around.
        arguments: arguments of a step: curves and nodes.

    Raises:
        TypeError: a number of the curves is not a float.
    """

    def __init__(self, law: SteadyLaw, laws: Sequence[TyreLaw], static_loads: Sequence[float]) -> None:
        self._laws = laws
        kind = np.dtype(
            [("known", float), ("contact", record_type(Contact)), ("curve", record_type(law.curve))], align=True
        )
        if not _all_floats(kind):
            raise TypeError(f"{law.curve.__name__}: every field must be a float, as curves are interpolated")
        self.curves: Records = np.zeros(len(laws), kind)
        lowest = LEAST_LOAD * min(static_loads)
        loads = ceil(log(_LARGEST_LOAD * max(static_loads) / lowest) / LOAD_STEP) + 1
        inclinations = 2 * ceil(_LARGEST_INCLINATION / INCLINATION_STEP) + 1
        tyres = self.curves.view(float).reshape(len(laws), -1)
        self.nodes = TyreNodes(
            # Memory of zeros is not occupied before it is written.
            np.zeros((_TABLES, loads, inclinations, tyres.shape[1])),
            lowest,
            lowest * exp(LOAD_STEP * (loads - 1)),
            np.zeros(len(laws), int),
            np.full(len(laws), np.nan),
            tyres,
            np.zeros((len(laws), 2)),
        )
        self.arguments: tuple[Any, ...] = (self.curves, self.nodes)
        self._tables: dict[tuple[int, float], int] = {}

    def make(self, frictions: Sequence[float]) -> None:
        """Evaluate the laws at the nodes that the wheels want and do not have.

        Args:
            frictions: friction of the ground under each wheel, relative to dry asphalt [1].
        """
        nodes = self.nodes
        _, loads, inclinations, _ = nodes.rows.shape
        for wheel, (law, friction) in enumerate(zip(self._laws, frictions, strict=True)):
            load, inclination = nodes.wanted[wheel].tolist()
            if load == 0.0 or not (isfinite(load) and isfinite(inclination) and isfinite(friction)):
                continue  # no step yet, or a diverged one
            if nodes.frictions[wheel] != friction:
                nodes.tables[wheel], nodes.frictions[wheel] = self._table(law, friction), friction
            table = nodes.rows[nodes.tables[wheel]]
            k, _, j = node_place(load, inclination, nodes.lowest, loads, inclinations)
            for row in (k, k + 1):
                for column in (j, j + 1):
                    if table[row, column, 0] == 0.0:
                        at = nodes.lowest * exp(LOAD_STEP * row), (column - inclinations // 2) * INCLINATION_STEP
                        tyre = law(*at, friction)
                        table[row, column] = _flat((1.0, plain(tyre.contact), plain(tyre.curve)))

    def _table(self, law: TyreLaw, friction: float) -> int:
        """Return the table of a law on a ground; the oldest one that no wheel uses is forgotten for it."""
        key, nodes = (id(law), friction), self.nodes
        if key not in self._tables:
            used = set(nodes.tables[np.isfinite(nodes.frictions)].tolist())
            free = [number for number in range(len(nodes.rows)) if number not in self._tables.values()]
            if not free:
                oldest = next(old for old, number in self._tables.items() if number not in used)
                free = [self._tables.pop(oldest)]
                nodes.rows[free[0], :, :, 0] = 0.0
            self._tables[key] = free[0]
        return self._tables[key]


def _all_floats(kind: np.dtype[np.void]) -> bool:
    return all(
        _all_floats(field[0]) if field[0].names else field[0].base.char == "d" for field in (kind.fields or {}).values()
    )


def _flat(values: Any) -> list[float]:
    return [number for value in values for number in (_flat(value) if isinstance(value, tuple) else (float(value),))]

"""Curves of tyres between nodes: against the laws themselves, and what a drive does at the limits of the nodes."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from mirdrake.core.paths import data_root
from mirdrake.plant.wheels.tyre_nodes import INCLINATION_STEP, LOAD_STEP, TyreCurves, find_tyre
from mirdrake.tyres import SteadyLaw, TyreAtLoad, TyreLaw
from mirdrake.tyres.magic_formula import magic_formula
from mirdrake.tyres.magic_formula_tyres import MagicFormulaTyres, make_law
from mirdrake.tyres.relaxation import Contact
from mirdrake.tyres.tir import read_tir

TYRE = read_tir(data_root() / "models" / "tyres" / "215_50R17.tir").parameters
STATIC = [4400.0, 4400.0, 3600.0, 3600.0]


def tyre_at(curves: TyreCurves, wheel: int, load: float, inclination: float, friction: float) -> TyreAtLoad:
    """Return the tyre of a wheel, with its nodes made where they are missing."""
    if not find_tyre(curves.nodes, wheel, load, inclination, friction):
        curves.make([friction] * 4)
        assert find_tyre(curves.nodes, wheel, load, inclination, friction)
    record = curves.curves[wheel]
    return TyreAtLoad(Contact(*record["contact"]), _dotted(record["curve"]), MagicFormulaTyres.law)


class _Fields:
    def __init__(self, record: Any) -> None:
        for name in record.dtype.names:
            setattr(self, name, _dotted(record[name]))


def _dotted(record: Any) -> Any:
    return _Fields(record) if getattr(record.dtype, "names", None) else float(record)


def magic_curves() -> TyreCurves:
    law = make_law(TYRE)
    return TyreCurves(MagicFormulaTyres.law, [law] * 4, STATIC)


def test_forces_between_nodes_are_those_of_the_magic_formula() -> None:
    """Fx, Fy and the moments within 0.1 % of the load and of what it has as a moment at 0.1 m."""
    curves, random = magic_curves(), np.random.default_rng(2)
    for _ in range(300):
        load, inclination = random.uniform(300.0, 9500.0), random.uniform(-0.12, 0.12)
        kappa, slip, friction = random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3), random.choice([1.0, 0.4])
        tyre = tyre_at(curves, int(random.integers(4)), load, inclination, friction)
        exact = magic_formula(TYRE, kappa, slip, load, vx=20.0, gamma=inclination, friction=friction)
        fx, fy, mz = tyre.forces(kappa, slip, 20.0)
        assert (fx, fy) == pytest.approx((exact.fx, exact.fy), abs=1e-3 * load)
        assert mz == pytest.approx(exact.mz, abs=1e-4 * load)
        moment = tyre.contact.overturning + tyre.contact.overturning_by_fy * fy
        assert moment == pytest.approx(exact.mx, abs=1e-4 * load)


@pytest.mark.parametrize("step", [(1e-6, 0.0), (0.0, 1e-9)], ids=["load", "inclination"])
def test_forces_are_continuous_over_a_node(step: tuple[float, float]) -> None:
    curves = magic_curves()
    load = curves.nodes.lowest * math.exp(LOAD_STEP * round(math.log(4000.0 / curves.nodes.lowest) / LOAD_STEP))
    forces = [
        tyre_at(curves, 0, load + sign * step[0], 2.0 * INCLINATION_STEP + sign * step[1], 1.0).forces(0.01, 0.03, 20.0)
        for sign in (-1.0, 1.0)
    ]
    assert forces[0] == pytest.approx(forces[1], rel=1e-6)


def test_beyond_the_last_nodes_the_curve_does_not_change() -> None:
    curves = magic_curves()
    steep, over = (tyre_at(curves, 0, 4000.0, angle, 1.0).forces(0.0, 0.05, 20.0) for angle in (0.3, 1.2))
    assert steep == pytest.approx(over, rel=1e-12)
    assert curves.nodes.highest > 30.0 * max(STATIC)


def test_nodes_of_a_ground_are_evaluated_once_until_there_are_too_many_grounds() -> None:
    calls: list[float] = []
    law = make_law(TYRE)

    def counting(load: float, inclination: float, friction: float) -> TyreAtLoad:
        calls.append(friction)
        return law(load, inclination, friction)

    curves = TyreCurves(MagicFormulaTyres.law, [counting] * 4, STATIC)
    for friction in (1.0, 0.5, 1.0, 0.5):
        for wheel in range(4):
            tyre_at(curves, wheel, 4000.0, 0.001, friction)
    assert calls == [1.0] * 4 + [0.5] * 4
    # Wheel 1 passes over many other grounds.
    for friction in 0.6 + 0.01 * np.arange(20):
        assert not find_tyre(curves.nodes, 1, 4000.0, 0.001, friction)
        curves.make([0.5, friction, 0.5, 0.5])
        assert find_tyre(curves.nodes, 1, 4000.0, 0.001, friction)
        assert find_tyre(curves.nodes, 0, 4000.0, 0.001, 0.5)
    assert len(calls) == 8 + 20 * 4


def test_numbers_that_are_not_finite_have_no_curve() -> None:
    curves = magic_curves()
    assert not find_tyre(curves.nodes, 0, math.nan, 0.0, 1.0)
    curves.make([1.0] * 4)
    assert not find_tyre(curves.nodes, 0, math.nan, 0.0, 1.0)


class _Flagged(NamedTuple):
    limit: float
    sticks: bool


def test_a_law_whose_curve_is_not_of_floats_is_an_error() -> None:
    law: TyreLaw = make_law(TYRE)
    with pytest.raises(TypeError, match="_Flagged: every field must be a float"):
        TyreCurves(SteadyLaw(_Flagged, lambda *_: (0.0, 0.0, 0.0)), [law] * 4, STATIC)

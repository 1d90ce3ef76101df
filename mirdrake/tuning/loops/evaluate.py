"""Evaluation of gains in any process; a test bench is built once per process and loop, and kept."""

import json
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mirdrake.core.errors import ConfigError, one_line
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Fidelity, LoopSpec
from mirdrake.tuning.loops.bench import PlantBench
from mirdrake.tuning.loops.kind import Bench
from mirdrake.tuning.loops.reduced import OpenLoop, find_loop_margins, open_loops, run_reduced
from mirdrake.tuning.loops.registry import LOOP_KINDS
from mirdrake.tuning.loops.signals import SignalBench
from mirdrake.tuning.spec import breaks_limit

KEPT = 3
"""Test benches that a thread keeps."""


class _Benches(threading.local):
    def __init__(self) -> None:
        self.by_key: OrderedDict[str, Bench] = OrderedDict()


_benches = _Benches()


def _key(spec: LoopSpec) -> str:
    """Return what a bench is built from; loops that differ in course or model share it."""
    return json.dumps([spec.kind, spec.diagram, spec.reference, spec.output, spec.effort], sort_keys=True)


def bench_of(spec: LoopSpec) -> Bench:
    """Return the bench of a loop; it is built unless this thread has it."""
    key = _key(spec)
    bench = _benches.by_key.pop(key, None)
    if bench is None:
        # Least recently used: a bench that is used is put back at the end.
        while len(_benches.by_key) >= KEPT:
            _benches.by_key.popitem(last=False)
        bench = LOOP_KINDS[spec.kind].make_bench(spec)
    # Loops that share a bench differ in course and model, so the present one is set each time.
    bench.spec = spec
    _benches.by_key[key] = bench
    return bench


def plant_bench(spec: LoopSpec) -> PlantBench:
    """Return the bench of a loop of a vehicle.

    Raises:
        ConfigError: it is a loop of signals.
    """
    bench = bench_of(spec)
    if not isinstance(bench, PlantBench):
        raise ConfigError(f"a loop of kind '{spec.kind}' has no bench of the plant")
    return bench


def loops_of(spec: LoopSpec, gains: Mapping[str, float]) -> list[OpenLoop]:
    """Return the open loops with gains: of the model, or of the linear diagram of a loop of signals."""
    if spec.model is not None:
        return open_loops(spec, gains)
    bench = bench_of(spec)
    return bench.open_loops(gains) if isinstance(bench, SignalBench) else []


def forget_bench(spec: LoopSpec) -> None:
    """Discard the bench of a loop, whose state is not known after an error."""
    _benches.by_key.pop(_key(spec), None)


@dataclass(frozen=True)
class LoopEvaluator:
    """Tests gains on a loop; see :class:`mirdrake.tuning.loops.base.Evaluator`. Can be pickled.

    Without gains, the controllers that the vehicle has now are tested.

    Attributes:
        spec: the loop.
        keep: whether evaluations keep their responses.
        margins: limits of margins by name. Gains that break one of them on the model, which no test can change, are
            evaluated on the reduced model, to save the time of the plant.
    """

    spec: LoopSpec
    keep: bool = False
    margins: dict[str, float] = field(default_factory=dict)

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Test gains; every failure is an evaluation."""
        try:
            # Unstable gains overflow; their NaN is judged, so NumPy's warnings have no value.
            with np.errstate(all="ignore"):
                result = self._evaluate(gains, conditions, fidelity)
        except Exception as error:
            forget_bench(self.spec)
            result = Evaluation("failed", reason=one_line(error))
        return result if self.keep else replace(result, response=None)

    def _evaluate(self, gains: Mapping[str, float], conditions: Conditions, fidelity: Fidelity) -> Evaluation:
        if not all(np.isfinite(value) for value in gains.values()):
            return Evaluation("unstable", reason="a gain is not finite")
        spec = self.spec
        # The test with another step is the same loop on the same bench.
        if conditions.step != 1.0:
            spec = replace(spec, course=replace(spec.course, step=conditions.step * spec.course.step))
        if fidelity == "reduced":
            return run_reduced(spec, gains, conditions, keep=self.keep)
        # No gains: the controllers of the vehicle, which may be of another kind than those that are tuned.
        if not gains and spec.test_control:
            margins = find_loop_margins(spec, spec.present)
            return bench_of(spec.as_present() if spec.gains else spec).run({}, conditions, margins=margins)
        margins = find_loop_margins(spec, gains)
        # Margins follow from the model alone, so a broken limit needs no run of the plant, if there is a reduced model.
        broken = any(breaks_limit(name, margins[name], limit) for name, limit in self.margins.items())
        if broken and spec.model is not None and spec.has_pid_gains:
            return run_reduced(spec, gains, conditions, keep=self.keep)
        return bench_of(spec).run(gains, conditions, margins=margins)

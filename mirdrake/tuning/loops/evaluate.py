"""Trials of gains, in whatever process: a bench is built once a process and loop, and kept."""

import json
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from mirdrake.core.errors import MirdrakeError
from mirdrake.execution.job import one_line
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Fidelity, LoopSpec
from mirdrake.tuning.loops.bench import PlantBench
from mirdrake.tuning.loops.reduced import find_loop_margins, run_reduced
from mirdrake.tuning.spec import AT_LEAST

KEPT = 3
"""Benches that a process keeps."""


class _Here(threading.local):
    def __init__(self) -> None:
        self.benches: OrderedDict[str, Any] = OrderedDict()


_here = _Here()


def bench_of(spec: LoopSpec) -> Any:
    """The bench of a loop, built unless this thread has it."""
    key = json.dumps([spec.kind, spec.diagram, spec.options.get("signals")], sort_keys=True)
    bench = _here.benches.pop(key, None)
    if bench is None:
        while len(_here.benches) >= KEPT:
            _here.benches.popitem(last=False)
        if spec.kind in ("diagram", "path"):
            from mirdrake.tuning.loops.signals import SignalBench

            bench = SignalBench(spec)
        else:
            bench = PlantBench(spec)
    bench.spec = spec
    _here.benches[key] = bench
    return bench


def forget_bench(spec: LoopSpec) -> None:
    """Drop the bench of a loop, which may be in any state."""
    key = json.dumps([spec.kind, spec.diagram, spec.options.get("signals")], sort_keys=True)
    _here.benches.pop(key, None)


def _breaks(name: str, value: float, limit: float) -> bool:
    return not (value >= limit if name in AT_LEAST else value <= limit)


@dataclass(frozen=True)
class LoopEvaluator:
    """Tries gains on a loop; see :class:`mirdrake.tuning.loops.base.Evaluator`. Can be pickled.

    Attributes:
        spec: the loop.
        keep: whether evaluations keep their responses.
        margins: limits of margins by name. The plant is not troubled with gains that break one on the model, which no
            run can mend: they are answered by the reduced model.
    """

    spec: LoopSpec
    keep: bool = False
    margins: dict[str, float] = field(default_factory=dict)

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Try gains; whatever happens is the answer."""
        try:
            with np.errstate(all="ignore"):
                if not all(np.isfinite(value) for value in gains.values()):
                    found = Evaluation("unstable", reason="a gain is not finite")
                elif fidelity == "reduced":
                    found = run_reduced(self.spec, gains, conditions)
                else:
                    margins = find_loop_margins(self.spec, gains)
                    if any(_breaks(name, margins[name], limit) for name, limit in self.margins.items()):
                        found = run_reduced(self.spec, gains, conditions)
                    else:
                        found = bench_of(self.spec).run(gains, conditions, margins=margins)
        except MirdrakeError as error:
            forget_bench(self.spec)
            found = Evaluation("failed", reason=str(error).splitlines()[0])
        except Exception as error:
            forget_bench(self.spec)
            found = Evaluation("failed", reason=one_line(error))
        return found if self.keep else replace(found, response=None)

    def digest(self) -> dict[str, Any]:
        """What decides on the outcome, as plain data."""
        return asdict(self.spec)

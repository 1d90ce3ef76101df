"""What can be wrong with a study, found before anything is driven, with file and line."""

import math
from collections.abc import Iterable

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.make import baseline_gains
from mirdrake.tuning.spec import AT_LEAST, FIGURES, TuningSpec


def check_study(spec: TuningSpec, loop: LoopSpec) -> None:
    """Refuse what there is not, or makes no sense for this loop.

    Args:
        spec: the study.
        loop: its loop, from :func:`mirdrake.tuning.loops.make.make_loop_spec`.

    Raises:
        ConfigError: the first fault, with file and line.
    """
    _check_gains(spec, loop)
    _check_cost(spec)
    _check_times(spec)
    if spec.schedule is not None and loop.kind in ("path", "diagram"):
        raise ConfigError(f"{where(spec, 'schedule')}: gains of this loop stand in no control.yaml; leave it out")


def _check_gains(spec: TuningSpec, loop: LoopSpec) -> None:
    _known(spec, ("search", "ranges"), spec.search.ranges, loop.gains, "gain")
    if isinstance(spec.baseline, dict):
        _known(spec, ("baseline",), spec.baseline, loop.gains, "gain")
    baseline_gains(spec, loop)
    if loop.kind == "diagram":
        for gain in loop.gains:
            if gain not in spec.search.ranges:
                place = where(spec, "search", "ranges")
                raise ConfigError(f"{place}: no rule gives a value of {gain}; write a range for it")


def _check_cost(spec: TuningSpec) -> None:
    _known(spec, ("cost",), spec.cost, FIGURES, "figure")
    _known(spec, ("constraints",), spec.constraints, FIGURES, "figure")
    for name, weight in spec.cost.items():
        if not (math.isfinite(weight) and weight >= 0.0):
            raise ConfigError(f"{where(spec, 'cost', name)}: {weight:g} is not allowed; a weight is 0 or more")
        if name in AT_LEAST:
            place = where(spec, "cost", name)
            raise ConfigError(f"{place}: more of it is better; make it a constraint, or take ms or mt")
    if not any(spec.cost.values()):
        raise ConfigError(f"{where(spec, 'cost')}: no figure has a weight; give one, for example {{iae: 1}}")


def _check_times(spec: TuningSpec) -> None:
    test = spec.test
    if test.step == 0.0:
        raise ConfigError(f"{where(spec, 'test', 'step')}: 0 is not allowed; without a step there is nothing to judge")
    if not test.step_time < test.duration:
        raise ConfigError(
            f"{where(spec, 'test', 'step_time')}: {test.step_time:g} s is not before the end ({test.duration:g} s)"
        )
    load_time = test.load_time
    if load_time is not None and not test.step_time < load_time < test.duration:
        raise ConfigError(
            f"{where(spec, 'test', 'load_time')}: {load_time:g} s is not between the step ({test.step_time:g} s) and "
            f"the end ({test.duration:g} s)"
        )


def _known(spec: TuningSpec, path: tuple[str, ...], given: Iterable[str], known: Iterable[str], what: str) -> None:
    for name in given:
        if name not in known:
            raise ConfigError(f"{where(spec, *path, name)}: no {what} '{name}'; {did_you_mean(name, known)}")

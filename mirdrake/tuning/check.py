"""Checks of a study before any test, with file and line; gains of the baseline."""

import math
from collections.abc import Iterable
from pathlib import Path

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.user_modules import skipped_modules
from mirdrake.core.yaml_io import where
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.spec import AT_LEAST, FIGURES, PUBLISHED, TuningSpec, load_tuning


def load_checked(path: Path | str, *, overrides: Iterable[str] = ()) -> TuningSpec:
    """Load a tuning file and check it with its loop, vehicle and world, as before any test.

    A loop whose user modules are skipped is not checked; see :func:`mirdrake.core.user_modules.without_user_code`.

    Raises:
        ConfigError, ModelError, WorldError: the study, its vehicle or its world has faults.
    """
    spec = load_tuning(path, overrides=overrides)
    _check_cost(spec)
    skipped = len(skipped_modules())
    try:
        loop = make_loop_spec(spec)
    except ConfigError:
        if len(skipped_modules()) > skipped:
            return spec
        raise
    check_study(spec, loop)
    return spec


def check_study(spec: TuningSpec, loop: LoopSpec) -> None:
    """Reject unknown names and values that are not valid for a loop.

    Args:
        spec: the study.
        loop: its loop, from :func:`mirdrake.tuning.loops.registry.make_loop_spec`.

    Raises:
        ConfigError: the first fault, with file and line.
    """
    _check_gains(spec, loop)
    _check_cost(spec)
    _check_times(spec, loop.course.duration)
    if spec.schedule is not None and not LOOP_KINDS[loop.kind].in_control_yaml:
        raise ConfigError(
            f"{where(spec, 'schedule')}: the gains of this loop are not in control.yaml; remove the schedule"
        )


def baseline_gains(spec: TuningSpec, loop: LoopSpec) -> dict[str, float]:
    """Return the gains to compare with; empty for the controllers that the vehicle has now.

    Missing ones are zero, or for a loop of signals those of the diagram.

    Raises:
        ConfigError: a gain of a loop of signals whose present value is not known.
    """
    # Empty gains mean the controllers as they are, whose kind need not have these gains.
    if LOOP_KINDS[loop.kind].in_control_yaml:
        if spec.baseline == "present":
            return {}
        given = PUBLISHED if spec.baseline == "published" else spec.baseline
        return {name: float(given.get(name, 0.0)) for name in loop.gains}
    # A diagram has no published gains: present values, overridden by those of the study.
    present = loop.present | (spec.baseline if isinstance(spec.baseline, dict) else {})
    missing = [name for name in loop.gains if name not in present]
    if missing:
        raise ConfigError(
            f"{where(spec, 'baseline')}: the present value of {missing[0]} is not known; write the gains to compare "
            f"with, for example {{{missing[0]}: 1}}"
        )
    return {name: float(present[name]) for name in loop.gains}


def _check_gains(spec: TuningSpec, loop: LoopSpec) -> None:
    _known(spec, ("search", "ranges"), spec.search.ranges, loop.gains, "gain")
    if isinstance(spec.baseline, dict):
        _known(spec, ("baseline",), spec.baseline, loop.gains, "gain")
    baseline_gains(spec, loop)
    kind = LOOP_KINDS[loop.kind]
    if not kind.identifiable:
        for gain in loop.gains:
            if gain not in spec.search.ranges and gain not in kind.ranges:
                location = where(spec, "search", "ranges")
                raise ConfigError(f"{location}: no rule gives a value of {gain}; write a range for it")


def _check_cost(spec: TuningSpec) -> None:
    _known(spec, ("cost",), spec.cost, FIGURES, "figure")
    _known(spec, ("constraints",), spec.constraints, FIGURES, "figure")
    for name, weight in spec.cost.items():
        if not (math.isfinite(weight) and weight >= 0.0):
            raise ConfigError(f"{where(spec, 'cost', name)}: {weight:g} is not allowed; a weight is 0 or more")
        if name in AT_LEAST:
            location = where(spec, "cost", name)
            raise ConfigError(f"{location}: a larger value is better; make it a constraint, or use ms or mt")
    if not any(spec.cost.values()):
        raise ConfigError(f"{where(spec, 'cost')}: no figure has a weight; give one, for example {{iae: 1}}")


def _check_times(spec: TuningSpec, duration: float) -> None:
    test = spec.test
    if test.step == 0.0:
        raise ConfigError(f"{where(spec, 'test', 'step')}: 0 is not allowed; the test needs a step")
    if not test.step_time < duration:
        raise ConfigError(
            f"{where(spec, 'test', 'step_time')}: {test.step_time:g} s is not before the end ({duration:g} s)"
        )
    # The load comes after the step has begun and before the end, else one of the two is not evaluated.
    load_time = test.load_time
    if load_time is not None and not test.step_time < load_time < duration:
        raise ConfigError(
            f"{where(spec, 'test', 'load_time')}: {load_time:g} s is not between the step ({test.step_time:g} s) and "
            f"the end ({duration:g} s)"
        )


def _known(spec: TuningSpec, path: tuple[str, ...], given: Iterable[str], known: Iterable[str], what: str) -> None:
    for name in given:
        if name not in known:
            raise ConfigError(f"{where(spec, *path, name)}: no {what} '{name}'; {did_you_mean(name, known)}")

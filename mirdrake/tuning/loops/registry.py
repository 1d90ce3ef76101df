"""Registry of the kinds of loops: a new kind is one class in a file of its own and one line here."""

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.yaml_io import where
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.loops.block_loop import BlockLoop, with_linear_model
from mirdrake.tuning.loops.cascade import CascadeLoop, as_cascade
from mirdrake.tuning.loops.kind import LoopKind
from mirdrake.tuning.loops.path import PathLoop
from mirdrake.tuning.loops.signals import DiagramLoopKind
from mirdrake.tuning.loops.speed import PedalSpeedLoop, SpeedLoop, WheelSpeedLoop
from mirdrake.tuning.loops.steering import SteeringLoop
from mirdrake.tuning.spec import TuningSpec

LOOP_KINDS: dict[str, LoopKind] = {
    kind.name: kind
    for kind in (
        WheelSpeedLoop(),
        SteeringLoop(),
        SpeedLoop(),
        PedalSpeedLoop(),
        PathLoop(),
        DiagramLoopKind(),
        BlockLoop(),
        CascadeLoop(),
    )
}
"""Kinds of loops by name."""


def make_loop_spec(study: TuningSpec, *, noise: bool | None = None, speed: float | None = None) -> LoopSpec:
    """Return the loop of a study as plain data.

    Args:
        study: the study.
        noise: whether the bench can add noise to the measurement; by default if the study's robustness asks for it.
        speed: of the car before the step, instead of the study's [m/s]; for a schedule.

    Raises:
        ConfigError: unknown loop, gain, signal or vehicle, or a loop that is not connected.
    """
    if not isinstance(study.loop, str):
        spec = LOOP_KINDS[DiagramLoopKind.name].make_spec(study, noise=noise, speed=speed)
        return as_cascade(with_linear_model(spec))
    names = [name for name, kind in LOOP_KINDS.items() if kind.selectable]
    if study.loop not in names:
        raise ConfigError(f"{where(study, 'loop')}: no loop '{study.loop}'; {did_you_mean(study.loop, names)}")
    return LOOP_KINDS[study.loop].make_spec(study, noise=noise, speed=speed)

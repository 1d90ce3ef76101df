"""Cascade of controllers in a user's diagram: rules from the inside to the outside, margins of the whole at the effort.

The parameters are gains of several PID controllers, those of the outermost first. The block of the last ones makes the
effort. Its loop is linearised with the outer loops open, and a rule gives its gains; then the next loop is linearised
with the inner one closed, and the same rule gives its gains, and so on (Åström and Hägglund, Advanced PID Control
(2006), section 13.4).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from pydrake.systems.framework import Context

from mirdrake.core.errors import ConfigError
from mirdrake.tuning.designs import Design, OmittedDesign, make_designs
from mirdrake.tuning.identify import Experiment, Identification
from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.block_loop import around_block, identify_block, tuned_names
from mirdrake.tuning.loops.controller_block import tuned_blocks
from mirdrake.tuning.loops.signals import DiagramLoopKind, SignalBench


class CascadeLoop(DiagramLoopKind):
    """Several PID controllers of a user's diagram, one within the other."""

    name: ClassVar[str] = "cascade"
    identifiable: ClassVar[bool] = True
    has_reduced_test: ClassVar[bool] = False
    conditions: ClassVar[tuple[str, ...]] = ("delay",)

    def make_bench(self, spec: LoopSpec) -> "CascadeBench":
        """See :meth:`LoopKind.make_bench`."""
        return CascadeBench(spec)

    def designs(
        self, identification: Identification, max_sensitivity: float
    ) -> tuple[tuple[Design, ...], tuple[OmittedDesign, ...]]:
        """Return a design of each rule that has gains for all controllers."""
        loop = identification.loop
        made: list[Design] = []
        omitted: list[OmittedDesign] = []
        inner, *outer = reversed(block_names(loop))
        partial, without = stage_designs(loop, inner, {}, max_sensitivity)
        omitted += without
        for design in partial:
            gains = design.gains
            # The same rule for the outer loops, each around what has been designed.
            for name in outer:
                found, without = stage_designs(loop, name, gains, max_sensitivity)
                same = next((one for one in found if one.name == design.name), None)
                if same is None:
                    reason = next((one.reason for one in without if one.name == design.name), "none for the outer loop")
                    omitted.append(OmittedDesign(design.name, f"{name}: {reason}"))
                    break
                gains = gains | same.gains
            else:
                made.append(replace(design, gains={gain: gains[gain] for gain in loop.gains}))
        return tuple(made), tuple(omitted)


def as_cascade(spec: LoopSpec) -> LoopSpec:
    """Return a loop of a diagram as a cascade if its parameters are gains of several PID controllers.

    Other loops are returned unchanged.
    """
    names = block_names(spec)
    if len(names) < 2 or sorted(tuned_names(spec)) != sorted(names):
        return spec
    # The effort is that of the last block, behind which the Monte Carlo adds delays.
    inner = around_block(spec, names[-1]) if spec.effort.startswith(f"{names[-1]}.") else None
    stages = [] if inner is None else [inner, *(around_block(spec, name) for name in names[:-1])]
    if inner is None or not all(stage is not None and stage.has_pid_gains for stage in stages):
        return spec
    return replace(spec, kind=CascadeLoop.name, diagram=inner.diagram, period=inner.period)


def block_names(spec: LoopSpec) -> list[str]:
    """Return the names of the blocks of the gains of a loop, in their order."""
    return list(dict.fromkeys(gain.rpartition(".")[0] for gain in spec.gains))


def stage_loop(spec: LoopSpec, name: str, gains: Mapping[str, float]) -> LoopSpec:
    """Return the loop around a block of a cascade: blocks with given gains are closed, the others stay open.

    Raises:
        ConfigError: the block is not a controller with one control.
    """
    systems: dict[str, Any] = dict(spec.diagram["systems"])
    for block in {gain.rpartition(".")[0] for gain in gains}:
        own = {gain.rpartition(".")[2]: value for gain, value in gains.items() if gain.rpartition(".")[0] == block}
        systems[block] = systems[block]["entry"] | own
    stage = around_block(replace(spec, diagram={**spec.diagram, "systems": systems}), name)
    if stage is None:
        raise ConfigError(f"'{name}' has no single control")
    return stage


def stage_designs(
    spec: LoopSpec, name: str, gains: Mapping[str, float], max_sensitivity: float
) -> tuple[tuple[Design, ...], tuple[OmittedDesign, ...]]:
    """Return the designs of a block of a cascade, around blocks with given gains."""
    identified = identify_block(stage_loop(spec, name, gains), name)
    return make_designs(identified, max_sensitivity=max_sensitivity)


class CascadeBench(SignalBench):
    """Test bench of a cascade; built once."""

    def _apply(self, context: Context, conditions: Conditions) -> None:
        """Write the delay of the innermost control."""
        inner = tuned_blocks(self.assembly)[block_names(self.spec)[-1]]
        inner.set_delay(context, conditions.delay or 0.0)

    def identify(self) -> Identification:
        """Return the models of all loops with the present gains, from the inside to the outside.

        Raises:
            ConfigError: a loop is not connected.
        """
        spec, gains = self.spec, dict[str, float]()
        experiments: list[Experiment] = []
        for name in reversed(block_names(spec)):
            stage = stage_loop(spec, name, gains)
            experiments += identify_block(stage, name).experiments
            gains |= stage.present
        return Identification(spec, tuple(experiments))

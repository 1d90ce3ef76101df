"""What every loop to tune has in common: its data, the conditions it is tried in, and what a trial gives.

The search, the sweeps and the Monte Carlo only know :class:`Evaluator`: a call that can be pickled, that takes gains by
name, conditions and a fidelity, and whose answer is an :class:`Evaluation`, whatever happens.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, Protocol

import pandas as pd

Fidelity = Literal["reduced", "plant"]
Status = Literal["ok", "unstable", "failed"]


@dataclass(frozen=True, slots=True)
class Conditions:
    """What may differ from the nominal loop in one trial; all of it is changed in a Context, nothing is built.

    Attributes:
        mass: factor on mass and inertia of all bodies of the vehicle [1]; its controllers do not know.
        friction: of the road [1]; None: the nominal one.
        delay: of the actuator, from the controller to the joint or pedal [s]; None: the nominal one.
        grade: of the road, positive uphill [rad].
        noise: standard deviation of the measurement [y], new in every period of the controller.
        seed: of the noise.
    """

    mass: float = 1.0
    friction: float | None = None
    delay: float | None = None
    grade: float = 0.0
    noise: float = 0.0
    seed: int = 0

    def data(self) -> dict[str, float]:
        """As numbers; nan for what is nominal."""
        return {name: math.nan if value is None else float(value) for name, value in asdict(self).items()}


NOMINAL = Conditions()


@dataclass(frozen=True)
class Evaluation:
    """What a set of gains does.

    Attributes:
        status: ok; unstable: it diverged, or still swings at the end; failed: it could not be tried.
        figures: by name: those of :class:`mirdrake.tuning.figures.Figures` with ``overshoot_percent`` for overshoot,
            and nominal margins ``ms``, ``mt``, ``gain_margin``, ``phase_margin_deg``, ``delay_margin_s``,
            ``disk_margin`` where a model of the loop is known. Empty unless ok.
        response: columns t [s], reference [y], output [y], effort [u]; None where it was not asked for.
        reason: one line; empty if ok.
    """

    status: Status
    figures: dict[str, float] = field(default_factory=dict)
    response: pd.DataFrame | None = None
    reason: str = ""


class Evaluator(Protocol):
    """Tries gains; can be pickled."""

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Try gains; never raises but for Ctrl-C."""
        ...


@dataclass(frozen=True)
class LoopSpec:
    """A loop as plain data, so that a worker can build it; made by :func:`mirdrake.tuning.loops.make_loop_spec`.

    Attributes:
        kind: wheel_speed, steering, speed, path or diagram.
        diagram: data of the diagram to build, with the loop's blocks in it.
        vehicle: name of the vehicle in it.
        gains: unit of each gain, by name.
        paths: dotted path of each gain in control.yaml; empty for a loop of a user's diagram.
        settings: other entries of control.yaml that the gains need, by dotted path.
        reference, output, effort: names of the signals.
        output_unit, effort_unit: their units.
        course: reference, load and duration of the trial.
        models: models of the loop, known after its identification; the reduced fidelity needs one.
        nominal: delay [s] and friction [1] of the nominal conditions.
        options: what a kind needs besides.
    """

    kind: str
    diagram: dict[str, Any]
    vehicle: str
    gains: dict[str, str]
    paths: dict[str, str]
    settings: dict[str, Any]
    reference: str
    output: str
    effort: str
    output_unit: str
    effort_unit: str
    course: dict[str, Any]
    nominal: dict[str, float]
    models: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)


class Loop(Protocol):
    """A built loop."""

    spec: LoopSpec

    def evaluate(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Try gains."""
        ...

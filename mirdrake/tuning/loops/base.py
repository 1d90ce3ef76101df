"""Data of a loop to tune, the conditions of a test, and the result of an evaluation.

Search and Monte Carlo know a loop only as an :class:`Evaluator`: a call that can be pickled, takes gains, conditions
and a fidelity, and always returns an :class:`Evaluation`.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import pandas as pd

from mirdrake.core.json_io import Json
from mirdrake.core.pid import PidGains
from mirdrake.tuning.models import TransferFunction

Fidelity = Literal["reduced", "plant"]
Status = Literal["ok", "unstable", "failed"]


@dataclass(frozen=True, slots=True)
class Conditions:
    """Deviations from the nominal loop in one test; they are written to a Context, nothing is rebuilt.

    Attributes:
        mass: factor on mass and inertia of all bodies of the vehicle, not known to its controllers [1].
        friction: of the road [1]; None: nominal.
        delay: of the actuator, from the controller to the joint or pedal [s]; None: nominal.
        grade: of the road, positive uphill [rad].
        noise: standard deviation of the measurement, drawn anew in every period of the controller [y].
        seed: of the noise.
        step: factor on the step of the set-point [1].
    """

    mass: float = 1.0
    friction: float | None = None
    delay: float | None = None
    grade: float = 0.0
    noise: float = 0.0
    seed: int = 0
    step: float = 1.0

    def numbers(self) -> dict[str, float]:
        """Return the conditions by name; nan for nominal ones."""
        return {name: math.nan if value is None else float(value) for name, value in asdict(self).items()}


NOMINAL = Conditions()


@dataclass(frozen=True)
class Evaluation:
    """Result of testing a set of gains.

    Attributes:
        status: ok; unstable: diverged, or still oscillating at the end; failed: could not be tested.
        figures: by name: those of :class:`mirdrake.tuning.figures.Figures`, with ``overshoot_percent`` for overshoot,
            and the nominal margins in :data:`mirdrake.tuning.spec.MARGINS` if a model is known. Empty unless ok.
        response: columns t [s], reference [y], output [y], effort [u]; None if it was not asked for.
        reason: one line; empty if ok.
        decays: whether any oscillation at the end decays, though it may be too large for a status of ok; False if that
            is not known.
    """

    status: Status
    figures: dict[str, float] = field(default_factory=dict)
    response: pd.DataFrame | None = None
    reason: str = ""
    decays: bool = False


class Evaluator(Protocol):
    """Callable that tests gains and can be pickled."""

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        """Test gains; raises nothing but KeyboardInterrupt."""
        ...


PID_ROLES = ("kp", "ki", "kd")
"""What gains may be to a PID controller."""

PATH_ROLES = ("convergence_time", "damping")
"""What gains may be to a driver that tracks a path: a PD controller of a double integrator."""

NO_ROLE = "-"
"""Role of a gain of a controller that is not PID, whatever the name of the gain."""


@dataclass(frozen=True)
class Gain:
    """Gain of a loop.

    Attributes:
        unit: its unit.
        path: dotted path in control.yaml; empty for a gain of a diagram.
        role: what it is to a PID controller, kp, ki or kd; empty: the last part of its name, such as ``pid.kp``.
    """

    unit: str = ""
    path: str = ""
    role: str = ""


@dataclass(frozen=True)
class Course:
    """Test manoeuvre: a step of the set-point, and a later load or the return of the set-point.

    Attributes:
        step: of the set-point [y].
        step_time: of the step [s].
        load: added to the effort from `load_time` on [u].
        load_time: of the load [s].
        duration: of the test [s].
        speed: of the car before the step [m/s].
        return_time: from which the set-point is that before the step again [s]; None: it does not return.
    """

    step: float
    step_time: float
    load: float
    load_time: float
    duration: float
    speed: float = 0.0
    return_time: float | None = None


@dataclass(frozen=True)
class OuterLoop:
    """PI controller that corrects the set-point of a loop by the error of its output; it is kept as it is.

    Attributes:
        kp: correction over error [1].
        ki: integral gain [1/s].
        limit: of the correction [y].
    """

    kp: float
    ki: float
    limit: float


@dataclass(frozen=True)
class BlockModel:
    """Linear model of a diagram around one of its blocks: see :mod:`mirdrake.tuning.loops.block_response`.

    Attributes:
        entry: of the block in the diagram.
        parameters: its tuned parameters, with their present values.
        control: its output port.
        period: of the model [s].
        folder: of the diagram file.
        values: elements of its inputs at the operating point.
        state: its state there.
        frequencies: of the responses [rad/s].
        responses: real and imaginary parts of the responses from the control to the sources of the inputs, without
            sign; by index of the element, without those that the control does not reach.
    """

    entry: Json
    parameters: dict[str, float]
    control: str
    period: float
    folder: str | None
    values: tuple[float, ...]
    state: tuple[float, ...]
    frequencies: tuple[float, ...] = ()
    responses: tuple[tuple[int, tuple[tuple[float, float], ...]], ...] = ()


@dataclass(frozen=True)
class DrivenAxle:
    """Wheels of a driven axle, and a tyre of them.

    Attributes:
        wheels: number of wheels.
        inertia: spin inertia of a wheel, with the rotor of its motor [kg m²].
        load: load of a wheel at rest [N].
        transfer: its change by the acceleration of the vehicle [N s²/m].
        stiffness: slip stiffness over the load [1].
        length: relaxation length [m].
        damping: damping between patch and rim at all speeds, over the load [s/m].
        low_damping: further damping at standstill, which fades up to the speed `low`, over the load [s/m].
        curve: force over load at the slips (k / (n - 1))², for the nominal friction [1].
    """

    wheels: int
    inertia: float
    load: float
    transfer: float
    stiffness: float
    length: float
    damping: float
    low_damping: float
    curve: tuple[float, ...]


@dataclass(frozen=True)
class SlipModel:
    """Vehicle and driven wheels as separate inertias that tyres couple up to their friction.

    Attributes:
        mass: of the vehicle, without the driven wheels' inertia, with that of the others [kg].
        radius: rolling radius of the driven wheels [m].
        friction: of the road [1].
        axles: driven axles.
        frequency: natural frequency of pitch [rad/s].
        damping: damping ratio of pitch [1].
        lean: displacement of the point below the centre of mass on the road by pitch, over the acceleration [s²].
        low: speed below which a tyre has its damping of low speeds, and a limit of its deflection [m/s].
    """

    mass: float
    radius: float
    friction: float
    axles: tuple[DrivenAxle, ...]
    frequency: float
    damping: float
    lean: float
    low: float

    def largest(self, *, backward: bool = False) -> float:
        """Return the largest acceleration, or deceleration, for which the driven tyres have the force [m/s²].

        From m a = μ Σ (N + c a): the acceleration changes the loads.
        """
        load = sum(axle.wheels * axle.load for axle in self.axles)
        moved = (-1.0 if backward else 1.0) * sum(axle.wheels * axle.transfer for axle in self.axles)
        return self.friction * load / (self.mass - self.friction * moved)


@dataclass(frozen=True)
class LoopModel:
    """Identified model of a loop, sufficient to simulate it without the plant.

    Attributes:
        plants: transfer functions from effort to measurement, without the hold of the effort: ``main``, and for a
            steering loop ``apart``, of the two wheels against each other.
        measured: factor on all of them, 1 at low frequencies, such as that of a car that pitches on its tyres; None: 1.
        output: the same for the output, times scale, with the same denominator; None: the measurement is the output.
        scale: measurement per output [1].
        start: output before the step [y].
        rise: largest slope of the set-point [y/s].
        fall: largest downward slope of the set-point [y/s].
        feedforward: effort per slope of the set-point [u s/y].
        weight: effort that would lift the whole weight of the car [u].
        drag: effort that keeps the output constant [u].
        limit: of the effort [u]; None: unlimited.
        mass_acts: whether the mass of the car is the inertia of the loop.
        radius_per_mass: relative change of the rolling radius of the driven wheels, which are measured, per relative
            change of the mass of the car: a tyre is compressed by its load [1].
        outer: the speed loop of the vehicle around this loop; None without one.
        block: exact linear model around a block of a diagram, from which margins are computed; None: from the transfer
            functions.
        slip: model of wheels that may slip; None for a loop that does not drive wheels, or by pedals.
    """

    plants: dict[str, TransferFunction]
    measured: TransferFunction | None = None
    output: TransferFunction | None = None
    scale: float = 1.0
    start: float = 0.0
    rise: float = math.inf
    fall: float = math.inf
    feedforward: float = 0.0
    weight: float = 0.0
    drag: float = 0.0
    limit: float | None = None
    mass_acts: bool = True
    radius_per_mass: float = 0.0
    outer: OuterLoop | None = None
    block: BlockModel | None = None
    slip: SlipModel | None = None

    @cached_property
    def key(self) -> str:
        """Its values, as a key of what was computed from it."""
        return repr(self)

    def to_measurement(self, plant: TransferFunction) -> TransferFunction:
        """Return one of the transfer functions with its factor to the measurement."""
        return plant if self.measured is None else plant * self.measured

    def to_output(self, plant: TransferFunction) -> TransferFunction:
        """Return one of the transfer functions with its factor to the output, times scale."""
        return self.to_measurement(plant) if self.output is None else plant * self.output


@dataclass(frozen=True)
class LoopSpec:
    """A loop as plain data, from which a worker process can build it.

    Attributes:
        kind: a name in :data:`mirdrake.tuning.loops.registry.LOOP_KINDS`.
        diagram: data of the diagram to build, including the blocks of the test bench.
        vehicle: name of the vehicle in it.
        gains: gains to tune, by name.
        reference: signal of the set-point, or its constant value.
        output: controlled signal.
        effort: control signal.
        output_unit: unit of the output.
        effort_unit: unit of the effort.
        course: test manoeuvre.
        period: of the controller [s]; None for a loop whose margins are not known.
        settings: further entries of control.yaml that the gains need, by dotted path.
        filter_time: of the derivative [s].
        delay: nominal delay of the actuator [s].
        friction: nominal friction of the road [1]; None if it is not the same everywhere.
        noisy: whether the bench has a block that adds noise to the measurement.
        present: gains that the diagram or control.yaml has now; empty if its controller has others, such as a servo.
        present_kind: kind of the present controller in control.yaml; empty for a loop of signals.
        test_control: entries of control.yaml that the test needs, whatever the gains.
        model: None before the identification.
    """

    kind: str
    diagram: Json
    vehicle: str
    gains: dict[str, Gain]
    reference: str | float
    output: str
    effort: str
    output_unit: str
    effort_unit: str
    course: Course
    period: float | None = None
    settings: dict[str, float | str] = field(default_factory=dict)
    filter_time: float = 0.0
    delay: float = 0.0
    friction: float | None = None
    noisy: bool = False
    present: dict[str, float] = field(default_factory=dict)
    present_kind: str = ""
    test_control: Json = field(default_factory=dict)
    model: LoopModel | None = None

    @property
    def time_step(self) -> float:
        """Time step of the plant [s]."""
        return float(self.diagram["plant"]["time_step"])

    def role(self, gain: str) -> str:
        """Return what a gain is to a PID controller: kp, ki or kd; other parameters have their own name."""
        declared = self.gains[gain].role if gain in self.gains else ""
        return declared or gain.rpartition(".")[2]

    @property
    def has_pid_gains(self) -> bool:
        """Whether the gains are those of a P, PI, PD or PID controller, for which there are rules."""
        roles = [self.role(gain) for gain in self.gains]
        return {"kp"} <= set(roles) <= set(PID_ROLES) and len(set(roles)) == len(roles)

    @property
    def has_rules(self) -> bool:
        """Whether rules give values of all gains: those of a PID controller, or of a driver that tracks a path."""
        return self.has_pid_gains or sorted(map(self.role, self.gains)) == sorted(PATH_ROLES)

    def gains_of(self, pid: PidGains) -> dict[str, float] | None:
        """Return the gains of the loop that are those of a PID controller; None if the loop has no such controller.

        A controller without integral part gets the other parts.
        A driver that tracks a path has T and zeta of ``e'' + 2 zeta/T e' + e/T^2 = 0``, so kp = 1/T^2 and
        kd = 2 zeta/T.
        """
        values = {"kp": pid.kp, "ki": pid.ki, "kd": pid.kd}
        if not self.has_pid_gains:
            if pid.ki or not pid.kp > 0.0 or not pid.kd > 0.0:
                return None
            values = {"convergence_time": pid.kp**-0.5, "damping": 0.5 * pid.kd * pid.kp**-0.5}
        # Without a derivative gain in the loop a PID has no place.
        elif pid.kd and "kd" not in map(self.role, self.gains):
            return None
        return {gain: values[self.role(gain)] for gain in self.gains}

    def with_control(self, control: Mapping[str, Any]) -> "LoopSpec":
        """Return the loop with other entries of control.yaml in its diagram, so that no gain is left to set."""
        vehicles = self.diagram["vehicles"]
        changed = {**vehicles, self.vehicle: {**vehicles[self.vehicle], "control": dict(control)}}
        return replace(self, gains={}, diagram={**self.diagram, "vehicles": changed})

    def as_present(self) -> "LoopSpec":
        """Return the loop with the controllers that its vehicle has now."""
        return self.with_control(self.test_control)

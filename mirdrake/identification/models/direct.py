"""Models whose outputs follow from their inputs alone: kinematic car, steering, joint behind its servo."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.identification.data import DataSet
from mirdrake.identification.models.additions import STEERING_LAG, is_angle_measured
from mirdrake.identification.models.base import (
    SPEED,
    Addition,
    Array,
    ModelOptions,
    Segment,
    Values,
    find_channel,
    select_outputs,
)
from mirdrake.identification.models.equations import EquationModel
from mirdrake.identification.models.filters import second_order
from mirdrake.identification.models.manoeuvres import lateral_manoeuvres
from mirdrake.identification.models.steer import STEERING, STEERING_PARAMETERS, steering_angle, steering_parameters
from mirdrake.identification.parameters import Parameter, Setting


class _DirectModel(EquationModel):
    """Model whose outputs follow from its inputs alone; its one state is not observed."""

    states, state_scales = ("none",), (1.0,)

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Return zero."""
        del u, p
        return np.zeros_like(x)

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Return the first input."""
        del p
        return np.asarray((u[0] + 0.0 * x[0])[None])

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Return zero."""
        del p, drive
        return np.zeros((1, len(rows)))


class KinematicOptions(ModelOptions):
    """Options of the kinematic model."""

    outputs: list[str] | None = Field(default=None, description="channels to compare; all if left out [-]")


class KinematicModel(_DirectModel):
    """Car without tyre slip behind its steering: r = v tan δ / (L + K v²), ay = v r."""

    kind = "kinematic"
    Options = KinematicOptions
    uses_steering_guess = True

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: KinematicOptions
    ) -> None:
        self.title = "kinematic single track with steering dynamics"
        self._steer = find_channel(channels, STEERING, "the steering", self.kind)
        self._speed = find_channel(channels, SPEED, "the speed", self.kind)
        self.inputs = (self._steer, self._speed)
        self.outputs = select_outputs(channels, ["yaw_rate", "lateral_acceleration"], options.outputs, self.kind)
        length = wheelbase or known.get("wheelbase", known.get("assumed_wheelbase", 2.7))
        # Ratio and wheelbase are not separable: the wheelbase is free only if the ratio is known to be 1.
        fixed = wheelbase is not None or "wheelbase" in known or self._steer != "road_wheel_angle"
        source = "given with the data" if wheelbase else "" if "wheelbase" in known else "assumed"
        self.parameters = (
            Parameter("wheelbase", "m", "front to rear axle", length, 0.02, 20.0, not fixed, usual=1.0, source=source),
            Parameter("understeer", "s^2/m", "K in L + K v²: understeer gradient of an angle", 0.0, -0.05, 0.2, False,
                      0.002, usual=4.0),
            *steering_parameters(self._steer),
        )  # fmt: skip
        self.input_parameters = STEERING_PARAMETERS

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return road wheel angle [rad] and speed [m/s]."""
        return np.stack((steering_angle(p, drive, self._steer, times), drive.at(self._speed, times)))

    def input_memory(self, p: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return dead time and lag of the steering."""
        return {self._steer: (p["steering_delay"], p["steering_lag"])}

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Return yaw rate and lateral acceleration."""
        # The unused state is added as zero, so that the result has the shape of all columns and shots.
        rate = u[1] * np.tan(u[0]) / (p["wheelbase"] + p["understeer"] * u[1] ** 2) + 0.0 * x[0]
        return np.stack([rate if name == "yaw_rate" else rate * u[1] for name in self.outputs])

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Return the combinations that a drive at one speed identifies."""
        return {
            "steering ratio times wheelbase": (p["steering_ratio"] * p["wheelbase"], "m"),
            "steering delay plus lag": (p["steering_delay"] + p["steering_lag"], "s"),
        }

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which drive would identify these parameters."""
        del drives
        if names & {"steering_delay", "steering_lag"}:
            return "do step steers"
        return "turn slowly and fast, left and right"

    def candidate_manoeuvres(self, p: Mapping[str, float], speed: float) -> dict[str, dict[str, Array]]:
        """Return the lateral manoeuvres."""
        return lateral_manoeuvres(p, speed)

    @classmethod
    def additions(cls, data: DataSet, options: KinematicOptions, settings: Mapping[str, Setting]) -> Iterator[Addition]:
        """Yield a lag of the steering, where its set-point is recorded."""
        del options
        if "steering_lag" not in settings and not is_angle_measured(data):
            yield STEERING_LAG


class SteeringOptions(ModelOptions):
    """Options of the steering model."""

    input: str | None = Field(default=None, description="channel of the input; hand wheel or command if left out [-]")


class SteeringModel(_DirectModel):
    """Steering alone: the road wheel angle from the hand wheel or the command."""

    kind = "steering"
    Options = SteeringOptions

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: SteeringOptions
    ) -> None:
        del known, wheelbase
        self.title = "steering"
        # The road wheel angle is the output here, so it cannot be the input.
        choice = (options.input,) if options.input else STEERING[1:]
        self._steer = find_channel(channels, choice, "the input of the steering", self.kind)
        find_channel(channels, ("road_wheel_angle",), "the road wheel angle", self.kind)
        self.inputs, self.outputs = (self._steer,), ("road_wheel_angle",)
        self.input_parameters = STEERING_PARAMETERS
        self.parameters = tuple(
            replace(info, free=info.name != "steering_backlash") for info in steering_parameters(self._steer)
        )

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return the road wheel angle [rad]."""
        return steering_angle(p, drive, self._steer, times)[None]

    def input_memory(self, p: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return dead time and lag of the steering."""
        return {self._steer: (p["steering_delay"], p["steering_lag"])}

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which drive would identify these parameters."""
        del drives
        if "steering_backlash" in names:
            return "turn the steering wheel slowly to the left and right"
        return "do steps of the steering"

    @classmethod
    def is_default_for(cls, channels: set[str]) -> bool:
        """Whether the road wheel angle and its input are recorded."""
        return "road_wheel_angle" in channels and bool(channels & {*STEERING[1:]})


class JointLoopOptions(ModelOptions):
    """Options of the joint-loop model."""

    input: str = Field(default="steering_command", description="channel of the set-point [-]")
    output: str = Field(default="road_wheel_angle", description="channel of the joint [-]")


class JointLoopModel(_DirectModel):
    """Joint behind its servo, second order with dead time: ÿ = ω² (K u(t - τ) + b - y) - 2 ζ ω ẏ.

    With the inertia J of the joint the servo gains are kp = J ω² and kd = 2 J ζ ω.
    """

    kind = "joint_loop"
    Options = JointLoopOptions

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: JointLoopOptions
    ) -> None:
        del wheelbase
        for name, meaning in ((options.input, "the set-point"), (options.output, "the joint")):
            if name not in channels:
                hint = did_you_mean(name, channels)
                raise ConfigError(f"{self.kind}: {meaning} '{name}' is in no log; {hint}", path=("model",))
        self.title = f"joint loop, {options.input} to {options.output}"
        self._input = options.input
        self.inputs, self.outputs = (options.input,), (options.output,)
        # The inertia only converts the fit to servo gains, and is not an unknown of it.
        inertia = known.get("inertia")
        source = "" if inertia else "not given: servo gains are per unit of inertia"
        self.parameters = (
            Parameter("gain", "1", "output over set-point", 1.0, 1e-4, 1e4, True, usual=1.5),
            Parameter("offset", "1", "offset of the output", 0.0, -1e3, 1e3, True, 0.02, usual=10.0),
            Parameter("natural_frequency", "rad/s", "natural frequency", 15.0, 0.1, 1e3, True, usual=1.5),
            Parameter("damping_ratio", "1", "damping ratio", 0.8, 0.02, 20.0, True, usual=1.0),
            Parameter("delay", "s", "dead time", 0.02, 0.0, 1.0, True, 0.05, usual=4.0),
            Parameter("inertia", "kg m^2", "inertia of the joint, for the gains of its servo", inertia or 1.0, 1e-9,
                      1e6, source=source),
        )  # fmt: skip
        self.input_parameters = frozenset({"gain", "offset", "natural_frequency", "damping_ratio", "delay"})

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return the response of the loop."""
        step = float(times[1] - times[0])
        # The response begins before the segment, as its inputs of the last seconds still act through delay and lag.
        wide, early = drive.with_history(times)
        target = p["gain"] * drive.at(self._input, wide, p["delay"]) + p["offset"]
        return second_order(target, step, p["natural_frequency"], p["damping_ratio"])[None, early:]

    def input_memory(self, p: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return dead time and slower time constant of the loop."""
        damping = p["damping_ratio"]
        decay = p["natural_frequency"] * (damping - math.sqrt(max(damping**2 - 1.0, 0.0)))
        return {self._input: (p["delay"], 1.0 / decay)}

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Return the servo gains and the total delay of the loop."""
        natural, inertia = p["natural_frequency"], p["inertia"]
        return {
            "servo stiffness kp": (inertia * natural**2, "N m/rad"),
            "servo damping kd": (2.0 * inertia * p["damping_ratio"] * natural, "N m s/rad"),
            "delay plus lag": (p["delay"] + 2.0 * p["damping_ratio"] / natural, "s"),
        }

    def offset_scale(self, channel: str) -> float:
        """Return 0: the offset is a parameter of the model."""
        del channel
        return 0.0

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which test would identify these parameters."""
        del drives, names
        return "do steps and a sweep of the set-point to beyond the natural frequency"

"""Small models: a car without slip, a steering by itself, a joint behind its servo."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.identification.models.base import Array, Model, Segment, Values, channel_of, pick_outputs, second_order
from mirdrake.identification.models.single_track import SPEED
from mirdrake.identification.models.steer import STEERING, STEERING_PARAMETERS, steering_angle, steering_parameters
from mirdrake.identification.parameters import Parameter


class _Direct(Model):
    """A model whose outputs follow from its inputs alone; its one state is never seen."""

    states, state_scales = ("none",), (1.0,)

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Nothing moves by itself."""
        del u, p
        return np.zeros_like(x)

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Zero."""
        del p, drive
        return np.zeros((1, len(rows)))


class KinematicModel(_Direct):
    """A car without slip behind its steering: r = v tan δ / (L + K v²), ay = v r.

    Args:
        offered: channels that all logs have.
        given: what is known of parameters.
        wheelbase: of the data set [m].
        outputs: channels to compare.
    """

    kind = "kinematic"

    def __init__(
        self,
        offered: set[str],
        given: Mapping[str, float],
        wheelbase: float | None,
        *,
        outputs: list[str] | None = None,
    ) -> None:
        self.title = "kinematic single track with the chain of the steering"
        self._steer = channel_of(offered, STEERING, "the steering", self.kind)
        self._speed = channel_of(offered, SPEED, "the speed", self.kind)
        self.inputs = (self._steer, self._speed)
        self.outputs = pick_outputs(offered, ["yaw_rate", "lateral_acceleration"], outputs, self.kind)
        length = wheelbase or given.get("wheelbase", given.get("assumed_wheelbase", 2.7))
        known = wheelbase is not None or "wheelbase" in given or self._steer != "road_wheel_angle"
        self.parameters = (
            Parameter(
                "wheelbase",
                "m",
                "front to rear axle",
                length,
                0.02,
                20.0,
                not known,
                usual=1.0,
                source="given with the data" if wheelbase else "" if "wheelbase" in given else "assumed",
            ),
            Parameter(
                "understeer",
                "s^2/m",
                "K in L + K v²: understeer gradient of an angle",
                0.0,
                -0.05,
                0.2,
                False,
                0.002,
                usual=4.0,
            ),
            *steering_parameters(self._steer),
        )
        self.input_parameters = STEERING_PARAMETERS

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Angle of the wheels [rad] and speed [m/s]."""
        return np.stack((steering_angle(p, drive, self._steer, times), drive.at(self._speed, times)))

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Yaw rate and lateral acceleration."""
        rate = u[1] * np.tan(u[0]) / (p["wheelbase"] + p["understeer"] * u[1] ** 2) + 0.0 * x[0]
        return np.stack([rate if name == "yaw_rate" else rate * u[1] for name in self.outputs])

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """What one speed tells."""
        return {
            "steering ratio times wheelbase": (p["steering_ratio"] * p["wheelbase"], "m"),
            "steering delay and lag together": (p["steering_delay"] + p["steering_lag"], "s"),
        }

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        return (
            "do step steers" if names & {"steering_delay", "steering_lag"} else "turn slowly and fast, left and right"
        )


class SteeringModel(_Direct):
    """A steering by itself: the angle of the wheels from the hand wheel or the command.

    Args:
        offered: channels that all logs have.
        given: not used.
        wheelbase: not used.
        input: channel of the input; left out: the hand wheel or the command.
    """

    kind = "steering"

    def __init__(
        self,
        offered: set[str],
        given: Mapping[str, float],
        wheelbase: float | None,
        *,
        input: str | None = None,  # noqa: A002
    ) -> None:
        del given, wheelbase
        self.title = "steering"
        choice = (input,) if input else STEERING[1:]
        self._steer = channel_of(offered, choice, "the input of the steering", self.kind)
        channel_of(offered, ("road_wheel_angle",), "the angle of the wheels", self.kind)
        self.inputs, self.outputs, self.input_parameters = (self._steer,), ("road_wheel_angle",), STEERING_PARAMETERS
        self.parameters = tuple(
            Parameter(**{**vars(info), "free": info.name != "steering_backlash"})
            for info in steering_parameters(self._steer)
        )

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Angle of the wheels [rad]."""
        return steering_angle(p, drive, self._steer, times)[None]

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Angle of the wheels."""
        del p
        return np.asarray((u[0] + 0.0 * x[0])[None])

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        return "turn the wheel to and fro slowly" if "steering_backlash" in names else "do steps of the steering"


class JointLoopModel(_Direct):
    """A joint behind its servo, second order with a dead time: ÿ = ω² (K u(t - τ) + b - y) - 2 ζ ω ẏ.

    With the inertia J of the joint the servo gains are kp = J ω², kd = 2 J ζ ω.

    Args:
        offered: channels that all logs have.
        given: what is known of parameters.
        wheelbase: not used.
        input: channel of the set-point.
        output: channel of the joint.
    """

    kind = "joint_loop"

    def __init__(
        self,
        offered: set[str],
        given: Mapping[str, float],
        wheelbase: float | None,
        *,
        input: str = "steering_command",  # noqa: A002
        output: str = "road_wheel_angle",
    ) -> None:
        del wheelbase
        for name, what in ((input, "the set-point"), (output, "the joint")):
            if name not in offered:
                raise ConfigError(f"model {self.kind}: {what} '{name}' is in no log; {did_you_mean(name, offered)}")
        self.title = f"joint loop, {input} to {output}"
        self._input = input
        self.inputs, self.outputs = (input,), (output,)
        inertia = given.get("inertia")
        self.parameters = (
            Parameter("gain", "1", "of the output over the set-point", 1.0, 1e-4, 1e4, True, usual=1.5),
            Parameter("offset", "1", "of the output", 0.0, -1e3, 1e3, True, 0.02, usual=10.0),
            Parameter("natural_frequency", "rad/s", "of the loop", 15.0, 0.1, 1e3, True, usual=1.5),
            Parameter("damping_ratio", "1", "of the loop", 0.8, 0.02, 20.0, True, usual=1.0),
            Parameter("delay", "s", "dead time", 0.02, 0.0, 1.0, True, 0.05, usual=4.0),
            Parameter(
                "inertia",
                "kg m^2",
                "of the joint, for the gains of its servo",
                inertia or 1.0,
                1e-9,
                1e6,
                source="" if inertia else "not given: servo gains are per unit of inertia",
            ),
        )
        self.input_parameters = frozenset({"gain", "offset", "natural_frequency", "damping_ratio", "delay"})

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """The answer of the loop."""
        step = float(times[1] - times[0])
        wide, early = drive.with_history(times)
        asked = p["gain"] * drive.at(self._input, wide, p["delay"]) + p["offset"]
        return second_order(asked, step, p["natural_frequency"], p["damping_ratio"])[None, early:]

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """The joint."""
        del p
        return np.asarray((u[0] + 0.0 * x[0])[None])

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Gains of the servo, and how late the loop is."""
        natural, inertia = p["natural_frequency"], p["inertia"]
        return {
            "servo stiffness kp": (inertia * natural**2, "N m/rad"),
            "servo damping kd": (2.0 * inertia * p["damping_ratio"] * natural, "N m s/rad"),
            "delay and lag together": (p["delay"] + 2.0 * p["damping_ratio"] / natural, "s"),
        }

    def offset_scale(self, channel: str) -> float:
        """The offset is a parameter of its own."""
        del channel
        return 0.0

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which test would tell these parameters apart."""
        del names
        return "do steps and a sweep of the set-point to beyond the natural frequency"

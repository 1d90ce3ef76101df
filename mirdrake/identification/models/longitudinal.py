"""Motion ahead: drive, brakes, rolling resistance, drag and grade.

::

    (m + mr) v̇ = Fd - (Fb + c m g + B |v|) tanh(v / 0.1 m/s) - D v |v| - m g (sin γ + γ0)

with the drive force Fd from the pedal, min(F, P / v) times its position, or from a measured torque at the wheels over
their radius; the brake force Fb from the pedal or a torque; each with a dead time and a lag of first order. D is half
the density of air times the drag area. Without a mass, forces are per kilogram.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.identification.models.base import (
    PART,
    SMALL,
    Array,
    Assumption,
    Model,
    Segment,
    Values,
    channel_of,
    first_order,
    pick_outputs,
)
from mirdrake.identification.models.single_track import SPEED
from mirdrake.identification.parameters import Parameter

_DRIVE = {"throttle": "throttle", "torque": "drive_torque"}
_BRAKE = {"pedal": "brake", "torque": "brake_torque"}
_STAND = 0.1
_TURNING = 0.03  # what turns, over the mass [1]
_SLOPE = 0.001  # of a road that is said to be flat, assumed [1]
_VISCOUS = 0.01  # resistance over speed, over the force of the rolling resistance, assumed [s/m]


class LongitudinalModel(Model):
    """See the head of the module.

    Args:
        offered: channels that all logs have.
        given: what is known of parameters.
        wheelbase: not used.
        drive: "throttle", "torque" or "none"; left out: what there is, in this order.
        brake: "pedal", "torque" or "none"; left out: the pedal, unless the torque at the wheels has it already.
        outputs: channels to compare; None: the speed, and the acceleration if there is one.

    Raises:
        ConfigError: a channel is missing, or an option unknown.
    """

    kind = "longitudinal"

    def __init__(
        self,
        offered: set[str],
        given: Mapping[str, float],
        wheelbase: float | None,
        *,
        drive: str | None = None,
        brake: str | None = None,
        outputs: list[str] | None = None,
    ) -> None:
        del wheelbase
        if drive is None:
            drive = next((name for name, channel in _DRIVE.items() if channel in offered), "none")
        if brake is None:
            brake = next((name for name, channel in _BRAKE.items() if channel in offered and drive != "torque"), "none")
        for name, value, known in (("drive", drive, _DRIVE), ("brake", brake, _BRAKE)):
            if value not in {*known, "none"}:
                raise ConfigError(f"model.{name}: unknown '{value}'; {did_you_mean(value, [*known, 'none'])}")
            if value != "none":
                channel_of(offered, (known[value],), f"the {name}", self.kind)
        self._drive, self._brake = drive, brake
        self.title = f"longitudinal, drive {drive}, brake {brake}"
        self._speed = channel_of(offered, SPEED, "the speed", self.kind)
        self._grade = "grade" in offered
        self.inputs = tuple(
            name for name in (_DRIVE.get(drive, ""), _BRAKE.get(brake, ""), "grade" if self._grade else "") if name
        )
        self.states, self.state_scales = ("vx",), (1.0,)
        self.outputs = pick_outputs(offered, [self._speed, "longitudinal_acceleration"], outputs, self.kind)
        self.input_parameters = frozenset(
            {
                "drive_force",
                "drive_delay",
                "drive_lag",
                "brake_force",
                "brake_delay",
                "brake_lag",
                "wheel_radius",
            }
        )
        self.parameters = self._make(given)

    def _make(self, given: Mapping[str, float]) -> tuple[Parameter, ...]:
        bare = "mass" not in given
        mass = given.get("mass", 1.0)
        force, per = ("N/kg", " per kg") if bare else ("N", "")
        found = [
            Parameter(
                "mass",
                "1" if bare else "kg",
                "of the vehicle",
                mass,
                1e-3,
                1e6,
                source="not given: forces are per kilogram" if bare else "",
            ),
            Parameter(
                "rotating_mass",
                "1" if bare else "kg",
                "of what turns, reduced to the road" + per,
                0.0,
                0.0,
                mass,
                scale=0.05 * mass,
            ),
            Parameter(
                "rolling_resistance", "1", "rolling resistance over weight", 0.01, 0.0, 0.5, True, 0.005, usual=6.0
            ),
            Parameter(
                "drag",
                f"{force} s^2/m^2",
                "drag over speed squared, half the density of air times the drag area",
                2.5e-4 * mass,
                0.0,
                0.05 * mass,
                True,
                2e-4 * mass,
                usual=6.0,
            ),
            Parameter(
                "viscous_resistance",
                f"{force} s/m",
                "resistance over speed",
                0.0,
                -0.1 * mass,
                0.5 * mass,
                scale=2e-3 * mass,
                usual=6.0,
            ),
            Parameter("slope", "1", "slope of the road that is not in 'grade'", 0.0, -0.3, 0.3, scale=0.005, usual=4.0),
        ]
        if self._drive == "throttle":
            found += [
                Parameter(
                    "drive_force",
                    force,
                    "at full throttle, when slow",
                    4.0 * mass,
                    0.01 * mass,
                    50.0 * mass,
                    True,
                    usual=1.0,
                ),
                Parameter(
                    "drive_power",
                    force.replace("N", "W"),
                    "at full throttle, when fast",
                    80.0 * mass,
                    0.01 * mass,
                    5e3 * mass,
                    True,
                    usual=1.5,
                ),
            ]
        elif self._drive == "torque":
            found.append(Parameter("wheel_radius", "m", "of the driven wheels", 0.33, 0.01, 2.0, usual=0.3))
        if self._brake == "pedal":
            found.append(
                Parameter("brake_force", force, "at full pedal", 8.0 * mass, 0.05 * mass, 50.0 * mass, True, usual=1.0)
            )
        elif self._brake == "torque" and self._drive != "torque":
            found.append(Parameter("wheel_radius", "m", "of the wheels", 0.33, 0.01, 2.0, usual=0.3))
        for name, kind in (("drive", self._drive), ("brake", self._brake)):
            if kind != "none":
                pedal = kind in {"throttle", "pedal"}
                found += [
                    Parameter(
                        f"{name}_delay",
                        "s",
                        f"dead time of the {name}",
                        0.05 if pedal else 0.0,
                        -0.1,
                        1.0,
                        pedal,
                        0.05,
                        usual=4.0,
                    ),
                    Parameter(
                        f"{name}_lag",
                        "s",
                        f"time constant of the {name}",
                        0.1 if pedal else 0.0,
                        0.0,
                        2.0,
                        pedal,
                        0.05,
                        usual=6.0,
                    ),
                ]
        return tuple(found)

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Position of the throttle or drive force [N], brake force [N], sine of the grade."""
        step, found = float(times[1] - times[0]), []
        zero = np.zeros(len(times))
        for name, kind, channels in (("drive", self._drive, _DRIVE), ("brake", self._brake, _BRAKE)):
            if kind == "none":
                found.append(zero)
                continue
            wide, early = drive.with_history(times)
            values = drive.at(channels[kind], wide, p[f"{name}_delay"])
            if kind == "torque":
                values = (values if name == "drive" else np.abs(values)) / p["wheel_radius"]
            elif kind == "pedal":
                values = values * p["brake_force"]
            found.append(first_order(values, step, p[f"{name}_lag"])[early:])
        found.append(np.sin(drive.at("grade", times)) if self._grade else zero)
        return np.stack(found)

    def _acceleration(self, x: Array, u: Array, p: Values) -> Array:
        v, m = x[0], p["mass"]
        push = u[0]
        if self._drive == "throttle":
            force, power = p["drive_force"], p["drive_power"]
            # A soft minimum of force and power over speed.
            push = push * force / np.sqrt(1.0 + (force * v / power) ** 2)
        against = u[1] + p["rolling_resistance"] * m * GRAVITY + p["viscous_resistance"] * np.abs(v)
        slope = m * GRAVITY * (u[2] + p["slope"])
        total = push - against * np.tanh(v / _STAND) - p["drag"] * v * np.abs(v) - slope
        return np.asarray(total / (m + p["rotating_mass"]))

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Of the speed."""
        return self._acceleration(x, u, p)[None]

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Speed and acceleration."""
        return np.stack(
            [self._acceleration(x, u, p) if name == "longitudinal_acceleration" else x[0] for name in self.outputs]
        )

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """The speed as measured."""
        del p
        seen = drive.outputs.get(self._speed)
        if seen is None:
            return np.full((1, len(rows)), 10.0)
        good = np.isfinite(seen)
        return np.interp(rows, np.flatnonzero(good), seen[good])[None]

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """What the road sees: decelerations, as the mass and what turns with it are in all forces."""
        mass = p["mass"] + p["rotating_mass"]
        rolling = (p["rolling_resistance"] + p["slope"]) * p["mass"] * GRAVITY
        coasting = rolling + 400.0 * p["drag"] + 20.0 * p["viscous_resistance"]
        found = {"deceleration without pedals at 20 m/s": (coasting / mass, "m/s^2")}
        if "brake_force" in p:
            braking = "deceleration of a full pedal, with rolling resistance"
            found[braking] = ((p["brake_force"] + rolling) / mass, "m/s^2")
            found["brake delay and lag together"] = (p["brake_delay"] + p["brake_lag"], "s")
        return found

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Rolling resistance of tyres on roads, drag of vehicles over their mass."""
        ranges = {"rolling_resistance": (0.001, 0.1), "drag": (2e-5 * p["mass"], 0.002 * p["mass"])}
        return ranges.get(name, (-np.inf, np.inf))

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """What nobody gave, and resistance over speed.

        Wheels alone are worth some 4 % of the mass of a car (T. D. Gillespie, Fundamentals of Vehicle Dynamics, 1992,
        chapter 2). That a road is flat to 0.1 %, and that bearings, seals and tyres lose a fifth of the rolling
        resistance more at 20 m/s, are assumptions of ours.
        """
        found = []

        def assumption(name: str, size: float, words: str, remedy: str) -> None:
            if name in assumed:
                found.append(Assumption(words, remedy, {name: p[name] + SMALL * size}, SMALL))

        assumption("rotating_mass", _TURNING * p["mass"], "what the turning masses are worth", "give rotating_mass")
        if not self._grade:
            assumption("slope", _SLOPE, "the slope of the road", "drive both ways, or give the slope")
        if "viscous_resistance" in assumed:
            size = _VISCOUS * p["rolling_resistance"] * p["mass"] * GRAVITY
            found.append(
                Assumption(
                    "whether resistance grows with speed",
                    "free viscous_resistance",
                    {"viscous_resistance": p["viscous_resistance"] + PART * size},
                    PART,
                    is_omitted=True,
                )
            )
        return tuple(found)

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        if names & {"brake_force", "brake_delay", "brake_lag"}:
            return "brake in several steps of the pedal"
        if names & {"drag", "rolling_resistance", "viscous_resistance", "slope"}:
            return "do a coast-down from a high speed to a low one, both ways"
        return "do steps of the throttle from different speeds"

"""Longitudinal motion: drive force, brakes, rolling resistance, drag and grade.

::

    (m + mr) v̇ = Fd - (Fb + c m g + B |v|) tanh(v / 0.1 m/s) - D v |v| - m g (sin γ + γ0)

Fd is the drive force: pedal position times min(F, P / v), or the measured wheel torque over the wheel radius. Fb is the
brake force from the pedal or a torque. Each has a dead time and a first-order lag. D is half the air density times the
drag area. Without a mass, forces are per kilogram.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.models.base import (
    OMITTED_FRACTION,
    SMALL_FRACTION,
    SPEED,
    Array,
    Assumption,
    ModelOptions,
    Segment,
    Values,
    find_channel,
    select_outputs,
)
from mirdrake.identification.models.equations import EquationModel
from mirdrake.identification.models.filters import first_order
from mirdrake.identification.models.manoeuvres import longitudinal_manoeuvres
from mirdrake.identification.parameters import Parameter

_DRIVE = {"throttle": "throttle", "torque": "drive_torque"}
_BRAKE = {"pedal": "brake", "torque": "brake_torque"}
_STANDSTILL = 0.1  # speed below which resistances fade [m/s]
_ROTATING = 0.03  # standard deviation of the rotating mass over the mass [1]
_SLOPE = 0.001  # standard deviation of the slope of a road taken as level [1]
_VISCOUS = 0.01  # standard deviation of the viscous resistance over the rolling resistance force [s/m]


class LongitudinalOptions(ModelOptions):
    """Options of the longitudinal model."""

    drive: Literal["throttle", "torque", "none"] | None = Field(
        default=None, description="signal of the drive force; the first one logged, in this order, if left out [-]"
    )
    brake: Literal["pedal", "torque", "none"] | None = Field(
        default=None, description="signal of the brakes; the first one logged, unless the wheel torque has it [-]"
    )
    outputs: list[str] | None = Field(default=None, description="channels to compare; all if left out [-]")


class LongitudinalModel(EquationModel):
    """Longitudinal motion; the equations are in the docstring of the module.

    Raises:
        ConfigError: a channel is missing.
    """

    kind = "longitudinal"
    data_parameters = ("mass",)
    Options = LongitudinalOptions

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: LongitudinalOptions
    ) -> None:
        del wheelbase
        drive: str | None = options.drive
        brake: str | None = options.brake
        # The first channel of the log in the order of preference, if the study does not choose.
        if drive is None:
            drive = next((name for name, channel in _DRIVE.items() if channel in channels), "none")
        if brake is None:  # a measured wheel torque includes the brake torque
            usable = drive != "torque"
            brake = next((name for name, channel in _BRAKE.items() if channel in channels and usable), "none")
        for name, value, signals in (("drive", drive, _DRIVE), ("brake", brake, _BRAKE)):
            if value != "none":
                find_channel(channels, (signals[value],), f"the {name}", self.kind)
        self._drive, self._brake = drive, brake
        self.title = f"longitudinal, drive {drive}, brake {brake}"
        self._speed = find_channel(channels, SPEED, "the speed", self.kind)
        self._grade = "grade" in channels
        inputs = (_DRIVE.get(self._drive, ""), _BRAKE.get(self._brake, ""), "grade" if self._grade else "")
        self.inputs = tuple(name for name in inputs if name)
        self.states, self.state_scales = ("vx",), (1.0,)
        self.outputs = select_outputs(channels, [self._speed, "longitudinal_acceleration"], options.outputs, self.kind)
        # Parameters that change the inputs are named, because only these make the inputs be computed again.
        self.input_parameters = frozenset(
            {"drive_force", "drive_delay", "drive_lag", "brake_force", "brake_delay", "brake_lag", "wheel_radius"}
        )
        self.parameters = self._make_parameters(known)

    def _make_parameters(self, known: Mapping[str, float]) -> tuple[Parameter, ...]:
        # Speeds alone determine forces over mass only; without a mass all forces are per kilogram.
        bare = "mass" not in known
        # Without a mass only ratios to it are identifiable: mass 1 makes all forces per kilogram.
        m = known.get("mass", 1.0)
        force, mass, per = ("N/kg", "1", " per kg") if bare else ("N", "kg", "")
        source = "not given: forces are per kilogram" if bare else ""
        parameters = [
            Parameter("mass", mass, "mass of the vehicle", m, 1e-3, 1e6, source=source),
            Parameter("rotating_mass", mass, "equivalent mass of rotating parts" + per, 0.0, 0.0, m, scale=0.05 * m),
            Parameter("rolling_resistance", "1", "rolling resistance over weight", 0.01, 0.0, 0.5, True, 0.005,
                      usual=6.0),
            Parameter("drag", f"{force} s^2/m^2", "drag over speed squared, half the air density times the drag area",
                      2.5e-4 * m, 0.0, 0.05 * m, True, 2e-4 * m, usual=6.0),
            Parameter("viscous_resistance", f"{force} s/m", "resistance over speed", 0.0, -0.1 * m, 0.5 * m,
                      scale=2e-3 * m, usual=6.0),
            Parameter("slope", "1", "slope of the road not contained in 'grade'", 0.0, -0.3, 0.3, scale=0.005,
                      usual=4.0),
        ]  # fmt: skip
        # Full throttle is limited by force at low and by power at high speed, see the equations.
        if self._drive == "throttle":
            parameters += [
                Parameter("drive_force", force, "drive force at full throttle and low speed", 4.0 * m, 0.01 * m,
                          50.0 * m, True, usual=1.0),
                Parameter("drive_power", force.replace("N", "W"), "drive power at full throttle and high speed",
                          80.0 * m, 0.01 * m, 5e3 * m, True, usual=1.5),
            ]  # fmt: skip
        if self._brake == "pedal":
            parameters.append(
                Parameter("brake_force", force, "force at full pedal", 8.0 * m, 0.05 * m, 50.0 * m, True, usual=1.0)
            )
        if "torque" in {self._drive, self._brake}:
            wheels = "radius of the driven wheels" if self._drive == "torque" else "radius of the wheels"
            parameters.append(Parameter("wheel_radius", "m", wheels, 0.33, 0.01, 2.0, usual=0.3))
        for name, kind in (("drive", self._drive), ("brake", self._brake)):
            if kind != "none":
                pedal = kind in {"throttle", "pedal"}
                # A measured torque acts at once; behind a pedal there are engine, motor or hydraulics.
                delay, lag = (0.05, 0.1) if pedal else (0.0, 0.0)
                parameters += [
                    Parameter(f"{name}_delay", "s", f"dead time of the {name}", delay, -0.1, 1.0, pedal, 0.05,
                              usual=4.0),
                    Parameter(f"{name}_lag", "s", f"time constant of the {name}", lag, 0.0, 2.0, pedal, 0.05,
                              usual=6.0),
                ]  # fmt: skip
        return tuple(parameters)

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return throttle position or drive force [N], brake force [N] and sine of the grade."""
        step, signals = float(times[1] - times[0]), []
        zero = np.zeros(len(times))
        for name, kind, channels in (("drive", self._drive, _DRIVE), ("brake", self._brake, _BRAKE)):
            if kind == "none":
                signals.append(zero)
                continue
            wide, early = drive.with_history(times)
            values = drive.at(channels[kind], wide, p[f"{name}_delay"])
            if kind == "torque":
                # Recorders disagree on the sign of brake torques; a negative drive torque is braking by the motor.
                values = (values if name == "drive" else np.abs(values)) / p["wheel_radius"]
            elif kind == "pedal":
                values = values * p["brake_force"]
            signals.append(first_order(values, step, p[f"{name}_lag"])[early:])
        signals.append(np.sin(drive.at("grade", times)) if self._grade else zero)
        return np.stack(signals)

    def input_memory(self, p: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return dead times and lags of drive and brake."""
        sources = (("drive", self._drive, _DRIVE), ("brake", self._brake, _BRAKE))
        return {
            channels[kind]: (p[f"{name}_delay"], p[f"{name}_lag"]) for name, kind, channels in sources if kind != "none"
        }

    def _acceleration(self, x: Array, u: Array, p: Values) -> Array:
        v, m = x[0], p["mass"]
        push = u[0]
        if self._drive == "throttle":
            force, power = p["drive_force"], p["drive_power"]
            # A smooth minimum of force and power over speed has no corner at which a search would stop.
            push = push * force / np.sqrt(1.0 + (force * v / power) ** 2)
        # Brakes and rolling resistance act against the motion; tanh avoids the jump of the sign at standstill.
        resistance = u[1] + p["rolling_resistance"] * m * GRAVITY + p["viscous_resistance"] * np.abs(v)
        slope = m * GRAVITY * (u[2] + p["slope"])
        total = push - resistance * np.tanh(v / _STANDSTILL) - p["drag"] * v * np.abs(v) - slope
        return np.asarray(total / (m + p["rotating_mass"]))

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Return the acceleration."""
        return self._acceleration(x, u, p)[None]

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Return speed and acceleration."""
        return np.stack(
            [self._acceleration(x, u, p) if name == "longitudinal_acceleration" else x[0] for name in self.outputs]
        )

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Return the measured speed."""
        del p
        seen = drive.outputs.get(self._speed)
        if seen is None:
            return np.full((1, len(rows)), 10.0)
        good = np.isfinite(seen)
        return np.interp(rows, np.flatnonzero(good), seen[good])[None]

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Return decelerations, which do not depend on the assumed masses."""
        mass = p["mass"] + p["rotating_mass"]
        rolling = (p["rolling_resistance"] + p["slope"]) * p["mass"] * GRAVITY
        # 20 m/s: 400 is its square.
        coasting = rolling + 400.0 * p["drag"] + 20.0 * p["viscous_resistance"]
        quantities = {"deceleration without pedals at 20 m/s": (coasting / mass, "m/s^2")}
        if "brake_force" in p:
            braking = "deceleration at full pedal, with rolling resistance"
            quantities[braking] = ((p["brake_force"] + rolling) / mass, "m/s^2")
            quantities["brake delay plus lag"] = (p["brake_delay"] + p["brake_lag"], "s")
        return quantities

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Return the usual range of rolling resistance, and of drag over mass."""
        ranges = {"rolling_resistance": (0.001, 0.1), "drag": (2e-5 * p["mass"], 0.002 * p["mass"])}
        return ranges.get(name, (-np.inf, np.inf))

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """Return default values and the omitted viscous resistance.

        The wheels of a car are worth some 4 % of its mass (T. D. Gillespie, Fundamentals of Vehicle Dynamics, 1992,
        chapter 2). That a road is level to 0.1 %, and that bearings, seals and tyres lose a fifth of the rolling
        resistance more at 20 m/s, are assumptions of ours.
        """
        sizes = [
            ("rotating_mass", _ROTATING * p["mass"], "the mass of rotating parts", "give rotating_mass"),
            ("slope", _SLOPE, "the slope of the road", "drive in both directions, or give the slope"),
        ]
        assumptions = [
            Assumption(description, remedy, {name: p[name] + SMALL_FRACTION * size}, SMALL_FRACTION)
            # A logged grade leaves no slope to be assumed.
            for name, size, description, remedy in (sizes[:1] if self._grade else sizes)
            if name in assumed
        ]
        if "viscous_resistance" in assumed:
            size = _VISCOUS * p["rolling_resistance"] * p["mass"] * GRAVITY
            changes = {"viscous_resistance": p["viscous_resistance"] + OMITTED_FRACTION * size}
            words = "whether resistance grows with speed", "free viscous_resistance"
            assumptions.append(Assumption(*words, changes, OMITTED_FRACTION, is_omitted=True))
        return tuple(assumptions)

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which drive would identify these parameters."""
        del drives
        if names & {"brake_force", "brake_delay", "brake_lag"}:
            return "brake in several steps of the pedal"
        if names & {"drag", "rolling_resistance", "viscous_resistance", "slope"}:
            return "do a coast-down from a high speed to a low one, in both directions"
        return "do throttle steps from different speeds"

    def candidate_manoeuvres(self, p: Mapping[str, float], speed: float) -> dict[str, dict[str, Array]]:
        """Return coast-down, throttle steps and brake steps, if the pedals are the inputs."""
        del p
        return longitudinal_manoeuvres(speed) if set(self.inputs) <= {"throttle", "brake"} else {}

    @classmethod
    def is_default_for(cls, channels: set[str]) -> bool:
        """Whether there are a speed and a pedal or torque."""
        return bool(channels & {*SPEED} and channels & {"throttle", "brake", "drive_torque", "brake_torque"})

"""Lateral motion of a single track over the recorded speed: linear, Fiala or Magic Formula tyres, with or without roll.

The equations of :mod:`mirdrake.single_track.dynamics` with the speed as an input, so that drive and brakes need not be
known. Velocities vy and yaw rate r are of the centre of mass, δ the angle of the front wheels::

    m (v̇y + vx r) = Ff cos δ + Fr       Iz ṙ = a Ff cos δ - b Fr
    αf = atan((vy + a r) / vx) - δ       αr = atan((vy - b r) / vx)

    linear          F = -C α
    fiala           F = -C tan α (1 - s + s²/3), s = C |tan α| / (3 μ N); -μ N sign α where s > 1
    magic_formula   F = -μ N sin(c atan(B α - E (B α - atan B α))), B = C / (c μ N)

Roll, an option, follows the lateral acceleration; the front wheels may steer with it, and an accelerometer on the body
sees a part of gravity and of its own sway::

    φ̈ = ω² (g_φ ay - φ) - 2 ζ ω φ̇        ay_seen = ay + l ṙ - h φ̈ + i g φ

Below the speed v1 = 0.2 sqrt(g L) the car goes where its wheels point, from 3 v1 on as above, between them mixed.
Without a mass, stiffnesses and inertia are per kilogram: that is all that motion tells.
"""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirdrake.errors import ConfigError, did_you_mean
from mirdrake.identification.models.base import Array, Drive, Model, Values, channel_of
from mirdrake.identification.models.steer import NAMES, STEERING, steering_angle, steering_parameters
from mirdrake.identification.parameters import Parameter
from mirdrake.worlds.world import GRAVITY

TYRES = ("linear", "fiala", "magic_formula")
SPEED = ("vx", "speed")
_FROUDE, _BLEND = 0.2, 0.05
_FINE = 0.03  # step of the integration over sqrt(L / g) [1]
_CORNERING = 12.0  # cornering stiffness over load, a common tyre [1/rad]


class SingleTrackModel(Model):
    """See the head of the module.

    Args:
        offered: channels that all logs have.
        given: what is known of parameters, by name: values of the study or the vehicle.
        wheelbase: of the data set [m].
        tyres: one of :data:`TYRES`.
        roll: whether the body rolls.
        outputs: channels to compare; None: all that there are.

    Raises:
        ConfigError: a channel is missing, or an option unknown.
    """

    def __init__(
        self,
        offered: set[str],
        given: Mapping[str, float],
        wheelbase: float | None,
        *,
        tyres: str = "linear",
        roll: bool = False,
        outputs: list[str] | None = None,
    ) -> None:
        if tyres not in TYRES:
            raise ConfigError(f"model.tyres: unknown tyres '{tyres}'; {did_you_mean(tyres, TYRES)}")
        self.kind = "single_track_roll" if roll else "single_track"
        self.title = f"single track with {tyres.replace('_', ' ')} tyres" + (" and roll" if roll else "")
        self._tyres, self._roll = tyres, roll
        self._steer = channel_of(offered, STEERING, "the steering", self.kind)
        self._speed = channel_of(offered, SPEED, "the speed", self.kind)
        self.inputs = (self._steer, self._speed)
        self.states, self.state_scales = ("vy", "yaw_rate"), (0.5, 0.2)
        possible = ["yaw_rate", "lateral_acceleration", "vy"]
        if roll:
            self.states += ("roll", "roll_rate")
            self.state_scales += (0.05, 0.3)
            possible += ["roll", "roll_rate"]
        self.outputs = pick_outputs(offered, possible, outputs, self.kind)
        self.through = NAMES
        self.parameters = self._make(given, wheelbase)
        p = {info.name: info.guess for info in self.parameters}
        length = p["front_length"] + p["rear_length"]
        self._v1 = _FROUDE * (GRAVITY * length) ** 0.5
        # Slip of stiff tyres at 3 v1 settles at some 60 sqrt(g / L); Runge-Kutta needs steps of less than 2.8 of it.
        self.fine = min(self.fine, _FINE * (length / GRAVITY) ** 0.5)

    def _make(self, given: Mapping[str, float], wheelbase: float | None) -> tuple[Parameter, ...]:
        lengths = [given.get("front_length"), given.get("rear_length")]
        total = wheelbase or given.get("assumed_wheelbase", 2.7)
        said = "half of the given wheelbase" if wheelbase else "assumed, no wheelbase is given"
        front = lengths[0] or (max(total - lengths[1], 0.1 * total) if lengths[1] else 0.5 * total)
        rear = lengths[1] or (max(total - front, 0.1 * total) if lengths[0] else 0.5 * total)
        mass = given.get("mass", 1.0)
        bare = "mass" not in given
        loads = (mass * GRAVITY * rear / (front + rear), mass * GRAVITY * front / (front + rear))
        per = " per kg" if bare else ""
        stiff, inert = ("N/(rad kg)", "m^2") if bare else ("N/rad", "kg m^2")
        name = "cornering stiffness of the {} axle, both tyres" + per
        found = [
            Parameter(
                "mass",
                "1" if bare else "kg",
                "of the vehicle",
                mass,
                1e-3,
                1e6,
                source="not given: stiffness and inertia are per kilogram" if bare else "",
            ),
            Parameter("front_length", "m", "centre of mass to front axle", front, 0.01, 20.0, source=said),
            Parameter("rear_length", "m", "centre of mass to rear axle", rear, 0.01, 20.0, source=said),
            Parameter(
                "cornering_stiffness_front",
                stiff,
                name.format("front"),
                _CORNERING * loads[0],
                0.3 * loads[0],
                500.0 * loads[0],
                True,
                usual=1.0,
            ),
            Parameter(
                "cornering_stiffness_rear",
                stiff,
                name.format("rear"),
                _CORNERING * loads[1],
                0.3 * loads[1],
                500.0 * loads[1],
                True,
                usual=1.0,
            ),
            Parameter(
                "yaw_inertia",
                inert,
                "about the vertical" + per,
                mass * front * rear,
                0.05 * mass * front * rear,
                20.0 * mass * front * rear,
                True,
                usual=0.7,
            ),
            *steering_parameters(self._steer),
            Parameter(
                "accelerometer_ahead",
                "m",
                "accelerometer before the centre of mass",
                0.0,
                -10.0,
                10.0,
                "lateral_acceleration" in self.outputs,
                0.2 * (front + rear),
                usual=1.5,
            ),
            Parameter(
                "velocity_ahead",
                "m",
                "place of the measured vy before the centre of mass",
                0.0,
                -10.0,
                10.0,
                "vy" in self.outputs,
                0.2 * (front + rear),
                usual=1.5,
            ),
        ]
        if self._tyres != "linear":
            found += [
                Parameter(f"friction_{axle}", "1", f"largest force over load, {axle}", 0.9, 0.05, 3.0, True, usual=0.7)
                for axle in ("front", "rear")
            ]
        if self._tyres == "magic_formula":
            for axle in ("front", "rear"):
                found.append(Parameter(f"shape_{axle}", "1", f"shape factor C, {axle}", 1.4, 1.0, 2.5, usual=0.3))
                found.append(
                    Parameter(
                        f"curvature_{axle}", "1", f"curvature factor E, {axle}", 0.0, -10.0, 0.99, scale=0.5, usual=2.0
                    )
                )
        if self._roll:
            found += [
                Parameter(
                    "roll_gain", "rad s^2/m", "roll angle over lateral acceleration", 0.01, 1e-4, 0.1, True, usual=1.0
                ),
                Parameter("roll_frequency", "rad/s", "natural frequency of roll", 9.0, 1.0, 60.0, True, usual=0.7),
                Parameter("roll_damping", "1", "damping ratio of roll", 0.3, 0.02, 3.0, True, usual=1.0),
                Parameter(
                    "roll_steer", "1", "steering of the front wheels over roll", 0.0, -1.0, 1.0, scale=0.05, usual=2.0
                ),
                Parameter("roll_steer_rear", "1", "the same at the rear", 0.0, -1.0, 1.0, scale=0.05, usual=2.0),
                Parameter(
                    "accelerometer_height",
                    "m",
                    "accelerometer over the roll axis",
                    0.0,
                    -5.0,
                    5.0,
                    scale=0.3,
                    usual=2.0,
                ),
                Parameter(
                    "accelerometer_tilt",
                    "1",
                    "1: it leans with the body, 0: it is levelled",
                    0.0,
                    -1.0,
                    2.0,
                    scale=0.3,
                    usual=2.0,
                ),
            ]
        return tuple(found)

    def drive(self, p: Mapping[str, float], drive: Drive, times: Array) -> Array:
        """Angle of the wheels [rad] and speed [m/s]."""
        return np.stack((steering_angle(p, drive, self._steer, times), drive.at(self._speed, times)))

    def _forces(self, x: Array, u: Array, p: Values) -> tuple[Array, Array, Array]:
        """Lateral forces of the axles [N], and the angle of the front wheels [rad]."""
        delta, v = u[0], np.maximum(u[1], self._v1)
        if self._roll:
            delta = delta + p["roll_steer"] * x[2]
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        rear = np.arctan((x[0] - b * x[1]) / v)
        if self._roll:
            rear = rear - p["roll_steer_rear"] * x[2]
        slips = (np.arctan((x[0] + a * x[1]) / v) - delta, rear)
        loads = (m * (GRAVITY / (a + b)) * b, m * (GRAVITY / (a + b)) * a)
        forces = [
            self._force(axle, slip, load, p) for axle, slip, load in zip(("front", "rear"), slips, loads, strict=True)
        ]
        return forces[0], forces[1], delta

    def _force(self, axle: str, slip: Array, load: Any, p: Values) -> Array:
        stiffness = p[f"cornering_stiffness_{axle}"]
        if self._tyres == "linear":
            return np.asarray(-stiffness * slip)
        peak = p[f"friction_{axle}"] * load
        if self._tyres == "fiala":
            tangent = np.tan(slip)
            share = stiffness * np.abs(tangent) / (3.0 * peak)
            stuck = np.minimum(share, 1.0)
            return np.asarray(-stiffness * tangent * (1.0 - stuck + stuck * stuck / 3.0) / np.maximum(share, 1.0))
        shape, bend = p[f"shape_{axle}"], p[f"curvature_{axle}"]
        slope = stiffness / (shape * peak) * slip
        return np.asarray(-peak * np.sin(shape * np.arctan(slope - bend * (slope - np.arctan(slope)))))

    def _accelerations(self, x: Array, u: Array, p: Values) -> tuple[Array, Array]:
        """Lateral acceleration of the centre of mass [m/s²] and yaw acceleration [rad/s²]."""
        front, rear, delta = self._forces(x, u, p)
        front = front * np.cos(delta)
        side, turn = (
            (front + rear) / p["mass"],
            (p["front_length"] * front - p["rear_length"] * rear) / p["yaw_inertia"],
        )
        vx, low = u[1], self._v1
        part = (vx * vx - low * low) / (8.0 * low * low)
        if np.min(part) >= 1.0:
            return side, turn
        part = np.clip(part, 0.0, 1.0)
        weigh = part * part * (3.0 - 2.0 * part)
        spin = vx * np.tan(delta) / (p["front_length"] + p["rear_length"])
        slow_turn, slow_vy = (spin - x[1]) / _BLEND, (p["rear_length"] * spin - x[0]) / _BLEND
        slow_side = slow_vy + x[1] * vx
        return slow_side + weigh * (side - slow_side), slow_turn + weigh * (turn - slow_turn)

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Of vy, yaw rate, and roll."""
        side, turn = self._accelerations(x, u, p)
        found = [side - x[1] * u[1], turn]
        if self._roll:
            found += [x[3], self._roll_acceleration(x, side, p)]
        return np.stack(found)

    def _roll_acceleration(self, x: Array, side: Array, p: Values) -> Array:
        natural = p["roll_frequency"]
        return np.asarray(natural * (natural * (p["roll_gain"] * side - x[2]) - 2.0 * p["roll_damping"] * x[3]))

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """The outputs in their order."""
        found = []
        for name in self.outputs:
            if name == "yaw_rate":
                found.append(x[1])
            elif name == "vy":
                found.append(x[0] + p["velocity_ahead"] * x[1])
            elif name in {"roll", "roll_rate"}:
                found.append(x[2 if name == "roll" else 3])
            else:
                side, turn = self._accelerations(x, u, p)
                seen = side + p["accelerometer_ahead"] * turn
                if self._roll:
                    sway = self._roll_acceleration(x, side, p)
                    seen = seen - p["accelerometer_height"] * sway + p["accelerometer_tilt"] * GRAVITY * x[2]
                found.append(seen)
        return np.stack(found)

    def start(self, p: Mapping[str, float], drive: Drive, rows: NDArray[np.intp]) -> Array:
        """Yaw rate as measured; vy as measured, or that of a slow turn."""
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        v = np.maximum(drive.inputs[self._speed][rows], self._v1)
        delta = drive.inputs[self._steer][rows] / p["steering_ratio"] + p["steering_offset"]
        spin = v * delta / (a + b)
        seen = drive.outputs.get("yaw_rate")
        if seen is not None:
            near = np.clip(rows, 3, drive.size - 4)[:, None] + np.arange(-3, 4)  # a glitch is no state
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # nothing but gaps
                middle = np.nanmedian(seen[near], axis=1)
            spin = np.where(np.isfinite(middle), middle, spin)
        side = b * spin - m * a * v * v * spin / ((a + b) * p["cornering_stiffness_rear"])
        found = [side, spin]
        if self._roll:
            found += [p["roll_gain"] * v * spin, np.zeros(len(rows))]
        return np.stack(found)

    def derived(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Understeer gradient and what else a slow drive shows."""
        a, b, m, length = p["front_length"], p["rear_length"], p["mass"], p["front_length"] + p["rear_length"]
        front, rear = p["cornering_stiffness_front"], p["cornering_stiffness_rear"]
        gradient = m / length * (b / front - a / rear)
        return {
            "understeer gradient": (gradient, "rad s^2/m"),
            "understeer gradient times steering ratio": (gradient * p["steering_ratio"], "rad s^2/m"),
            "steering ratio times wheelbase": (p["steering_ratio"] * length, "m"),
            "mass over sum of stiffnesses": (m / (front + rear), "rad s^2/m"),
            "sideslip gradient m a / (L Cr)": (m * a / (length * rear), "rad s^2/m"),
            "front stiffness over yaw inertia": (front / p["yaw_inertia"], "1/(m rad s^2)"),
            "steering delay and lag together": (p["steering_delay"] + p["steering_lag"], "s"),
        }

    def plausible(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Stiffness over load of road tyres is 4 to 40 1/rad, and the radius of gyration goes with the axles."""
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        load = m * GRAVITY / (a + b)
        ranges = {
            "cornering_stiffness_front": (2.0 * load * b, 45.0 * load * b),
            "cornering_stiffness_rear": (2.0 * load * a, 45.0 * load * a),
            "yaw_inertia": (0.3 * m * a * b, 3.0 * m * a * b),
            "friction_front": (0.1, 2.0),
            "friction_rear": (0.1, 2.0),
        }
        return ranges.get(name, (-np.inf, np.inf))

    def remedy(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        stiff = {"cornering_stiffness_front", "cornering_stiffness_rear"}
        if names & {"friction_front", "friction_rear"} or any(
            name.startswith(("shape", "curvature")) for name in names
        ):
            return "drive a ramp of the steering to the limit of the tyres"
        if "steering_ratio" in names:
            return "do slow turns and fast turns: the ratio shows at walking pace, the stiffness at speed"
        if names & {"steering_delay", "steering_lag"}:
            return "do step steers, or a sweep to 3 Hz"
        if names & stiff:
            return "do a step steer at two speeds, and record the lateral velocity if possible"
        return "do a step steer or a sweep to 2 Hz" if "yaw_inertia" in names else "turn left and right alike"


def pick_outputs(offered: set[str], possible: list[str], asked: list[str] | None, kind: str) -> tuple[str, ...]:
    """The channels to compare.

    Raises:
        ConfigError: one that was asked for is missing or unknown, or there is none at all.
    """
    for name in asked or []:
        if name not in possible:
            raise ConfigError(f"model.outputs: {kind} has no output '{name}'; {did_you_mean(name, possible)}")
        if name not in offered:
            raise ConfigError(f"model.outputs: no log has '{name}'; map its column in 'channels'")
    found = tuple(name for name in possible if name in offered and (asked is None or name in asked))
    if not found:
        raise ConfigError(f"model {kind}: needs at least one of {', '.join(possible)} to compare with; map its column")
    return found

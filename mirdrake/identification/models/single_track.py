"""Lateral motion of a single track over the recorded speed: linear, Fiala or Magic Formula tyres, with or without roll.

The equations of :mod:`mirdrake.single_track.dynamics` with the speed as an input, so that drive and brakes need not be
known. Velocities vy and yaw rate r are of the centre of mass, δ the angle of the front wheels::

    m (v̇y + vx r) = Ff cos δ + Fr       (Iz + J) ṙ = a Ff cos δ - b Fr
    αf = atan((vy + a r) / vx) - δ       αr = atan((vy - b r) / vx)

    linear          F = -C α
    fiala           F = -C tan α (1 - s + s²/3), s = C |tan α| / (3 μ N); -μ N sign α where s > 1
    magic_formula   F = -μ N sin(c atan(B α - E (B α - atan B α))), B = C / (c μ N)

J is what spinning wheels resist, since those outside of a bend turn faster: 1 % of Iz, where it is known. So is the
inertia I of what is steered; the moment that turns it, I δ̈, the car has in the other direction.

Roll, an option, follows the lateral acceleration; the front wheels may steer with it, and an accelerometer on the body
sees a part of gravity and of its own sway. A damper c between spring and bar k and the tyres' own kt behind them works
late, by τd = c / (k + kt) and more where wheels swing, on a rate p; τd = 0 if it is not given::

    φ̈ = ω² (g_φ q - φ) - 2 ζ ω p        τd ṗ = φ̇ - p        ay_seen = ay + l ṙ + (h - z) φ̈ + i g φ

Spinning wheels that yaw, and those in front that are steered, are gyroscopes that roll the body beside the forces of
the tyres. With their angular momentum H vx, half of it in front, what rolls it is, as an acceleration::

    q = (m h ay + H vx (r + δ̇ / 2)) / (m h + H)

The centre of mass is h above the roll axis, the accelerometer z. vy is that of the point below the centre of mass on
the axis, near the road, where the tyres are: with ay = (Ff + Fr) / m of the centre of mass itself it is
v̇y + vx r = ay + h φ̈, as in :mod:`mirdrake.single_track.dynamics`. Leaning wheels have camber thrust and may steer,
which is slip over roll: e φ of an axle.

Relaxation, another option: what the force of an axle answers is not its slip α but one that follows it while the tyre
rolls over its relaxation length σ: α̇' = vx (α - α') / σ. At 20 m/s that is some 20 ms. Without it the fit of a quick
steering takes it for yaw inertia and a delay of the steering. The forces then act behind the wheels by the tyres'
pneumatic trail t: a - t and b + t stand for a and b. Where there is roll, the moment has N φ - H vx φ̇ more: leaning
wheels have a moment beside that of their thrust, those outside of a bend have more rolling resistance, and wheels that
roll with the body are a gyroscope as well.

What steers the wheels gives way to their moments, which counts where its command is recorded and not their angle. With
the compliance s of a spring and a damper whose time is τ, the moment M φ of leaning and the inertia I of what is
steered, the front wheels are at δ + y::

    τ ẏ = s (-t Ff + M φ - H vx φ̇ / 2 - I (δ̈ + ṙ)) - y

Where the vehicle brakes its front tyres carry more, and turn it in more: stiffness and largest force of each axle go
with its load. The load transfer h, an option, is the height of the centre of mass if they are proportional to it, and
less if they grow more slowly::

    Nf = m g b / L - h (m dvx/dt + D vx²) / L        Nr = m g a / L + h (m dvx/dt + D vx²) / L

with the drag D vx² that pulls at the centre of mass, where it is known. Front wheels pull to where they point, with
f (m dvx/dt + D vx²) sin δ to the side, f being their part of the drive, or of the braking. At full lock that is a third
of it: left out, it looks like a steering that is late, and a small yaw inertia. The force X along a wheel takes its
share of the friction first: lateral forces are √(1 - X² / μ² N²) of those above, and at least 0.3.

Below the speed v1 = 0.2 sqrt(g L) the car goes where its wheels point, from 3 v1 on as above, between them mixed.
Without a mass, stiffnesses and inertia are per kilogram: that is all that motion tells.
"""

import math
import warnings
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

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
    pick_outputs,
)
from mirdrake.identification.models.single_track_parameters import DELAYS, RELAXATION, single_track_parameters
from mirdrake.identification.models.steer import AHEAD, STEERING, STEERING_PARAMETERS, steering_angle

AXLES = ("front", "rear")
TYRES = ("linear", "fiala", "magic_formula")
SPEED = ("vx", "speed")
_FROUDE, _BLEND = 0.2, 0.05
_FINE = 0.03  # step of the integration over sqrt(L / g) [1]
_SMOOTHING = 0.1  # of the speed, before it is differentiated [s]
_LIGHTEST = 0.1  # an axle keeps so much of its load [1]
_LEAST_GRIP = 0.3  # and so much of its friction to the side, however it drives or brakes [1]
_CENTRE = 0.05  # standard deviation of the centre of mass that is not known, over the wheelbase [1]
_SIZE = 0.1  # of the wheelbase that is not known, over itself [1]
_TRAIL = 0.013  # pneumatic trail over wheelbase [1]: 35 mm for a car
_FRICTION = 0.9  # of a dry road [1]
_CURVATURE = -1.0  # factor E at no slip of a 205/60R15: Pacejka, Tyre and Vehicle Dynamics, 2nd ed., table A3.1 [1]
_HEIGHT, _HIGHEST = 0.2, 0.5  # of the centre of mass over the wheelbase, usual and most [1]
_LAG = 0.05  # of a steering [s]
_DRIVE, _BRAKE = 0.5, 0.25  # standard deviations of what part of drive and braking front wheels have [1]
_LATENESS = 0.01  # of the instrument of vy, a second one: a sample at 100 Hz [s]
_LATE = {channel: name for channel, name, _ in DELAYS}
_GAIN = 0.01  # of roll over lateral acceleration: 5.6 degrees at g [rad s^2/m]
_ROLL_STEER = 0.05  # of an axle over roll: half of what camber thrust is worth in the Ford Escort of CommonRoad [1]
_OF_ROLL = {
    "roll_gain", "roll_frequency", "roll_damping", "accelerometer_tilt", "accelerometer_height", "velocity_height",
}  # fmt: skip
_SLIPPING = 0.4
"""Least time in which slip builds up, over the step of the integration [1]."""


class SingleTrackModel(Model):
    """See the head of the module.

    Args:
        offered: channels that all logs have.
        given: what is known of parameters, by name: values of the study or the vehicle.
        wheelbase: of the data set [m].
        tyres: one of :data:`TYRES`.
        roll: whether the body rolls.
        relaxation: whether slip builds up over a length; "shared": over one for both axles; None: if lengths are given.
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
        tyres: str | None = None,
        roll: bool | None = None,
        relaxation: bool | str | None = None,
        outputs: list[str] | None = None,
    ) -> None:
        left = {"tyres": tyres, "roll": roll, "relaxation": relaxation}
        self._open = {name for name, value in left.items() if value is None}
        tyres = tyres or "linear"
        if tyres not in TYRES:
            raise ConfigError(f"model.tyres: unknown tyres '{tyres}'; {did_you_mean(tyres, TYRES)}")
        self.kind = "single_track_roll" if roll else "single_track"
        if relaxation is None:
            relaxation = bool(given.get("relaxation_front") or given.get("relaxation_rear"))
            self._open -= {"relaxation"} if relaxation else set()
        if not isinstance(relaxation, bool) and relaxation != "shared":
            raise ConfigError(f"model.relaxation: got '{relaxation}'; allowed: true, false, shared")
        self._lengths = ("relaxation",) * 2 if relaxation == "shared" else ("relaxation_front", "relaxation_rear")
        more = [word for word, there in (("relaxation", relaxation), ("roll", roll)) if there]
        self.title = f"single track with {tyres.replace('_', ' ')} tyres" + "".join(f" and {word}" for word in more)
        self._tyres, self._roll, self._relaxation = tyres, bool(roll), bool(relaxation)
        self._steer = channel_of(offered, STEERING, "the steering", self.kind)
        self._speed = channel_of(offered, SPEED, "the speed", self.kind)
        self.inputs = (self._steer, self._speed)
        self.states, self.state_scales = ("vy", "yaw_rate"), (0.5, 0.2)
        possible = ["yaw_rate", "lateral_acceleration", "vy"]
        if roll:
            self.states += ("roll", "roll_rate")
            self.state_scales += (0.05, 0.3)
            possible += ["roll", "roll_rate"]
        self._damped_late = bool(roll and given.get("roll_damper_time"))
        if self._damped_late:
            self.states += ("damper_rate",)
            self.state_scales += (0.3,)
        self._slips = len(self.states)
        if relaxation:
            self.states += ("slip_front", "slip_rear")
            self.state_scales += (0.02, 0.02)
        self._yields = bool(relaxation and given.get("steering_compliance"))
        if self._yields:
            self.states += ("steering_give",)
            self.state_scales += (0.002,)
        self.outputs = pick_outputs(offered, possible, outputs, self.kind)
        self.input_parameters = STEERING_PARAMETERS
        self.parameters = single_track_parameters(
            given, wheelbase, self._steer, outputs=self.outputs, tyres=tyres, roll=self._roll,
            relaxation=self._lengths if relaxation else (), yields=self._yields, damped_late=self._damped_late,
        )  # fmt: skip
        self._no_wheelbase = wheelbase is None and not (given.get("front_length") and given.get("rear_length"))
        p = {info.name: info.guess for info in self.parameters}
        length = p["front_length"] + p["rear_length"]
        self._v1 = _FROUDE * (GRAVITY * length) ** 0.5
        # Slip of stiff tyres at 3 v1 settles at some 60 sqrt(g / L); Runge-Kutta needs steps of less than 2.8 of it.
        self.max_step = min(self.max_step, _FINE * (length / GRAVITY) ** 0.5)

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Angle of the wheels [rad], speed [m/s], its rate [m/s²] and those of the angle [rad/s, rad/s²]."""
        speed, step = drive.at(self._speed, times), float(times[1] - times[0])
        smooth = gaussian_filter1d(speed, max(_SMOOTHING / step, 1e-3), mode="nearest")
        angle = steering_angle(p, drive, self._steer, times)
        turning = np.gradient(angle, step)
        return np.stack((angle, speed, np.gradient(smooth, step), turning, np.gradient(turning, step)))

    def _slip_angles(self, x: Array, u: Array, p: Values) -> tuple[Array, Array]:
        """Of the wheels as they move, front and rear [rad]."""
        v = np.maximum(u[1], self._v1)
        a, b, angle = p["front_length"], p["rear_length"], self._angle(x, u)
        return np.arctan((x[0] + a * x[1]) / v) - angle, np.arctan((x[0] - b * x[1]) / v)

    def _angle(self, x: Array, u: Array) -> Array:
        """Of the front wheels [rad]."""
        return np.asarray(u[0] + x[-1] if self._yields else u[0])

    def _forces(self, x: Array, u: Array, slips: Sequence[Array], p: Values) -> tuple[Array, Array]:
        """Lateral forces of the axles [N]."""
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        alpha = (x[self._slips], x[self._slips + 1]) if self._relaxation else slips
        if self._roll:
            alpha = (alpha[0] - p["roll_steer"] * x[2], alpha[1] - p["roll_steer_rear"] * x[2])
        loads = [m * (GRAVITY / (a + b)) * arm for arm in (b, a)]
        moved = p["load_transfer"] / (a + b) * self._push(u, p)
        carried = (np.maximum(1.0 - moved / loads[0], _LIGHTEST), np.maximum(1.0 + moved / loads[1], _LIGHTEST))
        front, rear = (
            more * self._force(axle, slip, load, p, pull / more)
            for axle, slip, load, pull, more in zip(AXLES, alpha, loads, self._pulls(u, p), carried, strict=True)
        )
        return front, rear

    @staticmethod
    def _push(u: Array, p: Values) -> Array:
        """What the wheels push ahead with against inertia and the air [N]."""
        return np.asarray(p["mass"] * u[2] + p["drag"] * u[1] ** 2)

    def _pulls(self, u: Array, p: Values) -> tuple[Array, Array]:
        """The same by axle, front and rear [N]."""
        push = self._push(u, p)
        front = p["front_drive"] * np.maximum(push, 0.0) + p["front_brake"] * np.minimum(push, 0.0)
        return front, push - front

    def _force(self, axle: str, slip: Array, load: Any, p: Values, pull: Array | float = 0.0) -> Array:
        stiffness = p[f"cornering_stiffness_{axle}"]
        if self._tyres == "linear":
            return np.asarray(-stiffness * slip)
        peak = p[f"friction_{axle}"] * load
        left = np.sqrt(np.maximum(1.0 - (pull / peak) ** 2, _LEAST_GRIP**2))
        if self._tyres == "fiala":
            tangent = np.tan(slip)
            share = stiffness * np.abs(tangent) / (3.0 * peak)
            stuck = np.minimum(share, 1.0)
            grip = left * stiffness * (1.0 - stuck + stuck * stuck / 3.0)
            return np.asarray(-grip * tangent / np.maximum(share, 1.0))
        shape, bend = p[f"shape_{axle}"], p[f"curvature_{axle}"]
        slope = stiffness / (shape * peak) * slip
        return np.asarray(-left * peak * np.sin(shape * np.arctan(slope - bend * (slope - np.arctan(slope)))))

    def _accelerations(self, x: Array, u: Array, p: Values) -> tuple[Array, Array, Array]:
        """Lateral acceleration of the centre of mass [m/s²], yaw and roll acceleration [rad/s²]."""
        return self._motion(x, u, p, self._forces(x, u, self._slip_angles(x, u, p), p))

    def _motion(self, x: Array, u: Array, p: Values, forces: Sequence[Array]) -> tuple[Array, Array, Array]:
        front, rear = forces
        delta = self._angle(x, u)
        front = front * np.cos(delta)
        front = front + self._pulls(u, p)[0] * np.sin(delta)
        ahead, behind, inertia = p["front_length"], p["rear_length"], p["yaw_inertia"] + p["spin_inertia"]
        if self._relaxation:
            ahead, behind = ahead - p["trail_front"], behind + p["trail_rear"]
        side = (front + rear) / p["mass"]
        turn = (ahead * front - behind * rear - p["steering_inertia"] * u[4]) / inertia
        vx, low = u[1], self._v1
        part = (vx * vx - low * low) / (8.0 * low * low)
        if np.min(part) < 1.0:
            part = np.clip(part, 0.0, 1.0)
            weigh = part * part * (3.0 - 2.0 * part)
            spin = vx * np.tan(delta) / (p["front_length"] + p["rear_length"])
            slow_turn, slow_vy = (spin - x[1]) / _BLEND, (p["rear_length"] * spin - x[0]) / _BLEND
            slow_side = slow_vy + x[1] * vx
            side, turn = slow_side + weigh * (side - slow_side), slow_turn + weigh * (turn - slow_turn)
        if not self._roll:
            return side, turn, side
        turn = turn + (p["roll_moment"] * x[2] - p["wheel_momentum"] * vx * x[3]) / inertia
        return side, turn, self._roll_acceleration(x, u, side, p)

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Of vy, yaw rate, roll, rate of the dampers, slips, give of the steering."""
        slips = self._slip_angles(x, u, p)
        forces = self._forces(x, u, slips, p)
        side, turn, sway = self._motion(x, u, p, forces)
        found = [side - x[1] * u[1], turn]
        if self._roll:
            found[0] = found[0] + p["roll_arm"] * sway
            found += [x[3], sway]
        if self._damped_late:
            found.append((x[3] - x[4]) / np.maximum(p["roll_damper_time"], _SLIPPING * self.max_step))
        if self._relaxation:
            v, least = np.maximum(u[1], self._v1), _SLIPPING * self.max_step
            for i, (length, slip) in enumerate(zip(self._lengths, slips, strict=True)):
                # What the integration can follow, without a corner, at which a search would stay.
                time = least * (1.0 + (p[length] / (v * least)) ** 8) ** 0.125
                found.append((slip - x[self._slips + i]) / time)
        if self._yields:
            moment = -p["trail_front"] * forces[0] - p["steering_inertia"] * (u[4] + turn)
            if self._roll:
                moment = moment + p["camber_moment"] * x[2] - 0.5 * p["wheel_momentum"] * u[1] * x[3]
            time = np.maximum(p["steering_compliance_time"], _SLIPPING * self.max_step)
            found.append((p["steering_compliance"] * moment - x[-1]) / time)
        return np.stack(found)

    def _roll_acceleration(self, x: Array, u: Array, side: Array, p: Values) -> Array:
        natural, rate = p["roll_frequency"], x[4 if self._damped_late else 3]
        if np.any(p["wheel_momentum"]):
            share = p["wheel_momentum"] / (p["mass"] * p["roll_arm"] + p["wheel_momentum"])
            side = side + share * (u[1] * (x[1] + 0.5 * u[3]) - side)
        return np.asarray(natural * (natural * (p["roll_gain"] * side - x[2]) - 2.0 * p["roll_damping"] * rate))

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """The outputs in their order."""
        found, now = [], (x, u)
        for name in self.outputs:
            x, u = self._earlier(*now, p, _LATE.get(name))
            if name == "yaw_rate":
                found.append(x[1])
            elif name == "vy":
                # The state is that of the roll axis; what is above it goes to the left as the body rolls to the left.
                above = p["velocity_height"] * x[3] if self._roll else 0.0
                found.append(x[0] + p["velocity_ahead"] * x[1] - above)
            elif name in {"roll", "roll_rate"}:
                found.append(x[2 if name == "roll" else 3])
            else:
                side, turn, sway = self._accelerations(x, u, p)
                seen = side + p["accelerometer_ahead"] * turn
                if self._roll:
                    arm = p["roll_arm"] - p["accelerometer_height"]
                    seen = seen + arm * sway + p["accelerometer_tilt"] * GRAVITY * x[2]
                found.append(seen)
        return np.stack(found)

    def _earlier(self, x: Array, u: Array, p: Values, delay: str | None) -> tuple[Array, Array]:
        """States and inputs a delay ago, by the midpoint rule: off by a sixth of the cube of delay times frequency."""
        late = 0.0 if delay is None else p[delay]
        if not np.any(late):
            return x, u

        def back(time: Any) -> Array:
            parts = (u[0] - time * u[3], u[1] - time * u[2], u[2], u[3] - time * u[4], u[4])
            return np.stack(np.broadcast_arrays(*parts))

        middle = x - 0.5 * late * self.rates(x, u, p)
        return x - late * self.rates(middle, back(0.5 * late), p), back(late)

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
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
            found += [p["roll_gain"] * v * spin, *np.zeros((1 + self._damped_late, len(rows)))]
        if self._relaxation:
            held = m * v * spin / (a + b)
            found += [-held * b / p["cornering_stiffness_front"], -held * a / p["cornering_stiffness_rear"]]
            if self._yields:
                found.append(-p["steering_compliance"] * p["trail_front"] * held * b)
        return np.stack(found)

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Understeer gradient and what else a slow drive shows."""
        a, m, length = p["front_length"], p["mass"], p["front_length"] + p["rear_length"]
        front, rear = p["cornering_stiffness_front"], p["cornering_stiffness_rear"]
        gradient = self._understeer(p)
        return {
            "understeer gradient": (gradient, "rad s^2/m"),
            "understeer gradient times steering ratio": (gradient * p["steering_ratio"], "rad s^2/m"),
            "steering ratio times wheelbase": (p["steering_ratio"] * length, "m"),
            "mass over sum of stiffnesses": (m / (front + rear), "rad s^2/m"),
            "sideslip gradient m a / (L Cr)": (m * a / (length * rear), "rad s^2/m"),
            "front stiffness over yaw inertia": (front / p["yaw_inertia"], "1/(m rad s^2)"),
            "steering delay and lag together": (p["steering_delay"] + p["steering_lag"], "s"),
        }

    @staticmethod
    def _understeer(p: Mapping[str, float]) -> float:
        """Steering angle over lateral acceleration beyond that of a slow turn of the same radius [rad s²/m]."""
        q = defaultdict(float, p)
        a, b, roll = q["front_length"] - q["trail_front"], q["rear_length"] + q["trail_rear"], q["roll_gain"]
        front = (q["mass"] * b - q["roll_moment"] * roll) / (a + b)
        rear = q["mass"] - front
        slips = front / q["cornering_stiffness_front"] - rear / q["cornering_stiffness_rear"]
        given = q["steering_compliance"] * (q["trail_front"] * front - q["camber_moment"] * roll)
        return slips + (q["roll_steer_rear"] - q["roll_steer"]) * roll + given

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Stiffness over load of road tyres is 4 to 40 1/rad, and the radius of gyration goes with the axles."""
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        load = m * GRAVITY / (a + b)
        ranges = {
            "cornering_stiffness_front": (2.0 * load * b, 45.0 * load * b),
            "cornering_stiffness_rear": (2.0 * load * a, 45.0 * load * a),
            "yaw_inertia": (0.3 * m * a * b, 3.0 * m * a * b),
            "friction_front": (0.1, 2.0),
            "friction_rear": (0.1, 2.0),
            "load_transfer": (0.0, _HIGHEST * (a + b)),
            "roll_gain": (0.001, 0.03),
            "roll_frequency": (4.0, 40.0),
            "roll_damping": (0.03, 2.0),
            "accelerometer_tilt": (-0.5, 2.5),
            **dict.fromkeys(_LATE.values(), (-0.06, 0.06)),
            **dict.fromkeys(("velocity_height", "accelerometer_height"), (-0.5 * (a + b), a + b)),
            **dict.fromkeys(self._lengths, (0.02 * (a + b), 0.5 * (a + b))),
        }
        return ranges.get(name, (-np.inf, np.inf))

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """What is not in it, and what nobody gave.

        The front axle carries 40 to 60 % of nearly all cars. A relaxation length or an arm of roll that was assumed may
        be off by half of it; the pneumatic trail is a third of half a contact of 0.2 m (H. B. Pacejka, Tyre and Vehicle
        Dynamics, 3rd ed., section 3.2). An accelerometer or the sideways speed show roll.
        """
        length, found = p["front_length"] + p["rear_length"], []

        def assumption(names: Collection[str], off: Mapping[str, float], words: str, remedy: str) -> None:
            if set(names) <= assumed and any(off.values()):
                moved = {name: p[name] + SMALL * size for name, size in off.items()}
                found.append(Assumption(words, remedy, moved, SMALL))

        def lack(
            words: str, remedy: str, off: Mapping[str, float], options: Mapping[str, Any], most: float = math.inf
        ) -> None:
            if not set(options) - self._open:
                found.append(Assumption(words, remedy, off, PART, options, is_omitted=True, most=most))

        lengths = ("front_length", "rear_length")
        moved = {"front_length": _CENTRE * length, "rear_length": -_CENTRE * length}
        assumption(lengths, moved, "where the centre of mass is", "give front_length and rear_length")
        if self._no_wheelbase:
            moved = {name: _SIZE * p[name] for name in lengths if name in assumed}
            assumption((), moved, "the wheelbase", "give it")
        if self._relaxation:
            moved = {name: 0.5 * p[name] for name in self._lengths}
            assumption(self._lengths, moved, "the relaxation length of the tyres", "give the vehicle, or that length")
            trails = ("trail_front", "trail_rear")
            moved = dict.fromkeys(trails, _TRAIL * length)
            assumption(
                trails, moved, "the pneumatic trail of the tyres", "give the vehicle, or trail_front and trail_rear"
            )
        if self._roll:
            moved = {"roll_arm": 0.5 * p["roll_arm"]}
            assumption(("roll_arm",), moved, "how far the centre of mass is above the roll axis", "give roll_arm")
            for name, axle in (("roll_steer", "front"), ("roll_steer_rear", "rear")):
                if name in assumed:
                    moved = {name: p[name] + PART * _ROLL_STEER}
                    lack(f"whether roll steers the {axle} wheels", f"give {name}", moved, {})
        moved = {"relaxation": PART * RELAXATION * length}
        lack("whether the tyres relax", "give the vehicle, or its relaxation length", moved, {"relaxation": "shared"})
        if {"lateral_acceleration", "vy"} & set(self.outputs):
            lack("whether the body rolls", "fit a single_track_roll", {"roll_gain": PART * _GAIN}, {"roll": True})
        if "lateral_acceleration" in self.outputs:
            moved = {"roll_gain": PART * _GAIN, "accelerometer_tilt": 1.0}
            lack("whether a body that rolls leans the accelerometer", "fit a single_track_roll", moved, {"roll": True})
        moved = dict.fromkeys(("friction_front", "friction_rear"), _FRICTION / PART)
        lack("whether the tyres saturate", "drive gentle bends", moved, {"tyres": "magic_formula"})
        bends = ("curvature_front", "curvature_rear")
        if set(bends) <= assumed:
            moved = {name: p[name] + PART * _CURVATURE for name in bends}
            lack("how straight the curve of the tyres is", "give curvature_front and curvature_rear", moved, {})
        if "velocity_delay" in assumed:
            moved = {"velocity_delay": PART * _LATENESS}
            lack("whether vy is late", "give velocity_delay, or record all with one clock", moved, {})
        if "load_transfer" in assumed:
            moved = {"load_transfer": PART * _HEIGHT * length}
            lack("load transfer in braking", "give load_transfer", moved, {}, _HIGHEST / _HEIGHT)
        asked = self._steer != "road_wheel_angle"
        for name, size, words in (("front_drive", _DRIVE, "drive"), ("front_brake", _BRAKE, "brake")):
            if name in assumed:
                most = max(p[name], 1.0 - p[name]) / size
                lack(f"how much the front wheels {words}", f"give {name}", {name: p[name] + PART * size}, {}, most)
        if "steering_lag" in assumed and (asked or p["steering_delay"] > AHEAD):
            remedy = "record road_wheel_angle" if asked else "record where the wheels are, not what they were asked for"
            lack("a lag of the steering", remedy, {"steering_lag": PART * _LAG}, {})
        return tuple(found)

    def suggest_experiment(self, names: frozenset[str]) -> str:
        """Which drive would tell these parameters apart."""
        stiff = {"cornering_stiffness_front", "cornering_stiffness_rear"}
        if names & {"friction_front", "friction_rear"} or any(
            name.startswith(("shape", "curvature")) for name in names
        ):
            return "drive a ramp of the steering to the limit of the tyres"
        if names & _OF_ROLL:
            return "record the roll rate"
        if "steering_ratio" in names:
            return "do slow turns and fast turns: the ratio shows at walking pace, the stiffness at speed"
        if names & {"steering_delay", "steering_lag"}:
            return "do step steers, or a sweep to 3 Hz"
        if names & stiff:
            return "do a step steer at two speeds, and record the lateral velocity if possible"
        return "do a step steer or a sweep to 2 Hz" if "yaw_inertia" in names else "turn left and right alike"

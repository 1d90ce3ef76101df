"""Lateral motion of a single track at the recorded speed: linear, Fiala or Magic Formula tyres, with or without roll.

The equations are those of :mod:`mirdrake.single_track.dynamics` with the speed as an input, so that drive and brakes
need not be known. vy and yaw rate r are velocities of the centre of mass, δ is the road wheel angle::

    m (v̇y + vx r) = Ff cos δ + Fr       (Iz + J) ṙ = a Ff cos δ - b Fr
    αf = atan((vy + a r) / vx) - δ       αr = atan((vy - b r) / vx)

    linear          F = -C α
    fiala           F = -C tan α (1 - s + s²/3), s = C |tan α| / (3 μ N); -μ N sign α where s > 1
    magic_formula   F = -μ N sin(c atan(B α - E (B α - atan B α))), B = C / (c μ N)

J is the additional yaw inertia of the spinning wheels, whose speeds differ in a turn: 1 % of Iz, where it is known. The
steered parts have the inertia I; the reaction of the moment I δ̈ that turns them acts on the car.

Roll (option) follows the lateral acceleration. The front wheels may steer with roll (roll steer), and an accelerometer
on the body measures a part of gravity and of the lateral motion due to roll. A damper c between body and the spring k,
in series with the tyres' stiffness kt, acts with the lag τd = c / (k + kt), more with unsprung mass, on a roll rate p;
τd = 0 unless given::

    φ̈ = ω² (g_φ q - φ) - 2 ζ ω p        τd ṗ = φ̇ - p        ay_seen = ay + l ṙ + (h - z) φ̈ + i g φ

Spinning wheels that yaw or are steered are gyroscopes that roll the body in addition to the tyre forces. With their
angular momentum H vx, half of it in front, the roll excitation as an acceleration is::

    q = (m h ay + H vx (r + δ̇ / 2)) / (m h + H)

h is the height of the centre of mass above the roll axis, z that of the accelerometer. vy is the velocity of the point
of the roll axis below the centre of mass, near the road, where the tyres are. With the acceleration ay = (Ff + Fr) / m
of the centre of mass, v̇y + vx r = ay + h φ̈. Camber thrust and roll steer act as a slip over roll, e φ of an axle.

Relaxation (option): the force of an axle responds not to its slip α but to a slip α' that follows it over the
relaxation length σ: α̇' = vx (α - α') / σ, some 20 ms at 20 m/s. Without it, a fit of fast steering takes relaxation
for yaw inertia and steering delay. The forces then act behind the wheel centres by the pneumatic trail t: a - t and b +
t replace a and b. With roll, the yaw moment gets the terms N φ - H vx φ̇: camber moments, the difference in rolling
resistance between inner and outer wheels, and the gyroscopic moment of wheels that roll with the body.

The steering is compliant, which matters where its command is recorded rather than the road wheel angle. With the
compliance s of a spring, the time constant τ of its damper, the camber moment M φ and the inertia I of the steered
parts, the front wheels are at δ + y::

    τ ẏ = s (-t Ff + M φ - H vx φ̇ / 2 - I (δ̈ + ṙ)) - y

Load transfer: under braking the front tyres carry more, and the car turns in more. Stiffness and peak force of each
axle are proportional to its load. The load transfer h (option) is the height of the centre of mass if they are
proportional to the load, and less if they grow more slowly::

    Nf = m g b / L - h A / L        Nr = m g a / L + h A / L        A = m (dvx/dt - r vy) + D vx²

with the drag D vx² that acts at the centre of mass, where it is known. The wheels also overcome the backward part of
the lateral force of the front axle, which is m b vx r / (L cos δ) nearly, so that all of them have the longitudinal
force X = A + m b vx r tan δ / L. In a steady turn that is the cornering resistance -m vx r (b αf + a αr) / L, zero
without slip. The longitudinal force of the front axle follows its wheels and has the lateral component f X sin δ; f is
the front axle's share of the drive force, or of the braking force. At full lock that is a third of it; if it were
omitted, it would look like a delay of the steering and a small yaw inertia. The longitudinal force X of an axle uses
its share of the friction first: lateral forces are multiplied by √(1 - X² / μ² N²), and by 0.3 at least.

Below the speed v1 = 0.2 sqrt(g L) the car moves kinematically, above 3 v1 as written here, with a blend in between.
Without a mass, stiffnesses and inertia are per kilogram, which is all that the motion determines.
"""

import math
import warnings
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import gaussian_filter1d

from mirdrake.batched.log_runs import LogRuns, run_log
from mirdrake.core.compiled import records
from mirdrake.core.constants import GRAVITY
from mirdrake.identification.data import DataSet
from mirdrake.identification.models import single_track_equations as equations
from mirdrake.identification.models.additions import single_track_additions
from mirdrake.identification.models.base import (
    OMITTED_FRACTION,
    SMALL_FRACTION,
    SPEED,
    Addition,
    Array,
    Assumption,
    ModelOptions,
    Segment,
    Values,
    find_channel,
    select_outputs,
)
from mirdrake.identification.models.coverage import LONG, Coverage, make_coverage
from mirdrake.identification.models.equations import CompiledModel
from mirdrake.identification.models.manoeuvres import lateral_manoeuvres
from mirdrake.identification.models.single_track_equations import TrackFlags, TrackInputs, TrackState
from mirdrake.identification.models.single_track_parameters import (
    DELAYS,
    RELAXATION,
    single_track_parameters,
)
from mirdrake.identification.models.steer import SETPOINT_DELAY, STEERING, STEERING_PARAMETERS, steering_angle
from mirdrake.identification.parameters import Setting
from mirdrake.vehicles import Vehicle

AXLES = ("front", "rear")

_FROUDE = 0.2  # speed of the kinematic motion over sqrt(g L) [1]
_STEP = 0.03  # step of the integration over sqrt(L / g) [1]
_SMOOTHING = 0.1  # smoothing of the speed before it is differentiated [s]
_CENTRE = 0.05  # standard deviation of an unknown centre of mass over the wheelbase [1]
_TRAIL = 0.013  # pneumatic trail over wheelbase [1]: 35 mm for a car
_FRICTION = 0.9  # friction of a dry road [1]
# Standard deviation of factor C of the lateral force about 1.4 [1]. Measured: 1.19 (205/60R15, the same table), 1.35 (a
# passenger car), 1.59 (an off-road car) and 1.14 (335/65R22, a truck), in the public .tir files of Chrono and others.
_SHAPE = 0.2
_CURVATURE = -1.0  # factor E at zero slip of a 205/60R15: Pacejka, Tyre and Vehicle Dynamics, 2nd ed., table A3.1 [1]
_HEIGHT, _MAX_HEIGHT = 0.2, 0.5  # usual and largest height of the centre of mass over the wheelbase [1]
_LAG = 0.05  # usual lag of a steering [s]
_DRIVE, _BRAKE = 0.5, 0.25  # standard deviations of the front axle's shares of drive and braking [1]
_SENSOR_DELAY = 0.01  # usual delay of a separate instrument: a sample at 100 Hz [s]
_DELAY_PARAMETERS = {channel: name for channel, name, _ in DELAYS}
_ROLL_GAIN = 0.01  # usual roll over lateral acceleration: 5.6 degrees at g [rad s²/m]
_ROLL_STEER = 0.05  # slip of an axle over roll: half the camber thrust of the Ford Escort of CommonRoad [1]
_ROLL_PARAMETERS = {
    "roll_gain", "roll_frequency", "roll_damping", "accelerometer_tilt", "accelerometer_height", "velocity_height",
}  # fmt: skip
_NUMBERS = (
    "mass", "front_length", "rear_length", "cornering_stiffness_front", "cornering_stiffness_rear", "yaw_inertia",
    "spin_inertia", "steering_inertia", "load_transfer", "drag", "front_drive", "front_brake", "friction_front",
    "friction_rear", "shape_front", "shape_rear", "curvature_front", "curvature_rear", "relaxation_front",
    "relaxation_rear", "trail_front", "trail_rear", "steering_compliance", "steering_compliance_time", "camber_moment",
    "roll_damper_time", "roll_gain", "roll_frequency", "roll_damping", "roll_arm", "wheel_momentum", "roll_moment",
    "roll_steer", "roll_steer_rear", "accelerometer_ahead", "accelerometer_height", "accelerometer_tilt",
    "accelerometer_delay", "velocity_ahead", "velocity_height", "velocity_delay",
)  # fmt: skip
"""Parameters that the equations use."""

_NUMBERS_TYPE = np.dtype([(name, float) for name in _NUMBERS])

_SENSOR_PARAMETERS = frozenset(
    {
        "accelerometer_ahead", "accelerometer_height", "accelerometer_tilt", "accelerometer_delay", "velocity_ahead",
        "velocity_height", "velocity_delay",
    }
)  # fmt: skip
"""Parameters that only :func:`mirdrake.identification.models.single_track_equations.observe` uses."""

_EQUAL = 1e-12
"""Difference over the scale of a state below which two runs are one [1]: 1e-7 of the changes for derivatives."""

_MIN_TIME = 0.4
"""Least time constant of slip, dampers and steering compliance, over the step of the integration [1]."""

_SCALES = {
    "vy": 0.5, "yaw_rate": 0.2, "roll": 0.05, "roll_rate": 0.3, "damper_rate": 0.3, "slip_front": 0.02,
    "slip_rear": 0.02, "steering_deflection": 0.002,
}  # fmt: skip
"""All states with the size of a large change, in the order in which a model has them."""


class SingleTrackOptions(ModelOptions):
    """Options of the single track; options left out are open to the structure search."""

    tyres: Literal["linear", "fiala", "magic_formula"] | None = Field(default=None, description="tyre law [-]")
    roll: bool | None = Field(default=None, description="whether the body rolls [-]")
    relaxation: bool | Literal["shared"] | None = Field(
        default=None, description="tyre relaxation, shared: one length for both axles; as the vehicle if left out [-]"
    )
    outputs: list[str] | None = Field(default=None, description="channels to compare; all if left out [-]")


class SingleTrackModel(CompiledModel):
    """Single-track model of the lateral motion.

    Raises:
        ConfigError: a channel is missing.
    """

    kind = "single_track"
    data_parameters = ("mass", "front_length", "front_drive", "front_brake")
    Options = SingleTrackOptions
    uses_steering_guess = True
    sensor_parameters = _SENSOR_PARAMETERS
    rolls_by_default = False

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: SingleTrackOptions
    ) -> None:
        # What the study leaves open: the structure search may add it, and its omission counts as an assumption.
        self._open = {name for name in ("tyres", "roll", "relaxation") if getattr(options, name) is None}
        self._tyres, self._roll = options.tyres or "linear", bool(options.roll or self.rolls_by_default)
        self._open -= {"roll"} if self._roll else set()
        relaxation = options.relaxation
        if relaxation is None:
            relaxation = bool(known.get("relaxation_front") or known.get("relaxation_rear"))
            self._open -= {"relaxation"} if relaxation else set()
        self._relaxation = bool(relaxation)
        self._lengths = ("relaxation",) * 2 if relaxation == "shared" else ("relaxation_front", "relaxation_rear")
        parts = [word for word, has_it in (("relaxation", self._relaxation), ("roll", self._roll)) if has_it]
        self.title = f"single track with {self._tyres.replace('_', ' ')} tyres"
        self.title += "".join(f" and {word}" for word in parts)
        self._channels = frozenset(channels)
        self._steer = find_channel(channels, STEERING, "the steering", self.kind)
        self._speed = find_channel(channels, SPEED, "the speed", self.kind)
        self.inputs = (self._steer, self._speed)
        self._speeds: dict[int, tuple[Segment, Array, Array, Array]] = {}

        # The states follow from the options and from what is known of the vehicle.
        self._has_damper_lag = bool(self._roll and known.get("roll_damper_time"))
        self._is_compliant = bool(self._relaxation and known.get("steering_compliance"))
        absent = set() if self._roll else {"roll", "roll_rate"}
        absent |= set() if self._has_damper_lag else {"damper_rate"}
        absent |= set() if self._relaxation else {"slip_front", "slip_rear"}
        absent |= set() if self._is_compliant else {"steering_deflection"}
        self.states = tuple(name for name in _SCALES if name not in absent)
        self.state_scales = tuple(_SCALES[name] for name in self.states)
        self._row = {name: row for row, name in enumerate(self.states)}
        self._state_columns = [TrackState._fields.index(name) for name in self.states]

        # Roll is an output only if the model has it as a state.
        possible = ["yaw_rate", "lateral_acceleration", "vy", *(("roll", "roll_rate") if self._roll else ())]
        self.outputs = select_outputs(channels, possible, options.outputs, self.kind)
        self._output_columns = [equations.OUTPUTS.index(name) for name in self.outputs]
        self.input_parameters = STEERING_PARAMETERS
        self.parameters = single_track_parameters(
            known, wheelbase, self._steer, outputs=self.outputs, tyres=self._tyres, roll=self._roll,
            relaxation=self._lengths if self._relaxation else (), compliant=self._is_compliant,
            damper_lag=self._has_damper_lag,
        )  # fmt: skip
        self._wheelbase = wheelbase
        # Below a speed at constant Froude number v²/(g L) the slip angles are undefined, and the model changes to
        # kinematics.
        p = {info.name: info.guess for info in self.parameters}
        length = p["front_length"] + p["rear_length"]
        self._v1 = _FROUDE * (GRAVITY * length) ** 0.5
        # Slip of stiff tyres at 3 v1 settles at some 60 sqrt(g / L); Runge-Kutta needs steps of less than 2.8 of it.
        self.max_step = min(self.max_step, _STEP * (length / GRAVITY) ** 0.5)
        # This step resolves the motion; finer samples show more noise only. L. Ljung recommends ten samples in a period
        # of the bandwidth (System Identification, 2nd ed., 1999, section 13.7): for a car with 2 Hz, 50 ms.
        self.sample_time = self.max_step

    @classmethod
    def is_default_for(cls, channels: set[str]) -> bool:
        """Whether there are a speed, a steering channel and a lateral measurement."""
        lateral = {"yaw_rate", "lateral_acceleration", "vy"}
        return bool(channels & {*SPEED} and channels & {*STEERING} and channels & lateral)

    @classmethod
    def vehicle_values(cls, vehicle: Vehicle, options: SingleTrackOptions, *, measured: bool) -> dict[str, float]:
        """Return also the values of tyres, wheels, roll and steering compliance."""
        from mirdrake.identification.models.vehicle_values import single_track_values

        roll = bool(options.roll or cls.rolls_by_default)
        return single_track_values(vehicle, roll=roll, relaxation=options.relaxation is not False, measured=measured)

    @classmethod
    def additions(
        cls, data: DataSet, options: SingleTrackOptions, settings: Mapping[str, Setting]
    ) -> Iterator[Addition]:
        """Yield load transfer, steering lag, relaxation, roll, delays of sensors, tyre laws, if not specified."""
        open_options = {name for name in ("tyres", "roll", "relaxation") if name not in options.model_fields_set}
        yield from single_track_additions(
            data, settings, open_options=open_options, outputs=options.outputs, rolls=cls.rolls_by_default
        )

    def candidate_manoeuvres(self, p: Mapping[str, float], speed: float) -> dict[str, dict[str, Array]]:
        """Return the lateral manoeuvres."""
        return lateral_manoeuvres(p, speed)

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return road wheel angle [rad], speed [m/s], its rate [m/s²] and the rates of the angle [rad/s, rad/s²]."""
        step = float(times[1] - times[0])
        angle = steering_angle(p, drive, self._steer, times)
        turning = np.gradient(angle, step)
        return np.stack((angle, *self._speed_signals(drive, times), turning, np.gradient(turning, step)))

    def input_memory(self, p: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return dead time and lag of the steering."""
        return {self._steer: (p["steering_delay"], p["steering_lag"])}

    def _speed_signals(self, drive: Segment, times: Array) -> tuple[Array, Array]:
        """Return speed [m/s] and its rate [m/s²]; they do not depend on parameters and are kept for the last times."""
        cached = self._speeds.get(id(drive))
        if cached is None or cached[0] is not drive or not np.array_equal(cached[1], times):
            # Only the derivative uses the smoothed speed: noise of the speed would appear as large longitudinal forces.
            speed, step = drive.at(self._speed, times), float(times[1] - times[0])
            smooth = gaussian_filter1d(speed, max(_SMOOTHING / step, 1e-3), mode="nearest")
            cached = self._speeds[id(drive)] = (drive, times, speed, np.asarray(np.gradient(smooth, step)))
        return cached[2], cached[3]

    # --- equations of :mod:`mirdrake.identification.models.single_track_equations` ---

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Return the rates of the states in their order."""
        rates = equations.rates(self._flags((p,)), self._numbers(p), self._states_of(x), TrackInputs(*u))
        return np.stack(np.broadcast_arrays(*(getattr(rates, name) for name in self.states)))

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Return the outputs in their order."""
        seen = equations.observe(self._flags((p,)), self._numbers(p), self._states_of(x), TrackInputs(*u))
        return np.stack(np.broadcast_arrays(*(seen[column] for column in self._output_columns)))

    def run_log(
        self, columns: Sequence[Mapping[str, float]], inputs: Array, rows: Sequence[int], starts: Array, step: float,
        substeps: int, follows: Sequence[bool],
    ) -> LogRuns:  # fmt: skip
        """See :meth:`CompiledModel.run_log`."""
        # A plain array viewed as records: filling records field by field would take longer than the run.
        numbers: Array = np.array([list(vars(self._numbers(p)).values()) for p in columns])
        wide = np.zeros((len(starts), len(TrackState._fields)))
        wide[:, self._state_columns] = starts
        equal = np.zeros(len(TrackState._fields))
        equal[self._state_columns] = _EQUAL * np.array(self.state_scales)
        runs = run_log(
            equations.EQUATIONS,
            records(TrackFlags, [self._flags(columns)]),
            numbers.view(_NUMBERS_TYPE)[:, 0],
            inputs,
            wide,
            rows=rows,
            step=step,
            substeps=substeps,
            outputs=len(equations.OUTPUTS),
            follows=follows,
            tolerances=equal,
        )
        return LogRuns(runs.outputs[..., self._output_columns], runs.last[:, self._state_columns])

    def _states_of(self, x: Array) -> TrackState:
        """Return states by name."""
        return TrackState(**{name: x[row] for name, row in self._row.items()})

    def _flags(self, sets: Sequence[Values]) -> TrackFlags:
        """Return the variant for some sets of parameters."""
        # Delays of zero are left out of the compiled equations, as looking back costs two more evaluations.
        late = {
            channel: any(np.any(p.get(name, 0.0)) for p in sets) and channel in self.outputs
            for channel, name in _DELAY_PARAMETERS.items()
        }
        return TrackFlags(
            tyres=equations.TYRES.index(self._tyres),
            roll=self._roll,
            damper_lag=self._has_damper_lag,
            relaxation=self._relaxation,
            compliant=self._is_compliant,
            sees_acceleration="lateral_acceleration" in self.outputs,
            acceleration_late=late["lateral_acceleration"],
            velocity_late=late["vy"],
            low_speed=self._v1,
            least_time=_MIN_TIME * self.max_step,  # shorter ones would make the integration unstable
        )

    def _numbers(self, p: Values) -> SimpleNamespace:
        """Return all parameters of the equations by name; those that a variant does not have are zero."""
        values = {name: p.get(name, 0.0) for name in _NUMBERS}
        if self._relaxation:
            values |= {f"relaxation_{axle}": p[name] for axle, name in zip(AXLES, self._lengths, strict=True)}
        return SimpleNamespace(**values)

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Return the measured yaw rate, and vy, slips and roll of a steady turn with it."""
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        # Bounded by the speed of the kinematic motion, below which slip angles are undefined.
        v = np.maximum(drive.inputs[self._speed][rows], self._v1)
        delta = drive.inputs[self._steer][rows] / p["steering_ratio"] + p["steering_offset"]
        spin = v * delta / (a + b)
        seen = drive.outputs.get("yaw_rate")
        if seen is not None:
            near = np.clip(rows, 3, drive.size - 4)[:, None] + np.arange(-3, 4)  # robust against glitches
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # all samples near are missing
                middle = np.nanmedian(seen[near], axis=1)
            spin = np.where(np.isfinite(middle), middle, spin)
        # Steady turn: vy = b r - v αr with the slip of the rear axle αr = -m a v r / (L C).
        side = b * spin - m * a * v * v * spin / ((a + b) * p["cornering_stiffness_rear"])
        states = [side, spin]
        if self._roll:
            states += [p["roll_gain"] * v * spin, *np.zeros((1 + self._has_damper_lag, len(rows)))]
        if self._relaxation:
            force = m * v * spin / (a + b)
            states += [-force * b / p["cornering_stiffness_front"], -force * a / p["cornering_stiffness_rear"]]
            if self._is_compliant:
                states.append(-p["steering_compliance"] * p["trail_front"] * force * b)
        return np.stack(states)

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Return the understeer gradient and other combinations that quasi-steady driving identifies."""
        p = self.complete(p)
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
            "steering delay plus lag": (p["steering_delay"] + p["steering_lag"], "s"),
        }

    @staticmethod
    def _understeer(p: Mapping[str, float]) -> float:
        """Return the change of the steering angle over lateral acceleration at constant radius [rad s²/m]."""
        q = defaultdict(float, p)
        # Forces act behind the wheel centres by the pneumatic trail.
        a, b, roll = q["front_length"] - q["trail_front"], q["rear_length"] + q["trail_rear"], q["roll_gain"]
        front = (q["mass"] * b - q["roll_moment"] * roll) / (a + b)
        rear = q["mass"] - front
        # Slip over lateral acceleration of the axles, then roll steer and the deflection of the compliant steering.
        slips = front / q["cornering_stiffness_front"] - rear / q["cornering_stiffness_rear"]
        deflection = q["steering_compliance"] * (q["trail_front"] * front - q["camber_moment"] * roll)
        return slips + (q["roll_steer_rear"] - q["roll_steer"]) * roll + deflection

    def plausible_range(self, name: str, p: Mapping[str, float]) -> tuple[float, float]:
        """Return the physical range; stiffness over load of road tyres is 4 to 40 1/rad."""
        a, b, m = p["front_length"], p["rear_length"], p["mass"]
        load = m * GRAVITY / (a + b)
        ranges = {
            "cornering_stiffness_front": (2.0 * load * b, 45.0 * load * b),
            "cornering_stiffness_rear": (2.0 * load * a, 45.0 * load * a),
            "yaw_inertia": (0.3 * m * a * b, 3.0 * m * a * b),
            "friction_front": (0.1, 2.0),
            "friction_rear": (0.1, 2.0),
            "load_transfer": (0.0, _MAX_HEIGHT * (a + b)),
            "steering_lag": (2e-3, 0.9),
            # No vehicle responds before its steering, but half a sample at 25 Hz: a shorter dead time compensates for
            # another effect.
            "steering_delay": (-0.02, np.inf),
            "roll_gain": (0.001, 0.03),
            "roll_frequency": (4.0, 40.0),
            "roll_damping": (0.03, 2.0),
            "accelerometer_tilt": (-0.5, 2.5),
            **dict.fromkeys(_DELAY_PARAMETERS.values(), (-0.16, 0.16)),
            **dict.fromkeys(("velocity_height", "accelerometer_height"), (-0.5 * (a + b), a + b)),
            **dict.fromkeys(self._lengths, (0.02 * (a + b), 0.5 * (a + b))),
        }
        return ranges.get(name, (-np.inf, np.inf))

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """Return default values and omitted effects.

        The front axle carries 40 to 60 % of the weight of nearly all cars. A default relaxation length or roll arm may
        be off by half its value; the pneumatic trail is a third of half a contact patch of 0.2 m (H. B. Pacejka, Tyre
        and Vehicle Dynamics, 3rd ed., section 3.2). Roll shows in the lateral acceleration and in vy.
        """
        length, assumptions = p["front_length"] + p["rear_length"], []

        def assume(names: Collection[str], sizes: Mapping[str, float], description: str, remedy: str) -> None:
            # A given value is not an assumption.
            if set(names) <= assumed and any(sizes.values()):
                moved = {name: p[name] + SMALL_FRACTION * size for name, size in sizes.items()}
                assumptions.append(Assumption(description, remedy, moved, SMALL_FRACTION))

        def omit(
            description: str, remedy: str, moved: Mapping[str, float], options: Mapping[str, Any],
            max_size: float = math.inf,
        ) -> None:  # fmt: skip
            # An option that the study sets is its decision, no omission of the model.
            if not set(options) - self._open:
                assumptions.append(
                    Assumption(description, remedy, moved, OMITTED_FRACTION, options, is_omitted=True,
                               max_size=max_size)
                )  # fmt: skip

        # Values that were not given.

        lengths = ("front_length", "rear_length")
        moved = {"front_length": _CENTRE * length, "rear_length": -_CENTRE * length}
        assume(lengths, moved, "where the centre of mass is", "give front_length and rear_length")
        if self._relaxation:
            moved = {name: 0.5 * p[name] for name in self._lengths}
            assume(
                self._lengths,
                moved,
                "the relaxation length of the tyres",
                "name the vehicle in a study (vehicle: NAME), or give that length",
            )
            trails = ("trail_front", "trail_rear")
            moved = dict.fromkeys(trails, _TRAIL * length)
            assume(
                trails,
                moved,
                "the pneumatic trail of the tyres",
                "name the vehicle in a study (vehicle: NAME), or give trail_front and trail_rear",
            )
        shapes = ("shape_front", "shape_rear")
        assume(shapes, dict.fromkeys(shapes, _SHAPE), "the shape factor of the tyres", "give shape_front, shape_rear")
        if self._roll:
            moved = {"roll_arm": 0.5 * p["roll_arm"]}
            assume(("roll_arm",), moved, "the height of the centre of mass above the roll axis", "give roll_arm")
            for name, axle in (("roll_steer", "front"), ("roll_steer_rear", "rear")):
                if name in assumed:
                    moved = {name: p[name] + OMITTED_FRACTION * _ROLL_STEER}
                    omit(f"whether roll steers the {axle} wheels", f"give {name}", moved, {})
        # Effects that the model omits.
        moved = {"relaxation": OMITTED_FRACTION * RELAXATION * length}
        omit(
            "whether tyre relaxation matters",
            "name the vehicle in a study (vehicle: NAME), or give its relaxation length",
            moved,
            {"relaxation": "shared"},
        )
        if {"lateral_acceleration", "vy"} & set(self.outputs):
            omit(
                "whether the body rolls",
                "fit a single_track_roll",
                {"roll_gain": OMITTED_FRACTION * _ROLL_GAIN},
                {"roll": True},
            )
        if "lateral_acceleration" in self.outputs:
            moved = {"roll_gain": OMITTED_FRACTION * _ROLL_GAIN, "accelerometer_tilt": 1.0}
            omit("whether the accelerometer rolls with the body", "fit a single_track_roll", moved, {"roll": True})
        moved = dict.fromkeys(("friction_front", "friction_rear"), _FRICTION / OMITTED_FRACTION)
        omit("whether the tyres saturate", "drive gentle turns", moved, {"tyres": "magic_formula"})
        bends = ("curvature_front", "curvature_rear")
        if set(bends) <= assumed:
            moved = {name: p[name] + OMITTED_FRACTION * _CURVATURE for name in bends}
            omit("the curvature factor of the tyres", "give curvature_front and curvature_rear", moved, {})
        for channel, name, words in DELAYS:
            if channel in self.outputs and name in assumed:
                moved = {name: OMITTED_FRACTION * _SENSOR_DELAY}
                omit(f"whether {words} has a delay", f"give {name}, or record all channels with one clock", moved, {})
        if "load_transfer" in assumed:
            moved = {"load_transfer": OMITTED_FRACTION * _HEIGHT * length}
            omit("load transfer in braking", "give load_transfer", moved, {}, _MAX_HEIGHT / _HEIGHT)
        is_setpoint = self._steer != "road_wheel_angle"
        for name, size, words in (("front_drive", _DRIVE, "drive"), ("front_brake", _BRAKE, "braking")):
            if name in assumed:
                largest = max(p[name], 1.0 - p[name]) / size
                moved = {name: p[name] + OMITTED_FRACTION * size}
                omit(f"the front axle's share of the {words} force", f"give {name}", moved, {}, largest)
        if "steering_lag" in assumed and (is_setpoint or p["steering_delay"] > SETPOINT_DELAY):
            remedy = (
                "record road_wheel_angle" if is_setpoint else "record the actual road wheel angle, not its set-point"
            )
            omit("a lag of the steering", remedy, {"steering_lag": OMITTED_FRACTION * _LAG}, {})
        return tuple(assumptions)

    def complete(self, p: Mapping[str, float]) -> dict[str, float]:
        """Return the parameters with axle distances in proportion to a wheelbase that is estimated."""
        if "wheelbase" not in p:
            return dict(p)
        scale = p["wheelbase"] / (p["front_length"] + p["rear_length"])
        return {**p, "front_length": scale * p["front_length"], "rear_length": scale * p["rear_length"]}

    def complement(self, name: str) -> str | None:
        """Return the other part of a given wheelbase."""
        parts = {"front_length": "rear_length", "rear_length": "front_length"}
        return parts.get(name) if self._wheelbase is not None else None

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which drive would identify these parameters, by what the logs lack."""
        covered = make_coverage(drives, self._steer, self._speed)
        # The first group that is named decides: limits need the most special manoeuvre.
        stiff = {"cornering_stiffness_front", "cornering_stiffness_rear"}
        if names & {"friction_front", "friction_rear"} or any(
            name.startswith(("shape", "curvature")) for name in names
        ):
            return "do a slow steering ramp to the limit of the tyres"
        if names & _ROLL_PARAMETERS:
            return _sweep(covered, 3.0) if "roll_rate" in self._channels else "record the roll rate"
        if "wheelbase" in names:
            return "give the wheelbase"
        if "steering_ratio" in names:
            slow_and_fast = "do slow and fast turns: the ratio shows at walking pace, the stiffness at speed"
            return "" if covered.speeds else slow_and_fast
        if names & {"steering_delay", "steering_lag"}:
            return _sweep(covered, 3.0)
        if names & stiff:
            step = "" if covered.speeds and covered.sweep_to(1.0) else "do a step steer at two speeds"
            return _join(step, "" if "vy" in self._channels else "record the lateral velocity if possible")
        if "yaw_inertia" in names:
            return _sweep(covered, 2.0)
        longer = "" if covered.turning > LONG else "record longer"
        return _join(longer, "" if covered.sides else "drive turns to both sides")


def _sweep(covered: Coverage, frequency: float) -> str:
    """Return the advice to steer as fast as a sweep to a frequency [Hz]; empty if the logs do so."""
    return "" if covered.sweep_to(frequency) else f"do step steers, or a sweep to {frequency:g} Hz"


def _join(*advice: str) -> str:
    """Return the pieces of advice that there are."""
    return ", and ".join(text for text in advice if text)


class SingleTrackRollModel(SingleTrackModel):
    """Single-track model with roll of the body."""

    kind = "single_track_roll"
    rolls_by_default = True

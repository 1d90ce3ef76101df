"""Vertical dynamics: springs, dampers and tyre stiffness of both axles from a ride over a known road.

Half car with the mean of left and right wheels, which roll does not change; deviations from rest, z up::

    m z'' = Ff + Fr,    J θ'' = -a Ff + b Fr,    Fi = ci (zi - zbi) + di (zi' - zbi')
    mi zi'' = -Fi + ki (hi - zi) + ei (hi' - zi')

m is the mass less the wheels, θ the pitch angle (nose down), zb = z - a θ in front and z + b θ at the rear; zi is the
height of the hubs, hi of the road. c, d, k and mi are those of both wheels of an axle. The wheel travel zi - zbi
is positive in bump. The tyre touches the road along a length, over which it averages the road (at the mean speed).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.channels import AXLES
from mirdrake.identification.models.base import (
    OFFSETS,
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
from mirdrake.identification.parameters import Parameter
from mirdrake.vehicles import Vehicle

_CONTACT = 0.03  # standard deviation of the length over which a tyre averages the road [m]
_MASS = 0.02  # standard deviation of a mass that is not measured, relative [1]
_TRAVEL_OFFSET = 0.005  # of a travel sensor [m]


class RideOptions(ModelOptions):
    """Options of the ride model."""

    outputs: list[str] | None = Field(default=None, description="channels to compare; all if left out [-]")


class RideModel(EquationModel):
    """Half car over a known road; the equations are in the docstring of the module.

    Raises:
        ConfigError: a channel is missing.
    """

    kind = "ride"
    Options = RideOptions
    max_step = 0.0051
    states = ("z", "pitch", "z_front", "z_rear", "vz", "pitch_rate", "vz_front", "vz_rear")
    state_scales = (0.01, 0.01, 0.01, 0.01, 0.1, 0.1, 0.5, 0.5)
    input_parameters = frozenset({"contact_length"})

    def __init__(
        self, channels: set[str], known: Mapping[str, float], wheelbase: float | None, options: RideOptions
    ) -> None:
        self.title = "ride, half car"
        self._road = tuple(
            find_channel(channels, (f"road_height_{axle}",), "the height of the road", self.kind) for axle in AXLES
        )
        self._speed = find_channel(channels, SPEED, "the speed", self.kind)
        self.inputs, self.exact_inputs = (*self._road, self._speed), tuple(self._road)
        possible = [*(f"suspension_travel_{axle}" for axle in AXLES), "vertical_acceleration", "pitch_rate"]
        self.outputs = select_outputs(channels, possible, options.outputs, self.kind)
        self.parameters = _make_parameters(known, wheelbase)

    def input_signals(self, p: Mapping[str, float], drive: Segment, times: Array) -> Array:
        """Return height [m] and its rate [m/s] of the road under the tyres of both axles."""
        wide, early = drive.with_history(times)
        step, signals = float(times[1] - times[0]), []
        speed = float(np.nanmean(np.abs(drive.inputs[self._speed])))
        # Mean over the contact length by Gauss's rule with three points, which is exact for polynomials of degree 5.
        span = 0.5 * p["contact_length"] / max(speed, 1.0) * np.sqrt(0.6)
        for name in self._road:
            ahead, here, behind = (drive.at(name, wide + shift, smooth=True) for shift in (span, 0.0, -span))
            height = (5.0 * ahead + 8.0 * here + 5.0 * behind) / 18.0
            signals += [height[early:], np.gradient(height, step)[early:]]
        return np.stack(signals)

    def _accelerations(self, x: Array, u: Array, p: Values) -> tuple[Array, Array, Array, Array]:
        """Return the accelerations of body, pitch and both hubs."""
        z, pitch, zf, zr, vz, rate, vf, vr = x
        front = p["front_stiffness"] * (zf - z + p["front_length"] * pitch)
        front = front + p["front_damping"] * (vf - vz + p["front_length"] * rate)
        rear = p["rear_stiffness"] * (zr - z - p["rear_length"] * pitch)
        rear = rear + p["rear_damping"] * (vr - vz - p["rear_length"] * rate)
        sprung = p["mass"] - p["front_unsprung"] - p["rear_unsprung"]
        road_f = p["front_tyre_stiffness"] * (u[0] - zf) + p["tyre_damping"] * (u[1] - vf)
        road_r = p["rear_tyre_stiffness"] * (u[2] - zr) + p["tyre_damping"] * (u[3] - vr)
        return (
            np.asarray((front + rear) / sprung),
            np.asarray((p["rear_length"] * rear - p["front_length"] * front) / p["pitch_inertia"]),
            np.asarray((road_f - front) / p["front_unsprung"]),
            np.asarray((road_r - rear) / p["rear_unsprung"]),
        )

    def rates(self, x: Array, u: Array, p: Values) -> Array:
        """Return the derivatives of heights and velocities."""
        return np.concatenate([x[4:], np.stack(np.broadcast_arrays(*self._accelerations(x, u, p)))])

    def observe(self, x: Array, u: Array, p: Values) -> Array:
        """Return travels, the acceleration of the sensor with gravity, and the pitch rate."""
        z, pitch, zf, zr = x[0], x[1], x[2], x[3]
        result = []
        for name in self.outputs:
            if name == "vertical_acceleration":
                lift, turn, _, _ = self._accelerations(x, u, p)
                result.append(lift - p["sensor_ahead"] * turn + GRAVITY)
            elif name == "pitch_rate":
                result.append(x[5])
            elif "front" in name:
                result.append(zf - z + p["front_length"] * pitch)
            else:
                result.append(zr - z - p["rear_length"] * pitch)
        return np.stack(np.broadcast_arrays(*result))

    def initial_states(self, p: Mapping[str, float], drive: Segment, rows: NDArray[np.intp]) -> Array:
        """Return the states of a car that follows the road."""
        front, rear = (drive.inputs[name][rows] for name in self._road)
        wheelbase = p["front_length"] + p["rear_length"]
        pitch = (rear - front) / wheelbase
        z = (p["rear_length"] * front + p["front_length"] * rear) / wheelbase
        none = np.zeros_like(z)
        return np.stack([z, pitch, front, rear, none, none, none, none])

    def offset_scale(self, channel: str) -> float:
        """Return the expected size of a sensor's offset."""
        return _TRAVEL_OFFSET if channel.startswith("suspension_travel") else OFFSETS.get(channel, 0.0)

    def derived_quantities(self, p: Mapping[str, float]) -> dict[str, tuple[float, str]]:
        """Return ride and hop frequencies, and damping ratios, of both axles."""
        sprung = p["mass"] - p["front_unsprung"] - p["rear_unsprung"]
        wheelbase = p["front_length"] + p["rear_length"]
        quantities = {}
        for axle, arm in (("front", p["rear_length"]), ("rear", p["front_length"])):
            mass = sprung * arm / wheelbase
            spring, tyre = p[f"{axle}_stiffness"], p[f"{axle}_tyre_stiffness"]
            ride = np.sqrt(spring * tyre / (spring + tyre) / mass)
            quantities[f"ride frequency, {axle}"] = (float(ride / (2.0 * np.pi)), "Hz")
            hop = np.sqrt((spring + tyre) / p[f"{axle}_unsprung"])
            quantities[f"hop frequency, {axle}"] = (float(hop / (2.0 * np.pi)), "Hz")
            ratio = p[f"{axle}_damping"] / (2.0 * np.sqrt(spring * mass))
            quantities[f"damping ratio, {axle}"] = (float(ratio), "1")
        return quantities

    def assumptions(self, p: Mapping[str, float], assumed: frozenset[str]) -> tuple[Assumption, ...]:
        """Return the assumed mass and contact length. All forces are proportional to the mass."""
        sizes = {
            "mass": (_MASS * p["mass"], "the mass", "weigh the vehicle"),
            "contact_length": (_CONTACT, "the length over which a tyre averages the road", "give contact_length"),
        }
        return tuple(
            Assumption(words, remedy, {name: p[name] + SMALL_FRACTION * size}, SMALL_FRACTION)
            for name, (size, words, remedy) in sizes.items()
            if name in assumed
        )

    def suggest_experiment(self, names: frozenset[str], drives: Sequence[Segment] = ()) -> str:
        """Return which drive would identify these parameters."""
        del drives
        if any("tyre" in name or "unsprung" in name for name in names):
            return "drive over a rougher road, or faster, so that the wheels hop"
        return "drive over a road with long waves, so that body and pitch move"

    @classmethod
    def vehicle_values(cls, vehicle: Vehicle, options: Any, *, measured: bool) -> dict[str, float]:
        """Return mass, lengths, springs and dampers of a vehicle, for both wheels of an axle."""
        from mirdrake.identification.models.vehicle_values import common_values

        del options
        common = common_values(vehicle, measured=measured)
        names = ("mass", "front_length", "rear_length")
        values: dict[str, float] = {name: common[name] for name in names if name in common}
        springs = vehicle.spec.suspension
        if springs is not None:
            for axle in AXLES:
                own = getattr(springs, axle)
                values |= {f"{axle}_stiffness": 2.0 * own.stiffness, f"{axle}_damping": 2.0 * own.damping}
        return values


def _make_parameters(known: Mapping[str, float], wheelbase: float | None) -> tuple[Parameter, ...]:
    """Return the parameters of a half car; guesses are those of a usual car of the given mass."""
    bare = "mass" not in known
    m, length = known.get("mass", 1500.0), wheelbase or 2.7
    source = "not given: 1500 kg, to which all forces are proportional" if bare else ""
    a = known.get("front_length", 0.5 * length)
    parameters = [
        Parameter("mass", "kg", "mass of the vehicle", m, 10.0, 1e5, source=source),
        Parameter("front_length", "m", "distance of the centre of mass from the front axle", a, 0.05, 10.0),
        Parameter("rear_length", "m", "the same from the rear axle", known.get("rear_length", length - a), 0.05, 10.0),
        Parameter("pitch_inertia", "kg m^2", "pitch inertia of the body", 0.9 * m * a * (length - a), 0.1 * m,
                  3.0 * m * length**2, True, 0.1 * m, usual=2.0),
    ]  # fmt: skip
    for axle in AXLES:
        parameters += [
            Parameter(f"{axle}_stiffness", "N/m", f"both springs of the {axle} axle, at the wheel", 35.0 * m, 1.0 * m,
                      500.0 * m, True, usual=2.0),
            Parameter(f"{axle}_damping", "N s/m", f"both dampers of the {axle} axle, at the wheel", 2.3 * m, 0.05 * m,
                      30.0 * m, True, usual=2.0),
            Parameter(f"{axle}_tyre_stiffness", "N/m", f"vertical stiffness of both {axle} tyres", 250.0 * m, 10.0 * m,
                      2e3 * m, True, usual=1.5),
            Parameter(f"{axle}_unsprung", "kg", f"mass of both {axle} wheels and what moves with them", 0.05 * m,
                      2e-3 * m, 0.3 * m, True, usual=2.0),
        ]  # fmt: skip
    return (
        *parameters,
        Parameter("tyre_damping", "N s/m", "vertical damping of both tyres of an axle", 0.3 * m, 0.0, 3.0 * m, True,
                  scale=0.1 * m, usual=4.0),
        Parameter("contact_length", "m", "length over which a tyre averages the road", 0.22, 0.0, 0.5,
                  scale=0.05),
        Parameter("sensor_ahead", "m", "distance of the accelerometer ahead of the centre of mass", 0.0, -5.0, 5.0,
                  scale=0.1),
    )  # fmt: skip

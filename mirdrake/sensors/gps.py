"""GPS receiver: position on the Earth and in the world, velocity, NMEA sentences."""

from math import atan2, cos, hypot, inf, nan, pi, sin
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from mirdrake.core.signals import signals
from mirdrake.sensors.geodesy import DatumSpec, to_geodetic
from mirdrake.sensors.mount import SensorMount
from mirdrake.sensors.nmea import Fix, gga, rmc
from mirdrake.sensors.noise import Noise
from mirdrake.sensors.noise_spec import LengthNoise, SpeedNoise
from mirdrake.sensors.sampling import Array, SampledSensor, mount_pose

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

GPS = signals(
    ("x", "m"),
    ("y", "m"),
    ("z", "m"),
    ("vx", "m/s"),
    ("vy", "m/s"),
    ("vz", "m/s"),
    ("latitude", "deg", "north"),
    ("longitude", "deg", "east"),
    ("altitude", "m", "above the WGS 84 ellipsoid"),
)
"""Position and velocity of the mount's origin in the world, and its position on the Earth."""

QUALITY = {"single": 1, "differential": 2, "rtk": 4}
"""Quality indicator of GGA for each kind of fix."""


class Gps(SampledSensor):
    """Position and velocity of a frame in the world, and its position on the Earth.

    Input ports:
        body_poses, body_spatial_velocities: the plant's outputs of all bodies.
    Output ports:
        sample (9) [m, m/s, deg]: :data:`GPS`. The first sample is output from the start; with a latency, NaN before it.
        stamp (1) [s]: time of the sample; -inf before the first.
        nmea: text, the sentences GGA and RMC of the sample, each with its end of line; empty before the first. Their
            clock starts at 1970-01-01 00:00:00 UTC, as that of picture names.

    Args:
        frame: mounting frame of the antenna; fixed to a body.
        mount: rate, noise, latency, dropout, datum and kind of fix.
        stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.
        period: time step of the plant [s], by half of which positions lead velocities.
    """

    def __init__(self, frame: Frame, mount: "GpsMount", *, stream: int = 0, period: float = 0.0) -> None:
        noise = [mount.noise, mount.noise, mount.vertical_noise, *[mount.velocity_noise] * 3]
        # Noise is added to the six measured values; latitude and longitude follow from them, so both agree.
        super().__init__(GPS, mount, stream=stream, initial=[nan] * 9, noise=Noise.of(noise, mount.rate))
        body, X_BS = mount_pose(frame)
        self._period, self._datum, self._quality = period, mount.datum, QUALITY[mount.fix]
        self._body, self._place = int(body.index()), X_BS.translation()
        self.body_poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        velocities = AbstractValue.Make([SpatialVelocity()])
        self.body_velocities = self.DeclareAbstractInputPort("body_spatial_velocities", velocities)
        # The text follows from the held sample only; without this, Drake assumes a dependence on all inputs.
        needs = {self.discrete_state_ticket(self._held), self.discrete_state_ticket(self._held_stamp)}
        self.nmea = self.DeclareAbstractOutputPort("nmea", lambda: AbstractValue.Make(""), self._calc_nmea, needs)
        self.declare_first_sample()

    def measure(self, context: Context) -> Array:
        """Return position [m] and velocity [m/s] of the antenna in the world (6)."""
        X_WB, V_WB = self.body_poses.Eval(context)[self._body], self.body_velocities.Eval(context)[self._body]
        # Velocity of a point fixed to the body: v_P = v_B + w x p_BP, all in the world frame.
        arm = X_WB.rotation().multiply(self._place)
        velocity = V_WB.translational() + np.cross(V_WB.rotational(), arm)
        return np.concatenate((X_WB.translation() + arm - 0.5 * self._period * velocity, velocity))

    def report(self, values: Array) -> Array:
        """Return the reading and the position on the Earth [deg, deg, m] (9)."""
        return np.concatenate((values, to_geodetic(values[:3], self._datum)))

    def _calc_nmea(self, context: Context, output: AbstractValue) -> None:
        time = float(context.get_discrete_state(self._held_stamp).get_value()[0])
        if time == -inf:
            output.set_value("")
            return
        _, _, _, vx, vy, _, latitude, longitude, altitude = context.get_discrete_state(self._held).get_value().tolist()
        # The world's x axis points `heading` clockwise from north, y a quarter turn to the left of it.
        heading = self._datum.heading
        north, east = vx * cos(heading) + vy * sin(heading), vx * sin(heading) - vy * cos(heading)
        course = atan2(east, north) * 180.0 / pi % 360.0
        fix = Fix(time, latitude, longitude, altitude, hypot(east, north), course, self._quality)
        output.set_value(gga(fix) + rmc(fix))


class GpsMount(SensorMount):
    """Satellite navigation receiver (GNSS)."""

    kind: Literal["gps"]
    noise: LengthNoise = Field(default_factory=LengthNoise, description="[m] horizontal position error, each axis")
    vertical_noise: LengthNoise = Field(default_factory=LengthNoise, description="[m] altitude error")
    velocity_noise: SpeedNoise = Field(default_factory=SpeedNoise, description="[m/s] velocity error, each axis")
    datum: DatumSpec = Field(default_factory=DatumSpec, description="geographic position of the world's origin")
    fix: Literal["single", "differential", "rtk"] = Field(default="single", description="fix quality in NMEA sentences")

    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> Gps:
        """Return the GPS receiver."""
        frame = parts.plant.GetFrameByName(self.frame, part.instance)
        return Gps(frame, self, stream=stream, period=part.period)

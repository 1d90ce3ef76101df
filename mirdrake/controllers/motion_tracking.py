"""Motion tracking: speed and steering that keep a full vehicle at the pose of a moving frame, the motion of an actor.

Both are predicted to the time at which the steering acts. In the moving frame, with its path curvature, the lateral and
heading errors go to zero by the law of the path tracker, see :mod:`mirdrake.controllers.path_tracking`. Along it, the
speed set-point is that of the frame, ahead by the lag of the vehicle, and a share of the distance to it per second.
"""

import math

from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.actors.traffic import MOTION, PREVIEW
from mirdrake.controllers.ackermann import Ackermann, SteeringGeometry
from mirdrake.controllers.drivable_line import DrivingLimits
from mirdrake.controllers.path_law import PathNumbers, Place, TrackerNumbers, steering_step
from mirdrake.controllers.path_tracking import PathGains
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_state_output, declare_vector_input
from mirdrake.core.vectors import COMMAND, STATE, Command

PERIOD = 0.02
"""Time between two updates [s], that of the motion."""

LAG = 0.04
"""Time by which the speed of a vehicle lags behind its set-point [s]."""

CATCH_UP = 0.8
"""Speed over the distance to the moving frame [1/s]."""

_SLOW = 0.1  # [m/s] speed of the frame below which a vehicle at its place is at rest
_AT_PLACE = 0.05  # [m]
_HERE = PathNumbers(length=1.0, spacing=1.0, closed=False, last=0)  # a line with the values of one point


class MotionTracker(LeafSystem):
    """A driver that follows a motion.

    Input ports:
        state (12) [m, rad, m/s, rad/s]: see :data:`~mirdrake.core.vectors.STATE`.
        motion (7) [m, rad, m/s, m/s², 1/m]: see :data:`~mirdrake.actors.traffic.MOTION`.

    Output ports:
        command (3) [m/s, rad, s]: speed, steering, stamp; a state, as of :class:`PathTracker`.

    Args:
        geometry: lengths and steering limits of the vehicle.
    """

    def __init__(self, geometry: SteeringGeometry) -> None:
        super().__init__()
        self._law = law = Ackermann(geometry)
        limits = DrivingLimits()
        self._gains = PathGains(speed=0.0)
        self._vehicle = TrackerNumbers(
            law.wheelbase, law.limit, law.rate, limits.lateral, limits.acceleration, limits.deceleration, PERIOD
        )
        self.state = declare_vector_input(self, "state", STATE)
        self.motion = declare_vector_input(self, "motion", MOTION)
        self._command = self.DeclareDiscreteState(len(COMMAND))
        self.command = declare_state_output(self, "command", COMMAND, self._command)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        x, y, _, _, _, yaw, vx, vy, _, _, _, wz = self.state.Eval(context).tolist()
        x_m, y_m, yaw_m, speed_m, acceleration, curvature, then = self.motion.Eval(context).tolist()

        # Along the frame: where the vehicle is now. It does not reverse, and does not creep at its place.
        behind = (x_m - x) * math.cos(yaw_m) + (y_m - y) * math.sin(yaw_m)
        speed = max(0.0, speed_m + LAG * acceleration + CATCH_UP * behind)
        if speed_m < _SLOW and behind < _AT_PLACE and acceleration <= 0.0:
            speed = 0.0

        # Across it: where both will be when the steering acts. The course is the yaw but for side slip.
        ahead, law = self._gains.preview_time, self._law
        course = yaw + min(max(math.atan2(vy, max(vx, 1.0)), -0.2), 0.2)
        x, y, course = _moved(x, y, course, max(vx, 0.0), wz, ahead)
        x_m, y_m, yaw_m = _moved(x_m, y_m, yaw_m, speed_m, curvature * speed_m, ahead)
        lateral = (y - y_m) * math.cos(yaw_m) - (x - x_m) * math.sin(yaw_m)
        # The steering turns into a bend before its begin, as far as its rate leaves no more for the preview time.
        left = law.rate * PREVIEW
        now, later = law.steering(curvature), law.steering(then)
        led = law.curvature(min(max(now, later - left), later + left))
        line, place = [[0.0, 0.0, led, speed_m]] * 2, Place(0.0, lateral, yaw_m, curvature)
        steering = steering_step(_HERE, line, self._gains, self._vehicle, place, course, max(vx, 0.0))
        values.set_value(self._command, Command(speed, steering, context.get_time()))


def _moved(x: float, y: float, yaw: float, speed: float, rate: float, time: float) -> tuple[float, float, float]:
    """Return a pose [m, m, rad] after a time [s] at a constant speed [m/s] and yaw rate [rad/s]."""
    middle, way = yaw + 0.5 * rate * time, speed * time
    return x + way * math.cos(middle), y + way * math.sin(middle), yaw + rate * time

"""Base of the kinds of joint control: what a kind has to declare, and the defaults.

The control unit runs the same steps for every kind: it computes a set-point for each joint (a spin rate [rad/s] or a
steering angle [rad]), calls the law of the kind, and writes the returned torque to the joint's actuator. Drake's
implicit PD servo of the joint, if the kind has one, acts in addition to that torque.
"""

from collections.abc import Callable, MutableSequence, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from mirdrake.core.interpolation import Rows
from mirdrake.core.pid import PidLimits
from mirdrake.core.yaml_io import Schema
from mirdrake.vehicles.joint_control.gain_schedule import GainSchedule

if TYPE_CHECKING:
    from mirdrake.vehicles.spec import VehicleSpec

DEFAULT_LAG = 0.02
"""Time constant of a steering joint in the reduced model, where the kind does not determine one [s]."""


class ServoGains(NamedTuple):
    """Gains of Drake's implicit PD servo of a joint: torque = stiffness x error + damping x error of the rate.

    Attributes:
        stiffness: [N m/rad]
        damping: [N m s/rad]
    """

    stiffness: float
    damping: float


class NoNumbers(NamedTuple):
    """Numbers of a law without gains; Numba needs at least one field."""

    unused: float = 0.0


class PedalPositions(NamedTuple):
    """Throttle and brake [1], and the gear: 1 drive, -1 reverse."""

    throttle: float
    brake: float
    gear: float


class PedalMaps(Protocol):
    """Characteristic curves of the pedals.

    Attributes:
        throttle: rows of pedal position [1] and share of the drive torque [1].
        brake: rows of pedal position [1] and torque of the four brakes [N m].
    """

    throttle: Rows
    brake: Rows


class DriveTrain(Protocol):
    """The properties of a powertrain that a pedal controller uses; :class:`mirdrake.plant.powertrain.PowertrainLaw`.

    Attributes:
        mass: mass of the vehicle [kg].
        rotating: equivalent mass of the rotating parts [kg].
        radius: radius of the driven wheels [m].
        maps: characteristic curves of the pedals.
    """

    mass: float
    rotating: float
    radius: float

    @property
    def maps(self) -> PedalMaps: ...  # noqa: D102

    def limits(self, gear: float, rate: float) -> tuple[float, float]:
        """Return the drive torque [N m] with the throttle closed and open, at a spin rate [rad/s] of the wheels."""


class PedalController(Protocol):
    """The speed controller of a kind that drives with the pedals."""

    def rest(self) -> list[float]:
        """Return the memory at the start."""

    def numbers(self, gains: Sequence[float]) -> Any:
        """Return what :meth:`step` takes as its gains, from the values of the gains in the Context."""

    def step(
        self, memory: Sequence[float], setpoint: float, slope: float, speed: float, *, gains: Any
    ) -> tuple[list[float], PedalPositions]:
        """Advance by one period.

        Args:
            memory: memory returned by the last step.
            setpoint: set-point of the speed [m/s].
            slope: its derivative [m/s²].
            speed: measured speed [m/s].
            gains: gains from :meth:`numbers`.

        Returns:
            The memory for the next step, and the pedals.
        """


JointLaw = Callable[[MutableSequence[float], int, float, float, float, Any, float, PidLimits], float]
"""``law(memory, start, setpoint, measurement, feedforward, numbers, period, limits) -> torque [N m]``.

The memory of the joint begins at ``memory[start]``; the law updates it in place. ``numbers`` is what the kind returned
from :meth:`JointControl.numbers`; ``limits`` are the limits of the torque.
"""


def feedforward_only(
    memory: MutableSequence[float],  # noqa: ARG001
    start: int,  # noqa: ARG001
    setpoint: float,  # noqa: ARG001
    measurement: float,  # noqa: ARG001
    feedforward: float,
    numbers: NoNumbers,  # noqa: ARG001
    period: float,  # noqa: ARG001
    limits: PidLimits,  # noqa: ARG001
) -> float:
    """Return the feed-forward torque [N m]: the law of a joint whose servo is Drake's."""
    return feedforward


class JointControl(Schema):
    """One kind of control for the wheels or for the steering joints.

    The fields of a subclass are its keys in control.yaml. A subclass declares what differs from the defaults below, and
    is registered with one line in :mod:`mirdrake.vehicles.joint_control`. Laws must be plain functions that Numba can
    compile (:mod:`mirdrake.core.compiled`).

    Attributes:
        gains: name and unit of each gain that may change while a simulation runs; each is a field of the schema.
        uses_pedals: whether throttle and brake drive the vehicle in place of the wheels' actuators.
        is_external: whether the torques come from a diagram instead of a law.
        law_parts: functions that the law calls, and those that they call.
        memory: initial memory of the law for one joint.
        number_type: class of the numbers that the law takes: a named tuple of floats.
    """

    gains: ClassVar[dict[str, str]] = {}
    uses_pedals: ClassVar[bool] = False
    is_external: ClassVar[bool] = False
    law_parts: ClassVar[tuple[Callable[..., Any], ...]] = ()
    memory: ClassVar[tuple[float, ...]] = ()
    number_type: ClassVar[type[Any]] = NoNumbers

    kind: str

    def torque_law(self) -> JointLaw:
        """Return the law of the torque of one joint."""
        return feedforward_only

    def gain_values(self) -> list[float]:
        """Return the values of the gains, in the order of `gains`."""
        return [float(getattr(self, name)) for name in self.gains]

    def gain_schedule(self) -> GainSchedule | None:
        """Return the gains over speed, if the kind has them."""
        return None

    def numbers(self, gains: Sequence[float]) -> Any:
        """Return the numbers that the law takes, for values of the gains."""
        return self.number_type(*gains)

    def torque_limits(self, joint_limit: float) -> PidLimits:
        """Return the limits of the torque [N m], for the limit of the joint's actuator [N m]."""
        return PidLimits(-joint_limit, joint_limit)

    def servo_gains(self) -> ServoGains | None:
        """Return the gains of Drake's implicit servo; None: the joint has no such servo."""
        return None

    def has_open_differential(self) -> bool:
        """Return whether the servos of an axle's two wheels share their torque equally."""
        return False

    def lag(self) -> float:
        """Return the time constant of the joint in the reduced model [s]."""
        gains = self.servo_gains()
        if gains is None or gains.damping == 0.0 or gains.stiffness == 0.0:
            return DEFAULT_LAG
        return gains.damping / gains.stiffness

    def make_pedal_controller(self, drive_train: DriveTrain, spec: "VehicleSpec", period: float) -> PedalController:
        """Return the controller of the pedals, for a kind that uses them.

        Args:
            drive_train: powertrain of the vehicle.
            spec: vehicle.yaml.
            period: time between updates [s].
        """
        raise NotImplementedError(f"{type(self).__name__} does not use pedals")

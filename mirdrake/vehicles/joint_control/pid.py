"""PID controllers of the joints, one per joint, which run at the rate of the control unit."""

from collections.abc import Callable, MutableSequence, Sequence
from math import inf
from typing import Any, ClassVar, Literal

from pydantic import Field

from mirdrake.core.pid import PidGains, PidLimits, PidNumbers, PidState, pid_step, read_pid, write_pid
from mirdrake.core.yaml_io import Duration, Torque
from mirdrake.vehicles.joint_control.base import JointControl, JointLaw
from mirdrake.vehicles.joint_control.gain_schedule import GainSchedule


def pid_torque(
    memory: MutableSequence[float],
    start: int,
    setpoint: float,
    measurement: float,
    feedforward: float,
    numbers: PidNumbers,
    period: float,
    limits: PidLimits,
) -> float:
    """Return the torque of a PID controller [N m]; :data:`mirdrake.vehicles.joint_control.base.JointLaw`."""
    state, torque = pid_step(read_pid(memory, start), setpoint, measurement, numbers, period, limits, feedforward)
    write_pid(memory, start, state)
    return torque


class Pid(JointControl):
    """Torque from a discrete PID controller; the unit of the error is rad (steering) or rad/s (wheel speed)."""

    law_parts: ClassVar[tuple[Callable[..., Any], ...]] = (pid_step, read_pid, write_pid)
    memory: ClassVar[tuple[float, ...]] = tuple(PidState())
    number_type: ClassVar[type[Any]] = PidNumbers

    kind: Literal["pid"]
    kp: float = Field(ge=0, description="[N m per unit] proportional gain")
    ki: float = Field(default=0.0, ge=0, description="[N m per unit and s] integral gain")
    kd: float = Field(default=0.0, ge=0, description="[N m s per unit] derivative gain")
    filter: Duration = Field(default=0.0, ge=0, description="[s] time constant of the derivative's low-pass")
    max_torque: Torque | None = Field(default=None, gt=0, description="[N m] limit; empty: the joint's own limit")
    max_integral: Torque | None = Field(default=None, ge=0, description="[N m] limit of the integral part; empty: none")
    schedule: GainSchedule | None = Field(default=None, description="gains over speed, in place of those above")

    def torque_law(self) -> JointLaw:
        """Return the law of the torque of one joint."""
        return pid_torque

    def gain_schedule(self) -> GainSchedule | None:
        """Return the gains over speed."""
        return self.schedule

    def numbers(self, gains: Sequence[float]) -> PidNumbers:
        """Return the numbers of the law for kp, ki and kd."""
        kp, ki, kd = gains
        limit = inf if self.max_integral is None else self.max_integral
        return PidGains(kp, ki, kd, filter_time=self.filter, max_integral=limit).numbers()

    def torque_limits(self, joint_limit: float) -> PidLimits:
        """Return the limits of the torque [N m]."""
        limit = joint_limit if self.max_torque is None else self.max_torque
        return PidLimits(-limit, limit)


class WheelPid(Pid):
    """Torque of a wheel from a discrete PID controller of its spin rate."""

    gains: ClassVar[dict[str, str]] = {"kp": "N m s/rad", "ki": "N m/rad", "kd": "N m s²/rad"}


class SteeringPid(Pid):
    """Torque of a steering joint from a discrete PID controller of its angle."""

    gains: ClassVar[dict[str, str]] = {"kp": "N m/rad", "ki": "N m/(rad s)", "kd": "N m s/rad"}

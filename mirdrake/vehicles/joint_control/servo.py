"""Servos of Drake: PD control of a joint that Drake solves implicitly with the contacts, stable at any gain."""

from typing import Literal

from pydantic import Field

from mirdrake.vehicles.joint_control.base import JointControl, ServoGains


class VelocityServo(JointControl):
    """Torque = gain x (set-point - measured wheel speed), solved implicitly by Drake.

    With an open differential, set-point and measured speed are the means of an axle's two wheels, so that both wheels
    get the same torque and the drive makes no yaw moment.
    """

    kind: Literal["servo"]
    gain: float = Field(gt=0, description="[N m s/rad] per wheel")
    differential: Literal["none", "open"] = Field(
        default="none", description="none: a motor and a set-point per wheel; open: one drive per axle, equal torques"
    )

    def servo_gains(self) -> ServoGains:
        """Return the gains of Drake's servo."""
        return ServoGains(0.0, self.gain)

    def has_open_differential(self) -> bool:
        """Return whether the servos of an axle's two wheels share their torque equally."""
        return self.differential == "open"


class PositionServo(JointControl):
    """Torque = stiffness x angle error - damping x rate error, solved implicitly.

    The damping is adapted to the time step (:func:`mirdrake.plant.plant.implicit_servo`).
    """

    kind: Literal["servo"]
    stiffness: float = Field(gt=0, description="[N m/rad] per steered wheel")
    damping: float = Field(ge=0, description="[N m s/rad] per steered wheel")

    def servo_gains(self) -> ServoGains:
        """Return the gains of Drake's servo."""
        return ServoGains(self.stiffness, self.damping)

"""Joint loops that are not part of mirdrake: a diagram connects the torques."""

from typing import ClassVar, Literal

from mirdrake.vehicles.joint_control.base import JointControl


class External(JointControl):
    """The torques of the joints are an input of the diagram, for your own controller.

    A diagram connects ``<vehicle>.control.wheel_loops.torque``, or ``<vehicle>.control.left_steering_loop.torque`` and
    ``<vehicle>.control.right_steering_loop.torque``.
    """

    is_external: ClassVar[bool] = True

    kind: Literal["external"]

"""Results of the inspection of a vehicle, as plain data; :mod:`mirdrake.vehicles.inspection` computes them."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import cast

from mirdrake.core.json_io import Json, finite_or_none, plain_data


class JointRole(StrEnum):
    """Role of a joint in vehicle.yaml."""

    NONE = ""
    WHEEL = "wheel"
    DRIVEN_WHEEL = "wheel, driven"
    STEERING = "steering"
    SUSPENSION = "suspension"

    @property
    def is_wheel(self) -> bool:
        """Whether the joint is the axle of a wheel."""
        return self in {JointRole.WHEEL, JointRole.DRIVEN_WHEEL}


@dataclass(frozen=True)
class LinkFigures:
    """One link.

    Attributes:
        name: name of the link.
        mass: [kg].
        com: centre of mass in the link's frame [m].
        moments: principal moments of inertia about the centre of mass, rising [kg m²].
        edges: edges of the homogeneous box with these moments, longest first [m]; zeros for a frame without mass.
        extent: edges of the box around its shapes [m], longest first; zeros without shapes.
        size_ratio: longest of the edges over the longest of the extent; None without mass or shapes.
        triangle: sum of the two smaller moments over the largest: 1 a flat plate, below it no body; None without mass.
        spin: inertia of a wheel about its joint's axis over m R²; None for other links.
        spin_is_smaller: whether a wheel's inertia about that axis is not its largest.
        friction: largest friction coefficient of its shapes [-]; None without shapes.
    """

    name: str
    mass: float
    com: tuple[float, float, float]
    moments: tuple[float, float, float]
    edges: tuple[float, float, float]
    extent: tuple[float, float, float]
    size_ratio: float | None = None
    triangle: float | None = None
    spin: float | None = None
    spin_is_smaller: bool = False
    friction: float | None = None


@dataclass(frozen=True)
class JointFigures:
    """One joint.

    Attributes:
        name: name of the joint.
        kind: its type in the URDF.
        parent: link.
        child: link.
        role: role in vehicle.yaml.
        corner: place of the role, ``front_left`` or ``left``; "" without a role.
        place: place of its child's frame in base_link [m].
        axis: axis in base_link; empty for fixed joints.
        lower: limit [rad], of a prismatic joint [m]; -inf without one.
        upper: limit, likewise; inf without one.
        velocity: limit [rad/s] or [m/s].
        effort: effort of its actuator [N m]; 0 without one.
        damping: [N m s/rad] or [N s/m].
    """

    name: str
    kind: str
    parent: str
    child: str
    role: JointRole
    corner: str
    place: tuple[float, float, float]
    axis: tuple[float, ...]
    lower: float
    upper: float
    velocity: float
    effort: float
    damping: float = 0.0

    @property
    def role_text(self) -> str:
        """Corner and role, such as "front_left wheel, driven"; "" without a role."""
        return f"{self.corner} {self.role}".strip()


@dataclass(frozen=True)
class ActuatorFigures:
    """Actuator: its name, its joint, the moved part, and the largest effort [N m]."""

    name: str
    joint: str
    moves: str
    effort: float


@dataclass(frozen=True)
class SensorFigures:
    """One mounted sensor.

    Attributes:
        name: name of the mount.
        kind: kind of the sensor.
        frame: link it is mounted in.
        place: place of the frame in base_link [m].
        rate: samples per second [Hz].
        yaw: heading of the frame's x axis in base_link, positive to the left [rad].
        pitch: pitch of the same axis, positive upwards [rad].
        roll: rotation about this axis [rad].
        across: horizontal field of view, right and left end about its x axis [rad]; empty for sensors without one.
        upward: the same from below to above [rad].
        reach: nearest and farthest distance [m]; empty for what does not look anywhere.
    """

    name: str
    kind: str
    frame: str
    place: tuple[float, float, float]
    rate: float
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    across: tuple[float, ...] = ()
    upward: tuple[float, ...] = ()
    reach: tuple[float, ...] = ()


@dataclass(frozen=True)
class Overlap:
    """A wheel and another link that are in the same place.

    Attributes:
        wheel: link.
        link: the other one.
        depth: depth of the overlap [m].
        pose: "straight ahead" or "at full lock".
    """

    wheel: str
    link: str
    depth: float
    pose: str


@dataclass(frozen=True)
class Inspection:
    """Figures of a vehicle; lengths [m], masses [kg], inertia [kg m²], angles [rad], in base_link.

    Attributes:
        vehicle: its name.
        title: make and model.
        grade: grade of its data.
        drive: driven axle.
        mass: all of it.
        com: centre of mass.
        loads: loads of front and rear axle at rest [N].
        front_share: part of the load on the front axle.
        side_share: part of the load on the left wheels.
        wheelbase: distance between the axles.
        tracks: front and rear.
        kingpin_track: distance between the steering axes.
        wheel_radii: front and rear, unloaded.
        wheel_widths: front and rear.
        size: length, width, height over the road of all collision shapes.
        visual_size: length, width, height of all visual shapes; None without visual shapes.
        ground_clearance: lowest point of all bodies but the wheels.
        steering_limits: steering limits of inner and outer wheel at full lock.
        turning_radius: turning radius of the rear axle's centre at full lock.
        turning_circle: diameter of the circle of the outer front wheel's middle, kerb to kerb.
        wall_circle: diameter of the circle of the outermost corner of all collision shapes, wall to wall.
        inertia: roll, pitch, yaw about the centre of mass.
        gyration: radii of gyration about the same axes.
        dynamic_index: k² / (a b) of the yaw inertia; at 1, an impact at one axle does not accelerate the other one.
        static_stability: track over twice the height of the centre of mass; lateral g at which it tips.
        overlaps: wheels that penetrate other links, straight ahead or at full lock.
        links: all links.
        joints: all joints.
        actuators: all actuators.
        sensors: all mounted sensors.
        warnings: sentences about implausible values.
    """

    vehicle: str
    title: str
    grade: str
    drive: str
    mass: float
    com: tuple[float, float, float]
    loads: tuple[float, float]
    front_share: float
    side_share: float
    wheelbase: float
    tracks: tuple[float, float]
    kingpin_track: float
    wheel_radii: tuple[float, float]
    wheel_widths: tuple[float, float]
    size: tuple[float, float, float]
    visual_size: tuple[float, float, float] | None
    ground_clearance: float
    steering_limits: tuple[float, float]
    turning_radius: float
    turning_circle: float
    wall_circle: float
    inertia: tuple[float, float, float]
    gyration: tuple[float, float, float]
    dynamic_index: float
    static_stability: float
    overlaps: tuple[Overlap, ...]
    links: tuple[LinkFigures, ...]
    joints: tuple[JointFigures, ...]
    actuators: tuple[ActuatorFigures, ...]
    sensors: tuple[SensorFigures, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> Json:
        """Plain data, for JSON; what is not finite becomes None."""
        return cast(Json, plain_data(asdict(self), finite_or_none))

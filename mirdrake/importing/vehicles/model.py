"""Model of a vehicle as read from URDF, xacro or SDF.

Readers fill it, repairs change it, the writer turns it into a vehicle folder. Values are those of the files, also
impossible ones: readers correct nothing. Each part has its place in the source, and each change and omission is a
:class:`Change`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Changes
from mirdrake.importing.places import Places
from mirdrake.importing.shape import Shape, Vector


@dataclass
class Inertial:
    """Mass [kg], place of the centre of mass with the axes of the tensor, and inertia about it [kg m²] (3 x 3)."""

    mass: float
    X_LI: RigidTransform
    inertia: Vector
    where: str = ""


@dataclass
class Surface:
    """Contact data of a link in Gazebo's terms; None for values that are not given.

    Attributes:
        mu: first friction coefficient.
        mu2: second friction coefficient.
        stiffness: kp [N/m].
        damping: kd [N s/m].
        others: further numbers by name, for example ``min_depth`` or ``max_vel``.
    """

    mu: float | None = None
    mu2: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    others: dict[str, str] = field(default_factory=dict)
    where: str = ""


@dataclass
class Link:
    """A link with its shapes.

    Attributes:
        X_ML: pose in the model, if the source states it (SDF); in a URDF the root link is the model's frame.
    """

    name: str
    inertial: Inertial | None = None
    visuals: list[Shape] = field(default_factory=list)
    collisions: list[Shape] = field(default_factory=list)
    surface: Surface | None = None
    where: str = ""
    X_ML: RigidTransform | None = None


@dataclass
class Limits:
    """Limits of a joint exactly as written; None for values that are not given."""

    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None


@dataclass
class Joint:
    """A joint.

    Attributes:
        kind: revolute, continuous, prismatic, fixed, floating, planar, universal, revolute2, ball, screw, gearbox.
        X_PJ: pose of the joint frame in the parent link; the child link's frame is `X_JC` further.
        X_JC: pose of the child link in the joint frame: identity in URDF, any in SDF.
        axis: axis in the joint frame J, as written (not normalised).
        axis2: second axis of universal and revolute2 joints, in J.
        damping: [N m s/rad] or [N s/m].
        friction: [N m] or [N].
        stiffness: stiffness of a spring at the joint [N m/rad] or [N/m], from any element of the source.
        mimic: joint that it follows; "" for none.
        others: further attributes and elements by name, kept for the report.
    """

    name: str
    kind: str
    parent: str
    child: str
    X_PJ: RigidTransform = field(default_factory=RigidTransform)
    X_JC: RigidTransform = field(default_factory=RigidTransform)
    axis: Vector = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    axis2: Vector | None = None
    limits: Limits = field(default_factory=Limits)
    limits2: Limits = field(default_factory=Limits)
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float | None = None
    mimic: str = ""
    others: dict[str, str] = field(default_factory=dict)
    where: str = ""


@dataclass
class SensorTag:
    """A Gazebo sensor.

    Attributes:
        kind: Gazebo's type in lower case, for example camera, depth, ray, gpu_ray, imu, gps, sonar, contact.
        link: link that carries it.
        X_LS: pose in its link.
        rate: [Hz]; None if not given.
        values: every leaf below the tag by dotted path without the tag itself, for example
            ``camera.image.width: "800"``, ``ray.scan.horizontal.samples: "180"``.
        plugins: file names of the plugins inside.
    """

    name: str
    kind: str
    link: str
    X_LS: RigidTransform = field(default_factory=RigidTransform)
    rate: float | None = None
    values: dict[str, str] = field(default_factory=dict)
    plugins: tuple[str, ...] = ()
    where: str = ""


@dataclass
class Plugin:
    """A model plugin with its parameters by dotted path."""

    name: str
    filename: str
    values: dict[str, str] = field(default_factory=dict)
    where: str = ""


@dataclass
class Transmission:
    """A ros_control transmission, or a joint of a ros2_control system."""

    joint: str
    interfaces: tuple[str, ...] = ()
    """Command interfaces in lower case, without package and "JointInterface": effort, velocity, position."""
    reduction: float = 1.0
    where: str = ""
    ranges: Mapping[str, float] = field(default_factory=dict)
    """Largest command of an interface in both directions, where stated; SI."""


@dataclass
class Controller:
    """A controller of ros_control's YAML files.

    Attributes:
        name: dotted path in the file.
        kind: its type, for example ``effort_controllers/JointVelocityController``.
        joints: joints that it moves.
        gains: joint -> p, i, d, i_clamp ...; "" for gains without a joint.
        values: all other leaves by dotted path.
    """

    name: str
    kind: str
    joints: tuple[str, ...] = ()
    gains: dict[str, dict[str, float]] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)
    where: str = ""


class Hint(NamedTuple):
    """A mistake in the files that may explain a rejection.

    Attributes:
        tag: tag of the element.
        where: ``file:line``.
        text: what is wrong with it, a clause whose subject is the element.
    """

    tag: str
    where: str
    text: str

    def __str__(self) -> str:
        return f"<{self.tag}> ({self.where}) {self.text}"


@dataclass
class SourceModel:
    """A whole model as read.

    Attributes:
        name: name of the model.
        links: links by name, in the order of the source.
        joints: joints by name, in the order of the source.
        files: files that took part, main file first.
        changes: changes of the readers.
        texts: licence and author found in the package, by file name.
        hints: mistakes in the files that may explain a rejection.
    """

    name: str
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    sensors: list[SensorTag] = field(default_factory=list)
    plugins: list[Plugin] = field(default_factory=list)
    transmissions: list[Transmission] = field(default_factory=list)
    controllers: list[Controller] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    changes: Changes = field(default_factory=Changes)
    texts: dict[str, str] = field(default_factory=dict)
    hints: list[Hint] = field(default_factory=list)


def shorten_places(model: SourceModel) -> Places:
    """Replace every place in a model by its short form, and return what shortens places."""
    places = Places(model.files[0])
    parts: list[object] = [*model.sensors, *model.plugins, *model.transmissions, *model.controllers]
    for link in model.links.values():
        parts += [link, link.inertial, link.surface, *link.visuals, *link.collisions]
    parts += model.joints.values()
    for part in parts:
        if part is not None:
            part.where = places.short(part.where)  # type: ignore[attr-defined]
    model.changes = Changes(map(places.change, model.changes))
    return places

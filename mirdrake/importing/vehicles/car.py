"""The repaired car as it is written: seven links in the frames of mirdrake."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Changes
from mirdrake.importing.shape import Shape, Vector
from mirdrake.importing.vehicles.round_shapes import Bounds
from mirdrake.vehicles.estimates import Estimates
from mirdrake.vehicles.spec import Drive


@dataclass(frozen=True)
class Layout:
    """Dimensions [m] of a car, and its poses in the source.

    Attributes:
        wheelbase: distance between the axles.
        tracks: front and rear, between the wheels' middle planes.
        kingpin_track: distance of the steering axes.
        trail: steering axes ahead of the front wheels' centres.
        radii: radii of the front and the rear wheels.
        widths: widths of the front and the rear wheels.
        X_MB: base_link in the frame of the source's root.
        parts: pose in M of each part's frame as the source has it, by part: the wheels, left_knuckle, right_knuckle.
    """

    wheelbase: float
    tracks: tuple[float, float]
    kingpin_track: float
    trail: float
    radii: tuple[float, float]
    widths: tuple[float, float]
    X_MB: RigidTransform
    parts: dict[str, RigidTransform]

    def places(self) -> dict[str, Vector]:
        """Return origins of knuckles and wheels in base_link [m]."""
        places = {}
        for side, sign in (("left", 1.0), ("right", -1.0)):
            x, y = self.wheelbase, sign * self.tracks[0] / 2.0
            places[f"front_{side}"] = np.array([x, y, self.radii[0]])
            places[f"rear_{side}"] = np.array([0.0, sign * self.tracks[1] / 2.0, self.radii[1]])
            places[f"{side}_knuckle"] = np.array([x + self.trail, sign * self.kingpin_track / 2.0, self.radii[0]])
        return places


@dataclass
class Mass:
    """Mass [kg], centre of mass in a part's frame [m], and inertia about it along the part's axes [kg m²] (3 x 3)."""

    mass: float = 0.0
    com: Vector = field(default_factory=lambda: np.zeros(3))
    inertia: Vector = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass
class Part:
    """One of the seven links with mass; its frame has x ahead, y left, z up.

    Attributes:
        name: name of the link.
        links: links of the source that it is made of.
        X_MP: pose of the part's frame in the source.
        mass: its mass, centre and inertia.
        visuals: visuals in the part's frame.
        collisions: collisions in the part's frame; of the body only, wheels get their cylinder.
    """

    name: str
    links: list[str]
    X_MP: RigidTransform
    mass: Mass = field(default_factory=Mass)
    visuals: list[Shape] = field(default_factory=list)
    collisions: list[Shape] = field(default_factory=list)


@dataclass(kw_only=True)
class Parts:
    """Links with mass of a car.

    Attributes:
        body: base link.
        knuckles: left and right.
        wheels: wheels by name, in the order of :data:`mirdrake.vehicles.spec.WHEELS`.
        carriers: carriers by the wheel's name, what moves up and down with it besides wheel and knuckle, in the frame
            of the body; empty without springs.
    """

    body: Part
    knuckles: tuple[Part, Part]
    wheels: dict[str, Part]
    carriers: dict[str, Part] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Part]:
        yield from (self.body, *self.knuckles, *self.wheels.values(), *self.carriers.values())

    def total_mass(self) -> float:
        """Return the mass of the whole car [kg]."""
        return sum(part.mass.mass for part in self)

    def centre_of_mass(self, layout: Layout) -> Vector:
        """Return the centre of mass of the whole car in base_link [m]."""
        places = layout.places()
        items = [(part.mass, np.zeros(3)) for part in (self.body, *self.carriers.values())]
        items += [(self.knuckles[0].mass, places["left_knuckle"]), (self.knuckles[1].mass, places["right_knuckle"])]
        items += [(part.mass, places[name]) for name, part in self.wheels.items()]
        total = sum(mass.mass for mass, _ in items)
        com: Vector = sum((mass.mass * (position + mass.com) for mass, position in items), np.zeros(3)) / total
        return com


@dataclass(frozen=True)
class Frame:
    """A link without mass on a fixed joint: a frame of the source or of a sensor."""

    name: str
    joint: str
    parent: str
    X_PF: RigidTransform


@dataclass(frozen=True)
class Number:
    """A number of the car and its origin: ``imported: <file:line>`` or ``estimated: how``."""

    value: float
    source: str


@dataclass(frozen=True)
class SpringSet:
    """Springs, dampers and anti-roll bars, all at the wheel.

    Attributes:
        numbers: front_stiffness, front_damping, front_anti_roll and the same of the rear [N/m, N s/m, N/m].
        rebound: lowest travel [m], below 0.
        bump: highest travel [m].
    """

    numbers: dict[str, Number]
    rebound: float
    bump: float


@dataclass(kw_only=True)
class Car(Parts):
    """Content of the files of a vehicle folder.

    Attributes:
        name: name of folder, robot and package.
        title: title for people.
        base: name of the base link.
        layout: dimensions.
        wheel_joints: names, by the names of the wheels.
        steering_joints: names, left and right.
        spring_joints: names, by the wheel's name.
        springs: springs of the suspension; None: the wheels do not move up and down.
        drive: driven axle.
        drive_source: its origin.
        numbers: all other numbers by key.
        estimates: values estimated from mass and dimensions.
        bounds: corners of the body in base_link, without its wheels.
        frames: other links of the source.
        mount_frames: links that sensors sit in.
        mounts: sensors.yaml as data.
        variant: variants/imported.yaml as data; None if there is none.
        licence: licence in the source.
        changes: all of them.
        warnings: sentences for the user that come first.
    """

    name: str
    title: str
    base: str
    layout: Layout
    wheel_joints: dict[str, str]
    steering_joints: tuple[str, str]
    drive: Drive
    drive_source: str
    numbers: dict[str, Number]
    estimates: Estimates
    bounds: Bounds
    spring_joints: dict[str, str] = field(default_factory=dict)
    springs: SpringSet | None = None
    frames: list[Frame] = field(default_factory=list)
    mount_frames: list[Frame] = field(default_factory=list)
    mounts: dict[str, dict[str, object]] = field(default_factory=dict)
    variant: dict[str, object] | None = None
    licence: str = ""
    changes: Changes = field(default_factory=Changes)
    warnings: list[str] = field(default_factory=list)

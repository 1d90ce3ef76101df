"""A vehicle in Meshcat with sliders for its joints and buttons for layers: meshes, collision shapes, frames."""

from math import cos, pi, sin

import numpy as np
from pydrake.geometry import (
    Cylinder,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from mirdrake.plant.plant import VehicleInPlant, make_plant, set_start
from mirdrake.vehicles import Vehicle
from mirdrake.viewer.controls import LayerButtons, follow_controls
from mirdrake.viewer.meshcat import WORLD_PATH
from mirdrake.worlds import load_world

BUTTONS = {"Frames": "KeyF", "Collision shapes": "KeyC", "Meshes": "KeyM"}
"""Buttons in Meshcat's controls, and their keys."""


SHAPE_COLOUR = Rgba(1.0, 0.30, 0.05, 0.5)
_AXES = (Rgba(0.90, 0.10, 0.10, 1.0), Rgba(0.10, 0.65, 0.15, 1.0), Rgba(0.10, 0.30, 0.95, 1.0))


class VehicleView:
    """Sliders and buttons of a vehicle in Meshcat, and their effects.

    Args:
        meshcat: Meshcat that shows the vehicle.
        diagram: diagram with the plant.
        plant: plant with the vehicle.
        part: the vehicle in the plant.
        frames: whether frames and centre of mass are visible at first.
        collision: whether collision shapes are visible at first.
        meshes: whether meshes are visible at first.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        diagram: Diagram,
        plant: MultibodyPlant,
        part: VehicleInPlant,
        *,
        frames: bool = False,
        collision: bool = False,
        meshes: bool = True,
    ) -> None:
        self._meshcat, self._diagram, self._plant, self._part = meshcat, diagram, plant, part
        self._context = diagram.CreateDefaultContext()
        self._joints = _moving_joints(plant, part)
        self._labels = {name: slider_label(joint) for name, joint in self._joints.items()}
        self._values = dict.fromkeys(self._joints, 0.0)
        self._ranges: dict[str, tuple[float, float]] = {}
        set_start(plant, self._plant_context, part, x=0.0, y=0.0, yaw=0.0)
        self._draw_frames()
        for name, joint in self._joints.items():
            low, high = float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])
            self._values[name] = float(joint.default_positions()[0])
            # Wheels have no limits; a slider needs some.
            reach = max(low, -pi), min(high, pi)
            # Fine enough for a small range, such as the travel of a stiff spring.
            step = 0.01 if reach[1] - reach[0] > 0.2 else (reach[1] - reach[0]) / 100.0
            self._ranges[name] = reach
            meshcat.AddSlider(self._labels[name], *reach, step, self._values[name])
        shown = {"Frames": frames, "Collision shapes": collision, "Meshes": meshes}
        paths = ("frames",), ("collision",), ("visualizer", part.name)
        layers = dict(zip(shown, (self._path(*names) for names in paths), strict=True))
        self._layers = LayerButtons(meshcat, BUTTONS, shown, layers)
        self.publish()
        self._layers.apply()

    @property
    def shown(self) -> dict[str, bool]:
        """Whether each layer is visible."""
        return self._layers.shown

    @property
    def _plant_context(self) -> Context:
        return self._plant.GetMyMutableContextFromRoot(self._context)

    def Run(self, diagram: Diagram, timeout: float | None = None, stop_button_keycode: str = "Escape") -> None:  # noqa: N802
        """Follow sliders and buttons until the button "Stop" is pressed; the interface is that of Drake's JointSliders.

        Args:
            diagram: diagram of the view.
            timeout: time after which it ends [s]; None for no timeout.
            stop_button_keycode: key of the button.
        """
        assert diagram is self._diagram
        follow_controls(self._meshcat, self.follow, timeout=timeout, key=stop_button_keycode)

    def follow(self) -> bool:
        """Apply the present values of sliders and buttons; return whether anything has changed."""
        changed = self._layers.follow()
        values = {name: self._clipped(name, self._meshcat.GetSliderValue(self._labels[name])) for name in self._joints}
        if values != self._values:
            self._values, changed = values, True
            self.publish()
        return changed

    def _clipped(self, name: str, value: float) -> float:
        """Return a value limited to the range of its slider; browsers can send any value."""
        low, high = self._ranges[name]
        return min(max(value, low), high)

    def publish(self) -> None:
        """Set the joints to the values of the sliders."""
        context = self._plant_context
        positions = self._plant.GetPositions(context).copy()
        for name, joint in self._joints.items():
            positions[joint.position_start()] = self._values[name]
        self._plant.SetPositions(context, positions)
        self._diagram.ForcedPublish(self._context)
        for index in self._plant.GetBodyIndices(self._part.instance):
            body = self._plant.get_body(index)
            # Meshcat's objects for frames are not geometry of the plant, so they are moved here.
            self._meshcat.SetTransform(
                self._path("frames", body.name()), self._plant.EvalBodyPoseInWorld(context, body)
            )
        com = self._plant.CalcCenterOfMassPositionInWorld(context, [self._part.instance])
        self._meshcat.SetTransform(self._path("frames", "centre of mass"), RigidTransform(com))

    def _draw_frames(self) -> None:
        """Draw a triad for each link and a ball at the centre of mass."""
        length = 0.15 * self._part.vehicle.geometry.wheelbase
        for index in self._plant.GetBodyIndices(self._part.instance):
            draw_triad(self._meshcat, self._path("frames", self._plant.get_body(index).name()), length)
        draw_ball(self._meshcat, self._path("frames", "centre of mass"), 0.25 * length)

    def _path(self, *names: str) -> str:
        return "/".join((WORLD_PATH, *names))


def slider_label(joint: Joint) -> str:
    """Return the label of the slider of a joint, such as ``front left steering [rad]``."""
    unit = "m" if joint.type_name() == "prismatic" else "rad"
    return f"{joint.name().removesuffix('_joint').replace('_', ' ')} [{unit}]"


def show_vehicle(
    vehicle: Vehicle, meshcat: Meshcat, *, frames: bool = False, collision: bool = False, meshes: bool = True
) -> tuple[Diagram, VehicleView]:
    """Show a vehicle at rest on an empty plane, with a slider for each joint and buttons for layers.

    Args:
        vehicle: vehicle to look at.
        meshcat: where.
        frames: show the frame of every link (x red, y green, z blue) and the centre of mass from the start.
        collision: show the collision shapes, as they are simulated, from the start.
        meshes: show the meshes from the start.

    Returns:
        the diagram and its view: call ``view.Run(diagram)`` to follow the controls until its button is pressed.
    """
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {vehicle.name: vehicle})
    MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat)
    shapes = MeshcatVisualizerParams(role=Role.kProximity, prefix="collision", default_color=SHAPE_COLOUR)
    MeshcatVisualizer.AddToBuilder(builder, parts.scene_graph, meshcat, shapes).set_name("collision_visualizer")
    diagram = builder.Build()
    look_at(meshcat, vehicle)
    part = parts.vehicles[vehicle.name]
    view = VehicleView(meshcat, diagram, parts.plant, part, frames=frames, collision=collision, meshes=meshes)
    return diagram, view


def look_at(meshcat: Meshcat, vehicle: Vehicle) -> None:
    """Place the camera ahead of a vehicle, to its left, at a distance for its size."""
    geometry = vehicle.geometry
    size = geometry.wheelbase + geometry.front_wheel_radius + geometry.rear_wheel_radius
    target = np.array([0.5 * geometry.wheelbase, 0.0, 0.13 * size])
    angle = 0.65
    eye = target + 0.98 * size * np.array([cos(angle), sin(angle), 0.34])
    meshcat.SetProperty("/Cameras/default/rotated/<object>", "near", min(0.1, 0.05 * size))
    meshcat.SetCameraPose(eye, target)


def draw_triad(meshcat: Meshcat, path: str, length: float) -> None:
    """Draw the axes of a frame as three rods: x red, y green, z blue.

    Args:
        meshcat: where.
        path: path in the scene tree; its transform is that of the frame.
        length: length of an axis [m].
    """
    # Meshcat's cylinders are along z.
    turns = (RotationMatrix.MakeYRotation(0.5 * pi), RotationMatrix.MakeXRotation(-0.5 * pi), RotationMatrix())
    for axis, (turn, colour) in enumerate(zip(turns, _AXES, strict=True)):
        rod = f"{path}/{'xyz'[axis]}"
        meshcat.SetObject(rod, Cylinder(0.03 * length, length), colour)
        meshcat.SetTransform(rod, RigidTransform(turn, 0.5 * length * np.eye(3)[axis]))
        _draw_over(meshcat, rod, order=1.0)


def draw_ball(meshcat: Meshcat, path: str, radius: float) -> None:
    """Draw the symbol of a centre of mass: a ball with black and white octants.

    Args:
        meshcat: where.
        path: path in the scene tree; its transform is that of the centre.
        radius: [m].
    """
    steps = 8  # of a quarter of the circumference
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    colours: list[list[float]] = []
    for octant in range(8):
        # Bits of the number are the signs of the octant.
        signs = np.array([1 - 2 * (octant >> axis & 1) for axis in range(3)], dtype=float)
        grey = 0.05 if signs.prod() > 0.0 else 0.95
        first = len(vertices)
        angles = np.linspace(0.0, 0.5 * pi, steps + 1)
        for up in angles:
            for around in angles:
                point = signs * [cos(up) * cos(around), cos(up) * sin(around), sin(up)]
                vertices.append((radius * point).tolist())
                colours.append([grey] * 3)
        for i in range(steps):
            for j in range(steps):
                a = first + i * (steps + 1) + j
                b, c, d = a + 1, a + steps + 1, a + steps + 2
                # A mirrored octant has the opposite orientation, so its triangles are reversed to face outwards.
                outward = 1 if signs.prod() > 0.0 else -1
                faces += [[a, b, d][::outward], [a, d, c][::outward]]
    meshcat.SetTriangleColorMesh(
        path,
        # Drake's Eigen matrices are stored by columns.
        np.asfortranarray(np.array(vertices).T),
        np.asfortranarray(np.array(faces, dtype=np.int32).T),
        np.asfortranarray(np.array(colours).T),
        side=Meshcat.SideOfFaceToRender.kFrontSide,
    )
    _draw_over(meshcat, path, order=2.0)


def _draw_over(meshcat: Meshcat, path: str, *, order: float) -> None:
    """Show an object through others in front of it: frames are inside bodies.

    To see through the bodies would not do: Meshcat's opacity misses glTF meshes, which load after it is set.
    """
    meshcat.SetProperty(f"{path}/<object>", "material.depthTest", False)
    meshcat.SetProperty(f"{path}/<object>", "material.transparent", True)  # drawn after what is not
    meshcat.SetProperty(f"{path}/<object>", "renderOrder", order)


def _moving_joints(plant: MultibodyPlant, part: VehicleInPlant) -> dict[str, Joint]:
    """Return the joints of a vehicle with one coordinate, by name; its floating base has seven."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(part.instance)]
    return {joint.name(): joint for joint in joints if joint.num_positions() == 1}

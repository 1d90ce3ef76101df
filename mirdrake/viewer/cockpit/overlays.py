"""Overlays of the picture of a drive, which can be switched on and off.

========= =====================================================================================
driven    the path of the rear axle, a ribbon
planned   the centre line of the track of the vehicle, and ahead of it the arc of the present
          steering angle
lidar     points of lidars and laser scanners
contacts  forces of all contacts, arrows
tyres     tangential forces of the road on the tyres, arrows
friction  patches of friction, red for low, green for high friction
========= =====================================================================================

Each is one or a few objects in Meshcat, updated only while it is visible.
"""

from collections.abc import Callable
from math import cos, sin, tan
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import ContactResults
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import Assembly
from mirdrake.core.constants import GRAVITY
from mirdrake.sensors.perception import show_points
from mirdrake.viewer.cockpit.shapes import Triangles, arrows, ribbon
from mirdrake.worlds.meshes import fill

Array = NDArray[np.float64]

LAYERS = ("driven", "planned", "lidar", "contacts", "tyres", "friction")
"""Names of the overlays."""

MOST_CONTACTS = 24
"""Arrows of contact forces; of more contacts the strongest are shown."""

MOST_POINTS = 5000
"""Largest number of drawn points of all lidars together; more points are thinned out."""

_ROOT = "overlays"
_CHUNK = 120  # points of a piece of the driven ribbon; only the last piece is drawn anew
_PIECES = 200  # of the ribbon that are kept
_REFERENCE = 0.9  # [m] arrow of a force that is a quarter of the weight, on a car
_AHEAD = 2.2  # [s] that the arc ahead reaches
_BLUE, _GREEN, _AMBER, _RED, _VIOLET = (
    Rgba(0.10, 0.42, 0.95, 0.9),
    Rgba(0.05, 0.65, 0.30, 0.9),
    Rgba(0.98, 0.62, 0.05, 0.9),
    Rgba(0.90, 0.10, 0.15, 1.0),
    Rgba(0.55, 0.15, 0.85, 1.0),
)


class Overlays:
    """The overlays of a drive.

    Args:
        meshcat: Meshcat instance in which to draw.
        assembly: the simulated diagram.
        name: name of the vehicle.

    Attributes:
        there: available overlays.
        shown: visible overlays.
    """

    def __init__(self, meshcat: Meshcat, assembly: Assembly, name: str) -> None:
        self._meshcat, self._assembly, self._name = meshcat, assembly, name
        self._part = assembly.parts.vehicles[name]
        systems = {system.get_name(): system for system in assembly.diagram.GetSystems()}
        self._truth, self._control = systems[f"{name}.truth"], systems[f"{name}.control"]
        self._rangers = [system for system in systems.values() if hasattr(system, "points_seen")]
        self._tyres = systems.get(f"{name}.tyres")
        # Lengths of arrows and widths of lines scale with the car, so that a model car is not covered by them.
        self._size = self._part.vehicle.geometry.wheelbase / 2.6
        plant = assembly.parts.plant
        weight = GRAVITY * plant.CalcTotalMass(plant.CreateDefaultContext(), [self._part.instance])
        self._scale = 4.0 * _REFERENCE * self._size / weight
        self._wheels = {int(joint.child_body().index()) for joint in self._part.wheels}
        world = assembly.parts.world
        self._track = world.tracks.get(assembly.tracks[name] or "")
        # Layers without content would be switches without effect.
        absent = {
            "lidar": not self._rangers,
            "friction": not world.patches,
        }
        self.there = tuple(layer for layer in LAYERS if not absent.get(layer))
        self.shown: set[str] = set()
        self._path: list[tuple[float, float]] = []
        self._piece = 0
        self._seen: dict[str, float] = {}
        self._draw_planned()
        self._draw_friction()
        for layer in LAYERS:
            self._show(layer, False)
        for layer in ("driven", "planned"):
            self.switch(layer, True)

    def switch(self, layer: str, on: bool) -> None:
        """Show or hide an overlay; an unavailable one is ignored."""
        if layer not in self.there:
            return
        (self.shown.add if on else self.shown.discard)(layer)
        self._show(layer, on)

    def forget(self) -> None:
        """Remove the driven path, for a new drive."""
        self._meshcat.Delete(f"{_ROOT}/driven")
        self._path, self._piece, self._seen = [], 0, {}
        self._show("driven", "driven" in self.shown)

    def note(self, x: float, y: float) -> None:
        """Add a point of the rear axle [m] to the driven path."""
        if not self._path or (x - self._path[-1][0]) ** 2 + (y - self._path[-1][1]) ** 2 > (0.25 * self._size) ** 2:
            self._path.append((x, y))

    def draw(self, context: Context) -> None:
        """Update the visible overlays.

        Args:
            context: context of the whole diagram.
        """
        draw: dict[str, Callable[[Context], None]] = {
            "driven": self._draw_driven,
            "planned": self._draw_ahead,
            "lidar": self._draw_points,
            "contacts": self._draw_contacts,
            "tyres": self._draw_tyres,
        }
        for layer in self.shown & draw.keys():
            draw[layer](context)

    def _show(self, layer: str, on: bool) -> None:
        self._meshcat.SetProperty(f"{_ROOT}/{layer}", "visible", on)

    def _mesh(self, path: str, mesh: Triangles, colour: Rgba) -> None:
        side = Meshcat.SideOfFaceToRender.kDoubleSide
        self._meshcat.SetTriangleMesh(f"{_ROOT}/{path}", *mesh, colour, side=side)

    def _arrows(self, path: str, starts: Array, forces: Array, colour: Rgba) -> None:
        """Draw forces [N] as arrows, visible through the vehicle."""
        self._mesh(path, arrows(starts, self._scale * forces, radius=0.028 * self._size), colour)
        for key, value in (("material.depthTest", False), ("material.transparent", True), ("renderOrder", 3.0)):
            self._meshcat.SetProperty(f"{_ROOT}/{path}/<object>", key, value)

    def _draw_driven(self, _: Context) -> None:
        if len(self._path) < 2:
            return
        self._mesh(f"driven/{self._piece % _PIECES}", ribbon(self._path, width=0.16 * self._size, height=0.035), _BLUE)
        if len(self._path) >= _CHUNK:
            self._piece, self._path = self._piece + 1, self._path[-1:]

    def _draw_planned(self) -> None:
        if self._track is None:
            return
        s = np.arange(0.0, self._track.length, 0.7 * self._size)
        s = np.append(s, self._track.length * (1.0 if self._track.closed else 1.0 - 1e-9))
        x, y, _ = self._track.pose(s)
        self._mesh("planned/line", ribbon(np.column_stack((x, y)), width=0.12 * self._size, height=0.03), _GREEN)

    def _draw_ahead(self, context: Context) -> None:
        """Draw the arc of the present steering angle, of curvature tan(δ)/L."""
        state = self._truth.GetOutputPort("state").Eval(self._truth.GetMyContextFromRoot(context))
        x, y, yaw, vx = float(state[0]), float(state[1]), float(state[5]), float(state[6])
        steering = self._control.GetOutputPort("status").Eval(self._control.GetMyContextFromRoot(context))[1]
        curvature = tan(float(steering)) / self._part.vehicle.geometry.wheelbase
        reach = np.linspace(0.0, vx * _AHEAD if abs(vx) > 0.5 else np.copysign(3.0 * self._size, vx + 0.05), 32)
        turn = curvature * reach
        ahead = np.where(np.abs(turn) > 1e-6, np.sin(turn) / np.where(turn == 0.0, 1.0, turn), 1.0) * reach
        left = (
            np.where(np.abs(turn) > 1e-6, (1.0 - np.cos(turn)) / np.where(turn == 0.0, 1.0, turn), 0.5 * turn) * reach
        )
        line = np.column_stack((x + cos(yaw) * ahead - sin(yaw) * left, y + sin(yaw) * ahead + cos(yaw) * left))
        self._mesh("planned/ahead", ribbon(line, width=0.22 * self._size, height=0.045), _AMBER)

    def _draw_points(self, context: Context) -> None:
        share = max(MOST_POINTS // max(len(self._rangers), 1), 1)
        for ranger in self._rangers:
            name = ranger.get_name()
            time, points = ranger.points_seen(context, self._assembly.parts.plant)
            if time == self._seen.get(name):
                continue
            self._seen[name] = time
            points = points[:: max(-(-len(points) // share), 1)]
            path = f"{_ROOT}/lidar/{name.replace('.', '/')}"
            show_points(self._meshcat, path, points, point_size=0.09 * self._size, height=2.5 * self._size)

    def _contacts(self, context: Context) -> list[tuple[Array, Array, int]]:
        """Return position [m], force [N] and body index of each contact.

        The force acts on the body of the vehicle. The index is -1 for a contact between other bodies.
        """
        plant = self._assembly.parts.plant
        results: ContactResults = plant.get_contact_results_output_port().Eval(plant.GetMyContextFromRoot(context))
        contacts = []
        for i in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(i)
            first, second = int(pair.bodyA_index()), int(pair.bodyB_index())
            # The force acts on body B; on A it is the opposite one.
            body = second if self._ours(second) else first if self._ours(first) else -1
            sign = -1.0 if body == first and body != second else 1.0
            contacts.append((pair.contact_point(), sign * pair.contact_force(), body))
        for i in range(results.num_hydroelastic_contacts()):
            patch = results.hydroelastic_contact_info(i)
            surface = patch.contact_surface()
            bodies = [self._body(surface.id_M()), self._body(surface.id_N())]
            body = bodies[0] if self._ours(bodies[0]) else bodies[1] if self._ours(bodies[1]) else -1
            sign = 1.0 if body == bodies[0] else -1.0
            contacts.append((surface.centroid(), sign * patch.F_Ac_W().translational(), body))
        if self._assembly.parts.wheel_contact == "tyre":
            contacts += self._loads(context)
        return contacts

    def _loads(self, context: Context) -> list[tuple[Array, Array, int]]:
        """Return the contacts of :meth:`_contacts` of wheels with a vertical tyre, which are none of the plant."""
        assert self._tyres is not None
        own = self._assembly.parts.plant.GetMyContextFromRoot(context)
        loads = self._tyres.GetOutputPort("wheel_load").Eval(self._tyres.GetMyContextFromRoot(context))
        contacts = []
        for joint, load in zip(self._part.wheels, loads, strict=True):
            x, y, _ = joint.frame_on_parent().CalcPoseInWorld(own).translation().tolist()
            ground = self._assembly.parts.terrain.at(x, y)
            body = int(joint.child_body().index())
            contacts.append((np.array([x, y, ground.z]), load * np.array(ground.normal), body))
        return contacts

    def _ours(self, body: int) -> bool:
        plant = self._assembly.parts.plant
        return bool(plant.get_body(BodyIndex(body)).model_instance() == self._part.instance)

    def _body(self, geometry: Any) -> int:
        parts = self._assembly.parts
        frame = parts.scene_graph.model_inspector().GetFrameId(geometry)
        body = parts.plant.GetBodyFromFrameId(frame)
        return int(body.index()) if body is not None else 0

    def _draw_contacts(self, context: Context) -> None:
        contacts = sorted(self._contacts(context), key=lambda contact: -float(np.linalg.norm(contact[1])))
        contacts = contacts[:MOST_CONTACTS]
        starts = np.array([position for position, _, _ in contacts]).reshape(-1, 3)
        forces = np.array([force for _, force, _ in contacts]).reshape(-1, 3)
        self._arrows("contacts/all", starts, forces, _RED)

    def _draw_tyres(self, context: Context) -> None:
        starts, forces = self._law_forces(context) if self._tyres is not None else self._friction_forces(context)
        starts[:, 2] = np.maximum(starts[:, 2], 0.0) + 0.12 * self._size
        self._arrows("tyres/all", starts, forces, _VIOLET)

    def _friction_forces(self, context: Context) -> tuple[Array, Array]:
        """Return positions and horizontal forces (n, 3) of the contacts of the wheels."""
        contacts = [(position, force) for position, force, body in self._contacts(context) if body in self._wheels]
        starts = np.array([position for position, _ in contacts]).reshape(-1, 3)
        forces = np.array([force for _, force in contacts]).reshape(-1, 3)
        forces[:, 2] = 0.0
        return starts, forces

    def _law_forces(self, context: Context) -> tuple[Array, Array]:
        """Return positions and horizontal forces (n, 3) of the tyre law at each wheel."""
        assert self._tyres is not None
        # Forces of the tyre law are not contact forces of the plant, so they are drawn from their own port.
        plant = self._assembly.parts.plant
        own = plant.GetMyContextFromRoot(context)
        forces_of_wheels = (
            self._tyres.GetOutputPort("tyre_forces").Eval(self._tyres.GetMyContextFromRoot(context)).reshape(4, -1)
        )
        starts, forces = np.zeros((4, 3)), np.zeros((4, 3))
        for index, joint in enumerate(self._part.wheels):
            X_WP = joint.frame_on_parent().CalcPoseInWorld(own)
            ahead = RollPitchYaw(X_WP.rotation()).yaw_angle()
            fx, fy = float(forces_of_wheels[index][0]), float(forces_of_wheels[index][1])
            starts[index] = X_WP.translation() - [0.0, 0.0, self._part.vehicle.geometry.wheel_radii[index]]
            forces[index] = cos(ahead) * fx - sin(ahead) * fy, sin(ahead) * fx + cos(ahead) * fy, 0.0
        return starts, forces

    def _draw_friction(self) -> None:
        """Draw the visible parts of the patches, the last on top; red for low friction, green for high friction."""
        world = self._assembly.parts.world
        # From the top down: what is covered by a later patch is not drawn.
        above: shapely.Geometry = shapely.MultiPolygon()
        for patch in reversed(world.patches):
            visible = shapely.difference(patch.area, above)
            above = shapely.union(above, patch.area)
            if visible.area < 1e-6:
                continue
            surface = fill(visible, z=0.025, tile=1.0, color=(0.0, 0.0, 0.0), texture=None)
            mesh = Triangles(
                np.asfortranarray(surface.vertices.T), np.asfortranarray(surface.triangles.T.astype(np.int32))
            )
            grip = min(max(patch.mu, 0.0), 1.0)
            colour = Rgba(0.95 - 0.9 * grip, 0.1 + 0.6 * grip, 0.15, 0.45)
            self._mesh(f"friction/{patch.name} mu {patch.mu:g}", mesh, colour)

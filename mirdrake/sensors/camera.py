"""Colour camera: Drake's renderer without a screen, pictures at a rate, noise of the image sensor.

The renderer is made only when a camera is. On Linux it draws through EGL and needs no display.
"""

import ctypes
import json
import logging
import sys
from collections.abc import Iterable
from functools import cache
from math import tan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    InMemoryMesh,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem, State
from pydrake.systems.sensors import CameraInfo, ImageRgba8U, RgbdSensor
from scipy.special import ndtri

from mirdrake.errors import MissingDependencyError
from mirdrake.sensors.noise import sample_noise
from mirdrake.sensors.sampling import mount_pose
from mirdrake.vehicles.mounts import CameraMount
from mirdrake.worlds.scenery import render_params

if TYPE_CHECKING:
    from mirdrake.plant import PlantParts, VehicleInPlant

Pixels = NDArray[np.uint8]

X_SC = RigidTransform(RotationMatrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])))
"""Drake's camera frame C (z ahead, x to the right, y down) in the mounting frame S (x ahead, y left, z up)."""

_DEVICES = 0x313F  # EGL_PLATFORM_DEVICE_EXT, of the extension EGL_EXT_platform_device
_LINEAR = 9729  # glTF's number of a texture filter without mipmaps
_LEVELS = 2**16  # of the uniform random numbers that noise is made of

logging.getLogger("drake").addFilter(
    # The colour that goes with a glTF mesh is not used; the renderer says so for each mesh.
    lambda record: "materials have been assigned to a glTF file" not in record.getMessage()
)


class Camera(Diagram):  # type: ignore[misc, unused-ignore]
    """Takes a colour picture at a rate, and holds it until the next.

    As with all held samples, a picture taken at time t is at the output right after t. Pixel (u, v) is column u from
    the left and row v from above; the middle of the first one is at (0, 0). A point (x, y, z) of the mounting frame is
    seen at u = (width - 1)/2 - f y/x, v = (height - 1)/2 - f z/x, with f = width / (2 tan(horizontal_fov / 2)).

    Input ports:
        query_object: the scene graph's.
    Output ports:
        color_image: the last picture, a Drake ImageRgba8U; its ``data`` is (height, width, 4).

    Args:
        plant: the finalised plant.
        frame: mounting frame, x ahead and z up; fixed to a body.
        mount: resolution, field of view, clipping, rate and noise.
        renderer: name of a renderer of the scene graph.
        stream: from :func:`mirdrake.sensors.noise.noise_stream`.
    """

    def __init__(
        self, plant: MultibodyPlant, frame: Frame, mount: CameraMount, *, renderer: str, stream: int = 0
    ) -> None:
        super().__init__()
        self.rate = mount.rate
        builder = DiagramBuilder()
        body, X_BS = mount_pose(frame)
        focal = 0.5 * mount.width / tan(0.5 * mount.horizontal_fov)
        middle = (0.5 * mount.width, 0.5 * mount.height)  # the renderer counts from the outer corner of the first pixel
        info = CameraInfo(mount.width, mount.height, focal, focal, *middle)
        core = RenderCameraCore(renderer, info, ClippingRange(mount.near, mount.far), RigidTransform())
        eye = builder.AddNamedSystem(
            "eye",
            RgbdSensor(
                plant.GetBodyFrameIdOrThrow(body.index()),
                X_BS.multiply(X_SC),
                ColorRenderCamera(core, False),
                DepthRenderCamera(core, DepthRange(mount.near, min(mount.near + 1.0, mount.far))),  # never drawn
            ),
        )
        self._shutter = builder.AddNamedSystem("shutter", _Shutter(mount, stream=stream))
        builder.Connect(eye.color_image_output_port(), self._shutter.light)
        builder.ExportInput(eye.query_object_input_port(), "query_object")
        builder.ExportOutput(self._shutter.color_image, "color_image")
        builder.BuildInto(self)

    def look(self, context: Context) -> Pixels:
        """The picture that it would take now, noise included: red, green, blue (height, width, 3).

        Args:
            context: Context of the whole diagram.
        """
        image = self._shutter.picture.Eval(self._shutter.GetMyContextFromRoot(context))
        pixels: Pixels = image.data[:, :, :3]
        return pixels


class _Shutter(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Adds noise to what the eye sees, and holds it."""

    def __init__(self, mount: CameraMount, *, stream: int) -> None:
        super().__init__()
        self._rate, self._stream, self._table = mount.rate, stream, _noise_table(mount.noise)
        empty = AbstractValue.Make(ImageRgba8U(mount.width, mount.height))
        self.light = self.DeclareAbstractInputPort("light", empty)
        self._held = self.DeclareAbstractState(empty)
        self.color_image = self.DeclareStateOutputPort("color_image", self._held)
        needs = {self.light.ticket(), self.time_ticket()}
        self.picture = self.DeclareAbstractOutputPort("picture", empty.Clone, self._develop, needs)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / mount.rate, 0.0, self._expose)

    def _develop(self, context: Context, value: AbstractValue) -> None:
        seen, out = self.light.Eval(context).data, value.get_mutable_value().mutable_data
        if self._table is None:
            out[:] = seen
            return
        bits = sample_noise(self._stream, round(context.get_time() * self._rate)).bit_generator
        levels = self._table[bits.random_raw(-(-seen.size // 4)).view(np.uint16)[: seen.size]].reshape(seen.shape)
        levels += seen
        np.clip(levels, 0, 255, out=out, casting="unsafe")
        out[:, :, 3] = 255

    def _expose(self, context: Context, state: State) -> None:
        held = state.get_mutable_abstract_state(int(self._held)).get_mutable_value()
        held.mutable_data[:] = self.picture.Eval(context).data


def _noise_table(noise: float) -> NDArray[np.int16] | None:
    """White noise of a standard deviation [of full scale] in grey levels, at equally likely quantiles."""
    if not noise:
        return None
    table: NDArray[np.int16] = np.rint(255.0 * noise * ndtri((np.arange(_LEVELS) + 0.5) / _LEVELS)).astype(np.int16)
    return table


def make_camera(mount: CameraMount, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> Camera:
    """A camera of a vehicle as its sensors.yaml describes it; adds the vehicle's renderer if there is none yet.

    Raises:
        MissingDependencyError: there is nothing to render with.
    """
    renderer = f"cameras/{part.name}"
    if not parts.scene_graph.HasRenderer(renderer):
        others = [f"cameras/{name}" for name in parts.vehicles if name != part.name]
        hide_model(parts.plant, parts.scene_graph, part.instance, accepting=others)
        use_plain_textures(parts.plant, parts.scene_graph)
        add_renderer(parts.scene_graph, renderer, render_params(parts.world))
    frame = parts.plant.GetFrameByName(mount.frame, part.instance)
    return Camera(parts.plant, frame, mount, renderer=renderer, stream=stream)


def add_renderer(scene_graph: SceneGraph, name: str, params: RenderEngineVtkParams) -> None:
    """Add Drake's VTK renderer to a scene graph, if this machine can run it.

    Raises:
        MissingDependencyError: EGL is not there.
    """
    reason = _egl_fault() if sys.platform == "linux" else None
    if reason is not None:
        raise MissingDependencyError(
            f"cameras need EGL to render ({reason}): install your system's EGL and Mesa drivers "
            "(Debian: apt install libegl1 libgl1-mesa-dri), or leave the cameras out"
        )
    scene_graph.AddRenderer(name, MakeRenderEngineVtk(params))


def use_plain_textures(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Take mipmaps from what is fixed in the world and in memory, before a renderer is added.

    With them VTK filters anisotropically, which costs half a second for a picture of grass without a graphics card,
    ten times the rest. Far ground gets a little rougher.
    """
    inspector = scene_graph.model_inspector()
    for geometry in plant.GetVisualGeometriesForBody(plant.world_body()):
        shape = inspector.GetShape(geometry)
        memory = shape.source().in_memory() if isinstance(shape, Mesh) and shape.source().is_in_memory() else None
        if memory is None or memory.mesh_file.extension() != ".gltf":
            continue
        document = json.loads(memory.mesh_file.contents())
        if "samplers" not in document:
            continue
        for sampler in document["samplers"]:
            sampler["minFilter"] = _LINEAR
        file = MemoryFile(json.dumps(document), ".gltf", memory.mesh_file.filename_hint())
        mesh = Mesh(InMemoryMesh(mesh_file=file, supporting_files=memory.supporting_files), shape.scale3())
        scene_graph.ChangeShape(source_id=plant.get_source_id(), geometry_id=geometry, shape=mesh)


@cache
def _egl_fault() -> str | None:
    """Why EGL cannot be used, or None if it can: its library must be there, and a driver that starts, if in software.

    VTK would end the process instead of raising.
    """
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return "libEGL.so.1 is not installed"
    pointer, count = ctypes.c_void_p, ctypes.c_int()
    egl.eglGetProcAddress.restype, egl.eglGetProcAddress.argtypes = pointer, [ctypes.c_char_p]
    query, get_display = (egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT"))
    if not query or not get_display:
        return "it has no driver"
    devices = (pointer * 16)()
    ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, pointer, pointer)(query)(16, devices, ctypes.byref(count))
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    for device in devices[: count.value]:
        display = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(get_display)(_DEVICES, device, None)
        if display and egl.eglInitialize(display, None, None):
            return None
    return "none of its drivers starts"


def hide_model(
    plant: MultibodyPlant, scene_graph: SceneGraph, instance: ModelInstanceIndex, *, accepting: Iterable[str]
) -> None:
    """Show a model to some renderers only: a camera behind a windscreen shall not see its own vehicle from within.

    Args:
        plant: the finalised plant.
        scene_graph: its scene graph, before the renderers are added.
        instance: the model.
        accepting: names of the renderers that shall show it; none at all hides it from every one.
    """
    base = _accepting(accepting)
    inspector = scene_graph.model_inspector()
    for index in plant.GetBodyIndices(instance):
        for geometry in plant.GetVisualGeometriesForBody(plant.get_body(index)):
            old, new = inspector.GetPerceptionProperties(geometry), PerceptionProperties(base)
            if old is None:
                continue
            for group in old.GetGroupNames() - {"renderer"}:
                for name in old.GetPropertiesInGroup(group):
                    new.UpdateProperty(group, name, old.GetProperty(group, name))
            scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kPerception)  # Drake replaces no such role
            scene_graph.AssignRole(plant.get_source_id(), geometry, new)


def _accepting(renderers: Iterable[str]) -> PerceptionProperties:
    """Properties with the names of the renderers that show a geometry.

    Drake wants a C++ set, for which Python has no word; but a parsed file has one.
    """
    tags = "".join(f'<drake:accepting_renderer name="{name}"/>' for name in (*renderers, "none"))
    visual = f'<visual><geometry><box size="1 1 1"/></geometry>{tags}</visual>'
    urdf = f'<robot name="m" xmlns:drake="http://drake.mit.edu"><link name="l">{visual}</link></robot>'
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.01)
    Parser(plant).AddModelsFromString(urdf, "urdf")
    (geometry,) = plant.GetVisualGeometriesForBody(plant.GetBodyByName("l"))
    return PerceptionProperties(scene_graph.model_inspector().GetPerceptionProperties(geometry))

"""Drake's VTK renderer for cameras: whether it runs here, what it draws, and how to have it draw quickly.

On Linux it draws through EGL and needs no display. Without a graphics card Mesa draws in software, and there three
things took most of the time of a picture, measured: anisotropic filtering of textures (:func:`use_plain_textures`), the
filter that smooths edges (:func:`smooth_edges_quickly`), and many small things
(:mod:`mirdrake.sensors.cameras.merging`).
"""

import ctypes
import json
import os
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    InMemoryMesh,
    MakeRenderEngineVtk,
    Mesh,
    RenderEngineVtkParams,
    SceneGraph,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from mirdrake.core.errors import MissingDependencyError
from mirdrake.sensors.cameras.labels import assign_labels
from mirdrake.sensors.cameras.looks import add_to_look, seen_by
from mirdrake.sensors.cameras.merging import merge_still_things
from mirdrake.worlds import World
from mirdrake.worlds.scenery import render_params

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

_DEVICES = 0x313F  # EGL_PLATFORM_DEVICE_EXT, of the extension EGL_EXT_platform_device
_LINEAR = 9729  # glTF's number of a texture filter without mipmaps

SHADERS = Path(__file__).resolve().parent / "shaders"
"""Shaders that Mesa takes in place of others."""


def vehicle_renderer(parts: "PlantParts", part: "VehicleInPlant") -> str:
    """Name of the renderer that all cameras of a vehicle share; added if it is not there yet.

    Raises:
        MissingDependencyError: there is nothing to render with.
    """
    renderer = f"cameras/{part.name}"
    if not parts.scene_graph.HasRenderer(renderer):
        if parts.scene_graph.RendererCount() == 0:
            assign_labels(parts)
            _merge(parts)
        others = [f"cameras/{name}" for name in parts.vehicles if name != part.name]
        hide_model(parts.plant, parts.scene_graph, part.instance, accepting=others)
        use_plain_textures(parts.plant, parts.scene_graph)
        add_renderer(parts.scene_graph, renderer, camera_params(parts.world))
    return renderer


def _merge(parts: "PlantParts") -> None:
    """Draw what stands still at one go, but for the vehicles whose cameras label it."""
    apart = {
        name
        for name, part in parts.vehicles.items()
        if any(getattr(mount, "label", False) for mount in part.vehicle.sensors.mounts.values())
    }
    merged = [f"cameras/{name}" for name in parts.vehicles if name not in apart]
    if merged:
        apart_in = [f"cameras/{name}" for name in sorted(apart)]
        merge_still_things(parts.plant, parts.scene_graph, merged_in=merged, apart_in=apart_in)


def camera_params(world: World) -> RenderEngineVtkParams:
    """Settings of the renderer for a world, with its weak lights from the sky made one.

    Each light costs a tenth of a picture without a graphics card. The irradiance of a matt surface is linear in the
    light's direction, so that the sum of two lights shines on what faces both as they do. The third weak one, from the
    ground, is left out: what faces downwards is black.
    """
    params = render_params(world)
    sun, above, aside, *_ = params.lights
    total = above.intensity * np.array(above.direction) + aside.intensity * np.array(aside.direction)
    strength = float(np.linalg.norm(total))
    above.direction, above.intensity = total / max(strength, 1e-9), strength
    params.lights = [sun, above]
    return params


def add_renderer(scene_graph: SceneGraph, name: str, params: RenderEngineVtkParams) -> None:
    """Add Drake's VTK renderer to a scene graph, if this machine can run it.

    Raises:
        MissingDependencyError: EGL is not there.
    """
    smooth_edges_quickly()
    reason = _egl_fault() if sys.platform == "linux" else None
    if reason is not None:
        raise MissingDependencyError(
            f"cameras need EGL to render ({reason}): install your system's EGL and Mesa drivers "
            "(Debian: apt install libegl1 libgl1-mesa-dri), or leave the cameras out"
        )
    scene_graph.AddRenderer(name, MakeRenderEngineVtk(params))


def smooth_edges_quickly() -> None:
    """Have Mesa take our filter for smooth edges instead of VTK's, before it reads the first shader.

    VTK's walks along every edge, and took two thirds of the time of a picture without a graphics card; ours looks at
    four neighbours. Mesa finds it by the SHA-1 of the shader that it replaces (its environment variable
    MESA_SHADER_READ_PATH, of which one that is set already is kept). Where no name fits, as with another version of
    VTK or a driver that is not Mesa's, VTK's own filter is taken, and all that changes is the time. The variable is for
    the C library alone; ``os.environ`` is left as it was.
    """
    setenv = getattr(ctypes.CDLL(None), "setenv", None) if sys.platform == "linux" else None
    if setenv is not None:
        setenv(b"MESA_SHADER_READ_PATH", os.fsencode(SHADERS), 0)


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
    base = seen_by(accepting)
    for index in plant.GetBodyIndices(instance):
        for geometry in plant.GetVisualGeometriesForBody(plant.get_body(index)):
            add_to_look(plant, scene_graph, geometry, base)

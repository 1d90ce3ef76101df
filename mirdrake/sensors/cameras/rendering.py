"""Drake's VTK renderer for cameras: availability, scene and speed.

On Linux it renders through EGL and needs no display. Without a graphics card Mesa renders in software. There, three
things took most of the measured time of a picture: anisotropic filtering of textures (:func:`use_plain_textures`),
anti-aliasing (:func:`smooth_edges_quickly`), and many small objects (:mod:`mirdrake.sensors.cameras.merging`).
"""

import ctypes
import json
import logging
import os
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, MakeRenderEngineVtk, Mesh, RenderEngineVtkParams, SceneGraph
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

SHADERS_OF = "1.51."
"""Beginning of the versions of Drake whose VTK has the shaders that are replaced."""

SHADERS = Path(__file__).resolve().parent / "shaders"
"""Folder of shaders that Mesa uses in place of others."""


def vehicle_renderer(parts: "PlantParts", part: "VehicleInPlant") -> str:
    """Return the name of the renderer that all cameras of a vehicle share; it is added if it does not exist yet.

    Raises:
        MissingDependencyError: EGL is not available.
    """
    renderer = f"cameras/{part.name}"
    if not parts.scene_graph.HasRenderer(renderer):
        # Labels and merging change geometry for all renderers, so they come before the first one.
        if parts.scene_graph.RendererCount() == 0:
            assign_labels(parts)
            _merge(parts)
        # The cameras of other vehicles still see this one.
        others = [f"cameras/{name}" for name in parts.vehicles if name != part.name]
        hide_model(parts.plant, parts.scene_graph, part.instance, accepting=others)
        use_plain_textures(parts.plant, parts.scene_graph)
        add_renderer(parts.scene_graph, renderer, camera_params(parts.world))
    return renderer


def _merge(parts: "PlantParts") -> None:
    """Merge the fixed objects into one mesh, except for renderers whose cameras output labels."""
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
    """Return the settings of the renderer for a world, with its two weak sky lights combined into one.

    Each light takes a tenth of the time of a picture without a graphics card. The irradiance of a matt surface is
    linear in the direction of the light, so that one light of the summed direction illuminates a surface that faces
    both lights as they do. The third weak light, from below, is omitted: surfaces that face downwards are black.
    """
    params = render_params(world)
    # The order of lights is that of render_params: sun, two sky lights, one from below.
    sun, above, aside, *_ = params.lights
    total = above.intensity * np.array(above.direction) + aside.intensity * np.array(aside.direction)
    strength = float(np.linalg.norm(total))
    above.direction, above.intensity = total / max(strength, 1e-9), strength
    params.lights = [sun, above]
    return params


def add_renderer(
    scene_graph: SceneGraph,
    name: str,
    params: RenderEngineVtkParams,
    *,
    needs: str = "cameras need",
    instead: str = ", or leave the cameras out",
) -> None:
    """Add Drake's VTK renderer to a scene graph.

    Args:
        scene_graph: the scene graph.
        name: name of the renderer.
        params: lights, background and shading.
        needs: beginning of the message of the error.
        instead: end of the message of the error.

    Raises:
        MissingDependencyError: EGL is not available.
    """
    smooth_edges_quickly()
    reason = _egl_fault() if sys.platform == "linux" else None
    if reason is not None:
        raise MissingDependencyError(
            f"{needs} EGL to render ({reason}): install your system's EGL and Mesa drivers "
            f"(Debian: apt install libegl1 libgl1-mesa-dri){instead}"
        )
    scene_graph.AddRenderer(name, MakeRenderEngineVtk(params))


def smooth_edges_quickly() -> None:
    """Replace VTK's anti-aliasing filter by a faster one in Mesa, before it compiles the first shader.

    VTK's filter follows every edge, and took two thirds of the time of a picture without a graphics card; the filter in
    :data:`SHADERS` compares four neighbours. Mesa finds it by the SHA-1 of the shader that it replaces (environment
    variable MESA_SHADER_READ_PATH; a value that is already set is kept). With another version of VTK, or with a driver
    that is not Mesa's, VTK's own filter is used: pictures take longer. The variable is set in the C library only;
    ``os.environ`` is not changed.
    """
    _report_other_vtk(version("drake"))
    setenv = getattr(ctypes.CDLL(None), "setenv", None) if sys.platform == "linux" else None
    if setenv is not None:
        # 0: a value that the user has set is kept.
        setenv(b"MESA_SHADER_READ_PATH", os.fsencode(SHADERS), 0)


@cache  # once for each version
def _report_other_vtk(drake: str) -> None:
    """Log that the shaders of another version of VTK are not replaced."""
    if not drake.startswith(SHADERS_OF):
        logging.getLogger("mirdrake").info(
            "Drake %s may have another version of VTK, whose anti-aliasing shader is not replaced by a faster one; "
            "without a graphics card, cameras may take up to three times as long",
            drake,
        )


def use_plain_textures(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Remove the mipmaps of the fixed meshes that are in memory, before a renderer is added.

    With mipmaps VTK filters anisotropically, which takes half a second for a picture of grass without a graphics card,
    ten times the rest. Without them the far ground looks slightly rougher.
    """
    inspector = scene_graph.model_inspector()
    # Only meshes in memory: files on disk belong to the user.
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
    """Return why EGL cannot be used, or None: its library and a driver that starts, possibly in software, are needed.

    Without this check VTK would end the process instead of raising.
    """
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return "libEGL.so.1 is not installed"
    pointer, count = ctypes.c_void_p, ctypes.c_int()
    # Extensions are not exported by the library; their addresses must be asked for.
    egl.eglGetProcAddress.restype, egl.eglGetProcAddress.argtypes = pointer, [ctypes.c_char_p]
    query, get_display = (egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT"))
    if not query or not get_display:
        return "it has no driver"
    devices = (pointer * 16)()
    ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, pointer, pointer)(query)(16, devices, ctypes.byref(count))
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    # One device that starts is enough; software rendering counts.
    for device in devices[: count.value]:
        display = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(get_display)(_DEVICES, device, None)
        if display and egl.eglInitialize(display, None, None):
            return None
    return "none of its drivers starts"


def hide_model(
    plant: MultibodyPlant, scene_graph: SceneGraph, instance: ModelInstanceIndex, *, accepting: Iterable[str]
) -> None:
    """Show a model in some renderers only, so that a camera behind the windscreen does not see its vehicle.

    Args:
        plant: the finalised plant.
        scene_graph: its scene graph, before the renderers are added.
        instance: the model.
        accepting: names of the renderers that show it; if empty, none does.
    """
    base = seen_by(accepting)
    for index in plant.GetBodyIndices(instance):
        for geometry in plant.GetVisualGeometriesForBody(plant.get_body(index)):
            add_to_look(plant, scene_graph, geometry, base)

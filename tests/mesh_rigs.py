"""Small mesh files in the formats of ROS and Gazebo, and a camera for the results."""

import struct

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    LightParameter,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from mirdrake.sensors.cameras.rendering import add_renderer

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # -x +x -y +y -z +z


def box(low, high):
    """Return triangles (12, 3, 3) of a box between two corners."""
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    corners = low + CORNERS * (high - low)
    return np.array([corners[list(t)] for q in QUADS for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])


def write_stl(path, triangles):
    """Return a binary STL."""
    record = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    record["v"] = triangles
    path.write_bytes(b"made by a test".ljust(80) + struct.pack("<I", len(triangles)) + record.tobytes())
    return path


def effect(name, look, transparent=""):
    return (
        f'<effect id="{name}-fx"><profile_COMMON>{look[0]}<technique sid="common"><lambert><diffuse>{look[1]}</diffuse>'
        f"{transparent}</lambert></technique></profile_COMMON></effect>"
    )


def material(name):
    return f'<material id="{name}" name="{name}"><instance_effect url="#{name}-fx"/></material>'


def flat(r, g, b):
    return "", f"<color>{r} {g} {b} 1</color>"


TEXTURED = (
    '<newparam sid="surf"><surface type="2D"><init_from>pic</init_from></surface></newparam>'
    '<newparam sid="samp"><sampler2D><source>surf</source></sampler2D></newparam>',
    '<texture texture="samp" texcoord="UV"/>',
)


def write_dae(
    path,
    *,
    size=(1, 1, 1),
    at=(0, 0, 0),
    unit="1",
    up="Z_UP",
    matrix="",
    looks=None,
    picture="pic.png",
    extra="",
    name="body",
    transparent="",
):
    """Return a box from `at` on; the second of two materials is on its upper face."""
    looks = looks or [("paint", flat(1, 0, 0))]
    points = " ".join(f"{value:g}" for value in (at + CORNERS * size).ravel())
    groups = {looks[0][0]: QUADS[: 6 if len(looks) == 1 else 5]}
    if len(looks) > 1:
        groups[looks[1][0]] = QUADS[5:]
    lists = ""
    for symbol, quads in groups.items():
        index = " ".join(f"{v} {k}" for quad in quads for k, v in enumerate(quad))
        lists += (
            f'<polylist material="{symbol}" count="{len(quads)}"><input semantic="VERTEX" source="#v" offset="0"/>'
            f'<input semantic="TEXCOORD" source="#uv" offset="1" set="0"/>'
            f"<vcount>{'4 ' * len(quads)}</vcount><p>{index}</p></polylist>"
        )
    bound = "".join(f'<instance_material symbol="{n}" target="#{n}"/>' for n, _ in looks)
    path.write_text(
        f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="u" meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_images><image id="pic"><init_from>{picture}</init_from></image></library_images>
<library_effects>{"".join(effect(n, look, transparent) for n, look in looks)}</library_effects>
<library_materials>{"".join(material(n) for n, _ in looks)}</library_materials>
<library_geometries><geometry id="cube" name="cube"><mesh>
<source id="p"><float_array id="pa" count="24">{points}</float_array><technique_common>
<accessor source="#pa" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<source id="uv"><float_array id="ua" count="8">0 0 1 0 1 1 0 1</float_array><technique_common>
<accessor source="#ua" count="4" stride="2"><param name="S" type="float"/><param name="T" type="float"/></accessor>
</technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{lists}{extra}</mesh></geometry>
</library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n" name="{name}">{matrix}
<instance_geometry url="#cube"><bind_material><technique_common>{bound}</technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
    )
    return path


def add_eye(builder, plant, scene, eye, target):
    """A camera of 160 x 120 pixels with a sun and black sky; returns the function diagram, context -> picture."""
    lights = [LightParameter(type="directional", direction=[-1, 0.7, -1.4], frame="world", intensity=3.0)]
    add_renderer(scene, "eye", RenderEngineVtkParams(lights=lights, default_clear_color=[0, 0, 0]))
    ahead = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    X_WC = RigidTransform(RotationMatrix(np.column_stack((right, np.cross(ahead, right), ahead))), eye)
    core = RenderCameraCore("eye", CameraInfo(160, 120, 0.8), ClippingRange(0.01, 50.0), RigidTransform())
    depth = DepthRenderCamera(core, DepthRange(0.1, 40.0))
    sensor = builder.AddSystem(RgbdSensor(scene.world_frame_id(), X_WC, ColorRenderCamera(core, False), depth))
    builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())

    def take(context):
        image = sensor.color_image_output_port().Eval(sensor.GetMyContextFromRoot(context)).data
        return image[:, :, :3].astype(int)

    return take

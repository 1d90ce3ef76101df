"""Small Gazebo worlds with the faults of real ones, written by the tests.

Each function writes one world below a folder and returns its file. Lengths are metres, angles radians.
"""

import itertools
import re

import numpy as np

from tests.mesh_rigs import box, write_dae, write_stl

SUN = '<light name="sun" type="directional"><direction>-0.5 0.1 -0.9</direction></light>'
PLANE = (
    '<model name="ground_plane"><static>1</static><link name="link"><collision name="c"><geometry><plane>'
    "<normal>0 0 1</normal><size>100 80</size></plane></geometry></collision></link></model>"
)


def world(folder, inside, *, version="1.6", name="default", file="trap.world", plane=PLANE):
    path = folder / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f'<?xml version="1.0"?>\n<sdf version="{version}">\n<world name="{name}">\n{plane}\n{inside}\n</world>\n'
        "</sdf>\n",
        encoding="utf-8",
    )
    return path


def shape(kind, size):
    if kind == "box":
        return f"<geometry><box><size>{size}</size></box></geometry>"
    if kind == "sphere":
        return f"<geometry><sphere><radius>{size}</radius></sphere></geometry>"
    if kind == "mesh":
        return f"<geometry><mesh><uri>{size}</uri></mesh></geometry>"
    radius, length = size.split()
    return f"<geometry><{kind}><radius>{radius}</radius><length>{length}</length></{kind}></geometry>"


def model(name, kind="box", size="1 1 1", *, pose="", link="", static=True, mass="", more="", visual=True, extra=""):
    pose = f"<pose>{pose}</pose>" if pose else ""
    link = f"<pose>{link}</pose>" if link else ""
    mass = f"<inertial><mass>{mass}</mass></inertial>" if mass else ""
    visual_element = f'<visual name="v">{shape(kind, size)}</visual>' if visual else ""
    return (
        f'<model name="{name}"><static>{int(static)}</static>{pose}<link name="link">{link}{mass}'
        f'<collision name="c">{shape(kind, size)}{more}</collision>{visual_element}</link>{extra}</model>'
    )


def include(uri, *, pose="", name="", more=""):
    pose = f"<pose>{pose}</pose>" if pose else ""
    name = f"<name>{name}</name>" if name else ""
    return f"<include><uri>{uri}</uri>{name}{pose}{more}</include>"


def model_folder(folder, name, sdf, *, config=True, version="1.6"):
    """Return a model of a model database."""
    (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / name / "model.sdf").write_text(f'<sdf version="{version}">{sdf}</sdf>', encoding="utf-8")
    if config:
        text = f'<model><name>{name}</name><sdf version="{version}">model.sdf</sdf></model>'
        (folder / name / "model.config").write_text(text, encoding="utf-8")
    return folder / name


def saved(folder):
    """A world that was saved while it ran: poses in <state> win, one model was deleted, one inserted, one is scaled."""
    state = """
<state world_name="default"><sim_time>9 0</sim_time>
<model name="crate"><pose>4 -2 0.499 1e-6 0 0.5</pose><scale>1 1 1</scale>
  <link name="link"><pose>4 -2 0.499 1e-6 0 0.5</pose><velocity>0 0 0 0 0 0</velocity></link></model>
<model name="slab"><pose>10 0 0.5 0 0 0</pose><scale>2 3 1</scale></model>
<model name="nobody"><pose>1 1 1 0 0 0</pose></model>
<insertions><model name="late"><static>1</static><pose>-9 0 0.5 0 0 0</pose><link name="link"><collision name="c">
<geometry><sphere><radius>0.5</radius></sphere></geometry></collision></link></model></insertions>
<deletions><name>gone</name></deletions></state>"""
    inside = (
        state
        + model("crate", pose="0 0 9 0 0 0", static=False, mass="7")
        + model("slab", size="1 1 1", pose="0 0 0.5 0 0 0")
        + model("gone", pose="0 30 0.5 0 0 0")
    )
    return world(folder, inside, version="1.4")


def nested(folder):
    """Static models nested in a static one, with frames, relative poses in degrees, and a placement frame."""
    inside = f"""
<frame name="corner"><pose degrees="true">10 0 0 0 0 90</pose></frame>
<model name="block"><static>true</static><pose relative_to="corner">1 2 0 0 0 0</pose>
  <frame name="door"><pose>3 0 0 0 0 0</pose></frame>
  <link name="wall"><pose relative_to="door">0 0 1 0 0 0</pose><collision name="c">{shape("box", "2 0.2 2")}</collision>
  </link>
  {model("post", "cylinder", "0.1 2", pose="0 1 1 0 0 0")}
</model>
<model name="hung" placement_frame="foot"><static>true</static><pose relative_to="block::door">0 5 0 0 0 0</pose>
  <frame name="foot"><pose>0 0 -1 0 0 0</pose></frame>
  <link name="link"><collision name="c">{shape("box", "1 1 2")}</collision></link></model>
<model name="by_quaternion"><static>1</static>
  <pose rotation_format="quat_xyzw">-5 0 1  0 0 0.70710678 0.70710678</pose>
  <link name="link"><collision name="c">{shape("box", "4 1 2")}</collision></link></model>"""
    return world(folder, inside, version="1.9")


def database(folder):
    """Includes of models at hand: without name, twice, with static and pose, nested, scaled meshes of three formats."""
    models = folder / "models"
    crate = model_folder(models, "crate", model("crate", "mesh", "meshes/crate.dae", static=False, mass="20"))
    (crate / "meshes").mkdir(exist_ok=True)
    write_dae(crate / "meshes" / "crate.dae", size=(0.5, 1.0, 0.8), at=(-0.25, -0.5, 0.0))
    arch = model_folder(models, "arch", model("arch", "mesh", "model://arch/arch.stl"), config=False)
    parts = [box((-2, -0.2, 0), (-1.6, 0.2, 3)), box((1.6, -0.2, 0), (2, 0.2, 3)), box((-2, -0.2, 3), (2, 0.2, 3.4))]
    write_stl(arch / "arch.stl", np.concatenate(parts))
    pair = '<model name="pair"><static>1</static>' + include("model://crate", name="a") + (
        include("model://crate", name="b", pose="0 3 0 0 0 0") + "</model>"
    )  # fmt: skip
    model_folder(models, "pair", pair)
    inside = (
        include("model://crate", pose="1 0 0 0 0 0")
        + include("model://crate", pose="3 0 0 0 0 1.5707963", more="<static>true</static>")
        + include("model://arch", name="gate one", pose="0 8 0 0 0 0")
        + include("model://pair", pose="-8 0 0 0 0 0")
    )
    return world(folder / "worlds", inside)


def ground(folder):
    """Floors, patches of planes, roads and friction."""
    mu = "<surface><friction><ode><mu>{}</mu><mu2>50</mu2></ode></friction></surface>"
    inside = (
        model("asphalt_lot", size="30 20 0.1", pose="5 0 -0.05 0 0 0", more=mu.format(0.7))
        + model("turned_floor", size="4 2 0.02", pose="0 25 0 0 0 0.5")
        + '<model name="grass_plane"><static>1</static><pose>-30 0 0.001 0 0 0</pose><link name="l">'
        '<collision name="c"><geometry><plane><normal>0 0 1</normal><size>10 12</size></plane></geometry>'
        + mu.format(0.4)
        + "</collision></link></model>"
        '<model name="ramp_plane"><static>1</static><pose>0 0 0 0 0.2 0</pose><link name="l"><collision name="c">'
        "<geometry><plane><normal>0 0 1</normal><size>10 10</size></plane></geometry></collision></link></model>"
        '<road name="main street"><width>6</width><point>0 -30 0</point><point>40 -30 0</point></road>'
        + model("kerb", size="10 0.2 0.12", pose="0 -20 0.06 0 0 0")
    )
    plane = PLANE.replace("</geometry>", "</geometry>" + mu.format(0.9))
    return world(folder, inside, plane=plane)


def leftovers(folder):
    """Write a world with elements that cannot be converted."""
    inside = """
<physics type="ode"><gravity>0 0 -1.62</gravity></physics><scene><ambient>1 1 1 1</ambient></scene><gui/><wind/>
<spherical_coordinates/><plugin name="p" filename="libp.so"/><magnetic_field>1 1 1</magnetic_field><audio/>
<light name="lamp" type="point"><pose>0 0 3 0 0 0</pose></light>
<light name="moon" type="directional"><direction>0 0 1</direction></light>
<actor name="walker"><pose>5 6 1 0 0 1.5707963</pose></actor>
<model name="hills"><static>1</static><link name="l"><collision name="c"><geometry><heightmap><uri>h.png</uri>
</heightmap></geometry></collision></link></model>
<model name="ghost"><static>1</static><link name="l"><visual name="v"><geometry><box><size>1 1 1</size></box></geometry>
</visual></link></model>
<model name="robot"><pose>-4 3 0.1 0 0 3.14159265</pose><link name="body"/><link name="w1"/><link name="w2"/>
<link name="w3"/><joint name="a" type="revolute"><parent>body</parent><child>w1</child></joint>
<joint name="b" type="revolute"><parent>body</parent><child>w2</child></joint>
<joint name="c" type="continuous"><parent>body</parent><child>w3</child></joint></model>"""
    return world(folder, inside)


def crowds(folder):
    """Populations of every kind."""

    def population(name, rest, pose="0 0 0 0 0 0", inner=None):
        inner = inner or model(name, "cylinder", "0.2 1", static=True)
        return f'<population name="{name}">{inner}<pose>{pose}</pose>{rest}</population>'

    def spread(kind):
        return f"<distribution><type>{kind}</type></distribution>"

    box = "<model_count>{}</model_count><box><size>{}</size></box>"
    disc = "<model_count>4</model_count><cylinder><radius>5</radius><length>1</length></cylinder>"
    grid = "<distribution><type>grid</type><rows>3</rows><cols>4</cols><step>2 3 0</step></distribution>"
    inside = (
        population("cans", grid, "10 20 0 0 0 0")
        + population("row", box.format(5, "0.1 10 0.1") + spread("linear-y"), "-20 0 0 0 0 0")
        + population("loose", box.format(6, "8 6 1") + spread("random"), "20 -20 0.5 0 0 0")
        + population("round", disc + spread("uniform"), "-20 -20 0 0 0 0")
        + population("empty", box.format(0, "8 6 1") + spread("random"))
    )
    return world(folder, inside)


def old_crowds(folder):
    """Populations as SDF 1.4 had them: a region with corners, and the distribution as a word."""

    def population(name, region, count, kind):
        inner = model(name, "cylinder", "0.1 0.5", static=True)
        return (
            f'<population name="{name}">{inner}<region>{region}</region><model_count>{count}</model_count>'
            f"<distribution>{kind}</distribution></population>"
        )

    steps = "<cuboid><min>-10 -12 0</min><rows>2</rows><cols>3</cols><step>2 3 0</step></cuboid>"
    inside = (
        population("steps", steps, 6, "grid")
        + population("some", "<cuboid><min>3 3 0</min><max>9 7 0.1</max></cuboid>", 5, "random")
        + population("round", "<cylinder><center>-13 3 0</center><radius>2</radius></cylinder>", 5, "uniform")
        + population("row", "<cuboid><min>-1 14 0</min><max>5 16 0.1</max></cuboid>", 6, "linear-x")
    )
    return world(folder, inside, version="1.4")


def outlines(folder):
    """Write extruded buildings, one L-shaped, one with a yard, on ground whose height of 5 m follows from the roads."""

    def ring(*points):
        return "<polyline><height>6</height>" + "".join(f"<point>{p}</point>" for p in points) + "</polyline>"

    def building(name, pose, rings):
        return (
            f'<model name="{name}"><static>1</static><pose>{pose}</pose><link name="l"><collision name="c"><geometry>'
            f"{rings}</geometry></collision></link></model>"
        )

    ell = ring("0 0", "20 0", "20 8", "8 8", "8 20", "0 20")
    yard = ring("0 0", "10 0", "10 10", "0 10") + ring("3 3", "3 7", "7 7", "7 3")
    inside = (
        building("ell", "10 20 5 0 0 0", ell)
        + building("yard", "-30 10 5 0 0 0", yard)
        + '<road name="street"><width>6</width><point>-40 0 5</point><point>40 0 5</point></road>'
    )
    return world(folder, inside, plane="")


def tilted(folder, *, plane=PLANE):
    """Things of several shapes in any pose, links with poses of their own, static and loose."""
    inside = (
        model("leaning", size="3 0.4 1.2", pose="5 -4 1.1 0.1 -0.35 2.2", link="0.3 0.1 0.2 -0.2 0.1 0.4")
        + model("pipe", "cylinder", "0.2 3", pose="-8 3 0.7 1.5707963 0 0.6")
        + model("ball", "sphere", "0.4", pose="-2 -7 0.4 0.3 0.2 0.1", static=False, mass="3")
        + f"""<model name="bench"><static>1</static><pose>12.3456 7.6543 0 0 0 -1.234</pose>
<link name="seat"><pose>0 0 0.5 0 0 0</pose><collision name="c">{shape("box", "1.6 0.4 0.05")}</collision></link>
<link name="leg"><pose>0.7 0 0.25 0 0 0.3</pose><collision name="c"><pose>0.01 0.02 0 0 0.1 0</pose>
{shape("cylinder", "0.04 0.5")}</collision></link></model>"""
    )
    return world(folder, inside, version="1.7", plane=plane)


def rich(folder):
    """Write a world with elements of every kind, as input of mutations."""
    models = folder / "models"
    arch = model_folder(models, "arch", model("arch", "mesh", "model://arch/arch.stl"))
    write_stl(arch / "arch.stl", box((-2, -0.2, 0), (-1.6, 0.2, 3)))
    inside = f"""
<state world_name="default">
<model name="crate"><pose>4 -2 0.499 1e-6 0 0.5</pose><scale>1 2 1</scale></model>
<deletions><name>gone</name></deletions>
</state>
{include("model://sun")}
{include("model://arch", pose="0 8 0 0 0 0.3", name="gate")}
{include("model://construction_cone", pose="6 6 0 0 0 0")}
<frame name="corner"><pose degrees="true">10 0 0 0 0 90</pose></frame>
{model("crate", pose="0 0 9 0 0 0", static=False, mass="7")}
{model("gone", pose="0 30 0.5 0 0 0")}
{model("floor", size="12 8 0.02", pose="-20 0 0 0 0 0.2")}
{model("leaning", size="3 0.4 1.2", pose="5 -4 1.1 0.1 -0.35 2.2", link="0.3 0.1 0.2 -0.2 0.1 0.4")}
<model name="block"><static>true</static><pose relative_to="corner">1 2 0 0 0 0</pose>
<link name="wall"><pose>3 0 1 0 0 0</pose><collision name="c">{shape("box", "2 0.2 2")}</collision></link>
{model("post", "cylinder", "0.1 2", pose="0 1 1 0 0 0")}
</model>
<road name="street"><width>6</width><point>0 -30 0</point><point>40 -30 0</point></road>
<actor name="walker"><pose>15 6 1 0 0 1.5</pose></actor>
<population name="cans">{model("can", "cylinder", "0.2 1")}<pose>-30 -20 0 0 0 0</pose><model_count>4</model_count>
<cylinder><radius>5</radius><length>1</length></cylinder><distribution><type>random</type></distribution></population>
<light name="lamp" type="point"><pose>0 0 3 0 0 0</pose></light>
<plugin name="p" filename="libp.so"/>"""
    return world(folder, inside, version="1.9", file="worlds/rich.world")


def meshes(folder):
    """Return a road, walls around a place, a small room without ceiling, and hills, as meshes."""
    poses = {"asphalt_road": "", "maze": "", "hills": "", "room": "5 5 0 0 0 0.4"}
    path = world(folder, "".join(model(name, "mesh", f"{name}.stl", pose=pose) for name, pose in poses.items()))
    sides = [box((-2, -2, 0), (2, -1.9, 1)), box((-2, 1.9, 0), (2, 2, 1)), box((1.9, -1.8, 0), (2, 1.8, 1))]
    write_stl(folder / "room.stl", np.concatenate(sides))
    write_stl(folder / "asphalt_road.stl", box((0, 0, -0.01), (40, 4, 0.01)))
    sides = [box((-20, -20, 0), (20, -19.9, 1)), box((-20, 19.9, 0), (20, 20, 1)),
             box((-20, -20, 0), (-19.9, 20, 1)), box((19.9, -20, 0), (20, 20, 1))]  # fmt: skip
    write_stl(folder / "maze.stl", np.concatenate(sides))
    x, y = np.meshgrid(np.linspace(-40, 40, 9), np.linspace(-40, 40, 9), indexing="ij")
    z = 2.0 * np.sin(0.2 * x) * np.cos(0.2 * y)
    points = np.stack((x, y, z), axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    quads = np.stack((np.stack((a, b, c), axis=-2), np.stack((a, c, d), axis=-2)), axis=-3).reshape(-1, 3, 3)
    write_stl(folder / "hills.stl", quads)
    return path


def broken():
    """Contents of worlds with one fault each, and a part of its message."""
    good = model("good", pose="20 0 0.5 0 0 0")
    return {
        "nan": (model("bad", pose="nan 0 0 0 0 0"), "finite"),
        "few numbers": (model("bad", pose="1 2 3"), "6 finite"),
        "words": (model("bad", pose="a b c d e f"), "6 finite"),
        "far": (model("bad", pose="1e9 0 0 0 0 0"), "at most 45000 m"),
        "negative": (model("bad", size="1 -1 1"), "allowed are 1 mm"),
        "tiny": (model("bad", size="1 1e-9 1"), "allowed are 1 mm"),
        "zero radius": (model("bad", "sphere", "0"), "allowed are 1 mm"),
        "no size": (model("bad").replace("<size>1 1 1</size>", ""), "without <size>"),
        "missing mesh": (model("bad", "mesh", "nowhere.dae"), "no such file"),
        "mesh elsewhere": (model("bad", "mesh", "model://nobody/m.dae"), "GAZEBO_MODEL_PATH (not set)"),
        "open outline": (
            model("bad").replace("<box><size>1 1 1</size></box>", "<polyline><point>0 0</point></polyline>"),
            "3 to 400 are allowed",
        ),
        "no address": (model("bad", "mesh", ""), "no <uri>"),
        "unknown include": (include("model://no_such_model_of_anybody"), "--package no_such_model_of_anybody=DIR"),
        "bare include": ("<include/>", "it has no <uri>"),
        "strange address": (include("ftp://example.org/gizmo"), "is not supported"),
        "unknown frame": (
            model("bad").replace("<static>1</static>", '<static>1</static><pose relative_to="x">0 0 0 0 0 0</pose>'),
            "frame 'x' does not exist",
        ),
        "population": (
            f'<population name="p">{good}<distribution><type>swarm</type></distribution></population>',
            "swarm",
        ),
        "endless population": (
            f'<population name="p">{good}<model_count>inf</model_count></population>',
            "at most 45000",
        ),
        "double link": (model("bad", extra='<link name="link"/>'), "names must differ"),
    }


def circuit(folder, height, *, with_plane=True, seen_only=False):
    """Return two straights of 100 m and two bends of radius 30 m out of slabs 8 m wide whose top is at a height [m]."""
    thick = min(0.05, 2.0 * height)
    z = height - thick / 2.0
    slab = {"visual": True, "more": ""}
    parts = [("straight_1", 100.0, 0.0, -30.0, 0.0), ("straight_2", 100.0, 0.0, 30.0, 0.0)]
    for side in (-1.0, 1.0):
        for turn in np.linspace(-80.0, 80.0, 9):
            a = np.radians(turn)
            x, y = side * (50.0 + 30.0 * np.cos(a)), 30.0 * np.sin(a)
            parts.append((f"bend_{int(side)}_{int(turn)}", 11.0, x, y, side * a + np.pi / 2.0))
    text = "".join(
        model(f"{name} asphalt", size=f"{long} 8 {thick}", pose=f"{x:.3f} {y:.3f} {z:.4f} 0 0 {yaw:.4f}", **slab)
        for name, long, x, y, yaw in parts
    )
    if seen_only:
        text = re.sub("<collision.*?</collision>", "", text, flags=re.DOTALL)
    text += model("cone", size="0.3 0.3 0.6", pose=f"20 33 {0.3 + (0.0 if seen_only else height)} 0 0 0")
    return world(folder, text, **({} if with_plane else {"plane": ""}))


def mesh_circuit(folder, radius, width, *, seen_only=False, walls=0.0, rise=0.0, height=0.0):
    """Return a ring of triangles as a track, with walls along its edges, or rising and falling by `rise` [m]."""
    count = 120
    turn = 2.0 * np.pi * np.arange(count) / count
    z = height + 0.5 * rise * (1.0 - np.cos(turn))
    rings = [np.column_stack((r * np.cos(turn), r * np.sin(turn), z + up))
             for up in ((0.0, walls) if walls else (0.0,))
             for r in (radius + width / 2.0, radius - width / 2.0)]  # fmt: skip
    faces = []
    for i in range(count):
        j = (i + 1) % count
        pairs = [(0, 1), (0, 2), (1, 3)] if walls else [(0, 1)]
        for a, b in pairs:
            faces += [(a * count + i, a * count + j, b * count + j), (a * count + i, b * count + j, b * count + i)]
    lines = [f"v {x:.4f} {y:.4f} {h:.4f}" for ring in rings for x, y, h in ring]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    (folder / "ring.obj").write_text("\n".join(lines) + "\n")
    geometry = "<geometry><mesh><uri>ring.obj</uri></mesh></geometry>"
    collision = "" if seen_only else f"<collision name='c'>{geometry}</collision>"
    inside = (
        f"<model name='race_track'><static>1</static><link name='l'>{collision}<visual name='v'>{geometry}</visual>"
        "</link></model>"
    )
    return world(folder, inside, **({"plane": ""} if rise else {}))


def town(folder, radius, width, *, named_by):
    """One mesh of level ground, a ring road and two houses; the parts differ in OBJ name or file."""
    turn = np.linspace(0.0, 2.0 * np.pi, 81)
    ring = []
    for a, b in itertools.pairwise(turn):
        corners = [
            (r * np.cos(t), r * np.sin(t), 0.01) for t in (a, b) for r in (radius - width / 2, radius + width / 2)
        ]
        ring += [[corners[0], corners[1], corners[3]], [corners[0], corners[3], corners[2]]]
    side = radius + 40.0
    square = [(-side, -side, 0.0), (side, -side, 0.0), (side, side, 0.0), (-side, side, 0.0)]
    parts = {
        "grass": [square[:3], [square[0], square[2], square[3]]],
        "MainStreet_asphalt": ring,
        "houses": [*box((-20, -5, 0), (-8, 8, 7)), *box((8, -5, 0), (20, 8, 9))],
    }
    if named_by == "file":
        geometries = []
        for name, triangles in parts.items():
            _write_parts(folder / f"{name}.obj", {name: triangles}, "o")
            geometries.append(f"<geometry><mesh><uri>{name}.obj</uri></mesh></geometry>")
        links = "".join(
            f"<link name='l{i}'><collision name='c'>{text}</collision><visual name='v'>{text}</visual></link>"
            for i, text in enumerate(geometries)
        )
        return world(folder, f"<model name='town'><static>1</static>{links}</model>", plane="")
    _write_parts(folder / "town.obj", parts, named_by)
    return world(folder, model("town", "mesh", "town.obj"), plane="")


def _write_parts(path, parts, named_by):
    """An OBJ file of triangles with named parts."""
    lines, count = [], 0
    for name, triangles in parts.items():
        lines.append(f"{named_by} {name}")
        for triangle in triangles:
            lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in triangle]
            lines.append(f"f {count + 1} {count + 2} {count + 3}")
            count += 3
    path.write_text("\n".join(lines) + "\n")

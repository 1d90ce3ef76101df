"""Small ROS and Gazebo packages with the faults of real ones, written by the tests.

Each function writes one package below a folder and returns its main file. Lengths are metres, masses kilograms.
"""

import io
import tarfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from tests.mesh_rigs import TEXTURED, box, flat, write_dae, write_stl

POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:0123456789abcdef\nsize 4096\n"
QUARTER = "1.5707963"


@dataclass(frozen=True)
class Car:
    """Numbers of a car as its files have them."""

    wheelbase: float = 2.5
    track: float = 1.5
    radius: float = 0.3
    width: float = 0.2
    body: float = 1200.0  # mass
    wheel: float = 15.0  # mass
    limit: float = 0.55

    @property
    def corners(self):
        """Name -> x, y of the wheel, with base_link between the axles."""
        x, y = 0.5 * self.wheelbase, 0.5 * self.track
        return {"front_left": (x, y), "front_right": (x, -y), "rear_left": (-x, y), "rear_right": (-x, -y)}

    @property
    def size(self):
        """Edges of the body."""
        return (1.5 * self.wheelbase, self.track - 1.2 * self.width, 0.35 * self.wheelbase)


RACER = Car(wheelbase=0.33, track=0.25, radius=0.05, width=0.04, body=2.8, wheel=0.15, limit=0.42)
GOLF = Car(wheelbase=1.7, track=1.0, radius=0.22, width=0.16, body=420.0, wheel=8.0, limit=0.5)


def box_inertial(mass, size, position="0 0 0"):
    x, y, z = size
    ixx, iyy, izz = (mass / 12.0 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y)))
    return (
        f'<inertial><origin xyz="{position}"/><mass value="{mass:g}"/>'
        f'<inertia ixx="{ixx:.6g}" ixy="0" ixz="0" iyy="{iyy:.6g}" iyz="0" izz="{izz:.6g}"/></inertial>'
    )


def wheel_inertial(car):
    spin = 0.5 * car.wheel * car.radius**2
    across = car.wheel * (3 * car.radius**2 + car.width**2) / 12.0
    return (
        f'<inertial><mass value="{car.wheel:g}"/><inertia ixx="{across:.6g}" ixy="0" ixz="0" iyy="{spin:.6g}" '
        f'iyz="0" izz="{across:.6g}"/></inertial>'
    )


def cylinder(car):
    return f'<origin rpy="{QUARTER} 0 0"/><geometry><cylinder radius="{car.radius}" length="{car.width}"/></geometry>'


def mesh(address, scale="", position=""):
    scale = f' scale="{scale}"' if scale else ""
    position = f'<origin xyz="{position}"/>' if position else ""
    return f'{position}<geometry><mesh filename="{address}"{scale}/></geometry>'


def body_shape(car, lift):
    x, y, z = car.size
    return f'<origin xyz="0 0 {lift + 0.5 * z:g}"/><geometry><box size="{x:g} {y:g} {z:g}"/></geometry>'


def link(name, inertial="", visual="", collision=""):
    visual = f"<visual>{visual}</visual>" if visual else ""
    collision = f"<collision>{collision}</collision>" if collision else ""
    return f'<link name="{name}">{inertial}{visual}{collision}</link>\n'


def joint(name, kind, parent, child, *, origin="0 0 0", axis="0 0 1", inside=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/><axis xyz="{axis}"/>{inside}</joint>\n'
    )


def transmission(name, interface):
    return (
        f'<transmission name="{name}_trans"><type>transmission_interface/SimpleTransmission</type><joint name="{name}">'
        f"<hardwareInterface>hardware_interface/{interface}</hardwareInterface></joint>"
        f'<actuator name="{name}_motor"><mechanicalReduction>1</mechanicalReduction></actuator></transmission>\n'
    )


def car_urdf(
    name, car, *, visual="", wheel_visual="", wheel_collision="", steer="{corner}_steer_joint",
    spin="{corner}_wheel_joint", wheel="{corner}_wheel", kinds=("revolute", "revolute"), steer_limit="", spin_limit="",
    base="base_link", before="", after="", suspension=None, transmissions=True,
):  # fmt: skip
    """A car with a body, two knuckles and four wheels; base_link between the axles at the height of their centres."""
    lift = 0.1 * car.radius
    inertial = box_inertial(car.body, car.size, f"0 0 {0.3 * car.size[2]:g}")
    text = before + link(base, inertial, visual or body_shape(car, lift), body_shape(car, lift))
    limit = steer_limit or f'<limit lower="-{car.limit}" upper="{car.limit}" effort="1000" velocity="2"/>'
    for corner, (x, y) in car.corners.items():
        position, parent = f"{x:g} {y:g} 0", base
        if suspension is not None:
            carrier = f"{corner}_carrier"
            text += link(carrier, box_inertial(0.5 * car.wheel, (0.1, 0.1, 0.1)))
            text += joint(f"{corner}_shock", "prismatic", base, carrier, origin=position, inside=suspension)
            position, parent = "0 0 0", carrier
        if corner.startswith("front"):
            knuckle, steered = f"{corner}_knuckle", steer.format(corner=corner)
            text += link(knuckle, box_inertial(0.3 * car.wheel, (0.1, 0.1, 0.1)))
            text += joint(
                steered, kinds[corner.endswith("right")], parent, knuckle, origin=position, inside=limit
            )  # fmt: skip
            position, parent = "0 0 0", knuckle
            if transmissions:
                text += transmission(steered, "PositionJointInterface")
        tyre, turning = wheel.format(corner=corner), spin.format(corner=corner)
        text += link(tyre, wheel_inertial(car), wheel_visual or cylinder(car), wheel_collision or cylinder(car))
        text += joint(turning, "continuous", parent, tyre, origin=position, axis="0 1 0", inside=spin_limit)
        if transmissions and corner.startswith("rear"):
            text += transmission(turning, "EffortJointInterface")
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n{text}{after}</robot>\n'


def package(folder, name, main, text, *, inside="urdf"):
    """Write a ROS package with one description file."""
    for part in (inside, "meshes"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    (folder / "package.xml").write_text(
        f'<?xml version="1.0"?>\n<package format="2"><name>{name}</name><version>0.1.0</version>'
        "<description>made by a test</description><maintainer email='nobody@example.org'>nobody</maintainer>"
        "<license>BSD</license></package>\n"
    )
    (folder / inside / main).write_text(text)
    return folder / inside / main


def wheel_mesh(car, scale=1.0):
    solid = trimesh.creation.cylinder(car.radius, car.width, sections=24).triangles
    return scale * solid[..., [0, 2, 1]][:, ::-1]  # axis along y, still outside out


def paint(path):
    picture = Image.new("RGB", (8, 8), (200, 30, 30))
    picture.paste((240, 240, 240), (0, 4, 8, 8))
    picture.save(path)


def body_dae(car, path, *, unit=0.01, up="Y_UP"):
    """The body in centimetres with a picture and a painted roof, and an up axis that counts for nothing."""
    size = np.array(car.size) / unit
    position = np.array([-0.5 * size[0], -0.5 * size[1], 0.1 * car.radius / unit])
    paint(path.parent / "Paint.PNG")
    looks = [("skin", TEXTURED), ("roof", flat(0.1, 0.2, 0.8))]
    write_dae(path, size=size, at=position, unit=f"{unit:g}", up=up, looks=looks, picture="../textures/paint.png")


# ---- cars that must come out


def city_car(folder):
    """Return a xacro package: $(find), macros in a second file, DAE and STL, Gazebo tags, transmissions, controllers.

    Its folder is not called as the package.
    """
    car, root = Car(), folder / "src" / "city_car-main"
    macros = f"""<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="r" value="{car.radius}"/>
<xacro:macro name="wheel" params="corner x y parent">
  <link name="${{corner}}_wheel">{wheel_inertial(car)}
    <visual><geometry><mesh filename="package://city_car_description/meshes/Wheel.STL"/></geometry></visual>
    <collision><geometry><mesh filename="package://city_car_description/meshes/Wheel.STL"/></geometry></collision></link>
  <joint name="${{corner}}_wheel_joint" type="continuous"><parent link="${{parent}}"/><child link="${{corner}}_wheel"/>
    <origin xyz="${{x}} ${{y}} 0"/><axis xyz="0 1 0"/><limit effort="0" velocity="0"/></joint>
  <gazebo reference="${{corner}}_wheel"><mu1>0.9</mu1><mu2>0.9</mu2><kp>1e7</kp><kd>1e3</kd>
    <material>Gazebo/Black</material></gazebo>
</xacro:macro>
<xacro:macro name="steered" params="corner x y">
  <link name="${{corner}}_knuckle">{box_inertial(4.0, (0.1, 0.1, 0.1))}</link>
  <joint name="${{corner}}_steer_joint" type="revolute"><parent link="chassis"/><child link="${{corner}}_knuckle"/>
    <origin xyz="${{x}} ${{y}} 0"/><axis xyz="0 0 1"/>
    <limit lower="-{car.limit}" upper="{car.limit}" effort="1000" velocity="2"/></joint>
  <xacro:wheel corner="${{corner}}" x="0" y="0" parent="${{corner}}_knuckle"/>
  {transmission("${corner}_steer_joint", "PositionJointInterface")}
</xacro:macro></robot>
"""
    x, y = car.corners["front_left"]
    main = f"""<?xml version="1.0"?>
<robot name="city_car" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:include filename="$(find city_car_description)/urdf/macros.xacro"/>
<xacro:arg name="lidar" default="false"/>
<xacro:if value="$(arg lidar)"><xacro:include filename="$(find lidar_nobody_has)/urdf/lidar.xacro"/></xacro:if>
<link name="base_footprint"/>
<link name="chassis">{box_inertial(car.body, car.size, "0 0 0.2")}
  <visual><geometry><mesh filename="package://city_car_description/meshes/body.dae"/></geometry></visual>
  <collision>{body_shape(car, 0.03)}</collision></link>
<joint name="base_joint" type="fixed"><parent link="base_footprint"/><child link="chassis"/>
  <origin xyz="0 0 ${{r}}"/></joint>
<xacro:steered corner="front_left" x="{x}" y="{y}"/>
<xacro:steered corner="front_right" x="{x}" y="-{y}"/>
<xacro:wheel corner="rear_left" x="-{x}" y="{y}" parent="chassis"/>
<xacro:wheel corner="rear_right" x="-{x}" y="-{y}" parent="chassis"/>
{transmission("rear_left_wheel_joint", "EffortJointInterface")}
{transmission("rear_right_wheel_joint", "EffortJointInterface")}
<link name="camera_link"/>
<joint name="camera_joint" type="fixed"><parent link="chassis"/><child link="camera_link"/>
  <origin xyz="0.5 0 1"/></joint>
<gazebo reference="chassis"><material>Gazebo/Red</material></gazebo>
<gazebo reference="camera_link"><sensor type="camera" name="front"><update_rate>10</update_rate>
  <camera><horizontal_fov>1.4</horizontal_fov><image><width>320</width><height>240</height></image>
  <clip><near>0.1</near><far>80</far></clip></camera>
  <plugin name="front_ros" filename="libgazebo_ros_camera.so"/></sensor></gazebo>
<gazebo><plugin name="control" filename="libgazebo_ros_control.so"><robotNamespace>/city</robotNamespace></plugin>
</gazebo>
</robot>
"""
    path = package(root, "city_car_description", "city_car.urdf.xacro", main)
    (root / "urdf/macros.xacro").write_text(macros)
    (root / "config").mkdir()
    (root / "config/controllers.yaml").write_text(
        "city:\n  left_steer:\n    type: effort_controllers/JointPositionController\n"
        "    joint: front_left_steer_joint\n"
        "    pid: {p: 3000.0, i: 0.0, d: 100.0}\n"
    )
    (root / "LICENSE").write_text("BSD-3-Clause, nobody\n")
    body_dae(car, root / "meshes/body.dae")
    write_stl(root / "meshes/Wheel.STL", wheel_mesh(car))
    return path


def mini_racer(folder):
    """A 1:10 racer whose xacro uses an argument that it nowhere declares, without transmissions, with other names."""
    names = {"steer": "{corner}_hinge_joint", "spin": "{corner}_axle_joint", "wheel": "{corner}_tyre"}
    text = car_urdf("mini_racer", RACER, transmissions=False, **names)
    text = text.replace(
        '<robot name="mini_racer">',
        '<robot name="mini_racer" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        '<xacro:property name="version" value="$(arg racer_version)"/>\n<link name="laser_${version}"/>\n'
        '<joint name="laser_joint" type="fixed"><parent link="base_link"/><child link="laser_${version}"/></joint>',
    )
    return package(folder / "mini_racer", "mini_racer", "racer.xacro", text)


def golf_cart(folder):
    """Write a package with visual and collision meshes .STL in millimetres."""
    wheel = mesh("package://golf_cart/meshes/WHEEL.STL", "0.001 0.001 0.001")
    text = car_urdf(
        "golf_cart", GOLF, wheel_visual=wheel, wheel_collision=wheel,
        visual=mesh("package://golf_cart/meshes/BODY.STL", "0.001 0.001 0.001"),
    )  # fmt: skip
    path = package(folder / "golf_cart", "golf_cart", "golf_cart.urdf", text)
    size = 1000 * np.array(GOLF.size)
    low = np.array([-0.5 * size[0], -0.5 * size[1], 22.0])
    write_stl(path.parents[1] / "meshes/BODY.STL", box(low, low + size))
    write_stl(path.parents[1] / "meshes/WHEEL.STL", wheel_mesh(GOLF, 1000.0))
    return path


def loose_limits(folder):
    """Massless links, limits of -1 and efforts of 0."""
    frames = link("base_footprint") + joint("foot", "fixed", "base_footprint", "base_link", origin="0 0 0.3")
    marker = link("marker", "", '<geometry><sphere radius="0.1"/></geometry>')
    marker += joint("marker_joint", "fixed", "base_link", "marker", origin="0 0 1.2")
    text = car_urdf(
        "loose_limits", Car(), before=frames, after=marker, spin_limit='<limit effort="-1" velocity="-1"/>',
        steer_limit='<limit lower="-0.55" upper="0.55" effort="0" velocity="0"/>',
    )  # fmt: skip
    return package(folder / "loose_limits", "loose_limits", "car.urdf", text)


def ball_wheels(folder):
    """Write a package whose wheels have spheres as collision and cylinders as visual geometry."""
    ball = '<geometry><sphere radius="0.3"/></geometry>'
    text = car_urdf("ball_wheels", Car(), wheel_collision=ball)
    return package(folder / "ball_wheels", "ball_wheels", "car.urdf", text)


def shocks(folder):
    """Prismatic suspension whose springs are given in non-standard attributes."""
    spring = (
        '<limit lower="-0.1" upper="0.1" effort="100000" velocity="10"/>'
        '<dynamics damping="2500" friction="0" spring_stiffness="30000" spring_reference="0"/>'
    )
    return package(folder / "shocks", "shocks", "car.urdf", car_urdf("shocks", Car(), suspension=spring))


def wheels_in_the_box(folder):
    """The body collides as one box around everything, wheels as well; Gazebo lets no parts of one model touch."""
    car = Car()
    x, y, z = car.size
    text = car_urdf("boxed", car).replace(
        f'<collision><origin xyz="0 0 {0.1 * car.radius + 0.5 * z:g}"/><geometry><box size="{x:g} {y:g} {z:g}"/>',
        f'<collision><origin xyz="0 0 0.3"/><geometry><box size="{x:g} {car.track + 0.3:g} 1"/>',
    )
    return package(folder / "boxed", "boxed", "car.urdf", text)


def lost_pictures(folder):
    """Write a package whose textures are missing."""
    text = car_urdf("unseen", Car(), visual=mesh("../meshes/body.dae"), wheel_visual=mesh("../meshes/wheel.dae"))
    return package(folder / "unseen", "unseen", "car.urdf", text)


def uneven_steering(folder):
    """Write a package whose left steering joint is revolute and whose right one is continuous, hence without limits."""
    text = car_urdf("uneven", Car(), kinds=("revolute", "continuous"))
    return package(folder / "uneven", "uneven", "car.urdf", text)


def odd_words(folder):
    """Write elements that only some readers support.

    An axis of zero at a fixed joint, four factors of a mesh's scale, a colour inside the geometry, numbers as
    attributes of Gazebo tags, Bullet's contact, continuous steering joints with limits, a plugin that selects the axle
    with torque, a pedal, and a material of a script.
    """
    car = Car()
    solid = mesh("../meshes/body.STL", "1 1 1 1").replace("</geometry>", '<material name="paint"/></geometry>')
    text = car_urdf(
        "odd_words", car, visual=solid, kinds=("continuous", "continuous"), transmissions=False,
        steer_limit=f'<limit lower="-{car.limit}" upper="{car.limit}" effort="10000000" velocity="1000000"/>',
        before='<material name="paint"><color rgba="0.1 0.5 0.2 1"/></material>\n',
        after=link("plate", "", '<geometry><box size="0.1 0.3 0.02"/></geometry>')
        + joint("plate_joint", "fixed", "base_link", "plate", origin="1.9 0 0.5", axis="0 0 0")
        + link("pedal", box_inertial(0.1, (0.1, 0.1, 0.1)))
        + joint("pedal_joint", "prismatic", "base_link", "pedal", inside='<limit lower="0" upper="0.08" effort="9"/>')
        + "".join(
            f'<gazebo reference="rear_{side}_wheel"><mu1 value="0.7"/><mu2 value="0.7"/><minDepth value="0.002"/>'
            "</gazebo>"
            for side in ("left", "right")
        )
        + '<gazebo reference="plate"><material>Workshop/Rust</material></gazebo>'
        + '<gazebo><plugin name="hybrid" filename="libhybrid.so"><front_torque>800</front_torque>'
        "<back_torque>0</back_torque><front_brake_torque>900</front_brake_torque></plugin></gazebo>\n",
    )  # fmt: skip
    for side in ("left", "right"):
        text = text.replace(
            f'<link name="front_{side}_wheel">',
            f'<link name="front_{side}_wheel"><contact><lateral_friction value="0.8"/><rolling_friction value="0.01"/>'
            "</contact>",
        )
    path = package(folder / "odd_words", "odd_words", "car.urdf", text)
    x, y, z = car.size
    low = np.array([-0.5 * x, -0.5 * y, 0.03])
    write_stl(path.parents[1] / "meshes/body.STL", box(low, low + np.array([x, y, z])))
    return path


def controllers_beside(folder):
    """Write the description in one package, its controllers in a second one, those of another robot in a third."""
    path = package(
        folder / "rover_description", "rover_description", "rover.urdf", car_urdf("rover", Car(), transmissions=False)
    )
    for name, corners in (("rover_control", ("front_left", "front_right")), ("crane_control", ("rear_left",))):
        package(folder / name, name, "nothing.txt", "", inside="notes")
        (folder / name / "config").mkdir()
        (folder / name / "config/motors.yaml").write_text(
            "".join(
                f"{corner}_motor:\n  type: effort_controllers/JointVelocityController\n"
                f"  joint: {corner}_wheel_joint\n  pid: {{p: 5.0, i: 0.5, d: 0.0}}\n"
                for corner in corners
            )
            + "boom:\n  type: effort_controllers/JointPositionController\n  joint: boom_joint\n"
        )
    return path


def lost_meshes(folder, *, how):
    """Write a package whose body mesh is missing, packed in an archive, or only a pointer."""
    text = car_urdf("lost", Car(), visual=mesh("package://lost/meshes/body.dae"))
    path = package(folder / "lost", "lost", "car.urdf", text)
    meshes = path.parents[1] / "meshes"
    if how == "archive":
        body_dae(Car(), meshes / "body.dae")
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w:gz") as archive:
            archive.add(meshes / "body.dae", "meshes/body.dae")
        (path.parents[1] / "meshes.tar.gz").write_bytes(packed.getvalue())
        for file in meshes.iterdir():
            file.unlink()
    elif how == "pointer":
        (meshes / "body.dae").write_text(POINTER)
    return path


def sdf_inertial(mass, size):
    x, y, z = size
    ixx, iyy, izz = (mass / 12.0 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y)))
    return (
        f"<inertial><mass>{mass:g}</mass><inertia><ixx>{ixx:.6g}</ixx><iyy>{iyy:.6g}</iyy><izz>{izz:.6g}</izz>"
        "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
    )


def sdf_wheel(car):
    shape = f"<geometry><cylinder><radius>{car.radius}</radius><length>{car.width}</length></cylinder></geometry>"
    return (
        sdf_inertial(car.wheel, (2 * car.radius * 0.87, car.width, 2 * car.radius * 0.87))
        + f'<collision name="c"><pose>0 0 0 {QUARTER} 0 0</pose>{shape}<surface><friction><ode><mu>0.8</mu>'
        f"<mu2>0.8</mu2></ode></friction></surface></collision>"
        f'<visual name="v"><pose>0 0 0 {QUARTER} 0 0</pose>{shape}</visual>'
    )


def sdf_joint(name, kind, parent, child, *axes, limit=""):
    text = "".join(
        f"<{tag}><xyz>{axis}</xyz>{limit if tag == 'axis' else ''}</{tag}>"
        for tag, axis in zip(("axis", "axis2"), axes, strict=False)
    )
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{text}</joint>\n'


def model(folder, name, body):
    """Write a Gazebo model: model.config and model.sdf."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.config").write_text(
        f"<?xml version='1.0'?>\n<model><name>{name}</name><version>1.0</version><sdf version='1.6'>model.sdf</sdf>"
        "<author><name>nobody</name></author><description>made by a test</description></model>\n"
    )
    (folder / "model.sdf").write_text(
        f"<?xml version='1.0'?>\n<sdf version='1.6'><model name='{name}'>\n{body}</model></sdf>\n"
    )
    return folder / "model.sdf"


def sdf_body(car, visual=""):
    x, y, z = car.size
    shape = f"<geometry><box><size>{x:g} {y:g} {z:g}</size></box></geometry>"
    height = 1.1 * car.radius + 0.5 * z
    return (
        f"<link name='chassis'><pose>0 0 {height:g} 0 0 0</pose>{sdf_inertial(car.body, car.size)}"
        f"<collision name='c'>{shape}</collision><visual name='v'>{visual or shape}"
        "<material><ambient>0.1 0.6 0.1 1</ambient><diffuse>0.1 0.6 0.1 1</diffuse></material></visual></link>\n"
    )


def sdf_cart(folder):
    """Return an SDF cart: four nested includes of a wheel model, meshes by model://, one of them a submesh."""
    car, models = GOLF, folder / "models"
    limit = f"<limit><lower>-{car.limit}</lower><upper>{car.limit}</upper><effort>500</effort></limit>"
    visual = "<geometry><mesh><uri>model://yard_cart/meshes/cart.dae</uri><submesh><name>hood</name><center>false</center></submesh></mesh></geometry>"
    text = sdf_body(car, visual)
    for corner, (x, y) in car.corners.items():
        parent, position = "chassis", f"{x:g} {y:g} {car.radius} 0 0 0"
        if corner.startswith("front"):
            text += f"<link name='{corner}_hub'><pose>{position}</pose>{sdf_inertial(2.0, (0.1, 0.1, 0.1))}</link>\n"
            text += sdf_joint(f"{corner}_steer", "revolute", parent, f"{corner}_hub", "0 0 1", limit=limit)
            parent = f"{corner}_hub"
        text += f"<include><uri>model://yard_wheel</uri><name>{corner}_wheel</name><pose>{position}</pose></include>\n"
        text += sdf_joint(f"{corner}_spin", "revolute", parent, f"{corner}_wheel::rim", "0 1 0")
    path = model(models / "yard_cart", "yard_cart", text)
    model(models / "yard_wheel", "yard_wheel", f"<link name='rim'>{sdf_wheel(car)}</link>\n")
    (path.parent / "meshes").mkdir()
    x, y, z = car.size
    stray = "</node><node name='stray'><translate>0 0 30</translate><instance_geometry url='#cube'/>"
    write_dae(
        path.parent / "meshes/cart.dae", size=(x, y, z), at=(-0.5 * x, -0.5 * y, -0.5 * z), name="hood",
        matrix="<instance_geometry url='#cube'/>" + stray, looks=[("green", flat(0.1, 0.6, 0.1))],
    )  # fmt: skip
    return path


def two_axis_joints(folder, kind):
    """Front wheels that steer and spin in one joint of two axes: ``universal`` or ``revolute2``."""
    car = Car()
    limit = f"<limit><lower>-{car.limit}</lower><upper>{car.limit}</upper></limit>"
    text = sdf_body(car)
    for corner, (x, y) in car.corners.items():
        text += f"<link name='{corner}_wheel'><pose>{x:g} {y:g} {car.radius} 0 0 0</pose>{sdf_wheel(car)}</link>\n"
        if corner.startswith("front"):
            text += sdf_joint(f"{corner}_joint", kind, "chassis", f"{corner}_wheel", "0 0 1", "0 1 0", limit=limit)
        else:
            text += sdf_joint(f"{corner}_joint", "revolute", "chassis", f"{corner}_wheel", "0 1 0")
    return model(folder / kind, f"{kind}_car", text)


# ---- models that must be rejected


def skid_steer(folder):
    """Four driven wheels and no steering at all."""
    car = Car()
    text = link("base_link", box_inertial(60.0, car.size), body_shape(car, 0.03), body_shape(car, 0.03))
    for corner, (x, y) in car.corners.items():
        text += link(f"{corner}_wheel", wheel_inertial(car), cylinder(car), cylinder(car))
        text += joint(
            f"{corner}_wheel_joint", "continuous", "base_link", f"{corner}_wheel", origin=f"{x} {y} 0", axis="0 1 0"
        )
    return package(folder / "rover", "rover", "rover.urdf", f'<robot name="rover">{text}</robot>')


def tricycle(folder):
    """One steered wheel ahead, two behind."""
    car = Car()
    text = link("base_link", box_inertial(200.0, car.size), body_shape(car, 0.03), body_shape(car, 0.03))
    text += link("fork", box_inertial(5.0, (0.1, 0.1, 0.1)))
    inside = '<limit lower="-0.6" upper="0.6" effort="100" velocity="2"/>'
    text += joint("fork_joint", "revolute", "base_link", "fork", origin="1.25 0 0", inside=inside)
    for name, parent, position in (
        ("front", "fork", "0 0 0"),
        ("rear_left", "base_link", "-1.25 0.7 0"),
        ("rear_right", "base_link", "-1.25 -0.7 0"),
    ):
        text += link(f"{name}_wheel", wheel_inertial(car), cylinder(car), cylinder(car))
        text += joint(f"{name}_wheel_joint", "continuous", parent, f"{name}_wheel", origin=position, axis="0 1 0")
    return package(folder / "trike", "trike", "trike.urdf", f'<robot name="trike">{text}</robot>')


def six_wheeler(folder):
    """Return a car with a second rear axle."""
    car = Car()
    more = ""
    for side, y in (("left", 0.75), ("right", -0.75)):
        more += link(f"third_{side}_wheel", wheel_inertial(car), cylinder(car), cylinder(car))
        more += joint(
            f"third_{side}_wheel_joint",
            "continuous",
            "base_link",
            f"third_{side}_wheel",
            origin=f"-2 {y} 0",
            axis="0 1 0",
        )
    return package(folder / "lorry", "lorry", "lorry.urdf", car_urdf("lorry", car, after=more))


def arm(folder):
    """Three links on a pedestal."""
    rod = '<origin xyz="0 0 0.25"/><geometry><cylinder radius="0.05" length="0.5"/></geometry>'
    text = link("pedestal", box_inertial(20.0, (0.3, 0.3, 0.3)), rod, rod)
    parent = "pedestal"
    for number, axis in enumerate(("0 0 1", "0 1 0", "0 1 0")):
        text += link(f"arm_{number}", box_inertial(3.0, (0.1, 0.1, 0.5), "0 0 0.25"), rod, rod)
        inside = '<limit lower="-3" upper="3" effort="50" velocity="2"/>'
        text += joint(f"turn_{number}", "revolute", parent, f"arm_{number}", origin="0 0 0.5", axis=axis, inside=inside)
        parent = f"arm_{number}"
    return package(folder / "arm", "arm", "arm.urdf", f'<robot name="arm">{text}</robot>')


def drone(folder):
    """Return a frame with four rotors."""
    plate = '<geometry><box size="0.3 0.3 0.05"/></geometry>'
    blade = '<geometry><cylinder radius="0.1" length="0.01"/></geometry>'
    text = link("base_link", box_inertial(1.5, (0.3, 0.3, 0.05)), plate, plate)
    for number, (x, y) in enumerate(((0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2))):
        text += link(f"rotor_{number}", box_inertial(0.02, (0.2, 0.02, 0.01)), blade, blade)
        text += joint(f"rotor_{number}_joint", "continuous", "base_link", f"rotor_{number}", origin=f"{x} {y} 0.05")
    return package(folder / "drone", "drone", "drone.urdf", f'<robot name="drone">{text}</robot>')


def missing_include(folder):
    """Return a xacro that includes a package which is not there."""
    text = (
        '<robot name="bad" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        '<xacro:include filename="$(find sensors_nobody_has)/urdf/all.xacro"/>\n<link name="base_link"/></robot>\n'
    )
    return package(folder / "bad", "bad", "bad.urdf.xacro", text)


def lost_wheels(folder):
    """Write a package whose wheels have a missing mesh as their only shape."""
    gone = mesh("package://gone/meshes/wheel.dae")
    text = car_urdf("gone", Car(), wheel_visual=gone, wheel_collision=gone)
    return package(folder / "gone", "gone", "car.urdf", text)


def names_below(folder):
    """Return all files and folders, hidden ones too."""
    return sorted(str(path.relative_to(folder)) for path in Path(folder).rglob("*"))

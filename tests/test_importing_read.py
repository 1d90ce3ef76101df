"""Reading of URDF, xacro and SDF files: every element is read or reported."""

import tarfile
from math import pi

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mirdrake.core.errors import ModelError
from mirdrake.importing.packages import Packages
from mirdrake.importing.vehicles.read import read_source
from mirdrake.importing.vehicles.recognise import recognise
from mirdrake.vehicles.xacro_render import MissingArgumentsError
from tests import trap_packages as traps

URDF = """<?xml version="1.0"?>
<robot name="cart">
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="body">
    <inertial><origin xyz="0.1 0 0.2"/><mass value="12"/>
      <inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0" iyz="0"/></inertial>
    <visual><origin rpy="0 0 1.5707963267948966"/><geometry><box size="1 2 3"/></geometry>
      <material name="blue"/></visual>
    <collision><geometry><sphere radius="0.5"/></geometry></collision>
  </link>
  <link name="wheel"/>
  <joint name="axle" type="continuous">
    <origin xyz="1 2 3"/><parent link="body"/><child link="wheel"/><axis xyz="0 2 0"/>
    <limit effort="0" velocity="-1"/><dynamics damping="0.5" friction="0.1" spring_stiffness="300" colour="red"/>
  </joint>
  <gazebo reference="wheel"><mu1>1.2</mu1><kp>1e6</kp><fancy>yes</fancy>
    <sensor name="eye" type="camera"><pose>1 0 0 0 0 0</pose><update_rate>20</update_rate>
      <camera><image><width>64</width></image></camera></sensor></gazebo>
  <gazebo><plugin name="drive" filename="libdrive.so"><joint>axle</joint></plugin></gazebo>
  <transmission name="t"><joint name="axle">
    <hardwareInterface>hardware_interface/VelocityJointInterface</hardwareInterface></joint>
    <actuator name="m"><mechanicalReduction>7</mechanicalReduction></actuator></transmission>
  <spring between="body"/>
</robot>
"""


def written(folder, text, name="cart.urdf"):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_every_key_of_a_spring_between_links_is_read_or_reported(tmp_path):
    keys = {"stiffness": "3000", "damping": "200", "free_length": "0.3", "p_AP": "0 0 0.1", "p_BQ": "0 0 0"}
    tag = "drake:linear_spring_damper"
    spring = f'<{tag}><{tag}_body_A name="body"/><{tag}_body_B name="wheel"/>'
    spring += "".join(f'<{tag}_{key} value="{value}"/>' for key, value in keys.items()) + f"</{tag}>"
    text = URDF.replace('type="continuous"', 'type="prismatic"').replace('<spring between="body"/>', spring)
    text = text.replace('<robot name="cart">', '<robot name="cart" xmlns:drake="http://drake.mit.edu">')
    model = read_source(written(tmp_path, text))
    assert (model.joints["axle"].stiffness, model.joints["axle"].damping) == (3000.0, 200.5)
    rows = {change.part: (change.old, change.new) for change in model.changes if change.part.startswith("spring of")}
    assert rows == {f"spring of joint 'axle': {key}": (keys[key], None) for key in ("free_length", "p_AP", "p_BQ")}


def test_a_urdf_is_read_unchanged(tmp_path):
    model = read_source(written(tmp_path, URDF))
    body, axle = model.links["body"], model.joints["axle"]
    assert body.inertial is not None
    assert body.inertial.mass == 12.0
    np.testing.assert_array_equal(body.inertial.inertia, [[1, 0.1, 0], [0.1, 2, 0], [0, 0, 2.5]])
    np.testing.assert_allclose(body.inertial.X_LI.translation(), [0.1, 0, 0.2])
    (box,) = body.visuals
    assert (box.kind, box.size, box.rgba) == ("box", (1.0, 2.0, 3.0), (0.0, 0.0, 1.0, 1.0))
    np.testing.assert_allclose(box.X_LG.rotation().matrix() @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    assert (axle.limits.effort, axle.limits.velocity, axle.limits.lower) == (0.0, -1.0, None)
    assert (axle.damping, axle.friction, axle.stiffness) == (0.5, 0.1, 300.0)
    np.testing.assert_array_equal(axle.axis, [0, 2, 0])


def test_gazebo_tags_and_transmissions_are_not_dropped(tmp_path):
    model = read_source(written(tmp_path, URDF))
    surface = model.links["wheel"].surface
    assert surface is not None
    assert (surface.mu, surface.mu2, surface.stiffness) == (1.2, None, 1e6)
    (eye,) = model.sensors
    assert (eye.kind, eye.link, eye.rate, eye.values["camera.image.width"]) == ("camera", "wheel", 20.0, "64")
    assert model.plugins[0].values == {"joint": "axle"}
    assert model.transmissions[0].interfaces == ("velocity",)
    assert model.transmissions[0].reduction == 7.0
    reported = {change.part for change in model.changes}
    assert reported == {"joint 'axle': colour", "<gazebo reference='wheel'>: <fancy>", "robot 'cart': <spring>"}
    assert all(change.place.endswith(tuple("0123456789")) for change in model.changes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass value="12"', 'mass value="nan"', "mass 'nan' should be a number"),
        ('xyz="1 2 3"', 'xyz="1 2"', "<origin> xyz '1 2' should be 3 finite numbers"),
        ('child link="wheel"', 'child link="whel"', "child link 'whel' does not exist"),
        ('type="continuous"', 'type="contiuous"', "of type 'contiuous'"),
        ('<link name="wheel"/>', '<link name="wheel"/><link name="wheel"/>', "link 'wheel' is defined twice"),
        ('axis xyz="0 2 0"', 'axis xyz="0 0 0"', "its axis has no direction"),
        ("</robot>", "", "not valid XML"),
        ("<robot ", "<vehicle ", "not valid XML"),
    ],
)
def test_invalid_values_are_errors_with_their_line(tmp_path, old, new, words):
    assert old in URDF
    with pytest.raises(ModelError) as caught:
        read_source(written(tmp_path, URDF.replace(old, new)))
    assert words in str(caught.value)
    assert "cart.urdf:" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_all_arguments_without_default_are_reported_at_once(tmp_path):
    text = (
        '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">\n<xacro:arg name="width"/>\n'
        '<xacro:arg name="side"/>\n<xacro:arg name="colour" default="red"/>\n'
        '<link name="$(arg side)_$(arg width)"/></robot>'
    )
    path = written(tmp_path, text, "a.xacro")
    with pytest.raises(MissingArgumentsError) as caught:
        read_source(path)
    assert "--argument width=VALUE" in str(caught.value)
    model = read_source(path, arguments={"width": "2", "side": "left"})
    assert list(model.links) == ["left_2"]
    with pytest.raises(ModelError, match="unknown argument 'sid'; did you mean 'side'"):
        read_source(path, arguments={"width": "2", "side": "left", "sid": "x"})


# ---- packages


def test_packages_are_found_by_their_name_and_by_their_folder(tmp_path):
    for folder, name in (("src/car-main", "car_description"), ("src/meshes", "meshes")):
        written(tmp_path / folder, f"<package><name>{name}</name></package>", "package.xml")
    written(tmp_path / "models/wheel", "<model><name>Big Wheel</name></model>", "model.config")
    packages = Packages(tmp_path / "src/car-main/urdf/car.urdf")
    assert packages.find("car_description") == tmp_path / "src/car-main"
    assert packages.find("car-main") == tmp_path / "src/car-main"
    assert packages.find("meshes") == tmp_path / "src/meshes"
    assert packages.find("wheel") == tmp_path / "models/wheel"
    assert packages.find("nothing") is None
    assert Packages(tmp_path / "x.urdf", {"car_description": tmp_path / "y"}).find("car_description") == tmp_path / "y"


def test_meshes_are_found_with_other_case_or_in_other_folders_and_archives_are_reported(tmp_path):
    root = tmp_path / "car"
    written(root, "<package><name>car</name></package>", "package.xml")
    written(root / "Meshes", "solid", "Wheel.STL")
    written(root / "other", "solid", "hood.stl")
    written(root / "meshes2", traps.POINTER, "door.dae")
    with tarfile.open(root / "all.tar.xz", "w:xz") as archive:
        archive.add(root / "other/hood.stl", "meshes/seat.dae")
    packages = Packages(root / "urdf/car.urdf")

    def resolve(address):
        return packages.resolve(address, folder=root / "urdf")

    assert resolve("package://car/meshes/wheel.stl") == (
        root / "Meshes/Wheel.STL",
        "found with different upper and lower case",
    )
    path, remark = resolve("package://car/meshes/hood.stl")
    assert path == root / "other/hood.stl"
    assert "in other/" in remark
    assert resolve("package://car/meshes2/door.dae")[0] is None
    assert "git lfs pull" in resolve("package://car/meshes2/door.dae")[1]
    assert resolve("package://car/meshes/seat.dae") == (None, "packed in all.tar.xz; unpack it and import again")
    assert resolve("../other/hood.stl") == (root / "other/hood.stl", "")
    assert resolve("package://track/x.dae") == (
        None,
        "package 'track' is not found; give its folder with --package track=DIR",
    )
    assert resolve("http://example.org/x.dae")[0] is None


# ---- SDF


def sdf(tmp_path, body, *, version="1.7", name="cart"):
    text = f"<sdf version='{version}'><model name='{name}'>{body}</model></sdf>"
    return written(tmp_path, text, "model.sdf")


def test_poses_are_relative_to_the_frames_that_they_name(tmp_path):
    body = f"""
    <link name='body'><pose>1 0 0 0 0 {pi / 2}</pose></link>
    <frame name='hook' attached_to='body'><pose>2 0 0 0 0 0</pose></frame>
    <link name='wheel'><pose relative_to='hook'>0 1 0 0 0 0</pose></link>
    <joint name='axle' type='revolute'><parent>body</parent><child>wheel</child><pose>0 0 0.5 0 0 0</pose>
      <axis><xyz expressed_in='__model__'>0 1 0</xyz><limit><lower>-1</lower></limit></axis></joint>"""
    axle = read_source(sdf(tmp_path, body)).joints["axle"]
    # The hook is 2 m ahead of the body, the wheel 1 m to its left: in the body's frame at (2, 1, 0); the joint above.
    np.testing.assert_allclose(axle.X_PJ.translation(), [2.0, 1.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(axle.X_JC.translation(), [0.0, 0.0, -0.5], atol=1e-12)
    # y of the model is -x... of a joint that is turned by 90 degrees it is x.
    np.testing.assert_allclose(axle.axis, [1.0, 0.0, 0.0], atol=1e-12)
    assert axle.limits.lower == -1.0


def test_an_old_sdf_gives_axes_in_the_frame_of_the_model(tmp_path):
    body = f"""<link name='body'/><link name='wheel'><pose>0 0 0 0 0 {pi / 2}</pose></link>
    <joint name='axle' type='revolute'><parent>body</parent><child>wheel</child><axis><xyz>0 1 0</xyz></axis></joint>"""
    old = read_source(sdf(tmp_path / "old", body, version="1.4")).joints["axle"]
    new = read_source(sdf(tmp_path / "new", body, version="1.6")).joints["axle"]
    np.testing.assert_allclose(old.axis, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(new.axis, [0, 1, 0], atol=1e-12)


def test_nested_models_and_includes_keep_their_place(tmp_path):
    model = read_source(traps.sdf_cart(tmp_path))
    spin = model.joints["rear_left_spin"]
    assert spin.child == "rear_left_wheel::rim"
    x, y = traps.GOLF.corners["rear_left"]
    height = 1.1 * traps.GOLF.radius + 0.5 * traps.GOLF.size[2]
    np.testing.assert_allclose(spin.X_PJ.translation(), [x, y, traps.GOLF.radius - height], atol=1e-9)
    (hood,) = model.links["chassis"].visuals
    assert hood.mesh is not None
    assert (hood.submesh, hood.mesh.name) == ("hood", "cart.dae")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "<sdf version='1.6'><model name='a'><static>1</static><link name='b'/></model></sdf>",
            "a prop, not a vehicle",
        ),
        ("<sdf version='1.6'><world name='w'/></sdf>", "one model is expected in the file; there are 0"),
        (
            "<sdf version='1.6'><model name='a'><link name='b'><pose relative_to='c'/></link>"
            "<frame name='c' attached_to='b'/></model></sdf>",
            "relative to itself",
        ),
        ("<sdf version='1.6'><model name='a'><link name='b'><pose>1 2</pose></link></model></sdf>", "6 finite numbers"),
        (
            "<sdf version='1.6'><model name='a'><include><uri>model://nobody_has_it</uri></include></model></sdf>",
            "--package nobody_has_it=DIR",
        ),
        ("<mujoco/>", "is not SDF"),
    ],
)
def test_sdf_files_without_a_vehicle_are_rejected(tmp_path, text, words):
    with pytest.raises(ModelError) as caught:
        read_source(written(tmp_path, text, "model.sdf"))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_include_that_includes_itself_ends(tmp_path):
    body = "<include><uri>model://loop</uri></include>"
    path = sdf(tmp_path / "loop", body, name="loop")
    written(tmp_path / "loop", "<model><name>loop</name><sdf version='1.7'>model.sdf</sdf></model>", "model.config")
    with pytest.raises(ModelError, match=r"nested more than|used twice|includes itself"):
        read_source(path)


def test_controllers_and_licence_come_from_the_package(tmp_path):
    model = read_source(traps.city_car(tmp_path))
    (controller,) = model.controllers
    assert controller.kind == "effort_controllers/JointPositionController"
    assert controller.joints == ("front_left_steer_joint",)
    assert controller.gains == {"front_left_steer_joint": {"p": 3000.0, "i": 0.0, "d": 100.0}}
    assert model.texts["licence"] == "BSD"
    assert model.texts["licence file"] == "BSD-3-Clause, nobody"


SDF = """<sdf version='1.7'><model name='cart'><link name='body'><pose>1 0 0 0 0 0.5</pose><inertial><mass>3</mass>
<inertia><ixx>1</ixx></inertia></inertial><collision name='c'>
<geometry><box><size>1 2 3</size></box></geometry></collision></link>
<link name='wheel'/><joint name='axle' type='revolute'><parent>body</parent><child>wheel</child>
<axis><xyz>0 1 0</xyz></axis></joint></model></sdf>"""


@settings(max_examples=150, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_damaged_file_gives_a_model_or_an_error_of_one_line(data, tmp_path_factory):
    text, name = data.draw(st.sampled_from([(URDF, "cart.urdf"), (SDF, "cart.sdf")]))
    begin = data.draw(st.integers(0, len(text) - 1))
    end = data.draw(st.integers(begin, min(len(text), begin + 30)))
    filler = data.draw(
        st.sampled_from(["", "nan", "<", ">", '"', "body", "wheel", "0 0 0", "${x}", "$(find a)", "\x00", "é"])
    )
    path = written(tmp_path_factory.mktemp("broken"), text[:begin] + filler + text[end:], name)
    try:
        reported = [change.part for change in read_source(path).changes]
    except ModelError as error:
        reported = str(error).splitlines()
        assert len(reported) == 1
    assert all(reported)


def test_repeated_elements_are_all_kept(tmp_path):
    twice = URDF.replace("<joint>axle</joint></plugin>", "<joint>axle</joint><joint>hub</joint></plugin>")
    model = read_source(written(tmp_path, twice))
    assert model.plugins[0].values == {"joint": "axle", "joint[2]": "hub"}


def test_a_fixed_joint_needs_no_axis(tmp_path):
    still = URDF.replace('type="continuous"', 'type="fixed"').replace('axis xyz="0 2 0"', 'axis xyz="0 0 0"')
    assert read_source(written(tmp_path, still)).joints["axle"].kind == "fixed"


def test_packages_beside_are_those_of_the_same_name(tmp_path):
    for name in ("car_description", "car_control", "cart_control", "car"):
        (tmp_path / name / "urdf").mkdir(parents=True)
        (tmp_path / name / "package.xml").write_text(f"<package><name>{name}</name></package>")
    path = written(tmp_path / "car_description/urdf", URDF)
    assert [folder.name for folder in Packages(path).beside()] == ["car", "car_control"]


MACRO = """<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="wheel" params="name"><link name="${name}"/></xacro:macro>
  <link name="base_link"/>
  <wheel name="front"/>
  %s
</robot>"""


LOST = '<joint name="j" type="fixed"><parent link="base_link"/><child link="front"/></joint>'


@pytest.mark.parametrize("more", ["", LOST])
def test_a_macro_call_without_the_prefix_of_xacro_is_named_in_the_rejection(tmp_path, more):
    path = tmp_path / "cart.urdf.xacro"
    path.write_text(MACRO % more)
    with pytest.raises(ModelError, match=r"<wheel> \(.*:4\) looks like a call of the macro 'wheel' without the prefix"):
        recognise(read_source(path))


def test_tags_of_xacro_without_prefix_are_named_and_other_unknown_elements_are_not(tmp_path):
    path = tmp_path / "cart.urdf"
    path.write_text('<robot name="cart"><property name="a" value="1"/><sprocket/><link name="base_link"/></robot>')
    model = read_source(path)
    assert len(model.hints) == 1
    assert (model.hints[0].tag, model.hints[0].where) == ("property", f"{path}:1")
    with pytest.raises(ModelError, match=r"no movable joints.*<property>"):
        recognise(model)


def test_unexpanded_expressions_are_named_in_the_rejection(tmp_path):
    path = tmp_path / "model.sdf"
    inertial = "<inertial><mass>${mass}</mass></inertial>"
    path.write_text(f'<sdf version="1.6"><model name="m"><link name="a">{inertial}</link></model></sdf>')
    with pytest.raises(ModelError, match=r"mass '\$\{mass\}' should be a number; it is an expression of xacro"):
        read_source(path)


def test_all_missing_arguments_are_listed_at_once_also_those_of_files_included_later(tmp_path):
    head = '<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "part.xacro").write_text(f'{head}<xacro:arg name="late"/><link name="$(arg late)"/></robot>')
    path = tmp_path / "cart.xacro"
    path.write_text(
        f'{head}<xacro:arg name="first"/>\n<link name="a$(arg first)"/><link name="b$(arg second)"/>'
        '<xacro:include filename="part.xacro"/></robot>'
    )
    with pytest.raises(MissingArgumentsError) as caught:
        read_source(path)
    assert set(caught.value.arguments) == {"first", "second", "late"}
    with pytest.raises(MissingArgumentsError) as caught:
        read_source(path, arguments={"first": "1"})
    assert set(caught.value.arguments) == {"second", "late"}


def test_relative_paths_in_arguments_count_from_the_working_directory(tmp_path, monkeypatch):
    head = '<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    (tmp_path / "here" / "part.xacro").write_text(f'{head}<link name="part"/></robot>')
    path = tmp_path / "there" / "cart.xacro"
    path.write_text(
        f'{head}<xacro:arg name="file"/><xacro:arg name="ns"/><xacro:include filename="$(arg file)"/>'
        '<link name="$(arg ns)"/></robot>'
    )
    monkeypatch.chdir(tmp_path / "here")
    for text in ("part.xacro", "./part.xacro", "../here/part.xacro"):
        assert "part" in read_source(path, arguments={"file": text, "ns": "here"}).links
    assert set(read_source(path, arguments={"file": "part.xacro", "ns": "a/b"}).links) == {"part", "a/b"}

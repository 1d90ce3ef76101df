"""Loading vehicles: the Bolt's figures by hand, and one-line errors for faults of a folder."""

import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder

from mirdrake.core.errors import ConfigError, MirdrakeError, ModelError
from mirdrake.core.paths import data_root
from mirdrake.vehicles import Vehicle, load_vehicle, make_package_map, render_xacro
from mirdrake.vehicles.parse import drake_log

RADIUS, WIDTH, WHEELBASE = 0.3234, 0.215, 2.601
WHEEL_LINKS = ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")
PARTS = ("base_link", "front_left_knuckle", "front_right_knuckle", *WHEEL_LINKS)

Built = tuple[MultibodyPlant, Diagram]


def build(vehicle: Vehicle, *, urdf: str = "", contact_model: str = "point") -> Built:
    """Return the vehicle on a stiff half space."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=0.005, contact_model=contact_model)
    plant, _ = AddMultibodyPlant(config, builder)
    parser = Parser(plant)
    parser.package_map().AddMap(make_package_map(vehicle.packages))
    parser.AddModelsFromString(urdf or vehicle.urdf, "urdf")
    properties = ProximityProperties()
    AddContactMaterial(friction=CoulombFriction(0.9, 0.9), dissipation=0.0, point_stiffness=1e9, properties=properties)
    AddRigidHydroelasticProperties(1.0, properties)
    with drake_log():  # half spaces and deformable bodies
        plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(), HalfSpace(), "ground", properties)
    plant.Finalize()
    return plant, builder.Build()


@pytest.fixture(scope="module")
def bolt() -> Vehicle:
    return load_vehicle("bolt")


@pytest.fixture(scope="module")
def built(bolt: Vehicle) -> Built:
    return build(bolt)


# --- the Bolt, by hand -------------------------------------------------------------------------------------------


def test_the_bolt_has_the_kerb_mass_of_the_real_car(built: Built) -> None:
    plant, _ = built
    assert plant.CalcTotalMass(plant.CreateDefaultContext()) == pytest.approx(1616.0, abs=1e-9)


def test_the_bolts_dimensions_are_measured_on_its_kinematics(bolt: Vehicle) -> None:
    geometry = bolt.geometry
    assert geometry.wheelbase == pytest.approx(2.601, abs=1e-12)
    assert geometry.front_track == pytest.approx(1.501, abs=1e-12)
    assert geometry.rear_track == pytest.approx(1.501, abs=1e-12)
    assert geometry.kingpin_track == pytest.approx(1.501 - 2 * 0.02, abs=1e-12)
    assert geometry.wheel_radii == pytest.approx((17 * 0.0254 / 2 + 0.5 * 0.215,) * 4, abs=1e-12)
    assert geometry.wheel_widths == pytest.approx((0.215,) * 4, abs=1e-12)
    assert geometry.steering_limit == pytest.approx(0.6, abs=1e-12)
    assert geometry.steering_rate == pytest.approx(0.5, abs=1e-12)


def test_the_bolts_front_axle_carries_56_percent_and_its_centre_of_mass_is_half_a_metre_up(built: Built) -> None:
    plant, _ = built
    p_WC = plant.CalcCenterOfMassPositionInWorld(plant.CreateDefaultContext())
    assert p_WC == pytest.approx([0.56 * WHEELBASE, 0.0, 0.5], abs=1e-9)


def test_the_inertia_of_a_wheel_is_that_of_a_solid_cylinder_about_y(built: Built) -> None:
    plant, _ = built
    context = plant.CreateDefaultContext()
    for name in WHEEL_LINKS:
        inertia = plant.GetBodyByName(name).CalcSpatialInertiaInBodyFrame(context)
        spin = 20.0 * RADIUS**2 / 2
        across = 20.0 * (3 * RADIUS**2 + WIDTH**2) / 12
        assert np.diag(inertia.CalcRotationalInertia().CopyToFullMatrix3()) == pytest.approx([across, spin, across])


def test_the_whole_cars_yaw_inertia_is_near_openpilots_scaling_law(built: Built) -> None:
    plant, _ = built
    instance = plant.GetModelInstanceByName("bolt")
    M_W = plant.CalcSpatialInertia(plant.CreateDefaultContext(), plant.world_frame(), plant.GetBodyIndices(instance))
    yaw = M_W.Shift(M_W.get_com()).CalcRotationalInertia().CopyToFullMatrix3()[2, 2]
    assert yaw == pytest.approx(2500.0 * 1616.0 * WHEELBASE**2 / (1462.0 * 2.70**2), rel=0.01)


def test_every_part_of_the_bolt_obeys_the_triangle_inequality(built: Built) -> None:
    plant, _ = built
    context = plant.CreateDefaultContext()
    for name in PARTS:
        inertia = plant.GetBodyByName(name).CalcSpatialInertiaInBodyFrame(context)
        central = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
        small, middle, large = np.sort(np.linalg.eigvalsh(central.CopyToFullMatrix3()))
        assert small > 0
        assert small + middle >= large


def test_drake_reports_no_warnings_about_the_bolt(bolt: Vehicle) -> None:
    assert bolt.warnings == ()


@pytest.mark.parametrize("contact_model", ["point", "hydroelastic_with_fallback"])
def test_the_bolt_rests_on_its_wheels_alone_and_its_weight_is_shared_as_planned(
    bolt: Vehicle, contact_model: str
) -> None:
    plant, diagram = build(bolt, contact_model=contact_model)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(6.0)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    results = plant.get_contact_results_output_port().Eval(context)
    assert results.num_point_pair_contacts() + results.num_hydroelastic_contacts() == 4
    front = rear = 0.0
    for index in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(index)
        name = plant.get_body(info.bodyA_index()).name()
        front += abs(info.contact_force()[2]) if name.startswith("front") else 0.0
        rear += abs(info.contact_force()[2]) if name.startswith("rear") else 0.0
    for index in range(results.num_hydroelastic_contacts()):
        info = results.hydroelastic_contact_info(index)
        load = abs(info.F_Ac_W().translational()[2])
        ahead = info.contact_surface().centroid()[0] > WHEELBASE / 2
        front, rear = (front + load, rear) if ahead else (front, rear + load)
    weight = 1616.0 * 9.81
    assert front + rear == pytest.approx(weight, rel=2e-3)
    assert front / (front + rear) == pytest.approx(0.56, abs=2e-3)


@pytest.mark.parametrize("angle", [-0.6, 0.0, 0.6])
def test_the_body_leaves_the_wheels_free_at_full_lock_even_without_the_collision_filter(
    bolt: Vehicle, angle: float
) -> None:
    start, end = "<drake:collision_filter_group", "</drake:collision_filter_group>"
    urdf = re.sub(f"{start}.*?{end}", "", bolt.urdf, flags=re.DOTALL)
    assert urdf != bolt.urdf
    plant, diagram = build(bolt, urdf=urdf)
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    for name in bolt.spec.joints.steering.names():
        plant.GetJointByName(name).set_angle(context, angle)
    plant.SetFreeBodyPose(context, plant.GetBodyByName("base_link"), RigidTransform([0.0, 0.0, 1.0]))
    scene_graph = diagram.GetSubsystemByName("scene_graph")
    assert isinstance(scene_graph, SceneGraph)
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(root))
    assert query.ComputePointPairPenetration() == []


@pytest.mark.parametrize(
    ("drive", "front", "rear"),  # effort limits [N m]: 2600 or 1400 for the brake, 2538 split over the driven wheels
    [("front", 2600 + 1269, 1400), ("rear", 2600, 1400 + 1269), ("all", 2600 + 634.5, 1400 + 634.5)],
)
def test_the_argument_drive_moves_the_motors_torque_to_the_driven_wheels(drive: str, front: float, rear: float) -> None:
    vehicle = load_vehicle("bolt", arguments={"drive": drive})
    assert vehicle.spec.drive == drive
    plant, _ = build(vehicle)
    limits = {
        actuator.joint().name(): actuator.effort_limit()
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    }
    wheels = [limits[name] for name in vehicle.spec.joints.wheels.names()]
    assert wheels == pytest.approx([front, front, rear, rear])
    assert len(limits) == 6


def test_a_positive_wheel_speed_rolls_ahead_and_a_positive_steering_angle_turns_left(
    bolt: Vehicle, built: Built
) -> None:
    plant, _ = built
    context = plant.CreateDefaultContext()
    wheel = plant.GetJointByName(bolt.spec.joints.wheels.rear_left)
    wheel.set_angular_rate(context, 1.0)
    # the lowest point of the wheel moves backwards: v = w x r = (0, 1, 0) x (0, 0, -R) = (-R, 0, 0)
    w_WW = plant.EvalBodySpatialVelocityInWorld(context, wheel.child_body()).rotational()
    assert np.cross(w_WW, [0.0, 0.0, -RADIUS]) == pytest.approx([-RADIUS, 0.0, 0.0])
    knuckle = plant.GetJointByName(bolt.spec.joints.steering.left)
    knuckle.set_angle(context, 0.1)
    ahead = knuckle.child_body().EvalPoseInWorld(context).rotation().multiply(np.array([1.0, 0.0, 0.0]))
    assert ahead == pytest.approx([math.cos(0.1), math.sin(0.1), 0.0])


def test_the_front_camera_is_where_the_paper_has_it(built: Built) -> None:
    # the paper: (0.58, 0, 1.695), counted from mid-wheelbase and 0.2845 m below the road
    plant, _ = built
    X_WC = plant.GetFrameByName("front_camera").CalcPoseInWorld(plant.CreateDefaultContext())
    assert X_WC.translation() == pytest.approx([0.58 + 1.3005, 0.0, 1.695 - 0.2845], abs=1e-9)
    assert X_WC.rotation().IsExactlyIdentity()


# --- a folder with a fault ---------------------------------------------------------------------------------------


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the Bolt's folder in the working directory."""
    folder = tmp_path / "bolt"
    shutil.copytree(data_root() / "models" / "bolt", folder)
    monkeypatch.chdir(tmp_path)
    return folder


def replace(file: Path, old: str, new: str) -> int:
    """Replace a text that occurs once; return its line number."""
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times in {file.name}"
    file.write_text(text.replace(old, new), encoding="utf-8")
    return text[: text.index(old)].count("\n") + 1


def message_of(kind: type[MirdrakeError], **arguments: str) -> str:
    with pytest.raises(kind) as caught:
        load_vehicle("bolt", arguments=arguments)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_copy_itself_loads_and_equals_the_original(copy: Path, bolt: Vehicle) -> None:
    vehicle = load_vehicle("bolt")
    assert vehicle.folder == copy
    assert vehicle.urdf == bolt.urdf
    assert vehicle.geometry == bolt.geometry


def test_an_unknown_vehicle_is_rejected_with_the_line_of_the_name() -> None:
    with pytest.raises(
        ConfigError, match=r"^drive\.yaml:3: vehicles\.ego\.model: unknown vehicle 'bollt'; did you mean 'bolt'\?"
    ):
        load_vehicle("bollt", where="drive.yaml:3: vehicles.ego.model")


def test_a_misspelt_xacro_argument_is_rejected(copy: Path) -> None:
    assert message_of(ModelError, driv="rear") == (
        "bolt/main.urdf.xacro: unknown argument 'driv'; did you mean 'drive'? "
        "(allowed: drive, payload, suspension, values)"
    )


def test_a_wrong_value_of_drive_is_rejected(copy: Path) -> None:
    assert (
        message_of(ConfigError, drive="raer")
        == "argument drive: 'raer' is not allowed; did you mean 'rear'? (allowed: all, front, rear)"
    )


def test_broken_xml_is_one_line_with_file_and_line(copy: Path) -> None:
    line = replace(copy / "structure.xacro", '<link name="base_link">', '<link name="base_link"')
    assert message_of(ModelError) == f"bolt/structure.xacro:{line + 1}: not valid XML: not well-formed (invalid token)"


def test_an_include_that_is_not_there_is_named_with_the_line_that_asks_for_it(copy: Path) -> None:
    line = replace(copy / "main.urdf.xacro", 'filename="sensors.xacro"', 'filename="sensor.xacro"')
    assert message_of(ModelError) == f"bolt/main.urdf.xacro:{line}: include: bolt/sensor.xacro: no such file"


def test_a_misspelt_property_is_reported_where_it_is_used(copy: Path) -> None:
    line = replace(copy / "structure.xacro", 'x="0" y="${track / 2}"', 'x="0" y="${trak / 2}"')
    message = message_of(ModelError)
    assert message == f"bolt/structure.xacro:{line - 1}: name 'trak' is not defined in 'trak / 2'"


def test_a_misspelt_macro_is_reported_with_its_line(copy: Path) -> None:
    line = replace(copy / "structure.xacro", "<xacro:body_contact/>", "<xacro:body_contakt/>")
    assert message_of(ModelError) == f"bolt/structure.xacro:{line}: unknown macro name: xacro:body_contakt"


def test_a_macro_with_an_unknown_parameter_is_reported_with_its_line(copy: Path) -> None:
    line = replace(
        copy / "structure.xacro",
        '<xacro:steered_corner name="front_left" side',
        '<xacro:steered_corner name="front_left" sid',
    )
    message = message_of(ModelError)
    assert message.startswith(f"bolt/structure.xacro:{line}: ")
    assert '"sid"' in message


def test_a_ros_package_that_only_ros_finds_is_rejected_with_its_line(copy: Path) -> None:
    line = replace(copy / "main.urdf.xacro", 'filename="sensors.xacro"', 'filename="$(find bolt)/sensors.xacro"')
    message = message_of(ModelError)
    tail = "$(find bolt): ROS packages are not available; give a path relative to this file"
    assert message == f"bolt/main.urdf.xacro:{line}: {tail}"


def test_a_negative_mass_is_rejected_with_link_and_number(copy: Path) -> None:
    replace(copy / "properties.xacro", 'name="wheel_mass" value="20"', 'name="wheel_mass" value="-20"')
    message = message_of(ModelError)
    assert re.fullmatch(
        r"bolt/structure\.xacro:\d+: link 'front_left_wheel': mass -20 kg; it should be above zero "
        r"\(leave <inertial> out for a frame on a fixed joint\)",
        message,
    )


@pytest.mark.parametrize("text", ["nan", "heavy"])
def test_a_mass_that_is_no_number_is_rejected(copy: Path, text: str) -> None:
    replace(
        copy / "properties.xacro",
        '<mass value="${mass}"/>\n      <inertia ixx="${mass',
        f'<mass value="{text}"/>\n      <inertia ixx="${{mass',
    )
    assert "link 'base_link': mass nan kg; it should be above zero" in message_of(ModelError)


def test_the_impossible_inertia_of_the_papers_first_body_is_rejected(copy: Path) -> None:
    # 63, 1048, 1111 on the diagonal, -31 for xz: (63 + 1111) / 2 ∓ sqrt(524² + 31²) = 62.0838 and 1111.9162
    file = copy / "structure.xacro"
    text = file.read_text(encoding="utf-8")
    start = text.index("<xacro:box_inertial")
    end = text.index("/>", start) + 2
    body = (
        '<inertial><mass value="2050"/><inertia ixx="63" iyy="1048" izz="1111" ixy="0" ixz="-31" iyz="0"/></inertial>'
    )
    file.write_text(text[:start] + body + text[end:], encoding="utf-8")
    assert message_of(ModelError) == (
        "bolt/structure.xacro:4: link 'base_link': principal moments of inertia 62.0838, 1048, 1111.92 kg m² break the "
        "triangle inequality (62.0838 + 1048 < 1111.92); no body has them"
    )


def test_a_moving_link_without_mass_is_rejected(copy: Path) -> None:
    line = replace(copy / "sensors.xacro", 'type="fixed"', 'type="continuous"')
    assert message_of(ModelError) == (
        f"bolt/sensors.xacro:{line - 1}: link 'front_camera' moves but has no mass; "
        "give it an <inertial> or a fixed joint"
    )


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (
            "structure",
            'x="0" y="${track / 2}"',
            'x="0" y="nan"',
            "<origin> xyz '0 nan 0.3234' should be 3 finite numbers within ±1000 m",
        ),
        ("structure", '<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "<axis> xyz '0 0 0' has no direction"),
        (
            "contact",
            'z0="1.0" z1',
            'z0="2.0" z1',
            "<box> size '3.1815 1.3 -0.405' should be 3 finite numbers above zero, at most 1000 m",
        ),
        (
            "contact",
            'tyre_stiffness" value="2e5"',
            'tyre_stiffness" value="-1"',
            "<drake:point_contact_stiffness> value '-1' should be a finite number above zero",
        ),
        (
            "properties",
            'steering_rate" value="0.5"',
            'steering_rate" value="-1"',
            "<limit> velocity '-1' should be a finite number not below zero",
        ),
        (
            "properties",
            'steering_limit" value="0.6"',
            'steering_limit" value="-0.6"',
            "<limit> lower 0.6 is above upper -0.6",
        ),
    ],
)
def test_numbers_at_which_drake_would_abort_are_rejected_with_their_line(
    copy: Path, file: str, old: str, new: str, message: str
) -> None:
    replace(copy / f"{file}.xacro", old, new)
    assert re.fullmatch(r"bolt/(structure|contact)\.xacro:\d+: " + re.escape(message), message_of(ModelError))


def test_a_missing_mesh_is_named_with_its_line(copy: Path) -> None:
    line = replace(copy / "structure.xacro", "meshes/body.gltf", "meshes/boddy.gltf")
    missing = copy / "meshes/boddy.gltf"
    assert message_of(ModelError) == (
        f"bolt/structure.xacro:{line}: visual mesh 'meshes/boddy.gltf': no such file: {missing}"
    )


def test_a_mesh_in_an_unknown_package_is_rejected(copy: Path) -> None:
    line = replace(copy / "structure.xacro", "meshes/body.gltf", "package://mirdake/body.gltf")
    assert message_of(ModelError) == (
        f"bolt/structure.xacro:{line}: visual mesh 'package://mirdake/body.gltf': unknown package 'mirdake'; "
        "did you mean 'mirdrake'? (allowed: bolt, mirdrake)"
    )


def test_a_mesh_whose_texture_is_missing_is_rejected(copy: Path) -> None:
    (copy / "body.gltf").write_text('{"images": [{"uri": "paint.png"}]}', encoding="utf-8")
    replace(copy / "structure.xacro", "meshes/body.gltf", "body.gltf")
    message = message_of(ModelError)
    assert message.endswith(f"it needs 'paint.png'; no such file: {copy / 'paint.png'}")


def test_a_relative_mesh_of_a_users_vehicle_anywhere_loads(copy: Path, tmp_path: Path) -> None:
    shutil.copy(data_root() / "models/bolt/meshes/wheel.gltf", copy / "wheel.gltf")
    for buffer in (data_root() / "models/bolt/meshes").glob("wheel*.bin"):
        shutil.copy(buffer, copy)
    replace(copy / "structure.xacro", "meshes/wheel.gltf", "wheel.gltf")
    folder = tmp_path / "my cars" / "bolt & co"
    shutil.move(copy, folder)
    vehicle = load_vehicle(str(folder))
    assert vehicle.name == "bolt & co"
    plant, _ = build(vehicle)
    assert plant.num_actuators() == 6


def test_a_joint_that_does_not_exist_is_rejected_with_a_hint(copy: Path) -> None:
    line = replace(copy / "vehicle.yaml", "rear_left: back_left_wheel_joint", "rear_left: rear_left_wheel_joint")
    message = message_of(ConfigError)
    assert message.startswith(
        f"bolt/vehicle.yaml:{line}: joints.wheels.rear_left: no joint 'rear_left_wheel_joint'; did you mean "
    )


def test_a_joint_with_two_roles_is_rejected(copy: Path) -> None:
    line = replace(copy / "vehicle.yaml", "rear_right: back_right_wheel_joint", "rear_right: back_left_wheel_joint")
    assert message_of(ConfigError) == (
        f"bolt/vehicle.yaml:{line}: joints.wheels.rear_right: joint 'back_left_wheel_joint' "
        "is already joints.wheels.rear_left"
    )


def test_exchanged_wheels_are_found_by_measuring(copy: Path) -> None:
    replace(copy / "vehicle.yaml", "rear_left: back_left_wheel_joint", "rear_left: back_x_wheel_joint")
    replace(copy / "vehicle.yaml", "rear_right: back_right_wheel_joint", "rear_right: back_left_wheel_joint")
    replace(copy / "vehicle.yaml", "back_x_wheel_joint", "back_right_wheel_joint")
    assert message_of(ModelError).endswith(
        "'back_right_wheel_joint' lies to the right of 'back_left_wheel_joint'; exchange them"
    )


def test_a_wheel_without_transmission_is_rejected(copy: Path) -> None:
    replace(copy / "structure.xacro", '<xacro:transmission joint="${joint}"/>', "")
    assert message_of(ModelError).endswith(
        "joint 'front_left_wheel_joint' has no <transmission>, so nothing can move it; add one"
    )


def test_a_steering_joint_without_limit_is_rejected(copy: Path) -> None:
    replace(
        copy / "structure.xacro",
        '"${name}_steering_joint" type="revolute"',
        '"${name}_steering_joint" type="continuous"',
    )
    assert message_of(ModelError).endswith(
        "joint 'front_left_steering_joint' is continuous; as joints.steering.left it should be revolute"
    )


def test_an_effort_limit_of_zero_is_rejected(copy: Path) -> None:
    replace(copy / "properties.xacro", 'name="steering_effort" value="1000"', 'name="steering_effort" value="0"')
    assert message_of(ModelError).endswith(
        "joint 'front_left_steering_joint' has effort limit 0 N m; it should be above zero"
    )


def test_a_drive_that_the_xacro_does_not_follow_is_rejected(copy: Path) -> None:
    replace(copy / "vehicle.yaml", "drive: front", "drive: rear")
    replace(copy / "main.urdf.xacro", 'name="drive" default="front"', 'name="driven" default="front"')
    replace(copy / "properties.xacro", "$(arg drive)", "$(arg driven)")
    assert message_of(ModelError).endswith(
        "joint 'back_left_wheel_joint' is limited to 1400 N m; vehicle.yaml asks for 2669 N m at the rear_left wheel "
        "(drive rear: 1269, brake 1400)"
    )


def test_a_brake_beyond_the_joints_limit_is_rejected(copy: Path) -> None:
    replace(copy / "properties.xacro", "${vehicle.brakes.max_torque}", "1000")
    assert message_of(ModelError).endswith(
        "joint 'front_left_wheel_joint' is limited to 1594 N m; vehicle.yaml asks for 3869 N m at the front_left wheel "
        "(drive front: 1269, brake 2600)"
    )


def test_a_car_that_is_not_symmetric_is_rejected(copy: Path) -> None:
    replace(copy / "structure.xacro", 'x="0" y="${-track / 2}"', 'x="0" y="${-track / 2 - 0.002}"')
    assert message_of(ModelError).endswith(
        "'back_left_wheel_joint' at 0 0.7505 0.3234 m and 'back_right_wheel_joint' at 0 -0.7525 0.3234 m "
        "are not mirror images within 1 mm"
    )


def test_a_wheel_that_would_roll_backwards_is_rejected(copy: Path) -> None:
    replace(copy / "structure.xacro", '<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>')
    assert message_of(ModelError).endswith(
        "wheel joint 'front_left_wheel_joint' turns about 0 -1 0 of 'base_link'; it must be 0 1 0, "
        "so that a positive speed rolls forward"
    )


def test_a_wheel_of_the_wrong_size_for_its_height_is_rejected(copy: Path) -> None:
    replace(copy / "contact.xacro", '<cylinder radius="${wheel_radius}"', '<cylinder radius="0.356"')
    assert message_of(ModelError).endswith(
        "wheel of 'front_left_wheel_joint' has its centre 0.3234 m above 'base_link' but a radius of 0.3560 m; "
        "'base_link' should lie on the road"
    )


def test_a_sensor_on_an_unknown_link_is_rejected_with_a_hint(copy: Path) -> None:
    line = replace(copy / "sensors.yaml", "frame: front_camera", "frame: front_kamera")
    assert message_of(ConfigError).startswith(
        f"bolt/sensors.yaml:{line}: mounts.front_camera.frame: no link 'front_kamera'; did you mean 'front_camera'?"
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gain: 200", "gain: .nan", "wheel_speed.gain: nan is not a finite number"),
        ("gain: 200", "gain: -1", "wheel_speed.gain: -1 is not allowed; it should be greater than 0"),
        ("gain: 200", "gian: 850", "wheel_speed.gian: unknown field; did you mean 'gain'?"),
        ("kp: 1.0", "kp: -0.5", "speed.kp: -0.5 is not allowed; it should be greater than or equal to 0"),
        ("rate: 50", "rate: 0", "rate: 0 is not allowed; it should be greater than 0"),
    ],
)
def test_a_gain_that_is_invalid_is_rejected_with_its_line(copy: Path, old: str, new: str, message: str) -> None:
    line = replace(copy / "control.yaml", old, new)
    with pytest.raises(ConfigError) as caught:
        load_vehicle("bolt")
    assert f"bolt/control.yaml:{line}: {message}" in str(caught.value)


def test_an_unknown_key_in_vehicle_yaml_is_rejected(copy: Path) -> None:
    line = replace(copy / "vehicle.yaml", "grade: B", "grad: B")
    with pytest.raises(ConfigError) as caught:
        load_vehicle("bolt")
    assert f"bolt/vehicle.yaml:{line}: grad: unknown field; did you mean 'grade'?" in str(caught.value)


def test_a_missing_file_of_the_folder_is_named(copy: Path) -> None:
    (copy / "control.yaml").unlink()
    assert message_of(ConfigError) == "bolt/control.yaml: no such file"


def test_warnings_of_drake_are_reported_with_the_source_line(copy: Path) -> None:
    line = replace(copy / "structure.xacro", '<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><dynamics friction="3"/>')
    (warning,) = load_vehicle("bolt").warnings  # once, although left and right have the same fault
    assert warning.startswith(f"bolt/structure.xacro:{line}: A joint has specified a non-zero")


def test_loading_prints_nothing(capfd: pytest.CaptureFixture[str], copy: Path) -> None:
    replace(copy / "structure.xacro", '<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><dynamics friction="3"/>')
    load_vehicle("bolt")
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


def test_a_tighter_software_limit_of_the_steering_wins(copy: Path) -> None:
    replace(copy / "vehicle.yaml", "  ratio: 16.8\n", "  ratio: 16.8\n  limit: 30 deg\n  rate: 20 deg/s\n")
    geometry = load_vehicle("bolt").geometry
    assert geometry.steering_limit == pytest.approx(math.pi / 6)
    assert geometry.steering_rate == pytest.approx(math.pi / 9)


def test_every_element_of_the_expanded_model_knows_its_source_line(bolt: Vehicle) -> None:
    urdf = render_xacro(bolt.folder / "main.urdf.xacro")
    sources = {file.name: file.read_text(encoding="utf-8").split("\n") for file in urdf.files}
    parts = ("main.urdf", "properties", "suspension", "structure", "contact", "sensors")
    assert set(sources) == {f"{part}.xacro" for part in parts}
    checked = 0
    for element in urdf.root.iter("collision"):
        name, line = urdf.where(element).rsplit(":", 1)
        assert "<collision" in sources[Path(name).name][int(line) - 1]
        checked += 1
    assert checked == 4 + 5

"""The report of `mirdrake inspect` on a vehicle, against numbers computed by hand."""

import dataclasses
import json
import math
import re
import shutil
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Capsule

from mirdrake.assembly.drawing import layout_command
from mirdrake.cli import main
from mirdrake.core.paths import data_root
from mirdrake.report import surfaces
from mirdrake.report.inspection import render_inspection
from mirdrake.report.inspection_text import describe, draw_links
from mirdrake.report.surfaces import collect_surfaces
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.inspection import inspect_vehicle
from mirdrake.vehicles.plausibility import find_oddities

BOLT = data_root() / "models" / "bolt"
COM, SHARE, LENGTH = '"com_height" value="0.5"', '"front_axle_share" value="0.56"', '"inertia_length" value="4.0"'

MOMENTS = """iyy="${spin if axis == 'y' else across}" izz="${spin if axis == 'z' else across}\""""


@pytest.fixture(scope="module")
def bolt():
    return inspect_vehicle(load_vehicle("bolt"))


@pytest.fixture
def copy(tmp_path):
    """A Bolt to change: copy(file, old, new) and then its inspection."""
    folder = tmp_path / "bolt"
    shutil.copytree(BOLT, folder)

    def changed(name, old, new):
        path = folder / name
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")
        return inspect_vehicle(load_vehicle(str(folder)))

    return changed


def test_mass_and_axle_loads_are_those_of_the_readme(bolt):
    assert bolt.mass == pytest.approx(1616.0, abs=1e-9)
    # 1616 kg x 9.80665 m/s² = 15847.5 N, of which 0.56 in front.
    assert bolt.loads == pytest.approx((8874.6, 6972.9), abs=0.1)
    assert bolt.com == pytest.approx((0.56 * 2.601, 0.0, 0.5), abs=1e-9)
    assert bolt.side_share == pytest.approx(0.5, abs=1e-12)


def test_the_turning_circle_is_that_of_the_outer_front_wheel(bolt):
    # Inner wheel 0.6 rad about a kingpin 0.7305 m from the middle: the rear axle's centre runs at
    # 2.601 / tan 0.6 + 0.7305 = 4.5324 m; the outer kingpin at sqrt(2.601² + (4.5324 + 0.7305)²), its wheel 0.02 m on.
    assert bolt.turning_radius == pytest.approx(4.5324, abs=1e-4)
    assert bolt.turning_circle == pytest.approx(2.0 * (math.sqrt(2.601**2 + 5.2629**2) + 0.02), abs=1e-3)
    # cot(outer) - cot(inner) = kingpin track / wheelbase
    inner, outer = bolt.steering_limits
    assert 1.0 / math.tan(outer) - 1.0 / math.tan(inner) == pytest.approx(1.461 / 2.601, abs=1e-12)


def test_the_outermost_corner_of_the_body_runs_on_the_circle_between_walls(bolt):
    # Front bumper 2.085 m ahead of mid-wheelbase, 1.765 m wide: its right corner at (3.3855, -0.8825), and the turning
    # centre 4.5324 m to the left of the rear axle's centre: 2 sqrt(3.3855² + 5.4149²) = 12.772 m.
    assert bolt.wall_circle == pytest.approx(2.0 * math.hypot(3.3855, 4.53237 + 0.8825), abs=1e-4)


@pytest.mark.parametrize(
    ("size", "inertia", "exchanged"),
    [
        ((0.932, 0.597, 0.456), (2.144, 2.099, 3.117), False),  # robots whose mass is in a short body
        ((0.912, 0.597, 0.456), (2.144, 1.933, 2.951), False),
        ((1.0, 0.98, 0.3), (2.2, 2.1, 4.0), False),  # nearly square
        ((1.112, 0.650, 0.570), (4.839, 2.034, 5.589), True),  # Unior with x and y exchanged
        ((4.166, 1.765, 1.595), (2374.3, 547.0, 2546.6), True),  # Bolt with x and y exchanged
    ],
)
def test_axes_of_the_inertia_are_exchanged_only_if_a_box_of_the_vehicles_size_fits_better(
    bolt, size, inertia, exchanged
):
    figures = dataclasses.replace(bolt, size=size, inertia=inertia)
    warnings = [warning for warning in find_oddities(figures, load_vehicle("bolt")) if "exchanged?" in warning]
    assert bool(warnings) == exchanged
    if exchanged:
        assert f"the vehicle is {size[0]:.3g} m long and {size[1]:.3g} m wide; are x and y exchanged?" in warnings[0]


def test_inertia_of_the_whole_car_is_the_sum_of_its_parts(bolt):
    assert bolt.inertia == pytest.approx((547.0, 2374.3, 2546.6), abs=0.1)
    a, b = 0.44 * 2.601, 0.56 * 2.601
    assert bolt.dynamic_index == pytest.approx(2546.6 / (1616.0 * a * b), rel=1e-4)
    assert bolt.static_stability == pytest.approx(1.501 / (2.0 * 0.5), rel=1e-9)


def test_a_box_has_the_edges_that_its_inertia_was_made_from(bolt):
    body = next(link for link in bolt.links if link.name == "base_link")
    assert body.edges == pytest.approx((4.0, 1.55, 1.2), abs=1e-9)
    assert body.extent[0] == pytest.approx(4.166, abs=1e-6)


def test_radii_of_gyration_are_roots_of_inertia_over_mass(bolt):
    assert bolt.gyration == pytest.approx((0.5818, 1.2121, 1.2553), abs=1e-4)  # sqrt(547 / 1616) and so on


def test_a_solid_wheel_has_half_the_spin_inertia_of_a_hoop(bolt):
    wheels = [link for link in bolt.links if link.name.endswith("wheel")]
    assert [wheel.spin for wheel in wheels] == pytest.approx([0.5] * 4, abs=1e-9)
    assert not any(wheel.spin_is_smaller for wheel in wheels)
    # A flat disc would have 1: (0.6 + 0.6) / 1.046.
    assert wheels[0].triangle == pytest.approx(2.0 * 0.59994 / 1.04589, abs=1e-3)
    body = next(link for link in bolt.links if link.name == "base_link")
    assert body.spin is None
    assert body.size_ratio == pytest.approx(4.0 / 4.166, abs=1e-6)


def test_actuators_describe_what_they_move(bolt):
    moves = {actuator.joint: (actuator.moves, actuator.effort) for actuator in bolt.actuators}
    assert moves["front_left_wheel_joint"] == ("drives and brakes the front left wheel", pytest.approx(3869.0))
    assert moves["back_right_wheel_joint"] == ("brakes the rear right wheel", pytest.approx(1400.0))
    assert moves["front_right_steering_joint"] == ("steers the right front wheel", pytest.approx(1000.0))


def test_a_camera_sees_as_high_as_its_picture_is_and_a_gps_sees_nothing(bolt):
    sensors = {sensor.name: sensor for sensor in bolt.sensors}
    camera, gps = sensors["front_camera"], sensors["gps"]
    assert camera.across == pytest.approx((-math.radians(40.0), math.radians(40.0)))
    assert camera.upward == pytest.approx(camera.across)  # 800 x 800 pixels
    assert (camera.yaw, camera.pitch, camera.reach) == (0.0, 0.0, (0.1, 300.0))
    assert gps.across == gps.reach == ()


def test_joints_have_roles_and_limits(bolt):
    roles = {joint.name: joint.role_text for joint in bolt.joints}
    assert roles["front_left_wheel_joint"] == "front_left wheel, driven"
    assert roles["back_right_wheel_joint"] == "rear_right wheel"
    assert roles["front_right_steering_joint"] == "right steering"
    steering = next(joint for joint in bolt.joints if joint.name == "front_left_steering_joint")
    assert (steering.lower, steering.upper, steering.velocity, steering.effort) == (-0.6, 0.6, 0.5, 1000.0)
    assert steering.axis == (0.0, 0.0, 1.0)


def test_a_sound_car_gets_no_warning(bolt):
    assert bolt.warnings == ()
    assert describe(bolt).endswith("no warnings")


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        (
            "properties.xacro",
            '"com_height" value="0.5"',
            '"com_height" value="-0.3"',
            "0.300 m below the road",
        ),
        ("properties.xacro", COM, COM.replace("0.5", "0.9"), "tips at 0.83 g sideways"),
        ("properties.xacro", SHARE, SHARE.replace("0.56", "0.9"), "90 % of the weight"),
        (
            "properties.xacro",
            '"front_axle_share" value="0.56"',
            '"front_axle_share" value="1.1"',
            "not between the axles",
        ),
        (
            "properties.xacro",
            '"inertia_length" value="4.0"',
            '"inertia_length" value="8.0"',
            "inertia of a box 8 m long",
        ),
        ("properties.xacro", "mass * radius**2 / 2", "0.6 * mass * radius**2 / 2", "0.30 m R²"),
        # The spin value on z although the joint turns about y: 0.6 kg m² / (20 kg x 0.3234² m²).
        ("properties.xacro", MOMENTS, 'iyy="${across}" izz="${spin}"', "is 0.29 m R²; a disc has 0.5"),
        # Plausible about the axis, but larger about another.
        (
            "properties.xacro",
            MOMENTS,
            'iyy="${0.42 * mass * radius**2}" izz="${0.6 * mass * radius**2}"',
            "are two moments exchanged?",
        ),
        ("contact.xacro", '"tyre_friction" value="0.9"', '"tyre_friction" value="10000"', "friction 10000; tyres"),
        # The floor and the bumpers end 0.1 m within the wheels' circumference.
        (
            "contact.xacro",
            '"${wheel_radius + 0.1}"',
            '"${wheel_radius - 0.1}"',
            "wheel 'rear_left_wheel' sticks 100 mm deep in 'base_link' straight ahead",
        ),
        ("contact.xacro", '"${wheel_radius + 0.1}"', '"${wheel_radius + 0.01}"', "deep in 'base_link' at full lock"),
        ("vehicle.yaml", "  brakes.front_share: ", "  # brakes.front_share: ", "no source for brakes.front_share"),
    ],
)
def test_findings_are_sentences(copy, file, old, new, words):
    assert any(words in warning for warning in copy(file, old, new).warnings)


def test_the_picture_names_every_link_and_every_moving_joint(bolt):
    if layout_command() is None:
        pytest.skip("Graphviz is not installed")
    svg = draw_links(bolt)
    texts = {element.text for element in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")}
    assert {link.name for link in bolt.links} <= texts
    assert {joint.name for joint in bolt.joints if joint.kind != "fixed"} <= texts


def test_the_command_prints_text_or_data_and_writes_files(capsys, tmp_path):
    assert main(["inspect", "bolt"]) == 0
    assert re.search(r"Turning circle +11\.78 m +\(kerb to kerb, diameter\)", capsys.readouterr().out)
    assert main(["inspect", "bolt", "--json", "--out", str(tmp_path / "bolt.json"), "--strict"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "bolt.json").read_text(encoding="utf-8"))
    assert printed["mass"] == pytest.approx(1616.0)


def test_figures_that_are_not_finite_are_null_in_data(bolt):
    free = bolt.to_dict()["joints"][1]
    assert (free["name"], free["lower"], free["upper"]) == ("front_left_wheel_joint", None, None)
    json.dumps(bolt.to_dict(), allow_nan=False)


def test_surfaces_are_as_large_as_the_vehicle(bolt):
    vehicle = load_vehicle("bolt")
    for collision, size in ((True, bolt.size), (False, bolt.visual_size)):
        points = [part.triangles.reshape(-1, 3) for part in collect_surfaces(vehicle, collision=collision)]
        low = [min(part[:, axis].min() for part in points) for axis in range(3)]
        high = [max(part[:, axis].max() for part in points) for axis in range(3)]
        assert high[0] - low[0] == pytest.approx(size[0], abs=1e-3)
        assert high[1] - low[1] == pytest.approx(size[1], abs=1e-3)
        assert high[2] == pytest.approx(size[2], abs=1e-3)


def test_a_mesh_that_is_drawn_as_its_hull_is_reported_once(caplog, monkeypatch):
    """Meshes that Drake can read and our reader cannot are drawn with another shape."""
    vehicle = load_vehicle("bolt")
    monkeypatch.setattr("mirdrake.report.surfaces.trimesh.load", lambda *_, **__: trimesh.Scene())
    surfaces._report_hull.cache_clear()
    collect_surfaces(vehicle)
    lines = [line for line in caplog.messages if "drawings show its convex hull" in line]
    assert lines
    assert len(set(lines)) == len(lines)
    collect_surfaces(vehicle, steering=(0.1, 0.1))
    assert len([line for line in caplog.messages if "convex hull" in line]) == len(lines)
    surfaces._report_hull.cache_clear()


@pytest.fixture(scope="module")
def page(bolt):
    """Return the page of a faulty Bolt whose name needs escaping in HTML."""
    odd = dataclasses.replace(bolt, warnings=("tyres of <rubber> & air",))
    return render_inspection(odd, load_vehicle("bolt"), portrait=False)


def test_the_page_needs_no_other_file_and_no_network(page):
    addresses = re.findall(r"""(?:href|src)\s*=\s*["']([^"']*)["']|url\(([^)]*)\)""", page)
    assert addresses
    assert all(address.startswith(("#", "data:")) for pair in addresses for address in pair if address)
    outside = set(re.findall(r"https?://[^\s\"'<]+", page))
    assert outside <= {"http://www.w3.org/2000/svg"}


def test_the_page_has_the_figures_and_the_warnings(page):
    assert "tyres of &lt;rubber&gt; &amp; air" in page
    assert "<rubber>" not in page
    assert "1 finding<" in page
    for words in ("11.78 m", "12.77 m", "front 8875 N", "wheelbase 2.601 m", "80° × 80°, 0.1 to 300 m"):
        assert words in page


def test_the_drawings_are_whole_svg_with_a_picture_in_the_first_two(page):
    sheets = re.findall(r'<svg class="sheet".*?</svg>', page, flags=re.DOTALL)
    assert len(sheets) == 3
    for sheet in sheets:
        images = list(ElementTree.fromstring(sheet).iter("{http://www.w3.org/2000/svg}image"))
        assert len(images) == 1
        assert images[0].get("href", "").startswith("data:image/png;base64,")


def test_a_page_without_graphviz_and_without_shapes_names_what_to_install(bolt, monkeypatch):
    monkeypatch.setattr("mirdrake.assembly.drawing.layout_command", lambda: None)
    monkeypatch.setattr("mirdrake.report.inspection.collect_surfaces", lambda *_, **__: [])
    assert "mirdrake[drawing]" in render_inspection(bolt, load_vehicle("bolt"), portrait=False)


def test_the_command_rejects_unsupported_requests(capsys, tmp_path):
    assert main(["inspect", "blot"]) == 2
    assert "did you mean 'bolt'?" in capsys.readouterr().err
    assert main(["inspect", "bolt", "--out", str(tmp_path / "bolt.pdf")]) == 2
    assert "must end in .html, .svg, .dot or .json" in capsys.readouterr().err


def test_a_capsule_is_drawn_around_its_origin():
    mesh = surfaces._primitive(Capsule(0.1, 1.0))
    assert mesh is not None
    assert mesh.bounds == pytest.approx(np.array([[-0.1, -0.1, -0.6], [0.1, 0.1, 0.6]]), abs=1e-3)

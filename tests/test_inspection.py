"""What `mirdrake inspect` says of a vehicle, against numbers worked by hand."""

import json
import math
import shutil
from xml.etree import ElementTree

import pytest

from mirdrake.cli import main
from mirdrake.paths import data_root
from mirdrake.report.inspection import describe, draw_links
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.inspection import inspect_vehicle

BOLT = data_root() / "models" / "bolt"
COM, SHARE, LENGTH = '"com_height" value="0.5"', '"front_axle_share" value="0.56"', '"inertia_length" value="4.0"'


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


def test_inertia_of_the_whole_car_is_the_sum_of_its_parts(bolt):
    assert bolt.inertia == pytest.approx((547.0, 2374.3, 2546.6), abs=0.1)
    a, b = 0.44 * 2.601, 0.56 * 2.601
    assert bolt.dynamic_index == pytest.approx(2546.6 / (1616.0 * a * b), rel=1e-4)
    assert bolt.static_stability == pytest.approx(1.501 / (2.0 * 0.5), rel=1e-9)


def test_a_box_has_the_edges_that_its_inertia_was_made_from(bolt):
    body = next(link for link in bolt.links if link.name == "base_link")
    assert body.edges == pytest.approx((4.0, 1.55, 1.2), abs=1e-9)
    assert body.extent[0] == pytest.approx(4.166, abs=1e-6)


def test_joints_say_what_they_are_for(bolt):
    roles = {joint.name: joint.role for joint in bolt.joints}
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
        ("vehicle.yaml", "  brakes.front_share: ", "  # brakes.front_share: ", "no source for brakes.front_share"),
    ],
)
def test_what_looks_wrong_is_told_in_words(copy, file, old, new, words):
    assert any(words in warning for warning in copy(file, old, new).warnings)


def test_the_picture_names_every_link_and_every_moving_joint(bolt):
    if shutil.which("dot") is None:
        pytest.skip("Graphviz is not installed")
    svg = draw_links(bolt)
    texts = {element.text for element in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")}
    assert {link.name for link in bolt.links} <= texts
    assert {joint.name for joint in bolt.joints if joint.kind != "fixed"} <= texts


def test_the_command_prints_text_or_data_and_writes_files(capsys, tmp_path):
    assert main(["inspect", "bolt"]) == 0
    assert "turning circle         11.78 m (kerb to kerb, diameter)" in capsys.readouterr().out
    assert main(["inspect", "bolt", "--json", "--out", str(tmp_path / "bolt.json"), "--strict"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "bolt.json").read_text(encoding="utf-8"))
    assert printed["mass"] == pytest.approx(1616.0)


def test_the_command_refuses_what_it_cannot_do(capsys, tmp_path):
    assert main(["inspect", "blot"]) == 2
    assert "did you mean 'bolt'?" in capsys.readouterr().err
    assert main(["inspect", "bolt", "--out", str(tmp_path / "bolt.pdf")]) == 2
    assert "must end in .svg, .dot or .json" in capsys.readouterr().err

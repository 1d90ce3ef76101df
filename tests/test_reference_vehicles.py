"""The reference vehicles against published figures, entered by hand with their sources; and their variants.

Static figures are measured on the expanded model: mass and centre of mass with Drake's own, dimensions on the joints.
Turning circles are those of the middle of the outer front wheel, kerb to kerb; half a tyre's width is left out.
"""

import functools
import re
from dataclasses import dataclass

import numpy as np
import pytest
import trimesh

from mirdrake.assembly.diagram import assemble
from mirdrake.core.paths import data_root
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle, variants
from mirdrake.vehicles.inspection import inspect_vehicle
from mirdrake.vehicles.joint_control import SteeringPid, WheelPid

GRAVITY = 9.80665
INCH, FOOT, POUND = 0.0254, 0.3048, 0.45359237


@dataclass(frozen=True)
class Published:
    """Figures [kg, m, -] of a car; None where nobody has published one."""

    mass: float
    wheelbase: float | None
    tracks: tuple[float, float]
    front_share: float
    turning_circle: float | None = None
    turning_radius: float | None = None
    length: float | None = None


PUBLISHED = {
    # Mass 3563 lb and wheelbase 102.4 in: Wikipedia, maker's figures. Track: the authors' properties.md.
    # Front share: README 3, assumed; nobody has published one.
    "bolt": Published(3563 * POUND, 102.4 * INCH, (1.501, 1.501), 0.56, length=4.166),
    # Kerb mass 3794 lb, wheelbase 103.1 in, length 174.7 in: road tests of the 2008 Escape Hybrid AWD. Tracks 61.3 and
    # 60.9 in: data of the 2005 Escape, whose chassis the 2008 one kept. Turning circle 36.7 ft: README 6, not verified.
    # Front share: README 3, assumed.
    "catvehicle": Published(
        3794 * POUND, 103.1 * INCH, (61.3 * INCH, 60.9 * INCH), 0.57, turning_circle=36.7 * FOOT, length=174.7 * INCH
    ),
    # Mass 3828 lb, wheelbase 112.2 in and track 62.3 in: Dataspeed's drive-by-wire stack. Smallest turning radius
    # 5.05386 m and length 4.933 m: Apollo, modules/calibration/data/mkz_example/vehicle_param.pb.txt.
    # Front share: README 3, assumed.
    "mkz": Published(3828 * POUND, 112.2 * INCH, (62.3 * INCH,) * 2, 0.60, turning_radius=5.05386147161, length=4.933),
    # Mass and length: the Unior paper, which gives neither wheelbase nor track; the track is its width less a tyre's.
    "unior": Published(43.5, None, (0.65 - 0.11,) * 2, 0.50, length=1.112),
}
ROOT = data_root() / "models"
CARS = [name for name in PUBLISHED if (ROOT / name / "vehicle.yaml").is_file()]
FILES = (
    "README.md", "main.urdf.xacro", "properties.xacro", "structure.xacro", "contact.xacro", "sensors.xacro",
    "vehicle.yaml", "control.yaml", "sensors.yaml", "meshes/body.gltf", "meshes/wheel.gltf",
)  # fmt: skip


@functools.cache
def figures(name):
    return inspect_vehicle(load_vehicle(name))


def run(model, *, speed, duration, start=0.0, control=None, contact="point"):
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": model, "speed": start}},
        "control": {"ego": control or {"kind": "constant", "speed": speed}},
        "plant": {"contact": contact},
    }
    return Simulation(assemble(spec)).run(duration=duration)


def bend(model):
    """Return the signals of a curve that would need 1.8 g, at 14 m/s."""
    rows = [{"time": t, "speed": 14.0, "steering": angle} for t, angle in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.25))]
    return run(model, speed=14.0, duration=4.0, start=14.0, control={"kind": "schedule", "rows": rows})


# --- the real cars -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CARS)
def test_its_mass_is_the_published_one(name):
    assert figures(name).mass == pytest.approx(PUBLISHED[name].mass, rel=0.01)


@pytest.mark.parametrize("name", CARS)
def test_its_wheelbase_and_tracks_are_the_published_ones(name):
    published = PUBLISHED[name]
    if published.wheelbase is not None:
        assert figures(name).wheelbase == pytest.approx(published.wheelbase, rel=0.01)
    assert figures(name).tracks == pytest.approx(published.tracks, rel=0.01)


@pytest.mark.parametrize("name", CARS)
def test_axle_loads_follow_from_mass_and_front_share(name):
    published = PUBLISHED[name]
    weight = published.mass * GRAVITY
    loads = (weight * published.front_share, weight * (1.0 - published.front_share))
    assert figures(name).loads == pytest.approx(loads, rel=0.01)
    assert figures(name).side_share == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(
    "name", [name for name in CARS if PUBLISHED[name].turning_circle or PUBLISHED[name].turning_radius]
)
def test_it_turns_within_the_published_circle(name):
    published = PUBLISHED[name]
    if published.turning_circle is not None:  # kerb to kerb
        assert figures(name).turning_circle == pytest.approx(published.turning_circle, rel=0.01)
    if published.turning_radius is not None:  # of the middle of the rear axle
        assert figures(name).turning_radius == pytest.approx(published.turning_radius, rel=0.01)


@pytest.mark.parametrize("name", CARS)
def test_it_is_as_long_as_published_and_its_centre_of_mass_is_between_the_wheels(name):
    vehicle_figures = figures(name)
    assert vehicle_figures.size[0] == pytest.approx(PUBLISHED[name].length, rel=0.01)
    assert (
        0.35 * vehicle_figures.size[2] < vehicle_figures.com[2] < 0.40 * vehicle_figures.size[2] or name == "bolt"
    )  # the Bolt's battery is low
    assert 0.8 < vehicle_figures.dynamic_index < 1.1


@pytest.mark.parametrize("name", CARS)
def test_the_vehicle_has_no_warnings(name):
    assert figures(name).warnings == ()


# --- the folders -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CARS)
def test_its_folder_is_complete(name):
    assert [file for file in FILES if not (ROOT / name / file).is_file()] == []
    text = (ROOT / name / "README.md").read_text(encoding="utf-8")
    for words in ("Grade", "Licence", "Frame `base_link`", "## Derivation"):
        assert words in text
    sections = [int(number) for number in re.findall(r"^\*\*(\d+) ", text, flags=re.MULTILINE)]
    assert sections == list(range(1, len(sections) + 1))
    assert len(sections) >= 7


@pytest.mark.parametrize("name", CARS)
def test_every_number_of_its_yaml_has_a_source(name):
    spec = load_vehicle(name).spec
    assert spec.numbers_without_source() == []
    assert spec.sources_without_number() == []
    assert spec.grade in (ROOT / name / "README.md").read_text(encoding="utf-8").split("Grade **")[1][:1]


@pytest.mark.parametrize("name", CARS)
def test_its_readme_names_every_variant(name):
    text = (ROOT / name / "README.md").read_text(encoding="utf-8")
    assert [variant for variant in variants(ROOT / name) if f"@{variant}" not in text] == []


# --- the variants ------------------------------------------------------------------------------------------------


def test_the_published_bolt_weighs_1622_kg_with_its_centre_of_mass_four_fifths_of_a_metre_up():
    vehicle_figures = figures("bolt@published")
    assert vehicle_figures.mass == pytest.approx(1562 + 4 * 10 + 2 * 10, abs=1e-9)
    body = next(link for link in vehicle_figures.links if link.name == "base_link")
    assert body.com == pytest.approx((1.3, 0.0, 1.1159 - (0.608 - 0.3235)), abs=1e-9)
    # 566, 1880, 2045 and 48 for xz: (566 + 2045) / 2 -+ sqrt(739.5² + 48²)
    assert body.moments == pytest.approx((564.444, 1880.0, 2046.556), abs=1e-3)
    assert vehicle_figures.tracks == pytest.approx((2 * (0.655 + 0.1125), 2 * 0.765), abs=1e-9)
    assert vehicle_figures.kingpin_track == pytest.approx(1.31, abs=1e-9)
    assert vehicle_figures.static_stability < 1.0  # it tips before it slides


def test_the_published_bolt_runs_nine_percent_slow():
    # its controller has wheels of 0.356 m, the model of 0.3235 m: 0.3235 / 0.356 = 0.909
    moved = run("bolt@published", speed=5.0, duration=6.0)
    assert moved["ego.vx"].loc[4.0:].mean() / 5.0 == pytest.approx(0.3235 / 0.356, rel=0.005)


def test_the_published_bolt_lifts_its_inner_wheels_where_the_real_one_slides():
    # half a track over the height: 0.94 against a friction of 1.8; 1.50 against 0.9. A left bend.
    moved = {name: bend(name) for name in ("bolt@published", "bolt")}
    front, rear = "ego.wheel_load.front_left", "ego.wheel_load.rear_left"
    loads = {name: (signals[front] + signals[rear]).loc[0.5:] for name, signals in moved.items()}
    in_the_air = {name: (load == 0.0).mean() for name, load in loads.items()}
    assert in_the_air["bolt@published"] > 0.3
    assert moved["bolt@published"]["ego.roll"].abs().max() > 0.08
    assert in_the_air["bolt"] == 0.0
    assert moved["bolt"]["ego.roll"].abs().max() < 0.05


def test_the_published_cat_vehicle_rolls_into_the_bend():
    roll = {name: bend(name)["ego.roll"].loc[2.0:].mean() for name in ("catvehicle", "catvehicle@published")}
    assert roll["catvehicle"] > 0.01  # outwards: to the right in a left bend
    assert roll["catvehicle@published"] < 0.0


def test_the_published_cat_vehicle_hides_its_load_transfer():
    vehicle_figures = figures("catvehicle@published")
    assert vehicle_figures.mass == pytest.approx(1885.239, abs=1e-6)
    body = next(link for link in vehicle_figures.links if link.name == "base_link")
    assert body.com[2] == pytest.approx(-0.0256 - (0.66 - 0.3671951254), abs=1e-9)  # a third of a metre below the road
    assert vehicle_figures.com[2] < -0.2
    assert vehicle_figures.wheelbase == pytest.approx(2.60, abs=1e-9)
    wheel = load_vehicle("catvehicle@published").control.assumed.wheel_radius
    assert wheel == pytest.approx(1.0 / 2.6101, rel=1e-5)


def test_the_published_cat_vehicle_runs_four_percent_slow():
    # 2.6101 instead of 1 / 0.3672 = 2.723
    moved = run("catvehicle@published", speed=5.0, duration=9.0)
    assert moved["ego.vx"].loc[7.0:].mean() / 5.0 == pytest.approx(2.6101 * 0.3671951254, rel=0.005)


def test_the_cat_vehicle_in_pounds_weighs_more_than_twice_the_real_car():
    vehicle_figures = figures("catvehicle@published_pounds")
    assert vehicle_figures.mass == pytest.approx(3755 + 4 * 100 + 2 * 50 + 2, abs=1e-9)
    assert vehicle_figures.mass > 2.0 * figures("catvehicle").mass
    ratios = [
        heavy.moments[i] / light.moments[i]
        for heavy, light in zip(vehicle_figures.links, figures("catvehicle@published").links, strict=True)
        for i in range(3)
        if heavy.name == "base_link"
    ]
    assert ratios == pytest.approx([1.0 / POUND] * 3, rel=1e-4)  # both mass and inertia, 2.2046 times


def test_the_explorer_has_its_published_mass_wheelbase_length_and_track():
    # 4695 lb: road test of the 4WD; 112.6 in, 197.1 in: Car and Driver, December 2010; track 67 in: dealers' data
    vehicle_figures = figures("catvehicle@explorer")
    assert vehicle_figures.mass == pytest.approx(4695 * POUND, rel=0.01)
    assert vehicle_figures.wheelbase == pytest.approx(112.6 * INCH, rel=0.01)
    assert vehicle_figures.size[0] == pytest.approx(197.1 * INCH, rel=0.01)
    assert vehicle_figures.tracks == pytest.approx((67 * INCH,) * 2, rel=0.01)
    assert vehicle_figures.warnings == ()


def test_the_published_mkz_has_a_third_of_the_yaw_inertia():
    vehicle_figures, real = figures("mkz@published"), figures("mkz")
    assert vehicle_figures.mass == pytest.approx(1542.0, abs=1e-9)
    body = next(link for link in vehicle_figures.links if link.name == "base_link")
    assert body.moments == pytest.approx((1000.0,) * 3, abs=1e-9)
    assert body.com == pytest.approx((1.4225, 0.0, 0.25 + 0.33), abs=1e-9)
    assert vehicle_figures.inertia[2] == pytest.approx(real.inertia[2] / 3.0, rel=0.1)
    assert vehicle_figures.drive == "rear"


def test_the_published_mkz_is_not_slowed_by_its_limit_of_22_rad_per_s():
    # 22 rad/s x 0.33 m = 7.26 m/s: Drake takes a joint's speed limit as a note, not as a stop
    moved = run("mkz@published", speed=9.0, duration=6.0)
    assert moved["ego.vx"].iloc[-1] == pytest.approx(9.0, rel=0.01)


@pytest.mark.parametrize("name", ["unior", "unior@published", "unior@printed_steering"])
def test_size_and_mass_of_the_unior_are_those_of_the_paper(name):
    vehicle_figures = figures(name)
    assert vehicle_figures.mass == pytest.approx(43.5, rel=0.01)
    for size in (vehicle_figures.size, vehicle_figures.visual_size):
        assert size == pytest.approx((1.112, 0.65, 0.57), rel=0.01)
    wheel = load_vehicle(name).geometry
    assert (wheel.front_wheel_radius, wheel.rear_wheel_radius) == pytest.approx((0.13, 0.13), abs=1e-9)
    assert (wheel.front_wheel_width, wheel.rear_wheel_width) == pytest.approx((0.11, 0.11), abs=1e-9)


def test_the_sensors_of_the_unior_are_drawn_at_their_frames():
    mesh = trimesh.load(ROOT / "unior" / "meshes" / "body.gltf").to_geometry().vertices  # y up
    vertices = np.stack([mesh[:, 0], -mesh[:, 2], mesh[:, 1]], axis=1)
    places = {sensor.name: sensor.place for sensor in figures("unior").sensors}
    for name in ("kinect", "gps", "front_sonar", "rear_sonar"):  # frames on the surface
        assert np.linalg.norm(vertices - places[name], axis=1).min() < 0.06
    x, y, z = places["hokuyo"]  # a frame inside: the head of 2 x 0.026 m goes around it, and nothing is in its plane
    around = np.hypot(vertices[:, 0] - x, vertices[:, 1] - y)
    level = np.abs(vertices[:, 2] - z) < 0.008
    assert around[np.abs(vertices[:, 2] - z) < 0.03].min() < 0.03
    behind = np.arctan2(vertices[:, 1] - y, vertices[:, 0] - x)
    assert not (level & (around > 0.03) & (np.abs(behind) < np.deg2rad(120))).any()


def test_the_published_unior_is_a_cuboid_with_the_copied_gains():
    body = next(link for link in figures("unior@published").links if link.name == "base_link")
    lx, ly, lz = 1.112, 0.65, 0.57
    mass = 43.5 - 4 * 0.9 - 2 * 0.45
    cuboid = [mass * (ly**2 + lz**2) / 12, mass * (lx**2 + lz**2) / 12, mass * (lx**2 + ly**2) / 12]
    assert body.moments == pytest.approx(cuboid, rel=1e-9)
    vehicle = load_vehicle("unior@published")
    assert vehicle.spec.steering.law == "unior_printed"
    assert vehicle.control.wheel_speed == WheelPid(kind="pid", kp=100, ki=0.01, kd=10)
    assert vehicle.control.steering == SteeringPid(kind="pid", kp=100, ki=0.01, kd=10)


def test_the_published_unior_does_not_move():
    # a derivative of 10 N m s² on wheels of 0.008 kg m²: the torque jumps between its limits, and the wheels slide. A
    # sampled derivative is stable below the inertia only, and on tyres that is the inertia of the wheel at first, not
    # the 0.37 kg m² of robot and wheel
    moved = run("unior@published", speed=2.0, duration=8.0).signals.loc[5.0:]
    assert abs(moved["ego.vx"].mean()) < 0.1
    limit = load_vehicle("unior").spec.powertrain.max_torque / 2.0
    assert (moved["ego.wheel_torque.rear_left"].abs() > 0.99 * limit).mean() > 0.8


def test_the_printed_steering_of_the_unior_turns_the_outer_wheel_more_and_so_runs_wide():
    # in hydroelastic contact, whose discrete steps damp the heave; on the springs of the others the robot hops, as its
    # front wheels scrub at the friction limit (see the next test)
    control = {"kind": "constant", "speed": 1.4, "steering": 0.4}
    moved = run("unior@printed_steering", speed=1.4, duration=8.0, control=control, contact="hydroelastic")
    moved = moved.signals.loc[5.0:]
    left, right = (moved[f"ego.steering_angle.{side}"].mean() for side in ("left", "right"))
    assert left == pytest.approx(0.5 * 0.4, rel=0.01)
    geometry = load_vehicle("unior").geometry
    ratio = geometry.kingpin_track / geometry.wheelbase
    assert 1.0 / np.tan(right) == pytest.approx(1.0 / np.tan(left) - ratio, rel=0.01)
    ideal = geometry.wheelbase / np.tan(left) - geometry.kingpin_track / 2.0  # the larger angle inside
    radius = moved["ego.vx"].mean() / moved["ego.wz"].mean()
    assert 1.10 < radius / ideal < 1.20
    assert moved["ego.vx"].mean() == pytest.approx(1.4, rel=0.005)


@pytest.mark.parametrize(("contact", "step"), [("hydroelastic", 0.005), ("point", 0.005), ("tyre", 0.0025)])
def test_its_scrubbing_front_wheels_do_not_make_the_robot_hop(contact, step):
    # friction is proportional to the load and pitches the robot, which changes the load: with less than 14 % of
    # critical damping of heave this oscillation would grow until wheels lift off
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "unior@printed_steering"}},
        "control": {"ego": {"kind": "constant", "speed": 1.4, "steering": 0.4}},
        "plant": {"contact": contact, "time_step": step},
    }
    moved = Simulation(assemble(spec)).run(duration=6.0).signals.loc[4.0:]
    assert moved["ego.z"].std() < 2e-5
    assert moved["ego.wz"].std() < 0.005


def test_every_variant_has_a_one_line_description_and_sources_its_numbers():
    for name in CARS:
        for variant, path in variants(ROOT / name).items():
            vehicle = load_vehicle(f"{name}@{variant}")
            assert vehicle.spec.numbers_without_source() == [], path
            assert vehicle.warnings == ()
            assert np.isfinite(figures(f"{name}@{variant}").mass)

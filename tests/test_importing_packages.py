"""Packages with the faults of real ones are imported as cars that drive, or rejected with a reason."""

from collections.abc import Callable
from math import tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ModelError
from mirdrake.importing.vehicles import ImportResult, import_vehicle
from mirdrake.plant.plant import make_plant, set_start
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world
from tests import trap_packages as traps
from tests.marks import mostly_slow
from tests.mesh_rigs import add_eye

CAR, GOLF, RACER = traps.Car(), traps.GOLF, traps.RACER
SPEED = 2.0  # m/s, of all drives
STEERING = 0.2  # rad

GOOD: dict[str, tuple[Callable[[Path], Path], traps.Car, dict[str, Any]]] = {
    "city_car": (traps.city_car, CAR, {}),
    "mini_racer": (traps.mini_racer, RACER, {"arguments": {"racer_version": "v2"}}),
    "golf_cart": (traps.golf_cart, GOLF, {}),
    "loose_limits": (traps.loose_limits, CAR, {}),
    "ball_wheels": (traps.ball_wheels, CAR, {}),
    "shocks": (traps.shocks, CAR, {}),
    "uneven_steering": (traps.uneven_steering, CAR, {}),
    "wheels_in_the_box": (traps.wheels_in_the_box, CAR, {}),
    "lost_pictures": (traps.lost_pictures, CAR, {}),
    "sdf_cart": (traps.sdf_cart, GOLF, {}),
    "universal": (lambda folder: traps.two_axis_joints(folder, "universal"), CAR, {}),
    "revolute2": (lambda folder: traps.two_axis_joints(folder, "revolute2"), CAR, {}),
    "odd_words": (traps.odd_words, CAR, {}),
    "lost_picture": (lambda folder: traps.lost_meshes(folder, how="missing"), CAR, {}),
}

BAD = {
    "skid_steer": (traps.skid_steer, "steer"),
    "tricycle": (traps.tricycle, "wheel"),
    "six_wheeler": (traps.six_wheeler, "wheel"),
    "arm": (traps.arm, "wheel"),
    "drone": (traps.drone, "wheel"),
    "missing_include": (traps.missing_include, "sensors_nobody_has"),
    "argument_without_value": (traps.mini_racer, "racer_version"),
    "lost_wheels": (traps.lost_wheels, "wheel"),
}

_imported: dict[str, tuple[ImportResult | Exception, traps.Car]] = {}


@pytest.fixture
def imported(request, tmp_path_factory):
    """The result of an import, done once for all tests that ask."""
    name = request.param
    if name not in _imported:
        write, car, options = GOOD[name]
        root = tmp_path_factory.mktemp(name)
        result: ImportResult | Exception
        try:
            result = import_vehicle(write(root / "source"), name=name, folder=root / "models", **options)
        except Exception as error:  # the tests fail one by one with it
            result = error
        _imported[name] = (result, car)
    result, car = _imported[name]
    if isinstance(result, Exception):
        raise result
    return result, car


every_good_one = pytest.mark.parametrize("imported", GOOD, indirect=True)
some_good_ones = pytest.mark.parametrize("imported", mostly_slow(GOOD, fast=5), indirect=True)


@every_good_one
def test_it_loads_again_from_its_folder_with_the_dimensions_of_its_source(imported):
    result, car = imported
    geometry = load_vehicle(str(result.folder)).geometry
    assert geometry.wheelbase == pytest.approx(car.wheelbase, rel=1e-3)
    assert geometry.front_track == pytest.approx(car.track, rel=1e-3)
    assert geometry.rear_track == pytest.approx(car.track, rel=1e-3)
    assert geometry.front_wheel_radius == pytest.approx(car.radius, rel=0.01)
    assert geometry.rear_wheel_radius == pytest.approx(car.radius, rel=0.01)
    assert geometry.steering_limit == pytest.approx(car.limit, rel=0.05)


@some_good_ones
def test_it_holds_still_drives_ten_metres_straight_and_circles_to_both_sides(imported):
    result, car = imported
    rows = [
        {"time": 0.0, "speed": 0.0}, {"time": 3.0, "speed": 0.0}, {"time": 4.0, "speed": SPEED},
        {"time": 8.5, "speed": SPEED}, {"time": 9.0, "speed": SPEED, "steering": STEERING},
        {"time": 12.0, "speed": SPEED, "steering": STEERING}, {"time": 13.0, "speed": SPEED, "steering": -STEERING},
        {"time": 16.0, "speed": SPEED, "steering": -STEERING},
    ]  # fmt: skip
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": str(result.folder)}},
        "control": {"ego": {"kind": "schedule", "rows": rows}},
        "plant": {"contact": "point"},
    }
    signals = Simulation(assemble(spec)).run(duration=16.0).signals
    resting = signals.loc[2.8:2.99]
    assert np.abs(resting[["ego.vx", "ego.vy", "ego.vz"]].to_numpy()).max() < 1e-3
    straight = signals.loc[8.4:8.5].iloc[-1] - resting.iloc[0]
    assert straight["ego.x"] == pytest.approx(10.0, abs=0.5)  # 1 m while it gains speed, then 9 m
    assert abs(straight["ego.y"]) < 0.05
    ideal = SPEED * tan(STEERING) / car.wheelbase
    left, right = signals.loc[10.5:12.0]["ego.wz"].mean(), signals.loc[14.5:16.0]["ego.wz"].mean()
    assert left == pytest.approx(ideal, rel=0.04)
    assert right == pytest.approx(-left, rel=0.01)


@some_good_ones
def test_a_camera_beside_it_sees_it(imported):
    result, car = imported
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": load_vehicle(str(result.folder))})
    eye = car.wheelbase * np.array([1.6, -1.4, 0.9])
    take = add_eye(builder, parts.plant, parts.scene_graph, eye, (0.5 * car.wheelbase, 0.0, car.radius))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant = parts.plant.GetMyMutableContextFromRoot(context)
    set_start(parts.plant, plant, parts.vehicles["ego"], x=0.0, y=0.0, yaw=0.0)
    picture = take(context)
    set_start(parts.plant, plant, parts.vehicles["ego"], x=-1000.0, y=0.0, yaw=0.0)
    changed = np.abs(picture - take(context)).max(axis=2) > 8
    assert 0.05 < changed.mean() < 0.7
    assert len(np.unique(picture[changed].reshape(-1, 3), axis=0)) > 10  # shaded, not one flat patch


@pytest.mark.parametrize("name", BAD)
def test_other_vehicles_and_unreadable_files_are_rejected_in_one_line_and_nothing_is_written(name, tmp_path):
    write, word = BAD[name]
    main = write(tmp_path / "source")
    (tmp_path / "models").mkdir()
    before = traps.names_below(tmp_path)
    with pytest.raises(ModelError, match=word) as caught:
        import_vehicle(main, name="new", folder=tmp_path / "models")
    assert "\n" not in str(caught.value)
    assert traps.names_below(tmp_path) == before


@pytest.mark.parametrize(("how", "words"), [("missing", ""), ("archive", "tar.gz"), ("pointer", "git lfs")])
def test_a_missing_picture_is_left_out_with_the_reason(how, words, tmp_path):
    main = traps.lost_meshes(tmp_path / "source", how=how)
    result = import_vehicle(main, name="new", folder=tmp_path / "models")
    lines = [f"{change.part} {change.old} {change.new_text} {change.reason}" for change in result.changes]
    about = [line for line in lines if "body.dae" in line]
    assert about
    assert any(words.lower() in line.lower() for line in about)


@pytest.mark.parametrize("imported", ["city_car"], indirect=True)
def test_textures_and_paint_of_the_source_are_in_the_folder(imported):
    result, _ = imported
    names = [path.suffix for path in (result.folder / "meshes").iterdir()]
    assert ".gltf" in names
    assert ".png" in names
    assert ".dae" not in names


@pytest.mark.parametrize("imported", ["shocks"], indirect=True)
def test_springs_of_the_source_are_those_of_the_vehicle(imported):
    springs = imported[0].vehicle.spec.suspension
    assert (springs.front.stiffness, springs.rear.damping) == (30000.0, 2500.0)
    assert imported[0].vehicle.spec.joints.suspension.front_left == "front_left_shock"
    assert min(imported[0].vehicle.spring_loads) > 0.0


@pytest.mark.parametrize("imported", ["loose_limits", "shocks", "uneven_steering", "ball_wheels"], indirect=True)
def test_the_report_lists_every_repair_with_its_place(imported):
    result, _ = imported
    assert result.changes
    assert all(change.part and change.reason for change in result.changes)
    assert any("car.urdf:" in change.place for change in result.changes)


def test_the_same_package_gives_the_same_bytes(tmp_path):
    main = traps.golf_cart(tmp_path / "source")
    first, second = (import_vehicle(main, name="new", folder=tmp_path / turn).folder for turn in "ab")
    files = [path.relative_to(first) for path in sorted(first.rglob("*")) if path.is_file()]
    assert files == [path.relative_to(second) for path in sorted(second.rglob("*")) if path.is_file()]
    for name in files:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


@pytest.mark.parametrize("imported", ["odd_words"], indirect=True)
def test_elements_of_other_dialects_are_read_or_reported(imported):
    result, car = imported
    expected = {change.part: f"{change.old} -> {change.new_text}: {change.reason}" for change in result.changes}
    vehicle = result.vehicle
    assert vehicle.spec.drive == "front"
    assert (result.folder / "vehicle.yaml").read_text().count("torques of the plugin")
    properties = (result.folder / "properties.xacro").read_text()
    assert 'name="front_friction" value="0.8"' in properties
    assert 'name="rear_friction" value="0.7"' in properties
    assert expected["<mesh> scale"].startswith("1 1 1 1 -> 1 1 1")
    assert f"±{car.limit:g} rad" in expected["joint 'front_left_steer_joint': limits"]
    assert "suspension" not in expected["joint 'pedal_joint'"]
    assert "front_torque 800" in expected["plugin 'hybrid'"]
    assert expected["link 'plate': material"].startswith("Workshop/Rust -> left out")
    assert (
        "minDepth 0.002" in expected["contact stiffness of the tyres"]
        or "rolling_friction" in expected["contact stiffness of the tyres"]
    )
    assert not any("<contact>" in what or "<material>" in what for what in expected)


def test_controllers_of_the_neighbouring_package_of_the_same_name_count(tmp_path):
    result = import_vehicle(traps.controllers_beside(tmp_path / "source"), name="new", folder=tmp_path / "models")
    assert result.vehicle.spec.drive == "front"
    assert "rover_control/config/motors.yaml" in (result.folder / "vehicle.yaml").read_text()
    gain_changes = [change for change in result.changes if change.part.startswith("gains of")]
    assert [change.old for change in gain_changes] == ["p 5, i 0.5, d 0"]

"""The contact shapes of a wheel."""

from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Ellipsoid, Mesh
from pydrake.systems.framework import DiagramBuilder

from mirdrake.manoeuvres import Rig, find_facts
from mirdrake.plant.plant import make_plant
from mirdrake.plant.wheel_shape import (
    DISH,
    SEGMENTS,
    make_wheel_shape,
    patch_size,
    patch_slope,
    write_wheel_vtk,
)
from mirdrake.vehicles import WHEELS, load_vehicle
from mirdrake.worlds import load_world


def read(vtk):
    """Return points and tetrahedra of a legacy VTK text."""
    lines = vtk.splitlines()
    count = int(lines[4].split()[1])
    points = np.array([[float(word) for word in line.split()] for line in lines[5 : 5 + count]])
    cells = int(lines[5 + count].split()[1])
    return points, np.array([[int(w) for w in line.split()[1:]] for line in lines[6 + count : 6 + count + cells]])


def volumes(points, cells):
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


@given(radius=st.floats(0.02, 1.0), width=st.floats(0.01, 0.5), segments=st.integers(5, 64))
def test_the_mesh_fills_the_cylinder_without_its_concave_sides_and_every_tetrahedron_is_upright(
    radius, width, segments
):
    points, cells = read(write_wheel_vtk(radius=radius, width=width, segments=segments))
    parts = volumes(points, cells)
    assert (parts > 0.0).all()
    # The polygon has the circle's area; each side is a cone, its tip inside.
    dish = min(DISH * radius, 0.4 * width)
    assert parts.sum() == pytest.approx(pi * radius**2 * (width - 2.0 * dish / 3.0), rel=1e-9)


def test_every_inner_face_is_shared_by_two_tetrahedra_and_only_the_centre_is_inside():
    _, cells = read(write_wheel_vtk(radius=0.3, width=0.2, segments=12))
    faces = [tuple(sorted(np.delete(cell, k))) for cell in cells for k in range(4)]
    counts = {face: faces.count(face) for face in faces}
    assert set(counts.values()) == {1, 2}
    surface = {vertex for face, count in counts.items() if count == 1 for vertex in face}
    assert set(range(cells.max() + 1)) - surface == {24}


def test_a_right_wheel_is_the_mirror_image_of_a_left_one():
    left, left_cells = read(write_wheel_vtk(radius=0.3, width=0.2, segments=12))
    right, right_cells = read(write_wheel_vtk(radius=0.3, width=0.2, segments=12, mirrored=True))
    assert np.array_equal(right, left * [1.0, -1.0, 1.0])
    assert {frozenset(cell) for cell in right_cells.tolist()} == {frozenset(cell) for cell in left_cells.tolist()}
    assert (volumes(right, right_cells) > 0.0).all()


def test_hydroelastic_contact_gets_the_mesh_and_points_an_ellipsoid():
    assert isinstance(make_wheel_shape("hydroelastic", radius=0.3, width=0.2), Mesh)
    shape = make_wheel_shape("point", radius=0.3, width=0.2)
    assert isinstance(shape, Ellipsoid)
    assert (shape.a(), shape.b(), shape.c()) == (0.3, 0.1, 0.3)


# --- below tyre models -------------------------------------------------------------------------------------------


def one_car(model):
    """Return a Bolt in a plant on patches: (plant parts, its inspector, the car)."""
    builder = DiagramBuilder()
    parts = make_plant(builder, load_world("empty"), {"ego": load_vehicle(model)})
    return parts, parts.scene_graph.model_inspector(), parts.vehicles["ego"]


@pytest.mark.parametrize("model", ["bolt", "bolt@handling"])
def test_the_shape_of_a_tyre_does_not_turn_and_the_wheel_has_none(model):
    parts, inspector, car = one_car(model)
    for wheel, tyre in zip(car.wheels, car.tyres, strict=True):
        assert parts.plant.GetBodyFromFrameId(inspector.GetFrameId(tyre)).index() == wheel.parent_body().index()
        own = parts.plant.GetCollisionGeometriesForBody(wheel.child_body())
        assert all(inspector.GetProximityProperties(geometry) is None for geometry in own)
        context = parts.plant.CreateDefaultContext()
        X_WG = wheel.parent_body().EvalPoseInWorld(context) @ inspector.GetPoseInFrame(tyre)
        X_WC = wheel.child_body().EvalPoseInWorld(context)
        assert X_WG.IsNearlyEqualTo(X_WC, 1e-12)
        assert (
            inspector.GetProximityProperties(tyre).GetProperty("material", "coulomb_friction").dynamic_friction() == 0.0
        )
    assert not any(inspector.CollisionFiltered(tyre, parts.ground[0]) for tyre in car.tyres)
    boxes = [g for g in parts.plant.GetCollisionGeometriesForBody(car.base) if g not in car.tyres]
    assert boxes
    assert all(inspector.CollisionFiltered(tyre, box) for tyre in car.tyres for box in boxes)


@pytest.mark.parametrize("depth", [0.01, 0.022, 0.029])
def test_the_load_of_a_patch_is_that_of_the_pressure_in_the_polygon(depth):
    radius, width = 0.32, 0.2
    load = width * patch_size(radius, depth)
    sector = 2.0 * pi / SEGMENTS
    apothem = radius * sqrt(sector / sin(sector)) * cos(0.5 * sector)
    x, down = np.linspace(-0.25, 0.25, 40001), radius - depth
    for phase in (0.0, 0.3, 0.5):
        middle = (np.round(np.arctan2(x, down) / sector - phase) + phase) * sector
        share = np.maximum(1.0 - (x * np.sin(middle) + down * np.cos(middle)) / apothem, 0.0)
        # The parts of the patch at the sides, below a pyramid with its tip at the axle, do not count.
        assert width * np.trapezoid(share * (1.0 - share), x) == pytest.approx(load, rel=0.001)


def _patch(radius, width, depth, inclination, lifted=0.0):
    """Return the integral of p / E over an inclined patch [m²], with the pressure as if it were lower by `lifted` [m].

    The mesh is a pyramid with its tip in the axle: parts of the patch beside it do not count.
    """
    y, x = np.meshgrid(np.linspace(-0.5, 0.5, 2001) * width, np.linspace(-0.25, 0.25, 4001))
    down = radius - depth - y * np.tan(inclination)
    r = np.hypot(x, down)
    inside = (r < radius) & (np.abs(y) < 0.5 * width * r / radius)
    share = np.where(inside, 1.0 - np.hypot(x, down - lifted) / radius, 0.0)
    return float(share.sum()) * (0.5 / 4000) * (width / 2000) / np.cos(inclination)


@pytest.mark.parametrize("depth", [0.01, 0.022, 0.029])
@pytest.mark.parametrize("inclination", [0.03, 0.08])
def test_the_load_of_an_inclined_patch_is_that_of_the_pressure_in_it(depth, inclination):
    radius, width = 0.32, 0.1
    load = width * patch_size(radius, depth, inclination, width)
    assert load == pytest.approx(_patch(radius, width, depth, inclination), rel=5e-4)


def test_a_step_changes_the_pressure_of_a_patch_and_not_its_area():
    radius, width, depth, lower = 0.32, 0.1, 0.022, 1e-4
    change = _patch(radius, width, depth, 0.0, lower) - _patch(radius, width, depth, 0.0)
    assert patch_slope(radius, depth) * width * lower == pytest.approx(change, rel=2e-3)


@pytest.mark.parametrize("contact", [pytest.param("hydroelastic", marks=pytest.mark.slow), "point"])
def test_roll_and_lateral_acceleration_of_a_fast_turn_do_not_depend_on_the_step(contact):
    """With shapes that turn, patches held back 15 % of the roll at 5 ms, and 10 % at 2.5 ms."""
    vehicle = load_vehicle("bolt@handling")
    profile = {"kind": "step", "amplitude": 0.02, "start": 0.2, "rise": 0.15}
    ratios = []
    for step in (5e-3, 2.5e-3):
        rig = Rig("bolt@handling", vehicle, find_facts(vehicle), plant={"contact": contact, "time_step": step})
        driver = rig.open_driver(profile, speeds=[[0.0, 100.0 / 3.6]])
        run = rig.run("turn", driver, duration=1.7, speed=100.0 / 3.6)
        late = run.time > 1.4
        loads = [run.others[f"wheel_load.{wheel}"][late] for wheel in WHEELS]
        assert max(float(np.std(load) / np.mean(load)) for load in loads) < 0.01  # the loads do not oscillate
        ratios.append([run.roll[late].mean(), run.roll.max(), run.lateral_acceleration[late].mean()])
    assert ratios[0][0] > 0.02
    assert ratios[0] == pytest.approx(ratios[1], rel=0.003)

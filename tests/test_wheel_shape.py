"""The contact shapes of a wheel."""

from math import cos, pi, sin, sqrt, tan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddRigidHydroelasticProperties,
    Ellipsoid,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    HalfSpace,
    HydroelasticContactRepresentation,
    Mesh,
    ProximityProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from mirdrake.manoeuvres import Rig, find_facts
from mirdrake.plant.plant import make_plant
from mirdrake.plant.wheel_shape import (
    DISH,
    SEGMENTS,
    TREAD,
    make_wheel_shape,
    patch_load,
    patch_size,
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


MODULUS, RADIUS, WIDTH = 1e6, 0.32, 0.2


def contact_of(depth, inclination, pitch, *, mirrored, drop=0.0):
    """Return load [N] and overturning moment [N m] that a discrete step of Drake has for a mesh on a plane.

    Each polygon has the pressure at its centroid, at the end of the step, on its area at the beginning.
    """
    scene_graph = SceneGraph()
    source = scene_graph.RegisterSource("wheel")
    frame = scene_graph.RegisterFrame(source, GeometryFrame("wheel"))
    soft, hard = ProximityProperties(), ProximityProperties()
    AddCompliantHydroelasticProperties(RADIUS, MODULUS, soft)
    AddRigidHydroelasticProperties(hard)
    shape = make_wheel_shape("hydroelastic", radius=RADIUS, width=WIDTH, mirrored=mirrored)
    for shape_, properties in ((shape, soft), (HalfSpace(), hard)):
        geometry = GeometryInstance(RigidTransform(), shape_, "tyre" if properties is soft else "road")
        geometry.set_proximity_properties(properties)
        if properties is soft:
            scene_graph.RegisterGeometry(source, frame, geometry)
        else:
            scene_graph.RegisterAnchoredGeometry(source, geometry)
    context, poses = scene_graph.CreateDefaultContext(), FramePoseVector()
    height = (RADIUS - depth) * cos(inclination)
    # The axle is inclined, then the wheel turns about it.
    turned = RotationMatrix.MakeXRotation(inclination) @ RotationMatrix.MakeYRotation(-pitch)
    poses.set_value(frame, RigidTransform(turned, [0.0, 0.0, height]))
    scene_graph.get_source_pose_port(source).FixValue(context, poses)
    load, moment, centre = 0.0, 0.0, height * tan(inclination)
    for patch in (
        scene_graph.get_query_output_port()
        .Eval(context)
        .ComputeContactSurfaces(HydroelasticContactRepresentation.kPolygon)
    ):
        mesh, pressure = patch.poly_mesh_W(), patch.poly_e_MN()
        for face in range(patch.num_faces()):
            gradient = patch.EvaluateGradE_M_W(face) if patch.HasGradE_M() else patch.EvaluateGradE_N_W(face)
            rising = abs(gradient[2]) * np.sign(gradient @ patch.face_normal(face)) * (1 if patch.HasGradE_M() else -1)
            if rising <= 0.0:  # sides of the wheel
                continue
            vertex, place = mesh.element(face).vertex(0), patch.centroid(face)
            there = pressure.EvaluateAtVertex(vertex) + gradient @ (place - mesh.vertex(vertex))
            force = patch.area(face) * max(there + rising * drop, 0.0)
            load += force
            moment += force * (place[1] - centre)
    return load, moment


@pytest.mark.parametrize("depth", [-0.002, 0.003, 0.022])
@pytest.mark.parametrize("inclination", [0.0, 0.05, -0.08])
@pytest.mark.parametrize(("pitch", "mirrored", "drop"), [(0.0, False, 0.0), (0.03, True, 0.0), (-0.02, False, 4e-4)])
def test_load_and_moment_of_a_patch_are_those_of_drake(depth, inclination, pitch, mirrored, drop):
    """Also of a wheel whose lower side only touches the road."""
    expected = contact_of(depth, inclination, pitch, mirrored=mirrored, drop=drop)
    width, height = TREAD * WIDTH * (-1.0 if mirrored else 1.0), (RADIUS - depth) * cos(inclination)
    load, moment = patch_load(RADIUS, width, height, sin(inclination), pitch, drop)
    assert expected[0] > 0.0 or (depth < 0.0 and inclination == 0.0)
    assert MODULUS * load == pytest.approx(expected[0], rel=1e-6)
    assert MODULUS * moment == pytest.approx(expected[1], rel=1e-6, abs=1e-6 * WIDTH * expected[0])


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

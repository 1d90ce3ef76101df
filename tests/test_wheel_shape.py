"""The contact shapes of a wheel."""

from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Ellipsoid, Mesh

from mirdrake.plant import TyreSpring
from mirdrake.wheel_shape import make_wheel_shape, write_wheel_vtk


def read(vtk):
    """Points and tetrahedra of a legacy VTK text."""
    lines = vtk.splitlines()
    count = int(lines[4].split()[1])
    points = np.array([[float(word) for word in line.split()] for line in lines[5 : 5 + count]])
    cells = int(lines[5 + count].split()[1])
    return points, np.array([[int(w) for w in line.split()[1:]] for line in lines[6 + count : 6 + count + cells]])


def volumes(points, cells):
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


@given(radius=st.floats(0.02, 1.0), width=st.floats(0.01, 0.5), segments=st.integers(5, 64))
def test_the_mesh_fills_the_cylinder_exactly_and_every_tetrahedron_is_upright(radius, width, segments):
    points, cells = read(write_wheel_vtk(radius=radius, width=width, segments=segments))
    parts = volumes(points, cells)
    assert (parts > 0.0).all()
    assert parts.sum() == pytest.approx(pi * radius**2 * width, rel=1e-9)  # the polygon has the circle's area


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


@pytest.mark.parametrize("way", [0.0, 0.01, 0.08, 0.3])
def test_a_rolling_wheel_carries_the_pressure_of_a_patch_a_step_ahead_within_its_old_patch(way):
    depth, radius, modulus, width = 0.008, 0.32, 1e7, 0.2
    spring = TyreSpring((0.75 / (modulus * width * sqrt(2.0 / radius))) ** (2.0 / 3.0), 2.0 / 3.0, radius)
    half = sqrt(2.0 * radius * depth)
    x = np.linspace(-half, half, 20001)
    pressure = np.maximum(modulus / radius * (depth - x**2 / (2.0 * radius) + way * x / radius), 0.0)
    load = width * np.trapezoid(pressure, x)
    assert spring.load(depth, way=way) == pytest.approx(load, rel=1e-5)
    assert spring.load(depth, way=-way) == pytest.approx(load, rel=1e-5)

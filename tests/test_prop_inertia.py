"""Mass and inertia of props: those of the boxes around their solids."""

import numpy as np
import pytest
from pydrake.geometry import Box, Cylinder
from pydrake.math import RigidTransform

from mirdrake.worlds.props import Prop, Solid, make_primitive


def test_a_box_has_the_inertia_of_the_textbook_about_its_foot() -> None:
    box = make_primitive("box", (2.0, 3.0, 4.0))
    m = 500.0 * 24.0  # light wood
    inertia = box.inertia
    assert inertia.get_mass() == pytest.approx(m)
    np.testing.assert_allclose(inertia.get_com(), [0.0, 0.0, 2.0])
    about_com = m / 12.0 * np.array([3.0**2 + 4.0**2, 2.0**2 + 4.0**2, 2.0**2 + 3.0**2])
    about_foot = about_com + m * np.array([2.0**2, 2.0**2, 0.0])
    np.testing.assert_allclose(inertia.CalcRotationalInertia().CopyToFullMatrix3(), np.diag(about_foot), atol=1e-9)


def test_the_mass_goes_to_the_solids_by_their_volumes_and_each_counts_as_the_box_around_it() -> None:
    radius, height = np.sqrt(2.0 / np.pi), 1.0  # 2 m³, twice the cube
    cube = Solid(Box(1.0, 1.0, 1.0), RigidTransform([3.0, 0.0, 0.5]))
    post = Solid(Cylinder(radius, height), RigidTransform([0.0, 0.0, 0.5]))
    inertia = Prop("two", (cube, post), (5.0, 2.0, 1.0), 9.0).inertia
    np.testing.assert_allclose(inertia.get_com(), [1.0, 0.0, 0.5], atol=1e-12)
    side = np.ptp(post.corners, axis=0)  # a circle is a polygon around it
    assert side[:2] == pytest.approx(2.0 * radius, rel=0.01)
    around_z = 3.0 * (2.0 / 12.0 + 3.0**2) + 6.0 * (side[0] ** 2 + side[1] ** 2) / 12.0
    assert inertia.CalcRotationalInertia().CopyToFullMatrix3()[2, 2] == pytest.approx(around_z)

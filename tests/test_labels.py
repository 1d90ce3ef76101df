"""Labels of a world in Meshcat do not cover one another in the picture of the overview."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely import MultiPoint
from shapely.geometry.base import BaseGeometry

from mirdrake.viewer.labels import MOST, Label, apart

EYE, TARGET = np.array([0.0, -30.0, 30.0]), np.array([0.0, 0.0, 0.0])


def seen(label: Label) -> BaseGeometry:
    """Return the area of a plate in the picture of the camera, from its frame: x to the right, y up, z ahead."""
    s = np.sqrt(0.5)
    R_CW = np.array([[1.0, 0.0, 0.0], [0.0, s, s], [0.0, s, -s]])
    half_width, half_height = 0.5 * label.height * float(np.ptp(label.corners[:, 0])), 0.5 * label.height
    tilted = np.array([0.0, np.sin(np.radians(35.0)), np.cos(np.radians(35.0))])
    points = [
        np.array(label.position) + i * half_width * np.array([1.0, 0.0, 0.0]) + j * half_height * tilted
        for i, j in itertools.product((-1, 1), repeat=2)
    ]
    x, y, z = R_CW @ (np.array(points) - EYE).T
    return MultiPoint(np.column_stack([x / z, y / z])).convex_hull


def scatter(count: int, size: float) -> list[Label]:
    random = np.random.default_rng(1)
    places: NDArray[np.float64] = random.uniform([-size, -size, 0.0], [size, size, 4.0], (count, 3))
    return [Label(f"prop_{index}", (x, y, z), 0.8) for index, (x, y, z) in enumerate(places.tolist())]


def test_no_label_covers_another_one_and_each_that_is_left_out_would() -> None:
    labels = scatter(150, 12.0)
    kept = apart(labels, EYE, TARGET)
    assert 10 < len(kept) < len(labels)
    areas = {label: seen(label) for label in labels}
    assert all(areas[a].intersection(areas[b]).area < 1e-9 for a, b in itertools.combinations(kept, 2))
    # The box of a plate is a little larger than the plate, whose upper edge is farther away and therefore shorter.
    boxes = {label: area.envelope for label, area in areas.items()}
    for index, label in enumerate(labels):
        earlier = [other for other in labels[:index] if other in kept]
        assert (label in kept) != any(boxes[label].intersection(boxes[other]).area > 1e-12 for other in earlier)


def test_the_first_of_two_labels_at_a_place_is_kept() -> None:
    first, second = Label("first", (0.0, 0.0, 1.0), 1.0), Label("second", (0.0, 0.1, 1.0), 1.0)
    assert apart([first, second], EYE, TARGET) == [first]
    assert apart([second, first], EYE, TARGET) == [second]
    beside = Label("beside", (8.0, 0.0, 1.0), 1.0)
    assert apart([first, beside], EYE, TARGET) == [first, beside]


def test_what_is_behind_the_camera_has_no_label() -> None:
    assert apart([Label("behind", (0.0, -60.0, 30.0), 1.0)], EYE, TARGET) == []


def test_the_number_of_labels_is_limited() -> None:
    labels = [Label(f"{i}", (20.0 * i, 0.0, 0.0), 1.0) for i in range(-MOST, MOST)]
    assert len(apart(labels, EYE, TARGET)) == MOST


@pytest.mark.parametrize("text", ["a", "barrel[12]", "Über der Straße"])
def test_a_plate_is_as_wide_as_its_text(text: str) -> None:
    label = Label(text, (0.0, 0.0, 0.0), 1.0)
    document = label.mesh().mesh_file.contents()
    assert document
    low, high = label.corners.min(axis=0), label.corners.max(axis=0)
    np.testing.assert_allclose(low, -high)
    assert high[2] - low[2] == pytest.approx(1.0)
    assert high[0] > Label("", (0.0, 0.0, 0.0), 1.0).corners[:, 0].max()

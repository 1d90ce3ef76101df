"""Centre lines of road areas that cross themselves or have junctions."""

import math

import numpy as np
import pytest
import shapely

from mirdrake.importing.worlds.routes import route_in_area

Line = np.ndarray


def lemniscate(half: float) -> Line:
    """Return a lemniscate of Bernoulli from -half to half [m]."""
    t = np.linspace(0.0, 2.0 * math.pi, 400)
    return np.column_stack((np.cos(t), np.sin(t) * np.cos(t))) * (half / (1.0 + np.sin(t) ** 2))[:, None]


def crossed_circles(radius: float, apart: float) -> Line:
    """Return two arcs about (±apart, 0) that are joined by crossing tangents [m]."""
    touch = math.acos(radius / apart)
    turn = np.linspace(math.pi - touch, touch - math.pi, 200)
    right = np.column_stack((apart + radius * np.cos(turn), radius * np.sin(turn)))
    turn = np.linspace(touch, 2.0 * math.pi - touch, 200)
    left = np.column_stack((-apart + radius * np.cos(turn), radius * np.sin(turn)))
    return np.vstack((right, left, right[:1]))


@pytest.mark.parametrize(
    ("line", "width", "radius"),
    [
        (lemniscate(40.0), 5.0, 40.0 / 3.0),  # the least radius of a lemniscate is a third of its half length
        (lemniscate(60.0), 8.0, 60.0 / 3.0),
        (crossed_circles(12.0, 20.0), 5.0, 12.0),
        (crossed_circles(15.0, 22.0), 7.0, 15.0),
        (crossed_circles(10.0, 12.0), 4.0, 10.0),
    ],
)
def test_a_road_that_crosses_itself_goes_straight_on_at_the_crossing(line: Line, width: float, radius: float) -> None:
    route = route_in_area(shapely.LineString(line).buffer(width / 2.0))
    assert route is not None
    assert route.track.closed
    # Both loops, not one of them; a line that turns back at the crossing had a radius below half of the width.
    assert route.track.length == pytest.approx(shapely.LineString(line).length, rel=0.03)
    assert route.track.min_radius > 0.7 * radius
    x, y = route.track.point(s := np.linspace(0.0, route.track.length, 400), np.zeros_like(s))
    assert shapely.distance(shapely.points(x, y), shapely.LineString(line)).max() < 0.25 * width


def test_a_circuit_with_a_road_across_it_keeps_to_the_circuit() -> None:
    t = np.linspace(0.0, 2.0 * math.pi, 200)
    ring = shapely.LineString(np.column_stack((40.0 * np.cos(t), 25.0 * np.sin(t))))
    across = shapely.LineString([(0.0, -25.0), (0.0, 25.0)])
    road = shapely.union(ring.buffer(2.5), across.buffer(2.5))
    assert isinstance(road, shapely.Polygon)
    route = route_in_area(road)
    assert route is not None
    assert route.track.length == pytest.approx(ring.length, rel=0.03)

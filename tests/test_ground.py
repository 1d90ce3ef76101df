"""The ground: heights and slopes of layers against closed forms, roughness against ISO 8608."""

import tracemalloc
from math import cos, pi, sin, tan
from typing import Any

import numpy as np
import pytest
from scipy.signal import csd, welch
from scipy.special import k1

from mirdrake.ground import FLAT, Terrain
from mirdrake.ground.layers import ground_at, ground_heights
from mirdrake.ground.roughness import REFERENCE_FREQUENCY, ROUGHNESS, Roughness
from mirdrake.ground.terrain import Block, Grid, Kerb, LayerSource, Plane, Road, Wave


def arc(*, radius: float, angle: float, bank: float = 0.0, grade: float = 0.0, **more: Any) -> Road:
    """Return a road that turns left on a circle about (0, radius), from the origin along x."""
    s = np.linspace(0.0, radius * angle, round(radius * angle) + 1)
    yaw = s / radius
    flat = np.zeros_like(s)
    return Road(
        s,
        radius * np.sin(yaw),
        radius * (1.0 - np.cos(yaw)),
        yaw,
        grade * s,
        flat + grade,
        flat + bank,
        flat,
        flat + 3.0,
        flat + 3.0,
        **more,
    )


def check_slopes(terrain: Terrain, *, size: float = 20.0, tolerance: float = 1e-5) -> None:
    """Compare the slopes at random points with central differences of the height."""
    random, step = np.random.default_rng(3), 1e-4
    x, y = random.uniform(-size, size, 500), random.uniform(-size, size, 500)
    slopes = terrain.slopes(x, y)
    along = (terrain.height(x + step, y) - terrain.height(x - step, y)) / (2.0 * step)
    across = (terrain.height(x, y + step) - terrain.height(x, y - step)) / (2.0 * step)
    # Some points are at an edge, where the slope jumps.
    assert np.quantile(np.abs(slopes[:, 1] - along), 0.98) < tolerance
    assert np.quantile(np.abs(slopes[:, 2] - across), 0.98) < tolerance


def test_flat_ground() -> None:
    assert FLAT.flat
    assert FLAT.at(3.0, 4.0) == (0.0, (0.0, 0.0, 1.0))


def test_plane() -> None:
    z, normal = Terrain([Plane(0.5, 0.1, -0.2)]).at(10.0, 20.0)
    assert z == pytest.approx(0.5 + 1.0 - 4.0)
    assert normal == pytest.approx(np.array([-0.1, 0.2, 1.0]) / np.sqrt(1.05))


@pytest.mark.parametrize("smooth", [False, True])
def test_grid_passes_through_its_heights(smooth: bool) -> None:
    z = np.random.default_rng(1).normal(size=(5, 7))
    terrain = Terrain([Grid(z, 2.0, x=-3.0, y=1.0, smooth=smooth)])
    x, y = np.meshgrid(-3.0 + 2.0 * np.arange(7), 1.0 + 2.0 * np.arange(5))
    assert terrain.height(x, y) == pytest.approx(z, abs=1e-6)
    check_slopes(terrain)


def test_smooth_grid_of_a_sine_is_a_sine() -> None:
    """Eight nodes per wave: a cubic spline is within 0.5 % of the amplitude."""
    x = 0.5 * np.arange(64)
    z = np.tile(np.sin(2.0 * pi * x / 4.0), (8, 1))
    terrain = Terrain([Grid(z, 0.5, periodic=True)])
    u = np.linspace(0.0, 100.0, 1001)
    assert terrain.height(u, 0.3 * u) == pytest.approx(np.sin(2.0 * pi * u / 4.0), abs=5e-3)


def test_block_and_wave() -> None:
    """A kerb of 0.1 m with a face of 45 degrees; a bump of 75 mm over 600 mm."""
    terrain = Terrain([Block(0.1, 0.1, 2.0, 0.1, 3.0, 0.1, x=5.0, y=0.0, yaw=pi / 2.0)])
    assert terrain.height(5.0, [-0.1, 0.05, 0.1, 1.0, 2.15]) == pytest.approx([0.0, 0.05, 0.1, 0.1, 0.05])
    assert terrain.height([3.45, 6.55, 6.7], 1.0) == pytest.approx([0.05, 0.05, 0.0])
    check_slopes(terrain)
    wave = Terrain([Wave(0.075, 0.6, 3.0, 0.1)])
    assert wave.height([0.15, 0.3, 0.45, 0.7], 0.0) == pytest.approx([0.0375, 0.075, 0.0375, 0.0])
    check_slopes(wave, size=1.0)


def test_banked_curve() -> None:
    """A circle of 50 m to the left, banked by 20 degrees: the right side is higher by tan 20° per metre."""
    terrain = Terrain([arc(radius=50.0, angle=1.5, bank=-tan(pi / 9.0))])
    for offset in (-2.5, 0.0, 2.5):
        for angle in (0.3, 0.77, 1.2):
            x, y = (50.0 - offset) * sin(angle), 50.0 - (50.0 - offset) * cos(angle)
            z, zx, zy = terrain.slopes(x, y)
            assert z == pytest.approx(-tan(pi / 9.0) * offset, abs=1e-5)
            along, across = zx * cos(angle) + zy * sin(angle), zy * cos(angle) - zx * sin(angle)
            assert (along, across) == pytest.approx((0.0, -tan(pi / 9.0)), abs=1e-4)


def test_graded_curve_and_its_embankment() -> None:
    """A grade of 10 % on a circle of 50 m: beside the centre line the slope is 10 % over 1 - n / R."""
    terrain = Terrain([arc(radius=50.0, angle=1.5, grade=0.1, shoulder=1.0, embankment=5.0)])
    for offset in (-2.0, 2.0):
        x, y = (50.0 - offset) * sin(0.8), 50.0 - (50.0 - offset) * cos(0.8)
        z, zx, zy = terrain.slopes(x, y)
        assert z == pytest.approx(0.1 * 50.0 * 0.8, abs=1e-4)
        assert zx * cos(0.8) + zy * sin(0.8) == pytest.approx(0.1 / (1.0 - offset / 50.0), rel=1e-4)
    beyond = 50.0 - 3.0 - 1.0 - 5.1  # past the embankment
    assert terrain.height(beyond * sin(0.8), 50.0 - beyond * cos(0.8)) == 0.0
    check_slopes(terrain, size=45.0, tolerance=1e-4)


def test_kerb_beside_a_road() -> None:
    kerb = Kerb(left=False, height=0.12, face=0.12, top=0.3, begin=5.0, end=20.0)
    terrain = Terrain([arc(radius=1e6, angle=3e-5, kerb=kerb, blends=False)])
    y = -3.0 - np.array([-0.1, 0.06, 0.2, 0.48, 0.6])
    assert terrain.height(10.0, y) == pytest.approx([0.0, 0.06, 0.12, 0.06, 0.0], abs=1e-3)
    assert terrain.height([4.0, 21.0], -3.2) == pytest.approx([0.0, 0.0])
    assert terrain.height(10.0, 3.2) == 0.0


def test_a_kerb_ends_with_its_road() -> None:
    kerb = Kerb(left=False, height=0.12, face=0.12, top=0.3, begin=-np.inf, end=np.inf)
    terrain = Terrain([arc(radius=1e6, angle=3e-5, kerb=kerb, blends=False)])  # 30 m
    heights = terrain.height([-2.0, -0.01, 0.01, 29.99, 30.01, 32.0], -3.2)
    assert heights == pytest.approx([0.0, 0.0, 0.12, 0.12, 0.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("name", ["B", "D"])
def test_roughness_has_the_density_of_its_class(name: str) -> None:
    """Octave bands from 0.0125 to 1.6 cycles/m within 1 dB of ISO 8608, slope -2 within 0.1."""
    terrain, density = Terrain(Roughness(ROUGHNESS[name], seed=2).grids()), ROUGHNESS[name]
    u = np.arange(0.0, 5000.0, 0.05)
    z = terrain.height(u * cos(0.3), u * sin(0.3))
    n, power = welch(z, 20.0, nperseg=2**14)
    for low in 0.0125 * 2.0 ** np.arange(7):
        band = (n >= low) & (n < 2.0 * low)
        level = np.mean(power[band] * n[band] ** 2) / (density * REFERENCE_FREQUENCY**2)
        assert abs(10.0 * np.log10(level)) < 1.0
    band = (n > 0.0125) & (n < 1.6)
    assert np.polyfit(np.log(n[band]), np.log(power[band]), 1)[0] == pytest.approx(-2.0, abs=0.1)


def test_roughness_has_the_coherence_of_an_isotropic_field() -> None:
    """Two tracks at 1.5 m: coherence 2πnB K1(2πnB) by Kamash and Robson."""
    terrain, distance = Terrain(Roughness(ROUGHNESS["C"], seed=4).grids()), 1.5
    u = np.arange(0.0, 5000.0, 0.1)
    left = terrain.height(u * cos(0.3) - distance * sin(0.3), u * sin(0.3) + distance * cos(0.3))
    right = terrain.height(u * cos(0.3), u * sin(0.3))
    n, cross = csd(left, right, 10.0, nperseg=2**12)
    power = np.sqrt(welch(left, 10.0, nperseg=2**12)[1] * welch(right, 10.0, nperseg=2**12)[1])
    for low in (0.02, 0.05, 0.1, 0.2, 0.4):
        band = (n > low / 1.3) & (n < low * 1.3)
        phase = 2.0 * pi * n[band] * distance
        assert np.mean(cross[band].real / power[band]) == pytest.approx(np.mean(phase * k1(phase)), abs=0.1)


def test_one_square_kilometre_takes_less_than_100_megabytes() -> None:
    """At a cell of 0.25 m, with a bump and roughness; the grid here has a hundredth of the area."""
    tracemalloc.start()
    try:
        ground = Terrain([Grid(np.zeros((400, 400)), 0.25)])
        raised = ground.with_layers([Grid(np.ones((9, 9)), 0.05, smooth=False, local=True)])
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    rough = Terrain(Roughness(1e-4).grids()).nbytes
    assert 64e6 < 100 * kept + rough < 100e6
    assert np.shares_memory(ground.data.heights, raised.data.heights)


def test_layers_above_another_terrain_are_those_of_one_terrain() -> None:
    random = np.random.default_rng(5)
    below: list[LayerSource] = [Plane(1.0, 0.1), Grid(random.uniform(size=(20, 30)), 0.5), arc(radius=20.0, angle=1.0)]
    above: list[LayerSource] = [
        Grid(random.uniform(size=(9, 9)), 0.5, smooth=False, local=True),
        Block(0.1, 0.1, 1.0, 0.1, 3.0, 0.1),
    ]
    x, y = random.uniform(-5.0, 15.0, (2, 500))
    ground = Terrain(below)
    before = ground.slopes(x, y)
    raised = ground.with_layers(above)
    np.testing.assert_array_equal(raised.slopes(x, y), Terrain([*below, *above]).slopes(x, y))
    np.testing.assert_array_equal(ground.slopes(x, y), before)
    assert np.ptp(raised.slopes(x, y) - before) > 0.1
    assert not raised.even
    assert raised.samples > 0
    assert FLAT.with_layers([]).flat


def test_heights_along_a_line_are_those_of_its_points() -> None:
    random = np.random.default_rng(6)
    grids = [
        Grid(random.normal(size=(7, 9)), 0.7, x=-2.0, y=1.0, yaw=0.4, smooth=smooth, periodic=periodic)
        for smooth in (False, True)
        for periodic in (False, True)
    ]
    features: list[LayerSource] = [
        Block(0.2, 0.5, 2.0, 0.5, width=3.0, side=0.5, x=2.0),
        Wave(0.1, 3.0, width=4.0, side=0.5, y=1.0),
    ]
    kerb = Kerb(left=False, height=0.1, face=0.1, top=1.0)
    data = Terrain([Plane(0.3, 0.02, -0.01), *grids, arc(radius=30.0, angle=0.5, bank=0.05, kerb=kerb), *features]).data
    # In Python, numbers of single precision would round the products of the splines.
    double = data.heights.astype(float)
    data = data._replace(layers=data.layers.view(np.recarray), heights=double)  # type: ignore[attr-defined]
    places, along = np.linspace(-9.0, 9.0, 40), np.zeros(40)
    for x, y, angle in random.uniform((-10.0, -10.0, -pi), (20.0, 10.0, pi), (20, 3)).tolist():
        ex, ey = cos(angle), sin(angle)
        ground_heights(data, x, y, ex, ey, places, 3, 40, along)
        at_points = [ground_at(data, x + s * ex, y + s * ey)[0] for s in places[3:].tolist()]
        np.testing.assert_allclose(along[3:], at_points, rtol=0.0, atol=1e-13)
    assert along[:3].tolist() == [0.0, 0.0, 0.0]

"""Effective plane of a wheel on uneven ground against closed forms, and the vertical force of a tyre."""

from math import cos, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.integrate import quad

from mirdrake.core.compiled import compiled
from mirdrake.core.errors import ConfigError
from mirdrake.ground import FLAT, Terrain
from mirdrake.ground.layers import GROUND_PARTS
from mirdrake.ground.terrain import SAMPLES, Block, LayerSource, Plane, Slab, Wave
from mirdrake.plant.wheels.ground_contact import CONTACT_PARTS, EffectivePlane, effective_plane
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.tyres.magic_formula_tyres import MagicFormulaTyres
from mirdrake.tyres.vertical import VerticalTyre, vertical_force, vertical_of_file

RADIUS, WIDTH = 0.3, 0.2


def under_wheel(terrain: Terrain, *, x: float, z: float, camber: float = 0.0, samples: int = SAMPLES) -> EffectivePlane:
    """Return the effective plane of a wheel that rolls along x, its centre at x and z."""
    upwards, axle = (0.0, -sin(camber), cos(camber)), (0.0, cos(camber), sin(camber))
    data = terrain.data._replace(layers=terrain.data.layers.view(np.recarray))  # type: ignore[attr-defined]
    return effective_plane(data, samples, RADIUS, WIDTH, (x, 0.0, z), (1.0, 0.0), upwards, axle)


@pytest.mark.parametrize("samples", [0, SAMPLES])
def test_deflection_on_a_plane(samples: int) -> None:
    plane = under_wheel(FLAT, x=1.0, z=0.28, samples=samples)
    assert plane == pytest.approx((0.02, 0.0, 1.0, 0.0, 1.0), abs=1e-12)
    assert under_wheel(FLAT, x=1.0, z=0.31, samples=samples).deflection == pytest.approx(-0.01)


@pytest.mark.parametrize("samples", [0, SAMPLES])
def test_deflection_on_an_incline(samples: int) -> None:
    """A slope of 15 %: the distance of the centre from the plane is z cos θ."""
    theta = np.arctan(0.15)
    plane = under_wheel(Terrain([Plane(slope_x=0.15)]), x=0.0, z=0.28 / cos(theta), samples=samples)
    assert plane == pytest.approx((0.02, -sin(theta), cos(theta), 0.0, 1.0), abs=1e-9)


def test_inclination_of_a_cambered_wheel_and_of_a_bank() -> None:
    """A wheel with a camber of 0.1 rad to its right; and an upright one on a bank of 0.1 to the left."""
    leaning = under_wheel(FLAT, x=0.0, z=0.28 * cos(0.1), camber=0.1, samples=0)
    assert (leaning.deflection, leaning.tilt) == pytest.approx((0.02, np.tan(0.1)), abs=1e-9)
    assert under_wheel(Terrain([Plane(slope_y=0.1)]), x=0.0, z=0.28).tilt == pytest.approx(-0.1)


def test_a_rigid_wheel_at_a_kerb_is_pushed_towards_its_centre() -> None:
    """At the edge of a kerb of 0.1 m, Fx / Fz is between that of the edge and that of the rim above it.

    A rigid wheel has sqrt(2 r h - h²) / (r - h).
    """
    height = 0.1
    ahead = sqrt(2.0 * RADIUS * height - height**2)
    kerb = Terrain([Block(height, 0.005, 5.0, 0.1, 10.0, 0.1)])
    for overlap in (0.03, 0.05):
        plane = under_wheel(kerb, x=-(ahead - overlap), z=RADIUS + 1e-9)
        assert plane.deflection > 0.0
        assert (ahead - overlap) / (RADIUS - height) < -plane.slope / plane.rise < ahead / (RADIUS - height)


def test_long_waves_are_followed_and_gaps_are_bridged() -> None:
    """On a hump of 4 m and 0.1 m the effective height is that of the crest; a gap of 5 cm takes a part of the area."""
    hump = Terrain([Wave(0.1, 4.0, 10.0, 0.1)])
    assert under_wheel(hump, x=2.0, z=0.38).deflection == pytest.approx(0.02, abs=1e-3)
    gap = Terrain([Block(-0.1, 1e-3, 0.05, 1e-3, 10.0, 0.1, x=-0.026)])
    bridged = under_wheel(gap, x=0.0, z=0.28)
    assert 0.005 < bridged.deflection < 0.02
    assert bridged.slope == pytest.approx(0.0, abs=0.02)


def test_an_obstacle_under_one_half_of_the_tyre() -> None:
    """Half of the springs of the full width: half of the energy and of the moment S of a plane."""
    plank = Terrain([Block(0.03, 0.1, 4.0, 0.1, 10.0, 0.001, x=-2.0, y=5.0005)])  # the left side, y > 0
    half = under_wheel(plank, x=0.0, z=0.31)

    def moment(depth: float) -> float:
        return float(2.0 / 3.0 * (2.0 * RADIUS * depth - depth**2) ** 1.5)

    energies = [quad(moment, 0.0, depth)[0] for depth in (half.deflection, 0.02)]
    assert energies[0] == pytest.approx(0.5 * energies[1], rel=1e-6)
    assert half.share == pytest.approx(0.5 * moment(0.02) / moment(half.deflection), rel=1e-6)


@pytest.mark.parametrize(
    ("layer", "ends", "heights"),
    [
        (Wave(0.075, 0.6, 10.0, 0.1), (-0.35, 0.3), (0.06, 0.09)),
        (Block(0.1, 0.1, 5.0, 0.1, 10.0, 0.1), (-0.4, 0.4), (0.06, 0.09)),
        (Block(0.1, 0.0176, 5.0, 0.1, 10.0, 0.1), (-0.4, 0.4), (0.06, 0.09)),
        (Slab(shapely.box(0.0, -5.0, 5.0, 5.0), 0.01), (-0.4, 0.4), (-0.03, 0.01)),
    ],
    ids=["bump", "kerb of 45 degrees", "kerb of 80 degrees", "slab of 10 mm"],
)
def test_a_wheel_that_returns_to_its_place_has_its_energy_again(
    layer: LayerSource, ends: tuple[float, float], heights: tuple[float, float]
) -> None:
    """Along a closed path over an obstacle a spring does no work: 1 % of its energy, 0.1 % with four times the samples.

    A force k d along the normal of the plane of equal area, as in the literature, takes up to 23 % at the kerbs.
    """
    terrain, low, high = Terrain([layer]), RADIUS + heights[0], RADIUS + heights[1]

    def plane(samples: int, x: float, z: float) -> EffectivePlane:
        return EffectivePlane(*quick(terrain.data, samples, RADIUS, WIDTH, (x, 0.0, z), *axes))

    quick = compiled(effective_plane, parts=(*GROUND_PARTS, *CONTACT_PARTS))
    axes = (1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    along = np.linspace(*ends, 2000)
    corners = ((ends[1], low), (ends[1], high), (ends[0], high), (ends[0], low))
    for samples, limit in ((SAMPLES, 1e-2), (4 * SAMPLES - 3, 1e-3)):
        work, largest = 0.0, 0.0
        for (x0, z0), (x1, z1) in zip((corners[-1], *corners), corners, strict=False):
            path = [plane(samples, x0 + t * (x1 - x0), z0 + t * (z1 - z0)) for t in np.linspace(0.0, 1.0, len(along))]
            forces = [max(p.deflection, 0.0) * p.share * (p.slope * (x1 - x0) + p.rise * (z1 - z0)) for p in path]
            work += np.trapezoid(forces, dx=1.0 / (len(along) - 1))
            largest = max(largest, *(0.5 * max(p.deflection, 0.0) ** 2 for p in path))
        assert abs(work) < limit * largest


def test_vertical_force() -> None:
    tyre = VerticalTyre(2e5, hardening=1e6, damping=0.1, growth=1e-3)
    assert vertical_force(tyre, 0.02, 0.0, 0.0) == pytest.approx(4400.0)
    assert tyre(4400.0) == pytest.approx(0.02)
    assert vertical_force(tyre, 0.02, 0.5, 10.0) == pytest.approx(4400.0 * 1.05 * 1.01)
    assert vertical_force(tyre, 0.02, -11.0, 0.0) == 0.0
    assert vertical_force(tyre, -0.01, 1.0, 0.0) == 0.0


def tyre_parameters(qfz2: float) -> MagicFormulaParameters:
    needed: dict[str, Any] = {"pcx1": 1.6, "pdx1": 1.1, "pkx1": 22.0, "pcy1": 1.3, "pky1": -20.0, "pky2": 1.5}
    needed |= {"pdy1": -1.0}
    known = MagicFormulaParameters.__dataclass_fields__
    return MagicFormulaParameters(
        unloaded_radius=0.32, fnomin=4000.0, vertical_stiffness=2.1e5, vertical_damping=300.0, qfz2=qfz2,
        **{name: value for name, value in needed.items() if name in known},
    )  # fmt: skip


def test_the_force_of_a_softening_tyre_rises_up_to_the_free_radius_or_is_an_error() -> None:
    """With a = Cz R0 / Fz0 = 16.8, the slope at R0 is zero at q = (-1 - sqrt(1 + a²)) / 2 = -8.915."""
    tyre = vertical_of_file(tyre_parameters(-8.9))
    assert tyre is not None
    forces = [vertical_force(tyre, depth, 0.0, 0.0) for depth in np.linspace(0.0, 0.32, 100)]
    assert np.all(np.diff(forces) > 0.0)
    assert tyre(forces[50]) == pytest.approx(0.32 * 50 / 99)
    with pytest.raises(ConfigError, match="a tyre has a load of 60000 N at rest, but carries 35"):
        tyre(60000.0)
    for qfz2 in (-8.93, 16.8**2 / 4.0, 100.0):
        with pytest.raises(ConfigError, match=r"QFZ2 = .* the vertical force does not rise"):
            vertical_of_file(tyre_parameters(qfz2))


def test_a_vertical_force_that_falls_is_an_error_with_its_line(tmp_path: Path) -> None:
    text = (Path(__file__).parents[1] / "models" / "tyres" / "215_50R17.tir").read_text(encoding="utf-8")
    lines = text.splitlines()
    start = next(index for index, line in enumerate(lines) if line.startswith("[VERTICAL]"))
    lines[start + 1 : start + 1] = ["VERTICAL_STIFFNESS = 200000", "QFZ2 = -50"]
    (tmp_path / "soft.tir").write_text("\n".join(lines), encoding="utf-8")
    tyres = MagicFormulaTyres.model_validate({"kind": "magic_formula", "file": "soft.tir", "rolling_resistance": 0.01})
    with pytest.raises(ConfigError, match=rf"soft.tir:{start + 3}: QFZ2 = -50 does not fit"):
        tyres.vertical_tyres(tmp_path)


def test_vertical_tyre_of_a_file_has_its_stiffness_at_the_nominal_load() -> None:
    tyre = vertical_of_file(tyre_parameters(15.0))
    assert tyre is not None
    depth = tyre(4000.0)
    assert tyre.stiffness + 2.0 * tyre.hardening * depth == pytest.approx(2.1e5)
    assert tyre.damping * 4000.0 == pytest.approx(300.0)

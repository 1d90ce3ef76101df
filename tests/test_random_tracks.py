"""Random tracks: closed, without crossings, repeatable, and as asked."""

import math
from typing import Any

import numpy as np
import pytest
import shapely

from mirdrake.core.errors import ConfigError, WorldError
from mirdrake.worlds import load_world
from mirdrake.worlds.loading import make_world
from mirdrake.worlds.tracks import Track


def _track(seed: int = 0, name: str = "main", own: int | None = None, **keys: Any) -> Track:
    random = {"length": 400.0, "seed": own, **keys}
    return make_world({"mirdrake": "world/1", "seed": seed, "tracks": {name: {"random": random}}}).tracks[name]


@pytest.mark.parametrize("seed", range(12))
def test_a_random_track_is_closed_has_its_length_and_keeps_its_distance(seed: int) -> None:
    track = _track(seed, min_radius=8.0, gap=6.0, irregularity=0.6)
    assert track.closed
    assert track.length == pytest.approx(400.0, abs=1e-9)
    gap, angle = track.gap
    assert gap < 1e-6
    assert abs(math.remainder(angle, 2.0 * math.pi)) < 1e-9
    assert track.min_radius >= 8.0 * (1.0 - 1e-9)

    # Independently of the generator: no two points that are far apart along the track are near in the plane.
    s = np.arange(0.0, track.length, 0.5)
    points = np.column_stack(track.point(s))
    assert shapely.is_valid(shapely.polygons(points))
    along = np.abs(s[:, np.newaxis] - s[np.newaxis, :])
    along = np.minimum(along, track.length - along)
    distance = np.hypot(*(points[:, np.newaxis] - points[np.newaxis, :]).transpose(2, 0, 1))
    assert distance[along > 25.0].min() > 6.0 - 1.0  # a half turn of radius 8 m is 25 m long; points are 0.5 m apart


def test_curvature_is_continuous() -> None:
    track = _track(3)
    ends = [piece.end_curvature for piece in track.pieces]
    starts = [piece.start_curvature for piece in track.pieces]
    assert [*starts[1:], starts[0]] == pytest.approx(ends, abs=1e-12)


def test_equal_seeds_give_equal_tracks_and_other_seeds_and_names_others() -> None:
    assert _track(5).pieces == _track(5).pieces
    assert _track(5).pieces != _track(6).pieces
    assert _track(5).pieces != _track(5, name="other").pieces
    assert _track(5, own=9).pieces == _track(6, own=9).pieces  # its own seed replaces that of the world


def test_the_start_is_on_a_straight() -> None:
    track = _track(2)
    assert track.curvature_at(0.0) == 0.0
    assert track.curvature_at(1.0) == 0.0


def test_a_track_that_cannot_exist_is_reported_in_one_line() -> None:
    with pytest.raises(WorldError, match=r"tracks\.main\.random: no random track was found in 500 attempts; increase"):
        _track(length=60.0, corners=30, min_radius=20.0)
    with pytest.raises(ConfigError, match=r"min_radius \(50 m\) is above max_radius \(40 m\)"):
        _track(min_radius=50.0)


def test_the_shipped_world_varies_width_light_and_surfaces() -> None:
    worlds = [load_world("random_track", overrides=[f"seed={seed}"]) for seed in range(8)]
    assert len({world.tracks["main"].width for world in worlds}) == 8
    assert len({world.spec.lights.sun.azimuth for world in worlds}) == 8
    assert len({world.spec.tracks["main"].surface for world in worlds}) > 1
    assert len({world.ground.surface for world in worlds}) > 1

"""Lanes of a track: in its direction on the right side, oncoming ones on the left.

A track without `lanes` is one lane along its centre line. The lanes of a direction are equally wide and numbered from
the right, as seen by their traffic: ``main.1``, ``main.2``; oncoming ones are ``main.-1``, ``main.-2``.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mirdrake.worlds.networks import Network
from mirdrake.worlds.networks.lane import Lane
from mirdrake.worlds.pieces import Array
from mirdrake.worlds.tracks import Track

if TYPE_CHECKING:
    from mirdrake.worlds.spec import TrackSpec

_SPACING = 0.5  # [m] between the nodes of a lane


def lanes_of_world(
    specs: Mapping[str, "TrackSpec"], tracks: Mapping[str, Track], network: Network | None
) -> dict[str, Lane]:
    """Return the lanes of all tracks, then those for motor vehicles of the network, by id."""
    lanes: dict[str, Lane] = {}
    for name, track in tracks.items():
        own = lanes_of_track(name, track, count=specs[name].lanes, oncoming=specs[name].oncoming)
        # A line to follow on other roads is no road: who is on those is on the line as well.
        lanes |= own if specs[name].road else {key: replace(lane, kind="line") for key, lane in own.items()}
    return lanes | ({} if network is None else {lane.id: lane for lane in network.driving()})


def lanes_of_track(name: str, track: Track, *, count: int = 1, oncoming: int = 0) -> dict[str, Lane]:
    """Return the lanes of a track by id.

    Args:
        name: name of the track.
        track: the track.
        count: number of lanes in its direction.
        oncoming: number of lanes in the opposite direction.
    """
    total = count + oncoming
    # Numbers count from the right edge in the direction of traffic, as neighbours are named.
    lanes: dict[str, Lane] = {}
    for number in range(1, count + 1):
        share = (number - 0.5) / total  # of the width, from the right edge
        left = f"{name}.{number + 1}" if number < count else None
        right = f"{name}.{number - 1}" if number > 1 else None
        lane = _lane(f"{name}.{number}", name, number, track, share, 1.0 / total, left, right)
        lanes[lane.id] = lane
    for number in range(1, oncoming + 1):  # seen by their traffic, its right edge is the left edge of the road
        share = 1.0 - (number - 0.5) / total
        left = f"{name}.-{number + 1}" if number < oncoming else None
        right = f"{name}.-{number - 1}" if number > 1 else None
        lane = _lane(f"{name}.-{number}", name, -number, track, share, 1.0 / total, left, right)
        lanes[lane.id] = lane
    return lanes


def _lane(
    lane_id: str, road: str, number: int, track: Track, share: float, width: float, left: str | None, right: str | None
) -> Lane:
    """Return the lane whose centre has a share of the road's width on its right; `width` is its own share of it.

    A line at the offset d, + left, of a centre line with curvature k has the length element 1 - k d, the heading error
    atan(d' / (1 - k d)) and, where d is constant, the curvature k / (1 - k d).
    """
    station = np.linspace(0.0, track.length, max(2, int(np.ceil(track.length / _SPACING)) + 1))
    for _ in range(2):  # equal spacing on the lane: first by stations of the track, then corrected
        offset, slope, k = _offset(track, station, share), _slope(track, station, share), track.curvature(station)
        # Length of the lane per metre of the centre line, shorter on the inside of a bend.
        rate = np.hypot(1.0 - k * offset, slope)
        s = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(station))))
        if _:
            break
        station = np.interp(np.linspace(0.0, s[-1], len(s)), s, station)
    # The offset turns the heading by atan(slope / (1 - k n)) and changes the curvature to k / (1 - k n), n to the left.
    x, y = track.point(station, offset)
    yaw = track.pose(station)[2] + np.arctan2(slope, 1.0 - k * offset)
    curvature = k / (1.0 - k * offset)
    if track.closed:  # the end is the start, also in the last digits
        yaw[-1] = yaw[0] + 2.0 * np.pi * round((yaw[-1] - yaw[0]) / (2.0 * np.pi))
        x[-1], y[-1], curvature[-1] = x[0], y[0], curvature[0]

    # Oncoming lanes are stored in their own direction of travel.
    if number < 0:
        s, x, y, yaw, curvature, station = (
            s[-1] - s[::-1],
            x[::-1],
            y[::-1],
            yaw[::-1] + np.pi,
            -curvature[::-1],
            station[::-1],
        )
    # The lane of a closed track leads into itself.
    follows = (lane_id,) if track.closed else ()
    return Lane(
        lane_id, s, x, y, np.zeros(len(s)), yaw, curvature, width * _width(track, station),
        left=left, right=right, successors=follows, predecessors=follows, road=road, number=-number, road_s=station,
    )  # fmt: skip


def _width(track: Track, s: Array) -> Array:
    return np.asarray(track.left_width(s) + track.right_width(s))


def _offset(track: Track, s: Array, share: float) -> Array:
    """Return the offset of the line that has a share of the road's width on its right [m]."""
    return share * _width(track, s) - track.right_width(s)


def _slope(track: Track, s: Array, share: float) -> Array:
    """Return the change of that offset per metre of the centre line [-]."""
    # Central difference, as widths may be any function of s.
    h = 0.05
    return np.asarray((_offset(track, s + h, share) - _offset(track, s - h, share)) / (2.0 * h))


def station_on(lane: Lane, s: float) -> float:
    """Return the station on a lane [m] beside a station of its road [m]."""
    if lane.direction > 0:
        return float(np.interp(s, lane.road_s, lane.s))
    return float(np.interp(s, lane.road_s[::-1], lane.s[::-1]))

"""Free start poses for a car, on a road if there is one."""

import math
from collections.abc import Iterator

import numpy as np
import shapely

from mirdrake.vehicles import load_vehicle
from mirdrake.world_checks.obstacles import Body
from mirdrake.worlds import World
from mirdrake.worlds.world import Start

CAR = "bolt"
"""The standard car that must have room."""

_ROOM = 0.3  # [m] on all sides
_AHEAD = (120.0, 60.0, 30.0, 15.0, 6.0, 0.0)  # [m] to be free in front; the first of them for which there is a place
_AHEAD_OFF_ROAD = (30.0, 15.0, 6.0, 0.0)  # [m] likewise without a road, where more would lead out of yards and arenas
_LOW = 0.05  # [m] height of objects that are not obstacles
_STEP = 2.0  # [m] between places that are tried
_MOST_PLACES = 20_000
_HEADINGS = np.radians([0.0, 90.0, 180.0, 270.0, 45.0, 135.0, 225.0, 315.0])


class FreePlaces:
    """Free poses of a standard car in a world.

    Args:
        world: laid out.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._car = Body.of(load_vehicle(CAR)).wider(_ROOM)
        solids = [prop for prop in world.props if prop.bottom < self._car.height and prop.top > _LOW]
        self._tree = shapely.STRtree([prop.footprint for prop in solids if not prop.prop.driven_over])

    def is_free(self, x: float, y: float, yaw: float, *, ahead: float = 0.0) -> bool:
        """Return whether the car has room at a pose and over a distance ahead of it [m]."""
        car = self._car
        c, s = math.cos(yaw), math.sin(yaw)
        corners = [(car.rear, -car.half_width), (car.front + ahead, -car.half_width),
                   (car.front + ahead, car.half_width), (car.rear, car.half_width)]  # fmt: skip
        places = np.array([(x + c * u - s * v, y + s * u + c * v) for u, v in corners])
        xmin, ymin, xmax, ymax = self._world.ground.extent
        if (places < (xmin, ymin)).any() or (places > (xmax, ymax)).any():
            return False
        return not len(self._tree.query(shapely.Polygon(places), predicate="intersects"))

    def is_start(self, start: Start) -> bool:
        """Return whether the car has room at a start."""
        return self.is_free(start.x, start.y, start.yaw)

    def find_on_tracks(self) -> tuple[str, float] | None:
        """Return the track and station s [m] with the most room ahead; None without room."""
        for ahead in _AHEAD:
            for name in self._world.tracks:
                s = self._find_on_track(name, ahead)
                if s is not None:
                    return name, s
        return None

    def _find_on_track(self, name: str, ahead: float) -> float | None:
        """Return the first station of a track with a free distance ahead [m]; None if there is none."""
        track = self._world.tracks[name]
        # An open track needs room for the rear of the car at its start, and for the distance ahead at its end.
        behind = 0.0 if track.closed else min(max(0.0, -self._car.rear) + 0.5, 0.25 * track.length)
        last = track.length if track.closed else min(0.6 * track.length, track.length - ahead - self._car.front)
        count = math.ceil(ahead / _STEP)
        clear = 0  # places in a row with room, up to the one that is tried
        s = behind
        while s <= last + count * _STEP:
            x, y, yaw = track.pose_at(s % track.length if track.closed else min(s, track.length))
            clear = clear + 1 if self.is_free(x, y, yaw) else 0
            # Free places in a row stand for the free distance ahead of the first of them.
            if clear > count:
                return round(s - count * _STEP, 2)
            s += _STEP
        return None

    def find_near(self, x: float, y: float) -> tuple[float, float, float] | None:
        """Return the nearest pose to a point with room, also ahead [m, rad]; None if there is none."""
        for ahead in _AHEAD_OFF_ROAD:
            for dx, dy in _spiral():
                for yaw in _HEADINGS:
                    if self.is_free(x + dx, y + dy, float(yaw), ahead=ahead):
                        return round(x + dx, 3), round(y + dy, 3), float(yaw)
        return None


def _spiral() -> Iterator[tuple[float, float]]:
    """Yield positions around the origin, nearest first [m]."""
    count, ring = 0, 0
    while count < _MOST_PLACES / len(_HEADINGS):
        # Six more places per ring keep their distance.
        number = max(1, 6 * ring)
        for angle in 2.0 * math.pi * np.arange(number) / number:
            count += 1
            yield ring * _STEP * math.cos(angle), ring * _STEP * math.sin(angle)
        ring += 1

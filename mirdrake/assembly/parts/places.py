"""Start poses of the vehicles of a diagram."""

from collections.abc import Mapping
from itertools import combinations
from math import hypot

from mirdrake.assembly.diagram_spec import DiagramSpec, Place
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import Start, World
from mirdrake.worlds.actors import FullActor


def find_start(spec: DiagramSpec, name: str, world: World) -> Start:
    """Return the start of a vehicle: a given pose, a start of the world, or the origin."""
    entry = spec.vehicles[name]
    if isinstance(entry.start, Place):
        start = Start(entry.start.x, entry.start.y, entry.start.yaw)
        world.ground.check_position(start.x, start.y, where=where(spec, "vehicles", name, "start"))
    elif entry.start is None and not world.starts:
        start = Start(0.0, 0.0, 0.0)
    else:
        start = world.start(entry.start or next(iter(world.starts)), where=where(spec, "vehicles", name, "start"))
    speed = start.speed if entry.speed is None else entry.speed
    return Start(start.x, start.y, start.yaw, speed, start.track, start.s)


def start_of_actor(actor: FullActor, world: World) -> Start:
    """Return the start of a full vehicle among the actors of a world: at rest if it waits for its start."""
    speed = 0.0 if actor.spec.starts is not None else actor.spec.speed
    return Start(*actor.start(world.lanes[actor.lane]), speed)


def check_starts(spec: DiagramSpec, vehicles: Mapping[str, Vehicle], starts: Mapping[str, Start]) -> None:
    """Reject vehicles that start nearer than a track width to one another, in any direction."""
    for (first, a), (second, b) in combinations(starts.items(), 2):
        width = min(vehicles[name].geometry.rear_track for name in (first, second))
        if hypot(a.x - b.x, a.y - b.y) < width:
            raise ConfigError(
                f"'{second}' starts at the place of '{first}', at "
                f"({b.x:g}, {b.y:g}) m; give each vehicle a start of its own",
                where=where(spec, "vehicles", second, "start"),
            )

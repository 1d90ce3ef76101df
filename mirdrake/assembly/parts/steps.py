"""Whether the events of a diagram fall on steps of its plant, from its data: the plant is made for the answer."""

from collections.abc import Iterator, Mapping
from typing import Any

from mirdrake.actors.traffic import PERIOD as TRAFFIC_PERIOD
from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.scene import Scene
from mirdrake.controllers.motion_tracking import PERIOD as TRACKING_PERIOD
from mirdrake.core.checks import whole_periods
from mirdrake.core.user_systems import sampling_period
from mirdrake.plant.powertrain.system import RATE as POWERTRAIN_RATE


def keeps_steps(spec: DiagramSpec, scene: Scene, factories: Mapping[str, Any]) -> bool:
    """Return whether all events of a diagram coincide with steps of its plant, and only the plant is continuous.

    An event within a step would divide it, and the integration would depend on it. Of user systems and drivers only
    those are known whose class states its period.

    Args:
        spec: the diagram.
        scene: of the diagram.
        factories: functions that make systems in Python, by their names under ``systems``.
    """
    step = spec.plant.time_step
    return not factories and all(
        time is not None and whole_periods(time, step) is not None for time in event_times(spec, scene)
    )


def event_times(spec: DiagramSpec, scene: Scene) -> Iterator[float | None]:
    """Yield the periods and latencies of the systems of a diagram, apart from its plant [s]; None: not known."""
    if spec.record.signals:
        yield 1.0 / spec.record.rate
    for entry in spec.systems.values():
        yield sampling_period(entry.kind, entry.parameters(), folder=spec.folder)
    for driver in spec.control.values():
        yield from driver.event_periods(spec.folder)
    for name, vehicle in scene.vehicles.items():
        yield 1.0 / vehicle.control.rate
        parked = name in spec.vehicles and spec.vehicles[name].parked
        pedals = vehicle.control.wheel_speed.uses_pedals and not parked
        # Powertrain with battery, and the actuator of the rear steering.
        if pedals or vehicle.spec.steering.rear is not None:
            yield 1.0 / POWERTRAIN_RATE
        for sensor in spec.sensors.get(name, ()):
            mount = vehicle.sensors.mounts[sensor]
            yield from (1.0 / mount.rate, mount.latency)
    world = scene.world
    if world.actors or world.full_actors or world.ways:
        yield TRAFFIC_PERIOD
    if world.full_actors:
        yield TRACKING_PERIOD

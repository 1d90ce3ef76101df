"""Whether the events of a diagram fall on steps of its plant, from its data: the plant is made for the answer."""

from collections.abc import Iterator, Mapping
from typing import Any

from mirdrake.actors.traffic import PERIOD as TRAFFIC_PERIOD
from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.scene import Scene
from mirdrake.controllers.motion_tracking import PERIOD as TRACKING_PERIOD
from mirdrake.core.checks import whole_periods
from mirdrake.core.user_systems import sampling_period
from mirdrake.core.yaml_io import where
from mirdrake.plant.obstacles import terrain_of
from mirdrake.plant.plant import contact_of_wheels, needs_solver
from mirdrake.plant.powertrain.system import RATE as POWERTRAIN_RATE


def interrupting_event(spec: DiagramSpec, scene: Scene, factories: Mapping[str, Any] | None = None) -> str:
    """Return where a diagram has an event that may lie within a step of its plant, and why; empty if nowhere.

    An event within a step would divide it, and the integration would depend on it. Of user systems and drivers only
    those are known whose class states its period.

    Args:
        spec: the diagram.
        scene: of the diagram.
        factories: functions that make systems in Python, by their names under ``systems``.
    """
    step = spec.plant.time_step
    for name in factories or ():
        return f"{where(spec, 'systems', name)}: the period of a system made in Python is not known"
    for place, time in _event_times(spec, scene):
        if time is None:
            return f'{place}: its period is not known, as its class does not name the argument (sampled_with = "...")'
        if whole_periods(time, step) is None:
            return f"{place}: {time:g} s is not a multiple of plant.time_step, {step:g} s"
    return ""


def discrete_plant(spec: DiagramSpec, scene: Scene) -> list[str]:
    """Return a line if an event makes a plant discrete that could be continuous; see :func:`interrupting_event`."""
    if needs_solver(contact_of_wheels(spec.plant, terrain_of(scene.world)), scene.world):
        return []
    event = interrupting_event(spec, scene)
    return [f"{event}; the plant is therefore discrete, and the run takes longer"] if event else []


def _event_times(spec: DiagramSpec, scene: Scene) -> Iterator[tuple[str, float | None]]:
    """Yield the places of the systems of a diagram, apart from its plant, with periods and latencies [s].

    None: not known.
    """
    if spec.record.signals:
        yield where(spec, "record", "rate"), 1.0 / spec.record.rate
    for name, entry in spec.systems.items():
        yield where(spec, "systems", name), sampling_period(entry.kind, entry.parameters(), folder=spec.folder)
    for name, driver in spec.control.items():
        for period in driver.event_periods(spec.folder):
            yield where(spec, "control", name), period
    for name, vehicle in scene.vehicles.items():
        yield f"{name}: control unit", 1.0 / vehicle.control.rate
        parked = name in spec.vehicles and spec.vehicles[name].parked
        # Powertrain with battery, and the actuator of the rear steering.
        if vehicle.control.wheel_speed.uses_pedals and not parked:
            yield f"{name}: powertrain", 1.0 / POWERTRAIN_RATE
        if vehicle.spec.steering.rear is not None:
            yield f"{name}: rear steering", 1.0 / POWERTRAIN_RATE
        for sensor in spec.sensors.get(name, ()):
            mount = vehicle.sensors.mounts[sensor]
            yield f"{name}.{sensor}: period", 1.0 / mount.rate
            yield f"{name}.{sensor}: latency", mount.latency
    world = scene.world
    if world.actors or world.full_actors or world.ways:
        yield "traffic", TRAFFIC_PERIOD
    if world.full_actors:
        yield "actors with full dynamics", TRACKING_PERIOD

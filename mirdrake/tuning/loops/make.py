"""From a tuning file to the data of its loop: the diagram to build, the gains, the course."""

import math
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

from mirdrake.assembly.diagram import assemble as make_assembly
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantSpec
from mirdrake.tuning.loops.base import LoopSpec
from mirdrake.tuning.spec import PUBLISHED, TuningSpec
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.joint_control import JOINT_CONTROLS
from mirdrake.worlds import load_world

EGO = "ego"
_BLOCKS = "mirdrake.tuning.loops.blocks:"
_NEVER = 1e6
"""Dead-man time of a bench [s]: its commands come without stamps."""

SLOPE = 0.6
"""Slope of the speed's set-point [m/s²]: one driven axle can give it at a friction of 0.3 on a climb of 5°."""

EVEN = {"wheel_speed": 10.0, "speed": 10.0, "steering": 3.0}
"""Speed of the car before the step [m/s], unless the file says; a small car takes less."""


def make_loop_spec(spec: TuningSpec, *, noise: bool | None = None, speed: float | None = None) -> LoopSpec:
    """The loop of a tuning file as plain data.

    Args:
        spec: the file.
        noise: whether the sensor can be noisy; if left out, as the robustness asks for.
        speed: of the car before the step instead of the file's [m/s], for a schedule.

    Raises:
        ConfigError: a gain, a figure, a signal or a vehicle is not known, or the loop is not connected.
    """
    if not isinstance(spec.loop, str) or spec.loop == "path":
        from mirdrake.tuning.loops.signals import make_signal_loop

        return make_signal_loop(spec)
    vehicle = load_vehicle(_model(spec), where=where(spec, "vehicle"))
    world = load_world(spec.world, where=where(spec, "world"))
    if any(mu != world.ground.mu for _, mu in world.friction_areas):
        place = where(spec, "world")
        raise ConfigError(f"{place}: {spec.world} has friction that is not the same everywhere; take empty, say")
    noisy = spec.robustness.noise > 0.0 if noise is None else noise
    joint = "steering" if spec.loop == "steering" else "wheel"
    pedals = joint == "wheel" and vehicle.control.wheel_speed.uses_pedals
    if pedals and spec.loop == "wheel_speed":
        raise ConfigError(
            f"{where(spec, 'loop')}: {vehicle.name} is driven by pedals and has no wheel-speed loop; take speed"
        )
    section = "steering" if joint == "steering" else "wheel_speed"
    # Pedals are tuned as they are; joint torques come from the PID controller of the section.
    units = vehicle.control.wheel_speed.gains if pedals else JOINT_CONTROLS[section]["pid"].gains
    rate = vehicle.control.rate
    settings: dict[str, Any] = {}
    if not pedals:
        filter_time = 2.0 / rate if spec.test.filter is None else spec.test.filter
        settings = {f"{section}.kind": "pid", f"{section}.filter": filter_time}
        if joint == "wheel":
            settings |= {"speed.kp": 0.0, "speed.ki": 0.0}
    course = make_course(spec, vehicle, speed=speed)
    control: dict[str, Any] = {"dead_man": _NEVER}
    for path, value in settings.items():
        group, key = path.split(".")
        control.setdefault(group, {})[key] = value
    control.setdefault(section, {}).update(dict.fromkeys(units, 0.0))
    if getattr(vehicle.control, section).gain_schedule() is not None:
        control[section]["schedule"] = None
    if joint == "wheel":
        slope = SLOPE if spec.test.slope is None else spec.test.slope
        control.setdefault("speed", {}).update({"max_acceleration": slope, "max_deceleration": slope})
    size = 3 if pedals else len(ElementTree.fromstring(vehicle.urdf).findall("transmission"))
    between = ("pedals", "pedals_reference") if pedals else ("torque_command", "torque_reference")
    systems = {"late": {"kind": f"{_BLOCKS}LateActuator", "size": size, "period": 1.0 / rate}}
    connect = [[f"{EGO}.{between[0]}", "late.u"], ["late.y", f"{EGO}.{between[1]}"]]
    diagram: dict[str, Any] = {
        "name": spec.name,
        "world": _world(spec),
        "vehicles": {
            EGO: {
                "model": _model(spec),
                "start": {"x": 0.0, "y": 0.0, "yaw": 0.0},
                "speed": course["speed"],
                "control": control,
            }
        },
        "systems": systems,
        "connect": connect,
        "plant": _plant(spec, rate),
        "record": {"rate": rate, "meshcat": False, "report": False},
        "duration": course["duration"],
        "seed": spec.seed,
    }
    if noisy:  # the size of the plant's state is known when it is built
        size = make_assembly(make_spec(diagram)).parts.plant.num_multibody_states()
        systems["noisy"] = {"kind": f"{_BLOCKS}NoisySensor", "size": size, "period": 1.0 / rate}
        connect += [[f"{EGO}.plant_state", "noisy.u"], ["noisy.y", f"{EGO}.measured_state"]]
    output_unit = {"wheel_speed": "rad/s", "speed": "m/s", "steering": "rad"}[spec.loop]
    return LoopSpec(
        kind=spec.loop,
        diagram=diagram,
        vehicle=EGO,
        gains=units,
        paths={gain: f"{section}.{gain}" for gain in units},
        settings=settings,
        reference={"wheel_speed": "wheel_speed_setpoint", "speed": "speed_setpoint"}.get(
            spec.loop, "steering_setpoint"
        ),
        output={"wheel_speed": "driven wheels", "speed": "vx"}.get(spec.loop, "steering_angle"),
        effort="pedals" if pedals else "joint_torque",
        output_unit=output_unit,
        effort_unit="1" if pedals else "N m",
        course=course,
        nominal={"delay": spec.test.delay, "friction": float(world.ground.mu)},
        options={
            "noisy": noisy,
            "pedals": pedals,
            "period": 1.0 / rate,
            "filter": settings.get(f"{section}.filter", 0.0),
        },
    )


def finer(loop: LoopSpec) -> LoopSpec:
    """The loop at a finer step of the plant: that of a diagram which names none, or half of its own if that is less.

    A long step of the plant damps what it does not resolve. Wheels that lose their grip for an instant are light, and
    gains that hold the car may make them spin; at a long step that is not seen.
    """
    plant = loop.diagram["plant"]
    step = min(PlantSpec().time_step, 0.5 * float(plant["time_step"]))
    return replace(loop, diagram={**loop.diagram, "plant": {**plant, "time_step": step}})


def make_course(spec: TuningSpec, vehicle: Vehicle, *, speed: float | None = None) -> dict[str, Any]:
    """Numbers of the trial: speed [m/s], step [y], step_time, load [u], load_time, duration [s].

    A car of 1 m takes 3 m/s where one of the usual size takes 10: speeds go with the root of the wheelbase.
    """
    test = spec.test
    scale = math.sqrt(vehicle.geometry.wheelbase / 2.6)
    driven = len(vehicle.spec.driven_wheels())
    even = test.speed if speed is None else speed
    even = round(EVEN[str(spec.loop)] * scale, 2) if even is None else even
    if spec.loop == "steering":
        step, load = min(0.1, 0.5 * vehicle.geometry.steering_limit), 0.0
    else:
        step = round(2.0 * scale, 2)
        load = -0.05 * vehicle.spec.powertrain.max_torque / driven  # a grade of about 2.5 %
    pedals = spec.loop != "steering" and vehicle.control.wheel_speed.uses_pedals
    return {
        "speed": even,
        "step": step if test.step is None else test.step,
        "step_time": test.step_time,
        "load": 0.0 if pedals else load if test.load is None else test.load,
        "load_time": 0.6 * test.duration if test.load_time is None else test.load_time,
        "duration": test.duration,
    }


def baseline_gains(spec: TuningSpec, loop: LoopSpec) -> dict[str, float]:
    """Gains to compare with; what is not said is zero, or in a loop of signals what the diagram has.

    Raises:
        ConfigError: a loop of signals, of whose gains nobody knows what the diagram has.
    """
    if "present" in loop.options:
        given = dict(loop.options["present"]) | (spec.baseline if isinstance(spec.baseline, dict) else {})
        missing = [name for name in loop.gains if name not in given]
        if missing:
            raise ConfigError(f"{where(spec, 'baseline')}: say what to compare with, as in {{{missing[0]}: 1}}")
        return {name: float(given[name]) for name in loop.gains}
    given = PUBLISHED if spec.baseline == "published" else spec.baseline
    return {name: float(given.get(name, 0.0)) for name in loop.gains}


def _model(spec: TuningSpec) -> str:
    from mirdrake.assembly.diagram_spec import _absolute

    name, mark, variant = str(spec.vehicle).partition("@")
    return str(spec.vehicle) if spec.folder is None else f"{_absolute(name, _path(spec))}{mark}{variant}"


def _world(spec: TuningSpec) -> str:
    from mirdrake.assembly.diagram_spec import _absolute

    return spec.world if spec.folder is None else _absolute(spec.world, _path(spec))


def _path(spec: TuningSpec) -> Any:
    from pathlib import Path

    return Path(str(spec.folder))


def _plant(spec: TuningSpec, rate: float) -> dict[str, Any]:
    """Point contact and the longest step that will do, unless the file says.

    Steered joints are light and stiff; they take two steps of the plant a period. A car's speed takes one, if its
    actuators are late by half a period at least: half a period more or less of delay would be seen.
    """
    steps = 2 if spec.loop == "steering" or spec.test.delay < 0.5 / rate else 1
    usual = {"contact": "point", "time_step": 1.0 / rate / steps, "machine_code": True}
    return usual | spec.plant.model_dump(exclude_unset=True)

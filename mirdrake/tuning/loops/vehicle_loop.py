"""Loops of a vehicle on a straight road: diagram of the test bench, gains and test manoeuvre."""

import math
from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuator
from pydrake.systems.framework import Context

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import _absolute, make_spec
from mirdrake.core.contacts import STUDY_CONTACT
from mirdrake.core.errors import ConfigError
from mirdrake.core.json_io import Json
from mirdrake.core.yaml_io import where
from mirdrake.plant.plant import PlantSpec, VehicleInPlant
from mirdrake.plant.wheels.tyre_forces import make_spinning_wheels, wheel_laws
from mirdrake.tuning.loops.base import Course, Gain, LoopSpec
from mirdrake.tuning.loops.bench import PlantBench
from mirdrake.tuning.loops.kind import LoopKind
from mirdrake.tuning.models import Floats
from mirdrake.tuning.spec import TuningSpec
from mirdrake.tyres import SlipTyres
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.joint_control import JOINT_CONTROLS
from mirdrake.worlds import World, load_world

if TYPE_CHECKING:
    from mirdrake.tuning.identify import Identification

EGO = "ego"
_BLOCKS = "mirdrake.tuning.loops.blocks:"
MOST_ANGLE = 1.0
"""Largest angle that an oscillation of the wheels may turn in a step of the plant [rad].

That is half of the limit of an explicit method. The damping of the tyre and the loads of single wheels lower the limit:
at 2 rad the wheels of a robot of 18 kg oscillate in 5 of 12 runs of a Monte Carlo, at 1 rad in none. Source: E. Hairer,
C. Lubich and G. Wanner, Geometric Numerical Integration, 2nd ed., section I.5: the method of Störmer and Verlet is
stable up to 2.
"""

_NO_TIMEOUT = 1e6
"""Watchdog timeout on a bench [s]: its commands have no time stamps."""


class VehicleLoop(LoopKind):
    """A loop of a vehicle that drives straight.

    Attributes:
        section: of control.yaml that has the gains.
        reference: signal of the set-point.
        output: controlled signal.
        output_unit: its unit.
        effort: control signal.
        effort_unit: its unit.
        initial_speed: default speed before the step, for a car with a wheelbase of 2.6 m [m/s].
        delayed_ports: output and input of the vehicle between which the actuator delay is.
    """

    section: ClassVar[str] = "wheel_speed"
    reference: ClassVar[str]
    output: ClassVar[str]
    output_unit: ClassVar[str]
    effort: ClassVar[str] = "joint_torque"
    effort_unit: ClassVar[str] = "N m"
    initial_speed: ClassVar[float] = 10.0
    delayed_ports: ClassVar[tuple[str, str]] = ("torque_command", "torque_reference")

    # --- data of the loop ---

    def make_spec(self, study: TuningSpec, *, noise: bool | None = None, speed: float | None = None) -> LoopSpec:
        """See :meth:`LoopKind.make_spec`."""
        vehicle = load_vehicle(_vehicle_name(study), where=where(study, "vehicle"))
        world = load_world(study.world, where=where(study, "world"))
        if any(mu != world.ground.mu for _, mu in world.friction_areas):
            place = where(study, "world")
            raise ConfigError(
                f"{place}: the friction of {study.world} is not the same everywhere; use another world, such as empty"
            )
        return self.of_vehicle(study, vehicle, world, noise=noise, speed=speed)

    def of_vehicle(
        self, study: TuningSpec, vehicle: Vehicle, world: World, *, noise: bool | None, speed: float | None
    ) -> LoopSpec:
        """Return the loop of a loaded vehicle."""
        period = 1.0 / vehicle.control.rate
        filter_time = 2.0 / vehicle.control.rate if study.test.filter is None else study.test.filter
        settings = self.settings(filter_time)
        course = self.course(study, vehicle, speed)
        # Noise needs a block of its own, so only loops that draw it have one.
        noisy = study.robustness.noise > 0.0 if noise is None else noise

        # All gains are zero in the file; the bench writes them to a Context.
        # Commands on the bench have no time stamps: the watchdog must not stop the vehicle.
        test_control: Json = {"dead_man": _NO_TIMEOUT, **self.test_control(study)}
        control: Json = {**test_control, self.section: {}}
        for path, value in settings.items():
            group, key = path.split(".")
            control.setdefault(group, {})[key] = value
        units = self.gain_units(vehicle)
        control[self.section] |= dict.fromkeys(units, 0.0)
        present = getattr(vehicle.control, self.section)
        # A schedule in control.yaml would have precedence over the gains that are tested.
        if present.gain_schedule() is not None:
            control[self.section]["schedule"] = None

        # The actuator's delay is a block between the controllers and the plant.
        source, sink = self.delayed_ports
        size = self.channels(vehicle)
        delayed = {"kind": f"{_BLOCKS}DelayedActuator", "size": size, "period": period, "at_once": True}
        blocks = {"delay": delayed}
        connect = [[f"{EGO}.{source}", "delay.u"], ["delay.y", f"{EGO}.{sink}"]]
        diagram: Json = {
            "name": study.name,
            "world": study.world if study.folder is None else _absolute(study.world, Path(study.folder)),
            "vehicles": {
                EGO: {
                    "model": _vehicle_name(study),
                    "start": {"x": 0.0, "y": 0.0, "yaw": 0.0},
                    "speed": course.speed,
                    "control": control,
                }
            },
            "systems": blocks,
            "connect": connect,
            "plant": _plant(study, vehicle.control.rate, steps=_steps_per_period(vehicle.control.rate)),
            "record": {"rate": vehicle.control.rate, "meshcat": False, "report": False},
            "duration": course.duration,
            "seed": study.seed,
        }
        # Whole steps of the plant per period of the unit, so that updates are on steps.
        if "time_step" not in study.plant.model_fields_set and isinstance(vehicle.spec.tyres, SlipTyres):
            parts = assemble(make_spec(diagram)).parts
            longest = MOST_ANGLE / fastest_spin(parts.plant, parts.vehicles[EGO])
            steps = max(_steps_per_period(vehicle.control.rate), math.ceil(period / longest))
            diagram["plant"]["time_step"] = period / steps
        if noisy:  # the size of the plant's state is only known once it is built
            states = assemble(make_spec(diagram)).parts.plant.num_multibody_states()
            blocks["noise"] = {"kind": f"{_BLOCKS}NoisySensor", "size": states, "period": period}
            connect += [[f"{EGO}.plant_state", "noise.u"], ["noise.y", f"{EGO}.measured_state"]]
        return LoopSpec(
            kind=self.name,
            diagram=diagram,
            vehicle=EGO,
            gains={gain: Gain(unit, f"{self.section}.{gain}") for gain, unit in units.items()},
            reference=self.reference,
            output=self.output,
            effort=self.effort,
            output_unit=self.output_unit,
            effort_unit=self.effort_unit,
            course=course,
            period=period,
            settings=settings,
            filter_time=filter_time if settings else 0.0,
            delay=study.test.delay,
            friction=float(world.ground.mu),
            noisy=noisy,
            # Present gains can be compared only if the present controller has all of the gains.
            present=dict(zip(present.gains, present.gain_values(), strict=True))
            if set(units) <= set(present.gains)
            else {},
            present_kind=present.kind,
            test_control=test_control,
        )

    def gain_units(self, vehicle: Vehicle) -> dict[str, str]:  # noqa: ARG002
        """Return the unit of each gain: by default those of a PID controller of the joints."""
        return JOINT_CONTROLS[self.section]["pid"].gains

    def settings(self, filter_time: float) -> dict[str, float | str]:
        """Return entries of control.yaml that the gains need, by dotted path."""
        return {f"{self.section}.kind": "pid", f"{self.section}.filter": filter_time}

    def test_control(self, study: TuningSpec) -> dict[str, dict[str, object]]:  # noqa: ARG002
        """Return entries of control.yaml for the test, by section; they are not written to the vehicle."""
        return {}

    def channels(self, vehicle: Vehicle) -> int:
        """Return the number of channels of the delayed command."""
        return len(ElementTree.fromstring(vehicle.urdf).findall("transmission"))

    def course(self, study: TuningSpec, vehicle: Vehicle, speed: float | None) -> Course:
        """Return the test manoeuvre; a small or slow car drives more slowly."""
        test = study.test
        # Froude scaling relative to the wheelbase of a car. After the usual step of 2 m/s the speed is at most 90 % of
        # the largest set-point, so that the limit does not act.
        fastest = vehicle.control.speed.max_speed or math.inf
        scale = min(math.sqrt(vehicle.geometry.wheelbase / 2.6), 0.9 * fastest / (self.initial_speed + 2.0))
        initial = test.speed if speed is None else speed
        usual_step, load = self.default_step_and_load(vehicle, scale)
        # Values of the study have precedence over those of the kind of loop.
        step = usual_step if test.step is None else test.step
        duration = round(self.default_duration(study, vehicle, step), 1) if test.duration is None else test.duration
        return Course(
            speed=round(self.initial_speed * scale, 2) if initial is None else initial,
            step=step,
            step_time=test.step_time,
            load=load if test.load is None else test.load,
            load_time=0.6 * duration if test.load_time is None else test.load_time,
            duration=duration,
        )

    @abstractmethod
    def default_step_and_load(self, vehicle: Vehicle, scale: float) -> tuple[float, float]:
        """Return the default step [y] and load [u]; `scale` is that of speeds."""

    @abstractmethod
    def default_duration(self, study: TuningSpec, vehicle: Vehicle, step: float) -> float:
        """Return the default duration of the test [s], in which a step [y] can settle, and then a load."""

    # --- the loop on its bench ---

    def make_bench(self, spec: LoopSpec) -> PlantBench:
        """See :meth:`LoopKind.make_bench`."""
        return PlantBench(spec, self)

    @abstractmethod
    def identify(self, bench: PlantBench) -> "Identification":
        """Identify the loop by experiments on its bench.

        Raises:
            RunError: the plant could not be measured.
        """

    @abstractmethod
    def actuators(self, bench: PlantBench) -> tuple[JointActuator, ...]:
        """Return the actuators that the effort acts on."""

    def effort_limit(self, bench: PlantBench, actuator_limit: float) -> float:  # noqa: ARG002
        """Return the largest effort [u], from the smallest limit of the actuators [N m]."""
        return actuator_limit

    @abstractmethod
    def noisy_states(self, bench: PlantBench) -> list[int]:
        """Return the elements of the plant's state that the loop measures."""

    @abstractmethod
    def output_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the output [y] of each column of plant states."""

    def measured_from(self, bench: PlantBench, state: Floats) -> Floats:
        """Return the signal that the controller of the loop measures, of each column of plant states."""
        return self.output_from(bench, state)

    @abstractmethod
    def reference_from(self, bench: PlantBench, status: Floats) -> Floats:
        """Return the set-point [y] from the signals of the vehicle's status, shape (signals, samples)."""

    def effort_from(self, bench: PlantBench, context: Context) -> Floats:
        """Return the logged effort [u]."""
        log = bench.assembly.taps[f"{bench.spec.vehicle}.joint_torques"]
        return np.array(log.data(context)[bench.channels[0]], dtype=float)

    def other_signals(self, bench: PlantBench, state: Floats, output: Floats) -> dict[str, Floats]:  # noqa: ARG002
        """Return further signals that must not oscillate [y], by what oscillates then."""
        return {}

    @abstractmethod
    def initial_output(self, bench: PlantBench) -> float:
        """Return the output before the step [y]."""

    @abstractmethod
    def command_after_step(self, bench: PlantBench) -> tuple[float, float]:
        """Return the set-points of speed [m/s] and steering [rad] after the step."""


def _vehicle_name(study: TuningSpec) -> str:
    name, mark, variant = str(study.vehicle).partition("@")
    return str(study.vehicle) if study.folder is None else f"{_absolute(name, Path(study.folder))}{mark}{variant}"


def _steps_per_period(rate: float) -> int:
    """Return the default number of steps of the plant per period of the controller: at least that of a diagram.

    The slip of a light wheel on a stiff tyre decays within milliseconds: at a step of 20 ms it oscillates whatever the
    gains.
    """
    return max(2, math.ceil(1.0 / (rate * PlantSpec().time_step)))


def fastest_spin(plant: MultibodyPlant, part: VehicleInPlant) -> float:
    """Return the largest frequency with which a wheel oscillates on its tyre [rad/s], from ω² = C h² / (σ J).

    C is the slip stiffness, h the rolling radius, σ the relaxation length, J the inertia of the spin.
    """
    wheels, (_, laws) = make_spinning_wheels(plant, part), wheel_laws(part)
    frequencies = []
    for wheel, law in zip(wheels, laws, strict=True):
        contact = law(wheel.static_load, 0.0, 1.0).contact
        frequencies.append(wheel.radius * math.sqrt(contact.stiffness_x / (contact.length_x * wheel.inertia)))
    return max(frequencies)


def _plant(study: TuningSpec, rate: float, *, steps: int) -> dict[str, object]:
    """Return the settings of the plant: vertical tyres and the longest step that is accurate, if the study has none.

    With vertical tyres the plant is continuous, which takes less than half of the time of point contact.
    """
    usual = {"contact": STUDY_CONTACT, "time_step": 1.0 / rate / steps, "machine_code": True}
    return usual | study.plant.model_dump(exclude_unset=True)

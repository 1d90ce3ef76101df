"""Vehicles driven by pedals: the pedal controller, the connections, and cars on the road."""

import shutil
from dataclasses import replace
from math import radians, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from mirdrake.assembly.diagram import assemble, make_diagram
from mirdrake.controllers import VehicleControl
from mirdrake.controllers.schedule import ConstantCommand
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.plant.powertrain import Measured, PowertrainLaw
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track import make_single_track_vehicle
from mirdrake.vehicles import Vehicle, load_vehicle
from mirdrake.vehicles.joint_control.pedals import PedalControl, PedalLaw, PedalState
from mirdrake.vehicles.powertrain_spec import Actuators, SteeringActuator
from mirdrake.worlds import load_world

RADIUS = 0.3175
STEP_UP = [{"time": 0, "speed": 0}, {"time": 0.5, "speed": 0}, {"time": 0.6, "speed": 20}]


@pytest.fixture(scope="module")
def bolt() -> Vehicle:
    return load_vehicle("bolt@handling")


def foot_of(vehicle: Vehicle, **actuators) -> tuple[PedalLaw, PowertrainLaw]:
    spec = vehicle.spec.model_copy(update={"actuators": Actuators(**actuators)})
    law = PowertrainLaw(spec, radii=(RADIUS,) * 4, mass=1616.0, wheelbase=2.6, rotating=60.0, period=0.01)
    return PedalLaw(PedalControl(kind="pedals"), law, spec, 0.02), law


def rolling(speed: float) -> Measured:
    return Measured((speed / RADIUS,) * 4, (speed,) * 4, speed)


# --- the law -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bolt", "mkz", "unior"])
@pytest.mark.parametrize("acceleration", [2.0, 0.5, 0.0, -0.05, -3.0])
def test_the_pedals_give_the_force_that_is_wanted(name, acceleration):
    foot, law = foot_of(load_vehicle(f"{name}@handling"))
    speed = 2.5  # no gear is being changed
    _, pedals = foot.advance(PedalState(), speed, acceleration, speed, gains=foot.numbers([1.0, 0.3]))
    _, torques = law.step(law.rest(speed), pedals, rolling(speed))
    spec = load_vehicle(f"{name}@handling").spec
    resistance = spec.tyres.rolling_resistance * 1616.0 * 9.80665 + 0.6 * spec.aerodynamics.drag_area * speed**2
    required_force = 1676.0 * acceleration + resistance
    most = law.limits(1.0, speed / RADIUS)[1] / RADIUS
    force = (sum(torques.drive) - sum(torques.brake)) / RADIUS
    assert force == pytest.approx(np.clip(required_force, -spec.brakes.max_torque / RADIUS, most), rel=1e-9, abs=1e-6)
    assert pedals.throttle == 0.0 or pedals.brake == 0.0


def test_a_standstill_command_holds_the_brake_and_resets_the_integral():
    foot, law = foot_of(load_vehicle("bolt@handling"))
    state = PedalState(1.0, PedalState().loop._replace(integral=500.0))
    state, pedals = foot.advance(state, 0.0, 0.0, 0.2, gains=foot.numbers([1.0, 0.5]))
    assert state == PedalState()
    assert pedals.throttle == 0.0
    _, torques = law.step(law.rest(), pedals, rolling(0.0))
    assert sum(torques.brake) == pytest.approx(0.3 * 1616.0 * 9.80665 * RADIUS)


def test_the_gear_changes_at_standstill_only():
    foot, _ = foot_of(load_vehicle("bolt@handling"))
    gains = foot.numbers([1.5, 0.5])
    state, pedals = foot.advance(PedalState(), -2.0, -3.0, 4.0, gains=gains)
    assert (pedals.gear, pedals.throttle) == (1.0, 0.0)
    assert pedals.brake > 0.1
    state, pedals = foot.advance(state, -2.0, -3.0, 0.1, gains=gains)
    assert pedals.gear == -1.0
    assert pedals.throttle > 0.1


# --- the control unit --------------------------------------------------------------------------------------------


def unit_of(vehicle: Vehicle) -> tuple[MultibodyPlant, VehicleControl]:
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle}, spec=PlantSpec(contact="point"))
    return parts.plant, VehicleControl(parts.plant, parts.vehicles["ego"])


def steering_of(vehicle: Vehicle, count: int = 12) -> np.ndarray:
    """Return set-points of the left steering joint over the first updates of a step command."""
    plant, control = unit_of(vehicle)
    context = control.CreateDefaultContext()
    control.plant_state.FixValue(context, plant.GetPositionsAndVelocities(plant.CreateDefaultContext()).copy())
    angles = []
    for number in range(count):
        context.SetTime(0.02 * number)
        control.command.FixValue(context, [0.0, 0.2, 0.02 * number])
        control._update(context, context.get_mutable_state())
        desired = control.desired_state.Eval(context)[: len(control.desired_state.Eval(context)) // 2]
        angles.append(np.abs(desired).max())
    return np.array(angles)


def test_the_steering_actuator_delays_the_set_point_of_the_joints(bolt):
    plain = steering_of(bolt)
    late = SteeringActuator(delay=0.04)
    actuators = bolt.spec.actuators.model_copy(update={"steering": late})
    delayed = steering_of(replace(bolt, spec=bolt.spec.model_copy(update={"actuators": actuators})))
    assert plain[0] > 0.0
    assert not delayed[:2].any()
    assert delayed[2:] == pytest.approx(plain[:-2])


def test_a_steering_delay_off_the_control_period_is_rejected(bolt):
    actuators = bolt.spec.actuators.model_copy(update={"steering": SteeringActuator(delay=0.03)})
    with pytest.raises(ConfigError, match=r"delay: 0\.03 s is not a multiple of the 0\.02 s"):
        unit_of(replace(bolt, spec=bolt.spec.model_copy(update={"actuators": actuators})))


def test_pedals_leave_the_wheels_to_the_tyres_and_carry_the_rotor(bolt):
    plant, control = unit_of(bolt)
    assert control.HasOutputPort("pedals")
    rotor = 0.5 * 0.04 * 7.05**2
    results = {}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if "wheel" in actuator.name():
            assert not actuator.has_controller()
            results[actuator.joint().name()] = actuator.default_rotor_inertia()
    driven = [value for name, value in results.items() if name.startswith("front")]
    assert driven == pytest.approx([rotor, rotor])
    assert sum(results.values()) == pytest.approx(2.0 * rotor)


# --- files and wiring --------------------------------------------------------------------------------------------


def test_pedals_on_tyres_without_a_torque_input_are_rejected(tmp_path):
    folder = shutil.copytree(load_vehicle("bolt").folder, tmp_path / "car", ignore=shutil.ignore_patterns("variants"))
    text = (folder / "control.yaml").read_text()
    start = text.index("wheel_speed:")
    changed = text[:start] + "wheel_speed:\n  kind: pedals\n" + text[text.index("steering:") :]
    (folder / "control.yaml").write_text(changed)
    line = changed[:start].count("\n") + 2
    with pytest.raises(
        ConfigError, match=rf"control\.yaml:{line}: wheel_speed\.kind: pedals drive tyres of kind brush"
    ):
        load_vehicle(str(folder))


DRIVER = '''
from pydrake.systems.framework import LeafSystem


class Foot(LeafSystem):
    """Presses the throttle for a second, then nothing."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("command", 3, lambda context, out: out.SetFromVector([0, 0, context.get_time()]))
        self.DeclareVectorOutputPort("pedals", 3, self._press)

    def _press(self, context, out):
        out.SetFromVector([0.5 if context.get_time() < 1.0 else 0.0, 0, 1])
'''


def own_driver(tmp_path: Path, model: str) -> dict[str, Any]:
    (tmp_path / "my_foot.py").write_text(DRIVER)
    return {"world": "empty", "vehicles": {"ego": {"model": model}}, "control": {"ego": {"kind": "my_foot:Foot"}}}


def test_a_driver_with_pedals_presses_them_itself(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    signals = Simulation(assemble(own_driver(tmp_path, "bolt@handling"))).run(duration=1.5).signals
    throttle = signals["ego.powertrain.throttle"]
    assert throttle.loc[0.9:0.99].min() == pytest.approx(0.5, abs=1e-6)
    assert throttle.iloc[-1] < 1e-3
    assert signals["ego.vx"].iloc[-1] > 1.5


def test_a_driver_with_pedals_needs_a_vehicle_with_pedals(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=r"control\.ego: this driver presses pedals, but bolt has none"):
        assemble(own_driver(tmp_path, "bolt"))


def test_pedals_can_be_taken_from_any_block_and_read_by_any():
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt@handling"}},
        "control": {"ego": {"kind": "constant", "speed": 5.0}},
        "systems": {"foot": {"kind": "constant", "value": [0.0, 0.4, 0.0]}},
        "connect": [["foot.y", "ego.pedals_reference"]],
    }
    signals = Simulation(assemble(spec)).run(duration=1.0).signals
    assert signals["ego.powertrain.brake"].iloc[-1] == pytest.approx(0.4, abs=0.01)
    assert abs(signals["ego.vx"].iloc[-1]) < 0.05
    diagram = make_diagram({"world": "empty", "vehicles": {"ego": {"model": "bolt@handling"}}})
    assert {"ego.control", "ego.powertrain", "ego.tyres"} <= {system.get_name() for system in diagram.GetSystems()}


# --- on the road -------------------------------------------------------------------------------------------------


def test_the_bolt_follows_a_speed_schedule_with_its_pedals_and_stops():
    rows = [*STEP_UP, {"time": 9, "speed": 20}, {"time": 9.1, "speed": 0}]
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt@handling"}},
        "control": {"ego": {"kind": "schedule", "rows": rows}},
        "plant": {"contact": "point"},
    }
    signals = Simulation(assemble(spec)).run(duration=18.0).signals
    error = (signals["ego.vx"] - signals["ego.speed_setpoint"]).loc[1.5:13.0].abs()
    assert error.max() < 0.8  # 0.13 s of delay and lag in the brake at 5 m/s²
    assert error.mean() < 0.15
    assert signals["ego.vx"].loc[8.0:9.0].mean() == pytest.approx(20.0, abs=0.05)
    stood = signals.loc[16.0:]
    assert np.ptp(stood["ego.x"]) < 1e-4
    assert stood["ego.powertrain.throttle"].max() < 1e-6
    assert stood["ego.powertrain.brake_torque"].min() > 1000.0
    assert signals["ego.powertrain.drive_torque"].min() < -1000.0  # the motor takes its part of the braking


@pytest.fixture
def slope_world(tmp_path):
    path = tmp_path / "slope.yaml"
    path.write_text(
        "mirdrake: world/1\nname: slope\n"
        f"ground: {{surface: asphalt, mu: 0.9, slope: {{grade: {tan(radians(5.0))}, heading: 0 deg}}}}\n"
        "start: {origin: {at: [0, 0], yaw: 0}}\n"
    )
    return str(path)


def test_the_bolt_holds_on_a_slope_and_starts_up_it(slope_world):
    rows = [{"time": 0, "speed": 0}, {"time": 8, "speed": 0}, {"time": 8.1, "speed": 5}, {"time": 12, "speed": 5}]
    spec = {
        "world": slope_world,
        "vehicles": {"ego": {"model": "bolt@handling"}},
        "control": {"ego": {"kind": "schedule", "rows": rows}},
        "plant": {"contact": "point"},
    }
    signals = Simulation(assemble(spec)).run(duration=12.0).signals
    position = signals["ego.x"].loc[4.0:8.0]
    assert np.ptp(position) < 1e-4
    assert signals["ego.x"].loc[8.0:].min() > position.min() - 0.01  # it does not roll back
    assert signals["ego.vx"].iloc[-1] == pytest.approx(5.0, abs=0.4)


def test_full_and_reduced_model_have_the_same_speed_under_the_same_pedals(tmp_path):
    model = shutil.copytree(data_root() / "models" / "bolt", tmp_path / "bolt")
    file = model / "variants" / "handling.yaml"  # the reduced model has no wheels whose slip is held
    file.write_text(file.read_text(encoding="utf-8").replace("traction: true", "traction: false"), encoding="utf-8")
    builder = DiagramBuilder()
    car = builder.AddSystem(make_single_track_vehicle(load_vehicle(f"{model}@handling"), tyres="brush"))
    driver = builder.AddSystem(ConstantCommand(10.0))
    builder.Connect(driver.get_output_port(), car.GetInputPort("command"))
    log = LogVectorOutput(car.GetOutputPort("state"), builder, 0.1)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(6.0)
    reduced = log.FindLog(simulator.get_context())
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": f"{model}@handling"}},
        "control": {"ego": {"kind": "constant", "speed": 10.0}},
        "plant": {"contact": "point"},
    }
    full = Simulation(assemble(spec)).run(duration=6.0).signals
    speeds = np.interp(reduced.sample_times(), full.index.to_numpy(), full["ego.vx"].to_numpy())
    assert reduced.data()[6] == pytest.approx(speeds, abs=0.25)
    assert reduced.data()[6, -1] == pytest.approx(10.0, abs=0.1)

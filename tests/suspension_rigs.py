"""Cars on springs with the parameters of the tests, on point contact, under constant forces."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantValueSource, ConstantVectorSource, VectorLogSink

from mirdrake.core.paths import data_root
from mirdrake.plant.plant import PlantParts, PlantSpec, VehicleInPlant, make_plant, set_start
from mirdrake.plant.suspension import make_axle_forces, make_bump_stops
from mirdrake.plant.wheels import WheelTyres
from mirdrake.sensors.ground_truth import vehicle_state
from mirdrake.vehicles import Vehicle, make_vehicle, render_xacro
from mirdrake.vehicles.mounts import SensorsSpec
from mirdrake.vehicles.spec import ControlSpec, VariantSpec, VehicleSpec
from mirdrake.vehicles.vehicle import MAIN_FILE, load_part
from mirdrake.worlds import World, load_world
from tests.rigs import add_tyres, free_rolling

GRAVITY = 9.80665
FRONT = {"stiffness": 28000.0, "damping": 2000.0, "anti_roll": 20000.0}
REAR = {"stiffness": 27000.0, "damping": 1800.0, "anti_roll": 9000.0}
TYRE = 2e5  # N/m, point contact
JOINTS = {
    f"{axle}_{side}": f"{axle}_{side}_suspension_joint" for axle in ("front", "rear") for side in ("left", "right")
}


def on_springs(
    model: str = "bolt", *, front: Mapping[str, Any] = FRONT, rear: Mapping[str, Any] = REAR, **arguments: str
) -> Vehicle:
    """Return a reference vehicle on these springs; nothing drives or brakes its wheels."""
    springs = {"front": dict(front), "rear": dict(rear)}
    changed: dict[str, Any] = {"joints": {"suspension": JOINTS}, "suspension": springs}
    values = {"suspension": "true", **arguments}
    change = VariantSpec(description="on springs", arguments=values, vehicle=changed)
    folder = data_root() / "models" / model
    spec = load_part(folder, "vehicle", VehicleSpec, change)
    control = load_part(folder, "control", ControlSpec, change)
    sensors = load_part(folder, "sensors", SensorsSpec, change)
    urdf = render_xacro(folder / MAIN_FILE, arguments=values, defaults={"drive": spec.drive})
    return free_rolling(make_vehicle(urdf, folder=folder, spec=spec, control=control, sensors=sensors))


@dataclass
class PushedCar:
    """A car with held wheels and straight steering, under constant generalised forces on its body."""

    parts: PlantParts
    part: VehicleInPlant
    tyres: WheelTyres
    simulator: Simulator
    log: VectorLogSink

    def advance(self, duration: float) -> None:
        """Simulate on for a time [s]."""
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + duration)

    @property
    def loads(self) -> np.ndarray:
        """Normal load of each wheel [N]."""
        return np.array(self.tyres.wheel_load.Eval(self.tyres.GetMyContextFromRoot(self.simulator.get_context())))

    @property
    def state(self) -> np.ndarray:
        """State of the plant."""
        plant = self.parts.plant
        return np.array(plant.get_state_output_port().Eval(plant.GetMyContextFromRoot(self.simulator.get_context())))

    @property
    def travel(self) -> np.ndarray:
        """Return the travel of the four wheels [m]."""
        return self.state[[joint.position_start() for joint in self.part.suspension]]

    def lift(self, heave: float, pitch: float = 0.0) -> None:
        """Move the body up [m] and turn it nose down [rad] about the rear axle, the wheels staying where they are."""
        plant = self.parts.plant
        context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        q = plant.GetPositions(context).copy()
        start = self.part.base.floating_positions_start()
        X_WB = plant.GetFreeBodyPose(context, self.part.base)
        rpy = RollPitchYaw(X_WB.rotation())
        q[start + 6] += heave
        for joint, x in zip(self.part.suspension, [self.part.vehicle.geometry.wheelbase] * 2 + [0.0] * 2, strict=True):
            q[joint.position_start()] -= heave - pitch * x
        plant.SetPositions(context, q)
        X_WB = RigidTransform(RollPitchYaw(0.0, rpy.pitch_angle() + pitch, 0.0), q[start + 4 : start + 7])
        plant.SetFreeBodyPose(context, self.part.base, X_WB)

    def pose(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return times [s], height of the vehicle frame [m], pitch and roll [rad] of the log."""
        log = self.log.FindLog(self.simulator.get_context())
        start = self.part.base.floating_positions_start()
        states = vehicle_state(log.data()[start : start + 7], np.zeros((6, log.num_samples())))
        return log.sample_times(), states[2], states[4], states[3]


def pushed_car(
    vehicle: Vehicle,
    *,
    force: tuple[float, float, float] = (0.0, 0.0, 0.0),
    step: float = 0.0025,
    parked: bool = True,
    world: str | World = "empty",
) -> PushedCar:
    """Return a car at rest; the force [N], in world axes, acts at its centre of mass from the start."""
    builder = DiagramBuilder()
    spec = PlantSpec(time_step=step, contact="point")
    world = load_world(world) if isinstance(world, str) else world
    parts = make_plant(builder, world, {"ego": vehicle}, spec=spec, parked=["ego"] if parked else [])
    plant, part = parts.plant, parts.vehicles["ego"]
    tyres = add_tyres(builder, parts)
    com = plant.CalcCenterOfMassPositionInWorld(plant.CreateDefaultContext(), [part.instance])
    push = ExternallyAppliedSpatialForce()
    push.body_index, push.p_BoBq_B = part.base.index(), com
    push.F_Bq_W = SpatialForce(np.zeros(3), np.array(force))
    pushed = builder.AddSystem(ConstantValueSource(Value[list[ExternallyAppliedSpatialForce]]([push])))
    builder.Connect(pushed.get_output_port(), plant.get_applied_spatial_force_input_port())
    more = [one for one in (make_axle_forces(plant, part), make_bump_stops(plant, part)) if one is not None]
    total = builder.AddSystem(Adder(1 + len(more), plant.num_velocities()))
    builder.Connect(tyres.generalized_force, total.get_input_port(0))
    for index, one in enumerate(more, start=1):
        builder.AddSystem(one)
        builder.Connect(plant.get_state_output_port(part.instance), one.get_input_port())
        builder.Connect(one.get_output_port(), total.get_input_port(index))
    builder.Connect(total.get_output_port(), plant.get_applied_generalized_force_input_port())
    straight = builder.AddSystem(ConstantVectorSource(np.zeros(2 * plant.num_actuators(part.instance))))
    builder.Connect(straight.get_output_port(), plant.get_desired_state_input_port(part.instance))
    log = builder.AddSystem(VectorLogSink(plant.num_multibody_states(), publish_period=0.01))
    builder.Connect(plant.get_state_output_port(), log.get_input_port())
    simulator = Simulator(builder.Build())
    set_start(plant, plant.GetMyMutableContextFromRoot(simulator.get_mutable_context()), part, x=0.0, y=0.0, yaw=0.0)
    return PushedCar(parts, part, tyres, simulator, log)

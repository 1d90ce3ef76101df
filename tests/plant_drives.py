"""Drives of the full plant with cargo, set in its Context, with sensor noise."""

from functools import cache

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import make_spec
from mirdrake.identification import DataSet, Log
from mirdrake.sensors.ground_truth import vehicle_state

CARGO = ((160.0, (3.3, 0.0, 0.6)), (190.0, (-0.7, 0.0, 0.6)))
"""Point masses in the nose and in the boot: mass [kg], place in the vehicle frame [m]."""

NOISE = {
    "vx": 0.02, "vy": 0.02, "yaw_rate": 0.003, "longitudinal_acceleration": 0.1, "lateral_acceleration": 0.1,
    "drive_torque": 5.0, "road_wheel_angle": 0.0003,
}  # fmt: skip


def _diagram(step, contact):
    return {
        "name": "drive with cargo",
        "world": "empty",
        "vehicles": {
            "ego": {
                "model": "bolt@handling",
                "start": {"x": 0.0, "y": 0.0},
                "speed": 14.0,
                "control": {"dead_man": 1e6},
            }
        },
        "systems": {
            "slow": {"kind": "sine", "amplitude": 0.015, "frequency": 0.3},
            "quick": {"kind": "sine", "amplitude": 0.015, "frequency": 1.3},
            "sum": {"kind": "adder", "inputs": 2},
        },
        "connect": [["slow.y0", "sum.u0"], ["quick.y0", "sum.u1"], ["sum.sum", "ego.steering_reference"]],
        "plant": {"contact": contact, "time_step": step},
        "record": {"rate": 1.0 / step, "meshcat": False, "report": False},
    }


@cache
def drive_with_cargo(duration=6.0, step=0.005, contact="point", cargo=CARGO):
    """Return exact channels at 200 Hz, and the true mass, centre of mass before the rear axle, and yaw inertia."""
    assembly = assemble(make_spec(_diagram(step, contact)))
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    context = assembly.make_context()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    loaded = part.base.CalcSpatialInertiaInBodyFrame(plant_context)
    for mass, location in cargo:
        loaded += SpatialInertia(mass, location, UnitInertia.PointMass(location))
    part.base.SetSpatialInertiaInBodyFrame(plant_context, loaded)
    level = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(level, part.base, RigidTransform())
    part.base.SetSpatialInertiaInBodyFrame(level, loaded)
    whole = plant.CalcSpatialInertia(level, plant.world_frame(), plant.GetBodyIndices(part.instance))
    com = whole.get_com()
    turn = whole.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()[2, 2]
    truth = {
        "mass": float(whole.get_mass()),
        "rear_length": float(com[0]),
        "com_height": float(com[2]),
        "yaw_inertia": float(turn),
    }

    simulator = Simulator(assembly.diagram, context)
    for port, value in (("speed_reference", 14.0), ("reference_stamp", 0.0)):
        assembly.diagram.GetInputPort(f"ego.{port}").FixValue(context, [value])
    simulator.Initialize()
    wait = 1.5
    for switch_time, speed in (
        (wait, 14.0),
        (wait + 0.4 * duration, 22.0),
        (wait + 0.7 * duration, 15.0),
        (wait + duration, 20.0),
    ):
        assembly.diagram.GetInputPort("ego.speed_reference").FixValue(context, [speed])
        simulator.AdvanceTo(switch_time)
    tap = assembly.taps["plant_state"]
    x, time = np.array(tap.data(context)), np.array(tap.times(context))
    status = np.array(assembly.taps["ego.powertrain_status"].data(context))
    positions = plant.num_positions()
    state = vehicle_state(
        x[part.base.floating_positions_start() :][:7],
        x[positions + part.base.floating_velocities_start_in_v() :][:6],
    )
    angle = np.mean([x[joint.position_start()] for joint in part.steering], axis=0)
    vx, vy, turn = state[6], state[7], state[11]
    ahead = plant.CalcCenterOfMassPositionInWorld(_unloaded(plant, part), [part.instance])[0]
    slope = [np.gradient(values, time) for values in (vx, vy, turn)]
    channels = {
        "vx": vx,
        "vy": vy + ahead * turn,
        "yaw_rate": turn,
        "longitudinal_acceleration": slope[0] - vy * turn - ahead * turn**2,
        "lateral_acceleration": slope[1] + vx * turn + ahead * slope[2],
        "road_wheel_angle": angle,
        "drive_torque": status[6],
        "brake_torque": status[7],
        "throttle": status[0],
        "brake": status[1],
    }
    keep = time >= wait - 1e-9
    return time[keep] - wait, {name: values[keep] for name, values in channels.items()}, truth


def _unloaded(plant, part):
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    return context


def noisy(exact, seed=0, names=None, every=2, use="train"):
    """Return the exact drive as measured by the sensors of a car, at 100 Hz."""
    time, channels, _ = exact
    random = np.random.default_rng(seed)
    noisy_channels = {
        name: (values + NOISE.get(name, 0.0) * random.standard_normal(len(values)))[::every]
        for name, values in channels.items()
        if names is None or name in names
    }
    return Log(f"drive {seed}", use, time[::every], noisy_channels)


def data_set(*logs):
    return DataSet(tuple(logs))

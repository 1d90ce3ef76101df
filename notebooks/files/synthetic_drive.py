"""Drives of a known car, as logs with the noise and the offsets of sensors."""

import numpy as np
import pandas as pd
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

import mirdrake as mir
from mirdrake.single_track import make_single_track

random = np.random.default_rng(1)
bolt = mir.load_vehicle("bolt")


def drive(angle, speed, name, delay=0.04, step=0.01):
    """Simulate a drive of the single track, write it into a CSV file, and return it.

    Args:
        angle: set-point of the steering at each step [rad].
        speed: initial speed [m/s].
        name: the file.
        delay: delay of the steering, which is not in the log [s].
        step: [s].
    """
    time = step * np.arange(len(angle))
    builder = DiagramBuilder()
    car = builder.AddSystem(make_single_track(bolt))
    steering = PiecewisePolynomial.FirstOrderHold(time, np.interp(time - delay, time, angle)[None])
    builder.Connect(builder.AddSystem(TrajectorySource(steering)).get_output_port(), car.GetInputPort("steering"))
    pedals = builder.AddSystem(ConstantVectorSource([400.0, 0.0]))  # drive and brake force [N]
    builder.Connect(pedals.get_output_port(), car.GetInputPort("forces"))
    logs = [LogVectorOutput(car.GetOutputPort(port), builder, step) for port in ("state", "motion")]
    simulator = Simulator(builder.Build())
    start = [speed if name == "vx" else 0.0 for name in car.state_names]
    car.GetMyMutableContextFromRoot(simulator.get_mutable_context()).SetContinuousState(start)
    simulator.AdvanceTo(time[-1])
    state, motion = (log.FindLog(simulator.get_context()).data() for log in logs)
    yaw, vx, yaw_rate, ay = state[5], state[6], state[11], motion[2]
    table = pd.DataFrame({"t": time, "steer_deg": np.degrees(angle)})
    table["v_kmh"] = 3.6 * (vx + random.normal(0, 0.02, len(time)))
    table["gyro_z_deg"] = np.degrees(yaw_rate + random.normal(0.002, 0.003, len(time)))
    table["heading_deg"] = np.degrees(yaw + random.normal(0, 0.001, len(time)))
    table["ay"] = ay + random.normal(-0.05, 0.1, len(time))
    table.to_csv(name, index=False)
    return table

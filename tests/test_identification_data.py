"""Recorded drives and their check: every oddity that real logs have is put into a clean one, and found with its number."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from scipy.io import savemat
from scipy.signal import butter, sosfiltfilt

from mirdrake.errors import ConfigError, MirdrakeError
from mirdrake.identification import DataSet, Log, check_data, load_data
from mirdrake.identification.alignment import delay_of
from mirdrake.identification.channels import CHANNELS, unit_factor
from mirdrake.identification.readers import FORMATS
from mirdrake.identification.samples import find_glitches
from mirdrake.identification.timing import hold_of
from mirdrake.logs import RunWriter
from mirdrake.single_track import SingleTrack, SingleTrackParameters

CAR = SingleTrackParameters(
    mass=1500.0, yaw_inertia=2400.0, front_length=1.2, rear_length=1.5, front_stiffness=90e3, rear_stiffness=110e3
)
STEP, FINE = 0.01, 0.0025
NOISE = {
    "vx": 0.01, "vy": 0.005, "yaw_rate": 0.002, "yaw": 0.0005,
    "longitudinal_acceleration": 0.05, "lateral_acceleration": 0.05, "road_wheel_angle": 0.0003,
}  # fmt: skip


def drive(seconds: float = 40.0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A drive with steering and pedals that sweep, without noise, on steps of FINE."""
    model = SingleTrack(CAR)
    simulator = Simulator(model)
    context = simulator.get_mutable_context()
    model.set_state(context, vx=15.0)
    steering, forces = model.steering.FixValue(context, [0.0]), model.forces.FixValue(context, [0.0, 0.0, 0.0])
    ResetIntegratorFromFlags(simulator, "runge_kutta3", FINE)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.Initialize()
    time = np.arange(round(seconds / FINE)) * FINE
    angle = 0.03 * (np.sin(2.0 * time) + 0.7 * np.sin(2.0 * np.pi * (0.3 + 0.02 * time) * time))
    force = 3500.0 * np.sin(0.8 * time) + 1500.0 * np.sin(2.3 * time)
    states, motions = [], []
    for at, turn, push in zip(time, angle, force, strict=True):
        steering.GetMutableData().SetFrom(type(steering.get_value())([turn]) if False else _vector([turn]))
        forces.GetMutableData().SetFrom(_vector([max(push, 0.0), max(-push, 0.0), 0.0]))
        states.append(model.state.Eval(context).copy())
        motions.append(model.motion.Eval(context).copy())
        simulator.AdvanceTo(at + FINE)
    return time, {"state": np.array(states), "motion": np.array(motions), "angle": angle, "force": force}

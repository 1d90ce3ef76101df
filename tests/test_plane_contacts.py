"""On the plane, the contact that bears the wheels does not decide about the motion of a vehicle."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context

from mirdrake.plant.plant import PlantSpec
from mirdrake.plant.wheels.tyre_forces import _Equations
from mirdrake.vehicles import WHEELS
from tests.ground_rigs import WHEEL_LOADS, drive
from tests.marks import mostly_slow
from tests.rigs import GRAVITY, coasting_car

CONTACTS = ("point", "tyre", "hydroelastic")


def mean_end(folder: Path, **settings: object) -> dict[str, float]:
    """Return the means of the last 0.3 s of a drive of 4 s."""
    signals = drive(folder, duration=4.0, **settings)
    end = signals.tail(60).mean()
    return {"load": float(end[WHEEL_LOADS].sum()), **{str(name): float(end[name]) for name in end.index}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "speed", "steering"),
    [
        ("bolt@handling", 15.0, 0.06),
        ("mkz@handling", 15.0, 0.06),
        ("catvehicle@handling", 15.0, 0.06),
        ("unior@handling", 4.0, 0.1),
        ("bolt", 8.0, 0.16),
        ("unior", 1.6, 0.2),
    ],
)
def test_a_steady_turn_is_the_same_on_every_contact(tmp_path: Path, model: str, speed: float, steering: float) -> None:
    ends = [mean_end(tmp_path, model=model, contact=c, speed=speed, steering=steering) for c in CONTACTS]
    weight = ends[0]["load"]
    for end in ends[1:]:
        # Drake's load of a patch on 64 facets differs from the closed form, by 0.1 % upright and more when inclined.
        # The difference bears the vehicle, too, but is not in the loads.
        assert end["load"] == pytest.approx(weight, rel=2e-3)
        for name in ("ego.wz", "ego.vx"):
            assert end[name] == pytest.approx(ends[0][name], rel=2e-3)
        # 0.1 % of a deflection of 8 mm on either side of a track of 0.5 m is a roll angle of 3e-5 rad.
        assert end["ego.roll"] == pytest.approx(ends[0]["ego.roll"], rel=5e-3, abs=3e-5)
        assert end["ego.z"] == pytest.approx(ends[0]["ego.z"], abs=2e-4)
        for name in WHEEL_LOADS:
            assert end[name] == pytest.approx(ends[0][name], abs=1e-3 * weight)


def test_each_step_is_solved_once_and_the_log_has_its_torques(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log at an update of the control unit does not make the plant solve its step twice."""
    solved, solve = [0], _Equations._solve

    def counted(system: _Equations, context: Context) -> None:
        solved[0] += 1
        solve(system, context)

    monkeypatch.setattr(_Equations, "_solve", counted)
    torques = {}
    for contact in ("tyre", "point"):
        solved[0] = 0
        signals = drive(tmp_path, model="bolt", contact=contact, step=0.005, rows=[(0.0, 1.0, 0.1)], duration=0.5)
        assert solved[0] == 100 + (contact == "tyre")  # a continuous plant also has forces before its first step
        torques[contact] = signals[[f"ego.wheel_torque.{wheel}" for wheel in WHEELS]].to_numpy()
        assert not torques[contact][0].any()  # there was no step yet
    # Both are those of the last step. One step apart they would differ by three quarters of the largest torque.
    assert torques["point"] == pytest.approx(torques["tyre"], abs=0.05 * np.abs(torques["tyre"]).max())


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_the_loads_of_a_bouncing_and_rolling_car_are_its_weight_and_inertia(contact: str) -> None:
    """The acceleration is that of the plant, with the forces of Drake's contact: it does not know the logged loads."""
    step = 0.000625
    car = coasting_car(10.0, PlantSpec(time_step=step, contact=contact))
    plant = car.parts.plant
    context = plant.GetMyMutableContextFromRoot(car.simulator.get_mutable_context())
    base = car.part.base
    pose = plant.GetFreeBodyPose(context, base)
    lower = RigidTransform(RollPitchYaw(0.006, 0.0, 0.0).ToQuaternion(), pose.translation() - [0.0, 0.0, 0.006])
    plant.SetFreeBodyPose(context, base, lower)
    car.advance(0.5 * step)  # between two steps, so that each advance makes one of them
    mass, momenta, loads = plant.CalcTotalMass(context), [], []
    for _ in range(400):
        momenta.append(mass * plant.CalcCenterOfMassTranslationalVelocityInWorld(context)[2])
        car.advance(step)
        loads.append(car.loads.sum())
    needed = np.diff(momenta) / step + mass * GRAVITY
    assert np.ptp(needed) > 0.2 * mass * GRAVITY
    # The damping of the loads has the velocity at the beginning of a step, that of the plant the one at its end: an
    # error of the first order, up to 440 N at steps of 5 ms.
    assert needed == pytest.approx(np.array(loads[:-1]), abs=0.01 * mass * GRAVITY)


@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
@pytest.mark.parametrize("speed", mostly_slow([5.0, 10.0, 20.0, 30.0]))
def test_coast_down_and_rolling_radius_at_steps_of_20_milliseconds(contact: str, speed: float) -> None:
    car = coasting_car(speed, PlantSpec(time_step=0.02, contact=contact))
    car.advance(0.6)
    before = car.speed
    car.advance(2.0)
    # Inertia with that of the wheels, four cylinders of 20 kg.
    mass = 1616.0 + 4.0 * 0.5 * 20.0
    assert (before - car.speed) / 2.0 * mass / (1616.0 * GRAVITY) == pytest.approx(0.0079, rel=0.02)
    plant = car.parts.plant
    velocities = plant.GetVelocities(plant.GetMyContextFromRoot(car.simulator.get_context()))
    spins = np.array([velocities[joint.velocity_start()] for joint in car.part.wheels])
    front, rear = car.part.rolling_radii(plant)
    assert car.speed / spins == pytest.approx([front, front, rear, rear], rel=0.002)

"""On the plane, the contact that bears the wheels does not decide about the motion of a vehicle."""

from pathlib import Path

import numpy as np
import pytest

from mirdrake.plant.plant import PlantSpec
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
    for end in ends[1:]:
        assert end["load"] == pytest.approx(ends[0]["load"], rel=5e-4)
        for name in ("ego.wz", "ego.vx"):
            assert end[name] == pytest.approx(ends[0][name], rel=2e-3)
        assert end["ego.roll"] == pytest.approx(ends[0]["ego.roll"], rel=5e-3, abs=2e-6)
        assert end["ego.z"] == pytest.approx(ends[0]["ego.z"], abs=2e-4)
        for name in WHEEL_LOADS:
            assert end[name] == pytest.approx(ends[0][name], rel=4e-3)


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

"""Slip model of speed loops against the full plant: slip tyres, all-wheel drive, loops of the wheels and of the car."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from mirdrake.tuning.loops.base import Conditions, LoopSpec
from mirdrake.tuning.loops.evaluate import LoopEvaluator, plant_bench
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.loops.slip import make_slip_model, run_slip
from mirdrake.tuning.loops.speed import WheelSpeedLoop
from mirdrake.tuning.models import Integrator
from mirdrake.tuning.spec import make_tuning
from mirdrake.vehicles.scaffold import new_vehicle
from mirdrake.vehicles.traction import followed_slope

ROOT = Path(__file__).parents[1]

WHEELS_BY_TORQUE = """\
description: slip tyres and springs, torque of the wheels
base: handling
control: {wheel_speed: {kind: servo, gain: 1.0}}
"""


def robot(folder: Path, drive: str) -> Path:
    """Return a robot of 60 kg with a variant on brush tyres and springs, whose wheels have torque controllers."""
    made = new_vehicle(
        "robot", wheelbase=0.7, track=0.5, mass=60.0, wheel_radius=0.12, drive=drive, sensors="none", folder=folder
    )
    (made / "variants" / "torque.yaml").write_text(WHEELS_BY_TORQUE, encoding="utf-8")
    # Steeper slopes than those of a new vehicle, which no wheel should lose its grip on: 70 % of the grip.
    file = made / "control.yaml"
    control = yaml.safe_load(file.read_text(encoding="utf-8"))
    for name, most in (("max_acceleration", 3.0), ("max_deceleration", 5.0)):
        control["speed"][name] = min(most, 0.7 / followed_slope(1.0) * control["speed"][name])
    file.write_text(yaml.safe_dump(control), encoding="utf-8")
    return made


def own_slopes_of(vehicle: str, loop: str, *, time_step: float) -> tuple[LoopSpec, float]:
    """Return a loop with its slip model on the vehicle's own slopes, and its inertia; no model is identified."""
    study = {"vehicle": vehicle, "loop": loop, "test": {"delay": 0.05}, "plant": {"time_step": time_step}}
    spec = make_loop_spec(make_tuning(study))
    bench, kind = plant_bench(spec), LOOP_KINDS[spec.kind]
    assert isinstance(kind, WheelSpeedLoop)
    inertia = kind._inertia(bench)
    # Drag: that of the rolling resistance.
    resistance = bench.part.vehicle.spec.tyres.rolling_resistance
    weight = kind.model(bench, Integrator(1.0, 0.0).transfer_function(), 0.0).weight
    model = kind.model(bench, Integrator(1.0 / inertia, 0.05).transfer_function(), resistance * weight)
    one = Integrator(1.0, 0.0).transfer_function()
    model = replace(model, output=one if loop == "speed" else None, slip=make_slip_model(bench))
    own = kind.at_own_slopes(replace(spec, model=model))
    assert own is not None
    return own, inertia


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "variant", "loop", "friction", "stable", "unstable"),
    [
        pytest.param("all", "", "speed", 0.9, (2.0, 8.0), (), id="all_wheels"),
        pytest.param("all", "", "speed", 0.4, (), (2.0, 8.0), id="all_wheels_slippery"),
        pytest.param("rear", "", "wheel_speed", 0.9, (1.0, 4.0), (8.0,), id="spin"),
        pytest.param("all", "@torque", "speed", 0.9, (2.0, 3.0), (), id="all_wheels_brush"),
        pytest.param("rear", "@torque", "speed", 0.9, (1.0,), (2.0, 4.0), id="rear_brush"),
        pytest.param("front", "@torque", "wheel_speed", 0.9, (1.0,), (8.0,), id="spin_brush"),
    ],
)
def test_verdict_and_error_are_those_of_the_plant(
    tmp_path: Path, drive: str, variant: str, loop: str, friction: float, stable: tuple[float, ...],
    unstable: tuple[float, ...],
) -> None:  # fmt: skip
    """PI controllers of a bandwidth [rad/s] from the inertia; slip tyres at 2.5 ms: see docs/tuning_method.md."""
    own, inertia = own_slopes_of(f"{robot(tmp_path, drive)}{variant}", loop, time_step=0.0025 if variant else 0.005)
    _compare(own, inertia, friction, stable, unstable)


@pytest.mark.slow
def test_verdict_and_error_are_those_of_the_plant_with_the_magic_formula(tmp_path: Path) -> None:
    bolt = shutil.copytree(ROOT / "models" / "bolt", tmp_path / "bolt")
    (bolt / "variants" / "torque.yaml").write_text(WHEELS_BY_TORQUE.replace("1.0", "200.0"), encoding="utf-8")
    own, inertia = own_slopes_of(f"{bolt}@torque", "speed", time_step=0.0025)
    _compare(own, inertia, 0.9, (0.15,), (1.0,))


def _compare(
    own: LoopSpec, inertia: float, friction: float, stable: tuple[float, ...], unstable: tuple[float, ...]
) -> None:
    for bandwidth in (*stable, *unstable):
        gains = {"kp": bandwidth * inertia, "ki": 0.25 * bandwidth**2 * inertia, "kd": 0.0}
        conditions = Conditions(friction=friction)
        model, plant = run_slip(own, gains, conditions), LoopEvaluator(own)(gains, conditions)
        assert (model.status, plant.status) == 2 * ("ok" if bandwidth in stable else "unstable",), plant.reason
        if bandwidth in stable:
            assert model.figures["iae"] == pytest.approx(plant.figures["iae"], rel=0.1)

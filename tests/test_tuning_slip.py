"""Slip model of speed loops: closed forms of a sliding wheel, grip, and the plant."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
import yaml

from mirdrake.tuning.grip import axles_of
from mirdrake.tuning.loops.base import Course, DrivenAxle, Evaluation, Gain, LoopModel, LoopSpec, SlipModel
from mirdrake.tuning.loops.bench import WAIT, BenchProcess
from mirdrake.tuning.loops.evaluate import plant_bench
from mirdrake.tuning.loops.registry import LOOP_KINDS, make_loop_spec
from mirdrake.tuning.loops.slip import (
    UNSTABLE,
    fault_on_own_slopes,
    make_slip_model,
    pitch_of,
    reaction_on_own_slopes,
    run_slip,
    slip_reaction,
)
from mirdrake.tuning.loops.speed import GRIP, WheelSpeedLoop
from mirdrake.tuning.models import Integrator
from mirdrake.tuning.scenarios import MOST_SLIP, SLIP, InSlip
from mirdrake.tuning.spec import load_tuning, make_tuning
from mirdrake.vehicles.scaffold import new_vehicle
from mirdrake.vehicles.traction import FORCE_PEAK, followed_slope

ROOT = Path(__file__).parents[1]
RADIUS, INERTIA, LOAD, FRICTION = 0.3, 1.2, 4000.0, 0.8
GRIP_TORQUE = FRICTION * LOAD * RADIUS
SPEED = 10.0


COULOMB = DrivenAxle(
    2, INERTIA, LOAD, 0.0, stiffness=1e4, length=1e-4, damping=1e4, low_damping=0.0, curve=(0.0, *[FRICTION] * 100)
)
"""Wheels with Coulomb friction that reverses with the slip."""


def sliding_wheel(
    *, period: float, delay: float, limit: float | None, duration: float, axle: DrivenAxle = COULOMB
) -> LoopSpec:
    """Return the loop of a wheel on a vehicle of infinite mass."""
    slip = SlipModel(1e12, RADIUS, FRICTION, (axle,), 20.0, 0.5, 0.0, 0.1)
    model = LoopModel(
        {"main": Integrator(1.0, 0.0).transfer_function()},
        output=Integrator(1.0, 0.0).transfer_function(),
        scale=1.0 / RADIUS,
        start=SPEED,
        rise=1e-12,  # the set-point is constant
        limit=limit,
        slip=slip,
    )
    return LoopSpec(
        kind="speed",
        diagram={"plant": {"time_step": period}},
        vehicle="ego",
        gains={name: Gain(path=f"wheel_speed.{name}") for name in ("kp", "ki", "kd")},
        reference="",
        output="",
        effort="",
        output_unit="m/s",
        effort_unit="N m",
        course=Course(1.0, 0.5, 0.0, duration, duration, SPEED),
        period=period,
        filter_time=0.0,
        delay=delay - WAIT * period,
        model=model,
    )


def slip_of(spec: LoopSpec, kp: float, slip: float) -> np.ndarray:
    """Return the slip velocity of the wheel, from the efforts and outputs of a run that starts in a slide [m/s]."""
    assert spec.model is not None
    # The output of a wheel-speed loop is the spin rate.
    wheel = replace(spec, model=replace(spec.model, output=None, scale=1.0, start=SPEED / RADIUS))
    response = run_slip(wheel, {"kp": kp, "ki": 0.0, "kd": 0.0}, slip=slip).response
    assert response is not None
    return np.asarray(response["output"]) * RADIUS - SPEED


@pytest.mark.parametrize("torque", [1.3, 2.0, 4.0])
def test_a_sliding_wheel_at_its_limits_oscillates_as_in_the_closed_form(torque: float) -> None:
    """The torque reverses a dead time after the slip: amplitude (T - F h) τ h / J, period 4 τ T / (T + F h)."""
    period, delay, limit = 2.5e-4, 0.06, torque * GRIP_TORQUE
    spec = sliding_wheel(period=period, delay=delay, limit=limit, duration=4.0)
    slip = slip_of(spec, 1e6, 30.0)[8000:]
    amplitude = (limit - GRIP_TORQUE) * delay * RADIUS / INERTIA
    # Sampling adds up to a period to the dead time.
    assert np.max(slip) == pytest.approx(amplitude, rel=0.03)
    assert np.min(slip) == pytest.approx(-amplitude, rel=0.03)
    crossings = np.flatnonzero((slip[:-1] < 0.0) & (slip[1:] >= 0.0))
    lasts = float(np.mean(np.diff(crossings))) * period
    assert lasts == pytest.approx(4.0 * delay * limit / (limit + GRIP_TORQUE), rel=0.03)


def test_a_wheel_whose_torque_is_below_its_friction_returns_to_rolling_with_any_gain() -> None:
    for kp in (10.0, 100.0, 1e4, 1e6):
        spec = sliding_wheel(period=1e-3, delay=0.06, limit=0.9 * GRIP_TORQUE, duration=3.0)
        assert np.abs(slip_of(spec, kp, 30.0)[2500:]).max() < 0.05


@pytest.mark.parametrize(("closed_loop", "sensitivity", "peak"), [(1.25, 1.59, 1.475), (2.0, 1.39, 1.35)])
def test_the_acceleration_at_the_start_of_a_slope_peaks_by_the_gain_times_the_dead_time(
    closed_loop: float, sensitivity: float, peak: float
) -> None:
    """SIMC of an integrator: kp τ = 1 / (1 + τc / τ), the integral part adds kp τ² / (2 Ti); time in dead times."""
    kp = 1.0 / (1.0 + closed_loop)
    ki = kp / (4.0 * (1.0 + closed_loop))
    frequencies = np.geomspace(0.01, 20.0, 4000)
    loop = (kp + ki / (1j * frequencies)) * np.exp(-1j * frequencies) / (1j * frequencies)
    assert np.abs(1.0 / (1.0 + loop)).max() == pytest.approx(sensitivity, abs=0.01)

    step, lag = 0.01, 100
    speed = integral = 0.0
    control = np.zeros(3000)
    for k in range(len(control)):
        error = k * step - speed
        integral += error * step
        control[k] = 1.0 + kp * error + ki * integral
        speed += (control[k - lag] if k >= lag else 0.0) * step
    assert control.max() == pytest.approx(peak, rel=0.01)
    assert control.max() == pytest.approx(1.0 + kp + 0.5 * ki, rel=0.02)
    assert control.max() < FORCE_PEAK
    assert followed_slope(10.0) == pytest.approx(0.9 * 10.0 / 1.5)


@pytest.mark.parametrize("whole", [0, 1, 3])
def test_a_free_wheel_is_stable_up_to_the_gain_of_the_sampled_loop(whole: int) -> None:
    """Of z^(n+1) - z^n + K all roots are inside the circle for K < 2 cos(n π / (2 n + 1)), S. A. Kuruklis,
    J. Math. Anal. Appl. 188 (1994) 719; K = kp T / J, dead time n T."""
    period = 0.02
    free = replace(COULOMB, load=0.0)
    spec = sliding_wheel(period=period, delay=whole * period, limit=None, duration=20.0, axle=free)
    largest = 2.0 * math.cos(whole * math.pi / (2 * whole + 1)) * INERTIA / period
    if whole == 0:
        spec = replace(spec, delay=-WAIT * period)
    decays, grows = slip_of(spec, 0.97 * largest, 1.0), slip_of(spec, 1.03 * largest, 1.0)
    assert np.abs(decays[-100:]).max() < 0.1
    assert np.abs(grows[-100:]).max() > 3.0


@pytest.mark.parametrize("whole", [0, 1, 3])
def test_a_wheel_on_an_elastic_tyre_oscillates_as_the_exact_sampled_loop(whole: int) -> None:
    """The wheel oscillates on its tyre by a quarter of a turn per period: numerical damping would hide it."""
    period, stiffness, length = 0.02, 200.0, 0.6
    slips = np.linspace(0.0, 1.0, 101) ** 2
    linear = tuple((stiffness * slips).tolist())
    elastic = replace(COULOMB, load=300.0, stiffness=stiffness, length=length, damping=0.0, curve=linear)
    spec = sliding_wheel(period=period, delay=whole * period, limit=None, duration=5.3, axle=elastic)
    if whole == 0:
        spec = replace(spec, delay=-WAIT * period)

    # (s, u, T)' with the torque T held for a period.
    pull = RADIUS**2 / INERTIA * elastic.load * stiffness / length
    assert math.sqrt(pull) * period == pytest.approx(0.5 * math.pi, rel=0.2)
    system = np.array([[0.0, -pull, RADIUS / INERTIA], [1.0, -SPEED / length, 0.0], [0.0, 0.0, 0.0]])
    exact = scipy.linalg.expm(system * period)

    def radius(kp: float) -> float:
        # The state, then the torques of the last periods, the latest first; T = -kp s / h.
        loop = np.zeros((2 + whole, 2 + whole))
        loop[:2, :2] = exact[:2, :2]
        loop[3:, 2:-1] = np.eye(max(whole - 1, 0))
        if whole:
            loop[:2, -1], loop[2, 0] = exact[:2, 2], -kp / RADIUS
        else:
            loop[:2, 0] -= kp / RADIUS * exact[:2, 2]
        return float(np.abs(np.linalg.eigvals(loop)).max())

    largest = scipy.optimize.brentq(lambda kp: radius(kp) - 1.0, 1.0, 1e4)
    for factor in (0.97, 1.03):
        slip = slip_of(spec, factor * largest, 1e-6)
        rate = (np.std(slip[160:260]) / np.std(slip[60:160])) ** (1.0 / 100.0)
        assert rate == pytest.approx(radius(factor * largest), abs=5e-3)  # 0.3 % of the gain


@pytest.mark.parametrize("name", ["bolt", "unior"])
def test_a_vehicle_pitches_on_its_tyres_as_computed(name: str) -> None:
    """Poles of the pitch rate of the plant after a push, from its samples: r[k + 2] = a r[k + 1] + b r[k]."""
    loop = make_loop_spec(make_tuning({"vehicle": name, "loop": "speed"}))
    bench = plant_bench(loop)
    process = BenchProcess(bench)
    plant, base = bench.plant, bench.part.base
    context = plant.GetMyMutableContextFromRoot(process.context)
    rate = base.floating_velocities_start_in_v() + 1
    velocities = plant.GetVelocities(context)
    velocities[rate] = 0.02
    plant.SetVelocities(context, velocities)
    rates = []
    for _ in range(20):
        process(0.0)
        rates.append(float(plant.GetVelocities(context)[rate]))
    (a, b), *_ = np.linalg.lstsq(np.transpose([rates[1:-1], rates[:-2]]), np.array(rates[2:]), rcond=None)
    pole = np.log(np.roots([1.0, -a, -b]).astype(complex)[0]) / bench.period
    frequency, damping, _ = pitch_of(bench, axles_of(bench))
    assert abs(pole) == pytest.approx(frequency, rel=0.1)
    assert -pole.real / abs(pole) == pytest.approx(damping, abs=0.05)


@pytest.fixture(scope="module")
def bolt() -> LoopSpec:
    """Return the speed loop of the Bolt with its slip model; the mass stands for the identified model."""
    loop = make_loop_spec(load_tuning(ROOT / "studies/bolt_speed.yaml"))
    bench, kind = plant_bench(loop), LOOP_KINDS[loop.kind]
    assert isinstance(kind, WheelSpeedLoop)
    plant = Integrator(0.0132, 0.0574).transfer_function()
    model = kind.model(bench, plant, 25.9)
    one = Integrator(1.0, 0.0).transfer_function()
    return replace(loop, model=replace(model, output=one, slip=make_slip_model(bench)))


def test_the_largest_slopes_are_those_of_the_traction_limits(bolt: LoopSpec) -> None:
    axles, model = axles_of(plant_bench(bolt)), bolt.model
    assert model is not None
    assert model.slip is not None
    # The rotating mass of the other wheels is that of two wheels of 1 kg m².
    rotating = model.slip.mass / 1616.0
    assert model.slip.largest() == pytest.approx(axles.largest(0.9, 0.0), rel=rotating - 0.99)
    assert model.slip.largest(backward=True) == pytest.approx(axles.largest(0.9, 0.0, backward=True), rel=0.03)


def test_own_slopes_beyond_the_grip_are_limited_to_what_any_gains_can_follow(bolt: LoopSpec) -> None:
    kind = LOOP_KINDS[bolt.kind]
    assert bolt.model is not None
    assert bolt.model.slip is not None
    own = kind.at_own_slopes(bolt)
    assert own is not None
    assert own.model is not None
    assert (own.model.rise, own.model.fall) == (3.0, 5.0)
    slippery = replace(bolt, model=replace(bolt.model, slip=replace(bolt.model.slip, friction=0.3)))
    limited = kind.at_own_slopes(slippery)
    assert limited is not None
    assert limited.model is not None
    assert limited.model.rise == pytest.approx(GRIP * slippery.model.slip.largest())  # type: ignore[union-attr]
    assert limited.diagram["vehicles"]["ego"]["control"]["speed"]["max_acceleration"] == limited.model.rise


def test_gains_that_spin_the_wheels_of_the_plant_do_so_on_the_slip_model(bolt: LoopSpec) -> None:
    """Results of the plant at 2.5 ms with 3 % less friction: the first four are unstable, the others are stable."""
    own = LOOP_KINDS[bolt.kind].at_own_slopes(bolt)
    assert own is not None
    for kp, ki in ((400.0, 300.0), (281.0, 521.0), (266.0, 13.0), (182.2, 181.1)):
        gains = {"kp": kp, "ki": ki, "kd": 0.0}
        assert "the slip of the wheels" in fault_on_own_slopes(own, gains)
        assert reaction_on_own_slopes(own, gains) >= UNSTABLE
    for kp, ki in ((140.0, 33.0), (150.0, 100.0)):
        assert fault_on_own_slopes(own, {"kp": kp, "ki": ki, "kd": 0.0}) == ""


def test_gains_whose_wheels_return_by_chance_are_rejected(bolt: LoopSpec) -> None:
    """On the plant at 2.5 ms these return to rolling with 2 %, and keep sliding with 3 % less friction."""
    own = LOOP_KINDS[bolt.kind].at_own_slopes(bolt)
    assert own is not None
    gains = {"kp": 172.0, "ki": 80.0, "kd": 0.0}
    assert run_slip(own, gains, friction=0.99).status == "ok"
    assert reaction_on_own_slopes(own, gains) > 1.0
    # The reaction grows with the gain, so that a search knows where to go.
    reactions = [reaction_on_own_slopes(own, gains | {"kp": kp}) for kp in (130.0, 150.0, 172.0, 200.0)]
    assert reactions == sorted(reactions)


def test_the_reaction_is_the_torque_of_the_controller_over_that_of_the_friction() -> None:
    spec = sliding_wheel(period=1e-3, delay=0.06, limit=None, duration=1.0)
    slides = np.array([[0.0, 0.5, 0.2]])
    expected = 100.0 * 0.5 / RADIUS / GRIP_TORQUE
    assert slip_reaction(spec, {"kp": 100.0, "ki": 50.0, "kd": 0.0}, slides, friction=FRICTION) == pytest.approx(
        expected
    )
    # kd / (Tf + T) of the derivative, with a filter of 9 ms.
    filtered = replace(spec, filter_time=9e-3)
    found = slip_reaction(filtered, {"kp": 100.0, "ki": 50.0, "kd": 1.0}, slides, friction=FRICTION)
    assert found == pytest.approx(2.0 * expected)


@pytest.mark.parametrize(("kp", "reverses"), [(0.95, False), (1.5, True)])
def test_a_reaction_above_one_reverses_the_torque_of_a_sliding_wheel(kp: float, reverses: bool) -> None:
    """The wheel rolls on Coulomb friction with no torque, then starts to slide by 3 m/s: the torque is -kp s / h."""
    spec = sliding_wheel(period=1e-3, delay=0.06, limit=None, duration=1.0)
    gain = kp * GRIP_TORQUE * RADIUS / 3.0
    slip = slip_of(spec, gain, 3.0)
    assert slip_reaction(
        spec, {"kp": gain, "ki": 0.0, "kd": 0.0}, np.array([[3.0]]), friction=FRICTION
    ) == pytest.approx(kp)
    assert bool(slip.min() < -0.02) is reverses


@pytest.mark.parametrize(("drive", "mass"), [("front", 14.0), ("front", 61.0), ("rear", 30.0), ("rear", 95.0)])
def test_a_new_robot_has_slopes_that_its_wheels_follow_with_tuned_gains(
    drive: str, mass: float, tmp_path: Path
) -> None:
    """SIMC with τc = 1.5 τ for the inertia of the vehicle, as the outer speed loop doubles the gain of 1 / (4 τ)."""
    wheelbase = round(2.6 * (mass / 1450.0) ** (1.0 / 3.0), 3)
    folder = new_vehicle(
        "robot", wheelbase=wheelbase, track=0.58 * wheelbase, mass=mass, drive=drive, sensors="none", folder=tmp_path
    )
    loop = make_loop_spec(make_tuning({"vehicle": str(folder), "loop": "speed"}))
    bench, kind = plant_bench(loop), LOOP_KINDS[loop.kind]
    assert isinstance(kind, WheelSpeedLoop)
    inertia = mass * bench.radius**2 / len(bench.driven)
    plant = Integrator(1.0 / inertia, loop.delay).transfer_function()
    one = Integrator(1.0, 0.0).transfer_function()
    model = replace(kind.model(bench, plant, 0.0), output=one, slip=make_slip_model(bench))
    loop = replace(loop, model=model)
    dead = loop.delay + 0.5 * bench.period
    kp = 0.5 * 0.4 / dead * inertia
    gains = {"kp": kp, "ki": 0.1 * kp / dead, "kd": 0.0}
    assert fault_on_own_slopes(kind.at_own_slopes(loop), gains) == ""

    # With three quarters of the grip, the wheels slip.
    file = folder / "control.yaml"
    control = yaml.safe_load(file.read_text(encoding="utf-8"))
    for name in ("max_acceleration", "max_deceleration"):
        control["speed"][name] *= 0.75 / followed_slope(1.0)
    file.write_text(yaml.safe_dump(control), encoding="utf-8")
    assert "wheel" in fault_on_own_slopes(kind.at_own_slopes(loop), gains)


def test_gains_that_keep_slipping_break_a_limit_without_a_test_on_the_plant(bolt: LoopSpec) -> None:
    calls: list[object] = []

    def evaluate(gains: object, conditions: object = None, fidelity: object = "plant") -> Evaluation:
        calls.append(fidelity)
        return Evaluation("ok", {"iae": 1.0})

    own = LOOP_KINDS[bolt.kind].at_own_slopes(bolt)
    assert own is not None
    tries = InSlip(evaluate, own, bolt)
    assert tries({"kp": 400.0, "ki": 300.0, "kd": 0.0}).figures[SLIP] > 10.0 * MOST_SLIP
    assert tries({"kp": 140.0, "ki": 33.0, "kd": 0.0}).figures[SLIP] < MOST_SLIP
    assert calls == ["reduced", "plant"]

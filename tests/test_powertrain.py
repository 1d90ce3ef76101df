"""Motors, engines, brakes, pedals and actuators against closed forms; slip and yaw control in small models."""

from math import copysign, pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mirdrake.core.compiled import as_arrays, compiled, entry_point
from mirdrake.core.errors import ConfigError
from mirdrake.core.interpolation import invert_map, read_map
from mirdrake.core.yaml_io import parse_yaml
from mirdrake.plant.powertrain import ActuatorLaw, Measured, PowertrainLaw
from mirdrake.plant.powertrain.actuator import follow
from mirdrake.plant.powertrain.antilock import BRAKING, DRIVING, SlipState, hold_slip
from mirdrake.plant.powertrain.brakes import AxleShares, drive_shares, driven_rate, split_brakes, split_drive
from mirdrake.plant.powertrain.engine import GearState, engine_point, make_engine, shift
from mirdrake.plant.powertrain.maps import PedalMaps
from mirdrake.plant.powertrain.motor import Motor, full_torque, generator_torque, make_motor, wheel_limits
from mirdrake.plant.powertrain.stability import stability_torques
from mirdrake.plant.powertrain.system import UPDATE_PARTS, StatePlaces, update
from mirdrake.tyres.brush import BrushTyre, brush_forces
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.powertrain_spec import (
    Actuator,
    Antilock,
    ElectricPowertrain,
    EnginePowertrain,
    Pedals,
    Regeneration,
    Stability,
    Traction,
)
from mirdrake.vehicles.spec import VehicleSpec

RADIUS, MASS, PERIOD = 0.32, 1616.0, 0.01
ELECTRIC = ElectricPowertrain(
    kind="electric",
    max_torque=2538.0,
    max_power=150e3,
    gear=7.05,
    max_speed=8810.0 * pi / 30.0,
    governed_speed=40.68,
    efficiency=0.97,
    rotor_inertia=0.04,
    regeneration=Regeneration(max_torque=250.0, max_power=70e3),
)
ENGINE = EnginePowertrain.model_validate(
    {
        "kind": "engine",
        "max_torque": 1e5,
        "max_power": 1e6,
        "torque_curve": [(80.0, 200.0), (300.0, 400.0), (600.0, 300.0)],
        "drag_torque": 40.0,
        "idle": 80.0,
        "gears": [4.0, 2.0, 1.0],
        "final_drive": 3.0,
        "shift_up": (200.0, 550.0),
        "shift_down": (90.0, 200.0),
        "shift_time": 0.2,
        "efficiency": 0.9,
        "inertia": 0.25,
        "converter": {"stall_speed": 200.0, "stall_ratio": 2.0, "coupling": 0.9, "creep_torque": 30.0},
    }
)


def law(*, slip_control: bool = False, **changes) -> PowertrainLaw:
    spec = load_vehicle("bolt").spec.model_copy(update={"powertrain": ELECTRIC, **changes})
    inertias = (1.5,) * 4 if slip_control else ()
    return PowertrainLaw(
        spec, radii=(RADIUS,) * 4, mass=MASS, wheelbase=2.6, inertias=inertias, rotating=60.0, period=PERIOD
    )


def rolling(speed: float) -> Measured:
    return Measured((speed / RADIUS,) * 4, (speed,) * 4, speed)


def drag(speed: float) -> float:
    return 115.0 + 0.495 * speed * speed


# --- motor -------------------------------------------------------------------------------------------------------


def test_a_motor_is_limited_by_torque_then_power_then_top_speed():
    motor = Motor(torque=360.0, power=150e3, gear=7.05, top=900.0)
    assert full_torque(motor, 0.0) == 360.0
    assert full_torque(motor, 150e3 / 360.0) == pytest.approx(360.0)
    assert full_torque(motor, 600.0) == pytest.approx(250.0)
    assert full_torque(motor, 900.0) == 0.0
    assert full_torque(motor, 895.5) == pytest.approx(0.5 * 150e3 / 895.5)  # half way down the last hundredth
    assert full_torque(motor, -100.0) == 360.0


def test_a_torque_map_limits_the_motor_further():
    motor = Motor(torque=360.0, power=150e3, rows=((0.0, 300.0), (400.0, 300.0), (800.0, 100.0)))
    assert full_torque(motor, 200.0) == 300.0
    assert full_torque(motor, 600.0) == pytest.approx(200.0)


def test_regeneration_has_separate_limits_and_fades_at_walking_pace():
    motor = make_motor(ELECTRIC, radius=RADIUS)
    assert generator_torque(motor, 200.0) == 250.0
    assert generator_torque(motor, 700.0) == pytest.approx(100.0)
    slow = 1.0 / RADIUS * 7.05  # 1 m/s, half of the fade speed
    assert generator_torque(motor, slow) == pytest.approx(125.0)
    assert generator_torque(motor, 0.0) == generator_torque(motor, -50.0) == 0.0


def test_gear_losses_are_paid_by_the_wheels_when_driving_and_by_the_motor_when_braking():
    one_pedal = ELECTRIC.model_copy(
        update={"regeneration": Regeneration(max_torque=100.0, max_power=70e3, coast_share=1.0)}
    )
    closed, opened = wheel_limits(make_motor(one_pedal, radius=RADIUS), 30.0)
    assert opened == pytest.approx(360.0 * 7.05 * 0.97)
    assert closed == pytest.approx(-100.0 * 7.05 / 0.97)


def test_full_throttle_on_a_point_mass_is_what_an_integrator_gives():
    train, speed = law(), 0.0
    memory, times = train.rest(), dict[float, float]()
    for step in range(1500):
        memory, torques = train.step(memory, (1.0, 0.0, 1.0), rolling(speed))
        speed += PERIOD * (sum(torques.drive) / RADIUS - drag(speed)) / (MASS + 60.0)
        for mark in (13.41, 26.82):
            if speed >= mark:
                times.setdefault(mark, (step + 1) * PERIOD)

    def rate(_t, v):
        torque = min(360.0, 150e3 / max(v[0] / RADIUS * 7.05, 1e-9)) * 7.05 * 0.97
        return [(torque / RADIUS - drag(v[0])) / (MASS + 60.0)]

    exact = solve_ivp(rate, (0.0, 10.0), [0.0], rtol=1e-9, atol=1e-9, dense_output=True).sol
    for mark, time in times.items():
        assert time == pytest.approx(brentq(lambda t, mark=mark: exact(t)[0] - mark, 0.1, 10.0), abs=0.02)
    assert set(times) == {13.41, 26.82}


def test_top_speed_follows_from_power_and_drag_or_from_the_governor():
    free = ELECTRIC.model_copy(update={"governed_speed": None, "max_power": 60e3, "max_speed": 2000.0})
    for powertrain, expected in (
        (free, brentq(lambda v: 60e3 * 0.97 / v - drag(v), 10.0, 80.0)),
        (ELECTRIC, 40.68),
    ):
        train = law(powertrain=powertrain)
        memory, speed = train.rest(), 30.0
        for _ in range(30000):
            memory, torques = train.step(memory, (1.0, 0.0, 1.0), rolling(speed))
            speed += PERIOD * (sum(torques.drive) / RADIUS - drag(speed)) / MASS
        assert speed == pytest.approx(expected, rel=0.005)


# --- engine ------------------------------------------------------------------------------------------------------


def test_the_converter_doubles_the_torque_at_stall_and_couples_later():
    engine = make_engine(ENGINE, wheel_inertia=1e9)  # so that the engine's own inertia takes nothing
    stall = engine_point(engine, 1.0, 0.0)
    assert stall.speed == 200.0
    assert stall.full == pytest.approx(200.0 + 120.0 / 220.0 * 200.0)
    assert stall.opened == pytest.approx(stall.full * 2.0 * 12.0 * 0.9)
    half = engine_point(engine, 1.0, 100.0 / 12.0)
    assert half.opened == pytest.approx(stall.full * (2.0 - 0.5 / 0.9) * 12.0 * 0.9)
    coupled = engine_point(engine, 1.0, 400.0 / 12.0)
    assert coupled.speed == pytest.approx(400.0)
    assert coupled.opened == pytest.approx((400.0 - 100.0 / 3.0) * 12.0 * 0.9)
    assert engine_point(engine, 1.0, 601.0 / 12.0).opened == 0.0


def test_the_converter_never_gives_more_power_than_it_takes():
    engine = make_engine(ENGINE, wheel_inertia=1e9)
    for behind in np.linspace(0.0, 600.0, 200):
        point = engine_point(engine, 2.0, behind / 6.0)
        assert point.opened * behind / 6.0 <= point.full * point.speed * 0.9 * (1.0 + 1e-12)


def test_a_closed_throttle_creeps_below_idle_speed_and_drags_above():
    engine = make_engine(ENGINE, wheel_inertia=1e9)
    assert engine_point(engine, 1.0, 0.0).closed == pytest.approx(30.0 * 12.0 * 0.9)
    assert engine_point(engine, 1.0, 80.0 / 12.0).closed == 0.0
    assert engine_point(engine, 1.0, 160.0 / 12.0).closed == pytest.approx(-40.0 * 12.0 / 0.9)


def test_torque_used_by_the_engine_is_the_share_of_its_inertia():
    # F r (1 + J i² / (m r²)) = T: 0.25 x 144 = 36 kg m² beside 164
    engine = make_engine(ENGINE, wheel_inertia=164.0)
    free = engine_point(make_engine(ENGINE, wheel_inertia=1e12), 1.0, 30.0).opened
    assert engine_point(engine, 1.0, 30.0).opened == pytest.approx(free * 164.0 / 200.0)


def test_the_gearbox_shifts_by_speed_and_throttle_and_has_no_torque_meanwhile():
    engine = make_engine(ENGINE, wheel_inertia=100.0)
    rate = 210.0 / 12.0  # above shift_up with a closed throttle, below with an open one
    assert shift(engine, GearState(), rate, 1.0, 0.01) == GearState()
    shifting = shift(engine, GearState(), rate, 0.0, 0.01)
    assert shifting == GearState(2.0, 0.2)
    assert shift(engine, shifting, rate, 0.0, 0.15) == pytest.approx((2.0, 0.05))
    assert shift(engine, GearState(2.0), 85.0 / 6.0, 0.0, 0.01).gear == 1.0
    assert shift(engine, GearState(2.0), 85.0 / 6.0 * 2.0, 1.0, 0.01).gear == 1.0  # kicked down
    assert shift(engine, GearState(3.0), 1000.0, 1.0, 0.01).gear == 3.0  # the last one


def test_a_car_with_gears_shifts_up_once_each_and_down_again_without_hunting():
    train = law(powertrain=ENGINE)
    memory, speed, gears, gaps = train.rest(), 0.0, [1.0], 0
    for step in range(6000):
        pedals = (1.0, 0.0, 1.0) if step < 3000 else (0.0, 0.2, 1.0)
        memory, torques = train.step(memory, pedals, rolling(speed))
        gaps += step < 3000 and torques.status[6] == 0.0
        if torques.status[2] != gears[-1]:
            gears.append(torques.status[2])
        force = sum(torques.drive) / RADIUS - sum(torques.brake) / RADIUS * (speed > 0.0) - drag(speed)
        speed = max(speed + PERIOD * force / MASS, 0.0)
    assert gears == [1.0, 2.0, 3.0, 2.0, 1.0]
    assert gaps == 40  # twice 0.2 s


def test_reverse_has_a_separate_ratio_and_neutral_has_no_torque():
    train = law(powertrain=ENGINE.model_copy(update={"reverse": 5.0}))
    _, back = train.step(train.rest(), (1.0, 0.0, -1.0), rolling(0.0))
    _, ahead = train.step(train.rest(), (1.0, 0.0, 1.0), rolling(0.0))
    reach = MASS * RADIUS**2
    share = (reach / (reach + 0.25 * 225.0)) / (reach / (reach + 0.25 * 144.0))
    assert sum(back.drive) == pytest.approx(-sum(ahead.drive) * 5.0 / 4.0 * share)
    assert back.status[2] == -1.0
    _, neutral = train.step(train.rest(), (1.0, 0.0, 0.0), rolling(5.0))
    assert neutral.drive == (0.0,) * 4


# --- brakes and differential -------------------------------------------------------------------------------------


def test_an_open_differential_gives_both_wheels_the_same_and_loses_no_power():
    for drive, share, expected in (("front", 0.5, (1.0, 0.0)), ("rear", 0.5, (0.0, 1.0)), ("all", 0.3, (0.3, 0.7))):
        shares = drive_shares(drive, share)
        assert tuple(shares) == pytest.approx(expected)
        torques, rates = split_drive(1000.0, shares), (10.0, 14.0, 11.0, 17.0)
        assert torques[0] == torques[1] == 500.0 * shares.front
        assert torques[2] == torques[3] == 500.0 * shares.rear
        power = sum(torque * rate for torque, rate in zip(torques, rates, strict=True))
        assert power == pytest.approx(1000.0 * driven_rate(rates, shares))


@pytest.mark.parametrize("generator", [0.0, 300.0, 1e6])
def test_axles_keep_their_balance_whoever_brakes(generator):
    motor, brakes = split_brakes(2000.0, 0.65, generator=generator, shares=AxleShares(1.0, 0.0))
    assert motor == min(generator, 1300.0)
    assert brakes[0] + brakes[1] + motor == pytest.approx(1300.0)
    assert brakes[2] == brakes[3] == pytest.approx(350.0)
    assert min(brakes) >= 0.0


def test_a_motor_on_all_wheels_brakes_no_axle_more_than_its_part():
    motor, brakes = split_brakes(2000.0, 0.65, generator=1e6, shares=AxleShares(0.5, 0.5))
    assert motor == pytest.approx(1400.0)  # the rear axle's 700 N m are half of it
    assert brakes == pytest.approx((300.0, 300.0, 0.0, 0.0))


def test_the_brake_pedal_gives_the_stated_torque_with_the_stated_balance():
    train = law()
    _, torques = train.step(train.rest(), (0.0, 0.5, 1.0), rolling(0.0))
    assert torques.brake == pytest.approx((1300.0, 1300.0, 700.0, 700.0))  # half of 8000, 0.65 in front
    _, moving = train.step(train.rest(), (0.0, 0.5, 1.0), rolling(20.0))
    taken = 70e3 / (20.0 / RADIUS * 7.05) * 7.05 / 0.97  # regeneration within its power, and the gear's losses help
    assert sum(moving.drive) == pytest.approx(-taken)
    assert sum(moving.brake) == pytest.approx(4000.0 - taken)
    _, neutral = train.step(train.rest(), (0.0, 0.5, 0.0), rolling(20.0))
    assert neutral.drive == (0.0,) * 4


def test_the_rotor_is_shared_by_the_driven_wheels():
    total = 0.04 * 7.05**2
    assert ELECTRIC.wheel_inertia(drive="front", front=True) == pytest.approx(total / 2.0)
    assert ELECTRIC.wheel_inertia(drive="front", front=False) == 0.0
    both = ELECTRIC.model_copy(update={"front_share": 0.3})
    parts = [both.wheel_inertia(drive="all", front=front) for front in (True, True, False, False)]
    assert sum(parts) == pytest.approx(total)
    assert load_vehicle("bolt").spec.powertrain.wheel_inertia(drive="front", front=True) == 0.0


# --- pedals ------------------------------------------------------------------------------------------------------


def test_pedal_maps_are_read_forwards_and_backwards():
    maps = PedalMaps(load_vehicle("mkz").spec.pedals, brake_torque=9000.0)
    for torque in np.linspace(1.0, 9000.0, 57):
        assert read_map(maps.brake, invert_map(maps.brake, torque)) == pytest.approx(torque)
    for part in np.linspace(0.001, 1.0, 57):
        assert read_map(maps.throttle, invert_map(maps.throttle, part)) == pytest.approx(part)
    assert read_map(maps.brake, 0.234) == 521.0
    assert invert_map(maps.throttle, 0.0) == invert_map(maps.brake, 0.0) == 0.0
    assert invert_map(maps.throttle, 2.0) == 0.80
    assert read_map(maps.throttle, 0.9) == 1.0
    assert read_map(maps.brake, 1.0) == 9000.0  # beyond the table a straight line to what the brakes can


def test_without_maps_pedals_are_straight_lines():
    maps = PedalMaps(Pedals(), brake_torque=8000.0)
    assert read_map(maps.brake, 0.25) == 2000.0
    assert read_map(maps.throttle, 0.25) == 0.25


# --- actuators ---------------------------------------------------------------------------------------------------


def responses(actuator: Actuator, steps: int = 60) -> np.ndarray:
    chain = ActuatorLaw(actuator, period=PERIOD)
    memory, values = chain.rest(0.0), []
    for _ in range(steps):
        memory, value = chain.step(memory, 1.0)
        values.append(value)
    return np.array(values)


def test_a_delay_is_exactly_its_number_of_periods():
    expected = (np.arange(60) >= 5).astype(float)
    assert np.array_equal(responses(Actuator(delay=0.05)), expected)
    assert np.array_equal(responses(Actuator()), np.ones(60))


def test_a_lag_is_the_exponential_at_any_period():
    times = PERIOD * np.arange(1, 61)
    assert responses(Actuator(time_constant=0.08)) == pytest.approx(1.0 - np.exp(-times / 0.08), abs=1e-14)
    late = responses(Actuator(time_constant=0.08, delay=0.03))
    assert late[3:] == pytest.approx(1.0 - np.exp(-times[:-3] / 0.08), abs=1e-14)
    assert not late[:3].any()


def test_a_rate_limit_runs_straight_and_ends_in_the_lag():
    times = PERIOD * np.arange(1, 61)
    assert responses(Actuator(rate=4.0)) == pytest.approx(np.minimum(4.0 * times, 1.0))
    # gap R tau = 0.32 is reached at 0.17 s, from then on the lag alone
    both = np.where(times < 0.17, 4.0 * times, 1.0 - 0.32 * np.exp(-(times - 0.17) / 0.08))
    assert responses(Actuator(rate=4.0, time_constant=0.08)) == pytest.approx(both, abs=1e-13)


def test_the_step_does_not_depend_on_the_period():
    value = 0.0
    for _ in range(7):
        value = follow(value, -1.0, period=0.01, time_constant=0.05, rate=8.0)
    assert value == pytest.approx(follow(0.0, -1.0, period=0.07, time_constant=0.05, rate=8.0), abs=1e-14)


def test_actuators_of_the_pedals_delay_what_the_wheels_get():
    actuators = load_vehicle("bolt").spec.actuators.model_copy(update={"throttle": Actuator(delay=0.03)})
    train = law(actuators=actuators)
    memory, drives = train.rest(), []
    for _ in range(6):
        memory, torques = train.step(memory, (1.0, 0.0, 1.0), rolling(0.0))
        drives.append(sum(torques.drive) > 0.0)
    assert drives == [False, False, False, True, True, True]


def test_a_delay_must_be_a_multiple_of_the_period():
    with pytest.raises(ConfigError, match=r"delay: 0\.015 s is not a multiple of the 0\.01 s"):
        ActuatorLaw(Actuator(delay=0.015), period=0.01)


# --- slip and yaw ------------------------------------------------------------------------------------------------

LOAD = 4000.0
CAR = LOAD / 9.80665
TYRE = BrushTyre(
    nominal_load=LOAD,
    longitudinal_stiffness=25.0 * LOAD,
    cornering_stiffness=15.0 * LOAD,
    friction=1.0,
    peak_load=2.0 * LOAD,
    half_length=0.06,
)


def road_force(slip: float, friction: float, falling: bool) -> float:
    """Return the brush tyre, whose friction does not fall, or one that loses a quarter of its grip when it slides."""
    force = float(brush_forces(TYRE, slip, 0.0, LOAD, friction=friction).fx)
    return force * (1.0 - 0.25 * max(abs(slip) - 0.1, 0.0) / 0.9) if falling else force


def quarter_car(speed, torque, options, *, friction=1.0, falling=True, sign=BRAKING, until=3.0):
    """Return the distance [m], and slips above 3 m/s, of a quarter car at maximum braking or drive torque."""
    inertia, step, relaxation = 1.2, 2e-4, 0.3
    rate, slip, distance, slips, applied, state = speed / RADIUS, 0.0, 0.0, [], 0.0, SlipState()
    for count in range(round(20.0 / step)):
        if count % 50 == 0:
            applied = torque
            if options is not None:
                state, applied = hold_slip(
                    state,
                    torque,
                    direction=sign,
                    rate=rate,
                    speed=speed,
                    options=options,
                    radius=RADIUS,
                    inertia=inertia,
                    period=50 * step,
                )
            if speed > 3.0:
                slips.append((rate * RADIUS - speed) / speed)
        creep = rate * RADIUS - speed
        slip += step * (creep - speed * slip) / relaxation
        force = road_force(min(max(slip, -1.0), 1.0), friction, falling)
        rate -= step * force * RADIUS / inertia
        change = step * applied / inertia
        if sign == DRIVING:
            rate += change
        else:
            rate = rate - copysign(change, rate) if abs(rate) > change else 0.0
        speed += step * force / CAR
        distance += step * speed
        if (sign == BRAKING and speed < 0.05) or (sign == DRIVING and speed > until):
            break
    return distance, np.array(slips[30:])


@pytest.mark.parametrize("friction", [1.0, 0.3])
def test_antilock_holds_the_slip_and_stops_sooner_than_locked_wheels(friction):
    options = Antilock()
    held, slips = quarter_car(27.8, 2500.0, options, friction=friction)
    locked, _ = quarter_car(27.8, 2500.0, None, friction=friction)
    assert slips.mean() == pytest.approx(-options.target_slip, abs=0.015)
    assert np.ptp(slips) < 0.05
    assert held < 0.9 * locked


def test_antilock_hardly_lengthens_braking_where_sliding_friction_equals_the_peak():
    held, _ = quarter_car(27.8, 2500.0, Antilock(), falling=False)
    locked, _ = quarter_car(27.8, 2500.0, None, falling=False)
    assert held < 1.01 * locked


def test_antilock_leaves_a_gentle_brake_alone():
    state = SlipState()
    for _ in range(50):
        state, torque = hold_slip(
            state, 300.0, direction=BRAKING, rate=61.5, speed=20.0, options=Antilock(), radius=RADIUS, inertia=1.2,
            period=PERIOD,
        )  # fmt: skip
        assert torque == 300.0


def test_traction_control_holds_the_slip_of_a_wheel_that_has_too_much_torque():
    _, slips = quarter_car(3.0, 2500.0, Traction(), friction=0.5, sign=DRIVING, until=15.0)
    assert slips.mean() == pytest.approx(0.1, abs=0.02)
    _, spinning = quarter_car(3.0, 2500.0, None, friction=0.5, sign=DRIVING, until=15.0)
    assert spinning.max() > 1.0


def test_antilock_in_the_law_acts_on_the_locking_wheel_alone():
    brakes = load_vehicle("bolt").spec.brakes.model_copy(update={"abs": Antilock()})
    train = law(slip_control=True, brakes=brakes)
    memory = train.rest()
    for _ in range(20):
        rates = (20.0 / RADIUS,) * 3 + (8.0 / RADIUS,)  # the rear right wheel has a slip of 0.6
        memory, torques = train.step(memory, (0.0, 1.0, 0.0), Measured(rates, (20.0,) * 4, 20.0))
    assert torques.brake[:3] == pytest.approx((2600.0, 2600.0, 1400.0))
    assert torques.brake[3] < 700.0
    assert torques.status[-1] == 1.0


def test_traction_control_takes_torque_from_both_wheels_of_the_differential():
    train = law(slip_control=True, powertrain=ELECTRIC.model_copy(update={"traction": Traction()}))
    memory = train.rest()
    for _ in range(5):
        rates = (10.0 / RADIUS, 20.0 / RADIUS, 10.0 / RADIUS, 10.0 / RADIUS)
        memory, torques = train.step(memory, (1.0, 0.0, 1.0), Measured(rates, (10.0,) * 4, 10.0))
    full = 360.0 * 7.05 * 0.97
    assert torques.drive[0] == torques.drive[1] < 0.4 * full
    assert torques.status[-1] == 1.0


def test_stability_control_brakes_the_wheel_that_turns_the_car_back():
    options = Stability(gain=1e4, dead_band=0.05, understeer=0.0, max_acceleration=8.0, max_torque=1200.0)

    def torques(steering, yaw_rate, speed=20.0):
        return stability_torques(options, speed=speed, steering=steering, yaw_rate=yaw_rate, wheelbase=2.6)

    yaw_rate_setpoint = 20.0 * 0.03 / 2.6
    assert torques(0.03, yaw_rate_setpoint + 0.04) == (0.0,) * 4
    much = torques(0.03, yaw_rate_setpoint + 0.1)
    assert much == pytest.approx((0.0, 500.0, 0.0, 0.0))  # to the left too much: outside, in front
    little = torques(0.03, yaw_rate_setpoint - 0.1)
    assert little == pytest.approx((0.0, 0.0, 500.0, 0.0))  # too little: inside, behind
    right = torques(-0.03, -yaw_rate_setpoint - 0.5)
    assert right == pytest.approx((1200.0, 0.0, 0.0, 0.0))
    limited = torques(0.3, 0.4)  # 0.4 rad/s x 20 m/s: all that there is
    assert limited == (0.0,) * 4
    assert torques(0.03, 1.0, speed=3.0) == (0.0,) * 4


def test_stability_control_keeps_a_loose_car_from_spinning():
    # linear single track with a compliant rear axle: unstable above its critical speed
    mass, inertia, front, rear, length = 1600.0, 2500.0, 90e3, 60e3, 2.6
    a, b, speed, step, steering = 1.3, 1.3, 30.0, 1e-3, 0.01
    options = Stability(understeer=0.001)

    def largest(active: bool) -> float:
        aside = yaw_rate = most = moment = 0.0
        for count in range(4000):
            if active and count % 10 == 0:
                torques = stability_torques(
                    options, speed=speed, steering=steering, yaw_rate=yaw_rate, wheelbase=length
                )
                moment = (torques[0] + torques[2] - torques[1] - torques[3]) / RADIUS * 0.75
            ahead = -front * ((aside + a * yaw_rate) / speed - steering)
            behind = -rear * (aside - b * yaw_rate) / speed
            aside += step * ((ahead + behind) / mass - speed * yaw_rate)
            yaw_rate += step * (a * ahead - b * behind + moment) / inertia
            most = max(most, abs(yaw_rate))
        return most

    assert largest(active=False) > 1.0
    assert largest(active=True) < 0.3


# --- files -------------------------------------------------------------------------------------------------------


def change(text: str) -> VehicleSpec:
    base = load_vehicle("bolt").folder / "vehicle.yaml"
    return parse_yaml(base.read_text(), VehicleSpec, name="vehicle.yaml", overrides=[text])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("powertrain.kind=steam", "powertrain.kind: unknown kind 'steam'; .*electric, engine, simple"),
        ("powertrain.gaers=[1]", "powertrain.gaers: unknown field; did you mean 'gears'"),
        ("powertrain={kind: electric, max_torque: 1, max_power: 1, max_speed: 1}", "powertrain.gear: is missing"),
        ("powertrain.max_torque=-5", "powertrain.max_torque: -5 is not allowed; it should be greater than 0"),
        ("brakes.abs=7", r"brakes.abs: 7 is not a mapping"),
        ("brakes.abs={target_slip: 2}", "brakes.abs.target_slip: 2 is not allowed"),
        ("actuators.brake.delay=-1 s", "actuators.brake.delay: -1.0 is not allowed"),
        ("pedals.brake=[[0.5, 10], [0.4, 20]]", "pedals.brake: the rows must be in ascending order"),
    ],
)
def test_bad_input_is_reported_with_its_place(override, message):
    with pytest.raises(ConfigError, match=message):
        change(override)


def test_bad_input_is_reported_with_file_and_line():
    text = (load_vehicle("bolt").folder / "vehicle.yaml").read_text()
    line = text[: text.index("powertrain:")].count("\n") + 2
    with pytest.raises(ConfigError, match=f"^vehicle.yaml:{line}: powertrain.kind: unknown kind 'steam'"):
        parse_yaml(text.replace("powertrain:", "powertrain:\n  kind: steam\n ", 1), VehicleSpec, name="vehicle.yaml")


def test_a_gearbox_that_would_hunt_is_rejected():
    data = ENGINE.model_dump() | {"shift_down": (90.0, 300.0)}
    with pytest.raises(ValueError, match="gear 1 would shift up at 550 rad/s and gear 2 down again at 300"):
        EnginePowertrain.model_validate(data)


def test_options_are_off_by_default_and_true_means_their_defaults():
    plain = change("brakes.max_torque=1")
    assert (plain.brakes.abs, plain.brakes.esc, plain.powertrain.traction) == (None, None, None)
    assert change("brakes.abs=false").brakes.abs is None
    assert change("brakes.abs=true").brakes.abs == Antilock()
    assert change("brakes.esc={gain: 5}").brakes.esc == Stability(gain=5.0)


@pytest.mark.parametrize("name", ["bolt", "mkz"])
def test_machine_code_does_the_same_to_the_bit(name):
    law, places = law_of_plant(name), StatePlaces((13, 14, 15, 16), (11, 12), 0, 4, 2.6, 0.75, 0.8)
    # Compiled for each vehicle's numbers as for the plant; wheel slips, both pedals and all gears are drawn.
    compiled_update = entry_point(compiled(update, parts=UPDATE_PARTS))
    constants = places, law.numbers, law.assistance
    machine = places, as_arrays(law.numbers), law.assistance
    memories, random, interventions = (law.rest(), np.array(law.rest())), np.random.default_rng(1), 0.0
    for k in range(400):
        speed = 15.0 * random.uniform(-0.2, 1.0)
        spins, pedals = (
            speed / RADIUS + random.normal(size=4) * 5.0,
            random.uniform(0.0, 1.0, 2) * [k % 3 > 0, k % 4 < 1],
        )
        motion = [*random.normal(size=3) * 0.2, speed, *random.normal(size=2) * 0.2]
        x = np.array([1.0, *random.normal(size=3) * 0.1, *motion, 0.0, *random.normal(size=2) * 0.2, *spins])
        given = x, random.normal(size=4) * 0.1, np.array([*pedals, (1.0, 1.0, 1.0, -1.0, 0.0)[k % 5]])
        torques, shown = (np.zeros(8), [0.0] * 8), (np.zeros(9), [0.0] * 9)
        compiled_update((*machine, *given, memories[1], torques[0], shown[0]))
        x, rear, pedals = (values.tolist() for values in given)
        update(*constants, x, rear, pedals, memories[0], torques[1], shown[1])
        interventions += shown[0][8]
        assert np.array_equal(torques[0], torques[1])
        assert np.array_equal(shown[0], shown[1])
        assert np.array_equal(memories[0], memories[1])
    assert interventions > 50.0


def law_of_plant(name: str) -> PowertrainLaw:
    vehicle = load_vehicle(f"{name}@handling")
    brakes = vehicle.spec.brakes.model_copy(update={"esc": Stability()})
    spec = vehicle.spec.model_copy(update={"brakes": brakes})
    return PowertrainLaw(
        spec, radii=(RADIUS,) * 4, mass=MASS, wheelbase=2.6, inertias=(1.5, 1.6, 1.7, 1.8), period=PERIOD
    )

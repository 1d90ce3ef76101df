"""Models of traffic against closed forms: gaps, stops, stability of a ring, lane changes, order of the actors."""

import cmath
import math
from itertools import product
from typing import Any

import numpy as np
import pytest

from mirdrake.actors.behaviours.idm import Idm, idm
from mirdrake.actors.behaviours.idm_mobil import IdmMobil, mobil
from mirdrake.actors.crew import make_crew, start_states
from mirdrake.actors.motion import lateral, span_of
from mirdrake.actors.step import TimeStep
from mirdrake.controllers.platoon import CaccSpec, acc, cacc_step
from mirdrake.worlds import World, make_world
from mirdrake.worlds.clearance import Volume

DT = 0.02  # [s]
Array = Any


def traffic_world(
    actors: list[dict[str, Any]], *, length: float, closed: bool = False, lanes: int = 1, **more: Any
) -> World:
    """Return a world with a ring or a straight road."""
    radius = length / (2.0 * math.pi)
    piece = {"arc": {"radius": radius, "angle": "360 deg"}} if closed else {"line": length}
    track = {"segments": [piece], "closed": closed, "width": 3.5 * lanes, "lanes": lanes}
    return make_world({"mirdrake": "world/1", "tracks": {"main": track}, "actors": actors} | more)


def simulate(world: World, duration: float, *, each: Any = None) -> Array:
    """Return the states at the end."""
    lanes, crew, _ = make_crew(world, {}, 0)
    step = TimeStep(lanes, crew)
    claims = step.claims()
    now = start_states(world, lanes)
    after = np.empty_like(now)
    for k in range(round(duration / DT)):
        step(now, np.empty((0, 5)), k * DT, DT, after, claims)
        now, after = after, now
        if each is not None:
            each(k * DT + DT, now)
    return now


def car(name: str, s: float, speed: float, **more: Any) -> dict[str, Any]:
    """Return a car on the track."""
    lane = {"lane": more.pop("lane")} if "lane" in more else {}
    entry = {"actor": "sedan", "name": name, "on_track": {"track": "main", "s": s} | lane, "speed": speed}
    return entry | {"behaviour": {"kind": "idm"}} | more


@pytest.mark.parametrize("speed", [2.0, 6.0, 10.0, 15.0, 22.0])
def test_idm_keeps_its_equilibrium_gap(speed: float) -> None:
    # s_e(v) = (s0 + v T) / sqrt(1 - (v/v0)^delta)
    world = traffic_world([car("follower", 10.0, 25.0), car("lead", 120.0, speed, behaviour="follow")], length=20_000.0)
    states = simulate(world, 400.0)
    expected = (2.0 + 1.8 * speed) / math.sqrt(1.0 - (speed / 25.0) ** 4)
    assert states["v"][0] == pytest.approx(speed, rel=1e-4)
    assert states["gap"][0] == pytest.approx(expected, rel=1e-3)


def test_idm_stops_behind_a_standing_car() -> None:
    world = traffic_world([car("follower", 10.0, 20.0), car("lead", 400.0, 0.0, behaviour="follow")], length=1000.0)
    states = simulate(world, 120.0)
    assert states["v"][0] == pytest.approx(0.0, abs=0.02)
    assert states["gap"][0] == pytest.approx(2.0, abs=0.1)
    limits = []
    simulate(world, 40.0, each=lambda _, now: limits.append(now["a"][0]))
    assert min(limits) > -3.2  # about the comfortable deceleration


@pytest.mark.parametrize(
    ("speed", "distance", "passes"), [(25.0, 70.0, True), (25.0, 80.0, False), (10.0, 14.0, True), (10.0, 29.0, False)]
)
def test_amber_is_passed_if_a_stop_is_too_late_and_red_comes_later(speed: float, distance: float, passes: bool) -> None:
    # Amber of 3 s. At 25 m/s a comfortable stop needs 25²/(2 2) = 156 m, but only 75 m are driven before red; at 10 m/s
    # it needs 25 m, and 30 m are driven.
    line, amber = 400.0, 3.0
    light = {"controls": [f"main@{line:g}"], "programme": {"green": 1.0, "amber": amber, "red": 100.0}, "offset": 1.0}
    behaviour = {"kind": "idm", "deceleration": 2.0}
    front = make_crew(traffic_world([car("one", 1.0, speed)], length=600.0), {}, 0)[1].shape[0, 0]
    one = car("one", line - distance - front, speed, behaviour=behaviour)
    fronts = []
    world = traffic_world([one], length=600.0, signals={"light": light})
    simulate(world, 20.0, each=lambda time, now: fronts.append((time, now["s"][0] + front)))
    before_red = max(s for time, s in fronts if time <= amber)
    assert (before_red > line) == passes
    # Nobody passes at red.
    assert (fronts[-1][1] > line) == passes


@pytest.mark.slow
@pytest.mark.parametrize(("acceleration", "is_stable"), [(0.6, False), (3.0, True)])
def test_stability_of_a_ring_has_the_sign_of_the_linear_criterion(acceleration: float, is_stable: bool) -> None:
    # M. Treiber, A. Kesting, Traffic Flow Dynamics, 15.4: with the derivatives of the acceleration by gap, speed and
    # speed ahead, a ring is stable if f_s <= (f_v^2 - f_l^2) / 2.
    count, gap = 50, 20.0
    model = Idm(kind="idm", acceleration=acceleration, deceleration=3.0, headway=1.2)
    numbers = np.array([0.0, *model.numbers()])
    low, high = 0.0, 25.0
    for _ in range(60):  # equilibrium speed of the gap
        speed = 0.5 * (low + high)
        low, high = (speed, high) if idm(numbers, speed, 25.0, gap, speed) > 0.0 else (low, speed)
    h = 1e-5
    f_s = (idm(numbers, speed, 25.0, gap + h, speed) - idm(numbers, speed, 25.0, gap - h, speed)) / (2 * h)
    f_v = (idm(numbers, speed + h, 25.0, gap, speed) - idm(numbers, speed - h, 25.0, gap, speed)) / (2 * h)
    f_l = (idm(numbers, speed, 25.0, gap, speed + h) - idm(numbers, speed, 25.0, gap, speed - h)) / (2 * h)
    assert (f_s <= 0.5 * (f_v * f_v - f_l * f_l)) == is_stable

    size = 4.5005  # [m] of the car
    spacing = gap + size
    behaviour = model.model_dump() | {"kind": "idm"}
    cars = [
        car(f"car_{i:02d}", i * spacing + (0.5 if i == 0 else 0.0), speed, behaviour=behaviour) for i in range(count)
    ]
    world = traffic_world(cars, length=count * spacing, closed=True)
    lanes, crew, _ = make_crew(world, {}, 0)
    crew.members["speed"][:] = 25.0
    step = TimeStep(lanes, crew)
    claims = step.claims()
    now = start_states(world, lanes)
    now["desired"] = 25.0
    after, spread = np.empty_like(now), []
    for k in range(30_000):
        step(now, np.empty((0, 5)), k * DT, DT, after, claims)
        now, after = after, now
        spread.append(float(np.ptp(now["v"])))
    early, late = max(spread[1000:2000]), max(spread[-1000:])
    assert late < 0.5 * early if is_stable else late > 2.0 * early


CHANGES = list(product([0.0, 0.3], [(-1.0, 0.0), (0.0, 0.0), (0.5, 0.0), (-2.0, 0.5), (-0.3, 0.0)], [0.0, -4.0]))


@pytest.mark.parametrize(("politeness", "own", "new_then"), CHANGES)
def test_mobil_decides_by_its_two_criteria(politeness: float, own: tuple[float, float], new_then: float) -> None:
    model = IdmMobil(kind="idm_mobil", politeness=politeness, threshold=0.2, safe=3.0)
    numbers = np.array([0.0, *model.numbers()])
    gain = mobil(numbers, own[0], own[1], 0.0, new_then, -0.1, 0.1)
    safe = new_then >= -3.0
    advantage = own[1] - own[0] + politeness * (new_then - 0.0 + 0.1 - (-0.1))
    assert (gain > 0.0) == (safe and advantage > 0.2)


def test_lane_changes_leave_a_slow_car_behind_without_overlap() -> None:
    behaviour = {"kind": "idm_mobil", "acceleration": 1.5}
    cars = [car("fast", 20.0, 20.0, behaviour=behaviour), car("slow", 80.0, 8.0, behaviour="follow")]
    world = traffic_world(cars, length=2000.0, lanes=2)
    states = simulate(world, 40.0)
    assert [actor.lane for actor in world.actors] == ["main.1", "main.1"]
    assert states["lane"].tolist() == [1.0, 0.0]  # numbers of main.2 and main.1
    assert states["y"][0] == pytest.approx(1.75, abs=1e-3)
    assert states["x"][0] > states["x"][1] + 10.0


@pytest.mark.slow
def test_a_ring_with_two_lanes_has_no_overlap_in_a_million_car_seconds() -> None:
    rng = np.random.default_rng(1)
    count, length = 100, 2500.0
    cars = [
        car(f"car_{i:03d}", i // 2 * 50.0 + 10.0 * (i % 2), 20.0, lane=1 + i % 2, behaviour={
            "kind": "idm_mobil", "acceleration": float(rng.uniform(0.8, 2.0)), "headway": float(rng.uniform(1.0, 2.0)),
        })
        for i in range(count)
    ]  # fmt: skip
    for i, entry in enumerate(cars):
        entry["speed"] = float(rng.uniform(12.0, 28.0)) if i % 5 else 10.0
    world = traffic_world(cars, length=length, closed=True, lanes=2)
    smallest, changes, last = [math.inf], [0], [None]
    size = 4.5005

    def look(_: float, now: Array) -> None:
        if last[0] is not None:
            changes[0] += int((now["lane"] != last[0]).sum())
        last[0] = now["lane"].copy()
        for lane in (0, 1):
            s = np.sort(now["s"][now["lane"] == lane])
            if len(s) > 1:
                length_of_lane = world.lanes[f"main.{lane + 1}"].length
                gaps = np.diff(np.concatenate((s, [s[0] + length_of_lane]))) - size
                smallest[0] = min(smallest[0], float(gaps.min()))

    simulate(world, 10_000.0, each=look)  # 100 cars for 10 000 s
    assert changes[0] > 100
    assert smallest[0] > 0.0


@pytest.mark.slow
def test_results_are_the_same_twice_and_in_reverse_order() -> None:
    rng = np.random.default_rng(0)
    cars = [
        car(f"car_{i:03d}", 20.0 * i, float(rng.uniform(8.0, 20.0)), lane=1 + i % 2, behaviour="idm_mobil")
        for i in range(100)
    ]
    first = simulate(traffic_world(cars, length=2100.0, closed=True, lanes=2), 60.0)
    again = simulate(traffic_world(cars, length=2100.0, closed=True, lanes=2), 60.0)
    backwards = simulate(traffic_world(cars[::-1], length=2100.0, closed=True, lanes=2), 60.0)
    assert first.tobytes() == again.tobytes() == backwards.tobytes()


def test_a_pedestrian_waits_for_a_car_that_arrives_within_its_critical_gap() -> None:
    walker = {"actor": "pedestrian", "name": "walker", "path": [[200, -8], [200, 8]], "speed": 1.4}
    walker |= {"behaviour": "walk"}

    def time_at_road(cars: list[dict[str, Any]]) -> float:
        entered: list[float] = []
        world = traffic_world([walker, *cars], length=400.0)

        def look(time: float, now: Array) -> None:
            if now["y"][-1] > -1.5 and not entered:
                entered.append(time)

        simulate(world, 25.0, each=look)
        return entered[0]

    free = time_at_road([])
    assert free == pytest.approx(6.5 / 1.4, abs=0.3)
    # The car arrives 2 s after the pedestrian would. Another one, 8 s later, is no reason to wait.
    near = 200.0 - 10.0 * (free + 2.0)
    waited = time_at_road([car("near", near, 10.0, behaviour="follow")])
    assert free + 1.5 < waited < free + 4.0
    far = car("far", 200.0 - 10.0 * (free + 8.0), 10.0, behaviour="follow")
    assert time_at_road([far]) == pytest.approx(free)


def test_two_pedestrians_pass_each_other() -> None:
    one = {"actor": "pedestrian", "name": "one", "path": [[0, 50], [20, 50]], "speed": 1.4, "behaviour": "walk"}
    two = one | {"name": "two", "path": [[20, 50.1], [0, 50.1]]}
    closest = [math.inf]

    def look(_: float, now: Array) -> None:
        closest[0] = min(closest[0], math.hypot(now["x"][0] - now["x"][1], now["y"][0] - now["y"][1]))

    states = simulate(traffic_world([one, two], length=100.0), 30.0, each=look)
    assert states["x"][0] == pytest.approx(20.0, abs=0.05)
    assert states["x"][1] == pytest.approx(0.0, abs=0.05)
    assert closest[0] > 0.3


def test_an_offset_in_a_bend_shortens_the_way() -> None:
    # At R = 60 m and 3 m inside, a turn takes (1 - 3/60) of the time.
    length = 2.0 * math.pi * 60.0
    cars = [car("inner", 0.0, 10.0, behaviour="follow"), car("middle", 0.0, 10.0, behaviour="follow")]
    cars[0]["on_track"]["offset"] = 3.0
    states = simulate(traffic_world(cars, length=length, closed=True), 10.0)
    assert states["s"][1] == pytest.approx(100.0, abs=1e-6)
    assert states["s"][0] == pytest.approx(100.0 / (1.0 - 3.0 / 60.0), rel=1e-5)
    assert math.hypot(states["x"][0] - 0.0, states["y"][0] - 60.0) == pytest.approx(57.0, abs=1e-3)


def test_the_heading_is_continuous_over_the_end_of_a_ring() -> None:
    headings: list[float] = []
    world = traffic_world([car("one", 95.0, 10.0, behaviour="follow")], length=100.0, closed=True)
    simulate(world, 1.0, each=lambda _, now: headings.append(float(now["yaw"][0])))
    turns = np.mod(np.diff(headings) + math.pi, 2.0 * math.pi) - math.pi
    assert turns == pytest.approx(2.0 * math.pi * 10.0 * DT / 100.0, rel=1e-6)


def test_a_lane_change_does_not_turn_sharper_than_its_radius() -> None:
    change, radius = 3.5, 5.4
    span = span_of(change, 0.0, radius)
    bends = [lateral(0.0, change, done, span)[2] for done in np.linspace(0.0, span, 2001)]
    assert max(map(abs, bends)) == pytest.approx(1.0 / radius, rel=1e-5)
    assert lateral(0.0, change, span, span) == (change, 0.0, 0.0)


def amplification(
    frequency: float, *, kp: float, kd: float, time_gap: float, lag: float, delay: float | None = None
) -> float:
    """Return |Gamma(j w)|: amplitude of the speed of a vehicle over that of the one ahead [-]; string stable if <= 1.

    With vehicles x'' = a, lag a' = -a + a_wanted, G = 1/(s² (lag s + 1)), K = kp + kd s and H = h s + 1:
    CACC: Gamma = (exp(-delay s) / (lag s + 1) + G K) / (H (1 + G K)), since the message is the acceleration, which has
    the lag, and not the commanded one; ACC: Gamma = G K / (1 + G (K + kp h s)).

    Args:
        frequency: w [rad/s].
        kp: gain of the spacing error [1/s^2].
        kd: gain of the speed difference [1/s].
        time_gap: h [s].
        lag: time constant of the vehicle [s].
        delay: of messages [s]; None: ACC, without messages.
    """
    s = 1j * frequency
    plant, control = 1.0 / (s * s * (lag * s + 1.0)), kp + kd * s
    if delay is None:
        return abs(plant * control / (1.0 + plant * (control + kp * time_gap * s)))
    loop = plant * control
    message = cmath.exp(-delay * s) / (lag * s + 1.0)
    return abs((message + loop) / ((time_gap * s + 1.0) * (1.0 + loop)))


@pytest.mark.parametrize(
    ("time_gap", "delay"), [(0.3, None), (2.5, None), (0.3, 0.15), (0.8, 0.15), (0.15, 0.4)]
)  # fmt: skip
def test_a_platoon_amplifies_disturbances_as_its_transfer_function_says(time_gap: float, delay: float | None) -> None:
    kp, kd, lag, dt = 0.2, 0.7, 0.1, 0.01
    for frequency in (0.3, 0.8, 1.5):
        # A vehicle behind one whose speed oscillates; its own acceleration has the lag.
        u = a = v = x = 0.0
        duration = 60.0 + 4.0 * 2.0 * math.pi / frequency
        speeds, history = [], [0.0] * max(1, 1 + round((delay or 0.0) / dt))
        for k in range(round(duration / dt)):
            t = k * dt
            lead, place = math.sin(frequency * t), (1.0 - math.cos(frequency * t)) / frequency
            history = [frequency * math.cos(frequency * t), *history[:-1]]
            gap = place - x + 2.0
            gains = {"kp": kp, "kd": kd, "time_gap": time_gap, "standstill": 2.0}
            if delay is None:
                wish = acc(gap, lead, v, **gains)
            else:
                u = wish = cacc_step(u, gap, lead, v, a, history[-1], dt, **gains)
            a += (wish - a) * (1.0 - math.exp(-dt / lag))
            v += a * dt
            x += v * dt
            speeds.append(v)
        period = round(2.0 * math.pi / frequency / dt)
        tail = np.array(speeds[-3 * period :])
        measured = 0.5 * float(np.ptp(tail))
        expected = amplification(frequency, kp=kp, kd=kd, time_gap=time_gap, lag=lag, delay=delay)
        assert measured == pytest.approx(expected, rel=0.03)


def test_string_stability_needs_a_time_gap() -> None:
    frequencies = np.geomspace(0.01, 20.0, 400)

    def worst(time_gap: float, delay: float | None) -> float:
        return max(amplification(w, kp=0.2, kd=0.7, time_gap=time_gap, lag=0.1, delay=delay) for w in frequencies)

    assert worst(3.0, None) <= 1.0 < worst(0.5, None)
    default = CaccSpec(kind="cacc", track="main", speed=10.0)
    assert worst(default.time_gap, default.delay) <= 1.0 < worst(0.6, default.delay)


def test_the_volume_of_an_actor_is_that_of_its_prop() -> None:
    world = traffic_world([car("one", 50.0, 0.0)], length=100.0)
    actor = world.actors[0]
    volume: Volume = actor.volume
    assert actor.front + actor.rear == pytest.approx(actor.prop.size[0], abs=0.01)
    assert volume.high == pytest.approx(actor.prop.size[2], abs=0.01)

"""Tyre models in the plant: forces at known slips, cornering, standstill, brakes, energy, steps, worlds, bad input."""

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from mirdrake.assembly.diagram import assemble
from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.plant.wheels.motion import wheel_places
from mirdrake.plant.wheels.step import tyre_step
from mirdrake.plant.wheels.tyre_nodes import TyreNodes
from mirdrake.runs.simulation import Simulation
from mirdrake.tyres import TYRES, SlipTyres
from mirdrake.tyres.brush import BrushTyre, brush_at_load, brush_forces, brush_on
from mirdrake.tyres.magic_formula import magic_formula
from mirdrake.tyres.tir import read_tir
from mirdrake.vehicles import load_vehicle
from tests.marks import mostly_slow
from tests.tyre_rigs import Watch, make_bolts, make_slope, motions, on_tyres, steady_forces

KINDS = ("brush", "magic_formula")
CONTACTS = ("point", "hydroelastic")
TIR = read_tir(Path(__file__).parent.parent / "models" / "tyres" / "215_50R17.tir").parameters
BRUSH = BrushTyre(
    nominal_load=4000,
    longitudinal_stiffness=88000,
    cornering_stiffness=54400,
    friction=1.0,
    friction_by_load=-0.1,
    peak_load=8000,
    half_length=0.06,
)


def tyre_kind(kind):
    tyres = TYRES[kind]
    assert issubclass(tyres, SlipTyres)
    return tyres


@pytest.fixture(scope="module")
def bolt(tmp_path_factory):
    folder = make_bolts(tmp_path_factory.mktemp("models"))
    return lambda variant: f"{folder}@{variant}"


@pytest.fixture(scope="module")
def free_car(bolt):
    """Return the diagram of a car whose wheels nothing drives; tests change only contexts of it."""
    return cache(lambda kind: on_tyres(bolt(f"{kind}_free"), contact="point"))


# --- forces at known slips ---------------------------------------------------------------------------------------


def sliding_state(assembly, *, vx=15.0, vy=0.0, slip=0.0, steering=0.0, roll=0.0):
    """Return a car at the height of rest that moves ahead and to the left, all wheels with one slip Vsx / -vx."""
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    state = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(assembly.make_context())).copy()
    q, v = part.base.floating_positions_start(), plant.num_positions() + part.base.floating_velocities_start_in_v()
    state[q : q + 4] = [np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0]
    state[v : v + 6] = [0.0, 0.0, 0.0, vx, vy, 0.0]
    for joint in part.steering:
        state[joint.position_start()] = steering
    places = wheel_places(part)
    for wheel_place, motion in zip(places, motions(plant.num_positions(), state.tolist(), places), strict=True):
        state[plant.num_positions() + wheel_place.spin] = motion.vx * (1.0 + slip) / motion.rolling
    return state


def expected(kind, kappa, tan_alpha, load, vx, gamma, friction):
    if kind == "brush":
        return brush_forces(BRUSH, kappa, tan_alpha, load, friction=friction)
    forces = magic_formula(TIR, kappa, tan_alpha, load, vx=vx, gamma=gamma, friction=friction)
    return forces.fx, forces.fy, forces.mz


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slip", [-0.3, -0.03, 0.0, 0.02])
@pytest.mark.parametrize(("vy", "steering", "roll"), [(0.0, 0.0, 0.0), (0.6, 0.0, 0.005), (-2.0, 0.1, -0.003)])
def test_forces_are_those_of_the_law_at_the_slips_of_the_wheels(free_car, kind, slip, vy, steering, roll):
    assembly = free_car(kind)
    state = sliding_state(assembly, vy=vy, slip=slip, steering=steering, roll=roll)
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    forces = steady_forces(assembly.tyres["ego"], state)
    stiffness = part.compression[0].stiffness
    for motion, (fx, fy, mz, kappa, alpha) in zip(
        motions(plant.num_positions(), state.tolist(), wheel_places(part)), forces, strict=True
    ):
        load = stiffness * (part.vehicle.geometry.front_wheel_radius - motion.radius)
        assert load > 500.0
        slips = -motion.slip_x / motion.vx, motion.vy / motion.vx
        assert [kappa, np.tan(alpha)] == pytest.approx(slips, abs=1e-7)
        target = expected(kind, *slips, load, motion.vx, motion.inclination, 1.0)
        # The curve of a tyre is interpolated over load and inclination: within 1e-3 of the load, as in test_tyre_nodes.
        assert [fx, fy] == pytest.approx(list(target[:2]), abs=1e-3 * load)
        assert mz == pytest.approx(target[2], abs=1e-4 * load)


@pytest.mark.parametrize("kind", KINDS)
def test_a_car_that_slides_to_its_left_is_pushed_to_the_right(free_car, kind):
    assembly = free_car(kind)
    forces = steady_forces(assembly.tyres["ego"], sliding_state(assembly, vy=0.5))
    assert (forces[:, 4] > 0.0).all()
    assert (forces[:, 1] < -500.0).all()
    assert (forces[:, 2] > 5.0).all()  # turns the wheels to the left, into the motion


@pytest.mark.parametrize("kind", KINDS)
def test_combined_slip_stays_in_the_friction_ellipse_and_costs_lateral_force(free_car, kind):
    assembly = free_car(kind)
    peaks = []
    for slip, vy in [(0.0, 0.9), (-0.05, 0.9), (-0.15, 0.9), (-0.6, 0.9), (-0.15, 0.0), (0.1, 3.0)]:
        forces = steady_forces(assembly.tyres["ego"], sliding_state(assembly, vy=vy, slip=slip))
        peaks.append(forces[0, :2])
    sides = [abs(force[1]) for force in peaks[:4]]
    assert all(late < early for early, late in pairwise(sides))
    load = 1616.0 * GRAVITY * 0.56 / 2.0
    most = (brush_at_load(BRUSH, load).limit,) * 2 if kind == "brush" else (1.10 * 1.01 * load, 0.95 * 1.01 * load)
    for fx, fy in peaks:
        assert np.hypot(fx / most[0], fy / most[1]) < 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_a_tyre_under_twice_the_load_gives_less_than_twice_the_force(free_car, kind):
    assembly = free_car(kind)
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    sides = []
    for times in (1.0, 2.0, 0.0):
        state = sliding_state(assembly, vy=6.0)
        deeper = (times - 1.0) * (part.vehicle.geometry.front_wheel_radius - state_radius(assembly, state))
        state[part.base.floating_positions_start() + 6] -= deeper
        forces = steady_forces(assembly.tyres["ego"], state, steps=400)
        sides.append(abs(forces[0, 1]))
    assert 1.6 * sides[0] < sides[1] < 1.97 * sides[0]
    assert sides[2] == 0.0  # in the air
    assert plant.time_step() == 0.005


def state_radius(assembly, state):
    places = wheel_places(assembly.parts.vehicles["ego"])
    return motions(assembly.parts.plant.num_positions(), state.tolist(), places)[0].radius


def test_the_aligning_moment_of_a_brush_tyre_changes_sign_with_the_direction_of_rolling():
    random = np.random.default_rng(3)
    for _ in range(300):
        load, friction = random.uniform(0.0, 12000.0), random.uniform(0.1, 1.3)
        kappa, slip, vx = random.uniform(-2.0, 2.0), random.uniform(-1.0, 1.0), random.uniform(-3.0, 20.0)
        full = brush_forces(BRUSH, kappa, slip, load, friction=friction)
        fade = np.sin(0.5 * np.pi * np.clip(vx, -1.0, 1.0))  # of the moment, as the direction of rolling turns round
        fast = brush_on(brush_at_load(BRUSH, load, friction=friction), kappa, slip, vx)
        assert fast == pytest.approx((full.fx, full.fy, full.mz * fade), rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_compiled_and_python_steps_are_equal(bolt, kind):
    assembly, random = on_tyres(bolt(kind), contact="point"), np.random.default_rng(5)
    tyres, law = assembly.tyres["ego"], tyre_kind(kind).law.forces
    context = tyres.CreateDefaultContext()
    quick, results = tyres.equations.step, []
    for step in (quick, lambda given: tyre_step(law, *map(with_dots, given))):
        random, samples = np.random.default_rng(5), []
        tyres.equations.step = step
        context.get_mutable_discrete_state().SetFrom(tyres.CreateDefaultContext().get_discrete_state())
        for speed in (0.0, 0.3, 12.0):
            for _ in range(5):
                slides = dict(zip(("vy", "slip", "steering", "roll"), random.uniform(-0.3, 0.3, 4), strict=True))
                tyres.plant_state.FixValue(context, sliding_state(assembly, vx=speed, **slides))
                tyres.wheel_torque.FixValue(context, random.uniform(0.0, 900.0, 8))
                force = tyres.generalized_force.Eval(context)
                context.get_mutable_discrete_state().SetFrom(tyres.EvalUniquePeriodicDiscreteUpdate(context))
                samples.append(np.concatenate([force, *(group.value() for group in discrete_groups(context))]))
        results.append(np.array(samples))
    assert np.abs(results[0]).max() > 1000.0
    assert results[0] == pytest.approx(results[1], rel=1e-9, abs=1e-9)


class Dotted:
    """A record whose fields Python can read and write with dots, as machine code does."""

    def __init__(self, record):
        self.__dict__["record"] = record

    def __getattr__(self, name):
        return with_dots(self.record[name])

    def __setattr__(self, name, value):
        self.record[name] = value


def with_dots(given):
    if isinstance(given, TyreNodes):
        return given
    if not given.dtype.names:
        return given
    return list(map(Dotted, given)) if given.shape else Dotted(given)


def discrete_groups(context):
    values = context.get_discrete_state()
    return [values.get_vector(index) for index in range(values.num_groups())]


# --- driving -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("contact", CONTACTS)
def test_a_wheel_without_torque_rolls_without_force(bolt, kind, contact):
    assembly = on_tyres(bolt(f"{kind}_free"), speed=10.0, contact=contact)
    watch = Watch(assembly)
    end = Simulation(assembly).run(duration=4.0, monitor=watch).signals.iloc[-1]
    assert end["ego.vx"] == pytest.approx(10.0, rel=2e-3)
    forces = np.mean(watch.forces[400:], axis=0)
    assert np.abs(forces[:, 0]).max() < 8.0  # of 4000 N of load


def locked_share(kind, friction=1.0):
    """Return the deceleration of the car with locked wheels over g, without load transfer."""
    loads = [1616.0 * GRAVITY * part / 2.0 for part in (0.56, 0.44)]
    return -sum(expected(kind, -1.0, 0.0, load, 5.0, 0.0, friction)[0] for load in loads) / (0.5 * 1616.0 * GRAVITY)


def steer(model, *, speed=12.0, angle=0.03, duration=3.0, **settings):
    return Simulation(on_tyres(model, speed=speed, steering=angle, **settings)).run(duration=duration).signals


def test_a_steady_circle_is_that_of_the_single_track_model(bolt):
    run = steer(bolt("brush_free"), contact="point")
    end = run.iloc[-20:].mean()
    mass, length, share = 1616.0, 2.601, 0.56
    front, rear = (2.0 * brush_at_load(BRUSH, mass * GRAVITY * part / 2.0).cornering for part in (share, 1.0 - share))
    ahead, behind = length * (1.0 - share), length * share
    angle = np.mean([np.tan(end[f"ego.steering_angle.{side}"]) for side in ("left", "right")])
    # m v r = Ff + Fr, a Ff - b Fr + Mz = 0; what the aligning moments add is half the length of the patch / 3.
    trail = BRUSH.half_length / 3.0
    gradient = mass * ((behind + trail) / front - (ahead - trail) / rear) / length
    speed = end["ego.vx"]
    assert end["ego.wz"] == pytest.approx(speed * angle / (length + gradient * speed**2), rel=0.01)
    neutral = speed * angle / length
    assert end["ego.wz"] < 0.95 * neutral  # it does understeer


@pytest.mark.parametrize("kind", KINDS)
def test_the_length_of_the_step_does_not_change_the_curve(bolt, kind):
    ends = [
        steer(bolt(kind), angle=0.05, duration=4.0, contact="point", time_step=step).iloc[-10:].mean()
        for step in (0.0025, 0.005, 0.01)
    ]
    for end in ends[:2]:
        for name in ("ego.wz", "ego.vy", "ego.x", "ego.y", "ego.tyre_fy.front_left"):
            assert end[name] == pytest.approx(ends[2][name], rel=2e-3)


def test_the_length_of_the_step_does_not_change_how_far_a_car_drifts_before_it_turns(bolt):
    """The error is at least of second order: 1 % at 10 ms and a quarter of it at 5 ms."""
    runs = [
        steer(bolt("brush"), angle=0.05, duration=0.8, contact="point", time_step=step)
        for step in (0.01, 0.005, 0.0025)
    ]
    coarse, middle, fine = (run["ego.vy"].min() for run in runs)
    assert coarse == pytest.approx(fine, rel=0.01)
    assert middle == pytest.approx(fine, rel=0.0025)


@pytest.mark.parametrize("step", [0.0025, 0.005])
def test_a_robot_rocks_on_its_tyres_with_their_stiffness_and_the_damping_of_their_rubber(step):
    """Free heave: ω² = 4 k / m, and Hunt-Crossley's damper N d at each wheel; the time step adds no damping."""
    assembly = assemble(
        {
            "world": "empty",
            "vehicles": {"ego": {"model": "unior@handling", "parked": True}},
            "control": {"ego": {"kind": "constant", "speed": 0.0}},
            "plant": {"contact": "point", "time_step": step},
        }
    )
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    simulator = Simulator(assembly.diagram, assembly.make_context())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    mass = plant.CalcTotalMass(context, [part.instance])
    X_WB = plant.EvalBodyPoseInWorld(context, part.base)
    rest, lift = X_WB.translation()[2], 0.001
    raised = X_WB.translation() + np.array([0.0, 0.0, lift])
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform(X_WB.rotation(), raised))
    stiffness, dissipation = 13450.0, 0.1556  # models/unior/contact.xacro
    rate = np.sqrt(4.0 * stiffness / mass)
    damping = 0.5 * mass * GRAVITY * dissipation / np.sqrt(4.0 * stiffness * mass)
    samples = []
    while (now := simulator.get_context().get_time()) < 4.5 * 2.0 * np.pi / rate:
        simulator.AdvanceTo(now + step)
        samples.append(plant.EvalBodyPoseInWorld(context, part.base).translation()[2] - rest)
    heights = np.array(samples) / lift
    tops = np.flatnonzero((heights[1:-1] > heights[:-2]) & (heights[1:-1] > heights[2:])) + 1
    assert 2.0 * np.pi * 3.0 / ((tops[3] - tops[0]) * step) == pytest.approx(rate, rel=0.02)
    assert np.log(heights[tops[0]] / heights[tops[3]]) / (6.0 * np.pi) == pytest.approx(damping, rel=0.1)


def test_hydroelastic_and_point_contact_corner_alike(bolt):
    point, patch = (steer(bolt("brush_free"), contact=contact).iloc[-20:].mean() for contact in CONTACTS)
    assert patch["ego.wz"] == pytest.approx(point["ego.wz"], rel=0.03)


def test_kinetic_energy_goes_where_the_tyres_slide(bolt):
    assembly = on_tyres(bolt("brush_free"), speed=12.0, steering=0.06, contact="point")
    watch, plant = Watch(assembly), assembly.parts.plant
    context = plant.CreateDefaultContext()

    def energy(state):
        plant.SetPositionsAndVelocities(context, state)
        return plant.CalcKineticEnergy(context)

    Simulation(assembly).run(duration=5.0, monitor=watch)
    work, base = 0.0, assembly.parts.vehicles["ego"].base
    yaw = plant.num_positions() + base.floating_velocities_start_in_v() + 2
    before = watch.motions(0)
    for index in range(1, len(watch.times)):
        now, step = watch.motions(index), watch.times[index] - watch.times[index - 1]
        for early, late, (fx, fy, mz, _, _) in zip(before, now, watch.forces[index], strict=True):
            slide = 0.5 * (early.slip_x + late.slip_x) * fx + 0.5 * (early.vy + late.vy) * fy
            turning = (
                watch.states[index][yaw] + late.spin * late.axle[2]
            )  # a leaning wheel turns on the road as it rolls
            work += (slide + mz * turning) * step
        before = now
    lost = energy(watch.states[-1]) - energy(watch.states[0])
    assert lost < -5e3  # of 118 kJ
    assert work == pytest.approx(lost, rel=0.005)


def test_without_slip_no_energy_is_lost(bolt):
    end = (
        Simulation(on_tyres(bolt("magic_formula_free"), speed=20.0, contact="point"))
        .run(duration=10.0)
        .signals.iloc[-1]
    )
    assert end["ego.vx"] == pytest.approx(20.0, rel=1e-3)


# --- standstill --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("contact", mostly_slow(CONTACTS))
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("how", ["brakes", "parked"])
def test_a_car_held_on_a_slope_of_five_degrees_does_not_creep(bolt, tmp_path, contact, kind, how):
    slope = str(make_slope(tmp_path, np.tan(np.radians(5.0))))
    torque = [0.0] * 4 + [1000.0] * 4
    assembly = on_tyres(
        bolt(f"{kind}_free"), torque=torque, parked=how == "parked", world=slope, contact=contact, rate=10.0
    )
    x = Simulation(assembly).run(duration=14.0).signals["ego.x"].to_numpy()
    assert -0.005 < x[40] - x[0] < 0.0  # deflects its tyres
    assert np.abs(x[40:] - x[40]).max() < 1e-4


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step", mostly_slow([0.01, 0.0025]))
def test_a_car_at_rest_stays_at_rest(bolt, contact, kind, step):
    run = Simulation(on_tyres(bolt(f"{kind}_free"), contact=contact, time_step=step)).run(duration=5.0).signals
    last = run.iloc[-50:]
    assert np.abs(last["ego.vx"]).max() < 1e-5
    assert np.abs(last["ego.wheel_speed.front_left"]).max() < 1e-4


@pytest.mark.parametrize("contact", mostly_slow(CONTACTS))
@pytest.mark.parametrize("kind", KINDS)
def test_at_walking_pace_there_is_no_oscillation(bolt, contact, kind):
    run = steer(bolt(kind), speed=0.1, angle=0.1, duration=8.0, contact=contact)
    last = run.iloc[-200:]
    assert last["ego.vx"].between(0.098, 0.102).all()
    for wheel in ("front_left", "rear_right"):
        assert last[f"ego.wheel_speed.{wheel}"].between(0.27, 0.36).all()
        forces = last[f"ego.tyre_fx.{wheel}"]
        assert np.abs(np.diff(forces, n=2)).max() < 5.0  # facets, but no chatter


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("torque", mostly_slow([800.0, 5000.0]))
def test_brakes_bring_the_car_to_a_stop_and_hold_it(bolt, contact, kind, torque):
    brakes = [torque, torque, 0.6 * torque, 0.6 * torque]
    assembly = on_tyres(bolt(f"{kind}_free"), speed=10.0, torque=[0.0] * 4 + brakes, contact=contact, rate=100.0)
    run = Simulation(assembly).run(duration=5.0).signals
    wheel = run["ego.wheel_speed.front_left"].to_numpy()
    assert np.abs(wheel[-200:]).max() < 5e-3
    # It rocks on its tyres: after 5 s with up to 0.022 m/s at 5 ms, and 0.021 m/s at 1.25 ms on every contact.
    assert np.abs(run["ego.vx"].to_numpy()[-40:]).max() < 0.025
    if torque > 2000.0:  # locked at once
        assert np.abs(wheel[10:]).max() < 0.05  # of 33 rad/s; facets of hydroelastic contact make it oscillate
        assert run["ego.x"].max() == pytest.approx(50.0 / (locked_share(kind) * GRAVITY), rel=0.06)
    else:  # the deceleration follows from the brake torques; the wheels' inertia counts
        radius = np.mean(assembly.parts.vehicles["ego"].rolling_radii(assembly.parts.plant))
        mass = 1616.0 + 4.0 * 0.5 * 20.0
        speed = run["ego.vx"].to_numpy()
        assert (speed[50] - speed[100]) / 0.5 == pytest.approx(sum(brakes) / radius / mass, rel=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_the_length_of_the_step_does_not_change_the_braking_distance(bolt, kind):
    trajectories = []
    for step in (0.0025, 0.005, 0.01):
        torque = [0.0] * 4 + [1250.0] * 2 + [600.0] * 2
        assembly = on_tyres(bolt(f"{kind}_free"), speed=10.0, torque=torque, contact="point", time_step=step)
        trajectories.append(Simulation(assembly).run(duration=3.0).signals["ego.x"].max())
    assert trajectories == pytest.approx([trajectories[0]] * 3, rel=0.01)


def test_a_driven_wheel_on_the_spot_does_not_wind_up(bolt):
    assembly = on_tyres(bolt("brush_free"), torque=[600.0, 600.0] + [0.0] * 6, contact="point")
    run = Simulation(assembly).run(duration=1.0).signals
    assert run["ego.vx"].iloc[-1] == pytest.approx(1200.0 / (0.97 * 0.3234) / 1656.0, rel=0.03)
    wheel = run["ego.wheel_speed.front_left"].to_numpy()
    assert (np.diff(wheel[10:]) > 0.0).all()  # after the jolt of the start


def test_on_brush_tyres_the_trail_changes_sign_when_a_car_rolls_back(bolt):
    assembly = on_tyres(bolt("brush_free"), contact="point")
    forward = steady_forces(assembly.tyres["ego"], sliding_state(assembly, vy=0.5))
    back = steady_forces(assembly.tyres["ego"], sliding_state(assembly, vx=-15.0, vy=0.5))
    assert back[:, 1] == pytest.approx(forward[:, 1])
    assert back[:, 2] == pytest.approx(-forward[:, 2])


# --- worlds ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_on_ice_the_forces_are_those_of_ice(bolt, tmp_path, kind):
    path = tmp_path / "ice.yaml"
    patch = "{rect: {center: [20, 0], size: [80, 20]}, surface: ice, mu: 0.1}"
    path.write_text(f"mirdrake: world/1\nground: {{surface: asphalt, patches: [{patch}]}}\n", encoding="utf-8")
    torque = [0.0] * 4 + [3000.0] * 4
    assembly = on_tyres(bolt(f"{kind}_free"), speed=5.0, torque=torque, world=str(path), contact="point")
    watch = Watch(assembly)
    Simulation(assembly).run(duration=1.0, monitor=watch)
    sliding = np.mean([forces[:, 0].sum() for forces in watch.forces[100:]])
    assert -sliding / (1616.0 * GRAVITY) == pytest.approx(locked_share(kind, friction=0.1 / 0.85), rel=0.01)


def test_split_friction_turns_a_braking_car_to_the_side_that_grips(bolt, tmp_path):
    path = tmp_path / "split.yaml"
    patch = "{rect: {center: [0, 10], size: [200, 20]}, surface: ice, mu: 0.1}"
    path.write_text(f"mirdrake: world/1\nground: {{surface: asphalt, patches: [{patch}]}}\n", encoding="utf-8")
    torque = [0.0] * 4 + [3000.0] * 4
    assembly = on_tyres(bolt("brush_free"), speed=10.0, torque=torque, world=str(path), contact="point")
    first, second = (Simulation(assembly).run(duration=0.5).signals for _ in range(2))
    assert first["ego.wz"].iloc[-1] < -0.3
    assert first.equals(second)


def test_two_cars_each_have_their_tyres(bolt):
    spec = {
        "world": str(Path(bolt("brush")).parent / "asphalt.yaml"),
        "vehicles": {
            "first": {"model": bolt("coulomb"), "speed": 8.0, "start": {"x": 0, "y": 5}},
            "ego": {"model": bolt("brush"), "speed": 8.0, "start": {"x": 0, "y": 0}},
        },
        "control": {name: {"kind": "constant", "speed": 8.0, "steering": 0.05} for name in ("first", "ego")},
        "plant": {"contact": "point"},
    }
    run = Simulation(assemble(spec)).run(duration=2.0).signals
    alone = steer(bolt("brush"), speed=8.0, angle=0.05, duration=2.0, contact="point", air_density=1.2)
    assert run["ego.wz"].iloc[-1] == pytest.approx(alone["ego.wz"].iloc[-1], rel=1e-3)
    # The other car has Coulomb tyres: its slip angles are a tenth of those of the brush tyres.
    assert abs(run["first.tyre_alpha.rear_left"].iloc[-1]) < 0.2 * abs(run["ego.tyre_alpha.rear_left"].iloc[-1])


# --- bad input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tyres", "expected_message"),
    [
        ("{kind: brsh, rolling_resistance: 0}", "tyres.kind: unknown kind 'brsh'; did you mean 'brush'"),
        (
            "{kind: magic_formula, rolling_resistance: 0, file: 215_50R18.tir}",
            "tyres.file: no file '215_50R18.tir'; did you mean '215_50R17.tir'?",
        ),
        (
            "{kind: magic_formula, rolling_resistance: 0, file: 215_50R17.tir, rear_file: no.tir}",
            "tyres.rear_file: no file 'no.tir'",
        ),
        (
            "{kind: magic_formula, rolling_resistance: 0, file: tyre.yaml}",
            "tyres.file: 'tyre.yaml' is not a tyre property",
        ),
        (
            "{kind: magic_formula, rolling_resistance: 0, file: 215_50R17.tir, scale: {lmu: 1}}",
            "tyres.scale.lmu: unknown field; did you mean 'lmuy'?",
        ),
        ("{kind: brush, rolling_resistance: 0}", "tyres.front: is missing"),
    ],
)
def test_wrong_tyres_are_rejected_with_their_place(tmp_path, tyres, expected_message):
    folder = make_bolts(tmp_path)
    file = folder / "variants" / "wrong.yaml"
    file.write_text(f"description: wrong\nvehicle:\n  tyres: {tyres}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_vehicle(f"{folder}@wrong")
    assert f"wrong.yaml:3: {expected_message}" in str(caught.value)


def test_a_tir_file_of_the_vehicles_own_comes_first_and_its_faults_are_named(tmp_path):
    folder = make_bolts(tmp_path)
    (folder / "215_50R17.tir").write_text("[UNITS]\nLENGTH = 'furlong'\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"215_50R17\.tir:2: \[UNITS\] LENGTH: unknown unit"):
        on_tyres(f"{folder}@magic_formula")


def test_scale_factors_multiply_those_of_the_file(tmp_path):
    folder = make_bolts(tmp_path)
    text = "description: slippery\nvehicle: {tyres: {kind: magic_formula, rolling_resistance: 0, file: 215_50R17.tir, "
    text += "scale: {lmuy: 0.5}, rear_scale: {lky: 2}}}\ncontrol: {wheel_speed: {kind: pid, kp: 0}}\n"
    (folder / "variants" / "scaled.yaml").write_text(text, encoding="utf-8")
    whole, scaled = (on_tyres(f"{folder}@{name}", contact="point") for name in ("magic_formula_free", "scaled"))
    for vy, wheel, factor in ((6.0, 0, 0.5), (0.02, 2, 2.0)):
        sides = [
            steady_forces(assembly.tyres["ego"], sliding_state(assembly, vy=vy))[wheel, 1]
            for assembly in (whole, scaled)
        ]
        assert sides[1] == pytest.approx(factor * sides[0], rel=0.05)

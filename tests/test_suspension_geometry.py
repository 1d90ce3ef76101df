"""Roll centres, anti-dive and bump stops: worked numbers, and closed forms of load transfer."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError
from mirdrake.core.paths import data_root
from mirdrake.ground import FLAT
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.plant.suspension import make_bump_stops
from mirdrake.plant.wheels.ground_contact import add_ground_force, ground_contact
from mirdrake.plant.wheels.motion import (
    WheelMotion,
    WheelPlace,
    add_road_force,
    base_motion,
    wheel_motion,
    wheel_places,
    wheel_pose,
)
from mirdrake.runs.simulation import Simulation
from mirdrake.single_track import estimate_parameters
from mirdrake.tyres import SlipTyres
from mirdrake.vehicles import WHEELS, Vehicle, load_vehicle
from mirdrake.vehicles.chassis_spec import AxleSuspension
from mirdrake.worlds import load_world
from tests.suspension_rigs import FRONT, REAR, on_springs, pushed_car

TRACK, HEIGHT, WHEELBASE = 1.501, 0.5, 2.601  # the Bolt's [m]
HANDLING = {"front": {"stiffness": 28e3, "anti_roll": 12e3}, "rear": {"stiffness": 27e3, "anti_roll": 17e3}}
TYRE = 2e5  # vertical stiffness of a tyre [N/m]
AT_REST = 0.00186  # pitch of the Bolt at rest [rad]
Axle = dict[str, Any]


def rows_of(vehicle: Vehicle) -> tuple[Any, Any, list[int]]:
    """Return a plant with the vehicle, its part, and the rows of its suspension joints."""
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle})
    part = parts.vehicles["ego"]
    return parts.plant, part, [joint.velocity_start() for joint in part.suspension]


TABLES = {
    "camber": [(-0.08, 0.02), (0.0, -0.01), (0.03, -0.02), (0.08, -0.05)],
    "toe": [(-0.08, -0.004), (0.0, 0.002), (0.08, 0.006)],
    "roll_centre": [(-0.08, 0.12), (0.08, 0.02)],
    "anti_drive": [(-0.05, 0.02), (0.05, 0.06)],
    "anti_brake": 0.09,
}


def arms_of(vehicle: Vehicle) -> tuple[Any, Any, list[WheelPlace]]:
    """Return a plant with the vehicle, its part and its wheels."""
    plant, part, _ = rows_of(vehicle)
    return plant, part, wheel_places(part)


def state_at(plant: Any, part: Any, wheel: WheelPlace, *, travel: float, deflection: float = 0.0) -> Any:
    """Return the state of a level vehicle at rest, with a wheel on the road."""
    state = np.zeros(plant.num_multibody_states())
    base = part.base.floating_positions_start()
    state[base], state[base + 6], state[wheel.suspension[0]] = 1.0, -travel - deflection, travel
    return state


def motion_at(plant: Any, part: Any, wheel: WheelPlace, *, travel: float) -> WheelMotion:
    """Return the motion of a wheel of a level vehicle at rest."""
    state, positions = state_at(plant, part, wheel, travel=travel), plant.num_positions()
    return wheel_motion(state, wheel, base_motion(state, wheel.base, positions), positions)


@pytest.mark.parametrize("index", range(4))
def test_toe_and_camber_are_those_of_the_table_on_both_sides(index: int) -> None:
    plant, part, wheels = arms_of(on_springs(front=FRONT | TABLES, rear=REAR | TABLES))
    side = 1.0 if index % 2 == 0 else -1.0
    for travel, camber, toe in ((-0.08, 0.02, -0.004), (0.0, -0.01, 0.002), (0.08, -0.05, 0.006)):
        motion = motion_at(plant, part, wheels[index], travel=travel)
        # Camber is positive with the top outwards, toe for toe-in: left wheel to the left, and turned to the right.
        assert motion.inclination == pytest.approx(-side * camber, abs=1e-9)
        assert np.arctan2(motion.ahead[1], motion.ahead[0]) == pytest.approx(-side * toe, abs=1e-9)
    # Outside of a table the slope of its end continues.
    leans = [motion_at(plant, part, wheels[index], travel=travel).inclination for travel in (0.0799, 0.08, 0.1)]
    assert (leans[2] - leans[1]) / 0.02 == pytest.approx((leans[1] - leans[0]) / 1e-4, rel=0.01)


@pytest.mark.parametrize("index", range(4))
def test_the_force_on_the_travel_is_the_virtual_work_along_the_path_of_the_contact_point(index: int) -> None:
    plant, part, wheels = arms_of(on_springs(front=FRONT | TABLES, rear=REAR | TABLES))
    wheel, step = wheels[index], 1e-5
    side, end = (1.0 if index % 2 == 0 else -1.0), (1.0 if index < 2 else -1.0)
    for travel in (-0.1, -0.04, 0.02, 0.05, 0.09):
        low, here, high = (motion_at(plant, part, wheel, travel=travel + s) for s in (-step, 0.0, step))
        moved = (np.array(high.arm_base) - low.arm_base) / (2.0 * step)
        # The contact point at the height of the road; the path is that of the contact point at the radius of the wheel.
        height = float(np.interp(travel, [-0.08, 0.08], [0.12, 0.02])) if abs(travel) < 0.08 else None
        slope = float(np.interp(travel, [-0.05, 0.05], [0.02, 0.06])) if abs(travel) < 0.05 else None
        if height is not None:
            assert here.path[1] == pytest.approx(side * 2.0 * height / TRACK, abs=2e-5)
        if slope is not None:
            assert here.path[0] == pytest.approx(end * slope, abs=1e-9)
        # The place of the contact point, unlike its velocity, has products of toe, camber and kingpin offset.
        products = []
        for one in (low, high):
            lean, toe = np.tan(one.inclination), np.arctan2(one.ahead[1], one.ahead[0])
            arm = wheel.arms.radius * lean + wheel.offset / np.cos(one.inclination)
            across = arm * np.cos(toe) - wheel.arms.radius * np.sin(one.inclination)
            products.append([-arm * np.sin(toe), across])
        expected = np.array(here.path[:2]) + (np.array(products[1]) - products[0]) / (2.0 * step)
        assert moved[:2] == pytest.approx(expected, abs=1e-4)
        force = [0.0] * plant.num_velocities()
        add_road_force(force, wheel, here, 500.0, -1200.0, 40.0)
        x, y = 500.0 * here.ahead[0] + 1200.0 * here.ahead[1], 500.0 * here.ahead[1] - 1200.0 * here.ahead[0]
        toe = (np.arctan2(*high.ahead[::-1]) - np.arctan2(*low.ahead[::-1])) / (2.0 * step)
        work = x * here.path[0] + y * here.path[1] + 40.0 * toe
        assert force[wheel.suspension[1]] == pytest.approx(work, abs=1e-3)


def test_the_contact_of_a_vertical_tyre_has_the_same_path() -> None:
    plant, part, wheels = arms_of(on_springs(front=FRONT | TABLES, rear=REAR | TABLES))
    positions, random = plant.num_positions(), np.random.default_rng(3)
    for wheel in wheels:
        state = state_at(plant, part, wheel, travel=0.03, deflection=0.005)
        state[positions + wheel.suspension[1]] = 0.7
        velocity = positions + part.base.floating_velocities_start_in_v()
        state[velocity : velocity + 6] = random.uniform(-1.0, 1.0, 6)
        base = base_motion(state, wheel.base, positions)
        flat = wheel_motion(state, wheel, base, positions)
        ground = ground_contact(state, wheel, wheel.arms.radius, 0.2, base, positions, FLAT.data, 0)
        assert (ground.vx, ground.vy) == pytest.approx((flat.vx, flat.vy), abs=1e-12)
        assert ground.turn == pytest.approx(flat.turn, abs=1e-12)
        assert ground.path == pytest.approx(flat.path, abs=1e-12)
        assert ground.inclination == pytest.approx(flat.inclination, abs=1e-12)
        forces: list[list[float]] = [[0.0] * plant.num_velocities() for _ in range(2)]
        add_road_force(forces[0], wheel, flat, 500.0, -1200.0, 40.0, 300.0, -5.0, -200.0, 70.0)
        add_ground_force(forces[1], wheel, ground, (500.0, -1200.0, 300.0), 40.0, -5.0, -200.0, 70.0)
        assert forces[1] == pytest.approx(forces[0], abs=1e-9 * 1e3)


@pytest.mark.parametrize("uneven", [False, True], ids=["plane", "ground"])
@pytest.mark.parametrize("index", range(4))
def test_forces_and_moments_of_the_road_have_their_power(index: int, uneven: bool) -> None:
    """A car that rolls, pitches, steers and travels: force times velocity, moment times angular velocity of the wheel.

    The angular velocity is that of differences of the frame of the wheel carrier: x axis, axle and their product.
    """
    plant, part, wheels = arms_of(on_springs(front=FRONT | TABLES, rear=REAR | TABLES))
    positions, random, wheel = plant.num_positions(), np.random.default_rng(index), wheels[index]
    wheel = wheel._replace(rolling=0.3)
    context = plant.CreateDefaultContext()
    q = state_at(plant, part, wheel, travel=0.03, deflection=0.005)[:positions]
    start = part.base.floating_positions_start()
    q[start : start + 4] = RollPitchYaw(0.2, -0.25, 0.7).ToQuaternion().wxyz()
    if wheel.steering[0] >= 0:
        q[wheel.steering[0]] = 0.3
    v = random.uniform(-1.0, 1.0, plant.num_velocities())
    plant.SetPositions(context, q)
    moved = plant.MapVelocityToQDot(context, v)

    def pose(positions_now: Any) -> Any:
        state: Any = np.concatenate([positions_now, v])
        return wheel_pose(state, wheel, base_motion(state, wheel.base, positions), positions)

    def frame(positions_now: Any) -> Any:
        base = RotationMatrix(
            Quaternion(positions_now[start : start + 4] / np.linalg.norm(positions_now[start : start + 4]))
        )
        axle = np.array(pose(positions_now).axle)
        along = np.cross(axle, base.matrix()[:, 2])
        along /= np.linalg.norm(along)
        return np.column_stack([along, axle, np.cross(along, axle)])

    step = 1e-6
    turning = (frame(q + step * moved) - frame(q - step * moved)) / (2.0 * step) @ frame(q).T
    omega = np.array([turning[2, 1], turning[0, 2], turning[1, 0]])

    state: Any = np.concatenate([q, v])
    base, force = base_motion(state, wheel.base, positions), [0.0] * plant.num_velocities()
    fx, fy, fz, mz, resistance, mx = 500.0, -1200.0, 300.0, 40.0, -5.0, 70.0
    contact: Any
    if uneven:
        contact = ground_contact(state, wheel, wheel.arms.radius, 0.2, base, positions, FLAT.data, 0)
        add_ground_force(force, wheel, contact, (fx, fy, fz), mz, resistance, 0.0, mx)
        ahead, left, normal = (np.array(axis) for axis in (contact.ahead, contact.left, contact.normal))
    else:
        contact = wheel_motion(state, wheel, base, positions)
        add_road_force(force, wheel, contact, fx, fy, mz, fz, resistance, 0.0, mx)
        normal = np.array([0.0, 0.0, 1.0])
        ahead = np.array([*contact.ahead, 0.0])
        left = np.cross(normal, ahead)
    assert contact.turn == pytest.approx(omega @ normal, abs=1e-6)
    rise, rate = pose(q).rise, pose(q).rate
    velocity = np.array(base.velocity) + np.cross(base.turning, contact.arm_base) + rise * np.array(contact.path)
    velocity += rate * np.cross(contact.up, contact.arm_pivot)
    assert (velocity @ ahead, velocity @ left) == pytest.approx((contact.vx, contact.vy), abs=1e-9)
    axle = np.array(contact.axle)
    moment, spin = mz * normal + resistance * axle + mx * ahead, v[wheel.spin]
    power = (fx * ahead + fy * left + fz * normal) @ velocity + moment @ omega
    power += (moment @ axle - 0.3 * fx) * spin
    assert np.dot(force, v) == pytest.approx(power, rel=1e-7)


def test_arms_press_the_outer_wheel_down_and_support_the_nose_under_braking() -> None:
    geometry = {"anti_brake": 0.1, "anti_drive": 0.05}
    plant, part, wheels = arms_of(on_springs(front=FRONT | geometry | {"roll_centre": 0.15}, rear=REAR | geometry))

    def travel_forces(fx: float, fy: float, *, braked: bool) -> list[float]:
        result = []
        for wheel in wheels:
            force = [0.0] * plant.num_velocities()
            motion = motion_at(plant, part, wheel, travel=0.0)
            add_road_force(force, wheel, motion, fx, fy, 0.0, brake=fx * motion.rolling if braked else 0.0)
            result.append(force[wheel.suspension[1]])
        return result

    # Left turn with 1000 N on each wheel: 2 x 0.15 / 1.501 of it in front, the inner wheel up and the outer one down.
    assert travel_forces(0.0, 1000.0, braked=False) == pytest.approx([199.867, -199.867, 0.0, 0.0], abs=1e-3)
    # Braking with 1000 N a wheel: front wheels are pressed away from the body, rear wheels are drawn to it.
    assert travel_forces(-1000.0, 0.0, braked=True) == pytest.approx([-100.0, -100.0, 100.0, 100.0])
    # A motor that brakes acts through half shafts, with the slope of driving forces.
    assert travel_forces(-1000.0, 0.0, braked=False) == pytest.approx([-50.0, -50.0, 50.0, 50.0])
    # Driving: the nose is drawn down, the tail pressed up.
    assert travel_forces(1000.0, 0.0, braked=False) == pytest.approx([50.0, 50.0, -50.0, -50.0])


def test_a_table_of_an_axle_is_checked() -> None:
    with pytest.raises(ValueError, match="ascending travel"):
        AxleSuspension(stiffness=1.0, damping=1.0, toe=[(0.0, 0.0), (0.0, 0.1)])
    rows = [[(0.01 * i + 0.001 * j, 0.0) for i in range(6)] for j in range(3)]
    with pytest.raises(ValueError, match="18 different travels, but at most 16"):
        AxleSuspension(stiffness=1.0, damping=1.0, toe=rows[0], camber=rows[1], roll_centre=rows[2])


def test_a_bump_stop_acts_beyond_its_travel_only() -> None:
    stop = {"bump_stop": {"travel": 0.05, "stiffness": 100e3}}
    plant, part, rows = rows_of(on_springs(front=FRONT | stop))
    stops = make_bump_stops(plant, part)
    assert stops is not None
    root, context = plant.CreateDefaultContext(), stops.CreateDefaultContext()
    for joint, travel in zip(part.suspension, (0.06, 0.04, 0.09, -0.09), strict=True):
        joint.set_translation(root, travel)
    stops.get_input_port().FixValue(context, plant.GetPositionsAndVelocities(root, part.instance))
    force = np.array(stops.get_output_port().Eval(context))
    assert force[rows] == pytest.approx([-1000.0, 0.0, 0.0, 0.0])
    assert np.delete(force, rows) == pytest.approx(0.0)


def test_a_bump_stop_too_stiff_for_the_time_step_is_an_error_with_the_largest_stiffness() -> None:
    vehicle = on_springs(front=FRONT | {"bump_stop": {"travel": 0.05, "stiffness": 5e6}})
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle}, spec=PlantSpec(time_step=0.005))
    # 40 kg below a front spring: 40 / 0.005² N/m.
    with pytest.raises(
        ConfigError, match=r"5e\+06 N/m is too stiff for 40 kg of unsprung mass .* at most 1.6e\+06 N/m"
    ):
        make_bump_stops(parts.plant, parts.vehicles["ego"])


# --- on the road -------------------------------------------------------------------------------------------------


def plain_numbers(keys: Axle) -> Axle:
    """Return keys without types of NumPy and without tuples."""
    result: Axle = json.loads(json.dumps(keys, default=float))
    return result


def drive(
    folder: Path,
    front: Axle,
    rear: Axle,
    control: dict[str, Any] | list[dict[str, float]],
    *,
    speed: float,
    duration: float,
    tyre: str | None = None,
    contact: str = "tyre",
) -> pd.DataFrame:
    """Return the signals of a Bolt on slip tyres with these keys added to its axles; only friction brakes brake it."""
    folder.mkdir()
    (folder / "variants").mkdir()
    source = data_root() / "models" / "bolt"
    for path in source.iterdir():
        if path.name != "variants":
            (folder / path.name).symlink_to(path)
    change = yaml.safe_load((source / "variants" / "handling.yaml").read_text(encoding="utf-8"))
    for name, keys in (("front", front), ("rear", rear)):
        change["vehicle"]["suspension"][name] |= plain_numbers(keys)
    change["vehicle"]["powertrain"]["regeneration"] = None
    if tyre is not None:
        (folder / "own.tir").write_text(tyre, encoding="utf-8")
        change["vehicle"]["tyres"]["file"] = "own.tir"
    control = {"kind": "schedule", "rows": control} if isinstance(control, list) else control
    (folder / "variants" / "x.yaml").write_text(yaml.safe_dump(change), encoding="utf-8")
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": f"{folder}@x", "speed": speed}},
        "control": {"ego": control},
        "plant": {"contact": contact, "time_step": 0.005},
    }
    return Simulation(assemble(spec)).run(duration=duration).signals


@pytest.mark.parametrize("contact", ["point", pytest.param("hydroelastic", marks=pytest.mark.slow)])
def test_in_a_steady_turn_arms_act_the_same_on_every_contact(tmp_path: Path, contact: str) -> None:
    """The contact shapes do not move with the arms, but the tyres do: 0.6 mm are 2 % of the roll and 40 N of a load."""
    turn = {"kind": "constant", "speed": 14.0, "steering": 0.06}
    ends = []
    for name in ("tyre", contact):
        signals = drive(tmp_path / name, TABLES, TABLES, turn, speed=14.0, duration=4.0, contact=name)
        ends.append(signals.tail(20).mean())
    tyre, other = ends
    assert tyre["ego.roll"] > 0.03
    for name in ("ego.wz", "ego.vx", "ego.roll"):
        assert other[name] == pytest.approx(tyre[name], rel=1e-3)
    for wheel in WHEELS:
        assert other[f"ego.wheel_load.{wheel}"] == pytest.approx(tyre[f"ego.wheel_load.{wheel}"], abs=2.0)


def test_in_a_steady_turn_arms_take_the_share_of_their_roll_centres(tmp_path: Path) -> None:
    turn = {"kind": "constant", "speed": 12.0, "steering": 0.07}
    heights = {"front": 0.10, "rear": 0.20}
    plain = drive(tmp_path / "plain", {}, {}, turn, speed=12.0, duration=5.0).iloc[-1]
    front, rear = ({"roll_centre": heights[axle]} for axle in ("front", "rear"))
    armed = drive(tmp_path / "arms", front, rear, turn, speed=12.0, duration=5.0).iloc[-1]
    lateral = {
        axle: sum(armed[f"ego.tyre_fy.{axle}_{side}"] for side in ("left", "right")) for axle in ("front", "rear")
    }
    assert armed["ego.wz"] == pytest.approx(plain["ego.wz"], rel=0.02)
    # Springs carry N T - F h of an axle's moment N T: (N T - F h) / K + N T / K_t = φ for both axles, with N T of both
    # together the moment of the lateral force. The plain car gives the softness 1 / K + 1 / K_t of each axle.
    springs = {axle: (row["stiffness"] / 2.0 + row["anti_roll"]) * TRACK**2 for axle, row in HANDLING.items()}
    softness = {axle: plain["ego.roll"] / (transfer(plain, axle) * TRACK) for axle in heights}
    lifted = {axle: lateral[axle] * heights[axle] / springs[axle] for axle in heights}
    moment = sum(transfer(armed, axle) for axle in heights) * TRACK
    overturning = sum(overturning_moments(armed, 0.088))
    # The roll shifts the weight by another few percent.
    assert moment == pytest.approx(HEIGHT * sum(lateral.values()) + overturning, rel=0.05)
    roll = (moment - sum(lifted[axle] / softness[axle] for axle in heights)) / sum(1.0 / s for s in softness.values())
    assert armed["ego.roll"] == pytest.approx(roll, rel=0.02)
    for axle in heights:
        assert transfer(armed, axle) * TRACK == pytest.approx((roll + lifted[axle]) / softness[axle], rel=0.02)
    assert roll < 0.9 * plain["ego.roll"]


def overturning_moments(row: pd.Series, factor: float) -> list[float]:
    """Return Mx = R0 N QSX3 Fy / FNOMIN of each tyre (4.E69) [N m], with QSX3 = `factor`."""
    return [0.3234 * row[f"ego.wheel_load.{wheel}"] * factor * row[f"ego.tyre_fy.{wheel}"] / 4000.0 for wheel in WHEELS]


def transfer(row: pd.Series, axle: str) -> float:
    """Return half of the difference of an axle's wheel loads [N]."""
    return float(row[f"ego.wheel_load.{axle}_right"] - row[f"ego.wheel_load.{axle}_left"]) / 2.0


BRAKING = [{"time": t, "speed": v, "steering": 0.0} for t, v in ((0.0, 20.0), (0.5, 20.0), (4.5, 0.0))]


def test_anti_dive_takes_its_part_of_the_front_springs_compression(tmp_path: Path) -> None:
    travels, forces, pitches = [], [], []
    for name, slope in (("plain", 0.0), ("anti", 0.08)):
        signals = drive(tmp_path / name, {"anti_brake": slope}, {}, BRAKING, speed=20.0, duration=4.0)
        late = signals.loc[3.2:4.0].mean()  # the pitching has died out
        travels.append(sum(late[f"ego.travel.front_{side}"] for side in ("left", "right")))
        forces.append(sum(late[f"ego.tyre_fx.front_{side}"] for side in ("left", "right")))
        pitches.append(late["ego.pitch"])
    assert forces[1] == pytest.approx(forces[0], rel=0.02)
    # The two springs c carry anti_brake times the braking force of the axle less. Along the joints, which pitch with
    # the body, the braking force itself has a component that is smaller by the difference of the pitch angles.
    expected = -forces[1] * (0.08 - (pitches[0] - pitches[1]))
    assert (travels[0] - travels[1]) * FRONT["stiffness"] == pytest.approx(expected, rel=0.03)


def test_full_anti_dive_and_anti_lift_leave_no_travel_under_braking(tmp_path: Path) -> None:
    # Braking force F of which the front has the share p: its arms support F H / L with p F anti_brake, H / (p L) each.
    plain = drive(tmp_path / "plain", {}, {}, BRAKING, speed=20.0, duration=4.0).loc[3.2:4.0].mean()
    force = {axle: sum(plain[f"ego.tyre_fx.{axle}_{side}"] for side in ("left", "right")) for axle in HANDLING}
    share = force["front"] / sum(force.values())
    height = HEIGHT - 0.02  # on tyres that are compressed
    front, rear = ({"anti_brake": height / (part * WHEELBASE)} for part in (share, 1.0 - share))
    anti = drive(tmp_path / "anti", front, rear, BRAKING, speed=20.0, duration=4.0).loc[3.2:4.0].mean()
    for axle in HANDLING:
        for side in ("left", "right"):
            signal = f"ego.travel.{axle}_{side}"
            assert abs(anti[signal]) < 0.03 * abs(plain[signal])
    # What is left are the tyres: 2 F H / (k L²), both axles on tyres of 200 kN/m.
    tyres = -sum(force.values()) * height / WHEELBASE**2 / TYRE
    rest = (anti["ego.travel.front_left"] - anti["ego.travel.rear_left"]) / WHEELBASE
    assert anti["ego.pitch"] - AT_REST == pytest.approx(tyres + rest, rel=0.03)


def test_camber_of_the_arms_changes_the_lateral_force_as_the_tyre_law_says(tmp_path: Path) -> None:
    turn = {"kind": "constant", "speed": 12.0, "steering": 0.06}
    camber = {"camber": [(-0.08, 0.06), (0.0, -0.02), (0.08, -0.10)]}
    row = drive(tmp_path / "camber", camber, camber, turn, speed=12.0, duration=4.0).iloc[-1]
    tyres = load_vehicle("bolt@handling").spec.tyres
    assert isinstance(tyres, SlipTyres)
    laws = tyres.axle_laws(data_root() / "models" / "bolt")
    for index, name in enumerate(WHEELS):
        # The body leans to the right by its roll; camber counts outwards, to the left at a left wheel.
        side, travel = (1.0 if name.endswith("left") else -1.0), row[f"ego.travel.{name}"]
        inclination = row["ego.roll"] - side * (-0.02 - 1.0 * travel)
        slip = row[f"ego.tyre_kappa.{name}"], np.tan(row[f"ego.tyre_alpha.{name}"]), row["ego.vx"]
        load = row[f"ego.wheel_load.{name}"]
        force, upright = (laws[index >= 2](load, lean, 1.0).forces(*slip)[1] for lean in (inclination, row["ego.roll"]))
        assert row[f"ego.tyre_fy.{name}"] == pytest.approx(force, abs=15.0)
        if travel > 0.0:
            assert abs(force - upright) > 50.0


def test_tables_of_zeros_change_no_bit(tmp_path: Path) -> None:
    rows = [{"time": t, "speed": 15.0, "steering": angle} for t, angle in ((0.0, 0.0), (0.3, 0.05), (0.8, -0.05))]
    zeros: Axle = {key: [(-0.05, 0.0), (0.0, 0.0), (0.04, 0.0)] for key in ("camber", "toe", "roll_centre")}
    zeros |= {"anti_brake": 0.0, "anti_drive": 0.0}
    plain, armed = (
        drive(tmp_path / str(len(keys)), keys, keys, rows, speed=15.0, duration=1.5) for keys in ({}, zeros)
    )
    pd.testing.assert_frame_equal(armed, plain, check_exact=True)


def test_the_reduced_model_has_the_roll_steer_and_the_camber_of_the_arms() -> None:
    plain = estimate_parameters(load_vehicle("bolt@handling"))
    keys = {"camber": [(-0.1, 0.08), (0.1, -0.08)], "toe": [(-0.1, 0.01), (0.1, -0.01)]}
    armed = estimate_parameters(with_axles(load_vehicle("bolt@handling"), keys, {}))
    # The aligning moments of the front tyres change a little, and with them the force of the rear axle.
    assert armed.rear_stiffness == pytest.approx(plain.rear_stiffness, rel=5e-3)
    # Slip over a_y of the front axle: toe -0.1 rad/m as in the test below, and camber that the roll does not add.
    load = plain.mass * plain.rear_length / (plain.front_length + plain.rear_length)
    added = load * (1.0 / armed.front_stiffness - 1.0 / plain.front_stiffness)
    toe = estimate_parameters(with_axles(load_vehicle("bolt@handling"), {"toe": keys["toe"]}, {}))
    by_toe = load * (1.0 / toe.front_stiffness - 1.0 / plain.front_stiffness)
    # Roll of the front axle over a_y, difference of its travels over the track, in a drive at 12 m/s and 0.02 rad.
    assert by_toe == pytest.approx(0.1 * TRACK / 2.0 * 0.007246, rel=0.03)
    # Camber gain 0.8 rad/m makes up for a part of the camber by roll: the axle needs less slip.
    assert added < 0.9 * by_toe


def with_axles(vehicle: Vehicle, front: Axle, rear: Axle) -> Vehicle:
    """Return a vehicle with keys added to its axles."""
    springs = vehicle.spec.suspension
    assert springs is not None
    axles = {
        name: AxleSuspension(**(getattr(springs, name).model_dump() | keys))
        for name, keys in (("front", front), ("rear", rear))
    }
    spec = vehicle.spec.model_copy(update={"suspension": springs.model_copy(update=axles)})
    return replace(vehicle, spec=spec)


def test_the_overturning_moment_of_the_tyres_adds_to_the_load_transfer(tmp_path: Path) -> None:
    turn = {"kind": "constant", "speed": 12.0, "steering": 0.07}
    text = (data_root() / "models" / "tyres" / "215_50R17.tir").read_text(encoding="utf-8")
    rows = []
    for name, factor in (("plain", "0.0"), ("moment", "0.1")):
        tyre = text.replace("QSX3 = 0.088", f"QSX3 = {factor}")
        assert factor in tyre
        rows.append(drive(tmp_path / name, {}, {}, turn, speed=12.0, duration=4.0, tyre=tyre).iloc[-1])
    # About the road, (N_right - N_left) T / 2 = m h a_y + Mx.
    moments = overturning_moments(rows[1], 0.1)
    arms = []
    for row in rows:
        lateral = sum(row[f"ego.tyre_fy.{wheel}"] for wheel in WHEELS)
        transferred = sum(transfer(row, axle) for axle in HANDLING) * TRACK
        arms.append((transferred - (sum(moments) if row is rows[1] else 0.0)) / lateral)
    assert sum(moments) > 100.0
    assert arms[1] == pytest.approx(arms[0], abs=0.004)  # the body rolls a little more, which moves its weight


def test_roll_steer_adds_its_part_to_the_understeer_gradient(tmp_path: Path) -> None:
    turn = {"kind": "constant", "speed": 14.0, "steering": 0.012}  # 0.8 m/s², where tyres are linear
    gradients, rolls = [], []
    for name, front, rear in (("plain", 0.0, 0.0), ("front", -0.1, 0.0), ("rear", 0.0, 0.08)):
        toe_front, toe_rear = ({"toe": [(-0.1, -0.1 * slope), (0.1, 0.1 * slope)]} for slope in (front, rear))
        row = drive(tmp_path / name, toe_front, toe_rear, turn, speed=14.0, duration=4.0).iloc[-1]
        angle = np.mean([row[f"ego.steering_angle.{side}"] for side in ("left", "right")])
        acceleration = row["ego.vx"] * row["ego.wz"]
        gradients.append((angle - WHEELBASE * row["ego.wz"] / row["ego.vx"]) / acceleration)
        travel = {axle: row[f"ego.travel.{axle}_right"] - row[f"ego.travel.{axle}_left"] for axle in HANDLING}
        rolls.append({axle: travel[axle] / TRACK / acceleration for axle in HANDLING})
    # K = (toe gradient) t/2 (roll of the axle by its springs) / a_y: less toe-in in bump understeers in front, more at
    # the rear (T. Gillespie, Fundamentals of Vehicle Dynamics, chapter 6, roll steer).
    assert gradients[1] - gradients[0] == pytest.approx(0.1 * TRACK / 2.0 * rolls[1]["front"], rel=0.02)
    assert gradients[2] - gradients[0] == pytest.approx(0.08 * TRACK / 2.0 * rolls[2]["rear"], rel=0.02)
    # Each axle rolls as the moment m h a_y on the stiffness of springs and tyres in series demands.
    springs = {axle: (row["stiffness"] / 2.0 + row["anti_roll"]) * TRACK**2 for axle, row in HANDLING.items()}
    stiffness = {axle: 1.0 / (1.0 / spring + 2.0 / (TYRE * TRACK**2)) for axle, spring in springs.items()}
    weight = 1616.0 * HEIGHT
    roll = weight / (sum(stiffness.values()) - 9.81 * weight)
    for axle in HANDLING:
        assert rolls[0][axle] == pytest.approx(roll * stiffness[axle] / springs[axle], rel=0.05)


def test_a_loaded_car_rests_where_springs_and_stops_carry_it_together() -> None:
    axle = FRONT | {"bump_stop": {"travel": 0.03, "stiffness": 60e3}, "damping": 4000.0}
    car = pushed_car(on_springs(front=axle, rear=axle), force=(0.0, 0.0, -12000.0), step=0.005)
    car.advance(2.0)
    # c z + c_s (z - z0) = F / 2 of the axle: 6720 N in front, 5280 N at the rear.
    expected = [(load / 2.0 + 60e3 * 0.03) / (28e3 + 60e3) for load in (6720.0, 6720.0, 5280.0, 5280.0)]
    assert car.travel == pytest.approx(expected, rel=0.02)

"""Friction that depends on the position: a car with locked wheels slides as a plane body with four contact points."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mirdrake.assembly.diagram import Assembly, assemble
from mirdrake.core.constants import GRAVITY
from mirdrake.plant.plant import set_start
from mirdrake.runs.simulation import Simulation
from mirdrake.worlds import make_world

CONTACTS = ("point", "hydroelastic")


@dataclass
class Body:
    """Parameters of a car in the closed form: mass [kg], place and height [m] of its centre, yaw inertia [kg m²]."""

    mass: float
    ahead: float
    height: float
    inertia: float
    wheelbase: float
    track: float

    def wheels(self):
        """Contact points from the centre of mass, ahead and to the left [m]."""
        front, rear, half = self.wheelbase - self.ahead, -self.ahead, self.track / 2.0
        return np.array([[front, half], [front, -half], [rear, half], [rear, -half]])


def body_of(assembly: Assembly) -> Body:
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    context = plant.CreateDefaultContext()
    start = assembly.starts["ego"]
    set_start(plant, context, part, x=start.x, y=start.y, yaw=start.yaw)
    middle = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])
    inertia = plant.CalcSpatialInertia(context, plant.world_frame(), plant.GetBodyIndices(part.instance))
    about_middle = inertia.Shift(middle).CalcRotationalInertia().CopyToFullMatrix3()
    geometry = part.vehicle.geometry
    return Body(
        plant.CalcTotalMass(context, [part.instance]),
        middle[0] - start.x,
        middle[2],
        about_middle[2, 2],
        geometry.wheelbase,
        geometry.rear_track,
    )


def slide(body: Body, mu, *, speed: float, duration: float, x: float = 0.0, y: float = 0.0):
    """The plane motion of a car with locked wheels: x, y of the rear axle's middle [m], yaw [rad], speed, yaw rate.

    Coulomb friction at four points, their loads quasi-static: weight, and transfer by the forces of the moment before.
    """
    points = body.wheels()
    weight = body.mass * GRAVITY / 2.0
    share = body.ahead / body.wheelbase
    loads = weight * np.array([share, share, 1.0 - share, 1.0 - share])
    forces_of_loads = np.linalg.pinv(np.vstack((np.ones(4), points.T)))  # smallest change of the loads

    def rates(_, state):
        px, py, yaw, vx, vy, rate = state
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        arms = points @ turn.T
        velocity = np.array([vx, vy]) + rate * np.column_stack((-arms[:, 1], arms[:, 0]))
        pace = np.linalg.norm(velocity, axis=1, keepdims=True)
        grip = mu(px + arms[:, 0], py + arms[:, 1])
        normal = loads
        for _ in range(8):  # loads and forces depend on each other
            forces = -(grip * normal)[:, None] * velocity / np.maximum(pace, 1e-3)
            total = turn.T @ forces.sum(axis=0)
            # Moments about the centre of mass: forces at the ground, at the height of the centre.
            normal = loads + forces_of_loads @ np.array([0.0, -body.height * total[0], -body.height * total[1]])
        moment = float((arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0]).sum())
        return [vx, vy, rate, *(forces.sum(axis=0) / body.mass), moment / body.inertia]

    def stopped(_, state):
        return np.hypot(state[3], state[4]) - 1e-2

    stopped.terminal = True  # type: ignore[attr-defined]
    start = [x + body.ahead, y, 0.0, speed, 0.0, 0.0]
    solution = solve_ivp(rates, (0.0, duration), start, events=stopped, max_step=0.01, rtol=1e-6)
    px, py, yaw, vx, vy, rate = solution.y[:, -1]
    return px - body.ahead * np.cos(yaw), py - body.ahead * np.sin(yaw), yaw, np.hypot(vx, vy), rate


def skid(tmp_path, ground: str, *, contact: str, speed: float, duration: float, time_step: float = 0.005):
    path = tmp_path / "pad.yaml"
    path.write_text(f"mirdrake: world/1\nground: {ground}\n", encoding="utf-8")
    assembly = assemble(
        {
            "world": str(path),
            "vehicles": {"ego": {"model": "bolt", "start": {"x": 0, "y": 0}, "speed": speed, "parked": True}},
            "control": {"ego": "constant"},
            "plant": {"contact": contact, "time_step": time_step},
        }
    )
    return Simulation(assembly).run(duration=duration).signals.iloc[-1], assembly


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("time_step", [pytest.param(0.001, marks=pytest.mark.slow), 0.005])
def test_on_ice_a_car_slides_v_squared_over_two_mu_g(tmp_path, contact, time_step):
    ice = "{surface: asphalt, patches: [{rect: {center: [20, 0], size: [80, 20]}, surface: ice, mu: 0.1}]}"
    end, _ = skid(tmp_path, ice, contact=contact, speed=8.0, duration=9.0, time_step=time_step)
    assert end["ego.vx"] == pytest.approx(0.0, abs=1e-3)
    assert end["ego.x"] == pytest.approx(8.0**2 / (2.0 * 0.1 * GRAVITY), rel=0.02)


@pytest.mark.parametrize("contact", CONTACTS)
def test_behind_the_ice_the_asphalt_brakes_axle_by_axle(tmp_path, contact):
    ground = "{surface: asphalt, mu: 0.6, patches: [{rect: {center: [2, 0], size: [16, 20]}, surface: ice}]}"
    end, assembly = skid(tmp_path, ground, contact=contact, speed=7.0, duration=4.0)
    x, *_ = slide(body_of(assembly), assembly.parts.world.mu, speed=7.0, duration=4.0)
    assert 10.0 < x < 15.0  # past the ice, which alone would need 25 m
    assert end["ego.x"] == pytest.approx(x, rel=0.02)


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("side", [1, -1])
def test_with_ice_on_one_side_a_braking_car_turns_to_the_other(tmp_path, contact, side):
    ground = (
        f"{{surface: gravel, mu: 0.2, patches: [{{rect: {{center: [0, {10 * side}], size: [200, 20]}}, "
        "surface: ice, mu: 0.05}]}"
    )
    end, assembly = skid(tmp_path, ground, contact=contact, speed=10.0, duration=0.8)
    body = body_of(assembly)
    moment = 0.5 * body.track * (0.2 - 0.05) * body.mass * GRAVITY / 2.0
    _, _, yaw, speed, rate = slide(body, assembly.parts.world.mu, speed=10.0, duration=0.8)
    assert rate == pytest.approx(-side * moment / body.inertia * 0.8, rel=0.1)  # less by the damping of the slide
    assert end["ego.wz"] == pytest.approx(rate, rel=0.03)
    assert end["ego.yaw"] == pytest.approx(yaw, rel=0.05)
    assert np.hypot(end["ego.vx"], end["ego.vy"]) == pytest.approx(speed, rel=0.01)


def test_the_same_run_again_finds_the_same_ground(tmp_path):
    ground = "{surface: asphalt, patches: [{disc: {center: [6, 0], radius: 3}, surface: ice}]}"
    path = tmp_path / "pad.yaml"
    path.write_text(f"mirdrake: world/1\nground: {ground}\n", encoding="utf-8")
    simulation = Simulation(
        assemble(
            {
                "world": str(path),
                "vehicles": {"ego": {"model": "bolt", "start": {"x": 0, "y": 0}, "speed": 6.0, "parked": True}},
                "control": {"ego": "constant"},
                "plant": {"contact": "point"},
            }
        )
    )
    first, second = (simulation.run(duration=1.5).signals for _ in range(2))
    assert first.equals(second)
    assert first["ego.x"].iloc[-1] > 3.5  # asphalt alone would stop it after 2.2 m


def test_later_patches_lie_on_top():
    world = make_world(
        {
            "mirdrake": "world/1",
            "ground": {
                "surface": "grass",
                "patches": [
                    {"rect": {"size": [10, 10]}, "surface": "asphalt"},
                    {"disc": {"radius": 2}, "surface": "ice", "mu": 0.15},
                    {"rect": {"center": [1, 0], "size": [1, 1]}, "mu": 0.4},
                ],
            },
        }
    )
    assert world.mu([20.0, 4.0, 0.0, 1.0], 0.0).tolist() == [0.5, 0.85, 0.15, 0.4]
    assert world.road_mu == 0.85

"""Vehicles on uneven ground against closed forms: sines, banking, bumps, kerbs, grades."""

import re
import shutil
from math import cos, pi, radians, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from scipy.optimize import brentq

from mirdrake.assembly.diagram import Assembly
from mirdrake.core.compiled import compiled
from mirdrake.core.constants import GRAVITY
from mirdrake.core.paths import data_root
from mirdrake.ground import Terrain
from mirdrake.ground.layers import GROUND_PARTS
from mirdrake.ground.terrain import SAMPLES, Block
from mirdrake.plant.wheels.ground_contact import CONTACT_PARTS, EffectivePlane, effective_plane
from mirdrake.runs.simulation import Simulation
from mirdrake.tyres.vertical import VerticalTyre
from tests.ground_rigs import TYRE_FX, TYRE_FY, WHEEL_LOADS, TyreEnergy, drive, on_ground
from tests.handling_rigs import free_handling
from tests.marks import mostly_slow
from tests.tyre_rigs import BRUSH, FREE

BANK = radians(20.0)


# --- grades and banking -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grade", "heading"),
    mostly_slow([(-0.15, 0.0), (tan(BANK), pi / 2.0), (0.05, 0.0), (0.15, 0.0)], fast=2),
    ids=str,
)
@pytest.mark.parametrize(
    "rows",
    [
        [(0.0, 12.0, 0.0), (0.5, 12.0, 0.0), (0.51, 0.0, 0.0)],
        [(0.0, 12.0, 0.0), (0.5, 12.0, 0.0), (1.0, 12.0, 0.05)],
    ],
    ids=["brake", "steer"],
)
def test_brake_and_steer_on_an_incline_as_on_a_plane_under_inclined_gravity(
    tmp_path: Path, grade: float, heading: float, rows: list[tuple[float, float, float]]
) -> None:
    """5 and 15 %, 20 degrees of banking: loads, Fx, Fy and spins within 1 % of their largest value."""
    incline = {"grade": grade, "heading": heading}
    relief, gravity = (
        drive(tmp_path, rows=rows, speed=12.0, duration=2.0, **layers)
        for layers in ({"relief": [{"plane": incline}]}, {"ground": {"slope": incline}})
    )
    for names in (WHEEL_LOADS, TYRE_FX, TYRE_FY, ["ego.wheel_speed.front_left"], ["ego.wheel_speed.rear_right"]):
        largest = max(gravity[names].abs().to_numpy().max(), 100.0)
        assert (relief[names] - gravity[names]).abs().to_numpy().max() < 0.01 * largest


@pytest.mark.parametrize("heading", [0.0, pi / 2.0], ids=["along", "across"])
@pytest.mark.parametrize(
    "model", mostly_slow(["bolt@handling", "unior", "bolt", "mkz@handling", "unior@handling"], fast=2)
)
def test_a_parked_vehicle_does_not_creep_on_a_grade_of_15_percent(tmp_path: Path, model: str, heading: float) -> None:
    """The mean position of a second changes by less than 0.1 mm in 10 s, while the tyres still oscillate a little."""
    grade = [{"plane": {"grade": 0.15, "heading": heading}}]
    signals = drive(tmp_path, relief=grade, model=model, parked=True, duration=14.0)
    places = signals[["ego.x", "ego.y", "ego.z"]]
    early, late = (places[(places.index > t) & (places.index <= t + 1.0)].mean() for t in (3.0, 13.0))
    assert np.linalg.norm(late - early) < 1e-4


def test_on_a_banked_circle_a_car_needs_no_lateral_force_at_the_hands_off_speed(tmp_path: Path) -> None:
    """20 degrees, 100 m: no lateral force at √(g R tan θ), with the steering L cos θ / R of a geodesic, within 1 %."""
    radius, bank = 100.0, "-20 deg"
    hands_off = sqrt(GRAVITY * radius * tan(BANK))
    track = {"segments": [{"arc": {"radius": radius, "angle": "360 deg"}}], "closed": True, "width": 8.0}
    road = {"along": "main", "banking": [[0, bank], [pi * radius, bank]]}
    driver = {"kind": "mirdrake.manoeuvres.drivers:PathDriver", "line": {"kind": "circle", "radius": radius}}
    speeds, forces, angles = [], [], []
    for speed in (0.99 * hands_off, 1.01 * hands_off):
        signals = drive(
            tmp_path,
            relief=[{"road": road}],
            world={"tracks": {"main": track}},
            control={**driver, "speeds": [[0, speed], [60, speed]]},
            speed=speed,
            duration=8.0,
        )
        last = signals[signals.index > 5.0]
        speeds.append(np.hypot(last["ego.vx"], last["ego.vy"]).mean())
        forces.append(last[TYRE_FY].sum(axis=1).mean())
        angles.append(last[["ego.steering_angle.left", "ego.steering_angle.right"]].to_numpy().mean())
    assert forces[0] < 0.0 < forces[1]
    assert np.interp(0.0, forces, speeds) == pytest.approx(hands_off, rel=0.01)
    assert np.interp(0.0, forces, angles) == pytest.approx(2.601 * cos(BANK) / radius, rel=0.01)


# --- a car over sines: amplitude and phase ------------------------------------------------------------------------

SPEED, PERIOD = 40.0, 10.0  # m/s; time in which all sines of the road repeat [s]
FREQUENCIES = np.unique(np.round(np.geomspace(0.5, 20.0, 20) * PERIOD)) / PERIOD
WAVENUMBERS = 2.0 * pi * FREQUENCIES / SPEED
AMPLITUDES = 4e-4 * np.sqrt(20.0 / FREQUENCIES)
PHASES = np.random.default_rng(4).uniform(0.0, 2.0 * pi, len(FREQUENCIES))


def linear_car(assembly: Assembly, loads: np.ndarray, speed: float) -> np.ndarray:
    """Return the complex responses of a freely rolling car on springs to a road of unit amplitude at the rear axle.

    A half car: heave, pitch, travel of both axles, and the surge that inclined normal forces cause. A patch of the
    length 2 a envelops a sine of the wavenumber k by the factor 3 (sin(k a) - k a cos(k a)) / (k a)³, the mean with the
    weight a² - x².

    Args:
        assembly: the diagram.
        loads: of a front and a rear wheel [N].
        speed: [m/s].

    Returns:
        Heights of body and wheel, and load, in front and at the rear (2, 3, number of frequencies) [m, m, N].
    """
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    springs, geometry = part.vehicle.spec.suspension, part.vehicle.geometry
    tyre, length, radius = part.compression[0], geometry.wheelbase, geometry.front_wheel_radius
    assert isinstance(tyre, VerticalTyre)
    assert springs is not None
    context = plant.CreateDefaultContext()
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, part.base, RigidTransform())
    base = part.base.floating_velocities_start_in_v()
    S = np.zeros((plant.num_velocities(), 5))
    S[base + 5, 0] = S[base + 1, 1] = S[base + 3, 4] = 1.0
    for index, (joint, wheel) in enumerate(zip(part.suspension, part.wheels, strict=True)):
        S[joint.velocity_start(), 2 + index // 2] = 1.0
        S[wheel.velocity_start(), 4] = 1.0 / part.rolling_radii(plant)[index // 2]
    M = S.T @ plant.CalcMassMatrix(context) @ S
    # Rows: compression of the front and rear tyres by the motion; columns: z, pitch, travels, x.
    B = np.array([[1.0, -length, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0, 0.0]])
    D = np.array([[0.0, radius, 0.0, 0.0, 1.0]] * 2)  # horizontal forces at the wheel centres
    damping = tyre.damping * loads
    K, C = 2.0 * tyre.stiffness * B.T @ B, 2.0 * (B.T * damping) @ B
    for row, axle in ((2, springs.front), (3, springs.rear)):
        K[row, row] += 2.0 * axle.stiffness
        C[row, row] += 2.0 * axle.damping
    # Weight and loads incline with the body.
    height = plant.CalcCenterOfMassPositionInWorld(context, [part.instance])[2]
    K[1, 1] += 2.0 * loads.sum() * (radius - height)
    depth = loads / tyre.stiffness
    half = np.sqrt(2.0 * radius * depth - depth**2)
    responses = []
    for k in WAVENUMBERS:
        omega, a = k * speed, k * half
        # Height at the wheels; inclination of the normal, and rate, follow from its derivative.
        raised = np.array([np.exp(1j * k * length), 1.0]) * 3.0 * (np.sin(a) - a * np.cos(a)) / a**3
        F = 2.0 * B.T @ (raised * (tyre.stiffness + 1j * omega * damping)) - 2.0 * D.T @ (loads * 1j * k * raised)
        X = np.linalg.solve(-(omega**2) * M + 1j * omega * C + K, F)
        wheels = B @ X
        body = wheels - X[2:4]
        force = (raised - wheels) * (tyre.stiffness + 1j * omega * damping)
        responses.append(np.stack([body, wheels, force], axis=1))
    return np.moveaxis(np.array(responses), 0, 2)


@pytest.mark.parametrize(("step", "amplitude", "phase"), [(0.0025, 0.02, 3.0), (0.005, 0.05, 3.0)])
def test_a_car_over_sines_has_the_responses_of_the_linear_car(
    tmp_path: Path, step: float, amplitude: float, phase: float
) -> None:
    """20 sines from 0.5 to 20 Hz in one drive: body, wheels and loads of both axles in amplitude and phase [deg]."""
    cell, settle = 0.1, 4.0
    x = np.arange(0.0, SPEED * (PERIOD + settle + 2.0), cell)
    road = np.sum(AMPLITUDES[:, None] * np.sin(np.multiply.outer(WAVENUMBERS, x) + PHASES[:, None]), axis=0)
    np.save(tmp_path / "sines.npy", np.tile(road, (60, 1)))
    assembly = on_ground(
        tmp_path,
        relief=[{"grid": {"file": "sines.npy", "cell": cell, "at": [0.0, -3.0]}}],
        model=free_handling(tmp_path, "bolt"),
        start=10.0,
        speed=SPEED,
        step=step,
        plant={"air_density": 0.0},
    )
    signals = Simulation(assembly).run(duration=settle + PERIOD + 0.1).signals
    shown = (signals.index >= settle) & (signals.index < settle + PERIOD - 0.5 * step)
    time, place = signals.index.to_numpy()[shown], signals["ego.x"].to_numpy()[shown]
    speed = (place[-1] - place[0]) / (time[-1] - time[0])
    waves = np.multiply.outer(place, WAVENUMBERS)
    regressors = np.hstack([np.ones((len(time), 1)), time[:, None], np.cos(waves), np.sin(waves)])

    def response(values: np.ndarray) -> np.ndarray:
        """Return the complex amplitudes of a signal over those of the road at the rear axle."""
        found = np.linalg.lstsq(regressors, values, rcond=None)[0][2:].reshape(2, -1)
        return np.asarray((found[0] - 1j * found[1]) / (AMPLITUDES * np.exp(1j * (PHASES - 0.5 * pi))))

    rear, pitch = signals["ego.z"].to_numpy(), signals["ego.pitch"].to_numpy()
    loads = signals[shown][[WHEEL_LOADS[0], WHEEL_LOADS[2]]].mean().to_numpy()
    expected = linear_car(assembly, loads, speed)
    errors = []
    length = assembly.parts.vehicles["ego"].vehicle.geometry.wheelbase
    for axle, (body, name) in enumerate(((rear - length * np.sin(pitch), "front_left"), (rear, "rear_left"))):
        wheel = body + signals[f"ego.travel.{name}"].to_numpy()
        # The logged loads are those of the middle of the step before.
        lag = np.exp(0.5j * WAVENUMBERS * speed * step)
        load = response(signals[f"ego.wheel_load.{name}"].to_numpy()[shown]) * lag
        measured = [response(body[shown]), response(wheel[shown]), load]
        errors.append(np.array(measured) / expected[axle])
    ratios = np.array(errors)
    assert np.abs(np.abs(ratios) - 1.0).max() < amplitude
    assert np.degrees(np.abs(np.angle(ratios))).max() < phase


# --- braking and steering on a plate and on a bump -----------------------------------------------------------------


@pytest.mark.parametrize(
    "rows",
    [
        [(0.0, 12.0, 0.0), (2.5, 12.0, 0.0), (2.51, 0.0, 0.0)],
        [(0.0, 12.0, 0.0), (2.5, 12.0, 0.0), (2.9, 12.0, 0.05)],
    ],
    ids=["brake", "steer"],
)
def test_brake_and_steer_on_a_plate_as_on_the_plane(tmp_path: Path, rows: list[tuple[float, float, float]]) -> None:
    """A plate of 20 mm: loads and lateral forces within 0.2 % of their largest value, longitudinal ones within 1 %.

    The speed that the edge takes from the car is regained before the manoeuvre begins.
    """
    plate = {"box": [60.0, 40.0, 0.02], "at": [34.0, 0.0], "driven_over": True}
    plane, raised = (
        drive(tmp_path, rows=rows, speed=12.0, duration=4.0, world={"props": props}, relief=[{"plane": {}}])
        for props in ([], [plate])
    )
    late = plane.index > 2.5
    assert (raised["ego.z"] - plane["ego.z"])[late].mean() == pytest.approx(0.02, abs=1e-5)
    # In the turn the longitudinal forces are below 100 N, and the speeds differ by a few mm/s.
    for names, limit in ((WHEEL_LOADS, 0.002), (TYRE_FX, 0.01), (TYRE_FY, 0.002)):
        largest = max(plane[names].abs().to_numpy().max(), 100.0)
        assert (raised[names] - plane[names])[late].abs().to_numpy().max() < limit * largest


BRAKE = 300.0  # torque of each brake [N m]: 0.23 g
BUMP = {"bump": {"at": [6.0, 0.0], "length": 0.6, "height": "50 mm", "width": 12.0}}


@pytest.mark.parametrize(
    ("brake", "steering"),
    [
        pytest.param(BRAKE, 0.0, id="brake", marks=pytest.mark.slow),
        pytest.param(0.0, 0.06, id="steer", marks=pytest.mark.slow),
        pytest.param(BRAKE, 0.06, id="both"),
    ],
)
def test_energy_and_momentum_of_braking_and_steering_over_a_bump(tmp_path: Path, brake: float, steering: float) -> None:
    """A bump of 50 mm at 8 m/s, in a turn of 0.3 g or with brakes that do not lock a wheel.

    The energy decreases by the work of dampers, tyres and brakes, and the momentum changes by the forces of the ground
    along the tyre axes. Behind the bump the car moves as on the plane.
    """
    model, runs = free_handling(tmp_path, "bolt"), []
    layers: list[dict[str, Any]] = [BUMP, {"plane": {}}]
    for layer in layers:
        assembly = on_ground(
            tmp_path,
            relief=[layer],
            model=model,
            speed=8.0,
            step=0.0025,
            rows=[(0.0, 8.0, 0.0), (0.2, 8.0, steering)],
            plant={"air_density": 0.0},
            systems={"torque": {"kind": "constant", "value": [0.0] * 4 + [brake] * 4}},
            connect=[["torque.y", "ego.wheel_torque"]],
        )
        watch = TyreEnergy(assembly, brake)
        runs.append((Simulation(assembly).run(duration=2.2, monitor=watch).signals, watch))
    (bump, watch), (plane, _) = runs
    # The weight that the bump shifts is a part of its tyres' forces.
    spread = bump[WHEEL_LOADS].to_numpy().max() / plane[WHEEL_LOADS].to_numpy().max()
    assert spread > 1.4
    begin = 200 if steering else 0  # the servo moves the wheels in the first half second
    lost, dissipated = watch.energy[-1] - watch.energy[begin], watch.work[-1] - watch.work[begin]
    assert lost < -100.0
    assert dissipated == pytest.approx(lost, rel=0.001)
    change, impulse = watch.momentum[-1] - watch.momentum[0], watch.impulse[-1] - watch.impulse[0]
    assert impulse == pytest.approx(change, abs=1e-4 * float(np.linalg.norm(watch.momentum[0])))
    # Behind the bump.
    wheels = ["ego.wheel_speed.front_left", "ego.wheel_speed.rear_right"]
    assert (bump[wheels].to_numpy() > 1.0).all()
    if brake:
        forces = [float(run[TYRE_FX].to_numpy()[-80:].mean()) for run in (bump, plane)]
        assert forces[0] == pytest.approx(forces[1], rel=0.01)
    else:
        curvature = [
            run["ego.wz"].to_numpy()[-80:].mean()
            / np.linalg.norm(run[["ego.vx", "ego.vy"]].to_numpy()[-80:], axis=1).mean()
            for run in (bump, plane)
        ]
        assert curvature[0] == pytest.approx(curvature[1], rel=0.01)


# --- bumps and kerbs ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "speed", [pytest.param(3.0, marks=pytest.mark.slow), 5.0, pytest.param(8.0, marks=pytest.mark.slow)]
)
def test_energy_and_peaks_over_a_bump_of_75_millimetres(tmp_path: Path, speed: float) -> None:
    """Peaks change by less than 3 % from 2.5 to 1.25 ms; the energy decreases by the work of dampers and tyres."""
    bump = [{"bump": {"at": [3.2, 0.0], "length": 0.6, "height": "75 mm", "width": 6.0}}]
    model, peaks = free_handling(tmp_path, "bolt"), []
    for step in (0.0025, 0.00125):
        assembly = on_ground(tmp_path, relief=bump, model=model, speed=speed, step=step, plant={"air_density": 0.0})
        watch = TyreEnergy(assembly)
        signals = Simulation(assembly).run(duration=0.4 + 3.9 / speed, monitor=watch).signals
        peaks.append((signals[WHEEL_LOADS].to_numpy().max(), np.diff(signals["ego.vz"]).max() / step))
        assert watch.energy[-1] - watch.energy[0] == pytest.approx(watch.work[-1], rel=0.004)
    assert peaks[0] == pytest.approx(peaks[1], rel=0.03)


def climbing_torque(folder: Path, *, stiffness: float, height: float, step: float) -> float:
    """Return the torque of each front wheel with which a Bolt climbs a kerb slowly, relative to that of rigid wheels.

    A rigid wheel turns about the edge at the distance a = √(2 r h - h²) ahead of its axle: T = F a, which for a driven
    wheel is the condition Fx / Fz = a / (r - h) of a pushed one. The torque on the body takes T / L from the load.
    """
    model = folder / f"bolt_{stiffness:.0f}"
    shutil.copytree(data_root() / "models" / "bolt", model)
    contact = (model / "contact.xacro").read_text(encoding="utf-8")
    for name, value in (("point_contact_stiffness", stiffness), ("hunt_crossley_dissipation", 0.5)):
        contact = re.sub(rf'({name} value=")[^"]*"', rf'\g<1>{value}"', contact)
    (model / "contact.xacro").write_text(contact, encoding="utf-8")
    rigid_tyres = BRUSH.replace("rolling_resistance: 0", "rolling_resistance: 0, rolling_ratio: 1.0")
    text = f"description: for tests\nvehicle: {{tyres: {rigid_tyres}}}\n{FREE}\n"
    (model / "variants" / "free.yaml").write_text(text, encoding="utf-8")
    length, radius, load = 2.601, 0.3234, 0.56 * 1616.0 * GRAVITY / 2.0
    arm = sqrt(2.0 * radius * height - height**2)
    rigid = load * arm / (1.0 + arm / length)
    edge = length + arm + 0.02
    kerb = {"at": [edge, 0.0], "length": 20.0, "height": height, "width": 10.0, "shape": "trapezoid", "slope": "80 deg"}
    assembly = on_ground(
        folder,
        relief=[{"bump": kerb}],
        ground={"mu": 1.7},  # rubber on a rough edge: the condition asks for 1.05
        model=f"{model}@free",
        step=step,
        plant={"air_density": 0.0},
        systems={"torque": {"kind": "constant", "value": [0.0] * 8}},
        connect=[["torque.y", "ego.wheel_torque"]],
    )
    simulator = Simulator(assembly.diagram, assembly.make_context())
    context = simulator.get_mutable_context()
    source = assembly.diagram.GetSubsystemByName("torque")
    torques = source.get_mutable_source_value(source.GetMyMutableContextFromRoot(context))
    plant, part = assembly.parts.plant, assembly.parts.vehicles["ego"]
    state, speed, highest = plant.GetMyContextFromRoot(context), 0.0, 0.0
    # From 60 % of the expected torque, with a damping that keeps the climb slow.
    for time in np.arange(0.02, 30.0, 0.02):
        torque = 0.6 * rigid * min(time / 3.0, 1.0) + 40.0 * max(time - 6.0, 0.0) - 1500.0 * speed
        for wheel in (0, 1):
            torques.SetAtIndex(wheel, torque)
        simulator.AdvanceTo(time)
        speed = float(plant.EvalBodySpatialVelocityInWorld(state, part.base).translational()[0])
        highest = max(highest, torque)
        if plant.EvalBodyPoseInWorld(state, part.wheels[0].child_body()).translation()[0] > edge + 0.02:
            return highest / rigid
    raise AssertionError("the car does not climb")


def static_climb(stiffness: float, height: float) -> float:
    """Return the same torque from the statics of the law of the tyre, with fine samples of the ground.

    A normal force F along (nx, nz) and a tangential one f hold the load W: F = W nz, f = W nx. At a place of the wheel
    its height follows from F, and the torque from f; the climb takes the largest one.
    """
    length, radius, load = 2.601, 0.3234, 0.56 * 1616.0 * GRAVITY / 2.0
    plane = compiled(effective_plane, parts=(*GROUND_PARTS, *CONTACT_PARTS))
    terrain = Terrain([Block(height, height / tan(radians(80.0)), 20.0, 0.1, 10.0, 0.1)])
    axes, samples = ((1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), 16 * (SAMPLES - 1) + 1

    def at(x: float, z: float) -> EffectivePlane:
        return EffectivePlane(*plane(terrain.data, samples, radius, 0.215, (x, 0.0, z), *axes))

    def excess(z: float, x: float) -> float:
        found = at(x, z)
        return stiffness * max(found.deflection, 0.0) * found.share - load * found.rise

    arms = []
    for x in np.linspace(-0.25, 0.02, 55):
        z = brentq(excess, radius - 0.05, radius + height + 0.01, args=(x,), xtol=1e-7)
        arms.append(-at(x, z).slope * radius)
    arm = sqrt(2.0 * radius * height - height**2)
    return max(arms) / (1.0 + max(arms) / length) / (arm / (1.0 + arm / length))


@pytest.mark.slow
def test_the_torque_that_climbs_a_kerb_of_10_centimetres_is_that_of_a_rigid_wheel(tmp_path: Path) -> None:
    """Within 5 % with tyres six times as stiff as those of the Bolt. Its own envelop the edge and need a sixth less."""
    assert climbing_torque(tmp_path, stiffness=1.2e6, height=0.1, step=0.00125) == pytest.approx(1.0, rel=0.05)
    assert static_climb(1e7, 0.1) == pytest.approx(1.0, rel=0.05)
    soft = climbing_torque(tmp_path, stiffness=2e5, height=0.1, step=0.0025)
    assert soft == pytest.approx(static_climb(2e5, 0.1), rel=0.05)
    assert soft == pytest.approx(0.83, abs=0.02)

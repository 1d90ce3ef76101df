"""Springs, dampers and anti-roll bars: static position as designed, and motion as in the textbook.

Formulas: quarter car and half car with wheels and tyres as further masses and springs; roll and pitch under a force at
the centre of mass at the height h over the road, with springs and tyres in series and the weight that moves along.
"""

import functools
import re

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError, ModelError
from mirdrake.core.paths import data_root
from mirdrake.plant.plant import PlantSpec, make_plant
from mirdrake.plant.rest_pose import find_rest_pose
from mirdrake.plant.suspension import make_axle_forces
from mirdrake.runs.simulation import Simulation
from mirdrake.vehicles import load_vehicle
from mirdrake.worlds import load_world
from tests.suspension_rigs import FRONT, GRAVITY, REAR, TYRE, on_springs, pushed_car

MASS, LENGTH, TRACK, HEIGHT, SHARE = 1616.0, 2.601, 1.501, 0.5, 0.56  # the Bolt's
RADIUS, HALF_WIDTH = 0.3234, 0.1075
UNSPRUNG = (20.0 + 10.0 + 10.0, 20.0 + 10.0)  # wheel, carrier, and in front the knuckle [kg]
SPRINGY = ("bolt", "mkz", "catvehicle")

bolt = functools.cache(on_springs)

ARGUMENTS = 'arguments: {suspension: "true"}\n'
WHEELS = "front_left", "front_right", "rear_left", "rear_right"
NAMED = "{" + ", ".join(f"{wheel}: {wheel}_suspension_joint" for wheel in WHEELS) + "}"
SECTION = "{front: {stiffness: 28000, damping: 2000}, rear: {stiffness: 27000, damping: 1800}}"


def bolt_variant(folder, change):
    """Return the Bolt in a folder of its own with one variant; its name."""
    folder.mkdir(exist_ok=True)
    (folder / "variants").mkdir(exist_ok=True)
    for path in (data_root() / "models" / "bolt").iterdir():
        if path.name != "variants" and not (folder / path.name).exists():
            (folder / path.name).symlink_to(path)
    (folder / "variants" / "x.yaml").write_text("description: x\n" + change, encoding="utf-8")
    return f"{folder}@x"


@pytest.fixture
def sprung(tmp_path):
    """Name of a Bolt on FRONT and REAR, for diagrams."""
    springs = f"{{front: {FRONT}, rear: {REAR}}}".replace("'", "")
    change = f"vehicle:\n  suspension: {springs}\n  joints: {{suspension: {NAMED}}}\n"
    return bolt_variant(tmp_path / "sprung", ARGUMENTS + change)


def com_height(car):
    """Height of the Bolt's centre of mass on its tyres [m]."""
    pose = find_rest_pose(car.parts.plant, car.part)
    assert pose is not None
    return HEIGHT + pose.z - pose.pitch * SHARE * LENGTH


# --- at rest -----------------------------------------------------------------------------------------------------


def test_the_springs_carry_the_axle_loads_less_what_hangs_below_them():
    front, rear = MASS * GRAVITY * SHARE / 2, MASS * GRAVITY * (1 - SHARE) / 2
    loads = (front - UNSPRUNG[0] * GRAVITY,) * 2 + (rear - UNSPRUNG[1] * GRAVITY,) * 2
    assert bolt().spring_loads == pytest.approx(loads, rel=1e-9)


def test_a_car_on_springs_rests_at_its_design_height():
    car = pushed_car(bolt())
    car.advance(2.0)
    _, height, pitch, roll = car.pose()
    assert np.ptp(height) < 1e-4
    assert np.ptp(pitch) < 1e-4
    assert np.abs(roll).max() < 1e-6
    assert np.abs(car.travel).max() < 1e-4
    loads = np.repeat([MASS * GRAVITY * SHARE / 2, MASS * GRAVITY * (1 - SHARE) / 2], 2)
    assert car.loads == pytest.approx(loads, rel=2e-3)


@pytest.mark.parametrize("suspension", ["true", "false"])
@pytest.mark.parametrize("model", SPRINGY)
def test_a_reference_vehicle_rests_with_and_without_springs(model, suspension):
    vehicle = on_springs(model) if suspension == "true" else load_vehicle(model, arguments={"suspension": "false"})
    assert vehicle.warnings == ()
    car = pushed_car(vehicle)
    assert len(car.part.suspension) == (4 if suspension == "true" else 0)
    car.advance(1.0)
    _, height, _, _ = car.pose()
    assert np.ptp(height) < 1e-4


@pytest.mark.parametrize("model", SPRINGY)
def test_springs_change_neither_mass_nor_axle_loads_nor_dimensions(model):
    rigid, sprung = load_vehicle(model), on_springs(model)
    assert sprung.geometry == rigid.geometry
    figures = []
    for vehicle in (rigid, sprung):
        plant = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle}).plant
        context = plant.CreateDefaultContext()
        instance = plant.GetModelInstanceByName("ego")
        com = plant.CalcCenterOfMassPositionInWorld(context, [instance])
        figures.append([plant.CalcTotalMass(context, [instance]), *com])
    assert figures[0] == pytest.approx(figures[1], abs=1e-9)


@pytest.mark.parametrize("heading", [0.0, 0.5, 1.5707963267948966, 3.0])
def test_a_parked_car_on_a_slope_starts_in_equilibrium(heading, sprung, tmp_path):
    (tmp_path / "hill.yaml").write_text(
        "mirdrake: world/1\nname: hill\nground: {slope: {grade: 0.0875}}\n", encoding="utf-8"
    )
    spec = {
        "world": str(tmp_path / "hill.yaml"),
        "vehicles": {"ego": {"model": sprung, "parked": True, "start": {"x": 0, "y": 0, "yaw": heading}}},
        "control": {"ego": {"kind": "constant", "speed": 0}},
        "plant": {"contact": "point", "air_density": 0},
    }
    signals = Simulation(assemble(spec)).run(duration=2.0).signals
    # Put there as on the flat it would settle by 0.01. The tyres deflect along the road by σ/C m g sin θ = 0.3 mm.
    for name in ("z", "roll", "pitch"):
        course = signals[f"ego.{name}"]
        assert abs(course.iloc[-1] - course.iloc[0]) < 1e-4
        assert np.ptp(course) < 6e-4


# --- ride --------------------------------------------------------------------------------------------------------


def half_car(front=FRONT, rear=REAR):
    """The state matrix of body height and pitch and two wheels per axle: springs, dampers, tyres on point contact."""
    vehicle = bolt()
    plant = make_plant(DiagramBuilder(), load_world("empty"), {"ego": vehicle}).plant
    context, body = plant.CreateDefaultContext(), plant.GetBodyByName("base_link")
    inertia = body.CalcSpatialInertiaInBodyFrame(context)
    m, com = inertia.get_mass(), inertia.get_com()
    about_y = inertia.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()[1, 1]
    loads = np.array([MASS * GRAVITY * SHARE, MASS * GRAVITY * (1 - SHARE)])
    k, c = 2 * np.array([front["stiffness"], rear["stiffness"]]), 2 * np.array([front["damping"], rear["damping"]])
    tyre, loss = 2 * TYRE * np.ones(2), 0.1 * loads  # Hunt and Crossley: force k d (1 + 0.1 v)
    arms = np.array([LENGTH - com[0], -com[0]])
    links = np.array([[1.0, arms[0], -1.0, 0.0], [1.0, arms[1], 0.0, -1.0]])  # body over wheel; nose up
    # As the body turns, its wheels go along below its centre of mass: their mass and spin, and the road's load on them.
    below = com[2] - RADIUS
    beside = 2 * sum(UNSPRUNG) + 4 * 10.0
    about_y += m * beside / (m + beside) * below**2
    M = np.diag([m, about_y, 2 * UNSPRUNG[0], 2 * UNSPRUNG[1]])
    K = links.T @ np.diag(k) @ links + np.diag([0.0, -MASS * GRAVITY * below, *tyre])
    C = links.T @ np.diag(c) @ links + np.diag([0.0, 0.0, *loss])
    inverse = np.linalg.inv(M)
    return np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ K, -inverse @ C]]), float(com[0])


def response(A, x0, times):
    """Return the free response (states x times) of x' = A x."""
    values, vectors = np.linalg.eig(A)
    return (vectors @ (np.exp(np.outer(values, times)) * np.linalg.solve(vectors, x0.astype(complex))[:, None])).real


def slow_pole(times, values):
    """Return the natural frequency [Hz] and damping ratio of the slower of the two oscillations in a free response."""
    step = 4
    y = values[::step]
    rows = np.array([y[i : i + 4] for i in range(len(y) - 4)])
    prediction = np.linalg.lstsq(rows, y[4:], rcond=None)[0]
    roots = np.roots([1.0, *(-prediction[::-1])]).astype(complex)
    poles = np.log(roots) / (times[step] - times[0])
    pole = min((pole for pole in poles if pole.imag > 0.1), key=abs)
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)


@pytest.mark.parametrize("step", [0.0025, 0.005])
def test_the_car_bounces_like_a_quarter_car(step):
    # springs in proportion to the body's weight on them: bouncing does not pitch, and the car is one quarter car
    _, com = half_car()
    front = {"stiffness": 28000.0, "damping": 1500.0}
    rear = {key: value * (LENGTH - com) / com for key, value in front.items()}
    car = pushed_car(on_springs(front=front, rear=rear), step=step)
    car.lift(0.01)
    car.advance(1.5)
    times, height, pitch, _ = car.pose()
    k, c = (2 * (front[key] + rear[key]) for key in ("stiffness", "damping"))
    wheels, tyre, loss = 2 * sum(UNSPRUNG), 4 * TYRE, 0.1 * MASS * GRAVITY
    body = MASS - wheels
    quarter = np.array(
        [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [-k / body, k / body, -c / body, c / body],
            [k / wheels, -(k + tyre) / wheels, c / wheels, -(c + loss) / wheels],
        ]
    )
    pole = min((value for value in np.linalg.eigvals(quarter) if value.imag > 0), key=abs)
    frequency, ratio = slow_pole(times, height + (pitch[0] - pitch) * com - height[-1])
    assert frequency == pytest.approx(abs(pole) / (2 * np.pi), rel=0.02)
    assert ratio == pytest.approx(-pole.real / abs(pole), rel=0.02)
    assert 1.1 < frequency < 1.4


@pytest.mark.parametrize("step", [0.0025, 0.005])
@pytest.mark.parametrize(("heave", "pitch"), [(0.01, 0.0), (0.0, 0.005)])
def test_the_car_bounces_and_pitches_like_a_half_car(heave, pitch, step):
    A, com = half_car()
    car = pushed_car(bolt(), step=step, parked=False)  # held wheels would roll along with the pitching
    car.advance(0.5)
    _, rest, nose, _ = car.pose()
    car.lift(heave, pitch)
    car.advance(1.5)
    times, height, turned, _ = car.pose()
    after = times > 0.505
    # the body's own centre of mass, and its angle nose up; the vehicle frame's origin is at the rear axle
    theta = -(turned[after] - nose[-1])
    z = height[after] - rest[-1] + com * theta
    x0 = np.array([heave - com * pitch, -pitch, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    expected = response(A, x0, times[after] - 0.5)
    assert z == pytest.approx(expected[0], abs=0.04 * np.abs(expected[0]).max())
    assert theta == pytest.approx(expected[1], abs=0.04 * np.abs(expected[1]).max())


# --- load transfer -----------------------------------------------------------------------------------------------


def roll_stiffnesses(front, rear):
    """Return the roll stiffness of both axles, with tyres in series [N m/rad]."""
    stiffnesses = []
    for axle in (front, rear):
        own = (axle["stiffness"] / 2 + axle.get("anti_roll", 0.0)) * TRACK**2
        stiffnesses.append(1 / (1 / own + 1 / (TYRE * TRACK**2 / 2)))
    return stiffnesses


@pytest.mark.parametrize(
    ("front", "rear"), [(FRONT, REAR), (FRONT, REAR | {"anti_roll": 40000.0}), (FRONT | {"anti_roll": 0.0}, REAR)]
)
def test_a_side_force_rolls_the_car_and_the_stiffer_axle_takes_more_of_it(front, rear):
    force = 1000.0
    car = pushed_car(on_springs(front=front, rear=rear), force=(0.0, force, 0.0))
    car.advance(3.0)
    height = com_height(car)
    axles = roll_stiffnesses(front, rear)
    crown = HALF_WIDTH**2 / RADIUS  # the ellipsoid of the wheel rolls sideways on this radius
    angle = force * height / (sum(axles) - MASS * GRAVITY * (height - crown))
    _, _, _, roll = car.pose()
    assert roll[-1] == pytest.approx(-angle, rel=0.02)  # to the left is down
    loads = car.loads
    assert (loads[0] - loads[1]) / 2 == pytest.approx(axles[0] * angle / TRACK, rel=0.02)
    assert (loads[2] - loads[3]) / 2 == pytest.approx(axles[1] * angle / TRACK, rel=0.02)


def test_the_bolt_rolls_five_degrees_at_one_g():
    spec = load_vehicle("bolt@handling").spec.suspension
    assert spec is not None
    axles = roll_stiffnesses(spec.front.model_dump(), spec.rear.model_dump())
    angle = MASS * GRAVITY * HEIGHT / (sum(axles) - MASS * GRAVITY * HEIGHT)
    assert np.rad2deg(angle) == pytest.approx(5.0, abs=0.1)


def test_braking_dives_the_nose_by_the_springs_and_tyres_of_both_axles():
    force = 500.0
    car = pushed_car(bolt(), force=(force, 0.0, 0.0))
    pose = find_rest_pose(car.parts.plant, car.part)
    assert pose is not None
    still = pose.pitch
    car.advance(3.0)
    height = com_height(car)
    softness = sum(1 / (2 * stiffness) for stiffness in (FRONT["stiffness"], REAR["stiffness"], TYRE, TYRE)) / LENGTH**2
    weight = MASS * GRAVITY * (height - RADIUS)  # held wheels roll along as the car turns, so their contacts do
    angle = force * height * softness / (1 - weight * softness)
    _, _, pitch, _ = car.pose()
    assert pitch[-1] - still == pytest.approx(angle, rel=0.02)
    assert car.loads[:2].sum() - MASS * GRAVITY * SHARE == pytest.approx(force * height / LENGTH, rel=0.05)


def test_travel_ends_at_the_stops():
    car = pushed_car(bolt(), force=(0.0, 0.0, -25000.0))
    car.advance(2.0)
    assert car.travel == pytest.approx([0.1] * 4, abs=5e-3)


def test_an_anti_roll_bar_acts_on_the_difference_of_travel_only():
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"other": load_vehicle("bolt"), "ego": bolt()})
    plant, part = parts.plant, parts.vehicles["ego"]
    gain = make_axle_forces(plant, part)
    assert gain is not None
    context = gain.CreateDefaultContext()
    root = plant.CreateDefaultContext()
    for joint, travel in zip(part.suspension, (0.03, 0.01, -0.02, 0.02), strict=True):
        joint.set_translation(root, travel)
    gain.get_input_port().FixValue(context, plant.GetPositionsAndVelocities(root, part.instance))
    force = gain.get_output_port().Eval(context)
    rows = [joint.velocity_start() for joint in part.suspension]
    assert force[rows] == pytest.approx([-400.0, 400.0, 360.0, -360.0])
    assert np.delete(force, rows) == pytest.approx(0.0)
    assert make_axle_forces(plant, parts.vehicles["other"]) is None


def test_half_of_the_damping_is_that_of_the_velocity_at_the_beginning_of_a_step():
    soft = {"stiffness": 28000.0, "damping": 2000.0}
    parts = make_plant(DiagramBuilder(), load_world("empty"), {"ego": on_springs(front=soft, rear=soft)})
    plant, part = parts.plant, parts.vehicles["ego"]
    gain, root = make_axle_forces(plant, part), plant.CreateDefaultContext()
    assert gain is not None
    rates = np.array([0.3, 0.1, -0.2, 0.2])
    for joint, rate in zip(part.suspension, rates, strict=True):
        joint.set_translation_rate(root, rate)
        assert joint.GetDampingVector(root) == pytest.approx([1000.0])
    context = gain.CreateDefaultContext()
    gain.get_input_port().FixValue(context, plant.GetPositionsAndVelocities(root, part.instance))
    force = gain.get_output_port().Eval(context)
    assert force[[joint.velocity_start() for joint in part.suspension]] == pytest.approx(-1000.0 * rates)
    assert np.count_nonzero(force) == 4


# --- on the road -------------------------------------------------------------------------------------------------


def lane_change(model, step):
    rows = [(0.0, 0.0), (0.5, 0.0), (0.8, 0.03), (1.4, -0.03), (2.0, 0.0)]
    spec = {
        "world": "empty",
        "vehicles": {"ego": {"model": model, "speed": 15}},
        "control": {
            "ego": {"kind": "schedule", "rows": [{"time": t, "speed": 15, "steering": angle} for t, angle in rows]}
        },
        "plant": {"contact": "point", "time_step": step},
    }
    return Simulation(assemble(spec)).run(duration=3.0).signals


def test_a_lane_change_rolls_outwards_and_does_not_depend_on_the_step(sprung):
    fine, coarse = lane_change(sprung, 0.0025), lane_change(sprung, 0.005)
    first = fine["ego.roll"].loc[0.5:1.4]
    assert first.max() > 0.01  # steered to the left, it rolls to the right
    assert fine["ego.roll"].abs().max() < np.deg2rad(5.0)
    for name in ("roll", "wz"):  # not vy, in which contact creeps by the step with and without springs
        size = fine[f"ego.{name}"].abs().max()
        assert coarse[f"ego.{name}"].abs().max() == pytest.approx(size, rel=0.02)


def test_the_travel_of_the_wheels_is_logged(sprung):
    signals = lane_change(sprung, 0.005)
    travel_difference = signals["ego.travel.front_right"] - signals["ego.travel.front_left"]
    time = signals["ego.roll"].idxmax()
    own, tyre = (FRONT["stiffness"] / 2 + FRONT["anti_roll"]) * TRACK**2, TYRE * TRACK**2 / 2
    assert travel_difference.loc[time] / TRACK == pytest.approx(
        signals["ego.roll"].loc[time] * tyre / (own + tyre), rel=0.1
    )


# --- bad values --------------------------------------------------------------------------------------------------


def rejection(tmp_path, change):
    """Return the error message of an invalid variant of the Bolt."""
    model = bolt_variant(tmp_path / "car", change)
    with pytest.raises((ConfigError, ModelError)) as caught:
        load_vehicle(model)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            ARGUMENTS,
            r"suspension.xacro:\d+: joint 'front_left_suspension_joint' is prismatic and carries the front_left",
        ),
        (
            ARGUMENTS + f"vehicle: {{joints: {{suspension: {NAMED}}}}}",
            r"x.yaml:3: joints.suspension: the joints have no springs; add the section suspension",
        ),
        (f"vehicle:\n  suspension: {SECTION}", r"x.yaml:3: suspension: the springs have no joints"),
        (
            f"vehicle:\n  joints: {{suspension: {NAMED}}}\n  suspension: {SECTION}",
            r"x.yaml:3: joints.suspension.front_left: no joint 'front_left_suspension_joint'",
        ),
        (
            ARGUMENTS + f"vehicle:\n  suspension: {SECTION.replace('28000', '0')}\n  joints: {{suspension: {NAMED}}}",
            r"x.yaml:4: suspension.front.stiffness: .*greater than 0",
        ),
        (
            ARGUMENTS + f"vehicle:\n  suspension: {SECTION.replace('2000', '-1')}\n  joints: {{suspension: {NAMED}}}",
            r"x.yaml:4: suspension.front.damping: ",
        ),
        (
            ARGUMENTS + f"vehicle:\n  suspension: {SECTION.replace('2000', '2000, dampings: 1')}",
            r"x.yaml:4: suspension.front.dampings: unknown field; did you mean 'damping'",
        ),
        (
            ARGUMENTS + f"vehicle:\n  suspension: {SECTION}\n  joints: {{suspension: {NAMED.replace('{', '{x: y, ')}}}",
            r"x.yaml:5: joints.suspension.x: unknown field",
        ),
        (
            ARGUMENTS
            + f"vehicle:\n  suspension: {SECTION}\n  joints: {{suspension: "
            + "{front_left: rear_left_suspension_joint, front_right: front_right_suspension_joint, "
            + "rear_left: front_left_suspension_joint, rear_right: rear_right_suspension_joint}}",
            r"joint 'front_left_suspension_joint' is prismatic and carries the front_left wheel, but has no role",
        ),
        ("arguments: {suspension: maybe}", r"argument suspension is 'maybe'; allowed: true, false"),
        (
            'arguments: {suspension: "true", values: published}',
            r"published.xacro:\d+: argument values is 'published', which has no suspension; leave suspension at false",
        ),
    ],
)
def test_faults_of_a_suspension_are_reported_with_file_and_line(tmp_path, change, expected):
    assert re.search(expected, rejection(tmp_path, change)), rejection(tmp_path, change)


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("suspension.xacro", 'xyz="0 0 1"', 'xyz="0 0 -1"', "moves along 0 0 -1 of 'base_link'; it should be 0 0 1"),
        ("suspension.xacro", '"rebound_travel" value="0.1"', '"rebound_travel" value="0"', "is limited to 0 … 0.1 m"),
        ("suspension.xacro", "${10 if suspension", "${340 if suspension", "carries -"),
    ],
)
def test_a_joint_that_cannot_carry_its_wheel_is_rejected(tmp_path, name, old, new, expected):
    text = (data_root() / "models" / "bolt" / name).read_text(encoding="utf-8")
    assert old in text
    change = ARGUMENTS + f"vehicle:\n  suspension: {SECTION}\n  joints: {{suspension: {NAMED}}}"
    bolt_variant(tmp_path / "car", change)
    (tmp_path / "car" / name).unlink()
    (tmp_path / "car" / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    assert expected in rejection(tmp_path, change)


def test_the_air_and_the_wind_of_a_plant_are_checked():
    with pytest.raises(ValueError, match="air_density"):
        PlantSpec(air_density=-1.0)

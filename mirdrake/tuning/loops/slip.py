"""Slip model of a speed loop: whether driven wheels that begin to slip return to rolling.

A rolling wheel moves with the vehicle. A sliding one has its own inertia only, which is 50 to 200 times smaller, and
gains that suit the vehicle make it unstable: with the dead time τ of the loop a wheel of the inertia J is stable up to
kp = π J / (2 τ). Whether it returns depends on the friction F = μ N of the sliding tyre and the rolling radius r:

- With torques below F r it always does.
- With a larger limit T of the torque, high gains sustain an oscillation: the torque reverses τ after the slip does, and
  the slip has the amplitude (T - F r) τ r / J and the period 4 τ T / (T + F r).

Most vehicles have such torques, so that good gains rely on wheels that do not begin to slide in operation. Therefore
tests are driven on this model: above all the vehicle's own slopes of the set-point, with a reserve of friction.
"""

import math
from collections.abc import Mapping

import numpy as np

from mirdrake.core.compiled import compiled, records
from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.core.pid import PidGains, PidLimits
from mirdrake.plant.wheels.step import SMOOTH_SPEED
from mirdrake.plant.wheels.tyre_forces import REFERENCE_FRICTION, make_spinning_wheels, wheel_laws
from mirdrake.tuning.grip import axles_of
from mirdrake.tuning.loops.base import NOMINAL, Conditions, DrivenAxle, Evaluation, LoopSpec, OuterLoop, SlipModel
from mirdrake.tuning.loops.bench import WAIT, PlantBench
from mirdrake.tuning.loops.reduced import judge_test, model_of, pid_of, reduced_test
from mirdrake.tuning.loops.slip_kernel import SLIP_PARTS, SlipNumbers, simulate_slip
from mirdrake.tuning.models import Floats
from mirdrake.tyres.relaxation import DEFLECTION_LIMIT
from mirdrake.vehicles.traction import FRICTION_RESERVE, Axles

RESERVE, DIRECT_RESERVE = 0.03, FRICTION_RESERVE
"""Reserves of friction on own slopes, with the nominal dead time and with the shortest one [1].

With less, wheels of the plant oscillated, in the test or in other drives. With the shortest dead time, sampled gains
may be too high for a rolling wheel on the slip stiffness of its tyre, before it slides.
"""

UNSTABLE = 10.0
"""Reaction of wheels that do not return to rolling, at least [1]."""

STEP = 1e-3
"""Longest step of the model [s]."""

NODES = 101
"""Slips at which the force of a tyre is stored."""


def pitch_of(bench: PlantBench, axles: Axles) -> tuple[float, float, float]:
    """Return natural frequency [rad/s] and damping ratio of a vehicle that pitches on its springs and tyres.

    The third value is the displacement of its point on the road below the centre of mass, by the pitch of an
    acceleration, over that acceleration: m h² / (I ω²) [s²].

    ω² = (k_f l_f² + k_r l_r²) / I with the stiffness of an axle, tyre and spring in series; a damper of the spring
    moves by the share of the spring. Source: T. D. Gillespie, Fundamentals of Vehicle Dynamics (1992), chapter 5,
    uncoupled bounce and pitch.
    """
    plant, part = bench.plant, bench.part
    context = plant.CreateDefaultContext()
    whole = plant.CalcSpatialInertia(context, plant.world_frame(), plant.GetBodyIndices(part.instance))
    inertia = float(whole.Shift(whole.get_com()).CalcRotationalInertia().get_moments()[1])
    suspension, wheels = part.vehicle.spec.suspension, make_spinning_wheels(plant, part)
    stiffness = damping = 0.0
    for wheel, tyre in ((0, part.compression[0]), (2, part.compression[1])):
        load, arm = wheels[wheel].static_load, axles.to_rear if wheel else axles.to_front
        borne, damped = math.sqrt(tyre.stiffness**2 + 4.0 * tyre.hardening * load), tyre.damping * load
        if suspension is not None:
            spring = suspension.corners()[wheel]
            damped = spring.damping * (borne / (borne + spring.stiffness)) ** 2
            borne *= spring.stiffness / (borne + spring.stiffness)
        stiffness += 2.0 * borne * arm**2
        damping += 2.0 * damped * arm**2
    lean = whole.get_mass() * axles.height**2 / stiffness
    return math.sqrt(stiffness / inertia), 0.5 * damping / math.sqrt(stiffness * inertia), lean


def make_slip_model(bench: PlantBench) -> SlipModel:
    """Return the slip model of a vehicle on the bench of a loop that controls the torque of each driven wheel."""
    wheels, (_, laws) = make_spinning_wheels(bench.plant, bench.part), wheel_laws(bench.part)
    axles, friction = axles_of(bench), float(bench.spec.friction or 0.0)
    total = float(bench.plant.CalcTotalMass(bench.plant.CreateDefaultContext(), [bench.part.instance]))
    base = axles.to_front + axles.to_rear
    driven = []
    for first in sorted({wheel - wheel % 2 for wheel in bench.driven}):
        wheel = wheels[first]
        tyre = laws[first](wheel.static_load, 0.0, friction / REFERENCE_FRICTION)
        slips = np.linspace(0.0, 1.0, NODES) ** 2
        speed = max(bench.spec.course.speed, 1.0)
        driven.append(
            DrivenAxle(
                wheels=2,
                inertia=wheel.inertia,
                load=wheel.static_load,
                # Half of the load of an axle that moves to the other one, or from it.
                transfer=float((1.0 if first else -1.0) * 0.5 * total * axles.height / base),
                stiffness=tyre.contact.stiffness_x / wheel.static_load,
                length=tyre.contact.length_x,
                damping=wheel.settings.lasting_damping / wheel.static_load,
                low_damping=wheel.settings.damping / wheel.static_load,
                curve=tuple(float(tyre.forces(slip, 0.0, speed)[0]) / wheel.static_load for slip in slips.tolist()),
            )
        )
    others = sum(wheel.inertia for place, wheel in enumerate(wheels) if place not in bench.driven)
    return SlipModel(
        total + float(others / bench.radius**2), float(bench.radius), friction, tuple(driven), *pitch_of(bench, axles),
        low=wheels[bench.driven[0]].settings.low,
    )  # fmt: skip


def direct(spec: LoopSpec) -> Conditions:
    """Return the conditions of a controller without dead time, as in a diagram."""
    _, period = model_of(spec)
    return Conditions(delay=-WAIT * period)


def fault_on_own_slopes(slopes: LoopSpec, gains: Mapping[str, float]) -> str:
    """Return why gains do not follow the vehicle's own slopes on the slip model, with reserves of friction; or ""."""
    for conditions, friction, where in _own_slopes(slopes):
        result, reaction = run_with_reaction(slopes, gains, conditions, friction=friction)
        if result.status != "ok":
            return f"{where}{result.reason}"
        if reaction > 1.0:
            return f"{where}a driven wheel slides, and the controller reacts with {reaction:.3g} times its friction"
    return ""


def reaction_on_own_slopes(slopes: LoopSpec, gains: Mapping[str, float]) -> float:
    """Return the largest :func:`slip_reaction` on the vehicle's own slopes, with reserves of friction [1].

    It is above 1 if the gains do not follow them.
    """
    largest = 0.0
    for conditions, friction, _ in _own_slopes(slopes):
        result, reaction = run_with_reaction(slopes, gains, conditions, friction=friction)
        largest = max(largest, reaction if result.status == "ok" else max(reaction, UNSTABLE))
    return largest


def _own_slopes(slopes: LoopSpec) -> tuple[tuple[Conditions, float, str], ...]:
    """Return the tests on the own slopes: conditions, factor on the friction, and what to write before a fault."""
    return (NOMINAL, 1.0 - RESERVE, ""), (direct(slopes), 1.0 - DIRECT_RESERVE, "without dead time: ")


def run_slip(
    spec: LoopSpec,
    gains: Mapping[str, float],
    conditions: Conditions = NOMINAL,
    *,
    friction: float = 1.0,
    slip: float = 0.0,
    keep: bool = True,
) -> Evaluation:
    """Run the test of a loop on the slip model.

    Args:
        spec: the loop.
        gains: by name.
        conditions: of the test.
        friction: factor on the friction of the road [1].
        slip: slip velocity of the driven wheels at the start [m/s].
        keep: whether the evaluation has the response.

    Raises:
        ConfigError: the loop has no slip model, or a gain is not valid.
    """
    return _run(spec, gains, conditions, friction=friction, slip=slip, keep=keep)[0]


def run_with_reaction(
    spec: LoopSpec, gains: Mapping[str, float], conditions: Conditions = NOMINAL, *, friction: float = 1.0
) -> tuple[Evaluation, float]:
    """Return the evaluation of a test, without response, and the :func:`slip_reaction` of its wheels."""
    result, slides = _run(spec, gains, conditions, friction=friction, slip=0.0, keep=False)
    return result, slip_reaction(spec, gains, slides, friction=friction * _road(spec, conditions))


def slip_reaction(spec: LoopSpec, gains: Mapping[str, float], slides: Floats, *, friction: float) -> float:
    """Return the torque with which the controller of a sliding wheel reacts, over that of the friction [1].

    A wheel that slides by s gets the torque kp s / r a dead time later, and kd / (Tf + Ts) s / r from the derivative of
    a controller with the filter Tf and the period Ts. If this is below the friction μ N r, the torque does not reverse,
    and the wheel returns to rolling. With a larger one it slides back, and so on: see the head of the module.

    Args:
        spec: the loop.
        gains: by name.
        slides: sliding velocity of the wheels of each axle, shape (a, k) [m/s].
        friction: of the road [1].
    """
    model, period = model_of(spec)
    assert model.slip is not None
    pid = pid_of(spec, gains)
    gain = pid.kp + pid.kd / (pid.filter_time + period)
    peaks = [
        float(curve.max()) * axle.load
        for curve, axle in zip(_curves(model.slip, friction), model.slip.axles, strict=True)
    ]
    return float(np.max(gain * slides.max(axis=1) / (np.array(peaks) * model.slip.radius**2)))


def _road(spec: LoopSpec, conditions: Conditions) -> float:
    """Return the friction of the road in a test [1]."""
    model, _ = model_of(spec)
    if model.slip is None:
        raise ConfigError("the loop has no slip model")
    return model.slip.friction if conditions.friction is None else conditions.friction


def _run(
    spec: LoopSpec,
    gains: Mapping[str, float],
    conditions: Conditions,
    *,
    friction: float,
    slip: float,
    keep: bool,
) -> tuple[Evaluation, Floats]:
    """Run a test; return the evaluation, and the sliding velocity of the wheels of each axle in each period [m/s]."""
    (model, _), road = model_of(spec), friction * _road(spec, conditions)
    assert model.slip is not None
    test, pid, curves = reduced_test(spec, conditions), pid_of(spec, gains), _curves(model.slip, road)
    rows = np.array(
        [
            (
                axle.wheels, axle.inertia * conditions.mass, axle.load * conditions.mass,
                axle.transfer * conditions.mass, axle.stiffness, axle.length, axle.damping, axle.low_damping,
                DEFLECTION_LIMIT * float(curve.max()) / axle.stiffness, _peak_slip(curve),
            )
            for axle, curve in zip(model.slip.axles, curves, strict=True)
        ]
    )  # fmt: skip
    output, effort = np.zeros(len(test.t)), np.zeros(len(test.t))
    slips, slides = np.zeros((len(rows), len(test.t))), np.zeros((len(rows), len(test.t)))
    compiled(simulate_slip, parts=SLIP_PARTS)(
        records(SlipNumbers, [_numbers(spec, pid, test.limits, conditions, slip)]),
        rows, curves, test.wanted, test.feedforward, test.loads, test.resistances, test.noise,
        output, effort, slips, slides,
    )  # fmt: skip
    per = model.scale * model.slip.radius  # m/s per output
    others = {f"the slip of the wheels of driven axle {k + 1}": row / per for k, row in enumerate(slips)}
    return judge_test(spec, test, gains, conditions, output, effort, keep=keep, others=others), slides


def _curves(model: SlipModel, road: float) -> Floats:
    """Return force over load of each axle for a friction of the road, by similarity.

    Source: H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 4.2: with another friction, the curve is scaled
    along both axes, so that the slip stiffness is the same.
    """
    ratio = road / model.friction
    slips = np.linspace(0.0, 1.0, NODES) ** 2
    return np.array([ratio * np.interp(slips / ratio, slips, axle.curve) for axle in model.axles])


def _peak_slip(curve: Floats) -> float:
    """Return the slip of the largest force of a curve, to which a force within a thousandth counts [1]."""
    return float((np.argmax(curve > 0.999 * curve.max()) / (NODES - 1)) ** 2)


def _numbers(spec: LoopSpec, pid: PidGains, limits: PidLimits, conditions: Conditions, slip: float) -> SlipNumbers:
    model, period = model_of(spec)
    assert model.slip is not None
    outer = model.outer or OuterLoop(0.0, 0.0, 0.0)
    # Delay of the actuator, and the mean wait for it.
    delay = (spec.delay if conditions.delay is None else conditions.delay) + WAIT * period
    whole = math.floor(delay / period + 1e-9)
    return SlipNumbers(
        period=period,
        steps=math.ceil(period / STEP - 1e-9),
        whole=whole,
        part=max(delay - whole * period, 0.0),
        scale=float(model.scale),
        start=model.start,
        is_speed=model.output is not None,
        outer=model.outer is not None,
        mass=model.slip.mass * conditions.mass,
        radius=model.slip.radius,
        gravity=GRAVITY * math.sin(conditions.grade),
        frequency=model.slip.frequency,
        damping=model.slip.damping,
        lean=model.slip.lean,
        low=model.slip.low,
        slip=slip,
        drag=model.drag,
        fade=SMOOTH_SPEED * model.slip.radius,
        pid=pid.numbers(),
        limits=limits,
        outer_pid=PidGains(outer.kp, outer.ki).numbers(),
        outer_limits=PidLimits(-outer.limit, outer.limit),
    )

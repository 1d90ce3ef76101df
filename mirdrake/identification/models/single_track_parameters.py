"""The parameters of the single track: guesses and bounds by its loads and lengths, or as a vehicle has them."""

from collections.abc import Collection, Mapping, Sequence

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.models.steer import steering_parameters
from mirdrake.identification.parameters import Parameter

_CORNERING = 12.0
"""Cornering stiffness over load, a common tyre [1/rad]."""

RELAXATION = 0.15
"""Relaxation length over wheelbase [1]: 0.4 m for a car (Pacejka, Tyre and Vehicle Dynamics, 3rd ed., chapter 7)."""

_ROLL_ARM = 0.15
"""Centre of mass over the roll axis, over the wheelbase [1]: 0.4 m for a car."""

_AXLES = {"relaxation": "both axles", "relaxation_front": "front", "relaxation_rear": "rear"}

DELAYS = (
    ("lateral_acceleration", "accelerometer_delay", "lateral acceleration"),
    ("vy", "velocity_delay", "vy"),
)
"""Outputs that may be late, the names of how much, and words."""


def single_track_parameters(
    given: Mapping[str, float],
    wheelbase: float | None,
    steer: str,
    *,
    outputs: Collection[str],
    tyres: str,
    roll: bool,
    relaxation: Sequence[str],
    yields: bool,
    damped_late: bool,
) -> tuple[Parameter, ...]:
    """Parameters of a single track.

    Args:
        given: what is known, by name; without a mass all is per kilogram.
        wheelbase: of the data set [m].
        steer: channel of the steering.
        outputs: channels to compare.
        tyres: "linear", "fiala" or "magic_formula".
        roll: whether the body rolls.
        relaxation: names of the lengths over which slip builds up, front and rear; none: at once.
        yields: whether the steering gives way.
        damped_late: whether the tyres give way to the dampers.
    """
    lengths = [given.get("front_length"), given.get("rear_length")]
    total = wheelbase or given.get("assumed_wheelbase", 2.7)
    said = "half of the given wheelbase" if wheelbase else "assumed, no wheelbase is given"
    if any(lengths):
        said = "the rest of the wheelbase" if wheelbase else "assumed, no wheelbase is given"
    front = lengths[0] or (max(total - lengths[1], 0.1 * total) if lengths[1] else 0.5 * total)
    rear = lengths[1] or (max(total - front, 0.1 * total) if lengths[0] else 0.5 * total)
    mass = given.get("mass", 1.0)
    bare = "mass" not in given
    loads = (mass * GRAVITY * rear / (front + rear), mass * GRAVITY * front / (front + rear))
    per = " per kg" if bare else ""
    stiff, inert = ("N/(rad kg)", "m^2") if bare else ("N/rad", "kg m^2")
    name = "cornering stiffness of the {} axle, both tyres" + per
    found = [
        Parameter(
            "mass",
            "1" if bare else "kg",
            "of the vehicle",
            mass,
            1e-3,
            1e6,
            source="not given: stiffness and inertia are per kilogram" if bare else "",
        ),
        Parameter(
            "front_length", "m", "centre of mass to front axle", front, 0.01, 20.0, source="" if lengths[0] else said
        ),
        Parameter(
            "rear_length", "m", "centre of mass to rear axle", rear, 0.01, 20.0, source="" if lengths[1] else said
        ),
        Parameter(
            "cornering_stiffness_front",
            stiff,
            name.format("front"),
            _CORNERING * loads[0],
            0.3 * loads[0],
            500.0 * loads[0],
            True,
            usual=1.0,
        ),
        Parameter(
            "cornering_stiffness_rear",
            stiff,
            name.format("rear"),
            _CORNERING * loads[1],
            0.3 * loads[1],
            500.0 * loads[1],
            True,
            usual=1.0,
        ),
        Parameter(
            "yaw_inertia",
            inert,
            "about the vertical" + per,
            mass * front * rear,
            0.05 * mass * front * rear,
            20.0 * mass * front * rear,
            True,
            usual=0.7,
        ),
        Parameter(
            "spin_inertia",
            inert,
            "with which spinning wheels resist yawing" + per,
            0.0,
            0.0,
            mass * front * rear,
            scale=0.01 * mass * front * rear,
            usual=2.0,
        ),
        Parameter(
            "steering_inertia",
            inert,
            "of what is steered, about its axes" + per,
            0.0,
            0.0,
            mass * front * rear,
            scale=1e-3 * mass * front * rear,
            usual=2.0,
        ),
        *steering_parameters(steer),
        Parameter(
            "accelerometer_ahead",
            "m",
            "accelerometer before the centre of mass",
            0.0,
            -10.0,
            10.0,
            "lateral_acceleration" in outputs,
            0.2 * (front + rear),
            usual=1.5,
        ),
        Parameter(
            "velocity_ahead",
            "m",
            "place of the measured vy before the centre of mass",
            0.0,
            -10.0,
            10.0,
            "vy" in outputs,
            0.2 * (front + rear),
            usual=1.5,
        ),
    ]
    found += [
        Parameter(
            name, "s", f"how late the measured {words} is behind the yaw rate", 0.0, -0.1, 0.1, scale=0.01, usual=2.0
        )
        for channel, name, words in DELAYS
        if channel in outputs
    ]
    found.append(
        Parameter(
            "load_transfer",
            "m",
            "height of the centre of mass, where stiffness goes with load",
            0.0,
            -0.6 * (front + rear),
            0.6 * (front + rear),
            scale=0.2 * (front + rear),
            usual=2.0,
        )
    )
    found.append(
        Parameter(
            "drag",
            "1/m" if bare else "N s^2/m^2",
            "of the air over the square of the speed, which moves load to the rear" + per,
            0.0,
            0.0,
            mass,
            scale=1e-4 * mass,
            usual=2.0,
        )
    )
    found += [
        Parameter(
            name,
            "1",
            f"part of the {words} that the front wheels have",
            usual,
            0.0,
            1.0,
            scale=0.5,
            usual=1.0,
            source="" if name in given else f"assumed: {usual:g}",
        )
        for name, words, usual in (("front_drive", "drive", 0.5), ("front_brake", "braking", 0.6))
    ]
    if tyres != "linear":
        found += [
            Parameter(f"friction_{axle}", "1", f"largest force over load, {axle}", 0.9, 0.05, 3.0, True, usual=0.7)
            for axle in ("front", "rear")
        ]
    if tyres == "magic_formula":
        for axle in ("front", "rear"):
            found.append(Parameter(f"shape_{axle}", "1", f"shape factor C, {axle}", 1.4, 1.0, 2.5, usual=0.3))
            found.append(
                Parameter(
                    f"curvature_{axle}", "1", f"curvature factor E, {axle}", 0.0, -10.0, 0.99, scale=0.5, usual=2.0
                )
            )
    if relaxation:
        found += [
            Parameter(
                key,
                "m",
                f"relaxation length of the tyres, {_AXLES[key]}",
                RELAXATION * (front + rear),
                0.0,
                2.0 * (front + rear),
                key == "relaxation",
                scale=0.1 * (front + rear),
                usual=2.0,
                source="" if key in given else "assumed: 0.15 of the wheelbase",
            )
            for key in dict.fromkeys(relaxation)
        ]
        found += [
            Parameter(
                f"trail_{axle}",
                "m",
                f"pneumatic trail, {axle}: how far behind the wheels the force acts",
                0.0,
                -0.5,
                0.5,
                scale=0.02,
                usual=2.0,
            )
            for axle in ("front", "rear")
        ]
    if yields:
        found += [
            Parameter(
                "steering_compliance",
                "rad/(N m)" if "mass" in given else "rad kg/(N m)",
                "angle of the front wheels over the moment on both that the steering gives way to",
                0.0,
                0.0,
                1.0,
                scale=1e-5,
                usual=2.0,
            ),
            Parameter("steering_compliance_time", "s", "how late it does", 0.0, 0.0, 1.0, scale=0.02, usual=2.0),
        ]
        if roll:
            found.append(
                Parameter(
                    "camber_moment",
                    "N m/rad" if "mass" in given else "N m/(rad kg)",
                    "moment of the front wheels on the steering over roll, beside that of their force",
                    0.0,
                    -10.0 * mass,
                    10.0 * mass,
                    scale=0.5 * mass,
                    usual=2.0,
                )
            )
    if damped_late:
        found.append(
            Parameter(
                "roll_damper_time", "s", "how late the dampers work, with tyres behind them", 0.0, 0.0, 1.0,
                scale=0.01, usual=2.0,
            )
        )  # fmt: skip
    return (*found, *(_roll_parameters(given, outputs, mass, front + rear) if roll else ()))


def _roll_parameters(
    given: Mapping[str, float], outputs: Collection[str], mass: float, length: float
) -> tuple[Parameter, ...]:
    # Where no sensor sees the roll, what a vehicle's files say of it is better than what a log does.
    seen = bool({"roll", "roll_rate"} & set(outputs))
    gain, frequency, damping = ("roll_gain", "roll_frequency", "roll_damping")
    return (
        Parameter(
            gain, "rad s^2/m", "roll angle over lateral acceleration", 0.01, 1e-4, 0.1, seen or gain not in given,
            usual=1.0,
        ),
        Parameter(
            frequency, "rad/s", "natural frequency of roll", 9.0, 1.0, 60.0, seen or frequency not in given, usual=0.7
        ),
        Parameter(damping, "1", "damping ratio of roll", 0.3, 0.02, 3.0, seen or damping not in given, usual=1.0),
        Parameter(
            "roll_arm", "m", "centre of mass over the roll axis", _ROLL_ARM * length, 0.0, 3.0, scale=0.2, usual=2.0,
            source="" if "roll_arm" in given else "assumed: 0.15 of the wheelbase",
        ),
        Parameter(
            "wheel_momentum",
            "kg m" if "mass" in given else "m",
            "angular momentum of all wheels over speed",
            0.0,
            0.0,
            mass,
            scale=0.01 * mass,
            usual=2.0,
        ),
        Parameter(
            "roll_moment", "N m/rad" if "mass" in given else "N m/(rad kg)",
            "moment of the road about the vertical over roll, beside those of the lateral forces",
            0.0, -10.0 * mass, 10.0 * mass, scale=0.5 * mass, usual=2.0,
        ),
        Parameter("roll_steer", "1", "steering of the front wheels over roll", 0.0, -1.0, 1.0, scale=0.05, usual=2.0),
        Parameter("roll_steer_rear", "1", "the same at the rear", 0.0, -1.0, 1.0, scale=0.05, usual=2.0),
        Parameter(
            "accelerometer_height", "m", "accelerometer over the roll axis", 0.0, -5.0, 5.0, scale=0.1 * length,
            usual=2.0,
        ),
        Parameter(
            "velocity_height", "m", "place of the measured vy over the roll axis", 0.0, -5.0, 5.0, scale=0.1 * length,
            usual=2.0,
        ),
        Parameter(
            "accelerometer_tilt", "1", "1: it leans with the body, 0: it is levelled", 0.0, -1.0, 2.0, scale=0.3,
            usual=2.0,
        ),
    )  # fmt: skip

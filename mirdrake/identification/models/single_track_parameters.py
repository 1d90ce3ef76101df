"""Parameters of the single track: guesses and bounds from its loads and lengths, or values of a vehicle."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from mirdrake.core.constants import GRAVITY
from mirdrake.identification.models.steer import steering_parameters
from mirdrake.identification.parameters import Parameter

_CORNERING = 12.0
"""Cornering stiffness over load of a common tyre [1/rad]."""

RELAXATION = 0.15
"""Relaxation length over wheelbase [1]: 0.4 m for a car (Pacejka, Tyre and Vehicle Dynamics, 3rd ed., chapter 7)."""

_ROLL_ARM = 0.15
"""Height of the centre of mass above the roll axis over the wheelbase [1]: 0.4 m for a car."""

ASSUMED_WHEELBASE = 0.5
"""Standard deviation of the logarithm of an unknown wheelbase from that which suits the tightest turn [1]."""

_AXLES = {"relaxation": "both axles", "relaxation_front": "front", "relaxation_rear": "rear"}

DELAYS = (
    ("lateral_acceleration", "accelerometer_delay", "lateral acceleration"),
    ("vy", "velocity_delay", "vy"),
)
"""Outputs that may have a delay, the parameters of the delays, and names for people."""


@dataclass(frozen=True)
class _Size:
    """Mass, axle distances and units of a single track; without a mass everything is per kilogram."""

    bare: bool
    mass: float
    front: float
    rear: float
    sources: tuple[str, str]

    @property
    def is_assumed(self) -> bool:
        """Whether the wheelbase is assumed."""
        return any(source.startswith("assumed") for source in self.sources)

    @property
    def length(self) -> float:
        return self.front + self.rear

    @property
    def per(self) -> str:
        return " per kg" if self.bare else ""

    def unit(self, unit: str, bare: str) -> str:
        return bare if self.bare else unit


def single_track_parameters(
    known: Mapping[str, float],
    wheelbase: float | None,
    steer: str,
    *,
    outputs: Collection[str],
    tyres: str,
    roll: bool,
    relaxation: Sequence[str],
    compliant: bool,
    damper_lag: bool,
) -> tuple[Parameter, ...]:
    """Return the parameters of a single track.

    Args:
        known: known values by name; without a mass everything is per kilogram.
        wheelbase: wheelbase of the data set [m].
        steer: channel of the steering.
        outputs: channels to compare.
        tyres: "linear", "fiala" or "magic_formula".
        roll: whether the body rolls.
        relaxation: parameters of the relaxation lengths, front and rear; empty without relaxation.
        compliant: whether the steering is compliant.
        damper_lag: whether the roll dampers act in series with the tyres.
    """
    size = _size(known, wheelbase)
    parameters = _rigid_parameters(size, known, outputs, steer)
    # A linear tyre has no limit of friction, the brush and the Magic Formula have one for each axle.
    if tyres != "linear":
        parameters += [
            Parameter(f"friction_{axle}", "1", f"largest force over load, {axle}", 0.9, 0.05, 3.0, True, usual=0.7)
            for axle in ("front", "rear")
        ]
    if tyres == "magic_formula":
        for axle in ("front", "rear"):
            parameters += [
                Parameter(f"shape_{axle}", "1", f"shape factor C, {axle}", 1.4, 1.0, 2.5, usual=0.3),
                Parameter(f"curvature_{axle}", "1", f"curvature factor E, {axle}", 0.0, -10.0, 0.99, scale=0.5,
                          usual=2.0),
            ]  # fmt: skip
    if relaxation:
        parameters += _relaxation_parameters(size, known, relaxation)
    if compliant:
        parameters += _compliance_parameters(size, roll=roll)
    if damper_lag:
        parameters.append(
            Parameter("roll_damper_time", "s", "lag of the dampers in series with the tyres", 0.0, 0.0, 1.0,
                      scale=0.01, usual=2.0)
        )  # fmt: skip
    return (*parameters, *(_roll_parameters(known, outputs, size) if roll else ()))


def _size(known: Mapping[str, float], wheelbase: float | None) -> _Size:
    """Complete mass and axle distances, with the sources of the assumed values."""
    lengths = [known.get("front_length"), known.get("rear_length")]
    # A distance that is not given is the rest of the wheelbase, but at least a tenth of it.
    total = wheelbase or known.get("assumed_wheelbase", 2.7)
    source = "half of the given wheelbase" if wheelbase else "assumed, no wheelbase is given"
    if any(lengths):
        source = "the rest of the wheelbase" if wheelbase else "assumed, no wheelbase is given"
    front = lengths[0] or (max(total - lengths[1], 0.1 * total) if lengths[1] else 0.5 * total)
    rear = lengths[1] or (max(total - front, 0.1 * total) if lengths[0] else 0.5 * total)
    sources = ("" if lengths[0] else source, "" if lengths[1] else source)
    return _Size("mass" not in known, known.get("mass", 1.0), front, rear, sources)


def _rigid_parameters(size: _Size, known: Mapping[str, float], outputs: Collection[str], steer: str) -> list[Parameter]:
    """Return mass, lengths, stiffnesses, inertias, steering, sensor positions and longitudinal forces."""
    m, length, per = size.mass, size.length, size.per
    # Guesses and bounds scale with the vehicle, so that they suit a model car as well as a truck.
    loads = {"front": m * GRAVITY * size.rear / length, "rear": m * GRAVITY * size.front / length}
    stiffness, inertia = size.unit("N/rad", "N/(rad kg)"), size.unit("kg m^2", "m^2")
    gyration = m * size.front * size.rear  # yaw inertia of a car, nearly
    # An assumed wheelbase is uncertain, and the inertia is proportional to its square.
    inertia_usual = math.hypot(0.3, 2.0 * ASSUMED_WHEELBASE if size.is_assumed else 0.0)
    source = "not given: stiffness and inertia are per kilogram" if size.bare else ""
    parameters = [
        # Bounds exclude only what no vehicle has. `usual` holds 95 % of vehicles: stiffness over load of 4.5 to 32 per
        # radian, inertia over m a b of 0.55 to 1.8. Where a log does not determine them, they keep a usual value.
        Parameter("mass", size.unit("kg", "1"), "mass of the vehicle", m, 1e-3, 1e6, source=source),
        Parameter("front_length", "m", "centre of mass to front axle", size.front, 0.01, 20.0, source=size.sources[0]),
        Parameter("rear_length", "m", "centre of mass to rear axle", size.rear, 0.01, 20.0, source=size.sources[1]),
    ]
    # Without a wheelbase the axle distances are in proportion to an estimated one.
    if "front_length" not in known and "rear_length" not in known and size.is_assumed:
        parameters.append(
            Parameter("wheelbase", "m", "distance of the axles", length, 0.1, 40.0, True, usual=ASSUMED_WHEELBASE)
        )
    parameters += [
        Parameter(f"cornering_stiffness_{axle}", stiffness, f"cornering stiffness of the {axle} axle, both tyres{per}",
                  _CORNERING * load, 0.3 * load, 500.0 * load, True, usual=0.5)
        for axle, load in loads.items()
    ]  # fmt: skip
    parameters += [
        Parameter("yaw_inertia", inertia, "yaw inertia" + per, gyration, 0.05 * gyration, 20.0 * gyration, True,
                  usual=inertia_usual),
        Parameter("spin_inertia", inertia, "additional yaw inertia of the spinning wheels" + per, 0.0, 0.0, gyration,
                  scale=0.01 * gyration, usual=2.0),
        Parameter("steering_inertia", inertia, "inertia of the steered parts about the steering axes" + per, 0.0, 0.0,
                  gyration, scale=1e-3 * gyration, usual=2.0),
        *steering_parameters(steer),
        Parameter("accelerometer_ahead", "m", "accelerometer ahead of the centre of mass", 0.0, -10.0, 10.0,
                  "lateral_acceleration" in outputs, 0.2 * length, usual=1.5),
        Parameter("velocity_ahead", "m", "position of the measured vy ahead of the centre of mass", 0.0, -10.0, 10.0,
                  "vy" in outputs, 0.2 * length, usual=1.5),
    ]  # fmt: skip
    parameters += [
        Parameter(name, "s", f"delay of the measured {words} against the yaw rate", 0.0, -0.2, 0.2, scale=0.01,
                  usual=2.0)
        for channel, name, words in DELAYS
        if channel in outputs
    ]  # fmt: skip
    # Effects of the longitudinal force are small in handling tests, so that these parameters are fixed unless freed.
    parameters += [
        Parameter("load_transfer", "m", "height of the centre of mass, if tyre forces are proportional to the load",
                  0.0, -0.6 * length, 0.6 * length, scale=0.2 * length, usual=2.0),
        Parameter("drag", size.unit("N s^2/m^2", "1/m"), "drag over speed squared, which unloads the front axle" + per,
                  0.0, 0.0, m, scale=1e-4 * m, usual=2.0),
    ]  # fmt: skip
    return parameters + [
        Parameter(name, "1", f"front axle's share of the {words} force", share, 0.0, 1.0, scale=0.5, usual=1.0,
                  source="" if name in known else f"assumed: {share:g}")
        for name, words, share in (("front_drive", "drive", 0.5), ("front_brake", "braking", 0.6))
    ]  # fmt: skip


def _relaxation_parameters(size: _Size, known: Mapping[str, float], lengths: Sequence[str]) -> list[Parameter]:
    total = size.length
    parameters = [
        Parameter(key, "m", f"relaxation length of the tyres, {_AXLES[key]}", RELAXATION * total, 0.0, 2.0 * total,
                  key == "relaxation", scale=0.1 * total, usual=2.0,
                  source="" if key in known else "assumed: 0.15 of the wheelbase")
        for key in dict.fromkeys(lengths)
    ]  # fmt: skip
    return parameters + [
        Parameter(f"trail_{axle}", "m", f"pneumatic trail, {axle}: distance of the force behind the wheel centre",
                  0.0, -0.5, 0.5, scale=0.02, usual=2.0)
        for axle in ("front", "rear")
    ]  # fmt: skip


def _compliance_parameters(size: _Size, *, roll: bool) -> list[Parameter]:
    parameters = [
        Parameter("steering_compliance", size.unit("rad/(N m)", "rad kg/(N m)"),
                  "deflection of the front wheels over the moment on both", 0.0, 0.0, 1.0, scale=1e-5, usual=2.0),
        Parameter("steering_compliance_time", "s", "time constant of the deflection", 0.0, 0.0, 1.0, scale=0.02,
                  usual=2.0),
    ]  # fmt: skip
    if roll:
        parameters.append(
            Parameter("camber_moment", size.unit("N m/rad", "N m/(rad kg)"),
                      "steering moment of the front wheels over roll, beside that of their force", 0.0,
                      -10.0 * size.mass, 10.0 * size.mass, scale=0.5 * size.mass, usual=2.0)
        )  # fmt: skip
    return parameters


def _roll_parameters(known: Mapping[str, float], outputs: Collection[str], size: _Size) -> tuple[Parameter, ...]:
    # Without a roll sensor, the values of the vehicle's files are more certain than estimates from a log.
    measured = bool({"roll", "roll_rate"} & set(outputs))
    # A measured roll angle makes its parameters identifiable; without it given values are kept.
    free = {name: measured or name not in known for name in ("roll_gain", "roll_frequency", "roll_damping")}
    # Bounds and scales are multiples of mass and wheelbase, so that they suit vehicles of any size.
    m, length = size.mass, size.length
    arm_source = "" if "roll_arm" in known else "assumed: 0.15 of the wheelbase"
    return (
        Parameter("roll_gain", "rad s^2/m", "roll angle over lateral acceleration", 0.01, 1e-4, 0.1, free["roll_gain"],
                  usual=1.0),
        Parameter("roll_frequency", "rad/s", "natural frequency of roll", 9.0, 1.0, 60.0, free["roll_frequency"],
                  usual=0.7),
        Parameter("roll_damping", "1", "damping ratio of roll", 0.3, 0.02, 3.0, free["roll_damping"], usual=1.0),
        Parameter("roll_arm", "m", "height of the centre of mass above the roll axis", _ROLL_ARM * length, 0.0, 3.0,
                  scale=0.2, usual=2.0, source=arm_source),
        Parameter("wheel_momentum", size.unit("kg m", "m"), "angular momentum of all wheels over speed", 0.0, 0.0, m,
                  scale=0.01 * m, usual=2.0),
        Parameter("roll_moment", size.unit("N m/rad", "N m/(rad kg)"),
                  "yaw moment of the tyres over roll, beside those of the lateral forces",
                  0.0, -10.0 * m, 10.0 * m, scale=0.5 * m, usual=2.0),
        Parameter("roll_steer", "1", "steering of the front wheels over roll", 0.0, -1.0, 1.0, scale=0.05, usual=2.0),
        Parameter("roll_steer_rear", "1", "steering of the rear wheels over roll", 0.0, -1.0, 1.0, scale=0.05,
                  usual=2.0),
        Parameter("accelerometer_height", "m", "accelerometer above the roll axis", 0.0, -5.0, 5.0, scale=0.1 * length,
                  usual=2.0),
        Parameter("velocity_height", "m", "position of the measured vy above the roll axis", 0.0, -5.0, 5.0,
                  scale=0.1 * length, usual=2.0),
        Parameter("accelerometer_tilt", "1", "1: it rolls with the body, 0: it is levelled", 0.0, -1.0, 2.0, scale=0.3,
                  usual=2.0),
    )  # fmt: skip

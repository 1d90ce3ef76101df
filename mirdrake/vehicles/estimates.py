"""Estimates of vehicle parameters that a data sheet does not contain.

The formulas hold from a 1:10 car (3.5 kg, wheel radius 0.05 m) to a lorry of 20 t: most are a dimensionless number
times a power of the given mass m, wheel radius R, wheelbase L and gravity g. Top speed and power follow no such law:
they are those of the class of vehicles, by the mass (:data:`TOP_SPEEDS`, :data:`POWER_PER_MASS`). The numbers come
from vehicles with published figures, above all the Chevrolet Bolt in models/bolt (*the Bolt*; its README names the
sources). Forces scale with m g, lengths with R or L, and times with sqrt(R / g) (Froude scaling). Two times do not
scale: the time step of the plant and the period of the controllers. The steering servo is designed for these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from math import atan, atan2, cos, hypot, log, pi, radians, sin, sqrt, tan
from typing import Any

import numpy as np

from mirdrake.core.constants import GRAVITY
from mirdrake.core.errors import ConfigError
from mirdrake.vehicles.spec import Drive
from mirdrake.vehicles.traction import Axles, followed_slope

BOLT_RADIUS = 0.3234
"""Wheel radius of the Bolt [m], the reference of all time scales."""

TYRE_COMPRESSION = 0.061
"""Tyre compression over wheel radius under a quarter of the weight: car tyres have about 200 kN/m, the Bolt's deflects
by 20 mm."""

PATCH_LENGTH = (0.205, 0.332)
"""Half length of the contact patch over wheel radius, *assumed*: of the Bolt, 66 mm, and the largest of smaller wheels.

That of smaller wheels is larger in inverse proportion to the root of the radius. The flattened length is shorter than
the chord of the compressed circle, since the tread is bent at both ends of the patch.
"""

ROBOT_MASS = 100.0
"""Mass below which a vehicle counts as a robot, without hand wheel and cabin; model cars give its estimates [kg]."""

TURNING_CIRCLE = 4.0
"""Turning circle between kerbs of a road vehicle, in wheelbases.

For the 32 vehicles in tests/data/turning_circles.csv (city car to lorry of 12 t), the median error is +1 %, the
standard deviation 7 %, and the errors range from -15 to +17 %. The track does not improve the fit.
"""

ROBOT_STEERING = 0.42
"""Steering limit of a robot's inner wheel [rad]: F1TENTH 0.42, AutoRally 0.37, MuSHR 0.34, MIT racecar 0.3 to 0.34."""

STEERING_MOST = 0.8
"""Largest estimate of a steering limit [rad]; the joints of driven front wheels do not allow more."""

YAW_COEFFICIENT = (0.09, 0.13)
"""Yaw inertia over mass x wheelbase x length: of robots and of road vehicles [-].

Burg uses this form for road vehicles with 0.127 (quoted by MacInnis et al., SAE 970951); the four measured vehicles in
tests/data/yaw_inertias.csv have 0.12 to 0.15. Model cars have their mass near the middle: F1TENTH 0.067, BARC 0.085 to
0.106, ORCA and AutoRally 0.10. Between :data:`ROBOT_MASS` and twice that mass, the coefficient is interpolated over the
logarithm of the mass. Over the whole table the median error is -4 % and the standard deviation 14 %; the largest error
is +34 % (F1TENTH).
"""

TOP_SPEEDS = (
    (10.0, 2.0), (100.0, 2.0), (500.0, 12.0), (700.0, 12.0), (900.0, 45.0), (3500.0, 45.0), (7500.0, 25.0)
)  # fmt: skip
"""Masses [kg] and top speeds [m/s]: ground robots, golf carts and light quadricycles, cars, and lorries.

The tables are interpolated, logarithms over logarithms. Vehicles of more than 3.5 t are limited to 90 km/h in Europe
(Directive 92/6/EEC). Vehicles below 5 kg are model cars, whose top speed is that of the wheels,
:data:`WHEEL_SPEED`; between 5 and 10 kg, the top speed is interpolated as well. For the 30 vehicles in
tests/data/powers.csv (delivery robot to bus), the median error is 1 %, the largest a factor of 2.4; 83 % are within a
factor of 1.6.
"""

POWER_PER_MASS = (
    (100.0, 14.0), (500.0, 15.0), (1600.0, 99.6), (2500.0, 70.0), (3500.0, 35.0), (7500.0, 18.0), (18000.0, 13.0)
)  # fmt: skip
"""Masses [kg] and powers over mass at the top speed of :data:`TOP_SPEEDS` [W/kg]: the classes as there.

A vehicle with another top speed has a power in proportion to it: the same thrust. The Bolt has 93 W/kg at 42 m/s. For
the 25 powers in tests/data/powers.csv, the median error is 6 %, the largest a factor of 2.1; 80 % are within a factor
of 1.6.
"""

WHEEL_SPEED = 130.0
"""Largest estimate of a wheel speed [rad/s], as the Bolt's: one revolution in ten time steps of 5 ms."""

MODEL_CAR_MASS = 5.0
"""Mass up to which a vehicle counts as a model car, which is faster than a larger robot [kg]."""

STEERING_ERROR = 1e-3
"""Deflection of a steering servo under the scrub moment of its tyre [rad], for tyres without a slip model."""

STEERING_FREQUENCY = 10.0
"""Smallest natural frequency of a steering servo with its wheel [Hz]; the servo is strongly overdamped."""


def _quantity(label: str, unit: str, how: str) -> Any:
    """Return a field of :class:`Estimates`: its name in tables, its unit, and how it is estimated."""
    return field(metadata={"label": label, "unit": unit, "how": f"estimated: {how}"})


@dataclass(frozen=True)
class Estimates:
    """Estimated parameters of a vehicle, and the given ones. SI units, vehicle frame of :mod:`mirdrake.vehicles`.

    The label of a field is its meaning. Values of an axle are those of one wheel, spring, damper or tyre.
    """

    length: float = _quantity(
        "length", "m", "1.65 wheelbases (Bolt 1.60, Escape 1.69, MKZ 1.73), at least 2.6 wheel radii longer than one"
    )
    width: float = _quantity("width", "m", "1.03 x (track + wheel width); Bolt 1.765 m of 1.716 m")
    height: float = _quantity("height", "m", "4.6 wheel radii (Bolt 4.9, MKZ 4.5, Unior 4.4)")
    ground_clearance: float = _quantity("ground clearance", "m", "0.45 wheel radii; Bolt 0.15 m")
    arch_half: float = _quantity(
        "half length of a wheel arch", "m", "reach of a tyre at the steering limit, plus a clearance of 0.1 wheel radii"
    )
    front_axle_share: float = _quantity(
        "share of the weight on the front axle", "-", "0.5, the mean of front-driven (Bolt 0.56) and rear-driven cars"
    )
    com_height: float = _quantity(
        "height of the centre of mass",
        "m",
        "0.37 of the height as in cars without a floor battery, at most 0.45 tracks so that the vehicle slides "
        "before it rolls over",
    )
    wheel_mass: float = _quantity(
        "one wheel", "kg", "283 kg per m³ of wheel cylinder (Bolt 20 kg), at most 2.5 % of the mass (Unior 2.1 %)"
    )
    knuckle_mass: float = _quantity("one steering knuckle", "kg", "half a wheel, as the Bolt's (10 kg)")
    kingpin_offset: float = _quantity(
        "scrub radius: steering axis inside the middle plane of the wheel",
        "m",
        "scrub radius of 0.06 wheel radii; Bolt 0.02 m",
    )
    inertia_edges: tuple[float, float, float] = _quantity(
        "box with the inertia of the body",
        "m",
        "homogeneous box of 0.88 widths and 0.75 heights (Bolt), as long as makes the yaw inertia of the whole "
        "vehicle the one below",
    )
    yaw_inertia: float = _quantity(
        "yaw inertia, whole vehicle",
        "kg m²",
        "0.13 x mass x wheelbase x length as measured road vehicles; below 100 kg 0.09, as F1TENTH, BARC, AutoRally",
    )
    roll_inertia: float = _quantity(
        "roll inertia, whole vehicle", "kg m²", "body as a homogeneous box, plus wheels and knuckles"
    )
    pitch_inertia: float = _quantity(
        "pitch inertia, whole vehicle", "kg m²", "body as a homogeneous box, plus wheels and knuckles"
    )
    tyre_dissipation: float = _quantity(
        "dissipation", "s/m", "0.85 over the speed of the tread towards the road at top speed; Bolt 0.1 s/m"
    )
    tyre_stiffness: float = _quantity(
        "stiffness", "N/m", "compression of 0.061 radii under a quarter of the weight; Bolt 2e5 N/m"
    )
    friction: float = _quantity(
        "friction coefficient of the tyre", "-", "0.9, a car tyre on dry asphalt (Bolt 0.82 to 1.04)"
    )
    rolling_resistance: float = _quantity(
        "rolling resistance", "-", "0.01, a common car tyre (Bolt 0.0073, Audibot 0.01)"
    )
    max_torque: float = _quantity(
        "drive torque, sum over the driven wheels", "N m", "half the weight as thrust, 0.5 m g R (Bolt 0.495)"
    )
    max_power: float = _quantity(
        "power",
        "W",
        "power over mass of its class, by the mass: robots 14 W/kg, golf carts 15, cars up to 100, lorries of 18 t 13; "
        "in proportion to the top speed",
    )
    brake_torque: float = _quantity(
        "brake torque, sum over the four wheels",
        "N m",
        "1.5 times the weight as braking force, so that the tyres limit the braking (Bolt 1.56)",
    )
    brake_front_share: float = _quantity(
        "share of the brake torque on the front axle", "-", "load share of the front axle when braking with 0.5 g"
    )
    steering_effort: float = _quantity(
        "torque of a steering joint", "N m", "0.8 x wheel load x wheel radius (Bolt 1000 N m)"
    )
    steering_rate: float = _quantity(
        "steering rate at the road wheel", "rad/s", "0.16 m/s over the wheel radius (Bolt 0.5 rad/s, F1TENTH 3.2 rad/s)"
    )
    steering_motor_damping: float = _quantity(
        "damping of a steering motor",
        "N m s/rad",
        "torque over the no-load speed, which is four times the rate, as of the Unior's motors (data sheet: 4.1)",
    )
    steering_motor_inertia: float = _quantity(
        "rotor inertia of a steering motor, at the road wheel",
        "kg m²",
        "16 ms x the damping of the motor, as of the Unior's motors; with the wheel, a joint lags by 20 to 25 ms",
    )
    steering_ratio: float = _quantity(
        "steering ratio",
        "-",
        "8.2 rad of the hand wheel to each side (MKZ) over the steering limit; 1 below 100 kg, without a hand wheel",
    )
    steering_stiffness: float = _quantity(
        "steering servo",
        "N m/rad",
        "1 mrad under the scrub moment of the tyre, friction x load x the root of an eighth of the patch's diagonal "
        "squared plus the scrub radius squared; at least 10 Hz with the wheel",
    )
    steering_damping: float = _quantity(
        "steering servo", "N m s/rad", "time constant 0.02 s, one period of the controllers, as the Bolt"
    )
    handling_steering_stiffness: float = _quantity(
        "steering servo",
        "N m/rad",
        "39 per rad x wheel load x wheel radius (Bolt 5e4 N m/rad), as compliant as a real steering; at least 10 Hz "
        "with the wheel",
    )
    handling_steering_damping: float = _quantity(
        "steering servo", "N m s/rad", "time constant 0.02 s, one period of the controllers"
    )
    handling_steering_rate: float = _quantity(
        "steering rate",
        "rad/s",
        "2.5 times the rate of an automated vehicle; drivers reach 1200 deg/s at the hand wheel (FMVSS 126), the "
        "servo of AutoRally 8 rad/s",
    )
    wheel_speed_limit: float = _quantity(
        "wheel speed limit",
        "rad/s",
        "top speed of its class, by the mass: robots 2 m/s, golf carts 12, cars 45, lorries 25; at most 130 rad/s (one "
        "revolution in ten steps of 5 ms), as model cars below 5 kg",
    )
    wheel_servo_gain: float = _quantity(
        "servo of a driven wheel",
        "N m s/rad",
        "time constant 0.42 s for a car, with the root of the wheel radius (Bolt 200)",
    )
    speed_kp: float = _quantity("speed loop, kp", "-", "1, as the Bolt")
    speed_ki: float = _quantity("speed loop, ki", "1/s", "1 per s for a car, over the root of the wheel radius")
    max_correction: float = _quantity(
        "speed loop, limit of the correction", "m/s", "2 m/s for a car, with the root of the wheel radius"
    )
    max_speed: float = _quantity(
        "top speed: largest speed set-point", "m/s", "wheel speed limit times the wheel radius"
    )
    max_acceleration: float = _quantity(
        "slope of the speed set-point when accelerating",
        "m/s²",
        "3 m/s² as the Bolt, at most 0.6 of what grip and torque of the driven wheels allow, as the force overshoots",
    )
    max_deceleration: float = _quantity(
        "slope of the speed set-point when decelerating",
        "m/s²",
        "5 m/s² as the Bolt, at most 0.6 of what grip and torque of the driven wheels allow, as the force overshoots",
    )
    drag_area: float = _quantity("drag area", "m²", "0.3 x width x height; Bolt 0.825 m²")
    carrier_mass: float = _quantity("unsprung mass besides wheel and knuckle", "kg", "half a wheel, as the Bolt")
    suspension_travel: float = _quantity("wheel travel in bump and rebound", "m", "0.31 wheel radii, as the Bolt")
    front_stiffness: float = _quantity(
        "front spring", "N/m", "ride frequency 1.25 Hz with the tyre for a car, over the root of the wheel radius"
    )
    rear_stiffness: float = _quantity(
        "rear spring", "N/m", "ride frequency 1.4 Hz with the tyre for a car, over the root of the wheel radius"
    )
    front_damping: float = _quantity("front damper", "N s/m", "damping ratio 0.3")
    rear_damping: float = _quantity("rear damper", "N s/m", "damping ratio 0.3")
    front_anti_roll: float = _quantity(
        "front anti-roll bar, force over difference of travel",
        "N/m",
        "5 degrees of roll at 1 g, tyres included; 0.65 of the bars in front",
    )
    rear_anti_roll: float = _quantity(
        "rear anti-roll bar, force over difference of travel",
        "N/m",
        "5 degrees of roll at 1 g, tyres included; 0.35 of the bars at the rear",
    )
    front_load: float = _quantity("load, front", "N", "of a wheel at rest")
    rear_load: float = _quantity("load, rear", "N", "of a wheel at rest")
    front_cornering_stiffness: float = _quantity(
        "cornering stiffness, front",
        "N/rad",
        "11 x the load per rad, as tyres of cars; robots 6.5 (ORCA 6), lorries less with the root of the load above "
        "10 kN",
    )
    rear_cornering_stiffness: float = _quantity(
        "cornering stiffness, rear", "N/rad", "1.15 times the front's for its load, so that the vehicle understeers"
    )
    front_slip_stiffness: float = _quantity("longitudinal slip stiffness, front", "N", "twice the cornering stiffness")
    rear_slip_stiffness: float = _quantity("longitudinal slip stiffness, rear", "N", "twice the cornering stiffness")
    patch_half_length: float = _quantity("half length of the contact patch", "m", "0.2 wheel radii, as tyres of cars")
    assist_speed: float = _quantity(
        "antilock, traction and stability control are active above",
        "m/s",
        "2 m/s for a car, with the root of the wheel radius",
    )
    stability_gain: float = _quantity(
        "gain of the stability control",
        "N m s/rad",
        "with mass x wheel radius x root of the wheel radius; the Bolt has 2e4 N m s/rad",
    )
    stability_dead_band: float = _quantity(
        "yaw-rate error that the stability control ignores",
        "rad/s",
        "0.05 rad/s for a wheelbase of 2.6 m, over the root of the wheelbase",
    )
    stability_torque: float = _quantity(
        "brake torque of the stability control, one wheel",
        "N m",
        "0.3 of the weight x wheel radius; a car like the Bolt 1500 N m",
    )
    relaxation_x: float = _quantity("relaxation length, longitudinal", "m", "0.5 wheel radii")
    relaxation_y: float = _quantity("relaxation length, lateral", "m", "1.3 wheel radii; cars 0.3 to 0.6 m")


HOW: dict[str, str] = {item.name: item.metadata["how"] for item in fields(Estimates)}
"""Rule of estimation of each field of :class:`Estimates`, for ``sources`` in vehicle.yaml and the README."""

LABELS: dict[str, tuple[str, str]] = {
    item.name: (item.metadata["label"], item.metadata["unit"]) for item in fields(Estimates)
}
"""Name in tables and unit of each field of :class:`Estimates`."""


def estimate(
    *,
    mass: float,
    wheelbase: float,
    track: float,
    wheel_radius: float,
    wheel_width: float,
    height: float | None = None,
    length: float | None = None,
    width: float | None = None,
    drive: Drive = "rear",
    steering_limit: float = 0.6,
    front_axle_share: float | None = None,
    com_height: float | None = None,
    yaw_inertia: float | None = None,
    power: float | None = None,
    top_speed: float | None = None,
) -> Estimates:
    """Estimate all parameters of a vehicle folder from a few given ones; see :data:`HOW`.

    Args:
        mass: mass of the whole vehicle [kg].
        wheelbase: [m].
        track: distance between the contact centres of the wheels of an axle; the mean if the axles differ [m].
        wheel_radius: [m].
        wheel_width: width of the tread [m].
        height: above the road [m]; this and the next two are estimated if None.
        length: over all [m].
        width: without mirrors [m].
        drive: driven axles, which also brake when the set-point of the speed falls.
        steering_limit: steering limit of the inner wheel [rad].
        front_axle_share: share of the weight on the front axle [-]; 0.5 if None.
        com_height: centre of mass of the whole vehicle above the road [m]; this and the next ones are estimated if
            None.
        yaw_inertia: yaw inertia of the whole vehicle [kg m²].
        power: power of the powertrain [W].
        top_speed: [m/s].

    Raises:
        ConfigError: no mass distribution has the given yaw inertia.
    """
    radius = wheel_radius
    load = mass * GRAVITY / 4.0
    slow = sqrt(radius / BOLT_RADIUS)  # Froude: times of this vehicle over those of the Bolt

    # Sizes and masses, in proportion to those of reference vehicles; see HOW.
    length = max(1.65 * wheelbase, wheelbase + 2.6 * radius) if length is None else length
    width = 1.03 * (track + wheel_width) if width is None else width
    height = 4.6 * radius if height is None else height
    share = 0.5 if front_axle_share is None else front_axle_share
    com_height = min(0.37 * height, 0.45 * track) if com_height is None else com_height
    wheel_mass = min(283.0 * pi * radius**2 * wheel_width, 0.025 * mass)
    knuckle_mass = wheel_mass / 2.0
    kingpin_offset = 0.06 * radius
    # A given yaw inertia has to be met exactly, an estimated one is approximated by the box.
    wanted = yaw_coefficient(mass) * mass * wheelbase * length if yaw_inertia is None else yaw_inertia
    edges, (roll, pitch, yaw) = _inertia(
        yaw=wanted,
        given=yaw_inertia is not None,
        mass=mass,
        wheelbase=wheelbase,
        track=track,
        radius=radius,
        wheel_width=wheel_width,
        size=(length, width, height),
        com=(share * wheelbase, com_height),
        parts=(wheel_mass, knuckle_mass),
    )

    long, longest = PATCH_LENGTH
    half_patch = radius * min(long * max(sqrt(BOLT_RADIUS / radius), 1.0), longest)
    fastest = estimate_top_speed(mass, radius) if top_speed is None else top_speed
    max_torque = 0.5 * mass * GRAVITY * radius
    # Largest accelerations by grip and torque of the driven axles.
    axles = Axles(
        (1.0 - share) * wheelbase, share * wheelbase, com_height, front=drive != "rear", rear=drive != "front"
    )
    friction, torque = 0.9, max_torque / (mass * radius)
    forward, backward = (
        followed_slope(min(axles.largest(friction, 0.0, backward=end), torque)) for end in (False, True)
    )
    # The tread comes down with v a / R at the front end of the patch of the half length a.
    downward = fastest / radius * half_patch

    # Steering motor: a linear speed-torque line whose no-load speed is four times the rate.
    effort, rate = 0.8 * load * radius, 0.16 / radius
    resistance = effort / (4.0 * rate)
    # Scrub moment of a tyre that turns on the spot: the patch is as wide as the tread.
    scrub = friction * load * sqrt((wheel_width**2 + (2.0 * half_patch) ** 2) / 8.0 + kingpin_offset**2)
    # Inertia that the servo turns: wheel about the kingpin, and rotor; the least stiffness gives it 10 Hz.
    turned = _wheel_inertia(wheel_mass, radius, wheel_width) + wheel_mass * kingpin_offset**2 + 0.016 * resistance
    min_stiffness = turned * (2.0 * pi * STEERING_FREQUENCY) ** 2
    stiffness, compliant = max(scrub / STEERING_ERROR, min_stiffness), max(39.0 * load * radius, min_stiffness)
    # Cornering stiffness over load; see HOW.
    # Lorry tyres lose cornering stiffness over load with the root of the load above 10 kN.
    grip = 6.5 if mass < ROBOT_MASS else 11.0 * min(1.0, sqrt(10e3 / load))
    loads = 2.0 * share * load, 2.0 * (1.0 - share) * load
    cornering = grip * loads[0], 1.15 * grip * loads[1]
    return Estimates(
        length=length,
        width=width,
        height=height,
        ground_clearance=0.45 * radius,
        arch_half=_reach(radius, wheel_width / 2.0 + kingpin_offset, steering_limit) + 0.1 * radius,
        front_axle_share=share,
        com_height=com_height,
        wheel_mass=wheel_mass,
        knuckle_mass=knuckle_mass,
        kingpin_offset=kingpin_offset,
        inertia_edges=edges,
        yaw_inertia=yaw,
        roll_inertia=roll,
        pitch_inertia=pitch,
        tyre_dissipation=0.85 / downward,
        tyre_stiffness=load / (TYRE_COMPRESSION * radius),
        friction=friction,
        rolling_resistance=0.01,
        max_torque=max_torque,
        max_power=estimate_power(mass, radius, fastest) if power is None else power,
        brake_torque=1.5 * mass * GRAVITY * radius,
        brake_front_share=min(max(share + 0.5 * com_height / wheelbase, 0.4), 0.85),
        steering_effort=effort,
        steering_rate=rate,
        steering_motor_damping=resistance,
        steering_motor_inertia=0.016 * resistance,
        steering_ratio=8.2 / steering_limit if mass >= ROBOT_MASS else 1.0,
        steering_stiffness=stiffness,
        steering_damping=0.02 * stiffness,
        handling_steering_stiffness=compliant,
        handling_steering_damping=0.02 * compliant,
        handling_steering_rate=2.5 * rate,
        wheel_speed_limit=fastest / radius,
        wheel_servo_gain=mass * radius**2 / (4 if drive == "all" else 2) / (0.42 * slow),
        speed_kp=1.0,
        speed_ki=1.0 / slow,
        max_correction=2.0 * slow,
        max_speed=fastest,
        max_acceleration=min(3.0, forward),
        max_deceleration=min(5.0, backward),
        drag_area=0.3 * width * height,
        carrier_mass=wheel_mass / 2.0,
        suspension_travel=0.31 * radius,
        **_springs(
            bodies=(
                # Sprung mass of a corner: half of the axle's share less wheel, carrier (half a wheel) and knuckle.
                0.5 * mass * share - 1.5 * wheel_mass - knuckle_mass,
                0.5 * mass * (1.0 - share) - 1.5 * wheel_mass,
            ),
            tyre=load / (TYRE_COMPRESSION * radius),
            tipping=mass * GRAVITY * com_height,
            track=track,
            slow=slow,
        ),
        front_load=loads[0],
        rear_load=loads[1],
        front_cornering_stiffness=cornering[0],
        rear_cornering_stiffness=cornering[1],
        front_slip_stiffness=2.0 * cornering[0],
        rear_slip_stiffness=2.0 * cornering[1],
        patch_half_length=0.2 * radius,
        assist_speed=2.0 * slow,
        stability_gain=2e4 * mass * radius * slow / (1616.0 * BOLT_RADIUS),
        stability_dead_band=0.05 * sqrt(2.6 / wheelbase),
        stability_torque=0.3 * mass * GRAVITY * radius,
        relaxation_x=0.5 * radius,
        relaxation_y=1.3 * radius,
    )


def estimate_top_speed(mass: float, wheel_radius: float) -> float:
    """Return the top speed [m/s] of a vehicle of this mass [kg] and wheel radius [m]; :data:`TOP_SPEEDS`."""
    return min(_class_speed(mass, wheel_radius), WHEEL_SPEED * wheel_radius)


def estimate_power(mass: float, wheel_radius: float, top_speed: float) -> float:
    """Return the power [W] by mass [kg], wheel radius [m] and top speed [m/s]; :data:`POWER_PER_MASS`."""
    return mass * _interpolate(POWER_PER_MASS, mass) * top_speed / _class_speed(mass, wheel_radius)


def _class_speed(mass: float, wheel_radius: float) -> float:
    """Return the top speed of the class of a vehicle [m/s]."""
    return _interpolate(((MODEL_CAR_MASS, WHEEL_SPEED * wheel_radius), *TOP_SPEEDS), mass)


def _interpolate(table: Sequence[tuple[float, float]], mass: float) -> float:
    """Return the value of a table at a mass [kg]; logarithms over logarithms, constant beyond both ends."""
    masses, values = np.log(np.array(table)).T
    return float(np.exp(np.interp(log(mass), masses, values)))


def yaw_coefficient(mass: float) -> float:
    """Return yaw inertia over mass x wheelbase x length [-] of a vehicle of this mass [kg]; :data:`YAW_COEFFICIENT`."""
    # Interpolated over log(mass) between 100 and 200 kg, so that the estimate has no jump.
    robot, road = YAW_COEFFICIENT
    return robot + (road - robot) * min(max(log(mass / ROBOT_MASS) / log(2.0), 0.0), 1.0)


def estimate_steering_limit(*, mass: float, wheelbase: float, track: float, wheel_radius: float) -> float:
    """Return the steering limit of the inner wheel [rad]; :data:`TURNING_CIRCLE` and :data:`ROBOT_STEERING`."""
    if mass < ROBOT_MASS:
        return ROBOT_STEERING
    circle = TURNING_CIRCLE * wheelbase
    if circle <= least_turning_circle(wheelbase=wheelbase, track=track, wheel_radius=wheel_radius, limit=STEERING_MOST):
        return STEERING_MOST
    return steering_limit_of_circle(circle, wheelbase=wheelbase, track=track, wheel_radius=wheel_radius)


def steering_limit_of_circle(circle: float, *, wheelbase: float, track: float, wheel_radius: float) -> float:
    """Return the angle of the inner wheel [rad] at which the outer front wheel's middle runs on a circle.

    The equations of :mod:`mirdrake.controllers.ackermann` with the scrub radius of :func:`estimate`.

    Args:
        circle: its diameter [m].
        wheelbase: [m].
        track: front [m].
        wheel_radius: front [m].

    Raises:
        ConfigError: the inner wheel would have to turn by a right angle or more.
    """
    scrub = 0.06 * wheel_radius
    kingpin = track / 2.0 - scrub
    outer = circle / 2.0 - scrub  # from the turning centre to the outer kingpin
    inner = sqrt(max(outer**2 - wheelbase**2, 0.0)) - 2.0 * kingpin  # to the inner one, along the rear axle
    # The turning centre would not be outside of the inner kingpin.
    if inner <= 0.0:
        raise ConfigError(
            f"turning_circle {circle:g} m is not possible with a wheelbase of {wheelbase:g} m and a track of {track:g} "
            f"m; allowed: above {2.0 * (hypot(wheelbase, 2.0 * kingpin) + scrub):.3g} m"
        )
    return atan(wheelbase / inner)


def least_turning_circle(*, wheelbase: float, track: float, wheel_radius: float, limit: float) -> float:
    """Return the turning circle [m] at a steering limit of the inner wheel [rad]."""
    scrub = 0.06 * wheel_radius
    return 2.0 * (hypot(wheelbase, wheelbase / tan(limit) + track - 2.0 * scrub) + scrub)


def _springs(
    *, bodies: tuple[float, float], tyre: float, tipping: float, track: float, slow: float
) -> dict[str, float]:
    """Return springs, dampers and bars of both axles, all at the wheel [N/m, N s/m].

    Args:
        bodies: part of the body on a front and on a rear spring [kg].
        tyre: stiffness of a tyre [N/m].
        tipping: weight times height of the centre of mass [N m].
        track: [m].
        slow: times of this vehicle over those of the Bolt [-].
    """
    springs: dict[str, float] = {}
    for axle, body, ride in (("front", bodies[0], 1.25), ("rear", bodies[1], 1.4)):
        # The ride frequency is that of spring and tyre in series, so the spring alone is stiffer.
        with_tyre = body * (2.0 * pi * ride / slow) ** 2
        springs[f"{axle}_stiffness"] = stiffness = 1.0 / (1.0 / with_tyre - 1.0 / tyre)
        springs[f"{axle}_damping"] = 2.0 * 0.3 * sqrt(stiffness * body)
    # Roll stiffness for 5 degrees at 1 g, the weight leaning along; tyres in series; less what the springs have.
    wanted = tipping / radians(5.0) + tipping
    stiffness_of_axles = wanted / (1.0 - min(wanted / (tyre * track**2), 0.8))
    # Springs of both axles resist roll with k t² / 2 each, bars with their stiffness times t²; never less than zero.
    bars = max(stiffness_of_axles / track**2 - 0.5 * (springs["front_stiffness"] + springs["rear_stiffness"]), 0.0)
    return springs | {"front_anti_roll": 0.65 * bars, "rear_anti_roll": 0.35 * bars}


def _reach(radius: float, side: float, limit: float) -> float:
    """Return how far a wheel reaches ahead of its steering axis [m] at any angle up to the limit.

    Args:
        radius: radius of the wheel [m].
        side: distance from the steering axis to the wheel's outer face [m].
        limit: limit of the angle [rad].
    """
    # The front corner of the tyre is farthest ahead when it is straight ahead of the kingpin.
    worst = atan2(side, radius)
    return hypot(radius, side) if worst < limit else radius * cos(limit) + side * sin(limit)


def _wheel_inertia(mass: float, radius: float, width: float) -> float:
    """Return the inertia of a wheel about a vertical axis through its centre [kg m²]: of a solid cylinder."""
    return mass * (3.0 * radius**2 + width**2) / 12.0


def _inertia(
    *,
    yaw: float,
    given: bool,
    mass: float,
    wheelbase: float,
    track: float,
    radius: float,
    wheel_width: float,
    size: tuple[float, float, float],
    com: tuple[float, float],
    parts: tuple[float, float],
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the edges of the body's box [m], and roll, pitch and yaw inertia of the whole vehicle [kg m²].

    Wheels and knuckles count as points at the wheel centres, but for the yaw inertia.

    Args:
        yaw: required yaw inertia of the whole vehicle [kg m²].
        given: whether it was given, and must be met.
        mass: mass of the whole vehicle [kg].
        wheelbase: [m].
        track: [m].
        radius: radius of the wheels [m].
        wheel_width: width of their tread [m].
        size: length, width, height [m].
        com: centre of mass of the whole vehicle, ahead of the rear axle and above the road [m].
        parts: mass of a wheel and of a knuckle [kg].

    Raises:
        ConfigError: no box has the given yaw inertia.
    """
    # Body from whole vehicle: mass and centre of mass of the wheels and knuckles are subtracted.
    wheel, knuckle = parts
    front, rear = 2.0 * (wheel + knuckle), 2.0 * wheel
    body = mass - front - rear
    x, z = com
    body_x = (mass * x - front * wheelbase) / body
    body_z = (mass * z - (front + rear) * radius) / body

    # Steiner terms about the centre of mass of the vehicle; `rest` is the yaw inertia without the box itself.
    along = front * (wheelbase - x) ** 2 + rear * x**2 + body * (body_x - x) ** 2
    across = (front + rear) * track**2 / 4.0
    up = (front + rear) * (radius - z) ** 2 + body * (body_z - z) ** 2
    b, c = 0.88 * size[1], 0.75 * size[2]
    about_own = 4.0 * _wheel_inertia(wheel, radius, wheel_width) + 2.0 * knuckle * (0.3 * radius) ** 2 / 2.0
    rest = along + across + about_own
    # The box is at least as long as 0.4 of the vehicle, and so little wider that the yaw inertia is met.
    b = min(b, sqrt(max(12.0 * (yaw - rest) / body - (0.4 * size[0]) ** 2, (0.4 * b) ** 2)))
    square = 12.0 * (yaw - rest) / body - b**2
    # A given yaw inertia is accepted for boxes of 0.25 to 2 times the length of the vehicle.
    low, high = (rest + body * ((0.25 * part) ** 2 + b**2) / 12.0 for part in (size[0], 8.0 * size[0]))
    if given and not low <= yaw <= high:
        raise ConfigError(
            f"yaw_inertia {yaw:g} kg m² does not fit the mass, the axles and the length; allowed: {low:.3g} to "
            f"{high:.3g} kg m²"
        )
    a = sqrt(max(square, (0.25 * size[0]) ** 2))
    box = [body * (p**2 + q**2) / 12.0 for p, q in ((b, c), (a, c), (a, b))]
    return (a, b, c), (box[0] + across + up, box[1] + along + up, box[2] + rest)

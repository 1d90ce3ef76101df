"""What a data sheet does not say about a vehicle, estimated from what it says.

The formulas hold from a car of 1:10 (3.5 kg, wheel radius 0.05 m) to one of 5 t, because each is a number without
dimension times a power of the given mass m, wheel radius R, wheelbase L and gravity g. The numbers are those of
vehicles with published figures, above all of the Chevrolet Bolt in models/bolt (called *the Bolt*; its README names
the sources). Forces scale with m g, lengths with R or L, and times with sqrt(R / g) as in Froude's law, so that a
small car behaves like a large one seen on a slower film. Two times do not shrink: the step of the plant and the period
of the controllers; the steering servo keeps theirs.
"""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, radians, sin, sqrt

GRAVITY = 9.80665

BOLT_RADIUS = 0.3234
"""Wheel radius for which times are as measured on the Bolt [m]."""

HYDROELASTIC_COMPRESSION = (0.021, 0.055)
"""Tyre compression over wheel radius, in hydroelastic contact under a quarter of the weight: that of the Bolt, and
the most of a smaller wheel.

A step of Drake computes the patch where the wheel was; when the patch moves on by its half length sqrt(2 R d) or more
in a step, the car rides up and loses grip. Wheels smaller than the Bolt's are therefore softer, in inverse proportion
to the radius. Measured at steps of 5 ms: with R = 0.13 m and rear drive, accelerating with 3 m/s² to 9.5 m/s ends in a
spin at 0.021 and 0.035, and is followed within 1.4 % at 0.055; a circle at 4 m/s² becomes 0.15 % wider.
"""

POINT_COMPRESSION = 0.061
"""The same in point contact: tyres of cars have about 200 kN/m, the Bolt's sits 20 mm deep."""

HOW: dict[str, str] = {
    "length": "estimated: 1.65 wheelbases (Bolt 1.60, Escape 1.69, MKZ 1.73), at least 2.6 wheel radii longer than one",
    "width": "estimated: 1.03 x (track + wheel width); Bolt 1.765 m of 1.716 m",
    "height": "estimated: 4.6 wheel radii (Bolt 4.9, MKZ 4.5, Unior 4.4)",
    "ground_clearance": "estimated: 0.45 wheel radii; Bolt 0.15 m",
    "arch_half": "estimated: a tyre turned to the steering limit, and 0.1 wheel radii of air",
    "front_axle_share": "estimated: 0.5, the mean of front-driven (Bolt 0.56) and rear-driven cars",
    "com_height": "estimated: 0.37 of the height as in cars without floor battery, at most 0.45 tracks so that the car "
    "slides before it tips",
    "wheel_mass": "estimated: 283 kg per m³ of wheel cylinder (Bolt 20 kg), at most 2.5 % of the mass (Unior 2.1 %)",
    "knuckle_mass": "estimated: half a wheel, as the Bolt's (10 kg)",
    "kingpin_offset": "estimated: scrub radius of 0.06 wheel radii; Bolt 0.02 m",
    "inertia_edges": "estimated: homogeneous box of 0.88 widths and 0.75 heights (Bolt), as long as makes the yaw "
    "inertia of the whole vehicle 0.95 m a b, a and b from the centre of mass to the axles",
    "yaw_inertia": "estimated: 0.95 m a b (dynamic index of the Bolt), a and b from the centre of mass to the axles",
    "roll_inertia": "estimated: body as a homogeneous box, plus wheels and knuckles",
    "pitch_inertia": "estimated: body as a homogeneous box, plus wheels and knuckles",
    "tyre_modulus": "estimated: a wheel under a quarter of the weight is pressed in by 0.021 radii (Bolt); a smaller "
    "wheel than 0.32 m by up to 0.055 radii, so that its patch is long enough for steps of 5 ms",
    "tyre_resolution": "estimated: 0.155 wheel radii; Bolt 0.05 m",
    "tyre_dissipation": "estimated: 0.85 over the speed at which the tread meets the road at top speed, so that the "
    "patch stays whole; Bolt 0.1 s/m",
    "tyre_point_stiffness": "estimated: a wheel under a quarter of the weight is pressed in by 0.061 radii; "
    "Bolt 2e5 N/m",
    "friction": "estimated: 0.9, a car tyre on dry asphalt (Bolt 0.82 to 1.04)",
    "rolling_resistance": "estimated: 0.01, a common car tyre (Bolt 0.0073, Audibot 0.01)",
    "max_torque": "estimated: half the weight as thrust, 0.5 m g R (Bolt 0.495)",
    "max_power": "estimated: full torque up to 0.45 of the top speed, as the Bolt (93 W/kg)",
    "brake_torque": "estimated: 1.5 times the weight as braking force, so that the tyres limit the braking (Bolt 1.56)",
    "brake_front_share": "estimated: the front axle's part of the load when braking at 0.5 g",
    "steering_effort": "estimated: 0.8 x wheel load x wheel radius (Bolt 1000 N m)",
    "steering_rate": "estimated: 0.16 m/s over the wheel radius (Bolt 0.5 rad/s, F1TENTH 3.2 rad/s)",
    "steering_motor_damping": "estimated: its torque over a speed without load of four times its rate, as the Unior's "
    "motors (data sheet: 4.1)",
    "steering_motor_inertia": "estimated: 16 ms x that resistance, as the Unior's motors; with the wheel a joint lags "
    "by 20 to 25 ms",
    "steering_ratio": "estimated: hand wheel of 8.2 rad to each side (MKZ) over the steering limit; 1 below 100 kg, "
    "where there is no hand wheel",
    "steering_stiffness": "estimated: 39000 per rad x wheel load x wheel radius (Bolt 5e7 N m/rad), as good as rigid: "
    "Coulomb tyres do not slip; with tyres that do, a thousandth of it gives way as a real steering",
    "steering_damping": "estimated: time constant 0.02 s, one period of the controllers, as the Bolt",
    "wheel_speed_limit": "estimated: 130 rad/s as the Bolt (a turn in ten steps of 5 ms), at most 45 m/s",
    "wheel_servo_gain": "estimated: time constant 0.42 s for a car, with the root of the wheel radius (Bolt 200)",
    "speed_kp": "estimated: 1, as the Bolt",
    "speed_ki": "estimated: 1 per s for a car, over the root of the wheel radius",
    "max_correction": "estimated: 2 m/s for a car, with the root of the wheel radius",
    "max_acceleration": "estimated: 3 m/s², as the Bolt",
    "max_deceleration": "estimated: 5 m/s², as the Bolt",
    "drag_area": "estimated: 0.3 x width x height; Bolt 0.825 m²",
    "carrier_mass": "estimated: half a wheel, as the Bolt",
    "suspension_travel": "estimated: 0.31 wheel radii, as the Bolt",
    "front_stiffness": "estimated: ride frequency 1.25 Hz with the tyre for a car, over the root of the wheel radius",
    "rear_stiffness": "estimated: ride frequency 1.4 Hz with the tyre for a car, over the root of the wheel radius",
    "front_damping": "estimated: damping ratio 0.3",
    "rear_damping": "estimated: damping ratio 0.3",
    "front_anti_roll": "estimated: 5 degrees of roll at 1 g, tyres included; 0.65 of the bars in front",
    "rear_anti_roll": "estimated: 5 degrees of roll at 1 g, tyres included; 0.35 of the bars at the rear",
}
"""One line for each field of :class:`Estimates`: how it was found. They go into ``sources`` and README files."""


@dataclass(frozen=True)
class Estimates:
    """Estimates of what was not given; what was given is repeated. SI, vehicle frame of :mod:`mirdrake.vehicles`.

    Attributes:
        length: over all [m].
        width: without mirrors [m].
        height: above the road [m].
        ground_clearance: [m].
        arch_half: half length of a front wheel's arch [m].
        front_axle_share: part of the weight on the front axle at rest [-].
        com_height: centre of mass of the whole vehicle above the road [m].
        wheel_mass: one wheel with tyre [kg].
        knuckle_mass: one steering knuckle with hub and brake [kg].
        kingpin_offset: steering axis inside the wheel's middle plane, on the road: the scrub radius [m].
        inertia_edges: edges along x, y, z of a homogeneous box with the body's inertia [m].
        yaw_inertia: whole vehicle, about its centre of mass [kg m²].
        roll_inertia: the same about x.
        pitch_inertia: the same about y.
        tyre_modulus: hydroelastic modulus of the wheel mesh of :mod:`mirdrake.wheel_shape` [Pa].
        tyre_resolution: Drake's mesh hint [m].
        tyre_dissipation: Hunt-Crossley dissipation [s/m].
        tyre_point_stiffness: [N/m].
        friction: tyre on road [-].
        rolling_resistance: [-].
        max_torque: of the powertrain, at the driven wheels together [N m].
        max_power: of the powertrain [W].
        brake_torque: all four wheels together [N m].
        brake_front_share: part of it on the front axle [-].
        steering_effort: of one steering joint [N m].
        steering_rate: at the road wheel [rad/s].
        steering_motor_damping: resistance of one steering motor, at the road wheel [N m s/rad].
        steering_motor_inertia: of its rotor, at the road wheel [kg m²].
        steering_ratio: hand wheel to road wheel [-].
        steering_stiffness: of one steering servo [N m/rad].
        steering_damping: of one steering servo [N m s/rad].
        wheel_speed_limit: [rad/s].
        wheel_servo_gain: of one driven wheel [N m s/rad].
        speed_kp: of the speed loop [-].
        speed_ki: of the speed loop [1/s].
        max_correction: of the speed loop [m/s].
        max_acceleration: of the speed set-point [m/s²].
        max_deceleration: of the speed set-point [m/s²].
        drag_area: drag coefficient times frontal area [m²].
        carrier_mass: of what moves up and down with a wheel on springs besides wheel and knuckle [kg].
        suspension_travel: of a wheel up and down from where the vehicle stands [m].
        front_stiffness: of a front spring, at the wheel [N/m].
        rear_stiffness: the same at the rear.
        front_damping: of a front damper, at the wheel [N s/m].
        rear_damping: the same at the rear.
        front_anti_roll: force of the bar on a front wheel over the difference of travel [N/m].
        rear_anti_roll: the same at the rear.
    """

    length: float
    width: float
    height: float
    ground_clearance: float
    arch_half: float
    front_axle_share: float
    com_height: float
    wheel_mass: float
    knuckle_mass: float
    kingpin_offset: float
    inertia_edges: tuple[float, float, float]
    yaw_inertia: float
    roll_inertia: float
    pitch_inertia: float
    tyre_modulus: float
    tyre_resolution: float
    tyre_dissipation: float
    tyre_point_stiffness: float
    friction: float
    rolling_resistance: float
    max_torque: float
    max_power: float
    brake_torque: float
    brake_front_share: float
    steering_effort: float
    steering_rate: float
    steering_motor_damping: float
    steering_motor_inertia: float
    steering_ratio: float
    steering_stiffness: float
    steering_damping: float
    wheel_speed_limit: float
    wheel_servo_gain: float
    speed_kp: float
    speed_ki: float
    max_correction: float
    max_acceleration: float
    max_deceleration: float
    drag_area: float
    carrier_mass: float
    suspension_travel: float
    front_stiffness: float
    rear_stiffness: float
    front_damping: float
    rear_damping: float
    front_anti_roll: float
    rear_anti_roll: float


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
    driven_wheels: int = 2,
    steering_limit: float = 0.6,
    front_axle_share: float | None = None,
) -> Estimates:
    """Everything that a vehicle folder needs, from a few given numbers; :data:`HOW` says how.

    Args:
        mass: of the whole vehicle [kg].
        wheelbase: [m].
        track: between the contact centres of an axle's wheels; the mean if they differ [m].
        wheel_radius: [m].
        wheel_width: of the tread [m].
        height: above the road [m]; estimated if left out, as are the next two.
        length: over all [m].
        width: without mirrors [m].
        driven_wheels: 2 or 4.
        steering_limit: of the inner wheel [rad].
        front_axle_share: part of the weight on the front axle [-]; one half if left out.
    """
    radius = wheel_radius
    load = mass * GRAVITY / 4.0
    slow = sqrt(radius / BOLT_RADIUS)  # Froude: times of this vehicle over those of the Bolt
    length = max(1.65 * wheelbase, wheelbase + 2.6 * radius) if length is None else length
    width = 1.03 * (track + wheel_width) if width is None else width
    height = 4.6 * radius if height is None else height
    share = 0.5 if front_axle_share is None else front_axle_share
    com_height = min(0.37 * height, 0.45 * track)
    wheel_mass = min(283.0 * pi * radius**2 * wheel_width, 0.025 * mass)
    knuckle_mass = wheel_mass / 2.0
    kingpin_offset = 0.06 * radius
    edges, (roll, pitch, yaw) = _inertia(
        mass=mass,
        wheelbase=wheelbase,
        track=track,
        radius=radius,
        size=(length, width, height),
        com=(share * wheelbase, com_height),
        parts=(wheel_mass, knuckle_mass),
    )
    soft, softest = HYDROELASTIC_COMPRESSION
    compression = min(soft * max(BOLT_RADIUS / radius, 1.0), softest)
    wheel_speed_limit = min(130.0, 45.0 / radius)
    max_torque = 0.5 * mass * GRAVITY * radius
    # A flat strip on the wedge mesh, whose pressure is E depth / R: load = (4/3) w E d sqrt(2 R d) / R with d = c R.
    modulus = 0.75 * load / (sqrt(2.0) * compression**1.5 * wheel_width * radius)
    # The tread comes down with v a / R at the front end of the patch; a = sqrt(2 R d) is its half length.
    downward = wheel_speed_limit * radius * sqrt(2.0 * compression)
    stiffness = 39e3 * load * radius
    effort, rate = 0.8 * load * radius, 0.16 / radius
    resistance = effort / (4.0 * rate)
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
        tyre_modulus=modulus,
        tyre_resolution=0.155 * radius,
        tyre_dissipation=0.85 / downward,
        tyre_point_stiffness=load / (POINT_COMPRESSION * radius),
        friction=0.9,
        rolling_resistance=0.01,
        max_torque=max_torque,
        max_power=max_torque * 0.45 * wheel_speed_limit,
        brake_torque=1.5 * mass * GRAVITY * radius,
        brake_front_share=min(max(share + 0.5 * com_height / wheelbase, 0.4), 0.85),
        steering_effort=effort,
        steering_rate=rate,
        steering_motor_damping=resistance,
        steering_motor_inertia=0.016 * resistance,
        steering_ratio=8.2 / steering_limit if mass >= 100.0 else 1.0,
        steering_stiffness=stiffness,
        steering_damping=0.02 * stiffness,
        wheel_speed_limit=wheel_speed_limit,
        wheel_servo_gain=mass * radius**2 / driven_wheels / (0.42 * slow),
        speed_kp=1.0,
        speed_ki=1.0 / slow,
        max_correction=2.0 * slow,
        max_acceleration=3.0,
        max_deceleration=5.0,
        drag_area=0.3 * width * height,
        carrier_mass=wheel_mass / 2.0,
        suspension_travel=0.31 * radius,
        **_springs(
            bodies=(
                0.5 * mass * share - 1.5 * wheel_mass - knuckle_mass,
                0.5 * mass * (1.0 - share) - 1.5 * wheel_mass,
            ),
            tyre=load / (POINT_COMPRESSION * radius),
            tipping=mass * GRAVITY * com_height,
            track=track,
            slow=slow,
        ),
    )


def _springs(
    *, bodies: tuple[float, float], tyre: float, tipping: float, track: float, slow: float
) -> dict[str, float]:
    """Springs, dampers and bars of both axles, all at the wheel [N/m, N s/m].

    Args:
        bodies: part of the body on a front and on a rear spring [kg].
        tyre: stiffness of a tyre [N/m].
        tipping: weight times height of the centre of mass [N m].
        track: [m].
        slow: times of this vehicle over those of the Bolt [-].
    """
    found: dict[str, float] = {}
    for axle, body, ride in (("front", bodies[0], 1.25), ("rear", bodies[1], 1.4)):
        with_tyre = body * (2.0 * pi * ride / slow) ** 2
        found[f"{axle}_stiffness"] = stiffness = 1.0 / (1.0 / with_tyre - 1.0 / tyre)
        found[f"{axle}_damping"] = 2.0 * 0.3 * sqrt(stiffness * body)
    # Roll stiffness for 5 degrees at 1 g, the weight leaning along; tyres in series; less what the springs have.
    wanted = tipping / radians(5.0) + tipping
    own = wanted / (1.0 - min(wanted / (tyre * track**2), 0.8))
    bars = max(own / track**2 - 0.5 * (found["front_stiffness"] + found["rear_stiffness"]), 0.0)
    return found | {"front_anti_roll": 0.65 * bars, "rear_anti_roll": 0.35 * bars}


def _reach(radius: float, side: float, limit: float) -> float:
    """How far a wheel reaches ahead of its steering axis [m] at any angle up to the limit.

    Args:
        radius: of the wheel [m].
        side: from the steering axis to the wheel's outer face [m].
        limit: of the angle [rad].
    """
    worst = atan2(side, radius)
    return hypot(radius, side) if worst < limit else radius * cos(limit) + side * sin(limit)


def _inertia(
    *,
    mass: float,
    wheelbase: float,
    track: float,
    radius: float,
    size: tuple[float, float, float],
    com: tuple[float, float],
    parts: tuple[float, float],
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Edges of the body's box [m], and roll, pitch and yaw inertia of the whole vehicle [kg m²].

    Wheels and knuckles count as points at the wheel centres.

    Args:
        mass: of the whole vehicle [kg].
        wheelbase: [m].
        track: [m].
        radius: of the wheels [m].
        size: length, width, height [m].
        com: centre of mass of the whole vehicle, ahead of the rear axle and above the road [m].
        parts: mass of a wheel and of a knuckle [kg].
    """
    wheel, knuckle = parts
    front, rear = 2.0 * (wheel + knuckle), 2.0 * wheel
    body = mass - front - rear
    x, z = com
    body_x = (mass * x - front * wheelbase) / body
    body_z = (mass * z - (front + rear) * radius) / body
    along = front * (wheelbase - x) ** 2 + rear * x**2 + body * (body_x - x) ** 2
    across = (front + rear) * track**2 / 4.0
    up = (front + rear) * (radius - z) ** 2 + body * (body_z - z) ** 2
    b, c = 0.88 * size[1], 0.75 * size[2]
    wanted = 0.95 * mass * x * (wheelbase - x)
    a = sqrt(max(12.0 * (wanted - along - across) / body - b**2, (0.5 * size[0]) ** 2))
    box = [body * (p**2 + q**2) / 12.0 for p, q in ((b, c), (a, c), (a, b))]
    return (a, b, c), (box[0] + across + up, box[1] + along + up, box[2] + along + across)

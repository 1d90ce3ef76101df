"""Parameters of the full plant: guesses from the files of the vehicle."""

from mirdrake.identification.models.plant_context import MassProperties
from mirdrake.identification.models.steer import steering_parameters
from mirdrake.identification.parameters import Parameter
from mirdrake.vehicles import Vehicle


def plant_parameters(
    vehicle: Vehicle, steer: str, whole: MassProperties, rest: MassProperties, damping: float, friction: float | None
) -> tuple[Parameter, ...]:
    """Return the parameters of a plant.

    Args:
        vehicle: the vehicle in it.
        steer: channel of the steering.
        whole: mass properties of the vehicle.
        rest: the same without its base body.
        damping: damping of each wheel bearing [N m s/rad].
        friction: friction of the road [1]; None if it is not uniform.
    """
    name = vehicle.name
    mass, ahead, height = whole.mass, float(whole.com[0]), float(whole.com[2])
    base, turn = vehicle.geometry.wheelbase, float(whole.inertia[2, 2])
    steering = []
    for parameter in steering_parameters(steer):
        if parameter.name == "steering_lag":  # the lag of the servo is in the plant
            continue
        if parameter.name == "steering_delay":
            # A recorded hand wheel angle may contain the lag of the servo already, which the plant would add a second
            # time.
            servo, late = vehicle.control.steering, 0.5 / vehicle.control.rate
            if servo.kind == "servo" and servo.stiffness > 0.0:
                late += servo.damping / servo.stiffness
            guess = -late if steer == "steering_wheel_angle" else 0.0
            parameter = Parameter(
                parameter.name, parameter.unit, parameter.meaning, guess, -0.2, 0.5, True, 0.05, usual=2.0
            )
        steering.append(parameter)
    # Guesses are the values of the files, and bounds keep what the rest of the car requires, such as a positive body
    # mass.
    parameters = [
        Parameter("mass", "kg", "mass of the vehicle", mass, 1.05 * rest.mass, 10.0 * mass, True, source=name),
        Parameter("rear_length", "m", "centre of mass ahead of the rear axle", ahead, 0.1 * base, 0.9 * base,
                  source=name),
        Parameter("com_height", "m", "height of the centre of mass", height, 0.2 * height, 3.0 * height, source=name),
        Parameter("yaw_inertia", "kg m^2", "about the centre of mass", turn, 0.4 * turn, 4.0 * turn, True, source=name),
        Parameter("wheel_damping", "N m s/rad", "damping of each wheel bearing", damping, 0.0, 100.0, scale=1.0,
                  usual=5.0, source=name),
        Parameter("accelerometer_ahead", "m", "ahead of the file's centre of mass", 0.0, -10.0, 10.0, scale=0.5),
        Parameter("velocity_ahead", "m", "measured vy ahead of the file's centre of mass", 0.0, -10.0, 10.0, scale=0.5),
        Parameter("accelerometer_tilt", "1", "1: it rolls with the body, 0: it is levelled", 0.0, -1.0, 2.0, scale=0.3),
        *steering,
    ]  # fmt: skip
    # Friction and rolling resistance exist in the plant only with contact or with a tyre law.
    if friction is not None:
        parameters.append(
            Parameter("friction", "1", "friction of the road", friction, 0.05, 1.8 * friction, source="world")
        )
    if vehicle.spec.tyres.has_slip:
        rolling = vehicle.spec.tyres.rolling_resistance
        parameters.append(
            Parameter("rolling_resistance", "1", "of the tyres", rolling, 0.0, 0.2, scale=0.005, usual=5.0, source=name)
        )
    return tuple(parameters)

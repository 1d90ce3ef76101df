"""README.md of an imported vehicle: dimensions with their origin, all changes, and what the user should check."""

from collections.abc import Iterable

import numpy as np

from mirdrake.importing.changes import TABLE_HEAD, Code, rows_by_file, table_cell
from mirdrake.importing.places import Places
from mirdrake.importing.vehicles.car import Car
from mirdrake.importing.vehicles.limits import STEERING_LIMIT
from mirdrake.importing.vehicles.masses import NO_MASS
from mirdrake.importing.vehicles.model import SourceModel
from mirdrake.importing.vehicles.recognise import BOTH_STEERED
from mirdrake.vehicles.estimates import HOW, LABELS

Row = tuple[str, str, str, str]
_ROWS = (
    ("steering_limit", "steering limit of the inner wheel", "rad"),
    ("steering_rate", "steering rate at the road wheel", "rad/s"),
    ("steering_effort", "steering torque at a wheel", "N m"),
    ("steering_ratio", "steering ratio, hand wheel to road wheel", "-"),
    ("max_torque", "drive torque, all driven wheels", "N m"),
    ("max_power", "drive power", "W"),
    ("wheel_speed_limit", "speed limit of the wheels", "rad/s"),
    ("brake_torque", "brake torque, all wheels", "N m"),
    ("brake_front_share", "share of the front axle", "-"),
    ("rolling_resistance", "rolling resistance", "-"),
    ("drag_area", "drag area", "m²"),
    ("front_friction", "friction of the front tyres", "-"),
    ("rear_friction", "friction of the rear tyres", "-"),
    ("front_tyre_stiffness", "stiffness of the front tyres", "N/m"),
    ("rear_tyre_stiffness", "stiffness of the rear tyres", "N/m"),
    ("tyre_dissipation", "dissipation of the tyres", "s/m"),
)
_CONTROL = ("wheel_servo_gain", "steering_stiffness", "steering_damping", "speed_kp", "speed_ki", "max_correction",
            "max_acceleration", "max_deceleration")  # fmt: skip


def readme_words(car: Car, model: SourceModel, places: Places) -> dict[str, object]:
    """Return the variables of the README template besides the car."""
    mass = car.total_mass()
    driven = "All-wheel-driven" if car.drive == "all" else f"{car.drive.capitalize()}-driven"
    wheelbase = car.layout.wheelbase
    return {
        "summary": f"{driven} vehicle of {mass:.5g} kg with a wheelbase of {wheelbase:.4g} m.",
        "files": [places.file(path) for path in model.files],
        "author": " ".join(model.texts.get("author", "").split()),
        "tables": _tables(car, mass),
        "change_head": "\n".join(TABLE_HEAD),
        "changes": [(file, [row.text for row in rows]) for file, rows in rows_by_file(car.changes)],
        "check_title": "## Please check by hand",
        "to_check": [
            *car.warnings,
            "Geometry: `mirdrake view` shows visuals, collision shapes and frames.",
            *assumptions(car),
            *_estimates(car),
        ],
    }


def _tables(car: Car, mass: float) -> list[tuple[str, list[Row]]]:
    layout = car.layout
    com = car.centre_of_mass(layout)
    measured = "imported: measured on links and joints"
    wheels = (car.wheels["front_left"].mass, car.wheels["rear_left"].mass)
    # The masses of links are as in the source unless a repair changed one.
    repaired = any(change.code in (Code.MASS, Code.INERTIA) for change in car.changes)
    masses = "imported" + (": see the changes below" if repaired else ": sum of the links")
    dimensions: list[Row] = [
        ("wheelbase", _n(layout.wheelbase), "m", measured),
        ("track, front and rear", f"{_n(layout.tracks[0])}, {_n(layout.tracks[1])}", "m", measured),
        ("distance of the steering axes", _n(layout.kingpin_track), "m", measured),
        ("trail: steering axes ahead of the wheel centres", _n(layout.trail), "m", measured),
        ("wheel radius, front and rear", f"{_n(layout.radii[0])}, {_n(layout.radii[1])}", "m", measured),
        ("wheel width, front and rear", f"{_n(layout.widths[0])}, {_n(layout.widths[1])}", "m", measured),
        ("mass of the car", _n(mass), "kg", masses),
        ("body, knuckle", f"{_n(car.body.mass.mass)}, {_n(car.knuckles[0].mass.mass)}", "kg", masses),
        ("wheel, front and rear", f"{_n(wheels[0].mass)}, {_n(wheels[1].mass)}", "kg", masses),
        ("centre of mass", " ".join(_n(value) for value in com), "m", masses),
        ("inertia of the body", " ".join(_n(value) for value in np.diag(car.body.mass.inertia)), "kg m²", masses),
    ]
    # Every number has its source beside it, so that the reader sees which ones are estimates.
    numbers = [(label, _n(car.numbers[key].value), unit, car.numbers[key].source) for key, label, unit in _ROWS]
    control = [(LABELS[key][0], _n(getattr(car.estimates, key)), LABELS[key][1], HOW[key]) for key in _CONTROL]
    tables = [("Dimensions and masses", dimensions), ("Limits and contact", numbers), ("Control", control)]
    return [(title, [tuple(map(table_cell, row)) for row in rows]) for title, rows in tables]  # type: ignore[misc]


def assumptions(car: Car) -> Iterable[str]:
    """Yield what was assumed and changes how the vehicle drives, for README.md and the terminal."""
    codes = {change.code for change in car.changes}
    if not car.drive_source:
        yield "Driven axle: not stated in the source, rear is assumed; `drive` in vehicle.yaml."
    if Code.DIRECTION in codes:
        yield "Direction of travel: the steered axle is assumed to be the front."
    if car.numbers["steering_limit"].source.startswith("estimated"):
        yield f"Steering limit: none in the source that can be used, ±{STEERING_LIMIT:g} rad is assumed."
    speed = car.numbers["wheel_speed_limit"]
    if speed.source.startswith("estimated"):
        top = speed.value * car.layout.radii[1]
        yield f"Top speed: not in the source, {top:.3g} m/s is assumed for a vehicle of this mass."
    if any(change.reason == BOTH_STEERED for change in car.changes):
        yield "Rear axle: steered in the source, fixed here; `steering.rear` in vehicle.yaml steers it."
    body = [change for change in car.changes if change.part == f"link '{car.body.name}': mass"]
    if any(change.reason == NO_MASS for change in body):
        yield f"Mass of the body: {body[0].old} in the source, {car.body.mass.mass:.4g} kg is estimated."
    if codes & {Code.MASS, Code.INERTIA}:
        yield "Masses, inertias and centre of mass: some were replaced; see the table of changes."
    if car.springs is not None:
        yield "Ride height: at rest the springs are at their zero position; `suspension` in vehicle.yaml."
    if Code.SUSPENSION_FIXED in codes:
        yield "Ride height: the suspension is fixed at its zero position."


def _estimates(car: Car) -> Iterable[str]:
    estimated = sum(number.source.startswith("estimated") for number in car.numbers.values())
    count = f"{estimated} of {len(car.numbers)} limits and contact numbers, and all gains"
    yield f"{count}, are estimates; replace those that you know."
    if not car.licence:
        yield "Licence: none was found."


def _n(value: float) -> str:
    return f"{float(value) + 0.0:.5g}" if abs(value) > 1e-12 else "0"

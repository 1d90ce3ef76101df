"""Vehicle folders from a few dimensions, complete and ready to drive.

Quantities that are not given are estimated (:mod:`mirdrake.vehicles.estimates`). README.md of the folder and
``sources`` in its vehicle.yaml state the origin of each number. The files are made from the templates beside this
module.
"""

import json
import os
import re
from dataclasses import dataclass
from math import atan, ceil, hypot, inf, pi, radians, sqrt, tan
from pathlib import Path
from typing import Any

import jinja2

from mirdrake.core.errors import ConfigError
from mirdrake.core.files import staging
from mirdrake.core.paths import search_folders
from mirdrake.core.yaml_io import display_path
from mirdrake.vehicles.bodywork import write_car
from mirdrake.vehicles.bodywork.sizes import BodySize
from mirdrake.vehicles.estimates import least_turning_circle
from mirdrake.vehicles.questions import ask
from mirdrake.vehicles.vehicle import load_vehicle
from mirdrake.vehicles.vehicle_plan import TABLES, Plan, plan_vehicle, rounded

__all__ = ["ask", "check_name", "new_vehicle", "plan_vehicle", "vehicle_place", "write_diagram", "write_visuals"]

TEMPLATES = Path(__file__).resolve().parent / "templates"

SKIDPAD_RADIUS = 9.125
"""Radius of the centre line of worlds/skidpad.yaml [m]."""

SKIDPAD_WIDTH = 3.0
"""Width of its track [m]."""


def new_vehicle(
    name: str, *, title: str | None = None, folder: Path | str | None = None, force: bool = False, **quantities: Any
) -> Path:
    """Write a vehicle folder that is ready to drive.

    Args:
        name: name of folder and model: letters, digits, underscores.
        title: make and model for titles; derived from the name if None.
        folder: parent folder of the vehicle folder; ``models`` in the working directory if None.
        force: replace an existing vehicle of that name.
        quantities: arguments of :func:`plan_vehicle`; `wheelbase` and `mass` are required, others are estimated.

    Returns:
        The vehicle folder.

    Raises:
        ConfigError: the name, a quantity, or the target is not allowed; nothing is written then.
    """
    check_name(name)
    return write_vehicle(name, plan_vehicle(**quantities), title=title, folder=folder, force=force)


def write_vehicle(
    name: str, plan: Plan, *, title: str | None = None, folder: Path | str | None = None, force: bool = False
) -> Path:
    """Write the folder of a planned vehicle; see :func:`new_vehicle`."""
    check_name(name)
    target = vehicle_place(name, folder=folder, force=force)
    # The folder is published only when the vehicle and its variants load, so a failure leaves nothing behind.
    with staging(target.parent) as stage:
        building = stage.path / target.name
        building.mkdir()
        _write_files(building, name, title or name.replace("_", " ").capitalize(), plan)
        load_vehicle(str(building))
        for variant in ("springs", "handling"):
            load_vehicle(f"{building}@{variant}")
        stage.publish()
    return target


def check_name(name: str) -> None:
    """Check that a name can be used for a folder, a robot and a package.

    Raises:
        ConfigError: the name is not allowed.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,63}", name):
        raise ConfigError(
            f"name '{name[:80]}' is not allowed; allowed: a letter, then letters, digits and _, at most 64 characters"
        )


def vehicle_place(name: str, *, folder: Path | str | None = None, force: bool = False) -> Path:
    """Return the folder of a new vehicle.

    Raises:
        ConfigError: a file or folder exists there that may not be replaced.
    """
    target = Path(folder or "models") / name
    if target.is_symlink() or target.exists():
        if not force:
            raise ConfigError(
                f"{display_path(target)} exists already; choose another name, or use --force to replace it"
            )
        # Even --force never removes a folder that is not a vehicle, nor follows a link.
        if target.is_symlink() or not (target / "vehicle.yaml").is_file():
            raise ConfigError(
                f"{display_path(target)} is not a vehicle folder and is not replaced; choose another name"
            )
    return target


def write_diagram(vehicle: Path, *, folder: Path | str, force: bool = False) -> tuple[Path, bool]:
    """Write a diagram file in which the vehicle drives circles: on the skidpad, or on a plane if it is too large.

    Args:
        vehicle: folder of the vehicle.
        folder: folder of the diagram file.
        force: replace an existing file.

    Returns:
        The file, and whether it was written; an existing file is kept.
    """
    loaded = load_vehicle(str(vehicle))
    geometry, name = loaded.geometry, vehicle.name
    # A vehicle on the search path is written by name, any other one by a path relative to the diagram file.
    known = any(parent == vehicle.resolve().parent for parent in search_folders("models"))
    model = name if known else os.path.relpath(vehicle.resolve(), Path(folder).resolve())
    # The skidpad needs a circle with a margin of 20 % to full lock, and the outer front wheel within the track.
    tightest = geometry.wheelbase / tan(geometry.steering_limit) + geometry.kingpin_track / 2.0
    side = (geometry.front_track + geometry.front_wheel_width) / 2.0
    sweep = hypot(SKIDPAD_RADIUS + side, geometry.wheelbase) - SKIDPAD_RADIUS  # of the outer front wheel
    fits = 1.2 * tightest < SKIDPAD_RADIUS and sweep < SKIDPAD_WIDTH / 2.0
    radius = SKIDPAD_RADIUS if fits else 1.5 * tightest
    # Lateral acceleration of 0.4 g as in the diagram of the Bolt, at most 40 wheel radii per second.
    speed = min(sqrt(3.9 * radius), 40.0 * geometry.rear_wheel_radius)
    # 80 % of the largest set-point leave a reserve to the speed loop.
    speed = float(f"{min(speed, 0.8 * (loaded.control.speed.max_speed or inf)):.2g}")
    duration = ceil(2.0 * 2.0 * pi * radius / speed + 2.0 * speed)  # two laps, and time to accelerate
    file = Path(folder) / f"{name}_{'skidpad' if fits else 'circle'}.yaml"
    if file.exists() and not force:
        return file, False
    text = _templates().get_template("diagram.yaml.jinja")
    file.parent.mkdir(parents=True, exist_ok=True)
    content = text.render(
        model=model,
        title=loaded.spec.name,
        fits=fits,
        radius=f"{radius:.4g}",
        speed=f"{speed:g}",
        duration=duration,
        steering=f"{rounded(atan(geometry.wheelbase / radius))}",
        sensors=", ".join(loaded.sensors.mounts),
    )
    file.write_text(content, encoding="utf-8")
    return file, True


# --- the parts ---------------------------------------------------------------------------------------------------


def _templates() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # YAML, XML with numbers and checked names, Markdown
    )
    environment.filters["quoted"] = lambda text: json.dumps(text, ensure_ascii=False)
    return environment


def _write_files(folder: Path, name: str, title: str, plan: Plan) -> None:
    """Write all files of a vehicle folder."""
    values = plan.values
    # The tables of the README state the source of each number.
    rows = []
    for heading, file, entries in TABLES:
        rows.append(
            (
                heading,
                file,
                [
                    {"label": label, "value": _cell(values[key]), "unit": unit, "source": plan.sources[key]}
                    for key, label, unit in entries
                ],
            )
        )
    driven = "All-wheel-driven" if plan.drive == "all" else f"{plan.drive.capitalize()}-driven"
    # Everything the templates name; StrictUndefined makes a missing word an error.
    words = {
        **values,
        "name": name,
        "title": " ".join(title.split()),
        "drive": plan.drive,
        "body": plan.body,
        "sources": plan.sources,
        "tables": rows,
        "robot": plan.body == "robot",
        "mounts": place_sensors(plan),
        "mast_radius": rounded(0.012 * values["height"]),
        "other_rear": any(values[key] != values[f"rear_{key}"] for key in ("wheel_radius", "wheel_width")),
        # Each axle has its own tyre, because stiffnesses are proportional to the load.
        "axles": {
            axle: {key: values[f"{axle}_{key}"] for key in ("load", "slip_stiffness", "cornering_stiffness")}
            for axle in ("front", "rear")
        },
        "camera_near": rounded(min(0.3 * values["wheel_radius"], 0.1)),
        "turning_circle": rounded(
            least_turning_circle(
                limit=values["steering_limit"], **{key: values[key] for key in ("wheelbase", "track", "wheel_radius")}
            )
        ),
        "given_count": plan.given_count(),
        "summary": f"{driven} vehicle of {values['mass']:g} kg with a wheelbase of {values['wheelbase']:g} m.",
    }
    # The tree of templates is the tree of the folder.
    environment = _templates()
    for template in sorted((TEMPLATES / "vehicle").rglob("*.jinja")):
        relative = template.relative_to(TEMPLATES / "vehicle")
        text = environment.get_template(f"vehicle/{relative.as_posix()}").render(words)
        (folder / relative.parent).mkdir(exist_ok=True)
        (folder / relative.with_suffix("")).write_text(text, encoding="utf-8")
    write_visuals(folder, plan)


@dataclass(frozen=True)
class PlacedSensor:
    """A sensor of a new vehicle.

    Attributes:
        sensor: word for it, of :data:`mirdrake.vehicles.questions.SENSORS`.
        name: name of the mount.
        preset: preset of the mount.
        x: position in base_link [m].
        z: the same.
        mast: heights of its lower and upper end [m]; None without a mast.
    """

    sensor: str
    name: str
    preset: str
    x: float
    z: float
    mast: tuple[float, float] | None


def place_sensors(plan: Plan) -> list[PlacedSensor]:
    """Return the sensors of a new vehicle, outside of the collision boxes.

    Cameras and lidars look over the body. The mast of a lidar with several planes is so high that its lowest beam, 15
    degrees below the horizon, clears the ends of the roof. The mast ends a hundredth of the vehicle height below the
    sensor, so that no beam hits it.

    Args:
        plan: the vehicle.
    """
    values, robot = plan.values, plan.body == "robot"
    wheelbase, height, radius = values["wheelbase"], values["height"], values["wheel_radius"]
    front = (wheelbase + values["length"]) / 2.0
    # Positions in base_link: origin on the road below the rear axle, x ahead.
    com = values["front_axle_share"] * wheelbase
    roof = (front - values["length"], 0.92 * wheelbase)  # as in contact.xacro
    half_roof = (roof[1] - roof[0]) / 2.0
    # Velodyne: 15 degrees below the horizon and 1 degree of margin over half of the roof.
    over = height + (0.06 * height if robot else max(0.05, tan(radians(16.0)) * half_roof))
    bumper = 1.2 * radius if robot else 0.35 * height
    known = {
        "camera": ("front_camera", "bolt_camera", (0.7 * wheelbase, 1.03 * height), height),
        "depth_camera": ("depth_camera", "kinect_v1", (0.8 * wheelbase, 1.03 * height), height),
        "lidar": ("lidar", "hokuyo_utm_30lx" if robot else "velodyne_vlp16", (sum(roof) / 2.0, over), height),
        "gps": ("gps", "consumer_gps", (com, height), None),
        "imu": ("imu", "automotive_imu", (com, values["com_height"]), None),
        "sonar": ("sonar", "parking_sonar", (front + 0.01 * height, bumper), None),
    }
    mounts = []
    for sensor in plan.sensors:
        name, preset, (x, z), foot = known[sensor]
        mast = None if foot is None else (foot, z - 0.01 * height)
        mounts.append(PlacedSensor(sensor, name, preset, rounded(x), rounded(z), mast))
    return mounts


def _cell(value: Any) -> str:
    return " x ".join(f"{part:g}" for part in value) if isinstance(value, tuple) else f"{value:.10g}"


def write_visuals(folder: Path, plan: Plan) -> None:
    """Write meshes/body.gltf and meshes/wheel.gltf, in the frames of base_link and of a wheel."""
    values = plan.values
    names = ("wheelbase", "length", "width", "height", "wheel_radius", "wheel_width", "ground_clearance")
    # Front overhang: half of what the length exceeds the wheelbase by, but never zero.
    overhang = max((values["length"] - values["wheelbase"]) / 2.0, 0.02 * values["wheelbase"])
    track = max(values["track"], values["track_rear"])
    size = BodySize(track=track, front_overhang=overhang, **{name: values[name] for name in names})
    write_car(folder, style=plan.body, size=size)

"""Write a car as a vehicle folder."""

import json
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import jinja2
import numpy as np
import yaml
from pydrake.math import RigidTransform, RollPitchYaw

from mirdrake.importing.changes import Changes
from mirdrake.importing.meshes.convex import CUT_TIME
from mirdrake.importing.places import Places
from mirdrake.importing.shape import Shape
from mirdrake.importing.vehicles.car import Car, Mass, Part
from mirdrake.importing.vehicles.model import SourceModel
from mirdrake.importing.vehicles.report import readme_words
from mirdrake.importing.vehicles.shapes import convert_shapes

TEMPLATES = Path(__file__).resolve().parent / "templates"

FILES = ("main.urdf.xacro", "properties.xacro", "contact.xacro", "structure.xacro", "sensors.xacro", "vehicle.yaml",
         "control.yaml", "README.md")  # fmt: skip


def write_car(car: Car, model: SourceModel, folder: Path, *, places: Places, convex_time: float = CUT_TIME) -> None:
    """Write everything below an empty folder.

    Args:
        car: repaired; its shapes become those of the files, and its changes get those of the shapes.
        model: source of the vehicle.
        folder: exists.
        places: short names of files of the source.
        convex_time: time limit for cutting collision meshes into convex parts [s].
    """
    # Shapes first: the templates name their files, and the README lists their changes.
    car.changes += convert_shapes(car, folder, convex_time=convex_time)
    car.changes = Changes(dict.fromkeys(map(places.change, car.changes)))
    car.warnings = list(map(places.text, car.warnings))
    # StrictUndefined: a template with a misspelt name fails here instead of writing an incomplete vehicle.
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # numbers, checked names, and texts that are quoted one by one
    )
    environment.filters["n"] = digits
    environment.filters["quoted"] = lambda text: json.dumps(text, ensure_ascii=False)
    words = {
        "car": car,
        "layout": car.layout,
        "numbers": car.numbers,
        "estimates": car.estimates,
        "front": car.wheels["front_left"].mass,
        "rear": car.wheels["rear_left"].mass,
        "knuckle": car.knuckles[0].mass,
        "moments": _moments,
        "visuals": _visuals,
        "geometry": _geometry,
        "place": _place,
        **readme_words(car, model, places),
    }
    # All files are rendered from the same words, so that a number cannot differ between them.
    for name in FILES:
        text = environment.get_template(f"{name}.jinja").render(words)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "sensors.yaml").write_text(_yaml({"mounts": car.mounts}), encoding="utf-8")
    if car.variant is not None:
        (folder / "variants").mkdir()
        (folder / "variants" / "imported.yaml").write_text(_yaml(car.variant), encoding="utf-8")


def digits(value: float) -> str:
    """Return a number as text with six significant digits."""
    # Adding 0.0 turns -0.0 into 0.0.
    return f"{float(value) + 0.0:.6g}"


def _yaml(data: object) -> str:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=110)


def _moments(mass: Mass) -> Iterator[tuple[str, float]]:
    for key in ("xx", "yy", "zz", "xy", "xz", "yz"):
        row, column = ("xyz".index(letter) for letter in key)
        value = float(mass.inertia[row, column])
        # Products of inertia that are only rounding are written as zero.
        yield f"i{key}", value if abs(value) > 1e-8 * mass.inertia.max() else 0.0


# --- XML ---------------------------------------------------------------------------------------------------------


def _place(X: RigidTransform) -> str:
    """Return the attributes xyz and rpy of a pose, rounded to 1e-6."""
    angles = RollPitchYaw(X.rotation()).vector()
    xyz, rpy = (np.where(np.abs(values) < 1e-6, 0.0, values) for values in (X.translation(), angles))
    return f'xyz="{" ".join(map(digits, xyz))}" rpy="{" ".join(map(digits, rpy))}"'


def _visuals(part: Part) -> Iterator[str]:
    """Yield the visual elements of a part, a line each."""
    for number, shape in enumerate(part.visuals, start=1):
        colour = ""
        if shape.rgba is not None:
            values = [min(max(float(value), 0.0), 1.0) for value in shape.rgba]
            name = "rgba_" + "_".join(f"{value:.3g}" for value in values)
            colour = f'<material name="{name}"><color rgba="{" ".join(map(digits, values))}"/></material>'
        name = f"{part.name}_{number}"
        inside = f"<origin {_place(shape.X_LG)}/><geometry>{_geometry(shape)}</geometry>{colour}"
        yield f'<visual name="{name}">{inside}</visual>'


def _geometry(shape: Shape) -> str:
    """Return the element of a shape."""
    size = [digits(value) for value in shape.size]
    if shape.kind == "mesh":
        scale = "" if tuple(shape.scale) == (1.0, 1.0, 1.0) else f' scale="{" ".join(map(digits, shape.scale))}"'
        return f"<mesh filename={quoteattr(shape.address)}{scale}/>"
    if shape.kind == "box":
        return f'<box size="{" ".join(size)}"/>'
    if shape.kind == "sphere":
        return f'<sphere radius="{size[0]}"/>'
    # Ellipsoids and capsules are Drake's extensions of URDF.
    if shape.kind == "ellipsoid":
        return f'<drake:ellipsoid a="{size[0]}" b="{size[1]}" c="{size[2]}"/>'
    prefix = "drake:" if shape.kind == "capsule" else ""
    return f'<{prefix}{shape.kind} radius="{size[0]}" length="{size[1]}"/>'

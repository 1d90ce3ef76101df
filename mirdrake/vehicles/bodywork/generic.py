"""A car of no maker in any size: :func:`write_car`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mirdrake.core.errors import ModelError
from mirdrake.vehicles.bodywork.boxes import BOX_STYLES, build_boxes
from mirdrake.vehicles.bodywork.car import CarOutline, Warp, arch_clearance, build_body, write_meshes
from mirdrake.vehicles.bodywork.curves import Array
from mirdrake.vehicles.bodywork.gltf import Material
from mirdrake.vehicles.bodywork.shell import half_shell
from mirdrake.vehicles.bodywork.styles import STYLES, Style
from mirdrake.vehicles.bodywork.wheels import WheelDesign, build_wheel

STEERING = 0.65  # the largest angle of a front wheel the wheel openings leave room for [rad]
_LENGTH = 4.2  # cars are built in this length and enlarged at the end, so that small ones are as fine as large ones [m]
_COLOURS = {
    "hatchback": Material((0.86, 0.30, 0.08), 0.36, 0.1),
    "sedan": Material((0.38, 0.42, 0.47), 0.32, 0.25),
    "suv": Material((0.13, 0.36, 0.26), 0.36, 0.15),
    "van": Material((0.86, 0.87, 0.88), 0.4, 0.05),
    "truck": Material((0.10, 0.27, 0.55), 0.4, 0.05),
    "robot": Material((0.92, 0.62, 0.05), 0.4, 0.05),
}


def write_car(
    folder: Path, *, style: str, wheelbase: float, track: float, length: float, width: float, height: float,
    wheel_radius: float, wheel_width: float, ground_clearance: float, front_overhang: float,
) -> None:  # fmt: skip
    """Write ``meshes/body.gltf`` and ``meshes/wheel.gltf`` (each with a ``.bin``) of a car of no maker.

    The body's bounds are the sizes asked for, except that door mirrors stand out of the width, and that it reaches from
    ``ground_clearance`` up. Wheel openings leave room for wheels that steer by 0.65 rad, as far as the body is high
    enough for that.

    Args:
        folder: the vehicle's folder.
        style: hatchback, sedan, suv, or one of :data:`mirdrake.vehicles.bodywork.boxes.BOX_STYLES`.
        wheelbase: distance of the axles [m].
        track: distance of the wheels' middle planes [m]; of the wider axle, if they differ.
        length: of the body [m].
        width: of the body without mirrors [m].
        height: of the body above the road [m].
        wheel_radius: radius of the tyres [m].
        wheel_width: width of the tyres [m].
        ground_clearance: height of the body's underside [m].
        front_overhang: from the front axle to the front end [m].

    Raises:
        ModelError: there is no such style, or the sizes make no car.
    """
    sizes = {
        "wheelbase": wheelbase, "track": track, "length": length, "width": width, "height": height,
        "wheel_radius": wheel_radius, "wheel_width": wheel_width, "ground_clearance": ground_clearance,
        "front_overhang": front_overhang,
    }  # fmt: skip
    if style not in (*STYLES, *BOX_STYLES):
        raise ModelError(f"no body style {style!r}; the styles are {', '.join((*STYLES, *BOX_STYLES))}")
    for name, value in sizes.items():
        if not (np.isfinite(value) and value > 0):
            raise ModelError(f"a body with {name} {value:g} m: it must be positive")
    if front_overhang >= length - 0.5 * wheelbase or ground_clearance >= 0.8 * height:
        what = (
            f"length {length:g}, front_overhang {front_overhang:g}, height {height:g}, clearance {ground_clearance:g}"
        )
        raise ModelError(f"a body with {what} m leaves no room for a car; measure them again")
    scale = length / _LENGTH
    sizes = {name: value / scale for name, value in sizes.items()}
    if style in BOX_STYLES:
        meshes = {"wheel": build_wheel(_wheel(sizes, style)), "body": build_boxes(style, sizes, steering=STEERING)}
    else:
        drawn = STYLES[style]()
        shell = half_shell(drawn.skin)
        car = fit(drawn, sizes, points=shell[0])
        meshes = {"wheel": build_wheel(car.wheel), "body": build_body(car, shell=shell)}
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    materials = {"paint": _COLOURS[style]}
    write_meshes(folder / "meshes", meshes, materials=materials, generator="mirdrake", scale=scale)


def fit(style: Style, sizes: dict[str, float], *, points: Array) -> CarOutline:
    """Return a style's car in the sizes of :func:`write_car`; ``points`` (n, 3) are those of its skin."""
    wheel = WheelDesign(
        sizes["wheel_radius"], sizes["wheel_width"], style.profile * sizes["wheel_radius"], rim=style.rim
    )
    length, height, clearance = sizes["length"], sizes["height"], sizes["ground_clearance"]
    reach, inwards = arch_clearance(wheel, STEERING)
    front = sizes["wheelbase"] + sizes["front_overhang"]
    low, high = points.min(axis=0), points.max(axis=0)
    top = max([high[2], *(float(p.mesh.corners()[:, 2].max()) + p.at[2] for p in style.parts if p.on is None)])
    # The wings must be above the wheel openings; the proportions give way where the wheels are large.
    tall = (height - clearance) / (top - low[2])
    wing = clearance + (style.shoulder - low[2]) * tall
    room = clearance + 0.78 * (height - clearance)
    arch_radius = max(
        min(max(reach + 0.06 * wheel.radius, 1.10 * wheel.radius), room - wheel.radius - 0.02), 1.02 * wheel.radius
    )
    wing = min(max(wing, wheel.radius + arch_radius + 0.06), max(room, wing))
    warp = Warp(
        x=((low[0], front - length), (0.0, 0.0), (style.wheelbase, sizes["wheelbase"]), (high[0], front)),
        y=((0.0, 0.0), (high[1], sizes["width"] / 2)),
        z=((low[2], clearance), (style.shoulder, wing), (top, height)),
    )
    inner = max(sizes["track"] / 2 - inwards - 0.03, 0.12 * sizes["width"])
    return CarOutline(
        form=style.form, wheelbase=sizes["wheelbase"], wheel=wheel, arch_radius=arch_radius, arch_inner=inner,
        regions=style.regions, parts=style.parts, warp=warp,
    )  # fmt: skip


def _wheel(sizes: dict[str, float], style: str) -> WheelDesign:
    """Wheel of a body of boxes: with cleats for a robot."""
    radius, width = sizes["wheel_radius"], sizes["wheel_width"]
    return WheelDesign(
        radius, width, (0.55 if style == "robot" else 0.64) * radius, blocks=14 if style == "robot" else 0
    )

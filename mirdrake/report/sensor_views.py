"""The sensors of a run: what each of them recorded, and pictures and scans at one moment of the drive.

A scan is drawn from above in the frame of the vehicle, x up and y to the left. Returns from the road are grey.
"""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image
from pydrake.math import RollPitchYaw

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.recording.arrays import Samples
from mirdrake.report.inspection_text import describe_view
from mirdrake.report.words import format_time
from mirdrake.runs.logs import Run
from mirdrake.vehicles import Vehicle
from mirdrake.vehicles.figures import SensorFigures
from mirdrake.vehicles.inspection import find_sensors
from mirdrake.vehicles.mount import Mount
from mirdrake.vehicles.outline import measure_outline
from mirdrake.viewer.pages import data_address

Array = NDArray[np.float64]

_MOST_VIEWS = 4  # of a vehicle
_WIDTH = 480  # of a picture [px]
_SIZE = 320.0  # width of a scan [px]
_CELL = 1.6  # returns in one cell are drawn as one dot [px]
_ROAD = 0.2  # returns below this height above the road are those of the road [m]
_STEPS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # distances of the circles [m]


@dataclass(frozen=True)
class SensorRow:
    """A sensor of a run as texts.

    Attributes:
        name: name in the vehicle.
        kind: kind of the sensor.
        preset: product of which the mount has the values; empty without one.
        place: position in the frame of the vehicle [m].
        rate: samples per second, and the latency if there is one.
        view: field of view and range.
        recorded: number and kind of the samples, and their file.
    """

    name: str
    kind: str
    preset: str
    place: str
    rate: str
    view: str
    recorded: str


@dataclass(frozen=True)
class SensorView:
    """Picture of a camera, as an address, or scan from above, as a drawing; with its caption."""

    caption: str
    address: str = ""
    drawing: Markup | None = None


@dataclass(frozen=True)
class SensorsOfVehicle:
    """The sensors of one vehicle.

    Attributes:
        vehicle: its name.
        rows: one for each sensor that the diagram uses.
        views: pictures and scans.
    """

    vehicle: str
    rows: list[SensorRow]
    views: list[SensorView]


def make_sensors(run: Run, name: str, vehicle: Vehicle | None) -> SensorsOfVehicle:
    """Return the sensors that a vehicle of a run uses; none without its scene.

    Args:
        run: the run.
        name: name of the vehicle.
        vehicle: the vehicle, from the scene of the run.
    """
    used = ((run.spec or {}).get("sensors") or {}).get(name) or []
    mounts = {} if vehicle is None else vehicle.sensors.mounts
    used = [sensor for sensor in used if sensor in mounts]
    if vehicle is None or not used:
        return SensorsOfVehicle(name, [], [])
    # The meshes of the vehicle may have gone since the run; the page then lacks positions and scans.
    try:
        figures = {sensor.name: sensor for sensor in find_sensors(vehicle)}
    except MirdrakeError:
        figures = {}
    rows = [_make_row(run, f"{name}.{sensor}", mounts[sensor], figures.get(sensor)) for sensor in used]
    return SensorsOfVehicle(name, rows, _make_views(run, name, vehicle, used, figures))


# --- table -----------------------------------------------------------------------------------------------------------


def _make_row(run: Run, name: str, mount: Mount, figures: SensorFigures | None) -> SensorRow:
    latency = f", latency {1e3 * mount.latency:g}\u00a0ms" if mount.latency else ""
    return SensorRow(
        name=name.partition(".")[2],
        kind=mount.kind.replace("_", " "),
        preset=mount.preset or "",
        place="–" if figures is None else ", ".join(f"{value:.3f}" for value in figures.place).replace("-", "−"),
        rate=f"{mount.rate:g}\u00a0Hz{latency}",
        view="–" if figures is None else describe_view(figures),
        recorded=_recorded(run, name, mount),
    )


def _recorded(run: Run, name: str, mount: Mount) -> str:
    """Return what a run recorded of a sensor: number and kind of the samples, and their file."""
    folders = _picture_folders(run, name)
    if folders:
        count = len(run.pictures[folders[0]])
        size = f" of {mount.width} × {mount.height}" if hasattr(mount, "width") and hasattr(mount, "height") else ""
        return f"{_many(count, 'picture')}{size} in {', '.join(f'{folder}/' for folder in folders)}"
    if name in run.arrays:
        samples = run.arrays[name]
        file = f"{name}.parquet"
        if "ranges" in samples and not samples.is_number("ranges"):
            beams = " × ".join(str(size) for size in samples.shape("ranges"))
            return f"{_many(len(samples.times), 'scan')} of {beams} beams in {file}"
        return f"{_many(len(samples.times), 'sample')} of {', '.join(samples)} in {file}"
    return "nothing (record.cameras is false)" if mount.takes_pictures else "nothing"


def _many(count: int, noun: str) -> str:
    return f"{count:,} {noun}{'' if count == 1 else 's'}".replace(",", "\u202f")


def _picture_folders(run: Run, name: str) -> list[str]:
    """Return the folders of pictures of a camera: one, or one for each kind of picture such as depths."""
    return [folder for folder in run.pictures if folder == name or folder.startswith(f"{name}.")]


# --- pictures and scans ----------------------------------------------------------------------------------------------


def _make_views(
    run: Run, name: str, vehicle: Vehicle, used: Sequence[str], figures: dict[str, SensorFigures]
) -> list[SensorView]:
    """Return pictures and scans at the middle of the run, all at nearly the same time."""
    moment = 0.5 * float(run.signals.index[-1]) if len(run.signals) else 0.0
    views: list[SensorView] = []
    for sensor in used:
        full = f"{name}.{sensor}"
        folders = _picture_folders(run, full)
        if folders and run.pictures[folders[0]]:
            picture = min(run.pictures[folders[0]], key=lambda one: abs(one.time - moment))
            views.append(SensorView(f"{sensor} at {format_time(picture.time)}", _thumbnail(picture.path)))
        elif full in run.arrays and sensor in figures:
            view = _scan(run.arrays[full], vehicle.sensors.mounts[sensor], figures[sensor], vehicle, moment)
            views += [] if view is None else [view]
    return views[:_MOST_VIEWS]


def _thumbnail(path: Path) -> str:
    """Return a picture as a small JPEG in a ``data:`` address; of depths and labels, the far is light."""
    with Image.open(path) as image:
        pixels = np.asarray(image)
    if pixels.dtype != np.uint8:
        pixels = (255.0 * pixels / max(int(pixels.max()), 1)).astype(np.uint8)
    small = Image.fromarray(pixels)
    small.thumbnail((_WIDTH, _WIDTH))
    file = io.BytesIO()
    small.save(file, "JPEG", quality=80)
    return data_address(file.getvalue(), "image/jpeg")


def _scan(samples: Samples, mount: Mount, figures: SensorFigures, vehicle: Vehicle, moment: float) -> SensorView | None:
    """Return the scan nearest to a time [s]; None for a sensor without beams of known directions."""
    times = samples.times
    if not len(times) or "ranges" not in samples:
        return None
    index = int(np.abs(times - moment).argmin())
    sample = samples.sample(index)
    if {"azimuths", "elevations"} <= set(sample):
        azimuths, elevations = np.meshgrid(sample["azimuths"], sample["elevations"])
    elif hasattr(mount, "start_angle") and hasattr(mount, "end_angle"):
        azimuths = np.linspace(mount.start_angle, mount.end_angle, sample["ranges"].size)
        elevations = np.zeros_like(azimuths)
    else:
        return None
    level = np.cos(elevations)
    rays = np.stack((level * np.cos(azimuths), level * np.sin(azimuths), np.sin(elevations)))
    returned = np.isfinite(sample["ranges"])
    points = rays[:, returned] * sample["ranges"][returned]
    # From the frame of the sensor to that of the vehicle, whose z = 0 is the road.
    R_BS = RollPitchYaw(figures.roll, -figures.pitch, figures.yaw).ToRotationMatrix().matrix()
    points = R_BS @ points + np.asarray(figures.place)[:, None]
    count = f"{points.shape[1]:,} of {sample['ranges'].size:,} beams with a return".replace(",", "\u202f")
    caption = f"{figures.name} at {format_time(float(times[index]))}, from above: {count}"
    return SensorView(caption, drawing=_draw_scan(points, vehicle, caption))


def _draw_scan(points: Array, vehicle: Vehicle, description: str) -> Markup:
    """Draw returns (3, n) [m] in the frame of the vehicle from above, with the outline of the vehicle."""
    road = points[2] < _ROAD
    distances = np.hypot(*(points[:2] if road.all() else points[:2, ~road]))
    reach = max(1.15 * float(np.percentile(distances, 90)), 5.0) if distances.size else 20.0
    # A sensor that looks ahead only has its vehicle at the lower edge.
    ahead_only = not (points[0] < -0.1 * reach).any()
    behind = 0.15 * reach if ahead_only else reach
    scale = 0.5 * _SIZE / reach  # px/m
    height = (reach + behind) * scale

    def place(x: Any, y: Any) -> tuple[Any, Any]:
        return 0.5 * _SIZE - scale * y, (reach - x) * scale

    step = next((step for step in _STEPS if reach / step < 4.0), _STEPS[-1])
    middle, origin = place(0.0, 0.0)
    parts = []
    for number in range(1, math.floor(1.5 * reach / step) + 1):
        radius = number * step * scale
        parts.append(f'<circle cx="{middle:.1f}" cy="{origin:.1f}" r="{radius:.1f}" fill="none" stroke="var(--grid)"/>')
    for chosen, colour in ((road, "var(--edge)"), (~road, "var(--main)")):
        parts.append(_dots(*place(points[0, chosen], points[1, chosen]), height, colour))
    outline = measure_outline(vehicle.urdf, packages=vehicle.packages, base_link=vehicle.spec.base_link)
    if outline is not None:
        left, top = place(outline.front, outline.left)
        right, bottom = place(outline.rear, outline.right)
        parts.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}" '
            f'rx="{0.2 * (right - left):.1f}" fill="var(--paper)" stroke="var(--ink)"/>'
        )
    # Labels last: they are above the dots.
    for number in range(1, math.floor(reach / step) + 1):
        text = f"{number * step:g}\u00a0m"
        y = origin - number * step * scale
        parts.append(f'<text x="{middle:.1f}" y="{y + 4.0:.1f}" text-anchor="middle" font-size="12">{text}</text>')
    return Markup(
        f'<svg class="plot scan" viewBox="0 0 {_SIZE:.0f} {height:.0f}" role="img" aria-label="{{}}">{{}}</svg>'
    ).format(description, Markup("".join(parts)))


def _dots(u: Array, v: Array, height: float, colour: str) -> str:
    """Return points in the drawing [px] as one path, one dot for each cell that has any."""
    inside = (u >= 0.0) & (u <= _SIZE) & (v >= 0.0) & (v <= height)
    cells = np.unique(np.round(np.column_stack((u[inside], v[inside])) / _CELL).astype(int), axis=0)
    if not len(cells):
        return ""
    dots = "".join(f"M{x:.1f} {y:.1f}h{_CELL}" for x, y in (cells * _CELL).tolist())
    return f'<path d="{dots}" stroke="{colour}" stroke-width="{_CELL}" fill="none"/>'

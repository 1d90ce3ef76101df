"""The run report: a headline with the result, the track from above, signals, sensors, events, settings.

The page needs no network and no other file; only the link to recording.html leads out of it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup

from mirdrake.assembly.scene import Scene
from mirdrake.core.errors import MirdrakeError, RunError
from mirdrake.core.files import write_file
from mirdrake.core.json_io import plain_data
from mirdrake.report.drive import VEHICLE_COLOURS, draw_drive, own_track
from mirdrake.report.drive_layers import scale_colours
from mirdrake.report.figures import Array, drawing_style
from mirdrake.report.inner_charts import make_inner_charts
from mirdrake.report.page import Tile, render_page
from mirdrake.report.sensor_views import make_sensors
from mirdrake.report.svg import embed_graph
from mirdrake.report.vehicle_charts import Chart, VehicleSignals, distance, make_charts
from mirdrake.report.words import format_duration, format_quantity, format_time, title_case
from mirdrake.runs.logs import Run
from mirdrake.runs.texts import STRAIGHT_ON, describe_findings, describe_stop
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import Track

_TEMPLATE = "run_report.html.jinja"
_MOST_EVENTS = 200  # rows of the table
_MOST_MARKS = 30  # vertical lines in a chart


@dataclass(frozen=True)
class VehiclePage:
    """Section of one vehicle."""

    name: str
    model: str
    anchor: str
    colour: str
    sentence: str
    tiles: list[Tile]
    charts: list[Chart]


def write_report(run: Run, *, diagram_svg: str | None = None) -> Path:
    """Write report.html into the folder of a run.

    Args:
        run: finished, killed or empty; the page omits what is missing.
        diagram_svg: the drawing of the diagram; by default the file diagram.svg of the folder.

    Returns:
        the path of the file. The same run gives the same bytes.

    Raises:
        RunError: the run has no folder, or it cannot be written.
    """
    if run.folder is None:
        raise RunError("the run is only in memory and has no folder for its report; simulate with folder=…")
    page = render_report(run, diagram_svg=diagram_svg)
    path = run.folder / "report.html"
    write_file(path, page)
    return path


def render_report(run: Run, *, diagram_svg: str | None = None) -> str:
    """Return the page; see :func:`write_report`."""
    summary, spec = run.summary or {}, run.spec or {}
    # Drawing needs increasing times; a killed run may have repeated or unsorted rows.
    signals = run.signals[~run.signals.index.duplicated()].sort_index()
    simulated = _number(summary.get("simulated_s"))
    # A killed run has no summary.
    if not math.isfinite(simulated) and len(signals):
        simulated = float(signals.index[-1])
    # The scene of the run folder, not that of today's files: both may differ.
    world = _world_name(spec, summary)
    scene, scene_notes = _scene_of(run)
    loaded = {} if scene is None else scene.vehicles
    names = _vehicle_names(run)
    tracks = {name: _track_of(run, VehicleSignals(signals, name), scene) for name in names}
    folder = run.folder.name if run.folder else ""
    # Pictures need Matplotlib's settings of reports, whatever the settings of the user are.
    with drawing_style():
        vehicles = [
            _make_vehicle_page(run, VehicleSignals(signals, name), index, tracks[name], loaded.get(name))
            for index, name in enumerate(names)
        ]
        drive = draw_drive(names, signals, None if scene is None else scene.world, run.actors, tracks)
        inner = make_inner_charts(
            signals, run.units, vehicles=names, systems=spec.get("systems") or {}, marks=_marks(run)
        )
    sensors = [make_sensors(run, name, loaded.get(name)) for name in names]
    # The name of the diagram, else that of the folder.
    name = str(summary.get("diagram") or folder or "run")
    headline, sentences = _headline(vehicles, world, simulated)
    light, dark = scale_colours()
    diagram, diagram_note = _diagram(run.folder, diagram_svg)
    events = sorted(run.events or [], key=lambda event: _number(event.get("time"), math.inf))
    return render_page(
        _TEMPLATE,
        title=f"{name} · run report",
        over=name if folder in {"", name} else f"{name} · {folder}",
        headline=headline,
        tiles=(vehicles[0].tiles if len(vehicles) == 1 else []) + _run_tiles(summary, simulated, len(signals)),
        notices=[*_incomplete(summary, len(signals)), *describe_findings(summary), *scene_notes],
        folder=folder,
        sentences=sentences,
        stop_reason=describe_stop(summary),
        vehicles=vehicles,
        drive=drive,
        sensors=[one for one in sensors if one.rows],
        inner=inner,
        events=[
            (format_time(_number(event.get("time"))), event.get("kind", ""), event.get("text", ""))
            for event in events[:_MOST_EVENTS]
        ],
        more_events=max(0, len(events) - _MOST_EVENTS),
        spec_yaml=yaml.safe_dump(plain_data(spec), sort_keys=False, allow_unicode=True, width=100) if spec else "",
        facts=_facts(spec, summary),
        marked=bool(_marks(run)),
        diagram=diagram,
        diagram_note=diagram_note,
        recording=bool(run.folder and (run.folder / "recording.html").is_file()),
        light_scale=light,
        dark_scale=dark,
    )


# --- parts of the page ---------------------------------------------------------------------------------------------


def _scene_of(run: Run) -> tuple[Scene | None, list[str]]:
    """Return the scene of a run, if it has one, and notices about it."""
    try:
        scene = run.scene()
    except MirdrakeError as error:
        return None, [str(fault) for fault in error.faults] if run.folder is not None and run.spec else []
    return scene, list(scene.changes)


def _incomplete(summary: Mapping[str, Any], rows: int) -> list[str]:
    """Return notices for a run that did not end, or has no samples."""
    notices = []
    if not summary.get("stop_reason"):
        notices.append("The run did not end, or its summary is missing. This page shows what was recorded until then.")
    if not rows:
        notices.append("No samples were recorded, so there are no charts.")
    return notices


def _dimensions(vehicle: Vehicle | None) -> dict[str, float]:
    """Return wheelbase and width over the wheels [m] of a vehicle; empty if it is not known."""
    if vehicle is None:
        return {}
    geometry = vehicle.geometry
    track = max(geometry.front_track, geometry.rear_track)
    return {"wheelbase": geometry.wheelbase, "body_width": track + max(geometry.wheel_widths)}


def _make_vehicle_page(
    run: Run, signals: VehicleSignals, index: int, track: Track | None, vehicle: Vehicle | None
) -> VehiclePage:
    name = signals.name
    entry = (run.spec or {}).get("vehicles", {}).get(name) or {}
    summary = ((run.summary or {}).get("vehicles") or {}).get(name) or {}
    model = str(summary.get("model") or (entry.get("model") if isinstance(entry, Mapping) else entry) or name)
    figures = _figures(signals, summary)
    # A road width has a meaning only beside the lateral error.
    width = track.width if track is not None and signals.has("lateral_error") else None
    charts = []
    # A run may end before its first sample, and the page must still open.
    if len(signals.time):
        charts = make_charts(
            signals,
            f"v{index}-",
            road_width=width,
            road_edges=_road_edges(signals, track),
            geometry=_dimensions(vehicle),
            marks=_marks(run),
        )
    return VehiclePage(
        name=name,
        model=model,
        anchor=f"vehicle-{index + 1}",
        colour=VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)],
        sentence=_sentence(figures),
        tiles=_vehicle_tiles(figures),
        charts=charts,
    )


def _track_of(run: Run, signals: VehicleSignals, scene: Scene | None) -> Track | None:
    """Return the track against which a vehicle was measured, if it is known."""
    if scene is None:
        return None
    driver = ((run.spec or {}).get("control") or {}).get(signals.name)
    name = driver.get("track") if isinstance(driver, Mapping) else None
    return own_track(signals, scene.world, name if isinstance(name, str) else None)


def _road_edges(signals: VehicleSignals, track: Track | None) -> tuple[Array, Array] | None:
    """Return the lateral positions [m] of the road's edges along the drive, + left, if its width varies."""
    if track is None or track.edges is None or not signals.has("lateral_error", "progress"):
        return None
    s, left, right = track.edges
    along = signals["progress"]
    # Edges are stored as widths: left is positive, right negative (ISO 8855).
    return np.interp(along, s, left), -np.interp(along, s, right)


def _figures(signals: VehicleSignals, summary: Mapping[str, Any]) -> dict[str, float]:
    """Return the figures of a vehicle: from the summary, or from the signals of a run that was killed."""
    figures = {key: _number(value) for key, value in summary.items() if key != "model"}
    figures = {key: value for key, value in figures.items() if math.isfinite(value)}
    # Figures of the summary have priority; those of the signals replace what is missing.
    if len(signals.time):
        figures.setdefault("distance_m", distance(signals))
        if signals.has("lateral_error"):
            figures.setdefault("max_abs_lateral_error_m", float(np.nanmax(np.abs(signals["lateral_error"]))))
        if signals.has("vx"):
            figures.setdefault("max_speed_mps", float(np.nanmax(np.abs(signals["vx"]))))
    return figures


def _sentence(figures: Mapping[str, float]) -> str:
    """Return the errors of a drive as the end of a sentence about the vehicle."""
    parts = []
    if figures.get("max_abs_lateral_error_m", 0.0) >= STRAIGHT_ON:
        parts.append(f"largest lateral error {format_quantity(figures['max_abs_lateral_error_m'], 'm', digits=2)}")
    if "mean_speed_error_percent" in figures:
        parts.append(
            f"mean speed error on straights {format_quantity(figures['mean_speed_error_percent'], '%', digits=2)}"
        )
    if figures.get("off_road_s"):
        parts.append(f"{format_duration(figures['off_road_s'])} off the road")
    return ", ".join(parts)


def _headline(vehicles: Sequence[VehiclePage], world: str, simulated: float) -> tuple[str, list[str]]:
    """Return the result as a sentence, and a sentence for each of several vehicles."""
    during = f" in {format_duration(simulated)}" if math.isfinite(simulated) else ""
    if not vehicles:
        return (f"{format_duration(simulated)} of {world or 'simulation'}" if during else "A run without signals"), []
    several = len(vehicles) > 1
    sentences = []
    for page in vehicles:
        laps, distance = (
            next((tile.value for tile in page.tiles if tile.label == label), "") for label in ("Laps", "Distance")
        )
        # A tenth of a lap or less is better described by its distance.
        if laps and (float(laps) >= 0.1 or not distance):
            drove = f"{laps}\u00a0lap{'' if laps == '1.00' else 's'}" + (f" of {world}" if world else "") + during
        else:
            drove = f"{distance}{during}" + (f" on {world}" if world else "")
        who = f"{page.name}, the {title_case(page.model)}," if several else f"The {title_case(page.model)}"
        sentence = f"{who} drove {drove}" if laps or distance else f"{who} has no signals"
        sentences.append(sentence + (f"; {page.sentence}" if page.sentence else ""))
    if not several:
        return sentences[0], []
    during = f" for {format_duration(simulated)}" if math.isfinite(simulated) else ""
    return f"{len(vehicles)} vehicles drove" + (f" on {world}" if world else "") + during, sentences


def _vehicle_tiles(figures: Mapping[str, float]) -> list[Tile]:
    # Only figures that the run has: a killed or short run lacks some.
    tiles = []
    if "laps" in figures:
        tiles.append(Tile("Laps", f"{figures['laps']:.2f}"))
    if "distance_m" in figures:
        tiles.append(Tile("Distance", format_quantity(figures["distance_m"], "m")))
    if figures.get("max_abs_lateral_error_m", 0.0) >= STRAIGHT_ON:
        tiles.append(Tile("Largest lateral error", format_quantity(figures["max_abs_lateral_error_m"], "m", digits=2)))
    if "mean_speed_error_percent" in figures:
        tiles.append(
            Tile(
                "Mean speed error",
                format_quantity(figures["mean_speed_error_percent"], digits=2) + "\u00a0%",
                "from the driver's command, on straights",
            )
        )
    if "max_speed_mps" in figures:
        tiles.append(
            Tile(
                "Top speed",
                format_quantity(figures["max_speed_mps"], "m/s"),
                format_quantity(3.6 * figures["max_speed_mps"], "km/h"),
            )
        )
    if "off_road_s" in figures:
        tiles.append(Tile("Off the road", format_quantity(figures["off_road_s"], "s", digits=2)))
    return tiles


def _run_tiles(summary: Mapping[str, Any], simulated: float, rows: int) -> list[Tile]:
    tiles = []
    # Old runs and interrupted ones have no wall time or factor; such values are not finite.
    wall, factor = _number(summary.get("wall_s")), _number(summary.get("real_time_factor"))
    if math.isfinite(simulated):
        tiles.append(Tile("Simulated", format_duration(simulated), f"{rows:,} samples".replace(",", "\u202f")))
    if math.isfinite(factor):
        pace = "faster than real time" if factor > 1.0 else "slower than real time"
        tiles.append(
            Tile(
                "Real-time factor",
                format_quantity(factor, "×"),
                f"{format_duration(wall)} of computing" if math.isfinite(wall) else pace,
            )
        )
    return tiles


def _facts(spec: Mapping[str, Any], summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what is needed to repeat the run: name and value."""
    facts = [("Seed", summary.get("seed", spec.get("seed")))]
    facts.append(("Hash of the settings (SHA-256)", summary.get("spec_sha256", spec.get("sha256"))))
    versions = summary.get("versions") or spec.get("versions") or {}
    if isinstance(versions, Mapping):
        facts += [(str(name), version) for name, version in versions.items()]
    return [(name, str(value)) for name, value in facts if value is not None]


def _diagram(folder: Path | None, text: str | None) -> tuple[Markup | None, str]:
    """Return the drawing of the diagram, and a note if it cannot be shown."""
    # A run that is loaded has only its files.
    if text is None and folder and (path := folder / "diagram.svg").is_file():
        text = path.read_text(encoding="utf-8", errors="replace")
    # The DOT text is written in any case; without a picture beside it, Graphviz was missing.
    if not text and folder and (folder / "diagram.dot").is_file():
        install = "install it (pip install 'mirdrake[drawing]') and run again, or draw diagram.dot elsewhere"
        return None, f"The block diagram was not drawn because Graphviz is missing; {install}."
    if not text:
        return None, ""
    try:
        # The file may have been edited: a page must not contain markup that was not checked.
        return Markup(embed_graph(text, "diagram-", "Systems of the diagram and the wires between them")), ""
    except ValueError as error:
        return None, f"The drawing of the diagram is omitted: {error}."


# --- reading the run -------------------------------------------------------------------------------------------------


def _vehicle_names(run: Run) -> list[str]:
    named = [*((run.spec or {}).get("vehicles") or {}), *((run.summary or {}).get("vehicles") or {})]
    if not named:
        named = [str(column).removesuffix(".x") for column in run.signals.columns if str(column).endswith(".x")]
    return list(dict.fromkeys(str(name) for name in named))


def _marks(run: Run) -> list[float]:
    """Return the times of events [s] to draw: within the run, without start and end, none if there are too many."""
    if not len(run.signals):
        return []
    first, last = float(run.signals.index[0]), float(run.signals.index[-1])
    # Marks at the very ends would coincide with the axes.
    edge = 0.005 * (last - first)
    marks = [_number(event.get("time")) for event in run.events or []]
    marks = sorted({mark for mark in marks if first + edge < mark < last - edge})
    # Too many lines would hide the curves.
    return marks if len(marks) <= _MOST_MARKS else []


def _world_name(spec: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    world = spec.get("world") or summary.get("world") or ""
    name = str(world.get("name", "")) if isinstance(world, Mapping) else str(world)
    # A world may be given by the path of its file, whose folders are of no interest to the reader.
    return Path(name).stem if name.endswith((".yaml", ".yml")) else name


def _number(value: Any, otherwise: float = math.nan) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return otherwise

"""``mirdrake run``: simulate a diagram and write a run folder."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet, add_set, positive_time, print_files, terminated_like_interrupted
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import resolved
from mirdrake.core.progress import Progress
from mirdrake.core.yaml_io import display_path

if TYPE_CHECKING:
    from mirdrake.assembly.diagram_spec import DiagramSpec
    from mirdrake.assembly.scene import Scene
    from mirdrake.runs.logs import Run

MORE = """\
The folder holds spec.yaml, signals.parquet, events.jsonl, summary.json, recording.html, report.html.
Ctrl-C stops early and keeps the results so far. In a terminal a Meshcat page shows the run live. User modules
(kind: "module:Class") are executed.

examples:
  mirdrake run bolt_test_track --set control.ego.speed=8 --set duration=60 --out runs/faster
  mirdrake run runs/faster/spec.yaml      repeat a run; the results are bit-equal
  mirdrake run bolt_test_track --commands log.csv       drive from recorded commands, until they end:
      a table with the header  time [s],speed [km/h],steering [deg]  , a driving_log.txt, or a run folder"""

_MOST_CHANGES = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("diagram", help="name or path of a diagram file")
    add_set(parser)
    parser.add_argument(
        "--duration",
        type=positive_time,
        metavar="S",
        help="simulated time [s], or with a unit (1 min); the run also ends after the `laps` of the file, unless "
        "--set laps=null",
    )
    parser.add_argument(
        "--commands",
        action="append",
        default=[],
        metavar="[VEHICLE=]LOG",
        help="drive by recorded commands in place of the driver in the file (repeatable)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/<name>-<UTC time>)")
    parser.add_argument("--realtime", action="store_true", help="not faster than real time")
    parser.add_argument("--view", action=argparse.BooleanOptionalAction, help="live Meshcat (default: in a terminal)")
    parser.add_argument("--recording", action=argparse.BooleanOptionalAction, help="write recording.html")
    parser.add_argument("--report", action=argparse.BooleanOptionalAction, help="write report.html")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Simulate the diagram; 1 if the run diverged."""
    from mirdrake.assembly.diagram_spec import load_diagram
    from mirdrake.assembly.parts.steps import discrete_plant
    from mirdrake.assembly.scene import make_scene
    from mirdrake.assembly.speed_limits import limited_speeds
    from mirdrake.workflow import run_diagram

    # The options that switch pages on and off are short for keys of the file.
    overrides = list(options.set)
    for name, key in (("recording", "meshcat"), ("report", "report")):
        if getattr(options, name) is not None:
            overrides.append(f"record.{key}={str(getattr(options, name)).lower()}")
    spec = load_diagram(options.diagram, overrides=overrides)
    duration = options.duration
    if options.commands:
        end_of_commands = _use_recorded_commands(spec, options.commands)
        duration = duration or end_of_commands

    # The scene is laid out once, for the live view and for the run.
    scene, meshcat = make_scene(spec), None
    _warn_of_changed_files(spec, scene, options.diagram, overrides)
    for line in limited_speeds(spec, scene.vehicles):
        print(f"warning: {line}", file=sys.stderr)
    for line in discrete_plant(spec, scene):
        print(f"note: {line}", file=sys.stderr)
    if options.view or (options.view is None and sys.stdout.isatty() and not options.quiet):
        from mirdrake.viewer import make_meshcat

        meshcat = make_meshcat(world=scene.world, title=spec.name)
        print(f"Meshcat: {meshcat.web_url()}", flush=True)

    with (
        terminated_like_interrupted(),
        Progress(spec.name, duration or spec.duration, "s", quiet=options.quiet) as progress,
    ):
        # The speed is measured from the first step on, without the time for building the diagram.
        begin: list[tuple[float, float]] = []

        def show(time: float, _: float) -> None:
            begin.append((perf_counter(), time)) if not begin else None
            wall, simulated = perf_counter() - begin[0][0], time - begin[0][1]
            progress.update(time, text=f"{simulated / max(wall, 1e-3):.1f} x real time" if simulated > 0.0 else "")

        finished = run_diagram(
            spec,
            scene=scene,
            folder=options.out,
            duration=duration,
            meshcat=meshcat,
            realtime_rate=1.0 if options.realtime else 0.0,
            progress=show,
            print_line=lambda text: progress.update(text=text),
            # Warnings are printed also with --quiet, which is for progress and results.
            report=lambda incident: progress.write(f"warning: t = {incident.time:.2f} s: {incident.text}"),
        )
    if not options.quiet:
        _print_summary(finished)

    # A run that diverged has written its folder, but its exit code is 1.
    if not finished.diverged:
        return 0
    location = f"{display_path(finished.folder)}: " if finished.folder else ""
    print(
        f"error: {location}the run {finished.stop}; fix the block that computes it, or try a smaller plant.time_step",
        file=sys.stderr,
    )
    return 1


def _warn_of_changed_files(spec: "DiagramSpec", scene: "Scene", diagram: str, overrides: Sequence[str]) -> None:
    """Print one line if vehicle or world files have changed since the run that wrote the given spec.yaml."""
    from mirdrake.assembly.scene import changed_files
    from mirdrake.runs.summary import changed_since

    # What --set changes in vehicles or the world differs on purpose.
    if spec.provenance is None or any(text.startswith(("vehicles", "world")) for text in overrides):
        return
    changed_parts = changed_since(scene, spec.provenance)
    parts = ["the world" if name == "world" else f"vehicle '{name}'" for name in changed_parts]
    changed = list(dict.fromkeys([*parts, *changed_files(scene, Path(diagram).parent)]))
    if changed:
        names = ", ".join(changed[:_MOST_CHANGES])
        more = f" and {len(changed) - _MOST_CHANGES} more" if len(changed) > _MOST_CHANGES else ""
        print(
            f"warning: {diagram}: changed since that run: {names}{more}; the results may differ",
            file=sys.stderr,
        )


def _use_recorded_commands(spec: "DiagramSpec", texts: Sequence[str]) -> float:
    """Let recorded commands drive the vehicles of a spec; return the time at which the last of them ends [s].

    Args:
        spec: its control is replaced.
        texts: ``[VEHICLE=]LOG``; the first vehicle by default.
    """
    from mirdrake.controllers.command_log import read_commands
    from mirdrake.controllers.schedule import ScheduleSpec

    end = 0.0
    for text in texts:
        vehicle, mark, file = text.partition("=")
        if not mark or vehicle not in spec.vehicles:
            # A path may contain an equals sign; the text before it is a vehicle only if it cannot be a path.
            if mark and "/" not in vehicle and not Path(text).exists():
                raise ConfigError(f"--commands {text}: no vehicle '{vehicle}'; {did_you_mean(vehicle, spec.vehicles)}")
            vehicle, file = next(iter(spec.vehicles)), text
        path = Path(file)
        if not path.exists():
            raise ConfigError(f"--commands {text}: no such file")
        log = read_commands(path, vehicle=vehicle)
        if log.duration <= 0.0:
            raise ConfigError(f"--commands {text}: contains fewer than two rows at different times")
        end = max(end, log.duration)
        spec.control[vehicle] = ScheduleSpec(kind="schedule", file=str(resolved(path)), vehicle=vehicle)
    return end


def _print_summary(run: "Run") -> None:
    from mirdrake.runs.texts import describe_figures, describe_findings, describe_stop

    summary = run.summary
    factor = summary["real_time_factor"] or 0.0
    print(f"{summary['diagram']}: {summary['simulated_s']:g} s in {summary['wall_s']:g} s ({factor:g} x real time)")
    # Only views have no other place in the summary.
    for event in run.events:
        if event["kind"] == "view":
            print(f"  {event['text']}")
    print(f"  {describe_stop(summary)}")
    for text in describe_findings(summary):
        print(f"  {text}")
    for name, figures in summary["vehicles"].items():
        print(f"  {name}: {figures['model']}, {figures['distance_m'] or 0.0:.1f} m driven")
        for hit in figures.get("collisions", ()):
            print(f"    collision with '{hit['with']}' at t = {hit['time']:.2f} s, {hit['speed_mps']:.1f} m/s")
        for text in describe_figures(figures):
            print(f"    {text}")
    if run.folder is not None:
        files = (("report.html", "report"), ("recording.html", "recording, opens offline"))
        print_files(run.folder, files, indent="  ")

"""``mirdrake run``: simulate a diagram and write a run folder."""

import argparse
import contextlib
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mirdrake.cli.verb import add_set
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_io import shown

if TYPE_CHECKING:
    from mirdrake.assembly.diagram_spec import DiagramSpec
    from mirdrake.assembly.scene import Scene
    from mirdrake.runs.incidents import Incident
    from mirdrake.runs.logs import Run

HELP = "simulate a diagram and write a run folder"
MORE = """\
The folder holds spec.yaml, signals.parquet, events.jsonl, summary.json, recording.html, report.html.
Ctrl-C stops early and keeps what is done. In a terminal a Meshcat page shows the run live.

examples:
  mirdrake run bolt_test_track --set control.ego.speed=8 --set duration=60 --out runs/faster
  mirdrake run runs/faster/spec.yaml      the same again, to the last bit
  mirdrake run bolt_test_track --commands log.csv       drive from recorded commands, for as long as they last:
      a table with the header  time [s],speed [km/h],steering [deg]  , a driving_log.txt, or a run folder"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("diagram", help="name or path of a diagram file")
    add_set(parser)
    parser.add_argument("--duration", type=_positive, metavar="S", help="simulated time [s] instead of the file's")
    parser.add_argument(
        "--commands",
        action="append",
        default=[],
        metavar="[VEHICLE=]LOG",
        help="drive from recorded commands, instead of the file's control",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/<name>-<UTC time>)")
    parser.add_argument("--realtime", action="store_true", help="not faster than real time")
    parser.add_argument("--view", action=argparse.BooleanOptionalAction, help="live Meshcat (default: in a terminal)")
    parser.add_argument("--recording", action=argparse.BooleanOptionalAction, help="write recording.html")
    parser.add_argument("--report", action=argparse.BooleanOptionalAction, help="write report.html")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Simulate."""
    from tqdm import tqdm

    from mirdrake.assembly.diagram_spec import load_diagram
    from mirdrake.assembly.scene import make_scene
    from mirdrake.workflow import run_diagram

    overrides = list(options.set)
    for name, key in (("recording", "meshcat"), ("report", "report")):
        if getattr(options, name) is not None:
            overrides.append(f"record.{key}={str(getattr(options, name)).lower()}")
    spec = load_diagram(options.diagram, overrides=overrides)
    duration = options.duration
    if options.commands:
        lasts = _drive_from(spec, options.commands)
        duration = duration or lasts
    terminal = sys.stdout.isatty() and not options.quiet
    scene, meshcat = make_scene(spec), None
    _report_changes(spec, scene, options.diagram, overrides)
    if options.view or (options.view is None and terminal):
        from mirdrake.viewer import make_meshcat

        meshcat = make_meshcat(world=scene.world)
        print(f"Meshcat: {meshcat.web_url()}", flush=True)
    end = duration or spec.duration
    bar = tqdm(
        total=end,
        unit="s",
        desc=spec.name,
        disable=not (sys.stderr.isatty() and not options.quiet),
        bar_format="{desc}: {percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} s, {remaining} left{postfix}",
    )

    start: dict[str, float] = {}

    def progress(time: float, duration: float) -> None:
        begin = (
            start.setdefault("clock", perf_counter()),
            start.setdefault("time", time),
        )  # without building and start-up
        if time > begin[1]:
            factor = (time - begin[1]) / max(perf_counter() - begin[0], 1e-3)
            bar.set_postfix_str(f"{factor:.1f} x real time", refresh=False)
        bar.update(min(time, duration) - bar.n)

    with _terminated_like_interrupted(), bar:
        done = run_diagram(
            spec,
            scene=scene,
            folder=options.out,
            duration=duration,
            meshcat=meshcat,
            realtime_rate=1.0 if options.realtime else 0.0,
            progress=progress,
            say=lambda text: bar.set_postfix_str(text) if not bar.disable else None,
            report=None if options.quiet else lambda incident: bar.write(_incident_text(incident), file=sys.stderr),
        )
    if not options.quiet:
        _print_summary(done)
    reason = done.summary["stop_reason"]
    if reason.startswith("diverged"):
        place = f"{shown(done.folder)}: " if done.folder else ""
        print(
            f"error: {place}the run {reason}; correct what computes it, or try a smaller plant.time_step",
            file=sys.stderr,
        )
        return 1
    return 0


def _report_changes(spec: "DiagramSpec", scene: "Scene", diagram: str, overrides: Sequence[str]) -> None:
    """Print one line if vehicle or world files have changed since the run that wrote the given spec.yaml."""
    from mirdrake.assembly.scene import changed_files
    from mirdrake.runs.summary import changed_since

    # What --set changes in vehicles or the world differs on purpose.
    if spec.provenance is None or any(text.startswith(("vehicles", "world")) for text in overrides):
        return
    names = changed_since(scene, spec.provenance)
    parts = ["the world" if name == "world" else f"vehicle '{name}'" for name in names]
    changed = list(dict.fromkeys([*parts, *changed_files(scene, Path(diagram).parent)]))
    if changed:
        more = f" and {len(changed) - 5} more" if len(changed) > 5 else ""
        print(
            f"warning: {diagram}: changed since that run: {', '.join(changed[:5])}{more}; the results may differ",
            file=sys.stderr,
        )


def _drive_from(spec: "DiagramSpec", texts: Sequence[str]) -> float:
    """Let recorded commands drive; returns how long they last [s]."""
    from mirdrake.controllers.command_log import read_commands
    from mirdrake.controllers.spec import ScheduleSpec

    lasts = 0.0
    for text in texts:
        name, mark, file = text.partition("=")
        if not mark or name not in spec.vehicles:
            name, file = next(iter(spec.vehicles)), text
            if mark and "/" not in text.partition("=")[0] and not Path(text).exists():
                given = text.partition("=")[0]
                raise ConfigError(f"--commands {text}: no vehicle '{given}'; {did_you_mean(given, spec.vehicles)}")
        path = Path(file)
        if not path.exists():
            raise ConfigError(f"--commands {text}: no such file")
        log = read_commands(path, vehicle=name)
        if log.duration <= 0.0:
            raise ConfigError(f"--commands {text}: its commands last no time; two rows are needed at least")
        lasts = max(lasts, log.duration)
        spec.control[name] = ScheduleSpec(kind="schedule", file=str(resolved(path)), vehicle=name)
    return lasts


def _incident_text(incident: "Incident") -> str:
    return f"warning: t = {incident.time:.2f} s: {incident.text}"


def _print_summary(run: "Run") -> None:
    summary = run.summary
    factor = summary["real_time_factor"] or 0.0
    print(f"{summary['diagram']}: {summary['simulated_s']:g} s in {summary['wall_s']:g} s ({factor:g} x real time)")
    reason = summary["stop_reason"]
    for event in run.events:
        if event["kind"] == "view":
            print(f"  {event['text']}")
    texts = {
        "duration": "its whole duration",
        "interrupted": "interrupted; what was done is kept",
        "laps": "all laps done",
    }
    print(f"  {texts.get(reason, reason)}")
    for name, figures in summary["vehicles"].items():
        print(f"  {name}: {figures['model']}, {figures['distance_m'] or 0.0:.1f} m driven")
        for hit in figures.get("collisions", ()):
            print(f"    collision with '{hit['with']}' at t = {hit['time']:.2f} s, {hit['speed_mps']:.1f} m/s")
        for key, text in (
            ("laps", "laps {:.3f}"),
            ("max_abs_lateral_error_m", "largest lateral error {:.3f} m"),
            ("mean_speed_error_percent", "mean speed error on straights {:.3f} %"),
            ("off_road_s", "off the road for {:.2f} s"),
        ):
            if figures[key] is not None:
                print(f"    {text.format(figures[key])}")
    if run.folder is not None:
        print(f"  {shown(run.folder)}/")
        for file, text in (("report.html", "report"), ("recording.html", "replay, opens offline")):
            if (run.folder / file).is_file():
                print(f"    {file:16} {text}")


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is no number") from None
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not allowed; it must be a positive time in s")
    return value


@contextlib.contextmanager
def _terminated_like_interrupted() -> Iterator[None]:
    """While inside, SIGTERM ends a run as Ctrl-C does: what is done is kept."""

    def interrupt(number: int, frame: Any) -> None:
        handler = signal.getsignal(signal.SIGINT)  # a running simulation has its own, which waits for the end of a step
        if not callable(handler):
            raise KeyboardInterrupt
        handler(number, frame)

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)

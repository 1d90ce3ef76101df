"""The command ``mirdrake``: thin verbs around the Python functions."""

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from mirdrake.errors import ConfigError, MirdrakeError, did_you_mean
from mirdrake.paths import names, search_folders
from mirdrake.yaml_io import shown

if TYPE_CHECKING:
    from mirdrake.logs import Run

_TEXT = """\
Model, simulate, identify and tune car-like vehicles with Drake.

  mirdrake list                         what there is: vehicles, worlds, diagrams
  mirdrake run bolt_test_track          a Chevrolet Bolt drives a lap; results go to runs/
  mirdrake run bolt_test_track --set control.ego.speed=8 --set plant.contact=point
  mirdrake view bolt                    look at a vehicle, with a slider for every joint
  mirdrake check my_diagram.yaml        every fault with file and line, without running
  mirdrake draw bolt_test_track         the block diagram as SVG

Names are looked up in the folders models/, worlds/ and diagrams/ of MIRDRAKE_PATH, of the working directory and of
mirdrake itself; a path works as well. Exit codes: 0 done, 1 a check failed or a run diverged, 2 bad input.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; those of the process if left out.

    Returns:
        0 done, 1 a run diverged or a check failed, 2 bad input, 130 interrupted before there was anything to keep.
    """
    options = _parser().parse_args(arguments)
    try:
        code: int = options.verb(options)
        sys.stdout.flush()  # here, where a reader that has gone is no error
    except MirdrakeError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"error: {place}{error.strerror or error}", file=sys.stderr)
        return 2
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "mirdrake", description=_TEXT, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="version", version=_version())
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)

    def add(name: str, verb: Callable[[argparse.Namespace], int], text: str, more: str = "") -> argparse.ArgumentParser:
        raw = argparse.RawDescriptionHelpFormatter
        child = verbs.add_parser(name, help=text, description=f"{text}\n\n{more}".strip(), formatter_class=raw)
        child.set_defaults(verb=verb)
        return child

    run = add(
        "run",
        _run,
        "simulate a diagram and write a run folder",
        "The folder holds spec.yaml, signals.parquet, events.jsonl, summary.json, recording.html, report.html.\n"
        "Ctrl-C stops early and keeps what is done. In a terminal a Meshcat page shows the run live.\n\n"
        "examples:\n"
        "  mirdrake run bolt_test_track --set control.ego.speed=8 --set duration=60 --out runs/faster\n"
        "  mirdrake run runs/faster/spec.yaml      the same again, to the last bit",
    )
    run.add_argument("diagram", help="name or path of a diagram file")
    _add_set(run)
    run.add_argument("--duration", type=_positive, metavar="S", help="simulated time [s] instead of the file's")
    run.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/<name>-<UTC time>)")
    run.add_argument("--realtime", action="store_true", help="not faster than real time")
    run.add_argument("--view", action=argparse.BooleanOptionalAction, help="live Meshcat (default: in a terminal)")
    run.add_argument("--recording", action=argparse.BooleanOptionalAction, help="write recording.html")
    run.add_argument("--report", action=argparse.BooleanOptionalAction, help="write report.html")
    run.add_argument("--quiet", action="store_true", help="print nothing but errors")

    listing = add(
        "list", _list, "list vehicles, worlds, diagrams, and the kinds of blocks", "example:\n  mirdrake list worlds"
    )
    listing.add_argument("what", nargs="?", choices=["models", "worlds", "diagrams", "blocks"], help="only these")

    view = add(
        "view",
        _view,
        "look at a vehicle, a world, a diagram or a run in Meshcat",
        "For a vehicle there is a slider for every joint; Escape in the page, or Ctrl-C here, ends it.\n\n"
        "examples:\n"
        "  mirdrake view bolt\n"
        "  mirdrake view test_track --out track.html      a page that opens offline",
    )
    view.add_argument("name", help="name or path of a vehicle, a world, a diagram or a run folder")
    view.add_argument("--out", type=Path, metavar="FILE", help="write an HTML page that opens offline, and stop")

    check = add(
        "check",
        _check,
        "check diagrams, vehicles and worlds without running them",
        "Every fault is one line with file and line number; the exit code is 2 if there is one.\n\n"
        "example:\n  mirdrake check bolt test_track my_diagram.yaml",
    )
    check.add_argument("names", nargs="+", metavar="NAME", help="names or paths")
    _add_set(check)

    draw = add(
        "draw",
        _draw,
        "draw a diagram's blocks and connections as SVG (needs Graphviz)",
        "example:\n  mirdrake draw bolt_test_track --out blocks.svg",
    )
    draw.add_argument("diagram", help="name or path of a diagram file")
    _add_set(draw)
    draw.add_argument("--out", type=Path, metavar="FILE", help=".svg or .dot (default: <name>.svg)")
    return parser


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a key of the file, for example control.ego.speed=8; may be given again",
    )


# --- verbs -------------------------------------------------------------------------------------------------------


def _run(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from mirdrake.diagram_spec import load_diagram
    from mirdrake.workflow import run_diagram

    overrides = list(options.set)
    for name, key in (("recording", "meshcat"), ("report", "report")):
        if getattr(options, name) is not None:
            overrides.append(f"record.{key}={str(getattr(options, name)).lower()}")
    spec = load_diagram(options.diagram, overrides=overrides)
    terminal = sys.stdout.isatty() and not options.quiet
    meshcat: Any = None
    if options.view or (options.view is None and terminal):
        from mirdrake.viewer import make_meshcat
        from mirdrake.worlds import load_world

        meshcat = make_meshcat(world=load_world(spec.world))
        print(f"Meshcat: {meshcat.web_url()}", flush=True)
    end = options.duration or spec.duration
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
        run = run_diagram(
            spec,
            folder=options.out,
            duration=options.duration,
            meshcat=meshcat,
            realtime_rate=1.0 if options.realtime else 0.0,
            progress=progress,
            say=lambda text: bar.set_postfix_str(text) if not bar.disable else None,
        )
    if not options.quiet:
        _print_summary(run)
    reason = run.summary["stop_reason"]
    if reason.startswith("diverged"):
        place = f"{shown(run.folder)}: " if run.folder else ""
        print(
            f"error: {place}the run {reason}; mend what computes it, or try a smaller plant.time_step", file=sys.stderr
        )
        return 1
    return 0


def _print_summary(run: "Run") -> None:
    summary = run.summary
    factor = summary["real_time_factor"] or 0.0
    print(f"{summary['diagram']}: {summary['simulated_s']:g} s in {summary['wall_s']:g} s ({factor:g} x real time)")
    reason = summary["stop_reason"]
    texts = {
        "duration": "its whole duration",
        "interrupted": "interrupted; what was done is kept",
        "laps": "all laps done",
    }
    print(f"  {texts.get(reason, reason)}")
    for name, figures in summary["vehicles"].items():
        print(f"  {name}: {figures['model']}, {figures['distance_m'] or 0.0:.1f} m driven")
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


def _list(options: argparse.Namespace) -> int:
    for kind in [options.what] if options.what else ["models", "worlds", "diagrams", "blocks"]:
        print(f"{kind}:")
        if kind == "blocks":
            from mirdrake.blocks import BLOCKS

            for name, schema in BLOCKS.items():
                print(f"  {name:22} {(schema.__doc__ or '').splitlines()[0]}")
            continue
        for name, path in names(kind).items():
            print(f"  {name:22} {shown(path)}")
        if not search_folders(kind):
            print(f"  (no folder {kind}/ found)")
    return 0


def _view(options: argparse.Namespace) -> int:
    from mirdrake.diagram_spec import load_diagram
    from mirdrake.logs import load_run
    from mirdrake.vehicles import load_vehicle
    from mirdrake.viewer import make_meshcat, show_diagram, show_vehicle, show_world
    from mirdrake.viewer.recording import draw_run
    from mirdrake.viewer.show import write_page
    from mirdrake.worlds import load_world

    kind = _kind_of(options.name)
    sliders: Any = None
    diagram: Any = None
    if kind == "runs":
        run = load_run(options.name)
        meshcat = make_meshcat(world=load_world(run.spec["world"]))
        draw_run(run, meshcat)
    elif kind == "diagrams":
        spec = load_diagram(options.name)
        meshcat = make_meshcat(world=load_world(spec.world))
        diagram = show_diagram(spec, meshcat)
    elif kind == "worlds":
        world = load_world(options.name)
        meshcat = make_meshcat(world=world)
        diagram = show_world(world, meshcat)
    else:
        meshcat = make_meshcat(world=load_world("empty"))
        diagram, sliders = show_vehicle(load_vehicle(options.name), meshcat)
    if options.out is not None:
        write_page(meshcat, options.out)
        print(shown(options.out))
        return 0
    print(f"Meshcat: {meshcat.web_url()}  (Ctrl-C ends)", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        if sliders is not None:
            sliders.Run(diagram, stop_button_keycode="Escape")
        else:
            signal.pause()
    return 0


def _kind_of(name: str) -> str:
    """What a name or path stands for: "models", "worlds", "diagrams" or "runs".

    Raises:
        ConfigError: nothing has that name.
    """
    path = Path(name)
    if (path / "spec.yaml").is_file():
        return "runs"
    model = name.rpartition("@")[0] or name  # bolt@published
    if any((Path(one) / "vehicle.yaml").is_file() or one in names("models") for one in (name, model)):
        return "models"
    if path.suffix in {".yaml", ".yml"} and path.is_file():
        from mirdrake.yaml_io import parse_tree

        data, _ = parse_tree(path.read_text(encoding="utf-8", errors="replace"), shown(path))
        return "worlds" if isinstance(data, dict) and "mirdrake" in data else "diagrams"
    for kind in ("worlds", "diagrams"):
        if name in names(kind):
            return kind
    known = [*names("models"), *names("worlds"), *names("diagrams")]
    raise ConfigError(f"nothing is called '{name}'; {did_you_mean(name, known)}")


def _check(options: argparse.Namespace) -> int:
    faults = 0
    for name in options.names:
        try:
            notes = _check_one(name, options.set)
        except MirdrakeError as error:
            faults += 1
            for line in str(error).splitlines():
                print(f"error: {line}", file=sys.stderr)
            continue
        print(f"{name}: sound")
        for note in notes:
            print(f"  {note}")
    return 2 if faults else 0


def _check_one(name: str, overrides: Sequence[str]) -> list[str]:
    """Check one thing; returns remarks that are no faults."""
    from mirdrake.diagram import assemble, load_diagram
    from mirdrake.vehicles import load_vehicle
    from mirdrake.worlds import load_world

    kind = _kind_of(name)
    if kind == "models":
        return list(load_vehicle(name).warnings)
    if kind == "worlds":
        load_world(name)
        return []
    assembly = assemble(load_diagram(str(Path(name) / "spec.yaml") if kind == "runs" else name, overrides=overrides))
    return [f"output '{port}' is not read" for port in assembly.unread]


def _draw(options: argparse.Namespace) -> int:
    from mirdrake.diagram import assemble, load_diagram
    from mirdrake.drawing import draw_svg, write_dot
    from mirdrake.logs import write_file

    assembly = assemble(load_diagram(options.diagram, overrides=options.set))
    out = options.out or Path(f"{assembly.spec.name}.svg")
    if out.suffix not in {".svg", ".dot"}:
        raise ConfigError(f"--out {out}: the name must end in .svg or .dot")
    write_file(out, draw_svg(assembly) if out.suffix == ".svg" else write_dot(assembly))
    print(shown(out))
    return 0


# --- helpers -----------------------------------------------------------------------------------------------------


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


def _version() -> str:
    from importlib.metadata import version

    return f"mirdrake {version('mirdrake')}"


if __name__ == "__main__":
    sys.exit(main())

"""``mirdrake tune``: good gains for a loop, with evidence."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from mirdrake.cli import tune_apply
from mirdrake.core.errors import MissingDependencyError
from mirdrake.core.paths import find
from mirdrake.execution.worker_server import LOOP, start_server

HELP = "tune the gains of a loop: identify, rules, search, robustness; apply writes them into control.yaml"
MORE = """\
STUDY.yaml says which loop of which vehicle (mirdrake: tuning/1). The loop is identified on the full plant; rules, loop
shaping and a search give candidates; the best are confirmed on the plant and shaken. The folder holds tuning.json,
tables and the page tuning.html. Ctrl-C keeps what is done; the same call goes on from there.
`mirdrake tune apply RESULT` writes the gains into control.yaml; see mirdrake tune apply --help.
Exit codes: 0 all that a tuned loop shall reach is reached, 1 something is not, 2 bad input, 130 stopped.

examples:
  mirdrake tune studies/bolt_speed.yaml --out runs/bolt_speed
  mirdrake tune studies/unior_steering.yaml --set search.trials=200 --set robustness.runs=20
  mirdrake tune studies/bolt_speed.yaml --scheduler tcp://192.168.1.5:8786      workers of Dask on other computers
  mirdrake tune apply runs/bolt_speed --dry-run"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The verb's arguments."""
    parser.add_argument("study", metavar="STUDY.yaml", help="a tuning file; or the word apply")
    parser.add_argument("more", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a value of the study; again")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: as many as cores; 0: none)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask scheduler, instead of processes here")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (default: runs/tune-<study>, taken up again)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(options: argparse.Namespace) -> int:
    """Tune, or apply."""
    if options.study == "apply":
        parser = argparse.ArgumentParser(
            prog="mirdrake tune apply",
            description=tune_apply.HELP,
            epilog=tune_apply.MORE,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        tune_apply.add_arguments(parser)
        return tune_apply.run(parser.parse_args(options.more))
    if options.more:
        again = argparse.ArgumentParser(prog="mirdrake tune", usage=argparse.SUPPRESS)
        add_arguments(again)
        options = again.parse_args([*_given(options), *options.more, options.study])
    return _tune(options)


def _given(options: argparse.Namespace) -> list[str]:
    """Options that stood before the study, as words."""
    words = [f"--set={value}" for value in options.set] + (["--quiet"] if options.quiet else [])
    given = {name: getattr(options, name) for name in ("workers", "scheduler", "out")}
    return words + [f"--{name}={value}" for name, value in given.items() if value is not None]


def _tune(options: argparse.Namespace) -> int:
    path = find("studies", options.study)
    if options.scheduler is None and options.workers != 0:
        start_server(LOOP)
    from mirdrake.tuning.spec import load_tuning

    spec = load_tuning(path, overrides=options.set)
    from mirdrake.tuning.tune import StoppedError, tune

    folder = options.out or Path("runs") / f"tune-{spec.name}"
    bar = _Bar(talks=not options.quiet and sys.stderr.isatty())
    executor: Any = None
    client: Any = None
    if options.scheduler is not None:
        client = _dask(options.scheduler)
        executor = client.get_executor()
    try:
        result = tune(spec, out=folder, executor=executor, workers=options.workers, progress=bar)
    except StoppedError as stop:
        bar.end()
        print(str(stop), file=sys.stderr)
        return 130
    finally:
        bar.end()
        if client is not None:
            client.close()
    _report(result)
    met = all(row["met"] for row in result.data["acceptance"])
    if not options.quiet:
        _show(result)
    return 0 if met else 1


def _report(result: Any) -> None:
    from mirdrake.report.tuning import write_tuning_report  # Matplotlib takes half a second

    write_tuning_report(result.folder)


def _dask(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise MissingDependencyError("--scheduler needs Dask: pip install 'mirdrake[cluster]'") from None
    from mirdrake.core.errors import RunError

    try:
        return Client(address, timeout="10s")
    except Exception as error:
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise RunError(f"--scheduler {address}: no scheduler answers there: {line}") from None


def _show(result: Any) -> None:
    """The candidates, and what was reached."""
    data = result.data
    names = list(data["loop"]["gains"])
    width = max(len(str(one["name"])) for one in data["candidates"])
    units = ", ".join(f"{name} [{entry['unit']}]" for name, entry in data["loop"]["gains"].items())
    print(f"{data['name']}: {units}")
    for one in data["candidates"]:
        gains = "  ".join(f"{one['gains'][name]:>9.4g}" for name in names)
        cost = "        -" if one["cost"] is None else f"{one['cost']:9.4g}"
        word = "best" if one["name"] == data["best"] else "" if one["feasible"] else one["status"]
        word = "breaks a constraint" if word == "ok" else word
        print(f"  {one['name']:<{width}}  {gains}  cost {cost}  {word}")
    for row in data["acceptance"]:
        value = "-" if row["value"] is None else f"{row['value']:.3g}"
        limit = "-" if row["limit"] is None else f"{row['limit']:.3g}"
        print(f"  {'met    ' if row['met'] else 'NOT met'} {row['what']}: {value} (limit {limit})")
    if data["best"] is None:
        print("  no candidate meets the constraints; relax them, widen search.ranges, or give more trials")
    print(f"  {result.folder}")


class _Bar:
    """A line with stage, share and time left; nothing without a terminal."""

    def __init__(self, *, talks: bool) -> None:
        self.talks, self._shown = talks, False

    def __call__(self, stage: str, done: int, total: int, left: float) -> None:
        if not self.talks:
            return
        time_left = "" if not math.isfinite(left) else f", {left / 60.0:.0f}:{left % 60.0:02.0f} left"
        part = done / max(total, 1)
        print(f"\r\033[K{stage:<14} |{'#' * round(30 * part):<30}| {done}/{total}{time_left}", end="", file=sys.stderr)
        sys.stderr.flush()
        self._shown = True

    def end(self) -> None:
        """Clear the line."""
        if self._shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
            self._shown = False

"""Options, checks and output that several verbs share."""

import argparse
import contextlib
import math
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mirdrake.core.errors import ConfigError, did_you_mean, first_line
from mirdrake.core.extras import import_extra
from mirdrake.core.paths import missing_file, names
from mirdrake.core.yaml_io import display_path, to_si

if TYPE_CHECKING:
    from mirdrake.assembly.diagram import Assembly
    from mirdrake.assembly.scene import Scene

# --- options ---------------------------------------------------------------------------------------------------------


def add_set(parser: argparse.ArgumentParser, example: str = "control.ego.speed=8") -> None:
    """Add the option ``--set``."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help=f"override a key of the file, for example {example} (repeatable)",
    )


def add_param(parser: argparse.ArgumentParser, **kwargs: Any) -> None:
    """Add the option ``--param`` for parameters of a world."""
    parser.add_argument(
        "-p",
        "--param",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of a parameter of the world, or of seed, for example mu=0.3 (repeatable)",
        **kwargs,
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--trust``."""
    parser.add_argument("--trust", action="store_true", help="execute user modules that the file names")


def assemble_for_display(name: str, overrides: Sequence[str], *, trust: bool) -> "tuple[Assembly, list[str]]":
    """Return a diagram with the blocks of its control units, and what was left out of it, one line each.

    Args:
        name: name or path of a diagram file.
        overrides: overrides of the option ``--set``.
        trust: whether user modules are executed; otherwise what they define is left out.
    """
    from mirdrake.assembly.diagram import assemble, load_diagram
    from mirdrake.assembly.diagram_spec import without_user_systems
    from mirdrake.core.user_modules import without_user_code

    spec = load_diagram(name, overrides=overrides)
    skipped: list[str] = []
    if not trust:
        spec, skipped = without_user_systems(spec)
    with contextlib.nullcontext() if trust else without_user_code():
        return assemble(spec, expand=True), skipped


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--quiet``."""
    parser.add_argument("--quiet", action="store_true", help="print only errors")


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the options ``--workers`` and ``--scheduler``."""
    parser.add_argument("--workers", type=whole_number(0), metavar="N", help="processes (default: one per core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="address of a Dask scheduler; its workers do the work")


def whole_number(low: int, high: int = 100_000) -> Any:
    """Return a converter of argparse that accepts whole numbers within limits."""

    def parse(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is not allowed; expected a whole number from {low} to {high}")
        return int(text)

    return parse


def positive_quantity(unit: str, example: str) -> Any:
    """Return a type of an option: a positive finite number in an SI unit, or with a unit as in YAML files."""

    def parse(text: str) -> float:
        try:
            value = to_si(text, unit)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"'{text}': {error}") from None
        if not isinstance(value, float):
            raise argparse.ArgumentTypeError(f"'{text}' is not a number in {unit}, or with a unit such as {example}")
        if not 0.0 < value < math.inf:
            raise argparse.ArgumentTypeError(f"'{text}' is not allowed; expected a positive number in {unit}")
        return value

    return parse


positive_time = positive_quantity("s", "1 min")
"""Type of an option: a positive finite time [s], also with a unit."""

positive_length = positive_quantity("m", "250 cm")
"""Type of an option: a positive finite length [m], also with a unit."""


def parse_pairs(option: str, texts: Sequence[str], example: str = "") -> dict[str, str]:
    """Return ``NAME=VALUE`` texts as a mapping.

    Raises:
        ConfigError: a text has another form.
    """
    pairs = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not mark or not name:
            raise ConfigError(f"{option} {text}: expected NAME=VALUE{f', {example}' if example else ''}")
        pairs[name] = value
    return pairs


def parse_names(text: str) -> list[str]:
    """Return comma-separated names; "none" and an empty text are an empty list."""
    return [name for part in text.split(",") if (name := part.strip()) not in {"", "none"}]


def world_overrides(options: argparse.Namespace) -> tuple[str, ...]:
    """Return ``--set`` and ``--param`` of a world as overrides of its file."""
    given = (text if text.partition("=")[0].strip() == "seed" else f"params.{text}" for text in options.param)
    return (*options.set, *given)


def core_count() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# --- kinds of names, folders of results ------------------------------------------------------------------------------


def kind_of(name: str) -> str:
    """Return the kind of a name or path: "models", "worlds", "diagrams", "studies", "runs" or "files".

    "files" are files of other formats of :data:`mirdrake.schemas.KINDS`, such as a data set or a prop.

    Raises:
        ConfigError: nothing has that name.
    """
    path = Path(name)
    # Files come before names: a folder that the user names may be called like a model of the library.
    if (path / "spec.yaml").is_file():
        return "runs"
    # A variant has no folder of its own, except that a folder may have an @ in its name.
    model = name.rpartition("@")[0] or name  # bolt@published
    if any((Path(folder) / "vehicle.yaml").is_file() or folder in names("models") for folder in (name, model)):
        return "models"
    if path.suffix in {".yaml", ".yml"} and path.is_file():
        from mirdrake.schemas import format_of

        kinds = {"world": "worlds", "diagram": "diagrams", "study": "studies", "tuning": "studies"}
        return (kinds | {"identification": "studies", "learning": "studies"}).get(format_of(path), "files")
    for kind in ("worlds", "diagrams", "studies"):
        if name in names(kind):
            return kind
    known = [name for kind in ("models", "worlds", "diagrams", "studies") for name in names(kind)]
    if not path.exists() and (os.sep in name or path.suffix in {".yaml", ".yml"}):
        raise ConfigError(f"'{name}': {missing_file(path)}")
    raise ConfigError(f"unknown name '{name}'; {did_you_mean(name, known)}")


def new_folder(given: Path | None, stem: str) -> Path:
    """Return the folder for results: the given one if it is empty or missing, else ``runs/<stem>-<UTC time>``.

    Raises:
        RunError: the given folder is not empty.
    """
    from mirdrake.runs.logs import occupied
    from mirdrake.runs.simulation import default_folder

    folder = given or default_folder(stem)
    if folder.exists() and any(folder.iterdir()):
        raise occupied(folder)
    return folder


@contextmanager
def open_dask(address: str | None) -> Iterator[Any]:
    """Yield the executor of a Dask scheduler; None without an address.

    Raises:
        MissingDependencyError: Dask is not installed.
        ConfigError: no scheduler answers at the address, or it has no workers.
    """
    if address is None:
        yield None
        return
    # Dask is an extra, which only clusters need.
    distributed = import_extra("distributed", need="--scheduler needs Dask", extra="cluster")
    try:
        client: Any = distributed.Client(address, timeout="10 s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            f"--scheduler {address}: no Dask scheduler answers ({first_line(error)}); start one with: dask scheduler"
        ) from None
    with client:
        # Without workers the study would never begin.
        if not client.scheduler_info()["workers"]:
            raise ConfigError(f"--scheduler {address}: it has no workers; start some with: dask worker {address}")
        with client.get_executor() as executor:
            yield executor


@contextlib.contextmanager
def terminated_like_interrupted() -> Iterator[None]:
    """Handle SIGTERM as Ctrl-C within the block, so that finished work is kept."""

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


# --- output ----------------------------------------------------------------------------------------------------------


def print_files(folder: Path, files: Sequence[tuple[str, str]], *, note: str = "", indent: str = "") -> None:
    """Print a folder and, of the given (file, meaning), those that it holds."""
    print(f"{indent}{display_path(folder)}/{note}")
    width = max((len(name) for name, _ in files), default=0)
    for name, meaning in files:
        if (folder / name).is_file():
            print(f"{indent}  {name:{width}}  {meaning}")


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table; each column but the last is as wide as its widest cell."""
    if not rows:
        return
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head) - 1)]
    for row in (head, *rows):
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        yield "  ".join([*cells, row[-1]]).rstrip()


def skipped_lines(names: Iterable[str], verb: str, done: str) -> list[str]:
    """Return a line for each part of a file that was left out because its code was not executed."""
    return [f"not {done}: {name}: mirdrake {verb} executes user modules only with --trust" for name in names]


def print_changes(scene: "Scene") -> None:
    """Print a note for each mesh that has changed since a run."""
    for line in scene.changes:
        print(f"note: {line}", file=sys.stderr)

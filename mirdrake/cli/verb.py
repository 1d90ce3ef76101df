"""What several verbs share."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import names

if TYPE_CHECKING:
    from mirdrake.assembly.scene import Scene


def add_set(parser: argparse.ArgumentParser) -> None:
    """The option ``--set``."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a key of the file, for example control.ego.speed=8; may be given again",
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--trust``."""
    parser.add_argument("--trust", action="store_true", help="execute modules of your own that the file names")


def not_executed(names: Iterable[str]) -> list[str]:
    """Return a line for each part of a file that was left out, as its code was not executed."""
    return [f"not checked: {name}: a module of your own is executed with --trust only" for name in names]


def print_changes(scene: "Scene") -> None:
    """Print a note for each mesh that has changed since a run."""
    for line in scene.changes:
        print(f"note: {line}", file=sys.stderr)


def kind_of(name: str) -> str:
    """Return what a name or path stands for: "models", "worlds", "diagrams", "studies", "runs" or "files".

    "files" are files of other formats of :data:`mirdrake.schemas.KINDS`, as a data set or a prop.

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
        from mirdrake.schemas import format_of

        kinds = {"world": "worlds", "diagram": "diagrams", "study": "studies", "tuning": "studies"}
        return (kinds | {"identification": "studies"}).get(format_of(path), "files")
    for kind in ("worlds", "diagrams", "studies"):
        if name in names(kind):
            return kind
    known = [name for kind in ("models", "worlds", "diagrams", "studies") for name in names(kind)]
    raise ConfigError(f"nothing is called '{name}'; {did_you_mean(name, known)}")

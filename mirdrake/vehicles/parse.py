"""URDF text into a throw-away Drake plant, quietly."""

import contextlib
import logging
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from pydrake.geometry import SceneGraph
from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant

from mirdrake.core.drake_errors import urdf_fault
from mirdrake.core.errors import ModelError

_HINT = re.compile(r'(<drake:mesh_resolution_hint value=")([0-9.eE+-]+)(")')


def make_package_map(packages: Mapping[str, str]) -> PackageMap:
    """Return a package map with these packages only, so that nothing is downloaded."""
    package_map = PackageMap.MakeEmpty()
    for name, folder in packages.items():
        package_map.Add(name, Path(folder))
    return package_map


def parse_urdf(
    text: str, *, packages: Mapping[str, str], where_line: Callable[[int], str]
) -> tuple[MultibodyPlant, SceneGraph, tuple[str, ...]]:
    """Parse a vehicle alone into a plant, finalise it, and collect Drake's warnings.

    The plant is there to be measured, not simulated: hydroelastic meshes are made coarse, which saves most of the time.

    Args:
        text: URDF.
        packages: package name -> folder.
        where_line: ``file:line`` in the source of a line of `text`.

    Returns:
        plant, scene graph (keep both alive), warnings.

    Raises:
        ModelError: Drake cannot parse the text.
    """
    scene_graph = SceneGraph()
    plant = MultibodyPlant(time_step=0.001)
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    parser = Parser(plant)
    parser.package_map().AddMap(make_package_map(packages))

    def placed(message: str) -> ModelError:
        line, reason = urdf_fault(message)
        return ModelError(reason, where=where_line(line))

    # Drake reports some faults as warnings only; they are returned with their line.
    with drake_log() as messages:
        try:
            parser.AddModelsFromString(_coarse(text), "urdf")
            plant.Finalize()
        except (Exception, SystemExit) as error:  # a failed assertion in Drake arrives as SystemExit
            raise placed(str(error)) from None
    return plant, scene_graph, tuple(dict.fromkeys(str(placed(message)) for message in messages))


def _coarse(text: str) -> str:
    """Return the text with resolution hints [m] of at least 1."""

    def coarser(match: re.Match[str]) -> str:
        try:
            hint = float(match.group(2))
        except ValueError:
            return match.group(0)
        # Hints that are not above zero are left as they are, for the checks of numbers and for Drake.
        return f"{match.group(1)}{max(hint, 1.0)}{match.group(3)}" if hint > 0.0 else match.group(0)

    return _HINT.sub(coarser, text)


@contextlib.contextmanager
def drake_log() -> Iterator[list[str]]:
    """Collect Drake's log messages, from warnings up, instead of printing them."""
    messages: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    logger = logging.getLogger("drake")
    # The logger belongs to the process: its handlers are put back, also after an error.
    handlers, propagate = logger.handlers[:], logger.propagate
    logger.handlers, logger.propagate = [Collector(level=logging.WARNING)], False
    try:
        yield messages
    finally:
        logger.handlers, logger.propagate = handlers, propagate

"""A vehicle, world, diagram or run in a notebook: a 3D view in the output of a cell, which stays when the kernel ends.

::

    from mirdrake.viewer.inline import show

    show(mir.load_vehicle("bolt"))
    run.animate()  # the same as show(run)

The view is a page of its own inside the cell: it needs no port, no network and no other tab, and it is saved with the
notebook. Outside a notebook, :meth:`InlineView.save` writes the same page into a file.
"""

from html import escape
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.scene import make_scene
from mirdrake.core.errors import ConfigError
from mirdrake.core.files import write_file
from mirdrake.runs.logs import Run
from mirdrake.runs.plots import Animation
from mirdrake.vehicles import Vehicle
from mirdrake.viewer.meshcat import offline_meshcat
from mirdrake.viewer.recording import recording_page
from mirdrake.viewer.show import show_diagram, show_vehicle, show_world
from mirdrake.worlds import World, load_world


class InlineView:
    """A Meshcat page that a notebook shows.

    Args:
        page: the HTML page.
        height: height of the view [px].
    """

    def __init__(self, page: str, *, height: int = 420) -> None:
        self.page, self.height = page, height

    def _repr_html_(self) -> str:
        """Return the HTML element for a notebook."""
        return (
            f'<iframe srcdoc="{escape(self.page, quote=True)}" width="100%" height="{self.height}" '
            'style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        """Return a hint for consoles."""
        return '3D view: shown in a notebook; .save("view.html") writes it to a file'

    def save(self, path: Path | str) -> Path:
        """Write the page to a file that opens offline.

        Raises:
            RunError: the file cannot be written.
        """
        write_file(Path(path), self.page)
        return Path(path)


class RunView(InlineView, Animation):
    """The animation of a run; see :meth:`mirdrake.Run.animate`."""

    @classmethod
    def of_run(cls, run: Run, *, height: int, frames_per_second: float) -> "RunView":
        """Return the animation of a run.

        Raises:
            RunError: the run has no scene or no samples.
        """
        return cls(recording_page(run, frames_per_second=frames_per_second), height=height)


def show(content: Vehicle | World | DiagramSpec | Run | Meshcat, *, height: int = 420, **options: Any) -> InlineView:
    """Return a 3D view for a notebook; it is shown as the last value of a cell.

    Args:
        content: a vehicle, a world, a diagram spec, a run, or a Meshcat with your own drawing.
        height: height of the view [px].
        **options: of a vehicle ``frames``, ``collision``, ``meshes``; of a run ``frames_per_second``.

    Raises:
        ConfigError: the object has another type.
    """
    if isinstance(content, Meshcat):
        return InlineView(content.StaticHtml(), height=height)
    if isinstance(content, Run):
        # A recording of a notebook is small at 20 frames per second.
        return RunView.of_run(content, height=height, **{"frames_per_second": 20.0} | options)
    scene = make_scene(content) if isinstance(content, DiagramSpec) else None
    if scene is not None:
        world = scene.world
    elif isinstance(content, Vehicle):
        world = load_world("empty")
    elif isinstance(content, World):
        world = content
    else:
        raise ConfigError(
            f"show: cannot show a {type(content).__name__}; expected a vehicle, world, diagram spec, run or Meshcat"
        )
    # The page contains everything, so that the notebook shows it without a server.
    with offline_meshcat(world=world) as meshcat:
        if isinstance(content, Vehicle):
            show_vehicle(content, meshcat, **options)
        elif isinstance(content, World):
            show_world(content, meshcat, **options)
        else:
            show_diagram(content, meshcat, scene=scene, **options)
        page = meshcat.StaticHtml()
    return InlineView(page, height=height)

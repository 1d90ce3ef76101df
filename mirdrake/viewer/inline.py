"""A vehicle, world, diagram or run in a notebook: a 3D view in the output of a cell, which stays when the kernel ends.

::

    from mirdrake.viewer.inline import show

    show(mir.load_vehicle("bolt"))

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
from mirdrake.vehicles import Vehicle
from mirdrake.viewer.meshcat import make_offline_meshcat
from mirdrake.viewer.recording import draw_run
from mirdrake.viewer.show import show_diagram, show_vehicle, show_world
from mirdrake.worlds import World, load_world


class InlineView:
    """A Meshcat page that a notebook shows.

    Args:
        page: the HTML page.
        height: of the view [px].
    """

    def __init__(self, page: str, *, height: int = 420) -> None:
        self.page, self.height = page, height

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return (
            f'<iframe srcdoc="{escape(self.page, quote=True)}" width="100%" height="{self.height}" '
            'style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        """Where there is no page to show."""
        return 'a 3D view; a notebook shows it, and .save("view.html") writes it into a file'

    def save(self, path: Path | str) -> Path:
        """The page as a file that opens offline.

        Raises:
            RunError: it cannot be written.
        """
        write_file(Path(path), self.page)
        return Path(path)


def show(thing: Vehicle | World | DiagramSpec | Run | Meshcat, *, height: int = 420, **options: Any) -> InlineView:
    """Show something in a notebook; make it the last line of a cell.

    Args:
        thing: a vehicle, a world, a diagram spec, a run, or a Meshcat with what you drew.
        height: of the view [px].
        **options: of a vehicle ``frames``, ``collision``, ``meshes``; of a run ``frames_per_second``.

    Raises:
        ConfigError: it is none of these.
    """
    if isinstance(thing, Meshcat):
        return InlineView(thing.StaticHtml(), height=height)
    if isinstance(thing, Vehicle):
        meshcat = make_offline_meshcat(world=load_world("empty"))
        show_vehicle(thing, meshcat, **options)
    elif isinstance(thing, World):
        meshcat = make_offline_meshcat(world=thing)
        show_world(thing, meshcat, **options)
    elif isinstance(thing, DiagramSpec):
        scene = make_scene(thing)
        meshcat = make_offline_meshcat(world=scene.world)
        show_diagram(thing, meshcat, scene=scene, **options)
    elif isinstance(thing, Run):
        meshcat = make_offline_meshcat(world=thing.scene().world)
        draw_run(thing, meshcat, **options)
    else:
        raise ConfigError(
            f"show: a {type(thing).__name__} cannot be shown; give a vehicle, a world, a diagram spec or a run"
        )
    return InlineView(meshcat.StaticHtml(), height=height)

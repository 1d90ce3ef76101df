"""``mirdrake view``: show a vehicle, a world, a diagram or a run in Meshcat."""

import argparse
import contextlib
import time
from functools import partial
from pathlib import Path
from typing import Any

from mirdrake.cli.common import kind_of, print_changes
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path

MORE = """\
The page of a vehicle has a slider for every joint, and buttons that show and hide frames (key F), collision shapes (C)
and meshes (M); the options below set the initial view. Escape in the page or Ctrl-C in the terminal ends it.
The pages of a diagram and a run have the views follow, cockpit and map (keys 1, 2, 3).

examples:
  mirdrake view bolt
  mirdrake view bolt --collision --no-meshes     only the collision shapes
  mirdrake view test_track --out track.html      a page that opens offline"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("name", help="name or path of a vehicle, a world, a diagram or a run folder")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write an HTML page that opens offline, and stop")
    vehicle = parser.add_argument_group("for a vehicle")
    vehicle.add_argument("--frames", action="store_true", help="show the frame of every link, and the centre of mass")
    vehicle.add_argument("--collision", action="store_true", help="show the collision shapes")
    vehicle.add_argument("--no-meshes", action="store_true", help="hide the meshes")


def run(options: argparse.Namespace) -> int:
    """Write the page, or show it until it is closed or Ctrl-C is pressed."""
    from mirdrake.assembly.diagram_spec import load_diagram
    from mirdrake.assembly.scene import make_scene
    from mirdrake.core.files import write_file
    from mirdrake.runs.logs import load_run, reads_run
    from mirdrake.vehicles import load_vehicle
    from mirdrake.viewer import make_meshcat, show_diagram, show_vehicle, show_world
    from mirdrake.viewer.meshcat import make_offline_meshcat, meshcat_faults
    from mirdrake.viewer.recording import draw_run, recording_page, views_of
    from mirdrake.viewer.show import write_page
    from mirdrake.viewer.views import ViewButtons, make_views
    from mirdrake.worlds import load_world

    # Options that have no effect on this kind are rejected before anything is loaded.
    kind = kind_of(options.name)
    if kind in {"studies", "files"}:
        raise ConfigError(f"'{options.name}' is a study or a data file and cannot be shown")
    layers = [f"--{name.replace('_', '-')}" for name in ("frames", "collision", "no_meshes") if getattr(options, name)]
    if layers and kind != "models":
        raise ConfigError(f"only for a vehicle; '{options.name}' is not a vehicle", where=", ".join(layers))

    # A file is drawn by a Meshcat that serves no page.
    title = Path(options.name).stem
    # The sliders of a vehicle are in Meshcat's controls.
    make = (
        partial(make_meshcat, title=title, controls=kind == "models") if options.out is None else make_offline_meshcat
    )
    sliders: Any = None
    diagram: Any = None
    views: tuple[Any, ...] = ()
    # A recorded run is drawn with its own scene, and has no diagram to simulate.
    if kind == "runs":
        run = load_run(options.name)
        print_changes(run.scene())
        if options.out is not None:
            write_file(options.out, reads_run(recording_page)(run))
            print(display_path(options.out))
            return 0
        meshcat = make(world=run.scene().world)
        reads_run(draw_run)(run, meshcat)
        views = reads_run(views_of)(run)
    elif kind == "diagrams":
        spec = load_diagram(options.name)
        scene = make_scene(spec)
        meshcat = make(world=scene.world)
        diagram = show_diagram(spec, meshcat, scene=scene)
        views = make_views(next(iter(scene.vehicles.values())))
    elif kind == "worlds":
        world = load_world(options.name)
        meshcat = make(world=world)
        diagram = show_world(world, meshcat)
    else:
        meshcat = make(world=load_world("empty"))
        diagram, sliders = show_vehicle(
            load_vehicle(options.name),
            meshcat,
            frames=options.frames,
            collision=options.collision,
            meshes=not options.no_meshes,
        )

    # An interactive view runs until Escape or Ctrl-C; each kind has its own loop, as only vehicles have sliders.
    if options.out is not None:
        write_page(meshcat, options.out, views=views)
        print(display_path(options.out))
        return 0
    print(f"Meshcat: {meshcat.web_url()}  (Ctrl-C ends)", flush=True)
    with contextlib.suppress(KeyboardInterrupt), meshcat_faults():
        if sliders is not None:
            sliders.Run(diagram, stop_button_keycode="Escape")
        elif views:
            buttons = ViewButtons(meshcat, views)
            while True:
                buttons.follow()
                time.sleep(0.05)
        else:
            while True:
                meshcat.GetNumActiveConnections()
                time.sleep(0.5)
    return 0

"""A cockpit with its page: Meshcat, the drive and the server together."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from math import inf
from pathlib import Path
from typing import Any

from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.scene import make_scene
from mirdrake.viewer.cockpit.drive import Cockpit
from mirdrake.viewer.cockpit.gains import slider_of
from mirdrake.viewer.cockpit.server import make_server
from mirdrake.viewer.cockpit.start import NAME
from mirdrake.viewer.cockpit.watchdog import TIMEOUT
from mirdrake.viewer.meshcat import make_meshcat_behind

REMIND = 20.0
"""Time without a page after which the address is repeated [s]."""


class OpenCockpit:
    """A drive with its page on this machine; use it as a context manager, in the thread that made it.

    Args:
        spec: result of :func:`mirdrake.viewer.cockpit.drive_spec`.
        port: port of localhost; None takes the first free one from 8765 on, 0 any free one.
        print_line: prints a message of one line.
        folder: returns the folder of a recording.
        timeout: watchdog timeout without input, after which the vehicle brakes [s].
        remind: time without a page after which the address is repeated [s].

    Attributes:
        drive: the drive.
        url: address of the page.

    Raises:
        ConfigError, ModelError, WorldError, DiagramError: the diagram cannot be built.
        RunError: the port is taken.
    """

    def __init__(
        self,
        spec: DiagramSpec,
        *,
        port: int | None = None,
        print_line: Callable[[str], None] = lambda _: None,
        folder: Callable[[], Path] | None = None,
        timeout: float = TIMEOUT,
        remind: float = REMIND,
    ) -> None:
        self._print_line, self._remind = print_line, remind
        # One scene for the simulation and its picture.
        scene = make_scene(spec)
        self._meshcat, upstream = make_meshcat_behind(world=scene.world)
        self.drive = Cockpit(
            spec, scene=scene, meshcat=self._meshcat, print_line=print_line, folder=folder, timeout=timeout
        )
        self._server = make_server(
            upstream=upstream,
            about=self._about(),
            report=self._report,
            order=self.drive.order,
            port=port,
        )
        self.url = self._server.url
        self._reminded = time.monotonic()

    def __enter__(self) -> "OpenCockpit":
        self._server.start()
        return self

    def __exit__(self, *fault: object) -> None:
        self._server.close()

    def run(self, *, duration: float = inf) -> None:
        """Drive until Ctrl-C, or for a wall-clock time [s], inside ``with``."""
        self.drive.run(duration=duration, watch=self._watch)

    def _report(self, page: str, message: Mapping[str, Any]) -> Mapping[str, object]:
        self.drive.watchdog.report(page, message)
        return self.drive.readings

    def _watch(self) -> None:
        now = time.monotonic()
        if now - self._reminded > self._remind:
            self._reminded = now
            if self.drive.watchdog.silence > self._remind:
                self._print_line(f"no page is open; the cockpit is at {self.url}")

    def _about(self) -> dict[str, object]:
        """Return the data of the page that do not change."""
        drive, assembly = self.drive, self.drive.assembly
        assert drive.picture is not None
        assert drive.overlays is not None
        limits, track = drive.limits, assembly.parts.world.tracks.get(assembly.tracks[NAME] or "")
        # The page draws the lane beside the path; worlds without tracks get a usual half width [m].
        lane = 2.0
        if track is not None:
            lane = max(0.5, float(min(track.left_width(0.0), track.right_width(0.0))))
        return {
            "vehicle": drive.part.vehicle.spec.name,
            "world": assembly.parts.world.name.replace("_", " "),
            "views": [asdict(view) for view in drive.picture.views.values()],
            "layers": list(drive.overlays.there),
            "gains": [slider_of(gain) for gain in drive.gains],
            "signals": drive.signals,
            "forward": limits.forward,
            "backward": limits.backward,
            "steering": limits.steering,
            "lane": lane,
        }

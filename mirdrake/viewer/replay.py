"""Replay of a run: the Meshcat recording with a panel of synchronised camera pictures.

On this machine a server delivers each picture on request. A page that opens offline contains the pictures, reduced in
size and number.
"""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mirdrake.core.errors import RunError
from mirdrake.core.files import write_file
from mirdrake.core.recording.pictures import Picture
from mirdrake.runs.logs import Run, reads_run
from mirdrake.viewer.pages import add_to_body, data_address
from mirdrake.viewer.recording import recording_page
from mirdrake.viewer.server import Answer, PageServer

WIDTH = 400
"""Width of pictures in a page that opens offline [pixel]."""

QUALITY = 75
"""JPEG quality of these pictures."""

MOST = 2400
"""Largest number of pictures in a page that opens offline; longer runs are thinned."""

_PANEL = """
<style>
  #cameras { position: fixed; left: 12px; bottom: 64px; width: 32vw; max-height: calc(100vh - 84px); overflow: hidden;
    z-index: 2; font: 13px/1.4 system-ui, sans-serif; color: #fff; text-shadow: 0 0 3px #000; }
  #cameras figure { margin: 8px 0 0 0; background: rgba(20, 24, 30, .82); border-radius: 6px; overflow: hidden; }
  #cameras img { display: block; width: 100%; }
  #cameras figcaption { padding: 3px 8px; font-variant-numeric: tabular-nums; }
</style>
<div id="cameras"></div>
<script id="pictures" type="application/json">DATA</script>
<script>
(() => {
  const cameras = JSON.parse(document.getElementById("pictures").textContent);
  const panel = document.getElementById("cameras");
  for (const camera of cameras) {
    const figure = document.createElement("figure");
    camera.image = document.createElement("img");
    camera.image.alt = camera.name;
    camera.caption = document.createElement("figcaption");
    figure.append(camera.image, camera.caption);
    panel.append(figure);
    camera.shown = -1;
  }
  const now = () => Math.max(0, ...viewer.animator.actions.map(action => action.time));
  function last(times, time) {  // the last one that is not later
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= time + 1e-4) low = middle + 1; else high = middle;
    }
    return Math.max(low - 1, 0);
  }
  function follow() {
    const time = now();
    for (const camera of cameras) {
      const index = last(camera.times, time);
      if (index === camera.shown) continue;
      camera.shown = index;
      camera.image.src = camera.sources[index];
      const degrees = camera.steering[index] * 180 / Math.PI;
      const side = Math.abs(degrees) < 0.05 ? "" : degrees > 0 ? " left" : " right";
      camera.caption.textContent = `${camera.name} · ${camera.times[index].toFixed(2)} s · ` +
        `${camera.speed[index].toFixed(2)} m/s · ${Math.abs(degrees).toFixed(1)}°${side}`;
    }
    requestAnimationFrame(follow);
  }
  requestAnimationFrame(follow);
})();
</script>
"""


@reads_run
def write_replay(run: Run, path: Path) -> None:
    """Write a page that opens offline.

    Args:
        run: run with a folder and signals, with or without pictures.
        path: path of the page.

    Raises:
        RunError: the run has no samples, or the page cannot be written.
    """
    total = sum(len(pictures) for pictures in run.pictures.values())
    # Rounded up: all cameras together stay below the limit.
    stride = -(-total // MOST) if total else 1
    chosen = {name: pictures[::stride] for name, pictures in run.pictures.items()}
    write_file(path, _page(run, chosen, lambda _, picture: embedded(picture)))


class Replay:
    """A page on this machine with every picture of a run.

    Args:
        run: run with a folder and signals.
        port: port to listen on; 0 takes any free one.

    Attributes:
        url: address of the page.

    Raises:
        RunError: the run has no samples, or the port is taken.
    """

    def __init__(self, run: Run, *, port: int = 0) -> None:
        page = reads_run(_page)(run, run.pictures, _address).encode()
        # Only addresses made here are served, so that a request cannot reach other files.
        pictures = {_address(name, p): p for name, taken in run.pictures.items() for p in taken}

        def files(path: str) -> Answer | None:
            if path == "":
                return page, "text/html; charset=utf-8"
            picture = pictures.get(path)
            return visible(picture) if picture is not None and picture.path.is_file() else None

        self._server = PageServer("the replay", ports=[port], files=files)
        self.url = self._server.url

    def serve(self) -> None:
        """Serve until :meth:`close` or Ctrl-C."""
        self._server.serve()

    def close(self) -> None:
        """Stop serving; to be called from another thread, or after :meth:`serve`."""
        self._server.close()


def _address(name: str, picture: Picture) -> str:
    return f"pictures/{name}/{picture.path.name}"


def visible(picture: Picture) -> tuple[bytes, str]:
    """Return a picture for a browser and its content type; depths and labels are grey levels."""
    if picture.path.suffix == ".jpg":
        return picture.path.read_bytes(), "image/jpeg"
    file = io.BytesIO()
    Image.fromarray(grey(picture.pixels)).save(file, "PNG", compress_level=1)
    return file.getvalue(), "image/png"


def grey(numbers: Any) -> Any:
    """Return 16-bit numbers as grey levels: the largest is white, 0 black."""
    return (255.0 * numbers / max(int(numbers.max()), 1)).astype(np.uint8)


def embedded(picture: Picture) -> str:
    """Return a picture, at most :data:`WIDTH` wide, as a ``data:`` address."""
    with Image.open(picture.path) as image:
        small = image if image.mode == "RGB" else Image.fromarray(grey(np.asarray(image)))
        if small.width > WIDTH:
            small = small.resize((WIDTH, max(1, round(small.height * WIDTH / small.width))))
        file = io.BytesIO()
        small.save(file, "JPEG", quality=QUALITY)
    return data_address(file.getvalue(), "image/jpeg")


def _page(run: Run, pictures: Mapping[str, Sequence[Picture]], source: Callable[[str, Picture], str]) -> str:
    """Return the Meshcat recording of a run with the panel of its cameras."""
    if run.signals.empty:
        raise RunError("has no samples to replay", where=str(run.folder))
    page = recording_page(run)
    start = float(run.signals.index[0])
    cameras = [
        {
            "name": name,
            "times": [round(picture.time - start, 6) for picture in taken],
            "steering": [round(picture.steering, 5) for picture in taken],
            "speed": [round(picture.speed, 4) for picture in taken],
            "sources": [source(name, picture) for picture in taken],
        }
        for name, taken in pictures.items()
        if taken
    ]
    if not cameras:
        return page
    # "</script>" in a name would end the script element.
    data = json.dumps(cameras).replace("</", "<\\/")
    return add_to_body(page, _PANEL.replace("DATA", data))

"""The page of a drive: Meshcat's own with the cockpit over it.

The page sends the input of the driver about thirty times a second and receives the readings of the gauges. Messages of
a page that is closed, hidden or hangs stop, and the watchdog timeout follows.
"""

import json
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

from mirdrake.viewer.pages import add_to_body, with_title
from mirdrake.viewer.private_meshcat import Upstream
from mirdrake.viewer.server import PageServer

PORT = 8765
"""First port to try."""

_TRIED = 20  # ports from there on


def make_server(
    *,
    upstream: Upstream,
    about: Mapping[str, Any],
    report: Callable[[str, Mapping[str, Any]], Mapping[str, object]],
    order: Callable[[Mapping[str, Any]], None],
    port: int | None = None,
) -> PageServer:
    """Return the server of a drive.

    Args:
        upstream: the Meshcat that is shown.
        about: data of the page that does not change, for JSON.
        report: called with the page's name and its message, returns the readings; in threads of the server.
        order: called with the request of a button; likewise.
        port: port of localhost; None takes the first free one from :data:`PORT` on, 0 any free one.

    Raises:
        RunError: the port is taken.
    """
    page = _page(upstream, about).encode()

    def ordered(message: Mapping[str, Any]) -> Mapping[str, object]:
        order(message)
        return {}

    return PageServer(
        "the cockpit",
        ports=[port] if port is not None else [*range(PORT, PORT + _TRIED), 0],
        files=lambda path: (page, "text/html; charset=utf-8") if path == "" else None,
        posts={"report": lambda message: report(str(message.get("page", "")), message), "order": ordered},
        upstream=upstream,
    )


def _page(upstream: Upstream, about: Mapping[str, Any]) -> str:
    """Return Meshcat's page with the cockpit in front."""
    page = upstream.get("/")[2].decode()
    folder = files(__package__)
    parts = {name: (folder / name).read_text(encoding="utf-8") for name in ("page.html", "page.css", "page.js")}
    data = json.dumps(about).replace("</", "<\\/")
    over = (
        f"<style>\n{parts['page.css']}</style>\n{parts['page.html']}"
        f'<script id="about" type="application/json">{data}</script>\n<script>\n{parts["page.js"]}</script>\n'
    )
    return with_title(add_to_body(page, over), "mirdrake drive")

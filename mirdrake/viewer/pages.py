"""Additions to HTML pages."""

import base64
import html


def add_to_body(page: str, addition: str) -> str:
    """Return a page of Meshcat with HTML at the end of its body."""
    head, mark, tail = page.rpartition("</body>")
    assert mark, "Meshcat's page has no body"
    return head + addition + mark + tail


def with_title(page: str, title: str) -> str:
    """Return a page of Meshcat with a title of its own."""
    return page.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>", 1)


def with_open_controls(page: str) -> str:
    """Return a page of Meshcat whose controls are open, and wide enough for the names of sliders."""
    return add_to_body(page, "<script>viewer.gui.width = Math.min(400, window.innerWidth); viewer.gui.open();</script>")


def data_address(content: bytes, kind: str) -> str:
    """Return content of a media type as a ``data:`` address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"

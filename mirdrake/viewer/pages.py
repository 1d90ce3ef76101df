"""Additions to HTML pages."""

import base64


def add_to_body(page: str, addition: str) -> str:
    """Return a page of Meshcat with HTML at the end of its body."""
    head, mark, tail = page.rpartition("</body>")
    assert mark, "Meshcat's page has no body"
    return head + addition + mark + tail


def data_address(content: bytes, kind: str) -> str:
    """Return content of a media type as a ``data:`` address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"

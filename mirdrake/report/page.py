"""An HTML page from its template.

A report is one module and one template of this folder. The template extends ``page_base.html.jinja`` and fills its
blocks (``main`` above all); the module renders it with :func:`render_page` and writes it with
:func:`mirdrake.core.files.write_file`. A page needs no network and no other file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jinja2

__all__ = ["Tile", "render_page"]


class Tile(NamedTuple):
    """A figure at the head of a page: its name, its value with the unit, and a note."""

    label: str
    value: str
    note: str = ""


def render_page(
    template: str | Path,
    *,
    title: str,
    headline: str,
    over: str = "",
    tiles: Sequence[tuple[str, str, str]] = (),
    notices: Sequence[str] = (),
    filters: Mapping[str, Callable[..., Any]] | None = None,
    **values: Any,
) -> str:
    """Return a page: a template with its values, escaped unless they are ``Markup``.

    Args:
        template: file name of a template in this folder, or the path of one elsewhere.
        title: title of the browser's tab.
        headline: the result in one line.
        over: small text above the headline.
        tiles: figures below the headline.
        notices: warnings below the tiles.
        filters: functions that the template applies to values, besides those of Jinja.
        values: further names in the template.

    Raises:
        jinja2.UndefinedError: the template names a value that is missing.
    """
    path = Path(template)
    environment = _environment(path.parent if path.is_absolute() else None).overlay()
    environment.filters = environment.filters | dict(filters or {})
    page = environment.get_template(path.name)
    return page.render(title=title, headline=headline, over=over, tiles=tiles, notices=notices, **values)


@lru_cache(maxsize=4)
def _environment(folder: Path | None) -> jinja2.Environment:
    """Return the Jinja environment with the templates of this package and of another folder."""
    folders = [Path(__file__).parent, *([folder] if folder is not None else [])]
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )

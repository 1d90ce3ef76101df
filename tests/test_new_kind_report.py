"""A user adds a report: one module, one template, and one line that calls it."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mirdrake.core.files import write_file
from mirdrake.report.figures import Curve, Panel, draw_chart, drawing_style
from mirdrake.report.page import Tile, render_page
from mirdrake.report.words import format_quantity

TEMPLATE = """\
{% extends "page_base.html.jinja" %}
{% block main %}
<h2>Speed</h2>
<figure>{{ chart }}</figure>
<p id="note">{{ note }}</p>
{% endblock %}
"""


@dataclass(frozen=True)
class CoastDown:
    """The typed result that the report shows."""

    time: np.ndarray
    speed: np.ndarray
    note: str


def write_coast_down(result: CoastDown, path: Path, template: Path) -> None:
    """Write the user's report: the whole module but its imports."""
    with drawing_style():
        panel = Panel("Speed", "m/s", [Curve("speed", result.speed, "main")], zero=True)
        chart = draw_chart(result.time, [panel], "speed-", "Speed over time.")
    distance = float(np.trapezoid(result.speed, result.time))
    page = render_page(
        template,
        title="Coast-down",
        headline=f"{format_quantity(distance, 'm')} from {format_quantity(result.speed[0], 'm/s')}",
        tiles=[Tile("Distance", format_quantity(distance, "m"), "to standstill")],
        notices=["measured on one day"],
        chart=chart,
        note=result.note,
    )
    write_file(path, page)


def test_a_report_of_a_user_has_the_frame_of_all_pages(tmp_path: Path) -> None:
    template = tmp_path / "coast_down.html.jinja"
    template.write_text(TEMPLATE, encoding="utf-8")
    time = np.linspace(0.0, 10.0, 101)
    write_coast_down(CoastDown(time, 20.0 - 2.0 * time, "wind < 1 m/s"), tmp_path / "coast_down.html", template)
    page = (tmp_path / "coast_down.html").read_text(encoding="utf-8").replace("\u00a0", " ")
    assert "<h1>100 m from 20.0 m/s</h1>" in page
    assert '<dd class="value">100 m</dd><dd class="note">to standstill</dd>' in page
    assert '<p class="notice">measured on one day</p>' in page
    assert "wind &lt; 1 m/s" in page  # values are escaped
    assert page.count("<svg") == 2  # wide and narrow
    assert "--paper: #ffffff" in page  # the common style sheet
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_a_value_that_the_template_misses_is_an_error(tmp_path: Path) -> None:
    template = tmp_path / "bare.html.jinja"
    template.write_text(TEMPLATE, encoding="utf-8")
    with pytest.raises(Exception, match="'chart' is undefined"):
        render_page(template, title="bare", headline="bare")
    assert format_quantity(math.nan) == "–"

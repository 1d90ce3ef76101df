"""The validation report: simulated and published figures side by side."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mirdrake.core.files import write_file
from mirdrake.manoeuvres.published import KNOWN, ROLES, Role
from mirdrake.manoeuvres.results import format_figure, format_number, format_setting
from mirdrake.manoeuvres.validation import Comparison, ValidationResults, format_error, format_published
from mirdrake.readers.units import format_unit
from mirdrake.report.page import Tile, render_page

_TEMPLATE = "validation.html.jinja"
_WIDTH, _LEFT, _RIGHT, _ROW, _TOP = 1000.0, 400.0, 80.0, 30.0, 34.0  # of the chart [px]
_STEPS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def write_validation(results: ValidationResults) -> Path:
    """Write validation.html into the folder of the results.

    Raises:
        RunError: the file cannot be written.
    """
    assert results.folder is not None
    path = results.folder / "validation.html"
    write_file(path, render_validation(results))
    return path


def render_validation(results: ValidationResults) -> str:
    """Return the page; see :func:`write_validation`."""
    none_because = results.published.none_because
    return render_page(
        _TEMPLATE,
        filters={"number": format_figure, "units": format_unit, "value": format_setting},
        title=f"{results.facts.title} · validation",
        over=f"{results.facts.name} · validation report · simulated against published figures of the real vehicle",
        headline=f"{results.facts.title}: {results.headline}",
        results=results,
        # Roles without figures have no table.
        tables=[
            (role, text, [_row(comparison) for comparison in results.having(role)])
            for role, text in ROLES.items()
            if results.having(role)
        ],
        chart=_chart(results),
        tiles=[] if none_because else _tiles(results),
        notices=[*([f"Nothing to compare: {none_because}."] if none_because else []), *results.published.notes],
        known=_known(results.comparisons),
        outcomes=results.outcomes,
    )


@dataclass(frozen=True)
class Row:
    """A comparison as a row of a table."""

    text: str
    published: str
    simulated: str
    error: str
    verdict: str
    payload: str
    source: str
    status: str
    note: str


@dataclass(frozen=True)
class Bar:
    """A bar of the chart: positions [px], texts, and the class of its verdict."""

    y: float
    x: float
    width: float
    text: str
    label: str
    label_x: float
    anchor: str
    verdict: str


@dataclass(frozen=True)
class Bars:
    """The chart of errors as bars about zero [px].

    Attributes:
        width: width of the chart; `height`, `top` (of the first bar), `row` (height of one), `left` (end of names)
            likewise.
        band: left edge and width of the tolerance.
        ticks: position and text.
        bars: one per comparison.
    """

    width: float
    height: float
    top: float
    row: float
    left: float
    band: tuple[float, float]
    ticks: list[tuple[float, str]]
    bars: list[Bar]


def _row(comparison: Comparison) -> Row:
    figure, simulated, error = comparison.figure, comparison.simulated, comparison.error
    return Row(
        text=figure.text,
        published=format_published(figure),
        simulated="–" if simulated is None else f"{format_figure(simulated)} {figure.shown_unit}",
        error="–" if error is None else format_error(error).replace("-", "−"),
        verdict=comparison.verdict,
        payload=f"{format_number(comparison.payload)} kg",
        source=figure.source,
        status=figure.status,
        note=comparison.remarks,
    )


def _tiles(results: ValidationResults) -> list[Tile]:
    facts, plant = results.facts, results.plant
    payload = results.published.payload
    step = 1000.0 * float(plant.get("time_step", 0.0))
    return [
        *(_tile(results, role) for role in ROLES if results.count(role)[1]),
        Tile("Vehicle", facts.name, f"{format_number(facts.mass)} kg plus {format_number(payload)} kg payload"),
        Tile("Plant", f"{plant.get('contact')} contact", f"step {step:g} ms, road friction {results.friction:g}"),
    ]


def _tile(results: ValidationResults, role: Role) -> Tile:
    """Return the number of figures of a role within the tolerance, and their largest error."""
    within, total = results.count(role)
    errors = [abs(x.error) for x in results.having(role) if x.error is not None and x.figure.bound == "about"]
    limit = f"within ±{format_number(100.0 * results.tolerance)} %"
    note = f"{limit}, largest error {100.0 * max(errors):.1f} %" if errors else limit
    return Tile(f"{role.capitalize()} figures", f"{within} of {total}", note)


def _known(comparisons: Sequence[Comparison]) -> list[tuple[str, str]]:
    used = {comparison.figure.status for comparison in comparisons}
    return [(status, text) for status, text in KNOWN.items() if status in used]


def _chart(results: ValidationResults) -> Bars | None:
    """Return errors as bars about zero, with the band of the tolerance; None if there are none."""
    shown = [(x, 100.0 * x.error) for role in ROLES for x in results.having(role) if x.error is not None]
    if not shown:
        return None
    tolerance = 100.0 * results.tolerance
    # The tolerance band always fits, with some room beside it.
    axis_limit = max(1.4 * tolerance, *(1.08 * abs(error) for _, error in shown))
    middle = _LEFT + 0.5 * (_WIDTH - _LEFT - _RIGHT)
    scale = 0.5 * (_WIDTH - _LEFT - _RIGHT) / axis_limit
    # Round steps with at most five ticks on each side.
    step = next(
        (step for step in _STEPS if axis_limit / step <= 5.0), 2.0 * 10.0 ** math.ceil(math.log10(axis_limit / 10.0))
    )
    count = math.floor(axis_limit / step)
    bars = [
        Bar(
            y=_TOP + number * _ROW,
            x=middle + scale * min(error, 0.0),
            # An error of zero still needs a visible bar.
            width=max(abs(scale * error), 1.5),
            text=f"{comparison.figure.text} ({comparison.figure.role})",
            label=format_error(comparison.error).replace("-", "−"),
            label_x=middle + scale * error + (6.0 if error >= 0.0 else -6.0),
            anchor="start" if error >= 0.0 else "end",
            verdict=comparison.verdict,
        )
        for number, (comparison, error) in enumerate(shown)
    ]
    ticks = [
        (middle + scale * step * tick, f"{step * tick:+g} %".replace("-", "−") if tick else "0")
        for tick in range(-count, count + 1)
    ]
    return Bars(
        width=_WIDTH,
        height=_TOP + len(shown) * _ROW + 8.0,
        top=_TOP,
        row=_ROW,
        left=_LEFT,
        band=(middle - scale * tolerance, 2.0 * scale * tolerance),
        ticks=ticks,
        bars=bars,
    )

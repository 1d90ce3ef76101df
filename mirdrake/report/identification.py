"""The reports of an identification: the data check, and the fit with its parameters, residuals and profiles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mirdrake.core.files import write_file
from mirdrake.core.wording import plural
from mirdrake.identification.channels import channel as known_channel
from mirdrake.identification.channels import quantity
from mirdrake.identification.data import DataSet, Log
from mirdrake.identification.findings import DataReport, Excitation, Finding
from mirdrake.identification.fit import ChannelFit, Fit, FittedParameter, half_width
from mirdrake.identification.identify import Identification
from mirdrake.readers.units import format_unit
from mirdrake.report.figures import Curve, Panel, draw_chart, drawing_style, to_svg
from mirdrake.report.page import render_page
from mirdrake.report.svg import THEME, embed_svg
from mirdrake.report.words import format_significant

_TEMPLATE = "identification.html.jinja"
_LEVEL = 3.84  # rise of the cost at the ends of a 95 % interval
_TONES = {
    "identified": "good",
    "weakly identified": "weak",
    "not identifiable": "bad",
    "contradicts the given value": "bad",
    "fixed": "plain",
    "good": "good",
    "weak": "weak",
    "none": "bad",
    "info": "plain",
    "warning": "weak",
    "fault": "bad",
}
_SIZE = (320.0, 190.0)  # of the picture of a profile [px]


def write_data_check(file: Path, name: str, data: DataSet, report: DataReport) -> None:
    """Write the report of a data check.

    Args:
        file: file to write.
        name: name of the checked logs.
        data: data as recorded.
        report: findings, and the repaired data.

    Raises:
        RunError: the file cannot be written.
    """
    write_file(file, render_data_check(name, data, report))


def write_identification(result: Identification, folder: Path) -> Path:
    """Write the report of a study, report.html.

    Raises:
        RunError: the file cannot be written.
    """
    path = folder / "report.html"
    write_file(path, render_identification(result))
    return path


def render_data_check(name: str, data: DataSet, report: DataReport) -> str:
    """Return the page; see :func:`write_data_check`."""
    faults = sum(finding.severity == "fault" for finding in report.findings)
    warnings = sum(finding.severity == "warning" for finding in report.findings)
    rows = sum(len(log.time) for log in data.logs)
    length = sum(float(log.time[-1] - log.time[0]) for log in report.data.logs)
    tiles = [
        ("Logs", str(len(data.logs)), f"{len(data.train)} for training, {len(data.validation)} for validation"),
        ("Samples", f"{rows:,}".replace(",", "\u202f"), f"{length:.4g} s after repairs"),
        (
            "Findings",
            str(faults + warnings),
            f"{plural(faults, 'fault')}, {plural(warnings, 'warning')}",
        ),
        ("Repairs", str(len(report.repairs)), "each is listed below"),
    ]
    # The headline answers the question of the page: whether the data can be used, and for what.
    headline = report.headline
    with drawing_style():
        sections = _data_sections(report, data, pictures=True)
    return _render(
        title=f"{name}: {headline}",
        headline=f"{name}: {headline}",
        over="data check",
        tiles=tiles,
        sections=sections,
        result=None,
        fit=None,
    )


def render_identification(result: Identification) -> str:
    """Return the page; see :func:`write_identification`."""
    fit, check = result.fit, result.check
    free = [parameter for parameter in fit.parameters if parameter.kind != "fixed"]
    against = sum(parameter.verdict == "contradicts the given value" for parameter in free)
    # A parameter that contradicts the given value is identified all the same.
    good = sum(parameter.verdict == "identified" for parameter in free) + against
    # Fits to validation logs are the evidence; those to the training logs only show that the model is flexible enough.
    validation = [channel for channel in fit.channels if channel.part == "validation"]
    training = [channel for channel in fit.channels if channel.part == "train"]
    condition = "∞" if not math.isfinite(fit.condition_number) else format_significant(fit.condition_number, 3)
    tiles = [
        ("Parameters", f"{good} of {len(free)}", f"identified; {against} contradict the given value"),
        ("Fit, training logs", _least(training), _least_of(training)),
        ("Fit, validation logs", _least(validation), _least_of(validation)),
        ("Condition number", condition, "of the information matrix; above 1000 a combination is not identifiable"),
    ]
    with drawing_style():
        return _render(
            title=f"{result.name} · identification",
            headline=f"{result.name}: {good} of {len(free)} parameters identified",
            over=f"identification · {fit.model}",
            tiles=tiles,
            sections=_data_sections(check, None, pictures=False),
            result=result,
            fit=fit,
            verdicts=_verdicts(free),
            parameters=[_parameter(parameter) for parameter in free],
            fixed=[_parameter(parameter) for parameter in fit.parameters if parameter.kind == "fixed"],
            correlation=_correlation(fit, free),
            overlays=[_overlay(fit, log, number) for number, log in enumerate(fit.traces)],
            profiles=[_profile(fit, name, number) for number, name in enumerate(fit.profiles)],
            stages=[
                Stage(
                    stage.name, [_parameter(parameter) for parameter in stage.parameters if parameter.kind != "fixed"]
                )
                for stage in result.stages
            ],
            chosen=[(log.name, log.use, len(log.time), _span(log), ", ".join(log.channels)) for log in check.data.logs],
        )


def _render(**values: Any) -> str:
    return render_page(
        _TEMPLATE,
        filters={
            "breaks": _breaks,
            "units": format_unit,
            "number": _number,
            "tone": lambda word: _TONES.get(word, "plain"),
            "chance": _chance,
        },
        **values,
    )


# --- data ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DataSection:
    """A log on the page.

    Attributes:
        name: name of the log.
        use: training or validation.
        size: samples and length.
        findings: warnings and faults.
        infos: checks without a finding.
        offers: parameters that the drive excites.
        picture: its channels, or None.
    """

    name: str
    use: str
    size: str
    findings: list[Finding]
    infos: list[Finding]
    offers: list[Excitation]
    picture: Markup | None


@dataclass(frozen=True)
class ParameterRow:
    """A parameter as a row: the 95 % interval, its bound if it is there, the given value, and two half-widths."""

    one: FittedParameter
    span: str
    bound: str
    given: str
    noise: str
    model: str


@dataclass(frozen=True)
class Cell:
    """A cell of the heat map: its text, a colour, and the strength of the colour [%]."""

    text: str
    colour: str
    share: int


@dataclass(frozen=True)
class CorrelationRow:
    """A row of the heat map."""

    name: str
    cells: list[Cell]


@dataclass(frozen=True)
class Overlay:
    """Measured and modelled channels of a log."""

    log: str
    part: str
    picture: Markup


@dataclass(frozen=True)
class Profile:
    """The profile likelihood of a parameter."""

    name: str
    picture: Markup


@dataclass(frozen=True)
class Stage:
    """An earlier stage of the study: its name and its free parameters."""

    name: str
    rows: list[ParameterRow]


def _data_sections(report: DataReport, raw: DataSet | None, *, pictures: bool) -> list[DataSection]:
    """Return a section for each log: findings, excited parameters, channels."""
    sections = []
    originals = {log.name: log for log in raw.logs} if raw is not None else {}
    seen: set[str] = set()
    for number, log in enumerate(report.data.logs):
        # Findings of the whole log are shown with its first part only.
        first = log.name.partition(", part ")[0]
        names = {log.name} | ({first} if first not in seen else set())
        seen.add(first)
        findings = [item for item in report.findings if item.log in names]
        sections.append(
            DataSection(
                name=log.name,
                use="training" if log.use == "train" else "validation",
                size=f"{len(log.time)} samples, {log.time[-1] - log.time[0]:.4g} s",
                findings=[item for item in findings if item.severity != "info"],
                infos=[item for item in findings if item.severity == "info"],
                offers=[item for item in report.excitation if item.log == log.name],
                picture=_channels(report, originals.get(first), log, number) if pictures else None,
            )
        )
    return sections


def _channels(report: DataReport, raw: Log | None, log: Log, number: int) -> Markup:
    """Draw each channel of a log as recorded and as repaired."""
    retimed = any(item.check == "sample_time" and item.repair for item in report.findings if item.log == log.name)
    panels = []
    time = log.time
    if raw is not None and not retimed:
        inside = (raw.time >= log.time[0]) & (raw.time <= log.time[-1])
        # Recorded stamps may be out of order; the chart needs increasing times.
        order = np.argsort(raw.time[inside], kind="stable")
        time = raw.time[inside][order]
    for name, values in log.channels.items():
        good = np.isfinite(values)
        # Both curves on one time axis, that of the recording.
        repaired = np.interp(time, log.time[good], values[good]) if good.any() else np.full(len(time), np.nan)
        curves = [Curve("repaired", repaired, "main", width=1.1)]
        if raw is not None and not retimed:
            curves.insert(0, Curve("recorded", raw.channels[name][inside][order], "own1", width=1.1))
        # The vertical range is that of the repaired values, so that glitches of the recording are cut off.
        about = known_channel(name)
        panels.append(
            Panel(
                f"{name}: {about.meaning}", about.unit, curves, relative_height=0.5, limits=_limits(curves[-1].values)
            )
        )
    return draw_chart(time, panels, f"log{number}-", f"channels of {log.name}")


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Return limits of the axis for the repaired values, so that glitches are cut off."""
    good = values[np.isfinite(values)]
    low, high = (float(good.min()), float(good.max())) if len(good) else (0.0, 1.0)
    room = 0.08 * (high - low) or max(0.1 * abs(high), 0.1)
    return low - room, high + room


def _span(log: Log) -> str:
    return f"{log.time[0]:.4g} … {log.time[-1]:.4g} s"


# --- fit -------------------------------------------------------------------------------------------------------------


def _verdicts(free: Sequence[FittedParameter]) -> list[tuple[str, str]]:
    """Return each verdict that occurs, the best first, with the parameters that have it."""
    order = ("identified", "contradicts the given value", "weakly identified", "not identifiable")
    groups: dict[str, list[str]] = {verdict: [] for verdict in order}
    for parameter in free:
        groups.setdefault(parameter.verdict, []).append(parameter.name.replace("_", " "))
    return [(verdict, ", ".join(names)) for verdict, names in groups.items() if names]


def _parameter(parameter: FittedParameter) -> ParameterRow:
    span = "" if parameter.kind == "fixed" else f"{_number(parameter.low, 'open')} … {_number(parameter.high, 'open')}"
    bound = "" if parameter.at_bound is None else f"at its {'lower' if parameter.at_bound == 'low' else 'upper'} bound"
    noise, model = (
        text and format_significant(float(text), 2)
        for text in (half_width(parameter.sigma_noise), half_width(parameter.sigma_model))
    )
    return ParameterRow(parameter, span, bound, _number(parameter.given, ""), noise, model)


def _correlation(fit: Fit, free: Sequence[FittedParameter]) -> list[CorrelationRow]:
    """Return the rows of the heat map: blue above zero, orange below."""
    rows = []
    for index, parameter in enumerate(free):
        # Parameters fixed at the end have no row in the matrix.
        if index >= len(fit.correlation):
            break
        cells = []
        for value in fit.correlation[index]:
            good = bool(np.isfinite(value))
            colour = "main" if value > 0.0 else "own1"
            share = round(85.0 * min(abs(float(value)), 1.0)) if good else 0
            cells.append(Cell(f"{value:.2f}".replace("-", "−") if good else "–", colour, share))
        rows.append(CorrelationRow(parameter.name, cells))
    return rows


def _overlay(fit: Fit, log: str, number: int) -> Overlay:
    """Draw measured and modelled channels of a log, each with its residual."""
    frame = fit.traces[log]
    # The unit and the fit of a channel are those of this log.
    fits = [channel for channel in fit.channels if channel.log == log]
    time = frame["t"].to_numpy(dtype=float)
    panels = []
    for name in [str(column) for column in frame if f"{column}_model" in frame]:
        measured, model = frame[name].to_numpy(dtype=float), frame[f"{name}_model"].to_numpy(dtype=float)
        own = next((channel for channel in fits if channel.channel == name), None)
        unit = own.unit if own is not None else known_channel(quantity(name)).unit
        label = name if own is None else f"{name}, fit {own.nrmse_percent:.1f} %"
        # A residual shows what the model lacks, which the curves themselves hide.
        panels.append(
            Panel(label, unit, [Curve("measured", measured, "edge", width=2.6), Curve("model", model, "main")])
        )
        panels.append(
            Panel("residual", unit, [Curve("residual", measured - model, "own1", width=1.0)], relative_height=0.4)
        )
    part = fits[0].part if fits else "train"
    picture = draw_chart(time, panels, f"fit{number}-", f"measured and modelled channels of {log}")
    return Overlay(log, "training" if part == "train" else "validation", picture)


def _profile(fit: Fit, name: str, number: int) -> Profile:
    """Draw the increase of the cost when a parameter is fixed at other values than its estimate."""
    frame: pd.DataFrame = fit.profiles[name]
    # Increase of the cost over the minimum: its crossing of the level bounds the 95 % interval.
    width, height = _SIZE
    figure = Figure(figsize=(width / 72.0, height / 72.0), dpi=72.0)
    axes = figure.add_axes((46.0 / width, 40.0 / height, 1.0 - 60.0 / width, 1.0 - 52.0 / height))
    value, cost = frame["value"].to_numpy(dtype=float), frame["cost"].to_numpy(dtype=float)
    # The values of a profile need not be sorted.
    order = np.argsort(value)
    axes.plot(value[order], cost[order], color=THEME["main"], linewidth=1.6, marker="o", markersize=2.6)
    axes.axhline(_LEVEL, color=THEME["own1"], linewidth=1.2, linestyle="dashed")
    high = float(np.nanmax(cost)) if np.isfinite(cost).any() else 1.0
    # The curve matters up to the 95 % level; steep ends would flatten it.
    axes.set_ylim(-0.3, min(max(high, 1.3 * _LEVEL), 12.0))
    axes.grid(color=THEME["grid"], linewidth=1.0)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    # The given value shows at once whether the log contradicts it.
    known = next((parameter for parameter in fit.parameters if parameter.name == name), None)
    axes.set_xlabel(f"{name} [{format_unit(known.unit) if known else ''}]", labelpad=3.0)
    if known is not None and known.given is not None and value.min() <= known.given <= value.max():
        axes.axvline(known.given, color=THEME["muted"], linewidth=1.0)
    picture = embed_svg(
        to_svg(figure),
        f"profile{number}-",
        attributes={"class": "plot", "role": "img", "aria-label": f"profile of {name}"},
    )
    return Profile(name, Markup(picture))


def worst_fit(fits: Sequence[ChannelFit]) -> ChannelFit:
    """Return the channel whose fit misses most of what its noise allows: a noisy sensor is not a fault of the model."""
    missed = [channel.noise_limit_percent - channel.nrmse_percent for channel in fits]
    return fits[int(np.argmax(np.nan_to_num(missed, nan=-np.inf)))]


def _least(fits: Sequence[ChannelFit]) -> str:
    return f"{worst_fit(fits).nrmse_percent:.1f} %" if fits else "–"


def _least_of(fits: Sequence[ChannelFit]) -> str:
    if not fits:
        return "no such log"
    worst = worst_fit(fits)
    limit = f"{worst.noise_limit_percent:.0f} %"
    return f"farthest below the limit of its noise ({limit}): {worst.channel} of {worst.log}"


def _number(value: float | None, none: str = "–") -> str:
    if value is None or not math.isfinite(value):
        return none
    return format_significant(value)


def _breaks(name: str) -> Markup:
    """Return a name that may be wrapped after its underscores."""
    return Markup("_<wbr>").join(name.split("_"))


def _chance(value: float | None) -> str:
    """Return a probability as a text."""
    if value is None or not math.isfinite(value):
        return "–"
    return "< 0.001" if value < 1e-3 else f"{value:.2g}"

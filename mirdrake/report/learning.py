"""The report of a learning study: how the network drives, its training, its delay, and what it looks at."""

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mirdrake.core.curves import thin
from mirdrake.core.files import read_errors, write_file
from mirdrake.core.recording.pictures import encode
from mirdrake.learning.explain import FILE
from mirdrake.learning.result import CloneResult
from mirdrake.report.figures import drawing_style
from mirdrake.report.page import Tile, render_page
from mirdrake.report.svg import THEME
from mirdrake.report.tuning_axes import HALF, WIDE, add_axes, embed, label, new_figure
from mirdrake.runs.logs import Run

_TEMPLATE = "learning.html.jinja"
_COLOURS = ("main", "own1", "own2", "own3", "own4")
_BUCKETS = 600
_TINT = (255.0, 60.0, 0.0)
"""Colour of the pixels that change the steering most."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sample:
    """A picture at which network and expert differ: data URLs, ratio of width and height of the second, and texts."""

    picture: str
    saliency: str
    ratio: float
    place: str
    network: str
    expert: str


def write_learning_report(result: CloneResult) -> Path:
    """Write learning.html into the folder of the result.

    Raises:
        RunError: the file cannot be written.
    """
    path = result.folder / "learning.html"
    write_file(path, render_learning(result))
    return path


def render_learning(result: CloneResult) -> str:
    """Return the page; see :func:`write_learning_report`."""
    with drawing_style():
        charts = [(world, _error_chart(result, world)) for world in result.last.drives]
        training = _training_chart(result)
    return render_page(
        _TEMPLATE,
        title=f"{result.name} · learning",
        over=f"{result.name} · learning report · {result.processor_s / 60.0:.1f} min of processor time",
        headline=headline(result),
        tiles=_tiles(result),
        notices=[result.delay_sentence] if result.is_delay_the_cause else [],
        result=result,
        charts=charts,
        training=training,
        samples=_samples(result),
    )


def headline(result: CloneResult) -> str:
    """Return the result in one line."""
    drives = list(result.last.drives.items())
    # A drive that ended early is worse than any that was finished.
    world, drive = min(drives, key=lambda entry: (entry[1].figures.finished, entry[1].figures.autonomy))
    figures = drive.figures
    place = f"on {world}" if len(drives) == 1 else f"in {len(drives)} worlds, the worst of which is {world}"
    if figures.finished and not figures.interventions:
        return (
            f"The network drives {figures.laps:.1f} laps {place} without an intervention: lateral error "
            f"{figures.rms:.3f} m RMS, largest {figures.largest:.2f} m"
        )
    end = "" if figures.finished else ", not finished"
    return (
        f"The network drives {figures.laps:.2f} laps {place} with {figures.interventions} interventions{end}: autonomy "
        f"{100.0 * figures.autonomy:.1f} %"
    )


def _tiles(result: CloneResult) -> list[Tile]:
    last, train = result.last, result.spec["train"]
    figures = min((drive.figures for drive in last.drives.values()), key=lambda figures: figures.autonomy)
    expert = sum(drive.figures.time for drive in result.collected)
    return [
        Tile("Autonomy", f"{100.0 * figures.autonomy:.1f} %", "1 − 6 s · interventions / time (PilotNet)"),
        Tile("Lateral error", f"{figures.rms:.3f} m RMS", f"largest {figures.largest:.2f} m"),
        Tile("Wheels off the road", f"{figures.off_road:.1f} s", f"of {figures.time:.0f} s"),
        Tile("Pictures", f"{last.pictures}", f"from {expert:.0f} s of the expert; {train['epochs']} epochs"),
    ]


def _error_chart(result: CloneResult, world: str) -> Markup:
    """Return the lateral error over the place on the track, of each lap of the last round, and of the rounds before."""
    figure = new_figure(WIDE, 260.0)
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0))
    vehicle = result.vehicle
    # The last round is drawn over the earlier ones, which show the progress.
    for index, training_round in enumerate(result.rounds):
        if world not in training_round.drives:
            continue
        is_last = training_round is result.last
        for run in training_round.drives[world].runs(result.folder):
            for place, error in _laps(run, vehicle):
                style: dict[str, Any] = {
                    "color": THEME["main" if is_last else "edge"],
                    "linewidth": 1.4 if is_last else 0.8,
                }
                axes.plot(*thin(place, error, _BUCKETS), zorder=2.0 + index, **style)
    axes.axhline(0.0, color=THEME["muted"], linewidth=1.0, zorder=1.0)
    label(axes, "Place along the track [m]", "Lateral error [m]")
    axes.set_ylabel("Lateral error, left positive [m]")
    return embed(figure, f"error-{world}", "Lateral error over the place along the track")


def _laps(run: Run, vehicle: str) -> list[tuple[Array, Array]]:
    """Return place and lateral error of each lap of a run."""
    place, error = (run[f"{vehicle}.{name}"].to_numpy(dtype=float) for name in ("progress", "lateral_error"))
    ends = np.flatnonzero(np.abs(np.diff(place)) > 0.5 * max(place.max(), 1.0)) + 1
    return list(zip(np.split(place, ends), np.split(error, ends), strict=True))


def _training_chart(result: CloneResult) -> Markup:
    """Return the validation error over the epochs, of each round."""
    figure = new_figure(HALF, 240.0)
    axes = add_axes(figure, (0.0, 0.0, 1.0, 1.0))
    for index, training_round in enumerate(result.rounds):
        epochs = np.arange(1, len(training_round.validation_error) + 1)
        axes.plot(epochs, training_round.validation_error, color=THEME[_COLOURS[index % len(_COLOURS)]], linewidth=1.6)
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    label(axes, "Epoch", "Steering error [rad]")
    return embed(figure, "training", "Steering error at places that were not learnt, over the epochs")


def _samples(result: CloneResult) -> list[Sample]:
    """Return the pictures of the last drive with the largest differences of network and expert."""
    file = result.folder / Path(result.last.file).parent / FILE
    if not file.is_file():
        return []
    # A damaged file of samples ends in one line with its name.
    with read_errors(file), np.load(file) as arrays:
        data = {name: arrays[name] for name in arrays.files}
    height, width = data["cropped"]
    columns = (data["pictures"], data["prepared"], data["saliency"], data["place"], data["network"], data["expert"])
    return [
        Sample(
            _url(picture),
            _url(_tinted(prepared, saliency)),
            round(float(width / height), 3),
            f"{place:.0f} m",
            _signed(network),
            _signed(expert),
        )
        for picture, prepared, saliency, place, network, expert in zip(*columns, strict=True)
    ]


def _signed(angle: float) -> str:
    return f"{angle:+.3f} rad".replace("-", "−")


def _tinted(picture: NDArray[Any], saliency: Array) -> NDArray[np.uint8]:
    """Return a picture in grey with the pixels that change the steering most in colour."""
    grey = picture.mean(axis=2, keepdims=True).repeat(3, axis=2)
    share = saliency[:, :, np.newaxis] ** 2
    tinted = np.clip((1.0 - share) * grey + share * np.asarray(_TINT), 0.0, 255.0)
    return np.asarray(tinted, dtype=np.uint8)


def _url(pixels: NDArray[Any]) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(encode(pixels.astype(np.uint8))).decode()}"

"""Sliders in a notebook that change keys of a diagram, simulate it again and plot signals."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.extras import import_extra

if TYPE_CHECKING:
    from mirdrake.builder.diagram import Diagram

_STEPS = 100  # positions of a slider


def make_sliders(
    diagram: "Diagram",
    signals: Sequence[str],
    ranges: Mapping[str, tuple[float, float]],
    *,
    present: Mapping[str, float | None],
    duration: float,
) -> Any:
    """Return a widget with a slider for each key and the plot of a run with the values of the sliders.

    Args:
        diagram: the diagram; the sliders change it.
        signals: patterns of the signals to plot.
        ranges: smallest and largest value of each key, by its dotted path.
        present: present value of each key; None if the diagram leaves it out.
        duration: simulated time [s].

    Raises:
        MissingDependencyError: ipywidgets is not installed.
        ConfigError: a range is empty.
    """
    ipywidgets = import_extra("ipywidgets", need="sliders need ipywidgets", extra="notebook")

    def rerun(**values: float) -> Any:
        for path, value in values.items():
            diagram.set(path, value)
        return diagram.simulate(duration).plot(*signals)

    bars = {}
    for path, (low, high) in ranges.items():
        # ipywidgets reports an empty range without naming the slider.
        if not low < high:
            raise ConfigError(f"sliders: {path}: the range ({low:g}, {high:g}) is empty; give the smaller value first")
        value = present[path]
        bars[path] = ipywidgets.FloatSlider(
            value=min(high, max(low, (low + high) / 2.0 if value is None else value)),
            min=low, max=high, step=(high - low) / _STEPS, continuous_update=False,
            description=_short_name(path, ranges), style={"description_width": "initial"},
        )  # fmt: skip
    # Figures of mirdrake are not figures of pyplot, which would be shown without being asked for.
    return ipywidgets.interactive(rerun, {"auto_display": True}, **bars)


def _short_name(path: str, paths: Iterable[str]) -> str:
    """Return the shortest end of a dotted path that no other path has."""
    keys = path.split(".")
    ends = (".".join(keys[-number:]) for number in range(1, len(keys)))
    others = [f".{other}" for other in paths if other != path]
    return next((end for end in ends if not any(other.endswith(f".{end}") for other in others)), path)

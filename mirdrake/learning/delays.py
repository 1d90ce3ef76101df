"""Delay of the loop that a network closes, and whether the loop has the margin for it, before anything is trained.

A cloned policy is at best a delayed copy of its expert. The loop of the expert is linearised at its steering, and the
additional delay T of the network multiplies it by exp(-jωT): latency, and half a period on average while the command is
held. The margins of the delayed loop then show whether a perfect copy could drive.

A lead of the labels, which are the expert's commands T later, compensates the delay as far as the expert's motion is
known in advance. The margins are those without it, the worst case.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, pi
from typing import Any

import numpy as np

from mirdrake.learning.drives import Figures
from mirdrake.tuning.linearise import linearise
from mirdrake.tuning.margins import Margins, margins_of

LARGEST_SENSITIVITY = 2.0
"""Ms above which the delay is reported as a cause; common values are 1.2 to 2.0 (K. J. Åström and T. Hägglund, Advanced
PID Control, 2006, section 4.6)."""

OPERATING_TIME = 5.0
"""Time at which the loop is linearised; the car then drives at its set-point [s]."""


@dataclass(frozen=True)
class DelayMargin:
    """Margins of the steering loop, of the expert and with the delay of the network.

    Attributes:
        latency: time from the exposure of a picture to the command [s].
        hold: mean time for which a command is held before it acts, half a period [s].
        lead: time after the exposure at which labels are read [s].
        delay_margin: additional delay that the expert's loop tolerates [s].
        crossover: gain crossover frequency of the expert's loop [rad/s].
        phase_margin: of the expert's loop [rad].
        delayed_phase_margin: with the delay of the network [rad].
        sensitivity: Ms of the expert's loop [1].
        delayed_sensitivity: with the delay of the network [1].
    """

    latency: float
    hold: float
    lead: float
    delay_margin: float
    crossover: float
    phase_margin: float
    delayed_phase_margin: float
    sensitivity: float
    delayed_sensitivity: float

    @property
    def delay(self) -> float:
        """Additional delay of the network's loop [s]."""
        return self.latency + self.hold


def is_delay_the_cause(margin: DelayMargin, copy: Figures) -> bool:
    """Return whether the delay alone explains a car that weaves or leaves the road.

    Args:
        margin: margins of the steering loop.
        copy: figures of the expert whose steering has the delay of the network, the best that a copy can do.
    """
    left = copy.interventions > 0 or not copy.finished or copy.off_road > 0.0
    return left or margin.delayed_sensitivity > LARGEST_SENSITIVITY or margin.delay >= margin.delay_margin


def delay_sentence(margin: DelayMargin, copy: Figures) -> str:
    """Return what the delay means in three sentences; see :func:`is_delay_the_cause`."""
    texts = [
        f"The expert's loop tolerates {1e3 * margin.delay_margin:.0f} ms of additional delay; the network adds "
        f"{1e3 * margin.delay:.0f} ms ({1e3 * margin.latency:.0f} ms latency, {1e3 * margin.hold:.0f} ms hold), and Ms "
        f"rises from {margin.sensitivity:.2f} to {margin.delayed_sensitivity:.2f}."
    ]
    texts.append(
        f"The expert itself drives with this delay with {copy.interventions} interventions, a lateral error of "
        f"{copy.rms:.3f} m RMS and at most {copy.largest:.2f} m, and wheels off the road for {copy.off_road:.1f} s."
    )
    # The advice depends on the expert with the same delay, not on the network, whose errors have other causes as well.
    if is_delay_the_cause(margin, copy):
        texts.append("If the network weaves, the delay is the cause: increase the rate, or reduce the latency.")
    else:
        texts.append("The delay is not a cause of weaving.")
    return " ".join(texts)


def find_delay_margin(
    diagram: Mapping[str, Any], reference: str, *, latency: float, rate: float, lead: float
) -> DelayMargin:
    """Return the margins of a steering loop with the delay of a network.

    Args:
        diagram: diagram of the expert, without cameras.
        reference: input that the steering is connected to.
        latency: time from the exposure of a picture to the command [s].
        rate: pictures per second [Hz].
        lead: of the labels [s].

    Raises:
        ConfigError: the diagram cannot be built.
        MissingDependencyError: python-control is not installed.
    """
    # Cameras do not act on the expert's loop, and rendering would only take time.
    data = {**diagram, "sensors": {}, "record": {**(diagram.get("record") or {}), "cameras": False}}

    # Cut at the steering: there the network takes the place of the expert.
    model = linearise(data, {}, reference, None, time=OPERATING_TIME, cut=True)
    own: Margins = model.margins()
    delay = latency + 0.5 / rate

    def delayed(frequencies: Any) -> Any:
        return model.loop(frequencies) * np.exp(-1j * np.asarray(frequencies) * delay)

    # Up to the Nyquist frequency of the sampled loop.
    late = margins_of(delayed, 0.01, 0.999 * pi / model.system.dt)
    return DelayMargin(
        latency, 0.5 / rate, lead,
        own.delay_margin if np.isfinite(own.delay_margin) else inf,
        own.gain_crossover, own.phase_margin, late.phase_margin, own.max_sensitivity, late.max_sensitivity,
    )  # fmt: skip

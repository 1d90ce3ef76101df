"""Requirements on a run in plain English, each with a signed margin.

::

    requirement = ["after" T] (always E | never E | eventually E ["within" T] | E until E | at end E)
    E           = E or E | E and E | not E | (E) | ["abs"] SIGNAL < VALUE | EVENT
    SIGNAL      = one of SIGNALS, or any column of the run, with the dot in its name
    EVENT       = collision, stopped, on road, rollover, at goal, at NAME

    always clearance > 0.5 m
    never collision
    eventually stopped within 25 s
    after 5 s always abs lateral_error < 0.3 m or speed < 1 m/s
    speed < 5 m/s until at goal

Values may have a unit that fits (``36 km/h``); without one they are SI. Times count from the start of the run; what
follows ``after T`` counts from there. ``A until B`` asks that B happens, and that A holds at every sample before.

The margin is the quantitative semantics of signal temporal logic (A. Donzé, O. Maler, "Robust satisfaction of temporal
logic over real-valued signals", FORMATS 2010): positive where the requirement holds, and how far it is from changing,
in the SI unit of the signal that decides. ``and`` takes the least margin, ``or`` the greatest, whatever their units.
Over the samples that count it is the least of them for ``always``, the least of the opposite for ``never``, the
greatest for ``eventually``, that of the last sample for ``at end``. A signal that counts (:data:`COUNTS`) is half a
count away from changing when it has its last good value.

Signals are those of :data:`~mirdrake.requirements.observation.SIGNALS`; docs/kinds.md lists them.

Events: ``collision`` (margin: the clearance, taken negative, m), ``stopped`` (slower than 0.05 m/s; m/s), ``on road``
(from the outermost wheel to the edge, m), ``rollover`` (tilt beyond 45 deg, rad), ``at goal`` and ``at NAME`` (m inside
the goal's area or beyond its gate; laps for a goal of laps), ``at red`` (m of the front beyond a stop line that it had
not passed when its light became red).
"""

from mirdrake.requirements.judging import Finding, Requirement
from mirdrake.requirements.observation import Event, Observation, observe, outline
from mirdrake.requirements.parser import parse_requirement
from mirdrake.requirements.terms import COUNTS
from mirdrake.vehicles.outline import Outline

__all__ = [
    "COUNTS", "Event", "Finding", "Observation", "Outline", "Requirement", "observe", "outline", "parse_requirement",
]  # fmt: skip

"""Contact events of a run: begin and end of each pair, few however often the number of contacts changes."""

from typing import Any

import numpy as np
import pytest

from mirdrake.assembly.diagram import assemble
from mirdrake.runs.contact_periods import ContactPeriods
from mirdrake.runs.simulation import Simulation


def look(touches: Any, *, step: float = 0.01, blocks: int = 7) -> list[tuple[float, str]]:
    """Return the events of a pair whose samples arrive in blocks."""
    periods, times = ContactPeriods(), step * np.arange(float(len(touches)))
    return [
        event
        for rows in np.array_split(np.arange(len(touches)), blocks)
        for event in periods.look(times[rows], touches[rows])
    ]


def test_a_rattling_contact_is_one_period_whatever_the_blocks() -> None:
    touches = np.zeros(400, dtype=bool)
    touches[50:150:2] = True  # changes 100 times
    touches[300:310] = True
    expected = [(0.5, "begins"), (1.48, "ends after 0.98 s"), (3.0, "begins again (2)"), (3.09, "ends after 0.09 s")]
    for blocks in (1, 3, 400):
        events = look(touches, blocks=blocks)
        assert [text for _, text in events] == [text for _, text in expected]
        assert [time for time, _ in events] == pytest.approx([time for time, _ in expected])


def test_the_number_of_events_of_a_pair_is_bounded() -> None:
    touches = np.arange(200_000) % 60 == 0  # every 0.6 s for half an hour
    events = look(touches)
    assert len(events) == 2 * ContactPeriods.MOST + 1
    assert "not listed" in events[-1][1]


def test_a_contact_at_the_end_of_a_run_has_no_end_and_an_empty_block_has_no_events() -> None:
    assert look(np.ones(30, dtype=bool)) == [(0.0, "begins")]
    assert not list(ContactPeriods().look(np.empty(0), np.empty(0, dtype=bool)))


@pytest.mark.slow
def test_a_car_against_a_wall_has_few_events_and_tyres_on_the_road_none() -> None:
    spec: dict[str, Any] = {
        "world": "empty",
        "vehicles": {
            "ego": {"model": "bolt", "start": {"x": 0, "y": 0}, "speed": 3},
            "other": {"model": "bolt", "start": {"x": 7, "y": 0.5, "yaw": 0.3}, "parked": True},
        },
        "control": {"ego": {"kind": "constant", "speed": 3}, "other": {"kind": "constant", "speed": 0}},
        "plant": {"contact": "point"},
    }
    run = Simulation(assemble(spec)).run(duration=4.0)
    changes = np.count_nonzero(np.diff(run["other_contacts"]))
    assert changes > 0
    kinds = [entry["kind"] for entry in run.events]
    assert kinds.count("collision") == 2  # each car with the other
    assert kinds.count("contact") <= 6
    spec["vehicles"]["other"]["start"]["y"] = 9.0
    assert Simulation(assemble(spec)).run(duration=1.0).events == []

"""A user adds a manoeuvre: one class, and one line that registers it."""

from typing import ClassVar

import numpy as np
import pytest

from mirdrake.core.yaml_io import Speed
from mirdrake.manoeuvres import registry
from mirdrake.manoeuvres.base import ManoeuvreSpec, setting
from mirdrake.manoeuvres.facts import find_facts
from mirdrake.manoeuvres.results import describe
from mirdrake.manoeuvres.rig import Rig
from mirdrake.report.handling import write_handling
from mirdrake.vehicles import load_vehicle


class StraightSpec(ManoeuvreSpec):
    """Constant speed along a straight line."""

    title: ClassVar[str] = "Straight line"
    standard: ClassVar[str] = "own"
    headline: ClassVar[tuple[str, ...]] = ("distance",)

    speed: Speed = setting(5.0, "speed of the test", "m/s", "own", gt=0.0)

    def drive(self, rig, outcome):
        driver = rig.line_driver({"kind": "straight", "length": 100.0}, speeds=[[0.0, self.speed]])
        record = rig.run("straight", driver, duration=2.0, speed=self.speed)
        outcome.add("distance", "Distance", record.x[-1] - record.x[0], "m")
        outcome.add("offset", "Largest lateral displacement", float(np.max(np.abs(record.y))), "m")


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(registry.MANOEUVRES, "straight", StraightSpec)


@pytest.fixture(scope="module")
def unior():
    return load_vehicle("unior")


def test_a_registered_manoeuvre_is_driven_scaled_and_reported(unior, tmp_path):
    facts = find_facts(unior)
    assert "straight" in registry.find_names("all")
    rig = Rig("unior", unior, facts, kind="single_track", folder=tmp_path)
    outcome = registry.run_manoeuvre("straight", rig)
    # Equal Froude numbers: the speed of a small robot is that of a car times the root of the length scale.
    speed = 5.0 * facts.scale**0.5
    assert outcome.value("distance") == pytest.approx(2.0 * speed, rel=0.02)
    assert (outcome.value("offset") or 0.0) < 1e-3
    lines = list(describe(outcome))
    assert lines[0].startswith("Straight line (own) - done")
    from mirdrake.manoeuvres.results import HandlingResults

    results = HandlingResults(facts, "single_track", {}, rig.friction, [outcome], tmp_path)
    write_handling(results)
    page = (tmp_path / "handling.html").read_text(encoding="utf-8")
    assert "Straight line" in page
    assert "distance" in page
    assert "speed of the test" in page

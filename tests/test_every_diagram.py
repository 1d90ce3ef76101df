"""Every bundled diagram runs, every bundled vehicle drives in every bundled world."""

import numpy as np
import pytest

from mirdrake.diagram import assemble, load_diagram
from mirdrake.paths import data_root
from mirdrake.simulation import Simulation

ROOT = data_root()
DIAGRAMS = sorted(path.stem for path in (ROOT / "diagrams").glob("*.yaml"))
WORLDS = sorted(path.stem for path in (ROOT / "worlds").glob("*.yaml"))
MODELS = sorted(path.parent.name for path in (ROOT / "models").glob("*/vehicle.yaml"))


@pytest.mark.parametrize("name", DIAGRAMS)
def test_a_bundled_diagram_reads_all_its_outputs_and_stays_on_the_road(name):
    assembly = assemble(load_diagram(str(ROOT / "diagrams" / f"{name}.yaml")))
    assert assembly.unread == ()
    run = Simulation(assembly).run(duration=2.0)
    assert run.summary["stop_reason"] == "duration"
    assert all(figures["off_road_s"] == 0.0 for figures in run.summary["vehicles"].values())
    assert [event for event in run.events if event["kind"] == "contact"] == []


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
def test_a_vehicle_under_random_commands_stays_finite_and_sinks_no_deeper(model, world, contact):
    rng = np.random.default_rng(2026)
    times = np.arange(0.0, 1.0, 0.1)
    rows = [{"time": t, "speed": rng.uniform(-2, 8), "steering": rng.uniform(-0.5, 0.5)} for t in times.tolist()]
    spec = {
        "world": world,
        "vehicles": {"ego": {"model": model}},
        "control": {"ego": {"kind": "schedule", "rows": rows}},
        "plant": {"contact": contact},
    }
    run = Simulation(assemble(spec)).run(duration=1.0)
    assert np.isfinite(run.signals.to_numpy()).all()
    assert run["ego.z"].iloc[-1] == pytest.approx(run["ego.z"].iloc[0], abs=0.01)
    assert run["other_contacts"].max() == 0

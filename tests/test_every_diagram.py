"""Every bundled diagram runs."""

import pytest

from mirdrake.assembly.diagram import assemble, load_diagram
from mirdrake.core.paths import data_root
from mirdrake.runs.simulation import Simulation

ROOT = data_root()
DIAGRAMS = sorted(path.stem for path in (ROOT / "diagrams").glob("*.yaml"))


@pytest.mark.parametrize("name", DIAGRAMS)
def test_a_bundled_diagram_reads_all_its_outputs_and_stays_on_the_road(name):
    assembly = assemble(load_diagram(str(ROOT / "diagrams" / f"{name}.yaml")))
    assert assembly.unread == assembly.idle_cameras == ()
    run = Simulation(assembly).run(duration=2.0)
    assert run.summary["stop_reason"] == "duration"
    assert all(figures["off_road_s"] == 0.0 for figures in run.summary["vehicles"].values())
    assert [event for event in run.events if event["kind"] == "contact"] == []

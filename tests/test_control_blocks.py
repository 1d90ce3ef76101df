"""The control unit as a Diagram of blocks: the same bits as the fused unit, and blocks that can be replaced."""

import numpy as np
import pytest

from mirdrake.assembly.diagram import assemble, make_diagram, make_spec
from mirdrake.runs.simulation import Simulation

DRIVES = {
    "path": {"kind": "path_tracking", "track": "main", "speed": 3.0},
    "schedule": {
        "kind": "schedule",
        "rows": [
            {"time": 0.0, "speed": 2.0},
            {"time": 0.4, "speed": -1.0, "steering": 0.2},
            {"time": 0.9, "speed": 0.0},
        ],
    },
}


def spec_of(vehicle, *, contact="point", drive="path", **more):
    data = {
        "world": "test_track",
        "vehicles": {"ego": {"model": vehicle, "start": "line"}},
        "control": {"ego": DRIVES[drive]},
        "plant": {"contact": contact},
        "record": {"meshcat": False, "report": False},
    }
    return make_spec(data | more)


def assert_same_bits(spec, duration):
    fused, expanded = (Simulation(assemble(spec, expand=expand)).run(duration=duration) for expand in (False, True))
    assert list(fused.signals) == list(expanded.signals)
    different = [name for name in fused.signals if not np.array_equal(fused[name], expanded[name], equal_nan=True)]
    assert different == []
    assert np.ptp(fused["ego.speed_setpoint"]) > 0.5


@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_the_blocks_give_the_same_bits_as_the_fused_unit(vehicle):
    assert_same_bits(spec_of(vehicle, drive="schedule"), 1.2)


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("contact", ["point", "hydroelastic"])
@pytest.mark.parametrize(
    "vehicle", ["bolt", "mkz", "catvehicle", "unior", "mkz@handling", "bolt@published", "unior@printed_steering"]
)
def test_the_same_over_vehicles_contacts_and_drives(vehicle, contact, drive):
    assert_same_bits(spec_of(vehicle, contact=contact, drive=drive), 6.0)


def test_a_diagram_for_python_has_the_blocks_and_their_ports():
    control = make_diagram("bolt_test_track").GetSubsystemByName("ego.control")
    names = [system.get_name() for system in control.GetSystems()]
    assert {"dead_man", "acceleration_limit", "speed_pid", "ackermann", "wheel_loops", "steering_loops"} <= set(names)
    assert control.HasOutputPort("speed_pid.error")
    assert control.HasOutputPort("ackermann.wheel_angles")

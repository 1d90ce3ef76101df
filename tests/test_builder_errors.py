"""Wrong uses of `mir.Diagram` in Python: one line that states what was given and what is allowed."""

from typing import Any

import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import Gain

import mirdrake as mir


class Raises(LeafSystem):
    """A system whose constructor raises."""

    def __init__(self):
        super().__init__()
        raise RuntimeError("no licence\nsecond line")


class Wide(LeafSystem):
    """A controller with two outputs in one port."""

    def __init__(self):
        super().__init__()
        for name in ("reference", "measurement"):
            self.DeclareVectorInputPort(name, 1)
        self.DeclareVectorOutputPort("output", 2, lambda context, output: None)


def small():
    d = mir.Diagram("empty", contact="point")
    ego = d.add_vehicle("bolt")
    d.drive(ego, "constant", speed=2.0)
    return d, ego


def wrong(change):
    """Return a function that builds a diagram with a change."""

    def call():
        d, ego = small()
        change(d, ego)
        d.assemble()

    return call


MISSPELT: dict[str, Any] = {"timestep": 0.01}
NO_NUMBER: dict[str, Any] = {"time_step": "fast"}

CASES = {
    "unknown world 'test_trak'; did you mean 'test_track'": lambda: mir.Diagram("test_trak"),
    "unknown argument 'timestep'; did you mean 'time_step'": lambda: mir.Diagram("empty", **MISSPELT),
    "plant.time_step: 'fast' is not a number": lambda: mir.Diagram("empty", **NO_NUMBER).add_vehicle("bolt"),
    "plant.contact: 'hydro' is not allowed": lambda: mir.Diagram("empty", contact="hydro").add_vehicle("bolt"),
    "unknown vehicle 'blot'; did you mean 'bolt'": lambda: mir.Diagram("empty").add_vehicle("blot"),
    "vehicles.ego.start.x: 'a' is not a number": lambda: mir.Diagram("empty").add_vehicle("bolt", start={"x": "a"}),
    "vehicles.my car: 'my car' is not allowed; use letters": lambda: mir.Diagram("empty").add_vehicle("bolt", "my car"),
    "PathTracking: name the arguments": lambda: mir.PathTracking("main", 5.0),
    "speed: unit 'kg' does not fit; allowed: m/s": lambda: mir.PathTracking(track="main", speed="5 kg"),
    "a driver is a kind by name, a mapping": wrong(lambda d, ego: d.drive(ego, None)),
    "sensors.ego.0: a list is not a text": wrong(lambda d, ego: d.sensors(ego, ["imu"])),
    "add: missing a required argument: 'system'; arguments: name, system": wrong(lambda d, ego: d.add("x")),
    "'x' is function, which is not a Drake system": wrong(lambda d, ego: d.add("x", lambda: Gain(1.0, 1))),
    "systems.x.kind: unknown kind 'dely'; did you mean 'delay'": wrong(lambda d, ego: d.add("x", "dely")),
    "Raises cannot be made: RuntimeError: no licence": wrong(lambda d, ego: d.add("x", Raises)),
    "connect: expected a name, such as ego.vx": wrong(lambda d, ego: d.connect(Gain(1.0, 1).get_output_port(), "x")),
    "or <vehicle>.control.<block> to replace": wrong(lambda d, ego: d.replace(ego.driver, Gain, k=1.0, size=1)),
    "has no block 'sped_pid' to replace": wrong(lambda d, ego: d.replace(ego.control.sped_pid, Wide)),
    "output 'output' of Wide has 2 elements": wrong(lambda d, ego: d.replace(ego.control.speed_pid, Wide)),
    "sped: unknown field; did you mean 'speed'": wrong(lambda d, ego: d.set("vehicles.ego.control.sped.kp", 1)),
    "speed.kp: 'big' is not a number": wrong(lambda d, ego: d.set("vehicles.ego.control.speed.kp", "big")),
    "record.rte: unknown field; did you mean 'rate'": wrong(lambda d, ego: d.record(rte=3)),
    "laps: -1 is not allowed": wrong(lambda d, ego: d.stop_after(laps=-1)),
    "give the smallest and the largest value": wrong(lambda d, ego: d.sliders(duration=1.0, seed=3)),
    "'ego.contrl' has no blocks to draw; these have: ego.tyres, ego.control": wrong(
        lambda d, ego: d.draw("ego.contrl")
    ),
    "no port matches 'ego.contrl.*'": wrong(lambda d, ego: d.ports("ego.contrl.*")),
    "linearize: unknown input 'ego.speed_referenc'; did you mean 'ego.speed_reference'": wrong(
        lambda d, ego: d.linearize("ego.speed_referenc")
    ),
    "unknown diagram 'bolt_test_trak'": lambda: mir.Diagram.load("bolt_test_trak"),
    "input 'x.u' is not connected": wrong(lambda d, ego: d.add("x", "delay", delay=0.1)),
    "run: unknown argument 'durtion'; did you mean 'duration'": lambda: small()[0].simulate(0.1, durtion=3),
    "in place of a disabled block: ego.control.speed_pid.output; add [<output>, ego": wrong(
        lambda d, ego: (d.set("vehicles.ego.control.disable", ["speed_pid"]), d.simulate(0.1))
    ),
    "duration 'long' s is not allowed": lambda: small()[0].simulate("long"),
}


@pytest.mark.parametrize("message", CASES)
def test_a_wrong_use_is_one_line(message):
    with pytest.raises(mir.MirdrakeError) as caught:
        CASES[message]()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_jupyter_shows_the_line_of_the_cell_and_the_message_only():
    try:
        exec(compile("import mirdrake as mir\nmir.Diagram('nowhere')", "<cell>", "exec"), {"__name__": "__main__"})
    except mir.MirdrakeError as error:
        shown = error._render_traceback_()
    assert shown[-1].startswith("ConfigError: Diagram: world: unknown world 'nowhere'")
    assert len(shown) <= 2

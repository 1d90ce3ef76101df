"""Diagrams built in Python: the same data, bits and errors as a diagram file."""

import os
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import Gain

import mirdrake as mir
from mirdrake.assembly.diagram import assemble
from mirdrake.core.paths import find
from mirdrake.runs.simulation import Simulation


class Through(LeafSystem):
    """y = gain · u."""

    def __init__(self, gain=1.0):
        super().__init__()
        self.gain, self.u = gain, self.DeclareVectorInputPort("u", 1)
        self.DeclareVectorOutputPort("y", 1, self._calc)

    def _calc(self, context, output):
        output[0] = self.gain * self.u.Eval(context)[0]


def small(vehicle="bolt", **options):
    d = mir.Diagram("test_track", contact="point", **options)
    ego = d.add_vehicle(vehicle, start="line")
    d.drive(ego, mir.PathTracking(track="main", speed=3.0))
    d.record(meshcat=False, report=False)
    return d, ego


def bolt_test_track():
    d = mir.Diagram("test_track", duration=260, name="bolt_test_track")
    ego = d.add_vehicle("bolt", start="line")
    d.drive(ego, mir.PathTracking(track="main", speed="5 m/s"))
    d.stop_after(laps=1)
    return d


def bolt_skidpad():
    d = mir.Diagram("skidpad", duration=60, name="bolt_skidpad")
    ego = d.add_vehicle("bolt", start="left")
    d.drive(ego, mir.PathTracking(track="left", speed=6.0))
    d.sensors(ego, "imu", "gps")
    d.stop_after(laps=4)
    return d


def collect_driving_data():
    d = mir.Diagram("test_track", contact="point", duration=3600, name="collect_driving_data")
    camera = {"width": 640, "height": 480, "rate": 25}
    ego = d.add_vehicle("bolt", start="line", mounts={"front_camera": camera})
    d.drive(ego, mir.PathTracking(track="main", speed=5.0))
    d.sensors(ego, "front_camera")
    d.record(cameras=True, meshcat=False)
    return d


def two_cars():
    d = mir.Diagram("skidpad", duration=30, name="two_cars")
    left = d.add_vehicle("bolt", "left", start={"x": 9.125, "y": 9.125, "yaw": "90 deg"})
    right = d.add_vehicle(
        "bolt", "right", arguments={"drive": "rear"}, start={"x": -9.125, "y": -9.125, "yaw": "90 deg"}
    )
    d.drive(left, mir.PathTracking(track="left", speed=5.0))
    d.drive(right, mir.PathTracking(track="right", speed=5.0))
    return d


SHIPPED = [bolt_test_track, bolt_skidpad, collect_driving_data, two_cars]


@pytest.mark.parametrize("make", SHIPPED)
def test_a_shipped_diagram_built_in_python_and_written_is_the_same_spec(make, tmp_path):
    make().to_yaml(tmp_path / f"{make.__name__}.yaml")
    written, shipped = (mir.load_diagram(name) for name in (str(tmp_path / f"{make.__name__}.yaml"), make.__name__))
    leave = {"folder"}
    assert written.model_dump(exclude=leave) == shipped.model_dump(exclude=leave)
    assert mir.Diagram.load(make.__name__).spec().model_dump(exclude=leave) == shipped.model_dump(exclude=leave)


@pytest.mark.parametrize("make", SHIPPED)
def test_a_loaded_diagram_keeps_the_text_of_its_file(make, tmp_path):
    d, text = mir.Diagram.load(make.__name__), find("diagrams", make.__name__).read_text(encoding="utf-8")
    assert d.to_yaml() == text
    assert d.to_yaml(tmp_path / "other.yaml") == text


def test_only_what_was_changed_differs_from_the_text_of_a_file(tmp_path):
    d = mir.Diagram.load("bolt_skidpad")
    text = d.to_yaml()
    d.set("vehicles.ego.control.speed.kp", 2.0)
    d.set("control.ego.speed", "7 m/s")
    d.set("world.seed", 3)
    lag = d.add("lag", "delay", delay=0.1)
    d.connect(d["ego.steering_command"], lag.u)
    expected = (
        text.replace("world: skidpad", "world: {name: skidpad, seed: 3}")
        .replace("start: left}", "start: left, control: {speed: {kp: 2.0}}}")
        .replace("speed: 6 m/s", "speed: 7 m/s")
        + "systems:\n  lag: {kind: delay, delay: 0.1}\n"
        + "connect:\n  - [ego.steering_command, lag.u]\n"
    )
    assert d.to_yaml() == expected


def test_a_text_written_to_another_folder_names_the_same_files(tmp_path):
    (tmp_path / "yard.yaml").write_text("mirdrake: world/1\n", encoding="utf-8")
    (tmp_path / "blocks.py").write_text(
        "from pydrake.systems.primitives import Gain\n\n\n"
        "class Half(Gain):\n    def __init__(self) -> None:\n        super().__init__(k=0.5, size=1)\n",
        encoding="utf-8",
    )
    text = (
        "world: yard.yaml  # beside it\nvehicles: {ego: {model: bolt}}\nsystems: {half: {kind: 'blocks:Half'}}\n"
        "connect: [[ego.vx, half.u]]\n"
    )
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    d = mir.Diagram.load(str(tmp_path / "own.yaml"))
    assert d.to_yaml(tmp_path / "beside.yaml") == text
    (tmp_path / "below").mkdir()
    there = d.to_yaml(tmp_path / "below" / "own.yaml")
    assert there.splitlines()[1:4] == text.splitlines()[1:]
    assert mir.Diagram.load(str(tmp_path / "below" / "own.yaml")).spec() == d.spec()


@pytest.mark.slow
@pytest.mark.parametrize("make", SHIPPED)
def test_it_gives_the_same_bits(make, tmp_path):
    make().to_yaml(tmp_path / "drive.yaml")
    runs = [Simulation(assemble(str(name))).run(duration=3.0) for name in (tmp_path / "drive.yaml", make.__name__)]
    runs.append(make().simulate(3.0, inner=False))
    for run in runs[1:]:
        for name in map(str, runs[0].signals):
            assert np.array_equal(runs[0][name], run[name], equal_nan=True), name


def test_inner_signals_are_recorded_and_change_no_bit():
    d, _ = small()
    plain, inner = d.simulate(0.3, inner=False), d.simulate(0.3)
    assert "ego.control.speed_pid.output" in inner.signals
    assert all(np.array_equal(plain[name], inner[name], equal_nan=True) for name in map(str, plain.signals))


@pytest.mark.parametrize("vehicle", ["bolt", "mkz", "catvehicle", "unior"])
def test_blocks_are_added_and_replaced(vehicle):
    d, ego = small(vehicle)
    half = d.add("half", Gain, k=0.5, size=1)
    d.connect(ego.driver.speed_command, half.u)
    d.connect(half.y, ego.control.speed_reference)
    d.replace(ego.control.steering_actuator, Through(gain=2.0))  # an object
    run = d.simulate(0.2)
    actuator, reference = run["ego.control.steering_actuator.steering"], run["ego.steering_setpoint"]
    # Steering on a straight is near 1e-15 rad: no absolute tolerance.
    np.testing.assert_allclose(actuator.to_numpy(), 2.0 * reference.to_numpy(), rtol=1e-9, atol=0.0)
    assert np.abs(actuator.to_numpy()).max() > 0.0
    assert "half: pydrake.systems.primitives:Gain" in repr(d)


def test_a_block_of_this_session_is_built_again_with_its_new_parameters():
    """Its parameters are not in the data of the diagram, as no file could name its class."""

    class Session(Through):
        pass

    d, ego = small("unior")
    for gain in (2.0, 0.5):
        d.replace(ego.control.steering_actuator, Session, gain=gain)
        run = d.simulate(0.2)
        actuator, reference = run["ego.control.steering_actuator.steering"], run["ego.steering_setpoint"]
        np.testing.assert_allclose(actuator.to_numpy(), gain * reference.to_numpy(), rtol=1e-9, atol=0.0)
        assert np.abs(actuator.to_numpy()).max() > 0.0


def test_names_complete_and_print():
    d, ego = small()
    assert {"error", "output", "reference"} <= set(dir(ego.control.speed_pid))
    assert {"left", "right"} <= set(dir(ego.control.ackermann))
    assert "ego.control.speed_pid: " in repr(ego.control.speed_pid)
    table = d.ports("ego.control.speed_pid.*")
    assert table.loc["ego.control.speed_pid.error", "elements"] == "error [m/s]"


def messages():
    d, ego = small()
    yield "no vehicle 'eg'; did you mean 'ego'", lambda: d.drive("eg", "constant")
    yield "unknown kind 'constnt'; did you mean 'constant'", lambda: d.drive(ego, "constnt")
    yield "trak: unknown field; did you mean 'track'", lambda: mir.PathTracking(trak="main")
    yield "the name 'ego' is taken", lambda: d.add_vehicle("bolt")
    yield "start_at: unknown", lambda: d.add_vehicle("bolt", "b", start_at="line")
    yield "is int, which is not a Drake system", lambda: d.add("x", int)

    def connected(source, sink):
        other, _ = small()
        other.add("half", Gain, k=[0.5, 0.5])
        other.connect(source, sink)
        return other.assemble

    yield "unknown output 'ego.driver.sped_command'", connected("ego.driver.sped_command", "half.u")
    yield "'ego.state.vx' has 1 element, 'half.u' takes 2", connected("ego.vx", "half.u")
    yield (
        "in m/s, 'ego.steering_reference' takes steering in rad",
        connected("ego.vx", "ego.control.steering_reference"),
    )
    e = small()[0]
    e.add("x", Gain, gain=3)
    yield "Gain cannot be made: TypeError: its arguments do not fit", e.assemble
    f = small()[0]
    f.add("x", Through())
    yield "block 'x' cannot be written: it is an object; write add('x', Through, <arguments>)", f.to_yaml


def test_faults_are_one_line():
    for message, call in messages():
        with pytest.raises(mir.MirdrakeError) as caught:
            call()
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


def test_an_object_is_built_into_one_diagram_only():
    d, ego = small()
    d.add("x", Through(2.0))
    d.connect(ego.vx, "x.u")
    assert d._repr_svg_()  # drawing does not use it
    first, second = d.simulate(0.1), d.simulate(0.1)  # the same built diagram runs again
    assert np.array_equal(first["x.y"], second["x.y"])
    d.sensors(ego, "imu")
    with pytest.raises(mir.MirdrakeError, match="'x' is an object and already part of a built diagram; give the class"):
        d.simulate(0.1)


# --- runs --------------------------------------------------------------------------------------------------------


def test_a_run_is_plotted_compared_and_described():
    d, _ = small()
    run = d.simulate(0.2)
    figure = run.plot("ego.vx", "ego.control.*_pid.output", "ego.wz")
    assert [axes.get_ylabel() for axes in figure.axes] == ["[m/s]", "[rad/s]"]
    assert [line.get_label() for line in figure.axes[0].lines] == ["ego.vx", "ego.control.speed_pid.output"]
    both = run.compare(run, "ego.vx", labels=("first", "second"))
    assert [line.get_label() for line in both.axes[0].lines] == ["ego.vx, first", "ego.vx, second"]
    usual = run.compare(run)
    assert [line.get_label() for line in usual.axes[0].lines] == ["ego.vx, this", "ego.vx, other"]
    assert "0.20 s; ran for its whole duration" in repr(run)
    with pytest.raises(mir.MirdrakeError, match=r"no signal matches 'ego.vxx'; did you mean 'ego.vx'"):
        run.plot("ego.vxx")


def test_sliders_change_a_key_and_simulate_again():
    pytest.importorskip("ipywidgets")
    d, _ = small()
    key = "vehicles.ego.control.speed.kp"
    d.set(key, 1.5)
    sliders = d.sliders("ego.speed_trim", duration=0.2, **{key: (0.0, 4.0)})
    (bar,) = [child for child in sliders.children if hasattr(child, "max")]
    assert (bar.value, bar.min, bar.max, bar.description) == (1.5, 0.0, 4.0, "kp")
    trims = []
    for value in (0.5, 4.0):
        bar.value = value
        sliders.update()
        trims.append(np.abs(sliders.result.axes[0].lines[0].get_ydata()).max())
    assert trims[1] > trims[0] > 0.0
    with pytest.raises(mir.MirdrakeError, match="the range"):
        d.sliders("ego.vx", **{key: (4.0, 0.0)})


def test_sliders_of_equal_keys_have_different_names():
    pytest.importorskip("ipywidgets")
    d, _ = small()
    keys = ["vehicles.ego.control.speed.kp", "vehicles.ego.control.speed.ki", "control.ego.speed", "vehicles.ego.speed"]
    sliders = d.sliders("ego.vx", duration=0.1, **dict.fromkeys(keys, (1.0, 4.0)))
    names = [child.description for child in sliders.children if hasattr(child, "max")]
    assert names == ["kp", "ki", "control.ego.speed", "vehicles.ego.speed"]


SLIDERS = """
import mirdrake as mir
d = mir.Diagram("test_track", contact="point")
ego = d.add_vehicle("bolt", start="line")
d.drive(ego, mir.PathTracking(track="main", speed=3.0))
d.sliders("ego.vx", duration=0.2, **{"vehicles.ego.control.speed.kp": (0, 3)})
"""


@pytest.mark.slow
def test_a_slider_that_is_moved_in_a_notebook_shows_the_plot_of_a_new_run():
    """A kernel gets what the front end sends when a slider is moved, and answers with a picture."""
    pytest.importorskip("ipywidgets")
    start_new_kernel = pytest.importorskip("jupyter_client.manager").start_new_kernel
    # The tests draw without a screen; a notebook has its own way to show figures.
    environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    manager, client = start_new_kernel(kernel_name="python3", env=environment)
    try:
        messages = answers(client, client.execute(SLIDERS))
        opened = [m["content"] for m in messages if m["msg_type"] == "comm_open"]
        states = {content["comm_id"]: content["data"].get("state", {}) for content in opened}
        bar = next(comm for comm, state in states.items() if state.get("_model_name") == "FloatSliderModel")
        assert states[bar]["description"] == "kp"
        change = {"method": "update", "state": {"value": 2.7}, "buffer_paths": []}
        moved = client.session.msg("comm_msg", {"comm_id": bar, "data": change})
        client.shell_channel.send(moved)
        for shown in (messages, answers(client, moved["header"]["msg_id"])):
            assert sum("image/png" in m["content"].get("data", {}) for m in shown) == 1
        (text,) = answers(client, client.execute("print(d.to_yaml())"), "stream")
        assert "kp: 2.7" in text["content"]["text"]
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


def answers(client, request, kind=None):
    """Return the messages of a kernel about a request, until it has ended."""
    messages: list[dict[str, Any]] = []
    while not messages or messages[-1]["content"].get("execution_state") != "idle":
        message = client.get_iopub_msg(timeout=120)
        if message["parent_header"].get("msg_id") == request:
            messages.append(message)
    return [message for message in messages if kind in {None, message["msg_type"]}]


def test_a_run_is_animated_and_its_statistics_have_units(tmp_path):
    d, _ = small()
    run = d.simulate(0.2)
    view = run.animate(height=300)
    assert 'height="300"' in view._repr_html_()
    assert view.save(tmp_path / "run.html").stat().st_size > 100_000
    table = run.statistics("ego.v*", "ego.control.speed_pid.*")
    assert table.loc["ego.vx", "unit"] == "m/s"
    assert table.loc["ego.vx", "max"] == run["ego.vx"].max()
    assert len(repr(run).splitlines()) <= 10


# --- the example of the documentation, word for word -------------------------------------------------------------

EXAMPLE = """\
d = mir.Diagram(world="test_track", time_step=0.005)
ego = d.add_vehicle("bolt", start="line")
d.drive(ego, mir.PathTracking(track="main", speed=5.0))
notch = d.add("notch", Notch(frequency=4.0))           # any pydrake system, or a kind of ours by name
d.connect(ego.driver.steering_command, notch.u); d.connect(notch.y, ego.control.steering_reference)
d.sensors(ego, "front_camera", "imu")
d                                                      # in a notebook: the block diagram, ports on hover
run = d.simulate(30); run.plot("ego.lateral_error", "ego.control.*_pid.output")
"""


class Notch(LeafSystem):
    """Notch filter of second order, sampled at 50 Hz: zeros on the unit circle at its frequency, poles at 0.8 of it."""

    def __init__(self, frequency):
        super().__init__()
        self.angle = 2.0 * np.pi * frequency * 0.02
        self.u, state = self.DeclareVectorInputPort("u", 1), self.DeclareDiscreteState(4)
        self.DeclareVectorOutputPort("y", 1, lambda context, output: output.SetFromVector([self.calculate(context)]))
        self.DeclarePeriodicDiscreteUpdateEvent(0.02, 0.0, self.update)
        self.state = state

    def calculate(self, context):
        u1, u2, y1, y2 = context.get_discrete_state(self.state).value()
        c, r = 2.0 * np.cos(self.angle), 0.8
        gain = (1.0 - r * c + r * r) / (2.0 - c)
        return gain * (self.u.Eval(context)[0] - c * u1 + u2) + r * c * y1 - r * r * y2

    def update(self, context, state):
        u1, _, y1, _ = context.get_discrete_state(self.state).value()
        state.set_value(self.state, [self.u.Eval(context)[0], u1, self.calculate(context), y1])


@pytest.mark.parametrize("duration", ["0.3", pytest.param("30", marks=pytest.mark.slow)])
def test_the_example_runs_word_for_word(duration, tmp_path):
    names: dict[str, Any] = {"mir": mir, "Notch": Notch}
    exec(EXAMPLE.replace("simulate(30)", f"simulate({duration})"), names)
    run = names["run"]
    assert run["ego.lateral_error"].abs().max() < 0.3
    assert "ego.control.speed_pid.output" in run.signals
    assert "notch.y" in run.signals
    assert names["d"].spec().sensors == {"ego": ["front_camera", "imu"]}
    with pytest.raises(mir.MirdrakeError, match="block 'notch' cannot be written: it is an object"):
        names["d"].to_yaml(tmp_path / "my.yaml")


def test_a_low_pass_of_drake_works_in_yaml(tmp_path):
    (tmp_path / "low_pass.yaml").write_text(
        "world: empty\nvehicles: {ego: {model: bolt}}\ncontrol: {ego: {kind: constant, speed: 2}}\n"
        "plant: {contact: point}\nrecord: {meshcat: false, report: false}\nsystems:\n"
        '  filter: {kind: "pydrake.systems.primitives:FirstOrderLowPassFilter", time_constant: 0.2, size: 1}\n'
        "connect: [[ego.speed_command, filter.u], [filter.y, ego.speed_reference]]\n"
    )
    run = mir.simulate(str(tmp_path / "low_pass.yaml"), duration=0.5)
    assert run["filter.y"].iloc[-1] == pytest.approx(2.0 * (1.0 - np.exp(-0.5 / 0.2)), rel=0.01)

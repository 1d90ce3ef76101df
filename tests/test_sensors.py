"""Sensors in a diagram; effects of cameras on a run."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from mirdrake.assembly.diagram import assemble, make_diagram
from mirdrake.cli import main
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.runs.logs import Run, load_run, picture_name
from mirdrake.runs.simulation import Simulation
from mirdrake.sensors.cameras import rendering as camera

GRAVITY = 9.80665
FAULT = camera._egl_fault()
needs_egl = pytest.mark.skipif(FAULT is not None, reason=f"cameras cannot be drawn here: {FAULT}")


# --- in a diagram ------------------------------------------------------------------------------------------------


def parked(sensors: Sequence[str], **more: Any) -> dict[str, Any]:
    """Return a parked Bolt on an empty plane, with sensors."""
    return {
        "world": "empty",
        "vehicles": {"ego": {"model": "bolt"}},
        "control": {"ego": {"kind": "constant", "speed": 0.0}},
        "sensors": {"ego": list(sensors)},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
    } | more


def run(sensors: Sequence[str], **more: Any) -> Run:
    return Simulation(assemble(parked(sensors, **more))).run(duration=0.2)


def test_sensors_are_columns_of_the_signals_with_units() -> None:
    done = run(["gps", "imu"])
    names = [name for name in done.signals.columns if name.startswith(("ego.gps", "ego.imu"))]
    gps = ("x", "y", "z", "vx", "vy", "vz", "latitude", "longitude", "altitude")
    imu = ("fx", "fy", "fz", "wx", "wy", "wz")
    assert names == [*(f"ego.gps.{a}" for a in gps), *(f"ego.imu.{a}" for a in imu)]
    assert [done.units[name] for name in ("ego.gps.x", "ego.imu.fx", "ego.imu.wz")] == ["m", "m/s²", "rad/s"]
    assert done["ego.imu.fz"].mean() == pytest.approx(GRAVITY, abs=0.06)  # bias of 0.02 m/s²: 3 of them


def test_equal_seeds_give_equal_samples_and_others_do_not() -> None:
    first, again, other = run(["imu"], seed=3), run(["imu"], seed=3), run(["imu"], seed=4)
    assert first.signals.equals(again.signals)
    assert not np.any(first["ego.imu.wz"].to_numpy()[1:] == other["ego.imu.wz"].to_numpy()[1:])


def test_one_more_sensor_changes_nothing_about_the_noise_of_the_others() -> None:
    alone, together = run(["imu"]), run(["gps", "imu"])
    names = [name for name in alone.signals.columns if name.startswith("ego.imu")]
    assert len(names) == 6
    assert alone.signals[names].equals(together.signals[names])


def test_sensors_are_outputs_of_a_diagram() -> None:
    diagram = make_diagram(parked(["gps", "imu"]))
    assert [diagram.GetOutputPort(name).size() for name in ("ego.gps", "ego.imu")] == [9, 6]


def test_a_sensor_that_is_named_twice_is_rejected() -> None:
    with pytest.raises(ConfigError, match=r"sensors\.ego\.1: 'imu' is named twice"):
        assemble(parked(["imu", "imu"]))


def test_unused_cameras_are_not_built(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera, "_egl_fault", lambda: "not installed")
    assembly = assemble(parked(["front_camera"]))
    assert assembly.parts.scene_graph.RendererCount() == 0
    assert not assembly.diagram.HasSubsystemNamed("ego.front_camera")
    assert assembly.unread == ()
    assert assembly.idle_cameras == ("ego.front_camera",)


def test_recording_cameras_without_a_camera_is_rejected() -> None:
    with pytest.raises(ConfigError, match=r"record\.cameras: no camera is in use; name one under sensors"):
        assemble(parked(["imu"], record={"cameras": True}))


def test_without_egl_the_message_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera, "_egl_fault", lambda: "libEGL.so.1 is not installed")
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(MissingDependencyError, match=r"libEGL.*apt install libegl1 libgl1-mesa-dri"):
        assemble(parked(["front_camera"], record={"cameras": True}))


# --- camera ------------------------------------------------------------------------------------------------------


@needs_egl
def test_a_camera_sees_other_vehicles_but_not_its_own(tmp_path: Path) -> None:
    # one behind the other: the bonnet would be in both pictures, the blue car ahead is in one
    world = tmp_path / "queue.yaml"
    starts = "start:\n  back: {at: [0, 0]}\n  front: {at: [8, 0]}\n"
    world.write_text(f"mirdrake: world/1\nname: queue\nground: {{surface: asphalt}}\n{starts}", encoding="utf-8")
    names = {"behind": "back", "ahead": "front"}
    spec = parked([], world=str(world), record={"cameras": True})
    spec["vehicles"] = {name: {"model": "bolt", "start": start} for name, start in names.items()}
    spec["control"] = {name: {"kind": "constant", "speed": 0.0} for name in names}
    spec["sensors"] = {name: ["front_camera"] for name in names}
    assembly = assemble(spec)
    context = assembly.make_context()
    pictures = {name: assembly.cameras[f"{name}.front_camera"][0].look(context)["color"].astype(int) for name in names}
    blue = {name: int(((p[:, :, 2] - p[:, :, 0] > 80) & (p[:, :, 2] > 100)).sum()) for name, p in pictures.items()}
    assert blue["behind"] > 5000
    assert blue["ahead"] == 0


def test_pictures_are_named_by_simulated_time_from_1970_on() -> None:
    assert picture_name(0.0) == "1970-01-01-00-00-00-000000"
    assert picture_name(1.0 / 30.0) == "1970-01-01-00-00-00-033333"
    assert picture_name(3661.25) == "1970-01-01-01-01-01-250000"


FILE = """\
world: test_track
vehicles:
  ego: {model: bolt, start: line, speed: 5}
control:
  ego: {kind: path_tracking, track: main, speed: 5 m/s}
sensors: {ego: [front_camera, gps, imu]}
record: {cameras: true, meshcat: false, report: false}
duration: 0.1
"""


@needs_egl
def test_a_run_writes_pictures_and_a_driving_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    diagram = tmp_path / "drive.yaml"
    diagram.write_text(FILE, encoding="utf-8")
    for name in ("a", "b"):
        assert main(["run", str(diagram), "--out", str(tmp_path / name)]) == 0
    capsys.readouterr()
    folder = tmp_path / "a" / "ego.front_camera"
    log = [line.split("\t") for line in (folder / "driving_log.txt").read_text(encoding="utf-8").splitlines()]
    names = [f"1970-01-01-00-00-00-{us:06d}.jpg" for us in (0, 33333, 66667, 100000)]  # 30 Hz, both ends
    assert [row[0] for row in log] == names
    assert sorted(path.name for path in folder.iterdir()) == [*names, "driving_log.txt"]
    assert [float(row[1]) for row in log] == pytest.approx([0.0] * 4, abs=1e-3)  # straight ahead
    assert [float(row[2]) for row in log] == pytest.approx([5.0] * 4, abs=0.05)
    with Image.open(folder / names[1]) as picture:
        assert picture.size == (800, 800)
        sky, road = np.asarray(picture)[100, 400], np.asarray(picture)[700, 200]
    assert sky.min() > 180
    assert np.ptp(road.astype(int)) < 40  # grey
    again = tmp_path / "b" / "ego.front_camera"
    assert all((folder / name).read_bytes() == (again / name).read_bytes() for name in (*names, "driving_log.txt"))
    signals = load_run(tmp_path / "a").signals
    assert {"ego.gps.x", "ego.imu.fz"} <= set(signals.columns)


BLOCK = """\
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, LeafSystem
from pydrake.systems.sensors import ImageRgba8U


class Brightness(LeafSystem):
    def __init__(self):
        super().__init__()
        self.image = self.DeclareAbstractInputPort("image", AbstractValue.Make(ImageRgba8U()))
        self.DeclareVectorOutputPort("mean", BasicVector(1), self.calc)

    def calc(self, context, output):
        output.SetFromVector([self.image.Eval(context).data[:, :, :3].mean()])
"""


@needs_egl
def test_a_block_of_the_users_can_read_a_camera(tmp_path: Path) -> None:
    (tmp_path / "seeing_blocks.py").write_text(BLOCK, encoding="utf-8")
    done = run(
        ["front_camera"],
        systems={"eye": {"kind": "seeing_blocks:Brightness"}},
        connect=[["ego.front_camera.color_image", "eye.image"]],
        folder=str(tmp_path),
    )
    brightness: pd.Series = done["eye.mean"]
    assert brightness.iloc[0] == 0.0  # no picture yet
    assert 60.0 < brightness.iloc[-1] < 220.0

"""A drive without a browser: effects of manual input and buttons on the simulation, and the recording."""

import http.client
import json
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import yaml

from mirdrake.assembly.diagram_spec import load_diagram
from mirdrake.cli import main
from mirdrake.core.errors import ConfigError, RunError
from mirdrake.runs.logs import load_run
from mirdrake.runs.simulation import simulate
from mirdrake.viewer.cockpit import Cockpit, OpenCockpit, drive_spec
from mirdrake.viewer.cockpit.drive import follow_track
from mirdrake.viewer.cockpit.pace import BEHIND
from mirdrake.viewer.cockpit.shapes import arrows, ribbon
from mirdrake.viewer.meshcat import make_meshcat
from mirdrake.viewer.replay import write_replay
from mirdrake.worlds import load_world

Readings = Mapping[str, Any]


def spec(**more: Any) -> Any:
    data: dict[str, Any] = {
        "world": "test_track",
        "vehicles": {"ego": {"model": "bolt", "start": "line"}},
        "plant": {"contact": "point"},
        "name": "drive",
    }
    return drive_spec(data | more)


class Fingers:
    """Manual input to a cockpit from another thread, as from a page.

    Args:
        cockpit: to drive.
        drive: run it in a thread; False leaves that to the test, as Meshcat does not like to change threads.
    """

    def __init__(self, cockpit: Cockpit, *, drive: bool = True) -> None:
        self._cockpit, self._hands, self._stop = cockpit, {"active": False}, threading.Event()
        self._drive = threading.Thread(target=cockpit.run, kwargs={"duration": 50.0 if drive else 0.0})
        self._speak = threading.Thread(target=self._report)

    def __enter__(self) -> "Fingers":
        self._drive.start()
        self._speak.start()
        return self

    def __exit__(self, *fault: object) -> None:
        self.fall_silent()
        self._cockpit.stop()
        self._drive.join()

    def press(self, **hands: Any) -> None:
        """Send this input from now on."""
        self._hands = {"active": True, **hands}

    def fall_silent(self) -> None:
        """Send no more messages."""
        self._stop.set()
        self._speak.join()

    def until(self, true: Callable[[Readings], bool], *, seconds: float = 15.0) -> Readings:
        """Return the first readings for which a condition is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            readings = self._cockpit.readings
            if readings and true(readings):
                return readings
            time.sleep(0.01)
        raise AssertionError(f"never true within {seconds} s; the last was {self._cockpit.readings}")

    def _report(self) -> None:
        while not self._stop.is_set():
            self._cockpit.watchdog.report("test", self._hands)
            time.sleep(0.03)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A drive of a few seconds, recorded with a changed gain and a lost input."""
    folder = tmp_path_factory.mktemp("drive") / "run"
    messages: list[str] = []
    cockpit = Cockpit(
        spec(world="empty", vehicles={"ego": {"model": "bolt"}}),
        print_line=messages.append,
        folder=lambda: folder,
        timeout=0.5,
    )
    with Fingers(cockpit) as fingers:
        fingers.press(throttle=1.0)
        fingers.until(lambda readings: readings["speed"] > 6.0)
        cockpit.order({"do": "gain", "name": "speed.ki", "value": 0.5})
        cockpit.order({"do": "record"})
        fingers.until(lambda readings: readings["recording"] is not None)
        fingers.press(throttle=0.3, steer=0.4)
        fingers.until(lambda readings: readings["time"] > 1.0)
        cockpit.order({"do": "gain", "name": "speed.kp", "value": 2.0})
        fingers.until(lambda readings: readings["time"] > 2.0)
        fingers.fall_silent()
        fingers.until(lambda readings: readings["lost"] and abs(readings["speed"]) < 0.02)
        halted = fingers.until(lambda readings: True)["time"]
        fingers.until(lambda readings: readings["time"] > halted + 1.0)  # it rocks back on its springs and tyres
        cockpit.order({"do": "record"})
        fingers.until(lambda readings: readings["recording"] is None)
    return folder, messages


def test_a_recording_is_an_ordinary_run_folder(recorded):
    run = load_run(recorded[0])
    assert run.summary["stop_detail"] == "stopped"
    assert run.signals.index[0] == 0.0  # the clock starts with the recording
    assert np.diff(run.signals.index).max() == pytest.approx(0.02)
    assert run["ego.vx"].iloc[0] > 5.9
    assert run["ego.steering_command"].max() > 0.05
    assert {"ego.speed_command", "ego.wheel_load.front_left"} <= set(run.signals.columns)
    assert run.summary["vehicles"]["ego"]["distance_m"] > 5.0


def test_lost_input_brakes_to_standstill_and_is_reported(recorded):
    folder, messages = recorded
    run = load_run(folder)
    lost = [event for event in run.events if event["kind"] == "input"]
    assert [event["text"].split(":")[0] for event in lost] == ["input lost"]
    assert any("input lost: braking to standstill" in line for line in messages)
    vx, instant = run["ego.vx"], lost[0]["time"]
    assert vx[instant:].iloc[0] > 6.0
    assert abs(vx.iloc[-1]) < 0.05
    braking = vx[instant + 0.2 : instant + 0.8]
    slope = (braking.iloc[-1] - braking.iloc[0]) / (braking.index[-1] - braking.index[0])
    assert slope == pytest.approx(-5.0, rel=0.1)  # max_deceleration of control.yaml


def test_a_gain_that_was_changed_is_in_the_events(recorded):
    texts = [event["text"] for event in load_run(recorded[0]).events if event["kind"] == "gain"]
    assert texts == ["speed.kp = 1", "speed.ki = 0.5", "speed.kp = 2"]


def test_a_recording_drives_again_from_its_own_commands(recorded):
    folder, _ = recorded
    first = load_run(folder)
    again = simulate(load_diagram(str(folder / "spec.yaml")))
    assert again.summary["simulated_s"] == pytest.approx(first.summary["simulated_s"])
    for signal, apart in (("ego.x", 0.3), ("ego.y", 0.3), ("ego.vx", 0.15)):
        then = np.interp(first.signals.index, again.signals.index, again[signal])
        assert np.abs(first[signal] - then).max() < apart, signal


def test_a_recording_is_replayed_with_the_views_and_exported(recorded, tmp_path, capsys):
    folder, _ = recorded
    write_replay(load_run(folder), tmp_path / "replay.html")
    page = (tmp_path / "replay.html").read_text(encoding="utf-8")
    assert 'id="views"' in page
    assert re.findall(r'"name": "(\w+)", "eye"', page) == ["follow", "cockpit", "map"]
    assert main(["export", str(folder), "--to", "csv", "--out", str(tmp_path / "csv")]) == 0
    capsys.readouterr()


def test_reset_returns_the_vehicle_and_keeps_the_gains():
    cockpit = Cockpit(spec())
    with Fingers(cockpit) as fingers:
        before = fingers.until(lambda readings: True)
        fingers.press(throttle=1.0)
        cockpit.order({"do": "gain", "name": "speed.ki", "value": 0.25})
        fingers.until(lambda readings: readings["x"] > before["x"] + 1.0)
        fingers.press()
        cockpit.order({"do": "reset"})
        readings = fingers.until(lambda readings: readings["distance"] < 0.1)
        assert (readings["x"], readings["y"]) == pytest.approx((before["x"], before["y"]), abs=0.05)
        assert readings["speed"] == pytest.approx(0.0, abs=0.1)
        assert cockpit.gain("speed.ki") == 0.25
        assert cockpit.gain("speed.kp") == 1.0


def test_the_place_on_a_track_does_not_alternate_between_two_parts_that_are_equally_near():
    # Both circles of the figure eight touch at the origin, and the point is on their common tangent.
    track = load_world("skidpad").tracks["eight"]
    place, first = follow_track(track, -15.0, 0.0, None)
    assert abs(first) == pytest.approx(np.hypot(15.0, 9.125) - 9.125, abs=1e-6)
    for number in range(20):
        place, lateral = follow_track(track, -15.0, 1e-6 * (-1.0) ** number, place)
        assert lateral == pytest.approx(first, abs=1e-4)
    # Another part that is clearly nearer is taken: the middle of the centre line on either side.
    for y in (-18.25, 18.25):
        place, lateral = follow_track(track, 0.0, y, place)
        assert lateral == pytest.approx(0.0, abs=1e-6)


def test_inner_signals_are_among_the_readings():
    cockpit = Cockpit(spec(record={"signals": ["ego.control.*_pid.error", "ego.control.ackermann.*"]}))
    assert cockpit.signals[:2] == [("ego.control.speed_pid.error", "m/s"), ("ego.control.ackermann.left", "rad")]
    with Fingers(cockpit) as fingers:
        fingers.press(throttle=1.0)
        readings = fingers.until(lambda readings: readings["speed"] > 0.5)
        assert len(readings["signals"]) == len(cockpit.signals)
        assert readings["signals"][0] > 0.0


def test_simulated_time_stops_in_a_pause_and_follows_the_clock_otherwise():
    cockpit = Cockpit(spec())
    with Fingers(cockpit) as fingers:
        fingers.until(lambda readings: readings["time"] > 0.5)
        cockpit.order({"do": "pause"})
        instant = fingers.until(lambda readings: readings["paused"])["time"]
        time.sleep(0.3)
        assert cockpit.readings["time"] == instant
        cockpit.order({"do": "pause"})
        fingers.until(lambda readings: not readings["paused"] and readings["time"] > instant)
        began, first = time.monotonic(), cockpit.readings["time"]
        readings = fingers.until(lambda readings: readings["time"] > first + 2.0)
        ahead = readings["time"] - first - (time.monotonic() - began)
        assert ahead < BEHIND + 0.1  # no faster than real time, but for what was late when it began


@pytest.mark.parametrize("order", [{}, {"do": "fly"}, {"do": "gain"}, {"do": "gain", "name": "speed.kp", "value": "x"},
                                   {"do": "gain", "name": "speed.kp", "value": -1.0},
                                   {"do": "gain", "name": "speed.kp", "value": float("nan")},
                                   {"do": "layer", "name": 3}])  # fmt: skip
def test_orders_that_make_no_sense_change_nothing(order):
    cockpit = Cockpit(spec())
    cockpit.order(order)
    cockpit.run(duration=0.05)
    assert cockpit.gain("speed.kp") == 1.0


def test_an_unknown_gain_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"no gain 'kp'; there are: speed\.kp, speed\.ki"):
        Cockpit(spec()).gain("kp")


def test_a_folder_that_cannot_be_written_is_reported_and_the_drive_continues(tmp_path):
    (tmp_path / "run").write_text("in the way")
    messages: list[str] = []
    cockpit = Cockpit(spec(), print_line=messages.append, folder=lambda: tmp_path / "run")
    cockpit.order({"do": "record"})
    cockpit.run(duration=0.2)
    assert "cannot be created" in messages[0]
    assert cockpit.runs == []
    assert cockpit.readings["time"] > 0.0


def test_the_pedals_vehicle_has_the_gains_of_its_pedals():
    from mirdrake.vehicles import load_vehicle

    assert [gain.path for gain in load_vehicle("bolt@handling").control.gains()] == ["wheel_speed.kp", "wheel_speed.ki"]
    assert [gain.path for gain in load_vehicle("unior").control.gains()][:2] == ["speed.kp", "speed.ki"]
    assert "wheel_speed.kp" in [gain.path for gain in load_vehicle("unior").control.gains()]


# --- the page's server -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site() -> Iterator[OpenCockpit]:
    with OpenCockpit(spec(), port=0) as cockpit:
        cockpit.run(duration=0.2)
        yield cockpit


def ask(site: OpenCockpit, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, bytes]:
    """Return the status and body of an answer; a path without slash at its beginning is below the page."""
    path = path if path.startswith("/") else urlsplit(site.url).path + path
    port = urlsplit(site.url).port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    try:
        given = {"Host": f"localhost:{port}"} | {key.replace("_", "-"): value for key, value in headers.items()}
        connection.request(method, path, body, given)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def test_the_page_holds_meshcat_and_the_cockpit_and_its_scripts_come_from_the_same_port(site):
    status, page = ask(site, "GET", "")
    assert status == 200
    assert b"Chevrolet Bolt EV" in page
    script = re.search(rb'src="(cas-v1/\w+)"', page)
    assert script is not None
    status, content = ask(site, "GET", script[1].decode())
    assert status == 200
    assert len(content) > 100_000


def test_a_report_is_answered_with_what_the_gauges_show(site):
    body = json.dumps({"page": "p", "throttle": 0.0, "active": False}).encode()
    status, answer = ask(site, "POST", "report", body)
    assert status == 200
    assert {"speed", "steering", "lateral", "factor", "paused", "lost"} <= set(json.loads(answer))


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("POST", "/report", {}, 403),  # no token
        ("POST", f"/{'0' * 22}/order", {}, 403),
        ("GET", "", {"Host": "evil.example"}, 403),  # a name that leads here
        ("GET", "", {"Origin": "http://evil.example"}, 403),  # a page from elsewhere
        ("GET", "/etc/passwd", {}, 403),
        ("GET", "etc/passwd", {}, 404),
        ("GET", "cas-v1/../../x", {}, 404),
    ],
)
def test_requests_of_other_pages_are_rejected(site, method, path, headers, status):
    assert ask(site, method, path, b"{}", **headers)[0] == status


@pytest.mark.parametrize("body", [b"", b"{", b"[1]", b"null"])
def test_a_request_that_is_not_a_message_is_rejected(site, body):
    assert ask(site, "POST", "report", body)[0] == 400


def test_a_taken_port_is_named(site):
    port = urlsplit(site.url).port
    with pytest.raises(RunError, match=f"cannot listen on port {port} of localhost: .*; choose another port"):
        OpenCockpit(spec(), port=port)


def test_without_a_page_the_address_is_repeated():
    messages: list[str] = []
    with OpenCockpit(spec(), port=0, print_line=messages.append, remind=0.3) as cockpit:
        cockpit.run(duration=0.8)
    assert messages
    assert set(messages) == {f"no page is open; the cockpit is at {cockpit.url}"}


# --- overlays ------------------------------------------------------------------------------------------


def test_every_overlay_can_be_drawn_and_hidden():
    data = {
        "world": "skidpad",
        "vehicles": {"ego": {"model": "mkz"}},
        "sensors": {"ego": ["roof_lidar"]},
        "plant": {"contact": "point"},
    }
    meshcat = make_meshcat(port=0)
    cockpit = Cockpit(drive_spec(data), meshcat=meshcat)
    overlays = cockpit.overlays
    assert overlays is not None
    with Fingers(cockpit, drive=False) as fingers:
        fingers.press(throttle=1.0, steer=1.0)
        cockpit.run(duration=20.0, watch=lambda: cockpit.stop() if cockpit.readings["distance"] > 1.0 else None)
    assert cockpit.readings["steering"] > 0.05
    drawn = {"driven": "0", "planned": "ahead", "lidar": "ego/roof_lidar", "contacts": "all", "tyres": "all"}
    for layer in overlays.there:
        overlays.switch(layer, True)
    overlays.draw(cockpit._context)
    for layer, path in drawn.items():
        assert meshcat.HasPath(f"overlays/{layer}/{path}"), layer
    overlays.switch("driven", False)
    assert "driven" not in overlays.shown
    overlays.forget()
    assert not meshcat.HasPath("overlays/driven/0")


@pytest.mark.parametrize(
    ("contact", "world"), [("point", "empty"), ("hydroelastic", "empty"), ("tyre", "empty"), ("point", "test_track")]
)
def test_contact_forces_carry_the_vehicle_and_point_upwards(contact, world):
    settings = {"world": world, "vehicles": {"ego": {"model": "bolt"}}, "plant": {"contact": contact}}
    cockpit = Cockpit(spec(**settings), meshcat=make_meshcat(port=0))
    cockpit.run(duration=0.6)
    plant = cockpit.assembly.parts.plant
    weight = 9.81 * plant.CalcTotalMass(plant.CreateDefaultContext())
    assert cockpit.overlays is not None
    forces = [force for _, force, _ in cockpit.overlays._contacts(cockpit._context)]
    assert len(forces) == 4
    assert all(force[2] > 0.0 for force in forces)
    assert sum(force[2] for force in forces) == pytest.approx(weight, rel=0.03)


def test_a_ribbon_is_as_wide_as_asked_and_its_area_is_length_times_width():
    line = np.column_stack((np.linspace(0.0, 10.0, 21), np.zeros(21)))
    vertices, faces = ribbon(line, width=0.4, height=0.1)
    a, b, c = (vertices[:, faces[i]].T for i in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert areas.sum() == pytest.approx(10.0 * 0.4)
    assert np.cross(b - a, c - a)[:, 2].min() * np.cross(b - a, c - a)[:, 2].max() > 0.0  # all face the same way
    assert set(vertices[2]) == {0.1}


def test_arrows_reach_from_tail_to_tip_and_short_ones_are_omitted():
    tails = np.array([[0.0, 0, 0], [5, 5, 5], [1, 1, 1]])
    vertices, faces = arrows(tails, np.array([[0.0, 0, 2], [1e-3, 0, 0], [3, 0, 0]]), radius=0.05)
    assert vertices.shape[1] == 2 * 19
    assert faces.max() == vertices.shape[1] - 1
    for tip in ([0.0, 0.0, 2.0], [4.0, 1.0, 1.0]):
        assert np.linalg.norm(vertices.T - tip, axis=1).min() < 1e-12
    assert arrows(np.zeros((0, 3)), np.zeros((0, 3)), radius=0.05).faces.shape == (3, 1)  # nothing to see, no fault


# --- the command line ------------------------------------------------------------------------------------------------


def test_the_command_drives_for_a_time_and_reports_the_run_folder(capsys, tmp_path):
    assert main(["drive", "unior", "empty", "--port", "0", "--duration", "0.3", "--out", str(tmp_path)]) == 0
    assert re.match(r"Cockpit: http://localhost:\d+/[\w-]+/  \(Ctrl-C ends\)\n$", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["bolz"], "unknown name 'bolz'; did you mean 'bolt'"),
        (["test_track"], "'test_track' is not a vehicle"),
        (["bolt", "unior"], "'unior' is not a world"),
        (["bolt", "--start", "lime"], "lime"),
        (["bolt", "--sensors", "roof"], "roof"),
        (["bolt", "--set", "plant.time_stepp=1"], "did you mean 'time_step'"),
    ],
)
def test_bad_input_is_one_line(arguments, words, capsys):
    assert main(["drive", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.startswith("error: ")
    assert len(text.splitlines()) == 1
    assert words in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "-1"], "error: --duration: '-1' is not allowed; expected a positive number in s"),
        (["--port", "99999999"], "error: --port: '99999999' is not allowed; expected a whole number from 0 to 65535"),
    ],
)
def test_a_value_out_of_range_is_a_usage_error(arguments, words, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["drive", "bolt", *arguments])
    assert words in capsys.readouterr().err


def test_the_spec_of_a_recording_is_complete(recorded):
    data = yaml.safe_load((recorded[0] / "spec.yaml").read_text(encoding="utf-8"))
    assert data["control"]["ego"] == {"kind": "schedule", "interpolation": None, "rows": None, "file": ".",
                                      "vehicle": "ego", "period": None}  # fmt: skip
    assert data["vehicles"]["ego"]["control"] == {"speed": {"ki": 0.5}}  # as it was when the recording began
    assert data["duration"] == pytest.approx(load_run(recorded[0]).summary["simulated_s"])
    assert set(data["provenance"]) == {"spec_sha256", "content_sha256", "versions"}

"""Pages on this machine: allowed connections, messages that reach Meshcat, and runs that survive hostile ones."""

import base64
import contextlib
import gc
import http.client
import math
import os
import random
import re
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from pydrake.geometry import Meshcat

from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import RunError
from mirdrake.runs.simulation import Simulation, simulate
from mirdrake.viewer import FollowCamera, make_meshcat
from mirdrake.viewer.meshcat import make_offline_meshcat
from mirdrake.viewer.server import PageServer
from mirdrake.viewer.websocket import MOST, FrameReader, ProtocolError, is_event, make_frame
from mirdrake.workflow import run_diagram
from tests.chromium import NEEDS_BROWSER, open_browser

KEY = base64.b64encode(bytes(16)).decode()


@pytest.fixture
def meshcat() -> Meshcat:
    return make_meshcat(port=0)


def connect(url: str, *, key: str = KEY, path: str | None = None, **headers: str) -> socket.socket:
    """Return a socket that has asked for a web socket; the answer is not read yet."""
    address = urlsplit(url)
    there = socket.create_connection(("127.0.0.1", int(address.port or 0)), timeout=5.0)
    lines = {
        "Host": address.netloc,
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": key,
        "Sec-WebSocket-Version": "13",
    } | {name.replace("_", "-"): value for name, value in headers.items()}
    text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    there.sendall(f"GET {path or address.path} HTTP/1.1\r\n{text}\r\n".encode())
    return there


def status(there: socket.socket) -> int:
    """Return the status of the answer to a request."""
    text = b""
    while b"\r\n\r\n" not in text:
        block = there.recv(4096)
        if not block:
            break
        text += block
    return int(text.split()[1])


def get(url: str, path: str | None = None, **headers: str) -> tuple[int, bytes]:
    address = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=5.0)
    try:
        connection.request("GET", path or address.path, headers={"Host": address.netloc} | headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def ports() -> set[int]:
    """Return the TCP ports that this process listens on."""
    ports_found = set()
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(int(name))) as duplicate:
            if duplicate.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) and duplicate.family != socket.AF_UNIX:
                ports_found.add(duplicate.getsockname()[1])
    return ports_found


def pack(value: Any) -> bytes:
    """Return a value in MessagePack."""
    if isinstance(value, str):
        return b"\xd9" + bytes([len(value.encode())]) + value.encode()
    if isinstance(value, float):
        return b"\xcb" + struct.pack(">d", value)
    if isinstance(value, list):
        return b"\xdc" + struct.pack(">H", len(value)) + b"".join(map(pack, value))
    if isinstance(value, dict):
        return bytes([0x80 + len(value)]) + b"".join(pack(key) + pack(item) for key, item in value.items())
    if value is None or isinstance(value, bool):
        return b"\xc0" if value is None else b"\xc3" if value else b"\xc2"
    return bytes([value])


CLICK = pack({"type": "button", "name": "Go"})


def wait_for(condition: Callable[[], bool], seconds: float = 5.0) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


# --- who can connect -------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/proc/self/fdinfo").is_dir(), reason="needs Linux")
def test_meshcat_has_no_port_of_its_own():
    before = ports()
    meshcat = make_meshcat(port=0)
    assert ports() - before == {urlsplit(meshcat.web_url()).port}
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", meshcat.port()), timeout=1.0)
    offline = make_offline_meshcat()
    assert ports() - before == {urlsplit(meshcat.web_url()).port}
    assert "</body>" in offline.StaticHtml()


def test_the_controls_are_open_if_asked():
    opened = [b"viewer.gui.open()" in get(make_meshcat(port=0, controls=on).web_url())[1] for on in (False, True)]
    assert opened == [False, True]


def test_the_page_has_the_title_of_what_it_shows():
    for title, shown in (("bolt <1>", b"bolt &lt;1&gt;"), (None, b"mirdrake")):
        page = get((make_meshcat(port=0) if title is None else make_meshcat(port=0, title=title)).web_url())[1]
        assert re.findall(rb"<title>(.*?)</title>", page) == [shown]


def test_the_page_works_and_its_port_is_closed_with_it(meshcat):
    meshcat.AddButton("Go")
    url = meshcat.web_url()
    code, page = get(url)
    assert code == 200
    script = re.search(rb'src="(cas-v1/\w+)"', page)
    assert script is not None
    assert len(get(url, urlsplit(url).path + script[1].decode())[1]) > 100_000
    with connect(url) as there:
        assert status(there) == 101
        there.sendall(make_frame(2, CLICK))
        assert wait_for(lambda: meshcat.GetButtonClicks("Go") == 1)
    assert wait_for(lambda: meshcat.GetNumActiveConnections() == 0)


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:7000"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://localhost:1"},
        {"Origin": "null"},
        {"Origin": "https://localhost"},
    ],
)
def test_a_foreign_page_is_rejected(meshcat, headers):
    url = meshcat.web_url()
    code, text = get(url, **headers)
    assert code == 403
    assert len(text) < 100
    with connect(url, **headers) as there:
        assert status(there) == 403


@pytest.mark.parametrize("path", ["/", "/x/", "/%00/", "//", "/../", "/" + "A" * 22 + "/", "/index.html", "/cas-v1/0"])
def test_without_the_token_there_is_a_short_text(meshcat, path):
    code, text = get(meshcat.web_url(), path)
    assert (code, text) == (403, b"403: wrong token; open the whole address that mirdrake printed\n")
    with connect(meshcat.web_url(), path=path) as there:
        assert status(there) == 403


def test_the_page_itself_may_connect_and_a_taken_port_is_named(meshcat):
    url = urlsplit(meshcat.web_url())
    with connect(meshcat.web_url(), Origin=f"http://{url.netloc}") as there:
        assert status(there) == 101
    with connect(meshcat.web_url(), key="short") as there:
        assert status(there) == 400
    with pytest.raises(RunError, match=f"Meshcat cannot listen on port {url.port} of localhost: .*choose another port"):
        make_meshcat(port=url.port)


# --- what reaches Meshcat --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "event",
    [
        {"type": "button", "name": "Go"},
        {"type": "slider", "name": "x", "value": 0.5},
        {"type": "slider", "name": "x", "value": 3},
        {"type": "gamepad", "name": "", "gamepad": {"index": 0, "button_values": [0.0, 1], "axes": [0.25]}},
        {"type": "gamepad", "name": "", "gamepad": {"index": None, "button_values": [], "axes": []}},
    ],
)
def test_events_of_the_page_are_passed_on(event):
    assert is_event(pack(event))


@pytest.mark.parametrize(
    "event",
    [
        {"type": "slider", "name": "x", "value": math.nan},
        {"type": "slider", "name": "x", "value": math.inf},
        {"type": "slider", "name": "x", "value": "1"},
        {"type": "slider", "name": 1, "value": 1.0},
        {"type": "camera_pose", "name": "", "camera_pose": [0.0] * 16, "is_perspective": True},
        {"type": "button", "name": "Go", "more": 1},
        {"type": "gamepad", "gamepad": {"index": 0, "button_values": [math.nan], "axes": []}},
        {"type": "gamepad", "gamepad": [[[[[[]]]]]]},
        {"name": "Go"},
        {},
        [],
        3,
        None,
    ],
)
def test_anything_else_is_not(event):
    assert not is_event(pack(event))


def test_no_bytes_make_the_reader_or_the_decoder_fail():
    source = random.Random(7)
    for _ in range(3000):
        data = bytearray(CLICK if source.random() < 0.5 else source.randbytes(source.randrange(40)))
        for _ in range(source.randrange(3)):
            if data:
                data[source.randrange(len(data))] = source.randrange(256)
        is_event(bytes(data))
        is_event(bytes(data[: source.randrange(len(data) + 1)]))
        with contextlib.suppress(ProtocolError):
            list(FrameReader().feed(bytes(data)))


@pytest.mark.parametrize("size", [0, 1, 125, 126, 127, 65535, 65536])
def test_a_message_is_the_same_after_masking_fragments_and_any_split(size):
    source = random.Random(size)
    payload, mask = source.randbytes(size), source.randbytes(4)
    cut = size // 3
    frames = b""
    for first, part, last in ((True, payload[:cut], False), (False, payload[cut:], True)):
        head = bytes([(0x80 if last else 0) | (2 if first else 0)])
        n = len(part)
        head += bytes([0x80 | n]) if n < 126 else bytes([0xFE]) + struct.pack(">H", n)
        frames += head + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(part))
        frames += make_frame(9, b"ping") if first else b""
    reader = FrameReader()
    frames_read: list[tuple[int, bytes]] = []
    step = max(1, len(frames) // 50)
    for i in range(0, len(frames), step):
        frames_read += reader.feed(frames[i : i + step])
    assert frames_read == [(9, b"ping"), (2, payload)]
    assert list(FrameReader().feed(make_frame(2, payload))) == [(2, payload)]


def hostile_frames() -> Iterator[tuple[str, bytes]]:
    """Bytes after the handshake, with a name each."""
    yield "empty", make_frame(2, b"")
    yield "empty text", make_frame(1, b"")
    yield "not MessagePack", make_frame(2, b"\xc1")
    yield "cut MessagePack", make_frame(2, CLICK[:-1])
    yield "long array", make_frame(2, b"\xdd\xff\xff\xff\xff")
    yield "deep", make_frame(2, b"\x91" * 60000)
    yield "camera", make_frame(2, pack({"type": "camera_pose", "camera_pose": [0.0] * 16, "is_perspective": True}))
    yield "bad UTF-8", make_frame(1, b"\xff\xfe") + make_frame(2, b"\x82\xa4type\xa6button\xa4name\xa2\xff\xfe")
    yield "fragments", b"\x02\x81\0\0\0\0\x82" * 3
    yield "endless fragments", b"\x02\x80\0\0\0\0" + b"\x00\x80\0\0\0\0" * 5000
    yield "continuation first", b"\x80\x80\0\0\0\0"
    yield "oversized", b"\x82\xff" + struct.pack(">Q", 1 << 62) + b"\0\0\0\0"
    yield "large", make_frame(2, bytes(MOST + 1))
    yield "no mask", b"\x82\x00"
    yield "reserved bits", b"\xf2\x80\0\0\0\0"
    yield "unknown opcode", b"\x83\x80\0\0\0\0"
    yield "large ping", b"\x89\xfe\x00\xff\0\0\0\0" + bytes(255)
    yield "pings", make_frame(9, b"x" * 100) * 3000
    yield "close", make_frame(8, b"\x03\xe8") + make_frame(2, b"")
    yield "half a header", b"\x82"
    yield "nothing", b""
    source = random.Random(3)
    for number in range(20):
        yield f"random {number}", source.randbytes(source.randrange(1, 4000))


def attack(url: str) -> int:
    """Send all hostile frames to a page whose address is known; returns how many."""
    count = 0
    for name, data in hostile_frames():
        with connect(url) as there, contextlib.suppress(OSError):
            assert status(there) == 101, name
            there.sendall(data)
            if count % 3 == 0:
                there.shutdown(socket.SHUT_WR)  # half closed
            if count % 5 == 0:
                there.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset
            time.sleep(0.01)
        count += 1
    return count


DRIVE = {
    "world": "empty",
    "vehicles": {"ego": {"model": "bolt"}},
    "control": {"ego": {"kind": "constant", "speed": 2.0}},
    "plant": {"contact": "point"},
    "duration": 2.0,
    "name": "drive",
    "record": {"meshcat": False, "report": False},
}


def test_a_run_survives_all_frames_and_writes_its_folder(tmp_path):
    meshcat = make_meshcat(port=0)
    meshcat.AddButton("Go")
    url = meshcat.web_url()
    sent: list[int] = []
    thread = threading.Thread(target=lambda: sent.append(attack(url)))

    def progress(time_now: float, end: float) -> None:
        if not thread.is_alive() and not sent:
            thread.start()

    done = run_diagram(DRIVE, folder=tmp_path / "run", meshcat=meshcat, progress=progress, realtime_rate=1.0)
    thread.join()
    assert sent == [sum(1 for _ in hostile_frames())]
    assert done.summary["stop_reason"] == "duration"
    assert (tmp_path / "run" / "summary.json").is_file()
    assert meshcat.GetButtonClicks("Go") == 0
    with connect(url) as there:  # which works still
        assert status(there) == 101
        there.sendall(make_frame(2, CLICK))
        assert wait_for(lambda: meshcat.GetButtonClicks("Go") == 1)


def kill(meshcat: Meshcat) -> None:
    """End Meshcat's thread, as a frame does that it cannot decode."""
    server = next(server for server in _servers() if server.url == meshcat.web_url())
    assert server.upstream is not None
    with server.upstream.connect() as there:
        there.sendall(
            b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        assert status(there) == 101
        there.sendall(make_frame(2, b""))
        time.sleep(0.1)


def _servers() -> list[PageServer]:
    return [server for server in gc.get_objects() if type(server) is PageServer]


def test_a_run_goes_on_if_meshcat_ends_before_the_first_step(tmp_path):
    meshcat = make_meshcat(port=0)
    assembly = assemble(DRIVE, meshcat=meshcat)
    kill(meshcat)
    with pytest.raises(RuntimeError):
        meshcat.GetNumActiveConnections()
    done = Simulation(assembly).run(folder=tmp_path / "run", monitor=FollowCamera(meshcat, assembly))
    assert done.summary["stop_reason"] == "duration"
    assert [(event["kind"], event["time"]) for event in done.events] == [("view", 0.0)]
    assert (tmp_path / "run" / "summary.json").is_file()
    without = simulate(DRIVE)
    assert done.signals.equals(without.signals[done.signals.columns])


def test_a_run_goes_on_without_meshcat_to_the_same_bits(tmp_path):
    meshcat = make_meshcat(port=0)
    killed: list[float] = []

    def progress(time_now: float, end: float) -> None:
        if time_now >= 1.0 and not killed:
            killed.append(time_now)
            kill(meshcat)

    done = run_diagram(DRIVE, folder=tmp_path / "run", meshcat=meshcat, progress=progress)
    assert killed
    with pytest.raises(RuntimeError):
        meshcat.GetNumActiveConnections()
    assert done.summary["stop_reason"] == "duration"
    assert [event["kind"] for event in done.events] == ["view"]
    without = simulate(DRIVE)
    assert done.signals.equals(without.signals[done.signals.columns])


def test_a_run_with_a_view_is_the_run_without(tmp_path):
    with_view = simulate(DRIVE, meshcat=make_meshcat(port=0))
    assert with_view.signals.equals(simulate(DRIVE).signals)


# --- a browser -------------------------------------------------------------------------------------------------------

FOREIGN = """<!DOCTYPE html><body><script>
const out = {};
async function attempt(port) {
  for (const host of ["localhost", "127.0.0.1"]) {
    for (const path of ["/", "/index.html"]) {
      const key = `${host}:${port}${path}`;
      out[key + " ws"] = await new Promise(done => {
        const one = new WebSocket(`ws://${key}`);
        one.onopen = () => { one.send(new Uint8Array(0)); one.send(""); setTimeout(() => done("open"), 200); };
        one.onerror = () => done("refused");
        setTimeout(() => done("silent"), 3000);
      });
      for (const mode of ["cors", "no-cors"]) {
        try {
          const answer = await fetch(`http://${key}`, { mode });
          out[`${key} ${mode}`] = answer.type + (await answer.text()).length;
        } catch { out[`${key} ${mode}`] = "failed"; }
      }
    }
  }
}
window.probe = async ports => { for (const port of ports) await attempt(port); return out; };
</script>"""


@pytest.mark.parametrize("layer", [pytest.param("Go", marks=NEEDS_BROWSER)])
def test_our_page_works_in_a_browser_and_a_foreign_page_gets_nothing(layer, tmp_path):
    meshcat = make_meshcat(port=0)
    meshcat.AddButton(layer, "KeyG")
    foreign = PageServer("foreign", ports=[0], files=lambda path: (FOREIGN.encode(), "text/html") if not path else None)
    foreign.start()
    try:
        with open_browser(tmp_path / "browser", network=True) as browser:
            browser.get(meshcat.web_url())
            assert wait_for(lambda: meshcat.GetNumActiveConnections() == 1, 20.0)
            browser.find_element("tag name", "body").send_keys("g")
            assert wait_for(lambda: meshcat.GetButtonClicks("Go") == 1)
            browser.get(foreign.url)
            ours = urlsplit(meshcat.web_url()).port
            result = browser.execute_async_script(
                "const done = arguments[1]; window.probe(arguments[0]).then(done);", [ours, meshcat.port()]
            )
            assert len(result) == 24
            assert {key: value for key, value in result.items() if key.endswith("ws") and value != "refused"} == {}
            assert {key: value for key, value in result.items() if value not in {"refused", "failed", "opaque0"}} == {}
            assert meshcat.GetButtonClicks("Go") == 1
            assert meshcat.GetNumActiveConnections() == 0
    finally:
        foreign.close()

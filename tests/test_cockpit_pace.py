"""A drive keeps real time with all features on and the page open on another machine.

A minute of real time needs a machine that nothing else keeps busy; alone on it:

    pytest tests/test_cockpit_pace.py tests/test_browser_drive.py -m slow -k "real_time or pace" -s
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from mirdrake.viewer.cockpit import OpenCockpit, drive_spec

PAGE = r"""
import base64, http.client, json, os, socket, sys, threading, time
from urllib.parse import urlsplit
port, path = urlsplit(sys.argv[1]).port, urlsplit(sys.argv[1]).path
connection = http.client.HTTPConnection("127.0.0.1", port)
pictures = socket.create_connection(("127.0.0.1", port))
key = base64.b64encode(os.urandom(16)).decode()
pictures.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                 f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
received = [0]
def take():
    while data := pictures.recv(1 << 18):
        received[0] += len(data)
threading.Thread(target=take, daemon=True).start()
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    message = {"page": "p", "throttle": 0.2, "steer": 0.5, "active": True}
    connection.request("POST", f"{path}report", json.dumps(message), {"Host": f"localhost:{port}"})
    connection.getresponse().read()
    time.sleep(0.033)
print(received[0])
"""
"""What a page does, without drawing: it reports thirty times a second and takes the pictures."""


def busy() -> float:
    """Return the processor time used by the whole machine, and that taken by its host [s]; 0 where it is unknown."""
    try:
        columns = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()[1:]
    except OSError:
        return 0.0
    user, nice, system, _, _, interrupts, soft, steal, *_ = map(float, columns)
    return (user + nice + system + interrupts + soft + steal) / os.sysconf("SC_CLK_TCK")


def drive_with_everything(data: dict[str, Any], *, seconds: float) -> tuple[float, float, float]:
    """Simulated over wall-clock time, processor time over simulated time, and what the page received [byte/s]."""
    with OpenCockpit(drive_spec(data), port=0) as cockpit:
        drive = cockpit.drive
        assert drive.overlays is not None
        for layer in drive.overlays.there:
            drive.order({"do": "layer", "name": layer, "on": True})
        url = cockpit.url
        page = subprocess.Popen([sys.executable, "-c", PAGE, url, str(seconds + 2.0)], stdout=subprocess.PIPE)
        cockpit.run(duration=2.0)
        began, cpu, first, others = time.monotonic(), time.process_time(), drive.readings["time"], busy()
        cockpit.run(duration=seconds)
        wall, cpu, simulated = time.monotonic() - began, time.process_time() - cpu, drive.readings["time"] - first
        others = max(busy() - others - cpu, 0.0)
        out, _ = page.communicate(timeout=30)
    sys.stdout.write(
        f"\nreal-time factor {simulated / wall:.3f}, {cpu / simulated:.2f} processors for the drive, "
        f"{others / wall:.2f} of {os.cpu_count()} for all else\n"
    )
    assert drive.readings["distance"] > 1.0
    assert not drive.readings["lost"]  # a drive that is slower than real time outlives the page
    return simulated / wall, cpu / simulated, int(out) / (seconds + 2.0)


CAR = {"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}, "plant": {"contact": "point"}}
LIDAR = {
    "world": "parking_lot",
    "vehicles": {"ego": {"model": "mkz"}},
    "sensors": {"ego": ["roof_lidar"]},
    "plant": {"contact": "point"},
}


def test_a_drive_with_all_overlays_needs_a_part_of_one_core():
    _, cpu, rate = drive_with_everything(CAR, seconds=5.0)
    assert cpu < 0.6  # seconds of a processor for a simulated second
    assert 10e3 < rate < 3e6  # pictures come, and not too many


@pytest.mark.slow
@pytest.mark.parametrize("data", [CAR, LIDAR], ids=["car", "lidar"])
def test_real_time_holds_for_a_minute_with_all_overlays(data):
    factor, cpu, _ = drive_with_everything(data, seconds=60.0)
    assert factor == pytest.approx(1.0, abs=0.01)
    assert cpu < 0.8

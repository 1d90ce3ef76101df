"""A Meshcat that only this process can connect to.

Drake's Meshcat accepts a web socket from any page, and its thread ends when a frame cannot be decoded. Browsers do not
apply the same-origin policy to web sockets, so that a foreign page in the user's browser could read the scene and end
the simulation. Therefore Meshcat listens on no port here:

1. Meshcat opens its port on a random loopback address.
2. The listening socket is replaced, under the same file descriptor, by a Unix socket without a name in the file system.
   The kernel closes the port with it.
3. Meshcat's event loop (epoll) is given the new socket under the old entry.

:class:`Upstream` connects to that socket. Without Linux's ``/proc``, Meshcat listens on a port that
the Fetch standard forbids to web pages.
"""

import contextlib
import ctypes
import gc
import http.client
import logging
import os
import platform
import re
import secrets
import socket
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

from mirdrake.core.errors import RunError, first_line

BLOCKED_PORTS = (6000, 6566, 6665, 6666, 6667, 6668, 6669, 6679, 6697, 10080, 4190, 4045, 5060, 5061, 3659, 2049, 1723)
"""Ports that no web page may use, by the Fetch standard's list of bad ports."""

_MADE: list[Meshcat] = []
"""Meshcats of this process that were not released, with five file descriptors each. Drake ends the process when a
Meshcat is destroyed on another thread than the one that made it, and Python's garbage collector runs on any thread that
allocates, for example one of the page server."""

_DESCRIPTORS = Path("/proc/self/fd")

_READ = 0x001  # EPOLLIN
_ADD = 1  # EPOLL_CTL_ADD
_ENTRY = re.compile(r"^tfd:\s*(\d+) events:\s*[0-9a-f]+ data:\s*([0-9a-f]+)", re.MULTILINE)


class Upstream:
    """Connections from this process to its Meshcat.

    Args:
        descriptor: inode of the Unix socket; None if `port` is used.
        port: port of 127.0.0.1 where Meshcat listens; None if `descriptor` is used.
    """

    def __init__(self, *, descriptor: int | None = None, port: int | None = None) -> None:
        self._descriptor, self._port = descriptor, port

    def connect(self, *, timeout: float = 10.0) -> socket.socket:
        """Return a new connection to Meshcat.

        Raises:
            OSError: Meshcat has ended.
        """
        if self._port is not None:
            return socket.create_connection(("127.0.0.1", self._port), timeout=timeout)
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(timeout)
        # Through /proc: the socket's path is removed, but its inode can still be opened.
        try:
            connection.connect(f"/proc/self/fd/{self._descriptor}")
        except OSError:
            connection.close()
            raise
        return connection

    def get(self, path: str) -> tuple[int, str, bytes]:
        """Return status, content type and body of what Meshcat serves under a path.

        Raises:
            OSError: Meshcat has ended.
        """
        # The host name is not resolved; the connection exists already.
        request = http.client.HTTPConnection("meshcat", timeout=30.0)
        request.sock = self.connect(timeout=30.0)
        try:
            request.request("GET", path, headers={"Connection": "close"})
            answer = request.getresponse()
            kind = answer.headers.get("Content-Type", "application/octet-stream")
            return answer.status, kind, answer.read()
        except http.client.HTTPException as error:
            raise OSError(str(error)) from None
        finally:
            request.close()

    def close(self) -> None:
        """Release the socket's inode; no new connection can be made."""
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor, self._port = None, 0


def make_private_meshcat(*, url: str = "http://localhost:{port}") -> tuple[Meshcat, Upstream]:
    """Return a Meshcat without a port, and how to connect to it.

    Args:
        url: result of its ``web_url()``.

    Raises:
        RunError: Meshcat cannot listen.
    """
    reason = "it is disabled"
    if sys.platform == "linux" and _DESCRIPTORS.is_dir():
        # A random address of 127.0.0.0/8, so that no page can guess it in the moment before the port closes.
        numbers = secrets.token_bytes(3)
        host = f"127.{numbers[0]}.{numbers[1]}.{max(1, min(numbers[2], 254))}"
        try:
            meshcat = _make(host=host, port=0, url=url)
            return meshcat, Upstream(descriptor=_replace_listener(meshcat.port()))
        except (OSError, RuntimeError) as error:
            reason = first_line(error)
    # Without the exchange of the socket, a port that no browser opens is the next best.
    for port in BLOCKED_PORTS:
        with contextlib.suppress(RuntimeError):
            return _make(host="127.0.0.1", port=port, url=url), Upstream(port=port)
    raise RunError(f"Meshcat cannot listen: {reason}")


def release(meshcat: Meshcat) -> None:
    """Let a Meshcat be destroyed with its last reference, and free its file descriptors.

    To be called on the thread that made it, when no diagram draws in it any more.
    """
    gc.collect()  # diagrams are reference cycles: those that drew in it are freed now, on this thread
    _MADE[:] = [made for made in _MADE if made is not meshcat]


def _make(*, host: str, port: int, url: str) -> Meshcat:
    with _quietly():
        # Kept alive: see `_MADE`.
        _MADE.append(Meshcat(MeshcatParams(host=host, port=port, web_url_pattern=url, show_stats_plot=False)))
    return _MADE[-1]


def _replace_listener(port: int) -> int:
    """Replace the socket of this process that listens on a port by a Unix socket; return the inode's descriptor.

    Raises:
        OSError: the listening socket or its event loop is not found.
    """
    listener = _find_listener(port)
    loop, data = _find_loop(listener)
    with tempfile.TemporaryDirectory(prefix="mirdrake-") as folder, socket.socket(socket.AF_UNIX) as private:
        path = os.path.join(folder, "meshcat")
        # Non-blocking, as Meshcat's event loop expects of its listening socket.
        private.setblocking(False)
        private.bind(path)
        private.listen(64)
        # A descriptor of the inode itself (O_PATH) survives the removal of the folder.
        inode = os.open(path, os.O_PATH | os.O_CLOEXEC)
        os.dup2(private.fileno(), listener, inheritable=False)  # closes the port, which also leaves the event loop
    try:
        _watch(loop, listener, data)
    except OSError:
        os.close(inode)
        raise
    return inode


def _find_listener(port: int) -> int:
    """Return the descriptor of the socket of this process that listens on a port."""
    for entry in _DESCRIPTORS.iterdir():
        number = int(entry.name)
        try:
            if not os.readlink(entry).startswith("socket:"):
                continue
            # dup, because closing the Python socket must not close Meshcat's own descriptor.
            with socket.socket(fileno=os.dup(number)) as candidate:
                listens = candidate.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
                if listens and candidate.family == socket.AF_INET and candidate.getsockname()[1] == port:
                    return number
        except OSError:  # closed in the meantime
            continue
    raise OSError(f"no socket of this process listens on port {port}")


def _find_loop(listener: int) -> tuple[int, int]:
    """Return the epoll descriptor that waits for a listening socket, and the data of its entry."""
    for entry in Path("/proc/self/fdinfo").iterdir():
        with contextlib.suppress(OSError):
            # fdinfo lists what an epoll waits for, with the data by which Meshcat recognises the socket.
            for number, data in _ENTRY.findall(entry.read_text(encoding="ascii")):
                if int(number) == listener:
                    return int(entry.name), int(data, 16)
    raise OSError("Meshcat's event loop is not found")


class _Event(ctypes.Structure):
    """Linux's ``epoll_event``, which is packed on x86-64 only."""

    _pack_ = 1 if platform.machine() in {"x86_64", "AMD64"} else 8
    _fields_ = (("events", ctypes.c_uint32), ("data", ctypes.c_uint64))


def _watch(loop: int, descriptor: int, data: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    event = _Event(_READ, data)
    if library.epoll_ctl(loop, _ADD, descriptor, ctypes.byref(event)) != 0:
        raise OSError(ctypes.get_errno(), "Meshcat's event loop does not accept the private socket")


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Keep Drake from logging where Meshcat listens; the caller reports its own address."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(max(level, logging.WARNING))
    try:
        yield
    finally:
        log.setLevel(level)

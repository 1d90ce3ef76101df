"""The server of every page on this machine: run, view, world show, drive and replay.

A page is below a random token: ``http://localhost:7000/<token>/``. Each request must name this machine in ``Host``,
come from the page itself where the browser states an ``Origin``, and have the token in its path; else it gets 403.
So a foreign page in the same browser can neither read nor control anything here, even if it finds the port.

Meshcat is behind the server and has no port of its own (:mod:`mirdrake.viewer.private_meshcat`). Files and scene
messages are passed on as they are. What a browser sends is decoded here; only well-formed events reach Meshcat.
"""

import json
import secrets
import selectors
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from mirdrake.core.errors import RunError
from mirdrake.viewer.pages import with_open_controls, with_title
from mirdrake.viewer.private_meshcat import Upstream
from mirdrake.viewer.websocket import (
    BINARY,
    CLOSE,
    PING,
    PONG,
    FrameReader,
    ProtocolError,
    accept_key,
    is_event,
    make_frame,
)

HOST = "127.0.0.1"

MOST = 65536
"""Largest size of a request body [byte]."""

CONNECTIONS = 64
"""Largest number of simultaneous connections; others are closed at once."""

RATE = 1000
"""Largest number of web socket frames of a page per second; a page that sends more is disconnected."""

PATIENCE = 20.0
"""Timeout of a request, and of a browser that does not read [s]."""

_NAMES = {"127.0.0.1", "localhost"}
_ICON = (
    b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><circle cx="16" cy="16" r="12" fill="none" '
    b'stroke="#1f6feb" stroke-width="5"/><path d="M4 16H28M16 16V28" stroke="#1f6feb" stroke-width="4"/></svg>'
)
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",  # or the token would leave the page with a link
    "X-Frame-Options": "SAMEORIGIN",
    "Cross-Origin-Resource-Policy": "same-origin",
}

Answer = tuple[bytes, str]
"""Content and its type."""


class PageServer:
    """Serves a page until it is closed.

    Args:
        name: name of the service, for the error message of a port in use.
        ports: ports of localhost, tried in this order; 0 is any free one.
        files: returns the content of a path of the page, "" for the page itself; None if there is none.
        posts: functions by path that answer a posted JSON object, in threads of the server.
        upstream: Meshcat, for the page and files that `files` does not have.
        title: of the page, if it is that of `upstream`.
        controls: whether the controls of Meshcat are open in the page of `upstream`.
        largest: largest size of a request body [byte].

    Attributes:
        token: random, in the page's address.
        url: address of the page.

    Raises:
        RunError: no port is free.
    """

    def __init__(
        self,
        name: str,
        *,
        ports: Iterable[int],
        files: Callable[[str], Answer | None] = lambda _: None,
        posts: Mapping[str, Callable[[Mapping[str, Any]], Mapping[str, object]]] | None = None,
        upstream: Upstream | None = None,
        title: str = "mirdrake",
        controls: bool = False,
        largest: int = MOST,
    ) -> None:
        self.largest, self.title, self.controls = largest, title, controls
        self.token, self.files, self.posts, self.upstream = secrets.token_urlsafe(16), files, posts or {}, upstream
        # Bound to the loopback address: other computers cannot connect.
        self._server = _listen(name, partial(_Handler, self), list(ports))
        self.url = f"http://localhost:{self._server.server_address[1]}/{self.token}/"
        self._thread: threading.Thread | None = None

    def serve(self) -> None:
        """Serve until :meth:`close` is called."""
        self._server.serve_forever(poll_interval=0.1)

    def start(self) -> None:
        """Serve in a new thread."""
        self._thread = threading.Thread(target=self.serve, name="page server", daemon=True)
        self._thread.start()

    def stop_listening(self) -> None:
        """Release the port of a server that has not started."""
        self._server.server_close()

    def close(self) -> None:
        """Stop serving; to be called from another thread, or after :meth:`serve`."""
        self._server.shutdown()
        self.stop_listening()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
        if self.upstream is not None:
            self.upstream.close()


class _Server(ThreadingHTTPServer):
    request_queue_size = 32
    daemon_threads = True

    def __init__(self, *arguments: Any) -> None:
        self._free = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread, if there are not too many."""
        # Without blocking: the accepting thread must not wait for slow browsers.
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, then release the connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that closes its connection in the middle of an answer."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    timeout = PATIENCE

    def __init__(self, site: PageServer, *arguments: Any) -> None:
        self._site = site
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """Answer with the page, one of its files or Meshcat's web socket."""
        path = self._path()
        if path is None:
            return
        upgrade = self.headers.get("Upgrade", "").lower()
        # Before the files: the web socket has the same path as the page.
        if upgrade == "websocket" and path == "":
            self._tunnel()
            return
        content = self._site.files(path)
        if content is None and self._site.upstream is not None:
            content = self._fetch(path)
            if content is None:
                return
        if content is None:
            self.send_error(404)
        else:
            self._answer(*content)

    def do_POST(self) -> None:
        """Answer a JSON object."""
        path, length = self._path(), self.headers.get("Content-Length", "")
        if path is None:
            return
        # Length and digits are bounded before the conversion, so that a huge number costs nothing.
        if not (length.isdecimal() and len(length) < 10 and int(length) <= self._site.largest):
            self.close_connection = True
            self.send_error(400)
            return
        try:
            message = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            message = None
        if path not in self._site.posts:
            self.send_error(404)
        elif not isinstance(message, dict):
            self.send_error(400)
        else:
            self._answer(json.dumps(self._site.posts[path](message)).encode(), "application/json")

    def _path(self) -> str | None:
        """Return the path below the page; None if the request was rejected or redirected."""
        head, mark, path = urlsplit(self.path).path.removeprefix("/").partition("/")
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        origin = self.headers.get("Origin")
        # Host protects against DNS rebinding, Origin against requests of other sites in the same browser.
        if host not in _NAMES or (origin is not None and origin != f"http://{self.headers.get('Host')}"):
            self._reject("another page has no access to this one")
        # Constant time, or the time of the answer would reveal how much of a guessed token is right.
        elif secrets.compare_digest(head.encode(), self._site.token.encode()):
            if mark:
                return path
            # Relative addresses in the page need the slash at the end.
            self.send_response(308)
            self.send_header("Location", f"/{head}/")
            self.send_header("Content-Length", "0")
            self.end_headers()
        # Browsers ask for the icon without the token.
        elif self.path == "/favicon.ico" and self.command == "GET":
            self._answer(_ICON, "image/svg+xml")
        else:
            self._reject("wrong token; open the whole address that mirdrake printed")
        return None

    def _reject(self, text: str) -> None:
        self.close_connection = True
        length = self.headers.get("Content-Length", "")
        if length.isdecimal() and len(length) < 10 and int(length) <= MOST:
            self.rfile.read(int(length))  # else the connection is reset before the answer is read
        self._answer(f"403: {text}\n".encode(), "text/plain; charset=utf-8", status=403)

    def _answer(self, content: bytes, kind: str, *, status: int = 200) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        for key, value in _HEADERS.items():
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(content)

    def _fetch(self, path: str) -> Answer | None:
        """Return Meshcat's content of a path; None if the request was answered with an error."""
        assert self._site.upstream is not None
        try:
            # A path with other characters could add lines to the request to Meshcat.
            status, kind, content = self._site.upstream.get(
                f"/{path}" if path.isascii() and path.isprintable() else "/-"
            )
        except (OSError, ValueError):
            status, kind, content = 502, "", b""
        if status != 200:
            # 502 states that Meshcat has ended; anything else is a file that does not exist.
            self.send_error(status if status == 502 else 404)
            return None
        if path == "":
            page = with_title(content.decode(), self._site.title)
            content = (with_open_controls(page) if self._site.controls else page).encode()
        return content, kind

    def _tunnel(self) -> None:
        """Connect a web socket with Meshcat until one side closes it."""
        # After the upgrade the connection is not HTTP any more.
        self.close_connection = True
        answer = accept_key(self.headers.get("Sec-WebSocket-Key", ""))
        if answer is None or self.headers.get("Sec-WebSocket-Version") != "13" or self._site.upstream is None:
            self.send_error(400)
            return
        try:
            upstream_socket, first = _open_socket(self._site.upstream)
        except OSError:
            self.send_error(502)
            return
        with upstream_socket:
            self.send_response(101)
            for key, value in (("Upgrade", "websocket"), ("Connection", "Upgrade"), ("Sec-WebSocket-Accept", answer)):
                self.send_header(key, value)
            self.end_headers()
            # Meshcat may have sent frames together with its answer.
            self.wfile.write(first)
            _pump(self.connection, upstream_socket)

    def log_message(self, format: str, *values: Any) -> None:  # noqa: A002
        """Print nothing."""


def _open_socket(upstream: Upstream) -> tuple[socket.socket, bytes]:
    """Return a web socket to Meshcat and the first bytes of its frames.

    Raises:
        OSError: Meshcat has ended.
    """
    upstream_socket = upstream.connect()
    try:
        # The key may be any 16 bytes: nobody checks the answer of this process to itself.
        upstream_socket.sendall(
            b"GET / HTTP/1.1\r\nHost: meshcat\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        head = b""
        while b"\r\n\r\n" not in head:
            data = upstream_socket.recv(65536)
            # Limited, as the head has no end if it is not Meshcat that answers.
            if not data or len(head) > MOST:
                raise OSError("Meshcat did not accept the web socket")
            head += data
    except OSError:
        upstream_socket.close()
        raise
    head, _, first = head.partition(b"\r\n\r\n")
    if b" 101 " not in head.split(b"\r\n")[0]:
        upstream_socket.close()
        raise OSError("Meshcat did not accept the web socket")
    return upstream_socket, first


def _pump(here: socket.socket, there: socket.socket) -> None:
    """Pass the scene to the browser, and well-formed events of the browser to Meshcat."""
    reader, second, count = FrameReader(), 0, 0
    for side in (here, there):
        side.settimeout(PATIENCE)  # a browser that does not read would fill Meshcat's memory
    with selectors.DefaultSelector() as ready:
        # One loop for both directions, as each side may send at any time.
        ready.register(here, selectors.EVENT_READ)
        ready.register(there, selectors.EVENT_READ)
        while True:
            for key, _ in ready.select():
                try:
                    data = key.fileobj.recv(262144)  # type: ignore[union-attr]
                    if not data:
                        return
                    # From Meshcat unchanged: it is trusted, and scenes are large.
                    if key.fileobj is there:
                        here.sendall(data)
                        continue
                    for opcode, payload in reader.feed(data):
                        now = int(time.monotonic())
                        # Counted by whole seconds: the limit need not be exact.
                        second, count = (second, count + 1) if now == second else (now, 1)
                        if count > RATE:
                            return
                        # Text frames and unknown messages are dropped, as a frame that
                        # Meshcat cannot decode ends its thread.
                        if opcode in {CLOSE, PING, PONG} or (opcode == BINARY and is_event(payload)):
                            there.sendall(make_frame(opcode, payload))
                        if opcode == CLOSE:
                            return
                except (OSError, ProtocolError):
                    return


def _listen(name: str, handler: Any, ports: list[int]) -> _Server:
    reason = ""
    for port in ports:
        try:
            return _Server((HOST, port), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
    wanted = f"port {ports[0]}" if len(ports) == 1 else f"ports {ports[0]} to {ports[-1]}"
    raise RunError(f"{name} cannot listen on {wanted} of localhost: {reason}; choose another port")

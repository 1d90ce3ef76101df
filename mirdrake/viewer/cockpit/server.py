"""The page of a drive on this machine: one port for the page, its reports, and Meshcat behind it.

The page is Meshcat's own with the cockpit over it. It reports what hands do, some thirty times a second, and gets what
the gauges show in the answer; so a page that is closed, hidden or hangs falls silent, which the dead-man notices.
Whatever else Meshcat's page asks for is fetched from Meshcat, its web socket is passed through.

Only this machine can connect. Other pages in the same browser cannot drive: each answer needs the token of the page,
and a foreign page can neither read it nor send it.
"""

import json
import re
import secrets
import select
import socket
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from mirdrake.errors import RunError

HOST = "127.0.0.1"

PORT = 8765
"""The first port that is tried."""

_ASSET = re.compile(r"/cas-v1/[0-9a-f]{1,128}")
_TRIED = 20  # ports from there on
_MOST = 65536  # bytes of a report
_ICON = (
    b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><circle cx="16" cy="16" r="12" fill="none" '
    b'stroke="#1f6feb" stroke-width="5"/><path d="M4 16H28M16 16V28" stroke="#1f6feb" stroke-width="4"/></svg>'
)
_NAMES = {"127.0.0.1", "localhost"}


class CockpitServer:
    """Serves the page of a drive until it is closed.

    Args:
        meshcat: address of the Meshcat that is shown, as ``http://localhost:7000``.
        about: what the page needs to know at first, as plain data.
        report: called with the page's name and its message, gives the answer; from threads of the server.
        order: called with what a button asks for; likewise.
        port: of localhost; None takes the first free one from :data:`PORT` on, 0 any free one.

    Attributes:
        url: where the page is.

    Raises:
        RunError: the port is taken.
    """

    def __init__(
        self,
        *,
        meshcat: str,
        about: Mapping[str, Any],
        report: Callable[[str, Mapping[str, Any]], Mapping[str, Any]],
        order: Callable[[Mapping[str, Any]], None],
        port: int | None = None,
    ) -> None:
        self.token = secrets.token_hex(16)
        page = _page(meshcat, {**about, "token": self.token}).encode()
        handler = partial(_Handler, _Site(page, meshcat, self.token, report, order))
        self._server = _listen(handler, port)
        self._server.daemon_threads = True
        self.url = f"http://localhost:{self._server.server_address[1]}/"

    def serve(self) -> None:
        """Answer until :meth:`close` is called."""
        self._server.serve_forever(poll_interval=0.1)

    def close(self) -> None:
        """The end; from another thread than the one that serves."""
        self._server.shutdown()
        self._server.server_close()


class _Site:
    """What a handler needs."""

    def __init__(
        self,
        page: bytes,
        meshcat: str,
        token: str,
        report: Callable[[str, Mapping[str, Any]], Mapping[str, Any]],
        order: Callable[[Mapping[str, Any]], None],
    ) -> None:
        self.page, self.meshcat, self.token, self.report, self.order = page, meshcat, token, report, order


class _Server(ThreadingHTTPServer):
    request_queue_size = 32

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away in the middle of an answer is no error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def __init__(self, site: _Site, *arguments: Any) -> None:
        self._site = site
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """The page, or what Meshcat has."""
        if not self._from_here():
            self.send_error(403)
        elif self.headers.get("Upgrade", "").lower() == "websocket":
            self._tunnel()
        elif urlsplit(self.path).path in {"/", "/index.html"}:
            self._answer(self._site.page, "text/html; charset=utf-8")
        elif self.path == "/favicon.ico":
            self._answer(_ICON, "image/svg+xml")
        elif _ASSET.fullmatch(self.path):
            self._fetch()
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        """What hands do, or what a button asks for."""
        length = self.headers.get("Content-Length", "")
        if not (length.isdigit() and int(length) <= _MOST):
            self.close_connection = True
            self.send_error(400)
            return
        body = self.rfile.read(int(length))
        given = self.headers.get("X-Mirdrake-Token", "")
        if not (self._from_here() and secrets.compare_digest(given, self._site.token)):
            self.send_error(403)
            return
        try:
            message = json.loads(body)
        except ValueError:
            message = None
        if not isinstance(message, dict):
            self.send_error(400)
        elif self.path == "/report":
            answer = self._site.report(str(message.get("page", "")), message)
            self._answer(json.dumps(answer).encode(), "application/json")
        elif self.path == "/order":
            self._site.order(message)
            self._answer(b"{}", "application/json")
        else:
            self.send_error(404)

    def _from_here(self) -> bool:
        """Whether the browser means this machine by name, and no foreign page sends it."""
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        origin = self.headers.get("Origin")
        return host in _NAMES and (origin is None or urlsplit(origin).netloc == self.headers.get("Host"))

    def _answer(self, content: bytes, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def _fetch(self) -> None:
        try:
            with urllib.request.urlopen(f"{self._site.meshcat}{self.path}", timeout=30.0) as answer:
                self._answer(answer.read(), answer.headers.get("Content-Type", "application/octet-stream"))
        except urllib.error.HTTPError as error:
            self.send_error(error.code)
        except OSError:
            self.send_error(502)

    def _tunnel(self) -> None:
        """Pass a web socket through to Meshcat, byte by byte, until one side closes it."""
        self.close_connection = True
        address = urlsplit(self._site.meshcat)
        try:
            there = socket.create_connection((str(address.hostname), int(address.port or 80)), timeout=10.0)
        except OSError:
            self.send_error(502)
            return
        with there:
            there.settimeout(None)
            there.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            lines = [f"GET {self.path} HTTP/1.1", f"Host: {address.netloc}"]
            lines += [f"{key}: {value}" for key, value in self.headers.items() if key.lower() not in {"host", "origin"}]
            there.sendall(("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"))
            _pump(self.connection, there)

    def log_message(self, format: str, *values: Any) -> None:  # noqa: A002
        """Say nothing."""


def _pump(here: socket.socket, there: socket.socket) -> None:
    """Bytes from each side to the other."""
    other = {here: there, there: here}
    while True:
        ready, _, _ = select.select([here, there], [], [], 60.0)
        for side in ready:
            try:
                data = side.recv(262144)
                if not data:
                    return
                other[side].sendall(data)
            except OSError:
                return


def _listen(handler: Any, port: int | None) -> _Server:
    ports = [port] if port is not None else [*range(PORT, PORT + _TRIED), 0]
    reason = ""
    for one in ports:
        try:
            return _Server((HOST, one), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
    raise RunError(f"the cockpit cannot listen on port {port} of localhost: {reason}; choose another with --port")


def _page(meshcat: str, about: Mapping[str, Any]) -> str:
    """Meshcat's page with the cockpit over it."""
    with urllib.request.urlopen(meshcat, timeout=30.0) as answer:
        page: str = answer.read().decode()
    folder = files(__package__)
    parts = {name: (folder / name).read_text(encoding="utf-8") for name in ("page.html", "page.css", "page.js")}
    data = json.dumps(about).replace("</", "<\\/")
    over = (
        f"<style>\n{parts['page.css']}</style>\n{parts['page.html']}"
        f'<script id="about" type="application/json">{data}</script>\n<script>\n{parts["page.js"]}</script>\n'
    )
    head, mark, tail = page.rpartition("</body>")
    assert mark, "Meshcat's page has no body"
    return (head + over + mark + tail).replace("<title>Drake MeshCat</title>", "<title>mirdrake drive</title>")

"""Local page of the explorer: a server on the loopback interface whose address holds a random token.

Every request must contain the token. Requests from other pages are refused by their origin, and requests to other
names of this machine by their host. The page requests nothing from the network.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import secrets
import socket
import sys
import threading
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from mistray.analyses.explorer.assets import asset
from mistray.analyses.explorer.calls import answer
from mistray.analyses.explorer.explorer import Explorer
from mistray.errors import MistrayError

LOOPBACK = "127.0.0.1"
MOST_BYTES = 1 << 20  # of a request
MOST_STRANGE = 32  # connections that have not told the token
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
FILES = {"": ("page.html", "text/html"), "page.js": ("page.js", "text/javascript"),
         "explore.js": ("explore.js", "text/javascript"), "explore.css": ("explore.css", "text/css")}  # fmt: skip


class PageServer(ThreadingHTTPServer):
    """
    Local web server for the page of an explorer.

    Parameters
    ----------
    explorer : Explorer
        Explorer of a scene.
    port : int
        Port to listen on; 0: any that is free.

    Raises
    ------
    MistrayError
        If the port cannot be used, as when it is taken.
    """

    daemon_threads = True
    allow_reuse_address = False
    request_queue_size = 128  # connections that wait to be taken

    def __init__(self, explorer: Explorer, port: int = 0) -> None:
        self.explorer = explorer
        self.token = secrets.token_urlsafe(24)
        self._strange: dict[Any, None] = {}  # connections that have not told the token, the oldest first
        self._lock = threading.Lock()
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            raise MistrayError(
                f"port {port} cannot be used ({error.strerror or error}); give another one, or leave out --port"
            ) from None

    @property
    def port(self) -> int:
        """Port that the server listens on."""
        return int(self.server_address[1])

    @property
    def address(self) -> str:
        """Address to open in a browser, with the secret token."""
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    @property
    def hosts(self) -> tuple[str, ...]:
        """Host names, with port, by which a browser may address the server; others are refused."""
        return (f"{LOOPBACK}:{self.port}", f"localhost:{self.port}")

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in its own thread; close the oldest one if more than 32 have not sent the token."""
        with self._lock:
            self._strange[request] = None
            oldest = next(iter(self._strange)) if len(self._strange) > MOST_STRANGE else None
            self._strange.pop(oldest, None)
        if oldest is not None:
            with contextlib.suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)
        super().process_request(request, client_address)

    def trust(self, connection: Any) -> None:
        """Mark a connection as trusted, since it has sent the token, so that it stays open."""
        with self._lock:
            self._strange.pop(connection, None)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection and forget it."""
        self.trust(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print errors, but not those of connections that the page closes before an answer is sent."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


@contextlib.contextmanager
def serving(explorer: Explorer, port: int = 0) -> Iterator[PageServer]:
    """Serve the page of an explorer within a block, in separate threads, and yield the server."""
    server = PageServer(explorer, port)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Handler of the HTTP requests of the page on one connection."""

    server: PageServer
    server_version = "mistray"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    timeout = 60

    def do_GET(self) -> None:
        """Answer a GET request with a file of the page; refuse it without the token, or if there is no such file."""
        name = self._name()
        if name is None:
            return
        if name not in FILES:
            return self._say(HTTPStatus.NOT_FOUND, "there is no such file")
        file, kind = FILES[name]
        self._send(HTTPStatus.OK, asset(file).encode(), f"{kind}; charset=utf-8")

    def do_POST(self) -> None:
        """Answer a POST request, a call from the page, with JSON; a call that cannot be answered gets an error."""
        name = self._name()
        if name is None:
            return
        if name != "call":
            return self._say(HTTPStatus.NOT_FOUND, "there is no such call")
        if self.headers.get("Content-Type", "").partition(";")[0].strip() != "application/json":
            return self._say(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a call is application/json")
        lengths = self.headers.get_all("Content-Length", [])
        length = lengths[0] if len(lengths) == 1 else ""
        if not length.isascii() or not length.isdigit() or len(length) > 9 or int(length) > MOST_BYTES:
            return self._say(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a call has at most {MOST_BYTES} bytes")
        try:
            asked = json.loads(self.rfile.read(int(length)))
            if not isinstance(asked, dict):
                raise ValueError("no object")
        except (ValueError, RecursionError):
            return self._say(HTTPStatus.BAD_REQUEST, "a call is a JSON object")
        try:
            found = answer(self.server.explorer, asked.get("call"), asked.get("given", {}))
        except MistrayError as error:
            return self._say(HTTPStatus.BAD_REQUEST, str(error))
        self._send(HTTPStatus.OK, json.dumps(found, allow_nan=False).encode(), "application/json")

    def _name(self) -> str | None:
        """Return the path after the token in the requested address; None if the request was refused."""
        parts = self.path.partition("?")[0].split("/", 2)
        token, name = (parts[1], parts[2]) if len(parts) == 3 else ("", "")
        known = hmac.compare_digest(token.encode("utf-8", "replace"), self.server.token.encode())
        origin = self.headers.get("Origin")
        here = [name in self.server.hosts for name in self.headers.get_all("Host", [])] == [True]
        if not known or not here or (origin is not None and origin not in [f"http://{h}" for h in self.server.hosts]):
            self._say(HTTPStatus.FORBIDDEN, "open the address that mistray app has printed")
            return None
        self.server.trust(self.connection)
        return name

    def _say(self, status: HTTPStatus, what: str) -> None:
        """Refuse a request with an HTTP status and a one-line reason, and close the connection unread."""
        self.close_connection = True
        self._send(status, json.dumps({"error": " ".join(what.split())}).encode(), "application/json")

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        with contextlib.suppress(ConnectionError):
            self.send_response(status)
            for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}.items():
                self.send_header(name, value)
            if self.close_connection:
                self.send_header("Connection", "close")
            self.end_headers()
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Suppress logging, because requests contain the token."""

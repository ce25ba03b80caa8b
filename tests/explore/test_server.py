"""The page is served to who knows the address, on this machine, and to nobody else."""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time

import pytest

from mistray.errors import MistrayError
from mistray.explore.assets import asset
from mistray.explore.server import LOOPBACK, MOST_BYTES, MOST_STRANGE, PageServer, serving


@pytest.fixture(scope="module")
def server(explorer):
    with serving(explorer) as found:
        yield found


def ask(server, method, path, body=None, **headers):
    """Status, headers and body of the answer to one request."""
    connection = http.client.HTTPConnection(LOOPBACK, server.port, timeout=30)
    try:
        connection.request(method, path, body, headers)
        reply = connection.getresponse()
        return reply.status, dict(reply.getheaders()), reply.read()
    finally:
        connection.close()


def call(server, name, given=None, **headers):
    body = json.dumps({"call": name, "given": given or {}})
    status, _, found = ask(
        server, "POST", f"/{server.token}/call", body, **{"Content-Type": "application/json", **headers}
    )
    return status, json.loads(found)


def test_the_page_and_its_files(server):
    for name, kind in (("", "html"), ("page.js", "javascript"), ("explore.js", "javascript"), ("explore.css", "css")):
        status, headers, body = ask(server, "GET", f"/{server.token}/{name}")
        assert status == 200
        assert kind in headers["Content-Type"]
        assert body
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["Cache-Control"] == "no-store"
        assert headers["Referrer-Policy"] == "no-referrer"
    for name in ("page.html", "explore.js", "page.js", "explore.css"):
        assert not [word for word in ("http://", "https://", "//cdn", "@import") if word in asset(name).replace(
            "http://www.w3.org/2000/svg", "")]  # fmt: skip


@pytest.mark.parametrize(
    "path",
    ["/", "", "/call", "//", "/wrong/", "/{token}", "/{token}x/", "/{short}/", "/wrong/{token}/", "/%2e%2e/{token}/",
     "/%C3%A4/"],
)  # fmt: skip
def test_without_the_token_nothing_is_served(server, path):
    path = path.format(token=server.token, short=server.token[:-1])
    assert ask(server, "GET", path)[0] == 403
    assert ask(server, "POST", path, "{}", **{"Content-Type": "application/json"})[0] == 403


def test_the_token_is_long_and_new(server, explorer):
    other = PageServer(explorer)
    assert other.token != server.token
    assert len(other.token) >= 32
    assert other.server_address[0] == LOOPBACK
    other.server_close()


@pytest.mark.parametrize("name", ["../call", "..%2f..%2fetc/passwd", "page.html", "explorer.py", "assets/", "call"])
def test_other_files_are_not_there(server, name):
    assert ask(server, "GET", f"/{server.token}/{name}")[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1:1", "", "127.0.0.1"])
def test_other_hosts_are_refused(server, host):
    """A name of somebody else that was bent to this machine."""
    assert ask(server, "GET", f"/{server.token}/", Host=host)[0] == 403


def test_other_origins_are_refused(server):
    here = f"http://{LOOPBACK}:{server.port}"
    for origin in (here, f"http://localhost:{server.port}"):
        assert call(server, "page", Origin=origin)[0] == 200
    for origin in ("http://evil.example", "null", f"https://{LOOPBACK}:{server.port}", f"{here}.evil"):
        assert call(server, "page", Origin=origin)[0] == 403, origin


def test_calls_answer(server, explorer):
    status, page = call(server, "page")
    assert status == 200
    assert {control["name"] for control in page["controls"]} == set(explorer.controls)
    status, view = call(server, "move", {"values": {"layers": 110.0}})
    assert (status, view["label"]) == (200, "estimate")
    assert call(server, "reset")[1]["values"]["layers"] == 100.0
    status, found = call(server, "move", {"values": {"layers": 1e308}})
    assert status == 400
    assert "layers" in found["error"]
    assert "\n" not in found["error"]


@pytest.mark.parametrize(
    "body", ["", "{", "[]", "null", "3", '"move"', "NaN", "[" * 100_000, '{"call": 3}', '{"call": "eval"}',
             '{"call": "__init__"}', '{"call": "move"}', '{"call": "move", "given": []}',
             '{"call": "move", "given": {"values": []}}', '{"call": "move", "given": {"values": {"layers": NaN}}}',
             '{"call": "detail", "given": {"events": {}}}', '{"call": "detail"}', b"\xff\xfe"]
)  # fmt: skip
def test_bad_calls_are_one_line(server, body):
    status, _, found = ask(server, "POST", f"/{server.token}/call", body, **{"Content-Type": "application/json"})
    assert status == 400
    assert "\n" not in json.loads(found)["error"]


def test_other_kinds_and_sizes_are_refused(server):
    path = f"/{server.token}/call"
    assert ask(server, "POST", path, '{"call": "page"}', **{"Content-Type": "text/plain"})[0] == 415
    assert ask(server, "POST", path, '{"call": "page"}')[0] == 415
    for length in (str(MOST_BYTES + 1), "-1", "1e3", "many"):
        headers = {"Content-Type": "application/json", "Content-Length": length}
        assert ask(server, "POST", path, None, **headers)[0] == 413
    assert ask(server, "PUT", path, "{}")[0] == 501


def test_who_waits_is_told(server, explorer):
    version = explorer.view()["version"]
    threading.Timer(0.2, lambda: explorer.move({"layers": 120.0})).start()
    assert call(server, "wait", {"since": version})[1]["version"] > version
    assert call(server, "wait", {"since": "x"})[1]["version"] > version
    explorer.reset()


def test_a_port_that_is_taken(server, explorer):
    with pytest.raises(MistrayError, match=str(server.port)):
        PageServer(explorer, server.port)


@pytest.mark.parametrize("length", ["9" * 5000, "0" * 20 + "2", "-1", "1_0", "٣", "", "2 3", "2\r\nContent-Length: 2"])
def test_lengths_that_are_none(server, length):
    """Refused with an answer, and nothing of the body is read."""
    lines = [f"POST /{server.token}/call HTTP/1.1", f"Host: {LOOPBACK}:{server.port}", "Content-Type: application/json"]
    with socket.create_connection((LOOPBACK, server.port), timeout=30) as made:
        made.sendall("\r\n".join([*lines, f"Content-Length: {length}", "", "{}"]).encode())
        assert made.recv(1000).startswith(b"HTTP/1.1 413")


def test_a_second_host(server):
    lines = [f"GET /{server.token}/ HTTP/1.1", f"Host: {LOOPBACK}:{server.port}", "Host: evil.example", "", ""]
    with socket.create_connection((LOOPBACK, server.port), timeout=30) as made:
        made.sendall("\r\n".join(lines).encode())
        assert made.recv(1000).startswith(b"HTTP/1.1 403")


def test_connections_that_say_nothing(server):
    """The oldest are closed; the page is answered all the while, and one that knows the token is kept."""
    kept = http.client.HTTPConnection(LOOPBACK, server.port, timeout=30)
    kept.request("GET", f"/{server.token}/page.js")
    assert kept.getresponse().read()
    before = threading.active_count()
    idle = [socket.create_connection((LOOPBACK, server.port), timeout=30) for _ in range(100)]
    assert idle[0].recv(1) == b""  # closed
    assert ask(server, "GET", f"/{server.token}/")[0] == 200
    kept.request("GET", f"/{server.token}/")
    assert kept.getresponse().status == 200
    deadline = time.monotonic() + 10
    while threading.active_count() > before + MOST_STRANGE + 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert threading.active_count() <= before + MOST_STRANGE + 2
    for one in (kept, *idle):
        one.close()

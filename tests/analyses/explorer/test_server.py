"""The page is served to who knows the address, the widget answers as it does, and what Save writes loses no file."""

import http.client
import json
import shutil
import socket
import sys
import threading
import time
from pathlib import Path

import pytest
import vectors
from analyses.explorer.chromium import needs_chromium, page
from command_line import succeeds
from refusals import refused

import mistray
from mistray import Explorer
from mistray.analyses.explorer.assets import asset
from mistray.analyses.explorer.saving import SCENE_FILE, STUDY_FILE
from mistray.analyses.explorer.server import LOOPBACK, MOST_BYTES, MOST_STRANGE, PageServer, serving
from mistray.metrics.parameters import parameters

JSON = {"Content-Type": "application/json"}


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
    status, _, found = ask(server, "POST", f"/{server.token}/call", body, **JSON, **headers)
    return status, json.loads(found)


def test_the_page_and_its_files(server):
    for name, kind in (("", "html"), ("page.js", "javascript"), ("explore.js", "javascript"), ("explore.css", "css")):
        status, headers, body = ask(server, "GET", f"/{server.token}/{name}")
        assert (status, bool(body)) == (200, True)
        assert kind in headers["Content-Type"]
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
    for name in ("page.html", "explore.js", "page.js", "explore.css"):
        text = asset(name).replace("http://www.w3.org/2000/svg", "")
        assert not [word for word in ("http://", "https://", "//cdn", "@import") if word in text]


def test_who_is_refused(server, explorer):
    """Without the token, from another host, or as a name of somebody else that was bent to this machine."""
    token = server.token
    for path in ("/", "", "/call", "/wrong/", f"/{token}", f"/{token}x/", f"/{token[:-1]}/", f"/wrong/{token}/",
                 f"/%2e%2e/{token}/", "/%C3%A4/"):  # fmt: skip
        assert ask(server, "GET", path)[0] == ask(server, "POST", path, "{}", **JSON)[0] == 403, path
    for name in ("../call", "..%2f..%2fetc/passwd", "page.html", "explorer.py", "assets/", "call"):
        assert ask(server, "GET", f"/{token}/{name}")[0] == 404, name
    for host in ("evil.example", "127.0.0.1:1", "", "127.0.0.1"):
        assert ask(server, "GET", f"/{token}/", Host=host)[0] == 403, host
    here = f"http://{LOOPBACK}:{server.port}"
    for origin in (here, f"http://localhost:{server.port}"):
        assert call(server, "page", Origin=origin)[0] == 200
    for origin in ("http://evil.example", "null", f"https://{LOOPBACK}:{server.port}", f"{here}.evil"):
        assert call(server, "page", Origin=origin)[0] == 403, origin
    other = PageServer(explorer)
    assert (other.token != token, len(other.token) >= 32, other.server_address[0]) == (True, True, LOOPBACK)
    other.server_close()
    with refused(str(server.port)):
        PageServer(explorer, server.port)  # which is taken


def test_calls_answer(server, explorer):
    status, page = call(server, "page")
    assert (status, {control["name"] for control in page["controls"]}) == (200, set(explorer.controls))
    status, view = call(server, "move", {"values": {"layers": 110.0}})
    assert (status, view["label"]) == (200, "estimate")
    assert call(server, "reset")[1]["values"]["layers"] == 100.0
    status, found = call(server, "move", {"values": {"layers": 1e308}})
    assert status == 400
    assert "layers" in found["error"]
    assert "\n" not in found["error"]


def test_bad_calls_other_kinds_and_sizes_are_refused(server):
    for body in ("", "{", "[]", "3", '"move"', "NaN", "[" * 100_000, '{"call": 3}', '{"call": "eval"}',
                 '{"call": "__init__"}', '{"call": "move"}', '{"call": "move", "given": []}',
                 '{"call": "move", "given": {"values": []}}', '{"call": "move", "given": {"values": {"layers": NaN}}}',
                 '{"call": "detail", "given": {"events": {}}}', '{"call": "detail"}', b"\xff\xfe"):  # fmt: skip
        status, _, found = ask(server, "POST", f"/{server.token}/call", body, **JSON)
        assert status == 400, body
        assert "\n" not in json.loads(found)["error"]
    # Of lengths that are none, and by a second host, nothing of the body is read
    path = f"/{server.token}/call"
    for kind in ({"Content-Type": "text/plain"}, {}):
        assert ask(server, "POST", path, '{"call": "page"}', **kind)[0] == 415
    assert ask(server, "PUT", path, "{}")[0] == 501
    lines = [f"POST {path} HTTP/1.1", f"Host: {LOOPBACK}:{server.port}", "Content-Type: application/json"]
    lengths = (str(MOST_BYTES + 1), "9" * 5000, "0" * 20 + "2", "-1", "1e3", "٣", "", "2 3", "2\r\nContent-Length: 2")
    raw = [([*lines, f"Content-Length: {length}"], b"HTTP/1.1 413") for length in lengths]
    for head, answer in (*raw, ([*lines, "Host: evil.example", "Content-Length: 2"], b"HTTP/1.1 403")):
        with socket.create_connection((LOOPBACK, server.port), timeout=30) as made:
            made.sendall("\r\n".join([*head, "", "{}"]).encode())
            assert made.recv(1000).startswith(answer), head


def test_who_waits_is_told(server, explorer):
    version = explorer.view()["version"]
    threading.Timer(0.2, lambda: explorer.move({"layers": 120.0})).start()
    assert call(server, "wait", {"since": version})[1]["version"] > version
    assert call(server, "wait", {"since": "x"})[1]["version"] > version
    explorer.reset()


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
    assert until(lambda: threading.active_count() <= before + MOST_STRANGE + 2, 10)
    for one in (kept, *idle):
        one.close()


pytest.importorskip("anywidget", reason="no anywidget; pip install 'mistray[widget]'")
# A model as anywidget hands it over, whose messages go to the server of the page
MODEL = vectors.text("widget_model.js")


@pytest.fixture
def widget(at_start):
    from mistray.analyses.explorer.widget import ExplorerWidget

    found = ExplorerWidget(at_start)
    found.sent = []
    found.send = found.sent.append
    yield found
    found.close()
    for thread in found._threads:
        thread.join(30)


def answer_to(widget, call, asked):
    """The answer to a message; the widget's threads may send views of their own meanwhile."""
    widget._handle_custom_msg({"id": call, **asked}, [])
    return next(sent for sent in widget.sent if sent.get("id") == call)


def until(test, seconds):
    """Wait until it is true, or the time is up."""
    deadline = time.monotonic() + seconds
    while not (done := test()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return done


def test_messages_are_answered_and_traces_follow(widget, at_start):
    assert widget._threads == []  # nothing is traced before somebody looks
    widget._handle_custom_msg([1], [])  # which is none, is passed over
    assert widget.sent == []
    for asked in ({"call": "eval"}, {}, {"call": "move", "given": {"values": {"layers": "x"}}}):
        assert "\n" not in answer_to(widget, "3", asked)["error"]
        widget.sent.clear()
    page = answer_to(widget, "1", {"call": "page"})["found"]
    assert {control["name"] for control in page["controls"]} == set(at_start.controls)
    moved = answer_to(widget, "2", {"call": "move", "given": {"values": {"layers": 90.0}}})["found"]
    assert moved["label"] == "estimate"
    assert until(lambda: any("view" in sent and sent["view"]["label"] == "traced"
                             and sent["view"]["values"]["layers"] == 90.0 for sent in widget.sent), 60)  # fmt: skip
    json.dumps(widget.sent, allow_nan=False)


def test_the_explorer_shows_itself(at_start, monkeypatch):
    shown = at_start._repr_mimebundle_()
    data = shown[0] if isinstance(shown, tuple) else shown
    assert "application/vnd.jupyter.widget-view+json" in data
    at_start._widget.close()
    at_start._widget = None
    monkeypatch.setitem(sys.modules, "mistray.analyses.explorer.widget", None)
    assert "mistray[widget]" in at_start._repr_mimebundle_()["text/plain"]


@needs_chromium
def test_the_front_end_speaks_with_a_model(at_start, tmp_path):
    with serving(at_start) as server, page(tmp_path / "profile") as shown:
        shown.open(server.address)
        shown.until("document.querySelector('table.paths tbody tr')")
        shown.run(MODEL)
        assert shown.run("shown.querySelectorAll('table.paths tbody tr').length") > 5
        shown.run("""(() => { const input = shown.querySelector('[name="layers"]'); input.value = 300;
                              input.dispatchEvent(new Event("input")); })()""")
        shown.until("shown.dataset.answers === '1'")
        assert at_start.state["layers"] == pytest.approx(95.0)
        shown.run(f"tell({json.dumps(at_start.settle())})")
        assert shown.run("shown.dataset.label") == "traced"
        shown.run("leave()")
        assert (shown.run("listeners.size"), shown.errors) == (0, [])


def check_stray(scene, shown, **limits):
    t = mistray.trace(scene, field_deg=0.0, **limits)
    assert sum(row.power_W for row in t.paths if row.kind != "direct") == pytest.approx(shown["stray_W"][0], rel=1e-4)


@pytest.fixture
def saving(at_start, tmp_path):
    at_start.saving.folder, at_start.saving.force = tmp_path, False
    at_start.saving._own.clear()
    yield at_start
    at_start.saving.folder = Path()


def test_the_scene_has_the_coatings_and_numbers_that_were_turned(saving):
    saving.move({"coating window": "bbar3", "layers": 110.0, "detector.bsdf.R": 0.1})
    scene = mistray.load(saving.save_scene())
    for shape in scene.shapes():
        if shape.id() in saving.controls["coating window"].surfaces:
            first, *_ = shape.bsdf().coating.layers
            assert first.thickness_nm == pytest.approx(1.1 * 550 / 4 / 1.38, rel=1e-5)
    assert parameters(scene)["detector.bsdf.R"].value[0] == pytest.approx(0.1, rel=1e-6)
    check_stray(scene, saving.settle(), rays=2000, max_reflections=2)


def test_nothing_is_replaced_but_its_own_files(saving, tmp_path):
    (tmp_path / SCENE_FILE).write_text("mine")
    with refused(SCENE_FILE):
        saving.save_scene()
    assert (tmp_path / SCENE_FILE).read_text() == "mine"
    saving.saving.force = True
    saving.save_scene()
    saving.saving.force = False
    saving.save_scene()  # that of before
    assert not list(tmp_path.glob(".*"))
    (tmp_path / STUDY_FILE).symlink_to(tmp_path / "nowhere")
    saving.move({"detector.bsdf.R": 0.1})
    with refused(STUDY_FILE):
        saving.save_study()
    saving.saving.folder = tmp_path / SCENE_FILE
    with refused(SCENE_FILE):
        saving.save_scene()
    saving.saving.folder = tmp_path / "new" / "folder"
    assert saving.save_scene().is_file()
    scene = tmp_path / SCENE_FILE  # which is explored, is never replaced
    shutil.copy(saving.path, scene)
    other = Explorer(scene, field_deg=[0.0], rays=200)
    other.saving.folder, other.saving.force = tmp_path, True
    before = scene.read_bytes()
    with refused("explored"):
        other.save_scene()
    assert scene.read_bytes() == before


def test_names_of_any_kind(saving, tmp_path):
    """Blanks, brackets, quotation marks and letters of other scripts in names of surfaces, parts and the file."""
    text = saving.path.read_text(encoding="utf-8")
    for old, new in (("window_front", "窓 [1] &quot;front&quot;"), ("window_rear", "a*b? c")):
        text = text.replace(old, new)
    text = text.replace('value="window"', "value=\"p [a] \\ 'b'\"")
    odd = tmp_path / "odd [scene] ü.xml"
    odd.write_text(text, encoding="utf-8")
    other = Explorer(odd, field_deg=[0.0], rays=500)
    other.saving.folder = tmp_path
    other.settle()
    (name,) = [name for name, one in other.controls.items() if "a*b? c" in one.surfaces and one.choices]
    other.move({name: "bbar3"})
    shown = other.settle()
    check_stray(mistray.load(other.save_scene()), shown, rays=500)
    assert "窓 [1]" in other.save_study().read_text(encoding="utf-8")


def test_the_study_runs_on_both_scenes(saving, capsys):
    saving.move({"coating window": "bare"})
    with refused("control"):
        saving.save_study()  # there is nothing to vary
    saving.move({"coating window": "bbar3", "layers": 105.0, "detector.bsdf.R": 0.15})
    scene, study = saving.save_scene(), saving.save_study()
    assert {"detector.bsdf.R", "window_front"} <= set(study.read_text().replace('"', " ").split())
    assert "max_reflections = 2" in study.read_text().splitlines()  # of the explorer
    for path in (scene, saving.path):
        succeeds(capsys, "optimize", path, study, "--steps", 1, "--verification-seeds", 2, "--quiet")

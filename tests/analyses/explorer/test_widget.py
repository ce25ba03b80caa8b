"""The widget answers as the page does, by messages, and shows itself in Jupyter."""

import builtins
import json
import time

import pytest
import vectors
from analyses.explorer.chromium import CHROMIUM, page

from mistray.analyses.explorer.server import serving

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


def answer_to(widget, call):
    """The answer to a call; its threads may send views of their own meanwhile."""
    return next(sent for sent in widget.sent if sent.get("id") == call)


def until(test, seconds=60):
    began = time.monotonic()
    while not test():
        assert time.monotonic() - began < seconds
        time.sleep(0.02)


def test_messages_are_answered_and_traces_follow(widget, at_start):
    assert widget._threads == []  # nothing is traced before somebody looks
    widget._handle_custom_msg([1], [])  # which is none, is passed over
    assert widget.sent == []
    for asked in ({"call": "eval"}, {}, {"call": "move", "given": {"values": {"layers": "x"}}}):
        widget._handle_custom_msg({"id": "3", **asked}, [])
        assert "\n" not in answer_to(widget, "3")["error"]
        widget.sent.clear()
    widget._handle_custom_msg({"id": "1", "call": "page"}, [])
    page = answer_to(widget, "1")["found"]
    assert {control["name"] for control in page["controls"]} == set(at_start.controls)
    widget._handle_custom_msg({"id": "2", "call": "move", "given": {"values": {"layers": 90.0}}}, [])
    moved = answer_to(widget, "2")["found"]
    assert moved["label"] == "estimate"
    until(lambda: any("view" in sent and sent["view"]["label"] == "traced"
                      and sent["view"]["values"]["layers"] == 90.0 for sent in widget.sent))  # fmt: skip
    json.dumps(widget.sent, allow_nan=False)


def test_the_explorer_shows_itself(at_start, monkeypatch):
    shown = at_start._repr_mimebundle_()
    data = shown[0] if isinstance(shown, tuple) else shown
    assert "application/vnd.jupyter.widget-view+json" in data
    at_start._widget.close()
    at_start._widget = None
    real = builtins.__import__

    def without(name, *others):
        if name == "mistray.analyses.explorer.widget":
            raise ImportError(name)
        return real(name, *others)

    monkeypatch.setattr(builtins, "__import__", without)
    assert "mistray[widget]" in at_start._repr_mimebundle_()["text/plain"]


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to show the widget; install chromium")
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
        view = at_start.settle()
        shown.run(f"tell({json.dumps(view)})")
        assert shown.run("shown.dataset.label") == "traced"
        shown.run("leave()")
        assert shown.run("listeners.size") == 0
        assert shown.errors == []

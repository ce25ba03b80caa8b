"""The page of a 3-D view, down to a telephone, light and dark: nothing lies upon another thing or is cut off."""

from __future__ import annotations

from pathlib import Path

import pytest
from analyses.explorer.chromium import CHROMIUM, page

import mistray
from mistray.analyses.view.drawing import LEGEND_LETTERS, legend_text

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to open a page; install chromium"),
]
BOXES = """
[".updatemenu-button", ".colorbar", ".legend", ".legend2"]
  .flatMap((name) => [...document.querySelectorAll(`#view ${name}`)])
  .map((part) => part.getBoundingClientRect()).filter((box) => box.width > 0)
  .map(({ left, right, top, bottom }) => [left, right, top, bottom])
"""


LONG = "17 multiple scatter at third_barrel_wall_2, scatter at the_inner_retaining_ring_of_the_window, 550 nm, 1e-05 W"
COLOURS = "[plot._fullLayout.paper_bgcolor, plot._fullLayout.font.color, plot.data.at(-1).line.color]"


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1100, "light"), (1280, "dark")])
def test_parts_of_a_view_lie_apart(width, scheme, tmp_path):
    pytest.importorskip("plotly")
    axe = pytest.importorskip("axe_core_python.base", reason="no axe; pip install axe-core-python")
    scene = mistray.load("plate")
    seen = mistray.view(scene, mistray.trace(scene, field_deg=5, rays=2000), title="plate")
    seen.figure.data[-1].update(name=legend_text(LONG), line={"color": "#000000"})
    file = seen.write(tmp_path / "view.html", "mistray view plate")
    with page(tmp_path / "profile") as shown:
        shown.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        shown.open(file.as_uri(), width, 844)
        shown.until("document.querySelector('#view .legend')")
        shown.run("new Promise((done) => setTimeout(done, 1000))")
        assert shown.run("document.documentElement.scrollWidth") <= width
        boxes = shown.run(BOXES)
        assert len(boxes) > 6
        for k, (left, right, top, bottom) in enumerate(boxes):
            assert left >= -2
            assert right <= width + 2
            for others in boxes[k + 1 :]:
                assert (
                    right <= others[0] + 2 or others[1] <= left + 2 or bottom <= others[2] + 2 or others[3] <= top + 2
                )
        assert shown.run("plot._fullLayout._size.w") > 0.6 * width
        light = ["white", "#2a3f5f", "#000000"]
        assert (shown.run(COLOURS) == light) == (scheme == "light")
        assert shown.run("getComputedStyle(document.body).backgroundColor === 'rgb(255, 255, 255)'") == (
            scheme == "light"
        )
        shown.run(Path(axe.__file__).with_name("axe.min.js").read_text(encoding="utf-8") + "; 0")
        found = shown.run("axe.run({ exclude: ['svg > *'] })")
        assert [(one["id"], one["nodes"][0]["html"][:200]) for one in found["violations"]] == []
        # The page follows a change of the colours, there and back
        shown.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "light"}])
        shown.run("new Promise((done) => setTimeout(done, 500))")
        assert shown.run(COLOURS) == light
        assert shown.errors == []


def test_names_of_a_legend_break():
    assert legend_text("0 direct image, 3 W") == "0 direct image, 3 W"
    lines = legend_text(LONG).split("<br>")
    assert (len(lines), lines[0]) == (3, "17 multiple scatter at")
    assert lines[2].startswith("…")
    assert lines[2].endswith("_of_the_window, 550 nm, 1e-05 W")
    assert max(map(len, lines)) <= LEGEND_LETTERS
    assert legend_text("<a> & b") == "&lt;a&gt; &amp; b"
    assert max(map(len, legend_text("x" * 100).split("<br>"))) == LEGEND_LETTERS
    assert max(map(len, legend_text("x" * 200).split("<br>"))) == LEGEND_LETTERS

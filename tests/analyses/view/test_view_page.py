"""The page of a 3-D view, down to a telephone, light and dark: nothing lies upon another thing or is cut off."""

import pytest
from analyses.explorer.chromium import needs_chromium, page

import mistray
from mistray.analyses.view.drawing import LEGEND_LETTERS, legend_text

pytestmark = [pytest.mark.long, needs_chromium]
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
    scene = mistray.load("plate")
    seen = mistray.view(scene, mistray.trace(scene, field_deg=5, rays=2000), title="plate")
    seen.figure.data[-1].update(name=legend_text(LONG), line={"color": "#000000"})
    file = seen.write(tmp_path / "view.html", "mistray view plate")
    with page(tmp_path / "profile") as shown:
        shown.like(scheme)
        shown.open(file.as_uri(), width, 844)
        shown.until("document.querySelector('#view .legend')")
        shown.run("new Promise((done) => setTimeout(done, 1000))")
        assert shown.run("document.documentElement.scrollWidth") <= width
        boxes = shown.run(BOXES)
        assert len(boxes) > 6
        for k, (left, right, top, bottom) in enumerate(boxes):
            assert left >= -2
            assert right <= width + 2
            for west, east, north, south in boxes[k + 1 :]:
                assert right <= west + 2 or east <= left + 2 or bottom <= north + 2 or south <= top + 2
        assert shown.run("plot._fullLayout._size.w") > 0.6 * width
        light = ["white", "#2a3f5f", "#000000"]
        assert (shown.run(COLOURS) == light) == (scheme == "light")
        assert shown.is_white() == (scheme == "light")
        assert shown.violations() == []
        # The page follows a change of the colours, there and back
        shown.like("light")
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
    for letters in (100, 200):
        assert max(map(len, legend_text("x" * letters).split("<br>"))) == LEGEND_LETTERS

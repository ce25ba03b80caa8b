"""The page of a 3-D view on a telephone: nothing lies upon another thing, and nothing is cut off."""

from __future__ import annotations

import pytest
from analyses.explorer.chromium import CHROMIUM, page

import mistray

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


@pytest.mark.parametrize("width", [390, 1280])
def test_parts_of_a_view_lie_apart(width, tmp_path):
    pytest.importorskip("plotly")
    scene = mistray.load("plate")
    file = mistray.view(scene, mistray.trace(scene, field_deg=5, rays=2000)).write(tmp_path / "view.html")
    with page(tmp_path / "profile") as shown:
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
        assert shown.errors == []

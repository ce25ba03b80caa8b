"""Every control of a report in a browser: headless Chromium opens the pages and uses them."""

import base64
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import vectors
from analyses.explorer.chromium import Page, needs_chromium, page
from analyses.fake_pst import fake_pst
from analyses.fake_trace import ghosts_of, trace_at

from mistray.analyses.ghosts.figures.ghost_images import common_range
from mistray.analyses.ghosts.page.report import html_text
from mistray.analyses.pst.page import pst_report
from mistray.toolkit.drawings.section_layout import worst_paths
from mistray.toolkit.pages.embedded import palette_png
from mistray.toolkit.pages.render import html_page
from mistray.toolkit.typeset import power_of_ten

WIDE, NARROW = 1300, 390  # pixels: a window, and a telephone
pytestmark = [pytest.mark.long, needs_chromium]
HELPERS = vectors.text("browser_helpers.js")
# The panel of the first field; a box is drawn by the pointer or entered by its edges
PANEL = vectors.text("browser_panel.js")
UNFOLDED = """for (const one of document.querySelectorAll("details.field, details.chapter")) one.open = true;
document.querySelector("div.explorer")?.scrollIntoView()"""
READY = 'document.querySelector("div.explorer.ready") || !document.querySelector("div.explorer")'
# Nothing may be wider than the page, but for tables and pictures, which scroll by themselves
BESIDE = """[...document.querySelectorAll("body *")].filter((place) => !place.closest(".wide, figure, svg, .tip") &&
  place.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map((place) => place.outerHTML)"""


@pytest.fixture(scope="module")
def report():
    return ghosts_of(*map(trace_at, (0.0, 20.0)))


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Page]:
    with page(tmp_path_factory.mktemp("browser") / "profile") as found:
        yield found


@pytest.fixture
def opened(report, browser, tmp_path) -> Iterator[Callable[..., Callable[[str], Any]]]:
    """Opens a page and answers expressions about it; nothing may fail in there."""

    def run(name: str, width: int = WIDE) -> Callable[[str], Any]:
        dot = palette_png(np.zeros((1, 1), dtype=np.uint8), np.zeros((1, 3), dtype=np.uint8))
        if name == "ghosts":
            drawn = dict.fromkeys(("overview.png", "overview_common.png"), dot)  # nothing is done with them
            text = html_text(report, "lens", "mistray ghosts lens", pictures=drawn)
        else:
            text = html_page(pst_report(fake_pst(), "camera"))
        (tmp_path / f"{name}.html").write_text(text, encoding="utf-8")
        browser.open((tmp_path / f"{name}.html").as_uri(), width, 1000)
        browser.until(f"location.href.endsWith('{name}.html') && document.readyState === 'complete'")
        browser.run(HELPERS + (PANEL if name == "ghosts" else ""))
        return browser.run

    yield run
    assert browser.errors == []


def check_tables(run: Callable[[str], Any]) -> None:
    found = run("tables()")
    assert found["sorted"]
    assert all(answer == [True, "ascending", True, "descending"] for answer in found["sorted"].values()), found
    none, again, rows = found["filtered"]
    assert (none, again, found["opens"]) == (0, rows, True)
    assert run("unused()") == []


def test_a_report_of_ghosts(report, browser, opened):
    """A path is chosen and drawn, boxes hold the light of the points within them, and keys do what the pointer does."""
    run, t = opened("ghosts"), report[0.0]
    assert run("[folded.open, panel.classList.contains('ready')]") == [False, False]
    run("document.querySelector('#t-worst a[href=\"#field-0\"]').click(); panel.scrollIntoView()")
    assert run("folded.open")
    browser.until("panel.classList.contains('ready')")
    table = report.table(0.0).sort_values("rank_rms_irradiance")
    paths = [str(path_id) for path_id in table.path_id]
    assert run("ids()") == paths
    all_light = run("light()")
    run("pick.focus(); pick.click()")
    browser.until("which.value === 'path'")
    run("pause()")
    assert run("[which.selectedOptions[0].textContent, pick.getAttribute('aria-pressed')]") == ["path 1", "true"]
    assert "path 1, log₁₀ scale 10" in run("label()")
    events = run("[...panel.querySelectorAll('ol.events li')].map((item) => item.textContent)")
    named = table.events[table.path_id == 1].iloc[0].split()
    assert [item.split(":")[0] for item in events] == [event.split(":")[0] for event in named]
    assert events[-1] == "detector: absorbed"
    (colour,) = (colour for path_id, colour, _ in worst_paths(report, 0.0) if path_id == 1)
    rays = run("[...panel.querySelectorAll('svg.rays path.ray')].map((ray) => ray.getAttribute('stroke'))")
    assert rays == [colour] * 7
    turns = run("panel.querySelectorAll('svg.rays path[stroke=\"#e69f00\"]').length")
    assert turns == 2  # the detector and the window
    path_light = run("light()")
    assert not run("panel.querySelector('input.whole').checked")  # the map has zoomed to the path
    run("click('input.whole')")
    assert path_light > run("light()") > 0  # larger in its own frame
    run("pick.blur(); panel.querySelector('button.back').click()")
    assert run("document.activeElement === pick")
    run("choose('stray')")
    assert "without the direct image, log₁₀ scale 10" in run("label()")
    assert run("light()") not in (0, all_light)
    # A box by the pointer: the upper right quarter of the picture of all light
    run("choose('light')")
    run("drag('pointerdown', 0.5, 0.5); drag('pointerup', 0.5, 0.5)")
    assert not run("boxed()")
    run("drag('pointermove', 1.1, 0.5); drag('pointerdown', 0.5, 0.5); drag('pointermove', 0.8, 0.7)")
    run("drag('pointerup', 1, 1)")
    browser.until("boxed()")
    dragged = x0, x1, y0, y1 = run("['x0', 'x1', 'y0', 'y1'].map((name) => Number(fields[name].value))")
    assert dragged == pytest.approx([0, 2, 0, 1.5], abs=0.051)  # a pixel is 0.05 mm
    expected = {}
    for path_id, path in enumerate(t.fakes):
        x, y = path.points.T
        share = float(((x >= x0) & (x < x1) & (y >= y0) & (y < y1)).mean())
        if share > 0:
            expected[str(path_id)] = path.power * share
    in_box = run("inBox()")
    assert dict(zip(run("ids()"), in_box, strict=True)) == pytest.approx(expected, rel=2e-3)
    assert in_box == sorted(in_box, reverse=True)
    run("click('button[type=\"reset\"]')")
    assert run("ids()") == paths
    run("fields.x0.value = 'none'; panel.querySelector('form').requestSubmit(); pause()")
    assert "Give all four edges" in run("told('.found')")
    run("enter(3, 4, -1, 1)")
    assert run("told('.found')").startswith("The box lies beside the detector")
    assert not run("boxed()")
    run("enter('−2,0', '2', '-1.5', '1,5')")
    assert sum(run("inBox()")) == pytest.approx(t.irradiance.sum() * 0.05**2, rel=2e-3)
    run("press(canvas, 'Escape'); pause()")
    assert not run("boxed()")
    dim = run("light()")
    run("press(canvas, 'ArrowRight')")
    assert run("light()") > dim  # a cross
    assert run("told('.readout')").startswith("x ")
    run("press(canvas, 'ArrowUp', { shiftKey: true }); pause()")
    assert run("told('.found')").startswith("Box x ")
    run("click('button[type=\"reset\"]')")
    assert run("values()")[1] == "field 0°"
    # The field without a direct image, on its own scale and on that of both
    run("const second = document.querySelectorAll('div.explorer')[1], map = second.querySelector('canvas')")
    run("second.closest('details').open = true; second.scrollIntoView()")
    browser.until("second.classList.contains('ready')")
    low, high = (power_of_ten(round(power)) for power in common_range(report))
    assert f"to {high} W/mm²" not in run("map.getAttribute('aria-label')")  # there are ghosts alone
    run("second.querySelector('input.common').click(); pause()")
    assert f"all light, log₁₀ scale {low} to {high} W/mm²" in run("map.getAttribute('aria-label')")
    check_tables(run)


def test_a_report_of_a_pst(opened):
    run = opened("pst")
    assert run("values()") == [True, "PST at 0°", "PST at 2°", "PST at 80°", True]
    assert run("document.querySelectorAll('div.hover .tip tr').length") >= 4
    check_tables(run)


def test_widths_and_accessibility(browser, opened):
    """Nothing is wider than its page; the rules of axe: landmarks, names of controls, contrast, order of headings."""
    for name, width, scheme in (
        ("ghosts", WIDE, "light"), ("ghosts", NARROW, "light"), ("pst", WIDE, "light"), ("ghosts", WIDE, "dark"),
        ("pst", NARROW, "dark"),
    ):  # fmt: skip
        browser.like(scheme)
        run = opened(name, width)
        run(UNFOLDED)
        browser.until(READY)
        scrolled, shown = run("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
        assert scrolled <= shown <= width
        assert run(BESIDE) == []
        assert browser.is_white() == (scheme == "light")
        assert browser.violations() == []
    browser.ask("Emulation.setEmulatedMedia", features=[])


def test_warnings_are_one_line_and_numbers_do_not_break(opened):
    run = opened("ghosts", NARROW)
    warnings = "document.querySelector('details.warnings')"
    assert run(f"{warnings}.open") is False
    assert run(f"{warnings}.getBoundingClientRect().height") < 60
    assert "cured by --rays" in run(f"{warnings}.innerText")
    # Neither exponents of a program nor blanks at which a number parts from its error or its unit
    broken = "[...document.body.innerText.matchAll(/\\d\\.\\d*e[+-]\\d\\d|\\d [±%]/g)].map((found) => found[0])"
    assert run(broken) == []


def test_on_paper(browser, opened):
    """Portrait pages with the answer on the first; folded fields are a line, and settings are printed."""
    opened("ghosts")
    pdf = base64.b64decode(browser.ask("Page.printToPDF")["data"])
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert 3 <= len(boxes) <= 6
    assert all(float(width) < float(height) for width, height in boxes)

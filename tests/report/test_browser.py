"""Every control of a report in a browser: headless Chromium runs the page and a driver that uses them."""

from __future__ import annotations

import html
import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from explore.chromium import CHROMIUM
from report.fake_pst import fake_pst
from report.fake_trace import ghosts_of, trace_at

from mistray.report.figures.layout import worst_paths
from mistray.report.figures.plots import common_range
from mistray.report.ghosts.report import html_text
from mistray.report.html.embedded import palette_png
from mistray.report.html.render import html_page
from mistray.report.pst_output import pst_report

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update",
    "--disable-background-networking", "--disable-sync", "--window-size=1300,1000", "--enable-logging=stderr",
    "--virtual-time-budget=200000", "--dump-dom",
)  # fmt: skip
DRAWN = ("overview.png", "overview_common.png")  # pictures that nothing is done with
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to open a report; install chromium"),
]
DRIVER = """
<script>
const found = { errors: [] };
window.addEventListener("error", (event) => found.errors.push(event.message));
window.addEventListener("unhandledrejection", (event) => found.errors.push(String(event.reason)));
const pause = () => new Promise((done) => setTimeout(done, 50));
const until = async (test) => { for (let k = 0; k < 1000 && !test(); k += 1) await pause(); };
const press = (target, key, more) =>
  target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, ...more }));
// Controls by their kind, so that one of many alike stands for all of them
const CONTROLS = "button, select, input, summary, th[tabindex], canvas[tabindex], div[tabindex]";
const kind = (control) => [control.localName, control.type, control.name, control.className].filter(Boolean).join(" ");
const used = new Set();
for (const name of ["click", "keydown", "input", "change", "submit", "reset", "pointerdown"])
  document.addEventListener(name, ({ target }) => {
    const control = target.closest && target.closest(CONTROLS);
    if (control) used.add(kind(control));
    if (name === "submit") target.querySelectorAll("input, [type=submit]").forEach((one) => used.add(kind(one)));
  }, true);
window.addEventListener("load", async () => {
  try { await drive(); } catch (error) { found.errors.push(String(error)); }
  found.unused = [...new Set([...document.querySelectorAll(CONTROLS)].map(kind))].filter((name) => !used.has(name));
  parent.postMessage({ page: location.pathname.split("/").pop(), found }, "*");
});
</script>
"""
# All pages in one browser, each as large as the window; it tells the results when all have come
FRAMES = """<!DOCTYPE html>
<html><head><meta charset="utf-8"><title>reports</title>
<style>iframe { position: absolute; left: 0; top: 0; width: 1300px; height: 1000px; border: 0; }</style></head><body>
<script>
const found = {};
window.addEventListener("message", (event) => {
  found[event.data.page] = event.data.found;
  if (Object.keys(found).length === document.querySelectorAll("iframe").length)
    document.documentElement.dataset.found = JSON.stringify(found);
});
</script>
%s
</body></html>
"""
FRAME = '<iframe src="%s" style="position: absolute; left: 0; top: 0; width: %dpx; height: 1000px; border: 0"></iframe>'
WIDE, NARROW = 1300, 390  # pixels: a window, and a telephone
GHOSTS = """
<script>
async function drive() {
  const panel = document.querySelector("div.explorer"), canvas = panel.querySelector("canvas");
  const table = document.getElementById(panel.dataset.table), which = panel.querySelector("select.which");
  const rows = () => [...table.tBodies[0].rows].filter((row) => !row.hidden);
  const ids = () => rows().map((row) => row.querySelector("button.pick").dataset.path);
  const folded = panel.closest("details"), link = document.querySelector('#t-worst a[href="#field-0"]');
  found.folded = [folded.open, panel.classList.contains("ready")];
  link.click();
  found.opened = folded.open;
  canvas.setPointerCapture = () => {};  // there is no pointer behind the events below
  panel.scrollIntoView();
  await until(() => panel.classList.contains("ready"));
  found.drawn_when_near = panel.classList.contains("ready");
  const light = () => {
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const pen = copy.getContext("2d", { willReadFrequently: true });
    pen.drawImage(canvas, 0, 0);
    const { data } = pen.getImageData(0, 0, canvas.width, canvas.height);
    let sum = 0; for (let k = 0; k < data.length; k += 4) sum += data[k]; return sum; };
  found.paths = ids();
  found.all_light = light();
  // A path by the keyboard
  const pick = [...table.querySelectorAll("button.pick")].find((button) => button.dataset.path === "1");
  pick.focus(); pick.click();
  await until(() => which.value === "path");
  await pause();
  found.path = which.selectedOptions[0].textContent;
  found.pressed = pick.getAttribute("aria-pressed");
  found.label = canvas.getAttribute("aria-label");
  found.turns = panel.querySelectorAll('svg.rays path[stroke="#e69f00"]').length;
  found.ray_colour = panel.querySelector("svg.rays path.ray").getAttribute("stroke");
  found.events = [...panel.querySelectorAll("ol.events li")].map((item) => item.textContent);
  found.rays = panel.querySelectorAll("svg.rays path.ray").length;
  found.path_light = light();
  panel.querySelector("input.whole").click();
  await pause();
  found.path_alone = light();
  panel.querySelector("input.whole").click();
  await pause();
  pick.blur();
  panel.querySelector("button.back").click();
  found.back = document.activeElement === pick;
  which.value = "stray"; which.dispatchEvent(new Event("change"));
  await pause();
  found.stray_label = canvas.getAttribute("aria-label");
  found.stray_light = light();
  // A box by the pointer: the upper right quarter of the picture of all light
  which.value = "light"; which.dispatchEvent(new Event("change"));
  await pause();
  const frame = canvas.getBoundingClientRect(), width = frame.width - 52 - 74, height = frame.height - 8 - 36;
  const wide = Math.min(width, height * 4 / 3);
  const drag = (kind, x, y) => canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, button: 0, bubbles: true,
    clientX: frame.left + 52 + x * wide, clientY: frame.top + 8 + (1 - y) * wide * 3 / 4 }));
  drag("pointerdown", 0.5, 0.5); drag("pointerup", 0.5, 0.5);
  found.clicked = table.classList.contains("boxed");
  drag("pointermove", 1.1, 0.5);
  drag("pointerdown", 0.5, 0.5); drag("pointermove", 0.8, 0.7);
  drag("pointerup", 1, 1);
  await until(() => table.classList.contains("boxed"));
  found.dragged = ["x0", "x1", "y0", "y1"].map((name) => Number(panel.querySelector("form").elements[name].value));
  found.box_paths = ids();
  found.in_box = rows().map((row) => Number(row.querySelector("td.inbox").dataset.v));
  panel.querySelector('button[type="reset"]').click();
  await pause();
  found.cleared = ids();
  // A box by its edges, then by the keyboard
  const fields = panel.querySelector("form").elements;
  fields.x0.value = "none"; panel.querySelector("form").requestSubmit();
  await pause();
  found.refused = panel.querySelector(".found").textContent;
  const enter = (...values) => {
    ["x0", "x1", "y0", "y1"].forEach((name, k) => { fields[name].value = values[k]; });
    panel.querySelector("form").requestSubmit();
    return pause();
  };
  await enter(3, 4, -1, 1);
  found.outside = panel.querySelector(".found").textContent;
  found.boxed_outside = table.classList.contains("boxed");
  await enter("−2,0", "2", "-1.5", "1,5");
  found.whole = rows().map((row) => Number(row.querySelector("td.inbox").dataset.v));
  press(canvas, "Escape");
  await pause();
  found.escaped = table.classList.contains("boxed");
  const dim = light();
  press(canvas, "ArrowRight");
  found.cross = light() - dim;
  found.read_by_keys = panel.querySelector(".readout").textContent;
  press(canvas, "ArrowUp", { shiftKey: true });
  await pause();
  found.by_keys = panel.querySelector(".found").textContent;
  panel.querySelector('button[type="reset"]').click();
  await pause();
  found.hover = values();
  // The field without a direct image, on its own scale and on that of both
  const second = document.querySelectorAll("div.explorer")[1], map = second.querySelector("canvas");
  second.closest("details").open = true;
  second.scrollIntoView();
  await until(() => second.classList.contains("ready"));
  found.own_scale = map.getAttribute("aria-label");
  second.querySelector("input.common").click();
  await pause();
  found.common_scale = map.getAttribute("aria-label");
  found.tables = tables();
}
</script>
"""
PLOT = """
<script>
// A head of each kind sorts its column up and down; a word that no row has hides all rows; what is folded opens
function tables() {
  const value = (cell) => (cell.dataset.v === undefined || cell.dataset.v === "" ? NaN : Number(cell.dataset.v));
  const sorted = {}, seen = new Set();
  for (const head of document.querySelectorAll("table th[tabindex]")) {
    const rows = [...head.closest("table").tBodies[0].rows];
    if (seen.has(head.className) || rows.length < 2) continue;
    seen.add(head.className);
    const place = [...head.parentNode.cells].indexOf(head);
    const column = () => [...head.closest("table").tBodies[0].rows].map((row) => value(row.cells[place]));
    const rises = (all, sign) => all.every((v, k) => !k || Number.isNaN(v) || !(sign * v < sign * all[k - 1]));
    press(head, "Enter");
    const up = rises(column(), 1), told = head.getAttribute("aria-sort");
    head.click();
    sorted[head.className] = [up, told, rises(column(), -1), head.getAttribute("aria-sort")];
  }
  const filter = document.querySelector("input.filter"), table = document.getElementById(filter.dataset.table);
  const shown = () => [...table.tBodies[0].rows].filter((row) => !row.hidden).length;
  const type = (words) => { filter.value = words; filter.dispatchEvent(new Event("input")); return shown(); };
  const filtered = [type("no such word"), type(""), table.tBodies[0].rows.length];
  const folded = document.querySelector("details"), before = folded.open;
  folded.querySelector("summary").click();
  const opens = folded.open !== before;
  folded.querySelector("summary").click();
  return { sorted, filtered, opens };
}
function values() {
  const plot = document.querySelector("div.hover"), svg = plot.querySelector("svg"), tip = plot.querySelector(".tip");
  const before = tip.hidden;
  press(plot, "ArrowRight");
  const first = tip.querySelector("caption").textContent;
  press(plot, "ArrowRight");
  const second = tip.querySelector("caption").textContent;
  const box = svg.getBoundingClientRect();
  svg.dispatchEvent(new PointerEvent("pointermove", { clientX: box.right, clientY: box.top + 50 }));
  const last = tip.querySelector("caption").textContent, rows = tip.querySelectorAll("tr").length;
  press(plot, "Escape");
  return { before, first, second, last, rows, after: tip.hidden };
}
</script>
"""

# Whatever is folded is opened: nothing may be wider than the page, but for tables, which scroll by themselves
WIDTH = """
<script>
async function drive() {
  for (const details of document.querySelectorAll("details.field, details.chapter")) details.open = true;
  await until(() => document.querySelector("div.explorer.ready"));
  await pause();
  found.width = [document.documentElement.scrollWidth, document.documentElement.clientWidth];
  const beside = (place) => place.getBoundingClientRect().right > document.documentElement.clientWidth + 1;
  found.beside = [...document.querySelectorAll("body *")].filter(
    (place) => beside(place) && !place.closest(".wide, svg, .tip")).map((place) => place.outerHTML.slice(0, 80));
}
</script>
"""
AXE = """
<script>
async function drive() {
  for (const details of document.querySelectorAll("details.field, details.chapter")) details.open = true;
  await until(() => document.querySelector("div.explorer.ready"));
  const { violations } = await axe.run({ exclude: ["svg > *"] });  // a drawing is one picture
  found.violations = violations.map((one) => [one.id, one.impact, one.nodes[0].html.slice(0, 200)]);
}
</script>
"""


def opened(pages: dict[str, tuple[str, str]], folder: Path) -> dict[str, dict]:
    """What the driver of each page found, by name; anything on the console makes it fail."""
    for name, (text, driver) in pages.items():
        page = text.replace("</body>", PLOT + driver + DRIVER + "</body>")
        (folder / name).write_text(page, encoding="utf-8")
    index = folder / "index.html"
    index.write_text(
        FRAMES % "\n".join(FRAME % (name, NARROW if name.startswith("narrow") else WIDE) for name in pages),
        encoding="utf-8",
    )
    command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={folder / 'profile'}", index.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    found = re.search(r'<html[^>]* data-found="([^"]*)"', done.stdout)
    assert found, f"a driver did not finish:\n{done.stderr[-3000:]}"
    assert "CONSOLE" not in done.stderr, done.stderr
    return json.loads(html.unescape(found[1]))


@pytest.fixture(scope="module")
def report():
    return ghosts_of(*map(trace_at, (0.0, 20.0)))


@pytest.fixture(scope="module")
def found(report, tmp_path_factory):
    dot = palette_png(np.zeros((1, 1), dtype=np.uint8), np.zeros((1, 3), dtype=np.uint8))
    pst = "<script>async function drive() { found.hover = values(); found.tables = tables(); }</script>"
    text = html_text(report, "lens", "mistray ghosts lens", pictures={name: dot for name in DRAWN})
    pages = {
        "ghosts.html": (text, GHOSTS),
        "wide.html": (text, WIDTH),
        "narrow.html": (text, WIDTH),
        "pst.html": (html_page(pst_report(fake_pst(), "camera")), pst),
    }
    return opened(pages, tmp_path_factory.mktemp("pages"))


def test_controls_and_widths(found):
    """No errors; every kind of control was used; heads sort, filters hide; nothing is wider than its page."""
    assert {page: result["errors"] for page, result in found.items()} == {page: [] for page in found}
    for page in ("ghosts.html", "pst.html"):
        assert found[page]["unused"] == []
        tables = found[page]["tables"]
        assert tables["sorted"]
        for kind, answer in tables["sorted"].items():
            assert answer == [True, "ascending", True, "descending"], (page, kind)
        none, again, rows = tables["filtered"]
        assert (none, again) == (0, rows)
        assert tables["opens"]
    for page, width in (("wide.html", WIDE), ("narrow.html", NARROW)):
        scrolled, shown = found[page]["width"]
        assert scrolled <= shown <= width
        assert found[page]["beside"] == []
    assert found["ghosts.html"]["hover"]["first"] == "field 0°"
    values = found["pst.html"]["hover"]
    assert (values["before"], values["after"]) == (True, True)
    assert (values["first"], values["second"], values["last"]) == ("PST at 0°", "PST at 2°", "PST at 80°")
    assert values["rows"] >= 4


def test_accessibility(report, tmp_path):
    """The rules of axe for pages: landmarks, names of controls, texts of pictures, contrast, order of headings."""
    axe = pytest.importorskip("axe_core_python.base", reason="no axe; pip install axe-core-python")
    rules = Path(axe.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    pages = {
        "ghosts.html": (html_text(report, "lens"), f"<script>{rules}</script>{AXE}"),
        "pst.html": (
            html_page(pst_report(fake_pst(), "camera")),
            f"<script>{rules}</script>{AXE.replace('.explorer.ready', '')}",
        ),
    }
    found = opened(pages, tmp_path)
    assert {page: result.get("violations") for page, result in found.items()} == {page: [] for page in pages}


def test_on_paper(report, tmp_path):
    """Portrait pages with the answer on the first; folded fields are a line, and settings are printed."""
    (tmp_path / "page.html").write_text(html_text(report, "lens", "mistray ghosts lens"), encoding="utf-8")
    flags = [flag for flag in FLAGS if flag not in ("--dump-dom", "--enable-logging=stderr")]
    command = [str(CHROMIUM), *flags, f"--user-data-dir={tmp_path / 'profile'}", "--no-pdf-header-footer",
               f"--print-to-pdf={tmp_path / 'page.pdf'}", (tmp_path / "page.html").as_uri()]  # fmt: skip
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    pdf = (tmp_path / "page.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert 3 <= len(boxes) <= 6
    assert all(float(width) < float(height) for width, height in boxes)


def test_a_path_is_chosen_and_drawn(report, found):
    found = found["ghosts.html"]
    assert found["folded"] == [False, False]
    assert found["opened"]
    table = report.table(0.0).sort_values("rank_rms_irradiance")
    assert found["drawn_when_near"]
    assert found["paths"] == [str(path_id) for path_id in table.path_id]
    assert (found["path"], found["pressed"]) == ("path 1", "true")
    events = table.events[table.path_id == 1].iloc[0].split()
    assert [item.split(":")[0] for item in found["events"]] == [event.split(":")[0] for event in events]
    assert found["events"][-1] == "detector: absorbed"
    assert found["turns"] == 2  # the detector and the window
    assert found["rays"] == 7
    assert found["ray_colour"] == dict((path_id, colour) for path_id, colour, _ in worst_paths(report, 0.0))[1]
    assert found["back"]
    low, high = common_range(report)
    assert f"all light, log10 scale 1e{low:.0f} to 1e{high:.0f} W/mm²" in found["common_scale"]
    assert f"to 1e{high:.0f} W/mm²" not in found["own_scale"]  # there are ghosts alone
    assert "path 1, log10 scale 1e" in found["label"]
    assert "without the direct image, log10 scale 1e" in found["stray_label"]
    assert found["all_light"] > 0
    assert found["stray_light"] not in (0, found["all_light"])
    assert found["path_alone"] > found["path_light"] > 0  # larger in its own frame


def test_boxes(report, found):
    found, t = found["ghosts.html"], report[0.0]
    assert found["dragged"] == pytest.approx([0, 2, 0, 1.5], abs=0.051)  # a pixel is 0.05 mm
    x0, x1, y0, y1 = found["dragged"]
    expected = {}
    for path_id, path in enumerate(t.fakes):
        x, y = path.points.T
        share = float(((x >= x0) & (x < x1) & (y >= y0) & (y < y1)).mean())
        if share > 0:
            expected[str(path_id)] = path.power * share
    assert dict(zip(found["box_paths"], found["in_box"], strict=True)) == pytest.approx(expected, rel=2e-3)
    assert found["in_box"] == sorted(found["in_box"], reverse=True)
    assert found["clicked"] is found["boxed_outside"] is found["escaped"] is False
    assert found["cleared"] == found["paths"]
    assert "Give all four edges" in found["refused"]
    assert found["outside"].startswith("The box lies beside the detector")
    assert sum(found["whole"]) == pytest.approx(t.irradiance.sum() * 0.05**2, rel=2e-3)
    assert found["cross"] > 0
    assert found["read_by_keys"].startswith("x ")
    assert found["by_keys"].startswith("Box x ")

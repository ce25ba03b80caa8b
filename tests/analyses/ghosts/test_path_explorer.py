"""The panel of a field: what the page holds of its paths, and the scripts that work with it."""

import base64
import io
import json
import re
import shutil
import subprocess
import zlib
from importlib.resources import files

import matplotlib.image
import numpy as np
import pytest
from analyses.fake_trace import EXTENT, SHAPE, ghosts_of, trace_at
from matplotlib.figure import Figure

from mistray.analyses.ghosts.maps.path_maps import PathMap
from mistray.analyses.ghosts.page.fields import explored_paths
from mistray.analyses.ghosts.page.report import html_text
from mistray.analyses.ghosts.page.thumbnails import SIDE, thumbnail
from mistray.recorders.film import WEIGHTS
from mistray.settings import BATCHES
from mistray.toolkit.irradiance import log_range
from mistray.toolkit.pages.embedded import MapStore, colour_table, json_script, palette_png, power_codes
from mistray.toolkit.pages.hover import hover_figure
from mistray.toolkit.pages.render import html_parts

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="no node to run the scripts of a report; install nodejs")
SCRIPTS = ("report", "drawing", "explorer")
# The scripts find nothing to work on, and what they define is at hand
STUB = """
const document = { querySelectorAll: () => [], getElementById: () => null };
%s
const given = JSON.parse(require("fs").readFileSync(0, "utf-8"));
(async () => { const run = async () => { %s }; console.log(JSON.stringify(await run())); })();
"""


def javascript(code: str, given: object, *scripts: str) -> object:
    assets = files("mistray.toolkit.pages").joinpath("assets")
    sources = "\n".join(assets.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in scripts)
    command = [str(NODE), "-e", STUB % (sources, code)]
    done = subprocess.run(command, input=json.dumps(given), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def panel_of(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="data-t-field-0">(.*?)</script>', text)
    held = json.loads(found[1])
    return json.loads(zlib.decompress(base64.b64decode(held["packed"]))) | {"codes": held["codes"]}


def test_page_holds_the_power_of_every_path():
    report = ghosts_of(*map(trace_at, (0.0, 20.0)))
    table, data = report.table(0.0).set_index("path_id"), panel_of(html_text(report, "lens"))
    powers = stored(data["codes"])

    def power(entry: list[int]) -> float:
        return powers[entry[5] : entry[5] + entry[3] * entry[4]].sum()

    found = {int(path_id): power(entry) for path_id, entry in data["paths"].items()}
    assert found == pytest.approx(table.power_W.to_dict(), rel=2e-3)
    assert data["rest"][3:5] == [0, 0]
    assert power(data["direct"]) == pytest.approx(table.power_W[table.kind == "direct"].sum(), rel=2e-3)
    assert power(data["stray"]) == pytest.approx(table.power_W[table.kind != "direct"].sum(), rel=2e-3)
    for lines in data["rays"].values():
        assert 1 <= len(lines) <= 7
        assert all((line[0], line[-2]) == (-2, 5) for line in lines)


def test_paths_beyond_the_memory_are_the_rest(monkeypatch):
    room = 8.0 * SHAPE[0] * SHAPE[1] * (1 + 3 * (BATCHES + WEIGHTS))
    monkeypatch.setattr("mistray.analyses.ghosts.maps.path_maps.MAP_BYTES", room)
    report = ghosts_of(trace_at(0.0))
    table = report.table(0.0).set_index("path_id")
    maps = report.path_maps(0.0, list(table.index))
    assert list(maps.paths) == [0, 1]
    assert maps.rest.power_W.sum() == pytest.approx(table.power_W[2:].sum(), rel=1e-12)
    assert report.path_maps(0.0, list(table.index)) is maps  # made once, also if it has not all of them
    assert f"{len(table) - 2} of these paths have no map" in html_parts(explored_paths(report, 0.0, "t"))


@needs_node
def test_box_names_the_paths_that_the_table_leaves_out(monkeypatch):
    """A table of the worst path alone: in half of the detector the others have the power of their points there."""
    for name in ("ROWS_SHOWN", "STRONGEST_SHOWN"):
        monkeypatch.setattr(f"mistray.analyses.ghosts.page.fields.{name}", 1)
    t = trace_at(0.0)
    report = ghosts_of(t)
    table = report.table(0.0).set_index("path_id")
    data = panel_of(html_text(report, "lens"))
    others = {path_id for path_id, _, _ in data["others"]}
    assert others
    assert others | set(map(int, data["paths"])) == set(table.index)
    x0, x1, y0, y1 = EXTENT
    found = javascript(
        """
        const powers = powersOf(await inflated(bytesOf(given.data.codes)));
        const others = given.data.others.map(([id, label, entry]) => ({ id, label, map: readMap(entry, powers) }));
        const box = snapBox(given.half, given.data.extent, given.data.shape, given.data.grid);
        const about = Object.fromEntries(others.map((path) => [path.id, powerAbout(path.map, box.pixels)]));
        const rest = powerWithin(readMap(given.data.rest, powers), box.pixels);
        return { mm: box.mm, about, rest, text: Explorer.prototype.below.call({ others, box }, rest, rest) };
        """,
        {"data": data, "half": [x0, (x0 + x1) / 2, y0, y1]},
        *SCRIPTS,
    )
    inside = {
        number: path.power * float(np.mean(path.points[:, 0] < found["mm"][1]))
        for number, path in enumerate(t.fakes)
        if number in others
    }
    assert found["rest"] == pytest.approx(sum(inside.values()), rel=5e-3)
    for number, power in inside.items():  # a cell that the edge of the box cuts is a fifteenth of a path at most
        assert found["about"][str(number)] == pytest.approx(power, abs=t.fakes[number].power / 10)
    first = max(inside, key=inside.__getitem__)
    assert f"path {first} ({table.label[first]}, about " in found["text"]


@needs_node
def test_sum_of_two_maps_is_that_of_their_pixels():
    rng = np.random.default_rng(3)
    maps = [
        {"pixels": pixels, "column": column, "row": row, "width": 5, "height": 3, "power": list(rng.random(15))}
        for pixels, column, row in ((4, 2, 1), (2, 9, 3))
    ]
    dark = {"pixels": 8, "column": 0, "row": 0, "width": 0, "height": 0, "power": []}
    code = """
        const sums = [together(...given.maps), together(given.dark, given.maps[0])];
        return sums.map((map) => ({ ...map, power: [...map.power] }));
        """
    both, alone = javascript(code, {"maps": maps, "dark": dark}, *SCRIPTS)

    def pixels_of(found):
        whole, n = np.zeros((40, 40)), found["pixels"]
        power = np.reshape(found["power"], (found["height"], found["width"])) / n**2
        rows, columns = found["row"] * n, found["column"] * n
        spread = power.repeat(n, 0).repeat(n, 1)
        whole[rows : rows + spread.shape[0], columns : columns + spread.shape[1]] = spread
        return whole

    blocks = (pixels_of(maps[0]) + pixels_of(maps[1])).reshape(10, 4, 10, 4).sum(axis=(1, 3))
    np.testing.assert_allclose(pixels_of(both).reshape(10, 4, 10, 4).sum(axis=(1, 3)), blocks, rtol=1e-12, atol=1e-15)
    assert alone["pixels"] == 8
    assert sum(alone["power"]) == pytest.approx(sum(maps[0]["power"]))


@needs_node
def test_parts_of_the_scripts():
    """Scales are those of the thumbnails, numbers sort by value with text last, ticks are round numbers."""
    values = 10.0 ** np.random.default_rng(2).uniform(-9, 2.5, 500)
    values[::5] = 0
    maps = [values, values[:3], np.array([1e-4]), np.zeros(4)]
    found = javascript("return given.map((v) => logRange(v, 6));", [list(v) for v in maps], *SCRIPTS)
    assert [None if limits is None else tuple(limits) for limits in found] == [log_range([v], 6.0) for v in maps]
    by_key = "given.map((text) => key({ dataset: {}, textContent: text })).sort(compare)"
    for code, given, script, answer in (
        (by_key, ["10", "9", "–", "1e-3", "barrel"], "report", [1e-3, 9, 10, "barrel", "–"]),
        ("given.map((x) => nearest([1, 5, 6], x))", [-3, 2.9, 3.1, 5.4, 99], "hover", [0, 0, 1, 1, 2]),
        ("ticks(...given)", [-2.1, 2.1, 5], "drawing", [-2, -1, 0, 1, 2]),
        ("ticks(...given)", [0.0012, 0.0031, 4], "drawing", [0.0015, 0.002, 0.0025, 0.003]),
    ):
        assert javascript(f"return {code};", given, script) == answer


def stored(text: str) -> np.ndarray:
    """The powers of a store, written from its description."""
    high, low = np.split(np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8).astype(np.int64), 2)
    code = 256 * high + low
    return np.where(code == 0, 0.0, 10.0 ** (code / 600 - 100))


def test_powers_json_and_pictures_of_a_page():
    power = 10.0 ** np.random.default_rng(1).uniform(-60, 8, 10_000)
    power[::7] = 0
    store = MapStore()
    assert store.add(PathMap(4, 2, 3, power.reshape(100, 100))) == [4, 2, 3, 100, 100, 0]
    assert store.add(PathMap(1, 0, 0, np.ones((1, 2)))) == [1, 0, 0, 2, 1, 10_000]
    found = stored(store.text())
    np.testing.assert_array_equal(found[:10_000] == 0, power == 0)
    np.testing.assert_allclose(found[:10_000], power, rtol=1.93e-3)  # half a step: 10^(1/1200) - 1
    np.testing.assert_allclose(found[10_000:], 1.0, rtol=1e-12)
    assert power_codes(np.array([0.0, 1e-200, 1e200])).tolist() == [0, 1, 65535]
    assert stored(MapStore().text()).size == 0
    # Rounding goes up as often as down
    assert found.sum() / (power.sum() + 2) == pytest.approx(1, rel=1e-3)
    text = json_script("data-x", {"name": "</script><b>", "µ": [1.5]})
    assert text.count("</script>") == 1
    assert json.loads(text[text.index(">") + 1 : text.rindex("<")]) == {"name": "</script><b>", "µ": [1.5]}
    with pytest.raises(ValueError, match="JSON compliant"):
        json_script("data-x", [float("nan")])
    index = np.arange(256, dtype=np.uint8).reshape(8, 32)
    picture = matplotlib.image.imread(io.BytesIO(palette_png(index, colour_table())), format="png")
    np.testing.assert_array_equal(np.rint(255 * picture[:, :, :3]).astype(np.uint8), colour_table()[index])
    # A thumbnail is centred, upright and on its own scale
    power = np.zeros((60, 80))
    power[40, 60] = 1.0  # in the upper half
    power[40, 59] = 1e-3
    found, pixel = PathMap.of(power, 96), 0.05
    x, y = -2 + 60.5 * pixel, -1.5 + 40.5 * pixel
    result = thumbnail(found, EXTENT, (60, 80), (x, y), 0.0)
    assert result.width_mm == pytest.approx(12 * pixel)
    assert result.limits == (-1.0, 3.0)  # 1 W on (0.05 mm)² is 400 W/mm², 1e-3 W is 0.4
    picture = matplotlib.image.imread(io.BytesIO(result.png), format="png")[:, :, :3]
    assert picture.shape[:2] == (SIDE, SIDE)
    lit, middle = picture.sum(axis=2) > 0, SIDE // 2
    assert lit[middle, middle]
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert rows.mean() == pytest.approx(SIDE / 2 - 0.5, abs=0.6)
    assert picture[middle, middle].sum() > picture[middle, columns[0]].sum() > 0
    above = thumbnail(found, EXTENT, (60, 80), (x, y - 4 * pixel), 0.0)
    rows = np.flatnonzero(matplotlib.image.imread(io.BytesIO(above.png), format="png")[:, :, :3].any(axis=(1, 2)))
    assert rows.mean() < SIDE / 4
    assert thumbnail(PathMap.of(np.zeros((60, 80)), 96), EXTENT, (60, 80), (0.0, 0.0), np.nan).limits is None


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_places_of_values_are_those_of_the_points_that_the_svg_draws(scale):
    x = [1.0, 2.0, 5.0, 9.0]
    figure = Figure(figsize=(7.3, 4.1), dpi=137, layout="constrained")
    above, _ = figure.subplots(2, 1, sharex=True)
    above.set_xscale(scale)
    above.plot(x, [1, 3, 2, 1e3], marker="o")
    above.set_ylabel("a long\nlabel")
    html = hover_figure("data-a", figure, above, x, ["t"] * 4, [[("v", "1 < 2")]] * 4, "what it is")
    data = json.loads(re.search(r'<script type="application/json"[^>]*>(.*?)</script>', html)[1])
    markers = re.findall(r'<use xlink:href="#[^"]*" x="([\d.]+)" y="([\d.]+)" style="fill: #1f77b4', html)
    places, heights = np.array(markers, dtype=float).T
    np.testing.assert_allclose(data["x"], places, atol=0.05)
    left, top, right, bottom = data["area"]
    assert np.all((left < places) & (places < right) & (top < heights) & (heights < bottom))
    view = [float(v) for v in re.search(r'viewBox="([^"]*)"', html)[1].split()]
    np.testing.assert_allclose(data["view"], view, atol=1e-3)
    assert "1 \\u003c 2" in html
    assert 'tabindex="0"' in html

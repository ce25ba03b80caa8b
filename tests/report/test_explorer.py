"""The panel of a field: what the page holds of its paths, and the script that adds up the light in a box."""

from __future__ import annotations

import base64
import importlib
import json
import re
import shutil
import subprocess
import zlib
from importlib.resources import files

import numpy as np
import pytest
from report.fake_trace import EXTENT, SHAPE, ghosts_of, trace_at
from report.test_embedded import stored

from mistray.analysis.irradiance import log_range
from mistray.recorders.film import WEIGHTS
from mistray.report.ghosts.fields import explored_paths
from mistray.report.ghosts.report import html_text
from mistray.report.html.render import html_parts
from mistray.settings import BATCHES

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
    """Run code with the scripts of a report; `given` is its data, what it returns is the answer."""
    assets = files("mistray.report.html").joinpath("assets")
    sources = "\n".join(assets.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in scripts)
    command = [str(NODE), "-e", STUB % (sources, code)]
    done = subprocess.run(command, input=json.dumps(given), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def panel_of(text: str) -> dict:
    """What a page holds of field 0°."""
    found = re.search(r'<script type="application/json" id="data-t-field-0">(.*?)</script>', text)
    held = json.loads(found[1])
    return json.loads(zlib.decompress(base64.b64decode(held["packed"]))) | {"codes": held["codes"]}


def test_page_holds_the_power_of_every_path():
    """And its rays, which start at z = -2 and end at the detector at z = 5."""
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
    monkeypatch.setattr(importlib.import_module("mistray.analysis.maps.path_maps"), "MAP_BYTES", room)
    t = trace_at(0.0)
    report = ghosts_of(t)
    table = report.table(0.0).set_index("path_id")
    maps = report.path_maps(0.0, list(table.index))
    assert list(maps.paths) == [0, 1]
    assert maps.rest.power_W.sum() == pytest.approx(table.power_W[2:].sum(), rel=1e-12)
    assert report.path_maps(0.0, list(table.index)) is maps  # made once, also if it has not all of them
    assert f"{len(table) - 2} of these paths have no map" in html_parts(explored_paths(report, 0.0, "t"))


@needs_node
@pytest.mark.long
def test_box_names_the_paths_that_the_table_leaves_out(monkeypatch):
    """A table of the worst path alone: in half of the detector the others have the power of their points there."""
    fields = importlib.import_module("mistray.report.ghosts.fields")
    monkeypatch.setattr(fields, "ROWS_SHOWN", 1)
    monkeypatch.setattr(fields, "STRONGEST_SHOWN", 1)
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
    """Maps on cells of 4 and 2 pixels, of which the second lies partly beside the first."""
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

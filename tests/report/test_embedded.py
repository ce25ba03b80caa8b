"""What an HTML file holds besides text: maps in sixteen bits, PNG files, JSON, places of the points of a plot."""

from __future__ import annotations

import base64
import io
import json
import re
import zlib

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from mistray.analysis.maps.path_maps import PathMap
from mistray.report.html.embedded import MapStore, colour_table, json_script, palette_png, power_codes
from mistray.report.html.hover import hover_figure
from mistray.report.html.thumbnails import SIDE, thumbnail

EXTENT = (-2.0, 2.0, -1.5, 1.5)


def stored(text: str) -> np.ndarray:
    """The powers of a store, written from its description."""
    raw = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8).astype(np.int64)
    high, low = np.split(raw, 2)
    code = 256 * high + low
    return np.where(code == 0, 0.0, 10.0 ** (code / 600 - 100))


def test_powers_keep_their_value_to_a_fifth_of_a_percent():
    power = 10.0 ** np.random.default_rng(1).uniform(-60, 8, 10_000)
    power[::7] = 0
    store = MapStore()
    assert store.add(PathMap(4, 2, 3, power.reshape(100, 100))) == [4, 2, 3, 100, 100, 0]
    assert store.add(PathMap(1, 0, 0, np.ones((1, 2)))) == [1, 0, 0, 2, 1, 10_000]
    found = stored(store.text())
    np.testing.assert_array_equal(found[:10_000] == 0, power == 0)
    np.testing.assert_allclose(found[:10_000], power, rtol=1.93e-3)  # half a step: 10^(1/1200) - 1
    np.testing.assert_allclose(found[10_000:], 1.0, rtol=1e-12)
    # Beyond the range the last one stays
    assert power_codes(np.array([0.0, 1e-200, 1e200])).tolist() == [0, 1, 65535]
    assert stored(MapStore().text()).size == 0
    # Rounding goes up as often as down
    assert found.sum() / (power.sum() + 2) == pytest.approx(1, rel=1e-3)


def test_json_cannot_end_its_element():
    text = json_script("data-x", {"name": "</script><b>", "µ": [1.5]})
    assert text.count("</script>") == 1
    assert json.loads(text[text.index(">") + 1 : text.rindex("<")]) == {"name": "</script><b>", "µ": [1.5]}
    with pytest.raises(ValueError, match="JSON compliant"):
        json_script("data-x", [float("nan")])


def test_png_is_read_back_by_another_reader():
    index = np.arange(256, dtype=np.uint8).reshape(8, 32)
    picture = matplotlib.image.imread(io.BytesIO(palette_png(index, colour_table())), format="png")
    np.testing.assert_array_equal(np.rint(255 * picture[:, :, :3]).astype(np.uint8), colour_table()[index])


def test_thumbnail_is_centred_upright_and_on_its_own_scale():
    power = np.zeros((60, 80))
    power[40, 60] = 1.0  # in the upper half
    power[40, 59] = 1e-3
    found = PathMap.of(power, 96)
    pixel = 0.05
    x, y = -2 + 60.5 * pixel, -1.5 + 40.5 * pixel
    result = thumbnail(found, EXTENT, (60, 80), (x, y), 0.0)
    assert result.width_mm == pytest.approx(12 * pixel)
    assert result.limits == (-1.0, 3.0)  # 1 W on (0.05 mm)² is 400 W/mm², 1e-3 W is 0.4
    picture = matplotlib.image.imread(io.BytesIO(result.png), format="png")[:, :, :3]
    assert picture.shape[:2] == (SIDE, SIDE)
    lit = picture.sum(axis=2) > 0
    middle = SIDE // 2
    assert lit[middle, middle]
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert rows.mean() == pytest.approx(SIDE / 2 - 0.5, abs=0.6)
    assert picture[middle, middle].sum() > picture[middle, columns[0]].sum() > 0
    # Higher up on the detector is higher up in the picture
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

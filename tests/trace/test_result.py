"""What a trace gives back: maps, boxes, path table, flux report, ray tables."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from oracles.small_scenes import scene_text, shape_xml

import mistray
from mistray.trace import PathRow

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def triplet() -> Any:
    return mistray.trace(mistray.load("cooke_triplet"), rays=20_000, field_deg=8.0)


class TestMaps:
    def test_maps_of_paths_sum_to_the_map_of_the_detected_power(self, triplet) -> None:
        x0, x1, y0, y1 = triplet.extent
        pixel = (x1 - x0) * (y1 - y0) / triplet.irradiance.size
        assert triplet.irradiance.sum() * pixel == pytest.approx(triplet.energy.detected_W, rel=1e-9)
        few = triplet.light.few_rays
        assert few[triplet.irradiance == 0].all()
        assert np.all(triplet.irradiance_se[~few] > 0)
        assert np.isnan(triplet.irradiance_se[few]).all()
        ids = [row.path_id for row in triplet.paths]
        maps = triplet.maps([[number] for number in ids])
        total = sum(values for values, _ in maps)
        np.testing.assert_allclose(total, triplet.irradiance, rtol=1e-6, atol=1e-9 * triplet.irradiance.max())
        for row, (values, _) in zip(triplet.paths, maps, strict=True):
            assert values.sum() * pixel == pytest.approx(row.power_W, rel=1e-9)
        ghosts, direct = triplet.each_map([ids[1:], [0]], [True, True])
        se, direct_se, whole = (np.linalg.norm(one.apart, axis=-1) for one in (ghosts, direct, triplet.light))
        np.testing.assert_allclose(np.hypot(se, direct_se), whole, rtol=2e-2)
        assert not triplet.irradiance_of([])[0].any()
        for groups, words in (
            ([[99999]], "path_id 99999 does not exist"),
            ([[0, 1], [1]], "path_id 1 is in two groups"),
        ):
            with pytest.raises(mistray.MistrayError, match=words):
                triplet.maps(groups)

    @pytest.mark.parametrize("turn_deg", [0, 90])
    def test_axes_of_an_oblong_detector(self, load_text, turn_deg: int) -> None:
        """x grows along columns, y along rows; turned, its own x is the world's y, and its own y the world's -x."""
        detector = shape_xml("asphere", "detector", 5.0, sensor=True, half_width=6.0, half_height=3.0)
        detector = detector.replace("<translate", f'<rotate z="1" angle="{turn_deg}"/><translate')
        text = scene_text(detector, radius=0.05).replace('name="height" value="64"', 'name="height" value="20"')
        x, y = (-4.0, 2.0) if turn_deg == 0 else (-2.0, -4.0)
        aside = f'<transform name="to_world"><translate x="{x}" y="{y}"/></transform></emitter>'
        t = mistray.trace(load_text(text.replace("</emitter>", aside))[0], rays=500)
        assert (t.extent, t.irradiance.shape) == ((-6.0, 6.0, -3.0, 3.0), (20, 64))
        row, column = np.unravel_index(t.irradiance.argmax(), t.irradiance.shape)
        assert (column, row) == (int((-4 + 6) / 12 * 64), int((2 + 3) / 6 * 20))
        assert (t.paths[0].x_mm, t.paths[0].y_mm) == pytest.approx((-4.0, 2.0), abs=0.01)

    @pytest.mark.parametrize("mode", [{}, {"below_threshold": "roulette", "flux_threshold": 0.5}])
    def test_random_walks_repeat_exactly(self, mode: dict[str, Any]) -> None:
        t = mistray.trace(mistray.load("cooke_triplet"), rays=8000, field_deg=5.0, splitting="one", **mode)
        total, _ = t.irradiance_of([row.path_id for row in t.paths])
        np.testing.assert_allclose(total, t.irradiance, rtol=1e-12, atol=1e-12 * t.irradiance.max())
        assert [row.rays for row in t.box(*t.extent)] == [row.rays for row in t.paths]
        for row in t.paths[1:4]:
            table = t.history(row.path_id, 10_000).to_pandas()
            hits = table[table.intercept == "Absorbed"]
            assert len(hits) == row.rays
            assert hits.flux_W.sum() == pytest.approx(row.incident_W, rel=1e-9)
            assert np.average(hits.x_mm, weights=hits.flux_W) == pytest.approx(row.x_mm, abs=1e-4)

    def test_everything(self, triplet) -> None:
        x0, x1, y0, y1 = triplet.extent
        box = triplet.box(x0, x1, y0, y1)
        assert [(row.events, row.rays) for row in box] == [(row.events, row.rays) for row in triplet.paths]
        for a, b in zip(box, triplet.paths, strict=True):
            assert a.power_W == pytest.approx(b.power_W, rel=1e-12)
            assert a.rms_radius_mm == pytest.approx(b.rms_radius_mm, rel=1e-6)
        assert len(triplet.box(-19.0, -18.9, -19.0, -18.9)) == 0
        # A box of whole pixels holds what the map holds there
        height, width = triplet.irradiance.shape
        x0, x1, y0, y1 = triplet.extent
        dx, dy = (x1 - x0) / width, (y1 - y0) / height
        row, column = np.unravel_index(triplet.irradiance.argmax(), triplet.irradiance.shape)
        for reach in (0, 3, 40):  # the core of the image is narrower than a pixel
            c0, c1 = max(column - reach, 0), min(column + reach + 1, width)
            r0, r1 = max(row - reach, 0), min(row + reach + 1, height)
            eps = 1e-6 * dx
            box = triplet.box(x0 + c0 * dx + eps, x0 + c1 * dx - eps, y0 + r0 * dy + eps, y0 + r1 * dy - eps)
            inside = triplet.irradiance[r0:r1, c0:c1].sum() * dx * dy
            assert sum(p.power_W for p in box) == pytest.approx(inside, rel=1e-3)
            assert box[0].percent == pytest.approx(100 * box[0].power_W / sum(p.power_W for p in box))
            for p in box:
                assert x0 + c0 * dx <= p.x_mm <= x0 + c1 * dx
                assert y0 + r0 * dy <= p.y_mm <= y0 + r1 * dy


class TestPathTable:
    def test_columns_and_order(self, triplet, tmp_path: Path) -> None:
        table = triplet.paths.to_pandas()
        assert list(table.columns) == [f.name for f in fields(PathRow)]
        assert list(table.path_id) == list(range(len(table)))
        assert table.power_W.is_monotonic_decreasing
        assert table.percent.sum() == pytest.approx(100)
        assert (table.order % 2 == 0).all()
        assert table.kind[0] == "direct"
        expected = table.power_W / np.pi / table.rms_radius_mm**2
        np.testing.assert_allclose(table.rms_irradiance_W_mm2, expected, rtol=1e-9)
        triplet.paths.to_csv(tmp_path / "paths.csv")
        pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "paths.csv"), table, check_dtype=False, rtol=5e-9)
        # Find: words in this order, others between
        paths = triplet.paths
        one = paths.find("L3_rear:R", "L1_front:R")
        assert one == [row for row in paths if (row.ghost_1, row.ghost_2) == ("L3_rear", "L1_front")] != []
        assert not paths.find("L1_front:R", "L3_rear:R")
        assert len(paths.find("L1_front")) == len(paths)
        for wrong, near in (("L1_fron", "'L1_front'"), ("1_front:T", "'L1_front'"), ("L1_front:.", "one of A")):
            with pytest.raises(mistray.MistrayError, match=near):
                paths.find(wrong)
        assert len(paths.find("detector:A")) == len(paths)
        assert paths.find() == list(paths)
        assert paths.find("L2_front:T", "L2_front:T") == [row for row in paths if row.events.count("L2_front:T") >= 2]

    def test_none_and_empty(self, load_text) -> None:
        scene = mistray.load("cooke_triplet")
        t, with_ledger = (mistray.trace(scene, rays=2000, ledger=ledger) for ledger in (False, True))
        for use in (lambda: t.paths, lambda: t.box(0, 1, 0, 1), lambda: t.history(0), lambda: t.irradiance_of([0])):
            with pytest.raises(mistray.MistrayError, match="trace with ledger=True"):
                use()
        assert t.energy.detected_W == pytest.approx(with_ledger.energy.detected_W, rel=1e-12)
        assert t.segments == with_ledger.segments
        wall = shape_xml("asphere", "wall", 0.0, semi_diameter=3.0)
        screen = shape_xml("asphere", "detector", 5.0, sensor=True, half_width=1.0, half_height=1.0)
        t = mistray.trace(load_text(scene_text(wall, screen))[0], rays=100)
        assert list(t.paths.to_pandas().columns) == [f.name for f in fields(PathRow)]
        assert (len(t.paths), len(t.rays()), t.paths.find("wall"), t.energy.detected_W) == (0, 0, [], 0)
        assert not t.irradiance.any()
        assert t.energy.absorbed["wall"][0] == pytest.approx(np.pi)


def test_history(triplet) -> None:
    row = triplet.paths[1]
    history = triplet.history(row.path_id, 5)
    assert len(history) == 5
    rare = triplet.paths[-1]
    assert len(triplet.history(rare.path_id, 100_000)) == rare.rays
    for wrong, words in (((0, 0), "n is 0"), ((-1,), "path_id -1 does not exist")):
        with pytest.raises(mistray.MistrayError, match=words):
            triplet.history(*wrong)
    table = history.to_pandas()
    columns = ["ray", "node", "start_ray", "intercept", "object", "surface", "wavelength_nm"]
    assert list(table.columns) == [*columns, "x_mm", "y_mm", "z_mm", "flux_W", "opl_mm", "dx", "dy", "dz"]
    unit = triplet.energy.launched_W / triplet.settings["rays"]
    for number, points in enumerate(history.rays):
        ray = table[table.ray == number]
        np.testing.assert_array_equal(ray[["x_mm", "y_mm", "z_mm"]].to_numpy(), points)
        assert list(ray.intercept) == ["Emitted", *(what for _, what in row.event_list)]
        assert list(ray.surface)[1:] == [name for name, _ in row.event_list]
        assert list(ray.node) == list(range(len(points)))
        assert ray.flux_W.iloc[0] == ray.flux_W.iloc[1] == pytest.approx(unit, rel=1e-6)
        assert ray.flux_W.is_monotonic_decreasing
        steps = np.diff(points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        directions = ray[["dx", "dy", "dz"]].to_numpy()
        np.testing.assert_allclose(directions[:-1] * lengths[:, None], steps, atol=1e-9)
        assert not directions[-1].any()
        opl = np.diff(ray.opl_mm.to_numpy())
        assert np.all(opl >= lengths * (1 - 1e-12))
        assert opl[[0, -1]] == pytest.approx(lengths[[0, -1]], rel=1e-12)  # air


def test_flux_at_the_surfaces_of_a_plate() -> None:
    t = mistray.trace(mistray.load("plate"), rays=1000)
    rows = {row.id: row for row in t.surfaces}
    r, launched = 0.04, t.energy.launched_W
    # Front: from outside, and the first reflection from inside; two reflections are the limit
    assert (rows["plate_front"].hits, rows["plate_edge"].hits, rows["plate_front"].part) == (2000, 0, "plate")
    assert rows["plate_front"].incident_W == pytest.approx(launched * (1 + (1 - r) * r), rel=1e-6)
    assert rows["plate_rear"].incident_W == pytest.approx(launched * (1 - r) * (1 + r * r), rel=1e-6)
    assert (rows["detector"].absorbed_W, rows["plate_front"].absorbed_W) == (t.energy.detected_W, 0)
    assert list(t.surfaces.to_pandas().id) == list(rows)

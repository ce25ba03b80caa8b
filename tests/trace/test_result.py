"""What a trace gives back: maps, boxes, path table, flux report, ray tables."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.trace import PathRow

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def triplet() -> Any:
    return mistray.trace(mistray.load("cooke_triplet"), rays=20_000, field_deg=8.0)


@pytest.fixture(scope="module")
def ball_text() -> str:
    """A strong lens with a glass edge: ghosts, total reflections, structure; the detector reflects and is oblong."""
    glass = interface_xml("1.8", "air")
    return scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", "1.8"), radius=5.0, semi_diameter=4.0),
        shape_xml("asphere", "rear", 8.0, glass, radius=-5.0, semi_diameter=4.0),
        shape_xml("frustum", "edge", 0.0, glass, r0=4.0, z0=2.0, r1=4.0, z1=6.0),
        shape_xml("frustum", "tube", 0.0, interface_xml(R=0.1), r0=6.0, z0=0.0, r1=6.0, z1=14.0),
        shape_xml("asphere", "detector", 14.0, interface_xml(R=0.3), sensor=True, half_width=6.0, half_height=3.0),
        radius=3.5,
    ).replace('name="height" value="64"', 'name="height" value="20"')


class TestMaps:
    def test_map_holds_the_detected_power(self, triplet) -> None:
        x0, x1, y0, y1 = triplet.extent
        pixel = (x1 - x0) * (y1 - y0) / triplet.irradiance.size
        assert triplet.irradiance.sum() * pixel == pytest.approx(triplet.energy.detected_W, rel=1e-9)
        assert triplet.irradiance.dtype == np.float64
        few = triplet.light.few_rays
        assert few[triplet.irradiance == 0].all()
        assert np.all(triplet.irradiance_se[~few] > 0)
        assert np.isnan(triplet.irradiance_se[few]).all()

    def test_maps_of_all_paths_sum_to_the_map(self, triplet) -> None:
        maps = triplet.maps([[row.path_id] for row in triplet.paths])
        total = sum(values for values, _ in maps)
        np.testing.assert_allclose(total, triplet.irradiance, rtol=1e-6, atol=1e-9 * triplet.irradiance.max())
        x0, x1, y0, y1 = triplet.extent
        pixel = (x1 - x0) * (y1 - y0) / triplet.irradiance.size
        for row, (values, _) in zip(triplet.paths, maps, strict=True):
            assert values.sum() * pixel == pytest.approx(row.power_W, rel=1e-9)

    def test_irradiance_of_some_paths(self, triplet) -> None:
        ids = [row.path_id for row in triplet.paths]
        ghosts, direct = triplet.each_map([ids[1:], [0]], [True, True])
        value = ghosts.value + direct.value
        np.testing.assert_allclose(value, triplet.irradiance, rtol=1e-9, atol=1e-9 * triplet.irradiance.max())
        se, direct_se, whole = (np.linalg.norm(one.apart, axis=-1) for one in (ghosts, direct, triplet.light))
        np.testing.assert_allclose(np.hypot(se, direct_se), whole, rtol=2e-2)
        nothing, _ = triplet.irradiance_of([])
        assert not nothing.any()

    @pytest.mark.parametrize(
        "mode", [{"splitting": "one"}, {"splitting": "one", "below_threshold": "roulette", "flux_threshold": 0.5}]
    )
    def test_random_walks_repeat_exactly(self, mode: dict[str, Any]) -> None:
        """Maps, boxes and histories trace the same rays again and must draw the same random numbers."""
        t = mistray.trace(mistray.load("cooke_triplet"), rays=8000, field_deg=5.0, **mode)
        total, _ = t.irradiance_of([row.path_id for row in t.paths])
        np.testing.assert_allclose(total, t.irradiance, rtol=1e-12, atol=1e-12 * t.irradiance.max())
        assert [row.rays for row in t.box(*t.extent)] == [row.rays for row in t.paths]
        for row in t.paths[1:4]:
            table = t.history(row.path_id, 10_000).to_pandas()
            hits = table[table.intercept == "Absorbed"]
            assert len(hits) == row.rays
            assert hits.flux_W.sum() == pytest.approx(row.incident_W, rel=1e-9)
            assert np.average(hits.x_mm, weights=hits.flux_W) == pytest.approx(row.x_mm, abs=1e-4)

    def test_errors(self, triplet) -> None:
        with pytest.raises(mistray.MistrayError, match="path_id 99999 does not exist"):
            triplet.irradiance_of([99999])
        with pytest.raises(mistray.MistrayError, match="path_id 1 is in two groups"):
            triplet.maps([[0, 1], [1]])

    def test_axes_of_an_oblong_detector(self, load_text) -> None:
        """x grows along columns, y along rows: a beam aside lights the pixels that its coordinates say."""
        text = scene_text(
            shape_xml("asphere", "plane", 0.0, interface_xml(), semi_diameter=50.0),
            shape_xml("asphere", "detector", 5.0, sensor=True, half_width=6.0, half_height=3.0),
            radius=0.05,
        ).replace('name="height" value="64"', 'name="height" value="20"')
        aside = text.replace("</emitter>", '<transform name="to_world"><translate x="-4" y="2"/></transform></emitter>')
        t = mistray.trace(load_text(aside)[0], rays=500)
        assert t.extent == (-6.0, 6.0, -3.0, 3.0)
        assert t.irradiance.shape == (20, 64)
        row, column = np.unravel_index(t.irradiance.argmax(), t.irradiance.shape)
        assert column == int((-4 + 6) / 12 * 64)
        assert row == int((2 + 3) / 6 * 20)
        assert (t.paths[0].x_mm, t.paths[0].y_mm) == pytest.approx((-4.0, 2.0), abs=0.01)

    def test_axes_follow_a_turned_detector(self, load_text) -> None:
        text = scene_text(
            shape_xml("asphere", "plane", 0.0, interface_xml(), semi_diameter=50.0),
            shape_xml("asphere", "detector", 5.0, sensor=True, half_width=6.0, half_height=3.0),
            radius=0.05,
        )
        turned = text.replace('<translate z="5.0"/>', '<rotate z="1" angle="90"/><translate z="5.0"/>')
        aside = turned.replace(
            "</emitter>", '<transform name="to_world"><translate x="-1" y="2"/></transform></emitter>'
        )
        t = mistray.trace(load_text(aside)[0], rays=500)
        # the detector's own x is the world's y, its own y the world's -x
        assert (t.paths[0].x_mm, t.paths[0].y_mm) == pytest.approx((2.0, 1.0), abs=0.01)


class TestBox:
    def test_everything(self, triplet) -> None:
        x0, x1, y0, y1 = triplet.extent
        box = triplet.box(x0, x1, y0, y1)
        assert [(row.events, row.rays) for row in box] == [(row.events, row.rays) for row in triplet.paths]
        for a, b in zip(box, triplet.paths, strict=True):
            assert a.power_W == pytest.approx(b.power_W, rel=1e-12)
            assert a.rms_radius_mm == pytest.approx(b.rms_radius_mm, rel=1e-6)

    def test_pixels(self, triplet) -> None:
        """A box of whole pixels holds what the map holds there."""
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

    def test_the_trace_stays_as_it_is(self, triplet) -> None:
        before = triplet.paths.to_pandas()
        triplet.box(0.0, 0.1, 0.0, 0.1)
        pd.testing.assert_frame_equal(before, triplet.paths.to_pandas())
        total, _ = triplet.irradiance_of([row.path_id for row in triplet.paths])
        np.testing.assert_allclose(total, triplet.irradiance, rtol=1e-9, atol=1e-9 * triplet.irradiance.max())

    def test_empty_and_wrong(self, triplet) -> None:
        assert len(triplet.box(-19.0, -18.9, -19.0, -18.9)) == 0
        with pytest.raises(mistray.MistrayError, match="x 1 … 0, y 0 … 1 mm"):
            triplet.box(1, 0, 0, 1)


class TestPathTable:
    def test_columns_and_order(self, triplet) -> None:
        table = triplet.paths.to_pandas()
        assert list(table.columns) == [f.name for f in fields(PathRow)]
        assert list(table.path_id) == list(range(len(table)))
        assert table.power_W.is_monotonic_decreasing
        assert table.percent.sum() == pytest.approx(100)
        assert (table.order % 2 == 0).all()
        assert table.path_id[0] == 0
        assert table.kind[0] == "direct"
        np.testing.assert_allclose(
            table.rms_irradiance_W_mm2, table.power_W / np.pi / table.rms_radius_mm**2, rtol=1e-9
        )

    def test_csv_round_trip(self, triplet, tmp_path: Path) -> None:
        triplet.paths.to_csv(tmp_path / "paths.csv")
        table = triplet.paths.to_pandas()
        read = pd.read_csv(tmp_path / "paths.csv")
        assert list(read.columns) == list(table.columns)
        pd.testing.assert_frame_equal(read, table, check_dtype=False, rtol=5e-9)

    def test_rows(self, load_text, ball_text: str) -> None:
        """Classification of every row from its own events."""
        t = mistray.trace(load_text(ball_text)[0], rays=20_000, field_deg=20.0)
        assert {"direct", "ghost", "structure", "structure+ghost"} <= {row.kind for row in t.paths}
        assert any(row.tir for row in t.paths)
        for row in t.paths:
            events = row.event_list
            assert events[-1] == ("detector", "Absorbed")
            assert len(events) == len(row.path) == len(row.events.split())
            mirrors = [name for name, what in events if what == "SpecRefl"]
            structure = sum(name == "tube" for name in mirrors)
            assert row.structure_bounces == structure
            assert row.order == len(mirrors) - structure
            assert row.tir == sum(what == "TIR" for _, what in events)
            assert [row.ghost_1, row.ghost_2] == [*mirrors, "-", "-"][:2]
            expected = {(0, 0): "direct", (1, 0): "ghost", (0, 1): "structure", (1, 1): "structure+ghost"}
            if len(events) > 1 and (row.order or row.structure_bounces or not row.tir):
                assert row.kind == expected[row.order > 0, row.structure_bounces > 0] or row.kind == "straight shot"
            assert row.scatter_1 == "-"
            assert row.incident_W == pytest.approx(row.power_W / 0.7, rel=1e-6)
            assert row.power_W >= 0
            assert row.source == "emitter" or row.source.startswith("source")

    def test_find(self, triplet) -> None:
        """Words in this order, others between; ids are not patterns and not beginnings of others."""
        paths = triplet.paths
        one = paths.find("L3_rear:R", "L1_front:R")
        assert [row.events for row in one] == [
            row.events for row in paths if (row.ghost_1, row.ghost_2) == ("L3_rear", "L1_front")
        ]
        assert one
        assert not paths.find("L1_front:R", "L3_rear:R")
        assert len(paths.find("L1_front")) == len(paths)
        for wrong, near in (("L1_fron", "'L1_front'"), ("1_front:T", "'L1_front'"), ("L1_front:.", "one of A")):
            with pytest.raises(mistray.MistrayError, match=near):
                paths.find(wrong)
        assert len(paths.find("detector:A")) == len(paths)
        assert paths.find() == list(paths)
        rows = paths.find("L2_front:T", "L2_front:T")
        assert rows
        assert all(row.events.count("L2_front:T") >= 2 for row in rows)

    def test_table_as_a_sequence(self, triplet) -> None:
        assert [row.path_id for row in triplet.paths[:3]] == [0, 1, 2]
        assert triplet.paths[-1].path_id == len(triplet.paths) - 1
        text = str(triplet.paths)
        assert all(row.ghost_1 in text for row in triplet.paths[:20])
        assert text.count("\n") >= min(len(triplet.paths), 20)
        assert f"{len(triplet.paths)} paths" in repr(triplet)

    def test_no_ledger(self) -> None:
        scene = mistray.load("cooke_triplet")
        t = mistray.trace(scene, rays=20_000, field_deg=8.0, ledger=False)
        for use in (lambda: t.paths, lambda: t.box(0, 1, 0, 1), lambda: t.history(0), lambda: t.irradiance_of([0])):
            with pytest.raises(mistray.MistrayError, match="trace with ledger=True"):
                use()
        with_ledger = mistray.trace(scene, rays=20_000, field_deg=8.0)
        assert t.energy.detected_W == pytest.approx(with_ledger.energy.detected_W, rel=1e-12)
        assert t.segments == with_ledger.segments

    def test_empty(self, load_text) -> None:
        """Nothing reaches the detector: an empty table with all its columns, and maps of zeros."""
        scene, _ = load_text(
            scene_text(
                shape_xml("asphere", "wall", 0.0, semi_diameter=3.0),
                shape_xml("asphere", "detector", 5.0, sensor=True, half_width=1.0, half_height=1.0),
            )
        )
        t = mistray.trace(scene, rays=100)
        assert len(t.paths) == 0
        assert list(t.paths.to_pandas().columns) == [f.name for f in fields(PathRow)]
        assert not t.irradiance.any()
        assert t.energy.detected_W == 0
        assert t.energy.absorbed["wall"][0] == pytest.approx(np.pi)
        assert t.paths.find("wall") == []
        assert t.rays().empty


class TestRayTables:
    def test_history(self, triplet) -> None:
        row = triplet.paths[1]
        history = triplet.history(row.path_id, 5)
        assert len(history) == 5
        table = history.to_pandas()
        columns = ["ray", "node", "start_ray", "intercept", "object", "surface", "wavelength_nm"]
        assert list(table.columns) == [*columns, "x_mm", "y_mm", "z_mm", "flux_W", "opl_mm", "dx", "dy", "dz"]
        unit = triplet.energy.launched_W / triplet.settings["rays"]
        for number, points in enumerate(history.rays):
            ray = table[table.ray == number]
            np.testing.assert_array_equal(ray[["x_mm", "y_mm", "z_mm"]].to_numpy(), points)
            events = [("Emitted", "source"), *((what, name) for name, what in row.event_list)]
            assert list(ray.intercept) == [what for what, _ in events]
            assert list(ray.surface)[1:] == [name for _, name in events][1:]
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
            assert opl[0] == pytest.approx(lengths[0], rel=1e-12)  # air
            assert opl[-1] == pytest.approx(lengths[-1], rel=1e-12)

    def test_optical_path_lengths_of_a_paraboloid(self, load_text) -> None:
        """All of them are equal to the focus (Fermat), to 1e-12; also from float32 start rays."""
        scene, _ = load_text(
            scene_text(
                shape_xml("asphere", "mirror", 0.0, interface_xml(R=0.9, mirror=True), radius=-200.0, conic=-1.0,
                          semi_diameter=30.0),
                shape_xml("asphere", "detector", -100.0, sensor=True, half_width=1.0, half_height=1.0),
                radius=25.0,
            )
        )  # fmt: skip
        t = mistray.trace(scene, rays=3000)
        row = next(row for row in t.paths if row.path == "RA")
        table = t.history(row.path_id, 200).to_pandas()
        opl = table[table.intercept == "Absorbed"].opl_mm
        assert len(opl) == 200
        assert np.ptp(opl) < 1e-9
        assert row.kind == "direct"  # a mirror of the design is no ghost
        assert row.rms_radius_mm < 1e-4

    def test_history_is_spread_over_the_beam(self, triplet) -> None:
        """A handful of rays shows the path as a whole, not one corner of the beam."""
        starts = np.array([points[0] for points in triplet.history(0, 16).rays])
        everything = np.array([points[0] for points in triplet.history(0, 4000).rays])
        assert np.all(starts[:, :2].std(axis=0) > 0.5 * everything[:, :2].std(axis=0))

    def test_history_gives_what_there_is(self, triplet) -> None:
        rare = triplet.paths[-1]
        assert len(triplet.history(rare.path_id, 100_000)) == rare.rays
        with pytest.raises(mistray.MistrayError, match="n is 0"):
            triplet.history(0, 0)
        with pytest.raises(mistray.MistrayError, match="path_id -1 does not exist"):
            triplet.history(-1)

    def test_straight_shot(self, load_text) -> None:
        scene, _ = load_text(
            scene_text(
                shape_xml("asphere", "wall", 0.0, semi_diameter=3.0, inner_semi_diameter=0.5),
                shape_xml("asphere", "detector", 5.0, sensor=True, half_width=1.0, half_height=1.0),
            )
        )
        t = mistray.trace(scene, rays=1000)
        assert [(row.kind, row.path, row.order) for row in t.paths] == [("straight shot", "A", 0)]
        assert set(t.rays(n=3).type) == {"Emitted"}


class TestFluxReport:
    def test_plate(self) -> None:
        t = mistray.trace(mistray.load("plate"), rays=1000)
        rows = {row.id: row for row in t.surfaces}
        assert [row.id for row in t.surfaces] == [shape.id() for shape in mistray.load("plate").shapes()]
        r, launched = 0.04, t.energy.launched_W
        # front: from outside, and the first reflection from inside; two reflections are the limit
        assert rows["plate_front"].hits == 2000
        assert rows["plate_front"].incident_W == pytest.approx(launched * (1 + (1 - r) * r), rel=1e-6)
        assert rows["plate_rear"].incident_W == pytest.approx(launched * (1 - r) * (1 + r * r), rel=1e-6)
        assert rows["plate_edge"].hits == 0
        assert rows["detector"].absorbed_W == t.energy.detected_W
        assert rows["plate_front"].part == "plate"
        assert rows["plate_front"].absorbed_W == 0
        assert list(t.surfaces.to_pandas().columns) == [
            "id", "part", "space", "hits", "incident_W", "incident_se_W", "absorbed_W", "absorbed_se_W",
        ]  # fmt: skip
        assert len(t.surfaces) == 4
        assert t.surfaces[0].id == t.surfaces.to_pandas().id[0]

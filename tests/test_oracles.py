"""The oracles' geometry, scene reader and statistics against analytic cases."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from oracles import scene_xml, statistics
from oracles.geometry import Asphere, Frustum, Plane
from oracles.small_scenes import STEEP_REAR

HERE = Path(__file__).parent


def test_no_oracle_imports_the_program_under_test() -> None:
    files = [*sorted((HERE / "oracles").glob("*.py"))]
    assert len(files) >= 9
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            bad = {n.split(".")[0] for n in names} & {"mistray", "mitsuba", "drjit", "plugins"}
            assert not bad, f"{path.name} imports {bad}"


class TestGeometry:
    @pytest.mark.parametrize(
        "surface",
        [
            STEEP_REAR,
            Asphere(STEEP_REAR.curvature, STEEP_REAR.conic, STEEP_REAR.coefficients, 1.06, inner=0.5),
            Asphere(0.0, 0.0, ((2, 0.3), (3, -0.4), (4, 0.15)), 1.5),
            Asphere(-0.3, -1.0, ((2, -0.02),), half_width=1.2, half_height=0.7),
        ],
        ids=["steep", "ring", "wavy", "rectangle"],
    )
    def test_asphere_hit_is_the_first_crossing(self, surface: Asphere) -> None:
        """A fine scan along each ray finds the same crossing; also for rays that start on the surface."""
        rays = 400
        rng = np.random.default_rng(3)
        direction = rng.normal(size=(rays, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        leaving = np.arange(rays) % 2 == 0
        x, y = rng.uniform(-1.5, 1.5, (2, 20 * rays))
        on = np.flatnonzero(self.within(surface, x, y))[:rays]
        x, y = x[on], y[on]
        on_surface = np.stack([x, y, surface.sag(x * x + y * y)], axis=1)
        origin = np.where(leaving[:, None], on_surface, 1.5 * rng.normal(size=(rays, 3)))
        found = surface.first_hit(origin, direction, leaving)
        hit = np.isfinite(found)
        assert 0.05 < hit.mean() < 0.9
        point = origin[hit] + found[hit, None] * direction[hit]
        assert np.abs(point[:, 2] - surface.sag(point[:, 0] ** 2 + point[:, 1] ** 2)).max() < 1e-14
        step = 5e-4
        t = np.arange(20, 20000) * step
        for i in range(rays):
            p = origin[i] + t[:, None] * direction[i]
            u = p[:, 0] ** 2 + p[:, 1] ** 2
            inside = self.within(surface, p[:, 0], p[:, 1])
            f = np.where(inside, p[:, 2] - surface.sag(np.minimum(u, surface.reach**2)), np.nan)
            crossing = np.flatnonzero((f[1:] <= 0) != (f[:-1] <= 0))
            crossing = crossing[np.isfinite(f[crossing]) & np.isfinite(f[crossing + 1])]
            if found[i] < t[0]:
                continue  # closer than the scan starts
            scanned = t[crossing[0]] if len(crossing) else np.inf
            close = np.isfinite(found[i]) and scanned <= found[i] <= scanned + step
            grazing = np.isfinite(found[i]) and found[i] < scanned and abs(f[np.searchsorted(t, found[i])]) < 1e-6
            assert close or grazing or (np.isinf(scanned) and np.isinf(found[i])), (
                f"ray {i}: {found[i]} against {scanned}"
            )

    @staticmethod
    def within(surface: Asphere, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u = x * x + y * y
        sides = (np.abs(x) <= surface.half_width) & (np.abs(y) <= surface.half_height)
        return sides & (u <= surface.outer**2) & (u >= surface.inner**2)

    def test_normals_are_gradients(self) -> None:
        x, y, h = np.array([0.3, -0.9, 0.0]), np.array([0.2, 0.4, 0.0]), 1e-6

        def sag(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return STEEP_REAR.sag(x * x + y * y)

        slopes = (sag(x + h, y) - sag(x - h, y)) / (2 * h), (sag(x, y + h) - sag(x, y - h)) / (2 * h)
        expected = np.stack([-slopes[0], -slopes[1], np.ones(3)], axis=1)
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        np.testing.assert_allclose(STEEP_REAR.normal(np.stack([x, y, sag(x, y)], axis=1)), expected, atol=1e-9)
        rim_slope = 2 * STEEP_REAR.outer * STEEP_REAR.slope_u(np.array(STEEP_REAR.outer**2))
        assert rim_slope == pytest.approx(2.07, abs=0.005)

    @pytest.mark.parametrize(
        ("frustum", "origin", "leaving", "length"),
        [
            (Frustum(3, -9, 3, 9), (0, 0, 0), False, 5.0),
            (Frustum(1, 4, 5, 4), (0, 0, 0), False, 5.0),
            (Frustum(3.01, 4, 5, 4), (0, 0, 0), False, np.inf),
            # cone r = z: 0.6 t = 0.8 t + 1 from (0, 0, 1) has no solution ahead, from (0, 0, -1) t = 5
            (Frustum(0, 0, 9, 9), (0, 0, -1), False, 5.0),
            (Frustum(0, 0, 9, 9), (0, 0, 1), False, np.inf),
            # a chord inside a cylinder meets it again, outside it does not
            (Frustum(3, -9, 3, 9), (-3, 0, 0), True, 10.0),
            (Frustum(3, -9, 3, 9), (3, 0, 0), True, np.inf),
        ],
    )
    def test_frustum_special_cases(self, frustum: Frustum, origin: tuple, leaving: bool, length: float) -> None:
        found = frustum.first_hit(np.array([origin], dtype=float), np.array([[0.6, 0.0, 0.8]]), np.array([leaving]))
        assert found[0] == pytest.approx(length, abs=1e-14)

    def test_frustum_normals_point_away_from_the_axis(self) -> None:
        s = np.sqrt(0.5)
        for frustum, point, normal in (
            (Frustum(2, 0, 2, 1), [2, 0, 0.5], [1, 0, 0]),
            (Frustum(1, 0, 2, 1), [0, 1.5, 0.5], [0, s, -s]),
            (Frustum(2, 1, 1, 0), [0, 1.5, 0.5], [0, s, -s]),
            (Frustum(2, 0, 1, 1), [0, 1.5, 0.5], [0, s, s]),
            (Frustum(2, 1, 1, 1), [0, 1.5, 1], [0, 0, 1]),
        ):
            np.testing.assert_allclose(frustum.normal(np.array([point], dtype=float))[0], normal, atol=1e-15)


class TestSceneXml:
    def test_transforms_act_in_xml_order(self) -> None:
        text = """<scene version="3.0.0"><default name="angle" value="90"/>
        <shape type="rectangle" id="a"><transform name="to_world"><scale x="2" y="3"/><rotate y="1" angle="$angle"/>
        <translate x="5"/></transform></shape>
        <shape type="disk" id="b"><transform name="to_world">
        <lookat origin="1, 2, 3" target="1, 2, 9" up="0, 1, 0"/></transform></shape>
        <shape type="disk" id="c"><transform name="to_world">
        <translate z="1"/><rotate value="1, 0, 0" angle="90"/></transform></shape>
        <shape type="disk" id="d"><transform name="to_world">
        <matrix value="0 -1 0 7  1 0 0 8  0 0 1 9  0 0 0 1"/></transform></shape>
        <shape type="sphere" id="e"><float name="radius" value="2"/>
        <point name="center" x="1" y="0" z="4"/></shape></scene>"""
        a, b, c, d, e = scene_xml.parse_scene(text).shapes
        assert isinstance(a.surface, Plane)
        assert (a.surface.half_width, a.surface.half_height) == pytest.approx((2, 3))
        np.testing.assert_allclose(a.normal(np.array([[5.0, 0, 0]]))[0], [1, 0, 0], atol=1e-15)
        for shape, place in ((a, [5, 0, 0]), (b, [1, 2, 3]), (c, [0, -1, 0])):
            np.testing.assert_allclose(shape.to_world[:3, 3], place, atol=1e-15)
        np.testing.assert_allclose(b.to_world[:3, 0], [1, 0, 0])
        np.testing.assert_allclose(b.to_world[:3, 2], [0, 0, 1])
        np.testing.assert_allclose(d.to_world @ [1, 0, 0, 1], [7, 9, 9, 1])
        hit = e.first_hit(np.array([[1.0, 0, 0]]), np.array([[0.0, 0, 1]]), np.array([False]))
        assert hit[0] == pytest.approx(2.0)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('<shape type="cube" id="x"/>', "shape type 'cube'"),
            ('<shape type="asphere" id="x"><float name="semidiameter" value="1"/></shape>', "semidiameter"),
            ('<shape type="disk" id="x"/><shape type="disk" id="x"/>', "not unique"),
            ('<shape type="disk" id="x"><bsdf type="diffuse"/></shape>', "diffuse"),
            ('<emitter type="point"/>', "point"),
        ],
    )
    def test_nothing_is_half_read(self, text: str, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            scene_xml.parse_scene(f"<scene>{text}</scene>")


class TestStatistics:
    def test_limit_is_sidak(self) -> None:
        assert statistics.z_limit(1, 0.0027) == pytest.approx(3.0, abs=1e-3)
        assert statistics.z_limit(20, 0.05) == pytest.approx(3.0161, abs=1e-3)
        rng = np.random.default_rng(11)
        alarms = (np.abs(rng.normal(size=(4000, 50))).max(axis=1) > statistics.z_limit(50, 0.05)).mean()
        statistics.assert_z("false alarms", alarms, 0.05, np.sqrt(0.05 * 0.95 / 4000))

    def test_what_fails(self) -> None:
        """Beyond the limit, one of several, without an error, beyond the relative limit; a value that is no number."""
        for message, wrong in (
            ("off by 5.00 standard errors", ("plate T", 1.1, 1.0, 0.02)), ("inf", ("count", 5, 4, 0)),
            (r"\[1\].*1 of 3", ("T", [1, 2, 3], [1, 1, 3], 0.1)),
        ):  # fmt: skip
            with pytest.raises(AssertionError, match=message):
                statistics.assert_z(*wrong)
        with pytest.raises(AssertionError, match="relative"):
            statistics.assert_within("plate T", 1.01, 1.0, 0.01)
        statistics.assert_z("count", 5, 5, 0)
        with pytest.raises(ValueError, match="finite"):
            statistics.assert_z("power", np.nan, 1.0, 0.1)

"""The oracles' geometry, scene reader, materials, coatings and statistics against analytic cases."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles import glass, scene_xml, statistics
from oracles.geometry import Asphere, Frustum, Plane, Sphere
from oracles.interface import CoatingTable, Interface, fresnel_unpolarised, interact
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
    def random_rays(self, rays: int, size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        direction = rng.normal(size=(rays, 3))
        return rng.normal(size=(rays, 3)) * size, direction / np.linalg.norm(direction, axis=1, keepdims=True)

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
        origin, direction = self.random_rays(rays, 1.5, 3)
        leaving = np.arange(rays) % 2 == 0
        rng = np.random.default_rng(4)
        if np.isfinite(surface.outer):
            r = np.sqrt(rng.uniform(surface.inner**2, surface.outer**2, rays))
            phi = rng.uniform(0, 2 * np.pi, rays)
            x, y = r * np.cos(phi), r * np.sin(phi)
        else:
            x, y = rng.uniform(-1.2, 1.2, rays), rng.uniform(-0.7, 0.7, rays)
        on = np.stack([x, y, surface.sag(x * x + y * y)], axis=1)
        origin = np.where(leaving[:, None], on, origin)
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
            inside = (u <= surface.outer**2) & (u >= surface.inner**2)
            inside &= (np.abs(p[:, 0]) <= surface.half_width) & (np.abs(p[:, 1]) <= surface.half_height)
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

    def test_asphere_without_coefficients_is_a_sphere(self) -> None:
        origin, direction = self.random_rays(4000, 1.0, 5)
        origin[:, 2] += 2.0
        cap = Asphere(1 / 2.0, outer=1.9999)
        lifted = origin - [0.0, 0.0, 2.0]
        no = np.zeros(len(origin), dtype=bool)
        whole = Sphere(2.0).first_hit(lifted, direction, no)
        found = cap.first_hit(origin, direction, no)
        lower = np.isfinite(whole) & ((lifted + whole[:, None] * direction)[:, 2] < -0.05)
        assert lower.sum() > 500
        np.testing.assert_allclose(found[lower], whole[lower], rtol=0, atol=1e-13)

    def test_normals_are_gradients(self) -> None:
        h = 1e-6
        for x, y in ((0.3, 0.2), (-0.9, 0.4), (0.0, 0.0)):
            gradient = [
                (
                    STEEP_REAR.sag(np.array((x + a) ** 2 + (y + b) ** 2))
                    - STEEP_REAR.sag(np.array((x - a) ** 2 + (y - b) ** 2))
                )
                / (2 * h)
                for a, b in ((h, 0), (0, h))
            ]
            expected = np.array([-gradient[0], -gradient[1], 1.0])
            point = np.array([[x, y, STEEP_REAR.sag(np.array(x * x + y * y))]])
            np.testing.assert_allclose(STEEP_REAR.normal(point)[0], expected / np.linalg.norm(expected), atol=1e-9)

    def test_steep_rim_slope(self) -> None:
        assert 2 * STEEP_REAR.outer * STEEP_REAR.slope_u(np.array(STEEP_REAR.outer**2)) == pytest.approx(
            2.07, abs=0.005
        )

    def test_frustum_special_cases(self) -> None:
        o, d = np.array([[0.0, 0.0, 0.0]]), np.array([[0.6, 0.0, 0.8]])
        no, yes = np.array([False]), np.array([True])
        assert Frustum(3, -9, 3, 9).first_hit(o, d, no)[0] == pytest.approx(5.0, abs=1e-15)
        assert Frustum(1, 4, 5, 4).first_hit(o, d, no)[0] == pytest.approx(5.0, abs=1e-15)
        assert np.isinf(Frustum(3.01, 4, 5, 4).first_hit(o, d, no)[0])
        # cone r = z: 0.6 t = 0.8 t + 1 from (0, 0, 1) has no solution ahead, from (0, 0, -1) t = 5
        assert Frustum(0, 0, 9, 9).first_hit(np.array([[0, 0, -1.0]]), d, no)[0] == pytest.approx(5.0, abs=1e-14)
        assert np.isinf(Frustum(0, 0, 9, 9).first_hit(np.array([[0, 0, 1.0]]), d, no)[0])
        # a chord inside a cylinder meets it again, outside it does not
        on = np.array([[-3.0, 0.0, 0.0]])
        assert Frustum(3, -9, 3, 9).first_hit(on, d, yes)[0] == pytest.approx(10.0, abs=1e-14)
        assert np.isinf(Frustum(3, -9, 3, 9).first_hit(-on, d, yes)[0])

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

    def test_cone_frustum_near_flat_agrees_with_the_annulus(self) -> None:
        origin, direction = self.random_rays(2000, 1.0, 8)
        no = np.zeros(len(origin), dtype=bool)
        flat = Frustum(1, 0, 3, 0).first_hit(origin, direction, no)
        cone = Frustum(1, 0, 3, 1e-9).first_hit(origin, direction, no)
        both = np.isfinite(flat) & np.isfinite(cone) & (np.abs(direction[:, 2]) > 1e-2)
        assert both.sum() > 200
        np.testing.assert_allclose(flat[both], cone[both], atol=1e-6)

    def test_asphere_beyond_its_conic_is_refused(self) -> None:
        with pytest.raises(ValueError, match="ends before"):
            Asphere(STEEP_REAR.curvature, STEEP_REAR.conic, (), 1.2)


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
        model = scene_xml.parse_scene(text)
        a, b, c, d, e = model.shapes
        assert isinstance(a.surface, Plane)
        assert (a.surface.half_width, a.surface.half_height) == pytest.approx((2, 3))
        np.testing.assert_allclose(a.normal(np.array([[5.0, 0, 0]]))[0], [1, 0, 0], atol=1e-15)
        np.testing.assert_allclose(a.to_world[:3, 3], [5, 0, 0])
        np.testing.assert_allclose(b.to_world[:3, 3], [1, 2, 3])
        np.testing.assert_allclose(b.normal(np.array([[1.0, 2, 3]]))[0], [0, 0, 1])
        np.testing.assert_allclose(b.to_world[:3, 0], [1, 0, 0])
        np.testing.assert_allclose(c.to_world[:3, 3], [0, -1, 0], atol=1e-15)
        np.testing.assert_allclose(d.to_world @ [1, 0, 0, 1], [7, 9, 9, 1])
        hit = e.first_hit(np.array([[1.0, 0, 0]]), np.array([[0.0, 0, 1]]), np.array([False]))
        assert hit[0] == pytest.approx(2.0)

    def test_interfaces_nested_and_referred(self) -> None:
        text = """<scene version="3.0.0"><bsdf type="interface" id="coat"><string name="back" value="nd=1.544 Vd=56.1"/>
        <float name="R" value="0.02"/><float name="T" value="0.98"/></bsdf>
        <shape type="asphere" id="L1_front"><float name="semi_diameter" value="2"/><string name="part" value="L1"/>
        <integer name="space" value="3"/><ref id="coat"/></shape>
        <shape type="asphere" id="wall"><float name="semi_diameter" value="2"/><bsdf type="interface">
        <float name="R" value="0.07"/><boolean name="mirror" value="true"/></bsdf></shape></scene>"""
        lens, wall = scene_xml.parse_scene(text).shapes
        assert lens.interface == Interface("air", "nd=1.544 Vd=56.1", 0.02, 0.98)
        assert (lens.part, lens.space, lens.interface.opaque) == ("L1", 3, False)
        assert wall.interface.opaque
        assert wall.interface.mirror
        assert wall.part == "wall"

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('<shape type="cube" id="x"/>', "shape type 'cube'"),
            ('<shape type="asphere" id="x"><float name="semidiameter" value="1"/></shape>', "semidiameter"),
            ('<shape type="disk" id="x"/><shape type="disk" id="x"/>', "not unique"),
            (
                '<shape type="asphere" id="x"><float name="semi_diameter" value="1"/><bsdf type="diffuse"/></shape>',
                "diffuse",
            ),
            ('<emitter type="point"/>', "point"),
        ],
    )
    def test_nothing_is_half_read(self, text: str, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            scene_xml.parse_scene(f"<scene>{text}</scene>")


class TestPhysics:
    def test_catalogue_d_indices(self) -> None:
        printed = {"N-BK7": 1.5168, "N-SK16": 1.62041, "F2": 1.62004, "N-F2": 1.62005, "SF5": 1.6727, "N-SF5": 1.67271}
        printed |= {"N-SF11": 1.78472, "N-LAK9": 1.691, "SF6": 1.80518, "N-SF6": 1.80518, "fused silica": 1.45846}
        printed |= {"sapphire": 1.76817}
        assert set(printed) == set(glass.SELLMEIER)
        for name, nd in printed.items():
            assert glass.refractive_index(name, glass.LINE_D_NM) == pytest.approx(nd, abs=1.5e-5), name

    def test_abbe_number_comes_back(self) -> None:
        n = {
            line: glass.refractive_index("nd=1.544 Vd=56.1", line)
            for line in (glass.LINE_D_NM, glass.LINE_F_NM, glass.LINE_C_NM)
        }
        assert n[glass.LINE_D_NM] == pytest.approx(1.544, abs=1e-15)
        abbe = (n[glass.LINE_D_NM] - 1) / (n[glass.LINE_F_NM] - n[glass.LINE_C_NM])
        assert abbe == pytest.approx(56.1, abs=1e-9)

    def test_fresnel_vectors(self) -> None:
        for row in vectors.rows("fresnel.csv"):
            n1, n2, aoi = float(row["n1"]), float(row["n2"]), np.radians(float(row["aoi"]))
            cos_t = np.sqrt(1 - (n1 / n2 * np.sin(aoi)) ** 2)
            r = fresnel_unpolarised(*(np.array(v) for v in (n1, n2, np.cos(aoi), cos_t)))
            assert r == pytest.approx(float(row["Runpol"]), abs=1e-13)

    def test_total_internal_reflection(self) -> None:
        """Critical angle of n = 1.5: 41.81 degrees; an ideal coating gives R + T there."""
        for angle_deg, tir in ((41.80, False), (41.82, True)):
            d = np.array([[0.0, np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))]])
            out = interact(Interface("1.5", "air", 0.02, 0.97), 1.5, 1.0, 550.0, d, np.array([[0.0, 0.0, 1.0]]))
            assert out.tir[0] == tir
            assert (out.reflectance[0], out.transmittance[0]) == pytest.approx((0.99, 0.0) if tir else (0.02, 0.97))

    def test_coating_table(self, tmp_path: Path) -> None:
        rows = [
            f"{lam},{ang},{lam * 1e-4 + ang * 1e-3},{0.9 - ang * 2e-3},{0.01}"
            for lam in (500, 600)
            for ang in (0, 40, 90)
        ]
        path = tmp_path / "coat.csv"
        path.write_text("# made up\nwavelength_nm,angle_deg,R,T,R_back\n" + "\n".join(rows), encoding="utf-8")
        table = CoatingTable.read(path)
        r, t = table.evaluate(530.0, np.cos(np.radians([30.0, 30.0])), np.array([True, False]))
        np.testing.assert_allclose(r, [0.053 + 0.03, 0.01], atol=1e-12)
        np.testing.assert_allclose(t, 0.84, atol=1e-12)
        with pytest.raises(ValueError, match="650"):
            table.evaluate(650.0, np.array([1.0]), np.array([True]))
        # from glass the table's angle is that in air
        d = np.array([[0.0, np.sin(np.radians(19.4712206345)), np.cos(np.radians(19.4712206345))]])
        out = interact(Interface("air", "1.5", table=table), 1.0, 1.5, 500.0, -d, np.array([[0.0, 0.0, 1.0]]))
        assert out.transmittance[0] == pytest.approx(0.84, abs=1e-9)


class TestStatistics:
    def test_limit_is_sidak(self) -> None:
        assert statistics.z_limit(1, 0.0027) == pytest.approx(3.0, abs=1e-3)
        assert statistics.z_limit(20, 0.05) == pytest.approx(3.0161, abs=1e-3)

    def test_false_alarm_rate_is_the_stated_one(self) -> None:
        rng = np.random.default_rng(11)
        alarms = (np.abs(rng.normal(size=(4000, 50))).max(axis=1) > statistics.z_limit(50, 0.05)).mean()
        statistics.assert_z("false alarms", alarms, 0.05, np.sqrt(0.05 * 0.95 / 4000))

    def test_message_says_by_how_much(self) -> None:
        with pytest.raises(
            AssertionError, match=r"plate T: 1\.1 ± 0\.02, expected 1, off by 5\.00 standard errors \(limit 3\.29"
        ):
            statistics.assert_z("plate T", 1.1, 1.0, 0.02)
        with pytest.raises(AssertionError, match=r"power \[b\].*1 of 3 beyond"):
            statistics.assert_z("power", [1, 2, 3], [1, 1, 3], 0.1, names=["a", "b", "c"])
        with pytest.raises(AssertionError, match="relative"):
            statistics.assert_within("plate T", 1.01, 1.0, 0.01)
        with pytest.raises(ValueError, match="finite"):
            statistics.assert_z("power", np.nan, 1.0, 0.1)

    def test_zero_error_needs_equality(self) -> None:
        statistics.assert_z("count", 5, 5, 0)
        with pytest.raises(AssertionError, match="inf"):
            statistics.assert_z("count", 5, 4, 0)

    def test_mean_and_error(self) -> None:
        mean, error = statistics.mean_and_error([1.0, 2.0, 3.0, 4.0])
        assert (mean, error) == pytest.approx((2.5, np.sqrt(5 / 3) / 2))

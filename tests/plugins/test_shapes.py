"""`asphere` and `frustum` as Mitsuba plugins: three ways to load them, their parameters, their errors, their meshes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.geometry import Asphere, Frustum
from oracles.small_scenes import STEEP_REAR

import mistray
from mistray._mitsuba_compat import mesh_arrays

pytestmark = pytest.mark.quick

BLACK = {"type": "interface", "R": 0.0}
EVEN = {"radius": 20.0, "conic": -0.5, "a4": 1e-4, "a6": -2e-7}
ASPHERE = {"type": "asphere", **EVEN, "semi_diameter": 6.0, "bsdf": BLACK}
FRUSTUM = {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 3.0, "z1": 4.0, "bsdf": BLACK}
LIST = ["curvature", "conic", *(f"a{order}" for order in range(4, 21, 2))]


def xml_of(values: dict[str, Any], more: str = "") -> str:
    items = "".join(f'<float name="{k}" value="{v!r}"/>' for k, v in values.items() if isinstance(v, float))
    bsdf = '<bsdf type="interface"><float name="R" value="0"/></bsdf>'
    return f'<shape version="3.0.0" type="{values["type"]}" id="S1">{items}{more}{bsdf}</shape>'


def why(make: Any) -> str:
    """The text of the error, whatever Mitsuba wraps around it."""
    with pytest.raises((mistray.MistrayError, RuntimeError, TypeError)) as caught:
        make()
    return str(caught.value)


class TestLoading:
    @pytest.mark.parametrize("values", [ASPHERE, FRUSTUM], ids=["asphere", "frustum"])
    def test_string_file_and_dict(self, values: dict[str, Any], tmp_path: Path) -> None:
        (tmp_path / "shape.xml").write_text(xml_of(values), encoding="utf-8")
        shapes = [
            mi.load_string(xml_of(values)),
            mi.load_file(str(tmp_path / "shape.xml")),
            mi.load_dict({**values, "id": "S1"}),
        ]
        boxes = [np.array([shape.bbox().min, shape.bbox().max]) for shape in shapes]
        for shape, box in zip(shapes, boxes, strict=True):
            assert shape.id() == "S1"
            assert str(shape) == str(shapes[0])
            assert type(shape).__name__.lower() == values["type"]
            assert shape.part == "S1"
            assert shape.space == -1
            np.testing.assert_array_equal(box, boxes[0])
        assert shapes[0].values == pytest.approx(shapes[2].values)

    def test_part_and_space(self) -> None:
        more = '<string name="part" value="L1"/><integer name="space" value="3"/>'
        shape = mi.load_string(xml_of(ASPHERE, more))
        assert (shape.part, shape.space) == ("L1", 3)

    def test_defaults(self) -> None:
        plane = mi.load_dict({"type": "asphere", "semi_diameter": 2.0, "bsdf": BLACK})
        assert plane.plane
        assert plane.values["curvature"] == 0
        assert not plane.sag(np.linspace(0, 2, 5)).any()
        for radius in (0.0, np.inf, -np.inf):
            flat = mi.load_dict({"type": "asphere", "radius": radius, "semi_diameter": 2.0, "bsdf": BLACK})
            assert flat.values["curvature"] == 0
        by_curvature = mi.load_dict({"type": "asphere", "curvature": 0.05, "semi_diameter": 2.0, "bsdf": BLACK})
        assert by_curvature.values["curvature"] == 0.05
        whole = mi.load_dict({"type": "asphere", "radius": 20, "semi_diameter": 2, "bsdf": BLACK})
        assert whole.values["curvature"] == 0.05  # integers are numbers too

    def test_to_string(self) -> None:
        text = str(mi.load_string(xml_of(ASPHERE)))
        for part in ("Asphere[id = S1", "curvature = 0.05", "conic = -0.5", "a4 = 0.0001", "semi_diameter = 6"):
            assert part in text
        assert str(mi.load_string(xml_of(FRUSTUM))) == "Frustum[id = S1, r0 = 5, z0 = -1, r1 = 3, z1 = 4]"


class TestErrors:
    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ({"type": "asphere"}, "shape 'S': give either semi_diameter or both half_width and half_height"),
            ({"type": "asphere", "half_width": 1.0}, "shape 'S': a rectangular clip needs half_width and half_height"),
            (
                {"type": "asphere", "semi_diameter": 1.0, "half_width": 1.0, "half_height": 1.0},
                "shape 'S': give either semi_diameter or both",
            ),
            ({"type": "asphere", "semi_diameter": -2.0}, "shape 'S': semi_diameter is -2; it must lie between 1e-15"),
            ({"type": "asphere", "half_width": 0.0, "half_height": 1.0}, "shape 'S': half_width is 0; it must"),
            (
                {"type": "asphere", "semi_diameter": 2.0, "inner_semi_diameter": 2.0},
                "shape 'S': inner_semi_diameter is 2 mm; it must lie between 0 and semi_diameter = 2 mm",
            ),
            ({"type": "asphere", "semi_diameter": 2.0, "inner_semi_diameter": -1.0}, "inner_semi_diameter is -1;"),
            ({"type": "asphere", "semi_diameter": 2.0, "radius": 5.0, "curvature": 0.2}, "give radius or curvature"),
            (
                {"type": "asphere", "semi_diameter": 6.0, "radius": 5.0},
                "shape 'S': the conic ends at r = 5 mm, inside the aperture of 6 mm; reduce the aperture",
            ),
            ({"type": "asphere", "semi_diameter": 2.0, "radius": "5 mm"}, "radius is '5 mm'; it must be a number"),
            ({"type": "asphere", "semi_diameter": 2.0, "conic": True}, "conic is True; it must be a number"),
            ({"type": "asphere", "semi_diameter": 2.0, "radius": float("nan")}, "radius is nan; it must be a number"),
            ({"type": "asphere", "semi_diameter": float("inf")}, "semi_diameter is inf; it must lie"),
            ({"type": "asphere", "semi_diameter": 2.0, "a4": float("inf")}, "a4 is inf; it must lie"),
            ({"type": "frustum", "r0": 1.0, "r1": 1.0}, "shape 'S': a frustum needs z0, z1 (mm)"),
            ({**FRUSTUM, "r0": -1.0}, "shape 'S': r0 is -1; it must lie between 0 and 1e12 mm"),
            ({**FRUSTUM, "r0": 3.0, "z0": 4.0}, "shape 'S': r0 = r1 and z0 = z1; a frustum of no area"),
            ({**FRUSTUM, "r0": 0.0, "r1": 0.0}, "shape 'S': r0 = r1 = 0; a frustum of no area"),
            ({**FRUSTUM, "z1": float("inf")}, "z1 is inf; it must lie"),
        ],
    )
    def test_message(self, values: dict[str, Any], message: str) -> None:
        assert message in why(lambda: mi.load_dict({**values, "id": "S"}))

    @pytest.mark.parametrize("values", [ASPHERE, FRUSTUM], ids=["asphere", "frustum"])
    def test_unknown_parameter(self, values: dict[str, Any]) -> None:
        assert "curvatur" in why(lambda: mi.load_dict({**values, "curvatur": 1.0}))
        assert "curvatur" in why(lambda: mi.load_string(xml_of({**values, "curvatur": 1.0})))

    @pytest.mark.parametrize("step", ['<scale value="2"/>', '<scale x="-1"/>', '<matrix value="1 .5 0 0 1 0 0 0 1"/>'])
    @pytest.mark.parametrize("values", [ASPHERE, FRUSTUM], ids=["asphere", "frustum"])
    def test_only_rigid_motions(self, values: dict[str, Any], step: str) -> None:
        pose = f'<transform name="to_world">{step}</transform>'
        message = why(lambda: mi.load_string(xml_of(values, pose)))
        assert "shape 'S1': to_world scales, shears or mirrors; use a rigid motion" in message


class TestParameters:
    def test_lists(self) -> None:
        params = mi.traverse(mi.load_dict(ASPHERE))
        for key in (*LIST, "semi_diameter", "inner_semi_diameter"):
            # The range of coefficients is that of lengths to the power of 19
            assert isinstance(params[key], mi.Float64 if re.fullmatch(r"a\d+", key) else mi.Float)
            assert params.flags(key) & mi.ParamFlags.Discontinuous.value
        assert float(params["curvature"][0]) == np.float32(0.05)
        clipped = mi.traverse(mi.load_dict({"type": "asphere", "half_width": 2.0, "half_height": 1.0, "bsdf": BLACK}))
        assert {"half_width", "half_height"} <= set(clipped.keys())
        assert "semi_diameter" not in clipped
        frustum = mi.traverse(mi.load_dict(FRUSTUM))
        assert {"r0", "z0", "r1", "z1"} <= set(frustum.keys())
        assert {"vertex_positions", "faces"} <= set(frustum.keys())

    def test_update_makes_the_mesh_again(self) -> None:
        shape = mi.load_dict(ASPHERE)
        params = mi.traverse(shape)
        before = mesh_arrays(shape)[0]
        params["curvature"] = mi.Float(-0.03)
        params.update()
        after = mesh_arrays(shape)[0]
        r2 = after[:, 0] ** 2 + after[:, 1] ** 2
        expected = Asphere(-0.03, -0.5, ((2, 1e-4), (3, -2e-7)), 6.0).sag(r2.astype(float))
        np.testing.assert_allclose(after[:, 2], expected, atol=1e-6)
        assert np.abs(after - before).max() > 0.5
        assert shape.bbox().min.z == pytest.approx(float(expected.min()), abs=1e-5)

    def test_update_keeps_the_digits_of_the_others(self) -> None:
        """float32 cannot hold 0.1: what is not changed stays as the scene gave it."""
        shape = mi.load_dict({**ASPHERE, "conic": 0.1, "a4": 1.23456789e-5})
        params = mi.traverse(shape)
        params["curvature"] = mi.Float(0.04)
        params.update()
        assert shape.values["conic"] == 0.1
        assert shape.values["a4"] == 1.23456789e-5
        assert shape.values["curvature"] == np.float32(0.04)

    def test_update_in_a_scene_changes_the_trace(self) -> None:
        """A plane-parallel plate that becomes a lens; the analytic surface follows, not only the mesh."""
        scene = mistray.load("plate")
        before = mistray.trace(scene, rays=2000)
        params = mi.traverse(scene)
        params["plate_rear.curvature"] = mi.Float(-1 / 60)
        params.update()
        after = mistray.trace(scene, rays=2000)
        # f = 60 / 0.5 = 120 mm, the screen is 15 mm behind: 1 - 15/120
        ratio = after.paths[0].rms_radius_mm / before.paths[0].rms_radius_mm
        assert ratio == pytest.approx(1 - 15 / 120, rel=2e-3)
        params["plate_rear.curvature"] = mi.Float(0.0)
        params.update()
        again = mistray.trace(scene, rays=2000)
        assert again.paths[0].rms_radius_mm == pytest.approx(before.paths[0].rms_radius_mm, rel=1e-9)

    def test_frustum_update_changes_the_trace(self) -> None:
        scene = mistray.load(
            {
                "type": "scene",
                "beam": {"type": "collimated", "radius": 2.0},
                "stop": {"type": "frustum", "r0": 1.0, "z0": 0.0, "r1": 5.0, "z1": 0.0, "bsdf": BLACK},
                "detector": {
                    "type": "asphere", "half_width": 3.0, "half_height": 3.0, "bsdf": BLACK,
                    "to_world": mi.ScalarTransform4f().translate([0, 0, 1]),
                    "meter": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
                },
            }
        )  # fmt: skip
        params = mi.traverse(scene)
        for radius in (1.0, 0.5, 1.5):
            params["stop.r0"] = mi.Float(radius)
            params.update()
            t = mistray.trace(scene, rays=50_000)
            error = 4 * t.energy.detected_se_W
            assert t.energy.detected_W == pytest.approx(np.pi * radius**2, abs=error)

    @pytest.mark.parametrize(
        ("key", "value", "message"),
        [
            ("semi_diameter", -1.0, "semi_diameter is -1; it must lie"),
            ("curvature", 0.5, "the conic ends at"),
            ("a8", float("nan"), "a8 is nan; it must lie"),
            ("inner_semi_diameter", 7.0, "inner_semi_diameter is 7 mm"),
        ],
    )
    def test_bad_update_leaves_everything(self, key: str, value: float, message: str) -> None:
        shape = mi.load_dict({**ASPHERE, "conic": 0.0, "id": "S"})
        params = mi.traverse(shape)
        values, mesh, old = dict(shape.values), mesh_arrays(shape)[0], float(params[key][0])
        params[key] = mi.Float(value)
        with pytest.raises(mistray.MistrayError, match=f"shape 'S': {message}"):
            params.update()
        assert shape.values == values
        assert float(mi.traverse(shape)[key][0]) == old
        np.testing.assert_array_equal(mesh_arrays(shape)[0], mesh)
        params["a4"] = mi.Float(2e-4)  # and the next good one is taken
        params.update()
        assert shape.values["a4"] == np.float32(2e-4)
        assert shape.values[key] == values[key]

    def test_update_with_gradients(self) -> None:
        shape = mi.load_dict(ASPHERE)
        params = mi.traverse(shape)
        dr.enable_grad(params["curvature"])
        params["curvature"] = params["curvature"] * 1.01
        params.update()
        assert shape.values["curvature"] == pytest.approx(0.0505, rel=1e-6)


class TestMesh:
    """What stock integrators and viewers see."""

    CASES = {
        "asphere": (ASPHERE, Asphere(0.05, -0.5, ((2, 1e-4), (3, -2e-7)), 6.0)),
        "steep": (
            {
                "type": "asphere", "radius": 3.482, "conic": 8.701, "semi_diameter": STEEP_REAR.outer, "bsdf": BLACK,
                **{f"a{2 * power}": value for power, value in STEEP_REAR.coefficients},
            },
            STEEP_REAR,
        ),
        "clipped": (
            {"type": "asphere", "radius": -12.0, "half_width": 4.0, "half_height": 2.0, "bsdf": BLACK},
            Asphere(-1 / 12, half_width=4.0, half_height=2.0),
        ),
        "ring": (
            {"type": "asphere", "radius": 12.0, "semi_diameter": 5.0, "inner_semi_diameter": 2.0, "bsdf": BLACK},
            Asphere(1 / 12, outer=5.0, inner=2.0),
        ),
        "plane": (
            {"type": "asphere", "semi_diameter": 5.0, "bsdf": BLACK}, Asphere(0.0, outer=5.0)
        ),
        "cone": (FRUSTUM, Frustum(5.0, -1.0, 3.0, 4.0)),
        "cylinder": ({**FRUSTUM, "r1": 5.0}, Frustum(5.0, -1.0, 5.0, 4.0)),
        "tip": ({**FRUSTUM, "r1": 0.0}, Frustum(5.0, -1.0, 0.0, 4.0)),
        "backward cone": ({**FRUSTUM, "z0": 4.0, "z1": -1.0}, Frustum(5.0, 4.0, 3.0, -1.0)),
        "washer": ({**FRUSTUM, "z1": -1.0}, Frustum(5.0, -1.0, 3.0, -1.0)),
        "washer outwards": ({**FRUSTUM, "r0": 3.0, "r1": 5.0, "z1": -1.0}, Frustum(3.0, -1.0, 5.0, -1.0)),
    }  # fmt: skip

    @pytest.mark.parametrize("posed", [False, True])
    @pytest.mark.parametrize("name", CASES)
    def test_hits_and_normals(self, name: str, posed: bool) -> None:
        """The mesh lies on the surface within its facets, and its normals point where the formula's do."""
        values, exact = self.CASES[name]
        to_world = mi.ScalarTransform4f()
        if posed:
            to_world = to_world.translate([1, 2, 3]).rotate([1, 0, 0], 30)
        matrix = np.array(to_world.matrix, dtype=float)
        scene = mi.load_dict({"type": "scene", "s": {**values, "to_world": to_world}}, optimize=False)
        rng = np.random.default_rng(3)
        n = 4000
        reach = exact.extent()
        target = rng.uniform(-1, 1, (n, 3)) * reach
        direction = rng.normal(size=(n, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        origin = target - 3 * reach * direction
        world = origin @ matrix[:3, :3].T + matrix[:3, 3], direction @ matrix[:3, :3].T
        rays = mi.Ray3f(mi.Point3f(world[0].T), mi.Vector3f(world[1].T))
        si = scene.ray_intersect(rays)
        t, valid = np.array(si.t, dtype=float), np.array(si.is_valid())
        theirs = exact.first_hit(origin, direction, np.zeros(n, dtype=bool))
        hit = np.isfinite(theirs)
        assert hit.sum() > 300
        assert np.mean(hit != valid) < 0.03  # facets do not reach the rims
        both = hit & valid
        point = origin + theirs[:, None] * direction
        local = exact.normal(point[both])
        grazing = np.abs(np.einsum("ij,ij->i", local, direction[both]))
        close = np.abs(t[both] - theirs[both]) * grazing < 6e-3 * reach
        assert close.mean() > 0.97
        normal = np.array(si.n, dtype=float).T[both][close]
        cosine = np.einsum("ij,ij->i", normal, (local @ matrix[:3, :3].T)[close])
        assert np.quantile(cosine, 0.02) > 0.9

    def test_vertices_are_on_the_surface(self) -> None:
        for values, exact in self.CASES.values():
            vertices = mesh_arrays(mi.load_dict(values))[0].astype(float)
            if isinstance(exact, Asphere):
                z = exact.sag(vertices[:, 0] ** 2 + vertices[:, 1] ** 2)
                np.testing.assert_allclose(vertices[:, 2], z, atol=3e-6)
            else:
                r = np.hypot(vertices[:, 0], vertices[:, 1])
                along = (exact.r1 - exact.r0) * (vertices[:, 2] - exact.z0) - (exact.z1 - exact.z0) * (r - exact.r0)
                np.testing.assert_allclose(along, 0.0, atol=1e-5)

    def test_mesh_is_made_of_triangles_with_area(self) -> None:
        for values, _ in self.CASES.values():
            vertices, faces = mesh_arrays(mi.load_dict(values))
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
            assert area.min() > 0
            assert faces.max() < len(vertices)

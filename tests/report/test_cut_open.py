"""Surfaces cut open: points lie on the formulas, cuts in the plane, areas are right."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from report.view_scene import EXACT, FORMULAS, glass, mm, tilted

from mistray.errors import MistrayError
from mistray.report.figures.cut_open import CutPlane, clip, open_surfaces, triangulate, turned

ZERO = 1e-12


def area(vertices, faces):
    a, b, c = np.asarray(vertices, dtype=float)[np.asarray(faces)].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


@pytest.mark.parametrize("cut", [None, CutPlane(), CutPlane(90.0), CutPlane(37.0, 0.4)], ids=str)
def test_points_lie_on_the_surfaces_and_on_the_kept_side(scene, cut):
    surfaces = {surface.name: surface for surface in open_surfaces(scene, cut)}
    assert set(surfaces) == set(FORMULAS)
    for name, surface in surfaces.items():
        assert len(surface.faces) > 0
        assert FORMULAS[name](surface.vertices).max() < EXACT, name
        assert all(FORMULAS[name](line).max() < EXACT for line in surface.lines), name
        if cut is not None:
            # a curved rectangle is lifted along its own axis, which lies in these planes
            assert cut.height(surface.vertices).max() < EXACT, name
            on_plane = [line for line in surface.lines if np.abs(cut.height(line)).max() < EXACT]
            assert on_plane, name


def test_halves_have_the_area_of_the_whole(scene):
    """A plane that a surface does not reach leaves all of it, or nothing."""

    def areas(cut):
        return {surface.name: area(surface.vertices, surface.faces) for surface in open_surfaces(scene, cut)}

    whole, near, far = areas(None), areas(CutPlane(0.0)), areas(CutPlane(180.0))
    for name in ("L1_front", "stop_wall", "window_front", "window_rear"):
        assert near[name] + far[name] == pytest.approx(whole[name], rel=2e-3)
    for name, exact in (("stop_wall", np.pi * 5.0 * np.hypot(1.0, 4.0)), ("window_front", 24.0)):
        assert whole[name] == pytest.approx(exact, rel=2e-3)
        assert areas(CutPlane(180.0, 50.0))[name] == pytest.approx(exact, rel=5e-3)
    assert all(len(surface.faces) == 0 for surface in open_surfaces(scene, CutPlane(180.0, -50.0)))
    # Surfaces have roles, parts and materials
    surfaces = {surface.name: surface for surface in open_surfaces(scene, CutPlane())}
    roles = {**dict.fromkeys(surfaces, "glass"), "stop_wall": "structure", "detector": "detector"}
    assert {name: surface.role for name, surface in surfaces.items()} == roles
    assert surfaces["L1_front"].part == "L1"
    assert (surfaces["L1_front"].materials, surfaces["stop_wall"].materials) == ("air | 1.6", "")


def test_cut_cylinder_in_closed_form():
    """A tube of radius 2 cut at x = 1: the arc that is left spans 240 degrees."""
    vertices, faces, lines = turned([[2.0, 0.0], [2.0, 5.0]], np.eye(4), 400, CutPlane(0.0, 1.0))
    assert area(vertices, faces) == pytest.approx(5.0 * 2.0 * np.radians(240.0), rel=1e-4)
    ends = [line for line in lines if np.ptp(line[:, 2]) > 1.0]
    np.testing.assert_allclose(
        sorted(end[0, :2].tolist() for end in ends), [[1.0, -np.sqrt(3)], [1.0, np.sqrt(3)]], atol=1e-12
    )
    # A disc whose plane is not that of any ring of the cut: half of it is left whatever its tilt
    matrix = tilted(25.0)
    r = np.linspace(0.0, 3.0, 33)
    vertices, faces, _ = turned(np.column_stack([r, 0.0 * r]), matrix, 200, CutPlane(180.0))
    assert area(vertices, faces) == pytest.approx(np.pi * 9.0 / 2, rel=1e-3)
    assert np.abs(vertices @ matrix[:3, 2]).max() < ZERO * 10


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (0, 2) for z in (5, 6)], dtype=float)
BOX = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
       [1, 5, 7], [1, 7, 3]]  # fmt: skip


@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.25])
def test_clipped_box(offset):
    """2 × 2 × 1 mm: what is left of it lies at x ≤ offset; its walls keep their winding."""
    vertices, faces, lines = clip(CORNERS, BOX, CutPlane(0.0, offset))
    depth = 1.0 + offset
    assert area(vertices, faces) == pytest.approx(2.0 * 1.0 + depth * 2 * (2.0 + 1.0), rel=1e-12)
    assert sum(np.linalg.norm(line[1] - line[0]) for line in lines) == pytest.approx(2 * (2.0 + 1.0))
    normals = np.cross(*(np.diff(vertices[faces], axis=1)).transpose(1, 0, 2))
    outward = vertices[faces].mean(axis=1) - [(offset - 1) / 2, 1.0, 5.5]
    assert (np.einsum("ij,ij->i", normals, outward) > 0).all()
    assert clip(CORNERS.astype(np.float32), BOX, CutPlane(0.0, offset))[0].dtype == np.float32


def test_triangles_of_a_polygon():
    """An L from both sides, corners twice and on edges, a comb, and the segment between two parabolas."""
    y = np.linspace(-1.0, 1.0, 129)
    bent = [[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]
    comb = [[0, 0], [5, 0], [5, 2], [4, 2], [4, 1], [3, 1], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2]]
    meniscus = np.concatenate([np.column_stack([0.5 * y**2, y]), np.column_stack([0.3 + 0.2 * y**2, y])[::-1]])
    for outline, exact, error in (
        (bent, 5.0, 1e-12),
        (bent[::-1], 5.0, 1e-12),
        ([[0, 0], [1, 0], [1, 0], [2, 0], [2, 2], [0, 2], [0, 1]], 4.0, 1e-12),
        (comb, 8.0, 1e-12),
        (meniscus, 0.4, 2e-4),
    ):
        points = np.column_stack([np.array(outline, dtype=float), np.zeros(len(outline))])
        assert area(points, triangulate(outline)) == pytest.approx(exact, rel=error)


STOCK = {
    "rectangle": ('<transform name="to_world"><scale x="2" y="1"/><translate z="5"/></transform>', 8.0),
    "disk": ('<transform name="to_world"><scale value="2"/><translate z="5"/></transform>', np.pi * 4),
    "sphere": ('<float name="radius" value="2"/><point name="center" x="0" y="0" z="5"/>', 4 * np.pi * 4),
    "cylinder": (
        '<float name="radius" value="2"/><point name="p0" x="0" y="0" z="4"/><point name="p1" x="0" y="0" z="7"/>',
        2 * np.pi * 2 * 3,
    ),
    "cube": (mm(z=5.0), 24.0),
}


@pytest.mark.parametrize("kind", STOCK)
def test_shapes_of_mitsuba(kind, load_scene):
    inside, exact = STOCK[kind]
    scene = load_scene(
        f'<scene version="3.0.0"><shape type="{kind}" id="it">{inside}{glass("air", "1.5")}</shape></scene>'
    )
    for cut, share in ((None, 1.0), (CutPlane(), 0.5)):
        (it,) = open_surfaces(scene, cut)
        assert area(it.vertices, it.faces) == pytest.approx(exact * share, rel=5e-3)
        if kind == "sphere":
            np.testing.assert_allclose(np.linalg.norm(it.vertices - [0, 0, 5.0], axis=1), 2.0, atol=EXACT)


def test_a_shape_without_triangles_is_refused():
    values = {"id": "dust", "is_sensor": False, "is_mesh": False, "bsdf": None, "__str__": "SDFGrid[\n]"}
    dust = type("Dust", (), {name: lambda _, value=value: value for name, value in values.items()})()
    with pytest.raises(MistrayError, match="shape 'dust' is SDFGrid, which has no triangles to draw"):
        open_surfaces(SimpleNamespace(shapes=lambda: [dust]), None)

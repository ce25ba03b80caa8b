"""Closed lenses: a straight line from a face meets the next face from the side of the medium that it is in."""

import numpy as np
import pytest

from mistray import Detector, Structure
from mistray.prescription import Decentre, Outline, OutlineFigure, Row, Sequential, circle, rectangle
from mistray.prescription.closing.system import build
from mistray.prescription.geometry import detector_frame
from mistray.prescription.sequential.first_order import field_tangents, first_order
from mistray.prescription.sequential.rays import trace
from mistray.surfaces.host_points import surface_points
from mistray.surfaces.host_rays import first_hit
from mistray.surfaces.surfaces import SurfaceTable

GLASS = {"material": "N-BK7"}
CLIPPED, IMAGE = {"aperture": rectangle(8, 5)}, Row(9, kind="image")
ELLIPSE = Outline((OutlineFigure("ellipse", angle_deg=20, sizes=(8, 6)),))
LENSES = {
    "rectangle": (
        Row(1, radius=50, thickness=6, stop=True, **GLASS, **CLIPPED),
        Row(2, radius=-50, thickness=46, **CLIPPED),
    ),
    "ellipse and cut circle": (
        Row(1, radius=50, thickness=6, stop=True, aperture=ELLIPSE, **GLASS),
        Row(2, radius=-50, thickness=46, semi_diameter=7, semi_diameter_fixed=True, aperture=rectangle(6, 5)),
    ),
    "biconics": (
        Row(1, radius=50, thickness=6, stop=True, semi_diameter=10, **GLASS),
        Row(2, radius=-50, thickness=4, semi_diameter=10),
        Row(3, radius=30, sag={"curvature_x": 0.005}, thickness=6, semi_diameter=9, **GLASS),
        Row(4, radius=-50, sag={"curvature_x": -0.05}, thickness=10, semi_diameter=11),
        Row(5, radius=80, thickness=6, semi_diameter=11, **GLASS),
        Row(6, thickness=20, semi_diameter=11),
    ),
    "break in glass": (
        Row(1, radius=60, thickness=4, stop=True, **GLASS),
        Row(2, kind="coordinate_break", thickness=3, decentre=Decentre()),
        Row(3, radius=-60, thickness=60),
    ),
    "Mangin mirror": (
        Row(1, radius=-60, thickness=4, stop=True, **GLASS),
        Row(2, radius=-90, thickness=-4, mirror=True),
        Row(3, radius=-60, thickness=-40),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LENSES)
def test_light_finds_no_way_beside_a_lens(name):
    built = build(Sequential(name, (*LENSES[name], IMAGE), aperture=14))
    table, rng = SurfaceTable(built.prescription.to_scene(), 587.56), np.random.default_rng(0)
    media = [(shape.bsdf().front, shape.bsdf().back) for shape in table.shapes]
    clear = [k for k, shape in enumerate(table.shapes) if not shape.bsdf().opaque]
    numbers = [row.number for row in LENSES[name] if row.kind == "surface" and not row.mirror]
    wanted = [f"S{number}" for number in numbers if (name, number) != ("Mangin mirror", 3)]
    assert [table.ids[k] for k in clear] == wanted
    wrong = []
    for k in clear:
        p, normal = surface_points(table, k, 500, rng)
        d = rng.normal(size=p.shape)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        away = np.abs(np.sum(d * normal, axis=1)) > 0.05  # not along the face, which it may meet again
        p, d, normal = p[away], d[away], normal[away]
        side = np.sum(d * normal, axis=1) > 0
        hit, _, there = first_hit(table, p, d, np.full(len(p), k))
        for a, number, b in zip(side.astype(int), hit, (np.sum(d * there, axis=1) < 0).astype(int), strict=True):
            met = "air" if number < 0 else media[number][b]
            if met != media[k][a] and "_edge" not in (table.ids[number] if number >= 0 else ""):
                wrong.append((table.ids[k], table.ids[number] if number >= 0 else "none"))
    assert not wrong


def test_the_clear_share_of_a_frame_is_that_of_a_turned_detector():
    detector = Detector(x=3.0, z=20.0, tilt_deg=(10.0, 0.0, 35.0), half_width=8, half_height=3)
    frame = detector_frame(detector, 12.0)
    back, area = np.linalg.inv(detector.to_world()), 0.0
    for piece in frame:
        own = back @ piece.to_world()
        np.testing.assert_allclose(own[:3, :3], np.eye(3), atol=1e-12)
        assert own[2, 3] == pytest.approx(0.0, abs=1e-12)
        assert abs(own[0, 3]) + piece.half_width <= 12 + 1e-9
        assert abs(own[1, 3]) + piece.half_height <= 12 + 1e-9
        assert abs(own[0, 3]) >= 8 + piece.half_width - 1e-9 or abs(own[1, 3]) >= 3 + piece.half_height - 1e-9
        area += 4 * piece.half_width * piece.half_height
    assert area == pytest.approx(24**2 - 16 * 6)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0])
def test_a_board_leaves_the_detector_free(turn_deg):
    image = Row(3, kind="image", aperture=rectangle(8, 3), decentre=Decentre(tilt_deg=(0, 0, turn_deg)))
    rows = Row(1, radius=50, thickness=6, stop=True, **GLASS), Row(2, radius=-50, thickness=46), image
    built = build(Sequential("turned", rows, aperture=16)).prescription
    back = np.linalg.inv(built.detector.to_world())
    for piece in built.structures:
        if piece.part == "board":
            x, y = (back @ piece.to_world())[:2, 3]
            assert abs(x) >= 8 + piece.half_width - 1e-9 or abs(y) >= 3 + piece.half_height - 1e-9


def test_image_heights_of_a_lens_in_water():
    rows = Row(1, radius=20, thickness=4, stop=True, **GLASS), Row(2, radius=-20, thickness=20), IMAGE
    field = {"field_kind": "image_height", "fields": ((0, 0), (0, 0.01))}
    lens = Sequential("in water", rows, aperture=0.1, object_material="1.333", **field)
    data = first_order(lens)
    slope = field_tangents(lens, data)[1, 1]
    lens = lens.with_rows((rows[0], Row(2, radius=-20, thickness=data.bfl), IMAGE))
    hits, _ = trace(lens, [[0.0, 0.0, 0.0]], [[0.0, slope, 1.0]])
    assert hits[-1, 0, 1] == pytest.approx(0.01, rel=1e-4)


@pytest.mark.parametrize("opening", [circle(2.0, x=6.0, y=-3.0), rectangle(2.0, 1.0, x=6.0, y=-3.0)])
def test_a_plate_around_an_opening_beside_the_axis_covers_the_lens(opening):
    rows = Row(1, thickness=5, aperture=opening), Row(2, radius=50, thickness=6, semi_diameter=9, stop=True, **GLASS)
    built = build(Sequential("aside", (*rows, Row(3, radius=-50, thickness=46, semi_diameter=9), IMAGE), aperture=4))
    angle = np.linspace(0, 2 * np.pi, 73)
    plate = [piece for piece in built.prescription.structures if piece.part.startswith("S1_")]
    x, y = 9 * np.cos(angle), 9 * np.sin(angle)
    covered = np.zeros(len(x), dtype=bool)
    for piece in plate:
        if isinstance(piece, Structure):
            covered |= np.hypot(x - piece.x, y - piece.y) <= max(piece.r0, piece.r1)
        else:
            covered |= (np.abs(x - piece.x) <= piece.half_width) & (np.abs(y - piece.y) <= piece.half_height)
    assert covered.all()

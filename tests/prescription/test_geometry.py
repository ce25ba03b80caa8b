"""Walls, edges of lenses, barrels, frames and Fresnel lenses: closed profiles, spots, and what cannot be one."""

import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from refusals import each_refused

from mistray import Coating, Detector, Prescription, Source, Structure, Surface, trace
from mistray.physics.geometry.outline import Outline, OutlineFigure, circle, rectangle
from mistray.prescription import Stop, barrel, detector_frame, fresnel, lens_edge, wall
from mistray.prescription.geometry import whole_face


def profile(pieces):
    return [(piece.name, (piece.r0, piece.z0), (piece.r1, piece.z1)) for piece in pieces]


def plano(name, z, semi_diameter, **sides):
    return Surface(name, z=z, semi_diameter=semi_diameter, **sides)


def body(part="L1", z=0.0, front_radius=5.0, rear_radius=5.0):
    front = plano(f"{part}_front", z, front_radius, back="1.5", part=part)
    return front, plano(f"{part}_rear", z + 2.0, rear_radius, front="1.5", part=part)


def test_wall_leaves_out_empty_pieces_and_numbers_the_rest():
    assert profile(wall("w", [(1, 0), (1, 0), (1, 2)])) == [("w", (1, 0), (1, 2))]
    assert [piece.name for piece in wall("w", [(1, 0), (1, 2), (2, 2)])] == ["w_1", "w_2"]
    assert wall("w", [(1, 0), (1, 0)]) == ()
    (edge,) = lens_edge(*body())
    assert profile([edge]) == [("L1_edge", (5.0, 0.0), (5.0, 2.0))]
    assert (edge.front, edge.back, edge.part, edge.coating) == ("1.5", "air", "L1", Coating(R=0.0))
    coating, bevel = Coating(R=0.07), Coating(R=0.02, T=0.98)
    faces = lens_edge(*body(rear_radius=4.0), 6.0, coating=coating, bevel_coating=bevel, contact_radii=(5.2, 4.0))
    assert profile(faces) == [
        ("L1_bevel_1", (5.0, 0.0), (5.2, 0.0)),
        ("L1_flange_1", (5.2, 0.0), (6.0, 0.0)),
        ("L1_edge", (6.0, 0.0), (6.0, 2.0)),
        ("L1_flange_2", (4.0, 2.0), (6.0, 2.0)),
    ]
    assert [face.coating for face in faces] == [bevel, coating, coating, coating]
    # the normal of a ring points to +z: glass behind the front ring, before the rear ring
    assert [(face.front, face.back) for face in faces] == [("air", "1.5")] * 2 + [("1.5", "air")] * 2


def test_impossible_edges():
    steep = {"radius": 6.0, "semi_diameter": 5.0, "back": "1.5"}
    each_refused(
        (body(), (4.0, None), "contact radius 4 mm"),
        ((body()[0], plano("x", 2.0, 5.0, front="1.6")), "'1.5' for one and '1.6' for the other"),
        ((Surface("f", **steep), plano("r", 2.0, 5.0, front="1.5")), "edge thickness"),
        ((Surface("f", **steep, coefficients=(-0.005,)), plano("r", 0.2, 2.5, front="1.5")), "cut into it"),
        by=lambda faces, contact=(None, None): lens_edge(*faces, contact_radii=contact),
    )


def free_ends(shapes):
    """Ends of the profile in the (r, z) half plane that belong to one face alone; the axis is no end."""
    ends = Counter()
    for shape in shapes:
        points = [(shape.r0, shape.z0), (shape.r1, shape.z1)] if isinstance(shape, Structure) else [shape.rim]
        ends.update(point for point in points if point[0] > 0)
    return {point for point, count in ends.items() if count < 2}


def test_barrels_and_frames():
    stop = Stop(2.0, 4.0, 4.1, 3.0, 3.0)
    detector = Detector(z=20.0, semi_diameter=6.0)
    cemented = (
        Surface("C_front", z=6.0, radius=30.0, semi_diameter=4.0, back="1.5", part="C1"),
        Surface("C_mid", z=8.0, radius=-30.0, semi_diameter=4.5, front="1.5", back="1.7", part="C2"),
        Surface("C_rear", z=9.0, semi_diameter=3.5, front="1.7", part="C2"),
    )
    group = (*body(), stop, *cemented, detector)
    walls = barrel(group, coating=Coating(R=0.05))
    assert [piece.name for piece in walls if piece.part == "barrel"] == [f"barrel_{k}_wall" for k in (1, 2, 3)]
    assert {piece.part for piece in walls} == {"L1", "C1", "C2", "barrel"}
    assert all(piece.coating.opaque for piece in walls)
    faces = [*(item for item in group if isinstance(item, Surface)), *stop.faces(), *walls]
    assert free_ends(faces) == set()
    assert free_ends([face for face in faces if face.name != "barrel_1_wall"]) == {(3.0, 4.0)}
    assert free_ends([face for face in faces if face.name != "barrel_3_wall"]) == {(6.0, 20.0)}
    first = Surface("a", radius=-8.0, semi_diameter=6.0, front="1.5")
    second = plano("b", 0.5, 3.0)
    assert first.rim[1] < -2
    # the straight line from the rim of a to the rim of b would pass inside of a
    steps = [("barrel_1_wall_1", first.rim, (6.0, 0.5)), ("barrel_1_wall_2", (6.0, 0.5), (3.0, 0.5))]
    assert profile(barrel((first, second))) == steps
    each_refused(((first, plano("b", -1.0, 3.0)), "cut into it"), by=barrel)
    # Rims that are not plane: the edge has the height of both, so that no light passes beside it
    toric = (replace(face, sag={"curvature_x": 0.02 * sign}) for face, sign in zip(body(), (1, -1), strict=True))
    (edge,) = barrel(toric)
    assert (edge.z0, edge.z1) == (pytest.approx(0.0, abs=1e-12), 2.0)
    bent = (replace(face, sag={"curvature_x": -0.02 * sign}) for face, sign in zip(body(), (1, -1), strict=True))
    (edge,) = barrel(bent)
    assert (edge.z0, edge.z1) == pytest.approx((-0.2506, 2.2506), abs=1e-4)
    edge, ring, step = barrel((body()[0], replace(body(rear_radius=4.0)[1], sag={"curvature_x": 0.02})))
    assert (edge.z1, ring.z1, step.r0, step.z0, step.z1) == pytest.approx((2.1603, 2.1603, 4.0, 2.0, 2.1603), abs=1e-4)
    gas = barrel((plano("a", 0.0, 5.0, back="1.00027"), plano("b", 3.0, 5.0, front="1.00027")))
    assert [piece.part for piece in gas] == ["barrel"]  # no lens
    assert (gas[0].front, gas[0].back) == ("1.00027", "air")  # a cell that is filled, in air
    # A doublet and a lens that stand in another gas: it is around all their edges and walls
    doublet = (replace(cemented[0], front="1.005"), cemented[1], replace(cemented[2], back="1.005"))
    lens = plano("D_front", 12.0, 3.0, front="1.005", back="1.5"), plano("D_rear", 13.0, 3.0, front="1.5", back="1.005")
    around = [piece.back for piece in barrel((*doublet, *lens)) if piece.r0 == piece.r1 or piece.part == "barrel"]
    assert (set(around), [piece.back for piece in lens_edge(*lens)]) == ({"1.005"}, ["1.005"])
    detector = Detector(z=5.0, half_width=2.0, half_height=1.0)
    frame = detector_frame(detector, 4.0, space=7)
    for x, y in [(2.5, 0.0), (-3.0, 3.5), (0.0, 1.5), (1.9, -1.2), (0.0, -3.9), (3.9, 3.9)]:
        covering = [s for s in (detector, *frame) if abs(x - s.x) <= s.half_width and abs(y - s.y) <= s.half_height]
        assert len(covering) == 1, (x, y)
    assert sum(4 * s.half_width * s.half_height for s in (detector, *frame)) == pytest.approx(8.0**2)
    assert {s.z for s in frame} == {5.0}
    each_refused((detector, 2.1, "reach the corners"), (Detector(semi_diameter=3.0), "round"), by=detector_frame)


INDEX, FOCUS, SIZE, THICK, GROOVE = 1.5, 60.0, 20.0, 3.0, 4.0
CONIC, RADIUS = -(INDEX**2), -FOCUS * (INDEX - 1)  # plane face ahead: a hyperboloid without spherical aberration


def lens() -> Prescription:
    """Collimated light through a plane face, then through rings of the hyperboloid; the rim absorbs."""
    glass, clear = f"{INDEX}", Coating(R=0.0, T=1.0)
    kind = {"radius": RADIUS, "conic": CONIC, "semi_diameter": SIZE, "z": THICK, "groove_mm": GROOVE, "front": glass}
    rings = fresnel("fresnel", coating=clear, riser=Coating(R=0.0), **kind)
    surfaces = [face for face in rings if isinstance(face, Surface)]
    rim = Structure("rim", SIZE, 0.0, SIZE, float(surfaces[-1].z_at(SIZE)), front=glass)
    return Prescription(
        name="Fresnel lens",
        surfaces=(Surface("plane", semi_diameter=SIZE, back=glass, coating=clear), *surfaces),
        structures=(*(face for face in rings if isinstance(face, Structure)), rim),
        detector=Detector(z=THICK + FOCUS, half_width=15.0, half_height=15.0, pixels=(32, 32)),
        source=Source(radius=SIZE, distance=10.0, wavelength_nm=(550.0,)),
    )


def sag_of(r: np.ndarray | float) -> np.ndarray:
    c = 1 / RADIUS
    return np.asarray(c * np.square(r) / (1 + np.sqrt(1 - (1 + CONIC) * c * c * np.square(r))))


def test_spots_of_fresnel_lenses_and_bad_numbers() -> None:
    """Ring k and its focus lie set back: the spot follows from straight lines; 4 SE of 10⁵ rays are 1 %."""
    found = trace(lens().to_scene(), rays=100_000, seed=1)
    rows = {row.events: row for row in found.paths}
    edges = [*np.arange(0, SIZE, GROOVE), SIZE]
    total = 0.0
    for k, (inner, outer) in enumerate(pairwise(edges), start=1):
        row = rows[f"plane:T fresnel_{k}:T detector:A"]
        r = np.sqrt(np.linspace(inner**2, outer**2, 2001))
        back = -float(sag_of(inner))
        start = THICK + back + sag_of(r)
        height = r * (THICK + back + FOCUS - (THICK + FOCUS)) / (THICK + back + FOCUS - start)
        assert row.rms_radius_mm == pytest.approx(math.sqrt(np.mean(height**2)), rel=0.01, abs=1e-4)
        total += row.power_W
    # Behind the rings light turns inward, away from the risers: none is lost
    assert total == pytest.approx(found.energy.launched_W, rel=1e-4)
    assert abs(found.energy.closure) < 1e-6 * found.energy.launched_W
    assert found.energy.escaped_W < 1e-6 * found.energy.launched_W
    faces = fresnel("f", radius=RADIUS, conic=CONIC, semi_diameter=SIZE, depth_mm=0.5, front="1.5")
    risers = [face for face in faces if isinstance(face, Structure)]
    assert len(risers) == math.ceil(abs(float(sag_of(SIZE))) / 0.5) - 1
    for riser in risers:
        assert (riser.z1 - riser.z0, riser.front, riser.back) == (pytest.approx(-0.5, abs=1e-6), "air", "1.5")
    (first, *_, last) = (face for face in faces if isinstance(face, Surface))
    assert (first.inner_semi_diameter, last.semi_diameter) == (0, SIZE)
    assert last.z_at(last.inner_semi_diameter) == pytest.approx(0.0, abs=1e-9)
    each_refused(
        ({}, "no width of its rings; give groove_mm or depth_mm"),
        ({"groove_mm": 1.0, "depth_mm": 1.0}, "groove_mm and depth_mm; give"),
        ({"groove_mm": 0.0}, "groove_mm is 0"),
        ({"groove_mm": 1e-9}, "rings; make them wider"),
        ({"groove_mm": 1.0, "semi_diameter": -1.0}, "semi_diameter is -1"),
        ({"groove_mm": 1.0, "conic": 3.0}, "its conic ends within 20 mm"),
        ({"depth_mm": 1.0, "radius": math.inf}, "0 rings"),
        by=lambda numbers: fresnel("f", **{"radius": RADIUS, "semi_diameter": SIZE, **numbers}),
    )


def test_a_barrel_blackens_faces_around_their_outlines():
    """Their rims lie in circles, from which edges and walls begin."""
    front = Surface("L1_front", radius=50, half_width=4, half_height=3, back="1.5", part="L1")
    rear = Surface("L1_rear", z=4, outline=circle(9.0).within(6.0), front="1.5", part="L1")
    third = Surface("L2_front", z=9, outline=rectangle(6.0, 2.0).within(5.0), back="1.5", part="L2")
    faces = barrel([front, rear, third, plano("L2_rear", 12.0, 5.0, front="1.5", part="L2")])
    rests = {face.name: face for face in faces if isinstance(face, Surface)}
    assert list(rests) == ["L1_front_aperture", "L2_front_aperture"]
    both = Outline((OutlineFigure("rectangle", "&", sizes=(4.0, 3.0)),))
    assert whole_face(replace(front, half_width=None, half_height=None, outline=both))[1] == rests["L1_front_aperture"]
    cut = Outline((*rectangle(6.0, 2.0).figures, OutlineFigure("circle", "&", sizes=(5.5,)))).within(6.5)
    assert whole_face(replace(third, outline=cut))[0].outline == cut  # which no figures around it express
    rest = rests["L1_front_aperture"]
    assert (rest.radius, rest.coating, rest.back) == (50, Coating(R=0.0), "1.5")
    inside = rest.outline.contains(np.array([3.9, 4.1, 0.0, 0.0, 4.1]), np.array([0.0, 0.0, 2.9, 3.1, 3.1]))
    assert inside.tolist() == [False, True, False, True, False]  # the last lies beyond the corners
    z = 50 - math.sqrt(50**2 - 5.005**2)
    assert profile(face for face in faces if not isinstance(face, Surface)) == [
        ("L1_flange_1", (pytest.approx(5.005), pytest.approx(z)), (6.0, pytest.approx(z))),
        ("L1_edge", (6.0, pytest.approx(z)), (6.0, 4.0)),
        ("barrel_1_wall", (6.0, 4.0), (5.0, 9.0)),
        ("L2_edge", (5.0, 9.0), (5.0, 12.0)),
    ]

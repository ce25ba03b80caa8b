"""Prisms, boxes, cubes and plates: closed bodies that do to light what textbooks say, and arrays."""

import math
from dataclasses import replace

import numpy as np
import pytest
import vectors
from refusals import each_refused
from sequential_lenses import by_name, lens, newtonian, triplet

import mistray
from mistray import Coating, Detector, Prescription, Source, Structure, Surface, Trace
from mistray.physics.geometry.outline import Outline, OutlineFigure, circle, polygon, rectangle
from mistray.prescription import Scatter, Unread, array, beam_splitter_cube, box, moved_as_one, plate, prism
from mistray.prescription.closing.system import build, to_prescription
from mistray.prescription.scene_file import beside
from mistray.prescription.sequential.edge_rays import edge_rays
from mistray.prescription.sequential.rays import to_world, trace
from mistray.prescription.sequential.table import Decentre, Row, Sequential
from mistray.recorders import FarField, Probe

pytestmark = pytest.mark.quick

FAR = Detector("far", z=500.0, half_width=1.0, half_height=1.0)
BEAM = Source(radius=1.0, z=-50.0)
CIRCLE, ELLIPSE = OutlineFigure("circle", sizes=(5.0,)), OutlineFigure("ellipse", sizes=(2.0, 1.0))
DOWN = {"edges_deg": (0, 0.01), "axis": (0, -1, 0), "up": (0, 0, 1)}


def traced(*faces, detectors=(FAR,), source=BEAM, recorders=(), **settings):
    """A trace of a body alone."""
    others = tuple(detectors[1:])
    body = {"surfaces": (), "structures": tuple(faces), "detector": detectors[0], "more_detectors": others}
    design = Prescription(name="body", source=source, **body)
    return mistray.trace(design.to_scene(), **{"rays": 2000, "recorders": recorders} | settings)


class TestPrism:
    @pytest.mark.parametrize("way_round", [1, -1])
    def test_least_deviation(self, way_round: int) -> None:
        """An equilateral prism turns light by 2 asin(n sin 30°) - 60° where it goes through it symmetrically."""
        n, side = 1.5, 20.0
        deviation = 2 * math.asin(n * math.sin(math.radians(30))) - math.radians(60)
        h = side * math.sqrt(3) / 2
        corners = [(-h / 3, -side / 2), (2 * h / 3, 0.0), (-h / 3, side / 2)][::way_round]
        body = moved_as_one(prism("p", corners, 20.0, material="1.5"), tilt_deg=(math.degrees(deviation) / 2, 0, 0))
        far = FarField("far", edges_deg=np.degrees(deviation) + np.array([-0.001, 0.001]))
        aside = FarField("aside", edges_deg=(0, 0.01), axis=(0, -math.sin(deviation), math.cos(deviation)))
        t = traced(*body, recorders=[far, aside], max_reflections=0)
        cos_i = math.cos((deviation + math.radians(60)) / 2)
        cos_t = math.sqrt(1 - (1 - cos_i**2) / n**2)
        r = np.mean([((a - b) / (a + b)) ** 2 for a, b in ((cos_i, n * cos_t), (n * cos_i, cos_t))])  # of s and p
        assert far.power[0] == pytest.approx(aside.power[0], rel=1e-9)
        # Unpolarised light at each face: the mean of s and p twice, not the mean of their squares
        assert far.power[0] == pytest.approx(np.pi * (1 - r) ** 2, rel=1e-5)
        assert abs(t.energy.closure) < 1e-6

    @pytest.mark.parametrize("tilt", [0.0, 3.0, -2.0])
    def test_pentaprism(self, tilt: float) -> None:
        """It turns light by 90° however it stands: two mirrors at 45°, and faces at 90°, in its own glass."""
        a = 20.0
        far = a * (1 + math.tan(math.radians(22.5)))
        corners = [(0.0, 0.0), (a, 0.0), (far, a), (a, far), (0.0, a)]
        faces = ("entrance", "mirror_1", "roof", "mirror_2", "exit")
        coated = {"mirrors": ("mirror_1", "mirror_2"), "coatings": dict.fromkeys(faces[1::2], Coating(R=1.0, T=0.0))}
        body = prism("penta", corners, a, material="1.5", faces=faces, **coated)
        body = moved_as_one(moved_as_one(body, y=-a / 2, z=-a / 2), tilt_deg=(tilt, 0, 0))
        down = FarField("down", **DOWN)
        t = traced(*body, recorders=[down], max_reflections=0)
        assert down.power[0] == pytest.approx(np.pi * 0.96**2, rel=2e-3)
        assert abs(t.energy.closure) < 1e-6

    def test_total_reflection_faces_and_bad_input(self) -> None:
        """A right-angle prism turns light by its hypotenuse, with nothing lost but at the two other faces."""
        body = prism("porro", [(-5, -5), (5, -5), (-5, 5)], 10.0, material="1.6", faces=("in", "hypotenuse", "out"))
        down = FarField("down", **DOWN)
        t = traced(*body, recorders=[down], max_reflections=0)
        assert down.power[0] == pytest.approx(np.pi * (1 - (0.6 / 2.6) ** 2) ** 2, rel=1e-5)
        assert t.energy.absorbed["porro_left"][0] == 0
        # Light that got into a concave body finds no gap between its faces on the way through 60 reflections
        corners = [(-10, -10), (10, -10), (10, 10), (3, 2), (-10, 10)]
        sides = Coating(R=0.7, T=0.2)
        body = prism("w", corners, 12.0, material="1.5", coatings={str(k): sides for k in range(1, 6)}, ends=sides)
        beam = Source(radius=4.0, z=-50.0, field_deg=7.0, azimuth_deg=33.0)
        t = traced(*body, source=beam, max_reflections=60, max_events=200, flux_threshold=1e-6, rays=20_000)
        assert t.segments > 30 * 20_000
        assert t.energy.cut["medium"] == 0
        assert abs(t.energy.closure) < 1e-6
        given = {"name": "p", "corners": [(0, 0), (1, 0), (0, 1)], "width": 1.0, "material": "1.5"}
        each_refused(
            ({"corners": [(0, 0), (1, 1), (1, 0), (0, 1)]}, "crosses itself"),
            ({"corners": [(0, 0), (1, 1), (2, 2)]}, "without area"),
            ({"corners": [(0, 0, 1), (1, 1, 1), (2, 2, 3)]}, "give y and z"),
            ({"width": math.nan}, "width"),
            ({"faces": ("a", "a", "b")}, "names of its 3 faces"),
            ({"coatings": {"top": None}}, "no face 'top'"),
            by=lambda change: prism(**(given | change)),
        )


class TestCubeAndBox:
    def test_cube_and_box(self) -> None:
        """R of the diagonal goes to +y and T on, through two bare faces; also turned and displaced with its beam."""
        cube = beam_splitter_cube("cube", 20.0, material="1.5", splitter=Coating(R=0.3, T=0.6))
        up = Detector("up", y=100.0, tilt_deg=(90.0, 0.0, 0.0), half_width=5.0, half_height=5.0)
        t = traced(*cube, detectors=(up, Detector("on", z=100.0, half_width=5.0, half_height=5.0)), max_reflections=1)
        paths = {(row.detector, row.path): row.power_W for row in t.paths}
        assert paths["on", "TTTA"] == pytest.approx(np.pi * 0.6 * 0.96**2, rel=1e-5)
        assert paths["up", "TRTA"] == pytest.approx(np.pi * 0.3 * 0.96**2, rel=1e-5)
        motion = {"x": 3.0, "y": -4.0, "z": 7.0, "tilt_deg": (0.0, 0.0, 37.0)}  # the source looks along z
        beam = Source(x=3.0, y=-4.0, z=-50.0, radius=1.0)
        (up,) = moved_as_one([up], **motion)
        t = traced(*moved_as_one(cube, **motion), detectors=(up,), source=beam, max_reflections=1)
        assert t.energy.detected_W == pytest.approx(np.pi * 0.3 * 0.96**2, rel=1e-5)
        # It takes all light that meets it, wherever it stands
        dark = box("dark", (1.0, 2.0, 3.0), centre=(0.3, -0.2, 10.0))
        beam = Source(half_width=3.0, half_height=3.0, z=-5.0)
        glass = Surface("glass", z=-1.0, semi_diameter=9.0, coating=Coating(R=0.0, T=1.0))
        t = traced(glass, *dark, source=beam, rays=50_000)
        taken, se = t.energy.absorbed["dark_front"]
        assert abs(taken - 2.0) < 4 * se  # 1 in 16,000
        assert t.energy.absorbed["dark_top"][0] == 0
        turned = moved_as_one(box("dark", (1.0, 2.0, 3.0)), tilt_deg=(90.0, 0.0, 0.0))
        absorbed = traced(*turned, source=beam, rays=50_000).energy.absorbed
        assert absorbed["dark_top"][0] == 0  # turned towards +z, and its bottom towards the light
        taken, se = absorbed["dark_bottom"]
        assert abs(taken - 3.0) < 4 * se
        each_refused(("b", (1.0, 0.0, 1.0), "size is 0; it must lie between 1e-15"), by=box)


def behind(outline: Outline, half: float, x: float, y: float, field_deg: float, rays: int = 60_000) -> Trace:
    """Of a square beam that meets a plate of 2 mm about a point of it, the trace."""
    beam = Source(half_width=half, half_height=half, x=x, y=y - 15 * math.tan(math.radians(field_deg)), z=-5.0)
    screen = Detector("behind", z=30.0, half_width=60.0, half_height=60.0)
    settings = {"detectors": (screen,), "source": beam, "rays": rays, "field_deg": field_deg}
    return traced(*plate("plate", outline, 2.0, z=10.0), **settings)


class TestPlate:
    def test_holes(self) -> None:
        """Light passes through its holes alone; aslant their walls shade a part of it."""
        outline = Outline((
            *rectangle(20.0, 15.0).figures,
            OutlineFigure("circle", "-", 8.0, 0.0, sizes=(3.0,)),
            OutlineFigure("rectangle", "-", -8.0, 2.0, 30.0, (4.0, 1.0)),
            OutlineFigure("polygon", "-", 0.0, -8.0, sizes=(-2.0, 0.0, 2.0, 0.0, 0.0, 3.0)),
        ))  # fmt: skip
        assert len(plate("plate", outline, 2.0)) == 2 + 4 + 1 + 4 + 3
        t = behind(outline, 13.0, 0.0, 0.0, 0.0, rays=200_000)
        assert abs(t.energy.detected_W - (np.pi * 9 + 16 + 6)) < 4 * t.energy.detected_se_W  # 1 in 16,000
        assert t.energy.absorbed["plate_rear"][0] == 0
        # At 20° along y the wall takes 2 tan 20° from the width of each hole: of the circle what two discs share
        tilted = behind(outline, 12.0, 0.0, 0.0, 20.0, rays=200_000)
        shift = 2 * math.tan(math.radians(20))
        lens = 18 * math.acos(shift / 6) - shift / 2 * math.sqrt(36 - shift**2)
        angle = math.radians(30)
        slot = (8 - abs(shift * math.sin(angle))) * (2 - abs(shift * math.cos(angle)))
        triangle = 6 * (1 - shift / 3) ** 2
        expected = (lens + slot + triangle) * math.cos(math.radians(20))
        assert abs(tilted.energy.detected_W - expected) < 4 * tilted.energy.detected_se_W

    @pytest.mark.parametrize(("a", "b", "turn_deg"), [(6.0, 4.0, 0.0), (1.5, 9.0, 25.0)])
    @pytest.mark.parametrize("field_deg", [0.0, 20.0])
    def test_an_elliptical_hole(self, a: float, b: float, turn_deg: float, field_deg: float) -> None:
        """π a b straight on; aslant what the ellipse shares with itself, moved along y by 2 tan 20°: unit circles."""
        hole = OutlineFigure("ellipse", "-", 2.0, 1.0, turn_deg, (a, b))
        t = behind(Outline((*rectangle(30.0, 30.0).figures, hole)), 11.0, 2.0, 1.0, field_deg)
        phi, cosine = math.radians(turn_deg), math.cos(math.radians(field_deg))
        s = 2 * math.tan(math.radians(field_deg)) * math.hypot(math.sin(phi) / a, math.cos(phi) / b)
        shared = a * b * (2 * math.acos(s / 2) - s * math.sqrt(1 - s * s / 4)) * cosine
        assert abs(t.energy.detected_W - shared) < 4 * t.energy.detected_se_W  # 1 in 16,000
        walls = sum(t.energy.absorbed[f"plate_wall_2_{k}"][0] for k in range(1, 5))
        assert walls == pytest.approx(np.pi * a * b * cosine - shared, rel=0.1, abs=1e-9)

    def test_an_elliptical_rim(self) -> None:
        """Aslant an ellipse shades π a b and, by its thickness, 2 tan 20° times its width across that way."""
        a, b, phi, angle = 7.0, 2.0, math.radians(35.0), math.radians(20.0)
        t = behind(Outline((OutlineFigure("ellipse", "+", 1.0, 2.0, 35.0, (a, b)),)), 11.0, 1.0, 2.0, 20.0)
        width = 2 * math.hypot(a * math.cos(phi), b * math.sin(phi))
        shaded = (np.pi * a * b + 2 * math.tan(angle) * width) * math.cos(angle)
        assert abs(t.energy.launched_W - t.energy.detected_W - shaded) < 4 * t.energy.detected_se_W  # 1 in 16,000

    def test_outlines(self) -> None:
        ring, bore = (OutlineFigure("circle", "-", sizes=(radius,)) for radius in (3.0, 1.0))
        each_refused(
            ([ELLIPSE, OutlineFigure("ellipse", "+", sizes=(1.0, 3.0))], "'\\+ellipse'"),
            ([ELLIPSE, OutlineFigure("ellipse", "-", sizes=(1.0, 1.5))], "over its rim"),
            ([CIRCLE, OutlineFigure("circle", "+", 2.0, sizes=(5.0,))], "figure 2"),
            ([CIRCLE, OutlineFigure("circle", "-", 3.0, sizes=(3.0,))], "over its rim"),
            ([CIRCLE, ring, bore], "overlap"),
            (polygon([(0, 0), (1, 1), (1, 0), (0, 1)]).figures, "crosses itself"),
            (circle(1.0).figures, -1.0, "thickness"),
            by=lambda figures, thickness=1.0: plate("p", Outline(tuple(figures)), thickness),
        )
        assert len(plate("p", circle(5.0, x=1.0), 1.0)) == 3


class TestPlacing:
    def test_array(self) -> None:
        """Nine lenslets image a beam to nine points."""
        lenslet = (
            Surface("lenslet_front", radius=5.0, half_width=1.0, half_height=1.0, back="1.5"),
            Surface("lenslet_rear", z=1.0, half_width=1.0, half_height=1.0, front="1.5"),
            Structure("post", 0.2, 0.0, 0.2, 1.0, x=5.0, part="post"),
        )
        places = [(2.0 * i, 2.0 * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        faces = array(lenslet[:2], places)
        assert (len(faces), faces[2].name) == (18, "lenslet_front_2")
        screen = Detector("screen", z=1.0 + (10.0 - 1 / 1.5), half_width=3.0, half_height=3.0, pixels=(9, 9))
        beam = Source(half_width=2.9, half_height=2.9, z=-5.0)
        t = traced(*faces, detectors=(screen,), source=beam, rays=90_000, max_reflections=0)
        spots = t.irradiance[1::3, 1::3]
        assert spots.sum() / t.irradiance.sum() > 0.95
        assert spots.min() > 0.6 * spots.max()  # the beam covers a part of those at the rim
        assert {face.part for face in array(lenslet[2:], places[:2])} == {"post_1", "post_2"}
        each_refused(([], "no places"), ([(1.0,)], "place 1"), by=lambda wrong: array(faces, wrong))

    def test_segments_tip_and_piston(self) -> None:
        """A segment that is tipped by a tenth of a degree sends its light aside by twice as much."""
        mirror = Surface("segment", half_width=1.0, half_height=1.0, coating=Coating(R=1.0, T=0.0), mirror=True)
        (tipped,) = moved_as_one([mirror], z=20.0, tilt_deg=(0.1, 0.0, 0.0))
        seen = Probe("seen", centre=(0, 0, 10.0), normal=(0, 0, -1), half_width=3.0, half_height=3.0, pixels=(1, 301))
        traced(tipped, recorders=[seen], max_reflections=0, source=Source(radius=0.001, z=-1.0))
        y = (int(np.argmax(seen.irradiance[0][:, 0])) + 0.5) * 6 / 301 - 3
        assert abs(abs(y) - 10 * math.tan(math.radians(0.2))) < 6 / 301


def changed(number: int, given: Sequential | None = None, **values: object) -> Sequential:
    """The triplet with other values of one row."""
    given = given or triplet()
    return given.with_rows([replace(row, **values) if row.number == number else row for row in given.rows])


def test_a_triplet_is_closed_from_the_first_rim_to_the_detector():
    closed = to_prescription(triplet())
    shapes = by_name(closed)
    assert [s.name for s in closed.surfaces] == ["S1", "S2", "S3", "S4", "S6", "S7"]
    assert [s.part for s in closed.surfaces] == ["L1", "L1", "L2", "L2", "L3", "L3"]
    assert shapes["S6"].z == pytest.approx(3.25896 + 6.00755 + 0.99998 + 2.0 + 2.75041)
    # Each rim is the end of a wall and of an edge or its flange
    pieces = [shape for shape in shapes.values() if isinstance(shape, Structure)]
    profile = [end for piece in pieces for end in ((piece.r0, piece.z0), (piece.r1, piece.z1))]
    for surface in closed.surfaces:
        met = sum(math.dist(surface.rim, end) < 1e-9 for end in profile)
        assert met == (1 if surface.name == "S1" else 2), surface.name
    assert any(math.dist(end, closed.detector.rim) < 1e-9 for end in profile)
    boards = [f"board_{side}" for side in ("bottom", "left", "right", "top")]
    assert sorted(name for name in shapes if name.startswith("board")) == boards
    for lens_name, glass in (("L1", "1.62041"), ("L2", "1.62005"), ("L3", "1.62041")):
        edge = shapes[f"{lens_name}_edge"]
        assert (edge.front, edge.coating, edge.r0) == (glass, Coating(R=0.0), edge.r1)
    # The stop has the hole of the real marginal ray and closes the tube: outside of the wall that it pierces
    hits, _ = trace(triplet(), [[0.0, 5.0, -1.0]], [[0.0, 0.0, 1.0]])
    stop, barrel = closed.stop, shapes["barrel_2_wall"]
    assert stop.radius == pytest.approx(hits[4, 0, 1], rel=1e-12)
    assert stop.z_front == stop.z_rear == pytest.approx(3.25896 + 6.00755 + 0.99998 + 2.0)
    assert stop.outer_front > np.interp(stop.z_front, [barrel.z0, barrel.z1], [barrel.r0, barrel.r1])


def test_the_detector_and_the_clear_radii():
    """The image of the fields is no measure of a sensor: what lies beyond it sees past the rims of the lenses."""
    given = triplet()
    image = given.rows[-1]

    def detector(aperture: Outline | None, **chosen):
        row = replace(image, aperture=aperture, semi_diameter=5.0)
        built = build(replace(given, rows=(*given.rows[:-1], row)), **chosen)
        found = built.prescription.detector
        return (found.half_width, found.half_height), " ".join(built.notes)

    free, plain = detector(None)
    assert free[0] == free[1] >= 1.02 * 5.0
    wide, notes = detector(rectangle(240.0, 180.0))
    assert (wide, notes) == ((240.0, 180.0), plain)
    small, notes = detector(rectangle(3.0, 4.0))
    assert small == (3.0, 4.0)
    assert "field (0, 20)" in notes, "whose light meets no detector"
    assert detector(rectangle(3.0, 4.0), detector_half_mm=(2.0, 1.0))[0] == (2.0, 1.0)
    for other in (circle(5.0), rectangle(3.0, 4.0, y=1.0)):
        size, notes = detector(other)
        assert size[0] == size[1] >= 5.0
        assert "not a rectangle about its middle" in notes
    given = changed(6, changed(2, semi_diameter=12.0), semi_diameter=5.0, semi_diameter_fixed=True)
    built = build(given, margin=0.1)
    shapes = by_name(built.prescription)
    assert (shapes["S2"].semi_diameter, shapes["S6"].semi_diameter) == (12.0, 5.0)
    assert any("of 17 rays" in note and "at surface 6" in note for note in built.notes)
    # The rays of 20° fill the stop; its upper and lower rims bound the first surface
    assert shapes["S1"].semi_diameter > 1.1 * 5.0
    narrow, wide = (by_name(to_prescription(triplet(), margin=m))["S1"].semi_diameter for m in (0.0, 0.1))
    assert wide == pytest.approx(1.1 * narrow, rel=1e-12)
    built = build(changed(1, semi_diameter=6.0))
    assert by_name(built.prescription)["S1"].semi_diameter > 9.0
    assert any("drawn clear radii" in note and note.endswith("surfaces 1") for note in built.notes)


def test_coatings_of_a_zemax_file(tmp_path):
    """
    Waves are those of the primary wavelength; mirrors and cemented faces turn their layers to the light.

    The thin silver of the mirrors is their substrate, under half a wave that absorbs.
    """
    file = tmp_path / "COATING.DAT"
    file.write_text(
        "MATE MGF2\n0.8 1.38 0\nMATE DULL\n0.8 1.6 -0.05\nMATE AG\n0.8 0.06 -3.6\n"
        "COAT AR\nMGF2 0.25\nCOAT MIRROR\nDULL 0.5\nAG 0.001 1\n"
    )
    rows = (
        Row(1, radius=-200.0, mirror=True, thickness=-70.0, stop=True, coating=f"{file}:MIRROR"),
        Row(2, radius=-80.0, mirror=True, thickness=60.0, coating=f"{file}:MIRROR"),
        Row(3, material="1.9044", thickness=4.0, coating=f"{file}:AR"),
        Row(4, material="1.5", thickness=4.0, coating=f"{file}:MIRROR"),
        Row(5, thickness=30.0),
        Row(6, kind="image"),
    )
    scene = build(lens(*rows, wavelengths_nm=(800.0,), weights=(1.0,), aperture=40.0)).prescription.to_scene()
    coated = {shape.id(): shape.bsdf() for shape in scene.shapes()}
    found = [coated[name].coating.response(800.0, 1.0, 1.0, [1.0], side).R for name in ("S1", "S2") for side in (1, 0)]
    assert np.min(found) == pytest.approx(np.max(found), rel=1e-6)
    assert 0.7 < np.min(found) < 0.8
    assert coated["S4"].coating.front_to_back(800.0, 1.9044, 1.5)[2].tolist() == [0, 1]
    assert np.max(coated["S3"].coating.response(800.0, 1.0, 1.9044, [1.0], True).R) < 1e-6


def test_rims_rays_coatings_and_edges_of_lenses():
    rows = (
        Row(1, radius=61.0, thickness=6.0, material="1.5168", stop=True, label="crown"),
        Row(2, radius=-44.0, thickness=2.5, material="1.6727"),
        Row(3, radius=-130.0, thickness=95.0),
    )
    prescription = to_prescription(lens(*rows, Row(4, kind="image"), aperture=20.0, fields=((0.0, 0.0), (0.0, 3.0))))
    shapes = by_name(prescription)
    edges = [shapes["L1_edge"], shapes["L2_edge"]]
    assert len({edge.r0 for edge in edges} | {edge.r1 for edge in edges}) == 1
    assert edges[0].z1 == edges[1].z0
    pieces = [piece for piece in prescription.structures if isinstance(piece, Structure)]
    rings = [(piece.r0, piece.z0, piece.r1, piece.z1) for piece in pieces if piece.z0 == piece.z1]
    assert len(rings) == len(set(rings))
    assert shapes["crown"].part == "L1"
    # Every point of the float64 trace, put into the world, lies on the placed surface
    for given in (triplet(), newtonian()):
        shapes = [*to_prescription(given).surfaces, to_prescription(given).detector]
        starts = np.array([[x, y, -10.0] for x, y in ((0, 0), (1, 2), (-3, 1), (0, -4))], dtype=float)
        hits, _ = trace(given, starts, np.tile([0.0, 0.0, 1.0], (4, 1)))
        for row, places in zip(given.rows, to_world(given, hits), strict=True):
            if not row.mirror and row.material == "air" and row.kind != "image":
                continue
            name = "detector" if row.kind == "image" else row.label or f"S{row.number}"
            (shape,) = (shape for shape in shapes if shape.name == name)
            own = np.linalg.inv(shape.to_world())
            local = places @ own[:3, :3].T + own[:3, 3]
            flat = replace(shape, x=0.0, y=0.0, z=0.0, tilt_deg=(0.0, 0.0, 0.0))
            assert local[:, 2] == pytest.approx(flat.z_at(np.hypot(local[:, 0], local[:, 1])), abs=1e-9)
    given = changed(3, changed(2, changed(1, coating="AR"), coating="lib/COATING.DAT:HEAR1"), coating="unknown")
    built = build(given, coatings={"ar": Coating(preset="mgf2_quarter_wave")})
    shapes = by_name(built.prescription)
    assert shapes["S1"].coating == Coating(preset="mgf2_quarter_wave")
    assert shapes["S2"].coating == Coating(table="lib/COATING.DAT:HEAR1", design_nm=given.wavelength_nm)
    assert shapes["S3"].coating is None
    assert "coating 'unknown' of surface 3 is not given (coatings=): it is bare" in built.notes
    assert by_name(beside(built.prescription, "out"))["S2"].coating.table == "../lib/COATING.DAT:HEAR1"
    built = build(changed(1, material="nd=1.62 Vd=60"))
    assert built.prescription.surfaces[0].back == "nd=1.62 Vd=60 k=0"
    assert "material 'nd=1.62 Vd=60': its absorption is unknown and taken for 0" in built.notes
    ground = by_name(to_prescription(triplet(), edges="ground", ground_reflectance=0.3))
    paint = Scatter("paint", {"reflectance": 0.3}, name="ground_edge")
    assert (ground["L2_edge"].scatter, ground["barrel_1_wall"].scatter) == ((paint,), ())
    open_ = by_name(to_prescription(triplet(), edges="open"))
    assert open_["L2_edge"].coating is None
    assert not any(name.startswith(("barrel", "board")) for name in open_)
    # In another gas it is around all edges, walls and rims of mirrors, too
    for given in (triplet(), newtonian()):
        rows = [replace(row, material="1.005" if row.material == "air" else row.material) for row in given.rows]
        around = to_prescription(replace(given, rows=tuple(rows), object_material="1.005")).structures
        pieces = [piece for piece in around if piece.name.endswith(("_edge", "_wall", "_rim"))]
        assert {piece.back for piece in pieces} == {"1.005"}


def test_provenance_lists_notes_and_every_line_without_effect(tmp_path):
    pickups = Unread(0, "pickups", "values are taken as they are")
    lines = ((12, "  XDAT 1 2", "not read"), (40, "TOL -- 3", "a tolerance"), (3, "\x01\x02 bad", "?"))
    unread = (*(Unread(*line) for line in lines), pickups)
    given = replace(triplet(object_distance=500.0), name="a\x00b", source="Zemax file a.zmx", unread=unread)
    prescription = to_prescription(given)
    lines = prescription.provenance.splitlines()
    told = {"Without effect, line 12: XDAT 1 2 (not read)", "Without effect: pickups (values are taken as they are)"}
    assert (lines[0], told - set(lines)) == ("From Zemax file a.zmx.", set())
    # Its pupil lies in the stop, which the source's frame has its origin in
    source = prescription.source
    assert source.distance - source.z == pytest.approx(500.0)
    assert "Note: the object is virtual" in to_prescription(triplet(object_distance=-500.0)).provenance
    prescription.to_xml(tmp_path / "a.xml")
    text = (tmp_path / "a.xml").read_text(encoding="utf-8")
    assert all(words in text for words in ("line 40: TOL - - 3 (a tolerance)", "\\x01\\x02 bad"))
    assert not set(map(chr, range(32))) - {"\n"} & set(text)


def test_the_source_and_what_is_no_lens():
    weighted = triplet(wavelengths_nm=(486.1, 587.6, 656.3), weights=(1.0, 2.0, 0.0), primary=1)
    source = to_prescription(weighted, beam="exact").source
    assert (source.radius, source.plane, source.pupil_area, source.wavelength_nm) == (5.0, "axis", None, (486.1, 587.6))
    assert source.weights == pytest.approx((1 / 3, 2 / 3))
    built = build(triplet(), beam="front")
    front = by_name(built.prescription)["S1"].semi_diameter
    assert built.prescription.source.radius == pytest.approx(1.05 * front)
    assert built.prescription.source.pupil_area == pytest.approx(math.pi * front**2)
    # At the first field, slopes tan 3° and tan 4° in x and y: the azimuth turns from +y towards -x
    tangents = [math.tan(math.radians(angle)) for angle in (3.0, 4.0)]
    source = to_prescription(triplet(fields=((3.0, 4.0), (0.0, 0.0)))).source
    assert source.field_deg == pytest.approx(math.degrees(math.atan(math.hypot(*tangents))), abs=1e-8)
    assert source.azimuth_deg == pytest.approx(-math.degrees(math.atan2(*tangents)), abs=1e-8)
    down = to_prescription(triplet(fields=((0.0, -5.0), (0.0, 5.0)))).source
    assert (down.field_deg, down.azimuth_deg) == (-5.0, 0.0)
    # Of a near object it is the point of the first field, so that the chief ray starts there
    near = triplet(object_distance=200.0, field_kind="object_height", fields=((3.0, -5.0), (0.0, 0.0)))
    source = to_prescription(near).source
    away, turn = -source.distance * math.tan(math.radians(source.field_deg)), math.radians(source.azimuth_deg)
    assert (-away * math.sin(turn), away * math.cos(turn)) == pytest.approx((3.0, -5.0), abs=1e-6)
    assert source.z - source.distance == pytest.approx(-200.0, rel=1e-12)
    built = build(triplet(fields=tuple((0.0, 0.1 * k) for k in range(200))))
    assert "of 200 fields the first and the 23 outermost others give sizes and vignetting" in built.notes
    rows = triplet().rows
    many = [*rows[:-1], *(Row(number, thickness=0.1) for number in range(8, 501)), rows[-1]]
    each_refused(
        (triplet(), {"beam": "all"}, "beam = 'all'"),
        (triplet(), {"edges": "shiny"}, "edges = 'shiny'"),
        (changed(1, radius=1e-300), {}, "lens 'test'"),
        (triplet().with_rows(many), {}, "has 501 surfaces, more than 500"),
        by=lambda given, options: build(given, **options),
    )


def test_crossing_surfaces_names_and_tilted_groups():
    """An equiconvex lens of R = 50, t = 2: the faces meet where 2 sag = 2, r² = 2 R - 1."""
    biconvex = lens(
        Row(1, stop=True, thickness=8.0),
        Row(2, radius=50.0, thickness=2.0, material="1.5", semi_diameter=15.0),
        Row(3, radius=-50.0, thickness=49.0, semi_diameter=15.0),
        Row(4, kind="image"),
    )
    built = build(biconvex)
    shapes = by_name(built.prescription)
    knife = math.sqrt(2 * 50.0 * 1.0 - 1.0)
    for name in ("S2", "S3"):
        assert 0.99 * knife <= shapes[name].semi_diameter < knife
    assert any("'S2' and 'S3' cross" in note for note in built.notes)
    # So do both faces of a Mangin mirror, whose first one light meets twice, with the edge between them
    mangin = lens(
        Row(1, radius=50.0, thickness=2.0, material="1.5", semi_diameter=14.0, stop=True),
        Row(2, radius=-50.0, thickness=-2.0, mirror=True, material="1.5", semi_diameter=14.0),
        Row(3, radius=50.0, thickness=-30.0, semi_diameter=14.0),
        Row(4, kind="image"),
        aperture=8.0,
    )
    shapes = by_name(to_prescription(mangin))
    assert shapes["S1"].semi_diameter == shapes["S2"].semi_diameter == shapes["L1_edge"].r0
    assert shapes["S1"].semi_diameter == pytest.approx(knife, rel=0.01)
    # It is as small as its beam, on the way back too, where it bulges through the stop before it
    bulging = lens(
        Row(1, stop=True, thickness=0.1),
        Row(2, radius=-50.0, thickness=4.0, material="1.5", semi_diameter=14.0),
        Row(3, radius=-80.0, thickness=-4.0, mirror=True, material="1.5", semi_diameter=14.0),
        Row(4, radius=-50.0, thickness=-30.0, semi_diameter=14.0),
        Row(5, kind="image"),
        aperture=8.0,
    )
    reach = edge_rays(bulging).reach
    assert by_name(to_prescription(bulging))["S2"].semi_diameter == pytest.approx(max(reach[1], reach[3]), rel=1e-12)
    for labels, names, parts in vectors.toml("tables.toml")["names of surfaces"]:
        named = zip(triplet().rows, [*labels.split(";"), *8 * [""]], strict=False)
        rows = [replace(row, label=name) for row, name in named]
        prescription = to_prescription(triplet().with_rows(rows))
        assert [s.name for s in prescription.surfaces][:4] == names.split()
        assert [s.part for s in prescription.surfaces][:4:2] == parts.split()
    labels = ["L1 front", "it's", "twin", "twin", "iris", "stop_front", "", "FPA"]
    rows = [replace(row, label=name) for row, name in zip(triplet().rows, labels, strict=True)]
    prescription = to_prescription(triplet().with_rows(rows))
    (note,) = [line for line in prescription.provenance.splitlines() if "'FPA'" in line]
    pairs = {"L1 front": "'L1_front'", "twin": "'S3' and 'S4'", "iris": "'stop_front'", "stop_front": "'S6'"}
    for old, new in {**pairs, "FPA": "'detector'"}.items():
        assert f"'{old}' is {new}" in note
    each_refused((prescription, {"FPA": "R=0.05"}, "did you mean 'detector'"), by=mistray.coat)
    tilted = lens(
        Row(1, thickness=5.0, stop=True),
        Row(2, kind="coordinate_break", decentre=Decentre(y=1.0, tilt_deg=(10.0, 0.0, 0.0))),
        Row(3, radius=50.0, thickness=4.0, material="1.5"),
        Row(4, radius=-50.0, thickness=40.0),
        Row(5, kind="image"),
        aperture=8.0,
    )
    shapes = by_name(to_prescription(tilted))
    for shape in (shapes["L1_edge"], shapes["S3"]):
        assert (shape.x, shape.y, shape.z, shape.tilt_deg) == (0.0, 1.0, 5.0, (10.0, 0.0, 0.0))
    assert shapes["board_left"].tilt_deg == (10.0, 0.0, 0.0)
    assert shapes["detector"].z == pytest.approx(5.0 + 44.0 * math.cos(math.radians(10.0)))


def test_the_stop_has_the_apertures_that_the_file_states():
    shapes = by_name(to_prescription(changed(5, aperture=circle(3.0, 0.5))))
    stop, disc = shapes["stop_front"], shapes["S5_obscuration"]
    assert (stop.r1, (disc.semi_diameter, disc.z)) == (3.0, pytest.approx((0.5, stop.z0), abs=1e-9))
    assert "S5_aperture" not in shapes
    shapes = by_name(to_prescription(changed(5, aperture=rectangle(1.0, 3.0))))
    assert shapes["S5_frame_left"].x + shapes["S5_frame_left"].half_width == pytest.approx(-1.0)
    rows = list(newtonian().rows)
    rows[0] = replace(rows[0], obscuration=circle(30.0))
    rows[1] = replace(rows[1], aperture=circle(110.0, 20.0))
    rows[3] = replace(rows[3], aperture=rectangle(25.0, 40.0))
    shapes = by_name(to_prescription(newtonian().with_rows(rows)))
    assert (shapes["sky_obscuration"].semi_diameter, shapes["sky_obscuration"].coating) == (30.0, Coating(R=0.0))
    assert (shapes["primary"].semi_diameter, shapes["primary"].inner_semi_diameter) == (110.0, 20.0)
    assert (shapes["flat"].half_width, shapes["flat"].half_height) == (25.0, 40.0)
    assert "flat_rim" not in shapes
    for number in (1, 2):
        shapes = by_name(to_prescription(changed(number, obscuration=circle(2.0, y=1.0))))
        patch, surface = shapes[f"S{number}_obscuration"], shapes[f"S{number}"]
        # 1 µm before the surface, on its figure, in the material before it
        assert (patch.outline, patch.z) == (circle(2.0, y=1.0), pytest.approx(surface.z - 1e-3))
        assert (patch.radius, patch.conic) == (surface.radius, surface.conic)
        assert patch.front == patch.back == surface.front
    # A sphere ends at its radius, whatever the file says of apertures; nothing of an obscuration may be left
    end = 0.999 * abs(triplet().rows[0].radius)
    disc = by_name(to_prescription(changed(1, obscuration=circle(100.0, inner=5.0))))["S1_obscuration"]
    assert (disc.semi_diameter, disc.inner_semi_diameter) == (pytest.approx(end), 5.0)
    for beyond in (circle(100.0, inner=50.0), circle(1.0, x=80.0)):
        built = build(changed(1, obscuration=beyond))
        assert "S1_obscuration" not in by_name(built.prescription)
        assert any("obscuration that lies beyond the rim" in note for note in built.notes)
    for stated in (rectangle(100.0, 8.0), circle(100.0, x=60.0)):
        built = build(changed(1, aperture=stated))
        assert by_name(built.prescription)["S1"].outline == stated.within(end)
        assert any("its aperture is cut where its conic ends" in note for note in built.notes)


def test_a_freeform_lens_has_an_edge_that_reaches_both_rims():
    """A toroid in front of a plane: no light gets out between the rims and the edge, which is a little too long."""
    rows = (
        Row(1, radius=60.0, sag={"toroid_curvature": -1 / 80}, thickness=6.0, material="1.5", semi_diameter=10.0),
        Row(2, radius=math.inf, sag={"zernike_6": 0.1, "zernike_radius": 10.0}, thickness=60.0, semi_diameter=10.0),
        Row(3, kind="image"),
    )
    built = build(Sequential("toroid", rows, aperture=12.0, fields=((0.0, 0.0),)))
    edge = by_name(built.prescription)["L1_edge"]
    heights = 100 / 120, -100 / 160  # of the rim in y and in x, near enough
    assert edge.z0 == pytest.approx(min(heights), rel=0.02)
    assert edge.z1 == pytest.approx(6.0 + 0.1 * math.sqrt(6), rel=1e-6)
    light = mistray.trace(built.prescription.to_scene(), rays=20_000, field_deg=30.0, max_reflections=3)
    assert light.energy.cut["medium"] == 0.0
    assert abs(light.energy.closure) < 1e-5
    for x in (0.0, 1.0):
        cut = replace(rows[0], aperture=Outline((OutlineFigure("ellipse", x=x, sizes=(9.0, 8.0)),)))
        built = build(Sequential("toroid", (cut, *rows[1:]), aperture=12.0))
        assert any("it has no edges" in note for note in built.notes) == bool(x)
        assert ("S1_aperture" in by_name(built.prescription)) == (not x)

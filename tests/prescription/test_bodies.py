"""Prisms, boxes, cubes and plates: closed bodies that do to light what textbooks say, and arrays."""

import math

import numpy as np
import pytest

import mistray
from mistray import Coating, Detector, Prescription, Source, Structure, Surface
from mistray.physics.geometry.outline import Outline, OutlineFigure
from mistray.prescription import array, beam_splitter_cube, box, circle, moved_as_one, plate, polygon, prism, rectangle
from mistray.recorders import FarField, Probe
from mistray.trace import Trace

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
        edges = np.degrees(deviation) + np.array([-0.001, 0.001])
        far = FarField("far", edges_deg=edges)
        aside = FarField("aside", edges_deg=(0, 0.01), axis=(0, -math.sin(deviation), math.cos(deviation)))
        t = traced(*body, recorders=[far, aside], max_reflections=0)
        r = np.mean(self.fresnel(n, math.cos((deviation + math.radians(60)) / 2)))
        assert far.power[0] == pytest.approx(aside.power[0], rel=1e-9)
        # Unpolarised light at each face: the mean of s and p twice, not the mean of their squares
        assert far.power[0] == pytest.approx(np.pi * (1 - r) ** 2, rel=1e-5)
        assert abs(t.energy.closure) < 1e-6

    @staticmethod
    def fresnel(n: float, cos_i: float) -> list[float]:
        """Reflectances of s and p from vacuum into an index n."""
        cos_t = math.sqrt(1 - (1 - cos_i**2) / n**2)
        return [((a - b) / (a + b)) ** 2 for a, b in ((cos_i, n * cos_t), (n * cos_i, cos_t))]

    @pytest.mark.parametrize("tilt", [0.0, 3.0, -2.0])
    def test_pentaprism(self, tilt: float) -> None:
        """It turns light by 90° however it stands: two mirrors at 45°, and faces at 90°, in its own glass."""
        a = 20.0
        far = a * (1 + math.tan(math.radians(22.5)))
        corners = [(0.0, 0.0), (a, 0.0), (far, a), (a, far), (0.0, a)]
        faces = ("entrance", "mirror_1", "roof", "mirror_2", "exit")
        silver = Coating(R=1.0, T=0.0)
        body = prism("penta", corners, a, material="1.5", faces=faces, mirrors=("mirror_1", "mirror_2"),
                     coatings={"mirror_1": silver, "mirror_2": silver})  # fmt: skip
        body = moved_as_one(moved_as_one(body, y=-a / 2, z=-a / 2), tilt_deg=(tilt, 0, 0))
        down = FarField("down", **DOWN)
        t = traced(*body, recorders=[down], max_reflections=0)
        assert down.power[0] == pytest.approx(np.pi * 0.96**2, rel=2e-3)
        assert abs(t.energy.closure) < 1e-6

    def test_total_reflection(self) -> None:
        """A right-angle prism turns light by its hypotenuse, with nothing lost but at the two other faces."""
        body = prism("porro", [(-5, -5), (5, -5), (-5, 5)], 10.0, material="1.6", faces=("in", "hypotenuse", "out"))
        down = FarField("down", **DOWN)
        t = traced(*body, recorders=[down], max_reflections=0)
        r = (0.6 / 2.6) ** 2
        assert down.power[0] == pytest.approx(np.pi * (1 - r) ** 2, rel=1e-5)
        assert t.energy.absorbed["porro_left"][0] == 0

    def test_closed(self) -> None:
        """Light that got into a concave body finds no gap between its faces on the way through 60 reflections."""
        corners = [(-10, -10), (10, -10), (10, 10), (3, 2), (-10, 10)]
        sides = Coating(R=0.7, T=0.2)
        body = prism("w", corners, 12.0, material="1.5", coatings={str(k): sides for k in range(1, 6)}, ends=sides)
        beam = Source(radius=4.0, z=-50.0, field_deg=7.0, azimuth_deg=33.0)
        t = traced(*body, source=beam, max_reflections=60, max_events=200, flux_threshold=1e-6, rays=20_000)
        assert t.segments > 30 * 20_000
        assert t.energy.cut["medium"] == 0
        assert abs(t.energy.closure) < 1e-6

    def test_bad_input(self) -> None:
        for change, words in (
            ({"corners": [(0, 0), (1, 1), (1, 0), (0, 1)]}, "crosses itself"),
            ({"corners": [(0, 0), (1, 1), (2, 2)]}, "without area"),
            ({"corners": [(0, 0, 1), (1, 1, 1), (2, 2, 3)]}, "give y and z"),
            ({"width": math.nan}, "width"),
            ({"faces": ("a", "a", "b")}, "names of its 3 faces"),
            ({"coatings": {"top": None}}, "no face 'top'"),
        ):
            given = {"name": "p", "corners": [(0, 0), (1, 0), (0, 1)], "width": 1.0, "material": "1.5"} | change
            with pytest.raises(mistray.MistrayError, match=words):
                prism(**given)


class TestCubeAndBox:
    def test_cube(self) -> None:
        """R of the diagonal goes to +y and T on, through two bare faces; also turned and displaced with its beam."""
        cube = beam_splitter_cube("cube", 20.0, material="1.5", splitter=Coating(R=0.3, T=0.6))
        up = Detector("up", y=100.0, tilt_deg=(90.0, 0.0, 0.0), half_width=5.0, half_height=5.0)
        on = Detector("on", z=100.0, half_width=5.0, half_height=5.0)
        t = traced(*cube, detectors=(up, on), max_reflections=1)
        paths = {(row.detector, row.path): row.power_W for row in t.paths}
        assert paths["on", "TTTA"] == pytest.approx(np.pi * 0.6 * 0.96**2, rel=1e-5)
        assert paths["up", "TRTA"] == pytest.approx(np.pi * 0.3 * 0.96**2, rel=1e-5)
        motion = {"x": 3.0, "y": -4.0, "z": 7.0, "tilt_deg": (0.0, 0.0, 37.0)}  # the source looks along z
        beam = Source(x=3.0, y=-4.0, z=-50.0, radius=1.0)
        (up,) = moved_as_one([up], **motion)
        t = traced(*moved_as_one(cube, **motion), detectors=(up,), source=beam, max_reflections=1)
        assert t.energy.detected_W == pytest.approx(np.pi * 0.3 * 0.96**2, rel=1e-5)

    def test_box(self) -> None:
        """It takes all light that meets it, wherever it stands."""
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
        with pytest.raises(mistray.MistrayError, match="size is 0; it must lie between 1e-15"):
            box("b", (1.0, 0.0, 1.0))


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
        holes = np.pi * 9 + 16 + 6
        assert abs(t.energy.detected_W - holes) < 4 * t.energy.detected_se_W  # 1 in 16,000
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
        for figures, words in (
            ([ELLIPSE, OutlineFigure("ellipse", "+", sizes=(1.0, 3.0))], "'\\+ellipse'"),
            ([ELLIPSE, OutlineFigure("ellipse", "-", sizes=(1.0, 1.5))], "over its rim"),
            ([CIRCLE, OutlineFigure("circle", "+", 2.0, sizes=(5.0,))], "figure 2"),
            ([CIRCLE, OutlineFigure("circle", "-", 3.0, sizes=(3.0,))], "over its rim"),
            ([CIRCLE, ring, bore], "overlap"),
            (polygon([(0, 0), (1, 1), (1, 0), (0, 1)]).figures, "crosses itself"),
        ):
            with pytest.raises(mistray.MistrayError, match=words):
                plate("p", Outline(tuple(figures)), 1.0)
        with pytest.raises(mistray.MistrayError, match="thickness"):
            plate("p", circle(1.0), -1.0)
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
        assert len(faces) == 18
        assert faces[2].name == "lenslet_front_2"
        back = 10.0 - 1 / 1.5
        screen = Detector("screen", z=1.0 + back, half_width=3.0, half_height=3.0, pixels=(9, 9))
        beam = Source(half_width=2.9, half_height=2.9, z=-5.0)
        t = traced(*faces, detectors=(screen,), source=beam, rays=90_000, max_reflections=0)
        spots = t.irradiance[1::3, 1::3]
        assert spots.sum() / t.irradiance.sum() > 0.95
        assert spots.min() > 0.6 * spots.max()  # the beam covers a part of those at the rim
        assert {face.part for face in array(lenslet[2:], places[:2])} == {"post_1", "post_2"}
        for wrong, words in (([], "no places"), ([(1.0,)], "place 1")):
            with pytest.raises(mistray.MistrayError, match=words):
                array(faces, wrong)

    def test_segments_tip_and_piston(self) -> None:
        """A segment that is tipped by a tenth of a degree sends its light aside by twice as much."""
        mirror = Surface("segment", half_width=1.0, half_height=1.0, coating=Coating(R=1.0, T=0.0), mirror=True)
        (tipped,) = moved_as_one([mirror], z=20.0, tilt_deg=(0.1, 0.0, 0.0))
        seen = Probe("seen", centre=(0, 0, 10.0), normal=(0, 0, -1), half_width=3.0, half_height=3.0, pixels=(1, 301))
        traced(tipped, recorders=[seen], max_reflections=0, source=Source(radius=0.001, z=-1.0))
        y = (int(np.argmax(seen.irradiance[0][:, 0])) + 0.5) * 6 / 301 - 3
        assert abs(abs(y) - 10 * math.tan(math.radians(0.2))) < 6 / 301

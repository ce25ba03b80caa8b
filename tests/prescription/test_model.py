"""Parts of a prescription: what they refuse, how shapes stand; near objects, polarised sources, detectors."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles.small_scenes import write
from refusals import each_refused, refused

import mistray
from mistray import Coating, Detector, Prescription, Source, Structure, Surface
from mistray.io import from_zemax, to_sequential, write_zemax
from mistray.prescription import Grid, ObjectPoint, Stop
from mistray.scene.read_optics import read_optics

pytestmark = pytest.mark.quick

DETECTOR = Detector(z=20.0, half_width=1.0, half_height=1.0)
SOURCE = Source(radius=1.0)
AR = Coating(preset="bbar3", name="ar")


def system(*surfaces, **more):
    return Prescription(name="test", surfaces=surfaces, **({"detector": DETECTOR, "source": SOURCE} | more))


def lens(z=0.0, radius=50.0, front=None, rear=None):
    return (
        Surface("L1_front", z=z, radius=radius, semi_diameter=5.0, back="1.5", coating=front),
        Surface("L1_rear", z=z + 2.0, radius=-radius, semi_diameter=5.0, front="1.5", coating=rear),
    )


def message(function, *arguments, **keywords):
    with refused() as caught:
        function(*arguments, **keywords)
    return str(caught.value)


def test_bad_parts():
    for part, values, wanted in (
        (Surface, {"semi_diameter": -5.0}, "surface 'x': semi_diameter is -5; it must lie between 1e-15 and 1e12 mm"),
        (Surface, {"half_width": 1.0}, "give either semi_diameter, both half sizes or an outline"),
        (Surface, {"semi_diameter": 1.0, "inner_semi_diameter": 1.0}, "between 0 and 1 mm, 1 excluded"),
        (Surface, {"semi_diameter": 1.0, "coefficients": (0.0,) * 10}, "at most 9"),
        (Surface, {"half_width": 1.5, "half_height": 1.5, "radius": 2.0}, "2.12132 mm; its conic ends at 2 mm"),
        (Coating, {}, "coating 'x': it has no recipe; give one of R (and T), table, layers and preset"),
        (Coating, {"R": 0.1, "table": "x.csv"}, "it has R = 0.1 and table = 'x.csv'; give one of"),
        (Coating, {"R": 0.6, "T": 0.5}, "coating 'x': R = 0.6 and T = 0.5; both must lie in 0 … 1 and R + T must"),
        (Coating, {"table": "x.csv", "T": 0.1}, "T = 0.1 beside table = 'x.csv', which already holds T"),
        (Coating, {"preset": "bbar9"}, "coating preset 'bbar9' is unknown; did you mean 'bbar4'?"),
        (Coating, {"layers": "1.38 10", "design_nm": 0.0}, "design_nm is 0; it must lie between 10 and 1e7 nm"),
        (Coating, {"layers": "1.38 10", "first": "top"}, "first is 'top'; choose from outside, front, back"),
        (Coating, {"R": 0.1, "first": "front"}, "coating 'x': first has no meaning beside R, which has no layers"),
        (Coating, {"R": 0.1, "name": "a.b"}, "must not be empty or hold a dot"),
        (Structure, {"r0": 1.0, "z0": 0.0, "r1": -1.0, "z1": 1.0}, "structure 'x': r1 is -1; it must lie between 0"),
        (Structure, {"r0": 1.0, "z0": 0.0, "r1": 1.0, "z1": 0.0}, "no area"),
        (Detector, {"half_width": 1.0, "half_height": 1.0, "pixels": (0, 5)}, "pixels is 0; it must be a whole number"),
        (Source, {}, "give either radius or both half sizes"),
        (Source, {"radius": -1.0}, "radius is -1"),
        (Source, {"radius": 1.0, "irradiance": 0.0}, "irradiance is 0"),
        (Source, {"radius": 1.0, "inner_radius": 1.0}, "inner_radius is 1"),
        (Source, {"radius": 1.0, "pupil_area": -1.0}, "pupil_area is -1"),
        (Source, {"radius": 1.0, "plane": "pupil"}, "choose from beam, axis"),
        (Source, {"radius": 1.0, "pattern": "hex"}, "choose from random, grid"),
        (Source, {"radius": 1.0, "wavelength_nm": ()}, "at least one"),
        (Source, {"radius": 1.0, "wavelength_nm": (500.0, 600.0), "weights": (1.0,)}, "1 weights for 2"),
        (Prescription, {"surfaces": (), "detector": ("detector", 50.0)}, "'x': detector is a tuple"),
        (Prescription, {"surfaces": (*lens(), *lens(z=10.0))}, "2 shapes are called 'L1_front'"),
        (Prescription, {"surfaces": (*lens(), Surface("s", z=2.0, radius=-50.0, semi_diameter=3.0))}, "coincide"),
        (Prescription, {"surfaces": (Surface("s", z=20.0, semi_diameter=3.0),), "detector": DETECTOR}, "coincide"),
        (Prescription, {"surfaces": lens(front=AR, rear=replace(AR, preset="bbar4"))}, "coatings are called 'ar'"),
        (Prescription, {"surfaces": lens(front=replace(AR, name="L1_rear"))}, "a shape and a coating are called"),
    ):
        assert wanted in message(part, **({} if part is Source else {"name": "x"}) | values)


def test_coatings_crossing_surfaces_stops_and_names():
    for recipe, layered, opaque in vectors.toml("tables.toml")["coatings"]:
        assert (Coating(**recipe).layered, Coating(**recipe).opaque) == (layered, opaque), recipe
    assert system(*lens(front=AR, rear=AR)).shared_coatings() == {"ar": AR}
    # Two spheres whose sags add up to the thickness; rings of a telescope that share no radius may stand so
    front = Surface("front", radius=10.0, semi_diameter=6.0, back="1.5")
    rear = Surface("rear", z=2.0, radius=-10.0, semi_diameter=6.0, front="1.5")
    at = re.search(r"'front' and 'rear' cross at r = ([\d.]+) mm", message(system, front, rear))
    assert float(at[1]) == pytest.approx(math.sqrt(10**2 - 9**2), rel=0.003)  # to the spacing of the samples
    system(
        Surface("M1", semi_diameter=10.0, inner_semi_diameter=6.0, radius=100.0),
        Surface("M3", z=-0.1, semi_diameter=6.0, inner_semi_diameter=1.0, radius=20.0),
    )
    each_refused((5.0, 0.0, "radius is 5;"), (1.0, 0.2, "swap them"), by=lambda *start: Stop(*start, 0.1, 4.0, 6.0))
    for name in ("", "a.b", " a", "=a", "a\nb"):
        assert ascii(name) in message(Surface, name, semi_diameter=1.0)
        assert ascii(name) in message(Structure, name, 1.0, 0.0, 1.0, 1.0)
    thick = [(f.name, f.r0, f.z0, f.r1, f.z1) for f in Stop(1.0, -0.1, 0.0, 2.0, 3.0).faces()]
    assert thick[:2] == [("stop_front", 2.0, -0.1, 1.0, -0.1), ("stop_wall", 1.0, -0.1, 1.0, 0.0)]
    assert thick[2:] == [("stop_rear", 1.0, 0.0, 3.0, 0.0)]
    (thin,) = Stop(1.0, 0.0, 0.0, 2.0, 2.0).faces()
    assert thin.z0 == thin.z1 == 0.0


def test_numbers_of_numpy_and_odd_names_of_grids_are_written(tmp_path: Path) -> None:
    sag = {"grid": Grid.of(np.zeros((4, 4)), (5.0, 5.0))}
    sides = [Surface(name, z=z, semi_diameter=5.0, sag=sag) for name, z in (("a/b", 0.0), ("a b", 1.0))]
    plate = Surface("c", z=2.0, radius=np.float32(50.5), conic=np.int64(-1), semi_diameter=5.0, space=np.int64(3))
    system(*sides, plate, source=Source(radius=1.0, field_deg=np.float32(0.5))).to_xml(tmp_path / "$1.xml")
    assert {path.name for path in tmp_path.glob("*.npz")} == {"_1_a_b_grid.npz", "_1_a_b_2_grid.npz"}
    for line in ('"radius" value="50.5"', '"conic" value="-1"', '"space" value="3"', '"field_deg" value="0.5"'):
        assert f"name={line}/>" in (tmp_path / "$1.xml").read_text()
    assert len(mistray.load(tmp_path / "$1.xml").shapes()) == 4


@pytest.mark.parametrize("missing", ["detector", "source"])
def test_scene_needs_detector_and_source(missing, tmp_path):
    prescription = system(*lens(), **{missing: None})
    for given in (prescription.to_dict, prescription.to_scene, lambda: prescription.to_xml(tmp_path / "scene.xml")):
        with refused("", f"has no {missing}", f"add {missing}="):
            given()
    assert not list(tmp_path.iterdir())
    for name in ("integrator", "source", "type"):
        taken = system(*lens(), structures=(Structure(name, 9.0, 0.0, 9.0, 1.0),))
        assert f"'{name}' is a name of the scene's own" in message(taken.to_dict)
    assert "no source" in message(system(*lens(), source=None).with_source, field_deg=7.0)
    assert system(*lens()).with_source(field_deg=7.0).source.field_deg == 7.0


def test_paraxial_and_placement_about_x_then_y_then_z():
    thin = system(*lens(radius=100.0)).paraxial(550.0)
    assert thin.efl == pytest.approx(1 / (0.5 * (2 / 100 - 0.5 * 2 / (1.5 * 100**2))), rel=1e-12)
    bent = [replace(face, radius=math.inf, sag={"xy_0_2": face.curvature / 2}) for face in lens(radius=100.0)]
    assert system(*bent).paraxial(550.0).efl == pytest.approx(thin.efl, rel=1e-6)
    mirror = Surface("m", semi_diameter=5.0, radius=-100.0, coating=Coating(R=1.0), mirror=True)
    assert "surface 'm'" in message(system(mirror).paraxial, 550.0)
    placed = Surface("s", semi_diameter=1.0, x=1.0, y=2.0, z=3.0, tilt_deg=(90.0, 90.0, 90.0))
    matrix = placed.to_world()
    np.testing.assert_allclose(matrix[:3, 3], (1, 2, 3))
    # x axis: stays, then -z, stays; z axis: -y, stays, then +x
    np.testing.assert_allclose(matrix[:3, :3] @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(matrix[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-15)
    assert not placed.coaxial
    assert Surface("s", semi_diameter=1.0, z=3.0, tilt_deg=(0.0, 0.0, 45.0)).coaxial


# An ellipsoid of revolution images one focus in the other without aberrations: at R/(1 - e) and R/(1 + e)
RADIUS, ECCENTRICITY = -60.0, 0.5
FAR, NEAR = -RADIUS / (1 - ECCENTRICITY), -RADIUS / (1 + ECCENTRICITY)
OBJECT = f"MODE SEQ\nOBNA 0.1 0\nFTYP 1 0 2 1 0 0 0\nXFLN 0 0\nYFLN 0 2\nWAVM 1 0.55 1\nSURF 0\n  DISZ {FAR}"
MIRROR = f"SURF 1\n  STOP\n  CURV {1 / RADIUS}\n  CONI {-(ECCENTRICITY**2)}\n  GLAS MIRROR 0 0\n  DISZ {-NEAR}"


def test_an_ellipsoid_images_its_focus(tmp_path: Path) -> None:
    """It is written as it was read: Zemax file, scene, Zemax file."""
    lens = from_zemax(write(tmp_path, f"{OBJECT}\n{MIRROR}\nSURF 2\n  DISZ 0\n  DIAM 3 1\n", "ellipsoid.zmx"))
    assert isinstance(lens.source, ObjectPoint)
    lens.to_xml(tmp_path / "scene.xml")
    for scene in (lens.to_scene(), mistray.load(tmp_path / "scene.xml")):
        (direct,) = mistray.trace(scene, rays=20_000, max_reflections=0).paths.select("kind == 'direct'")
        assert max(direct.rms_radius_mm, np.hypot(direct.x_mm, direct.y_mm)) < 1e-4
        moved = mistray.trace(scene, rays=20_000, field_mm=1.0, max_reflections=0)
        assert moved.paths.select("kind == 'direct'")[0].y_mm == pytest.approx(-NEAR / FAR, rel=0.05)
    write_zemax(to_sequential(lens), tmp_path / "back.zmx")
    back = from_zemax(tmp_path / "back.zmx").source
    assert isinstance(back, ObjectPoint)
    assert back.distance - back.z == pytest.approx(FAR)


SOURCES = [Source(radius=2.0), ObjectPoint(distance=50.0)]
STATES = [
    ({"stokes": (0.25, -0.5, 0.75)}, (0.25, -0.5, 0.75)),
    ({"jones": (1, -1j)}, (0, 0, 1)),
    ({"jones": (0.5 + 1j, 2)}, ((1.25 - 4) / 5.25, 2 / 5.25, 4 / 5.25)),
    ({"polarization_deg": 45.0}, (0, 1, 0)),
    ({}, None),
]


@pytest.mark.parametrize(("light", "stokes"), STATES)
@pytest.mark.parametrize("source", SOURCES)
def test_a_polarised_source_comes_back(tmp_path: Path, source, light, stokes) -> None:
    lens = system(source=replace(source, **light))
    file = tmp_path / "lens.xml"
    lens.to_xml(file)
    for scene in (lens.to_scene(), mistray.load(file)):
        assert [emitter.stokes for emitter in scene.emitters()] == [pytest.approx(stokes, abs=1e-12)]
    found, _ = read_optics(file)
    assert {key: getattr(found.source, key) for key in light} == light
    assert any(key in file.read_text(encoding="utf-8") for key in ("stokes", "jones", "polarization")) == bool(light)


def test_sources_of_a_call_and_refusals() -> None:
    for light in ({"stokes": (1, 1, 1)}, {"jones": (0, 0)}, {"jones": (1, 0), "polarization_deg": 3.0}):
        for source in SOURCES:
            with pytest.raises(mistray.MistrayError, match=next(iter(light))):
                replace(source, **light)
    scene = mistray.load("plate", sources=["beam:radius=2,stokes=0 0.6 0.8"])
    assert scene.emitters()[0].stokes == pytest.approx((0, 0.6, 0.8))
    assert mistray.trace(scene, rays=64).paths[0].s2 == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize("field_deg", [0.0, 40.0, 60.0])
def test_the_books_have_what_is_detected_lost_and_reflected(tmp_path: Path, field_deg: float) -> None:
    """Linear between the nodes in wavelength and cosine; 600 nm lies in the middle."""
    rows = "500,0,.2,.1\n500,60,.4,.3\n700,0,.1,.5\n700,60,.3,.6\n"
    (tmp_path / "qe.csv").write_text(f"wavelength_nm,angle_deg,R,T\n{rows}")
    size = {"half_width": 5.0, "half_height": 5.0}
    lost = Surface("lost", z=10.1, coating=Coating(R=0.0), **size)
    sensor = Detector("sensor", z=10.0, coating=Coating(table=str(tmp_path / "qe.csv")), **size)
    parts = {"surfaces": (), "structures": (lost,), "detector": sensor, "source": Source(z=10.0, radius=1.0)}
    scene = Prescription(name="sensor", **parts).to_scene()
    t = mistray.trace(scene, rays=3000, field_deg=field_deg, wavelength_nm=(500.0, 600.0))
    along = (np.cos(np.radians(field_deg)) - 0.5) / 0.5  # 1 at 0°, 0 at 60°
    for nm, at_0, at_60 in ((500.0, (0.2, 0.1), (0.4, 0.3)), (600.0, (0.15, 0.3), (0.35, 0.45))):
        r, lost = along * np.array(at_0) + (1 - along) * np.array(at_60)
        energy = t.energy_at(nm)
        assert energy.detected_W == pytest.approx((1 - r - lost) * energy.launched_W, rel=1e-5)
        assert energy.absorbed["lost"][0] == pytest.approx(lost * energy.launched_W, rel=1e-5)
        assert energy.escaped_W == pytest.approx(r * energy.launched_W, rel=1e-5)
    assert abs(t.energy.closure) < 1e-6

"""Shipped scenes are what their prescriptions give; dictionary and XML file of a prescription hold the same scene."""

import importlib
import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles import beams, nonsequential, scene_xml
from refusals import each_refused

import mistray
from mistray import Coating, Detector, Prescription, Scatter, Source, Structure, Surface, thermal
from mistray.physics.sags.terms import sag
from mistray.prescription import Stop, from_zemax, read_zemax, wall
from mistray.prescription.scene_file import xml_text
from mistray.prescription.sequential.rays import trace
from mistray.scatter.abg import ABg
from mistray.scatter.kinds import OWN_KINDS

SCENES = Path(__file__).parents[2] / "scenes"
RAYS = 4000


def build(name):
    return importlib.import_module(f"mistray.scenes.{name}.prescription").build()


@pytest.mark.parametrize("name", sorted(file.parent.name for file in SCENES.glob("*/prescription.py")))
def test_xml_is_what_the_prescription_gives(name):
    assert (SCENES / name / "scene.xml").read_text(encoding="utf-8") == xml_text(build(name))


def test_lenses_are_the_published_ones():
    """The Cooke triplet, the double Gauss at F/4; in focus, and so is the singlet."""
    triplet, lens, singlet = map(build, ("cooke_triplet", "double_gauss", "singlet_window_detector"))
    first, system, last = (each.paraxial(587.5618) for each in (triplet, lens, singlet))
    assert (first.efl, first.bfl) == pytest.approx((50.0, 41.2365), abs=2e-3)
    assert system.efl == pytest.approx(50.0, rel=0.01)
    assert system.z[-1] + system.bfl == pytest.approx(lens.detector.z, abs=1e-3)
    at_stop = system.trace(1.0, 0.0)[4]
    stop_height = at_stop[0] + at_stop[1] * (lens.stop.z_front - system.z[4])
    assert system.efl / (2 * lens.stop.radius / stop_height) == pytest.approx(4.0, rel=1e-3)
    assert last.z[-1] + last.bfl == pytest.approx(singlet.detector.z, rel=1e-13)


def in_air(name, rays, field_deg, **limits):
    """The float64 oracle's ledger of a beam through a scene file."""
    model = scene_xml.read_scene(SCENES / name / "scene.xml")
    emitter = model.emitters[0]
    beam = beams.collimated(emitter, rays, beams.start_distance(model, emitter), field_deg)
    nm = float(emitter.values["wavelength_nm"])
    return beam, nonsequential.trace(model, beam.origin, beam.direction, beam.power, nm, **limits)


@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "phone_camera", "singlet_window_detector"])
@pytest.mark.parametrize("field_deg", [0.0, 15.0])
def test_light_leaves_through_the_front_only(name, field_deg):
    """By the last surface touched; everything else is absorbed."""
    _, ledger = in_air(name, 1000, field_deg, max_events=20, flux_threshold=1e-5)
    assert not ledger.leaks_W
    front = "window_front" if name == "phone_camera" else "L1_front"
    assert {key for key, power in ledger.escaped_from_W.items() if power} <= {front, "source"}


def test_scenes_image_as_they_should():
    _, ledger = in_air("newtonian", RAYS, 0.1, flux_threshold=1e-6)
    image = ledger.paths[0]
    assert image.text == "primary:R diagonal:R image:A"
    focal_length, coma = 1270.0, 3 * math.radians(0.1) / (16 * (1270.0 / 190.5) ** 2) * 1270.0
    assert abs(image.y_mm) == pytest.approx(focal_length * math.tan(math.radians(0.1)), abs=coma)
    assert image.rms_radius_mm < 0.02
    # the beam less the shadows of the diagonal and of the eyepiece tube, two mirrors of 92 %
    diagonal = build("newtonian").surfaces[1]
    tube, primary, tube_end, tube_width = 101.6, 95.25, 76.2, 25.4
    height = 2 * diagonal.half_height / math.sqrt(2) + 3 / math.sqrt(2)  # the back is 3 mm behind, at 45 degrees
    shadow = 2 * diagonal.half_width * height + tube_width * (primary - tube_end)
    passing = (primary**2 - shadow / math.pi) / tube**2
    standard_error = math.sqrt(passing * (1 - passing) / RAYS)
    assert image.power_W / ledger.launched_W == pytest.approx(0.92**2 * passing, abs=standard_error)
    beam, ledger = in_air("lens_and_reflector", 4000, 0.0)
    direct = ledger.find("lens_front:T", "lens_rear:T", "reflector:R", "target:A")
    ghost = ledger.find("lens_front:T", "lens_rear:R", "lens_front:R", "lens_rear:T", "reflector:R", "target:A")
    assert direct.power_W / direct.rays / beam.power[0] == pytest.approx(20.7347613517402 / 26, rel=3e-3)
    per_ray = (ghost.power_W / ghost.rays) / (direct.power_W / direct.rays)
    assert per_ray == pytest.approx((0.00286680426298308 / 2) / (20.7347613517402 / 26), rel=1e-2)
    # Its polynomials against the root of the equation of equal paths, and what they make of the light of the sun
    from mistray.scenes.head_up_display.prescription import FOCUS_MM, INCIDENCE_DEG, MIRROR_HALF, coefficients

    c, s = math.cos(math.radians(INCIDENCE_DEG)), math.sin(math.radians(INCIDENCE_DEG))
    x, y = np.meshgrid(*(np.linspace(-half, half, 23) for half in MIRROR_HALF))
    b, constant = 4 * FOCUS_MM * c - 2 * s * c * y, x * x + c * c * y * y
    exact = -2 * constant / (b + np.sqrt(b * b - 4 * s * s * constant))
    assert sag(x, y, coefficients()) == pytest.approx(exact, abs=1e-5)  # terms of order 7 are 8e-6 mm at the corners
    display = build("head_up_display")
    mirror, detector = display.surfaces[2], display.detector
    away = FOCUS_MM / math.hypot(detector.y, detector.z)
    at_focus = replace(detector, y=away * detector.y, z=away * detector.z)
    bare = replace(display, surfaces=(mirror,), structures=(), detector=at_focus)
    spot = max(mistray.trace(bare.to_scene(), rays=20_000, seed=1).paths, key=lambda row: row.power_W)
    assert max(spot.rms_radius_mm, math.hypot(spot.x_mm, spot.y_mm)) < 5e-4


@pytest.mark.parametrize("field_mm", [0.0, -8.0, 8.0])
def test_the_offner_relay_images_as_two_concentric_spheres_do(field_mm):
    """
    Each ray, without the window, against the closed form of mirrors about one centre.

    A reflection keeps the distance p = h cos a of a ray from the centre, h the height of the object and a the angle of
    the ray out of the plane through the centre across h. So the whole relay only turns it, by half a turn and
    2 asin(p/R2) - 4 asin(p/R1), in the plane of the ray and the centre. The line through object and centre lies in that
    plane, and the ray comes back to it p/cos(a - turn) from the centre.
    """
    from mistray.scenes.offner_relay.prescription import HEIGHT, PRIMARY_RADIUS, SECONDARY_RADIUS

    relay = build("offner_relay")
    structures = tuple(one for one in relay.structures if one.part != "window")
    bare = replace(relay, surfaces=relay.surfaces[:2], structures=structures, detector=replace(relay.detector, z=0.0))
    t = mistray.trace(bare.to_scene(), rays=2000, field_mm=field_mm, seed=3)
    direct = next(row for row in t.paths if row.kind == "direct")
    assert direct.event_list[:3] == [("primary", "SpecRefl"), ("secondary", "SpecRefl"), ("primary", "SpecRefl")]
    h = HEIGHT + field_mm
    heights = []
    for start, first, *_, end in t.history(direct.path_id, 100).rays:
        assert start == pytest.approx((0.0, h, 0.0), abs=1e-6)
        along = (first - start) / np.linalg.norm(first - start)
        angle = math.asin(along[1])
        p = h * math.cos(angle)
        turn = 2 * math.asin(p / SECONDARY_RADIUS) - 4 * math.asin(p / PRIMARY_RADIUS)
        heights.append(-p / math.cos(angle - turn))
        assert end == pytest.approx((0.0, heights[-1], 0.0), abs=1e-8)
    assert np.std(heights) < (5e-4 if field_mm == 0 else 2e-2)


DETECTOR_MM, STOP_MM, PIXEL_CORNER = 20.0, 5.0, (4.8, 3.84)
LENS = Path(__file__).parents[2] / "examples" / "lwir_camera.zmx"


def test_the_spot_on_axis_is_small_at_all_wavelengths_together():
    """By the float64 rays of the table; wider than the pupil, so that the stop limits the light."""
    lens, table = from_zemax(LENS), read_zemax(LENS)
    assert lens.detector.z - lens.stop.z_front == pytest.approx(DETECTOR_MM)
    assert (lens.stop.radius, lens.detector.half_width, lens.detector.half_height) == (STOP_MM, *PIXEL_CORNER)
    r, angle = np.meshgrid(14.8 * np.sqrt((np.arange(12) + 0.5) / 12), np.linspace(0, 2 * np.pi, 16, endpoint=False))
    start = np.column_stack([(r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel(), np.full(r.size, -10.0)])
    stop = next(number for number, row in enumerate(table.rows) if row.stop)
    spots = []
    for wavelength_nm in (8000.0, 10000.0, 12000.0):
        hits, _ = trace(table, start, np.tile([0.0, 0.0, 1.0], (len(start), 1)), wavelength_nm)
        passed = np.hypot(*hits[stop, :, :2].T) <= STOP_MM
        assert 0.8 < passed.mean() < 1
        spots.append(hits[-1, passed, :2])
    assert np.sqrt((np.concatenate(spots) ** 2).sum(axis=1).mean()) < 0.005  # asked for: 20 µm


def test_the_detector_sees_the_cold_shield_and_the_scene_alone():
    """Without reflections no ray ends at a warm wall; shares by geometry, 4 standard errors: false alarm 6e-5."""
    lens = from_zemax(LENS)
    warm = [structure.name for structure in lens.structures if not structure.name.startswith(("barrel_4", "board"))]
    settings = {"rays": 30_000, "max_reflections": 0, "max_scatters": 0}
    report = thermal(lens.to_scene(), 293.0, wavelengths_um=8.0, band_um=(8.0, 8.01), **settings)
    assert "barrel_2_wall" in warm
    hits = {emitter.name: emitter.hits for emitter in report.emitters}
    assert sum(hits.get(name, 0) for name in warm) == 0 < 1000 < hits["stop_front"]
    rng, n = np.random.default_rng(4), 100_000
    x, y = rng.uniform(-1, 1, (2, n)) * np.array(PIXEL_CORNER)[:, None]
    r, a = STOP_MM * np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    square = (r * np.cos(a) - x) ** 2 + (r * np.sin(a) - y) ** 2 + DETECTOR_MM**2
    open_share = float(np.mean(DETECTOR_MM**2 / square**2) * STOP_MM**2)
    seen = {e.name: e.share for e in report.emitters}
    assert abs(seen["window_rear"].value - open_share) < 4 * seen["window_rear"].se < 0.1 * open_share
    shield = seen["stop_front"].value + sum(seen[name].value for name in seen if name.startswith(("barrel_4", "board")))
    assert shield + open_share == pytest.approx(1, abs=5 * seen["window_rear"].se)


SAMPLE = str(Path(__file__).parents[1] / "data" / "coating_sample.dat")
LAYERS = {"layers": "1.38 99.6, 2.1 0.5w", "design_nm": 1 / 2e-3, "n_shift": (0.01, 0.0), "k_shift": (0.0, 1e-3)}
AR = Coating(**LAYERS, name="ar")
ABG = Scatter("abg", {"A": 1e-5, "B": 1 / 3e5, "g": 2.0, "event": "reflection"})
POLISH = Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish")
BLACK = Scatter("paint", {"preset": "flat_black"})
DIRT = Scatter("particulate", {"level": 300.0}, name="dirt")
K_CORRELATION = Scatter("k_correlation", {"rms_nm": 1.0, "B_um": 10.0, "slope": 1.8, "band_limited": True})
SYSTEM = Prescription(
    name="all <parameters> -- & more",
    provenance="first line\nsecond -- line\n--- third ----",
    surfaces=(
        Surface("L1_front", z=0.1, radius=1.679, conic=0.22669364, coefficients=(0.00980281, 0.0, -0.0239681),
                semi_diameter=1.2, inner_semi_diameter=0.1, back="nd=1.544 Vd=56.1 k=0",
                coating=Coating(R=0.02, T=0.98), part="L1", space=3),
        Surface("fold", x=1e-7, y=-2.0, z=1 / 3, tilt_deg=(45.0, 0.5, -90.0), half_width=1.0, half_height=2.0,
                coating=Coating(R=1.0), mirror=True),
        Surface("bare", z=2.0, semi_diameter=1.0, front="nd=1.544 Vd=56.1 k=0", back="1.7"),
        Surface("layered", z=3.5, semi_diameter=1.0, front="1.7", coating=Coating(**LAYERS, first="back")),
        Surface("preset", z=3.7, semi_diameter=1.0, coating=Coating(preset="protected_al"), mirror=True),
        Surface("shared_1", z=4.0, semi_diameter=1.0, back="1.5", coating=AR),
        Surface("shared_2", z=4.5, semi_diameter=1.0, front="1.5", coating=AR),
        Surface("zemax", z=4.8, semi_diameter=1.0, coating=Coating(table=f"{SAMPLE}:AR")),
        Surface("split", z=5.0, semi_diameter=1.0, coating=Coating(R=0.1, T=0.8, name="split_coating")),
        Surface("scattering", z=5.3, semi_diameter=1.0, coating=Coating(preset="bbar3"),
                scatter=(ABG, K_CORRELATION, POLISH, DIRT)),
    ),
    structures=(Structure("edge", 1.0, 2.0, 1.0, 3.0, front="1.7", y=0.5, tilt_deg=(90.0, 0.0, 0.0), space=0),),
    stop=Stop(0.5, -0.2, -0.1, 1.5, 1.6, coating=Coating(R=0.07), scatter=(BLACK,)),
    detector=Detector(z=5.7, half_width=2.0, half_height=1.5, coating=Coating(R=0.2), pixels=(40, 30)),
    source=Source(y=0.1, tilt_deg=(0.0, 180.0, 0.0), radius=1.252, inner_radius=0.3, field_deg=10.0, azimuth_deg=30.0,
                  plane="axis", distance=12.0, irradiance=2.0, wavelength_nm=(486.1, 587.6), weights=(1.0, 2.0),
                  pattern="grid"),
)  # fmt: skip


def test_dictionary_and_file_load_to_the_same_scene(tmp_path):
    SYSTEM.to_xml(tmp_path / "scene.xml")
    first, second = scenes = [SYSTEM.to_scene(), mistray.load(tmp_path / "scene.xml")]
    assert [shape.id() for shape in first.shapes()] == [shape.id() for shape in second.shapes()]
    a, b = mi.traverse(first), mi.traverse(second)
    assert list(a.keys()) == list(b.keys())
    for key in list(a.keys()):
        np.testing.assert_array_equal(np.array(a[key]), np.array(b[key]), err_msg=key)
    for one, other in zip(first.shapes(), second.shapes(), strict=True):
        assert str(one.bsdf()) == str(other.bsdf())
        assert [(one.part, one.space), str(one)] == [(other.part, other.space), str(other)]
    assert [str(emitter) for emitter in first.emitters()] == [str(emitter) for emitter in second.emitters()]
    for scene in scenes:
        shapes = {shape.id(): shape for shape in scene.shapes()}
        coatings = {name: shape.bsdf().coating for name, shape in shapes.items()}
        assert coatings["shared_1"] is coatings["shared_2"]
        assert coatings["shared_1"].indices(500.0) == pytest.approx((1.39, 2.1 + 1e-3j), rel=1e-7)
        assert coatings["layered"].first == "back"
        assert (shapes["L1_front"].part, shapes["L1_front"].space) == ("L1", 3)
        kinds = [type(model).__name__ for model in shapes["scattering"].bsdf().scatter]
        assert kinds == ["ABg", "KCorrelation", "HarveyShack", "Particulate"]
        assert [name for name in shapes if name.startswith("stop")] == ["stop_front", "stop_wall", "stop_rear"]
        films = {key.rpartition(".")[0] for key in dict(mi.traverse(scene)) if key.endswith("thickness_nm")}
        assert films == {"ar", *(f"{name}.bsdf.coating" for name in ("layered", "preset", "scattering", "zemax"))}


def test_file_is_readable_and_the_same_each_time(tmp_path):
    """Numbers survive to the last bit; where nothing can be written no file is left."""
    path, wrong = tmp_path / "scene.xml", SYSTEM.with_source(field_deg=float("nan"))
    missing = tmp_path / "missing" / "a.xml"
    each_refused((SYSTEM, missing, "check the folder"), (wrong, path, "nan"), by=Prescription.to_xml)
    assert not list(tmp_path.iterdir())
    SYSTEM.to_xml(path)
    first = path.read_bytes()
    SYSTEM.to_xml(path)
    assert path.read_bytes() == first
    assert [file.name for file in tmp_path.iterdir()] == ["scene.xml"]
    root = ElementTree.fromstring(first)
    assert root.get("version") == "3.0.0"
    assert float(root.find("./shape[@id='fold']/transform/translate").get("z")) == 1 / 3
    sections = [f"<!-- {name} -->" for name in ("Optical surfaces", "Structure", "Detector")]
    for comment in ("second - - line", "- - - third - - - -", *sections):
        assert comment in first.decode()


DUST = Scatter("particulate", {"level": 300.0})
GLASS = Coating(R=0.02, T=0.98, name="ar")
SINGLET = Prescription(
    name="lens",
    surfaces=(
        Surface("L_front", semi_diameter=5.0, back="1.5", coating=GLASS),
        Surface("L_rear", z=2.0, semi_diameter=5.0, front="1.5", coating=GLASS),
    ),
    structures=wall("tube", [(5.0, 2.0), (5.0, 8.0), (4.0, 8.0)]),
    stop=Stop(2.0, 9.0, 9.1, 4.0, 4.0, coating=Coating(R=0.05)),
    detector=Detector(z=10.0, half_width=2.0, half_height=2.0),
    source=Source(radius=2.0),
)
EXAMPLES = vectors.toml("scatter_examples.toml")


def test_bad_models() -> None:
    rougher = replace(POLISH, properties={"rms_nm": 5.0})
    silver = {"rms_nm": 2.0, "B_um": 100.0, "slope": 3.0, "substrate": "silver"}
    each_refused(
        ("harvey", "scatter 'harvey': there is no such model; use abg, "),
        ("harvey_shack", {"rms": 4.0}, "scatter 'harvey_shack': there is no 'rms'; did you mean 'rms_nm'"),
        ("abg", {"A": 1.0, "B": 1.0}, "ABg: g is missing"),
        ("abg", {"A": [1.0], "B": 1.0, "g": 2.0}, r"scatter 'abg': A = \[1.0\]; give a number, a text or a boolean"),
        ("k_correlation", silver, "scatter 'k_correlation': substrate is 'silver'"),
        ("paint", {"preset": "flat_black"}, "a.b", "shape 'a.b': a name must not"),
        by=lambda kind, properties=None, name=None: Scatter(kind, properties or {}, name=name),
    )
    each_refused(
        ({"M_*": (POLISH,)}, r"prescription 'lens': no shape is called 'M_\*'"),
        ({"stop_wall": (BLACK,)}, "matches some faces of stop 'stop'"),
        ({"L_front": (POLISH,), "L_rear": (rougher,)}, "two different scatter models are called 'polish'"),
        ({"L_front": (replace(POLISH, name="L_rear"),)}, "a shape and a scatter model are called 'L_rear'"),
        ({"L_front": (replace(POLISH, name="ar"),)}, "a coating and a scatter model are called 'ar'"),
        by=SINGLET.with_scatter,
    )


def test_scatter_by_name() -> None:
    """Every plugin can be written; patterns add up, in their order, to what a shape has."""
    assert EXAMPLES.keys() == OWN_KINDS.keys()
    for kind, properties in EXAMPLES.items():
        model = Scatter(kind, properties).model()
        assert model is None if "file" in properties else isinstance(model, OWN_KINDS[kind])
    result = SINGLET.with_scatter({"L_*": (POLISH,), "L_rear": (DUST,), "tube_?": (BLACK,)})
    found = {shape.name: shape.scatter for shape in result.with_scatter({"stop_*": (BLACK, DUST)}).shapes()}
    stop = dict.fromkeys(("stop_front", "stop_wall", "stop_rear"), (BLACK, DUST))
    tube = dict.fromkeys(("tube_1", "tube_2"), (BLACK,))
    assert found == {"L_front": (POLISH,), "L_rear": (POLISH, DUST), **tube, **stop, "detector": ()}
    assert result.shared_scatter() == {"polish": POLISH}
    assert not any(shape.scatter for shape in SINGLET.shapes())


def test_the_scene_has_the_models(tmp_path) -> None:
    """From the dictionary and from the file; a named model is one object with one key."""
    abg = Scatter("abg", {"A": 0.0009765625, "B": 0.0078125, "g": 2.0, "side": "back"})  # exact in float32
    scattering = SINGLET.with_scatter({"L_*": (POLISH, DUST), "L_rear": (abg,), "tube_*": (BLACK,)})
    scattering.to_xml(tmp_path / "scene.xml")
    for scene in (scattering.to_scene(), mistray.load(tmp_path / "scene.xml")):
        scatter = {shape.id(): shape.bsdf().scatter for shape in scene.shapes()}
        assert [type(model) for model in scatter["L_rear"]] == [OWN_KINDS[model.kind] for model in (POLISH, DUST, abg)]
        assert replace(scatter["L_rear"][2], name="") == ABg(0.0009765625, 0.0078125, 2.0, side="back")
        assert scatter["L_front"][0] == scatter["L_rear"][0]
        assert [model.reflectance for model in scatter["tube_2"]] == pytest.approx([0.045])
        assert scatter["stop_wall"] == ()
        assert [key for key in dict(mi.traverse(scene)) if "rms_nm" in key] == ["polish.rms_nm"]

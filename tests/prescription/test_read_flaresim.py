"""Lens files of FlareSim and prescriptions in JSON: what is read, what is assumed, and what is refused by name."""

import json
import math
import re
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles import nonsequential, scene_xml
from oracles.small_scenes import write
from refusals import each_refused, refused

import mistray
from mistray.prescription import Coating, Scatter, Structure, from_flaresim, from_json, read_flaresim, to_prescription
from mistray.prescription.scene_file import xml_text
from mistray.prescription.sequential.rays import trace

DATA = Path(__file__).parents[1] / "data" / "lenses" / "flaresim"
# By the maker of a thick biconvex lens: 1/f = (n-1)(2/R - (n-1) t / (n R²)), its stop 1 mm behind
SINGLET = vectors.text("flaresim_singlet.txt")


def rows_of(path: Path) -> list[list[float]]:
    """The columns of a file; a stop is a plane of radius 0."""
    text = path.read_text(encoding="utf-8").partition("surfaces:")[2]
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    return [[float(word) if word != "stop" else 0.0 for word in words] for words in lines if words]


def heights(rows: list[list[float]]) -> tuple[list[float], float]:
    """Of a paraxial ray that is parallel to the axis at height 1, at each surface, and its last angle."""
    found, angle, index = [1.0], 0.0, 1.0  # angle times index
    for radius, thickness, after, *_ in rows:
        angle -= found[-1] * (after - index) / radius if radius else 0.0
        index = after
        found.append(found[-1] + thickness * angle / index)
    return found[:-1], angle


def focus(rows: list[list[float]]) -> tuple[float, float]:
    """Focal length and distance from the last surface to the focus."""
    height, angle = heights(rows)
    return 1 / -angle, height[-1] / -angle


def test_a_lens_with_its_focal_length_and_f_number():
    nikkor, rows = read_flaresim(DATA / "nikkor_28mm.lens"), rows_of(DATA / "nikkor_28mm.lens")
    efl, back = focus(rows)
    assert efl == pytest.approx(28.61, rel=2e-4)  # as the file says
    lens = to_prescription(nikkor)
    assert [surface.name for surface in lens.surfaces][:3] == ["S1", "S2", "S3"]
    assert lens.stop.radius == pytest.approx(13.83 / 2)
    # F/2.8 with the column as full diameters, F/1.4 as semi-diameters
    assert efl / (2 * math.sqrt(lens.source.pupil_area / math.pi)) == pytest.approx(2.8, rel=0.01)
    assert any("full diameters" in note and "F/2.9" in note for note in nikkor.notes)
    # Spherical aberration moves the focus, by less than the 2 % from which on it is noted as missing aspheres
    assert nikkor.rows[-2].thickness == pytest.approx(back, abs=0.02 * efl)
    assert "US005917663" in nikkor.source
    # The lens is made for film of 24 mm by 36 mm, whose corner is 21.6 mm from the axis
    lens = from_flaresim(DATA / "nikkor_28mm.lens")
    assert 0.9 < lens.detector.half_width / 21.6 < 1.25
    # Faces with glass behind are coated in this file; what lies in cement, or says 0, is bare
    presets = {surface.name: surface.coating and surface.coating.preset for surface in lens.surfaces}
    assert (presets["S1"], presets["S2"]) == ("mgf2_quarter_wave", None)
    cement = [f"S{k + 1}" for k in range(1, len(rows)) if rows[k][2] > 1 and rows[k - 1][2] > 1]
    assert all(presets[name] is None for name in cement)
    # The mean square distance of rays of the beam is least: a plane 20 µm before or behind has more
    height = np.linspace(0.05, 1, 200) * 13.83 / 2 * 0.7
    start = np.column_stack([0 * height, height, np.full(200, -5.0)])
    hits, along = trace(nikkor, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    inside = np.abs(hits[10, :, 1]) < 13.83 / 2  # the stop
    y, slope = hits[-1, inside, 1], along[-1, inside, 1] / along[-1, inside, 2]
    before, here, behind = (np.sum(height[inside] * (y + z * slope) ** 2) for z in (-0.02, 0.0, 0.02))
    assert here < min(before, behind)


def test_a_lens_without_a_stop():
    lens = read_flaresim(DATA / "no_stop_20mm.lens")
    # The row that the marginal ray fills most: heights of a paraxial ray over the sizes of the column
    rows = rows_of(DATA / "no_stop_20mm.lens")
    filled = [abs(height) / row[4] for height, row in zip(heights(rows)[0], rows, strict=True)]
    place = filled.index(max(filled))
    assert [k for k, row in enumerate(lens.rows) if row.stop] == [place]
    assert any(f"surface {place + 1} is it" in note for note in lens.notes)
    lens = read_flaresim(path := DATA / "without_its_aspheres.lens")
    assert lens.rows[-2].thickness == pytest.approx(focus(rows_of(path))[1], rel=1e-6)
    assert any("paraxial focus" in note for note in lens.notes)


def test_semi_diameters_by_the_f_number_and_cement(tmp_path):
    """f = 49.2 mm: a stop of 4.9 mm is F/5 as a semi-diameter, one of 9.8 mm as a diameter."""
    for stop, size, kind in ((4.7, 8, "semi-diameters"), (9.4, 16, "full diameters")):
        lens = read_flaresim(write(tmp_path, SINGLET.format(stop=stop, size=size), "own.lens"))
        assert any(kind in note for note in lens.notes), lens.notes
        assert (lens.aperture, lens.rows[0].semi_diameter) == pytest.approx((9.4, 8))
    head = SINGLET.partition("50.0   5.0")[0]
    apart = "50 5 1.6031101 60 16 1\n-60 0 1 0 16 0\n-60 3 1.7 30 16 1\n-300 1 1 0 16 0\nstop 70 1 0 9.4 0\n"
    joined = "50 5 1.6031101 60 16 1\n-60 3 1.7 30 16 1\n-300 1 1 0 16 0\nstop 70 1 0 9.4 0\n"
    lenses = [read_flaresim(write(tmp_path, head + rows, "own.lens")) for rows in (apart, joined)]
    assert any("2 and 3" in note for note in lenses[0].notes)
    both = [[(row.radius, row.material, row.thickness, row.coating) for row in lens.rows] for lens in lenses]
    assert both[0] == both[1]
    assert both[0][0][1] == "nd=1.6031101 Vd=60.0 k=0"
    within = "50 5 1.6 60 16 1\n-60 0 1 0 16 0\nstop 0 1 0 1e6 0\n-60 3 1.7 30 14 1\n-300 71 1 0 16 0\n"
    lens = read_flaresim(write(tmp_path, head + within, "own.lens"))
    assert [(row.number, row.stop) for row in lens.rows] == [(1, False), (2, True), (5, False), (6, False)]
    assert lens.aperture == 14


def test_what_cannot_be_read_is_named(tmp_path):
    for old, new, message in vectors.toml("refusals.toml")["files of FlareSim"]:
        text = SINGLET.replace(old, new).format(size=16, stop=9.4)
        path = write(tmp_path, text, "own.lens") if old else DATA / "converter.lens"
        with refused(re.escape(message), path.name):
            read_flaresim(path)


@pytest.mark.parametrize("name", ["nikkor_28mm", "no_stop_20mm", "without_its_aspheres"])
def test_the_light_that_passes_the_stop_arrives(name):
    """95 % of it, less what bare and coated faces reflect: 4 % and 1.5 % each at most; and there are ghosts."""
    prescription = from_flaresim(DATA / f"{name}.lens")
    scene = prescription.to_scene()
    faces = sum(surface.front == "air" or surface.back == "air" for surface in prescription.surfaces)
    t = mistray.trace(scene, rays=4000, max_reflections=0)
    assert t.energy.detected_W / t.pupil_W > 0.95 * (1 - 0.08) ** faces
    assert len(mistray.ghosts(scene, rays=2000)[0].paths) > 3


FILE = Path(__file__).parents[2] / "scenes" / "phone_camera" / "prescription.json"
PARSED = json.loads(FILE.read_text())
POLISH = {"kind": "harvey_shack", "rms_nm": 4.0, "name": "polish", "shapes": ["L*_front", "window_rear"]}


@pytest.fixture(scope="module")
def camera():
    return from_json(FILE)


def test_focal_length_at_two_wavelengths(camera):
    """EFL at the d line from the report's indices; at 550 nm it rests on the dispersion model."""
    checks = PARSED["checks"]
    for wavelength_nm, key in [(587.5618, "performance_R13_5p727_d"), (550.0, "performance_R13_5p727_550nm")]:
        system = camera.paraxial(wavelength_nm)
        assert system.efl == pytest.approx(checks[key]["EFL"], abs=6e-6)
        defocus = system.z[-1] + system.bfl - camera.detector.z
        assert defocus == pytest.approx(checks[key]["paraxial_defocus_mm"], abs=6e-6)
    other = from_json(FILE, variant="R13=5.272")
    assert other.paraxial(587.5618).efl == pytest.approx(PARSED["variants"]["R13=5.272"]["EFL"], abs=6e-6)


def test_surfaces(camera):
    parts = ["window", "L1", "L2", "L3", "L4", "L5", "filter"]
    assert [s.name for s in camera.surfaces] == [f"{part}_{face}" for part in parts for face in ("front", "rear")]
    rows = [row for row in PARSED["surfaces"] if row["medium_after"] != "AIR" or "rear" in row["name"]]
    for surface, row in zip(camera.surfaces, rows, strict=True):
        assert (surface.z, surface.radius) == (row["z"], row["radius"] or 0)
        assert surface.semi_diameter == row["semi_diameter"]
        assert surface.rim[1] == pytest.approx(row.get("edge_z", row["z"]), abs=6e-7)
    assert {(s.part.startswith("L"), s.coating.R) for s in camera.surfaces} == {(False, 0.01), (True, 0.02)}
    filling, power = from_json(FILE, beam="exact").source, PARSED["sources"]["stray_light"]["power_W"]
    assert (np.pi * filling.radius**2, camera.source.pupil_area) == pytest.approx((power, power), rel=1e-9)
    assert camera.source.radius == pytest.approx(1.05 * filling.radius)
    assert (camera.source.wavelength_nm, camera.source.x, camera.source.y, camera.source.z) == ((550.0,), 0, 0, 0)
    wall = next(face for face in camera.stop.faces() if face.name == "stop_wall")
    assert (wall.r0, wall.z0, wall.r1, wall.z1) == (1.25171162, -0.075, 1.25171162, 0.0)
    assert (camera.detector.coating.R, camera.detector.coating.opaque) == (0.2, True)
    assert 2 * camera.detector.half_width == pytest.approx(PARSED["detector"]["width"], abs=1e-8)


def test_every_barrel_piece_is_there_once(camera):
    pieces = Counter(row_space for row_space, rows in PARSED["barrel"]["optical_spaces"].items() for _ in rows)
    # three faces of the stop are made from aperture_stop, and the board is a frame of four around the detector
    pieces["1"] -= 3
    pieces["7"] += 3
    assert pieces == Counter(str(s.space) for s in camera.structures if s.part in ("barrel", "board"))
    for a, b in combinations([s for s in camera.shapes() if isinstance(s, Structure) and s.z0 == s.z1], 2):
        if a.z0 == b.z0:
            overlap = min(max(a.r0, a.r1), max(b.r0, b.r1)) - max(min(a.r0, a.r1), min(b.r0, b.r1))
            assert overlap <= 0, (a.name, b.name)
    faces = {s.name: s for s in camera.structures}
    for body in PARSED["lens_bodies"]:
        for number in (1, 2):
            visible = body.get(f"visible_bevel_{number}")
            if not visible or (body["name"], number) == ("L1", 1):  # the barrel's lip covers this one
                continue
            ring, flange = (faces[f"{body['name']}_{kind}_{number}"] for kind in ("bevel", "flange"))
            assert sorted((ring.r0, ring.r1)) == pytest.approx(visible)
            assert (ring.coating.T, flange.coating.R, flange.coating.opaque) == (0.98, 0.07, True)
    assert "L1_bevel_1" not in faces
    assert faces["barrel_1_L1_seat_lip"].back == camera.surfaces[2].back


RAYS = 4000


@pytest.mark.parametrize("variant", [None, "R13=5.272"])
@pytest.mark.parametrize("cell", range(14))
def test_every_cell_is_closed(cell, variant):
    """From inside a cell every ray meets a face whose near side holds the cell's own medium."""
    lens = from_json(FILE, variant=variant)
    model = scene_xml.parse_scene(xml_text(lens), FILE)
    first, second = [*lens.surfaces, lens.detector][cell : cell + 2]
    z, material = (first.z + second.z) / 2, first.back
    assert material == (first.back if cell % 2 else second.front)
    rng = np.random.default_rng(7)
    direction = rng.normal(size=(RAYS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.tile([0.0, 0.0, z], (RAYS, 1))
    # one flight takes the rays to the boundary, a second one, from there and in any direction, back into the cell
    last = np.full(RAYS, -1)
    for _ in range(4):
        t, hit = nonsequential.nearest_hits(model, origin, direction, last)
        assert np.all(hit >= 0)
        origin = origin + t[:, None] * direction
        for number in np.unique(hit):
            here, shape = hit == number, model.shapes[number]
            normal = shape.normal(origin[here])
            from_front = np.einsum("ij,ij->i", normal, direction[here]) > 0
            assert set(np.where(from_front, shape.interface.front, shape.interface.back)) == {material}, shape.shape_id
            inward = np.where(from_front[:, None], -normal, normal)
            fresh = rng.normal(size=inward.shape)
            fresh /= np.linalg.norm(fresh, axis=1, keepdims=True)
            direction[here] = fresh - 2 * np.minimum(np.sum(fresh * inward, axis=1, keepdims=True), 0) * inward
        last = hit


def changed(tmp_path, change):
    data = json.loads(FILE.read_text())
    change(data)
    return write(tmp_path, json.dumps(data), "lens.json")


def test_bad_files(tmp_path):
    words = "variant 'x' changes 'S13'; name surface and quantity, as in S13.radius"
    each_refused(
        (lambda d: d.pop("coatings"), "key 'coatings' is missing"),
        (lambda d: d["surfaces"][6].update(semi_diameter=-1.4), "surface 'L1_front': semi_diameter is -1.4; it must"),
        (lambda d: d["surfaces"][6].update(medium_after="GLASS"), "'GLASS'"),
        (lambda d: d["surfaces"][6].update(name="first"), "surface 'first' is not named"),
        (lambda d: d["surfaces"][6].update(z=None), "not 'NoneType'; compare with scenes/phone_camera"),
        (lambda d: d.update(surfaces=5), "'int' object is not iterable; compare with scenes/phone_camera"),
        (lambda d: d["surfaces"][6]["coefficients"].update(A5=1.0), "'S5 L1 front' has a coefficient 'A5'"),
        (lambda d: d["barrel"]["optical_spaces"]["2"][0].update(label="cone"), "barrel piece 'cone'"),
        (lambda d: d["barrel"]["optical_spaces"]["1"].pop(3), r"labelled '\(AS rear\)'"),
        (lambda d: d.update(scatter=[POLISH | {"shapes": ["L9_*"]}]), r"no shape is called 'L9_\*'"),
        (lambda d: None, "R13=5", "variant 'R13=5' is unknown"),
        (lambda d: d["variants"].update(x={"change": {"S13": 5.0}}), "x", words),
        (lambda d: d["variants"].update(x={"change": {"S99.radius": 5}}), "x", "changes 'S99', which is no surface"),
        (lambda d: d["variants"].update(x={"change": {"S13.radios": 5}}), "x", "changes 'S13.radios'"),
        by=lambda change, variant=None: from_json(changed(tmp_path, change), variant=variant),
    )
    each_refused(
        (tmp_path / "none.json", "No such file"),
        (write(tmp_path, "{", "text.json"), "must be a JSON file"),
        (write(tmp_path, "[]", "list.json"), "compare with scenes/phone_camera"),
        by=from_json,
    )


def test_missing_orders_are_0_and_every_piece_of_one_name_is_there(tmp_path):
    piece = PARSED["barrel"]["optical_spaces"]["3"][0]
    middle = {"r": (piece["r1"] + piece["r2"]) / 2, "z": (piece["z1"] + piece["z2"]) / 2}

    def change(data):
        data["surfaces"][6]["coefficients"] = {"A8": -0.015, "A4": -0.02}
        halves = [piece | {f"{key}{end}": value for key, value in middle.items()} for end in (2, 1)]
        data["barrel"]["optical_spaces"]["3"] = halves
        data["materials"]["BK7"] = {"nd": 1.516, "k": 1e-6}  # no Vd

    lens = from_json(changed(tmp_path, change))
    assert next(s for s in lens.surfaces if s.name == "L1_front").coefficients == (-0.02, 0.0, -0.015)
    assert "1.516 k=1e-06" in {surface.back for surface in lens.surfaces}
    first, second = (s for s in lens.structures if s.name in ("barrel_3_cone", "barrel_3_cone_2"))
    assert (first.r1, first.z1) == (second.r0, second.z0) == (middle["r"], middle["z"])


def test_coatings_of_layers(tmp_path):
    layers, shared = {"layers": "MgF2 99.6, 2.1 0.5w", "design_nm": 500.0}, {"preset": "bbar3", "name": "ar"}
    change = {"lenses": layers, "window, IR filter": shared}
    lens = from_json(changed(tmp_path, lambda data: data["coatings"].update(change)))
    coating = {surface.part: surface.coating for surface in lens.surfaces}
    assert (coating["L1"], coating["window"], coating["filter"]) == (Coating(**layers), *2 * [Coating(**shared)])
    dirt = {"kind": "particulate", "level": 300.0, "shapes": ["window_*", "barrel_?_cone"]}
    lens = from_json(changed(tmp_path, lambda data: data.update(scatter=[POLISH, dirt])))
    scatter = {shape.name: shape.scatter for shape in lens.shapes() if shape.scatter}
    particles = Scatter("particulate", {"level": 300.0})
    assert scatter["L3_front"] == (Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish"),)
    assert (scatter["window_rear"], scatter["barrel_4_cone"]) == ((*scatter["L3_front"], particles), (particles,))
    assert "L3_rear" not in scatter

from __future__ import annotations

import json
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from oracles import nonsequential, scene_xml
from refusals import refused

from mistray.prescription import Coating, Scatter, Structure, from_json
from mistray.prescription.scene_file import xml_text

FILE = Path(__file__).parents[2] / "scenes" / "phone_camera" / "prescription.json"
DATA = json.loads(FILE.read_text())
POLISH = {"kind": "harvey_shack", "rms_nm": 4.0, "name": "polish", "shapes": ["L*_front", "window_rear"]}


@pytest.fixture(scope="module")
def camera():
    return from_json(FILE)


def test_focal_length_at_two_wavelengths(camera):
    """EFL at the d line from the report's indices; at 550 nm it rests on the dispersion model."""
    checks = DATA["checks"]
    for wavelength_nm, key in [(587.5618, "performance_R13_5p727_d"), (550.0, "performance_R13_5p727_550nm")]:
        system = camera.paraxial(wavelength_nm)
        assert system.efl == pytest.approx(checks[key]["EFL"], abs=6e-6)
        defocus = system.z[-1] + system.bfl - camera.detector.z
        assert defocus == pytest.approx(checks[key]["paraxial_defocus_mm"], abs=6e-6)
    other = from_json(FILE, variant="R13=5.272")
    assert other.paraxial(587.5618).efl == pytest.approx(DATA["variants"]["R13=5.272"]["EFL"], abs=6e-6)


def test_surfaces(camera):
    names = [s.name for s in camera.surfaces]
    parts = ["window", "L1", "L2", "L3", "L4", "L5", "filter"]
    assert names == [f"{part}_{face}" for part in parts for face in ("front", "rear")]
    rows = [row for row in DATA["surfaces"] if row["medium_after"] != "AIR" or "rear" in row["name"]]
    for surface, row in zip(camera.surfaces, rows, strict=True):
        assert surface.z == row["z"]
        assert surface.radius == (row["radius"] or 0)
        assert surface.semi_diameter == row["semi_diameter"]
        assert surface.rim[1] == pytest.approx(row.get("edge_z", row["z"]), abs=6e-7)
    assert {s.coating.R for s in camera.surfaces if s.part in ("window", "filter")} == {0.01}
    assert {s.coating.R for s in camera.surfaces if s.part.startswith("L")} == {0.02}
    filling = from_json(FILE, beam="exact").source
    assert np.pi * filling.radius**2 == pytest.approx(DATA["sources"]["stray_light"]["power_W"], rel=1e-9)
    assert camera.source.radius == pytest.approx(1.05 * filling.radius)
    assert camera.source.pupil_area == pytest.approx(DATA["sources"]["stray_light"]["power_W"], rel=1e-9)
    assert camera.source.wavelength_nm == (550.0,)
    assert (camera.source.x, camera.source.y, camera.source.z) == (0, 0, 0)
    wall = next(face for face in camera.stop.faces() if face.name == "stop_wall")
    assert (wall.r0, wall.z0, wall.r1, wall.z1) == (1.25171162, -0.075, 1.25171162, 0.0)
    assert camera.detector.coating.R == 0.2
    assert camera.detector.coating.opaque
    assert 2 * camera.detector.half_width == pytest.approx(DATA["detector"]["width"], abs=1e-8)


def test_every_barrel_piece_is_there_once(camera):
    pieces = Counter(row_space for row_space, rows in DATA["barrel"]["optical_spaces"].items() for _ in rows)
    # three faces of the stop are made from aperture_stop, and the board is a frame of four around the detector
    pieces["1"] -= 3
    pieces["7"] += 3
    assert pieces == Counter(str(s.space) for s in camera.structures if s.part in ("barrel", "board"))
    flat = [s for s in camera.shapes() if isinstance(s, Structure) and s.z0 == s.z1]
    for a, b in combinations(flat, 2):
        if a.z0 == b.z0:
            overlap = min(max(a.r0, a.r1), max(b.r0, b.r1)) - max(min(a.r0, a.r1), min(b.r0, b.r1))
            assert overlap <= 0, (a.name, b.name)
    faces = {s.name: s for s in camera.structures}
    for body in DATA["lens_bodies"]:
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


@pytest.mark.long
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
            near = np.where(from_front, shape.interface.front, shape.interface.back)
            assert set(near) == {material}, shape.shape_id
            inward = np.where(from_front[:, None], -normal, normal)
            fresh = rng.normal(size=inward.shape)
            fresh /= np.linalg.norm(fresh, axis=1, keepdims=True)
            away = np.sum(fresh * inward, axis=1, keepdims=True)
            direction[here] = fresh - 2 * np.minimum(away, 0) * inward
        last = hit


def changed(tmp_path, change):
    data = json.loads(FILE.read_text())
    change(data)
    path = tmp_path / "lens.json"
    path.write_text(json.dumps(data))
    return path


def test_bad_files(tmp_path):
    for change, wanted in (
        (lambda d: d.pop("coatings"), "key 'coatings' is missing"),
        (lambda d: d["surfaces"][6].update(semi_diameter=-1.4), "surface 'L1_front': semi_diameter is -1.4; it must"),
        (lambda d: d["surfaces"][6].update(medium_after="GLASS"), "'GLASS'"),
        (lambda d: d["surfaces"][6].update(name="first"), "surface 'first' is not named"),
        (lambda d: d["barrel"]["optical_spaces"]["2"][0].update(label="cone"), "barrel piece 'cone'"),
        (lambda d: d["barrel"]["optical_spaces"]["1"].pop(3), r"labelled '\(AS rear\)'"),
        (lambda d: d.update(scatter=[POLISH | {"shapes": ["L9_*"]}]), r"no shape is called 'L9_\*'"),
    ):
        with refused(wanted):
            from_json(changed(tmp_path, change))
    with refused("variant 'R13=5' is unknown"):
        from_json(FILE, variant="R13=5")
    (tmp_path / "text.json").write_text("{")
    for file, words in (("none.json", "No such file"), ("text.json", "must be a JSON file")):
        with refused(words):
            from_json(tmp_path / file)


def test_coatings_of_layers(tmp_path):
    layers = {"layers": "MgF2 99.6, 2.1 0.5w", "design_nm": 500.0}
    shared = {"preset": "bbar3", "name": "ar"}
    change = {"lenses": layers, "window, IR filter": shared}
    lens = from_json(changed(tmp_path, lambda data: data["coatings"].update(change)))
    by_part = {surface.part: surface.coating for surface in lens.surfaces}
    assert by_part["L1"] == Coating(**layers)
    assert by_part["window"] == by_part["filter"] == Coating(**shared)
    dirt = {"kind": "particulate", "level": 300.0, "shapes": ["window_*", "barrel_?_cone"]}
    lens = from_json(changed(tmp_path, lambda data: data.update(scatter=[POLISH, dirt])))
    scatter = {shape.name: shape.scatter for shape in lens.shapes() if shape.scatter}
    particles = Scatter("particulate", {"level": 300.0})
    assert scatter["L3_front"] == (Scatter("harvey_shack", {"rms_nm": 4.0}, name="polish"),)
    assert scatter["window_rear"] == (*scatter["L3_front"], particles)
    assert scatter["barrel_4_cone"] == (particles,)
    assert "L3_rear" not in scatter

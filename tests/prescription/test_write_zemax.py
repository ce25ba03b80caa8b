import math
from dataclasses import replace

import exported_lenses
import json_units
import numpy as np
import peers
import pytest
import vectors
from command_line import fails, run
from refusals import each_refused, refused

from mistray.io import read_zemax, to_sequential, write_zemax
from mistray.physics.geometry.outline import ALL, Outline, OutlineFigure, circle, rectangle
from mistray.physics.sags.terms import sag
from mistray.prescription import Coating, Detector, ObjectPoint, Prescription, Source, Stop, Surface
from mistray.prescription.sequential.first_order import first_order
from mistray.prescription.sequential.rays import frames, to_world, trace
from mistray.prescription.sequential.table import Decentre, Row, Sequential

pytestmark = pytest.mark.quick

# Type of a file, and what a row of it may have beside a conic
FREEFORMS = {
    "ODDASPHE": {"sag": {"r1": 1e-3, "r3": -2e-5}, "coefficients": (1e-6,)},
    "XASPHERE": {"coefficients": (1e-6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-20)},
    "TOROIDAL": {"sag": {"toroid_curvature": 0.01, "a2": 1e-3}, "coefficients": (1e-6,)},
    "BICONICX": {"sag": {"curvature_x": -0.02, "conic_x": 0.3}},
    "SZERNSAG": {"sag": {"zernike_1": 0.1, "zernike_22": 0.01, "zernike_radius": 7.0}, "coefficients": (1e-6,)},
    "FZERNSAG": {"sag": {"fringe_37": 0.01, "fringe_radius": 7.0}},
    "XPOLYNOM": {"sag": {"xy_1_0": 0.1, "xy_2_3": 1e-5, "xy_0_2": 1e-3}},
    "QED_TYPE": {"sag": {"qbfs_0": 0.1, "qbfs_3": -1e-3, "q_radius": 7.0}},
    "TILTSURF": {"sag": {"slope_x": 0.1, "slope_y": -0.2}},
}
IMAGE = Row(9, kind="image")
FROZEN = vectors.frame(exported_lenses.CSV.name)  # rays of optiland through the exported files


def rays(name: str) -> list[np.ndarray]:
    """Start, direction and end of six rays, each (6, 3)."""
    found = FROZEN[FROZEN["lens"] == name][list(exported_lenses.COLUMNS[2:])].to_numpy()
    assert len(found) == 6
    return np.hsplit(found, 3)


def written(lens: Sequential, folder) -> Sequential:
    """The lens as its file says it."""
    write_zemax(lens, folder / "lens.zmx")
    return read_zemax(folder / "lens.zmx")


@pytest.mark.parametrize("name", exported_lenses.LENSES)
def test_rays_of_exported_file_are_those_of_optiland(name, tmp_path):
    lens = exported_lenses.exported(name)
    start, direction, end = rays(name)
    for each in (lens, written(lens, tmp_path)):
        points, _ = trace(each, start, direction)
        np.testing.assert_allclose(to_world(each, points)[-1], end, atol=1e-9)


@pytest.mark.parametrize("name", exported_lenses.LENSES)
def test_optiland_reads_the_exported_lens(name, tmp_path):
    peers.need("optiland")
    lens = exported_lenses.exported(name)
    write_zemax(lens, tmp_path / "lens.zmx")
    start, direction, end = rays(name)
    found = exported_lenses.optiland_image_points(tmp_path / "lens.zmx", start, direction, lens.wavelength_nm)
    np.testing.assert_allclose(found, end, atol=1e-9)


def test_everything_of_a_lens_comes_back(tmp_path):
    rows = (
        Row(1, label="Öffnung front", radius=51.5, conic=-0.7, coefficients=(1e-6, 0.0, 3e-12), thickness=4.0,
            material="schott/SF5", semi_diameter=11.0, semi_diameter_fixed=True, coating="AR"),
        Row(2, radius=-80.0, thickness=3.0, material="nd=1.53 Vd=56 k=0", semi_diameter=10.5),
        Row(3, thickness=1.0, stop=True, semi_diameter=5.0, aperture=circle(5.0, 1.5)),
        Row(4, radius=-200.0, mirror=True, thickness=-30.0, semi_diameter=math.hypot(9.0, 11.0),
            aperture=rectangle(8.0, 9.0, x=1.0, y=-2.0)),
        Row(5, thickness=-2.0, material="1.5", semi_diameter=6.0, obscuration=circle(2.0)),
        Row(6, kind="image", radius=90.0, semi_diameter=7.0),
    )  # fmt: skip
    light = {"wavelengths_nm": (486.1, 587.6, 656.2), "weights": (0.5, 1.0, 0.25), "primary": 1}
    aperture = {"object_distance": 120.0, "aperture_kind": "object_na", "aperture": 0.06}
    field = {"field_kind": "object_height", "fields": ((0.0, 0.0), (3.0, -4.0))}
    vignetting = ((0.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3, 0.4))
    lens = Sequential("Ø 22 mm", rows, vignetting=vignetting, **light, **aperture, **field)
    back = written(lens, tmp_path)
    found = [replace(row, line=0) for row in back.rows]
    assert found[3].semi_diameter == pytest.approx(rows[3].semi_diameter, rel=1e-15)  # the reach of its corners
    found[0] = replace(found[0], radius=51.5)  # by way of its curvature
    found[3] = replace(found[3], semi_diameter=rows[3].semi_diameter)
    assert replace(back, rows=tuple(found), source="", notes=(), unread=()) == replace(lens, source="")
    assert [line.text for line in back.unread] == ["COAT AR"]  # there is no coating file


def test_apertures_come_back(tmp_path):
    """OpticStudio takes the size of a floating stop from its semi-diameter, whatever the lens draws there."""
    for kind in ("entrance_pupil_diameter", "f_number", "stop_diameter"):
        for size in (None, 9.0):
            rows = (Row(1, thickness=1.0, semi_diameter=7.0), Row(2, stop=True, semi_diameter=size), IMAGE)
            back = written(Sequential("lens", rows, aperture_kind=kind, aperture=4.0), tmp_path)
            assert (back.aperture_kind, back.aperture) == (kind, 4.0)
            assert [row.semi_diameter for row in back.rows[:2]] == [7.0, 2.0 if kind == "stop_diameter" else size]
    lens = Sequential("lens", (Row(1), IMAGE), object_distance=50.0, aperture_kind="object_na", aperture=0.1)
    for telecentric in (False, True):
        assert written(replace(lens, telecentric=telecentric), tmp_path).telecentric == telecentric


def test_what_a_file_cannot_say_is_told(tmp_path):
    slit, hole, spot = rectangle(ALL, 1.0), Outline((OutlineFigure("circle", "-", sizes=(1.0,)),)), circle(1.0)
    cases = (
        (Row(1, aperture=slit), "surface 1: its slit, as it has no rim", None),
        (Row(1, aperture=slit, semi_diameter=5.0), None, rectangle(5.0, 1.0)),
        (Row(1, aperture=hole), "surface 1: its hole of radius 1 mm", None),
        (Row(1, aperture=hole, semi_diameter=5.0), None, circle(5.0, 1.0)),
        (Row(1, obscuration=spot, semi_diameter=5.0, semi_diameter_fixed=True), "stops no light", (None, spot)),
        (Row(1, obscuration=spot, semi_diameter=5.0), None, (None, spot)),
        (Row(1, coating="FILES/COATING.DAT:my AR"), "coating 'my AR': its name is written with '_'", None),
        (Row(1, coating="AR"), None, None),
    )
    for row, loss, aperture in cases:
        lost = write_zemax(Sequential("lens", (row, IMAGE), aperture=1.0), tmp_path / "lens.zmx")
        assert [loss in each for each in lost] == [True] if loss else lost == (), row
        clear, opaque = aperture if isinstance(aperture, tuple) else (aperture, None)
        back = read_zemax(tmp_path / "lens.zmx").rows[0]
        assert (back.aperture, back.obscuration) == (clear, opaque)


@pytest.mark.parametrize("tilt_first", [False, True])
@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (1.0, -2.0, 0.0), (1.0, 2.0, 3.0)])
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.0, 20.0, 0.0), (10.0, -20.0, 30.0)])
def test_frames_of_decentres_come_back(tilt_first, returns, shift, tilt, tmp_path):
    x, y, z = shift
    decentre = Decentre(x=x, y=y, z=z, tilt_deg=tilt, tilt_first=tilt_first, returns=returns)
    rows = (Row(1, thickness=5.0), Row(2, thickness=7.0, decentre=decentre), Row(3, thickness=1.0), IMAGE)
    lens = Sequential("lens", rows, aperture=1.0)
    back = written(lens, tmp_path)
    places = [frame for frame, row in zip(frames(back), back.rows, strict=True) if row.kind != "coordinate_break"]
    np.testing.assert_allclose(places, frames(lens), atol=1e-12)


def test_each_break_turns_about_one_axis_after_its_decentre(tmp_path):
    """Programs disagree about several tilts in one break, and some know no order."""
    for row in written(exported_lenses.tilted(), tmp_path).rows:
        if row.decentre is not None:
            assert sum(map(bool, row.decentre.tilt_deg)) <= 1
            assert (row.decentre.tilt_first, row.decentre.z) == (False, 0)


def test_glasses(tmp_path):
    for material, wavelengths, line, loss in (
        ("N-BK7", (550.0,), "GLAS N-BK7 0 0 1.5168", None),
        ("ohara/S-BSL7", (550.0,), "GLAS S-BSL7 0 0 1.5163", None),
        ("fused silica", (550.0,), "GLAS SILICA 0 0 1.4584", None),
        ("1.7", (587.56,), "GLAS ___BLANK 1 0 1.7 10000000000 ", None),
        ("1.7", (632.8,), "GLAS ___BLANK 1 0 1.7 0 ", "no dispersion"),
        ("nd=1.6 Vd=40 k=0", (587.56,), "GLAS ___BLANK 1 0 1.6 40 ", None),
        ("nd=1.6 Vd=40 k=0", (500.0,), "GLAS ___BLANK 1 0 1.6 40 ", "formulas of their own"),
        ("nd=1.6 Vd=40 k=1e-6", (587.56,), "GLAS ___BLANK 1 0 1.6 40 ", "absorption"),
        ("PMMA k=0", (486.1, 587.6), "GLAS PMMA 0 0 1.4", None),
        ("N-BK7 shift=0.001", (587.5618,), "GLAS ___BLANK 1 0 1.5178", "alone"),
        ("Ge", (1500.0,), "GLAS GERMANIUM 0 0 ", None),
        ("MgF2", (486.1, 587.6), "GLAS ___BLANK 1 0 1.38", "approximate"),
    ):
        rows = (Row(1, thickness=1.0, material=material), IMAGE)
        lens = Sequential("lens", rows, aperture=1.0, wavelengths_nm=wavelengths, weights=(1.0,) * len(wavelengths))
        losses = write_zemax(lens, tmp_path / "lens.zmx")
        text = (tmp_path / "lens.zmx").read_text()
        assert line in text
        catalogues = {"N-BK7": "SCHOTT", "S-BSL7": "OHARA", "SILICA": "MISC", "PMMA": "MISC", "GERMANIUM": "INFRARED"}
        expected = catalogues.get(line.split()[1])
        assert (f"\nGCAT {expected}\n" in text) if expected else ("GCAT" not in text)
        assert any(loss in each for each in losses) if loss else losses == ()
        lenses = (lens, read_zemax(tmp_path / "lens.zmx"))
        index = [trace(each, [[0, 0, 0]], [[0, 0.5, 1]])[1][0, 0, 1] for each in lenses]
        if len(wavelengths) == 1 or loss is None:  # the file says the same to its reader
            assert index[0] == pytest.approx(index[1], rel=1e-9)


def test_what_no_file_holds_is_refused(tmp_path):
    odd = Sequential("lens", (Row(1, label="front", sag={"curvature_x": 0.1, "r3": 1e-3}), IMAGE), aperture=1.0)
    many = replace(odd, wavelengths_nm=tuple(range(400, 425)), weights=(1.0,) * 25)
    each_refused(
        (odd, r"surface 1 'front'.*r3"),
        (replace(odd, rows=(Row(1, sag={"xy_0_0": 1.0}), IMAGE)), "surface 1 ''.*xy_0_0"),
        (replace(many, rows=(Row(1), IMAGE)), "lens 'lens': 25 wavelengths"),
        by=lambda lens: write_zemax(lens, tmp_path / "lens.zmx"),
    )
    assert not (tmp_path / "lens.zmx").exists()


@pytest.mark.parametrize("kind", sorted(FREEFORMS))
def test_freeforms_come_back(kind, tmp_path):
    base = {"radius": math.inf, "conic": 0.0} if kind == "TILTSURF" else {"radius": 80.0, "conic": -0.5}
    row = Row(1, semi_diameter=5.0, **base, **FREEFORMS[kind])
    file = tmp_path / "lens.zmx"
    write_zemax(Sequential("lens", (row, IMAGE), aperture=1.0), file)
    text = file.read_text(encoding="utf-8")
    assert f"TYPE {kind}\n" in text
    back = read_zemax(file).rows[0]
    assert back.sag_numbers == pytest.approx(row.sag_numbers, rel=1e-12)
    assert (back.radius, back.conic) == (row.radius, row.conic)
    file.write_text(text.replace("UNIT MM", "UNIT IN"), encoding="utf-8")
    x, y = np.random.default_rng(5).uniform(-3, 3, (2, 40))
    found = sag(25.4 * x, 25.4 * y, read_zemax(file).rows[0].sag_numbers)
    assert found == pytest.approx(25.4 * sag(x, y, row.sag_numbers), abs=1e-12)


@pytest.mark.parametrize(("design_nm", "primary", "told"), [(800.0, 0, False), (900.0, 1, False), (700.0, 1, True)])
def test_waves_of_a_coating_file_choose_the_primary_wavelength(design_nm, primary, told):
    coating = Coating(table="COATING.DAT:AR", design_nm=design_nm)
    front = Surface("front", radius=50.0, semi_diameter=5.0, back="1.5", coating=coating)
    film = Detector(z=12.0, semi_diameter=3.0, front="1.5")
    source = Source(radius=4.0, z=-5.0, wavelength_nm=(800.0, 900.0, 1000.0))
    lens = to_sequential(Prescription(name="x", surfaces=(front,), detector=film, source=source))
    assert lens.primary == primary
    assert any("are of 700 nm here, and of 900 nm there" in note for note in lens.notes) == told


def test_the_stop_surfaces_from_behind_and_what_is_refused():
    """A front surface that bulges through the plane of the stop lies behind the stop at the stop's rim."""
    front = Surface("front", radius=10.0, semi_diameter=5.0, back="1.5")
    lens = (front, Surface("rear", z=4.0, radius=-10.0, semi_diameter=5.0, front="1.5"))
    image = Detector(z=12.0, semi_diameter=3.0)
    sag = 10 - math.sqrt(10**2 - 4**2)
    for z, labels in ((sag - 0.1, ["stop", "front"]), (sag + 0.1, ["front", "stop"])):
        p = Prescription(name="x", surfaces=lens, stop=Stop(4.0, z, z, 8.0, 8.0), detector=image)
        rows = to_sequential(p).rows
        assert [row.label for row in rows[:2]] == labels
        np.testing.assert_allclose(sum(row.thickness for row in rows), 12.0 - (z if labels[0] == "stop" else 0.0))
    # The rim of a plane 30 mm from an object in water: NA = n sin θ, which the file gives as OBNA
    point = ObjectPoint(z=1.0, distance=31.0)
    water = Surface("front", semi_diameter=5.0, front="1.33", back="1.5")
    surfaces = (water, replace(lens[1], radius=-50.0, semi_diameter=8.0))
    near = to_sequential(Prescription(name="x", surfaces=surfaces, detector=image, source=point))
    assert near.aperture == pytest.approx(1.33 * math.sin(math.atan(5 / 30)))
    data = first_order(near)
    assert data.epd / 2 / (30 + data.entrance_pupil_z) == pytest.approx(5 / 30)
    narrow = replace(point, half_angle_deg=3.0)  # its light does not fill the lens
    narrow = to_sequential(Prescription(name="x", surfaces=surfaces, detector=image, source=narrow))
    assert narrow.aperture == pytest.approx(1.33 * math.sin(math.radians(3)))
    # A lens in the way back from a mirror keeps its materials and bends the same way
    mirror = Surface("mirror", z=50.0, semi_diameter=20.0, coating=Coating(R=1.0), mirror=True)
    near = Surface("near", z=20.0, radius=30.0, semi_diameter=10.0, front="1.5")
    far = Surface("far", z=16.0, semi_diameter=10.0, back="1.5")
    image = Detector(z=-10.0, semi_diameter=9.0)
    lens = to_sequential(Prescription(name="x", surfaces=(mirror, near, far), detector=image))
    assert [row.thickness for row in lens.rows] == [-30.0, -4.0, -26.0, 0.0]
    assert [row.material for row in lens.rows[:3]] == ["air", "1.5", "air"]
    # Along the light, -z, the first radius is -30 mm: s' = 1.5·(-30)/0.5 = -90 mm, and behind the plane, 4 mm on,
    # (s' - 4)/1.5: light seems to come from 94/1.5 mm before it
    points, directions = trace(lens, [[1e-4, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    point, direction = to_world(lens, points)[2, 0], directions[2, 0]
    assert lens.rows[1].radius == 30.0
    crossing = 50.0 + point[2] - direction[2] * point[0] / direction[0]  # the table begins at the mirror
    assert crossing == pytest.approx(16.0 + 94.0 / 1.5, abs=1e-5)
    front = Surface("front", radius=30.0, semi_diameter=10.0, back="1.5")
    rear = Surface("rear", y=0.5, z=4.0, radius=-30.0, semi_diameter=10.0, front="1.5")
    p = Prescription(name="x", surfaces=(front, rear), detector=Detector(y=0.5, z=30.0, semi_diameter=9.0))
    assert [row.decentre for row in to_sequential(p).rows[1:]] == [Decentre(y=0.5), None]
    front, image = Surface("front", semi_diameter=5.0, back="1.5"), Detector("image", z=20.0, semi_diameter=9.0)
    rear = Surface("rear", z=4.0, semi_diameter=5.0, front="1.5")
    each_refused(
        ((front, rear), None, "it has no detector"),
        ((), image, "it has no optical surface"),
        ((rear, front), image, "to surface 'front' in 'air', but the surface stands in '1.5'|order of light"),
        ((front, replace(rear, z=60.0)), image, "light behind surface 'rear' runs away from surface 'image'"),
        ((front, replace(rear, front="1.6")), image, "'rear' in '1.5', but the surface stands in '1.6'"),
        ((front, replace(rear, coating=Coating(R=0.1))), image, "surface 'rear' is opaque and no mirror"),
        by=lambda surfaces, detector: to_sequential(Prescription(name="camera", surfaces=surfaces, detector=detector)),
        pattern="camera.*({})",
    )


@pytest.mark.parametrize(("z", "place", "aperture"), [(-5, 0, 6), (50, 0, 6), (150, 2, 6 / 0.99), (190, 4, None)])
def test_a_stop_behind_mirrors_and_a_lens_that_is_turned_round(z, place, aperture):
    """f = 200 and -75 mm, 80 mm apart: of a height of 1 on the primary 0.6 are left, and 0.99 are 130 mm further on."""
    known = {"mirror": True, "coating": Coating(R=1.0)}
    surfaces = (
        Surface("primary", z=100.0, radius=-400.0, semi_diameter=40.0, inner_semi_diameter=5.0, **known),
        Surface("secondary", z=20.0, radius=-150.0, semi_diameter=12.0, **known),
        Surface("front", z=160.0, radius=-100.0, semi_diameter=10.0, tilt_deg=(180.0, 0.0, 0.0), front="1.5"),
        Surface("rear", z=165.0, semi_diameter=10.0, front="1.5"),
    )
    lens = Prescription(name="x", surfaces=surfaces, detector=Detector(z=250.0, semi_diameter=9.0))
    found = to_sequential(replace(lens, stop=Stop(3.0, z, z, 9.0, 9.0)))
    assert [row.stop for row in found.rows].index(True) == place
    assert aperture is None or found.aperture == pytest.approx(aperture, rel=2e-3)


def test_fields_of_tilted_sources_and_the_distance_of_an_object_from_a_stop_in_front():
    surfaces = (Surface("front", semi_diameter=5.0, back="1.5"), Surface("rear", z=4, semi_diameter=8.0, front="1.5"))
    lens = Prescription(name="x", surfaces=surfaces, detector=Detector(z=12.0, semi_diameter=3.0))
    beam = Source(radius=2.0, y=1.0, field_deg=3.0, tilt_deg=(-10.0, 0.0, 0.0))
    found = to_sequential(replace(lens, source=beam, more_detectors=(Detector("probe", z=30.0, semi_diameter=3.0),)))
    assert "detectors besides 'detector' are left out (1)" in found.notes
    assert found.fields[1] == pytest.approx((0.0, 13.0))
    assert "the beam is centred beside the axis; it is taken about the axis" in found.notes
    point = ObjectPoint(x=1.0, z=-20.0, distance=100.0, tilt_deg=(0.0, 30.0, 0.0))
    found = to_sequential(replace(lens, stop=Stop(1.0, -25.0, -25.0, 9.0, 9.0), source=point))
    assert found.object_distance == pytest.approx(100 * math.cos(math.radians(30)) - 5)  # from the stop, the first row
    assert found.fields[1] == pytest.approx((1 - 50.0, 0.0))
    with refused("prescription 'x': its source shines against the z axis"):
        to_sequential(replace(lens, source=replace(beam, tilt_deg=(0.0, 180.0, 0.0))))


@pytest.mark.parametrize("name", [*exported_lenses.SCENES, "three_mirror_telescope"])  # mirrors off the axis
def test_command_writes_the_lens_of_the_scene_file(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lens = to_sequential(exported_lenses.importlib.import_module(f"mistray.scenes.{name}.prescription").build())
    shown = json_units.read(run(capsys, "export", name, "-o", "lens.zmx", "--json")[1])
    assert (shown["files"], shown["surfaces"]) == (["lens.zmx"], sum(row.kind == "surface" for row in lens.rows))
    if name == "newtonian":
        assert shown["entrance_pupil_diameter_mm"] == pytest.approx(190.5)
        assert "vane_1" in shown["left_out"]
    found, expected = read_zemax("lens.zmx"), written(lens, tmp_path)
    assert [replace(row, line=0) for row in found.rows] == [replace(row, line=0) for row in expected.rows]
    assert (found.aperture, found.wavelengths_nm) == (expected.aperture, expected.wavelengths_nm)


def test_command_says_what_is_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "'.txt' cannot be written" in fails(capsys, "export", "newtonian", "-o", "lens.txt")
    assert "the folder 'no' does not exist" in fails(capsys, "export", "newtonian", "-o", "no/lens.zmx")
    assert "such as newtonian" in fails(capsys, "export", "newtonion", "-o", "lens.zmx")

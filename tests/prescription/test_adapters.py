"""Lenses of optiland, both ways, of ray-optics, and OSLO files; other files: tests/validation/test_lens_files.py."""

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import peer_lenses
import peers
import pytest
import vectors
from oracles.small_scenes import write
from refusals import each_refused, refused

import mistray
from mistray import MistrayError, MistrayWarning
from mistray.coatings import coating_from_text
from mistray.io.optiland import from_optiland
from mistray.io.rayoptics import from_rayoptics
from mistray.materials import complex_index, refractive_index
from mistray.physics.sags.terms import sag as freeform_sag
from mistray.prescription import Coating, circle, from_oslo, read_oslo, to_optiland
from mistray.prescription import from_optiland as lens_of_optiland
from mistray.prescription.sequential.first_order import first_order
from mistray.prescription.sequential.materials import same_material
from mistray.prescription.sequential.rays import to_world, trace
from mistray.prescription.spectral import DEFAULT_NM


def test_materials_are_named_only_where_their_index_is_the_same():
    def bk7(wavelength):
        return refractive_index("N-BK7", wavelength)

    lines = (486.13, 587.56, 656.27)
    assert same_material(["schott/BK7", "N-BK7"], bk7, lines) == "N-BK7"
    table = same_material(["F2"], bk7, lines)
    assert [complex_index(table, line) for line in lines] == [bk7(line) for line in lines]
    assert same_material(["N-BK7"], lambda wavelength: 1.0, lines) == "air"
    assert same_material(["N-BK7"], lambda wavelength: 1.7, lines) == "1.7 k=0"
    assert same_material(["PMMA"], lambda w: refractive_index("PMMA", w), lines).startswith("PMMA")


def file_and_model(name: str) -> tuple[Any, Any]:
    """A CODE V file of the packages, read by ray-optics; the test is left out where they are not installed."""
    peers.need("rayoptics")
    path = next(path for file, path in peer_lenses.files().items() if file.endswith(f"/{name}.seq"))
    return path, peer_lenses.by_rayoptics(path).model


@pytest.mark.parametrize("name", ["ag_dblgauss", "CODV_49664", "questar35", "threemir", "dec_rev_tilt_test", "singlet",
                                  "folded_lenses", "paraboloid_f8"])  # fmt: skip
def test_a_model_of_rayoptics_is_the_lens_of_its_file(name):
    path, model = file_and_model(name)
    model["seq_model"].gaps[-1].thi -= model["optical_spec"]["focus"].focus_shift  # which peer_lenses adds
    ours, theirs = peer_lenses.read(path), from_rayoptics(model)
    assert [row.kind for row in theirs.rows] == [row.kind for row in ours.rows]
    assert (theirs.field_kind, theirs.wavelengths_nm) == (ours.field_kind, ours.wavelengths_nm)
    assert np.array(theirs.fields) == pytest.approx(np.array(ours.fields))
    wavelength = ours.wavelength_nm
    assert first_order(theirs, wavelength).efl == pytest.approx(first_order(ours, wavelength).efl, rel=1e-6)
    positions, directions = (values.reshape(-1, 3) for values in peer_lenses.starts(ours))
    theirs_hits, ours_hits = (trace(lens, positions, directions, wavelength)[0][-1] for lens in (theirs, ours))
    assert theirs_hits == pytest.approx(ours_hits, abs=2e-6)
    assert np.isfinite(ours_hits).all()


def test_what_rayoptics_has_and_we_do_not():
    toroid = peers.rayoptics("elem.profiles").XToroid(r=50.0, rR=60.0)
    grating = peers.rayoptics("oprops.doe").DiffractiveElement()
    wrong = {"phase_element": (grating, "diffracting surfaces"), "profile": (toroid, "XToroid has no counterpart")}
    for key, (thing, words) in wrong.items():
        model = file_and_model("CODV_32327")[1]
        setattr(model["seq_model"].ifcs[1], key, thing)
        with pytest.raises(MistrayError, match=f"interface 1: {words}"):
            from_rayoptics(model)
    model = file_and_model("CODV_32327")[1]
    surface, interfaces = peers.rayoptics("elem.surface"), model["seq_model"].ifcs
    for interface in interfaces:
        interface.clear_apertures, interface.edge_apertures = [], []
    interfaces[1].edge_apertures = [surface.Circular(radius=7.5)]
    interfaces[2].clear_apertures = [surface.Circular(radius=6.0)]
    interfaces[2].edge_apertures = [surface.Circular(radius=8.0)]
    found = from_rayoptics(model)
    sizes = [(row.semi_diameter, row.semi_diameter_fixed) for row in found.rows]
    assert sizes == [(7.5, False), (6.0, True)] + [(None, False)] * (len(sizes) - 2)
    assert [entry.text for entry in found.unread] == ["interface 2: edge Circular"]


def test_profiles_of_rayoptics():
    for kind, numbers in (
        ("EvenPolynomial", {"r": 50.0, "cc": -0.4, "coefs": [1e-3, 1e-6, 0.0, 1e-12]}),
        ("RadialPolynomial", {"r": 50.0, "cc": -0.4, "coefs": [1e-3, 2e-3, -1e-5, 1e-6]}),
        ("YToroid", {"r": 50.0, "rR": 80.0, "cc": 0.2, "coefs": [1e-3, 1e-6]}),
    ):
        model = file_and_model("CODV_32327")[1]
        profile = model["seq_model"].ifcs[1].profile = getattr(peers.rayoptics("elem.profiles"), kind)(**numbers)
        points = np.random.default_rng(1).uniform(-3, 3, (20, 2))
        theirs = np.array([float(profile.sag(x, y)) for x, y in points])
        assert freeform_sag(*points.T, from_rayoptics(model).rows[0].sag_numbers) == pytest.approx(theirs, abs=1e-9)


@pytest.mark.parametrize(("kind", "value"), [("NA", 0.1), ("f/#", 5.0)])
def test_a_pupil_of_rayoptics_at_an_immersed_image(kind, value):
    """Its f/# and its NA both hold the index n = 1.33 there: n u' = NA = 1/(2 f/#)."""
    model = file_and_model("singlet")[1]
    sequence, pupil = model["seq_model"], model["optical_spec"]["pupil"]
    sequence.gaps[-1].medium = import_module("opticalglass.opticalmedium").ConstantIndex(1.33, "water")
    pupil.key, pupil.value = ("image", kind), value
    model.update_model()
    theirs = model["analysis_results"]["parax_data"].ax_ray
    lens = from_rayoptics(model)
    data = first_order(lens)
    slope = data.epd / 2 / (lens.object_distance + data.entrance_pupil_z)
    assert slope == pytest.approx(abs(float(theirs[0][1])), rel=1e-6)
    assert abs(float(theirs[-1][1])) == pytest.approx(0.1 / 1.33, rel=1e-6)


def bench(*surfaces, aperture=("EPD", 8), fields=("angle", ((0, 2),)), microns=(0.5876,), first=np.inf):
    """An optic of optiland with these surfaces after the object; the last one is the image."""
    optic = peers.optiland("optic").Optic("bench")
    optic.surfaces.add(index=0, thickness=first)
    for index, numbers in enumerate((*surfaces, {}), start=1):
        optic.surfaces.add(index=index, **numbers)
    optic.set_aperture(aperture_type=aperture[0], value=aperture[1])
    optic.fields.set_type(fields[0])
    for x, y in fields[1]:
        optic.fields.add(x=x, y=y)
    for micron in microns:
        optic.wavelengths.add(value=micron, is_primary=micron == microns[0])
    return optic


def mirror_and_lens(aperture=None, **system):
    """A window, a tilted mirror, perhaps with an aperture, and a lens off the axis with an asphere."""
    asphere = {"surface_type": "even_asphere", "radius": -50, "conic": 0.3, "coefficients": [0.0, 1e-6]}
    optic = bench(
        {"thickness": 3, "material": "N-BK7", "is_stop": True, "comment": "window"},
        {"radius": -400, "conic": -0.5, "thickness": 60},
        {"radius": -300, "thickness": -40, "material": "mirror", "rx": np.radians(4), "dy": 1.5},
        asphere | {"thickness": -4, "material": "N-SF5", "rx": np.radians(8), "ry": np.radians(-3)},
        {"radius": np.inf, "thickness": -30},
        **({"fields": ("angle", ((0, 0), (-1, 2))), "microns": (0.5876, 0.4861)} | system),
    )
    list(optic.surfaces)[3].aperture = aperture
    return optic


def ends_by_optiland(optic, positions, directions, wavelength_nm):
    """Points on the image and directions there."""
    count = len(positions)
    last = np.ones(count), np.full(count, wavelength_nm / 1e3)
    rays = peers.optiland("rays").RealRays(*positions.T, *directions.T, *last)
    optic.surfaces.trace(rays)
    return np.stack([rays.x, rays.y, rays.z], axis=1), np.stack([rays.L, rays.M, rays.N], axis=1)


def test_a_lens_of_optiland_has_the_same_rays():
    optic = mirror_and_lens(peers.optiland("physical_apertures").RadialAperture(r_max=20, r_min=0.1))
    found = from_optiland(optic)
    assert (found.name, found.fields, found.aperture) == ("bench", ((0, 0), (-1, 2)), 8)
    assert found.wavelengths_nm == pytest.approx((587.6, 486.1))
    assert [row.material for row in found.rows[:3]] == ["N-BK7", "air", "air"]
    assert [row.mirror for row in found.rows[:4]] == [False, False, True, False]
    assert (found.rows[2].aperture, found.rows[0].label, found.rows[0].stop) == (circle(20, 0.1), "window", True)
    positions, directions = (values.reshape(-1, 3) for values in peer_lenses.starts(found))
    last = sum(row.thickness for row in found.rows)  # the image is not tilted and stands on the axis
    for wavelength in found.wavelengths_nm:
        ends, headings = ends_by_optiland(optic, positions, directions, wavelength)
        hits, onward = trace(found, positions, directions, wavelength)
        assert ends - [0, 0, last] == pytest.approx(hits[-1], abs=1e-9)
        assert headings == pytest.approx(onward[-1], abs=1e-10)
    assert np.ptp(hits[-1][:, 1]) > 0.1


@pytest.mark.parametrize("aperture", [("EPD", 11), ("imageFNO", 6.0), ("objectNA", 0.05), ("float_by_stop_size", 9.0)])
def test_an_aperture_of_optiland_is_as_wide_here(aperture):
    optic = bench(
        {"radius": 60, "thickness": 4, "material": "N-BK7"}, {"radius": -80, "thickness": 5},
        {"thickness": 100, "is_stop": True}, first=150, aperture=aperture, fields=("object_height", ((0, 3),)),
    )  # fmt: skip
    found = from_optiland(optic)
    assert (found.object_distance, found.field_kind, found.fields) == (150, "object_height", ((0, 3),))
    assert first_order(found).epd == pytest.approx(float(np.ravel(optic.paraxial.EPD())[0]), rel=1e-6)
    assert not found.telecentric
    if aperture[0] == "objectNA":
        optic.obj_space_telecentric = True
        assert from_optiland(optic).telecentric


FREEFORMS = {
    "odd_asphere": {"radius": 60.0, "conic": -0.4, "coefficients": [1e-3, 2e-4, -1e-5, 1e-6]},
    "polynomial": {"radius": 60.0, "coefficients": np.array([[0, 1e-3, 2e-4], [-2e-3, 1e-4, 0], [3e-4, 0, 1e-7]])},
    "chebyshev": {"radius": 60.0, "conic": 0.3, "coefficients": np.array([[0, 0.01, 0.02], [0.03, 0.01, 0]]),
                  "norm_x": 9.0, "norm_y": 8.0},
    "toroidal": {"radius": 60.0, "radius_y": -90.0, "conic": 0.3, "toroidal_coeffs_poly_y": [1e-4, 1e-6]},
    **{f"zernike, {kind}": {"zernike_type": kind, "radius": 60.0, "norm_radius": 9.0,
                            "coefficients": np.linspace(0.003, -0.002, 15)} for kind in ("noll", "fringe", "standard")},
    "forbes_qbfs": {"radius": 60.0, "conic": -0.7, "radial_terms": {0: 0.1, 1: -0.03, 4: 0.01}, "norm_radius": 9.0},
    "forbes_q2d": {"radius": 60.0, "conic": -0.7, "norm_radius": 9.0, "freeform_coeffs": {
        ("a", 0, 1): 0.02, ("a", 1, 0): 0.01, ("b", 2, 1): -0.02, ("a", 3, 2): 0.01, ("b", 1, 3): 0.01}},
    "biconic, cylinder": {"radius_x": np.inf, "radius_y": 80.0, "conic_y": -0.5},
}  # fmt: skip


@pytest.mark.parametrize("kind", FREEFORMS)
def test_freeforms_of_optiland_have_the_same_rays(kind):
    front = {"surface_type": kind.partition(",")[0], "thickness": 4, "material": "N-BK7", "is_stop": True}
    optic = bench(front | FREEFORMS[kind], {"radius": -70, "thickness": 50}, aperture=("EPD", 10))
    found = from_optiland(optic)
    assert found.rows[0].sag
    rng = np.random.default_rng(2)
    positions = np.column_stack([rng.uniform(-4, 4, (40, 2)), np.full(40, -5.0)])
    directions = np.column_stack([rng.uniform(-0.1, 0.1, (40, 2)), np.ones(40)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ends, headings = ends_by_optiland(optic, positions, directions, 587.6)
    hits, onward = trace(found, positions, directions, 587.6)
    assert ends[:, :2] == pytest.approx(hits[-1][:, :2], abs=1e-6)
    assert headings == pytest.approx(onward[-1], abs=1e-7)


def test_optiland_apertures_and_what_we_do_not_have():
    physical = peers.optiland("physical_apertures")
    points = np.random.default_rng(3).uniform(-6, 6, (400, 2))
    for aperture in (
        physical.EllipticalAperture(a=4, b=2, offset_x=1, offset_y=-1),
        physical.PolygonAperture(x=[-4, 3, 5, 0], y=[-3, -4, 2, 5]),
        physical.RadialAperture(r_max=5) - physical.RectangularAperture(-1, 2, -3, 1),
        physical.RadialAperture(r_max=5) & physical.EllipticalAperture(a=3, b=6),
        physical.RadialAperture(r_max=2) | physical.RectangularAperture(1, 5, -1, 1),
    ):
        found = from_optiland(mirror_and_lens(aperture))
        assert not found.unread
        assert (found.rows[2].aperture.contains(*points.T) == np.asarray(aperture.contains(*points.T))).all(), aperture
    # It adds two conics, one of x and one of y, which is no biconic of the standard
    optic = mirror_and_lens()
    optic.set_aperture(aperture_type="imageFNO", value=5)
    assert from_optiland(optic).aperture_kind == "f_number"
    list(optic.surfaces)[4].geometry.coefficients[0] = 1e-3
    assert from_optiland(optic).rows[3].sag == {"a2": 1e-3}
    list(optic.surfaces)[4].geometry.k = 400.0  # it ends at 2.5 mm
    assert from_optiland(optic).rows[3].conic == 400.0
    optic = bench({"surface_type": "biconic", "radius_x": 50.0, "radius_y": 80.0, "thickness": 30, "is_stop": True})
    each_refused(
        (optic, r"surface 1: optiland's BiconicGeometry is another surface by"),
        (peers.optiland("optic").Optic("empty"), "it needs a surface, a wavelength and an aperture"),
        *((thing, f"from_optiland was given {type(thing).__name__}; give an Optic") for thing in (None, 3, {})),
        by=from_optiland,
    )
    with refused("from_rayoptics was given str; give an OpticalModel"):
        from_rayoptics("lens.zmx")


@pytest.fixture(scope="module")
def triplet() -> Any:
    """optiland's Cooke triplet with an ideal coating in front."""
    coatings = peers.optiland("coatings")
    optic = peers.optiland("samples.objectives").CookeTriplet()
    first = list(optic.surfaces)[1]
    first.interaction_model.coating = coatings.SimpleCoating(transmittance=0.97, reflectance=0.02)
    first.aperture = peers.optiland("physical_apertures").RadialAperture(r_max=9.5)
    return optic


def test_a_lens_there_and_back(triplet: Any) -> None:
    lens = lens_of_optiland(triplet)
    assert lens.surfaces[0].coating == Coating(R=0.02, T=0.97)
    assert lens.surfaces[1].coating is None
    assert not any("oating" in line for line in lens.provenance)
    back = to_optiland(lens, field_deg=[0, 14, 20])
    surfaces = list(back.surfaces)
    assert [surface.comment for surface in surfaces[1:3]] == ["S1", "S2"]
    ideal = surfaces[1].interaction_model.coating
    assert (ideal.reflectance, ideal.transmittance, surfaces[1].aperture.r_max) == (0.02, 0.97, 9.5)
    assert surfaces[2].interaction_model.coating is None
    assert float(np.ravel(back.paraxial.f2())[0]) == pytest.approx(float(np.ravel(triplet.paraxial.f2())[0]), rel=1e-9)
    again = lens_of_optiland(back)
    assert [surface.coating for surface in again.surfaces] == [surface.coating for surface in lens.surfaces]
    assert [s.semi_diameter for s in again.surfaces] == pytest.approx([s.semi_diameter for s in lens.surfaces])
    assert [s.curvature for s in again.surfaces] == pytest.approx([s.curvature for s in lens.surfaces], rel=1e-12)
    power = []
    for each in (lens, again):  # the ghosts of the same rays
        t = mistray.trace(each.to_scene(), rays=2000, max_reflections=2)
        power.append([t.paths[0].power_W, t.paths.find("S2:R", "S1:R")[0].power_W / t.paths[0].power_W])
    assert power[1] == pytest.approx(power[0], rel=1e-3)


def test_layers_become_their_r_and_t(triplet: Any) -> None:
    coated = mistray.coat(lens_of_optiland(triplet), {"S3": "MgF2 99.64"})
    with pytest.warns(MistrayWarning, match=r"surface 'S3': coating 'coating' becomes R = 0\.0\d+, T = 0\.9\d+, as at"):
        back = to_optiland(coated)
    found = list(back.surfaces)[3].interaction_model.coating
    assert found.reflectance + found.transmittance == pytest.approx(1, abs=1e-6)
    n = 1.6204  # SF2 of the sample's flint, roughly
    assert found.reflectance == pytest.approx(((n - 1.384**2) / (n + 1.384**2)) ** 2, abs=3e-3)


@pytest.mark.parametrize("first", ["front", "back"])
def test_layers_that_light_meets_from_behind(triplet: Any, first: str) -> None:
    """Behind a mirror light travels along -z, and meets the back of a surface."""
    coating = Coating(layers="Ag 20, 2.3 60", first=first)
    mirror = mistray.Surface("M", z=100.0, semi_diameter=20.0, coating=Coating(R=1.0), mirror=True)
    plate = mistray.Surface("P", z=50.0, semi_diameter=10.0, front="1.5", coating=coating)
    film = mistray.Detector(z=10.0, back="1.5", semi_diameter=5.0)
    lens = mistray.Prescription(name="x", surfaces=(mirror, plate), detector=film, source=mistray.Source(radius=4.0))
    with pytest.warns(MistrayWarning, match="surface 'P'"):
        back = to_optiland(lens)
    found = list(back.surfaces)[2].interaction_model.coating
    layers = replace(coating_from_text("Ag 20, 2.3 60"), first=first)
    exact = layers.response(DEFAULT_NM[0], 1.5, 1.0, np.ones(1), from_front=False)
    assert (found.reflectance, found.transmittance) == pytest.approx((exact.R.mean(), exact.T.mean()))


def test_what_optiland_has_not(triplet: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    lens = lens_of_optiland(triplet)
    first, *others = lens.surfaces
    freeform = replace(first, sag={"zernike_5": 1e-4, "zernike_radius": 9.5})
    with pytest.raises(MistrayError, match=r"surface 'S1' is a freeform \(zernike_5, zernike_radius\)"):
        to_optiland(replace(lens, surfaces=(freeform, *others)))
    with pytest.raises(MistrayError, match="surface 'S1' stands off the axis or is tilted"):
        to_optiland(replace(lens, surfaces=(replace(first, y=0.3), *others)))
    for name in [name for name in sys.modules if name.split(".")[0] == "optiland"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optiland", None)
    with pytest.raises(MistrayError, match="to_optiland needs optiland"):
        to_optiland(lens)


pytestmark = pytest.mark.quick
DOUBLET = vectors.text("doublet.len")


@pytest.fixture
def read(tmp_path: Path) -> Any:
    peers.optiland("fileio.oslo")

    def reader(text: str) -> Any:
        return read_oslo(write(tmp_path, text, "lens of mine.len"))

    return reader


def test_a_doublet_and_what_is_not_understood(read: Any) -> None:
    lens = read(DOUBLET)
    assert lens.source == "OSLO file lens of mine.len"
    shapes = np.array([[row.radius, row.thickness] for row in lens.rows[:3]])
    assert shapes == pytest.approx(np.array([[61.47, 6.0], [-44.64, 2.5], [-129.94, 95.0]]))
    assert (lens.rows[2].conic, lens.rows[2].coefficients[0]) == (-0.5, pytest.approx(1e-7))
    assert [row.stop for row in lens.rows[:3]] == [True, False, False]
    assert (lens.aperture, np.max(lens.fields)) == pytest.approx((25.0, 1.0))
    assert lens.wavelengths_nm == pytest.approx((587.56, 486.13, 656.27))
    assert lens.primary == 0
    assert [row.material for row in lens.rows[:3]] == ["schott/N-BK7", "schott/SF5", "air"]
    n1, n2 = (refractive_index(row.material, 587.56) for row in lens.rows[:2])
    # Thick doublet by hand: the ray at height 1 parallel to the axis
    y, u = 1.0, 0.0
    for row, before, behind in zip(lens.rows, (1.0, n1, n2), (n1, n2, 1.0), strict=False):
        u = (before * u - y * (behind - before) / row.radius) / behind
        y += row.thickness * u
    assert first_order(lens).efl == pytest.approx(-1 / u, rel=1e-9)
    assert 95 < -1 / u < 105
    each_refused(
        (("CC -0.5", "GSP 1.0"), "lens of mine.len'"),
        (("GLA N-BK7", "GLA NO-SUCH-GLASS"), "glass 'NO-SUCH-GLASS' is not in"),
        ((DOUBLET, ""), "lens of mine.len'"),
        by=lambda change: read(DOUBLET.replace(*change)),
    )


def test_without_optiland(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with refused("check the path"):
        read_oslo(tmp_path / "none.len")
    monkeypatch.setitem(sys.modules, "optiland.fileio.oslo.reader.converter", None)
    with refused(r"pip install 'optiland>=0\.6\.3'"):
        from_oslo(write(tmp_path, DOUBLET, "lens.len"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["CookeTriplet", "DoubleGauss", "HeliarLens", "Telephoto"])
def test_lenses_that_optiland_wrote(name: str, tmp_path: Path) -> None:
    samples, writer = peers.optiland("samples.objectives"), peers.optiland("fileio.oslo")
    path = tmp_path / f"{name} of optiland.len"
    optic = getattr(samples, name)()
    writer.save_oslo_file(optic, str(path))
    found, exact = read_oslo(path), from_optiland(optic)
    start = np.column_stack([*np.random.default_rng(1).uniform(-1, 1, (2, 30)), np.full(30, -1.0)])
    along = np.tile([0.0, 0.01, 1.0], (30, 1))
    last, wanted = (to_world(lens, trace(lens, start, along)[0])[-1] for lens in (found, exact))
    assert np.isfinite(wanted).all()
    assert last == pytest.approx(wanted, abs=2e-6)

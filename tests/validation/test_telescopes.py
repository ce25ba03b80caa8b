"""Telescopes and Rubin/LSST ray by ray against batoid; see docs/validation/telescopes.md and lsst.md."""

import importlib
import math
from pathlib import Path

import numpy as np
import pytest
from validation.tables import read, value

import mistray
from mistray.io.batoid.design_light import BatoidLight
from mistray.prescription import from_batoid

pytestmark = pytest.mark.validation

batoid = pytest.importorskip("batoid")
beside_batoid = importlib.import_module("validation.beside_batoid")
LSST, Telescope = beside_batoid.LSST, beside_batoid.Telescope

RAYS = 10_000
TELESCOPES = {
    "HSC": (Telescope("HSC_no_obsc.yaml", 750.0), (0.0, 0.3, 0.7)),
    "ComCam": (Telescope("ComCam_g.yaml", 480.0), (0.0, 0.2, 0.4)),
    "LSST": (LSST, (0.0, 1.0, 1.6)),
    "DECam with its spider": (Telescope("DECam.yaml", 620.0), (0.5,)),
    "HSC with its struts": (Telescope("HSC.yaml", 750.0), (0.3,)),
    "Rubin with Zernikes": (Telescope("Rubin_v3.14_r.yaml", 620.0), (1.0,)),
    "Rubin in g": (Telescope("Rubin_v3.14_g.yaml", 480.0), (0.0,)),
    "Rubin as it is shipped": (Telescope("Rubin_v3.14_r.yaml", 620.0, "rubin"), (1.0,)),
    "DESI": (Telescope("DESI.yaml", 620.0), (0.0, 1.0)),
}
CASES = [(name, field) for name, (_, fields) in TELESCOPES.items() for field in fields]
FAINT = 1e-6  # of the star


@pytest.mark.parametrize(("name", "field_deg"), CASES)
def test_same_rays(name: str, field_deg: float) -> None:
    telescope = TELESCOPES[name][0]
    comparison = telescope.compare(field_deg, RAYS)
    ours, star = comparison.image
    assert ours.rays == star.rays
    assert abs(ours.rms_mm - star.rms_mm) < 2e-4  # single precision
    assert (ours.x_mm, ours.y_mm) == pytest.approx((star.x_mm, star.y_mm), abs=1e-3)
    assert not [
        names
        for names, sums in comparison.missing.items()
        if comparison.order[names] == 2 and sums.flux > FAINT * star.flux
    ]
    ghosts = {names: pair for names, pair in comparison.ghosts().items() if pair[1].flux > FAINT * star.flux}
    assert len(ghosts) > 30
    for names, (mine, theirs) in ghosts.items():
        given_up = telescope.unconverged(names, comparison) if mine.rays > theirs.rays else 0
        expected = theirs.flux * (1 + given_up / theirs.rays)  # all rays of a path have the same flux
        assert mine.flux == pytest.approx(expected, rel=3e-3), telescope.label(names)


FILES = sorted(Path(str(batoid.datadir)).glob("**/*.yaml"))
# batoid 0.9 cannot read PFS; its own tilted surfaces have normals of arcsin where their sag has arctan; the projector
# loses the middle of its beam in the hole of its flat, which batoid lets it meet and pass
LEFT_OUT = {"PFS", "AuxTel", "CBP"}
STRICT_MM, VIGNETTING = 1e-3, 2e-3
AXIAL = ("donsoptikz1",)  # an apochromat; all others are compared at shares of the edge of the field, too


@pytest.mark.parametrize("name", ["rubin", *(file.stem for file in FILES if file.stem not in LEFT_OUT)])
def test_every_telescope_images_as_in_batoid(name: str) -> None:
    file = next(file for file in FILES if file.stem == ("Rubin_v3.14_r" if name == "rubin" else name))
    optic = batoid.Optic.fromYaml(str(file))
    read = from_batoid(file, wavelength_nm=620.0, reflectance=0.02, beam="exact")
    scene = mistray.load("rubin") if name == "rubin" else read.to_scene()
    edge = math.degrees(BatoidLight(batoid, optic, 620.0)._edge_of_field())
    for field_deg in {0.0, *(share * edge for share in (() if name in AXIAL else (0.5, 0.9)))}:
        t = mistray.trace(scene, rays=5000, field_deg=field_deg, max_reflections=0, flux_threshold=1e-3)
        run = t.runs[0]
        origin, direction = run.start_rays(np.arange(run.rays))
        n = optic.inMedium.getN(620e-9)  # batoid's velocities are 1/n
        columns = [np.ascontiguousarray(column) for column in (*(origin.T / 1e3), *(direction.T / n))]
        count = len(origin)
        rays = batoid.RayVector(*columns, np.zeros(count), np.full(count, 620e-9), np.ones(count))
        optic.trace(rays)
        arrived = ~(rays.vignetted | rays.failed)
        image = max((row for row in t.paths if row.order == 0), key=lambda row: row.rays)
        assert image.rays == pytest.approx(arrived.sum(), abs=VIGNETTING * count)
        x, y = 1e3 * rays.x[arrived], 1e3 * rays.y[arrived]
        rms = float(np.hypot(np.std(x), np.std(y)))
        assert image.rms_radius_mm == pytest.approx(rms, abs=STRICT_MM + 0.01 * rms)
        assert (image.x_mm, image.y_mm) == pytest.approx((np.mean(x), np.mean(y)), abs=2e-3)


def test_the_projector_loses_what_its_flat_has_no_mirror_for() -> None:
    file = next(file for file in FILES if file.stem == "CBP")
    t = mistray.trace(
        from_batoid(file, wavelength_nm=620.0, reflectance=0.0, beam="exact").to_scene(), rays=5000, max_reflections=0
    )
    image = max(t.paths, key=lambda row: row.power_W)
    # The flat is turned by 20°: of the round beam the hole takes an ellipse
    hole = (44.45 / 120.65) ** 2 * np.cos(np.radians(20))
    assert image.power_W / t.energy.launched_W == pytest.approx(1 - hole, abs=0.015)
    assert image.rms_radius_mm < 2e-3


LSST_RAYS = 20_000
# 1°: the usual case. 1.6°: paths are clipped or lost, and light still clears the camera on its way from M2 to M3
FIELDS_DEG = (1.0, 1.6)


@pytest.fixture(scope="module", params=FIELDS_DEG)
def result(request):
    return request.param, LSST.compare(request.param, LSST_RAYS)


def test_every_path_of_batoid_and_no_other(result):
    """More are only those that come back to the camera by M3, which batoid's list of neighbours leaves out."""
    field, comparison = result
    assert not comparison.missing
    assert len(comparison.ghosts()) == {1.0: 34, 1.6: 32}[field]
    assert all(names.count("M3") > 1 for names in comparison.more)
    assert not [names for names in comparison.paths if names.count("M3") > 1]
    if field == 1.0:
        # one reflection, so that the list of two-reflection paths is batoid's exactly
        assert [comparison.order[names] for names in comparison.more] == [1]
    # Also of paths by M3: batoid itself, told to follow their surfaces, finds the same light
    agree(comparison.ghosts())
    agree(comparison.more)
    # A path that loses rays, each of which both programs must lose
    most = max(ours.rays for ours, _ in comparison.paths.values())
    assert sum(ours.rays < 0.95 * most for ours, _ in comparison.ghosts().values()) >= 15
    # Rounding of coordinates of metres blurs the image by less than a micrometre; the ghosts do not notice
    ours, theirs = comparison.image
    assert ours.rays == theirs.rays
    assert 0 <= ours.rms_mm**2 - theirs.rms_mm**2 < (1.5e-3) ** 2


MIRRORS, LEG_MM = 3, 11_000.0  # of the design path, and the longest way between two of them and back


def agree(pairs) -> None:
    """The same light, but for one ray on the edge of an aperture, within three RMS radii of the centroid; each mirror
    more is a leg over which single precision rounds a direction by 2^-24."""
    for names, (ours, theirs) in pairs.items():
        further = sum(name in ("M1", "M2", "M3") for name in names) - MIRRORS
        on_edge = abs(ours.rays - theirs.rays)
        assert on_edge <= 1
        share = on_edge / min(ours.rays, theirs.rays)
        assert abs(ours.flux / theirs.flux - 1) < 1e-6 + 1.001 * share
        apart = np.hypot(ours.x_mm - theirs.x_mm, ours.y_mm - theirs.y_mm)
        assert apart < 1e-3 + max(further, 0) * 2.0**-24 * LEG_MM + 3 * theirs.rms_mm * share
        assert abs(ours.rms_mm / theirs.rms_mm - 1) < 5e-5 + (3**2 - 1) / 2 * share


def test_the_camera_stands_in_the_way_beyond():
    """At 1.75° light on its way from M2 to M3 meets the side of the camera, which batoid does not know."""
    ours, theirs = LSST.compare(1.75, LSST_RAYS).image
    assert 0.001 < 1 - ours.rays / theirs.rays < 0.004


def test_the_report_holds_these_numbers(result):
    field, comparison = result
    rows = [row for row in read("lsst.md", "fields") if value(row["field °"])[0] == field]
    assert [int(row["found"]) for row in rows] == [len(comparison.ghosts()), len(comparison.more)]
    flux = 1e3 * sum(ours.flux for ours, _ in comparison.ghosts().values())
    assert value(rows[0]["flux ‰"])[0] == pytest.approx(flux, rel=0.02)
    if field == 1.0:
        found = {LSST.label(names): ours for names, (ours, _) in comparison.ghosts().items()}
        for row in read("lsst.md", "ghosts"):
            ours = found[row["turns at"]]
            assert value(row["flux ‰"])[0] == pytest.approx(1e3 * ours.flux, rel=0.01)
            assert value(row["y mm"])[0] == pytest.approx(ours.y_mm, abs=5 * ours.rms_mm / ours.rays**0.5)
            assert value(row["RMS radius mm"])[0] == pytest.approx(ours.rms_mm, rel=0.01)

"""Image quality of scenes with closed forms, and surface transfer functions of scatter models."""

import math

import mitsuba as mi
import numpy as np
import pytest
from matplotlib.text import Text
from oracles import ideal_images
from refusals import each_refused

import mistray
from mistray.analyses.image import figures, pupil_grid
from mistray.analyses.transfer.surface import product, transfer_of_bsdf, transfer_of_spectrum
from mistray.errors import MistrayWarning
from mistray.physics.imaging import surface_transfer as formulas
from mistray.scatter.abg import ABg
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.scatter.total import lobe_total

pytestmark = pytest.mark.quick
FOCAL, RADIUS, OBSTRUCTION = 100.0, 12.5, 0.2
MIRROR = {"R": 0.9, "mirror": True}


def shape(kind="asphere", sensor=False, z=0.0, bsdf=None, **numbers):
    value = {"type": kind, "bsdf": {"type": "interface", **(bsdf or {"R": 0.0})}, **numbers}
    value["to_world"] = mi.ScalarTransform4f().translate([0, 0, z])
    return value | ({"sensor": {"type": "irradiancemeter"}} if sensor else {})


def paraboloid(scale=1.0, half_width=None):
    """A concave mirror at z = 0 whose focus, in front of it, is a disc that takes the middle of the beam."""
    stop = {"semi_diameter": OBSTRUCTION * RADIUS * scale}
    if half_width:
        stop = {"half_width": half_width, "half_height": half_width}
    return {
        "type": "scene",
        "light": {"type": "collimated", "radius": 2 * RADIUS * scale, "wavelength_nm": 550.0},
        "mirror": shape(radius=-2 * FOCAL * scale, conic=-1.0, semi_diameter=RADIUS * scale, bsdf=MIRROR),
        "detector": shape(sensor=True, z=-FOCAL * scale, **stop),
    }


def test_annular_pupil_line_and_edge():
    """On its axis there is no aberration; y = 2f tan(u/2), so that N = 1/(2 sin u) = (1 + (y/2f)²)/(2 y/f)."""
    (axis,) = mistray.image_quality(mistray.load(paraboloid()), 0.0, grid=128)
    half = RADIUS / (2 * FOCAL)
    f_number = (1 + half**2) / (4 * half)
    assert axis.rms_waves("piston") < 1e-6
    assert axis.strehl == pytest.approx(1.0, abs=1e-6)
    assert axis.f_number() == pytest.approx(f_number, rel=2e-3)
    cut = ideal_images.cut_off(550e-6, f_number)
    inner = OBSTRUCTION * (1 + half**2) / (1 + (half * OBSTRUCTION) ** 2)
    share = np.linspace(0, 1, 41)
    for azimuth in ("tangential", "sagittal", 30.0):
        assert axis.mtf(share * cut, azimuth) == pytest.approx(ideal_images.annular_mtf(share, inner), abs=1.5e-3)
    psf = axis.psf(64, method="huygens")
    assert psf.values == pytest.approx(axis.psf(64).values, abs=1e-5 * psf.values.max())
    assert np.unravel_index(np.argmax(psf.values), (64, 64)) == (32, 32)
    x = np.linspace(-0.02, 0.02, 401)
    line, edge = axis.line_spread(x, "sagittal")
    assert edge[200] == pytest.approx(0.5, abs=1e-9)
    assert np.gradient(edge, x)[1:-1] == pytest.approx(line[1:-1], abs=0.02 * line.max())
    assert np.all(line > -1e-3 * line.max())
    # Beyond, the image is repeated
    each_refused(
        (lambda: axis.line_spread([0.0, 1.01 * axis.largest_radius_mm]), "x_mm reach from 0 to"),
        (lambda: axis.rms_waves("defocus"), "removed is 'defocus'; give 'piston', 'tilt' or 'focus'"),
        (lambda: axis.psf(16, line=1), "line is 1; it must be a whole number between -1 and 0"),
        (lambda: axis.mtf(5.0, None), "azimuth is None"),
    )
    assert axis.psf(16.0, line=-1).values.shape == (16, 16)


def test_coma_and_scale():
    """Off the axis a paraboloid with its stop on it has coma 3θ/(16 N²), astigmatism, and no distortion."""
    theta = 0.2
    (image,) = mistray.image_quality(mistray.load(paraboloid(half_width=1.0)), theta)
    assert np.abs(image.image_mm) == pytest.approx([0.0, FOCAL * np.tan(np.radians(theta))], abs=1e-9)
    assert image.distortion_percent == pytest.approx(0.0, abs=1e-6)
    fit = image.main.zernikes("fringe", 16)
    # W131 = θ y³/(4 f²): the wavefront of the coma of a paraboloid; R31 = 3ρ³ - 2ρ
    coma = np.radians(theta) * RADIUS**3 / (4 * FOCAL**2) / 3 / 550e-6
    y, x = (abs(fit.coefficients[fit.names.index(f"coma {axis}")]) for axis in "yx")
    assert y == pytest.approx(coma, rel=0.02)
    assert x < 1e-4
    # Astigmatism: the sagittal image lies in the focal plane, the tangential one θ² f in front of it
    assert image.sagittal_focus_mm == pytest.approx(0.0, abs=1e-6)
    assert image.tangential_focus_mm == pytest.approx(-FOCAL * np.radians(theta) ** 2, rel=0.01)
    # The edge goes from 0 to 1, also where the centroid lies beside the image point
    assert np.linalg.norm(image.centroid_mm) > 1e-3
    end = image.largest_radius_mm
    _, (low, high) = image.line_spread([-end, end])
    assert 0 < low < 0.006
    assert 0.994 < high < 1


@pytest.mark.parametrize("scale", [1e-3, 1e6])
def test_scales(scale):
    """A mirror of 25 µm and one of 25 km: what has no unit stays, if the wavelength grows as well."""
    (found,) = mistray.image_quality(mistray.load(paraboloid(scale)), 0.0, wavelength_nm=550.0 * min(scale * 1e2, 1e3))
    assert found.rms_spot_mm() < 1e-5 * scale  # places of a scene are in float32
    assert found.f_number() == pytest.approx(4.0, rel=0.01)
    assert found.strehl == pytest.approx(1.0, abs=1e-4)


def test_table():
    steps: list[tuple[int, int]] = []
    scene, light = mistray.load(paraboloid()), {"wavelength_nm": [500, 600], "weights": [1, 2]}
    found = mistray.image_quality(scene, [0.0, 0.1], progress=lambda *of: steps.append(of), **light)
    assert steps == [(k, 4) for k in range(1, 5)]
    table = found.to_pandas([50.0])
    assert table.mtf_tangential_50_per_mm.between(0, 1).all()
    assert (list(table.field_deg), found.stop) == ([0.0, 0.1], "mirror")
    assert found.image_scale_mm == pytest.approx(FOCAL, rel=1e-6)
    assert found[0].shares == pytest.approx([1 / 3, 2 / 3])


def test_pictures_of_some_fields_hold_the_last_one_and_say_so(monkeypatch):
    """And spots are named where there are more wavelengths than colours."""
    found = mistray.image_quality(mistray.load(paraboloid()), [0.0, 0.1, 0.2], grid=32)
    draws = (figures.mtf_figure, figures.psf_figure, figures.opd_figure, figures.spot_figure, figures.energy_figure)
    assert not any("fields" in draw(found).get_suptitle() for draw in draws)
    left, right, *_ = figures.psf_figure(found).axes[0].images[0].get_extent()
    assert left + right == pytest.approx(-(right - left) / figures.PIXELS)  # the pixel after the middle is about 0
    wave, pupil = figures.opd_figure(found).axes[0].images[0], found[0].main.pupil
    assert np.diff(wave.get_extent()[:2]) == pytest.approx(32 * pupil.step)
    monkeypatch.setattr(figures, "SHOWN", 2)
    for draw in draws:
        made = draw(found, "mirror")
        assert made.get_suptitle().endswith(", 2 of 3 fields")
        named = [text.get_text() for text in made.findobj(Text)]
        assert [any(text.startswith(image.name) for text in named) for image in found] == [True, False, True]
    monkeypatch.setattr(figures, "COLOURS", figures.COLOURS[:1])
    found = mistray.image_quality(mistray.load(paraboloid()), 0.0, wavelength_nm=[400, 500, 600], grid=16)
    (axes,) = figures.spot_figure(found).axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["400 nm", "500 nm", "600 nm"]


def test_a_cell_without_a_path_length_is_dark(monkeypatch):
    """It is left out of the wavefront, and the cells beside it keep their light."""
    scene, real = mistray.load(paraboloid()), pupil_grid.design_light

    def broken(*rays, throughput=False):
        light = real(*rays, throughput)
        if throughput:
            light.opl_mm[0] = np.nan
        return light

    whole = mistray.image_quality(scene, 0.0, grid=32)[0].main.pupil
    monkeypatch.setattr(pupil_grid, "design_light", broken)
    pupil = mistray.image_quality(scene, 0.0, grid=32)[0].main.pupil
    first = np.flatnonzero(whole.share)[0]
    np.testing.assert_array_equal(np.flatnonzero(pupil.share != whole.share), first)
    np.testing.assert_array_equal(np.delete(pupil.flux, first), np.delete(whole.flux, first))
    assert pupil.share.flat[first] == pupil.flux.flat[first] == 0


def test_wavelengths_count_by_the_light_that_arrives():
    """Through 5 mm of k = 2e-6, there and back: exp(-8πkt/λ), within 7° of the axis."""
    scene, glass = paraboloid(), "1.0+2e-6i"
    for name, z, media in (("front", -20.0, {"back": glass}), ("rear", -15.0, {"front": glass})):
        scene[name] = shape(z=z, semi_diameter=30.0, bsdf={"R": 0.0, "T": 1.0, **media})
    (found,) = mistray.image_quality(mistray.load(scene), 0.0, wavelength_nm=[500, 1000], weights=[1, 2])
    light = np.array([1, 2]) * np.exp(-8 * np.pi * 2e-6 * 5.0 / np.array([5e-4, 1e-3]))
    assert found.shares == pytest.approx(light / light.sum(), rel=2e-3)


@pytest.mark.long
def test_spots_are_right_where_the_rim_is_steep():
    """A sag of A r¹² sends light 24 A f r¹¹ aside: RMS 24 A f R¹¹/√12 over a disc, to (R/f)²/2 = 0.8 %."""
    A, scene = 1e-17, paraboloid()
    scene["mirror"]["a12"] = A
    (found,) = mistray.image_quality(mistray.load(scene), 0.0, grid=16)
    expected = 24 * A * FOCAL * RADIUS**11 / math.sqrt(12 * (1 - OBSTRUCTION**2))
    assert found.rms_spot_mm() == pytest.approx(expected, rel=0.02)


def test_what_has_no_psf_and_what_is_refused():
    """A point at 300 mm before a lens that is focused at infinity: the spot is there, a note says why MTF is not."""
    found = mistray.image_quality(mistray.load("cooke_triplet", "point:0,0,-300"), field_mm=5.0)
    (image,) = found
    assert np.isnan([*image.mtf([10.0]), image.strehl]).all()
    assert np.isfinite(image.rms_spot_mm())
    assert "field 5 mm" in found.notes[0]
    scene, blind = mistray.load(paraboloid()), paraboloid()
    del blind["mirror"]
    each_refused(
        (mistray.load("cooke_triplet"), {"field_deg": 60.0}, r"field 60°.*no light"),
        (mistray.load("cooke_triplet"), {"field_deg": 14.0, "reference_radius_mm": 0.01}, "miss so small a sphere"),
        (scene, {"stop": "nobody"}, "'nobody'"),
        (mistray.load(blind), {}, "no image"),
        (mistray.load("cooke_triplet", "laser:0,0,-50,waist_x=1,waist_y=1"), {}, "neither far away nor a point"),
        by=lambda given, arguments: mistray.image_quality(given, **arguments),
    )


def test_near_object_and_azimuth():
    """An Offner relay images at 1:1 without distortion; its pupils lie far away, its MTF is nearly ideal."""
    axis, beside = found = mistray.image_quality(mistray.load("offner_relay"), field_mm=[0.0, 2.0], grid=48)
    assert found.magnification == pytest.approx(1.0, rel=1e-6)
    assert beside.field_mm == pytest.approx(2.0)
    assert np.linalg.norm(beside.image_mm - axis.image_mm) == pytest.approx(2.0, rel=1e-5)
    assert axis.strehl > 0.99
    f = np.linspace(0, 0.9, 10) * axis.cut_off_per_mm()
    assert axis.mtf(f) == pytest.approx(axis.diffraction_limit(f), abs=0.01)
    scene = mistray.load("cooke_triplet")
    up, aside = (mistray.image_quality(scene, 10.0, azimuth_deg=azimuth, grid=48)[0] for azimuth in (0.0, 30.0))
    turn = np.radians(30.0)
    expected = up.image_mm[1] * np.array([-np.sin(turn), np.cos(turn)])
    assert aside.image_mm == pytest.approx(expected, abs=1e-6)
    for azimuth in ("tangential", "sagittal"):
        assert aside.mtf([30.0], azimuth) == pytest.approx(up.mtf([30.0], azimuth), abs=0.005)


VANES = (OBSTRUCTION * RADIUS, RADIUS)  # mm from the axis, both ends


@pytest.fixture(scope="module")
def free():
    return mistray.image_quality(mistray.load(paraboloid()), 0.0, grid=64)[0]


@pytest.mark.parametrize(("width", "first_deg"), [(0.05, 45.0), (0.33, 0.0), (0.33, 20.0)])
def test_thin_vanes(free, width, first_deg):
    """Narrower than a cell of 0.4 mm, they take the area between the arcs at their ends, and MTF by autocorrelation."""
    scene, half = paraboloid(), (VANES[1] - VANES[0]) / 2 + 0.2
    for k in range(4):
        place = mi.ScalarTransform4f().translate([0, 0, -FOCAL - 5]).rotate([0, 0, 1], first_deg + 90 * k)
        scene[f"vane_{k}"] = shape(half_width=half, half_height=width / 2)
        scene[f"vane_{k}"]["to_world"] = place.translate([sum(VANES) / 2, 0, 0])
    image = mistray.image_quality(mistray.load(scene), 0.0, grid=64)[0]
    y = width * ((np.arange(1000) + 0.5) / 1000 - 0.5)
    inner, outer = (np.sqrt(r * r - y * y) for r in VANES)
    blocked = 4 * width * float(np.mean(outer - inner)) / (np.pi * (VANES[1] ** 2 - VANES[0] ** 2))
    found = 1 - image.main.pupil.share.sum() / free.main.pupil.share.sum()
    assert found == pytest.approx(blocked, abs=5e-4)
    if width < 0.1 or not first_deg:
        return
    # By the height at the mirror: the direction cosines of a paraboloid go with it to 0.4 %
    at = np.linspace(-RADIUS, RADIUS, 1501)
    x, y = np.meshgrid(at, at)
    ring = (np.hypot(x, y) < VANES[1]) & (np.hypot(x, y) > VANES[0])
    crossed = ring.copy()
    for k in range(4):
        turn = np.radians(first_deg + 90 * k)
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        crossed &= ~((along > 0) & (np.abs(across) < width / 2))
    for shift in (300, 600):  # 5 and 10 mm
        frequency = shift * (at[1] - at[0]) / (550e-6 * FOCAL)
        crossed_mtf, ring_mtf = (np.sum(p[:, shift:] & p[:, :-shift]) / np.sum(p) for p in (crossed, ring))
        found = (image.mtf(frequency, 0.0) - free.mtf(frequency, 0.0)).item()
        assert crossed_mtf - ring_mtf < -0.015
        assert found == pytest.approx(crossed_mtf - ring_mtf, abs=1e-3)


LINE = 632.8
LAGS_UM = np.array([0.0, 0.1, 1.0, 10.0, 50.0, 200.0, 1e3, 1e4])
B_UM = 400.0
KNEE = LINE * 1e-3 / B_UM  # in direction cosines: shares of the scattered light about this large go beyond the horizon


def mirror(rms_nm: float, **more) -> KCorrelation:
    return KCorrelation(rms_nm, B_UM, 3.0, event="reflection", **more)


@pytest.mark.parametrize("rms_nm", [3.0, 40.0, 90.0])
def test_the_full_theory_has_the_transfer_function_of_harvey(rms_nm):
    """Its BSDF is the transform of exp(a C/σ²) - 1, so that both agree but for light near the horizon."""
    a = (4 * math.pi * rms_nm / LINE) ** 2
    found = transfer_of_bsdf(mirror(rms_nm, theory="ghs_full"), LINE)
    expected = formulas.surface_transfer(formulas.exponential_correlation(LAGS_UM, B_UM / (2 * math.pi)), a)
    # Of the scattered light the horizon and the obliquity take a few of these
    few = 3 * KNEE * (1 + a) * a
    np.testing.assert_allclose(found.at_lag(LAGS_UM), expected, atol=few)
    assert found.at_lag(np.zeros(1))[0] == pytest.approx(1, abs=1e-12)
    assert found.plateau == pytest.approx(math.exp(-a), abs=few)


@pytest.mark.parametrize("event", ["reflection", "transmission"])
def test_bsdf_and_spectrum_agree_to_the_first_order(event):
    model = KCorrelation(5.0, B_UM, 2.6, event=event)
    n_out = 1.0 if event == "reflection" else 1.5
    by_bsdf = transfer_of_bsdf(model, LINE, event, 1.0, n_out)
    by_spectrum = transfer_of_spectrum(model, LINE, event, 1.0, n_out)
    a = by_spectrum.tis
    # Slope 2.6 leaves (B/λ)^-0.6 of the light at the horizon, where theories differ
    wide = (B_UM / (LINE * 1e-3)) ** -0.6
    np.testing.assert_allclose(by_bsdf.at_lag(LAGS_UM), by_spectrum.at_lag(LAGS_UM), atol=a * a / 2 + a * wide)
    assert by_bsdf.tis == pytest.approx(a, rel=a + wide)
    width = 1e-3
    found = transfer_of_bsdf(Gaussian(0.2, width), LINE)
    expected = 0.8 + 0.2 * np.exp(-((math.pi * width * LAGS_UM / (LINE * 1e-3)) ** 2))
    np.testing.assert_allclose(found.at_lag(LAGS_UM), expected, atol=0.2 * 1e-4)


def test_the_spectrum_of_a_band_is_the_closed_form_where_the_band_holds_all():
    """A table of a spectrum is that spectrum; oblique incidence lowers the phase, independent surfaces multiply."""
    a = (4 * math.pi * 10 / LINE) ** 2
    expected = formulas.surface_transfer(formulas.k_correlation(LAGS_UM, B_UM, 5.0), a)
    found = transfer_of_spectrum(KCorrelation(10.0, B_UM, 5.0, event="reflection"), LINE)
    np.testing.assert_allclose(found.at_lag(LAGS_UM), expected, atol=1e-4 * a)
    f = np.geomspace(1e-6, 4.0, 400)
    table = PsdTable(tuple(f.tolist()), tuple(mirror(4.0).psd(LINE)(f).tolist()), event="reflection")
    of_table, one = (transfer_of_spectrum(model, LINE) for model in (table, mirror(4.0)))
    np.testing.assert_allclose(of_table.at_lag(LAGS_UM), one.at_lag(LAGS_UM), atol=1e-6)
    np.testing.assert_allclose(product([one, one], [LAGS_UM, LAGS_UM]), one.at_lag(LAGS_UM) ** 2)
    oblique = transfer_of_spectrum(mirror(4.0), LINE, cos_i=0.5)
    assert math.log(oblique.plateau) == pytest.approx(math.log(one.plateau) * 0.5**2, rel=1e-9)
    nu = np.array([0.0, 1.0, 30.0])  # frequencies are lags by f-number and footprint
    np.testing.assert_allclose(one.at(nu, 5.0, 20.0), one.at_lag(LINE * 1e-3 * 5.0 * 20.0 * nu))


@pytest.mark.parametrize(
    "model", [ABg(1e-4, 1e-5, 2.0), HarveyShack(0.5), Particulate(level=500.0), Paint(0.04), mirror(5.0)]
)
def test_tis_is_the_integral_of_the_lobes_at_every_angle(model):
    for angle in (0.0, 45.0, 80.0):
        cos_i = math.cos(math.radians(angle))
        found = transfer_of_bsdf(model, LINE, cos_i=cos_i, share=0.9)
        scattered, lost = 0.0, 0.0
        for lobe in (lobe for lobe in model.lobes(LINE, 1.0, 1.0, True) if lobe.event == "reflection"):
            total = float(lobe_total(lobe, np.array([cos_i]), 1.0, 1.0)[0])
            scattered += float(np.polyval(lobe.shares[::-1], 0.9)) * total
            depth = lobe.optical_depth
            lost += lobe.shares[1] * total if depth is None else depth * float(lobe.oblique(np.array([cos_i]))[0])
        assert found.tis == pytest.approx(scattered / (scattered + 0.9 * (1 - lost)), rel=1e-9)
        values = found.at_lag(np.array([0.0, 1e-3, 1e6]))
        assert values[0] == pytest.approx(1, abs=1e-9)
        assert values[2] == pytest.approx(found.plateau, abs=1e-3)


def test_a_smooth_surface_changes_nothing_and_a_rough_one_is_told():
    for found in (
        transfer_of_spectrum(mirror(0.0), LINE),
        transfer_of_bsdf(mirror(0.0), LINE),
        transfer_of_bsdf(ABg(0.0, 1e-5, 2.0), LINE),
        transfer_of_spectrum(mirror(5.0, side="front"), LINE, "transmission", 1.5, 1.5),
    ):
        assert found.tis == 0
        np.testing.assert_array_equal(found.at([0.0, 100.0], 4.0, 25.0), 1)
    with pytest.warns(MistrayWarning, match="not smooth in reflection at 632.8 nm"):
        found = transfer_of_spectrum(mirror(120.0), LINE)
    assert found.plateau == pytest.approx(math.exp(-((4 * math.pi * 120 / LINE) ** 2)), rel=0.02)
    assert transfer_of_spectrum(mirror(120.0), 10600.0).tis == pytest.approx((4 * math.pi * 120 / 10600) ** 2, rel=0.05)
    each_refused(
        (lambda: transfer_of_bsdf(mirror(1.0), LINE, "both"), "event"),
        (lambda: transfer_of_spectrum(mirror(1.0), 0.5), "wavelength_nm"),
        (lambda: transfer_of_bsdf(mirror(1.0), LINE, "transmission", 1.5, 1.0, cos_i=0.2), "totally reflected"),
        (lambda: transfer_of_bsdf(mirror(1.0), LINE, share=0.0), "nothing goes on"),
        (lambda: transfer_of_spectrum(mirror(1.0), LINE).at([1.0], 0.0, 1.0), "f_number"),
        (lambda: transfer_of_spectrum(mirror(1.0), LINE).at([-1.0], 1.0, 1.0), "frequencies_per_mm"),
    )

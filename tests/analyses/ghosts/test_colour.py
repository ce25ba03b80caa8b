"""Colour pictures against published colorimetry: the observer, sRGB, white, exposure, coatings."""

import subprocess
import sys

import numpy as np
import pytest
from analyses.fake_trace import EXTENT, LENS, SHAPE, SHARES, FakePath, FakeTrace, ghosts_of, trace_at
from oracles import colour as oracle

from mistray.analyses.ghosts.colour import ColourPictures, Look, check_wavelengths, develop, observer, xyz
from mistray.analyses.ghosts.spectral import SpectralMaps
from mistray.errors import MistrayError
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES

VISIBLE = np.arange(400.0, 701.0, 10.0)
DESIGN_NM, GLASS = 550.0, 1.5168


class SmoothTrace(FakeTrace):
    def sampled(self, path_ids):
        x0, x1, y0, y1 = EXTENT
        x = np.linspace(x0, x1, 2 * SHAPE[1] + 1)[1::2]
        y = np.linspace(y0, y1, 2 * SHAPE[0] + 1)[1::2][:, None]
        image = np.zeros(SHAPE)
        for path in (self.fakes[path_id] for path_id in path_ids):
            inside = np.hypot(x - path.x, y - path.y) < path.radius
            image[inside] += path.power / (np.pi * path.radius**2)
        return Sampled(image, np.zeros((*SHAPE, BATCHES)))


IMAGE = f"{LENS} detector:A"
FULL_GHOST, RED_GHOST = (f"{LENS} detector:R {surface}:R detector:A" for surface in ("L1_rear", "L1_front"))
GREY, YELLOW, DIRECT = (-1.0, 0.0), (1.0, 0.0), (0.0, 1.0)


def at(image, place):
    column = (place[0] - EXTENT[0]) / (EXTENT[1] - EXTENT[0]) * SHAPE[1]
    row = (place[1] - EXTENT[2]) / (EXTENT[3] - EXTENT[2]) * SHAPE[0]
    return image[int(row), int(column)]


def trace(field_deg, level):
    """Direct image, a ghost with the spectrum of the source, and one that lacks 450 nm; radii 0.1, 0.5 and 0.4 mm."""
    paths = []
    for wavelength, share in SHARES.items():
        paths.append(FakePath(IMAGE, 3.0 * share, 10, *DIRECT, 0.1, wavelength=wavelength))
        paths.append(FakePath(FULL_GHOST, 1e-4 * level * share, 10, *GREY, 0.5, wavelength=wavelength))
        if wavelength > 500:
            paths.append(FakePath(RED_GHOST, 5e-5 * level * share, 10, *YELLOW, 0.4, wavelength=wavelength))
    return SmoothTrace(paths, field_deg, shares=SHARES)


@pytest.fixture(scope="module")
def report():
    return ghosts_of(trace(0.0, 1.0), trace(20.0, 0.3))


def test_observer_is_the_published_one():
    """Light of equal energy over 360 … 830 nm is white: the observer is normalised to this within 1e-4."""
    for wavelength, published in oracle.OBSERVER.items():
        np.testing.assert_allclose(observer([wavelength])[0], published, atol=1e-6)
    between = 0.75 * observer([555])[0] + 0.25 * observer([556])[0]
    np.testing.assert_allclose(observer([555.25])[0], between, rtol=1e-12)
    for wavelength, published in oracle.SPECTRUM_LOCUS.items():
        np.testing.assert_allclose(oracle.chromaticity(xyz([3e-4], [wavelength])), published, atol=1e-5)
    wavelengths = np.arange(360.0, 831.0)
    np.testing.assert_allclose(oracle.chromaticity(xyz(np.ones(471), wavelengths)), [1 / 3, 1 / 3], atol=1e-4)


@pytest.mark.long
def test_the_colour_package_leaves_numpy_s_printing_alone():
    """It would cut the numbers of every CSV file that pandas writes afterwards to twelve digits."""
    code = (
        "import numpy as np; before = np.get_printoptions(); from mistray.analyses.ghosts.colour import observer; "
        "observer([550.0]); assert np.get_printoptions() == before; print(repr(np.float64(0.1)))"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, "np.float64(0.1)"), done.stderr


@pytest.mark.parametrize("weights", [(1, 1, 1), (1, 2, 1), (5, 1, 2)])
@pytest.mark.parametrize("level", [1e-6, 0.18, 1.0])
def test_light_of_the_source_is_grey(weights, level):
    source = xyz(weights, [450.0, 550.0, 650.0])
    got = develop(level * source, 1 / source[1], source)
    np.testing.assert_allclose(got.rgb, oracle.encode(np.full(3, level)), rtol=1e-9)
    assert (got.outside, got.overexposed) == (0, 0)


def test_without_adaptation_it_is_srgb():
    """Random colours inside of the gamut, by a matrix from the primaries and the white of IEC 61966-2-1."""
    linear = np.random.default_rng(3).random((200, 3))
    got = develop(linear @ oracle.rgb_to_xyz().T, 1.0)
    np.testing.assert_allclose(got.rgb, oracle.encode(linear), atol=1e-9)
    assert (got.outside, got.overexposed) == (0, 0)
    # Overexposed light goes towards white, and darkness is black
    source = xyz([1, 1, 1], [450.0, 550.0, 650.0])
    got = develop(np.array([0.5, 1.0, 40.0])[:, None] * source, 1 / source[1], source)
    np.testing.assert_allclose(got.rgb[1:], 1.0)
    assert got.overexposed == pytest.approx(1 / 3)
    got = develop(np.zeros((2, 2, 3)), 1.0)
    assert ((got.rgb == 0).all(), got.outside, got.overexposed) == (True, 0, 0)


@pytest.mark.parametrize("white", [None, xyz([1, 2, 1], [450.0, 550.0, 650.0])])
def test_luminance_is_linear_for_every_colour(white):
    """Also outside of the gamut and with adaptation; 5e-3 of the luminance of white is the brightest that is safe."""
    wavelengths = np.arange(420.0, 701.0, 20.0)
    light = np.array([xyz([1.0], [wavelength]) for wavelength in wavelengths])
    light *= (np.linspace(5e-4, 5e-3, len(light)) / light[:, 1])[:, None]
    got = develop(light, 2.0, white)
    luminance = oracle.decode(got.rgb) @ oracle.rgb_to_xyz()[1]
    np.testing.assert_allclose(luminance, 2 * light[:, 1], rtol=1e-6)
    assert (got.outside, got.overexposed) == (1, 0)


def reflected(layers):
    """XYZ of white light that a coating on glass reflects at normal incidence, and that of the light itself."""
    power = oracle.stack_in_air(layers, GLASS, VISIBLE)
    return xyz(power, VISIBLE), xyz(np.ones(len(VISIBLE)), VISIBLE)


def test_colours_of_coatings():
    """Bare glass is grey, a quarter wave of MgF2 a weak purple, a V coat, whose R = 0 at 550 nm, blue and magenta."""
    light, white = reflected([])
    assert light[1] / white[1] == pytest.approx(oracle.bare(GLASS), rel=1e-12)
    np.testing.assert_allclose(np.ptp(develop(light, 0.2 / light[1], white).rgb), 0, atol=1e-12)
    light, white = reflected([(1.38, DESIGN_NM / 4 / 1.38)])  # R rises from 1.26 % to both ends, more to the blue
    red, green, blue = oracle.decode(develop(light, 0.2 / light[1], white).rgb)
    assert green < 0.95 * red < 0.95 * blue
    assert light[1] / white[1] == pytest.approx(0.01326, abs=2e-5)
    np.testing.assert_allclose(oracle.chromaticity(light), [0.3211, 0.3046], atol=2e-4)
    light, white = reflected([(1.38, 0.31797 * DESIGN_NM / 1.38), (2.10, 0.06703 * DESIGN_NM / 2.10)])
    red, green, blue = oracle.decode(develop(light, 0.02 / light[1], white).rgb)
    assert green < 0.01 * blue
    assert 0.1 * blue < red < blue
    np.testing.assert_allclose(oracle.chromaticity(light), [0.2129, 0.0734], atol=2e-4)  # far below white at 1/3


def luminance(picture):
    return oracle.decode(picture.rgb) @ oracle.rgb_to_xyz()[1]


def test_brightest_ghost_of_all_fields_is_white_at_no_stops(report):
    """Discs of 1e-4 W and 0.5 mm: the grey one is the brightest, since 450 nm adds hardly any luminance to it."""
    pictures = ColourPictures(report, Look(block=1))
    y = {nm: oracle.OBSERVER[nm][1] for nm in (450.0, 650.0)} | {550.0: observer([550.0])[0, 1]}
    grey = 1e-4 / (np.pi * 0.5**2) * sum(share * y[nm] for nm, share in SHARES.items())
    yellow = 5e-5 / (np.pi * 0.4**2) * sum(share * y[nm] for nm, share in SHARES.items() if nm > 500)
    assert grey > yellow
    np.testing.assert_allclose(at(pictures.stray[0.0].rgb, GREY), 1, rtol=1e-9)
    np.testing.assert_allclose(luminance(pictures.stray[20.0])[0, 0], 0)
    assert at(luminance(pictures.stray[20.0]), GREY) == pytest.approx(0.3, rel=1e-6)
    assert at(luminance(pictures.stray[20.0]), YELLOW) == pytest.approx(0.3 * yellow / grey, rel=1e-5)
    dim, bright = (luminance(ColourPictures(report, Look(block=1, stops=stops)).stray[0.0]) for stops in (-4.0, -3.0))
    assert at(bright, GREY) == pytest.approx(1 / 8, rel=1e-6)
    np.testing.assert_allclose(bright, 2 * dim, rtol=1e-6)


def test_exposure_over_the_direct_image_leaves_the_ghosts_dark(report):
    pictures = ColourPictures(report, Look(block=1, reference="direct"))
    np.testing.assert_allclose(at(pictures.all_light[0.0].rgb, DIRECT), 1, rtol=1e-9)
    assert pictures.all_light[0.0].overexposed == 0
    ratio = 1e-4 / 0.5**2 / (3 / 0.1**2)
    assert at(luminance(pictures.stray[0.0]), GREY) == pytest.approx(ratio, rel=1e-6)
    assert (at(pictures.stray[0.0].rgb, DIRECT) == 0).all()
    light = [FakePath(IMAGE, 1.0, 10, *DIRECT, 0.1, wavelength=wavelength) for wavelength in SHARES]
    t = SmoothTrace(light, shares=SHARES)
    pictures = ColourPictures(ghosts_of(t), Look(block=1))
    assert (pictures.all_light[0.0].rgb == 0).all()

    pictures = ColourPictures(report, Look(block=1, stops=1.0, white="D65"))
    figure = pictures.figure(0.0)
    left, right = (axes.get_images()[0] for axes in figure.axes)
    np.testing.assert_array_equal(left.get_array(), pictures.all_light[0.0].rgb)
    np.testing.assert_array_equal(right.get_array(), pictures.stray[0.0].rgb)
    assert tuple(left.get_extent()) == report[0.0].extent
    caption = figure.get_supxlabel()
    assert all(words in caption for words in ("450, 550, 650 nm", "white: D65", "+1 stops over the brightest ghost"))
    # Noise asks for blocks: 4 × 4 pixels hold 16 times the rays; the mean irradiance stays
    stray = np.random.default_rng(0).poisson(8.0, (3, 60, 40)).astype(float)
    maps = SpectralMaps(
        np.array([450.0, 550.0, 650.0]), np.ones(3), np.zeros_like(stray), stray, stray.sum(axis=(1, 2))
    )
    assert [maps.block_for(noise) for noise in (100.0, 5.0, 1e9)] == [4, 1, 20]
    binned = maps.binned(4)
    assert binned.stray.shape == (3, 15, 10)
    np.testing.assert_allclose(binned.stray.mean(axis=(1, 2)), stray.mean(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(binned.stray[1, 2, 3], stray[1, 8:12, 12:16].mean(), rtol=1e-12)
    assert "pixels averaged" in ColourPictures(report, Look(block=2)).caption(0.0)


def test_what_gives_no_colour_is_refused(report):
    red = xyz([1, 1, 1], [660.0, 680.0, 700.0])
    for call, words in (
        (lambda: check_wavelengths([450.0, 550.0, 1064.0]), "1064 nm is not visible; .* from 360 to 830 nm"),
        (lambda: ColourPictures(ghosts_of(trace_at(0.0))), r"1 wavelength \(550 nm\); .* needs at least 3"),
        (lambda: develop(red, 1.0, red), "too saturated to be taken as white; use white D65"),
        (lambda: Look(stops=float("nan")), "stops is nan"),
        (lambda: Look(reference="sky"), "reference is 'sky"),
        (lambda: Look(white="E"), "white is 'E"),
        (lambda: Look(block=-1), "block is -1"),
        (lambda: ColourPictures(report, Look(block=7)), "blocks of 7 pixels do not fill"),
    ):
        with pytest.raises(MistrayError, match=words):
            call()

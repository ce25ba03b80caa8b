"""Pictures, curves and colours of ghosts: what they show is what was traced, and white is white."""

import ast
import importlib
import io
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from analyses.fake_scene import FakeShape, lens_scene
from analyses.fake_trace import EXTENT, LENS, SHAPE, SHARES, FakePath, FakeTrace, ghosts_of, trace_at
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.text import Text
from oracles import colour as oracle
from refusals import each_refused, refused

import mistray
from mistray.analyses.bsdf.figures import bsdf_figure, particles_figure
from mistray.analyses.coating.figures import coated_surfaces, coating_figure, surfaces_figure
from mistray.analyses.ghosts.colour import ColourPictures, Look, check_wavelengths, develop, observer, xyz
from mistray.analyses.ghosts.figures.ghost_images import common_range, ghost_image, levels_against_field, montage
from mistray.analyses.ghosts.spectral import SpectralMaps
from mistray.coatings import Bare, preset, spectrum
from mistray.prescription.baffles.cassegrain import cassegrain_baffles
from mistray.prescription.baffles.two_stage import two_stage_baffle
from mistray.prescription.baffles.vane_tube import vane_tube
from mistray.prescription.baffles.zones import first_order_zones, lit_zones, seen_zones
from mistray.recorders.sampled import Sampled
from mistray.scatter.abg import ABg
from mistray.scatter.paint import Paint
from mistray.scatter.scan import scan
from mistray.settings import BATCHES
from mistray.toolkit.drawings.baffles import baffle_figure, cassegrain_figure
from mistray.toolkit.drawings.section_layout import glass_bodies, layout, meridional, section
from mistray.toolkit.figures.figure import Figure, legend_label
from mistray.toolkit.figures.palette import BLUE, ORANGE, VERMILION
from mistray.toolkit.figures.plots import draw_map, image_colours
from mistray.toolkit.irradiance import averaged, log_range


@pytest.fixture(scope="module")
def report():
    return ghosts_of(*map(trace_at, (0.0, 10.0, 20.0)))


def scene_of(*shapes):
    return SimpleNamespace(shapes=lambda: list(shapes))


def images(figure):
    return [image for axes in figure.axes for image in axes.get_images() if image.get_array().ndim == 2]


def test_ghost_image_shows_log10_of_the_map(report):
    whole, stray = images(ghost_image(report, 10.0))
    t, (map_, _) = report[10.0], report.stray_map(10.0)
    for image, expected in ((whole, t.irradiance), (stray, map_)):
        floor, top = image.get_clim()
        assert (floor, top) == log_range([expected], 8.0)
        lit = expected >= 10**floor
        np.testing.assert_allclose(image.get_array()[lit], np.log10(expected[lit]))
        assert np.ma.masked_invalid(image.get_array()).mask[~lit].all()
        assert tuple(image.get_extent()) == pytest.approx(t.extent)
    assert stray.get_clim()[1] < whole.get_clim()[1]
    assert {image.get_clim() for image in images(ghost_image(report, 10.0, (-7.0, 3.0)))} == {(-7.0, 3.0)}
    (image,) = images(ghost_image(report, 20.0))
    assert np.nansum(10 ** image.get_array()) == pytest.approx(report[20.0].irradiance.sum(), rel=1e-6)
    # A montage shows stray light on scales of their own, or on one
    own, common = images(montage(report)), images(montage(report, common=True))
    assert [image.get_clim() for image in own] == [log_range([report.stray_map(field)[0]], 8.0) for field in report]
    assert {image.get_clim() for image in common} == {common_range(report, stray=True)}
    brightest = max(float(np.nanmax(image.get_array())) for image in own)
    assert brightest < np.log10(report[0.0].irradiance.max()) - 1  # no direct image
    # A layout draws the worst ghosts, or the paths asked for
    both = ["detector → L1_rear (ghost)", "detector → window_rear (ghost)"]
    for field, ghosts, wanted in ((10.0, 2, ["direct image", *both]), (10.0, 0, ["direct image"]), (20.0, 1, both)):
        assert layout(report, field, ghosts=ghosts).axes[0].get_legend_handles_labels()[1] == wanted
    table = report.table(10.0)
    direct, other = (table.path_id[rows].iloc[0] for rows in (table.kind == "direct", table.ghost_2 == "window_rear"))
    handles, labels = layout(report, 10.0, path_ids=[direct, other]).axes[0].get_legend_handles_labels()
    assert labels == [f"path {direct}: direct image", f"path {other}: detector → window_rear"]
    assert handles[0].get_color() != handles[1].get_color()
    with refused("path_id 99 does not exist"):
        layout(report, 10.0, path_ids=[99])


def test_averaged_colours_and_dark_maps(report):
    """Odd sizes: squares at the far edges reach beyond the map and have the mean of what lies on it."""
    image = np.random.default_rng(4).random((11, 7))
    coarse, extent = averaged(image, (-1.0, 2.5, 0.0, 5.5), 4)
    assert coarse.shape == (4, 3)
    assert extent == (-1.0, 3.5, 0.0, 6.0)
    np.testing.assert_allclose(coarse[1, 0], image[3:6, :3].mean())
    np.testing.assert_allclose(coarse[3, 2], image[9:, 6:].mean())
    np.testing.assert_array_equal(averaged(image, (0.0, 1.0, 0.0, 1.0), 11)[0], image)
    # Lightness of the colour map must rise without a break, or steps appear that are not in the data
    rgb = image_colours()(np.linspace(0, 1, 64))[:, :3]
    luminance = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance) > 0).all()
    axes, extent = Figure().subplots(), (-1.0, 1.0, -1.0, 1.0)
    assert draw_map(axes, np.zeros((4, 4)), extent, None) is None
    assert [text.get_text() for text in axes.texts] == ["no light"]
    with refused("the floor must lie below the top"):
        draw_map(axes, np.ones((2, 2)), extent, (2.0, 1.0))
    few, value = report.stray_light(20.0).few_rays, report.stray_map(20.0)[0]
    image, hatch = (image for axes in ghost_image(report, 20.0).axes for image in axes.get_images())
    lines = hatch.get_array()[..., 3] > 0
    size = lines.shape[0] // value.shape[0]
    assert size >= 1
    hatched = lines.reshape(value.shape[0], size, value.shape[1], size).any(axis=(1, 3))
    assert not hatched[~few | (value < 10.0 ** image.get_clim()[0])].any()
    assert hatched.any()
    # Levels leave out what a logarithmic axis cannot show
    left = levels_against_field(report).axes[0]
    assert left.get_legend_handles_labels()[1] == ["direct image", "ghost", "structure"]
    np.testing.assert_array_equal(left.containers[0].lines[0].get_xdata(), [0.0, 10.0])
    # A layout says which path is too rare
    t = trace_at(20.0)
    sampled = t.sampled_rays
    (kept,) = [k for k, path in enumerate(t.fakes) if "detector:R L1_rear:R" in path.events]
    t.sampled_rays = lambda ids, n: {i: rays if i == kept else [] for i, rays in sampled(ids, n).items()}
    drawn = layout(ghosts_of(t, nominal=trace_at(0.0)), 20.0, ghosts=2).axes[0]
    told = ["detector → L1_rear (ghost)", "detector → window_rear (ghost), too rare to draw"]
    assert drawn.get_legend_handles_labels()[1] == told


def test_sections_glass_and_rays_of_a_layout():
    mirror = FakeShape("fold", "fold", [[0.0, 0.0], [1.0, 0.0]], 0.0, mirror=True)
    c = np.sqrt(0.5)
    mirror.matrix[:3, :3] = [[1, 0, 0], [0, c, -c], [0, c, c]]
    (surface,) = section(scene_of(mirror))
    assert surface.kind == "mirror"
    np.testing.assert_allclose(surface.lines[0][-1], [c, c], atol=1e-12)
    # L1 of the fake lens has rims at r = 1 and an edge of r = 1 between z = 1.05 and 1.5; here one that is pointed
    window, _ = glass_bodies(lens_scene())
    assert (window[:, 0].min(), window[:, 0].max(), window[:, 1].max()) == (0.0, 0.3, 1.2)
    front, rear, _ = (shape for shape in lens_scene().shapes() if shape.part == "L1")
    sides = [
        FakeShape(name, "L1", [[1.0, z], [1.2, 1.2]], 0.0, "nd=1.6 Vd=30", "air", opaque=True)
        for name, z in (("L1_edge", 1.05), ("L1_bevel", 1.5))
    ]
    (body,) = glass_bodies(scene_of(front, rear, *sides))
    assert (body[:, 1].max(), body[:, 1].min()) == (1.2, -1.2)
    # Meridional rays spread over the pupil and stay near the plane
    starts = np.random.default_rng(0).uniform(-1, 1, (64, 2))
    rays = [np.array([[x, y, 0.0], [x, y, 1.0]]) for x, y in starts]
    chosen = meridional(rays, 7)
    assert len(chosen) == 7
    assert np.ptp([ray[0, 1] for ray in chosen]) > 1.2
    assert np.mean([abs(ray[0, 0]) for ray in chosen]) < 0.5 * np.mean(np.abs(starts[:, 0]))
    assert [len(meridional(rays[:n], 7)) for n in (0, 2)] == [0, 2]


TUBE = vane_tube("tube", optic_radius=18, z_rear=102, length=102, wall_radius=30, field_deg=4)


def zones(figure, colour):
    """(z0, z1) of the bands of a colour above the axis, sorted."""
    found = []
    for band in figure.axes[0].findobj(PolyCollection):
        if tuple(band.get_facecolor()[0]) == to_rgba(colour):
            z, r = band.get_paths()[0].vertices.T
            if r.min() > 0:
                found.append((z.min(), z.max()))
    return sorted(found)


def test_zones_are_drawn():
    spoiled = replace(TUBE, vanes=TUBE.vanes[:3] + TUBE.vanes[4:])
    for tube in (TUBE, spoiled):
        figure = baffle_figure(tube)
        drawn = ((ORANGE, lit_zones(tube)), (BLUE, seen_zones(tube)), (VERMILION, first_order_zones(tube)))
        for colour, wanted in drawn:
            assert zones(figure, colour) == [pytest.approx(zone) for zone in wanted]
    assert zones(baffle_figure(spoiled), VERMILION)
    assert not zones(baffle_figure(TUBE), VERMILION)
    lines = [line for line in baffle_figure(TUBE).axes[0].lines if line.get_color() == BLUE]
    assert len(lines) == len(TUBE.vanes)
    for line, vane in zip(lines, TUBE.vanes, strict=True):
        (z0, z1), (r0, r1) = line.get_data()
        assert (z0, r0) == (102, -18)
        assert r0 + (r1 - r0) * (vane.z - z0) / (z1 - z0) == pytest.approx(vane.radius)


def test_two_stages_and_a_cassegrain_are_drawn():
    baffle = two_stage_baffle("b", optic_radius=10, z_rear=0, field_deg=5, exclusion_deg=40, depth=8)
    drawn = zones(baffle_figure(baffle, exclusion_deg=40), ORANGE)
    assert len(drawn) == len(lit_zones(baffle.outer, 40.0)) + len(lit_zones(baffle.inner))
    telescope = importlib.import_module("mistray.scenes.cassegrain.prescription").build()
    primary, secondary = telescope.surfaces
    rims = cassegrain_baffles(primary, secondary, telescope.detector, field_deg=0.28, wall_depth=4, wall_rear=26)
    picture = cassegrain_figure(telescope, rims, title="telescope")
    assert [text.get_text() for text in picture.axes[0].texts] == ["A", "B"]


ANGLES = (0.0, 30.0, 60.0)


def labels(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_models() -> None:
    left, right = bsdf_figure(scan(ABg(0.0025, 0.001, 1.8), ANGLES), "ABg", knee=0.0215).axes
    assert labels(left) == ["all angles of incidence"]  # one curve, for it depends on |β - β0| alone
    assert labels(right) == ["0°: TIS 4.134 %", "30°: TIS 3.936 %", "60°: TIS 3.258 %"]
    r, f = left.lines[0].get_data()
    np.testing.assert_allclose(f, 0.0025 / (0.001 + np.asarray(r) ** 1.8), rtol=1e-12)
    for line, angle in zip(right.lines, ANGLES, strict=True):
        theta, f = line.get_data()
        assert theta[np.argmax(f)] == pytest.approx(angle, abs=1e-6)
        assert np.max(f) == pytest.approx(2.5)
    # One that grows away from the normal is drawn for each angle; a Lambertian one is a straight line
    left, _ = bsdf_figure(scan(Paint(0.04, b0=0.05, l=0.1, s=-3, n=1.5), ANGLES), "paint").axes
    assert labels(left) == ["0°", "30°", "60°"]
    left, right = bsdf_figure(scan(Paint(0.3), ANGLES), "paint").axes
    assert labels(left) == ["all angles of incidence"]
    low, high = right.get_ylim()
    assert low < 0.3 / np.pi < high
    with refused("one or more angles"):
        bsdf_figure([], "none")
    left, right = particles_figure(300).axes
    (own,) = [line for line in left.lines if line.get_label() == "level 300"]
    diameter, count = own.get_data()
    assert count[0] == pytest.approx(10 ** (0.926 * np.log10(300) ** 2), rel=1e-9)
    assert (diameter[-1], count[-1]) == (pytest.approx(300), pytest.approx(1))  # one particle of the level's diameter
    assert "level 300: 0.02531 %" in labels(right)  # area of the spheres
    (standard,) = [line for line in right.lines if line.get_label() == "formula of the standard"]
    levels, area = standard.get_data()
    assert 10 ** np.interp(np.log10(396), np.log10(levels), np.log10(area)) == pytest.approx(0.10085, rel=1e-3)
    assert "formula of the standard" not in labels(particles_figure(300, 0.383).axes[1])


WAVELENGTHS = np.arange(450.0, 651.0, 50.0)


def curve(axes, label: str) -> np.ndarray:
    return next(item for item in axes.get_lines() if item.get_label() == label).get_ydata()


def test_lines_are_the_spectra() -> None:
    left, right = coating_figure(preset("bbar3"), WAVELENGTHS, [0.0, 40.0], back="1.5168").axes
    values = spectrum(preset("bbar3"), WAVELENGTHS, [0.0, 40.0], back="1.5168")
    np.testing.assert_allclose(curve(left, "0°"), 100 * values.mean()[:, 0])
    (colour,) = (item.get_color() for item in left.get_lines() if item.get_label() == "40°")
    drawn = {item.get_linestyle(): item.get_ydata() for item in left.get_lines() if item.get_color() == colour}
    for style, share in (("-", values.mean()[:, 1]), ("--", values.R[:, 1, 0]), (":", values.R[:, 1, 1])):
        np.testing.assert_allclose(drawn[style], 100 * share)
    for nm in (450, 550, 650):
        (item,) = (item for item in right.get_lines() if item.get_label() == f"{nm} nm")
        at = spectrum(preset("bbar3"), [nm], item.get_xdata(), back="1.5168").mean()[0]
        np.testing.assert_allclose(item.get_ydata(), 100 * at)
    assert curve(left, "bare, 0°")[0] == pytest.approx(4.21646, abs=1e-4)
    mirror, _ = coating_figure(preset("protected_al"), WAVELENGTHS, [0.0]).axes
    assert mirror.get_yscale() == "linear"
    assert not any(str(item.get_label()).startswith("bare") for item in mirror.get_lines())


def test_one_row_for_each_kind_of_surface() -> None:
    coated = {"back": "1.6", "coating": {"type": "ref", "id": "ar"}}
    bsdfs = {"a": coated, "b": {"front": "1.6", "back": "air"}, "c": coated}
    bsdfs |= {"d": {"front": "1.6", "R": 0.9, "mirror": True}, "wall": {"R": 0.0}}
    shapes = {
        name: {"type": "asphere", "semi_diameter": 5.0, "z": 2.0 * k, "bsdf": {"type": "interface", **bsdf}}
        for k, (name, bsdf) in enumerate(bsdfs.items())
    }
    scene = mistray.load({"type": "scene", "ar": {"type": "thinfilm", "preset": "bbar3"}, **shapes})
    groups = coated_surfaces(scene)
    assert [group.names for group in groups] == [("a", "c"), ("b",), ("d",)]
    assert groups[0].coating.name == "ar"
    assert (groups[1].front, groups[1].back) == ("1.6", "air")
    assert isinstance(groups[1].coating, Bare)
    figure = surfaces_figure(groups, WAVELENGTHS, [0.0, 30.0])
    assert len(figure.axes) == 6
    first = figure.axes[0]
    assert first.get_title(loc="left") == "a, c"
    expected = spectrum(groups[0].coating, WAVELENGTHS, [30.0], "air", "1.6").mean()[:, 0]
    np.testing.assert_allclose(curve(first, "30°"), 100 * expected)
    # the rear of a lens is drawn from the air as well
    behind = spectrum(Bare(), WAVELENGTHS, [30.0], "1.6", "air", from_front=False).mean()[:, 0]
    np.testing.assert_allclose(curve(figure.axes[2], "30°"), 100 * behind)
    with refused("no optical surface"):
        coated_surfaces(SimpleNamespace(shapes=list))


@pytest.mark.parametrize("name", [r"$\frac{", r"a$b_{$", r"$x^2_1$", r"\$", "_^\\", '<i>"q"&</script>'])
@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_any_name_can_stand_anywhere(name: str, kind: str) -> None:
    figure = Figure(figsize=(3, 3), layout="constrained")
    axes = figure.subplots()
    axes.plot([1, 2], [1, 1e3], label=f"path {name}")
    axes.set_yscale("log")
    axes.set_xticks([1, 2], [name, name], rotation=30)
    axes.set(title=name, xlabel=name)
    axes.annotate(name, (1, 1))
    figure.suptitle(name)
    figure.supxlabel(name)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", title=name)
    figure.savefig(io.BytesIO(), format=kind, bbox_inches="tight")
    shown = [text for text in figure.findobj(Text) if name in text.get_text()]
    assert len(shown) >= 9
    assert not any(text.get_parse_math() for text in shown)
    powers = [label for label in axes.get_yticklabels() if "10^" in label.get_text()]
    assert powers
    assert all(label.get_parse_math() for label in powers)


def test_a_legend_has_all_names_and_no_report_has_another_figure() -> None:
    axes = Figure().subplots()
    for name in ("_edge", "edge", "__"):
        axes.plot([0, 1], [0, 1], label=legend_label(name))
    assert [text.get_text().strip() for text in axes.legend().get_texts()] == ["_edge", "edge", "__"]
    top = Path(mistray.__file__).parent
    for file in [file for folder in ("analyses", "toolkit") for file in (top / folder).rglob("*.py")]:
        for one in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = {name.name for name in one.names} if isinstance(one, ast.Import) else {getattr(one, "module", "")}
            assert file.name == "figure.py" or not names & {"matplotlib.figure", "matplotlib.pyplot"}, file.name


class SmoothTrace(FakeTrace):
    def sampled(self, path_ids):
        x0, x1, y0, y1 = EXTENT
        x = np.linspace(x0, x1, 2 * SHAPE[1] + 1)[1::2]
        y = np.linspace(y0, y1, 2 * SHAPE[0] + 1)[1::2][:, None]
        image = np.zeros(SHAPE)
        for path in (self.fakes[path_id] for path_id in path_ids):
            image[np.hypot(x - path.x, y - path.y) < path.radius] += path.power / (np.pi * path.radius**2)
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
def discs():
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
    line = np.tile(xyz([1], [520.0]), (3, 4, 1))  # outside sRGB, and not exposed
    assert develop(line, 0.0).outside == 1


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


VISIBLE, DESIGN_NM, GLASS = np.arange(400.0, 701.0, 10.0), 550.0, 1.5168


def reflected(layers):
    """XYZ of white light that a coating on glass reflects at normal incidence, and that of the light itself."""
    return xyz(oracle.stack_in_air(layers, GLASS, VISIBLE), VISIBLE), xyz(np.ones(len(VISIBLE)), VISIBLE)


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


def test_brightest_ghost_of_all_fields_is_white_at_no_stops(discs):
    """Discs of 1e-4 W and 0.5 mm: the grey one is the brightest, since 450 nm adds hardly any luminance to it."""
    pictures = ColourPictures(discs, Look(block=1))
    y = {nm: oracle.OBSERVER[nm][1] for nm in (450.0, 650.0)} | {550.0: observer([550.0])[0, 1]}
    grey = 1e-4 / (np.pi * 0.5**2) * sum(share * y[nm] for nm, share in SHARES.items())
    yellow = 5e-5 / (np.pi * 0.4**2) * sum(share * y[nm] for nm, share in SHARES.items() if nm > 500)
    assert grey > yellow
    np.testing.assert_allclose(at(pictures.stray[0.0].rgb, GREY), 1, rtol=1e-9)
    np.testing.assert_allclose(luminance(pictures.stray[20.0])[0, 0], 0)
    assert at(luminance(pictures.stray[20.0]), GREY) == pytest.approx(0.3, rel=1e-6)
    assert at(luminance(pictures.stray[20.0]), YELLOW) == pytest.approx(0.3 * yellow / grey, rel=1e-5)
    looks = (Look(block=1, stops=stops) for stops in (-4.0, -3.0))
    dim, bright = (luminance(ColourPictures(discs, look).stray[0.0]) for look in looks)
    assert at(bright, GREY) == pytest.approx(1 / 8, rel=1e-6)
    np.testing.assert_allclose(bright, 2 * dim, rtol=1e-6)


def test_exposure_over_the_direct_image_leaves_the_ghosts_dark(discs):
    pictures = ColourPictures(discs, Look(block=1, reference="direct"))
    np.testing.assert_allclose(at(pictures.all_light[0.0].rgb, DIRECT), 1, rtol=1e-9)
    assert pictures.all_light[0.0].overexposed == 0
    ratio = 1e-4 / 0.5**2 / (3 / 0.1**2)
    assert at(luminance(pictures.stray[0.0]), GREY) == pytest.approx(ratio, rel=1e-6)
    assert (at(pictures.stray[0.0].rgb, DIRECT) == 0).all()
    light = [FakePath(IMAGE, 1.0, 10, *DIRECT, 0.1, wavelength=wavelength) for wavelength in SHARES]
    pictures = ColourPictures(ghosts_of(SmoothTrace(light, shares=SHARES)), Look(block=1))
    assert (pictures.all_light[0.0].rgb == 0).all()
    pictures = ColourPictures(discs, Look(block=1, stops=1.0, white="D65"))
    figure = pictures.figure(0.0)
    for axes, of in zip(figure.axes, (pictures.all_light, pictures.stray), strict=True):
        np.testing.assert_array_equal(axes.get_images()[0].get_array(), of[0.0].rgb)
        assert tuple(axes.get_images()[0].get_extent()) == discs[0.0].extent
    caption = figure.get_supxlabel()
    assert all(words in caption for words in ("450, 550, 650 nm", "white: D65", "+1 stops over the brightest ghost"))
    # Noise asks for blocks: 4 × 4 pixels hold 16 times the rays; the mean irradiance stays
    stray = np.random.default_rng(0).poisson(8.0, (3, 60, 40)).astype(float)
    lines = np.array([450.0, 550.0, 650.0])
    maps = SpectralMaps(lines, np.ones(3), np.zeros_like(stray), stray, stray.sum(axis=(1, 2)))
    assert [maps.block_for(noise) for noise in (100.0, 5.0, 1e9)] == [4, 1, 20]
    binned = maps.binned(4)
    assert binned.stray.shape == (3, 15, 10)
    np.testing.assert_allclose(binned.stray.mean(axis=(1, 2)), stray.mean(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(binned.stray[1, 2, 3], stray[1, 8:12, 12:16].mean(), rtol=1e-12)
    assert "pixels averaged" in ColourPictures(discs, Look(block=2)).caption(0.0)


def test_what_gives_no_colour_is_refused(discs):
    red = xyz([1, 1, 1], [660.0, 680.0, 700.0])
    each_refused(
        (lambda: check_wavelengths([450.0, 550.0, 1064.0]), "1064 nm is not visible; .* from 360 to 830 nm"),
        (lambda: ColourPictures(ghosts_of(trace_at(0.0))), r"1 wavelength \(550 nm\); .* needs at least 3"),
        (lambda: develop(red, 1.0, red), "too saturated to be taken as white; use white D65"),
        (lambda: Look(stops=float("nan")), "stops is nan"),
        (lambda: Look(reference="sky"), "reference is 'sky"),
        (lambda: Look(white="E"), "white is 'E"),
        (lambda: Look(block=-1), "block is -1"),
        (lambda: ColourPictures(discs, Look(block=7)), "blocks of 7 pixels do not fill"),
    )

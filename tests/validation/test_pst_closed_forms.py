"""PSTs by both methods against closed forms and quadrature in float64: within 5 standard errors of 32 batches, false
alarm 2e-5 each of about 300 numbers, with errors below the limits at the tests."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import vectors
from oracles import ideal_lens
from oracles import scatter_integrals as integrals
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml, wall_xml
from oracles.small_scenes import interface_xml
from oracles.statistics import assert_z

import mistray
from mistray import Pst, pst
from mistray.analyses.pst.glare.extended_source import SkyRadiance, source_irradiance
from mistray.analyses.pst.glare.glare import veiling_glare_index

Load = Callable[[str], Any]

pytestmark = pytest.mark.validation

WHOLE = np.arange(5, 90, 10.0)  # cells of 10° that leave no gap
EVERYTHING = {"scatter_threshold": 0.0, "flux_threshold": 0.0}
ONE_BRANCH = {"max_reflections": 64, "max_scatters": 64, "splitting": "one", "aim": "none", **EVERYTHING}
METHODS = pytest.mark.parametrize("method", ["joined", "adjoint", "forward"])


def check(what: str, measured: Any, se: Any, expected: Any, relative: Any, rounding: float = 1e-6) -> None:
    """Within 5 standard errors of the exact numbers, or ``rounding`` of them; the errors are below ``relative``."""
    expected = np.asarray(expected)
    assert_z(what, measured, expected, se, k=5.0, floor=rounding * float(np.max(np.abs(expected))))
    assert np.all(np.asarray(se) < relative * expected), f"{what}: relative errors {np.asarray(se) / expected}"


def of(scene: Any, method: str, rays: tuple[int, int], angles: Any = WHOLE, cell_deg: float = 10.0, **more: Any) -> Pst:
    count = rays[1] if method == "forward" else rays[0]
    return pst(scene, angles, cell_deg=cell_deg, method=method, rays=count, paths=False, **more)


def check_sky(what: str, found: Pst, expected: float, relative: float) -> None:
    """Irradiance by a sky of radiance 1 over π."""
    e = source_irradiance(found, SkyRadiance(), "total")
    assert e.covered == pytest.approx(1, abs=1e-9)
    check(what, e.value / np.pi, e.se / np.pi, expected, relative)


def test_a_plate_without_an_edge(load_scene: Load) -> None:
    """Light through the side of the glass is lost in both directions; before, that of the sky was too bright by n²."""
    plate = [placed_xml("asphere", "front", interface_xml("air", "4.0"), semi_diameter=2.0)]
    plate += [placed_xml("asphere", "rear", interface_xml("4.0", "air"), at=(0, 0, 3.0), semi_diameter=2.0)]
    detector = placed_xml("asphere", "detector", at=(0, 0, 4.0), pixels=4, semi_diameter=1.0)
    scene = load_scene(scatter_scene(beam_xml(2.0), *plate, detector))
    forward, *others = (of(scene, method, (200_000, 40_000)) for method in ("forward", "adjoint", "joined"))
    for one in others:
        assert_z("PST", one.value, forward.value, np.hypot(one.standard_error, forward.standard_error))
        assert any(note.code == "medium" for note in one.facts["notes"])


class TestDirect:
    @METHODS
    def test_bare_detector(self, load_scene: Load, method: str) -> None:
        """Nothing but a detector: PST_n = cos θ, PST_p = 1."""
        scene = load_scene(scatter_scene(beam_xml(1.0), placed_xml("asphere", "detector", pixels=4, semi_diameter=1.0)))
        found = of(scene, method, (400_000, 40_000))
        check("PST normal", *found.curve(), found.grid.mean_cosine, 0.04)
        check("PST projected", *found.to("projected").curve(), np.ones(9), 0.04)
        check_sky("sky", found, 1.0, 0.003)

    @METHODS
    def test_on_axis(self, load_scene: Load, method: str) -> None:
        """T A_ep cos θ / A_det: a thin lens with T = 0.93² whose whole image falls on the detector."""
        size = {"half_width": 25.0, "half_height": 20.0}
        detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 100.0), pixels=4, **size)
        scene = load_scene(scatter_scene(beam_xml(1.0), *ideal_lens.lens_texts(100.0, 10.0, R=0.02, T=0.93), detector))
        found = of(scene, method, (2_000_000, 300_000), [0, 4, 8], 2.0, max_reflections=0)
        expected = 0.93**2 * np.pi * 100 / (4 * 25 * 20) * found.grid.mean_cosine
        check("direct", *found.curve("direct"), expected, 0.02)
        check("all light", *found.to("projected").curve(), expected / found.grid.mean_cosine, 0.02)

    @METHODS
    def test_phone_camera_on_axis(self, method: str) -> None:
        """Fourteen surfaces transmit 0.98 and 0.99; the stop of 0.075 mm limits the light by two shifted circles."""
        camera = mistray.load("phone_camera")
        found = of(camera, method, (4_000_000, 60_000), [0], 2.0, max_reflections=0, max_scatters=0)
        area = found.facts["detector_area_mm2"]
        assert area == pytest.approx(4.36788654**2, rel=1e-7)
        theta = np.radians(ideal_lens.cell_nodes(found.grid.edges_deg, 6))
        half = 0.5 * 0.075 * np.tan(theta) / 1.25171162  # of the shift, over the radius
        pupil = 2 * 1.25171162**2 * (np.arccos(half) - half * np.sqrt(1 - half**2))
        expected = 0.99**4 * 0.98**10 / area * ideal_lens.over_cells(np.cos(theta) * pupil, found.grid.edges_deg)
        check("direct", *found.curve("direct"), expected, 0.04)


PROFILES = {
    "lambert": integrals.lambertian(0.05),
    "ABg": integrals.abg(2e-5, 1e-6, 2.0),
    "harvey": integrals.harvey_shack(0.1099, 0.01, -1.5),
}
TRANSMITTED = {
    "lambert": bsdf_xml("paint", reflectance=0.05, event="transmission", relative_to="specular"),
    "ABg": bsdf_xml("abg", A=2e-5, B=1e-6, g=2.0, event="transmission"),
    "harvey": bsdf_xml("harvey_shack", b0=0.1099, l=0.01, s=-1.5, event="transmission"),
}


def plate_text(bsdf: str, plate_z: float, radius: float, half: float = 0.05) -> str:
    """A thin lens of f = 100 and a plate that scatters before or behind it; a small detector in the focus."""
    sheet = scattering_xml([TRANSMITTED[bsdf]], R=0.0, T=1.0)
    plate = placed_xml("asphere", "plate", sheet, at=(0.0, 0.0, plate_z), semi_diameter=2.5 * radius)
    detector = placed_xml("asphere", "detector", at=(0, 0, 100), pixels=4, half_width=half, half_height=half)
    return scatter_scene(beam_xml(1.0), *ideal_lens.lens_texts(100.0, radius), plate, detector)


class TestFirstOrderScatter:
    """BSDF cos θ π NA² and its like over the cells; the size of the detector, 0.06°, costs less than 1e-3."""

    ONCE = {"max_scatters": 1, "max_reflections": 0}

    @METHODS
    def test_plate_before_a_thin_lens(self, load_scene: Load, method: str) -> None:
        angles, edges = [5.0, 20.0, 45.0], np.array([[4.5, 5.5], [19.5, 20.5], [44.5, 45.5]])
        at_middle = ideal_lens.plate_before(PROFILES["ABg"], angles, 100.0, 12.5)
        cases = [f"thin lens 1st-order scatter f=100 a=12.5 th={angle:g}" for angle in angles]
        published = [vectors.analytic(case, "PST_normal=BSDF cos(th) pi NA^2") for case in cases]
        assert at_middle == pytest.approx(published, rel=1e-3)  # the rim of the lens is 0.04 mm before its vertex
        values = [ideal_lens.plate_before(PROFILES["ABg"], row, 100.0, 12.5) for row in ideal_lens.cell_nodes(edges, 6)]
        expected = ideal_lens.over_cells(np.array(values), edges)
        found = of(load_scene(plate_text("ABg", -3.0, 12.5)), method, (2_000_000, 200_000), angles, 1.0, **self.ONCE)
        value, se = found.curve("single_scatter")
        check("PST", value, np.hypot(se, 1e-3 * expected), expected, 0.08)

    @METHODS
    @pytest.mark.parametrize("plate_z", [0.3, 50.0, 80.0])
    @pytest.mark.parametrize("bsdf", ["lambert", "ABg", "harvey"])
    def test_plate_in_a_converging_beam(self, load_scene: Load, bsdf: str, plate_z: float, method: str) -> None:
        """The vectors are of a lens that changes slopes by -h/f, which no surface does: 1.3 % from this one."""
        for row in vectors.rows("scatter_plate_converging.csv"):
            if row["BTDF"].startswith(bsdf) and float(row["plate_z_mm"]) == round(plate_z):
                exact = ideal_lens.plate_behind(PROFILES[bsdf], plate_z, [float(row["theta_deg"])], 100.0, 10.0, 100.0)
                assert exact[0] == pytest.approx(float(row["E_det_on_axis_per_E0(normal)"]), rel=0.013)
        angles, edges = [0.5, 2.0, 5.0], np.array([[0.25, 0.75], [1.75, 2.25], [4.75, 5.25]])
        nodes = ideal_lens.cell_nodes(edges, 6)
        values = [ideal_lens.plate_behind(PROFILES[bsdf], plate_z, row, 100.0, 10.0, 100.0) for row in nodes]
        expected = ideal_lens.over_cells(np.array(values), edges)
        found = of(load_scene(plate_text(bsdf, plate_z, 10.0)), method, (2_000_000, 100_000), angles, 0.5, **self.ONCE)
        value, se = found.curve("single_scatter")
        check("PST", value, np.hypot(se, 1e-3 * expected), expected, np.array([0.3, 0.15, 0.1]))


@METHODS
@pytest.mark.parametrize("row", vectors.rows("vgi_retro.csv"))
def test_retro_ghost(load_scene: Load, row: dict[str, str], method: str) -> None:
    """R_det R_window of E_white: a telecentric lens with a pupil ring, so that the ghost of a point is a ring that
    leaves out the black patch about it; aberration of the pupil costs 0.2 % at F/8."""
    r_det, r1, r2 = (float(row[key]) for key in ("R_det", "R_w1", "R_w2"))
    n, t, gap = 1.5168, 1.0, 10.0
    focus = 100 + t * (n - 1) / n
    near, chip = focus - gap - t, interface_xml(R=r_det)
    window = (
        placed_xml("asphere", name, interface_xml(*sides, R=r, T=1 - r), at=(0, 0, z), semi_diameter=30.0)
        for name, sides, r, z in (("near", ("air", str(n)), r1, near), ("far", (str(n), "air"), r2, near + t))
    )
    text = scatter_scene(
        beam_xml(1.0),
        *ideal_lens.telecentric_texts(100.0, 6.25, 2.5, 6.0),
        *window,
        placed_xml("asphere", "chip", chip, at=(0, 0, focus), semi_diameter=30.0, inner_semi_diameter=0.1),
        placed_xml("asphere", "detector", chip, at=(0, 0, focus), pixels=4, semi_diameter=0.1),
    )
    angles = np.arange(0.1, 1.8, 0.2)
    found = of(load_scene(text), method, (1_000_000, 300_000), angles, 0.2, max_reflections=6, flux_threshold=1e-9)
    glare = veiling_glare_index(found, 0.2, source_deg=1.8, place="point")
    expected = float(row["VGI_percent (first order, E_black/E_white)"])
    check("VGI", glare.value, np.hypot(glare.se, 2e-3 * expected), expected, 0.08)


class TestCavities:
    @METHODS
    @pytest.mark.parametrize("rho", [0.05, 0.5, 1.0])
    @pytest.mark.parametrize("length", [1.0, 2.0, 4.0])
    def test_diffuse_tube(self, load_scene: Load, length: float, rho: float, method: str) -> None:
        """A sky is like a Lambertian entrance: E / π is the transmission; 60 reflections leave 1e-6 inside."""
        text = scatter_scene(
            beam_xml(1.0),
            placed_xml("frustum", "wall", wall_xml(rho), r0=1.0, z0=0.0, r1=1.0, z1=length),
            placed_xml("asphere", "detector", at=(0.0, 0.0, length), pixels=4, semi_diameter=1.0),
        )
        found = of(load_scene(text), method, (500_000, 100_000), max_scatters=60, aim="none", **EVERYTHING)
        check_sky("tube", found, vectors.analytic(f"tube L/r={length:g} rho={rho:g} ", "T (Lambertian entrance)"), 0.01)
        direct = source_irradiance(found, SkyRadiance(), "direct")
        check("direct", direct.value / np.pi, direct.se / np.pi, integrals.disc_to_disc(1.0, 1.0, length), 0.02)

    @METHODS
    @pytest.mark.parametrize("rho", [0.5, 0.9])
    def test_integrating_sphere(self, load_scene: Load, rho: float, method: str) -> None:
        """E / π = f / (1 - ρ(1 - f)); tube and belt close the gaps of the halves, 60 reflections leave 1e-4."""
        port, cap, width = 4.0, 3.0, 9.999
        half, wall, rim = float(np.sqrt(100 - width**2)), wall_xml(rho), {"semi_diameter": width}
        text = scatter_scene(
            beam_xml(1.0),
            placed_xml("asphere", "fore", wall, at=(0, 0, -10), radius=10.0, inner_semi_diameter=port, **rim),
            placed_xml("asphere", "rear", wall, at=(0, 0, 10), radius=-10.0, inner_semi_diameter=cap, **rim),
            placed_xml("frustum", "belt", wall, r0=width, z0=-half, r1=width, z1=half),
            placed_xml("frustum", "hull", r0=10.02, z0=-half, r1=10.02, z1=12.0),
            placed_xml("asphere", "detector", wall, at=(0, 0, 10), radius=-10.0, semi_diameter=cap, pixels=4),
        )
        f = 0.5 * (1 - np.sqrt(1 - (port / 10) ** 2))
        found = of(load_scene(text), method, (240_000, 200_000), max_scatters=60, aim="none", **EVERYTHING)
        check_sky("sphere", found, f / (1 - rho * (1 - f)), 0.025)


def cavity_text(*parts: str, wall: str, inner: str = "air", glass_from: float | None = None) -> str:
    """A can of radius 1 with a white detector in its bottom; behind ``glass_from`` it is filled with ``inner``."""
    white = scattering_xml([bsdf_xml("paint", reflectance=1.0)], front=inner, R=0.0)
    filled, end = glass_from is not None, 1.2
    behind, rim = (white, glass_from) if filled else (wall, end)
    shapes = [placed_xml("frustum", "can", wall, r0=1.0, z0=0.0, r1=1.0, z1=rim)]
    if filled:
        shapes.append(placed_xml("frustum", "filled", white, r0=1.0, z0=rim, r1=1.0, z1=end))
        shapes.append(placed_xml("asphere", "face", interface_xml("air", inner), at=(0, 0, rim), semi_diameter=1.0))
    shapes.append(placed_xml("asphere", "bottom", behind, at=(0, 0, end), semi_diameter=1.0, inner_semi_diameter=0.6))
    shapes.append(placed_xml("asphere", "detector", white, at=(0, 0, end), pixels=4, semi_diameter=0.6))
    return scatter_scene(beam_xml(1.0), *parts, *shapes)


WHITE = wall_xml(1.0)
FIT = bsdf_xml("polynomial", c000=-0.3, c100=0.2, c010=-0.4, c001=0.3, l10=-0.5, d=30.0)
HAZE = bsdf_xml("gaussian_lobe", total=0.5, width=0.3, event="both")
FITTED, SHEET = (
    placed_xml("asphere", "sheet", scattering_xml([model], R=r, T=1 - r), at=(0, 0, 0.3), semi_diameter=1.0)
    for model, r in ((FIT, 0.3), (HAZE, 0.2))
)


class TestWhiteFurnace:
    """All albedos are 1 and light of radiance 1 comes in by the one opening: it is 1 everywhere, n² in glass."""

    @METHODS
    @pytest.mark.parametrize(
        ("text", "squared_index"),
        [
            (cavity_text(wall=WHITE), 1.0),
            (cavity_text(wall=scattering_xml([bsdf_xml("harvey_shack", b0=1.0, l=0.1, s=-2.2)], R=1.0)), 1.0),
            (cavity_text(wall=scattering_xml([bsdf_xml("phong", b0=1.5, exponent=8.0)], R=1.0)), 1.0),
            (cavity_text(SHEET, wall=WHITE), 1.0),
            (cavity_text(FITTED, wall=WHITE), 1.0),
            (cavity_text(wall=WHITE, inner="1.2", glass_from=0.9), 1.2**2),
        ],
    )
    def test_cavity(self, load_scene: Load, text: str, squared_index: float, method: str) -> None:
        """Nothing absorbs, so that what 64 events cut would have come out; they cut less than 1e-3 here."""
        e = source_irradiance(of(load_scene(text), method, (240_000, 400_000), **ONE_BRANCH), SkyRadiance(), "total")
        check("furnace", e.value / np.pi, np.hypot(e.se / np.pi, 3e-4), squared_index, 0.01)

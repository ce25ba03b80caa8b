"""Plates, ghosts, first-order and multiple scatter with known answers: 4 standard errors, false alarms of 6e-5 each.

The flux of a path through plane surfaces at normal incidence is the same for every ray, so that its standard error is 0
and only float32 rounding is left: 1e-6 relative, which `assert_within` takes as its floor here. Where no limit of the
standard error is written at the test, the number is within 0.1 %.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import vectors
from lit_detector import BLACK, lit, meter
from oracles import closed_forms, scatter_scenes
from oracles import scatter_integrals as integrals
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml, target_xml, wall_xml
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_within, assert_z, mean_and_error

import mistray
from mistray.recorders import FluxSplit
from mistray.scenes.singlet_window_detector.prescription import build as singlet_window_detector

ROUNDING = 1e-6


def assert_power(what: str, watt: float, expected: float, se: float = 0.0) -> None:
    assert_within(what, watt, expected, se, rounding=ROUNDING)


class TestPlates:
    def test_plate_transmits_and_returns_what_the_series_says(self) -> None:
        t = mistray.trace(mistray.load("plate"), rays=4096, max_reflections=20, flux_threshold=1e-12)
        r = closed_forms.normal_reflectance(1, 1.5)
        transmitted, returned = closed_forms.plate(r)
        e = t.energy
        assert e.launched_W == pytest.approx(25 * np.pi, rel=1e-12)
        assert_power("T", e.detected_W / e.launched_W, transmitted, e.detected_se_W / e.launched_W)
        assert transmitted == pytest.approx(0.923077, abs=5e-7)
        assert_power("R", e.escaped_W / e.launched_W, returned, e.escaped_se_W / e.launched_W)
        orders = closed_forms.plate_orders(r, 4)
        for m, row in enumerate(t.paths[:4]):
            assert (row.order, row.rays) == (2 * m, 4096)
            assert_power(f"{2 * m} reflections", row.power_W / e.launched_W, orders[m], row.power_se_W / e.launched_W)
        assert t.paths[1].power_W / t.paths[0].power_W == pytest.approx(r**2, rel=ROUNDING)
        assert (t.paths[1].ghost_1, t.paths[1].ghost_2) == ("plate_rear", "plate_front")

    @pytest.mark.parametrize("number", [2, 3, 5])
    def test_plates_in_a_row(self, load_text, number: int) -> None:
        """What is missing from the closed form is what was cut, no more."""
        scene, _ = load_text(plates_text(number))
        t = mistray.trace(scene, rays=4, max_reflections=6, flux_threshold=1e-9, ledger=False)
        expected = closed_forms.plates(0.04, number)
        share = t.energy.detected_W / t.energy.launched_W
        cut = sum(t.energy.cut.values()) / t.energy.launched_W
        assert share <= expected * (1 + ROUNDING)
        assert expected <= (share + cut) * (1 + ROUNDING)
        assert share == pytest.approx(expected, rel=1e-3)
        if number > 2:  # one in, one out: false alarm 6e-5 each, 4 standard errors
            t = mistray.trace(scene, rays=2_000_000, max_reflections=60, splitting="one", ledger=False)
            share, se = np.array([t.energy.detected_W, t.energy.detected_se_W]) / t.energy.launched_W
            assert_power(f"T of {number} plates", share, expected, se)
            assert se == pytest.approx(np.sqrt(share * (1 - share) / 2_000_000), rel=0.5)  # 32 batches: known to 13 %

    @pytest.mark.parametrize(("r", "t"), [(0.05, 0.9), (0.3, 0.7), (0.5, 0.5), (0.2, 0.1)])
    def test_plate_with_ideal_coatings(self, load_text, r: float, t: float) -> None:
        scene, _ = load_text(plates_text(1, R=r, T=t))
        transmitted, returned = closed_forms.coated_plate(r, r, t1=t, t2=t)
        e = mistray.trace(scene, rays=256, max_reflections=60, flux_threshold=1e-12).energy
        assert_power("T", e.detected_W / e.launched_W, transmitted)
        assert_power("R", e.escaped_W / e.launched_W, returned)
        absorbed = sum(watt for watt, _ in e.absorbed.values()) / e.launched_W
        assert absorbed == pytest.approx(1 - transmitted - returned, abs=2e-6)

    @pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0])
    def test_plate_with_tabled_coatings(self, tmp_path: Path, load_text, incidence_deg: float) -> None:
        """R differs between the two sides; the angle is the one in air, for light from either side."""

        def coating(angle_deg: float) -> np.ndarray:
            sine2 = np.sin(np.radians(angle_deg)) ** 2
            return np.array([0.01 + 0.2 * sine2**2, 0.8 - 0.6 * sine2**3, 0.05 + 0.1 * sine2])

        lines = ["# the test asks for the mean of both wavelengths", "wavelength_nm,angle_deg,R,T,R_back"]
        for wavelength, r_factor, t_factor in ((500, 0.5, 0.9), (600, 1.5, 1.1)):
            for angle in np.arange(0.0, 91.0, 2.5):
                values = coating(angle) * [r_factor, t_factor, r_factor]
                lines.append(",".join(str(v) for v in (wavelength, angle, *values)))
        table = tmp_path / "coating.csv"
        table.write_text("\n".join(lines), encoding="utf-8")
        scene, _ = load_text(plates_text(1, table=str(table)))
        light = {"field_deg": incidence_deg, "wavelength_nm": 550.0}
        r, t, back = coating(incidence_deg)
        loop = 1 - back * r  # the front seen from inside is its back, the rear seen from inside its front
        e = mistray.trace(scene, rays=256, **light, max_reflections=40, flux_threshold=1e-12).energy
        assert e.detected_W / e.launched_W == pytest.approx(t * t / loop, rel=1e-4)
        assert e.escaped_W / e.launched_W == pytest.approx(r + t * t * r / loop, rel=1e-3)


NARROW = 0.1  # radius of the beam, mm


def test_ten_ghosts_of_a_lens_a_window_and_a_detector() -> None:
    """In a narrow beam before a detector that reflects 20 %: paraxial optics."""
    t = mistray.trace(singlet_window_detector().with_source(radius=NARROW).to_scene(), rays=60_000, flux_threshold=0.0)
    names = ["L1_front", "L1_rear", "window_front", "window_rear", "detector"]
    ghosts = {(names.index(row.ghost_2) + 1, names.index(row.ghost_1) + 1): row for row in t.paths if row.order == 2}
    pair = ["second_reflecting_surface", "first_reflecting_surface"]
    table = vectors.frame("ghost_lens_window_det.csv").set_index(pair).to_dict("index")
    assert (set(ghosts), [row.rays for row in t.paths]) == (set(table), [60_000] * 11)
    # A uniform disc has r = rms · √2. 20 comparisons at 4 standard errors: false alarm 1.3e-3
    for pair, row in ghosts.items():
        assert_power(f"ghost {pair}", row.incident_W / t.energy.launched_W, table[pair]["incident_power_per_W"])
        assert row.power_W == pytest.approx(0.8 * row.incident_W, rel=ROUNDING)
        radius, se = np.sqrt(2) * row.rms_radius_mm, np.sqrt(2) * row.rms_radius_se_mm
        expected = table[pair]["spot_radius_mm"] * (NARROW / 10.0)
        assert_within(f"radius of ghost {pair}", radius, expected, se, relative=3e-3)
        assert se / radius < 1.5e-3
        irradiance = row.rms_irradiance_W_mm2 / 2 / 0.8  # over the disc, incident
        expected = table[pair]["irradiance_on_detector_per_entrance_irradiance"]
        se = row.rms_irradiance_se_W_mm2 / 2 / 0.8
        assert_within(f"irradiance of ghost {pair}", irradiance, expected, se, relative=6e-3)
    # Where the rays of each ghost meet the axis, against the paraxial trace
    n = 1.5168
    r = closed_forms.normal_reflectance(1, n)
    rows = [(0.0, 0.01, 1.0, n), (5.0, -0.01, n, 1.0), (85.0, 0.0, 1.0, n), (87.0, 0.0, n, 1.0)]
    surfaces = [closed_forms.ParaxialSurface(*row, r, 1 - r) for row in rows]
    z = 87.0 + closed_forms.back_focus(surfaces)[1]
    for ghost in closed_forms.paraxial_ghosts(surfaces, z, 0.2, NARROW):
        for points in t.history(ghosts[ghost.second, ghost.first].path_id, 4).rays:
            end, before = points[-1], points[-2]
            slope = np.hypot(*(end - before)[:2]) / (end - before)[2]
            slope *= np.sign(np.dot((end - before)[:2], end[:2]))
            focus = end[2] - np.hypot(*end[:2]) / slope
            # the rim of the narrow beam: aberrations of 1e-4 of the distance to the focus
            distance = abs(ghost.height / ghost.slope)
            assert focus == pytest.approx(z - ghost.height / ghost.slope, abs=3e-4 * distance)


class TestGhostCounts:
    """Plane surfaces in air that reflect 1 % each: nothing is vignetted, every pair of surfaces is one ghost."""

    R = 0.01

    def scene(self, load_text, surfaces: int):
        coat = interface_xml(R=self.R, T=1 - self.R)
        names = [f"s{i:02}" for i in range(surfaces)]
        shapes = [shape_xml("asphere", name, 2.0 * i, coat, semi_diameter=5.0) for i, name in enumerate(names)]
        detector = shape_xml("asphere", "detector", 2.0 * surfaces, sensor=True, half_width=5.0, half_height=5.0)
        return load_text(scene_text(*shapes, detector))[0], names

    @pytest.mark.parametrize("surfaces", range(4, 16))
    def test_two_reflections(self, load_text, surfaces: int) -> None:
        scene, names = self.scene(load_text, surfaces)
        t = mistray.trace(scene, rays=64, max_reflections=2, flux_threshold=0.0)
        ghosts = [row for row in t.paths if row.order == 2]
        assert len(ghosts) == surfaces * (surfaces - 1) // 2 == closed_forms.ghost_count(surfaces, 2)
        assert (len(t.paths), t.paths[0].kind) == (len(ghosts) + 1, "direct")
        events = {tuple(row.event_list): row for row in ghosts}
        for second, first in closed_forms.ghost_sequences(surfaces, 2):
            row = events[tuple(closed_forms.ghost_events(names, (second, first), "detector"))]
            assert (row.kind, row.rays) == ("ghost", 64)
            power = self.R**2 * (1 - self.R) ** row.path.count("T")
            assert row.power_W / t.energy.launched_W == pytest.approx(power, rel=2e-6)

    @pytest.mark.parametrize(("surfaces", "reflections"), [(4, 4), (5, 4), (6, 4), (4, 6)])
    def test_more_reflections(self, load_text, surfaces: int, reflections: int) -> None:
        scene, names = self.scene(load_text, surfaces)
        t = mistray.trace(scene, rays=32, max_reflections=reflections, flux_threshold=0.0)
        found = {tuple(row.event_list) for row in t.paths if row.order == reflections}
        sequences = closed_forms.ghost_sequences(surfaces, reflections)
        assert found == {tuple(closed_forms.ghost_events(names, s, "detector")) for s in sequences}
        assert len(found) == closed_forms.ghost_count(surfaces, reflections)


class TestTotalReflection:
    def test_rod(self, load_text) -> None:
        """A bare rod guides everything, also skew rays: T is that of the plate with R at the angle of incidence."""
        rod = (
            shape_xml("asphere", "rod_front", 0.0, interface_xml("air", "1.5"), semi_diameter=2.0),
            shape_xml("frustum", "rod_side", 0.0, interface_xml("1.5", "air"), r0=2.0, z0=0.0, r1=2.0, z1=30.0),
            shape_xml("asphere", "rod_rear", 30.0, interface_xml("1.5", "air"), semi_diameter=2.0),
            shape_xml("asphere", "detector", 30.5, sensor=True, half_width=8.0, half_height=8.0),
        )
        scene, _ = load_text(scene_text(*rod, radius=1.5))
        mean = {"rays": 4096, "field_deg": 30.0, "polarization": "unpolarized"}
        t = mistray.trace(scene, max_reflections=8, flux_threshold=1e-12, **mean)
        _, averaged = closed_forms.tilted_plate(1.5, 30.0)
        e = t.energy
        # R at the angle of incidence differs between rays by rounding only
        assert_power("T of the rod", e.detected_W / e.launched_W, averaged)
        assert_power("R of the rod", e.escaped_W / e.launched_W, 1 - averaged)
        strongest = t.paths[0]
        assert (strongest.kind, strongest.order) == ("TIR", 0)
        assert strongest.tir == strongest.event_list.count(("rod_side", "TIR")) >= 2
        none = mistray.trace(scene, max_reflections=0, **mean)
        direct = (1 - np.mean(closed_forms.fresnel(30.0, 1.5))) ** 2
        assert_power("total reflections are free", none.energy.detected_W / e.launched_W, direct)

    def test_critical_angle(self, load_text) -> None:
        """n = 1.5: 41.81 deg; a coating reflects all but what it absorbs. The beam starts in glass."""

        def reflected(incidence_deg: float, **coating: float) -> mistray.Trace:
            face = shape_xml("asphere", "face", 0.0, interface_xml("1.5", "air", **coating), semi_diameter=50.0)
            screen = shape_xml("asphere", "detector", -20.0, sensor=True, half_width=60.0, half_height=60.0)
            scene, _ = load_text(scene_text(face, screen, distance=5.0))
            return mistray.trace(scene, rays=256, field_deg=incidence_deg)

        below, above, coated = reflected(41.7), reflected(41.9), reflected(50.0, R=0.1, T=0.7)
        assert [t.paths[0].path for t in (below, above, coated)] == ["RA", "IA", "IA"]
        assert above.paths[0].kind == "TIR"
        share, total, kept = (t.energy.detected_W / t.energy.launched_W for t in (below, above, coated))
        assert (total, kept) == pytest.approx((1.0, 0.8), rel=ROUNDING)
        assert coated.energy.absorbed["face"][0] / coated.energy.launched_W == pytest.approx(0.2, rel=ROUNDING)
        # The cosine of refraction, 0.064, comes from 1 - sin²: float32 leaves it 1e-5
        assert share == pytest.approx(np.mean(closed_forms.fresnel(41.7, 1 / 1.5)), rel=1e-4)
        assert below.energy.escaped_W / below.energy.launched_W == pytest.approx(1 - share, rel=1e-4)


Load = Callable[[str], Any]
TRANSMITTED = {
    "lamb": bsdf_xml("paint", reflectance=0.05, event="transmission", relative_to="specular"),
    "abg": bsdf_xml("abg", A=2e-5, B=1e-6, g=2.0, event="transmission"),
    "har": bsdf_xml("harvey_shack", b0=0.1099, l=0.01, s=-1.5, event="transmission"),
}
# Share of the rays aimed at a small detector that miss its rim by the rounding of their directions, and the other way
RIM = 5e-5
ROULETTE = {"below_threshold": "roulette", "scatter_threshold": 0.3}
EVERYTHING = {"scatter_threshold": 0.0, "flux_threshold": 0.0}


def check(what: str, measured: float, se: float, expected: float, relative: float, rounding: float = 1e-6) -> None:
    """Within 4 standard errors of the exact number, or ``rounding`` of it; the error is below ``relative`` of it."""
    assert_z(what, measured, expected, se, k=4.0, floor=rounding * expected)
    assert se < relative * expected, f"{what}: standard error {se / expected:.1e} of {expected:.6g}"


def check_detected(what: str, t: mistray.Trace, expected: float, relative: float) -> None:
    e = t.energy
    check(what, e.detected_W / e.launched_W, e.detected_se_W / e.launched_W, expected, relative)
    assert abs(e.closure) < 1e-6


@pytest.mark.core
@pytest.mark.parametrize("medium", ["air", "1.5"])
def test_a_mirror_scatters_with_the_wavelength_of_its_medium(medium: str) -> None:
    """TIS = (4π n σ/λ)² of a smooth mirror, to first order (H. E. Bennett, J. O. Porteus, J. Opt. Soc. Am. 51, 123)."""
    rough = {"type": "harvey_shack", "rms_nm": 2.0, "l": 0.01, "s": -1.5}
    mirror = {"type": "interface", "front": medium, "R": 1.0, "model": rough}
    window = {"type": "interface", "back": medium, "R": 0.0, "T": 1.0}
    scene = lit(
        {"type": "collimated", "radius": 1.0, "distance": 1.0, "wavelength_nm": 500.0},
        detector={"type": "asphere", "semi_diameter": 20.0, "z": -5.0, "bsdf": BLACK, "sensor": meter()},
        window={"type": "asphere", "semi_diameter": 20.0, "bsdf": window},
        edge={"type": "frustum", "r0": 20.0, "z0": 0.0, "r1": 20.0, "z1": 5.0, "bsdf": BLACK | {"front": medium}},
        mirror={"type": "asphere", "semi_diameter": 20.0, "z": 5.0, "bsdf": mirror},
    )
    traced = mistray.trace(scene, rays=2000, recorders=[FluxSplit("split", "mirror")], max_scatters=1)
    (row,) = traced.recorders["split"].rows
    tis = (4 * np.pi * (1.0 if medium == "air" else float(medium)) * 2.0 / 500.0) ** 2
    assert row.scattered_reflection[0] / row.incident[0] == pytest.approx(tis, rel=tis)


class TestTubes:
    @pytest.mark.parametrize("rho", [0.05, 0.5, 1.0])
    @pytest.mark.parametrize("length", [1.0, 2.0, 4.0])
    def test_diffuse_tube(self, load_scene: Load, length: float, rho: float) -> None:
        """As many bounces as a path can hold; the exact number is the sum of these orders."""
        bounces = 60
        scene = load_scene(scatter_scenes.tube_text(length, rho))
        t = mistray.trace(scene, rays=300_000, aim="none", max_scatters=bounces + 1, **EVERYTHING)
        check_detected("tube", t, integrals.tube_orders(length, rho, bounces).sum(), 0.01)
        # what 60 bounces leave inside is nothing but in the longest white tube
        whole = vectors.analytic(f"tube L/r={length:g} rho={rho:g} ", "T (Lambertian entrance)")
        rest = 1e-6 if length == 4 and rho == 1 else 1e-9
        assert integrals.tube_orders(length, rho, bounces).sum() == pytest.approx(whole, rel=rest)

    def test_orders(self, load_scene: Load) -> None:
        """Path by path: n bounces are n ``r`` in a row. False alarm of the nine together 1e-3."""
        scene = load_scene(scatter_scenes.tube_text(2.0, 0.5))
        t = mistray.trace(scene, rays=400_000, aim="none", max_scatters=9, **EVERYTHING)
        expected = np.pi * integrals.tube_orders(2.0, 0.5, 8)
        rows = {row.path: row for row in t.paths}
        paths = ["t" + "r" * n + "A" for n in range(9)]
        assert set(rows) == set(paths)
        measured, se = np.array([(rows[path].power_W, rows[path].power_se_W) for path in paths]).T
        assert_z("orders", measured, expected, se, names=paths)
        assert np.all(se[:4] < 0.02 * expected[:4])
        assert [rows[path].scatter_1 for path in paths] == ["entrance"] * 9

    @pytest.mark.parametrize(
        "mode",
        [
            {"rays": 60_000, "aim": "auto", "max_scatters": 5},
            {"rays": 400_000, "splitting": "one", "max_scatters": 5},
            {"rays": 30_000, "aim": "none", "scatter_rays": 3, "max_scatters": 4},
            {"rays": 300_000, "aim": "none", "max_scatters": 5} | ROULETTE,
        ],
    )
    def test_modes(self, load_scene: Load, mode: dict[str, Any]) -> None:
        t = mistray.trace(load_scene(scatter_scenes.tube_text(2.0, 0.5)), **{**EVERYTHING, **mode})
        check_detected("tube", t, integrals.tube_orders(2.0, 0.5, mode["max_scatters"] - 1).sum(), 0.01)


@pytest.mark.parametrize(("rho", "port"), [(0.95, 0.02), (0.98, 0.05), (0.5, 0.1), (0.05, 0.01), (0.1, 0.1)])
def test_port_and_wall_of_a_sphere(load_scene: Load, rho: float, port: float) -> None:
    """The flux out of the port of an integrating sphere: 60 orders of the geometric series; a dark one absorbs."""
    orders, scene = 60, load_scene(scatter_scenes.sphere_text(rho, port))
    t = mistray.trace(scene, rays=100_000, aim="none", max_scatters=orders, **EVERYTHING)
    # A hit of the wall costs 1 - rho, and the share that stays on it is 1 - port
    hits = (1 - (rho * (1 - port)) ** (orders + 1)) / (1 - rho * (1 - port))
    wall, se = (value / t.energy.launched_W for value in t.energy.absorbed["wall"])
    check("wall", wall, se, (1 - rho) * hits, 0.01 if rho > 0.1 else 1e-3)
    if rho > 0.1:
        check_detected("port", t, integrals.sphere_orders(rho, port, orders).sum(), 0.01)
    else:
        cavity = f"cavity (sphere) rho={rho:g} port f={port:g}"
        expected = vectors.analytic(cavity, "effective absorptance (1-rho)/(1-rho(1-f))")
        assert (1 - rho) * hits == pytest.approx(expected, rel=1e-9)
    aimed = mistray.trace(scene, rays=10_000, max_scatters=6, **EVERYTHING)
    check_detected("port", aimed, integrals.sphere_orders(rho, port, 6).sum(), 0.01)
    assert [row.id for row in aimed.aiming] == ["wall"]


class TestDiscs:
    @pytest.mark.parametrize("aim", ["none", "auto"])
    @pytest.mark.parametrize(("r1", "r2", "distance"), [(1, 1, 1), (1, 1, 4), (1, 2, 5), (5, 1, 10)])
    def test_coaxial(self, load_scene: Load, r1: int, r2: int, distance: int, aim: str) -> None:
        text = scatter_scenes.discs_text(float(r1), float(r2), float(distance))
        t = mistray.trace(load_scene(text), rays=400_000, aim=aim, max_scatters=1)
        expected = vectors.analytic(f"coaxial discs r1={r1} r2={r2} h={distance}", "F12")
        check_detected("disc to disc", t, expected, 0.03 if aim == "none" else 1.5e-3)

    @pytest.mark.parametrize(("offset", "case"), [(0.0, "axis"), (1.5, "offset x=1.5")])
    def test_disc_to_element(self, load_scene: Load, offset: float, case: str) -> None:
        """A square of 0.02 mm takes the place of the element: 1e-5 of curvature. The source has 1 W/mm^2."""
        half = 0.01
        text = scatter_scenes.discs_text(1.0, 0.0, 2.0, offset, half)
        t = mistray.trace(load_scene(text), rays=400_000, max_scatters=1)
        expected = vectors.analytic(f"disc r=1 -> dA h=2 {case}", "F")
        area = (2 * half) ** 2
        check("element", t.energy.detected_W / area, t.energy.detected_se_W / area, expected, 2e-3)


ABG = scattering_xml([bsdf_xml("abg", A=0.0025, B=0.001, g=1.8, event="transmission")], R=0.0, T=1.0)


def lit_plate(surface: str, axis: np.ndarray, size: float, incidence_deg: float = 0.0, kind: str = "rectangle") -> str:
    """A plate in the origin, 1 W on one point of it, and 100 mm away along an axis a detector with a target on it."""
    i, place = np.radians(incidence_deg), {"at": 100 * axis, "facing": axis}
    numbers = {"half_width": size, "half_height": size} if kind == "rectangle" else {"semi_diameter": size}
    return scatter_scene(
        beam_xml(1e-3, power=1.0, along=(float(np.sin(i)), 0.0, float(np.cos(i))), distance=10.0),
        placed_xml("asphere", "plate", surface, semi_diameter=1.0),
        target_xml("aim", "plate", kind, scale=(size, size, 1.0), **place),
        placed_xml("asphere", "detector", pixels=4, **numbers, **place),
    )


def axis_at(polar_deg: float, azimuth_deg: float = 0.0) -> np.ndarray:
    theta, phi = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def scattered(t: mistray.Trace) -> tuple[float, float]:
    return t.paths.power([row.path_id for row in t.paths if row.scatter_1 != "-"])


class TestFacingPlates:
    """Irradiance of a detector by an illuminated plate; a detector of 0.1 mm at 100 mm is a point to 2e-5."""

    CASES = [("Lambertian plate rho=.05", (0, 30, 60)), ("ABg plate normal inc", (5, 30, 60))]

    @pytest.mark.parametrize(("case", "angle_deg"), [(case, angle) for case, angles in CASES for angle in angles])
    def test_irradiance(self, load_scene: Load, case: str, angle_deg: int) -> None:
        lambertian = case.startswith("Lambertian")
        axis = axis_at(180 - angle_deg if lambertian else angle_deg)
        surface = wall_xml(0.05) if lambertian else ABG
        t = mistray.trace(load_scene(lit_plate(surface, axis, 0.05)), rays=100_000, aim="targets")
        power, se = scattered(t)
        expected = vectors.analytic(f"{case} d=100 th={angle_deg} ", "E_det per W [1/mm2]")
        check("irradiance", power / 0.01, se / 0.01, expected, 2e-3, RIM)
        assert lambertian or power / sum(row.power_W for row in t.paths) == 1  # nothing but scatter gets there

    @pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0, 85.0])
    def test_total(self, load_scene: Load, incidence_deg: float) -> None:
        """The specular beam loses the TIS at its angle, to 1e-4; the scattered rays carry as much on average."""
        scene = load_scene(lit_plate(ABG, axis_at(10.0), 0.05, incidence_deg))
        tis = integrals.total_scatter(integrals.abg(0.0025, 0.001, 1.8), np.sin(np.radians(incidence_deg)))
        none = mistray.trace(scene, rays=100, max_scatters=0).energy
        assert none.cut["max_scatters"] / none.launched_W == pytest.approx(tis, rel=1e-4)
        assert none.escaped_W / none.launched_W == pytest.approx(1 - tis, rel=1e-5)
        for aim in ("none", "targets"):
            cuts = [mistray.trace(scene, rays=40_000, aim=aim, seed=seed).energy.cut for seed in range(16)]
            mean, se = mean_and_error([cut["scatter_sampling"] for cut in cuts])
            assert_z(f"not carried, aim {aim}", mean, 0.0, se, k=4.0, floor=1e-5 * tis)
            assert se < 5e-3 * tis


@pytest.mark.parametrize("splitting", ["split", "one"])
def test_what_aimed_rays_leave_out_is_cut(load_scene: Load, splitting: str) -> None:
    """A Lambertian wall that may only aim, at a cone of 30° about its normal, loses rho cos² 30°."""
    rho, radius = 0.5, 100 * float(np.tan(np.radians(30.0)))
    scene = load_scene(lit_plate(wall_xml(rho), axis_at(180.0), radius, kind="disk"))
    how = {"rays": 40_000, "aim": "targets", "max_random_scatters": 0, "splitting": splitting}
    cuts = [mistray.trace(scene, seed=seed, **how).energy.cut for seed in range(16)]
    assert {cut["scatter_sampling"] for cut in cuts} == {0.0}
    mean, se = mean_and_error([cut["max_scatters"] for cut in cuts])
    assert_z(f"cut, {splitting}", mean, rho * 0.75, se, k=4.0, floor=1e-5)
    assert se < 1e-3 * rho


@pytest.mark.parametrize("row", vectors.rows("is_cone_flux.csv"), ids=lambda r: "_".join(list(r.values())[:5]))
def test_flux_into_a_cone(load_scene: Load, row: dict[str, str]) -> None:
    """A target that fills the cone gives the integral of f cos over it: to 1e-4, or 1e-3 where it holds the peak."""
    numbers = [float(row[key]) for key in ("theta_i", "cone_axis_theta", "cone_axis_phi", "cone_half_deg")]
    incidence, polar, azimuth, half = numbers
    rays = 8_000_000 if half == 10 else 2_000_000
    surface, radius = scattering_xml([TRANSMITTED[row["bsdf"]]], R=0.0, T=1.0), float(100 * np.tan(np.radians(half)))
    text = lit_plate(surface, axis_at(polar, azimuth), radius, incidence, "disk")
    t = mistray.trace(load_scene(text), rays=rays, aim="targets")
    peaked = row["bsdf"] != "lamb" and incidence == polar == azimuth == 0
    power, se = scattered(t)
    check("cone", power, se, float(row["Phi_imp/Phi_inc"]), 1e-3 if peaked else 1e-4, RIM)
    (surface,) = t.aiming
    assert surface.aimed == rays
    assert surface.landed >= 0.9999 * surface.aimed


def converging_text(bsdf: str, plate_z: float, theta_deg: float, half: float) -> tuple[str, float]:
    """A plate in beams from nodes of an ideal lens (f = 100, radius 10), a detector in its focus; W for 1 W/mm²."""
    x, w = np.polynomial.legendre.leggauss(3)
    azimuths = (np.arange(4) + 0.5) * np.pi / 4  # the other half of the pupil is its mirror image
    beams, total = [], 0.0
    for share, weight in zip(0.5 * (x + 1), 0.5 * w, strict=True):
        h = 10 * np.sqrt(share)
        for phi in azimuths:
            at = np.array([h * np.cos(phi), h * np.sin(phi), 0.0])
            along = np.array([np.tan(np.radians(theta_deg)) - at[0] / 100, -at[1] / 100, 1.0])
            power = float(np.cos(np.radians(theta_deg)) * weight * np.pi * 100 / 4)
            total += power
            beams.append(beam_xml(1e-4, power=power, at=at, along=along, distance=1.0))
    surface = scattering_xml([TRANSMITTED[bsdf]], R=0.0, T=1.0)
    return scatter_scene(
        *beams,
        placed_xml("asphere", "plate", surface, at=(0.0, 0.0, plate_z), semi_diameter=30.0),
        target_xml("aim", "plate", "rectangle", at=(0.0, 0.0, 100.0), scale=(half, half, 1.0)),
        placed_xml("asphere", "detector", at=(0.0, 0.0, 100.0), pixels=4, half_width=half, half_height=half),
    ), total


@pytest.mark.parametrize("row", vectors.rows("scatter_plate_converging.csv"))
def test_plate_in_a_converging_beam(load_scene: Load, row: dict[str, str]) -> None:
    """The exact integral, not Peterson's formula, 20 % off; twelve nodes of the pupil and 0.04 mm cost below 3e-4."""
    bsdf, half = {"h": "har", "l": "lamb", "A": "abg"}[row["BTDF"][0]], 0.02
    text, total = converging_text(bsdf, float(row["plate_z_mm"]), float(row["theta_deg"]), half)
    t = mistray.trace(load_scene(text), rays=100_000, aim="targets")
    assert t.energy.launched_W == pytest.approx(total, rel=1e-9)
    expected = float(row["E_det_on_axis_per_E0(normal)"])
    area = (2 * half) ** 2
    power, se = scattered(t)
    se = float(np.hypot(se / area, 3e-4 * expected))
    check("irradiance", power / area, se, expected, 2e-3)


@pytest.mark.parametrize("aim", ["auto", "targets"])
def test_two_scatters(load_scene: Load, aim: str) -> None:
    first = bsdf_xml("abg", A=0.05, B=0.1, g=2.0, event="transmission")
    second = bsdf_xml("harvey_shack", b0=0.3, l=0.2, s=-2.0, event="transmission")
    forms = integrals.abg(0.05, 0.1, 2.0), integrals.harvey_shack(0.3, 0.2, -2.0)
    at, along, half = np.array([20.0, 0.0, 60.0]), np.array([0.0, 0.0, 1.0]), 0.1
    text = scatter_scene(
        beam_xml(1e-3, power=1.0),
        placed_xml("asphere", "one", scattering_xml([first], R=0.0, T=1.0), semi_diameter=1.0),
        placed_xml("asphere", "two", scattering_xml([second], R=0.0, T=1.0), at=(0.0, 0.0, 30.0), semi_diameter=10.0),
        target_xml("aim_two", "two", "rectangle", at=at, scale=(half, half, 1.0)),
        target_xml("aim_one", "one", at=(0.0, 0.0, 30.0), scale=(10.0, 10.0, 1.0)),
        placed_xml("asphere", "detector", at=at, pixels=4, half_width=half, half_height=half),
    )
    t = mistray.trace(load_scene(text), rays=300_000, max_scatters=2, aim=aim, **EVERYTHING)
    expected = integrals.two_scatters(*forms, 30.0, 10.0, at, along)
    # what passes the first plate unscattered hits the middle of the second, and is scattered once
    once = integrals.rectangle_flux(forms[1], along, at - 30 * along, *(half * np.eye(3)[:2]))
    once *= 1 - integrals.total_scatter(forms[0], 0.0)
    both = [row for row in t.paths if row.path in ("ttA", "tiA", "itA", "iiA")]
    single = [row for row in t.paths if row.scatter_1 == "two"]
    for rows, exact, relative in ((both, expected * 4 * half**2, 0.02), (single, once, 3e-3)):
        check("scatter", *t.paths.power([row.path_id for row in rows]), exact, relative)

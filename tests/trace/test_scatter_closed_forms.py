"""First-order and multiple scatter with known answers: diffuse tubes and spheres, discs, plates, cones, double scatter.

A number from a trace must lie within 4 standard errors of the exact one (false alarm 6e-5 each), and the standard error
must be small enough for the test to mean something; both limits are written at the test.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import vectors
from lit_detector import BLACK, lit, meter
from oracles import scatter_integrals as integrals
from oracles import scatter_scenes
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml, target_xml, wall_xml
from oracles.statistics import assert_z, mean_and_error
from vectors import analytic

import mistray
from mistray.recorders import FluxSplit

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
    lamp = {"type": "collimated", "radius": 1.0, "distance": 1.0, "wavelength_nm": 500.0}
    scene = lit(
        lamp,
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
        whole = analytic(f"tube L/r={length:g} rho={rho:g} ", "T (Lambertian entrance)")
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
        expected = analytic(cavity, "effective absorptance (1-rho)/(1-rho(1-f))")
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
        expected = analytic(f"coaxial discs r1={r1} r2={r2} h={distance}", "F12")
        check_detected("disc to disc", t, expected, 0.03 if aim == "none" else 1.5e-3)

    @pytest.mark.parametrize(("offset", "case"), [(0.0, "axis"), (1.5, "offset x=1.5")])
    def test_disc_to_element(self, load_scene: Load, offset: float, case: str) -> None:
        """A square of 0.02 mm takes the place of the element: 1e-5 of curvature. The source has 1 W/mm^2."""
        half = 0.01
        text = scatter_scenes.discs_text(1.0, 0.0, 2.0, offset, half)
        t = mistray.trace(load_scene(text), rays=400_000, max_scatters=1)
        expected = analytic(f"disc r=1 -> dA h=2 {case}", "F")
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


class TestPlates:
    """Irradiance of a detector by an illuminated plate; a detector of 0.1 mm at 100 mm is a point to 2e-5."""

    @pytest.mark.parametrize(
        ("case", "angle_deg"),
        [
            *(("Lambertian plate rho=.05", angle) for angle in (0, 30, 60)),
            *(("ABg plate normal inc", angle) for angle in (5, 30, 60)),
        ],
    )
    def test_irradiance(self, load_scene: Load, case: str, angle_deg: int) -> None:
        lambertian = case.startswith("Lambertian")
        axis = axis_at(180 - angle_deg if lambertian else angle_deg)
        surface = wall_xml(0.05) if lambertian else ABG
        t = mistray.trace(load_scene(lit_plate(surface, axis, 0.05)), rays=100_000, aim="targets")
        power, se = scattered(t)
        expected = analytic(f"{case} d=100 th={angle_deg} ", "E_det per W [1/mm2]")
        check("irradiance", power / 0.01, se / 0.01, expected, 2e-3, RIM)
        assert lambertian or power / sum(row.power_W for row in t.paths) == 1  # nothing but scatter gets there

    @pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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

"""The oracles of scatter against tabulated vectors, published numbers and each other."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import beams, scatter, scene_xml
from oracles import scatter_integrals as integrals
from oracles.scatter_scenes import bsdf_xml, discs_text, lenses_text, sphere_text, tube_text
from oracles.statistics import assert_z
from vectors import analytic, rows

PROFILES = {
    "lamb": integrals.lambertian(0.05),
    "abg": integrals.abg(2e-5, 1e-6, 2),
    "har": integrals.harvey_shack(0.1099, 0.01, -1.5),
}


def traced(text: str, rays: int, **limits: float) -> scatter.Books:
    model = scene_xml.parse_scene(text)
    distance = beams.start_distance(model, model.emitters[0])
    beam = beams.collimated(model.emitters[0], rays, distance)
    models = scatter.scatter_models(text)
    return scatter.trace(model, models, beam.origin, beam.direction, beam.power, 550.0, **limits)


class TestIntegrals:
    @pytest.mark.parametrize("row", rows("is_cone_flux.csv"), ids=lambda r: "_".join(list(r.values())[:5]))
    def test_cone_flux(self, row: dict[str, str]) -> None:
        numbers = (float(row[key]) for key in ("theta_i", "cone_axis_theta", "cone_axis_phi", "cone_half_deg"))
        flux = integrals.cone_flux(PROFILES[row["bsdf"]], *numbers)
        assert flux == pytest.approx(float(row["Phi_imp/Phi_inc"]), rel=1e-9)

    def test_lambertian_cone(self) -> None:
        """rho sin^2(h) cos(axis) above the horizon."""
        flux = integrals.cone_flux(integrals.lambertian(0.3), 20.0, 40.0, 77.0, 13.0)
        assert flux == pytest.approx(0.3 * np.sin(np.radians(13)) ** 2 * np.cos(np.radians(40)), rel=1e-12)

    @pytest.mark.parametrize("row", rows("scatter_plate_converging.csv"), ids=lambda r: "_".join(r.values())[:34])
    def test_plate_in_a_converging_beam(self, row: dict[str, str]) -> None:
        profile = {"h": PROFILES["har"], "l": PROFILES["lamb"], "A": PROFILES["abg"]}[row["BTDF"][0]]
        found = integrals.converging_irradiance(
            profile, float(row["plate_z_mm"]), float(row["theta_deg"]), focal=100.0, radius=10.0
        )
        assert found == pytest.approx(float(row["E_det_on_axis_per_E0(normal)"]), rel=1e-9)

    @pytest.mark.parametrize(
        ("angle_deg", "expected"), [(0, 0.04134369388), (30, 0.03936), (60, 0.03258), (85, 0.02197)]
    )
    def test_total_of_an_abg(self, angle_deg: float, expected: float) -> None:
        found = integrals.total_scatter(integrals.abg(0.0025, 0.001, 1.8), np.sin(np.radians(angle_deg)))
        assert found == pytest.approx(expected, rel=1e-9 if angle_deg == 0 else 3e-4)

    @pytest.mark.parametrize("sine", [0.0, 0.3, 0.7, 0.999, 1.0])
    def test_total_of_a_lambertian(self, sine: float) -> None:
        assert integrals.total_scatter(integrals.lambertian(0.05), sine) == pytest.approx(0.05, rel=1e-12)

    @pytest.mark.parametrize("rho", ["0.05", "0.5", "1"])
    @pytest.mark.parametrize("length", ["1", "2", "4", "10"])
    def test_tube(self, length: str, rho: str) -> None:
        found = integrals.tube_orders(float(length), float(rho), 600).sum()
        assert found == pytest.approx(analytic(f"tube L/r={length} rho={rho} ", "T (Lambertian entrance)"), rel=1e-8)

    @pytest.mark.parametrize(("rho", "port"), [("0.95", "0.02"), ("0.98", "0.05"), ("0.5", "0")])
    def test_sphere(self, rho: str, port: str) -> None:
        found = integrals.sphere_orders(float(rho), float(port), 2000).sum()
        assert found == pytest.approx(
            analytic(f"int. sphere rho={rho} f={port}", "fraction out of ports (1st hit on wall)"), abs=1e-12
        )

    def test_view_factors(self) -> None:
        for r1, r2, h in ((1, 1, 1), (1, 1, 4), (1, 2, 5), (5, 1, 10)):
            case = f"coaxial discs r1={r1} r2={r2} h={h}"
            assert integrals.disc_to_disc(r1, r2, h) == pytest.approx(analytic(case, "F12"), rel=1e-12)
        assert integrals.element_to_disc(1, 2, 0) == analytic("disc r=1 -> dA h=2 axis", "F")
        assert integrals.element_to_disc(1, 2, 1.5) == pytest.approx(analytic("disc r=1 -> dA h=2 offset", "F"))

    @pytest.mark.parametrize("angle_deg", [5, 30, 60])
    def test_plate_to_detector(self, angle_deg: int) -> None:
        t = np.radians(angle_deg)
        out = np.array([np.sin(t), 0.0, np.cos(t)])
        right, up = np.array([np.cos(t), 0.0, -np.sin(t)]), np.array([0.0, 1.0, 0.0])
        size = 1e-3
        flux = integrals.rectangle_flux(
            integrals.abg(0.0025, 0.001, 1.8), np.array([0.0, 0.0, 1.0]), 100 * out, size * right, size * up
        )
        expected = analytic(f"ABg plate normal inc d=100 th={angle_deg} ", "E_det per W [1/mm2]")
        assert flux / (4 * size**2) == pytest.approx(expected, rel=1e-8)

    def test_two_scatters_reduce_to_one(self) -> None:
        """A first plate of nearly no width: f2 about the axis times its total, seen from z = distance."""
        narrow = integrals.harvey_shack(1e8, 1e-6, -8.0)
        target = np.array([30.0, 0.0, 90.0])
        found = integrals.two_scatters(
            narrow, integrals.abg(0.0025, 0.001, 1.8), 50.0, 20.0, target, np.array([0.0, 0.0, 1.0])
        )
        sine = 30 / 50
        once = integrals.abg(0.0025, 0.001, 1.8)(sine) * (1 - sine**2) / 2500
        assert found == pytest.approx(once * integrals.total_scatter(narrow, 0.0), rel=1e-4)


class TestTracer:
    """The Monte Carlo against the integrals: each number within 4 standard errors, false alarm 6e-5."""

    def check(self, what: str, books: scatter.Books, expected: float) -> None:
        power, se = books.detected
        assert_z(what, power / books.launched_W, expected, se / books.launched_W, k=4.0)
        assert se < 0.03 * power

    def test_discs(self) -> None:
        self.check("discs", traced(discs_text(1.0, 2.0, 5.0), 20_000), integrals.disc_to_disc(1, 2, 5))

    @pytest.mark.parametrize("rho", [0.5, 1.0])
    def test_tube(self, rho: float) -> None:
        bounces = 5
        books = traced(tube_text(2.0, rho), 20_000, max_scatters=bounces + 1)
        orders = integrals.tube_orders(2.0, rho, bounces)
        self.check("tube", books, orders.sum())
        path = "entrance:t wall:r wall:r detector:A"
        power, se = books.power(path)
        assert_z("two bounces", power / np.pi, orders[2], se / np.pi, k=4.0)

    def test_sphere(self) -> None:
        books = traced(sphere_text(0.95, 0.1), 40_000, max_scatters=12)
        self.check("sphere", books, integrals.sphere_orders(0.95, 0.1, 12).sum())
        wall, se = scatter.mean_and_se(books.absorbed["wall"])
        hits = (1 - (0.95 * 0.9) ** 13) / (1 - 0.95 * 0.9)
        assert_z("wall", wall / np.pi, 0.05 * hits, se / np.pi, k=4.0)

    def test_energy(self) -> None:
        """What is launched is detected, absorbed, cut or escapes."""
        text = lenses_text(bsdf_xml("abg", A=0.02, B=0.05, g=2.0))
        books = traced(text, 3_200, max_scatters=2, max_reflections=4, flux_threshold=1e-5)
        parts = [books.detected, *(scatter.mean_and_se(v) for v in books.absorbed.values())]
        parts += [scatter.mean_and_se(books.escaped), scatter.mean_and_se(books.cut)]
        total, error = np.array(parts).T
        assert_z("energy", total.sum(), books.launched_W, np.hypot.reduce(error), k=4.0)
        assert min(total) >= 0

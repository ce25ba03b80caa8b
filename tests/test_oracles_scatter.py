"""The oracles of scatter against closed forms and each other."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import beams, scatter, scene_xml
from oracles import scatter_integrals as integrals
from oracles.scatter_scenes import bsdf_xml, lenses_text, tube_text
from oracles.statistics import assert_z


def traced(text: str, rays: int, **limits: float) -> scatter.Books:
    model = scene_xml.parse_scene(text)
    beam = beams.collimated(model.emitters[0], rays, beams.start_distance(model, model.emitters[0]))
    models = scatter.scatter_models(text)
    return scatter.trace(model, models, beam.origin, beam.direction, beam.power, 550.0, **limits)


def test_a_lambertian() -> None:
    """ρ sin² h cos(axis) into a cone above the horizon; ρ in all, whatever the angle."""
    flux = integrals.cone_flux(integrals.lambertian(0.3), 20.0, 40.0, 77.0, 13.0)
    assert flux == pytest.approx(0.3 * np.sin(np.radians(13)) ** 2 * np.cos(np.radians(40)), rel=1e-12)
    for sine in (0.0, 0.3, 0.7, 0.999, 1.0):
        assert integrals.total_scatter(integrals.lambertian(0.05), sine) == pytest.approx(0.05, rel=1e-12)


class TestTracer:
    """The Monte Carlo against the integrals: each number within 4 standard errors, false alarm 6e-5."""

    @pytest.mark.parametrize("rho", [0.5, 1.0])
    def test_tube(self, rho: float) -> None:
        bounces = 5
        books = traced(tube_text(2.0, rho), 20_000, max_scatters=bounces + 1)
        orders = integrals.tube_orders(2.0, rho, bounces)
        path = "entrance:t wall:r wall:r detector:A"
        for what, (power, se), expected in (
            ("tube", books.detected, orders.sum()),
            ("two bounces", books.power(path), orders[2]),
        ):
            assert_z(what, power / np.pi, expected, se / np.pi, k=4.0)
        assert books.detected[1] < 0.03 * books.detected[0]

    def test_energy(self) -> None:
        text = lenses_text(bsdf_xml("abg", A=0.02, B=0.05, g=2.0))
        books = traced(text, 3_200, max_scatters=2, max_reflections=4, flux_threshold=1e-5)
        parts = [books.detected, *(scatter.mean_and_se(v) for v in books.absorbed.values())]
        parts += [scatter.mean_and_se(books.escaped), scatter.mean_and_se(books.cut)]
        total, error = np.array(parts).T
        assert_z("energy", total.sum(), books.launched_W, np.hypot.reduce(error), k=4.0)
        assert min(total) >= 0

"""Hits of the detector: where they count on a film with a tent, and what a metric gains from each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.frozen_paths import Hits, tent_image
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.errors import MistrayError
from mistray.execute.tracer import Run, prepare
from mistray.kernel.ray_tree import trace_tree
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.branch_recorder import NODE_FLOATS
from mistray.recorders.film import spreads
from mistray.recorders.ledger import DecodedPaths, Ledger
from mistray.settings import Settings
from mistray.surfaces.upload import upload

RAYS = 4000


def lens_text(
    film: str = '<rfilter type="box"/>', pixels: int = 8, z: float = 14.0, far: float = 0.0, radius: float = 3.5
) -> str:
    """A lens with ghosts; its beam is larger than the detector, whose middle may lie far from the axis."""
    glass = interface_xml("air", "1.7"), interface_xml("1.7", "air")
    detector = shape_xml("asphere", "detector", z, interface_xml(R=0.1), sensor=True, half_width=1.5, half_height=1.0)
    text = scene_text(
        shape_xml("asphere", "front", 3.0, glass[0], curvature=0.08, semi_diameter=4.0),
        shape_xml("asphere", "rear", 6.0, glass[1], curvature=-0.02, semi_diameter=4.0),
        detector,
        radius=radius,
    )
    text = text.replace('value="64"', f'value="{pixels}"').replace('<rfilter type="box"/>', film)
    return text.replace(f'<translate z="{z!r}"/>', f'<translate x="{-far!r}" z="{z!r}"/>')


def executed(scene: Any, **settings: Any) -> Run:
    (run,) = prepare(scene, Settings.of(scene, rays=RAYS, **settings))
    return run.execute(ledger=True)


def books(run: Run) -> tuple[Ledger, DecodedPaths]:
    assert run.ledger is not None
    assert run.sums.paths is not None
    return run.ledger, run.sums.paths


def recorded(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[bytes]]:
    """x, y (mm), weight and events of every hit of a plane detector that is not tilted, from the recorder."""
    recorder = run.record(None, 100_000)
    n = int(recorder.count[0])
    nodes = np.array(recorder.nodes).reshape(recorder.capacity, -1, NODE_FLOATS)
    length = np.array(recorder.length)[:n]
    last = nodes[np.arange(n), length - 1].astype(np.float64)
    codes = np.array(recorder.codes).reshape(recorder.capacity, -1)[:n]
    texts = [codes[i, : length[i]].tobytes() for i in range(n)]
    x, y = (last[:, :2] - run.table.vertices[run.table.detector][:2]).T
    return x, y, last[:, 6], texts


def metric(run: Run, **derivatives: Any) -> Adjoint:
    return Adjoint(0, run.make_film(), **derivatives, ledger=run.ledger)


def gains(run: Run, adjoint: Adjoint) -> float:
    trace_tree(run.scene, run.start_pass(0), run.settings, [adjoint])
    dr.eval(adjoint.gain)
    return float(np.array(adjoint.gain).sum())


class TestTent:
    def test_a_hit_is_spread_over_four_pixels(self, load_scene) -> None:
        """The image is that of the oracle, float64, from the hits of the recorder; no flux is lost at the border."""
        run = executed(load_scene(lens_text('<rfilter type="tent"/>')))
        x, y, w, _ = recorded(run)
        zero = np.zeros((0, len(x), 3))
        expected = tent_image([Hits(x, y, 0.9 * w, w, zero, [])], (-1.5, 1.5, -1.0, 1.0), (8, 8))
        np.testing.assert_allclose(run.light.value, expected, rtol=2e-4, atol=1e-6 * expected.max())
        np.testing.assert_allclose(run.light.value.sum(), 0.9 * w.sum(), rtol=1e-6)
        assert np.any(np.abs(x) > 1.5 - 1.5 / 8)  # beyond the centres of the outer pixels

    def test_a_box_counts_in_one(self, load_scene) -> None:
        run = executed(load_scene(lens_text()))
        x, y, w, _ = recorded(run)
        expected, _, _ = np.histogram2d(y, x, bins=8, range=((-1.0, 1.0), (-1.5, 1.5)), weights=0.9 * w)
        np.testing.assert_allclose(run.light.value, expected, rtol=2e-3, atol=1e-3 * expected.max())
        np.testing.assert_allclose(run.light.value.sum(), 0.9 * w.sum(), rtol=1e-6)
        # Maps of paths are spread by a tent as well
        t = mistray.trace(load_scene(lens_text('<rfilter type="tent"/>')), rays=RAYS)
        single = sum(t.irradiance_of([row.path_id])[0] for row in t.paths)
        np.testing.assert_allclose(single, t.irradiance, rtol=1e-9)

    def test_a_tent_of_another_width(self, load_scene) -> None:
        film = '<rfilter type="tent"><float name="radius" value="2.5"/></rfilter>'
        with pytest.raises(MistrayError, match=r"rfilter 'tent' has a radius of 2.5 pixels"):
            executed(load_scene(lens_text(film)))

        for kind, expected in (("tent", True), ("box", False), ("gaussian", False)):
            assert spreads(mi.load_dict({"type": "hdrfilm", "rfilter": {"type": kind}})) is expected


class TestDerivativeOfHits:
    @pytest.mark.parametrize("film", ["box", "tent"])
    def test_by_pixels(self, load_scene, film: str) -> None:
        run = executed(load_scene(lens_text(f'<rfilter type="{film}"/>')))
        pixel = np.random.default_rng(2).normal(size=(8, 8))
        expected = np.sum(pixel * run.light.value)
        assert gains(run, metric(run, pixel=upload(mi.Float, pixel))) == pytest.approx(expected, rel=1e-5)

    def test_by_moments_of_paths(self, load_scene) -> None:
        """The ledger's sums know the flux, its first moments and x² + y²; the rest comes from the recorder."""
        run = executed(load_scene(lens_text()))
        ledger, paths = books(run)
        rng = np.random.default_rng(3)
        coefficients = np.zeros((ledger.capacity, 6))
        coefficients[paths.slots] = rng.normal(size=(len(paths.slots), 6))
        x, y, w, texts = recorded(run)
        expected = 0.0
        for events, length, slot in zip(paths.events, paths.lengths, paths.slots, strict=True):
            mine = np.array([text == events[:length].tobytes() for text in texts])
            assert mine.any()
            terms = np.stack([np.ones(mine.sum()), x[mine], y[mine], x[mine] ** 2, y[mine] ** 2, x[mine] * y[mine]])
            expected += float(coefficients[slot] @ terms @ (0.9 * w[mine]))
        found = gains(run, metric(run, path=upload(mi.Float64, coefficients)))
        assert found == pytest.approx(expected, rel=1e-5)
        assert found != pytest.approx(1.01 * expected, rel=1e-5)
        # Variance of the place about its mean: its terms cancel to some 1e-6 of their size
        run = executed(load_scene(lens_text(z=19.0, far=1.2, radius=0.2)))
        ledger, paths = books(run)
        sums = paths.sums.sum(axis=1)
        slot = int(paths.slots[np.argmax(sums[:, 2])])
        _, _, flux, moment, *_ = sums[np.argmax(sums[:, 2])]
        mean = moment / flux
        coefficients = np.zeros((ledger.capacity, 6))
        coefficients[slot] = np.array([mean**2, -2 * mean, 0.0, 1.0, 0.0, 0.0]) / flux
        x, _, w, texts = recorded(run)
        row = int(np.flatnonzero(paths.slots == slot)[0])
        events = paths.events[row][: paths.lengths[row]].tobytes()
        mine = np.array([text == events for text in texts])
        expected = np.average((x[mine] - mean) ** 2, weights=w[mine])
        assert expected < 1e-5 * mean**2
        assert gains(run, metric(run, path=upload(mi.Float64, coefficients))) == pytest.approx(expected, rel=1e-4)

    def test_paths_that_the_ledger_does_not_know(self, load_scene) -> None:
        scene = load_scene(lens_text())
        run = executed(scene, max_reflections=0)
        other = executed(scene, max_reflections=2)
        assert run.ledger is not None
        assert other.sums.paths is not None
        known = np.array(run.ledger.keys)
        other, coefficients = replace(other, ledger=run.ledger), np.zeros((run.ledger.capacity, 6))
        coefficients[:, 0] = 1.0
        adjoint = metric(other, path=upload(mi.Float64, coefficients))
        found = gains(other, adjoint)
        direct = other.sums.paths.sums.sum(axis=1)[other.sums.paths.keys == known[known != 0][0]][0, 2]
        assert found == pytest.approx(direct, rel=1e-6)
        assert float(adjoint.unknown[0]) == pytest.approx(other.sums.paths.sums.sum(axis=(0, 1))[2] - direct, rel=1e-5)
        np.testing.assert_array_equal(np.array(run.ledger.keys), known)

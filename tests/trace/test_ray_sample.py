"""Rays and maps of many paths at once against those of one path, and against the paths in a box."""

from __future__ import annotations

import numpy as np
import pytest

import mistray
from mistray.events import EVENT_BITS, EVENT_MASK, LETTERS
from mistray.execute import tracer
from mistray.report.html.embedded import power_codes

RAYS = 5000


@pytest.fixture(scope="module")
def report():
    return mistray.ghosts(mistray.load("singlet_window_detector"), field_deg=[0.0, 2.0], rays=RAYS)


def test_box_of_the_report_is_that_of_the_trace(report):
    """The same rays once more, hit by hit, with the box in the kernel."""
    t = report[2.0]
    by_events = dict(zip(report.table(2.0).events, report.table(2.0).path_id, strict=True))
    maps = report.path_maps(2.0, list(by_events.values()))
    height, width = t.irradiance.shape
    x0, x1, y0, y1 = t.extent
    bright = np.argwhere(t.irradiance == t.irradiance.max())[0][::-1] // maps.grid
    most = np.array([width, height]) // maps.grid
    for first, last in (
        (bright, bright + 1),
        (np.maximum(bright - 3, 0), np.minimum(bright + 2, most)),
        (most // 4, most // 2),
    ):
        columns, rows = zip(first * maps.grid, last * maps.grid, strict=True)
        x, y = (x0 + (x1 - x0) * np.array(columns) / width), (y0 + (y1 - y0) * np.array(rows) / height)
        within = t.box(*x, *y)
        expected = {by_events[row.events]: row.power_W for row in within}
        found = {path_id: m.within(columns, rows) for path_id, m in maps.paths.items()}
        found = {path_id: power for path_id, power in found.items() if power > 0}
        assert found == pytest.approx(expected, rel=1e-5)
        # As the page has them
        for path_id, power in found.items():
            m = maps.paths[path_id]
            codes = power_codes(m.power_W).astype(float)
            rounded = np.where(codes > 0, 10 ** (codes / 600 - 100), 0.0)
            stored = type(m)(m.pixels, m.column, m.row, rounded).within(columns, rows)
            assert stored == pytest.approx(power, rel=2e-3)


def test_sampled_rays_are_rays_of_their_path(report):
    t = report[2.0]
    ids = [row.path_id for row in t.paths[:12]]
    sample = t.sampled_rays(ids, 20)
    assert list(sample) == ids
    names = t.tables[0].event_ids
    for path_id, rays in sample.items():
        for ray in rays:
            words = [f"{names[code >> EVENT_BITS]}:{LETTERS[code & EVENT_MASK]}" for code in ray.codes.tolist()]
            assert " ".join(words) == t.paths[path_id].events
    # The strongest ones are there, and spread over the beam
    first = np.array([ray.points[0] for ray in sample[ids[0]]])
    assert len(first) == 20
    assert np.ptp(first[:, 0]) > 0.5 * np.ptp([ray[0, 0] for ray in t.history(ids[0], 500).rays])


def test_sampled_rays_are_those_of_the_history(report):
    t = report[0.0]
    path_id = t.paths[1].path_id
    every = {ray.start_ray: ray for ray in t.history(path_id, RAYS)._rays}
    sample = t.sampled_rays([path_id], 10)[path_id]
    assert len(sample) == 10
    for ray in sample:
        np.testing.assert_allclose(ray.points, every[ray.start_ray].points, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(ray.flux_W, every[ray.start_ray].flux_W, rtol=1e-6)


def test_history_of_a_large_trace_is_spread_over_the_beam(report, monkeypatch):
    """A batch of more start rays than the recorder holds: not those of one corner of the beam alone."""
    t = report[0.0]
    whole = np.array([ray[0, :2] for ray in t.history(0, RAYS).rays])
    monkeypatch.setattr(tracer, "RECORD_CAPACITY", 16)  # of 125 start rays of a batch
    few = np.array([ray[0, :2] for ray in t.history(0, 16).rays])
    assert len(few) > 10
    assert (np.ptp(few, axis=0) > 0.6 * np.ptp(whole, axis=0)).all()

"""The view of a real trace: rays meet the surfaces that their events name, drawn are the rays of the history."""

from __future__ import annotations

import re

import numpy as np
import pytest

import mistray
from mistray.report.rays.path_rays import rays_of_paths


@pytest.fixture(scope="module")
def triplet():
    return mistray.load("cooke_triplet")


@pytest.fixture(scope="module")
def trace(triplet):
    return mistray.trace(triplet, rays=2_000, field_deg=10.0, max_reflections=2, max_scatters=0)


@pytest.fixture(scope="module")
def shown(triplet, trace):
    return mistray.view(triplet, trace, paths=3, rays=4)


def test_events_are_those_of_the_rows(shown, trace):
    """Exporting some rows gives polylines whose event strings equal the rows."""
    assert {ray.path_id for ray in shown.rays} == {0, 1, 2}
    for ray in shown.rays:
        assert ray.events == trace.paths[ray.path_id].events


def test_every_hit_lies_on_the_surface_that_its_event_names(shown, triplet):
    surfaces = {shape.id(): shape for shape in triplet.shapes()}
    met = set()
    for ray in shown.rays:
        for point, event in zip(ray.points[1:], ray.events.split(), strict=True):
            name = event.rpartition(":")[0]
            curvature, vertex = surfaces[name].values["curvature"], surfaces[name].matrix[2, 3]
            depth = point[2] - vertex
            # the sphere about (0, 0, vertex + 1/c) by its equation c (x² + y² + z²) = 2 z
            error = curvature * (point @ point - point[2] ** 2 + depth**2) / 2 - depth
            assert abs(error) < 1e-9, name
            met.add(name)
    assert {"L1_front", "L3_rear", "detector"} <= met


def test_the_picture_has_the_rays_of_the_history(shown, trace):
    drawn = {lines.meta["path_id"]: lines for lines in shown.figure.data if "path_id" in (lines.meta or {})}
    for path_id, lines in drawn.items():
        xyz = np.column_stack([lines.x, lines.y, lines.z])
        exact = [part for ray in trace.history(path_id, 4).rays for part in (ray, np.full((1, 3), np.nan))]
        np.testing.assert_array_equal(xyz, np.concatenate(exact))
        assert lines.name.startswith(f"{path_id} ")
    assert len({lines.name for lines in drawn.values()}) == len(drawn)


def test_flux_falls_along_a_ray(trace):
    for ray in rays_of_paths(trace, [0, 1], n=2):
        assert (np.diff(ray.flux_W) <= 0).all()
        assert ray.flux_W[0] == pytest.approx(trace.energy.launched_W / 2_000)


def test_hovering_shows_the_surface_table(shown, trace):
    text = {mesh.meta["surface"]: mesh.hovertemplate for mesh in shown.figure.data if "surface" in (mesh.meta or {})}
    for row in trace.surfaces:
        if row.id in text:
            value, hits = re.search(r"incident ([-+.\de]+) ± \S+ W, ([\d ]+) hits", text[row.id]).groups()
            assert float(value) == pytest.approx(row.incident_W, abs=row.incident_se_W)
            assert int(hits.replace(" ", "")) == row.hits
            assert f"part {row.part}<br>" in text[row.id]


def test_a_page_of_many_surfaces_is_small():
    """The phone camera has 70 surfaces; rays add little."""
    shown = mistray.view(mistray.load("phone_camera"))
    assert len(shown.surfaces) > 60
    assert len(shown.html().encode()) < 6_000_000


def test_scattered_rays():
    scene = mistray.load("plate_and_wall")
    t = mistray.trace(scene, rays=1_000, max_reflections=1)
    shown = mistray.view(scene, t, rays=2)
    assert any(t.paths[ray.path_id].scatters for ray in shown.rays)
    assert all(ray.events == t.paths[ray.path_id].events for ray in shown.rays)

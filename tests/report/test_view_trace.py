"""The view of a real trace: rays meet the surfaces that their events name, drawn are the rays of the history."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_hex

import mistray
from mistray.errors import MistrayError
from mistray.report.rays.path_rays import rays_of_paths
from mistray.report.view3d.controls import NO_LIGHT


@pytest.fixture(scope="module")
def triplet():
    return mistray.load("cooke_triplet")


@pytest.fixture(scope="module")
def trace(triplet):
    return mistray.trace(triplet, rays=2_000, field_deg=10.0, max_reflections=2, max_scatters=0)


@pytest.fixture(scope="module")
def shown(triplet, trace):
    return mistray.view(triplet, trace, paths=3, rays=4)


def test_every_hit_lies_on_the_surface_that_its_event_names(shown, triplet, trace):
    surfaces = {shape.id(): shape for shape in triplet.shapes()}
    met = set()
    assert {ray.path_id for ray in shown.rays} == {0, 1, 2}
    for ray in shown.rays:
        assert ray.events == trace.paths[ray.path_id].events
        for point, event in zip(ray.points[1:], ray.events.split(), strict=True):
            name = event.rpartition(":")[0]
            curvature, vertex = surfaces[name].values["curvature"], surfaces[name].matrix[2, 3]
            depth = point[2] - vertex
            # the sphere about (0, 0, vertex + 1/c) by its equation c (x² + y² + z²) = 2 z
            error = curvature * (point @ point - point[2] ** 2 + depth**2) / 2 - depth
            assert abs(error) < 1e-9, name
            met.add(name)
    assert {"L1_front", "L3_rear", "detector"} <= met
    # Flux falls along a ray
    for ray in rays_of_paths(trace, [0, 1], n=2):
        assert (np.diff(ray.flux_W) <= 0).all()
        assert ray.flux_W[0] == pytest.approx(trace.energy.launched_W / 2_000)


def test_a_page_of_many_surfaces_is_small(triplet, trace):
    shown = mistray.view(mistray.load("phone_camera"))
    assert len(shown.surfaces) > 60
    assert len(shown.html().encode()) < 6_000_000
    for given in (trace, None):
        with pytest.raises(MistrayError, match="irradiance"):
            mistray.view(triplet, given, colour="irradiance")


@pytest.fixture(scope="module")
def walls():
    scene = mistray.load("plate_and_wall", sensors=["surface_maps:housing* screen,azimuths=12,lengths=5,id=walls"])
    return scene, mistray.trace(scene, rays=3000, field_deg=20.0, max_reflections=1, max_scatters=1)


def test_walls_are_coloured_by_the_irradiance_of_their_cells(walls):
    scene, trace = walls
    shown = mistray.view(scene, trace, paths=1, rays=1, cut_deg=None)
    maps = trace.recorders["walls"].maps
    drawn = {one.meta["wall"]: one for one in shown.figure.data if "wall" in (one.meta or {})}
    assert set(drawn) == set(maps) == {"housing_wall", "housing_face", "screen"}
    for name, mesh in drawn.items():
        corners = maps[name].corners.reshape(-1, 3)
        np.testing.assert_array_equal(np.column_stack([mesh.x, mesh.y, mesh.z]), corners)
        middles = np.mean([corners[np.array(k)] for k in (mesh.i, mesh.j, mesh.k)], axis=0)
        cells = 0.5 * (middles[:60] + middles[60:])  # two triangles each
        # Corners of a facet lie on the tube, so that its middle is within it by 1 - cos 15°
        assert np.linalg.norm(cells - maps[name].places.reshape(-1, 3), axis=1).max() < 0.04 * np.abs(corners).max()
        assert list(mesh.facecolor[:60]) == list(mesh.facecolor[60:])
        value = maps[name].irradiance[0].ravel()
        assert {colour for colour, lit in zip(mesh.facecolor, value > 0, strict=False) if not lit} <= {NO_LIGHT}
    lit = np.concatenate([one.irradiance[0].ravel() for one in maps.values()])
    ends = [colour for mesh in drawn.values() for colour in mesh.facecolor[:60]]
    assert ends[int(np.argmax(lit))] == to_hex(colormaps["viridis"](1.0))


def test_a_button_shows_cells_in_the_place_of_their_walls(walls):
    scene, trace = walls
    shown = mistray.view(scene, trace, paths=1, rays=1, colour="flux")
    data = shown.figure.data
    buttons = {button.label: button.args for button in shown.figure.layout.updatemenus[1].buttons}
    assert list(buttons) == ["incident flux", "absorbed flux", "irradiance", "role"]
    for label, (values, bars, targets) in buttons.items():
        for k, visible in zip(targets, values["visible"], strict=True):
            meta = data[k].meta
            cells = label == "irradiance"
            mapped = meta.get("surface") in trace.recorders["walls"].maps
            assert visible == (cells if "wall" in meta else not (cells and mapped))
        assert bars["coloraxis3.showscale"] == (label == "irradiance")
        if label == "incident flux":  # as it is shown at first
            assert [data[k].visible for k in targets] == list(values["visible"])
    cut = {one.meta["wall"]: one for one in data if "wall" in (one.meta or {})}["housing_wall"]
    assert len(cut.i) == 12 * 5  # half of the cells, two triangles each

"""Where a backward trace aims: the opening, the design path in reverse, and what surfaces see of the sky."""

from typing import Any

import numpy as np
import pytest
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene, wall_xml

import mistray
from mistray.kernel.targets import Target
from mistray.sampling.backward_targets import BackwardTargets, backward_targets, find_opening
from mistray.sampling.design_path import DesignPath, find_design_path
from mistray.settings import Settings
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

AXIS = np.array([0.0, 0.0, 1.0])
DETECTOR = {"pixels": 4, "semi_diameter": 1.0}


def exits_of(scene: Any, axis: np.ndarray = AXIS, **settings: Any) -> tuple[SurfaceTable, BackwardTargets]:
    table = SurfaceTable(scene, 550.0)
    return table, backward_targets(table, scene, Settings(**settings), axis)


def opening_of(scene: Any, axis: np.ndarray = AXIS) -> tuple[Target, DesignPath]:
    table = SurfaceTable(scene, 550.0)
    path = find_design_path(table, scene)
    return find_opening(table, scene, path, axis, np.random.default_rng(0)), path


def tube(*more: str, length: float = 2.0, rho: float = 0.1, beam: str | None = None) -> str:
    return scatter_scene(
        beam_xml(0.5) if beam is None else beam,
        placed_xml("frustum", "tube", wall_xml(rho), r0=1.0, z0=0.0, r1=1.0, z1=length),
        placed_xml("asphere", "detector", at=(0.0, 0.0, length), **DETECTOR),
        *more,
    )


def trail(path: DesignPath, o: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    return [DesignPath(path.table, path.steps[: k + 1], path.end).follow(o, d, 0) for k in range(len(path.steps))]


@pytest.mark.parametrize("name", ["cooke_triplet", "newtonian", "lens_and_reflector", "plate"])
def test_rays_go_back_the_way_they_came(name: str) -> None:
    """The hits of the reversed path are those of the forward one, in float64 to 1e-9 of the size of the scene."""
    scene = mistray.load(name)
    _, path = opening_of(scene)
    opening, _ = opening_of(scene, path.steps[0].before)
    back = path.reversed(opening)
    rng = np.random.default_rng(3)
    first = path.steps[0]
    size = max(np.linalg.norm(step.point - first.point) for step in path.steps)
    d = first.before + 0.01 * rng.normal(size=(50, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = first.point + 0.02 * size * rng.uniform(-1, 1, (50, 3)) - size * d
    forward = trail(path, o, d)
    assert np.all(np.isfinite(forward[-1]))
    towards = (forward[-2] - forward[-1]) / np.linalg.norm(forward[-2] - forward[-1], axis=1, keepdims=True)
    hits = trail(back, forward[-1], towards)
    for hit, expected in zip(hits[:-1], forward[-2::-1], strict=True):
        np.testing.assert_allclose(hit, expected, atol=1e-9 * size)
    # In the plane of the opening, on the line of the ray that came
    normal = back.steps[-1].normal
    t = ((back.end.centre - forward[0]) @ normal) / (d @ normal)
    np.testing.assert_allclose(hits[-1], forward[0] + t[:, None] * d, atol=1e-9 * size)


def test_targets_of_a_tube(load_scene) -> None:
    """The detector and the wall aim at the mouth, a thousandth of the length before it, found to 2 % by its rays."""
    scene = load_scene(tube())
    mouth, _ = opening_of(scene)
    assert (mouth.shape, mouth.centre[2]) == ("ellipse", pytest.approx(-0.002, abs=1e-5))
    np.testing.assert_allclose(mouth.centre[:2], 0, atol=0.03)
    for half in (mouth.u, mouth.v):
        assert np.linalg.norm(half) == pytest.approx(1.0, abs=0.03)
        assert abs(half[2]) < 1e-9
    assert abs(mouth.u @ mouth.v) < 1e-9
    table, found = exits_of(scene, aimed_rays=2)
    (target,) = found.start.targets
    assert target.centre[2] < 0
    aim = found.aims[table.ids.index("tube"), False]
    assert (aim.rays, sum(one.share for one in aim.targets)) == (2, pytest.approx(1))
    for settings in ({"aim": "none"}, {"aim": "targets"}, {"aimed_rays": 0}):
        _, nothing = exits_of(scene, **settings)
        assert ((nothing.aims, nothing.start), nothing.views) == (({}, None), found.views)
    _, closed = exits_of(load_scene(tube(placed_xml("asphere", "lid", semi_diameter=1.0))))
    assert closed.start is None


@pytest.mark.parametrize("beam", ["", beam_xml(0.5, at=(50.0, 0.0, 0.0))])
def test_without_a_path(load_scene, beam: str) -> None:
    table, found = exits_of(load_scene(tube(length=2.5, beam=beam)))
    assert found.light is None
    (target,) = found.start.targets
    assert target.shape == "ellipse"
    assert target.centre[2] < 0
    assert np.linalg.norm(target.u) == pytest.approx(1.0, abs=0.05)
    assert (table.ids.index("tube"), False) in found.aims


@pytest.mark.parametrize(("at", "along", "light"), [((50.0, 0.0, 0.0), 1.0, None), ((0.0, 0.0, 9.0), -1.0, [0, 0, -1])])
def test_another_source_is_not_taken_for_one_before(load_scene, at, along, light) -> None:
    meter = placed_xml("asphere", "detector", at=(0.0, 0.0, 2.0), **DETECTOR)
    _, found = exits_of(load_scene(scatter_scene(beam_xml(0.5), meter)))
    np.testing.assert_allclose(found.light, [0, 0, 1])
    for beam, expected in ((beam_xml(0.5, at=at, along=(0.0, 0.0, along)), light), ("", None)):
        _, found = exits_of(load_scene(scatter_scene(beam, meter)))
        assert (found.light is None) == (expected is None)
        assert found.views == {}
        if expected is not None:
            np.testing.assert_allclose(found.light, expected)

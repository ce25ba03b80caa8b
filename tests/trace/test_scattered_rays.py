"""Rays that scatter, in the tables of rays: positions are found again in float64 on both sides of the scatter event."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.small_scenes import scene_text, shape_xml

import mistray

INDEX = 1.5
NUMBERS = "".join(f'<float name="{name}" value="{value}"/>' for name, value in (("A", 1e-3), ("B", 1e-3), ("g", 2)))
SCATTER = f'<bsdf type="abg">{NUMBERS}</bsdf>'


def plate(glass: str, coat: str) -> str:
    """A plate 5 mm thick with something nested in its front interface; the detector, 15 mm behind it, is black."""
    sides = f'<bsdf type="interface"><string name="{{}}" value="air"/><string name="{{}}" value="{glass}"/>{{}}</bsdf>'
    return scene_text(
        shape_xml("asphere", "front", 0.0, sides.format("front", "back", coat), semi_diameter=30.0),
        shape_xml("asphere", "rear", 5.0, sides.format("back", "front", ""), semi_diameter=30.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=6.0, half_height=6.0),
    )


@pytest.fixture(scope="module")
def trace(load_scene):
    return mistray.trace(load_scene(plate(f"{INDEX}", SCATTER)), rays=20_000, max_reflections=0)


@pytest.fixture(scope="module")
def hazy(load_scene):
    """The plate scatters within."""
    return mistray.trace(load_scene(plate(f"{INDEX} scatter=0.05 g=0.9", "")), rays=20_000, max_reflections=0)


@pytest.mark.parametrize(
    ("glass", "path", "intercept"),
    [("trace", "tTA", "RandTran"), ("trace", "iTA", "ImpTran"), ("hazy", "TtTA", "RandTran")],
)
def test_refraction_holds_after_a_scatter_event(request, glass: str, path: str, intercept: str) -> None:
    """Behind the plate the tangential part of the unit vector is n times that within it: Snell's law, to 1e-12."""
    trace = request.getfixturevalue(glass)
    row = next(row for row in trace.paths if row.path == path)
    assert (row.kind, row.scatters) == ("single scatter", 1)
    assert row.scatter_1.startswith("(1.5" if glass == "hazy" else "front")
    assert {text.split()[-3] for text in trace.rays(f"path_id = {row.path_id}", n=20).history} == {intercept}
    table, nodes = trace.history(row.path_id, 50).to_pandas(), len(path) + 1
    before = ["Emitted"] if glass == "trace" else ["Emitted", "SpecTran"]
    assert list(table.intercept[:nodes]) == [*before, intercept, "SpecTran", "Absorbed"]
    points = table[["x_mm", "y_mm", "z_mm"]].to_numpy().reshape(-1, nodes, 3)
    directions = table[["dx", "dy", "dz"]].to_numpy().reshape(-1, nodes, 3)[:, :-1]
    steps = np.diff(points, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    np.testing.assert_allclose(directions[:, -1, :2], INDEX * directions[:, -2, :2], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1.0, rtol=1e-12)
    np.testing.assert_allclose(directions * lengths[:, :, None], steps, atol=1e-11)
    index = [1.0, *[INDEX] * (nodes - 3), 1.0]
    np.testing.assert_allclose(np.diff(table.opl_mm.to_numpy().reshape(-1, nodes), axis=1), lengths * index, rtol=1e-12)
    np.testing.assert_allclose(points[:, -2:, 2], np.broadcast_to([5.0, 20.0], (len(points), 2)), atol=1e-12)
    depth = points[:, len(before), 2]
    assert np.all((depth > 0) & (depth < 5)) if glass == "hazy" else np.allclose(depth, 0, atol=1e-12)
    turned = np.linalg.norm(directions[:, -2, :2], axis=1)
    assert np.count_nonzero(turned > 1e-6) > 0.9 * len(turned)


def test_the_table_holds_random_and_aimed_light(trace) -> None:
    """Both together are one row of `by_way`; the errors of all paths together are those of the energy ledger."""
    assert trace.paths[0].path == "TTA"
    assert {row.path for row in trace.paths[1:]} == {"tTA", "iTA"}
    rows = trace.paths.by_way()
    assert list(rows.path) == ["TTA", "tTA"]
    scattered = [row for row in trace.paths if row.scatters]
    assert rows.power_W[1] == pytest.approx(sum(row.power_W for row in scattered), rel=1e-9)
    power, se = trace.paths.power(range(len(trace.paths)))
    assert power == pytest.approx(trace.energy.detected_W, rel=1e-9)
    assert se == pytest.approx(trace.energy.detected_se_W, rel=1e-6)

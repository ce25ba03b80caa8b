"""What the lanes of a packet share changes the speed of the kernel and nothing else."""

from __future__ import annotations

import sys
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.recorders import packets
from mistray.surfaces import surface_rows

ray_tree = sys.modules["mistray.kernel.ray_tree"]
SCENES = {
    "double_gauss": {},
    "phone_camera": {},
    "plate_and_wall": {"max_scatters": 2},
    "phone_camera_scatter": {"max_scatters": 2},
}


def numbers(name: str) -> tuple[np.ndarray, np.ndarray, list[tuple[str, int]]]:
    """Film, energy and path table of a small trace."""
    t = mistray.trace(mistray.load(name), rays=500, field_deg=5.0, **SCENES[name])
    energy = [t.energy.escaped_W, *(value for value, _ in t.energy.absorbed.values()), *t.energy.cut.values()]
    return t.irradiance, np.array(energy), sorted((row.path_id, row.rays) for row in t.paths)


def assert_same(a: Any, b: Any) -> None:
    assert a[2] == b[2]
    np.testing.assert_allclose(a[0], b[0], rtol=1e-9, atol=1e-12 * a[0].max())
    np.testing.assert_allclose(a[1], b[1], rtol=1e-9, atol=1e-12 * a[1].max())


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *((name, change) for name in ("double_gauss", "phone_camera") for change in ("levels", "no waiting")),
        ("plate_and_wall", "rows"),
        ("double_gauss", "rows"),
        pytest.param("phone_camera_scatter", "rows", marks=pytest.mark.slow),
    ],
)
def test_same_numbers(name: str, change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the order in which lanes go on nor the place of the surfaces' numbers enters a result."""
    if change == "rows":
        monkeypatch.setattr(surface_rows, "MOST_ROWS", 128)
    usual = numbers(name)
    if change == "rows":
        monkeypatch.setattr(surface_rows, "MOST_ROWS", 0)
    else:
        monkeypatch.setattr(ray_tree, "LEVELS", 1)
    if change == "no waiting":
        monkeypatch.setattr(ray_tree, "in_step", ray_tree.at_once)
    assert_same(numbers(name), usual)


@pytest.mark.parametrize(("terms", "size"), [(1, 1), (2, 2), (7, 8), (8, 8), (10, 16)])
def test_packets_are_sums(terms: int, size: int) -> None:
    rng = np.random.default_rng(1)
    rows, lanes = 5, 1000
    place, values, active = rng.integers(0, rows, lanes), rng.random((terms, lanes)), rng.random(lanes) < 0.7
    assert packets.packet_size(terms) == size
    sums = mi.Float64(np.zeros(rows * size))
    packets.add_packet(sums, [mi.Float64(v) for v in values], mi.UInt32(place), mi.Bool(active))
    expected = np.zeros((rows, size))
    np.add.at(expected[:, :terms], place[active], values[:, active].T)
    np.testing.assert_allclose(np.array(sums).reshape(rows, size), expected, rtol=1e-12)

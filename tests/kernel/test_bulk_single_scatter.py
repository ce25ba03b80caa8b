"""Scatter inside a body: a slab with the Henyey-Greenstein phase function against quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.scatter_integrals import gauss_legendre
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene
from oracles.small_scenes import interface_xml
from oracles.statistics import assert_z

import mistray

THICK, GAP = 10.0, 5.0


def henyey_greenstein(mu: np.ndarray, g: float) -> np.ndarray:
    """Per steradian."""
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * mu) ** 1.5)


def once_into_disc(sigma: float, g: float, radius: float) -> float:
    """Share of an axial beam that is scattered once in a slab of the index around it, and leaves it into a disc."""
    z, wz = gauss_legendre(np.linspace(0.0, THICK, 9), 16)
    total = 0.0
    for depth, weight in zip(z, wz, strict=True):
        least = np.cos(np.arctan2(radius, THICK - depth + GAP))
        mu, wm = gauss_legendre(1 - (1 - least) * np.linspace(1.0, 0.0, 17) ** 4, 16)
        inner = np.sum(wm * 2 * np.pi * henyey_greenstein(mu, g) * np.exp(-sigma * (THICK - depth) / mu))
        total += weight * sigma * np.exp(-sigma * depth) * inner
    return float(total)


def slab_text(sigma: float, g: float, radius: float) -> str:
    medium = f"1.0 scatter={sigma!r} g={g!r}"
    return scatter_scene(
        beam_xml(1e-3, power=1.0, distance=5.0),
        placed_xml("asphere", "front", interface_xml("air", medium, R=0.0, T=1.0), semi_diameter=500.0),
        placed_xml("asphere", "rear", interface_xml(medium, R=0.0, T=1.0), at=(0.0, 0.0, THICK), semi_diameter=500.0),
        placed_xml("asphere", "detector", at=(0.0, 0.0, THICK + GAP), pixels=4, semi_diameter=radius),
    )


@pytest.mark.parametrize(("sigma", "g"), [(0.02, 0.0), (0.05, 0.8), (0.05, -0.5), (0.2, 0.95)])
@pytest.mark.parametrize("radius", [2.0, 20.0])
@pytest.mark.parametrize("splitting", ["split", "one"])
def test_single_scatter(load_scene, sigma: float, g: float, radius: float, splitting: str) -> None:
    """What is not scattered, and what is scattered once into a disc: 4 standard errors, false alarm 6e-5 each."""
    t = mistray.trace(
        load_scene(slab_text(sigma, g, radius)), rays=400_000, max_scatters=1, aim="none", splitting=splitting
    )
    straight = [row.path_id for row in t.paths if row.scatter_1 == "-"]
    once = [row.path_id for row in t.paths if row.scatter_1 != "-"]
    power, se = t.paths.power(straight)
    assert_z("straight on", power, np.exp(-sigma * THICK), se, k=4.0, floor=1e-6)
    power, se = t.paths.power(once)
    expected = once_into_disc(sigma, g, radius)
    assert_z("scattered once", power, expected, se, k=4.0)
    assert se < 0.06 * expected
    assert abs(t.energy.closure) < 1e-6

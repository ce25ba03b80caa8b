"""Radial tables: they follow a profile, their totals are its integrals, and their cells have the right shares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from mistray.errors import MistrayError
from mistray.scatter.radial import R_MAX, RadialTable, node_radii, ring_flux

PROFILES = {
    "ABg": lambda r: 0.0025 / (0.001 + r**1.8),
    "narrow ABg": lambda r: 2e-5 / (1e-9 + r**2),
    "steep ABg": lambda r: 1e-3 / (1e-6 + r**3.5),
    "Harvey": lambda r: 0.1 * (1 + (r / 0.01) ** 2) ** -0.75,
    "Gaussian": lambda r: np.exp(-((r / 0.05) ** 2)),
    "constant": lambda r: 0.3 + 0 * r,
}


def integral(profile: Callable, low: float, high: float) -> float:
    """∫ 2π r f dr over log r, piece by piece."""
    edges = np.geomspace(max(low, 1e-10), high, 200)
    return sum(quad(lambda x: 2 * np.pi * np.exp(2 * x) * profile(np.exp(x)), a, b)[0] for a, b in
               zip(np.log(edges[:-1]), np.log(edges[1:]), strict=True))  # fmt: skip


@pytest.mark.parametrize("name", PROFILES)
def test_values_and_totals(name: str) -> None:
    profile = PROFILES[name]
    table = RadialTable.of(profile)
    r = np.exp(np.random.default_rng(1).uniform(-17, np.log(2), 2000))
    error = np.abs(table.value(r) - profile(r))
    assert np.all(error < 1e-3 * profile(r) + 1e-6 * profile(np.array(1e-9)))
    assert table.total == pytest.approx(integral(profile, 0, 2.0), rel=1e-4)
    for edge in (1e-4, 0.02, 0.3, 1.0):
        assert table.within(np.array([edge]))[0] == pytest.approx(integral(profile, 0, edge), rel=1e-4), edge


def test_a_profile_ends_where_it_is_told_to() -> None:
    table = RadialTable.of(PROFILES["constant"], 1.0)
    assert table.within(np.array([1.0, R_MAX])) == pytest.approx([0.3 * np.pi] * 2, rel=1e-3)
    assert table.value(np.array([1.5]))[0] < 1e-25


@pytest.mark.parametrize("name", PROFILES)
def test_the_alias_table_has_the_shares_of_the_cells(name: str) -> None:
    table = RadialTable.of(PROFILES[name])
    count = len(table.probability)
    share = table.probability / count
    np.add.at(share, table.alias, (1 - table.probability) / count)
    flux = ring_flux(node_radii()[:-1], table.log2_values)
    assert share[1:] == pytest.approx(flux / table.total, abs=1e-15)


@pytest.mark.parametrize(
    "bad", [lambda r: -r, lambda r: np.nan * r, lambda r: 0 * r, lambda r: 1 / np.maximum(r - 1, 0)]
)
def test_impossible_profiles(bad: Callable) -> None:
    with pytest.raises(MistrayError, match="give a BSDF > 0"), np.errstate(divide="ignore"):
        RadialTable.of(bad)

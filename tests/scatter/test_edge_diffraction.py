"""Edge diffraction as scatter: its lobe, its total, how it grows off the normal, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mistray.errors import MistrayError
from mistray.physics import diffraction
from mistray.scatter.edge_diffraction import EdgeDiffraction
from mistray.scatter.evaluate import bsdf
from mistray.scatter.radial import RadialTable
from mistray.scatter.total import factor_values, lobe_total

DATA = Path(__file__).parents[1] / "data"


def test_aperture_vectors() -> None:
    """Flux of a thin ring times its BSDF is the BDDF of the aperture, at any width of the ring."""
    table = pd.read_csv(DATA / "diffraction_circular.csv", comment="#", skipinitialspace=True)
    for row in table.itertuples():
        r0 = 0.98 * row.radius_mm
        width = (row.radius_mm**2 - r0**2) / (2 * row.radius_mm)
        lobes = EdgeDiffraction(width).lobes(1e6 * row.lambda_mm, 1.0, 1.0, True)
        directions = np.array([math.sin(row.theta_rad), 0.0, math.cos(row.theta_rad)])
        found = float(bsdf(lobes, "transmission", 1.0, directions, 1.0, 1.0, 1.0))
        share = 1 - (r0 / row.radius_mm) ** 2
        knee = diffraction.spread() * row.lambda_mm / width
        if row.theta_rad > 10 * knee:
            assert share * found == pytest.approx(row[7], rel=1e-9), row
        heisenberg = EdgeDiffraction(width, "heisenberg").lobes(1e6 * row.lambda_mm, 1.0, 1.0, True)
        higher = float(bsdf(heisenberg, "transmission", 1.0, directions, 1.0, 1.0, 1.0))
        if row.theta_rad > 10 * knee:
            assert higher / found == pytest.approx(math.sqrt(math.pi / 2), rel=1e-9)


@pytest.mark.parametrize("law", ["half_plane", "heisenberg"])
@pytest.mark.parametrize("width", [0.015, 0.1, 1.0])
def test_all_light_is_deflected(width: float, law: str) -> None:
    """The total is 1 far from grazing incidence, and nowhere more, so that every ring has a balanced budget."""
    cosines = np.linspace(0, 1, 101)
    for n_in, n_out in ((1.0, 1.0), (1.0, 1.5), (1.5, 1.0)):
        (lobe,) = EdgeDiffraction(width, law).lobes(550.0, n_in, n_out, True)
        total = lobe_total(lobe, cosines, n_in, n_out)
        assert np.all(total < 1 + 1e-6)
        assert total[-1] == pytest.approx(1, abs=1.5e-3), "0.13 % of the law of Heisenberg lie beyond the horizon"
        if n_in <= n_out:
            assert np.all(total[80:] > 0.99)


def test_table_is_the_profile() -> None:
    (lobe,) = EdgeDiffraction(0.05).lobes(550.0, 1.0, 1.0, True)
    table = RadialTable.of(lobe.profile)
    r = np.geomspace(1e-7, 1.9, 300)
    np.testing.assert_allclose(table.value(r), lobe.profile(r), rtol=1e-4)


def test_reciprocal() -> None:
    """BSDF(i → s) = BSDF(s → i) to the rounding, also far from the normal; the factor is that of the two directions."""
    rng = np.random.default_rng(2)
    (lobe,) = EdgeDiffraction(0.05).lobes(550.0, 1.0, 1.0, True)
    for _ in range(50):
        i, s = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        i[2], s[2] = abs(i[2]), abs(s[2])
        r = float(np.linalg.norm(i[:2] - s[:2]))
        there, back = (float(factor_values(lobe, a[2], np.array(b[2]), a[2], r)) for a, b in ((i, s), (s, i)))
        assert there == pytest.approx(back, rel=1e-12)
        if min(i[2], s[2]) > diffraction.GRAZING:
            assert there == pytest.approx((1 - i[:2] @ s[:2]) / (i[2] * s[2]), rel=1e-9)


def test_in_glass() -> None:
    """In a medium the wavelength is shorter; β n is what the edge deflects, whatever lies behind it."""
    (air,) = EdgeDiffraction(0.05).lobes(550.0, 1.0, 1.0, True)
    (glass,) = EdgeDiffraction(0.05).lobes(550.0, 1.0, 1.5, True)
    r = np.array([1e-4, 1e-3, 0.1])
    np.testing.assert_allclose(glass.profile(r), 1.5**2 * air.profile(1.5 * r), rtol=1e-12)


def test_sides() -> None:
    assert EdgeDiffraction(0.05, side="back").lobes(550.0, 1.0, 1.0, True) == ()
    (lobe,) = EdgeDiffraction(0.05, side="back").lobes(550.0, 1.0, 1.0, False)
    assert (lobe.event, lobe.factor, lobe.shares) == ("transmission", "edge", (0, 1, 0))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"width_mm": 0.0}, "EdgeDiffraction 'rim': width_mm is 0; it must lie"),
        ({"width_mm": math.nan}, "width_mm is nan"),
        ({"width_mm": 1.0, "law": "fresnel"}, "law is 'fresnel'"),
        ({"width_mm": 1.0, "event": "both"}, "event is 'both'; an edge diffracts what passes it: transmission"),
    ],
)
def test_refused(arguments: dict, words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        EdgeDiffraction(**arguments, name="rim")


def test_too_narrow() -> None:
    with pytest.raises(MistrayError, match=r"width_mm is 0.01 mm at 550 nm"):
        EdgeDiffraction(0.01).lobes(550.0, 1.0, 1.0, True)

"""Scans in the plane of incidence, tables of models, and chances without aimed rays."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from command_line import fails, succeeds

from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.chance import Chance, chance
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.paint import Paint
from mistray.scatter.scan import IncidentLight, scan, table


def test_refused_scans() -> None:
    for model, more, words in (
        (ABg(0.0025, 0.001, 1.8), ([90.0],), "angle of incidence 90°"),
        (
            ABg(0.0025, 0.001, 1.8),
            ([60.0], "transmission", IncidentLight(1.5, 1.0)),
            "totally reflected, .* smaller",
        ),
        (Paint(0.2), ([0.0], "transmission"), "scatters nothing in transmission"),
    ):
        with pytest.raises(MistrayError, match=words):
            scan(model, *more)


@pytest.mark.parametrize("frame", ["specular", "normal"])
def test_a_table_holds_the_model(frame: str) -> None:
    """Also of refracted light, about its own specular direction."""
    samples = table(ABg(0.0025, 0.001, 1.8), [0, 40], frame)
    d = samples.directions()
    sine = np.sin(np.radians(samples.specular_deg))[:, None, None]
    expected = 0.0025 / (0.001 + np.hypot(d[..., 0] - sine, d[..., 1]) ** 1.8)
    above = d[..., 2] > 1e-9
    np.testing.assert_allclose(samples.values[above], expected[above], rtol=1e-9)
    assert np.all(samples.values[d[..., 2] < -1e-9] == 0)
    Tabulated(samples)
    refracted = table(ABg(0.0025, 0.001, 1.8), [0, 40], "specular", "transmission", IncidentLight(n_out=1.5))
    assert refracted.event == "transmission"
    assert np.sin(np.radians(refracted.specular_deg[1])) * 1.5 == pytest.approx(np.sin(np.radians(40)), rel=1e-12)


LENS = ABg(2e-5, 1e-6, 2.0)
COMMAND = ["bsdf", "abg", "--A", "2e-5", "--B", "1e-6", "--g", "2", "--event", "transmission", "--angles-deg", "0"]


def test_the_example_of_the_webinar(capsys: pytest.CaptureFixture[str]) -> None:
    """p2 = 2.7713e-10, p = 3.4641e-11: 3e10 rays are one hit in the mean, 50 % need 2.0e10."""
    found = chance(LENS, 30.0, 4e-6, event="transmission", before=0.125)
    assert found.rays_for_one_hit == pytest.approx(2.887e10, rel=1e-3)
    assert found.rays_for(0.5) == pytest.approx(2.001e10, rel=1e-3)
    assert -math.expm1(-found.total * found.rays_for_one_hit) == pytest.approx(0.632, abs=1e-3)
    where = ["--hit-deg", 30, "--hit-sr", 4e-6, "--hit-before", 0.125]
    out = succeeds(capsys, *COMMAND, *where)
    assert all(f"{number:.4e}" in out for number in (found.of_scatter, found.total))
    assert (f"{found.of_scatter:.4e}", f"{found.total:.4e}") == ("2.7713e-10", "3.4641e-11")
    for more, total in ((where, pytest.approx(found.total)), ([], None)):
        record = json.loads(succeeds(capsys, *COMMAND, *more, "--json"))["without_importance_sampling"]
        assert (record and record["total"]) == total
    for half in (where[:2], where[4:]):
        assert "hit" in fails(capsys, *COMMAND, *half)


def test_half_of_the_runs_hit() -> None:
    """Counted: 20 000 runs of as many rays as `rays_for` says. False alarm 1e-5 (4.4 standard errors)."""
    for confidence in (0.5, 0.9):
        rays = Chance(0.03, 0.5).rays_for(confidence)
        whole = math.ceil(rays)
        hit = np.random.default_rng(2).binomial(whole, 0.015, 20_000) > 0
        exact = 1 - (1 - 0.015) ** whole
        assert exact >= confidence > 1 - (1 - 0.015) ** (whole - 1)
        assert abs(hit.mean() - exact) < 4.4 * math.sqrt(exact * (1 - exact) / 20_000)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((90.0, 1e-6), "scattered direction is 90"),
        ((30.0, 0.0), "solid angle is 0"),
        ((30.0, math.nan), "solid angle is nan"),
        ((0.0, 1.0), "solid angle 1 sr: too large for one value"),
    ],
)
def test_refuses(arguments: tuple[float, float], message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        chance(LENS, *arguments)

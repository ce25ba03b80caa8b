"""A world without importance sampling: the numbers of the webinar on TracePro, and a count of rays."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.chance import Chance, chance

LENS = ABg(2e-5, 1e-6, 2.0)
COMMAND = ["bsdf", "abg", "--A", "2e-5", "--B", "1e-6", "--g", "2", "--event", "transmission", "--angles-deg", "0"]


def test_the_example_of_the_webinar() -> None:
    """p2 = 2.7713e-10, p = 3.4641e-11: 3e10 rays are one hit in the mean, 50 % need 2.0e10."""
    found = chance(LENS, 30.0, 4e-6, event="transmission", before=0.125)
    assert f"{found.of_scatter:.4e}" == "2.7713e-10"
    assert f"{found.total:.4e}" == "3.4641e-11"
    assert found.rays_for_one_hit == pytest.approx(2.887e10, rel=1e-3)
    assert found.rays_for(0.5) == pytest.approx(2.001e10, rel=1e-3)
    assert -math.expm1(-found.total * found.rays_for_one_hit) == pytest.approx(0.632, abs=1e-3)


def test_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--hit-deg", "30", "--hit-sr", "4e-6", "--hit-before", "0.125"]
    assert main([*COMMAND, *where]) == 0
    out = capsys.readouterr().out
    assert all(number in out for number in ("2.7713e-10", "3.4641e-11"))
    assert main([*COMMAND, *where, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)["without_importance_sampling"]
    assert record["total"] == pytest.approx(3.4641e-11, rel=1e-4)
    assert main([*COMMAND, "--hit-deg", "30"]) == 2
    assert main([*COMMAND, "--hit-before", "0.1"]) == 2
    capsys.readouterr()
    assert main([*COMMAND, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["without_importance_sampling"] is None


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

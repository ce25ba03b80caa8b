"""Lobes evaluated at directions, scans in the plane of incidence, tables of models, and chances without aimed rays."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.scatter import Lobe, RatioTable
from mistray.scatter.abg import ABg
from mistray.scatter.chance import Chance, chance
from mistray.scatter.evaluate import bsdf
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.paint import Paint
from mistray.scatter.scan import IncidentLight, scan, table


def unit(theta_deg: float, phi_deg: float) -> np.ndarray:
    theta, phi = np.radians([theta_deg, phi_deg])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def one(lobe: Lobe, event: str, angle_deg: float, direction: np.ndarray, share: float = 1.0) -> float:
    return float(bsdf([lobe], event, np.cos(np.radians(angle_deg)), direction[None], 1.0, 1.5, share)[0])


class TestLobes:
    """Each part of a lobe by its definition, at one pair of directions: 40° of incidence, 20° and 70° of azimuth."""

    there = unit(20, 70)

    def profile(self, r: np.ndarray) -> np.ndarray:
        return 1 / (0.1 + r)

    def distance(self, centre: float) -> float:
        return float(np.hypot(self.there[0] - centre, self.there[1]))

    @pytest.mark.parametrize("axes", ["radial", "cosines"])
    def test_ratio(self, axes: str) -> None:
        """A table that is linear in each of its variables is exact: cos θ0 + log(r/r_min)/log(2/r_min) + ψ/π."""
        a, b, c = np.meshgrid(np.linspace(0, 1, 3), np.linspace(0, 1, 5), np.linspace(0, 1, 4), indexing="ij")
        lobe = Lobe("reflection", self.profile, ratio=RatioTable(a + b + c, 0.01, axes=axes))
        x, y = self.there[0] - np.sin(np.radians(40)), self.there[1]
        expected = np.cos(np.radians(40)) + (
            np.log(np.hypot(x, y) / 0.01) / np.log(200) + np.arctan2(y, x) / np.pi
            if axes == "radial"
            else np.cos(np.radians(20)) + 70 / 180
        )
        plain = one(Lobe("reflection", self.profile), "reflection", 40, self.there)
        assert one(lobe, "reflection", 40, self.there) == pytest.approx(expected * plain, rel=1e-12)

    def test_total_reflection(self) -> None:
        direction, cosine = self.there[None], float(np.cos(np.radians(50)))
        for centre, expected in (("specular", 0.0), ("normal", 1 / (0.1 + self.distance(0)))):
            lobe = Lobe("transmission", self.profile, centre=centre)
            assert bsdf([lobe], "transmission", cosine, direction, 1.5, 1.0, 1.0)[0] == pytest.approx(expected)


class TestScan:
    def test_abg(self) -> None:
        scans = scan(ABg(0.0025, 0.001, 1.8), [0, 30, 75])
        for one_scan in scans:
            beta = np.sin(np.radians(one_scan.theta_s_deg))
            np.testing.assert_allclose(
                one_scan.distance, np.abs(beta - np.sin(np.radians(one_scan.incidence_deg))), atol=1e-12
            )
            np.testing.assert_allclose(one_scan.values, 0.0025 / (0.001 + one_scan.distance**1.8), rtol=1e-12)
            assert np.all(np.diff(one_scan.theta_s_deg) > 0)
            assert one_scan.distance.min() == 0
        # Of the float64 test vectors of the model
        assert [s.scattered for s in scans] == pytest.approx([0.0413437, 0.0393575, 0.0263319], rel=1e-4)

    def test_transmission_has_its_own_angle_and_step(self) -> None:
        (found,) = scan(HarveyShack(rms_nm=4), [30.0], "transmission", IncidentLight(n_out=1.5333))
        assert np.sin(np.radians(found.specular_deg)) * 1.5333 == pytest.approx(0.5, rel=1e-12)
        assert found.theta_s_deg[found.values.argmax()] == pytest.approx(found.specular_deg, abs=1e-6)
        (normal,) = scan(HarveyShack(rms_nm=4), [0.0], "transmission", IncidentLight(n_out=1.5333))
        assert normal.scattered == pytest.approx((2 * np.pi * 0.5333 * 4 / 550) ** 2, rel=1e-4)

    def test_refused(self) -> None:
        model = ABg(0.0025, 0.001, 1.8)
        with pytest.raises(MistrayError, match="angle of incidence 90°"):
            scan(model, [90.0])
        with pytest.raises(MistrayError, match="is totally reflected, nothing is transmitted; give smaller angles"):
            scan(model, [60.0], "transmission", IncidentLight(n_in=1.5, n_out=1.0))
        with pytest.raises(MistrayError, match="scatters nothing in transmission"):
            scan(Paint(0.2), [0.0], "transmission")


class TestTable:
    @pytest.mark.parametrize("frame", ["specular", "normal"])
    def test_holds_the_model(self, frame: str) -> None:
        samples = table(ABg(0.0025, 0.001, 1.8), [0, 40], frame)
        d = samples.directions()
        sine = np.sin(np.radians(samples.specular_deg))[:, None, None]
        expected = 0.0025 / (0.001 + np.hypot(d[..., 0] - sine, d[..., 1]) ** 1.8)
        above = d[..., 2] > 1e-9
        np.testing.assert_allclose(samples.values[above], expected[above], rtol=1e-9)
        assert np.all(samples.values[d[..., 2] < -1e-9] == 0)
        Tabulated(samples)

    def test_refracted(self) -> None:
        samples = table(ABg(0.0025, 0.001, 1.8), [0, 40], "specular", "transmission", IncidentLight(n_out=1.5))
        assert samples.event == "transmission"
        assert np.sin(np.radians(samples.specular_deg[1])) * 1.5 == pytest.approx(np.sin(np.radians(40)), rel=1e-12)


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

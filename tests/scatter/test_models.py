"""Scatter models: what they refuse and scatter, scans, tables, and chances without aimed rays."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from command_line import fails, succeeds

from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.chance import Chance, chance
from mistray.scatter.edge_diffraction import EdgeDiffraction
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.harvey_shack import HarveyShack, index_step
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.scatter.phong import Phong
from mistray.scatter.polynomial import Polynomial
from mistray.scatter.scan import IncidentLight, scan, table

pytestmark = pytest.mark.quick

ABG = {"A": 1.0, "B": 1e-3, "g": 2.0}
ROUGH = {"rms_nm": 1.0, "B_um": 20.0, "slope": 3.0}
VECTOR = {"theory": "rayleigh_rice_vector"}
REFUSED: list[tuple[type, dict[str, Any], str]] = [
    (ABg, ABG | {"B": 0.0}, "B is 0; give B > 1e-12, or B ≥ 0 with g = 0"),
    (HarveyShack, {}, "neither of b0 and rms_nm"),
    (HarveyShack, {"b0": 1.0, "rms_nm": 4.0}, "both of b0 and rms_nm"),
    (KCorrelation, ROUGH | {"slope": 2.0}, "slope is 2, .*band_limited"),
    (KCorrelation, ROUGH | {"theory": "beckmann"}, "theory is 'beckmann'"),
    (KCorrelation, ROUGH | {"theory": "ghs_full", "slope": 2.5}, "ghs_full needs slope 3"),
    (KCorrelation, ROUGH | {"theory": "ghs_full", "band_limited": True}, "slope 3 and a total roughness"),
    (KCorrelation, ROUGH | {"theory": "rayleigh_rice"}, "rayleigh_rice is about reflection"),
    (KCorrelation, ROUGH | {"reference_nm": 550.0}, "reference_nm goes with band_limited"),
    (KCorrelation, ROUGH | {"substrate": 1.5 + 0j}, "substrate goes with theory rayleigh_rice_vector"),
    (KCorrelation, ROUGH | VECTOR | {"substrate": -1 + 2j}, "substrate is -1"),
    (Paint, {}, "nothing is scattered"),
    (Paint, {"reflectance": 0.99, "b0": 1.0}, "of the light at 0°; lower reflectance or b0"),
    (Paint, {"reflectance": 0.9, "b0": 1.0, "l": 0.1, "s": -3.0, "n": 1.5}, r"scatters 1\.\d+ of the light at \d+.*°"),
    (Particulate, {}, "neither of level and coverage_percent"),
    (Particulate, {"level": 300.0, "coverage_percent": 0.1}, "both of level and coverage_percent"),
    (Particulate, {"level": 300.0, "max_um": 400.0}, "max_um ≤ level"),
    (Particulate, {"level": 300.0, "relative_to": "incident"}, "relative_to is 'incident'"),
    (Phong, {"b0": 0.1, "exponent": 0.5}, "exponent is 0.5"),
    (Polynomial, {"coefficients": (("c00", -1.0),)}, "'c00' is no coefficient"),
    (Polynomial, {"coefficients": (("c100", -1.0),)}, "give each once, and c000"),
    (Polynomial, {"coefficients": (("c000", -1.0), ("c000", -2.0))}, "c000, c000; give each once"),
    (Polynomial, {"coefficients": ()}, "coefficients none"),
    (Polynomial, {"coefficients": (("c000", 400.0),)}, "its BSDF runs from .* the coefficients are too large"),
    (EdgeDiffraction, {"width_mm": 1.0, "law": "fresnel"}, "law is 'fresnel'"),
    (EdgeDiffraction, {"width_mm": 1.0, "event": "both"}, "event is 'both'.*transmission"),
]


@pytest.mark.parametrize(("model", "options", "words"), REFUSED)
def test_wrong_values(model: type, options: dict[str, Any], words: str) -> None:
    with pytest.raises(MistrayError, match=words) as caught:
        model(**options, name="lens")
    assert str(caught.value).startswith((f"{model.__name__} 'lens': ", "particles: "))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("model", "indices", "words"),
    [
        (HarveyShack(rms_nm=15.0), (1.0, 1.5), r"rms roughness 15 nm is not smooth .*0\.343, limit 0\.251"),
        (HarveyShack(rms_nm=8.0), (1.5, 1.0), "not smooth in reflection"),
        (KCorrelation(20.0, 20.0, 3.0), (1.0, 1.5), "not smooth in reflection at 550 nm"),
        (KCorrelation(100.0, 20.0, 3.0, theory="ghs_full"), (1.0, 1.5), r"100 nm is too much .* limit 2\)"),
        (KCorrelation(**ROUGH, **VECTOR), (1.0, 1.0), "indices are 1 on both sides"),
        (EdgeDiffraction(0.01), (1.0, 1.0), "width_mm is 0.01 mm at 550 nm"),
    ],
)
def test_light_that_a_model_does_not_describe(model: Any, indices: tuple[float, float], words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        model.lobes(550.0, *indices, True)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (ABg(1e-4, 1e-8, 2.5), None),
        (ABg(1e-4, float(np.float32(1e-6)), 2), None),
        (ABg(0.3, 7, 0), None),
        (ABg(1e-4, 1e-3, 1.8, name="lens"), "ABg 'lens': B 0.001 and g 1.8"),
        (ABg(1e-4, 1e-8, 1), "B 1e-08 and g 1"),
        (ABg(1.0, 1e-8, 2.0), "TIS is 57.9"),  # π ln(1 + 1/B)
        (Gaussian(0.1, 0.5), None),
        (Gaussian(0.95, 0.5), "TIS is 0.95"),
        (Gaussian(0.1, 2.0), "width 2"),
        (HarveyShack(1.0, l=float(np.float32(0.01))), None),
        (HarveyShack(100.0), "TIS is"),
        (HarveyShack(1.0, l=0.5), "l 0.5 and s -1.5"),
        (HarveyShack(1.0, s=-5.0), "s -5"),
        (KCorrelation(**ROUGH), None),
        (KCorrelation(1.0, 20.0, 4.5), "slope 4.5"),
        (Phong(0.1, 16.0), None),
        (Phong(3.0, 16.0), "TIS is 1.05"),  # 6π/18
    ],
)
def test_advice(model: Any, words: str | None) -> None:
    assert words in str(model.advice()) if words else model.advice() is None


BOTH, REFLECTED, TRANSMITTED = ["reflection", "transmission"], ["reflection"], ["transmission"]


@pytest.mark.parametrize(
    ("model", "indices", "from_front", "events"),
    [
        (ABg(**ABG), (1.0, 1.5), False, BOTH),
        (ABg(**ABG, event="transmission"), (1.0, 1.5), True, TRANSMITTED),
        (ABg(**ABG, side="back"), (1.0, 1.5), True, []),
        (ABg(**ABG, side="back"), (1.0, 1.5), False, BOTH),
        (HarveyShack(0.0), (1.0, 1.5), True, []),
        (HarveyShack(rms_nm=2.0), (1.5, 1.5), True, REFLECTED),  # no step of index
        (HarveyShack(rms_nm=15.0, event="transmission"), (1.0, 1.5), True, TRANSMITTED),  # too rough to reflect
        (KCorrelation(1.0, 20.0, 3.0), (1.5, 1.5), True, REFLECTED),
        (KCorrelation(20.0, 20.0, 3.0, event="transmission"), (1.0, 1.5), True, TRANSMITTED),
        (KCorrelation(20.0, 0.3, 2.2), (1.0, 1.5), True, BOTH),  # most of its frequencies do not scatter
        (KCorrelation(40.0, 12.0, 3.0, theory="ghs_full"), (1.0, 1.5), True, BOTH),
        (KCorrelation(**ROUGH, **VECTOR, substrate=1 + 7j), (1.0, 1.0), True, REFLECTED),
        (Paint(0.1), (1.0, 1.5), True, REFLECTED),
        (EdgeDiffraction(0.05, side="back"), (1.0, 1.0), False, TRANSMITTED),
        (Particulate(level=300.0, immersion=1.5, particle="1.6"), (1.5, 1.0), True, [*TRANSMITTED, *2 * REFLECTED]),
        (Particulate(level=300.0), (1.5, 1.0), True, TRANSMITTED),  # light in the glass does not meet them
    ],
)
def test_what_scatters(model: Any, indices: tuple[float, float], from_front: bool, events: list[str]) -> None:
    assert [lobe.event for lobe in model.lobes(550.0, *indices, from_front)] == events


def test_shares_and_steps() -> None:
    """Relative to the specular beam or to all light; the step of index that light meets."""
    for model, shares in (
        (ABg(**ABG), (0, 1, 0)),
        (ABg(**ABG, relative_to="incident"), (1, 0, 0)),
        (Paint(0.1), (1, 0, 0)),
        (Paint.preset("flat_black", relative_to="specular"), (0, 1, 0)),
    ):
        assert model.lobes(550.0, 1.0, 1.5, True)[0].shares == shares
    assert index_step("transmission", 1.0, 1.5) == index_step("transmission", 1.5, 1.0) == 0.5
    assert index_step("reflection", 1.5, 1.0) == 3.0
    with pytest.raises(MistrayError, match="'flat_blak' is unknown"):
        Paint.preset("flat_blak")


def test_refused_scans() -> None:
    model, dense = ABg(0.0025, 0.001, 1.8), IncidentLight(n_in=1.5, n_out=1.0)
    for arguments, words in (
        ((model, [90.0]), "angle of incidence 90°"),
        ((model, [60.0], "transmission", dense), "is totally reflected, nothing is transmitted; give smaller angles"),
        ((Paint(0.2), [0.0], "transmission"), "scatters nothing in transmission"),
    ):
        with pytest.raises(MistrayError, match=words):
            scan(*arguments)


@pytest.mark.parametrize("frame", ["specular", "normal"])
def test_a_table_holds_the_model(frame: str) -> None:
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

"""Intensities by direction from files: flux, directions, aim and orientation, beside closed forms."""

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, TUBE, lit, meter, towards_origin
from oracles.statistics import assert_z
from scipy.stats import chi2

import mistray
from mistray.files.intensities import Intensities, read_intensities
from mistray.sampling.emission_laws import IntensityTable
from mistray.spectra.spectrum import light_of

pytestmark = pytest.mark.quick

# A small round detector off the axis
ASIDE = towards_origin(float(np.degrees(np.arcsin(0.6))), 50.0)
DETECTOR = {"type": "asphere", "semi_diameter": 2.0, "to_world": ASIDE, "bsdf": BLACK, "sensor": meter()}


def lm63(theta: Any, phi: Any, candela: Any, first: str = "", multiplier: float = 1.0, second: float = 1.0) -> str:
    """An IES file of type C, candela (p, t), as the standard lays it out; lines are broken anywhere."""
    words = [f"{value:g}" for value in (*theta, *phi, *candela.ravel())]
    lines = [" ".join(words[k : k + 11]) for k in range(0, len(words), 11)]
    head = [first or "IESNA:LM-63-2002", "[TEST] made up: 30\xb0", "[MANUFAC] none", "[MORE] TILT is none"]
    size = f"1 -1 {multiplier:g} {len(theta)} {len(phi)} 1 2 0.1 0.1 0"
    return "\r\n".join([*head, "TILT=NONE", size, f"1 {second:g} 12.5", *lines, ""])


def rough(phis: int = 13) -> Intensities:
    """An intensity without any symmetry, 20 to 140° from the axis, with a dark corner."""
    values = np.random.default_rng(3).uniform(0.1, 1.0, (9, phis))
    values[:3, 2:5] = 0.0
    values[:, -1] = values[:, 0]
    return Intensities(np.linspace(20, 140, 9), np.linspace(0, 360, phis), values)


def table_of(found: Intensities) -> IntensityTable:
    mistray.ensure_variant()
    return IntensityTable(found.theta_deg, found.phi_deg, found.values)


def exact_intensity(found: Intensities, d: np.ndarray) -> np.ndarray:
    """Linear in both angles: (n,) for directions (n, 3); an oracle of its own."""
    theta = np.degrees(np.arccos(np.clip(d[:, 2], -1, 1)))
    phi = np.degrees(np.arctan2(d[:, 1], d[:, 0])) % 360
    t, p = found.theta_deg, found.phi_deg
    k = np.clip(np.searchsorted(t, theta, side="right") - 1, 0, len(t) - 2)
    j = np.clip(np.searchsorted(p, phi, side="right") - 1, 0, len(p) - 2)
    x, y = (theta - t[k]) / (t[k + 1] - t[k]), (phi - p[j]) / (p[j + 1] - p[j])
    v = found.values
    low, high = (1 - y) * v[k, j] + y * v[k, j + 1], (1 - y) * v[k + 1, j] + y * v[k + 1, j + 1]
    return np.where((theta >= t[0]) & (theta <= t[-1]), (1 - x) * low + x * high, 0.0)


def test_flux() -> None:
    """Of a constant intensity 4π, of cos θ and cos θ (1 + a cos φ) π, of a rough table a float64 sum."""
    theta, phi = np.linspace(0, 180, 181), np.linspace(0, 360, 73)
    lambert = np.maximum(np.cos(np.radians(theta)), 0.0)
    one = np.ones((181, 73))
    assert table_of(Intensities(theta, phi, one)).flux == pytest.approx(4 * np.pi, rel=1e-6)
    assert table_of(Intensities(theta, phi, lambert[:, None] * one)).flux == pytest.approx(np.pi, rel=1e-4)
    lobed = lambert[:, None] * (1 + 0.5 * np.cos(np.radians(phi)))
    assert table_of(Intensities(theta, phi, lobed)).flux == pytest.approx(np.pi, rel=1e-4)
    fine, nodes = rough(), np.radians(np.linspace(20, 140, 200_001))
    mean = 0.5 * (fine.values[:, 1:] + fine.values[:, :-1]).mean(axis=1)
    whole = 2 * np.pi * np.trapezoid(np.interp(np.degrees(nodes), fine.theta_deg, mean) * np.sin(nodes), nodes)
    assert table_of(fine).flux == pytest.approx(whole, rel=1e-6)


@pytest.mark.parametrize("wrong", [False, True])
def test_directions_follow_the_intensity(wrong: bool) -> None:
    """χ² of 24 × 24 cells of equal solid angle, against sums of the intensity; false alarm 1e-4. A wrong one fails."""
    found, n, side = rough(), 300_000, 24
    table = table_of(found)
    rng = mi.PCG32(size=n, initstate=7)
    d = table.directions(mi.Point2d(mi.Float64(rng.next_float32()), mi.Float64(rng.next_float32())))
    density = np.array(table.density(d))
    d = np.array(d).T
    cell = (np.clip((d[:, 2] + 1) / 2 * side, 0, side - 1)).astype(int) * side
    cell += np.clip(np.arctan2(d[:, 1], d[:, 0]) % (2 * np.pi) / (2 * np.pi) * side, 0, side - 1).astype(int)
    fine = 24
    z = (np.arange(side * fine) + 0.5) / (side * fine) * 2 - 1
    phi = (np.arange(side * fine) + 0.5) / (side * fine) * 2 * np.pi
    across = np.sqrt(1 - z * z)
    grid = np.stack([np.outer(across, np.cos(phi)), np.outer(across, np.sin(phi)), np.outer(z, np.ones_like(phi))], -1)
    value = exact_intensity(found, grid.reshape(-1, 3)) ** (1.1 if wrong else 1.0)
    share = value.reshape(side, fine, side, fine).sum(axis=(1, 3)).ravel()
    expected = n * share / share.sum()
    count = np.bincount(cell, minlength=side * side)
    used = expected > 10
    assert count[expected == 0].sum() <= 1e-6 * n
    statistic = float(np.sum((count[used] - expected[used]) ** 2 / expected[used]))
    assert (statistic > chi2.isf(1e-4, used.sum() - 1)) == wrong
    assert density == pytest.approx(exact_intensity(found, d) / table.flux, rel=2e-3, abs=1e-4)


def test_ies(tmp_path: Path) -> None:
    """Symmetric files and the whole circle say the same; azimuths go from x towards -y as seen along the axis."""
    theta = np.linspace(0, 90, 19)
    fall = np.cos(np.radians(theta))
    phi = np.linspace(0, 360, 25)
    for kind, shape, last in (
        ("quarter", 1 + 0.5 * np.cos(np.radians(2 * phi)), 90),
        ("half", 1 + 0.5 * np.cos(np.radians(phi)), 180),
        ("whole", 1 + 0.5 * np.sin(np.radians(phi)), 360),
        ("open", 1 + 0.5 * np.sin(np.radians(phi)), 345),
        ("any", np.ones(25), 0),
    ):
        keep = phi <= last
        file = tmp_path / f"{kind} one.ies"
        file.write_bytes(lm63(theta, phi[keep], 100 * np.outer(shape[keep], fall), multiplier=2.0).encode("latin-1"))
        found = read_intensities(file)
        assert (found.unit, (found.phi_deg[0], found.phi_deg[-1])) == ("cd", (0, 360))
        for azimuth, value in zip(phi, shape, strict=True):
            column = [np.interp(-azimuth % 360, found.phi_deg, row) for row in found.values]
            assert column == pytest.approx(200 * value * fall, rel=1e-4), (kind, azimuth)
    side = np.linspace(90, 270, 13)
    lobe = 1 + 0.5 * np.sin(np.radians(side))
    (tmp_path / "side.ies").write_text(lm63(theta, side, np.outer(lobe, fall)), encoding="latin-1")
    found = read_intensities(tmp_path / "side.ies")
    assert np.interp(360 - 30.0, found.phi_deg, found.values[0]) == pytest.approx(1.25, rel=1e-5)
    assert np.interp(270.0, found.phi_deg, found.values[0]) == pytest.approx(1.5, rel=1e-5)
    # Uneven steps: at 0° as at 180°, on the line from 0 at 90° to 11 at 200°
    side = np.array([90.0, 200.0, 270.0])
    (tmp_path / "side.ies").write_text(lm63(theta, side, np.outer([0, 11, 11], fall + 1)), encoding="latin-1")
    found = read_intensities(tmp_path / "side.ies")
    assert found.values[:, 0] == pytest.approx(9 * (fall + 1), rel=1e-5)


@pytest.mark.parametrize(
    ("first", "factor"),
    [("IESNA:LM-63-1995", 0.9), ("IESNA:LM-63-2002", 1.0), ("IES:LM-63-2019", 1.0), ("Lamp of 1986", 0.9)],
)
def test_factors_of_ies(first: str, factor: float, tmp_path: Path) -> None:
    """The second number of the ballast's line was a factor until 1995; now it says how the file was made."""
    text = lm63(np.array([0, 90]), np.array([0]), np.ones((1, 2)), first, 3.0, 0.9)
    (tmp_path / "a.ies").write_text(text, encoding="latin-1")
    assert read_intensities(tmp_path / "a.ies").values == pytest.approx(3.0 * factor)


def on_detector(found: Intensities) -> float:
    """∫ I dΩ over that detector from the origin."""
    x, w = np.polynomial.legendre.leggauss(80)
    rho, phi = 1.0 + x, (np.arange(160) + 0.5) / 160 * 2 * np.pi
    n, u, v = np.array([0.6, 0, 0.8]), np.array([0.8, 0, -0.6]), np.array([0, 1.0, 0])
    p = 50 * n + rho[:, None, None] * (np.cos(phi)[:, None] * u + np.sin(phi)[:, None] * v)
    r = np.linalg.norm(p, axis=-1)
    area = (w * rho)[:, None] * 2 * np.pi / 160
    d = (p / r[..., None]).reshape(-1, 3)
    return float(np.sum(exact_intensity(found, d).reshape(r.shape) * (p @ n) / r**3 * area))


def csv_of(found: Intensities, name: str) -> str:
    table = zip(found.theta_deg.tolist(), found.values.tolist(), strict=True)
    rows = [f"{t!r},{p!r},{v!r}" for t, row in table for p, v in zip(found.phi_deg.tolist(), row, strict=True)]
    return "\n".join(["# made up", f"theta_deg, phi_deg, {name}", *rows])


def test_aim(tmp_path: Path) -> None:
    """Aimed rays of a rough intensity give ∫ I dΩ on a small detector; 20 seeds, false alarm 1e-3; gain as promised."""
    found = rough()
    file = tmp_path / "a lamp.csv"
    file.write_text(csv_of(found, "intensity_W_sr"))
    here = lit({"type": "point_source", "filename": str(file)}, detector=DETECTOR, tube=TUBE)
    exact = on_detector(found)
    energies = [mistray.trace(here, rays=8000, seed=seed, ledger=False).energy for seed in range(20)]
    assert energies[0].launched_W == pytest.approx(table_of(found).flux, rel=1e-6)
    z = [(energy.detected_W - exact) / energy.detected_se_W for energy in energies]
    assert_z("mean", float(np.mean(z)), 0.0, 1 / np.sqrt(20), false_alarm=5e-4)
    share = exact / energies[0].launched_W
    relative = np.mean([energy.detected_se_W for energy in energies]) / exact
    assert (1 - share) / share / 8000 / relative**2 > 0.5 / share * (1 - share) * (1 - 3 * np.sqrt(2 / 31 / 20))
    assert all(abs(energy.closure) < 1e-6 for energy in energies)


def test_a_surface_with_an_intensity_of_a_file(tmp_path: Path) -> None:
    """A Lambertian file makes a disc Lambertian: radiance × area × the file's solid angle; false alarm 1e-3 of two."""
    theta = np.linspace(0, 90, 361)
    found = Intensities(theta, np.array([0.0, 360.0]), np.repeat(np.cos(np.radians(theta))[:, None], 2, axis=1))
    file = tmp_path / "lambert.csv"
    file.write_text(csv_of(found, "intensity"))
    lamp = {"type": "surface_source", "radius": 3.0, "radiance": 2.0}
    same = mistray.trace(lit(lamp, detector=DETECTOR), rays=20_000).energy
    for law in ({"filename": str(file)}, {"profile": ", ".join(f"{t}:{np.cos(np.radians(t))}" for t in theta)}):
        energy = mistray.trace(lit({**lamp, **law}, detector=DETECTOR), rays=20_000, ledger=False).energy
        assert energy.launched_W == pytest.approx(2 * np.pi**2 * 9, rel=1e-5)
        error = float(np.hypot(energy.detected_se_W, same.detected_se_W))
        assert_z("flux", energy.detected_W, same.detected_W, error, false_alarm=5e-4)


def test_candela_to_watt(tmp_path: Path) -> None:
    """100 cd all around are 400π lm, and of D65 as many W as its luminous efficacy says; of infrared light none."""
    file = tmp_path / "ball.ies"
    file.write_text(lm63(np.linspace(0, 180, 5), np.array([0]), np.full((1, 5), 100.0)), encoding="latin-1")
    lamp = {"type": "point_source", "filename": str(file)}
    for spectrum, efficacy in (
        ({"spectrum": "d65"}, light_of("d65").lumens_per_watt),
        ({"wavelength_nm": 555.0}, 683.0),
        ({}, 683 * 0.99495),  # V of 550 nm
    ):
        assert mi.load_dict({**lamp, **spectrum}).power() == pytest.approx(400 * np.pi / efficacy, rel=1e-3)
    assert mi.load_dict({**lamp, "power": 2.0, "wavelength_nm": 900.0}).power() == 2.0

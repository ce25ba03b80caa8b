"""Edge diffraction against float64 test vectors, the Airy pattern, and Sommerfeld's solution of the half plane."""

import math
from itertools import pairwise

import drjit as dr
import numpy as np
import pytest
import vectors
from drjit_derivatives import forward_derivatives
from oracles.derivatives import central_differences
from refusals import each_refused
from scipy.integrate import quad
from scipy.special import fresnel, j1

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics import diffraction

LAMBDA = 0.55e-3  # mm


def test_keller_vectors() -> None:
    table = vectors.frame("diffraction_keller.csv")
    theta = np.radians(table["theta_deg"].to_numpy())
    for name, sign in (("shadow", 1), ("lit", -1)):
        soft, hard = diffraction.keller(sign * theta, 1.0)
        np.testing.assert_allclose(soft, table[f"{name}_soft/lam"], rtol=1e-10)
        np.testing.assert_allclose(hard, table[f"{name}_hard/lam"], rtol=1e-10)
        np.testing.assert_allclose(0.5 * (soft + hard), table["1/(4pi^2 sin^2)"], rtol=1e-10)
    np.testing.assert_allclose(diffraction.half_plane(theta, 1.0), table["1/(4pi^2 th^2)"], rtol=1e-12)


def sommerfeld(theta: np.ndarray, distance: float, soft: bool) -> np.ndarray:
    """|u|² · distance of the diffracted part behind a half plane, u = U(φ-φ') ∓ U(φ+φ'), Born and Wolf, 11.5."""
    k = 2 * math.pi / LAMBDA

    def part(angle: np.ndarray) -> np.ndarray:
        # F(v) = ∫_v^∞ exp(iμ²) dμ by Fresnel integrals; the diffracted part is F(|v|) with the sign of -v
        v = math.sqrt(2 * k * distance) * np.cos(0.5 * angle)
        s, c = fresnel(np.abs(v) * math.sqrt(2 / math.pi))
        tail = math.sqrt(math.pi / 2) * ((0.5 - c) + 1j * (0.5 - s))
        wave = np.exp(-1j * k * distance * np.cos(angle))
        return -np.sign(v) * np.exp(-0.25j * math.pi) / math.sqrt(math.pi) * wave * tail

    phi, phi_i = 1.5 * math.pi + theta, 0.5 * math.pi
    field = part(phi - phi_i) + (-1 if soft else 1) * part(phi + phi_i)
    return np.abs(field) ** 2 * distance


def test_half_plane_by_keller_sommerfeld_and_fresnel() -> None:
    """The exact field 2000 wavelengths behind the edge, on both sides of the beam."""
    theta = np.radians([-80.0, -45, -20, -10, 10, 20, 45, 80])
    for found, soft in zip(diffraction.keller(theta, LAMBDA), (True, False), strict=True):
        np.testing.assert_allclose(found, sommerfeld(theta, 2000 * LAMBDA, soft), rtol=0.01)
    # Deep in the shadow the irradiance by Fresnel's integrals is the flux of the edge over the screen
    theta, distance = np.array([0.01, 0.03]), 1000.0
    s, c = fresnel(theta * distance * math.sqrt(2 / (LAMBDA * distance)))
    irradiance = 0.5 * ((0.5 - c) ** 2 + (0.5 - s) ** 2)
    assert diffraction.half_plane(theta, LAMBDA) / distance == pytest.approx(irradiance, rel=1e-4)


def test_unpolarised_keller_at_any_incidence() -> None:
    """The closed form in direction cosines against Keller's coefficients in his own angles, and reciprocity."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        sine = math.sqrt(1 - rng.uniform(-0.9, 0.9) ** 2)  # the parts along the edge are the same
        across_i, across_s = sine * np.cos(rng.uniform(0.05, math.pi - 0.05, 2))
        if abs(across_s - across_i) < 0.02:
            continue
        cos_i, cos_s = (math.sqrt(sine**2 - b * b) for b in (across_i, across_s))
        # Keller: light comes from φ', goes to φ; with the propagation along -φ' its part across is -sin γ cos φ'
        phi_i, phi = math.acos(-across_i / sine), 2 * math.pi - math.acos(across_s / sine)
        d = [1 / math.cos(0.5 * (phi - phi_i)) + sign / math.cos(0.5 * (phi + phi_i)) for sign in (-1, 1)]
        # |D|² of both polarisations; flux by edge length and azimuth is |D|² sin² γ, D has 1/sin γ
        by_azimuth = 0.5 * sum(v * v for v in d) * LAMBDA / (16 * math.pi**2)
        by_cosine = by_azimuth / cos_s  # dβ = sin γ |sin φ| dψ = cos θs dψ
        by_strip = by_cosine / cos_i  # irradiance across the ray by that on the aperture
        if min(cos_i, cos_s) < diffraction.GRAZING:
            continue
        r2 = (across_s - across_i) ** 2
        found = LAMBDA / (4 * math.pi**2) * diffraction.obliquity(cos_i, cos_s, r2) / r2
        assert found == pytest.approx(by_strip, rel=1e-9)
        assert diffraction.obliquity(cos_s, cos_i, r2) == diffraction.obliquity(cos_i, cos_s, r2)


def test_circular_aperture_and_heisenberg_vectors() -> None:
    """Vectors, and the mean of the Airy pattern over 40 rings, I = J1²(ka sin θ)/(π sin² θ)."""
    for row in vectors.frame("diffraction_circular.csv").itertuples():
        found = diffraction.circular_aperture(row.theta_rad, row.lambda_mm, row.radius_mm)
        assert found == pytest.approx(row[5], rel=1e-11)
        assert found / math.cos(row.theta_rad) == pytest.approx(row[7], rel=1e-11)
        assert found == pytest.approx(row.I_avg_Airy_per_W_sr, rel=0.011)  # limited by the window of the mean
    k = 2 * math.pi / LAMBDA
    for radius, theta in ((5.0, 0.003), (5.0, 0.02), (0.5, 0.02)):
        x = np.linspace(k * radius * theta - 20 * math.pi, k * radius * theta + 20 * math.pi, 40 * 64 + 1)
        # I sin³θ does not fall on average
        pattern = j1(x) ** 2 / (math.pi * (x / (k * radius)) ** 2)
        expected = np.mean((pattern * (x / (k * radius)) ** 3)[:-1]) / theta**3
        assert diffraction.circular_aperture(theta, LAMBDA, radius) == pytest.approx(expected, rel=1e-3)
    # A strip of any width diffracts, far out, by length of the edge: width · density
    table = vectors.frame("diffraction_hup.csv")
    column = table.columns[2]
    for row in table.to_dict("records"):
        law = "heisenberg" if "HUP" in row["model"] else "half_plane"
        for width in (1.0, 3.0):
            found = width * diffraction.deflection_density(row["theta_rad"], width, LAMBDA, law)
            assert found == pytest.approx(row[column], rel=1e-10)
        assert found / diffraction.half_plane(row["theta_rad"], LAMBDA) == pytest.approx(row["ratio"], rel=1e-10)
    assert diffraction.spread("heisenberg") / diffraction.spread() == pytest.approx(math.sqrt(math.pi / 2), rel=1e-14)
    each_refused((1.0, LAMBDA, "fresnel", "law of edge diffraction is 'fresnel'"), by=diffraction.deflection_sigma)


def total(density) -> float:
    """∫ over ten decades and more, by quadrature decade by decade."""
    return sum(quad(density, low, 10 * low, epsrel=1e-10)[0] for low in 10.0 ** np.arange(-9, 6))


@pytest.mark.parametrize("law", list(diffraction.SPREADS))
def test_density_is_the_mean_of_gaussians(law: str) -> None:
    width = 0.1
    for delta in (0.0, 1e-5, 1e-4, 1e-3, 1e-2):

        def gaussian(x: float, delta: float = delta) -> float:
            sigma = float(diffraction.deflection_sigma(x, LAMBDA, law))
            return math.exp(-0.5 * (delta / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)

        expected = quad(gaussian, 0, width, points=[width * 0.01, width * 0.1], epsrel=1e-11)[0] / width
        assert diffraction.deflection_density(delta, width, LAMBDA, law) == pytest.approx(expected, rel=1e-9)
    assert 2 * total(lambda d: diffraction.deflection_density(d, width, LAMBDA, law)) == pytest.approx(1, abs=1e-5)


def test_samples_and_rings_in_drjit() -> None:
    """χ² of 2e5 samples in 40 cells; false-alarm probability 1e-3. A density of 5 % less width fails."""
    rng = np.random.default_rng(3)
    count, width = 200_000, 0.1
    drawn = np.abs(diffraction.sampled_deflection(1 - rng.random(count), rng.standard_normal(count), width, LAMBDA))
    edges = np.concatenate([[0.0], np.geomspace(1e-5, 0.1, 40)])
    counted = np.histogram(drawn, edges)[0]

    def chi2(w: float) -> float:
        def density(d: float) -> float:
            return 2 * count * float(diffraction.deflection_density(d, w, LAMBDA))

        expected = np.array([quad(density, low, high, epsrel=1e-10)[0] for low, high in pairwise(edges)])
        return float(np.sum((counted - expected) ** 2 / expected))

    limit = 73.4  # χ² of 40 degrees of freedom, 1e-3
    assert chi2(width) < limit
    assert chi2(0.95 * width) > 3 * limit
    # Ring of any width: flux times BSDF is the far field of the whole aperture; over all directions it is 1
    radius = 5.0
    for width in (0.01, 0.1):
        r = np.array([0.05, 0.2, 0.7])
        bsdf = diffraction.ring_bsdf(r, width, LAMBDA) * diffraction.obliquity(1.0, np.sqrt(1 - r * r), r * r)
        intensity = 2 * width / radius * bsdf * np.sqrt(1 - r * r)
        np.testing.assert_allclose(intensity, diffraction.circular_aperture(np.arcsin(r), LAMBDA, radius), rtol=1e-12)
        whole = total(lambda r, w=width: 2 * np.pi * r * diffraction.ring_bsdf(r, w, LAMBDA))
        assert whole == pytest.approx(1, abs=1e-5)
    r = np.array([1e-7, 1e-4, 1e-2, 1.0])

    def ring(width: float) -> np.ndarray:
        return diffraction.ring_bsdf(dr.llvm.ad.Float64(r) if dr.is_array_v(width) else r, width, LAMBDA)

    np.testing.assert_allclose(np.array(ring(dr.llvm.ad.Float64(0.1))), ring(0.1), rtol=1e-12)
    slope = central_differences(ring, [0.1], [1e-6])
    np.testing.assert_allclose(forward_derivatives(ring, [0.1]), slope, rtol=1e-6)

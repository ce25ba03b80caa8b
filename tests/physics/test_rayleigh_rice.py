"""Vector perturbation theory against SCATMECH 7 (NIST), stored of pySCATMECH 0.1.10 and live, and against Fresnel."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import k_correlation as kc
from mistray.physics import rayleigh_rice as rr
from mistray.physics.fresnel import reflectance

VECTORS = 1e-6  # relative, as required
LENGTH_UM = 2 * math.pi  # of the roughness spectrum of the stored values: σ = 1 nm, lc = 1 µm
AMPLITUDE_UM4 = 2 * math.pi * 1e-6


def test_stored_values() -> None:
    for row in vectors.frame("rr_scatmech.csv").itertuples(index=False):
        ci, cs, cphi = (math.cos(math.radians(angle)) for angle in (row.theta_i, row.theta_s, row.phi_s))
        q = rr.polarization_factor(ci, cs, cphi, complex(row.n, row.k))
        assert q == pytest.approx(row.Q_scatmech, rel=VECTORS)
        psd = kc.psd_um4(row.f_1_um, AMPLITUDE_UM4, LENGTH_UM, 3.0)
        assert psd == pytest.approx(row.PSD_um4, rel=VECTORS)
        assert rr.brdf(ci, cs, q, psd, 0.6328) == pytest.approx(row.BRDF_SCATMECH_unpol, rel=VECTORS)


@pytest.mark.validation
@pytest.mark.parametrize("kind", ["reflection", "transmission"])
def test_live(kind: str) -> None:
    """Random substrates and directions; the roughness spectrum of SCATMECH is the same formula."""
    model = pytest.importorskip("pySCATMECH.brdf").BRDF_Model
    rng = np.random.default_rng(4)
    psd = {None: "ABC_PSD_Function", "A": AMPLITUDE_UM4, "B": LENGTH_UM, "C": 3}
    for _ in range(6):
        metal = kind == "reflection" and rng.random() < 0.5
        index = complex(rng.uniform(0.2, 4), rng.uniform(0, 8)) if metal else rng.uniform(0.5, 4)
        text = f"({index.real!r},{index.imag!r})" if metal else repr(index)
        side = {"reflection": 0, "transmission": 1}[kind]
        theirs = model("Microroughness_BRDF_Model", {"lambda": 0.6328, "substrate": text, "type": side, "psd": psd})
        for theta_i, theta_s, phi in rng.uniform(0, [1.55, 1.55, math.pi], (20, 3)):
            ci, cs, cphi = math.cos(theta_i), math.cos(theta_s), math.cos(phi)
            n = 1.0 if kind == "reflection" else index
            sine = math.sin(theta_i) / n
            if sine >= 1:
                continue
            r = math.sqrt(sine**2 + math.sin(theta_s) ** 2 - 2 * sine * math.sin(theta_s) * cphi)
            spectrum = kc.psd_um4(n * r / 0.6328, AMPLITUDE_UM4, LENGTH_UM, 3.0)
            if kind == "reflection":
                ours = rr.brdf(ci, cs, rr.polarization_factor(ci, cs, cphi, index), spectrum, 0.6328)
            else:
                path = ghs.path_in_transmission(ci, math.sqrt(1 - sine**2), 1.0, n)
                ours = ghs.smooth(path, spectrum, 0.6328, n) * rr.transmitted_factor(ci, cs, cphi, n)
            assert ours == pytest.approx(theirs.BRDF(thetai=theta_i, thetas=theta_s, phis=phi), rel=VECTORS)


@pytest.mark.parametrize("n", [0.66, 1.33, 1.5168, 4.0])
def test_specular_direction(n: float) -> None:
    """There Q is R and T of the bare surface, also beyond the critical angle."""
    ci = np.linspace(0.02, 1, 50)
    c2 = 1 - (1 - ci * ci) / n**2
    ct = np.sqrt(np.maximum(c2, 0.0))
    expected = np.where(c2 > 0, reflectance(ci, ct, 1.0, n), 1.0)
    np.testing.assert_allclose(rr.polarization_factor(ci, ci, np.ones_like(ci), n), expected, rtol=1e-12)
    np.testing.assert_allclose(rr.transmitted_factor(ci, ct, np.ones_like(ci), n), 1 - expected, atol=1e-12)


def test_reciprocity() -> None:
    """Q(i → s) is Q(s → i); in transmission, n² of the BTDF goes with the direction."""
    rng = np.random.default_rng(5)
    a, b, cphi = rng.uniform(0.01, 1, 200), rng.uniform(0.01, 1, 200), rng.uniform(-1, 1, 200)
    for index in (1.5168, 0.66, 1.37 + 7.62j):
        forth, back = rr.polarization_factor(a, b, cphi, index), rr.polarization_factor(b, a, cphi, index)
        np.testing.assert_allclose(forth, back, rtol=1e-12)
    n = 1.5168
    b = np.sqrt(1 - rng.uniform(0, 0.999, 200) / n**2)  # directions inside that come from outside

    def btdf(cos_i, cos_s, index):
        ct = np.sqrt(1 - (1 - cos_i**2) / index**2)
        # λ is that in the medium of incidence: 1/n of the other's
        in_medium = 1.0 if index > 1 else 1 / n
        return ghs.smooth(cos_i - index * ct, 1.0, in_medium, index) * rr.transmitted_factor(cos_i, cos_s, cphi, index)

    np.testing.assert_allclose(btdf(a, b, n) / n**2, btdf(b, a, 1 / n), rtol=1e-9)


def test_scalar_theory_is_right_near_the_refracted_beam_only() -> None:
    """What the docstring of the scalar theory says of it, for light from air into glass at normal incidence."""
    n = 1.5168
    share = []
    for angle in (2, 10, 30):
        cs = math.cos(math.radians(angle))
        whole = rr.transmitted_factor(1.0, 1.0, 1.0, n)
        scalar = (ghs.path_in_transmission(1.0, cs, 1.0, n) / (1 - n)) ** 2
        vector = np.mean([rr.transmitted_factor(1.0, cs, math.cos(phi), n) / whole for phi in (0, math.pi / 2)])
        share.append(scalar / vector)
    assert 1 - share[0] == pytest.approx(0.004, abs=1e-3)
    assert 1 - share[1] == pytest.approx(0.09, abs=0.02)
    assert share[2] == pytest.approx(0.35, abs=0.02)


def test_drjit() -> None:
    """As NumPy to the rounding of float32, with complex and with real indices."""
    rng = np.random.default_rng(6)
    a, b, cphi = rng.uniform(0.05, 1, 50), rng.uniform(0.05, 1, 50), rng.uniform(-1, 1, 50)
    cosines = [mi.Float(x) for x in (a, b, cphi)]
    for index, array in ((1.37 + 7.62j, mi.Complex2f(1.37, 7.62)), (1.5168, mi.Float(1.5168)), (0.66, mi.Float(0.66))):
        expected = rr.polarization_factor(a, b, cphi, index)
        np.testing.assert_allclose(rr.polarization_factor(*cosines, array), expected, rtol=2e-4)
        if not isinstance(index, complex):
            expected = rr.transmitted_factor(a, b, cphi, index)
            np.testing.assert_allclose(rr.transmitted_factor(*cosines, array), expected, rtol=2e-3, atol=1e-6)
    normal = mi.Float(1.0)
    dr.enable_grad(normal)
    q = rr.polarization_factor(normal, mi.Float(0.7), mi.Float(0.2), mi.Complex2f(1.37, 7.62))
    dr.forward(normal)
    assert np.all(np.isfinite(dr.grad(q)))

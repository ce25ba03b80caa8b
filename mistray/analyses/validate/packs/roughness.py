"""BRDF of a rough surface to first order (Rayleigh and Rice), unpolarised, from mistray and NIST's SCATMECH."""

from __future__ import annotations

import math

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder, others
from mistray.estimate import Estimate
from mistray.physics import k_correlation as kc
from mistray.physics import rayleigh_rice as rr

WAVELENGTH_UM = 0.6328
AMPLITUDE_UM4, LENGTH_UM, SLOPE = 2 * math.pi * 1e-6, 2 * math.pi, 3.0  # of σ = 1 nm with a correlation length of 1 µm


def _angles(row: DeclaredRow) -> tuple[float, float, float]:
    return tuple(math.radians(row.argument(f"{key}_deg")) for key in ("theta_i", "theta_s", "phi"))  # type: ignore[return-value]


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """Return the function by which mistray computes the BRDF, 1/sr, at a row's angles; the parameters are unused."""

    def number(row: DeclaredRow) -> Estimate:
        theta_i, theta_s, phi = _angles(row)
        ci, cs, cphi = (math.cos(angle) for angle in (theta_i, theta_s, phi))
        q = rr.polarization_factor(ci, cs, cphi, complex(row.argument("n"), row.argument("k")))
        r = math.sqrt(
            math.sin(theta_i) ** 2 + math.sin(theta_s) ** 2 - 2 * math.sin(theta_i) * math.sin(theta_s) * cphi
        )
        psd = kc.psd_um4(r / WAVELENGTH_UM, AMPLITUDE_UM4, LENGTH_UM, SLOPE)
        return Estimate(float(rr.brdf(ci, cs, q, psd, WAVELENGTH_UM)), 0.0)

    return number


def asked(row: DeclaredRow, _: Finder) -> Estimate:
    """Return the BRDF of a rough surface at a row's angles, 1/sr, as pySCATMECH computes it."""
    theta_i, theta_s, phi = _angles(row)
    substrate = f"({row.argument('n')!r},{row.argument('k')!r})"
    psd = {None: "ABC_PSD_Function", "A": AMPLITUDE_UM4, "B": LENGTH_UM, "C": SLOPE}
    with others():
        from pySCATMECH.brdf import BRDF_Model

        values = {"lambda": WAVELENGTH_UM, "substrate": substrate, "type": 0, "psd": psd}
        model = BRDF_Model("Microroughness_BRDF_Model", values)
        return Estimate(float(model.BRDF(thetai=theta_i, thetas=theta_s, phis=phi)), 0.0)

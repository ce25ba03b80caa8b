"""Field vectors along recorded rays, with amplitudes of `tmm` (Chipman, Lam and Young 2018, chapter 9)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import tmm


@dataclass(frozen=True)
class Hit:
    """One event of a ray: ``kind`` T, R or I; indices before and behind; layers (N, d_nm) in the order of incidence."""

    kind: str
    n_in: complex
    n_out: complex
    layers: tuple[tuple[complex, float], ...] = ()


def amplitudes(hit: Hit, cosine: float, wavelength_nm: float) -> tuple[complex, complex]:
    """Amplitudes of s and p (E field, signs of `tmm`) scaled so that their squares are shares of the flux."""
    angle = np.arcsin(np.sqrt(max(1 - cosine * cosine, 0.0)))
    index = [hit.n_in, *(n for n, _ in hit.layers), hit.n_out]
    thickness = [np.inf, *(d for _, d in hit.layers), np.inf]
    s, p = (tmm.coh_tmm(pol, index, thickness, angle, wavelength_nm) for pol in "sp")
    if hit.kind in ("R", "I"):
        return s["r"], p["r"]
    s_t, p_t = (np.sqrt(a["T"]) * a["t"] / abs(a["t"]) for a in (s, p))
    return s_t, p_t


def starting(d: np.ndarray, u: np.ndarray, stokes: Sequence[float]) -> np.ndarray:
    """Fields that do not interfere, (2, 3), of light of flux 1 along d, s1, s2, s3 about u: s2 + i s3 = 2 ex ey*."""
    v, degree = np.cross(d, u), float(np.linalg.norm(stokes))
    if degree == 0:
        return np.array([u, v], dtype=complex) / np.sqrt(2)
    s1, s2, s3 = np.array(stokes) / degree
    ex = np.sqrt(max((1 + s1) / 2, 0.0))
    ey = (s2 - 1j * s3) / (2 * ex) if ex > 1e-8 else 1.0
    across = -np.conj(ey) * u + ex * v
    return np.array([np.sqrt((1 + degree) / 2) * (ex * u + ey * v), np.sqrt(max(1 - degree, 0) / 2) * across])


def ending(fields: np.ndarray, d: np.ndarray) -> tuple[float, float, float]:
    """s1, s2, s3 of fields about the world's x, or y where d is within acos 0.9 of ±x, as seen across d."""
    helper = np.eye(3)[1 if abs(d[0]) > 0.9 else 0]
    a = helper - (helper @ d) * d
    a /= np.linalg.norm(a)
    x, y = fields @ a, fields @ np.cross(d, a)
    flux, product = np.sum(abs(x) ** 2 + abs(y) ** 2), 2 * np.sum(x * y.conj())
    return float(np.sum(abs(x) ** 2 - abs(y) ** 2) / flux), float(product.real / flux), float(product.imag / flux)


def transport(directions: np.ndarray, hits: Sequence[Hit], wavelength_nm: float) -> tuple[np.ndarray, float]:
    """Flux behind each event of unpolarised light of flux 1 along directions (k + 1, 3); polarisation at the end."""
    first = directions[0]
    helper = np.eye(3)[np.argmin(np.abs(first))]
    a = np.cross(first, helper) / np.linalg.norm(np.cross(first, helper))
    flux, fields = carry(directions, hits, wavelength_nm, starting(first, a, (0.0, 0.0, 0.0)))
    values = np.linalg.eigvalsh(sum(np.outer(f, f.conj()) for f in fields))[::-1]
    return flux, float((values[0] - values[1]) / (values[0] + values[1]))


def carry(
    directions: np.ndarray, hits: Sequence[Hit], wavelength_nm: float, fields: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Flux behind each event, and the fields at the end, of fields (m, 3) at the start that do not interfere."""
    flux = []
    for before, after, hit in zip(directions[:-1], directions[1:], hits, strict=True):
        reflected = hit.kind in ("R", "I")
        normal = after - before if reflected else hit.n_out.real * after - hit.n_in.real * before
        size = np.linalg.norm(normal)
        # the directions are the same where the indices are: any plane of incidence will do only at normal incidence
        normal = normal / size if size > 1e-9 else before
        cosine = abs(float(before @ normal))
        s = np.cross(before, normal)
        if np.linalg.norm(s) <= 1e-12:
            s = np.cross(before, np.eye(3)[np.argmin(np.abs(before))])
        s = s / np.linalg.norm(s)
        j_s, j_p = amplitudes(hit, cosine, wavelength_nm)
        p_in, p_out = np.cross(s, before), np.cross(s, after)
        fields = np.array([j_s * (f @ s) * s + j_p * (f @ p_in) * p_out for f in fields])
        flux.append(float(np.sum(np.abs(fields) ** 2)))
    return np.array(flux), fields

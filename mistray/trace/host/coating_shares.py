"""R and T of coatings for s and p light on the host, with the amplitude products of Stokes vectors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mistray.physics.fresnel import amplitudes, total_product, transmitted_product
from mistray.surfaces.optics import (
    FRESNEL,
    OPAQUE,
    REFLECTION_BACK,
    REFLECTION_FRONT,
    TABLED,
    TRANSMISSION,
    Optics,
    angle_table,
)

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


class CoatingShares:
    """R and T for s and p light of every surface: ideal values, Fresnel's equations, or tables over the angle."""

    def __init__(self, optics: Optics) -> None:
        self._indices = optics.host_indices
        self._kind = optics.host_words & 3
        self._places = np.zeros((len(self._kind), 4), dtype=np.int64)
        rows: list[Floats] = [np.zeros((0, 3, 4))]
        count = 0
        for i in np.flatnonzero(self._kind == TABLED).tolist():
            opaque = bool(optics.host_words[i] & OPAQUE)
            found = angle_table(
                optics.bsdfs[i].coating, optics.wavelength_nm, *optics.complex_indices[i], opaque, stokes=True
            )
            first, second = len(found.refraction), len(found.total)
            self._places[i] = count, first - 1, count + first, second - 1
            rows += [found.refraction, found.total]
            count += first + second
        self._rows = np.concatenate(rows)

    def shares(
        self, surface: Whole, from_front: np.ndarray, cos_i: Floats, eta: Floats, opaque: np.ndarray
    ) -> tuple[Floats, Floats]:
        """
        Return R and T of s and p, with their amplitude products, at hits of surfaces.

        Parameters
        ----------
        surface, from_front, opaque : (n,)
            Indices of the surfaces, whether the light comes from the front, and whether the surface is opaque.
        cos_i, eta : (n,) float64
            Cosine of the angle of incidence, and ratio of the indices n_i/n_t.

        Returns
        -------
        reflection, transmission : (n, 4) float64
            R, or T, for s and for p, and real and imaginary part of the product of the amplitude of s with the
            conjugate amplitude of p. Transmission is 0 in total reflection and at opaque surfaces.
        """
        kind, (front, back, R, T) = self._kind[surface], self._indices[surface].T
        sin2_t = eta**2 * (1 - cos_i**2)
        total = (sin2_t >= 1) & ~opaque
        cos_t, beyond = np.sqrt(np.maximum(1 - sin2_t, 0)), np.sqrt(np.maximum(sin2_t - 1, 0))
        # An ideal coating acts on s and p alike, as a bare surface does at normal incidence
        R = np.where(total, R + T, R)
        reflection, transmission = np.stack([R, R, -R, 0 * R], axis=1), np.stack([T, T, T, 0 * T], axis=1)
        if len(bare := np.flatnonzero(kind == FRESNEL)):
            n_i, n_t = (np.where(from_front, a, b)[bare] for a, b in ((front, back), (back, front)))
            c_i, c_t = cos_i[bare], cos_t[bare]
            r_s, r_p = amplitudes(c_i, c_t, n_i, n_t)
            re, im = total_product(c_i, beyond[bare], n_i, n_t)
            s, p, there = r_s**2, r_p**2, total[bare]
            reflection[bare] = np.stack([s, p, np.where(there, re, r_s * r_p), np.where(there, im, 0)], axis=1)
            through = transmitted_product(c_i, c_t, n_i, n_t)
            transmission[bare] = np.stack([1 - s, 1 - p, through, 0 * s], axis=1)
        if len(tabled := np.flatnonzero(kind == TABLED)):
            there, places = total[tabled], self._places[surface[tabled]].T
            # The smaller cosine is that in the rarer medium
            x = np.where(there, beyond[tabled], np.minimum(cos_i, cos_t)[tabled])
            x /= np.where(there, x + (eta * cos_i)[tabled], 1)
            x *= np.where(there, places[3], places[1])
            node = np.minimum(x.astype(np.int64), np.where(there, places[3], places[1]) - 1)
            row, fraction = np.where(there, places[2], places[0]) + node, (x - node)[:, None]
            side = np.where(from_front[tabled], REFLECTION_FRONT, REFLECTION_BACK)
            for found, channel in ((reflection, side), (transmission, TRANSMISSION)):
                low, high = self._rows[row, channel], self._rows[row + 1, channel]
                found[tabled] = low + fraction * (high - low)
        transmission[opaque | total] = 0
        return reflection, transmission

"""A slab that scatters: Monte Carlo in float64, photon by photon, with index 1 inside and outside."""

import numpy as np


def slab(depth: float, albedo: float, g: float, cos_start: float, photons: int, seed: int) -> tuple[float, ...]:
    """Shares of photons that leave through the far and the near face of a slab, and that are absorbed."""
    rng = np.random.default_rng(seed)
    z, cosine = np.zeros(photons), np.full(photons, cos_start)
    through = back = absorbed = 0
    while len(z):
        z = z + cosine * rng.exponential(size=len(z))
        through += int(np.sum(z > depth))
        back += int(np.sum(z < 0))
        inside = (z >= 0) & (z <= depth)
        z, cosine = z[inside], cosine[inside]
        dies = rng.random(len(z)) > albedo
        absorbed += int(np.sum(dies))
        z, cosine = z[~dies], cosine[~dies]
        turn = _cosines(g, len(z), rng)
        azimuth = rng.uniform(0, 2 * np.pi, len(z))
        # Spherical trigonometry: only the cosine with the slab's normal matters
        cosine = cosine * turn + np.sqrt(1 - cosine**2) * np.sqrt(1 - turn**2) * np.cos(azimuth)
    return through / photons, back / photons, absorbed / photons


def _cosines(g: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """By rejection from (1 - g²)/(1 + g² - 2 g c)^1.5, whose largest value is at c = sign(g)."""
    largest = (1 - g * g) / (1 - abs(g)) ** 3
    result = np.empty(count)
    missing = np.arange(count)
    while len(missing):
        c = rng.uniform(-1, 1, len(missing))
        accepted = rng.random(len(missing)) * largest < (1 - g * g) / (1 + g * g - 2 * g * c) ** 1.5
        result[missing[accepted]] = c[accepted]
        missing = missing[~accepted]
    return result

"""χ² tests of sampled directions in charts for narrow lobes: azimuth and logarithm of the distance from a centre."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

FEWEST = 20  # expected events of a cell; cells with fewer are pooled
AZIMUTHS, PER_OCTAVE = 12, 3
R_MAX = 2.0  # the horizon at normal incidence, r = 1, is then an edge of cells
INNER = 24  # points of a cell each way, for the integral of the density


@dataclass(frozen=True)
class Chart:
    """Directions on one side of z by azimuth φ about a centre and u = ln r, `octaves` down from `R_MAX`; r is the
    distance of the tangential parts if ``flat``, else of the unit vectors."""

    centre: np.ndarray
    side: float
    flat: bool
    octaves: int

    def _frame(self) -> np.ndarray:
        c = self.centre / np.linalg.norm(self.centre)
        across = np.array([0.0, 1.0, 0.0]) if abs(c[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
        x = np.cross(across, c)
        x /= np.linalg.norm(x)
        return np.array([x, np.cross(c, x), c])

    def directions(self, phi: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors (…, 3), and by what a density per solid angle is multiplied to be one per φ and u; 0 if none."""
        r = np.exp(u)
        if self.flat:
            xy = self.centre[:2] + r[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
            z = np.sqrt(np.maximum(0.0, 1 - np.sum(xy**2, axis=-1)))
            jacobian = np.where(z > 0, r * r / np.where(z > 0, z, 1), 0)
            return np.concatenate([xy, self.side * z[..., None]], axis=-1), jacobian
        sine, cosine = r * np.sqrt(np.maximum(0.0, 1 - r * r / 4)), 1 - r * r / 2
        local = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=-1)
        made = local @ self._frame()
        return made, np.where(made[..., 2] * self.side > 0, r * r, 0)

    def place(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """φ in 0 … 2π and u of unit vectors (n, 3)."""
        if self.flat:
            d = directions[:, :2] - self.centre[:2]
            x, y = d.T
        else:
            d = directions - self.centre / np.linalg.norm(self.centre)
            x, y = (directions @ self._frame()[:2].T).T
        with np.errstate(divide="ignore"):
            return np.arctan2(y, x) % (2 * np.pi), np.log(np.linalg.norm(d, axis=1))


def p_value(
    directions: np.ndarray, drawn: int, density: Callable[[np.ndarray], np.ndarray], charts: Sequence[Chart]
) -> float:
    """Probability that directions deviate so much from a density per solid angle; samples without one are a cell."""
    seen, expected = [], []
    nearest = _nearest(directions, charts)
    for number, chart in enumerate(charts):
        edges_phi = np.linspace(0, 2 * np.pi, AZIMUTHS + 1)
        distances = PER_OCTAVE * chart.octaves
        edges_u = np.log(R_MAX) + np.log(2) * np.linspace(-chart.octaves, 0, distances + 1)
        phi, u = chart.place(directions[nearest == number])
        seen.append(np.histogram2d(phi, u, [edges_phi, edges_u])[0].ravel())
        offsets = (np.arange(INNER) + 0.5) / INNER
        points_phi = (edges_phi[:-1, None] + offsets * np.diff(edges_phi)[:, None]).ravel()
        points_u = (edges_u[:-1, None] + offsets * np.diff(edges_u)[:, None]).ravel()
        points, jacobian = chart.directions(*np.meshgrid(points_phi, points_u, indexing="ij"))
        flat = points.reshape(-1, 3)
        mine = (jacobian.ravel() > 0) & (_nearest(flat, charts) == number)
        values = np.zeros(len(flat))
        values[mine] = density(flat[mine]) * jacobian.ravel()[mine]
        cells = values.reshape(AZIMUTHS, INNER, distances, INNER).mean(axis=(1, 3))
        expected.append((cells * np.diff(edges_phi)[0] * np.diff(edges_u)[0] * drawn).ravel())
    counts, means = np.concatenate(seen), np.concatenate(expected)
    rest = max(drawn - means.sum(), 0.0)
    counts, means = np.append(counts, drawn - counts.sum()), np.append(means, rest)
    few = means < FEWEST
    counts = np.append(counts[~few], counts[few].sum())
    means = np.append(means[~few], means[few].sum())
    if means[-1] < FEWEST:
        counts, means = counts[:-1], means[:-1]
    assert len(means) > 10, "too few cells for a test"
    return float(chi2.sf(np.sum((counts - means) ** 2 / means), len(means) - 1))


def _nearest(directions: np.ndarray, charts: Sequence[Chart]) -> np.ndarray:
    centres = np.array([chart.centre / np.linalg.norm(chart.centre) for chart in charts])
    return np.argmax(directions @ centres.T, axis=1)

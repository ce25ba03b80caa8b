"""MTF of a lens of optiland by a sum over a fine grid: OTF(f) = ∫∫ P(s + λf/2) P*(s - λf/2) d²s / ∫∫ |P|² d²s, where
polynomials through optiland's rays tell the amplitude, the phase and the rim at places s on the reference sphere."""

from typing import Any

import numpy as np
import peers

DEGREE = 8
CELLS, RINGS, SPOKES = 256, 24, 48


def pupil_rays(optic: Any, field: float, wavelength_um: float) -> dict[str, np.ndarray]:
    """Places in the stop, on the reference sphere and in the entering beam, and OPD of optiland's rays; by name."""
    base = peers.optiland("distribution").BaseDistribution
    wavefront = peers.optiland("wavefront").Wavefront

    class Polar(base):  # type: ignore[misc, valid-type]
        def generate_points(self, *_args: Any, **_kwargs: Any) -> None:
            r = np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
            r[-1] = 1.0  # the rim itself: no polynomial is drawn out beyond its points
            t = 2 * np.pi * np.arange(SPOKES) / SPOKES
            self.x, self.y = np.outer(r, np.cos(t)).ravel(), np.outer(r, np.sin(t)).ravel()

    points = Polar()
    points.generate_points()
    data = wavefront(optic, [(0, field)], [wavelength_um], 4, points).get_data((0, field), wavelength_um)
    sphere = np.stack([np.asarray(getattr(data, f"pupil_{k}"), dtype=float) for k in "xyz"], axis=1)
    centre = np.ravel(np.array(data.reference_center, dtype=float))
    s = (centre - sphere) / float(np.ravel(data.radius)[0])
    optic.trace_generic(0.0, float(field), points.x, points.y, wavelength_um)
    first = np.stack([np.asarray(getattr(optic.surfaces, k), dtype=float)[1] for k in "xyz"], axis=1)
    along = np.array([float(np.asarray(getattr(optic.surfaces, k))[0][0]) for k in "LMN"])
    u = np.array([1.0, 0.0, 0.0])
    across = np.stack([first @ u, first @ np.cross(along, u)], axis=1)
    return {"stop": np.stack([points.x, points.y], axis=1), "s": s, "across": across, "opd": np.asarray(data.opd)}


def transfer(rays: dict[str, np.ndarray], wavelength_um: float, frequencies: np.ndarray, axis: int) -> np.ndarray:
    """(m,) MTF at frequencies along x (axis 0) or y (axis 1), 1/mm."""
    at = rays["s"][:, :2]
    middle, scale = at.mean(axis=0), np.abs(at - at.mean(axis=0)).max()
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]

    def terms(points: np.ndarray) -> np.ndarray:
        x, y = ((points - middle) / scale).T
        return np.stack([x**i * y**j for i, j in powers], axis=1)

    def slopes(points: np.ndarray, k: int) -> np.ndarray:
        x, y = ((points - middle) / scale).T
        p, q = (k == 0), (k == 1)
        return np.stack([(i * p + j * q) * x ** max(i - p, 0) * y ** max(j - q, 0) for i, j in powers], axis=1) / scale

    values = np.column_stack([rays["stop"], rays["across"], rays["opd"]])
    found, *_ = np.linalg.lstsq(terms(at), values, rcond=None)

    def amplitude(points: np.ndarray) -> np.ndarray:
        stop = terms(points) @ found[:, :2]
        inside = np.hypot(*stop.T) <= 1
        p, result = points[inside], np.zeros(len(points), dtype=complex)
        by_x, by_y = (slopes(p, k) @ found[:, 2:4] for k in (0, 1))
        density = np.abs(by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0])
        result[inside] = np.sqrt(density) * np.exp(-2j * np.pi * (terms(p) @ found[:, 4]))
        return result

    half = 1.02 * scale
    line = half * ((2 * np.arange(CELLS) + 1) / CELLS - 1)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) + middle
    total = float((np.abs(amplitude(grid)) ** 2).sum())
    result = []
    for f in frequencies:
        shift = np.zeros(2)
        shift[axis] = 0.5e-3 * wavelength_um * f
        result.append(abs(np.vdot(amplitude(grid - shift), amplitude(grid + shift))) / total)
    return np.array(result)

"""Sampling of the light of a field on an even grid of direction cosines about its image point.

A coarse grid of rays first finds where light gets through, and its range of direction cosines. Newton's method then
finds the rays of an even grid of direction cosines, whose OPD is exact. Cells cut by a rim or a vane are divided
further to find the share of light that passes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.physics.imaging.pupil import Pupil
from mistray.sampling.design_path import DesignPath
from mistray.trace.host.bundle import PointBundle
from mistray.trace.host.design_light import DesignLight, design_light
from mistray.trace.host.stop import PupilStop, Region

Array = npt.NDArray[np.float64]

PARTS = 32  # rays in a cell that is cut
LOOKS = 8 * 64**2  # rays in all cells together that look for what cuts them
STEP = 1e-4  # of the differences for slopes, in units of the pupil's size
NEWTON_STEPS = 5
ON_GRID = 1e-4  # of a cell, by which rays may miss their places
NOT_MET = 1e-2  # by which they may where the search ends
MARGIN = 1.05  # of the grid around the light
ORDERS = (6, 4, 2, 1)  # of the polynomials that rays are found by first
RAYS_PER_TERM = 6


@dataclass(frozen=True)
class ImageFrame:
    """
    Image point of a field, with its axes and reference sphere.

    Attributes
    ----------
    point : (3,) float64
        Image point in world coordinates, mm.
    axes : (3, 3) float64
        Unit vectors as columns: x (sagittal), y (tangential), z along the light.
    curvature : float
        Curvature of the reference sphere, 1/mm: above 0 if the exit pupil lies before the image, 0 for a plane.
    """

    point: Array
    axes: Array
    curvature: float

    def cosines(self, light: DesignLight) -> tuple[Array, Array]:
        """
        Return direction cosines (n, 3) from the reference sphere to the image point, and path lengths (n,), mm.

        The length is that to the sphere plus the index times its radius, which stays finite for a pupil at infinity.
        """
        q = light.last - self.point
        along = np.einsum("ij,ij->i", q, light.direction)
        aside = q - along[:, None] * light.direction
        k, square = self.curvature, (aside**2).sum(axis=1)
        with np.errstate(invalid="ignore"):
            root = np.sqrt(1 - k * k * square)
        s = root[:, None] * light.direction - k * aside
        return s @ self.axes, light.opl_mm + light.index * (k * square / (1 + root) - along)


@dataclass(frozen=True)
class PupilSamples:
    """
    Light of a field at one wavelength, sampled on a grid of direction cosines.

    Attributes
    ----------
    pupil : Pupil
        Amplitude and OPD over the direction cosines.
    spot : (n, n, 2) float64
        Points on the detector relative to the image point, mm; NaN in dark cells. Of a cell that is cut it is the mean
        of its lit part.
    blur : (n, n) float64
        Mean square distance of the light of a cell at a rim from that point, mm²; 0 in other cells.
    stop : (n, n, 2) float64
        Points where the rays cross the stop, in units of its radius; NaN in dark cells.
    jacobian : (n, n) float64
        Area in the stop per area of direction cosines; NaN in dark cells.
    illumination : float
        ∫∫ T n² dα dβ with the throughput T: irradiance of the image of a scene of radiance 1, sr.
    """

    pupil: Pupil
    spot: Array
    blur: Array
    stop: Array
    jacobian: Array
    illumination: float


def sample_pupil(
    path: DesignPath, bundle: PointBundle, region: Region, frame: ImageFrame, stop: PupilStop, chief: Array, grid: int
) -> PupilSamples | None:
    """
    Return the light of a field sampled on an even grid of direction cosines.

    Parameters
    ----------
    path : DesignPath
        Design path of the scene.
    bundle, region
        Rays of the field, and the region of those that get through at this wavelength.
    frame : ImageFrame
        Image point, axes and reference sphere.
    stop : PupilStop
        Aperture stop, in which the rays also get coordinates.
    chief : (1, 2) float64
        Coordinates of the chief ray, the reference of the OPD.
    grid : int
        Number of cells across.

    Returns
    -------
    PupilSamples or None
        None if the light does not converge: its rays are parallel at the detector.
    """
    seen = design_light(path, *bundle.rays(region.points))
    known, _ = frame.cosines(seen)
    good = np.isfinite(known).all(axis=1)
    known, points = known[good, :2], region.points[good]
    low, high = known.min(axis=0), known.max(axis=0)
    across = region.size / region.cell
    width = MARGIN * float(np.max(high - low)) * (1 + 2 / max(across, 1.0))
    if not width > 1e-9:
        return None
    step = width / grid
    axes = [0.5 * (low + high)[k] + step * (np.arange(grid) - 0.5 * (grid - 1)) for k in (0, 1)]
    wanted = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    near = _near(wanted, known, 3 * width / max(across, 1.0) + step)
    x, slopes = np.full((len(wanted), 2), np.nan), np.full((len(wanted), 2, 2), np.nan)
    x[near], slopes[near] = _rays_to(path, bundle, frame, wanted[near], (points, known), region.size, step)
    lit = np.zeros(len(x), dtype=bool)
    some = np.flatnonzero(np.isfinite(x).all(axis=1))
    lit[some] = path.unobstructed(*bundle.rays(x[some]), beyond_end=True).passes
    share, hits, blur = _shares(path, bundle, x, slopes, lit.reshape(grid, grid), step)
    used = np.flatnonzero(share > 0)
    light = design_light(path, *bundle.rays(x[used]), throughput=True)
    opl = frame.cosines(light)[1]
    origin = frame.cosines(design_light(path, *bundle.rays(chief)))[1]
    flux = light.throughput * bundle.density(x[used]) / np.abs(np.linalg.det(slopes[used]))
    fine = np.isfinite(opl) & np.isfinite(flux)
    share[used[~fine]] = 0.0
    used = used[fine]
    # Of a cell that a rim cuts the ray in the middle may lie beyond it, where the spot is not lit
    hit = np.where(np.isfinite(hits[used]), hits[used], light.hit[fine])

    def spread(values: Array, fill: float) -> Array:
        result = np.full((grid * grid, *values.shape[1:]), fill)
        result[used] = values
        return result.reshape(grid, grid, *values.shape[1:])

    wavelength_mm = path.table.wavelength_nm * 1e-6
    at_stop, jacobian = _at_stop(path, bundle, stop, x[used], slopes[used], STEP * region.size)
    everything = np.full((grid * grid, 3), np.nan)
    everything[used] = np.column_stack([at_stop, jacobian])
    pupil = Pupil(
        wavelength_mm=wavelength_mm,
        index=light.index,
        step=step,
        alpha=axes[0],
        beta=axes[1],
        flux=spread(flux[fine], 0.0),
        share=share.reshape(grid, grid),
        opd_waves=spread((origin - opl[fine]) / wavelength_mm, 0.0),
        curvature=frame.curvature,
    )
    spot = spread((hit - frame.point) @ frame.axes[:, :2], np.nan)
    total = float((light.throughput[fine] * share[used]).sum()) * step**2 * light.index**2
    stopped = everything.reshape(grid, grid, 3)
    return PupilSamples(pupil, spot, blur.reshape(grid, grid), stopped[..., :2], stopped[..., 2], total)


def _near(wanted: Array, known: Array, margin: float) -> npt.NDArray[np.bool_]:
    """
    Return a mask of points (n, 2) inside the convex hull of known points or within `margin` of it, (n,) bool.

    All of them are direction cosines. If the known points have no hull, all are marked.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(known).equations  # unit normals outwards, and offsets
    except (QhullError, ValueError):  # too few rays for a hull
        return np.ones(len(wanted), dtype=bool)
    return np.asarray(np.all(wanted @ sides[:, :2].T + sides[:, 2] <= margin, axis=1))


def _rays_to(
    path: DesignPath,
    bundle: PointBundle,
    frame: ImageFrame,
    wanted: Array,
    known: tuple[Array, Array],
    size: float,
    cell: float,
) -> tuple[Array, Array]:
    """
    Return rays with the direction cosines `wanted`, (n, 2), found by Newton's method.

    `known` are the coordinates of some rays in the bundle and their direction cosines, (m, 2) each. `size` is the
    extent of the light in those coordinates, and `cell` the step of the grid in direction cosines.

    Returns
    -------
    x : (n, 2) float64
        Coordinates of the rays in the bundle; NaN if none is found.
    slopes : (n, 2, 2) float64
        Derivatives of the cosines with respect to the coordinates; NaN where they are degenerate.
    """
    x = _guess(wanted, *known)
    h = STEP * size
    shifts = np.concatenate([np.zeros((1, 2)), h * np.eye(2), -h * np.eye(2)])
    slopes = np.full((len(x), 2, 2), np.nan)
    miss = np.full(x.shape, np.inf)
    for number in range(NEWTON_STEPS):
        tried = (x[:, None] + shifts[: 1 if number else 5]).reshape(-1, 2)
        found = frame.cosines(design_light(path, *bundle.rays(tried)))[0][:, :2].reshape(len(x), -1, 2)
        if not number:
            slopes = np.stack([(found[:, 1] - found[:, 3]), (found[:, 2] - found[:, 4])], axis=2) / (2 * h)
        miss = wanted - found[:, 0]
        good = np.isfinite(miss).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
        good[good] = np.abs(np.linalg.det(slopes[good])) > 0
        if number and not np.any(np.abs(miss[good]) > ON_GRID * cell):
            break
        change = np.full_like(x, np.nan)
        change[good] = np.linalg.solve(slopes[good], miss[good][..., None])[..., 0]
        x = x + change
    # Beside the light the directions may fold over, and there is no such ray
    with np.errstate(invalid="ignore"):
        x[~np.all(np.abs(miss) <= NOT_MET * cell, axis=1)] = np.nan
        flat = ~(np.abs(np.linalg.det(slopes)) > 0)
    x[flat], slopes[flat] = np.nan, np.nan
    return x, slopes


def _guess(wanted: Array, points: Array, known: Array) -> Array:
    """Return guesses of coordinates, (n, 2), of rays with cosines `wanted`, from `points` with cosines `known`."""
    middle = 0.5 * (known.min(axis=0) + known.max(axis=0))
    scale = max(0.5 * float(np.ptp(known, axis=0).max()), 1e-300)
    order = next(n for n in ORDERS if n == ORDERS[-1] or len(points) >= RAYS_PER_TERM * (n + 1) * (n + 2) // 2)

    def terms(at: Array) -> Array:
        a, b = ((at - middle) / scale).T
        return np.stack([a**i * b**j for i in range(order + 1) for j in range(order + 1 - i)], axis=1)

    return np.asarray(terms(wanted) @ np.linalg.lstsq(terms(known), points, rcond=None)[0])


def _shares(
    path: DesignPath, bundle: PointBundle, x: Array, slopes: Array, lit: npt.NDArray[np.bool_], step: float
) -> tuple[Array, Array, Array]:
    """
    Return the lit fraction of each pupil cell, and where its light meets the detector.

    `x`, (cells, 2), and `slopes` are those of `_rays_to`; `lit`, (n, n), marks cells whose middle ray passes. `step` is
    their width in direction cosines. A few rays test every cell, because a vane narrower than a cell may lie between
    the middles. Cells that are cut, and their neighbours, are divided further, so that a vane found in one cell is
    followed to its end.

    Returns
    -------
    share : (cells,) float64
        Lit fraction.
    hits : (cells, 3) float64
        Mean point on the detector, mm, of the lit part of each divided cell; NaN for others and dark ones.
    blur : (cells,) float64
        Mean square distance from that point, mm²; 0 where there is none.
    """
    n = len(lit)
    known = np.isfinite(slopes).all(axis=(1, 2))
    share, hits, blur = lit.astype(np.float64).ravel(), np.full((len(x), 3), np.nan), np.zeros(len(x))
    moved = np.random.default_rng(0).random((len(x), 2))

    def look(cells: npt.NDArray[np.intp], count: int) -> tuple[tuple[Array, Array], npt.NDArray[np.bool_]]:
        """Return `count` test rays of each cell, see `PointBundle.rays`, and which of them pass, (m, count) bool."""
        at = step * ((_net(count) + moved[cells, None]) % 1 - 0.5)
        moves = np.swapaxes(np.linalg.solve(slopes[cells], np.swapaxes(at, 1, 2)), 1, 2)
        rays = bundle.rays((x[cells, None] + moves).reshape(-1, 2))
        return rays, path.unobstructed(*rays, beyond_end=True).passes.reshape(len(cells), count)

    def beside(cells: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return a mask of the cells that are marked or adjacent to a marked one, (n·n,) bool."""
        ringed = np.pad(cells.reshape(n, n), 1)
        return np.any([ringed[i : i + n, j : j + n] for i in range(3) for j in range(3)], axis=0).ravel()

    divided = np.zeros(len(x), dtype=bool)
    cut = beside(lit.ravel()) & beside(~lit.ravel())
    every = np.flatnonzero(known)
    passes = look(every, 1 << max(0, int(np.log2(LOOKS / len(x)))))[1]
    cut[every] |= np.any(passes != lit.ravel()[every, None], axis=1)
    while len(cells := np.flatnonzero(cut & known & ~divided)):
        rays, passes = look(cells, PARTS)
        share[cells] = passes.mean(axis=1)
        points = design_light(path, *rays).hit.reshape(*passes.shape, 3)
        seen = passes & np.isfinite(points).all(axis=2)
        some = seen.any(axis=1)
        hits[cells[some]] = np.mean(points[some], axis=1, where=seen[some, :, None])
        apart = points[some] - hits[cells[some], None]
        blur[cells[some]] = np.mean((apart**2).sum(axis=2), axis=1, where=seen[some])
        divided[cells] = True
        cut = beside(divided & (share > 0) & (share < 1))
    return share, hits, blur


def _net(count: int) -> Array:
    """
    Return points evenly spread over the unit square, (count, 2); `count` is a power of 2.

    J. M. Hammersley, "Monte Carlo methods for solving multivariable problems", Ann. N. Y. Acad. Sci. 86, 844 (1960).
    """
    k, bits = np.arange(count), int(np.log2(count))
    reversed_k = sum((((k >> bit) & 1) << (bits - 1 - bit) for bit in range(bits)), np.zeros_like(k))
    return np.asarray((np.stack([k, reversed_k], axis=1) + 0.5) / count)


def _at_stop(
    path: DesignPath, bundle: PointBundle, stop: PupilStop, x: Array, slopes: Array, h: float
) -> tuple[Array, Array]:
    """
    Return stop coordinates of rays, (n, 2) in stop radii, and stop area per area of direction cosines, (n,).

    The rays have entrance coordinates `x`, (n, 2), in which derivatives are taken over steps of ±`h`, and derivatives
    `slopes` of their cosines with respect to `x`.
    """
    shifts = np.concatenate([np.zeros((1, 2)), h * np.eye(2), -h * np.eye(2)])
    found = stop.coordinates(path, bundle, (x[:, None] + shifts).reshape(-1, 2)).reshape(len(x), 5, 2)
    by_x = np.stack([found[:, 1] - found[:, 3], found[:, 2] - found[:, 4]], axis=2) / (2 * h)
    return found[:, 0], np.abs(np.linalg.det(by_x) / np.linalg.det(slopes))

"""
Derivatives of a metric by geometry and all other parameters, for one source and wavelength.

The rays of each pass are recorded, sorted by path and replayed, see `mistray.gradients.replay`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.execute.tracer import Run
from mistray.gradients.edges import Edges
from mistray.gradients.full.full_rims import FullRims
from mistray.gradients.path_replay import PathReplay, each
from mistray.gradients.replay import scatter_event
from mistray.gradients.replay_surfaces import Hit, ReplaySurfaces, Split
from mistray.gradients.scatter_replay import ScatterReplay
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.recorders.film import Film
from mistray.recorders.path_derivative import MOMENTS, PathDerivative
from mistray.recorders.start_rays import StartRays
from mistray.recorders.tallies import HITS
from mistray.sampling.source import SceneSource
from mistray.surfaces.upload import upload

BOX_FILM = (
    "light that moves from pixel to pixel counts as if the derivative by the image were linear between their centres; "
    "a film with the reconstruction filter 'tent' has it exactly"
)
UNKNOWN_SHARE = 1e-9  # detected light past rims that merits a note, as a fraction of all
SAMPLE_STEP = 0x632BE5AB  # between seeds of samples; seeds of runs differ by 0x9E3779B9, so none coincide
HITS_PER_RAY = 8.0  # first guess if the scene has not been traced; portions that are too large are halved


class DetectorEnd:
    """
    Contribution of a detector hit to the metric.

    Parameters
    ----------
    film : Film
    coefficients : (n, MOMENTS) float64 or None
        Coefficients of the moments of each ray's hit.
    pixel : mi.Float64 or None
        (maps, height, width) derivative by the flux in each pixel, in units of a start ray.
    maps : (n,) int
        Number of the map of each ray, -1: none.
    flux : mi.Float64
        Flux with which each ray meets the detector.
    scatter : ScatterReplay or None
        Scatter of the scene; None: no surface scatters.
    """

    def __init__(
        self,
        film: Film,
        coefficients: np.ndarray | None,
        pixel: mi.Float64 | None,
        maps: np.ndarray,
        flux: mi.Float64,
        scatter: ScatterReplay | None,
    ) -> None:
        self._film, self._pixel, self._flux, self._scatter = film, pixel, flux, scatter
        self._mapped = upload(mi.Bool, maps >= 0)
        pixels = film.width * film.height
        self._first = upload(mi.UInt32, (np.maximum(maps, 0) * pixels).astype(np.uint32))
        self._terms = None
        if coefficients is not None:
            self._terms = [upload(mi.Float64, coefficients[:, k]) for k in range(MOMENTS)]

    def __call__(
        self,
        surfaces: ReplaySurfaces,
        met: Hit,
        recorded: mi.Vector3d,
        split: Split,
        s: mi.UInt32,
        batch: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Float64:
        """Return the contribution of each ray to the metric, to first order, as a function of its last hit."""
        # The coefficients hold centroids of recorded hits. A float64 hit differs from its recorded one by a shift that
        # rays of a path share, and the slope of a variance would see it.
        there = surfaces.local_point(recorded, s, active)
        x, y = (now - dr.detach(now) + then for now, then in ((met.q.x, there.x), (met.q.y, there.y)))
        gain = mi.Float64(0)
        if self._terms is not None:
            # Moments: a quadratic polynomial in the place of the hit
            a, bx, by, cxx, cyy, cxy = self._terms
            gain = gain + a + x * (bx + cxx * x + cxy * y) + y * (by + cyy * y)
        if self._pixel is not None:
            gain = gain + self._image(x, y, active)
        # The detector records what it absorbs
        absorbed = 1 - split.R - split.T
        if self._scatter is not None:
            here = scatter_event(met, split, s, mi.Bool(True), batch)
            absorbed = self._scatter.absorbed(here, active)
        return self._flux * absorbed * gain

    def _image(self, x: mi.Float64, y: mi.Float64, active: mi.Bool) -> mi.Float64:
        """
        Return the derivative by the image at a place on the film.

        The value is that of the film's own filter, the slope that of bilinear interpolation between pixel centres.
        """
        film = self._film
        column, row = (
            (x - mi.Float64(film.x0)) * mi.Float64(film.per_mm_x),
            (y - mi.Float64(film.y0)) * mi.Float64(film.per_mm_y),
        )

        def pixel(i: mi.Int32, j: mi.Int32) -> mi.Float64:
            i, j = dr.clip(i, 0, film.width - 1), dr.clip(j, 0, film.height - 1)
            return dr.gather(
                mi.Float64, self._pixel, self._first + mi.UInt32(j * film.width + i), active & self._mapped
            )

        u, v = column - 0.5, row - 0.5
        i, j = mi.Int32(dr.floor(dr.detach(u))), mi.Int32(dr.floor(dr.detach(v)))
        fu, fv = u - mi.Float64(i), v - mi.Float64(j)
        smooth = dr.lerp(
            dr.lerp(pixel(i, j), pixel(i + 1, j), fu), dr.lerp(pixel(i, j + 1), pixel(i + 1, j + 1), fu), fv
        )
        if film.tent:
            return smooth
        own = pixel(mi.Int32(dr.floor(dr.detach(column))), mi.Int32(dr.floor(dr.detach(row))))
        return own + (smooth - dr.detach(smooth))


def run_gradient(
    run: Run, paths: PathDerivative | None, pixel: np.ndarray | None, request: GradientRequest
) -> TableGradient:
    """
    Compute the derivatives of a metric at one source and wavelength by tracing the same rays again.

    Parameters
    ----------
    run : Run
    paths : PathDerivative or None
        Coefficients by path; None: all hits contribute, to map 0.
    pixel : (maps, height, width) or None
        Derivative by the flux in each pixel, in units of a start ray.
    request : GradientRequest
        Coatings alone take a second trace (see `mistray.recorders.adjoint`); for anything else rays are recorded and
        replayed (see `mistray.gradients.replay`).
    """
    # Coatings alone: one adjoint trace, nothing is recorded
    if not request.replays:
        return TableGradient(run.table, run.scattering, rows=run.derivatives(pixel, paths))
    longest = run.settings.max_events if run.paths is None else int(run.paths.lengths.max(initial=1))
    source = run.source
    assert isinstance(source, SceneSource)
    path_replay = PathReplay(run.table, run.scattering, run.settings, request, longest, source)
    # Size of the portions, from the hits of the trace
    film = run.make_film()
    image = None if pixel is None else upload(mi.Float64, np.asarray(pixel, dtype=np.float64))
    traced = run.surfaces.size > 0
    hits = float(run.surfaces[run.table.detector, HITS].sum()) / run.rays if traced else HITS_PER_RAY
    recorder = path_replay.recorder

    # Callbacks: trace a portion, select its paths, evaluate the detector
    def trace(start: StartRays) -> None:
        run.trace_trees(start, recorder)

    def counts(keys: np.ndarray) -> np.ndarray:
        if paths is None:
            return np.ones(len(keys), dtype=bool)
        coefficients, maps = paths.of(keys)
        return np.asarray(coefficients.any(axis=1) | ((maps >= 0) & (image is not None)))

    def end(row: mi.UInt32, keys: np.ndarray) -> DetectorEnd:
        coefficients, maps = each(paths.of, keys) if paths is not None else (None, np.zeros(len(keys), dtype=np.int64))
        return DetectorEnd(
            film, coefficients, image, maps, dr.gather(mi.Float64, recorder.weight, row), path_replay.scatter
        )

    with dr.suspend_grad():  # single events are differentiated, nothing around them
        edges = None
        if path_replay.edges:
            full = FullRims(source, run.table, request.edge_widths[0])
            edges = Edges(run.scene, run.settings, request.edge_widths, full.limits)
            adjoint = run.adjoint(pixel, paths, rows=0)
        # Record and replay pass by pass: paths with visibility held, then hits close to rims
        for sample in _samples(run, request.edge_samples):
            for number in range(run.passes):
                whole = sample.start_pass(number)
                if not request.only_rims:
                    for start in path_replay.portions(whole, hits, trace):
                        path_replay.replay(start, counts, end)
                if edges is not None:
                    for start, events in edges.events(whole, adjoint):
                        path_replay.replay_edges(start, events)
    # Result, with notes on what it leaves out
    raw = path_replay.result()
    if edges is not None and full.any:
        raw.full.append(full)
    if edges is not None and traced and not request.edge_samples:
        strange = float(adjoint.unknown[0]) / max(float(run.light.value.sum()), np.finfo(float).tiny)
        if strange > UNKNOWN_SHARE:
            raw.left_out.append(
                f"light past rims on paths that the trace has not met: {strange:.1e} of what is detected"
            )
    if image is not None and request.geometry and not film.tent:
        raw.left_out.append(BOX_FILM)
    return raw


def _samples(run: Run, count: int) -> Iterator[Run]:
    """Yield the run itself, or as many further runs that start other rays."""
    if not count:
        yield run
    for number in range(1, count + 1):
        yield replace(run, seed=(run.seed + SAMPLE_STEP * number) % 2**32)

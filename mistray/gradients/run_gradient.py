"""
Derivatives of a metric with respect to scene parameters, for one source and wavelength.

The rays of each pass are recorded, sorted by path and replayed, see `mistray.gradients.replay`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.execute.tracer import Run
from mistray.gradients.path_replay import FIRST_RECORDS, Ends, PathReplay
from mistray.gradients.recorded_rays import RecordedRays
from mistray.gradients.replay import End
from mistray.gradients.replay_surfaces import ReplaySurfaces
from mistray.gradients.replayed_event import ReplayedEvent
from mistray.gradients.scatter_replay import ScatterReplay
from mistray.gradients.table_gradient import Derivatives, GradientRequest, TableGradient
from mistray.recorders.film import Film
from mistray.recorders.path_derivative import MOMENTS, PathDerivative
from mistray.sampling.source import SceneSource
from mistray.surfaces.upload import upload

BOX_FILM = (
    "light that moves between pixels counts as if derivatives with respect to the image were linear between their "
    "centres; a film with the reconstruction filter 'tent' has it exactly"
)
UNKNOWN_SHARE = 1e-9  # detected light past rims that merits a note, as a fraction of all
SAMPLE_STEP = 0x632BE5AB  # between seeds of samples; seeds of runs differ by 0x9E3779B9, so none coincide


@dataclass(frozen=True)
class DetectorEnds(Ends):
    """
    Contributions to a metric of recorded rays that end at the detector.

    Attributes
    ----------
    film : Film
        Pixel grid of the detector.
    paths : PathDerivative or None
        Coefficients by path; None: all hits contribute, to map 0.
    pixel : mi.Float64 or None
        (maps, height, width) derivative of the metric with respect to the flux in each pixel, the flux in units of the
        start ray's; None: the metric does not use the image.
    scatter : ScatterReplay or None
        Scatter of the scene; None: no surface scatters.
    """

    film: Film
    paths: PathDerivative | None
    pixel: mi.Float64 | None
    scatter: ScatterReplay | None

    def counts(self, keys: np.ndarray) -> np.ndarray:
        """Return a mask of paths, (n,) bool: True where a path contributes to the metric; `keys` as in `Ends`."""
        if self.paths is None:
            return super().counts(keys)
        coefficients, maps = self.paths.of(keys)
        return np.asarray(coefficients.any(axis=1) | ((maps >= 0) & (self.pixel is not None)))

    def end(self, rays: RecordedRays, keys: np.ndarray, path: mi.UInt32) -> End:
        """Return the contribution of each ray to the metric, a function of its detector hit, see `Ends.end`."""
        terms: list[mi.Float64] = []
        mapped, first = mi.Bool(True), mi.UInt32(0)
        if self.paths is not None:
            coefficients, maps = self.paths.of(keys)
            table = upload(mi.Float64, coefficients)
            terms = [dr.gather(mi.Float64, table, MOMENTS * path + k) for k in range(MOMENTS)]
            places = np.maximum(maps, 0) * (self.film.width * self.film.height)
            mapped, first = (
                dr.gather(kind, upload(kind, values), path)
                for kind, values in ((mi.Bool, maps >= 0), (mi.UInt32, places))
            )
        flux, place = rays.weight, rays.place

        def gained(surfaces: ReplaySurfaces, at: ReplayedEvent) -> mi.Float64:
            # The coefficients hold centroids of recorded places. A hit of the replay differs from its recorded one by a
            # shift that rays of a path share, and the slope of a variance would see it
            x, y = (mi.Float64(now - dr.detach(now)) + then for now, then in zip((at.q.x, at.q.y), place, strict=True))
            gain = mi.Float64(0)
            if terms:
                # Moments: a quadratic polynomial in the place of the hit
                a, bx, by, cxx, cyy, cxy = terms
                gain = gain + a + x * (bx + cxx * x + cxy * y) + y * (by + cyy * y)
            if self.pixel is not None:
                gain = gain + self._image(x, y, first, at.active & mapped)
            # The detector records what it absorbs
            absorbed = 1 - at.R - at.T if self.scatter is None else self.scatter.absorbed(at, at.active)
            return flux * absorbed * gain

        return gained

    def _image(self, x: mi.Float64, y: mi.Float64, first: mi.UInt32, active: mi.Bool) -> mi.Float64:
        """
        Return the metric's derivative with respect to flux at places x, y, mm, on the detector, in the unit of `pixel`.

        The value is that of the film's own filter, the slope that of bilinear interpolation between pixel centres.
        `first` is the index in `pixel` of the first pixel of each ray's map.
        """

        def filtered(film: Film) -> mi.Float64:
            found = mi.Float64(0)
            for pixel, share in film.places(x, y):
                value = dr.gather(mi.Float64, self.pixel, first + pixel, active)
                found += value if share is None else value * share
            return found

        smooth = filtered(replace(self.film, tent=True))
        return smooth if self.film.tent else filtered(self.film) + (smooth - dr.detach(smooth))


def run_gradient(
    run: Run, paths: PathDerivative | None, pixel: np.ndarray | None, request: GradientRequest
) -> TableGradient:
    """
    Return the derivatives of a metric at one source and wavelength, by tracing the same rays again.

    Parameters
    ----------
    run : Run
        Executed run, whose rays are traced again.
    paths : PathDerivative or None
        Coefficients by path; None: all hits contribute, to map 0.
    pixel : (maps, height, width) or None
        Derivative of the metric with respect to the flux in each pixel, the flux in units of the start ray's. None: the
        metric does not use the image.
    request : GradientRequest
        Requested derivatives. Coatings alone take a second trace (see `mistray.recorders.adjoint`); for anything else
        rays are recorded and replayed (see `mistray.gradients.replay`).

    Raises
    ------
    MistrayError
        If the rays are replayed and the scene has what a replay cannot treat, see
        `mistray.gradients.path_replay.PathReplay`, or a single start ray has more ends than can be recorded.
    """
    # Coatings alone: one adjoint trace, nothing is recorded
    if not request.replays:
        return TableGradient(run.table, run.scattering, Derivatives(rows=run.derivatives(pixel, paths)))
    traced = run.executed  # None where the film alone is differentiated
    longest, records = run.settings.max_events, FIRST_RECORDS
    if traced is not None and traced.paths is not None:
        longest = int(traced.paths.lengths.max(initial=1))
        records = float(traced.paths.sums[:, :, 0].sum() / max(run.started.sum(), 1))
    assert isinstance(run.source, SceneSource)
    film = run.make_film()
    image = None if pixel is None else upload(mi.Float64, np.asarray(pixel, dtype=np.float64))
    with dr.suspend_grad():  # single events are differentiated, nothing around them
        path_replay = PathReplay(run.scene, run.settings, request, longest, run.source, records)
        ends = DetectorEnds(film, paths, image, path_replay.scatter)
        adjoint = run.adjoint(pixel, paths, rows=0) if path_replay.edges else None
        # The run itself, or as many further runs that start other rays
        further = [SAMPLE_STEP * number for number in range(1, request.edge_samples + 1)]
        for sample in [replace(run, seed=(run.seed + step) % 2**32) for step in further] or [run]:
            for number in range(run.passes):
                path_replay.replay_pass(sample.start_pass(number), run.trace_trees, ends, adjoint)
    # Result, with notes on what it leaves out
    raw = path_replay.result()
    if adjoint is not None and traced is not None and traced.surfaces.size and not request.edge_samples:
        strange = float(adjoint.unknown[0]) / max(float(run.light.value.sum()), np.finfo(float).tiny)
        if strange > UNKNOWN_SHARE:
            raw.left_out.append(
                f"light past rims on paths that the trace has not met: {strange:.1e} of what is detected"
            )
    if image is not None and request.geometry and not film.tent:
        raw.left_out.append(BOX_FILM)
    return raw

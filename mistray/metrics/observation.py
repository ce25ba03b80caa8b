"""Observation of a trace for a metric: powers, moments and images of paths as numbers that Dr.Jit differentiates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.metrics.changes.first_surfaces import FirstLight
from mistray.ranges import NORM as NORMS
from mistray.ranges import several, shown
from mistray.recorders.path_derivative import MOMENTS, HitDerivative
from mistray.recorders.path_events import way_text
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload
from mistray.trace import PathRow, Trace
from mistray.trace.named_paths import ALL, KINDS
from mistray.trace.path_filter import PathFilter

Selection = str | Sequence[str] | Callable[[PathRow], bool]
FEWEST_RAYS = 30  # rays below which the RMS radius of a path is too uncertain
NORM = 16.0  # exponent of smooth maxima: 4 % above two equal values, 1.7 times 4096 of them
TERMS = 4  # sums of a path: flux, and flux times x, y and x² + y²
# Coefficients of 1, x, y, x², y² and x y with which a hit at (x, y) adds its flux to each sum
TERM_COEFFICIENTS = np.zeros((TERMS, MOMENTS))
TERM_COEFFICIENTS[[0, 1, 2, 3, 3], [0, 1, 2, 3, 4]] = 1


@dataclass(frozen=True)
class Moments:
    """
    Moments of the light of some paths on the detector, as Dr.Jit numbers: one, or one for each path.

    Attributes
    ----------
    power : mi.Float64
        Power that the detector absorbs, W.
    x, y : mi.Float64
        Coordinates of the centroid in the detector's frame, mm.
    variance : mi.Float64
        Mean square distance from the centroid, mm².
    """

    power: mi.Float64
    x: mi.Float64
    y: mi.Float64
    variance: mi.Float64

    @property
    def rms_radius(self) -> mi.Float64:
        """RMS distance from the centroid, mm."""
        return dr.sqrt(self.variance)

    @property
    def rms_irradiance(self) -> mi.Float64:
        """Power over the area of a circle of the RMS radius, P / (π r²), W/mm²; as in the ghost table."""
        return self.power / (np.pi * self.variance)


class Observation:
    """
    Results of a trace as numbers that Dr.Jit can differentiate, for use in metrics.

    Parameters
    ----------
    result : Trace
        Trace at one field angle.

    Attributes
    ----------
    trace : Trace
        Trace with its results, which are not differentiable.

    Examples
    --------
    >>> found = mistray.optimize.Observation(mistray.trace(mistray.load("cooke_triplet"), rays=5000))
    >>> print(f"{found.power('ghost')[0] / found.launched_W:.4f}")
    0.0042
    """

    resamples = True
    """Whether other samples of the same light have the same meaning, see `GradientRequest.edge_samples`."""

    def __init__(self, result: Trace) -> None:
        self.trace = result
        self._rows = list(result.paths)
        self._moments_of_rows = result.paths.moments()
        self._sums: dict[tuple[tuple[int, ...], ...], tuple[mi.Float64, ...]] = {}
        self._maps: dict[tuple[int, ...], tuple[mi.Float64, Sampled]] = {}

    @property
    def irradiance(self) -> mi.Float64:
        """Irradiance of all light, W/mm², (height · width,), row by row; row 0 is at the smallest y."""
        return self._map(tuple(range(len(self._rows))))

    @property
    def launched_W(self) -> float:
        """Flux that the sources launch, W."""
        return self.trace.energy.launched_W

    @property
    def pupil_W(self) -> float:
        """Flux that counts as launched, W, see `mistray.trace.result.Trace.pupil_W`."""
        return self.trace.pupil_W

    @property
    def field_deg(self) -> float:
        """Field angle at which the scene was traced, degrees."""
        return float(self.trace.settings["field_deg"])

    @property
    def seconds(self) -> float:
        """Time that the trace took, s."""
        return self.trace.seconds

    def first_light(self) -> dict[str, FirstLight]:
        """Return the detected light, W, sorted by the first surface it meets, under a key such as "field 5 deg"."""
        return {f"field {self.field_deg:g} deg": FirstLight.of_trace(self.trace)}

    @property
    def _pixel_area(self) -> float:
        """Area of a pixel of the detector, mm²."""
        return self.trace.runs[0].pixel_area

    # ---- numbers

    def power(self, selection: Selection) -> mi.Float64:
        """
        Return the power that the detector absorbs from some paths together, W; 0 if they carry no light.

        Parameters
        ----------
        selection : str, sequence of str or callable
            Paths to add. Possible strings are a `kind` of the path table ("direct", "ghost", "structure", …), "stray"
            (all but "direct"), "all", a path by its `label` ("L1_rear -> L1_front") or all its `events`, and a filter
            ("G(L1*) & !S", see `mistray.trace.path_filter`). Randomly scattered and aimed light on one way counts as
            one path. Several strings, or a function of a `PathRow`, are possible, too.

        Raises
        ------
        MistrayError
            If a string matches no possible path of this scene, or the selection is empty.
        """
        return self._sums_of([self.chosen(selection)])[0]

    def moments(self, selection: Selection) -> Moments:
        """
        Return power (W), centroid and RMS radius (mm) of the light of some paths together.

        If they carry no light, `MistrayError` is raised.

        Parameters
        ----------
        selection : str, sequence of str or callable
            Paths, see `power`.
        """
        chosen = self.chosen(selection)
        return self._moments(selection, [chosen] if len(chosen) else [])

    def moments_of_each(self, selection: Selection) -> Moments:
        """
        Return power (W), centroid and RMS radius (mm) of each of some paths, in arrays.

        For `selection` see `power`. A path combines all wavelengths of its event list, and randomly scattered and aimed
        light. Paths of less than `FEWEST_RAYS` rays are left out, because the RMS radius of a few rays is too small too
        often.

        Raises
        ------
        MistrayError
            If no path is left, or one of them carries no light.
        """
        chosen = self.chosen(selection)
        groups: dict[tuple[str, str], list[int]] = {}
        for k in chosen.tolist():
            groups.setdefault((self._rows[k].source, self._ways[k]), []).append(k)
        sampled = [group for group in groups.values() if sum(self._rows[k].rays for k in group) >= FEWEST_RAYS]
        if groups and not sampled:
            raise MistrayError(
                f"paths {named(selection)}: none has {FEWEST_RAYS} rays at field {self.field_deg:g}°; trace more rays"
            )
        return self._moments(selection, sampled)

    def map(self, selection: Selection) -> mi.Float64:
        """
        Return the irradiance of selected paths together, W/mm², (height · width,), by tracing their rays again.

        Parameters
        ----------
        selection : str, sequence of str or callable
            Paths, see `power`; if they are all paths, nothing is traced again.
        """
        return self._map(tuple(self.chosen(selection).tolist()))

    def _map(self, chosen: tuple[int, ...]) -> mi.Float64:
        """Return the irradiance of chosen rows of the path table together, W/mm², (height · width,)."""
        if chosen not in self._maps:
            if len(chosen) == len(self._rows):
                found = self.trace.light
            else:
                with dr.suspend_grad():
                    (found,) = self.trace.each_map([[self._rows[k].path_id for k in chosen]], [True])
            self._maps[chosen] = leaf(found.value), found
        return self._maps[chosen][0]

    def peak(self, selection: Selection = ALL, norm: float = NORM) -> mi.Float64:
        """
        Return the smooth maximum of the irradiance of some paths over the pixels, W/mm², see `smooth_maximum`.

        `selection` is as for `power`, by default all light, and `norm` the exponent p. Like the brightest of noisy
        pixels, the result is too high by about the standard error of that pixel. Raise `MistrayError` as `power` and
        `smooth_maximum` do.
        """
        return smooth_maximum(self.map(selection), norm)

    def chosen(self, selection: Selection) -> np.ndarray:
        """
        Return the row indices of selected paths in the path table, (n,), ascending.

        See `power` for selections and errors.
        """
        if callable(selection):
            return np.array([k for k, row in enumerate(self._rows) if selection(row)], dtype=np.int64)
        held = [own.ids for text in texts_of(selection) for own in self.trace.paths.chosen(PathFilter(text))]
        return np.unique(np.concatenate(held))

    @cached_property
    def _ways(self) -> np.ndarray:
        """Event list of each path, (p,) strings, in which aimed scatter is written as random scatter."""
        return np.array(way_text(row.events for row in self._rows), dtype=object)

    def _sums_of(self, groups: Sequence[Sequence[int] | np.ndarray]) -> tuple[mi.Float64, ...]:
        """Return sums of flux (W) and moments by x, y (W mm) and x² + y² (W mm²), (groups,) each, by group of rows."""
        key = tuple(tuple(int(k) for k in group) for group in groups)
        if key not in self._sums:
            totals = [self._moments_of_rows[list(group)].sum(axis=0) for group in key]
            self._sums[key] = tuple(leaf(column) for column in np.array(totals).T)
        return self._sums[key]

    def _moments(self, selection: Selection, groups: Sequence[Sequence[int] | np.ndarray]) -> Moments:
        """
        Return power, centroid and variance of the light in each of `groups`, indices of rows of the path table.

        Raise `MistrayError` if a group is dark or there is none; the message names `selection`.
        """
        light = [self._moments_of_rows[list(group), 0].sum() for group in groups]
        if not light or not np.all(np.array(light) > 0):
            raise MistrayError(
                f"paths {named(selection)}: no light goes there at field {self.field_deg:g}°, so that it has no "
                "centroid and no radius; choose other paths or fields, or trace more rays"
            )
        power, x, y, square = self._sums_of(groups)
        x, y = x / power, y / power
        return Moments(power, x, y, dr.maximum(square / power - x * x - y * y, 0))

    # ---- derivatives, after dr.backward of a value

    def hit_derivative(self) -> HitDerivative:
        """
        Return the derivative of the metric's value with respect to the flux of a hit, in the metric's unit per W.

        It depends on the hit's path and position. A part on which the metric does not depend is None.
        """
        by_sum = self._by_sum()
        path = by_sum @ TERM_COEFFICIENTS if np.any(by_sum) else None
        images = [
            (np.array(chosen, dtype=np.int64), self._by_pixel(image)) for chosen, (image, _) in self._maps.items()
        ]
        images = [(chosen, by_pixel) for chosen, by_pixel in images if np.any(by_pixel)]
        if not images:
            return HitDerivative(None, path)
        # Paths that contribute to the same images share a map of derivatives, the sum of those of the images
        counts = np.zeros((len(self._rows), len(images)), dtype=bool)
        for number, (chosen, _) in enumerate(images):
            counts[chosen, number] = True
        if counts.all():
            return HitDerivative(np.sum([by_pixel for _, by_pixel in images], axis=0)[None], path)
        classes, place = np.unique(counts, axis=0, return_inverse=True)
        pixel = np.einsum("ci,ihw->chw", classes.astype(np.float64), [by_pixel for _, by_pixel in images])
        dark = ~classes.any(axis=1)
        map_of_class = np.where(dark, -1, np.cumsum(~dark) - 1)
        return HitDerivative(pixel[~dark], path, map_of_path=map_of_class[place.ravel()])

    def table_gradients(self, request: GradientRequest) -> Iterator[TableGradient]:
        """
        Yield the requested derivatives of the metric's value, for each source and wavelength that contributes.

        There are none if the value does not depend on this trace. Errors are those of `Trace.table_gradients`.
        """
        derivative = self.hit_derivative()
        if derivative.pixel is None and derivative.path is None:
            return iter(())
        return self.trace.table_gradients(derivative, request)

    def noise(self) -> Sampled:
        """
        Return the noise by batch, in its unit, of the metric whose derivatives `dr.backward` has left here.

        It is to first order in the detected light; without derivatives it is 0. The estimate's own value is the sum of
        flux times derivative: the metric itself only if that grows in proportion to the flux.
        """
        by_sum = self._by_sum()
        by_batch = self.trace.paths.by_batch(by_sum) if np.any(by_sum) else np.zeros(BATCHES)
        total = Sampled.of(by_batch, np.ones(BATCHES))
        for image, found in self._maps.values():
            by_pixel = self._by_pixel(image)
            if np.any(by_pixel):
                batches = self._pixel_area * np.einsum("yx,yxb->b", by_pixel, found.by_batch)
                total = total + Sampled.of(batches, np.ones(len(batches)))
        return total

    def clear(self) -> None:
        """Set to zero the derivatives that an earlier evaluation of a metric has left."""
        sums = (term for terms in self._sums.values() for term in terms)
        for array in (*sums, *(image for image, _ in self._maps.values())):
            dr.clear_grad(array)

    def _by_sum(self) -> np.ndarray:
        """
        Return derivatives of the metric with respect to the sums of each path, (paths, TERMS).

        The sums are in W, W mm and W mm².
        """
        total = np.zeros((len(self._rows), TERMS))
        for groups, terms in self._sums.items():
            by_group = np.stack([np.broadcast_to(np.array(dr.grad(term)), len(groups)) for term in terms], axis=1)
            for group, derivative in zip(groups, by_group, strict=True):
                total[list(group)] += derivative
        return total

    def _by_pixel(self, image: mi.Float64) -> np.ndarray:
        """
        Return the derivative of the metric's value with respect to the flux in each pixel, (height, width).

        It is in the metric's unit per W. `image` is the irradiance from which the metric was computed.
        """
        width, height, _ = self.trace.runs[0].table.film()
        by_irradiance = np.broadcast_to(np.array(dr.grad(image)), height * width).reshape(height, width)
        return np.asarray(by_irradiance / self._pixel_area)


def texts_of(selection: Selection) -> list[str]:
    """
    Return the strings in a selection of paths as a list, which is empty for a function.

    Raise `MistrayError` for an empty list or an entry that is not a string.
    """
    if callable(selection):
        return []
    texts = several(selection)
    if not texts or not all(isinstance(text, str) and text.strip() for text in texts):
        raise MistrayError(f"the selection of paths is {shown(selection)}; give one or more of {', '.join(KINDS)}")
    return texts


def named(selection: Selection) -> str:
    """Return the name of a selection of paths for messages: its string or list, or its function's name."""
    return repr(getattr(selection, "__name__", selection))


def leaf(values: np.ndarray) -> mi.Float64:
    """
    Return values as a Dr.Jit array with respect to which derivatives are computed.

    Each selection of a trace gets a leaf of its own. Dr.Jit 1.5 loses derivatives if a value gathered from several
    gathers of one leaf is gathered once more.
    """
    array = upload(mi.Float64, values)
    with dr.resume_grad():
        dr.enable_grad(array)
    return array


def smooth_maximum(values: Any, norm: float = NORM) -> mi.Float64:
    """
    Return the p-norm (Σ v^p)^(1/p) of values v ≥ 0: at least their maximum, and n^(1/p) times it for n equal values.

    Parameters
    ----------
    values : mi.Float64
        Values v ≥ 0; if all are 0, so are the result and its derivatives.
    norm : float
        Exponent p ≥ 1. A larger one is nearer to the maximum, and more of the derivative belongs to one value. 1 gives
        the sum.

    Raises
    ------
    MistrayError
        If `norm` is below 1.

    Examples
    --------
    >>> import mitsuba as mi
    >>> for norm in 1, 2, 16:
    ...     print(f"{norm}: {mistray.optimize.smooth_maximum(mi.Float64(1, 2, 3), norm)[0]:.2f}")
    1: 6.00
    2: 3.74
    16: 3.00
    """
    NORMS.check("norm", norm)
    largest = dr.max(dr.detach(values))
    if not float(largest[0]) > 0:
        return dr.sum(values) * dr.opaque(mi.Float64, 0)  # a dark map: 0 with the derivative 0
    # v^p as exp(p ln v), of numbers far from the limits of the exponent; a 0 counts as 1e-30 of the largest
    powers = dr.exp(float(norm) * dr.log(dr.maximum(values / largest, 1e-30)))
    return largest * dr.exp(dr.log(dr.sum(powers)) / float(norm))


def smooth_minimum(values: Any, norm: float = NORM) -> mi.Float64:
    """
    Return the smooth minimum (Σ v^-p)^(-1/p) of values v ≥ 0, with p = `norm`: at most their minimum.

    If one of them is 0, so are the result and its derivatives. Raise `MistrayError` if `norm` is below 1.

    Examples
    --------
    >>> import mitsuba as mi
    >>> print(f"{mistray.optimize.smooth_minimum(mi.Float64(1, 2, 3))[0]:.4f}")
    1.0000
    """
    NORMS.check("norm", norm)
    if float(dr.min(dr.detach(values))[0]) == 0:
        return dr.sum(values) * dr.opaque(mi.Float64, 0)
    return 1 / smooth_maximum(1 / values, norm)

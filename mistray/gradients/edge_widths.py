"""
Choice of the width of the zones along rims: of several widths that use the same hits, the one of least error.

A wide zone has little noise and much bias, a narrow one little bias and much noise. The difference of two widths shows
the bias of the wider one. The boundary kernel of a width has the least variance of all kernels within it that are exact
for a linear density (J. Fan and I. Gijbels, Local Polynomial Modelling and Its Applications, 1996, section 3.2). So the
difference is not correlated with the derivative of the wider one (J. A. Hausman, Econometrica 46, 1251, 1978), and a
choice by the difference is not a choice by the noise of the derivative that is kept.

One width serves all parameters: moves that do nothing together, such as those of all faces of a body along themselves,
still cancel. If the rays of a trace choose the width, its zones and those of half the width then use further rays, up
to `MOST_SAMPLES` times as many.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mistray.recorders.sampled import batch_error
from mistray.settings import BATCHES
from mistray.surfaces.surfaces import SurfaceTable

# Widths that are compared, in units of a rim's radius; the last one only serves to estimate the bias of the others
AUTOMATIC = tuple(0.05 * 0.5**k for k in range(5))
EQUAL = np.ones(BATCHES)  # runs of several fields and wavelengths are added batch by batch; each splits its rays evenly
MOST_SAMPLES = 3  # of further rays: more would take longer than the search for the width
CERTAIN = 3  # standard errors beyond which a difference is significant although several widths are compared
REMAINING = 4 / 3  # bias of a width over its difference from half the width, if the bias goes with its square


def widths_of(edge_width: float | None) -> tuple[float, ...]:
    """
    Return the widths of the boundary zones along rims, as fractions of a rim's radius, the widest first.

    They are `edge_width` and half of it; if it is None, those that the automatic choice compares.
    """
    return AUTOMATIC if edge_width is None else (edge_width, 0.5 * edge_width)


def rim_zones(
    table: SurfaceTable, width: float, limits: Mapping[tuple[int, int], float] | None = None
) -> dict[tuple[int, int], float]:
    """
    Return the widths of the boundary zones along all rims, mm, by surface and place in `RIM_COLUMNS`.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    width : float
        Width in units of the rim's radius or half side.
    limits : mapping, optional
        Upper limits of the widths of some zones, mm.
    """
    limits = limits or {}
    return {
        (piece.index, rim): min(zone, limits.get((piece.index, rim), np.inf))
        for piece in table.pieces
        for rim, zone in piece.zone_widths(width).items()
    }


@dataclass(frozen=True)
class WidthErrors:
    """
    Estimated noise and bias of derivatives of a metric, for each zone width but the narrowest.

    All are in the unit of the derivatives.

    Attributes
    ----------
    noise : (w - 1, n) float64
        Standard errors of the derivatives.
    check, check_se : (w - 1, n) float64
        Derivative with the next narrower width less that with this one, and the standard error of this difference.
    bias : (w - 1, n) float64
        Bias of the width, with its probable sign: -`REMAINING` times `check`. Its magnitude is no less than the noise
        of `check`, nor than the differences from still narrower zones less `CERTAIN` standard errors.
    """

    noise: np.ndarray
    check: np.ndarray
    check_se: np.ndarray
    bias: np.ndarray

    @classmethod
    def of(cls, sums: np.ndarray) -> WidthErrors:
        """
        Return noise and bias of derivatives, from the spread of batches and the differences between zone widths.

        Parameters
        ----------
        sums : (w, BATCHES, n) float64
            Derivatives for each width, the widest first, by batch; their sums are the derivatives.
        """
        last = len(sums) - 1

        def error(by_batch: np.ndarray) -> np.ndarray:
            return np.asarray(batch_error(np.moveaxis(by_batch, -2, -1), EQUAL))

        # A narrower zone has no less noise; where few rays hit it, it only seems so
        noise = np.maximum.accumulate(error(sums), axis=0)[:last]
        # Bias: from the next width, and from all narrower ones where the difference is significant
        check = (sums[1:] - sums[:-1]).sum(axis=1)
        check_se = np.maximum.accumulate(error(sums[1:] - sums[:-1]), axis=0)
        bias = np.maximum(REMAINING * np.abs(check), check_se)
        for k in range(last - 1):
            apart = sums[k + 2 :] - sums[k]
            certain = np.abs(apart.sum(axis=1)) - CERTAIN * np.maximum(error(apart), check_se[k])
            bias[k] = np.maximum(bias[k], certain.max(axis=0))
        return cls(noise, check, check_se, np.where(check < 0, bias, -bias))

    def total(self, times: np.ndarray | float = 1.0) -> np.ndarray:
        """
        Return the total error of each derivative, noise and bias combined, (w - 1, n), in the derivative's unit.

        `times`, (w - 1, 1), is the number of rays that each width will use, relative to the traced one.
        """
        floor = self.check_se / np.sqrt(times)
        seen = np.where(np.abs(self.bias) > self.check_se, np.abs(self.bias), 0.0)
        return np.asarray(np.hypot(self.noise / np.sqrt(times), np.maximum(seen, floor)))


def further_samples(number: int) -> int:
    """
    Return how many more ray samples a zone halved `number` times needs for as many hits as the widest zone has.

    It is at most `MOST_SAMPLES`. Each sample has as many rays as the trace.
    """
    return min(2**number - 1, MOST_SAMPLES)


def least_error(derivatives: Iterable[np.ndarray], more: bool = False) -> int:
    """
    Return the index of the zone width with the least total error, by the geometric mean over derivatives.

    Derivatives without an error do not count; if there are no derivatives at all, the index is 0, that of the widest.

    Parameters
    ----------
    derivatives : iterable of (w, BATCHES, n) float64
        Derivatives with respect to some parameters, see `WidthErrors.of`.
    more : bool
        Whether the zones of the chosen width will use further samples of rays, see `further_samples`: the noise is then
        that of all of them.
    """
    found = [WidthErrors.of(sums) for sums in derivatives]
    if not found:
        return 0
    rays = np.array([1 + further_samples(k) if more else 1 for k in range(len(found[0].noise))])
    totals = [errors.total(rays[:, None]) for errors in found]
    every = np.concatenate(totals, axis=1)
    return int(np.argmin(np.log(every[:, np.all(every > 0, axis=0)]).sum(axis=1)))

"""Point source transmittance as input of metrics: its cells as values that Dr.Jit can differentiate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.analyses.pst.glare.extended_source import ExtendedSource, SkyRadiance, cover
from mistray.analyses.pst.glare.glare import glare_cells
from mistray.analyses.pst.metrics.first_light import first_light
from mistray.analyses.pst.request import CONVENTIONS
from mistray.analyses.pst.result import GROUPS, LIGHT, Pst
from mistray.errors import MistrayError, nearest
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.known_arguments import known_arguments
from mistray.metrics.changes.first_surfaces import FirstLight
from mistray.metrics.observation import leaf
from mistray.ranges import Words, several
from mistray.recorders.direction_recorder import CLASSES
from mistray.recorders.sampled import Sampled
from mistray.surfaces.upload import upload

Light = str | Sequence[str]
CONVENTION, QUANTITY, PLACE = Words(CONVENTIONS), Words(("mean", "integral")), Words(("mean", "point"))


class PstObservation:
    """
    Computed point source transmittance (PST), with cells that Dr.Jit can differentiate.

    Light is one of `mistray.analyses.pst.result.CLASSES` ("direct", "straight_shot", "ghost", "single_scatter",
    "multiple_scatter", "edge_diffraction"), "stray" (all but "direct"), "total", or a sequence of classes.

    Parameters
    ----------
    result : Pst
        PST in either convention; derivatives need one that was not computed with ``method="forward"``.

    Attributes
    ----------
    pst : Pst
        The PST itself in the convention "normal", not differentiable.

    Examples
    --------
    >>> pst = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> found = mistray.optimize.PstObservation(pst)
    >>> print(f"{found.value_at(10, light='ghost')[0]:.1e}")
    4.8e-05
    """

    resamples = False
    """Whether other rays can be traced for it alone, see `GradientRequest.edge_samples`."""

    def __init__(self, result: Pst) -> None:
        self.pst = result.to("normal")
        self._values = np.sum(self.pst.weight * self.pst.by_batch, axis=-1)
        self._cells: dict[tuple[str, ...], mi.Float64] = {}

    @property
    def seconds(self) -> float:
        """Time that the trace of this PST took, s."""
        return float(self.pst.facts["seconds"])

    def first_light(self) -> dict[str, FirstLight]:
        """Return the light by the first surface that it meets, for each field angle by name; empty without paths."""
        return {f"PST at {angle:g} deg": first_light(self.pst, k) for k, angle in enumerate(self.pst.field_deg)}

    # ---- numbers

    def cells(self, light: Light = "stray", convention: str = "normal") -> mi.Float64:
        """
        Return the PST of every cell, (n · m,), by field angle, then by azimuth, differentiable.

        Parameters
        ----------
        light : str or sequence of str
            Classes of light.
        convention : {"normal", "projected"}
            See `Pst`.
        """
        CONVENTION.check("convention", convention)
        classes = named_classes(light)
        if classes not in self._cells:
            self._cells[classes] = leaf(self._values[[CLASSES.index(name) for name in classes]].sum(axis=0))
        if convention == "projected":
            cosine = np.repeat(self.pst.grid.mean_cosine, self.pst.grid.shape[1])
            return self._cells[classes] / upload(mi.Float64, cosine)
        return self._cells[classes]

    def weighted(self, coefficients: np.ndarray, light: Light = "stray") -> mi.Float64:
        """Return the sum over the cells of coefficients, (n, m), times PST_normal of `light`, differentiable."""
        return dr.sum(self.cells(light) * upload(mi.Float64, np.asarray(coefficients, dtype=np.float64)))

    @known_arguments
    def value_at(
        self, field_deg: float, light: Light = "stray", azimuth_deg: float | None = None, convention: str = "normal"
    ) -> mi.Float64:
        """
        Return the PST of the cell that contains a field angle, differentiable.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees; a negative one is at the opposite azimuth.
        light : str or sequence of str
            Classes of light.
        azimuth_deg : float, optional
            Azimuth, degrees; by default the mean over the azimuths.
        convention : {"normal", "projected"}
            See `Pst`.

        Raises
        ------
        MistrayError
            If no cell contains the direction.
        """
        CONVENTION.check("convention", convention)
        grid = self.pst.grid
        if azimuth_deg is None:
            i, j = grid.nearest(abs(field_deg), float(grid.azimuths_deg[0]))
        else:
            i, j = grid.nearest(field_deg, azimuth_deg)
        weights = np.zeros(grid.shape)
        weights[i, slice(None) if azimuth_deg is None else j] = 1 / (grid.shape[1] if azimuth_deg is None else 1)
        return self.weighted(weights / grid.mean_cosine[i] if convention == "projected" else weights, light)

    def curve(self, light: Light = "stray", convention: str = "normal") -> mi.Float64:
        """
        Return the PST at each field angle, averaged over azimuths, (n,), differentiable.

        `light` and `convention` are those of `cells`.
        """
        m = self.pst.grid.shape[1]
        return dr.block_sum(self.cells(light, convention), m) / m

    def band(
        self,
        low_deg: float,
        high_deg: float,
        light: Light = "stray",
        quantity: str = "integral",
        convention: str = "normal",
        interpolation: str = "cells",
    ) -> mi.Float64:
        """
        Return the PST over a band of field angles: ∫ PST_normal dΩ = ∫ PST_projected cos θ dΩ, or the mean.

        Parameters
        ----------
        low_deg, high_deg : float
            Ends of the band, 0 … 90 degrees.
        light : str or sequence of str
            Classes of light.
        quantity : {"integral", "mean"}
            "integral", sr: irradiance on the detector from a sky of radiance 1 W/(mm² sr) that fills the band.
            "mean": that divided by ∫ dΩ ("normal") or ∫ cos θ dΩ ("projected") over the part of the band within cells.
        convention : {"normal", "projected"}
            Convention of the mean; the integral is the same in both.
        interpolation : {"cells", "linear", "log"}
            PST between cells, see `mistray.analyses.pst.glare.extended_source.cover`; with "cells" it is 0 in
            the integral and left out of the mean.

        Raises
        ------
        MistrayError
            If no cell contains any of the band.
        """
        QUANTITY.check("quantity", quantity)
        CONVENTION.check("convention", convention)
        value = self.weighted(self.seen(SkyRadiance(1.0, low_deg, high_deg), light, interpolation), light)
        if quantity == "integral":
            return value
        grid = self.pst.grid
        parts = grid.edges_deg
        if interpolation != "cells":  # no gaps
            parts = np.array([[parts[0, 0], parts[-1, 1]]])
        cosine = np.cos(np.radians(np.clip(parts, low_deg, high_deg)))
        around = grid.shape[1] * np.radians(grid.azimuth_cell_deg)
        held = -np.diff(0.5 * cosine**2 if convention == "projected" else cosine).sum()
        return value / float(around * held)

    def seen(self, source: ExtendedSource, light: Light, interpolation: str = "cells") -> np.ndarray:
        """
        Return the factor of PST_normal of each cell in the irradiance from an extended source, (n, m), W/mm².

        It is the derivative of that irradiance. The integral is homogeneous of degree 1 in the PST, so that the sum of
        the factors times the PST is the integral itself.
        """
        curve = None
        if interpolation == "log":
            curve = self._values[[CLASSES.index(name) for name in named_classes(light)]].sum(axis=0)
        return cover(self.pst.grid, source, interpolation, curve).coefficients

    @known_arguments
    def veiling_glare_index(
        self,
        patch_deg: float,
        field_deg: float = 0.0,
        azimuth_deg: float = 0.0,
        *,
        source_deg: float = 90.0,
        place: str = "mean",
        interpolation: str = "cells",
    ) -> mi.Float64:
        """
        Return the veiling glare index, percent: 100 E_black / E_white (ISO 9358).

        Parameters
        ----------
        patch_deg, field_deg, azimuth_deg, source_deg, interpolation
            Arguments of `mistray.analyses.pst.glare.glare.veiling_glare_index`.
        place : {"mean", "point"}
            See `veiling_glare_index` there.

        Raises
        ------
        MistrayError
            If the detector gets no light from the white source.
        """
        PLACE.check("place", place)
        black, white, light = glare_cells(
            self.pst,
            patch_deg,
            field_deg,
            azimuth_deg,
            source_deg=source_deg,
            place=place,
            interpolation=interpolation,
        )
        below = self.weighted(white.coefficients, "total")
        if not float(dr.detach(below)[0]) > 0:
            raise MistrayError("veiling glare: no light of the white source meets the detector; take more rays")
        return 100 * self.weighted(black, light) / below

    # ---- derivatives, after dr.backward of a value

    @property
    def derivative(self) -> np.ndarray:
        """Derivative of the metric with respect to PST_normal by class of light and cell, (classes, n, m)."""
        total = np.zeros_like(self._values)
        for classes, cells in self._cells.items():
            by_cell = np.broadcast_to(np.array(dr.grad(cells)), self._values[0].size).reshape(self._values[0].shape)
            total[[CLASSES.index(name) for name in classes]] += by_cell
        return total

    def table_gradients(self, request: GradientRequest) -> Iterator[TableGradient]:
        """
        Yield the gradients of the metric with respect to the tracer's parameter tables, for each relevant wavelength.

        There are none if the metric does not depend on the PST.
        """
        derivative = self.derivative
        if not np.any(derivative):
            return iter(())
        return self.pst.table_gradients(derivative, request)

    def noise(self) -> Sampled:
        """Return the metric, linearised in the PST, with its noise from the spread of the batches of start rays."""
        parts = np.tensordot(self.derivative, self.pst.by_batch, axes=3) * self.pst.weight
        return Sampled.of(parts, self.pst.weight)

    def clear(self) -> None:
        """Set to zero the derivatives with respect to PST cells that an earlier metric has left."""
        for cells in self._cells.values():
            dr.clear_grad(cells)


def named_classes(light: Light) -> tuple[str, ...]:
    """Return the classes of light that one or several names stand for; raise `MistrayError` for an unknown name."""
    names = several(light)
    if not names:
        raise MistrayError(f"no light is chosen; use {', '.join(LIGHT)}")
    for name in names:
        if name not in LIGHT:
            raise MistrayError(f"light '{name}' does not exist; {nearest(str(name), LIGHT)}")
    return tuple(dict.fromkeys(part for name in names for part in GROUPS.get(name, (name,))))

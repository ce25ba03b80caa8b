"""Plugin `ray_file`: rays in a file as a source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.files.ray_sets import RaySet, read_ray_set
from mistray.param import documented, fixed, take
from mistray.plugins.emitters.light_source import LIGHT, LightSource
from mistray.ranges import POSITIVE, TEXT
from mistray.sampling.source import SceneSource, SourceRequest
from mistray.surfaces.upload import upload

MOST_LINES = 32  # wavelengths that are traced separately; more are combined


@documented
class RayFile(LightSource):
    r"""
    Rays of a file (:monosp:`ray_file`): a measured lamp, light of another program, or rays of a trace.

    CSV and Parquet files have the columns x_mm, y_mm, z_mm (or in m, cm, um, in, ft), dx, dy, dz, flux_W and optionally
    wavelength_nm. A table of `Trace.rays` has them, and `mistray.files.ray_sets.save_ray_set` writes such files. Zemax
    source files (.dat, binary or text) and IES TM-25 files (.tm25ray) are read, too. Rays are drawn in proportion to
    their flux, so that all traced rays carry the same flux.

    .. parameters::

    Each wavelength of the file is traced separately; if there are more than 32, near ones are combined. One with a
    sixteenth of the flux or more is never combined. With ``wavelength_nm`` in a call all rays have that wavelength.
    Mitsuba's own integrators get no light from it.

    .. code-block:: xml

        <emitter type="ray_file">
            <string name="filename" value="lamp.csv"/>
        </emitter>

    .. code-block:: python

        {"type": "ray_file", "filename": "lamp.csv", "power": 2.0}
    """

    properties = {
        "filename": fixed("string", TEXT, ".csv, .parquet, .dat or .tm25ray", within="a file"),
        "unit": fixed("string", TEXT, "unit of positions, if a text .dat has none", None, within="m, cm, mm, in, ft"),
        "power": fixed(
            "W", POSITIVE, "flux of all rays, instead of that in the file; needed for a file in lumens", None
        ),
        **LIGHT,
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        file = str(mi.file_resolver().resolve(take(self, props, "filename")))
        power = take(self, props, "power")
        self.rays_of_file: RaySet = read_ray_set(file, take(self, props, "unit"), power)
        self.given = float(self.rays_of_file.flux_W.sum()) if power is None else power
        known = ~np.isnan(self.rays_of_file.wavelength_nm)
        if known.any() and not known.all():
            self._fail(f"filename '{file}' has wavelengths for some rays only; give all or none")
        self._lines: list[np.ndarray] = []
        if known.all():
            if given := [key for key in ("wavelength_nm", "weights", "spectrum") if key in props]:
                self._fail(f"{given[0]} is given, and the file has wavelengths; leave it out")
            self._take_lines()
            self.states_light = True

    def _take_lines(self) -> None:
        """Group the rays of the file by wavelength; near wavelengths are combined if more than `MOST_LINES`."""
        wavelength, flux = self.rays_of_file.wavelength_nm, self.rays_of_file.flux_W
        lit = np.flatnonzero(flux > 0)
        _, line = np.unique(wavelength[lit], return_inverse=True)
        sums = np.bincount(line, flux[lit])
        if len(sums) > MOST_LINES:
            # By the middle of a wavelength's share: a strong wavelength is neither divided nor combined with others
            share = (np.cumsum(sums) - 0.5 * sums) / sums.sum()
            line = np.minimum(share * MOST_LINES, MOST_LINES - 1).astype(np.int64)[line]
        self._lines = [lit[line == k] for k in np.unique(line)]
        sums = np.array([flux[rays].sum() for rays in self._lines])
        means = [np.average(wavelength[rays], weights=flux[rays]) for rays in self._lines]
        # A single wavelength is kept exactly, without the rounding of a mean
        single = [np.ptp(wavelength[rays]) == 0 for rays in self._lines]
        self.wavelengths_nm = np.where(single, [wavelength[rays[0]] for rays in self._lines], means)
        self.weights = sums / sums.sum()

    def power(self, field_deg: float | None = None) -> float:
        """Return the total flux of the file's rays, W."""
        return self.given

    def sources(self, request: SourceRequest) -> Sequence[SceneSource]:
        """Return the sources that a trace starts, one for each wavelength."""
        own = len(self._lines) and np.array_equal(request.wavelengths_nm, self.wavelengths_nm)
        every = np.flatnonzero(self.rays_of_file.flux_W > 0)
        chosen = self._lines if own else [every] * len(request.wavelengths_nm)
        return [
            replace(source, emitter=_Rays(self, rays))
            for source, rays in zip(super().sources(request), chosen, strict=True)
        ]


class _Rays:
    """Subset of a file's rays, with the methods that a trace needs of a source."""

    extended: ClassVar[bool] = False
    precise: ClassVar[bool] = True
    differentiable: ClassVar[tuple[str, ...]] = ()

    def __init__(self, owner: RayFile, chosen: np.ndarray) -> None:
        rays = owner.rays_of_file
        self.values: Mapping[str, float] = {}
        self.polarized, self.stokes = owner.polarized, owner.stokes
        flux = rays.flux_W[chosen]
        ends = np.cumsum(flux) / flux.sum()
        ends[-1] = 2.0  # the last ray, rounding or not
        self._count = len(chosen)
        self._ends = upload(mi.Float64, ends)
        self._rows = [upload(mi.Float64, column[chosen]) for column in (*rays.origins.T, *rays.directions.T)]

    def rays_from(
        self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32, n: Mapping[str, Any]
    ) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Return origins, mm, and directions of rays drawn at the fractions `sample.x` of the cumulative flux."""
        # The other coordinate gives digits that a float32 lacks: a file may have more rays than float32 numbers
        u = dr.fma(sample.y - 0.5, 2.0**-24, sample.x)
        k = dr.binary_search(0, self._count - 1, lambda i: dr.gather(mi.Float64, self._ends, i) <= u)
        x, y, z, dx, dy, dz = (dr.gather(mi.Float64, row, k) for row in self._rows)
        return mi.Vector3d(x, y, z), mi.Vector3d(dx, dy, dz)


mi.register_emitter("ray_file", lambda props: RayFile(props))

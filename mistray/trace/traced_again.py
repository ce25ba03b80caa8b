"""Maps, rays and tables of paths that a trace gives by tracing its rays again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mistray.execute.scene_task import SceneTask
from mistray.execute.tracer import Run
from mistray.ranges import RAYS_LISTED, TEXT, Several
from mistray.recorders.film import Pixels
from mistray.recorders.flux_maps.surface_maps import AZIMUTHS, LENGTHS, SurfaceMap, SurfaceMaps
from mistray.trace.elsewhere import light_maps, rays_elsewhere
from mistray.trace.history import Ray, RayHistory, path_history, sample_rays
from mistray.trace.path_filter import PathFilter
from mistray.trace.path_images import PathGroups, path_images
from mistray.trace.paths import PathTable, path_table
from mistray.trace.ray_table import check_box, ray_table
from mistray.trace.sampled_hits import LightCone, SampledHits, light_cones, sampled_hits

if TYPE_CHECKING:
    import pandas as pd


class TracedAgain:
    """
    Base class of `mistray.trace.Trace`: methods that trace the same rays again, for what the first pass did not keep.

    Attributes
    ----------
    runs : list of Run
        Runs of the trace, one for each source and wavelength.
    task : SceneTask or None
        Scene for workers that trace a part of the rays; None: this process traces.
    """

    runs: list[Run]
    task: SceneTask | None

    @property
    def paths(self) -> PathTable:
        """Paths from the sources to the detectors, which a subclass returns."""
        raise NotImplementedError

    def irradiance_of(self, path_ids: int | Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the irradiance (W/mm²) that some paths together cause, by tracing the same rays again.

        Parameters
        ----------
        path_ids : int or sequence of int
            Ids of paths in the path table.

        Returns
        -------
        irradiance, standard_error : (height, width) float64
            Irradiance of each pixel and its standard error, W/mm².

        Raises
        ------
        MistrayError
            If there is no such path, or the trace has no path table or several detectors.
        """
        return self.maps([path_ids])[0]

    def surface_maps(
        self,
        surfaces: str | Sequence[str] = (),
        selections: str | Sequence[str] = "all",
        *,
        azimuths: int = AZIMUTHS,
        lengths: int = LENGTHS,
    ) -> list[dict[str, SurfaceMap]]:
        """
        Return maps of the incident and absorbed flux, W, of selected light on surfaces, by tracing the same rays again.

        Parameters
        ----------
        surfaces, azimuths, lengths
            See `mistray.recorders.SurfaceMaps`.
        selections : str or sequence of str
            Kinds, names or filters, see `mistray.trace.path_filter`; they may compare the columns of `rays_at`. Light
            may be in several of them.

        Returns
        -------
        list of dict
            Maps by the ids of their surfaces, for each selection.

        Raises
        ------
        MistrayError
            If a number is out of range, a name does not exist, no surface can be unrolled, or a filter is not valid or
            compares another column.
        UnfinishedError
            If the time is up before all rays are traced.
        """
        filters = [PathFilter(text) for text in Several(TEXT, least=0).check("selections", selections)]
        return light_maps(self.runs, SurfaceMaps("maps", surfaces, azimuths, lengths), filters)

    def maps(self, groups: PathGroups) -> list[tuple[np.ndarray, np.ndarray]]:
        """
        Return an irradiance map for each of several disjoint groups of paths, by tracing the same rays once more.

        Parameters
        ----------
        groups : int or sequence of int or of sequences of int
            Path ids; a path may be in one group only.

        Returns
        -------
        list of (irradiance, standard_error)
            One pair of (height, width) float64 for each group, W/mm².

        Raises
        ------
        MistrayError
            If there is no such path, a path is in two groups, or the trace has no path table or several detectors.
        """
        return [found.with_se for found in self.each_map(groups, True)]

    def each_map(self, groups: PathGroups, with_noise: bool | Sequence[bool]) -> Iterator[Pixels]:
        """
        Yield the irradiance maps of disjoint groups of paths one by one, by tracing the same rays once more.

        Parameters
        ----------
        groups : int or sequence of int or of sequences of int
            Path ids; a path may be in one group only.
        with_noise : bool or sequence of bool
            Whether all maps, or each of them, get their noise, which is NaN otherwise. During the sum a pixel of a map
            takes 8 bytes, with noise 8 bytes for each group of batches (`mistray.recorders.film.groups_of`).

        Yields
        ------
        Pixels
            Irradiance map of a group, (height, width), W/mm².

        Raises
        ------
        MistrayError
            If there is no such path, a path is in two groups, or the trace has no path table or several detectors.
        """
        return path_images(self.paths, self.task, groups, with_noise)

    def box(self, x0: float, x1: float, y0: float, y1: float) -> PathTable:
        """
        Return the table of the paths that feed a rectangle of the detector, by tracing the same rays again.

        Parameters
        ----------
        x0, x1, y0, y1 : float
            Rectangle in the frame of each detector, mm; x0 < x1 and y0 < y1.

        Returns
        -------
        PathTable
            Powers, centroids and radii within the rectangle. The `path_id` are ranks within it.

        Raises
        ------
        MistrayError
            If the rectangle is empty, or the trace has no path table.
        """
        box = check_box((x0, x1, y0, y1))
        return path_table([run.within(box) for run in self.paths.runs])

    def history(self, path_id: int, n: int = 8) -> RayHistory:
        """
        Return rays of a path with hit points (mm), flux (W) and optical path lengths (mm), by tracing them again.

        Parameters
        ----------
        path_id : int
            Id of the path in the path table.
        n : int
            Largest number of rays.

        Raises
        ------
        MistrayError
            If there is no such path, `n` is no whole number from 1, or the trace has no path table.
        """
        return path_history(self.paths, path_id, n)

    def sampled_rays(self, path_ids: int | Sequence[int], n: int = 8) -> dict[int, list[Ray]]:
        """
        Return rays of many paths, found by tracing again a sample of the start rays, spread over the beam.

        `history` looks for rays of one path until it has enough; here a path that is rare has few rays or none.

        Parameters
        ----------
        path_ids : int or sequence of int
            Ids of paths in the path table.
        n : int
            Largest number of rays of each path.

        Returns
        -------
        dict
            Rays by path id; an empty list for a path that no ray of the sample follows. When the time is up the sample
            is smaller.

        Raises
        ------
        MistrayError
            If there is no such path, `n` is no whole number from 1, or the trace has no path table.
        """
        return sample_rays(self.paths, path_ids, n)

    def light_cones(self, path_ids: int | Sequence[int]) -> dict[int, LightCone]:
        """
        Return the cone of directions of each path's light at the detector, by tracing a sample of rays again.

        Parameters
        ----------
        path_ids : int or sequence of int
            Ids of paths in the path table.

        Returns
        -------
        dict
            Light cones by path id; a path that occurs less than twice in the sample is left out.

        Raises
        ------
        MistrayError
            If there is no such path, or the trace has no path table or several detectors.
        """
        return light_cones(self.paths, path_ids)

    def sampled_hits(self, start_rays: int = 640, n: int = 16) -> list[SampledHits]:
        """
        Return points and directions of sampled rays of all paths at their surfaces, by tracing again.

        Parameters
        ----------
        start_rays : int
            Largest number of start rays of each source and wavelength.
        n : int
            Largest number of rays of each path; a rare path has few or none.

        Returns
        -------
        list of SampledHits
            One for each source and wavelength.

        Raises
        ------
        MistrayError
            If a number is not a whole number from 1, or the trace has no path table.
        """
        start_rays, n = RAYS_LISTED.check("start_rays", start_rays), RAYS_LISTED.check("n", n)
        return [sampled_hits(own, start_rays, n) for own in self.paths.located()]

    def rays(
        self,
        selection: str = "",
        *,
        n: int | None = 1000,
        box: Sequence[float] | None = None,
        pixels: Sequence[int] | None = None,
        events: bool = False,
    ) -> pd.DataFrame:
        """
        Return a table of rays that reach the detector, selected by their events, flux and position.

        The same rays are traced again until there are enough. They are spread over the beams of all sources and
        wavelengths; positions are computed again in float64.

        Parameters
        ----------
        selection : str
            A filter as ``"S(barrel*) & relative_flux > 0.01"``, see `mistray.trace.path_filter`; empty: every ray. Its
            columns are those of this table, ``relative_flux`` (`flux_W` over that of the strongest ray of the trace;
            takes one more run) and the attributes of `PathRow` for the ray's path.
        n : int or None
            Largest number of rays; None: all of them.
        box : x0, x1, y0, y1, optional
            Only rays that hit this rectangle of the detector, mm in its own frame; as in `box`.
        pixels : c0, c1, r0, r1, optional
            Only rays that hit these pixels, ``irradiance[r0:r1, c0:c1]``.
        events : bool
            Whether there is one row for each node of each ray instead of one for each ray.

        Returns
        -------
        DataFrame
            ray (number in this table), path_id, kind, wavelength_nm, source, start_ray, node (events of the ray), type
            (the last of them before the detector), history (all of them), flux_W (incident on the detector), x_mm,
            y_mm, z_mm, dx, dy, dz (direction of arrival), opl_mm (from the start), detector_x_mm and detector_y_mm (in
            the detector's frame), column, row (of the pixel). With `events` ray, node, path_id, kind, and columns of
            `RayHistory.to_pandas`.

        Raises
        ------
        MistrayError
            For a filter that cannot be parsed or names something that does not exist, an empty box, pixels out of
            range and an `n` that is no whole number from 1. Also for a trace without a path table or with several
            detectors.
        """
        return ray_table(self.paths, PathFilter(selection), n, box, pixels, events)

    def rays_at(
        self, where: str | Sequence[str], selection: str = "", *, n: int | None = 1000, events: bool = False
    ) -> pd.DataFrame:
        """
        Return a table of rays that arrive at any surface or leave the scene, by tracing them again.

        A row has the last node of a ray, or with `events` one of its nodes. Its columns are those of
        `RayHistory.to_pandas`, source, kind, key, and without `events` history.

        Parameters
        ----------
        where : str or sequence of str
            Surfaces or parts, with * for any letters and ? for one. Or "blocked" (all opaque ones but detectors),
            "escaped", or "returned" (escaped at over 90° to its first direction). Light that misses all surfaces is
            left out.
        selection, n, events
            Filter, largest number of rays (None: all), and whether there is a row for each node, see `rays`. The filter
            may compare kind, order and the like, wavelength_nm, source, surface.

        Raises
        ------
        MistrayError
            If a name does not exist, places do not go together, the filter is not valid or compares another column, or
            `n` is no whole number from 1.
        """
        return rays_elsewhere(self.runs, where, PathFilter(selection), n, events)

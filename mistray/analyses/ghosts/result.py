"""Result of a ghost analysis: every path to the detector at several field angles, against the direct image on axis.

Paths are compared by their RMS irradiance, ``P / (π r_rms²)`` in W/mm². P is the power that the detector absorbs, W,
and r_rms the RMS distance of the rays from their centroid, mm. Divided by that of the direct image on axis it is the
*normalised* RMS irradiance: the brightness of a ghost relative to the image of the same source.

With several wavelengths a path is its event list at all of them. A value then covers all light, unless a wavelength is
stated.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.analyses.ghosts.airy import tight, with_airy
from mistray.analyses.ghosts.combine import by_path
from mistray.analyses.ghosts.field_summary import FieldSummary, field_summary, power_of
from mistray.analyses.ghosts.filtered import Filtered, filtered
from mistray.analyses.ghosts.maps.light_maps import LightMap, light_maps
from mistray.analyses.ghosts.maps.path_maps import FieldMaps, ImagesOfField, field_maps, images_of_field
from mistray.analyses.ghosts.notes import ghost_notes
from mistray.analyses.ghosts.path_analysis import path_analysis
from mistray.analyses.ghosts.peaks import with_peaks
from mistray.analyses.ghosts.request import rank_column
from mistray.analyses.ghosts.scatter_surfaces import scatter_surfaces
from mistray.analyses.ghosts.stray_levels import stray_levels
from mistray.errors import MistrayError, UnknownKeyError
from mistray.estimate import Estimate
from mistray.files.irradiance_files import Map
from mistray.metrics.ghost_ranking import DirectImage, bounds, direct_image, ranked
from mistray.notes import Note
from mistray.ranges import TEXT, Several
from mistray.recorders.film import Pixels
from mistray.recorders.path_events import DIRECT
from mistray.result import KeyNumber, Result
from mistray.toolkit.irradiance import MapStatistics, brightest, statistics
from mistray.trace import Trace
from mistray.trace.sampled_hits import LightCone

MAPPED_PATHS = 4  # stray paths of each field that get a map of their own
RAYS_KEPT = 63  # of a path, to choose those from that are drawn

T = TypeVar("T")
Polyline = npt.NDArray[np.float64]


class GhostReport(
    Mapping[float, Trace],
    Result,
    table=".tables.printed:field_table",
    figure=".figures.ghost_images:levels_against_field",
):
    """
    Result of `ghosts`: a mapping from field angle, degrees, to `Trace`, with tables and maps.

    Attributes
    ----------
    scene : mi.Scene
        The scene that was traced.
    wavelengths_nm : list of float
        Wavelengths, nm, ascending.
    nominal : DirectImage
        Direct image on axis (field 0), all light: the denominator of every normalised value.
    nominal_trace : Trace
        Trace that the direct image on axis is from.
    arguments : dict
        Arguments of `mistray.trace` at every field.
    rank : {"rms", "power", "peak"}
        Quantity by which the lists of worst paths are ordered, see `ghosts`.
    traced_again : tuple of float
        Field angles that were traced again with more rays, degrees, see `ghosts`.
    not_traced : tuple of float
        Field angles requested but not traced for lack of time, degrees, see `ghosts`.
    light_maps : dict
        Field angle, degrees → list of `LightMap`; empty before `map_light` is called.
    photometric : bool
        Whether pages and files also have photometric units.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> for field_deg, t in report.items():
    ...     print(f"{field_deg:.0f}°: {len(t.paths)} paths, stray light {t.paths.stray_W.value:.1f} W")
    0°: 16 paths, stray light 1.6 W
    10°: 16 paths, stray light 1.4 W
    """

    def __init__(
        self,
        scene: Any,
        traces: Mapping[float, Trace],
        nominal_trace: Trace,
        arguments: Mapping[str, Any],
        rank: str = "rms",
        traced_again: Sequence[float] = (),
        not_traced: Sequence[float] = (),
    ) -> None:
        rank_column(rank)
        self.scene, self.rank, self.traced_again = scene, rank, tuple(traced_again)
        self.not_traced = tuple(not_traced)
        self._traces = dict(traces)
        self._made: dict[tuple[Any, ...], Any] = {}  # see `_once`
        self._tables: dict[tuple[float, bool], pd.DataFrame] = {}
        self._path_maps: dict[float, tuple[set[int], FieldMaps]] = {}  # with the paths that were requested
        self._cones: dict[float, dict[int, LightCone | None]] = {}
        self._rays: dict[tuple[float, int], list[Polyline]] = {}
        self.light_maps: dict[float, list[LightMap]] = {}
        self.photometric = False  # whether reports have photometric units, too
        self.arguments = dict(arguments)
        self.nominal_trace = nominal_trace
        self.wavelengths_nm = list(nominal_trace.wavelengths_nm)
        self.nominal = direct_image(nominal_trace.paths)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """
        Return the number of fields, and the most stray light of a field in W and over the direct image on axis.

        They are keyed by label; without a traced field there is only the number of fields, 0.
        """
        stray = {field: t.paths.stray_W for field, t in self.items()}
        found: dict[str, KeyNumber] = {"fields": len(self)}
        if not stray:
            return found
        worst = max(stray, key=lambda field: stray[field].value)
        paths = self[worst].paths
        over = self.nominal.dividing(paths.light(paths.ids(direct=False)), "light")  # of rays that they share
        return found | {
            f"most stray at {worst:g}° [W]": stray[worst],
            "over the image on axis [1]": Estimate(*over.whole),
        }

    def __getitem__(self, field_deg: float) -> Trace:
        try:
            return self._traces[field_deg]
        except KeyError:
            fields = ", ".join(f"{field:g}" for field in self._traces)
            raise UnknownKeyError(f"field {field_deg:g} deg was not traced; traced fields: {fields} deg") from None

    def __iter__(self) -> Iterator[float]:
        return iter(self._traces)

    def __len__(self) -> int:
        return len(self._traces)

    def of(self, traces: Mapping[float, Trace], not_traced: Sequence[float] = ()) -> GhostReport:
        """
        Return a report for other traces, by field angle (degrees), that reuses results computed for this one.

        `not_traced` are the field angles for which there was no time, degrees.
        """
        found = copy.copy(self)
        found._traces, found.not_traced = dict(traces), tuple(not_traced)
        return found

    @property
    def settings(self) -> dict[str, Any]:
        """
        The settings of all fields, see `mistray.trace.Trace`, without their angles.

        ``rays`` is the number at the field with the fewest. If fields were traced again, ``traced_again_deg`` has their
        angles, and ``contested_rays`` the largest number at any field. ``not_traced_deg`` has fields without a trace,
        if any.
        """
        rays = {field: int(t.settings["rays"]) for field, t in self.items()}
        shared = {key: value for key, value in next(iter(self.values())).settings.items() if key != "field_deg"}
        again = {"traced_again_deg": list(self.traced_again), "contested_rays": max(rays.values())}
        missing = {"not_traced_deg": list(self.not_traced)} if self.not_traced else {}
        return shared | {"rays": min(rays.values())} | (again if self.traced_again else {}) | missing

    @property
    def notes(self) -> list[Note]:
        """Notes on the reliability of the results; `ghosts` raises them as warnings, see docs/warnings.md."""
        return ghost_notes(self)

    def recorded(self, kind: type[T]) -> Iterator[tuple[float, T]]:
        """Yield field angle, degrees, and recorder, for every recorder of a class at every field."""
        for field, t in self.items():
            yield from ((field, one) for one in t.recorders.values() if isinstance(one, kind))

    def rivals(self, field_deg: float) -> pd.DataFrame:
        """
        Return the rows of `table` that may be the brightest path within two standard errors, though not ranked first.

        The highest upper bound of the RMS irradiance is first. Powers are in W and irradiances in W/mm².
        """
        table = self.table(field_deg)
        table = table[table.contested]
        return table.iloc[np.argsort(-bounds(table)[1], kind="stable")]

    def nominal_at(self, wavelength_nm: float) -> DirectImage:
        """Return the direct image on axis at one wavelength, nm."""
        return direct_image(self.nominal_trace.paths, self._known(wavelength_nm))

    def weight(self, wavelength_nm: float) -> float:
        """Return the share of a wavelength, nm, in the launched flux, 0 … 1."""
        launched = self.nominal_trace.energy_at(self._known(wavelength_nm)).launched_W
        return launched / self.nominal_trace.energy.launched_W

    def table(self, field_deg: float, per_wavelength: bool = False) -> pd.DataFrame:
        """
        Return the path table of one field, strongest path first.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees.
        per_wavelength : bool
            One row for each path and wavelength instead of one for each path.

        Returns
        -------
        DataFrame
            Columns of ``Trace.paths``, and the following. ``path_ids``: the path at each of its wavelengths, scattered
            at random and aimed. ``path_id`` is the strongest of them; ``wavelength_nm`` and ``polarization`` are means
            weighted by power. ``label``: ghost surfaces and places of scatter in words. ``percent_of_stray`` with its
            ``_se``: percentage of the power of all stray paths (``percent`` is of all light, the direct image
            included). ``normalised_rms_irradiance`` with its ``_se``. ``rank_power`` and ``rank_rms_irradiance``: ranks
            among the stray paths, 1 = worst, 0 for direct paths. The second rank is by the lower bound of the
            irradiance, `mistray.metrics.ghost_ranking.SURE` standard errors below it; paths of few rays have no bound
            and come last. ``contested``: whether the upper bound is above the lower bound of the first. Per wavelength,
            rows are normalised to the on-axis image at their wavelength, and ranked among the rows of that wavelength.
            Once paths are ranked by peak, rows of all light also have the columns of
            `mistray.analyses.ghosts.peaks.with_peaks`.
        """
        if not per_wavelength:
            return self._ranked(field_deg, rank_column(self.rank))
        key = field_deg, per_wavelength
        if key not in self._tables:
            self._tables[key] = self._by_wavelength(self[field_deg])
        return self._tables[key]

    def _once(self, key: tuple[Any, ...], make: Callable[[], T]) -> T:
        """Return the result of `make`, which is called only the first time and then kept under a key."""
        if key not in self._made:
            self._made[key] = make()
        found: T = self._made[key]
        return found

    def _ranked(self, field_deg: float, column: str) -> pd.DataFrame:
        """
        Return the path table of a field for all light, with a rank column; the rank by peak needs maps.

        Columns are those of `table`, with powers in W and irradiances in W/mm².
        """
        key, t = (field_deg, False), self[field_deg]
        if key not in self._tables:
            self._tables[key] = ranked(by_path(self._rows(t), t.paths), t.paths, self.nominal)
        if column not in self._tables[key]:
            self._tables[key] = with_peaks(self._tables[key], t)
        return self._tables[key]

    def _rows(self, t: Trace) -> pd.DataFrame:
        """Return the path table ``by_way`` of a trace, computed once."""
        return self._once(("rows", t), t.paths.by_way)

    def _by_wavelength(self, t: Trace) -> pd.DataFrame:
        parts, table = [], self._rows(t)
        for wavelength in self.wavelengths_nm:
            rows = by_path(table[table.wavelength_nm == wavelength], t.paths)
            parts.append(ranked(rows, t.paths, self.nominal_at(wavelength)))
        return pd.concat(parts).sort_values("path_id", ignore_index=True)

    def top(self, field_deg: float, count: int = 4, rank: str | None = None) -> pd.DataFrame:
        """
        Return the rows of the worst stray paths of one field, the worst first, with the columns of `table`.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees.
        count : int
            Number of paths.
        rank : {"rms", "power", "peak"}, optional
            Order, see `ghosts`. Default: that of the report.
        """
        column = rank_column(self.rank if rank is None else rank)
        table = self._ranked(field_deg, column)
        key = ("stray", field_deg, column, len(table.columns))  # a rank by peak adds columns
        stray = self._once(key, lambda: table[table.kind != DIRECT].sort_values(column))
        return stray.head(count)

    def listed(self, field_deg: float, count: int = 4, rank: str | None = None) -> pd.DataFrame:
        """
        Return the rows of `top`, plus the strongest stray path by power if it is not among them.

        Arguments, columns and units are those of `top` and `table`.
        """
        top, strongest = self.top(field_deg, count, rank), self.top(field_deg, min(count, 1), "power")
        return pd.concat([top, strongest[~strongest.path_id.isin(top.path_id)]])

    def with_airy(self, field_deg: float, rows: pd.DataFrame) -> pd.DataFrame:
        """
        Return rows of a field's table with the RMS irradiance at the Airy radius, see `mistray.analyses.ghosts.airy`.

        For paths with so small a radius that it matters, some rays are traced again to find their light cones. The new
        columns are in mm and W/mm².
        """
        known, wanted = self._cones.setdefault(field_deg, {}), set(tight(rows).path_id)
        if wanted - known.keys():
            tables = [table for (field, _), table in self._tables.items() if field == field_deg]
            every = [int(i) for i in wanted.union(*(tight(table).path_id for table in tables)) if i not in known]
            known |= dict.fromkeys(every) | self[field_deg].light_cones(every)
        return with_airy(rows, {i: cone for i, cone in known.items() if cone is not None})

    def spectrum(self, field_deg: float, path_id: int) -> pd.DataFrame:
        """Return the rows of one path at each of its wavelengths, ascending, with the columns of `table`."""
        whole = self.table(field_deg)
        found = whole.path_ids[whole.path_id == path_id]
        if len(found) != 1:
            raise MistrayError(f"path {path_id!r} is not in the table of field {field_deg:g} deg; see report.table")
        (members,) = found
        rows = self.table(field_deg, per_wavelength=True)
        return rows[rows.path_id.isin(members)].sort_values("wavelength_nm")

    @property
    def scatters(self) -> bool:
        """True if any scattered light reaches the detector, at any field angle."""
        return any(bool((self._rows(t).scatters > 0).any()) for t in self._traces.values())

    def scatter_surfaces(self, field_deg: float, wavelength_nm: float | None = None) -> pd.DataFrame:
        """
        Return the light on the detector by the first surface that scatters it.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees.
        wavelength_nm : float, optional
            Wavelength of the light, nm. Default: all light.

        Returns
        -------
        DataFrame
            See `mistray.analyses.ghosts.scatter_surfaces.scatter_surfaces`.
        """
        rows = self._rows(self[field_deg])
        if wavelength_nm is not None:
            rows = rows[rows.wavelength_nm == self._known(wavelength_nm)]
        return scatter_surfaces(self[field_deg], rows)

    def stray_levels(self, field_deg: float, by: str = "scatter") -> pd.DataFrame:
        """
        Return the stray light of a field, W, by critical surface and by level of scatter or of splitting.

        See `mistray.analyses.ghosts.stray_levels.stray_levels` for the columns and for `by`.
        """
        return stray_levels(self[field_deg], self._rows(self[field_deg]), by)

    def filtered(self, field_deg: float, selection: str) -> Filtered:
        """Return the paths of a field that pass a filter, see `mistray.trace.path_filter`, and their total power, W."""
        t = self[field_deg]
        return self._once(("filtered", t, selection), lambda: filtered(t, self._rows(t), selection))

    def map_light(self, selections: str | Sequence[str]) -> None:
        """Fill `light_maps` with maps of selected parts of the light at each field, by tracing the rays again."""
        chosen = Several(TEXT, least=0).check("selections", selections)
        self.light_maps = {field: light_maps(t, chosen) for field, t in self.items()}

    def check_ids(self, field_deg: float, path_ids: int | Sequence[int]) -> list[int]:
        """Return one or several path ids of a field's table as a list; raise `MistrayError` for one not in it."""
        found: list[int] = self[field_deg].paths.check_ids(path_ids).tolist()
        absent = set(found).difference(self._rows(self[field_deg]).path_id)
        if absent:
            raise MistrayError(f"path {min(absent)} is not in the table of field {field_deg:g} deg; see report.table")
        return found

    def aliased(self, field_deg: float, aliases: Mapping[str, str] | str) -> pd.DataFrame:
        """
        Return the path table of a field with renamed surfaces, see `mistray.trace.PathTable.by_way`.

        Powers are in W.
        """
        t = self[field_deg]
        return self._once(("aliased", t, str(aliases)), lambda: t.paths.by_way(aliases))

    def path_analysis(self, field_deg: float, sort: str = "power_W", least_share: float = 0.0) -> pd.DataFrame:
        """
        Return the paths of a field with lengths and objects, see `mistray.analyses.ghosts.path_analysis`.

        Powers are in W, and optical path lengths in mm.
        """
        t = self[field_deg]
        return self._once(("analysis", t, sort, least_share), lambda: path_analysis(t, sort, least_share))

    def power_of(self, field_deg: float, rows: pd.DataFrame) -> Estimate:
        """Return the total power of rows of this field's table, W, with its standard error."""
        return power_of(self[field_deg], rows.path_ids)

    def _known(self, wavelength_nm: float) -> float:
        if wavelength_nm not in self.wavelengths_nm:
            known = ", ".join(f"{value:g}" for value in self.wavelengths_nm)
            raise MistrayError(f"{wavelength_nm:g} nm was not traced; traced wavelengths: {known} nm")
        return wavelength_nm

    def map(self, field_deg: float, path_id: int) -> tuple[Map, Map]:
        """
        Return the irradiance map of a path of ``listed(field_deg, MAPPED_PATHS)`` with its standard error, W/mm².

        For other paths use ``report[field_deg].irradiance_of(path_ids)``.

        Raises
        ------
        MistrayError
            If the path is not among these.
        """
        try:
            return self._images(field_deg).paths[path_id]
        except KeyError:
            raise MistrayError(
                f"path {path_id} is not among the worst {MAPPED_PATHS} of field {field_deg:g} deg; "
                "use report[field_deg].irradiance_of(path_ids)"
            ) from None

    def stray_map(self, field_deg: float) -> tuple[Map, Map]:
        """Return the irradiance map of all but the direct paths and its standard error, (H, W), W/mm²."""
        stray = self.stray_light(field_deg)
        return stray.value, stray.se

    def stray_light(self, field_deg: float) -> Pixels:
        """Return the irradiance image of all but the direct paths, with its noise, W/mm²."""
        return self._images(field_deg).stray

    def stray_statistics(self, field_deg: float) -> MapStatistics:
        """Return extremes, mean and flux of the irradiance map without the direct image (W/mm², W)."""
        table = self.table(field_deg)
        return statistics(
            *self.stray_map(field_deg), self[field_deg].extent, int(table.rays[table.kind != DIRECT].sum())
        )

    def peak_to_nominal(self, field_deg: float) -> Estimate:
        """Return the peak irradiance of a field's stray light over that of the direct image on axis, dimensionless."""
        stray, nominal = self._images(field_deg).stray, self._nominal_map()
        found = brightest(stray).over(brightest(nominal))
        return Estimate(float(found.value), float(found.se))

    def path_maps(self, field_deg: float, path_ids: int | Sequence[int]) -> FieldMaps:
        """
        Return power maps of many paths of one field, by tracing the same rays once more.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees.
        path_ids : int or sequence of int
            Paths of the table of this field, the most important ones first. If the detector has so many pixels that
            not all maps fit into `mistray.analyses.ghosts.peaks.MAP_BYTES`, the last ones are part of `rest`.

        Returns
        -------
        FieldMaps
            Maps of the paths; the last ones made are kept for each field.
        """
        path_ids = self.check_ids(field_deg, path_ids)
        if field_deg not in self._path_maps or not set(path_ids) <= self._path_maps[field_deg][0]:
            worst = self.listed(field_deg, MAPPED_PATHS).path_id
            maps, images = field_maps(self[field_deg], self.table(field_deg), path_ids, set(worst))
            self._path_maps[field_deg] = set(path_ids), maps
            if images is not None:
                self._made.setdefault(("images", field_deg), images)
        return self._path_maps[field_deg][1]

    def rays_of_paths(self, field_deg: float, path_ids: int | Sequence[int]) -> dict[int, list[Polyline]]:
        """
        Return rays of paths for drawings, from a sample of the start rays of the trace that is spread over the beam.

        Returns
        -------
        dict
            Lists of polylines (k, 3) from the source to the detector in world coordinates, mm, by path id; empty for a
            path that is too rare to occur in the sample.
        """
        path_ids = self.check_ids(field_deg, path_ids)
        missing = [path_id for path_id in path_ids if (field_deg, path_id) not in self._rays]
        if missing:
            rows = self._rows(self[field_deg]).set_index("path_id").path_ids
            found = self[field_deg].sampled_rays([i for path_id in missing for i in rows[path_id]], RAYS_KEPT)
            for path_id in missing:
                self._rays[field_deg, path_id] = [ray.points for i in rows[path_id] for ray in found[i]]
        return {path_id: self._rays[field_deg, path_id] for path_id in path_ids}

    def rays_of(self, field_deg: float, path_id: int) -> list[Polyline]:
        """Return the rays of one path as `rays_of_paths` does; those of all worst paths are found at the same time."""
        table = self.table(field_deg)
        direct = table.path_id[table.kind == DIRECT].head(1)
        together = dict.fromkeys([path_id, *direct, *self.listed(field_deg, MAPPED_PATHS).path_id])
        return self.rays_of_paths(field_deg, list(together))[path_id]

    def _nominal_map(self) -> Pixels:
        field = next((field for field, t in self.items() if t is self.nominal_trace), None)
        if field is not None:
            return self._images(field).direct
        (image,) = self.nominal_trace.each_map([self.nominal.path_ids], [True])
        return image

    def _images(self, field_deg: float) -> ImagesOfField:
        """Return the irradiance images of a field, W/mm², computed once by tracing its rays again."""
        worst = [int(path_id) for path_id in self.listed(field_deg, MAPPED_PATHS).path_id]
        t, table = self[field_deg], self.table(field_deg)
        return self._once(("images", field_deg), lambda: images_of_field(t, table, worst))

    def summary(self, field_deg: float, wavelength_nm: float | None = None) -> FieldSummary:
        """
        Return the summary of one field, a row of the main table.

        Parameters
        ----------
        field_deg : float
            Field angle, degrees.
        wavelength_nm : float, optional
            Wavelength of the light and of the on-axis image to compare with, nm. Default: all light.
        """
        t = self[field_deg]
        rows, table = self._rows(t), self.table(field_deg, per_wavelength=wavelength_nm is not None)
        nominal = self.nominal if wavelength_nm is None else self.nominal_at(wavelength_nm)
        make = functools.partial(field_summary, t, rows, table, field_deg, wavelength_nm, nominal)
        return self._once(("summary", field_deg, wavelength_nm), make)

"""Point source transmittance over field angle and azimuth, by class of the light, with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analyses.pst.request import CONVENTIONS
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.gradients.pst_gradient import PstRays
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.known_arguments import known_arguments
from mistray.messages import Message
from mistray.metrics.next_order import NextOrder
from mistray.notes import Note
from mistray.percent import percent_text
from mistray.ranges import TEXT, Several
from mistray.recorders.direction_recorder import CLASSES, SINGLE
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.path_events import DIRECT
from mistray.result import KeyNumber, Result

if TYPE_CHECKING:
    import pandas as pd
    import xarray

    from mistray.analyses.pst.plan import Plan

STRAY = CLASSES[1:]
GROUPS = {"total": CLASSES, "stray": STRAY}
LIGHT = (*GROUPS, *CLASSES)
SCATTERED = slice(SINGLE, None)  # classes of scattered light
LARGE_ERROR = 0.1  # relative standard error of the PST at an angle that merits a note
LARGE_SHARE = 0.1  # fraction of the scattered light of a cell by a single ray that merits a note
BACKWARD, FORWARD = "backward", "forward"  # techniques of sampling


@dataclass(frozen=True, eq=False, repr=False)
class Pst(Result, table=".tables:curve_table", figure=".figures:pst_curve"):
    """
    Point source transmittance (PST) of a system: irradiance on the detector over irradiance of a distant source.

    PST_normal = E_det / E_⊥ with the irradiance E_⊥ on a plane across the beam; PST_projected = E_det / (E_⊥ cos θ),
    where the plane is that of the aperture (R. Breault in Handbook of Optics; E. Fest, Stray Light Analysis and
    Control, 2013). E_det is the flux that *meets* the detector, averaged over its area, whether absorbed or not. Values
    are means over the cells of `grid`.

    Light is "direct" by the design path, see docs/design_path.md. "straight_shot" is neither scattered nor reflected
    where that counts, but goes by another path: past a mirror or a lens, or through an edge or bevel. "ghost" is
    reflected, not scattered. "single_scatter" and "multiple_scatter" have one and several scatter events, with or
    without reflections. "edge_diffraction" is deflected at rings of `edge_diffraction` alone; if light is scattered as
    well, the number of all these events decides.

    Attributes
    ----------
    grid : DirectionGrid
        Grid of (n, m) cells: n field angles, m azimuths.
    by_batch : (c, n, m, b) float64
        PST_normal, dimensionless, of each of the c classes in `mistray.recorders.direction_recorder.CLASSES` from each
        batch of start rays alone. Batches are independent of each other; the cells of one batch are not.
    weight : (b,) or (n, m, b) float64
        Fraction of the start rays in each of the b batches, of each cell if cells have their own start rays.
    convention : {"normal", "projected"}
        Convention of `value` and all that is derived from it.
    method : {"joined", "adjoint", "forward"}
        Method of the computation, see `mistray.pst`.
    facts : dict
        Facts of the computation, plain values: scene, detector, detector_area_mm2, wavelength_nm, weights, rays, seed,
        seconds, segments, settings …
    largest_share : (n, m) float64
        Fraction, 0 … 1, of the scattered light of a cell that its strongest single ray carries; if it is large, so are
        the errors of the errors.
    path_rows : DataFrame, optional
        Paths by cell: columns cell (index of the field angle), azimuth_cell, those of
        `mistray.recorders.path_events.describe_events`, rays, pst_normal and pst_normal_se, dimensionless.
    maps : (2, n, m, h, w) float64, optional
        PST_normal of each pixel of the detector, h rows by w columns, and its standard error, dimensionless.
    extent_mm : tuple of four float
        Bounds x0, x1, y0, y1 of the detector, in its own frame, mm.
    source : PstRays, optional
        Rays of the computation, for derivatives; None with the method "forward", and after pickling.
    plan : Plan, optional
        Plan of its pilot, if forward and backward rays share the light (multiple importance sampling).
    techniques : dict of str to (c, n, m, b) float64
        Part of `by_batch` that rays of each direction contribute, dimensionless, see `budget`.
    next_orders : tuple of NextOrder
        Stray light by field angle compared with that of one more event on each path, if it was measured.

    Examples
    --------
    >>> pst = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> for angle, found in zip(pst.field_deg, pst.estimates("ghost")):
    ...     print(f"{angle:.0f}°: {mistray.report.with_error(found)}")
    10°: 4.71e-05 ± 1.0e-06
    30°: 3.848e-05 ± 5.4e-07
    >>> pst.paths(30).label.tolist()
    ['L1_rear → L1_front']
    """

    grid: DirectionGrid
    by_batch: np.ndarray
    weight: np.ndarray
    _: KW_ONLY
    convention: str = "normal"
    method: str = "joined"
    facts: dict[str, Any] = field(default_factory=dict)
    largest_share: np.ndarray | None = None
    path_rows: pd.DataFrame | None = None
    maps: np.ndarray | None = None
    extent_mm: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    source: PstRays | None = field(default=None, repr=False, compare=False)
    plan: Plan | None = field(default=None, repr=False, compare=False)
    techniques: Mapping[str, np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    next_orders: tuple[NextOrder, ...] = field(default=(), repr=False, compare=False)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of field angles, PST at the first, stray PST at the last, and the convention, by label."""
        first, last = self.field_deg[0], self.field_deg[-1]
        return {
            "angles": len(self.field_deg),
            f"PST at {first:g}° [1]": self.estimates()[0],
            f"stray at {last:g}° [1]": self.estimates("stray")[-1],
            "convention": self.convention,
        }

    @property
    def notes(self) -> list[Note]:
        """Notes on the reliability of the PST; `pst` raises them as warnings, see docs/warnings.md."""
        found = list(self.facts.get("notes", ()))
        value, se = self.curve()
        doubtful = (value > 0) & (se > LARGE_ERROR * value)
        if doubtful.any():
            worst = float((se[doubtful] / value[doubtful]).max())
            found.append(Message.LARGE_ERROR.note(worst=percent_text(worst), angles=_angles(self.field_deg[doubtful])))
        return found

    def table_gradients(
        self, derivative: np.ndarray, request: GradientRequest, groups: np.ndarray | None = None
    ) -> Iterator[TableGradient]:
        """
        Yield the derivatives of a metric with respect to the parameters of the scene, by tracing the same rays again.

        Parameters
        ----------
        derivative : (c, n, m) float64
            Derivative of the metric with respect to PST_normal of each class in each cell.
        request : GradientRequest
            Settings of the gradient.
        groups : (n, m) int, optional
            Index of the group of each cell, see `mistray.gradients.pst_gradient.PstRays.gradient`.

        Yields
        ------
        TableGradient
            Gradients for each wavelength and direction, to be added.

        Raises
        ------
        MistrayError
            If this is not the result of a trace from the detector in this process.
        """
        if self.source is None:
            raise MistrayError("this PST has no rays to differentiate; compute it here, without method='forward'")
        yield from self.source.gradient(np.asarray(derivative), request, groups)

    def __post_init__(self) -> None:
        if self.convention not in CONVENTIONS:
            raise MistrayError(f"convention is '{self.convention}'; use 'normal' or 'projected'")

    # ---- numbers

    @property
    def field_deg(self) -> np.ndarray:
        """Field angles of the cells, degrees, (n,)."""
        return self.grid.field_deg

    @property
    def _factor(self) -> np.ndarray:
        """Factor, by field angle, (n,), that converts PST_normal to the PST of the chosen convention."""
        cosine = np.maximum(self.grid.mean_cosine, np.finfo(float).tiny)
        return np.asarray(1 / cosine if self.convention == "projected" else np.ones_like(cosine))

    def samples(self, classes: str | Sequence[str] = "total") -> np.ndarray:
        """
        Return the PST of each cell from each batch of start rays alone, (n, m, b), dimensionless.

        `classes` are "total", "stray" (all but "direct"), a class of light, or several.
        """
        return np.asarray(self.by_batch[_numbers(classes)].sum(axis=0) * self._factor[:, None, None])

    def map(self, classes: str | Sequence[str] = "total") -> tuple[np.ndarray, np.ndarray]:
        """Return the PST of each cell and its standard error, (n, m) each, dimensionless; see `samples`."""
        return self.estimate(self.samples(classes), self.weight)

    def curve(self, classes: str | Sequence[str] = "total") -> tuple[np.ndarray, np.ndarray]:
        """
        Return the PST over field angle, averaged over azimuths, and its standard error, (n,) each, dimensionless.

        For `classes` see `samples`.
        """
        samples, weight = self.samples(classes), self.weight
        if weight.ndim == 1:
            # Cells share their start rays: the mean is formed in every batch
            return self.estimate(samples.mean(axis=1), weight)
        value, se = self.estimate(samples, weight)  # every cell has its own start rays
        return value.mean(axis=1), np.sqrt(np.sum(se**2, axis=1)) / value.shape[1]

    def estimates(self, classes: str | Sequence[str] = "total") -> list[Estimate]:
        """
        Return the values of `curve` as estimates with standard errors, one per field angle.

        For `classes` see `samples`.
        """
        return [Estimate(float(value), float(se)) for value, se in zip(*self.curve(classes), strict=True)]

    def columns(self, found: Callable[[str], tuple[np.ndarray, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return columns pst_<light> and pst_<light>_se for each name in `LIGHT`; `found` gives both for a name."""
        parts = ((name, end, part) for name in LIGHT for end, part in zip(("", "_se"), found(name), strict=True))
        return {f"pst_{name}{end}": part.ravel() for name, end, part in parts}

    @staticmethod
    def estimate(samples: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the weighted mean over batches (last axis), and its standard error from the spread of batches.

        The weights of the batches add up to 1; empty batches have none.
        """
        value = np.sum(weight * samples, axis=-1)
        # Empty batches have no weight
        used = np.maximum(np.count_nonzero(weight, axis=-1), 2)
        spread = np.sum(np.square(weight * (samples - value[..., None])), axis=-1)
        return value, np.sqrt(used / (used - 1) * spread)

    @property
    def value(self) -> np.ndarray:
        """PST of all light over field angle, averaged over azimuths, (n,), dimensionless."""
        return self.curve()[0]

    @property
    def standard_error(self) -> np.ndarray:
        """Standard error of `value`, (n,), dimensionless."""
        return self.curve()[1]

    @property
    def stray(self) -> np.ndarray:
        """PST of all light but the direct image over field angle, averaged over azimuths, (n,), dimensionless."""
        return self.curve("stray")[0]

    @property
    def stray_se(self) -> np.ndarray:
        """Standard error of `stray`, (n,), dimensionless."""
        return self.curve("stray")[1]

    def share_of_scattered(self, part: np.ndarray) -> np.ndarray:
        """Return `part` of the PST_normal over that of all scattered light, (n, m); 0 where none is scattered."""
        scattered = self.estimate(self.by_batch[SCATTERED].sum(axis=0), self.weight)[0]
        return np.divide(part, scattered, out=np.zeros_like(scattered), where=scattered > 0)

    @property
    def is_dark(self) -> bool:
        """True if no ray found light from any cell of directions."""
        return not np.any(np.nan_to_num(self.by_batch))

    def to(self, convention: str) -> Pst:
        """Return the PST in convention "normal" (irradiance across the beam) or "projected" (on the aperture plane)."""
        return self if convention == self.convention else replace(self, convention=convention)

    # ---- details

    @known_arguments
    def paths(self, field_deg: float, azimuth_deg: float = 0.0, n: int | None = None) -> pd.DataFrame:
        """
        Return a table of the paths of the light at a field angle, the strongest first.

        Parameters
        ----------
        field_deg, azimuth_deg : float
            Angles, degrees; the cell that contains them is used.
        n : int, optional
            Number of paths; by default all.

        Returns
        -------
        DataFrame
            Columns of `path_rows` without the cells, with ``pst``, ``pst_se`` (in the convention of this result),
            ``percent_of_stray`` (of all light at this angle but the direct image; NaN for the direct image) and
            ``percent_of_all``.

        Raises
        ------
        MistrayError
            If the PST was computed without paths, or no cell contains the direction.
        """
        if self.path_rows is None:
            raise MistrayError("this PST was computed without paths; ask for them with paths=True")
        cell = self.grid.nearest(field_deg, azimuth_deg)
        if cell not in self._path_tables:
            listed, cells = self._listed
            own = cells.get(cell, np.empty(0, dtype=np.intp))
            self._path_tables[cell] = listed.iloc[own].reset_index(drop=True)
        rows = self._path_tables[cell]
        return rows.copy() if n is None else rows.head(n)

    @cached_property
    def _path_tables(self) -> dict[tuple[int, int], pd.DataFrame]:
        """Cache of the path tables of `paths` by cell, since a report reads each of them about ten times."""
        return {}

    @cached_property
    def _listed(self) -> tuple[pd.DataFrame, dict[tuple[int, int], np.ndarray]]:
        """Path tables of all cells in one DataFrame, and the row indices of each cell."""
        rows = self.path_rows
        assert rows is not None  # `paths` has checked it
        rows = rows.sort_values("pst_normal", ascending=False, kind="stable", ignore_index=True)
        i, j = (rows[name].to_numpy(dtype=np.intp) for name in ("cell", "azimuth_cell"))
        stray, total = self.map("stray")[0][i, j], self.map()[0][i, j]
        factor = self._factor[i]
        rows = rows.assign(pst=factor * rows.pst_normal, pst_se=factor * rows.pst_normal_se)
        with np.errstate(divide="ignore", invalid="ignore"):
            rows["percent_of_stray"] = np.where(rows.kind != DIRECT, 100 * rows.pst / stray, np.nan)
            rows["percent_of_all"] = 100 * rows.pst / total
        # One sort and one grouping for all cells
        cells = dict(rows.groupby(["cell", "azimuth_cell"]).indices)
        return rows.drop(columns=["cell", "azimuth_cell", "pst_normal", "pst_normal_se"]), cells

    def budget(
        self, field_deg: float, azimuth_deg: float = 0.0, classes: str | Sequence[str] = "total"
    ) -> pd.DataFrame:
        """
        Return the contributions of forward and of backward rays to the PST at a field angle.

        Parameters
        ----------
        field_deg, azimuth_deg : float
            Angles, degrees; the cell that contains them is used.
        classes : str or sequence of str
            See `samples`.

        Returns
        -------
        DataFrame
            A row for each technique: technique, pst, pst_se (in the convention of this result), percent of the
            light.
        """
        import pandas as pd

        i, j = self.grid.nearest(field_deg, azimuth_deg)
        numbers, weight = _numbers(classes), self.weight if self.weight.ndim == 1 else self.weight[i, j]
        techniques = self.techniques or {FORWARD if self.method == "forward" else BACKWARD: self.by_batch}
        rows = []
        for name, part in techniques.items():
            value, se = self.estimate(part[numbers, i, j].sum(axis=0) * self._factor[i], weight)
            rows.append({"technique": name, "pst": float(value), "pst_se": float(se)})
        found = pd.DataFrame(rows)
        with np.errstate(divide="ignore", invalid="ignore"):
            found["percent"] = 100 * found.pst / found.pst.sum()
        return found

    @known_arguments
    def irradiance(self, field_deg: float, azimuth_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the irradiance map of the detector for a source of 1 W/mm² across the beam, and its standard error.

        The source is at a field angle and azimuth, degrees; the map is that of the cell that contains them.

        Returns
        -------
        value, se : (h, w) float64
            Irradiance and its standard error, W/mm², row 0 at the smallest y.

        Raises
        ------
        MistrayError
            If the PST was computed without maps, or no cell contains the direction.
        """
        if self.maps is None:
            raise MistrayError("this PST was computed without maps; ask for them with map_pixels=64, say")
        i, j = self.grid.nearest(field_deg, azimuth_deg)
        return self.maps[0, i, j], self.maps[1, i, j]

    def to_pandas(self) -> pd.DataFrame:
        """
        Return the PST as a DataFrame, one row for each cell of field angle and azimuth.

        Columns are angle_deg, angle_from_deg, angle_to_deg, azimuth_deg, convention, method, and for total, stray and
        each class of light the PST and its standard error (``…_se``).
        """
        import pandas as pd

        n, m = self.grid.shape
        columns: dict[str, Any] = {
            "angle_deg": np.repeat(self.field_deg, m),
            "angle_from_deg": np.repeat(self.grid.edges_deg[:, 0], m),
            "angle_to_deg": np.repeat(self.grid.edges_deg[:, 1], m),
            "azimuth_deg": np.tile(self.grid.azimuths_deg, n),
            "convention": self.convention,
            "method": self.method,
        }
        return pd.DataFrame(columns | self.columns(self.map))

    def to_xarray(self) -> xarray.Dataset:
        """
        Return the PST as arrays with named axes, with standard errors and units; needs the extra ``xarray``.

        Returns
        -------
        xarray.Dataset
            ``pst`` over light (total, stray and each class), field and azimuth, and ``pst_mean``, its mean over the
            azimuths, each with its standard error under the name with ``_se``. A PST with maps also has
            ``irradiance`` over field, azimuth, y and x, W/mm² for 1 W/mm² across the beam. Coordinates: field angle
            with the ends of its cells, ``field_from`` and ``field_to``, and azimuth, degrees; pixels, mm.

        Raises
        ------
        MistrayError
            If xarray is not installed.
        """
        from mistray.files.labelled import IRRADIANCE, Labelled, dataset, pixel_coordinates

        cells, means = ([found(name) for name in LIGHT] for found in (self.map, self.curve))
        (pst, pst_se), (mean, mean_se) = ([np.stack(part) for part in zip(*x, strict=True)] for x in (cells, means))
        what = f"point source transmittance, {self.convention}"
        # Arrays, then their coordinates
        arrays = {
            "pst": Labelled(("light", "field", "azimuth"), pst, "1", what, pst_se),
            "pst_mean": Labelled(("light", "field"), mean, "1", f"mean over azimuth of {what}", mean_se),
        }
        coordinates = {
            "light": Labelled(("light",), np.array(LIGHT), "", "class of light"),
            "field": Labelled(("field",), self.field_deg, "degree", "field angle"),
            "field_from": Labelled(("field",), self.grid.edges_deg[:, 0], "degree", "smallest field angle of a cell"),
            "field_to": Labelled(("field",), self.grid.edges_deg[:, 1], "degree", "largest field angle of a cell"),
            "azimuth": Labelled(("azimuth",), self.grid.azimuths_deg, "degree", "azimuth from +y towards -x"),
        }
        # Maps of the detector
        if self.maps is not None:
            rows, columns = self.maps.shape[-2:]
            coordinates |= pixel_coordinates(self.extent_mm, (rows, columns))
            axes = ("field", "azimuth", "y", "x")
            arrays["irradiance"] = Labelled(axes, self.maps[0], IRRADIANCE, "irradiance", self.maps[1])
        facts = {"convention": self.convention, "method": self.method, **self.facts}
        return dataset(arrays, coordinates, "Point source transmittance", facts)

    def to_csv(self, path: str | Path) -> None:
        """Write the table of `to_pandas` as CSV, numbers with nine digits."""
        self.to_pandas().to_csv(path, index=False, float_format="%.9g")


def _numbers(classes: str | Sequence[str]) -> list[int]:
    """
    Return the indices within `CLASSES` of a group ("total" or "stray"), of one class of light, or of several.

    Raises
    ------
    MistrayError
        If a class does not exist.
    """
    given = Several(TEXT).check("classes", classes)
    names = dict.fromkeys(name for one in given for name in GROUPS.get(one, (one,)))
    unknown = [name for name in names if name not in CLASSES]
    if unknown:
        raise MistrayError(f"class '{unknown[0]}' of light does not exist; use {', '.join(CLASSES)}, stray or total")
    return [CLASSES.index(name) for name in names]


def notes(found: Pst, largest: np.ndarray, rays: float) -> list[Note]:
    """
    Return notes on field angles with cells without light, or where a single ray carries much of the scattered light.

    Parameters
    ----------
    found : Pst
        PST to judge.
    largest : (n, m) float64
        See `Pst.largest_share`.
    rays : float
        Number of rays that searched for the light of each cell.
    """
    lines: list[Note] = []
    value, _ = found.map()
    # Cells without light
    dark = found.grid.field_deg[np.any(value == 0, axis=1)]
    if dark.size:
        lines.append(Message.DARK_ANGLES.note(angles=_angles(dark), rays=rays))
    # Cells in which single rays dominate
    heavy = found.grid.field_deg[np.any(largest > LARGE_SHARE, axis=1)]
    if heavy.size:
        lines.append(Message.ONE_RAY_AT_ANGLES.note(angles=_angles(heavy), limit=100 * LARGE_SHARE))
    return lines


def _angles(angles: np.ndarray) -> str:
    """Return angles, degrees, as text; of more than four, only the first and the last."""
    if len(angles) <= 4:
        return f"{', '.join(f'{angle:g}' for angle in angles)}°"
    return f"{len(angles)} angles from {angles[0]:g} to {angles[-1]:g}°"

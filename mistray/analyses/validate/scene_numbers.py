"""Numbers to compare that a trace of a scene gives: of its image, a ghost, scattered light, or a PST.

A path is named by the surfaces that reflect its light, without those that reflect the light of the image. Of several
such paths it is the strongest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.errors import MistrayError, errors_of
from mistray.estimate import UNKNOWN, Estimate
from mistray.metrics.scene_values import assign
from mistray.recorders.sampled import ERROR_RAYS
from mistray.scene import load
from mistray.trace import trace
from mistray.trace.path_row import PathRow
from mistray.trace.result import Trace

if TYPE_CHECKING:
    import pandas as pd

FAINTEST = 1e-9  # flux of a ray relative to a start ray, below which it is cut
SUBSETS = 16  # of the hits of a path, whose extents tell the error of that of all hits
LEAST_HITS = 16  # of a subset
SUMS = ("detected_W", "scattered_W")  # of many paths, whose spread over fewer rays than `ERROR_RAYS` is no error
REFLECTED = ("SpecRefl", "TIR")
OF_PATH: Mapping[str, tuple[str, str]] = {
    "power_W": ("power_W", "power_se_W"),
    "x_mm": ("x_mm", "x_se_mm"),
    "y_mm": ("y_mm", "y_se_mm"),
    "rms_radius_mm": ("rms_radius_mm", "rms_radius_se_mm"),
    "rms_irradiance_W_mm2": ("rms_irradiance_W_mm2", "rms_irradiance_se_W_mm2"),
    "share_percent": ("percent", "percent_se"),
}
"""Number and standard error of a row of the path table, by quantity."""


class SceneNumbers:
    """
    Mistray's numbers for the rows of one file; rows with the same light share one trace.

    Parameters
    ----------
    file : ReferenceFile
        Published numbers, with their scene.
    rays : int, optional
        Start rays of each trace instead of those of the file.
    seed : int
        Seed of the traces.
    """

    def __init__(self, file: ReferenceFile, rays: int | None, seed: int) -> None:
        self._file = file
        self._rays = rays or file.rays
        self._seed = seed
        self._scenes: dict[tuple[tuple[str, float], ...], mi.Scene] = {}
        self._reflections = max([2, *(len(one.path) for one in file.rows)])
        self._traces: dict[tuple[Any, ...], Trace] = {}
        self._found_hits: dict[Trace, pd.DataFrame] = {}

    def __call__(self, row: DeclaredRow) -> Estimate | None:
        """
        Return mistray's number for a row and its standard error, in the unit of the quantity.

        It is None if there is no such light. The error is NaN if the rays are too few.
        """
        if row.quantity == "pst":
            return self._pst(row)
        t = self._trace(row)
        if row.quantity in SUMS:
            light = detected(t) if row.quantity == "detected_W" else scattered(t, row.scattered_by)
            return light if light is None or self._rays >= ERROR_RAYS else Estimate(light.value, math.nan)
        found = named_path(t, row.path)
        if found is None:
            return None
        if row.quantity.startswith("diameter"):
            return extent(self._hits(t, found.path_id)[f"detector_{row.quantity.removeprefix('diameter_')}"].to_numpy())
        return Estimate(*(float(getattr(found, key)) for key in OF_PATH[row.quantity]))

    def scene(self, row: DeclaredRow) -> mi.Scene:
        """Return the scene with parameters and the pivot of the beam set as the file and the row ask."""
        values = {**(self._file.set or {}), **(row.set or {})}
        key = tuple(sorted(values.items()))
        if key not in self._scenes:
            own = self._file.folder / self._file.scene
            loaded = load(own if own.is_file() else self._file.scene)
            if values:
                with errors_of("set"):
                    assign(mi.traverse(loaded), {key: np.array([value]) for key, value in values.items()})
            if self._file.pivot_mm is not None:
                turning = [source for source in loaded.emitters() if hasattr(source, "field_deg")]
                if not turning:
                    raise MistrayError("pivot_mm is given, but no source of the scene has a field angle; leave it out")
                for source in turning:
                    source.matrix[:3, 3] = self._file.pivot_mm
            self._scenes[key] = loaded
        return self._scenes[key]

    def _trace(self, row: DeclaredRow) -> Trace:
        key = (tuple(sorted((row.set or {}).items())), row.field_deg, row.azimuth_deg, row.wavelength_nm)
        if key not in self._traces:
            self._traces[key] = trace(
                self.scene(row),
                rays=self._rays,
                seed=self._seed,
                field_deg=row.field_deg,
                azimuth_deg=row.azimuth_deg,
                wavelength_nm=row.wavelength_nm,
                max_reflections=self._reflections,
                flux_threshold=FAINTEST,
            )
        return self._traces[key]

    def _hits(self, t: Trace, path: int) -> pd.DataFrame:
        """
        Return the hits of a path, by its id, on the detector, mm, as a table of rays.

        Hits of all paths whose extent the file asks for are found at once.
        """
        if t not in self._found_hits:
            named = [named_path(t, row.path) for row in self._file.rows if row.quantity.startswith("diameter")]
            choice = " | ".join(dict.fromkeys(f"path_id == {one.path_id}" for one in named if one is not None))
            self._found_hits[t] = t.rays(choice, n=None)
        hits = self._found_hits[t]
        return hits[hits["path_id"] == path]

    def _pst(self, row: DeclaredRow) -> Estimate:
        from mistray.analyses.pst.run import pst

        light = {} if row.wavelength_nm is None else {"wavelength_nm": row.wavelength_nm}
        found = pst(
            self.scene(row),
            [row.field_deg],
            azimuths_deg=None if row.azimuth_deg is None else [row.azimuth_deg],
            rays=self._rays,
            seed=self._seed,
            max_reflections=self._reflections,
            flux_threshold=FAINTEST,
            **light,
        )
        value, se = found.curve()
        return Estimate(float(value[0]), float(se[0]))


def named_path(t: Trace, surfaces: Sequence[str]) -> PathRow | None:
    """
    Return the strongest path of a trace whose light the named surfaces reflect in this order; None if there is none.

    Reflections that the image has too are not to be named; without names it is the image or scattered light.
    """
    image = next((row for row in t.paths if row.order == 0), None)
    design = _reflecting(image) if image is not None else []
    rows = [row for row in t.paths if _without(_reflecting(row), design) == list(surfaces)]
    return max(rows, key=lambda row: row.power_W, default=None)


def detected(t: Trace) -> Estimate:
    """Return the power that the detector absorbs, W, of all paths."""
    return Estimate(t.energy.detected_W, t.energy.detected_se_W)


def scattered(t: Trace, pattern: str) -> Estimate | None:
    """Return the power on the detector, W, of light that is scattered once, by surfaces whose names fit; None if none.

    Light that anything but a mirror of the design reflects does not count.
    """
    ids = [row.path_id for row in t.paths if row.kind == "single scatter" and fnmatchcase(row.scatter_1, pattern)]
    return Estimate(*t.paths.power(ids)) if ids else None


def _reflecting(row: PathRow) -> list[str]:
    return [name for name, event in row.event_list if event in REFLECTED]


def _without(names: list[str], design: list[str]) -> list[str]:
    """Return names of reflecting surfaces less those in the image's own path, one occurrence for each."""
    left = list(design)
    kept = []
    for name in names:
        if name in left:
            left.remove(name)
        else:
            kept.append(name)
    return kept


def extent(hits: np.ndarray) -> Estimate:
    """
    Return the distance between the outermost hits of light with an edge, and a bound of its standard error.

    The outermost of n hits lie short of the edge by c / n^p on average, and scatter by about as much. p is 1 where the
    light, projected, ends at its full density, 2/3 for a disc, and 1/2 for a corner, the slowest. The extents of 16
    disjoint subsets of the hits are smaller and scatter more. With p = 1/2, what the mean of theirs lacks is at least
    three times what the extent of all hits lacks of the true one, and their standard deviation four times its own.

    Parameters
    ----------
    hits : (n,) float64
        Coordinates of the hits along one axis, mm.

    Returns
    -------
    Estimate
        Extent and its standard error, mm; both are NaN for fewer than 256 hits.
    """
    if len(hits) < SUBSETS * LEAST_HITS:
        return UNKNOWN
    whole = float(np.ptp(hits))
    shuffled = np.random.default_rng(0).permutation(hits)
    parts = np.array([np.ptp(shuffled[k::SUBSETS]) for k in range(SUBSETS)])
    short = (whole - parts.mean()) / (SUBSETS**0.5 - 1)
    return Estimate(whole, float(np.hypot(short, parts.std(ddof=1) / SUBSETS**0.5)))

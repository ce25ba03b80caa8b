"""Numbers to compare that a trace of a scene gives: of its image, of a ghost, or a PST (point source transmittance).

A path is named by the surfaces that reflect its light, without those that reflect the light of the image. Of several
such paths it is the strongest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.errors import MistrayError, nearest
from mistray.estimate import UNKNOWN, Estimate
from mistray.metrics.scene_values import assign
from mistray.scene import load
from mistray.trace import trace
from mistray.trace.paths import PathRow
from mistray.trace.result import Trace

FAINTEST = 1e-9  # flux of a ray relative to a start ray, below which it is cut
OUTERMOST_RAYS = 20_000  # whose hits give a diameter
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
        self._traces: dict[tuple[Any, ...], Trace] = {}

    def __call__(self, row: DeclaredRow) -> Estimate | None:
        """Return mistray's number for a row and its standard error; None if no light takes the row's path."""
        if row.quantity == "pst":
            return self._pst(row)
        reflections = max([2, *(len(one.path) for one in self._file.rows)])
        if row.quantity.startswith("diameter"):
            t = self._trace(row, max(len(row.path), 1), OUTERMOST_RAYS)
            found = named_path(t, row.path)
            return None if found is None else _diameter(t, found, row.quantity)
        t = self._trace(row, reflections, self._rays)
        found = named_path(t, row.path)
        return None if found is None else Estimate(*(float(getattr(found, key)) for key in OF_PATH[row.quantity]))

    def scene(self, row: DeclaredRow) -> mi.Scene:
        """Return the scene with its parameters set as the file and the row ask."""
        values = {**(self._file.set or {}), **(row.set or {})}
        key = tuple(sorted(values.items()))
        if key not in self._scenes:
            own = self._file.folder / self._file.scene
            loaded = load(own if own.is_file() else self._file.scene)
            if values:
                set_values(loaded, values)
            self._scenes[key] = loaded
        return self._scenes[key]

    def _trace(self, row: DeclaredRow, reflections: int, rays: int) -> Trace:
        values = tuple(sorted((row.set or {}).items()))
        key = (values, row.field_deg, row.azimuth_deg, row.wavelength_nm, reflections, rays)
        if key not in self._traces:
            self._traces[key] = trace(
                self.scene(row),
                rays=rays,
                seed=self._seed,
                field_deg=row.field_deg,
                azimuth_deg=row.azimuth_deg,
                wavelength_nm=row.wavelength_nm,
                max_reflections=reflections,
                flux_threshold=FAINTEST,
            )
        return self._traces[key]

    def _pst(self, row: DeclaredRow) -> Estimate:
        from mistray.analyses.pst.run import pst

        light = {} if row.wavelength_nm is None else {"wavelength_nm": row.wavelength_nm}
        found = pst(self.scene(row), [row.field_deg or 0.0], rays=self._rays, seed=self._seed, **light)
        value, se = found.curve()
        return Estimate(float(value[0]), float(se[0]))


def set_values(scene: mi.Scene, values: Mapping[str, float]) -> None:
    """Set parameters of a scene by their keys; raise `MistrayError` for a key that the scene has not."""
    params = mi.traverse(scene)
    known = [str(key) for key in params.keys()]  # noqa: SIM118  SceneParameters is no mapping
    for key in values:
        if key not in known:
            raise MistrayError(f"set: the scene has no parameter '{key}'; {nearest(key, known)}")
    assign(params, {key: np.array([value]) for key, value in values.items()})


def named_path(t: Trace, surfaces: Sequence[str]) -> PathRow | None:
    """Return the strongest path of a trace that the named surfaces reflect; None if there is none."""
    image = next((row for row in t.paths if row.order == 0), None)
    design = _reflecting(image) if image is not None else []
    rows = [row for row in t.paths if _without(_reflecting(row), design) == list(surfaces)]
    return max(rows, key=lambda row: row.power_W, default=None)


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


def _diameter(t: Trace, row: PathRow, quantity: str) -> Estimate:
    """Return the extent of a path's hits along x or y, mm; its standard error is the outermost gaps at both ends."""
    column = f"detector_{quantity.removeprefix('diameter_')}"
    hits = np.sort(t.rays(f"path_id == {row.path_id}", n=None)[column].to_numpy())
    if len(hits) < 3:
        return UNKNOWN
    return Estimate(float(np.ptp(hits)), math.hypot(hits[-1] - hits[-2], hits[1] - hits[0]))

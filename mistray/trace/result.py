"""Result of a forward trace: irradiance, paths, energy ledger, and more tables and maps by tracing its rays again."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.execute.scene_task import SceneTask
from mistray.execute.tracer import Run
from mistray.gradients.run_gradient import run_gradient
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.messages import fewer_rays
from mistray.notes import Note
from mistray.recorders.film import Pixels
from mistray.recorders.path_derivative import MOMENTS, HitDerivative, PathDerivative
from mistray.recorders.recorder import Recorder
from mistray.recorders.tallies import SCATTERED_FLUX, SCATTERED_HITS, SCATTERED_SQUARES, SEGMENTS
from mistray.result import KeyNumber, Result
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.thin_gaps import thin_gaps
from mistray.trace.energy import Energy, FluxReport, energy_ledger, flux_report
from mistray.trace.path_images import irradiance_of_runs
from mistray.trace.paths import PathTable, path_table
from mistray.trace.photometry import illuminance, luminous_flux
from mistray.trace.reliability import aimed_surfaces, silent_places, trace_notes, undeclared_images
from mistray.trace.traced_again import TracedAgain

if TYPE_CHECKING:
    import xarray


class Trace(
    TracedAgain, Result, table="..toolkit.tables.traces:trace_table", figure="..toolkit.figures.traces:trace_figure"
):
    """
    Result of `mistray.trace`: irradiance, paths, energy ledger and flux at surfaces, with standard errors.

    Attributes
    ----------
    settings : dict
        Everything that determines the result: arguments, scene, variant, versions. "polarization" is the mode of the
        trace, "polarization_reason" the reason for it, "polarization_change" the largest relative change by Stokes
        vectors.
    rays_traced, rays_planned : int
        Numbers of start rays that were traced and planned. Fewer were traced if the time was up, the trace was
        interrupted, or workers were lost.
    paths : PathTable
        Paths from the sources to the detectors, the strongest first; traced with ``ledger=False`` there are none, and
        reading them raises `MistrayError`.
    energy : Energy
        Energy ledger: where the launched flux went, W.
    surfaces : FluxReport
        Hits, incident and absorbed flux, W, at every surface.
    irradiance, irradiance_se : (height, width) float64
        Absorbed flux density of the detector and its standard error, W/mm²; row 0 is at the smallest y. Reading them
        raises `MistrayError` if the trace has several detectors, see `on`. The error comes from the spread of 32
        batches of start rays, or of 16 or 8 groups of them where the detector has more than 65 536 or 131 072 pixels.
        So several hits of a pixel by light of one start ray are one sample. From 32 batches an error is known to 13 %,
        from 8 to 27 %. It is NaN where too few rays meet a pixel, see `mistray.recorders.film.Pixels.few_rays`.
    coating_error : float
        Bound of the error of R and T, 0 … 1, by interpolation over the angle of incidence, for the worst coating.
    scattered_rays_per_start : float
        Number of hits of the detector by scattered rays, per start ray.
    largest_ray_share : float
        Largest share that one of those hits has of their flux, 0 … 1; NaN if there are none.
    effective_scattered_rays : float
        (Σ flux)²/Σ flux² of those hits: so many hits of equal flux have the same relative error.
    own_notes : list of Note
        Notes on the scene, its sources and the rays: gaps too thin for float32, see `mistray.surfaces.thin_gaps`; media
        treated as opaque because no light gets through their bodies; an unfinished trace; a detector that has no design
        path and gets nearly all of its light by one path; a detector without light at the sources' own field.
    aiming : list of AimedSurface
        Surfaces and media that aimed rays at targets.
    silent : list of SilentPlace
        Surfaces and media that scatter and got light, but sent nothing to the detector in this trace, each with its
        share of the launched flux; the one with most light first. Empty if traced with ``ledger=False``.
    recorders : dict of str to Recorder
        Named recorders of the trace, such as probes, by name.
    runs : list of Run
        Sums of the trace by source and wavelength, and all that it takes to trace their rays again.
    task : SceneTask or None
        Task from which workers build the same runs, see `mistray.distribute`; None if no workers traced.
    has_paths : bool
        Whether there is a path table, see `paths`.
    segments : int
        Number of ray segments that were traced.
    seconds : float
        Time in the kernel, s: neither recording nor compiling it counts.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> print(f"{len(t.paths)} paths, stray light {mistray.report.with_error(t.paths.stray_W)} W")
    16 paths, stray light 1.561 ± 0.013 W
    """

    def __init__(self, runs: list[Run], settings: dict[str, Any], task: SceneTask | None = None) -> None:
        self.runs, self.task = runs, task
        self.settings = settings
        self.recorders: dict[str, Recorder] = {}
        self.rays_traced = round(sum(float(run.started.sum()) for run in runs))
        self.rays_planned = sum(run.rays for run in runs)
        self.has_paths = all(run.sums.paths is not None for run in runs)
        self.surfaces = flux_report(runs)
        self.energy = energy_ledger(runs, self.surfaces)
        self.coating_error = max(run.table.optics.error for run in runs)
        hits, flux, squares = (
            sum(run.unit**power * float(run.sums.channels[channel].sum()) for run in runs)
            for power, channel in enumerate((SCATTERED_HITS, SCATTERED_FLUX, SCATTERED_SQUARES))  # Σ wᵏ, k = 0, 1, 2
        )
        self.scattered_rays_per_start = hits / self.rays_traced
        self.largest_ray_share = max(run.unit * run.sums.largest for run in runs) / flux if flux > 0 else float("nan")
        self.effective_scattered_rays = flux**2 / squares if squares > 0 else 0.0
        self.own_notes = thin_gaps(runs[0].table)  # the geometry is the same at all wavelengths
        self.own_notes += dict.fromkeys(note for run in runs for note in run.table.optics.notes)
        if self.rays_traced != self.rays_planned:
            self.own_notes.append(fewer_rays(self.rays_traced, self.rays_planned))
        self.own_notes += undeclared_images(self) if self.has_paths else []
        self.aiming, self.silent = aimed_surfaces(runs), silent_places(runs)
        self.segments = round(sum(float(run.sums.channels[SEGMENTS].sum()) for run in runs))
        self.seconds = sum(run.sums.seconds for run in runs)

    def __getstate__(self) -> dict[str, Any]:
        # With the path table, since there are processes that cannot make the runs again
        return self.__dict__ | ({"paths": self.paths} if self.has_paths else {})

    @property
    def notes(self) -> list[Note]:
        """Notes on the reliability of the trace; `trace` raises them as warnings, see docs/warnings.md."""
        return [note for _, note in trace_notes([self])]

    @cached_property
    def paths(self) -> PathTable:
        """
        Table of the paths from the sources to the detectors, the strongest first.

        Raises
        ------
        MistrayError
            If it was traced with ``ledger=False``, or interrupted when there were too many to read them at once.
        """
        if not self.has_paths:
            raise MistrayError(
                "this trace has no path table; trace with ledger=True, and do not interrupt it if it has many paths"
            )
        return path_table(self.runs)

    @property
    def pupil_W(self) -> float:
        """
        Launched flux to which relative results refer, W.

        For a beam whose ``pupil_area`` is stated it is the flux through that area: the beam of an imported lens is
        wider than its aperture. Else it is all flux of the sources.
        """
        return float(sum(run.source.pupil_power for run in self.runs))

    @property
    def detectors(self) -> list[str]:
        """Ids of the detectors of the trace, in the scene's order."""
        table = self.runs[0].table
        return [table.ids[i] for i in table.detectors]

    def on(self, detector: str) -> Trace:
        """
        Return the result for one detector alone: its irradiance, its paths and its energy ledger.

        Only those methods trace again that always do (`maps`, `box`, `history`, `rays`, gradients). Light that the
        other detectors absorb then counts as absorbed by surfaces. The result has no recorders. With a single detector,
        it is this trace.

        Parameters
        ----------
        detector : str
            One of `detectors`.

        Raises
        ------
        MistrayError
            For another name.
        """
        table = self.runs[0].table
        if detector not in self.detectors:
            raise MistrayError(f"'{detector}' is not a detector of this trace; choose from {', '.join(self.detectors)}")
        number = table.ids.index(detector)
        if len(table.detectors) == 1:
            return self
        tables = {id(run.table): run.table.on(number) for run in self.runs}  # sources of one wavelength share a table
        runs = [run.on(number, tables[id(run.table)]) for run in self.runs]
        return Trace(runs, self.settings | {"detector": detector}, self.task).of_scene(self.scene_name)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """
        Bounds of `irradiance` in the detector's frame: x0, x1, y0, y1, mm.

        Raise as `irradiance` does.
        """
        return self.runs[0].table.film()[2]

    @property
    def irradiance(self) -> np.ndarray:
        """
        Absorbed flux density on the detector, (height, width), W/mm²; row 0 is at the smallest y.

        Raise `MistrayError` for a trace of several detectors; `on` returns that of one.
        """
        return self._map[0]

    @property
    def irradiance_se(self) -> np.ndarray:
        """
        Standard error of `irradiance`, (height, width), W/mm²; NaN where too few rays meet a pixel.

        Raise as `irradiance` does.
        """
        return self._map[1]

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        return self.light.with_se

    @property
    def light(self) -> Pixels:
        """
        Absorbed flux density of all light on the detector with its noise, (height, width), W/mm².

        Raise as `irradiance` does.
        """
        return irradiance_of_runs(self.runs, [run.film for run in self.runs])

    @property
    def wavelengths_nm(self) -> list[float]:
        """Wavelengths of the trace, ascending, nm."""
        return sorted({run.source.wavelength_nm for run in self.runs})

    def _runs_at(self, wavelength_nm: float) -> list[Run]:
        runs = [run for run in self.runs if run.source.wavelength_nm == wavelength_nm]
        if not runs:
            known = ", ".join(f"{value:g}" for value in self.wavelengths_nm)
            raise MistrayError(f"{wavelength_nm:g} nm was not traced; this trace has {known} nm")
        return runs

    def write_irradiance(self, path: str | Path) -> None:
        """
        Write `irradiance` and `irradiance_se` as .fits, .exr (both extra ``images``) or .npy, as the name ends.

        See `mistray.files.irradiance_files` for the contents of the files, and `write_irradiance` there for errors.
        """
        from mistray.files.irradiance_files import IrradianceMap, write_irradiance

        write_irradiance(IrradianceMap.of(self), path)

    def to_xarray(self) -> xarray.Dataset:
        """
        Return the irradiance as arrays with named axes, standard errors and units; needs the extra ``xarray``.

        Returns
        -------
        xarray.Dataset
            ``irradiance`` over y and x, and ``irradiance_by_wavelength`` over wavelength, y and x, each with its
            standard error under the name with ``_se``; W/mm². Coordinates: the centres of the pixels in the frame of
            the detector, mm, and the wavelengths, nm. The detector is that of `irradiance`, see `on`.

        Raises
        ------
        MistrayError
            If xarray is not installed, or the trace has several detectors.
        """
        from mistray.files.labelled import irradiance_dataset

        return irradiance_dataset(self)

    @cached_property
    def illuminance(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Illuminance of the detector by absorbed light and its standard error, (height, width) each, lx.

        Raise `MistrayError` if no wavelength is visible, or for a trace of several detectors.
        """
        return illuminance(self.runs).with_se

    @property
    def luminous_flux(self) -> tuple[float, float]:
        """
        Luminous flux that the detectors absorb and its standard error, lm.

        Raise `MistrayError` if no wavelength is visible.
        """
        return luminous_flux(self.runs)

    def irradiance_at(self, wavelength_nm: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the irradiance at one wavelength of the trace, nm; those of all wavelengths add up to `irradiance`.

        Returns
        -------
        irradiance, standard_error : (height, width) float64
            Irradiance of each pixel and its standard error, W/mm².

        Raises
        ------
        MistrayError
            If the wavelength was not traced, or the trace has several detectors.
        """
        runs = self._runs_at(wavelength_nm)
        return irradiance_of_runs(runs, [run.film for run in runs]).with_se

    def energy_at(self, wavelength_nm: float) -> Energy:
        """
        Return the energy ledger of the light of one wavelength, nm.

        A wavelength that was not traced raises `MistrayError`.
        """
        runs = self._runs_at(wavelength_nm)
        return energy_ledger(runs, flux_report(runs))

    def energy_of(self, source: str) -> Energy:
        """
        Return the energy ledger of the light of one source, given by its name in the path table.

        Raises
        ------
        MistrayError
            If the trace has no source of that name.
        """
        runs = [run for run in self.runs if run.source.name == source]
        if not runs:
            names = ", ".join(dict.fromkeys(run.source.name for run in self.runs))  # a run for each wavelength
            raise MistrayError(f"source '{source}' is not one of the trace; it has {names}")
        return energy_ledger(runs, flux_report(runs))

    def surfaces_at(self, wavelength_nm: float) -> FluxReport:
        """
        Return the flux at every surface, W, of the light of one wavelength, nm.

        A wavelength that was not traced raises `MistrayError`.
        """
        return flux_report(self._runs_at(wavelength_nm))

    @property
    def tables(self) -> list[SurfaceTable]:
        """Surface tables of the trace as the kernel reads them, one per wavelength, in ascending order."""
        tables = {run.source.wavelength_nm: run.table for run in self.runs}
        return [tables[wavelength] for wavelength in sorted(tables)]

    def table_gradients(self, derivative: HitDerivative, request: GradientRequest) -> Iterator[TableGradient]:
        """
        Yield the requested derivatives of a metric with respect to scene parameters, by tracing the same rays again.

        Parameters
        ----------
        derivative : HitDerivative
            Derivative of the metric with respect to the flux of the hits of the detector.
        request : GradientRequest
            Requested derivatives.

        Yields
        ------
        TableGradient
            Derivatives for each source and wavelength on which the metric depends.

        Raises
        ------
        MistrayError
            If not all planned rays were traced.
        """
        if self.rays_traced != self.rays_planned:
            raise MistrayError(
                f"only {self.rays_traced} of {self.rays_planned} rays were traced; gradients need all of them"
            )
        path, maps = derivative.path, derivative.map_of_path
        of_runs = None if path is None and maps is None else self.paths.located()
        for number, run in enumerate(self.runs):
            # Chain rule: from the metric's derivative by W to that by the flux of a start ray
            pixel = None if derivative.pixel is None else run.unit * np.asarray(derivative.pixel, dtype=np.float64)
            by_path = None
            if of_runs is not None:
                own = of_runs[number]
                by_path = PathDerivative.of_paths(
                    own.keys,
                    own.slots,
                    run.unit * np.asarray(path)[own.ids] if path is not None else np.zeros((len(own.ids), MOMENTS)),
                    np.asarray(maps)[own.ids] if maps is not None else np.zeros(len(own.ids), dtype=np.int64),
                )
            # Runs that the metric does not depend on are not traced again
            if pixel is not None and not pixel.any():
                pixel = None
            if pixel is None and (by_path is None or not by_path.coefficients.any()):
                continue
            started = time.perf_counter()
            raw = run_gradient(run, by_path, pixel, request)
            raw.seconds = time.perf_counter() - started
            yield raw

    def key_numbers(self) -> dict[str, KeyNumber]:
        """
        Return detected and stray flux (W) and the number of paths, by label.

        The rays traced are added if some are missing, and the largest loss if all is dark. Without a path table there
        is no stray flux.
        """
        found: dict[str, KeyNumber] = {}
        if self.rays_traced != self.rays_planned:
            found["unfinished"] = f"{self.rays_traced} of {self.rays_planned} rays"
        found["detected [W]"] = Estimate(self.energy.detected_W, self.energy.detected_se_W)
        if self.rays_traced and self.energy.detected_W == 0:
            found["lost"] = self.energy.greatest_loss
        if not self.has_paths:
            return found | {"paths": "not kept"}
        return found | {"stray [W]": self.paths.stray_W, "paths": len(self.paths)}

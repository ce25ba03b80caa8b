"""
Photometry: luminous flux (lm) and illuminance (lx), by the luminous efficiency of each wavelength that is traced.

``Φ_v = K_m Σ V(λ_i) Φ_i`` with K_m = 683.002 lm/W and V(λ) of the CIE 1924 observer for daylight vision, 2° (ISO
23539:2023). A wavelength that stands for a band has the V of the wavelength.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.execute.tracer import Run
from mistray.recorders.film import Pixels
from mistray.recorders.flux_maps.cells import MM2_PER_M2
from mistray.recorders.sampled import sum_of_runs
from mistray.recorders.tallies import ABSORBED_HERE
from mistray.sampling.sources import source_emitters
from mistray.spectra.cie import VISIBLE_NM, luminous_efficacy


def check_light(scene: mi.Scene, wavelength_nm: Sequence[float] | None) -> None:
    """
    Raise `MistrayError` if lumen and lux make no sense: a source states no wavelength, or none is visible.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    wavelength_nm : sequence of float, optional
        Wavelengths that are traced, nm; by default those of the sources.
    """
    if wavelength_nm is not None:
        check_visible(wavelength_nm)
        return
    for emitter in source_emitters(scene):
        # The default wavelength of a source is no statement about its light
        if not emitter.states_light:
            raise MistrayError(
                f"source '{emitter.name}' states no wavelength or spectrum, so its light has no lm; give "
                "--wavelength-nm, or spectrum= to the source"
            )
    check_visible([float(nm) for emitter in source_emitters(scene) for nm in emitter.wavelengths_nm])


def check_visible(wavelengths_nm: Sequence[float]) -> None:
    """Raise `MistrayError` if none of these wavelengths, nm, is visible."""
    low, high = VISIBLE_NM
    if not any(low <= nm <= high for nm in wavelengths_nm):
        listed = ", ".join(f"{nm:g}" for nm in wavelengths_nm)
        raise MistrayError(
            f"no wavelength of {listed} nm is visible, {low:g} … {high:g} nm; trace one that is, or use W"
        )


def luminous_flux(runs: Sequence[Run]) -> tuple[float, float]:
    """
    Return the luminous flux absorbed by the detectors and its standard error, lm; the runs must not share rays.

    If no wavelength is visible, it raises `MistrayError`.
    """
    check_visible([run.source.wavelength_nm for run in runs])
    by_batch = [
        luminous_efficacy(run.source.wavelength_nm) * run.sums.surfaces[run.table.detectors, ABSORBED_HERE].sum(axis=0)
        for run in runs
    ]
    value, se = sum_of_runs(by_batch, runs)
    return float(value), float(se)


def illuminance(runs: Sequence[Run]) -> Pixels:
    """
    Return the illuminance map of the detector with its noise, (height, width), lx, from the absorbed flux.

    It raises `MistrayError` if no wavelength is visible, or if there are several detectors.
    """
    check_visible([run.source.wavelength_nm for run in runs])
    pixel_m2 = runs[0].pixel_area / MM2_PER_M2
    first, *others = (
        Pixels.of_film(run.film, run.started, luminous_efficacy(run.source.wavelength_nm) * run.unit / pixel_m2)
        for run in runs
        # Invisible light adds nothing to the sum
        if luminous_efficacy(run.source.wavelength_nm) > 0
    )
    return sum(others, start=first)

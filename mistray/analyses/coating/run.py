"""Evaluation of a coating by wavelength and angle, and of the coatings on the surfaces of a scene."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mistray.analyses.coating.figures import CoatedSurfaces, coated_surfaces
from mistray.analyses.coating.request import CoatingRequest
from mistray.coatings import PRESETS, CoatingModel, CoatingSpectrum, coating_from_text, spectrum
from mistray.coatings.stack import outside_first
from mistray.errors import MistrayError
from mistray.materials import complex_index

VISIBLE_NM = (400.0, 700.0)
VISIBLE_TO_NM, POINTS = 780.0, 61


@dataclass(frozen=True)
class CoatingResult:
    """
    Reflectance, transmittance and absorptance of a coating between two materials, by wavelength and angle.

    Attributes
    ----------
    request : CoatingRequest
        Request with its defaults filled in.
    coating : CoatingModel
        Coating that was evaluated.
    values : CoatingSpectrum
        R, T and A, 0 … 1, by wavelength (nm), angle (degrees) and polarisation.
    """

    request: CoatingRequest
    coating: CoatingModel
    values: CoatingSpectrum


@dataclass(frozen=True)
class SurfacesResult:
    """
    Mean reflectances of the coatings on the surfaces of a scene.

    Attributes
    ----------
    request : CoatingRequest
        Request with its wavelengths filled in.
    means : list of tuple of CoatedSurfaces and list of float
        Groups of surfaces, each with its reflectances, 0 … 1, one for each angle of the request: means over the
        wavelengths and over s and p. The light comes from the side of lower index.
    """

    request: CoatingRequest
    means: list[tuple[CoatedSurfaces, list[float]]]


def run_coating(request: CoatingRequest) -> CoatingResult:
    """Return R, T and A, 0 … 1, of a coating by wavelength and angle; by default an infrared preset is on germanium."""
    coating, design = coating_from_text(request.coating, request.design_nm), PRESETS.get(request.coating)
    design_nm, body, band = request.design_nm, "N-BK7", VISIBLE_NM
    if design is not None and design.design_nm > VISIBLE_TO_NM:
        design_nm, body = design.centre_nm(design_nm), "Ge"
        band = design.band[0] * design_nm, design.band[1] * design_nm
    back = request.back or body
    full = replace(_lit(request, band), back=back, design_nm=design_nm)
    values = spectrum(coating, full.wavelength_nm, full.angles_deg, full.front, back, not full.from_back)
    return CoatingResult(full, coating, values)


def run_surfaces(scene: Any, request: CoatingRequest) -> SurfacesResult:
    """
    Return mean reflectances of a scene's coatings, 0 … 1.

    By default the mean is from 400 to 700 nm, or over the band of the first source if all of it is beyond 780 nm.
    """
    light = next((getattr(emitter, "wavelengths_nm", ()) for emitter in scene.emitters()), ())
    invisible = len(light) > 0 and min(light) > VISIBLE_TO_NM
    full, means = _lit(request, (min(light), max(light)) if invisible else VISIBLE_NM), []
    lam = full.wavelength_nm
    for surface in coated_surfaces(scene):
        sides = surface.front, surface.back
        from_front = outside_first(*(complex_index(material, lam[0]) for material in sides))
        values = spectrum(surface.coating, lam, full.angles_deg, *sides, from_front)
        means.append((surface, values.mean().mean(axis=0).tolist()))
    return SurfacesResult(full, means)


def _lit(request: CoatingRequest, band: tuple[float, float]) -> CoatingRequest:
    """Return the coating request with its own wavelengths, or with 61 spread over `band`, nm: one for a line."""
    own = np.unique(np.linspace(*band, POINTS)).tolist()
    return replace(request, wavelength_nm=request.wavelength_nm or own)


def is_scene(text: str) -> bool:
    """True if a text names a scene: an XML file, a folder with one, or a shipped scene; a coating's name goes first."""
    is_layers_or_table = any(part in text.lower() for part in (" ", ".csv", ".dat")) and not os.path.isdir(text)
    if text in PRESETS or text == "bare" or is_layers_or_table:
        return text.lower().endswith(".xml")
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    from mistray.scene.load import find

    try:
        find(text)
    except MistrayError:
        return text.lower().endswith(".xml")
    return True

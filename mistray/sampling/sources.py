"""Sources of a scene: lookup of the emitters and construction of their start rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, PLACE_MM, WAVELENGTHS_NM, WEIGHTS, shown
from mistray.sampling.mitsuba_sources import mitsuba_source
from mistray.sampling.source import SceneSource, SourceRequest
from mistray.spectra.spectrum import DEFAULT_NM, of_lines
from mistray.surfaces.surfaces import solid_shapes

NO_SOURCE = "the scene has no source; add an emitter, such as 'collimated' or 'point_source'"


def source_emitters(scene: mi.Scene) -> list[Any]:
    """
    Return the source plugins of a scene; Mitsuba's own emitters are replaced by sources of the same light.

    Raises
    ------
    MistrayError
        If one of Mitsuba's own emitters cannot be traced.
    """
    emitters = enumerate(scene.emitters(), start=1)
    return [emitter if hasattr(emitter, "sources") else mitsuba_source(emitter, number) for number, emitter in emitters]


def scene_sources(
    scene: mi.Scene,
    field_deg: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: Any = None,
    weights: Any = None,
) -> list[SceneSource]:
    """
    Return the sources of a scene that are to be traced, one for each emitter and wavelength with light.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    field_deg, azimuth_deg : float, optional
        Field angle and azimuth, degrees, that replace the emitters' own; None: the emitters' own.
    wavelength_nm : float or sequence of float, optional
        Wavelengths, nm, that replace the emitters' own.
    weights : sequence of float, optional
        Shares of the flux, one for each of `wavelength_nm`; normalised. By default all are equal.

    Raises
    ------
    MistrayError
        If there is no source, a source has no power or an infinite one, a field angle or azimuth is out of range, or
        for the reasons of `spectrum`.
    """
    # Check before any source is built
    emitters = source_emitters(scene)
    if not emitters:
        raise MistrayError(NO_SOURCE)
    if field_deg is not None:
        FIELD_DEG.check("field_deg", field_deg)
    if azimuth_deg is not None:
        AZIMUTH_DEG.check("azimuth_deg", azimuth_deg)
    given = None if wavelength_nm is None and weights is None else spectrum(wavelength_nm, weights)
    # Bounds of what light can meet: targets are shapes too, but no surfaces
    bounds = mi.ScalarBoundingBox3f()
    for shape in solid_shapes(scene):
        bounds.expand(shape.bbox())
    # One source for each emitter and wavelength
    result: list[SceneSource] = []
    for number, emitter in enumerate(emitters, start=1):
        name = emitter.name or f"source_{number}"
        lines = given or (emitter.wavelengths_nm, emitter.weights)
        found = emitter.sources(SourceRequest(name, scene, bounds, field_deg, azimuth_deg, *lines))
        # A source without light, or with an infinite flux, leaves no finite shares of the rays
        power = sum(source.power for source in found)
        if not 0 < power < np.inf:
            remedy = "it sends no light, change its numbers" if power == 0 else "give a smaller irradiance or beam"
            raise MistrayError(f"source '{name}' has a power of {power} W; {remedy}")
        result += [source for source in found if source.power > 0]
    return result


def field_of(scene: mi.Scene, height_mm: float) -> float:
    """
    Return the field angle, degrees, of an object point at `height_mm` along y of a near source's object plane.

    Raises
    ------
    MistrayError
        If the height is out of range, the scene has no source, its light comes from infinity, or its sources stand in
        different planes.
    """
    PLACE_MM.check("field_mm", height_mm)
    # Rounded, so that sources in one plane agree in spite of float64
    found = {round(emitter.field_of(height_mm), 9) for emitter in source_emitters(scene)}
    if not found:
        raise MistrayError(NO_SOURCE)
    if len(found) > 1:
        raise MistrayError("field_mm: the sources of the scene stand in different planes; give field_deg")
    return found.pop()


def field_axes(scene: mi.Scene) -> np.ndarray:
    """Return the axes x, y, z of field angles as columns, (3, 3) float64: of the first source, else of the world."""
    for emitter in source_emitters(scene):
        return np.asarray(emitter.matrix[:3, :3], dtype=np.float64)
    return np.eye(3)


def spectrum_of(
    scene: mi.Scene, wavelength_nm: float | Sequence[float] | None, weights: float | Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return wavelengths, nm, and fractions of the flux, (n,) each: as given, else of the first source, else 550 nm.

    Wavelengths without flux are left out: they need no rays.
    """
    lines, shares = np.array([DEFAULT_NM]), np.ones(1)
    if wavelength_nm is not None or weights is not None:
        lines, shares = spectrum(wavelength_nm, weights)
    elif emitters := source_emitters(scene):
        lines, shares = emitters[0].wavelengths_nm, emitters[0].weights
    return lines[shares > 0], shares[shares > 0]


def spectrum(wavelength_nm: Any, weights: Any) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the given wavelengths, nm, and their weights scaled to a sum of 1, (n,) float64 each.

    Weights are equal by default.

    Raises
    ------
    MistrayError
        Without wavelengths, if one is given twice, or if a value or the number of weights is wrong.
    """
    if wavelength_nm is None:
        raise MistrayError("weights are given without wavelength_nm; give one wavelength for each weight")
    wavelengths = WAVELENGTHS_NM.check("wavelength_nm", wavelength_nm)
    if len(set(wavelengths)) < len(wavelengths):
        raise MistrayError(f"wavelength_nm is {shown(wavelength_nm)}; give every wavelength once")
    light = of_lines(wavelengths, None if weights is None else WEIGHTS.check("weights", weights))
    return light.wavelengths_nm, light.weights

"""The sources of a scene, as a trace starts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, WAVELENGTH_NM, WEIGHT
from mistray.sampling.source import SceneSource
from mistray.surfaces.surfaces import solid_shapes

DEFAULT_NM = 550.0  # where a scene has no source


@dataclass(frozen=True)
class SourceRequest:
    """
    What a trace asks of the plugin of a source, whose `sources` answers with a `SceneSource` for each wavelength.

    Attributes
    ----------
    name : str
        For tables: its id, or a number.
    bounds : mi.ScalarBoundingBox3f
        Of all shapes of the scene.
    field_deg, azimuth_deg : float or None
        Instead of the plugin's own.
    wavelengths_nm, weights : (n,) float64
        The shares of the flux add up to 1.
    """

    name: str
    bounds: mi.ScalarBoundingBox3f
    field_deg: float | None
    azimuth_deg: float | None
    wavelengths_nm: np.ndarray
    weights: np.ndarray


def source_emitters(scene: mi.Scene) -> list[Any]:
    """The emitters of a scene that a trace starts rays from: those of mistray, and of one's own."""
    return [emitter for emitter in scene.emitters() if hasattr(emitter, "sources")]


def scene_sources(
    scene: mi.Scene,
    field_deg: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: Any = None,
    weights: Any = None,
) -> list[SceneSource]:
    """
    The sources to trace: every one of a scene at every wavelength.

    Parameters
    ----------
    field_deg, azimuth_deg : float, optional
        Instead of the emitters' own.
    wavelength_nm : float or sequence of float, optional
        Instead of the emitters' own wavelengths.
    weights : sequence of float, optional
        Shares of the flux, one for each of `wavelength_nm`; normalised. By default all are equal.

    Raises
    ------
    MistrayError
        If there is no source, or a field angle, a wavelength or a weight is out of range.
    """
    emitters = source_emitters(scene)
    if not emitters:
        raise MistrayError("the scene has no source; add an emitter of type 'collimated'")
    if field_deg is not None:
        FIELD_DEG.check("field_deg", field_deg)
    if azimuth_deg is not None:
        AZIMUTH_DEG.check("azimuth_deg", azimuth_deg)
    given = None if wavelength_nm is None and weights is None else spectrum(wavelength_nm, weights)
    bounds = mi.ScalarBoundingBox3f()
    for shape in solid_shapes(scene):
        bounds.expand(shape.bbox())
    result: list[SceneSource] = []
    for number, emitter in enumerate(emitters, start=1):
        name = emitter.name or f"source_{number}"
        lines = given or (emitter.wavelengths_nm, emitter.weights)
        found = emitter.sources(SourceRequest(name, bounds, field_deg, azimuth_deg, *lines))
        power = sum(source.power for source in found)
        if not 0 < power < np.inf:
            remedy = "it sends no light, change its numbers" if power == 0 else "give a smaller irradiance or beam"
            raise MistrayError(f"source '{name}' has a power of {power} W; {remedy}")
        result += found
    return result


def field_axes(scene: mi.Scene) -> np.ndarray:
    """(3, 3) float64: columns x, y, z of the frame of field angles: that of the first source, else the world's."""
    for emitter in source_emitters(scene):
        return np.asarray(emitter.matrix[:3, :3], dtype=np.float64)
    return np.eye(3)


def spectrum_of(
    scene: mi.Scene, wavelength_nm: float | Sequence[float] | None, weights: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths (nm) and their shares: what is given, else those of the scene's first source, else 550 nm."""
    if wavelength_nm is None and weights is None:
        for emitter in source_emitters(scene):
            return emitter.wavelengths_nm, emitter.weights
        return np.array([DEFAULT_NM]), np.ones(1)
    return spectrum(wavelength_nm, weights)


def spectrum(wavelength_nm: Any, weights: Any) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths and normalised weights of a call."""
    if wavelength_nm is None:
        raise MistrayError("weights are given without wavelength_nm; give one wavelength for each weight")
    wavelengths = np.atleast_1d(np.asarray(wavelength_nm, dtype=np.float64))
    if not wavelengths.size:
        raise MistrayError("wavelength_nm is empty; give at least one")
    for wavelength in wavelengths:
        WAVELENGTH_NM.check("wavelength_nm", float(wavelength))
    if len(np.unique(wavelengths)) < len(wavelengths):
        raise MistrayError(f"wavelength_nm is {wavelength_nm}; give every wavelength once")
    shares = np.ones(len(wavelengths)) if weights is None else np.atleast_1d(np.asarray(weights, dtype=np.float64))
    if len(shares) != len(wavelengths):
        raise MistrayError(f"{len(shares)} weights for {len(wavelengths)} wavelengths; give one for each")
    for share in shares:
        WEIGHT.check("weights", float(share))
    if not shares.sum() > 0:
        raise MistrayError(f"weights are {weights}; give one above 0")
    return wavelengths, shares / shares.sum()

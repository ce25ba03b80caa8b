"""At which wavelengths optics are traced so that what they emit in a band is known."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.coatings import METAL_K, Stack
from mistray.errors import MistrayError
from mistray.physics import planck
from mistray.ranges import WAVELENGTH_UM
from mistray.surfaces.optics import unpolarized_shares

if TYPE_CHECKING:
    import mitsuba as mi

DISPERSIVE = 3  # wavelengths where something depends on them
SAME = 1e-9  # relative difference of what counts as constant
PROBED_R, PROBED_COSINES = np.array([1e-4, 1e-2, 0.3]), np.array([1.0, 0.8, 0.5, 0.2])


def band_weights(temperature_K: float, band_um: tuple[float, float], wavelengths_um: Sequence[float]) -> np.ndarray:
    """
    Weights with which values at some wavelengths add up to their integral with Planck's spectrum over a band.

    Parameters
    ----------
    temperature_K : float
    band_um : (float, float)
    wavelengths_um : (m,) sequence of float
        Ascending. Between them a value is linear, beyond them constant.

    Returns
    -------
    (m,) float64
        W/(mm² sr), not negative; their sum is the radiance of a blackbody in the band.
    """
    nodes = np.asarray(wavelengths_um, dtype=np.float64)
    inside = nodes[(nodes > band_um[0]) & (nodes < band_um[1])]
    weights = np.zeros(len(nodes))
    for low, high in pairwise([band_um[0], *inside, band_um[1]]):
        waves, radiances = planck.band_nodes(temperature_K, low, high)
        weights += [float(radiances @ np.interp(waves, nodes, unit)) for unit in np.eye(len(nodes))]
    return weights


def traced_wavelengths(
    scene: mi.Scene, given: float | Sequence[float] | None, band_um: tuple[float, float]
) -> tuple[float, ...]:
    """
    The given wavelengths, or the middle of the band where nothing depends on them, else its ends and its middle, µm.

    Raises
    ------
    MistrayError
        If those given do not ascend, or a material or coating is not known at one of them.
    """
    low, high = band_um
    if given is None:
        waves = np.linspace(low, high, DISPERSIVE)
    else:
        waves = np.atleast_1d(np.asarray(given, dtype=np.float64))
        if not waves.size or np.any(np.diff(waves) <= 0):
            raise MistrayError(f"wavelengths_um is {given}; give one or more in ascending order")
        for wave in waves:
            WAVELENGTH_UM.check("wavelengths_um", float(wave))
    depends = False
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if not hasattr(bsdf, "complex_indices"):  # no optical surface
            continue
        found = []
        for wave in waves:
            try:
                found.append(_optics(bsdf, 1e3 * wave))
            except MistrayError as error:
                raise MistrayError(
                    f"surface '{shape.id()}' at {wave:g} µm: {error}; or give wavelengths_um (--wavelength-um) at "
                    "which all materials are known, what the optics emit there is then taken for the whole band"
                ) from None
        first = found[0]
        depends |= any(len(one) != len(first) or not np.allclose(one, first, rtol=SAME, atol=0) for one in found)
    if given is None and not depends:
        return (0.5 * (low + high),)
    return tuple(map(float, waves))


def _optics(bsdf: Any, wavelength_nm: float) -> np.ndarray:
    """Numbers of an interface that its emission depends on: refraction, absorption, coating, scatter."""
    sides: tuple[complex, complex] = (1 + 0j, 1 + 0j)
    if not bsdf.opaque or isinstance(bsdf.coating, Stack):
        front, back = bsdf.complex_indices(wavelength_nm)
        sides = complex(front), complex(back)
    opaque = bsdf.opaque or max(n.imag for n in sides) > METAL_K
    numbers = [*(n.real for n in sides), *(n.imag / wavelength_nm for n in sides)]
    for from_front in (True, False):
        shares = unpolarized_shares(bsdf.coating, wavelength_nm, sides, opaque, from_front, PROBED_COSINES)
        numbers += np.concatenate(shares).tolist()
        n_in, n_out = (n.real for n in (sides if from_front else sides[::-1]))
        for model in bsdf.scatter:
            for lobe in model.lobes(wavelength_nm, n_in, n_out, from_front):
                numbers += [*lobe.shares, *np.asarray(lobe.profile(PROBED_R)).tolist()]
    return np.array(numbers)

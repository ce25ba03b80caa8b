"""Choice of the wavelengths at which optics are traced, so that their emission in a band is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mistray.coatings import METAL_K, Stack
from mistray.coatings.table import CoatingTable
from mistray.errors import MistrayError
from mistray.materials import table_nodes_nm
from mistray.physics import planck
from mistray.ranges import WAVELENGTH_UM
from mistray.surfaces.optics import unpolarized_shares
from mistray.surfaces.surfaces import SurfaceTable

if TYPE_CHECKING:
    import mitsuba as mi

DISPERSIVE = 3  # wavelengths at first where something depends on them
MOST_WAVELENGTHS = 64
BAND_ERROR = 0.01  # relative, of the integral over the band
EVEN_NODES = 65  # across the band, beside those of tables
LENGTHS = np.array([1.0, 2.0, 4.0, 8.0, 16.0])  # in a body, in units of its thinnest place
OPEN_LENGTHS = np.array([1.0, 0.3, 0.1, 0.03, 0.01])  # where nothing closes it, in units of the scene's size
LEAST_SHARE = 1e-4  # of the band's light: relative to less no error counts
LEAST_PASSED = 0.03  # the same of what a body passes
SAME = 1e-9  # relative difference of what counts as constant
PROBED_R, PROBED_COSINES = np.array([1e-4, 1e-2, 0.3]), np.array([1.0, 0.8, 0.5, 0.2])
NUMBERS = 4 + 4 * len(PROBED_COSINES)  # of an interface before those of its scatter


def band_weights(
    temperature_K: float,
    band_um: tuple[float, float],
    wavelengths_um: npt.ArrayLike,
    *,
    derivative: bool = False,
    photons: bool = False,
) -> np.ndarray:
    """
    Return weights whose sum with values at some wavelengths is their integral over a band with Planck's spectrum.

    Parameters
    ----------
    temperature_K : float
        Temperature of the blackbody, K.
    band_um : (float, float)
        Ends of the band, µm.
    wavelengths_um : (m,) sequence of float
        Wavelengths, µm, ascending. Between them a value is linear, beyond them constant.
    derivative : bool
        Whether the spectrum is replaced by its derivative with respect to temperature, per K.
    photons : bool
        Whether the spectrum is of photons per second instead of watts.

    Returns
    -------
    (m,) float64
        Weights, W/(mm² sr), not negative; their sum is the radiance of a blackbody in the band. With `derivative` they
        are per K, and with `photons` in photons/s instead of W.
    """
    quadrature = planck.derivative_nodes if derivative else planck.band_nodes
    nodes = np.asarray(wavelengths_um, dtype=np.float64)
    inside = nodes[(nodes > band_um[0]) & (nodes < band_um[1])]
    weights = np.zeros(len(nodes))
    for low, high in pairwise([band_um[0], *inside, band_um[1]]):
        waves, radiances = quadrature(temperature_K, low, high)
        if photons:
            radiances = radiances * planck.photons_per_joule(waves)
        weights += [float(radiances @ np.interp(waves, nodes, unit)) for unit in np.eye(len(nodes))]
    return weights


@dataclass(frozen=True)
class TracedBand:
    """
    Wavelengths at which the optics are traced, and the error of their emission in a band.

    Attributes
    ----------
    wavelengths_um : tuple of float
        Traced wavelengths, µm, ascending.
    error : float
        Bound of the relative error of a band integral by linear interpolation between them, of what surfaces absorb,
        reflect and transmit and bodies absorb and pass; that of scatter is left out. 0 if none of this depends on the
        wavelength or nothing emits in the band, NaN if the optics are not known over the whole band.
    """

    wavelengths_um: tuple[float, ...]
    error: float


def traced_wavelengths(
    scene: mi.Scene,
    given: float | Sequence[float] | None,
    band_um: tuple[float, float],
    temperatures_K: Sequence[float] = (293.0,),
) -> TracedBand:
    """
    Return the given wavelengths, µm, or as many as determine the integral over the band to 1 %, with its error.

    The middle of the band suffices if nothing depends on the wavelength. Otherwise its ends and middle are taken,
    and then, one by one, nodes of the tables of materials and coatings and an even grid between them. The next lies
    where an absorbed, reflected or transmitted share is farthest from the line between its neighbours. There are at
    most `MOST_WAVELENGTHS`, and three if the optics are not known over the whole band.

    The integrals are those with the spectra of blackbodies at `temperatures_K`.

    Raises
    ------
    MistrayError
        If a given wavelength is out of range or they do not ascend, or a material or coating is not known at one of
        them. Without given wavelengths: at an end or the middle of the band.
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
    optical = {shape.id(): shape.bsdf() for shape in scene.shapes() if hasattr(shape.bsdf(), "complex_indices")}
    for name, bsdf in optical.items():
        for wave in waves:
            try:
                _optics(bsdf, 1e3 * wave)
            except MistrayError as error:
                raise MistrayError(
                    f"surface '{name}' at {wave:g} µm: {error}; or give wavelengths_um (--wavelength-um) at "
                    "which all materials are known, what the optics emit there is then taken for the whole band"
                ) from None
    nodes = _nodes(list(optical.values()), band_um)
    try:
        found = [[_optics(bsdf, 1e3 * wave) for wave in nodes] for bsdf in optical.values()]
    except MistrayError:  # not known somewhere between those that are given
        return TracedBand(tuple(map(float, waves)), math.nan)
    if all(len(one) == len(rows[0]) and np.allclose(one, rows[0], rtol=SAME, atol=0) for rows in found for one in rows):
        return TracedBand(tuple(map(float, waves)) if given is not None else (0.5 * (low + high),), 0.0)
    lengths = _lengths(scene, 1e3 * waves[0])
    does = [
        _shares(np.array([one[:NUMBERS] for one in rows]), lengths[name])
        for name, rows in zip(optical, found, strict=True)
    ]
    shares = np.concatenate([share for share, _ in does], axis=1)
    least = np.concatenate([floor for _, floor in does])
    every = (band_weights(kelvin, band_um, nodes) for kelvin in temperatures_K)
    weights = np.array([one for one in every if one.any()])  # at some kelvins a band has no light above 0
    if not len(weights):
        return TracedBand(tuple(map(float, waves)), 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    whole = np.maximum(weights @ shares, least)

    def errors(at: np.ndarray) -> np.ndarray:
        """Return each node's part of the relative error with wavelengths `at`, µm, (temperatures, nodes, shares)."""
        lines = np.stack([np.interp(nodes, at, np.interp(at, nodes, column)) for column in shares.T], axis=1)
        return np.asarray(weights[:, :, None] * np.abs(shares - lines) / whole[:, None])

    while True:
        parts = errors(waves)
        sums = parts.sum(axis=1)
        worst = float(sums.max())
        if given is not None or worst <= BAND_ERROR or len(waves) >= MOST_WAVELENGTHS:
            return TracedBand(tuple(map(float, waves)), worst)
        row, column = np.unravel_index(int(sums.argmax()), sums.shape)
        of_node = parts[row, :, column]
        interval = np.clip(np.searchsorted(waves, nodes, side="right"), 1, len(waves) - 1)
        chosen = interval == np.bincount(interval, of_node).argmax()
        apart = np.where(chosen, of_node / np.maximum(weights[row], 1e-300), -1.0)
        waves = np.sort(np.append(waves, nodes[int(apart.argmax())]))


def _nodes(bsdfs: Sequence[Any], band_um: tuple[float, float]) -> np.ndarray:
    """Return wavelengths, µm, within a band at which material and coating data are tabulated, and an even grid."""
    found = [np.linspace(*band_um, EVEN_NODES)]
    for bsdf in bsdfs:
        if not bsdf.opaque or isinstance(bsdf.coating, Stack):
            found += [1e-3 * np.array(table_nodes_nm(material)) for material in (bsdf.front, bsdf.back)]
        if isinstance(bsdf.coating, Stack):
            found += [1e-3 * np.array(table_nodes_nm(layer.material)) for layer in bsdf.coating.layers]
        if isinstance(bsdf.coating, CoatingTable):
            found.append(1e-3 * bsdf.coating.wavelength_nm)
    every = np.unique(np.concatenate(found))
    return every[(every >= band_um[0]) & (every <= band_um[1])]


def _lengths(scene: mi.Scene, wavelength_nm: float) -> dict[str, np.ndarray]:
    """
    Return sample lengths of rays, (2, m) mm, in the bodies in front of and behind each surface, by its id.

    They are `LENGTHS` times the least thickness of the body, at most the size of the scene; on an open side they are
    `OPEN_LENGTHS` times that size.
    """
    table = SurfaceTable(scene, wavelength_nm)
    found = {}
    for number, name in enumerate(table.ids):
        thinnest = table.bodies.thickness(number)[:, None]
        closed = np.minimum(thinnest * LENGTHS, table.bodies.size)
        found[name] = np.where(np.isfinite(thinnest), closed, table.bodies.size * OPEN_LENGTHS)
    return found


def _shares(numbers: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the shares of light at a surface and in its bodies, and for each the least value to which errors refer.

    Parameters
    ----------
    numbers : (nodes, n) float64
        Optical values of an interface at each node, see `_optics`.
    lengths : (2, m) float64
        Lengths of rays in the bodies before and behind the surface, mm.

    Returns
    -------
    (nodes, shares) float64
        Shares absorbed and passed by the bodies; reflected, transmitted and absorbed by the surface.
    (shares,) float64
        Least value of each share to which errors are relative.
    """
    depths = 4e6 * np.pi * numbers[:, 2:4, None] * lengths  # k/λ of both sides, 1/nm
    # From either side R and then T at each cosine
    sides = numbers[:, 4:].reshape(len(numbers), 2, 2, -1)
    parts = [-np.expm1(-depths), np.exp(-depths), sides, np.clip(1 - sides.sum(axis=2), 0, 1)]
    flat = [part.reshape(len(numbers), -1) for part in parts]
    floors = [LEAST_SHARE, LEAST_PASSED, LEAST_SHARE, LEAST_SHARE]
    least = np.concatenate([np.full(part.shape[1], floor) for part, floor in zip(flat, floors, strict=True)])
    return np.concatenate(flat, axis=1), least


def _optics(bsdf: Any, wavelength_nm: float) -> np.ndarray:
    """
    Return the quantities on which emission at an interface depends, (n,).

    They are n of front and back, k/λ of both (1/nm), R and T at each of `PROBED_COSINES` from the front and from the
    back, and shares and profiles of scatter.
    """
    sides: tuple[complex, complex] = (1 + 0j, 1 + 0j)
    if not bsdf.opaque or isinstance(bsdf.coating, Stack):
        front, back = bsdf.complex_indices(wavelength_nm)
        sides = complex(front), complex(back)
    opaque = bsdf.opaque or max(n.imag for n in sides) > METAL_K
    numbers = [*(n.real for n in sides), *(n.imag / wavelength_nm for n in sides)]
    scatter: list[float] = []
    for from_front in (True, False):
        shares = unpolarized_shares(bsdf.coating, wavelength_nm, sides, opaque, from_front, PROBED_COSINES)
        numbers += np.concatenate(shares).tolist()
        n_in, n_out = (n.real for n in (sides if from_front else sides[::-1]))
        for model in bsdf.scatter:
            for lobe in model.lobes(wavelength_nm, n_in, n_out, from_front):
                scatter += [*lobe.shares, *np.asarray(lobe.profile(PROBED_R)).tolist()]
    return np.array([*numbers, *scatter])

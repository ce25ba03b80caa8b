"""
Derivatives of R and T in coating tables with respect to layer parameters and adjacent indices, and their chain rule.

The rows are exact values of the coating at the nodes. The chain rule needs their derivatives with respect to the
thickness and the complex index of each layer. These come from Dr.Jit's forward mode through `mistray.physics.thinfilm`,
in float64, one lane for each row that was used and each parameter. An adjacent index moves the cosines at the nodes,
which are singular at the critical angle: derivatives with respect to it are central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import LAYER_PARAMETERS, METAL_K
from mistray.coatings.stack import Stack
from mistray.physics.thinfilm import reflectance_transmittance
from mistray.settings import BATCHES
from mistray.surfaces.optics import (
    OPAQUE,
    REFLECTION_BACK,
    REFLECTION_FRONT,
    TABLED,
    TRANSMISSION,
    Optics,
    node_cosines,
    refraction_rows,
    total_rows,
)
from mistray.surfaces.upload import upload

IDEAL_PARAMETERS = ("R", "T")
SHIFTS = ("n_front_shift", "n_back_shift")
# Wide, because at the critical angle a cosine of 0 has an error of 1e-8; a five-point formula makes up for it
INDEX_STEP, EQUAL_INDICES = 2e-3, 1e-9


def table_rows(optics: Optics, surface: int) -> slice:
    """Return the slice of coating-table rows that hold a surface's R and T, for refraction and total reflection."""
    first, _, total, last = (int(v) for v in optics.host_places[surface])
    return slice(first, total + last + 1)


def layered_surfaces(optics: Optics, is_chosen: Callable[[Any, str], bool]) -> Iterator[tuple[int, list[str]]]:
    """
    Yield the index of each surface whose layered coating has requested layer parameters, and the names of these.

    `is_chosen` is that of `layer_gradient`.
    """
    for i, bsdf in enumerate(optics.bsdfs):
        names = [name for name in LAYER_PARAMETERS if bsdf.film is not None and is_chosen(bsdf.film, name)]
        if names and int(optics.host_words[i]) & 3 == TABLED:
            yield i, names


def layer_gradient(
    optics: Optics, rows: np.ndarray, is_chosen: Callable[[Any, str], bool]
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Yield derivatives of a metric with respect to the layers of coatings, by batch of start rays.

    Parameters
    ----------
    optics : Optics
        Optics of the run that was traced.
    rows : (BATCHES, rows, CHANNELS) float64
        Derivatives with respect to the rows of the tables.
    is_chosen : callable
        Takes a plugin and a name; returns whether that derivative is requested.

    Yields
    ------
    owner, name, gradient
        The coating plugin, one of `LAYER_PARAMETERS`, and the derivatives by batch, (BATCHES, layers), in the metric's
        unit, per nm for a thickness. A coating is yielded once for each pair of materials beside it.
    """
    # Surfaces with the same coating between the same materials share a table, and its derivatives
    shared: dict[tuple[int, int], tuple[int, list[str], np.ndarray]] = {}
    for i, names in layered_surfaces(optics, is_chosen):
        own = rows[:, table_rows(optics, i), : TRANSMISSION + 1]
        key = id(optics.bsdfs[i].film), id(optics.tables[i])
        shared[key] = i, names, own + shared[key][2] if key in shared else own
    # Chain rule: derivatives by used rows times derivatives of these rows by the layers
    asked = [(i, np.flatnonzero(np.any(own.any(axis=0), axis=1)), names) for i, names, own in shared.values()]
    slopes = layer_row_derivatives(optics, asked)
    for (i, used, names), (*_, own), by_layers in zip(asked, shared.values(), slopes, strict=True):
        gradient = own[:, used].reshape(BATCHES, -1) @ by_layers.reshape(len(by_layers), -1).T
        for name, values in zip(names, np.split(gradient, len(names), axis=1), strict=True):
            yield optics.bsdfs[i].film, name, values


def layer_tangent(optics: Optics, tangents: Mapping[tuple[int, str], np.ndarray]) -> np.ndarray:
    """
    Return the rates of change of R and T in coating tables, (rows, 3) float64, for given rates of layer parameters.

    They are per unit of the common variable, and 0 where no layer moves. See
    `mistray.gradients.parameter_gradient.number_tangent` for `tangents`.
    """
    rows = np.zeros((optics.rows, TRANSMISSION + 1))
    asked = []
    for i, names in layered_surfaces(optics, lambda owner, name: (id(owner), name) in tangents):
        places = table_rows(optics, i)
        asked.append((i, np.arange(places.stop - places.start), names))
    for (i, _, names), slopes in zip(asked, layer_row_derivatives(optics, asked), strict=True):
        speeds = np.concatenate([tangents[id(optics.bsdfs[i].film), name] for name in names])
        rows[table_rows(optics, i)] += np.tensordot(speeds.astype(np.float64), slopes, axes=1)
    return rows


@dataclass(frozen=True)
class _Side:
    """
    Coating seen by light that arrives from one side, at chosen angles of its table of R and T.

    Attributes
    ----------
    indices, thickness : (L,) complex and float
        Complex indices and thicknesses (nm) of the layers in the order of incidence.
    outer : (complex, complex)
        Indices of the materials before and behind.
    cosines : (m,) float
        Cosines of incidence.
    put : callable
        Stores the derivatives of R and T, (requested parameters · L, m) each, in the order of incidence; those of T
        only for light from the front of a surface that is not opaque.
    """

    indices: np.ndarray
    thickness: np.ndarray
    outer: tuple[complex, complex]
    cosines: np.ndarray
    put: Callable[[np.ndarray, np.ndarray], None]


def layer_row_derivatives(optics: Optics, asked: Sequence[tuple[int, np.ndarray, Sequence[str]]]) -> list[np.ndarray]:
    """
    Return the derivatives of R and T at the nodes of coating tables with respect to layer parameters.

    Parameters
    ----------
    optics : Optics
        Optical properties of the surfaces.
    asked : sequence of (int, (u,) int, sequence of str)
        Index of the surface, the requested rows, numbered through both parts of its table (refraction, total
        reflection), and the requested parameters, of `LAYER_PARAMETERS`.

    Returns
    -------
    list of (names · L, u, 3) float64
        Derivatives with respect to each parameter of each layer, in the coating's own order: 1/nm for a thickness, else
        dimensionless. The columns are R from the front, R from the back and T; T of an opaque surface has 0.
    """
    groups: dict[tuple[int, tuple[int, ...]], list[_Side]] = {}
    results = []
    for surface, used, names in asked:
        parts = tuple(LAYER_PARAMETERS.index(name) for name in names)
        result, sides = _sides(optics, surface, used, parts)
        results.append(result)
        for side in sides:
            groups.setdefault((len(side.indices), parts), []).append(side)
    for (_, parts), sides in groups.items():  # one kernel for all coatings of as many layers
        for side, (R, T) in zip(sides, _tangents(sides, parts, optics.wavelength_nm), strict=True):
            side.put(R, T)
    return results


def _sides(optics: Optics, surface: int, used: np.ndarray, parts: tuple[int, ...]) -> tuple[np.ndarray, list[_Side]]:
    """
    Return zeros for derivatives of table rows, (names · L, u, 3), and the sides of incidence that fill them.

    A side in a metal is left out, and so is the rarer side if only rows of total reflection are requested. `used` are
    the requested rows, as in `layer_row_derivatives`, and `parts` places in `LAYER_PARAMETERS`.
    """
    _, last, _, total_last = (int(v) for v in optics.host_places[surface])
    refraction = last + 1
    n_front, n_back = optics.complex_indices[surface]
    opaque = bool(optics.host_words[surface] & OPAQUE)
    coating = optics.bsdfs[surface].coating
    layers = len(coating.layers)
    result = np.zeros((len(parts) * layers, len(used), 3))
    front, back, dense = _cosines(n_front, n_back, opaque, last, total_last)
    total = used >= refraction
    found = []
    for is_front, outer in ((True, (n_front, n_back)), (False, (n_back, n_front))):
        # Total reflection occurs from the denser side only
        rows = ~total | (outer[0].real > outer[1].real)
        if not rows.any() or outer[0].imag > METAL_K:  # nothing travels in a metal
            continue
        indices, thickness, order = coating.front_to_back(optics.wavelength_nm, n_front, n_back, is_front)
        forward = slice(None, None, 1 if is_front else -1)
        slot = np.concatenate([order[forward] + block * layers for block in range(len(parts))])

        def put(
            R: np.ndarray, T: np.ndarray, is_front: bool = is_front, rows: np.ndarray = rows, slot: np.ndarray = slot
        ) -> None:
            channel = REFLECTION_FRONT if is_front else REFLECTION_BACK
            result[:, :, channel][np.ix_(slot, np.flatnonzero(rows))] = R
            if is_front and not opaque:
                result[:, :, TRANSMISSION][np.ix_(slot, np.flatnonzero(rows & ~total))] = T[:, ~total[rows]]

        cosines = np.concatenate([front if is_front else back, dense])[used][rows]
        found.append(_Side(indices[forward], thickness[forward], outer, cosines, put))
    return result, found


def _tangents(
    sides: Sequence[_Side], parts: tuple[int, ...], wavelength_nm: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Return derivatives of R and T, means of s and p, with respect to layer parameters, for every side and layer.

    They are (parts · L, m) for each side; `parts` are places in `LAYER_PARAMETERS`, and thicknesses are in nm. All
    coatings have equally many layers L.
    """
    layers = len(sides[0].indices)
    blocks = len(parts) * layers
    # One lane for each row and each parameter of a side
    number = np.concatenate([np.full(blocks * len(side.cosines), k) for k, side in enumerate(sides)])
    chosen = np.concatenate([np.repeat(np.arange(blocks), len(side.cosines)) for side in sides])
    cosine = upload(mi.Float64, np.concatenate([np.tile(side.cosines, blocks) for side in sides]))
    lane, parameter = upload(mi.UInt32, number), upload(mi.UInt32, chosen)

    def spread(values: Any) -> mi.Float64:
        return dr.gather(mi.Float64, upload(mi.Float64, np.array(values)), lane)

    complex_type = mi.Complex2f64
    n_layers, d_layers = [], []
    # Forward mode: each lane moves one parameter of one layer
    with dr.resume_grad():
        for j in range(layers):
            n = [side.indices[j] for side in sides]
            values = ([side.thickness[j] for side in sides], np.real(n), np.imag(n))
            moved = []
            for part, value in enumerate(values):
                x = spread(value)
                dr.enable_grad(x)
                mine = parameter == parts.index(part) * layers + j if part in parts else mi.Bool(False)
                dr.set_grad(x, dr.select(mine, mi.Float64(1), mi.Float64(0)))
                moved.append(x)
            d_layers.append(moved[0])
            n_layers.append(complex_type(moved[1], moved[2]))
        outer = [
            complex_type(*(spread(part([side.outer[k] for side in sides])) for part in (np.real, np.imag)))
            for k in (0, 1)
        ]
        # Thin-film stack, mean of s and p
        (r_s, r_p), (t_s, t_p) = reflectance_transmittance(
            outer[0], n_layers, d_layers, outer[1], dr.opaque(mi.Float64, wavelength_nm), cosine
        )
        mean_r, mean_t = 0.5 * (r_s + r_p), 0.5 * (t_s + t_p)
        dr.enqueue(dr.ADMode.Forward, d_layers, n_layers)
        dr.traverse(dr.ADMode.Forward)
        gradients = dr.grad(mean_r), dr.grad(mean_t)
        dr.eval(gradients)
    # Split the lanes by side
    both = [np.array(gradient) for gradient in gradients]
    ends = np.cumsum([blocks * len(side.cosines) for side in sides])[:-1]
    return [
        (R.reshape(blocks, -1), T.reshape(blocks, -1))
        for R, T in zip(*(np.split(values, ends) for values in both), strict=True)
    ]


def _cosines(
    n_front: complex, n_back: complex, same: bool, last: int, total_last: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the cosines of incidence at the nodes of a coating table, for refraction and for total reflection.

    They are those in front, behind and, in total reflection, on the denser side. With `same`, for an opaque surface or
    equal indices, light is not refracted: the first two are the nodes, and the last are 0. `last` and `total_last` are
    the indices, from 0, of the last nodes of both parts.
    """
    nodes, dense = np.linspace(0.0, 1.0, last + 1), np.linspace(0.0, 1.0, total_last + 1)
    if same:
        return nodes, nodes, 0 * dense
    front, back, _ = node_cosines(n_front.real, n_back.real, nodes)
    return front, back, node_cosines(n_front.real, n_back.real, dense)[2]


def row_derivatives(optics: Optics, surface: int, side: int) -> np.ndarray:
    """
    Return the derivatives of a coating's R and T at table nodes with respect to a real index beside it.

    `side` is 0 for the index in front, 1 for the one behind. The nodes are held fixed: they are cosines in the rarer
    material, or, between equal indices, cosines of incidence.

    Returns
    -------
    (rows, 3) float64
        Derivatives of both parts of the surface's table (refraction, total reflection): R from the front, R from the
        back and T. Those of total reflection are 0 for an opaque surface or equal indices.
    """
    sides = optics.complex_indices[surface]
    coating = optics.bsdfs[surface].coating
    held = [coating]
    if isinstance(coating, Stack):  # the order of the layers, which may differ for light from the back, is held as well
        firsts = dict.fromkeys(coating.side_of_first(*sides, from_front) for from_front in (True, False))
        held = [replace(coating, first=first) for first in firsts]
    opaque = bool(optics.host_words[surface] & OPAQUE)
    _, last, _, total_last = (int(v) for v in optics.host_places[surface])
    contrast = abs(sides[0].real - sides[1].real)
    # Step of the differences
    same = opaque or contrast < EQUAL_INDICES
    step = INDEX_STEP if same else min(INDEX_STEP, contrast / 8)  # the rarer material stays the rarer one

    def rows(change: float) -> np.ndarray:
        front, back = (n + change * (k == side) for k, n in enumerate(sides))
        at_front, at_back, dense = _cosines(front, back, same, last, total_last)
        nm, both = optics.wavelength_nm, (front, back)
        own = [refraction_rows(one, nm, both, opaque, False, at_front, at_back)[:, :, 0] for one in held]
        refraction = own[0]
        refraction[:, REFLECTION_BACK] = own[-1][:, REFLECTION_BACK]
        # Between equal indices there is no critical angle
        total = np.zeros((total_last + 1, 3)) if same else total_rows(held[0], nm, both, False, dense)[:, :, 0]
        return np.concatenate([refraction, total])

    return (8 * (rows(step) - rows(-step)) - (rows(2 * step) - rows(-2 * step))) / (12 * step)

"""
Chain rule from derivatives by the rows of the tables of R and T to derivatives by coating parameters.

The rows are exact values of the coating at the nodes, so the chain rule takes their derivatives by the thickness and
the complex index of each layer. These come from Dr.Jit's forward mode through `mistray.physics.thinfilm`, in float64,
one lane for each row that was used and each parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import LAYER_PARAMETERS, METAL_K
from mistray.errors import MistrayError
from mistray.kernel.interaction import REFLECTION_AND_TRANSMISSION
from mistray.physics.thinfilm import reflectance_transmittance
from mistray.settings import BATCHES
from mistray.surfaces.optics import IDEAL, OPAQUE, REFLECTION_BACK, REFLECTION_FRONT, TABLED, TRANSMISSION, node_cosines
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.surfaces.optics import Optics

IDEAL_PARAMETERS = ("R", "T")

NO_STOKES = (
    "gradients need polarization='unpolarized' and sources without stokes, jones or polarization_deg; the Stokes "
    "vector has no derivative yet"
)


def coating_gradient(
    optics: Optics, sums: np.ndarray, is_chosen: Callable[[Any, str], bool] = lambda owner, name: True
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Yield derivatives of a metric with respect to the coating parameters of a scene, by batch of start rays.

    Parameters
    ----------
    optics : Optics
        Optics of the run that was traced.
    sums : (BATCHES, rows, CHANNELS) float64
        Result of `Run.derivatives`.
    is_chosen : callable
        Takes a plugin and a name; returns whether that derivative is requested. By default all are.

    Yields
    ------
    owner, name, gradient
        The plugin that owns the parameter, its name (``thickness_nm``, ``n_shift``, ``k_shift``, ``R``, ``T``), and the
        derivatives by batch, (BATCHES, entries). A coating is yielded once for each pair of materials beside it.

    Raises
    ------
    MistrayError
        If the run carried polarisation.
    """
    if optics.stokes:
        raise MistrayError(NO_STOKES)
    # Surfaces with the same coating between the same materials share a table, and its derivatives
    shared: dict[tuple[int, int], tuple[int, np.ndarray]] = {}
    for i, bsdf in enumerate(optics.bsdfs):
        kind = int(optics.host_words[i]) & 3
        first, _, total_first, total_last = (int(v) for v in optics.host_places[i])
        # Ideal coating: its R and T are the row itself
        if kind == IDEAL:
            own = sums[:, first]
            both = own[:, REFLECTION_AND_TRANSMISSION]
            found = {"R": own[:, REFLECTION_FRONT] + own[:, REFLECTION_BACK] + both, "T": own[:, TRANSMISSION] + both}
            for name in IDEAL_PARAMETERS:
                if is_chosen(bsdf.film, name):
                    yield bsdf.film, name, found[name][:, None]
        elif kind == TABLED and bsdf.film is not None and any(is_chosen(bsdf.film, name) for name in LAYER_PARAMETERS):
            own = sums[:, first : total_first + total_last + 1, :REFLECTION_AND_TRANSMISSION]
            key = id(bsdf.film), id(optics.tables[i])
            shared[key] = i, own + shared[key][1] if key in shared else own
    # Chain rule: derivatives by used rows times derivatives of these rows by the layers
    asked = []
    for i, own in shared.values():
        film = optics.bsdfs[i].film
        names = [name for name in LAYER_PARAMETERS if is_chosen(film, name)]
        asked.append((i, np.flatnonzero(np.any(own.any(axis=0), axis=1)), names))
    found_rows = layer_row_derivatives(optics, asked)
    for (_, own), (i, used, names), slopes in zip(shared.values(), asked, found_rows, strict=True):
        gradient = own[:, used].reshape(BATCHES, -1) @ slopes.reshape(len(slopes), -1).T
        for name, values in zip(names, np.split(gradient, len(names), axis=1), strict=True):
            yield optics.bsdfs[i].film, name, values


@dataclass(frozen=True)
class _Side:
    """
    Incidence on a coating from one side, at rows of a table.

    Attributes
    ----------
    indices, thickness : (L,) complex and float
        Complex indices and thicknesses (nm) of the layers in the order of incidence.
    outer : (complex, complex)
        Indices of the materials before and behind.
    cosines : (m,) float
        Cosines of incidence.
    put : callable
        Takes the derivatives of R and T, (requested parameters · L, m) each, in the order of incidence.
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
    asked : sequence of (int, (u,) int, sequence of str)
        Surface, the requested rows, numbered through both parts of its table (refraction, total reflection), and the
        requested parameters, of `LAYER_PARAMETERS`.

    Returns
    -------
    list of (names · L, u, 3) float64
        Derivatives with respect to each parameter of each layer, in the coating's own order, thickness in nm. The
        columns are R from the front, R from the back and T.
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
    """Return the array of derivatives of some rows of a table, zero so far, and the sides that fill it."""
    _, last, _, total_last = (int(v) for v in optics.host_places[surface])
    refraction = last + 1
    n_front, n_back = optics.complex_indices[surface]
    opaque = bool(optics.host_words[surface] & OPAQUE)
    indices, thickness, order = optics.bsdfs[surface].coating.front_to_back(optics.wavelength_nm, n_front, n_back)
    layers = len(indices)
    result = np.zeros((len(parts) * layers, len(used), 3))
    # Cosines of incidence at the nodes of both parts of the table
    if opaque:
        front = back = np.linspace(0.0, 1.0, refraction)
        dense = np.zeros(total_last + 1)
    else:
        front, back, _ = node_cosines(n_front.real, n_back.real, np.linspace(0.0, 1.0, refraction))
        dense = node_cosines(n_front.real, n_back.real, np.linspace(0.0, 1.0, total_last + 1))[2]
    total = used >= refraction
    found = []
    for is_front, outer in ((True, (n_front, n_back)), (False, (n_back, n_front))):
        # Total reflection occurs from the denser side only
        rows = ~total | (outer[0].real > outer[1].real)
        if not rows.any() or outer[0].imag > METAL_K:  # nothing travels in a metal
            continue
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
    """Return derivatives of mean R and T by the same parameters of each layer, of coatings with equally many layers."""
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

"""From derivatives by the rows of the tables of R and T to derivatives by coating parameters.

The rows are exact values of the coating at the nodes, so the chain rule needs their derivatives by the thickness and
the complex index of each layer. Those come from Dr.Jit's forward mode through `mistray.physics.thinfilm`, in float64,
one lane for each row that was used and each parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import LAYER_PARAMETERS, METAL_K
from mistray.errors import MistrayError
from mistray.physics.thinfilm import reflectance_transmittance
from mistray.trace.interaction import REFLECTION_AND_TRANSMISSION
from mistray.trace.ledger import BATCHES
from mistray.trace.optics import IDEAL, OPAQUE, REFLECTION_BACK, REFLECTION_FRONT, TABLED, TRANSMISSION, node_cosines

if TYPE_CHECKING:
    from mistray.coatings import Stack
    from mistray.trace.optics import Optics

IDEAL_PARAMETERS = ("R", "T")


def coating_gradient(
    optics: Optics, sums: np.ndarray, wanted: Callable[[Any, str], bool] = lambda owner, name: True
) -> Iterator[tuple[Any, str, np.ndarray]]:
    """
    Derivatives of a metric by the coating parameters of a scene.

    Parameters
    ----------
    optics : Optics
        Of the run that was traced.
    sums : (BATCHES, rows, CHANNELS) float64
        From `Run.derivatives`.
    wanted : callable
        Says of a plugin and a name whether its derivative is asked for; by default all are.

    Yields
    ------
    owner, name, gradient
        The plugin that owns the parameter, its name (``thickness_nm``, ``n_shift``, ``k_shift``, ``R``, ``T``), and the
        derivatives by batch, (BATCHES, entries). A coating between several pairs of materials comes once for each.

    Raises
    ------
    MistrayError
        If the run carried polarisation.
    """
    if optics.stokes:
        raise MistrayError("gradients need polarization='unpolarized'; the Stokes vector has no derivative yet")
    # Surfaces with the same coating between the same materials share a table, and its derivatives
    shared: dict[tuple[int, int], tuple[int, np.ndarray]] = {}
    for i, bsdf in enumerate(optics.bsdfs):
        kind = int(optics.host_words[i]) & 3
        first, _, total_first, total_last = (int(v) for v in optics.host_places[i])
        if kind == IDEAL:
            own = sums[:, first]
            both = own[:, REFLECTION_AND_TRANSMISSION]
            found = {"R": own[:, REFLECTION_FRONT] + own[:, REFLECTION_BACK] + both, "T": own[:, TRANSMISSION] + both}
            for name in IDEAL_PARAMETERS:
                if wanted(bsdf.film, name):
                    yield bsdf.film, name, found[name][:, None]
        elif kind == TABLED and bsdf.film is not None and any(wanted(bsdf.film, name) for name in LAYER_PARAMETERS):
            own = sums[:, first : total_first + total_last + 1, :REFLECTION_AND_TRANSMISSION]
            key = id(bsdf.film), id(optics.tables[i])
            shared[key] = i, own + shared[key][1] if key in shared else own
    for i, own in shared.values():
        film = optics.bsdfs[i].film
        names = [name for name in LAYER_PARAMETERS if wanted(film, name)]
        used = np.flatnonzero(np.any(own.any(axis=0), axis=1))
        slopes = layer_row_derivatives(optics, i, used, names)
        gradient = own[:, used].reshape(BATCHES, -1) @ slopes.reshape(len(slopes), -1).T
        for name, values in zip(names, np.split(gradient, len(names), axis=1), strict=True):
            yield film, name, values


def layer_row_derivatives(optics: Optics, surface: int, used: np.ndarray, names: list[str]) -> np.ndarray:
    """
    Derivatives of rows of a coated surface's table by the parameters of its layers.

    Parameters
    ----------
    optics : Optics
    surface : int
    used : (u,) int
        The rows that are wanted, counted through both parts of the table.
    names : list of str
        Of `LAYER_PARAMETERS`.

    Returns
    -------
    (names · L, u, 3) float64
        By each parameter for all layers, in the coating's own order; columns as in the table.
    """
    _, last, _, total_last = (int(v) for v in optics.host_places[surface])
    return _row_derivatives(
        optics.bsdfs[surface].coating,
        optics.wavelength_nm,
        *optics.complex_indices[surface],
        bool(optics.host_words[surface] & OPAQUE),
        (last + 1, total_last + 1),
        used,
        [LAYER_PARAMETERS.index(name) for name in names],
    )


def _row_derivatives(
    stack: Stack,
    wavelength_nm: float,
    n_front: complex,
    n_back: complex,
    opaque: bool,
    counts: tuple[int, int],
    used: np.ndarray,
    parts: list[int],
) -> np.ndarray:
    """
    Derivatives of rows of a table by the parameters of each layer.

    Parameters
    ----------
    counts : (int, int)
        Rows of the refraction part and of the total-reflection part.
    used : (u,) int
        The rows that are wanted, counted through both parts.
    parts : list of int
        The parameters that are wanted, numbers in `LAYER_PARAMETERS`.

    Returns
    -------
    (parts · L, u, 3) float64
        By each parameter for all layers, in the coating's own order; columns as in the table.
    """
    indices, thickness, order = stack.front_to_back(wavelength_nm, n_front, n_back)
    layers = len(indices)
    if not len(used):
        return np.zeros((len(parts) * layers, 0, 3))
    refraction = counts[0]
    if opaque:
        front = back = np.linspace(0.0, 1.0, refraction)
        dense = np.zeros(counts[1])
    else:
        front, back, _ = node_cosines(n_front.real, n_back.real, np.linspace(0.0, 1.0, refraction))
        dense = node_cosines(n_front.real, n_back.real, np.linspace(0.0, 1.0, counts[1]))[2]
    at_front, at_back = np.concatenate([front, dense])[used], np.concatenate([back, dense])[used]
    total = used >= refraction
    result = np.zeros((len(parts) * layers, len(used), 3))
    # Total reflection is seen from the denser side only
    sides = (
        (True, at_front, ~total | (n_front.real > n_back.real)),
        (False, at_back, ~total | (n_back.real > n_front.real)),
    )
    for is_front, cosines, rows in sides:
        if not rows.any() or (n_front if is_front else n_back).imag > METAL_K:  # nothing travels in a metal
            continue
        ordered = (indices, thickness) if is_front else (indices[::-1], thickness[::-1])
        outer = (n_front, n_back) if is_front else (n_back, n_front)
        R, T = _tangents(*ordered, *outer, wavelength_nm, cosines[rows], parts)
        number = order if is_front else order[::-1]
        slot = np.concatenate([number + block * layers for block in range(len(parts))])
        place = np.ix_(slot, np.flatnonzero(rows))
        result[:, :, REFLECTION_FRONT if is_front else REFLECTION_BACK][place] = R
        if is_front and not opaque:
            below = ~total[rows]
            result[:, :, TRANSMISSION][np.ix_(slot, np.flatnonzero(rows & ~total))] = T[:, below]
    return result


def _tangents(
    indices: np.ndarray,
    thickness: np.ndarray,
    n_incident: complex,
    n_substrate: complex,
    wavelength_nm: float,
    cosines: np.ndarray,
    parts: list[int],
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the mean R and T by the parameters of each layer, (parts · L, m), in the order of incidence."""
    layers, nodes = len(indices), len(cosines)
    lane = dr.arange(mi.UInt32, len(parts) * layers * nodes)
    stride = dr.opaque(mi.UInt32, nodes)  # a literal would be compiled in, and the count changes with the design
    parameter = lane // stride

    def opaque(value: float) -> Any:
        return dr.opaque(mi.Float64, float(value))

    complex_type = mi.Complex2f64
    n_layers, d_layers = [], []
    with dr.resume_grad():
        for j, (n, d) in enumerate(zip(indices, thickness, strict=True)):
            values = [opaque(d), opaque(n.real), opaque(n.imag)]
            moved = []
            for part, value in enumerate(values):
                x = value + dr.zeros(mi.Float64, dr.width(lane))
                dr.enable_grad(x)
                mine = parameter == parts.index(part) * layers + j if part in parts else mi.Bool(False)
                dr.set_grad(x, dr.select(mine, mi.Float64(1), mi.Float64(0)))
                moved.append(x)
            d_layers.append(moved[0])
            n_layers.append(complex_type(moved[1], moved[2]))
        outer = [complex_type(opaque(n.real), opaque(n.imag)) for n in (n_incident, n_substrate)]
        cosine = dr.gather(mi.Float64, mi.Float64(cosines), lane % stride)
        (r_s, r_p), (t_s, t_p) = reflectance_transmittance(
            outer[0], n_layers, d_layers, outer[1], opaque(wavelength_nm), cosine
        )
        mean_r, mean_t = 0.5 * (r_s + r_p), 0.5 * (t_s + t_p)
        dr.enqueue(dr.ADMode.Forward, d_layers, n_layers)
        dr.traverse(dr.ADMode.Forward)
        gradients = dr.grad(mean_r), dr.grad(mean_t)
        dr.eval(gradients)
    shape = (len(parts) * layers, nodes)
    return np.array(gradients[0]).reshape(shape), np.array(gradients[1]).reshape(shape)

"""Coatings and scatter models of surfaces for any state of the controls, evaluated on the host.

An estimate evaluates them at the angles of rays that were traced in another state. The scene itself is not touched, so
that it may be traced meanwhile.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray.analyses.explorer.controls import AS_IT_IS, COATING, LAYERS, NUMBER, VALUES, Control
from mistray.coatings import CoatingModel, Ideal, Stack
from mistray.events import ABSORBED, AIMED_TRANSMITTED, FIRST_SCATTERED, RANDOM_TRANSMITTED, TRANSMITTED
from mistray.physics.contamination import coverage_percent
from mistray.scatter.evaluate import bsdf
from mistray.scatter.particulate import Particulate
from mistray.surfaces.optics import (
    REFLECTION_BACK,
    REFLECTION_FRONT,
    TRANSMISSION,
    node_cosines,
    refraction_rows,
    total_rows,
)
from mistray.surfaces.surfaces import solid_shapes

Floats = npt.NDArray[np.float64]
NODES = 257  # of tables over the angle
THROUGH = (RANDOM_TRANSMITTED, AIMED_TRANSMITTED)  # scattered to the other side


@dataclass(frozen=True)
class SurfaceLook:
    """
    Coating and scatter models of one surface, as a state of the explorer's controls sets them.

    Attributes
    ----------
    coating : CoatingModel
        Coating of the surface.
    models : tuple of (model, float)
        Scatter models, and the factor on the BSDF of each.
    """

    coating: CoatingModel
    models: tuple[tuple[Any, float], ...]


class Looks:
    """
    Coating and scatter models of all surfaces of a scene, for any state of the explorer's controls.

    Parameters
    ----------
    scene : mi.Scene
        Scene as loaded; its coatings and scatter models are read once.
    controls : mapping of str to Control
        Controls of the explorer, by name.
    """

    def __init__(self, scene: Any, controls: Mapping[str, Control]) -> None:
        self._shapes = {str(shape.id()): shape for shape in solid_shapes(scene)}
        self._bsdfs = {name: shape.bsdf() for name, shape in self._shapes.items()}
        self._as_it_is = {
            name: SurfaceLook(bsdf.coating, tuple((model, 1.0) for model in bsdf.scatter))
            for name, bsdf in self._bsdfs.items()
        }
        self._controls = controls

    def of(self, state: Mapping[str, VALUES]) -> dict[str, SurfaceLook]:
        """Return the coating and scatter models of each surface in a state of the controls, by shape id."""
        found = dict(self._as_it_is)
        for name, control in self._controls.items():
            if control.kind == COATING and state[name] != AS_IT_IS:
                for surface, coating in control.coatings(str(state[name])).items():
                    found[surface] = dataclasses.replace(found[surface], coating=coating)
        for name, control in self._controls.items():
            if control.kind == LAYERS and state[name] != control.start:
                factor = float(state[name]) / 100
                for surface, look in found.items():
                    if isinstance(look.coating, Stack):
                        found[surface] = dataclasses.replace(look, coating=scaled(look.coating, factor))
            elif control.kind == NUMBER and state[name] != control.start:
                for surface in control.surfaces:
                    found[surface] = self._changed(found[surface], surface, control, float(state[name]))
        return found

    def _changed(self, look: SurfaceLook, surface: str, control: Control, value: float) -> SurfaceLook:
        """
        Return a surface's coating and scatter models after its control takes a new value.

        Only R or T of ideal coatings and parameters of scatter models change.
        """
        one = control.parameter
        assert one is not None
        if one.kind == "share" and isinstance(look.coating, Ideal):
            r, t = (value, look.coating.T) if one.name == "R" else (look.coating.R, value)
            return dataclasses.replace(look, coating=dataclasses.replace(look.coating, R=r, T=t))
        if one.kind == "scatter":
            models = tuple(
                _with_value(model, one.name, value) if owner is one.owner else (model, amount)
                for owner, (model, amount) in zip(self._bsdfs[surface].scatterers, look.models, strict=True)
            )
            return dataclasses.replace(look, models=models)
        return look

    def factor(self, surface: str, look: SurfaceLook, hits: SurfaceHits) -> Floats:
        """
        Return the fraction of flux that goes the way of each hit's event, or the BSDF (1/sr) of scatter, (n,).

        The fraction is that which the coating reflects, transmits or absorbs, whatever part of it is then scattered.

        Parameters
        ----------
        surface : str
            Shape id.
        look : SurfaceLook
            Coating and scatter models of the surface.
        hits : SurfaceHits
            Hits of this surface, all with the same event.
        """
        plugin, nm = self._bsdfs[surface], hits.wavelength_nm
        sides = plugin.complex_indices(nm)
        found = np.zeros(len(hits.cos_i))
        for from_front in (True, False):
            here = hits.from_front == from_front
            if not here.any():
                continue
            r, t = _shares(look.coating, nm, sides, from_front, hits.cos_i[here])
            if hits.event == ABSORBED:
                found[here] = 1 - r - t
            elif hits.event < FIRST_SCATTERED:
                found[here] = t if hits.event == TRANSMITTED else r
            else:
                n_in, n_out = (n.real for n in (sides if from_front else sides[::-1]))
                event = ("transmission", t) if hits.event in THROUGH else ("reflection", r)
                directions = hits.cos_i[here], hits.scattered[here]
                found[here] = _scattered(look, nm, (n_in, n_out), from_front, directions, event)
        return found


@dataclass(frozen=True)
class SurfaceHits:
    """
    Hits of one surface with one event at one wavelength, n in number.

    Attributes
    ----------
    event : int
        Code of the event, see `mistray.events`.
    wavelength_nm : float
        Wavelength, nm.
    cos_i : (n,) float64
        Cosines of incidence.
    from_front : (n,) bool
        Whether light comes from the front.
    scattered : (n, 3) float64
        Unit directions of scattered light in the frame of `mistray.scatter.evaluate.bsdf`; 0 for other events.
    """

    event: int
    wavelength_nm: float
    cos_i: Floats
    from_front: npt.NDArray[np.bool_]
    scattered: Floats


def scaled(stack: Stack, factor: float) -> Stack:
    """Return a copy of a coating with all its layer thicknesses multiplied by `factor`."""
    layers = tuple(dataclasses.replace(layer, thickness_nm=factor * layer.thickness_nm) for layer in stack.layers)
    return dataclasses.replace(stack, layers=layers)


def _shares(
    coating: Any, wavelength_nm: float, sides: tuple[complex, complex], from_front: bool, cos_i: Floats
) -> tuple[Floats, Floats]:
    """
    Return R and T, (n,) each, 0 … 1, at cosines of incidence, (n,): means of s and p.

    `sides` are the complex indices in front and behind. Light comes from the front if `from_front`, else from the back.
    Under total reflection T is 0.
    """
    refraction, total = _tables(coating, wavelength_nm, sides)
    n_in, n_out = (n.real for n in (sides if from_front else sides[::-1]))
    sin2_out = np.zeros_like(cos_i) if coating.opaque else (n_in / n_out) ** 2 * (1 - cos_i * cos_i)
    # The variables of the tables, see `mistray.surfaces.optics`
    cosine = cos_i if n_in <= n_out or coating.opaque else np.sqrt(np.maximum(1 - sin2_out, 0))
    reflection = REFLECTION_FRONT if from_front else REFLECTION_BACK
    r, t = (_interpolated(refraction[:, row, 0], cosine) for row in (reflection, TRANSMISSION))
    beyond = sin2_out >= 1
    if total is not None and beyond.any():
        y = np.sqrt(np.maximum(sin2_out - 1, 0))
        inside = _interpolated(total[:, reflection, 0], y / np.maximum(y + n_in / n_out * cos_i, 1e-30))
        r, t = np.where(beyond, inside, r), np.where(beyond, 0.0, t)
    return r, t


@lru_cache(maxsize=1024)
def _tables(coating: Any, wavelength_nm: float, sides: tuple[complex, complex]) -> tuple[Floats, Floats | None]:
    """
    Return a table of R and T by angle for refraction (`refraction_rows`), and one for total reflection (`total_rows`).

    `sides` are the complex indices in front and behind. The second table is None for an opaque surface and between
    equal indices. Both are those of the kernel with fewer nodes, with an error below 1e-4. The kernel's own take ten
    times as long, and a slider asks for new ones at every step.
    """
    x = np.linspace(0.0, 1.0, NODES)
    front, back = (n.real for n in sides)
    at_front, at_back, dense = node_cosines(front, back, x)
    if coating.opaque:
        return refraction_rows(coating, wavelength_nm, sides, True, False, x, x), None
    refraction = refraction_rows(coating, wavelength_nm, sides, False, False, at_front, at_back)
    total = None if front == back else total_rows(coating, wavelength_nm, sides, False, dense)
    return refraction, total


def _interpolated(values: Floats, x: Floats) -> Floats:
    return np.interp(x, np.linspace(0.0, 1.0, len(values)), values)


def _scattered(
    look: SurfaceLook,
    wavelength_nm: float,
    indices: tuple[float, float],
    from_front: bool,
    directions: tuple[Floats, Floats],
    event: tuple[str, Floats],
) -> Floats:
    """
    Return the sum of the BSDFs of all scatter models of a surface, (n,), 1/sr.

    `indices` are those on the side of incidence and beyond; light comes from the front if `from_front`, else from the
    back. `directions` are cosines of incidence and scattered directions as in `SurfaceHits`. `event` is "reflection" or
    "transmission" and the coating's R or T, (n,).
    """
    total = np.zeros(len(directions[0]))
    for model, amount in look.models:
        lobes = model.lobes(wavelength_nm, *indices, from_front)
        total += amount * bsdf(lobes, event[0], *directions, *indices, event[1])
    return total


def _with_value(model: Any, name: str, value: float) -> tuple[Any, float]:
    """
    Return a scatter model with a new value of a parameter, and the factor on its BSDF.

    Mie series for a new cleanliness level take seconds. The scatter of particles is therefore scaled with the area that
    they cover.
    """
    changed = model.changed(**{name: value})
    if isinstance(model, Particulate) and name in ("level", "coverage_percent"):
        new, old = (coverage_percent(one.cleanliness, one.slope, one.min_um, one.max_um) for one in (changed, model))
        return model, new / old
    return changed, 1.0

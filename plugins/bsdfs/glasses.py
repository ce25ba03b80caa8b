"""Materials on the two sides of an interface, with differentiable shifts of their refractive indices."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import CoatingModel, CoatingTable, Stack
from mistray.errors import MistrayError
from mistray.materials import complex_index, nearest_known_nm, refractive_index, resolved, shifted
from mistray.param import Param, fixed
from mistray.ranges import INDEX_SHIFT, TEXT

SHIFTS = ("n_front_shift", "n_back_shift")
MATERIAL = fixed(
    "string",
    TEXT,
    "material: ``air``, an index (``1.5168``, ``1.5+0.01i``), ``nd=1.544 Vd=56.1``, a name (``N-BK7``, ``Al``) or a "
    "file; see docs/materials.md",
    "air",
)
SHIFT = Param("1", INDEX_SHIFT, "shift of the real index of ``front`` or ``back`` at every wavelength", default=0.0)
MATERIALS = {**dict.fromkeys(("front", "back"), MATERIAL), **dict.fromkeys(SHIFTS, SHIFT)}


class Glasses:
    """
    Materials in front of and behind an interface, each with a differentiable shift of its real index.

    Parameters
    ----------
    props : mi.Properties
        Properties of the plugin; those of `MATERIALS` are read.
    owner : str
        Name of the plugin, for messages.
    resolve : callable
        Function that gives the path of a file from its path in the scene.

    Attributes
    ----------
    front, back : str
        Material strings. A shift is included as the suffix ``shift=VALUE``, so that all functions of a material have
        it.
    given : tuple of str
        Materials in front and behind, without the shifts.
    declared : tuple of bool
        Whether the scene declares the materials in front and behind; the default is air.
    parameters : dict of str to mi.Float
        Shifts of the indices by name.
    held : tuple of (1,) float64
        Values of these shifts that were applied last.
    """

    def __init__(self, props: mi.Properties, owner: str, resolve: Callable[[str], str]) -> None:
        front, back = (resolved(MATERIAL.of(props, side, owner), resolve) for side in ("front", "back"))
        self.given = self._names = front, back
        self.declared = "front" in props, "back" in props
        self.parameters = {name: mi.Float(SHIFT.of(props, name, owner)) for name in SHIFTS}

    def update(self, wavelength_nm: float) -> bool:
        """
        Apply the index shifts in `parameters`; return True if they have changed.

        Raises
        ------
        MistrayError
            If a shift is not a single number or is out of range, or the index is then not above 0 at the known
            wavelength nearest to `wavelength_nm`, nm. Then nothing has changed.
        """
        values = tuple(np.array(dr.detach(value), dtype=np.float64) for value in self.parameters.values())
        for name, value in zip(SHIFTS, values, strict=True):
            if value.shape != (1,):
                raise MistrayError(f"{name} is {value.tolist()}; give one number")
            INDEX_SHIFT.check(name, float(value[0]))
        front, back = (shifted(material, float(value[0])) for material, value in zip(self.given, values, strict=True))
        for material in (front, back):
            refractive_index(material, nearest_known_nm(material, wavelength_nm))
        changed = (front, back) != self._names
        self._names, self.held = (front, back), values
        return changed

    @property
    def front(self) -> str:
        return self._names[0]

    @property
    def back(self) -> str:
        return self._names[1]

    def known_indices(self, wavelength_nm: float) -> tuple[float, float]:
        """Return the real indices in front and behind at a wavelength, nm, or at the nearest known one."""
        front, back = (refractive_index(name, nearest_known_nm(name, wavelength_nm)) for name in self._names)
        return front, back

    def nearest_nm(self, wavelength_nm: float, coating: CoatingModel) -> float:
        """
        Return the wavelength, nm, nearest to a given one at which both materials and their coating are known.

        If there is none, one of them is not known at the wavelength. That is no error here: Mitsuba's kernels call the
        BSDFs of all scenes in the process, and a scene that is not rendered must not stop the rendering of another.
        """
        for material in self._names:
            wavelength_nm = nearest_known_nm(material, wavelength_nm)
        for layer in coating.layers if isinstance(coating, Stack) else ():
            wavelength_nm = nearest_known_nm(layer.material, wavelength_nm, with_k=True)
        if isinstance(coating, CoatingTable) and len(coating.wavelength_nm) > 1:
            wavelength_nm = float(np.clip(wavelength_nm, coating.wavelength_nm[0], coating.wavelength_nm[-1]))
        return wavelength_nm

    def transparent(self, wavelength_nm: float) -> tuple[complex, complex]:
        """
        Return the indices n + ik in front and behind at a wavelength, nm, for Mitsuba's own integrators.

        k is 0 if it is unknown.
        """
        found = []
        for material in self._names:
            try:
                found.append(complex_index(material, wavelength_nm))
            except MistrayError:
                found.append(complex(refractive_index(material, wavelength_nm)))
        return found[0], found[1]

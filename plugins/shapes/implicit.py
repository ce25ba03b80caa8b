"""Base class for users' own shapes: surfaces of revolution with a formula F(x, y, z) = 0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.physics._arrays import arctan2, sqrt
from mistray.plugins.shapes.revolution import Revolution
from mistray.surfaces.families.implicit_surface import PROFILE, ImplicitSurface
from mistray.surfaces.gradient_columns import OWN

__all__ = ["Implicit", "arctan2", "sqrt"]


class Implicit(Revolution):
    """
    Surface of revolution about the local z axis, given by a formula.

    A subclass becomes a plugin by registration, ``mi.register_shape("name", Name)``. It is then traced, recorded and
    drawn, has derivatives with respect to all of its parameters, edges included, and has a mesh for Mitsuba's own
    integrators. It defines the members below. x, y, z are coordinates in its own frame, mm, as arrays of NumPy or
    Dr.Jit, and n maps the names in `numbers` to values. `mistray.plugins.shapes.implicit` has `sqrt` and `arctan2` for
    both arrays.

    The normal points in the direction in which F grows, from the ``front`` of the nested ``interface`` to its ``back``.

    Attributes
    ----------
    numbers : tuple of str
        Parameters that the formula needs, at most 8.
    properties : mapping of str to Param
        All its parameters, from which the two following attributes are made; a subclass states either.
    ranges : mapping of str to Range
        Allowed ranges of all parameters; those without an entry in `defaults` are required.
    defaults : mapping of str to float
        Default values of parameters.
    mechanics : bool
        Whether it counts as mechanics (a lip, a housing) or as optics.
    """

    numbers: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def residual(x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """
        Return F at points, mm, of which the surface is F = 0.

        Values close to the distance from the surface in mm are best in float32.
        """
        raise NotImplementedError

    @staticmethod
    def gradient(x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Return the derivatives of F with respect to x, y and z at points, mm."""
        raise NotImplementedError

    @staticmethod
    def coordinate(x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """Return the coordinate u, mm, of points of the surface along its profile."""
        raise NotImplementedError

    @staticmethod
    def generatrix(u: Any, n: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the distance from the axis and the z of the profile, mm, at the coordinate u, mm; NumPy only."""
        raise NotImplementedError

    @staticmethod
    def ends(values: Mapping[str, float]) -> tuple[float, float]:
        """Return the least and the greatest coordinate u, mm, along the profile of a surface with given parameters."""
        raise NotImplementedError

    def __init_subclass__(cls) -> None:
        moved = (*OWN[: len(cls.numbers)], "low", "high")
        cls.columns = dict.fromkeys(vars(cls).get("properties") or getattr(cls, "ranges", {}), moved)
        super().__init_subclass__()

    def __init__(self, props: mi.Properties) -> None:
        self._start(props)
        missing = [key for key in self.ranges if key not in props and key not in self.defaults]
        if missing:
            raise MistrayError(f"{self.owner}: a {self.figure} needs {', '.join(missing)}; add them")
        values = {key: props.get(key, self.defaults.get(key)) for key in self.ranges}
        self._finish(props, {key: float(self.ranges[key].check(key, values[key], self.owner)) for key in values})

    def check(self) -> None:
        low, high = self.ends(self.values)
        if not low < high:
            raise MistrayError(f"{self.owner}: it begins at {low:g} and ends at {high:g} mm; a part of no length")
        if not float(np.min(self.profile(PROFILE)[:, 0])) >= 0:
            raise MistrayError(f"{self.owner}: its profile crosses the axis; change its numbers or its ends")

    @classmethod
    def surface(cls, values: Mapping[str, float]) -> ImplicitSurface:
        return ImplicitSurface.of(cls, values, cls.ends(values), cls.mechanics)

    def profile(self, count: int = 65) -> np.ndarray:
        return np.column_stack(self.generatrix(np.linspace(*self.ends(self.values), count), self.values))

    @property
    def outer_radius(self) -> float:
        return float(self.profile(PROFILE)[:, 0].max())

    @property
    def flipped(self) -> bool:
        (r0, z0), (r, z), (r1, z1) = self.profile(3)
        x, _, along = (float(g) for g in self.gradient(r, 0.0, z, self.values))
        return bool(x * (z1 - z0) - along * (r1 - r0) > 0)

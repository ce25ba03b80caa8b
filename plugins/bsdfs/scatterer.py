"""What the scatter plugins have in common: a model of scatter, by itself or nested in an `interface`."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.plugins.bsdfs.interface import SIDES, Interface
from mistray.plugins.bsdfs.lobe_pair import Pair
from mistray.scatter import Lobe, Scatter

PLACEMENT = ("event", "side", "relative_to")
ALONE = (*SIDES, "R", "T")  # what a scatter plugin takes by itself only


class Scatterer(Interface):
    """
    Base of the scatter plugins: an interface without layers whose light one model scatters.

    A plugin reads its properties in `_read`, makes its model in `_model_of`, and says what a lobe's profile is for
    Dr.Jit arrays in `profile`. Values that can be differentiated are `mi.Float` in `values`.

    Attributes
    ----------
    values : dict of str to mi.Float
        Differentiable parameters of the model.
    alone : list of str
        Properties that only a plugin by itself may have.
    sample_axis : SampleAxis or None
        To be set in `_read` where a lobe is anisotropic.
    """

    def _read_coating(self, props: mi.Properties) -> None:
        self.alone = [key for key in ALONE if key in props]
        self._placement = {key: str(props.get(key)) for key in PLACEMENT if key in props}
        self.values: dict[str, mi.Float] = {}
        self._read(props)
        self._model_held: tuple[np.ndarray, ...] = ()
        self.rebuild_model()
        # Absolute scatter takes its light from what is absorbed: by default all of it
        specular = getattr(self.model, "relative_to", "specular") == "specular"
        reflectance = float(props.get("R", 1.0 if specular and "T" not in props else 0.0))
        self._own_ideal = True
        self._R, self._T = mi.Float(reflectance), mi.Float(float(props.get("T", 0.0)))
        self._rebuild()
        self.scatterers = (self,)

    def _read(self, props: mi.Properties) -> None:
        """Read the properties of the model; differentiable ones go to `values`."""
        raise NotImplementedError

    def _take(self, props: mi.Properties, *needed: str, **defaults: float) -> None:
        """Read differentiable values: those that must be given, and those that have a default."""
        missing = [key for key in needed if key not in props]
        if missing:
            raise MistrayError(f"{self.title}: {missing[0]} is missing; give {', '.join(needed)}")
        for key in (*needed, *defaults):
            self.values[key] = mi.Float(float(props.get(key, defaults.get(key, 0.0))))

    def _optional(self, props: mi.Properties, key: str) -> float | None:
        """A number that need not be given."""
        return float(props.get(key)) if key in props else None

    def _model_of(self, **values: float) -> Scatter:
        """The model with these values of the differentiable parameters."""
        raise NotImplementedError

    def profile(self, lobe: Lobe, r: mi.Float, pair: Pair, wavelength_nm: float) -> mi.Float | None:
        """
        The profile of a lobe in closed form, differentiable by `values`; None if the lobe has only its table.

        Parameters
        ----------
        lobe : Lobe
            One of the model's lobes.
        r : mi.Float
            Distance from the centre.
        pair : Pair
            The two directions and the indices on their sides.
        wavelength_nm : float
        """
        return None

    def ratio(self, lobe: Lobe, r: mi.Float, pair: Pair, wavelength_nm: float) -> mi.Float | None:
        """The ratio of a lobe that has one, as `profile`; None if it has only its table."""
        return None

    def _nested_film(self, props: mi.Properties, nested: list[Any]) -> Any:
        raise MistrayError(f"{self.title}: a BSDF is nested in it; nest both in an 'interface' instead")

    def nest(self, interface: Interface) -> None:
        """Become a part of an interface, which has the materials and the coating."""
        if self.alone:
            raise MistrayError(
                f"{interface.title}: its {self.title} has {self.alone[0]} as well; give {self.alone[0]} at the "
                "interface only"
            )
        self.is_nested = True

    def rebuild_model(self) -> None:
        """Make the model from the values; raises if they are impossible, and then nothing has changed."""
        given = tuple(np.array(dr.detach(value), dtype=np.float64) for value in self.values.values())
        for name, value in zip(self.values, given, strict=True):
            if value.shape != (1,):
                raise MistrayError(f"{self.title}: {name} has {len(value)} entries; give one number")
        self.model = self._model_of(**{name: float(value[0]) for name, value in zip(self.values, given, strict=True)})
        self._model_held = given

    def _named_scatterers(self) -> dict[str, Any]:
        return {}

    def traverse(self, callback: mi.TraversalCallback) -> None:
        if not self.is_nested:
            super().traverse(callback)
        for name, value in self.values.items():
            callback.put(name, value, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: list[str] = []) -> None:  # noqa: B006  (Mitsuba's own signature)
        super().parameters_changed(keys)
        try:
            self.rebuild_model()
        except MistrayError:
            for value, held in zip(self.values.values(), self._model_held, strict=True):
                mi.set_property(value, mi.Float(held))  # in place: mi.traverse has handed out this very object
            raise

    def to_string(self) -> str:
        inside = [f"{name} = {float(value[0]):g}" for name, value in self.values.items()]
        inside += [f"{name} {value}" for name, value in self._placement.items()]
        own = "" if self.is_nested else f", {self.front} | {self.back}, {super()._summary()}"
        return f"{type(self).__name__}[{', '.join(inside)}{own}]"

"""Base class of the scatter plugins: one scatter model, by itself or nested in an `interface`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param, documented, params_of
from mistray.plugins.bsdfs.interface import BY_ITSELF, Interface, _resolve
from mistray.ranges import SHARE
from mistray.scatter import Placement
from mistray.scatter.kinds import add_kind
from mistray.scatter.lobe import PLACEMENT
from mistray.surfaces.upload import changed_numbers

REFLECTANCE = Param(
    "1",
    SHARE,
    "by itself only: reflectance; by default 0 with T or with ``relative_to`` ``incident``",
    default=None,
    otherwise="1",
)
# What a scatter plugin may have by itself only
ALONE = {"R": REFLECTANCE, "T": Param("1", SHARE, "by itself only: transmittance", default=0.0), **BY_ITSELF}


def properties_of(model: Any, own: Mapping[str, Param]) -> dict[str, Param]:
    """Return the properties of the plugin of a scatter model: its own, the model's parameters, and `ALONE`."""
    found = {**own, **params_of(model, PLACEMENT), **ALONE}
    if found["relative_to"].default == "incident":
        found["R"] = replace(REFLECTANCE, doc="by itself only: reflectance beside the scatter", otherwise="0")
    return found


class Scatterer(Interface):
    """
    Base class of the scatter plugins: an interface without layers, and one model that scatters its light.

    A plugin names its model in `model_type`. The parameters of the model are those of the plugin, and `ALONE`.

    Attributes
    ----------
    model_type : type
        Dataclass derived from `mistray.scatter.Placement`; its fields are `Param`.
    model : Placement
        Scatter model with the current values.
    values : dict of str to mi.Float
        Differentiable parameters of the model.
    alone : list of str
        Given properties that only a plugin by itself may have.
    """

    model_type: type[Placement]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.properties = properties_of(cls.model_type, vars(cls).get("properties", {}))
        add_kind(cls.kind, cls.model_type)
        documented(cls)

    def _read_coating(self, props: mi.Properties) -> None:
        self.alone = [key for key in ALONE if key in props]
        self.model = self._read_model(props)
        self._placement = {key: self._take(props, key) for key in PLACEMENT if key in props}
        self.values = {name: mi.Float(value) for name, value in self.model.values.items()}
        self._loaded = dict(self.model.values)
        self._model_held: tuple[np.ndarray, ...] = ()
        self.rebuild_model()
        # Absolute scatter takes its light from the absorbed light: by default all light is absorbed
        specular = self.model.relative_to == "specular"
        usual = 1.0 if specular and "T" not in props else 0.0
        self._own_ideal = True
        self._R = mi.Float(self._take(props, "R") if "R" in props else usual)
        self._T = mi.Float(self._take(props, "T"))
        self._rebuild()
        self.scatterers = (self,)

    def _read_model(self, props: mi.Properties) -> Placement:
        """Return the scatter model made from the scene's properties; raise `MistrayError` if one is not valid."""
        known = {key: self.model_type.param(key) for key in list(props.keys())}
        given = {key: param.of(props, key, self.title) for key, param in known.items() if param is not None}
        return self.model_type.of(_resolve, **given, name=self.name)

    def _nested_film(self, props: mi.Properties, nested: list[Any]) -> Any:
        raise MistrayError(f"{self.title}: a BSDF is nested in it; nest both in an 'interface' instead")

    def nest(self, interface: Interface) -> None:
        """
        Attach this plugin to an interface, which then owns materials and coating.

        Raise `MistrayError` if the plugin has properties that it may only have by itself.
        """
        if self.alone:
            raise MistrayError(
                f"{interface.title}: its {self.title} has {self.alone[0]} as well; give {self.alone[0]} at the "
                "interface only"
            )
        self.is_nested = True

    def rebuild_model(self) -> None:
        """
        Rebuild the scatter model from the current parameter values.

        If a value is out of range or is not a single number, raise `MistrayError` and leave everything unchanged.
        """
        moved = changed_numbers(self.values, self.title, self.model.values, self._loaded)
        if moved:
            self.model = self.model.changed(**moved)
        self._model_held = tuple(np.array(dr.detach(value)) for value in self.values.values())

    def _named_scatterers(self) -> dict[str, Any]:
        return {}

    def traverse(self, callback: mi.TraversalCallback) -> None:
        if not self.is_nested:
            super().traverse(callback)
        for name, value in self.values.items():
            callback.put(name, value, mi.ParamFlags.Differentiable)

    def _valid_values(self) -> list[tuple[mi.Float, np.ndarray]]:
        return [*super()._valid_values(), *zip(self.values.values(), self._model_held, strict=True)]

    def _apply(self) -> None:
        super()._apply()
        self.rebuild_model()

    def to_string(self) -> str:
        inside = [f"{name} = {float(value[0]):g}" for name, value in self.values.items()]
        inside += [f"{name} {value}" for name, value in self._placement.items()]
        own = "" if self.is_nested else f", {self.front} | {self.back}, {super()._summary()}"
        return f"{type(self).__name__}[{', '.join(inside)}{own}]"

"""Plugin `thinfilm`: a coating of layers, by itself or nested in an `interface`."""

from __future__ import annotations

import dataclasses
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.coatings import LAYER_PARAMETERS, CoatingModel, Layer, Stack, parse_layers, preset
from mistray.coatings.files import read_coating
from mistray.coatings.presets import PRESETS
from mistray.coatings.stack import SIDES as FIRST
from mistray.errors import MistrayError
from mistray.param import Param, documented, fixed
from mistray.plugins.bsdfs.interface import BY_ITSELF, SIDES, Interface, _resolve
from mistray.ranges import FINITE, FLAG, SHARE, TEXT, WAVELENGTH_NM, Words
from mistray.spectra.spectrum import DEFAULT_NM

RECIPES = ("layers", "preset", "table", "R")


@documented
class ThinFilm(Interface):
    r"""
    Optical coating (:monosp:`thinfilm`): a stack of layers, a preset, a table, or constant R and T.

    Nested in an ``interface`` it is the coating of that, between the interface's materials. Several interfaces may
    share one object by ``<ref id="…"/>``. By itself it is an interface with a coating and has the properties ``front``,
    ``back``, ``mirror`` and ``wavelength_nm`` as well.

    Exactly one of ``layers``, ``preset``, ``table`` and ``R`` defines the coating. R, T and the phases of layers follow
    from the wave equation for s and p. That includes absorption in the layers and in the media, total reflection and
    its frustration. Light that is neither reflected nor transmitted is absorbed.

    .. parameters::

    In ``mi.traverse`` layers have ``thickness_nm`` (nm, ≥ 0), ``n_shift`` and ``k_shift``. These are arrays with one
    entry for each layer, in the order of ``layers``, all differentiable through the ray tree. N = n + n_shift + i (k +
    k_shift) at every wavelength.

    Source: see `mistray.physics.thinfilm`; the presets are described in `mistray.coatings.presets`.

    .. code-block:: xml

        <bsdf type="thinfilm" id="ar"><string name="preset" value="bbar3"/></bsdf>
        <shape type="asphere" id="lens_front">
            <float name="semi_diameter" value="10"/>
            <bsdf type="interface"><string name="back" value="N-BK7"/><ref id="ar"/></bsdf>
        </shape>

    .. code-block:: python

        {"type": "thinfilm", "back": "N-BK7", "layers": "MgF2 99.64", "first": "outside"}
    """

    kind = "thinfilm"
    properties = {
        "layers": fixed(
            "string",
            TEXT,
            "``MgF2 99.64, 2.1 0.5w, 1.63+0.001i 84.4``: material (see docs/materials.md; k must be known) and "
            "thickness in nm, or in waves of ``design_nm`` with a w",
            None,
        ),
        "preset": fixed(
            "string",
            TEXT,
            f"{', '.join(f'``{name}``' for name in PRESETS)}: the design, not fitted",
            None,
        ),
        "table": fixed(
            "file", TEXT, "CSV over wavelength and angle, or a coating of a Zemax file: ``COATING.DAT:NAME``", None
        ),
        "R": Param("1", SHARE, "constant reflectance", default=None),
        "T": Param("1", SHARE, "constant transmittance beside R", default=0.0),
        "first": fixed(
            "string",
            Words(FIRST),
            "position of the first layer: ``outside`` is the side of lower index (metals count as substrate); on a "
            "mirror in one medium it is that of the light",
            "outside",
        ),
        "design_nm": fixed(
            "nm",
            WAVELENGTH_NM,
            "wavelength of thicknesses in waves; the materials of such layers must be known there",
            DEFAULT_NM,
        ),
        **dict.fromkeys(
            LAYER_PARAMETERS[1:], Param("list", FINITE, "shifts of n and of k, one number for each layer", default=0.0)
        ),
        "opaque": fixed(
            "bool",
            FLAG,
            "whether T = 0, as for a mirror; for a COAT of a Zemax file the last layer is then the substrate, as there",
            False,
        ),
        **BY_ITSELF,
    }

    def _read_coating(self, props: mi.Properties) -> None:
        self.sides = [key for key in SIDES if key in props]
        self._layers: tuple[Layer, ...] | None = None
        self._first, self._opaque = self._take(props, "first"), self._take(props, "opaque")
        self.design_nm = self._take(props, "design_nm")
        given = [key for key in (*RECIPES, "T") if key in props]
        if len([key for key in given if key != "T"]) != 1 or ("T" in given and "R" not in given):
            raise MistrayError(
                f"{self.title}: it has {' and '.join(given) or 'no coating'}; give one of layers, preset, table, or R "
                "and T"
            )
        recipe = given[0]
        self._recipe = "" if recipe == "R" else self._take(props, recipe)
        self.name: str = self.name or self._recipe
        if recipe == "R":
            super()._read_coating(props)
        else:
            coating = self._recipe_coating(recipe)
            if isinstance(coating, Stack):
                self._start_layers(coating, props)
            else:
                self._own = coating
        of_zemax = recipe == "table" and not self._recipe.lower().endswith(".csv")
        only_layers = (*(() if of_zemax else ("first", "opaque", "design_nm")), "n_shift", "k_shift")
        unused = [key for key in only_layers if key in props and self._layers is None]
        if unused:
            raise MistrayError(f"{self.title}: {unused[0]} has no meaning without layers; remove it")

    def _nested_film(self, props: mi.Properties, nested: list[Any]) -> Any:
        raise MistrayError(f"{self.title}: a BSDF is nested in it; nest the thinfilm in an 'interface' instead")

    def _recipe_coating(self, recipe: str) -> CoatingModel:
        if recipe == "layers":
            return Stack(parse_layers(self._recipe, self.design_nm, self.name, _resolve), name=self.name)
        if recipe == "preset":
            return preset(self._recipe, self.design_nm)
        return read_coating(self._recipe, self.design_nm, self._opaque, _resolve)

    def _start_layers(self, stack: Stack, props: mi.Properties) -> None:
        """
        Create the layers' parameters from a design: thicknesses in nm, and shifts of n and k.

        Raise `MistrayError` if the design has no layer.
        """
        self._layers, self._opaque = stack.layers, stack.opaque or self._opaque
        if not stack.layers:
            raise MistrayError(f"{self.title}: it has no layer; leave it out for a bare surface")
        shifts = [self._numbers(str(props.get(key, "")), key) for key in LAYER_PARAMETERS[1:]]
        self.thickness_nm = mi.Float([layer.thickness_nm for layer in stack.layers])
        self.n_shift, self.k_shift = (mi.Float(values) for values in shifts)
        self._rebuild()

    def _numbers(self, text: str, key: str) -> list[float]:
        """
        Return the values in a string, one for each layer; zeros for an empty string.

        Raise `MistrayError` if they are not numbers, or there are not as many as layers.
        """
        assert self._layers is not None
        if not text:
            return [0.0] * len(self._layers)
        try:
            values = [float(word) for word in text.replace(",", " ").split()]
        except ValueError as error:
            raise MistrayError(f"{self.title}: {key}: {error}; write numbers with commas between them") from None
        if len(values) != len(self._layers):
            raise MistrayError(f"{self.title}: {key} has {len(values)} numbers for {len(self._layers)} layers")
        return values

    def _parameters(self) -> dict[str, mi.Float]:
        if self._layers is None:
            return super()._parameters()
        return {"thickness_nm": self.thickness_nm, "n_shift": self.n_shift, "k_shift": self.k_shift}

    def _build(self, *values: np.ndarray) -> CoatingModel:
        if self._layers is None:
            return super()._build(*values)
        layers = tuple(
            dataclasses.replace(layer, thickness_nm=float(d), n_shift=float(n), k_shift=float(k))
            for layer, d, n, k in zip(self._layers, *values, strict=True)
        )
        stack = Stack(layers, self._first, self.name, self._opaque)
        stack.indices(
            self.design_nm, nearest=True
        )  # unknown materials and impossible shifts are errors of the scene, now
        return stack

    def _summary(self) -> str:
        if not isinstance(self._own, Stack):
            return super()._summary()
        thickness = ", ".join(f"{layer.material} {layer.thickness_nm:.6g}" for layer in self._own.layers)
        return f"{thickness} nm, first {self._first}{', opaque' if self._opaque else ''}"


mi.register_bsdf("thinfilm", lambda props: ThinFilm(props))

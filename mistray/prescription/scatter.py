"""How a surface of a prescription scatters."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from types import MappingProxyType
from typing import Any

from mistray.errors import MistrayError
from mistray.prescription.coating import check_name
from mistray.scatter.abg import ABg
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.kinds import KINDS
from mistray.scatter.lobe import Placement
from mistray.scatter.paint import Paint
from mistray.scatter.polynomial import Polynomial
from mistray.scatter.rough_surface import substrate_index

Value = bool | int | float | str


def _paint(preset: str | None = None, **properties: Any) -> Paint:
    return Paint(**properties) if preset is None else Paint.preset(preset, **properties)


def _k_correlation(substrate: str | None = None, **properties: Any) -> KCorrelation:
    index = None if substrate is None else substrate_index(substrate, "scatter 'k_correlation'")
    return KCorrelation(**properties, substrate=index)


# The files of these stand beside a scene that may not exist yet: their readers check them


def _table(
    file: str,
    cosine_corrected: bool = False,
    beyond: str = "error",
    anisotropy: str = "error",
    sample_axis: str = "x",
    rotation_deg: float = 0.0,
    **placement: Any,
) -> None:
    Placement(**placement)


def _abg(file: str | None = None, **properties: Any) -> ABg | None:
    if file is None:
        return ABg(**properties)
    Placement(**properties)
    return None


def _psd_table(
    file: str,
    beyond: str = "error",
    scale: float = 1.0,
    theory: str = "ghs",
    substrate: str | None = None,
    **placement: Any,
) -> None:
    Placement(**placement)


MODELS: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {
        **KINDS,
        "abg": _abg,
        "k_correlation": _k_correlation,
        "paint": _paint,
        "polynomial": Polynomial.of,
        "psd_table": _psd_table,
        "tabulated": _table,
    }
)
"""Plugin → what makes the model from its properties."""


@dataclass(frozen=True)
class Scatter:
    """
    A scatter plugin nested in the interface of a surface; see docs/scatter.md.

    Attributes
    ----------
    kind : str
        The plugin: one of `MODELS`.
    properties : mapping of str to bool, number or str
        Its properties as in XML, for example ``{"rms_nm": 4.0}``. Files are relative to the scene file.
    name : str or None
        Surfaces whose scatter has the same name share one object in the scene, with one set of parameters; ``None``:
        each surface has its own.

    Raises
    ------
    MistrayError
        If the plugin or a property is unknown, or the model refuses a value.
    """

    kind: str
    properties: Mapping[str, Value] = field(default_factory=dict)
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in MODELS:
            raise MistrayError(f"scatter '{self.kind}': there is no such model; use {', '.join(MODELS)}")
        if self.name is not None:
            check_name(self.name)
        for key, value in self.properties.items():
            if not isinstance(value, Value):
                raise MistrayError(f"scatter '{self.kind}': {key} = {value!r}; give a number, a text or a boolean")
        self.model()

    def __hash__(self) -> int:
        return hash((self.kind, tuple(sorted(self.properties.items())), self.name))

    def model(self) -> Any:
        """The model in `mistray.scatter`; None of what is read from a file, whose file only the scene knows."""
        try:
            return MODELS[self.kind](**self.properties)
        except TypeError as error:
            message = re.sub(r"^\S+\(\) ", "", str(error))
            raise MistrayError(f"scatter '{self.kind}': {message}; see the properties of the plugin") from None

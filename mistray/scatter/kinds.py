"""Registry of scatter models by the names that their plugins have in a scene."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.edge_diffraction import EdgeDiffraction
from mistray.scatter.gaussian import Gaussian
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.lobe import Placement
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.paint import Paint
from mistray.scatter.particulate import Particulate
from mistray.scatter.phong import Phong
from mistray.scatter.polynomial import Polynomial

OWN_KINDS: Mapping[str, type[Placement]] = {
    "abg": ABg,
    "edge_diffraction": EdgeDiffraction,
    "gaussian_lobe": Gaussian,
    "harvey_shack": HarveyShack,
    "k_correlation": KCorrelation,
    "paint": Paint,
    "particulate": Particulate,
    "phong": Phong,
    "polynomial": Polynomial,
    "psd_table": PsdTable,
    "tabulated": Tabulated,
}
_known = dict(OWN_KINDS)
KINDS: Mapping[str, type[Placement]] = MappingProxyType(_known)
"""Model classes by the names of their plugins, also of users' plugins; properties of a plugin are fields of its model.

`Tabulated` and `PsdTable` are read from their property ``file``. `Polynomial` takes its coefficients by name."""


def add_kind(kind: str, model: type[Placement]) -> None:
    """
    Register the model class of a scatter plugin; a later import of the same plugin replaces it.

    Raises
    ------
    MistrayError
        If the name is that of another model of mistray.
    """
    if OWN_KINDS.get(kind, model) is not model:
        raise MistrayError(f"scatter model '{kind}' of {model.__module__} has the name of one of mistray; rename it")
    _known[kind] = model

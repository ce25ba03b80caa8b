"""
Translation of Mitsuba's own BSDFs into interfaces of the same reflectance, transmittance and scatter.

It works on a parsed scene, because an object of Mitsuba has its spectra as three colours. What has no exact
translation stays as it is: Mitsuba's integrators take it, and a trace refuses it by name. Only a lone
`conductor` differs: Mitsuba's is black from behind, the interface reflects there, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.coatings import METAL_K
from mistray.errors import MistrayError
from mistray.materials import complex_index, nearest_known_nm, table_nodes_nm
from mistray.materials.spec import GAS_INDEX
from mistray.ranges import SHARE
from mistray.scene.allowed_plugins import STOCK
from mistray.scene.check import property_of
from mistray.spectra.spectrum import DEFAULT_NM

AIR = 1.000277  # Mitsuba's index of air, which is 1 here
GREY = 0.5  # reflectance of a `diffuse` that has none
BLACK = {"type": "interface", "R": 0.0}
NORMAL_SIDE, OTHER_SIDE, BOTH_SIDES = "back", "front", "both"  # the normal of a shape points to its back
FACTORS = ("specular_reflectance", "specular_transmittance")
SPECTRUM = "Spectrum"  # name of the class of a spectrum in a parsed scene, which Python cannot reach otherwise
DIGITS = 7  # of numbers that Mitsuba holds in single precision


@dataclass(frozen=True)
class _Scene:
    """
    Parsed scene, and the gas around it, for the translation of its BSDFs.

    Attributes
    ----------
    nodes : list of mi.parser.SceneNode
        Objects of the scene, with all references resolved.
    gas : float
        Index of the gas around the scene, as Mitsuba counts it: 1.000277 for air.
    """

    nodes: list[Any]
    gas: float

    def values(self, node: Any) -> dict[str, Any]:
        """Return the properties of an object by name; a texture that is the same everywhere counts as its value."""
        found = {key: property_of(node, key) for key in node.props.keys()}  # noqa: SIM118  Properties
        for key, value in found.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                texture = self.nodes[value.index()].props
                if texture.plugin_name() == "uniform" and "value" in texture:
                    found[key] = property_of(self.nodes[value.index()], "value")
        return found

    def shapes(self) -> Iterator[Any]:
        """Yield the shape nodes of the parsed scene."""
        inside = {index for node in self.nodes if node.type.name == "Scene" for index in self.of_kind(node, "Unknown")}
        for number, node in enumerate(self.nodes):
            if node.type.name == "Shape" or number in inside:
                yield node

    def of_kind(self, node: Any, kind: str) -> list[int]:
        """Return the indices of the objects of a kind, such as "BSDF", that an object refers to."""
        references = (one for one in self.values(node).values() if isinstance(one, mi.Properties.ResolvedReference))
        return [one.index() for one in references if self.nodes[one.index()].type.name == kind]


def translate_bsdfs(state: Any) -> None:
    """
    Replace the BSDFs of the shapes of a parsed scene by interfaces that do the same, see the module.

    A shape that emits light and has no BSDF gets a black interface.

    Parameters
    ----------
    state : mi.parser.ParserState
        Parsed scene after `mi.parser.transform_all`, not yet built.

    Raises
    ------
    MistrayError
        If a reflectance is not 0 … 1, or a metal is unknown. The message names the place as Mitsuba's own errors do.
    """
    nodes = list(state.nodes)
    scene = _Scene(nodes, next(_gases(nodes), AIR))
    found: dict[int, dict[str, Any]] = {}
    carried: dict[int, bool] = {}  # whether Mitsuba's own shapes alone carry a BSDF
    for node in scene.shapes():
        bsdfs = scene.of_kind(node, "BSDF")
        if not bsdfs and scene.of_kind(node, "Emitter"):
            node.props["bsdf"] = mi.load_dict(BLACK)  # as for Mitsuba
        for index in bsdfs:
            carried[index] = carried.get(index, True) and node.props.plugin_name() in STOCK["shape"]
    for index, only_stock in carried.items():
        try:
            made = _translated(scene, nodes[index], NORMAL_SIDE if only_stock else BOTH_SIDES)
        except MistrayError as error:
            place = mi.parser.file_location(state, nodes[index])
            raise MistrayError(f"While loading {place}: MistrayError: {error}") from None
        if made is not None:
            found[index] = made
    for index, made in found.items():  # last: a BSDF may also be a part of another one
        nodes[index].props = _properties(made, nodes[index].props.id())


def _properties(given: Mapping[str, Any], name: str) -> mi.Properties:
    """Return the properties of a plugin from its dict, with the id `name`; nested plugins are built."""
    props = mi.Properties(given["type"])
    props.set_id(name)
    for key, value in given.items():
        if key != "type":
            props[key] = mi.load_dict(value) if isinstance(value, dict) else value
    return props


def _translated(scene: _Scene, node: Any, side: str) -> dict[str, Any] | None:
    """
    Return the dict of a mistray interface that acts as a Mitsuba BSDF does; None if there is none.

    `side` is the side, or both, on which a diffuse BSDF scatters, see `_diffuse`. Raise `MistrayError` as
    `translate_bsdfs` does.
    """
    kind = node.props.plugin_name()
    values = scene.values(node)
    if kind == "twosided":
        parts = [scene.nodes[index] for index in scene.of_kind(node, "BSDF")]
        if len(parts) != len(values):
            return None
        kinds = [part.props.plugin_name() for part in parts]
        if kinds in (["diffuse"], ["conductor"]):
            return _translated(scene, parts[0], BOTH_SIDES)
        if kinds == ["diffuse", "diffuse"]:
            return _both(*(_translated(scene, *pair) for pair in zip(parts, (NORMAL_SIDE, OTHER_SIDE), strict=True)))
        return None
    if kind == "diffuse" and not values.keys() - {"reflectance"}:
        return _diffuse(values.get("reflectance", GREY), side)
    if kind == "dielectric" and not values.keys() - {"int_ior", "ext_ior", *FACTORS}:
        return _dielectric(values, scene.gas)
    if kind == "conductor" and not values.keys() - {"material", "eta", "k", FACTORS[0]}:
        return _conductor(values)
    return None


def _diffuse(reflectance: Any, side: str) -> dict[str, Any] | None:
    """
    Return the dict of an interface with a Lambertian paint on `side`; the other side is black, as in Mitsuba.

    `side` is `NORMAL_SIDE`, to which the normal points, `OTHER_SIDE` or `BOTH_SIDES`.

    A reflectance of 0 gives a black surface, and a colour or a texture None. One outside 0 … 1 raises `MistrayError`.
    """
    number, paint = _number(reflectance), {"type": "paint", "side": side}
    if number is None and not _is_table(reflectance):
        return None
    for share in (number,) if number is not None else reflectance.values:
        SHARE.check("reflectance", share, "diffuse")
    if number == 0 or (number is None and not any(reflectance.values)):
        return dict(BLACK)
    if number is not None:
        return {**BLACK, "paint": {**paint, "reflectance": number}}
    points = zip(map(_text, reflectance.wavelengths), map(_text, reflectance.values), strict=True)
    return {**BLACK, "paint": {**paint, "spectrum": ", ".join(f"{nm}:{value}" for nm, value in points)}}


def _both(first: dict[str, Any] | None, second: dict[str, Any] | None) -> dict[str, Any] | None:
    """
    Return the dict of one surface with the paint of `first` on its one side and that of `second` on the other.

    It is None if either is None.
    """
    if first is None or second is None:
        return None
    paints = {f"paint_{k}": one["paint"] for k, one in enumerate((first, second), start=1) if "paint" in one}
    return {**BLACK, **paints}


def _dielectric(values: Mapping[str, Any], gas: float) -> dict[str, Any] | None:
    """
    Return the dict of a bare refracting interface; its indices are relative to `gas`, or to a gas beside it.

    It is None if an index is not known, or if a specular factor is not 1.
    """
    inside, outside = (_ior(values.get(key, usual)) for key, usual in (("int_ior", "bk7"), ("ext_ior", "air")))
    if inside is None or outside is None or any(_number(values.get(key, 1.0)) != 1 for key in FACTORS):
        return None
    gas = next((n for n in (outside, inside) if n < GAS_INDEX), gas)
    front, back = ("air" if n < GAS_INDEX else repr(round(n / gas, 9)) for n in (inside, outside))
    return {"type": "interface", "front": front, "back": back}


def _conductor(values: Mapping[str, Any]) -> dict[str, Any] | None:
    """
    Return the dict of a bare interface with a metal behind it, as seen from the side of the normal.

    Mitsuba's perfect mirror becomes an ideal one with its factor as R. Without a metal that is known as numbers or
    tables, or with a factor other than 1, the result is None. A mirror's factor outside 0 … 1 raises `MistrayError`.
    """
    factor, material = _number(values.get(FACTORS[0], 1.0)), values.get("material", "none")
    eta, k = (values.get(key, usual) for key, usual in (("eta", 0.0), ("k", 1.0)))
    if material == "none" and _number(eta) == 0 and factor is not None:  # the default, a perfect mirror
        return {"type": "interface", "R": SHARE.check(FACTORS[0], factor, "conductor")}
    metal = f"mitsuba/{material}" if material != "none" else _metal(eta, k)
    if factor != 1 or metal is None or not _is_metal(metal):
        return None
    return {"type": "interface", "front": metal, "back": "air"}


def _metal(eta: Any, k: Any) -> str | None:
    """Return the material string of a metal with n and k as numbers or tables over wavelength; None for colours."""
    n, extinction = _number(eta), _number(k)
    if n is not None and extinction is not None:
        return f"{_text(n)}+{_text(extinction)}i"
    if n is not None and _is_table(k):  # the same n at both ends
        ends = _samples("n", (k.wavelengths[0], k.wavelengths[-1]), (n, n))
        return f"{ends} {_samples('k', k.wavelengths, k.values)}"
    if not _is_table(eta):
        return None
    table = _samples("n", eta.wavelengths, eta.values)
    if extinction is not None:
        return f"{table} k={_text(extinction)}"
    return f"{table} {_samples('k', k.wavelengths, k.values)}" if _is_table(k) else None


def _samples(name: str, wavelengths_nm: Sequence[float], values: Sequence[float]) -> str:
    pairs = zip(wavelengths_nm, values, strict=True)
    return " ".join(f"{name}({_text(wavelength)})={_text(value)}" for wavelength, value in pairs)


def _is_metal(material: str) -> bool:
    """
    True if a material transmits no light at any wavelength at which its n and k are known.

    Raise `MistrayError` for an unknown material.
    """
    nodes = table_nodes_nm(material) or (DEFAULT_NM,)
    return min(complex_index(material, nearest_known_nm(material, nm, with_k=True)).imag for nm in nodes) > METAL_K


def _gases(nodes: list[Any]) -> Iterator[float]:
    """Yield the indices of gases beside the dielectrics of a scene, as Mitsuba counts them."""
    for node in nodes:
        if node.type.name == "BSDF" and node.props.plugin_name() == "dielectric":
            given = {key: property_of(node, key) for key in ("ext_ior", "int_ior") if key in node.props}
            for value in ({"ext_ior": "air"} | given).values():
                index = _ior(value)
                if index is not None and index < GAS_INDEX:
                    yield index


def _ior(value: Any) -> float | None:
    """Return an index of refraction that Mitsuba knows by name or as a number; None for anything else."""
    if not isinstance(value, str):
        return _number(value)
    try:
        probe = mi.load_dict({"type": "dielectric", "int_ior": value, "ext_ior": 1.0})
    except RuntimeError:  # Mitsuba names it when it builds the scene
        return None
    return _plain(mi.traverse(probe)["eta"])


def _number(value: Any) -> float | None:
    """Return a property value as a number if it is the same at all wavelengths; else None, as for a texture."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _plain(value)
    if type(value).__name__ == SPECTRUM:
        return _plain(value.values[0]) if value.is_uniform() else None
    if isinstance(value, mi.ScalarColor3d):
        parts = np.array(value, dtype=np.float64).ravel()
        return _plain(parts[0]) if (parts == parts[0]).all() else None
    return None


def _is_table(value: Any) -> bool:
    """True if a value is a table over wavelength that is not the same everywhere."""
    return type(value).__name__ == SPECTRUM and not value.is_uniform()


def _text(value: float) -> str:
    """Return a number in digits, without those that conversion from single precision adds."""
    return f"{float(value):.{DIGITS}g}"


def _plain(value: float) -> float:
    return float(_text(value))

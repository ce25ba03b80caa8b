"""Differentiable parameters of a scene: kinds, units, ranges and tolerances.

The name of a parameter is its key in ``mi.traverse(scene)``, such as ``lens_front.curvature``, ``window_rear.bsdf.R``,
``AR.thickness_nm``.

Default tolerances are those of `mistray.metrics.default_tolerances`.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import peek
from mistray.coatings import LAYER_PARAMETERS
from mistray.errors import MistrayError
from mistray.execute.pickles import Missing
from mistray.gradients.coating_gradient import IDEAL_PARAMETERS, SHIFTS
from mistray.gradients.geometry_gradient import shape_parameters
from mistray.gradients.parameter_gradient import NO_PARAMETERS, without_derivative
from mistray.ids import fits
from mistray.metrics.default_tolerances import About, about_bsdf, about_scatter, about_shape, about_source
from mistray.ranges import TEXT, ByName, OfType, Several, several, shown
from mistray.surfaces.surfaces import solid_shapes

KINDS = ("coating", "share", "scatter", "curvature", "conic", "asphere", "rim", "position", "tilt", "index", "source")
SHAPE_KINDS = ("curvature", "conic", "asphere", "rim", "position", "tilt")  # of shapes and where they are
PARALLEL = 1e-6  # difference up to which directions of axes count as equal


@dataclass(frozen=True, eq=False)
class Parameter:
    """
    Scene parameter with respect to which traced results can be differentiated.

    Attributes
    ----------
    key : str
        Key in ``mi.traverse(scene)``.
    kind : str
        Kind, one of `KINDS`.
    unit : str
        Unit of the value.
    value : (entries,) float64
        Present value in the scene; several entries for the layers of a coating.
    owner : object
        Plugin that has the parameter; a pickle has none.
    name : str
        Name of the parameter in that plugin.
    shapes : tuple of str
        Ids of the surfaces that the parameter belongs to.
    tolerance : float
        Usual manufacturing tolerance, half the width of its range, see the module; in `unit`, > 0.
    low, high : float
        Limits of the physical range, in `unit`.

    Examples
    --------
    >>> known = mistray.optimize.parameters(mistray.load("lens_and_window"))
    >>> place = known["window_front.z"]
    >>> place.kind, place.unit, place.value, place.tolerance
    ('position', 'mm', array([0.]), 0.02)
    """

    key: str
    kind: str
    unit: str
    value: np.ndarray
    owner: Any
    name: str
    shapes: tuple[str, ...]
    tolerance: float
    low: float
    high: float

    def __getstate__(self) -> dict[str, Any]:
        reason = f"parameter '{self.key}' was pickled, without its scene; take it from parameters(scene) here"
        return vars(self) | {"owner": Missing(reason)}


KNOWN = ByName(OfType(Parameter, "must be a Parameter"), "mistray.optimize.parameters(scene)")


def parameters(scene: mi.Scene, params: Mapping[str, Any] | None = None) -> dict[str, Parameter]:
    """
    Return all parameters of a scene with respect to which a trace has derivatives, with their present values.

    Parameters of Mitsuba's own shapes have no derivative, nor have coatings and scatter without a surface. R or T of 0
    has none, because a trace does not follow such light. The same holds for indices next to an opaque surface without
    layers, and for holes of radius 0. ``z0`` and ``z1`` of a flat `frustum` have no derivative, but ``z`` has one.
    Parameters of scatter have none at values at which lobes appear or vanish.

    Parameters
    ----------
    scene : mi.Scene
        Scene to read.
    params : mi.SceneParameters, optional
        Parameters of ``mi.traverse(scene)``, perhaps reduced by its `keep`; by default all.

    Returns
    -------
    dict
        Parameters by key, in the order of `params`.

    Raises
    ------
    MistrayError
        If `params` is not an ``mi.SceneParameters``.

    Examples
    --------
    >>> known = mistray.optimize.parameters(mistray.load("lens_and_window"))
    >>> list(known)[:3]
    ['L1_front.bsdf.n_front_shift', 'L1_front.bsdf.n_back_shift', 'L1_front.curvature']
    """
    params = mi.traverse(scene) if params is None else params
    if not isinstance(params, mi.SceneParameters):
        raise MistrayError(f"params is {shown(params)}; give mi.traverse(scene)")
    surfaces = solid_shapes(scene)
    found = {}
    properties: Any = params.properties
    near: dict[int, list[Any]] = {}  # shapes by the plugins that are part of them
    own = {id(shape): frozenset(shape_parameters(shape)) for shape in surfaces}
    for shape in surfaces:
        bsdf = shape.bsdf()
        parts = [shape, bsdf, getattr(bsdf, "film", None), *getattr(bsdf, "scatterers", ())]
        for part in {id(part) for part in parts}:
            near.setdefault(part, []).append(shape)
    for key in params.keys():  # noqa: SIM118  (mi.SceneParameters iterates over pairs)
        owner, name = properties[key][2], key.rsplit(".", 1)[-1]
        shapes = [shape for shape in near.get(id(owner), ()) if _has(shape, owner, name, own)]
        about = _about(owner, name, shapes)
        if about is None:
            continue
        own_value = owner.values[name] if about in (about_shape, about_source) else peek(params, key)
        value = np.array(own_value, dtype=np.float64).ravel()
        described = about(owner, name, value)
        if described is not None:
            kind, unit, tolerance, low, high = described
            ids = tuple(str(shape.id()) for shape in shapes)
            found[key] = Parameter(key, kind, unit, value, owner, name, ids, float(tolerance), float(low), float(high))
    return found


def match(known: Mapping[str, Parameter], patterns: str | Iterable[str]) -> list[str]:
    """
    Return the keys that patterns match, in the order of the patterns, each once.

    Parameters
    ----------
    known : mapping of str to Parameter
        Parameters of the scene, from `parameters`.
    patterns : str or iterable of str
        Keys, or patterns with ``*``, ``?`` and ``[…]``.

    Raises
    ------
    MistrayError
        If a pattern matches nothing; the message offers the nearest keys.

    Examples
    --------
    >>> known = mistray.optimize.parameters(mistray.load("lens_and_window"))
    >>> mistray.optimize.match(known, "window_*.z")
    ['window_front.z', 'window_rear.z', 'window_edge.z']
    """
    found: dict[str, None] = {}
    KNOWN.check("known", known)
    for pattern in Several(TEXT, least=0).check("keys", several(patterns)):
        keys = [pattern] if pattern in known else [key for key in known if fits(key, pattern)]
        if not keys:
            advice = without_derivative(pattern) or _nearest(known, pattern)
            raise MistrayError(f"no parameter '{pattern}' with a derivative; {advice}")
        found |= dict.fromkeys(keys)
    return list(found)


def chosen_keys(scene: mi.Scene, known: Mapping[str, Parameter], keys: str | Iterable[str] | None) -> list[str]:
    """
    Return the keys of the scene parameters to take derivatives with respect to.

    They are all of `known` if `keys` is None, else those that match `keys`, which may be patterns.

    Raises
    ------
    MistrayError
        If no key is left, because none was given or the scene has no parameter, or a pattern matches nothing.
    """
    if not known and not parameters(scene):
        raise MistrayError(NO_PARAMETERS)
    found = list(known) if keys is None else match(known, keys)
    if not found:
        raise MistrayError("no parameter to differentiate by; give some of list(mistray.optimize.parameters(scene))")
    return found


def groups(known: Mapping[str, Parameter]) -> dict[str, list[str]]:
    """
    Return the groups of parameters that change together.

    Parameters
    ----------
    known : mapping of str to Parameter
        Parameters of the scene, from `parameters`.

    Returns
    -------
    dict
        Keys by the name of the group. ``N-BK7.index`` has the shifts of all sides on which a material lies. They change
        together, because light that comes out of one glass into another without a surface between is stopped. ``L1.z``
        has one coordinate of all surfaces of a part with parallel frames, and moves the part as a whole. Groups of a
        single key are left out.

    Examples
    --------
    >>> known = mistray.optimize.parameters(mistray.load("lens_and_window"))
    >>> mistray.optimize.groups(known)["window.z"]
    ['window_front.z', 'window_rear.z', 'window_edge.z']
    """
    found: dict[str, list[str]] = {}
    frames: dict[str, list[np.ndarray]] = {}
    for key, p in KNOWN.check("known", known).items():
        if p.kind == "index":
            found.setdefault(f"{p.owner.materials[SHIFTS.index(p.name)].strip()}.index", []).append(key)
        elif p.kind == "position":
            found.setdefault(f"{p.owner.part}.{p.name}", []).append(key)
            frames.setdefault(p.owner.part, []).append(p.owner.base[:3, :3])
    turned = {part for part, all_of_it in frames.items() if np.ptp(all_of_it, axis=0).max() > PARALLEL}
    return {
        name: keys
        for name, keys in found.items()
        if len(keys) > 1 and not (known[keys[0]].kind == "position" and name.rpartition(".")[0] in turned)
    }


def _nearest(known: Mapping[str, Parameter], pattern: str) -> str:
    owner, _, name = pattern.rpartition(".")
    owners, names = (list(dict.fromkeys(key.rpartition(".")[k] for key in known)) for k in (0, 2))
    if any(sign in pattern for sign in "*?["):
        close = [f"*{pattern}", *(f"{owner}.{found}" for found in difflib.get_close_matches(name, names))]
        close = [found for found in close if any(fits(key, found) for key in known)]
    elif owner in owners:
        own = [key for key in known if key.rpartition(".")[0] == owner]
        capitals = [key for key in own if key.casefold() == pattern.casefold()]
        close = capitals or difflib.get_close_matches(pattern, own, cutoff=0.0)
    else:
        close = difflib.get_close_matches(pattern, known)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return "give one of list(mistray.optimize.parameters(scene))"


def _values(owner: Any) -> Mapping[str, Any]:
    """Return the differentiable parameter values of a scatter plugin, by name; empty for other plugins."""
    return owner.values if hasattr(owner, "rebuild_model") else {}


def _about(owner: Any, name: str, shapes: Sequence[Any]) -> Callable[[Any, str, np.ndarray], About] | None:
    """
    Return the function of `mistray.metrics.default_tolerances` that describes a parameter; None if there is none.

    `owner` is the plugin that has it, and `shapes` are the shapes that it belongs to.
    """
    if hasattr(owner, "sources") and name in getattr(owner, "differentiable", ()):
        return about_source
    if not shapes:
        return None
    return about_shape if owner is shapes[0] else about_scatter if name in _values(owner) else about_bsdf


def _has(shape: Any, owner: Any, name: str, own: Mapping[int, Collection[str]]) -> bool:
    """
    True if parameter `name` of plugin `owner` belongs to a shape: to itself, its BSDF, scatter or coating.

    `own` has the names of the parameters of shapes by their ``id()``.
    """
    if owner is shape:
        return name in own[id(shape)]
    bsdf = shape.bsdf()
    if name in SHIFTS:
        return owner is bsdf and hasattr(bsdf, "coating")
    if name in _values(owner):
        return any(owner is item for item in getattr(bsdf, "scatterers", ()))
    return name in (*LAYER_PARAMETERS, *IDEAL_PARAMETERS) and owner is getattr(bsdf, "film", None)

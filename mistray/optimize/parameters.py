"""The parameters of a scene that a trace has derivatives by: what they are, their units, ranges and tolerances.

A parameter goes by its key in ``mi.traverse(scene)``, such as ``lens_front.curvature``, ``window_rear.bsdf.R``,
``AR.thickness_nm``.

Tolerances are what a shop holds without being asked for more, half the width of the range. They rank parameters; where
you know your own, give those.

========== =============================================== ==========================================================
kind       tolerance                                       source
========== =============================================== ==========================================================
coating    1 % of the mean thickness; n 0.01; k 1e-4       assumed, for evaporation without re-optimisation
share      20 % of R or T, or of what is left to 1         assumed
scatter    20 %; slopes and exponents 5 %; index 0.02      assumed: roughness, cleanliness and paint vary by as much
                                                           from one sample to the next
curvature  0.1 %, or 3 fringes over the aperture           Optimax, tolerancing limits of aspheres and cylinders: radius
                                                           ± 0.1 % or 3 HeNe fringes, whichever is larger
conic,     0.5 µm at the rim                               Optimax, tolerancing limits of aspheres: irregularity by
asphere                                                    profilometry ± 0.5 µm
rim        0.1 mm                                          ISO 2768-1: sizes of 0.5 to 6 mm in class m, 6 to 30 mm in
                                                           class f
position   0.02 mm of an `asphere`, 0.1 mm of a `frustum`  Optimax: centre thickness ± 0.020 mm; Apollo Optical Systems:
                                                           concentricity 0.015 to 0.025 mm; ISO 2768-1 as for rims
tilt       1 arcmin                                        assumed
source     what the source states, or 1 %                  assumed
index      5e-4; of air 1e-5                               Optimax, manufacturing tolerance chart, "precision": n
                                                           ± 0.0005; air at 20 ± 10 °C
========== =============================================== ==========================================================

Lengths are at most 1 % of the radius of their surface, because small parts are made in proportion.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import peek
from mistray.coatings import LAYER_PARAMETERS, Stack
from mistray.errors import MistrayError
from mistray.gradients.coating_gradient import IDEAL_PARAMETERS
from mistray.gradients.geometry_gradient import SHIFTS, shape_parameters
from mistray.gradients.scatter_gradient import fixed
from mistray.ids import fits
from mistray.physics.geometry.sag import sag
from mistray.surfaces.gradient_columns import COEFFICIENTS, DISPLACEMENT, ROTATION
from mistray.surfaces.surfaces import solid_shapes

KINDS = ("coating", "share", "scatter", "curvature", "conic", "asphere", "rim", "position", "tilt", "index", "source")
OF_SOURCE = 0.01  # of a number of a source that states no tolerance, relative to it
THICKNESS, LAYER_INDEX, LAYER_K = 0.01, 0.01, 1e-4
SHARE, LEAST_SHARE = 0.2, 1e-3
RADIUS, FRINGES_MM, FORM_MM = 1e-3, 3 * 633e-6 / 2, 5e-4
CLEAR_APERTURE = ("semi_diameter", "inner_semi_diameter", "half_width", "half_height")
RIM_MM, OPTICS_MM, MECHANICS_MM, IN_PROPORTION = 0.1, 0.02, 0.1, 0.01
ARCMIN = 1 / 60
PARALLEL = 1e-6  # by which the directions of axes may differ
INDEX, INDEX_OF_AIR, GAS = 5e-4, 1e-5, 1.01


@dataclass(frozen=True, eq=False)
class Parameter:
    """
    One parameter of a scene.

    Attributes
    ----------
    key : str
        In ``mi.traverse(scene)``.
    kind : str
        One of `KINDS`.
    unit : str
    value : (entries,) float64
        As the scene has it now; several entries for the layers of a coating.
    owner : object
        The plugin that has it.
    name : str
        Its name there.
    shapes : tuple of str
        Ids of the surfaces that it is about.
    tolerance : float
        Usual manufacturing tolerance, half the width of its range, see the module; in `unit`, greater than 0.
    low, high : float
        Physical range, in `unit`.
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


def parameters(scene: mi.Scene, params: Mapping[str, Any] | None = None) -> dict[str, Parameter]:
    """
    All parameters of a scene that a trace has a derivative by, as they stand.

    Not among them are those of stock shapes, of coatings and scatter that no surface has, the indices beside an opaque
    surface without layers, R or T of 0 (a trace does not follow what is not there), holes of no radius, ``z0`` and
    ``z1`` of a flat `frustum` (``z`` moves it), and values of scatter at which lobes come or go.

    Parameters
    ----------
    scene : mi.Scene
    params : mi.SceneParameters, optional
        ``mi.traverse(scene)``, perhaps reduced by its `keep`; by default all.

    Returns
    -------
    dict
        Key → parameter, in the order of `params`.
    """
    params = mi.traverse(scene) if params is None else params
    surfaces = solid_shapes(scene)
    found = {}
    properties: Any = params.properties  # type: ignore[union-attr]
    near: dict[int, list[Any]] = {}  # shapes by the plugins that are part of them
    for shape in surfaces:
        bsdf = shape.bsdf()
        parts = [shape, bsdf, getattr(bsdf, "film", None), *getattr(bsdf, "scatterers", ())]
        for part in {id(part) for part in parts}:
            near.setdefault(part, []).append(shape)
    for key in params.keys():  # noqa: SIM118  (mi.SceneParameters iterates over pairs)
        owner, name = properties[key][2], key.rsplit(".", 1)[-1]
        if name in getattr(owner, "differentiable", ()) and hasattr(owner, "sources"):
            found[key] = _of_source(key, owner, name)
            continue
        shapes = [shape for shape in near.get(id(owner), ()) if _has(shape, owner, name)]
        if not shapes:
            continue
        value = np.array(peek(params, key), dtype=np.float64).ravel()
        about = _about_shape if owner is shapes[0] else _about_scatter if name in _values(owner) else _about_bsdf
        described = about(owner, name, value)
        if described is not None:
            kind, unit, tolerance, low, high = described
            value = np.array([owner.values[name]]) if about is _about_shape else value
            ids = tuple(str(shape.id()) for shape in shapes)
            found[key] = Parameter(key, kind, unit, value, owner, name, ids, float(tolerance), float(low), float(high))
    return found


def match(known: Mapping[str, Parameter], patterns: Iterable[str]) -> list[str]:
    """
    Keys that patterns name, in the order of the patterns, each once.

    Parameters
    ----------
    known : mapping of str to Parameter
        From `parameters`.
    patterns : iterable of str
        Keys, or patterns with ``*``, ``?`` and ``[…]``.

    Raises
    ------
    MistrayError
        If one names nothing; the nearest keys are offered.
    """
    found: dict[str, None] = {}
    for pattern in patterns:
        keys = [pattern] if pattern in known else [key for key in known if fits(key, pattern)]
        if not keys:
            raise MistrayError(f"no parameter '{pattern}' with a derivative; {_nearest(known, pattern)}")
        found |= dict.fromkeys(keys)
    return list(found)


def groups(known: Mapping[str, Parameter]) -> dict[str, list[str]]:
    """
    Parameters that belong together.

    Parameters
    ----------
    known : mapping of str to Parameter
        From `parameters`.

    Returns
    -------
    dict
        Name → keys. ``N-BK7.index``: the shifts of all sides on which a material lies. They go together, because light
        that comes out of one glass into another without a surface between them is stopped. ``L1.z``: one coordinate of
        all surfaces of a part whose frames point the same way, which moves it as a whole.
    """
    found: dict[str, list[str]] = {}
    frames: dict[str, list[np.ndarray]] = {}
    for key, p in known.items():
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
        close = [f"{owner}.{found}" for found in difflib.get_close_matches(name, names)]
        close = [found for found in close if any(fits(key, found) for key in known)]
    elif owner in owners:
        own = [key for key in known if key.rpartition(".")[0] == owner]
        capitals = [key for key in own if key.casefold() == pattern.casefold()]
        close = capitals or difflib.get_close_matches(pattern, own, cutoff=0.0)
    else:
        close = difflib.get_close_matches(pattern, known)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return "list(mistray.optimize.parameters(scene)) shows them all"


def _values(owner: Any) -> Mapping[str, Any]:
    """Differentiable values of a scatter plugin."""
    return owner.values if hasattr(owner, "rebuild_model") else {}


def _has(shape: Any, owner: Any, name: str) -> bool:
    """Whether a parameter of a plugin is about a shape."""
    if owner is shape:
        return name in shape_parameters(shape)
    bsdf = shape.bsdf()
    if name in SHIFTS:
        return owner is bsdf and hasattr(bsdf, "coating")
    if name in _values(owner):
        return any(owner is item for item in getattr(bsdf, "scatterers", ()))
    return name in (*LAYER_PARAMETERS, *IDEAL_PARAMETERS) and owner is getattr(bsdf, "film", None)


_About = tuple[str, str, float, float, float] | None  # kind, unit, tolerance, low, high


def _about_scatter(owner: Any, name: str, value: np.ndarray) -> _About:
    if fixed(owner, name) is not None:
        return None
    param = owner.model.param(name)
    return "scatter", param.unit, param.usual_tolerance(float(value[0])), *param.ends


def _about_bsdf(owner: Any, name: str, value: np.ndarray) -> _About:
    if name in SHIFTS:
        if owner.opaque and not isinstance(owner.coating, Stack):
            return None
        n = owner.indices(owner.wavelength_nm)[SHIFTS.index(name)]
        return "index", "1", INDEX if n > GAS else INDEX_OF_AIR, value[0] - n, math.inf
    if name in IDEAL_PARAMETERS:
        if value[0] == 0:
            return None
        return "share", "1", max(SHARE * min(value[0], 1 - value[0]), LEAST_SHARE), 0.0, 1.0
    if name == "thickness_nm":
        return "coating", "nm", THICKNESS * float(value.mean()) or 1.0, 0.0, math.inf
    indices = np.array(owner.coating.indices(owner.design_nm))
    if name == "n_shift":
        return "coating", "1", LAYER_INDEX, float(np.max(value - indices.real)), math.inf
    return "coating", "1", LAYER_K, float(np.max(value - indices.imag)), math.inf


def _of_source(key: str, source: Any, name: str) -> Parameter:
    """A number of a source, which is about no surface."""
    within, value = source.ranges[name], source.values[name]
    tolerance = source.tolerances.get(name, OF_SOURCE * abs(value) or OF_SOURCE)
    return Parameter(
        key, "source", within.unit, np.array([value]), source, name, (), tolerance, within.low, within.high
    )


def _about_shape(shape: Any, name: str, value: np.ndarray) -> _About:
    v, size = shape.values, shape.outer_radius

    def length(usual: float) -> float:
        return min(usual, IN_PROPORTION * size)

    if name in DISPLACEMENT:
        usual = MECHANICS_MM if shape.mechanics else OPTICS_MM
        return "position", "mm", length(usual), -math.inf, math.inf
    if name in ROTATION:
        return "tilt", "deg", ARCMIN, -180.0, 180.0
    if name in ("z0", "z1"):
        return "rim", "mm", length(RIM_MM), -math.inf, math.inf
    if name in ("r0", "r1"):
        other = v["r1" if name == "r0" else "r0"] if shape.flat else 0.0  # an annulus keeps its width
        low, high = (0.0, other) if v[name] < other else (other, math.inf)
        return "rim", "mm", length(RIM_MM), low, high
    if name not in (*CLEAR_APERTURE, "curvature", "conic", *COEFFICIENTS):  # of a family of one's own
        return "rim", "mm", length(RIM_MM), shape.ranges[name].low, shape.ranges[name].high
    c, k = v["curvature"], v["conic"]
    if name in CLEAR_APERTURE:
        low = v["inner_semi_diameter"] if name == "semi_diameter" else 0.0
        end = 1 / (abs(c) * math.sqrt(1 + k)) if c and k > -1 else math.inf
        return "rim", "mm", length(RIM_MM), low, v["semi_diameter"] if name == "inner_semi_diameter" else end
    if name == "curvature":
        end = 1 / (size * math.sqrt(1 + k)) if k > -1 else math.inf
        return "curvature", "1/mm", max(RADIUS * abs(c), 2 * FRINGES_MM / size**2), -end, end
    if name == "conic":
        return "conic", "1", _conic_tolerance(c, k, size), -math.inf, 1 / (c * size) ** 2 - 1 if c else math.inf
    order = 4 + 2 * COEFFICIENTS.index(name)
    return "asphere", f"mm^{1 - order}", FORM_MM / size**order, -math.inf, math.inf


def _conic_tolerance(curvature: float, conic: float, radius: float) -> float:
    """Change of the conic constant that moves the rim by `FORM_MM`; 1 for a plane, which has none."""
    lower = conic - 1e-4  # upwards a hemisphere would end
    slope = (sag(radius**2, curvature, conic) - sag(radius**2, curvature, lower)) / (conic - lower)
    return FORM_MM / abs(slope) if slope else 1.0

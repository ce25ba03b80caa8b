"""Usual tolerances of the parameters of a scene, and their kinds, units and ranges.

Tolerances are those that a workshop holds by default, half the width of the range. They rank parameters; give your own
if you have them.

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

import math
from typing import Any

import numpy as np

from mistray.coatings import Stack
from mistray.gradients.coating_gradient import IDEAL_PARAMETERS, SHIFTS
from mistray.gradients.scatter_gradient import fixed
from mistray.physics.geometry.outline import Outline
from mistray.physics.geometry.sag import conic_end, sag
from mistray.physics.sags.terms import length_power
from mistray.ranges import Range
from mistray.surfaces.gradient_columns import COEFFICIENTS, DISPLACEMENT, ROTATION

OF_SOURCE = 0.01  # relative tolerance of a number of a source that declares none
THICKNESS, LAYER_INDEX, LAYER_K = 0.01, 0.01, 1e-4
SHARE, LEAST_SHARE = 0.2, 1e-3
RADIUS, FRINGES_MM, FORM_MM = 1e-3, 3 * 633e-6 / 2, 5e-4
CLEAR_APERTURE = ("semi_diameter", "inner_semi_diameter", "half_width", "half_height")
RIM_MM, OPTICS_MM, MECHANICS_MM, IN_PROPORTION = 0.1, 0.02, 0.1, 0.01
ARCMIN = 1 / 60
INDEX, INDEX_OF_AIR, GAS = 5e-4, 1e-5, 1.01

About = tuple[str, str, float, float, float] | None  # kind, unit, tolerance, low, high


def about_scatter(owner: Any, name: str, value: np.ndarray) -> About:
    """
    Return kind, unit, usual tolerance and range of a scatter model's parameter; None if it has no derivative.

    Arguments and results are attributes of `mistray.metrics.parameters.Parameter`; so are those of `about_bsdf`,
    `about_source` and `about_shape`.
    """
    if fixed(owner, name) is not None:
        return None
    param = owner.model.param(name)
    return "scatter", param.unit, param.usual_tolerance(float(value[0])), *param.ends


def about_bsdf(owner: Any, name: str, value: np.ndarray) -> About:
    """
    Return kind, unit, usual tolerance and range of an index, R or T, or coating layers; see `about_scatter`.

    The result is None for an index next to an opaque surface without layers, and for R or T of 0.
    """
    if name in SHIFTS:
        if owner.opaque and not isinstance(owner.coating, Stack):
            return None
        n = owner.known_indices[SHIFTS.index(name)]
        return "index", "1", INDEX if n > GAS else INDEX_OF_AIR, value[0] - n, math.inf
    if name in IDEAL_PARAMETERS:
        if value[0] == 0:
            return None
        return "share", "1", max(SHARE * min(value[0], 1 - value[0]), LEAST_SHARE), 0.0, 1.0
    if name == "thickness_nm":
        return "coating", "nm", THICKNESS * float(value.mean()) or 1.0, 0.0, math.inf
    indices = np.array(owner.coating.indices(owner.design_nm, nearest=True))
    if name == "n_shift":
        return "coating", "1", LAYER_INDEX, float(np.max(value - indices.real)), math.inf
    return "coating", "1", LAYER_K, float(np.max(value - indices.imag)), math.inf


def about_source(owner: Any, name: str, value: np.ndarray) -> About:
    """Return kind, unit, usual tolerance and range of a parameter of a light source; see `about_scatter`."""
    within = owner.ranges[name]
    tolerance = owner.tolerances.get(name, OF_SOURCE * abs(value[0]) or OF_SOURCE)
    return "source", within.unit, tolerance, within.low, within.high


def about_shape(shape: Any, name: str, value: np.ndarray) -> About:
    """Return kind, unit, tolerance and range of a parameter of a shape's figure, rims or place; see `about_scatter`."""
    v, size = shape.values, _size(shape)

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
        return _about_own(name, shape, length(RIM_MM), shape.ranges[name])
    c, k = v["curvature"], v["conic"]
    if name in ("curvature", "conic") and {"curvature_x", "toroid_curvature"} & v.keys():
        size = _size(shape, 1)
    if name in CLEAR_APERTURE:
        low = v.get("inner_semi_diameter", 0.0) if name == "semi_diameter" else 0.0
        end = 1 / (abs(c) * math.sqrt(1 + k)) if c and k > -1 else math.inf
        return "rim", "mm", length(RIM_MM), low, v["semi_diameter"] if name == "inner_semi_diameter" else end
    if name == "curvature":
        end = 1 / (size * math.sqrt(1 + k)) if k > -1 else math.inf
        return "curvature", "1/mm", _curvature_tolerance(c, size), -end, end
    if name == "conic":
        return "conic", "1", _conic_tolerance(c, k, size), -math.inf, 1 / (c * size) ** 2 - 1 if c else math.inf
    order = 4 + 2 * COEFFICIENTS.index(name)
    return "asphere", f"mm^{1 - order}", FORM_MM / size**order, -math.inf, math.inf


def _about_own(name: str, shape: Any, rim_mm: float, within: Range) -> About:
    """
    Return kind, unit, usual tolerance and range of a freeform's sag parameter; other names count as sizes of a rim.

    `rim_mm` is the tolerance of a rim of the shape, mm, and `within` gives the range.
    """
    power = length_power(name)
    if power is None:
        turned = name.endswith("angle_deg")
        return "rim", "deg" if turned else "mm", ARCMIN if turned else rim_mm, within.low, within.high
    unit = {1: "mm", 0: "1", -1: "1/mm"}.get(power, f"mm^{power}")
    if name == "conic_x":
        usual = _conic_tolerance(shape.values.get("curvature_x", 0.0), shape.values[name], _size(shape, 0))
        return "conic", unit, usual, within.low, within.high
    if name in ("curvature_x", "toroid_curvature"):
        return "curvature", unit, _curvature_tolerance(shape.values[name], _size(shape, 0)), within.low, within.high
    return "asphere", unit, FORM_MM / _size(shape) ** (1 - power), within.low, within.high


def _size(shape: Any, axis: int | None = None) -> float:
    """
    Return the radius of a shape's rim, mm; of an outline that is no circle about the vertex, a radius around it.

    With an `axis`, 0 for x or 1 for y, it is the distance that an outline reaches along that axis.
    """
    outline: Outline | None = getattr(shape, "outline", None)
    if outline is not None and axis is not None:
        return max(map(abs, outline.bounds()[2 * axis : 2 * axis + 2]))
    ring = None if outline is None else outline.annulus
    return ring[0] if ring else float(shape.outer_radius)


def _curvature_tolerance(curvature: float, size: float) -> float:
    """Return the usual tolerance of a curvature, 1/mm, of a surface with a rim of radius `size`, mm."""
    return max(RADIUS * abs(curvature), 2 * FRINGES_MM / size**2)


def _conic_tolerance(curvature: float, conic: float, radius: float) -> float:
    """
    Return the change of the conic constant that moves the surface at its rim by `FORM_MM`; 1 for a plane.

    `curvature` is in 1/mm, `radius` that of the rim, mm.
    """
    radius = min(radius, (1 - 1e-9) * conic_end(curvature, conic))
    lower = conic - 1e-4  # upwards a hemisphere would end
    slope = (sag(radius**2, curvature, conic) - sag(radius**2, curvature, lower)) / (conic - lower)
    return FORM_MM / abs(slope) if slope else 1.0

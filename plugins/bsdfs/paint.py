"""Plugin `paint`: a diffuse surface with an optional glossy lobe."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.paint import Paint as Model


class Paint(Scatterer):
    r"""
    Paint (:monosp:`paint`): BSDF = ρ/π + b0 [1 + (r/l)²]^(s/2) · sqrt(F(θi) F(θs))/F(0), with r = \|β - β0\|.

    F is the Fresnel reflectance of the binder's index n; without n the last factor is 1. The BSDF is absolute, and its
    light is taken from the absorbed light. An ``interface`` around it needs an R that is the specular reflectance
    beside the scatter, ``R`` = 0 for a matt paint. By itself it has R = T = 0.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    reflectance       1       0 … 1        0          ρ of the Lambertian part (differentiable)
    preset            string               none       reflectance of a paint by name: ``flat_black``,
                                                      ``black_lambertian``, ``white_lambertian``,
                                                      ``good_black_paint``, ``black_anodise``; see
                                                      `mistray.scatter.paint.PRESETS`
    b0                1/sr    ≥ 0          0          peak of the glossy lobe at normal incidence
                                                      (differentiable)
    l                 1       > 0          0.1        r of the lobe's knee (differentiable)
    s                 1       < 0          -2         slope beyond the knee (differentiable)
    n                 1       > 1          none       index of the binder, about 1.5 (differentiable)
    event             string               reflection event that scatters: ``reflection``, ``transmission`` or
                                                      ``both``
    side              string               both       side from which light is scattered: ``front``, ``back``,
                                                      ``both``
    relative_to       string               incident   BSDF per unit of R and T (``specular``) or per unit of
                                                      incident light (``incident``), taken from the absorbed
                                                      light
    R                 1       0 … 1        0          by itself only: reflectance beside the scatter
                                                      (differentiable)
    T                 1       0 … 1        0          by itself only: transmittance (differentiable)
    front, back       string               air        by itself only: materials, see ``interface``
    n_front_shift     1       ±            0          by itself only; see ``interface`` (differentiable)
    n_back_shift      1       ±            0          by itself only; see ``interface`` (differentiable)
    mirror            bool                 false      by itself only; see ``interface``
    wavelength_nm     nm      > 0          source     by itself only; see ``interface``
    ================= ======= ============ ========== ==========================================================

    It is reciprocal, also at grazing incidence. Source: see `mistray.scatter.paint`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0"/>
            <bsdf type="paint"><float name="reflectance" value="0.04"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "paint", "reflectance": 0.03, "b0": 0.5, "l": 0.2, "s": -3.0, "n": 1.5}
    """

    kind = "paint"
    model_type = Model


mi.register_bsdf("paint", lambda props: Paint(props))

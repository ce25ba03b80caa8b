"""Plugin `phong`: the Phong model of scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.phong import Phong as Model


class PhongLobe(Scatterer):
    r"""
    Phong scatter (:monosp:`phong`): BSDF = b0 cos^n α, with the angle α to the specular direction.

    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    b0                1/sr    ≥ 0          required   BSDF in the specular direction; TIS at normal incidence is
                                                      2π b0/(n + 2) (differentiable)
    exponent          1       ≥ 1          required   exponent n (differentiable)
    event             string               both       event that scatters: ``reflection``, ``transmission`` or
                                                      ``both``
    side              string               both       side from which light is scattered: ``front``, ``back``,
                                                      ``both``
    relative_to       string               specular   BSDF per unit of R and T (``specular``) or per unit of
                                                      incident light (``incident``), taken from the absorbed
                                                      light
    R                 1       0 … 1        1          by itself only: reflectance (differentiable); by default 0
                                                      with T or with ``relative_to`` ``incident``
    T                 1       0 … 1        0          by itself only: transmittance (differentiable)
    front, back       string               air        by itself only: materials, see ``interface``
    n_front_shift     1       ±            0          by itself only; see ``interface`` (differentiable)
    n_back_shift      1       ±            0          by itself only; see ``interface`` (differentiable)
    mirror            bool                 false      by itself only; see ``interface``
    wavelength_nm     nm      > 0          source     by itself only; see ``interface``
    ================= ======= ============ ========== ==========================================================

    It is reciprocal in reflection if R is constant; in transmission it is not. At oblique incidence the horizon cuts
    off part of the lobe. Source: see `mistray.physics.phong`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0.9"/>
            <bsdf type="phong"><float name="b0" value="0.1"/><float name="exponent" value="16"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "phong", "b0": 0.1, "exponent": 16.0, "R": 0.9}
    """

    kind = "phong"
    model_type = Model


mi.register_bsdf("phong", lambda props: PhongLobe(props))

"""Plugin `harvey_shack`: scatter of polished surfaces."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.harvey_shack import HarveyShack as Model


class HarveyShack(Scatterer):
    r"""
    Harvey-Shack scatter (:monosp:`harvey_shack`): BSDF = b0 [1 + (r/l)²]^(s/2), with r = \|β - β0\|.

    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T. Exactly one of ``b0`` and ``rms_nm`` determines how much is scattered. With
    ``rms_nm`` b0 follows from the indices on both sides, with Δn = 2 n in reflection and the difference of the indices
    in transmission. A surface that is not smooth is refused.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    b0                1/sr    ≥ 0          none       BSDF at r = 0 (differentiable)
    rms_nm            nm      ≥ 0          none       RMS roughness instead of b0 (differentiable)
    l                 1       > 0          0.01       r of the knee (differentiable)
    s                 1       < 0          -1.5       slope beyond the knee (differentiable)
    reference_nm      nm      > 0          none       wavelength at which b0 and l hold; at others the scatter
                                                      of a smooth surface is scaled. None: l, and b0 if given,
                                                      do not depend on the wavelength
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

    It is reciprocal in reflection if R is constant. Source: see `mistray.physics.harvey_shack`.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="back" value="nd=1.544 Vd=56.1"/>
            <bsdf type="harvey_shack"><float name="rms_nm" value="4"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "harvey_shack", "b0": 0.1099, "l": 0.01, "s": -1.5, "R": 0.95}
    """

    kind = "harvey_shack"
    model_type = Model


mi.register_bsdf("harvey_shack", lambda props: HarveyShack(props))

"""Plugin `gaussian_lobe`: a Gaussian lobe of scatter."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.gaussian import Gaussian as Model


class GaussianLobe(Scatterer):
    r"""
    Gaussian scatter (:monosp:`gaussian_lobe`): BSDF = f0 exp(-(r/w)²), with r = \|β - β0\|.

    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    total             1       0 … 1        required   fraction of R and T scattered at normal incidence
                                                      (differentiable)
    width             1       > 0          required   w: the r at which the BSDF is 1/e of its peak (differentiable)
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

    It is reciprocal in reflection if R is constant. Source: see `mistray.physics.gaussian`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0.9"/>
            <bsdf type="gaussian_lobe"><float name="total" value="0.2"/><float name="width" value="0.05"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "gaussian_lobe", "total": 0.2, "width": 0.05, "R": 0.9}
    """

    kind = "gaussian_lobe"
    model_type = Model


mi.register_bsdf("gaussian_lobe", lambda props: GaussianLobe(props))

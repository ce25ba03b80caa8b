"""Plugin `k_correlation`: scatter of a surface with a given roughness spectrum."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.k_correlation import KCorrelation as Model


class KCorrelation(Scatterer):
    r"""
    Scatter of a roughness spectrum (:monosp:`k_correlation`): PSD = A'/[1 + (B f)²]^(S/2).

    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T. The scatter follows from the indices on both sides by the generalised Harvey-Shack
    or the Rayleigh-Rice theory. A surface that is too rough for the theory is refused.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    rms_nm            nm      ≥ 0          required   rms roughness σ: over all frequencies, or over 0 … 1/λ
                                                      if ``band_limited`` (differentiable)
    B_um              um      > 0          required   1/B is the frequency of the knee (differentiable)
    slope             1       > 2; > 0     required   S; > 0 if ``band_limited`` (differentiable)
    band_limited      bool                 false      whether ``rms_nm`` is that of the band 0 … 1/λ only
    theory            string               ghs        ``ghs`` (smooth surfaces), ``ghs_full`` (rougher ones, S =
                                                      3), ``rayleigh_rice``, ``rayleigh_rice_vector``
    reference_nm      nm      > 0          none       wavelength of the band of ``rms_nm``; none: that of the
                                                      light
    substrate         string               back       n+ik of the substrate for ``rayleigh_rice_vector``:
                                                      ``0.96+6.69i``
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

    It is reciprocal in reflection if R is constant and the theory is not ``rayleigh_rice_vector``. Source: see
    `mistray.physics.k_correlation`.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="back" value="N-BK7"/>
            <bsdf type="k_correlation">
                <float name="rms_nm" value="2"/><float name="B_um" value="100"/><float name="slope" value="2.5"/>
            </bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "k_correlation", "rms_nm": 2.0, "B_um": 100.0, "slope": 2.5, "R": 0.95}
    """

    kind = "k_correlation"
    model_type = Model


mi.register_bsdf("k_correlation", lambda props: KCorrelation(props))

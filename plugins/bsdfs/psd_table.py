"""Plugin `psd_table`: scatter of a surface with a measured roughness spectrum."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.measured.psd_table import PsdTable as Model


class PsdTable(Scatterer):
    r"""
    Scatter of a measured roughness spectrum (:monosp:`psd_table`): a PSD interpolated in a file.

    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T. The scatter follows from the indices on both sides by the generalised Harvey-Shack
    or the Rayleigh-Rice theory. A surface that is too rough for the theory is refused.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    file              file                 required   CSV of spatial frequencies and of the two-dimensional
                                                      spectrum, see docs/scatter.md
    beyond            string               error      above the last frequency: ``error``, ``slope`` (the power
                                                      law goes on), or ``zero``
    scale             1       ≥ 0          1          factor that multiplies the spectrum (differentiable)
    theory            string               ghs        ``ghs``, ``rayleigh_rice`` or ``rayleigh_rice_vector``
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
    `mistray.scatter.rough_surface`.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="back" value="N-BK7"/>
            <bsdf type="psd_table">
                <string name="file" value="polish.csv"/><string name="beyond" value="slope"/>
            </bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "psd_table", "file": "polish.csv", "beyond": "slope", "R": 0.95}
    """

    kind = "psd_table"
    model_type = Model


mi.register_bsdf("psd_table", lambda props: PsdTable(props))

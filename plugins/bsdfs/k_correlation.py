"""Plugin `k_correlation`: scatter of a surface with a given roughness spectrum."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.k_correlation import KCorrelation as Model


class KCorrelation(Scatterer):
    r"""
    Scatter of a roughness spectrum (:monosp:`k_correlation`): PSD = A'/[1 + (B f)²]^(S/2).

    The PSD is in µm⁴. f is the spatial frequency, 1/µm, B is ``B_um``, S is ``slope``, and A' follows from ``rms_nm``.
    Nested in an ``interface`` it scatters a fraction of the light that this reflects and transmits. By itself it is an
    interface with constant R and T. The scatter follows from the indices on both sides by the generalised Harvey-Shack
    or the Rayleigh-Rice theory. A surface that is too rough for the theory is refused.

    .. parameters::

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

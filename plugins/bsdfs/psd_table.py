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

    .. parameters::

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

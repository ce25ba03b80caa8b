"""Plugin `tabulated`: measured scatter, interpolated in a table."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.sample_axis import SAMPLE, SampleAxis
from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.measured.tabulated import Tabulated as Model


class Tabulated(Scatterer):
    r"""
    Measured scatter (:monosp:`tabulated`): a BSDF interpolated in a file.

    The BSDF is absolute and its light is taken from the absorbed light, unless ``relative_to`` is ``specular``. Nested
    in an ``interface``, it leaves the R and T of that as the specular fractions. By itself it has R = T = 0. A surface
    has one sample axis: all its anisotropic models must have the same.

    .. parameters::

    It has no differentiable parameters. Source: see `mistray.scatter.measured.tabulated`.

    .. code-block:: xml

        <bsdf type="interface">
            <float name="R" value="0"/>
            <bsdf type="tabulated"><string name="file" value="black.bsdf"/></bsdf>
        </bsdf>

    .. code-block:: python

        {"type": "tabulated", "file": "black.bsdf"}
    """

    kind = "tabulated"
    model_type = Model
    properties = SAMPLE

    def _read_model(self, props: mi.Properties) -> Model:
        model = super()._read_model(props)
        assert isinstance(model, Model)
        axis = SampleAxis(props, model.anisotropic, self.title)
        self.sample_axis = axis if model.anisotropic else None
        return model


mi.register_bsdf("tabulated", lambda props: Tabulated(props))

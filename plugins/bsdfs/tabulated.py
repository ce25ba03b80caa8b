"""Plugin `tabulated`: measured scatter, interpolated in a table."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.sample_axis import SampleAxis
from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.measured.tabulated import Tabulated as Model


class Tabulated(Scatterer):
    r"""
    Measured scatter (:monosp:`tabulated`): a BSDF interpolated in a file.

    The BSDF is absolute and its light is taken from the absorbed light, unless ``relative_to`` is ``specular``. Nested
    in an ``interface``, it leaves the R and T of that as the specular fractions. By itself it has R = T = 0. A surface
    has one sample axis: all its anisotropic models must have the same.

    ================= ======= ============ ========== ==========================================================
    parameter         unit    range        default    meaning
    ================= ======= ============ ========== ==========================================================
    file              file                 required   Zemax tabular BSDF (``.bsdf``) or CSV of angles
                                                      (``.csv``), see docs/scatter.md
    cosine_corrected  bool                 false      whether the values are BSDF · cos θs
    beyond            string               error      past the last angle of the table: ``error``, ``hold`` the
                                                      last value, or ``zero``
    anisotropy        string               error      scatter that differs between rotations of the sample, or
                                                      between the sides of the plane of incidence: ``error``,
                                                      ``mean``, or ``keep``: it depends on how the sample lies
    sample_axis       string               x          x axis of an anisotropic sample: that of the shape, ``x``, or
                                                      in the plane through the shape's z axis, ``meridian``, as
                                                      for marks of a lathe
    rotation_deg      deg     -360 … 360   0          right-handed rotation of the sample: for ``x`` about the
                                                      shape's z axis, for ``meridian`` about its normal
    event             string               both       event that scatters: ``reflection``, ``transmission`` or
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

    def _read_model(self, props: mi.Properties) -> Model:
        model = super()._read_model(props)
        assert isinstance(model, Model)
        axis = SampleAxis(props, model.anisotropic, self.title)
        self.sample_axis = axis if model.anisotropic else None
        return model


mi.register_bsdf("tabulated", lambda props: Tabulated(props))

"""Plugin `edge_diffraction`: light diffracted at the edge of an opening, as scatter by a thin ring inside it."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.edge_diffraction import EdgeDiffraction as Model


class EdgeDiffraction(Scatterer):
    r"""
    Edge diffraction (:monosp:`edge_diffraction`): far from the beam, BSDF = λ/(4π³ w r³) · (1 - β0·β)/(cos θ0 cos θ).

    β and β0 are the direction cosines along the ring of the scattered and of the incident ray, at the angles θ and θ0
    to its normal. Their distance is r = \|β - β0\|. The wavelength is λ, and the width of the ring w. The BSDF is in
    1/sr. It is nested in the ``interface`` (R = 0, T = 1, one material) of a ring. The ring is a ``frustum`` of no
    height that lies in an opening along its edge. It deflects all light that meets it. Beyond the angle λ/(16 w) the
    diffracted light does not depend on the width. The model is for unpolarised light, averaged over all directions of
    the edge. It is right for the far field of an evenly lit round opening, or for the image of that by a lens.

    .. parameters::

    It is reciprocal. Source: see `mistray.physics.diffraction`.

    .. code-block:: xml

        <shape type="frustum" id="stop_edge">
            <float name="r0" value="4.95"/> <float name="z0" value="0"/>
            <float name="r1" value="5"/> <float name="z1" value="0"/>
            <bsdf type="interface">
                <float name="R" value="0"/><float name="T" value="1"/>
                <bsdf type="edge_diffraction"><float name="width_mm" value="0.04975"/></bsdf>
            </bsdf>
        </shape>

    .. code-block:: python

        {"type": "edge_diffraction", "width_mm": 0.04975, "R": 0.0, "T": 1.0}
    """

    kind = "edge_diffraction"
    model_type = Model


mi.register_bsdf("edge_diffraction", lambda props: EdgeDiffraction(props))

"""Plugin `edge_diffraction`: light diffracted at the edge of an opening, as scatter by a thin ring inside it."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.bsdfs.scatterer import Scatterer
from mistray.scatter.edge_diffraction import EdgeDiffraction as Model


class EdgeDiffraction(Scatterer):
    r"""
    Edge diffraction (:monosp:`edge_diffraction`): far from the beam, BSDF = λ/(4π³ w r³) · (1 - β0·β)/(cos θ0 cos θ).

    r = \|β - β0\|. It is nested in the ``interface`` (R = 0, T = 1, one material) of a ring. The ring is a ``frustum``
    of no height that lies in an opening along its edge. It deflects all light that meets it. Beyond the angle λ/(16 w)
    the diffracted light does not depend on the width. The model is for unpolarised light, averaged over all directions
    of the edge. It is right for the far field of an evenly lit round opening, or for the image of that by a lens.

    ================= ======= ============ ============ ========================================================
    parameter         unit    range        default      meaning
    ================= ======= ============ ============ ========================================================
    width_mm          mm      ≥ 25 λ       required     w: area of the ring over the length of the edge,
                                                        (r1² - r0²)/(2 r1) where r1 is the edge (differentiable)
    law               string               half_plane   ``half_plane``, or ``heisenberg``: Heisenberg's relation as
                                                        in other programs, 1.25 times as much far from the beam
    event             string               transmission ``transmission`` only
    side              string               both         side from which light is diffracted: ``front``, ``back``,
                                                        ``both``
    relative_to       string               specular     BSDF per unit of T (``specular``) or of incident
                                                        light (``incident``), taken from the absorbed light
    R                 1       0 … 1        1            by itself only: reflectance (differentiable); by default 0
                                                        with T or with ``relative_to`` ``incident``
    T                 1       0 … 1        0            by itself only: transmittance (differentiable)
    front, back       string               air          by itself only: materials, see ``interface``
    n_front_shift     1       ±            0            by itself only; see ``interface`` (differentiable)
    n_back_shift      1       ±            0            by itself only; see ``interface`` (differentiable)
    mirror            bool                 false        by itself only; see ``interface``
    wavelength_nm     nm      > 0          source       by itself only; see ``interface``
    ================= ======= ============ ============ ========================================================

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

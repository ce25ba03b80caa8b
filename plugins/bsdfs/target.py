"""Plugin `target`: makes a shape a target of scattered rays instead of a surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mistray.errors import MistrayError
from mistray.trace.settings import MOST_RAYS_PER_HIT


class TargetMark(mi.BSDF):
    r"""
    Target of scattered rays (:monosp:`target`): its shape is no surface, light passes through it.

    The surfaces that it names send some of their scattered rays towards the shape, uniformly over its area. A shape
    that catches the light to the detector (the detector itself, its image by the lenses that follow, the next lens)
    lowers the error of the result; no target changes the result itself. A surface that is named here has no automatic
    targets.

    The shape is a ``disk``, a ``rectangle``, a flat ``frustum`` (a ring), an ``asphere`` (its rim) or a mesh of at
    most 64 triangles (a closed curve, filled).

    ========= ======= ======= ======== ===============================================================
    parameter unit    range   default  meaning
    ========= ======= ======= ======== ===============================================================
    surfaces  string          required ids of the surfaces that aim here, separated by commas; ``*`` and
                                       ``?`` stand for any text and any character
    rays      integer 1 … 255 1        aimed rays at every hit of such a surface, for reflection and for
                                       transmission each
    scale     1       > 0     1        the shape is enlarged so many times about its centre
    hole      1       0 … < 1 0        share of the radius that is left out in the middle (disk, ring,
                                       round asphere)
    reverse   bool            false    virtual target: rays leave away from it, as if they came from it
    ========= ======= ======= ======== ===============================================================

    Under stock integrators the shape is invisible.

    .. code-block:: xml

        <shape type="disk" id="image_of_detector">
            <transform name="to_world"><scale value="3"/><translate z="120"/></transform>
            <bsdf type="target">
                <string name="surfaces" value="window_*, L1_front"/>
                <integer name="rays" value="10"/>
            </bsdf>
        </shape>

    .. code-block:: python

        {"type": "disk", "bsdf": {"type": "target", "surfaces": "L1_*", "reverse": True}}
    """

    is_target = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        title = f"target '{props.id()}'" if props.id() else "target"
        if "surfaces" not in props:
            raise MistrayError(f"{title}: surfaces is missing; name those that aim here, '*' for all")
        self.surfaces = tuple(part.strip() for part in str(props.get("surfaces")).split(",") if part.strip())
        self.rays = _number(title, props, "rays", 1)
        self.scale = _number(title, props, "scale", 1.0)
        self.hole = _number(title, props, "hole", 0.0)
        self.reverse = bool(props.get("reverse", False))
        if not self.surfaces:
            raise MistrayError(f"{title}: surfaces is empty; name those that aim here, '*' for all")
        if not 1 <= self.rays <= MOST_RAYS_PER_HIT or self.rays != int(self.rays):
            raise MistrayError(f"{title}: rays is {self.rays:g}; give a whole number from 1 to {MOST_RAYS_PER_HIT}")
        self.rays = int(self.rays)
        if not 0 < self.scale < float("inf"):
            raise MistrayError(f"{title}: scale is {self.scale:g}; it must be positive and finite")
        if not 0 <= self.hole < 1:
            raise MistrayError(f"{title}: hole is {self.hole:g}; it is a share of the radius, 0 … below 1")
        self.m_components = [mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide]
        self.m_flags = self.m_components[0]

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Mask = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = -si.wi
        bs.pdf = dr.select(active, 1.0, 0.0)
        bs.eta = 1.0
        bs.sampled_type = +mi.BSDFFlags.Null
        return bs, mi.Spectrum(1.0) & active

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Spectrum:
        return mi.Spectrum(0)

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Float:
        return mi.Float(0)

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        return mi.Spectrum(0), mi.Float(0)

    def eval_null_transmission(self, si: mi.SurfaceInteraction3f, active: mi.Mask = True) -> mi.Spectrum:
        return mi.Spectrum(1.0) & active

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """A target has no parameters that a result depends on."""

    def to_string(self) -> str:
        return f"Target[surfaces = {', '.join(self.surfaces)}, rays = {self.rays}]"


def _number(title: str, props: mi.Properties, key: str, default: float) -> float:
    value = props.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MistrayError(f"{title}: {key} is {value!r}; it must be a number")
    return value


mi.register_bsdf("target", lambda props: TargetMark(props))

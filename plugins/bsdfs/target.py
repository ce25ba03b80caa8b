"""Plugin `target`: makes a shape a target of scattered rays instead of a surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mistray.errors import MistrayError
from mistray.kernel.targets import CONES
from mistray.param import documented, fixed, take
from mistray.ranges import FLAG, PART, RAYS_PER_HIT, TARGET_SCALE, TEXT, Range

TARGET_CONE_DEG = Range(1e-6, 180.0, unit="degrees")


@documented
class TargetMark(mi.BSDF):
    r"""
    Target of scattered rays (:monosp:`target`): its shape is not a surface, light passes through it.

    The surfaces that it names send some of their scattered rays towards the shape. So do the media on their sides, with
    light that they scatter on its way to the surface. Choose a shape that collects the light for the detector: the
    detector itself, its image by the lenses behind, or the next lens. A target lowers the error of the result and never
    changes its expected value. A surface that is named here has no automatic targets, and neither have its media.
    Several targets may name one surface, and they may overlap.

    The shape is a ``disk``, a ``rectangle``, a flat ``frustum`` (a ring), an ``asphere`` (its rim), a mesh of at most
    64 triangles (a closed curve, filled) or a ``sphere``. With ``half_axes`` the sphere is an ellipsoid. Rays are
    uniform over the area of a flat target, and in solid angle as seen from outside a sphere. With ``about`` the target
    is a cone of directions instead, and with ``entity`` a surface of the scene; the shape then only gives what
    ``about`` needs.

    .. parameters::

    None of these is differentiable: a target changes the error of a result and not its value, so that derivatives are
    0. Gradients of aimed light are those of the rays that were sent. Under Mitsuba's own integrators the shape is
    invisible.

    .. code-block:: xml

        <shape type="disk" id="image_of_detector">
            <transform name="to_world"><scale value="3"/><translate z="120"/></transform>
            <bsdf type="target">
                <string name="surfaces" value="window_*, L1_front"/>
                <integer name="rays" value="10"/>
            </bsdf>
        </shape>

    .. code-block:: python

        {"type": "disk", "bsdf": {"type": "target", "surfaces": "M1", "about": "specular", "cone_deg": 2.0}}
    """

    is_target = True

    properties = {
        "surfaces": fixed(
            "string",
            TEXT,
            "ids of surfaces that aim here, with commas between; ``*`` stands for any text, ``?`` for any character",
        ),
        "rays": fixed(
            "integer",
            RAYS_PER_HIT,
            "aimed rays at every hit of such a surface, for reflection and for transmission each, and of every segment "
            "in a medium",
            1,
        ),
        "scale": fixed("1", TARGET_SCALE, "factor by which the target is enlarged about its centre", 1.0),
        "hole": fixed(
            "1", PART, "fraction of the radius that is left out in the middle (disk, ring, round asphere)", 0.0
        ),
        "reverse": fixed("bool", FLAG, "virtual target: rays leave away from it, as if they came from it", False),
        "half_axes": fixed(
            "mm",
            TEXT,
            "three numbers, separated by commas: half axes of an ellipsoid along the sphere's own x, y and z",
            "",
            within="> 0",
        ),
        "entity": fixed(
            "string",
            TEXT,
            "id of a surface that is the target: its outline if it is flat or an asphere, else the ellipsoid around "
            "its bounding box",
            "",
        ),
        "about": fixed(
            "string",
            TEXT,
            "axis of a cone: ``point`` (the centre of the shape), ``direction`` (the local z of a flat shape) or "
            "``specular`` (the light that is not scattered; any shape will do)",
            "",
        ),
        "cone_deg": fixed("degree", TARGET_CONE_DEG, "half-angle of the cone", None),
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        title = self.owner = f"target '{props.id()}'" if props.id() else "target"
        if "surfaces" not in props:
            raise MistrayError(f"{title}: surfaces is missing; name those that aim here, '*' for all")
        self.surfaces = tuple(part.strip() for part in take(self, props, "surfaces").split(",") if part.strip())
        self.rays, self.scale, self.hole = (take(self, props, key) for key in ("rays", "scale", "hole"))
        self.reverse = take(self, props, "reverse")
        if not self.surfaces:
            raise MistrayError(f"{title}: surfaces is empty; name those that aim here, '*' for all")
        self.entity, self.about = (take(self, props, key).strip() for key in ("entity", "about"))
        self.half_axes = _lengths(title, take(self, props, "half_axes"))
        self.cone_deg = take(self, props, "cone_deg") or 0.0
        self._check(title)
        self.m_components = [mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide]
        self.m_flags = self.m_components[0]

    def _check(self, title: str) -> None:
        """Raise `MistrayError` for properties that are invalid for a target or would be ignored."""
        if self.about and self.about not in CONES:
            raise MistrayError(f"{title}: about is '{self.about}'; use {', '.join(CONES[:-1])} or {CONES[-1]}")
        if bool(self.about) != bool(self.cone_deg):
            given, missing = ("about", "cone_deg") if self.about else ("cone_deg", "about")
            raise MistrayError(f"{title}: {given} without {missing}; a cone needs both")
        kinds = [key for key, value in (("about", self.about), ("entity", self.entity)) if value]
        sizes = {"scale": self.scale != 1, "hole": self.hole != 0, "half_axes": bool(self.half_axes)}
        unused = [key for key, given in sizes.items() if given and kinds and (self.about or key != "scale")]
        if len(kinds) > 1 or unused:
            raise MistrayError(f"{title}: {' and '.join([*kinds, *unused][:2])} exclude each other; leave one out")

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
        """Expose no parameters to `mi.traverse`, as no result depends on a target."""

    def to_string(self) -> str:
        return f"Target[surfaces = {', '.join(self.surfaces)}, rays = {self.rays}]"


def _lengths(title: str, text: str) -> tuple[float, ...]:
    """
    Return the three positive lengths in a string, mm; () for an empty string.

    Raise `MistrayError` if another string does not hold three positive numbers.
    """
    if not text.strip():
        return ()
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != 3 or not all(0 < value < float("inf") for value in found):
        raise MistrayError(f"{title}: half_axes is '{text}'; give three positive numbers (mm), separated by commas")
    return found


mi.register_bsdf("target", lambda props: TargetMark(props))

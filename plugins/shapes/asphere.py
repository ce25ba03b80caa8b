"""Plugin `asphere`: a surface of revolution, traced analytically by the ray tree."""

from __future__ import annotations

from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.sag import in_proportion, sag
from mistray.plugins.shapes.formula_shape import POSE, RELATIVE, curvature_property, float_property, grid
from mistray.plugins.shapes.revolution import Revolution
from mistray.ranges import FINITE, RADIUS_MM, SIZE_MM, Range
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.gradient_columns import COEFFICIENTS

# Largest number in the ray tree, 1/mm and mm: single precision with room for products
MOST = FINITE.high
COEFFICIENT = Range(-1e300, 1e300)


class Asphere(Revolution):
    r"""
    Surface of revolution (:monosp:`asphere`): plane, sphere, conic or even asphere.

    The sag of the surface over its vertex plane is

    .. math::

        z(r) = \frac{c r^2}{1 + \sqrt{1 - (1 + k) c^2 r^2}} + \sum_{i=2}^{10} a_{2i} r^{2i}.

    The vertex is the origin of the local frame, and the normal at the vertex is +z. The side at -z is the ``front`` of
    the nested ``interface``, the side at +z its ``back``. The ray tree intersects the formula. Mitsuba's own
    integrators and viewers use a triangle mesh, which is remade when a parameter changes.

    ======================= ============ ======== ========= =======================================================
    parameter               unit         range    default   meaning
    ======================= ============ ======== ========= =======================================================
    radius                  mm           ±        plane     vertex radius of curvature; 0 or inf is a plane
    curvature               1/mm         ±        0         curvature instead of ``radius`` (differentiable)
    conic                   1            ±        0         conic constant k (differentiable)
    a4 … a20                mm^(1-order) ±        0         even aspheric coefficients (differentiable); ``mi.Float64``
                                                            in `mi.traverse`, for their range is that of lengths to
                                                            the power of -19
    semi_diameter           mm           > 0      required  clear radius (differentiable)
    inner_semi_diameter     mm           ≥ 0      0         radius of a central hole (differentiable)
    half_width              mm           > 0      none      half width in x of a rectangular clip, instead of
                                                            ``semi_diameter`` (differentiable)
    half_height             mm           > 0      none      half height in y of that clip (differentiable)
    to_world                mm           rigid    identity  position and orientation of the vertex frame
    x, y, z                 mm           ±        0         displacement along the axes of this frame (differentiable)
    tilt_x, tilt_y, tilt_z  deg          ±        0         right-handed rotations about these axes, through the
                                                            displaced vertex; the one about z comes first, then y, then
                                                            x (differentiable)
    part                    string                shape id  name of the object the surface belongs to
    space                   integer               -1        optical space, for grouping in reports
    (nested) bsdf           bsdf                  required  an ``interface``
    (nested) sensor         sensor                none      an ``irradiancemeter``: makes this shape the detector;
                                                            Mitsuba's own integrators see the front of its mesh
    ======================= ============ ======== ========= =======================================================

    Source of the formula: the usual even asphere (ISO 10110-12), written out in `mistray.physics.geometry.sag`.

    .. code-block:: xml

        <shape type="asphere" id="L1_front">
            <float name="radius" value="1.679"/>
            <float name="conic" value="0.22669364"/>
            <float name="a4" value="0.00980281"/>
            <float name="semi_diameter" value="1.43762465"/>
            <bsdf type="interface">
                <string name="back" value="N-BK7"/>
            </bsdf>
        </shape>

    .. code-block:: python

        {"type": "asphere", "radius": 50.0, "semi_diameter": 12.5, "bsdf": {"type": "interface", "back": "N-BK7"}}
    """

    mechanics = False
    columns = {
        **{name: (name,) for name in ("curvature", "conic", *COEFFICIENTS, "half_width", "half_height")},
        "semi_diameter": ("outer",),
        "inner_semi_diameter": ("inner",),
    }
    in_double = COEFFICIENTS
    ranges = {
        **dict.fromkeys(("semi_diameter", "half_width", "half_height"), SIZE_MM),
        **dict.fromkeys(COEFFICIENTS, COEFFICIENT),
        "inner_semi_diameter": RADIUS_MM, "curvature": FINITE, "conic": FINITE,
    }  # fmt: skip

    def __init__(self, props: mi.Properties) -> None:
        self._start(props)
        values = {"curvature": curvature_property(props, "radius", "curvature")}
        rectangular = "half_width" in props or "half_height" in props
        if rectangular == ("semi_diameter" in props):
            raise MistrayError(
                f"shape '{self.name}': give either semi_diameter or both half_width and half_height (mm)"
            )
        if rectangular and not (("half_width" in props) and ("half_height" in props)):
            raise MistrayError(
                f"shape '{self.name}': a rectangular clip needs half_width and half_height (mm); give both"
            )
        values |= {"conic": float_property(props, "conic", 0.0)}
        values |= {key: float_property(props, key, 0.0) for key in COEFFICIENTS}
        if rectangular:
            values |= {key: float_property(props, key) for key in ("half_width", "half_height")}
        else:
            values |= {"semi_diameter": float_property(props, "semi_diameter")}
            values |= {"inner_semi_diameter": float_property(props, "inner_semi_diameter", 0.0)}
        self._finish(props, values)

    @property
    def rectangular(self) -> bool:
        """Whether the surface is clipped to a rectangle and not to a circle."""
        return "half_width" in self.values

    @property
    def sheet(self) -> bool:
        return True

    @property
    def figure(self) -> str:
        return "rectangle" if self.rectangular else "asphere" if any(self.coefficients) else "sphere or plane"

    @property
    def plane(self) -> bool:
        """Whether the surface is flat."""
        return self.values["curvature"] == 0 and not any(self.coefficients)

    @property
    def outer_radius(self) -> float:
        """Largest distance of the surface from its axis, mm."""
        v = self.values
        return float(np.hypot(v["half_width"], v["half_height"])) if self.rectangular else v["semi_diameter"]

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Aspheric coefficients a4 … a20, mm^-3 … mm^-19."""
        return tuple(self.values[key] for key in COEFFICIENTS)

    def sag(self, r: np.ndarray) -> np.ndarray:
        """Return the sag over the vertex plane, mm, at distances r from the axis, mm; float64."""
        c, k = self.values["curvature"], self.values["conic"]
        # A hemisphere's rim may exceed the end of the sphere by a rounding error
        r2 = np.square(r) if (1 + k) * c == 0 or k < -1 else np.minimum(np.square(r), (1 - 1e-15) / ((1 + k) * c * c))
        return np.asarray(sag(r2, c, k, self.coefficients))

    @staticmethod
    def surface(values: Mapping[str, float]) -> SagSurface:
        shape = values["curvature"], values["conic"], tuple(values[key] for key in COEFFICIENTS)
        if "half_width" in values:
            return SagSurface.of(*shape, half_size=(values["half_width"], values["half_height"]))
        return SagSurface.of(*shape, outer=values["semi_diameter"], inner=values["inner_semi_diameter"])

    @property
    def differentiable(self) -> tuple[str, ...]:
        return tuple(name for name in self.values if name != "inner_semi_diameter" or self.values[name])

    def step(self, name: str) -> float:
        if name in POSE:
            return super().step(name)
        v = self.values
        size = max(v["half_width"], v["half_height"]) if self.rectangular else v["semi_diameter"]
        powers = {"curvature": -1, "conic": 0} | {column: -3 - 2 * k for k, column in enumerate(COEFFICIENTS)}
        return float(RELATIVE * size ** powers.get(name, 1))

    def check(self) -> None:
        v = self.values
        if not self.rectangular and not 0 <= v["inner_semi_diameter"] < v["semi_diameter"]:
            raise MistrayError(
                f"shape '{self.name}': inner_semi_diameter is {v['inner_semi_diameter']:g} mm; "
                f"it must lie between 0 and semi_diameter = {v['semi_diameter']:g} mm"
            )
        self._check_single_precision()
        end = (1 + v["conic"]) * (v["curvature"] * self.outer_radius) ** 2
        if end > 1 + 1e-9:
            limit = 1 / (abs(v["curvature"]) * np.sqrt(1 + v["conic"]))
            raise MistrayError(
                f"shape '{self.name}': the conic ends at r = {limit:.6g} mm, inside the aperture of "
                f"{self.outer_radius:.6g} mm; reduce the aperture or the curvature"
            )

    def _check_single_precision(self) -> None:
        """Raise an error if a number is too large for the ray tree, which works in float32."""
        v, size = self.values, self.outer_radius
        numbers = {"product": v["curvature"] * (1 + v["conic"])}
        numbers |= dict(zip(COEFFICIENTS, in_proportion(self.coefficients, size)[0], strict=True))
        for key, number in numbers.items():
            if not abs(number) < MOST:
                name = "conic" if key == "product" else key
                raise MistrayError(
                    f"shape '{self.name}': {name} is {v[name]:g}, too much for float32 at an aperture of {size:g} mm; "
                    "correct it or its unit"
                )

    def profile(self, count: int = 65) -> np.ndarray:
        inner = self.values.get("inner_semi_diameter", 0.0)
        r = np.linspace(inner, self.values["half_height"] if self.rectangular else self.outer_radius, count)
        return np.column_stack([r, self.sag(r)])

    def _local_mesh(self) -> tuple[np.ndarray, np.ndarray]:
        if not self.rectangular:
            return super()._local_mesh()
        xy, faces = grid(self.values["half_width"], self.values["half_height"], 1 if self.plane else 32)
        return np.column_stack([xy, self.sag(np.hypot(xy[:, 0], xy[:, 1]))]), faces


mi.register_shape("asphere", lambda props: Asphere(props))

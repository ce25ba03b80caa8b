"""Plugin `asphere`: a surface of revolution, traced analytically by the ray tree."""

from __future__ import annotations

from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param, documented, take
from mistray.physics.geometry.sag import in_proportion, sag
from mistray.plugins.shapes.formula_shape import (
    CURVATURE,
    DETECTOR,
    FRAME,
    MOVES,
    NAMES,
    RADIUS,
    RELATIVE,
    curvature_of,
    grid,
)
from mistray.plugins.shapes.revolution import Revolution
from mistray.ranges import FINITE, RADIUS_MM, SIZE_MM, Range
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.gradient_columns import COEFFICIENTS

# Largest number in the ray tree, 1/mm and mm: single precision with room for products
MOST = FINITE.high
COEFFICIENT = Range(-1e300, 1e300)


@documented
class Asphere(Revolution):
    r"""
    Surface of revolution (:monosp:`asphere`): plane, sphere, conic or even asphere.

    The sag of the surface over its vertex plane is

    .. math::

        z(r) = \frac{c r^2}{1 + \sqrt{1 - (1 + k) c^2 r^2}} + \sum_{i=2}^{10} a_{2i} r^{2i}.

    Here r is the distance from the axis, c the ``curvature`` and k the ``conic`` constant. The vertex is the origin of
    the local frame, and the normal at the vertex is +z. The side at -z is the ``front`` of the nested ``interface``,
    the side at +z its ``back``. The ray tree intersects the formula. Mitsuba's own integrators and viewers use a
    triangle mesh, which is remade when a parameter changes.

    .. parameters::

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
    properties = {
        "radius": RADIUS,
        "curvature": CURVATURE,
        "conic": Param("1", FINITE, "conic constant k", default=0.0),
        **dict.fromkeys(
            COEFFICIENTS,
            Param(
                "mm^(1-order)",
                COEFFICIENT,
                "even aspheric coefficients; ``mi.Float64`` in `mi.traverse`, for their range is that of lengths to "
                "the power of -19",
                default=0.0,
            ),
        ),
        "semi_diameter": Param("mm", SIZE_MM, "clear radius"),
        "inner_semi_diameter": Param("mm", RADIUS_MM, "radius of a central hole", default=0.0),
        "half_width": Param(
            "mm", SIZE_MM, "half width in x of a rectangular clip, instead of ``semi_diameter``", otherwise="none"
        ),
        "half_height": Param("mm", SIZE_MM, "half height in y of that clip", otherwise="none"),
        **FRAME,
        **MOVES,
        **NAMES,
        **DETECTOR,
    }

    def __init__(self, props: mi.Properties) -> None:
        self._start(props)
        values = {"curvature": curvature_of(self, props, "radius", "curvature")}
        rectangular = "half_width" in props or "half_height" in props
        if rectangular == ("semi_diameter" in props):
            raise MistrayError(f"{self.owner}: give either semi_diameter or both half_width and half_height (mm)")
        if rectangular and not (("half_width" in props) and ("half_height" in props)):
            raise MistrayError(f"{self.owner}: a rectangular clip needs half_width and half_height (mm); give both")
        sizes = ("half_width", "half_height") if rectangular else ("semi_diameter", "inner_semi_diameter")
        values |= {key: take(self, props, key) for key in ("conic", *COEFFICIENTS, *sizes)}
        self._finish(props, values)

    @property
    def rectangular(self) -> bool:
        """True if the surface is clipped to a rectangle and not to a circle."""
        return "half_width" in self.values

    @property
    def sheet(self) -> bool:
        return True

    @property
    def figure(self) -> str:
        return "rectangle" if self.rectangular else "asphere" if any(self.coefficients) else "sphere or plane"

    @property
    def plane(self) -> bool:
        """True if the surface is flat."""
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
    def held(self) -> set[str]:
        """Names of the parameters without derivative: the radius of a hole if it is 0."""
        return {name for name in ("inner_semi_diameter",) if self.values.get(name) == 0}

    def step(self, name: str) -> float:
        if name in MOVES:
            return super().step(name)
        v = self.values
        size = max(v["half_width"], v["half_height"]) if self.rectangular else v["semi_diameter"]
        powers = {"curvature": -1, "conic": 0} | {column: -3 - 2 * k for k, column in enumerate(COEFFICIENTS)}
        return float(RELATIVE * size ** powers.get(name, 1))

    def check(self) -> None:
        v = self.values
        if not self.rectangular and not 0 <= v["inner_semi_diameter"] < v["semi_diameter"]:
            raise MistrayError(
                f"{self.owner}: inner_semi_diameter is {v['inner_semi_diameter']:g} mm; "
                f"it must lie between 0 and semi_diameter = {v['semi_diameter']:g} mm"
            )
        self._check_single_precision()
        end = (1 + v["conic"]) * (v["curvature"] * self.outer_radius) ** 2
        if end > 1 + 1e-9:
            limit = 1 / (abs(v["curvature"]) * np.sqrt(1 + v["conic"]))
            raise MistrayError(
                f"{self.owner}: the conic ends at r = {limit:.6g} mm, inside the aperture of "
                f"{self.outer_radius:.6g} mm; reduce the aperture or the curvature"
            )

    def _check_single_precision(self) -> None:
        """Raise `MistrayError` if a parameter of the surface is too large for the ray tree, which works in float32."""
        v, size = self.values, self.outer_radius
        numbers = {"product": v["curvature"] * (1 + v["conic"])}
        numbers |= dict(zip(COEFFICIENTS, in_proportion(self.coefficients, size)[0], strict=True))
        for key, number in numbers.items():
            if not abs(number) < MOST:
                name = "conic" if key == "product" else key
                raise MistrayError(
                    f"{self.owner}: {name} is {v[name]:g}, too much for float32 at an aperture of {size:g} mm; "
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

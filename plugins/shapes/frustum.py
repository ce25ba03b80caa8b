"""Plugin `frustum`: a cone, cylinder or flat annulus, traced analytically by the ray tree."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param, documented, take
from mistray.plugins.shapes.formula_shape import FRAME, MOVES, NAMES, RELATIVE
from mistray.plugins.shapes.revolution import Revolution
from mistray.ranges import PLACE_MM, RADIUS_MM
from mistray.surfaces.families.cone import Cone
from mistray.surfaces.families.sag_surface import SagSurface

if TYPE_CHECKING:
    from mistray.surfaces.surface import TracedSurface


@documented
class Frustum(Revolution):
    r"""
    Truncated cone (:monosp:`frustum`): a cone, a cylinder (``r0 = r1``) or a flat annulus (``z0 = z1``).

    It is for barrels, lens edges, bevels, stops and vanes. The generatrix runs from (r0, z0) to (r1, z1) about the
    local z axis. The normal points away from the axis, or to +z for a flat annulus. ``front`` of the nested
    ``interface`` is the side from which the normal points: the inside of a tube, the -z side of an annulus.

    .. parameters::

    .. code-block:: xml

        <shape type="frustum" id="stop_wall">
            <float name="r0" value="1.25"/> <float name="z0" value="-0.075"/>
            <float name="r1" value="1.25"/> <float name="z1" value="0"/>
            <bsdf type="interface"> <float name="R" value="0.07"/> </bsdf>
        </shape>

    .. code-block:: python

        {"type": "frustum", "r0": 5.0, "z0": 0.0, "r1": 5.0, "z1": 20.0, "bsdf": {"type": "interface", "R": 0.05}}
    """

    columns = {
        "r0": ("r0", "slope", "outer", "inner"),
        "r1": ("slope", "outer", "inner"),
        "z0": ("z", "slope", "low", "high"),
        "z1": ("slope", "low", "high"),
    }
    properties = {
        **dict.fromkeys(("r0", "r1"), Param("mm", RADIUS_MM, "radii of the two rims")),
        **dict.fromkeys(("z0", "z1"), Param("mm", PLACE_MM, "positions of the two rims along the axis")),
        **FRAME,
        **MOVES,
        **NAMES,
    }
    mesh_points = 2  # a straight generatrix

    def __init__(self, props: mi.Properties) -> None:
        self._start(props)
        missing = [key for key in ("r0", "z0", "r1", "z1") if key not in props]
        if missing:
            raise MistrayError(f"{self.owner}: a frustum needs {', '.join(missing)} (mm); add them")
        self._finish(props, {key: take(self, props, key) for key in ("r0", "z0", "r1", "z1")})

    @property
    def flat(self) -> bool:
        """True if the surface is a flat annulus."""
        return self.values["z0"] == self.values["z1"]

    @property
    def outer_radius(self) -> float:
        """Largest distance of the surface from its axis, mm."""
        return max(self.values["r0"], self.values["r1"])

    @staticmethod
    def surface(values: Mapping[str, float]) -> TracedSurface:
        r0, r1, length = values["r0"], values["r1"], values["z1"] - values["z0"]
        return Cone.of(r0, r1, length) if length else SagSurface.annulus(max(r0, r1), min(r0, r1))

    @staticmethod
    def vertex_frame(values: Mapping[str, float], matrix: np.ndarray) -> np.ndarray:
        """Return the frame, (4, 4) float64, mm, with the axes of `matrix` and its origin on the axis at z = ``z0``."""
        vertex = matrix.copy()
        vertex[:3, 3] += matrix[:3, 2] * values["z0"]
        return vertex

    @property
    def held(self) -> set[str]:
        """Names of the parameters without derivative: radii that are 0, and ``z0`` and ``z1`` of an annulus."""
        radii = {name for name in ("r0", "r1") if self.values[name] == 0}
        return radii | {"z0", "z1"} if self.flat else radii

    def step(self, name: str) -> float:
        v = self.values
        return super().step(name) if name in MOVES else RELATIVE * abs(v["z1"] - v["z0"] or v["r1"] - v["r0"])

    def check(self) -> None:
        v = self.values
        if self.flat and v["r0"] == v["r1"]:
            raise MistrayError(f"{self.owner}: r0 = r1 and z0 = z1; a frustum of no area, change one of them")
        if v["r0"] == v["r1"] == 0:
            raise MistrayError(f"{self.owner}: r0 = r1 = 0; a frustum of no area, change one of them")

    @property
    def sheet(self) -> bool:
        return self.flat

    @property
    def figure(self) -> str:
        return "ring" if self.flat else "cylinder" if self.values["r0"] == self.values["r1"] else "cone"

    @property
    def flipped(self) -> bool:
        v = self.values
        return v["r1"] < v["r0"] if self.flat else v["z1"] > v["z0"]

    def profile(self, count: int = 9) -> np.ndarray:
        v = self.values
        u = np.linspace(0.0, 1.0, count)
        return np.column_stack([v["r0"] + (v["r1"] - v["r0"]) * u, v["z0"] + (v["z1"] - v["z0"]) * u])


mi.register_shape("frustum", lambda props: Frustum(props))

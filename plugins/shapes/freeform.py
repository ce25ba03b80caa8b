"""Plugin `freeform`: a surface with any sag and any outline, traced analytically by the ray tree."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError, errors_of
from mistray.files.sag_grid import read_sag_grid
from mistray.param import Param, documented, fixed, take
from mistray.physics.geometry.outline import MOST_FIGURES, Outline, OutlineFigure, outline_of
from mistray.physics.sags.grid import Grid
from mistray.physics.sags.terms import FIXED, GRID, LENGTHS, RADII, check_names, length_power, sag
from mistray.plugins.shapes.formula_shape import (
    CURVATURE,
    DETECTOR,
    FRAME,
    MOVES,
    NAMES,
    RADIUS,
    RELATIVE,
    FormulaShape,
    curvature_of,
)
from mistray.ranges import FINITE, FLAG, PLACE_MM, TEXT, Range, Words
from mistray.surfaces.families.freeform import Freeform
from mistray.surfaces.families.freeform_sag import TOO_MUCH, LocalSag
from mistray.surfaces.families.outline_mesh import outline_mesh
from mistray.surfaces.gradient_columns import OWN, declare_columns

NUMBER = Range(-1e300, 1e300)
POLYNOMIALS = fixed("mm", PLACE_MM, "half sizes over which polynomials with these names are defined, > 0", None)
TERM = Param("mm", NUMBER, default=0.0)
CLIP = Param("mm", NUMBER, otherwise="none")
WAYS = {"both": 0, "+z": 1, "-z": -1}
SAMPLES = 61  # samples of the outline in each direction, at which the kernel's sag is checked
# Sizes that may stand together for an outline without a list of figures
SHORT = (("semi_diameter",), ("semi_diameter", "inner_semi_diameter"), ("half_width", "half_height"))


@documented
class FreeformShape(FormulaShape):
    r"""
    Surface with any sag within any outline (:monosp:`freeform`).

    Examples are biconics, toroids, cylinders, Zernike and other polynomials, off-axis pieces, apertures with spiders,
    and segments. The sag is a sum in the frame of the vertex: a conic of ``curvature`` and ``conic``, and all given
    parameters of `mistray.physics.sags.terms`. The normal points to +z; the side at -z is the ``front`` of the nested
    ``interface``, the side at +z its ``back``.

    The outline is made of figures in the plane across the axis, one after the other. The first one is an area; ``+``
    adds a figure, ``-`` cuts one away, ``&`` intersects with one. They may lie anywhere. A piece of a parabola far off
    its axis is computed to the precision of its own size, because the ray tree works about the middle of the outline.

    .. parameters::

    The ray tree stores the sag as a quadric and a departure from it in Chebyshev polynomials of degree 20 at most. A
    surface whose sag differs from that by more than 1e-6 of its size is refused.

    .. code-block:: xml

        <shape type="freeform" id="M1">
            <float name="radius" value="-2000"/> <float name="conic" value="-1"/>
            <string name="clip_1" value="+circle"/>
            <float name="clip_1_y" value="300"/> <float name="clip_1_radius" value="100"/>
            <bsdf type="interface"> <float name="R" value="0.98"/> <boolean name="mirror" value="true"/> </bsdf>
        </shape>

    .. code-block:: python

        {
            "type": "freeform",
            "radius": 80.0,
            "zernike_6": 0.01,
            "zernike_radius": 12.0,
            "semi_diameter": 12.0,
            "bsdf": {"type": "interface", "back": "N-BK7"},
        }
    """

    properties = {
        "curvature": replace(CURVATURE, doc="curvature of the conic, or of y alone"),
        "conic": Param("1", FINITE, "constant k of the conic, or of y alone", default=0.0),
        "radius": RADIUS,
        "curvature_x": Param("1/mm", NUMBER, "curvature of x, of a biconic or a cylinder", default=None),
        "conic_x": Param("1", NUMBER, "constant k of x, of a biconic", default=None),
        "radius_x": replace(RADIUS, doc="radius instead of ``curvature_x``", otherwise="none"),
        "toroid_curvature": Param("1/mm", NUMBER, "toroid, see `mistray.physics.sags.terms`", default=None),
        "toroid_radius": replace(RADIUS, doc="radius instead of ``toroid_curvature``", otherwise="none"),
        **dict.fromkeys([f"a{k}" for k in range(2, 31, 2)], replace(TERM, unit="mm^(1-order)", doc="even asphere")),
        **dict.fromkeys([f"r{k}" for k in range(1, 31)], replace(TERM, unit="mm^(1-order)", doc="odd asphere")),
        "xy_i_j": replace(TERM, unit="mm^(1-i-j)", doc="x^i y^j, to xy_12_12"),
        "zernike_j": replace(TERM, doc="standard Zernike polynomials, j = 1 … 231"),
        "zernike_radius": replace(POLYNOMIALS, doc="radius for these polynomials"),
        "fringe_j": replace(TERM, doc="Fringe Zernike polynomials, j = 1 … 37"),
        "fringe_radius": replace(POLYNOMIALS, doc="radius for these polynomials"),
        **dict.fromkeys(("qbfs_m", "qcon_m"), replace(TERM, doc="Forbes's polynomials, m = 0 … 20")),
        **dict.fromkeys(
            ("q2d_cos_m_n", "q2d_sin_m_n"),
            replace(TERM, doc="Forbes's polynomials without symmetry, m = 1 … 20, n = 0 … 20"),
        ),
        "q_radius": replace(POLYNOMIALS, doc="radius for Forbes's polynomials"),
        "chebyshev_i_j": replace(TERM, doc="Chebyshev polynomials, to chebyshev_20_20"),
        **dict.fromkeys(("chebyshev_x", "chebyshev_y"), replace(POLYNOMIALS, doc="half sizes for these polynomials")),
        GRID: fixed("string", TEXT, "file with heights on a grid, see `mistray.files.sag_grid`", None),
        "grid_scale": Param("1", NUMBER, "factor of the grid's heights", default=1.0),
        **dict.fromkeys(("grid_x", "grid_y"), replace(TERM, doc="position of the grid's frame")),
        **dict.fromkeys(("slope_x", "slope_y"), replace(TERM, unit="1", doc="tilt in the sag")),
        "semi_diameter": replace(CLIP, doc="a centred circle instead of figures", within="> 0"),
        "inner_semi_diameter": replace(CLIP, doc="radius of a hole in that circle", within="≥ 0", otherwise="0"),
        **dict.fromkeys(
            ("half_width", "half_height"), replace(CLIP, doc="a centred rectangle instead of figures", within="> 0")
        ),
        "clip_k": fixed(
            "string",
            TEXT,
            "sign and kind of figure k: ``+circle``, ``-rectangle``, ``&ellipse``, ``+polygon``",
            None,
        ),
        **dict.fromkeys(("clip_k_x", "clip_k_y"), replace(TERM, doc="position of figure k")),
        "clip_k_angle_deg": replace(TERM, unit="deg", doc="rotation of figure k, from x to y"),
        "clip_k_radius": replace(CLIP, doc="radius of a circle", within="> 0"),
        "clip_k_half_width": replace(CLIP, doc="half width of a rectangle or an ellipse", within="> 0"),
        "clip_k_half_height": replace(CLIP, doc="half height of a rectangle or an ellipse", within="> 0"),
        **dict.fromkeys(("clip_k_x1", "clip_k_y1"), replace(CLIP, doc="first of the corners of a polygon, in turn")),
        **FRAME,
        **MOVES,
        **NAMES,
        **DETECTOR,
        "mechanics": fixed("boolean", FLAG, "whether it counts as mechanics, as a plate or a spider does", False),
        "meets": fixed(
            "string",
            Words(tuple(WAYS)),
            "directions along its z axis of the light that meets it; light in the other direction passes",
            "both",
        ),
    }

    def __init__(self, props: mi.Properties) -> None:
        self._start(props)
        self.mechanics, self._way = take(self, props, "mechanics"), WAYS[take(self, props, "meets")]
        given = {key for key in list(props.keys()) if length_power(key) is not None or key in RADII}
        values = {"curvature": 0.0, "conic": 0.0}
        for key in sorted(given, key=_order):
            if key in RADII:
                values[RADII[key]] = curvature_of(self, props, key, RADII[key])
            else:
                values[key] = self._number(props, key)
        self._grid = _read_grid(props, self.owner)
        check_names({*values, *self._grid}, self.owner)
        values |= {"grid_scale": 1.0, "grid_x": 0.0, "grid_y": 0.0} | values if self._grid else {}
        self._figures = self._outline_of(props, values)
        self.in_double = tuple(key for key in values if key not in ("curvature", "conic"))
        self.ranges = dict.fromkeys(values, NUMBER) | {"curvature": FINITE, "conic": FINITE}
        declare_columns(dict.fromkeys(values, OWN))
        self._finish(props, values)

    def _number(self, props: mi.Properties, key: str, default: float | None = None) -> float:
        return float(TERM.typed(props.get(key, default), key, self.owner))

    def _outline_of(self, props: mi.Properties, values: dict[str, float]) -> Outline | None:
        """
        Return the outline that figures define, None without them; add its parameters to `values`.

        A centred circle or rectangle adds its sizes. Raise `MistrayError` if the outline is not valid.
        """
        short = tuple(key for key in (*SHORT[1], *SHORT[2]) if key in props)
        clips = [k for k in range(1, MOST_FIGURES + 1) if f"clip_{k}" in props]
        if bool(short) == bool(clips) or clips != list(range(1, len(clips) + 1)):
            raise MistrayError(
                f"{self.owner}: it needs semi_diameter, or half_width and half_height, or an outline clip_1, clip_2, …"
            )
        if short and short not in SHORT:
            raise MistrayError(
                f"{self.owner}: {', '.join(short)}; give either semi_diameter or both half_width and half_height"
            )
        outline = outline_of(props, partial(self._number, props), self.owner)
        values |= {key: self._number(props, key) for key in short} if outline is None else outline.numbers()
        return outline

    # ---- outline and sag

    @property
    def outline(self) -> Outline:
        """Outline of the surface, mm, in the frame of the vertex."""
        return self._outline(self.values)

    def _outline(self, v: Mapping[str, float]) -> Outline:
        if "semi_diameter" in v:
            figures = [OutlineFigure("circle", sizes=(v["semi_diameter"],))]
            if v.get("inner_semi_diameter"):
                figures.append(OutlineFigure("circle", "-", sizes=(v["inner_semi_diameter"],)))
            return Outline(tuple(figures))
        if "half_width" in v:
            return Outline((OutlineFigure("rectangle", sizes=(v["half_width"], v["half_height"])),))
        assert self._figures is not None
        return self._figures.with_numbers(v)

    def _sag_numbers_of(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the parameters of the sag by name, in mm and powers of it, with its grid, if it has one."""
        return {key: values[key] for key in self.values if length_power(key) is not None} | self._grid

    def check(self) -> None:
        outline = self.outline
        outline.check(self.owner)
        x0, x1, y0, y1 = outline.bounds()
        # Kept while differences are taken, so that a sag's numbers alone change its columns
        self._middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
        self._half = (0.5 * (x1 - x0), 0.5 * (y1 - y0))
        self._samples = outline.sample(SAMPLES)
        for key, value in self.values.items():
            if key in LENGTHS:
                PLACE_MM.check(key, value, self.owner)
                if not value > 0:
                    raise MistrayError(f"{self.owner}: {key} is {value:g} mm; it must be greater than 0")
        self._check_grid()
        if not np.isfinite(self.height(*self._samples)).all():
            raise MistrayError(
                f"{self.owner}: its sag ends or folds within its outline; reduce the outline or a curvature"
            )
        self._local = LocalSag.of(self._sag_numbers_of(self.values), self._middle, self._half, *self._samples)
        size = math.hypot(*self._half)
        if self._local.error > TOO_MUCH * size:
            raise MistrayError(
                f"{self.owner}: single precision has its sag to {self._local.error:.2g} mm only; reduce the outline or "
                "the orders of its sag"
            )

    def _check_grid(self) -> None:
        """Raise `MistrayError` if the outline extends beyond the grid."""
        if not self._grid:
            return
        x, y = self._samples
        lacks = self._grid[GRID].lacks(x - self.values["grid_x"], y - self.values["grid_y"])
        if lacks:
            raise MistrayError(
                f"{self.owner}: its outline leaves its grid '{self._grid[GRID].path}': {lacks}; make the outline "
                "smaller"
            )

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the sag over the vertex plane, mm, float64, at points x, y, mm, of the vertex frame."""
        return sag(x, y, self._sag_numbers_of(self.values))

    def surface(self, values: Mapping[str, float]) -> Freeform:  # type: ignore[override, unused-ignore]
        numbers, local = self._sag_numbers_of(values), self._local
        if numbers != self._sag_numbers_of(self.values):
            local = local.moved(numbers, self._middle, self._half, *self._samples)
        ox, oy = self._middle
        figures = (replace(figure, x=figure.x - ox, y=figure.y - oy) for figure in self._outline(values).figures)
        return Freeform.of(local, Outline(tuple(figures)), self._half, self.mechanics, self._way)

    def vertex_frame(self, values: Mapping[str, float], matrix: np.ndarray) -> np.ndarray:  # type: ignore[override, unused-ignore]
        """
        Return the frame at the middle of the outline, on the surface, (4, 4) float64, mm.

        Its axes are those of `matrix`.
        """
        frame = np.array(matrix)
        ox, oy = self._middle
        height = float(sag(np.array(ox), np.array(oy), self._sag_numbers_of(values)))
        frame[:3, 3] += matrix[:3, :3] @ (ox, oy, height)
        return frame

    @property
    def held(self) -> set[str]:
        """
        Names of parameters without derivative: radii of polynomials, and a hole of radius 0.

        If there are too many parameters, these are all but those of the pose.
        """
        if len(self._local.sag.numbers) + len(self.outline.numbers()) > len(OWN):
            return set(self.values) - set(MOVES)
        return {key for key in self.values if key in LENGTHS or (key == "inner_semi_diameter" and not self.values[key])}

    def step(self, name: str) -> float:
        if name in MOVES or name.endswith("angle_deg"):
            return super().step(name if name in MOVES else "tilt_z")
        power = length_power(name)
        return float(RELATIVE * math.hypot(*self._half) ** (1 if power is None else power))

    # ---- for Mitsuba's own integrators and drawings

    @property
    def sheet(self) -> bool:
        return True

    @property
    def figure(self) -> str:
        return "freeform"

    @property
    def outer_radius(self) -> float:
        """Upper bound of the distance of the surface from its vertex's axis, mm."""
        return math.hypot(*self._middle) + math.hypot(*self._half)

    def _local_mesh(self) -> tuple[np.ndarray, np.ndarray]:
        points, faces = outline_mesh(self.outline)
        z = self.height(points[:, 0], points[:, 1])
        # A conic may end on the rim itself, by a rounding error
        inner = np.array(self._middle) + (1 - 1e-9) * (points - self._middle)
        z = np.where(np.isfinite(z), z, self.height(inner[:, 0], inner[:, 1]))
        return np.column_stack([points, z]), faces


def _read_grid(props: mi.Properties, owner: str) -> dict[str, Grid]:
    """
    Return the grid of sags that a property names, under the key `GRID`; empty without the property.

    Raise `MistrayError` if the file cannot be read.
    """
    if GRID not in props:
        return {}
    name = props[GRID]
    if not isinstance(name, str):
        raise MistrayError(f"{owner}: grid is {name!r}; give the name of a file, see mistray.files.sag_grid")
    path = str(mi.file_resolver().resolve(name))
    with errors_of(owner):
        return {GRID: Grid.of_values(*read_sag_grid(path), path)}


def _order(name: str) -> tuple[int, str]:
    """Return the sort key of a parameter's name: others before coefficients, these in numerical order."""
    digits = "".join(f"{int(part):04d}" if part.isdigit() else part for part in name.replace("_", " ").split())
    return (0 if name in FIXED or name in RADII else 1, digits)


mi.register_shape("freeform", lambda props: FreeformShape(props))

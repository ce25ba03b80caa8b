"""Plugin `freeform`: a surface with any sag and any outline, traced analytically by the ray tree."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.files.sag_grid import read_sag_grid
from mistray.physics.geometry.outline import KINDS, MOST_FIGURES, SIGNS, SIZES, Outline, OutlineFigure
from mistray.physics.sags.grid import Grid
from mistray.physics.sags.terms import FIXED, GRID, LENGTHS, check_names, length_power, sag
from mistray.plugins.shapes.formula_shape import POSE, RELATIVE, FormulaShape, curvature_property, float_property
from mistray.ranges import FINITE, PLACE_MM, Range
from mistray.surfaces.families.freeform import Freeform
from mistray.surfaces.families.freeform_sag import TOO_MUCH, LocalSag
from mistray.surfaces.families.outline_mesh import outline_mesh
from mistray.surfaces.gradient_columns import OWN, declare_columns

NUMBER = Range(-1e300, 1e300)
RADII = {"radius": "curvature", "radius_x": "curvature_x", "toroid_radius": "toroid_curvature"}
WAYS = {"both": 0, "+z": 1, "-z": -1}
SAMPLES = 61  # samples of the outline in each direction, at which the kernel's sag is checked
# Sizes that may stand together for an outline without a list of figures
SHORT = (("semi_diameter",), ("semi_diameter", "inner_semi_diameter"), ("half_width", "half_height"))


class FreeformShape(FormulaShape):
    r"""
    Surface with any sag within any outline (:monosp:`freeform`).

    Examples are biconics, toroids, cylinders, Zernike and other polynomials, off-axis pieces, apertures with spiders,
    and segments. The sag is a sum in the frame of the vertex: a conic of ``curvature`` and ``conic``, and all given
    numbers of `mistray.physics.sags.terms`. The normal points to +z; the side at -z is the ``front`` of the nested
    ``interface``, the side at +z its ``back``.

    The outline is made of figures in the plane across the axis, one after the other. The first one is an area; ``+``
    adds a figure, ``-`` cuts one away, ``&`` intersects with one. They may lie anywhere. A piece of a parabola far off
    its axis is computed to the precision of its own size, because the ray tree works about the middle of the outline.

    ========================= ============ ======== ========= ==========================================================
    parameter                 unit         range    default   meaning
    ========================= ============ ======== ========= ==========================================================
    curvature, conic          1/mm, 1      ±        0         numbers of the conic, or of y alone (differentiable)
    radius                    mm           ±        plane     radius instead of ``curvature``; 0 or inf is a plane
    curvature_x, conic_x      1/mm, 1      ±        none      biconic or cylinder (differentiable)
    radius_x                  mm           ±        none      radius instead of ``curvature_x``
    toroid_curvature          1/mm         ±        none      toroid (differentiable)
    toroid_radius             mm           ±        none      radius instead of ``toroid_curvature``
    a2, a4 … a30              mm^(1-order) ±        0         even asphere (differentiable)
    r1, r2 … r30              mm^(1-order) ±        0         odd asphere (differentiable)
    xy_i_j                    mm^(1-i-j)   ±        0         x^i y^j, to xy_12_12 (differentiable)
    zernike_j                 mm           ±        0         standard Zernike polynomials, j = 1 … 231 (differentiable)
    zernike_radius            mm           > 0      none      radius for these polynomials
    fringe_j                  mm           ±        0         Fringe Zernike polynomials, j = 1 … 37 (differentiable)
    fringe_radius             mm           > 0      none      radius for these polynomials
    qbfs_m, qcon_m            mm           ±        0         Forbes's polynomials, m = 0 … 20 (differentiable)
    q2d_cos_m_n, q2d_sin_m_n  mm           ±        0         Forbes's polynomials without symmetry, m = 1 … 20,
                                                              n = 0 … 20 (differentiable)
    q_radius                  mm           > 0      none      radius for Forbes's polynomials
    chebyshev_i_j             mm           ±        0         Chebyshev polynomials, to chebyshev_20_20 (differentiable)
    chebyshev_x, chebyshev_y  mm           > 0      none      half sizes for these polynomials
    grid                      string                none      file with heights on a grid, see
                                                              `mistray.files.sag_grid`
    grid_scale                1            ±        1         factor of the grid's heights (differentiable)
    grid_x, grid_y            mm           ±        0         position of the grid's frame (differentiable)
    slope_x, slope_y          1            ±        0         tilt in the sag (differentiable)
    semi_diameter             mm           > 0      none      a centred circle instead of figures (differentiable)
    inner_semi_diameter       mm           ≥ 0      0         radius of a hole in that circle (differentiable)
    half_width, half_height   mm           > 0      none      a centred rectangle instead of figures (differentiable)
    clip_k                    string                none      sign and kind of figure k: ``+circle``, ``-rectangle``,
                                                              ``&ellipse``, ``+polygon``
    clip_k_x, clip_k_y        mm           ±        0         position of figure k (differentiable)
    clip_k_angle_deg          deg          ±        0         rotation of figure k, from x to y (differentiable)
    clip_k_radius             mm           > 0      none      radius of a circle (differentiable)
    clip_k_half_width         mm           > 0      none      half width of a rectangle or an ellipse (differentiable)
    clip_k_half_height        mm           > 0      none      half height of a rectangle or an ellipse (differentiable)
    clip_k_x1, clip_k_y1, …   mm           ±        none      corners of a polygon, in turn (differentiable)
    to_world                  mm           rigid    identity  position and orientation of the vertex frame
    x, y, z                   mm           ±        0         displacement along the axes of this frame
                                                              (differentiable)
    tilt_x, tilt_y, tilt_z    deg          ±        0         right-handed rotations about these axes, as of `asphere`
                                                              (differentiable)
    part                      string                shape id  name of the object the surface belongs to
    space                     integer               -1        optical space, for grouping in reports
    mechanics                 boolean               false     whether it counts as mechanics, as a plate or a spider
                                                              does
    meets                     string                both      light that meets it: ``both`` directions along its z axis,
                                                              ``+z`` or ``-z``; light in the other direction passes
    (nested) bsdf             bsdf                  required  an ``interface``
    (nested) sensor           sensor                none      an ``irradiancemeter``: makes this shape the detector
    ========================= ============ ======== ========= ==========================================================

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

    def __init__(self, props: mi.Properties) -> None:
        self._start(props)
        self.mechanics = bool(props.get("mechanics", False))
        owner = f"shape '{self.name}'"
        meets = str(props.get("meets", "both"))
        if meets not in WAYS:
            raise MistrayError(f"{owner}: meets is '{meets}'; use {', '.join(WAYS)}")
        self._way = WAYS[meets]
        given = {key for key in list(props.keys()) if length_power(key) is not None or key in RADII}
        values = {"curvature": 0.0, "conic": 0.0}
        for key in sorted(given, key=_order):
            if key in RADII:
                values[RADII[key]] = curvature_property(props, key, RADII[key])
            else:
                values[key] = float_property(props, key)
        self._grid = _read_grid(props, owner)
        check_names({*values, *self._grid}, owner)
        values |= {"grid_scale": 1.0, "grid_x": 0.0, "grid_y": 0.0} | values if self._grid else {}
        self._forms = self._figures(props, values)
        self.in_double = tuple(key for key in values if key not in ("curvature", "conic"))
        self.ranges = dict.fromkeys(values, NUMBER) | {"curvature": FINITE, "conic": FINITE}
        declare_columns(dict.fromkeys(values, OWN))
        self._finish(props, values)

    def _figures(self, props: mi.Properties, values: dict[str, float]) -> list[tuple[str, str, int]]:
        """Sign, kind and number of sizes of each figure; the numbers of the figures are added to `values`."""
        owner = f"shape '{self.name}'"
        short = tuple(key for key in (*SHORT[1], *SHORT[2]) if key in props)
        clips = [k for k in range(1, MOST_FIGURES + 1) if f"clip_{k}" in props]
        if bool(short) == bool(clips) or clips != list(range(1, len(clips) + 1)):
            raise MistrayError(
                f"{owner}: it needs semi_diameter, or half_width and half_height, or an outline clip_1, clip_2, …"
            )
        if short:
            if short not in SHORT:
                raise MistrayError(
                    f"{owner}: {', '.join(short)}; give either semi_diameter or both half_width and half_height"
                )
            values |= {key: float_property(props, key) for key in short}
            return []
        forms = []
        for k in clips:
            text = str(props[f"clip_{k}"]).strip()
            sign, kind = (text[:1], text[1:].strip()) if text[:1] in SIGNS else ("+", text)
            if kind not in KINDS:
                raise MistrayError(f"{owner}: clip_{k} is '{text}'; use + - or & and one of {', '.join(KINDS)}")
            names = ["x", "y", "angle_deg"]
            corners = 1
            while kind == "polygon" and f"clip_{k}_x{corners}" in props:
                names += [f"x{corners}", f"y{corners}"]
                corners += 1
            names += SIZES.get(kind, ())
            for name in names:
                default = 0.0 if name in ("x", "y", "angle_deg") else None
                if default is None and f"clip_{k}_{name}" not in props:
                    raise MistrayError(f"{owner}: {kind} clip_{k} needs clip_{k}_{name}; add it")
                values[f"clip_{k}_{name}"] = float_property(props, f"clip_{k}_{name}", default)
            forms.append((sign, kind, len(names) - 3))
        return forms

    # ---- outline and sag

    @property
    def outline(self) -> Outline:
        """Outline in the frame of the vertex, mm."""
        return self._outline(self.values)

    def _outline(self, v: Mapping[str, float]) -> Outline:
        if "semi_diameter" in v:
            figures = [OutlineFigure("circle", sizes=(v["semi_diameter"],))]
            if v.get("inner_semi_diameter"):
                figures.append(OutlineFigure("circle", "-", sizes=(v["inner_semi_diameter"],)))
            return Outline(tuple(figures))
        if "half_width" in v:
            return Outline((OutlineFigure("rectangle", sizes=(v["half_width"], v["half_height"])),))
        forms = [OutlineFigure(kind, sign, sizes=(0.0,) * sizes) for sign, kind, sizes in self._forms]
        return Outline(tuple(forms)).with_numbers(v)

    def _sag_numbers_of(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Numbers of the sag by name, with its grid."""
        return {key: values[key] for key in self.values if length_power(key) is not None} | self._grid

    def check(self) -> None:
        owner = f"shape '{self.name}'"
        outline = self.outline
        outline.check(owner)
        x0, x1, y0, y1 = outline.bounds()
        # Kept while differences are taken, so that a sag's numbers alone change its columns
        self._middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
        self._half = (0.5 * (x1 - x0), 0.5 * (y1 - y0))
        self._samples = outline.sample(SAMPLES)
        for key, value in self.values.items():
            if key in LENGTHS:
                PLACE_MM.check(key, value, owner)
                if not value > 0:
                    raise MistrayError(f"{owner}: {key} is {value:g} mm; it must be greater than 0")
        self._check_grid(owner)
        if not np.isfinite(self.height(*self._samples)).all():
            raise MistrayError(f"{owner}: its sag ends or folds within its outline; reduce the outline or a curvature")
        self._local = LocalSag.of(self._sag_numbers_of(self.values), self._middle, self._half, *self._samples)
        size = math.hypot(*self._half)
        if self._local.error > TOO_MUCH * size:
            raise MistrayError(
                f"{owner}: single precision has its sag to {self._local.error:.2g} mm only; reduce the outline or the "
                "orders of its sag"
            )

    def _check_grid(self, owner: str) -> None:
        """Raise an error if the outline extends beyond the grid."""
        if not self._grid:
            return
        x, y = self._samples
        lacks = self._grid[GRID].lacks(x - self.values["grid_x"], y - self.values["grid_y"])
        if lacks:
            raise MistrayError(
                f"{owner}: its outline leaves its grid '{self._grid[GRID].path}': {lacks}; make the outline smaller"
            )

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the sag over the vertex plane at points of the vertex frame, mm, float64."""
        return sag(x, y, self._sag_numbers_of(self.values))

    def surface(self, values: Mapping[str, float]) -> Freeform:  # type: ignore[override]
        numbers, local = self._sag_numbers_of(values), self._local
        if numbers != self._sag_numbers_of(self.values):
            local = local.moved(numbers, self._middle, self._half, *self._samples)
        ox, oy = self._middle
        figures = (replace(figure, x=figure.x - ox, y=figure.y - oy) for figure in self._outline(values).figures)
        return Freeform.of(local, Outline(tuple(figures)), self._half, self.mechanics, self._way)

    def vertex_frame(self, values: Mapping[str, float], matrix: np.ndarray) -> np.ndarray:  # type: ignore[override]
        """Return the frame of the middle of the outline, (4, 4) float64, mm."""
        frame = np.array(matrix)
        ox, oy = self._middle
        height = float(sag(np.array(ox), np.array(oy), self._sag_numbers_of(values)))
        frame[:3, 3] += matrix[:3, :3] @ (ox, oy, height)
        return frame

    @property
    def held(self) -> set[str]:
        """Names of the parameters without derivative: radii of polynomials, missing holes; all if too many."""
        if len(self._local.sag.numbers) + len(self.outline.numbers()) > len(OWN):
            return set(self.values) - set(POSE)
        return {key for key in self.values if key in LENGTHS or (key == "inner_semi_diameter" and not self.values[key])}

    def step(self, name: str) -> float:
        if name in POSE or name.endswith("angle_deg"):
            return super().step(name if name in POSE else "tilt_z")
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
    """Grid that a property names, by `GRID`; empty without the property."""
    if GRID not in props:
        return {}
    name = props[GRID]
    if not isinstance(name, str):
        raise MistrayError(f"{owner}: grid is {name!r}; give the name of a file, see mistray.files.sag_grid")
    path = str(mi.file_resolver().resolve(name))
    try:
        return {GRID: Grid.of_values(*read_sag_grid(path), path)}
    except MistrayError as error:
        raise MistrayError(f"{owner}: {error}") from None


def _order(name: str) -> tuple[int, str]:
    """Sort key of a number's name: base before coefficients, coefficients in numerical order."""
    digits = "".join(f"{int(part):04d}" if part.isdigit() else part for part in name.replace("_", " ").split())
    return (0 if name in FIXED or name in RADII else 1, digits)


mi.register_shape("freeform", lambda props: FreeformShape(props))

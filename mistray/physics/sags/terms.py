"""Sag of a surface by named parameters: a conic, or one for x and one for y, and all terms added to it.

Every parameter has one name in scene files, prescriptions and gradients. Lengths are in mm; r² = x² + y². Only `grid`
is not a number.

=============================== ============ ==========================================================================
name                            unit         what it adds
=============================== ============ ==========================================================================
curvature, conic                1/mm, 1      the conic c r²/(1 + √(1 - (1 + k) c² r²)); of y alone with the next two
curvature_x, conic_x            1/mm, 1      a biconic (ISO 10110-19): (cx x² + cy y²)/(1 + √(1 - (1 + kx) cx² x² -
                                             (1 + ky) cy² y²)); a cylinder if one of both curvatures is 0
toroid_curvature                1/mm         the profile of y (curvature, conic, a2 …) turned about the line parallel
                                             to y at the distance of its inverse from the vertex
slope_x, slope_y                1            a tilt: slope_x x + slope_y y
a2, a4 … a30                    mm^(1-order) even asphere: r^order (of y in a toroid)
r1, r2 … r30                    mm^(1-order) odd or extended asphere: r^order
xy_1_0 … xy_12_12               mm^(1-i-j)   x^i y^j
zernike_1 … zernike_231         mm           standard Zernike polynomials over ``zernike_radius``
fringe_1 … fringe_37            mm           Fringe Zernike polynomials over ``fringe_radius``
qbfs_0 … , qcon_0 …             mm           Forbes's polynomials over ``q_radius``; qbfs along the conic's normal
q2d_cos_1_0 … q2d_cos_20_20     mm           Forbes's polynomials u^m cos mφ Q_mn over ``q_radius``, along the
                                             conic's normal; q2d_sin_m_n with sin mφ
chebyshev_0_0 … chebyshev_20_20 mm           T_i(x/chebyshev_x) T_j(y/chebyshev_y)
grid                            file         a `Grid`: heights on a rectangular grid, such as a measured figure error
grid_scale, grid_x, grid_y      1, mm, mm    its factor (1) and where its own frame lies
=============================== ============ ==========================================================================
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from mistray.errors import MistrayError
from mistray.physics.sags.forbes import q2d, qbfs, qcon
from mistray.physics.sags.grid import Grid
from mistray.physics.sags.zernike import LAST_FRINGE, LAST_STANDARD, fringe, standard
from mistray.ranges import ANYTHING, ByName, several

# Names, and the power of the length in their units
FIXED = {
    "curvature": -1, "conic": 0, "curvature_x": -1, "conic_x": 0, "toroid_curvature": -1, "slope_x": 0, "slope_y": 0,
    "zernike_radius": 1, "fringe_radius": 1, "q_radius": 1, "chebyshev_x": 1, "chebyshev_y": 1,
    "grid_scale": 0, "grid_x": 1, "grid_y": 1,
}  # fmt: skip
RADII = {"radius": "curvature", "radius_x": "curvature_x", "toroid_radius": "toroid_curvature"}  # mm, instead of these
LENGTHS = ("zernike_radius", "fringe_radius", "q_radius", "chebyshev_x", "chebyshev_y")  # of polynomials
XY_ORDERS = tuple((total - j, j) for total in range(21) for j in range(total + 1))  # 1, x, y, x², xy, y², …
MOST_EVEN, MOST_RADIAL, MOST_XY, MOST_CHEBYSHEV, MOST_Q = 30, 30, 12, 20, 20
_NUMBERED = re.compile(r"(a|r|xy|zernike|fringe|qbfs|qcon|q2d_cos|q2d_sin|chebyshev)(?:_)?(\d+)(?:_(\d+))?")
_NEEDS = {
    "zernike": ("zernike_radius",), "fringe": ("fringe_radius",), "qbfs": ("q_radius",), "qcon": ("q_radius",),
    "q2d_cos": ("q_radius",), "q2d_sin": ("q_radius",), "chebyshev": ("chebyshev_x", "chebyshev_y"),
}  # fmt: skip

GRID = "grid"

Numbers = Mapping[str, Any]  # a float, or a Grid for `GRID`
SAG = ByName(ANYTHING, "{'conic_x': -1.0}")


def length_power(name: str) -> int | None:
    """Return the exponent of mm in the unit of a sag's parameter, -1 for a curvature; None for an unknown name."""
    if name in FIXED:
        return FIXED[name]
    found = _numbered(name)
    if found is None:
        return None
    kind, i, j = found
    return {"a": 1 - i, "r": 1 - i, "xy": 1 - i - (j or 0)}.get(kind, 1)


def _numbered(name: str) -> tuple[str, int, int | None] | None:
    """
    Return the polynomial family and orders in a coefficient's name, such as ("xy", 2, 1) for "xy_2_1".

    The result is None for other names.
    """
    match = _NUMBERED.fullmatch(name)
    if match is None:
        return None
    kind, i, j = match[1], int(match[2]), None if match[3] is None else int(match[3])
    known = {
        "a": j is None and i % 2 == 0 and 2 <= i <= MOST_EVEN,
        "r": j is None and 1 <= i <= MOST_RADIAL,
        "xy": j is not None and i + (j or 0) >= 1 and max(i, j or 0) <= MOST_XY,
        "zernike": j is None and 1 <= i <= LAST_STANDARD,
        "fringe": j is None and 1 <= i <= LAST_FRINGE,
        "qbfs": j is None and i <= MOST_Q,
        "qcon": j is None and i <= MOST_Q,
        "q2d_cos": j is not None and 1 <= i <= MOST_Q and j <= MOST_Q,
        "q2d_sin": j is not None and 1 <= i <= MOST_Q and j <= MOST_Q,
        "chebyshev": j is not None and max(i, j or 0) <= MOST_CHEBYSHEV,
    }[kind]
    written = f"{kind}{i}" if kind in "ar" else f"{kind}_{i}" + ("" if j is None else f"_{j}")
    return (kind, i, j) if known and written == name else None


def check_names(names: str | Iterable[str], owner: str) -> None:
    """
    Check that parameters with these names define a sag.

    Raises
    ------
    MistrayError
        If a name is unknown, a parameter that another one needs is missing, or two exclude each other.
    """
    names = set(several(names))
    for name in sorted(names - {GRID}):
        if length_power(name) is None:
            raise MistrayError(f"{owner}: '{name}' is not a parameter of a sag; see mistray.physics.sags.terms")
        kind = (_numbered(name) or ("",))[0]
        for needed in _NEEDS.get(kind, ()):
            if needed not in names:
                raise MistrayError(f"{owner}: {name} needs {needed} (mm); add it")
    placed = sorted(name for name in names if name.startswith("grid_"))
    if placed and GRID not in names:
        raise MistrayError(f"{owner}: {placed[0]} needs grid (a file); add it")
    if "conic_x" in names and not {"curvature_x", "toroid_curvature"} & names:
        raise MistrayError(f"{owner}: conic_x needs curvature_x (1/mm); add it")
    if {"curvature_x", "toroid_curvature"} <= names:
        raise MistrayError(f"{owner}: curvature_x with toroid_curvature; give one of them")


def with_even(curvature: float, conic: float, coefficients: float | Sequence[float], more: Numbers) -> dict[str, Any]:
    """
    Return the parameters of a sag by name, with units as in the table of this module.

    They are curvature, conic, the even terms (a4, a6, …) that are not 0, and `more`, which take precedence.
    """
    even = {f"a{2 * i}": a for i, a in enumerate(several(coefficients), start=2) if a}
    return {"curvature": curvature, "conic": conic, **even, **more}


def sag(x: np.ndarray, y: np.ndarray, n: Numbers) -> np.ndarray:
    """
    Return the sag along +z, mm, at points of the vertex frame; NaN beyond the end of a conic.

    Parameters
    ----------
    x, y : ndarray
        Coordinates of the points, mm, that broadcast together to the shape of the result.
    n : mapping of str to float, and of "grid" to Grid
        Parameters by their names in the table of this module; missing ones are 0, but `grid_scale` is 1.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    families: dict[str, dict[tuple[int, int], float]] = {}
    for name, value in n.items():
        found = _numbered(name)
        if found is not None and value:
            families.setdefault(found[0], {})[found[1], found[2] or 0] = value
    with np.errstate(all="ignore"):
        even = families.pop("a", {})
        total = _base(x, y, n, even if "toroid_curvature" in n else {})
        total = total + n.get("slope_x", 0.0) * x + n.get("slope_y", 0.0) * y
        r2 = x * x + y * y
        if "toroid_curvature" not in n:
            total = total + _powers(r2, even, 2)
        total = total + _powers(np.sqrt(r2), families.pop("r", {}), 1)
        for kind, terms in families.items():
            total = total + _added(kind, x, y, n, terms)
    return np.asarray(total + _gridded(x, y, n)[0] if GRID in n else total)


def _gridded(x: np.ndarray, y: np.ndarray, n: Numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the height of the grid in `n`, mm, and its slopes in x and y, at points of the surface's frame, mm."""
    grid: Grid = n[GRID]
    found = grid.evaluate(x - n.get("grid_x", 0.0), y - n.get("grid_y", 0.0))
    z, across, along = (n.get("grid_scale", 1.0) * value for value in found)
    return z, across, along


def half_turned(n: Numbers) -> dict[str, Any]:
    """Return the parameters of the same surface in a frame turned by 180° about y, which reverses x and z."""
    x, y = np.array(0.3), np.array(0.4)
    found: dict[str, Any] = {}
    for name, value in n.items():
        if name == GRID:
            found[name] = value.half_turned()
        elif name in LENGTHS or name in ("conic", "conic_x", "grid_scale", "grid_y"):
            found[name] = value
        elif name in FIXED and not name.startswith("slope"):
            found[name] = -value
        else:
            alone = {name: 1.0, **dict.fromkeys(LENGTHS, 1.0)}
            found[name] = -value * float(np.sign(sag(-x, y, alone) * sag(x, y, alone)))
    return found


def slopes(x: np.ndarray, y: np.ndarray, n: Numbers, step: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the derivatives of the sag with respect to x and y, by differences of the fourth order; exact for a grid.

    Parameters
    ----------
    x, y, n
        Parameters of `sag`.
    step : float
        Step of the differences, mm; with a thousandth of the surface's size, errors are near 1e-12.
    """
    places = ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))
    smooth = {name: value for name, value in n.items() if name != GRID}
    across = sum(w * sag(x + k * step, y, smooth) for k, w in places) / (12 * step)
    along = sum(w * sag(x, y + k * step, smooth) for k, w in places) / (12 * step)
    if GRID in n:  # whose curvature jumps from cell to cell
        _, by_x, by_y = _gridded(x, y, n)
        across, along = across + by_x, along + by_y
    return np.asarray(across), np.asarray(along)


def vertex_curvatures(n: Numbers, step: float) -> tuple[float, float]:
    """
    Return the curvatures of a sag in x and y at the vertex, 1/mm, without the kink of the term r1.

    Parameters
    ----------
    n : mapping of str to float
        Parameters of the sag, by name.
    step : float
        Step of the differences, mm.
    """
    # r3 … r30 have no curvature at the vertex, but those of odd orders would add an error of the first order in `step`
    smooth = {name: value for name, value in n.items() if name == "r2" or (_numbered(name) or ("",))[0] != "r"}
    zero = np.zeros(1)
    middle = sag(zero, zero, smooth)
    both = ((step + zero, zero), (zero, step + zero))
    found = [(sag(x, y, smooth) + sag(-x, -y, smooth) - 2 * middle) / step**2 for x, y in both]
    return float(found[0][0]), float(found[1][0])


def _powers(base: np.ndarray, terms: Mapping[tuple[int, int], float], step: int) -> np.ndarray:
    """
    Return Σ a base^(order/step) over terms, without overflow of powers whose products with a are finite.

    `terms` map (order, 0) to a; `base` is r^step, so that each term is a r^order.
    """
    total = np.zeros_like(base)
    for (order, _), amount in terms.items():
        root = np.sign(amount) * np.abs(amount) ** (step / order)
        total = total + np.sign(amount) * np.abs(root * base) ** (order // step)
    return total


def _base(x: np.ndarray, y: np.ndarray, n: Numbers, even: Mapping[tuple[int, int], float]) -> np.ndarray:
    c, k = n.get("curvature", 0.0), n.get("conic", 0.0)
    if "toroid_curvature" in n:
        profile = c * y * y / (1 + np.sqrt(1 - (1 + k) * c * c * y * y)) + _powers(y * y, even, 2)
        # R - √((R - f)² - x²) = (f (2 - f/R) + x²/R) / (1 + √((1 - f/R)² - x²/R²)), for any R
        turn = n["toroid_curvature"]
        left = 1 - turn * profile
        return np.asarray(
            (profile * (2 - turn * profile) + turn * x * x)
            / (1 + np.sign(left) * np.sqrt(left * left - (turn * x) ** 2))
        )
    cx, kx = (n.get("curvature_x", c), n.get("conic_x", 0.0)) if "curvature_x" in n else (c, k)
    if "curvature_x" not in n:
        r2 = x * x + y * y
        return np.asarray(c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2)))
    root = np.sqrt(1 - (1 + kx) * (cx * x) ** 2 - (1 + k) * (c * y) ** 2)
    return np.asarray((cx * x * x + c * y * y) / (1 + root))


def _added(kind: str, x: np.ndarray, y: np.ndarray, n: Numbers, terms: dict[tuple[int, int], float]) -> np.ndarray:
    if kind == "xy":
        return np.asarray(sum(a * x**i * y**j for (i, j), a in terms.items()))
    if kind == "chebyshev":
        table = np.zeros((1 + max(i for i, _ in terms), 1 + max(j for _, j in terms)))
        for place, a in terms.items():
            table[place] = a
        return np.asarray(chebyshev.chebval2d(x / n["chebyshev_x"], y / n["chebyshev_y"], table))
    single = {i: a for (i, _), a in terms.items()}
    if kind in ("zernike", "fringe"):
        radius = n[f"{kind}_radius"]
        return (standard if kind == "zernike" else fringe)(x / radius, y / radius, single)
    r2 = x * x + y * y
    u2 = r2 / n["q_radius"] ** 2
    if kind == "qcon":
        return qcon(u2, single)
    if kind == "qbfs":
        departure = qbfs(u2, single)
    else:
        u, v = x / n["q_radius"], y / n["q_radius"]
        departure = q2d(u, v, terms, {}) if kind == "q2d_cos" else q2d(u, v, {}, terms)
    c2, conic = n.get("curvature", 0.0) ** 2, n.get("conic", 0.0)
    # Along the axis it exceeds that along the normal of the conic
    return np.asarray(departure * np.sqrt((1 - conic * c2 * r2) / (1 - (1 + conic) * c2 * r2)))

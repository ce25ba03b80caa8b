"""Freeform surfaces in float64: explicit formulas of their sags, whose complex steps give slopes; hits by bisection."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline

from .geometry import Array, Mask, Surface, box_span

TINY = 1e-30
SAMPLES, HALVINGS = 257, 60
# Qbfs_m(x) and Qcon_m(x) as printed by Forbes (2007), equations (2.8) and (3.9)
QBFS = (
    lambda x: 1 + 0 * x,
    lambda x: (13 - 16 * x) / math.sqrt(19),
    lambda x: math.sqrt(2 / 95) * (29 - 4 * x * (25 - 19 * x)),
)
QCON = (
    lambda x: 1 + 0 * x,
    lambda x: -(5 - 6 * x),
    lambda x: 15 - 14 * x * (3 - 2 * x),
    lambda x: -(35 - 12 * x * (14 - x * (21 - 10 * x))),
)


def noll(j: int) -> tuple[int, int]:
    """n and m of the standard order, m < 0 for sines (R. J. Noll, 1976)."""
    n = 0
    while j > (n + 1) * (n + 2) // 2:
        n += 1
    place = j - n * (n + 1) // 2  # 1 … n + 1
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place + 1) // 2) - 1
    return n, m if m == 0 or j % 2 == 0 else -m


def fringe(j: int) -> tuple[int, int]:
    """n and m of the Fringe order, by groups of equal (n + m)/2."""
    if j == 37:
        return 12, 0
    group = math.isqrt(j - 1)  # (n + m)/2
    place = j - 1 - group**2  # 0 … 2 group
    m = group - place // 2
    return 2 * group - m, m if place % 2 == 0 else -m


def zernike(n: int, m: int, x: Array, y: Array, normalised: bool) -> Array:
    """R_n^|m| times cos or sin of |m| θ, in powers of x and y."""
    k, r2 = abs(m), x * x + y * y
    radial = sum(
        (-1) ** s
        * math.factorial(n - s)
        / (math.factorial(s) * math.factorial((n + k) // 2 - s) * math.factorial((n - k) // 2 - s))
        * r2 ** ((n - k) // 2 - s)
        for s in range((n - k) // 2 + 1)
    )
    scale = math.sqrt((n + 1) * (1 if m == 0 else 2)) if normalised else 1.0
    return np.asarray(scale * radial * harmonic(k, m < 0, x, y))


def harmonic(k: int, odd: bool, x: Array, y: Array) -> Array:
    """r^k cos kθ, or r^k sin kθ where odd, with θ from the x axis."""
    powers = range(int(odd), k + 1, 2)
    return sum((-1) ** ((i - odd) // 2) * math.comb(k, i) * x ** (k - i) * y**i for i in powers)


def q2d(m: int, last: int) -> list[float]:
    """Coefficients of Q_m,last (Forbes 2012) by powers of x = u², by Gram and Schmidt from exact moments."""

    def mean(a: int, b: int) -> Fraction:
        k = (a + b - 2) // 2
        return Fraction(a * b + m * m, 2) * Fraction(math.comb(2 * k, k), 4**k)

    def product(f: list[Fraction], g: list[Fraction]) -> Fraction:
        return sum(p * q * mean(m + 2 * i, m + 2 * j) for i, p in enumerate(f) for j, q in enumerate(g))

    known: list[list[Fraction]] = []
    for n in range(last + 1):
        new = [Fraction(0)] * n + [Fraction((-1) ** n)]
        for other in known:
            share = product(new, other) / product(other, other)
            new = [p - share * q for p, q in zip(new, other + [Fraction(0)] * (n + 1 - len(other)), strict=True)]
        known.append(new)
    norm = math.sqrt(product(known[-1], known[-1]))
    return [float(value) / norm for value in known[-1]]


def _grid(path: str) -> RectBivariateSpline:
    lines = [line.split() for line in Path(path).read_text().splitlines() if line and not line.startswith("!")]
    nx, ny, dx, dy, _, x, y = (float(word) for word in lines[0])
    heights = np.array([float(words[0]) for words in lines[1:]]).reshape(int(ny), int(nx))[::-1]
    across, along = (m + step * (np.arange(int(n)) - (n - 1) / 2) for m, step, n in ((x, dx, nx), (y, dy, ny)))
    return RectBivariateSpline(across, along, heights.T, s=0)


def _height(spline: RectBivariateSpline, x: Array, y: Array) -> Array:
    """Of complex places to first order in what is imaginary."""
    u, v = np.broadcast_arrays(np.real(x), np.real(y))
    z = spline(u, v, grid=False)
    if not (np.iscomplexobj(x) or np.iscomplexobj(y)):
        return np.asarray(z)
    by_x, by_y = spline(u, v, dx=1, grid=False), spline(u, v, dy=1, grid=False)
    return np.asarray(z + 1j * (by_x * np.imag(x) + by_y * np.imag(y)))


@dataclass(frozen=True)
class Figure:
    """A figure of an outline: sign, kind, and numbers by name as in the scene (x, y, angle_deg, radius …)."""

    sign: str
    kind: str
    numbers: Mapping[str, float]

    def holds(self, x: Array, y: Array) -> Mask:
        n = self.numbers
        angle = math.radians(n.get("angle_deg", 0.0))
        dx, dy = x - n.get("x", 0.0), y - n.get("y", 0.0)
        u, v = dx * math.cos(angle) + dy * math.sin(angle), dy * math.cos(angle) - dx * math.sin(angle)
        if self.kind == "circle":
            return np.asarray(u * u + v * v <= n["radius"] ** 2)
        if self.kind == "ellipse":
            return np.asarray((u / n["half_width"]) ** 2 + (v / n["half_height"]) ** 2 <= 1)
        if self.kind == "rectangle":
            return np.asarray((np.abs(u) <= n["half_width"]) & (np.abs(v) <= n["half_height"]))
        count = sum(re.fullmatch(r"x\d+", name) is not None for name in n)
        corners = [(n[f"x{k}"], n[f"y{k}"]) for k in range(1, count + 1)]
        turns = np.zeros(np.shape(u))
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
            cross = (ax - u) * (by - v) - (ay - v) * (bx - u)
            turns += np.arctan2(cross, (ax - u) * (bx - u) + (ay - v) * (by - v))
        return np.asarray(np.abs(turns) > math.pi)


@dataclass(frozen=True)
class Freeform(Surface):
    """z = sag(x, y), normal towards +z; `numbers` by their names in a scene, `way` ±1 where light one way passes."""

    numbers: Mapping[str, float]
    figures: tuple[Figure, ...]
    box: tuple[float, float, float, float]
    way: int = 0
    grid: RectBivariateSpline | None = None

    @classmethod
    def of(cls, values: Mapping[str, float | str]) -> Freeform:
        given = dict(values)
        for name, of in (("radius", "curvature"), ("radius_x", "curvature_x"), ("toroid_radius", "toroid_curvature")):
            if name in given:
                radius = float(given.pop(name))
                given[of] = 1 / radius if radius and math.isfinite(radius) else 0.0
        way = {"both": 0, "+z": 1, "-z": -1}[str(given.pop("meets", "both"))]
        given.pop("mechanics", None)
        grid = _grid(str(given.pop("grid"))) if "grid" in given else None
        figures = []
        if "semi_diameter" in given:
            figures.append(Figure("+", "circle", {"radius": float(given.pop("semi_diameter"))}))
            if inner := float(given.pop("inner_semi_diameter", 0.0)):
                figures.append(Figure("-", "circle", {"radius": inner}))
        elif "half_width" in given:
            sizes = {name: float(given.pop(name)) for name in ("half_width", "half_height")}
            figures.append(Figure("+", "rectangle", sizes))
        while f"clip_{len(figures) + 1}" in given:
            start = f"clip_{len(figures) + 1}"
            text = str(given.pop(start))
            own = {key: given.pop(key) for key in list(given) if key.startswith(start + "_")}
            numbers = {key.removeprefix(start + "_"): float(value) for key, value in own.items()}
            figures.append(Figure(text[0], text[1:], numbers))
        corners = np.concatenate([_corners(figure) for figure in figures if figure.sign == "+"])
        (x0, y0), (x1, y1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        return cls({key: float(value) for key, value in given.items()}, tuple(figures), (x0, x1, y0, y1), way, grid)

    def sag(self, x: Array, y: Array) -> Array:
        n = self.numbers
        r2 = x * x + y * y
        if "toroid_curvature" in n:
            z = _turned(_profile(y, n), x, n["toroid_curvature"])
        elif "curvature_x" in n:
            cx, cy = n["curvature_x"], n.get("curvature", 0.0)
            root = 1 - (1 + n.get("conic_x", 0.0)) * (cx * x) ** 2 - (1 + n.get("conic", 0.0)) * (cy * y) ** 2
            z = (cx * x * x + cy * y * y) / (1 + np.sqrt(root))
        else:
            z = _conic(r2, n.get("curvature", 0.0), n.get("conic", 0.0))
        for name, value in n.items():
            z = z + value * self._term(name, x, y, r2)
        if self.grid is not None:
            u, v = x - n.get("grid_x", 0.0), y - n.get("grid_y", 0.0)
            z = z + n.get("grid_scale", 1.0) * _height(self.grid, u, v)
        return z

    def _q2d(self, part: str, m: int, last: int, x: Array, y: Array) -> Array:
        n, radius = self.numbers, self.numbers["q_radius"]
        u, v = x / radius, y / radius
        radial = sum(a * (u * u + v * v) ** k for k, a in enumerate(q2d(m, last)))
        c2r2, k = n.get("curvature", 0.0) ** 2 * (x * x + y * y), n.get("conic", 0.0)
        return np.asarray(harmonic(m, part == "sin", u, v) * radial * np.sqrt((1 - k * c2r2) / (1 - (1 + k) * c2r2)))

    def _term(self, name: str, x: Array, y: Array, r2: Array) -> Array:
        n = self.numbers
        kind, *_ = name.split("_") if "_" in name else re.findall("[a-z]+", name)
        orders = [int(v) for v in re.findall(r"\d+", name)]
        i, j = (*orders, 0, 0)[:2]
        if kind == "grid":
            return 0 * x
        if kind == "q2d" and len(orders) == 3:
            return self._q2d(name.split("_")[1], orders[1], orders[2], x, y)
        if name in ("slope_x", "slope_y"):
            return x if name == "slope_x" else y
        if not orders or (kind == "a" and "toroid_curvature" in n):
            return 0 * x
        if kind in ("a", "r"):
            return r2 ** (i // 2) if i % 2 == 0 else np.sqrt(r2) ** i
        if kind == "xy":
            return x**i * y**j
        if kind in ("zernike", "fringe"):
            radius = n[f"{kind}_radius"]
            order = noll(i) if kind == "zernike" else fringe(i)
            return zernike(*order, x / radius, y / radius, kind == "zernike")
        if kind == "chebyshev":
            return np.cos(i * np.arccos(x / n["chebyshev_x"])) * np.cos(j * np.arccos(y / n["chebyshev_y"]))
        u2 = r2 / n["q_radius"] ** 2
        if kind == "qcon":
            return u2 * u2 * QCON[i](u2)
        # Over the cosine of the angle between the conic's normal and the axis, 1/√(1 + (dz/dr)²)
        c, k = n.get("curvature", 0.0), n.get("conic", 0.0)
        slope2 = c * c * r2 / (1 - (1 + k) * c * c * r2)
        return u2 * (1 - u2) * np.sqrt(1 + slope2) * QBFS[i](u2)

    def slopes(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Derivatives of the sag, by complex steps."""
        return self.sag(x + 1j * TINY, y).imag / TINY, self.sag(x, y + 1j * TINY).imag / TINY

    def implicit(self, point: Array) -> tuple[Array, Array]:
        x, y, z = point.T
        across, along = self.slopes(x, y)
        return z - self.sag(x, y), np.column_stack([-across, -along, np.ones(len(point))])

    def contains(self, x: Array, y: Array) -> Mask:
        inside = np.full(np.shape(x), self.figures[0].sign == "-")
        for figure in self.figures:
            here = figure.holds(x, y)
            inside = {"+": inside | here, "-": inside & ~here, "&": inside & here}[figure.sign]
        return inside

    def extent(self) -> float:
        x0, x1, y0, y1 = self.box
        return math.hypot(max(abs(x0), abs(x1)), max(abs(y0), abs(y1)))

    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        x0, x1, y0, y1 = self.box
        # The part of the ray that is over the box, and no farther from it than the sag goes
        gx, gy = np.meshgrid(np.linspace(x0, x1, 41), np.linspace(y0, y1, 41))
        with np.errstate(invalid="ignore"):
            z = self.sag(gx, gy)
        reach = 1.5 * (np.nanmax(z) - np.nanmin(z)) + 1e-3 * self.extent()
        bottom, top = np.array([x0, y0, np.nanmin(z) - reach]), np.array([x1, y1, np.nanmax(z) + reach])
        low, high = box_span(origin, direction, bottom, top)
        low = np.maximum(low, 0.0)
        some = np.flatnonzero((high > low) & (direction[:, 2] * self.way >= 0))
        best = np.full(len(origin), np.inf)
        if not len(some):
            return best
        o, d = origin[some], direction[some]
        start = np.where(leaving[some], low[some] + 1e-6 * (high - low)[some], low[some])
        t = start[:, None] + (high[some] - start)[:, None] * np.linspace(0, 1, SAMPLES)

        def height(t: Array, rows: Array) -> Array:
            with np.errstate(invalid="ignore"):
                x, y, z = (o[rows, k] + t * d[rows, k] for k in range(3))
                return np.asarray(z - self.sag(x, y))

        f = height(t.T, np.arange(len(some))).T
        known = np.isfinite(f[:, :-1]) & np.isfinite(f[:, 1:])
        row, place = np.nonzero(known & ((f[:, :-1] < 0) != (f[:, 1:] < 0)))  # a sample may lie on the surface
        a, b, f_a = t[row, place], t[row, place + 1], f[row, place]
        for _ in range(HALVINGS):
            middle = 0.5 * (a + b)
            same = height(middle, row) * f_a > 0
            a, b = np.where(same, middle, a), np.where(same, b, middle)
        x, y = o[row, 0] + a * d[row, 0], o[row, 1] + a * d[row, 1]
        good = self.contains(x, y)
        np.minimum.at(best, some[row[good]], a[good])
        return best


def _corners(figure: Figure) -> Array:
    n = figure.numbers
    if figure.kind == "polygon":
        u, v = (np.array([value for key, value in n.items() if re.fullmatch(rf"{axis}\d+", key)]) for axis in "xy")
    else:
        half_width, half_height = (n.get("radius", n.get(name, 0.0)) for name in ("half_width", "half_height"))
        u, v = half_width * np.array([-1, -1, 1, 1]), half_height * np.array([-1, 1, -1, 1])
    angle = math.radians(n.get("angle_deg", 0.0))
    x = n.get("x", 0.0) + u * math.cos(angle) - v * math.sin(angle)
    return np.stack([x, n.get("y", 0.0) + u * math.sin(angle) + v * math.cos(angle)], axis=1)


def _conic(r2: Array, c: float, k: float) -> Array:
    return np.asarray(c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2)))


def _profile(y: Array, n: Mapping[str, float]) -> Array:
    g = _conic(y * y, n.get("curvature", 0.0), n.get("conic", 0.0))
    for name, value in n.items():
        if re.fullmatch(r"a\d+", name):
            g = g + value * y ** int(name[1:])
    return g


def _turned(g: Array, x: Array, c: float) -> Array:
    """A profile z = g(y) turned about the line at z = 1/c: c/2 ((z - g)² + …) solved for z."""
    if c == 0:
        return g
    # (1/c - z)² + x² = (1/c - g)²
    return np.asarray((1 - np.sqrt((1 - c * g) ** 2 - c * c * x * x)) / c)

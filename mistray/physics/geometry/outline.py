"""Outlines of surfaces: circles, ellipses, rectangles and polygons, added, cut away and intersected.

An outline is a list of figures in the plane across the axis, applied one after the other. The first one is an area, or
a hole in the whole plane if its sign is "-". A later one is added ("+"), cut away ("-") or intersected ("&"). A spider
in an annulus is "+circle", "-circle" and a "-rectangle" for each vane.

`contains` takes floats, NumPy arrays or Dr.Jit arrays, so that the tracing kernel and the host share one formula.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import PLACE_MM, Each, OfType, Several, several

SIGNS = ("+", "-", "&")
# Names of the sizes of figures beside x, y (mm) and angle_deg; a polygon has x1, y1, x2, y2, …
SIZES = {"circle": ("radius",), "ellipse": ("half_width", "half_height"), "rectangle": ("half_width", "half_height")}
KINDS = (*SIZES, "polygon")
MOST_FIGURES, MOST_CORNERS = 64, 64
CORNER = Each(PLACE_MM, 2)
ALL = 1e30  # half size, mm, that stands for unbounded


@dataclass(frozen=True)
class OutlineFigure:
    """
    Circle, ellipse, rectangle or polygon of an outline.

    Attributes
    ----------
    kind : str
        "circle", "ellipse", "rectangle" or "polygon".
    sign : str
        Operation with the figures before: "+" (added), "-" (cut away) or "&" (intersected).
    x, y : float
        Position of the figure's origin, mm.
    angle_deg : float
        Rotation about that position, degrees, from x to y.
    sizes : tuple of float
        Circle: radius. Ellipse, rectangle: half width and half height. Polygon: coordinates x1, y1, x2, y2, … of its
        corners. All in mm.

    Examples
    --------
    >>> ring = mistray.prescription.circle(5.0, inner=2.0)
    >>> [(figure.sign, figure.kind, figure.sizes) for figure in ring.figures]
    [('+', 'circle', (5.0,)), ('-', 'circle', (2.0,))]
    """

    kind: str
    sign: str = "+"
    x: float = 0.0
    y: float = 0.0
    angle_deg: float = 0.0
    sizes: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "sizes", tuple(several(self.sizes)))

    def check(self, owner: str) -> None:
        """
        Check the kind, the sign and the dimensions of the figure.

        Raises
        ------
        MistrayError
            If kind or sign is unknown, a value is not finite, or a size is missing or not positive; or if a polygon has
            too few or too many corners, no area, or sides that cross.
        """
        if self.kind not in KINDS or self.sign not in SIGNS:
            raise MistrayError(f"{owner}: '{self.sign}{self.kind}' is not a figure; use + - or & and one of {KINDS}")
        numbers = (self.x, self.y, self.angle_deg, *self.sizes)
        if not all(math.isfinite(v) for v in numbers):
            raise MistrayError(f"{owner}: {self.kind} with {numbers}; all of its numbers must be finite")
        if self.kind == "polygon":
            self._check_polygon(owner)
        elif len(self.sizes) != len(SIZES[self.kind]) or min(self.sizes) <= 0:
            raise MistrayError(
                f"{owner}: {self.kind} of {self.sizes} mm; it needs {', '.join(SIZES[self.kind])} above 0"
            )

    def _check_polygon(self, owner: str) -> None:
        count = len(self.sizes) // 2
        if len(self.sizes) % 2 or not 3 <= count <= MOST_CORNERS:
            raise MistrayError(
                f"{owner}: polygon of {len(self.sizes)} numbers; it needs x and y of 3 to {MOST_CORNERS} corners"
            )
        corners = self.corners
        for i, j in combinations(range(count), 2):
            a, b, c, d = corners[i], corners[(i + 1) % count], corners[j], corners[(j + 1) % count]
            beside = (i + 1) % count == j or (j + 1) % count == i
            if not beside and _cross(a, b, c, d):
                raise MistrayError(f"{owner}: polygon crosses itself, sides {i + 1} and {j + 1}; sort its corners")
        if abs(signed_area(corners)) <= 1e-12 * max(float(np.ptp(corners, axis=0).max()), 1e-300) ** 2:
            raise MistrayError(f"{owner}: polygon without area; correct its corners")

    @property
    def corners(self) -> np.ndarray:
        """Corners of a polygon, or of the box of another figure, in its own frame, (n, 2), mm."""
        if self.kind == "polygon":
            return np.array(self.sizes, dtype=np.float64).reshape(-1, 2)
        a, b = self.sizes if len(self.sizes) == 2 else 2 * self.sizes
        return np.array([(-a, -b), (a, -b), (a, b), (-a, b)])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the figure's parameters, in the order of `values`."""
        if self.kind == "polygon":
            return ("x", "y", "angle_deg", *(f"{c}{k + 1}" for k in range(len(self.sizes) // 2) for c in "xy"))
        return ("x", "y", "angle_deg", *SIZES[self.kind])

    @property
    def values(self) -> tuple[float, ...]:
        """Position (x, y), mm, angle, degrees, and sizes, mm, of the figure, in the order of `names`."""
        return (self.x, self.y, self.angle_deg, *self.sizes)

    def bounds(self) -> tuple[float, float, float, float]:
        """Return the least and greatest x, then the least and greatest y of the figure in the outline's frame, mm."""
        c, s = math.cos(math.radians(self.angle_deg)), math.sin(math.radians(self.angle_deg))
        if self.kind in ("circle", "ellipse"):
            a, b = self.sizes if len(self.sizes) == 2 else 2 * self.sizes
            wide, high = math.hypot(a * c, b * s), math.hypot(a * s, b * c)
            return self.x - wide, self.x + wide, self.y - high, self.y + high
        x, y = self.placed(self.corners).T
        return float(x.min()), float(x.max()), float(y.min()), float(y.max())

    @property
    def reach(self) -> float:
        """Upper bound of the distance of the figure's points from the outline's origin, mm."""
        if self.kind in ("circle", "ellipse"):
            return math.hypot(self.x, self.y) + max(self.sizes)
        return float(np.hypot(*self.placed(self.corners).T).max())

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Return points, (n, 2), mm, converted from the frame of the figure to that of its outline."""
        c, s = math.cos(math.radians(self.angle_deg)), math.sin(math.radians(self.angle_deg))
        u, v = points.T
        return np.stack([self.x + c * u - s * v, self.y + s * u + c * v], axis=1)

    def crossed(self, y: np.ndarray) -> np.ndarray:
        """Return the x, (n, k), mm, at which lines along x at given y, (n,), mm, cross the border; NaN for none."""
        if self.kind in ("circle", "ellipse"):
            a, b = self.sizes if len(self.sizes) == 2 else 2 * self.sizes
            c, s, up = math.cos(math.radians(self.angle_deg)), math.sin(math.radians(self.angle_deg)), y - self.y
            # (u/a)² + (v/b)² = 1 with u = c X + s Y, v = c Y - s X
            square, half = (c / a) ** 2 + (s / b) ** 2, c * s * up * (1 / a**2 - 1 / b**2)
            with np.errstate(invalid="ignore"):
                root = np.sqrt(half**2 - square * (((s / a) ** 2 + (c / b) ** 2) * up**2 - 1))
            return np.stack([self.x - (half + root) / square, self.x - (half - root) / square], axis=1)
        start = self.placed(self.corners)
        (x0, y0), (x1, y1) = start.T, np.roll(start, -1, axis=0).T
        crosses = (y0 <= y[:, None]) != (y1 <= y[:, None])
        return np.where(crosses, x0 + (y[:, None] - y0) / np.where(y1 == y0, 1.0, y1 - y0) * (x1 - x0), np.nan)

    def contains(self, x: Any, y: Any, n: Mapping[str, Any]) -> Any:
        """
        Return a mask of points x, y, mm, that lie in the figure.

        `n` holds its parameters by name, lengths in mm, with "cos" and "sin" of the angle if the figure is rotated.
        """
        u, v = x - n["x"], y - n["y"]
        if self.kind == "circle":
            return u * u + v * v <= n["radius"] * n["radius"]
        if self.angle_deg:
            u, v = u * n["cos"] + v * n["sin"], v * n["cos"] - u * n["sin"]
        if self.kind == "ellipse":
            u, v = u / n["half_width"], v / n["half_height"]
            return u * u + v * v <= 1
        if self.kind == "rectangle":
            return (abs(u) <= n["half_width"]) & (abs(v) <= n["half_height"])
        count = len(self.sizes) // 2
        inside = None
        for k in range(count):  # how often a line to the right crosses the sides
            (x0, y0), (x1, y1) = ((n[f"x{j + 1}"], n[f"y{j + 1}"]) for j in (k, (k + 1) % count))
            low, high = y0 <= v, y1 <= v
            left = (x1 - x0) * (v - y0) - (u - x0) * (y1 - y0) > 0
            crossed = (low & ~high & left) | (~low & high & ~left)
            inside = crossed if inside is None else inside ^ crossed
        return inside


@dataclass(frozen=True)
class Outline:
    """
    Outline of a surface: figures combined one after the other.

    Attributes
    ----------
    figures : tuple of OutlineFigure
        Figures in the order in which they are combined.

    Examples
    --------
    >>> slot = mistray.prescription.rectangle(4.0, 1.0)
    >>> slot.bounds()
    (-4.0, 4.0, -1.0, 1.0)
    >>> slot.contains(np.array([3.0, 5.0]), np.array([0.5, 0.5]))
    array([ True, False])
    """

    figures: tuple[OutlineFigure, ...]

    def __post_init__(self) -> None:
        check = OfType(OutlineFigure, "must be an OutlineFigure").check
        object.__setattr__(self, "figures", tuple(check("figures", one, "outline") for one in several(self.figures)))

    def check(self, owner: str) -> None:
        """
        Check that the outline defines a surface of finite size.

        Raises
        ------
        MistrayError
            If a figure is not valid, there is none or more than 64, or the outline is unbounded or empty.
        """
        if not 1 <= len(self.figures) <= MOST_FIGURES:
            raise MistrayError(f"{owner}: an outline of {len(self.figures)} figures; use 1 to {MOST_FIGURES}")
        for figure in self.figures:
            figure.check(owner)
        x0, x1, y0, y1 = self.bounds()
        if max(x1 - x0, y1 - y0) >= ALL:
            raise MistrayError(f"{owner}: its outline has no bounds; begin with a figure that is not cut away")
        if self.empty:
            raise MistrayError(f"{owner}: its outline holds nothing; correct its figures")

    def bounds(self) -> tuple[float, float, float, float]:
        """
        Return the least and greatest x, then y of a box around the outline, mm; ±1e30 where it is unbounded.

        Figures that are cut away do not reduce the box.
        """
        box = (-ALL, ALL, -ALL, ALL)
        for number, figure in enumerate(self.figures):
            own = figure.bounds()
            if figure.sign == "+":
                box = own if number == 0 else _around(box, own)
            elif figure.sign == "&":
                box = (max(box[0], own[0]), min(box[1], own[1]), max(box[2], own[2]), min(box[3], own[3]))
        return box

    @property
    def bounded(self) -> bool:
        """True if the outline has finite extent in both x and y."""
        x0, x1, y0, y1 = self.bounds()
        return max(x1 - x0, y1 - y0) < ALL

    @property
    def empty(self) -> bool:
        """True if no point of a fine grid over the outline's box lies in it."""
        x0, x1, y0, y1 = self.bounds()
        return not (x1 > x0 and y1 > y0) or not self.sample(200)[0].size

    @property
    def annulus(self) -> tuple[float, float] | None:
        """Outer and inner radius (0: no hole), mm, of a circle or annulus about the origin; None for other outlines."""
        first, *more = self.figures
        if first.sign != "+" or any(f.kind != "circle" or f.x or f.y for f in self.figures):
            return None
        if len(more) > 1 or any(f.sign != "-" for f in more):
            return None
        return first.sizes[0], more[0].sizes[0] if more else 0.0

    @property
    def sides(self) -> tuple[float, float] | None:
        """Half width and half height, mm, of an unrotated rectangle about the origin; None for other outlines."""
        first = self.figures[0]
        if len(self.figures) > 1 or first.kind != "rectangle" or first.sign != "+" or first.x or first.y:
            return None
        return (first.sizes[0], first.sizes[1]) if not first.angle_deg else None

    def within(self, radius: float) -> Outline:
        """Return the part of the outline within a circle about the origin; the radius is in mm."""
        first, *more = self.figures
        own = first if first.sign == "-" else replace(first, sign="&")
        return _in_circle(radius, [own, *more])

    def around(self, radius: float) -> Outline | None:
        """
        Return the part of a circle of `radius`, mm, about the origin that lies outside the outline.

        It is None if figures cannot express it: the outline begins with a hole, or it has an intersection.
        """
        if self.figures[0].sign != "+" or any(f.sign == "&" for f in self.figures):
            return None
        signs = {"+": "-", "-": "+"}
        return _in_circle(radius, [replace(f, sign=signs[f.sign]) for f in self.figures])

    def grown(self, margin: float) -> Outline:
        """
        Return the outline with all edges but those of polygons moved by `margin`, mm: out if > 0, so that holes shrink.

        A figure that would vanish keeps sizes of 0.
        """

        def grown(f: OutlineFigure) -> OutlineFigure:
            if f.kind == "polygon":
                return f
            more = -margin if f.sign == "-" else margin
            return replace(f, sizes=tuple(max(size + more, 0.0) for size in f.sizes))

        return Outline(tuple(map(grown, self.figures)))

    def half_turned(self) -> Outline:
        """Return the same outline as seen in a frame turned by 180° about the y axis, which reverses x."""

        def turned(f: OutlineFigure) -> OutlineFigure:
            sizes = f.sizes if f.kind != "polygon" else tuple(v * (-1) ** (k + 1) for k, v in enumerate(f.sizes))
            return OutlineFigure(f.kind, f.sign, -f.x, f.y, -f.angle_deg, sizes)

        return Outline(tuple(map(turned, self.figures)))

    def turned(self, angle_deg: float) -> Outline:
        """Return the outline rotated about the origin, from x to y, by an angle in degrees."""
        c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
        return Outline(
            tuple(
                OutlineFigure(f.kind, f.sign, c * f.x - s * f.y, s * f.x + c * f.y, f.angle_deg + angle_deg, f.sizes)
                for f in self.figures
            )
        )

    def touches(self, x: np.ndarray, y: np.ndarray, slack: float) -> np.ndarray:
        """
        Return a mask of points, (n,), mm, that lie in the outline or at most about `slack`, mm, outside it.

        A negative `slack` asks for points that far inside. The distance is tested along x and along y only.
        """
        step = abs(slack)
        found = self.contains(x, y)
        for dx, dy in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)):
            near = self.contains(x + dx, y + dy)
            found = found | near if slack > 0 else found & near
        return np.asarray(found)

    def sample(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y, (n,), mm, of the points inside the outline of a count × count grid over its box."""
        x0, x1, y0, y1 = self.bounds()
        along = (np.arange(count) + 0.5) / count
        x, y = np.meshgrid(x0 + (x1 - x0) * along, y0 + (y1 - y0) * along)
        inside = self.contains(x, y)
        return x[inside], y[inside]

    def numbers(self) -> dict[str, float]:
        """Return the parameters of all figures by name, such as "clip_1_radius"; lengths in mm, angles in degrees."""
        return {
            f"clip_{k}_{name}": value
            for k, figure in enumerate(self.figures, start=1)
            for name, value in zip(figure.names, figure.values, strict=True)
        }

    def turns(self) -> dict[str, float]:
        """Return the cosine and sine of each rotated figure's angle, by names as "clip_1_cos"; empty without any."""
        found: dict[str, float] = {}
        for k, figure in enumerate(self.figures, start=1):
            if figure.angle_deg:
                angle = math.radians(figure.angle_deg)
                found |= {f"clip_{k}_cos": math.cos(angle), f"clip_{k}_sin": math.sin(angle)}
        return found

    def with_numbers(self, numbers: Mapping[str, float]) -> Outline:
        """
        Return the outline with other parameters of its figures.

        The mapping `numbers` has the names and units that the method `Outline.numbers` gives.
        """
        figures = []
        for k, figure in enumerate(self.figures, start=1):
            x, y, angle, *sizes = (numbers[f"clip_{k}_{name}"] for name in figure.names)
            figures.append(OutlineFigure(figure.kind, figure.sign, x, y, angle, tuple(sizes)))
        return Outline(tuple(figures))

    @property
    def form(self) -> tuple[tuple[str, str, int, bool], ...]:
        """
        Kind, sign, number of sizes, and whether it is rotated, of each figure.

        Code that is generated for an outline depends on these alone.
        """
        return tuple((f.kind, f.sign, len(f.sizes), bool(f.angle_deg)) for f in self.figures)

    def contains(self, x: Any, y: Any, numbers: Mapping[str, Any] | None = None) -> Any:
        """
        Return a mask of points that lie within the outline; False for NaN.

        Parameters
        ----------
        x, y : float or array
            Coordinates of the points, mm.
        numbers : mapping of str to float or array, optional
            Values of `numbers` and `turns` by name; by default those of the outline itself.
        """
        known = self.numbers() | self.turns() if numbers is None else numbers
        inside: Any = None
        for k, figure in enumerate(self.figures, start=1):
            start = f"clip_{k}_"
            own = {name[len(start) :]: value for name, value in known.items() if name.startswith(start)}
            here = figure.contains(x, y, own)
            if inside is None:
                inside = ~here if figure.sign == "-" else here
            elif figure.sign == "+":
                inside = inside | here
            else:
                inside = inside & (~here if figure.sign == "-" else here)
        return inside


def outline_of(values: Any, number: Callable[..., float], owner: str) -> Outline | None:
    """
    Return the outline that properties state as ``clip_1``, ``clip_2``, …, or None without them.

    Parameters
    ----------
    values : mapping
        Properties by name.
    number : callable
        Returns the number of a name, or the default that it gets.
    owner : str
        Name of the surface, for messages.

    Raises
    ------
    MistrayError
        If a figure is unknown or lacks a size.
    """
    figures = []
    for k in range(1, MOST_FIGURES + 1):
        if f"clip_{k}" not in values:
            break
        text = str(values[f"clip_{k}"]).strip()
        sign, kind = (text[:1], text[1:].strip()) if text[:1] in SIGNS else ("+", text)
        if kind not in KINDS:
            raise MistrayError(f"{owner}: clip_{k} is '{text}'; use + - or & and one of {', '.join(KINDS)}")
        sizes = list(SIZES.get(kind, ()))
        while kind == "polygon" and f"clip_{k}_x{len(sizes) // 2 + 1}" in values:
            sizes += [f"{axis}{len(sizes) // 2 + 1}" for axis in "xy"]
        for name in sizes:
            if f"clip_{k}_{name}" not in values:
                raise MistrayError(f"{owner}: {kind} clip_{k} needs clip_{k}_{name}; add it")
        x, y, angle = (number(f"clip_{k}_{name}", 0.0) for name in ("x", "y", "angle_deg"))
        lengths = tuple(number(f"clip_{k}_{name}") for name in sizes)
        figures.append(OutlineFigure(kind, sign, x, y, angle, lengths))
    return Outline(tuple(figures)) if figures else None


def circle(radius: float, inner: float = 0.0, x: float = 0.0, y: float = 0.0) -> Outline:
    """
    Return the outline of a circle of `radius` centred at (x, y), or of an annulus if `inner` > 0; lengths in mm.

    Examples
    --------
    >>> ring = mistray.prescription.circle(5.0, inner=2.0)
    >>> ring.contains(np.array([0.0, 3.0]), np.array([0.0, 0.0]))
    array([False,  True])
    """
    hole = (OutlineFigure("circle", "-", x, y, sizes=(inner,)),) if inner > 0 else ()
    return Outline((OutlineFigure("circle", "+", x, y, sizes=(radius,)), *hole))


def rectangle(half_width: float, half_height: float, x: float = 0.0, y: float = 0.0, angle_deg: float = 0.0) -> Outline:
    """
    Return the outline of a rectangle centred at (x, y), rotated from x to y by `angle_deg`, degrees; lengths in mm.

    Before the rotation `half_width` is its half size along x, and `half_height` that along y.

    Examples
    --------
    >>> window = mistray.prescription.rectangle(4.0, 1.0, angle_deg=90.0)
    >>> [round(edge, 6) for edge in window.bounds()]
    [-1.0, 1.0, -4.0, 4.0]
    """
    return Outline((OutlineFigure("rectangle", "+", x, y, angle_deg, (half_width, half_height)),))


def polygon(corners: Sequence[Sequence[float]]) -> Outline:
    """
    Return the outline of a polygon with given corners (x, y), mm.

    Examples
    --------
    >>> triangle = mistray.prescription.polygon([(0, 0), (4, 0), (0, 3)])
    >>> triangle.bounds()
    (0.0, 4.0, 0.0, 3.0)
    """
    points = Several(CORNER).check("corners", corners, "polygon")
    return Outline((OutlineFigure("polygon", sizes=tuple(v for point in points for v in point)),))


def _in_circle(radius: float, figures: Sequence[OutlineFigure]) -> Outline:
    """Return the outline of a circle of `radius`, mm, about the origin, combined with figures and cut to the circle."""
    circle = OutlineFigure("circle", sizes=(radius,))
    beyond = [replace(circle, sign="&")] if any(f.sign == "+" for f in figures) else []
    return Outline((circle, *figures, *beyond))


def _around(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float, float]:
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def signed_area(corners: np.ndarray) -> float:
    """Return the area of a polygon with corners (n, 2), in their unit squared; positive if counterclockwise."""
    x, y = corners.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """True if the segments a-b and c-d, of points (2,), cross at an inner point of both."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0

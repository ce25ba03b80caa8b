"""Sag of a freeform in the kernel: a quadric and a departure in Chebyshev polynomials, about the middle of its outline.

Let cx x² + cy y² + A z² = 2 z be a quadric in the frame of its vertex, with lengths in mm, and cx, cy and A in 1/mm. In
a parallel frame whose origin is the point x0, y0, z0 of the quadric, at the middle of the outline, it is

    C(x, y) - 2 B z + A z² = 0,   C = cx x² + cy y² + 2 (lx x + ly y),   z = C / (B + √(B² - A C)),

with the dimensionless B = 1 - A z0, lx = cx x0 and ly = cy y0. So an off-axis piece is computed to the precision of its
own size, however far away its vertex is. Polynomials do not approximate odd powers of the distance from the vertex
well: these are added to the departure, and so is a grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np

from mistray.physics._arrays import sqrt
from mistray.physics.geometry.departure import BoxDeparture, Form
from mistray.physics.sags.terms import FIXED, GRID, LENGTHS, MOST_RADIAL, length_power, sag
from mistray.surfaces.extrema import larger
from mistray.surfaces.families.grid_patches import GridPatches

QUADRIC = ("cx", "cy", "a", "b", "lx", "ly")
BOX = ("ix", "iy")
VERTEX = ("vx", "vy", "per_size", "at_middle")
GRIDDED = ("grid_scale", "grid_x", "grid_y", "grid_middle")
NEAREST = 1e-12  # squared distance from the vertex that replaces smaller ones, in units of the size squared
ENDED = 1e-6  # fraction of B²: beyond its end a conic keeps the slope that it has there, so that searches converge
PROBE = 1e-3  # replaces a number that is 0, in units of the size: its derivative stays
ENOUGH = 2e-9  # error of a departure that is small enough, in units of the size
TOO_MUCH = 1e-6  # error of a departure that is reported, in units of the size


@dataclass(frozen=True)
class FreeformSag:
    """
    Form of a freeform's sag, on which its kernel code depends; its implicit function is F = z - sag(x, y).

    Attributes
    ----------
    curved : bool
        Whether the quadric is curved; False for a plane, which may be tilted.
    form : Form
        Form of the departure from the quadric.
    odd : tuple of int
        Odd powers of the distance from the vertex; (): there are none.
    grid : GridPatches, optional
        Grid of heights added to the sag; None: no grid is added.
    """

    curved: bool
    form: Form
    odd: tuple[int, ...] = ()
    grid: GridPatches | None = None

    @property
    def quadric(self) -> bool:
        """True if the sag is a pure quadric, so that ray crossings are roots of a quadratic equation."""
        return self.form.degree < 0 and not self.odd and self.grid is None

    def roots(self, q: tuple[Any, Any, Any], d: tuple[Any, Any, Any], n: Mapping[str, Any]) -> tuple[Any, Any]:
        """
        Return the two distances, mm, at which lines meet the quadric, the lesser first; NaN or infinite for none.

        For a plane both are the same.

        Parameters
        ----------
        q, d : (3,) arrays
            Points near the quadric, mm, and unit directions of the lines.
        n : mapping
            Values of the sag's parameters by name.
        """
        (x, y, z), (dx, dy, dz) = q, d
        if not self.curved:
            t = (n["b"] * z - x * n["lx"] - y * n["ly"]) / (dx * n["lx"] + dy * n["ly"] - n["b"] * dz)
            return t, t
        along_x, along_y, along_z = n["cx"] * x + n["lx"], n["cy"] * y + n["ly"], n["a"] * z - n["b"]
        square = n["cx"] * dx * dx + n["cy"] * dy * dy + n["a"] * dz * dz
        half = along_x * dx + along_y * dy + along_z * dz
        value = x * (along_x + n["lx"]) + y * (along_y + n["ly"]) + z * (along_z - n["b"])
        # Without a difference of near numbers
        larger_part = -(half + dr.mulsign(dr.sqrt(half * half - square * value), half))
        first, second = larger_part / square, value / larger_part
        return dr.minimum(first, second), dr.maximum(first, second)

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Names of the sag's parameters, such as curvatures and polynomial coefficients."""
        odd = (*VERTEX, *(f"odd_{k}" for k in self.odd)) if self.odd else ()
        return (*QUADRIC, *BOX, *self._coefficients, *odd, *(GRIDDED if self.grid is not None else ()))

    @cached_property
    def _coefficients(self) -> tuple[str, ...]:
        return tuple(f"c{k}" for k in range(len(self.form.terms) if self.form.degree >= 0 else 0))

    def evaluate(self, x: Any, y: Any, n: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """
        Return the sag, mm, and its slopes in x and y at points, mm.

        `n` has the values of the parameters by name. All arrays are of NumPy or of Dr.Jit. Beyond the end of a conic
        the result is NaN with NumPy; with Dr.Jit the slope that the conic has there continues.
        """
        across, along = n["cx"] * x + n["lx"], n["cy"] * y + n["ly"]
        if self.curved:
            c = x * (across + n["lx"]) + y * (along + n["ly"])
            root = _root(n["b"] * n["b"] - n["a"] * c)
            steep = 1 / root
            z, across, along = c / (n["b"] + root), across * steep, along * steep
        else:
            z = (x * n["lx"] + y * n["ly"]) / n["b"]
            across, along = across / n["b"], along / n["b"]
        if self.form.degree >= 0:
            u, v = x * n["ix"], y * n["iy"]
            more, by_u, by_v = self.form.evaluate(u, v, [n[name] for name in self._coefficients])
            z, across, along = z + more, across + by_u * n["ix"], along + by_v * n["iy"]
        if self.odd:
            u, v = (x + n["vx"]) * n["per_size"], (y + n["vy"]) * n["per_size"]
            r2 = u * u + v * v + NEAREST
            power, order = sqrt(r2), 1
            z = z - n["at_middle"]
            for k in self.odd:
                while order < k:
                    power, order = power * r2, order + 2
                part = n[f"odd_{k}"] * power
                steep = k * part / r2 * n["per_size"]
                z, across, along = z + part, across + steep * u, along + steep * v
        if self.grid is not None:
            height, by_x, by_y = self.grid.evaluate(x + n["grid_x"], y + n["grid_y"])
            scale = n["grid_scale"]
            z, across, along = z + scale * height - n["grid_middle"], across + scale * by_x, along + scale * by_y
        return z, across, along

    def residual(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """Return the implicit function F = z - sag(x, y), mm, at points (mm); it is 0 on the surface."""
        return z - self.evaluate(x, y, n)[0]

    def gradient(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Return the derivatives of F = z - sag(x, y) with respect to x, y and z, dimensionless."""
        _, across, along = self.evaluate(x, y, n)
        return -across, -along, 1.0


def _root(square: Any) -> Any:
    if isinstance(square, np.ndarray | np.generic | float):
        with np.errstate(invalid="ignore"):
            return np.sqrt(square)
    return dr.sqrt(larger(square, ENDED))


@dataclass(frozen=True)
class LocalSag:
    """
    Sag of a freeform in a frame about the middle of its outline, in float64.

    Attributes
    ----------
    sag : FreeformSag
        Form of the sag.
    numbers : dict of str to float
        Values of the parameters that `sag.numbers` names.
    origin : (3,) float
        Middle of the outline in the frame of the vertex, mm.
    error, slope_error : float
        Largest difference from the exact sag, mm, and from its slope.
    """

    sag: FreeformSag
    numbers: dict[str, float]
    origin: tuple[float, float, float]
    error: float
    slope_error: float

    @classmethod
    def of(
        cls, n: Mapping[str, Any], middle: tuple[float, float], half: tuple[float, float], x: Any, y: Any
    ) -> LocalSag:
        """
        Return the sag over a box, fitted about the middle of that box.

        Parameters
        ----------
        n : mapping
            Values of the parameters of the exact sag by name, and its grid; see `mistray.physics.sags.terms`.
        middle, half : (2,) float
            Middle and half size of the box in the frame of the vertex, mm.
        x, y : (n,) float64
            Points of the outline in the frame of the vertex, mm.
        """
        form = cls._at(_probe(n, float(np.hypot(*half))), middle, half, x, y, None).sag
        return cls._at(n, middle, half, x, y, form)

    def moved(
        self, n: Mapping[str, Any], middle: tuple[float, float], half: tuple[float, float], x: Any, y: Any
    ) -> LocalSag:
        """
        Return the sag for changed parameters, in the form of this one so that the kernel code stays the same.

        Parameters as in `of`.
        """
        return self._at(n, middle, half, x, y, self.sag)

    @classmethod
    def _at(
        cls,
        n: Mapping[str, Any],
        middle: tuple[float, float],
        half: tuple[float, float],
        x: Any,
        y: Any,
        form: FreeformSag | None,
    ) -> LocalSag:
        ox, oy = middle
        quadric = _quadric(n)
        z0 = float(quadric_sag(ox, oy, *quadric))
        cx, cy, a = quadric
        base = {"cx": cx, "cy": cy, "a": a, "b": 1 - a * z0, "lx": cx * ox, "ly": cy * oy}
        at_middle = float(sag(np.array(ox), np.array(oy), n))
        size = float(np.hypot(*half))
        powers = {k: n[f"r{k}"] for k in range(1, MOST_RADIAL + 1, 2) if f"r{k}" in n}
        odd = {f"odd_{k}": amount * size**k for k, amount in powers.items()}
        if odd:
            r = np.sqrt((ox * ox + oy * oy) / size**2 + NEAREST)
            base |= {"vx": ox, "vy": oy, "per_size": 1 / size}
            base |= {"at_middle": sum(amount * r**k for k, amount in zip(powers, odd.values(), strict=True)), **odd}
        own = FreeformSag(bool(cx or cy), Form(), tuple(powers))
        smooth = {name: value for name, value in n.items() if name != GRID}
        smooth_middle = float(sag(np.array(ox), np.array(oy), smooth))

        def departure(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return np.asarray(sag(x + ox, y + oy, smooth) - smooth_middle - own.evaluate(x, y, base)[0])

        found = BoxDeparture.of(departure, half, x - ox, y - oy, ENOUGH * size, form.form if form else None)
        if form is None:
            whole = FreeformSag(own.curved, found.form, own.odd, GridPatches(n[GRID]) if GRID in n else None)
        else:
            whole = FreeformSag(form.curved, found.form, own.odd, form.grid)
        box = {"ix": 1 / found.half[0], "iy": 1 / found.half[1]}
        coefficients = {f"c{k}": float(c) for k, c in enumerate(found.coefficients)}
        if GRID in n:
            box |= dict(
                zip(
                    GRIDDED,
                    (n.get("grid_scale", 1.0), ox - n.get("grid_x", 0.0), oy - n.get("grid_y", 0.0),
                     at_middle - smooth_middle),
                    strict=True,
                )
            )  # fmt: skip
        return cls(whole, base | box | coefficients, (ox, oy, at_middle), found.error, found.slope_error)


def _probe(n: Mapping[str, Any], size: float) -> dict[str, Any]:
    """Return a sag's parameters slightly changed, none 0 and curvatures unequal, to show its general form."""
    twofold = "curvature_x" in n or "toroid_curvature" in n
    found: dict[str, Any] = {}
    for k, (name, value) in enumerate(n.items()):
        if name == GRID:
            found[name] = value
            continue
        step = PROBE * size ** (length_power(name) or 0)
        if name not in FIXED:
            found[name] = value or step
        else:
            unlike = twofold and name not in LENGTHS
            found[name] = (value * (1 - (k + 1) * PROBE) or step) if unlike else value
    return found


def _quadric(n: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return curvatures in x and y and the factor of z² of the quadric that underlies a sag, 1/mm each."""
    c, k = n.get("curvature", 0.0), n.get("conic", 0.0)
    if "toroid_curvature" in n:
        cx, kx = n["toroid_curvature"], 0.0
    elif "curvature_x" in n:
        cx, kx = n["curvature_x"], n.get("conic_x", 0.0)
    else:
        return c, c, c * (1 + k)
    # Between those of both profiles, so that it is that of a cylinder's own and changes smoothly
    largest = max(abs(c), abs(cx)) or 1.0
    u, v = (c / largest) ** 2, (cx / largest) ** 2
    return cx, c, (u * c * (1 + k) + v * cx * (1 + kx)) / ((u + v) or 1.0)


def quadric_sag(x: Any, y: Any, cx: float, cy: float, a: float) -> Any:
    """
    Return the sag of a quadric at points (x, y) in the frame of its vertex, mm.

    `cx` and `cy` are its curvatures, `a` is the factor of z², all in 1/mm.
    """
    c = cx * x * x + cy * y * y
    return c / (1 + np.sqrt(1 - a * c))

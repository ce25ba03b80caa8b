"""
Importance targets of scattered rays: flat regions, ellipsoids and cones, grouped by the place where light is scattered.

A flat target of area A, mm², has the pdf r²/(A |cos θ|) per sr. Here r is the distance of the point of the target, mm,
and θ the angle between the direction and the target's normal, see `mistray.kernel.device_targets`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mistray.errors import MistrayError

SHAPES = ("ellipse", "parallelogram", "triangle")


@dataclass(frozen=True, eq=False)
class Target:
    """
    Flat importance target, to which scattered rays are sent uniformly over its area.

    Points of the region are centre + a u + b v, with

    - "ellipse": hole ≤ √(a² + b²) ≤ 1, so that u and v are conjugate radii;
    - "parallelogram": -1 ≤ a, b ≤ 1, so that u and v are half edges;
    - "triangle": a, b ≥ 0 and a + b ≤ 1, so that `centre` is a corner, u and v are edges.

    Attributes
    ----------
    shape : {"ellipse", "parallelogram", "triangle"}
        Shape of the region, see above.
    centre : (3,) float64
        Centre, or a corner of a triangle, mm.
    u, v : (3,) float64
        Vectors that span the region, mm; they need not be at right angles.
    hole : float
        Inner radius of an ellipse as a fraction of the outer one, 0 ≤ hole < 1.
    reverse : bool
        Whether the target is virtual: rays leave along the line from one of its points to the surface, away from it.
    share : float
        Probability that an aimed ray of the surface goes to this target.

    Raises
    ------
    MistrayError
        For an unknown shape, a target of no area, a hole or a share out of range.
    """

    shape: str
    centre: np.ndarray
    u: np.ndarray
    v: np.ndarray
    hole: float = 0.0
    reverse: bool = False
    share: float = 1.0

    def __post_init__(self) -> None:
        # Arrays in float64, whatever the caller gives
        for key in ("centre", "u", "v"):
            value = np.asarray(getattr(self, key), dtype=np.float64)
            if value.shape != (3,) or not np.all(np.isfinite(value)):
                raise MistrayError(f"target: {key} is {getattr(self, key)}; give three finite numbers (mm)")
            object.__setattr__(self, key, value)
        if self.shape not in SHAPES:
            raise MistrayError(f"target: shape is '{self.shape}'; use {', '.join(SHAPES[:-1])} or {SHAPES[-1]}")
        if not 0 <= self.hole < 1 or (self.hole and self.shape != "ellipse"):
            raise MistrayError(f"target: hole is {self.hole:g} of a {self.shape}; only an ellipse has one, below 1")
        if not 0 < self.share <= 1:
            raise MistrayError(f"target: share is {self.share:g}; it is a probability above 0 and at most 1")
        # Parallel u and v have no area, and no pdf
        if not np.linalg.norm(np.cross(self.u, self.v)) > 0:
            raise MistrayError(f"target at {self.centre.tolist()} mm has no area; give it a size")

    @cached_property
    def normal(self) -> np.ndarray:
        """Unit normal of the target along u × v, (3,) float64."""
        normal = np.cross(self.u, self.v)
        return np.asarray(normal / np.linalg.norm(normal))

    @cached_property
    def area(self) -> float:
        """Area of the target, mm²."""
        # A parallelogram has half edges, so that it is four times u × v
        factor = {"ellipse": np.pi * (1 - self.hole**2), "parallelogram": 4.0, "triangle": 0.5}[self.shape]
        return float(factor * np.linalg.norm(np.cross(self.u, self.v)))

    def points(self, samples: np.ndarray) -> np.ndarray:
        """
        Return points on the target, mapped from the unit square so that uniform density stays uniform.

        Parameters
        ----------
        samples : (n, 2) float64
            Points of the unit square; uniform ones give points of uniform density.

        Returns
        -------
        (n, 3) float64
            Points, mm.
        """
        first, second = samples[:, 0], samples[:, 1]
        if self.shape == "ellipse":
            # Area grows with the square of the radius
            radius = np.sqrt(self.hole**2 + (1 - self.hole**2) * first)
            a, b = radius * np.cos(2 * np.pi * second), radius * np.sin(2 * np.pi * second)
        elif self.shape == "parallelogram":
            a, b = 2 * first - 1, 2 * second - 1
        else:
            # The lines a + b = s are of length ∝ s: a root makes points uniform, as for a disc
            root = np.sqrt(first)
            a, b = root * (1 - second), root * second
        return np.asarray(self.centre + a[:, None] * self.u + b[:, None] * self.v)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Return a mask, (n,), of points (n, 3), mm, in the target's plane that lie on the target; False for NaN."""
        # Coordinates a, b by the pseudoinverse, since u and v need not be at right angles
        a, b = np.linalg.pinv(np.stack([self.u, self.v], axis=1)) @ (points - self.centre).T
        with np.errstate(invalid="ignore"):
            if self.shape == "ellipse":
                # A comparison with NaN is false
                return (np.hypot(a, b) <= 1) & (np.hypot(a, b) >= self.hole)
            if self.shape == "parallelogram":
                return (np.abs(a) <= 1) & (np.abs(b) <= 1)
            return (a >= 0) & (b >= 0) & (a + b <= 1)

    def sides(self, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator) -> tuple[bool, bool]:
        """
        Return two bools: whether any random ray to the target leaves against a normal, and whether any leaves along it.

        The rays start at points (n, 3), mm, of surfaces that have the `normals` (n, 3) there.
        """
        return _sides(self.points(rng.random((len(points), 2))) - points, normals, self.reverse)

    @property
    def size(self) -> tuple[float, float]:
        """Lengths of u and v, mm: conjugate radii of an ellipse, half sides of a parallelogram, edges of a triangle."""
        return float(np.linalg.norm(self.u)), float(np.linalg.norm(self.v))


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """
    Sphere or ellipsoid as an importance target of scattered rays.

    Space is scaled so that the ellipsoid is a sphere. There rays are uniform in the solid angle of the sphere; from
    within they go anywhere.

    Attributes
    ----------
    centre : (3,) float64
        Centre, mm.
    axes : (3, 3) float64
        Half axes as rows, mm; at right angles to each other.
    reverse, share
        See `Target`.

    Raises
    ------
    MistrayError
        For numbers that are not finite, or half axes that are 0 or not at right angles.
    """

    centre: np.ndarray
    axes: np.ndarray
    reverse: bool = False
    share: float = 1.0
    shape = "ellipsoid"

    def __post_init__(self) -> None:
        centre, axes = np.asarray(self.centre, dtype=np.float64), np.asarray(self.axes, dtype=np.float64)
        if centre.shape != (3,) or axes.shape != (3, 3) or not (np.isfinite(centre).all() and np.isfinite(axes).all()):
            raise MistrayError("target: an ellipsoid has a centre and three half axes; give finite numbers (mm)")
        # The Gram matrix is diagonal where the half axes are at right angles; 1e-5 allows for rounded input
        squares = axes @ axes.T
        lengths = np.sqrt(np.diag(squares))
        if not np.all(lengths > 0) or np.any(np.abs(squares - np.diag(lengths**2)) > 1e-5 * np.outer(lengths, lengths)):
            raise MistrayError(
                f"target at {centre.tolist()} mm: half axes of {', '.join(f'{v:g}' for v in lengths)} mm; those of an "
                "ellipsoid are longer than 0 and at right angles"
            )
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "axes", axes)

    def sides(self, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator) -> tuple[bool, bool]:
        """
        Return two bools: whether any random ray to the target leaves against a normal, and whether any leaves along it.

        The rays start at points (n, 3), mm, of surfaces that have the `normals` (n, 3) there.
        """
        # Normal deviates have no preferred direction: points of the unit sphere, scaled to the ellipsoid
        on = rng.normal(size=points.shape)
        on = self.centre + on / np.linalg.norm(on, axis=1, keepdims=True) @ self.axes
        return _sides(on - points, normals, self.reverse)

    @property
    def size(self) -> tuple[float, float]:
        """Lengths of the two longer half axes of the ellipsoid, mm."""
        # Half axes of the largest silhouette
        _, second, longest = np.sort(np.linalg.norm(self.axes, axis=1))
        return float(longest), float(second)


@dataclass(frozen=True, eq=False)
class TargetCone:
    """
    Cone of directions as an importance target, sampled uniformly in solid angle.

    Attributes
    ----------
    about : {"direction", "point", "specular"}
        Axis: a fixed direction, the direction to a point, or that of the specular beam.
    axis : (3,) float64
        Direction (of any length) or point, mm; not used about "specular".
    half_angle : float
        Half-angle, rad, above 0 and at most π.
    reverse, share
        See `Target`.

    Raises
    ------
    MistrayError
        For an unknown `about`, an axis that is not finite, a direction of length 0, or a half-angle out of range.
    """

    about: str
    axis: np.ndarray
    half_angle: float
    reverse: bool = False
    share: float = 1.0
    shape = "cone"

    def __post_init__(self) -> None:
        axis = np.asarray(self.axis, dtype=np.float64)
        if self.about not in CONES:
            raise MistrayError(f"target: a cone about '{self.about}'; use {', '.join(CONES[:-1])} or {CONES[-1]}")
        if axis.shape != (3,) or not np.isfinite(axis).all():
            raise MistrayError(f"target: the axis of a cone is {self.axis}; give three finite numbers")
        # Only a direction has to be of unit length; a point is in mm
        if self.about == "direction":
            length = float(np.linalg.norm(axis))
            if not length > 0:
                raise MistrayError("target: the direction of a cone is 0; give it a length")
            axis = axis / length
        if not 0 < self.half_angle <= np.pi:
            angle = np.degrees(self.half_angle)
            raise MistrayError(f"target: the half-angle of a cone is {angle:g}°; it lies above 0 and is at most 180°")
        object.__setattr__(self, "axis", axis)

    @property
    def width(self) -> float:
        """Value of 1 - cos α for the cone's half-angle α, the height of its cap on the unit sphere."""
        # By the half of it, since 1 - cos of a small angle is lost in rounding
        return float(2 * np.sin(0.5 * self.half_angle) ** 2)

    @property
    def solid_angle(self) -> float:
        """Solid angle of the cone, sr."""
        return 2 * np.pi * self.width

    def sides(self, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator) -> tuple[bool, bool]:
        """
        Return two bools: whether any random ray to the target leaves against a normal, and whether any leaves along it.

        The rays start at points (n, 3), mm, of surfaces that have the `normals` (n, 3) there. For a cone about the
        specular beam both are True.
        """
        if self.about == "specular":
            return True, True
        axes = self.axis - points if self.about == "point" else np.broadcast_to(self.axis, points.shape)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        # The cosine is uniform where directions are uniform in solid angle
        cosine = rng.uniform(1 - self.width, 1, len(points))
        # A random direction across the axis
        aside = np.cross(axes, rng.normal(size=points.shape))
        aside *= np.sqrt(1 - cosine**2)[:, None] / np.linalg.norm(aside, axis=1, keepdims=True)
        return _sides(cosine[:, None] * axes + aside, normals, self.reverse)


CONES = ("direction", "point", "specular")
AnyTarget = Target | Ellipsoid | TargetCone


def _sides(d: np.ndarray, normals: np.ndarray, reverse: bool) -> tuple[bool, bool]:
    """
    Return two bools: whether any ray along d, (n, 3), goes against its normal, and whether any goes along it.

    `normals` are (n, 3), one for each ray. With `reverse` rays go along -d.
    """
    outward = np.einsum("ij,ij->i", d, normals) * (-1 if reverse else 1)
    return bool(np.any(outward < 0)), bool(np.any(outward > 0))


@dataclass(frozen=True)
class Inside:
    """
    Volume on one side of a surface whose medium scatters light on its way to that surface.

    Attributes
    ----------
    surface : int
        Index of the surface.
    at_back : bool
        Whether the medium is at the back of the surface.
    """

    surface: int
    at_back: bool


Side = tuple[int, bool]
"""Index of a surface, and whether the light leaves it to the back."""

Place = Side | Inside
"""Place of scatter: a side of a surface, or a medium next to a surface."""


@dataclass(frozen=True, eq=False)
class AimSet:
    """
    Importance targets of light that a surface scatters to one of its sides, or that a medium scatters.

    Attributes
    ----------
    targets : tuple of Target, Ellipsoid or TargetCone
        Targets, whose shares add up to 1; they may overlap.
    rays : int
        Number of aimed rays at every hit, or on every ray segment in a medium; at least 1.

    Raises
    ------
    MistrayError
        If the shares do not add up to 1, or there is no ray.
    """

    targets: tuple[AnyTarget, ...]
    rays: int

    @classmethod
    def of(cls, targets: Sequence[AnyTarget], rays: int, weights: Sequence[float] | None = None) -> AimSet:
        """Return targets that share `rays` aimed rays per hit in proportion to `weights`; equally by default."""
        # By default each target gets as many rays as the others, whatever its size
        parts = np.ones(len(targets)) if weights is None else np.asarray(weights, dtype=np.float64)
        shares = (parts / parts.sum()).tolist()
        return cls(tuple(replace(target, share=share) for target, share in zip(targets, shares, strict=True)), rays)

    def __post_init__(self) -> None:
        total = sum(target.share for target in self.targets)
        if abs(total - 1) > 1e-9:
            raise MistrayError(f"targets of a surface: their shares add up to {total:g}; they must add up to 1")
        if self.rays < 1:
            raise MistrayError(f"targets of a surface: {self.rays} aimed rays; give at least one")

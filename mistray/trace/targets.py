"""Where scattered rays are aimed at: flat targets in space, and the targets of one side of one surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mistray.errors import MistrayError

SHAPES = ("ellipse", "parallelogram", "triangle")


@dataclass(frozen=True, eq=False)
class Target:
    """
    A flat region that rays are sent to, uniformly over its area.

    Points of the region are centre + a u + b v, with

    - "ellipse": hole ≤ √(a² + b²) ≤ 1, so that u and v are conjugate radii;
    - "parallelogram": -1 ≤ a, b ≤ 1, so that u and v are half edges;
    - "triangle": a, b ≥ 0 and a + b ≤ 1, so that `centre` is a corner, u and v are edges.

    Attributes
    ----------
    shape : {"ellipse", "parallelogram", "triangle"}
    centre : (3,) float64
        mm.
    u, v : (3,) float64
        mm; they need not be at right angles.
    hole : float
        Of an ellipse: share of the radius that is left out in the middle, 0 ≤ hole < 1.
    reverse : bool
        The target is virtual: rays leave along the line from a point of the target to the surface, away from it.
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
        if not np.linalg.norm(np.cross(self.u, self.v)) > 0:
            raise MistrayError(f"target at {self.centre.tolist()} mm has no area; give it a size")

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit vector of u × v."""
        normal = np.cross(self.u, self.v)
        return np.asarray(normal / np.linalg.norm(normal))

    @property
    def area(self) -> float:
        """mm²."""
        factor = {"ellipse": np.pi * (1 - self.hole**2), "parallelogram": 4.0, "triangle": 0.5}[self.shape]
        return float(factor * np.linalg.norm(np.cross(self.u, self.v)))

    def points(self, samples: np.ndarray) -> np.ndarray:
        """
        Points of the target.

        Parameters
        ----------
        samples : (n, 2) float64
            Of the unit square; uniform ones give points of uniform density.

        Returns
        -------
        (n, 3) float64
            mm.
        """
        first, second = samples[:, 0], samples[:, 1]
        if self.shape == "ellipse":
            radius = np.sqrt(self.hole**2 + (1 - self.hole**2) * first)
            a, b = radius * np.cos(2 * np.pi * second), radius * np.sin(2 * np.pi * second)
        elif self.shape == "parallelogram":
            a, b = 2 * first - 1, 2 * second - 1
        else:
            root = np.sqrt(first)
            a, b = root * (1 - second), root * second
        return np.asarray(self.centre + a[:, None] * self.u + b[:, None] * self.v)

    def holds(self, points: np.ndarray) -> np.ndarray:
        """Whether points (n, 3) of the target's plane lie on the target; NaN do not."""
        a, b = np.linalg.pinv(np.stack([self.u, self.v], axis=1)) @ (points - self.centre).T
        with np.errstate(invalid="ignore"):
            if self.shape == "ellipse":
                return (np.hypot(a, b) <= 1) & (np.hypot(a, b) >= self.hole)
            if self.shape == "parallelogram":
                return (np.abs(a) <= 1) & (np.abs(b) <= 1)
            return (a >= 0) & (b >= 0) & (a + b <= 1)

    def with_share(self, share: float) -> Target:
        """The same target with another share."""
        return replace(self, share=share)


@dataclass(frozen=True, eq=False)
class AimSet:
    """
    The targets of the light that leaves a surface on one of its sides.

    Attributes
    ----------
    targets : tuple of Target
        Their shares add up to 1; they may overlap.
    rays : int
        Aimed rays at every hit, at least 1.
    """

    targets: tuple[Target, ...]
    rays: int

    def __post_init__(self) -> None:
        total = sum(target.share for target in self.targets)
        if abs(total - 1) > 1e-9:
            raise MistrayError(f"targets of a surface: their shares add up to {total:g}; they must add up to 1")
        if self.rays < 1:
            raise MistrayError(f"targets of a surface: {self.rays} aimed rays; give at least one")

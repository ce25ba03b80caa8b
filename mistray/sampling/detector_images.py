"""
Images of the detector in the spaces of the design path: the importance targets of scattered light.

Light that leaves a surface of the design path lands on the detector if it heads for the image of the detector. The
image is that by all surfaces that follow, in the space that the light enters. A ray starts at the small distance p, mm,
from the base ray and differs from its direction by the small slope q. Its hit on the detector, mm, is

    x = x0 + P p + Q q

with 2 × 2 matrices P and Q, the latter in mm (for a coaxial system P = A and Q = B of the ABCD matrix). A plane at the
distance L is imaged onto the detector where Q = L P, that is L = B/A. A detector of half size h has an image of half
size h/|A|. In stray-light work these are ISL and ISH (see `mistray.physics.imaging.paraxial.image_seen`).

Backward rays are aimed at images of the opening of the system instead, see `DesignPath.reversed`.

A paraxial image includes neither aberrations nor the apertures on the way. Real rays show how large the target must be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mistray.kernel.targets import Target
from mistray.sampling.design_path import DesignPath
from mistray.surfaces.host_points import across, sphere_points

NEAR = 1e-6  # least distance of a target, in units of the system's size
FAR = 1e4  # finite stand-in for infinity, in units of the system's size
DIFFERENCE = 1e-5  # steps of the derivatives along a path, in units of the system's size and as slopes
SEARCH = 3.0  # enlargement of the paraxial image for the first half of the real rays; the others go everywhere
MARGIN = 1.25  # enlargement of the target that these need, for a second search
# Share of the light to the detector that a target may leave out; and the same in units of the share of diffuse light
# that goes to the detector: the larger that share, the better rays without a target find the detector
LEFT_OUT, LEFT_TO_RANDOM_RAYS = 1e-3, 0.05
ENOUGH, PLENTY = 50, 400  # rays to the detector that suffice to shape a target in another plane, and any target well
PLANES = np.linspace(-2, 2, 21)  # vergences of other planes, in units of that of the image
BETTER = 2.0  # least ratio of the rays that land by a target in another plane to those by one in the image's


@dataclass(frozen=True)
class Fitted:
    """
    Importance target that was fitted to traced rays, and the fraction of the rays to it that reach the detector.

    Attributes
    ----------
    target : Target
        Flat region that serves as target.
    landed : float
        Fraction of the rays aimed at it that land on the detector by the design path.
    """

    target: Target
    landed: float


class DetectorImages:
    """
    Images of the detector by the surfaces of a design path, as importance targets of scattered light.

    Parameters
    ----------
    path : DesignPath
        Design path to the detector.

    Attributes
    ----------
    paraxial : list of Target
        Paraxial image of the detector in the space before each step of the path; the first is the space of the source.
        An image at infinity is a far target.
    """

    def __init__(self, path: DesignPath) -> None:
        self.path = path
        self.detector = path.end
        points = np.array([step.point for step in path.steps])
        half = np.linalg.norm(self.detector.u) + np.linalg.norm(self.detector.v)
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)) + half)
        self.paraxial = [self._paraxial(number) for number in range(len(path.steps))]

    def _base(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a point, mm, and the unit direction of the base ray before step `number`, (3,) each."""
        return self.path.steps[max(number - 1, 0)].point, self.path.steps[number].before

    def _paraxial(self, number: int) -> Target:
        """Return the paraxial image of the detector, a flat target, in the space before step `number`."""
        start, axis = self._base(number)
        frame = across(axis)
        P, Q, hit = self._derivatives(number, frame)
        square, far = float(np.sum(P * P)), FAR * self.size
        # L = B/A; for astigmatic systems the least-squares solution of Q = L P
        distance = float(np.sum(P * Q)) / square if square > 0 else np.inf
        if abs(distance) > far:
            distance, P = far, Q / far
        # Columns: half axes of the detector on the image plane
        u, v = (frame @ np.linalg.inv(P)).T
        centre = start + distance * axis - frame @ np.linalg.solve(P, hit)
        return Target(self.detector.shape, centre, u, v, hole=self.detector.hole, reverse=bool(distance < 0))

    def _derivatives(self, number: int, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the derivatives of a ray's hit with respect to its shift and slope, and the hit of the base ray.

        Shift and slope are those before step `number`.
        `frame`, (3, 2), has the axes of shift and slope as columns. Hits are in units of the detector's half axes,
        (2,). The derivatives, (2, 2) each, are in 1/mm for the shift, and dimensionless for the slope.
        """
        start, axis = self._base(number)
        step = DIFFERENCE * self.size
        # Central differences: four shifted rays, four tilted ones, and the base ray
        shifts = np.concatenate([frame.T, -frame.T, np.zeros((5, 3))]) * step
        tilts = np.concatenate([np.zeros((4, 3)), frame.T, -frame.T, np.zeros((1, 3))]) * DIFFERENCE
        d = axis + tilts
        hits = self.path.follow(start + shifts, d / np.linalg.norm(d, axis=1, keepdims=True), number)
        half = np.stack([self.detector.u, self.detector.v], axis=1)
        x = (hits - self.detector.centre) @ half / np.sum(half**2, axis=0)
        return (x[0:2] - x[2:4]).T / (2 * step), (x[4:6] - x[6:8]).T / (2 * DIFFERENCE), x[8]

    def fitted(self, number: int, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator) -> Fitted:
        """
        Return the fitted target of light that is scattered at given points into the space before a step of the path.

        It is the paraxial image of the detector, enlarged until it holds nearly all of the light that reaches the
        detector from there by the path: all but `LEFT_OUT`, or but a share that random rays find easily. The image may
        be so close that most rays aimed at it miss the detector. Then a target in another plane replaces it, if
        `BETTER` times more rays land by that. Where no ray reaches the detector, the image itself is returned, with
        `landed` 0.

        Parameters
        ----------
        number : int
            Index of the step.
        points, normals : (n, 3) float64
            Points of the scattering surface (mm), and normals to the side that the light leaves on.
        rng : np.random.Generator
            Random number generator.
        """
        image = self.paraxial[number]
        start, axis = self._base(number)
        distance, far = float((image.centre - start) @ axis), FAR * self.size
        if abs(distance) < NEAR * self.size:  # an image on the surface itself has no direction
            distance = NEAR * self.size
            image = replace(image, centre=start + distance * axis, reverse=False)
        # Target in the plane of the image
        size = SEARCH
        for _ in range(2):  # the second target is close to the final size, so that more rays land
            wide = replace(image, u=size * image.u, v=size * image.v, hole=0.0)
            rays = self._landing_rays(number, wide, points, normals, rng)
            if not len(rays.o):
                return Fitted(image, 0.0)
            at_image = _held(image, rays, start, axis, distance, least=1.0)
            if len(rays.o) > PLENTY:
                break
            size = MARGIN * max(_ratio(at_image.target.u, image.u), _ratio(at_image.target.v, image.v))
        if len(rays.o) < ENOUGH or at_image.landed > 1 / BETTER:
            return at_image
        # Targets in other planes, even in vergence
        vergences = 1 / distance + max(abs(1 / distance), 1 / self.size) * PLANES
        others = [1 / v if abs(v) * far > 1 else far for v in vergences]
        best = max((_held(image, rays, start, axis, other) for other in others), key=lambda fitted: fitted.landed)
        return best if best.landed > BETTER * at_image.landed else at_image

    def _landing_rays(
        self, number: int, wide: Target, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator
    ) -> _Rays:
        """
        Return sampled rays that reach the detector from points of a surface; `number` is the index of the first step.

        Half of the rays tried are aimed at `wide`, half leave as from a Lambertian surface.
        """
        to_image = np.arange(len(points)) % 2 == 0
        aimed = (wide.points(rng.random((len(points), 2))) - points) * (-1 if wide.reverse else 1)
        d = np.where(to_image[:, None], aimed, normals + sphere_points(rng, len(points)))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        cosine = np.einsum("ij,ij->i", d, normals)
        landed = np.flatnonzero(cosine > 0)
        hits = self.path.follow(points[landed], d[landed], number, bounded=True)
        landed = landed[np.isfinite(hits[:, 0])]
        o, d, cosine = points[landed], d[landed], cosine[landed]
        t = ((wide.centre - o) @ wide.normal) / (d @ wide.normal)
        hit = wide.holds(o + t[:, None] * d) & ((t < 0) == wide.reverse)
        # Balance heuristic: Σ n_i pdf_i/n of both techniques, of which each has half of the rays
        density = 0.5 * cosine / np.pi + np.where(hit, 0.5 * t**2 / (wide.area * np.abs(d @ wide.normal)), 0.0)
        return _Rays(o, d, 1 / density, cosine / density, len(points))


@dataclass(frozen=True)
class _Rays:
    """
    Rays that reached the detector, out of `tried` rays sent, in arrays with one entry for each.

    They have origins (mm) and unit directions. Each stands for a solid angle and a projected solid angle (sr), the
    inverse of its density.
    """

    o: np.ndarray
    d: np.ndarray
    solid_angle: np.ndarray
    projected: np.ndarray
    tried: int

    @property
    def covered(self) -> float:
        """Fraction of the rays' projected solid angle that a fitted target must contain."""
        return 1 - max(LEFT_OUT, LEFT_TO_RANDOM_RAYS * float(self.projected.sum()) / (np.pi * self.tried))


def _held(
    image: Target, rays: _Rays, start: np.ndarray, axis: np.ndarray, distance: float, least: float = 0.0
) -> Fitted:
    """
    Return a target moved to a distance, mm, along its line of sight and enlarged until it holds the given rays.

    The distance is from `start` along the unit vector `axis`. Half axes are at least `least` times those of the image.
    `landed` is 0 if the target holds too few of the rays.
    """
    centre = start + distance / float((image.centre - start) @ axis) * (image.centre - start)
    t = ((centre - rays.o) @ axis) / (rays.d @ axis)
    coordinates = np.linalg.pinv(np.stack([image.u, image.v], axis=1)) @ (rays.o + t[:, None] * rays.d - centre).T
    if image.shape == "ellipse":
        size = np.full(2, _quantile(np.hypot(*coordinates), rays.projected, rays.covered))
    else:
        size = np.array([_quantile(np.abs(x), rays.projected, 0.5 + 0.5 * rays.covered) for x in coordinates])
    # Rays at the edge of what lands are the rarer the fewer there are
    size = np.where(size > least, size * (1 + 1 / np.sqrt(len(rays.o))), max(least, 1e-9))
    target = replace(
        image, centre=centre, u=size[0] * image.u, v=size[1] * image.v, hole=0.0, reverse=bool(distance < 0)
    )
    relative = coordinates / size[:, None]
    within = np.hypot(*relative) if image.shape == "ellipse" else np.max(np.abs(relative), axis=0)
    held = (within <= 1) & ((t < 0) == target.reverse)
    if rays.projected[held].sum() < (2 * rays.covered - 1) * rays.projected.sum():
        return Fitted(target, 0.0)
    density = t**2 / (target.area * np.abs(rays.d @ target.normal))
    return Fitted(target, float(np.sum((density * rays.solid_angle)[held]) / rays.tried))


def _ratio(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a) / np.linalg.norm(b))


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """Return the value below which the fraction `share` of the total weight lies."""
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, share * summed[-1])])

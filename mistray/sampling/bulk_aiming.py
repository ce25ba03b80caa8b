"""Where light that a medium scatters should be sent so that it reaches the detector.

- A body on the design path is aimed at the image of the detector by the surfaces that follow.
- Any other body is aimed at what can be seen from within: the detector, and the lenses and mirrors of the design path.
  Backward rays from there, refracted where they enter the body, show where it seems to be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.kernel.targets import Inside, Target
from mistray.sampling.detector_images import FAR, DetectorImages
from mistray.sampling.scattering_bodies import Body
from mistray.surfaces.host_points import across
from mistray.surfaces.host_rays import first_hit, onward
from mistray.surfaces.surfaces import SurfaceTable

PATH_RAYS = 4096  # from a body on the design path, that show how large the image must be
SIGHT_RAYS = 4096  # backwards, from what a body may see
MOST_SURFACES = 6  # between the two
LEAST_SEEN = 16  # rays of a target through one surface
LANDED = 0.02  # share of the rays to an image that must land on the detector
MOST_TARGETS = 4
PLANES = np.linspace(-2, 2, 33)  # vergences of planes, in units of that in which the rays are closest

Sight = tuple[Target, int]
"""What may be seen, and the number of its surface; -1: none."""


def body_targets(
    table: SurfaceTable, body: Body, images: DetectorImages | None, sights: Sequence[Sight], rng: np.random.Generator
) -> list[Target]:
    """
    Targets of the light that a body scatters.

    Parameters
    ----------
    table : SurfaceTable
    body : Body
    images : DetectorImages, optional
        Of the design path.
    sights : sequence of Sight
        For a body that is not on the path, what counts most first.
    rng : np.random.Generator
    """
    found = []
    steps = images.path.steps if images else ()
    for number, step in enumerate(steps):
        ends = {Inside(step.surface, not step.from_front)}
        if number:
            ends.add(Inside(steps[number - 1].surface, steps[number - 1].to_back))
        if images is not None and not ends.isdisjoint(body.sides):
            points = body.points[rng.integers(len(body.points), size=PATH_RAYS)]
            fitted = images.fitted(number, points, np.tile(step.before, (PATH_RAYS, 1)), rng)
            if fitted.landed > LANDED:
                found.append(fitted.target)
    if not found:
        found = [target for sight in sights for target in _apparent(table, body, *sight, rng)]
    return found[:MOST_TARGETS]


def _apparent(table: SurfaceTable, body: Body, sight: Target, surface: int, rng: np.random.Generator) -> list[Target]:
    """A target as it is seen from within a body, once through each surface of the body."""
    o = sight.points(rng.random((SIGHT_RAYS, 2)))
    d = body.points[rng.integers(len(body.points), size=SIGHT_RAYS)] - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    last = np.full(SIGHT_RAYS, surface)
    lines: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    for _ in range(MOST_SURFACES):
        hit, p, normal = first_hit(table, o, d, last)
        from_front = np.einsum("ij,ij->i", d, normal) > 0
        arrives = [
            Inside(s, not front) in body.faces for s, front in zip(hit.tolist(), from_front.tolist(), strict=True)
        ]
        for entry in np.unique(last[arrives]):
            own = np.array(arrives) & (last == entry)
            lines.setdefault(int(entry), []).append((o[own], -d[own]))
        going = (hit >= 0) & ~np.array(arrives)
        after, _ = onward(table, hit[going], d[going], normal[going])
        whole = np.isfinite(after[:, 0])
        o, d, last = p[going][whole], after[whole], hit[going][whole]
        if not len(o):
            break
    found = []
    for entry, parts in lines.items():
        points, directions = (np.concatenate([part[k] for part in parts]) for k in range(2))
        if len(points) < LEAST_SEEN:
            continue
        if entry == surface:  # seen as it is
            found.append((len(points), sight))
        else:
            target = _holding(points, directions, body.points)
            found += [] if target is None else [(len(points), target)]
    return [target for _, target in sorted(found, key=lambda entry: -entry[0])]


def _holding(points: np.ndarray, directions: np.ndarray, within: np.ndarray) -> Target | None:
    """
    The ellipse that all of some rays pass and that fills the least solid angle as seen from points of a body.

    Parameters
    ----------
    points, directions : (n, 3) float64
        Where the rays leave the body (mm), and unit directions in which they leave it.
    within : (m, 3) float64
        Points of the body, mm.
    """
    axis = directions.mean(axis=0)
    axis /= np.linalg.norm(axis)
    ahead = directions @ axis
    if not np.all(ahead > 0):
        return None
    middle, frame = points.mean(axis=0), across(axis)
    height = (points - middle) @ axis
    slopes = directions @ frame / ahead[:, None]
    places = (points - middle) @ frame - height[:, None] * slopes  # in the plane through the middle
    depth = (within - middle) @ axis
    size = float(np.linalg.norm(np.ptp(within, axis=0)))
    spread = float(np.sum(np.var(slopes, axis=0)))
    together = -float(np.sum((places - places.mean(axis=0)) * (slopes - slopes.mean(axis=0)))) / len(points)
    far = FAR * size
    closest = together / spread if spread > abs(together) / far else np.copysign(far, together)
    best: tuple[float, Target] | None = None
    for vergence in 1 / closest + max(abs(1 / closest), 1 / size) * PLANES if closest else 1 / size * PLANES:
        distance = 1 / vergence if abs(vergence) * far > 1 else far
        # A plane through the body has points of it on both sides
        if depth.min() <= distance <= depth.max():
            continue
        crossings = places + distance * slopes
        centre = crossings.mean(axis=0)
        _, _, turned = np.linalg.svd(crossings - centre, full_matrices=False)
        along = (crossings - centre) @ turned.T
        half = np.maximum(np.abs(along).max(axis=0), 1e-6 * abs(distance))
        half *= np.hypot(*(along / half).T).max() * (1 + 1 / np.sqrt(len(points)))
        u, v = (half[:, None] * turned) @ frame.T
        target = Target(
            "ellipse", middle + distance * axis + frame @ centre, u, v, reverse=bool(distance < depth.min())
        )
        solid_angle = float(np.mean(target.area / (distance - depth) ** 2))
        if best is None or solid_angle < best[0]:
            best = solid_angle, target
    return best[1] if best else None

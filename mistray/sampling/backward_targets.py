"""
Importance targets of a backward trace: the directions in which rays should be sent so that they leave the scene.

- The *opening* is where the light enters: the disc, at the front of the scene, through which the first surface of the
  design path (or the detector, where there is none) sees the outside.
- Rays that leave a surface of the backward design path, and rays that start on the detector, are aimed at the image of
  the opening by the surfaces that follow. Rays from any other surface are aimed at what they see of the opening and,
  from behind, of lenses and mirrors. This is `automatic_targets` for the reversed design path.
- From a side that sees much of the sky itself, rays are aimed at the sky. Its targets are discs so far away and so
  large that all field angles get a share.

Targets change the variance of a result but not its expectation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.cache.remembered import remembered
from mistray.kernel.targets import AimSet, Place, Side, Target
from mistray.sampling.design.probes import DesignStep
from mistray.sampling.design_path import OPENING, DesignPath, find_design_path
from mistray.sampling.detector_images import FAR, DetectorImages
from mistray.sampling.importance_targets import (
    SEARCH_SHARE,
    automatic_bulk_targets,
    automatic_targets,
    signature,
)
from mistray.sampling.kept_targets import kept_targets, read, read_list, written, written_list
from mistray.settings import Settings
from mistray.surfaces.host_points import across, box_corners, lambertian_directions, surface_points
from mistray.surfaces.host_rays import first_hit, onward
from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable, solid_shapes
from mistray.time_budget import fewer_rays, share

PROBES = 2048  # rays that search for the opening
SKY_PROBES = 256  # rays that search for the sky
VIEW_PROBES, MOST_STEPS = 128, 40  # rays that search for it through optics, and hits of each
CONES_DEG = (80.0, 20.0, 5.0, 1.0)  # field angles up to which the opening is sought
OPEN = 0.2  # share of a side's rays that must see the sky for the sky to be its target
SKY_DEG = (10.0, 35.0, 80.0)  # field angles up to which the discs of the sky reach
LANDED = 0.02  # share of the rays to an image of the opening that must leave by it

_known: dict[str, BackwardTargets] = {}


@dataclass(frozen=True)
class BackwardTargets:
    """
    Importance targets of a backward trace, and the fractions of rays by which surfaces see the sky.

    Attributes
    ----------
    aims : dict
        Targets by place of scatter.
    start : AimSet or None
        Targets of the rays that start on the detector, towards the light; None: they are not aimed.
    light : (3,) float64 or None
        Unit direction of the design path's light at the detector; None: there is no design path.
    views : dict
        For each surface that transmits or is a mirror, by its index, the fraction of Lambertian rays that leave the
        scene backward by refraction and by reflection at mirrors, from the side with more of them.
    """

    aims: dict[Place, AimSet]
    start: AimSet | None
    light: np.ndarray | None
    views: dict[int, float]

    def written(self) -> dict[str, Any]:
        """Return the targets and fractions as JSON values; the numbers of rays, which are 1, are left out."""
        return {
            "aims": written({place: aim.targets for place, aim in self.aims.items()}),
            "start": written_list(self.start.targets if self.start else ()),
            "light": None if self.light is None else self.light.tolist(),
            "views": [[surface, share] for surface, share in self.views.items()],
        }

    @classmethod
    def read(cls, content: Any) -> BackwardTargets:
        """Return the targets that `written` wrote; raise ValueError, TypeError or KeyError for other content."""
        aims, start, light = read(content["aims"]), read_list(content["start"]), content["light"]
        return cls(
            {place: AimSet.of(targets, 1) for place, targets in aims.items()},
            AimSet.of(start, 1) if start else None,
            None if light is None else np.array(light),
            {int(surface): float(share) for surface, share in content["views"]},
        )


def backward_targets(table: SurfaceTable, scene: mi.Scene, settings: Settings, axis: np.ndarray) -> BackwardTargets:
    """
    Return the importance targets of backward rays, for all surfaces and media that scatter and for the detector.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    scene : mi.Scene
        Loaded scene.
    settings : Settings
        Uses `aim` and `aimed_rays`; no ray is aimed unless `aim` is "auto" and `aimed_rays` is above 0.
    axis : (3,) float64
        Unit direction of light at field angle 0.
    """
    # A scene is traced many times; the cached targets have one ray each, as settings may differ
    scatterers = [i for i in range(table.count) if table.interfaces[i].scatter]
    key = signature(table, scene, scatterers) + repr(np.round(axis, 9).tolist())
    found = remembered(
        _known,
        key,
        lambda: kept_targets(
            scene,
            scatterers,
            f"{key} backward",
            lambda: _find(table, scene, scatterers, axis),
            BackwardTargets.written,
            BackwardTargets.read,
        ),
    )
    if settings.aim != "auto" or not settings.aimed_rays:
        return replace(found, aims={}, start=None)
    return replace(found, aims={place: replace(aim, rays=settings.aimed_rays) for place, aim in found.aims.items()})


@share(SEARCH_SHARE)
def _find(table: SurfaceTable, scene: mi.Scene, scatterers: list[int], axis: np.ndarray) -> BackwardTargets:
    """Return the `BackwardTargets` of a scene by probe rays; `axis` is the unit direction of light at field angle 0."""
    # Opening of the system
    rng = np.random.default_rng(0)
    path = find_design_path(table, scene)
    opening = find_opening(table, scene, path, axis, rng)
    found: dict[Place, list[Target]] = {}
    start = back = None
    if opening is not None:
        # Targets by the reversed design path, of surfaces and of the detector
        if path is not None:
            back = path.reversed(opening)
        else:  # straight from the detector to the opening
            out = DesignStep(OPENING, False, opening.centre, -axis, -axis, np.zeros(3))
            back = DesignPath(table, (out,), opening)
        found = automatic_targets(table, back, scatterers)
        points, normals = surface_points(table, table.detector, fewer_rays(PROBES), rng)
        towards = normals * np.sign(normals @ back.steps[0].before)[:, None]
        fitted = DetectorImages(back).fitted(0, points, towards, rng)
        start = AimSet.of([fitted.target], 1) if fitted.landed > LANDED else None
    # The sky replaces them on sides that are open to it
    far = sky_discs(scene, axis)
    found |= {side: far for side, share in _sky_shares(table, scatterers, axis, rng).items() if share > OPEN}
    found |= automatic_bulk_targets(table, back, far)
    # Views of the sky by optics, from which the branch probabilities follow
    words = table.optics.host_words
    views = _views(table, [i for i in range(table.count) if not words[i] & OPAQUE or words[i] & MIRROR], axis, rng)
    light = path.steps[-1].before if path is not None else None
    aims = {place: AimSet.of(targets, 1) for place, targets in found.items()}
    return BackwardTargets(aims, start, light, views)


def find_opening(
    table: SurfaceTable, scene: mi.Scene, path: DesignPath | None, axis: np.ndarray, rng: np.random.Generator
) -> Target | None:
    """
    Return the disc at the front of the scene through which outside light reaches the path's first surface.

    Without a path the detector takes the place of that surface. The result is None if no probe ray gets out, or all
    leave at one point. `axis` is the unit direction of light at field angle 0.
    """
    first = path.steps[0].surface if path is not None else table.detector
    points, _ = surface_points(table, first, PROBES, rng)
    # Position along the axis of the front of the scene
    along = box_corners(shape.bbox() for shape in solid_shapes(scene)) @ axis
    frame, front = across(axis), float(along.min() - 1e-3 * np.ptp(along))
    through = []
    for widest in CONES_DEG:  # a distant opening is missed by most rays of a wide cone
        cosine = rng.uniform(np.cos(np.radians(widest)), 1.0, PROBES)
        phi = rng.uniform(0.0, 2 * np.pi, PROBES)
        aside = np.sqrt(1 - cosine**2)[:, None] * (np.stack([np.cos(phi), np.sin(phi)], axis=1) @ frame.T)
        d = aside - cosine[:, None] * axis
        free = first_hit(table, points, d, np.full(PROBES, first))[0] < 0
        t = np.maximum((points[free] @ axis - front) / cosine[free], 0.0)
        through.append(points[free] + t[:, None] * d[free])
    # Circle around the points at which free rays cross the front plane
    p = np.concatenate(through)
    if not len(p):
        return None
    middle = 0.5 * (p.max(axis=0) + p.min(axis=0))
    middle += (front - middle @ axis) * axis
    radius = float(np.max(np.linalg.norm(p - middle - ((p - middle) @ axis)[:, None] * axis, axis=1)))
    if radius == 0:
        return None
    u, v = radius * frame.T
    return Target("ellipse", middle, u, v)


def sky_discs(scene: mi.Scene, axis: np.ndarray) -> list[Target]:
    """
    Return flat target discs far away that stand for the sky, one for each angular radius in `SKY_DEG`, degrees.

    They are where light along the unit vector `axis` comes from.
    """
    corners = box_corners(shape.bbox() for shape in solid_shapes(scene))
    distance = FAR * float(np.linalg.norm(corners[-1] - corners[0]))
    frame = across(axis)
    centre = corners.mean(axis=0) - distance * axis
    return [Target("ellipse", centre, *(distance * np.tan(np.radians(angle)) * frame.T)) for angle in SKY_DEG]


def _lambertian_rays(
    table: SurfaceTable, surfaces: list[int], count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return `count` Lambertian rays per side of each surface, front first: origins, mm, directions, (s, 2, n, 3)."""
    o, d = (np.zeros((len(surfaces), 2, count, 3)) for _ in range(2))
    for row, surface in enumerate(surfaces):
        o[row], normals = surface_points(table, surface, count, rng)
        for side, sign in enumerate((-1.0, 1.0)):
            d[row, side] = lambertian_directions(sign * normals, rng)
    return o, d


def _sky_shares(
    table: SurfaceTable, surfaces: list[int], axis: np.ndarray, rng: np.random.Generator
) -> dict[Side, float]:
    """
    Return the fraction of Lambertian rays from each side of surfaces that leave against `axis` without a hit.

    `axis` is the unit direction of light at field angle 0; all rays at more than 90° to it leave against it.
    """
    probes = fewer_rays(SKY_PROBES)
    o, d = _lambertian_rays(table, surfaces, probes, rng)
    last = np.repeat(surfaces, 2 * probes)
    hit, _, _ = first_hit(table, o.reshape(-1, 3), d.reshape(-1, 3), last)
    free = (hit.reshape(d.shape[:3]) < 0) & (d @ axis < 0)
    shares = free.mean(axis=2)
    return {(surface, bool(side)): shares[row, side] for row, surface in enumerate(surfaces) for side in (0, 1)}


def _views(table: SurfaceTable, surfaces: list[int], axis: np.ndarray, rng: np.random.Generator) -> dict[int, float]:
    """
    Return, by surface index, the fraction of Lambertian rays that leave the scene against `axis` by specular events.

    The fraction is that of the side with more of them; `axis` is that of `_sky_shares`.
    """
    probes = fewer_rays(VIEW_PROBES)
    start, along = _lambertian_rays(table, surfaces, probes, rng)
    o, d, last = start.reshape(-1, 3), along.reshape(-1, 3), np.repeat(surfaces, 2 * probes)
    side, gone = np.repeat(np.arange(2 * len(surfaces)), probes), np.zeros(2 * len(surfaces))
    for _ in range(MOST_STEPS):
        if not len(o):
            break
        hit, p, normal = first_hit(table, o, d, last)
        # The light has a positive component along the axis, so that backward rays leave with a negative one
        gone += np.bincount(side[(hit < 0) & (d @ axis < 0)], minlength=len(gone))
        met = np.flatnonzero(hit >= 0)
        after, _ = onward(table, hit[met], d[met], normal[met])
        goes = np.isfinite(after[:, 0])
        on = met[goes]
        o, d, last, side = p[on], after[goes], hit[on], side[on]
    best = gone.reshape(-1, 2).max(axis=1) / probes
    return dict(zip(surfaces, best.tolist(), strict=True))

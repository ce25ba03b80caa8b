"""
Importance targets: the directions in which surfaces should scatter light so that it reaches the detector.

- Light that leaves a surface of the design path towards the detector is aimed at the image of the detector.
- Light that leaves any other surface is aimed at what can be seen from there. This is the detector, and each lens and
  mirror of the design path from the side on which the design has its light. Where rays reach the detector by that lens
  or mirror, they are aimed at the image that it forms of the detector, else at its aperture.
- A side that sees none of these, but other surfaces that transmit, is aimed at what it sees through them: a window
  through its other faces, see `mistray.sampling.bulk_aiming`.
- Light that a surface of the design path scatters backwards is not aimed.
- Light that a medium scatters is aimed likewise, see `mistray.sampling.bulk_aiming`.
- A surface that a shape with a ``target`` names has those targets and no others. So have the media on its sides, for
  light that they scatter on its way to the surface.

Random rays cover all other directions, so that targets change the variance of a result but not its expectation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mistray.cache.remembered import remembered
from mistray.kernel.targets import AimSet, Inside, Place, Side, Target
from mistray.sampling.bulk_aiming import Appearance, Sight, apparent, arrivals, body_targets, scattering_bodies
from mistray.sampling.design_path import OPENING, DesignPath, find_design_path
from mistray.sampling.detector_images import DetectorImages
from mistray.sampling.kept_targets import kept_targets, read, written
from mistray.sampling.outlines import outline
from mistray.sampling.scene_targets import scene_targets
from mistray.settings import Settings
from mistray.surfaces.host_points import lambertian_directions, surface_points
from mistray.surfaces.host_rays import first_hit, onward
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import fewer_rays, share, time_is_up

PATH_POINTS, SEEN_POINTS = 4096, 1024  # points of a surface from which rays to the image are tried
PROBES, DETECTOR_PROBES = 16, 256  # rays from a surface that test whether a lens, or the detector, can be seen
THROUGH_PROBES = 64  # rays that test whether something can be seen through other surfaces
SEEN, DETECTOR_SEEN = 0.04, 0.005  # share of them that must see it
SECOND_WAY = 0.25  # of two ways to the same sight, one with less than this share of the rays of the other is dropped
LANDED = 0.02  # share of the rays to an image that must land on the detector
MOST_TARGETS = 4
SEARCH_SHARE = 0.2  # share of a time budget after which the search for images ends

_OF_SOURCES = ("matrix", "size", "plane", "distance", "field_deg", "azimuth_deg", "values")
_known: dict[str, dict[Place, list[Target]]] = {}
_known_sets: dict[str, dict[Place, AimSet]] = {}  # of the same targets, by numbers of aimed rays


def importance_targets(table: SurfaceTable, scene: mi.Scene, settings: Settings) -> dict[Place, AimSet]:
    """
    Return the importance targets of all surfaces and media that scatter: those of the scene and automatic ones.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    scene : mi.Scene
        Loaded scene.
    settings : Settings
        Uses `aim` ("none": no targets, "targets": only those of the scene) and `aimed_rays` (0: no automatic ones).

    Returns
    -------
    dict
        Targets by place of scatter; from places without an entry no ray is aimed.
    """
    # Targets that the scene defines
    scatterers = [i for i in range(table.count) if table.interfaces[i].scatter]
    if settings.aim == "none" or not (scatterers or table.optics.scatters):
        return {}
    given = scene_targets(table, scene)
    found: dict[Place, AimSet] = {}
    for sets in given.values():
        found |= sets
    rest = [surface for surface in scatterers if surface not in given]
    if settings.aim == "targets" or not settings.aimed_rays:
        return found
    # Automatic targets of the other surfaces, from the cache if the scene has been traced before
    key, rays = signature(table, scene, rest), settings.aimed_rays
    automatic = remembered(
        _known, key, lambda: kept_targets(scene, rest, key, lambda: _of_detectors(table, scene, rest), written, read)
    )

    def automatic_sets() -> dict[Place, AimSet]:
        return {place: AimSet.of(targets, rays) for place, targets in automatic.items()}

    for place, aim in remembered(_known_sets, f"{key} {rays}", automatic_sets).items():
        if (place.surface if isinstance(place, Inside) else place[0]) not in given:
            found[place] = aim
    return found


def signature(table: SurfaceTable, scene: mi.Scene, surfaces: Sequence[int]) -> str:
    """
    Return a hash of the surfaces, films and sources of a scene, as part of the keys of caches; coatings are left out.

    Importance targets and the medium outside of the scene depend on nothing else that matters: a target that misses a
    change raises only the variance. `surfaces` are the indices of those that the cached result is for.
    """
    of_table = remembered(table.kept, "signature", lambda: _table_facts(table))
    films = [table.film(detector) for detector in table.detectors]
    return hashlib.sha256(repr((of_table, films, source_facts(scene), tuple(surfaces))).encode()).hexdigest()


def source_facts(scene: mi.Scene) -> str:
    """Return the attributes `_OF_SOURCES` of the sources of a scene, as text; "" where one has no such attribute."""
    facts = [getattr(emitter, key, "") for emitter in scene.emitters() for key in _OF_SOURCES]
    return repr([fact.tobytes() if isinstance(fact, np.ndarray) else fact for fact in facts])


def _table_facts(table: SurfaceTable) -> str:
    """Return a hash of the places, shapes and materials of all surfaces, for `signature`."""
    facts = [
        *((shape.id(), str(shape.bbox()), str(getattr(shape, "values", ""))) for shape in table.shapes),
        *(getattr(shape, "coefficients", "") for shape in table.shapes),
        table.vertices.tobytes(),
        table.rotations.tobytes(),
        table.optics.host_indices.tobytes(),
        table.optics.host_words.tobytes(),
        table.optics.host_scattering.tobytes(),
        np.array(table.optics.extinction).tobytes(),
        table.optics.mostly_reflects.tobytes(),
        table.mitsuba_hash,
    ]
    return hashlib.sha256(repr(facts).encode()).hexdigest()


@share(SEARCH_SHARE)
def _of_detectors(table: SurfaceTable, scene: mi.Scene, surfaces: Sequence[int]) -> dict[Place, list[Target]]:
    """Return the automatic importance targets towards every detector, by the surface side or medium that scatters."""
    found: dict[Place, list[Target]] = {}
    for detector in table.detectors:
        view = table.on(detector)
        path = find_design_path(view, scene)
        own = automatic_targets(view, path, surfaces) | automatic_bulk_targets(view, path)
        for place, targets in own.items():
            found.setdefault(place, []).extend(targets)
    return found


def automatic_bulk_targets(
    table: SurfaceTable, path: DesignPath | None, sky: Sequence[Target] = ()
) -> dict[Place, list[Target]]:
    """
    Return the automatic importance targets of media that scatter, by surface side at which a segment ends.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    path : DesignPath, optional
        See `automatic_targets`.
    sky : sequence of Target
        In a backward trace, the targets of a body that is not on the path; (): those that it sees of the path.

    Returns
    -------
    dict
        Targets by `Inside`, a surface and its side; empty where no medium scatters.
    """
    if not table.optics.scatters:
        return {}
    rng = np.random.default_rng(0)
    images = DetectorImages(path) if path else None
    # For a body off the path, the end of the path is the most important sight
    *optics, end = _sights(table, path)
    sights = [Sight(target, -1) for target in sky] or [end, *optics]
    found: dict[Place, list[Target]] = {}
    for body in scattering_bodies(table):
        targets = body_targets(table, body, images, sights, rng)
        found |= dict.fromkeys(body.sides, targets) if targets else {}
    return found


def _sights(table: SurfaceTable, path: DesignPath | None) -> list[Sight]:
    """Return the surfaces of the design path and its end as sights to aim at; without a path, the detector alone."""
    if path is None:
        return [Sight(outline(table.shapes[table.detector]), table.detector)]
    *steps, end = path.steps
    before = [Sight(outline(table.shapes[step.surface]), step.surface, step.before) for step in steps]
    return [*before, Sight(path.end, end.surface)]


def automatic_targets(
    table: SurfaceTable, path: DesignPath | None, surfaces: Sequence[int]
) -> dict[Place, list[Target]]:
    """
    Return the automatic importance targets of surfaces that scatter, by side; sides without any are left out.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    path : DesignPath, optional
        Path to the detector, or backward to the opening; None: only the detector itself is a target.
    surfaces : sequence of int
        Indices of the surfaces that scatter.
    """
    # Surfaces on the path: images of its end, for each step at which they meet the light
    images = DetectorImages(path) if path else None
    on_path = {step.surface for step in path.steps} if path else {table.detector}
    found: dict[Place, list[Target]] = {}
    rng = np.random.default_rng(0)
    for surface in surfaces:
        if images and surface in on_path:
            points, normals = surface_points(table, surface, fewer_rays(PATH_POINTS), rng)
            for number, step in enumerate(images.path.steps[:-1], start=1):
                if step.surface == surface:
                    outward = normals if step.to_back else -normals
                    target = images.fitted(number, points, outward, rng).target
                    found.setdefault((surface, step.to_back), []).append(target)
    # Surfaces off the path
    others = [surface for surface in surfaces if surface not in on_path]
    return found | _seen_targets(table, images, others, rng)


def _seen_targets(
    table: SurfaceTable, images: DetectorImages | None, surfaces: Sequence[int], rng: np.random.Generator
) -> dict[Side, list[Target]]:
    """
    Return, for each side of surfaces, the targets visible from it: detector, lenses and mirrors of the path.

    `images` are those of the detector by the surfaces of the path; None: there is no path.
    """
    if not surfaces:
        return {}
    # Test all views at once
    sights = _sights(table, images.path if images else None)
    last, end = len(sights) - 1, sights[-1].surface
    sampled = {
        surface: surface_points(table, surface, max(fewer_rays(SEEN_POINTS), DETECTOR_PROBES), rng)
        for surface in surfaces
    }
    views: list[tuple[Side, int]] = [
        ((surface, to_back), number)
        for surface in surfaces
        for to_back in (False, True)
        for number in range(len(sights))
    ]
    seen = _seen(table, images, views, sights, sampled, rng)
    # Views that are open enough: the image by the lens or mirror if rays land by it, else its aperture
    found: dict[Side, list[tuple[float, int, Target]]] = {}
    for (side, number), part in zip(views, seen, strict=True):
        target, direct = sights[number].target, number == last
        if part < (DETECTOR_SEEN if direct else SEEN):
            continue
        if images and not direct and not time_is_up():
            points, normals = sampled[side[0]]
            image = images.fitted(number, points, normals if side[1] else -normals, rng)
            if image.landed > LANDED:
                found.setdefault(side, []).append((part, number, image.target))
                if end != OPENING:
                    continue
                # Backward rays may also leave by that lens past the opening
        # Adding 1 ranks the detector itself first
        found.setdefault(side, []).append((part + direct, number, target))
    # Views through other surfaces; they replace a direct view with far fewer rays
    passing = _passing(table, [sight.surface for sight in sights], surfaces, sampled, rng)
    for row, shares in enumerate(seen.reshape(-1, len(sights))):
        if time_is_up():
            break
        if passing[row] < SEEN:
            continue
        side = surfaces[row // 2], bool(row % 2)
        through = _seen_through(table, side, sights, shares, sampled[side[0]], rng)
        best = {one.number: one.share for one in reversed(through)}
        entries = [entry for entry in found.pop(side, []) if shares[entry[1]] >= SECOND_WAY * best.get(entry[1], 0.0)]
        entries += [(one.share + (one.number == last), one.number, one.target) for one in through]
        if entries:
            found[side] = entries
    return {
        side: [target for _, _, target in sorted(entries, key=lambda entry: -entry[0])[:MOST_TARGETS]]
        for side, entries in found.items()
    }


def _passing(
    table: SurfaceTable,
    own: Sequence[int],
    surfaces: Sequence[int],
    sampled: dict[int, tuple[np.ndarray, np.ndarray]],
    rng: np.random.Generator,
) -> np.ndarray:
    """
    Return the fraction of rays from both sides of surfaces, front first, (2 s,), that go on at a surface not in `own`.

    `sampled` has points and normals by surface, see `_seen_through`. All sides are tested at once, which takes a fifth
    of the time of one after the other.
    """
    o, normals = (
        np.repeat(np.stack([sampled[surface][k][:THROUGH_PROBES] for surface in surfaces]), 2, axis=0) for k in (0, 1)
    )
    normals[::2] *= -1
    d = lambertian_directions(normals.reshape(-1, 3), rng)
    last = np.repeat(surfaces, 2 * o.shape[1])
    hit, _, normal = first_hit(table, o.reshape(-1, 3), d, last)
    goes = (hit >= 0) & ~np.isin(hit, own)
    after, _ = onward(table, hit[goes], d[goes], normal[goes])
    goes[goes] = np.isfinite(after[:, 0])
    return goes.reshape(o.shape[:2]).mean(axis=1)


def _seen_through(
    table: SurfaceTable,
    side: Side,
    sights: Sequence[Sight],
    shares: np.ndarray,
    sampled: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
) -> list[Appearance]:
    """
    Return targets that one side of a surface sees through surfaces that are not sights, such as a window's other face.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    side : Side
        Index of the surface, and whether the side is its back.
    sights : sequence of Sight
        Surfaces and openings that are targets where they can be seen.
    shares : (n,) float64
        Fraction of the rays to each sight that arrive directly. Views through other surfaces are dropped where
        far fewer rays arrive.
    sampled : tuple
        Points of the surface, mm, and unit normals, (k, 3) each.
    rng : np.random.Generator
        Random number generator.
    """
    # Rays from the sights to the surface, by the surfaces on their way
    (surface, to_back), (points, _) = side, sampled
    own = [sight.surface for sight in sights]
    ends, least = {Inside(surface, to_back)}, np.maximum(SECOND_WAY * shares, SEEN)
    ways = arrivals(table, points, ends, sights, THROUGH_PROBES, rng)
    enough = [way for way, (o, _) in ways.items() if len(o) > THROUGH_PROBES * least[way[0]]]
    numbers = sorted({way[0] for way in enough if way[-1] not in own})
    if not numbers:
        return []
    found = apparent(table, points, ends, [sights[number] for number in numbers], rng)
    return [one._replace(number=numbers[one.number]) for one in found if one.by not in own]


def _seen(
    table: SurfaceTable,
    images: DetectorImages | None,
    views: Sequence[tuple[Side, int]],
    sights: Sequence[Sight],
    sampled: dict[int, tuple[np.ndarray, np.ndarray]],
    rng: np.random.Generator,
) -> np.ndarray:
    """
    Return the fraction, (views,), of each view's rays that reach its sight from the side that the design uses.

    A view is a surface side and the index of the sight that rays from it go to. `sampled` is as in `_passing`.
    """
    # Rays of all views in one array
    sides, numbers = zip(*views, strict=True)
    rays = [DETECTOR_PROBES if number == len(sights) - 1 else PROBES for number in numbers]
    origins = np.concatenate([sampled[surface][0][:count] for (surface, _), count in zip(sides, rays, strict=True)])
    outward = np.concatenate(
        [
            sampled[surface][1][:count] * (1 if to_back else -1)
            for (surface, to_back), count in zip(sides, rays, strict=True)
        ]
    )
    ends = np.concatenate(
        [sights[number].target.points(rng.random((count, 2))) for number, count in zip(numbers, rays, strict=True)]
    )
    d = (ends - origins) / np.linalg.norm(ends - origins, axis=1, keepdims=True)
    which = np.repeat(np.arange(len(views)), rays)
    surface = np.array([surface for surface, _ in sides])[which]
    requested = np.full(len(d), table.detector)
    goes = np.einsum("ij,ij->i", d, outward) > 0
    if images:
        steps = [images.path.steps[number] for number in numbers]
        requested = np.array([step.surface for step in steps])[which]
        from_front = np.array([step.from_front for step in steps])[which]
        goes &= np.einsum("ij,ij->i", d, np.array([step.before for step in steps])[which]) > 0
    # Those that head for the right side of the surface of a step
    some = np.flatnonzero(goes)
    hit, _, normal = first_hit(table, origins[some], d[some], surface[some])
    arrives = hit == requested[some]
    if images:
        arrives &= (hit == OPENING) | ((np.einsum("ij,ij->i", d[some], normal) > 0) == from_front[some])
    return np.bincount(which[some[arrives]], minlength=len(views)) / rays

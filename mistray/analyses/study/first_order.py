"""First-order data of an optical system, from real rays: focal length, aperture, field, and aperture stop.

The system may be folded or tilted: all quantities refer to its base ray, the path of the ray in the middle of the beam
(see `mistray.sampling.design_path`). Derivatives along it are differences of rays in float64.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.sampling.design_path import DesignPath
from mistray.sampling.outlines import outline
from mistray.sampling.source import SceneSource
from mistray.sampling.sources import scene_sources
from mistray.surfaces.host_points import across
from mistray.trace.host.design_light import media

STEP = 1e-5  # height of the rays for derivatives, in units of the beam's size
AFOCAL = 1e-9  # slope per unit of height, in units of 1/size, below which the system has no focus
AZIMUTHS = 24  # directions in which the edge of the entrance pupil is looked for
OFFSET = 0.1  # of the first direction, rad, so that none lies along a vane that is parallel to x or y
RADII = 96  # radii in each of them; an obstruction or an aperture narrower than that may be missed
HALVINGS = 10  # of the distance of two radii, to find the edge between them
LOOKS, PROBES = 48, 72  # rays along a side of a grid that finds the light, and of one about this light for its area
FINE = 4800  # azimuths at which the area between the edges is summed
LARGEST_FIELD_DEG = 89.0


@dataclass(frozen=True, kw_only=True)
class FirstOrder:
    """
    First-order data of a system at one wavelength: focal length, pupil, field.

    Attributes
    ----------
    wavelength_nm : float
        Wavelength, nm.
    focal_length_mm : float
        Rear effective focal length, mm, the mean of both sections; positive if the image is upside down; ``inf`` if
        afocal.
    focal_lengths_mm : (float, float)
        Focal lengths in the two sections along the base ray, mm.
    back_focus_mm : float
        Distance from the last surface before the detector to the paraxial focus, along the base ray, mm; ``inf`` if
        afocal.
    defocus_mm : float
        Distance from the paraxial focus to the detector, along the base ray, mm; NaN if afocal.
    pupil_diameter_mm : float
        Diameter of the disc of the same area as the entrance pupil on axis, obstruction included, mm; NaN if nothing
        passes.
    pupil_area_mm2 : float
        Free area of the entrance pupil on axis, mm²: cross-section of the light that reaches the detector by the design
        path, by a grid of rays: good to some 0.1 %.
    stop : str
        Id of the surface that blocks the light just outside the pupil; "-" if there is none.
    f_number : float
        Working F-number of the image, 1/(2 n sin u); ``inf`` if afocal, NaN if no such light arrives. n is the index
        before the detector, and u the angle there between the light from the edge of the pupil and the base ray.
    field_deg : dict
        Field angles, degrees, that move the base ray on the detector by half of its width ("x"), of its height ("y") or
        of its diagonal ("diagonal"), to its edges and corner if the ray at 0° meets its middle. NaN if there is none
        below 89°. For a round detector all are the same.
    near : bool
        Whether the object is near; the pupil is then that of a point, in the plane of the origin of its frame.
    """

    wavelength_nm: float
    focal_length_mm: float
    focal_lengths_mm: tuple[float, float]
    back_focus_mm: float
    defocus_mm: float
    pupil_diameter_mm: float
    pupil_area_mm2: float
    stop: str
    f_number: float
    field_deg: dict[str, float]
    near: bool = False


def first_order(scene: Any, path: DesignPath) -> FirstOrder:
    """
    Return the first-order data of a system at one wavelength.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    path : DesignPath
        Design path of the scene, see `mistray.sampling.design_path.find_design_path`.
    """
    lengths, back = _focus(path)
    finite = [value for value in lengths if math.isfinite(value)]
    focal = float(np.mean(finite)) if finite else math.inf
    last, detector = path.steps[-2] if len(path.steps) > 1 else path.steps[-1], path.steps[-1]
    to_detector = float(np.linalg.norm(detector.point - last.point))
    diameter, area, stop = _pupil(scene, path)
    return FirstOrder(
        wavelength_nm=path.table.wavelength_nm,
        focal_length_mm=focal,
        focal_lengths_mm=lengths,
        back_focus_mm=back,
        defocus_mm=to_detector - back if math.isfinite(back) else math.nan,
        pupil_diameter_mm=diameter,
        pupil_area_mm2=area,
        stop=stop,
        f_number=_working_f_number(scene, path, diameter / 2) if math.isfinite(focal) else math.inf,
        field_deg=_field(scene, path),
        near=scene_sources(scene)[0].middle is None,
    )


def _focus(path: DesignPath) -> tuple[tuple[float, float], float]:
    """
    Return focal lengths, mm, in two sections, and the mean distance of the foci behind the last surface, mm.

    Each is ``inf`` where the light leaves collimated. A focal length is -h/u' for the height h of a parallel ray before
    the system and its slope u' behind it. Both are along an axis that turns with the base ray.
    """
    first = path.steps[0]
    frame = across(first.before)
    points = np.array([step.point for step in path.steps])
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-6)
    o = first.point - size * first.before + STEP * size * np.concatenate([np.zeros((1, 3)), frame.T, -frame.T])
    d = np.tile(first.before, (5, 1))
    axes = frame.T
    for step in path.steps[:-1]:
        o, normal = path.meet(step, o, d)
        before, d = d[0], path.leave(step, d, normal)
        axes = _carried(axes, before, d[0], step.reflects)
    heights, slopes = o[1:3] - o[3:5], d[1:3] - d[3:5]  # of two rays 2 · STEP · size apart
    bent = np.linalg.norm(slopes, axis=1)
    found = bent > AFOCAL * 2 * STEP
    sign = np.where(np.einsum("ij,ij->i", axes, slopes) > 0, -1, 1)
    lengths = np.where(found, sign * 2 * STEP * size / np.where(found, bent, 1.0), np.inf)
    squares = np.where(found, bent, 1.0) ** 2
    focus = np.where(found, -np.einsum("ij,ij->i", heights, slopes) / squares, np.inf)
    real = focus[np.isfinite(focus)]
    return (float(lengths[0]), float(lengths[1])), float(real.mean()) if len(real) else math.inf


def _carried(axes: np.ndarray, before: np.ndarray, after: np.ndarray, reflects: bool) -> np.ndarray:
    """Return axes across a ray, (2, 3), turned as the ray turns; where it reflects, mirrored with it."""
    side = -1.0 if reflects else 1.0
    return np.asarray(axes - np.outer(axes @ after, after + side * before) / (1 + side * before @ after))


def _pupil(scene: Any, path: DesignPath) -> tuple[float, float, str]:
    """
    Return diameter (mm) and unobstructed area (mm²) of the entrance pupil, and the surface at its edge.

    Without any light they are NaN, 0 and "-". The id of the surface is "-" also if rays at the edge leave the scene.
    """
    target = outline(path.table.shapes[path.steps[0].surface])
    source = scene_sources(scene, field_deg=0.0)[0]
    largest = 1.02 * (float(np.linalg.norm(target.u) + np.linalg.norm(target.v)) + _off_axis(target.centre, source))
    phi = OFFSET + 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    r = largest * (np.arange(RADII) + 0.5) / RADII

    def tried(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = path.unobstructed(*source.through(x, y))
        return found.passes, found.ends

    def along(radii: np.ndarray, azimuths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return tried(radii * np.cos(azimuths), radii * np.sin(azimuths))

    # Inner and outer edge in some directions
    passes, ends = (values.reshape(AZIMUTHS, RADII) for values in along(np.tile(r, AZIMUTHS), np.repeat(phi, RADII)))
    every, is_open = np.arange(AZIMUTHS), passes.any(axis=1)
    outermost, innermost = RADII - 1 - np.argmax(passes[:, ::-1], axis=1), np.argmax(passes, axis=1)
    low, high = r[outermost], np.append(r, largest)[outermost + 1]
    edge = np.where(outermost + 1 < RADII, ends[every, np.minimum(outermost + 1, RADII - 1)], -1)
    hole_low, hole_high = np.append(0.0, r)[innermost], r[innermost]
    # Where the ray next to the axis passes there is no obstruction
    obstructed = np.flatnonzero((innermost > 0) & is_open)
    for _ in range(HALVINGS):
        middle, inside = 0.5 * (low + high), 0.5 * (hole_low + hole_high)[obstructed]
        good, here = along(np.concatenate([middle, inside]), np.concatenate([phi, phi[obstructed]]))
        good, open_inside, here = good[:AZIMUTHS], good[AZIMUTHS:], here[:AZIMUTHS]
        low, high, edge = np.where(good, middle, low), np.where(good, high, middle), np.where(good, edge, here)
        hole_low[obstructed] = np.where(open_inside, hole_low[obstructed], inside)
        hole_high[obstructed] = np.where(open_inside, inside, hole_high[obstructed])
    inner, outer = np.zeros(AZIMUTHS), np.where(is_open, low, 0.0)
    inner[obstructed] = hole_high[obstructed]
    # A vane along one direction is no edge
    outer = np.median([np.roll(outer, 1), outer, np.roll(outer, -1)], axis=0)

    # What lies otherwise than between these edges, as at corners and vanes: a finer grid where light was found
    side = largest * ((2 * np.arange(LOOKS) + 1) / LOOKS - 1)
    looks = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    lit = looks[tried(*looks.T)[0]]
    ways = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    lit = np.concatenate([lit, (r[:, None] * ways[:, None])[passes], outer[:, None] * ways])
    if not is_open.any() and not len(lit) > AZIMUTHS:
        return math.nan, 0.0, "-"
    corner, size = lit.min(axis=0) - largest / LOOKS, np.ptp(lit, axis=0) + 2 * largest / LOOKS
    rows = np.stack(np.meshgrid(*[np.arange(PROBES)] * 2), axis=-1).reshape(-1, 2)
    x, y = (corner + size * (rows + np.random.default_rng(0).random(rows.shape)) / PROBES).T
    good, here = tried(x, y)
    radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
    first, last = (np.interp(azimuth, phi, radii, period=2 * np.pi) for radii in (inner, outer))
    between = (radius > first) & (radius < last)
    fine = np.linspace(0, 2 * np.pi, FINE, endpoint=False)
    ring = [math.pi * float(np.mean(np.interp(fine, phi, radii, period=2 * np.pi) ** 2)) for radii in (inner, outer)]
    cell = float(np.prod(size)) / len(x)
    area = ring[1] - ring[0] + cell * (int(good.sum()) - int(between.sum()))
    surface = Counter(edge[is_open].tolist()).most_common(1)[0][0] if is_open.any() else -1
    filled = area
    if np.all(outer > 0):  # all about the axis; what is dark within, but by the edge, is an obstruction
        beyond, short = good & (radius >= last), between & ~good & (here == surface)
        filled = ring[1] + cell * (int(beyond.sum()) - int(short.sum()))
    return 2 * math.sqrt(filled / math.pi), area, path.table.ids[surface] if surface >= 0 else "-"


def _working_f_number(scene: Any, path: DesignPath, radius: float) -> float:
    """Return the working F-number of rays through a circle of a radius, mm, about the base ray; NaN if none arrives."""
    phi = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    x, y = (np.append(0.0, radius * along) for along in (np.cos(phi), np.sin(phi)))
    o, d = scene_sources(scene, field_deg=0.0)[0].through(x, y)
    for step in path.steps[:-1]:
        o, normal = path.meet(step, o, d)
        d = path.leave(step, d, normal)
    square = (np.cross(d[1:], d[0]) ** 2).sum(axis=1)
    square = square[np.isfinite(square)]
    return 1 / (2 * media(path)[-1].real * math.sqrt(float(square.mean()))) if square.any() else math.nan


def _off_axis(centre: np.ndarray, source: SceneSource) -> float:
    """Return the distance, mm, of a point (3,), mm, from the axis of a source."""
    away = centre - source.pivot
    return float(np.linalg.norm(away - (away @ source.direction) * source.direction))


def _field(scene: Any, path: DesignPath) -> dict[str, float]:
    """Return the field angles "x", "y" and "diagonal", degrees, of `FirstOrder.field_deg`."""
    detector = outline(path.table.shapes[path.table.detector])
    half = np.stack([detector.u, detector.v], axis=1)
    size = np.linalg.norm(half, axis=0)
    axes = half / size

    def hit(angle_deg: float, azimuth_deg: float) -> np.ndarray:
        """Return the detector point of a field's base ray, (1, 2), mm from the centre along its axes; NaN for none."""
        source = scene_sources(scene, field_deg=angle_deg, azimuth_deg=azimuth_deg)[0]
        found = path.follow(*source.through(np.zeros(1), np.zeros(1)), 0)
        return np.asarray((found[0] - detector.centre) @ axes)

    # A field in the direction of azimuth φ, from +y towards -x, moves the image along one line: which azimuth serves
    # which edge follows from a small field
    small = 1e-3
    start = hit(0.0, 0.0)
    with np.errstate(invalid="ignore"):
        moved = np.stack([hit(small, azimuth) - start for azimuth in (0.0, 90.0)], axis=1)
    if not np.all(np.isfinite(moved)) or abs(np.linalg.det(moved)) < 1e-18:
        return {"x": math.nan, "y": math.nan, "diagonal": math.nan}
    edges = {"x": np.array([size[0], 0.0]), "y": np.array([0.0, size[1]]), "diagonal": size}
    if detector.shape == "ellipse":
        edges["diagonal"] = edges["x"] if size[0] >= size[1] else edges["y"]
    found = {}
    for name, edge in edges.items():
        across_axes = np.linalg.solve(moved, edge)  # shares of the azimuths 0 and 90
        azimuth = math.degrees(math.atan2(across_axes[1], across_axes[0]))
        found[name] = _angle(lambda angle, azimuth=azimuth: hit(angle, azimuth) - start, float(np.linalg.norm(edge)))
    return found


def _angle(shift: Any, wanted: float) -> float:
    """
    Return the field angle, degrees, at which the image is shifted by `wanted`, mm; NaN if there is none below 89°.

    `shift`: function from field angle, degrees, to the displacement of the base ray on the detector, (1, 2), mm.
    """
    low, high = 0.0, math.nan
    for angle in (1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, LARGEST_FIELD_DEG):
        away = float(np.linalg.norm(shift(angle)))
        if not math.isfinite(away) or away >= wanted:
            high = angle
            break
        low = angle
    if not math.isfinite(high):
        return math.nan
    for _ in range(40):
        middle = 0.5 * (low + high)
        away = float(np.linalg.norm(shift(middle)))
        low, high = (middle, high) if math.isfinite(away) and away < wanted else (low, middle)
    return 0.5 * (low + high) if math.isfinite(float(np.linalg.norm(shift(low)))) else math.nan

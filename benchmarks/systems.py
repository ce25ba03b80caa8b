"""Systems of more than round lenses: a housing of a million triangles, freeforms, a primary mirror of segments.

Each is set beside a scene that does without: the lens alone, an even asphere of the same order, a primary in one piece.
What is compared is the time of a segment of the ray tree in the kernel, which is what grows with the number of rays.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import mitsuba as mi
import numpy as np
from rows import REPEATS, Row, measured

import mistray
from mistray.mechanics.ply import ply_bytes
from mistray.prescription import Coating, Detector, MeshStructure, Prescription, Scatter, Source, Surface
from mistray.scenes.double_gauss.prescription import build as double_gauss
from mistray.scenes.segmented_mirror.prescription import FOCAL_LENGTH, MIRROR, SOURCE_RADIUS
from mistray.scenes.segmented_mirror.prescription import build as segmented_mirror

RADIUS_MM, FROM_MM, TO_MM = 36.0, -30.0, 70.0  # of the tube
AROUND, ALONG = 1000, 500  # two triangles each
PAINT = Scatter("abg", {"A": 0.02, "B": 1.0, "g": 0.0})
ORDER = 8
HOLE_MM = 660.0  # of a primary in one piece: where the hexagon in the middle is missing


def tube() -> bytes:
    """A cylinder of triangles about the axis, as a PLY file."""
    phi = 2 * np.pi * np.arange(AROUND) / AROUND
    z = np.linspace(FROM_MM, TO_MM, ALONG + 1)
    ring = RADIUS_MM * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(AROUND, height)]) for height in z])
    a = (AROUND * np.arange(ALONG)[:, None] + np.arange(AROUND)).ravel()
    b = (AROUND * np.arange(ALONG)[:, None] + np.roll(np.arange(AROUND), -1)).ravel()
    c, d = a + AROUND, b + AROUND
    return ply_bytes(vertices, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]))


def in_tube(folder: Path, painted: bool) -> mi.Scene:
    """The double Gauss within the tube."""
    (folder / "tube.ply").write_bytes(tube())
    part = MeshStructure("tube", "tube.ply", coating=Coating(R=0.05), scatter=(PAINT,) if painted else ())
    lens = double_gauss()
    replace(lens, structures=(*lens.structures, part)).to_xml(folder / "scene.xml")
    return mistray.load(folder / "scene.xml")


def beside_the_lens(painted: bool, rays: int, repeats: int) -> Row:
    """Segments per second in the tube over those of the lens alone."""
    settings = {"rays": rays, "field_deg": 5.0, "max_reflections": 2}
    with tempfile.TemporaryDirectory() as folder:
        scene = in_tube(Path(folder), painted)
    alone = double_gauss().to_scene()
    what = f"double Gauss in a {'painted ' * painted}tube of {2 * AROUND * ALONG / 1e6:g} M triangles"
    return _rates(
        "painted_tube" if painted else "tube",
        f"{what}{', one scatter' * painted}, the lens alone without scatter",
        partial(mistray.trace, scene, max_scatters=int(painted), **settings),
        partial(mistray.trace, alone, **settings),
        0.3 if painted else 0.6,
        repeats,
    )


def singlet(front: Surface) -> mi.Scene:
    """A lens with this front."""
    rear = Surface("rear", z=6.0, radius=-80.0, semi_diameter=14.0, front="1.5")
    return Prescription(
        name="singlet", surfaces=(front, rear), detector=Detector(z=84.0, half_width=10.0, half_height=10.0),
        source=Source(radius=12.0, z=-10.0),
    ).to_scene()  # fmt: skip


def zernike(rays: int, repeats: int) -> Row:
    """Time of a trace through Zernike polynomials over that through an even asphere."""
    rng = np.random.default_rng(1)
    terms = (ORDER + 1) * (ORDER + 2) // 2
    sag = {f"zernike_{k}": float(rng.normal(0, 1e-4)) for k in range(4, terms + 1)} | {"zernike_radius": 14.0}
    even = (1e-7, 1e-10, 1e-13)[: ORDER // 2 - 1]
    common = {"radius": 80.0, "semi_diameter": 14.0, "back": "1.5"}
    scenes = singlet(Surface("front", sag=sag, **common)), singlet(Surface("front", coefficients=even, **common))
    here, there = (partial(mistray.trace, scene, rays=rays, max_reflections=2) for scene in scenes)
    return times("zernike", f"singlet whose front has {terms - 3} Zernike terms, the same with a4 to a{ORDER}",
                  here, there, 2.0, repeats)  # fmt: skip


def segments(rays: int, repeats: int) -> Row:
    """Time of a trace with 18 segments over that with one mirror."""
    design = segmented_mirror()
    whole = Surface("primary", radius=-2 * FOCAL_LENGTH, conic=-1.0, semi_diameter=SOURCE_RADIUS,
                    inner_semi_diameter=HOLE_MM, coating=MIRROR, mirror=True)  # fmt: skip
    one = replace(design, surfaces=(whole, design.surfaces[-1]))
    here, there = (partial(mistray.trace, p.to_scene(), rays=rays, max_reflections=2) for p in (design, one))
    return times("segments", "telescope with a primary of 18 segments, the same in one piece", here, there, 1.5,
                  repeats)  # fmt: skip


Trace = Callable[[], mistray.Trace]


def _per_segment(here: Trace, there: Trace, repeats: int) -> tuple[float, float, str]:
    """Segments per second of both, and what says how much work there was."""
    best, closure, segments = [math.inf, math.inf], 0.0, [0, 0]
    for turn in range(repeats + 1):
        for k, action in enumerate((here, there)):
            found = action()
            closure, segments[k] = max(closure, abs(found.energy.closure)), found.segments
            if turn:  # the first one compiles
                best[k] = min(best[k], found.seconds)
    equal = f"{segments[0] / 1e6:.3g} and {segments[1] / 1e6:.3g} M segments, energy to {closure:.1g}"
    return segments[0] / best[0], segments[1] / best[1], equal


def _rates(key: str, what: str, here: Trace, there: Trace, bar: float, repeats: int) -> Row:
    ours, other, equal = _per_segment(here, there, repeats)
    return Row(key, what, f"{ours / 1e6:.1f} M/s", f"{other / 1e6:.1f} M/s", ours / other, bar, equal=equal)


def times(key: str, what: str, here: Trace, there: Trace, bar: float, repeats: int) -> Row:
    """Time of a segment of the first over that of the second."""
    ours, other, equal = _per_segment(here, there, repeats)
    texts = (f"{1e9 / rate:.3g} ns a segment" for rate in (ours, other))
    return Row(key, what, *texts, other / ours, bar, small=True, equal=equal)


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `systems`."""
    rays, repeats = (1 << 13, 1) if quick else (1 << 21, REPEATS)
    for painted in (False, True):
        key = "painted_tube" if painted else "tube"
        yield measured(key, "double Gauss in a tube of triangles", partial(beside_the_lens, painted, rays, repeats))
    yield measured("zernike", "Zernike front against an even asphere", partial(zernike, rays, repeats))
    yield measured("segments", "18 segments against one mirror", partial(segments, rays, repeats))

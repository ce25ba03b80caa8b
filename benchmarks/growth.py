"""How the cost of a trace grows: with rays, surfaces, paths, layers, detectors, wavelengths and threads.

Kernels are compiled before; times are those of the trace alone. The ratio is the exponent of the power law that fits
all points best, but for the first row, the time of ten times the rays, and for threads. A twentieth is allowed for
noise where a bar says "linear". The tube is one mirror that is cut into more and more rings, and ghosts of plates
meet more surfaces the more there are.
"""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from modes import coated, stack
from rows import REPEATS, Row, agree, alternate, slope

import mistray
from mistray.execute.tracer import Run, prepare
from mistray.light import Light
from mistray.prescription import Coating, Detector, Prescription, Source, Structure, Surface, barrel
from mistray.recorders.tallies import SEGMENTS
from mistray.settings import Settings

LINEAR = 1.05
THREADS_BAR = 1.8
RAYS = (10_000, 100_000, 1_000_000, 10_000_000)
PLATES = (2, 5, 10, 20)
RINGS = (10, 30, 100, 300, 1000)  # more than 128 lie in a tree
REFLECTIONS = (0, 2, 4)  # an odd number of reflections sends no light to the detector
LAYERS = (1, 4, 10, 40, 100)
DETECTORS = (1, 4, 16)  # squares
WAVELENGTHS = (1, 2, 4, 8, 16)
NS, MS = 1e9, 1e3


def executed(run: Run, ledger: bool = True) -> float:
    """Trace and give the number of segments."""
    return float(run.execute(ledger).sums.channels[SEGMENTS].sum())


def with_rays(quick: bool) -> list[Row]:
    """The Cooke triplet with its path table, 1e4 … 1e7 rays."""
    counts = RAYS[:2] if quick else RAYS
    runs = [prepare(mistray.load("cooke_triplet"), Settings(rays=count))[0].execute(True) for count in counts]
    # The longest would take minutes five times over
    times = alternate(*(lambda run=run: run.execute(True) for run in runs), repeats=1 if quick else 2)
    seconds = [timing.seconds for timing in times]
    growth = seconds[-1] / seconds[-2] / (counts[-1] / counts[-2])
    ends = (f"{value:.3g} s" for value in (seconds[-1], seconds[-2]))
    what = f"time of {counts[-1]:g} rays over {counts[-1] / counts[-2]:g} times that of {counts[-2]:g}"
    return [
        Row("rays", f"`cooke_triplet`, path table: {what}", *ends, growth, LINEAR, small=True),
        exponent("rays-exponent", "`cooke_triplet`, path table", "rays", counts, "seconds", seconds),
    ]


def plates(count: int) -> Prescription:
    """Plane-parallel plates in a black barrel, 4 surfaces each with edge and wall, and a detector."""
    pairs = (
        (
            Surface(f"P{k}_front", z=4.0 * k, semi_diameter=10.0, back="1.5", part=f"P{k}"),
            Surface(f"P{k}_rear", z=4.0 * k + 2.0, semi_diameter=10.0, front="1.5", part=f"P{k}"),
        )
        for k in range(count)
    )
    optics = tuple(itertools.chain.from_iterable(pairs))
    detector = Detector(z=4.0 * count, semi_diameter=10.0, pixels=(64, 64))
    return Prescription(
        name=f"{count} plates",
        surfaces=optics,
        structures=barrel((*optics, detector)),
        detector=detector,
        source=Source(radius=8.0),
    )


def with_surfaces(quick: bool) -> list[Row]:
    """Plates: a ray straight through, which meets the more surfaces the more there are, and a segment of the tree."""
    counts = PLATES[:2] if quick else PLATES
    lenses = [plates(count) for count in counts]
    surfaces = [len(lens.surfaces) + len(lens.structures) + 1 for lens in lenses]
    scenes = [lens.to_scene() for lens in lenses]
    rays, repeats = (1 << 12, 1) if quick else (1 << 20, REPEATS)
    straight = [prepare(scene, Settings(rays=rays, max_reflections=0))[0] for scene in scenes]
    times = alternate(*(lambda run=run: executed(run, False) for run in straight), repeats=repeats)
    per_ray = [NS * timing.seconds / rays for timing in times]
    # As many segments each time: a reflection at each surface, and the way back through those before it
    starts = [(rays >> 3) // count**2 for count in counts]
    pairs = zip(scenes, starts, strict=True)
    trees = [prepare(scene, Settings(rays=start, max_reflections=1))[0] for scene, start in pairs]
    segments = [executed(run, False) for run in trees]
    times = alternate(*(lambda run=run: executed(run, False) for run in trees), repeats=repeats)
    per_segment = [NS * timing.seconds / number for timing, number in zip(times, segments, strict=True)]
    return [
        exponent("surfaces-straight", "straight through plates, a start ray", "surfaces", surfaces, "ns", per_ray),
        exponent("surfaces-tree", "plates with one reflection, a segment", "surfaces", surfaces, "ns", per_segment),
    ]


def exponent(
    key: str, what: str, by: str, counts: Sequence[int], unit: str, values: Sequence[float], bar: float | None = LINEAR
) -> Row:
    """Exponent of the growth of a time with a number of things."""
    return Row(
        key,
        f"{what}: exponent of its time over the number of {by}, {counts[0]} … {counts[-1]}",
        f"{values[-1]:.3g} {unit}",
        f"{values[0]:.3g} {unit}",
        slope(counts, values),
        bar,
        small=True,
        series={by: counts, unit: values},
    )


def with_paths(quick: bool) -> Row:
    """The Cooke triplet with up to 4 reflections: what a segment costs with more rows of the path table."""
    scene = mistray.load("cooke_triplet")
    limits = REFLECTIONS[:2] if quick else REFLECTIONS
    rays = 1 << (12 if quick else 19)
    runs = [prepare(scene, Settings(rays=rays >> k, max_reflections=k, flux_threshold=0.0))[0] for k in limits]
    runs = [run.execute(True) for run in runs]
    segments = [float(run.sums.channels[SEGMENTS].sum()) for run in runs]
    numbers = [len(run.paths.keys) for run in runs]
    times = alternate(*(lambda run=run: executed(run) for run in runs), repeats=1 if quick else REPEATS)
    values = [NS * timing.seconds / count for timing, count in zip(times, segments, strict=True)]
    what = "`cooke_triplet`, a segment of trees of more reflections"
    return exponent("paths", what, "paths", numbers, "ns", values, 0.15)


def with_layers(quick: bool) -> list[Row]:
    """The double Gauss with 1 … 100 layers on every surface: the trace reads tables, which are made before."""
    layers = LAYERS[:2] if quick else LAYERS
    scenes = [coated("double_gauss", stack(number)) for number in layers]
    settings = Settings(rays=1 << (10 if quick else 17), max_reflections=1, flux_threshold=0.0)
    runs = [prepare(scene, settings)[0] for scene in scenes]
    repeats = 1 if quick else REPEATS
    traces = alternate(*(lambda run=run: run.execute(True) for run in runs), repeats=repeats)
    fresh = (500.0 + 1e-3 * k for k in itertools.count())  # tables are kept: each time at another wavelength, nm
    makes = (lambda scene=scene: prepare(scene, settings, Light(wavelength_nm=next(fresh))) for scene in scenes)
    tables = alternate(*makes, repeats=repeats)
    found = ("trace", "trace", traces, 0.04), ("tables", "tables of R and T", tables, 1.0)
    return [
        exponent(
            f"layers-{key}",
            f"`double_gauss`, {what}",
            "layers",
            layers,
            "ms",
            [MS * one.seconds for one in timings],
            bar,
        )
        for key, what, timings, bar in found
    ]


def tube(count: int) -> Prescription:
    """A tube of mirror, 100 mm long, in so many rings, with a detector behind it."""
    ends = np.linspace(0.0, 100.0, count + 1)
    rings = (
        Structure(name=f"ring_{k}", r0=10.0, z0=z0, r1=10.0, z1=z1, coating=Coating(R=0.9))
        for k, (z0, z1) in enumerate(itertools.pairwise(ends.tolist()))
    )
    return Prescription(
        name=f"tube of {count} rings",
        surfaces=(),
        structures=tuple(rings),
        detector=Detector(z=101.0, semi_diameter=12.0, pixels=(64, 64)),
        source=Source(radius=8.0, field_deg=30.0),
    )


def with_rings(quick: bool) -> list[Row]:
    """A tube in rings, up to 1000: a segment, and what precedes the first ray of a scene."""
    counts = RINGS[:2] if quick else RINGS
    settings = Settings(rays=1 << (10 if quick else 19), max_reflections=16)
    loading, scenes = [], []
    for count in counts:
        lens = tube(count)
        began = time.perf_counter()
        scenes.append(lens.to_scene())
        runs = prepare(scenes[-1], settings)
        loading.append(MS * (time.perf_counter() - began))
    runs = [prepare(scene, settings)[0] for scene in scenes]
    segments = [executed(run, False) for run in runs]
    agree("segments", segments, segments[0], 1e-2)
    times = alternate(*(lambda run=run: executed(run, False) for run in runs), repeats=1 if quick else REPEATS)
    values = [NS * timing.seconds / number for timing, number in zip(times, segments, strict=True)]
    return [
        exponent("rings", "a tube of mirror, a segment", "rings", counts, "ns", values),
        exponent(
            "rings-load", "a tube of mirror, from its prescription to the first ray", "rings", counts, "ms", loading
        ),
    ]


def screens(side: int) -> mi.Scene:
    """A plate, and behind it a square of 16 mm of side² detectors that takes all light of the beam."""
    width, place = 8.0 / side, np.arange(side) - (side - 1) / 2
    at = mi.ScalarTransform4d().translate
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    detector = {
        "type": "asphere",
        "half_width": width,
        "half_height": width,
        "bsdf": {"type": "interface", "R": 0.0},
        "sensor": {"type": "irradiancemeter", "film": film},
    }
    scene: dict[str, Any] = {"type": "scene", "source": {"type": "collimated", "radius": 8.0}}
    for name, z, front, back in (("front", 0.0, "air", "1.5"), ("rear", 2.0, "1.5", "air")):
        interface = {"type": "interface", "front": front, "back": back}
        scene[name] = {"type": "asphere", "semi_diameter": 10.0, "to_world": at([0, 0, z]), "bsdf": interface}
    for k, (x, y) in enumerate(itertools.product(2 * width * place, repeat=2)):
        scene[f"screen_{k}"] = detector | {"to_world": at([float(x), float(y), 10.0])}
    return mistray.load(scene)


def with_detectors(quick: bool) -> Row:
    """The light of a plate on more and more detectors: the same segments."""
    counts = DETECTORS[:2] if quick else DETECTORS
    settings = Settings(rays=1 << (10 if quick else 20))
    runs = [prepare(screens(math.isqrt(count)), settings)[0].execute(True) for count in counts]
    segments = [float(run.sums.channels[SEGMENTS].sum()) for run in runs]
    agree("segments", segments, segments[0], 1e-3)
    times = alternate(*(lambda run=run: run.execute(True) for run in runs), repeats=1 if quick else REPEATS)
    values = [NS * timing.seconds / number for timing, number in zip(times, segments, strict=True)]
    return exponent("detectors", "a plate, a segment", "detectors", counts, "ns", values)


def with_wavelengths(quick: bool) -> Row:
    """The Cooke triplet with the same rays for more and more wavelengths, each of which has tables of its own."""
    counts = WAVELENGTHS[:2] if quick else WAVELENGTHS
    scene = mistray.load("cooke_triplet")
    shift = (1e-3 * k for k in itertools.count())  # tables are kept: each time at other wavelengths, nm

    def work(count: int) -> None:
        nm = np.linspace(450.0, 650.0, count) + next(shift)
        mistray.trace(scene, rays=1 << (12 if quick else 19), polarization="unpolarized", wavelength_nm=nm.tolist())

    times = alternate(*(lambda count=count: work(count) for count in counts), repeats=1 if quick else REPEATS)
    values = [MS * timing.seconds for timing in times]
    return exponent("wavelengths", "`cooke_triplet`, the same rays", "wavelengths", counts, "ms", values)


def with_threads(quick: bool) -> Iterator[Row]:
    """Two threads against one."""
    before = dr.thread_count()
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for name, rays in (("double_gauss", 1 << 19), ("phone_camera", 1 << 15)):
        what = f"`{name}`: threads 1 → 2"
        if processors < 2:
            yield Row("threads-" + name, what, "", f"not measured: this machine has {processors} processor", math.nan)
            continue
        (run,) = prepare(mistray.load(name), Settings(rays=rays >> 6 if quick else rays))

        def on(threads: int, run: Run = run) -> None:
            mistray.set_threads(threads)
            run.execute(True)

        try:
            two, one = alternate(lambda: on(2), lambda: on(1), repeats=1 if quick else REPEATS)
        finally:
            mistray.set_threads(before)
        yield Row(
            f"threads-{name}",
            what,
            f"{two.seconds:.3g} s, {two.cores:.1f} cores",
            f"{one.seconds:.3g} s, {one.cores:.1f} cores",
            one.seconds / two.seconds,
            THREADS_BAR,
        )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `growth`."""
    yield from with_rays(quick)
    yield from with_surfaces(quick)
    yield from with_rings(quick)
    yield with_paths(quick)
    yield from with_layers(quick)
    yield with_detectors(quick)
    yield with_wavelengths(quick)
    yield from with_threads(quick)

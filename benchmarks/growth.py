"""How the cost of a trace grows: with rays, surfaces, paths, layers and threads.

Kernels are compiled before; times are those of the trace alone. Growth is told by the exponent of a power law, or by
the ratio of the ends. A twentieth is allowed for noise where a bar says "linear".
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator, Sequence

import drjit as dr
from modes import coated, stack
from rows import REPEATS, Row, alternate, slope

import mistray
from mistray.execute.tracer import Run, prepare
from mistray.light import Light
from mistray.prescription import Detector, Prescription, Source, Surface, barrel
from mistray.recorders.tallies import SEGMENTS
from mistray.settings import Settings

LINEAR = 1.05
THREADS_BAR = 1.8
RAYS = (10_000, 100_000, 1_000_000, 10_000_000)
PLATES = (2, 5, 10, 20)
REFLECTIONS = (0, 2, 4)  # an odd number of reflections sends no light to the detector
LAYERS = (1, 4, 10, 40, 100)
NS, MS = 1e9, 1e3


def executed(run: Run, ledger: bool = True) -> float:
    """Trace and give the number of segments."""
    return float(run.execute(ledger).sums.channels[SEGMENTS].sum())


def with_rays(quick: bool) -> Row:
    """The Cooke triplet with its path table, 1e4 … 1e7 rays."""
    counts = RAYS[:2] if quick else RAYS
    runs = [prepare(mistray.load("cooke_triplet"), Settings(rays=count))[0].execute(True) for count in counts]
    # The longest would take minutes five times over
    times = alternate(*(lambda run=run: run.execute(True) for run in runs), repeats=1 if quick else 2)
    seconds = [timing.seconds for timing in times]
    growth = seconds[-1] / seconds[-2] / (counts[-1] / counts[-2])
    return Row(
        "rays",
        f"`cooke_triplet`, path table: time of {counts[-1]:g} rays over {counts[-1] / counts[-2]:g} times that of "
        f"{counts[-2]:g}",
        f"{seconds[-1]:.3g} s",
        f"{seconds[-2]:.3g} s",
        growth,
        LINEAR,
        small=True,
        series={"rays": counts, "seconds": seconds},
    )


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
        exponent("surfaces-straight", "straight through plates, a start ray", "ns", surfaces, per_ray),
        exponent("surfaces-tree", "plates with one reflection, a segment", "ns", surfaces, per_segment),
    ]


def exponent(key: str, what: str, unit: str, surfaces: Sequence[int], values: Sequence[float]) -> Row:
    """Exponent of the growth with surfaces."""
    return Row(
        key,
        f"{what}: exponent of its time over the number of surfaces, {surfaces[0]} … {surfaces[-1]}",
        f"{values[-1]:.3g} {unit}",
        f"{values[0]:.3g} {unit}",
        slope(surfaces, values),
        LINEAR,
        small=True,
        series={"surfaces": surfaces, unit: values},
    )


def with_paths(quick: bool) -> Row:
    """The Cooke triplet with up to 4 reflections: what a segment costs with more rows of the path table."""
    scene = mistray.load("cooke_triplet")
    limits = REFLECTIONS[:2] if quick else REFLECTIONS
    rays = 1 << (12 if quick else 19)
    runs = [prepare(scene, Settings(rays=rays >> k, max_reflections=k, flux_threshold=0.0))[0] for k in limits]
    runs = [run.execute(True) for run in runs]
    segments = [float(run.sums.channels[SEGMENTS].sum()) for run in runs]
    numbers = [len(mistray.trace(scene, rays=rays >> k, max_reflections=k, flux_threshold=0.0).paths)
               for k in limits]  # fmt: skip
    times = alternate(*(lambda run=run: executed(run) for run in runs), repeats=1 if quick else REPEATS)
    values = [NS * timing.seconds / count for timing, count in zip(times, segments, strict=True)]
    return Row(
        "paths",
        f"`cooke_triplet`, a segment with {numbers[-1]} paths in the table over one with {numbers[0]}",
        f"{values[-1]:.3g} ns",
        f"{values[0]:.3g} ns",
        values[-1] / values[0],
        small=True,
        series={"paths": numbers, "ns": values},
    )


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
    result = []
    for key, what, timings in (("trace", "trace", traces), ("tables", "tables of R and T", tables)):
        values = [MS * timing.seconds for timing in timings]
        result.append(
            Row(
                f"layers-{key}",
                f"`double_gauss`, {what}: time with {layers[-1]} layers on every surface over that with {layers[0]}",
                f"{values[-1]:.3g} ms",
                f"{values[0]:.3g} ms",
                values[-1] / values[0],
                LINEAR * layers[-1] / layers[0] if key == "tables" else 1.25,
                small=True,
                series={"layers": layers, "ms": values},
            )
        )
    return result


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
    yield with_rays(quick)
    yield from with_surfaces(quick)
    yield with_paths(quick)
    yield from with_layers(quick)
    yield from with_threads(quick)

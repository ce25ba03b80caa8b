"""What gradients cost: time over that of the trace, memory over the number of rays and of parameters."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from memory import peak_mb
from modes import coated
from rows import REPEATS, Row, agree, alternate

import mistray
from mistray.gradients.edge_widths import widths_of
from mistray.gradients.table_gradient import GradientRequest
from mistray.metrics.gradient import chosen_parameters, gradient_request
from mistray.optimize import gradient, parameters, path_power
from mistray.surfaces.gradient_columns import RIM_COLUMNS

SHAPES = ("curvature", "conic", "asphere", "position", "tilt", "index")
KINDS = {"coatings": ("coating", "share"), "geometry": SHAPES, "rims": ("rim",)}
BARS = {"coatings": 1.0, "geometry": 3.5, "rims": 2.0}


def layer_cost(name: str, rays: int, most: float, repeats: int) -> Row:
    """A metric with the gradient of every layer over the metric alone; small is good."""
    scene = coated(name, "1.38 99.6, 2.10 131.0, 1.63 84.4")
    params = mi.traverse(scene)
    metric = path_power(scene, "ghost", rays=rays, flux_threshold=0.0)
    coatings = [key for key, p in parameters(scene).items() if p.kind in ("coating", "share")]
    found = gradient(metric, params, coatings)
    count = sum(len(values) for values in found.gradient.values())
    with_it, alone = alternate(lambda: gradient(metric, params, coatings), metric.value, repeats=repeats)
    return Row(
        f"layers-{name}",
        f"`{name}`: ghost power and its {count} derivatives by layers / ghost power",
        f"{with_it.seconds:.3f} s",
        f"{alone.seconds:.3f} s",
        with_it.seconds / alone.seconds,
        most,
        small=True,
        equal=agree("ghost power", found.value, metric.value(), 1e-6),
    )


def gradient_costs(name: str, rays: int, repeats: int, **settings: Any) -> list[Row]:
    """Time of the derivatives by all coatings, by all of the geometry and by all rims over that of the trace."""
    scene = mistray.load(name)
    params = mi.traverse(scene)
    known = chosen_parameters(scene, params)
    metric = path_power(scene, "all", rays=rays, **settings)
    result = []
    for what, kinds in KINDS.items():
        chosen = [p for p in known.values() if p.kind in kinds]
        if not chosen:
            continue
        request = _request(what, chosen)
        best = [np.inf, np.inf]
        for repeat in range(repeats + 1):
            started = time.perf_counter()
            (observation,) = metric.observe()
            traced = time.perf_counter()
            dr.backward(metric.evaluate([observation]), flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            for _ in observation.table_gradients(request):
                pass
            done = time.perf_counter()
            if repeat:  # the first one compiles
                best = [min(best[0], traced - started), min(best[1], done - traced)]
        result.append(
            Row(
                f"{what}-{name}",
                f"`{name}`: gradient by all {what} ({sum(p.value.size for p in chosen)} numbers) / trace",
                f"{best[1]:.2f} s",
                f"{best[0]:.2f} s",
                best[1] / best[0],
                BARS[what],
                small=True,
            )
        )
    return result


def _request(what: str, chosen: list[Any]) -> GradientRequest:
    """Geometry with visibility as it is, or what rims do alone."""
    if what == "rims":
        return GradientRequest(rows=False, geometry=frozenset(RIM_COLUMNS), edge_widths=widths_of(0.05))
    return gradient_request(chosen, edges=False)


def memory(name: str, rays: int) -> list[Row]:
    """Largest memory of a process that computes a gradient: four times the rays, and all parameters instead of one."""

    def peak(count: int, keys: str) -> float:
        command = [sys.executable, __file__, "--peak", name, str(count), keys]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-1])

    few, many, one = peak(rays, "*"), peak(4 * rays, "*"), peak(rays, "*.curvature")
    return [
        Row(
            f"memory-rays-{name}",
            f"`{name}`: memory of a gradient, {4 * rays} / {rays} rays",
            f"{many:.0f} MB",
            f"{few:.0f} MB",
            many / few,
            1.2,
            small=True,
        ),
        Row(
            f"memory-parameters-{name}",
            f"`{name}`: memory of a gradient, by all / by curvatures",
            f"{few:.0f} MB",
            f"{one:.0f} MB",
            few / one,
            1.2,
            small=True,
        ),
    ]


def _peak(name: str, rays: int, pattern: str) -> None:
    """Print the largest resident memory of a gradient, MB."""
    scene = mistray.load(name)
    mistray.gradient(path_power(scene, "all", rays=rays, max_scatters=0), mi.traverse(scene), keys=[pattern])
    print(peak_mb())


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `gradients`."""
    repeats = 1 if quick else REPEATS
    for name, rays in (("cooke_triplet", 1 << 16), ("phone_camera", 1 << 12)):
        yield layer_cost(name, rays >> 6 if quick else rays, 1.5, repeats)
    for name, rays in (("double_gauss", 200_000), ("phone_camera", 10_000)):
        yield from gradient_costs(name, rays // 100 if quick else rays, repeats)
    yield from memory("double_gauss", 1_000 if quick else 100_000)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Cost of gradients.")
    parser.add_argument("--peak", nargs=3, metavar=("SCENE", "RAYS", "KEYS"), help="memory of one gradient")
    options = parser.parse_args()
    if options.peak:
        _peak(options.peak[0], int(options.peak[1]), options.peak[2])
    else:
        print(*rows(False), sep="\n")

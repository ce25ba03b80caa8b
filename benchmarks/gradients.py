"""What gradients cost: time over that of the trace, memory over the number of rays and of parameters."""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from rows import REPEATS, Row

import mistray
from mistray.optimize import path_power
from mistray.optimize.gradient import chosen_parameters, wanted_of
from mistray.trace.raw_gradient import RIM_COLUMNS, Wanted

SHAPES = ("curvature", "conic", "asphere", "position", "tilt", "index")
KINDS = {"coatings": ("coating", "share"), "geometry": SHAPES, "rims": ("rim",)}
BARS = {"coatings": 2.5, "geometry": 4.0, "rims": 2.5}


def gradient_costs(name: str, rays: int, **settings: Any) -> list[Row]:
    """Time of the derivatives by all coatings, by all of the geometry and by all rims over that of the trace."""
    scene = mistray.load(name)
    params = mi.traverse(scene)
    known = chosen_parameters(scene, params)
    metric = path_power(scene, "all", rays=rays, **settings)
    rows = []
    for what, kinds in KINDS.items():
        chosen = [p for p in known.values() if p.kind in kinds]
        if not chosen:
            continue
        wanted = _wanted(what, chosen)
        best = [np.inf, np.inf]
        for repeat in range(REPEATS + 1):
            started = time.perf_counter()
            (observation,) = metric.observe()
            traced = time.perf_counter()
            dr.backward(metric.evaluate([observation]), flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
            for _ in observation.raw_gradients(wanted):
                pass
            done = time.perf_counter()
            if repeat:  # the first one compiles
                best = [min(best[0], traced - started), min(best[1], done - traced)]
        rows.append(
            Row(
                f"{name}: gradient by all {what} ({sum(p.value.size for p in chosen)} numbers) / trace",
                f"{best[1]:.2f} s",
                f"{best[0]:.2f} s",
                best[1] / best[0],
                BARS[what],
                small=True,
            )
        )
    return rows


def _wanted(what: str, chosen: list[Any]) -> Wanted:
    """Geometry with visibility as it is, or what rims do alone."""
    if what == "rims":
        return Wanted(rows=False, geometry=frozenset(RIM_COLUMNS), edges=True)
    return wanted_of(chosen, edges=False, edge_width=0.02)


def memory(name: str, rays: int) -> list[Row]:
    """Largest memory of a process that computes a gradient: four times the rays, and all parameters instead of one."""

    def peak(count: int, keys: str) -> float:
        command = [sys.executable, __file__, "--peak", name, str(count), keys]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-1])

    few, many, one = peak(rays, "*"), peak(4 * rays, "*"), peak(rays, "*.curvature")
    return [
        Row(
            f"{name}: memory of a gradient, {4 * rays} / {rays} rays",
            f"{many:.0f} MB",
            f"{few:.0f} MB",
            many / few,
            1.2,
            True,
        ),
        Row(f"{name}: memory, by all / by curvatures", f"{few:.0f} MB", f"{one:.0f} MB", few / one, 1.2, True),
    ]


def _peak(name: str, rays: int, pattern: str) -> None:
    """Print the largest resident memory of a gradient, MB."""
    scene = mistray.load(name)
    mistray.gradient(path_power(scene, "all", rays=rays, max_scatters=0), mi.traverse(scene), keys=[pattern])
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Cost of gradients.")
    parser.add_argument("--peak", nargs=3, metavar=("SCENE", "RAYS", "KEYS"), help="memory of one gradient")
    options = parser.parse_args()
    if options.peak:
        _peak(options.peak[0], int(options.peak[1]), options.peak[2])
    else:
        for row in (
            *gradient_costs("double_gauss", 200_000),
            *gradient_costs("phone_camera", 20_000),
            *memory("double_gauss", 100_000),
        ):
            print(row)

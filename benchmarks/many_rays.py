"""A trace of very many start rays in one process: does memory stay, do the sums keep their digits?

    python benchmarks/many_rays.py                     # plate, 1e9 rays, with the path table
    python benchmarks/many_rays.py --scene singlet_window_detector --rays 1e8

The base is the largest memory of the process once the scene is loaded and nothing is traced; a trace of `FEW` rays says
how long the whole will take. The exit code is 1 if memory grows by `MOST_MIB` or more, the energy does not close to
`MOST_CLOSURE`, or the hits of the strongest path differ from those of the few rays by more than chance.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from memory import peak_mb
from rows import Row

import mistray
from mistray.execute.tracer import PASS_LANES

FEW = 4 * PASS_LANES  # as many passes as memory takes to settle
MOST_MIB = 1e9 / 2**20
MOST_CLOSURE = 1e-5
SIGMAS = 5.0  # a false alarm in 2e6 runs
EVERY_S = 10.0
BENCH_RAYS = 100_000_000


@dataclass(frozen=True)
class ManyRays:
    """
    What a long trace has shown.

    Attributes
    ----------
    base_mib, few_mib, many_mib : float
        Largest memory of the process so far: scene loaded, after `FEW` rays, at the end.
    seconds : float
        Of the long trace.
    closure : float
    hits_per_ray, hits_per_ray_of_few : float
        Hits of the detector by the strongest path, for each start ray.
    rays, segments, paths : int
    """

    base_mib: float
    few_mib: float
    many_mib: float
    seconds: float
    closure: float
    hits_per_ray: float
    hits_per_ray_of_few: float
    rays: int
    segments: int
    paths: int

    @property
    def failures(self) -> list[str]:
        """What is not as it should be."""
        found = []
        if self.many_mib - self.base_mib >= MOST_MIB:
            found.append(f"memory grew by {self.many_mib - self.base_mib:.0f} MiB")
        if not abs(self.closure) <= MOST_CLOSURE:
            found.append(f"closure {self.closure:.1e}")
        share = min(self.hits_per_ray_of_few, 1.0)
        # A path has one hit of a start ray at most, as long as nothing scatters
        chance = SIGMAS * (share * (1 - share) * (1 / FEW + 1 / self.rays)) ** 0.5
        if abs(self.hits_per_ray - self.hits_per_ray_of_few) > chance:
            found.append(f"hits {self.hits_per_ray:.9f} per ray, {self.hits_per_ray_of_few:.9f} of few rays")
        return found

    def __str__(self) -> str:
        return (
            f"{self.rays:.3g} rays, {self.segments:.4g} segments, {self.paths} paths in {self.seconds:.0f} s "
            f"({self.segments / self.seconds / 1e6:.1f} Msegments/s)\n"
            f"memory: {self.base_mib:.0f} MiB with the scene loaded, {self.few_mib:.0f} MiB after {FEW:.3g} rays, "
            f"{self.many_mib:.0f} MiB at the end: {self.many_mib - self.base_mib:.0f} MiB over the base (bar "
            f"{MOST_MIB:.0f})\n"
            f"closure: {self.closure:.1e} (bar {MOST_CLOSURE:g})\n"
            f"hits of the strongest path per start ray: {self.hits_per_ray:.9f}, of few rays "
            f"{self.hits_per_ray_of_few:.9f}"
        )


def largest_mib() -> float:
    """Largest resident memory of the process so far."""
    return peak_mb() * 1e6 / 2**20


def many_rays(name: str, rays: int, progress: Callable[[str], None]) -> ManyRays:
    """Trace a scene with the path table on; `progress` takes lines of text."""
    scene = mistray.load(name)
    base = largest_mib()
    mistray.trace(scene, rays=PASS_LANES, max_scatters=0)  # compiles
    few = mistray.trace(scene, rays=FEW, max_scatters=0)
    few_mib = largest_mib()
    progress(f"{name}, {rays:.3g} rays: about {few.seconds * rays / FEW / 60:.1f} min")
    began = shown = time.monotonic()

    def advance(done: int, total: int) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= EVERY_S:
            shown = now
            left = (now - began) * (total / done - 1)
            progress(f"{100 * done / total:5.1f} %, {left / 60:.1f} min to go, {largest_mib():.0f} MiB")

    many = mistray.trace(scene, rays=rays, max_scatters=0, progress=advance)
    return ManyRays(
        base,
        few_mib,
        largest_mib(),
        time.monotonic() - began,
        many.energy.closure,
        many.paths[0].rays / rays,
        few.paths[0].rays / FEW,
        rays,
        many.segments,
        len(many.paths),
    )


def rows(quick: bool = False) -> list[Row]:
    """Memory and closure of `BENCH_RAYS` rays in a process of their own; 1e9 take many minutes and are run by hand."""
    rays = FEW if quick else BENCH_RAYS
    command = [sys.executable, __file__, "--rays", str(rays), "--json"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = ManyRays(**json.loads(printed.splitlines()[-1]))
    grown = found.many_mib - found.base_mib
    what = f"`plate`, path table on, {rays:.2g} rays"
    closure = abs(found.closure)
    return [
        Row(
            "memory",
            f"{what}: memory over the base",
            f"{grown:.0f} MiB",
            f"{MOST_MIB:.0f} MiB",
            grown / MOST_MIB,
            1.0,
            True,
        ),
        Row("closure", f"{what}: closure", f"{closure:.1e}", f"{MOST_CLOSURE:g}", closure / MOST_CLOSURE, 1.0, True),
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Memory and closure of a trace of very many rays.")
    parser.add_argument("--scene", default="plate", help="shipped scene or file (plate)")
    parser.add_argument("--rays", type=float, default=1e9, help="start rays, at most 4.29e9 (1e9)")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON in the last line")
    options = parser.parse_args()
    found = many_rays(options.scene, round(options.rays), lambda line: print(line, flush=True))
    print(json.dumps(asdict(found)) if options.json else found)
    for failure in found.failures:
        print(f"NOT AS IT SHOULD BE: {failure}", file=sys.stderr)
    sys.exit(1 if found.failures else 0)

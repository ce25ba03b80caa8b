"""Largest memory of jobs, each in a fresh process: what it takes above a small job of the same kind.

    python benchmarks/memory.py rays 1000000      # prints MB before and after

Many more rays, up to 1e9, take hours: ``python benchmarks/many_rays.py``.
"""

from __future__ import annotations

import argparse
import math
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from rows import Row, missing

MOST_MB = 1000.0
SETTLED = 1 << 22  # rays; some passes of a trace, as much memory as it takes
SAME = 1.2


def rays(count: int) -> None:
    """The Cooke triplet with its path table."""
    import mistray

    mistray.trace(mistray.load("cooke_triplet"), rays=count).paths.to_pandas()


def lsst(count: int) -> None:
    """The ghosts of Rubin/LSST here."""
    from telescopes import TELESCOPES, ours, scene_of

    ours(TELESCOPES[0], scene_of(TELESCOPES[0]), count)


def lsst_batoid(count: int) -> None:
    """The ghosts of Rubin/LSST by batoid, from its own rays."""
    import batoid
    from telescopes import TELESCOPES, optic

    around = max(8, round(math.sqrt(count)))
    beam = {"wavelength": 1e-9 * TELESCOPES[0].wavelength_nm, "theta_x": 0.0, "theta_y": math.radians(1.0)}
    bundle = batoid.RayVector.asPolar(optic=optic(TELESCOPES[0]), nrad=count // around, naz=around, **beam)
    optic(TELESCOPES[0]).traceSplit(bundle, minFlux=TELESCOPES[0].threshold)


JOBS = {"rays": (rays, 1000), "lsst": (lsst, 1000), "lsst_batoid": (lsst_batoid, 1000)}


def peak_mb() -> float:
    """
    Largest resident memory of this process so far, MB.

    Linux counts the memory of the process that has started this one into ru_maxrss, so that a small job of a large
    benchmark would seem as large as that; VmHWM is its own.
    """
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # bytes on macOS


def above(job: str, count: int) -> float:
    """Memory of a job in a fresh process above that after a small one, MB."""
    command = [sys.executable, __file__, job, str(count)]
    base, peak = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-2:]
    return float(peak) - float(base)


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `memory`."""
    few, many = (2_000, 4_000) if quick else (SETTLED, 10_000_000)
    few_mb, many_mb = above("rays", few), above("rays", many)
    what = "`cooke_triplet`, path table: memory above a trace of 1000 rays"
    yield Row(
        "rays", f"{what}, {many:g} over {few:g} rays", f"{many_mb:.0f} MB", f"{few_mb:.0f} MB",
        max(many_mb, 1.0) / max(few_mb, 1.0), SAME, small=True,
    )  # fmt: skip
    yield Row(
        "limit", f"{what}, {many:g} rays, against the bar", f"{many_mb:.0f} MB", f"{MOST_MB:.0f} MB",
        MOST_MB / max(many_mb, 1.0), 1.0,
    )  # fmt: skip
    what = "Rubin/LSST ghosts: memory above a job of 1000 rays"
    absent = missing("lsst", f"{what}, against batoid", "batoid")
    if absent:
        yield absent
        return
    count = 2_000 if quick else 50_000
    ours, theirs = above("lsst", count), above("lsst_batoid", count)
    yield Row(
        "lsst", f"{what}, {count} rays, against batoid", f"{ours:.0f} MB", f"{theirs:.0f} MB",
        max(theirs, 1.0) / max(ours, 1.0),
    )  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Largest memory of a job, MB: after a small one, and after it.")
    parser.add_argument("job", choices=sorted(JOBS))
    parser.add_argument("count", type=lambda text: int(float(text)), help="start rays")
    options = parser.parse_args()
    run, small = JOBS[options.job]
    run(small)
    base = peak_mb()
    run(options.count)
    print(f"{base:.1f} {peak_mb():.1f}")

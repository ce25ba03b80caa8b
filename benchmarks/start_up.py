"""How long mistray takes to start: the import, the help, and a fresh process to its first ghost table.

    python benchmarks/start_up.py

Wall time, which has the bars, and beside it the processor time of the process, which leaves out what the disk and other
programs take; the best of several. With an empty kernel cache it is one run, because compiling takes most of it.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rows import Row

IMPORT_S, HELP_S, COLD_S, WARM_S = 1.5, 0.3, 20.0, 4.0  # bars, wall time
REPEATS = 3
CACHES = ("MISTRAY_CACHE", "XDG_CACHE_HOME")  # would lead out of another home
MODULE = (sys.executable, "-m", "mistray")


@dataclass(frozen=True)
class Duration:
    """Wall time and CPU time of a process, s."""

    wall: float
    cpu: float

    def __str__(self) -> str:
        return f"{self.wall:.2f} s ({self.cpu:.2f} s of CPU)"


def run(*command: str, home: Path | None = None) -> Duration:
    """Run a process to its end; Dr.Jit keeps its kernels in `home`."""
    environment = dict(os.environ)
    if home is not None:
        environment = {key: value for key, value in environment.items() if key not in CACHES} | {"HOME": str(home)}
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return Duration(wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def best(*command: str, home: Path | None = None) -> Duration:
    """The least times of `REPEATS` runs."""
    runs = [run(*command, home=home) for _ in range(REPEATS)]
    return Duration(min(one.wall for one in runs), min(one.cpu for one in runs))


def cold_and_warm(*command: str) -> tuple[Duration, Duration]:
    """A run with an empty kernel cache, and the least times of runs with the cache that it leaves; all find targets."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        run(*command, home=home)  # stores what mistray itself keeps, such as importance targets
        shutil.rmtree(home / ".drjit")
        return run(*command, home=home), best(*command, home=home)


def rows(quick: bool = False, scene: str = "cooke_triplet") -> list[Row]:
    """The import, the help, and `mistray ghosts SCENE` with an empty and a warm kernel cache, against their bars."""
    ghosts = (*MODULE, "ghosts", scene, *(("--rays", "1000") if quick else ()))
    cold, warm = cold_and_warm(*ghosts)
    found = (
        ("import", "`import mistray`", best(sys.executable, "-c", "import mistray"), IMPORT_S),
        ("help", "`mistray --help`", best(*MODULE, "--help"), HELP_S),
        ("cold", f"`mistray ghosts {scene}` to its table, empty kernel cache", cold, COLD_S),
        ("warm", f"`mistray ghosts {scene}` to its table, warm kernel cache", warm, WARM_S),
    )
    return [
        Row(key, f"{what}, wall time against the bar", str(taken), f"{bar:g} s", taken.wall / bar, 1.0, small=True)
        for key, what, taken, bar in found
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Start-up time.")
    parser.add_argument("--scene", default="cooke_triplet", help="shipped scene or file (cooke_triplet)")
    for row in rows(scene=parser.parse_args().scene):
        print(row)

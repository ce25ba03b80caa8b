"""Runs the attack: ``PYTHONPATH=tests python -m attack``, some with ``--part options scenes`` or ``--every 10``."""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from number_fuzz import Worker

from attack import in_process, processes

Part = Callable[[Worker, int], dict[str, Callable[[], str]]]
PARTS: dict[str, Part] = {
    part.__name__: part
    for part in (in_process.options, in_process.scenes, in_process.files, in_process.bombs,
                 processes.interrupts, processes.surroundings)
}  # fmt: skip


def run_part(part: str, folder: Path, seed: int = 1, every: int = 1, first: int = 0) -> tuple[int, dict[str, str]]:
    """How many cases of a part were tried, one of `every` from the first on, and what failed, by the case's name."""
    worker, failures = Worker(folder), {}
    in_process.prepare(folder)
    try:
        cases = list(PARTS[part](worker, seed).items())[first::every]
        for name, run in cases:
            if wrong := run():
                failures[name] = wrong
    finally:
        worker.close()
    return len(cases), failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--part", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--every", type=int, default=1, help="run one of so many cases")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    failed = 0
    for part in given.part:
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            tried, failures = run_part(part, Path(folder), given.seed, given.every)
        for name, wrong in failures.items():
            print(f"{part}: {name}: {wrong}")
        print(f"{part:14}{len(failures):6d} of {tried:6d} failed{time.monotonic() - began:8.0f} s", flush=True)
        failed += len(failures)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())

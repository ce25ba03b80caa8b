"""
Runs the attack: ``PYTHONPATH=tests python -m attack``, some of it with ``--part options xml`` or ``--every 10``.

Prints each failure, and a table of what was tried and what failed, beside the same before it was mended. Ends with 1 if
anything failed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from attack.parts import BEFORE, COMMIT
from attack.run import run_part


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--part", nargs="+", choices=BEFORE, default=list(BEFORE))
    parser.add_argument("--every", type=int, default=1, help="run one of so many cases")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rows = []
    for part in given.part:
        with tempfile.TemporaryDirectory() as folder:
            done = run_part(part, Path(folder), given.seed, given.every, print_failures=True)
        tried, failed, _ = BEFORE[part]
        rows.append((part, tried, failed, done.tried, len(done.failures), done.seconds))
        print(f"{part}: {done.tried} tried, {len(done.failures)} failed, {done.seconds:.0f} s", flush=True)
    print(f"\n{'part':<14}{'at ' + COMMIT:>20}{'now':>20}{'s':>8}")
    for part, tried, failed, now, wrong, seconds in rows:
        print(f"{part:<14}{f'{failed} of {tried}':>20}{f'{wrong} of {now}':>20}{seconds:>8.0f}")
    return int(any(wrong for *_, wrong, _ in rows))


if __name__ == "__main__":
    sys.exit(main())

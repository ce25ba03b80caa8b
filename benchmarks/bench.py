"""Speed, as ratios taken in one run: ``make bench`` prints the table and keeps it.

Each ratio compares two things on the same machine a moment apart, the best of several alternating repeats, with every
kernel compiled before the clock starts. Figures in Mrays/s or Msegments/s depend on the machine; the ratios hardly do.

The table goes to benchmarks/README.md, with a figure, and as numbers to benchmarks/last.json. A ratio that got worse by
more than 15 % since the kept run is named, in a line after its row and again at the end.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import record as records
from machine import machine
from page import HEAD, write_page
from record import Kept, Record
from rows import Row

from mistray.errors import MistrayError

HERE = Path(__file__).parent
RECORD, PAGE, FIGURE = "last.json", "README.md", "growth.svg"
GOT_WORSE, NOT_MEASURED = 1, 1
# Name of a part, its module, and what it measures
PARTS = {
    "embree": ("intersection", "the ray tree against Mitsuba's own ray intersection (Embree)"),
    "batoid": ("telescopes", "ghosts of LSST, HSC and DECam against batoid"),
    "optiland": ("triplet", "ghosts of a Cooke triplet against optiland's sequences and non-sequential tracer"),
    "films": ("thinfilm", "thin films against tmm and tmm_fast"),
    "mie": ("spheres", "Mie spheres against miepython"),
    "pst": ("pst", "PST by both directions against forward runs"),
    "gradients": ("gradients", "gradients against the trace alone"),
    "coating_steps": ("coating_steps", "share of tracing in a coating optimisation"),
    "modes": ("modes", "path table, coatings and polarisation against plain traces"),
    "scatter": ("scatter", "scatter models and a scattering camera"),
    "systems": ("systems", "a housing of triangles, freeforms and segments against lenses alone"),
    "sources": ("sources", "a point source against a collimated beam"),
    "start": ("start_up", "import, help, first ghost table with an empty and a filled kernel cache"),
    "waiting": ("waiting", "small traces, moves of the explorer, first kernels, the PST of the Cassegrain"),
    "memory": ("memory", "largest memory"),
    "growth": ("growth", "growth with rays, surfaces, paths, layers, detectors, wavelengths and threads"),
}


def rows_of(part: str, quick: bool) -> Iterator[Row]:
    """Rows of a part; what goes wrong ends the part with a row that says so, and not the run."""
    module, what = PARTS[part]
    try:
        yield from importlib.import_module(module).rows(quick)
    except Exception as error:  # of any program: the other rows must not be lost
        text = " ".join(f"{type(error).__name__}: {error}".split()).replace("|", "/")
        yield Row("failed", what, "", f"FAILED: {text[:300]}", math.nan, failed=True)


def run(parts: Sequence[str], quick: bool, before: Record) -> tuple[list[Kept], list[str]]:
    """
    Measure and print, row by row.

    Returns
    -------
    list of Kept
        The rows.
    list of str
        What got worse since the kept run.
    """
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    kept, slower = [], []
    print(*HEAD, sep="\n")
    for part in parts:
        started = time.perf_counter()
        for measured in rows_of(part, quick):
            # Bars are for the full size
            row = replace(measured, bar=None) if quick else measured
            print(row, flush=True)
            one = Kept(part, row, day, machine())
            line = "" if quick else records.worse(row, before[one.name].row if one.name in before else None)
            if line:
                print(line, flush=True)
                slower.append(line)
            kept.append(one)
        if sys.stderr.isatty():
            print(f"{part}: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    return kept, slower


def arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """What to measure and to keep."""
    listing = "\n".join(f"  {part:15}{what}" for part, (_, what) in PARTS.items())
    parser = argparse.ArgumentParser(
        prog="bench.py",
        description=__doc__,
        epilog=f"parts:\n{listing}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, metavar="PART", help="these parts; kept rows of the others stay"
    )
    parser.add_argument(
        "--quick", action="store_true", help="a few rays once: shows that it runs; no bars, nothing is kept or compared"
    )
    parser.add_argument("--no-write", action="store_true", help="print and compare only, keep nothing")
    parser.add_argument(
        "--strict",
        action="store_true",
        help=f"if a ratio got worse by more than 15 %%, keep nothing and exit with {GOT_WORSE}",
    )
    parser.add_argument(
        "--folder", type=Path, default=HERE, help="of the kept record and its page (default: that of bench.py)"
    )
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """
    Measure, print, compare, keep.

    Returns
    -------
    int
        0; 1 if a row could not be measured although its program is installed, or with ``--strict`` if a ratio got
        worse; 2 after one line on stderr if the kept record cannot be read.
    """
    options = arguments(argv)
    try:
        before = {} if options.quick else records.read(options.folder / RECORD)
        parts = [part for part in PARTS if part in (options.only or PARTS)]
        kept, slower = run(parts, options.quick, before)
        failed = [one for one in kept if one.row.failed]
        if slower:
            print(f"\n{len(slower)} of {len(kept)} ratios got worse by more than 15 %:", *slower, sep="\n")
        if failed:
            print(
                f"\n{len(failed)} rows could not be measured:", *(f"{k.name}: {k.row.other}" for k in failed), sep="\n"
            )
        keep_nothing = options.quick or options.no_write or (options.strict and slower)
        if not keep_nothing:
            record = records.merged(before, parts, kept)
            records.write(options.folder / RECORD, record)
            write_page(options.folder / PAGE, options.folder / FIGURE, record, PARTS)
    except MistrayError as error:
        print(f"bench.py: error: {error}", file=sys.stderr)
        return 2
    return NOT_MEASURED if failed else GOT_WORSE if options.strict and slower else 0


if __name__ == "__main__":
    sys.exit(main())

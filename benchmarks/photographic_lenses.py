"""Photographic lenses of a folder of .lens files, as a table by outcome.

    python benchmarks/photographic_lenses.py FOLDER
    python benchmarks/photographic_lenses.py FOLDER --csv lenses.csv --trace 600

Each file is imported. Its focal length and F-number are compared with those that it states, and rays of the axis are
followed on the host through the clear radii of the scene: of those that pass the stop 95 % must meet the detector.
With --trace, lenses in random order are traced as scenes for so many seconds, and must list ghosts.

The files of https://github.com/petermercell/flaresim_nuke, folder `lenses`, are what the reader was written for.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.prescription import Built, read_flaresim
from mistray.prescription.closing.system import build
from mistray.prescription.sequential.rays import trace

ARRIVING = 0.95
FOCAL_LENGTH = 0.02  # relative
F_NUMBER = 0.1  # relative
RAYS = 2000
SEED = 1


@dataclass
class Lens:
    """What became of a file; shares and numbers are NaN where there are none."""

    file: str
    outcome: str
    reason: str = ""
    focal_mm: float = math.nan
    stated_focal_mm: float = math.nan
    f_number: float = math.nan
    stated_f_number: float = math.nan
    arriving: float = math.nan


def stated(path: Path) -> tuple[float, float]:
    """Focal length and F-number that a file states; NaN without."""
    text = path.read_text(encoding="utf-8")
    focal = re.search(r"(?m)^focal_length:\s*([\d.]+)", text)
    number = re.search(r"(?m)^#.*elements, f/([\d.]+)", text)
    return float(focal[1]) if focal else math.nan, float(number[1]) if number else math.nan


def arriving(built: Built) -> float:
    """Share of the light on the axis that passes the stop and then all clear radii to the detector."""
    lens, prescription = built.lens, built.prescription
    source, detector = prescription.source, prescription.detector
    assert source is not None
    assert detector is not None
    radius = getattr(source, "radius", None) or built.first_order.epd / 2
    turn = np.random.default_rng(SEED).random((2, RAYS))
    r, angle = radius * np.sqrt(turn[0]), 2 * math.pi * turn[1]
    start = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(RAYS, built.first_order.entrance_pupil_z)])
    hits, _ = trace(lens, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    clear = {surface.name: surface.outer_radius for surface in prescription.surfaces}
    alive, passed = np.ones(RAYS, dtype=bool), 0
    for row, (x, y, _) in zip(lens.rows, np.moveaxis(hits, 2, 1), strict=True):
        r = np.hypot(x, y)
        if row.kind == "image":
            assert detector.half_width is not None
            alive &= (np.abs(x) <= detector.half_width) & (np.abs(y) <= detector.half_width)
            continue
        alive &= r <= clear.get(f"S{row.number}", math.inf)
        if row.stop:
            alive &= r <= lens.aperture / 2 * (1 + 1e-9)
            passed = int(np.sum(alive))
    return float(np.sum(alive)) / passed if passed else 0.0


def looked_at(path: Path) -> Lens:
    """What becomes of a file."""
    if path.stat().st_size == 0:
        return Lens(path.name, "empty")
    focal, number = stated(path)
    try:
        built = build(read_flaresim(path))
    except MistrayError as error:
        return Lens(
            path.name,
            "refused",
            str(error).replace(f"FlareSim file '{path.name}'", "").lstrip(":, "),
            math.nan,
            focal,
            math.nan,
            number,
        )
    data = built.first_order
    share = arriving(built)
    result = Lens(path.name, "", "", data.efl, focal, data.f_number, number, share)
    notes = [note for note in built.notes if "cross at" in note]
    if share < ARRIVING:
        result.outcome = "too little light arrives"
        result.reason = "; ".join(notes) or "clear apertures behind the stop take it"
    elif math.isnan(focal) or abs(data.efl / focal - 1) <= FOCAL_LENGTH:
        result.outcome = "as stated"
    else:
        (result.reason,) = [note for note in built.notes if note.startswith("focal length")]
        result.outcome = "with a note on its focal length"
    return result


def traced(path: Path) -> tuple[int, float]:
    """Ghosts that a trace of few rays lists, and the share of the light in the pupil that is detected."""
    import mistray
    from mistray.prescription import from_flaresim

    t = mistray.trace(from_flaresim(path).to_scene(), rays=RAYS, max_reflections=2)
    ghosts = sum(1 for one in t.paths if one.events.count(":R") > 0)
    return ghosts, t.energy.detected_W / t.pupil_W


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--csv", type=Path, help="write a line for each file there")
    parser.add_argument("--trace", type=float, default=0.0, help="seconds for traces")
    options = parser.parse_args()
    files = sorted(path for path in options.folder.rglob("*") if path.is_file() and path.suffix != ".md")
    lenses = []
    for number, path in enumerate(files, 1):
        lenses.append(looked_at(path))
        print(f"\r{number} of {len(files)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    if options.csv:
        with options.csv.open("w", newline="", encoding="utf-8") as out:
            writer = csv.DictWriter(out, asdict(lenses[0]))
            writer.writeheader()
            writer.writerows(map(asdict, lenses))
    for outcome, count in Counter(lens.outcome for lens in lenses).most_common():
        print(f"{count:6}  {outcome}")
    known = [lens for lens in lenses if lens.f_number > 0 and lens.stated_f_number > 0]
    close = [lens for lens in known if abs(lens.f_number / lens.stated_f_number - 1) <= F_NUMBER]
    print(f"{len(close):6}  of {len(known)} that state an F-number have it within {100 * F_NUMBER:g} %")
    for lens in lenses:
        if lens.outcome in ("refused", "too little light arrives"):
            print(f"{lens.file}: {lens.outcome}: {lens.reason}")
    readable = [path for path, lens in zip(files, lenses, strict=True) if lens.arriving >= ARRIVING]
    ends, order = time.monotonic() + options.trace, np.random.default_rng(SEED).permutation(len(readable))
    found: list[tuple[int, float]] = []
    for place in map(int, order):
        if time.monotonic() > ends:
            break
        found.append(traced(readable[place]))
        print(f"{readable[place].name}: {found[-1][0]} ghosts, {100 * found[-1][1]:.1f} % detected", flush=True)
    if found:
        print(f"{len(found)} traced, {sum(ghosts > 0 for ghosts, _ in found)} with ghosts")


if __name__ == "__main__":
    main()

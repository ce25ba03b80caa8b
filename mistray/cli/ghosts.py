"""`mistray ghosts`."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import RAW, count, field, finite, positive
from mistray.cli.ghosts_json import WORST_SHOWN, as_json

if TYPE_CHECKING:
    from mistray.analysis.ghosts import Progress


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "ghosts",
        help="trace the ghosts of a scene and rank them",
        description="Trace a scene at one or more field angles, list all paths to the detector and rank the stray\n"
        "ones by RMS irradiance P/(π r_rms²), relative to the direct image on axis.",
        epilog="examples:\n"
        "  mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out\n"
        "  mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json",
        formatter_class=RAW,
    )
    parser.add_argument(
        "scene", metavar="SCENE", help="scene XML file, or the name of a shipped scene such as phone_camera"
    )
    source = parser.add_argument_group("source (default: as the scene says)")
    source.add_argument("--field-deg", type=field, nargs="+", metavar="DEG", help="field angles, degrees")
    source.add_argument("--azimuth-deg", type=finite, metavar="DEG", help="azimuth of the field about z, degrees")
    source.add_argument("--wavelength-nm", type=positive, metavar="NM", help="wavelength, nm")
    tracing = parser.add_argument_group("ray tree (default: as the scene says, else what stands in brackets)")
    tracing.add_argument("--rays", type=count, metavar="N", help="start rays at each field (1e6)")
    tracing.add_argument("--max-reflections", type=count, metavar="N",
                         help="reflections on one path, those of mirrors and TIR not counted (2)")  # fmt: skip
    tracing.add_argument("--max-events", type=count, metavar="N", help="surfaces met on one path (64)")
    tracing.add_argument("--flux-threshold", type=finite, metavar="F",
                         help="flux below which a ray ends, relative to its start ray (1e-8)")  # fmt: skip
    tracing.add_argument("--splitting", choices=("split", "one"),
                         help="follow both rays at a surface, or one of them by chance (split)")  # fmt: skip
    tracing.add_argument("--below-threshold", choices=("cut", "roulette"),
                         help="end a ray below the threshold, or play unbiased roulette (cut)")  # fmt: skip
    tracing.add_argument("--seed", type=count, metavar="N", help="seed of the random numbers (0)")
    tracing.add_argument("--variant", metavar="NAME", help="Mitsuba variant, such as cuda_ad_rgb (llvm_ad_rgb)")
    output = parser.add_argument_group("output")
    output.add_argument("--out", type=Path, metavar="DIR", help="write report.html, CSV, PNG and path-sort files there")
    output.add_argument("--json", action="store_true", help="print JSON instead of the tables")
    output.add_argument("--quiet", action="store_true", help="no progress, no tables")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from mistray._mitsuba_compat import silence_warnings
    from mistray._variant import ensure_variant

    ensure_variant(options.variant)  # settles libLLVM before anything imports Mitsuba
    silence_warnings()
    from mistray.analysis import ghosts
    from mistray.report import main_table, writable_directory, write_all
    from mistray.scene import load

    if options.out is not None:
        writable_directory(options.out)
    scene = load(options.scene)
    with _progress(options) as progress:
        report = ghosts(
            scene,
            fields_deg=options.field_deg,
            wavelength_nm=options.wavelength_nm,
            azimuth_deg=options.azimuth_deg,
            rays=options.rays,
            max_reflections=options.max_reflections,
            max_events=options.max_events,
            flux_threshold=options.flux_threshold,
            splitting=options.splitting,
            below_threshold=options.below_threshold,
            seed=options.seed,
            progress=progress,
        )
    files = []
    if options.out is not None:
        files = write_all(report, options.out, _title(options.scene), options.command_line)
    if options.json:
        print(json.dumps(as_json(report, files), indent=2, allow_nan=False))
    elif not options.quiet:
        print(main_table(report, WORST_SHOWN))
        if files:
            print(f"\n{len(files)} files in {options.out}; open {options.out / 'report.html'}")
    return 0


def _title(scene: str) -> str:
    """Name of a scene: that of its file, or of its folder if the file is called scene.xml."""
    path = Path(scene).resolve()
    return path.parent.name if path.name == "scene.xml" else path.stem


@contextlib.contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Progress | None]:
    """A bar on stderr when that is a terminal."""
    if options.quiet or not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    form = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
    with tqdm(desc="tracing", total=1.0, bar_format=form, leave=False, file=sys.stderr) as bar:

        def advance(done: float, total: float) -> None:
            bar.update(max(done / total - bar.n, 0.0))

        yield advance

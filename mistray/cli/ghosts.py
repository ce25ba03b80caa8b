"""`mistray ghosts`."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import RAW, count, field, finite, positive
from mistray.cli.ghosts_json import WORST_SHOWN, as_json
from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray.analysis.ghosts import Progress
    from mistray.report import Look


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "ghosts",
        help="trace the ghosts and the scattered light of a scene and rank them",
        description="Trace a scene at one or more field angles, list all paths to the detector and rank the stray\n"
        "ones by RMS irradiance P/(π r_rms²), relative to the direct image on axis.",
        epilog="examples:\n"
        "  mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out\n"
        "  mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json\n"
        "  mistray ghosts scene.xml --max-scatters 2 --max-reflections 1 --aimed-rays 4 --out out\n"
        "  mistray ghosts scene.xml --wavelength-nm 450 550 650 --weights 1 2 1 --colour --out out",
        formatter_class=RAW,
    )
    parser.add_argument(
        "scene", metavar="SCENE", help="scene XML file, or the name of a shipped scene such as phone_camera"
    )
    source = parser.add_argument_group("source (default: as the scene says)")
    source.add_argument("--field-deg", type=field, nargs="+", metavar="DEG", help="field angles, degrees")
    source.add_argument("--azimuth-deg", type=finite, metavar="DEG", help="azimuth of the field about z, degrees")
    source.add_argument("--wavelength-nm", type=positive, nargs="+", metavar="NM", help="wavelengths, nm")
    source.add_argument("--weights", type=finite, nargs="+", metavar="W",
                        help="shares of the flux, one for each of --wavelength-nm (equal)")  # fmt: skip
    tracing = parser.add_argument_group("ray tree (default: as the scene says, else what stands in brackets)")
    tracing.add_argument("--rays", type=count, metavar="N", help="start rays at each field (1e6)")
    tracing.add_argument("--max-reflections", type=count, metavar="N",
                         help="reflections on one path, those of mirrors and TIR not counted (2)")  # fmt: skip
    tracing.add_argument("--max-generations", type=count, metavar="N",
                         help="reflections and scatter events together on one path (no limit)")  # fmt: skip
    tracing.add_argument("--max-events", type=count, metavar="N", help="surfaces met on one path (64)")
    tracing.add_argument("--flux-threshold", type=finite, metavar="F",
                         help="flux below which a ray ends, relative to its start ray (1e-8)")  # fmt: skip
    tracing.add_argument("--splitting", choices=("split", "one"),
                         help="follow both rays at a surface, or one of them by chance (split)")  # fmt: skip
    tracing.add_argument("--below-threshold", choices=("cut", "roulette"),
                         help="end a ray below the threshold, or play unbiased roulette (cut)")  # fmt: skip
    tracing.add_argument("--seed", type=count, metavar="N", help="seed of the random numbers (0)")
    tracing.add_argument("--polarization", choices=("unpolarized", "stokes"),
                         help="means of s and p at every hit, or Stokes vectors along paths (unpolarized)")  # fmt: skip
    tracing.add_argument("--variant", metavar="NAME", help="Mitsuba variant, such as cuda_ad_rgb (llvm_ad_rgb)")
    scatter = parser.add_argument_group("scatter (default: as the scene says, else what stands in brackets)")
    scatter.add_argument("--max-scatters", type=count, metavar="N", help="scatter events on one path; 0: none (1)")
    scatter.add_argument("--max-optical-scatters", type=count, metavar="N",
                         help="those of them at surfaces that transmit (no limit)")  # fmt: skip
    scatter.add_argument("--max-random-scatters", type=count, metavar="N",
                         help="those of them that are not aimed at a target (no limit)")  # fmt: skip
    scatter.add_argument("--scatter-rays", type=count, metavar="N", help="rays scattered at random at every hit (1)")
    scatter.add_argument("--aimed-rays", type=count, metavar="N",
                         help="rays aimed at the targets at every hit, to either side; 0: none (1)")  # fmt: skip
    scatter.add_argument("--aim", choices=("auto", "targets", "none"),
                         help="aim at the detector and targets of the scene, only at these, or not (auto)")  # fmt: skip
    scatter.add_argument("--scatter-threshold", type=finite, metavar="F",
                         help="flux below which a scattered ray ends, relative to its start (1e-4)")  # fmt: skip
    output = parser.add_argument_group("output")
    output.add_argument("--out", type=Path, metavar="DIR", help="write report.html, CSV, PNG and path-sort files there")
    output.add_argument("--per-wavelength", action="store_true", help="add paths and ledgers at each wavelength")
    output.add_argument("--json", action="store_true", help="print JSON instead of the tables")
    output.add_argument("--quiet", action="store_true", help="no progress, no tables")
    colour = parser.add_argument_group("colour pictures (need --out and three wavelengths or more)")
    colour.add_argument("--colour", action="store_true", help="draw the ghosts as a photograph would show them")
    colour.add_argument("--stops", type=finite, metavar="S",
                        help="exposure, stops over the one that just fills the brightest channel (0)")  # fmt: skip
    colour.add_argument("--reference", choices=("ghosts", "direct"),
                        help="brightest pixel of the stray light, or of the direct image on axis (ghosts)")  # fmt: skip
    colour.add_argument("--white", choices=("source", "D65"),
                        help="what comes out as grey: the light of the source, or D65 (source)")  # fmt: skip
    colour.add_argument("--block", type=count, metavar="N",
                        help="pixels averaged along each side; 0: as many as the noise asks for (0)")  # fmt: skip
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from mistray._mitsuba_compat import silence_warnings
    from mistray._variant import ensure_variant

    ensure_variant(options.variant)  # settles libLLVM before anything imports Mitsuba
    silence_warnings()
    from mistray.analysis import ghosts
    from mistray.report import main_table, writable_directory, write_all
    from mistray.report.colour import check_wavelengths
    from mistray.scene import load
    from mistray.trace import Settings

    _check_weights(options)
    look = _look(options)
    if options.out is not None:
        writable_directory(options.out)
    scene = load(options.scene)
    if look is not None:
        check_wavelengths(options.wavelength_nm or _own_wavelengths(scene))
    with _progress(options) as progress:
        report = ghosts(
            scene,
            fields_deg=options.field_deg,
            wavelength_nm=options.wavelength_nm,
            weights=options.weights,
            azimuth_deg=options.azimuth_deg,
            progress=progress,
            **{setting.name: getattr(options, setting.name) for setting in fields(Settings)},
        )
    files = []
    if options.out is not None:
        files = write_all(
            report, options.out, _title(options.scene), options.command_line, options.per_wavelength, look
        )
    if options.json:
        print(json.dumps(as_json(report, files, options.per_wavelength), indent=2, allow_nan=False))
    elif not options.quiet:
        print(main_table(report, WORST_SHOWN, options.per_wavelength))
        if files:
            print(f"\n{len(files)} files in {options.out}; open {options.out / 'report.html'}")
    return 0


def _check_weights(options: argparse.Namespace) -> None:
    if options.weights is None:
        return
    if options.wavelength_nm is None:
        raise MistrayError("--weights without --wavelength-nm; give one wavelength for each weight")
    if len(options.weights) != len(options.wavelength_nm):
        raise MistrayError(
            f"--weights has {len(options.weights)} values for {len(options.wavelength_nm)} of --wavelength-nm; "
            "give one weight for each wavelength"
        )


def _look(options: argparse.Namespace) -> Look | None:
    """How colour pictures shall look; None if there shall be none."""
    given = {key: getattr(options, key) for key in ("stops", "reference", "white", "block")}
    given = {key: value for key, value in given.items() if value is not None}
    if not options.colour:
        if given:
            raise MistrayError(f"--{next(iter(given))} is about colour pictures; add --colour, or leave it out")
        return None
    if options.out is None:
        raise MistrayError("--colour draws pictures; say with --out where they shall go")
    from mistray.report import Look

    return Look(**given)


def _own_wavelengths(scene: Any) -> list[float]:
    return sorted({float(nm) for emitter in scene.emitters() for nm in getattr(emitter, "wavelengths_nm", ())})


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

"""The command line: parses, calls the functions of the package, prints."""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import math
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray.analysis.ghosts import GhostReport, Progress

BAD_INPUT = 2
INTERRUPTED = 130
WORST_SHOWN = 4

_RAW = argparse.RawDescriptionHelpFormatter


class _Parser(argparse.ArgumentParser):
    """Reports a wrong argument as any other bad input: in one line."""

    def error(self, message: str) -> NoReturn:
        raise MistrayError(f"{message}; see '{self.prog} --help'")


def main(argv: Sequence[str] | None = None) -> int:
    """
    Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default: those of the process.

    Returns
    -------
    int
        Exit code: 0, or 2 after one line on stderr that says what is wrong with the input.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError):  # a replaced stream, as in a notebook, has no encoding to speak of
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        options = _parser().parse_args(arguments)
        options.command_line = shlex.join(["mistray", *arguments])
        code = int(options.run(options))
        sys.stdout.flush()
        return code
    except MistrayError as error:
        return _fail(str(error))
    except BrokenPipeError:  # the reader, such as head, has seen enough; nothing may be flushed to it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (RuntimeError, OSError, MemoryError) as error:  # Mitsuba, Dr.Jit, files
        return _fail(f"{type(error).__name__}: {error}" if not isinstance(error, RuntimeError) else str(error))
    except KeyboardInterrupt:
        print("mistray: interrupted, nothing was written", file=sys.stderr)
        return INTERRUPTED


def _fail(message: str) -> int:
    print(f"mistray: error: {' '.join(message.split())}", file=sys.stderr)
    return BAD_INPUT


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="mistray",
        description="Stray-light analysis of optical systems. Units: mm, nm (wavelengths), degrees, W.",
        epilog="example:\n  mistray ghosts phone_camera --field-deg 0 10 20 --out out",
        formatter_class=_RAW,
    )
    parser.add_argument("--version", action="version", version=f"mistray {importlib.metadata.version('mistray')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_doctor(commands)
    _add_import(commands)
    _add_ghosts(commands)
    return parser


def _add_doctor(commands: Any) -> None:
    parser = commands.add_parser(
        "doctor",
        help="say what is installed, what is missing and how to get it",
        description="Look for LLVM, Mitsuba and its variants, the packages mistray needs and a GPU.",
        epilog="example:\n  mistray doctor",
        formatter_class=_RAW,
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=_doctor)


def _add_import(commands: Any) -> None:
    parser = commands.add_parser(
        "import",
        help="turn a lens file into a scene",
        description="Read a lens and write it as a scene (Mitsuba XML).",
        epilog="examples:\n"
        "  mistray import scenes/phone_camera/prescription.json -o scene.xml\n"
        "  mistray import LSST_r.yaml -o lsst.xml --wavelength-nm 620",
        formatter_class=_RAW,
    )
    parser.add_argument("lens", metavar="LENS", help="camera lens as JSON (like scenes/phone_camera), or batoid YAML")
    parser.add_argument(
        "-o", "--output", metavar="XML", type=Path, help="file to write (default: LENS with .xml, in this folder)"
    )
    parser.add_argument(
        "--wavelength-nm", type=_positive, metavar="NM", help="wavelength of the source, nm (batoid: required)"
    )
    parser.add_argument("--variant", metavar="NAME", help="design variant that the JSON file holds, such as R13=5.272")
    parser.set_defaults(run=_import)


def _add_ghosts(commands: Any) -> None:
    parser = commands.add_parser(
        "ghosts",
        help="trace the ghosts of a scene and rank them",
        description="Trace a scene at one or more field angles, list all paths to the detector and rank the stray\n"
        "ones by RMS irradiance P/(π r_rms²), relative to the direct image on axis.",
        epilog="examples:\n"
        "  mistray ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --out out\n"
        "  mistray ghosts scene.xml --wavelength-nm 620 --rays 1e7 --json",
        formatter_class=_RAW,
    )
    parser.add_argument(
        "scene", metavar="SCENE", help="scene XML file, or the name of a shipped scene such as phone_camera"
    )
    source = parser.add_argument_group("source (default: as the scene says)")
    source.add_argument("--field-deg", type=_field, nargs="+", metavar="DEG", help="field angles, degrees")
    source.add_argument("--azimuth-deg", type=_finite, metavar="DEG", help="azimuth of the field about z, degrees")
    source.add_argument("--wavelength-nm", type=_positive, metavar="NM", help="wavelength, nm")
    tracing = parser.add_argument_group("ray tree (default: as the scene says, else what stands in brackets)")
    tracing.add_argument("--rays", type=_count, metavar="N", help="start rays at each field (1e6)")
    tracing.add_argument("--max-reflections", type=_count, metavar="N",
                         help="reflections on one path, those of mirrors and TIR not counted (2)")  # fmt: skip
    tracing.add_argument("--max-events", type=_count, metavar="N", help="surfaces met on one path (64)")
    tracing.add_argument("--flux-threshold", type=_finite, metavar="F",
                         help="flux below which a ray ends, relative to its start ray (1e-8)")  # fmt: skip
    tracing.add_argument("--splitting", choices=("split", "one"),
                         help="follow both rays at a surface, or one of them by chance (split)")  # fmt: skip
    tracing.add_argument("--below-threshold", choices=("cut", "roulette"),
                         help="end a ray below the threshold, or play unbiased roulette (cut)")  # fmt: skip
    tracing.add_argument("--seed", type=_count, metavar="N", help="seed of the random numbers (0)")
    tracing.add_argument("--variant", metavar="NAME", help="Mitsuba variant, such as cuda_ad_rgb (llvm_ad_rgb)")
    output = parser.add_argument_group("output")
    output.add_argument("--out", type=Path, metavar="DIR", help="write report.html, CSV, PNG and path-sort files there")
    output.add_argument("--json", action="store_true", help="print JSON instead of the tables")
    output.add_argument("--quiet", action="store_true", help="no progress, no tables")
    parser.set_defaults(run=_ghosts)


def _doctor(options: argparse.Namespace) -> int:
    from mistray import doctor

    return doctor.main(as_json=options.json)


def _import(options: argparse.Namespace) -> int:
    lens = Path(options.lens)
    if not lens.is_file():
        raise MistrayError(f"lens '{lens}': no such file; check the path")
    output = options.output or Path(lens.with_suffix(".xml").name)
    if not output.parent.is_dir():
        raise MistrayError(f"output '{output}': the folder '{output.parent}' does not exist; make it first")
    if lens.suffix == ".json":
        prescription = _from_json(lens, options)
    elif lens.suffix in (".yaml", ".yml"):
        prescription = _from_batoid(lens, options)
    else:
        raise MistrayError(f"lens '{lens}': files of type '{lens.suffix}' cannot be read; give .json or batoid .yaml")
    draft = output.with_name(f".{output.name}.draft")
    try:
        prescription.to_xml(draft)
        draft.replace(output)
    finally:
        draft.unlink(missing_ok=True)
    count = sum(1 for _ in prescription.shapes())
    print(f"{output}: {count} surfaces; next: {shlex.join(['mistray', 'ghosts', str(output)])}")
    return 0


def _from_json(lens: Path, options: argparse.Namespace) -> Any:
    from mistray.prescription import from_json

    prescription = from_json(lens, variant=options.variant)
    if options.wavelength_nm is None:
        return prescription
    return prescription.with_source(wavelength_nm=(options.wavelength_nm,), weights=None)


def _from_batoid(lens: Path, options: argparse.Namespace) -> Any:
    if options.variant is not None:
        raise MistrayError(f"--variant {options.variant}: batoid files hold no variants; leave it out")
    if options.wavelength_nm is None:
        raise MistrayError(f"lens '{lens}': batoid media depend on the wavelength; give --wavelength-nm")
    try:
        import batoid
    except ImportError:
        raise MistrayError("batoid is not installed; run: pip install 'mistray[batoid]'") from None
    from mistray.prescription import from_batoid

    try:
        optic = batoid.Optic.fromYaml(str(lens))
    except Exception as error:  # yaml and batoid raise all kinds
        raise MistrayError(f"lens '{lens}': {error}; it must be a batoid YAML file") from None
    return from_batoid(optic, wavelength_nm=options.wavelength_nm)


def _ghosts(options: argparse.Namespace) -> int:
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
        print(json.dumps(_as_json(report, files), indent=2, allow_nan=False))
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


def _as_json(report: GhostReport, files: Sequence[Path]) -> dict[str, Any]:
    from mistray.report.tables import summary_frame, warnings

    fields = []
    for row in summary_frame(report).to_dict("records"):
        energy = report[row["field_deg"]].energy
        row["energy"] = {
            "launched_W": energy.launched_W,
            "detected_W": energy.detected_W,
            "detected_se_W": energy.detected_se_W,
            "absorbed_W": {name: {"value": power, "se": se} for name, (power, se) in energy.absorbed.items()},
            "escaped_W": energy.escaped_W,
            "escaped_se_W": energy.escaped_se_W,
            "cut_W": dict(energy.cut),
            "closure": energy.closure,
        }
        row["worst_paths"] = report.top(row["field_deg"], WORST_SHOWN).to_dict("records")
        fields.append(row)
    settings = {key: value for key, value in next(iter(report.values())).settings.items() if key != "field_deg"}
    answer = {
        "settings": settings,
        "fields": fields,
        "warnings": warnings(report),
        "files": [str(file) for file in files],
    }
    return dict(_plain(answer))


def _plain(value: Any) -> Any:
    """The value with what JSON knows: numpy scalars as numbers, NaN and infinity as null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number")
    return value


def _positive(text: str) -> float:
    value = _finite(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} must be positive")
    return value


def _field(text: str) -> float:
    value = _finite(text)
    if not -90 < value < 90:
        raise argparse.ArgumentTypeError(f"{text} must lie between -90 and 90 degrees")
    return value


def _count(text: str) -> int:
    value = _finite(text)
    if value < 0 or value != int(value):
        raise argparse.ArgumentTypeError(f"{text} must be a whole number that is not negative, such as 1e6")
    return int(value)

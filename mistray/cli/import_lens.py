"""`mistray import`."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from mistray.cli.arguments import RAW, positive
from mistray.errors import MistrayError


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "import",
        help="turn a lens file into a scene",
        description="Read a lens and write it as a scene (Mitsuba XML).",
        epilog="examples:\n"
        "  mistray import scenes/phone_camera/prescription.json -o scene.xml\n"
        "  mistray import LSST_r.yaml -o lsst.xml --wavelength-nm 620",
        formatter_class=RAW,
    )
    parser.add_argument("lens", metavar="LENS", help="camera lens as JSON (like scenes/phone_camera), or batoid YAML")
    parser.add_argument(
        "-o", "--output", metavar="XML", type=Path, help="file to write (default: LENS with .xml, in this folder)"
    )
    parser.add_argument(
        "--wavelength-nm", type=positive, metavar="NM", help="wavelength of the source, nm (batoid: required)"
    )
    parser.add_argument("--variant", metavar="NAME", help="design variant that the JSON file holds, such as R13=5.272")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
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
    prescription.to_xml(output)
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

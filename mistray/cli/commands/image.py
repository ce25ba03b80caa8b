"""`mistray image`."""

from __future__ import annotations

from mistray.cli.command import Command, Group, Option
from mistray.cli.options import Options
from mistray.cli.progress import progress_bar
from mistray.cli.shared import DETECTOR, MACHINE, SCENE, SOURCE, SPECTRUM, SURFACES, TABLE_FORMATS, output
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, FREQUENCY_PER_MM, PLACE_MM, PUPIL_CELLS

# What --out writes
FILES = (
    "report.html", "image_quality.*", "mtf.*", "zernikes.*", "psf.png", "opd.png", "spots.png", "energy.png",
    "fields.png",
)  # fmt: skip

# fmt: off
COMMAND = Command(
    "image",
    "image quality of the direct light: spots, wavefront, PSF, MTF, encircled energy, distortion",
    "Trace a grid of rays along the design path of a scene, in float64, within its stops, rims and vanes, and compute\n"
    "the image of a point at each field. Ghosts and scattered light are left out.",
    (
        "mistray image cooke_triplet --field-deg 0 14 20 --frequencies 20 40 --out out",
        "mistray image scene.xml --field-mm 0 5 --wavelength-nm 486 588 656 --weights 1 2 1",
        "mistray image newtonian --field-deg 0 0.3 --json",
    ),
    (
        SCENE,
        Group("source (default: as the scene says)", (
            Option("--field-deg", "field angles, degrees (0)", FIELD_DEG, "DEG", "+"),
            Option("--field-mm", "object heights of a near source instead, mm", PLACE_MM, "MM", "+"),
            Option("--azimuth-deg", "azimuth of the field about z, degrees", AZIMUTH_DEG, "DEG"),
            *SPECTRUM,
            SOURCE,
            DETECTOR,
        )),
        Group("pupil", (
            Option("--stop", "surface that limits the light (that at which most light next to the pupil ends)",
                   metavar="ID"),
            Option("--grid", "cells across the pupil (64, or as many as the wavefront asks for, up to 512)",
                   PUPIL_CELLS, "N"),
            Option("--frequencies", "of the MTF in the table, 1/mm (three below the cut-off)",
                   FREQUENCY_PER_MM, "F", "+"),
            *MACHINE,
        )),
        SURFACES,
        output("report.html, CSV, JSON and PNG files", FILES, formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.start()
    from mistray.analysis.image_quality.image_quality import image_quality
    from mistray.report.image_quality import quality_record, quality_report, quality_text

    if options.field_mm and options.field_deg:
        raise MistrayError("--field-deg and --field-mm are given; give one of them")
    scene = options.load()
    with progress_bar(options) as progress:
        found = image_quality(
            scene,
            options.field_deg or 0.0,
            field_mm=options.field_mm,
            azimuth_deg=options.azimuth_deg,
            wavelength_nm=options.wavelength_nm,
            weights=options.weights,
            detector=options.detector,
            stop=options.stop,
            grid=options.grid,
            progress=progress,
        )
    frequencies = options.frequencies or found.default_frequencies()
    files = options.write(lambda title, command: quality_report(found, frequencies, title, command))
    return options.show(lambda: quality_record(found, frequencies), lambda: quality_text(found, frequencies), files)

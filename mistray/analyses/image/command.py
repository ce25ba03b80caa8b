"""Command `mistray image`, which computes the image quality of the direct light of a scene."""

from __future__ import annotations

from mistray.toolkit.command import AnalysisCommand, Group
from mistray.toolkit.field_options import options_of
from mistray.toolkit.shared_options import MACHINE, SCENE, SOURCE, SURFACES, TABLE_FORMATS, output

COMMAND = AnalysisCommand(
    "image",
    "image quality of the direct light: spots, wavefront, PSF, MTF, encircled energy, distortion",
    "Trace a grid of rays along the design path of a scene, in float64, within its stops, rims and vanes, and compute\n"
    "the image of a point at each field. Ghosts and scattered light are left out.",
    (
        "mistray image cooke_triplet --field-deg 0 14 20 --frequencies 20 40 --out out",
        "mistray image scene.xml --field-mm 0 5 --wavelength-nm 486 588 656 --weights 1 2 1",
        "mistray image newtonian --field-deg 0 0.3 --json",
    ),
    lambda request: (
        SCENE,
        Group(
            "source (default: as the scene says)",
            (*options_of(request.ImageRequest, "field_deg", "field_mm", "light"), SOURCE),
        ),
        Group(
            "pupil",
            (
                *options_of(request.ImageRequest, "stop", "grid"),
                *options_of(request.ImageTables, "frequencies"),
                *MACHINE,
            ),
        ),
        SURFACES,
        output(
            "report.html, CSV, JSON and PNG files",
            (
                "report.html",
                "image_quality.*",
                "mtf.*",
                "zernikes.*",
                "psf.png",
                "opd.png",
                "spots.png",
                "energy.png",
                "fields.png",
            ),
            formats=TABLE_FORMATS,
        ),
    ),
    __package__,
    request="ImageRequest",
    shown="ImageTables",
)

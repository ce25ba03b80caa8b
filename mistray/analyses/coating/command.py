"""Command `mistray coating`, which prints the reflectance of a coating by wavelength and angle."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mistray.toolkit.command import Command
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.shared_options import FORCE, JSON, PLOT, written

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

COMMAND = Command(
    "coating",
    "reflectance of a coating over wavelength and angle",
    "Evaluate a coating between two materials, or the coatings of a scene: R, T and A = 1 - R - T\n"
    "over wavelength and angle, for s and p. Pictures, and a CSV table that scenes can use.",
    (
        "mistray coating bbar3 --plot bbar3.png",
        "mistray coating protected_al --wavelength-nm 400:1000:10 --angles-deg 0 45",
        'mistray coating "MgF2 99.64, 2.1 0.5w, 1.63 0.25w" --back N-SF6 --csv ar.csv',
        "mistray coating COATING.DAT:AR --design-nm 587.6 --json",
        "mistray coating cooke_triplet --plot surfaces.png",
    ),
    lambda request: (
        *options_of(request.CoatingRequest),
        PLOT,
        written("--csv", "write R, T and phases; its angles are those in the material of lower index"),
        FORCE,
        JSON,
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray coating` with parsed options and return the exit code."""
    from mistray.analyses.coating.page import figure, record, text
    from mistray.analyses.coating.request import CoatingRequest
    from mistray.analyses.coating.run import CoatingResult, SurfacesResult, is_scene, run_coating, run_surfaces

    request = request_of(CoatingRequest, vars(options))
    options.check_pictures("plot")
    files = options.claim()
    found: CoatingResult | SurfacesResult
    if is_scene(request.coating):
        own = " has no meaning for a scene, whose surfaces have their own materials; leave it out"
        options.refuse(("front", "back", "from_back", "csv"), own)
        options.prepare_mitsuba()
        from mistray.scene import load

        with options.working(f"loading {request.coating}"):
            scene = load(request.coating)
        found = run_surfaces(scene, request)
    else:
        found = run_coating(request)
        if options.csv is not None:
            from mistray.coatings import write_table

            full = found.request
            write_table(found.coating, options.csv, full.wavelength_nm, full.angles_deg, full.front, str(full.back))
    if options.plot is not None:
        from mistray.toolkit.figures.plots import write_figure

        write_figure(figure(found), options.plot)
    return options.tell(lambda: record(found), lambda: text(found), files)

"""Command `mistray coat`, which puts coatings, paint and scatter on surfaces of a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mistray.errors import MistrayError
from mistray.toolkit.command import Command
from mistray.toolkit.shared_options import FORCE, JSON, SCENE, SURFACES, written

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

COATING, PAINT, SCATTER = SURFACES.options

COMMAND = Command(
    "coat",
    "put coatings, paint and scatter on surfaces of a scene by name; writes a new scene",
    "Write a scene whose surfaces have other coatings, paint or scatter models; all else in the file stays.\n"
    "A PATTERN is the name of a surface, of a part with all its surfaces, or has * and ?. Later ones go over\n"
    "earlier ones. A coating of a pattern goes on clear surfaces: edges that are black and faces in cement stay\n"
    "as they are, and the command lists them.",
    (
        "mistray coat cooke_triplet 'L?_*=bbar3' -o coated.xml",
        "mistray coat lens.xml 'L1_front=MgF2 99.64' 'L1_rear=COATING.DAT:AR' --paint 'barrel*=flat_black' -o new.xml",
        "mistray coat phone_camera 'L*=bbar4 design_nm=940' --scatter 'L*=harvey_shack rms_nm=1.5' -o nir.xml",
    ),
    (
        SCENE,
        replace(COATING, name="coatings", help=f"coatings: {COATING.help}", nargs="*", extends=False),
        PAINT,
        SCATTER,
        written("-o --output", "file to write (default: SCENE with _coated.xml, in this folder)", "XML"),
        JSON,
        FORCE,
    ),
)


def run(options: Options) -> int:
    """Run `mistray coat` with parsed options and return the exit code."""
    options.coating = options.coatings
    if not (options.coating or options.paint or options.scatter):
        raise MistrayError("nothing to put on; give PATTERN=COATING, such as 'lens_*=bbar3', --paint or --scatter")
    output = options.claim_output(Path(f"{options.title}_coated.xml"))
    options.prepare_mitsuba()
    from mistray.analyses.coat.page import record, text
    from mistray.scene import write_coated

    with options.working(f"coating {options.scene}"):
        found = record(write_coated(options.scene, output, options.rules()))
    return options.say(lambda: found, lambda: text(found, output), [output])

"""`mistray coat`."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.options import Options, print_json
from mistray.cli.progress import working
from mistray.errors import MistrayError
from mistray.toolkit.command import Command, Option
from mistray.toolkit.shared_options import FORCE, SCENE, SURFACES

if TYPE_CHECKING:
    from mistray.scene import Coated

COATING, PAINT, SCATTER = SURFACES.options
NAMES_SHOWN = 8  # surfaces in a line

# fmt: off
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
        Option("coatings", f"coatings: {COATING.help}", COATING.type, COATING.metavar, "*"),
        PAINT,
        SCATTER,
        Option("-o --output", "file to write (default: SCENE with _coated.xml, in this folder)", Path, "XML",
               writes=()),
        Option("--json", "print JSON instead of text", bool),
        FORCE,
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.coating = options.coatings
    if not (options.coating or options.paint or options.scatter):
        raise MistrayError("nothing to put on; give PATTERN=COATING, such as 'lens_*=bbar3', --paint or --scatter")
    output = options.claim_output(Path(f"{options.title}_coated.xml"))
    from mistray._mitsuba_compat import silence_warnings
    from mistray._variant import ensure_variant

    ensure_variant()  # settles libLLVM before anything imports Mitsuba
    silence_warnings()
    from mistray.scene import write_coated

    with working(f"coating {options.scene}"):
        coated = write_coated(options.scene, output, options.rules())
    if options.json:
        print_json(_record(coated), [output])
    else:
        print(_text(coated, output))
    return 0


def _record(coated: Coated) -> dict[str, Any]:
    changes = [
        {
            "surface": name,
            "recoated": change.recoated,
            "coating": _called(change.coating) if change.recoated else None,
            "scatter": [model.name or model.kind for model in change.scatter],
        }
        for name, change in coated.changes.items()
    ]
    return {"changes": changes, "left": [asdict(item) for item in coated.left], "notes": list(coated.notes)}


def _called(coating: Any) -> str:
    if coating is None:
        return "bare"
    if coating.name is not None:
        return str(coating.name)
    return f"R = {coating.R:g}" + (f", T = {coating.T:g}" if coating.T else "") if coating.R else "black"


def _text(coated: Coated, output: Path) -> str:
    groups: dict[str, list[str]] = {}
    for name, change in coated.changes.items():
        models = [model.name or model.kind for model in change.scatter]
        looks = [_called(change.coating)] if change.recoated else []
        groups.setdefault(" + ".join([*looks, *models]) or "no scatter", []).append(name)
    lines = [f"{look}: {_listed(names)}" for look, names in groups.items()]
    left: dict[str, list[str]] = {}
    for item in coated.left:
        left.setdefault(item.why, []).append(item.surface)
    lines += [f"left alone, because it {why}: {_listed(names)}" for why, names in left.items()]
    lines += [f"note: {note}" for note in coated.notes]
    count = f"{len(coated.changes)} surface{'s' if len(coated.changes) > 1 else ''}"
    then = shlex.join(["mistray", "ghosts", str(output)])
    lines.append(f"{output}: {count} changed; next: {then}")
    return "\n".join(lines)


def _listed(names: list[str]) -> str:
    names = list(dict.fromkeys(names))
    more = len(names) - NAMES_SHOWN
    return ", ".join(names[:NAMES_SHOWN]) + (f" and {more} more" if more > 0 else "")

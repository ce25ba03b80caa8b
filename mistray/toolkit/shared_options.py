"""Command-line options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from mistray.light import Light
from mistray.ranges import RAYS, SECONDS, THREADS
from mistray.settings import NO_LIMIT, NOTHING_CUT, Settings
from mistray.toolkit.arguments import Pairs
from mistray.toolkit.command import Group, Option
from mistray.toolkit.field_options import option_of
from mistray.toolkit.fields import Request

ELSE = "(default: as the scene says, else what stands in brackets)"
TABLE_FORMATS = ("parquet", "pdf")  # tables, and the report that has them
MAP_FORMATS = ("exr", "fits", "npy")
NAMES = tuple(setting.name for setting in fields(Settings))


def setting(name: str, default: str = "") -> Option:
    """Return the option for a trace setting; `default` is the text of the default, if empty that of `Settings`."""
    usual = getattr(Settings, name)
    return option_of(
        Settings.__dataclass_fields__[name], default or {NO_LIMIT: "no limit", NOTHING_CUT: "none"}.get(usual, "")
    )


def ray_tree(rays: str | type[Request], *more: Option) -> Group:
    """
    Return the group of options for the ray tree, followed by `more` options.

    `rays` is the help text of --rays, or the class of requests whose field it is.
    """
    names = NAMES[NAMES.index("rays") + 1 : NAMES.index("max_scatters")]
    own = Option("--rays", rays, RAYS, "N") if isinstance(rays, str) else option_of(rays.__dataclass_fields__["rays"])
    return Group(f"ray tree {ELSE}", (own, *map(setting, names), *MACHINE, *more))


# fmt: off
SCENE = Option("scene", "scene XML file, lens file as of mistray import, or the name of a shipped scene such as "
               "phone_camera", metavar="SCENE")
_LIGHT = {field.name: option_of(field) for field in fields(Light)}
SPECTRUM = (_LIGHT["wavelength_nm"], _LIGHT["weights"])
SOURCE = Option("--source", "light instead of the scene's, KIND:x,y,z,name=value,…: point:0,0,-500, sun:field_deg=30; "
                "KIND: beam, point, surface, laser, sun, sky or a plugin (docs/sources.md)", None, "SOURCE", "+")
MAPS = Option("--surface-maps", "record the light on walls by place: patterns of surfaces or parts, and name=value "
              "with azimuths, lengths, id; alone: all walls (docs/surface_maps.md)", None, "WALLS", "*")
SPLIT = Option("--flux-split", "record what surfaces absorb, reflect, transmit and scatter: patterns of surfaces or "
               "parts, and id=name; alone: all surfaces (docs/detectors.md)", None, "SURFACES", "*")
SENSORS = (
    Option("--probe", "record the light that crosses a rectangle, x,y,z,name=value,… with half_width, half_height, "
           "normal, pixels, directions, id (docs/detectors.md)", None, "PROBE", "+"),
    Option("--far-field", "record the light that leaves the scene by direction, name=value,… with edges_deg, azimuths, "
           "axis, id", None, "FIELD", "+"),
    MAPS,
    SPLIT,
)
NEXT_ORDER = Option(
    "--no-next-order", "do not measure the result again with one more scatter event and one more reflection", bool
)
TIME = Option("--seconds", "end this time after the start of the command, with what is found so far", SECONDS, "S")
MACHINE = (
    Option("--variant", "Mitsuba variant; cuda_ad_rgb traces on an NVIDIA GPU (llvm_ad_rgb)", metavar="NAME"),
    Option("--threads", "threads of the processor (all)", THREADS, "N"),
    Option("--plugin", "module with Mitsuba plugins of another package (docs/extending.md)", None, "MODULE", "+"),
)
SCHEDULER = Option("--scheduler", "trace by the workers of a dask cluster, tcp://host:port (this process)",
                   metavar="ADDRESS")
SCATTER = Group(f"scatter {ELSE}", tuple(map(setting, NAMES[NAMES.index("max_scatters") :])))
SURFACES = Group("surfaces, by PATTERN: the name of a surface or of a part, or with *, ?", (
    Option("--coating", "'L?_*=bbar3', 'L1_front=MgF2 99.64': a preset, layers, table.csv, R=0.01 T=0.99, bare, or one "
           "of the scene (docs/coatings.md)",
           Pairs("not a coating; write PATTERN=COATING, such as 'lens_*=bbar3'"), "PATTERN=COATING", "+", extends=True),
    Option("--paint", "'barrel*=flat_black', 'wall=0.05' (Lambertian), 'ring=R=0.1'; black absorbs everything",
           Pairs("not a paint; write PATTERN=PAINT, such as 'vane*=flat_black'"), "PATTERN=PAINT", "+", extends=True),
    Option("--scatter", "'L*=harvey_shack rms_nm=4', 'window=particulate level=300': a model with its numbers, beside "
           "those of other kinds; none takes all off (docs/scatter.md)",
           Pairs("not a scatter model; write PATTERN=MODEL, such as 'L*=harvey_shack rms_nm=4'", repeats=True),
           "PATTERN=MODEL", "+", extends=True),
))
DETECTOR = _LIGHT["detector"]
JSON = Option("--json", "print JSON instead of text", bool)
FORCE = Option("--force", "replace existing files; never one that is read", bool)
# fmt: on


def written(name: str, help: str, metavar: str = "FILE") -> Option:
    """Return an option that names a file for the command to write; `metavar` is the placeholder in the help."""
    return Option(name, help, Path, metavar, writes=())


PLOT = written("--plot", "write a picture: .png, .svg or .pdf")


def saved_run(name: str, when: str = "") -> Group:
    """
    Return the options --state, for the file of a run that can be resumed, and --resume.

    `name` is the usual name of the file; `when` is added to the heading of the group.
    """
    state = Option(
        "--state", f"what is finished, renewed as the run goes on ({name} in --out)", Path, "FILE", writes=()
    )
    return Group(f"saved run{when}", (state, Option("--resume", "go on from the saved run", bool)))


def output(
    files: str, names: Sequence[str], *more: Option, shown: str = "tables", formats: Sequence[str] = ()
) -> Group:
    """
    Return the group of options for where and how results are written.

    Parameters
    ----------
    files : str
        Description of the files that --out writes.
    names : sequence of str
        Patterns of the names of these files, see `mistray.cli.claims`.
    *more : Option
        Further options of the group.
    shown : str
        Description of the printed output.
    formats : sequence of str
        Further formats of the files, from `TABLE_FORMATS` and `MAP_FORMATS`; empty: no option --formats.
    """
    maps = "; irradiance with its error as EXR, FITS, NPY" if len(formats) > len(TABLE_FORMATS) else ""
    what = f"tables as Parquet too; the report as PDF{maps}"
    kinds = Option("--formats", f"{what} (needs --out)", tuple(formats), nargs="+", default=[])
    options = (
        Option("--out", f"write {files} there", Path, "DIR", writes=tuple(names)),
        FORCE,
        *([kinds] if formats else []),
        Option("--json", f"print JSON instead of the {shown}", bool),
        Option("--quiet", f"no progress, no {shown}", bool),
    )
    return Group("output", (*options, *more))

"""`mistray objects`."""

from __future__ import annotations

from mistray.cli.options import Options
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, CONE_DEG, FIELD_DEG, PLACE_MM, RAYS, ROWS, SHARE, WAVELENGTH_NM
from mistray.toolkit.command import Command, Group, Option, angles
from mistray.toolkit.shared_options import (
    DETECTOR,
    ELSE,
    MACHINE,
    SCENE,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    setting,
)

ROWS_SHOWN = 25
HALF_ANGLE_DEG = 20.0
# What the search of objects takes as it is given
TAKEN = (
    "rays", "field_deg", "azimuth_deg", "view_half_angle_deg", "wavelength_nm", "detector", "stop", "threshold",
    "ray_control", "max_events", "seed",
)  # fmt: skip

# What --out writes
FILES = ("objects.*", "objects_*.csv")

# fmt: off
COMMAND = Command(
    "objects",
    "critical, illuminated and common objects of a scene, and the light that they scatter",
    "Objects that the detector sees (critical), that light from outside reaches (illuminated), and\n"
    "both (common): surfaces only transmit, mirrors reflect, nothing is split or scattered. Light that common\n"
    "objects and optics send to the detector by one scatter event is estimated as flux x BSDF x pi GCF. Ways by\n"
    "which the detector sees the outside past the optics are reported as warnings.",
    (
        "mistray objects phone_camera --half-angle-deg 20 --out out",
        "mistray objects phone_camera_scatter --field-deg 0 10 20:40:5 --rays 3e5",
        "mistray objects phone_camera --disc -5.75 3.083 --view-half-angle-deg 45 --threshold 0 --json",
    ),
    (
        SCENE,
        Group("light from outside (one of the first three)", (
            Option("--half-angle-deg", f"from everywhere within this angle of the axis ({HALF_ANGLE_DEG:g})",
                   CONE_DEG, "DEG"),
            angles("--field-deg", "a distant source at field angles: numbers, and ranges first:last:step", FIELD_DEG),
            Option("--disc", "a Lambertian disc across the z axis, mm; its cone is --half-angle-deg",
                   PLACE_MM, ("Z", "RADIUS"), 2),
            Option("--azimuth-deg", "azimuth of --field-deg, from +y to -x (0)", AZIMUTH_DEG, "DEG"),
            Option("--wavelength-nm", "wavelength (first of the scene's source)", WAVELENGTH_NM, "NM"),
        )),
        Group("view of the detector", (
            Option("--view-half-angle-deg", "rays leave the detector within this angle of its normal (90)",
                   CONE_DEG, "DEG"),
            DETECTOR,
            Option("--stop", "part or shape that is the aperture stop (found by marginal rays)", metavar="NAME"),
        )),
        Group(f"rays {ELSE}", (
            Option("--rays", "start rays from the detector, and from outside at each angle (1e6)", RAYS, "N"),
            Option("--threshold", "flux that makes an object count, W for each W that starts (1e-6)", SHARE, "W"),
            setting("ray_control", default="transmit_specular"),
            Option("--no-total-reflection", "end rays in total reflection", bool),
            setting("max_events"),
            setting("seed"),
            TIME,
            *MACHINE,
        )),
        SURFACES,
        output("objects.html, CSV, JSON and PNG files", FILES,
               Option("--rows", f"rows of each table ({ROWS_SHOWN})", ROWS, "N", default=ROWS_SHOWN),
               formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    if options.field_deg is not None:
        for name, option in (("half_angle_deg", "--half-angle-deg"), ("disc", "--disc")):
            if getattr(options, name) is not None:
                raise MistrayError(f"--field-deg and {option} are two kinds of source; give one of them")
    else:
        options.refuse(["azimuth_deg"], " is about --field-deg; give that too, or leave it out")
    options.start()
    from mistray.analyses.objects.page import objects_record, objects_report, objects_text
    from mistray.analyses.objects.search import objects
    from mistray.trace.host.ray_sources import DiskSource

    given = options.given("half_angle_deg", *TAKEN)
    if options.disc is not None:
        z, radius = options.disc
        given["source"] = DiskSource((0.0, 0.0, z), radius, given.pop("half_angle_deg", HALF_ANGLE_DEG))
    scene = options.load()
    with options.tracing() as progress:
        reflected = not options.no_total_reflection
        found = objects(scene, total_reflection=reflected, progress=progress, seconds=options.seconds_left(), **given)
        estimates = found.estimates()
    files = options.write(lambda title, command: objects_report(found, estimates, title, command))
    return options.show(
        lambda: objects_record(found, estimates),
        lambda: objects_text(found, estimates, options.rows),
        files,
        "objects.html",
    )

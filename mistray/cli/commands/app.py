"""`mistray app`."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path

from mistray.cli.options import Options, print_json
from mistray.ranges import FIELD_DEG, LIVE_RAYS, PORT, SECONDS, WAVELENGTH_NM
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.shared_options import FORCE, NAMES, SCATTER, SCENE, ray_tree

# What Save writes; of `mistray.analyses.explorer.saving`, not imported to parse a command line
FILES = ("explored_scene.xml", "explored_study.toml")

TREE = ray_tree("")
AT_ONCE_S = 0.5  # in which Ctrl-C is noticed at the latest

# fmt: off
COMMAND = Command(
    "app",
    "explore a scene live: turn coatings, paints, shapes and fields on a page of this machine",
    "Show a page with sliders for coatings, numbers of the scene, field and wavelength. Stray light follows at\n"
    "once by an estimate, and is traced in the background. The page is served to this machine alone, at an\n"
    "address with a secret. Ctrl-C ends it.",
    (
        "mistray app phone_camera",
        "mistray app lens.xml --field-deg 10 0 5 15 20 --out explored",
        "mistray app double_gauss_barrel --control 'black_paint*.reflectance' 'hood*.r1' --max-scatters 1",
    ),
    (
        SCENE,
        Group("controls", (
            Option("--field-deg", "field angles that are traced ahead, degrees; the first is the one to start with "
                   "(that of the scene, 0 5 10 15 20 25)", FIELD_DEG, "DEG", "+"),
            Option("--wavelength-nm", "wavelength to start with, nm (as the scene says)", WAVELENGTH_NM, "NM"),
            Option("--control", "numbers to turn, by keys or patterns such as 'vane_*.r1' (docs/parameters.md), "
                   "instead of those that are chosen by themselves", None, "KEY", "+"),
        )),
        Group(TREE.title, (
            Option("--rays", "start rays of every trace (as many as take a second, at most 20 000)", LIVE_RAYS, "N"),
            *TREE.options[1:],
        )),
        SCATTER,
        Group("page", (
            Option("--port", "port of this machine (any that is free)", PORT, "N"),
            Option("--seconds", "end by itself after this time (Ctrl-C ends it)", SECONDS, "S"),
            Option("--no-browser", "do not open the page", bool),
            Option("--out", "folder where Save puts its files (this folder)", Path, "DIR", writes=FILES),
            FORCE,
            Option("--json", "print the address as JSON", bool),
            Option("--quiet", "print nothing but the address", bool),
        )),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.start()
    from mistray.analyses.explorer.explorer import Explorer
    from mistray.analyses.explorer.server import serving

    settings = {name: getattr(options, name) for name in NAMES if name != "rays"}
    with options.working("compiling"):
        explorer = Explorer(
            options.scene, options.field_deg, options.wavelength_nm, options.control, options.rays, **settings
        )
    if options.out is not None:
        explorer.saving.folder = options.out
    explorer.saving.force = options.force
    try:
        with serving(explorer, options.port or 0) as server:
            if options.json:
                print_json({"address": server.address, "port": server.port})
            else:
                print(server.address)
                if not options.quiet:
                    print("Ctrl-C ends it.")
            sys.stdout.flush()
            if not options.no_browser:
                webbrowser.open(server.address)
            while (left := options.seconds_left()) is None or left > SECONDS.low:
                explorer.work(AT_ONCE_S if left is None else min(left, AT_ONCE_S))
    except KeyboardInterrupt:  # that is how it ends
        pass
    return 0

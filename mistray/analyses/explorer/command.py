"""Command `mistray app`, which explores the stray light of a scene live on a local web page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from mistray.ranges import PORT, SECONDS
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.field_options import group, request_of
from mistray.toolkit.shared_options import FORCE, SCATTER, SCENE, ray_tree

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

AT_ONCE_S = 0.5  # in which Ctrl-C is noticed at the latest
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
    lambda request: (
        SCENE,
        group("controls", request.ExplorerRequest, "field_deg", "wavelength_nm", "control"),
        ray_tree(request.ExplorerRequest),
        SCATTER,
        Group(
            "page",
            (
                Option("--port", "port of this machine (any that is free)", PORT, "N"),
                Option("--seconds", "end by itself after this time (Ctrl-C ends it)", SECONDS, "S"),
                Option("--no-browser", "do not open the page", bool),
                Option(
                    *("--out", "folder where Save puts its files (this folder)", Path, "DIR"),
                    writes=(request.SCENE_FILE, request.STUDY_FILE),
                ),
                FORCE,
                Option("--json", "print the address as JSON", bool),
                Option("--quiet", "print nothing but the address", bool),
            ),
        ),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray app` with parsed options until time or Ctrl-C ends it, and return the exit code."""
    import webbrowser

    from mistray.analyses.explorer.request import ExplorerRequest

    request = request_of(ExplorerRequest, vars(options))
    options.start()
    from mistray.analyses.explorer.explorer import Explorer
    from mistray.analyses.explorer.server import serving

    light = request.field_deg, request.wavelength_nm, request.control, request.rays
    with options.working("compiling"):
        explorer = Explorer(options.scene, *light, **request.settings)
    explorer.saving.folder, explorer.saving.force = options.out or Path(), options.force
    try:
        with serving(explorer, options.port or 0) as server:
            how = "" if options.quiet else "\nCtrl-C ends it."
            options.quiet = False
            options.say(lambda: {"address": server.address, "port": server.port}, lambda: f"{server.address}{how}")
            sys.stdout.flush()
            if not options.no_browser:
                webbrowser.open(server.address)
            while (left := options.seconds_left()) is None or left > SECONDS.low:
                explorer.work(AT_ONCE_S if left is None else min(left, AT_ONCE_S))
    except KeyboardInterrupt:  # that is how it ends
        pass
    return 0

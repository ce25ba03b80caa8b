"""`mistray sensitivity`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mistray.cli.options import Options
from mistray.cli.saved_run import SavedRun
from mistray.errors import MistrayError
from mistray.ranges import CONE_DEG, EDGE_WIDTH, FACTOR, FIELD_DEG, POLAR_DEG, POSITIVE, ROWS
from mistray.toolkit.arguments import pairs
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.field_options import flag
from mistray.toolkit.shared_options import (
    SCATTER,
    SCENE,
    SCHEDULER,
    SOURCE,
    SPECTRUM,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
    saved_run,
)

# Metrics and the arguments that they take
PATHS = ("path_power", "ghost_to_signal", "peak_irradiance", "ghost_rms_irradiance", "ghost_focus")
METRICS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(PATHS, ("paths", "field_deg")),
    "rms_spot": ("field_deg",),
    "transmission": ("field_deg",),
    "relative_illumination": ("field_deg",),
    "pst_bin": ("field_deg", "light"),
    "pst_band": ("band_deg", "light"),
    "veiling_glare": ("patch_deg",),
}
NEEDED = {"relative_illumination": "field_deg", "pst_bin": "field_deg", "pst_band": "band_deg",
          "veiling_glare": "patch_deg"}  # fmt: skip
OWN = ("paths", "field_deg", "band_deg", "patch_deg", "light")
KINDS = ("coating", "share", "scatter", "curvature", "conic", "asphere", "rim", "position", "tilt", "index")

# What --out writes
STATE = "sensitivity_state.npz"
FILES = (STATE, "report.html", "sensitivity.*", "propagation.csv", "draws.csv", "ranking.png", "monte_carlo.png")

# fmt: off
COMMAND = Command(
    "sensitivity",
    "rank all parameters by what their tolerances do to a metric; which changes lower it 10 times",
    "One reverse run of the trace gives the derivative of a metric by every parameter of the scene.\n"
    "The command ranks them by the change of the metric per manufacturing tolerance, and adds up all tolerances.\n"
    "It also says which three changes would lower the metric 10 times; docs/sensitivity.md describes it.",
    (
        "mistray sensitivity phone_camera --field-deg 0 10 20 --rays 1e4 --out out/sensitivity",
        "mistray sensitivity baffle_tube --metric pst_band --band-deg 20 80 --rays 2e5",
        "mistray sensitivity phone_camera --parameter '*.R' --together 'L*.R' --monte-carlo 100",
        "mistray sensitivity phone_camera_scatter --metric path_power --paths stray --kind scatter --json",
        "mistray sensitivity phone_camera --metric path_power --paths 'detector -> window_rear' --rays 1e4",
    ),
    (
        SCENE,
        Group("metric", (
            Option("--metric", f"{', '.join(METRICS)} (path_power)", tuple(METRICS), "NAME", default="path_power"),
            Option("--paths", "of path_power and the like: ghost, stray …, a name as 'L2_rear -> L1_front', all "
                   "events of a path, or a filter (docs/rays.md) (ghost)", metavar="PATHS"),
            Option("--field-deg", "field angles, averaged (the source's own); of pst_bin one, that of the PST",
                   FIELD_DEG, "DEG", "+"),
            Option("--band-deg", "of pst_band: its ends, degrees", POLAR_DEG, ("LOW", "HIGH"), 2),
            Option("--patch-deg", "of veiling_glare: half-width of the black patch", CONE_DEG, "DEG"),
            Option("--light", "of a PST: stray, ghost, single_scatter, total … (stray)", metavar="CLASS"),
            *SPECTRUM,
            SOURCE,
        )),
        Group("parameters", (
            Option("--parameter", "keys or patterns such as 'vane_*.r0' (all)", metavar="KEY", nargs="+"),
            Option("--kind", f"only these kinds: {', '.join(KINDS)}", KINDS, "KIND", "+"),
            Option("--tolerance", "tolerances in the unit of the parameter, by key or pattern (usual ones)",
                   pairs("no tolerance; write KEY=VALUE, such as 'L*_front.x=0.02'", POSITIVE),
                   "KEY=VALUE", "+"),
            Option("--together", "patterns of parameters that vary together and count as one",
                   metavar="KEY", nargs="+", default=[]),
            Option("--change", "what may be changed to lower the metric (coatings, scatter, structure)",
                   metavar="KEY", nargs="+"),
            Option("--factor", "how much lower it shall be (10)", FACTOR, "F", default=10.0),
            Option("--reach", "largest change that is proposed, in tolerances; R and T have none (10)",
                   POSITIVE, "N", default=10.0),
            Option("--no-check", "do not trace the changes that are proposed", bool),
            Option("--monte-carlo", "trace N perturbed systems (0)", ROWS, "N", default=0),
            Option("--no-edges", "leave out what rays gain and lose at rims", bool),
            Option("--edge-width", "width of the zone at a rim in which rays count, over its radius (that of the least "
                   "error)", EDGE_WIDTH, "W"),
        )),
        ray_tree("start rays at each field, or of the PST", TIME, SCHEDULER),
        SURFACES,
        SCATTER,
        saved_run(STATE),
        output("report.html, CSV files, JSON and pictures", FILES,
               Option("--top", "rows of the table (20)", ROWS, "N", default=20), formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.check()
    options.check_resume()
    keywords = _metric_keywords(options)
    options.start()
    from mistray.analyses.pst.metrics.by_name import FACTORIES
    from mistray.analyses.sensitivity.page import sensitivity_record, sensitivity_report, sensitivity_text
    from mistray.analyses.sensitivity.run import sensitivity
    from mistray.metrics.parameters import match, parameters

    scene = options.load()
    metric = FACTORIES[options.metric](scene, **keywords, **options.given(*options.spectral_settings()))
    keys = options.parameter
    if options.kind is not None:
        known = parameters(scene)
        keys = [key for key in (known if keys is None else match(known, keys)) if known[key].kind in options.kind]
        if not keys:
            raise MistrayError(f"the scene has no parameter of kind {' or '.join(options.kind)} among those chosen")
    state = options.saved_run(STATE)
    saved = SavedRun(state, lambda: "what is finished is", options.resume)
    files: list[Path] = []
    with saved.told():
        with options.tracing() as progress:
            result = sensitivity(
                metric,
                keys=keys,
                tolerances=dict(options.tolerance or ()),
                together=options.together,
                factor=options.factor,
                change=options.change,
                reach=options.reach,
                check=not options.no_check,
                monte_carlo=options.monte_carlo,
                seed=options.seed or 0,
                edges=not options.no_edges,
                edge_width=options.edge_width,
                state=state,
                resume=options.resume,
                seconds=options.seconds_left(),
                progress=progress,
            )
        files = options.write(lambda title, command: sensitivity_report(result, title, command))
    if saved.code:
        return saved.code
    return options.show(lambda: sensitivity_record(result), lambda: sensitivity_text(result, options.top), files)


def _metric_keywords(options: Options) -> dict[str, Any]:
    """The arguments of the metric's function, after a check that all that is given belongs to it."""
    metric, allowed = options.metric, METRICS[options.metric]
    takes = " and ".join(map(flag, allowed))
    options.refuse(
        (name for name in OWN if name not in allowed), f" is not about the metric {metric}; it takes {takes}"
    )
    needed = NEEDED.get(metric)
    if needed is not None and getattr(options, needed) is None:
        raise MistrayError(f"the metric {metric} needs {flag(needed)}")
    found = options.given("patch_deg", "light")
    if options.paths is not None:
        found["selection"] = options.paths
    if options.field_deg is not None:
        found["field_deg"] = tuple(options.field_deg)
        if metric == "pst_bin":
            if len(options.field_deg) > 1:
                raise MistrayError("the metric pst_bin is about one field angle; give one --field-deg")
            (found["field_deg"],) = options.field_deg
    if options.band_deg is not None:
        found["low_deg"], found["high_deg"] = options.band_deg
    return found

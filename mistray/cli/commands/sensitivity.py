"""`mistray sensitivity`."""

from __future__ import annotations

import argparse
from typing import Any

from mistray.cli.arguments import Help
from mistray.cli.claims import claim_folder
from mistray.cli.tracing_arguments import (
    add_output,
    add_ray_tree,
    add_scatter,
    add_scene,
    add_scheduler,
    add_spectrum,
    check_weights,
    progress_bar,
    scene_title,
    settings_of,
    show,
    start_mitsuba,
    workers_of,
    working,
)
from mistray.errors import MistrayError
from mistray.ranges import CONE_DEG, EDGE_WIDTH, FACTOR, FIELD_DEG, POLAR_DEG, POSITIVE, ROWS

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
FILES = ("report.html", "sensitivity.*", "propagation.csv", "draws.csv", "ranking.png", "monte_carlo.png")


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "sensitivity",
        help="rank all parameters by what their tolerances do to a metric; which changes lower it 10 times",
        description="One reverse run of the trace gives the derivative of a metric by every parameter of the scene.\n"
        "The command ranks them by the change of the metric per manufacturing tolerance, adds up all tolerances, and\n"
        "says which three changes would lower the metric 10 times; docs/sensitivity.md describes it.",
        epilog="examples:\n"
        "  mistray sensitivity phone_camera --field-deg 0 10 20 --rays 1e4 --out out/sensitivity\n"
        "  mistray sensitivity baffle_tube --metric pst_band --band-deg 20 80 --rays 2e5\n"
        "  mistray sensitivity phone_camera --parameter '*.R' --together 'L*.R' --monte-carlo 100\n"
        "  mistray sensitivity phone_camera_scatter --metric path_power --paths stray --kind scatter --json",
        formatter_class=Help,
    )
    add_scene(parser)
    what = parser.add_argument_group("metric")
    what.add_argument("--metric", choices=tuple(METRICS), default="path_power", metavar="NAME",
                      help=f"{', '.join(METRICS)} (path_power)")  # fmt: skip
    what.add_argument("--paths", metavar="KIND",
                      help="of path_power and the like: ghost, stray … or the events of one path (ghost)")  # fmt: skip
    what.add_argument("--field-deg", type=FIELD_DEG, nargs="+", metavar="DEG",
                      help="field angles, averaged (the source's own); of pst_bin one, that of the PST")  # fmt: skip
    what.add_argument(
        "--band-deg", type=POLAR_DEG, nargs=2, metavar=("LOW", "HIGH"), help="of pst_band: its ends, degrees"
    )
    what.add_argument(
        "--patch-deg", type=CONE_DEG, metavar="DEG", help="of veiling_glare: half-width of the black patch"
    )
    what.add_argument("--light", metavar="CLASS", help="of a PST: stray, ghost, single_scatter, total … (stray)")
    add_spectrum(what)
    about = parser.add_argument_group("parameters")
    about.add_argument("--parameter", nargs="+", metavar="KEY", help="keys or patterns such as 'vane_*.r0' (all)")
    about.add_argument("--kind", nargs="+", choices=KINDS, metavar="KIND", help=f"only these kinds: {', '.join(KINDS)}")
    about.add_argument("--tolerance", nargs="+", type=_tolerance, metavar="KEY=VALUE",
                       help="tolerances in the unit of the parameter, by key or pattern (usual ones)")  # fmt: skip
    about.add_argument("--together", nargs="+", default=[], metavar="KEY",
                       help="patterns of parameters that vary together and count as one")  # fmt: skip
    about.add_argument("--change", nargs="+", metavar="KEY",
                       help="what may be changed to lower the metric (coatings, scatter, structure)")  # fmt: skip
    about.add_argument("--factor", type=FACTOR, default=10.0, metavar="F", help="how much lower it shall be (10)")
    about.add_argument("--reach", type=POSITIVE, default=10.0, metavar="N",
                       help="largest change that is proposed, in tolerances; R and T have none (10)")  # fmt: skip
    about.add_argument("--no-check", action="store_true", help="do not trace the changes that are proposed")
    about.add_argument("--monte-carlo", type=ROWS, default=0, metavar="N", help="trace N perturbed systems (0)")
    about.add_argument("--no-edges", action="store_true", help="leave out what rays gain and lose at rims")
    about.add_argument("--edge-width", type=EDGE_WIDTH, default=0.02, metavar="W",
                       help="width of the zone at a rim in which rays count, over its radius (0.02)")  # fmt: skip
    add_scheduler(add_ray_tree(parser, "start rays at each field, or of the PST"))
    add_scatter(parser)
    output = add_output(parser, "report.html, CSV files, JSON and pictures", FILES)
    output.add_argument("--top", type=ROWS, default=20, metavar="N", help="rows of the table (20)")
    parser.take_old_name("--angle-deg", "--field-deg")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    check_weights(options)
    keywords = _metric_keywords(options)
    start_mitsuba(options)
    from mistray.optimize.metrics.by_name import FACTORIES
    from mistray.optimize.parameters import match, parameters
    from mistray.optimize.tolerances.sensitivity import sensitivity
    from mistray.report.tables.sensitivity import sensitivity_record, sensitivity_text
    from mistray.scene import load

    claim_folder(options)
    with working(f"loading {options.scene}", options.quiet):
        scene = load(options.scene)
    settings = {key: value for key, value in settings_of(options).items() if value is not None}
    settings |= {
        key: getattr(options, key) for key in ("wavelength_nm", "weights") if getattr(options, key) is not None
    }
    metric = FACTORIES[options.metric](scene, **keywords, **settings)
    keys = options.parameter
    if options.kind is not None:
        known = parameters(scene)
        keys = [key for key in (known if keys is None else match(known, keys)) if known[key].kind in options.kind]
        if not keys:
            raise MistrayError(f"the scene has no parameter of kind {' or '.join(options.kind)} among those chosen")
    with workers_of(options), progress_bar(options) as progress:
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
            progress=progress,
        )
    files = []
    if options.out is not None:
        from mistray.report.sensitivity_output import write_sensitivity

        with working("drawing the report", options.quiet):
            files = write_sensitivity(result, options.out, scene_title(options.scene), options.command_line)
    show(options, lambda: sensitivity_record(result), lambda: sensitivity_text(result, options.top), files)
    return 0


def _metric_keywords(options: argparse.Namespace) -> dict[str, Any]:
    """The arguments of the metric's function, after a check that all that is given belongs to it."""
    allowed = METRICS[options.metric]
    for name in OWN:
        if getattr(options, name) is not None and name not in allowed:
            raise MistrayError(
                f"--{name.replace('_', '-')} is not about the metric {options.metric}; "
                f"{'it takes --' + ' and --'.join(item.replace('_', '-') for item in allowed)}"
            )
    needed = NEEDED.get(options.metric)
    if needed is not None and getattr(options, needed) is None:
        raise MistrayError(f"the metric {options.metric} needs --{needed.replace('_', '-')}")
    found: dict[str, Any] = {}
    if options.paths is not None:
        found["selection"] = options.paths
    if options.field_deg is not None:
        found["field_deg"] = tuple(options.field_deg)
        if options.metric == "pst_bin":
            if len(options.field_deg) > 1:
                raise MistrayError("the metric pst_bin is about one field angle; give one --field-deg")
            (found["field_deg"],) = options.field_deg
    if options.band_deg is not None:
        found["low_deg"], found["high_deg"] = options.band_deg
    for name in ("patch_deg", "light"):
        if getattr(options, name) is not None:
            found[name] = getattr(options, name)
    return found


def _tolerance(text: str) -> tuple[str, float]:
    """A key or pattern and a number."""
    key, sign, value = text.rpartition("=")
    if not sign or not key:
        raise argparse.ArgumentTypeError(f"'{text}' is no tolerance; write KEY=VALUE, such as 'L*_front.x=0.02'")
    return key, POSITIVE(value)

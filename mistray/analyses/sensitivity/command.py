"""Command `mistray sensitivity`, which ranks parameters by the effect of their tolerances on a metric."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mistray.errors import MistrayError
from mistray.toolkit.command import Command, Group
from mistray.toolkit.field_options import options_of, request_of
from mistray.toolkit.shared_options import (
    SCATTER,
    SCENE,
    SCHEDULER,
    SOURCE,
    SURFACES,
    TABLE_FORMATS,
    TIME,
    output,
    ray_tree,
    saved_run,
)

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options

STATE = "sensitivity_state.npz"
METRIC = ("metric", "paths", "field_deg", "band_deg", "patch_deg", "light", "spectrum")
FURTHER = ("tolerances", "together", "change", "factor", "reach", "check", "monte_carlo", "edges", "edge_width")

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
    lambda request: (
        SCENE,
        Group("metric", (*options_of(request.MetricRequest, *METRIC), SOURCE)),
        Group(
            "parameters",
            (
                *options_of(request.SensitivityRequest, "keys"),
                *options_of(request.SensitivityList, "kind"),
                *options_of(request.SensitivityRequest, *FURTHER),
            ),
        ),
        ray_tree("start rays at each field, or of the PST", TIME, SCHEDULER),
        SURFACES,
        SCATTER,
        saved_run(STATE),
        output(
            "report.html, CSV files, JSON and pictures",
            (STATE, "report.html", "sensitivity.*", "propagation.csv", "draws.csv", "ranking.png", "monte_carlo.png"),
            *options_of(request.SensitivityList, "top"),
            formats=TABLE_FORMATS,
        ),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray sensitivity` with parsed options and return the exit code."""
    from mistray.analyses.sensitivity.request import MetricRequest, SensitivityList, SensitivityRequest

    options.check()
    given = vars(options)
    about, request = request_of(MetricRequest, given), request_of(SensitivityRequest, given)
    listed = request_of(SensitivityList, given)
    options.start()
    from mistray.analyses.pst.metrics.by_name import FACTORIES
    from mistray.analyses.sensitivity import page
    from mistray.analyses.sensitivity.run import run as sensitivity
    from mistray.metrics.parameters import match, parameters

    scene = options.load()
    metric = FACTORIES[about.metric](scene, **about.keywords)
    if listed.kind is not None:
        known = parameters(scene)
        chosen = known if request.keys is None else match(known, request.keys)
        request = replace(request, keys=tuple(key for key in chosen if known[key].kind in listed.kind))
        if not request.keys:
            raise MistrayError(f"the scene has no parameter of kind {' or '.join(listed.kind)} among those chosen")
    saved = options.saved_run(STATE, lambda: "what is finished is")
    with saved.reported():
        with options.tracing() as progress:
            result = sensitivity(metric, request, progress=progress, **saved.how, seconds=options.seconds_left())
        files = options.write(lambda title, command: page.page(result, title, command))
        options.show(lambda: page.record(result), lambda: page.text(result, listed.top), files)
    return saved.code

"""Ghost analysis: every path to the detector at several field angles, compared with the direct image on axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mitsuba as mi

from mistray.analyses.ghosts.field_traces import (
    NOMINAL_FIELD_DEG,
    FieldTraces,
    Progress,
    fewer_wavelengths,
    one_for_fields,
)
from mistray.analyses.ghosts.request import CONTESTED_FACTOR, GhostsRequest
from mistray.analyses.ghosts.result import GhostReport
from mistray.errors import Interrupted, UnfinishedError
from mistray.ranges import RAYS
from mistray.sampling.sources import field_of
from mistray.time_budget import is_limited, within
from mistray.toolkit.analysis import analysis
from mistray.trace import Trace


def run(
    scene: mi.Scene, request: GhostsRequest, *, progress: Progress | None = None, seconds: float | None = None
) -> GhostReport:
    """
    Trace a scene at several field angles and rank its stray light.

    The direct image on axis, the denominator of every normalised value, is taken from the field 0. If ``field_deg``
    lacks this field, it is traced as well, without reflections and scatter. All fields have the same polarization.
    Every list of worst paths names the strongest path by power, too. Where paths are ranked by RMS irradiance and
    without a time budget, a field with a contested worst path (``contested`` in `GhostReport.table`) is traced again.

    Parameters
    ----------
    scene : mi.Scene
        Scene with one source, from `mistray.load`.
    request : GhostsRequest
    progress : callable, optional
        Called now and then with the number of fields done, parts of one included, and of all fields.
    seconds : float, optional
        Time for all fields, s, in equal shares; each ends with the rays that it has, see `mistray.trace`. Fields for
        which it is too short are in `GhostReport.not_traced`; those that are traced are spread over all. Maps, which a
        report requests later, take as long again.

    Returns
    -------
    GhostReport
        A mapping from field angle to `mistray.trace.Trace`.

    Raises
    ------
    MistrayError
        If an argument is invalid, none of several detectors is named, or `mistray.trace` raises it.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` maps fields to traces, the last of them of fewer rays,
        and is a `GhostReport` if the field 0 is known.
    Interrupted
        If the user presses Ctrl-C; ``partial`` is as above, with the finished fields and the rays of the unfinished
        one.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> report.top(0, 2)[["ghost_1", "ghost_2"]]
        ghost_1   ghost_2
    2  L3_front   L2_rear
    5   L3_rear  L1_front
    """
    arguments: dict[str, Any] = {**request.light, **request.settings}
    wanted: list[float | None] = list(dict.fromkeys(request.field_deg or [None]))
    if request.field_mm is not None:
        wanted = list(dict.fromkeys(field_of(scene, height) for height in request.field_mm))
    fields_of, rank = FieldTraces(scene, arguments, progress), request.rank
    report: Any = {}

    def tabulate(field: float) -> None:
        """Compute the ranked table of a field, and the maps that its ranking needs."""
        nonlocal report
        report = report.of(fields_of.traces) if report else _report(scene, fields_of, None, arguments, rank)
        report.summary(field)
        report.listed(field)

    try:
        with within(seconds):
            if isinstance(scene, mi.Scene):
                arguments["polarization"] = one_for_fields(scene, wanted, arguments)
                arguments |= fewer_wavelengths(scene, wanted, arguments)
            fields_of.trace(wanted, tabulate)
            traces, missing = fields_of.traces, fields_of.not_traced
            report = report.of(traces, missing) if report else _report(scene, fields_of, None, arguments, rank)
            assert isinstance(report, GhostReport)
            if rank == "rms" and not is_limited():
                more = _rays_of_contested(report, request.contested_rays)
                fields_of.trace_again(more)
                report = _report(scene, fields_of, None, arguments, rank) if more else report
    except (UnfinishedError, Interrupted) as error:
        error.args = (f"{error}; {_finished(fields_of, wanted)}",)
        error.partial = _report(scene, fields_of, error.partial, arguments, rank)
        raise
    except KeyboardInterrupt:
        if not fields_of.traces:
            raise
        raise Interrupted(_finished(fields_of, wanted), _report(scene, fields_of, None, arguments, rank)) from None
    assert isinstance(report, GhostReport)
    return report


_BY_POSITION = "field_deg wavelength_nm weights azimuth_deg progress rank seconds contested_rays"
ghosts = analysis("ghosts", GhostsRequest, run, _BY_POSITION.split())


def _rays_of_contested(report: GhostReport, wanted: float | None) -> dict[float, int]:
    """
    Return the new number of start rays by contested field, degrees, where it exceeds the present number.

    It is `wanted`, or four times the present number if that is None.
    """
    had = {field: int(t.settings["rays"]) for field, t in report.items() if len(report.rivals(field))}
    more = {
        field: int(min(CONTESTED_FACTOR * rays, RAYS.high) if wanted is None else wanted) for field, rays in had.items()
    }
    return {field: rays for field, rays in more.items() if rays > had[field]}


def _finished(found: FieldTraces, wanted: Sequence[float | None]) -> str:
    """Return the sentence of an error message on the fields that are finished and those that are not."""
    left = ", ".join(f"{field:g}" for field in wanted if field is not None and field not in found.traces)
    return f"{len(found.traces)} of {len(wanted)} fields are finished" + (f", not {left} deg" if left else "")


def _report(
    scene: Any, found: FieldTraces, unfinished: Any, arguments: Mapping[str, Any], rank: str
) -> GhostReport | dict[float, Trace]:
    """Return the report of traced fields, an unfinished one included, or the traces if the image on axis is missing."""
    traces = dict(found.traces)
    if isinstance(unfinished, Trace) and unfinished.has_paths and not found.at_extra:
        traces[float(unfinished.settings["field_deg"])] = unfinished
    nominal = traces.get(NOMINAL_FIELD_DEG, found.nominal)
    if not traces or nominal is None:
        return traces
    return GhostReport(scene, traces, nominal, arguments, rank, found.traced_again)

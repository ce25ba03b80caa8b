"""Verdict of a ghost analysis: the worst paths over all fields, and the surface worth changing first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mistray.analyses.ghosts.request import RANKS
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.path_columns import mark_of
from mistray.estimate import UNKNOWN, Estimate
from mistray.ids import event_words
from mistray.metrics.ghost_ranking import bounds
from mistray.recorders.path_events import DIRECT, way_text
from mistray.recorders.sampled import Sampled
from mistray.toolkit.rows import column, derived
from mistray.toolkit.tables.frames import estimate_of

RANKED_BY = {"power": "power_W", "peak": "peak_W_mm2"}
DEEDS = {"T": "passes", "R": "reflects", "I": "reflects"}  # all other letters: scatters


@dataclass(frozen=True, kw_only=True)
class WorstPath:
    """
    Stray path at the field where it is worst; its values are those of ``report.table``.

    Attributes
    ----------
    label : str
        Name of the path in words; with several sources that of its source follows in parentheses.
    few_rays, contested : bool
        Whether its values have no errors there, and whether it may be as bright as the worst path of all fields.
    fields : tuple of float
        All fields where light takes this path, ascending, degrees.
    """

    field_deg: float = column("that field, degrees")
    path_id: int = column("its row in the table of this field")
    label: str
    kind: str = column("its kind")
    power_W: Estimate = column("its power", head="power [W absorbed]")
    percent_of_stray: Estimate = column("its share of the stray light", head="of stray light [%]")
    normalised: Estimate = column("its RMS irradiance over that of the direct image on axis")
    peak_W_mm2: Estimate = column("its brightest pixel, W/mm²; NaN unless paths are ranked by it")
    few_rays: bool
    contested: bool
    fields: tuple[float, ...]

    @derived.column("its name, with a mark where the numbers are in doubt", head="path")
    def marked(self) -> str:
        """Name of the path, with a mark where its values are in doubt."""
        return f"{self.label} {mark_of(self)}".rstrip()


@dataclass(frozen=True)
class Remedy:
    """
    Surface that sends most of the stray light of a field to the detector.

    Attributes
    ----------
    surface : str
        Id of the surface.
    deed : {"reflects", "scatters", "passes"}
        Interaction with most of that light. "passes": it transmits light where the direct image does not go, as at an
        edge.
    field_deg : float
        Field angle with the most stray light, degrees.
    percent : Estimate
        Percentage of the stray light of this field that the surface takes part in.
    left_W : dict
        Stray light at every field without that of this surface, W, by field angle. It is exact if the surface came to
        absorb the light that it now sends astray. A coating that transmits it instead makes other paths through the
        surface brighter by a factor of 1/(1 - R) for each transmission.
    """

    surface: str
    deed: str
    field_deg: float
    percent: Estimate
    left_W: dict[float, Estimate]


def worst_of_all_fields(report: GhostReport, count: int = 10) -> list[WorstPath]:
    """
    Return the worst stray paths of all fields, each once for each source, at the field where it is worst.

    Parameters
    ----------
    report : GhostReport
        Its rank is the order: by the lower bound of the RMS irradiance, by power or by peak. By RMS irradiance and by
        peak, paths of few rays come last, as in ``report.table``.
    count : int
        Largest number of paths.
    """
    tables = [report.table(field)[lambda t: t.kind != DIRECT].assign(field_deg=field) for field in report]
    every = pd.concat(tables, ignore_index=True)
    if every.empty:
        return []
    low, high = bounds(every)
    if report.rank == "rms":
        harm = pd.Series(low, every.index)
    else:
        harm = every[RANKED_BY[report.rank]].where(~every.few_rays | (report.rank == "power"))
    if every.source.nunique() > 1:
        every["label"] = every.label + " (" + every.source + ")"
    every = every.assign(way=[*zip(every.source, way_text(every.events), strict=True)], harm=harm, high=high)
    every = every.sort_values(["harm", RANKS["rms"]], ascending=[False, True], na_position="last")
    fields = every.groupby("way").field_deg.agg(lambda found: tuple(sorted(set(found))))
    first = every.drop_duplicates("way").head(count)
    contested = (first.high > first.harm.iloc[0]) & (np.arange(len(first)) > 0)
    first = first.assign(contested=contested & (report.rank == "rms"))
    names = ("field_deg", "path_id", "label", "kind", "few_rays", "contested")
    return [
        WorstPath(
            **{name: row[name] for name in names},
            power_W=estimate_of(row, "power_W"),
            percent_of_stray=estimate_of(row, "percent_of_stray"),
            normalised=estimate_of(row, "normalised_rms_irradiance"),
            peak_W_mm2=estimate_of(row, "peak_W_mm2") if "peak_W_mm2" in row else UNKNOWN,
            fields=fields[row["way"]],
        )
        for row in first.to_dict("records")
    ]


def brightest_field(report: GhostReport) -> float | None:
    """Return the field angle of the worst stray path by RMS irradiance, degrees; None if none can be normalised."""
    rated = [field for field in report if report.summary(field).brightest_normalised.value > 0]
    lower = {field: float(bounds(report.top(field, 1, "rms"))[0, 0]) for field in rated}
    return max(rated, key=lambda field: -math.inf if math.isnan(lower[field]) else lower[field], default=None)


def most_stray(report: GhostReport) -> float | None:
    """Return the field angle with the most stray light, degrees; None if no field has any."""
    stray_W = {field: report.power_of(field, _stray(report, field)).value for field in report}
    return max((field for field in report if stray_W[field] > 0), key=stray_W.__getitem__, default=None)


def shares_of_kinds(report: GhostReport, field_deg: float) -> dict[str, Estimate]:
    """Return the percentage of a field's stray light that each kind of path carries, the largest first."""
    stray = _stray(report, field_deg)
    found = {str(kind): _percent(report, field_deg, rows, stray) for kind, rows in stray.groupby("kind")}
    return dict(sorted(found.items(), key=lambda item: -item[1].value))


def remedy(report: GhostReport) -> Remedy | None:
    """
    Return the surface that takes part in most of the stray light, at the field that has the most.

    A surface takes part in a path that is reflected or scattered there and the direct image is not, or that passes
    where no direct image does. Detectors are left out: their reflectance is seldom a choice. The result is None without
    stray light, or if no surface takes part in it.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    """
    field = most_stray(report)
    if field is None:
        return None
    wanted = _design_events(report)
    detectors = {name for t in report.values() for name in t.energy.detected}
    stray_at = {at: _stray(report, at) for at in report}
    deeds_at = {at: _deeds(rows, wanted, detectors) for at, rows in stray_at.items()}
    stray, deeds = stray_at[field], deeds_at[field]
    if deeds.empty:
        return None
    by_surface = deeds.drop_duplicates(["surface", "row"]).groupby("surface").power_W.sum()
    surface = str(by_surface.idxmax())
    own = deeds[deeds.surface == surface]
    left = {}
    for at, found in deeds_at.items():
        rows, taken = stray_at[at], found.row[found.surface == surface].to_numpy(np.int64)
        left[at] = report.power_of(at, rows.iloc[np.delete(np.arange(len(rows)), taken)])
    return Remedy(
        surface=surface,
        deed=str(own.groupby("deed").power_W.sum().idxmax()),
        field_deg=field,
        percent=_percent(report, field, stray.iloc[sorted(set(own.row))], stray),
        left_W=left,
    )


def _stray(report: GhostReport, field_deg: float) -> pd.DataFrame:
    table = report.table(field_deg)
    return table[table.kind != DIRECT]


def _design_events(report: GhostReport) -> set[str]:
    """Return the events, such as ``L1_front:T``, that occur on the direct images of any field."""
    tables = [report[field].paths.by_way() for field in report] + [report.nominal_trace.paths.by_way()]
    return {word for table in tables for text in table.events[table.kind == DIRECT] for word in event_words(text)}


def _deeds(rows: pd.DataFrame, wanted: set[str], detectors: set[str]) -> pd.DataFrame:
    """
    Return a row for each event of a stray path at a surface: surface, event in words, row of the path, power, W.

    Events that direct images have too, absorption, and events at detectors are left out. Without direct images all
    transmission is left out.
    """
    found = []
    for number, (text, power) in enumerate(zip(way_text(rows.events), rows.power_W, strict=True)):
        for word in event_words(text):
            surface, _, letter = word.rpartition(":")
            # Where no direct image is known, nobody can say what light should pass
            harmless = word in wanted or letter == "A" or (letter == "T" and not wanted)
            if surface not in detectors and not harmless:
                found.append((surface, DEEDS.get(letter, "scatters"), number, power))
    return pd.DataFrame(found, columns=["surface", "deed", "row", "power_W"])


def _percent(report: GhostReport, field_deg: float, rows: pd.DataFrame, of: pd.DataFrame) -> Estimate:
    """Return the power of path rows as a percentage of that of others; its error allows for rays common to both."""
    groups: Sequence[list[int]] = [[i for path_ids in part.path_ids for i in path_ids] for part in (rows, of)]
    light: Sampled = report[field_deg].paths.numbers(groups).light
    share = light[np.array([0])].over(light[np.array([1])])
    return Estimate(100 * float(share.value[0]), 100 * float(share.se[0]))

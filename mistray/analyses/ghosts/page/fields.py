"""Section of one field angle in the HTML report: statistics, map and paths."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import pandas as pd
from markupsafe import Markup

from mistray.analyses.ghosts.field_summary import FieldSummary
from mistray.analyses.ghosts.maps.path_maps import FieldMaps
from mistray.analyses.ghosts.page.answer import field_anchor
from mistray.analyses.ghosts.page.path_explorer import BOX_HEADER, explorer, picture_cell
from mistray.analyses.ghosts.page.thumbnails import DECADES, thumbnail
from mistray.analyses.ghosts.request import RANKS, rank_column
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.stray_levels import LEVELS
from mistray.analyses.ghosts.tables.levels import TITLES, level_table
from mistray.analyses.ghosts.tables.path_columns import CONTESTED, FEW, NUMBERS, PathColumns, marked
from mistray.analyses.ghosts.tables.printed import AIRY_TEXT, CONTESTED_TEXT, FEW_TEXT, is_partly_reflected
from mistray.estimate import Estimate
from mistray.toolkit.drawings.section_layout import layout
from mistray.toolkit.pages.markup import image
from mistray.toolkit.pages.model import (
    Column,
    FigurePart,
    Filter,
    Fold,
    Folded,
    NotePart,
    PagePart,
    Table,
    Value,
    columns,
)
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.rows import table
from mistray.toolkit.tables.text import ABSENT, number, with_error
from mistray.toolkit.typeset import power_of_ten

SURFACE_AND_ALL = 2  # columns of a table of levels that holds none
ROWS_SHOWN = 60  # the worst paths
STRONGEST_SHOWN = 10  # and the first by power and by RMS irradiance
AT_WAVELENGTHS = (
    "Normalised to the on-axis image at the same wavelength. Of all light: at all wavelengths; of stray light: at this "
    "one."
)
PICTURES = Markup(
    "Pictures: log<sub>10</sub> of the irradiance about the centroid of each path, "
    '<i class="scale"></i> from the floor to the top that stand below it in W/mm², '
    f"at most {DECADES:g} decades; black: less, or no ray."
)
RANK_HEADERS = {"rms": "RMS irr.", "power": "power", "peak": "peak"}


def field_section(report: GhostReport, s: FieldSummary, pictures: Mapping[str, bytes], per_wavelength: bool) -> Folded:
    """
    Return the section of one field: statistics, system and path table, folded behind a line with its main results.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    s : FieldSummary
        Summary of all light of this field.
    pictures : mapping of str to bytes
        Colour pictures as PNG by file name, as from `mistray.analyses.ghosts.page.output.draw`.
    per_wavelength : bool
        Add the paths at each wavelength.
    """
    t = report[s.field_deg]
    m, stray = s.map, report.stray_statistics(s.field_deg)
    heads = columns("<map", "min [W/mm²]", "max [W/mm²]", "average [W/mm²]", "RMS [W/mm²]", "total flux [W absorbed]",
                    "incident rays")  # fmt: skip
    block: list[list[Value]] = [
        [name, number(v.minimum), Estimate(v.maximum, v.maximum_se), *map(number, (v.mean, v.rms, v.flux_W)),
         v.incident_rays]
        for name, v in (("all light", m), ("without the direct image", stray))
    ]  # fmt: skip
    kinds = ", ".join(f"{count} {kind}" for kind, count in s.paths_of_kind.items() if count)
    asymmetry = ""
    if math.isfinite(s.asymmetry) and float(t.settings.get("azimuth_deg") or 0.0) % 180 == 0:
        asymmetry = (
            f" Left-right asymmetry of the map {s.asymmetry:.2g}; noise alone gives {s.asymmetry_expected:.2g} "
            "in a system that is symmetric about the y-z plane."
        )
    text = (
        f"{s.paths} paths ({kinds}). Pixels {m.pixel_mm[0] * 1e3:.4g} × {m.pixel_mm[1] * 1e3:.4g} µm. "
        f"{thousands(t.segments)} segments traced in {t.seconds:.2f} s.{asymmetry}"
    )
    colour = pictures.get(f"colour_{s.field_deg:g}deg.png")
    anchor = field_anchor(s.field_deg)
    told = f"section of the system with rays of the direct image and of the worst stray paths, field {s.field_deg:g}°"
    parts: list[PagePart] = [
        NotePart(text),
        FigurePart(functools.partial(layout, report, s.field_deg), text=told),
        *([FigurePart(colour, text=f"the detector in colour, field {s.field_deg:g}°")] if colour else []),
        *explored_paths(report, s.field_deg, f"t-{anchor}"),
        NotePart("Irradiance and levels", "h3"),
        Table(heads, block, f"t-map-{anchor}", sortable=False),
    ]
    for by in LEVELS:
        levels = level_table(report, s.field_deg, by, f"t-{by}-levels-{anchor}")
        if len(levels.columns) > SURFACE_AND_ALL:
            parts += [NotePart(f"{TITLES[by]}."), levels]
    if per_wavelength:
        parts.append(_paths_at_wavelengths(report, s.field_deg, f"t-waves-{anchor}"))
    return Folded(_headline(report, s), parts, "field", anchor)


def _headline(report: GhostReport, s: FieldSummary) -> str:
    """Return the line that opens a field: direct and stray power absorbed, W, and the worst path."""
    power = s.direct.power_W
    direct = f"{with_error(power)} W direct light absorbed" if power.value > 0 else "no direct light"
    text = f"Field {s.field_deg:g}°: {direct}"
    worst = report.top(s.field_deg, 1)
    if worst.empty:
        return f"{text}, no stray light"
    return f"{text}, {with_error(s.stray_W)} W stray light absorbed; worst path {worst.label.iloc[0]}"


def mapped_paths(report: GhostReport, field_deg: float) -> FieldMaps:
    """Return the power maps, W, of the paths in a field's table; made once, by tracing its rays once more."""
    return report.path_maps(field_deg, list(shown_paths(report, field_deg).path_id))


def explored_paths(report: GhostReport, field_deg: float, name: str) -> list[PagePart]:
    """
    Return the table of a field's paths with a picture of each, and the panel that shows the selected path.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    field_deg : float
        Field angle, degrees.
    name : str
        Id of the table.
    """
    paths, shown, maps = report.table(field_deg), shown_paths(report, field_deg), mapped_paths(report, field_deg)
    ranks = {column: Column("rank", RANK_HEADERS[rank]) for rank, column in RANKS.items() if column in paths}
    images: list[list[Value]] = []
    ends: list[list[Value]] = []
    for row in shown.itertuples(index=False):
        images.append([_picture(report, field_deg, row, maps), ""])
        own = [str(rank) if rank else ABSENT for rank in (getattr(row, column) for column in ranks)]
        ends.append([*own, Fold(row.path, row.events, "path m")])
    last = Table([*ranks.values(), *columns("<path [T R I t r A]")], ends)
    listed = Table([*columns("image"), BOX_HEADER], images, name).beside(_paths(shown, shown, False), last)
    left_out = paths[~paths.path_id.isin(shown.path_id)]
    notes = []
    if len(left_out):
        share = f"{left_out.percent_of_stray.sum():.3g} % of the stray light"
        notes.append(f"{len(left_out)} more paths are in paths.csv; together they hold {share}.")
    unmapped = int((~shown.path_id.isin(list(maps.paths))).sum())
    if unmapped:
        notes.append(
            f"{unmapped} of these paths have no map, because the detector has too many pixels for maps of all of them; "
            "in a box they count among the rest."
        )
    if shown.few_rays.any():
        notes.append(f"{FEW} {FEW_TEXT}.")
    if shown.airy_radius_mm.notna().any():
        notes.append(f"{AIRY_TEXT}.")
    if shown.contested.any():
        notes.append(f"{CONTESTED} {CONTESTED_TEXT}.")
    return [
        explorer(report, field_deg, maps, name),
        _filter(field_deg, name),
        NotePart(PICTURES, "note"),
        listed,
        *([NotePart(" ".join(notes), "note")] if notes else []),
    ]


def _filter(field_deg: float, name: str) -> Filter:
    return Filter(name, "filter rows, for example: detector window", f"filter the paths of field {field_deg:g}°")


def _paths_at_wavelengths(report: GhostReport, field_deg: float, name: str) -> Folded:
    """Return the folded table of the shown paths at each of their wavelengths."""
    shown = shown_paths(report, field_deg)
    spectra = [report.spectrum(field_deg, path_id).assign(path_id=path_id) for path_id in shown.path_id]
    every = pd.concat(spectra or [shown], ignore_index=True)
    found = _paths(report.with_airy(field_deg, every), shown, True, name)
    summary = f"The same paths at each wavelength ({len(found.rows)} rows)"
    return Folded(summary, [_filter(field_deg, name), found, NotePart(AT_WAVELENGTHS, "note")])


def shown_paths(report: GhostReport, field_deg: float) -> pd.DataFrame:
    """
    Return the rows of a field's path table that the report shows: direct paths, then stray ones, the worst first.

    They have the columns of `GhostReport.with_airy`, with powers in W and irradiances in W/mm².
    """
    column = rank_column(report.rank)
    paths = report.with_airy(field_deg, report.table(field_deg)).sort_values(column)
    first = (paths[["rank_power", "rank_rms_irradiance"]] <= STRONGEST_SHOWN).any(axis=1)
    return paths[first | (paths[column] <= ROWS_SHOWN)]


def _numbers(paths: pd.DataFrame, wave: bool) -> list[str]:
    """
    Return the names of numeric columns for a table of paths, without those that hold no values.

    With `wave` each row is one wavelength.
    """
    absent = {name for name in ("polarization", "s1", "s2", "s3", "airy_radius_mm") if paths[name].isna().all()}
    absent |= {"airy_irradiance_W_mm2"} if "airy_radius_mm" in absent else set()
    absent |= set() if is_partly_reflected(paths) else {"incident_W"}
    absent |= set() if "rank_peak" in paths and not wave else {"peak_W_mm2"}
    return [name for name in NUMBERS if name not in absent]


def _paths(rows: pd.DataFrame, shown: pd.DataFrame, wavelength: bool, name: str = "") -> Table:
    """
    Return the table of path rows; its numeric columns are those with values for the paths in `shown`.

    With `wavelength` each row is one wavelength, and has a column for it, nm.
    """
    only = ["path_id", "label", "kind", *["wavelength_nm"] * wavelength, "rays", *_numbers(shown, wavelength)]
    return table(PathColumns, marked(rows), name, only)


def _picture(report: GhostReport, field_deg: float, row: Any, maps: FieldMaps) -> Value:
    if row.path_id not in maps.paths:
        return ""
    t = report[field_deg]
    height, width = t.irradiance.shape
    found = thumbnail(maps.paths[row.path_id], t.extent, (height, width), (row.x_mm, row.y_mm), row.rms_radius_mm)
    scale = " … ".join(power_of_ten(round(limit)) for limit in found.limits) if found.limits else "dark"
    content = image(found.png, f"irradiance of path {row.path_id}")
    return picture_cell(row.path_id, content, (scale, f"{found.width_mm:.2g} mm wide"))

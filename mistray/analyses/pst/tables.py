"""Tables of a point source transmittance (PST) for pages and files, its printed text, and its JSON values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from mistray.analyses.pst.causes import Break, breaks, cause_frame, field_edge, stray_paths
from mistray.analyses.pst.result import Pst
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.percent import percent_text
from mistray.recorders.direction_recorder import CLASSES
from mistray.toolkit.pages.model import Column, Fold, Table, Value, columns
from mistray.toolkit.tables.text import ABSENT, number, table_text

if TYPE_CHECKING:
    from mistray.analyses.pst.first_level import FirstLevel

RARE = ("straight_shot", "edge_diffraction")  # classes that are shown where there are any
DEFINITIONS = {
    "normal": "PST = E_det/E_⊥: irradiance on the detector over that on a plane across the beam (normal)",
    "projected": "PST = E_det/(E_⊥ cos θ): irradiance on the detector over that on the aperture's plane (projected)",
}
METHODS = {
    "joined": "joined: rays from the detector and from the source, all angles at once",
    "adjoint": "adjoint: rays from the detector, all angles at once",
    "forward": "forward: one beam of light for each angle",
}
DENOMINATOR = "%: share of the stray light at that angle, which is all light but the direct image"


def shown_classes(pst: Pst) -> tuple[str, ...]:
    """Return the classes of light that a printed table shows; those in `RARE` only if they have light."""
    return tuple(group for group in CLASSES if group not in RARE or np.any(pst.curve(group)[0] > 0))


def name_of(group: str) -> str:
    """Return the name of a class of light with spaces instead of underscores."""
    return group.replace("_", " ")


def curve_frame(pst: Pst) -> pd.DataFrame:
    """
    Return the curve with full precision as a frame, one row for each field angle.

    Columns are angle_deg, angle_from_deg, angle_to_deg, convention and method; the mean PST over azimuths and its
    standard error, for all light, stray light and each class; and largest_share, see the function of this name.
    """
    columns: dict[str, Any] = {
        "angle_deg": pst.field_deg,
        "angle_from_deg": pst.grid.edges_deg[:, 0],
        "angle_to_deg": pst.grid.edges_deg[:, 1],
        "convention": pst.convention,
        "method": pst.method,
    }
    return pd.DataFrame(columns | pst.columns(pst.curve) | {"largest_share": largest_share(pst)})


def cell_frame(pst: Pst) -> pd.DataFrame:
    """
    Return the table of `Pst.to_pandas` with a column for the largest share, 0 … 1, of a single ray in each cell.

    That share is NaN if it is unknown.
    """
    share = pst.largest_share
    return pst.to_pandas().assign(largest_share=np.nan if share is None else share.ravel())


def largest_share(pst: Pst) -> np.ndarray:
    """Return the fraction of scattered light in its strongest ray, largest over azimuths, (n,); NaN: unknown."""
    if pst.largest_share is None:
        return np.full(len(pst.field_deg), np.nan)
    return np.asarray(pst.largest_share.max(axis=1))


def path_frame(pst: Pst) -> pd.DataFrame:
    """Return a DataFrame of the paths of cells: angle_deg, azimuth_deg, rank (1: strongest), then as in `Pst.paths`."""
    parts = []
    for angle in pst.field_deg:
        for azimuth in pst.grid.azimuths_deg:
            rows = pst.paths(angle, azimuth)
            rows.insert(0, "rank", np.arange(1, len(rows) + 1))
            rows.insert(0, "azimuth_deg", azimuth)
            rows.insert(0, "angle_deg", angle)
            parts.append(rows)
    return pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)


def curve_table(pst: Pst) -> Table:
    """Return the table of the PST of all light, stray light and each class, with standard errors, for a page."""
    shown = ("total", "stray", *shown_classes(pst))
    curves = zip(*map(pst.estimates, shown), strict=True)
    shares = largest_share(pst)
    rows: list[list[Value]] = []
    for angle, pairs, part in zip(pst.field_deg, curves, shares, strict=True):
        share = number(100 * float(part), 3) if part else ABSENT
        rows.append([f"{angle:g}", *(pair if pair.value else ABSENT for pair in pairs), share])
    named = ("all light", "stray light", *map(name_of, shown[2:]))
    heads = columns("angle [deg]", *(f"{name} [PST]" for name in named), "largest ray [% of scatter]")
    return Table(heads, rows, "t-curve")


def curve_text(pst: Pst) -> str:
    """Return the PST curve as a text table: all light and stray light with standard errors, each class without."""
    table = curve_table(pst)
    heads = columns("angle [deg]", "PST [all light]", "PST [stray light]")
    heads += [Column(name_of(group)) for group in shown_classes(pst)]
    rows = [[*row[:3], *(number(v.value, 3) if isinstance(v, Estimate) else v for v in row[3:])] for row in table.rows]
    return table_text(Table([*heads, table.columns[-1]], rows))


def top_paths_text(pst: Pst, count: int) -> str:
    """
    Return the strongest stray paths of each angle side by side, with their percentages, as text.

    If there are none, a sentence says so.
    """
    tops = {angle: stray_paths(pst, angle, count) for angle in pst.field_deg}
    shown = max((len(top) for top in tops.values()), default=0)
    if not shown:
        where = " at angles that were traced at all azimuths" if np.isnan(pst.value).any() else ""
        return f"no stray light was seen{where}"
    heads = columns("angle [deg]", *(head for k in range(shown) for head in (f"<{k + 1}.", "[%]")))
    rows = []
    for angle, top in tops.items():
        cells = [f"{angle:g}"]
        for row in top.itertuples(index=False):
            cells += [str(row.label), number(float(row.percent_of_stray), 3)]
        rows.append(cells + [""] * (len(heads) - len(cells)))
    return table_text(Table(heads, rows))


def level_table(found: FirstLevel) -> Table:
    """Return the table of stray PST, one row per field angle and one column per set of limits on the paths."""
    curves = [one.estimates("stray") for one in found.curves.values()]
    angles = next(iter(found.curves.values())).field_deg
    rows: list[list[Value]] = [[f"{angle:g}", *values] for angle, *values in zip(angles, *curves, strict=True)]
    return Table(columns("angle [deg]", *found.curves), rows)


def breaks_table(found: Sequence[Break]) -> Table:
    """Return the table of abrupt bends of the curve, with slopes and the strongest causes on either side."""
    heads = columns("angle [deg]", "slope before [decades/deg]", "slope after [decades/deg]",
                    "<stray light before [% of it]", "<stray light after [% of it]")  # fmt: skip
    rows = [
        [f"{item.field_deg:g}", f"{item.slope_before:+.3f}", f"{item.slope_after:+.3f}", causes_text(item.before),
         causes_text(item.after)]
        for item in found
    ]  # fmt: skip
    return Table(heads, rows, "t-breaks")


def paths_table(pst: Pst, count: int) -> Table:
    """Return the table of the strongest stray paths of each angle, one per row, for a page."""
    heads = columns(
        "angle [deg]", "rank", "<path", "<kind", "<first scatter surface", "rays", "PST", "of stray light [%]",
        "of all light [%]", "<surfaces [T R I t r A]",
    )  # fmt: skip
    rows: list[list[Value]] = [
        [
            *(f"{angle:g}", rank, str(row.label), str(row.kind), str(row.scatter_1), int(row.rays)),
            Estimate(row.pst, row.pst_se),
            *(number(float(share), 4) for share in (row.percent_of_stray, row.percent_of_all)),
            Fold(str(row.path), str(row.events), "path m"),
        ]
        for angle in pst.field_deg
        for rank, row in enumerate(stray_paths(pst, angle, count).itertuples(index=False), 1)
    ]
    return Table(heads, rows, "t-paths", filter=("filter rows, for example: window", "filter the paths"))


def causes_text(causes: Sequence[tuple[str, float]]) -> str:
    """Return causes of stray light and their shares as text, such as "barrel_1 83 %, ghosts 12 %"; a dash for none."""
    return ", ".join(f"{name} {percent_text(0.01 * share)}" for name, share in causes) or ABSENT


def causes_at(pst: Pst, count: int) -> list[list[tuple[str, float]]]:
    """Return the strongest causes of stray light at each angle with their percentages, over all azimuths."""
    table = cause_frame(pst)
    rows = [row[row > 0].sort_values(ascending=False, kind="stable").head(count) for _, row in table.iterrows()]
    return [[(str(name), float(share)) for name, share in row.items()] for row in rows]


def top_causes_text(pst: Pst, count: int) -> str:
    """Return the strongest causes of stray light at each angle with their percentages, as text."""
    rows = [[f"{angle:g}", causes_text(at)] for angle, at in zip(pst.field_deg, causes_at(pst, count), strict=True)]
    return table_text(Table(columns("angle [deg]", "<first scattered by, or else caused by [% of stray light]"), rows))


def pst_text(pst: Pst, paths_shown: int = 4) -> str:
    """
    Return the text that `mistray pst` prints: curve, strongest stray paths and causes of each angle, breaks, warnings.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    paths_shown : int
        Number of paths and causes for each angle; 0: none.

    Examples
    --------
    >>> pst = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> print(mistray.report.pst_text(pst, paths_shown=0).splitlines()[0])
    PST = E_det/E_⊥: irradiance on the detector over that on a plane across the beam (normal)
    """
    parts = [heading(pst), curve_text(pst), ""]
    if pst.path_rows is not None and paths_shown:
        parts += [f"Strongest stray paths of each angle; {DENOMINATOR}", top_paths_text(pst, paths_shown), ""]
        parts += [] if pst.is_dark else [top_causes_text(pst, paths_shown), ""]
    found = breaks(pst)
    if found:
        parts += ["Breaks of the curve of stray light", table_text(breaks_table(found)), ""]
    parts.append("±: one standard error")
    edge = field_edge(pst)
    if edge is not None:
        first = pst.field_deg[0]
        parts.append(f"edge of the field, half of the direct light at {first:g}°, interpolated: {edge:.1f}°")
    parts += [order.sentence for order in pst.next_orders]
    parts += [f"warning: {text}" for text in pst.notes]
    return "\n".join(parts)


def heading(pst: Pst) -> str:
    """Return two lines of text about a PST: its convention; then method, number of rays, wavelengths and cells."""
    facts = pst.facts
    lines = facts.get("wavelength_nm")
    parts = [METHODS[pst.method]]
    if facts.get("rays") is not None:
        parts.append(f"{float(facts['rays']):.3g} start rays")
    if lines is not None:
        parts.append(f"{', '.join(f'{line:g}' for line in np.atleast_1d(lines))} nm")
    widths = np.unique(np.round(np.diff(pst.grid.edges_deg, axis=1), 9))
    around = "all azimuths" if pst.grid.azimuth_cell_deg >= 360 else f"{pst.grid.azimuth_cell_deg:g}° of azimuth"
    parts.append(f"means over cells of {widths[-1]:g}° and {around}")
    return f"{DEFINITIONS[pst.convention]}\n{'; '.join(parts)}"


def pst_record(pst: Pst, paths_shown: int = 4) -> dict[str, Any]:
    """
    Return a PST as JSON-serialisable values.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    paths_shown : int
        Number of strongest stray paths and causes of each angle.

    Returns
    -------
    dict
        convention, definition, method, facts, grid, field_edge_deg, percent_of_stray (its definition), curve (rows of
        `curve_frame`, with ``paths`` and ``causes`` if the PST has paths), breaks, next_orders, warnings, and cells
        (rows of `cell_frame`) if there are several azimuths.
    """
    curve = curve_frame(pst).drop(columns=["convention", "method"]).to_dict("records")
    if pst.path_rows is not None:
        for row, causes in zip(curve, causes_at(pst, paths_shown), strict=True):
            row["paths"] = stray_paths(pst, row["angle_deg"], paths_shown).to_dict("records")
            row["causes"] = [{"cause": name, "percent_of_stray": share} for name, share in causes]
    record = {
        "convention": pst.convention,
        "definition": DEFINITIONS[pst.convention],
        "method": pst.method,
        "facts": pst.facts,
        "grid": pst.grid.facts(),
        "field_edge_deg": field_edge(pst),
        "percent_of_stray": DENOMINATOR.removeprefix("%: "),
        "curve": curve,
        "breaks": breaks(pst),
        "next_orders": [order.record() for order in pst.next_orders],
        "warnings": pst.notes,
    }
    if pst.grid.shape[1] > 1:
        record["cells"] = cell_frame(pst).drop(columns=["convention", "method"]).to_dict("records")
    return dict(plain(record))

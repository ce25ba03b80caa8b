"""A point source transmittance as one self-contained report.html."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from mistray.analysis.estimate import Estimate
from mistray.analysis.pst.causes import breaks, cause_frame, field_edge, stray_paths
from mistray.analysis.pst.result import Pst
from mistray.report.figures.pst import pst_causes, pst_curve
from mistray.report.html.hover import hover_figure
from mistray.report.html.markup import (
    cell,
    data_table,
    figure,
    filter_box,
    image,
    number_cell,
    section,
    setting_text,
    thousands,
    version_settings,
)
from mistray.report.html.page import page
from mistray.report.tables.pst import (
    DEFINITIONS,
    DENOMINATOR,
    causes_text,
    heading,
    largest_share,
    name_of,
    shown_classes,
    warnings,
)
from mistray.report.tables.text import ABSENT, number, with_error

MEANINGS = (
    ("E_det", "flux that meets the detector, on both sides and at every hit, over its area; what it absorbs of it does "
     "not matter"),
    ("E_⊥", "irradiance of the distant source on a plane across its beam"),
    ("θ", "angle between the beam and the axis; the PST of an angle is the mean over its cell of directions"),
    ("direct image", "light through the optics without scatter and without any reflection but those of mirrors"),
    ("straight shots", "light without scatter and reflection too, but past the optics, through an edge or a bevel, or "
     "with total reflection"),
    ("ghosts", "light that is reflected by optics or structure, and not scattered"),
    ("single, multiple scatter", "light that is scattered once, or several times, with or without reflections"),
    ("stray light", "all light but the direct image"),
    ("of stray light", "share of the stray light at this angle; the same denominator for all paths of an angle"),
    ("largest ray", "share of the scattered light of a cell in its strongest single ray; where it is large the tails "
     "of the distribution are not sampled, and both the value and its error are likely too small"),
    ("edge of the field", "angle at which the direct image has half of its PST at the smallest angle, interpolated"),
    ("break", "angle at which the slope of log10 PST of the stray light changes abruptly: another cause takes over"),
    ("± ", "one standard error, from the spread of independent batches of start rays"),
)  # fmt: skip


def html_text(
    pst: Pst, title: str = "scene", command: str = "", pictures: Mapping[str, bytes] | None = None, paths_shown: int = 4
) -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    pst : Pst
    title : str
        Name of the optical system.
    command : str
        The command line that made it.
    pictures : mapping of str to bytes, optional
        PNG files by name that stand in the report: pst_map.png and irradiance_….png, see
        `mistray.report.pst_output.draw`.
    paths_shown : int
        Strongest stray paths of each angle.
    """
    pictures = pictures or {}
    has_paths = pst.path_rows is not None and paths_shown > 0
    detector = {name: png for name, png in pictures.items() if name.startswith("irradiance_")}
    parts = [
        ("curve", "Curve", curve_figure(pst, title)),
        *([("causes", "Causes", _causes(pst, title))] if has_paths else []),
        *([("map", "Map", _map(pictures["pst_map.png"]))] if "pst_map.png" in pictures else []),
        *([("detector", "Detector", _detector(detector))] if detector else []),
        ("table", "Table", _table(pst)),
        *([("paths", "Paths", _paths(pst, paths_shown))] if has_paths else []),
        ("settings", "Definitions and settings", _settings(pst, command)),
    ]
    links = "".join(f'<a href="#{anchor}">{text}</a>' for anchor, text, _ in parts)
    sections = [_head(pst, title, links), *(section(*part) for part in parts)]
    return page(f"PST: {title}", sections, ("report", "hover"))


def _head(pst: Pst, title: str, links: str) -> str:
    definition, run = heading(pst).splitlines()
    found = warnings(pst)
    box = ""
    if found:
        items = "".join(f"<li>{escape(text)}</li>" for text in found)
        box = f'<div class="warnings"><b>Mind</b><ul>{items}</ul></div>'
    return (
        f'<header><h1>Point source transmittance: {escape(title)}</h1><p class="sub">{escape(definition)}.<br>'
        f"{escape(run)}.</p><p>{_finding(pst)}</p>{box}<nav>{links}</nav></header>"
    )


def _finding(pst: Pst) -> str:
    """The result in two sentences."""
    if pst.is_dark:
        return "No light was seen at any angle."
    angles, (total, total_se), (stray, stray_se) = pst.field_deg, pst.curve(), pst.curve("stray")
    first = f"PST({angles[0]:g}°) = <b>{with_error(Estimate(float(total[0]), float(total_se[0])))}</b>"
    edge = field_edge(pst)
    if edge is not None:
        first += f", edge of the field at {edge:.1f}°"
    outside = angles > (edge if edge is not None else -1.0)
    lit = stray > 0
    if not (outside & lit).any():
        return f"{first}."
    shown = (outside & lit).nonzero()[0][[0, -1]]
    values = [f"{with_error(Estimate(float(stray[i]), float(stray_se[i])))} at {angles[i]:g}°" for i in shown]
    where = "beyond it" if edge is not None else "over all angles"
    return f"{first}. Stray light {where}: {' to '.join(dict.fromkeys(values))}."


def curve_figure(pst: Pst, title: str = "") -> str:
    """The curve of a PST, with its values for the pointer."""
    figure = pst_curve(pst, title)
    curves = {"all light": pst.curve(), "stray light": pst.curve("stray")}
    curves |= {name_of(group): pst.curve(group) for group in shown_classes(pst)}
    values = [
        [
            (name, with_error(Estimate(float(value[i]), float(se[i]))) if value[i] else ABSENT)
            for name, (value, se) in curves.items()
        ]
        for i in range(len(pst.field_deg))
    ]
    titles = [f"PST at {angle:g}°" for angle in pst.field_deg]
    caption = "PST of all light, of the stray light and of each class; below, relative standard errors."
    return hover_figure("data-curve", figure, figure.axes[0], list(pst.field_deg), titles, values, caption)


def causes_figure(pst: Pst, title: str = "") -> str:
    """The shares of the causes of stray light, with their values for the pointer."""
    figure, table = pst_causes(pst, title), cause_frame(pst)
    values = [
        [(str(name), f"{number(float(share), 3)} %") for name, share in row.items() if share > 0]
        for _, row in table.iterrows()
    ]
    titles = [f"stray light at {angle:g}°" for angle in pst.field_deg]
    caption = "Where the stray light comes from: first surface that scatters it; ghosts are light only reflected."
    return hover_figure("data-causes", figure, figure.axes[0], list(pst.field_deg), titles, values, caption)


def _causes(pst: Pst, title: str) -> str:
    found = breaks(pst)
    parts = [causes_figure(pst, title)]
    if found:
        rows = [
            [
                cell(f"{item.field_deg:g}"),
                *(cell(f"{slope:+.3f}") for slope in (item.slope_before, item.slope_after)),
                *(cell(causes_text(causes), "t") for causes in (item.before, item.after)),
            ]
            for item in found
        ]
        header = [("angle", "deg"), ("slope before", "decades/deg"), ("slope after", "decades/deg"),
                  ("stray light before", "% of it", "t"), ("stray light after", "% of it", "t")]  # fmt: skip
        parts += ["<h3>Breaks of the curve of stray light</h3>", data_table("t-breaks", header, rows)]
    return "".join(parts)


def _map(png: bytes) -> str:
    caption = "PST over field angle and azimuth; the point of a map is the direction in which the light travels."
    return figure(image(png, "PST over field angle and azimuth"), caption)


def _detector(pictures: Mapping[str, bytes]) -> str:
    text = "Irradiance on the detector from a distant source of 1 W/mm² across its beam, each on its own scale."
    return f"<p>{text}</p>" + "".join(figure(image(png, name.removesuffix(".png"))) for name, png in pictures.items())


def _table(pst: Pst) -> str:
    shown = shown_classes(pst)
    header = [("angle", "deg"), ("all light", "PST"), ("stray light", "PST"),
              *((name_of(group), "PST") for group in shown), ("largest ray", "% of scatter")]  # fmt: skip
    curves = [pst.curve(group) for group in ("total", "stray", *shown)]
    share = largest_share(pst)
    rows = []
    for i, angle in enumerate(pst.field_deg):
        pairs = (Estimate(float(value[i]), float(se[i])) for value, se in curves)
        cells = [number_cell(pair) if pair.value else cell(ABSENT) for pair in pairs]
        rows.append([cell(f"{angle:g}"), *cells, cell(number(100 * float(share[i]), 3) if share[i] else ABSENT)])
    return f"<p>{escape(DEFINITIONS[pst.convention])}.</p>" + data_table("t-curve", header, rows)


def _paths(pst: Pst, count: int) -> str:
    header = [
        ("angle", "deg"), ("rank", ""), ("path", "", "t"), ("kind", "", "t"), ("first scatter surface", "", "t"),
        ("rays", ""), ("PST", ""), ("of stray light", "%"), ("of all light", "%"), ("surfaces", "T R I t r A", "t"),
    ]  # fmt: skip
    rows = []
    for angle in pst.field_deg:
        for rank, row in enumerate(stray_paths(pst, angle, count).itertuples(index=False), 1):
            rows.append(
                [
                    cell(f"{angle:g}"),
                    cell(str(rank)),
                    *(cell(str(text), "t") for text in (row.label, row.kind, row.scatter_1)),
                    cell(str(row.rays)),
                    number_cell(Estimate(float(row.pst), float(row.pst_se))),
                    *(cell(number(float(share), 4)) for share in (row.percent_of_stray, row.percent_of_all)),
                    '<td class="path m"><details><summary>'
                    f"{escape(str(row.path))}</summary>{escape(str(row.events))}</details></td>",
                ]
            )
    return (
        f"<p>The {count} strongest stray paths of each angle; {escape(DENOMINATOR)}. All that were kept are in "
        "pst_paths.csv.</p>"
        + filter_box("t-paths", "filter rows, for example: window", "filter the paths")
        + data_table("t-paths", header, rows)
    )


def _settings(pst: Pst, command: str) -> str:
    definitions = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in MEANINGS)
    shown: dict[str, Any] = {"convention": pst.convention, "method": pst.method}
    for key, value in pst.facts.items():
        if isinstance(value, dict):
            shown |= {f"{key}: {name}": item for name, item in value.items()}
        elif key != "notes":
            shown[key] = thousands(value) if key in ("rays", "segments") else value
    shown |= version_settings()
    pairs = ((escape(str(key)), escape(setting_text(value))) for key, value in shown.items())
    items = "".join(f"<dt>{key}</dt><dd>{value}</dd>" for key, value in pairs)
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Definitions</h3><dl class="settings">{definitions}</dl>'
        f'<h3>Settings</h3><dl class="settings">{items}</dl>{ran}'
    )

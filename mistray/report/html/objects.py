"""Critical, illuminated and common objects as a section of an HTML report, and as a report of their own."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import pandas as pd

from mistray.analysis.estimate import Estimate
from mistray.analysis.objects.rows import CommonObject, SceneObject
from mistray.analysis.objects.search import Objects
from mistray.report.html.markup import (
    cell,
    data_table,
    figure,
    filter_box,
    image,
    number_cell,
    section,
    setting_text,
    version_settings,
)
from mistray.report.html.page import page
from mistray.report.tables.objects import MEANINGS, POWER_UNIT, heading, shot_frame
from mistray.report.tables.text import ABSENT, number

CAPTION = (
    "Surfaces by what sees them. A surface with two sides has the colour of the more important one; the strongest "
    "common objects have their names above."
)


def html_text(found: Objects, estimates: pd.DataFrame, png: bytes, title: str = "scene", command: str = "") -> str:
    """
    A self-contained report.

    Parameters
    ----------
    found : Objects
    estimates : DataFrame
        ``found.estimates()``.
    png : bytes
        The picture of `mistray.report.figures.objects.objects_layout`.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.
    """
    links = (("layout", "Layout"), ("common", "Common"), ("estimates", "Estimate"), ("critical", "Critical"),
             ("illuminated", "Illuminated"), ("straight", "Straight shots"), ("settings", "Settings"))  # fmt: skip
    nav = "".join(f'<a href="#{anchor}">{text}</a>' for anchor, text in links)
    first, second = heading(found).splitlines()
    head = (
        f'<header><h1>Critical and illuminated objects: {escape(title)}</h1><p class="sub">{escape(first)}.<br>'
        f"{escape(second)}.</p><p>{_finding(found, estimates)}</p>{_warnings(found)}<nav>{nav}</nav></header>"
    )
    facts = "".join(
        f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>"
        for key, value in (found.facts | version_settings()).items()
    )
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    settings = f'{definitions()}<h3>Settings</h3><dl class="settings">{facts}</dl>{ran}'
    return page(
        f"Objects: {title}",
        [head, *objects_sections(found, estimates, png), section("settings", "Definitions and settings", settings)],
    )


def objects_sections(found: Objects, estimates: pd.DataFrame, png: bytes) -> list[str]:
    """The sections of a report from the layout to the straight shots."""
    return [
        section("layout", "Layout", figure(image(png, "objects in the section of the system"), CAPTION)),
        section("common", "Common objects", _common(found)),
        section("estimates", "Light by one scatter event", _estimates(estimates)),
        section("critical", "Critical objects", _objects("t-critical", found.critical)),
        section("illuminated", "Illuminated objects", _objects("t-illuminated", found.illuminated)),
        section("straight", "Straight shots", _shots(found)),
    ]


def definitions() -> str:
    """What the terms mean, as a list."""
    items = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in MEANINGS)
    return f'<h3>Definitions</h3><dl class="settings">{items}</dl>'


def _warnings(found: Objects) -> str:
    texts = found.warnings
    if not texts:
        return ""
    return f'<div class="warnings"><b>Mind</b><ul>{"".join(f"<li>{escape(text)}</li>" for text in texts)}</ul></div>'


def _finding(found: Objects, estimates: pd.DataFrame) -> str:
    """The result in two sentences."""
    counts = (
        f"The detector sees {len(found.critical)} objects that are no optics, light from outside reaches "
        f"{len(found.illuminated)}, and {len(found.common)} are both."
    )
    strongest = estimates[estimates.pst > 0].sort_values("pst", ascending=False).head(1)
    if strongest.empty:
        return escape(counts)
    row = strongest.iloc[0]
    angle = f" at {row.angle_deg:g}°" if pd.notna(row.angle_deg) else ""
    return (
        f"{escape(counts)} By the product estimate the most light of a single scatter event comes from "
        f"<b>{escape(str(row.id))}</b>{angle}: PST {number(row.pst, 2)}, {number(row.percent, 3)} % of all such light."
    )


def _objects(name: str, rows: Sequence[SceneObject]) -> str:
    header = [("rays", ""), ("power", POWER_UNIT), ("object", "", "t"), ("side", "", "t"), ("part", "", "t"),
              ("space", ""), ("stands between", "", "t"), ("stop", "", "t")]  # fmt: skip
    table = [
        [
            cell(str(row.rays)),
            number_cell(Estimate(row.power, row.power_se)),
            *(cell(text, "t") for text in (row.id, row.side, row.part)),
            cell(_space(row.space)),
            *(cell(text, "t") for text in (row.between, row.stop)),
        ]
        for row in rows
    ]
    return filter_box(name, "filter rows, for example: barrel", "filter the objects") + data_table(name, header, table)


def _common(found: Objects) -> str:
    text = "In the order of the light. By one scatter event each of them can send light to the detector."
    parts = [f"<p>{text}</p>{_both('t-common', found.common)}"] if found.common else ["<p>None but the optics.</p>"]
    if found.apart:
        names = ", ".join(row.id for row in found.apart)
        parts.append(f"<p>Lit in one place and seen in another, so not common: {escape(names)}.</p>")
    parts.append(
        f"<details><summary>{len(found.optics)} surfaces of the design path, common by design</summary>"
        f"{_both('t-optics', found.optics)}</details>"
    )
    return "".join(parts)


def _both(name: str, rows: Sequence[CommonObject]) -> str:
    header = [("object", "", "t"), ("side", "", "t"), ("part", "", "t"), ("space", ""), ("stands between", "", "t"),
              ("stop", "", "t"), ("critical", POWER_UNIT), ("rays", ""), ("illuminated", POWER_UNIT),
              ("rays", "")]  # fmt: skip
    table = [
        [
            *(cell(text, "t") for text in (row.id, row.side, row.part)),
            cell(_space(row.space)),
            *(cell(text, "t") for text in (row.between, row.stop)),
            number_cell(Estimate(row.critical_power, row.critical_power_se)),
            cell(str(row.critical_rays)),
            number_cell(Estimate(row.illuminated_power, row.illuminated_power_se)),
            cell(str(row.illuminated_rays)),
        ]
        for row in rows
    ]
    return data_table(name, header, table)


def _estimates(estimates: pd.DataFrame) -> str:
    shown = estimates[estimates.pst > 0]
    if shown.empty:
        return "<p>No common object scatters; give the surfaces scatter models.</p>"
    angles = bool(shown.angle_deg.notna().any())
    header = [*([("angle", "deg")] if angles else []), ("object", "", "t"), ("optic", "", "t"), ("side", "", "t"),
              ("stop", "", "t"), ("Φ", "W for 1 W/mm²"), ("BSDF", "1/sr"), ("GCF", ""), ("PST", ""),
              ("share", "%")]  # fmt: skip
    rows = [
        [
            *([cell(f"{row.angle_deg:g}")] if angles else []),
            *(cell(text, "t") for text in (row.id, "yes" if row.optic else "", row.side, row.stop)),
            number_cell(Estimate(row.flux_W, row.flux_W_se)),
            cell(number(row.bsdf_1_sr, 3)),
            cell(number(row.gcf, 3)),
            number_cell(Estimate(row.pst, row.pst_se)),
            cell(number(row.percent, 3)),
        ]
        for row in shown.itertuples(index=False)
    ]
    text = (
        "<p>Flux on the object times its BSDF times the projected solid angle π GCF of the detector, by one scatter "
        "event and no ghost. An estimate: the factors are means over pieces of the object.</p>"
    )
    return (
        text
        + filter_box("t-estimates", "filter rows", "filter the estimates")
        + data_table("t-estimates", header, rows)
    )


def _shots(found: Objects) -> str:
    frame = shot_frame(found)
    if frame.empty:
        return "<p>The detector sees the outside by the design path only.</p>"
    header = [("way", "", "t"), ("rays", ""), ("share", "of the view of the detector"), ("field angles", "deg")]
    rows = [
        [
            '<td class="t"><details><summary>'
            f"{escape(str(row.way))}</summary>{escape(str(row.surfaces))}</details></td>",
            cell(str(row.rays)),
            number_cell(Estimate(row.share, row.share_se)),
            cell(f"{row.angle_from_deg:.3g} … {row.angle_to_deg:.3g}"),
        ]
        for row in frame.itertuples(index=False)
    ]
    text = "<p>Ways by which the detector sees the outside past the optics, with neither reflection nor scatter.</p>"
    return text + data_table("t-shots", header, rows)


def _space(space: int) -> str:
    return str(space) if space >= 0 else ABSENT

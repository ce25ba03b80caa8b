"""Everything that `mistray objects` writes, into one directory, each file complete or not at all."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from markupsafe import Markup

from mistray.analysis.objects.search import Objects
from mistray.report.figures.objects import objects_layout
from mistray.report.figures.plots import as_png
from mistray.report.model import Figure, Folded, Note, Part, Report, Section
from mistray.report.output import write_report
from mistray.report.parts import settings_section, terms, version_settings
from mistray.report.tables.objects import (
    APART,
    common_table,
    csv_tables,
    estimate_table,
    heading,
    object_table,
    objects_record,
    shot_table,
)
from mistray.report.tables.text import number

CAPTION = (
    "Surfaces by what sees them. A surface with two sides has the colour of the more important one; the strongest "
    "common objects have their names above."
)
ESTIMATE = (
    "Flux on the object times its BSDF times the projected solid angle π GCF of the detector, by one scatter event and "
    "no ghost. An estimate: the factors are means over pieces of the object."
)
NO_SCATTER = "No common object scatters; give the surfaces scatter models."
COMMON = "In the order of the light. By one scatter event each of them can send light to the detector."
SHOTS = "Ways by which the detector sees the outside past the optics, with neither reflection nor scatter."
NO_SHOTS = "The detector sees the outside by the design path only."


def objects_report(found: Objects, estimates: pd.DataFrame, title: str = "scene", command: str = "") -> Report:
    """The report; see `write_objects`."""
    png = as_png(objects_layout(found, title))
    first, second = heading(found).splitlines()
    estimated, shots = estimate_table(estimates), shot_table(found)
    sections = [
        Section("layout", "Layout", [Figure(png, CAPTION, "objects in the section of the system")], "Layout"),
        Section("common", "Common objects", _common(found), "Common"),
        Section("estimates", "Light by one scatter event",
                [Note(ESTIMATE), estimated] if estimated.rows else [Note(NO_SCATTER)], "Estimate"),
        Section("critical", "Critical objects", [object_table(found.critical, name="t-critical")], "Critical"),
        Section("illuminated", "Illuminated objects",
                [object_table(found.illuminated, name="t-illuminated")], "Illuminated"),
        Section("straight", "Straight shots",
                [Note(SHOTS), shots] if shots.rows else [Note(NO_SHOTS)], "Straight shots"),
        settings_section(found.facts | version_settings(), command, terms("objects"), link="Settings"),
    ]  # fmt: skip
    return Report(
        "Critical and illuminated objects",
        title,
        sections,
        lead=[Note(Markup("{}.<br>{}.").format(first, second), "sub"), Note(_finding(found, estimates))],
        warnings=found.warnings,
        tab="Objects",
        csv=csv_tables(found, estimates),
        json={"objects.json": {"title": title, "command": command} | objects_record(found, estimates)},
        files={"objects.png": png},
        page="objects.html",
    )


def write_objects(
    found: Objects, estimates: pd.DataFrame, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write the tables of `csv_tables`, objects.png, objects.json and objects.html.

    Parameters
    ----------
    found : Objects
    estimates : DataFrame
        ``found.estimates()``.
    directory : str or Path
        Made if it is missing, with the directories above it; other files in it are left alone.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written.
    """
    return write_report(objects_report(found, estimates, title, command), directory)


def _finding(found: Objects, estimates: pd.DataFrame) -> str:
    """The result in two sentences."""
    counts = (
        f"The detector sees {len(found.critical)} objects that are no optics, light from outside reaches "
        f"{len(found.illuminated)}, and {len(found.common)} are both."
    )
    strongest = estimates[estimates.pst > 0].sort_values("pst", ascending=False).head(1)
    if strongest.empty:
        return counts
    row = strongest.iloc[0]
    angle = f" at {row.angle_deg:g}°" if pd.notna(row.angle_deg) else ""
    text = (
        "{} By the product estimate the most light of a single scatter event comes from <b>{}</b>{}: PST {}, {} % of "
        "all such light."
    )
    return Markup(text).format(counts, row.id, angle, number(row.pst, 2), number(row.percent, 3))


def _common(found: Objects) -> list[Part]:
    parts: list[Part] = [Note("None but the optics.")]
    if found.common:
        parts = [Note(COMMON), common_table(found.common, name="t-common")]
    if found.apart:
        parts.append(Note(APART.format(", ".join(row.id for row in found.apart))))
    optics = f"{len(found.optics)} surfaces of the design path, common by design"
    return [*parts, Folded(optics, [common_table(found.optics, name="t-optics")])]

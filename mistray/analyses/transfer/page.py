"""Report parts on images of points with stray light, shared by a study and other reports."""

from __future__ import annotations

from collections.abc import Callable

from mistray.analyses.transfer.figures import image_figure, mtf_figure, spread_figure
from mistray.analyses.transfer.image_spread import CLASSES
from mistray.analyses.transfer.result import FieldTransfer, Transfer
from mistray.estimate import Estimate
from mistray.time_budget import can_draw
from mistray.toolkit.figures.figure import Figure as Drawing
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart, Items, NotePart, PagePart, Table, Terms, Value, columns
from mistray.toolkit.pages.parts import terms
from mistray.toolkit.tables.frames import frame_table

CAPTIONS: tuple[tuple[str, Callable[[FieldTransfer, str], Drawing], str], ...] = (
    ("mtf", mtf_figure, "MTF with and without stray light, and the contrast that stray light takes."),
    (
        "spread",
        spread_figure,
        "Irradiance about the direct image by diffraction, ghosts and scatter; encircled energy and the light outside.",
    ),
    ("image", image_figure, "The image of a point, with stray light, over its peak."),
)
"""Name, figure and caption of the pictures of a field."""


def field_table(found: Transfer) -> Table:
    """Return the table of fields: light by class, % of that on the detector, veiling floor, and stray over direct."""
    heads = columns("<field", *(f"{name} [% of detected]" for name in CLASSES), "veiling floor", "glare")
    rows: list[list[Value]] = [
        [
            one.name,
            *(share.times(100) for share in one.shares.values()),
            one.veiling_floor,
            Estimate(one.glare.value, one.glare.se),
        ]
        for one in found
    ]
    return Table(heads, rows, empty="no field")


def curve_table(found: FieldTransfer) -> Table:
    """Return the table of a field's transfer functions, dimensionless, with a row for each frequency, 1/mm."""
    return frame_table("", found.to_pandas())


def transfer_parts(found: Transfer, title: str = "") -> list[PagePart]:
    """
    Return pictures of all fields, remarks, and definitions of terms, as page parts.

    A note replaces the pictures of a field if the time is up or its wavefront is not resolved.

    Parameters
    ----------
    found : Transfer
        Images of points with stray light.
    title : str
        Name of the optical system.
    """
    parts: list[PagePart] = []
    for one in found:
        parts.append(NotePart(f"Image of a point with stray light, field {one.name}", "h3"))
        if one.image.resolved and not can_draw():
            parts.append(NotePart("Its pictures are not drawn, for the time was up."))
        elif one.image.resolved:
            parts += [FigurePart(as_png(draw(one, title)), caption) for _, draw, caption in CAPTIONS]
        else:
            parts.append(NotePart("Its wavefront is too steep for the grid: it has no PSF and no MTF; see below."))
    if found.notes:
        parts.append(Items(found.notes, "warnings"))
    return [*parts, Terms(list(terms("transfer").items()))]

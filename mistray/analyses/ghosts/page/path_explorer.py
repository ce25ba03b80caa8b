"""Path explorer of a report: map, rays and events of the selected path, and the paths that light a box of the detector.

The page holds a map of every path of a table in the cells of `mistray.analyses.ghosts.maps.path_maps`, and coarse maps
of the other paths of the field. The script explorer.js draws them and adds up the light in a box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.analyses.ghosts.figures.ghost_images import common_range
from mistray.analyses.ghosts.maps.path_maps import FieldMaps
from mistray.analyses.ghosts.result import GhostReport
from mistray.events import INTERCEPTS, LETTERS
from mistray.toolkit.drawings.section_layout import RAYS_DRAWN, meridional, worst_paths
from mistray.toolkit.pages.embedded import MapStore, decimals, json_script, packed, rounded, section_data
from mistray.toolkit.pages.model import Column, Html, HtmlCell
from mistray.toolkit.pages.render import template

EVENT_WORDS = {
    "Absorbed": "absorbed",
    "SpecTran": "transmitted",
    "SpecRefl": "reflected",
    "TIR": "totally reflected",
    "RandTran": "scattered in transmission",
    "RandRefl": "scattered in reflection",
    "ImpTran": "scattered in transmission, aimed",
    "ImpRefl": "scattered in reflection, aimed",
}
BOX_HEADER = Column("in the box", "W", "inbox")


def page_data(report: GhostReport) -> Html:
    """Return data that the panels of all fields share, as HTML: section of the system, colours, words, map scales."""
    data = {
        "scales": {"light": common_range(report), "stray": common_range(report, stray=True)},
        "events": {letter: EVENT_WORDS[INTERCEPTS[code]] for code, letter in LETTERS.items()},
    }
    return Html(json_script("data-page", section_data(report.scene) | data))


def explorer(report: GhostReport, field_deg: float, maps: FieldMaps, table: str) -> Html:
    """
    Return the explorer panel of one field with its data, as HTML.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    field_deg : float
        Field angle, degrees.
    maps : FieldMaps
        Maps of the paths of the field.
    table : str
        Id of the table of paths that belongs to the panel; its rows name their paths in ``data-path``.
    """
    t = report[field_deg]
    store = MapStore()
    rays = report.rays_of_paths(field_deg, list(maps.paths))
    drawn = {path_id: [ray[:, [2, 1]] for ray in meridional(found, RAYS_DRAWN)] for path_id, found in rays.items()}
    points = np.concatenate([np.zeros((1, 2)), *(line for lines in drawn.values() for line in lines)])
    digits = decimals(points.min(axis=0), points.max(axis=0))
    labels = report.table(field_deg).set_index("path_id").label
    data = {
        "field": field_deg,
        "extent": list(t.extent),
        "shape": list(t.irradiance.shape),
        "grid": maps.grid,
        "direct": store.add(maps.direct),
        "stray": store.add(maps.stray),
        "rest": store.add(maps.rest),
        "paths": {str(path_id): store.add(found) for path_id, found in maps.paths.items()},
        "others": [[path_id, labels[path_id], store.add(found)] for path_id, found in maps.others.items()],
        "rays": {str(path_id): rounded(lines, digits) for path_id, lines in drawn.items()},
        "colours": {str(path_id): colour for path_id, colour, _ in worst_paths(report, field_deg)},
    }
    source = f"data-{table}"
    panel = template("explorer.html", table=table, source=source, field=f"{field_deg:g}")
    return Html(panel + json_script(source, {"packed": packed(data), "codes": store.text()}))


def picture_cell(path_id: int, content: str, below: Sequence[str]) -> HtmlCell:
    """Return the table cell with the button that selects a path; lines of text are below its picture."""
    return HtmlCell(template("picture_cell.html", path_id=path_id, content=content, below=below))

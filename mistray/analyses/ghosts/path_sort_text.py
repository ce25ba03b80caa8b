"""Path-sort text file: a list of paths with a representative ray each, for spreadsheets and scripts.

The fields are those of TracePro's path-sort file. Columns are separated by tabs.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.trace import Trace

TITLE = "Path sort: all paths that end on the detector, sorted by absorbed flux."
COLUMNS = (
    "Path", "Rays", "Absorbed flux [W]", "Standard error [W]", "Percent of detected flux", "Wavelength [nm]",
    "Intercepts",
)  # fmt: skip
RAY_COLUMNS = ("Split", "Intercept", "Object", "Surface")
ENDS = ("Emitted", "Absorbed")
_PATH_LINE = re.compile(r"Path (\d+): ")


@dataclass(frozen=True)
class SortedPath:
    """
    Path in a path-sort file.

    Attributes
    ----------
    path_id, rays : int
        Index of the path, 0 for the strongest, and its number of rays.
    absorbed_W, absorbed_se_W, percent, wavelength_nm : float
        Absorbed flux and its standard error, W, its percentage of all detected flux, and the wavelength, nm.
    events : tuple of (str, str, str)
        Intercept type, object and surface, from "Emitted" to "Absorbed".

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> first = mistray.report.parse_path_sort(mistray.report.path_sort_text(t, count=2))[0]
    >>> first.intercepts, first.events[1]
    ('(6 SpecTran)', ('SpecTran', 'L1', 'L1_front'))
    """

    path_id: int
    rays: int
    absorbed_W: float
    absorbed_se_W: float
    percent: float
    wavelength_nm: float
    events: tuple[tuple[str, str, str], ...]

    @property
    def intercepts(self) -> str:
        """
        Types of the events between start and end with counts, in order of first occurrence: "(4 SpecTran)(2 SpecRefl)".

        It is "(none)" without such events.
        """
        counts = Counter(kind for kind, _, _ in self.events if kind not in ENDS)
        return "".join(f"({count} {kind})" for kind, count in counts.items()) or "(none)"


def sorted_paths(trace: Trace, count: int | None = None) -> list[SortedPath]:
    """
    Return the paths of a trace as entries of a path-sort file.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    count : int, optional
        Number of paths, the strongest ones. Default: all.
    """
    # A medium that scatters is no surface; it is its own part
    part = {row.id: row.part for row in trace.surfaces}
    return [
        SortedPath(
            row.path_id,
            row.rays,
            row.power_W,
            row.power_se_W,
            row.percent,
            row.wavelength_nm,
            (("Emitted", "", ""), *((kind, part.get(name, name), name) for name, kind in row.event_list)),
        )
        for row in trace.paths[:count]
    ]


def path_sort_text(trace: Trace, count: int | None = None) -> str:
    """
    Return the path-sort file of a trace: a summary line for each path, then a representative ray of each.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    count : int, optional
        Number of paths, the strongest ones. Default: all.

    Returns
    -------
    str
        Text that `parse_path_sort` reads back.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> text = mistray.report.path_sort_text(t, count=1)
    >>> print(text.splitlines()[0])
    Path sort: all paths that end on the detector, sorted by absorbed flux.
    """
    entries = sorted_paths(trace, count)
    lines = [TITLE, _settings_line(trace.settings)]
    left_out = len(trace.paths) - len(entries)
    if left_out:
        rest = 100 - sum(path.percent for path in entries)
        lines.append(f"{left_out} weaker paths are left out; together they hold {rest:.3g} % of the detected flux.")
    lines += ["", "\t".join(COLUMNS)]
    for path in entries:
        power = f"{path.absorbed_W:.9g}\t{path.absorbed_se_W:.3g}\t{path.percent:.9g}"
        lines.append(f"{path.path_id}\t{path.rays}\t{power}\t{path.wavelength_nm:.9g}\t{path.intercepts}")
    for path in entries:
        lines += ["", f"Path {path.path_id}: {path.rays} rays, {path.absorbed_W:.9g} W absorbed; representative ray:"]
        lines.append("\t".join(RAY_COLUMNS))
        lines += ["\t".join((str(split), *event)).rstrip() for split, event in enumerate(path.events, start=1)]
    return "\n".join(lines) + "\n"


def parse_path_sort(text: str) -> list[SortedPath]:
    """
    Return the paths in the text of a path-sort file.

    Raises
    ------
    MistrayError
        If the text is not such a file, or a path lacks its representative ray.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> paths = mistray.report.parse_path_sort(mistray.report.path_sort_text(t, count=2))
    >>> [(path.path_id, path.rays) for path in paths]
    [(0, 3222), (1, 2309)]
    """
    lines = text.splitlines()
    header = "\t".join(COLUMNS)
    if not lines or lines[0] != TITLE or header not in lines:
        raise MistrayError(
            "path-sort file: the title or the column line is missing; give a file written by path_sort_text"
        )
    start = lines.index(header) + 1
    end = next((k for k in range(start, len(lines)) if not lines[k]), len(lines))
    events = _representative_rays(lines[end:])
    entries = []
    for line in lines[start:end]:
        path_id = line.partition("\t")[0]
        if not events.get(int(path_id)) or events[int(path_id)][-1][0] != ENDS[1]:
            raise MistrayError(f"path-sort file: path {path_id} has no whole representative ray; the file is cut off")
        _, rays, *numbers, _ = line.split("\t")
        absorbed, se, percent, wavelength = map(float, numbers)
        entries.append(SortedPath(int(path_id), int(rays), absorbed, se, percent, wavelength, events[int(path_id)]))
    return entries


def _representative_rays(lines: Sequence[str]) -> dict[int, tuple[tuple[str, str, str], ...]]:
    rays: dict[int, list[tuple[str, str, str]]] = {}
    current: list[tuple[str, str, str]] = []
    for line in lines:
        opened = _PATH_LINE.match(line)
        if opened:
            current = rays.setdefault(int(opened[1]), [])
        elif line and line[0].isdigit():
            _, kind, surface, target, *_ = [*line.split("\t"), "", "", ""]
            current.append((kind, surface, target))
    return {path_id: tuple(events) for path_id, events in rays.items()}


def _settings_line(settings: dict[str, Any]) -> str:
    shown = ("field_deg", "azimuth_deg", "rays", "max_reflections", "max_scatters", "flux_threshold", "splitting",
             "seed")  # fmt: skip
    return ", ".join(f"{key} = {settings[key]}" for key in shown if key in settings)

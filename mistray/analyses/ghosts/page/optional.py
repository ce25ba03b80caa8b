"""Optional sections of the report of a ghost analysis, and those that users add."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mistray.analyses.ghosts.page.flux_split import flux_split_section
from mistray.analyses.ghosts.page.light_maps import light_maps_section
from mistray.analyses.ghosts.page.passing import passing_section
from mistray.analyses.ghosts.page.photometric import photometric_section
from mistray.analyses.ghosts.page.surface_maps import surface_maps_section
from mistray.analyses.ghosts.result import GhostReport
from mistray.toolkit.pages.model import Section
from mistray.toolkit.pages.own_sections import SectionMaker, add_section, own_sections

MAKERS = (light_maps_section, passing_section, surface_maps_section, flux_split_section, photometric_section)


def optional_sections(report: GhostReport) -> list[Section]:
    """Return the optional sections that apply to a report, followed by those that users have added."""
    made = [make(report) for make in MAKERS]
    return [*(section for section in made if section is not None), *own_sections(report)]


def report_section(make: Any = None, *, of: type = GhostReport) -> Any:
    """
    Add a section to the report of every ghost analysis, or of other results, with its page, text, JSON and CSV files.

    Parameters
    ----------
    make : callable
        See `mistray.toolkit.pages.own_sections.add_section`. Without it a decorator is returned, as in
        ``@report_section(of=mistray.analysis.ThermalReport)``.
    of : type
        Class of the results whose reports have the section.

    Returns
    -------
    callable
        `make` itself, so that this function works as a decorator.

    Examples
    --------
    >>> from mistray.toolkit.pages.model import Section
    >>> @mistray.report.report_section
    ... def remarks(report):
    ...     return Section("Remarks", ("The barrel is painted black.",))
    >>> mistray.report.remove_section(remarks)
    """

    def add(make: SectionMaker) -> Callable[[Any], Any]:
        return add_section(make, of)

    return add if make is None else add(make)

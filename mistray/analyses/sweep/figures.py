"""Picture of a sweep: stray and direct light against field, wavelength or configuration."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from mistray.analyses.sweep.result import Sweep, estimate_of
from mistray.toolkit.figures.figure import Figure, legend_label, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION

COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BROWN, GREY, BLACK)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", ":", "-.")
PANELS = (("stray_W", "stray light over launched", True), ("direct_W", "direct image over launched", False))
LEGEND = 24  # lines that are named


def sweep_figure(result: Sweep, title: str = "") -> Figure:
    """
    Draw stray light and the direct image over the launched power, with standard errors.

    The abscissa is the field angle; with a single field the wavelength, and with a single wavelength too the
    configuration. Colours are configurations, markers and dashes are wavelengths.

    Parameters
    ----------
    result : Sweep
        Sweep to draw.
    title : str
        Name of the optical system.
    """
    figure, axes = Figure.of_panels(10.4, 4.4, 1, 2)
    names = [one.name for one in result.configurations]
    across, label = _abscissa(result)
    for panel, (column, text, logarithmic) in zip(axes, PANELS, strict=True):
        _draw(panel, result, column, across)
        if logarithmic and any(row[column] > 0 for row in result.rows):
            panel.set_yscale("log")
        if across == "configuration":
            panel.set_xticks(range(len(names)), names, rotation=30 if len(names) > 4 else 0, ha="center")
        plain_axes(panel, below=True, xlabel=label, ylabel=text)
    handles, labels = axes[0].get_legend_handles_labels()
    if 1 < len(handles) <= LEGEND:
        figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    return figure.headed(title, f"{len(result)} traces", "error bars: one standard error")


def _abscissa(result: Sweep) -> tuple[str, str]:
    if len(result.field_deg) > 1:
        return "field_deg", "field angle [deg]"
    if len(result.wavelengths_nm) > 1:
        return "wavelength_nm", "wavelength [nm]"
    return "configuration", "configuration"


def _draw(panel: Axes, result: Sweep, column: str, across: str) -> None:
    names = [one.name for one in result.configurations]
    forms = dict(zip(result.wavelengths_nm, zip(cycle(MARKERS), cycle(DASHES), strict=False), strict=False))
    lines: dict[tuple[str, str, tuple[str, str]], list[tuple[float, float, float]]] = {}
    for row in result.rows:
        value = estimate_of(row, column)
        if across == "configuration":
            key, x = ("", BLUE, (MARKERS[0], "")), float(names.index(row["configuration"]))
        else:
            colour = COLOURS[names.index(row["configuration"]) % len(COLOURS)]
            form = (MARKERS[0], DASHES[0]) if across == "wavelength_nm" else forms[row["wavelength_nm"]]
            words = [row["configuration"]] if len(names) > 1 else []
            words += [f"{row['wavelength_nm']:g} nm"] if across == "field_deg" and len(forms) > 1 else []
            key, x = (", ".join(words), colour, form), row[across]
        launched = row["launched_W"]
        lines.setdefault(key, []).append((x, value.value / launched, value.se / launched))
    for (text, colour, (marker, dashes)), points in lines.items():
        x, y, se = np.array(sorted(points)).T
        style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4, "lw": 1.0, "capsize": 2}
        panel.errorbar(x, y, yerr=se, label=legend_label(text) or None, ls=dashes, **style)

"""What an optimisation of coatings leaves behind: scene, tables, pictures, and the text that is printed."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mistray.analysis.estimate import Estimate
from mistray.coatings import spectrum
from mistray.coatings.stack import outside_first
from mistray.errors import MistrayError
from mistray.materials import complex_index
from mistray.optimize import Comparison, Optimization
from mistray.optimize.designs import Placed
from mistray.replace_file import replace_file
from mistray.report.html_optimization import optimization_html
from mistray.report.output import writable_directory
from mistray.report.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, as_png
from mistray.report.text import text_table, with_error
from mistray.scene.recoat import recoated

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
ANGLES_DEG = (0.0, 30.0)
POINTS = 201  # of a curve over wavelength
UNITS = {"path_power": "W/W", "ghost_to_signal": "1"}
MEANINGS = {"path_power": "power over launched power", "ghost_to_signal": "power over that of the direct image"}
MARGIN = 0.08  # of the band, drawn on either side of it


def comparison_table(comparison: Comparison, unit: str = "") -> str:
    """Before and after, in `unit`: the whole, each field and each wavelength."""
    rows = []
    for row in comparison.marginals():
        what = "all"
        if row.field_deg is not None:
            what = f"field {row.field_deg:g}°"
        elif row.wavelength_nm is not None:
            what = f"{row.wavelength_nm:g} nm"
        numbers = ((row.before, row.before_se), (row.after, row.after_se), (row.ratio, row.ratio_se))
        rows.append([what, *(with_error(Estimate(*pair)) for pair in numbers)])
    return text_table([("", ""), ("before", unit), ("after", unit), ("before / after", "1")], rows, left=(0,))


def design_table(result: Optimization) -> str:
    """The layers of every coating before and after."""
    rows = []
    for item in result.placed:
        before = result.designs[0].thickness_nm[item.group.name]
        after = result.best.thickness_nm[item.group.name]
        for k, (layer, bounds) in enumerate(zip(item.group.start.layers, item.group.bounds_nm, strict=True)):
            name = item.group.name if k == 0 else ""
            held = "*" if min(abs(after[k] - bound) for bound in bounds) < 1e-6 * bounds[1] else " "
            rows.append([name, str(k + 1), layer.material, f"{before[k]:.2f}", f"{after[k]:.2f}{held}"])
    heads = [("coating", ""), ("layer", ""), ("material", ""), ("before", "nm"), ("after", "nm")]
    table = text_table(heads, rows, left=(0, 2))
    return f"{table}\n* at its bound" if any(row[-1].endswith("*") for row in rows) else table


def report_text(result: Optimization) -> str:
    """What `mistray optimize` prints at the end."""
    metric = result.study.metric
    lines = [
        f"{metric.kind} of the paths '{metric.paths}', {len(result.comparison.seeds)} seeds not used in the search"
    ]
    lines += [comparison_table(result.comparison, UNITS[metric.kind]), ""]
    for item in result.placed:
        lines.append(f"coating '{item.group.name}' on {', '.join(item.surfaces)}; first layer {item.group.start.first}")
    lines += [design_table(result), ""]
    best = result.best_step
    lines.append(
        f"best design: from start {best.start + 1} of {len(result.designs)} ({result.best.name}), step {best.step}"
    )
    for number, reason in sorted(result.ended.items()):
        lines.append(f"search from start {number + 1}: {reason}")
    lines.append(
        f"{result.steps[-1].evaluations} gradients, {result.search_seconds:.1f} s; verification "
        f"{result.verification_seconds:.1f} s"
    )
    lines += [f"not in the gradient: {text}" for text in result.left_out]
    return "\n".join(lines)


def convergence_figure(result: Optimization) -> Figure:
    """Metric and gradient norm against the number of gradients computed, one line for each start."""
    figure = Figure(figsize=(10.4, 4.0), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, design in enumerate(result.designs):
        steps = [step for step in result.steps if step.start == number]
        x = [step.evaluations for step in steps]
        style = {"color": COLOURS[number % len(COLOURS)], "marker": "o", "ms": 3.5, "lw": 1.1}
        left.errorbar(x, [s.value for s in steps], [s.value_se for s in steps], label=design.name, capsize=2, **style)
        right.plot(x, [s.gradient_norm for s in steps], **style)
    left.set_ylabel(f"{result.study.metric.paths}: {MEANINGS[result.study.metric.kind]}")
    left.legend(fontsize=8, frameon=False)
    right.set_ylabel("|d log(metric) / d thickness| [1/nm]")
    for axes in (left, right):
        axes.set_yscale("log")
        axes.set_xlabel("gradients computed")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(True, which="major", color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    figure.supxlabel("error bars: one standard error; all points trace the same rays", fontsize=7.5, color="#555555")
    return figure


def reflectance_figure(result: Optimization) -> Figure:
    """R(λ) of every coating before and after, at 0° and 30° in the rarer material, one row for each glass."""
    panels = [(item, glass) for item in result.placed for glass in _glasses(item)]
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(5.4 * columns, 0.6 + 3.2 * rows), dpi=110, layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    wavelengths = _drawn_wavelengths(result)
    for axes, (item, (front, back)) in zip(grid.flat, panels, strict=False):
        inside = (wavelengths >= result.band_nm[0] - 1e-6) & (wavelengths <= result.band_nm[-1] + 1e-6)
        curves = []
        from_front = outside_first(complex_index(front, wavelengths[0]), complex_index(back, wavelengths[0]))
        for name, thickness, style in (("before", result.designs[0], "--"), ("after", result.best, "-")):
            stack = item.stack(thickness.thickness_nm[item.group.name])
            values = spectrum(stack, wavelengths, ANGLES_DEG, front, back, from_front).mean()
            curves.append(values)
            for k, colour in enumerate(COLOURS[: len(ANGLES_DEG)]):
                axes.plot(wavelengths, 100 * values[:, k], style, color=colour, lw=1.4 if name == "after" else 1.0)
        axes.axvspan(result.band_nm[0], result.band_nm[-1], color="#f0f0f0", zorder=0)
        sides = (front, back) if from_front else (back, front)
        axes.set_title(f"{item.group.name}, {' | '.join(sides)}", fontsize=10)
        axes.set_xlim(wavelengths[0], wavelengths[-1])
        axes.set_ylim(0, 110 * max(np.max(curve[inside]) for curve in curves))
        axes.set_xlabel("wavelength [nm]")
        axes.set_ylabel("reflectance [%]")
        axes.grid(True, color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    handles = [Line2D([], [], color=COLOURS[k], label=f"{angle:g}°") for k, angle in enumerate(ANGLES_DEG)]
    handles += [Line2D([], [], color=BLACK, ls=ls, label=name) for ls, name in (("--", "before"), ("-", "after"))]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    figure.supxlabel("mean of s and p; grey: wavelengths of the study", fontsize=7.5, color="#555555")
    return figure


def write_optimization(result: Optimization, directory: str | Path, command: str = "") -> list[Path]:
    """
    Write scene.xml, table.csv, history.csv, convergence.png, reflectance.png and report.html, each whole or not at all.

    Parameters
    ----------
    result : Optimization
    directory : str or Path
        Made if it is missing.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written.
    """
    target = writable_directory(directory)
    target.mkdir(parents=True, exist_ok=True)
    pictures = {
        "convergence.png": as_png(convergence_figure(result)),
        "reflectance.png": as_png(reflectance_figure(result)),
    }
    source = result.source.resolve()
    title = source.parent.name if source.name == "scene.xml" else source.stem
    files: dict[str, str | bytes] = {
        "scene.xml": recoated(result.source, result.coatings, target, f"study {Path(result.study.name).name}"),
        "table.csv": _csv(_table_rows(result.comparison)),
        "history.csv": _csv(_history_rows(result)),
        **pictures,
        "report.html": optimization_html(result, pictures, UNITS[result.study.metric.kind], title, command),
    }
    return [replace_file(target / name, content) for name, content in files.items()]


def _glasses(item: Placed) -> list[tuple[str, str]]:
    """Materials on both sides; a pair and its reverse look the same from outside if the first layer is outside."""
    if item.group.start.first != "outside":
        return list(item.glasses)
    return list({frozenset(pair): pair for pair in reversed(item.glasses)}.values())[::-1]


def _drawn_wavelengths(result: Optimization) -> np.ndarray:
    """The band and a little beyond, as far as all materials are known."""
    materials = {name for item in result.placed for pair in item.glasses for name in pair}
    materials |= {layer.material for item in result.placed for layer in item.group.start.layers}
    ends = []
    for edge, beyond in ((result.band_nm[0], 1 - MARGIN), (result.band_nm[-1], 1 + MARGIN)):
        try:
            for material in materials:
                complex_index(material, edge * beyond)
            ends.append(edge * beyond)
        except MistrayError:  # no data there
            ends.append(edge)
    return np.union1d(np.linspace(ends[0], ends[1], POINTS), result.band_nm)


def _table_rows(comparison: Comparison) -> list[Sequence[object]]:
    rows: list[Sequence[object]] = [
        ("field_deg", "wavelength_nm", "before", "before_se", "after", "after_se", "ratio", "ratio_se")
    ]
    for row in comparison.rows:
        place = ("all" if value is None else value for value in (row.field_deg, row.wavelength_nm))
        rows.append((*place, row.before, row.before_se, row.after, row.after_se, row.ratio, row.ratio_se))
    return rows


def _history_rows(result: Optimization) -> list[Sequence[object]]:
    fields = ("start", "step", "evaluations", "value", "value_se", "gradient_norm", "seconds")
    names = [f"{item.group.name}_{k}_nm" for item in result.placed for k in range(1, len(item.group.start.layers) + 1)]
    rows: list[Sequence[object]] = [(*fields, *names)]
    for step in result.steps:
        thickness = (d for item in result.placed for d in step.thickness_nm[item.group.name])
        rows.append((*(getattr(step, key) for key in fields), *thickness))
    return rows


def _csv(rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()

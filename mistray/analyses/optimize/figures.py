"""Pictures of an optimisation: its steps, its variables, and the spectra of its coatings."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mistray.analyses.optimize.study.comparison import Comparison, Levels
from mistray.analyses.optimize.study.optimization import Optimization
from mistray.analyses.optimize.study.state import Step
from mistray.analyses.optimize.study.study_scene import PlacedDesign
from mistray.coatings import spectrum
from mistray.coatings.stack import outside_first
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.materials import complex_index
from mistray.toolkit.figures.bars import bars, magnitude_bars
from mistray.toolkit.figures.figure import Figure, legend_label, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
STYLES = ("-", "--", ":", "-.")  # a colour comes again with the next of these
MARKERS = "osD^v"  # hollow, as lines of variables can hide each other
MARKED = 12  # steps with markers
NAMED = 16  # lines in a legend
ANGLES_DEG = (0.0, 30.0)
POINTS = 201  # of a curve over wavelength
MARGIN = 0.08  # of the band, drawn on either side of it


def search_figure(result: Optimization, title: str = "") -> Figure:
    """Draw merit and gradient norm of all searches, and terms of the best one relative to the start, by evaluation."""
    figure, (left, middle, right) = Figure.of_panels(13.2, 4.0, 1, 3, dpi=110)
    for number, start in enumerate(result.starts):
        steps = [step for step in result.steps if step.start == number]
        x = [step.evaluations for step in steps]
        style = {**_style(number), "marker": "o", "ms": 3.5}
        left.errorbar(x, [s.merit for s in steps], [s.merit_se for s in steps], label=start.name, capsize=2, **style)
        right.plot(x, [s.gradient_norm for s in steps], **style)
    left.set_ylabel("merit")
    best = _best_search(result)
    first = result.steps[0].terms
    for number, term in enumerate(result.study.terms):
        if first[term.name] == 0:
            continue  # nothing to relate it to
        shares = [step.terms[term.name] / first[term.name] for step in best]
        style = {**_style(number), "marker": "o", "ms": 3.5, "label": term.name}
        middle.plot([step.evaluations for step in best], shares, **style)
    middle.set_ylabel("terms of the best search\nover those of the given start")
    if all(np.min(line.get_ydata()) > 0 for line in middle.lines):
        middle.set_yscale("log")
    right.set_ylabel("length of the gradient")
    if any(step.gradient_norm > 0 for step in result.steps):
        right.set_yscale("log")
    for axes in (left, middle, right):
        _frame(axes, "evaluations", legend=axes is not right)
    fixed = result.study.optimizer.seeds == "fixed"
    rays = "all points trace the same rays" if fixed else "every point has its own rays"
    how = (
        "merit: sum of the terms to be lowered, as logarithms, and of penalties of limits. "
        "Gradient: of the merit, by shares of the way between the bounds.\n"
        f"Error bars: one standard error, long where few heavy rays carry a term; {rays}."
    )
    return figure.headed(title, small_print=how) if title else figure.small_print(how)


def comparison_figure(found: Comparison, title: str = "") -> Figure:
    """Draw each term, over all its fields and wavelengths, before over after as a bar with its standard error."""
    ratios = {row.term: Estimate(row.ratio, row.ratio_se) for row in found.rows if row.whole}
    return bars(ratios, [BLUE] * len(ratios), "before / after [1]").headed(title, f"on {len(found.seeds)} seeds")


def levels_figure(found: Levels, title: str = "") -> Figure:
    """Draw the mean of each term over the seeds, in its unit, as a bar with its standard error."""
    names = {f"{name} [{found.units.get(name, '1')}]": value for name, value in found.means.items()}
    return magnitude_bars(names, "mean over the seeds, in the unit of each term").headed(title, "terms")


def variables_figure(result: Optimization) -> Figure:
    """Draw the variables over the steps of the best search, scaled from 0 at the low to 1 at the high bound."""
    figure, axes = Figure.of_panels(8.4, 4.4, dpi=110)
    best = _best_search(result)
    shares = np.array([result.variables.shares(step.x) for step in best])
    every = -(-len(best) // MARKED)
    for number, variable in enumerate(result.variables.variables):
        marker = MARKERS[number % len(MARKERS)]
        style = {**_style(number), "marker": marker, "mfc": "none", "ms": 4 + 2 * (number % 3)}
        start = number % every  # so that markers of lines on top of each other take turns
        axes.plot(
            [step.step for step in best],
            shares[:, number],
            label=legend_label(variable.name),
            markevery=(start, every),
            **style,
        )
    _frame(axes, "step", ylim=(-0.03, 1.03), ylabel="share of the way from low to high bound")
    if len(result.variables) <= NAMED:
        figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return figure


def reflectance_figure(result: Optimization) -> Figure:
    """Draw R(λ) of every coating before and after, at 0° and 30° in the rarer medium, a panel per pair of materials."""
    panels = [(item, glass) for item in result.placed for glass in _glasses(item)]
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure, grid = Figure.of_panels(5.4 * columns, 0.6 + 3.2 * rows, rows, columns, dpi=110, squeeze=False)
    wavelengths = _drawn_wavelengths(result)
    for axes, (item, (front, back)) in zip(grid.flat, panels, strict=False):
        inside = (wavelengths >= result.band_nm[0] - 1e-6) & (wavelengths <= result.band_nm[-1] + 1e-6)
        curves = []
        from_front = outside_first(complex_index(front, wavelengths[0]), complex_index(back, wavelengths[0]))
        for name, step, style in (("before", result.steps[0], "--"), ("after", result.best, "-")):
            values = spectrum(
                result.stack(item.group.name, step), wavelengths, ANGLES_DEG, front, back, from_front
            ).mean()
            curves.append(values)
            for k, colour in enumerate(COLOURS[: len(ANGLES_DEG)]):
                axes.plot(wavelengths, 100 * values[:, k], style, color=colour, lw=1.4 if name == "after" else 1.0)
        axes.axvspan(result.band_nm[0], result.band_nm[-1], color="#f0f0f0", zorder=0)
        sides = (front, back) if from_front else (back, front)
        axes.set_title(f"{item.group.name}, {' | '.join(sides)}", fontsize=10)
        axes.set(xlim=wavelengths[[0, -1]], ylim=(0, 110 * max(np.max(curve[inside]) for curve in curves)))
        plain_axes(axes, xlabel="wavelength [nm]", ylabel="reflectance [%]")
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    handles = [Line2D([], [], color=COLOURS[k], label=f"{angle:g}°") for k, angle in enumerate(ANGLES_DEG)]
    handles += [Line2D([], [], color=BLACK, ls=ls, label=name) for ls, name in (("--", "before"), ("-", "after"))]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure.small_print("mean of s and p; grey: wavelengths of the study")


def _best_search(result: Optimization) -> list[Step]:
    """Return the steps of the search that found the best design."""
    return [step for step in result.steps if step.start == result.best.start]


def _style(number: int) -> dict[str, Any]:
    """Return colour, line style and width of the curve of index `number`, as Matplotlib arguments."""
    return {
        "color": COLOURS[number % len(COLOURS)],
        "ls": STYLES[number // len(COLOURS) % len(STYLES)],
        "lw": 1.1,
    }


def _frame(axes: Axes, below: str, **said: Any) -> None:
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    plain_axes(axes, xlabel=below, **said)


def _glasses(item: PlacedDesign) -> list[tuple[str, str]]:
    """
    Return the pairs of materials in front of and behind a coating for which its reflectance is drawn.

    A pair and its reverse count once if the design's first layer lies outside.
    """
    if item.group.start.first != "outside":
        return list(item.glasses)
    return list({frozenset(pair): pair for pair in reversed(item.glasses)}.values())[::-1]


def _drawn_wavelengths(result: Optimization) -> np.ndarray:
    """Return the wavelengths to draw, nm: the band, with each end moved out by 8 % if all materials have data there."""
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

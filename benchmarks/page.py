"""benchmarks/README.md and its figure, from the kept record."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from io import StringIO
from pathlib import Path

from record import Kept, Record

from mistray.replace_file import replace_file

HEAD = ("| compared | mistray | other | ratio | bar | equal work |", "|---|---|---|---|---|---|")
INTRODUCTION = """\
# Benchmarks

Written by `make bench`; do not edit. Each ratio is taken in one process from runs that alternate, the best of several,
kernels compiled before; "cores" is processor time over wall time. Ratios count, seconds depend on the machine. Where
two programs are compared, both get the same rays and the same lens, and "equal work" says in which number they agree,
and how well; if they do not, no ratio is given.

    make bench                                             # everything, about half an hour on two cores
    make bench BENCH='--only batoid optiland'              # parts; the kept rows of the others stay
    python benchmarks/bench.py --quick --only optiland     # seconds: shows that it runs, keeps nothing
    python benchmarks/bench.py --strict                    # exit code 1 if a ratio got worse by more than 15 %

[last.json](last.json) has the same as numbers. A run names every ratio that got worse by more than 15 % since the kept
one, and --strict keeps nothing then. Programs that are not installed have a row that says so; `make bench` installs all
but tmm_fast, which brings torch: `pip install tmm_fast`. Traces of up to 1e9 rays in constant memory, which take hours,
are a program of their own: `python benchmarks/many_rays.py`.
"""


def write_page(path: Path, figure: Path, record: Record, parts: Mapping[str, tuple[str, str]]) -> None:
    """
    Write the page and, if there is growth to show, the figure.

    Parameters
    ----------
    path, figure : Path
        Of the page and, in the same folder, of its figure.
    record : Record
    parts : mapping
        Part → its module, whose docstring says what each side computes, and its title.
    """
    lines = [INTRODUCTION, *_machines(list(record.values())), ""]
    for part, (module, title) in parts.items():
        rows = [kept for kept in record.values() if kept.part == part]
        if not rows:
            continue
        lines += [f"## {title[0].upper()}{title[1:]}", ""]
        if sides := _sides(module):
            lines += [sides, ""]
        lines += [*HEAD, *(str(kept.row) for kept in rows), ""]
        if part == "growth" and _draw(figure, rows):
            lines += [f"![Cost over what grows]({figure.name})", ""]
    replace_file(path, "\n".join(lines), "page of benchmarks")


def _machines(rows: list[Kept]) -> list[str]:
    """Each machine with the parts that were measured on it, the latest first."""
    places = {(kept.day, kept.machine) for kept in rows}
    lines = []
    for day, machine in sorted(places, reverse=True):
        parts = dict.fromkeys(kept.part for kept in rows if (kept.day, kept.machine) == (day, machine))
        what = "" if len(places) == 1 else f": {', '.join(parts)}"
        lines.append(f"- {day}, {machine}{what}")
    return lines


def _sides(module: str) -> str:
    """What a module says about both sides: its docstring without the first line; nothing is imported."""
    source = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
    text = ast.get_docstring(ast.parse(source)) or ""
    return text.partition("\n\n")[2].replace("``", "`")


def _draw(path: Path, rows: list[Kept]) -> bool:
    """Log-log curves of all rows that have points; False if none has."""
    with_points = [kept.row for kept in rows if kept.row.series]
    if not with_points:
        return False
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator

    columns = 3
    lines = -(-len(with_points) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.2 * lines), layout="constrained")
    FigureCanvasSVG(figure)
    for number, row in enumerate(with_points):
        axes = figure.add_subplot(lines, columns, number + 1)
        (x_name, x), (y_name, y) = row.series.items()
        axes.loglog(x, y, "o-")
        # The line through the first point that cost in proportion would follow
        axes.loglog(x, [y[0] * value / x[0] for value in x], "--", color="0.6", linewidth=1, label="linear")
        axes.set_xticks(x, labels=[f"{value:g}" for value in x])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlabel(x_name)
        axes.set_ylabel(y_name)
        axes.set_title(row.what.split(":")[0].replace("`", ""), fontsize=8)
        axes.legend(fontsize=7)
    text = StringIO()
    with rc_context({"svg.hashsalt": "mistray"}):  # the same points give the same file
        figure.savefig(text, format="svg", metadata={"Date": None})
    replace_file(path, text.getvalue(), "figure of benchmarks")
    return True

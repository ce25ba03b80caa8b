"""Texts of figures are shown as they are written, whatever signs the names in them have."""

from __future__ import annotations

import ast
import io
from pathlib import Path

import pytest
from matplotlib.text import Text

from mistray import report
from mistray.report.figures.figure import Figure, legend_label

NAMES = (r"$\frac{", r"a$b_{$", r"$x^2_1$", r"\$", "_^\\", '<i>"q"&</script>')


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_any_name_can_stand_anywhere(name: str, kind: str) -> None:
    figure = Figure(figsize=(3, 3), layout="constrained")
    axes = figure.subplots()
    axes.plot([1, 2], [1, 1e3], label=f"path {name}")
    axes.set_yscale("log")
    axes.set_xticks([1, 2], [name, name], rotation=30)
    axes.set_title(name)
    axes.set_xlabel(name)
    axes.annotate(name, (1, 1))
    figure.suptitle(name)
    figure.supxlabel(name)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", title=name)
    figure.savefig(io.BytesIO(), format=kind, bbox_inches="tight")
    shown = [text for text in figure.findobj(Text) if name in text.get_text()]
    assert len(shown) >= 9
    assert not any(text.get_parse_math() for text in shown)
    powers = [label for label in axes.get_yticklabels() if "10^" in label.get_text()]
    assert powers
    assert all(label.get_parse_math() for label in powers)


def test_a_legend_has_all_names_and_no_report_has_another_figure() -> None:
    axes = Figure().subplots()
    for name in ("_edge", "edge", "__"):
        axes.plot([0, 1], [0, 1], label=legend_label(name))
    assert [text.get_text().strip() for text in axes.legend().get_texts()] == ["_edge", "edge", "__"]
    for file in Path(report.__file__).parent.rglob("*.py"):
        if file.name == "figure.py":
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert node.module not in ("matplotlib.figure", "matplotlib.pyplot"), file.name
            if isinstance(node, ast.Import):
                assert not {name.name for name in node.names} & {"matplotlib.figure", "matplotlib.pyplot"}, file.name

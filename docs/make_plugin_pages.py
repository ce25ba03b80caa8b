"""Writes docs/plugins/*.md, one page a plugin and an index, from the docstrings of the plugin classes.

    python docs/make_plugin_pages.py

The docstrings are reStructuredText as in Mitsuba's own plugins: a first sentence, prose, one table of the parameters,
an XML and a Python example. They are read from the source, so that neither Mitsuba nor an installation is needed.
`tests/test_plugin_pages.py` keeps the pages current and loads their examples.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLUGINS = ROOT / "plugins"
PAGES = ROOT / "docs" / "plugins"
KINDS = {
    "shapes": "Shapes",
    "bsdfs": "BSDFs",
    "emitters": "Emitters",
    "sensors": "Sensors",
    "integrators": "Integrators",
}
COLUMNS = ("parameter", "unit", "range", "default", "meaning")
DIFFERENTIABLE = re.compile(r",? ?\(differentiable\)")
INTRODUCTION = """\
What mistray adds to Mitsuba 3. Lengths are in mm, wavelengths in nm, angles in degrees. A unit of 1 is a pure number;
where a parameter is no number its type stands instead. Parameters by their names in gradients and studies:
[docs/parameters.md](../parameters.md). How to write a plugin of your own:
[own_bsdf_plugin.ipynb](../../notebooks/own_bsdf_plugin.ipynb)."""
NOTE = "<!-- Written by docs/make_plugin_pages.py from the docstring of the class; change that. -->"


@dataclass(frozen=True)
class Parameter:
    """
    A row of a plugin's table.

    Attributes
    ----------
    name : str
        As in the table: ``radius``, ``r0, r1``, ``a4 … a20``, ``(nested) bsdf``.
    unit, range, default, meaning : str
        Cells; the unit of what is no number is its type.
    differentiable : bool
    """

    name: str
    unit: str
    range: str
    default: str
    meaning: str
    differentiable: bool

    @property
    def names(self) -> list[str]:
        """Single names: ``a4 … a8`` is a4, a6, a8 for even aspheres, ``xy_i_j`` stays; a nested object has none."""
        found = []
        for part in (part.strip() for part in self.name.split(",")):
            if span := re.fullmatch(r"([a-z]+)(\d+) … \1(\d+)", part):
                found += [f"{span[1]}{i}" for i in range(int(span[2]), int(span[3]) + 1, 2 if span[1] == "a" else 1)]
            elif re.fullmatch(r"\w+", part):
                found.append(part)
        return found


@dataclass(frozen=True)
class Manual:
    """
    What a docstring says.

    Attributes
    ----------
    plugin, kind : str
        Name in a scene, and folder of `plugins`.
    file : Path
    summary : str
        First sentence, Markdown.
    parts : tuple of (str, str)
        ("text", Markdown), ("table", ""), ("xml", code) and ("python", code), in their order.
    parameters : tuple of Parameter
    """

    plugin: str
    kind: str
    file: Path
    summary: str
    parts: tuple[tuple[str, str], ...]
    parameters: tuple[Parameter, ...]

    def example(self, language: str) -> str:
        """The example in "xml" or "python"."""
        return next(text for kind, text in self.parts if kind == language)

    def page(self) -> str:
        """The page, Markdown."""
        lines = [NOTE, "", f"# {self.plugin}", "", self.summary, ""]
        for kind, text in self.parts:
            if kind == "text":
                lines += [text, ""]
            elif kind == "table":
                lines += [*_markdown_table(self.parameters), ""]
            else:
                lines += [f"```{kind}", text, "```", ""]
        folder = f"plugins/{self.kind}/{self.file.name}"
        lines += [f"Plugin of the kind *{KINDS[self.kind].removesuffix('s').lower().replace('bsdf', 'BSDF')}*; "
                  f"source: [{folder}](../../{folder}). [All plugins](README.md)"]  # fmt: skip
        return "\n".join(lines) + "\n"


def manuals() -> list[Manual]:
    """
    The manuals of all plugins, shapes first.

    Raises
    ------
    ValueError
        A docstring has no table, or one without an example; the message names the file.
    """
    found = []
    for kind in KINDS:
        for file in sorted((PLUGINS / kind).glob("*.py")):
            if manual := _manual(kind, file):
                found.append(manual)
    return found


def pages() -> dict[str, str]:
    """File names in docs/plugins and what they hold."""
    found = manuals()
    return {"README.md": _index(found)} | {f"{manual.plugin}.md": manual.page() for manual in found}


def _manual(kind: str, file: Path) -> Manual | None:
    """The manual of the plugin of a file; None for a file that registers none."""
    source = file.read_text(encoding="utf-8")
    registered = re.search(r'^mi\.register_\w+\("(\w+)", lambda props: (\w+)\(props\)\)', source, re.MULTILINE)
    if registered is None:
        return None
    plugin, name = registered.groups()
    owner = next(node for node in ast.parse(source).body if isinstance(node, ast.ClassDef) and node.name == name)
    title, _, body = inspect.cleandoc(ast.get_docstring(owner) or "").partition("\n\n")
    parts: list[tuple[str, str]] = []
    parameters: tuple[Parameter, ...] = ()
    for block in _blocks(body):
        if block[0].startswith("==="):
            parameters = tuple(_rows(block))
            parts.append(("table", ""))
        elif code := re.fullmatch(r"\.\. code-block:: (\w+)", block[0]):
            parts.append((code[1], inspect.cleandoc("\n".join(block[1:]).strip("\n"))))
        elif block[0] == ".. math::":
            formula = inspect.cleandoc("\n".join(block[1:]).strip("\n"))
            parts.append(("text", f"$$\n{formula}\n$$"))
        else:
            parts.append(("text", _markdown("\n".join(block))))
    missing = {"table", "xml", "python"} - {part for part, _ in parts}
    if missing:
        raise ValueError(f"{file}: the docstring of {name} has no {', '.join(sorted(missing))}; compare abg.py")
    return Manual(plugin, kind, file, _markdown(" ".join(title.split())), tuple(parts), parameters)


def _blocks(body: str) -> list[list[str]]:
    """Paragraphs, with what is indented under a directive, and tables, which may hold empty lines in their cells."""
    blocks: list[list[str]] = []
    for paragraph in re.split(r"\n{2,}", body.strip("\n")):
        lines = paragraph.splitlines()
        if blocks and blocks[-1][0].startswith("..") and lines[0].startswith(" "):
            blocks[-1] += ["", *lines]
        else:
            blocks.append(lines)
    return blocks


def _rows(table: list[str]) -> list[Parameter]:
    """The rows of a simple table of reStructuredText; its rules say where the columns are."""
    spans = [(m.start(), m.end()) for m in re.finditer("=+", table[0])]
    starts = [start for start, _ in spans]
    ends: list[int | None] = [*starts[1:], None]
    cells = [[line[a:b].strip() for a, b in zip(starts, ends, strict=True)] for line in table if "===" not in line]
    if tuple(cells[0]) != COLUMNS:
        raise ValueError(f"the columns of a table of parameters are {', '.join(COLUMNS)}, not {', '.join(cells[0])}")
    rows: list[list[str]] = []
    for line in cells[1:]:
        if line[0]:
            rows.append(line)
        else:  # a cell goes on
            rows[-1] = [_joined(*pair) for pair in zip(rows[-1], line, strict=True)]
    return [
        Parameter(*row[:4], DIFFERENTIABLE.sub("", row[4]).strip(), bool(DIFFERENTIABLE.search(row[4]))) for row in rows
    ]


def _joined(above: str, below: str) -> str:
    return f"{above} {below}".strip()


def _markdown(text: str) -> str:
    """Inline markup of reStructuredText as that of Markdown."""
    text = re.sub(r":\w+:`([^`]*)`", r"`\1`", text)
    return re.sub(r"``(.*?)``", r"`\1`", text).replace(r"\|", "|")


def _cell(text: str) -> str:
    return _markdown(text).replace("|", r"\|") or "–"


def _markdown_table(parameters: tuple[Parameter, ...]) -> list[str]:
    lines = ["| parameter | unit | range | default | differentiable | meaning |", "|---|---|---|---|---|---|"]
    for row in parameters:
        name = re.sub(r"\w+", r"`\g<0>`", row.name).replace("(`nested`)", "(nested)")
        cells = [name, *map(_cell, (row.unit, row.range, row.default))]
        cells += ["yes" if row.differentiable else "–", _cell(row.meaning)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _index(found: list[Manual]) -> str:
    lines = [NOTE, "", "# Plugins", "", INTRODUCTION]
    for kind, title in KINDS.items():
        lines += ["", f"## {title}", "", "| plugin | what |", "|---|---|"]
        for manual in (manual for manual in found if manual.kind == kind):
            summary = re.sub(r" \(`\w+`\)", "", manual.summary).rstrip(".").replace("|", r"\|")
            lines.append(f"| [`{manual.plugin}`]({manual.plugin}.md) | {summary} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Write the pages and remove those of plugins that are gone."""
    PAGES.mkdir(exist_ok=True)
    wanted = pages()
    for stale in PAGES.glob("*.md"):
        if stale.name not in wanted:
            stale.unlink()
    for name, text in wanted.items():
        (PAGES / name).write_text(text, encoding="utf-8")
    print(f"{len(wanted)} pages in {PAGES.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

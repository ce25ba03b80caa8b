"""Writes docs/plugins/*.md, one page a plugin and an index, from the plugin classes.

    python docs/make_plugin_pages.py

The docstrings are reStructuredText as in Mitsuba's own plugins: a first sentence, prose, an XML and a Python example.
The table of the parameters comes from their declarations, see `mistray.param`. Both are read from the source, so that
neither Mitsuba nor an installation is needed, only NumPy. `tests/test_plugin_pages.py` keeps the pages current and
loads their examples.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
import inspect
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

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
GROUND = ("mistray.errors", "mistray.param", "mistray.ranges", "mistray.settings")  # imported, for they import no more
INTRODUCTION = """\
What mistray adds to Mitsuba 3. Lengths are in mm, wavelengths in nm, angles in degrees. A unit of 1 is a pure number;
where a parameter is no number its type stands instead. Parameters by their names in gradients and studies:
[docs/parameters.md](../parameters.md). How to write a plugin of your own:
[own_bsdf_plugin.ipynb](../../notebooks/own_bsdf_plugin.ipynb)."""
NOTE = "<!-- Written by docs/make_plugin_pages.py from the docstring and the parameters of the class; change these. -->"


class Names:
    """
    Values of names in a module or a class body, made from their source when they are asked for.

    Parameters
    ----------
    body : list of ast.stmt
        Statements of the module or the class.
    outer : Names, optional
        Names of the module around a class.
    """

    def __init__(self, body: list[ast.stmt], outer: Names | None = None) -> None:
        self._outer = outer
        self._nodes: dict[str, ast.AST] = {}
        for node in body:
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    if isinstance(target, ast.Name):
                        self._nodes[target.id] = node.value
                    elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                        self._nodes |= dict(zip(map(ast.unparse, target.elts), node.value.elts, strict=False))
            elif isinstance(node, ast.AnnAssign) and node.value and isinstance(node.target, ast.Name):
                self._nodes[node.target.id] = node.value
            elif isinstance(node, ast.ClassDef | ast.FunctionDef):
                self._nodes[node.name] = node
            elif isinstance(node, ast.Import | ast.ImportFrom):
                self._nodes |= {alias.asname or alias.name: node for alias in node.names}

    def __getattr__(self, name: str) -> Any:
        node = self._nodes.get(name)
        if node is None:
            return getattr(self._outer, name)
        if isinstance(node, ast.Import | ast.ImportFrom):
            wanted = next(alias.name for alias in node.names if name in (alias.asname, alias.name))
            if isinstance(node, ast.Import):
                return _module(wanted)
            return getattr(_module(node.module or ""), wanted, None) or _module(f"{node.module}.{wanted}")
        if isinstance(node, ast.FunctionDef):
            return self._function(node)
        return self._class(node) if isinstance(node, ast.ClassDef) else self.value(node)

    def __call__(self) -> Names:
        """An object of a class that is not made from its source."""
        return self

    def value(self, node: ast.AST) -> Any:
        """Value of an expression."""
        return eval(compile(ast.Expression(node), "<source>", "eval"), self._scope(node))  # type: ignore[arg-type]

    def knows(self, name: str) -> bool:
        """Whether the source states a name."""
        return name in self._nodes or (self._outer is not None and self._outer.knows(name))

    def _scope(self, node: ast.AST) -> dict[str, Any]:
        """Names in an expression or a function, with their values, as far as the source states them."""
        names = {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
        return {name: getattr(self, name) for name in names if self.knows(name)}

    def _function(self, node: ast.FunctionDef) -> Any:
        """A function, without the types of its arguments."""
        node.returns = None
        for argument in node.args.args:
            argument.annotation = None
        scope = self._scope(node)
        exec(compile(ast.Module([node], []), "<source>", "exec"), scope)
        return scope[node.name]

    def _class(self, node: ast.ClassDef) -> Any:
        """A dataclass with its fields alone; of another class the names in its body."""
        inside = Names(node.body, self)
        if not any("dataclass" in ast.dump(mark) for mark in node.decorator_list):
            return inside
        stated = [one for one in node.body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)]
        annotated = [(one.target.id, ast.unparse(one.annotation), one.value) for one in stated]
        fields = [
            (
                name,
                dataclasses.KW_ONLY if kind == "KW_ONLY" else kind,
                *([] if value is None else [inside.value(value)]),
            )
            for name, kind, value in annotated
            if not kind.startswith("ClassVar")
        ]
        bases = tuple(self.value(base) for base in node.bases)
        also = {"also": inside.also} if inside.knows("also") else {}
        return dataclasses.make_dataclass(node.name, fields, bases=bases, namespace=also)


@functools.cache
def _module(name: str) -> Any:
    """A module of the ground or of Python; of others the names in its source."""
    if "mistray" not in sys.modules:  # its own __init__ would start Mitsuba
        hollow = sys.modules["mistray"] = ModuleType("mistray")
        hollow.__path__ = [str(ROOT / "mistray")]
    if name in GROUND or not name.startswith("mistray"):
        return importlib.import_module(name)
    path = ROOT / name.replace("mistray.plugins", "plugins").replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return Names(ast.parse(file.read_text(encoding="utf-8")).body)


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
    parameters : dict of str to Param
        Parameters by name, see `mistray.param`; ``xy_i_j`` stands for any numbers, ``(nested) bsdf`` for an object.
    """

    plugin: str
    kind: str
    file: Path
    summary: str
    parts: tuple[tuple[str, str], ...]
    parameters: dict[str, Any]

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
    for block in _blocks(body):
        if block[0] == _module("mistray.param").PLACE:
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
    declared = getattr(_module(f"mistray.plugins.{kind}.{file.stem}"), name)
    properties = declared.properties if declared.knows("properties") else {}
    if declared.knows("model_type"):
        properties = _module("mistray.plugins.bsdfs.scatterer").properties_of(declared.model_type, properties)
    return Manual(plugin, kind, file, _markdown(" ".join(title.split())), tuple(parts), properties)


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


def _markdown(text: str) -> str:
    """Inline markup of reStructuredText as that of Markdown."""
    text = re.sub(r":\w+:`([^`]*)`", r"`\1`", text)
    return re.sub(r"``(.*?)``", r"`\1`", text).replace(r"\|", "|")


def _cell(text: str) -> str:
    return _markdown(text).replace("|", r"\|") or "–"


def _markdown_table(parameters: dict[str, Any]) -> list[str]:
    param = _module("mistray.param")
    lines = ["| parameter | unit | range | default | differentiable | meaning |", "|---|---|---|---|---|---|"]
    for names, row in param.grouped(parameters):
        title = re.sub(r"\w+", r"`\g<0>`", param.title_of(names)).replace("(`nested`)", "(nested)")
        cells = [title, *map(_cell, (row.unit, row.allowed, row.usual))]
        cells += ["yes" if row.moves else "–", _cell(row.doc)]
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

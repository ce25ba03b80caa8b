"""What the functions of `page_pictures` draw from: their code, and the pages, scenes and analyses that they name."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DRAWING = ("mistray/toolkit/drawings", "mistray/toolkit/figures", "mistray/toolkit/typeset.py")
LOOKS = ("mistray/toolkit/pages/assets", "mistray/toolkit/pages/templates")  # of pages
ON_PAGES = ("page*.py", "page/*.py", "drawing.py", "controls.py", "front_end/*")  # of an analysis


@functools.cache
def scenes() -> list[str]:
    """The shipped scenes."""
    return sorted(file.parent.name for file in (ROOT / "scenes").glob("*/scene.xml"))


def scene(name: str) -> str:
    """A shipped scene."""
    return (ROOT / "scenes" / name / "scene.xml").read_text(encoding="utf-8")


@functools.cache
def drawing(analysis: str) -> tuple[str, ...]:
    """The code that draws the figures of an analysis."""
    folder = ROOT / "mistray" / "analyses" / analysis
    files = [
        file for place in DRAWING for file in sorted([ROOT / place, *(ROOT / place).rglob("*.py")]) if file.is_file()
    ]
    return tuple(
        code(file) for file in [*files, *sorted(folder.rglob("figures*.py")), *sorted(folder.rglob("figures/*.py"))]
    )


@functools.cache
def code(file: Path) -> str:
    """Text of a file; of Python without comments and docstrings."""
    text = file.read_text(encoding="utf-8")
    return _code(ast.parse(text)) if file.suffix == ".py" else text


def _code(tree: ast.AST) -> str:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return ast.unparse(tree)


def analyses(tree: ast.AST) -> list[str]:
    """Modules of analyses that code imports."""
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return sorted({module for module in modules if module.startswith("mistray.analyses.")})


@functools.cache
def page_functions() -> dict[str, tuple[str, ...]]:
    """What the pictures of pages are made of, by the file of the picture."""
    tree = ast.parse((Path(__file__).parent / "page_pictures.py").read_text(encoding="utf-8"))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    (pictures,) = (
        node.value for node in tree.body if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Dict)
    )
    pairs = zip(pictures.keys, pictures.values, strict=True)
    return {
        f"{ast.literal_eval(key)}.png": tuple(_made_of(functions, ast.unparse(name)))
        for key, name in pairs
        if key is not None
    }


def _made_of(functions: dict[str, ast.FunctionDef], name: str) -> Iterator[str]:
    """A function with those that it calls, blocks and tables of pages, scenes, and modules and pages of analyses."""
    called = [name]
    for one in called:  # grows
        found = {node.id for node in ast.walk(functions[one]) if isinstance(node, ast.Name)}
        called += sorted(found & (set(functions) - set(called)))
    for function in (functions[one] for one in called):
        yield _code(function)
        for module in analyses(function):
            place = ROOT.joinpath(*module.split("."))
            yield from map(code, sorted(place.parent.glob(f"{place.name}.py")))
            yield from map(code, sorted(place.parent.glob("front_end/*")))
        for node in ast.walk(function):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield from (scene(word) for word in node.value.split() if word in scenes())
                if re.fullmatch(r"\w+\.md", node.value):
                    yield "\n".join(line for line in _page(node.value).splitlines() if line.startswith("|"))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args:
                first, *others = [one.value for one in node.args if isinstance(one, ast.Constant)] or [None]
                if node.func.id == "shown":
                    yield from BLOCK.findall(_page(f"{first}.md"))[: (others or [0])[0] + 1]
                if node.func.id == "screenshot":
                    yield from _look(str(first).split()[0])


def _page(name: str) -> str:
    """Text of a page of the docs."""
    (file,) = (file for file in (ROOT / "docs" / name, ROOT / "docs" / "validation" / name) if file.is_file())
    return file.read_text(encoding="utf-8")


def _look(analysis: str) -> Iterator[str]:
    """What the page of an analysis looks like."""
    folders = [file for place in LOOKS for file in sorted((ROOT / place).glob("*"))]
    own = [file for kind in ON_PAGES for file in sorted((ROOT / "mistray" / "analyses" / analysis).glob(kind))]
    yield from map(code, [*folders, *own])

"""Writes the stubs of the package anew, which type checkers and editors read: `python tests/stubs.py`.

A package that imports its names when they are used has them in a table that no type checker reads, and a function made
by `mistray.toolkit.analysis.analysis` has a signature only when it runs. A stub says both.
"""

from __future__ import annotations

import ast
import builtins
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from mistray.ranges import demand_of

ROOT = Path(__file__).parents[1]
HEAD = '"""{what}"""\n\n# Written by tests/stubs.py from what the functions are when they run\n'
FOLDERS = ("plugins", "scenes")  # of the repository, which the installed package holds
LITERAL = bool | int | float | str | tuple | range | None


def packages() -> list[str]:
    """Return the packages that have a table of their names."""
    files = sorted((ROOT / "mistray").rglob("*.py"))
    tables = [file for file in files if re.search("^(__all__ = lazy_package|_homes = )", file.read_text("utf-8"), re.M)]
    return [".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for file in tables]


def place(package: str) -> Path:
    """Return the stub of a package."""
    path = ROOT / package.replace(".", "/")
    return path / "__init__.pyi" if path.is_dir() else path.with_suffix(".pyi")


def stub(package: str) -> str:
    """Return the stub of a package: where its names come from, and functions of analyses with their signatures."""
    module = importlib.import_module(package)
    imports: dict[str, str] = {}
    functions = []
    for name in module.__all__:
        value = getattr(module, name)
        if is_defined(module, name):
            types = Types(value)
            functions.append(definition(value, types))
            imports = types.imports | imports
        elif name in FOLDERS:
            imports |= {"ModuleType": "from types import ModuleType", name: f"{name}: ModuleType"}
        elif name == "__version__":
            imports[name] = f"{name}: str"
        else:
            imports[name] = f"from {home_of(module, name)} import {name} as {name}"
    head = HEAD.format(what=(module.__doc__ or "").partition("\n")[0])
    lines = sorted(imports.values(), key=lambda line: "import" not in line)
    return "\n".join([head, *lines, f"\n__all__ = {module.__all__}", *functions, ""])


def is_defined(module: ModuleType, name: str) -> bool:
    """Whether the stub of a package has a function of an analysis in full; others import it from there."""
    value = getattr(module, name)
    return hasattr(value, "request") and value.__module__ == home_of(module, name)


def analyses() -> list[str]:
    """Return the names of all functions that stubs have in full."""
    modules = map(importlib.import_module, packages())
    return [f"{module.__name__}.{name}" for module in modules for name in module.__all__ if is_defined(module, name)]


def named(name: str) -> Any:
    """Return a function by its public name."""
    package, _, own = name.rpartition(".")
    return getattr(importlib.import_module(package), own)


def home_of(module: ModuleType, name: str) -> str:
    """Return the module that a public name is imported from."""
    value = getattr(module, name)
    own = module.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", "")
    return str(vars(module)["_homes"].get(name, own))


def definition(function: Callable[..., Any], types: Types) -> str:
    """Return a function as a stub has it, with its docstring, which editors show."""
    signature = inspect.signature(function)
    shown = []
    for name, one in signature.parameters.items():
        if one.kind is one.KEYWORD_ONLY and "*" not in shown:
            shown.append("*")
        default = repr(one.default) if isinstance(one.default, LITERAL) else "..."
        shown.append(f"{name}: {types.text(one.annotation)}{'' if one.default is one.empty else f' = {default}'}")
    doc = textwrap.indent(inspect.getdoc(function) or "", "    ", lambda line: bool(line.strip())).strip()
    head = f"def {function.__name__}({', '.join(shown)}) -> {types.text(signature.return_annotation)}:"
    return f'{head}\n    r"""\n    {doc}\n    """\n'


class Types(ast.NodeTransformer):
    """Annotations of a function in full, without aliases of types, and the `imports` of the names in them."""

    def __init__(self, function: Any) -> None:
        parts = [getattr(demand_of(one), "kind", None) for one in dataclasses.fields(function.request)]
        owners = (function, *function.request.__mro__, *filter(None, parts))
        self.modules = [owner.__module__ for owner in owners if owner.__module__ != "builtins"]
        self.imports: dict[str, str] = {}

    def text(self, annotation: str) -> str:
        """Return an annotation in full."""
        return ast.unparse(self.visit(ast.parse(annotation, mode="eval")))

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """Return an alias as what it stands for, and remember where another name comes from."""
        if hasattr(builtins, node.id):
            return node
        known = (source for module in self.modules if (source := source_of(node.id, module)))
        # What may be several is declared as a tuple
        found = next(known, f"from collections.abc import {node.id}")
        if isinstance(found, str):
            self.imports[node.id] = found
            return node
        alias, module = found
        self.modules.insert(0, module)
        return self.visit(alias)


def source_of(name: str, module: str) -> str | tuple[ast.expr, str] | None:
    """Return the import of a name in a module, or what it is an alias of and where; None if the module has it not."""
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            for alias in (alias for alias in node.names if name == (alias.asname or alias.name)):
                if isinstance(node, ast.Import):
                    return ast.unparse(node)
                own = source_of(name, node.module) if (node.module or "").startswith("mistray.") else None
                return own if isinstance(own, tuple) else f"from {node.module} import {ast.unparse(alias)}"
        elif isinstance(node, ast.ClassDef) and node.name == name:
            return f"from {module} import {name}"
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return node.value, module
    return None


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse(inspect.getsource(importlib.import_module(module)))


def statements(text: str) -> dict[str, str]:
    """Return what a stub says by name, however it is formatted."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            start = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            found |= {alias.asname or alias.name: f"{start}{ast.unparse(alias)}" for alias in node.names}
        elif isinstance(node, ast.FunctionDef):
            found[node.name] = ast.unparse(node)
        elif isinstance(node, ast.Assign):
            found["__all__"] = ast.unparse(node.value)
    return found


if __name__ == "__main__":
    written = [place(package) for package in packages()]
    for package, file in zip(packages(), written, strict=True):
        file.write_text(stub(package), encoding="utf-8")
    ruff = Path(sys.executable).with_name("ruff")
    for command in (["check", "-q", "--fix", "--select", "I"], ["format", "-q"]):
        subprocess.run([ruff, *command, *written], check=True, cwd=ROOT)

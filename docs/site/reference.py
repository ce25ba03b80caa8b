"""The reference: public names of the packages by their docstrings, commands by their help, and the plugins."""

from __future__ import annotations

import ast
import contextlib
import io
from pathlib import Path

from repository import MadePage

ROOT = Path(__file__).parents[2]
# Packages whose names are public, in the order of an analysis
PACKAGES = (
    "scene", "prescription", "coatings", "scatter", "materials", "mechanics", "io", "trace", "recorders", "analysis",
    "sweeps", "optimize", "report", "explore", "cluster",
)  # fmt: skip
INTRODUCTION = """\
# Python reference

All public functions and classes by their docstrings. Lengths are in mm, wavelengths in nm, powers in W. Angles are in
degrees where a name ends in `_deg`. `import mistray` is enough for the first table: `mistray.load`, `mistray.trace`
and so on. Examples take `import mistray` and `import numpy as np` for granted; few rays make them quick.
"""


def navigation() -> list[object]:
    """The part of the navigation that the reference is."""
    packages = [{f"mistray.{name}": f"reference/{name}.md"} for name in (*PACKAGES, "physics")]
    plugins = sorted(file.stem for file in (ROOT / "docs" / "plugins").glob("*.md") if file.stem != "README")
    return [
        {"Python": ["reference/index.md", *packages]},
        {"Command line": "reference/commands.md"},
        {"Plugins": ["plugins/README.md", *({name: f"plugins/{name}.md"} for name in plugins)]},
    ]


def pages() -> dict[str, MadePage]:
    """The pages of the packages and of the commands."""
    made = {"reference/index.md": MadePage(index()), "reference/commands.md": MadePage(commands())}
    made |= {f"reference/{name}.md": MadePage(package_page(name)) for name in PACKAGES}
    made["reference/physics.md"] = MadePage(physics_page())
    return made


def homes(package: str) -> dict[str, str]:
    """Public names of a package and the modules that define them, read from its stub, or else its ``__init__``."""
    tree = source(f"mistray.{package}".rstrip("."))
    found = {node.name: f"mistray.{package}.{node.name}" for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mistray."):
            for alias in node.names:
                found[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    for node in tree.body:
        if (
            isinstance(node, ast.Assign)
            and ast.unparse(node.targets[0]) == "__all__"
            and isinstance(node.value, ast.List)
        ):
            listed = {ast.literal_eval(name) for name in node.value.elts}
            return {name: home for name, home in found.items() if name in listed}
    return {name: home for name, home in found.items() if home.split(".")[1][0] != "_"}


def source(module: str) -> ast.Module:
    """A module or a package as it is written; a stub says more of a package."""
    path = ROOT / module.replace(".", "/")
    files = path / "__init__.pyi", path / "__init__.py", path.with_suffix(".pyi"), path.with_suffix(".py")
    return ast.parse(next(file for file in files if file.is_file()).read_text(encoding="utf-8"))


def definition(home: str) -> str:
    """Where a name is defined, also if a package hands it on."""
    module, _, name = home.rpartition(".")
    package = module.removeprefix("mistray.")
    path = ROOT / "mistray" / package.replace(".", "/")
    if (path / "__init__.py").is_file() or path.with_suffix(".pyi").is_file():
        handed = homes(package).get(name, home)
        return home if handed == home else definition(handed)
    return home


def first_sentence(home: str) -> str:
    """First line of the docstring of a name."""
    module, _, name = home.rpartition(".")
    for node in source(module).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split()).replace("|", r"\|")
    return ""


def index() -> str:
    """What the package itself offers, and where the rest is."""
    names = homes("")
    lines = [INTRODUCTION, "| name | what |", "|---|---|"]
    for name in sorted(names, key=str.lower):
        home = definition(names[name])
        if first_sentence(home):
            lines.append(f"| [`mistray.{name}`][{home}] | {first_sentence(home)} |")
    lines += ["", "| package | what |", "|---|---|"]
    for package in (*PACKAGES, "physics"):
        lines.append(f"| [`mistray.{package}`]({package}.md) | {package_summary(package)} |")
    here = [home for home in names.values() if home.split(".")[1] in ("_variant", "errors")]
    return "\n".join([*lines, "", *(f"::: {home}\n" for home in here)])


def package_summary(package: str) -> str:
    """First sentence of the docstring of a package."""
    return " ".join((ast.get_docstring(source(f"mistray.{package}")) or "").partition("\n\n")[0].split())


def package_page(package: str) -> str:
    """All public names of a package."""
    lines = [f"# mistray.{package}", "", package_summary(package), ""]
    elsewhere = []
    for name, home in sorted(homes(package).items(), key=lambda item: item[0].lower()):
        place = definition(home)
        if documented_elsewhere(place, package):
            elsewhere.append(f"[`{name}`][{place}]")
        else:
            lines += [f"::: {place}", ""]
    if elsewhere:
        lines.insert(4, f"Also here, documented with their own packages: {', '.join(elsewhere)}.\n")
    return "\n".join(lines)


def documented_elsewhere(place: str, package: str) -> bool:
    """Whether a definition stands on the page of its own package: it is a public name there, or an equation."""
    own = place.split(".")[1]
    if own == package or own not in PACKAGES:
        return own == "physics"
    return place in map(definition, homes(own).values())


def physics_page() -> str:
    """The modules of equations."""
    lines = ["# mistray.physics", "", package_summary("physics"), ""]
    for file in sorted((ROOT / "mistray" / "physics").rglob("*.py")):
        if file.name[0] != "_":
            module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
            lines += [f"::: {module}", "    options: { show_root_full_path: true }", ""]
    return "\n".join(lines)


def commands() -> str:
    """What each command says with ``--help``."""
    from mistray.cli.program import COMMANDS as MODULES

    lines = ["# Command line", "", "What `mistray --help` and each command with `--help` print.", ""]
    lines += ["```text", help_text(), "```", ""]
    for name in (module.COMMAND.name for module in MODULES):
        lines += [f"## mistray {name}", "", "```text", help_text(name), "```", ""]
    return "\n".join(lines)


def help_text(*words: str) -> str:
    """The help of a command, as wide as a page."""
    from mistray.cli.program import main

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main([*words, "--help"])
    return printed.getvalue().rstrip()

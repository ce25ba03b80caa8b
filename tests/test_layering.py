"""Who may import whom: a module imports only from the layers above it, so data flows one way."""

import ast
import graphlib
import re
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.quick

ROOT = Path(__file__).parents[1]

# From the ground up, side by side where a stroke stands: a module imports from its own layer and those before it
GROUND_UP = """
    errors events ids percent estimate result notes ranges param known_arguments named_values settings light messages
    _lazy time_budget supervisor interrupts read_file replace_file replace_folder files cache _libatomic _llvm
    _mitsuba_compat entry_points _variant
    physics|materials|coatings spectra scatter prescription io mechanics scene surfaces recorders kernel sampling
    execute gradients trace metrics cluster toolkit analyses analysis|optimize|sweeps|report|explore cli
    __main__
"""
LAYERS = [set(names.split("|")) for names in GROUND_UP.split()]
# `physics` holds equations and nothing else; plugins are looked up by Mitsuba: they use these, and no module imports
# them; a shipped scene is a prescription written in Python.
MAY_IMPORT = {
    "physics": {"errors", "ranges", "physics"},
    "plugins": {
        "errors", "ids", "ranges", "param", "settings", "light", "files", "_variant", "_mitsuba_compat", "physics",
        "materials", "coatings", "spectra", "scatter", "surfaces", "recorders", "kernel", "sampling", "execute",
        "gradients", "named_values", "trace", "plugins",
    },
    "scenes": {"errors", "materials", "prescription", "scenes"},
}  # fmt: skip
# These work on arrays and tables, or before Mitsuba can be imported.
NO_MITSUBA = {
    "errors", "events", "ids", "ranges", "known_arguments", "named_values", "settings", "light", "replace_file",
    "replace_folder", "read_file", "files", "io", "cache", "physics", "materials", "coatings", "spectra", "scatter",
    "scenes", "toolkit", "cli", "mechanics", "_libatomic", "_llvm",
}  # fmt: skip
# Importing Dr.Jit opens libLLVM, so these do it in functions, once libLLVM is settled or somebody asks for a scene.
LATE_MITSUBA = {"_variant", "_mitsuba_compat", "prescription"}
# (importing layer, imported layer): upward imports inside a function, each with its reason.
LAZY = {
    ("result", "toolkit"): "a result is shown by the tables and figures of reports",
    ("prescription", "io"): "mistray.prescription.from_zemax and its like name readers of mistray.io",
    ("prescription", "scene"): "Prescription.to_scene() is a shorthand for mistray.scene.load",
}
# (analysis, analysis that it imports): all that one may know of another, each with its reason.
PAIRS = {
    ("budget", "pst"): "requirements are on metrics, which a file names",
    ("optimize", "pst"): "a term of a study is a metric by its name; a PST is measured again at the end",
    ("explorer", "optimize"): "what is explored is saved as a study",
    ("explorer", "ghosts"): "the page shows paths, ranking and verdict of ghosts",
    ("fit", "pst"): "models of measured PSTs",
    ("sensitivity", "pst"): "the metric of the command is one by its name",
    **{("study", other): "made of the others" for other in ("ghosts", "image", "objects", "pst", "transfer")},
    ("sweep", "ghosts"): "a sweep has a ghost report for each configuration",
    ("sweep", "pst"): "a sweep of PSTs, with their curves and tables",
    ("sweep", "sensitivity"): "edits are ranked by what parameters may do",
    ("transfer", "image"): "the transfer function of the direct image",
    ("validate", "objects"): "the flux on critical and illuminated objects is compared",
    ("validate", "pst"): "PSTs and the veiling glare index are compared",
}
MOST_PAIRS = 17
# Names that change between Mitsuba releases live in one file.
RELEASE_NAMES = {"vertex_positions", "vertex_normals", "vertex_texcoords"}


@dataclass(frozen=True)
class Use:
    where: str
    layer: str
    target: str
    lazy: bool


def layer_of(module: str) -> str:
    """`mistray.trace.kernel` is of layer `trace`; the package itself is of layer `mistray`."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else parts[0]


def module_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "mistray" else ("mistray", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def uses(file: Path) -> list[Use]:
    module = module_of(file)
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    found: list[Use] = []

    def note(node: ast.AST, name: str, lazy: bool) -> None:
        found.append(Use(f"{file.relative_to(ROOT)}:{node.lineno}", layer_of(module), name, lazy))

    def visit(node: ast.AST, lazy: bool) -> None:
        if isinstance(node, ast.Import):
            for alias in node.names:
                note(node, alias.name, lazy)
        elif isinstance(node, ast.ImportFrom):
            start = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            for alias in node.names:
                note(node, f"{base}.{alias.name}" if base == "mistray" else base, lazy)
        elif not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            inside = lazy or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            for child in ast.iter_child_nodes(node):
                visit(child, inside)

    visit(ast.parse(file.read_text()), False)
    return found


FILES = sorted(f for top in ("mistray", "plugins", "scenes") for f in (ROOT / top).rglob("*.py") if f.is_file())
USES = [use for file in FILES for use in uses(file)]
HEIGHT = {layer: height for height, layers in enumerate(LAYERS) for layer in layers}

MOST_FILES = 20  # that a reader takes in at a glance


def test_a_room_has_few_files_and_every_module_a_layer():
    rooms = Counter(file.parent for file in FILES if file.name != "__init__.py")
    assert not {room for room, count in rooms.items() if count > MOST_FILES and ROOT / "mistray" in room.parents}
    layers = {layer_of(module_of(file)) for file in FILES} - {"mistray", "plugins", "scenes"}
    assert layers <= set(HEIGHT), "put new modules into LAYERS"


MOST_LINES, MOST_PARAMETERS = 150, 8
REASON = "# More than 8 parameters: "  # and why, in the line above


def test_functions_are_short_and_take_few_parameters():
    long, wide = [], []
    for file in FILES:
        text = file.read_text()
        lines = text.splitlines()
        for node in (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)):
            where = f"{file.relative_to(ROOT)}:{node.lineno} {node.name}"
            long += [where] if node.end_lineno - node.lineno >= MOST_LINES else []
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            above = lines[min([node.lineno, *(d.lineno for d in node.decorator_list)]) - 2].strip()
            if len(set(names) - {"self", "cls"}) > MOST_PARAMETERS and not above.startswith(REASON):
                wide.append(where)
    assert (long, wide) == ([], [])


def test_modules_import_in_no_circle():
    """Imports within functions and for types aside; of a package its modules rather than itself."""
    names = {module_of(file) for file in FILES}
    imports = {name: set() for name in names}
    for file in FILES:
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.Import):
                imports[module_of(file)] |= {alias.name for alias in node.names} & names
            elif isinstance(node, ast.ImportFrom) and not node.level:
                inside = [f"{node.module}.{alias.name}" for alias in node.names]
                imports[module_of(file)] |= {name if name in names else node.module for name in inside} & names
    graphlib.TopologicalSorter(imports).prepare()  # raises where modules need each other


def test_the_rooms_are_listed_in_their_order():
    """What CONTRIBUTING.md says of each room of the package is the first line of its docstring."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    said = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", text, re.MULTILINE))
    rooms = {file.parent.name: file for file in (ROOT / "mistray").glob("*/__init__.py")}
    assert said == {name: ast.get_docstring(ast.parse(f.read_text())).splitlines()[0] for name, f in rooms.items()}
    heights = [HEIGHT[name] for name in said if name not in ("cache", "files")]  # everybody uses these
    assert heights == sorted(heights)


def broken_rule(use: Use) -> str | None:
    top = use.target.split(".")[0]
    if top in ("mitsuba", "drjit"):
        if use.layer == "physics" and top == "drjit":
            return None  # the same formulas run on Dr.Jit arrays
        if use.layer in NO_MITSUBA:
            return f"{use.layer} works without {top}"
        if use.layer in LATE_MITSUBA and not use.lazy:
            return f"{use.layer} imports {top} in functions only"
        return None
    if top != "mistray" or use.layer == "mistray":
        return None
    target = layer_of(use.target)
    if use.layer in ("plugins", "scenes") or (use.layer in MAY_IMPORT and target not in MAY_IMPORT[use.layer]):
        return None if target in MAY_IMPORT[use.layer] else f"{use.layer} does not import {target}"
    if target in ("plugins", "scenes"):
        return None if (use.layer, target) == ("scene", "scenes") else f"{target} are looked up by name"
    if target not in HEIGHT:
        return f"import the module that defines it instead of '{use.target}'"
    if HEIGHT[target] > HEIGHT[use.layer] and not (use.lazy and (use.layer, target) in LAZY):
        return f"{use.layer} lies below {target}"
    return None


def test_imports_go_one_way():
    assert not [f"{use.where}: {rule}" for use in USES if (rule := broken_rule(use))]
    used = {(use.layer, layer_of(use.target)) for use in USES if use.lazy and use.target.startswith("mistray")}
    assert set(LAZY) <= used, "remove exceptions that nobody needs"
    for layer, target, lazy in (
        ("physics", "mitsuba", True), ("trace", "mistray.analyses", True), ("plugins", "mistray.analyses.x", False),
        ("scenes", "mistray.trace", False), ("toolkit", "drjit", False), ("_variant", "mitsuba", False),
    ):  # fmt: skip
        assert broken_rule(Use("x", layer, target, lazy))


def analysis_of(name: str) -> str:
    parts = name.split(".")
    return parts[2] if parts[:2] == ["mistray", "analyses"] and len(parts) > 3 else ""


def test_analyses_know_of_each_other_what_a_table_says():
    used = {
        (own, other)
        for use in USES
        if (own := re.sub(r"^mistray/analyses/(\w+)/.*|.*", r"\1", use.where))
        and (other := analysis_of(f"{use.target}.x"))
        and own != other
    }
    assert used == set(PAIRS)
    assert len(PAIRS) <= MOST_PAIRS
    needs = {own: {other for one, other in PAIRS if one == own} for own, _ in PAIRS}
    graphlib.TopologicalSorter(needs).prepare()  # raises where analyses need each other


def test_names_of_mitsuba_releases_are_in_one_file():
    for file in (file for file in FILES if file.name != "_mitsuba_compat.py"):
        nodes = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Constant)]
        assert not {node.value for node in nodes if isinstance(node.value, str)} & RELEASE_NAMES, file


def test_a_trace_loads_nothing_that_makes_lenses():
    """Nor what reads lens files: a sixth of the modules that a command waits for."""
    program = (
        "import sys, mistray; mistray.trace(mistray.load('cooke_triplet'), rays=64); "
        "print([name for name in sys.modules if name.startswith(('mistray.prescription', 'mistray.io', 'pandas'))])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]", done.stdout

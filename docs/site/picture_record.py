"""What the pictures of the README, the pages and the gallery are made of, so that none of them grows stale.

docs/images/made.json holds a checksum for each picture: of its command or notebook, its scene, and the code that draws.
A test compares; `make docs` draws what has changed.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import json
from pathlib import Path

from notebook_results import code_of, names

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "docs" / "images" / "made.json"
DRAWING = ("mistray/toolkit/drawings", "mistray/toolkit/figures", "mistray/toolkit/typeset.py")
# Pictures that a command draws: its words, and the file of its output folder that is the picture; {file} is the picture
COMMANDS = {
    "phone_camera_layout.svg": ("view phone_camera --field-deg 10 --layout {file}", ""),
    "phone_camera_ghosts.png": (
        "ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --rays 1e5 --out {folder}",
        "overview.png",
    ),
    "objects_phone_camera.png": (
        "objects phone_camera --half-angle-deg 20 --rays 1e5 --out {folder}",
        "objects.png",
    ),
    "coating_bbar3.png": ("coating bbar3 --back 1.5168 --plot {file}", ""),
    "bsdf_level300.png": ("bsdf particulate --level 300 --event transmission --back air --plot {file}", ""),
    "bsdf_abg.png": ("bsdf abg --A 0.0025 --B 0.001 --g 1.8 --plot {file}", ""),
}


def scenes() -> list[str]:
    """The shipped scenes."""
    return sorted(file.parent.name for file in (ROOT / "scenes").glob("*/scene.xml"))


def inputs() -> dict[str, str]:
    """Checksum of what each picture is made of, by its file below docs/images."""
    found = {
        name: _checksum(command, *_scene_of(command), *drawing(command)) for name, (command, _) in COMMANDS.items()
    }
    found |= {name: _checksum(code, *drawing("view")) for name, code in page_functions().items()}
    found |= {f"gallery/{name}.png": _checksum(*_scene(name), *drawing("view")) for name in scenes()}
    return found | {f"gallery/{name}.png": _checksum(*code_of(name)) for name in names()}


@functools.cache
def page_functions() -> dict[str, str]:
    """Code of the functions that draw the pictures of pages, by the file of the picture."""
    tree = ast.parse((Path(__file__).parent / "page_pictures.py").read_text(encoding="utf-8"))
    code = {node.name: ast.unparse(node) for node in tree.body if isinstance(node, ast.FunctionDef)}
    (pictures,) = (
        node.value for node in tree.body if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Dict)
    )
    pairs = zip(pictures.keys, pictures.values, strict=True)
    return {f"{ast.literal_eval(key)}.png": code[ast.unparse(function)] for key, function in pairs if key is not None}


def record() -> dict[str, str]:
    """Checksums of what the stored pictures were made of."""
    return dict(json.loads(RECORD.read_text(encoding="utf-8"))) if RECORD.exists() else {}


def stale() -> list[str]:
    """Pictures that are missing, or were made of something else than what is there now."""
    made = record()
    return [name for name, checksum in inputs().items() if made.get(name) != checksum or not picture(name).is_file()]


def keep(name: str) -> None:
    """Note that a picture has been made of what is there now."""
    made = {known: checksum for known, checksum in record().items() if known in inputs()}
    made[name] = inputs()[name]
    RECORD.write_text(json.dumps(dict(sorted(made.items())), indent=1) + "\n", encoding="utf-8")


def picture(name: str) -> Path:
    """File of a picture."""
    return RECORD.parent / name


@functools.cache
def drawing(command: str) -> tuple[str, ...]:
    """The code that draws the pictures of a command, without comments and docstrings."""
    analysis = ROOT / "mistray" / "analyses" / command.split()[0]
    files = [
        file for place in DRAWING for file in sorted([ROOT / place, *(ROOT / place).rglob("*.py")]) if file.is_file()
    ]
    return tuple(
        _code(file)
        for file in [*files, *sorted(analysis.rglob("figures*.py")), *sorted(analysis.rglob("figures/*.py"))]
    )


def _code(file: Path) -> str:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:]
    return ast.unparse(tree)


def _scene_of(command: str) -> tuple[str, ...]:
    name = command.split()[1]
    return _scene(name) if name in scenes() else ()


def _scene(name: str) -> tuple[str, ...]:
    return ((ROOT / "scenes" / name / "scene.xml").read_text(encoding="utf-8"),)


def _checksum(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:20]

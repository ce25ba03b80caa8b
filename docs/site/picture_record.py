"""What the pictures of the README, the pages and the gallery are made of, so that none of them grows stale.

docs/images/made.json holds a checksum for each picture: of its command, example, function or notebook, its scene, and
the code that draws. A test compares, and finds pictures without one; `make docs` draws what has changed.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import json
from pathlib import Path

from notebook_results import code_of, names
from page_code import ROOT, analyses, code, drawing, page_functions, scene, scenes

RECORD = ROOT / "docs" / "images" / "made.json"
# Pictures that a command draws, or an example: its words, with {folder} for its output, and the file there
COMMANDS = {
    "phone_camera_layout.svg": ("view phone_camera --field-deg 10 --layout {folder}/layout.svg", "layout.svg"),
    "phone_camera_ghosts.png": (
        "ghosts phone_camera --field-deg 0 5 10 15 20 25 27 --rays 1e5 --out {folder}",
        "overview.png",
    ),
    "double_gauss_walls.png": (
        "ghosts double_gauss_barrel --field-deg 20 --rays 1e6 --max-reflections 1 --surface-maps azimuths=72 "
        "--out {folder}",
        "surface_maps_20deg.png",
    ),
    "objects_phone_camera.png": (
        "objects phone_camera --half-angle-deg 20 --rays 1e5 --out {folder}",
        "objects.png",
    ),
    "coating_bbar3.png": ("coating bbar3 --back 1.5168 --plot {folder}/plot.png", "plot.png"),
    "bsdf_level300.png": (
        "bsdf particulate --level 300 --event transmission --back air --plot {folder}/plot.png",
        "plot.png",
    ),
    "bsdf_abg.png": ("bsdf abg --A 0.0025 --B 0.001 --g 1.8 --plot {folder}/plot.png", "plot.png"),
    # Examples take minutes; the tables beside their pictures are of the same run, so that both are made anew together
    "phone_camera_ar.png": ("examples/phone_camera_ar.py {folder}", "layers.png"),
    "phone_camera_ar_reflectance.png": ("examples/phone_camera_ar.py {folder}", "reflectance.png"),
    "triplet_ar_reflectance.png": ("examples/triplet_ar.py {folder}", "reflectance.png"),
}


@functools.cache
def inputs() -> dict[str, str]:
    """Checksum of what each picture is made of, by its file below docs/images."""
    found = {name: _checksum(command, *_of_command(command)) for name, (command, _) in COMMANDS.items()}
    found |= {name: _checksum(*made_of, *drawing("view")) for name, made_of in page_functions().items()}
    found |= {f"gallery/{name}.png": _checksum(scene(name), *drawing("view")) for name in scenes()}
    return found | {f"gallery/{name}.png": _checksum(*code_of(name)) for name in names()}


def pictures() -> list[str]:
    """The pictures that there are."""
    files = [file for file in RECORD.parent.rglob("*") if file.is_file() and file != RECORD]
    return sorted(file.relative_to(RECORD.parent).as_posix() for file in files)


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


def _of_command(command: str) -> tuple[str, ...]:
    """What a command draws from: its scene and the code of its figures; of an example its files, and the same."""
    first, second = command.split()[:2]
    if not first.endswith(".py"):
        return (*([scene(second)] if second in scenes() else []), *drawing(first))
    script = ROOT / first
    used = dict.fromkeys(module.split(".")[2] for module in analyses(ast.parse(script.read_text(encoding="utf-8"))))
    own = [code(file) for file in sorted(script.parent.glob(f"{script.stem}.*"))]
    return (*own, *(text for analysis in used for text in drawing(analysis)))


def _checksum(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:20]

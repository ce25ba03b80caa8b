"""Scenes from files, dicts and names of shipped scenes."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray._variant import ensure_variant
from mistray.errors import MistrayError
from mistray.scene.check import check_overlaps
from mistray.scene.depth import check_depth
from mistray.scene.messages import explain

# Not optimised, because merged shapes lose their names. Not in parallel: a thread that waits for Dr.Jit while it makes
# one of our shapes would begin the next one inside of that wait, which has crashed the process.
LOADING = {"optimize": False, "parallel": False}

NAMES_OFFERED = 5  # shipped scenes that are nearest to one that does not exist


def load(source: str | Path | dict[str, Any]) -> mi.Scene:
    """
    Load an optical system as a Mitsuba scene.

    Parameters
    ----------
    source : str, Path or dict
        A scene XML file, the name of a shipped scene such as ``"phone_camera"``, or a Mitsuba scene dict.

    Returns
    -------
    mi.Scene

    Raises
    ------
    MistrayError
        If the file is missing or nested too deeply, Mitsuba cannot read it or surfaces overlap; the message is one
        line.
    """
    ensure_variant()
    given = source if isinstance(source, dict) else find(source)
    if isinstance(given, Path):
        check_depth(given)
    try:
        scene = mi.load_dict(given, **LOADING) if isinstance(given, dict) else mi.load_file(str(given), **LOADING)
    except Exception as error:  # Mitsuba raises RuntimeError and TypeError with text of many lines
        raise MistrayError(explain(error, given)) from None
    if not isinstance(scene, mi.Scene):
        raise MistrayError(f'scene: the dict describes a {type(scene).__name__}; add "type": "scene" at its top')
    check_overlaps(scene)
    return scene


def shipped_scenes() -> dict[str, Path]:
    """The files of the scenes that come with mistray, by their names."""
    import mistray.scenes

    return {path.parent.name: path for path in sorted(Path(mistray.scenes.__file__).parent.glob("*/scene.xml"))}


def find(source: str | Path) -> Path:
    """File of a scene: an existing path, or the name of a shipped scene."""
    path = Path(source)
    if path.is_file():
        return path
    shipped = shipped_scenes()
    if str(source) in shipped:
        return shipped[str(source)]
    if path.is_dir() and (path / "scene.xml").is_file():
        return path / "scene.xml"
    nearest = ", ".join(difflib.get_close_matches(str(source), shipped, n=NAMES_OFFERED, cutoff=0.0))
    raise MistrayError(f"scene '{source}': no such file; give a scene XML file or a shipped scene, such as {nearest}")

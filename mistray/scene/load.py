"""Scenes from files, dicts and names of shipped scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray._variant import ensure_variant
from mistray.errors import MistrayError


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
        If the file is missing or Mitsuba cannot read it; the message is one line.
    """
    ensure_variant()
    try:
        if isinstance(source, dict):
            return mi.load_dict(source, optimize=False)
        return mi.load_file(str(find(source)), optimize=False)
    except MistrayError:
        raise
    except Exception as error:  # Mitsuba raises RuntimeError and TypeError with text of many lines
        raise MistrayError(_one_line(error, source)) from None


def find(source: str | Path) -> Path:
    """File of a scene: an existing path, or the name of a shipped scene."""
    path = Path(source)
    if path.is_file():
        return path
    import mistray.scenes

    shipped = Path(mistray.scenes.__file__).parent
    named = shipped / str(source) / "scene.xml"
    if named.is_file():
        return named
    if path.is_dir() and (path / "scene.xml").is_file():
        return path / "scene.xml"
    names = ", ".join(sorted(entry.parent.name for entry in shipped.glob("*/scene.xml")))
    raise MistrayError(f"scene '{source}': no such file; give a scene XML file or one of the shipped scenes: {names}")


def _one_line(error: Exception, source: str | Path | dict[str, Any]) -> str:
    """The lines of a Mitsuba error that say what is wrong."""
    where = "scene" if isinstance(source, dict) else f"scene '{source}'"
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    for line in reversed(lines):
        if "MistrayError: " in line:
            return f"{where}: {line.split('MistrayError: ', 1)[1]}"
    useful = [line for line in lines if not line.startswith(("File ", "Traceback", "~", "^"))]
    text = " ".join(useful) or type(error).__name__
    for noise in ("Error while loading ", "[parser.cpp:", "[xml.cpp:"):
        text = text.replace(noise, "" if noise.endswith(" ") else noise)
    return f"{where}: {text}; correct the scene"

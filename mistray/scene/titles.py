"""Names of scenes for titles and results."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.scene.load import find
from mistray.scene.source import file_of


def title_of_file(path: Path) -> str:
    """Return the name of a scene for titles: the file's name, or its folder's if the file is called scene.xml."""
    return path.parent.name if path.name == "scene.xml" else path.stem


def scene_name(source: Any) -> str:
    """
    Return the name of an analysed scene, for results; empty if it is not known.

    Parameters
    ----------
    source
        Loaded scene, scene file, shipped scene, or an object that has a scene, such as a metric.
    """
    if isinstance(source, str | Path | ModuleType):
        try:
            return title_of_file(find(source).resolve())
        except MistrayError:  # the file has gone since
            return ""
    scene = source if isinstance(source, mi.Scene) else getattr(source, "scene", None)
    file = file_of(scene) if isinstance(scene, mi.Scene) else None
    return title_of_file(file) if file is not None else ""

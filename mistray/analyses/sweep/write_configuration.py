"""A configuration of a scene as a scene file of its own."""

from __future__ import annotations

import tempfile
from pathlib import Path

from mistray.analyses.sweep.configurations import Configuration
from mistray.analyses.sweep.original import move
from mistray.scene import Rules, find, load, write_coated
from mistray.scene.add_structures import add_structures
from mistray.scene.rewrite import write_rewritten


def write_configuration(source: str | Path, configuration: Configuration, target: str | Path) -> Path:
    """
    Write a scene with what a configuration moves, paints, coats and blocks; everything else in the file stays.

    Parameters
    ----------
    source : str or Path
        Scene XML file, or the name of a shipped scene.
    configuration : Configuration
    target : str or Path
        May be `source` itself.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MistrayError
        If the configuration names what the scene has not, a value stands in another file or in none, or surfaces
        overlap afterwards; nothing is written then.
    """
    one, file = configuration, find(source)
    with tempfile.TemporaryDirectory() as folder:
        if one.block:
            file = add_structures(file, one.block, Path(folder) / "blocked.xml")
        if one.coat or one.paint:
            coated = Path(folder) / "coated.xml"
            write_coated(file, coated, Rules(dict(one.coat), dict(one.paint), {}))
            file = coated
        values = move(load(file), one).values
        return write_rewritten(file, values, target, f"configuration {one.name}")

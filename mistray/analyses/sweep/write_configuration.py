"""Writing a configuration of a scene to a scene file."""

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
    Write a scene with the moves, paint, coatings and structures of a configuration; the rest of the file is unchanged.

    Parameters
    ----------
    source : str or Path
        Scene XML file, or the name of a shipped scene.
    configuration : Configuration
        Configuration to write.
    target : str or Path
        File to write; may be `source` itself.

    Returns
    -------
    Path
        File written.

    Raises
    ------
    MistrayError
        If the configuration names something that the scene lacks, a value is in another file or in none, or surfaces
        overlap afterwards; nothing is written then.

    Examples
    --------
    >>> coated = mistray.sweeps.Configuration("coated", coat={"L*": "bbar3"}, paint={"barrel*": 0.03})
    >>> file = mistray.sweeps.write_configuration("cooke_triplet", coated, "coated.xml")
    >>> scene = mistray.load(file)
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

"""Import of lens files of other programs for all commands that take a scene."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

from mistray.cli.parsed_options import Options
from mistray.errors import MistrayError


@contextlib.contextmanager
def lens_as_scene(options: Options) -> Iterator[None]:
    """
    Convert a lens file given as a command's scene to a temporary scene file, used within a block.

    The option ``scene`` then names that file, which exists as long as the block; notes go to stderr. For any other
    scene nothing is done. `mistray import` has more options and writes a file.

    Raises
    ------
    MistrayError
        If the lens file cannot be read, or needs further files beside it.
    """
    lens = Path(options.has("scene") or "")
    kind = None
    if lens.suffix.lower() not in ("", ".xml"):
        from mistray.analyses.import_lens.read import kind_of, read_lens
        from mistray.analyses.import_lens.request import LensRequest

        kind = kind_of(lens)
    if kind is None:
        yield
        return
    import tempfile

    from mistray.prescription.scene_file import beside

    wavelengths = options.has("wavelength_nm") or [None]
    # Media of batoid have no index without it
    found = read_lens(LensRequest(str(lens), wavelengths[0] if kind == "batoid" else None))

    with tempfile.TemporaryDirectory(prefix="mistray-") as folder:
        scene = Path(folder) / f"{lens.stem}.xml"
        beside(found.prescription, scene.parent).to_xml(scene)
        if len(list(scene.parent.iterdir())) > 1:  # what a command writes would name files that go with the folder
            raise MistrayError(f"lens '{lens}': its sags are grids, in files of their own; run 'mistray import' first")
        options.lens_file, options.scene = str(lens), str(scene)  # the file too must not be overwritten
        if not options.has("quiet"):
            print(f"mistray: {lens} is imported as it stands; 'mistray import' has options for it", file=sys.stderr)
            for line in found.lines(lens.name):
                print(f"mistray: {line}", file=sys.stderr)
        yield

"""Keys of the rows of a sweep, the data that a row depends on, and storage of rows in the cache."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray.analyses.sweep.configurations import Resolved
from mistray.analyses.sweep.numbers import Numbers, read_numbers
from mistray.cache import Cache, code_fingerprint, file_fingerprint, key_of
from mistray.errors import MistrayError
from mistray.scene.files import scene_files
from mistray.trace import Settings

OWN = ("mistray", "mitsuba", "drjit")  # packages whose code is part of `code_fingerprint`
CHANGED = "sweep: files of the scene were changed while it was traced; the rows since then are not kept"


@dataclass(frozen=True, eq=False)
class Cell:
    """
    Key of a row of a sweep: configuration, wavelength (nm) and field angle (degrees).

    Attributes
    ----------
    configuration : Resolved
        Configuration of the scene.
    wavelength_nm, field_deg : float
        Wavelength, nm, and field angle, degrees.
    """

    configuration: Resolved
    wavelength_nm: float
    field_deg: float

    @property
    def name(self) -> tuple[str, float, float]:
        """Configuration name, field angle (degrees) and wavelength (nm): the key of a row."""
        return self.configuration.name, self.field_deg, self.wavelength_nm

    def __str__(self) -> str:
        return f"configuration '{self.configuration.name}', field {self.field_deg:g} deg, {self.wavelength_nm:g} nm"


class KeptRows:
    """
    Rows of a sweep in the disk cache, for reading and storing.

    Parameters
    ----------
    store : Cache
        Cache of results.
    contents : SceneContents
        Contents of the scene's files, recorded before the scene was loaded.
    facts : mapping
        Facts that all rows depend on, from `traced_facts`.
    """

    def __init__(self, store: Cache, contents: SceneContents, facts: Mapping[str, Any]) -> None:
        self.store, self._contents, self._facts = store, contents, facts
        self._changed = False

    def key(self, cell: Cell) -> str:
        """Return the cache key (a hash) of a row; it depends on the values of the configuration, not on its name."""
        values = {key: numbers.tolist() for key, numbers in cell.configuration.values.items()}
        own = {"values": values, "field_deg": cell.field_deg, "wavelength_nm": cell.wavelength_nm}
        return key_of({**self._facts, **own})

    def read(self, cells: Iterable[Cell]) -> dict[Cell, Numbers]:
        """Return the rows that are in the cache, by cell."""
        found = {cell: self.store.get(self.key(cell), read_numbers) for cell in cells}
        return {cell: numbers for cell, numbers in found.items() if numbers is not None}

    def keep(self, cell: Cell, numbers: Numbers) -> None:
        """Store a row in the cache, unless files of the scene have changed since it was loaded."""
        self._changed = self._changed or not self._contents.unchanged()
        if not self._changed:
            self.store.put(self.key(cell), json.dumps(numbers).encode())

    @property
    def problems(self) -> list[str]:
        """Problems with the cache, and with scene files that changed during the sweep, one line each."""
        return [*self.store.problems, *([CHANGED] if self._changed else [])]


class SceneContents:
    """
    Hashes of the contents of all files of a scene, to detect changes.

    Parameters
    ----------
    scene : Path
        Scene file.

    Attributes
    ----------
    hashes : list of str
        Hashes of the contents of all files of the scene, without their paths.
    """

    def __init__(self, scene: Path) -> None:
        self._scene, self._files = scene, scene_files(scene)
        self._stamps = _stamps(self._files)  # before the contents
        self.hashes = [file_fingerprint(path) for path in self._files]

    def unchanged(self) -> bool:
        """
        True if the scene's files are unchanged; False if they are changed or cannot be read.

        Contents are read again only if a time stamp or size differs.
        """
        try:
            return _stamps(self._files) == self._stamps or SceneContents(self._scene).hashes == self.hashes
        except (MistrayError, OSError):  # gone, or half written by an editor
            return False


def _stamps(files: Iterable[Path]) -> list[tuple[int, int, int]]:
    status = [path.stat() for path in files]
    return [(one.st_mtime_ns, one.st_size, one.st_ino) for one in status]


def traced_facts(contents: SceneContents, settings: Settings, azimuth_deg: float | None) -> dict[str, Any]:
    """
    Return the facts that all rows of a sweep depend on.

    Parameters
    ----------
    contents : SceneContents
        Contents of the scene's files.
    settings : Settings
        Settings as they hold, those of the scene's own integrator included.
    azimuth_deg : float, optional
        Azimuth of the field, degrees; None: that of the source.

    Returns
    -------
    dict
        Contents of the files, settings with the seed, variant, versions and code.
    """
    return {
        "kind": "row of a sweep",
        "code": code_fingerprint(),
        "variant": mi.variant(),
        "files": contents.hashes,
        "settings": asdict(settings),
        "azimuth_deg": azimuth_deg,
    }


def foreign_plugins(scene: Any) -> list[str]:
    """Return the class names of plugins in a scene that come neither with mistray nor with Mitsuba."""
    parts: list[Any] = [scene.integrator(), *scene.emitters(), *scene.sensors()]
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        parts += [shape, bsdf, getattr(bsdf, "film", None), *getattr(bsdf, "scatterers", ())]
    params: Any = mi.traverse(scene)
    parts += [entry[2] for entry in params.properties.values()]
    found = {type(part) for part in parts if part is not None}
    return sorted({kind.__name__ for kind in found if kind.__module__.partition(".")[0] not in OWN})

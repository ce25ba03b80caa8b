"""Result of a sweep, with a row for each configuration, wavelength and field."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import mitsuba as mi

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.run import ghosts
from mistray.analyses.sweep.configurations import Resolved
from mistray.analyses.sweep.numbers import FIRST_LIGHT, Numbers, entering_columns, widest
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.metrics.changes.first_surfaces import Entering, FirstLight, entering_text, spoils
from mistray.metrics.changes.gaps import Gap, gaps_text
from mistray.metrics.scene_values import assign
from mistray.result import KeyNumber, Result
from mistray.scene import load
from mistray.toolkit.tables import frames
from mistray.toolkit.tables.frames import error_of
from mistray.trace import Trace, trace

if TYPE_CHECKING:
    import pandas as pd

CELL = ("configuration", "field_deg", "wavelength_nm")
"""The columns that name a row."""
Source: TypeAlias = "Path | dict[str, Any] | mi.Scene"


@dataclass(kw_only=True, eq=False, repr=False)
class Sweep(Result, table=".page:rows_table", figure=".figures:sweep_figure"):
    """
    Result of `mistray.sweep`: a row for each configuration, field angle and wavelength.

    Attributes
    ----------
    source : Path, dict or mi.Scene
        Scene that was swept.
    configurations : tuple of Resolved
        Configurations with the values that each one sets.
    field_deg, wavelengths_nm : tuple of float
        Field angles, degrees, and wavelengths, nm.
    rows : list of dict
        Rows for each configuration, wavelength and field, in this order, see `to_pandas`; for an unfinished sweep only
        the finished ones.
    reused : int
        Number of rows that come from the cache.
    cache_folder : Path or None
        Folder of the cache; None if it was neither read nor written.
    warnings : tuple of str
        Problems with the cache, and rows without rays or with fewer rays for lack of time, one line each.
    arguments : dict
        Arguments of `mistray.trace` in every row, as given.
    gaps : mapping of str to tuple of Gap
        Surfaces that meet in the original scene and are apart in a configuration, by configuration, see
        `mistray.metrics.changes.gaps`.
    not_traced : tuple of (str, float, float)
        Configuration, field angle (degrees) and wavelength (nm) of each row that was not traced for lack of time.

    Examples
    --------
    >>> states = {"centred": {"L2.y": 0.0}, "shifted": {"L2.y": 0.3}}
    >>> found = mistray.sweep("cooke_triplet", 0, configurations=states, rays=5000, cache=False)
    >>> table = found.to_pandas().set_index("configuration")
    >>> (1000 * table.direct_rms_radius_mm).round(1).to_dict()
    {'centred': 12.3, 'shifted': 35.9}
    """

    source: Source
    configurations: tuple[Resolved, ...]
    field_deg: tuple[float, ...]
    wavelengths_nm: tuple[float, ...]
    rows: list[Numbers]
    arguments: dict[str, Any]
    reused: int = 0
    cache_folder: Path | None = None
    warnings: tuple[str, ...] = ()
    gaps: Mapping[str, tuple[Gap, ...]] = field(default_factory=dict)
    not_traced: tuple[tuple[str, float, float], ...] = ()
    _scenes: dict[str, Any] = field(default_factory=dict, init=False)

    def __len__(self) -> int:
        return len(self.rows)

    def to_pandas(self) -> pd.DataFrame:
        """
        Return a row for each configuration, wavelength and field, as a frame.

        Returns
        -------
        DataFrame
            Columns ``configuration``, ``field_deg``, ``wavelength_nm``, and those of
            `mistray.analyses.sweep.numbers.numbers_of`. If one of several configurations is the original scene, also
            ``entering``, ``entering_percent``, ``entering_percent_se`` and ``gap_mm``, as in `PstSweep.to_pandas`.
            Rows that were not traced come last, with NaN.
        """
        import pandas as pd

        missing = [dict(zip(CELL, cell, strict=True)) for cell in self.not_traced]
        return pd.DataFrame([*(self.shown(row) for row in self.rows), *missing])

    @cached_property
    def _row_of(self) -> dict[tuple[Any, ...], Numbers]:
        """Rows by their key: configuration, field angle (degrees) and wavelength (nm)."""
        return {tuple(row[key] for key in CELL): row for row in self.rows}

    def shown(self, row: Numbers) -> Numbers:
        """Return a row by column name with the columns that `to_pandas` shows."""
        numbers = {key: value for key, value in row.items() if key != FIRST_LIGHT}
        if self.base is None:
            return numbers
        found = self.entering(*(row[key] for key in CELL))
        return numbers | entering_columns(found) | {"gap_mm": widest(self.gaps.get(row["configuration"], ()))}

    @property
    def base(self) -> str | None:
        """Name of the configuration without changes, the standard of the others; None without it or without others."""
        if len(self.configurations) < 2:
            return None
        return next((one.name for one in self.configurations if not one.values), None)

    def entering(
        self, configuration: str | None = None, field_deg: float | None = None, wavelength_nm: float | None = None
    ) -> tuple[Entering, ...]:
        """
        Return the surfaces that light newly meets first in a row, against the original scene, the strongest first.

        Parameters and errors are those of `trace`. It is empty if no configuration is the original scene, or if its row
        was not finished.
        """
        name, field, wavelength = self._cell(configuration, field_deg, wavelength_nm)
        light = [self._first_light((one, field, wavelength)) for one in (name, self.base)]
        return () if light[0] is None or light[1] is None else light[0].since(light[1])

    def _first_light(self, cell: tuple[str | None, float, float]) -> FirstLight | None:
        row = self._row_of.get(cell, {})
        return FirstLight(**row[FIRST_LIGHT]) if FIRST_LIGHT in row else None

    @property
    def opened(self) -> list[str]:
        """Lines of text on gaps that configurations open, and on light that newly meets a surface first."""
        found = [f"{name}: {gaps_text(gaps)}" for name, gaps in self.gaps.items() if gaps]
        for row in self.rows:
            cell = tuple(row[key] for key in CELL)
            entering = self.entering(*cell)
            if not entering:
                continue
            before = self._row_of[(self.base, *cell[1:])]
            less = row["stray_W"] < before["stray_W"] and spoils(entering)
            no_gain = "; less stray light is no gain here" if less else ""
            found.append(f"{cell[0]} at {cell[1]:g} deg, {cell[2]:g} nm: {entering_text(entering)}{no_gain}")
        return found

    def values(self) -> pd.DataFrame:
        """Return a DataFrame of the values set: configuration, key, entry (from 0), unit (empty if unknown), value."""
        import pandas as pd

        rows = [
            (one.name, key, entry, one.units.get(key, ""), float(value))
            for one in self.configurations
            for key, numbers in one.values.items()
            for entry, value in enumerate(numbers)
        ]
        return pd.DataFrame(rows, columns=["configuration", "key", "entry", "unit", "value"])

    def estimate(
        self,
        name: str,
        configuration: str | None = None,
        field_deg: float | None = None,
        wavelength_nm: float | None = None,
    ) -> Estimate:
        """
        Return a quantity of a row and its standard error.

        Parameters
        ----------
        name : str
            A column that has an error, such as ``"stray_W"``.
        configuration, field_deg, wavelength_nm : optional
            Row to use: name, degrees and nm; any of which the sweep has only one may be left out.

        Raises
        ------
        MistrayError
            If there is no such row or column.
        """
        where = self._cell(configuration, field_deg, wavelength_nm)
        if where not in self._row_of:
            raise MistrayError("sweep: this row was not finished; run it again")
        return estimate_of(self._row_of[where], name)

    def trace(
        self, configuration: str | None = None, field_deg: float | None = None, wavelength_nm: float | None = None
    ) -> Trace:
        """
        Trace the rays of a row again, and return the trace with its paths, rays and maps.

        A sweep keeps only numbers, because traces take tens of megabytes each.

        Parameters
        ----------
        configuration, field_deg, wavelength_nm : optional
            Row to trace: name, degrees and nm; any of which the sweep has only one may be left out.

        Raises
        ------
        MistrayError
            If there is no such row, or if the sweep was given a loaded scene, which has one state only, and the
            configuration changes it.
        """
        name, field, wavelength = self._cell(configuration, field_deg, wavelength_nm)
        return trace(self._scene(name), field_deg=field, wavelength_nm=wavelength, **self.arguments)

    def ghosts(self, configuration: str | None = None, wavelength_nm: float | None = None) -> GhostReport:
        """
        Return the ghost analysis of a configuration at one wavelength over all fields, by tracing the same rays again.

        Parameters and errors are those of `trace`. `mistray.report.write_all` writes its files.
        """
        name, _, wavelength = self._cell(configuration, self.field_deg[0], wavelength_nm)
        return ghosts(self._scene(name), self.field_deg, wavelength, contested_rays=0, **self.arguments)

    def _scene(self, name: str) -> Any:
        """
        Return the scene in a configuration, loaded on first use and kept for later traces.

        Raises
        ------
        MistrayError
            If the sweep was given a loaded scene and the configuration changes it.
        """
        if name in self._scenes:
            return self._scenes[name]
        one = next(one for one in self.configurations if one.name == name)
        if isinstance(self.source, mi.Scene) and one.values:
            raise MistrayError(
                f"configuration '{name}' changes a scene that was given loaded; give sweep() the scene's file, so that "
                "the configuration gets a scene of its own"
            )
        scene = self.source if isinstance(self.source, mi.Scene) else load(self.source)
        if one.values:
            assign(mi.traverse(scene), one.values)
        self._scenes[name] = scene
        return scene

    def _cell(
        self, configuration: str | None, field_deg: float | None, wavelength_nm: float | None
    ) -> tuple[str, float, float]:
        names = tuple(one.name for one in self.configurations)
        return (
            _chosen("configuration", configuration, names),
            _chosen("field_deg", field_deg, self.field_deg),
            _chosen("wavelength_nm", wavelength_nm, self.wavelengths_nm),
        )

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the numbers of rows, configurations and cached rows, and least and most stray power, W, by label."""
        found: dict[str, KeyNumber] = {"rows": len(self), "configurations": len(self.configurations)}
        stray = [estimate_of(row, "stray_W") for row in self.rows]
        if stray:
            found |= {"least stray [W]": min(stray), "most stray [W]": max(stray)}
        return found | {"from the cache": self.reused}


def estimate_of(row: Numbers, name: str) -> Estimate:
    """
    Return a quantity of a row with its standard error; see `Sweep.estimate`.

    Raises
    ------
    MistrayError
        If the row has no such column with an error.
    """
    if name not in row or error_of(name, list(row)) is None:
        known = ", ".join(key.replace("_se", "", 1) for key in row if re.search(r"_se(_|$)", key))
        raise MistrayError(f"a sweep has no number '{name}' with an error; choose from {known}")
    return frames.estimate_of(row, name)


def _chosen(what: str, given: Any, known: Sequence[Any]) -> Any:
    if given is None and len(known) == 1:
        return known[0]
    if given not in known:
        listed = ", ".join(f"'{value}'" if isinstance(value, str) else f"{value:g}" for value in known)
        said = "is missing" if given is None else f"is {given!r}"
        raise MistrayError(f"sweep: {what} {said}; choose from {listed}")
    return given

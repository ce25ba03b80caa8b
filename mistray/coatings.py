"""Reflectance and transmittance tabled over wavelength and angle, as a coating house delivers them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError

COLUMNS = ("wavelength_nm", "angle_deg", "R", "T")


@dataclass(frozen=True)
class CoatingTable:
    """
    R and T on a rectangular grid of wavelengths and angles.

    Attributes
    ----------
    name : str
        File or other name, for messages.
    wavelength_nm : (w,) float
        Ascending, nm.
    cos_rare : (a,) float
        Ascending cosine of the angle of incidence in the rarer of the two materials (the air side of a lens).
    values : (w, a, 3) float
        R for light from the front, R for light from the back, T (equal from both sides, by reciprocity).
    """

    name: str
    wavelength_nm: np.ndarray
    cos_rare: np.ndarray
    values: np.ndarray

    @classmethod
    def read(cls, path: str | Path) -> CoatingTable:
        """
        Read a CSV file with the columns wavelength_nm, angle_deg, R, T and optionally R_back.

        Raises
        ------
        MistrayError
            If the file is missing, a column is missing, the rows are no full grid, or R + T exceeds 1.
        """
        path = Path(path)
        try:
            with path.open(newline="") as file:
                reader = csv.DictReader(line for line in file if not line.startswith("#"))
                names = [name.strip() for name in reader.fieldnames or []]
                rows = [[value.strip() for value in row.values()] for row in reader]
        except OSError as error:
            raise MistrayError(
                f"coating table '{path}': {error.strerror}; check the path, relative to the scene file"
            ) from None
        missing = [name for name in COLUMNS if name not in names]
        if missing:
            raise MistrayError(
                f"coating table '{path}': column {', '.join(missing)} is missing; it needs {', '.join(COLUMNS)}"
            )
        try:
            data = {name: np.array([float(row[i]) for row in rows]) for i, name in enumerate(names)}
        except ValueError as error:
            raise MistrayError(f"coating table '{path}': {error}; every cell must be a number") from None
        wavelengths, angles = np.unique(data["wavelength_nm"]), np.unique(data["angle_deg"])
        if len(rows) != len(wavelengths) * len(angles) or not rows:
            raise MistrayError(
                f"coating table '{path}': {len(rows)} rows for {len(wavelengths)} wavelengths "
                f"and {len(angles)} angles; give every angle once at every wavelength"
            )
        order = np.lexsort((-data["angle_deg"], data["wavelength_nm"]))
        columns = [data["R"], data.get("R_back", data["R"]), data["T"]]
        values = np.stack([column[order] for column in columns], axis=-1).reshape(len(wavelengths), len(angles), 3)
        worst = float(np.max(values[..., :2].max(axis=-1) + values[..., 2]))
        if values.min() < 0 or worst > 1 + 1e-6:
            raise MistrayError(
                f"coating table '{path}': R + T reaches {worst:.6g} or a value is negative; R + T + A = 1 must hold"
            )
        return cls(str(path), wavelengths, np.cos(np.radians(angles[::-1])), values)

    @property
    def opaque(self) -> bool:
        """Whether T is 0 everywhere."""
        return not np.any(self.values[..., 2])

    def evaluate(self, wavelength_nm: float, cos_rare: np.ndarray) -> np.ndarray:
        """
        Interpolate, linearly in wavelength and in the cosine.

        Parameters
        ----------
        wavelength_nm : float
            Must lie within the table, unless the table holds a single wavelength.
        cos_rare : (n,) float
            Beyond the steepest tabled angle the last value is kept.

        Returns
        -------
        (n, 3) float
            R from the front, R from the back, T.

        Raises
        ------
        MistrayError
            If the wavelength is outside of the table.
        """
        lam = self.wavelength_nm
        if len(lam) == 1:
            slab = self.values[0]
        elif not lam[0] <= wavelength_nm <= lam[-1]:
            raise MistrayError(
                f"coating table '{self.name}': {wavelength_nm:g} nm is outside of its {lam[0]:g} … {lam[-1]:g} nm; "
                "extend the table"
            )
        else:
            i = min(int(np.searchsorted(lam, wavelength_nm, side="right")) - 1, len(lam) - 2)
            u = (wavelength_nm - lam[i]) / (lam[i + 1] - lam[i])
            slab = (1 - u) * self.values[i] + u * self.values[i + 1]
        return np.column_stack([np.interp(cos_rare, self.cos_rare, slab[:, k]) for k in range(3)])

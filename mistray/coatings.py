"""Reflectance and transmittance tabled over wavelength and angle, as a coating house delivers them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError

COLUMNS = ("wavelength_nm", "angle_deg", "R", "T")


@dataclass(frozen=True, eq=False)
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

    def response(self, wavelength_nm, n_front, n_back, cos_incident, from_front):  # type: ignore[no-untyped-def]
        """Placeholder."""
        n1, n2 = (n_front.real, n_back.real) if from_front else (n_back.real, n_front.real)
        s2 = (n1 / n2) ** 2 * (1 - cos_incident**2)
        c2 = np.sqrt(np.maximum(1 - s2, 0))
        v = self.evaluate(wavelength_nm, np.minimum(cos_incident, c2))
        r, t = v[:, 0 if from_front else 1], v[:, 2]
        r, t = np.where(s2 >= 1, r + t, r), np.where(s2 >= 1, 0, t)
        return Response(np.stack([r, r], 1), np.stack([t, t], 1), np.full(len(r), np.pi), np.zeros(len(r)))


@dataclass(frozen=True)
class Response:
    """Placeholder of worker C's class."""

    R: np.ndarray
    T: np.ndarray
    phase_r: np.ndarray
    phase_t: np.ndarray


@dataclass(frozen=True)
class Bare:
    """Placeholder of worker C's class."""

    name: str = "bare"
    opaque: bool = False

    def response(self, wavelength_nm, n_front, n_back, cos_incident, from_front):  # type: ignore[no-untyped-def]
        """Fresnel."""
        n1, n2 = (n_front, n_back) if from_front else (n_back, n_front)
        c1 = np.asarray(cos_incident) + 0j
        c2 = np.sqrt(1 - (n1 / n2) ** 2 * (1 - c1 * c1) + 0j)
        c2 = np.where((n2 * c2).imag < 0, -c2, c2)
        rs = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2 + 1e-300)
        rp = (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2 + 1e-300)
        R = np.abs(np.stack([rs, rp], axis=1)) ** 2
        R[np.asarray(cos_incident) == 0] = 1
        return Response(R, np.maximum(1 - R, 0), np.angle(rs * rp.conj()), np.zeros(len(R)))


class Stack:
    """Placeholder of worker C's class."""

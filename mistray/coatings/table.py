"""Reflectance and transmittance tabulated over wavelength and angle, as coating houses deliver them.

On a detector such a table states its quantum efficiency, 1 - R - T.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mistray.coatings.response import METAL_K, Response, cosines, total_reflection
from mistray.coatings.simple import SUM_TOLERANCE
from mistray.errors import MistrayError
from mistray.files.number_rows import numbers, read_cells
from mistray.ranges import ANYTHING, ByName

REQUIRED = ("wavelength_nm", "angle_deg")
SHARES = ("R", "T", "R_back")
PHASES = ("phase_r_deg", "phase_t_deg", "phase_r_back_deg")
COLUMNS = (*REQUIRED, *(f"{share}{pol}" for share in SHARES for pol in ("", "_s", "_p")), *PHASES)
DEFAULT_PHASES = {"phase_r_deg": 180.0, "phase_t_deg": 0.0, "phase_r_back_deg": 180.0}
FRONT, BACK, THROUGH = range(3)
TABLE = ByName(ANYTHING, "{'wavelength_nm': …, 'angle_deg': …, 'R': …, 'T': …}")


@dataclass(frozen=True, eq=False)
class CoatingTable:
    """
    R and T of a coating on a rectangular grid of wavelengths and angles, for s and p, with phases if known.

    Between the nodes R, T and the phase factors are linear in the wavelength and in the cosine of the angle. Beyond the
    greatest angle the last value is kept. A table of one wavelength holds for all wavelengths.

    Attributes
    ----------
    name : str
        Name of the file or other name, for messages.
    wavelength_nm : (w,) float64
        Vacuum wavelengths, ascending, nm.
    cos_rare : (a,) float64
        Cosines of the angle of incidence, ascending, in the rarer of the two materials (the air side of a lens), for
        light from either side. For an opaque coating, or on a metal, they are those on the side of incidence.
    shares : (w, a, 3, 2) float64
        R for light from the front, R for light from the back, and T, which is equal from both sides; for s and p.
    phasors : (w, a, 3) complex128
        Phase factors exp(i φ) of the phases φ = arg(j_s) - arg(j_p) in the order of `shares`, see `Response`.

    Examples
    --------
    >>> quarter_wave = mistray.coatings.coating_from_text("MgF2 0.25w")
    >>> mistray.coatings.write_table(quarter_wave, "mgf2.csv", [500, 550, 600], [0, 30], back="N-BK7")
    >>> table = mistray.coatings.CoatingTable.read("mgf2.csv")
    >>> table.wavelength_nm
    array([500., 550., 600.])
    >>> np.degrees(np.arccos(table.cos_rare)).round(6)
    array([30.,  0.])
    """

    name: str
    wavelength_nm: np.ndarray
    cos_rare: np.ndarray
    shares: np.ndarray
    phasors: np.ndarray

    @classmethod
    def read(cls, path: str | Path) -> CoatingTable:
        """
        Return the coating table in a CSV file.

        The columns wavelength_nm and angle_deg are required, with R and T, or R_s, R_p, T_s, T_p. R_back, or R_back_s
        and R_back_p, are optional, for a coating that absorbs; without them R holds from both sides. The phases
        phase_r_deg, phase_t_deg and phase_r_back_deg are optional, too: phase of s minus phase of p, by default 180, 0
        and 180, or without R_back twice phase_t_deg minus phase_r_deg. Lines that start with # are comments.

        Raises
        ------
        MistrayError
            If the file or a column is missing, a column is unknown, a cell is not a number, the rows are not a full
            grid, an angle or a wavelength is out of range, a fraction is negative, or R + T exceeds 1.
        """
        what = f"coating table '{path}'"
        (_, head), *below = read_cells(path, "coating table") or [(0, [])]
        header = _header(head, what)
        rows = [numbers(row, len(header), f"{what}, line {number}") for number, row in below]
        columns = np.array(rows, dtype=np.float64).reshape(len(rows), len(header)).T
        return cls.from_columns(str(path), dict(zip(header, columns, strict=True)))

    @classmethod
    def from_columns(cls, name: str, columns: Mapping[str, np.ndarray]) -> CoatingTable:
        """
        Return a coating table made of columns of wavelength, angle, R, T and phases.

        Parameters
        ----------
        name : str
            Name for messages.
        columns : mapping
            Arrays of equal length by the column names of `read`; rows in any order.

        Raises
        ------
        MistrayError
            If the rows are not a full grid, an angle or a wavelength is out of range, a fraction is negative, or R + T
            exceeds 1.
        """
        what = f"coating table '{name}'"
        TABLE.check("columns", columns, what)
        lam, angle = (np.asarray(columns[key], dtype=np.float64) for key in REQUIRED)
        wavelengths, angles = np.unique(lam), np.unique(angle)
        grid = set(zip(lam, angle, strict=True))
        if not len(lam) or len(lam) != len(wavelengths) * len(angles) or len(grid) != len(lam):
            raise MistrayError(
                f"{what}: {len(lam)} rows for {len(wavelengths)} wavelengths and {len(angles)} angles; "
                "give every angle once at every wavelength"
            )
        if angles[0] < 0 or angles[-1] > 90 or wavelengths[0] <= 0:
            raise MistrayError(
                f"{what}: angles from {angles[0]:g} to {angles[-1]:g}°, wavelengths from {wavelengths[0]:g} nm; "
                "angles must lie in 0 … 90°, wavelengths be positive"
            )
        order = np.lexsort((-angle, lam))
        shape = (len(wavelengths), len(angles))

        def pair(share: str) -> np.ndarray | None:
            names = (share, share) if share in columns else (f"{share}_s", f"{share}_p")
            if names[0] not in columns:
                return None
            return np.stack([np.asarray(columns[key])[order].reshape(shape) for key in names], axis=-1)

        reflected, transmitted, behind = (pair(share) for share in SHARES)
        assert reflected is not None
        assert transmitted is not None
        shares = np.stack([reflected, reflected if behind is None else behind, transmitted], axis=2)
        worst = float(np.max(shares[:, :, :THROUGH].max(axis=2) + shares[:, :, THROUGH]))
        if shares.min() < 0 or worst > 1 + SUM_TOLERANCE:
            raise MistrayError(f"{what}: R + T reaches {worst:.6g} or a value is negative; R + T + A = 1 must hold")
        phases = {
            key: np.asarray(columns.get(key, np.full(len(lam), default))) for key, default in DEFAULT_PHASES.items()
        }
        if "phase_r_back_deg" not in columns and behind is None:  # Stokes' relation: it absorbs nothing, r' = -r* t/t*
            phases["phase_r_back_deg"] = 2 * phases["phase_t_deg"] - phases["phase_r_deg"]
        angles_of = [phases[key][order].reshape(shape) for key in ("phase_r_deg", "phase_r_back_deg", "phase_t_deg")]
        phasors = np.exp(1j * np.radians(np.stack(angles_of, axis=-1)))
        return cls(name, wavelengths, np.cos(np.radians(angles[::-1])), shares, phasors)

    @property
    def opaque(self) -> bool:
        """True if the coating transmits nothing, T = 0, at every wavelength and angle of the table."""
        return not np.any(self.shares[:, :, THROUGH])

    def response(
        self, wavelength_nm: float, n_front: complex, n_back: complex, cos_incident: npt.ArrayLike, from_front: bool
    ) -> Response:
        """
        Return R, T and phases for light from one side, see `CoatingModel.response`.

        Beyond the critical angle R is the table's R + T at its greatest angle.

        Raises
        ------
        MistrayError
            If the wavelength is outside a table of several, or a cosine is out of range.
        """
        cosine = cosines(cos_incident)
        n_1, n_2 = (n_front, n_back) if from_front else (n_back, n_front)
        beyond = np.zeros(len(cosine), dtype=bool)
        if n_1.real > n_2.real and n_2.imag <= METAL_K and not self.opaque:
            beyond = total_reflection(n_front, n_back, cosine, from_front)
            cosine = np.sqrt(np.maximum(1 - (n_1.real / n_2.real) ** 2 * (1 - cosine**2), 0))
        shares, phasors = self._slab(wavelength_nm)
        reflection = FRONT if from_front else BACK

        def at(values: np.ndarray) -> np.ndarray:
            return np.asarray(np.interp(cosine, self.cos_rare, values))

        r, t = (
            np.stack([at(shares[:, channel, polarization]) for polarization in range(2)], axis=1)
            for channel in (reflection, THROUGH)
        )
        phase_r, phase_t = (
            np.arctan2(at(phasors[:, channel].imag), at(phasors[:, channel].real)) for channel in (reflection, THROUGH)
        )
        beyond = beyond[:, None]
        return Response(np.where(beyond, r + t, r), np.where(beyond, 0.0, t), phase_r, phase_t)

    def _slab(self, wavelength_nm: float) -> tuple[np.ndarray, np.ndarray]:
        """
        Return R and T, (a, 3, 2), and phase factors, (a, 3), at the table's angles, for a wavelength, nm.

        Raise `MistrayError` outside the table, unless it has one wavelength.
        """
        lam = self.wavelength_nm
        if len(lam) == 1:
            return self.shares[0], self.phasors[0]
        if not lam[0] <= wavelength_nm <= lam[-1]:
            raise MistrayError(
                f"coating table '{self.name}': {wavelength_nm:g} nm is outside its {lam[0]:g} … {lam[-1]:g} nm; "
                "extend the table"
            )
        i = min(int(np.searchsorted(lam, wavelength_nm, side="right")) - 1, len(lam) - 2)
        u = (wavelength_nm - lam[i]) / (lam[i + 1] - lam[i])
        shares, phasors = ((1 - u) * values[i] + u * values[i + 1] for values in (self.shares, self.phasors))
        return shares, phasors


def _header(names: Sequence[str], what: str) -> list[str]:
    """
    Return the column names of a coating table's CSV file.

    Raise `MistrayError` if a column is unknown, missing, or there twice; `what` is the start of its message.
    """
    given = list(names)
    unknown = [name for name in given if name not in COLUMNS]
    doubled = sorted({name for name in given if given.count(name) > 1})
    if unknown or doubled:
        raise MistrayError(
            f"{what}: column '{(unknown or doubled)[0][:40]}' is {'unknown' if unknown else 'there twice'}; "
            f"possible are {', '.join(COLUMNS)}"
        )
    missing = [name for name in REQUIRED if name not in given]
    for share in SHARES:
        pair = [name for name in (f"{share}_s", f"{share}_p") if name in given]
        if share in given and pair:
            raise MistrayError(f"{what}: columns {share} and {pair[0]} are both there; give {share} or its s and p")
        if len(pair) == 1 or (share not in given and not pair and share != "R_back"):
            missing.append(f"{share} or {share}_s and {share}_p" if not pair else f"the partner of {pair[0]}")
    if missing:
        raise MistrayError(
            f"{what}: column {', '.join(missing)} is missing; it needs wavelength_nm, angle_deg, R, T "
            "(or R_s, R_p, T_s, T_p)"
        )
    return given

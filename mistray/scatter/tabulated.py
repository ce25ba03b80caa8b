"""Measured scatter: a BSDF given by a table of directions."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.scatter.bsdf_csv import read_bsdf_csv
from mistray.scatter.evaluate import bsdf
from mistray.scatter.lobe import Lobe, Placement, RatioTable
from mistray.scatter.samples import BEYOND, Samples
from mistray.scatter.total import lobe_total
from mistray.scatter.zemax_bsdf import read_zemax_bsdf

INCIDENCE_NODES, R_NODES, PSI_NODES = 49, 257, 37
COS_NODES = 129
BINS_PER_OCTAVE = 4  # of the carrier
SMALLEST_R = 1e-6
ROUNDING = 1e-3  # of the total: tables are printed with four digits


@dataclass(frozen=True)
class Tabulated(Placement):
    """
    A BSDF interpolated in a table, the same at all wavelengths.

    The table becomes a profile over r = |β - β0|, the geometric mean of the data, times a smooth ratio over the
    specular direction, r and the azimuth about it. Between two angles of incidence it follows the specular direction,
    so that a peak moves and does not double; beyond the first and the last the scatter about the specular direction
    stays as it is there.

    Attributes
    ----------
    samples : Samples
        From `read`, or from arrays.
    cosine_corrected : bool
        The values are BSDF times cos θs, scattered intensity by incident flux.
    beyond : {"error", "hold", "zero"}
        What holds for directions past the last polar angle of the table.
    event, side, name
        As in `Placement`; where the file names one event, "both" means that one.
    relative_to : {"incident", "specular"}
        A measured BSDF is absolute: its light is taken from what the surface absorbs.

    Raises
    ------
    MistrayError
        If the table does not cover the hemisphere, scatters more than all light, or scatters none.
    """

    samples: Samples
    cosine_corrected: bool = False
    beyond: str = "error"
    _: KW_ONLY
    relative_to: str = "incident"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.beyond not in BEYOND:
            raise MistrayError(f"{self.title}: beyond is '{self.beyond}'; use 'error', 'hold' or 'zero'")
        measured = self.samples.event
        if measured is not None and self.event not in ("both", measured):
            raise MistrayError(
                f"{self.title}: the table holds {measured}, the event is '{self.event}'; leave event out"
            )
        if self.beyond == "error":
            self.samples.check_cover()
        if not np.any(self._above & (self._distances > SMALLEST_R) & (self._grid > 0)):
            raise MistrayError(f"{self.samples.title}: all values are 0; leave the model out")
        angles = self.samples.specular_deg
        lobe = Lobe("reflection", self._carrier, ratio=self._ratio)  # angles are counted from the specular direction
        totals = lobe_total(lobe, np.cos(np.radians(angles)), 1.0, 1.0)
        worst = int(np.argmax(totals))
        if totals[worst] > 1 + ROUNDING:
            raise MistrayError(
                f"{self.samples.title}: TIS = {totals[worst]:.4g} at {angles[worst]:g}°, more than all light; check "
                "the unit (1/sr) and whether the values are cosine corrected"
            )

    @classmethod
    def read(cls, path: str | Path, anisotropy: str = "error", **options: Any) -> Tabulated:
        """
        Read a table: a Zemax tabular BSDF (.bsdf) or a CSV file of angles.

        Parameters
        ----------
        path : str or Path
        anisotropy : {"error", "mean"}
            What becomes of scatter that is not the same at all rotations of the sample and on both sides of the plane
            of incidence: refused, or averaged. A trace has isotropic scatter only.
        **options
            The other attributes.

        Raises
        ------
        MistrayError
            If the name ends otherwise, or for what the readers find wrong.
        """
        readers = {".bsdf": read_zemax_bsdf, ".csv": read_bsdf_csv}
        suffix = Path(path).suffix.lower()
        if suffix not in readers:
            raise MistrayError(f"BSDF table '{path}': its name must end in .bsdf (Zemax) or .csv")
        return cls(readers[suffix](path, anisotropy), **options)

    @property
    def title(self) -> str:
        """For messages."""
        return f"Tabulated '{self.name or self.samples.name}'"

    def lobes(self, wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> tuple[Lobe, ...]:
        """The lobes for light of one side, see `Scatter`; a table is the same at all wavelengths."""
        events = self.events(from_front)
        if self.samples.event is not None:
            events = tuple(event for event in events if event == self.samples.event)
        return tuple(Lobe(event, self._carrier, shares=self.shares, ratio=self._ratio) for event in events)

    @cached_property
    def _above(self) -> np.ndarray:
        """Nodes that lie above the horizon, (a, b, c)."""
        return self.samples.above(self.cosine_corrected)

    @cached_property
    def _grid(self) -> np.ndarray:
        return self.samples.bsdf(self.cosine_corrected)

    @cached_property
    def _distances(self) -> np.ndarray:
        """|β - β0| of the nodes, (a, b, c)."""
        beta = self.samples.directions()[..., :2]
        return np.hypot(beta[..., 0] - np.sin(np.radians(self.samples.specular_deg))[:, None, None], beta[..., 1])

    @cached_property
    def _nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of the carrier: log r, and log f, the mean over the azimuths and over the angles of incidence."""
        used = self._above & (self._distances > SMALLEST_R) & (self._grid > 0)
        bins = np.floor(np.log2(np.maximum(self._distances, SMALLEST_R)) * BINS_PER_OCTAVE).astype(int)
        first = bins[used].min()
        centres = (np.arange(first, bins[used].max() + 1) + 0.5) * (np.log(2) / BINS_PER_OCTAVE)
        curves = []
        for r, f, number, here in zip(self._distances, self._grid, bins, used, strict=True):
            if not np.any(here):
                continue
            count = np.bincount(number[here] - first)
            sums = (np.bincount(number[here] - first, np.log(column[here])) for column in (r, f))
            mean_r, mean_f = (total[count > 0] / count[count > 0] for total in sums)
            curves.append(np.interp(centres, mean_r, mean_f))
        return centres, np.mean(curves, axis=0)

    def _carrier(self, r: np.ndarray) -> np.ndarray:
        """A power law between the nodes, constant before the first and after the last."""
        log_r, log_f = self._nodes
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.interp(np.log(r), log_r, log_f)))

    @cached_property
    def _ratio(self) -> RatioTable:
        """
        The table over the carrier, resampled: about the specular direction, or about the normal.

        The first suits peaks that are not round, the second what changes towards the horizon. That of the two is taken
        which is nearer to the table at its own nodes.
        """
        relative = self.samples.held(self._grid / self._carrier(self._distances), self._above)
        choices = (self._about_specular(relative), self._about_normal(relative))
        return min(choices, key=self._misfit)

    def _about_specular(self, relative: np.ndarray) -> RatioTable:
        """Over r and ψ; between angles of incidence at equal r and ψ."""
        samples = self.samples
        r_min = max(SMALLEST_R, 0.5 * float(np.min(self._distances[self._above & (self._distances > SMALLEST_R)])))
        r = np.geomspace(r_min, 2, R_NODES)[:, None]
        psi = np.linspace(0, np.pi, PSI_NODES)
        planes = []
        for index, specular in enumerate(np.radians(samples.specular_deg)):
            x, y = np.sin(specular) + r * np.cos(psi), r * np.sin(psi)
            beta = np.hypot(x, y)
            rim = np.maximum(1.0, beta)  # past the horizon the value at the horizon
            above = np.stack([x / rim, y / rim, np.sqrt(np.maximum(0.0, 1 - (beta / rim) ** 2))], axis=-1)
            planes.append(samples.at(relative, index, above, self.beyond))
        return RatioTable(self._over_incidence(planes), r_min, fixed=True)

    def _about_normal(self, relative: np.ndarray) -> RatioTable:
        """Over cos θs and φ; between angles of incidence at equal directions."""
        z = np.linspace(0, 1, COS_NODES)[:, None]
        phi = np.linspace(0, np.pi, PSI_NODES)
        sine = np.sqrt(1 - z * z)
        directions = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), z), axis=-1)
        planes = [
            self.samples.at(relative, index, directions, self.beyond)
            for index in range(len(self.samples.specular_deg))
        ]  # fmt: skip
        return RatioTable(self._over_incidence(planes), axes="cosines", fixed=True)

    def _over_incidence(self, planes: list[np.ndarray]) -> np.ndarray:
        """Interpolate between the angles of incidence onto nodes of their cosine."""
        angle = np.degrees(np.arccos(np.linspace(0, 1, INCIDENCE_NODES if len(planes) > 1 else 2)))
        place = np.interp(angle, self.samples.specular_deg, np.arange(len(planes)))
        low = np.minimum(place.astype(int), max(len(planes) - 2, 0))
        high = np.minimum(low + 1, len(planes) - 1)
        fraction = (place - low)[:, None, None]
        stack = np.array(planes)
        return (1 - fraction) * stack[low] + fraction * stack[high]

    def _misfit(self, ratio: RatioTable) -> float:
        """Mean departure from the table, relative to it, at its nodes above the horizon."""
        lobes = [Lobe("reflection", self._carrier, ratio=ratio)]
        directions, departures = self.samples.directions(), []
        for index, cosine in enumerate(np.cos(np.radians(self.samples.specular_deg))):
            here = self._above[index] & (self._grid[index] > 0)
            found = bsdf(lobes, "reflection", float(cosine), directions[index][here], 1.0, 1.0, 1.0)
            departures.append(np.abs(found / self._grid[index][here] - 1))
        return float(np.mean(np.concatenate(departures)))

"""Scatter model that interpolates a measured BSDF in a table of directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param
from mistray.ranges import FLAG, TEXT, Words
from mistray.scatter.evaluate import TINY, bsdf
from mistray.scatter.lobe import RELATIVE_TO, Lobe, Placement, RatioTable
from mistray.scatter.measured.bsdf_csv import read_bsdf_csv
from mistray.scatter.measured.rotations import RotatedSamples
from mistray.scatter.measured.samples import ANISOTROPY, BEYOND, BsdfSamples
from mistray.scatter.measured.speos_bsdf import SUFFIX, read_speos_bsdf
from mistray.scatter.measured.zemax_bsdf import read_zemax_bsdf
from mistray.scatter.radial import RadialTable
from mistray.scatter.total import lobe_total

INCIDENCE_NODES, R_NODES, PSI_NODES = 49, 257, 37
COS_NODES = 129
# Nodes of an anisotropic table, which has the rotation of the sample and both sides of the plane of incidence as well
TURNED_INCIDENCE_NODES, TURNED_R_NODES, TURNED_PSI_NODES, MOST_ROTATIONS = 33, 129, 73, 36
COARSE = 4  # every fourth node is compared to choose the frame of an anisotropic table
AZIMUTH_STEP_DEG = 2.5  # widest step of the azimuth in tables of smooth scatter
POLE = 1e-6  # sine of a direction's angle with the normal below which it counts as the normal
BINS_PER_OCTAVE = 4  # bins of the carrier
STEEPEST = 24.0  # fall of the carrier, a power of r; a bin may hold the horizon alone, where a table may have 1e-17
SMALLEST_R = 1e-6
ROUNDING = 1e-3  # of the total: tables are printed with four digits


@dataclass(frozen=True)
class Tabulated(Placement):
    """
    BSDF interpolated in a table, independent of the wavelength.

    The table becomes a profile over r = |β - β0|, the mean of the data, times a smooth ratio over the specular
    direction, r and the azimuth about it. Between two angles of incidence the scatter follows the specular
    direction, so that a peak moves and does not double. Beyond the first and the last angle it keeps its form about the
    specular direction. Between two rotations of the sample it turns with the sample or stays with the plane of
    incidence, whichever changes it less. If the file states the total scatter, the model has this total.

    Attributes
    ----------
    samples : BsdfSamples or RotatedSamples
        Table from `read`, or made from arrays.
    cosine_corrected : bool
        Whether the values are BSDF times cos θs, that is scattered intensity divided by incident flux, 1/sr.
    beyond : {"error", "hold", "zero"}
        Treatment of directions past the last polar angle: refused, last value held, or 0.
    event, side, name
        Options of `Placement`; if the file declares one event, "both" means that event.
    relative_to : {"incident", "specular"}
        Reference of the BSDF, see `Placement`. By default it is absolute, as measured, and its light is taken from the
        absorbed light.

    Raises
    ------
    MistrayError
        If the table holds another event, scatters more than all light or none, or does not cover the hemisphere and
        `beyond` is "error".
    """

    samples: BsdfSamples | RotatedSamples
    cosine_corrected: bool = Param("bool", FLAG, "whether the values are BSDF · cos θs").field(False)
    beyond: str = Param(
        "string", Words(BEYOND), "past the last angle of the table; ``hold``: the last value goes on"
    ).field("error")
    _: KW_ONLY
    relative_to: str = RELATIVE_TO.field("incident")

    also = MappingProxyType(
        {
            "file": Param(
                "file", TEXT, ".bsdf of Zemax, .anisotropicbsdf of Speos, or .csv of angles; see docs/scatter.md"
            ),
            "anisotropy": Param(
                "string",
                Words(ANISOTROPY),
                "scatter that differs between rotations of the sample, or between the sides of the plane of incidence; "
                "``keep``: it depends on how the sample lies",
                default="error",
            ),
        }
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        measured = self.samples.event
        if measured is not None and self.event not in ("both", measured):
            raise MistrayError(
                f"{self.title}: the table holds {measured}, the event is '{self.event}'; leave event out"
            )
        if self.beyond == "error":
            self._first.check_cover()
        if not np.any(self._above & (self._distances > SMALLEST_R) & (self._grid > 0)):
            raise MistrayError(f"{self.samples.title}: all values are 0; leave the model out")
        for rotation, totals in zip(self.samples.rotation_deg, self._scale * self._totals, strict=True):
            worst = int(np.argmax(totals))
            if totals[worst] > 1 + ROUNDING:
                turned = f" and rotation {rotation:g}°" if self.anisotropic else ""
                raise MistrayError(
                    f"{self.samples.title}: TIS = {totals[worst]:.4g} at {self._first.specular_deg[worst]:g}°{turned}, "
                    "more than all light; check the unit (1/sr) and whether the values are cosine corrected"
                )

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> Tabulated:
        """Return the model with given properties, see `Placement.of`; the file `file` holds the table."""
        if "file" not in properties:
            raise MistrayError(f"{cls.__name__}: file is missing; name a .bsdf, .anisotropicbsdf or .csv file")
        return cls.read(resolve(properties.pop("file")), **properties)

    @classmethod
    def read(cls, path: str | Path, anisotropy: str = "error", **options: Any) -> Tabulated:
        """
        Return the model of a BSDF table in a file: of Zemax (.bsdf), of Speos (.anisotropicbsdf), or a CSV of angles.

        Parameters
        ----------
        path : str or Path
            File of the table.
        anisotropy : {"error", "mean", "keep"}
            Whether scatter that differs between rotations of the sample, or between the sides of the plane of
            incidence, is refused, averaged or kept. If it is kept, it depends on how the surface is turned.
        **options
            Values of attributes other than `samples`.

        Raises
        ------
        MistrayError
            If the file name has another ending, the file is not valid, or for the reasons of the class.
        """
        readers = {".bsdf": read_zemax_bsdf, ".csv": read_bsdf_csv, SUFFIX: read_speos_bsdf}
        suffix = Path(path).suffix.lower()
        if suffix not in readers:
            raise MistrayError(f"BSDF table '{path}': its name must end in .bsdf (Zemax), {SUFFIX} (Speos) or .csv")
        return cls(readers[suffix](path, anisotropy), **options)

    @property
    def title(self) -> str:
        """Kind and name of the model, for error messages."""
        return f"Tabulated '{self.name or self.samples.name}'"

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobe of an event, or () if only the other event was measured, see `Placement.event_lobes`."""
        if self.samples.event not in (None, event):
            return ()
        return (Lobe(event, lambda r: self._scale * self._carrier(r), shares=self.shares, ratio=self._ratio),)

    @property
    def anisotropic(self) -> bool:
        """True if the scatter changes when the sample is turned about its normal, or has no mirror symmetry."""
        return isinstance(self.samples, RotatedSamples) or self.samples.whole

    @cached_property
    def _tables(self) -> tuple[BsdfSamples, ...]:
        """
        BSDF, 1/sr, at all d rotations of the sample, on one grid, with the last values above the horizon held below it.

        A table about the normal that resolves the scatter is interpolated to finer azimuths: between two of them a
        smooth lobe differs from a ratio to the profile. Of a peak between coarse angles only the profile tells the
        form.
        """
        tables = tuple(
            replace(table, values=table.held(table.bsdf(self.cosine_corrected), table.above(self.cosine_corrected)))
            for table in self.samples.tables
        )
        coarse = tables[0].frame == "normal" and np.max(np.diff(tables[0].azimuth_deg), initial=0) > AZIMUTH_STEP_DEG
        if not (coarse and all(table.resolved(self.beyond) for table in tables)):
            return tables
        return tuple(table.finer(AZIMUTH_STEP_DEG) for table in tables)

    @property
    def _first(self) -> BsdfSamples:
        """Table of the first sample rotation, see `_tables`."""
        return self._tables[0]

    @cached_property
    def _above(self) -> np.ndarray:
        """Mask of grid directions above the horizon, (a, b, c), see `BsdfSamples.above`."""
        return self._first.above(self.cosine_corrected)

    @cached_property
    def _grid(self) -> np.ndarray:
        """BSDF at all d rotations, (d, a, b, c), 1/sr, see `_tables`."""
        return np.array([table.values for table in self._tables])

    @cached_property
    def _distances(self) -> np.ndarray:
        """Distances |β - β0| of the grid directions from the specular one, in direction cosines, (a, b, c)."""
        beta = self._first.directions()[..., :2]
        return np.hypot(beta[..., 0] - np.sin(np.radians(self._first.specular_deg))[:, None, None], beta[..., 1])

    @cached_property
    def _nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Nodes of the radial profile, (k,): ln r, and ln f, f in 1/sr, mean over azimuth, incidence and rotation.

        Arithmetic means, and a limit to the slope, keep the ratio of the table to the profile small, so that it can be
        interpolated where the table falls by many powers of ten.
        """
        used = self._above & (self._distances > SMALLEST_R) & (self._grid > 0)
        bins = np.floor(np.log2(np.maximum(self._distances, SMALLEST_R)) * BINS_PER_OCTAVE).astype(int)
        one_of_any = bins[np.any(used, axis=0)]
        first = one_of_any.min()
        centres = (np.arange(first, one_of_any.max() + 1) + 0.5) * (np.log(2) / BINS_PER_OCTAVE)
        curves = []
        for grid, lit in zip(self._grid, used, strict=True):
            for r, f, number, here in zip(self._distances, grid, bins, lit, strict=True):
                if not np.any(here):
                    continue
                count = np.bincount(number[here] - first)
                sums = (np.bincount(number[here] - first, column) for column in (np.log(r[here]), f[here]))
                mean_r, mean_f = (total[count > 0] / count[count > 0] for total in sums)
                curves.append(np.interp(centres, mean_r, np.log(mean_f)))
        log_f = np.log(np.mean(np.exp(curves), axis=0)) + STEEPEST * centres
        return centres, np.maximum.accumulate(log_f) - STEEPEST * centres

    def _carrier(self, r: np.ndarray) -> np.ndarray:
        """Return the radial profile, 1/sr, at distances r: a power law between nodes, constant outside them."""
        log_r, log_f = self._nodes
        with np.errstate(divide="ignore"):
            return np.asarray(np.exp(np.interp(np.log(r), log_r, log_f)))

    @cached_property
    def _totals(self) -> np.ndarray:
        """TIS at the d rotations and a angles of incidence of the table, (d, a), without `_scale`."""
        lobe = Lobe("reflection", self._carrier, ratio=self._ratio)  # angles are counted from the specular direction
        cosines, profile = np.cos(np.radians(self._first.specular_deg)), RadialTable.of(self._carrier)
        rotations = np.radians(self.samples.rotation_deg)
        return np.array([lobe_total(lobe, cosines, 1.0, 1.0, profile, rotation) for rotation in rotations])

    @cached_property
    def _scale(self) -> float:
        """Factor with which the model has the total that the file states; 1 if it states none."""
        if self._first.stated is None:
            return 1.0
        total, specular, rotation = self._first.stated
        found = [np.interp(specular, self._first.specular_deg, row) for row in self._totals]
        return float(total / np.interp(rotation, self.samples.rotation_deg, found, period=360.0))

    @cached_property
    def _ratio(self) -> RatioTable:
        """
        Ratio of the table to the profile `_carrier`, resampled about the specular direction or about the normal.

        Nodes about the specular direction suit peaks that are not round; nodes about the normal suit changes towards
        the horizon. The one with the smaller error at the nodes of the table is used.
        """
        relative = [self._first.held(grid / self._carrier(self._distances), self._above) for grid in self._grid]
        resample = self._turned if self.anisotropic else self._still
        choices = (resample(relative, "radial"), resample(relative, "cosines"))
        return min(choices, key=self._misfit)

    def _still(self, relative: list[np.ndarray], axes: str) -> RatioTable:
        """
        Return the ratio of an isotropic table to the radial profile, at nodes of `axes`, see `RatioTable`.

        `relative` holds the ratio at the nodes of the table of each rotation of the sample, (a, b, c) each.
        """
        nodes = self._second_nodes(axes, R_NODES), np.linspace(0, np.pi, PSI_NODES)
        planes = self._planes(relative[0], self._first, axes, *nodes)
        return RatioTable(self._over_incidence(planes, INCIDENCE_NODES), self._r_min, axes, fixed=True)

    def _turned(self, relative: list[np.ndarray], axes: str) -> RatioTable:
        """
        Return the ratio of an anisotropic table to the radial profile; parameters as in `_still`.

        Its azimuths count from the specular direction or from the sample's x axis, whichever makes it change less.
        """
        second, angle = self._second_nodes(axes, TURNED_R_NODES), np.linspace(0, 2 * np.pi, TURNED_PSI_NODES)
        rotations = np.radians(self.samples.rotation_deg)

        def planes(second: np.ndarray, angle: np.ndarray, from_x: bool) -> np.ndarray:
            found = [
                self._planes(values, table, axes, second, angle + (rotation if from_x else 0.0))
                for values, table, rotation in zip(relative, self._tables, rotations, strict=True)
            ]
            return np.array(found)

        def change(from_x: bool) -> float:
            some = planes(second[::COARSE], angle[:-1:COARSE], from_x)
            return float(np.sum(np.abs(some - np.roll(some, -1, axis=0))))

        from_x = change(True) < change(False)
        closed = _all_round(rotations, planes(second, angle, from_x))
        values = np.stack([self._over_incidence(part, TURNED_INCIDENCE_NODES) for part in closed], axis=1)
        return RatioTable(values, self._r_min, axes, fixed=True, first_rotation=float(rotations[0]), from_x=from_x)

    @cached_property
    def _r_min(self) -> float:
        """Smallest distance r = |β - β0| at which the ratio is tabulated."""
        return max(SMALLEST_R, 0.5 * float(np.min(self._distances[self._above & (self._distances > SMALLEST_R)])))

    def _second_nodes(self, axes: str, count: int) -> np.ndarray:
        """Return `count` nodes of r, logarithmic up to 2, for axes "radial", else `COS_NODES` of cos θs in 0 … 1."""
        return np.geomspace(self._r_min, 2, count) if axes == "radial" else np.linspace(0, 1, COS_NODES)

    def _planes(
        self, relative: np.ndarray, table: BsdfSamples, axes: str, second: np.ndarray, angle: np.ndarray
    ) -> np.ndarray:
        """
        Return `relative` of a table at the measured angles of incidence and given scattered directions.

        Parameters
        ----------
        relative : (a, b, c) float64
            Ratio of the measured BSDF to `_carrier` at the nodes of `table`.
        table : BsdfSamples
            Measurement at one rotation of the sample.
        axes : str
            "radial": directions by r and ψ about the specular direction; else by cos θs and φ.
        second : (m,) float64
            Nodes of r or cos θs.
        angle : (k,) float64
            Nodes of ψ or φ, rad.

        Returns
        -------
        (a, m, k) float64
            Values of `relative` for each measured angle of incidence, node of `second` and node of `angle`.
        """
        planes, second = [], second[:, None]
        for index, specular in enumerate(np.radians(table.specular_deg)):
            if axes == "radial":
                x, y = np.sin(specular) + second * np.cos(angle), second * np.sin(angle)
                beta = np.hypot(x, y)
                rim = np.maximum(1.0, beta)  # past the horizon the value at the horizon
                parts = [x / rim, y / rim, np.sqrt(np.maximum(0.0, 1 - (beta / rim) ** 2))]
            else:
                # At the pole, too, each azimuth of an anisotropic table has its own value
                sine = np.sqrt(np.maximum(1 - second * second, POLE**2 if table.whole else 0.0))
                parts = list(np.broadcast_arrays(sine * np.cos(angle), sine * np.sin(angle), second))
            planes.append(table.at(relative, index, np.stack(parts, axis=-1), self.beyond))
        return np.array(planes)

    def _over_incidence(self, planes: np.ndarray, nodes: int) -> np.ndarray:
        """
        Return the ratios of `_planes`, (nodes, m, k), at even steps 0 … 1 of the cosine of the specular angle.

        If only one angle of incidence was measured, there are two equal nodes.
        """
        angle = np.degrees(np.arccos(np.linspace(0, 1, nodes if len(planes) > 1 else 2)))
        place = np.interp(angle, self._first.specular_deg, np.arange(len(planes)))
        low = np.minimum(place.astype(int), max(len(planes) - 2, 0))
        high = np.minimum(low + 1, len(planes) - 1)
        fraction = (place - low)[:, None, None]
        return np.asarray((1 - fraction) * planes[low] + fraction * planes[high])

    def _misfit(self, ratio: RatioTable) -> float:
        """
        Return the mean relative error, each 1 at most, of the interpolating model at nodes above the horizon.

        To it is added the error weighted by the scattered flux, which a narrow peak may hold on few nodes. Nodes
        without scatter are left out, and so is the pole for anisotropic samples.
        """
        lobes = [Lobe("reflection", self._carrier, ratio=ratio)]
        directions, departures = self._first.directions(), list[float]()
        polar = np.radians(self._first.polar_deg)
        flux = directions[..., 2] * np.sin(polar) * (np.gradient(polar) if len(polar) > 1 else 1.0)
        counts = self._above & (self._first.polar_deg > 0) if self.anisotropic else self._above
        for grid, rotation in zip(self._grid, np.radians(self.samples.rotation_deg), strict=True):
            for index, cosine in enumerate(np.cos(np.radians(self._first.specular_deg))):
                here = counts[index] & (grid[index] > 0)
                out = directions[index][here]
                found = bsdf(lobes, "reflection", float(cosine), out, 1.0, 1.0, 1.0, float(rotation))
                given, weight = grid[index][here], flux[index][here]
                error = np.abs(found - given)
                departures.append(float(np.mean(np.minimum(error / given, 1.0))))
                departures[-1] += float(weight @ error / max(weight @ given, TINY))
        return float(np.mean(departures))


def _all_round(rotations: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """
    Return values given at ascending rotations of a sample, (d,), rad, at even steps over a turn from the first.

    `planes`, (d, …), are the values. The last one repeats the first; there are at most `MOST_ROTATIONS` steps.
    """
    steps = np.diff(rotations, append=rotations[0] + 2 * np.pi)
    count = min(MOST_ROTATIONS, int(np.ceil(2 * np.pi / float(np.min(steps)) - 1e-6)))
    wanted = rotations[0] + np.linspace(0, 2 * np.pi, max(count, 1) + 1)
    place = np.interp(wanted, np.append(rotations, rotations[0] + 2 * np.pi), np.arange(len(planes) + 1))
    low = np.minimum(place.astype(int), len(planes) - 1)
    fraction = (place - low).reshape(-1, *[1] * (planes.ndim - 1))
    return np.asarray((1 - fraction) * planes[low] + fraction * planes[(low + 1) % len(planes)])

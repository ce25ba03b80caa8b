"""Energy ledger of a trace, and flux report of its surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from mistray.estimate import Estimate
from mistray.execute.tracer import Run
from mistray.recorders.sampled import sum_of_runs
from mistray.recorders.tallies import ABSORBED_HERE, CUTS, ESCAPED, HITS, INCIDENT
from mistray.result import KeyNumber, Result

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Energy(Result, table="..toolkit.tables.traces:energy_table", figure="..toolkit.figures.traces:energy_figure"):
    """
    Energy ledger of a trace: the launched flux and where it went, W; names with ``_se`` are standard errors, W.

    Attributes
    ----------
    launched_W, detected_W, escaped_W : float
        Flux of the sources, flux that the detectors absorb, and flux that leaves the scene, W.
    detected_se_W, escaped_se_W : float
        Standard errors of the two latter, W.
    detected : dict of str to (float, float)
        Detector id → absorbed flux and its standard error, W.
    absorbed : dict of str to (float, float)
        Surface id → absorbed flux and its standard error, W, the detectors left out.
    absorbed_in : dict of str to (float, float)
        Material → flux absorbed along the way through it and its standard error, W; only materials that absorb flux.
    cut : dict of str to float
        Reason → flux of the branches that were not followed, W:

        - "flux_threshold", "max_reflections", "max_generations", "max_events", "max_consecutive", "max_segments",
          "ray_control";
        - "max_scatters": all limits of scatter events;
        - "roulette": flux that Russian roulette removed less what it added, 0 on average;
        - "specular_reflection_below", "specular_transmission_below", "scattered_reflection_below",
          "scattered_transmission_below", "absorption_below": flux that `cut_below` and `cut_below_W` cut;
        - "scatter_sampling": flux that surfaces scatter less that of the scattered rays, 0 on average;
        - "medium": a ray met a surface from a material that is not there, a gap or an overlap in the geometry.

        Where `max_random_scatters` leaves a hit only its aimed rays, "max_scatters" holds the scattered flux less that
        of these rays. That is right on average, but has the noise of the aimed rays and can be below 0.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> share = t.energy.absorbed["barrel_1_wall"][0] / t.energy.launched_W
    >>> print(f"the first wall absorbs {share:.0%} of the light")
    the first wall absorbs 37% of the light
    >>> bool(abs(t.energy.closure) < 1e-4)
    True
    """

    launched_W: float
    detected_W: float
    detected_se_W: float
    detected: dict[str, tuple[float, float]]
    absorbed: dict[str, tuple[float, float]]
    absorbed_in: dict[str, tuple[float, float]]
    escaped_W: float
    escaped_se_W: float
    cut: dict[str, float]

    @property
    def closure(self) -> float:
        """Relative closure: (detected + absorbed at surfaces and in media + escaped + cut - launched) / launched."""
        absorbed = sum(value for value, _ in (*self.absorbed.values(), *self.absorbed_in.values()))
        return (
            self.detected_W + absorbed + self.escaped_W + sum(self.cut.values()) - self.launched_W
        ) / self.launched_W

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the launched and the detected flux, W, and the relative closure."""
        detected = Estimate(self.detected_W, self.detected_se_W)
        return {"launched [W]": self.launched_W, "detected [W]": detected, "closure": f"{self.closure:.1e}"}

    @property
    def greatest_loss(self) -> str:
        """Name of the largest loss of flux, with its percentage of the launched flux, such as ``'stop' takes 93 %``."""
        losses = {f"'{name}' takes": value for name, (value, _) in self.absorbed.items()}
        losses |= {f"{name} absorbs": value for name, (value, _) in self.absorbed_in.items()}
        losses |= {"the outside gets": self.escaped_W} | {f"{reason} cuts": value for reason, value in self.cut.items()}
        what, value = max(losses.items(), key=lambda item: item[1])
        return f"{what} {100 * value / self.launched_W:.3g} %"

    def __str__(self) -> str:
        def line(name: str, value: float, se: float | None = None) -> str:
            error = "" if se is None else f" ± {se:.1e}"
            return f"{name:<28}{value:>14.6e}{error:<12} W {100 * value / self.launched_W:>11.5f} %"

        lines = [line("launched", self.launched_W), line("detected", self.detected_W, self.detected_se_W)]
        if len(self.detected) > 1:
            lines += [line(f"detected by {name}", *value) for name, value in self.detected.items()]
        # Only losses that occur are listed, the strongest first
        strongest = sorted(self.absorbed.items(), key=lambda item: -item[1][0])
        lines += [line(f"absorbed by {name}", *value) for name, value in strongest if value[0] > 0]
        lines += [line(f"absorbed in {name}", *value) for name, value in self.absorbed_in.items()]
        lines.append(line("escaped", self.escaped_W, self.escaped_se_W))
        lines += [line(f"cut by {reason}", value) for reason, value in self.cut.items() if value]
        lines.append(f"{'closure':<28}{self.closure:>14.1e} (relative)")
        return "\n".join(lines)


@dataclass(frozen=True)
class SurfaceFlux:
    """
    Hits, incident flux and absorbed flux (W) at one surface of a trace, with standard errors.

    Attributes
    ----------
    id, part : str
        Id of the surface, and name of its part.
    space : int
        Optical space that the surface declares; -1: none.
    hits : int
        Number of rays that meet it.
    incident_W, incident_se_W : float
        Incident flux and its standard error, W.
    absorbed_W, absorbed_se_W : float
        Absorbed flux and its standard error, W.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> front = t.surfaces[0]
    >>> print(f"{front.id}: {front.incident_W:.0f} W incident, {front.absorbed_W:.0f} W absorbed")
    L1_front: 348 W incident, 0 W absorbed
    """

    id: str
    part: str
    space: int
    hits: int
    incident_W: float
    incident_se_W: float
    absorbed_W: float
    absorbed_se_W: float

    def __add__(self, other: SurfaceFlux) -> SurfaceFlux:
        """
        Return hits and fluxes, W, of two traces at the same surface added up.

        The errors are added, too: an upper bound, since the traces may share start rays.
        """
        sums = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)[3:]}
        return replace(self, **sums)


class FluxReport(
    Sequence[SurfaceFlux],
    Result,
    table="..toolkit.tables.traces:flux_table",
    figure="..toolkit.figures.traces:flux_figure",
):
    """
    Incident and absorbed flux, W, at every surface of the scene, in the scene's order.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> table = t.surfaces.to_pandas().set_index("id")
    >>> print(f"{table.incident_W['L1_front']:.0f} W meet the first surface")
    348 W meet the first surface
    """

    def __init__(self, rows: Sequence[SurfaceFlux]) -> None:
        self._rows = list(rows)

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        return self._rows[index]

    def __len__(self) -> int:
        return len(self._rows)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return, by label, the number of surfaces, the number of hits, and the flux absorbed at surfaces, W."""
        absorbed = sum(row.absorbed_W for row in self)
        return {"surfaces": len(self), "hits": sum(row.hits for row in self), "absorbed [W]": float(absorbed)}

    def to_pandas(self) -> pd.DataFrame:
        """Return the report as a DataFrame: a row for each surface, a column for each attribute of `SurfaceFlux`."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self._rows])


def flux_report(runs: Sequence[Run]) -> FluxReport:
    """Return the flux at every surface, W, summed over runs (sources and wavelengths)."""
    table = runs[0].table
    listed = list(table.listed)
    hits = np.sum([run.sums.surfaces[listed, HITS].sum(axis=-1) for run in runs], axis=0)
    fluxes = [
        sum_of_runs([run.sums.surfaces[listed, kind] for run in runs], runs) for kind in (INCIDENT, ABSORBED_HERE)
    ]
    columns = [hits.round().astype(int), *(values for pair in fluxes for values in pair)]
    rows = zip(listed, *(column.tolist() for column in columns), strict=True)
    return FluxReport([SurfaceFlux(table.ids[i], table.parts[i], table.spaces[i], *numbers) for i, *numbers in rows])


def energy_ledger(runs: Sequence[Run], surfaces: FluxReport) -> Energy:
    """Return the energy ledger, W, of runs (sources and wavelengths) together; `surfaces` is their flux report."""
    table = runs[0].table
    # Detectors
    own = {table.ids[i] for i in table.detectors}
    detected = {row.id: (row.absorbed_W, row.absorbed_se_W) for row in surfaces if row.id in own}
    # Detectors share start rays: the error of their sum comes from that of the batches
    _, detected_se = sum_of_runs([run.sums.surfaces[table.detectors, ABSORBED_HERE].sum(axis=0) for run in runs], runs)
    # Light that leaves the scene
    escaped, escaped_se = sum_of_runs([run.sums.channels[ESCAPED] for run in runs], runs)
    # Media, by name, whatever their numbers in each run
    media: dict[str, list[tuple[np.ndarray, Run]]] = {}
    for run in runs:
        for name, sums in zip(run.table.optics.media[1:], run.sums.media[1:], strict=True):
            if sums.any():
                media.setdefault(name, []).append((sums, run))
    absorbed_in = {name: sum_of_runs(*zip(*found, strict=True)) for name, found in media.items()}
    return Energy(
        launched_W=sum(run.source.power for run in runs),
        detected_W=sum(value for value, _ in detected.values()),
        detected_se_W=float(detected_se),
        detected=detected,
        absorbed={row.id: (row.absorbed_W, row.absorbed_se_W) for row in surfaces if row.id not in own},
        absorbed_in={name: (float(value), float(se)) for name, (value, se) in absorbed_in.items()},
        escaped_W=float(escaped),
        escaped_se_W=float(escaped_se),
        cut={
            reason: float(sum(run.unit * run.sums.channels[row].sum() for run in runs)) for reason, row in CUTS.items()
        },
    )

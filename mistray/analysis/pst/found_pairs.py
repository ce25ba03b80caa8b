"""What a run of a PST has found: its ways in both directions, the strongest of them, and those it met too seldom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.analysis.pst.forward_part import ForwardPart
from mistray.analysis.pst.pilot import BACKWARD, FORWARD, SELDOM, forward_events
from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import CLASS_COUNT
from mistray.recorders.path_events import DIRECT, describe_events
from mistray.recorders.path_key import host_keys

if TYPE_CHECKING:
    import pandas as pd

PATHS_LISTED = 200  # of a cell, the strongest
SELDOM_LISTED = 40  # ways that were sampled too seldom
TOLD = 1e-3  # share of a cell's light that such a way must add to the error to be listed


@dataclass(frozen=True)
class FoundPairs:
    """
    Light by way and cell, in both directions.

    Attributes
    ----------
    events : (w, k) uint32
    lengths : (w,) int
        Ways, in the order of the light.
    way, cell : (p,) int
    hits, value, variance : (p,) float64
        Rays, PST_normal and its variance.
    planned : (q,) int
        Ways of the pairs of the plan.
    """

    events: np.ndarray
    lengths: np.ndarray
    way: np.ndarray
    cell: np.ndarray
    hits: np.ndarray
    value: np.ndarray
    variance: np.ndarray
    planned: np.ndarray

    @classmethod
    def of(cls, trace: BackwardTrace, light: ForwardPart, paths: dict[str, np.ndarray]) -> FoundPairs:
        """What a run has found; `paths` is the path table of all its backward rays."""
        plan = light.plan
        if not paths:
            nothing = np.zeros(0)
            paths = {name: nothing for name in ("hits", "weight", "squares")}
            paths |= {name: nothing.astype(np.int64) for name in ("lengths", "path", "cell")}
            paths["events"] = np.zeros((0, 1), dtype=np.uint32)
        turned, lengths = forward_events(paths["events"], paths["lengths"], trace.table.detector)
        longest = max(turned.shape[1], plan.events.shape[1])
        events = np.concatenate(
            [np.pad(part, ((0, 0), (0, longest - part.shape[1]))) for part in (turned, plan.events)]
        )
        lengths = np.concatenate([lengths, plan.lengths])
        _, chosen, place = np.unique(host_keys(events, lengths), return_index=True, return_inverse=True)
        planned = place[len(turned) :][plan.way]
        numbers, hits, value, variance = light.pairs()
        met = hits > 0
        rays = float(trace.rays.sum())
        unit = np.repeat(np.pi / trace.grid.solid_angle, trace.grid.shape[1])[paths["cell"]] / rays
        spread = unit**2 * np.maximum(paths["squares"] - paths["weight"] ** 2 / rays, 0)
        return cls(
            events=events[chosen],
            lengths=lengths[chosen],
            way=np.concatenate([place[paths["path"]], planned[numbers[met]]]),
            cell=np.concatenate([paths["cell"], plan.cell[numbers[met]]]),
            hits=np.concatenate([paths["hits"], hits[met]]),
            value=np.concatenate([unit * paths["weight"], value[met]]),
            variance=np.concatenate([spread, variance[met]]),
            planned=planned,
        )

    def _describe(self, trace: BackwardTrace, ways: np.ndarray) -> dict[str, np.ndarray]:
        """The columns of `describe_events` of some ways."""
        table, lengths = trace.table, self.lengths[ways]
        facts = describe_events(self.events[ways], lengths, table.event_ids, table.event_words)
        if not trace.has_optics:  # light that meets nothing is the image then
            facts["kind"][lengths == 1] = DIRECT
        return facts

    def seldom(self, trace: BackwardTrace, light: ForwardPart) -> tuple[np.ndarray, list[dict[str, Any]]]:
        """Variance that the run is missing, by class and cell, and the ways that it sampled too seldom."""
        plan = light.plan
        cells = plan.rays.shape[1]
        rays = np.where(plan.forward, light.rays[plan.cell], float(trace.rays.sum()))
        if trace.lists_paths:
            found, wanted = self.way * cells + self.cell, self.planned * cells + plan.cell
            order = np.argsort(found)
            place = order[np.minimum(np.searchsorted(found, wanted, sorter=order), max(len(order) - 1, 0))]
            there = found[place] == wanted if len(found) else np.zeros(len(wanted), dtype=bool)
            hits, variance = (np.where(there, part[place], 0.0) for part in (self.hits, self.variance))
        else:  # nobody has counted them: as many as in the pilot
            own = np.where(plan.forward, FORWARD, BACKWARD)
            before = own, np.arange(len(own))
            hits = plan.hits[before] * rays / plan.rays[own, plan.cell]
            variance = plan.second[before] / np.maximum(rays, 1)
        missing = plan.widening(hits, variance, rays)
        hidden = np.zeros((CLASS_COUNT, cells))
        np.add.at(hidden, (light.classes, plan.cell), missing)
        listed = np.flatnonzero((hits < SELDOM) & (missing > (TOLD * plan.light[plan.cell]) ** 2))
        listed = listed[np.argsort(-missing[listed], kind="stable")][:SELDOM_LISTED]
        facts = self._describe(trace, self.planned[listed])
        angle, azimuth = np.divmod(plan.cell[listed], trace.grid.shape[1])
        columns = {
            "angle_deg": trace.grid.field_deg[angle],
            "azimuth_deg": trace.grid.azimuths_deg[azimuth],
            "events": facts["events"],
            "rays": hits[listed].astype(np.int64),
            "pilot_rays": plan.hits[np.where(plan.forward, BACKWARD, FORWARD), np.arange(len(missing))][listed],
            "pst_normal": plan.mean[np.where(plan.forward, BACKWARD, FORWARD), np.arange(len(missing))][listed],
        }
        rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
        return hidden.reshape(CLASS_COUNT, *trace.grid.shape), [dict(zip(columns, row, strict=True)) for row in rows]

    def path_rows(self, trace: BackwardTrace) -> pd.DataFrame | None:
        """The strongest ways of each cell; None if the run lists no paths."""
        import pandas as pd

        if not trace.lists_paths:
            return None
        m = trace.grid.shape[1]
        kept = _strongest(self.cell, self.value, PATHS_LISTED)
        used, place = np.unique(self.way[kept], return_inverse=True)
        columns: dict[str, Any] = {"cell": self.cell[kept] // m, "azimuth_cell": self.cell[kept] % m}
        columns |= {name: values[place] for name, values in self._describe(trace, used).items()}
        columns["rays"] = self.hits[kept].astype(np.int64)
        columns["pst_normal"] = self.value[kept]
        columns["pst_normal_se"] = np.sqrt(self.variance[kept])
        return pd.DataFrame(columns)


def _strongest(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the largest values of each group, at most `count` of each."""
    order = np.lexsort((-values, group))
    sizes = np.bincount(group) if len(group) else np.zeros(0, dtype=np.int64)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.asarray(order[rank < count])

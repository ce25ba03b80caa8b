"""Rays on demand: polylines and the ray history table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.path_events import INTERCEPTS
from mistray.recorders.path_key import EVENT_BITS, EVENT_MASK
from mistray.trace.precise import retrace

if TYPE_CHECKING:
    import pandas as pd

    from mistray.execute.tracer import Run


@dataclass
class Ray:
    """
    Branch from the source to the detector.

    Attributes
    ----------
    start_ray : int
        Number of the start ray.
    points : (k + 1, 3) float64
        Start and all hits, mm.
    directions : (k + 1, 3) float64
        Direction in which the ray leaves each point; zero at the detector.
    flux_W : (k + 1,) float64
        Flux with which the ray arrives at each point.
    opl_mm : (k + 1,) float64
        Optical path length from the start.
    codes : (k,) uint32
        Events, surface << EVENT_BITS | type.
    """

    start_ray: int
    points: np.ndarray
    directions: np.ndarray
    flux_W: np.ndarray
    opl_mm: np.ndarray
    codes: np.ndarray


class RayHistory:
    """Recorded rays of one path, or of all."""

    def __init__(self, run: Run, rays: list[Ray]) -> None:
        self._run, self._rays = run, rays

    def __len__(self) -> int:
        return len(self._rays)

    def __getitem__(self, numbers: Sequence[int]) -> RayHistory:
        """Return the rays of these numbers."""
        return RayHistory(self._run, [self._rays[number] for number in numbers])

    @property
    def rays(self) -> list[np.ndarray]:
        """Polylines (k + 1, 3), mm."""
        return [ray.points for ray in self._rays]

    def with_facts(self, facts: Mapping[str, np.ndarray]) -> pd.DataFrame:
        """Return the ray history table with more columns after the node, from one value for each ray."""
        table = self.to_pandas()
        for place, (name, values) in enumerate(facts.items(), start=2):
            table.insert(place, name, values[table.ray.to_numpy(np.int64)].tolist())
        return table

    def to_pandas(self) -> pd.DataFrame:
        """
        Return the ray history table: one row for each node of each ray.

        Columns: ray, node, start_ray, intercept (Emitted, SpecTran, SpecRefl, TIR, RandTran, RandRefl, ImpTran,
        ImpRefl, Absorbed), object, surface, wavelength_nm, x_mm, y_mm, z_mm, flux_W (arriving), opl_mm (from the
        start), dx, dy, dz (leaving).
        """
        import pandas as pd

        table, source = self._run.table, self._run.source
        ids, parts = table.event_ids, table.event_parts
        rows = []
        for number, ray in enumerate(self._rays):
            # A start ray has no event: its source stands for the object
            met = [(INTERCEPTS[code & EVENT_MASK], code >> EVENT_BITS) for code in ray.codes.tolist()]
            events = [("Emitted", source.name, "-"), *((what, parts[place], ids[place]) for what, place in met)]
            nodes = zip(events, ray.points, ray.flux_W, ray.opl_mm, ray.directions, strict=True)
            for node, (event, point, flux, opl, direction) in enumerate(nodes):
                facts = number, node, ray.start_ray, *event, source.wavelength_nm
                rows.append((*facts, *point, flux, opl, *direction))
        # In the order of the rows above
        names = ["ray", "node", "start_ray", "intercept", "object", "surface", "wavelength_nm"]
        return pd.DataFrame(rows, columns=[*names, "x_mm", "y_mm", "z_mm", "flux_W", "opl_mm", "dx", "dy", "dz"])


def joined_histories(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the ray history tables of several runs as one, with the rays numbered through."""
    import pandas as pd

    done = 0
    for table in tables:
        rays = table.ray.nunique()
        table["ray"] += done
        done += rays
    return pd.concat([table for table in tables if len(table)] or tables[:1], ignore_index=True)


def spread(count: int, most: int | None) -> np.ndarray:
    """Return at most `most` of the numbers 0 … count - 1, the first and the last among them; None: all of them."""
    if most is None or count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)


def read_rays(run: Run, recorder: BranchRecorder, most: int) -> RayHistory:
    """Read at most `most` rays, spread over the recorded ones, with positions computed again in float64."""
    count = min(int(recorder.count[0]), recorder.capacity)
    lanes = np.array(recorder.lane)[:count]
    # Start rays are numbered along a curve through the beam: every k-th is a fair sample of all
    order = np.argsort(lanes, kind="stable")
    order = order[spread(count, most)]
    return RayHistory(run, rays_in_slots(run, recorder, order, *run.start_rays(lanes[order])))


def rays_in_slots(
    run: Run, recorder: BranchRecorder, slots: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> list[Ray]:
    """
    Return recorded rays with positions computed again in float64.

    Parameters
    ----------
    run : Run
    recorder : BranchRecorder
    slots : (n,) int
        Places of the rays in the recorder.
    origins, directions : (n, 3) float64
        Start rays, mm.
    """
    lanes = np.array(recorder.lane)[slots]
    # Bundles come in the order of their events; the rays go back to that of the slots
    rays: dict[int, Ray] = {}
    for bundle in bundles(run, recorder, slots, origins, directions):
        rays |= {k: bundle.ray(j, int(lanes[k])) for j, k in enumerate(bundle.numbers.tolist())}
    return [rays[number] for number in range(len(slots))]


class Bundle(NamedTuple):
    """Rays of the same events, with their numbers (n,); other attributes as in `Ray`, with a row for each ray."""

    numbers: np.ndarray
    codes: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    opl_mm: np.ndarray
    flux_W: np.ndarray

    def ray(self, row: int, start_ray: int) -> Ray:
        """Return the ray of a row."""
        points, leaving, flux, opl = (v[row] for v in (self.points, self.directions, self.flux_W, self.opl_mm))
        return Ray(start_ray, points, leaving, flux, opl, self.codes)


def bundles(
    run: Run, recorder: BranchRecorder, slots: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> Iterator[Bundle]:
    """Yield recorded rays by their events, with positions computed again in float64; see `rays_in_slots`."""
    codes, lengths = recorder.events(slots)
    nodes = recorder.nodes_of(slots, codes.shape[1])
    # All rays at once, whatever their paths: `retrace` groups them by surface, step by step
    exact = retrace(run.table, origins, directions, codes, lengths, nodes[:, :, :3] + run.table.centre)
    flux = run.unit * np.concatenate([np.ones((len(slots), 1)), nodes[:, :, 6]], axis=1)
    alike: dict[bytes, list[int]] = {}  # numbers of the rays of the same events
    for number, length in enumerate(lengths.tolist()):
        alike.setdefault(codes[number, :length].tobytes(), []).append(number)
    for same in alike.values():
        numbers = np.array(same)
        length = int(lengths[same[0]])
        own = (values[numbers, : length + 1] for values in (*exact, flux))
        yield Bundle(numbers, codes[same[0], :length].copy(), *own)

"""Scatter of all surfaces, packed for the kernel: lobes, targets, and totals over the angle of incidence.

Light of one side of a surface that leaves by one event (transmission or reflection) is one *case*, number
4 s + 2 side + event. Each case has a list of lobes, a list of targets, and a table over the angle of incidence of what
the specular beam loses and of what is scattered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.scatter.lobe import Lobe, Scatter
from mistray.scatter.radial import RadialTable
from mistray.scatter.total import Totals, check_budget, model_lobes, specular_cosine, totals
from mistray.trace.device_targets import DeviceTargets
from mistray.trace.lobes import RadialSampler
from mistray.trace.optics import OPAQUE, Optics
from mistray.trace.targets import AimSet
from mistray.trace.upload import upload

EVENT_NAMES = ("transmission", "reflection")  # in the order of the cases
CASES = 4  # of a surface
ANGLES = 256  # intervals of the tables of totals, uniform in the cosine
# Flags of a lobe; the number of its radial table stands above them
BY_ANGLE, RETRO, NORMAL, GHS, RAYLEIGH_RICE, RATIO, BY_COSINES, EDGE = (1 << bit for bit in range(8))
TABLE_SHIFT = 8
RANDOM_RAYS_SHIFT = 16


@dataclass(frozen=True)
class Side:
    """What the models of a surface make of light of one side: lobes with their tables, and totals by angle."""

    lobes: tuple[Lobe, ...]
    tables: tuple[RadialTable, ...]
    rows: dict[str, np.ndarray]  # event → (ANGLES + 1, 4): loss, and three terms of what is scattered

    def without_transmission(self) -> Side:
        """The same of an opaque surface."""
        kept = [
            (lobe, table) for lobe, table in zip(self.lobes, self.tables, strict=True) if lobe.event == "reflection"
        ]
        lobes, tables = tuple(lobe for lobe, _ in kept), tuple(table for _, table in kept)
        return Side(lobes, tables, {**self.rows, "transmission": np.zeros((ANGLES + 1, 4))})


@lru_cache(maxsize=1024)
def side_of(models: tuple[Scatter, ...], wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> Side:
    """Lobes and totals; uniform nodes in cos θi for reflection, in the cosine in the rarer medium for transmission."""
    lobes = model_lobes(models, wavelength_nm, n_in, n_out, from_front)
    tables = tuple(RadialTable.of(lobe.profile, lobe.r_max) for lobe in lobes)
    x = np.linspace(0.0, 1.0, ANGLES + 1)
    denser = np.sqrt(1 - (1 - x * x) * min(n_out / n_in, 1.0) ** 2)  # cos θi where cos θt is x
    rows = {}
    for event in EVENT_NAMES:
        cos_i = x if event == "reflection" else denser
        here = [k for k, lobe in enumerate(lobes) if lobe.event == event]
        sums = totals([lobes[k] for k in here], cos_i, n_in, n_out, [tables[k] for k in here])
        rows[event] = np.column_stack([sums.loss[event], *sums.terms[event]])
    return Side(lobes, tables, rows)


class ScatterTables:
    """
    Scatter of all surfaces at one wavelength.

    Parameters
    ----------
    ids : sequence of str
        Names of the surfaces, for messages.
    optics : Optics
        Their coatings and materials at a wavelength.
    aims : mapping
        (surface, leaves to the back) → targets.
    backward : bool
        For rays that go against the light. A case is then that of the light which the ray goes against: a ray from the
        front that is transmitted meets light from the back that is.

    Attributes
    ----------
    any : bool
        Whether a surface scatters.
    """

    def __init__(
        self,
        ids: Sequence[str],
        optics: Optics,
        aims: Mapping[tuple[int, bool], AimSet],
        backward: bool = False,
    ) -> None:
        bsdfs = optics.bsdfs
        self.any = any(bsdf.scatter for bsdf in bsdfs)
        self.backward = backward
        if not self.any:
            return
        count = len(bsdfs)
        # By side: first row of the totals of transmission and reflection, aimed rays of either, the first of them with
        # the random rays above; by case: first lobe, lobes, first target, targets
        sides = np.zeros((count * 2, 4), dtype=np.uint32)
        cases = np.zeros((count * CASES, 4), dtype=np.uint32)
        transmission_rows = np.zeros(count * 2, dtype=np.uint32)  # by side, that of its own light
        total_rows: list[np.ndarray] = [np.zeros((2, 4))]  # for cases without scatter
        lobe_rows: list[np.ndarray] = []
        ratios: list[np.ndarray] = []
        aim_sets: list[AimSet] = []
        targets = 0
        radial: dict[int, int] = {}
        self._tables: list[RadialTable] = []
        self.flags = 0
        self.most_lobes = 0
        node = 2
        for s, bsdf in enumerate(bsdfs):
            if not bsdf.scatter:
                continue
            found = self._sides_of(ids, optics, s)
            for side, from_front in enumerate((True, False)):
                sides[2 * s + side, 2] = bsdf.scatter_rays << RANDOM_RAYS_SHIFT
                for case, event in enumerate(EVENT_NAMES):
                    light = found[1 - side if backward and event == "transmission" else side]
                    members = [k for k, lobe in enumerate(light.lobes) if lobe.event == event]
                    if not members:
                        continue
                    sides[2 * s + side, case] = node
                    row = cases[s * CASES + 2 * side + case]
                    row[:2] = len(lobe_rows), len(members)
                    total_rows.append(light.rows[event])
                    if event == "transmission":
                        transmission_rows[2 * s + (1 - side if backward else side)] = node
                    node += ANGLES + 1
                    for k in members:
                        lobe, table = light.lobes[k], light.tables[k]
                        if id(table) not in radial:
                            radial[id(table)] = len(self._tables)
                            self._tables.append(table)
                        flags, place = _flags(lobe, ratios)
                        self.flags |= flags
                        r_min = lobe.ratio.r_min if lobe.ratio is not None else 1.0
                        numbers = [*lobe.shares, table.total, min(lobe.oblique_limit, 1e30), np.log2(r_min)]
                        words = np.array([flags | radial[id(table)] << TABLE_SHIFT, place], dtype=np.uint32)
                        lobe_rows.append(np.concatenate([np.array(numbers, dtype=np.float32).view(np.uint32), words]))
                    self.most_lobes = max(self.most_lobes, len(members))
                    aim = aims.get((s, from_front == (event == "transmission")))
                    if aim is not None:
                        row[2:] = targets, len(aim.targets)
                        sides[2 * s + side, 2 + case] += aim.rays
                        aim_sets.append(aim)
                        targets += len(aim.targets)
        self.aimed = bool(aim_sets)
        self.sides, self.cases = upload(mi.UInt32, sides), upload(mi.UInt32, cases)
        self.transmission_rows = mi.UInt32(transmission_rows)
        self.totals = upload(mi.Float, np.concatenate(total_rows))
        self.lobes = upload(mi.UInt32, np.array(lobe_rows if lobe_rows else [np.zeros(8, dtype=np.uint32)]))
        self.ratios = upload(mi.Float, np.concatenate(ratios) if ratios else np.zeros(1))
        self.targets = DeviceTargets(aim_sets)
        self.radial = RadialSampler(self._tables)
        dr.eval(self.sides, self.cases, self.transmission_rows, self.totals, self.lobes, self.ratios)

    @staticmethod
    def _sides_of(ids: Sequence[str], optics: Optics, s: int) -> list[Side]:
        """What a surface makes of light from the front and from the back, checked."""
        found = []
        for from_front in (True, False):
            n_in, n_out = optics.host_indices[s, :2] if from_front else optics.host_indices[s, 1::-1]
            models = tuple(optics.bsdfs[s].scatter)
            side = side_of(models, optics.wavelength_nm, float(n_in), float(n_out), from_front)
            if optics.host_words[s] & OPAQUE:
                side = side.without_transmission()
            if side.lobes:
                title = f"surface '{ids[s]}', light from the {'front' if from_front else 'back'}"
                check_side(title, side, n_in, n_out, partial(optics.shares, s, from_front))
            found.append(side)
        return found


def _flags(lobe: Lobe, ratios: list[np.ndarray]) -> tuple[int, int]:
    """Flags of a lobe, and the place of its ratio table, which is appended to the others behind its three sizes."""
    flags = BY_ANGLE if lobe.measure == "angle" else 0
    flags |= {"specular": 0, "retro": RETRO, "normal": NORMAL}[lobe.centre]
    flags |= {"none": 0, "ghs": GHS, "rayleigh_rice": RAYLEIGH_RICE, "edge": EDGE}[lobe.factor]
    if lobe.ratio is None:
        return flags, 0
    place = sum(map(len, ratios))
    ratios += [np.array(lobe.ratio.values.shape, dtype=np.float64), lobe.ratio.values.ravel()]
    return flags | RATIO | (BY_COSINES if lobe.ratio.axes == "cosines" else 0), place


def check_side(
    title: str, side: Side, n_in: float, n_out: float, response: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
) -> None:
    """Raise if a surface gives away more light than it gets."""
    cos_i = np.linspace(0.0, 1.0, ANGLES + 1)
    rarer = np.minimum(cos_i, specular_cosine("transmission", cos_i, n_in, n_out))
    reflectance, transmittance = response(cos_i)
    rows = {
        event: np.array([np.interp(x, cos_i, column) for column in side.rows[event].T])
        for event, x in (("reflection", cos_i), ("transmission", rarer))
    }
    sums = Totals({event: row[0] for event, row in rows.items()}, {event: row[1:] for event, row in rows.items()})
    check_budget(title, sums, cos_i, reflectance, transmittance)

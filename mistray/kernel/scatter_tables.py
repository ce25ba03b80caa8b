"""
Scatter of all surfaces, packed for the kernel: lobes, targets, and totals over the angle of incidence.

A *case* is light from one side of a surface that is scattered in one event (transmission or reflection). Its index is
4 s + 2 side + event. Each case has a list of lobes, a list of targets, and a table over the angle of incidence. The
table holds the loss of the specular beam, and the scattered flux as the terms of a polynomial in R or T.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.bulk_scattering import BulkScattering
from mistray.kernel.device_targets import DeviceTargets
from mistray.kernel.lobes import RadialSampler, multilinear
from mistray.kernel.sample_axes import SurfaceFrames
from mistray.kernel.targets import AimSet, Place
from mistray.scatter.lobe import Lobe, LobeModel, RatioTable
from mistray.scatter.particulate import particle_indices
from mistray.scatter.radial import RadialTable
from mistray.scatter.total import Totals, check_budget, model_lobes, specular_cosine, totals
from mistray.surfaces.optics import OPAQUE, Optics
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

EVENT_NAMES = ("transmission", "reflection")  # in the order of the cases
CASES = 4  # number of cases of a surface
ANGLES = 256  # intervals of the tables of totals, uniform in the cosine
# Flags of a lobe; the number of its radial table is in the bits above them
BY_ANGLE, RETRO, NORMAL, GHS, RAYLEIGH_RICE, EDGE, COSINE, RATIO, BY_COSINES, ANGULAR, TURNED, FROM_X = (
    1 << bit for bit in range(12)
)
FACTOR_FLAGS = {"ghs": GHS, "rayleigh_rice": RAYLEIGH_RICE, "cosine": COSINE, "edge": EDGE}
TABLE_SHIFT = 12
LOBE_FLOATS = 6
# Head of a ratio table: numbers of nodes along its three axes and 0, or along the first axis, the rotation and the last
# two; then the first rotation of the sample, in turns
RATIO_HEAD = 5
NO_TOTALS = 2  # rows of zeros before the totals, for cases without scatter
TURNED_ANGLES = 64  # intervals of the totals of anisotropic lobes, which are interpolated to `ANGLES`
RANDOM_RAYS_SHIFT = 16
MOST_CHECKED = 1024
_checked: set[Hashable] = set()  # scatter, coating and media of surfaces that gain no light, by an earlier trace


@dataclass(frozen=True)
class Member:
    """
    Scatter lobe of one surface, side of incidence and event, with its plugin and radial profile.

    Attributes
    ----------
    plugin : Scatterer
        Plugin of the lobe.
    number : int
        Index of the lobe among those of the plugin's model for light from this side.
    lobe : Lobe
        Part of the BSDF with one peak.
    table : RadialTable
        Radial profile of the lobe.
    """

    plugin: Any
    number: int
    lobe: Lobe
    table: RadialTable


@dataclass(frozen=True)
class Side:
    """
    Scatter of light that comes from one side of a surface: lobes, radial profiles, and total scatter by angle.

    Attributes
    ----------
    lobes : tuple of Lobe
        Lobes of all models and events.
    tables : tuple of RadialTable
        Radial profile of each lobe.
    rows : dict
        Totals by event, (turns, ANGLES + 1, 4), over rotation of the sample and angle of incidence: specular loss, and
        three terms of the scattered flux.
    models : tuple of int
        Index of the model of each lobe.
    """

    lobes: tuple[Lobe, ...]
    tables: tuple[RadialTable, ...]
    # Event → (turns, ANGLES + 1, 4): loss, and three terms of the scattered flux, at uniform rotations of the sample,
    # the last of which is the first again; a single one for isotropic scatter
    rows: dict[str, np.ndarray]
    models: tuple[int, ...] = ()  # number of the model of each lobe

    def members(self, plugins: Sequence[Any], event: str) -> tuple[Member, ...]:
        """Return the scatter lobes of one event, transmission or reflection, with the plugins they come from."""
        lobes = enumerate(zip(self.lobes, self.tables, self.models, strict=True))
        return tuple(
            Member(plugins[model], k - self.models.index(model), lobe, table)
            for k, (lobe, table, model) in lobes
            if lobe.event == event
        )

    def without_transmission(self) -> Side:
        """Return a copy without the lobes of transmitted light, for an opaque surface."""
        kept = [k for k, lobe in enumerate(self.lobes) if lobe.event == "reflection"]
        return Side(
            tuple(self.lobes[k] for k in kept),
            tuple(self.tables[k] for k in kept),
            {**self.rows, "transmission": np.zeros((1, ANGLES + 1, 4))},
            tuple(self.models[k] for k in kept),
        )


def side_of(models: tuple[LobeModel, ...], wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> Side:
    """
    Return the scatter lobes and total scatter of models for light from one side of a surface, cached.

    `n_in` and `n_out` are the real refractive indices on the side that the light comes from and on the other side.
    """
    key = models, particle_indices(models, wavelength_nm), wavelength_nm, n_in, n_out, from_front
    return _known_side(*key) or _recent_side(*key)


@lru_cache(maxsize=1024)
def _known_side(*key: Any) -> Side | None:
    """Return the result of `side_of`; None if it has ratio tables, of megabytes, that change with its models."""
    side = _recent_side(*key)
    return side if all(lobe.fixed for lobe in side.lobes) else None


@lru_cache(maxsize=64)
def _recent_side(
    models: tuple[LobeModel, ...],
    _particles: tuple[complex, ...],
    wavelength_nm: float,
    n_in: float,
    n_out: float,
    from_front: bool,
) -> Side:
    """Return the result of `side_of`, of which the last few are kept."""
    return make_side(models, wavelength_nm, n_in, n_out, from_front)


def make_side(models: tuple[LobeModel, ...], wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> Side:
    """
    Return the lobes of scatter models, and their total integrated scatter by angle of incidence; see `side_of`.

    Nodes are uniform in cos θi for reflection. For transmission they are uniform in the cosine in the rarer medium;
    light in the denser one has the cosine of the direction that is refracted to it.
    """
    own = [model_lobes([model], wavelength_nm, n_in, n_out, from_front) for model in models]
    lobes = tuple(lobe for part in own for lobe in part)
    tables = tuple(RadialTable.of(lobe.profile, lobe.r_max) for lobe in lobes)
    rows = {}
    for event in EVENT_NAMES:
        here = [k for k, lobe in enumerate(lobes) if lobe.event == event]
        # Totals of isotropic lobes, on the full grid of angles
        still, turned = ([k for k in here if lobes[k].anisotropic == kind] for kind in (False, True))

        def block(numbers: list[int], nodes: int, rotation: float, event: str = event) -> np.ndarray:
            x = np.linspace(0.0, 1.0, nodes)
            cos_i = x if event == "reflection" else np.sqrt(1 - (1 - x * x) * min(n_out / n_in, 1.0) ** 2)
            chosen, radial = [lobes[k] for k in numbers], [tables[k] for k in numbers]
            sums = totals(chosen, cos_i, n_in, n_out, radial, rotation)
            return np.column_stack([sums.loss[event], *sums.terms[event]])

        rows[event] = block(still, ANGLES + 1, 0.0)[None]
        if turned:
            count = max(ratio.values.shape[1] for k in turned if (ratio := lobes[k].ratio) is not None)
            blocks = [block(turned, TURNED_ANGLES + 1, turn) for turn in np.linspace(0, 2 * np.pi, count)[:-1]]
            rows[event] = rows[event] + _finer(np.array([*blocks, blocks[0]]))
    return Side(lobes, tables, rows, tuple(number for number, part in enumerate(own) for _ in part))


def _finer(rows: np.ndarray) -> np.ndarray:
    """Return tables of total scatter interpolated to `ANGLES` steps of the cosine, (turns, ANGLES + 1, 4)."""
    places = np.linspace(0, TURNED_ANGLES, ANGLES + 1)
    low = np.minimum(places.astype(int), TURNED_ANGLES - 1)
    fraction = (places - low)[:, None]
    return np.asarray((1 - fraction) * rows[:, low] + fraction * rows[:, low + 1])


@dataclass(frozen=True)
class Case:
    """
    Scatter of light from one side of a surface in one event, transmission or reflection.

    Attributes
    ----------
    surface : int
        Index of the surface.
    from_front : bool
        Whether the light comes from the front; for transmission in a backward trace the ray comes from the other side.
    event : str
        "reflection" or "transmission".
    rows : (turns, ANGLES + 1, 4) float64
        Totals over the rotation of the sample and the angle, see `Side`.
    members : tuple of Member
        Lobes that scatter in this case.
    first_row, first_lobe : int
        Index of its first row in the table of totals, which begins with `NO_TOTALS` rows of zeros, and of its first
        member among all lobes.
    """

    surface: int
    from_front: bool
    event: str
    rows: np.ndarray
    members: tuple[Member, ...]
    first_row: int
    first_lobe: int


@dataclass(frozen=True)
class PackedLobes:
    """
    Scatter lobes of all cases concatenated into arrays.

    Attributes
    ----------
    members : list of Member
        Lobes in the order of the arrays.
    floats : (n, LOBE_FLOATS) float64
        Coefficients c0, c1 and c2, total of the radial profile, limit of 1/cos θi, and log2 of the smallest distance r
        of the ratio table, see `mistray.scatter.lobe.Lobe`.
    words : (n, 2) uint32
        Flags with the index of the radial table in `tables`, and index of the ratio table in `ratios`.
    tables : list of RadialTable
        Radial profiles, each once.
    table_numbers : list of int
        Index in `tables` of the radial table of each lobe.
    ratios : (m,) float64
        Ratio tables, each after a head of `RATIO_HEAD` values; first those that change with the models' parameters.
    moving : int
        Length of the part of `ratios` that changes with the models' parameters.
    """

    members: list[Member]
    floats: np.ndarray
    words: np.ndarray
    tables: list[RadialTable]
    table_numbers: list[int]
    ratios: np.ndarray
    moving: int


def pack(cases: Sequence[Case], by_plugin: bool = False) -> PackedLobes:
    """
    Return the scatter lobes of all cases as arrays; a table that several lobes share is stored once.

    Parameters
    ----------
    cases : sequence of Case
        Cases that scatter.
    by_plugin : bool
        Whether equal tables of two plugins are two tables, so that each has its own derivatives.
    """
    # Tables that lobes share are stored once
    members = [member for case in cases for member in case.members]
    owners = [id(member.plugin) if by_plugin else 0 for member in members]
    tables: dict[tuple[int, int], tuple[int, RadialTable]] = {}
    ratios: dict[tuple[int, int], RatioTable] = {}
    for member, owner in zip(members, owners, strict=True):
        tables.setdefault((id(member.table), owner), (len(tables), member.table))
        if member.lobe.ratio is not None:
            ratios.setdefault((id(member.lobe.ratio), owner), member.lobe.ratio)

    # Ratio tables, the fixed ones last: a gradient takes the first part alone
    places, parts, place, moving = {}, [np.zeros(0)], 0, 0
    for key, ratio in sorted(ratios.items(), key=lambda item: item[1].fixed):
        places[key] = place
        sizes = ratio.values.shape if ratio.anisotropic else (*ratio.values.shape, 0)
        parts += [np.array([*sizes, ratio.first_rotation / (2 * np.pi)]), ratio.values.ravel()]
        place += RATIO_HEAD + ratio.values.size
        moving = moving if ratio.fixed else place

    # Numbers of each lobe
    floats, words, numbers = np.zeros((len(members), LOBE_FLOATS)), np.zeros((len(members), 2), dtype=np.uint32), []
    for k, (member, owner) in enumerate(zip(members, owners, strict=True)):
        numbers.append(tables[id(member.table), owner][0])
        floats[k] = lobe_floats(member.lobe, member.table)
        words[k] = _flags(member.lobe) | numbers[-1] << TABLE_SHIFT, places.get((id(member.lobe.ratio), owner), 0)
    return PackedLobes(
        members, floats, words, [table for _, table in tables.values()], numbers, np.concatenate(parts), moving
    )


def lobe_floats(lobe: Lobe, table: RadialTable) -> np.ndarray:
    """Return a lobe's coefficients, profile total and limits, (LOBE_FLOATS,) float64, see `PackedLobes.floats`."""
    r_min = lobe.ratio.r_min if lobe.ratio is not None else 1.0
    return np.array([*lobe.shares, table.total, min(lobe.oblique_limit, 1e30), np.log2(r_min)])


def _flags(lobe: Lobe) -> int:
    """Return the flag bits of a lobe: its radius (angle or direction cosine), centre, cosine factor and ratio table."""
    flags = BY_ANGLE if lobe.measure == "angle" else 0
    flags |= {"specular": 0, "retro": RETRO, "normal": NORMAL}[lobe.centre]
    flags |= FACTOR_FLAGS.get(lobe.factor, 0)
    if lobe.ratio is None:
        return flags
    flags |= RATIO | {"radial": 0, "angular": ANGULAR, "cosines": BY_COSINES}[lobe.ratio.axes]
    if not lobe.anisotropic:
        return flags
    return flags | TURNED | (FROM_X if lobe.ratio.from_x else 0)


class ScatterTables:
    """
    Tables of the scatter of all surfaces at one wavelength, on the device.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces with their coatings and materials at a wavelength.
    aims : mapping
        Targets by place of scatter.
    backward : bool
        Whether rays are traced backward. The case of a ray is then that of the light, which propagates the other way: a
        ray from the front that is transmitted stands for light from the back that is transmitted.

    Attributes
    ----------
    any : bool
        Whether a surface scatters.
    aims : mapping
        Targets, see Parameters.
    bulk : BulkScattering or None
        Scatter in media; None: no medium scatters.
    all_cases : list of Case
        Cases that scatter, in the order of their totals and lobes.
    total_rows : int
        Number of rows of the totals.
    flags : int
        Bitwise or of the flags of all lobes; set only if a surface scatters, like the arrays on the device.

    Raises
    ------
    MistrayError
        If a surface returns more than the incident flux, or scatters anisotropically but has no sample axis.
    """

    def __init__(
        self,
        table: SurfaceTable,
        aims: Mapping[Place, AimSet],
        backward: bool = False,
    ) -> None:
        optics = table.optics
        bsdfs = optics.bsdfs
        self.backward, self.aims = backward, aims
        self.bulk = BulkScattering(table, aims) if optics.scatters else None
        self.all_cases: list[Case] = []
        count = len(bsdfs)
        # By side: first row of the totals of transmission and of reflection, numbers of aimed rays of either, the first
        # of which has the number of random rays in its upper bits; by case: first lobe, number of lobes, first target,
        # number of targets
        sides = np.zeros((count * 2, 4), dtype=np.uint32)
        cases = np.zeros((count * CASES, 4), dtype=np.uint32)
        # By side: number of rotations of the sample in the totals of transmission, of reflection, and of transmission
        # of light from this side
        turns = np.ones((count * 2, 4), dtype=np.uint32)
        transmission_rows = np.zeros(count * 2, dtype=np.uint32)  # by side, that of light from this side
        aim_sets: list[AimSet] = []
        targets = lobes = 0
        self.total_rows = NO_TOTALS
        self.most_lobes = 0
        alike: dict[tuple[Any, ...], list[Side]] = {}  # surfaces of equal scatter, coating and media share theirs
        for s, bsdf in enumerate(bsdfs):
            if not bsdf.scatter:
                continue
            media = [light_indices(optics, s, from_front) for from_front in (True, False)]
            indices, opaque = optics.complex_indices[s], optics.host_words[s] & OPAQUE
            kind = (*bsdf.scatter, bsdf.coating, *media, *indices, opaque, optics.wavelength_nm)
            if kind not in alike:
                alike[kind] = self._sides_of(table.ids, optics, s, kind)
            found = alike[kind]
            for side, from_front in enumerate((True, False)):
                sides[2 * s + side, 2] = bsdf.scatter_rays << RANDOM_RAYS_SHIFT
                for number, event in enumerate(EVENT_NAMES):
                    # The side that the light comes from: a backward ray that is transmitted leaves towards it
                    lit = 1 - side if backward and event == "transmission" else side
                    first, members = self.total_rows, found[lit].members(bsdf.scatterers, event)
                    if not members:
                        continue
                    case = Case(s, lit == 0, event, found[lit].rows[event], members, first, lobes)
                    self.total_rows += len(case.rows) * (ANGLES + 1)
                    sides[2 * s + side, number] = first
                    turns[2 * s + side, number] = len(case.rows)
                    row = cases[s * CASES + 2 * side + number]
                    row[:2] = lobes, len(case.members)
                    if event == "transmission":
                        transmission_rows[2 * s + lit] = first
                        turns[2 * s + lit, 2] = len(case.rows)
                    self.all_cases.append(case)
                    lobes += len(case.members)
                    self.most_lobes = max(self.most_lobes, len(case.members))
                    # Targets are those of the side to which the ray leaves
                    aim = aims.get((s, from_front == (event == "transmission")))
                    if aim is not None:
                        row[2:] = targets, len(aim.targets)
                        sides[2 * s + side, 2 + number] += aim.rays
                        aim_sets.append(aim)
                        targets += len(aim.targets)
        self.any = bool(self.all_cases)
        if not self.any:
            return

        # Upload
        self.aimed = bool(aim_sets)
        self.sides, self.cases = upload(mi.UInt32, sides), upload(mi.UInt32, cases)
        self.transmission_rows = upload(mi.UInt32, transmission_rows)
        self.totals = upload(
            mi.Float,
            np.concatenate([np.zeros((NO_TOTALS, 4)), *(case.rows.reshape(-1, 4) for case in self.all_cases)]),
        )
        packed = pack(self.all_cases)
        self.flags = int(np.bitwise_or.reduce(packed.words[:, 0] & ((1 << TABLE_SHIFT) - 1), initial=0))
        self._upload_lobes(packed)
        turned = {case.surface for case in self.all_cases if any(member.lobe.anisotropic for member in case.members)}
        self.frames = self._frames(table, sorted(turned)) if turned else None
        self.turns = upload(mi.UInt32, turns)
        self.targets = DeviceTargets(aim_sets, table.centre)
        self.radial = RadialSampler(packed.tables)
        dr.eval(self.sides, self.cases, self.transmission_rows, self.turns, self.totals, self.lobes, self.ratios)

    def _upload_lobes(self, packed: PackedLobes) -> None:
        bits = packed.floats.astype(np.float32).view(np.uint32)
        self.lobes = upload(mi.UInt32, np.hstack([bits, packed.words]))
        self.ratios = upload(mi.Float, packed.ratios if len(packed.ratios) else np.zeros(1))

    @staticmethod
    def _frames(table: SurfaceTable, turned: Sequence[int]) -> SurfaceFrames | None:
        """Return the sample axes of surfaces with anisotropic scatter; `turned` holds the indices of these surfaces."""
        return SurfaceFrames(table, turned)

    @staticmethod
    def _sides_of(ids: Sequence[str], optics: Optics, s: int, kind: Hashable) -> list[Side]:
        """
        Return the scatter of surface s for light from its front and from its back.

        Lobes of transmitted light are left out for an opaque surface. `kind` is equal for surfaces of equal scatter,
        coating and media, of which one is checked. Raise `MistrayError` if it returns more than the incident flux.
        """
        found, checked = [], kind in _checked
        for from_front in (True, False):
            n_in, n_out = light_indices(optics, s, from_front)
            side = side_of(tuple(optics.bsdfs[s].scatter), optics.wavelength_nm, n_in, n_out, from_front)
            if optics.host_words[s] & OPAQUE:
                side = side.without_transmission()
            if side.lobes and not checked:
                title = f"surface '{ids[s]}', light from the {'front' if from_front else 'back'}"
                check_side(title, side, n_in, n_out, partial(optics.shares, s, from_front))
            found.append(side)
        if len(_checked) == MOST_CHECKED:
            _checked.clear()
        _checked.add(kind)
        return found

    def total(self, row: mi.UInt32, active: mi.Bool) -> mi.Vector4f:
        """Return the row of total scatter: lost specular fraction, and coefficients of the scattered fraction."""
        return dr.gather(mi.Vector4f, self.totals, row, active)

    def lobe(self, row: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector4f, mi.Float, mi.Float, mi.Vector2u]:
        """Return lobe parameters: flux coefficients and profile total, limit of 1/cos θi, log2 of r_min, flag words."""
        numbers, more = (dr.gather(mi.Vector4u, self.lobes, 2 * row + k, active) for k in range(2))
        shares = mi.Vector4f(*(dr.reinterpret_array(mi.Float, v) for v in numbers))
        limit, log2_r_min = (dr.reinterpret_array(mi.Float, v) for v in more.xy)
        return shares, limit, log2_r_min, more.zw

    def ratio(self, place: mi.UInt32, places: Sequence[mi.Float], active: mi.Bool) -> mi.Float:
        """Return values of the ratio table stored at `place`, interpolated linearly along its three or four axes."""
        sizes = self._ratio_sizes(place, len(places), active)
        return multilinear(self.ratios, place + RATIO_HEAD, sizes, places, active)

    def first_rotation(self, place: mi.UInt32, active: mi.Bool) -> mi.Float:
        """Return the sample azimuth, in turns, at the first node of the anisotropic ratio table stored at `place`."""
        return dr.gather(mi.Float, self.ratios, place + RATIO_HEAD - 1, active)

    def _ratio_sizes(self, place: mi.UInt32, axes: int, active: mi.Bool) -> list[mi.UInt32]:
        """Return the number of nodes along each of the axes of the ratio table stored at `place`."""
        numbers = [dr.gather(mi.Float, self.ratios, place + k, active) for k in range(axes)]
        return [dr.maximum(mi.UInt32(number), 2) for number in numbers]


def light_indices(optics: Optics, surface: int, from_front: bool) -> tuple[float, float]:
    """
    Return the real refractive indices on the side of incidence and on the other side of a surface.

    For an opaque surface both are the index on the side of incidence. The kernel needs none there, but the lobes do:
    their wavelength is that in the medium.
    """
    if optics.host_words[surface] & OPAQUE:
        front, back = (float(n) for n in optics.host_media_n[optics.declared[surface]])
        return (front, front) if from_front else (back, back)
    front, back = (float(n) for n in optics.host_indices[surface, :2])
    return (front, back) if from_front else (back, front)


def check_side(
    title: str, side: Side, n_in: float, n_out: float, response: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
) -> None:
    """
    Raise `MistrayError` if a surface reflects, transmits and scatters more than the incident flux at any angle.

    `title` begins the message, `n_in` and `n_out` are as in `side_of`, and `response` returns R and T of the coating at
    cosines of incidence.
    """
    cos_i = np.linspace(0.0, 1.0, ANGLES + 1)
    # Rows of transmission are over the cosine in the rarer medium; here all are compared at the same cos θi
    rarer = np.minimum(cos_i, specular_cosine("transmission", cos_i, n_in, n_out))
    reflectance, transmittance = response(cos_i)
    for turn in range(max(len(rows) for rows in side.rows.values())):
        rows = {
            event: np.array(
                [np.interp(x, cos_i, column) for column in side.rows[event][turn % len(side.rows[event])].T]
            )
            for event, x in (("reflection", cos_i), ("transmission", rarer))
        }
        sums = Totals({event: row[0] for event, row in rows.items()}, {event: row[1:] for event, row in rows.items()})
        check_budget(title, sums, cos_i, reflectance, transmittance)

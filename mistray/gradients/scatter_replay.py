"""What scatter did to recorded paths, with derivatives by directions, indices, coatings and the tables of scatter.

At an event of a path the surface keeps a share of its light in the specular beam, or sends a flux per solid angle along
the direction that the path took. Their logarithms are evaluated here by the kernel's own functions. Directions are held
fixed ("detached sampling"): random numbers and sampling densities have no derivative, so they do not enter.

Derivatives by the tables' entries are wanted for each batch of start rays. An entry is read as its value plus a number
that is 0 and has a derivative: these zeros take no memory, only their derivatives do, and the values stay as the kernel
has them. `mistray.gradients.scatter_gradient` goes on from there to the values of the scatter models.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.interaction import shares_at
from mistray.kernel.lobes import STRIDE, RadialSampler, multilinear, radial_place
from mistray.kernel.scatter_shares import Shares
from mistray.kernel.scatter_tables import LOBE_FLOATS, RATIO_HEAD, PackedLobes, ScatterTables, pack
from mistray.kernel.scattering import Around, Scattering, specular_direction
from mistray.scatter.radial import RINGS, RadialTable
from mistray.settings import BATCHES

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

TOTALS, LOBES, RATIOS, LOGS = "totals", "lobes", "ratios", "logs"
TOTAL_FLOATS = 4
AZIMUTH = 2  # axis of a ratio table
ROUND = (1, 3)  # axes of an anisotropic one that go all round
EDGE_OF_PROFILE = 0.5  # change of the step of log2 f from one cell to the next that no smooth profile has

Coating = Callable[[mi.Bool, mi.Float], tuple[mi.Float, mi.Float]]


@dataclass
class ScatterEvent:
    """
    Where a path meets a surface; numbers may have derivatives, in single or double precision.

    Attributes
    ----------
    s : mi.UInt32
        Numbers of the surfaces.
    batch : mi.UInt32
        Of start rays.
    reflect : mi.Bool
        Whether the path goes on at the side that it came from.
    from_front : mi.Bool
        Whether it comes from the front.
    d : mi.Vector3f
        Unit direction of arrival.
    axis : mi.Vector3f
        Unit normal on the side that d goes to.
    cos_i, cos_t : mi.Float
        Cosines of the angles of incidence and refraction; the latter 0 in total reflection.
    eta : mi.Float
        Index on the side of incidence over the one on the other side.
    R, T : mi.Float
        Of the coating for light along d; T = 0 in total reflection.
    q : mi.Vector3f, optional
        The point in the frame of the surface, mm, in which the directions are then given; needed where scatter depends
        on how a sample is turned.
    """

    s: mi.UInt32
    batch: mi.UInt32
    reflect: mi.Bool
    from_front: mi.Bool
    d: mi.Vector3f
    axis: mi.Vector3f
    cos_i: mi.Float
    cos_t: mi.Float
    eta: mi.Float
    R: mi.Float
    T: mi.Float
    q: mi.Vector3f | None = None

    @property
    def side(self) -> mi.UInt32:
        """Number of the side of incidence."""
        return 2 * self.s + dr.select(self.from_front, mi.UInt32(0), 1)

    def where(self, active: mi.Bool) -> ScatterEvent:
        """The same with harmless numbers in lanes that do not matter, so that no NaN comes out of them."""
        up = (0, 0, 1)
        return replace(
            self,
            d=dr.select(active, self.d, type(self.d)(*up)),
            axis=dr.select(active, self.axis, type(self.axis)(*up)),
            **{key: dr.select(active, getattr(self, key), 1) for key in ("cos_i", "cos_t", "eta")},
            **{key: dr.select(active, getattr(self, key), 0.5) for key in ("R", "T")},
            q=None if self.q is None else dr.select(active, self.q, type(self.q)(1, 0, 0)),
        )


class ScatterReplay(Scattering):
    """
    Scatter of all surfaces at one wavelength, with derivatives; to be called where AD is on.

    Parameters
    ----------
    table : SurfaceTable
        Of the run.
    scattering : Scattering
        Of the run; a surface must scatter.

    Attributes
    ----------
    leaves : dict
        Name of an array → zeros whose derivatives are those by its entries, (BATCHES · size) mi.Float64.
    """

    def __init__(self, table: SurfaceTable, scattering: Scattering) -> None:
        self._table, self.any = table, True
        packed = pack(scattering.tables.all_cases, by_plugin=True)
        sizes = {name: int(np.prod(shape)) for name, shape in shapes(scattering.tables, packed).items()}
        self.leaves: dict[str, mi.Float64] = {}
        with dr.resume_grad():
            for name, size in sizes.items():
                self.leaves[name] = dr.zeros(mi.Float64, BATCHES * size)
                dr.enable_grad(self.leaves[name])
        self._tables: ReplayTables = ReplayTables(scattering.tables, packed, self.leaves, sizes)

    def derivatives(self) -> dict[str, np.ndarray]:
        """Name of an array → derivatives by its entries that have been accumulated, (BATCHES, size) float64."""
        return {name: np.array(dr.grad(leaf)).reshape(BATCHES, -1) for name, leaf in self.leaves.items()}

    def clear(self) -> None:
        """Set the derivatives to 0."""
        for leaf in self.leaves.values():
            dr.set_grad(leaf, dr.zeros(mi.Float64, dr.width(leaf)))

    def log_kept(self, event: ScatterEvent, active: mi.Bool) -> mi.Float:
        """Logarithm of the share of R or T that stays in the specular beam; 0 where not active, or where it is 0."""
        transmission, reflection, _, _ = self._all_shares(event, active)
        kept = dr.select(event.reflect, reflection.kept, transmission.kept)
        good = active & (kept > 0)
        return dr.select(good, dr.log(dr.select(good, kept, 1)), 0)

    def absorbed(self, event: ScatterEvent, active: mi.Bool) -> mi.Float:
        """Share of the light that neither event takes; of light along the ray. What a detector gets."""
        _, _, along, reflection = self._all_shares(event, active)
        event = event.where(active)
        specular = event.R * reflection.kept + event.T * along.kept
        return dr.select(active, 1 - specular - reflection.scattered - along.scattered, 0)

    def _all_shares(self, event: ScatterEvent, active: mi.Bool) -> tuple[Shares, Shares, Shares, Shares]:
        """Of transmission, of reflection, and of transmission and of reflection of light along the ray."""
        event = event.where(active)
        self._tables.batch = event.batch
        side, rarer = event.side, dr.minimum(event.cos_i, event.cos_t)
        plan = dr.gather(mi.Vector4u, self._tables.sides, side, active)
        row = dr.gather(mi.UInt32, self._tables.transmission_rows, side, active)
        turns = self._turns(event.d, event.axis, self._sample_axis(event, active), side, active)
        return (
            self._shares(plan.x, rarer, event.T, active, turns["transmission"]),
            self._shares(plan.y, event.cos_i, event.R, active, turns["reflection"]),
            self._shares(row, rarer, event.T, active, turns["along"]),
            self._shares(plan.y, event.cos_i, event.R, active, turns["back"]),
        )

    def _sample_axis(self, event: ScatterEvent, active: mi.Bool) -> mi.Vector3f | None:
        """The x axis of the sample in the frame of the surface, if scatter depends on it."""
        if self._tables.frames is None or event.q is None:
            return None
        normal = dr.select(event.from_front, event.axis, -event.axis)
        return self._tables.frames.local(event.s, normal, event.q, active)

    def log_flux(
        self, event: ScatterEvent, direction: mi.Vector3f, active: mi.Bool, coating: Coating | None = None
    ) -> mi.Float:
        """
        Logarithm of the flux that the surface sends along a direction, per solid angle and unit of incident flux.

        Against the light it is that which light that comes against `direction` sends against d, as flux per solid angle
        of `direction`, see `Scattering`.

        Parameters
        ----------
        event : ScatterEvent
        direction : mi.Vector3f
            Unit vector.
        active : mi.Bool
        coating : callable, optional
            (from_front, cosine of incidence) → R and T of the surfaces for light of that side; in total reflection
            R + T and 0. Only asked in a backward trace; by default from the tables, without derivatives by their rows.

        Returns
        -------
        mi.Float
            0 where not active, or where no light goes.
        """
        event = event.where(active)
        direction = dr.select(active, direction, type(direction)(0, 0, dr.select(event.reflect, -1, 1)))
        self._tables.batch = event.batch
        plan = dr.gather(
            mi.Vector4u, self._tables.cases, 2 * event.side + dr.select(event.reflect, mi.UInt32(1), 0), active
        )
        outward = dr.select(event.reflect, -event.axis, event.axis)
        cos_s = dr.dot(direction, outward)
        specular = specular_direction(event.reflect, event.d, event.axis, event.cos_i, event.cos_t, event.eta)
        x_axis, one = self._sample_axis(event, active), mi.Float(1)
        around = Around(event.axis, outward, specular, event.d, event.cos_i, event.eta, x_axis, one)
        if self._tables.backward:
            flux = self._coated_backward_flux(
                event, plan, around, direction, cos_s, coating or self._coating(event.s, active)
            )
        else:
            lobes = self._read_lobes(plan, dr.select(event.reflect, event.R, event.T), event.cos_i)
            flux, _, _ = self._evaluate(lobes, one, direction, cos_s, around)
        good = active & (cos_s > 0) & (flux > 0)
        return dr.select(good, dr.log(dr.select(good, flux, 1)), 0)

    def _coated_backward_flux(
        self,
        event: ScatterEvent,
        plan: mi.Vector4u,
        around: Around,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        coating: Coating,
    ) -> mi.Float:
        """As `_backward_flux`, where R and T have derivatives."""
        from_front = event.from_front ^ ~event.reflect
        R, T = coating(from_front, cos_s)
        # Of light on the side of the ray, or on the other side
        eta = dr.select(event.reflect, event.eta, dr.rcp(event.eta))
        cos_t = dr.safe_sqrt(1 - dr.square(eta) * (1 - dr.square(cos_s)))
        share = dr.select(event.reflect, R, T)
        return self._backward_flux(plan, event.reflect, around, direction, cos_s, cos_t, share)

    def _coating(self, s: mi.UInt32, active: mi.Bool) -> Coating:
        """The coatings of surfaces, from the tables of the run."""
        word = dr.gather(mi.UInt32, self._table.optics.words, s, active)
        return lambda from_front, cos_i: shares_at(self._table, s, word, from_front, mi.Float(cos_i), active)[:2]


class ReplayTables(ScatterTables):
    """
    The tables of a run, each entry with the zero of a leaf added.

    Parameters
    ----------
    tables : ScatterTables
    packed : PackedLobes
        Their lobes, by plugin.
    leaves, sizes : dict
        Name of an array → its leaf, and the size of that by batch.

    Attributes
    ----------
    batch : mi.UInt32
        Whose derivatives are meant; to be set before anything is read.
    """

    def __init__(
        self, tables: ScatterTables, packed: PackedLobes, leaves: dict[str, mi.Float64], sizes: dict[str, int]
    ) -> None:
        self.backward, self.flags, self.most_lobes = tables.backward, tables.flags, tables.most_lobes
        self.sides, self.cases, self.transmission_rows = tables.sides, tables.cases, tables.transmission_rows
        self.totals, self.turns, self.frames = tables.totals, tables.turns, tables.frames
        self._upload_lobes(packed)
        self.radial = ReplayRadial(packed.tables, partial(self._zero, LOGS))
        self.batch = mi.UInt32(0)
        self._leaves, self._sizes = leaves, {name: dr.opaque(mi.UInt32, size) for name, size in sizes.items()}

    def _zero(self, name: str, index: mi.UInt32, active: mi.Bool) -> mi.Float:
        """The zero of an entry."""
        return mi.Float(dr.gather(mi.Float64, self._leaves[name], self.batch * self._sizes[name] + index, active))

    def total(self, row: mi.UInt32, active: mi.Bool) -> mi.Vector4f:
        """As in `ScatterTables`."""
        zeros = mi.Vector4f(*(self._zero(TOTALS, TOTAL_FLOATS * row + k, active) for k in range(TOTAL_FLOATS)))
        return super().total(row, active) + zeros

    def lobe(self, row: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector4f, mi.Float, mi.Float, mi.Vector2u]:
        """As in `ScatterTables`."""
        shares, limit, log2_r_min, words = super().lobe(row, active)
        zeros = [self._zero(LOBES, LOBE_FLOATS * row + k, active) for k in range(LOBE_FLOATS)]
        return shares + mi.Vector4f(*zeros[:4]), limit + zeros[4], log2_r_min + zeros[5], words

    def ratio(self, place: mi.UInt32, places: Sequence[mi.Float], active: mi.Bool) -> mi.Float:
        """As in `ScatterTables`; derivatives along the axes are differences over a cell about the place."""
        sizes, held = self._ratio_sizes(place, len(places), active), [dr.detach(at) for at in places]
        turned = len(places) > 3

        def at(values: mi.Float, first: mi.UInt32, where: Sequence[mi.Float], lit: mi.Bool) -> mi.Float:
            return mi.Float(multilinear(values, first + RATIO_HEAD, sizes, where, lit))

        value = at(self.ratios, place, held, active)
        for axis, (moved, still) in enumerate(zip(places, held, strict=True)):
            half = 0.5 / (mi.Float(sizes[axis]) - 1)
            low, high = dr.maximum(still - half, 0), dr.minimum(still + half, 1)
            mirrored, round_ = axis == AZIMUTH and not turned, axis in ROUND and turned
            if mirrored:  # tables are the same on both sides of the plane of incidence
                low, high = dr.abs(still - half), 1 - dr.abs(1 - still - half)
            if round_:
                low, high = (end - dr.floor(end) for end in (still - half, still + half))
            ends = [at(self.ratios, place, [*held[:axis], end, *held[axis + 1 :]], active) for end in (low, high)]
            width = 2 * half if mirrored or round_ else high - low
            value = value + (ends[1] - ends[0]) / width * (moved - still)
        if RATIOS not in self._leaves:
            return value
        size = self._sizes[RATIOS]
        return value + at(self._leaves[RATIOS], self.batch * size + place, held, active & (place < size))


class ReplayRadial(RadialSampler):
    """
    Radial tables; the logarithm at a node has the zero of a leaf, by the place of the node, added.

    The derivative by the radius is not that of the straight lines between the nodes, which jumps, but that of parabolas
    through neighbours: the profile's own to 1e-4.
    """

    def __init__(self, tables: Sequence[RadialTable], zero: Callable[[mi.UInt32, mi.Bool], mi.Float]) -> None:
        super().__init__(tables)
        self._zero = zero

    def value(self, table: mi.UInt32, r2: mi.Float, active: mi.Bool) -> mi.Float:
        """As in `RadialSampler`."""
        place = radial_place(r2)
        held = dr.detach(place)
        node = mi.UInt32(held)
        fraction, first = held - mi.Float(node), table * STRIDE
        before, _ = self._pair(table, dr.maximum(node, 1) - 1, active)
        low, high = self._pair(table, node, active)
        _, after = self._pair(table, dr.minimum(node, RINGS - 1) + 1, active)
        own = high - low
        # Not across the edge of a profile
        sides = [dr.select(dr.abs(side - own) < EDGE_OF_PROFILE, side, own) for side in (low - before, after - high)]
        slope = 0.5 * (own + dr.lerp(*sides, fraction))
        low, high = low + self._zero(first + node, active), high + self._zero(first + node + 1, active)
        return dr.exp2(dr.lerp(low, high, fraction) + slope * (place - held))


def shapes(tables: ScatterTables, packed: PackedLobes) -> dict[str, tuple[int, ...]]:
    """Name of an array → shape of the entries that have derivatives; those of ratios are of the moving ones."""
    found: dict[str, tuple[int, ...]] = {
        TOTALS: (tables.total_rows, TOTAL_FLOATS),
        LOBES: packed.floats.shape,
        LOGS: (len(packed.tables), STRIDE),
    }
    return found | ({RATIOS: (packed.moving,)} if packed.moving else {})

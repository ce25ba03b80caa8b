"""
Flux factors of scatter along recorded paths, differentiable with respect to indices, coatings and scatter tables.

At an event of a path the surface keeps a fraction of the light in the specular beam, or scatters a flux per solid angle
into the next direction. Their logarithms are evaluated here by the kernel's own functions. Directions are held
("detached sampling"): random numbers and sampling pdfs have no derivative, so they do not enter.

Derivatives with respect to the entries of the tables are kept for each batch of start rays. An entry is read as its
value plus a zero that has a derivative: only the derivatives of these zeros take memory, and the values stay as the
kernel has them. `mistray.gradients.scatter_gradient` continues from there to the parameters of the scatter models.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.lobes import STRIDE, RadialSampler, multilinear, radial_place
from mistray.kernel.scatter_shares import Shares
from mistray.kernel.scatter_tables import LOBE_FLOATS, RATIO_HEAD, ScatterTables, pack
from mistray.kernel.scattering import LobeFrame, Scattering, specular_direction
from mistray.scatter.radial import RINGS, RadialTable
from mistray.settings import BATCHES

TOTALS, LOBES, RATIOS, LOGS = "totals", "lobes", "ratios", "logs"
TOTAL_FLOATS = 4
AZIMUTH = 2  # axis of a ratio table
ROUND = (1, 3)  # periodic axes of an anisotropic one
EDGE_OF_PROFILE = 0.5  # change of the step of log2 f between cells, above which the profile has an edge there

Coating = Callable[[mi.Bool, mi.Float], tuple[mi.Float, mi.Float]]


@dataclass
class ScatterEvent:
    """
    Hits of recorded paths on surfaces, as input of scatter models; its values may carry derivatives.

    Attributes
    ----------
    s : mi.UInt32
        Indices of the surfaces.
    batch : mi.UInt32
        Batches of the start rays.
    reflect : mi.Bool
        Whether the path continues on the side of incidence.
    from_front : mi.Bool
        Whether the path arrives from the front.
    d : mi.Vector3f
        Unit direction of arrival.
    axis : mi.Vector3f
        Unit normal on the side of transmission.
    cos_i, cos_t : mi.Float
        Cosines of the angles of incidence and refraction; the latter 0 in total reflection.
    eta : mi.Float
        Index on the side of incidence over the one on the other side.
    R, T : mi.Float
        Reflectance and transmittance of the coating for light along d; T = 0 in total reflection.
    coating : callable
        (from_front, cosine of incidence) → R and T of the surfaces for light of that side; in total reflection R + T
        and 0. It is only called in a backward trace.
    q : mi.Vector3f, optional
        Point in the frame of the surface, mm; the directions are then in this frame, too. It is needed where scatter
        depends on the orientation of a sample.
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
    coating: Coating
    q: mi.Vector3f | None = None

    @property
    def side(self) -> mi.UInt32:
        """Index of the side of incidence among the sides of all surfaces: 2s in front, 2s + 1 behind."""
        return 2 * self.s + dr.select(self.from_front, mi.UInt32(0), 1)

    def where(self, active: mi.Bool) -> ScatterEvent:
        """Return the event with valid dummy values in inactive lanes, so that these produce no NaN."""
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
    Scatter of all surfaces at one wavelength, differentiable; call its methods with automatic differentiation enabled.

    Parameters
    ----------
    scattering : Scattering
        Scatter of the run; at least one surface must scatter.

    Attributes
    ----------
    any : bool
        True: a surface scatters.
    tables : ReplayTables
        Tables of the run, whose entries carry derivatives.
    """

    def __init__(self, scattering: Scattering) -> None:
        self.any = True
        self.tables: ReplayTables = ReplayTables(scattering.tables)

    def derivatives(self) -> dict[str, np.ndarray]:
        """Return the accumulated derivatives with respect to scatter-table entries, (BATCHES, size) by array name."""
        return {name: np.array(dr.grad(leaf)).reshape(BATCHES, -1) for name, leaf in self.tables.leaves.items()}

    def log_kept(self, event: ScatterEvent, active: mi.Bool) -> mi.Float:
        """
        Return the natural logarithm of the fraction of R or T that stays in the specular beam.

        The result is 0 if the lane is inactive or nothing stays.
        """
        transmission, reflection, _, _ = self._all_shares(event, active)
        kept = dr.select(event.reflect, reflection.kept, transmission.kept)
        good = active & (kept > 0)
        return dr.select(good, dr.log(dr.select(good, kept, 1)), 0)

    def absorbed(self, event: ScatterEvent, active: mi.Bool) -> mi.Float:
        """
        Return the fraction of the flux along the ray that a surface absorbs, as a detector does.

        It is 1 less the specular beams and the scattered light of reflection and transmission.
        """
        _, _, along, reflection = self._all_shares(event, active)
        event = event.where(active)
        specular = event.R * reflection.kept + event.T * along.kept
        return dr.select(active, 1 - specular - reflection.scattered - along.scattered, 0)

    def _all_shares(self, event: ScatterEvent, active: mi.Bool) -> tuple[Shares, Shares, Shares, Shares]:
        """
        Return the specular and scattered fractions of R and T at an event.

        Returns
        -------
        transmission, reflection, along, back : Shares
            The first two for the light of the path, forward or backward; the others for light along the ray.
        """
        event = event.where(active)
        self.tables.batch = event.batch
        # Cosine in the rarer material: the variable of the rows of transmission
        side, rarer = event.side, dr.minimum(event.cos_i, event.cos_t)
        plan = dr.gather(mi.Vector4u, self.tables.sides, side, active)
        row = dr.gather(mi.UInt32, self.tables.transmission_rows, side, active)
        turns = self._turns(event.d, event.axis, self._sample_axis(event, active), side, active)
        return (
            self._shares(plan.x, rarer, event.T, active, turns["transmission"]),
            self._shares(plan.y, event.cos_i, event.R, active, turns["reflection"]),
            self._shares(row, rarer, event.T, active, turns["along"]),
            self._shares(plan.y, event.cos_i, event.R, active, turns["back"]),
        )

    def _sample_axis(self, event: ScatterEvent, active: mi.Bool) -> mi.Vector3f | None:
        """
        Return the sample's x axis at each hit, in the surface's frame; None if it is not needed.

        That is if no scatter is anisotropic, or if the event has no position `q`.
        """
        if self.tables.frames is None or event.q is None:
            return None
        normal = dr.select(event.from_front, event.axis, -event.axis)
        return self.tables.frames.local(event.s, normal, event.q, active)

    def log_flux(self, event: ScatterEvent, direction: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """
        Return the natural logarithm of the flux scattered into a direction, per sr and unit of incident flux.

        In a backward trace it is the flux that forward light along -`direction` scatters into -d, as flux per solid
        angle of `direction`, see `Scattering`.

        Parameters
        ----------
        event : ScatterEvent
            Hits with scattering surfaces.
        direction : mi.Vector3f
            Unit direction of the scattered ray, in the frame of the event's directions.
        active : mi.Bool
            Lanes that are evaluated.

        Returns
        -------
        mi.Float
            Logarithm; 0 if inactive, or if no light is scattered there.
        """
        event = event.where(active)
        direction = dr.select(active, direction, type(direction)(0, 0, dr.select(event.reflect, -1, 1)))
        self.tables.batch = event.batch
        plan = dr.gather(
            mi.Vector4u, self.tables.cases, 2 * event.side + dr.select(event.reflect, mi.UInt32(1), 0), active
        )
        # Local shading frame of the lobes
        outward = dr.select(event.reflect, -event.axis, event.axis)
        cos_s = dr.dot(direction, outward)
        specular = specular_direction(event.reflect, event.d, event.axis, event.cos_i, event.cos_t, event.eta)
        x_axis, one = self._sample_axis(event, active), mi.Float(1)
        frame = LobeFrame(event.axis, outward, specular, event.d, event.cos_i, event.eta, x_axis, one)
        # BSDF: that of the forward light in a backward trace
        if self.tables.backward:
            # R and T of the forward light, which arrives along -`direction`, on the ray's side or on the other one
            R, T = event.coating(event.from_front ^ ~event.reflect, cos_s)
            eta = dr.select(event.reflect, event.eta, dr.rcp(event.eta))
            cos_t = dr.safe_sqrt(1 - dr.square(eta) * (1 - dr.square(cos_s)))
            share = dr.select(event.reflect, R, T)
            flux = self._backward_flux(plan, event.reflect, frame, direction, cos_s, cos_t, share)
        else:
            lobes = self._read_lobes(plan, dr.select(event.reflect, event.R, event.T), event.cos_i)
            flux, _, _ = self._evaluate(lobes, one, direction, cos_s, frame)
        good = active & (cos_s > 0) & (flux > 0)
        return dr.select(good, dr.log(dr.select(good, flux, 1)), 0)


class ReplayTables(ScatterTables):
    """
    Scatter tables of a run whose entries carry derivatives, by a zero with a gradient added to each entry.

    Parameters
    ----------
    tables : ScatterTables
        Tables of the run.

    Attributes
    ----------
    radial : ReplayRadial
        Radial tables of the lobes.
    leaves : dict
        Name of an array → zeros that hold the derivatives with respect to its entries, (BATCHES · size) mi.Float64. Of
        the ratio tables, only entries that parameters change have such zeros.
    sizes : dict
        Name of an array → number of its entries that have derivatives.
    packed : PackedLobes
        Lobes of the tables, by plugin.
    batch : mi.UInt32
        Batch to which derivatives are added; to be set before anything is read.
    """

    def __init__(self, tables: ScatterTables) -> None:
        vars(self).update(vars(tables))
        self.packed = packed = pack(tables.all_cases, by_plugin=True)
        self._upload_lobes(packed)
        self.radial = ReplayRadial(packed.tables, partial(self._zero, LOGS))
        self.batch = mi.UInt32(0)
        sizes = {TOTALS: tables.total_rows * TOTAL_FLOATS, LOBES: packed.floats.size, LOGS: len(packed.tables) * STRIDE}
        sizes |= {RATIOS: packed.moving} if packed.moving else {}
        self.sizes, self._sizes = sizes, {name: dr.opaque(mi.UInt32, size) for name, size in sizes.items()}
        with dr.resume_grad():
            # Literal zeros take no memory, and no time to read
            self.leaves = {name: dr.zeros(mi.Float64, BATCHES * size) for name, size in sizes.items()}
            dr.enable_grad(self.leaves)

    def _zero(self, name: str, index: mi.UInt32, active: mi.Bool) -> mi.Float:
        """
        Return a zero that carries the derivative with respect to an entry of an array, for the present batch.

        `name` is the array and `index` the entry.
        """
        return mi.Float(dr.gather(mi.Float64, self.leaves[name], self.batch * self._sizes[name] + index, active))

    def total(self, row: mi.UInt32, active: mi.Bool) -> mi.Vector4f:
        """Return rows of total scatter, as `ScatterTables.total` does, with derivatives with respect to the entries."""
        zeros = mi.Vector4f(*(self._zero(TOTALS, TOTAL_FLOATS * row + k, active) for k in range(TOTAL_FLOATS)))
        return super().total(row, active) + zeros

    def lobe(self, row: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector4f, mi.Float, mi.Float, mi.Vector2u]:
        """
        Return lobe parameters and flag words, as `ScatterTables.lobe` does.

        The parameters carry derivatives with respect to the entries of the tables.
        """
        shares, limit, log2_r_min, words = super().lobe(row, active)
        zeros = [self._zero(LOBES, LOBE_FLOATS * row + k, active) for k in range(LOBE_FLOATS)]
        return shares + mi.Vector4f(*zeros[:4]), limit + zeros[4], log2_r_min + zeros[5], words

    def ratio(self, place: mi.UInt32, places: Sequence[mi.Float], active: mi.Bool) -> mi.Float:
        """
        Return a ratio table's interpolated value at `places`, with derivatives with respect to them and to the entries.

        `place` is the index of the table's head in the array of all, `places` are coordinates along its axes, 0 … 1.
        Derivatives along the axes are differences over one cell about the place, one-sided at the ends of an axis that
        is neither periodic nor mirrored. Only tables that parameters change have derivatives with respect to entries.
        """
        sizes, held = self._ratio_sizes(place, len(places), active), [dr.detach(at) for at in places]
        turned = len(places) > 3

        def at(values: mi.Float, first: mi.UInt32, where: Sequence[mi.Float], lit: mi.Bool) -> mi.Float:
            return mi.Float(multilinear(values, first + RATIO_HEAD, sizes, where, lit))

        value = at(self.ratios, place, held, active)
        # Slope along each axis, from two reads of the table
        for axis, (moved, still) in enumerate(zip(places, held, strict=True)):
            half = 0.5 / (mi.Float(sizes[axis]) - 1)
            low, high = dr.maximum(still - half, 0), dr.minimum(still + half, 1)
            mirrored, round_ = axis == AZIMUTH and not turned, axis in ROUND and turned
            if mirrored:  # tables are symmetric about the plane of incidence
                low, high = dr.abs(still - half), 1 - dr.abs(1 - still - half)
            if round_:
                low, high = (end - dr.floor(end) for end in (still - half, still + half))
            ends = [at(self.ratios, place, [*held[:axis], end, *held[axis + 1 :]], active) for end in (low, high)]
            width = 2 * half if mirrored or round_ else high - low
            value = value + (ends[1] - ends[0]) / width * (moved - still)
        # Derivatives by the entries
        if RATIOS not in self.leaves:
            return value
        size = self._sizes[RATIOS]
        return value + at(self.leaves[RATIOS], self.batch * size + place, held, active & (place < size))


class ReplayRadial(RadialSampler):
    """
    Radial tables of scatter lobes whose logarithm carries a derivative at each node.

    The slope of linear interpolation jumps at the nodes. The derivative with respect to the radius is therefore that of
    parabolas through neighbouring nodes, which is the profile's own to 1e-4.
    """

    def __init__(self, tables: Sequence[RadialTable], zero: Callable[[mi.UInt32, mi.Bool], mi.Float]) -> None:
        super().__init__(tables)
        self._zero = zero

    def value(self, table: mi.UInt32, r2: mi.Float, active: mi.Bool) -> mi.Float:
        """
        Return the value f of radial table `table`, 1/sr, at the squared distance r2, see `RadialSampler.value`.

        It carries derivatives with respect to the distance and to the entries of the table.
        """
        place = radial_place(r2)
        held = dr.detach(place)
        node = mi.UInt32(held)
        fraction, first = held - mi.Float(node), table * STRIDE
        before, _ = self._pair(table, dr.maximum(node, 1) - 1, active)
        low, high = self._pair(table, node, active)
        _, after = self._pair(table, dr.minimum(node, RINGS - 1) + 1, active)
        own = high - low
        # Beyond the edge of a profile the slope of the cell itself replaces that of its neighbour
        sides = [dr.select(dr.abs(side - own) < EDGE_OF_PROFILE, side, own) for side in (low - before, after - high)]
        slope = 0.5 * (own + dr.lerp(*sides, fraction))
        low, high = low + self._zero(first + node, active), high + self._zero(first + node + 1, active)
        return dr.exp2(dr.lerp(low, high, fraction) + slope * (place - held))

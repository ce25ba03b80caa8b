"""The lobes of one surface for stock integrators: value, density and choice of directions in both transport modes.

Light comes from the direction i (towards its origin) and is scattered into s. In the mode "importance" i is Mitsuba's
wi and s its wo; in the mode "radiance", where paths start at the eye, it is the other way round. That the same function
serves both makes them adjoint: what `path` renders is what light does, also for models that are not reciprocal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.scatter_gradient import quotient
from mistray.kernel.lobes import RadialSampler, multilinear
from mistray.kernel.scatter_tables import ANGLES, Side, check_side, side_of
from mistray.kernel.scattering import fraction_of
from mistray.plugins.bsdfs.lobe_pair import Pair, Slot, cosine, factor
from mistray.plugins.bsdfs.sample_axis import SampleFrame
from mistray.scatter import Lobe
from mistray.scatter.lobe import EVENTS
from mistray.scatter.radial import RadialTable
from mistray.surfaces.upload import upload

STEP = 1e-3  # relative, of a parameter, for differences of tables in single precision
SMALLEST_SHARE = 0.1  # of R and T, when directions are chosen before the light's angle is known
ONE_LESS = 1 - 2.0**-24  # the largest float32 below 1


@dataclass
class Choice:
    """A direction, its component of `interface`, whether a lobe was chosen, and whether its direction is possible."""

    wo: mi.Vector3f
    component: mi.UInt32
    chosen: mi.Bool
    valid: mi.Bool


class LobeSum:
    """
    All lobes of a surface at one wavelength.

    Parameters
    ----------
    plugins : sequence of Scatterer
    wavelength_nm : float
    n : tuple of float
        Indices in front and behind.
    opaque : bool
        Nothing is transmitted.
    response : callable
        (from_front, (m,) cosines of incidence) → R and T of the coating, (m,) each.
    title : str
        Of the surface, for messages.
    """

    def __init__(
        self,
        plugins: Sequence[Any],
        wavelength_nm: float,
        n: tuple[float, float],
        opaque: bool,
        response: Callable[[bool, np.ndarray], tuple[np.ndarray, np.ndarray]],
        title: str,
    ) -> None:
        self.title, self._response = title, response
        self.plugins, self.wavelength_nm, self.opaque = tuple(plugins), wavelength_nm, opaque
        self.n = n
        self.models = [plugin.model for plugin in plugins]
        tables: list[RadialTable] = []
        self.slots = self._pair_sides(tables)
        self.sampler = RadialSampler(tables) if tables else None
        self._ratios = {
            id(lobe.ratio): upload(mi.Float, lobe.ratio.values.ravel())
            for slot in self.slots
            for lobe in slot.lobes
            if lobe is not None and lobe.ratio is not None
        }

    def _arguments(self, from_front: bool) -> tuple[float, float, float, bool]:
        """Of `Scatter.lobes`."""
        return (self.wavelength_nm, *(self.n if from_front else self.n[::-1]), from_front)

    def _lobes(self, model: Any, from_front: bool) -> tuple[Lobe, ...]:
        """Lobes of a model for light of one side."""
        found: tuple[Lobe, ...] = model.lobes(*self._arguments(from_front))
        return found

    def _side(self, models: Sequence[Any], from_front: bool) -> Side:
        """The same of several with what they take from the specular beams, which takes time to compute."""
        side = side_of(tuple(models), *self._arguments(from_front))
        return side.without_transmission() if self.opaque else side

    def _pair_sides(self, tables: list[RadialTable]) -> list[Slot]:
        """The lobes of both sides, paired where they are alike, and their tables."""
        found: dict[tuple[Any, ...], list[tuple[Lobe | None, int, int]]] = {}
        for k, model in enumerate(self.models):
            for side, from_front in enumerate((True, False)):
                for number, lobe in enumerate(self._lobes(model, from_front)):
                    if self.opaque and lobe.event == "transmission":
                        continue
                    key = (k, number, lobe.event, lobe.measure, lobe.centre, lobe.factor, lobe.ratio is None)
                    entry = found.setdefault(key, [(None, 0, 0), (None, 0, 0)])
                    entry[side] = lobe, number, len(tables)
                    tables.append(RadialTable.of(lobe.profile, lobe.r_max))
        slots = []
        for key, both in found.items():
            (front, a, i), (back, b, j) = both
            sums = tuple(0.0 if lobe is None else tables[t].total for lobe, _, t in both)
            slots.append(Slot(self.plugins[key[0]], (front, back), (a, b), (i, j), (sums[0], sums[1])))
        return slots

    # -- the specular beams --------------------------------------------------------------------------------------

    @cached_property
    def _losses(self) -> mi.Float:
        """What all models together take from the specular beams, after a check of the surface's budget."""
        for from_front in (True, False):
            where = f"{self.title}, light from the {'front' if from_front else 'back'}"
            n_in, n_out = self.n if from_front else self.n[::-1]
            check_side(where, self._side(self.models, from_front), n_in, n_out, partial(self._response, from_front))
        return upload(mi.Float, self._loss_table(self.models).ravel())

    def _loss_table(self, models: Sequence[Any]) -> np.ndarray:
        """Share that the specular beams lose: (rotation, event, side of incidence, nodes of the cosine of `loss`)."""
        rows = [
            [self._side(models, from_front).rows[event][..., 0] for from_front in (True, False)] for event in EVENTS
        ]
        turns = max(len(part) for both in rows for part in both)
        even = [[np.broadcast_to(part, (turns, ANGLES + 1)) for part in both] for both in rows]
        return np.moveaxis(np.array(even), 2, 0)

    def loss(
        self, event: str, cosine: mi.Float, from_back: mi.Bool, active: mi.Bool, rotation: mi.Float | None = None
    ) -> mi.Float:
        """
        Share that the reflected or refracted beam loses, differentiable by the parameters of the models.

        Parameters
        ----------
        event : {"reflection", "transmission"}
        cosine : mi.Float
            Of the angle of incidence; for transmission, of the angle in the rarer material.
        from_back : mi.Bool
            Whether the light comes from the back.
        active : mi.Bool
        rotation : mi.Float, optional
            Of the sample, in turns, where a lobe is anisotropic.
        """
        place = dr.clip(cosine, 0, 1) * ANGLES
        node = dr.minimum(mi.UInt32(place), ANGLES - 1)
        first = (2 * EVENTS.index(event) + dr.select(from_back, mi.UInt32(1), mi.UInt32(0))) * (ANGLES + 1)

        def at(table: mi.Float) -> mi.Float:
            block = 2 * len(EVENTS) * (ANGLES + 1)
            turns = dr.width(table) // block

            def of(number: Any) -> mi.Float:
                where = number * block + first + node
                low, high = (dr.gather(mi.Float, table, where + step, active) for step in range(2))
                return dr.lerp(low, high, place - mi.Float(node))

            if turns == 1 or rotation is None:
                return of(0)
            turn = fraction_of(rotation) * (turns - 1)
            before = dr.minimum(mi.UInt32(turn), turns - 2)
            return dr.lerp(of(before), of(before + 1), turn - mi.Float(before))

        value = at(self._losses)
        for plugin in self.plugins:
            for name, parameter in plugin.values.items():
                if dr.grad_enabled(parameter):
                    slope = sum(weight * self._loss_table([model]) for weight, model in quotient(plugin, name, STEP))
                    value += at(upload(mi.Float, slope.ravel())) * (parameter - dr.detach(parameter))
        return value

    # -- the lobes -----------------------------------------------------------------------------------------------

    def _pair(self, mode: Any, wi: mi.Vector3f, wo: mi.Vector3f, sample: SampleFrame | None = None) -> Pair:
        light, seen = (wo, wi) if mode == mi.TransportMode.Radiance else (wi, wo)
        n_front, n_back = (mi.Float(n) for n in self.n)
        from_back = light.z > 0
        return Pair(light, seen, dr.select(from_back, n_back, n_front), dr.select(from_back, n_front, n_back), sample)

    def value(
        self,
        ctx: mi.BSDFContext,
        wi: mi.Vector3f,
        wo: mi.Vector3f,
        shares: tuple[mi.Float, mi.Float],
        active: mi.Bool,
        sample: SampleFrame | None = None,
    ) -> mi.Float:
        """
        BSDF times the cosine of wo, without the specular beams.

        Parameters
        ----------
        ctx : mi.BSDFContext
        wi, wo : mi.Vector3f
            Local frame.
        shares : tuple of mi.Float
            R and T of the coating where the light comes in: at wo in the mode "radiance", at wi in the other.
        active : mi.Bool
        sample : SampleFrame, optional
            Needed where a lobe is anisotropic.
        """
        pair = self._pair(ctx.mode, wi, wo, sample)
        radiance = ctx.mode == mi.TransportMode.Radiance
        cos_o = pair.cos_i if radiance else pair.cos_s
        over_cos_s = cos_o / pair.cos_s if radiance else mi.Float(1)  # flux per solid angle is the BSDF times cos θs
        for plugin in self.plugins:
            silent = not any(slot.plugin is plugin for slot in self.slots)
            if silent and any(map(dr.grad_enabled, plugin.values.values())):
                raise MistrayError(f"{plugin.title}: it scatters nothing here, so it has no derivative; start above 0")
        result = mi.Float(0)
        for slot, (lit, x) in self._enabled(ctx, pair, shares):
            lobe = slot.lobe
            lit &= active
            if lobe.event == "transmission" and lobe.centre != "normal":
                lit &= pair.refracted().z != 0
            f = self._profile(slot, pair, lit) * slot.coefficient(x, pair.from_back)
            if lobe.measure == "angle":
                f *= slot.oblique(pair.cos_i, pair.from_back) * over_cos_s * factor(lobe, pair)
            else:
                f *= cos_o * factor(lobe, pair) * self._ratio(slot, pair, lit)
            result += dr.select(lit, f, 0)
        return result

    def _enabled(
        self, ctx: mi.BSDFContext, pair: Pair, shares: tuple[mi.Float, mi.Float]
    ) -> list[tuple[Slot, tuple[mi.Bool, mi.Float]]]:
        """The lobes that a context asks for, where they reach s, with their R or T."""
        where = {"reflection": (pair.reflected, shares[0]), "transmission": (pair.i.z * pair.s.z < 0, shares[1])}
        return [(slot, where[slot.lobe.event]) for slot in self.slots if enabled(ctx, slot.lobe.event)]

    def _profile(self, slot: Slot, pair: Pair, active: mi.Bool) -> mi.Float:
        """f(r) in closed form where there is one, else from the table; differentiable."""
        r2 = pair.r2(slot.lobe)
        known = slot.plugin.profile(slot.lobe, dr.sqrt(r2), pair, self.wavelength_nm)
        if known is not None:
            return known
        value = self._density(slot, r2, pair.from_back, active)
        for name, parameter in slot.plugin.values.items():
            if dr.grad_enabled(parameter):
                slope = self._table_slope(slot, name, r2, pair.from_back, active)
                value += slope * (parameter - dr.detach(parameter))
        return value

    def _table_slope(self, slot: Slot, name: str, r2: mi.Float, from_back: mi.Bool, active: mi.Bool) -> mi.Float:
        """Derivative of f(r) of a table by a parameter of the model."""
        models = quotient(slot.plugin, name, STEP)
        tables = []
        for _, model in models:
            for number, lobe, from_front in zip(slot.numbers, slot.lobes, (True, False), strict=True):
                there = self._lobes(model, from_front)[number] if lobe is not None else slot.lobe
                tables.append(RadialTable.of(there.profile, there.r_max))
        sampler, side = RadialSampler(tables), dr.select(from_back, mi.UInt32(1), mi.UInt32(0))
        values = (sampler.value(side + 2 * k, r2, active) for k in range(len(models)))
        return sum((weight * value for (weight, _), value in zip(models, values, strict=True)), mi.Float(0))

    def _density(self, slot: Slot, r2: mi.Float, from_back: mi.Bool, active: mi.Bool) -> mi.Float:
        """f(r) of the table."""
        assert self.sampler is not None
        return self.sampler.value(slot.table(from_back), r2, active)

    def _ratio(self, slot: Slot, pair: Pair, active: mi.Bool) -> mi.Float:
        """The lobe's ratio in closed form where there is one, else from its table."""
        both = [None if lobe is None else lobe.ratio for lobe in slot.lobes]
        if both[0] is None and both[1] is None:
            return mi.Float(1)
        known = slot.plugin.ratio(slot.lobe, dr.sqrt(pair.r2(slot.lobe)), pair, self.wavelength_nm)
        if known is not None:
            return known
        if both[0] is both[1] and both[0] is not None:
            return self._tabled(both[0], slot.lobe, pair, active)
        values = [None if ratio is None else self._tabled(ratio, slot.lobe, pair, active) for ratio in both]
        front, back = (mi.Float(0) if value is None else value for value in values)
        return dr.select(pair.from_back, back, front)

    def _tabled(self, ratio: Any, lobe: Lobe, pair: Pair, active: mi.Bool) -> mi.Float:
        specular = pair.centre(Lobe(lobe.event, lobe.profile))
        first = dr.clip(dr.abs(specular.z), 0, 1)
        if ratio.axes == "angular":
            first = dr.acos(first) * (2 / np.pi)
        if ratio.axes != "cosines":
            side = (pair.s - pair.centre(lobe)).xy
            second = dr.log(dr.maximum(dr.norm(side), ratio.r_min) / ratio.r_min) / float(np.log(2 / ratio.r_min))
        else:
            side, second = pair.s.xy, pair.cos_s
        if ratio.anisotropic:
            assert pair.sample is not None
            tangent, beside, rotation = pair.sample.plane(specular.xy, pair.i.z)
            azimuth = dr.atan2(dr.dot(side, beside), dr.dot(side, tangent)) * (0.5 / np.pi)
            azimuth = fraction_of(azimuth - rotation if ratio.from_x else azimuth)
            turn = fraction_of(rotation - ratio.first_rotation / (2 * np.pi))
            turned = first, turn, dr.clip(second, 0, 1), azimuth
            return multilinear(self._ratios[id(ratio)], 0, ratio.values.shape, turned, active)
        long = dr.norm(specular.xy) * dr.norm(side)
        cosine = dr.select(long > 0, dr.dot(side, specular.xy) / dr.select(long > 0, long, 1), 1)
        places = first, dr.clip(second, 0, 1), dr.safe_acos(cosine) / np.pi
        return multilinear(self._ratios[id(ratio)], 0, ratio.values.shape, places, active)

    # -- choosing directions -------------------------------------------------------------------------------------

    def weights(
        self, ctx: mi.BSDFContext, wi: mi.Vector3f, shares: tuple[mi.Float, mi.Float]
    ) -> list[tuple[Slot, mi.Float]]:
        """
        The lobes that a context asks for and about how much they scatter.

        Parameters
        ----------
        shares : tuple of mi.Float
            R and T of the coating at wi.
        """
        radiance = ctx.mode == mi.TransportMode.Radiance
        cos_i = dr.abs(wi.z)
        found = []
        for slot in self.slots:
            event = slot.lobe.event
            if not enabled(ctx, event):
                continue
            from_back = wi.z < 0 if radiance and event == "transmission" else wi.z > 0
            x = shares[EVENTS.index(event)]
            if radiance:
                x = dr.maximum(x, SMALLEST_SHARE)
            amount = slot.coefficient(x, from_back) * slot.total(from_back) * slot.oblique(cos_i, from_back)
            found.append((slot, dr.detach(amount)))
        return found

    def density(
        self,
        ctx: mi.BSDFContext,
        wi: mi.Vector3f,
        wo: mi.Vector3f,
        weights: Sequence[tuple[Slot, mi.Float]],
        active: mi.Bool,
    ) -> mi.Float:
        """Sum of the lobes' densities of wo, per solid angle, each times its weight."""
        pair = self._pair(ctx.mode, wi, wo)
        radiance = ctx.mode == mi.TransportMode.Radiance
        cos_o = pair.cos_i if radiance else pair.cos_s
        result = mi.Float(0)
        for slot, weight in weights:
            lobe = slot.lobe
            through = lobe.event == "transmission"
            lit = active & (pair.i.z * pair.s.z < 0 if through else pair.reflected) & (weight > 0)
            if radiance and lobe.centre == "normal":
                pdf = cos_o / np.pi
            else:
                pdf = self._density(slot, pair.r2(lobe), pair.from_back, lit)
                pdf /= dr.maximum(slot.total(pair.from_back), 1e-37)
                if lobe.measure == "cosines":
                    pdf *= cos_o
                if through and lobe.centre == "specular":
                    cos_c = dr.abs(pair.refracted().z)
                    lit &= cos_c > 0
                    if radiance:  # the table is about directions on the other side
                        pdf *= dr.square(pair.eta)
                        if lobe.measure == "angle":
                            pdf *= cos_o / dr.select(cos_c > 0, cos_c, 1)
            result += dr.select(lit, weight * pdf, 0)
        return dr.detach(result)

    def choose(
        self,
        ctx: mi.BSDFContext,
        wi: mi.Vector3f,
        probabilities: Sequence[tuple[Slot, mi.Float]],
        u: mi.Float,
        v: mi.Point2f,
        active: mi.Bool,
    ) -> tuple[Choice, mi.Float]:
        """
        Choose a lobe and a direction in it.

        Parameters
        ----------
        probabilities : sequence of (Slot, mi.Float)
            Of each lobe; their sum may be less than 1.
        u, v : mi.Float, mi.Point2f
            Uniform random numbers.

        Returns
        -------
        choice : Choice
        rest : mi.Float
            u less the sum of the probabilities, where no lobe is chosen.
        """
        assert self.sampler is not None
        radiance = ctx.mode == mi.TransportMode.Radiance
        picks = []
        chosen, table, inner = mi.Bool(False), mi.UInt32(0), mi.Float(0)
        for slot, p in probabilities:
            mine = active & ~chosen & (u < p)
            through = radiance and slot.lobe.event == "transmission"
            table = dr.select(mine, slot.table(wi.z < 0 if through else wi.z > 0), table)
            inner = dr.select(mine, u / dr.select(mine, p, 1), inner)
            chosen |= mine
            u = dr.select(chosen, u, u - p)
            picks.append((slot, mine))
        r = self.sampler.sample(table, v.x, dr.minimum(inner, ONE_LESS), chosen)
        sin_phi, cos_phi = dr.sincos(2 * np.pi * v.y)
        choice = Choice(mi.Vector3f(0, 0, 1), mi.UInt32(0), chosen, mi.Bool(False))
        for slot, mine in picks:
            radius = dr.sqrt(v.x) if radiance and slot.lobe.centre == "normal" else r
            wo, valid = self._direction(radiance, wi, slot.lobe, radius, sin_phi, cos_phi)
            choice.wo = dr.select(mine, wo, choice.wo)
            choice.valid |= mine & valid
            choice.component = dr.select(mine, 2 + EVENTS.index(slot.lobe.event), choice.component)
        return choice, u

    def _direction(
        self, radiance: bool, wi: mi.Vector3f, lobe: Lobe, r: mi.Float, sin_phi: mi.Float, cos_phi: mi.Float
    ) -> tuple[mi.Vector3f, mi.Bool]:
        """The direction wo at a radius and an azimuth of a lobe, and whether it is one that light can have."""
        through = lobe.event == "transmission"
        here, other = (dr.select(wi.z > 0, mi.Float(b), mi.Float(a)) for a, b in (self.n, self.n[::-1]))
        pair = Pair(wi, wi, here, other)  # light along wi; only its specular direction is requested
        if lobe.measure == "angle":
            centre = wi if radiance and through else pair.centre(lobe)
            sin_a, cos_a = r * dr.safe_sqrt(1 - 0.25 * r * r), 1 - 0.5 * r * r
            wo = mi.Frame3f(centre).to_world(mi.Vector3f(sin_a * cos_phi, sin_a * sin_phi, cos_a))
            if through and radiance:  # light comes from where it is refracted into this direction
                origin = Pair(wo, wo, here, other).refracted()
                return origin, (wo.z * wi.z > 0) & (origin.z != 0)
            return wo, (wo.z * wi.z < 0) & (centre.z != 0) if through else wo.z * wi.z > 0
        if radiance and through and lobe.centre == "specular":
            r = r * (here / other)  # the radius is one on the other side
        centre = pair.centre(lobe)
        x, y = dr.fma(r, cos_phi, centre.x), dr.fma(r, sin_phi, centre.y)
        z = cosine(x, y)
        return mi.Vector3f(x, y, dr.mulsign(z, -wi.z if through else wi.z)), z > 0


def enabled(ctx: mi.BSDFContext, event: str) -> bool:
    """Whether a context asks for the scatter of an event; the components are those of `interface`."""
    if event == "reflection":
        return bool(ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 2))
    return bool(ctx.is_enabled(mi.BSDFFlags.GlossyTransmission, 3))

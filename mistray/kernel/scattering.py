"""How the kernel scatters a ray.

A scattered ray is drawn either at random, a lobe by its flux and a direction by its profile, or towards a target, by
its share and uniformly over its area. All rays of a hit together are weighted with the balance heuristic of E. Veach
(Robust Monte Carlo methods for light transport simulation, 1997, section 9.2): a direction that several techniques
could have given counts f/Σ n_i p_i, so that the sum is unbiased whatever the targets are.

Rays that go backwards (see `mistray.execute.backward`) are drawn alike, about the reflected or refracted
direction of the ray, and weighted with the BSDF of the light that they go against: surfaces need not be reciprocal. In
transmission lobes are as wide in optical direction cosines n sin θ as they are for the light, as those of a reciprocal
surface are (E. Veach, 1997, section 5.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray.kernel.interaction import Interaction, shares_at
from mistray.kernel.sample_axes import NO_TANGENT, fraction_of, plane_of_sample
from mistray.kernel.scatter_shares import Rivalry, ScatterBudget, ScatteredRay, Shares, Turn
from mistray.kernel.scatter_tables import (
    ANGLES,
    ANGULAR,
    BY_ANGLE,
    BY_COSINES,
    COSINE,
    EDGE,
    FROM_X,
    GHS,
    NORMAL,
    RANDOM_RAYS_SHIFT,
    RATIO,
    RAYLEIGH_RICE,
    RETRO,
    TABLE_SHIFT,
    TURNED,
    ScatterTables,
)
from mistray.physics.diffraction import obliquity
from mistray.scatter.radial import R_MAX

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

NO_AZIMUTH = 1e-16  # product of the squared lengths of two directions' tangential parts
ONE_LESS = 1 - 2.0**-23  # a cosine whose angle still has a finite derivative
ANYWHERE = 0.1  # share of the rays of a lobe by angle that go against refraction anywhere


@dataclass
class Around:
    """
    What the lobes of a hit are about.

    Attributes
    ----------
    axis : mi.Vector3f
        The normal on the side that the light goes to without reflection.
    outward, specular, d : mi.Vector3f
        The normal on the side that rays are sent to, the specular direction and the one of arrival.
    cos_i, eta : mi.Float
        Cosine of incidence, and the index there over the one behind.
    x_axis : mi.Vector3f or None
        The x axis of a sample that is not the same in all azimuths.
    scale : mi.Float
        By which random rays are spread wider.
    """

    axis: mi.Vector3f
    outward: mi.Vector3f
    specular: mi.Vector3f
    d: mi.Vector3f
    cos_i: mi.Float
    eta: mi.Float
    x_axis: mi.Vector3f | None
    scale: mi.Float


class Scattering:
    """
    Scatter of all surfaces at one wavelength.

    Parameters
    ----------
    tables : ScatterTables

    Attributes
    ----------
    any : bool
        Whether a surface scatters.
    bulk : BulkScattering or None
        Scatter in media, if any scatters.
    """

    def __init__(self, tables: ScatterTables) -> None:
        self._tables = tables
        self.any, self.bulk = tables.any, tables.bulk

    @property
    def tables(self) -> ScatterTables:
        """What it reads."""
        return self._tables

    @property
    def arrays(self) -> list[Any]:
        """What the kernel reads of the models of the surfaces; targets, which change no result, are not among it."""
        tables = self._tables
        if not tables.any:
            return []
        frames = [tables.frames.rows] if tables.frames is not None else []
        return [tables.totals, tables.lobes, tables.ratios, *tables.radial.arrays, *frames]

    def give(self, s: mi.UInt32, it: Interaction, active: mi.Bool) -> ScatterBudget:
        """What the surfaces s scatter of the light that meets them."""
        side = 2 * s + dr.select(it.from_front, mi.UInt32(0), 1)
        plan = dr.gather(mi.Vector4u, self._tables.sides, side, active)
        rarer = dr.minimum(it.cos_i, it.cos_t)
        turns = self._turns(it.reflected, it.axis, self._x_axis(s, it, active), side, active)
        transmission = self._shares(plan.x, rarer, self._transmittance(it), active, turns["transmission"])
        reflection = self._shares(plan.y, it.cos_i, it.R, active, turns["reflection"])
        along, back = transmission, reflection
        if self._tables.backward:
            row = dr.gather(mi.UInt32, self._tables.transmission_rows, side, active)
            along = self._shares(row, rarer, it.T, active, turns["along"])
            if turns["back"] is not None:
                back = self._shares(plan.y, it.cos_i, it.R, active, turns["back"])
        absorbed = 1 - it.R * back.kept - it.T * along.kept - back.scattered - along.scattered
        aimed_t = dr.select(transmission.scattered > 0, plan.z & ((1 << RANDOM_RAYS_SHIFT) - 1), 0)
        aimed_r = dr.select(reflection.scattered > 0, plan.w, 0)
        scattered = transmission.scattered + reflection.scattered
        random_rays = plan.z >> RANDOM_RAYS_SHIFT
        return ScatterBudget(transmission, reflection, scattered, absorbed, 2 * side, aimed_t, aimed_r, random_rays)

    def _transmittance(self, it: Interaction) -> mi.Float:
        """T; in a backward trace not 0 in total reflection, since light can be scattered into such directions."""
        return dr.select(it.tir, 1, it.T) if self._tables.backward else it.T

    def _x_axis(self, s: mi.UInt32, it: Interaction, active: mi.Bool) -> mi.Vector3f | None:
        """The x axis of the sample, if there is one whose scatter depends on it."""
        if self._tables.frames is None:
            return None
        return self._tables.frames.at(s, dr.select(it.from_front, it.axis, -it.axis), it.local, active)

    def _turns(
        self, heading: mi.Vector3f, axis: mi.Vector3f, x_axis: mi.Vector3f | None, side: mi.UInt32, active: mi.Bool
    ) -> dict[str, Turn | None]:
        """
        How the sample lies for light that the rays stand for in transmission and reflection, and for light along them.

        Parameters
        ----------
        heading : mi.Vector3f
            Of a ray before or after its reflection.
        axis : mi.Vector3f
            The normal on the side that the ray goes to.
        x_axis : mi.Vector3f or None
            Of the sample; None: all lie alike.
        side : mi.UInt32
        active : mi.Bool
        """
        if x_axis is None:
            return dict.fromkeys(("transmission", "reflection", "along", "back"))
        _, _, along = plane_of_sample(heading - dr.dot(heading, axis) * axis, -axis, x_axis)
        counts = dr.gather(mi.Vector4u, self._tables.turns, side, active)
        # Light that a ray goes against comes from where it is reflected or refracted to: the axis seen from there
        backward = self._tables.backward
        return {
            "transmission": Turn(0.5 - along if backward else along, counts.x),
            "reflection": Turn(along + 0.5 if backward else along, counts.y),
            "along": Turn(along, counts.z),
            "back": Turn(along, counts.y),
        }

    def _shares(
        self, first: mi.UInt32, cosine: mi.Float, x: mi.Float, active: mi.Bool, turn: Turn | None = None
    ) -> Shares:
        """Totals of a case, whose table starts at a row, at a cosine; the coating's R or T is x."""
        here = active & (first != 0)
        place = dr.select(here, cosine * ANGLES, 0)
        node = dr.minimum(mi.UInt32(place), ANGLES - 1)

        def at(start: mi.UInt32) -> mi.Vector4f:
            low, high = (self._tables.total(start + node + k, here) for k in range(2))
            return dr.lerp(low, high, place - mi.Float(node))

        if turn is None:
            row = at(first)
        else:
            block = fraction_of(turn.rotation) * mi.Float(turn.count - 1)
            before = dr.minimum(mi.UInt32(block), dr.maximum(turn.count, 2) - 2)
            after = dr.minimum(before + 1, turn.count - 1)
            low, high = (at(first + number * (ANGLES + 1)) for number in (before, after))
            row = dr.lerp(low, high, block - mi.Float(before))
        scattered = dr.fma(x, dr.fma(x, row.w, row.z), row.y)
        return Shares(
            1 - dr.select(here, dr.minimum(row.x, 1), 0),
            dr.select(here, scattered, 0),
            dr.select(here, dr.fma(2 * x, row.w, row.z), 0),
        )

    # More than 8 parameters: the node, the ray and the state of a conditional block, which takes loose arrays
    def scatter(
        self,
        table: SurfaceTable,
        s: mi.UInt32,
        given: ScatterBudget,
        choose: Callable[[mi.PCG32], ScatteredRay],
        it: Interaction,
        d: mi.Vector3f,
        otherwise: mi.Vector3f,
        rng: mi.PCG32,
        active: mi.Bool,
        opposite: Scattering | None = None,
        connects: bool = False,
    ) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Bool, mi.Bool, mi.PCG32, Rivalry]:
        """
        Draw a scattered ray.

        Parameters
        ----------
        table : SurfaceTable
        s : mi.UInt32
            Numbers of the surfaces.
        given : ScatterBudget
        choose : callable
            Says which of the node's rays it is.
        it : Interaction
        d : mi.Vector3f
            Direction of arrival.
        otherwise : mi.Vector3f
            Direction where not active.
        rng : mi.PCG32
        active : mi.Bool
        opposite : Scattering, optional
            Of a trace in the other direction.
        connects : bool
            Whether rays may be connected to light.

        Returns
        -------
        direction : mi.Vector3f
        weight : mi.Float
            Flux of the ray per unit of incident flux; 0 if its direction goes into the surface.
        slope : mi.Float
            d ln(weight) / d(R or T).
        reflect, aim : mi.Bool
            Whether it stays on the side of incidence, and whether it goes to a target.
        rng : mi.PCG32
        rivalry : Rivalry
            What the ray knows of those of the other direction.
        """

        def draw(rng: mi.PCG32, otherwise: mi.Vector3f) -> tuple[Any, ...]:
            rng = mi.PCG32(rng)
            ray = choose(rng)
            *drawn, odds, against = self._draw(table, s, given, ray, it, d, otherwise, rng, opposite)
            known = [] if opposite is None else [odds, against]
            if connects:
                assert ray.joint is not None
                known.append(dr.select(ray.joins, ray.joint.word, 0))
            return *drawn, ray.reflect, ray.aim, rng, *known

        def leave(rng: mi.PCG32, otherwise: mi.Vector3f) -> tuple[Any, ...]:
            stay = mi.Vector3f(otherwise), mi.Float(0), mi.Float(0), mi.Bool(False), mi.Bool(False), rng
            known = [] if opposite is None else [mi.Float(1), mi.Float(0)]
            return *stay, *known, *([mi.UInt32(0)] if connects else [])

        # Few lanes scatter at a time: packets of lanes without one skip all this
        result: tuple[Any, ...] = dr.if_stmt((rng, otherwise), active, draw, leave, mode="symbolic", label="scatter")
        return *result[:6], Rivalry(*result[6:])

    # More than 8 parameters: those of `scatter`
    def _draw(
        self,
        table: SurfaceTable,
        s: mi.UInt32,
        given: ScatterBudget,
        ray: ScatteredRay,
        it: Interaction,
        d: mi.Vector3f,
        otherwise: mi.Vector3f,
        rng: mi.PCG32,
        opposite: Scattering | None,
    ) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Float, mi.Float]:
        """Direction, weight, slope of `scatter`, odds and density of `Rivalry`."""
        case = given.first_case + dr.select(ray.reflect, mi.UInt32(1), 0)
        x = dr.select(ray.reflect, it.R, self._transmittance(it))
        scale = dr.select(ray.reflect, 1, it.eta) if self._tables.backward else mi.Float(1)
        outward = dr.select(ray.reflect, -it.axis, it.axis)
        specular = dr.select(ray.reflect, it.reflected, it.transmitted)
        u = [rng.next_float32() for _ in range(4)]
        plan = dr.gather(mi.Vector4u, self._tables.cases, case)
        lobes = self._read_lobes(plan, x, it.cos_i)
        total = sum((lobe["flux"] for lobe in lobes), mi.Float(0))
        x_axis = self._x_axis(s, it, mi.Bool(True))
        around = Around(it.axis, outward, specular, d, it.cos_i, it.eta, x_axis, scale)
        direction = self._random(lobes, total, u, around)
        own = mi.UInt32(0)
        if self._tables.aimed:
            aimed, own = self._tables.targets.sample(plan.zw, u, it.p, specular, ray.aim)
            direction = dr.select(ray.aim, aimed, direction)
        if ray.joint is not None:
            direction = dr.select(ray.joins, ray.joint.direction, direction)
        cos_s = dr.dot(direction, outward)
        flux, slope, density = self._evaluate(lobes, total, direction, cos_s, around)
        if self._tables.backward:
            from_front = it.from_front ^ ~ray.reflect
            R, T, cos_t = shares_at(table, s, it.word, from_front, cos_s, mi.Bool(True))
            share = dr.select(ray.reflect, R, T)
            flux = self._backward_flux(plan, ray.reflect, around, direction, cos_s, cos_t, share)
        techniques, expected = ray.random_rays * density, density
        if self._tables.aimed:
            aimed_rays = ray.aimed_rays if opposite is None else self._aimed_rays(case)
            targets = self._tables.targets
            at_targets = targets.density(plan.zw, it.p, direction, specular, ray.aim, own, aimed_rays > 0)
            techniques += ray.aimed_rays * at_targets
            expected = density + aimed_rays * at_targets
        if ray.joint is not None:
            techniques = dr.select(ray.joins, expected / ray.joint.factor, techniques)
        weight = flux / techniques
        good = (cos_s > 0) & (flux > 0) & dr.isfinite(weight)
        odds, against = mi.Float(1), expected
        if opposite is not None:
            other = opposite.density_against(table, s, it, ray.reflect, d, direction, cos_s, x_axis)
            # Per étendue n² cos θ dω dA, which is the same before and behind mirrors and lenses
            odds = other / expected * (cos_s / it.cos_i) * dr.select(ray.reflect, 1, dr.rcp(dr.square(it.eta)))
            odds = dr.select(good & dr.isfinite(odds), odds, 0)
            against = expected if self._tables.backward else other
        return (
            dr.select(good, direction, otherwise),
            dr.select(good, weight, 0),
            dr.select(good, slope / flux, 0),
            odds,
            against,
        )

    def _aimed_rays(self, case: mi.UInt32) -> mi.Float:
        """Rays of a case that are aimed, wherever there is light to be scattered."""
        side = dr.gather(mi.Vector4u, self._tables.sides, case >> 1, True)
        return mi.Float(dr.select((case & 1) != 0, side.w, side.z & ((1 << RANDOM_RAYS_SHIFT) - 1)))

    def density_against(
        self,
        table: SurfaceTable,
        s: mi.UInt32,
        it: Interaction,
        reflect: mi.Bool,
        d: mi.Vector3f,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        x_axis: mi.Vector3f | None,
    ) -> mi.Float:
        """
        Rays per sr that this trace, which goes the other way, sends along -d where a ray arrives along `-direction`.

        One is drawn at random; chances that a hit scatters at all are left out.
        """
        from_front = it.from_front ^ ~reflect
        R, T, cos_t = shares_at(table, s, it.word, from_front, cos_s, mi.Bool(True))
        if self._tables.backward:
            T = dr.select(cos_t > 0, T, 1)
        eta = dr.select(reflect, it.eta, dr.rcp(it.eta))
        incident, outward = -direction, -it.axis
        axis = dr.select(reflect, it.axis, outward)
        specular = specular_direction(reflect, incident, axis, cos_s, cos_t, eta)
        case = 4 * s + dr.select(from_front, mi.UInt32(0), 2) + dr.select(reflect, mi.UInt32(1), 0)
        plan = dr.gather(mi.Vector4u, self._tables.cases, case)
        lobes = self._passing_lobes(plan, reflect, dr.select(reflect, R, T), cos_s, cos_t)
        total = sum((lobe["flux"] for lobe in lobes), mi.Float(0))
        scale = dr.select(reflect, 1, eta) if self._tables.backward else mi.Float(1)
        around = Around(axis, outward, specular, incident, cos_s, eta, x_axis, scale)
        _, _, density = self._evaluate(lobes, total, -d, it.cos_i, around)
        if not self._tables.aimed:
            return density
        rays, targets = self._aimed_rays(case), self._tables.targets
        return density + rays * targets.density(plan.zw, it.p, -d, specular, mi.Bool(False), mi.UInt32(0), rays > 0)

    def _backward_flux(
        self,
        plan: mi.Vector4u,
        reflect: mi.Bool,
        around: Around,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        cos_t: mi.Float,
        x: mi.Float,
    ) -> mi.Float:
        """
        What light that comes against `direction` sends against d, as flux per solid angle of `direction`.

        `cos_t` is the light's own cosine of refraction, x the coating's R or T for it. With the étendue
        dG = n² cos θ dω dA of either direction the flux per étendue is the same whether one follows the light or goes
        against it; the change from dG to dω gives the factor n_i² cos θ_i/(n_o² cos θ_o).
        """
        incident, outward, eta = -direction, -around.axis, dr.rcp(around.eta)
        specular = specular_direction(reflect, incident, dr.select(reflect, around.axis, outward), cos_s, cos_t, eta)
        lobes = self._passing_lobes(plan, reflect, x, cos_s, cos_t)
        one = mi.Float(1)
        light = Around(outward, outward, specular, incident, cos_s, eta, around.x_axis, one)
        flux, _, _ = self._evaluate(lobes, one, -around.d, around.cos_i, light)
        return flux * cos_s / around.cos_i * dr.select(reflect, 1, dr.square(eta))

    def _passing_lobes(
        self, plan: mi.Vector4u, reflect: mi.Bool, x: mi.Float, cos_i: mi.Float, cos_t: mi.Float
    ) -> list[dict[str, Any]]:
        """The lobes of light that comes against a ray: in total reflection only those about the normal pass on."""
        lobes = self._read_lobes(plan, x, cos_i)
        passes = reflect | (cos_t > 0)
        for lobe in lobes:
            lobe["here"] = lobe["here"] & (passes | ((lobe["words"].x & NORMAL) != 0))
        return lobes

    def _read_lobes(self, plan: mi.Vector4u, x: mi.Float, cos_i: mi.Float) -> list[dict[str, Any]]:
        """The lobes of a case and the flux of each over all directions."""
        lobes = []
        for j in range(self._tables.most_lobes):
            here = plan.y > j
            row = plan.x + j
            shares, limit, log2_r_min, words = self._tables.lobe(row, here)
            coefficient = dr.fma(x, dr.fma(x, shares.z, shares.y), shares.x)
            if self._tables.flags & BY_ANGLE:
                oblique = dr.minimum(dr.rcp(cos_i), limit)
                coefficient = dr.select((words.x & BY_ANGLE) != 0, oblique, 1) * coefficient
            flux = dr.select(here, coefficient * shares.w, 0)
            slope = dr.fma(2 * x, shares.z, shares.y) / dr.fma(x, dr.fma(x, shares.z, shares.y), shares.x)
            lobes.append(
                {
                    "here": here,
                    "words": words,
                    "coefficient": coefficient,
                    "flux": flux,
                    "total": dr.select(here, shares.w, 1),
                    "slope": dr.select(dr.isfinite(slope), slope, 0),
                    "log2_r_min": log2_r_min,
                }
            )
        return lobes

    def _centre(self, words: mi.Vector2u, around: Around) -> mi.Vector3f:
        """Unit vector at the centre of a lobe."""
        centre = around.specular
        if self._tables.flags & RETRO:
            centre = dr.select((words.x & RETRO) != 0, -around.d, centre)
        if self._tables.flags & NORMAL:
            centre = dr.select((words.x & NORMAL) != 0, around.outward, centre)
        return centre

    def _random(
        self,
        lobes: list[dict[str, Any]],
        total: mi.Float,
        u: list[mi.Float],
        around: Around,
    ) -> mi.Vector3f:
        """A direction at random: a lobe by its flux, then its profile."""
        outward, scale = around.outward, around.scale
        chosen, wanted, so_far = lobes[0]["words"], u[0] * total, lobes[0]["flux"]
        for lobe in lobes[1:]:
            later = lobe["here"] & (wanted >= so_far) & (lobe["flux"] > 0)
            chosen = dr.select(later, lobe["words"], chosen)
            so_far = so_far + lobe["flux"]  # not +=, which would change the first lobe's flux
        r = self._tables.radial.sample(chosen.x >> TABLE_SHIFT, u[1], u[3], mi.Bool(True)) * scale
        if self._tables.backward and self._tables.flags & NORMAL:
            # Light of all directions goes to a lobe about the normal
            r = dr.select((chosen.x & NORMAL) != 0, dr.sqrt(u[1]), r)
        centre = self._centre(chosen, around)
        turn = u[2]
        by_angle = (chosen.x & BY_ANGLE) != 0 if self._tables.flags & BY_ANGLE else mi.Bool(False)
        if self._tables.backward and self._tables.flags & BY_ANGLE:
            # There are directions that a lobe by angle does not reach against refraction: a few rays go anywhere
            refracts = by_angle & (scale != 1)
            anywhere = refracts & (turn < ANYWHERE)
            turn = dr.select(refracts, (turn - ANYWHERE) / (1 - ANYWHERE), turn)
            turn = dr.select(anywhere, u[2] / ANYWHERE, turn)
            r, centre = dr.select(anywhere, dr.sqrt(u[1]), r), dr.select(anywhere, outward, centre)
            by_angle &= ~anywhere
        sine, cosine = dr.sincos(2 * dr.pi * turn)
        axis = dr.select(by_angle, centre, outward) if self._tables.flags & BY_ANGLE else outward
        across, along = mi.coordinate_system(axis)
        aside = cosine * across + sine * along
        tangential = centre - dr.dot(centre, outward) * outward + r * aside
        left = 1 - dr.squared_norm(tangential)
        direction = dr.fma(dr.sqrt(dr.maximum(left, 0)), outward, tangential)
        direction = dr.select(left > 0, direction, -outward)
        if self._tables.flags & BY_ANGLE:
            chord = dr.fma(-0.5 * r, r, 1) * centre + r * dr.sqrt(dr.maximum(dr.fma(-0.25 * r, r, 1), 0)) * aside
            direction = dr.select(by_angle, dr.select(r <= R_MAX, chord, -outward), direction)
        return dr.normalize(direction)

    def _evaluate(
        self,
        lobes: list[dict[str, Any]],
        total: mi.Float,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        around: Around,
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Flux per solid angle and incident flux, its derivative by R or T, and the density of the random rays."""
        outward, cos_i, scale = around.outward, around.cos_i, around.scale
        flux, slope, density = mi.Float(0), mi.Float(0), mi.Float(0)
        for lobe in lobes:
            words = lobe["words"]
            here = lobe["here"]
            apart = direction - self._centre(words, around)
            across = apart - dr.dot(apart, outward) * outward
            r2, per_angle = dr.squared_norm(across), cos_s
            if self._tables.flags & BY_ANGLE:
                by_angle = (words.x & BY_ANGLE) != 0
                r2 = dr.select(by_angle, dr.squared_norm(apart), r2)
                per_angle = dr.select(by_angle, 1, cos_s)
            profile = self._tables.radial.value(words.x >> TABLE_SHIFT, r2, here)
            value = dr.select(here, profile * per_angle, 0)
            drawn = value / lobe["total"]
            if self._tables.backward:
                wide = r2 / dr.square(scale)
                drawn = self._tables.radial.value(words.x >> TABLE_SHIFT, wide, here) * per_angle
                drawn = dr.select(here & (wide <= R_MAX**2), drawn / (lobe["total"] * dr.square(scale)), 0)
                if self._tables.flags & BY_ANGLE:
                    mixed = dr.lerp(drawn, cos_s / dr.pi, ANYWHERE)
                    drawn = dr.select(here & by_angle & (scale != 1), mixed, drawn)
                if self._tables.flags & NORMAL:
                    drawn = dr.select(here & ((words.x & NORMAL) != 0), cos_s / dr.pi, drawn)
            density += lobe["flux"] * drawn
            value *= lobe["coefficient"]
            if self._tables.flags & GHS:
                value *= dr.select((words.x & GHS) != 0, 0.25 * dr.square(cos_i + cos_s), 1)
            if self._tables.flags & RAYLEIGH_RICE:
                value *= dr.select((words.x & RAYLEIGH_RICE) != 0, cos_i * cos_s, 1)
            if self._tables.flags & COSINE:
                value *= dr.select((words.x & COSINE) != 0, cos_s, 1)
            if self._tables.flags & EDGE:
                grown = obliquity(dr.dot(around.specular, outward), cos_s, r2)
                value *= dr.select((words.x & EDGE) != 0, grown, 1)
            if self._tables.flags & RATIO:
                ratio = self._ratio(lobe, around, direction, cos_s, r2, across)
                value *= dr.select((words.x & RATIO) != 0, ratio, 1)
            flux += value
            slope += value * lobe["slope"]
        return flux, slope, dr.select(total > 0, density / total, 0)

    def _ratio(
        self,
        lobe: dict[str, Any],
        around: Around,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        r2: mi.Float,
        across: mi.Vector3f,
    ) -> mi.Float:
        """The ratio table of a lobe."""
        words, outward, x_axis = lobe["words"], around.outward, around.x_axis
        active = lobe["here"] & ((words.x & RATIO) != 0)
        cos_specular = dr.dot(around.specular, outward)
        tangent = around.specular - cos_specular * outward
        second = dr.clip(1 - (1 - 0.5 * dr.log2(dr.maximum(r2, 1e-30))) / (1 - lobe["log2_r_min"]), 0, 1)
        if self._tables.flags & BY_COSINES:
            by_cosines = (words.x & BY_COSINES) != 0
            across = dr.select(by_cosines, direction - cos_s * outward, across)
            second = dr.select(by_cosines, dr.clip(cos_s, 0, 1), second)
        lengths = dr.squared_norm(across) * dr.squared_norm(tangent)
        # At normal incidence there is no azimuth, and no derivative by it; in the plane of incidence it has a kink
        cosine = dr.dot(across, tangent) * dr.rsqrt(dr.maximum(lengths, NO_AZIMUTH))
        cosine = dr.select(lengths > NO_AZIMUTH, cosine, 0)
        angle = dr.acos(dr.clip(cosine, -ONE_LESS, ONE_LESS))
        first = dr.clip(cos_specular, 0, 1)
        if self._tables.flags & ANGULAR:
            bent = dr.acos(dr.minimum(first, ONE_LESS)) * (2 / dr.pi)
            first = dr.select((words.x & ANGULAR) != 0, bent, first)
        turned = active & ((words.x & TURNED) != 0) if x_axis is not None else mi.Bool(False)
        value = self._tables.ratio(words.y, (first, second, angle / dr.pi), active & ~turned)
        if x_axis is None:
            return value
        lit = dr.mulsign(outward, -dr.dot(around.d, outward))
        tangent, beside, rotation = plane_of_sample(tangent, lit, x_axis)
        across = dr.select(dr.squared_norm(across) > NO_TANGENT**2, across, tangent)
        azimuth = dr.atan2(dr.dot(across, beside), dr.dot(across, tangent)) * (0.5 / dr.pi)
        azimuth = azimuth - dr.select((words.x & FROM_X) != 0, rotation, 0)
        rotation = rotation - self._tables.first_rotation(words.y, turned)
        places = (first, fraction_of(rotation), second, fraction_of(azimuth))
        return dr.select(turned, self._tables.ratio(words.y, places, turned), value)


def specular_direction(
    reflect: mi.Bool, d: mi.Vector3f, axis: mi.Vector3f, cos_i: mi.Float, cos_t: mi.Float, eta: mi.Float
) -> mi.Vector3f:
    """Unit direction that light along d is reflected or refracted into; arguments as in `Interaction`."""
    return dr.normalize(dr.select(reflect, d - 2 * cos_i * axis, eta * d + (cos_t - eta * cos_i) * axis))

"""
Scatter of a ray at a surface: sampling, evaluation, and the weights of multiple importance sampling.

A scattered ray is drawn either at random, a lobe by its flux and a direction by its profile, or towards a target, by
its share and uniformly over its area. All rays of a hit together are weighted with the balance heuristic of E. Veach
(Robust Monte Carlo methods for light transport simulation, 1997, section 9.2): a direction that several techniques i
could have drawn counts f/Σ n_i pdf_i, so that the sum is unbiased whatever the targets are. Here f is the scattered
flux per sr and incident flux, n_i the number of rays of a technique, and pdf_i its density, 1/sr.

Backward rays (see `mistray.execute.backward`) are drawn alike, about the reflected or refracted direction of the ray.
They are weighted with the BSDF of the forward light, since surfaces need not be reciprocal. In transmission their lobes
are as wide in optical direction cosines n sin θ as those of forward light, as they are at a reciprocal surface
(E. Veach, 1997, section 5.2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import is_
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.kernel.interaction import Interaction, shares_at
from mistray.kernel.lobes import tangents
from mistray.kernel.sample_axes import NO_TANGENT, fraction_of, plane_of_sample
from mistray.kernel.scatter_shares import ScatterBudget, ScatteredRay, ScatterHit, ScatterPdfs, ScatterShares
from mistray.kernel.scatter_tables import (
    ANGULAR,
    BY_ANGLE,
    BY_COSINES,
    FACTOR_FLAGS,
    FROM_X,
    NORMAL,
    RANDOM_RAYS_SHIFT,
    RATIO,
    RETRO,
    TABLE_SHIFT,
    TURNED,
    ScatterTables,
)
from mistray.kernel.targets import AimSet, Place
from mistray.recorders.sampler import DIRECTION, TECHNIQUE, Sampler
from mistray.scatter.lobe import factor
from mistray.scatter.radial import R_MAX
from mistray.surfaces.surfaces import SurfaceTable

NO_AZIMUTH = 1e-16  # product of the squared lengths of two directions' tangential parts
ONE_LESS = 1 - 2.0**-23  # a cosine whose angle still has a finite derivative
ANYWHERE = 0.1  # share of the rays of a lobe by angle that go against refraction anywhere


@dataclass
class LobeFrame:
    """
    Local shading frame of the scatter lobes at a hit.

    Attributes
    ----------
    axis : mi.Vector3f
        Unit normal on the side that the light goes to without reflection.
    outward, specular, d : mi.Vector3f
        Unit vectors: normal on the side that rays are sent to, specular direction, and direction of arrival.
    cos_i, eta : mi.Float
        Cosine of the angle of incidence, and refractive index on the side of incidence over that on the other.
    x_axis : mi.Vector3f or None
        The x axis of the sample, a unit vector; None: all samples are isotropic.
    scale : mi.Float
        Factor by which random rays are spread wider; 1 for forward rays.
    """

    axis: mi.Vector3f
    outward: mi.Vector3f
    specular: mi.Vector3f
    d: mi.Vector3f
    cos_i: mi.Float
    eta: mi.Float
    x_axis: mi.Vector3f | None
    scale: mi.Float


class Scattering(ScatterShares):
    """
    Scatter of all surfaces at one wavelength: scattered fractions, and sampling and evaluation of the BSDF.

    Parameters
    ----------
    tables : ScatterTables
        Tables of the scatter of all surfaces.

    Attributes
    ----------
    tables : ScatterTables
        Tables of the scatter of all surfaces.
    any : bool
        Whether a surface scatters.
    bulk : BulkScattering or None
        Scatter in media; None: no medium scatters.
    """

    @classmethod
    def of(cls, table: SurfaceTable, aims: Mapping[Place, AimSet], backward: bool = False) -> Scattering:
        """Return the scatter of a table, see `ScatterTables`: that of before if its targets are the same objects."""
        known: Scattering | None = table.kept.get(("scattering", backward))
        before = {} if known is None else known.tables.aims
        if known is None or [*aims] != [*before] or not all(map(is_, aims.values(), before.values())):
            known = cls(ScatterTables(table.without_scene(), aims, backward))
            table.kept["scattering", backward] = known
        return known

    @property
    def arrays(self) -> list[Any]:
        """
        Device arrays of the scatter models; none if no surface scatters.

        Importance targets are left out, as they change only the variance.
        """
        tables = self.tables
        if not tables.any:
            return []
        frames = [tables.frames.rows] if tables.frames is not None else []
        return [tables.totals, tables.lobes, tables.ratios, *tables.radial.arrays, *frames]

    def scatter(
        self,
        hit: ScatterHit,
        budget: ScatterBudget,
        choose: Callable[[], ScatteredRay],
        otherwise: mi.Vector3f,
        sampler: Sampler,
        active: mi.Bool,
        competing: Scattering | None = None,
        connects: bool = False,
    ) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Bool, mi.Bool, ScatterPdfs]:
        """
        Return a random scattered ray of each hit: direction, flux with its MIS weight, and pdfs.

        Parameters
        ----------
        hit : ScatterHit
            Hits of surfaces that scatter.
        budget : ScatterBudget
            Fractions that the hits scatter and absorb.
        choose : callable
            ``choose()`` returns the ray of the node that is to be drawn.
        otherwise : mi.Vector3f
            Direction returned where a lane is inactive or the ray carries nothing.
        sampler : Sampler
            Random numbers of the rays.
        active : mi.Bool
            Lanes that take part.
        competing : Scattering, optional
            Scatter of a competing trace in the other direction.
        connects : bool
            Whether rays may be connected to light vertices.

        Returns
        -------
        direction : mi.Vector3f
            Unit direction.
        weight : mi.Float
            Flux of the ray per unit of incident flux; 0 if its direction goes into the surface.
        slope : mi.Float
            d ln(weight) / d(R or T).
        reflect, aim : mi.Bool
            Whether it stays on the side of incidence, and whether it goes to a target.
        pdfs : ScatterPdfs
            Densities of the direction, for MIS weights.
        """

        # A conditional block returns loose arrays: the ray, and the densities that the trace needs
        def draw(otherwise: mi.Vector3f) -> tuple[Any, ...]:
            ray = choose()
            *drawn, pdf_ratio, pdf_rev = self._draw(hit, budget, ray, otherwise, sampler, competing)
            known = [] if competing is None else [pdf_ratio, pdf_rev]
            if connects:
                assert ray.connection is not None
                known.append(dr.select(ray.connects, ray.connection.word, 0))
            return *drawn, ray.reflect, ray.aim, *known

        def leave(otherwise: mi.Vector3f) -> tuple[Any, ...]:
            stay = mi.Vector3f(otherwise), mi.Float(0), mi.Float(0), mi.Bool(False), mi.Bool(False)
            known = [] if competing is None else [mi.Float(1), mi.Float(0)]
            return *stay, *known, *([mi.UInt32(0)] if connects else [])

        # Few lanes scatter at a time: packets of lanes without one skip all this
        result: tuple[Any, ...] = dr.if_stmt((otherwise,), active, draw, leave, mode="symbolic", label="scatter")
        return *result[:5], ScatterPdfs(*result[5:])

    def _draw(
        self,
        hit: ScatterHit,
        budget: ScatterBudget,
        ray: ScatteredRay,
        otherwise: mi.Vector3f,
        sampler: Sampler,
        competing: Scattering | None,
    ) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Float, mi.Float]:
        """
        Return direction, weight and slope of the rays that `scatter` returns, and the two pdfs of `ScatterPdfs`.

        `ray` says how each is drawn; the other parameters are as in `scatter`.
        """
        table, s, it, d = hit
        # The case of reflection follows that of transmission from the same side
        case = budget.first_case + dr.select(ray.reflect, mi.UInt32(1), 0)
        plan, lobes, frame = self._case(case, s, it, d, ray.reflect)
        # Random numbers: a place on the lobe or target, and which one it is
        u, (choice, kept) = sampler.pair(DIRECTION), sampler.pair(TECHNIQUE)
        total = sum((lobe["flux"] for lobe in lobes), mi.Float(0))
        # Sample: at random, towards a target, or to a light vertex
        direction = self._random(lobes, total, (choice, *u, kept), frame)
        own = mi.UInt32(0)
        if self.tables.aimed:
            aimed, own = self.tables.targets.sample(plan.zw, choice, u, it.p, frame.specular, ray.aim)
            direction = dr.select(ray.aim, aimed, direction)
        if ray.connection is not None:
            direction = dr.select(ray.connects, ray.connection.direction, direction)
        # Evaluate; a backward ray carries the flux of forward light
        cos_s = dr.dot(direction, frame.outward)
        flux, slope, pdf = self._evaluate(lobes, total, direction, cos_s, frame)
        if self.tables.backward:
            from_front = it.from_front ^ ~ray.reflect
            R, T, cos_t = shares_at(table, s, it.word, from_front, cos_s, mi.Bool(True))
            share = dr.select(ray.reflect, R, T)
            flux = self._backward_flux(plan, ray.reflect, frame, direction, cos_s, cos_t, share)
        # MIS weight: f/Σ n_i pdf_i over the techniques of the hit
        techniques, expected = ray.random_rays * pdf, pdf
        if self.tables.aimed:
            # Where a trace competes, aimed rays count whether or not this light has any
            aimed_rays = ray.aimed_rays if competing is None else self._aimed_rays(case)
            targets = self.tables.targets
            at_targets = targets.density(plan.zw, it.p, direction, frame.specular, ray.aim, own, aimed_rays > 0)
            techniques += ray.aimed_rays * at_targets
            expected = pdf + aimed_rays * at_targets
        if ray.connection is not None:
            # A connection stands for all rays that the hit sends there; its MIS weight comes at the end of the path
            techniques = dr.select(ray.connects, expected / ray.connection.factor, techniques)
        # Directions into the surface carry nothing
        weight = flux / techniques
        good = (cos_s > 0) & (flux > 0) & dr.isfinite(weight)
        # Densities of the competing direction
        pdf_ratio, pdf_rev = mi.Float(1), expected
        if competing is not None:
            other = competing.pdf_reverse(table, s, it, ray.reflect, d, direction, cos_s, frame.x_axis)
            # Per étendue n² cos θ dω dA, which is the same before and behind mirrors and lenses
            pdf_ratio = other / expected * (cos_s / it.cos_i) * dr.select(ray.reflect, 1, dr.rcp(dr.square(it.eta)))
            pdf_ratio = dr.select(good & dr.isfinite(pdf_ratio), pdf_ratio, 0)
            pdf_rev = expected if self.tables.backward else other
        return (
            dr.select(good, direction, otherwise),
            dr.select(good, weight, 0),
            dr.select(good, slope / flux, 0),
            pdf_ratio,
            pdf_rev,
        )

    def _case(
        self, case: mi.UInt32, s: mi.UInt32, it: Interaction, d: mi.Vector3f, reflect: mi.Bool
    ) -> tuple[mi.Vector4u, list[dict[str, Any]], LobeFrame]:
        """Return the table row of a scatter case, its lobes and their shading frame, for a ray that arrives along d."""
        x = dr.select(reflect, it.R, self._transmittance(it))
        scale = dr.select(reflect, 1, it.eta) if self.tables.backward else mi.Float(1)
        # Lobes are centred on the specular direction on the side that the ray leaves to
        outward = dr.select(reflect, -it.axis, it.axis)
        specular = dr.select(reflect, it.reflected, it.transmitted)
        plan = dr.gather(mi.Vector4u, self.tables.cases, case)
        lobes, x_axis = self._read_lobes(plan, x, it.cos_i), self._x_axis(s, it, mi.Bool(True))
        return plan, lobes, LobeFrame(it.axis, outward, specular, d, it.cos_i, it.eta, x_axis, scale)

    def _aimed_rays(self, case: mi.UInt32) -> mi.Float:
        """Return the number of aimed rays that a scatter case sends per hit."""
        side = dr.gather(mi.Vector4u, self.tables.sides, case >> 1, True)
        return mi.Float(dr.select((case & 1) != 0, side.w, side.z & ((1 << RANDOM_RAYS_SHIFT) - 1)))

    def pdf_reverse(
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
        Return the reverse pdf: rays per sr that this competing trace sends along -d for one along `-direction`.

        One ray is drawn at random, and all aimed rays count. The probability that a hit scatters at all is left out.
        `reflect` says whether the ray stays on the side of incidence, `cos_s` is the cosine of the angle of `direction`
        with the normal, and `x_axis` is as in `LobeFrame`.
        """
        # R, T and refraction for a ray that arrives along `-direction`, on the other side if it was transmitted
        from_front = it.from_front ^ ~reflect
        R, T, cos_t = shares_at(table, s, it.word, from_front, cos_s, mi.Bool(True))
        if self.tables.backward:
            T = dr.select(cos_t > 0, T, 1)

        # Its frame, its lobes, and their density towards -d
        eta = dr.select(reflect, it.eta, dr.rcp(it.eta))
        incident, outward = -direction, -it.axis
        axis = dr.select(reflect, it.axis, outward)
        specular = specular_direction(reflect, incident, axis, cos_s, cos_t, eta)
        # Four cases for each surface: transmission and reflection, from the front and from the back
        case = 4 * s + dr.select(from_front, mi.UInt32(0), 2) + dr.select(reflect, mi.UInt32(1), 0)
        plan = dr.gather(mi.Vector4u, self.tables.cases, case)
        lobes = self._passing_lobes(plan, reflect, dr.select(reflect, R, T), cos_s, cos_t)
        total = sum((lobe["flux"] for lobe in lobes), mi.Float(0))
        scale = dr.select(reflect, 1, eta) if self.tables.backward else mi.Float(1)
        frame = LobeFrame(axis, outward, specular, incident, cos_s, eta, x_axis, scale)
        _, _, pdf = self._evaluate(lobes, total, -d, it.cos_i, frame)
        # Targets of the competing trace draw there as well
        if not self.tables.aimed:
            return pdf
        rays, targets = self._aimed_rays(case), self.tables.targets
        return pdf + rays * targets.density(plan.zw, it.p, -d, specular, mi.Bool(False), mi.UInt32(0), rays > 0)

    def _backward_flux(
        self,
        plan: mi.Vector4u,
        reflect: mi.Bool,
        frame: LobeFrame,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        cos_t: mi.Float,
        x: mi.Float,
    ) -> mi.Float:
        """
        Return the flux (1/sr) that forward light along `-direction` scatters along -d, per solid angle of `direction`.

        `plan` is the row of the case, see `_read_lobes`, and `frame` that of the ray. `cos_s` and `cos_t` are the
        light's own cosines of incidence and refraction, x is the coating's R or T for it. With the étendue
        dG = n² cos θ dω dA of either direction the flux per étendue is the same for forward and backward rays; the
        change from dG to dω gives the factor n_i² cos θ_i/(n_o² cos θ_o), with i for the side and angle at which the
        light arrives, and o for those at which it leaves.
        """
        # The light comes along -direction, and is scattered to -d: the frame seen from there
        incident, outward, eta = -direction, -frame.axis, dr.rcp(frame.eta)
        specular = specular_direction(reflect, incident, dr.select(reflect, frame.axis, outward), cos_s, cos_t, eta)
        lobes = self._passing_lobes(plan, reflect, x, cos_s, cos_t)
        one = mi.Float(1)
        light = LobeFrame(outward, outward, specular, incident, cos_s, eta, frame.x_axis, one)
        flux, _, _ = self._evaluate(lobes, one, -frame.d, frame.cos_i, light)
        return flux * cos_s / frame.cos_i * dr.select(reflect, 1, dr.square(eta))

    def _passing_lobes(
        self, plan: mi.Vector4u, reflect: mi.Bool, x: mi.Float, cos_i: mi.Float, cos_t: mi.Float
    ) -> list[dict[str, Any]]:
        """
        Return the lobes by which light can scatter in a given case.

        Where light that would be transmitted is in total reflection, only lobes about the normal can. `cos_i` and
        `cos_t` are its cosines of incidence and refraction; for `plan` and `x` see `_read_lobes`.
        """
        # In total reflection cos θt is 0, and nothing is refracted into a specular direction
        lobes = self._read_lobes(plan, x, cos_i)
        passes = reflect | (cos_t > 0)
        for lobe in lobes:
            lobe["here"] = lobe["here"] & (passes | ((lobe["words"].x & NORMAL) != 0))
        return lobes

    def _read_lobes(self, plan: mi.Vector4u, x: mi.Float, cos_i: mi.Float) -> list[dict[str, Any]]:
        """
        Return the lobes of a case as values by lane, as many as the case with most lobes has.

        `plan` is the row of the case in `ScatterTables.cases`, `x` the coating's R or T, and `cos_i` the cosine of
        incidence. Of each lobe, "here" is the mask of lanes that have it, "coefficient" the factor on its profile, and
        "total" the profile's integral. "flux" is their product, 0 where masked, by which lobes are drawn: it includes
        directions beyond the horizon, and leaves out cosine factor and ratio table. "slope" is d ln(flux)/dx.
        """
        # All cases read as many lobes as the largest has; those that a case has not are masked
        lobes = []
        for j in range(self.tables.most_lobes):
            here = plan.y > j
            row = plan.x + j
            shares, limit, log2_r_min, words = self.tables.lobe(row, here)
            # c₀ + c₁ x + c₂ x² of the coating's x = R or T
            coefficient = dr.fma(x, dr.fma(x, shares.z, shares.y), shares.x)
            # A lobe by angle has a factor 1/cos θi up to a limit, see `mistray.scatter.lobe.Lobe`
            if self.tables.flags & BY_ANGLE:
                oblique = dr.minimum(dr.rcp(cos_i), limit)
                coefficient = dr.select((words.x & BY_ANGLE) != 0, oblique, 1) * coefficient
            # Flux over all directions, and d ln(flux)/dx
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

    def _centre(self, words: mi.Vector2u, frame: LobeFrame) -> mi.Vector3f:
        """Return the unit vector about which a lobe is centred: specular direction, reverse of arrival, or normal."""
        # The specular direction, the one of arrival (retro-reflection) or the normal
        centre = frame.specular
        if self.tables.flags & RETRO:
            centre = dr.select((words.x & RETRO) != 0, -frame.d, centre)
        if self.tables.flags & NORMAL:
            centre = dr.select((words.x & NORMAL) != 0, frame.outward, centre)
        return centre

    def _random(
        self,
        lobes: list[dict[str, Any]],
        total: mi.Float,
        u: tuple[mi.Float, mi.Float, mi.Float, mi.Float],
        frame: LobeFrame,
    ) -> mi.Vector3f:
        """
        Return a unit direction drawn from the lobes, each chosen in proportion to its flux.

        The first of four uniform numbers `u` chooses a lobe by its flux, of which all have `total`, the others a radius
        and an azimuth in its profile, and whether a cell of its table is kept.
        """
        # The lobe, by its flux
        outward, scale = frame.outward, frame.scale
        chosen, flux, so_far = lobes[0]["words"], u[0] * total, lobes[0]["flux"]
        for lobe in lobes[1:]:
            later = lobe["here"] & (flux >= so_far) & (lobe["flux"] > 0)
            chosen = dr.select(later, lobe["words"], chosen)
            so_far = so_far + lobe["flux"]  # not +=, which would change the first lobe's flux
        # The radius in its profile, in direction cosines or, for a lobe by angle, a chord
        r = self.tables.radial.sample(chosen.x >> TABLE_SHIFT, u[1], u[3], mi.Bool(True)) * scale
        if self.tables.backward and self.tables.flags & NORMAL:
            # Light of all directions goes to a lobe about the normal
            r = dr.select((chosen.x & NORMAL) != 0, dr.sqrt(u[1]), r)
        # The azimuth about its centre
        centre = self._centre(chosen, frame)
        turn = u[2]
        by_angle = (chosen.x & BY_ANGLE) != 0 if self.tables.flags & BY_ANGLE else mi.Bool(False)
        if self.tables.backward and self.tables.flags & BY_ANGLE:
            # There are directions that a lobe by angle does not reach against refraction: a few rays go anywhere
            refracts = by_angle & (scale != 1)
            anywhere = refracts & (turn < ANYWHERE)
            turn = dr.select(refracts, (turn - ANYWHERE) / (1 - ANYWHERE), turn)
            turn = dr.select(anywhere, u[2] / ANYWHERE, turn)
            r, centre = dr.select(anywhere, dr.sqrt(u[1]), r), dr.select(anywhere, outward, centre)
            by_angle &= ~anywhere
        # The direction
        sine, cosine = dr.sincos(2 * dr.pi * turn)
        axis = dr.select(by_angle, centre, outward) if self.tables.flags & BY_ANGLE else outward
        across, along = tangents(axis)
        aside = cosine * across + sine * along
        tangential = centre - dr.dot(centre, outward) * outward + r * aside
        cos2 = 1 - dr.squared_norm(tangential)
        direction = dr.fma(dr.sqrt(dr.maximum(cos2, 0)), outward, tangential)
        direction = dr.select(cos2 > 0, direction, -outward)  # beyond the horizon: into the surface, of weight 0
        if self.tables.flags & BY_ANGLE:
            chord = dr.fma(-0.5 * r, r, 1) * centre + r * dr.sqrt(dr.maximum(dr.fma(-0.25 * r, r, 1), 0)) * aside
            direction = dr.select(by_angle, dr.select(r <= R_MAX, chord, -outward), direction)
        return dr.normalize(direction)

    def _evaluate(
        self,
        lobes: list[dict[str, Any]],
        total: mi.Float,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        frame: LobeFrame,
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """
        Return the scattered flux per incident flux, its derivative with respect to R or T, and the pdf of random rays.

        All three are per sr. `lobes` come from `_read_lobes`, and `total` is the sum of the fluxes by which they are
        drawn. `cos_s` is the cosine between `direction` and the frame's `outward`.
        """
        outward, cos_i, scale = frame.outward, frame.cos_i, frame.scale
        flux, slope, density = mi.Float(0), mi.Float(0), mi.Float(0)
        for lobe in lobes:
            # Distance from the centre, in direction cosines or, for a lobe by angle, as a chord
            words = lobe["words"]
            here = lobe["here"]
            apart = direction - self._centre(words, frame)
            across = apart - dr.dot(apart, outward) * outward
            r2, per_angle = dr.squared_norm(across), cos_s
            if self.tables.flags & BY_ANGLE:
                by_angle = (words.x & BY_ANGLE) != 0
                r2 = dr.select(by_angle, dr.squared_norm(apart), r2)
                per_angle = dr.select(by_angle, 1, cos_s)
            # Profile, and the density with which `_random` draws it; backward rays spread it by `scale`
            profile = self.tables.radial.value(words.x >> TABLE_SHIFT, r2, here)
            value = dr.select(here, profile * per_angle, 0)
            drawn = value / lobe["total"]
            if self.tables.backward:
                wide = r2 / dr.square(scale)
                drawn = self.tables.radial.value(words.x >> TABLE_SHIFT, wide, here) * per_angle
                drawn = dr.select(here & (wide <= R_MAX**2), drawn / (lobe["total"] * dr.square(scale)), 0)
                if self.tables.flags & BY_ANGLE:
                    mixed = dr.lerp(drawn, cos_s / dr.pi, ANYWHERE)
                    drawn = dr.select(here & by_angle & (scale != 1), mixed, drawn)
                if self.tables.flags & NORMAL:
                    drawn = dr.select(here & ((words.x & NORMAL) != 0), cos_s / dr.pi, drawn)
            # Mean over lobes, which are drawn by their flux
            density += lobe["flux"] * drawn
            # Factors of the models beside the profile
            value *= lobe["coefficient"]
            cos_0 = dr.dot(frame.specular, outward)
            for name, flag in FACTOR_FLAGS.items():
                if self.tables.flags & flag:
                    value *= dr.select((words.x & flag) != 0, factor(name, cos_i, cos_s, cos_0, r2), 1)
            if self.tables.flags & RATIO:
                ratio = self._ratio(lobe, frame, direction, cos_s, r2, across)
                value *= dr.select((words.x & RATIO) != 0, ratio, 1)
            flux += value
            slope += value * lobe["slope"]
        return flux, slope, dr.select(total > 0, density / total, 0)

    def _ratio(
        self,
        lobe: dict[str, Any],
        frame: LobeFrame,
        direction: mi.Vector3f,
        cos_s: mi.Float,
        r2: mi.Float,
        across: mi.Vector3f,
    ) -> mi.Float:
        """
        Return the factor by which a lobe's ratio table scales the BSDF in a direction, interpolated linearly.

        `across` is the tangential part of the difference of the direction from the lobe's centre. `r2` is its square,
        but for a lobe by angle that of the whole difference, a chord. `cos_s` is as in `_evaluate`.
        """
        # Coordinates of the table: incidence, distance from the centre or angle of scatter, and azimuth
        words, outward, x_axis = lobe["words"], frame.outward, frame.x_axis
        active = lobe["here"] & ((words.x & RATIO) != 0)
        cos_specular = dr.dot(frame.specular, outward)
        tangent = frame.specular - cos_specular * outward
        second = dr.clip(1 - (1 - 0.5 * dr.log2(dr.maximum(r2, 1e-30))) / (1 - lobe["log2_r_min"]), 0, 1)
        if self.tables.flags & BY_COSINES:
            by_cosines = (words.x & BY_COSINES) != 0
            across = dr.select(by_cosines, direction - cos_s * outward, across)
            second = dr.select(by_cosines, dr.clip(cos_s, 0, 1), second)
        lengths = dr.squared_norm(across) * dr.squared_norm(tangent)
        # At normal incidence there is no azimuth, and no derivative by it; in the plane of incidence it has a kink
        cosine = dr.dot(across, tangent) * dr.rsqrt(dr.maximum(lengths, NO_AZIMUTH))
        cosine = dr.select(lengths > NO_AZIMUTH, cosine, 0)
        angle = dr.acos(dr.clip(cosine, -ONE_LESS, ONE_LESS))
        first = dr.clip(cos_specular, 0, 1)
        if self.tables.flags & ANGULAR:
            bent = dr.acos(dr.minimum(first, ONE_LESS)) * (2 / dr.pi)
            first = dr.select((words.x & ANGULAR) != 0, bent, first)
        turned = active & ((words.x & TURNED) != 0) if x_axis is not None else mi.Bool(False)
        value = self.tables.ratio(words.y, (first, second, angle / dr.pi), active & ~turned)
        if x_axis is None:
            return value
        # And the rotation of an anisotropic sample
        lit = dr.mulsign(outward, -dr.dot(frame.d, outward))
        tangent, beside, rotation = plane_of_sample(tangent, lit, x_axis)
        across = dr.select(dr.squared_norm(across) > NO_TANGENT**2, across, tangent)
        azimuth = dr.atan2(dr.dot(across, beside), dr.dot(across, tangent)) * (0.5 / dr.pi)
        azimuth = azimuth - dr.select((words.x & FROM_X) != 0, rotation, 0)
        rotation = rotation - self.tables.first_rotation(words.y, turned)
        places = (first, fraction_of(rotation), second, fraction_of(azimuth))
        return dr.select(turned, self.tables.ratio(words.y, places, turned), value)


def specular_direction(
    reflect: mi.Bool, d: mi.Vector3f, axis: mi.Vector3f, cos_i: mi.Float, cos_t: mi.Float, eta: mi.Float
) -> mi.Vector3f:
    """
    Return the unit direction into which light along d is specularly reflected or refracted.

    `axis` is the unit normal on the side of transmission, `cos_i` and `cos_t` are the cosines of incidence and
    refraction, and eta is n_i/n_t.
    """
    return dr.normalize(dr.select(reflect, d - 2 * cos_i * axis, eta * d + (cos_t - eta * cos_i) * axis))

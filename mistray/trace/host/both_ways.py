"""Short host trace in float64 that carries flux both as the mean of s and p and as Stokes vectors, for comparison.

Both modes share the rays, so that their ratio has next to no noise, and no kernel is compiled. The equations are those
of `mistray.kernel.polarization`; the axis of a Stokes vector is carried along with it. Light that a surface scatters,
once along a path and aimed at the targets of the trace, is unpolarised from there on. Light that media scatter, and
light that scatters again, is not followed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from mistray.events import ABSORBED, AIMED_REFLECTED, AIMED_TRANSMITTED, EVENT_BITS, REFLECTED, TOTAL, TRANSMITTED
from mistray.execute.tracer import Run
from mistray.kernel.polarization import NORMAL_INCIDENCE
from mistray.kernel.scatter_tables import ANGLES, Case, light_indices
from mistray.kernel.targets import AimSet, Target
from mistray.scatter.evaluate import bsdf
from mistray.surfaces.host_points import lambertian_directions
from mistray.surfaces.host_rays import first_hit, specular
from mistray.surfaces.optics import (
    BACK_MEDIUM_SHIFT,
    FRONT_MEDIUM_SHIFT,
    MEDIUM_MASK,
    MIRROR,
    OPAQUE,
)
from mistray.surfaces.upload import upload
from mistray.trace.host.coating_shares import CoatingShares

SEED = 20  # a fixed one: the mode of a trace must not depend on its seed
SCATTERED_RAYS = 256  # rays that all hits of surfaces that scatter send together
MOST_BRANCHES, MOST_IN_ALL = 8_000, 100_000  # in a generation, hits in a call: with deep limits trees hardly end
_NODES = np.linspace(0, 1, ANGLES + 1)
ROUNDED = 5e-4  # relative error that is not visible in a number of three digits
LEAST_OF_SCATTER = 1e-2  # fraction of the flux of a scattered ray below which its branches end

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Branches:
    """
    State of n branches of ray trees after an event, with their flux in both polarisation modes.

    Attributes
    ----------
    o, d, axis : (n, 3) float64
        Origins (mm), unit directions, and unit vectors across these to which the Stokes vectors refer.
    mean : (n,) float64
        Flux by the mean of s and p, in units of a start ray.
    light : (n, 4) float64
        Stokes vectors I, Q, U, V in the same units.
    floor : (n,) float64
        Flux below which branches end, in units of a start ray.
    last, medium, reflections, ray : (n,) int
        Index of the surface that they come from (-1: none), index of their material, number of reflections that count
        for `max_reflections`, and index of the start ray.
    scattered : (n,) bool
        Whether a surface has scattered them.
    codes : (n, k) int
        Events, surface << EVENT_BITS | type.
    """

    o: Floats
    d: Floats
    axis: Floats
    mean: Floats
    light: Floats
    floor: Floats
    last: Whole
    medium: Whole
    reflections: Whole
    ray: Whole
    scattered: npt.NDArray[np.bool_]
    codes: Whole

    def take(self, chosen: np.ndarray) -> Branches:
        """Return the branches selected by an array of indices or by a boolean mask."""
        return Branches(*(getattr(self, f.name)[chosen] for f in fields(self)))

    @property
    def bright(self) -> npt.NDArray[np.bool_]:
        """Mask of the branches, (n,), whose flux in either mode is above their `floor`."""
        return np.asarray(np.maximum(self.mean, self.light[:, 0]) > self.floor)

    @staticmethod
    def together(parts: list[Branches]) -> Branches:
        """Return the branches of all parts, concatenated; `parts` must not be empty."""
        return Branches(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Branches)))

    def after(self, code: Whole, d: Floats, axis: Floats, mean: Floats, light: Floats) -> Branches:
        """
        Return the branches after one more event; `code`, (n,), is that of each branch, see `codes`.

        Directions, axes and fluxes after it are those given, see the attributes of these names. Origins remain.
        """
        codes = np.concatenate([self.codes, code[:, None]], axis=1)
        return replace(self, d=d, axis=axis, mean=mean, light=light, last=code >> EVENT_BITS, codes=codes)


@dataclass(frozen=True)
class Arrivals:
    """
    Flux that a detector absorbs of one or several paths in both polarisation modes, from a sample of rays.

    Attributes
    ----------
    path : tuple of int
        Events of the path, see `Branches.codes`.
    mean, stokes : float
        Flux that the detector absorbs in either mode, W.
    hits : int
        Number of branches that arrived.
    spread : float
        RMS distance of the hits from their centroid, weighted by flux, mm.
    residual : float
        Sum over the branches of the squared deviation of `stokes` from proportionality to `mean`, W².
    scattered : bool
        Whether a surface scatters the light.
    reflections : int
        Number of reflections that count for `max_reflections`.
    name : str
        Name of the light for messages.
    """

    path: tuple[int, ...] = ()
    mean: float = 0.0
    stokes: float = 0.0
    hits: int = 0
    spread: float = 0.0
    residual: float = 0.0
    scattered: bool = False
    reflections: int = 0
    name: str = ""

    def plus(self, other: Arrivals) -> Arrivals:
        """
        Return two arrivals added up: flux, W, hits and residual.

        The spread is the larger of the two; all else is that of this one.
        """
        sums = {name: getattr(self, name) + getattr(other, name) for name in ("mean", "stokes", "residual", "hits")}
        return replace(self, **sums, spread=max(self.spread, other.spread))

    @property
    def stray(self) -> bool:
        """
        True if a surface scattered the light, or reflected it other than as a mirror or by total reflection.

        False for the direct image, and for light that reaches the detector past the optics without such an event.
        """
        return self.scattered or self.reflections > 0

    @property
    def change(self) -> float:
        """Change of the absorbed flux, as a fraction, if Stokes vectors replace the mean of s and p; 0 without flux."""
        return self.stokes / self.mean - 1 if self.mean > 0 else 0.0

    @property
    def error(self) -> float:
        """Standard error of `change` (a fraction), estimated from the branches; 0 without flux."""
        return math.sqrt(self.residual) / self.mean if self.mean > 0 else 0.0

    @property
    def words(self) -> str:
        """Phrase for messages: path name and change of its flux in percent, with a standard error that is visible."""
        shown = self.error > ROUNDED * abs(self.change)
        return f"{self.name} by {100 * self.change:+.3g}{f' ± {100 * self.error:.1g}' if shown else ''} %"


def started(run: Run, rays: int) -> tuple[Branches, float]:
    """Return about `rays` start rays of a run as `Branches`, and the flux, W, of a start ray of weight 1."""
    pilot = replace(run, rays=run.source.count(rays), seed=SEED, parts=None)
    start = pilot.start_pass(0)
    if (given := dr.width(start.lane)) > 2 * rays:  # a source may have rays of its own
        start = start.take(upload(mi.UInt32, np.linspace(0, given - 1, rays).astype(np.int64)))
    o, d = pilot.exact(start)
    n = len(o)
    weight = np.broadcast_to(np.array(start.w, dtype=np.float64), n)
    light = np.zeros((n, 4))
    light[:, 0] = weight
    left = run.table.ids.index(run.source.shape) if run.source.shape else -1
    zero, none = np.zeros(n, dtype=np.int64), np.zeros((n, 0), dtype=np.int64)
    return Branches(
        o, d, _across(d), weight.copy(), light, run.settings.flux_threshold * weight, zero + left,
        zero + (run.source.medium or 0), zero, np.arange(n), np.zeros(n, dtype=bool), none,
    ), run.source.power / n  # fmt: skip


def follow(run: Run, rays: int) -> tuple[list[Arrivals], int]:
    """
    Trace a sample of the rays of a run in float64; return the flux of each path on the detectors in both modes.

    Parameters
    ----------
    run : Run
        Run of unpolarised light.
    rays : int
        Approximate number of start rays, spread over the beam.

    Returns
    -------
    arrivals : list of Arrivals
        Light at the detectors, path by path.
    hits : int
        Number of hits of surfaces that were traced.
    """
    branches, unit = started(run, rays)
    tree = _Tree(run, np.random.default_rng(SEED))
    tree.grow(branches)
    if tree.dim:
        tree.grow(tree.scatter())
    return [found for end in tree.ends for found in _by_path(*end, unit)], tree.hits


@dataclass(frozen=True)
class _Lit:
    """
    Branches that meet a scattering surface, with their flux in both polarisation modes.

    Attributes
    ----------
    case : Case
        Side and event by which the surface scatters.
    branches : Branches
        Branches before the scatter, n of them.
    outward : (n, 3) float64
        Unit normals on the side to which the light is scattered.
    mean, own : (n,) float64
        R or T for the mean of s and p, and for the Stokes vector of the light.
    """

    case: Case
    branches: Branches
    outward: Floats
    mean: Floats
    own: Floats

    @property
    def flux(self) -> Floats:
        """Scattered flux of each branch by the mean of s and p, (n,), in units of a start ray."""
        # Mean over the rotations of the sample, and the terms of a polynomial in R or T
        _, *terms = (np.interp(self.cosine, _NODES, column) for column in self.case.rows.mean(axis=0).T)
        return np.asarray(self.branches.mean * sum(term * self.mean**power for power, term in enumerate(terms)))

    @property
    def cosine(self) -> Floats:
        """
        Cosines of the angle of incidence, (n,).

        For transmission, tabulated in the rarer medium, they are an approximation.
        """
        return np.abs(np.einsum("ij,ij->i", self.branches.d, self.outward))


class _Tree:
    """
    Host trace of a ray tree, one generation of branches after the other, in both polarisation modes.

    Attributes
    ----------
    ends : list of (Branches, (n,) float64, (n,) float64)
        Branches that arrived at a detector, and the flux that it absorbs of each, in units of a start ray: first by the
        mean of s and p, then by Stokes vectors.
    dim : list of _Lit
        Hits so far of surfaces that scatter.
    hits : int
        Number of hits of surfaces.
    """

    def __init__(self, run: Run, rng: np.random.Generator) -> None:
        self._table, self._settings, self._rng = run.table, run.settings, rng
        tables = run.scattering.tables
        self._aims = tables.aims
        self._cases = {(case.surface, case.from_front, case.event): case for case in tables.all_cases}
        self._extinction = np.array(run.table.optics.extinction, dtype=np.float64)
        self._coatings = CoatingShares(run.table.optics)
        self._detects = np.isin(np.arange(run.table.count), run.table.detectors)
        self.ends: list[tuple[Branches, Floats, Floats]] = []
        self.dim: list[_Lit] = []
        self.hits = 0

    def grow(self, branches: Branches) -> None:
        """
        Trace branches generation by generation, only the brightest `MOST_BRANCHES` of each.

        It ends when none are left, after `max_events` generations, or once this call has added more than `MOST_IN_ALL`
        hits.
        """
        last = self.hits + MOST_IN_ALL
        for _ in range(self._settings.max_events):
            if len(branches.o) > MOST_BRANCHES:
                branches = branches.take(np.sort(np.argsort(-branches.mean, kind="stable")[:MOST_BRANCHES]))
            self.hits += len(branches.o)
            branches = self._step(branches)
            if not len(branches.o) or self.hits > last:
                break

    def scatter(self) -> Branches:
        """
        Return scattered rays from recorded hits, drawn in proportion to scattered flux; empty the list of hits.

        There are no rays if no flux is scattered.
        """
        flux = np.concatenate([lit.flux for lit in self.dim])
        lit, self.dim = self.dim, []
        edges = np.cumsum(np.maximum(flux, 0))
        if not edges[-1] > 0:
            return lit[0].branches.take(np.zeros(0, dtype=np.int64))
        # Systematic sampling: each hit in proportion to its flux, but for rounding
        places = (np.arange(SCATTERED_RAYS) + self._rng.random()) * edges[-1] / SCATTERED_RAYS
        chosen = np.minimum(np.searchsorted(edges, places, side="right"), len(edges) - 1)
        found, first = [], 0
        for one in lit:
            count = len(one.outward)
            own = chosen[(chosen >= first) & (chosen < first + count)]
            if len(own):
                weight = edges[-1] / SCATTERED_RAYS / flux[own]
                found.append(self._rays(one, own - first, weight))
            first += count
        return Branches.together(found)

    def _step(self, b: Branches) -> Branches:
        """
        Return the specular children of branches at their next surface; record hits of detectors and scatterers.

        Branches that leave the scene end.
        """
        table, optics = self._table, self._table.optics
        # Intersect
        surface, p, normal = first_hit(table, b.o, b.d, b.last)
        hit = np.flatnonzero(surface >= 0)
        b, surface, p, normal = b.take(hit), surface[hit], p[hit], normal[hit]
        if not len(hit):
            return b

        # Side of incidence and media
        words, indices = optics.host_words[surface].astype(np.int64), optics.host_indices[surface]
        along = np.einsum("ij,ij->i", b.d, normal)
        from_front, cosine = along > 0, np.minimum(np.abs(along), 1)
        sides = [(words >> shift) & MEDIUM_MASK for shift in (FRONT_MEDIUM_SHIFT, BACK_MEDIUM_SHIFT)]
        near, far = np.where(from_front, sides[0], sides[1]), np.where(from_front, sides[1], sides[0])
        medium = np.where(near > 0, near, b.medium)

        # Attenuate
        transmittance = np.exp(-self._extinction[medium] * np.linalg.norm(p - b.o, axis=1))
        b = replace(b, o=p, mean=b.mean * transmittance, light=b.light * transmittance[:, None], medium=medium)

        # Snell's law, R and T, and the Stokes vectors in the plane of incidence
        eta = np.where(from_front, indices[:, 0] / indices[:, 1], indices[:, 1] / indices[:, 0])
        back, through, total = specular(b.d, normal, eta)
        opaque = (words & OPAQUE) != 0
        total &= ~opaque
        shares = self._coatings.shares(surface, from_front, cosine, eta, opaque)
        b = _turned(b, normal)
        s, (reflected, transmitted) = b.axis, (_child(b.light, X) for X in shares)
        mean_r, mean_t = (b.mean * 0.5 * (X[:, 0] + X[:, 1]) for X in shares)

        # Record hits of detectors
        here = np.flatnonzero(self._detects[surface])
        if len(here):
            end = b.take(here)
            code = (surface[here] << EVENT_BITS) | ABSORBED
            end = end.after(code, end.d, end.axis, end.mean, end.light)
            stokes = b.light[:, 0] - reflected[:, 0] - transmitted[:, 0]
            self.ends.append((end, (b.mean - mean_r - mean_t)[here], stokes[here]))

        # Specular children, without the scattered flux
        cos_t = np.sqrt(np.maximum(0, 1 - eta**2 * (1 - cosine**2)))
        kept_r = self._kept(surface, from_front, "reflection", cosine)
        kept_t = self._kept(surface, from_front, "transmission", np.minimum(cosine, cos_t))
        allowed = self._settings.allowed
        mirror = (words & MIRROR) != 0
        counts = ~total & ~mirror
        may = np.where(total, "I" in allowed, np.where(mirror, "M" in allowed, "R" in allowed))
        may &= ~counts | (b.reflections < self._settings.max_reflections)
        what = np.where(total, TOTAL, REFLECTED)
        echo = b.after((surface << EVENT_BITS) | what, back, s, mean_r * kept_r, reflected * kept_r[:, None])
        echo = replace(echo, reflections=b.reflections + counts, medium=medium)
        code = (surface << EVENT_BITS) | TRANSMITTED
        onward = b.after(code, through, s, mean_t * kept_t, transmitted * kept_t[:, None])
        onward = replace(onward, medium=far)
        children = [echo.take(may & echo.bright), onward.take(~opaque & ~total & onward.bright & ("T" in allowed))]

        # Scatter waits until all specular branches are traced, so that its rays can be sampled by flux
        if self._cases and self._settings.max_scatters:
            sent = {"reflection": (shares[0][:, :2], reflected), "transmission": (shares[1][:, :2], transmitted)}
            self._light(b, surface, from_front, normal, sent)
        return Branches.together(children)

    def _kept(self, surface: Whole, from_front: np.ndarray, event: str, cosine: Floats) -> Floats:
        """
        Return the fraction, (n,), of R or T of the surfaces that stays in the specular beam beside scattered light.

        `event` is "reflection" or "transmission". `cosine` is that of the angle of incidence, in transmission that of
        the angle in the rarer medium.
        """
        kept = np.ones(len(surface))
        for (number, side, name), case in self._cases.items():
            here = np.flatnonzero((surface == number) & (from_front == side))
            if name == event and len(here):
                loss = case.rows[:, :, 0].mean(axis=0)
                kept[here] = 1 - np.minimum(np.interp(cosine[here], _NODES, loss), 1)
        return kept

    def _light(
        self,
        b: Branches,
        surface: Whole,
        from_front: np.ndarray,
        normal: Floats,
        sent: dict[str, tuple[Floats, Floats]],
    ) -> None:
        """
        Record branches that meet scattering surfaces, unless they were scattered before.

        The hits are at `surface`, (n,), with unit normals to the back, (n, 3). `sent` maps an event to R or T for s and
        p, (n, 2), and to the children's Stokes vectors, (n, 4). Events that the settings do not allow are left out.
        """
        for (number, side, event), case in self._cases.items():
            here = np.flatnonzero((surface == number) & (from_front == side) & ~b.scattered)
            reflects = event == "reflection"
            if not len(here) or ("r" if reflects else "t") not in self._settings.allowed:
                continue
            X, child = sent[event]
            flux = b.light[here, 0]
            own = np.divide(child[here, 0], flux, out=np.zeros(len(here)), where=flux > 0)
            outward = normal[here] * (1.0 if side != reflects else -1.0)
            self.dim.append(_Lit(case, b.take(here), outward, X[here].mean(axis=1), own))

    def _rays(self, lit: _Lit, chosen: Whole, weight: Floats) -> Branches:
        """
        Return one scattered ray for each chosen hit, aimed at a flat target if there is one, else Lambertian.

        `chosen`, (m,), holds indices of hits in `lit`; `weight`, (m,), is 1 over how often each is drawn on average.
        """
        case, b, outward = lit.case, lit.branches.take(chosen), lit.outward[chosen]
        to_back = case.from_front == (case.event == "transmission")
        d, per_sr = scattered_directions(b.o, outward, self._aims.get((case.surface, to_back)), self._rng)
        cos_s = np.einsum("ij,ij->i", d, outward)
        tangent = b.d - np.einsum("ij,ij->i", b.d, outward)[:, None] * outward
        size = np.linalg.norm(tangent, axis=1, keepdims=True)
        # Local shading frame: x along the tangential part of the incident direction
        x = np.where(size > 1e-9, tangent / np.maximum(size, 1e-9), _across(outward))
        y = np.cross(outward, x)
        local = np.stack([np.einsum("ij,ij->i", d, v) for v in (x, y)] + [np.maximum(cos_s, 0)], axis=1)
        lobes = [member.lobe for member in case.members]
        sides = light_indices(self._table.optics, case.surface, case.from_front)
        # Estimator f cos θ/pdf
        weight = weight * np.maximum(cos_s, 0) / np.maximum(per_sr, 1e-30)
        mean, own = (
            weight * bsdf(lobes, case.event, lit.cosine[chosen], local, *sides, X[chosen]) for X in (lit.mean, lit.own)
        )
        what = AIMED_TRANSMITTED if case.event == "transmission" else AIMED_REFLECTED
        light = np.zeros_like(b.light)
        light[:, 0] = b.light[:, 0] * own
        flux = b.mean * mean
        sent = b.after(np.full(len(d), (case.surface << EVENT_BITS) | what), d, _across(d), flux, light)
        word = int(self._table.optics.host_words[case.surface])
        medium = (word >> (BACK_MEDIUM_SHIFT if to_back else FRONT_MEDIUM_SHIFT)) & MEDIUM_MASK
        return replace(
            sent,
            floor=LEAST_OF_SCATTER * flux,
            codes=sent.codes[:, -1:],  # events before the scatter event do not tell paths apart here
            scattered=np.ones(len(d), dtype=bool),
            medium=np.full(len(d), medium),
        )


def scattered_directions(
    o: Floats, outward: Floats, aim: AimSet | None, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """
    Return unit directions, (n, 3), of scattered rays from origins o (mm), and their pdf, (n,), 1/sr.

    They go to points on the flat targets of `aim`, or away from those of a virtual one; targets that overlap add
    to the pdf. Without flat targets they are Lambertian about the unit normals `outward`.
    """
    flat = [target for target in aim.targets if isinstance(target, Target)] if aim is not None else []
    if not flat:
        d = lambertian_directions(outward, rng)
        return d, np.einsum("ij,ij->i", d, outward) / np.pi
    shares = np.array([target.share for target in flat])
    shares /= shares.sum()
    chosen = rng.choice(len(flat), len(o), p=shares)
    d = np.zeros_like(o)
    for k, target in enumerate(flat):
        at = chosen == k
        way = (target.points(rng.random((int(at.sum()), 2))) - o[at]) * (-1 if target.reverse else 1)
        d[at] = way / np.linalg.norm(way, axis=1, keepdims=True)
    per_sr = np.zeros(len(o))
    for k, target in enumerate(flat):
        slope = d @ target.normal
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            r = (target.centre - o) @ target.normal / slope
            # A ray drawn for a target at its edge may miss it by rounding
            met = ((r < 0) == target.reverse) & (target.holds(o + r[:, None] * d) | (chosen == k))
            # From area to solid angle: r²/(A |cos θ|)
            per_sr += np.where(met, shares[k] * r**2 / (target.area * np.maximum(np.abs(slope), 1e-9)), 0)
    return d, per_sr


def _by_path(end: Branches, mean: Floats, stokes: Floats, unit: float) -> list[Arrivals]:
    """
    Return the light of each path at the detector, from branches that arrived there.

    `mean` and `stokes`, (n,), are the absorbed flux in either mode, in units of a start ray, whose flux is `unit`, W.
    """
    paths, number = np.unique(end.codes, axis=0, return_inverse=True)
    number = number.ravel()
    found = []
    for k, path in enumerate(paths):
        own = np.flatnonzero(number == k)
        weight, other, p = mean[own], stokes[own], end.o[own]
        flux, ratio, spread = float(weight.sum()), 1.0, 0.0
        if flux > 0:
            ratio = float(other.sum()) / flux
            spread = float(np.sqrt(weight @ np.sum((p - weight @ p / flux) ** 2, axis=1) / flux))
        found.append(
            Arrivals(
                path=tuple(path.tolist()),
                mean=unit * flux,
                stokes=unit * float(other.sum()),
                hits=len(own),
                spread=spread,
                residual=float(np.sum((unit * (other - ratio * weight)) ** 2)),
                scattered=bool(end.scattered[own[0]]),
                reflections=int(end.reflections[own[0]]),
            )
        )
    return found


def _across(d: Floats) -> Floats:
    """Return a unit vector perpendicular to each direction, (n, 3)."""
    found = np.cross(d, np.eye(3)[np.argmin(np.abs(d), axis=1)])
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _cross(a: Floats, b: Floats) -> Floats:
    """Return row-wise cross products of two arrays of vectors, (n, 3); faster than `np.cross` for short arrays."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _turned(b: Branches, normal: Floats) -> Branches:
    """
    Return branches whose Stokes vectors refer to axes normal to the plane of incidence.

    `normal`, (n, 3), are unit normals of the surfaces. At normal incidence, where there is no such plane, branches keep
    their axes.
    """
    s = _cross(b.d, normal)
    size = np.sqrt(np.einsum("ij,ij->i", s, s))[:, None]
    s = np.where(size**2 > NORMAL_INCIDENCE, s / np.maximum(size, 1e-30), b.axis)
    c, n = np.einsum("ij,ij->i", b.axis, s), np.einsum("ij,ij->i", _cross(b.d, b.axis), s)
    cos2, sin2 = c * c - n * n, 2 * c * n
    flux, q, u, v = b.light.T
    return replace(b, light=np.stack([flux, cos2 * q + sin2 * u, cos2 * u - sin2 * q, v], axis=1), axis=s)


def _child(light: Floats, X: Floats) -> Floats:
    """
    Return Stokes vectors (flux, q, u, v), (n, 4), after reflection or transmission at a surface.

    `X`, (n, 4), holds R or T of s and p, and Re and Im of the amplitude product, see `CoatingShares.shares`.
    """
    flux, q, u, v = light.T
    s, p, re, im = X.T
    half, difference = 0.5 * (s + p), 0.5 * (s - p)
    return np.stack([half * flux + difference * q, difference * flux + half * q, re * u - im * v, im * u + re * v], 1)

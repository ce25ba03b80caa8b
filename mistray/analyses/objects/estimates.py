"""Estimate of stray light by one scatter event at an object: product of flux, BSDF and view of the detector.

    Φ_det = Φ · BSDF · π GCF

with the flux Φ on the object, its BSDF from the direction of that light to the detector, and the geometrical
configuration factor GCF: the projected solid angle of the detector as the object sees it through the optics, over π (R.
Breault, Control of Stray Light, in Handbook of Optics, OSA). The refractive index is n at the object and n_d at the
detector, and s is the mean weight of Lambertian rays from the detector that meet the object. Étendue then gives
π GCF = π (n_d/n)² A_det s/A. With rays within an angle α of its normal alone s sin²α takes the place of s.

A transmitting surface is seen from either side, by total reflection even from the one that faces away. Each side has
its own GCF, at most 1, and its own product.

The factors vary over an object, which is therefore divided into patches. GCF is the mean over the patches, weighted by
the flux on them. The BSDF is the mean over pairs of a ray that lights the object and one nearby that sees it, weighted
likewise. The remaining error comes from the variation within a patch.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from mistray.analyses.objects.patches import Patches
from mistray.analyses.objects.rows import CommonObject, ScatterEstimate
from mistray.analyses.objects.view import SIDES, HitSamples, RayView
from mistray.estimate import Estimate
from mistray.kernel.scatter_tables import light_indices, side_of
from mistray.scatter.evaluate import bsdf
from mistray.settings import BATCHES
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.ray_sources import DetectorView

PLACE = ("id", "part", "side", "between", "stop", "optic")
LIT, SEEN = 512, 128  # rays that light an object, and rays that see it near each of them, whose pairs give the BSDF
FEW = 32  # a part of those that see it, one in so many, is near


@dataclass(frozen=True, eq=False)
class SeenObject:
    """Hits of backward rays on an object, with a k-d tree of the hit points (mm) to find the nearest."""

    hits: HitSamples
    tree: cKDTree

    @classmethod
    def of(cls, hits: HitSamples) -> SeenObject:
        """Return the object made from its hits, with a k-d tree of their points."""
        return cls(hits, cKDTree(hits.point))


def product_estimates(
    table: SurfaceTable,
    detector: DetectorView,
    seen: RayView,
    views: Iterable[tuple[float, RayView]],
    objects: Mapping[int, CommonObject],
) -> list[ScatterEstimate]:
    """
    Return estimates of the light that each object sends to the detector by one scatter event, at every source angle.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    detector : DetectorView
        Detector, from which the backward rays started.
    seen : RayView
        Objects that the detector sees.
    views : iterable of (float, RayView)
        Source angle, degrees, NaN for a cone or a disc, and the objects that light from there meets.
    objects : mapping
        Rows of the objects, by their index in `seen`.

    Returns
    -------
    list of ScatterEstimate
        Estimates by angle; for each angle the strongest first.
    """
    sides = [
        (number, SeenObject.of(hits), replace(row, side=side))
        for number, row in objects.items()
        for side, hits in by_side(seen.samples(number), row.side)
    ]
    found, area = [], detector.area
    for angle, view in views:
        own = []
        for number, hits, row in sides:
            bsdf_1_sr, gcf, flux = estimate(table, area * detector.share, hits, view, number)
            own.append(
                ScatterEstimate(
                    angle_deg=angle,
                    **{name: getattr(row, name) for name in PLACE},
                    scatters=bool(table.interfaces[number // SIDES].scatter),
                    flux_W=Estimate(*view.area(number)),
                    bsdf_1_sr=bsdf_1_sr,
                    gcf=gcf,
                    detector_W=flux,
                    pst=flux.times(1 / area),
                )
            )
        total = sum(row.detector_W.value for row in own) or 1.0
        own.sort(key=lambda row: -row.detector_W.value)
        found += [replace(row, percent=100 * row.detector_W.value / total) for row in own]
    return sorted(found, key=lambda row: row.angle_deg)


def by_side(hits: HitSamples, side: str) -> list[tuple[str, HitSamples]]:
    """
    Return the rays that see an object, split by its side, as pairs (side, hits).

    The projected solid angle of one side is at most π sr.

    Parameters
    ----------
    hits : HitSamples
        Hits of backward rays on the object.
    side : {"front", "back", "both"}
        Side or sides of the object.
    """
    if side != "both" or not len(hits.weight):
        return [(side, hits)]
    parts = [("front", hits.from_front), ("back", ~hits.from_front)]
    return [(name, hits.only(here)) for name, here in parts if here.any()]


def estimate(
    table: SurfaceTable, area: float, view: SeenObject, illuminated: RayView, number: int
) -> tuple[float, float, Estimate]:
    """
    Return BSDF (1/sr), geometric configuration factor and product estimate of an object, W for 1 W/mm² across the beam.

    `area` is that of the detector, mm², times the share of its view that was traced; `number` is the index of the
    object in `illuminated`. All are 0 unless the object is seen where it is lit.
    """
    lit, seen = illuminated.samples(number), view.hits
    if not lit.weight.sum() > 0 or not seen.weight.sum() > 0:
        return 0.0, 0.0, Estimate(0.0, 0.0)
    surface = number // SIDES
    patches = Patches.of(table, surface, min(len(lit.weight), len(seen.weight)))
    at_lit, at_seen = patches.numbers(lit.point), patches.numbers(seen.point)
    # Projected solid angle of the detector from each patch
    scale = np.pi * area / seen.rays / patches.areas[:, None]
    omega = scale * _all_and_without(at_seen, seen.batch, seen.weight / seen.index**2, patches.count)
    light = _all_and_without(at_lit, lit.batch, lit.weight, patches.count)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.nan_to_num(np.sum(light * omega, axis=0) / light.sum(axis=0))
    if mean[0] == 0:
        return 0.0, 0.0, Estimate(0.0, 0.0)
    pairs = _pairs(table, surface, lit, view, lit.weight * omega[at_lit, 0])
    value = pairs.means(omega[at_lit[pairs.lit]] / omega[at_lit[pairs.lit], :1])
    hits = _all_and_without(np.zeros(BATCHES, dtype=int), np.arange(BATCHES), illuminated.flux[number], 1)[0]
    product = illuminated.area(number)[0] * hits / hits[0] * value * mean
    left_out = product[1:]
    error = float(np.sqrt((BATCHES - 1) / BATCHES * np.sum(np.square(left_out - left_out.mean()))))
    return float(value[0]), float(mean[0]) / np.pi, Estimate(float(product[0]), error)


def _all_and_without(place: np.ndarray, batch: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    """
    Return sums of weights by index `place`, (count, 1 + BATCHES).

    `place`, `batch` and `weight` have an entry for each ray. The first column is of all rays. The others leave one
    batch out each, and are scaled up to the number of all rays.
    """
    by_batch = np.bincount(place * BATCHES + batch, weight, minlength=count * BATCHES).reshape(count, BATCHES)
    total = by_batch.sum(axis=1, keepdims=True)
    return np.concatenate([total, (total - by_batch) * (BATCHES / (BATCHES - 1))], axis=1)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """
    BSDF for pairs of rays on one surface: one ray lights it, and nearby backward rays see it, k for each.

    Attributes
    ----------
    lit : (LIT,) int
        Indices of the rays that light the surface.
    lit_batch : (LIT,) int
        Batches of these rays.
    batch : (LIT, k) int
        Batches of the rays that see it.
    weight, value : (LIT, k) float64
        Weights of these rays, and the BSDF of each pair, 1/sr.
    """

    lit: np.ndarray
    lit_batch: np.ndarray
    batch: np.ndarray
    weight: np.ndarray
    value: np.ndarray

    def means(self, chance: np.ndarray) -> np.ndarray:
        """
        Return the mean BSDF over all pairs, 1/sr, then that without each batch of rays, (1 + BATCHES,).

        Parameters
        ----------
        chance : (LIT, 1 + BATCHES) float64
            Solid angles of the patches without each batch, over those by which the rays were chosen.
        """
        rows = np.broadcast_to(np.arange(len(self.lit))[:, None], self.batch.shape).ravel()
        bsdf, weight = (
            _all_and_without(rows, self.batch.ravel(), terms.ravel(), len(self.lit))
            for terms in (self.weight * self.value, self.weight)
        )
        left = np.ones((len(self.lit), 1 + BATCHES))
        left[np.arange(len(self.lit)), 1 + self.lit_batch] = 0.0
        known = chance * left * (weight > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.sum(known * np.where(weight > 0, bsdf / weight, 0.0), axis=0) / known.sum(axis=0)
        return np.asarray(np.nan_to_num(found))


def _pairs(table: SurfaceTable, surface: int, lit: HitSamples, view: SeenObject, chance: np.ndarray) -> _Pairs:
    """Return pairs of rays that light a surface, drawn in proportion to `chance`, (n,), and rays that see it nearby."""
    rng, seen = np.random.default_rng(surface), view.hits
    sums = np.cumsum(chance)
    chosen = np.searchsorted(sums, (np.arange(LIT) + rng.random()) / LIT * sums[-1], side="right")
    chosen = np.minimum(chosen, len(chance) - 1)
    near = min(int(np.clip(len(seen.weight) // FEW, 8, SEEN)), len(seen.weight))
    _, partners = view.tree.query(lit.point[chosen], k=near)
    partners = partners.reshape(len(chosen), near)
    weight = (seen.weight / seen.index**2)[partners]
    values = surface_bsdf(
        table,
        surface,
        lit.from_front[chosen],
        lit.direction[chosen],
        lit.normal[chosen],
        -seen.direction[partners],
        seen.from_front[partners] == lit.from_front[chosen][:, None],
    )
    return _Pairs(chosen, lit.batch[chosen], seen.batch[partners], weight, values)


def surface_bsdf(
    table: SurfaceTable,
    surface: int,
    from_front: np.ndarray,
    direction: np.ndarray,
    normal: np.ndarray,
    leaving: np.ndarray,
    same_side: np.ndarray,
) -> np.ndarray:
    """
    Return the BSDF of a surface, 1/sr, for pairs of incident and leaving directions, in float64.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    surface : int
        Index of the surface.
    from_front : (m,) bool
        Whether the light comes from the front.
    direction, normal : (m, 3) float64
        Unit directions of the incident light, and the unit normals on the side that it heads for.
    leaving : (m, k, 3) float64
        Unit directions of the scattered light.
    same_side : (m, k) bool
        Whether the light leaves on the side of incidence (reflection) or on the other (transmission).

    Returns
    -------
    (m, k) float64
        BSDF, 1/sr; 0 without scatter models, and where `leaving` points to the wrong side of the surface.
    """
    optics = table.optics
    models = tuple(optics.bsdfs[surface].scatter)
    values = np.zeros(leaving.shape[:2])
    if not models:
        return values
    cos_i = np.minimum(np.einsum("ij,ij->i", direction, normal), 1.0)
    along = direction - cos_i[:, None] * normal
    # At normal incidence any direction in the surface will do
    any_way = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.5, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    x = np.where(np.linalg.norm(along, axis=1, keepdims=True) > 1e-9, along, any_way)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    for front in (True, False):
        here = from_front == front
        if not here.any():
            continue
        n_in, n_out = light_indices(optics, surface, front)
        side = side_of(models, optics.wavelength_nm, n_in, n_out, front)
        if optics.host_words[surface] & OPAQUE:
            side = side.without_transmission()
        shares = optics.shares(surface, front, cos_i[here])
        for event, wanted, sign, share in (
            ("reflection", same_side, -1.0, shares[0]),
            ("transmission", ~same_side, 1.0, shares[1]),
        ):
            z = sign * normal[here]
            frame = np.stack([x[here], np.cross(z, x[here]), z], axis=2)
            local = leaving[here] @ frame
            found = bsdf(side.lobes, event, cos_i[here][:, None], local, n_in, n_out, share[:, None])
            values[here] += np.where(wanted[here] & (local[:, :, 2] > 0), found, 0.0)
    return values

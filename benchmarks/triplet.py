"""The Cooke triplet, against optiland's ghost sequences and against its non-sequential tracer, from the same rays.

The lens is ours, with constant indices, built for optiland surface by surface. Both are given our start rays.

`sequences`: optiland follows the 15 ghosts of two reflections one by one, in float64, rims clip, every surface reflects
2 % and transmits 98 % on both sides. The job here is a trace with the path table, which finds the ghosts by itself, in
float32 with float64 sums, and meets the barrel.

`nonsequential`: lenses, edges, barrel and detector frame are the same surfaces on both sides, bare glass by Fresnel's
equations, the mean of both polarisations; both may go on for 64 events and give a map of 380 × 380 pixels. optiland
computes in float64 on NumPy; on torch, which keeps dead rays in its arrays, the same job takes some sixty times as
long. With one branch per hit, which is its default, both follow every start ray along one path that is drawn at random.
With splitting both follow both branches down to 1e-3 of a start ray and play roulette below; optiland only up to the
20th hit, more than any two-reflection ghost has, because there the branches without flux behind total reflection,
which its roulette leaves alone, split on without end.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import Any

import mitsuba as mi
import numpy as np
from rows import REPEATS, Row, agree, alternate, duration, measured, missing, version

import mistray
from mistray.materials import refractive_index
from mistray.prescription import Coating, Prescription, Structure, Surface
from mistray.settings import NO_LIMIT

FIELD_DEG = 10.0
REFLECTANCE = 0.02
THRESHOLD = 1e-3  # of a start ray, for roulette
SPLIT_HITS = 20
SPOT_MM = 1.0  # half side of the square about the image of the source: the rest of the map is ghosts
HOW = "pip install --no-deps -r tests/peers.txt"
SEQUENCES_TOLERANCE = 2e-3
SPLIT_TOLERANCE, SPLIT_RAYS = 0.01, 4_000  # only what falls below the threshold is random; more so with fewer rays
BAR = 50.0  # of the non-sequential rows
SIGMAS = 6.0  # two independent sets of random branches: a false alarm in 5e8 runs


def optiland(module: str) -> ModuleType:
    """A module of optiland, as the tests import it: without vtk where that is not installed."""
    tests = str(Path(__file__).resolve().parent.parent / "tests")
    if tests not in sys.path:
        sys.path.append(tests)
    import peers

    return peers.optiland(module)


@cache
def prescription(coated: bool) -> Prescription:
    """The shipped lens with indices as numbers; coated: with R = 2 % on all lens surfaces."""
    from mistray.scenes.cooke_triplet.prescription import build

    lens = build()
    (wavelength,) = lens.source.wavelength_nm

    def plain(surface: Surface) -> Surface:
        sides = {side: repr(refractive_index(getattr(surface, side), wavelength)) for side in ("front", "back")}
        coating = Coating(R=REFLECTANCE, T=1 - REFLECTANCE) if coated else surface.coating
        return replace(surface, **sides, coating=coating)

    edges = tuple(
        replace(s, front="air", back="air") if isinstance(s, Structure) else s for s in lens.structures
    )  # opaque: what lies behind them does not count
    return replace(lens, surfaces=tuple(map(plain, lens.surfaces)), structures=edges)


def wavelength_um() -> float:
    """Wavelength of the lens, µm."""
    return prescription(True).source.wavelength_nm[0] / 1e3


def start_rays(trace: mistray.Trace) -> tuple[np.ndarray, np.ndarray]:
    """Origins (mm) and directions of the start rays of a trace, (n, 3) each."""
    (run,) = trace.runs
    return run.start_rays(np.arange(run.rays))


# --- sequences


def sequential_lens() -> Any:
    """The six surfaces and the image plane as an Optic."""
    lens, materials = prescription(True), optiland("materials")
    coating = optiland("coatings").SimpleCoating(transmittance=1 - REFLECTANCE, reflectance=REFLECTANCE)
    optic = optiland("optic").Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    z = [surface.z for surface in (*lens.surfaces, lens.detector)]
    for k, surface in enumerate(lens.surfaces):
        index = float(surface.back)
        optic.surfaces.add(
            index=k + 1,
            radius=surface.radius,
            thickness=z[k + 1] - z[k],
            material=materials.IdealMaterial(n=index) if index != 1 else "air",
            is_stop=surface.name == "L2_front",
            aperture=2 * surface.semi_diameter,
            coating=coating,
        )
    optic.surfaces.add(index=len(lens.surfaces) + 1)
    return optic


def sequences(origin: np.ndarray, direction: np.ndarray) -> Callable[[], dict[tuple[str, str], float]]:
    """Follow all ghosts of two reflections; flux on the detector by the surfaces that reflect, in start rays."""
    lens, optic = prescription(True), sequential_lens()
    group, rays = optiland("sequences").SequencedSurfaceGroup, optiland("rays").RealRays
    count = len(lens.surfaces)
    ghosts = {}
    for near, far in combinations(range(1, count + 1), 2):
        there, back, again = range(1, far), range(far - 1, near, -1), range(near + 1, count + 2)
        steps = [*there, (far, "reflect"), *back, (near, "reflect"), *again]
        names = lens.surfaces[far - 1].name, lens.surfaces[near - 1].name
        ghosts[names] = group(optic.surfaces.surfaces, steps)
    w, h = lens.detector.half_width, lens.detector.half_height

    def action() -> dict[tuple[str, str], float]:
        result = {}
        for names, ghost in ghosts.items():
            ends = ghost.trace(rays(*origin.T, *direction.T, np.ones(len(origin)), wavelength_um()))
            # Rays that miss a surface or are totally reflected are NaN there
            lands = (np.abs(ends.x) <= w) & (np.abs(ends.y) <= h)
            result[names] = float(ends.i[lands].sum())
        return result

    return action


def against_sequences(rays: int, repeats: int) -> Row:
    """Whole jobs, from the rays to the flux of every ghost."""
    scene = prescription(True).to_scene()

    def ours() -> mistray.Trace:
        return mistray.trace(scene, rays=rays, field_deg=FIELD_DEG, max_reflections=2, flux_threshold=0.0)

    trace = ours()
    theirs = sequences(*start_rays(trace))
    unit = trace.energy.launched_W / rays
    # In a ghost that is also reflected totally optiland's rays end
    found = {(p.ghost_1, p.ghost_2): p.power_W / unit for p in trace.paths if p.order == 2 and not p.tir}
    ghosts = theirs()
    flux = agree("flux", sum(found.get(names, 0.0) for names in ghosts), sum(ghosts.values()), SEQUENCES_TOLERANCE)
    here, there = alternate(ours, theirs, repeats=repeats)
    return Row(
        "sequences",
        f"`cooke_triplet`, R = 2 %, two-reflection ghosts of {rays} rays, {version('optiland')} `sequences`",
        duration(here),
        duration(there),
        there.seconds / here.seconds,
        equal=f"{len(ghosts)} ghosts, {flux}",
    )


# --- nonsequential


def nonsequential_scene(origin: np.ndarray, direction: np.ndarray) -> Any:
    """The same surfaces as an NSQScene, with a source of the given rays."""
    lens = prescription(False)
    nsq = {name: optiland(f"nonsequential.{name}") for name in ("scene", "components", "materials", "detectors")}
    shapes = optiland("nonsequential.components.geometry.analytic")
    system, ideal = optiland("coordinate_system").CoordinateSystem, optiland("materials").IdealMaterial
    components, scene = nsq["components"], nsq["scene"].NSQScene()

    def medium(index: str) -> Any:
        n = float(index)
        return nsq["materials"].nsq_material.VACUUM if n == 1 else nsq["materials"].NSQMaterial(ideal(n=n))

    for s in lens.surfaces:
        shape = shapes.ConicGeometry(s.radius, s.conic, s.semi_diameter)
        glass = components.RefractiveComponent(system(z=s.z), shape, medium(s.front), medium(s.back), name=s.name)
        scene.add_component(s.name, glass)
    for s in lens.structures:
        if not isinstance(s, Structure):
            shape = shapes.FinitePlaneGeometry(2 * s.half_width, 2 * s.half_height)
            place = system(x=s.x, y=s.y, z=s.z)
        elif s.z0 == s.z1:
            shape, place = shapes.AnnularPlaneGeometry(*sorted((s.r0, s.r1)), s.z0), system(z=s.z)
        else:
            (z0, r0), (z1, r1) = sorted(((s.z0, s.r0), (s.z1, s.r1)))
            shape, place = shapes.CylindricalFrustumGeometry(r0, r1, z0, z1), system(z=s.z)
        scene.add_component(s.name, components.AbsorbingComponent(place, shape, name=s.name))
    d = lens.detector
    config = nsq["detectors"].configs.IrradianceDetectorConfig(
        2 * d.half_width, 2 * d.half_height, *d.pixels, splat="hard"
    )
    scene.add_detector("detector", system(z=d.z), config)
    scene.source_registry.add("rays", given_rays(origin, direction))
    return scene


def given_rays(origin: np.ndarray, direction: np.ndarray) -> Any:
    """A source of optiland that emits these rays in their order."""
    sources, bundle = optiland("nonsequential.sources"), optiland("nonsequential.ray_bundle").NSQRayBundle
    system = optiland("coordinate_system").CoordinateSystem

    class GivenRays(sources.CollimatedSource):
        """One batch after the other; the numbers of the rays go on over those that were split from earlier ones."""

        emitted = 0

        def generate(self, ray_id: np.ndarray, rng: Any) -> Any:
            """The next rays, from the first one where a trace begins."""
            n, ones = len(ray_id), np.ones(len(ray_id))
            begin = 0 if ray_id[0] == 0 else self.emitted
            self.emitted = begin + n
            o, d = origin[begin : self.emitted].T, direction[begin : self.emitted].T
            return bundle(
                *(column.copy() for column in (*o, *d)),
                flux=ones * (self.total_flux / n),
                wavelength=ones * wavelength_um(),
                n_current=ones,
                bounce=np.zeros(n, dtype=np.int32),
                alive=np.ones(n, dtype=bool),
                ray_id=ray_id,
            )

    spectrum = sources.Spectrum.monochromatic(wavelength_um())
    return GivenRays(system(), spectrum, total_flux=1.0, aperture_radius=1.0)


def theirs_nonsequential(scene: Any, rays: int, splitting: bool) -> Callable[[], np.ndarray]:
    """Trace with optiland; (380, 380) shares of the launched flux, row 0 at the smallest y."""
    if splitting:
        policy = optiland("nonsequential.ir.scene_ir").SamplingPolicy
        # The budget is of live rays: none is dropped for it
        scene.sampling_policy = policy(split_depth=SPLIT_HITS, split_budget=1e6, rr_start_flux=THRESHOLD)
    backend = optiland("nonsequential.backends").NumpyBackend

    def action() -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = scene.trace(rays, max_depth=64, min_flux_fraction=0.0, seed=0, backend=backend(seed=0))
        return pixel_mm() ** 2 * np.asarray(result.detectors["detector"].irradiance)

    return action


def pixel_mm() -> float:
    """Side of a pixel of the detector."""
    detector = prescription(False).detector
    return 2 * detector.half_width / detector.pixels[0]


def same_light(ours: np.ndarray, theirs: np.ndarray, rays: int, splitting: bool) -> str:
    """Compare light in the image of the source and light elsewhere; random branches differ by their own noise."""
    centre = np.unravel_index(np.argmax(theirs), theirs.shape)
    y, x = np.ogrid[: theirs.shape[0], : theirs.shape[1]]
    spot = np.maximum(abs(y - centre[0]), abs(x - centre[1])) * pixel_mm() <= SPOT_MM
    split_tolerance = SPLIT_TOLERANCE * math.sqrt(max(1.0, SPLIT_RAYS / rays))
    cells = []
    for what, where in (("direct flux", spot), ("ghost flux", ~spot)):
        share = float(theirs[where].sum())
        noise = SIGMAS * math.sqrt(2 * max(1 - share, 0.0) / (share * rays)) if share > 0 else 0.0
        cells.append(agree(what, float(ours[where].sum()), share, split_tolerance if splitting else noise))
    return ", ".join(cells)


def against_nonsequential(rays: int, splitting: bool, bar: float, repeats: int) -> Row:
    """Whole traces from the rays to the map of the detector."""
    scene: mi.Scene = prescription(False).to_scene()
    how = {"splitting": "split" if splitting else "one", "below_threshold": "roulette" if splitting else "cut"}
    limits = {"max_reflections": NO_LIMIT, "max_events": 64, "flux_threshold": THRESHOLD if splitting else 0.0}

    def ours() -> mistray.Trace:
        return mistray.trace(scene, rays=rays, field_deg=FIELD_DEG, ledger=False, **how, **limits)

    trace = ours()
    theirs = theirs_nonsequential(nonsequential_scene(*start_rays(trace)), rays, splitting)
    share = trace.irradiance * pixel_mm() ** 2 / trace.energy.launched_W
    equal = same_light(share, theirs(), rays, splitting)
    here, there = alternate(ours, theirs, repeats=repeats)
    branches = "both branches at every hit" if splitting else "one branch per hit"
    return Row(
        "nonsequential-split" if splitting else "nonsequential",
        f"`cooke_triplet` with its barrel, {branches}, {rays} rays, {version('optiland')} `nonsequential`",
        duration(here),
        duration(there),
        there.seconds / here.seconds,
        bar,
        equal=equal,
    )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `optiland`."""
    repeats = 1 if quick else REPEATS
    what = "`cooke_triplet`, two-reflection ghosts, optiland `sequences`"
    # Without numba optiland's conics would be Python loops over rays
    absent = missing("sequences", what, "optiland", "numba")
    yield absent or measured("sequences", what, partial(against_sequences, 1_000 if quick else 100_000, repeats))
    rays, repeats = (2_000, 1) if quick else (200_000, 2)
    for key, splitting in (("nonsequential", False), ("nonsequential-split", True)):
        what = f"`cooke_triplet` with its barrel, optiland `{key}`"
        absent = missing(key, what, "optiland", how=HOW)
        count = rays * SPLIT_RAYS // 200_000 if splitting else rays  # which takes optiland some fifty times as long
        yield absent or measured(key, what, partial(against_nonsequential, count, splitting, BAR, repeats))

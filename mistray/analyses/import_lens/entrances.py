"""Entrances of light: surfaces through which the detector sees the outside, ideally the first optic alone."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from mistray.percent import percent_text
from mistray.sampling.design_path import find_design_path
from mistray.sampling.sources import field_axes, spectrum_of
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.backward_rays import steps_back
from mistray.trace.host.ray_sources import DetectorView

PASS, MOST_RAYS = 1000, 8000  # rays at a time, and in all
ENOUGH = 100  # of them that see the source's side
CHANCE = 0.05  # probability that none of the rays finds an entrance with the share that is stated as the bound
TOLD = 3  # surfaces that a sentence names


@dataclass(frozen=True)
class Entrances:
    """
    Shares of the detector's view towards the source, by the surface through which light enters.

    The measure is étendue: the flux from a sky of equal radiance over that hemisphere, without Fresnel losses,
    reflections at glass or scatter. Mirrors and total reflection turn the light.

    Attributes
    ----------
    first : str
        Id of the first surface of the design path; "" without a design path, and all other members are 0 or empty then.
    rays : int
        Number of rays from the detector that leave on that side.
    share, share_se : float
        Share of the view, 0 … 1, that enters through any other surface, and its standard error.
    others : dict of str to float
        Share by other surface, the largest first; the detector itself if light meets nothing before it.
    """

    first: str
    rays: int
    share: float
    share_se: float
    others: dict[str, float]

    def __str__(self) -> str:
        if not self.first:
            return "no light of the source finds a way through the optics, so that where light enters is not known"
        if not self.rays:
            return "the detector sees nothing of the source's side"
        if not self.others:
            least = percent_text(1 - CHANCE ** (1 / self.rays), 1)
            return f"all that the detector sees of the source's side enters by '{self.first}' (others: below {least})"
        named = [f"{name} ({percent_text(share)})" for name, share in list(self.others.items())[:TOLD]]
        more = [f"{len(self.others) - TOLD} more"] if len(self.others) > TOLD else []
        return (
            f"{percent_text(self.share)} (± {percent_text(self.share_se)}) of what the detector sees of the source's "
            f"side does not enter by '{self.first}' but by {', '.join([*named, *more])}"
        )


def entrances(scene: mi.Scene, rays: int = MOST_RAYS, seed: int = 0) -> Entrances:
    """
    Return the surfaces through which a scene's detectors see the outside, found by float64 rays on the host.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    rays : int
        Largest number of rays from all detectors together, of equal flux over their hemispheres. They are traced in
        passes of 1000, at least one, until enough get out.
    seed : int
        Seed of the rays.

    Returns
    -------
    Entrances
    """
    whole = SurfaceTable(scene, float(spectrum_of(scene, None, None)[0][0]))
    axis = field_axes(scene)[:, 2]
    tables = [whole.on(number) for number in whole.detectors]
    paths = [(table, find_design_path(table, scene)) for table in tables]
    views = [(DetectorView(table, path.steps[-1].before), path) for table, path in paths if path and path.has_optics]
    if not views:
        return Entrances("", 0, 0.0, 0.0, {})
    first = whole.ids[views[0][1].steps[0].surface]
    rng = np.random.default_rng(seed)
    names, weights = list[str](), list[float]()
    for _ in range(max(rays // PASS, 1)):
        for view, _ in views:
            start = view.sample(max(PASS // len(views), 1), rng)
            for step in steps_back(view.table, start.o, start.d):
                here = (step.met < 0) & (-step.d @ axis > 0)
                names += [whole.ids[k] for k in step.left[here]]
                weights += (view.area * start.weight[step.ray[here]]).tolist()
        if len(names) >= ENOUGH:
            break
    if not names:
        return Entrances(first, 0, 0.0, 0.0, {})
    seen, weight = np.array(names, dtype=object), np.array(weights) / np.sum(weights)
    shares = {name: float(weight[seen == name].sum()) for name in dict.fromkeys(names) if name != first}
    others = dict(sorted(shares.items(), key=lambda item: -item[1]))
    share = sum(others.values())
    error = np.sqrt(np.sum((weight * ((seen != first) - share)) ** 2))  # of a quotient of sums over the rays
    return Entrances(first, len(names), share, float(error), others)

"""Monte Carlo in float64 of surfaces that scatter, never aimed: the split tracer, with books by batch of start rays."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import nonsequential
from .frozen_scene import read_frozen
from .geometry import Array
from .replay import path_text
from .scatter_integrals import Lobe
from .scene_xml import SceneModel

BATCHES = 32


def scatter_models(text: str) -> dict[str, tuple[Lobe, ...]]:
    """Shape id → lobes of the models nested in its interface, from a scene's XML."""
    scene = read_frozen(text)
    return {
        name: tuple(replace(lobe, sides=(side,)) for side in ("front", "back") for lobe in scene.lobes(name, side))
        for name in scene.scatter
    }


@dataclass(frozen=True)
class Books:
    """What became of the launched power, (BATCHES,) each, W; paths by texts such as ``"plate:t detector:A"``."""

    launched_W: float
    paths: dict[str, Array]
    absorbed: dict[str, Array]
    escaped: Array
    cut: Array

    def power(self, path: str) -> tuple[float, float]:
        return mean_and_se(self.paths[path])

    detected = property(lambda self: mean_and_se(np.sum(list(self.paths.values()), axis=0)))


def mean_and_se(by_batch: Array) -> tuple[float, float]:
    """Sum over batches of equal size, and its standard error."""
    return float(by_batch.sum()), float(np.sqrt(len(by_batch)) * by_batch.std(ddof=1))


def trace(
    model: SceneModel,
    models: dict[str, tuple[Lobe, ...]],
    origin: Array,
    direction: Array,
    power: Array,
    wavelength_nm: float,
    *,
    flux_threshold: float = 0.0,
    **limits: Any,
) -> Books:
    """Books of start rays (n, 3), powers (n,); limits and seed are those of `nonsequential.trace`."""
    limits["flux_threshold"] = flux_threshold
    ledger = nonsequential.trace(model, origin, direction, power, wavelength_nm, lobes=models, **limits)
    batch = np.random.default_rng(limits.get("seed", 0)).permutation(len(origin)) % BATCHES

    def by_batch(rays: np.ndarray, weights: Array) -> Array:
        return np.bincount(batch[rays], weights, BATCHES)

    def books(what: str) -> dict[str, Array]:
        every = np.arange(len(origin))
        return {key[1]: by_batch(every, booked) for key, booked in ledger.books.items() if key[0] == what}

    paths = {path_text(path.events): by_batch(path.start_rays, path.weights) for path in ledger.paths}
    escaped, cut = (sum(books(what).values(), np.zeros(BATCHES)) for what in ("escaped", "cut"))
    return Books(ledger.launched_W, paths, books("absorbed"), escaped, cut)

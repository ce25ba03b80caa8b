"""A PST that no trace made: a camera of 26 degrees half field, ghosts and scatter of three walls."""

from itertools import product

import numpy as np
import pandas as pd
import vectors

from mistray.analyses.pst.result import CLASSES, Pst
from mistray.recorders.directions import DirectionGrid

BATCHES = 32
FACTS = {
    "scene": "camera",
    "detector": "detector",
    "detector_area_mm2": 18.0,
    "wavelength_nm": [550.0],
    "weights": [1.0],
    "rays": 1_000_000,
    "seed": 0,
    "seconds": 12.5,
    "segments": 34_567_890,
    "settings": {"max_reflections": 2, "max_scatters": 2},
    "notes": ["single rays carry more than 10 % of the scattered light at 72, 74, 76, 78, 80°"],
}
# events, order, kind, ghosts, first scatter surface, scatters, structure, class, level at each angle
PATHS = vectors.toml("tables.toml")["paths of a PST"]
COLUMNS = [
    "cell", "azimuth_cell", "key", "label", "events", "path", "order", "kind", "ghost_1", "ghost_2", "scatter_1",
    "scatters", "structure_bounces", "tir", "rays", "pst_normal", "pst_normal_se",
]  # fmt: skip
CLASS_OF_PATH = (0, 2, 3, 3, 3, 4, 2, 1)


def label(kind: str, ghost_1: str, ghost_2: str, scatter_1: str) -> str:
    if scatter_1 != "-":
        return f"scatter at {scatter_1}"
    ghosts = " → ".join(name for name in (ghost_1, ghost_2) if name != "-")
    if kind == "structure":
        return f"{ghosts} (structure)"
    return ghosts or ("direct image" if kind == "direct" else kind)


def levels(theta: np.ndarray) -> np.ndarray:
    edge = 1 / (1 + np.exp((theta - 26) / 0.7))
    return np.array(
        [
            0.9 * edge * (edge > 1e-3),
            2e-4 * np.exp(-((theta / 18) ** 2)),
            3e-4 / (1 + (theta / 6) ** 2),
            4e-5 * np.exp(-(((theta - 30) / 9) ** 2)),
            2e-6 * np.exp(-theta / 25),
            1e-6 * np.exp(-theta / 30),
            3e-4 * np.exp(-(((theta - 21) / 2.5) ** 2)),
            2e-5 * (abs(theta - 46) < 5),
        ]
    )


def fake_pst(
    field_deg=tuple(range(0, 81, 2)),
    azimuths_deg=None,
    noise: float = 0.05,
    map_pixels: int = 0,
    convention: str = "normal",
    dark_from_deg: float = 90.0,
    paths: bool = True,
    **facts,
) -> Pst:
    """The PST of the camera; `noise` is the relative spread of a batch, larger at larger angles."""
    rng = np.random.default_rng(7)
    grid = DirectionGrid.of(field_deg, azimuths_deg)
    n, m = grid.shape
    theta = grid.field_deg
    clean = np.repeat(levels(theta)[:, :, None] * (theta < dark_from_deg)[:, None], m, axis=2)
    if m > 1:
        clean[3] *= 1 + 0.5 * np.cos(np.radians(grid.azimuths_deg))
    spread = noise * (1 + theta / 20)[None, :, None, None]
    batches = clean[..., None] * rng.gamma(1 / spread**2, spread**2, size=(*clean.shape, BATCHES))
    by_batch = np.zeros((len(CLASSES), n, m, BATCHES))
    for path, kind in enumerate(CLASS_OF_PATH):
        by_batch[kind] += batches[path]
    rows = []
    for i, j, (p, (events, *numbers)) in product(range(n), range(m), enumerate(PATHS)):
        samples = batches[p, i, j]
        if samples.any():
            names = f"{p:010x}", label(*numbers[1:5]), events, "".join(word[-1] for word in events.split())
            light = samples.mean(), samples.std(ddof=1) / np.sqrt(BATCHES)
            rows.append((i, j, *names, *numbers, 0, int(1000 * rng.uniform()) + 1, *light))
    maps = None
    if map_pixels:
        x = (np.arange(map_pixels) + 0.5) / map_pixels - 0.5
        spot = np.exp(-(x[:, None] ** 2 + x[None, :] ** 2) / 0.02) + 0.02
        value = by_batch.sum(axis=0).mean(axis=-1)[..., None, None] * spot / spot.mean()
        maps = np.stack([value, 0.1 * value])
    return Pst(
        grid=grid,
        by_batch=by_batch,
        weight=np.full(BATCHES, 1 / BATCHES),
        convention=convention,
        facts=FACTS | facts,
        largest_share=np.broadcast_to(np.where(theta > 70, 0.31, 0.002)[:, None], (n, m)).copy(),
        path_rows=pd.DataFrame(rows, columns=COLUMNS) if paths else None,
        maps=maps,
        extent_mm=(-2.1, 2.1, -2.1, 2.1),
    )

"""Antireflection coatings of the phone camera against its ghosts, with the number of layers as the price.

For 1, 2, 3, 4 and 6 layers two designs are sought: one for each glass, and from that one for each surface. All are
measured with the textbook coatings on the same rays, which no search has seen, at twice as many wavelengths. Run from
anywhere, on two cores it takes less than five minutes:
python examples/phone_camera_ar.py [folder for the results]
"""

from __future__ import annotations

import sys
import tempfile
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import mistray
from mistray.coatings import preset, spectrum
from mistray.optimize import optimize, path_power
from mistray.report.optimization import write_optimization
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

SCENE = "phone_camera"
STUDY = Path(__file__).with_name("phone_camera_ar.toml")
GLASSES = {
    "window": ("window_front", "window_rear"),
    "crown": ("L1_front", "L1_rear", "L4_front", "L4_rear"),
    "flint": ("L2_front", "L2_rear", "L3_front", "L3_rear", "L5_front", "L5_rear"),
    "filter": ("filter_front", "filter_rear"),
}
INDICES = {"window": "nd=1.7715 Vd=72.2", "crown": "nd=1.544 Vd=56.1", "flint": "nd=1.632 Vd=23.3", "filter": "1.516"}
SURFACES = tuple(surface for surfaces in GLASSES.values() for surface in surfaces)
# Number of layers → presets with as many; the searches begin with the last one
PRESETS = {1: ("mgf2_quarter_wave",), 2: ("v_coat",), 3: ("bbar3",), 4: ("bbar4",)}
# Without a preset: bbar4 with a thin pair between it and the glass
SIX = "1.38 0.2389w, 2.10 0.5079w, 1.38 0.0834w, 2.10 0.0552w, 1.38 0.015w, 2.10 0.02w"
LAYERS = (1, 2, 3, 4, 6)
THICKNESS_NM = (5.0, 260.0)
SEED, RAYS, STEP_NM = 1000, 2700, 25  # of the measurement


@dataclass(frozen=True)
class Design:
    """Coatings by name, each with the surfaces that have it, and the ghost power with them by field and batch."""

    kind: str
    layers: int
    coatings: tuple[SharedCoating, ...]
    power: np.ndarray

    def better_than(self, other: Design) -> tuple[float, float]:
        """Ghost power of another design over that of this one, with its standard error; both saw the same rays."""
        return ratio(other.power, self.power)


def ratio(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """Ratio of two sums over fields and batches, (fields, batches) each, and its standard error from the batches."""
    value = above.sum() / below.sum()
    apart = above - value * below
    batches = apart.shape[1]
    return float(value), float(np.sqrt(batches * apart.var(axis=1, ddof=1).sum()) / below.sum())


def ghost_power(coatings: Sequence[SharedCoating], study: Mapping[str, Any], rays: int = RAYS) -> np.ndarray:
    """Ghost power over launched power with some coatings, parts that add up to the mean over the fields, (fields, batches)."""
    (term,) = study["term"]
    band = term["wavelength_nm"]
    lines = np.arange(band["start"], band["stop"] + 1, STEP_NM).tolist()
    with tempfile.TemporaryDirectory() as folder:
        scene = mistray.load(write_recoated(find(SCENE), coatings, Path(folder) / "scene.xml"))
        metric = path_power(
            scene,
            term["selection"],
            fields_deg=term["fields_deg"],
            wavelength_nm=lines,
            rays=rays,
            max_reflections=term["max_reflections"],
            flux_threshold=0,
        )
        parts = []
        for seen in metric.observe(seed=SEED):
            ghosts = np.array([float(path.kind == term["selection"]) for path in seen.trace.paths])
            parts.append(seen.trace.by_batch(ghosts) / seen.launched_W)
    return np.array(parts) / len(parts)


def search(study: Mapping[str, Any], coatings: Sequence[Mapping[str, Any]], folder: Path | None, **options: Any) -> tuple:
    """Coatings that make the ghosts weak, from some start, and the result of the search."""
    own = {**study, "coating": [{"thickness_nm": list(THICKNESS_NM), **coating} for coating in coatings]}
    own["optimizer"] = {**study["optimizer"], **options}
    result = optimize(SCENE, own, verification_seeds=2)
    if folder is not None:
        write_optimization(result, folder)
    return tuple(result.coatings), result


def designs(study: Mapping[str, Any], layers: Sequence[int] = LAYERS, folder: Path | None = None, rays: int = RAYS) -> list[Design]:
    """All textbook coatings and the designs of so many layers for each glass and for each surface."""
    found = []
    for count in PRESETS:
        for name in PRESETS[count]:
            shared = (SharedCoating(name, preset(name), SURFACES),)
            found.append(Design(name, count, shared, ghost_power(shared, study, rays)))
    for count in layers:
        start = {"preset": PRESETS[count][-1]} if count in PRESETS else {"layers": SIX}
        groups = [{"name": name, "surfaces": list(of), **start} for name, of in GLASSES.items()]
        place = None if folder is None else folder / f"glass_{count}"
        by_glass, _ = search(study, groups, place)
        found.append(Design("glass", count, by_glass, ghost_power(by_glass, study, rays)))
        groups = [
            {"name": surface, "surfaces": [surface], "layers": text(coating)}
            for coating in by_glass
            for surface in coating.surfaces
        ]
        place = None if folder is None else folder / f"surface_{count}"
        by_surface, _ = search(study, groups, place, starts=1)
        found.append(Design("surface", count, by_surface, ghost_power(by_surface, study, rays)))
        print(f"{count} layers: {found[-2].power.sum():.4g} by glass, {found[-1].power.sum():.4g} by surface", flush=True)
    return found


def text(coating: SharedCoating) -> str:
    """The layers of a coating, outside first, as in a study; within the bounds that rounding may have left."""
    inside = (np.clip(layer.thickness_nm, *THICKNESS_NM) for layer in coating.stack.layers)
    return ", ".join(f"{layer.material} {d:.6g}" for layer, d in zip(coating.stack.layers, inside, strict=True))


def table(found: Sequence[Design]) -> pd.DataFrame:
    """Each design against the best textbook coating with at most as many layers, and against the shipped coatings."""
    presets = [design for design in found if design.kind not in ("glass", "surface")]
    rows = []
    for design in found:
        power, error = design.power.sum(), np.sqrt(design.power.shape[1] * design.power.var(axis=1, ddof=1).sum())
        row = {"layers": design.layers, "design": design.kind, "power": power, "power_se": error}
        if design not in presets:
            rivals = [other for other in presets if other.layers <= design.layers]
            rival = min(rivals, key=lambda other: other.power.sum())
            times, times_se = design.better_than(rival)
            row |= {"best_preset": rival.kind, "ratio": times, "ratio_se": times_se}
        rows.append(row)
    return pd.DataFrame(rows).sort_values(["layers", "power"], ascending=[True, False], ignore_index=True)

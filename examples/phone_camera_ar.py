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
from matplotlib.ticker import MaxNLocator

import mistray
from mistray.coatings import layer_text, preset, spectrum
from mistray.optimize import optimize, path_power
from mistray.report.optimization import write_optimization
from mistray.report.output import csv_text, write_files
from mistray.report.plots import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
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
SURFACES = tuple(surface for surfaces in GLASSES.values() for surface in surfaces)
MATERIALS = {
    "window": "nd=1.7715 Vd=72.2 k=0",
    "crown": "nd=1.544 Vd=56.1 k=0",
    "flint": "nd=1.632 Vd=23.3 k=0",
    "filter": "nd=1.516 Vd=64.1 k=0",
}
PRESETS = {1: "mgf2_quarter_wave", 2: "v_coat", 3: "bbar3", 4: "bbar4"}  # by the number of layers
# No preset has six: bbar4 with a thin pair between it and the glass
SIX = "1.38 0.2389w, 2.10 0.5079w, 1.38 0.0834w, 2.10 0.0552w, 1.38 0.015w, 2.10 0.02w"
LAYERS = (1, 2, 3, 4, 6)
THICKNESS_NM = (5.0, 260.0)
STARTS = 3  # of the search for each glass; that for each surface goes on from its result
SEED, RAYS, STEP_NM = 1000, 1800, 25  # of the measurement
COLOURS = (SKY, GREEN, ORANGE, PURPLE, BLACK, BLUE)  # by the number of layers


@dataclass(frozen=True)
class Design:
    """
    Coatings of the camera and the ghosts with them.

    Attributes
    ----------
    kind : str
        "glass", "surface", or the name of a preset.
    layers : int
    coatings : tuple of SharedCoating
    power : (fields, batches) float64
        Parts of the ghost power over the launched power; their sum is its mean over the fields.
    """

    kind: str
    layers: int
    coatings: tuple[SharedCoating, ...]
    power: np.ndarray

    @property
    def textbook(self) -> bool:
        """Whether this is one preset on all surfaces."""
        return self.kind not in ("glass", "surface")

    @property
    def ghosts(self) -> tuple[float, float]:
        """Ghost power over launched power, mean over the fields, and its standard error."""
        return float(self.power.sum()), _error(self.power)

    def gain(self, other: Design) -> tuple[float, float]:
        """Ghost power of another design over that of this one, and its standard error; both saw the same rays."""
        ratio = float(other.power.sum() / self.power.sum())
        return ratio, _error(other.power - ratio * self.power) / float(self.power.sum())


def _error(parts: np.ndarray) -> float:
    """Standard error of a sum over fields and batches from the spread over the batches."""
    return float(np.sqrt(parts.shape[1] * parts.var(axis=1, ddof=1).sum()))


def measured(
    kind: str, layers: int, coatings: Sequence[SharedCoating], study: Mapping[str, Any], rays: int = RAYS
) -> Design:
    """A design with its ghosts, on rays that no search has seen."""
    (term,) = study["term"]
    band = term["wavelength_nm"]
    with tempfile.TemporaryDirectory() as folder:
        scene = mistray.load(write_recoated(find(SCENE), coatings, Path(folder) / "scene.xml"))
        metric = path_power(
            scene,
            term["selection"],
            fields_deg=term["fields_deg"],
            wavelength_nm=np.arange(band["start"], band["stop"] + 1, STEP_NM).tolist(),
            rays=rays,
            max_reflections=term["max_reflections"],
            flux_threshold=0,
        )
        parts = []
        for seen in metric.observe(seed=SEED):
            ghosts = np.array([float(path.kind == term["selection"]) for path in seen.trace.paths])
            parts.append(seen.trace.by_batch(ghosts) / seen.launched_W)
    return Design(kind, layers, tuple(coatings), np.array(parts) / len(parts))


def search(
    study: Mapping[str, Any], coatings: Sequence[Mapping[str, Any]], starts: int, folder: Path | None
) -> tuple[SharedCoating, ...]:
    """The coatings that a search from some start ends with; its report goes into the folder."""
    own = {**study, "coating": [{"thickness_nm": list(THICKNESS_NM), **coating} for coating in coatings]}
    own["optimizer"] = {**study["optimizer"], "starts": starts}
    result = optimize(SCENE, own, verification_seeds=2)
    if folder is not None:
        write_optimization(result, folder)
    return tuple(result.coatings)


def designs(
    study: Mapping[str, Any], layers: Sequence[int] = LAYERS, rays: int = RAYS, folder: Path | None = None
) -> list[Design]:
    """
    The presets on all surfaces, and designs of so many layers for each glass and for each surface.

    Parameters
    ----------
    study : mapping
        Term and optimizer.
    layers : sequence of int
    rays : int
        Of the measurement, at each field.
    folder : Path, optional
        For the reports of the searches.
    """
    found = [
        measured(name, count, [SharedCoating(name, preset(name), SURFACES)], study, rays)
        for count, name in PRESETS.items()
    ]
    for count in layers:
        start = {"preset": PRESETS[count]} if count in PRESETS else {"layers": SIX}
        glasses = [{"name": glass, "surfaces": list(surfaces), **start} for glass, surfaces in GLASSES.items()]
        best = search(study, glasses, STARTS, folder and folder / f"glass_{count}")
        found.append(measured("glass", count, best, study, rays))
        single = [
            {"name": surface, "surfaces": [surface], "layers": layer_text(coating.stack.layers)}
            for coating in best
            for surface in coating.surfaces
        ]
        best = search(study, single, 1, folder and folder / f"surface_{count}")
        found.append(measured("surface", count, best, study, rays))
        print(f"{count} layers: {', '.join(f'{d.kind} {d.ghosts[0]:.3g}' for d in found[-2:])}", flush=True)
    return found


def rival(design: Design, found: Sequence[Design]) -> Design:
    """The best preset with at most as many layers."""
    return min((d for d in found if d.textbook and d.layers <= design.layers), key=lambda d: d.ghosts[0])


def table(found: Sequence[Design]) -> pd.DataFrame:
    """Ghost power of all designs; those that were searched against the best preset with at most as many layers."""
    rows = []
    for design in sorted(found, key=lambda d: (d.layers, -d.ghosts[0])):
        power, power_se = design.ghosts
        row: dict[str, Any] = {"layers": design.layers, "design": design.kind, "ghosts": power, "ghosts_se": power_se}
        if not design.textbook:
            other = rival(design, found)
            gain, gain_se = design.gain(other)
            row |= {"preset": other.kind, "gain": gain, "gain_se": gain_se}
        rows.append(row)
    return pd.DataFrame(rows)


def curve_figure(found: Sequence[Design]) -> Figure:
    """Ghost power against the number of layers."""
    figure = Figure(figsize=(6.4, 4.2), dpi=110, layout="constrained")
    axes = figure.subplots()
    for kind, colour, label in (("glass", BLUE, "one design per glass"), ("surface", VERMILION, "one per surface")):
        chosen = [design for design in found if design.kind == kind]
        power, power_se = np.array([design.ghosts for design in chosen]).T
        axes.errorbar(
            [d.layers for d in chosen], power, power_se, fmt="o-", ms=4, lw=1.2, capsize=3, color=colour, label=label
        )
    for design in found:
        if design.textbook:
            axes.errorbar(design.layers, *design.ghosts, fmt="s", ms=5, capsize=3, color=BLACK)
            axes.annotate(
                design.kind, (design.layers, design.ghosts[0]), (6, 4), textcoords="offset points", fontsize=8
            )
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("layers on every surface")
    axes.set_ylabel("ghost power over launched power")
    axes.grid(True, which="both", color="#dddddd", lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False)
    figure.supxlabel("mean over 8 fields, 450 to 650 nm; bars: one standard error", fontsize=7.5, color="#555555")
    return figure


def reflectance_figure(found: Sequence[Design]) -> Figure:
    """R(λ) at 20° of the designs for each glass, and of the presets on it."""
    figure = Figure(figsize=(10.4, 6.4), dpi=110, layout="constrained")
    wavelengths = np.arange(430, 671, 2.0)
    for axes, (glass, material) in zip(figure.subplots(2, 2).flat, MATERIALS.items(), strict=True):
        for design in found:
            style = {"color": COLOURS[min(design.layers, len(COLOURS)) - 1], "ls": "--" if design.textbook else "-"}
            for coating in design.coatings:
                if design.kind != "surface" and set(GLASSES[glass]) <= set(coating.surfaces):
                    shown = spectrum(coating.stack, wavelengths, [20], "air", material).mean()[:, 0]
                    label = design.kind if design.textbook else f"{design.layers}, searched"
                    axes.plot(wavelengths, 100 * shown, lw=1.2, label=label, **style)
        axes.axvspan(450, 650, color="#f0f0f0", zorder=0)
        axes.set_title(f"{glass}, {material.removesuffix(' k=0')}", fontsize=10)
        axes.set_xlim(wavelengths[0], wavelengths[-1])
        axes.set_ylim(0, 3)
        axes.set_xlabel("wavelength [nm]")
        axes.set_ylabel("reflectance at 20° [%]")
        axes.grid(True, color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    return figure


def main(folder: Path) -> None:
    """Search all designs, write reports, table and pictures."""
    started = time.perf_counter()
    found = designs(tomllib.loads(STUDY.read_text()), folder=folder)
    rows = table(found)
    write_files({"layers.csv": csv_text(rows)}, folder)
    curve_figure(found).savefig(folder / "layers.png")
    reflectance_figure(found).savefig(folder / "reflectance.png")
    print(rows.to_string(index=False, float_format="%.4g", na_rep=""))
    print(f"{time.perf_counter() - started:.0f} s in all; results in {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/phone_camera_ar"))

"""Antireflection coatings of the phone camera against its ghosts, with the number of layers as the price.

For 1, 2, 3, 4 and 6 layers two designs are sought: one for each glass, and one for each surface. The gradient of the
ghosts by the reflectances of all surfaces, at all wavelengths and angles, says what every surface is worth; with it the
designs are found on the host. All are then traced beside the textbook coatings, on rays and at wavelengths that no
search has seen. Run from anywhere, on two cores it takes some minutes:
python examples/phone_camera_ar.py [folder for the results]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

import mistray
from mistray.analyses.optimize.reflectance_weights import ReflectanceWeights, best_thicknesses, reflectance_weights
from mistray.coatings import Stack, parse_layers, preset, spectrum
from mistray.optimize import Metric, path_power
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from mistray.toolkit.pages.output import csv_text, write_files

SCENE = "phone_camera"
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
TEXTBOOK = ("mgf2_quarter_wave", "v_coat", "bbar3", "bbar4")  # presets of 1, 2, 3 and 4 layers
# By the number of layers, with the materials of the presets; no preset has six
LAYERS = {
    1: "1.38 0.25w",
    2: "1.38 0.318w, 2.10 0.067w",
    3: "1.38 0.25w, 2.10 0.5w, 1.63 0.25w",
    4: "1.38 0.2389w, 2.10 0.5079w, 1.38 0.0834w, 2.10 0.0552w",
    6: "1.38 0.2389w, 2.10 0.5079w, 1.38 0.0834w, 2.10 0.0552w, 1.38 0.05w, 2.10 0.05w",
}
STARTS = {count: Stack(parse_layers(text, 550.0)) for count, text in LAYERS.items()}
LOW_NM, HIGH_NM = 5.0, 260.0  # of a layer
ROUNDS = 2
FIELDS_DEG = (0, 5, 10, 15, 20, 25, 26, 27)
SEARCH_NM, SEARCH_RAYS = (450, 500, 550, 600, 650), 320
BAND_NM = tuple(range(450, 651, 25))
SEED, RAYS = 1000, 1800  # of the measurement, the rays at each field
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


def ghost_metric(coatings: Sequence[SharedCoating], wavelength_nm: Sequence[float], rays: int) -> Metric:
    """Ghost power over launched power with some coatings on the camera, mean over the fields."""
    with tempfile.TemporaryDirectory() as folder:
        scene = mistray.load(write_recoated(find(SCENE), coatings, Path(folder) / "scene.xml"))
    traced = {"max_reflections": 2, "flux_threshold": 0, "rays": rays}
    return path_power(scene, "ghost", field_deg=FIELDS_DEG, wavelength_nm=wavelength_nm, **traced)


def measured(kind: str, layers: int, coatings: Sequence[SharedCoating], rays: int) -> Design:
    """A design with its ghosts, on rays and at wavelengths that no search has seen."""
    observations = ghost_metric(coatings, BAND_NM, rays).observe(seed=SEED)
    parts = []
    for seen in observations:
        ghosts = [path.path_id for path in seen.trace.paths if path.kind == "ghost"]
        parts.append(seen.trace.paths.light(ghosts).by_batch / seen.launched_W)
    return Design(kind, layers, tuple(coatings), np.array(parts) / len(parts))


def search(groups: Mapping[str, Sequence[str]], start: Stack, known: ReflectanceWeights) -> tuple[SharedCoating, ...]:
    """
    A design of its own for each group of surfaces: least sum of weight times R, then again with the weights there.

    The ghosts are linear in R but for those between two lens surfaces, so that two rounds suffice; the better counts.
    """
    stacks = dict.fromkeys(groups, start)
    best = np.inf, ()
    for _ in range(ROUNDS):
        for name, surfaces in groups.items():
            cost = known.cost(surfaces, start)
            given = [
                np.clip([layer.thickness_nm for layer in stack.layers], LOW_NM, HIGH_NM)
                for stack in {start, stacks[name]}
            ]
            low, high = (np.full(len(start.layers), bound) for bound in (LOW_NM, HIGH_NM))
            thickness = best_thicknesses(cost, low, high, given)
            layers = (replace(one, thickness_nm=float(d)) for one, d in zip(start.layers, thickness, strict=True))
            stacks[name] = replace(start, layers=tuple(layers))
        coatings = tuple(SharedCoating(name, stacks[name], tuple(surfaces)) for name, surfaces in groups.items())
        known = reflectance_weights(ghost_metric(coatings, SEARCH_NM, SEARCH_RAYS))
        best = min(best, (known.value, coatings), key=lambda pair: pair[0])
    return best[1]


def designs(layers: Sequence[int] = tuple(STARTS), rays: int = RAYS) -> list[Design]:
    """
    The presets on all surfaces, and designs of so many layers for each glass and for each surface.

    Parameters
    ----------
    layers : sequence of int
        Keys of `STARTS`.
    rays : int
        Of the measurement, at each field.
    """
    found = [
        measured(name, len(stack.layers), [SharedCoating(name, stack, SURFACES)], rays) for name, stack in textbook()
    ]
    ready = SharedCoating("start", STARTS[3], SURFACES)
    known = reflectance_weights(ghost_metric([ready], SEARCH_NM, SEARCH_RAYS))
    for count in layers:
        for kind, groups in (("glass", GLASSES), ("surface", {surface: (surface,) for surface in SURFACES})):
            found.append(measured(kind, count, search(groups, STARTS[count], known), rays))
            print(f"{count} layers per {kind}: ghosts {found[-1].ghosts[0]:.3g}", flush=True)
    return found


def textbook() -> Iterator[tuple[str, Stack]]:
    """The transparent presets."""
    for name in TEXTBOOK:
        yield name, preset(name)


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
    lines = ("glass", "o-", BLUE, "one design per glass"), ("surface", "s--", VERMILION, "one per surface")
    for kind, mark, colour, label in lines:
        chosen = [design for design in found if design.kind == kind]
        power, power_se = np.array([design.ghosts for design in chosen]).T
        style = {"ms": 8, "mfc": "none", "capsize": 3, "lw": 1.2, "color": colour, "label": label}
        axes.errorbar([d.layers for d in chosen], power, power_se, fmt=mark, **style)
    for design in found:
        if design.textbook:
            axes.errorbar(design.layers, *design.ghosts, fmt="D", ms=5, capsize=3, color=BLACK)
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
        axes.set_ylim(0, 1.8)
        axes.set_xlabel("wavelength [nm]")
        axes.set_ylabel("reflectance at 20° [%]")
        axes.grid(True, color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    return figure


def main(folder: Path) -> None:
    """Search all designs, write scenes, table and pictures."""
    started = time.perf_counter()
    found = designs()
    rows = table(found)
    folder.mkdir(parents=True, exist_ok=True)
    for design in found:
        note = f"{design.layers} layers, {design.kind}: ghosts {design.ghosts[0]:.3g} of the launched power"
        write_recoated(find(SCENE), design.coatings, folder / f"{design.kind}_{design.layers}.xml", note)
    write_files({"layers.csv": csv_text(rows)}, folder)
    curve_figure(found).savefig(folder / "layers.png")
    reflectance_figure(found).savefig(folder / "reflectance.png")
    print(rows.to_string(index=False, float_format="%.4g", na_rep=""))
    print(f"{time.perf_counter() - started:.0f} s in all; results in {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/phone_camera_ar"))

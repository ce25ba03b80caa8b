"""A lens is bent so that the ghost of a window leaves its focus, while the image stays as it is.

The scene is lens_and_window, the study lens_bending.toml. Run from anywhere, on two cores it takes a minute or two:
python examples/lens_bending.py [folder for the results]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from matplotlib.figure import Figure

import mistray
from mistray.analyses.optimize.page import write_optimization
from mistray.analyses.optimize.tables import report_text
from mistray.metrics.scene_values import assign
from mistray.optimize import Observation, optimize

SCENE = "lens_and_window"
STUDY = Path(__file__).with_name("lens_bending.toml")
FIELD_DEG = 0.5
FACES = ("L1_front.curvature", "L1_rear.curvature")
SEEDS = (101, 102, 103)
HALF_MM = 0.8  # of the pictures


def is_ghost(row: Any) -> bool:
    """The ghosts of the study: from a face of the window to the front of the lens."""
    return bool(row.kind == "ghost" and row.ghost_1.startswith("window") and row.ghost_2 == "L1_front")


def bending_scan(shifts: np.ndarray, rays: int = 1000) -> np.ndarray:
    """
    RMS radii over a change of both curvatures, which keeps the power of a thin lens; the detector follows the focus.

    Parameters
    ----------
    shifts : (n,) float
        1/mm.

    Returns
    -------
    (n, 3) float64
        Of the image, of the ghost by the front of the window and of that by its rear, mm; NaN where none is met.
    """
    scene = mistray.load(SCENE)
    params = mi.traverse(scene)
    start = {key: np.array(params[key]) for key in FACES}
    found = np.full((len(shifts), 3), np.nan)
    for k, shift in enumerate(shifts):
        bent = {key: value + shift for key, value in start.items()}
        squares, places = [], np.array([-0.2, 0.0, 0.2])
        for z in places:  # the mean square of a spot is a parabola over the focus
            assign(params, {**bent, "detector.z": np.array([z])})
            traced = Observation(mistray.trace(scene, rays=rays, field_deg=FIELD_DEG, max_reflections=0))
            squares.append(float(traced.moments("direct").variance[0]))
        a, b, _ = np.polyfit(places, squares, 2)
        assign(params, {"detector.z": np.array([-b / (2 * a)])})
        traced = Observation(mistray.trace(scene, rays=rays, field_deg=FIELD_DEG, flux_threshold=0))
        found[k, 0] = float(traced.moments("direct").rms_radius[0])
        for column, face in ((1, "window_front"), (2, "window_rear")):
            path = [row for row in traced.trace.paths if is_ghost(row) and row.ghost_1 == face]
            found[k, column] = path[0].rms_radius_mm if path else np.nan
    return found


def maps(scene: Any, rays: int = 50_000) -> dict[str, Any]:
    """Mean irradiance over `SEEDS` of the ghosts and of the image, (height, width) W/mm², and their peaks by seed."""
    found: dict[str, Any] = {"ghost": [], "direct": []}
    for seed in SEEDS:
        traced = Observation(mistray.trace(scene, rays=rays, seed=seed, field_deg=FIELD_DEG, flux_threshold=0))
        for name, selection in (("ghost", is_ghost), ("direct", "direct")):
            found[name].append(np.array(traced.map(selection)).reshape(traced.trace.irradiance.shape))
    result: dict[str, Any] = {"extent": traced.trace.extent}
    for name, images in found.items():
        result |= {name: np.mean(images, axis=0), f"{name} peaks": np.array([image.max() for image in images])}
    return result


def picture(before: dict[str, Any], after: dict[str, Any]) -> Figure:
    """Ghost and image before and after, each with one logarithmic scale."""
    figure, axes = plt.subplots(2, 2, figsize=(8.5, 7.6), layout="constrained")
    for row, name in enumerate(("ghost", "direct")):
        half = HALF_MM if name == "ghost" else 0.1
        top = max(before[name].max(), after[name].max())
        for axis, when, found in zip(axes[row], ("before", "after"), (before, after), strict=True):
            *_, y0, y1 = found["extent"]
            height = len(found[name])
            y = y0 + (y1 - y0) * (np.arange(height) + 0.5) / height
            centre = float((found[name].sum(axis=1) * y).sum() / found[name].sum())
            image = axis.imshow(
                found[name],
                origin="lower",
                extent=found["extent"],
                norm="log",
                vmin=top * 1e-4,
                vmax=top,
                cmap="inferno",
                interpolation="nearest",
            )
            axis.set_facecolor("black")
            axis.set(xlim=(-half, half), ylim=(centre - half, centre + half), xlabel="x [mm]", ylabel="y [mm]")
            axis.set_title(f"{'ghost' if name == 'ghost' else 'image'} {when}, peak {found[name].max():.3g} W/mm²")
        figure.colorbar(image, ax=axes[row], label="irradiance [W/mm²]")
    return figure


def scan_picture(shifts: np.ndarray, radii: np.ndarray) -> Figure:
    """RMS radii over the bending."""
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    for column, name in enumerate(("image", "ghost by window_front", "ghost by window_rear")):
        axis.semilogy(1e3 * shifts, 1e3 * radii[:, column], marker=".", label=name)
    axis.axvline(0, color="grey", lw=0.8, ls=":")
    axis.set(xlabel="change of both curvatures [1/m]", ylabel="RMS radius [µm]", title="in the focus of the image")
    axis.legend()
    return figure


def main(folder: Path) -> None:
    """Scan, optimise, verify with maps on other seeds, draw."""
    started = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    shifts = np.linspace(-1.5e-3, 1.5e-3, 13)
    scan_picture(shifts, bending_scan(shifts)).savefig(folder / "scan.png", dpi=150)
    result = optimize(SCENE, STUDY)
    write_optimization(result, folder)
    print(report_text(result))
    before, after = (maps(mistray.load(scene)) for scene in (SCENE, folder / "scene.xml"))
    picture(before, after).savefig(folder / "ghost.png", dpi=150)
    ratios = before["ghost peaks"] / after["ghost peaks"]
    print(f"\npeak irradiance of the ghosts [W/mm²] at {FIELD_DEG:g}°, pixels of 20 µm, {len(SEEDS)} seeds")
    print(f"before {before['ghost peaks'].round(3)}, after {after['ghost peaks'].round(4)}: {ratios.round(1)} x lower")
    print(f"{time.perf_counter() - started:.0f} s in all; results in {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/lens_bending"))

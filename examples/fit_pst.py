"""The inverse problem: roughness, cleanliness and the reflectance of a paint from a noisy PST, and how well known.

The scene is lens_and_screen. The measurement is made up: a run with rays of its own at values that the fit does not
know, and noise of 5 %, in 400 draws. Run from anywhere, on two cores it takes a few minutes:
python examples/fit_pst.py [folder for the results]
"""

from __future__ import annotations

import sys
import time
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

import mistray
from mistray.optimize import Evaluations, Fit, PstBands, fit

SCENE = "lens_and_screen"
KEYS = ("polish.rms_nm", "dust.level", "black.reflectance")
TRUTH = {"polish.rms_nm": 1.5, "dust.level": 300.0, "black.reflectance": 0.04}
START = {"polish.rms_nm": 1.9, "dust.level": 270.0, "black.reflectance": 0.05}
EDGES_DEG = (4, 6, 9, 13, 18, 24, 31, 39, 48)
AZIMUTHS_DEG = (0, 180)  # the lens lights the screen, and it does not
NOISE = 0.05  # of each datum, relative
RAYS, RAYS_OF_DATA = 120_000, 400_000
DRAWS, SEED_OF_DATA = 400, 1000
SETTLED = 2.0  # in its scales a PST of single scatter is nearly linear


@cache
def scene() -> Any:
    """The scene; what it holds is set by every model."""
    return mistray.load(SCENE)


def curve(rays: int, seed: int) -> PstBands:
    """The PST in bands at both azimuths, by the three parameters."""
    return PstBands(scene(), KEYS, EDGES_DEG, azimuths_deg=AZIMUTHS_DEG, rays=rays, seed=seed, max_scatters=1)


@cache
def measured() -> tuple[np.ndarray, np.ndarray]:
    """The PST at the truth, (n,), and the covariance of the noise of its run."""
    return curve(RAYS_OF_DATA, SEED_OF_DATA).measure([TRUTH[key] for key in KEYS])


@cache
def model() -> Evaluations:
    """The model, which all draws share; each of its evaluations has rays of its own."""
    seeds = count()
    return Evaluations(lambda values: curve(RAYS, next(seeds))(values), SETTLED)


def measurement(draw: int) -> tuple[np.ndarray, np.ndarray]:
    """Data of a draw, (n,), and the covariance of their noise, (n, n), that of the run that made them included."""
    value, covariance = measured()
    noise = np.random.default_rng(draw).standard_normal(len(value))
    return value * (1 + NOISE * noise), covariance + np.diag(np.square(NOISE * value))


def estimate(draw: int) -> Fit:
    """The fit to a draw."""
    about = curve(RAYS, 0)
    return fit(model(), *measurement(draw), START, low=about.low, high=about.high, power=about.power)


def fit_picture(found: Fit, bands: list[Any], observed: np.ndarray, noise: np.ndarray) -> Figure:
    """Data, fit and residuals in standard deviations."""
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, height_ratios=(3, 1), figsize=(7, 6), layout="constrained")
    middle = np.array([(low + high) / 2 for _, low, high in bands])
    half = np.array([(high - low) / 2 for _, low, high in bands])
    for k, azimuth in enumerate(AZIMUTHS_DEG):
        here = np.array([band[0] == azimuth for band in bands])
        error = np.sqrt(np.diag(noise))[here]
        label = f"data, {azimuth}°"
        top.errorbar(middle[here], observed[here], error, half[here], "o", ms=3, color=f"C{k}", label=label)
        top.plot(middle[here], (observed - found.residual)[here], color=f"C{k}", label=f"fit, {azimuth}°")
        bottom.plot(middle[here], found.residual[here] / np.sqrt(np.diag(found.noise))[here], "o", color=f"C{k}", ms=4)
    top.set(yscale="log", ylabel="PST_normal of stray light")
    top.legend(title="azimuth")
    bottom.axhline(0, color="grey", lw=0.8)
    bottom.set(xlabel="field angle [deg]", ylabel="residual / σ", ylim=(-4, 4))
    return figure


def region_picture(found: Fit) -> Figure:
    """95 % regions of each pair of parameters (χ² with 2 degrees of freedom), in per cent of the truth."""
    pairs = [(0, 1), (0, 2), (1, 2)]
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
    relative = found.standard_error / found.value
    covariance = found.correlation * np.outer(relative, relative)
    names = ("roughness", "cleanliness level", "reflectance")
    for axis, (i, j) in zip(axes, pairs, strict=True):
        centre = 100 * np.array([np.log(found.estimate[KEYS[k]] / TRUTH[KEYS[k]]) for k in (i, j)])
        size, turn = np.linalg.eigh(covariance[np.ix_((i, j), (i, j))])
        width, height = 2 * 100 * np.sqrt(5.991 * size)
        angle = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
        axis.add_patch(Ellipse(tuple(centre), width, height, angle=angle, fill=False, color="C0"))
        axis.plot(*centre, "o", color="C0", label="estimate")
        axis.plot(0, 0, "x", color="C3", label="truth")
        axis.set(xlabel=f"{names[i]} / truth, ln [%]", ylabel=f"{names[j]} / truth, ln [%]")
        axis.autoscale_view()
    axes[0].legend()
    return figure


def main(folder: Path) -> None:
    """One fit with pictures, then the draws."""
    started = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    found = estimate(0)
    print(f"{found}\ncorrelations\n{found.correlation.round(2)}")
    observed, noise = measurement(0)
    fit_picture(found, curve(RAYS, 0).bands, observed, noise).savefig(folder / "fit.png", dpi=150)
    region_picture(found).savefig(folder / "regions.png", dpi=150)
    fits = [found, *(estimate(draw) for draw in range(1, DRAWS))]
    inside = sum(one.covers(TRUTH) for one in fits)
    distances = np.array([one.distance(TRUTH) for one in fits])
    print(f"truth inside the 95 % region in {inside} of {DRAWS} draws; mean χ² {distances.mean():.2f}, expected 3")
    print(f"{len(model().points)} evaluations of the model in all")
    print(f"{time.perf_counter() - started:.0f} s in all; results in {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/fit_pst"))

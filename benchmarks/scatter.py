"""Scatter: segments per second of the scattering phone camera, and samples per second of every scatter plugin.

A sample is a call of the plugin's own `sample` for one ray: a direction, its density and its weight, at incidences from
0° to 85°. ``python benchmarks/scatter.py`` prints the rows alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import drjit as dr
import mitsuba as mi
import numpy as np
from rows import REPEATS, Row, alternate

import mistray
from mistray.execute.tracer import prepare
from mistray.recorders.tallies import SEGMENTS
from mistray.scatter.abg import ABg
from mistray.scatter.measured.zemax_bsdf import write_zemax_bsdf
from mistray.scatter.scan import table
from mistray.settings import Settings

SEGMENTS_BAR = 1e7
SAMPLES_BAR = 5e7
SAMPLES = 1 << 22
MODELS: dict[str, dict[str, object]] = {
    "abg, B = 1e-3": {"type": "abg", "A": 2.5e-3, "B": 1e-3, "g": 1.8},
    "abg, B = 1e-9": {"type": "abg", "A": 1e-9, "B": 1e-9, "g": 2.0},
    "harvey_shack": {"type": "harvey_shack", "rms_nm": 4.0, "l": 0.01, "s": -1.5},
    "k_correlation": {"type": "k_correlation", "rms_nm": 4.0, "B_um": 100.0, "slope": 2.5},
    "gaussian_lobe": {"type": "gaussian_lobe", "total": 0.01, "width": 0.01},
    "particulate": {"type": "particulate", "level": 400.0},
    "paint": {"type": "paint", "reflectance": 0.05, "b0": 0.2, "l": 0.1, "s": -2.0},
    "paint with n": {"type": "paint", "reflectance": 0.05, "b0": 0.2, "l": 0.1, "s": -2.0, "n": 1.5},
}


def per_second(rate: float) -> str:
    return f"{rate / 1e6:.1f} M/s"


def scattering_camera(rays: int, repeats: int) -> list[Row]:
    """The ray tree of the phone camera with polish, dust and paint, aimed by itself; and without the path table."""
    scene = mistray.load("phone_camera_scatter")
    run = prepare(scene, Settings(rays=rays))[0].execute(True)
    with_table, without = alternate(lambda: run.execute(True), lambda: run.execute(False), repeats=repeats)
    segments = float(run.sums.channels[SEGMENTS].sum())
    rates = {"on": segments / with_table.seconds, "off": segments / without.seconds}
    return [
        Row(
            f"camera-{state}",
            f"`phone_camera_scatter`, path table {state}, against the bar (segments/s)",
            per_second(rate),
            per_second(SEGMENTS_BAR),
            rate / SEGMENTS_BAR,
            1.0 if state == "on" else None,
        )
        for state, rate in rates.items()
    ]


def sampler(properties: dict[str, object], count: int) -> Callable[[], None]:
    """Draw directions from a plugin."""
    bsdf = mi.load_dict(properties)
    rng = np.random.default_rng(0)
    theta = rng.uniform(0, np.radians(85), count)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(np.sin(theta), 0, -np.cos(theta))
    first, second = mi.Float(rng.random(count)), mi.Point2f(rng.random((2, count)))
    context = mi.BSDFContext()
    dr.eval(si, first, second)

    def action() -> None:
        found, weight = bsdf.sample(context, si, first, second)
        dr.eval(found.wo, found.pdf, weight)
        dr.sync_thread()

    return action


def scatter_samples(count: int, repeats: int) -> list[Row]:
    """Every model against the bar; two models share a line of time so that each is measured in turn with another."""
    mistray.ensure_variant()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "measured.bsdf"
        write_zemax_bsdf(table(ABg(2.5e-3, 1e-3, 1.8), [0, 15, 30, 45, 60, 75], "specular"), path)
        samplers = {name: sampler(properties, count) for name, properties in MODELS.items()}
        samplers["tabulated"] = sampler({"type": "tabulated", "file": str(path)}, count)
    result, names = [], list(samplers)
    for k in range(0, len(names), 2):
        pair = names[k], names[(k + 1) % len(names)]  # the last of an odd number has the first beside it again
        times = alternate(*(samplers[name] for name in pair), repeats=repeats)
        for name, timing in zip(names[k : k + 2], times, strict=False):
            rate = count / timing.seconds
            result.append(
                Row(
                    f"samples-{name}",
                    f"scatter sampling, {name}, against the bar (samples/s)",
                    per_second(rate),
                    per_second(SAMPLES_BAR),
                    rate / SAMPLES_BAR,
                    1.0,
                )
            )
    return result


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `scatter`."""
    repeats = 1 if quick else REPEATS
    yield from scattering_camera(1 << (9 if quick else 15), repeats)
    yield from scatter_samples(1 << 12 if quick else SAMPLES, repeats)


if __name__ == "__main__":
    print(*rows(False), sep="\n")

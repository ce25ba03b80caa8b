"""Every printed standard error against the spread of repeated runs; as a script, with [SEEDS [WORD …]], the table."""

import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))

import scene_dicts

import mistray
from mistray.analyses.pst.glare import glare, ratios
from mistray.analyses.pst.glare.extended_source import Disc, SkyRadiance, source_irradiance
from mistray.metrics import metric as metrics
from mistray.recorders.direction_recorder import CLASSES

SEEDS = 100
Entry = tuple[str, str, float, float]  # kind, name, value, standard error
Entries = Iterator[Entry]
NUMBERS = {"power": ("power_W", "power_se_W"), "percent": ("percent", "percent_se"), "centroid": ("y_mm", "y_se_mm")}
NUMBERS["RMS radius"] = "rms_radius_mm", "rms_radius_se_mm"
NUMBERS["RMS irradiance"] = "rms_irradiance_W_mm2", "rms_irradiance_se_W_mm2"
SHAPES = ("centroid", "RMS radius", "RMS irradiance")
FEW = 100  # rays, below which the shape of a path is not compared: its distribution is far from normal


def painted_screen(pixels: int = 8) -> mi.Scene:
    """A beam on a painted screen and a detector beside it, in whose pixels many scattered rays of one start land."""
    place = mi.ScalarTransform4f().look_at([6, 0, -6], [0, 0, 0], [0, 1, 0])
    paint = {"type": "interface", "R": 0.0, "m": {"type": "paint", "reflectance": 0.5}}
    meter = {"to_world": place, "sensor": scene_dicts.meter(pixels)}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0},
        screen={"type": "asphere", "semi_diameter": 5.0, "bsdf": paint},
        detector=scene_dicts.detector(0.0, half_width=5.0, half_height=5.0, **meter),
    )


def rows_of(table: pd.DataFrame, kind: str = "", wavelength: bool = True) -> Entries:
    for row in table.itertuples():
        way = f"{row.wavelength_nm if wavelength else 0:.0f} {row.events}"
        for name, (value, se) in NUMBERS.items():
            if name not in SHAPES or (row.rays >= FEW and row.rms_radius_mm >= 1e-6):
                yield f"{kind}{name}", way, getattr(row, value), getattr(row, se)


def pixels_of(kind: str, value: np.ndarray, se: np.ndarray, of: float = 0.0) -> Entries:
    for place in np.argwhere((value > 0) & np.isfinite(se)):
        yield kind, f"{of:g} {tuple(place.tolist())}", float(value[tuple(place)]), float(se[tuple(place)])


def estimate(kind: str, name: str, found: Any) -> Entry:
    return kind, name, float(found.value), float(found.se)


def of_trace(scene: mi.Scene, seed: int, again: bool = True, **settings: Any) -> Entries:
    t = mistray.trace(scene, seed=seed, **settings)
    yield from rows_of(t.paths.by_way())
    yield from pixels_of("pixel", t.irradiance, t.irradiance_se)
    for kind, name, of, ends in (
        *(("surface", f"{row.id} ", row, ("incident", "absorbed")) for row in t.surfaces),
        ("energy", "", t.energy, ("detected", "escaped")),
    ):
        yield from ((kind, name + end, getattr(of, f"{end}_W"), getattr(of, f"{end}_se_W")) for end in ends)
    if not again:
        return
    frame = t.paths.to_pandas()
    yield from pixels_of("pixel of paths", *t.irradiance_of(list(frame.path_id[frame.kind != "direct"])))
    x0, x1, y0, y1 = t.extent
    middle = t.box(0.4 * x0, 0.4 * x1, 0.4 * y0, 0.4 * y1).by_way()
    yield from (entry for entry in rows_of(middle, "box ") if "box power" in entry or "box percent" in entry)


def of_ghosts(scene: mi.Scene, seed: int, field_deg: tuple[float, ...], **settings: Any) -> Entries:
    report = mistray.ghosts(scene, field_deg=field_deg, seed=seed, **settings)
    yield estimate("ghost summary", "nominal power", report.nominal.power_W)
    yield estimate("ghost summary", "nominal radius", report.nominal.rms_radius_mm)
    yield estimate("ghost summary", "nominal density", report.nominal.rms_irradiance_W_mm2)
    for field in field_deg:
        table = report.table(field)
        for kind, *rest in rows_of(table, "ghost ", wavelength=False):
            yield kind, f"{field:g} {rest[0]}", *rest[1:]
        for row in table.itertuples():
            name = f"{field:g} {row.events}"
            if row.kind != "direct":
                yield "ghost percent of stray", name, row.percent_of_stray, row.percent_of_stray_se
            if row.rays >= FEW:
                yield "ghost normalised", name, row.normalised_rms_irradiance, row.normalised_rms_irradiance_se
        one = report.summary(field)
        for name in ("stray_W", "ghost_to_signal", "stray_to_nominal"):
            yield estimate("ghost summary", f"{field:g} {name}", getattr(one, name))
        yield from pixels_of("ghost pixel", *report.stray_map(field), field)
        for row in report.scatter_surfaces(field).itertuples():
            yield "ghost scatter surface", f"{field:g} {row.surface}", row.power_W, row.power_se_W


def of_image(scene: mi.Scene, seed: int, **settings: Any) -> Entries:
    t = mistray.trace(scene, seed=seed, **settings)
    yield estimate("trace metric", "ghost to signal", glare.ghost_to_signal(t)[0])
    spread = glare.glare_spread(t)
    yield from pixels_of("trace metric pixel", spread.value, spread.se)


def of_pst(scene: mi.Scene, seed: int, angles: list[float], maps: int = 0, **settings: Any) -> Entries:
    more = {"map_pixels": maps} if maps else {}
    p = mistray.pst(scene, field_deg=angles, seed=seed, **more, **settings)
    for name in ("total", *CLASSES):
        for angle, value, se in zip(p.field_deg, *p.curve(name), strict=True):
            if value > 0:
                yield "PST by class", f"{name} {angle:g}", value, se
    sky = SkyRadiance(to_deg=float(angles[-1]))
    for name, found in {
        "sky": source_irradiance(p, sky),
        "disc": source_irradiance(p, Disc(4.0, 1.0, angles[len(angles) // 2])),
        "vgi": glare.veiling_glare_index(p, 4.0, source_deg=angles[-1], place="mean"),
        "throughput": ratios.image_throughput(p),
        "radiance": ratios.equivalent_stray_radiance(p, sky),
        "stray to signal": ratios.stray_to_signal(p, sky, 1.0),
    }.items():
        yield estimate("PST metric", name, found)
    curve = ratios.rejection_ratio(p, reference_deg=float(angles[2]))  # that of 0° has few rays: a ratio would be skew
    for angle, value, se in zip(curve.field_deg, curve.value, curve.se, strict=True):
        if se > 0:
            yield "PST metric", f"psrr {angle:g}", value, se
    if maps:
        at_a_place = glare.veiling_glare_index(p, 4.0, source_deg=angles[-1], at_mm=(1.0, 1.0))
        yield estimate("PST map metric", "vgi", at_a_place)
        for angle in angles[2:4]:
            yield from pixels_of("PST pixel", *p.irradiance(angle), angle)


def of_objects(scene: mi.Scene, seed: int, **settings: Any) -> Entries:
    found = mistray.objects(scene, seed=seed, **settings)
    for which in ("critical", "illuminated"):
        for row in getattr(found, which):
            if row.rays >= FEW:
                yield "object power", f"{which} {row.id} {row.side}", row.power, row.power_se
    for shot in found.straight_shots:
        if shot.rays >= FEW:
            yield "straight shot", " ".join(shot.surfaces), shot.share, shot.share_se
    for row in found.estimates().itertuples():
        name = f"{row.angle_deg:g} {row.id} {row.side}"
        yield "object flux", name, row.flux_W, row.flux_W_se
        if row.detector_W > 0:
            yield "object PST", name, row.pst, row.pst_se


def of_gradient(scene: mi.Scene, seed: int, keys: list[str], chosen: tuple[str, ...], **settings: Any) -> Entries:
    params = mi.traverse(scene)
    made: dict[str, Callable[..., metrics.Metric]] = {
        "ghost power": metrics.path_power, "ghost to signal": metrics.ghost_to_signal,
        "peak": metrics.peak_irradiance, "transmission": metrics.transmission, "spot": metrics.rms_spot,
    }  # fmt: skip
    for name in chosen:
        g = mistray.gradient(made[name](scene, seed=seed, **settings), params, keys=keys)
        yield "gradient value", name, g.value, g.value_se
        for key, values in g.gradient.items():
            for k, value in enumerate(values):
                if value:
                    yield "gradient", f"{name} {key} {k}", value, g.standard_error[key][k]


def of_thermal(scene: mi.Scene, seed: int, **settings: Any) -> Entries:
    report = mistray.thermal(scene, seed=seed, **settings)
    for e in report.emitters:
        if e.hits >= FEW:
            yield estimate("thermal", f"{e.name} emission", e.emission)
            yield estimate("thermal", f"{e.name} irradiance", e.irradiance_W_mm2)
            if e.kind == "surface":
                yield estimate("thermal", f"{e.name} share", e.share)
    yield estimate("thermal", "total", report.total_W_mm2)
    yield estimate("thermal", "scene", report.scene_W_mm2)


@dataclass(frozen=True)
class Case:
    """What is repeated: entries of a scene, shipped (by name) or made, at some settings."""

    entries: Callable[..., Entries]
    scene: str | Callable[[], mi.Scene]
    settings: dict[str, Any]

    def load(self) -> mi.Scene:
        return mistray.load(self.scene) if isinstance(self.scene, str) else self.scene()


def case(entries: Callable[..., Entries], scene: str | Callable[[], mi.Scene], **settings: Any) -> Case:
    return Case(entries, scene, settings)


TRIPLET, SCATTERED, GAUSS = "cooke_triplet", "newtonian_scatter", "double_gauss"
KEYS = ["*.bsdf.R", "*curvature", "*semi_diameter"]
LIMITS = {"keys": KEYS, "rays": 4000, "max_reflections": 2}
LIGHT = ("ghost power", "ghost to signal", "peak", "transmission")
SPOT = "gradients of a spot"
CASES = {
    "scattered paths": case(of_trace, SCATTERED, rays=5000, field_deg=5.0, max_reflections=1, max_scatters=2),
    "painted screen": case(of_trace, painted_screen, rays=2000, aimed_rays=16),
    "ghost paths": case(of_trace, GAUSS, rays=4000, field_deg=5.0, wavelength_nm=[480.0, 550.0, 650.0]),
    "ghost report, two wavelengths": case(of_ghosts, GAUSS, field_deg=(0, 8), rays=6000, wavelength_nm=[500.0, 600.0]),
    "ghost report, scatter": case(of_ghosts, SCATTERED, field_deg=(0,), rays=4000, max_scatters=1, max_reflections=1),
    "ghost report": case(of_ghosts, TRIPLET, field_deg=(0.0, 5.0), rays=4000),
    "glare of a trace": case(of_image, TRIPLET, rays=4000, field_deg=3.0),
    "PST": case(of_pst, TRIPLET, angles=[0.0, 4.0, 8.0, 12.0, 16.0, 20.0], maps=8, rays=60_000),
    "PST with the light": case(of_pst, TRIPLET, angles=[0.0, 6.0, 12.0, 18.0], maps=8, rays=2000, method="forward"),
    "objects at two angles": case(of_objects, "phone_camera_scatter", rays=20_000, field_deg=[0.0, 10.0]),
    "objects": case(of_objects, SCATTERED, rays=20_000),
    "gradients": case(of_gradient, "singlet_window_detector", chosen=LIGHT, **LIMITS),
    SPOT: case(of_gradient, "singlet_window_detector", chosen=("spot",), **LIMITS),
    "thermal": case(of_thermal, "cassegrain", rays=4000),
}


def repeats(name: str, seeds: int) -> pd.DataFrame:
    """Entries that were there in all of so many runs: mean, std, kurtosis over the runs, RMS of the errors."""
    found: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    case = CASES[name]
    scene = case.load()
    for seed in range(seeds):
        for kind, entry, value, se in case.entries(scene, seed, **case.settings):
            found[kind, entry].append((value, se))
    rows = []
    for (kind, entry), pairs in found.items():
        assert len(pairs) <= seeds, f"{name}: two entries are called {kind} {entry}"
        if len(pairs) < seeds:
            continue
        value, se = np.array(pairs).T
        spread, error = value.std(ddof=1), np.sqrt(np.mean(np.square(se)))
        rows.append((name, kind, entry, value.mean(), spread, error, peaked(value)))
    frame = pd.DataFrame(rows, columns=["case", "kind", "entry", "mean", "std", "rms_se", "kurtosis"])
    return frame[frame["std"] > 1e-6 * frame["mean"].abs()]  # what does not vary has no error to compare


def peaked(values: np.ndarray) -> float:
    """Excess kurtosis, 0 where it is negative: what is seldom seen has few large values."""
    apart = values - values.mean()
    variance = np.mean(apart**2)
    return max(float(np.mean(apart**4) / variance**2 - 3), 0.0) if variance > 0 else 0.0


def table(frames: list[pd.DataFrame]) -> pd.DataFrame:
    """std/SE by case and kind: pooled over the entries, and of the worst ones."""
    whole = pd.concat(frames)
    ratio = np.square(whole["std"]) / np.square(whole["rms_se"])
    groups = ratio.groupby([whole["case"], whole["kind"]])
    roots = {name: np.sqrt(column) for name, column in groups.agg(["mean", "min", "max"]).items()}
    return pd.DataFrame({"entries": groups.size(), **roots}).set_axis(["entries", "std/SE", "least", "most"], axis=1)


def main() -> None:
    seeds, words = int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS, sys.argv[2:] or [""]
    for name in CASES:
        if any(word in name for word in words):
            print(table([repeats(name, seeds)]).to_string(float_format="%.3f"), flush=True)


if __name__ == "__main__":
    mistray.set_threads(1)
    main()

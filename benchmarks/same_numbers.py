"""Whether a change of the program keeps its numbers: energy, paths, PST, emission and gradients of shipped scenes.

    python benchmarks/same_numbers.py before.json
    python benchmarks/same_numbers.py after.json --against before.json

Beside the numbers are the hashes of the kernels that Dr.Jit ran for them. Where these are the same, numbers may differ
by 1e-12 of themselves, which is the order of their sums. Otherwise paths above 1e-6 of the launched power must be the
same, and numbers must agree within 1e-5 of themselves or 3 standard errors of their difference.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import mistray
from mistray.errors import MistrayError
from mistray.optimize import Metric, ghost_to_signal, path_power
from mistray.replace_file import replace_file

EXACT, CLOSE, ERRORS = 1e-12, 1e-5, 3.0  # relative, relative, in standard errors
FAINT = 1e-6  # paths below this share of the launched power may come and go with the rays
LEAST_OPERATIONS = 200  # smaller kernels fill and add arrays; how many there are depends on the clock
SEED = 18

# Together they have every kind of shape, BSDF, emitter and sensor of the shipped scenes, and the modes of a trace
TRACES: dict[str, dict[str, Any]] = {
    "cooke_triplet": {"rays": 8000, "field_deg": 5, "wavelength_nm": (486.1, 587.6)},
    "double_gauss": {"rays": 4000, "field_deg": 3},
    "double_gauss_barrel": {"rays": 4000, "field_deg": 8},
    "phone_camera": {"rays": 4000, "field_deg": 10},
    "lens_and_window": {"rays": 8000, "polarization": "stokes"},
    "lens_and_screen": {"rays": 4000},
    "newtonian_scatter": {"rays": 4000, "splitting": "one"},
    "cassegrain": {"rays": 4000},
    "two_stage_baffle": {"rays": 4000},
    "three_mirror_telescope": {"rays": 4000},
    "offner_relay": {"rays": 4000},
    "plate_and_wall": {"rays": 8000, "below_threshold": "roulette"},
}
PSTS: dict[str, dict[str, Any]] = {
    "two_stage_baffle": {"rays": 8000, "field_deg": (20, 40, 60)},
    "newtonian_scatter": {"rays": 32768, "field_deg": (5, 30), "relative_error": 0.2},
    "plate_and_wall": {"rays": 8000, "field_deg": (10, 30), "method": "forward"},
}
THERMAL: dict[str, dict[str, Any]] = {"cassegrain": {"temperature_K": 290.0, "rays": 8000}}
# Metric, its scene, and parameters: of a coating and a curvature, and of a scatter lobe and a rim
GRADIENTS: dict[str, tuple[Callable[..., Metric], dict[str, Any], tuple[str, ...]]] = {
    "phone_camera": (
        ghost_to_signal,
        {"field_deg": (10.0,), "rays": 500},
        ("window_rear.bsdf.R", "L1_front.curvature"),
    ),
    "newtonian_scatter": (
        partial(path_power, selection="single scatter"),
        {"field_deg": (2.0,), "rays": 4000},
        ("black_paint.reflectance", "primary.bsdf.R", "mirror_cell.r1"),
    ),
}

Numbers = dict[str, tuple[float, float]]  # name → number, its standard error
Part = dict[str, Any]


def trace_numbers(scene: mi.Scene, **arguments: Any) -> Part:
    """Where the light went, and the paths."""
    trace = mistray.trace(scene, seed=SEED, **arguments)
    energy = trace.energy
    numbers: Numbers = {
        "launched": (energy.launched_W, 0.0),
        "detected": (energy.detected_W, energy.detected_se_W),
        "escaped": (energy.escaped_W, energy.escaped_se_W),
        **{f"absorbed by {name}": pair for name, pair in (energy.absorbed | energy.absorbed_in).items()},
        "irradiance": (float(np.sum(trace.irradiance)), float(np.sqrt(np.nansum(trace.irradiance_se**2)))),
    }
    table = trace.paths.to_pandas()
    rows = zip(table.wavelength_nm, table.path, table.events, table.power_W, table.power_se_W, strict=True)
    paths = {f"{nm:g} nm: {path} {events}": (power, se) for nm, path, events, power, se in rows}
    # What is cut has no error of its own, so that other random numbers cannot be told from a change
    cut = {reason: (flux, math.nan) for reason, flux in energy.cut.items()}
    return {"launched_W": energy.launched_W, "numbers": numbers, "paths": paths, "cut": cut}


def pst_numbers(scene: mi.Scene, **arguments: Any) -> Part:
    """The PST of a few cells."""
    pst = mistray.pst(scene, seed=SEED, **arguments)
    pairs = zip(np.ravel(pst.value), np.ravel(pst.standard_error), strict=True)
    return {"numbers": {f"cell {cell}": (float(value), float(se)) for cell, (value, se) in enumerate(pairs)}}


def thermal_numbers(scene: mi.Scene, **arguments: Any) -> Part:
    """Irradiance on the detector by each emitter."""
    report = mistray.thermal(scene, seed=SEED, **arguments)
    estimates = {emitter.name: emitter.irradiance_W_mm2 for emitter in report.emitters}
    estimates |= {"all": report.total_W_mm2, "scene": report.scene_W_mm2, "narcissus": report.nitd_K}
    return {"numbers": {name: (float(estimate.value), float(estimate.se)) for name, estimate in estimates.items()}}


def gradient_numbers(
    scene: mi.Scene, metric_of: Callable[..., Metric], keys: tuple[str, ...], **arguments: Any
) -> Part:
    """A metric and its derivatives."""
    metric = metric_of(scene, seed=SEED, **arguments)
    found = mistray.gradient(metric, mi.traverse(scene), keys=list(keys))
    numbers: Numbers = {"metric": (found.value, found.value_se)}
    for key, values in found.gradient.items():
        pairs = zip(np.ravel(values), np.ravel(found.standard_error[key]), strict=True)
        numbers |= {f"{key} {entry}": (float(value), float(se)) for entry, (value, se) in enumerate(pairs)}
    return {"numbers": numbers}


def kernels_of(work: Callable[[], Part]) -> Part:
    """Numbers with the hashes of the kernels that ran for them."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        part = work()
        history = [kernel for kernel in dr.kernel_history() if kernel.get("hash")]
    hashes = {str(kernel["hash"]) for kernel in history if kernel["operation_count"] >= LEAST_OPERATIONS}
    return {"kernels": sorted(hashes), **part}


def measure(scenes: frozenset[str] | None = None) -> dict[str, Part]:
    """All numbers, or those of some scenes, by what was computed."""
    mistray.set_threads(1)  # the order of sums is that of the rays
    parts: dict[str, Part] = {}
    gradients = {name: {"metric_of": of, "keys": keys, **more} for name, (of, more, keys) in GRADIENTS.items()}
    for kind, function, cases in (
        ("trace", trace_numbers, TRACES),
        ("pst", pst_numbers, PSTS),
        ("thermal", thermal_numbers, THERMAL),
        ("gradient", gradient_numbers, gradients),
    ):
        for name, arguments in cases.items():
            if scenes is None or name in scenes:
                scene = mistray.load(name)
                parts[f"{kind} {name}"] = kernels_of(partial(function, scene, **arguments))
    return parts


def differences(before: Mapping[str, Part], after: Mapping[str, Part]) -> Iterator[str]:
    """A line for each number that changed by more than it may."""
    for name in sorted(before.keys() ^ after.keys()):
        yield f"{name}: only {'before' if name in before else 'after'}"
    for name in sorted(before.keys() & after.keys()):
        old, new = before[name], after[name]
        same = old["kernels"] == new["kernels"]
        for table in ("numbers", "paths", "cut")[: 3 if same else 2]:
            # Paths that are in one table only matter where they are strong
            faint = FAINT * old["launched_W"] if table == "paths" and "paths" in old and not same else 0.0
            yield from (f"{name}: {line}" for line in _unlike(old.get(table, {}), new.get(table, {}), same, faint))


def _unlike(old: Mapping[str, Any], new: Mapping[str, Any], same: bool, faint: float) -> Iterator[str]:
    for key in sorted(old.keys() | new.keys()):
        if key not in old or key not in new:
            number, se = old.get(key) or new[key]
            if abs(number) > faint or not faint:
                yield f"{key} ({number:.6g} ± {se:.1g}) only {'before' if key in old else 'after'}"
            continue
        (a, a_se), (b, b_se) = old[key], new[key]
        if max(abs(a), abs(b)) < faint or (math.isnan(a) and math.isnan(b)):
            continue
        error = 0.0 if same else ERRORS * math.hypot(*(se for se in (a_se, b_se) if math.isfinite(se)))
        if not abs(a - b) <= max((EXACT if same else CLOSE) * max(abs(a), abs(b)), error):
            yield f"{key}: {a:.15g} → {b:.15g}{', by the same kernels' if same else f' (± {b_se:.1g})'}"


def main(arguments: list[str] | None = None) -> int:
    """
    The command.

    Returns
    -------
    int
        1 if numbers changed.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="file to write")
    parser.add_argument("--against", type=Path, metavar="FILE", help="compare with this earlier file")
    parser.add_argument("--scenes", nargs="+", metavar="NAME", help="only these")
    options = parser.parse_args(arguments)
    scenes = frozenset(options.scenes) if options.scenes else None
    if unknown := sorted((scenes or frozenset()) - TRACES.keys()):
        raise MistrayError(f"scene '{unknown[0]}' is not measured; there are {', '.join(TRACES)}")
    before = json.loads(options.against.read_text(encoding="utf-8")) if options.against else None
    after = measure(scenes)
    replace_file(options.out, json.dumps(after, indent=1, ensure_ascii=False) + "\n", "record of numbers")
    if before is None:
        return 0
    if scenes is not None:
        before = {name: part for name, part in before.items() if name.split()[1] in scenes}
    changed = list(differences(before, json.loads(json.dumps(after))))
    alike = sum(before[name]["kernels"] == after[name]["kernels"] for name in before.keys() & after.keys())
    for line in changed:
        print(line)
    print(f"{len(changed)} numbers changed; {alike} of {len(after)} parts ran the same kernels")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())

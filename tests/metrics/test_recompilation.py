"""No kernel is compiled between the steps of an optimisation: numbers of a scene are data, whatever they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from frozen_cases import coated_text, scene_text
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import scene_text as small_text
from oracles.small_scenes import shape_xml

import mistray
from mistray.optimize import Metric, optimize

ABG = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
POLISH = bsdf_xml("harvey_shack", rms_nm=4.0, l=0.01, s=-1.5)
WINDOW = small_text(
    shape_xml(
        "asphere", "front", 0.0, scattering_xml((ABG,), "air", "1.5", R=0.1, T=0.8), radius=60.0, semi_diameter=9.0
    ),
    shape_xml("asphere", "rear", 5.0, scattering_xml((POLISH,), "1.5", "air", R=0.1, T=0.8), semi_diameter=9.0),
    shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0),
    radius=5.0,
)
TRACED = {"rays": 1000, "max_reflections": 2, "azimuth_deg": 20.0}


def new_kernels() -> int:
    """Kernels that are new to this process since the last call; one found in the disk cache counts too."""
    entries = dr.kernel_history([dr.KernelType.JIT])
    return sum(not entry["cache_hit"] or entry["cache_disk"] for entry in entries)


def changing(scene: Any, metric: Metric, keys: list[str], **more: Any) -> list[int]:
    """Kernels that are new in each of five gradients, between which all the numbers change."""
    params = mi.traverse(scene)
    before = {key: np.array(params[key], dtype=np.float64) for key in keys}
    rng, counts = np.random.default_rng(1), []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _ in range(5):
            for key, values in before.items():
                tiny = 1e-3 if key.endswith(("x", "y", "z")) else 0.0
                params[key] = mi.Float(values * rng.uniform(0.99, 1.01, len(values)) + tiny * rng.uniform())
            params.update()
            dr.kernel_history_clear()
            mistray.gradient(metric, params, keys, **more)
            counts.append(new_kernels())
    return counts


CASES: dict[str, tuple[str, Callable[[Any], Any], list[str]]] = {
    "coatings": (
        coated_text(scene_text("cooke_triplet"), "L2_front", "L3_rear"),
        lambda o: o.power("ghost"),
        ["L2_front.bsdf.coating.thickness_nm", "L3_rear.bsdf.coating.n_shift"],
    ),
    "geometry": (
        scene_text("cooke_triplet"),
        lambda o: o.power("ghost") / o.power("direct") + 1e-3 * o.moments("ghost").rms_radius,
        ["L1_front.curvature", "L2_front.z", "L3_rear.y", "L2_rear.tilt_x", "detector.z", "L1_edge.r0", "L3_rear.a4"],
    ),
    "image": (
        scene_text("cooke_triplet"),
        lambda o: o.peak("ghost") + dr.sum(dr.square(o.irradiance)),
        ["L1_front.curvature", "L3_rear.y", "L2_front.semi_diameter"],
    ),
    "scatter": (
        WINDOW,
        lambda o: o.power(lambda row: row.scatters > 0),
        ["front.bsdf.abg.A", "front.bsdf.abg.g", "rear.bsdf.harvey_shack.rms_nm", "rear.bsdf.R", "front.curvature"],
    ),
}


@pytest.mark.long
@pytest.mark.usefixtures("no_kernels")
@pytest.mark.parametrize("name", CASES)
def test_numbers_are_data(load_scene: Callable[[str], Any], name: str) -> None:
    """The first two gradients may compile: in the second, numbers that were 0 are there for the first time."""
    text, function, keys = CASES[name]
    scene = load_scene(text)
    metric = Metric(scene, lambda observations: function(observations[0]), (4.0,), settings=TRACED)
    counts = changing(scene, metric, keys)
    assert counts[0] > 0
    assert counts[2:] == [0, 0, 0], counts


@pytest.mark.long
@pytest.mark.parametrize("how", [{}, {"method": "adam", "seeds": "fresh"}])
def test_no_step_of_a_search_compiles(how: dict[str, Any]) -> None:
    """On the Cooke triplet: two terms of light at two fields, one of layers; none after the second step."""
    given = {
        "trace": {"field_deg": [0, 15], "wavelength_nm": [550], "rays": 200},
        "term": [
            {"kind": "path_power", "goal": "minimise"},
            {"kind": "transmission", "goal": "at_least", "limit_of_start": 0.9},
            {"kind": "total_thickness", "goal": "at_most", "limit": 300},
        ],
        "coating": [{"surfaces": "all", "preset": "bbar3", "thickness_nm": [10, 250]}],
        "optimizer": {"starts": 1, "steps": 4, "tolerance": 0, **how},
    }
    new: list[int] = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        optimize("cooke_triplet", given, verification_seeds=2, progress=lambda step, start: new.append(new_kernels()))
        dr.kernel_history_clear()
    assert len(new) == 5
    assert new[3:] == [0, 0], new

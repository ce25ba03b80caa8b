"""Gradients by scatter models, and by what scattered light meets, against float64 differences on frozen paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from frozen_cases import Case, Metrics, compare
from oracles.frozen_paths import power, rms_radius
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import scene_text, shape_xml
from oracles.statistics import z_limit, z_score

import mistray

TOLERANCE = 1e-2  # of BSDF parameters
TRACED = {"max_reflections": 1, "flux_threshold": 0.0, "scatter_threshold": 0.0, "field_deg": 3.0, "azimuth_deg": 20.0}
ABG = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
POLISH = bsdf_xml("harvey_shack", rms_nm=4.0, l=0.01, s=-1.5)
SHACK = bsdf_xml("harvey_shack", b0=0.4, l=0.03, s=-1.8)
PAINT = bsdf_xml("paint", reflectance=0.2, b0=0.3, l=0.2, s=-2.5)


def lens(front: Sequence[str], rear: Sequence[str], *more: str, detector: str | None = None) -> str:
    """A lens whose faces scatter, other shapes, and a detector near its focus."""
    faces = (("front", 0.0, 30.0, "air", "1.6", front), ("rear", 4.0, -40.0, "1.6", "air", rear))
    shapes = [
        shape_xml("asphere", name, z, scattering_xml(models, a, b, R=0.1, T=0.8), radius=radius, semi_diameter=8.0)
        for name, z, radius, a, b, models in faces
    ]
    end = shape_xml("asphere", "detector", 30.0, detector, sensor=True, half_width=4.0, half_height=4.0)
    return scene_text(*shapes, *more, end, radius=4.0)


TUBE = shape_xml("frustum", "tube", 0.0, scattering_xml((PAINT,), R=0.3), r0=4.5, z0=8.0, r1=4.0, z1=26.0)
GLOSS = scattering_xml((bsdf_xml("paint", reflectance=0.1, b0=0.2, l=0.3, s=-2.0),), R=0.2)
CASES = {
    "polished lens": lambda: Case(lens((ABG,), (POLISH,)), {**TRACED, "rays": 400, "seed": 1}),
    "painted tube": lambda: Case(lens((), (), TUBE), {**TRACED, "rays": 400, "seed": 2, "field_deg": 12.0}),
    "detector that scatters": lambda: Case(lens((SHACK,), (), detector=GLOSS), {**TRACED, "rays": 400, "seed": 3}),
    "two scatters": lambda: Case(
        lens((SHACK,), (ABG,)), {**TRACED, "rays": 150, "seed": 4, "max_scatters": 2, "max_reflections": 0}
    ),
}
POSE = ("y", "z", "tilt_x")
SHACK_VALUES = [f"front.bsdf.harvey_shack.{value}" for value in ("b0", "l", "s")]
PAINT_VALUES = ("reflectance", "b0", "l", "s")
KEYS = {
    "polished lens": [
        *(f"front.bsdf.abg.{value}" for value in "ABg"),
        *(f"rear.bsdf.harvey_shack.{value}" for value in ("rms_nm", "l", "s")),
        *(f"front.{name}" for name in (*POSE, "curvature")),
        *("rear.tilt_x", "rear.curvature", "detector.z", "rear.bsdf.T", "front.bsdf.T"),
    ],
    "painted tube": [
        *(f"tube.bsdf.paint.{value}" for value in PAINT_VALUES),
        *(f"tube.{name}" for name in (*POSE, "r0", "z1")),
        *("tube.bsdf.R", "rear.curvature", "front.bsdf.n_back_shift", "rear.bsdf.n_front_shift"),
    ],
    "detector that scatters": [
        *SHACK_VALUES,
        *(f"detector.bsdf.paint.{value}" for value in PAINT_VALUES),
        *("detector.bsdf.R", "detector.tilt_x"),
    ],
    "two scatters": [
        *SHACK_VALUES,
        *(f"rear.bsdf.abg.{value}" for value in "ABg"),
        *("front.z", "front.tilt_x", "rear.curvature"),
    ],
}


@pytest.fixture(scope="module")
def cases() -> Callable[[str], Case]:
    """Name → case, made once."""
    return cache(lambda name: CASES[name]())


def is_scattered(row: Any) -> bool:
    return bool(row.scatters > 0)


def metrics_of(case: Case) -> Metrics:
    scattered = [bundle.text for bundle in case.paths.bundles if bundle.scatters]
    straight = [bundle.text for bundle in case.paths.bundles if not bundle.scatters]
    stray, direct = case.select(scattered), case.select(straight)

    return {
        "scattered": (lambda o: o.power(is_scattered) / o.launched_W, lambda h: power(stray(h)) / case.launched_W),
        "specular": (
            lambda o: o.power(lambda row: row.scatters == 0) / o.launched_W,
            lambda h: power(direct(h)) / case.launched_W,
        ),
        "rms radius": (lambda o: o.moments(is_scattered).rms_radius, lambda h: rms_radius(stray(h))),
    }


def kind_of(key: str) -> str:
    return key if ".bsdf." in key else key.rsplit(".", 1)[-1]


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_against_the_oracle(cases: Callable[[str], Case], name: str) -> None:
    """A gradient that is 5 % too large must fail for each kind."""
    case, keys = cases(name), KEYS[name]
    assert any(bundle.scatters for bundle in case.paths.bundles)
    noticed = compare(case, keys, metrics_of(case), kind_of, tolerance=TOLERANCE, wrong=1.05, cancels=0.25)
    assert noticed >= {kind_of(key) for key in keys}


def test_what_is_left_out_is_named(cases: Callable[[str], Case]) -> None:
    """The roughness lobe of a glass depends on its index; that derivative is not there, and is not silently so."""
    case = cases("polished lens")
    metric = case.metric(lambda o: o.power("all"))
    found = mistray.gradient(metric, mi.traverse(case.scene), ["rear.bsdf.n_front_shift"], edges=False)
    assert any("scatter with the index" in text for text in found.left_out)


@pytest.mark.long
def test_cleanliness_level() -> None:
    """
    Dust, whose random choices change with its level: two traces with other seeds at levels 20 % apart.

    False-alarm probability 1e-3.
    """
    case = Case(lens((bsdf_xml("particulate", level=400.0),), ()), {**TRACED, "rays": 20_000, "seed": 5})
    params, key = mi.traverse(case.scene), "front.bsdf.particulate.level"

    found = mistray.gradient(case.metric(lambda o: o.power(is_scattered)), params, [key], edges=False)
    values, errors = [], []
    for seed, level in ((6, 440.0), (7, 360.0)):
        params[key] = mi.Float(level)
        params.update()
        paths = mistray.trace(case.scene, **{**case.settings, "seed": seed}).paths
        value, error = paths.power([row.path_id for row in paths if row.scatters])
        values.append(value)
        errors.append(error)
    expected = (values[0] - values[1]) / 80.0
    se = np.hypot(np.hypot(*errors) / 80.0, found.standard_error[key][0])
    assert se < 0.1 * expected
    assert abs(z_score(found.gradient[key][0], expected, se)) < z_limit()

"""The core of the suite on a GPU: every number of the CUDA backend against the same trace by LLVM on the processor.

Both take the same random numbers, so that the results agree far better than their standard errors; what differs are
roundings, of which a ray on a rim makes a hit or a miss. Single paths may differ by `SIGMAS` standard errors: less than
one false alarm in 1e5 runs, were the rays independent, and none for equal rays. To show that these comparisons work
where there is no GPU, `test_another_variant` runs them with another variant of LLVM.
"""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest
from oracles.small_scenes import interface_xml, meter_xml, scene_text, write

SIGMAS = 6.0
ROUNDING = 1e-5  # relative

PROGRAM = """
    import json, sys
    from dataclasses import replace
    import mitsuba as mi
    import mistray
    from mistray.optimize import path_power
    from mistray.prescription import Coating
    from mistray.scenes.cooke_triplet.prescription import build

    rays, ball = int(sys.argv[1]), sys.argv[2]
    found = {}

    lens = mistray.load("cooke_triplet")
    for field, t in mistray.ghosts(lens, field_deg=[0.0, 10.0], rays=rays).items():
        found[f"ghosts at {field:g}"] = {row.events: t.paths.power([row.path_id]) for row in t.paths}
        found[f"energy at {field:g}"] = {
            "detected": (t.energy.detected_W, t.energy.detected_se_W),
            "escaped": (t.energy.escaped_W, t.energy.escaped_se_W),
            "closure": (t.energy.closure, 1e-6),
        }
    t = mistray.trace(lens, rays=rays, max_reflections=2, polarization="stokes")
    found["polarised"] = {row.events: t.paths.power([row.path_id]) for row in t.paths}
    worst = t.paths[1].path_id
    image, error = t.irradiance_of([worst])
    found["map"] = {"sum": (float(image.sum()), float((error[error > 0] ** 2).sum() ** 0.5))}
    plate = mistray.trace(mistray.load("plate"), rays=rays)  # all rays of a path have the same optical path
    found["history"] = {"opl": (float(plate.history(1, n=1).to_pandas().opl_mm.iloc[-1]), 1e-6)}

    # A sphere and a detector of Mitsuba's own: rays meet them by OptiX, inside the loop of the kernel
    t = mistray.trace(mistray.load(ball), rays=rays)
    found["stock shapes"] = {row.events: t.paths.power([row.path_id]) for row in t.paths}

    phone = mistray.load("phone_camera_scatter")
    p = mistray.pst(phone, [40.0], rays=2 * rays, max_reflections=1)
    found["pst"] = {"stray at 40": tuple(map(float, (p.stray[0], p.stray_se[0])))}
    t = mistray.trace(phone, rays=rays // 10, field_deg=10.0, max_reflections=1)
    found["scatter"] = {"detected": (t.energy.detected_W, t.energy.detected_se_W), "closure": (t.energy.closure, 1e-6)}

    layer = Coating(preset="mgf2_quarter_wave", design_nm=550.0, name="ar")
    surfaces = tuple(s if s.front == s.back else replace(s, coating=layer) for s in build().surfaces)
    coated = replace(build(), surfaces=surfaces).to_scene()
    metric = path_power(coated, "ghost", rays=rays // 5, field_deg=(0.0,))
    g = mistray.gradient(metric, mi.traverse(coated), keys=["*.thickness_nm", "*.curvature"])
    found["gradient"] = {
        f"{key}[{k}]": (float(value), float(g.standard_error[key][k]))
        for key, values in g.gradient.items()
        for k, value in enumerate(values)
    }
    print(json.dumps({"variant": mi.variant(), "found": found}))
"""

# Traces whose memory on the GPU is compared; the driver is asked, because Dr.Jit keeps what it once had
MEMORY = """
    import ctypes
    import drjit as dr
    import mistray
    import mitsuba as mi

    driver, context = ctypes.CDLL("libcuda.so.1"), ctypes.c_void_p()

    def used() -> float:
        free, total = ctypes.c_size_t(0), ctypes.c_size_t(0)
        assert driver.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total)) == 0
        return (total.value - free.value) / 2**20

    scene = mistray.load("cooke_triplet")
    # Dr.Jit leaves no context current between its calls
    assert driver.cuDevicePrimaryCtxRetain(ctypes.byref(context), 0) == 0
    assert driver.cuCtxSetCurrent(context) == 0
    for rays in (4_000_000, 40_000_000):
        assert abs(mistray.trace(scene, rays=rays).energy.closure) < 1e-5
        print(dr.detail.malloc_watermark(dr.backend_v(mi.Float)) / 2**20, used())
"""


def run(program: str, variant: str, *arguments: str) -> str:
    command = [sys.executable, "-c", textwrap.dedent(program), *arguments]
    env = os.environ | {"MISTRAY_VARIANT": variant}
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr
    return done.stdout


def ball_scene(folder: Path) -> str:
    """A ball lens and a detector, both stock shapes, in a file."""
    ball = f'<shape type="sphere" id="ball"><float name="radius" value="5"/>{interface_xml("1.5", "air")}</shape>'
    place = '<transform name="to_world"><scale value="4"/><translate z="9"/></transform>'
    detector = f'<shape type="rectangle" id="detector">{meter_xml(32)}{place}{interface_xml(R=0.0)}</shape>'
    return str(write(folder, scene_text(ball, detector, radius=2.0)))


def numbers(variant: str, folder: Path, rays: int = 50_000) -> dict[str, Any]:
    printed = json.loads(run(PROGRAM, variant, str(rays), ball_scene(folder)).splitlines()[-1])
    assert printed["variant"] == variant
    return printed["found"]


def differences(found: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """What differs by more than rounding and chance, a line each."""
    lines = [f"{name}: missing" for name in sorted(set(found) ^ set(expected))]
    for name in sorted(set(found) & set(expected)):
        ours, theirs = found[name], expected[name]
        strongest = max(abs(value) for value, _ in theirs.values())
        for key in sorted(set(ours) | set(theirs)):
            (a, a_se), (b, b_se) = ours.get(key, (0.0, 0.0)), theirs.get(key, (0.0, 0.0))
            apart, allowed = abs(a - b), SIGMAS * (a_se**2 + b_se**2) ** 0.5
            # A path of one ray or two, which may just miss a rim, has no error to speak of
            if not apart <= allowed + ROUNDING * abs(b) + 1e-9 * strongest:
                lines.append(f"{name}, {key}: {a:.8g} ± {a_se:.1g} against {b:.8g} ± {b_se:.1g}")
    return lines


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return numbers("llvm_ad_rgb", tmp_path_factory.mktemp("llvm"))


@pytest.mark.gpu
def test_numbers_are_those_of_the_processor(expected: dict[str, Any], tmp_path: Path) -> None:
    """Ghost table, energy, Stokes vectors, a map, a ray history, stock shapes, PST, scatter and gradients."""
    assert not differences(numbers("cuda_ad_rgb", tmp_path), expected)


@pytest.mark.gpu
def test_memory_of_the_gpu_does_not_grow_with_the_rays() -> None:
    few_arrays, few, many_arrays, many = map(float, run(MEMORY, "cuda_ad_rgb").split()[-4:])
    assert many_arrays < few_arrays + 10, "arrays of Dr.Jit"
    assert many < few + 100, "all that the driver has given away"


@pytest.mark.slow
def test_another_variant(expected: dict[str, Any], tmp_path: Path) -> None:
    assert not differences(numbers("llvm_ad_spectral", tmp_path), expected)


def test_a_wrong_number_is_found() -> None:
    ghosts, energy = {"a": (1.0, 1e-3), "b": (1e-3, 1e-6)}, {"closure": (0.0, 1e-6)}
    right = {"ghosts": ghosts, "energy": energy}
    assert not differences(right, right)
    for wrong in (
        {"ghosts": ghosts | {"b": (1.02e-3, 1e-6)}}, {"ghosts": {"a": ghosts["a"]}},
        {"ghosts": ghosts | {"a": (float("nan"), 1e-3)}}, {"energy": {"closure": (1e-4, 1e-6)}},
    ):  # fmt: skip
        assert len(differences(right | wrong, right)) == 1
    assert len(differences({"ghosts": ghosts}, right)) == 1

"""Scenes of more surfaces than the kernel unrolls: the same light as with few, and costs that grow as they should.

A tube in a thousand rings is the tube, a plane in a thousand tiles is the plane: the rays and their random numbers are
the same, so that powers agree to the rounding and no error of a sample is in the comparison.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import scene_text, shape_xml

import mistray
from mistray.optimize import path_power
from mistray.surfaces import shell_tree
from mistray.surfaces.surfaces import SurfaceTable

RADIUS, LENGTH = 20.0, 100.0
PAINT = '<bsdf type="paint"><float name="reflectance" value="0.05"/></bsdf>'
DETECTOR = shape_xml("asphere", "detector", LENGTH, sensor=True, semi_diameter=RADIUS)


def posed(shape: str, pose: str) -> str:
    return shape.replace("<bsdf", f'<transform name="to_world">{pose}</transform><bsdf', 1)


def plain(kind: str, name: str, **numbers: float) -> str:
    values = "".join(f'<float name="{key}" value="{value!r}"/>' for key, value in numbers.items())
    return f'<shape type="{kind}" id="{name}">{values}{PAINT}</shape>'


def tube(rings: int) -> str:
    """A painted tube in rings."""
    ends = np.linspace(0.0, LENGTH, rings + 1)
    return "".join(
        plain("frustum", f"ring_{k}", r0=RADIUS, z0=float(ends[k]), r1=RADIUS, z1=float(ends[k + 1]))
        for k in range(rings)
    )


def cups(count: int) -> str:
    """Cones, washers, bowls and tiles strewn about, each with an orientation of its own."""
    rng = np.random.default_rng(5)
    kinds = (
        ("frustum", {"r0": 1.5, "z0": 0.0, "r1": 0.8, "z1": 2.0}),
        ("frustum", {"r0": 1.6, "z0": 0.5, "r1": 0.4, "z1": 0.5}),
        ("asphere", {"radius": 3.0, "semi_diameter": 1.5}),
        ("asphere", {"half_width": 1.0, "half_height": 0.4}),
        ("asphere", {"radius": 4.0, "semi_diameter": 1.2, "a4": 1e-3}),
    )
    found = []
    for k in range(count):
        kind, numbers = kinds[k % len(kinds)]
        x, y, z = rng.uniform((-14, -14, 10), (14, 14, 90))
        pose = "".join(f'<rotate {axis}="1" angle="{rng.uniform(0, 360)}"/>' for axis in "xy")
        found.append(posed(plain(kind, f"cup_{k}", **numbers), f'{pose}<translate x="{x}" y="{y}" z="{z}"/>'))
    return "".join(found)


@pytest.fixture
def load(tmp_path: Path) -> Callable[[str], mi.Scene]:
    def load(shapes: str) -> mi.Scene:
        path = tmp_path / "scene.xml"
        path.write_text(scene_text(shapes, DETECTOR, radius=15.0))
        return mistray.load(path)

    return load


def absorbed(trace: mistray.Trace, but: str = "detector") -> float:
    return float(sum(power for name, (power, _) in trace.energy.absorbed.items() if name != but))


def test_surfaces_of_all_kinds_in_a_tree_stop_the_same_light(
    load: Callable[[str], mi.Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load(cups(60))
    settings = {"rays": 20_000, "seed": 1, "field_deg": 5.0}
    unrolled = mistray.trace(scene, **settings)
    monkeypatch.setattr(shell_tree, "MOST_UNROLLED", 0)
    monkeypatch.setattr(shell_tree, "MOST_ASPHERES", 0)
    tree = SurfaceTable(scene, 550.0).tree
    assert tree is not None
    assert len(tree.members) == 61
    looped = mistray.trace(scene, **settings)
    assert looped.segments == pytest.approx(unrolled.segments, rel=1e-3)
    launched = unrolled.energy.launched_W
    for name, (power, _) in unrolled.energy.absorbed.items():
        assert looped.energy.absorbed[name][0] == pytest.approx(power, abs=2e-4 * launched), name


@pytest.mark.long
def test_derivatives_by_rings_add_up_to_that_of_the_tube(load: Callable[[str], mi.Scene]) -> None:
    """A metric of the tube's reflectance and radius: the same rays, so its derivative is the sum over the rings."""

    def total(rings: int, name: str) -> tuple[float, float]:
        scene = load(tube(rings))
        metric = path_power(scene, "stray", rays=1000, field_deg=(20.0,), seed=1)
        found = mistray.gradient(metric, mi.traverse(scene), keys=[f"ring_*.{name}"])
        return found.value, float(sum(np.sum(values) for values in found.gradient.values()))

    assert total(150, "bsdf.reflectance") == pytest.approx(total(1, "bsdf.reflectance"), rel=1e-5)


@pytest.mark.long
def test_the_kernel_does_not_grow_with_the_number_of_walls(load: Callable[[str], mi.Scene]) -> None:
    """What is compiled is counted, which no cache of kernels hides; unrolled, a wall adds 110 operations."""

    def operations(walls: int) -> int:
        scene = load(tube(walls))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            mistray.trace(scene, rays=100, seed=1, field_deg=20.0)
            return max(kernel.get("operation_count") or 0 for kernel in dr.kernel_history())

    assert operations(150) > 1000
    assert operations(400) <= operations(300)
    assert operations(400) < 1.2 * operations(150)

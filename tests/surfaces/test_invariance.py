"""What must not matter: order and number of the shapes, the cut into passes, the size of the ledger."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import plates_text, scene_text, shape_xml
from tiers import slow_unless

import mistray
from mistray.execute import tracer
from mistray.optimize import path_power
from mistray.recorders.path_key import FIRST_KEY, MULTIPLIER
from mistray.surfaces import shell_tree
from mistray.surfaces.surfaces import SurfaceTable

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*/scene.xml"))
# Lenses, mirrors, walls and scatter; all others are slow
QUICK = ("baffle_tube", "cassegrain", "cooke_triplet", "newtonian", "phone_camera", "plate_and_wall")
CASES = [pytest.param(path, id=path.parent.name, marks=slow_unless(path.parent.name in QUICK)) for path in SCENES]


def rows(t: Any) -> list[tuple]:
    """Everything of the table that does not depend on the order in which threads add."""
    return [(row.path_id, row.events, row.kind, row.order, row.ghost_1, row.ghost_2, row.rays) for row in t.paths]


def key_of(codes: np.ndarray) -> int:
    """The key of an event list with Python's integers."""
    key = FIRST_KEY
    for code in codes:
        key = ((key ^ (int(code) + 1)) * MULTIPLIER) % 2**64
        key ^= key >> 29
    return key


def assert_same(a: Any, b: Any) -> None:
    assert rows(a) == rows(b)
    for x, y in zip(a.paths, b.paths, strict=True):
        assert (y.power_W, y.incident_W) == pytest.approx((x.power_W, x.incident_W), rel=1e-12)
        assert (y.x_mm, y.y_mm) == pytest.approx((x.x_mm, x.y_mm), rel=1e-12, abs=1e-12)
        assert y.rms_radius_mm == pytest.approx(x.rms_radius_mm, rel=1e-7, abs=1e-7)
    surfaces = [{row.id: (row.hits, row.part, row.space) for row in t.surfaces} for t in (a, b)]
    assert surfaces[0] == surfaces[1]
    assert b.energy.escaped_W == pytest.approx(a.energy.escaped_W, rel=1e-12)
    assert b.segments == a.segments
    np.testing.assert_allclose(b.irradiance, a.irradiance, rtol=1e-9, atol=1e-12 * a.irradiance.max())


def shuffled(text: str, seed: int) -> str:
    """The scene with its shapes in another order."""
    shapes = re.findall(r"<shape.*?</shape>", text, flags=re.DOTALL)
    places = re.split(r"<shape.*?</shape>", text, flags=re.DOTALL)
    order = list(range(len(shapes)))
    random.Random(seed).shuffle(order)
    return "".join(a + b for a, b in zip(places, [*(shapes[i] for i in order), ""], strict=True))


@pytest.mark.parametrize("path", CASES)
def test_order_of_the_shapes(path: Path, tmp_path: Path) -> None:
    """Bit for bit the same hits; the sums to the rounding of Float64 additions in another order."""
    scene = mistray.load(path)
    other = tmp_path / "scene.xml"
    other.write_text(shuffled(path.read_text(encoding="utf-8"), seed=4), encoding="utf-8")
    permuted = mistray.load(other)
    names = [[shape.id() for shape in s.shapes()] for s in (scene, permuted)]
    assert names[0] != names[1]
    assert sorted(names[0]) == sorted(names[1])
    field = 0.0 if path.parent.name == "newtonian" else 3.0
    assert_same(*(mistray.trace(s, rays=3000, field_deg=field) for s in (scene, permuted)))


def test_order_of_the_shapes_with_equal_powers(load_text) -> None:
    """R = T = 1/2: the powers of many paths are equal to the last bit, and their numbers still do not change."""
    text = plates_text(3, R=0.5, T=0.5)
    traces = [mistray.trace(load_text(t)[0], rays=64, max_reflections=4) for t in (text, shuffled(text, 1))]
    powers = [row.power_W for row in traces[0].paths]
    assert len(set(powers)) < len(powers) / 2
    assert_same(*traces)


class TestRepeats:
    @pytest.mark.parametrize(
        "mode", [{}, {"splitting": "one"}, {"below_threshold": "roulette", "flux_threshold": 0.01}]
    )
    def test_same_seed_same_result(self, mode: dict[str, Any]) -> None:
        scene = mistray.load("double_gauss")
        a, b, other = (mistray.trace(scene, rays=20_000, seed=seed, **mode) for seed in (5, 5, 6))
        assert_same(a, b)
        assert a.energy.detected_W != other.energy.detected_W

    def test_same_scene_loaded_twice_and_from_a_dict(self) -> None:
        from mistray.scenes.cooke_triplet.prescription import build

        scenes = [mistray.load("cooke_triplet"), mistray.load("cooke_triplet"), build().to_scene()]
        a, b, c = (mistray.trace(scene, rays=2000) for scene in scenes)
        assert_same(a, b)
        assert_same(a, c)

    def test_a_scene_can_be_traced_again_and_again(self) -> None:
        scene = mistray.load("lens_and_reflector")
        names = [shape.id() for shape in scene.shapes()]
        first = mistray.trace(scene, rays=400)
        mistray.trace(scene, rays=400, field_deg=1.0, wavelength_nm=600.0, splitting="one")
        assert_same(first, mistray.trace(scene, rays=400))
        assert names == [shape.id() for shape in scene.shapes()]


class TestPasses:
    """A trace runs in passes of bounded size. Where they are cut changes the random numbers and nothing else."""

    def test_paths_and_books(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Powers within a joint false alarm of 1e-3."""
        from oracles.statistics import assert_z

        scene = mistray.load("double_gauss")
        whole = mistray.trace(scene, rays=30_000, seed=2)
        monkeypatch.setattr(tracer, "PASS_LANES", 7_000)
        cut = mistray.trace(scene, rays=30_000, seed=2)
        assert cut.settings["rays"] == whole.settings["rays"] == 30_000
        assert abs(cut.energy.closure) < 1e-6
        strong = [row.events for row in whole.paths if row.rays > 100]
        found = {row.events: row for row in cut.paths}
        assert set(strong) <= set(found)
        pairs = [(row, found[row.events]) for row in whole.paths if row.events in strong]
        measured, expected = np.array([[b.power_W, a.power_W] for a, b in pairs]).T
        errors = np.array([np.hypot(a.power_se_W, b.power_se_W) for a, b in pairs])
        assert_z("power", measured, expected, errors, names=strong, floor=1e-9)
        ratio = cut.energy.detected_se_W / whole.energy.detected_se_W
        assert 0.4 < ratio < 2.5  # both from 32 batches

    @pytest.mark.parametrize("lanes", [64, 100, 1000])
    def test_plate(self, monkeypatch: pytest.MonkeyPatch, lanes: int) -> None:
        """Nothing is random there: the same to rounding, errors of zero, each ray once."""
        scene = mistray.load("plate")
        whole = mistray.trace(scene, rays=1030)
        monkeypatch.setattr(tracer, "PASS_LANES", lanes)
        cut = mistray.trace(scene, rays=1030)
        assert rows(whole) == rows(cut)
        assert cut.energy.detected_W == pytest.approx(whole.energy.detected_W, rel=1e-12)
        assert cut.energy.detected_se_W < 1e-7 * cut.energy.detected_W
        assert cut.segments == whole.segments

    def test_maps_box_and_history_over_several_passes(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tracer, "PASS_LANES", 500)
        t = mistray.trace(mistray.load("cooke_triplet"), rays=2200)
        total, _ = t.irradiance_of([row.path_id for row in t.paths])
        np.testing.assert_allclose(total, t.irradiance, rtol=1e-9, atol=1e-9 * t.irradiance.max())
        x0, x1, y0, y1 = t.extent
        assert [row.rays for row in t.box(x0, x1, y0, y1)] == [row.rays for row in t.paths]
        table = t.history(0, 2200).to_pandas()
        assert table.start_ray.nunique() == t.paths[0].rays
        assert table.start_ray.max() < 2200


class TestLedger:
    def test_growth(self, monkeypatch: pytest.MonkeyPatch) -> None:
        scene = mistray.load("double_gauss")
        whole = mistray.trace(scene, rays=3000)
        monkeypatch.setattr(tracer, "FIRST_CAPACITY", 8)
        grown = mistray.trace(scene, rays=3000)
        assert grown.runs[0].ledger.capacity >= 64
        assert_same(whole, grown)

    def test_too_many_paths(self, monkeypatch: pytest.MonkeyPatch) -> None:
        scene = mistray.load("double_gauss")
        monkeypatch.setattr(tracer, "FIRST_CAPACITY", 8)
        monkeypatch.setattr(tracer, "LAST_CAPACITY", 32)
        with pytest.raises(mistray.MistrayError, match=r"more than 22 paths .* flux_threshold .* ledger=False"):
            mistray.trace(scene, rays=3000)
        assert mistray.trace(scene, rays=3000, ledger=False).energy.detected_W > 0

    def test_keys_are_the_hashes_of_the_event_lists(self) -> None:
        """Local arrays whose index starts at width one once filled the lists with garbage; the hash shows it."""
        t = mistray.trace(mistray.load("double_gauss"), rays=3000)
        (run,) = t.runs
        assert len(run.sums.paths.keys) == len(t.paths) > 20
        lists = [row[:length] for row, length in zip(run.sums.paths.events, run.sums.paths.lengths, strict=True)]
        assert [key_of(row) for row in lists] == [int(key) for key in run.sums.paths.keys]
        assert len({row.tobytes() for row in lists}) == len(t.paths)

    def test_garbage_is_found(self) -> None:
        (run,) = mistray.trace(mistray.load("cooke_triplet"), rays=500).runs
        run.ledger.decode()
        events = np.array(run.ledger.events)
        slot = int(run.sums.paths.slots[0])
        events[slot * run.settings.max_events] ^= 1
        run.ledger.events = mi.UInt32(events)
        with pytest.raises(mistray.MistrayError, match=rf"1 of {len(run.sums.paths.keys)} event lists do not match"):
            run.ledger.decode()


Load = Callable[[str], mi.Scene]
RADIUS, LENGTH = 20.0, 100.0
PAINT = '<bsdf type="paint"><float name="reflectance" value="0.05"/></bsdf>'
DETECTOR = shape_xml("asphere", "detector", LENGTH, sensor=True, semi_diameter=RADIUS)


def plain(kind: str, name: str, pose: str = "", **numbers: float) -> str:
    values = "".join(f'<float name="{key}" value="{value!r}"/>' for key, value in numbers.items())
    return f'<shape type="{kind}" id="{name}">{values}<transform name="to_world">{pose}</transform>{PAINT}</shape>'


def lit(shapes: str) -> str:
    return scene_text(shapes, DETECTOR, radius=15.0)


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
        found.append(plain(kind, f"cup_{k}", f'{pose}<translate x="{x}" y="{y}" z="{z}"/>', **numbers))
    return "".join(found)


def test_surfaces_of_all_kinds_in_a_tree_stop_the_same_light(load_scene: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(lit(cups(60)))
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
def test_derivatives_by_rings_add_up_to_that_of_the_tube(load_scene: Load) -> None:
    """A metric of the tube's reflectance and radius: the same rays, so its derivative is the sum over the rings."""

    def total(rings: int, name: str) -> tuple[float, float]:
        scene = load_scene(lit(tube(rings)))
        metric = path_power(scene, "stray", rays=1000, field_deg=(20.0,), seed=1)
        found = mistray.gradient(metric, mi.traverse(scene), keys=[f"ring_*.{name}"])
        return found.value, float(sum(np.sum(values) for values in found.gradient.values()))

    assert total(150, "bsdf.reflectance") == pytest.approx(total(1, "bsdf.reflectance"), rel=1e-5)


@pytest.mark.long
def test_the_kernel_does_not_grow_with_the_number_of_walls(load_scene: Load) -> None:
    """What is compiled is counted, which no cache of kernels hides; unrolled, a wall adds 110 operations."""

    def operations(walls: int) -> int:
        scene = load_scene(lit(tube(walls)))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            mistray.trace(scene, rays=100, seed=1, field_deg=20.0)
            return max(kernel.get("operation_count") or 0 for kernel in dr.kernel_history())

    assert operations(150) > 1000
    assert operations(400) <= operations(300)
    assert operations(400) < 1.2 * operations(150)

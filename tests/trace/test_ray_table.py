"""Tables of rays at the detector, at any surface and of many paths: exactly the rays that are asked for."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import fails, succeeds
from lit_detector import lit, square
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.events import EVENT_BITS, EVENT_MASK
from mistray.execute import tracer
from mistray.recorders.path_events import DIRECT, LETTERS, STRAY_KINDS
from mistray.toolkit.pages.embedded import power_codes
from mistray.trace import ray_table
from mistray.trace.history import over_the_beam

FIRST = [
    "ray", "path_id", "kind", "wavelength_nm", "source", "start_ray", "node", "type", "history", "flux_W",
    "x_mm", "y_mm", "z_mm", "dx", "dy", "dz", "opl_mm", "detector_x_mm", "detector_y_mm", "column", "row",
]  # fmt: skip


def assert_same_rays(one: pd.DataFrame, other: pd.DataFrame) -> None:
    """In any order."""
    key = ["wavelength_nm", "start_ray", "path_id", "x_mm", "y_mm", "flux_W"]
    first, second = (table.sort_values(key, ignore_index=True)[FIRST[1:]] for table in (one, other))
    pd.testing.assert_frame_equal(first, second)


@pytest.fixture(scope="module")
def triplet() -> Any:
    colours = {"wavelength_nm": [486.1, 656.3], "weights": [1.0, 3.0]}
    return mistray.trace(mistray.load("cooke_triplet"), rays=6000, field_deg=8.0, **colours)


@pytest.fixture(scope="module")
def everything(triplet: Any) -> pd.DataFrame:
    return triplet.rays(n=None)


@pytest.fixture(scope="module")
def rough(load_scene: Callable[[str], Any]) -> Any:
    front = scattering_xml([bsdf_xml("abg", A=1e-3, B=1e-3, g=2.0)], "air", "1.5")
    plate = [
        placed_xml("asphere", "front", front, semi_diameter=4.0),
        placed_xml("asphere", "rear", interface_xml("1.5", "air"), at=(0, 0, 3.0), semi_diameter=4.0),
    ]
    size = {"half_width": 5.0, "half_height": 5.0, "pixels": 16}
    meter = placed_xml("asphere", "detector", interface_xml(R=0.2), at=(0, 0, 9.0), **size)
    branches = {"scatter_rays": 3, "aimed_rays": 2, "max_scatters": 2}
    return mistray.trace(load_scene(scatter_scene(beam_xml(2.0), *plate, meter)), rays=1500, **branches)


class TestAll:
    def test_sums(self, triplet: Any, everything: pd.DataFrame) -> None:
        assert list(everything.columns) == FIRST
        assert list(everything.ray) == list(range(len(everything)))
        for row in triplet.paths:
            rays = everything[everything.path_id == row.path_id]
            assert (len(rays), rays.flux_W.sum()) == (row.rays, pytest.approx(row.incident_W, rel=1e-6))
            assert (set(rays.kind), set(rays.wavelength_nm)) == ({row.kind}, {row.wavelength_nm})
            intercepts = [what for _, what in row.event_list]
            assert (set(rays.history), set(rays.type)) == ({" ".join(intercepts)}, {intercepts[-2]})
            assert set(rays.node) == {len(intercepts)}
            assert rays.detector_x_mm.mean() == pytest.approx(row.x_mm, abs=max(4 * row.x_se_mm, 1e-4))
        few = triplet.rays(n=40).merge(everything, on=["path_id", "start_ray", "history", "x_mm", "y_mm", "flux_W"])
        assert (len(few), few.wavelength_nm_x.nunique()) == (40, 2)  # some of these, spread over sources and beam
        assert np.ptp(few.start_ray) > 0.7 * np.ptp(everything.start_ray)
        np.testing.assert_allclose(np.linalg.norm(everything[["dx", "dy", "dz"]].to_numpy(), axis=1), 1, rtol=1e-12)
        height, width = triplet.irradiance.shape
        image = np.zeros((height, width))
        absorbs = triplet.energy.detected_W / everything.flux_W.sum()
        np.add.at(image, (everything.row, everything.column), absorbs * everything.flux_W)
        x0, x1, y0, y1 = triplet.extent
        pixel = (x1 - x0) * (y1 - y0) / image.size
        np.testing.assert_allclose(image / pixel, triplet.irradiance, rtol=1e-5, atol=1e-12)

    def test_few_rays_are_spread_over_the_beam(self) -> None:
        for most in (16, 17, 33):  # start rays go through the beam once for each of 32 batches
            places = np.sort(over_the_beam(20_000, most) % 625)
            assert np.diff(places, append=places[0] + 625).max() < 0.2 * 625, most
        lens = mistray.Surface("lens", radius=20, semi_diameter=8, back="1.5")  # f = 60 mm in the glass behind
        system = mistray.Prescription(
            name="immersed",
            surfaces=(lens,),
            detector=mistray.Detector(z=60, half_width=1, half_height=1, front="1.5"),
            source=mistray.Source(radius=2),
        )
        t = mistray.trace(system.to_scene(), rays=20_000)
        start = t.sampled_hits()[0].start
        assert np.linalg.norm(start[:, :2].mean(axis=0)) < 0.3  # of 2 mm
        assert t.light_cones(0)[0].aperture == pytest.approx(1.5 * 2 / 60, rel=0.02)

    def test_branches_beyond_the_recorder_s_room(self, rough: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        whole = rough.rays(n=None)
        assert len(whole) == sum(row.rays for row in rough.paths)
        monkeypatch.setattr(ray_table, "CAPACITY", 1 << 11)
        assert_same_rays(whole, rough.rays(n=None))
        monkeypatch.setattr(ray_table, "CAPACITY", 2)
        with pytest.raises(mistray.MistrayError, match=r"a single start ray has .* flux_threshold"):
            rough.rays(n=None)


class TestHotSpot:
    @pytest.mark.parametrize("fraction", [(0.1, 0.4, 0.3, 0.9), (0.0, 1.0, 0.45, 0.46)])
    def test_box(self, rough: Any, fraction: tuple[float, ...]) -> None:
        x0, x1, y0, y1 = rough.extent
        low, size = np.array([x0, x0, y0, y0]), np.array([x1 - x0, x1 - x0, y1 - y0, y1 - y0])
        box = tuple(low + size * fraction)
        rays, whole = rough.rays(n=None, box=box), rough.rays(n=None)
        own = {row.events: (row.rays, row.incident_W) for row in rough.box(*box)}
        found = rays.groupby("path_id").flux_W.agg(["size", "sum"])
        assert {rough.paths[i].events: tuple(v) for i, v in found.iterrows()} == {
            events: (rays, pytest.approx(power, rel=1e-6)) for events, (rays, power) in own.items()
        }
        inside = (whole.detector_x_mm.between(*box[:2])) & (whole.detector_y_mm.between(*box[2:]))
        assert_same_rays(rays, whole[inside])
        rays = rough.rays(n=None, pixels=(3, 9, 5, 6))
        inside = whole.column.between(3, 8) & whole.row.between(5, 5)
        assert rays.flux_W.sum() == pytest.approx(whole.flux_W[inside].sum(), rel=1e-12)

    def test_refused(self, rough: Any) -> None:
        for pixels in ((0, 17, 0, 1), (3, 3, 0, 1), (-1, 2, 0, 1), (0, 1, 2, 1)):
            with pytest.raises(mistray.MistrayError, match="16 columns and 16 rows"):
                rough.rays(pixels=pixels)
        with pytest.raises(mistray.MistrayError, match="x 1 … 0"):
            rough.rays(box=(1, 0, 0, 1))
        with pytest.raises(mistray.MistrayError, match="n is 0"):
            rough.rays(n=0)
        with pytest.raises(mistray.MistrayError, match=r"filter 'S\(nowhere\)': .*'nowhere'"):
            rough.rays("S(nowhere)")


class TestSelection:
    @pytest.mark.parametrize(
        ("text", "same"),
        [
            ("G(L3_rear)", lambda r, t: [t.paths[i].events.count("L3_rear:R") > 0 for i in r.path_id]),
            ("kind = ghost & !G(L3_rear)", lambda r, t: [
                t.paths[i].kind == "ghost" and "L3_rear:R" not in t.paths[i].events for i in r.path_id]),
            ("wavelength_nm < 500 ^ order = 2", lambda r, t: (r.wavelength_nm < 500) ^ (r.kind == "ghost")),
            ("path_id = 3 | path_id = 1", lambda r, t: r.path_id.isin([1, 3])),
            ("start_ray < 700 & opl_mm > 85", lambda r, t: (r.start_ray < 700) & (r.opl_mm > 85)),
            ("!(flux_W > 1e-5 | dz < 0.97)", lambda r, t: ~((r.flux_W > 1e-5) | (r.dz < 0.97))),
            ("relative_flux > 1e-3 & relative_flux < 0.5",
             lambda r, t: (r.flux_W / r.flux_W.max()).between(1e-3, 0.5)),
            ("column >= 256 & row < 400", lambda r, t: (r.column >= 256) & (r.row < 400)),
            ("tir > 0", lambda r, t: [t.paths[i].tir > 0 for i in r.path_id]),
        ],
    )  # fmt: skip
    def test_against_pandas(self, triplet: Any, everything: pd.DataFrame, text: str, same: Callable[..., Any]) -> None:
        expected = everything[np.array(same(everything, triplet), dtype=bool)]
        assert_same_rays(triplet.rays(text, n=None), expected)

    def test_events(self, triplet: Any) -> None:
        row = triplet.paths.select("kind = ghost")[0]
        table = triplet.rays(f"path_id = {row.path_id}", n=3, events=True)
        rays = triplet.rays(f"path_id = {row.path_id}", n=3)
        known = triplet.history(row.path_id, row.rays).to_pandas()
        assert (len(table), set(table.path_id)) == (3 * (len(row.event_list) + 1), {row.path_id})
        for number, ray in table.groupby("ray"):
            same = known[known.start_ray == ray.start_ray.iloc[0]].reset_index(drop=True)
            ray = ray.reset_index(drop=True)
            columns = [name for name in known if name != "ray"]
            pd.testing.assert_frame_equal(ray[columns], same[columns])
            assert ray.flux_W.iloc[-1] == rays.flux_W[number]
            assert ray.opl_mm.iloc[-1] == rays.opl_mm[number]
        assert triplet.rays("H(detector) > 9", events=True).empty


PLATE = (
    shape_xml("asphere", "p_front", 0.0, interface_xml("air", "1.5"), semi_diameter=9.0),
    shape_xml("asphere", "p_rear", 2.0, interface_xml("1.5", "air"), semi_diameter=9.0),
)
SENSOR = shape_xml("asphere", "detector", 12.0, interface_xml(R=0.3), sensor=True, half_width=9.0, half_height=9.0)
MIRRORS = interface_xml(R=0.5)
ABG = bsdf_xml("abg", A=1e-3, B=1e-3, g=2.0)
ROUGH_PLATE = (PLATE[0], PLATE[1].replace(interface_xml("1.5", "air"), scattering_xml([ABG], "1.5", "air")))
PAINT = scattering_xml([bsdf_xml("paint", reflectance=0.5)], R=0.0)
RING = placed_xml(
    "frustum", "ring", scattering_xml([bsdf_xml("edge_diffraction", width_mm=0.05)], R=0.0, T=1.0),
    r0=0.5, z0=0.0, r1=1.1, z1=0.0, at=(0, 0, -1.0),
)  # fmt: skip
TUBE = shape_xml("frustum", "tube", 0.0, MIRRORS, r0=1.5, z0=2.5, r1=1.5, z1=11.0)
# A strong lens with a glass edge: total reflections
BALL = (
    shape_xml("asphere", "front", 0.0, interface_xml("air", "1.8"), radius=5.0, semi_diameter=4.0),
    shape_xml("asphere", "rear", 8.0, interface_xml("1.8", "air"), radius=-5.0, semi_diameter=4.0),
    shape_xml("frustum", "edge", 0.0, interface_xml("1.8", "air"), r0=4.0, z0=2.0, r1=4.0, z1=6.0),
    shape_xml("asphere", "detector", 14.0, interface_xml(R=0.3), sensor=True, half_width=9.0, half_height=9.0),
)
TURNED = {"field_deg": 25.0}
SCENES = {
    "direct": (PLATE, {}),
    "straight shot": ((), {}),
    "ghost": (PLATE, {}),
    "structure": ((*PLATE, TUBE), TURNED),
    "structure+ghost": ((*PLATE, TUBE), TURNED | {"max_reflections": 3}),
    "TIR": (BALL, TURNED),
    "single scatter": (ROUGH_PLATE, {}),
    "multiple scatter": ((*PLATE, TUBE.replace(MIRRORS, PAINT)), TURNED | {"max_scatters": 2}),
    "ghost + scatter": (ROUGH_PLATE, {}),
    "edge diffraction": ((RING,), {}),
    "diffraction + others": ((RING, *PLATE), {}),
}


@pytest.mark.parametrize("kind", SCENES)
def test_a_scene_for_each_class(load_scene: Callable[[str], Any], kind: str) -> None:
    """Light of each class comes about; every path has one class, and the classes share out all the light."""
    assert set(SCENES) == {DIRECT, *STRAY_KINDS}
    shapes, settings = SCENES[kind]
    sensor = () if shapes is BALL else (SENSOR,)
    scene = load_scene(scene_text(*shapes, *sensor, radius=3.5 if shapes is BALL else 1.0))
    t = mistray.trace(scene, **{"rays": 4000, "max_reflections": 2} | settings)
    table = t.paths.to_pandas()
    assert kind in set(table.kind)
    assert set(table.kind) <= {DIRECT, *STRAY_KINDS}
    assert len(t.rays(f'kind = "{kind}"', n=None)) == table.rays[table.kind == kind].sum()
    assert table.groupby("kind").power_W.sum().sum() == pytest.approx(t.energy.detected_W, rel=1e-9)
    for row in t.paths:
        what = [name for _, name in row.event_list]
        deflected = sum(name[:3] in ("Ran", "Imp") for name in what)
        rings = [event for name, event in row.event_list if name == "ring" and event in ("RandTran", "ImpTran")]
        assert row.diffractions == len(rings)
        assert (row.kind in ("edge diffraction", "diffraction + others")) == (row.diffractions > 0)
        assert (row.kind == "edge diffraction") == (row.diffractions == deflected > 0 and "SpecRefl" not in what)
        assert row.objects == len(what)
        assert row.unique_objects == len({name for name, _ in row.event_list})
        assert row.last_object == (row.event_list[-2][0] if len(what) > 1 else "-")


def test_air_between_mirrors_counts() -> None:
    """Optical path lengths in air of 1.0003 that only the window behind two mirrors names, beside Snell's law."""
    air, glass, angle = 1.0003, 1.5, np.radians(10.0)

    def flat(z: float, y: float, half: float, **bsdf: Any) -> dict[str, Any]:
        size = {"half_width": half, "half_height": half}
        return {"type": "asphere", **size, "y": y, "z": z, "bsdf": {"type": "interface", **bsdf}}

    y1, y2, y3 = np.tan(angle) * np.array([50.0, 150.0, 240.0])
    mirrors = {"first": flat(50.0, y1, 4.0, R=1.0, mirror=True), "second": flat(-50.0, y2, 4.0, R=1.0, mirror=True)}
    window = {
        "front": {**flat(40.0, y3, 10.0, front=str(air), back=str(glass)), "part": "window"},
        "rear": {**flat(45.0, y3, 10.0, front=str(glass), back=str(air)), "part": "window"},
    }
    beam = {"type": "collimated", "radius": 1.0, "field_deg": 10.0, "distance": 20.0}
    t = mistray.trace(lit(beam, **mirrors, **window, detector=square(15.0, y=y3, z=60.0)), rays=1000, max_reflections=0)
    inside = np.arcsin(air * np.sin(angle) / glass)
    for _, ray in t.history(t.paths.find("detector")[0].path_id, 20).to_pandas().groupby("ray"):
        assert list(ray.surface)[1:] == ["first", "second", "front", "rear", "detector"]
        before = air * np.array([50.0 - ray.z_mm.iloc[0], 100.0, 90.0]) / np.cos(angle)
        expected = np.cumsum([0.0, *before, glass * 5.0 / np.cos(inside), air * 15.0 / np.cos(angle)])
        np.testing.assert_allclose(ray.opl_mm, expected, rtol=1e-9)


def test_rays_of_the_ledger_filters_and_numbers() -> None:
    traced = mistray.trace(mistray.load("singlet_window_detector"), rays=60, field_deg=5.0)
    for name in ("window_front", "barrel_1_wall", "detector"):
        (row,) = [row for row in traced.surfaces if row.id == name]
        table = traced.rays_at(row.id, n=None)
        assert (len(table), set(table.surface)) == (row.hits, {row.id})
        assert table.flux_W.sum() == pytest.approx(row.incident_W, rel=1e-6)
        np.testing.assert_allclose((table[["dx", "dy", "dz"]] ** 2).sum(axis=1), 1, rtol=1e-6)
    walls = sum(row.absorbed_W for row in traced.surfaces if row.id != "detector")  # they are black
    assert traced.rays_at("blocked", n=None).flux_W.sum() == pytest.approx(walls, rel=1e-6)
    escaped = traced.rays_at("escaped", n=None)
    # What misses the first lens altogether has no event: the launched light less what arrives at first surfaces
    nodes = traced.rays_at("*", n=None)
    missed = traced.energy.launched_W - nodes.flux_W[nodes.node == 1].sum()
    assert escaped.flux_W.sum() + missed == pytest.approx(traced.energy.escaped_W, rel=1e-5)
    assert len(traced.rays_at("returned", n=None)) == (escaped.dz < 0).sum() > 0  # the light goes along z
    table = traced.rays_at("window_front", "R(window_rear)", n=7.0)
    assert len(table) == 7
    for whole in (traced.rays, lambda n: traced.rays_at("escaped", n=n), lambda n: traced.sampled_rays(0, n)):
        assert len(whole(n=2.0))
        with pytest.raises(mistray.MistrayError, match=r"n is 2\.5; it must be a whole number"):
            whole(n=2.5)
    assert table.history.str.contains("window_rear:SpecRefl").all()
    nodes = traced.rays_at("escaped", n=5, events=True)
    assert (nodes.ray.nunique(), set(nodes.intercept[nodes.node == 0])) == (5, {"Emitted"})
    for where, selection, words in (
        ("windw", "", "'window'"),
        ("blockd", "", "'blocked'"),
        ("window", "power_W > 1", "'power_W'"),
        ("window", "source = moon", "never 'moon'"),
        ("window", "surface = windw", "never 'windw'"),
        ("window", "type = SpecRefr", "never 'SpecRefr'"),
        (["escaped", "window"], "", "alone"),
    ):
        with pytest.raises(mistray.MistrayError, match=words):
            traced.rays_at(where, selection)


def test_the_flux_at_the_start_of_aimed_rays() -> None:
    """Most rays of a far lamp are sent to the lens, with small weights; in vacuum a ray keeps its flux."""
    lamp = {"type": "point_source", "z": -200.0}
    front = {"type": "asphere", "semi_diameter": 10.0, "bsdf": {"type": "interface", "back": "1.5"}}
    rear = {**front, "z": 4.0, "bsdf": {"type": "interface", "front": "1.5"}}
    t = mistray.trace(lit(lamp, front=front, rear=rear, detector=square(20.0, z=60.0)), rays=4000)
    unit = t.energy.launched_W / t.rays_traced
    tables = [t.history(0, n=5).to_pandas(), t.rays(n=5, events=True), t.rays_at("front", n=5, events=True)]
    for flux in [table.flux_W[table.node == k].to_numpy() for table in tables for k in (0, 1)]:
        assert 0 < flux.min() < 0.1 * unit
    for table in tables:
        start, first = (table.flux_W[table.node == k].to_numpy() for k in (0, 1))
        np.testing.assert_allclose(start, first, rtol=1e-6)
    for ray in t.sampled_rays(0, 5)[0]:
        assert ray.flux_W[0] == pytest.approx(ray.flux_W[1], rel=1e-6)


def test_the_command_writes_rays_that_arrive(tmp_path, capsys):
    """All rays of a surface carry its incident flux, in every format; a file of them is a source of that flux."""
    out = tmp_path / "out"
    command = ["ghosts", "plate_and_wall", "--rays", "500", "--max-scatters", "1", "--quiet"]
    for more, word in (
        (["--rays-at", "scren", "--out", str(out)], "screen"),
        (["--rays-at", "screen"], "--out"),
        (["--rays-at", "escaped", "screen", "--out", str(out)], "alone"),
        (["--rays-at", "screen", "--filter", "power_W > 1", "--out", str(out)], "power_W"),
        (["--formats", "dat", "--out", str(out)], "--rays-at"),
    ):
        assert word in fails(capsys, *command, *more)
    more = ["--rays-at", "screen", "--most-rays", "0", "--formats", "dat", "parquet"]
    succeeds(capsys, *command, *more, "--out", out)
    rays = pd.read_csv(out / "rays_at.csv")
    surfaces = pd.read_csv(out / "surfaces.csv")
    (incident,) = surfaces.incident_W[surfaces.id == "screen"]
    assert rays.flux_W.sum() == pytest.approx(incident, rel=1e-6)
    assert set(rays.surface) == {"screen"}
    assert set(rays.kind) >= {"single scatter"}
    assert len(pd.read_parquet(out / "rays_at.parquet")) == len(rays)
    scene = mistray.load("plate_and_wall", sources=[{"type": "ray_file", "filename": str(out / "rays_at_0deg.dat")}])
    assert mistray.trace(scene, rays=200, max_scatters=0).energy.launched_W == pytest.approx(incident, rel=1e-5)


RAYS = 5000


def test_boxes_samples_and_histories_of_a_report(monkeypatch):
    report = mistray.ghosts(mistray.load("singlet_window_detector"), field_deg=[0.0, 2.0], rays=RAYS)
    t = report[2.0]
    by_events = dict(zip(report.table(2.0).events, report.table(2.0).path_id, strict=True))
    maps = report.path_maps(2.0, list(by_events.values()))
    height, width = t.irradiance.shape
    x0, x1, y0, y1 = t.extent
    bright = np.argwhere(t.irradiance == t.irradiance.max())[0][::-1] // maps.grid
    most = np.array([width, height]) // maps.grid
    near = np.maximum(bright - 3, 0), np.minimum(bright + 2, most)
    for first, last in ((bright, bright + 1), near, (most // 4, most // 2)):
        columns, rows = zip(first * maps.grid, last * maps.grid, strict=True)
        x, y = (x0 + (x1 - x0) * np.array(columns) / width), (y0 + (y1 - y0) * np.array(rows) / height)
        found = {path_id: m.within(columns, rows) for path_id, m in maps.paths.items()}
        found = {path_id: power for path_id, power in found.items() if power > 0}
        assert found == pytest.approx({by_events[row.events]: row.power_W for row in t.box(*x, *y)}, rel=1e-5)
        for path_id, power in found.items():
            m = maps.paths[path_id]
            codes = power_codes(m.power_W).astype(float)
            rounded = np.where(codes > 0, 10 ** (codes / 600 - 100), 0.0)
            stored = type(m)(m.pixels, m.column, m.row, rounded).within(columns, rows)
            assert stored == pytest.approx(power, rel=2e-3)
    # Sampled rays are rays of their path
    ids = [row.path_id for row in t.paths[:12]]
    sample = t.sampled_rays(ids, 20)
    assert list(sample) == ids
    names = t.tables[0].event_ids
    for path_id, rays in sample.items():
        for ray in rays:
            words = [f"{names[code >> EVENT_BITS]}:{LETTERS[code & EVENT_MASK]}" for code in ray.codes.tolist()]
            assert " ".join(words) == t.paths[path_id].events
    first = np.array([ray.points[0] for ray in sample[ids[0]]])
    assert len(first) == 20
    assert np.ptp(first[:, 0]) > 0.5 * np.ptp([ray[0, 0] for ray in t.history(ids[0], 500).rays])
    t = report[0.0]
    path_id = t.paths[1].path_id
    every = {ray.start_ray: ray for ray in t.history(path_id, RAYS)._rays}
    sample = t.sampled_rays([path_id], 10)[path_id]
    assert len(sample) == 10
    for ray in sample:
        np.testing.assert_allclose(ray.points, every[ray.start_ray].points, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(ray.flux_W, every[ray.start_ray].flux_W, rtol=1e-6)
    # A batch of more start rays than the recorder holds: not those of one corner of the beam alone
    whole = np.array([ray[0, :2] for ray in t.history(0, RAYS).rays])
    monkeypatch.setattr(tracer, "RECORD_CAPACITY", 16)  # of 125 start rays of a batch
    few = np.array([ray[0, :2] for ray in t.history(0, 16).rays])
    assert len(few) > 10
    assert (np.ptp(few, axis=0) > 0.6 * np.ptp(whole, axis=0)).all()


INDEX = 1.5


def plate(glass: str, *models: str) -> str:
    """A plate 5 mm thick, whose front may scatter; the detector, 15 mm behind it, is black."""
    return scene_text(
        shape_xml("asphere", "front", 0.0, scattering_xml(models, "air", glass), semi_diameter=30.0),
        shape_xml("asphere", "rear", 5.0, interface_xml(glass, "air"), semi_diameter=30.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=6.0, half_height=6.0),
    )


@pytest.fixture(scope="module")
def trace(load_scene):
    return mistray.trace(load_scene(plate(f"{INDEX}", ABG)), rays=20_000, max_reflections=0)


@pytest.fixture(scope="module")
def hazy(load_scene):
    return mistray.trace(load_scene(plate(f"{INDEX} scatter=0.05 g=0.9")), rays=20_000, max_reflections=0)


@pytest.mark.parametrize(
    ("glass", "path", "intercept"),
    [("trace", "tTA", "RandTran"), ("trace", "iTA", "ImpTran"), ("hazy", "TtTA", "RandTran")],
)
def test_refraction_holds_after_a_scatter_event(request, glass: str, path: str, intercept: str) -> None:
    """Behind the plate the tangential part of the unit vector is n times that within it: Snell's law, to 1e-12."""
    trace = request.getfixturevalue(glass)
    row = next(row for row in trace.paths if row.path == path)
    assert (row.kind, row.scatters) == ("single scatter", 1)
    assert row.scatter_1.startswith("(1.5" if glass == "hazy" else "front")
    assert {text.split()[-3] for text in trace.rays(f"path_id = {row.path_id}", n=20).history} == {intercept}
    table, nodes = trace.history(row.path_id, 50).to_pandas(), len(path) + 1
    before = ["Emitted"] if glass == "trace" else ["Emitted", "SpecTran"]
    assert list(table.intercept[:nodes]) == [*before, intercept, "SpecTran", "Absorbed"]
    points = table[["x_mm", "y_mm", "z_mm"]].to_numpy().reshape(-1, nodes, 3)
    directions = table[["dx", "dy", "dz"]].to_numpy().reshape(-1, nodes, 3)[:, :-1]
    steps = np.diff(points, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    np.testing.assert_allclose(directions[:, -1, :2], INDEX * directions[:, -2, :2], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1.0, rtol=1e-12)
    np.testing.assert_allclose(directions * lengths[:, :, None], steps, atol=1e-11)
    index = [1.0, *[INDEX] * (nodes - 3), 1.0]
    np.testing.assert_allclose(np.diff(table.opl_mm.to_numpy().reshape(-1, nodes), axis=1), lengths * index, rtol=1e-12)
    np.testing.assert_allclose(points[:, -2:, 2], np.broadcast_to([5.0, 20.0], (len(points), 2)), atol=1e-12)
    depth = points[:, len(before), 2]
    assert np.all((depth > 0) & (depth < 5)) if glass == "hazy" else np.allclose(depth, 0, atol=1e-12)
    turned = np.linalg.norm(directions[:, -2, :2], axis=1)
    assert np.count_nonzero(turned > 1e-6) > 0.9 * len(turned)


def test_the_table_holds_random_and_aimed_light(trace) -> None:
    assert trace.paths[0].path == "TTA"
    assert {row.path for row in trace.paths[1:]} == {"tTA", "iTA"}
    rows = trace.paths.by_way()
    assert list(rows.path) == ["TTA", "tTA"]
    scattered = [row for row in trace.paths if row.scatters]
    assert rows.power_W[1] == pytest.approx(sum(row.power_W for row in scattered), rel=1e-9)
    power, se = trace.paths.power(range(len(trace.paths)))
    assert power == pytest.approx(trace.energy.detected_W, rel=1e-9)
    assert se == pytest.approx(trace.energy.detected_se_W, rel=1e-6)

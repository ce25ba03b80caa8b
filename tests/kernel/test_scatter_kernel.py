"""Scattered rays in the tree: the sampling is unbiased, modes and limits agree, and what a limit cuts is booked."""

import numpy as np
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import z_limit, z_score

import mistray

FRONT, REAR = '<string name="front" value="air"/>', '<string name="front" value="1.5"/>'
ROUGH = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
SHARP = bsdf_xml("harvey_shack", b0=0.5, l=0.01, s=-1.5)


def window_text(*models: str) -> str:
    """A window, scattering on both faces, before a detector that does not see all of it."""
    return scene_text(
        shape_xml("asphere", "front", 0.0, scattering_xml(models, "air", "1.5"), semi_diameter=50.0),
        shape_xml("asphere", "rear", 5.0, scattering_xml(models, "1.5", "air"), semi_diameter=50.0),
        shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0),
    )


def scattered(trace: mistray.Trace) -> tuple[float, float]:
    return trace.paths.power([row.path_id for row in trace.paths if row.scatters])


@pytest.mark.parametrize("models", [(ROUGH,), (ROUGH, SHARP)])
@pytest.mark.parametrize("aim", ["auto", "none"])
def test_rays_carry_what_the_surfaces_scatter(load_scene, models: tuple[str, ...], aim: str) -> None:
    """The difference is 0 on average; 16 seeds give its error. False alarm 1e-3 for the four cases."""
    scene = load_scene(window_text(*models))
    cuts = []
    for seed in range(16):
        energy = mistray.trace(scene, rays=20_000, seed=seed, aim=aim, ledger=False).energy
        cuts.append(energy.cut["scatter_sampling"] / energy.launched_W)
        assert abs(energy.closure) < 1e-5
    mean, se = np.mean(cuts), np.std(cuts, ddof=1) / 4
    assert se < 2e-4  # of a few percent that are scattered
    assert abs(mean) < z_limit(4) * 1.5 * se  # Student's t with 15 degrees of freedom has wider tails


LIMITS = {
    "max_scatters": lambda row: row.scatters,
    "max_random_scatters": lambda row: row.path.count("t") + row.path.count("r"),
    "max_optical_scatters": lambda row: row.scatters,  # nothing here is opaque but the detector
    "max_generations": lambda row: row.scatters + row.order,
}


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("most", [0, 1, 2])
def test_limits(load_scene, limit: str, most: int) -> None:
    scene = load_scene(window_text(ROUGH))
    more = {"max_scatters": 3} if limit != "max_scatters" else {}
    trace = mistray.trace(scene, rays=5_000, max_reflections=2, **{limit: most}, **more)
    counts = [LIMITS[limit](row) for row in trace.paths]
    assert max(counts) == most
    assert abs(trace.energy.closure) < 1e-5
    assert trace.energy.cut["max_generations" if limit == "max_generations" else "max_scatters"] > 0


def test_aimed_rays_alone_one_in_one_out(load_scene) -> None:
    """Light that has no target, here the reflected, is not sent at random then; the aimed carry the same as all do."""
    scene = load_scene(window_text(ROUGH))
    found = {}
    for splitting, rays in (("split", 50_000), ("one", 400_000)):
        trace = mistray.trace(scene, rays=rays, max_scatters=2, max_random_scatters=0, splitting=splitting)
        assert {LIMITS["max_random_scatters"](row) for row in trace.paths} == {0}
        assert abs(trace.energy.closure) < 1e-5
        found[splitting] = scattered(trace)
    (split, split_se), (one, one_se) = found.values()
    assert one_se < 0.03 * one
    assert abs(z_score(one, split, np.hypot(one_se, split_se))) < z_limit(1)


def test_without_scatter_surfaces_lose_what_they_would_scatter(load_scene) -> None:
    """Totals of the model at normal incidence, twice, exactly; both faces scatter what is reflected as well."""
    scene = load_scene(window_text(ROUGH))
    energy = mistray.trace(scene, rays=1000, max_scatters=0, max_reflections=0).energy
    total = 0.0413436938882 * 2e-3 / 2.5e-3  # float64 test vector of A = 0.0025, B = 0.001, g = 1.8
    direct, lost = 0.96**2 * (1 - total) ** 2, total + 0.96 * (1 - total) * total
    assert energy.detected_W / energy.launched_W == pytest.approx(direct, rel=1e-4)
    assert energy.cut["max_scatters"] / energy.launched_W == pytest.approx(lost, rel=1e-3)


def test_a_surface_can_ask_for_more_random_rays(load_scene) -> None:
    """Same flux, more hits of the detector, from that surface only; false alarm 1e-3."""
    plain = window_text(ROUGH)
    more = plain.replace(REAR, f'<integer name="scatter_rays" value="8"/>{REAR}')
    assert more != plain
    traces = [mistray.trace(load_scene(text), rays=40_000, aim="none", seed=k) for k, text in enumerate((plain, more))]
    hits = [{name: sum(r.rays for r in t.paths if r.scatter_1 == name) for name in ("front", "rear")} for t in traces]
    assert hits[1]["rear"] == pytest.approx(8 * hits[0]["rear"], rel=0.1)
    assert hits[1]["front"] == pytest.approx(hits[0]["front"], rel=0.1)
    (a, a_se), (b, b_se) = map(scattered, traces)
    assert abs(z_score(a, b, np.hypot(a_se, b_se))) < z_limit()


@pytest.mark.parametrize("faces", [("front",), ("front", "rear")])
def test_one_in_one_out_at_some_surfaces(load_scene, faces: tuple[str, ...]) -> None:
    """Same flux of scattered and of all light with fewer segments; false alarm 1e-3 for all four comparisons."""
    settings, text = {"rays": 200_000, "max_scatters": 2}, window_text(ROUGH, SHARP)
    split = mistray.trace(load_scene(text), **settings)
    for place in [{"front": FRONT, "rear": REAR}[face] for face in faces]:
        assert place in text
        text = text.replace(place, f'<string name="splitting" value="one"/>{place}', 1)
    one = mistray.trace(load_scene(text), seed=7, **settings)
    assert one.segments < split.segments
    assert abs(one.energy.closure) < 1e-5
    (a, a_se), (b, b_se) = scattered(one), scattered(split)
    assert abs(z_score(a, b, np.hypot(a_se, b_se))) < z_limit(4)
    both = np.hypot(one.energy.detected_se_W, split.energy.detected_se_W)
    assert abs(z_score(one.energy.detected_W, split.energy.detected_W, both)) < z_limit(4)


def test_a_surface_of_fixed_shares_is_unbiased_one_in_one_out(load_scene) -> None:
    """R = 0.2, T = 0.8 and no scatter: every ray has one segment behind the face, 80 % of them go on, ± 3.3 SE."""
    face = interface_xml("air", "air", R=0.2, T=0.8, splitting="one")
    front = shape_xml("asphere", "front", 0.0, face, semi_diameter=50.0)
    detector = shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0)
    scene = load_scene(scene_text(front, detector))
    trace = mistray.trace(scene, rays=100_000)
    assert trace.segments == 200_000
    share = trace.energy.detected_W / trace.energy.launched_W
    assert abs(z_score(share, 0.8, np.sqrt(0.16 / 100_000))) < z_limit()

"""Rays that scatter in the tree: against a slow Monte Carlo in float64, by all modes; what a limit cuts is booked."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import beams, scatter, scatter_integrals, scene_xml
from oracles import scatter_scenes as scenes
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from oracles.statistics import assert_z, z_limit, z_score
from tiers import slow_unless

import mistray

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*/scene.xml"))
ROUGH = bsdf_xml("harvey_shack", b0=0.5, l=0.02, s=-1.5)
PAINT = bsdf_xml("paint", reflectance=0.05)
LIMITS = {"single": {"max_scatters": 1, "max_reflections": 1}, "double": {"max_scatters": 2, "max_reflections": 0}}
MODES: dict[str, dict[str, Any]] = {
    "unaimed": {"aim": "none", "rays": 200_000},
    "aimed": {"aim": "auto", "rays": 60_000},
    "many rays a hit": {"aim": "auto", "rays": 20_000, "scatter_rays": 3, "aimed_rays": 2},
    "no roulette": {"aim": "auto", "rays": 10_000, "scatter_threshold": 0.0},
    "one in, one out": {"splitting": "one", "rays": 1_000_000},
}


class TestAgainstMonteCarlo:
    """Strongest paths at a joint false alarm of 1e-3, totals within 4.5 standard errors of 32 batches (1e-4 each)."""

    TEXT = scenes.lenses_text(bsdf_xml("abg", A=0.02, B=0.05, g=2.0), wall=scenes.wall_xml(0.3))

    @pytest.fixture(scope="class", params=LIMITS)
    @classmethod
    def oracle(cls, request: pytest.FixtureRequest) -> tuple[str, scatter.Books]:
        model, models = scene_xml.parse_scene(cls.TEXT), scatter.scatter_models(cls.TEXT)
        beam = beams.collimated(model.emitters[0], 8_000, beams.start_distance(model, model.emitters[0]))
        start, limits = (beam.origin, beam.direction, beam.power), LIMITS[request.param]
        return request.param, scatter.trace(model, models, *start, 550.0, **limits)

    @pytest.mark.parametrize("mode", MODES)
    def test_paths_and_books(self, load_scene, oracle: tuple[str, scatter.Books], mode: str) -> None:
        name, books = oracle
        t = mistray.trace(load_scene(self.TEXT), seed=3, **LIMITS[name], **{"flux_threshold": 0.0, **MODES[mode]})
        rows: dict[str, list[int]] = {}
        for row in t.paths:
            events = row.events.replace(":i", ":t").replace(":j", ":r")  # aimed as if at random
            rows.setdefault(events, []).append(row.path_id)
        # a rare path may have no ray of the oracle's
        rare, _ = t.paths.power([number for path in set(rows) - set(books.paths) for number in rows[path]])
        assert rare < 1e-3 * t.energy.launched_W
        strong = sorted(books.paths, key=lambda path: -books.power(path)[0])[:14]
        assert sum(":t" in path or ":r" in path for path in strong) >= 8
        measured, expected = np.array([[t.paths.power(rows[path]) for path in strong], list(map(books.power, strong))])
        se = np.hypot(measured[:, 1], expected[:, 1])
        assert_z(f"{mode}, paths", measured[:, 0], expected[:, 0], se, names=strong, floor=1e-6 * books.launched_W)
        e = t.energy
        totals = [((e.detected_W, e.detected_se_W), books.detected)]
        totals += [(e.absorbed[name], scatter.mean_and_se(flux)) for name, flux in books.absorbed.items() if flux.any()]
        totals.append(((e.escaped_W, e.escaped_se_W), scatter.mean_and_se(books.escaped)))
        measured, expected = np.array(totals).swapaxes(0, 1)
        se = np.hypot(measured[:, 1], expected[:, 1])
        assert_z(f"{mode}, books", measured[:, 0], expected[:, 0], se, k=4.5)
        assert abs(e.closure) < 1e-6


UNAIMED = {"rays": 8_000_000, "aim": "none", "max_scatters": 1}


def plate_text(model: str, **detector: Any) -> str:
    """A narrow beam of 1 W on a plate that scatters in transmission, and a detector."""
    plate = placed_xml("asphere", "plate", scattering_xml([model], R=0.0, T=1.0), semi_diameter=1.0)
    meter = placed_xml("asphere", "detector", pixels=4, **detector)
    return scenes.scatter_scene(beam_xml(1e-3, power=1.0, distance=5.0), plate, meter)


@pytest.mark.parametrize("kind", ["specular peak", "far tail"])
def test_random_rays_where_few_go(load_scene, kind: str) -> None:
    """Unaimed rays where 1e-5 to 1e-3 of the light goes, and a rounded probability shows; false alarm 6e-5."""
    (a, b, g), axis_deg, half_deg = {
        "specular peak": ((0.02, 0.1, 2.0), 0.0, 0.25),
        "far tail": ((1e-5, 1e-9, 3.0), 60.0, 25.0),
    }[kind]
    axis, half = np.radians([axis_deg, half_deg])
    towards = np.array([np.sin(axis), 0.0, np.cos(axis)])
    place = {"at": 100 * towards, "facing": towards, "semi_diameter": float(100 * np.tan(half))}
    t = mistray.trace(load_scene(plate_text(bsdf_xml("abg", A=a, B=b, g=g), **place)), **UNAIMED)
    expected = scatter_integrals.cone_flux(scatter_integrals.abg(a, b, g), 0.0, axis_deg, 0.0, half_deg)
    (row,) = (row for row in t.paths if row.scatter_1 == "plate")
    assert row.rays > 100
    assert_z(kind, row.power_W, expected, row.power_se_W, k=4.0)
    assert row.power_se_W < 0.1 * expected


def test_a_gaussian_has_no_halo(load_scene) -> None:
    """Ten widths and more from the peak is nothing: no ray of 8 million gets to a detector there."""
    model = bsdf_xml("gaussian_lobe", total=0.5, width=0.01, event="transmission")
    ring = {"at": (0.0, 0.0, 1.0), "inner_semi_diameter": 0.1, "semi_diameter": 5.0}
    t = mistray.trace(load_scene(plate_text(model, **ring)), **UNAIMED)
    assert (len(t.paths), t.energy.escaped_W) == (0, pytest.approx(1.0, rel=1e-3))


# One branch at every hit is much the same kernel: two scenes show it, all others are slow
SPLITTING = [
    pytest.param(path, how, marks=slow_unless(how == "split" or path.parent.name in ("baffle_tube", "phone_camera")))
    for path in SCENES
    for how in ("split", "one")
]


@pytest.mark.parametrize(("path", "splitting"), SPLITTING)
def test_energy_closes(path: Path, splitting: str, tmp_path: Path) -> None:
    """1e-5 in every scene with scatter on every surface, in the field and outside of it; nothing is negative."""
    text = path.read_text(encoding="utf-8")
    scene_file = write(tmp_path, scenes.rough_and_painted(text, scene_xml.parse_scene(text, path), [ROUGH], [PAINT]))
    scene = mistray.load(scene_file)
    near = scene_xml.parse_scene(text, path).emitters[0].kind == "point_source"
    for field_deg in (0.0, 2.0) if near else (0.0, 9.0, 40.0):
        for aim, below in (("none", "roulette"), ("auto", "cut")):
            limits = {"max_scatters": 2, "max_reflections": 1, "below_threshold": below}
            t = mistray.trace(scene, rays=500, field_deg=field_deg, splitting=splitting, aim=aim, **limits)
            e = t.energy
            assert abs(e.closure) < 1e-5, f"{field_deg} deg, aim {aim}: {e}"
            parts = [e.detected_W, e.escaped_W, *(watt for watt, _ in (*e.absorbed.values(), *e.absorbed_in.values()))]
            assert min(parts) >= 0
            # Of metres a seam between a face and its edge is open by the rounding of float32
            assert e.cut["medium"] <= (1e-12 * e.launched_W if path.parent.name == "rubin" else 0)
            assert sum(row.power_W for row in t.paths) == pytest.approx(e.detected_W, rel=1e-9)
            assert {row.id: row.absorbed_W for row in t.surfaces if row.id in e.absorbed} == {
                name: watt for name, (watt, _) in e.absorbed.items()
            }


FRONT, REAR = '<string name="front" value="air"/>', '<string name="front" value="1.5"/>'
DULL = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
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


@pytest.mark.parametrize("models", [(DULL,), (DULL, SHARP)])
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


COUNTED = {
    "max_scatters": lambda row: row.scatters,
    "max_random_scatters": lambda row: row.path.count("t") + row.path.count("r"),
    "max_optical_scatters": lambda row: row.scatters,  # nothing here is opaque but the detector
    "max_generations": lambda row: row.scatters + row.order,
}


@pytest.mark.parametrize("limit", COUNTED)
@pytest.mark.parametrize("most", [0, 1, 2])
def test_limits(load_scene, limit: str, most: int) -> None:
    more = {"max_scatters": 3} if limit != "max_scatters" else {}
    trace = mistray.trace(load_scene(window_text(DULL)), rays=5_000, max_reflections=2, **{limit: most}, **more)
    assert max(COUNTED[limit](row) for row in trace.paths) == most
    assert abs(trace.energy.closure) < 1e-5
    assert trace.energy.cut["max_generations" if limit == "max_generations" else "max_scatters"] > 0


def test_aimed_rays_lost_light_and_random_rays(load_scene) -> None:
    """Light that has no target, here the reflected, is not sent at random then; the aimed carry the same as all do."""
    scene = load_scene(window_text(DULL))
    found = {}
    for splitting, rays in (("split", 50_000), ("one", 400_000)):
        trace = mistray.trace(scene, rays=rays, max_scatters=2, max_random_scatters=0, splitting=splitting)
        assert {COUNTED["max_random_scatters"](row) for row in trace.paths} == {0}
        assert abs(trace.energy.closure) < 1e-5
        found[splitting] = scattered(trace)
    (split, split_se), (one, one_se) = found.values()
    assert one_se < 0.03 * one
    assert abs(z_score(one, split, np.hypot(one_se, split_se))) < z_limit(1)
    # Totals of the model at normal incidence, twice, exactly; both faces scatter what is reflected as well
    scene = load_scene(window_text(DULL))
    energy = mistray.trace(scene, rays=1000, max_scatters=0, max_reflections=0).energy
    total = 0.0413436938882 * 2e-3 / 2.5e-3  # float64 test vector of A = 0.0025, B = 0.001, g = 1.8
    direct, lost = 0.96**2 * (1 - total) ** 2, total + 0.96 * (1 - total) * total
    assert energy.detected_W / energy.launched_W == pytest.approx(direct, rel=1e-4)
    assert energy.cut["max_scatters"] / energy.launched_W == pytest.approx(lost, rel=1e-3)
    # Same flux, more hits of the detector, from that surface only; false alarm 1e-3
    plain = window_text(DULL)
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
    settings, text = {"rays": 200_000, "max_scatters": 2}, window_text(DULL, SHARP)
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
    trace = mistray.trace(load_scene(scene_text(front, detector)), rays=100_000)
    assert trace.segments == 200_000
    assert abs(z_score(trace.energy.detected_W / trace.energy.launched_W, 0.8, np.sqrt(0.16 / 100_000))) < z_limit()

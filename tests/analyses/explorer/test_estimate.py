"""What the explorer says at once agrees with what a trace of the same state finds, in the coatings that are put on."""

import json
import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from oracles.small_scenes import write
from refusals import refused

import mistray
from mistray import MistrayError
from mistray.analyses.explorer import explorer as module
from mistray.analyses.explorer.controls import AS_IT_IS, COATING, controls_of
from mistray.analyses.explorer.explorer import Explorer, _kinds_of_coatings
from mistray.analyses.explorer.looks import Looks
from mistray.prescription import from_zemax
from mistray.surfaces.optics import unpolarized_shares

TOTALS = ("stray_W", "direct_W", "ratio")


def test_nothing_moved_is_what_was_traced(at_start):
    view = at_start.view()
    t = mistray.trace(mistray.load("singlet_window_detector"), rays=2000, field_deg=0.0, max_reflections=2)
    stray = [row for row in t.paths if row.kind != "direct"]
    assert (view["label"], view["left_out"]) == ("traced", [])
    assert view["remedy"]["surface"].startswith(("window", "L1"))
    assert view["stray_W"][0] == pytest.approx(sum(row.power_W for row in stray), rel=1e-12)
    strongest = next(path for path in view["paths"] if path["rank_power"] == 0)
    assert strongest["power_W"] == stray[0].power_W
    worst = mistray.ghosts(mistray.load("singlet_window_detector"), 0.0, rays=2000, max_reflections=2).top(0.0, 1)
    assert (view["paths"][0]["label"], view["paths"][0]["rank_rms"]) == (worst.label.iloc[0], 0)
    assert at_start._guess.map_W.sum() == pytest.approx(at_start._guess.stray_W.value, rel=1e-5)
    json.dumps(view, allow_nan=False)


@pytest.mark.quick
def test_a_share_of_the_detector_scales_its_ghosts_exactly(at_start):
    before, control = at_start.view(), at_start.controls["detector.bsdf.R"]
    view = at_start.move({control.name: control.start / 4})
    assert view["label"] == "estimate"
    absorbed = (1 - control.start / 4) / (1 - control.start)
    ghosts = []
    for one in (view, before):
        ghosts.append(sum(path["power_W"] for path in one["paths"] if "detector:R" in path["events"].split()))
    assert ghosts[0] / ghosts[1] == pytest.approx(absorbed / 4, rel=1e-6)
    assert view["direct_W"][0] / before["direct_W"][0] == pytest.approx(absorbed, rel=1e-6)
    found = at_start.settle()
    assert found["label"] == "traced"
    assert abs(found["difference"]["percent"]) < 1e-3  # rounding of the kernel


def test_a_coating_is_followed_within_what_the_sample_of_rays_knows(at_start):
    part = next(name for name in at_start.controls if name.startswith("coating "))
    before = at_start.view()
    estimate = at_start.move({part: "bbar3"})
    assert estimate["label"] == "estimate"
    # The sample of rays adds errors to those of the trace; in the ratio those of both lights add up, squared
    squares = [[(view[name][1] / view[name][0]) ** 2 for name in TOTALS] for view in (estimate, before)]
    stray, direct, ratio = np.subtract(*squares)
    assert min(stray, direct) > 0
    assert ratio == pytest.approx(stray + direct, rel=1e-6)
    traced = at_start.settle()
    assert traced["label"] == "traced"
    for name in TOTALS:
        assert estimate[name][0] == pytest.approx(traced[name][0], rel=5e-3)
    by_events = {path["events"]: path["power_W"] for path in estimate["paths"]}
    for path in traced["paths"][:8]:
        assert by_events[path["events"]] == pytest.approx(path["power_W"], rel=0.03)
    # Layers and wavelength together with a coating
    at_start.move({part: "mgf2_quarter_wave"})
    at_start.settle()
    estimate = at_start.move({"layers": 130.0, "wavelength": 600.0})
    assert any("wavelength" in text for text in estimate["left_out"])
    traced = at_start.settle()
    assert estimate["stray_W"][0] == pytest.approx(traced["stray_W"][0], rel=0.02)


def test_a_field_between_two_that_are_known(at_start):
    """Both ends weigh the same, and the error holds what a trace finds there, which is not half way."""
    first = at_start.view()
    alone = at_start.move({"field": 1.0})
    assert any("all as at 0°" in text for text in alone["left_out"])
    assert alone["stray_W"] == [first["stray_W"][0]] * 2
    at_start.move({"field": 0.0})
    at_start.prepare()
    view = at_start.move({"field": 1.0})
    assert view["label"] == "estimate"
    t = mistray.trace(mistray.load("singlet_window_detector"), rays=2000, field_deg=1.0, max_reflections=2)
    stray, direct = (sum(row.power_W for row in t.paths if (row.kind == "direct") == own) for own in (False, True))
    for name, exact in (("stray_W", stray), ("direct_W", direct), ("ratio", stray / direct)):
        value, error = view[name]
        assert abs(value - exact) < 2 * error
        assert error < 0.1 * value
    assert any("between those at 0° and 2°" in text for text in view["left_out"])
    path = next(path for path in view["paths"] if "detector:R" not in path["events"])
    detail = at_start.detail(path["events"])  # at the field of the view, too, not at that of the last trace
    assert detail["power_W"] == pytest.approx(path["power_W"], rel=1e-12)
    best = detail["remedies"][0]
    assert best["stray_W"] == pytest.approx(at_start.move({best["control"]: best["choice"]})["stray_W"][0], rel=1e-12)
    at_start.move({best["control"]: best["now"]})
    other = at_start.move({"field": 2.0})
    assert other["left_out"] == []
    middle = 0.5 * (first["stray_W"][0] + other["stray_W"][0])
    assert view["stray_W"][0] == pytest.approx(middle, rel=1e-9)


def test_detail_names_the_surfaces_and_a_coating_that_weakens_it(at_start):
    view = at_start.view()
    path = next(p for p in view["paths"] if "detector:R" not in p["events"])
    detail = at_start.detail(path["events"])
    assert detail["rays"]
    turns = {turn["surface"] for turn in detail["turns"]}
    assert turns == {w.rpartition(":")[0] for w in path["events"].split() if w[-1] not in "TA"}
    assert detail["remedies"][0]["stray_W"] < view["stray_W"][0]


def test_impossible_values_are_refused_and_nothing_moves(at_start):
    """Nor do values for which a model does not hold."""
    before = dict(at_start.state)
    for values, said in (
        ({"nothing": 1.0}, "nothing"),
        ({"field": float("nan")}, "nan"),
        ({"field": 1e308}, "1e\\+308"),
        ({"field": "0"}, "'0'"),
        ({"field": True}, "True"),
        ({"layers": [100]}, "\\[100\\]"),
        ({"coating L1": "gold"}, "gold"),
        ({"coating L1": 3}, "3"),
    ):
        with refused(said):
            at_start.move({"layers": 90.0} | values)
        assert at_start.state == before
    explorer = Explorer("baffle_tube", field_deg=[0.0], rays=200)
    explorer.settle()
    name = next(name for name in explorer.controls if name.endswith("rms_nm"))
    before = explorer.state[name]
    with refused("rough"):
        explorer.move({name: explorer.controls[name].high})
    assert explorer.state[name] == before


def test_scatter_models_are_followed_ray_by_ray():
    """Roughness of mirrors; paint of a wall that the detector sees; particles by the area that they cover."""
    for scene, field, name, factor in (
        ("newtonian_scatter", 1.0, "polish_2nm.rms_nm", 2.0),
        ("plate_and_wall", 20.0, "grey.reflectance", 0.5),
        ("newtonian_scatter", 1.0, "particles_400.level", 1.4),
    ):
        explorer = Explorer(scene, field_deg=[field], rays=5000, max_scatters=1)
        explorer.settle()
        before = explorer.view()
        estimate = explorer.move({name: factor * float(explorer.state[name])})
        assert estimate["stray_W"][0] != pytest.approx(before["stray_W"][0], rel=1e-3)
        assert any("specular beams" in text for text in estimate["left_out"])
        assert estimate["stray_W"][0] == pytest.approx(explorer.settle()["stray_W"][0], rel=0.06), name


def test_a_shape_is_followed_to_first_order():
    """Bending a lens moves light past its rims: derivative times way, and the trace beside it."""
    explorer = Explorer("lens_and_window", field_deg=[2.0], control=["L1_front.curvature"], rays=20_000)
    explorer.prepare()
    before, control = explorer.view(), explorer.controls["L1_front.curvature"]
    start = float(control.start)
    estimate = explorer.move({control.name: start + 0.5 * (control.low - start)})
    assert any("first order" in text for text in estimate["left_out"])
    assert estimate["stray_W"][1] > before["stray_W"][1]
    traced = explorer.settle()
    assert traced["stray_W"][0] != pytest.approx(before["stray_W"][0], rel=1e-3)
    off = estimate["stray_W"][0] - traced["stray_W"][0]
    assert abs(off) < 4.5 * np.hypot(estimate["stray_W"][1], traced["stray_W"][1])


@pytest.mark.long
def test_a_stop_that_the_beam_just_fills_has_no_derivative():
    """Its derivatives differ on its two sides: the estimate leaves its move out, says so, and stays a number."""
    explorer = Explorer("phone_camera", field_deg=[5.0], control=["stop_front.r1"], rays=1000)
    explorer.prepare()
    assert np.isnan(explorer._traced.slopes["stop_front.r1"].value)
    for part in (0.98, 0.96):
        view = explorer.move({"stop_front.r1": part * float(explorer.controls["stop_front.r1"].start)})
        assert "no derivative; all as traced" in view["left_out"][0]
        json.dumps([view, explorer.settle()], allow_nan=False)


def test_what_cannot_be_done_ahead_is_said_once():
    """Derivatives of polarised light, and light that misses the lens; the rest is done all the same."""
    explorer = Explorer("singlet_window_detector", field_deg=[0.0, 89.0, 1.0], rays=200, polarization="stokes",
                        control=["L1_front.curvature"])  # fmt: skip
    explorer.prepare()
    assert explorer.idle
    assert set(explorer._grid) >= {0.0, 1.0}
    assert "derivatives" in explorer._impossible  # not of polarised light
    assert explorer.view()["message"]
    view = explorer.move({"L1_front.curvature": float(explorer.controls["L1_front.curvature"].high)})
    assert any("no derivative" in text for text in view["left_out"])
    assert any("unpolarised" in text for text in explorer.move({"layers": 90.0})["left_out"])
    explorer.settle()
    assert set(explorer._grid) == {0.0}  # the other field was traced with another shape
    camera = Explorer("phone_camera", field_deg=[0.0], rays=200)  # whose rims that meet move together
    (control,) = [one for one in camera.controls.values() if one.name.endswith(" radius")]
    assert set(control.keys) == {"stop_front.r1", "stop_wall.r0", "stop_wall.r1", "stop_rear.r0"}


def test_a_trace_that_fails_is_over(at_start, monkeypatch):
    monkeypatch.setattr(module, "trace", Mock(side_effect=MistrayError("no light")))
    at_start.move({"layers": 91.0})
    for work in (at_start.settle, at_start.prepare):
        with refused("no light"):
            work()
        assert at_start.view()["busy"] == "waiting to trace"


CHOSEN = {"cooke_triplet": ("L2", "bbar3", 550.0), "lwir": ("L2", "bbar4_lwir", 1e4)}


@pytest.mark.parametrize("name", CHOSEN)
def test_an_estimate_has_the_coating_that_is_put_on(name, tmp_path):
    """On a part whose glass is not that of the preset."""
    path, (part, preset, nm) = mistray.scene.find("cooke_triplet"), CHOSEN[name]
    if name == "lwir":
        path = tmp_path / "lwir.xml"
        from_zemax(Path(__file__).parents[3] / "examples" / "lwir_camera.zmx").to_xml(path)
    scene = mistray.load(path)
    controls = controls_of(path, scene, [0.0], [nm], ["detector.z"])
    state = {key: control.start for key, control in controls.items()} | {f"coating {part}": preset}
    looks = Looks(scene, controls).of(state)
    coated = {shape.id(): shape.bsdf() for shape in mistray.coat(path, {part: preset}).shapes()}
    bare = {shape.id(): shape.bsdf() for shape in scene.shapes()}
    for surface in controls[f"coating {part}"].surfaces:
        sides = bare[surface].complex_indices(nm)
        shares = [
            np.array(unpolarized_shares(coating, nm, sides, False, True, np.array([1.0, 0.8])))
            for coating in (looks[surface].coating, coated[surface].coating, mistray.coatings.preset(preset))
        ]
        np.testing.assert_allclose(shares[0], shares[1], atol=1e-6)
        assert np.abs(shares[0] - shares[2]).max() > 1e-4, "the design is another one"
    for coatings in _kinds_of_coatings(controls):  # compiled ahead
        assert all(choice in controls[one].choices for one, choice in coatings.items())
    without = {key: replace(one, choices=one.choices[:2]) for key, one in controls.items()}
    assert [set(coatings.values()) for coatings in _kinds_of_coatings(without)] == [{"bare"}]
    # Choices suit the body and the light
    visible = name == "cooke_triplet"
    for control in controls.values():
        if control.kind == COATING:
            presets = control.choices[2:]
            assert control.choices[0] == AS_IT_IS
            assert [name in presets for name in ("bbar3", "bbar4_lwir")] == [visible, not visible]
            assert not (visible and any(preset.endswith("wir") for preset in presets))
            mistray.coat(path, {control.label: presets[0]})
            mistray.coat(path, {control.label: presets[-1]})


def with_another_source(folder, change, *line):
    """A file of the singlet at its own or another line, and a second source like the first but for a change."""
    text = mistray.scene.find("singlet_window_detector").read_text(encoding="utf-8")
    text = text.replace(*line) if line else text
    source = re.search(r'<emitter type="collimated" id="source">.*?</emitter>', text, re.DOTALL)[0]
    other = source.replace('id="source"', 'id="other"').replace(*change)
    return write(folder, text.replace(source, source + other))


def test_sources_of_different_wavelengths(tmp_path):
    """Each keeps its own: one number for both would change the colour of one of them."""
    assert "wavelength" not in Explorer(with_another_source(tmp_path, ("587.5618", "450")), rays=200).controls


@pytest.mark.long
def test_a_path_of_several_wavelengths_and_sources(tmp_path):
    """One row for both wavelengths, the sum of what a trace finds at each; one for each source, told apart by it."""
    both = '<float name="wavelength_nm" value="587.5618"', '<string name="wavelength_nm" value="486 656"'
    path = with_another_source(tmp_path, ('"radius" value="10"', '"radius" value="5"'), *both)
    light, powers = {"rays": 500, "max_reflections": 2}, {}
    for row in mistray.trace(mistray.load(path), **light).paths:
        powers[row.source, row.events] = powers.get((row.source, row.events), 0.0) + row.power_W
    explorer = Explorer(path, **light)
    view = explorer.settle()
    shown = {(one["source"], one["events"]): one["power_W"] for one in view["paths"]}
    assert len(shown) == len(view["paths"])
    assert shown == pytest.approx({path: powers[path] for path in shown}, rel=1e-9)
    worst = view["paths"][0]["events"]
    labels = [one["label"].rpartition(" ")[2] for one in view["paths"] if one["events"] == worst]
    assert sorted(labels) == ["(other)", "(source)"]
    for name in ("source", "other"):
        assert explorer.detail(worst, name)["power_W"] == pytest.approx(powers[name, worst], rel=1e-9)
    with refused("several sources"):
        explorer.detail(worst)
    # A coating is followed at both wavelengths
    estimate = explorer.move({"coating window": "mgf2_quarter_wave"})
    assert estimate["stray_W"][0] == pytest.approx(explorer.settle()["stray_W"][0], rel=0.01)

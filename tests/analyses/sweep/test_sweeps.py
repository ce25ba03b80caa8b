"""Sweeps and edits: closed forms, the same numbers as scenes written out, the ranking, and what is refused."""

import json
import math
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
import vectors
from command_line import fails, succeeds
from lit_detector import lit
from oracles.object_scenes import common_area
from oracles.scatter_scenes import beam_xml, diffuser_xml, placed_xml, scatter_scene, wall_xml
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write
from refusals import each_refused, refused

import mistray
from mistray import sweeps
from mistray.analyses.sweep import page
from mistray.analyses.sweep.configurations import resolve
from mistray.analyses.sweep.edit_tables import pst_sweep_record, pst_sweep_text
from mistray.materials import refractive_index
from mistray.optimize import pst_bin
from mistray.physics import thinfilm
from mistray.prescription import Structure
from mistray.sweeps import write_configuration

FEW = {"rays": 256, "cache": False}
REFLECTANCES = {"weak": (0.1, 0.8), "strong": (0.3, 0.6)}
LENS = scene_text(
    shape_xml("asphere", "front", 0.0, interface_xml("air", "glass.csv"), radius=20.0, semi_diameter=4.0),
    shape_xml("asphere", "rear", 3.0, interface_xml("glass.csv", "air"), radius=-30.0, semi_diameter=4.0),
    shape_xml("asphere", "detector", 24.0, sensor=True, half_width=8.0, half_height=8.0),
)
GLASS = "wavelength_nm,n,k\n400,{a},0\n700,{b},0\n"


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    return write(tmp_path, plates_text(1, R=0.1, T=0.8))


@pytest.fixture
def lens(tmp_path: Path) -> Path:
    (tmp_path / "glass.csv").write_text(GLASS.format(a=1.53, b=1.51))
    return write(tmp_path, LENS)


def states() -> dict[str, dict[str, float]]:
    return {name: {"p0_*.bsdf.R": r, "p0_*.bsdf.T": t} for name, (r, t) in REFLECTANCES.items()}


class TestNumbers:
    def test_closed_forms(self, plate: Path) -> None:
        """A plate sends T² straight through and T² R² after two reflections, at every angle and wavelength."""
        found = mistray.sweep(plate, [0, 10], [500, 600], states(), max_reflections=2, **FEW)
        table = found.to_pandas()
        assert len(found) == len(table) == 8
        assert not table.duplicated(["configuration", "field_deg", "wavelength_nm"]).any()
        for name, (r, t) in REFLECTANCES.items():
            rows, direct = table[table.configuration == name], math.pi * t**2
            assert list(rows.launched_W) == pytest.approx([math.pi] * 4, rel=1e-6)
            exact = {"direct_W": direct, "stray_W": direct * r**2, "ghost_to_signal": r**2}
            assert rows[[*exact]].to_numpy() == pytest.approx(np.tile([*exact.values()], (4, 1)), rel=1e-5)
            assert list(rows.ghost_W) == pytest.approx(list(rows.stray_W), rel=1e-9)
            assert list(rows.detected_W) == pytest.approx(list(rows.direct_W + rows.stray_W), rel=1e-6)
            assert list(rows.structure_W) == [0.0] * 4
            assert set(rows.worst_path) == {"p0_rear → p0_front"}
            assert list(rows.worst_power_W) == pytest.approx(list(rows.stray_W), rel=1e-9)
            assert max(abs(rows.closure)) < 1e-5
        assert found.estimate("ghost_to_signal", "strong", 10.0, 500.0).value == pytest.approx(0.09, rel=1e-5)

    def test_every_row_is_the_trace_of_a_scene_written_out(self, lens: Path, tmp_path: Path) -> None:
        """Shape, place and index, each in a scene file that says so, traced alone by `mistray.trace`."""
        moved = {"rear.curvature": -1 / 25, "detector.z": 0.5, "*glass.csv.index": 0.01}
        found = mistray.sweep(lens, [0, 5], [450, 650], {"as it is": {}, "moved": moved}, **FEW)
        (tmp_path / "other").mkdir()
        (tmp_path / "other" / "glass.csv").write_text(GLASS.format(a=1.54, b=1.52))
        text = LENS.replace("-30.0", "-25.0").replace('z="24.0"', 'z="24.5"')
        assert text.count("-25.0") == text.count("24.5") == 1
        scenes = {"as it is": lens, "moved": write(tmp_path / "other", text)}
        for row in found.rows:
            light = {key: row[key] for key in ("field_deg", "wavelength_nm")}
            t = mistray.trace(mistray.load(scenes[row["configuration"]]), rays=256, **light)
            direct, worst = t.paths[0], max((p for p in t.paths[1:]), key=lambda p: p.power_W)
            assert row["direct_W"] == pytest.approx(direct.power_W, rel=1e-5)
            assert row["direct_rms_radius_mm"] == pytest.approx(direct.rms_radius_mm, rel=1e-4)
            assert row["direct_rms_radius_se_mm"] == pytest.approx(direct.rms_radius_se_mm, rel=1e-2)
            assert row["stray_W"] == pytest.approx(sum(p.power_W for p in t.paths[1:]), rel=1e-4)
            assert row["stray_W"] >= worst.power_W
        radii = found.to_pandas().groupby("configuration").direct_rms_radius_mm.apply(np.array)
        assert (abs(radii["moved"] / radii["as it is"] - 1) > 0.05).all()

    def test_the_scene_has_its_values_back(self, plate: Path) -> None:
        scene = mistray.load(plate)
        mistray.sweep(scene, [0], 550, states(), **FEW)
        params = mi.traverse(scene)
        assert np.array(params["p0_front.bsdf.R"]) == np.float32(0.1)
        with refused():
            mistray.sweep(scene, [0], 550, {"a": {"p0_front.bsdf.R": 0.5, "p0_front.bsdf.T": 0.8}}, **FEW)
        found = mistray.sweep(scene, configurations={"a": {}, **states()}, **FEW)
        assert (found.field_deg, found.wavelengths_nm) == ((0.0,), (550.0,))  # what the scene says
        assert len(found.trace("a").paths) == 2
        with refused("'weak' changes a scene that was given loaded"):
            found.trace("weak")
        assert np.array(params["p0_front.bsdf.R"]) == np.float32(0.1)


def test_the_trace_of_a_row(plate: Path) -> None:
    found = mistray.sweep(plate, [0, 10], [500, 600], states(), **FEW)
    for name in REFLECTANCES:
        t, row = found.trace(name, 10, 600), found.estimate("stray_W", name, 10, 600)
        assert sum(p.power_W for p in t.paths[1:]) == pytest.approx(row.value, rel=1e-9)
        assert (t.settings["field_deg"], t.settings["wavelength_nm"]) == (10.0, [600.0])
    weak = found.trace("weak", 10, 600)
    report = found.ghosts("strong", 500)
    assert list(report) == [0.0, 10.0]
    assert report.summary(10.0).stray_W.value == pytest.approx(found.estimate("stray_W", "strong", 10, 500).value)
    image, _ = weak.irradiance_of([1])  # asked after the other configuration was traced
    assert image.sum() * (100 / 64) ** 2 == pytest.approx(math.pi * 0.64 * 0.01, rel=1e-5)


@pytest.mark.usefixtures("no_kernels")
def test_kernels_are_compiled_once(lens: Path) -> None:
    """The second row may add one, as may the first decentre: numbers that were 0 are there for the first time."""
    changed = {"front.curvature": 0.04, "rear.curvature": -0.03, "detector.z": 0.3, "*glass.csv.index": 2e-3}
    states, counts = {"a": {}, "b": changed, "c": {"rear.y": 0.2, **changed}, "d": {"rear.y": 0.3, **changed}}, [0] * 24

    def count(done: float, rows: float) -> None:
        """New to this process since the last call; one found in the disk cache counts too."""
        entries = dr.kernel_history([dr.KernelType.JIT])
        dr.kernel_history_clear()
        row = min(math.ceil(done), rows) - 1
        counts[int(row)] += sum(not entry["cache_hit"] or entry["cache_disk"] for entry in entries)

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        mistray.sweep(lens, [0, 5, 9], (450, 550), states, progress=count, cache=False, rays=500)
    assert counts[0] > 0
    assert counts[2:12] == [0] * 10, str(counts)
    assert counts[12] <= 1
    assert counts[13:] == [0] * 11, str(counts)


def test_wrong_arguments(plate: Path) -> None:
    each_refused(
        (([0], [550, 550]), "give every wavelength once"),
        (([0], 550, {}), "configurations is empty"),
        (([0], 550, [sweeps.Configuration("a", {})] * 2), "configuration 'a' is given twice"),
        (([0], 550, {"a": 1.0}), "configuration .a.: values is 1; give a mapping"),
        (([0], 550, {"a": {"p0_frnt.z": 1}}), "'a': the scene has no parameter 'p0_frnt.z'; did you"),
        (([0], 550, {"a": {"q*.z": 1}}), r"no parameter 'q\*.z'"),
        (([0], 550, {"a": {"p0_front.z": math.nan}}), "'p0_front.z' is .nan.; it must be finite"),
        (([0], 550, {"a": {"p0_front.z": [1, 2]}}), "2 numbers are given; it has 1"),
        (([0], 550, {"a": {"p0_front.z": "far"}}), "is 'far'; give a number"),
        (([0], 550, {"a": {"p0_front.faces": 1}}), "is not a number but UInt"),
        (([0], 550, {"a": {"p0_rear.z": -5.0}}), "configuration 'a': surfaces 'p0_front' and 'p0_rear'"),
        by=lambda arguments: mistray.sweep(plate, *arguments, cache=False),
    )
    found = mistray.sweep(plate, [0, 1], 550, rays=64, cache=False)
    each_refused(
        (lambda: mistray.sweep(plate, ray=5), "sweep: there is no argument 'ray'"),
        (lambda: found.trace(), "field_deg is missing; choose from 0, 1"),
        (lambda: found.trace(field_deg=0, wavelength_nm=500), "wavelength_nm is 500; choose from 550"),
        (lambda: found.estimate("stray", field_deg=0), "no number 'stray' with an error; choose from detected_W"),
    )


@pytest.mark.parametrize(
    ("own", "words"), [('"field_deg" value="1"', "field angles"), ('"wavelength_nm" value="450"', "spectra")]
)
def test_sources_that_differ(tmp_path: Path, own: str, words: str) -> None:
    """A row is at one wavelength and one field: that of neither source would hold for both."""
    other = f'<emitter type="collimated"><float name="radius" value="1"/><float name={own}/></emitter>'
    scene = write(tmp_path, plates_text(1).replace("</scene>", f"{other}</scene>"))
    with refused(f"the sources of the scene have several {words}; give"):
        mistray.sweep(scene, rays=64, cache=False)


class TestToml:
    def test_values(self) -> None:
        found = sweeps.read_configurations(vectors.DATA / "zoom_states.toml")
        tele = {"G2.z": (1.5,), "AR.thickness_nm": (90.0, 120.5)}
        expected = {"as designed": {}, "tele": tele, "warm": {"N-BK7.index": (1e-4,)}}
        assert [(one.name, dict(one.values)) for one in found] == [*expected.items()]

    def test_the_example(self) -> None:
        path = Path(__file__).parents[3] / "examples" / "triplet_states.toml"
        scene = mistray.load("cooke_triplet")
        designed, warm, moved = resolve(scene, mi.traverse(scene), sweeps.read_configurations(path))
        assert designed.values == {}
        assert set(moved.values) >= {"L2_front.z", "L2_rear.z", "L2_edge.z"}
        glasses = [key for key, value in warm.values.items() if value == np.float32(1e-4)]
        assert len(glasses) >= 4
        assert {warm.units[key] for key in glasses} == {"1"}

    def test_wrong(self, tmp_path: Path) -> None:
        path = tmp_path / "states.toml"
        with refused(r"configurations '.*states\.toml': No such file or directory"):
            sweeps.read_configurations(path)
        for text, words in vectors.toml("refusals.toml")["configurations"]:
            path.write_text(text, encoding="utf-8")
            with refused(words):
                sweeps.read_configurations(path)


def numbers(scene) -> dict[str, np.ndarray]:
    params = mi.traverse(scene)
    keys = [key for key in list(params.keys()) if key.rpartition(".")[2] in ("x", "y", "z")]
    return {key: np.array(params[key]).ravel() for key in keys}


@pytest.mark.parametrize(
    ("scene", "key", "step"), [("baffle_tube", "tube_vane_3.z", 2.0), ("cooke_triplet", "L2.y", -0.25)]
)
def test_a_move(tmp_path, scene: str, key: str, step: float) -> None:
    """One surface, and a lens as a body: all its surfaces and edges go the same way, nothing else does."""
    before = numbers(mistray.load(scene))
    file = write_configuration(scene, sweeps.Configuration("moved", {key: step}), tmp_path / "moved.xml")
    after = numbers(mistray.load(file))
    assert before.keys() == after.keys()
    part, _, axis = key.rpartition(".")
    moved = {name for name in before if not np.array_equal(before[name], after[name])}
    own = {name for name in before if name.startswith((f"{part}.", f"{part}_")) and name.endswith(f".{axis}")}
    assert moved == own
    for name in moved:
        np.testing.assert_allclose(after[name] - before[name], step, atol=1e-5)


@pytest.mark.parametrize("name", ["L.y", "?.y"])
def test_faces_that_stand_apart_move_along(load_scene, name: str) -> None:
    part = '<string name="part" value="L"/><transform'
    sides = ("front", 0.0, 1.0, ("air", "1.5")), ("rear", 3.0, 1.25, ("1.5", "air"))
    faces = [shape_xml("asphere", side, z, interface_xml(*own), semi_diameter=4.0, y=y) for side, z, y, own in sides]
    scene = load_scene(scene_text(*(face.replace("<transform", part) for face in faces)))
    (found,) = resolve(scene, mi.traverse(scene), [sweeps.Configuration("moved", {name: 5.0})])
    assert found.values == {"front.y": [5.0], "rear.y": [5.25]}


def test_paint_and_a_value_from_the_shell(capsys, tmp_path) -> None:
    file = tmp_path / "edited.xml"
    edit = ("--set", "tube_vane_3.z=1.5", "--paint", "tube_vane_2=R=0.3")
    assert str(file) in succeeds(capsys, "sweep", "baffle_tube", *edit, "--write-scene", file)
    shapes = {shape.id(): shape for shape in mistray.load(file).shapes()}
    assert float(shapes["tube_vane_2"].bsdf().coating.R) == pytest.approx(0.3)
    assert numbers(mistray.load(file))["tube_vane_3.z"] == pytest.approx(1.5)


def test_one_of_a_study(capsys, tmp_path) -> None:
    study, states = tmp_path / "states.toml", {"far": 3, "near": 1}
    far, near = (f'[[configuration]]\nname = "{n}"\nvalues = {{ "tube_vane_3.z" = {z} }}\n' for n, z in states.items())
    study.write_text(far + near, encoding="utf-8")
    command = ["sweep", "baffle_tube", study, "--write-scene", tmp_path / "far.xml"]
    assert "did you mean 'far'?" in fails(capsys, *command, "--configuration", "farr")
    assert "writes one configuration" in fails(capsys, *command)
    assert "--rays has no effect with --write-scene" in fails(capsys, *command, "--rays", 5)
    assert not (tmp_path / "far.xml").exists()
    succeeds(capsys, *command, "--configuration", "far")
    assert numbers(mistray.load(tmp_path / "far.xml"))["tube_vane_3.z"] == pytest.approx(3)


FIELD, SIGMAS = 10.0, 4.5
ANGLE, CELL = 15.0, 28.0  # of the ranking
HOLE, DETECTOR, DISTANCE = 2.5, 3.0, 10.0
LAYER_NM, COVER = 60.0, 1.5


def plate_and_wall(film: str = "", *more: str) -> str:
    """A plate before a detector, and beside them a grey wall that light meets and the detector sees."""
    glass = interface_xml("air", str(COVER)).removesuffix("</bsdf>") + film + "</bsdf>"
    plate = placed_xml("asphere", "plate", glass, semi_diameter=20.0)
    wall = placed_xml("asphere", "wall", wall_xml(0.4), at=(12.0, 0.0, 10.0), facing=(1.0, 0.0, 0.0), semi_diameter=5.0)
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, 20.0), pixels=4, semi_diameter=DETECTOR)
    return scatter_scene(beam_xml(5.0), plate, *more, wall, detector)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write(tmp_path, plate_and_wall())


def transmittance(layers: list[complex], nm: list[float], cosine: float) -> float:
    """Of unpolarised light into the plate at 550 nm."""
    return float(np.mean(thinfilm.reflectance_transmittance(1.0, layers, nm, COVER, 550.0, cosine)[1]))


def swept(scene: Path | mi.Scene, *configurations: sweeps.Configuration, **more: Any) -> sweeps.PstSweep:
    return sweeps.sweep_pst(scene, configurations, [FIELD], rays=20_000, max_scatters=1, **more)


def test_nothing_changes_nothing(scene: Path) -> None:
    found = swept(scene, sweeps.Configuration("nothing"))
    change = found.changed("nothing", FIELD, "total")
    assert (found.configurations, change.ratio) == (("as it is", "nothing"), 1)
    assert change.ratio_se < 1e-12 * change.before_se / change.before  # sums of the same rays in another order
    assert change.before_se > 0
    assert not any("no stray light" in text for text in found.warnings)
    # Without scatter and reflections there is none: 0 ± 0 is no measurement
    dark = sweeps.sweep_pst(scene, {"nothing": {}}, [FIELD], rays=1000, max_scatters=0, max_reflections=0)
    (text,) = [text for text in dark.warnings if "no stray light" in text]
    assert "10 deg" in text


def test_edits_say_that_their_light_is_unpolarised(tmp_path: Path) -> None:
    """The ghost of a plate at 45° is 1.548 times as bright by Stokes vectors; what is given is taken."""
    scene, edit = write(tmp_path, plates_text(1)), sweeps.Configuration("bent", {"p0_front.curvature": [1e-5]})
    told = "Stokes vectors change the ghost p0_rear → p0_front by +54.8"
    found = sweeps.sweep_pst(scene, [edit], [45.0], rays=2000)
    assert [text.partition(": ")[0] for text in found.warnings if told in text] == ["as it is", "bent"]
    assert not sweeps.sweep_pst(scene, [edit], [45.0], rays=2000, polarization="unpolarized").warnings
    assert any(told in text for text in sweeps.rank_edits(scene, 45.0, rays=2000, keys=["p0_front.z"]).left_out)


def test_paint_coating_block_and_errors(scene: Path) -> None:
    """What the wall scatters once goes with its reflectance, ray by ray: the error of the ratio is that of float32."""
    found = swept(
        scene,
        sweeps.Configuration("paint", paint={"w*": 0.1}),
        sweeps.Configuration("preset", paint={"wall": "flat_black"}),
        sweeps.Configuration("black", paint={"wall": 0.0}),
        sweeps.Configuration("value", {"wall.bsdf.paint.reflectance": 0.3}),
    )
    for name, expected in (("paint", 0.25), ("preset", 0.045 / 0.4), ("black", 0.0), ("value", 0.75)):
        change = found.changed(name, FIELD, "single_scatter")
        assert change.ratio == pytest.approx(expected, rel=1e-4), name
        assert change.ratio_se < 1e-4 * max(expected, 1e-9) + 1e-12 < change.before_se / change.before
    # The direct image goes with T of the plate, at 10° and unpolarised
    found = swept(scene, sweeps.Configuration("coat", coat={"plate": "MgF2 99.64"}), cell_deg=0.2)
    change = found.changed("coat", FIELD, "direct")
    cosine, n = np.cos(np.radians(FIELD)), complex(refractive_index("MgF2", 550.0))
    expected = transmittance([n], [99.64], cosine) / transmittance([], [], cosine)
    assert change.ratio == pytest.approx(expected, rel=1e-4)
    # A disc before the detector takes all; one that stands aside nothing, and it widens the beam of forward rays
    covers = sweeps.Configuration("covers", block=[Structure("covers", 0.0, 19.0, 15.0, 19.0)])
    aside = sweeps.Configuration("aside", block=[Structure("aside", 50.0, 19.0, 51.0, 19.0)])
    assert swept(scene, covers).changed("covers", FIELD, "direct").after == 0
    for method in ("joined", "forward"):
        change = swept(scene, aside, method=method).changed("aside", FIELD, "total")
        assert (change.ratio, change.ratio_se) == (pytest.approx(1, abs=1e-6), pytest.approx(0, abs=1e-6))
        assert change.before_se > 0
    # Of 12 seeds the ratios spread as their errors say
    # χ² of 11 degrees of freedom between its quantiles 1e-4 and 1 - 1e-4; a rim that blocks a part of the light
    rim = sweeps.Configuration("rim", block=[Structure("rim", 2.0, 15.0, 30.0, 15.0)])
    changes = [swept(scene, rim, seed=seed).changed("rim", FIELD, "total") for seed in range(12)]
    ratios, errors = (np.array([getattr(change, key) for change in changes]) for key in ("ratio", "ratio_se"))
    chi2 = np.sum(((ratios - np.average(ratios, weights=errors**-2)) / errors) ** 2)
    assert 1.5 < chi2 < 37.4


def test_tables_and_command(ringed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edits = tmp_path / "edits.toml"
    edits.write_text(
        '[[configuration]]\nname = "grey"\npaint = { "wall" = 0.2 }\n'
        '[[configuration]]\nname = "rim"\nblock = [{ name = "rim", r0 = 4.0, r1 = 30.0, z0 = 15.0 }]\n'
        'values = { "detector.z" = 0.5 }\n'
        '[[configuration]]\nname = "coated"\ncoat = { "plate" = "MgF2 99.64" }\n',
        encoding="utf-8",
    )
    grey, rim, coated = sweeps.read_configurations(edits)
    assert grey.paint == {"wall": 0.2}
    assert rim.block == (Structure("rim", 4.0, 15.0, 30.0, 15.0),)
    assert (coated.coat, coated.rebuilds) == ({"plate": "MgF2 99.64"}, True)
    out, few = tmp_path / "out", ["--pst-field-deg", "0:20:10", "--rays", "20000", "--max-scatters", "1"]
    ranking = ["--rank", "--step", "rim=0.3", "share=2%"]
    assert "rows" not in json.loads(succeeds(capsys, "sweep", ringed, *few, *ranking, "--json"))
    command = ["sweep", ringed, edits, *few, *ranking, "--out", out]
    record = json.loads(succeeds(capsys, *command, "--json"))
    assert record["configurations"] == ["as it is", "grey", "rim", "coated"]
    assert len(record["rows"]) == 9
    assert {row["step"] for row in record["ranking"] if row["method"] == "block"} == {0.3}
    rows, ranked_rows = (
        pd.read_csv(out / f"{name}.csv", comment="#", keep_default_na=False) for name in ("pst_sweep", "edit_ranking")
    )
    assert list(rows.after) == pytest.approx([row["after"] for row in record["rows"]])
    assert list(ranked_rows.label) == [row["label"] for row in record["ranking"]]
    assert {"pst_sweep.json", "pst_sweep.png", "report.html"} < {file.name for file in out.iterdir()}
    assert json.loads((out / "pst_sweep.json").read_text())["rows"] == record["rows"]
    assert "What each configuration does" in (out / "report.html").read_text(encoding="utf-8")
    printed = succeeds(capsys, *command, "--force")
    assert all(text in printed for text in ("coated", "grey", "wall.bsdf.paint.reflectance"))


def test_wrong_edits_are_refused(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    each_refused(
        ({"paint": {"wal": 0.1}}, "paint 'wal=0.1' fits no surface and no part; the nearest names are wall"),
        ({"paint": {"wall": "flat_blak"}}, "did you mean flat_black"),
        ({"coat": {"plate": "bbr3"}}, "coating 'bbr3'.*did you mean 'bbar3'"),
        ({"coat": {"wall": "bbar3"}}, "'wall' is opaque; give an opaque coating"),
        ({"block": [Structure("wall", 1.0, 0.0, 2.0, 0.0)]}, "it has an object 'wall' already"),
        by=lambda change: swept(scene, sweeps.Configuration("x", **change)),
        pattern="configuration 'x'.*{}",
    )
    x = sweeps.Configuration("x")
    each_refused(
        (lambda: swept(scene, x, relative_error=0.1), "relative_error would give the runs different rays"),
        (lambda: swept(scene, x, next_order=True), "next_order would give the runs different limits"),
        (lambda: swept(scene, sweeps.Configuration("as it is")), "this name is that of the scene without changes"),
        (lambda: swept(scene, x).changed("y", FIELD), "no configuration 'y'"),
    )
    for more in (["--pst-field-deg", "10"], ["none.toml", "--pst-field-deg", "10", "--field-deg", "1"]):
        fails(capsys, "sweep", scene, *more)


def test_a_loaded_scene(scene: Path) -> None:
    """Edits of a loaded scene are those of its file, with its numbers as they are; it stays as it is."""
    key, paint = "wall.bsdf.paint.reflectance", sweeps.Configuration("paint", paint={"w*": 0.1})
    loaded = mistray.load(scene)
    params = mi.traverse(loaded)
    assert swept(loaded, paint).changed("paint", FIELD, "single_scatter").ratio == pytest.approx(0.25, rel=1e-4)
    assert np.ravel(params[key]) == pytest.approx([0.4])
    params[key] = type(params[key])(0.2)
    params.update()
    back = swept(loaded, sweeps.Configuration("back", {key: 0.4})).changed("back", FIELD)
    assert back.ratio == pytest.approx(2, rel=1e-4)
    assert np.ravel(params[key]) == pytest.approx([0.2])
    with refused(r"configuration 'paint': 'wall.bsdf.paint.reflectance' of the scene is"):
        swept(loaded, paint)
    # A scene of a dict is moved and not painted
    loaded = lit({"type": "collimated", "radius": 3.0, "to_world": mi.ScalarTransform4f().translate([0, 0, -20])})
    found = sweeps.sweep_pst(loaded, {"moved": {"detector.z": 1.0}}, [FIELD], rays=2000)
    assert found.changed("moved", FIELD, "direct").ratio == pytest.approx(1, abs=0.05)
    with refused("a scene of a dict cannot be painted"):
        sweeps.sweep_pst(loaded, [sweeps.Configuration("dark", paint={"detector": 0.1})], [FIELD], rays=2000)


@pytest.fixture(scope="module")
def ringed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a coating on the plate, and a ring through whose hole the detector sees the light."""
    film = f'<bsdf type="thinfilm"><string name="layers" value="MgF2 {LAYER_NM}"/></bsdf>'
    ring = placed_xml("frustum", "ring", r0=HOLE, z0=20.0 - DISTANCE, r1=8.0, z1=20.0 - DISTANCE)
    return write(tmp_path_factory.mktemp("edits"), plate_and_wall(film, ring))


def ranked(scene: Any, light: str = "total", **more: Any) -> sweeps.EditRanking:
    return sweeps.rank_edits(scene, [ANGLE], light, **{"rays": 30_000, "max_scatters": 1, "cell_deg": CELL, **more})


def through_the_hole(hole: float = HOLE, distance: float = DISTANCE, nm: float = LAYER_NM) -> float:
    """Direct PST, mean over the solid angle of the cell: T cos θ times the part of the detector that sees the sky."""
    edges = np.radians(np.linspace(ANGLE - CELL / 2, ANGLE + CELL / 2, 2001))
    index, values = complex(refractive_index("MgF2", 550.0)), []
    for angle in (edges[1:] + edges[:-1]) / 2:
        d = distance * math.tan(math.asin(math.sin(angle) / COVER))  # between hole and detector, seen along the light
        passed = transmittance([index], [nm], math.cos(angle))
        values.append(passed * math.cos(angle) * common_area(d, hole, DETECTOR) / (math.pi * DETECTOR**2))
    return float(np.average(values, weights=np.diff(-np.cos(edges))))


def test_closed_forms(ringed: Path) -> None:
    """All four methods: four comparisons within 4.5 standard errors, false alarm 3e-5; the widest error is 10 %."""
    found = ranked(ringed, "direct", rays=1_200_000)
    value, error = found.pst[0]
    assert value == pytest.approx(through_the_hole(), abs=SIGMAS * error)
    expected = {
        "ring.r0": ("block", 0.1, "hole", (HOLE + 0.05, HOLE - 0.05)),
        "ring.z": ("move", 0.1, "distance", (DISTANCE - 0.05, DISTANCE + 0.05)),
        "plate.bsdf.coating.thickness_nm": ("coat", 1.0, "nm", (LAYER_NM + 0.5, LAYER_NM - 0.5)),
    }
    for label, (method, step, name, ends) in expected.items():
        change = through_the_hole(**{name: ends[0]}) - through_the_hole(**{name: ends[1]})
        edit = found[label]
        assert (edit.method, edit.step) == (method, step)
        derivative = edit.derivative[0]
        assert derivative.value * step == pytest.approx(change, abs=SIGMAS * derivative.se * step), label
        assert derivative.se * step < 0.1 * change
    painted = ranked(ringed, "single_scatter")["wall.bsdf.paint.reflectance"]
    assert (painted.method, painted.step) == ("paint", pytest.approx(0.004))
    # The light goes with the reflectance, ray by ray: nothing is uncertain about the relative change
    assert painted.change[0] == (pytest.approx(0.01, rel=1e-5), pytest.approx(0, abs=1e-7))
    assert painted.derivative[0].se > 1e-3 * painted.derivative[0].value


def test_parts_move_as_a_whole() -> None:
    """The derivative by the place of a lens is the sum of those by its surfaces, which are no edits of their own."""
    scene, settings = mistray.load("baffle_tube"), {"rays": 20_000, "max_scatters": 1, "cell_deg": 8}
    found = sweeps.rank_edits(scene, [6], keys=["lens_front.z", "detector.z", "*.tilt_x"], **settings)
    keys = ["lens_front.z", "lens_rear.z", "lens_edge.z"]
    gradient = mistray.gradient(pst_bin(scene, 6, **settings), mi.traverse(scene), keys)
    whole = sum(gradient.gradient[key][0] for key in keys)
    assert whole != 0
    assert found["lens.z"].derivative[0].value == pytest.approx(whole, rel=1e-9)
    labels = {edit.label for edit in found.edits}
    assert {"detector.z", "detector.tilt_x"} < labels
    assert not {*keys, "lens_front.tilt_x"} & labels


def test_several_angles_ranking_and_steps(ringed: Path) -> None:
    both = sweeps.rank_edits(ringed, [ANGLE, 25.0], "total", rays=20_000, max_scatters=1)
    metric = pst_bin(mistray.load(ringed), 25.0, "total", pst_field_deg=[ANGLE, 25.0], rays=20_000, max_scatters=1)
    # One width of the zones at rims for all edits, where a gradient by one of them may choose another
    gradient = mistray.gradient(metric, mi.traverse(metric.scene), ["ring.r0"], edge_width=both.edge_width[1])
    # Sums over lanes are in any order
    assert both.pst[1].value == pytest.approx(gradient.value, rel=1e-12)
    assert both["ring.r0"].derivative[1].value == pytest.approx(gradient.gradient["ring.r0"][0], rel=1e-12)
    assert list(both.to_pandas().angle_deg[:2]) == [ANGLE, 25.0]
    found = ranked(ringed, steps={"rim": 0.2, "wall.bsdf.*": "5 %", "coating": 3.0, "ring.z": "1 %"} | {"ring.z": 0.3})
    steps = {"ring.r0": 0.2, "plate.bsdf.coating.thickness_nm": 3, "ring.z": 0.3, "detector.z": 0.1}
    assert {label: found[label].step for label in steps} == steps
    assert found["wall.bsdf.paint.reflectance"].step == pytest.approx(0.02)
    assert {edit.method for edit in found.edits} == {"move", "block", "paint", "coat"}
    certain = [max(abs(c.value) - 2 * c.se for c in edit.change) for edit in found.edits]
    assert certain[0] == max(certain)
    table = found.to_pandas()
    np.testing.assert_allclose(table.change, table.derivative * table.step)
    np.testing.assert_allclose(table.change_percent, 100 * table.change / table.pst, rtol=1e-12)
    assert not {"plate.tilt_x", "detector.half_width"} & {edit.label for edit in found.edits if edit.method == "block"}


def test_wrong_steps_are_refused(ringed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    each_refused(
        ({"steps": {"rim": 0.0}}, "step of 'ring.*' is 0.0; give a number greater than 0 in mm"),
        ({"steps": {"rim": "nan"}}, "is nan"),
        ({"steps": {"ring.z": "1 %"}}, "'ring.z' is 1 % of 0; give it in mm"),
        ({"steps": {"rimm": 1.0}}, "no parameter 'rimm'"),
        ({"steps": {"plate.curvature": 1.0}}, "none of the edits is about it"),
        ({"light": "edge_diffraction"}, "the PST at 15° is 0"),
        ({"method": "forward"}, "method of a PST metric"),
        by=lambda change: ranked(ringed, **change),
    )
    with refused("field_deg is empty"):
        sweeps.rank_edits(ringed, [])
    # Per cents are those of each layer, not of the thickest
    film = '<bsdf type="thinfilm"><string name="layers" value="1.38 100, 2.1 0"/></bsdf>'
    with refused(r"'plate.bsdf.coating.thickness_nm\[1\]' is 2 % of 0; give it in nm"):
        ranked(write(tmp_path, plate_and_wall(film)), steps={"coating": "2 %"})
    for more in ("--rank", "--pst-field-deg 10 --step rim=1", "--pst-field-deg 10 --rank --step rim"):
        fails(capsys, "sweep", ringed, *more.split())


RADIUS, LENGTH, LIFTED, ASLANT = 8.0, 20.0, 0.7, 20.0
# Of a sheet that scatters before a tube: lifted, it lets light pass beside it that falls on the detector
EDITS = {
    "into the tube": {"sheet.z": 1.0},
    "lifted": {"sheet.z": -LIFTED},
    "lifted and clear": {"sheet.z": -LIFTED, "sheet.bsdf.paint.reflectance": 0.01},
    "clear": {"sheet.bsdf.paint.reflectance": 0.01},
}


@pytest.fixture(scope="module")
def covered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    sheet = placed_xml("asphere", "sheet", diffuser_xml(0.6), semi_diameter=RADIUS)
    tube = placed_xml("frustum", "tube", r0=RADIUS, z0=0.0, r1=RADIUS, z1=LENGTH)
    detector = placed_xml("asphere", "detector", at=(0.0, 0.0, LENGTH), pixels=8, semi_diameter=3.0)
    return write(tmp_path_factory.mktemp("opened"), scatter_scene(beam_xml(15.0), sheet, tube, detector))


@pytest.fixture(scope="module")
def pst(covered: Path) -> sweeps.PstSweep:
    return sweeps.sweep_pst(covered, EDITS, [0.0, ASLANT], rays=40_000, max_scatters=1, cell_deg=2.0)


@pytest.mark.parametrize("name", ["lifted", "lifted and clear"])
def test_first_surface_beside_an_edit_that_opens_a_gap(pst: sweeps.PstSweep, name: str) -> None:
    """Light that meets the detector first is of the class of straight shots, which another recorder counts."""
    (one,) = pst.changed(name, ASLANT).entering
    assert one.surface == "detector"
    shots, stray = (pst.changed(name, ASLANT, light).after for light in ("straight_shot", "stray"))
    assert 0.2 < one.share == pytest.approx(shots / stray, rel=1e-3)
    assert pst.changed(name, 0.0).entering == ()  # along the axis nothing passes beside the sheet
    (gap,) = pst.gaps[name]
    assert set(gap.surfaces) == {"sheet", "tube"}
    assert gap.gap_mm == pytest.approx(LIFTED, abs=1e-6)


def test_more_light_is_no_gain(pst: sweeps.PstSweep) -> None:
    assert pst.gaps["into the tube"] == pst.gaps["clear"] == pst.gaps["as it is"] == ()
    clear, lifted = (pst.changed(name, ASLANT) for name in ("clear", "lifted and clear"))
    assert clear.ratio < lifted.ratio < 1
    assert (clear.gain, lifted.gain) == (True, False)
    assert pst.changed("lifted and clear", 0.0).gain
    row = pst.to_pandas().set_index(["configuration", "angle_deg"]).loc["lifted and clear", ASLANT]
    assert (row.entering, row.gain, row.gap_mm) == ("detector", False, pytest.approx(LIFTED, abs=1e-6))
    assert row.entering_percent == 100 * lifted.entering[0].share
    record = json.loads(json.dumps(pst_sweep_record(pst)))
    assert record["gaps"]["lifted"][0]["gap_mm"] == pytest.approx(LIFTED, abs=1e-6)
    (row,) = (r for r in record["rows"] if (r["configuration"], r["angle_deg"]) == ("lifted", ASLANT))
    assert row["entering"][0]["surface"] == "detector"
    assert pst_sweep_text(pst).count("is no gain") == 1
    assert len(pst.warnings) == 4


def test_gaps_in_a_sweep_of_fields(covered: Path) -> None:
    """Before and after in a sweep of fields that has the scene as it is."""
    states = {"as it is": {}, **EDITS}
    fields = mistray.sweep(covered, [0.0, ASLANT], 550.0, states, rays=20_000, max_scatters=1, cache=False)
    assert {name for name, gaps in fields.gaps.items() if gaps} == {"lifted", "lifted and clear"}
    (one,) = fields.entering("lifted and clear", ASLANT)
    assert one.surface == "detector"
    assert fields.entering("clear", ASLANT) == fields.entering("as it is", ASLANT) == ()
    shots, stray = (fields.estimate(key, "lifted and clear", ASLANT) for key in ("straight_shot_W", "stray_W"))
    assert one.share == pytest.approx(shots.value / stray.value, rel=1e-6)
    table = fields.to_pandas().set_index(["configuration", "field_deg"])
    assert [table.entering["lifted", angle] for angle in (ASLANT, 0.0)] == ["detector", ""]
    assert "first_light" not in table
    record = json.loads(json.dumps(page.record(fields)))
    assert record["gaps"]["lifted"][0]["gap_mm"] == pytest.approx(LIFTED, abs=1e-6)
    assert len(record["warnings"]) == 4
    assert page.text(fields).count("no gain") == 1


def test_ranking_and_a_sweep_without_the_scene_as_it_is(covered: Path) -> None:
    """There is nothing to compare light with; gaps are found against the file."""
    found = mistray.sweep(covered, ASLANT, 550.0, {"lifted": EDITS["lifted"]}, rays=2000, max_scatters=1, cache=False)
    assert found.entering("lifted", ASLANT) == ()
    assert len(found.gaps["lifted"]) == 1
    assert "entering" not in found.to_pandas()
    # A step of an edit that opens a gap is named, and comes after those that open none
    ranking = sweeps.rank_edits(covered, ASLANT, "single_scatter", rays=10_000, max_scatters=1)
    opening = [edit.label for edit in ranking.edits if edit.gaps]
    assert ("sheet.z" in opening) == (ranking["sheet.z"].change[0].value > 0)  # lifting it lowers the light, or not
    certain = [edit for edit in ranking.edits if max(abs(c.value) - 2 * c.se for c in edit.change) > 0]
    assert [bool(edit.gaps) for edit in certain] == sorted(bool(edit.gaps) for edit in certain)
    assert opening
    expected = {"position": 0.1, "tilt": RADIUS * math.sin(math.radians(0.1)), "rim": 0.1}
    for edit in ranking.edits:
        for gap in edit.gaps:
            assert gap.gap_mm == pytest.approx(expected[edit.kind], rel=1e-3), edit.label

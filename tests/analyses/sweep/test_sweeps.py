"""Sweeps: closed forms, the same numbers as scenes written out or written as files, one compile, wrong arguments."""

from __future__ import annotations

import math
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from command_line import fails, succeeds
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write
from refusals import refused

import mistray
from mistray.analyses.sweep.configurations import resolve
from mistray.sweeps import Configuration, read_configurations, write_configuration

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
            rows = table[table.configuration == name]
            assert len(rows) == 4
            assert list(rows.launched_W) == pytest.approx([math.pi] * 4, rel=1e-6)
            assert list(rows.direct_W) == pytest.approx([math.pi * t**2] * 4, rel=1e-5)
            assert list(rows.stray_W) == pytest.approx([math.pi * t**2 * r**2] * 4, rel=1e-5)
            assert list(rows.ghost_W) == pytest.approx(list(rows.stray_W), rel=1e-9)
            assert list(rows.ghost_to_signal) == pytest.approx([r**2] * 4, rel=1e-5)
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
            t = mistray.trace(
                mistray.load(scenes[row["configuration"]]),
                rays=256, field_deg=row["field_deg"], wavelength_nm=row["wavelength_nm"],
            )  # fmt: skip
            direct, worst = t.paths[0], max((p for p in t.paths[1:]), key=lambda p: p.power_W)
            assert row["direct_W"] == pytest.approx(direct.power_W, rel=1e-5)
            assert row["direct_rms_radius_mm"] == pytest.approx(direct.rms_radius_mm, rel=1e-4)
            assert row["direct_rms_radius_se_mm"] == pytest.approx(direct.rms_radius_se_mm, rel=1e-2)
            assert row["stray_W"] == pytest.approx(sum(p.power_W for p in t.paths[1:]), rel=1e-4)
            assert row["stray_W"] >= worst.power_W
        radii = found.to_pandas().pivot(index="configuration", columns=["field_deg", "wavelength_nm"],
                                        values="direct_rms_radius_mm")  # fmt: skip
        assert (abs(radii.loc["moved"] / radii.loc["as it is"] - 1) > 0.05).all()

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
        t = found.trace(name, 10, 600)
        row = found.estimate("stray_W", name, 10, 600)
        assert sum(p.power_W for p in t.paths[1:]) == pytest.approx(row.value, rel=1e-9)
        assert (t.settings["field_deg"], t.settings["wavelength_nm"]) == (10.0, [600.0])
    weak = found.trace("weak", 10, 600)
    report = found.ghosts("strong", 500)
    assert list(report) == [0.0, 10.0]
    assert report.summary(10.0).stray_W.value == pytest.approx(found.estimate("stray_W", "strong", 10, 500).value)
    image, _ = weak.irradiance_of([1])  # asked after the other configuration was traced
    pixel = np.prod([(b - a) / n for a, b, n in ((-50, 50, 64), (-50, 50, 64))])
    assert image.sum() * pixel == pytest.approx(math.pi * 0.64 * 0.01, rel=1e-5)


@pytest.mark.usefixtures("no_kernels")
class TestKernels:
    CHANGED = {"front.curvature": 0.04, "rear.curvature": -0.03, "detector.z": 0.3, "*glass.csv.index": 2e-3}

    def test_compiled_once(self, lens: Path) -> None:
        """The second row may add one, as may the first decentre: numbers that were 0 are there for the first time."""
        off_axis = [{"rear.y": y, **self.CHANGED} for y in (0.2, 0.3)]
        states, counts = {"a": {}, "b": self.CHANGED, "c": off_axis[0], "d": off_axis[1]}, [0] * 24

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
    for arguments, words in (
        (([],), "field_deg is empty; give at least one"),
        (([0, 95],), "field_deg is 95; it must lie between -90 and 90"),
        (([0], [550, 550]), "give every wavelength once"),
        (([0], 550, {}), "configurations is empty"),
        (([0], 550, [Configuration("a", {})] * 2), "configuration 'a' is given twice"),
        (([0], 550, {"a": 1.0}), "configurations: .* is none"),
        (([0], 550, {"a": {"p0_frnt.z": 1}}), "'a': the scene has no parameter 'p0_frnt.z'; did you"),
        (([0], 550, {"a": {"q*.z": 1}}), r"no parameter 'q\*.z'"),
        (([0], 550, {"a": {"p0_front.z": math.nan}}), "'p0_front.z' is .nan.; it must be finite"),
        (([0], 550, {"a": {"p0_front.z": [1, 2]}}), "2 numbers are given; it has 1"),
        (([0], 550, {"a": {"p0_front.z": "far"}}), "is 'far'; give a number"),
        (([0], 550, {"a": {"p0_front.faces": 1}}), "is no number but UInt"),
        (([0], 550, {"a": {"p0_rear.z": -5.0}}), "configuration 'a': surfaces 'p0_front' and 'p0_rear'"),
    ):
        with refused(words):
            mistray.sweep(plate, *arguments, cache=False)
    found = mistray.sweep(plate, [0, 1], 550, rays=64, cache=False)
    for call, words in (
        (lambda: mistray.sweep(plate, ray=5), "sweep: there is no argument 'ray'"),
        (lambda: found.trace(), "field_deg is missing; choose from 0, 1"),
        (lambda: found.trace(field_deg=0, wavelength_nm=500), "wavelength_nm is 500; choose from 550"),
        (lambda: found.estimate("stray", field_deg=0), "no number 'stray' with an error; choose from detected_W"),
    ):
        with refused(words):
            call()


class TestToml:
    def test_values(self, tmp_path: Path) -> None:
        text = """
        [[configuration]]
        name = "as designed"
        [[configuration]]
        name = "tele"
        values = { "G2.z" = 1.5, "AR.thickness_nm" = [90, 120.5] }
        [[configuration]]
        name = "warm"
        [configuration.values]
        "N-BK7.index" = 1e-4
        """
        path = tmp_path / "states.toml"
        path.write_text(text, encoding="utf-8")
        found = read_configurations(path)
        assert [one.name for one in found] == ["as designed", "tele", "warm"]
        assert [dict(one.values) for one in found] == [
            {}, {"G2.z": (1.5,), "AR.thickness_nm": (90.0, 120.5)}, {"N-BK7.index": (1e-4,)},
        ]  # fmt: skip

    def test_the_example(self) -> None:
        path = Path(__file__).parents[3] / "examples" / "triplet_states.toml"
        scene = mistray.load("cooke_triplet")
        designed, warm, moved = resolve(scene, mi.traverse(scene), read_configurations(path))
        assert designed.values == {}
        assert set(moved.values) >= {"L2_front.z", "L2_rear.z", "L2_edge.z"}
        glasses = [key for key, value in warm.values.items() if value == np.float32(1e-4)]
        assert len(glasses) >= 4
        assert {warm.units[key] for key in glasses} == {"1"}

    def test_wrong(self, tmp_path: Path) -> None:
        path = tmp_path / "states.toml"
        with refused(r"configurations '.*states\.toml': No such file or directory"):
            read_configurations(path)
        for text, words in (
            ("", "configuration is missing; add at least one section"),
            ("[[configuration]]\nname='a'\nvalue={}", "configuration\\[1\\].value is unknown; did you mean 'values'"),
            ("[[configuration]]\nname='a'\nvalues={x='1'}", "configuration\\[1\\].values.x is '1'; give a number"),
            ("[[configuration]]\nname='a'\nvalues={x=nan}", "the numbers must be finite"),
            ("[[configuration]", "correct the TOML"),
        ):
            path.write_text(text, encoding="utf-8")
            with refused(words):
                read_configurations(path)


NAMED = (("far", 3), ("near", 1))


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
    file = write_configuration(scene, Configuration("moved", {key: step}), tmp_path / "moved.xml")
    after = numbers(mistray.load(file))
    assert before.keys() == after.keys()
    part, _, axis = key.rpartition(".")
    moved = {name for name in before if not np.array_equal(before[name], after[name])}
    own = {name for name in before if name.startswith((f"{part}.", f"{part}_")) and name.endswith(f".{axis}")}
    assert moved == own
    for name in moved:
        np.testing.assert_allclose(after[name] - before[name], step, atol=1e-5)


def test_paint_and_a_value_from_the_shell(capsys, tmp_path) -> None:
    file = tmp_path / "edited.xml"
    edit = ("--set", "tube_vane_3.z=1.5", "--paint", "tube_vane_2=R=0.3")
    assert str(file) in succeeds(capsys, "sweep", "baffle_tube", *edit, "--write-scene", file)
    shapes = {shape.id(): shape for shape in mistray.load(file).shapes()}
    assert float(shapes["tube_vane_2"].bsdf().coating.R) == pytest.approx(0.3)
    assert numbers(mistray.load(file))["tube_vane_3.z"] == pytest.approx(1.5)


def test_one_of_a_study(capsys, tmp_path) -> None:
    study = tmp_path / "states.toml"
    far, near = (f'[[configuration]]\nname = "{n}"\nvalues = {{ "tube_vane_3.z" = {z} }}\n' for n, z in NAMED)
    study.write_text(far + near, encoding="utf-8")
    command = ["sweep", "baffle_tube", study, "--write-scene", tmp_path / "far.xml"]
    assert "did you mean 'far'?" in fails(capsys, *command, "--configuration", "farr")
    assert "writes one configuration" in fails(capsys, *command)
    assert "--rays has no effect with --write-scene" in fails(capsys, *command, "--rays", 5)
    assert not (tmp_path / "far.xml").exists()
    succeeds(capsys, *command, "--configuration", "far")
    assert numbers(mistray.load(tmp_path / "far.xml"))["tube_vane_3.z"] == pytest.approx(3)

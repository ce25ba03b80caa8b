"""Scenes on their way to another process: files, numbers, dicts, and what cannot travel."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from workers_here import Here

import mistray
from mistray import MistrayError, UnfinishedError
from mistray.cluster.scene_numbers import put_numbers, read_numbers
from mistray.cluster.travel import Parcel, Unpacked
from mistray.execute.workers import current_workers, working_with
from mistray.scene.source import source_of

TABLE = "wavelength_nm,angle_deg,R,T\n500,0,0.25,0.7\n500,90,0.25,0.7\n600,0,0.5,0.4\n600,90,0.5,0.4\n"
FRONT = interface_xml("air", "1.5", table="{table}")
PLATE = scene_text(
    '<path value="../parts"/><include filename="front.xml"/>',
    shape_xml("asphere", "rear", 1.0, interface_xml("1.5", "air"), semi_diameter=2.0),
    shape_xml("asphere", "detector", 5.0, sensor=True, half_width=3.0, half_height=3.0),
)


class Power:
    """A task: the detected power at some wavelengths."""

    def __init__(self, scene):
        self.scene = scene

    def make(self):
        return self.scene

    def do(self, made, part):
        return powers(made, part)


def powers(scene, wavelengths=(500,)):
    return [mistray.trace(scene, rays=500, wavelength_nm=nm).energy.detected_W for nm in wavelengths]


def write_front(folder, table):
    shape = shape_xml("asphere", "front", 0.0, FRONT.format(table=table), semi_diameter=2.0)
    (folder / "parts/front.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')


@pytest.fixture
def plate(tmp_path):
    """A scene whose front, with its table, lies in a folder beside that of the scene."""
    for name in ("scenes", "parts/tables"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "parts/tables/coat.csv").write_text(TABLE)
    write_front(tmp_path, "tables/coat.csv")
    (tmp_path / "scenes/plate.xml").write_text(PLATE)
    return tmp_path / "scenes/plate.xml"


@pytest.mark.quick
def test_files_travel_with_a_scene(plate):
    scene = mistray.load(plate)
    here = powers(scene, (500, 600))
    assert here[0] / here[1] == pytest.approx(0.7 / 0.4, rel=0.1)
    packed = source_of(scene)
    assert sorted(Path(name).name for name in packed.files) == ["coat.csv", "front.xml", Path(packed.scene).name]
    parcel, same = (Parcel.of(Power(one)) for one in (scene, mistray.load(plate)))
    assert (parcel.digest, parcel.scenes.keys()) == (same.digest, same.scenes.keys())  # told by their contents
    shutil.rmtree(plate.parents[1])  # as on a machine without these files
    task, made = Unpacked().task(parcel.task, parcel.digest, parcel.scenes)
    np.testing.assert_allclose(task.do(made, (500, 600)), here, rtol=1e-12)
    with pytest.raises(MistrayError):
        Parcel.of(Power(scene))


def test_an_absolute_file_must_be_there_and_the_same(plate, tmp_path):
    table = tmp_path / "parts/tables/coat.csv"
    write_front(tmp_path, str(table))
    packed = source_of(mistray.load(plate))
    assert list(packed.checked) == [str(table)]
    np.testing.assert_allclose(powers(packed.load()), powers(mistray.load(plate)), rtol=1e-12)
    table.write_text(TABLE.replace("0.7", "0.6"))
    with pytest.raises(MistrayError, match=r"coat\.csv' is another file there"):
        packed.load()
    table.unlink()
    with pytest.raises(MistrayError, match=r"coat\.csv' is not there"):
        packed.load()


def test_a_scene_travels_with_its_numbers_as_they_are():
    """What was made of other numbers is made again; those of another scene are refused."""
    scene = mistray.load("lens_and_window")
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.endswith("front.curvature"))  # noqa: SIM118
    unpacked, parcels = Unpacked(), []
    for _ in range(2):
        parcels.append((Parcel.of(Power(scene)), powers(scene)))
        params[key] = params[key] * 0.5
        params.update()
    assert abs(parcels[1][1][0] / parcels[0][1][0] - 1) > 1e-6
    for parcel, expected in (*parcels, *parcels):
        task, made = unpacked.task(parcel.task, parcel.digest, parcel.scenes)
        assert made is not scene
        np.testing.assert_allclose(task.do(made, (500,)), expected, rtol=1e-12)
    with pytest.raises(MistrayError, match="is not in its source; load the scene again"):
        put_numbers(scene, read_numbers(mistray.load("plate_and_wall")))


def test_a_file_that_changed_since_is_noticed(plate, tmp_path):
    scene = mistray.load(plate)
    (tmp_path / "parts/tables/coat.csv").write_text(TABLE.replace("0.7", "0.6"))
    with working_with(Here()), pytest.raises(MistrayError, match="another one at the worker"):
        mistray.trace(scene, rays=500)


@pytest.mark.quick
def test_scenes_from_dicts_travel_with_their_frames():
    """But not those that hold objects, nor those of an unknown source."""
    place = mi.ScalarTransform4f().translate([0.1, 0, 1])
    bsdf = {"type": "interface", "front": "air", "back": "1.5"}
    plate = {"type": "asphere", "id": "front", "semi_diameter": 2.0, "to_world": place, "bsdf": bsdf}
    scene = mistray.load({"type": "scene", "plate": plate})
    parcel = Parcel.of(Power(scene))
    _, made = Unpacked().task(parcel.task, parcel.digest, parcel.scenes)
    for key, value in read_numbers(scene).items():
        np.testing.assert_array_equal(value, read_numbers(made)[key])
    with pytest.raises(MistrayError, match="cannot travel"):
        Parcel.of(Power(mistray.load({"type": "scene", "plate": plate | {"bsdf": mi.load_dict(bsdf)}})))
    unknown = mi.load_file(str(mistray.scene.find("plate")), optimize=False, parallel=False)
    with pytest.raises(MistrayError, match=r"load it with mistray.load\(path\)"):
        Parcel.of(Power(unknown))


VARIANTS = """
from types import SimpleNamespace

import distributed
import mistray
from mistray.cluster import worker
from mistray.cluster.travel import Parcel, surroundings

class Power:
    def __init__(self, scene):
        self.scene = scene

    def make(self):
        return self.scene

    def do(self, made, part):
        return mistray.trace(made, rays=100).energy.detected_W

distributed.get_worker = lambda: SimpleNamespace(address="tcp://127.0.0.1:1", state=SimpleNamespace(nthreads=1))
for variant in ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_rgb"):
    mistray.ensure_variant(variant)
    parcel = Parcel.of(Power(mistray.load("plate")))
    scenes = list(parcel.scenes.values()), list(parcel.scenes)
    print("W", worker.do_part(parcel.task, *scenes, parcel.digest, 0, surroundings(), {"127.0.0.1": 1}))
"""


def test_a_worker_serves_one_variant_after_another():
    """It may not give a scene of one variant to the traces of the next."""
    pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")
    done = subprocess.run([sys.executable, "-c", VARIANTS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = [float(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("W ")]
    assert found == pytest.approx([found[0]] * 3, rel=1e-6)


@pytest.mark.parametrize("last", [2, None])
def test_the_command_writes_what_is_finished(tmp_path, monkeypatch, capsys, last):
    """Where workers are lost while the report is drawn, all rays are traced, and what is left is done here."""
    written = []

    def write_all(report, folder, title, *_):
        written.append((current_workers() is not None, list(report), folder, title))
        if last is None and len(written) == 1:
            raise UnfinishedError("the connection is lost; start it again")

    monkeypatch.setattr("mistray.cluster.distribute", lambda address: working_with(Here(last=last)))
    monkeypatch.setattr("mistray.report.write_all", write_all)
    fields = [0, 1, 2] if last else [0, 1]
    words = ["ghosts", "lens_and_window", "--rays", 2000, "--field-deg", *fields, "--scheduler", "tcp://x:1"]
    text = fails(capsys, *words, "--json", "--out", tmp_path / "out")
    for fact in (f"a report of what is finished is in {tmp_path}", *(("2 of 3 fields", "not 2 deg") if last else ())):
        assert fact in text
    assert [one[0] for one in written] == ([False] if last else [True, False])
    assert written[-1][1:3] == ([0, 1], tmp_path / "out")
    assert written[-1][3].endswith("unfinished (0°: 2000 of 2000 rays; 1°: 2000 of 2000 rays)")

"""Work in parts, and `mistray.distribute` with a cluster of processes; scenes on their way to another process."""

import contextlib
import errno
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from command_line import fails
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import assert_z
from workers_here import Here, assert_same

import mistray
from mistray import MistrayError, UnfinishedError
from mistray.cluster.client import DaskJob
from mistray.cluster.travel import Parcel, Unpacked
from mistray.execute import by_parts
from mistray.execute.scene_numbers import put_numbers, read_numbers
from mistray.execute.workers import current_workers, do_parts, working_with
from mistray.metrics import metric as metrics
from mistray.scene.source import source_of
from mistray.toolkit.pages.model import Report

SCENE = "lens_and_window"
ROUNDING = 1e-12  # of sums of some 1e5 numbers of float64


@pytest.fixture(scope="module")
def scene():
    return mistray.load(SCENE)


def test_parts_add_up_to_one_run(scene, monkeypatch):
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)
    arguments = {"rays": 40_000, "wavelength_nm": [500.0, 600.0], "field_deg": 2.0}
    one = mistray.trace(scene, **arguments)
    workers, told = Here(), []
    with working_with(workers):
        many = mistray.trace(scene, progress=lambda *rays: told.append(rays), **arguments)
        assert len(workers.parts) == 16  # four for each worker
        assert_same(one, many)
        groups = [[0], list(range(1, len(many.paths)))]
        for a, b in zip(one.maps(groups), many.maps(groups), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)
    assert len(workers.parts) == 32
    assert told[-1] == (40_000, 40_000)
    assert all(a < b for (a, _), (b, _) in pairwise(told))
    # What a trace can do afterwards, it can do here
    assert_same(one, many)
    for a, b in zip(one.maps(groups), many.maps(groups), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)
    np.testing.assert_array_equal(one.history(0, 4).to_pandas(), many.history(0, 4).to_pandas())


def test_a_grid_whose_rows_are_not_all_there_is_no_sample(scene, monkeypatch):
    (run,) = mistray.trace(scene, rays=1000).runs
    run = replace(run, rays=1 << 20)
    assert len(by_parts.split([run], 1000)) == 32  # a batch is not divided
    monkeypatch.setattr(type(run.source), "pattern", "grid")
    parts = (by_parts.Part(0),)
    assert replace(run, rays=2000, parts=parts).is_sample
    assert not replace(run, rays=1 << 21, parts=parts).is_sample


def test_what_was_finished_is_a_trace_of_fewer_rays(scene, monkeypatch):
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)
    whole = mistray.trace(scene, rays=32_000)
    with working_with(Here(last=6)), pytest.raises(UnfinishedError, match=r"1\.2e") as caught:
        mistray.trace(scene, rays=32_000)
    part = caught.value.partial
    assert (part.rays_traced, part.rays_planned, part.settings["rays"]) == (12_000, 32_000, 12_000)
    assert "of 3.2e+04 rays are finished and kept" in str(caught.value)
    assert part.energy.launched_W == whole.energy.launched_W
    assert abs(part.energy.closure) < 1e-6
    assert_z("detected", part.energy.detected_W, whole.energy.detected_W, part.energy.detected_se_W, false_alarm=1e-6)
    ratio = part.energy.detected_se_W / whole.energy.detected_se_W
    assert ratio == pytest.approx(np.sqrt(32 / 12), rel=0.5)  # of 12 batches
    x0, x1, y0, y1 = part.extent
    area = (x1 - x0) * (y1 - y0) / part.irradiance.size
    np.testing.assert_allclose(part.irradiance_of([0])[0].sum() * area, part.paths[0].power_W, rtol=1e-6)
    assert len(part.history(0, 2)) == 2
    with pytest.raises(mistray.MistrayError, match="gradients need all"):
        list(part.table_gradients(None, None))
    with working_with(Here(last=0)), pytest.raises(UnfinishedError, match="too few") as caught:
        mistray.trace(scene, rays=1000)
    assert caught.value.partial is None


@pytest.mark.parametrize(("last", "fields", "kept"), [(2, [0, 1, 2], [0, 1]), (1, [1, 0], [0])])
def test_ghosts_keep_the_fields_that_are_finished(scene, last, fields, kept):
    """The yardstick comes first."""
    with working_with(Here(last=last)), pytest.raises(UnfinishedError, match="finished") as caught:
        mistray.ghosts(scene, field_deg=fields, rays=2000)
    report = caught.value.partial
    assert isinstance(report, mistray.GhostReport)
    assert {field: t.rays_traced for field, t in report.items()} == dict.fromkeys(kept, 2000)


@pytest.mark.parametrize("method", ["joined", "adjoint", "forward"])
def test_pst_by_workers(method, tmp_path):
    scene = mistray.load("plate_and_wall")
    arguments = {"field_deg": [0, 20], "rays": 4000 if method == "forward" else 60_000, "method": method}
    one = mistray.pst(scene, map_pixels=4, **arguments)
    workers = Here()
    with working_with(workers):
        many = mistray.pst(scene, map_pixels=4, **arguments)
    assert len(workers.parts) == (2 if method == "forward" else -(-60_000 // 2**14))  # passes of so many rays
    np.testing.assert_allclose(many.by_batch, one.by_batch, rtol=ROUNDING)
    np.testing.assert_allclose(many.maps, one.maps, rtol=1e-9, atol=1e-20)
    assert many.facts["rays"] == one.facts["rays"]
    order = ["cell", "events"]
    x, y = (found.path_rows.sort_values(order, ignore_index=True) for found in (one, many))
    assert list(x.events) == list(y.events)
    np.testing.assert_allclose(y.pst_normal, x.pst_normal, rtol=1e-9)
    if method == "forward":
        return
    state = tmp_path / "state.npz"
    with working_with(Here(last=2)), pytest.raises(UnfinishedError, match=r"3.277e\+04 of 6e\+04 rays") as caught:
        mistray.pst(scene, state=state, **arguments)
    assert caught.value.partial.facts["rays"] == 2 * 2**14
    assert str(state) in str(caught.value)
    rest = mistray.pst(scene, state=state, resume=True, **arguments)
    # A run that can go on has a larger pilot than one that cannot
    whole = mistray.pst(scene, state=tmp_path / "whole.npz", **arguments)
    np.testing.assert_allclose(rest.by_batch, whole.by_batch, rtol=ROUNDING)
    if method == "joined":  # an error that is wanted stops at the same pass
        wanted = arguments | {"rays": 1_000_000, "relative_error": 0.3}
        one = mistray.pst(scene, **wanted)
        with working_with(Here()):
            many = mistray.pst(scene, **wanted)
        assert many.facts["rays"] == one.facts["rays"] < 1_000_000
        np.testing.assert_allclose(many.by_batch, one.by_batch, rtol=ROUNDING)


def test_monte_carlo_of_tolerances(scene):
    metric = metrics.path_power(scene, selection="ghost", rays=2000)
    arguments = {"keys": ["*.curvature"], "check": False, "monte_carlo": 3, "edges": False}
    one = mistray.sensitivity(metric, **arguments)
    workers = Here()
    with working_with(workers):
        many = mistray.sensitivity(metric, **arguments)
    assert sorted(part for part in workers.parts if isinstance(part, int)) == [0, 1, 2]
    np.testing.assert_allclose(many.draws.ratios, one.draws.ratios, rtol=1e-9)
    np.testing.assert_allclose(many.draws.predicted, one.draws.predicted, rtol=1e-6)
    assert one.draws.ratios.std() > 0
    assert metric.value() == pytest.approx(one.value.value, rel=1e-9)  # the scene is as it was


def test_a_failing_consumer_calls_parts_off_at_once(scene, monkeypatch):
    """Not only when somebody drops the traceback, which a notebook keeps."""
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)
    ended = []

    class Watched(Here):
        @contextlib.contextmanager
        def job(self, task):
            try:
                with super().job(task) as job:
                    yield job
            finally:
                ended.append(len(self.parts))

    with pytest.raises(ZeroDivisionError) as caught, working_with(Watched()):
        mistray.trace(scene, rays=20_000, progress=lambda done, of: 1 / 0)
    assert caught.value.__traceback__ is not None  # still held
    assert ended == [1]


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


def test_a_change_of_a_file_and_a_small_one_of_a_curvature_are_noticed(plate, tmp_path):
    """Since the scene was loaded, and since the trace; beside the curvature a radius is a thousand times as large."""
    scene = mistray.load(plate)
    (tmp_path / "parts/tables/coat.csv").write_text(TABLE.replace("0.7", "0.6"))
    with working_with(Here()), pytest.raises(MistrayError, match="another one at the worker"):
        mistray.trace(scene, rays=500)
    scene = mistray.load("plate")
    with working_with(Here()):
        t = mistray.trace(scene, rays=500)
        params = mi.traverse(scene)
        params["plate_front.curvature"] = 1e-4
        params.update()
        with pytest.raises(MistrayError, match="another one at the worker"):
            t.maps([[0]])


@pytest.mark.quick
def test_scenes_from_dicts_travel_with_their_frames():
    """In single and in double precision; but not those that hold objects, nor those of an unknown source."""
    place, further = mi.ScalarTransform4f().translate([0.1, 0, 1]), mi.ScalarTransform4d().translate([0.1, 0, 1.1])
    bsdf = {"type": "interface", "front": "air", "back": "1.5"}
    plate = {"type": "asphere", "id": "front", "semi_diameter": 2.0, "to_world": place, "bsdf": bsdf}
    rear = plate | {"id": "rear", "to_world": further, "bsdf": {"type": "interface", "front": "1.5"}}
    scene = mistray.load({"type": "scene", "plate": plate, "rear": rear})
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

    def page(report, _, title, *__):
        written.append((current_workers() is not None, list(report), title))
        if last is None and len(written) == 1:
            raise UnfinishedError("the connection is lost; start it again")
        return Report("Ghost analysis", title, [])

    monkeypatch.setattr("mistray.cluster.distribute", lambda address: working_with(Here(last=last)))
    monkeypatch.setattr("mistray.analyses.ghosts.page.output.page", page)
    fields = [0, 1, 2] if last else [0, 1]
    words = ["ghosts", "lens_and_window", "--rays", 2000, "--field-deg", *fields, "--scheduler", "tcp://x:1"]
    text = fails(capsys, *words, "--json", "--out", tmp_path / "out")
    for fact in (f"a report of what is finished is in {tmp_path}", *(("2 of 3 fields", "not 2 deg") if last else ())):
        assert fact in text
    assert [one[0] for one in written] == ([False] if last else [True, False])
    assert written[-1][1] == [0, 1]
    assert written[-1][2].endswith("unfinished (0°: 2000 of 2000 rays; 1°: 2000 of 2000 rays)")
    assert (tmp_path / "out" / "report.html").exists()


distributed = pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")

RAYS = 60_000
LIMIT_S = 60.0


@dataclass
class Processes:
    """A scheduler and workers, each a process of its own."""

    address: str
    scheduler: subprocess.Popen
    workers: list[subprocess.Popen]


def dask(name: str, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments, "--no-dashboard"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@contextlib.contextmanager
def processes(folder: Path, workers: int, threads: int = 1) -> Iterator[Processes]:
    file = folder / "scheduler.json"
    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    address, ends = "", time.monotonic() + LIMIT_S
    while not address:
        assert time.monotonic() < ends
        time.sleep(0.05)
        try:
            address = json.loads(file.read_text())["address"]
        except (OSError, ValueError):  # not there, or not whole
            continue
    options = ["--nthreads", str(threads), "--no-nanny", "--local-directory", str(folder)]
    made = Processes(address, scheduler, [dask("worker", address, *options) for _ in range(workers)])
    try:
        yield made
    finally:
        for process in (*made.workers, scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    with processes(tmp_path_factory.mktemp("cluster"), 2) as made:
        yield made


@pytest.fixture(autouse=True)
def all_clients_are_closed():
    """One that is not closes itself when the garbage collection finds it: perhaps while the next one starts, and then
    both wait for ever for the same lock."""
    yield
    clients = [one for one in gc.get_objects() if isinstance(one, distributed.Client)]
    assert {client.status for client in clients} <= {"closed"}


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)


@pytest.fixture(scope="module")
def alone(scene):
    return mistray.trace(scene, rays=RAYS)


# The next five use up one cluster, in this order


def test_a_worker_of_another_version_is_refused(cluster, scene, monkeypatch):
    monkeypatch.setattr("mistray.cluster.travel.surroundings", lambda: {"mistray": "9.9", "variant": "llvm_ad_rgb"})
    with pytest.raises(MistrayError, match=r"has mistray .*, and 9.9 is used"), mistray.distribute(cluster.address):
        mistray.trace(scene, rays=1000)


def test_processes_give_the_numbers_of_one(cluster, scene, alone):
    with mistray.distribute(cluster.address):
        assert_same(alone, mistray.trace(scene, rays=RAYS))


def test_an_analysis_by_processes_and_its_result_from_one(cluster, scene):
    alone = mistray.ghosts(scene, [0], rays=RAYS)
    with mistray.distribute(cluster.address):
        assert_same(alone[0.0], mistray.ghosts(scene, [0], rays=RAYS)[0.0])
    with distributed.Client(cluster.address) as client:
        found = client.submit(mistray.ghosts, scene, [0], rays=RAYS).result(LIMIT_S)
    assert_same(alone[0.0], found[0.0])
    np.testing.assert_array_equal(found.stray_map(0.0), alone.stray_map(0.0))


def test_a_worker_that_is_killed_loses_nothing(cluster, scene, alone):
    killed = []

    def kill(done: int, _: int) -> None:
        if not killed:
            os.kill(cluster.workers[0].pid, signal.SIGKILL)
            killed.append(done)

    with mistray.distribute(cluster.address):
        many = mistray.trace(scene, rays=RAYS, progress=kill)
    assert killed[0] < RAYS / 2
    assert cluster.workers[0].wait(LIMIT_S) == -signal.SIGKILL
    assert_same(alone, many)


def test_a_scheduler_that_is_gone_is_told_and_what_was_finished_is_kept(cluster, scene, capfd):
    ended = []

    def end(done: int, _: int) -> None:
        if not ended:
            cluster.scheduler.kill()
            ended.append(time.monotonic())

    with (
        pytest.raises(UnfinishedError, match=f"scheduler {cluster.address} is lost.* are finished and kept") as caught,
        mistray.distribute(cluster.address),
    ):
        mistray.trace(scene, rays=RAYS, progress=end)
    assert time.monotonic() - ended[0] < 30
    part = caught.value.partial
    assert 0 < part.rays_traced < RAYS == part.rays_planned
    assert abs(part.energy.closure) < 1e-6
    assert len(str(caught.value).splitlines()) == 1
    assert "Traceback" not in capfd.readouterr().err


LAYOUT = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}


class Failing:
    """A task whose part 0 fails at the worker with what a lost connection could raise, too."""

    def make(self):
        return None

    def do(self, made, part):
        if part == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return part


def test_an_error_of_a_part_is_not_taken_for_a_lost_connection():
    with (
        distributed.LocalCluster(**LAYOUT) as here,
        distributed.Client(here) as client,
        mistray.distribute(client),
        pytest.raises(MistrayError, match=r"a worker failed: OSError: .*No space left on device") as caught,
        do_parts(current_workers(), Failing(), [0]) as results,
    ):
        next(results)
    assert not isinstance(caught.value, UnfinishedError)


@pytest.mark.long
def test_a_result_that_is_lost_with_the_last_worker_is_not_waited_for(monkeypatch):
    finished = DaskJob._next
    with (
        distributed.LocalCluster(**LAYOUT) as here,
        distributed.Client(here) as client,
        mistray.distribute(client, patience_s=0.2),
        do_parts(current_workers(), Failing(), [1]) as results,
    ):

        def lost(job):
            part = finished(job)
            here.sync(here.workers[0].close)
            return part

        monkeypatch.setattr(DaskJob, "_next", lost)
        with pytest.raises(UnfinishedError, match="no worker is left at the scheduler"):
            next(results)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "8786", "", "tcp://", "tcp://host:port", "tls://host:8786"])
def test_no_scheduler_at_an_address(address):
    with (
        pytest.raises(MistrayError, match=f"scheduler {address}: no answer .*; start it, or check the address"),
        mistray.distribute(address, patience_s=0.2),
    ):
        pass


def test_no_client(capsys):
    with pytest.raises(MistrayError, match="got int"), mistray.distribute(8786):
        pass
    assert "nonsense://x" in fails(capsys, "ghosts", SCENE, "--rays", "100", "--scheduler", "nonsense://x")


@pytest.mark.slow
def test_a_worker_with_threads_is_refused(tmp_path, scene):
    with (
        processes(tmp_path, 1, threads=2) as made,
        pytest.raises(MistrayError, match="has 2 threads"),
        mistray.distribute(made.address),
    ):
        mistray.trace(scene, rays=1000)


@pytest.mark.slow
def test_workers_that_are_all_gone_are_waited_for_and_then_given_up(tmp_path, scene):
    with (
        processes(tmp_path, 1) as made,
        pytest.raises(UnfinishedError, match="no worker is left") as caught,
        mistray.distribute(made.address, patience_s=20.0),
    ):
        mistray.trace(scene, rays=RAYS, progress=lambda *_: made.workers[0].kill())
    assert 0 < caught.value.partial.rays_traced < RAYS

"""`mistray.distribute` with a real cluster of processes, some of which are killed."""

from __future__ import annotations

import errno
import gc
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from command_line import fails
from workers_here import assert_same

import mistray
from mistray import MistrayError, UnfinishedError
from mistray.execute import by_parts
from mistray.execute.workers import current_workers, do_parts

distributed = pytest.importorskip("distributed", reason="the extra 'distributed' is not installed")

SCENE = "lens_and_window"
RAYS = 60_000
LIMIT_S = 60.0


@dataclass
class Processes:
    """A scheduler and workers, each a process of its own."""

    address: str
    scheduler: subprocess.Popen
    workers: list[subprocess.Popen]

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


def dask(name: str, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments, "--no-dashboard"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def start(folder: Path, workers: int, threads: int = 1) -> Processes:
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
    return Processes(address, scheduler, [dask("worker", address, *options) for _ in range(workers)])


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    processes = start(tmp_path_factory.mktemp("cluster"), 2)
    yield processes
    processes.end()


@pytest.fixture(autouse=True)
def all_clients_are_closed():
    """
    One that is not would close itself whenever the garbage collection finds it. That can be while the next one starts,
    and then both wait for ever for the same lock.
    """
    yield
    clients = [one for one in gc.get_objects() if isinstance(one, distributed.Client)]
    assert {client.status for client in clients} <= {"closed"}


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(by_parts, "LEAST_RAYS", 1 << 10)


@pytest.fixture(scope="module")
def scene():
    return mistray.load(SCENE)


@pytest.fixture(scope="module")
def alone(scene):
    return mistray.trace(scene, rays=RAYS)


# The next four use up one cluster, in this order


@pytest.mark.long
def test_a_worker_of_another_version_is_refused(cluster, scene, monkeypatch):
    monkeypatch.setattr("mistray.cluster.travel.surroundings", lambda: {"mistray": "9.9", "variant": "llvm_ad_rgb"})
    with (
        pytest.raises(MistrayError, match=r"has mistray .*, and 9.9 is used here"),
        mistray.distribute(cluster.address),
    ):
        mistray.trace(scene, rays=1000)


def test_processes_give_the_numbers_of_one(cluster, scene, alone):
    with mistray.distribute(cluster.address):
        assert_same(alone, mistray.trace(scene, rays=RAYS))


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


class Failing:
    """A task that fails at the worker with what a lost connection could raise, too."""

    def make(self):
        return None

    def do(self, made, part):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_an_error_of_a_part_is_not_taken_for_a_lost_connection():
    layout = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with (
        distributed.LocalCluster(**layout) as here,
        distributed.Client(here) as client,
        mistray.distribute(client),
        pytest.raises(MistrayError, match=r"a worker failed: OSError: .*No space left on device") as caught,
        do_parts(current_workers(), Failing(), [0]) as results,
    ):
        next(results)
    assert not isinstance(caught.value, UnfinishedError)


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
    processes = start(tmp_path, 1, threads=2)
    try:
        with (
            pytest.raises(MistrayError, match="has 2 threads"),
            mistray.distribute(processes.address),
        ):
            mistray.trace(scene, rays=1000)
    finally:
        processes.end()


@pytest.mark.slow
def test_workers_that_are_all_gone_are_waited_for_and_then_given_up(tmp_path, scene):
    processes = start(tmp_path, 1)

    def kill(*_: int) -> None:
        processes.workers[0].kill()

    try:
        with (
            pytest.raises(UnfinishedError, match="no worker is left") as caught,
            mistray.distribute(processes.address, patience_s=20.0),
        ):
            mistray.trace(scene, rays=RAYS, progress=kill)
    finally:
        processes.end()
    assert 0 < caught.value.partial.rays_traced < RAYS

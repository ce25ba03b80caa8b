"""Tiers and order of the tests, the record of what they take, and what a GPU runs."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
import tiers
from oracles import scene_xml, small_scenes

import mistray

SLOW_S = 3600
TOOK = "seconds of processors"
_started = pytest.StashKey[float]()
_took: dict[tuple[str, str], float] = {}


def processors() -> float:
    """Seconds that processors have worked for this process and for those that it has started and waited for."""
    return sum(os.times()[:4])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is long, keep the part that is asked for, and let files that take long come first."""
    for item in items:
        tiers.mark_long(item)
        if item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.timeout(SLOW_S))
    if tiers.PART in os.environ:
        kept = tiers.in_part(items)
        chosen = set(kept)
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = kept
    of_file: dict[str, float] = {}
    for file, function in dict.fromkeys(map(tiers.place, items)):  # in the same order in all processes
        of_file[file] = of_file.get(file, 0.0) + tiers.seconds_of(file, function)
    items.sort(key=lambda item: -of_file[tiers.place(item)[0]])  # two processes take whole files


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    item.stash[_started] = processors()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if call.when == "teardown" and tiers.RECORDING in os.environ:
        report.user_properties.append((TOOK, (*tiers.place(item), processors() - item.stash[_started])))
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    for name, value in report.user_properties:
        if name == TOOK and report.when == "teardown":
            file, function, took = value
            _took[file, function] = _took.get((file, function), 0.0) + took


def pytest_sessionfinish(session: pytest.Session) -> None:
    if _took and not hasattr(session.config, "workerinput"):  # not in a process of xdist
        tiers.write(_took)


@lru_cache(maxsize=1)
def gpu_missing() -> str:
    """Why no test can run on a GPU here; empty if they can."""
    from mistray.cli import doctor

    check = doctor._cuda()
    return "" if check.status == "ok" else f"no GPU to trace on ({check.found}); {check.remedy}"


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked `gpu` are skipped, with the reason, without a GPU."""
    if item.get_closest_marker("gpu") and gpu_missing():
        pytest.skip(gpu_missing())


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Results of earlier sessions and of the user are not looked at; commands that tests start inherit this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MISTRAY_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def own_scatter_models() -> None:
    """Scatter models that other tests and pages have made in this process are none of a test's."""
    if kinds := sys.modules.get("mistray.scatter.kinds"):
        for name in set(kinds._known).difference(kinds.OWN_KINDS):
            del kinds._known[name]


@pytest.fixture(scope="session", autouse=True)
def interrupts_arrive() -> None:
    """Also where the tests run in the background of a shell, which lets its children ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def no_kernels() -> None:
    """The process has compiled no kernel yet: what earlier tests have compiled is dropped, so that it counts again."""
    import drjit as dr

    from mistray.sampling.design import search

    dr.sync_thread()  # none of them runs any more
    dr.flush_kernel_cache()
    search._known.clear()  # what is found again compiles the kernels of its probes where it is needed first


@pytest.fixture(autouse=True)
def outputs_are_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command writes into the folder of --out is declared, or nobody would ask for --force before the trace."""
    from mistray.cli import claims, program
    from mistray.replace_file import Guard

    def strict(options: argparse.Namespace) -> Guard:
        guard = claims.guard_of(options)

        def claim(paths: Iterable[str | Path]) -> None:
            paths = list(paths)
            for path in map(os.path.abspath, paths):
                folder = getattr(options, "out", None) if getattr(options, "folder_files", ()) else None
                if folder is not None and os.path.dirname(path) == os.path.abspath(folder):
                    name = os.path.basename(path)
                    assert claims.is_declared(options, name) or name.startswith("."), f"{name} is not declared"
            Guard.claim(guard, paths)

        guard.claim = claim  # type: ignore[method-assign]
        return guard

    monkeypatch.setattr(program, "guard_of", strict)


@pytest.fixture(scope="session")
def load_text(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Any, scene_xml.SceneModel]]:
    """XML text → (Mitsuba scene, model of the oracles)."""

    def load(text: str) -> tuple[Any, scene_xml.SceneModel]:
        path = small_scenes.write(tmp_path_factory.mktemp("scene"), text)
        return mistray.load(path), scene_xml.read_scene(path)

    return load


@pytest.fixture(scope="session")
def load_scene(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """XML text → Mitsuba scene, for scenes with shapes that the oracles do not read."""

    def load(text: str) -> Any:
        return mistray.load(small_scenes.write(tmp_path_factory.mktemp("scene"), text))

    return load

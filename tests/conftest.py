"""Order of the tests: two processes take whole files, so that those that take minutes come first. What a GPU runs."""

from __future__ import annotations

import argparse
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
from oracles import scene_xml, small_scenes

import mistray

LONG = (
    "test_docs_site.py",
    "test_notebooks.py",
    "test_readme.py",
    "test_triplet_ar.py",
    "test_fit.py",
    "test_docs.py",
    "test_phone_camera.py",
    "test_pst_adjoint_forward.py",
    "test_replay.py",
    "test_scatter_aiming.py",
)


SLOW_S = 3600
UNTIL = "MISTRAY_TESTS_UNTIL"  # seconds since 1970


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of `LONG` in their order, then all others as they come; more time for those that are slow."""
    rank = {name: number for number, name in enumerate(LONG)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.timeout(SLOW_S))


@lru_cache(maxsize=1)
def gpu_missing() -> str:
    """Why no test can run on a GPU here; empty if they can."""
    from mistray import doctor

    check = doctor._cuda()
    return "" if check.status == "ok" else f"no GPU to trace on ({check.found}); {check.remedy}"


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests are skipped, with the reason, after a time of day that was set, and those marked `gpu` without a GPU."""
    if time.time() > float(os.environ.get(UNTIL, "inf")):
        pytest.skip(f"the time that {UNTIL} allows is over")
    if item.get_closest_marker("gpu") and gpu_missing():
        pytest.skip(gpu_missing())


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Results of earlier sessions and of the user are not looked at; commands that tests start inherit this."""
    before = os.environ.get("MISTRAY_CACHE")
    os.environ["MISTRAY_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["MISTRAY_CACHE"]
    else:
        os.environ["MISTRAY_CACHE"] = before


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


LoadText = Callable[[str], tuple[Any, scene_xml.SceneModel]]


@pytest.fixture(scope="session")
def load_text(tmp_path_factory: pytest.TempPathFactory) -> LoadText:
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

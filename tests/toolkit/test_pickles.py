"""Results of public functions go through a pickle: the same numbers, and what is traced again is the same."""

import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
import stubs
from refusals import refused
from result_calls import CALLS, LONG, data
from workers_here import assert_same

import mistray
from mistray import recorders
from mistray.analyses.ghosts.page import record as ghosts
from mistray.analyses.objects import page as objects
from mistray.analyses.study import page as study

load = mistray.load
long = pytest.mark.long


RECORDS: dict[str, Callable[[Any], Any]] = {
    "mistray.analysis.ghosts": ghosts.record,
    "mistray.analysis.objects": objects.record,
    "mistray.analysis.study": study.record,
}


def again(result: Any) -> Any:
    return pickle.loads(pickle.dumps(result))


@pytest.mark.core
@pytest.mark.parametrize("name", [pytest.param(name, marks=long if name in LONG else ()) for name in CALLS])
def test_a_result(name: str, folder: Path) -> None:
    result = CALLS[name]()
    found = again(result)
    assert type(found) is type(result)
    assert list(data(found)) == list(data(result))
    if name in RECORDS:  # what traces again, or asks the surfaces
        assert RECORDS[name](found) == RECORDS[name](result)


def test_every_analysis_is_called() -> None:
    assert {*stubs.analyses()} <= {*CALLS}


@long
def test_what_is_traced_again_is_the_same() -> None:
    """Of a scene whose numbers were set, by two wavelengths, with a map of a surface; twice over."""
    scene = load("plate_and_wall")
    params = mi.traverse(scene)
    params["housing_wall.bsdf.R"] = 0.3
    params.update()
    maps = recorders.SurfaceMaps("maps", "housing*")
    t = mistray.trace(scene, rays=500, wavelength_nm=[500, 600], recorders=[maps])
    found = again(again(t))
    assert repr(found) == repr(t)
    assert_same(t, found)
    assert found.runs[0] is found.paths.runs[0]
    groups = [[0], [1, 2]]
    for a, b in zip(t.maps(groups), found.maps(groups), strict=True):
        np.testing.assert_array_equal(a, b)
    pd.testing.assert_frame_equal(t.history(1).to_pandas(), again(t.history(1)).to_pandas())
    pd.testing.assert_frame_equal(t.rays("ghost", n=50), found.rays("ghost", n=50))
    assert list(data(found.recorders)) == list(data(t.recorders))


READ = """
import pickle, sys
found = pickle.load(open(sys.argv[1], "rb"))
print(found.table(5.0).to_csv(), found.stray_map(5.0)[0].sum(), found.scene.shapes()[0].id())
"""


@long
def test_by_another_process_without_the_files(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    found = mistray.ghosts(load("coated.xml"), [0, 5], rays=500)
    file = tmp_path_factory.mktemp("pickle") / "ghosts.pickle"
    file.write_bytes(pickle.dumps(found))
    (folder / "coated.xml").unlink()
    read = subprocess.run([sys.executable, "-c", READ, file], capture_output=True, text=True, check=True)
    expected = found.table(5.0).to_csv(), found.stray_map(5.0)[0].sum(), found.scene.shapes()[0].id()
    assert read.stdout.split() == " ".join(map(str, expected)).split()


def changed() -> Any:
    """A scene that changes between the trace and the pickle, by less than the rounding of its largest number."""
    scene = load("plate")
    t = mistray.ghosts(scene, [0], rays=100)
    params = mi.traverse(scene)
    params["plate_front.curvature"] = 1e-4
    params.update()
    return t


def of_unknown_source() -> Any:
    return mistray.ghosts(mi.load_file(str(mistray.scene.find("plate")), optimize=False, parallel=False), [0], rays=100)


def of_objects() -> Any:
    black = mi.load_dict({"type": "interface", "R": 0.0})
    detector = {"type": "asphere", "semi_diameter": 5.0, "bsdf": black, "sensor": {"type": "irradiancemeter"}}
    scene = load({"type": "scene", "detector": detector, "beam": {"type": "collimated", "radius": 1.0}})
    return mistray.ghosts(scene, [0], rays=100)


@pytest.mark.core
@pytest.mark.parametrize(
    ("make", "told"),
    [
        pytest.param(changed, "the scene, .* was changed after this result was computed", id="changed"),
        pytest.param(of_unknown_source, r"source is not known, .*; load it with mistray.load\(path\)", id="unknown"),
        pytest.param(of_objects, "loaded from objects that cannot be pickled .*; load it from plain", id="objects"),
    ],
)
def test_numbers_that_cannot_be_traced_again(make: Callable[[], Any], told: str) -> None:
    """They remain; what needs the surfaces is refused with the reason, after a second pickle, too."""
    report = make()
    found = again(again(report))
    pd.testing.assert_frame_equal(found[0.0].paths.to_pandas(), report[0.0].paths.to_pandas())
    assert list(data(found.table(0.0))) == list(data(report.table(0.0)))
    assert repr(found[0.0]) == repr(report[0.0])
    for use in (lambda: found.stray_map(0.0), lambda: found[0.0].irradiance, lambda: found[0.0].runs[0].table):
        with refused(told):
            use()

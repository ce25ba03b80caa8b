"""Results go through a pickle and a file: the same numbers, also of what is traced again; and files that are none."""

from __future__ import annotations

import dataclasses
import inspect
import json
import pickle
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
import pandas as pd
import pytest
import stubs
from refusals import refused
from result_calls import CALLS, LONG, data, result_classes
from workers_here import assert_same

import mistray
from mistray import ImageQuality, Trace, Transfer, recorders
from mistray.analyses.ghosts.page import record as ghosts
from mistray.analyses.objects import page as objects
from mistray.analyses.study import page as study
from mistray.analyses.validate.request import ValidateRequest
from mistray.analyses.validate.run import run_validation
from mistray.recorders import Recorder
from mistray.result import Result
from mistray.toolkit import saved_result
from mistray.toolkit.saved_result import KIND
from mistray.toolkit.summary import has_figure

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


OTHERS = {  # what these return is no result
    *("analysis.critical_rays", "optimize.bodies", "optimize.parameters", "optimize.read_study", "report.view"),
    "scene.load",
}
NAMES = [name for name in CALLS if name.removeprefix("mistray.") not in OTHERS]
PARTS: dict[type, Callable[[Any], list[Result]]] = {
    Trace: lambda t: [t.paths, t.energy, t.surfaces, t.history(1)],
    ImageQuality: lambda found: [found[0], found[0].main],
    Transfer: lambda found: [found[0]],
}
PICKLES, TRACE = "mistray.execute.pickles", "mistray.trace.result:Trace"
RAN: set[str] = set()
SAVED: set[type] = set()


def check(result: Result) -> Any:
    """The result after a file, once it says and draws the same."""
    SAVED.add(type(result))
    result.save("found.zip")
    found = mistray.load_result("found.zip")
    assert type(found) is type(result)
    assert found.scene_name == result.scene_name
    assert repr(found) == repr(result)
    if dataclasses.is_dataclass(result):
        before = dict(data(fields(result)))  # with what was computed from the fields, and kept
        loaded = dict(data(fields(found)))
        assert {place: plain(before[place]) for place in loaded} == {place: plain(one) for place, one in loaded.items()}
        assert {*fields(found)} == {*fields(result)}
    assert found._repr_html_().partition("<figure>")[0] == result._repr_html_().partition("<figure>")[0]
    for name in ("to_pandas", "table"):
        made = getattr(result, name, None)
        if inspect.ismethod(made) and not inspect.signature(made).parameters:
            pd.testing.assert_frame_equal(getattr(found, name)(), made())
    if has_figure(result):
        found.plot()
        plt.close("all")
    return found


def plain(value: Any) -> Any:
    """A value of `data` with numbers of NumPy as those of Python."""
    return re.sub(r"^np\.\w+\((.*)\)$", r"\1", value) if isinstance(value, str) else value


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", [pytest.param(name, marks=long if name in LONG else ()) for name in NAMES])
def test_a_saved_result(name: str) -> None:
    result = CALLS[name]()
    found = check(result)
    if name in RECORDS:  # what traces again, or asks the surfaces
        assert RECORDS[name](found) == RECORDS[name](result)
    for part in PARTS.get(type(result), lambda _: [])(result):
        check(part)
    RAN.add(name)


@long
@pytest.mark.usefixtures("folder")
def test_a_saved_Validation() -> None:
    """Of the command alone: no exported function returns it."""
    check(run_validation(ValidateRequest(only=("tracepro_abg",))))


@long
def test_every_class_of_results_was_saved() -> None:
    if {*NAMES} != RAN:
        pytest.skip("the tests above ran in another process")
    assert {kind.__name__ for kind in {*result_classes()} - SAVED} == set()


@pytest.mark.usefixtures("folder")
def test_scenes_travel_with_results() -> None:
    """The loaded trace can trace again, where the file of its scene is gone; what is the same object stays one."""
    t = mistray.trace(mistray.load("coated.xml"), rays=64, field_deg=1)
    t.save("found.zip")
    Path("coated.xml").unlink()
    found: Any = mistray.load_result("found.zip")
    assert found.runs[0] is found.paths.runs[0]
    pd.testing.assert_frame_equal(found.history(1).to_pandas(), t.history(1).to_pandas())
    again: Any = mistray.load_result(found.save("found.zip"))
    pd.testing.assert_frame_equal(again.rays("ghost", n=5), t.rays("ghost", n=5))


@pytest.mark.usefixtures("folder")
def test_what_mistray_does_not_know_is_refused() -> None:
    class Own(Recorder):
        name = "own"

    t = mistray.trace(mistray.load("coated.xml"), rays=64, recorders=[Own()])
    t.recorders["own"] = Own()
    with refused("Trace", "an object of class Own", "pickle"):
        t.save("found.zip")
    assert not Path("found.zip").exists()


def fields(result: Any) -> dict[str, Any]:
    """The fields of a result that do not belong to the process."""
    declared = result.__dataclass_fields__.values()
    return {field.name: getattr(result, field.name) for field in declared if field.compare}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    fit = CALLS["mistray.optimize.fit"]()
    return Path(fit.save(tmp_path / "fit.zip"))


def rewritten(file: Path, **changed: Any) -> Path:
    """The file with entries of its result in JSON replaced."""
    with zipfile.ZipFile(file) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    text = json.loads(entries[saved_result.TEXT])
    text["result"] |= changed
    text |= {key: value for key, value in changed.items() if key == "form"}
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in (entries | {saved_result.TEXT: json.dumps(text).encode()}).items():
            archive.writestr(name, content)
    return file


@pytest.mark.parametrize(
    "of",
    ["os:system", "builtins:exec", "mistray.__main__:Main", "mistray.cli.program:main", "mistray.estimate:Estimate",
     "mistray.no_such_module:Fit", "mistray.errors:MistrayError", "mistray.analyses.fit.run:Fit.value", "", None, 3],
)  # fmt: skip
def test_a_class_that_is_no_result(file: Path, of: Any) -> None:
    with refused("", str(file), "damaged, or no result"):
        mistray.load_result(rewritten(file, of=of))


@pytest.mark.parametrize(
    "odd",
    [
        {KIND: "made", "number": 9, "by": "os:system", "given": ["true"]},
        {KIND: "made", "number": 9, "by": f"{PICKLES}:_or_missing", "given": [{KIND: "maker", "of": "os:x"}]},
        {KIND: "made", "number": 9, "by": f"{PICKLES}:_made_frame", "given": ["load_file", "x.xml"]},
        {KIND: "object", "number": 9, "of": TRACE, "state": {"shown_by": {"table": "os:system"}}},
        {KIND: "object", "number": 9, "of": TRACE, "state": {"plot": "x"}},
        {KIND: "object", "number": 9, "of": "mistray.analyses.fit.run:Fit", "state": {"shown_by": {}}},
        {KIND: "made", "number": 9, "by": f"{PICKLES}:_made_array", "given": ["load_file", 3]},
        {KIND: "known", "number": 99},
        {KIND: "no_such_kind"},
        {},
    ],
    ids=lambda odd: odd.get(KIND, "none"),
)  # fmt: skip
def test_nothing_runs(file: Path, odd: Any) -> None:
    with zipfile.ZipFile(file) as archive:
        state = json.loads(archive.read(saved_result.TEXT))["result"]["state"]
    with refused("", str(file), "damaged, or no result"):
        mistray.load_result(rewritten(file, state=state | {"names": odd}))


def test_damage(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    for content in (b"", b"PK", whole[: len(whole) // 2], whole[:-30], b"x" * 1000, np.zeros(3).tobytes()):
        file.write_bytes(content)
        with refused("", str(file), "damaged, or no result"):
            mistray.load_result(file)
    for state in ({}, {"names": []}, {"scene_name": "x", "system": 1}, {"__class__": 1}):
        file.write_bytes(whole)
        with refused("", str(file), "damaged, or no result"):
            mistray.load_result(rewritten(file, state=state))
    file.write_bytes(whole)
    with refused("", str(file), "another version"):
        mistray.load_result(rewritten(file, form=99))
    for path, words in ((tmp_path / "none.zip", "no such file"), (tmp_path, ""), ("", "")):
        with refused("", f"result '{path}'", words):
            mistray.load_result(path)
    for odd in (3, None, [file], b"x", True):
        with refused("result", "a path"):
            mistray.load_result(odd)  # type: ignore[arg-type]


def test_a_place_that_cannot_be_written(file: Path) -> None:
    result: Result = mistray.load_result(file)
    with refused("result", "is a folder"):
        result.save(file.parent)
    with refused("nowhere"):
        result.save(file.parent / "nowhere" / "x.zip")

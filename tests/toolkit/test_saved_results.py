"""Results saved to a file and loaded again, and files that are none."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from result_calls import CALLS, LONG, data

import mistray
from mistray.result import Result
from mistray.toolkit import saved_result

long = pytest.mark.long
SAVED = {
    *("analysis.image_quality", "analysis.pst", "analysis.thermal", "optimize.budget", "optimize.compare"),
    *("optimize.fit", "optimize.gradient", "optimize.measure", "report.export_step"),
}
NAMES = [name for name in CALLS if name.removeprefix("mistray.") in SAVED]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", [pytest.param(name, marks=long if name in LONG else ()) for name in NAMES])
def test_a_saved_result(name: str) -> None:
    result = CALLS[name]()
    result.save("found.zip")
    found = mistray.load_result("found.zip")
    assert type(found) is type(result)
    assert found.scene_name == result.scene_name
    before = dict(data(fields(result)))  # with what was computed from the fields, and kept
    loaded = dict(data(fields(found)))
    assert {place: before[place] for place in loaded} == loaded
    assert {*fields(found)} == {*fields(result)}
    assert found._repr_html_().partition("<figure>")[0] == result._repr_html_().partition("<figure>")[0]


def fields(result: Any) -> dict[str, Any]:
    """The fields of a result that do not belong to the process."""
    declared = result.__dataclass_fields__.values()
    return {field.name: getattr(result, field.name) for field in declared if field.compare}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", ["ghosts", "objects", "transfer"])
def test_what_holds_rays_is_refused(name: str) -> None:
    result = CALLS[f"mistray.analysis.{name}"]()
    with refused(type(result).__name__, "numbers and texts", "pickle"):
        result.save("found.zip")
    assert not Path("found.zip").exists()


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


def test_damage(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    for content in (b"", b"PK", whole[: len(whole) // 2], whole[:-30], b"x" * 1000, np.zeros(3).tobytes()):
        file.write_bytes(content)
        with refused("", str(file), "damaged, or no result"):
            mistray.load_result(file)
    for fields in ({}, {"names": []}, {"scene_name": "x", "system": 1}):
        file.write_bytes(whole)
        with refused("", str(file), "damaged, or no result"):
            mistray.load_result(rewritten(file, fields=fields))
    file.write_bytes(whole)
    with refused("", str(file), "another version"):
        mistray.load_result(rewritten(file, form=99))
    for path, words in ((tmp_path / "none.zip", "no such file"), (tmp_path, ""), ("", "")):
        with refused("", f"result '{path}'", words):
            mistray.load_result(path)


def test_a_place_that_cannot_be_written(file: Path) -> None:
    result: Result = mistray.load_result(file)
    with refused("result", "is a folder"):
        result.save(file.parent)
    with refused("nowhere"):
        result.save(file.parent / "nowhere" / "x.zip")

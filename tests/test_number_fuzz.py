"""Nasty numbers for every numeric option of every command and every number of every plugin: no exception, no hang,
no success with nothing in its output. What is refused is refused in one clear line.

The long tests print a table by command and by plugin: ``pytest -s -m slow tests/test_number_fuzz.py``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fuzz_scenes import ABOUT, LINES, NUMBERS, TRACED, scene_tries, usual_of, write
from number_fuzz import NASTY, NASTY_XML, WORK, Try, Worker, numeric, outcome_of, parsers, table, tries
from test_plugin_pages import MANUALS

TRIES = tries(LINES, ABOUT)
SCENES = scene_tries()
# In the short tests: one of so many
STEP, STEP_XML = 61, 71
# What takes seconds: other tests have it
LONG = ("study", "budget", "optimize", "sensitivity", "particulate")


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    folder = tmp_path_factory.mktemp("numbers")
    write(folder)
    found = Worker(folder)
    yield found
    found.close()


def outcomes(worker: Worker, chosen: Iterable[Try]) -> tuple[list[tuple[str, str]], list[str]]:
    """Command and kind of outcome of each try, and what is wrong."""
    usual: dict[str, set[str]] = {}
    found, wrong = [], []
    for one in chosen:
        argv: Iterable[str] = one.argv
        if len(one.argv) == 1:
            (worker.folder / TRACED[1]).write_text(one.argv[0], encoding="utf-8")
            argv = TRACED
        command = next(iter(argv))
        answer = worker.run(argv)
        if answer["absent"] and command not in usual:
            usual[command] = usual_of(worker, command)
        kind, complaint = outcome_of(answer, usual.get(command, ()), one.option in WORK)
        found.append((one.command, kind))
        if complaint:
            wrong.append(f"{kind}: {one.command} {one.option} {one.value}: {complaint}")
    return found, wrong


def check(worker: Worker, chosen: list[Try]) -> None:
    found, wrong = outcomes(worker, chosen)
    print("\n" + table(found))
    assert len(found) == len(chosen)
    assert not wrong, "\n".join(wrong)


@pytest.mark.long
def test_some_options(worker: Worker) -> None:
    check(worker, [one for one in TRIES[::STEP] if one.command not in LONG and one.option not in WORK])


@pytest.mark.long
def test_some_numbers_of_scenes(worker: Worker) -> None:
    check(worker, [one for one in SCENES[::STEP_XML] if one.command not in LONG])


@pytest.mark.slow
@pytest.mark.parametrize("command", LINES)
def test_every_option(worker: Worker, command: str) -> None:
    check(worker, [one for one in TRIES if one.command == command])


@pytest.mark.slow
@pytest.mark.parametrize("plugin", list(dict.fromkeys(one.command for one in SCENES)))
def test_every_number_of_a_scene(worker: Worker, plugin: str) -> None:
    check(worker, [one for one in SCENES if one.command == plugin])


@pytest.mark.quick
def test_nothing_is_left_out() -> None:
    """Every command with a numeric option has its lines, every option and parameter every value."""
    assert {name for name, parser in parsers().items() if numeric(parser)} == set(LINES)
    assert {manual.plugin for manual in MANUALS} <= set(NUMBERS)
    assert len(TRIES) > 2496
    assert len(SCENES) > 1500
    for chosen, values in ((TRIES, NASTY), (SCENES, NASTY_XML)):
        places: dict[tuple[str, str], set[str]] = {}
        for one in chosen:
            places.setdefault((one.command, one.option), set()).add(one.value)
        assert all(found == set(values) for found in places.values())
    for command, option in (("pst", "--azimuths-deg"), ("bsdf", "--A"), ("thermal", "--part"), ("objects", "--disc")):
        assert any((one.command, one.option) == (command, option) for one in TRIES)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({}, "exit 0"),
        ({"code": 2, "said": "mistray: error: --rays 0: no rays; give one\n"}, "exit 2"),
        ({"code": 2, "said": "mistray: error: broken\n"}, "exit 2"),
        ({"code": None, "error": "KeyError: 'a' (x.py:1)"}, "exceptions"),
        ({"code": 0, "error": "late: 11.0 s", "seconds": 11.0}, "hangs"),
        ({"code": 130, "error": "late: 11.0 s", "seconds": 11.0}, "hangs"),
        ({"absent": [".a[].b"]}, "nothing"),
        ({"absent": [".usual"]}, "exit 0"),
    ],
)
def test_complaints_are_noticed(change: dict[str, Any], kind: str) -> None:
    answer = {"code": 0, "error": "", "seconds": 0.1, "said": "", "absent": []} | change
    found, complaint = outcome_of(answer, {".usual"})
    assert found == kind
    good = kind == "exit 0" or "give one" in str(answer["said"])
    assert (complaint == "") is good
    if answer["code"] == 130:
        assert outcome_of(answer, (), work=True) == ("stopped", "")


def test_a_worker_survives(worker: Worker, tmp_path: Path) -> None:
    """A crash of the process is an outcome, and the next line has a new process; nulls and NaN of files are found."""
    assert worker.process is not None or worker.run(("doctor", "--json"))["code"] in (0, 2)
    assert worker.process is not None
    worker.process.kill()
    worker.process.wait()
    with pytest.raises(BrokenPipeError):
        worker.run(("doctor", "--json"))
    worker.close()
    assert worker.run(("bsdf", "abg", "--A", "nan"))["code"] == 2
    from number_fuzz import nothing, nothing_in_csv

    (tmp_path / "a.csv").write_text("# remark\nx,y\n1,nan\n2,3\n")
    assert list(nothing_in_csv(tmp_path / "a.csv")) == ["a.csv:y"]
    assert sorted(nothing(json.loads('{"a": [{"b": null}, {"b": 1}], "c": NaN}'))) == [".a[].b", ".c"]

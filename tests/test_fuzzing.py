"""The machinery of `attack`: it leaves nothing out, and notices what is wrong; tests/attack runs it."""

import itertools
import json
import random
from collections.abc import Iterator
from typing import Any

import pytest
from attack.in_process import KINDS, OPTIONS, prepare, read
from fuzz_scenes import LINES, NUMBERS, scene_tries
from fuzzing import LONGEST
from number_fuzz import NASTY, NASTY_XML, WORDS, Worker, complaint, nothing, numeric, parsers
from test_plugin_pages import MANUALS


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    found = Worker(tmp_path_factory.mktemp("worker"))
    prepare(found.folder)
    yield found
    found.close()


@pytest.mark.quick
def test_nothing_is_left_out_and_damages_change_every_sample() -> None:
    """Every command with a numeric option has its lines, every option and parameter every value."""
    assert {name for name, parser in parsers().items() if numeric(parser)} == set(LINES)
    assert {manual.plugin for manual in MANUALS} <= set(NUMBERS)
    scenes = scene_tries()
    assert len(OPTIONS) > 3000
    assert len(scenes) > 1500
    places: dict[tuple[str, str], set[str]] = {}
    for one in (*OPTIONS, *scenes):
        places.setdefault((one.command, one.option), set()).add(one.value)
    for found in places.values():
        assert found in (set(NASTY), set(NASTY_XML), set(WORDS))
    for name in (("pst", "--azimuths-deg"), ("bsdf", "--A"), ("thermal", "--part"), ("objects", "--disc")):
        assert places[name] == set(NASTY)
    assert places["ghosts", "--filter"] == set(WORDS)
    # Each sort of damage changes a file of each kind for some seed, and gives the same for the same seed
    for kind in KINDS.values():
        for damage, sample in itertools.product(kind.damages, kind.samples):
            data = sample if isinstance(sample, bytes) else sample.read_bytes()
            made = [damage(data, random.Random(seed), kind.nest) for seed in (0, 1, 2, 0)]
            assert made[0] == made[3]
            assert set(made) != {data}, damage.__name__
    assert sum(kind.count * len(kind.damages) for kind in KINDS.values()) >= 1500


ERROR = "mistray: error: "
GOOD = "--rays 0: no rays; give one"


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({}, ""),
        ({"absent": [".usual", ".a[].b"]}, ".a[].b"),
        ({"code": 2, "said": f"mistray: a note\n{ERROR}{GOOD}\n"}, ""),
        ({"code": 2, "said": f"{ERROR}broken\n"}, "no clear line"),
        ({"code": 2, "said": f"{ERROR}{GOOD}\nb\n"}, "not one line"),
        ({"code": 2, "said": f"{ERROR}\x1b[2J{GOOD}"}, "1 lines"),
        ({"code": 2, "said": f"{ERROR}{'a' * LONGEST}; b"}, "1 lines"),
        ({"code": None, "error": "KeyError: 'a' (x.py:1)"}, "KeyError"),
        ({"said": "x.py:1: RuntimeWarning: overflow"}, "the inside"),
        ({"code": 130, "error": "late: 11.0 s", "seconds": 11.0}, "late"),
    ],
)
def test_complaints_are_noticed(change: dict[str, Any], wrong: str) -> None:
    answer = {"code": 0, "error": "", "seconds": 0.1, "said": "", "absent": []} | change
    found = complaint(answer, {".usual"})
    assert found.startswith(wrong)
    assert bool(found) == bool(wrong)
    if answer["code"] == 130:
        assert complaint(answer, (), work=True) == ""


def test_a_worker_survives(worker: Worker) -> None:
    """A crash of the process and a hang are outcomes, the next line has a new process, and nulls are found."""
    assert worker.run(("doctor", "--json"))["code"] in (0, 2)
    assert worker.process is not None
    worker.process.kill()
    worker.process.wait()
    with pytest.raises(BrokenPipeError):
        worker.run(("doctor", "--json"))
    worker.close()
    assert worker.run(("bsdf", "abg", "--A", "nan"))["code"] == 2
    late = worker.run(("ghosts", "scene.xml", "--rays", "4e9"), 0.5)
    assert complaint(late) != ""
    assert complaint(late, work=True) == ""
    assert sorted(nothing(json.loads('{"a": [{"b": null}, {"b": 1}], "c": NaN}'))) == [".a[].b", ".c"]


@pytest.mark.parametrize("ending", KINDS)
def test_the_samples_are_good(ending: str, worker: Worker) -> None:
    """What is damaged can be read, or the attack would show nothing."""
    for sample in KINDS[ending].samples:
        name = f"good{ending}"
        (worker.folder / name).write_bytes(sample if isinstance(sample, bytes) else sample.read_bytes())
        assert read(worker, ending, name) == ""
        # A coating that cannot be evaluated, a reader that needs optiland, a lens without a detector
        if ending not in (".dat", ".len", ".yaml"):
            assert worker.run(KINDS[ending].job.replace("FILE", name).split())["code"] == 0

"""Tiers of the tests: what `make test` runs, and the parts of the rest.

A record says how long each test function takes. `make test` leaves out those that take longer than `AT_ONCE_S`, unless
they are marked `core`, and all that are marked `long` or `slow`. What it leaves out, but for `slow` and `gpu`, is the
long tier. It is cut into parts of about equal length, one of which continuous integration runs a day. A function that
the record does not know is in `make test` if it has no mark, and in every part if it is marked `long`.
"""

import json
import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import pytest

Seconds = dict[str, dict[str, float]]  # file, below tests → function → seconds

RECORD = Path(__file__).parent / "durations.json"
RECORDING = "MISTRAY_RECORD"
PART = "MISTRAY_PART"  # a whole number, modulo the number of parts
AT_ONCE_S = 0.8  # of a function with all its cases
KEPT_S = 0.2  # shorter ones are not recorded
MOST_S = 1200.0  # of processors, for a part: two of them take half of it


def slow_unless(quick: bool) -> pytest.MarkDecorator | tuple[()]:
    """Marks of a case that shows again, unless it is one of the quick ones, what these show."""
    return () if quick else pytest.mark.slow


@lru_cache(maxsize=1)
def recorded() -> Seconds:
    """Seconds of processors that each function took, as `make record` found them."""
    found: Seconds = json.loads(RECORD.read_text(encoding="utf-8"))["seconds"]
    return found


def place(item: pytest.Item) -> tuple[str, str]:
    """File, below tests, and function of a test; a method is "Class.method"."""
    file = item.path.relative_to(RECORD.parent).as_posix()
    return file, item.nodeid.partition("::")[2].partition("[")[0].replace("::", ".")


def seconds_of(file: str, function: str) -> float:
    """What a function takes by the record; 0 if it is not in there."""
    return recorded().get(file, {}).get(function, 0.0)


def takes_long(file: str, function: str, core: bool) -> bool:
    """Whether a function takes longer than `make test` has time for; it has it for those that are marked `core`."""
    return not core and seconds_of(file, function) > AT_ONCE_S


def mark_long(item: pytest.Item) -> None:
    """Mark a test `long` that takes longer than `make test` has time for."""
    if takes_long(*place(item), core=item.get_closest_marker("core") is not None):
        item.add_marker(pytest.mark.long)


def parts(tier: Mapping[str, Mapping[str, float]]) -> list[set[tuple[str, str]]]:
    """The long tier (file → function → seconds), cut into as few parts, sets of (file, function), as hold it.

    A file is in one part, so that what its tests share is made once, unless it takes half a part or more: two processes
    share a part by files.
    """
    units: list[tuple[float, str, tuple[str, ...]]] = []
    for file, functions in tier.items():
        total = sum(functions.values())
        if total < MOST_S / 2:
            units.append((total, file, tuple(functions)))
        else:
            units += [(each, file, (function,)) for function, each in functions.items()]
    units.sort(reverse=True)
    count = max(1, -(-int(sum(unit[0] for unit in units)) // int(MOST_S)))
    while True:
        found: list[set[tuple[str, str]]] = [set() for _ in range(count)]
        lengths = [0.0] * count
        for seconds, file, functions_of in units:  # the longest first, each to the shortest part
            k = lengths.index(min(lengths))
            lengths[k] += seconds
            found[k] |= {(file, function) for function in functions_of}
        if max(lengths) <= MOST_S or count > len(units):
            return found
        count += 1


def chosen_part(count: int) -> int:
    """Index of the part that `MISTRAY_PART` names: a whole number, modulo the count."""
    text = os.environ[PART]
    if not text.isdecimal():
        raise pytest.UsageError(f"{PART} is '{text}'; give a whole number, such as 0 for the first part")
    return int(text) % count


def in_part(items: list[pytest.Item]) -> list[pytest.Item]:
    """Tests of the long tier that belong to the part that is asked for; those without a record belong to each."""
    tier: Seconds = {}
    for item in items:
        if item.get_closest_marker("long") and not (item.get_closest_marker("slow") or item.get_closest_marker("gpu")):
            file, function = place(item)
            if function in recorded().get(file, {}):
                tier.setdefault(file, {})[function] = recorded()[file][function]
    cut = parts(tier)
    others = set().union(*cut) - cut[chosen_part(len(cut))]
    return [item for item in items if place(item) not in others]


def write(seconds: Mapping[tuple[str, str], float]) -> None:
    """Put what functions took into the record; functions that are gone and files that are gone leave it."""
    merged = {file: dict(functions) for file, functions in recorded().items() if (RECORD.parent / file).exists()}
    for file in {file for file, _ in seconds}:
        source = (RECORD.parent / file).read_text(encoding="utf-8")
        old = merged.get(file, {})
        merged[file] = {name: took for name, took in old.items() if f"def {name.rpartition('.')[2]}(" in source}
    for (file, function), took in seconds.items():
        merged[file].pop(function, None)
        if took >= KEPT_S:
            merged[file][function] = round(took, 1)
    kept = {file: dict(sorted(functions.items())) for file, functions in sorted(merged.items()) if functions}
    text = json.dumps({"unit": "seconds of processors, two at work", "seconds": kept}, indent=1)
    RECORD.write_text(text + "\n", encoding="utf-8")

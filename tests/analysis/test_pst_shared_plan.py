"""One plan for runs that are compared: decisions, names of objects, and ways that a scene has not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from mistray.analysis.pst.pilot import Plan
from mistray.analysis.pst.shared_plan import share
from mistray.recorders.path_key import EVENT_BITS, REFLECTED, TRANSMITTED


def table(*ids: str, media: tuple[str, ...] = ("unknown",)) -> Any:
    return SimpleNamespace(ids=list(ids), optics=SimpleNamespace(media=list(media)))


def code(place: int, what: int = TRANSMITTED) -> int:
    return (place << EVENT_BITS) | what


def plan(ways: list[list[int]], pairs: list[tuple[int, int, bool]], hits: float = 5.0) -> Plan:
    """Ways as event lists, and (way, cell, forward) in two cells."""
    longest = max(map(len, ways))
    way, cell, forward = zip(*pairs, strict=True)
    return Plan(
        events=np.array([one + [0] * (longest - len(one)) for one in ways], dtype=np.uint32),
        lengths=np.array([len(one) for one in ways]),
        way=np.array(way),
        cell=np.array(cell),
        forward=np.array(forward),
        hits=np.full((2, len(pairs)), hits),
        mean=np.ones((2, len(pairs))),
        second=np.ones((2, len(pairs))),
        rays=np.full((2, 2), 1000.0),
        cost=np.ones(2),
    )


def decisions(one: Plan, names: Any) -> dict[tuple[tuple[tuple[str, int], ...], int], bool]:
    """Whether each pair is counted forwards, by names of its places."""
    places = [*names.ids, *names.optics.media]
    found = {}
    for way, cell, forward in zip(one.way, one.cell, one.forward, strict=True):
        codes = one.events[way, : one.lengths[way]].tolist()
        key = tuple((places[c >> EVENT_BITS], c & ((1 << EVENT_BITS) - 1)) for c in codes)
        assert (key, int(cell)) not in found
        found[key, int(cell)] = bool(forward)
    return found


def test_equal_ways_are_decided_alike_by_names() -> None:
    """In the second scene a new object comes first, so that all numbers are others."""
    before, after = table("detector", "lens", "wall"), table("baffle", "detector", "lens", "wall")
    first = plan(
        [[code(1), code(0)], [code(1), code(2, REFLECTED), code(0)]], [(0, 0, False), (1, 0, True), (1, 1, True)]
    )
    second = plan(
        [[code(2), code(1)], [code(2), code(3, REFLECTED), code(1)], [code(0, REFLECTED), code(1)]],
        [(0, 0, False), (1, 0, False), (2, 1, True), (0, 1, True)],
    )
    a, b = (decisions(*pair) for pair in zip(share([first, second], [before, after]), [before, after], strict=True))
    direct, wall = (
        (("lens", TRANSMITTED), ("detector", TRANSMITTED)),
        (("lens", TRANSMITTED), ("wall", REFLECTED), ("detector", TRANSMITTED)),
    )
    baffle = (("baffle", REFLECTED), ("detector", TRANSMITTED))
    assert a == {(direct, 0): False, (wall, 0): True, (wall, 1): True, (direct, 1): True}
    assert b == a | {(baffle, 1): True}


def test_what_a_plan_knows_stays_its_own() -> None:
    names = table("detector", "lens")
    first, second = plan([[code(1), code(0)]], [(0, 0, True)], 7.0), plan([[code(0)]], [(0, 0, False)], 3.0)
    a, b = share([first, second], [names, names])
    assert a.hits.tolist() == [[7.0], [7.0]]
    assert b.hits.tolist() == [[3.0, 0.0], [3.0, 0.0]]
    np.testing.assert_array_equal(b.rays, second.rays)


def test_media_are_no_objects() -> None:
    """A medium of the name of an object, and other numbers of media in each scene."""
    before, after = table("air", "lens", media=("unknown", "air")), table("air", "lens", "x", media=("air",))
    first = plan([[code(3), code(0)]], [(0, 0, True)])
    second = plan([[code(0)]], [(0, 1, False)])
    _, b = share([first, second], [before, after])
    new = b.events[b.way[-1], : b.lengths[b.way[-1]]]
    assert (new >> EVENT_BITS).tolist() == [3, 0]

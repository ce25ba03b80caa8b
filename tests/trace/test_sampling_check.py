"""The check of how scattered light was sampled: shares, limits, words."""

from types import SimpleNamespace
from typing import Any

import pytest
from lit_detector import hazy_block, lit, square, towards_origin

import mistray
from mistray.trace.reliability import AimedSurface, SilentPlace, sampling_check, sampling_notes


def traced(rays: float = 1.0, largest: float = 0.001, aiming: Any = (), silent: Any = ()) -> Any:
    numbers = {"scattered_rays_per_start": rays, "largest_ray_share": largest, "effective_scattered_rays": 5000.0}
    return SimpleNamespace(aiming=list(aiming), silent=list(silent), **numbers)


def aimed(aimed: float, landed: float, at_detector: bool = True) -> dict[str, Any]:
    return {"aiming": [AimedSurface("window", aimed, landed, at_detector)]}


def two_surfaces(a: float, b: float) -> list[AimedSurface]:
    return [AimedSurface("a", 1000, a), AimedSurface("b", 1000, b)]


def silent(count: int, share: float) -> dict[str, Any]:
    return {"silent": [SilentPlace(f"wall_{k}", share) for k in range(count)]}


def test_what_is_told() -> None:
    """One line for each cause, with the worst surfaces first, or none."""
    four = [AimedSurface(f"s{k}", 1000, 10 * k) for k in (3, 2, 1, 0)]
    for values, words in (
        (aimed(1000, 250), ()),
        (aimed(1000, 199), ("window 20 %",)),
        (aimed(1000, 200), ()),
        (aimed(99, 0), ()),  # of a few rays no reason to warn
        (aimed(100, 0), ("window 0 %",)),
        (aimed(1000, 1000, False), ("window",)),  # all land, so that the target is too small, unless it is the detector
        (aimed(1000, 1000), ()),
        (aimed(1000, 999, False), ()),
        ({"aiming": four}, ("s0 0 %, s1 1 %, s2 2 % and 1 more",)),
        ({"rays": 0.099}, ("at least 0.1",)),
        ({"rays": 0.1}, ()),
        ({**aimed(1000, 500), "rays": 0.0}, ("at least 0.1",)),
        ({"rays": 10.0}, ()),
        ({"rays": 10.1}, ("at most 10",)),
        ({"rays": 0.0, "largest": float("nan")}, ()),  # nothing scatters
        ({"largest": 0.049}, ()),
        ({"largest": 0.2}, ("20 %",)),
        (silent(1, 0.9e-3), ()),
        (silent(1, 1e-3), ("wall_0",)),
        (silent(7, 0.5), ("7 surfaces", "wall_2 50 % and 4 more")),
    ):
        notes = sampling_check(traced(**values)).notes
        assert len(notes) == bool(words)
        assert all(word in notes[0] for word in words)
    # Several traces share a line of each kind, with the worst figures of any of them
    wall, dim, edge = SilentPlace("wall", 0.5), SilentPlace("wall", 0.02), SilentPlace("edge", 0.1)
    several = [
        traced(40.0, 0.2, two_surfaces(100, 900), [dim]),
        traced(50.0, 0.001, two_surfaces(150, 50)),
        traced(0.0, float("nan")),
        traced(0.01, 0.3, two_surfaces(500, 900), [wall, edge]),
    ]
    found = sampling_notes(several)
    words = ("b 5 %, a 10 %", "wall 50 %, edge 10 %", "0.01", "50", "30 %")
    assert [numbers for numbers, _ in found] == [[0, 1], [0, 3], [3], [0, 1], [0, 3]]
    assert all(word in text for word, (_, text) in zip(words, found, strict=True))
    assert sampling_notes([]) == []


def hazy_scene(target: dict[str, Any] | None = None) -> Any:
    place = towards_origin(40.0, 100.0)
    more = {} if target is None else {"aim": target | {"to_world": place}}
    block = hazy_block("1.0 scatter=0.01")
    return lit({"type": "collimated", "radius": 1.0}, **block, detector=square(0.3, 8, to_world=place), **more)


def test_a_medium_whose_light_is_not_found_is_named():
    """Without aim no ray finds the detector (2e-6 of them would): the trace says so instead of 0 ± 0 alone."""
    blind = mistray.trace(hazy_scene(), rays=5000, aim="none")
    assert blind.energy.detected_W == 0
    (place,) = blind.silent
    assert place.id == "(1.0_scatter=0.01)"
    assert 0.9 < place.share < 1.1  # the whole beam, less what is scattered before, and once more what comes back
    assert any("(1.0_scatter=0.01)" in text for text in sampling_check(blind).notes)
    aimed = mistray.trace(hazy_scene(), rays=5000)
    assert aimed.silent == []
    assert not any("(1.0_scatter=0.01)" in text for text in sampling_check(aimed).notes)


@pytest.mark.parametrize(("scale", "low", "tight"), [(0.1, False, True), (0.35, False, False), (9.0, True, False)])
def test_targets_of_a_wrong_size_are_named(scale, low, tight):
    disc = {"type": "disk", "bsdf": {"type": "target", "surfaces": "*", "scale": scale}}
    (row,) = sampling_check(mistray.trace(hazy_scene(disc), rays=5000)).rows
    assert (row.low, row.tight) == (low, tight)

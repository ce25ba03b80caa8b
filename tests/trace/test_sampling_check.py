"""The check of how scattered light was sampled: shares, limits, words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.trace.reliability.aimed_rays import SilentPlace
from mistray.trace.reliability.sampling_check import sampling_check, sampling_notes


@dataclass
class Surface:
    id: str
    aimed: float
    landed: float
    at_detector: bool = True


@dataclass
class Traced:
    aiming: list[Surface] = field(default_factory=list)
    scattered_rays_per_start: float = 1.0
    largest_ray_share: float = 0.001
    effective_scattered_rays: float = 5000.0
    silent: list[SilentPlace] = field(default_factory=list)


def warnings_of(**values: Any) -> tuple[str, ...]:
    return sampling_check(Traced(**values)).notes


def test_shares_are_those_of_the_rays():
    check = sampling_check(Traced([Surface("a", 1000, 250), Surface("b", 400, 400)]))
    assert [(row.surface, row.aimed, row.share_landed, row.low) for row in check.rows] == [
        ("a", 1000, 0.25, False),
        ("b", 400, 1.0, False),
    ]
    assert (check.hits_per_start, check.largest_share, check.effective_hits) == (1.0, 0.001, 5000.0)
    assert check.notes == ()


def test_several_traces_share_a_line():
    """Each kind of warning once, with the traces that it is about and the worst figures of any of them."""
    traces = [
        Traced([Surface("a", 1000, 100), Surface("b", 1000, 900)], 40.0, 0.2, silent=[SilentPlace("wall", 0.02)]),
        Traced([Surface("a", 1000, 150), Surface("b", 1000, 50)], 50.0, 0.001),
        Traced([], 0.0, float("nan")),
        Traced([Surface("a", 1000, 500)], 0.01, 0.3, silent=[SilentPlace("wall", 0.5), SilentPlace("edge", 0.1)]),
    ]
    low, silent, few, many, single = sampling_notes(traces)
    assert low[0] == [0, 1]
    assert "b 5 %, a 10 %" in low[1]
    assert silent[0] == [0, 3]
    assert "wall 50 %, edge 10 %" in silent[1]
    assert (few[0], many[0], single[0]) == ([3], [0, 1], [0, 3])
    assert ("0.01" in few[1], "50" in many[1], "30 %" in single[1]) == (True, True, True)
    assert sampling_notes([]) == []


def test_nothing_scatters_nothing_to_say():
    check = sampling_check(Traced([], 0.0, float("nan"), 0.0))
    assert (check.rows, check.notes) == ((), ())
    assert np.isnan(check.largest_share)


@pytest.mark.parametrize(("landed", "low"), [(199, True), (200, False), (0, True)])
def test_few_aimed_rays_that_land_are_named(landed, low):
    check = sampling_check(Traced([Surface("window_front", 1000, landed)]))
    assert check.rows[0].low is low
    assert any("window_front" in text for text in check.notes) is low


def test_a_share_of_a_few_rays_is_no_reason_to_warn():
    assert warnings_of(aiming=[Surface("a", 99, 0)]) == ()
    assert warnings_of(aiming=[Surface("a", 100, 0)]) != ()


def test_the_worst_surfaces_come_first_and_not_all():
    surfaces = [Surface(f"s{k}", 1000, 10 * k) for k in reversed(range(8))]
    (text,) = warnings_of(aiming=surfaces)
    assert "s0 0 %, s1 1 %, s2 2 % and 5 more" in text


@pytest.mark.parametrize(
    ("hits", "words"), [(0.099, "at least 0.1"), (0.1, None), (10.0, None), (10.1, "at most 10"), (0.0, "at least 0.1")]
)
def test_hits_per_start_ray(hits, words):
    texts = warnings_of(aiming=[Surface("a", 1000, 500)], scattered_rays_per_start=hits)
    assert len(texts) == (words is not None)
    assert words is None or words in texts[0]


def test_unaimed_scatter_is_judged_too():
    assert len(warnings_of(scattered_rays_per_start=0.001)) == 1


def test_one_ray_that_brings_much():
    assert warnings_of(largest_ray_share=0.049) == ()
    (text,) = warnings_of(largest_ray_share=0.2)
    assert "20 %" in text


@pytest.mark.parametrize(
    ("landed", "at_detector", "tight"), [(1000, False, True), (1000, True, False), (999, False, False)]
)
def test_all_that_land_are_named_unless_the_target_is_the_detector(landed, at_detector, tight):
    check = sampling_check(Traced([Surface("window_front", 1000, landed, at_detector)]))
    assert check.rows[0].tight is tight
    assert any("window_front" in text for text in check.notes) is tight


def test_places_that_send_nothing_are_one_line_of_a_count_and_the_three_with_most_light():
    places = [SilentPlace(f"wall_{k}", 0.3 / 10**k) for k in range(7)]
    (text,) = (text for text in warnings_of(silent=places, scattered_rays_per_start=0.5) if "wall" in text)
    assert text.startswith("3 surfaces")
    assert "wall_0 30 %, wall_1 3 %, wall_2 0.3 % (" in text
    many = [SilentPlace(f"wall_{k}", 0.5) for k in range(7)]
    (text,) = warnings_of(silent=many)
    assert text.startswith("7 surfaces")
    assert "wall_2 50 % and 4 more" in text
    (text,) = warnings_of(silent=many, scattered_rays_per_start=0.0)[1:]
    assert "at least 0.1" in text


def test_places_with_little_light_are_no_warning():
    assert warnings_of(silent=[SilentPlace("wall", 0.9e-3)]) == ()
    assert len(warnings_of(silent=[SilentPlace("wall", 1e-3)])) == 1


def hazy_scene(target: dict[str, Any] | None = None) -> Any:
    """A block that scatters in a beam, and a small detector beside it, 40 degrees off."""
    glass, at = {"type": "interface", "front": "1.0 scatter=0.01"}, mi.ScalarTransform4f().translate
    place = mi.ScalarTransform4f().look_at([64.279, 0, 76.604], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    more = {} if target is None else {"aim": target | {"to_world": place}}
    return mistray.load({
        "type": "scene", "beam": {"type": "collimated", "radius": 1.0},
        "a": {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "back": "1.0 scatter=0.01"}},
        "e": {"type": "frustum", "r0": 5.0, "z0": 0.0, "r1": 5.0, "z1": 10.0, "bsdf": glass},
        "b": {"type": "asphere", "semi_diameter": 5.0, "to_world": at([0, 0, 10]), "bsdf": glass},
        "det": {"type": "asphere", "half_width": 0.3, "half_height": 0.3, "to_world": place,
                "bsdf": {"type": "interface", "R": 0.0}, "sensor": {"type": "irradiancemeter", "film": film}},
    } | more)  # fmt: skip


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
    """A disc inside the square detector, one about as large, and a far larger one."""
    disc = {"type": "disk", "bsdf": {"type": "target", "surfaces": "*", "scale": scale}}
    (row,) = sampling_check(mistray.trace(hazy_scene(disc), rays=5000)).rows
    assert (row.low, row.tight) == (low, tight)

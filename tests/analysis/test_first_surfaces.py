"""First surfaces that were none before: plain arithmetic, and the classes of a PST that count the same light."""

from __future__ import annotations

import pytest

from mistray.analysis.changes.first_surfaces import (
    Entering,
    FirstLight,
    entering_lines,
    entering_text,
    spoils,
    together,
)


def light(unseen: float = 0.0, direct: float = 0.0, **power: float) -> FirstLight:
    """Light of one path by each surface, known to 1 %; `direct` of it by the surface `front` is the image."""
    return FirstLight(
        power,
        {name: (0.01 * value) ** 2 for name, value in power.items()},
        {name: direct if name == "front" else 0.0 for name in power},
        power,
        unseen,
    )


BEFORE = light(front=8.0, hood=0.02)


BRIGHT = {"front": 4.0, "L3": 1.0}
LOUD = FirstLight(BRIGHT, {"front": 0.0, "L3": 0.16}, {"front": 0.0, "L3": 0.0}, BRIGHT)


@pytest.mark.parametrize(
    ("after", "before", "new"),
    [
        (BEFORE, BEFORE, []),
        (light(front=0.001, hood=0.02), BEFORE, []),  # the old light has gone, none is new
        (light(), BEFORE, []),
        (BEFORE, light(), []),
        (light(front=4.0, hood=4.0), BEFORE, ["hood"]),
        (light(front=4.0, hood=1.9), BEFORE, []),  # a trace of it before counts for none
        (light(front=4.0, L3=1.0), light(front=8.0, unseen=2.0), []),  # the list before may have left it out
        (light(front=4.0, L3=1.0), light(front=8.0, unseen=0.5), ["L3"]),
        (light(front=4.0, L3=0.003), BEFORE, []),  # less than 0.1 %
        (LOUD, BEFORE, []),  # less than three standard errors
    ],
)
def test_what_is_new(after: FirstLight, before: FirstLight, new: list[str]) -> None:
    assert [one.surface for one in after.since(before)] == new


def test_share_of_the_stray_light() -> None:
    (one,) = light(front=4.0, L3=1.0).since(BEFORE)
    assert one == Entering("L3", pytest.approx(0.2), pytest.approx(0.002), pytest.approx(1 / 8.02))
    # The image does not count: 3 of the light by the front
    (one,) = light(front=4.0, L3=1.0, direct=3.0).since(light(front=4.0, direct=3.0))
    assert (one.share, one.of_before) == pytest.approx((0.5, 1.0))
    both = light(front=1.0, L3=2.0).plus(light(front=3.0))  # independent traces add up
    assert both.power == {"front": 4.0, "L3": 2.0}
    assert both.variance["front"] == pytest.approx(0.01**2 * (1 + 9))
    assert both.strongest == {"front": 3.0, "L3": 2.0}


def test_no_gain_above_a_percent() -> None:
    """But little light left of much is one, all that is left being new."""
    assert not spoils(())
    assert not spoils((Entering("a", 0.009, 0.001, 0.5),))
    two = Entering("a", 0.009, 0.003, 0.008), Entering("b", 0.002, 0.004, 0.003)
    assert spoils(two)
    assert together(two) == pytest.approx((0.011, 0.005))
    (one,) = light(front=1e-6, vane=8e-3).since(BEFORE)
    assert (one.share, one.of_before) == pytest.approx((1.0, 8e-3 / 8.02), rel=1e-3)
    assert not spoils([one])
    assert spoils(light(front=1e-6, vane=0.2).since(BEFORE))


def test_three_places_are_told() -> None:
    assert "50 % (± 2.2 %)" in entering_text([Entering(f"s{k}", 0.1, 0.01, 0.1) for k in range(5)])
    places = {f"{k} deg": (Entering("s", 0.1, 0.01, 0.001 * k),) for k in range(5)}
    lines = entering_lines(places)
    assert [line.partition(":")[0] for line in lines[:3]] == ["4 deg", "3 deg", "2 deg"]
    assert "2 more" in lines[3]
    assert entering_lines({}) == []

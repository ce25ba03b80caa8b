"""PST: what a curve of 41 angles costs by both directions at once, against the light, and angle by angle with it.

The cost of an angle is its relative variance times the seconds of the run, which is the time to an error of 100 %; it
does not depend on the number of rays. With the light every angle has its own run, so that its seconds are those of all
angles together. ``python benchmarks/pst.py`` prints the rows alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from rows import NotTheSameWorkError, Row, agree, measured

import mistray
from mistray.analyses.pst.result import Pst

ANGLES_DEG = range(0, 81, 2)
UP_TO_DEG = 60.0
WANTED = 0.02  # relative error
WARM_UP = 1 << 12
KNOWN = 0.2  # relative error of an angle that is compared
SHARE = 0.1  # by which both curves may differ beside their noise


@dataclass(frozen=True)
class Case:
    """A scene, its limits, the rays of a run for all angles and of each forward one, and the bar of the time to 2 %."""

    scene: str
    limits: dict[str, Any]
    rays: int
    forward_rays: int
    bar: float


CASES = (
    Case("phone_camera_scatter", {"max_reflections": 1, "max_scatters": 1}, 1 << 20, 1 << 14, 10.0),
    Case("baffle_tube", {"max_reflections": 2, "max_scatters": 4}, 1 << 20, 1 << 15, 19.0),
)


def costs(found: Pst) -> np.ndarray:
    """(n,) relative variance × time, s; where no light was found the variance is taken for 1, and is more than that."""
    value, se = found.curve()
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(value > 0, (se / value) ** 2, 1.0) * found.facts["seconds"]


def run(case: Case, method: str, rays: int, **more: Any) -> Pst:
    """One run, its kernels compiled before."""
    scene = mistray.load(case.scene)
    arguments: dict[str, Any] = {"method": method, "paths": False, **case.limits, **more}
    mistray.pst(scene, [20.0], rays=WARM_UP, **arguments)
    return mistray.pst(scene, ANGLES_DEG, rays=rays, **arguments)


def same_curve(ours: Pst, other: Pst, quick: bool) -> str:
    """
    Compare both curves angle by angle where both know them: the median ratio must be 1.

    The median, because errors have heavy tails; allowed are `SHARE` and 6 standard errors of the median.
    """
    (value, se), (light, light_se) = ours.curve(), other.curve()
    known = (value > 0) & (light > 0) & (se < KNOWN * value) & (light_se < KNOWN * light)
    count = int(np.count_nonzero(known))
    if not count:
        if quick:
            return "no angle is known to both"
        raise NotTheSameWorkError(f"no angle is known to {KNOWN:.0%} in both directions; no ratio is given")
    noise = np.hypot(se[known] / value[known], light_se[known] / light[known])
    allowed = SHARE + 6 * 1.25 * float(np.median(noise)) / math.sqrt(count)
    return f"{agree('PST', np.median(value[known] / light[known]), 1.0, allowed)}, median of {count} angles"


def compared(key: str, title: str, joined: Pst, forward: Pst, bar: float, quick: bool) -> Row:
    """Cost of the angle that is worst for each method."""
    equal = same_curve(joined, forward, quick)
    ours, other, angles = costs(joined), costs(forward), np.array(ANGLES_DEG)
    worst, other_worst = int(np.argmax(ours)), int(np.argmax(other))
    dark = int(np.count_nonzero(forward.value == 0))
    unseen = f"; with it {dark} angles see no light, a variance of more than 1" * (dark > 0)
    return Row(
        key,
        f"{title}: relative variance × time at the worst of {len(angles)} angles ({angles[worst]}° and "
        f"{angles[other_worst]}°; angle by angle {np.median(other / ours):.3g} in the median{unseen})",
        f"{ours[worst]:.2g} s",
        f"{'> ' * (dark > 0)}{other[other_worst]:.2g} s",
        float(other[other_worst] / ours[worst]),
        bar,
        equal=equal,
    )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `pst`."""
    for full in CASES:
        case = replace(full, rays=1 << 13, forward_rays=1 << 9) if quick else full
        ours = run(case, "joined", case.rays)
        for aim, words, bar in (("none", "without importance sampling", 100.0), ("auto", "aimed", 20.0)):
            other = run(case, "forward", case.forward_rays, aim=aim)
            key, title = f"{case.scene}-{aim}", f"PST of `{case.scene}` by both directions, and with the light {words}"
            yield measured(key, title, partial(compared, key, title, ours, other, bar, quick))
        counts = np.array(ANGLES_DEG) <= UP_TO_DEG
        wanted = 0.5 if quick else WANTED
        reached = run(case, "joined", 1 << 30, relative_error=wanted, error_up_to_deg=UP_TO_DEG)
        against = costs(run(case, "adjoint", case.rays))[counts].max() / wanted**2
        seconds = float(reached.facts["seconds"])
        worst = float(np.max((reached.standard_error / reached.value)[counts]))
        yield Row(
            f"{case.scene}-2-percent",
            f"PST of `{case.scene}`: time to an error of {wanted:.0%} at every angle up to 60° (reached: {worst:.1%}), "
            "and against the light alone by its variance",
            f"{seconds:.0f} s",
            f"{against:.0f} s",
            float(against / seconds),
            case.bar,
        )


if __name__ == "__main__":
    print(*rows(False), sep="\n")

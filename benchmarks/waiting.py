"""What a user waits for: small traces, moves of the explorer, the first kernels, and the PST of the Cassegrain.

    python benchmarks/waiting.py

Wall time against its bar, the best of several; first kernels are the time of a process with an empty kernel cache less
that with a filled one, which alternate. The last row is the largest relative error of a PST after a given time.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from rows import Row, alternate
from start_up import MODULE, cold_and_warm

import mistray

REPEATS, WARM_UPS = 25, 3
MOVES = 20
PST_S, PST_ERROR = 90.0, 0.05
# Scene, arguments and bar, s
SMALL: dict[str, tuple[str, dict[str, Any], float]] = {
    "small-auto": ("cooke_triplet", {}, 8e-3),
    "small": ("cooke_triplet", {"polarization": "unpolarized"}, 8e-3),
    "small-scatter": ("phone_camera_scatter", {"max_scatters": 1}, 60e-3),
}
COLD_RUNS = 2
# Command, bar of its first kernels, s, and that of its run with a filled cache, if any
FIRST_KERNELS: dict[str, tuple[tuple[str, ...], float, float | None]] = {
    "ghosts": (("ghosts", "phone_camera", "--rays", "1e4"), 0.7, None),
    "pst": (("pst", "phone_camera_scatter", "--field-deg", "0:80:20", "--rays", "1e4"), 3.0, 5.0),
}


def against(key: str, what: str, seconds: float, bar: float) -> Row:
    """Return the row of a time against its bar, s."""
    return Row(key, f"{what}, against the bar", f"{seconds:.3g} s", f"{bar:g} s", seconds / bar, 1.0, small=True)


def small_trace(key: str, repeats: int) -> Row:
    """Return the row of a trace of 1000 rays with a new field and seed each time."""
    name, arguments, bar = SMALL[key]
    scene = mistray.load(name)

    number = itertools.count()

    def work() -> None:
        k = next(number)
        mistray.trace(scene, rays=1000, field_deg=3 + 0.1 * k, seed=k, **arguments)

    (fastest,) = alternate(work, repeats=repeats)
    said = "".join(f", {name} {value}" for name, value in arguments.items())
    return against(key, f"`{name}`: a trace of 1000 rays, new field and seed{said}", fastest.seconds, bar)


def explorer_moves(moves: int) -> Row:
    """Return the row of moves of a curvature in the explorer, each traced again; the bar is for `MOVES`."""
    explorer = mistray.Explorer("cooke_triplet", field_deg=[10.0], control=["L1_front.curvature"])
    name = "L1_front.curvature"
    start = explorer.controls[name].start
    assert isinstance(start, float)

    def work(k: int) -> None:
        explorer.move({name: start * (1 + 1e-3 * (k + 1))})
        explorer.settle()

    for k in range(WARM_UPS):
        work(-2 - k)
    began = time.perf_counter()
    for k in range(moves):
        work(k)
    seconds = (time.perf_counter() - began) * MOVES / moves
    return against("explorer", f"`cooke_triplet`: {MOVES} moves of the explorer, traced again", seconds, 1.5)


def first_kernels(key: str) -> Iterator[Row]:
    """Rows of a command: its time with an empty kernel cache less that with a filled one, and the latter."""
    command, bar, warm_bar = FIRST_KERNELS[key]
    pairs = [cold_and_warm(*MODULE, *command) for _ in range(COLD_RUNS)]
    cold, warm = (min(one.wall for one in runs) for runs in zip(*pairs, strict=True))
    what = f"`mistray {' '.join(command)}`"
    yield against(f"first-kernels-{key}", f"{what}: first kernels", cold - warm, bar)
    if warm_bar is not None:
        yield against(f"warm-{key}", f"{what}: filled kernel cache", warm, warm_bar)


def cassegrain(seconds: float) -> Row:
    """Return the row of the largest relative error of the Cassegrain's PST, 0 … 70°, three scatter events."""
    found = mistray.pst(mistray.load("cassegrain"), range(0, 71, 2), max_scatters=3, seconds=seconds, paths=False)
    value, se = found.curve()
    with np.errstate(divide="ignore", invalid="ignore"):
        worst = float(np.max(np.where(value > 0, se / value, 1.0)))
    what = f"`cassegrain`: largest relative error of its PST after {seconds:g} s, against the bar"
    return Row("cassegrain", what, f"{worst:.3g}", f"{PST_ERROR:g}", worst / PST_ERROR, 1.0, small=True)


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `waiting`."""
    for key in SMALL:
        yield small_trace(key, 2 if quick else REPEATS)
    yield explorer_moves(2 if quick else MOVES)
    for key in FIRST_KERNELS:
        if not quick:
            yield from first_kernels(key)
    yield cassegrain(5.0 if quick else PST_S)


if __name__ == "__main__":
    for row in rows(quick=False):
        print(row)

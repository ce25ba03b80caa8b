"""A hundred million start rays: no precision is lost in the sums, and memory does not grow with the number of rays."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap

import pytest
from oracles import closed_forms

PROGRAM = """
    import json, resource, sys
    import mistray

    rays = int(sys.argv[1])
    t = mistray.trace(mistray.load("plate"), rays=rays)
    print(json.dumps({
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "launched": t.energy.launched_W, "detected": t.energy.detected_W, "escaped": t.energy.escaped_W,
        "closure": t.energy.closure, "hits": [row.rays for row in t.paths], "segments": t.segments,
        "se": t.energy.detected_se_W, "rms": t.paths[0].rms_radius_mm, "rms_se": t.paths[0].rms_radius_se_mm,
        "x": t.paths[0].x_mm, "x_se": t.paths[0].x_se_mm, "map": float(t.irradiance.sum()),
    }))
"""


def traced(rays: int) -> dict:
    """The trace in a process of its own, with the peak of its memory."""
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(PROGRAM), str(rays)], capture_output=True, text=True, timeout=600
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_hundred_million_rays() -> None:
    """Plate, 8e8 segments. A float32 sum of 1e8 equal terms would end at 2^24 of them.

    One path's flux is a float32 product, good to 1e-7; the sums add nothing to its error: 1e8 rays give what a thousand
    rays give, to 1e-12. A pass has 2^20 rays: from four passes on, memory stays.
    """
    few, some, many = traced(1_000), traced(4_000_000), traced(100_000_000)
    assert many["hits"] == [100_000_000, 100_000_000]
    assert many["segments"] == 800_000_000
    for what in ("detected", "escaped"):
        assert many[what] == pytest.approx(few[what], rel=1e-12)
    expected = closed_forms.plate_orders(0.04, 2).sum()
    assert many["detected"] / many["launched"] == pytest.approx(expected, rel=1e-7)
    assert abs(many["closure"]) < 1e-7
    assert many["se"] < 1e-9 * many["detected"]
    pixel = (20 / 64) ** 2
    assert many["map"] * pixel == pytest.approx(many["detected"], rel=1e-12)
    # second moments too: a uniform disc of radius 5 mm, within 4 standard errors
    assert many["rms"] == pytest.approx(5 / 2**0.5, abs=4 * many["rms_se"])
    assert many["rms_se"] < 1e-3
    assert abs(many["x"]) < 4 * many["x_se"]
    assert many["mib"] < 1.15 * some["mib"] + 10

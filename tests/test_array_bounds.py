"""No kernel reads or writes outside of its arrays, on which LLVM and CUDA would do different things in silence.

Dr.Jit checks that in its debug mode, and says where it happened.
"""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

# Large sums may have a copy for each thread, whose places Dr.Jit would take for a mistake
BEGINNING = """
    import drjit as dr
    import mitsuba as mi
    import mistray
    from mistray.optimize import path_power, pst_bin
    dr.set_expand_threshold(0)
    dr.set_flag(dr.JitFlag.Debug, True)
"""
PROGRAMS = {
    "a wrong index": """
        dr.eval(dr.gather(mi.Float, mi.Float(1, 2, 3), mi.UInt32(0, 3)))
    """,
    "pst by both directions": """
        mistray.pst(mistray.load("baffle_tube"), [5.0, 40.0], rays=20_000, max_scatters=1)
    """,
    "pst of a deep tube": """
        mistray.pst(mistray.load("baffle_tube"), [5.0, 40.0], rays=20_000, max_scatters=3)
    """,
    "pst of a camera": """
        mistray.pst(mistray.load("phone_camera_scatter"), [5.0, 40.0], rays=20_000, max_reflections=1)
    """,
    "traces": """
        for name in ("cooke_triplet", "double_gauss", "offner_relay", "segmented_mirror", "head_up_display"):
            trace = mistray.trace(mistray.load(name), rays=20_000, polarization="stokes")
            trace.history(trace.paths[0].path_id, n=5)
    """,
    "gradients": """
        lens, tube = mistray.load("cooke_triplet"), mistray.load("baffle_tube")
        metric = path_power(lens, "ghost", rays=10_000, field_deg=(0.0,))
        mistray.gradient(metric, mi.traverse(lens), keys=["*.curvature", "*.semi_diameter"])
        metric = pst_bin(tube, 40.0, rays=10_000, max_scatters=2)
        mistray.gradient(metric, mi.traverse(tube))
    """,
    "other analyses": """
        mistray.transfer(mistray.load("cooke_triplet"), 5.0, rays=10_000)
        mistray.thermal(mistray.load("cassegrain"), rays=10_000)
        mistray.objects(mistray.load("cassegrain"), rays=10_000)
        mistray.image_quality(mistray.load("cooke_triplet"), [0.0, 10.0])
    """,
}
# LLVM takes ten minutes for the checked kernel of two scatters, and seconds for that of one
TIERS = {"a wrong index": ()} | dict.fromkeys(("pst of a deep tube", "pst of a camera"), pytest.mark.slow)


@pytest.mark.parametrize("name", [pytest.param(n, marks=TIERS.get(n, pytest.mark.long)) for n in PROGRAMS])
def test_arrays_are_used_within_their_bounds(name: str) -> None:
    program = textwrap.dedent(BEGINNING) + textwrap.dedent(PROGRAMS[name])
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = [line for line in (done.stdout + done.stderr).splitlines() if "out-of-bounds" in line]
    assert bool(found) == (name == "a wrong index"), "\n".join(found)

"""No kernel leaves its arrays, as Dr.Jit checks in its debug mode; small files say so before they take gigabytes."""

import io
import resource
import subprocess
import sys
import textwrap
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import mistray
from mistray.files.irradiance_files import read_irradiance
from mistray.files.sag_grid import read_sag_grid

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
    "a wrong index": "dr.eval(dr.gather(mi.Float, mi.Float(1, 2, 3), mi.UInt32(0, 3)))",
    "pst by both directions": 'mistray.pst(mistray.load("baffle_tube"), [5.0, 40.0], rays=20_000, max_scatters=1)',
    "pst of a deep tube": 'mistray.pst(mistray.load("baffle_tube"), [5.0, 40.0], rays=20_000, max_scatters=3)',
    "pst of a camera": 'mistray.pst(mistray.load("phone_camera_scatter"), [5, 40], rays=20_000, max_reflections=1)',
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


HUGE = 30_000  # points a side: 29 GB of four numbers
SMALL_MEMORY_KB = 200_000


def header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    """The beginning of a ``.npy`` of this shape, without its numbers."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def archive(path: Path, size: int, zeros: int = 0) -> Path:
    """A grid whose heights claim size by size points and are so many bytes of zeros."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, content in (
            ("corners", header((size, size, 4)) + bytes(min(zeros, 1 << 20))),
            ("missing", header((2, 2), "|b1") + bytes(4)),
            ("step", header((2,)) + np.ones(2).tobytes()),
            ("middle", header((2,)) + np.zeros(2).tobytes()),
        ):
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                entry.write(content)
                for _ in range(zeros >> 20 if name == "corners" else 0):
                    entry.write(bytes(1 << 20))
    return path


def said_of(read: Callable[[Path], object], path: Path) -> str:
    """What is said of a file; no memory for its arrays was taken."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with refused("", path.name) as caught:
        read(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < SMALL_MEMORY_KB
    return str(caught.value)


def test_a_grid_that_claims_more_than_it_holds(tmp_path: Path) -> None:
    assert "26.8 GiB" in said_of(read_sag_grid, archive(tmp_path / "grid.npz", HUGE))
    assert "by its header" in said_of(read_sag_grid, archive(tmp_path / "less.npz", 1000))
    grid = str(tmp_path / "grid.npz")
    shape = {"type": "freeform", "grid": grid, "semi_diameter": 5.0, "bsdf": {"type": "interface"}}
    with refused(r"'mirror'.*26\.8 GiB"):
        mistray.load({"type": "scene", "mirror": shape})


def test_a_grid_that_unpacks_to_more_than_its_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mistray.files.sag_grid.MOST_BYTES", 64 << 20)
    path = archive(tmp_path / "grid.npz", 1000, zeros=128 << 20)
    assert path.stat().st_size < 1 << 20
    assert "would unpack to 0.126 GiB, more than 0.0625 GiB" in said_of(read_sag_grid, path)


def test_a_grid_of_too_many_points(tmp_path: Path) -> None:
    """Each number is a byte here, and would be eight."""
    path = tmp_path / "grid.npz"
    side = 4097
    square = np.zeros((side, side, 4), np.int8)
    np.savez_compressed(path, corners=square, missing=square[..., 0] > 0, step=[1.0, 1.0], middle=[0.0, 0.0])
    assert f"{side} by {side} points" in said_of(read_sag_grid, path)
    text = tmp_path / "grid.dat"
    text.write_text("100000 100000 1 1 0 0 0\n0 0 0 0\n")
    assert "100000 by 100000 points" in said_of(read_sag_grid, text)

    scene = mistray.load("plate")
    state = archive(tmp_path / "state.npz", HUGE)
    assert "26.8 GiB" in said_of(lambda path: mistray.pst(scene, [0.0], rays=10, state=path, resume=True), state)
    path = tmp_path / "map.npy"
    path.write_bytes(header((HUGE, HUGE, 4)))
    assert "26.8 GiB" in said_of(read_irradiance, path)


def test_a_map_of_too_many_pixels(tmp_path: Path) -> None:
    """An EXR of a few hundred bytes whose header says 60,000 by 60,000 pixels."""
    openexr = pytest.importorskip("OpenEXR")
    path = tmp_path / "map.exr"
    pixels = np.zeros((4, 4), np.float32)
    with openexr.File({"compression": openexr.NO_COMPRESSION, "type": openexr.scanlineimage}, {"Y": pixels}) as file:
        file.write(str(path))
    window, large = (np.array([0, 0, last, last], "<i4").tobytes() for last in (3, 59_999))
    path.write_bytes(path.read_bytes().replace(window, large))
    assert "pixels are more than" in said_of(read_irradiance, path)

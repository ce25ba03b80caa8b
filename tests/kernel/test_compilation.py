"""What compiles a kernel and what does not: each row of two tables of docs/kernels.md; and twenty files one by one."""

import itertools
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles.scatter_scenes import bsdf_xml, placed_xml, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, write

import mistray
from mistray.execute.tracer import prepare
from mistray.kernel.launches import Launches
from mistray.recorders.tallies import Tallies
from mistray.settings import Settings
from mistray.surfaces.upload import download, upload

PAGE = Path(__file__).parents[2] / "docs" / "kernels.md"
TRACE = {"rays": 256, "max_scatters": 1}
ORDINARY: dict[str, dict[str, Any]] = vectors.toml("tables.toml")["ordinary numbers"]
HARVEY = bsdf_xml("harvey_shack", b0=0.1, l=0.01, s=-1.5)
VANE = placed_xml("frustum", "vane", at=(0, 0, 20), r0=4.0, z0=0.0, r1=4.7, z1=0.0)
SCREEN = placed_xml("rectangle", "screen", at=(0, 0, 20), scale=(0.1, 0.1, 1.0))


def scene(
    *more: str,
    models: str = "",
    stack: Sequence[tuple[float, float]] = ((1.38, 99.6),),
    index: str = "1.5",
    paint: float = 0.05,
    at: Sequence[float] = (0.0, 0.0, 3.0),
    facing: Sequence[float] = (0.0, 0.0, 1.0),
    stop_at: float = 5.0,
    pixels: int = 8,
    **changed: dict[str, Any],
) -> str:
    """An asphere and a conic with a stop, a painted barrel and a detector.

    `at` and `facing` place the second surface, and `changed` replaces numbers of `ORDINARY`; None leaves one out.
    """
    given = {
        key: {name: value for name, value in (values | changed.get(key, {})).items() if value is not None}
        for key, values in ORDINARY.items()
    }
    layers = bsdf_xml("thinfilm", layers=", ".join(f"{n} {d_nm}" for n, d_nm in stack))
    front = scattering_xml([layers, models or bsdf_xml("abg", **given["lobe"])], "air", index)
    rear = interface_xml(index, "air", **given["coating"])
    black = scattering_xml([bsdf_xml("paint", reflectance=paint)], R=0.0)
    return scene_text(
        placed_xml("asphere", "front", front, **given["front"]),
        placed_xml("asphere", "rear", rear, at=at, facing=facing, **given["rear"]),
        placed_xml("frustum", "stop", at=(0, 0, stop_at), **given["stop"]),
        placed_xml("frustum", "barrel", black, **given["barrel"]),
        placed_xml("asphere", "detector", at=(0, 0, 40), pixels=pixels, **given["detector"]),
        *more,
        **given["source"],
    )


Case = tuple[str, dict[str, Any]]  # a scene, and arguments of its trace
OF_THE_KERNEL = {"polarization": "stokes", "splitting": "one", "below_threshold": "roulette"}
OF_THE_KERNEL |= {"aim": "none", "max_events": 50, "ledger": False}


def scenes(*changes: dict[str, Any]) -> list[Case]:
    return [(scene(**changed), {}) for changed in changes]


NOTHING: dict[str, list[Case]] = {
    "radius, conic constant, coefficients and rim of a surface": scenes(
        {"rear": {"radius": -50.0}},
        {"front": {"conic": 0.0}},
        {"front": {"a4": 1.1e-5}},
        {"front": {"semi_diameter": 3.9}},
    ),
    "place along the axis, as long as the order stays": [(scene(at=(0, 0, 3.1), stop_at=5.5), {})],
    "radii and length of stops and walls": [(scene(stop={"r0": 2.9}, barrel={"r1": 5.2, "z1": 38.0}), {})],
    "index of a medium": [(scene(index="1.6"), {})],
    "materials, thicknesses and number of the layers of a stack": [(scene(stack=((1.38, 90.0), (2.1, 60.0))), {})],
    "R and T of an ideal coating": [(scene(coating={"R": 0.03, "T": 0.8}), {})],
    "numbers of a scatter model, and one model in place of another": scenes(
        {"lobe": {"A": 1e-3, "B": 1e-2, "g": 1.5}, "paint": 0.06}, {"models": HARVEY}
    ),
    "size, power, angles and wavelengths of the source": [
        (scene(source={"radius": 2.5, "irradiance": 2.0}), {}),
        (scene(), {"field_deg": 5.0, "azimuth_deg": 30.0, "wavelength_nm": (450.0, 500.0, 600.0)}),
    ],
    "size of the detector": [(scene(detector={"semi_diameter": 2.5}), {})],
    "number of rays, and seed": [(scene(), {"rays": 300, "seed": 5})],
    "thresholds, and limits of reflections and of scatter events": [
        (scene(), {"flux_threshold": 1e-5, "scatter_threshold": 1e-6, "max_reflections": 3, "max_scatters": 2}),
    ],
}
COMPILES: dict[str, list[Case]] = {
    "a surface more, or one less": [(scene(VANE), {})],
    "another order of the surfaces along the axis": [(scene(stop_at=-1.0), {})],
    "a surface that leaves the axis of others": [(scene(at=(0, 0.1, 3)), {}), (scene(facing=(0, 0.01, 1)), {})],
    "a curved surface that becomes plane": [(scene(rear={"radius": None}), {})],
    "a hole in a surface": [(scene(rear={"inner_semi_diameter": 0.5}), {})],
    "a coefficient of an asphere that was 0, and the last that becomes 0": scenes(
        {"front": {"a6": 1e-8}}, {"front": {"a4": 0.0}}
    ),
    "a departure from the conic that takes a second step of Newton's method": [(scene(front={"a4": 1e-3}), {})],
    "the first medium that absorbs, and the first that scatters": scenes(
        {"index": "1.5+1e-6i"}, {"index": "1.5 scatter=0.01 g=0.5"}
    ),
    "one more scatter model on a surface": [(scene(models=HARVEY + bsdf_xml("abg", **ORDINARY["lobe"])), {})],
    "no scatter": [(scene(), {"max_scatters": 0})],
    "a source of another kind, and a beam with a dark centre": [(scene(source={"inner_radius": 0.5}), {})],
    "pixels of the detector": [(scene(pixels=9), {})],
    "the first shape of Mitsuba's own": [(scene(SCREEN), {})],
    ", ".join(f"`{name}`" for name in OF_THE_KERNEL): [(scene(), {name: v}) for name, v in OF_THE_KERNEL.items()],
}

CALLS = itertools.count()
Kernels = Callable[[str, dict[str, Any]], set[str]]


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Kernels]:
    """Hashes of the kernels that a trace of a scene launches."""
    launched: list[dict[str, Any]] = []
    history, clear = dr.kernel_history, dr.kernel_history_clear

    def forget() -> None:  # a first launch empties the history, to time itself
        launched.extend(history())
        clear()

    def run(text: str, arguments: dict[str, Any]) -> set[str]:
        forget()
        launched.clear()
        assert mistray.trace(mistray.load(write(tmp_path, text)), **(TRACE | arguments)).irradiance.any()
        forget()
        return {str(kernel["hash"]) for kernel in launched if kernel["type"] == dr.KernelType.JIT}

    monkeypatch.setattr(dr, "kernel_history_clear", forget)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        yield run


def known(kernels: Kernels) -> set[str]:
    """Kernels of the ordinary scene and of another edit of it each time, since the process keeps what it knows."""
    number = next(CALLS)
    text, arguments = edits(random.Random(number))
    return kernels(scene(), {}) | kernels(text, arguments | {"flux_threshold": 1e-9 * (1 + number)})


def rows(title: str) -> list[str]:
    """First cells of the table of a section of the page."""
    section = PAGE.read_text(encoding="utf-8").split(f"\n## {title}\n")[1].split("\n## ")[0]
    return [line.split("|")[1].strip() for line in section.splitlines() if line.startswith("| ")][1:]


@pytest.mark.quick
def test_the_page_says_what_is_tested() -> None:
    assert rows("What compiles nothing") == list(NOTHING)
    assert rows("What compiles") == list(COMPILES)


@pytest.mark.quick
def test_edits_of_all_numbers_compile_nothing(kernels: Kernels) -> None:
    before = known(kernels)
    assert len(before) >= 4
    assert kernels(*edits(random.Random("quick"))) <= before


@pytest.mark.long
@pytest.mark.parametrize("what", NOTHING)
def test_compiles_nothing(what: str, kernels: Kernels) -> None:
    before = known(kernels)
    for text, arguments in NOTHING[what]:
        assert kernels(text, arguments) <= before, arguments


@pytest.mark.long
@pytest.mark.parametrize("what", COMPILES)
def test_compiles(what: str, kernels: Kernels) -> None:
    before = known(kernels)
    for text, arguments in COMPILES[what]:
        assert kernels(text, arguments) - before, arguments


@pytest.mark.long
def test_later_launches_of_a_pst_compile_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds of its pilot have the kernels of the first one, though more of its tables are filled."""
    launched: dict[Launches, list[set[str]]] = {}
    once, history = Launches.time, dr.kernel_history
    kernels: list[dict[str, Any]] = []

    def read() -> list[dict[str, Any]]:  # a first launch reads the history, to time itself
        kernels.extend(history())
        return kernels

    def time(self: Launches, lanes: int, work: Callable[[], object]) -> None:
        read()
        kernels.clear()
        once(self, lanes, work)
        large = {str(one["hash"]) for one in read() if one.get("operation_count", 0) > 1000}
        launched.setdefault(self, []).append(large)

    monkeypatch.setattr(Launches, "time", time)
    monkeypatch.setattr(dr, "kernel_history", read)
    loaded = mistray.load(write(tmp_path, scene(models=HARVEY)))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        mistray.pst(loaded, [10, 20], rays=3000, max_scatters=1)
    kinds = [rounds for rounds in launched.values() if len(rounds) > 2]
    assert len(kinds) >= 3
    for first, *later in kinds:
        assert first
        assert set().union(*later) <= first


@pytest.mark.quick
def test_rays_that_are_traced_again_compile_nothing() -> None:
    """As those of a pass whose path table was full."""
    (run,) = prepare(mistray.load("cooke_triplet"), Settings(rays=256))
    start, found = run.start_pass(0), []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _ in range(2):
            dr.kernel_history_clear()
            run.trace_trees(start, Tallies(run.table))
            found.append({str(one["hash"]) for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT})
    assert found[0]
    assert found[1] <= found[0]


@pytest.mark.quick
def test_objects_take_two_kernels() -> None:
    """Rays from every surface, from the source and from the detector: one kernel to find the stop, one for all else."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        mistray.objects(mistray.load("cooke_triplet"), rays=500)
        found = {str(one["hash"]) for one in dr.kernel_history() if one.get("operation_count", 0) > 1000}
    assert len(found) == 2


def edits(rng: random.Random) -> Case:
    """The scene with other numbers, and a trace by another seed, with another number of rays at another angle."""
    changed = {key: {n: x * rng.uniform(0.97, 0.995) for n, x in numbers.items()} for key, numbers in ORDINARY.items()}
    edited = scene(
        stack=[(rng.uniform(1.3, 2.2), rng.uniform(50, 150)) for _ in range(rng.randint(1, 5))],
        index=f"{rng.uniform(1.4, 1.9):.6f}",
        paint=rng.uniform(0.01, 0.1),
        at=(0.0, 0.0, rng.uniform(2.5, 3.3)),
        stop_at=rng.uniform(4.0, 6.0),
        **changed,
    )
    return edited, {"rays": rng.randint(200, 300), "seed": rng.randint(0, 1000), "field_deg": rng.uniform(0.5, 3.0)}


GLASSES = ("N-BK7 0 0 1.5168 64.17", "N-SF6 0 0 1.80518 25.36", "N-LAK33B 0 0 1.755 52.3", "F2 0 0 1.62 36.4")
SURFACE = "SURF {}\n  TYPE {}\n  CURV {:.6f}\n  DISZ {:.4f}\n  DIAM {:.4f}\n"


def lens_file(rng: random.Random) -> str:
    """A triplet as Zemax writes it, the last lens an asphere in front; the rear of each lens has the smaller rim."""
    lines = [
        "MODE SEQ\nUNIT MM X W X CM MR CPMM\nENPD 6\nGCAT SCHOTT\nFTYP 0 0 1 1 0 0 0\nXFLN 0\nYFLN 0\n"
        "WAVM 1 0.5875618 1\nPWAV 1\nSURF 0\n  TYPE STANDARD\n  DISZ INFINITY\n"
    ]
    for lens, sign in enumerate((1, -1, 1)):
        power = sign / rng.uniform(40.0, 80.0)
        front = power * rng.uniform(0.6, 1.4)
        kind = "EVENASPH" if lens == 2 else "STANDARD"
        rim = rng.uniform(4.5, 5.5)
        lines += [
            SURFACE.format(2 * lens + 1, kind, front, rng.uniform(3.0, 5.0), rim),
            f"  GLAS {rng.choice(GLASSES)}\n",
            f"  PARM 1 0\n  PARM 2 {rng.uniform(1e-7, 1e-6):.3e}\n" * (lens == 2),
            "  STOP\n" * (lens == 1),
            SURFACE.format(2 * lens + 2, "STANDARD", front - 2 * power, rng.uniform(4.0, 8.0), rim - 0.3),
        ]
    return "".join(lines) + "SURF 7\n  TYPE STANDARD\n  DISZ 0\n"


PROGRAM = """
import sys
import mistray
from mistray.prescription import from_zemax

path = sys.argv[1]
scene = mistray.load(path) if path.endswith(".xml") else from_zemax(path).to_scene()
mistray.trace(scene, **eval(sys.argv[2])).paths.to_pandas()
"""


@pytest.mark.long
@pytest.mark.parametrize("kind", ["xml", "zmx"])
def test_twenty_in_fresh_processes_compile_nothing_after_the_first(kind: str, tmp_path: Path) -> None:
    """Twenty edits of all numbers of a scene, and twenty lens files of surfaces of the same kinds."""
    cache = tmp_path / ".drjit"
    environment = os.environ | {"HOME": str(tmp_path)}
    kept: set[str] = set()
    for number in range(21):
        rng = random.Random(number)
        text, arguments = edits(rng) if kind == "xml" else (lens_file(rng), {"rays": 200 + number, "seed": number})
        path = tmp_path / f"file.{kind}"
        path.write_text(text, encoding="utf-8")
        command = [sys.executable, "-c", PROGRAM, str(path), repr(arguments)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        now = set(os.listdir(cache))
        if number:
            assert now == kept, f"number {number} compiled {len(now - kept)} kernels"
        kept = now
    assert len(kept) >= 4


@pytest.mark.quick
def test_vectors_of_any_width_come_to_the_host_without_a_kernel() -> None:
    """NumPy has Dr.Jit reorder the components of a vector, by a kernel with their number as a literal."""
    for count in (5, 7, 1009):
        rng = np.random.default_rng(count)
        vector = mi.Vector3f(*(upload(mi.Float, column) for column in rng.random((3, count))))
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            found = download(vector)
            assert not [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
        np.testing.assert_array_equal(found, np.array(vector, dtype=np.float64).T)
    np.testing.assert_array_equal(download(mi.Vector3f(upload(mi.Float, rng.random(2)), 1, 2))[:, 1:], [[1, 2], [1, 2]])

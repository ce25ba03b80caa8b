"""Speed, as ratios taken in one run: ``make bench`` prints the table and keeps it in benchmarks/README.md.

Each ratio compares two things on the same machine a moment apart, the best of several alternating repeats, with every
kernel compiled before the clock starts. Figures in Mrays/s or Msegments/s depend on the machine; the ratios hardly do.
"""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from coating_steps import tracing_share
from gradients import gradient_costs, memory
from pst import pst_costs
from rows import Row, alternate
from scatter import scatter_samples, scattering_camera
from thinfilm import thin_films

import mistray
from mistray.optimize import gradient, parameters, path_power
from mistray.prescription import Coating, from_batoid
from mistray.trace.books import SEGMENTS
from mistray.trace.settings import Settings
from mistray.trace.tracer import Run, prepare

HERE = Path(__file__).parent


def tree_segments(run: Run, most: int) -> tuple[mi.Point3f, mi.Vector3f]:
    """Segments of the run's own ray tree, in the order of their start rays and depths: origins and directions."""
    recorder = run.record(0, most)
    count = min(int(recorder.count[0]), recorder.capacity)
    lengths, lanes = np.array(recorder.length)[:count], np.array(recorder.lane)[:count]
    nodes = np.array(recorder.nodes).reshape(recorder.capacity, run.settings.max_events, -1)[:count]
    order = np.argsort(lanes, kind="stable")
    origins, directions = [], []
    for depth in range(1, int(lengths.max())):
        here = order[lengths[order] > depth]
        origins.append(nodes[here, depth - 1, :3] + 1e-4 * nodes[here, depth, 3:6])
        directions.append(nodes[here, depth, 3:6])
    o, d = mi.Point3f(np.concatenate(origins).T), mi.Vector3f(np.concatenate(directions).T)
    dr.eval(o, d)
    return o, d


def against_mesh(name: str, rays: int, bar: float | None) -> Row:
    """Whole ray tree, Fresnel and film included, against Mitsuba's bare intersection of the same lens as a mesh."""
    scene = mistray.load(name)
    settings = Settings(rays=rays)
    segments = 0.0

    def ours() -> None:
        nonlocal segments
        (run,) = prepare(scene, settings)
        run.execute(False, None)
        segments = float(run.reasons[SEGMENTS].sum())

    (sample,) = prepare(scene, settings)
    o, d = tree_segments(sample, 1 << 14)

    def mesh() -> None:
        hit = scene.ray_intersect_preliminary(mi.Ray3f(o, d), coherent=True)
        dr.eval(hit.t, hit.prim_index)
        dr.sync_thread()

    t_ours, t_mesh = alternate(ours, mesh)
    rate, other = segments / t_ours, dr.width(o) / t_mesh
    triangles = sum(shape.face_count() for shape in scene.shapes())
    return Row(
        f"ray tree of `{name}` (segments/s) against `ray_intersect_preliminary` of the same segments on its mesh of "
        f"{triangles / 1000:.0f} k triangles (rays/s)",
        f"{rate / 1e6:.1f} M/s",
        f"{other / 1e6:.1f} M/s",
        rate / other,
        bar,
    )


def ledger_cost(name: str, rays: int, bar: float) -> Row:
    """Speed with the path table on over speed with it off."""
    scene = mistray.load(name)
    settings = Settings(rays=rays)

    def run(ledger: bool) -> Callable[[], None]:
        def action() -> None:
            (run,) = prepare(scene, settings)
            run.execute(ledger, None)

        return action

    on, off = alternate(run(True), run(False))
    rates = [f"{rays / seconds / 1e3:.1f} k/s" for seconds in (on, off)]
    return Row(f"`{name}`: ledger on against off (start rays/s)", *rates, off / on, bar)


def against_batoid(rays: int, bar: float) -> Row:
    """All two-reflection ghosts of the Rubin telescope: the trace against batoid's `traceSplit`."""
    import batoid

    telescope = batoid.Optic.fromYaml("LSST_r.yaml")
    coating = batoid.SimpleCoating(0.02, 0.98)
    for surface in telescope.itemDict.values():
        if isinstance(surface, batoid.RefractiveInterface | batoid.Detector):
            surface.forwardCoating = surface.reverseCoating = coating
    scene = from_batoid(telescope, wavelength_nm=620.0, reflectance=0.02).to_scene()
    settings = Settings(rays=rays, max_reflections=2, flux_threshold=0.9 * 0.02**2 * 0.98**26)
    (run,) = prepare(scene, settings, field_deg=1.0)
    start = run.start_pass(0)
    origin, direction = np.array(start.o, dtype=float).T, np.array(start.d, dtype=float).T
    flip = np.array([-1.0, 1.0, -1.0])  # the scene is batoid's turned by 180 degrees about y

    def theirs() -> None:
        n = telescope.inMedium.getN(620e-9)
        x, v = 1e-3 * origin * flip, direction * flip / n
        bundle = batoid.RayVector(*x.T, *v.T, t=0.0, wavelength=620e-9, flux=1.0)
        telescope.traceSplit(bundle, minFlux=settings.flux_threshold)

    def ours() -> None:
        (run,) = prepare(scene, settings, field_deg=1.0)
        run.execute(True, None)

    t_ours, t_theirs = alternate(ours, theirs)
    return Row(
        f"Rubin/LSST r band, R = 2 %, ghosts of {rays} rays against batoid {batoid.__version__} `traceSplit` (jobs/s)",
        f"{t_ours:.2f} s",
        f"{t_theirs:.2f} s",
        t_theirs / t_ours,
        bar,
    )


def coated(name: str, layers: str) -> mi.Scene:
    """A shipped scene with the same stack on every refracting surface."""
    build = importlib.import_module(f"mistray.scenes.{name}.prescription").build
    prescription = build()
    surfaces = tuple(
        s if s.mirror or s.front == s.back else replace(s, coating=Coating(layers=layers))
        for s in prescription.surfaces
    )
    return replace(prescription, surfaces=surfaces).to_scene()


def forty_layers() -> str:
    rng = np.random.default_rng(0)
    return ", ".join(f"{rng.uniform(1.38, 2.2):.4f} {rng.uniform(20.0, 150.0):.2f}" for _ in range(40))


def coating_cost(name: str, rays: int, bar: float) -> Row:
    """A 40-layer stack on every surface over bare surfaces; nothing is cut, so that both trees are the same."""
    settings = Settings(rays=rays, flux_threshold=0.0)
    (stacks,) = prepare(coated(name, forty_layers()), settings)
    (bare,) = prepare(mistray.load(name), settings)
    t_stacks, t_bare = alternate(lambda: stacks.execute(True, None), lambda: bare.execute(True, None))
    rates = [f"{rays / seconds / 1e3:.1f} k/s" for seconds in (t_stacks, t_bare)]
    return Row(f"`{name}`: 40 layers on every surface against bare (start rays/s)", *rates, t_bare / t_stacks, bar)


def stokes_cost(name: str, rays: int, bar: float) -> Row:
    """Polarised light over unpolarised."""
    scene = mistray.load(name)
    (stokes,), (plain,) = (prepare(scene, Settings(rays=rays, polarization=p)) for p in ("stokes", "unpolarized"))
    t_stokes, t_plain = alternate(lambda: stokes.execute(True, None), lambda: plain.execute(True, None))
    rates = [f"{rays / seconds / 1e3:.1f} k/s" for seconds in (t_stokes, t_plain)]
    return Row(f"`{name}`: Stokes vectors against unpolarised (start rays/s)", *rates, t_plain / t_stokes, bar)


def gradient_cost(name: str, rays: int, most: float) -> Row:
    """A metric with the gradient of every layer over the metric alone; small is good."""
    scene = coated(name, "1.38 99.6, 2.10 131.0, 1.63 84.4")
    params = mi.traverse(scene)
    metric = path_power(scene, "ghost", rays=rays, flux_threshold=0.0)
    coatings = [key for key, p in parameters(scene).items() if p.kind in ("coating", "share")]
    count = sum(len(values) for values in gradient(metric, params, coatings).gradient.values())
    t_gradient, t_value = alternate(lambda: gradient(metric, params, coatings), metric.value)
    return Row(
        f"`{name}`: ghost power and its {count} derivatives against ghost power (time, small is good)",
        f"{t_gradient:.3f} s",
        f"{t_value:.3f} s",
        t_gradient / t_value,
        most,
        small=True,
    )


def first_run(name: str) -> str:
    """Time from Python's start to the first path table in a fresh process, kernels compiled before and not."""
    import subprocess
    import sys
    import tempfile

    code = f"import mistray; mistray.trace(mistray.load('{name}'), rays=1000).paths"

    def seconds(home: str | None) -> float:
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, **({"HOME": home} if home else {})})
        return time.perf_counter() - start

    with tempfile.TemporaryDirectory() as home:
        cold = seconds(home)
        warm = seconds(home)
    times = f"{cold:.1f} s with an empty kernel cache, {warm:.1f} s after"
    return f"`{name}`, 1000 rays, fresh process to path table: {times}."


def cores_in_use() -> float:
    """CPU time over wall time of a trace: how many cores the machine really gave to the threads."""
    (run,) = prepare(mistray.load("double_gauss"), Settings(rays=1 << 18))
    wall, cpu = time.perf_counter(), time.process_time()
    run.execute(False, None)
    return (time.process_time() - cpu) / (time.perf_counter() - wall)


def _cpu_information() -> list[str]:
    file = Path("/proc/cpuinfo")
    return file.read_text().splitlines() if file.exists() else []


def machine() -> str:
    """The processor, the number of its threads that Dr.Jit uses, and the versions."""
    model = next(
        (line.split(":", 1)[1].strip() for line in _cpu_information() if "model name" in line),
        platform.processor(),
    )
    llvm = ".".join(str(part) for part in dr.detail.llvm_version())
    versions = f"Mitsuba {mi.__version__}, Dr.Jit {dr.__version__}, LLVM {llvm}"
    return f"{model}, {dr.thread_count()} threads, {mi.variant()}, {versions}"


def main() -> None:
    """Run everything, print the table and write it to benchmarks/README.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-write", action="store_true", help="print only")
    arguments = parser.parse_args()
    rows = [
        against_mesh("double_gauss", 1 << 18, 5.0),
        against_mesh("phone_camera", 1 << 14, None),
        against_batoid(50_000, 5.0),
        ledger_cost("double_gauss", 1 << 18, 0.8),
        ledger_cost("phone_camera", 1 << 14, 0.8),
        coating_cost("double_gauss", 1 << 16, 0.8),
        stokes_cost("double_gauss", 1 << 17, 0.5),
        gradient_cost("cooke_triplet", 1 << 16, 2.5),
        gradient_cost("phone_camera", 1 << 12, 2.5),
        *gradient_costs("double_gauss", 200_000),
        *gradient_costs("phone_camera", 10_000),
        *memory("double_gauss", 100_000),
        *(tracing_share("cooke_triplet", rays) for rays in (60_000, 200_000)),
        *thin_films(),
        *scattering_camera(1 << 15),
        *scatter_samples(),
        *pst_costs(),
    ]
    table = ["| compared | mistray | other | ratio | bar |", "|---|---|---|---|---|", *map(str, rows)]
    text = "\n".join(
        [
            "# Benchmarks",
            "",
            "Written by `make bench`. Best of several alternating repeats, kernels compiled before; the ratios count.",
            "",
            f"Machine: {machine()}; {cores_in_use():.1f} cores at work during a trace (batoid uses one).",
            "",
            *table,
            "",
            first_run("phone_camera"),
            "",
            "A segment of the ray tree is more than a ray of the mesh: it includes Snell's law, R and T, the",
            "bookkeeping of energy and the film. The mesh is the one that the plugins give to stock integrators;",
            "its rays are segments of the same tree, sorted by start ray. batoid traces rays without film or ledger.",
            "",
        ]
    )
    print(text)
    if not arguments.no_write:
        (HERE / "README.md").write_text(text)


if __name__ == "__main__":
    main()

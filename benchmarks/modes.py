"""What the path table, coatings and polarisation cost: mistray against itself."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import replace

import mitsuba as mi
import numpy as np
from rows import REPEATS, Row, Timing, alternate

import mistray
from mistray.execute.tracer import prepare
from mistray.prescription import Coating
from mistray.settings import Settings


def coated(name: str, layers: str) -> mi.Scene:
    """A shipped scene with the same stack on every refracting surface."""
    build = importlib.import_module(f"mistray.scenes.{name}.prescription").build
    prescription = build()
    surfaces = tuple(
        s if s.mirror or s.front == s.back else replace(s, coating=Coating(layers=layers))
        for s in prescription.surfaces
    )
    return replace(prescription, surfaces=surfaces).to_scene()


def stack(count: int) -> str:
    """Layers of a coating, drawn at random: n and nm."""
    rng = np.random.default_rng(0)
    return ", ".join(f"{rng.uniform(1.38, 2.2):.4f} {rng.uniform(20.0, 150.0):.2f}" for _ in range(count))


def share_of_speed(key: str, what: str, rays: int, with_it: Timing, without: Timing, bar: float) -> Row:
    """Speed with a feature over speed without."""
    rates = [f"{rays / timing.seconds / 1e3:.1f} k/s" for timing in (with_it, without)]
    return Row(key, f"{what} (start rays/s)", *rates, without.seconds / with_it.seconds, bar)


def ledger_cost(name: str, rays: int, bar: float, repeats: int) -> Row:
    """The path table on and off."""
    scene = mistray.load(name)
    settings = Settings(rays=rays)

    def run(ledger: bool) -> Callable[[], None]:
        def action() -> None:
            (run,) = prepare(scene, settings)
            run.execute(ledger)

        return action

    times = alternate(run(True), run(False), repeats=repeats)
    return share_of_speed(f"ledger-{name}", f"`{name}`: path table on against off", rays, *times, bar)


def coating_cost(name: str, rays: int, bar: float, repeats: int) -> Row:
    """A 40-layer stack on every surface over bare surfaces; nothing is cut, so that both trees are the same."""
    settings = Settings(rays=rays, flux_threshold=0.0)
    stacks, bare = (prepare(one, settings)[0].execute(True) for one in (coated(name, stack(40)), mistray.load(name)))
    times = alternate(lambda: stacks.execute(True), lambda: bare.execute(True), repeats=repeats)
    return share_of_speed("layers", f"`{name}`: 40 layers on every surface against bare", rays, *times, bar)


def stokes_cost(name: str, rays: int, bar: float, repeats: int) -> Row:
    """Polarised light over unpolarised."""
    scene = mistray.load(name)
    modes = (Settings(rays=rays, polarization=mode) for mode in ("stokes", "unpolarized"))
    stokes, plain = (prepare(scene, settings)[0].execute(True) for settings in modes)
    times = alternate(lambda: stokes.execute(True), lambda: plain.execute(True), repeats=repeats)
    return share_of_speed("stokes", f"`{name}`: Stokes vectors against unpolarised", rays, *times, bar)


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `modes`."""
    shift, repeats = (8, 1) if quick else (0, REPEATS)
    yield ledger_cost("double_gauss", 1 << 18 - shift, 0.8, repeats)
    yield ledger_cost("phone_camera", 1 << 14 - shift, 0.8, repeats)
    yield coating_cost("double_gauss", 1 << 16 - shift, 0.8, repeats)
    yield stokes_cost("double_gauss", 1 << 17 - shift, 0.5, repeats)

"""R and T in the kernel, interpolated in tables, against `tmm` from either side and beyond the critical angle."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import tmm
from oracles.small_scenes import scene_text, shape_xml

from mistray.coatings import Layer, Stack
from mistray.kernel.interaction import interact
from mistray.surfaces import optics
from mistray.surfaces.surfaces import SurfaceTable

BOUND = 1e-5
ROUNDING = 4 * 2.0**-24  # of the squared cosine, by float32 directions of unit length
Layers = list[tuple[complex, float]]


def random_stack(rng: np.random.Generator, most: int = 40) -> tuple[Layers, float]:
    """1 to `most` layers, one in four absorbing, and the index of the glass."""
    layers = []
    for _ in range(rng.integers(1, most + 1)):
        k = 10 ** rng.uniform(-4, 0.5) if rng.random() < 0.25 else 0.0
        layers.append((rng.uniform(1.3, 2.4) + 1j * k, rng.uniform(5.0, 200.0)))
    return layers, float(rng.choice([1.0, 1.45, 1.5168, 1.8]))


def scene_with(layers: Layers, glass: float, reverse: bool) -> str:
    """One coated plane; the first layer touches air; glass behind, or in front if `reverse`."""
    text = ", ".join(f"{n.real!r}+{n.imag!r}i {d!r}" for n, d in layers)
    sides = ("air", repr(glass)) if not reverse else (repr(glass), "air")
    bsdf = (
        f'<bsdf type="interface"><string name="front" value="{sides[0]}"/><string name="back" value="{sides[1]}"/>'
        f'<bsdf type="thinfilm"><string name="layers" value="{text}"/>'
        f'<string name="first" value="{"back" if reverse else "front"}"/></bsdf></bsdf>'
    )
    return scene_text(
        shape_xml("asphere", "film", 0.0, bsdf, semi_diameter=5.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=9.0, half_height=9.0),
    )


def kernel(table: SurfaceTable, cosines: np.ndarray, from_front: bool, stokes: bool) -> tuple[np.ndarray, ...]:
    """What the kernel finds at the plane: R, T and in Stokes mode the coefficients of both children."""
    c = mi.Float(cosines)
    s = dr.sqrt(1 - c * c)
    d = mi.Vector3f(s, 0, c if from_front else -c)
    surface = dr.full(mi.UInt32, table.ids.index("film"), len(cosines))
    vector = dr.zeros(mi.Vector3f, len(cosines)) if stokes else None
    it = interact(table, dr.zeros(mi.Vector3f, len(cosines)), d, surface, None, vector, mi.Bool(True))
    if not stokes:
        return np.array(it.R), np.array(it.T)
    assert it.polarized is not None
    return tuple(np.array(m.coefficients) for m in (it.polarized.reflection, it.polarized.transmission))


def oracle(layers: Layers, n_in: float, n_out: float, cosines: np.ndarray) -> np.ndarray:
    """(8, m): R, T of s and of p; real and imaginary parts of r_s r_p* and of the same for T."""
    values = []
    for c in cosines.astype(float):
        angle = np.arccos(c)
        both = []
        for pol in "sp":
            index, d = [n_in, *(n for n, _ in layers), n_out], [np.inf, *(t for _, t in layers), np.inf]
            both.append(tmm.coh_tmm(pol, index, d, angle, 550.0))
        s, p = both
        product = s["r"] * np.conj(p["r"])
        through = s["t"] * np.conj(p["t"])
        size = np.sqrt(max(s["T"] * p["T"], 0.0))
        through = size * through / abs(through) if abs(through) > 0 else 0j
        values.append([s["R"], p["R"], s["T"], p["T"], product.real, product.imag, through.real, through.imag])
    return np.array(values).T


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_random_stacks(load_scene, seed) -> None:
    rng = np.random.default_rng(seed)
    layers, glass = random_stack(rng)
    for reverse in (False, True):
        scene = load_scene(scene_with(layers, glass, reverse))
        for stokes in (False, True):
            table = SurfaceTable(scene, 550.0, stokes=stokes)
            for from_front in (True, False):
                in_air = from_front != reverse
                n_in, n_out = (1.0, glass) if in_air else (glass, 1.0)
                ordered = layers if in_air else layers[::-1]
                cosines = rng.uniform(np.cos(np.radians(89.9)), 1.0, 20).astype(np.float32)
                expected = oracle(ordered, n_in, n_out, cosines)
                # What a change of the cosine's square by a few float32 roundings does: the angle is not known better
                square = cosines.astype(float) ** 2
                near = [np.sqrt(np.clip(square + step, 0, 1)) for step in (-ROUNDING, ROUNDING)]
                allowed = sum(np.abs(oracle(ordered, n_in, n_out, c) - expected) for c in near)
                total = (n_in / n_out) ** 2 * (1 - square) >= 1
                made = table.optics.tables[table.ids.index("film")]
                assert made is not None
                assert made.refraction_error <= BOUND / 5
                allowed += np.where(total, max(BOUND, made.total_error), BOUND)
                found = kernel(table, cosines, from_front, stokes)
                if stokes:
                    found = (*found[0][:2], *found[1][:2], *found[0][2:], *found[1][2:])
                    for k, row in enumerate(found):
                        assert np.all(np.abs(row - expected[k]) < allowed[k]), (k, stokes, from_front, reverse)
                else:
                    for row, pair in zip(found, ([0, 1], [2, 3]), strict=True):
                        error = np.abs(row - expected[pair].mean(axis=0))
                        assert np.all(error < allowed[pair].mean(axis=0)), (pair, from_front, reverse)


def test_a_film_of_a_file_that_changes_is_tabulated_again(tmp_path: Path) -> None:
    """In one process, under the same name: the disk cache would keep the old numbers as those of the new file."""
    stack = Stack((Layer(str(tmp_path / "film.csv"), 99.6),), "front")
    shares = []
    for n in (1.38, 2.3, 2.3):
        (tmp_path / "film.csv").write_text(f"wavelength_nm,n,k\n400,{n},0\n700,{n:.6f},0\n")
        known = optics.angle_table(stack, 550.0, 1 + 0j, 1.5 + 0j, False, False)
        there = stack.response(550.0, 1 + 0j, 1.5 + 0j, np.ones(1), True).R.mean()
        assert known.refraction[-1, optics.REFLECTION_FRONT, 0] == pytest.approx(there, rel=1e-9)
        shares.append(there)
    assert shares[0] < 0.05 < shares[1]
    assert shares[1] == shares[2]
    assert optics.angle_table(stack, 550.0, 1 + 0j, 1.5 + 0j, False, False) is known, "evaluated once"

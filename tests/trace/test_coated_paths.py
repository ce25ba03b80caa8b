"""Rays of a coated lens, event by event, against `tmm` and Beer-Lambert in float64, with and without Stokes vectors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from oracles.glass import absorption_per_mm, refractive_index
from oracles.polarized import Hit, amplitudes, transport

import mistray
from mistray.prescription import Coating
from mistray.scenes.cooke_triplet.prescription import build

WAVELENGTH_NM = 520.0
# From the air side; the second one absorbs
STACKS = {
    "clear": ((1.38 + 0j, 95.0), (2.1 + 0j, 120.0), (1.63 + 0j, 80.0)),
    "absorbing": ((1.46 + 0j, 60.0), (2.3 + 0.05j, 40.0), (0.2 + 3.1j, 4.0), (1.8 + 0j, 150.0)),
}
SIDES = {s.name: (s.front, s.back) for s in build().surfaces}


@pytest.fixture(scope="module", params=list(STACKS))
def coated(request: pytest.FixtureRequest) -> tuple[Any, tuple[tuple[complex, float], ...]]:
    stack = STACKS[request.param]
    text = ", ".join(f"{n.real!r}+{n.imag!r}i {d!r}" for n, d in stack)
    prescription = build()
    surfaces = tuple(replace(s, coating=Coating(layers=text)) for s in prescription.surfaces)
    return replace(prescription, surfaces=surfaces).to_scene(), stack


def events_of(row: Any, ray: Any, stack: tuple[tuple[complex, float], ...]) -> tuple[list[Hit], np.ndarray]:
    """The hits of a recorded ray and what the glass leaves of the flux up to each of them and the detector."""
    points = ray[["x_mm", "y_mm", "z_mm"]].to_numpy()
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    hits, left, medium = [], [], "air"
    for (name, kind), length in zip((event.split(":") for event in row.events.split()), lengths, strict=True):
        left.append(np.exp(-absorption_per_mm(medium, WAVELENGTH_NM) * length))
        if kind == "A":
            break
        front, back = SIDES[name]
        other = back if medium == front else front
        index = [complex(refractive_index(m, WAVELENGTH_NM)) for m in (medium, other)]
        hits.append(Hit(kind, *index, layers=stack if medium == "air" else stack[::-1]))
        medium = other if kind == "T" else medium
    return hits, np.cumprod(left)


@pytest.mark.long
@pytest.mark.parametrize("polarization", ["unpolarized", "stokes"])
@pytest.mark.parametrize("field_deg", [0.0, 18.0])
def test_flux_along_the_way(coated, polarization, field_deg) -> None:
    """Each share to 1e-5, and R of a few 1e-4 to 4e-6: the tables are good to 1e-6, float32 angles do the rest."""
    scene, stack = coated
    t = mistray.trace(
        scene, rays=4000, field_deg=field_deg, wavelength_nm=WAVELENGTH_NM, polarization=polarization, flux_threshold=0
    )
    kinds = set()
    for row in t.paths[:8]:
        table = t.history(row.path_id, n=3).to_pandas()
        for number in table.ray.unique():
            ray = table[table.ray == number]
            directions = ray[["dx", "dy", "dz"]].to_numpy()[:-1]
            hits, left = events_of(row, ray, stack)
            if polarization == "stokes":
                flux, _ = transport(directions, hits, WAVELENGTH_NM)
            else:
                shares = []
                for hit, before, after in zip(hits, directions[:-1], directions[1:], strict=True):
                    reflected = hit.kind != "T"
                    normal = after - before if reflected else hit.n_out.real * after - hit.n_in.real * before
                    cosine = abs(float(before @ normal)) / np.linalg.norm(normal)
                    shares.append(np.mean(np.abs(amplitudes(hit, cosine, WAVELENGTH_NM)) ** 2))
                flux = np.cumprod(shares)
            measured = ray.flux_W.to_numpy()
            expected = np.concatenate([[1.0], flux]) * left
            shares = expected[1:] / expected[:-1]
            found = measured[2:] / measured[1:-1]
            np.testing.assert_allclose(found, shares, rtol=1e-5, atol=4e-6, err_msg=row.events)
            kinds.add(row.kind)
    assert kinds == {"direct", "ghost"}

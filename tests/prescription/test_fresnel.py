"""Fresnel lenses: each ring images as the lens that it is cut from, displaced by its set-back."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.prescription import Coating, Detector, Prescription, Source, Structure, Surface, fresnel
from mistray.trace import trace

INDEX, FOCUS, SIZE, THICK, GROOVE = 1.5, 60.0, 20.0, 3.0, 4.0
CONIC, RADIUS = -(INDEX**2), -FOCUS * (INDEX - 1)  # plane face ahead: a hyperboloid without spherical aberration


def lens(**more: float) -> Prescription:
    """Collimated light through a plane face, then through rings of the hyperboloid; the rim absorbs."""
    glass = f"{INDEX}"
    rings = fresnel(
        "fresnel", radius=RADIUS, conic=CONIC, semi_diameter=SIZE, z=THICK, front=glass, coating=Coating(R=0.0, T=1.0),
        riser=Coating(R=0.0), **(more or {"groove_mm": GROOVE}),
    )  # fmt: skip
    surfaces = tuple(face for face in rings if isinstance(face, Surface))
    end = float(surfaces[-1].z_at(SIZE))
    return Prescription(
        name="Fresnel lens",
        surfaces=(Surface("plane", semi_diameter=SIZE, back=glass, coating=Coating(R=0.0, T=1.0)), *surfaces),
        structures=(
            *(face for face in rings if isinstance(face, Structure)),
            Structure("rim", SIZE, 0.0, SIZE, end, front=glass),
        ),
        detector=Detector(z=THICK + FOCUS, half_width=15.0, half_height=15.0, pixels=(32, 32)),
        source=Source(radius=SIZE, distance=10.0, wavelength_nm=(550.0,)),
    )


def sag_of(r: np.ndarray | float) -> np.ndarray:
    c = 1 / RADIUS
    return np.asarray(c * np.square(r) / (1 + np.sqrt(1 - (1 + CONIC) * c * c * np.square(r))))


def test_spots_of_the_rings() -> None:
    """Ring k and its focus lie set back: the spot follows from straight lines; 4 SE of 10⁵ rays are 1 %."""
    found = trace(lens().to_scene(), rays=100_000, seed=1)
    rows = {row.events: row for row in found.paths}
    edges = [*np.arange(0, SIZE, GROOVE), SIZE]
    total = 0.0
    for k, (inner, outer) in enumerate(pairwise(edges), start=1):
        row = rows[f"plane:T fresnel_{k}:T detector:A"]
        r = np.sqrt(np.linspace(inner**2, outer**2, 2001))
        back = -float(sag_of(inner))
        start = THICK + back + sag_of(r)
        height = r * (THICK + back + FOCUS - (THICK + FOCUS)) / (THICK + back + FOCUS - start)
        assert row.rms_radius_mm == pytest.approx(math.sqrt(np.mean(height**2)), rel=0.01, abs=1e-4)
        total += row.power_W
    # Behind the rings light turns inward, away from the risers: none is lost
    assert total == pytest.approx(found.energy.launched_W, rel=1e-4)
    assert abs(found.energy.closure) < 1e-6 * found.energy.launched_W
    assert found.energy.escaped_W < 1e-6 * found.energy.launched_W


def test_rings_of_equal_depth() -> None:
    faces = fresnel("f", radius=RADIUS, conic=CONIC, semi_diameter=SIZE, depth_mm=0.5, front="1.5")
    risers = [face for face in faces if isinstance(face, Structure)]
    assert len(risers) == math.ceil(abs(float(sag_of(SIZE))) / 0.5) - 1
    for riser in risers:
        assert riser.z1 - riser.z0 == pytest.approx(-0.5, abs=1e-6)
        assert (riser.front, riser.back) == ("air", "1.5")
    (first, *_, last) = (face for face in faces if isinstance(face, Surface))
    assert first.inner_semi_diameter == 0
    assert last.semi_diameter == SIZE
    assert last.z_at(last.inner_semi_diameter) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({}, "no width of its rings; give groove_mm or depth_mm"),
        ({"groove_mm": 1.0, "depth_mm": 1.0}, "groove_mm and depth_mm; give"),
        ({"groove_mm": 0.0}, "groove_mm = 0 mm"),
        ({"groove_mm": 1e-9}, "rings; make them wider"),
        ({"groove_mm": 1.0, "semi_diameter": -1.0}, "semi_diameter = -1 mm"),
        ({"groove_mm": 1.0, "conic": 3.0}, "its conic ends within 20 mm"),
        ({"depth_mm": 1.0, "radius": math.inf}, "0 rings"),
    ],
)
def test_bad_numbers_are_one_line(numbers: dict[str, float], message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        fresnel("f", **{"radius": RADIUS, "semi_diameter": SIZE, **numbers})

"""Stokes vectors along skew paths, against closed forms and against field vectors in float64."""

import numpy as np
import pytest
from oracles.closed_forms import fresnel
from oracles.polarized import transport
from oracles.skew_path import Face, skew_path
from oracles.small_scenes import plates_text

import mistray

pytestmark = pytest.mark.quick

TOTAL_45 = {"unpolarized": 0.9043267914588886, "stokes": 0.9073443298016289}


class TestPlateAt45Degrees:
    @pytest.mark.core
    @pytest.mark.parametrize("polarization", ["unpolarized", "stokes"])
    @pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 90.0, 217.0])
    def test_transmittance(self, load_text, polarization, azimuth_deg) -> None:
        """n = 1.5, all orders: 0.9073443 where s and p are kept apart, 0.9043268 where they are mixed at every hit;
        behind m reflections and two refractions (p - s)/(p + s) with s = T_s² R_s^m, p likewise."""
        settings = {"field_deg": 45.0, "azimuth_deg": azimuth_deg, "max_reflections": 10, "flux_threshold": 0.0}
        t = mistray.trace(load_text(plates_text(1))[0], rays=64, polarization=polarization, **settings)
        assert t.energy.detected_W / t.energy.launched_W == pytest.approx(TOTAL_45[polarization], abs=1e-6)
        assert abs(t.energy.closure) < 1e-6
        assert np.isnan(t.paths[0].polarization) == (polarization == "unpolarized")  # it does not pretend
        assert [row.order for row in t.paths[:3]] == [0, 2, 4]
        for row in t.paths[:3] if polarization == "stokes" else ():
            s, p = ((1 - r) ** 2 * r**row.order for r in fresnel(45.0, 1.5))
            assert row.power_W / t.energy.launched_W == pytest.approx((s + p) / 2, rel=3e-6)
            assert row.polarization == pytest.approx(abs(s - p) / (s + p), abs=3e-6)
            assert row.polarization_se < 1e-6

    def test_many_plates_polarize(self, load_text) -> None:
        """A pile of plates at Brewster's angle lets p pass whole: T_p = 1, the rest is s."""
        brewster = np.degrees(np.arctan(1.5))
        settings = {"field_deg": brewster, "max_reflections": 0, "polarization": "stokes"}
        t = mistray.trace(load_text(plates_text(4))[0], rays=16, **settings)
        r_s = ((1.5**2 - 1) / (1.5**2 + 1)) ** 2
        s = (1 - r_s) ** 8
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx((1 + s) / 2, rel=3e-6)
        assert t.paths[0].polarization == pytest.approx((1 - s) / (1 + s), abs=3e-6)


GLASS = 1.7
# The angle of incidence is known to a few float32 roundings of its cosine, 2e-7, which a reflection of a few per cent
# multiplies by |d ln R / d cos θ| < 10
WEAK = 2e-6


@pytest.mark.parametrize(
    ("angles_deg", "kinds"),
    [
        ([(35, 10), (30, 75), (50, 140)], "TTT"),  # skew refractions
        ([(40, 20), (25, 100), (30, 215), (20, 300)], "TRRT"),
        ([(45, 0), (50, 40), (60, 110), (30, 70)], "TIIT"),  # total reflections retard
        ([(45, 80), (30, 200), (48, 130), (15, 250)], "TRIT"),
    ],
)
def test_rays_of_skew_paths(load_scene, angles_deg, kinds) -> None:
    inside, faces = 1.0, []
    for (incidence, azimuth), kind in zip(angles_deg, kinds, strict=True):
        behind = GLASS if inside == 1.0 else 1.0
        faces.append(Face(incidence, azimuth, kind, behind))
        inside = behind if kind == "T" else inside
    path = skew_path(faces)
    t = mistray.trace(load_scene(path.text), rays=32, max_reflections=4, flux_threshold=0.0, polarization="stokes")
    (row,) = t.paths.find(*path.events)
    assert row.path == kinds + "A"
    flux, degree = transport(path.directions, path.hits, 550.0)
    for _, ray in t.history(row.path_id, n=2).to_pandas().groupby("ray"):
        measured = ray.flux_W.to_numpy()
        np.testing.assert_allclose(measured[2:] / measured[0], flux, rtol=WEAK, atol=1e-9)
    assert degree > 0.02
    assert row.polarization == pytest.approx(degree, abs=WEAK)

"""Beer-Lambert along the way: closed forms, and every loss in the ledger under its medium."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_z

import mistray

pytestmark = pytest.mark.quick

TAU = 0.9  # of 5 mm at 550 nm
K = float(-np.log(TAU) * 550e-6 / (4 * np.pi * 5.0))
DARK = f"1.5+{K!r}i"


def coated_plate() -> str:
    text = plates_text(1, index=DARK, R=0.02, T=0.98)
    rear = interface_xml(DARK, "air", R=0.02, T=0.98)
    assert rear in text
    return text.replace(rear, interface_xml(DARK, "air", R=0.05, T=0.95))


class TestPlate:
    @pytest.mark.parametrize("how", [{}, {"splitting": "one"}, {"polarization": "stokes"}])
    def test_all_orders(self, load_scene, how: dict[str, str]) -> None:
        """T = (1-R1)(1-R2)τ/(1-R1R2τ²), R = R1 + (1-R1)²R2τ²/(1-R1R2τ²), the rest stays in the glass."""
        settings = {"rays": 20_000, "max_reflections": 12, "flux_threshold": 0.0}
        e = mistray.trace(load_scene(coated_plate()), **settings, **how).energy
        many = 1 - 0.02 * 0.05 * TAU**2
        through = 0.98 * 0.95 * TAU / many
        back = 0.02 + 0.98**2 * 0.05 * TAU**2 / many
        assert through == pytest.approx(0.8385792491918453, rel=1e-12)
        # False-alarm probability of what is sampled: 4.5 σ, 7e-6
        assert_z("T", e.detected_W / e.launched_W, through, e.detected_se_W / e.launched_W, k=4.5, floor=2e-6 * through)
        assert_z("R", e.escaped_W / e.launched_W, back, e.escaped_se_W / e.launched_W, k=4.5, floor=1e-5 * back)
        assert set(e.absorbed_in) == {DARK}
        (value, se), stays = e.absorbed_in[DARK], 1 - through - back
        assert_z("absorbed", value / e.launched_W, stays, se / e.launched_W, k=4.5, floor=1e-5 * stays)
        assert "splitting" in how or se / e.launched_W < 1e-6
        assert sum(v for v, _ in e.absorbed.values()) == pytest.approx(0, abs=1e-6)
        assert abs(e.closure) < 1e-6
        assert f"absorbed in {DARK}" in str(e)

    def test_slanted_in_two_wavelengths(self, load_scene) -> None:
        """The way through the plate is 5 mm/cos θ', and the same k absorbs more at a shorter wavelength: τ^(550/λ)."""
        settings = {"wavelength_nm": [400.0, 550.0], "field_deg": 40.0, "max_reflections": 0}
        t = mistray.trace(load_scene(coated_plate()), rays=900, **settings)
        way = 1 / np.sqrt(1 - (np.sin(np.radians(40)) / 1.5) ** 2)
        for wavelength in (400.0, 550.0):
            (row,) = (row for row in t.paths if row.wavelength_nm == wavelength)
            expected = 0.98 * 0.95 * TAU ** (way * 550 / wavelength)
            assert row.power_W / (t.energy.launched_W / 2) == pytest.approx(expected, rel=3e-6)
            assert abs(t.energy_at(wavelength).closure) < 1e-6
        total = sum(t.energy_at(w).absorbed_in[DARK][0] for w in (400.0, 550.0))
        assert t.energy.absorbed_in[DARK][0] == pytest.approx(total, rel=1e-12)


def test_light_stays_in_the_medium_at_an_opaque_wall(load_scene) -> None:
    """A painted rear face (R = 0.6) sends the light back through the glass: 1 - τ and again R τ (1 - τ)."""
    text = scene_text(
        shape_xml("asphere", "front", 0.0, interface_xml("air", DARK, R=0.0, T=1.0), semi_diameter=20.0),
        shape_xml("asphere", "paint", 5.0, interface_xml(R=0.6), semi_diameter=20.0),
        shape_xml("asphere", "detector", 50.0, sensor=True, half_width=5.0, half_height=5.0),
    )
    e = mistray.trace(load_scene(text), rays=100).energy
    assert e.absorbed_in[DARK][0] / e.launched_W == pytest.approx((1 - TAU) * (1 + 0.6 * TAU), rel=1e-5)
    assert e.absorbed["paint"][0] / e.launched_W == pytest.approx(TAU * 0.4, rel=1e-5)
    assert e.escaped_W / e.launched_W == pytest.approx(TAU**2 * 0.6, rel=1e-5)
    assert abs(e.closure) < 1e-6


def test_history_and_replay_know_the_loss(load_scene) -> None:
    t = mistray.trace(load_scene(coated_plate()), rays=100, max_reflections=2)
    (ghost,) = (row for row in t.paths if row.order == 2)
    flux = t.history(ghost.path_id, n=1).to_pandas().flux_W.to_numpy()
    factors = [1, 1, 0.98 * TAU, 0.05 * TAU, 0.02 * TAU, 0.95]
    np.testing.assert_allclose(flux / flux[0], np.cumprod(factors), rtol=3e-6)


def test_metal_takes_what_it_does_not_reflect(load_scene) -> None:
    """A mirror of a metal: R of Fresnel with n + ik, the rest absorbed at the surface, nothing behind."""
    n = 0.958 + 6.69j
    text = scene_text(
        shape_xml("asphere", "mirror", 0.0, interface_xml("air", "0.958+6.69i"), semi_diameter=20.0),
        shape_xml("asphere", "detector", 50.0, sensor=True, half_width=5.0, half_height=5.0),
    )
    for field in (0.0, 60.0):
        e = mistray.trace(load_scene(text), rays=100, field_deg=field).energy
        c = np.cos(np.radians(field))
        q = np.sqrt(n * n - np.sin(np.radians(field)) ** 2)
        r_s, r_p = (c - q) / (c + q), (n * n * c - q) / (n * n * c + q)
        R = (abs(r_s) ** 2 + abs(r_p) ** 2) / 2
        assert e.absorbed["mirror"][0] / e.launched_W == pytest.approx(1 - R, abs=2e-6)
        assert e.escaped_W / e.launched_W == pytest.approx(R, abs=2e-6)
        assert abs(e.closure) < 1e-6

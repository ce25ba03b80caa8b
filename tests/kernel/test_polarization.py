"""Stokes vectors along skew paths, against closed forms and against field vectors in float64."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.polarized import Hit, transport
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml

import mistray

pytestmark = pytest.mark.quick

TOTAL_45 = {"unpolarized": 0.9043267914588886, "stokes": 0.9073443298016289}


def fresnel_45(n: float = 1.5) -> tuple[float, float]:
    c, cos_t = np.sqrt(0.5), np.sqrt(1 - 0.5 / n**2)
    return ((c - n * cos_t) / (c + n * cos_t)) ** 2, ((n * c - cos_t) / (n * c + cos_t)) ** 2


class TestPlateAt45Degrees:
    @pytest.mark.parametrize("polarization", ["unpolarized", "stokes"])
    @pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 90.0, 217.0])
    def test_transmittance(self, load_text, polarization, azimuth_deg) -> None:
        """n = 1.5, all orders: 0.9073443 where s and p are kept apart, 0.9043268 where they are mixed at every hit."""
        t = mistray.trace(
            load_text(plates_text(1))[0], rays=64, field_deg=45.0, azimuth_deg=azimuth_deg, max_reflections=10,
            flux_threshold=0.0, polarization=polarization,
        )  # fmt: skip
        assert t.energy.detected_W / t.energy.launched_W == pytest.approx(TOTAL_45[polarization], abs=1e-6)
        assert abs(t.energy.closure) < 1e-6

    def test_degree_of_polarization(self, load_text) -> None:
        """Behind m reflections and two refractions: (p - s)/(p + s) with s = T_s² R_s^m, p likewise."""
        t = mistray.trace(
            load_text(plates_text(1))[0], rays=64, field_deg=45.0, azimuth_deg=30.0, max_reflections=4,
            flux_threshold=0.0, polarization="stokes",
        )  # fmt: skip
        r_s, r_p = fresnel_45()
        assert [row.order for row in t.paths] == [0, 2, 4]
        for row in t.paths:
            s, p = ((1 - r) ** 2 * r**row.order for r in (r_s, r_p))
            assert row.power_W / t.energy.launched_W == pytest.approx((s + p) / 2, rel=3e-6)
            assert row.polarization == pytest.approx(abs(s - p) / (s + p), abs=3e-6)
            assert row.polarization_se < 1e-6

    def test_unpolarized_traces_do_not_pretend(self, load_text) -> None:
        t = mistray.trace(load_text(plates_text(1))[0], rays=64, field_deg=45.0)
        assert np.isnan(t.paths[0].polarization)

    def test_many_plates_polarize(self, load_text) -> None:
        """A pile of plates at Brewster's angle lets p pass whole: T_p = 1, the rest is s."""
        brewster = np.degrees(np.arctan(1.5))
        t = mistray.trace(
            load_text(plates_text(4))[0], rays=16, field_deg=brewster, max_reflections=0, polarization="stokes"
        )
        r_s = ((1.5**2 - 1) / (1.5**2 + 1)) ** 2
        s = (1 - r_s) ** 8
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx((1 + s) / 2, rel=3e-6)
        assert t.paths[0].polarization == pytest.approx((1 - s) / (1 + s), abs=3e-6)


GLASS = 1.7


def skew_path(angles_deg: list[tuple[float, float]], kinds: str, gap: float = 20.0) -> tuple[str, list[Hit]]:
    """Planes along a ray that starts along z in air; angle of incidence and azimuth of its plane at each."""

    def plane(name: str, at: np.ndarray, normal: np.ndarray, bsdf: str, half: float, sensor: bool) -> str:
        helper = np.eye(3)[np.argmin(np.abs(normal))]
        x = np.cross(helper, normal) / np.linalg.norm(np.cross(helper, normal))
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([x, np.cross(normal, x), normal, at])
        text = shape_xml("asphere", name, 0.0, bsdf, sensor, half_width=half, half_height=half)
        return text.replace('<translate z="0.0"/>', f'<matrix value="{" ".join(map(repr, matrix.ravel().tolist()))}"/>')

    d, point, inside = np.array([0.0, 0.0, 1.0]), np.zeros(3), 1.0
    shapes, hits = [], []
    for number, (angles, kind) in enumerate(zip(angles_deg, kinds, strict=True)):
        incidence, azimuth = np.radians(angles)
        a = np.cross(d, np.eye(3)[np.argmin(np.abs(d))])
        a /= np.linalg.norm(a)
        across = np.cos(azimuth) * a + np.sin(azimuth) * np.cross(d, a)
        normal = np.cos(incidence) * d + np.sin(incidence) * across
        other = GLASS if inside == 1.0 else 1.0
        shapes.append(plane(f"face_{number}", point, normal, interface_xml(str(inside), str(other)), 5.0, False))
        hits.append(Hit(kind, complex(inside), complex(other)))
        cosine, eta = d @ normal, inside / other
        if kind == "T":
            d = eta * d + (np.sqrt(1 - eta**2 * (1 - cosine**2)) - eta * cosine) * normal
            inside = other
        else:
            d = d - 2 * cosine * normal
        point = point + gap * d
    shapes.append(plane("detector", point, d, interface_xml(R=0.0), 5.0, True))
    return scene_text(*shapes, radius=0.01), hits


class TestSkewPaths:
    """Flux and degree of polarisation of rays whose planes of incidence all differ, against field vectors."""

    @pytest.mark.parametrize(
        ("angles_deg", "kinds"),
        [
            ([(35, 10), (30, 75), (50, 140)], "TTT"),  # skew refractions
            ([(40, 20), (25, 100), (30, 215), (20, 300)], "TRRT"),
            ([(45, 0), (50, 40), (60, 110), (30, 70)], "TIIT"),  # total reflections retard
            ([(45, 80), (30, 200), (48, 130), (15, 250)], "TRIT"),
        ],
    )
    def test_rays(self, load_scene, angles_deg, kinds) -> None:
        text, hits = skew_path(angles_deg, kinds)
        t = mistray.trace(load_scene(text), rays=32, max_reflections=4, flux_threshold=0.0, polarization="stokes")
        (row,) = t.paths.find(*(f"face_{k}:{kind}" for k, kind in enumerate(kinds)), "detector:A")
        assert row.path == kinds + "A"
        history = t.history(row.path_id, n=2)
        table = history.to_pandas()
        for number in range(len(history)):
            ray = table[table.ray == number]
            flux, degree = transport(ray[["dx", "dy", "dz"]].to_numpy()[:-1], hits, 550.0)
            measured = ray.flux_W.to_numpy()
            np.testing.assert_allclose(measured[2:] / measured[0], flux, rtol=1e-5)
        assert degree > 0.02
        assert row.polarization == pytest.approx(degree, abs=2e-5)

    def test_it_matters(self, load_scene) -> None:
        """The same skew path without memory is wrong by more than the tolerance above, so the test can fail."""
        text, _ = skew_path([(40, 20), (25, 100), (30, 215), (20, 300)], "TRRT")
        powers = [
            mistray.trace(load_scene(text), rays=32, max_reflections=4, flux_threshold=0.0, polarization=p).paths
            for p in ("unpolarized", "stokes")
        ]
        a, b = (paths.find(*(f"face_{k}:{kind}" for k, kind in enumerate("TRRT")))[0].power_W for paths in powers)
        assert abs(a / b - 1) > 1e-2

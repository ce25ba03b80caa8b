"""Rings that diffract, traced: within 3 standard errors of the far field of a round aperture (2.7e-3 each)."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import vectors
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.statistics import assert_z
from scipy.integrate import quad

import mistray

Load = Callable[[str], Any]
FAR = 20_000.0  # mm


def vector(theta: float) -> Any:
    table = vectors.frame("diffraction_circular.csv")
    (row,) = table[(table.lambda_mm == 0.55e-3) & (table.theta_rad == theta)].itertuples()
    return row


def ring_xml(radius: float, width: float, law: str = "half_plane") -> str:
    mean = width * (1 - width / (2 * radius))
    bsdf = scattering_xml([bsdf_xml("edge_diffraction", width_mm=mean, law=law)], R=0.0, T=1.0)
    return placed_xml("frustum", "edge", bsdf, r0=radius - width, z0=0.0, r1=radius, z1=0.0)


def stop_xml(radius: float, outer: float) -> str:
    return placed_xml("frustum", "stop", r0=radius, z0=0.0, r1=outer, z1=0.0)


def far_field(load: Load, radius: float, width: float, theta: float, law: str = "half_plane", **settings: Any) -> Any:
    sine, cosine = math.sin(theta), math.cos(theta)
    half = 0.01 * FAR * theta
    place = {"at": (FAR * sine, 0.0, FAR * cosine), "facing": (sine, 0.0, cosine)}
    detector = placed_xml("asphere", "detector", pixels=4, half_width=half, half_height=half, **place)
    beam = beam_xml(1.2 * radius, power=1.44)  # 1 W meets the opening
    scene = load(scatter_scene(beam, ring_xml(radius, width, law), stop_xml(radius, 1.3 * radius), detector))
    found = mistray.trace(scene, **{"rays": 400_000, "scatter_threshold": 0.0, **settings})
    solid_angle = 4 * half**2 / FAR**2
    return found.energy.detected_W / solid_angle, found.energy.detected_se_W / solid_angle


@pytest.mark.parametrize("theta", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("width", [0.05, 0.3])
def test_aperture(load_scene: Load, width: float, theta: float) -> None:
    """Intensity off axis for two widths of the ring, which does not matter."""
    row = vector(theta)
    value, se = far_field(load_scene, row.radius_mm, width, theta, seed=1)
    assert se < 0.02 * row[5]
    assert_z(f"ring of {width} mm at {theta} rad", value, row[5], se, k=3.0, floor=2e-3 * row[5])


def test_heisenberg_is_higher(load_scene: Load) -> None:
    row = vector(0.1)
    value, se = far_field(load_scene, row.radius_mm, 0.3, 0.1, "heisenberg", seed=2)
    assert_z("Heisenberg", value, math.sqrt(math.pi / 2) * row[5], se, k=3.0, floor=2e-3 * row[5])
    assert abs(value - row[5]) > 8 * se, "the two laws can be told apart"


@pytest.mark.parametrize("settings", [{"aim": "none"}, {"aim": "none", "splitting": "one"}, {"splitting": "one"}])
def test_however_it_is_sampled(load_scene: Load, settings: dict[str, Any]) -> None:
    """Flux on a ring of the far screen, λ/(π² a) (cot θ1 - cot θ2)."""
    low, high = 0.01, 0.03
    ring = {"semi_diameter": FAR * math.tan(high), "inner_semi_diameter": FAR * math.tan(low)}
    detector = placed_xml("asphere", "detector", at=(0, 0, FAR), pixels=4, **ring)
    scene = load_scene(scatter_scene(beam_xml(6.0, power=1.44), ring_xml(5.0, 0.3), stop_xml(5.0, 6.5), detector))
    found = mistray.trace(scene, rays=2_000_000, scatter_threshold=0.0, seed=3, **settings)
    expected = 0.55e-3 / (math.pi**2 * 5.0) * (1 / math.tan(low) - 1 / math.tan(high))
    value, se = found.energy.detected_W, found.energy.detected_se_W
    assert se < 0.06 * expected
    assert_z("flux", value, expected, se, k=3.0, floor=2e-3 * expected)


def test_energy(load_scene: Load) -> None:
    """A ring on an otherwise empty screen: all light is deflected, the books are closed."""
    screen = placed_xml("asphere", "detector", at=(0, 0, 100.0), pixels=4, semi_diameter=1000.0)
    scene = load_scene(scatter_scene(beam_xml(5.0, power=1.0), ring_xml(5.0, 0.5), stop_xml(5.0, 6.0), screen))
    found = mistray.trace(scene, rays=200_000, aim="none", seed=4)
    (row,), share = found.paths.find("edge:t"), 1 - 0.9**2
    # all but 1e-3, the angles beyond the screen
    assert_z("diffracted", row.power_W, share, row.power_se_W, k=3.0, floor=1.5e-3 * share)
    assert abs(found.energy.closure) < 1e-6


class TestPst:
    """A stop at the end of a black tube, a small detector at its other end: oblique light, both ways round."""

    RADIUS, LENGTH, HALF, TUBE = 5.0, 20.0, 0.5, 50.0
    ANGLES, CELL = (25.0, 35.0, 45.0, 60.0), 10.0  # no direct light

    def scene(self, load: Load, width: float) -> Any:
        size = {"half_width": self.HALF, "half_height": self.HALF}
        tube = placed_xml("frustum", "tube", r0=self.TUBE, z0=0.0, r1=self.TUBE, z1=self.LENGTH + 1)
        end = placed_xml("asphere", "detector", at=(0, 0, self.LENGTH), pixels=4, **size)
        ring, stop = ring_xml(self.RADIUS, width), stop_xml(self.RADIUS, self.TUBE)
        return load(scatter_scene(beam_xml(6.0), ring, stop, tube, end))

    def expected(self, angle: float, width: float) -> float:
        """The BSDF in direction cosines, integrated over ring, detector and cell."""
        nodes, weights = np.polynomial.legendre.leggauss(6)
        # Axes: field angle, azimuth and radius on the ring, x and y on the detector
        theta = np.radians(angle + 0.5 * self.CELL * nodes).reshape(-1, 1, 1, 1, 1)
        in_cell = weights.reshape(theta.shape) * np.sin(theta)
        azimuth = (np.arange(64) * np.pi / 32).reshape(1, -1, 1, 1, 1)
        radius = (self.RADIUS + 0.5 * width * (nodes - 1)).reshape(1, 1, -1, 1, 1)
        on_ring = np.pi / 64 * width * weights.reshape(radius.shape) * radius
        x, y = self.HALF * nodes.reshape(-1, 1), self.HALF * nodes
        on_detector = 0.25 * weights[:, None] * weights
        to = np.stack(np.broadcast_arrays(x - radius * np.cos(azimuth), y - radius * np.sin(azimuth), self.LENGTH))
        distance = np.linalg.norm(to, axis=0)
        beta_s, cos_s = to[:2] / distance, self.LENGTH / distance
        beta_i = np.stack([np.sin(theta), 0 * theta])
        r = np.linalg.norm(beta_s - beta_i, axis=0)
        area_over_edge = width * (1 - width / (2 * self.RADIUS))
        law = 0.55e-3 / (4 * np.pi**3 * area_over_edge * r**3) * (1 - np.sum(beta_i * beta_s, axis=0))
        irradiance = law * cos_s / distance**2  # the BSDF is law / (cos_i cos_s)
        return float(np.sum(in_cell * on_ring * on_detector * irradiance) / np.sum(in_cell))

    def test_far_field(self) -> None:
        """The expectation is right: far away it is λ a/(2π² sin³θ D²), the aperture's by reciprocity."""
        far = TestPst()
        far.LENGTH = 1e4  # type: ignore[misc]
        low, high = np.radians([20, 30])
        mean = quad(lambda t: math.sin(t) ** -2, low, high)[0] / (math.cos(low) - math.cos(high))
        closed = 0.55e-3 * far.RADIUS / (2 * math.pi**2 * far.LENGTH**2) * mean
        assert far.expected(25.0, 0.1) == pytest.approx(closed, rel=1e-4)

    @pytest.mark.parametrize(
        ("method", "rays", "width"),
        [("adjoint", 20_000_000, 0.25), ("adjoint", 15_000_000, 0.5), ("forward", 600_000, 0.5)],
    )
    def test_oblique_light(self, load_scene: Load, method: str, rays: int, width: float) -> None:
        settings = {"wavelength_nm": 550.0, "cell_deg": self.CELL, "rays": rays, "seed": 5}
        found = mistray.pst(self.scene(load_scene, width), self.ANGLES, method=method, **settings)
        value, se = found.curve("edge_diffraction")
        assert not np.any(found.curve("single_scatter")[0])
        expected = np.array([self.expected(angle, width) for angle in self.ANGLES])
        assert np.all(se < 0.12 * expected), se / expected
        assert_z(method, value / expected, 1.0, se / expected, k=3.0, floor=3e-3)

"""Plates, ghosts and trees with known answers: every number within 4 standard errors and 0.1 %.

The flux of a path through plane surfaces at normal incidence is the same for every ray, so that its standard error is 0
and only float32 rounding is left: 1e-6 relative, which `assert_within` takes as its floor here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from oracles import closed_forms
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml
from oracles.statistics import assert_within
from vectors import frame

import mistray
from mistray.scenes.singlet_window_detector.prescription import build as singlet_window_detector

ROUNDING = 1e-6


def assert_power(what: str, watt: float, expected: float, se: float = 0.0) -> None:
    assert_within(what, watt, expected, se, rounding=ROUNDING)


class TestPlates:
    def test_plate_transmits_and_returns_what_the_series_says(self) -> None:
        scene = mistray.load("plate")
        t = mistray.trace(scene, rays=4096, max_reflections=20, flux_threshold=1e-12)
        r = closed_forms.normal_reflectance(1, 1.5)
        transmitted, returned = closed_forms.plate(r)
        e = t.energy
        assert e.launched_W == pytest.approx(25 * np.pi, rel=1e-12)
        assert_power("T", e.detected_W / e.launched_W, transmitted, e.detected_se_W / e.launched_W)
        assert transmitted == pytest.approx(0.923077, abs=5e-7)
        assert_power("R", e.escaped_W / e.launched_W, returned, e.escaped_se_W / e.launched_W)
        orders = closed_forms.plate_orders(r, 4)
        for m, row in enumerate(t.paths[:4]):
            assert row.order == 2 * m
            assert row.rays == 4096
            assert_power(f"{2 * m} reflections", row.power_W / e.launched_W, orders[m], row.power_se_W / e.launched_W)
        assert t.paths[1].power_W / t.paths[0].power_W == pytest.approx(r**2, rel=ROUNDING)
        assert (t.paths[1].ghost_1, t.paths[1].ghost_2) == ("plate_rear", "plate_front")

    @pytest.mark.parametrize("number", [2, 3, 5])
    def test_plates_in_a_row(self, load_text, number: int) -> None:
        """What is missing from the closed form is what was cut, no more."""
        scene, _ = load_text(plates_text(number))
        t = mistray.trace(scene, rays=4, max_reflections=6, flux_threshold=1e-9, ledger=False)
        expected = closed_forms.plates(0.04, number)
        share = t.energy.detected_W / t.energy.launched_W
        cut = sum(t.energy.cut.values()) / t.energy.launched_W
        assert share <= expected * (1 + ROUNDING)
        assert expected <= (share + cut) * (1 + ROUNDING)
        assert share == pytest.approx(expected, rel=1e-3)
        if number > 2:  # one in, one out: false alarm 6e-5 each, 4 standard errors
            t = mistray.trace(scene, rays=2_000_000, max_reflections=60, splitting="one", ledger=False)
            share, se = np.array([t.energy.detected_W, t.energy.detected_se_W]) / t.energy.launched_W
            assert_power(f"T of {number} plates", share, expected, se)
            assert se == pytest.approx(np.sqrt(share * (1 - share) / 2_000_000), rel=0.5)  # 32 batches: known to 13 %

    @pytest.mark.parametrize(("r", "t"), [(0.05, 0.9), (0.3, 0.7), (0.5, 0.5), (0.2, 0.1)])
    def test_plate_with_ideal_coatings(self, load_text, r: float, t: float) -> None:
        scene, _ = load_text(plates_text(1, R=r, T=t))
        traced = mistray.trace(scene, rays=256, max_reflections=60, flux_threshold=1e-12)
        transmitted, returned = closed_forms.coated_plate(r, r, t1=t, t2=t)
        e = traced.energy
        assert_power("T", e.detected_W / e.launched_W, transmitted)
        assert_power("R", e.escaped_W / e.launched_W, returned)
        absorbed = sum(watt for watt, _ in e.absorbed.values()) / e.launched_W
        assert absorbed == pytest.approx(1 - transmitted - returned, abs=2e-6)

    @pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0])
    def test_plate_with_tabled_coatings(self, tmp_path: Path, load_text, incidence_deg: float) -> None:
        """R differs between the two sides; the angle is the one in air, for light from either side."""

        def coating(angle_deg: float) -> np.ndarray:
            sine2 = np.sin(np.radians(angle_deg)) ** 2
            return np.array([0.01 + 0.2 * sine2**2, 0.8 - 0.6 * sine2**3, 0.05 + 0.1 * sine2])

        lines = ["# the test asks for the mean of both wavelengths", "wavelength_nm,angle_deg,R,T,R_back"]
        for wavelength, r_factor, t_factor in ((500, 0.5, 0.9), (600, 1.5, 1.1)):
            for angle in np.arange(0.0, 91.0, 2.5):
                values = coating(angle) * [r_factor, t_factor, r_factor]
                lines.append(",".join(str(v) for v in (wavelength, angle, *values)))
        table = tmp_path / "coating.csv"
        table.write_text("\n".join(lines), encoding="utf-8")
        scene, _ = load_text(plates_text(1, table=str(table)))
        light, limits = (
            {"field_deg": incidence_deg, "wavelength_nm": 550.0},
            {"max_reflections": 40, "flux_threshold": 1e-12},
        )
        traced = mistray.trace(scene, rays=256, **light, **limits)
        r, t, back = coating(incidence_deg)
        loop = 1 - back * r  # the front seen from inside is its back, the rear seen from inside its front
        e = traced.energy
        assert e.detected_W / e.launched_W == pytest.approx(t * t / loop, rel=1e-4)
        assert e.escaped_W / e.launched_W == pytest.approx(r + t * t * r / loop, rel=1e-3)


NARROW = 0.1  # radius of the beam, mm


@pytest.fixture(scope="module")
def ten_ghosts_trace():
    scene = singlet_window_detector().with_source(radius=NARROW).to_scene()
    return mistray.trace(scene, rays=60_000, flux_threshold=0.0)


@pytest.fixture(scope="module")
def ten_ghosts(ten_ghosts_trace):
    names = ["L1_front", "L1_rear", "window_front", "window_rear", "detector"]
    doubles = [row for row in ten_ghosts_trace.paths if row.order == 2]
    return {(names.index(row.ghost_2) + 1, names.index(row.ghost_1) + 1): row for row in doubles}


@pytest.fixture(scope="module")
def vectors() -> dict[tuple[int, int], dict[str, float]]:
    table = frame("ghost_lens_window_det.csv").set_index(["second_reflecting_surface", "first_reflecting_surface"])
    return table.to_dict("index")


class TestSingletWindowDetector:
    """The ten ghosts of a lens, a window and a detector that reflects 20 %, in a narrow beam: paraxial optics."""

    def test_power(self, ten_ghosts_trace, ten_ghosts, vectors) -> None:
        assert set(ten_ghosts) == set(vectors)
        assert [row.rays for row in ten_ghosts_trace.paths] == [60_000] * 11
        for pair, row in ten_ghosts.items():
            share = row.incident_W / ten_ghosts_trace.energy.launched_W
            assert_power(f"ghost {pair}", share, vectors[pair]["incident_power_per_W"])
            assert row.power_W == pytest.approx(0.8 * row.incident_W, rel=ROUNDING)
        # A uniform disc has r = rms · √2. 20 comparisons at 4 standard errors: false alarm 1.3e-3
        for pair, row in ten_ghosts.items():
            scale = NARROW / 10.0
            radius = np.sqrt(2) * row.rms_radius_mm
            expected = vectors[pair]["spot_radius_mm"] * scale
            se = np.sqrt(2) * row.rms_radius_se_mm
            assert_within(f"radius of ghost {pair}", radius, expected, se, relative=3e-3)
            assert se / radius < 1.5e-3
            irradiance = row.rms_irradiance_W_mm2 / 2 / 0.8  # over the disc, incident
            expected = vectors[pair]["irradiance_on_detector_per_entrance_irradiance"]
            se = row.rms_irradiance_se_W_mm2 / 2 / 0.8
            assert_within(f"irradiance of ghost {pair}", irradiance, expected, se, relative=6e-3)

    def test_focus(self, ten_ghosts_trace, ten_ghosts) -> None:
        """Where the rays of each ghost meet the axis, against the paraxial trace."""
        n = 1.5168
        r = closed_forms.normal_reflectance(1, n)
        rows = [(0.0, 0.01, 1.0, n), (5.0, -0.01, n, 1.0), (85.0, 0.0, 1.0, n), (87.0, 0.0, n, 1.0)]
        surfaces = [closed_forms.ParaxialSurface(*row, r, 1 - r) for row in rows]
        z = 87.0 + closed_forms.back_focus(surfaces)[1]
        for ghost in closed_forms.paraxial_ghosts(surfaces, z, 0.2, NARROW):
            row = ten_ghosts[ghost.second, ghost.first]
            history = ten_ghosts_trace.history(row.path_id, 4)
            for points in history.rays:
                end, before = points[-1], points[-2]
                slope = np.hypot(*(end - before)[:2]) / (end - before)[2]
                slope *= np.sign(np.dot((end - before)[:2], end[:2]))
                focus = end[2] - np.hypot(*end[:2]) / slope
                # the rim of the narrow beam: aberrations of 1e-4 of the distance to the focus
                distance = abs(ghost.height / ghost.slope)
                assert focus == pytest.approx(z - ghost.height / ghost.slope, abs=3e-4 * distance)


class TestGhostCounts:
    """Plane surfaces in air that reflect 1 % each: nothing is vignetted, every pair of surfaces is one ghost."""

    R = 0.01

    def scene(self, load_text, surfaces: int):
        coat = interface_xml(R=self.R, T=1 - self.R)
        names = [f"s{i:02}" for i in range(surfaces)]
        shapes = [shape_xml("asphere", name, 2.0 * i, coat, semi_diameter=5.0) for i, name in enumerate(names)]
        detector = shape_xml("asphere", "detector", 2.0 * surfaces, sensor=True, half_width=5.0, half_height=5.0)
        return load_text(scene_text(*shapes, detector))[0], names

    @pytest.mark.parametrize("surfaces", range(4, 16))
    def test_two_reflections(self, load_text, surfaces: int) -> None:
        scene, names = self.scene(load_text, surfaces)
        t = mistray.trace(scene, rays=64, max_reflections=2, flux_threshold=0.0)
        ghosts = [row for row in t.paths if row.order == 2]
        assert len(ghosts) == surfaces * (surfaces - 1) // 2 == closed_forms.ghost_count(surfaces, 2)
        assert len(t.paths) == len(ghosts) + 1
        assert t.paths[0].kind == "direct"
        events = {tuple(row.event_list): row for row in ghosts}
        for second, first in closed_forms.ghost_sequences(surfaces, 2):
            row = events[tuple(closed_forms.ghost_events(names, (second, first), "detector"))]
            assert row.kind == "ghost"
            assert row.rays == 64
            transmissions = row.path.count("T")
            power = self.R**2 * (1 - self.R) ** transmissions
            assert row.power_W / t.energy.launched_W == pytest.approx(power, rel=2e-6)

    @pytest.mark.parametrize(("surfaces", "reflections"), [(4, 4), (5, 4), (6, 4), (4, 6)])
    def test_more_reflections(self, load_text, surfaces: int, reflections: int) -> None:
        scene, names = self.scene(load_text, surfaces)
        t = mistray.trace(scene, rays=32, max_reflections=reflections, flux_threshold=0.0)
        found = {tuple(row.event_list) for row in t.paths if row.order == reflections}
        sequences = closed_forms.ghost_sequences(surfaces, reflections)
        assert found == {tuple(closed_forms.ghost_events(names, s, "detector")) for s in sequences}
        assert len(found) == closed_forms.ghost_count(surfaces, reflections)


class TestTotalReflection:
    def test_rod(self, load_text) -> None:
        """A bare rod guides everything, also skew rays: T is that of the plate with R at the angle of incidence."""
        rod = (
            shape_xml("asphere", "rod_front", 0.0, interface_xml("air", "1.5"), semi_diameter=2.0),
            shape_xml("frustum", "rod_side", 0.0, interface_xml("1.5", "air"), r0=2.0, z0=0.0, r1=2.0, z1=30.0),
            shape_xml("asphere", "rod_rear", 30.0, interface_xml("1.5", "air"), semi_diameter=2.0),
            shape_xml("asphere", "detector", 30.5, sensor=True, half_width=8.0, half_height=8.0),
        )
        scene, _ = load_text(scene_text(*rod, radius=1.5))
        mean = {"rays": 4096, "field_deg": 30.0, "polarization": "unpolarized"}
        t = mistray.trace(scene, max_reflections=8, flux_threshold=1e-12, **mean)
        _, averaged = closed_forms.tilted_plate(1.5, 30.0)
        e = t.energy
        # R at the angle of incidence differs between rays by rounding only
        assert_power("T of the rod", e.detected_W / e.launched_W, averaged)
        assert_power("R of the rod", e.escaped_W / e.launched_W, 1 - averaged)
        strongest = t.paths[0]
        assert (strongest.kind, strongest.order) == ("TIR", 0)
        assert strongest.tir == strongest.event_list.count(("rod_side", "TIR")) >= 2
        none = mistray.trace(scene, max_reflections=0, **mean)
        cos_i = np.cos(np.radians(30.0))
        cos_t = np.sqrt(1 - 0.25 / 2.25)
        rs, rp = (cos_i - 1.5 * cos_t) / (cos_i + 1.5 * cos_t), (1.5 * cos_i - cos_t) / (1.5 * cos_i + cos_t)
        direct = (1 - 0.5 * (rs**2 + rp**2)) ** 2
        assert_power("total reflections are free", none.energy.detected_W / e.launched_W, direct)

    def test_critical_angle(self, load_text) -> None:
        """n = 1.5: 41.81 deg; a coating reflects all but what it absorbs. The beam starts in glass."""

        def reflected(incidence_deg: float, **coating: float) -> mistray.Trace:
            face = shape_xml("asphere", "face", 0.0, interface_xml("1.5", "air", **coating), semi_diameter=50.0)
            screen = shape_xml("asphere", "detector", -20.0, sensor=True, half_width=60.0, half_height=60.0)
            scene, _ = load_text(scene_text(face, screen, distance=5.0))
            return mistray.trace(scene, rays=256, field_deg=incidence_deg)

        below, above, coated = reflected(41.7), reflected(41.9), reflected(50.0, R=0.1, T=0.7)
        assert [t.paths[0].path for t in (below, above, coated)] == ["RA", "IA", "IA"]
        assert above.paths[0].kind == "TIR"
        share, total, kept = (t.energy.detected_W / t.energy.launched_W for t in (below, above, coated))
        assert (total, kept) == pytest.approx((1.0, 0.8), rel=ROUNDING)
        assert coated.energy.absorbed["face"][0] / coated.energy.launched_W == pytest.approx(0.2, rel=ROUNDING)
        n, sin_t = 1.5, 1.5 * np.sin(np.radians(41.7))
        cos_i, cos_t = np.cos(np.radians(41.7)), np.sqrt(1 - sin_t**2)
        rs, rp = (n * cos_i - cos_t) / (n * cos_i + cos_t), (cos_i - n * cos_t) / (cos_i + n * cos_t)
        # cos_t = 0.064 comes from 1 - sin²: float32 leaves it 1e-5
        assert share == pytest.approx(0.5 * (rs**2 + rp**2), rel=1e-4)
        assert below.energy.escaped_W / below.energy.launched_W == pytest.approx(1 - share, rel=1e-4)

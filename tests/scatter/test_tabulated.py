"""Tables of scatter: what they hold comes back, in both frames; what they must not hold is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.evaluate import bsdf
from mistray.scatter.measured.samples import Samples, half_circle
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.scan import table
from mistray.scatter.total import lobe_total

ANGLES = np.arange(0.0, 85.0, 10.0)
AZIMUTH = np.linspace(0.0, 180.0, 19)
POLAR = {"specular": np.concatenate([[0.0], np.geomspace(0.1, 170.0, 50)]), "normal": np.linspace(0.0, 90.0, 46)}
FRAMES = tuple(POLAR)


def samples(frame: str, function: Callable[[np.ndarray], np.ndarray], event: str | None = None) -> Samples:
    """A table of a function of the directions, (…, 3)."""
    shape = (len(ANGLES), len(AZIMUTH), len(POLAR[frame]))
    empty = Samples("test", frame, ANGLES, AZIMUTH, POLAR[frame], np.zeros(shape), event)
    return Samples("test", frame, ANGLES, AZIMUTH, POLAR[frame], function(empty.directions()), event)


def values(model: Tabulated, angle_deg: float, directions: np.ndarray) -> np.ndarray:
    lobes = model.lobes(550, 1.0, 1.5, True)
    return bsdf(lobes, "reflection", float(np.cos(np.radians(angle_deg))), directions, 1.0, 1.5, 0.2)


def directions(count: int = 500) -> np.ndarray:
    """Random directions above the surface."""
    rng = np.random.default_rng(3)
    z, phi = rng.random(count), rng.random(count) * np.pi
    return np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=-1)


class TestValues:
    @pytest.mark.parametrize("frame", FRAMES)
    def test_lambertian_everywhere(self, frame: str) -> None:
        model = Tabulated(samples(frame, lambda d: np.full(d.shape[:-1], 0.3 / np.pi)))
        for angle in (0.0, 17.0, 80.0, 88.0):
            np.testing.assert_allclose(values(model, angle, directions()), 0.3 / np.pi, rtol=1e-9)
        (lobe,) = [lobe for lobe in model.lobes(550, 1, 1.5, True) if lobe.event == "reflection"]
        np.testing.assert_allclose(lobe_total(lobe, np.cos(np.radians([0, 45, 85])), 1, 1.5), 0.3, rtol=1e-4)

    @pytest.mark.parametrize("frame", FRAMES)
    def test_cosine_corrected(self, frame: str) -> None:
        """A Lambertian surface whose intensity was measured: f cos θs = ρ/π cos θs."""
        model = Tabulated(samples(frame, lambda d: 0.3 / np.pi * np.maximum(d[..., 2], 0)), cosine_corrected=True)
        np.testing.assert_allclose(values(model, 30.0, directions()), 0.3 / np.pi, rtol=1e-9)
        raw = Tabulated(samples(frame, lambda d: 0.3 / np.pi * np.maximum(d[..., 2], 0)))
        assert np.max(np.abs(values(raw, 30.0, directions()) * np.pi / 0.3 - 1)) > 0.5

    @pytest.mark.parametrize(("frame", "tolerance"), [("specular", 0.02), ("normal", 0.02)])
    def test_peaked(self, frame: str, tolerance: float) -> None:
        """An ABg model from its own table, at angles of incidence that are not in it: median error, and total."""
        truth = ABg(0.0025, 0.001, 1.8)
        model = Tabulated(table(truth, np.arange(0, 81, 5), frame))
        there = directions()
        for angle in (0.0, 23.0, 47.0, 71.0):
            r = np.hypot(there[:, 0] - np.sin(np.radians(angle)), there[:, 1])
            error = np.abs(values(model, angle, there) / (0.0025 / (0.001 + r**1.8)) - 1)
            assert np.percentile(error, 90) < tolerance
            cosine = np.cos(np.radians([angle]))
            lobe = model.lobes(550, 1, 1.5, True)[0]
            expected = lobe_total(truth.lobes(550, 1, 1.5, True)[0], cosine, 1, 1.5)
            np.testing.assert_allclose(lobe_total(lobe, cosine, 1, 1.5), expected, rtol=tolerance)

    def test_follows_the_angle_of_incidence(self) -> None:
        """A surface that scatters more at oblique incidence, Lambertian otherwise."""
        empty = samples("normal", lambda d: np.full(d.shape[:-1], 1.0))
        growing = empty.values * (0.1 + ANGLES / 100)[:, None, None] / np.pi
        model = Tabulated(Samples("test", "normal", ANGLES, AZIMUTH, POLAR["normal"], growing))
        for angle, tolerance in ((0.0, 1e-9), (35.0, 0.02), (65.0, 0.02)):
            np.testing.assert_allclose(values(model, angle, directions()), (0.1 + angle / 100) / np.pi, rtol=tolerance)
        np.testing.assert_allclose(values(model, 89.0, directions()), (0.1 + 0.8) / np.pi, rtol=1e-9)  # held


class TestCover:
    def short(self, frame: str) -> Samples:
        full = samples(frame, lambda d: np.full(d.shape[:-1], 0.1))
        keep = full.polar_deg <= 60
        return Samples("short", frame, ANGLES, AZIMUTH, full.polar_deg[keep], full.values[..., keep])

    def test_polar(self) -> None:
        with pytest.raises(MistrayError, match=r"'short': its polar angles end at 60°.*the hemisphere reaches to 90°"):
            Tabulated(self.short("normal"))
        with pytest.raises(MistrayError, match="at incidence 80° the hemisphere reaches to 170°"):
            Tabulated(self.short("specular"))

    def test_beyond(self) -> None:
        grazing = np.array([[np.sin(1.3), 0.0, np.cos(1.3)], [np.sin(0.8), 0.0, np.cos(0.8)]])
        held = Tabulated(self.short("normal"), beyond="hold")
        np.testing.assert_allclose(values(held, 0.0, grazing), 0.1, rtol=1e-9)
        zero = Tabulated(self.short("normal"), beyond="zero")
        np.testing.assert_allclose(values(zero, 0.0, grazing), [0.0, 0.1], atol=1e-9)
        with pytest.raises(MistrayError, match="beyond is 'last'"):
            Tabulated(self.short("normal"), beyond="last")

    def test_azimuth(self) -> None:
        full = samples("normal", lambda d: np.full(d.shape[:-1], 0.1))
        with pytest.raises(MistrayError, match=r"azimuths from 0 to 90° do not cover the hemisphere"):
            Samples("half", "normal", ANGLES, AZIMUTH[:10], full.polar_deg, full.values[:, :10])

    def test_full_circle(self) -> None:
        azimuth = np.array([0.0, 90.0, 180.0, 270.0, 360.0])
        grid = np.ones((1, 5, 2)) * np.array([3.0, 2.0, 1.0, 2.0, 3.0])[:, None]
        half, kept = half_circle("test", azimuth, grid)
        np.testing.assert_array_equal(half, [0, 90, 180])
        np.testing.assert_array_equal(kept, grid[:, :3])
        with pytest.raises(MistrayError, match="azimuths 90 and 270° differ by 1 1/sr"):
            half_circle("test", azimuth, grid * np.array([1, 1.5, 1, 1, 1])[:, None])
        with pytest.raises(MistrayError, match=r"azimuth 90° has no mirror image 270°"):
            half_circle("test", azimuth[[0, 1, 2, 4]], grid[:, [0, 1, 2, 4]])


class TestRefused:
    def test_more_than_all_light(self) -> None:
        with pytest.raises(MistrayError, match=r"TIS = 1\.5 at \d+°, more than all light"):
            Tabulated(samples("normal", lambda d: np.full(d.shape[:-1], 1.5 / np.pi)))

    def test_no_light(self) -> None:
        with pytest.raises(MistrayError, match="all values are 0"):
            Tabulated(samples("normal", lambda d: np.zeros(d.shape[:-1])))

    def test_grids(self) -> None:
        full = samples("normal", lambda d: np.full(d.shape[:-1], 0.1))
        for value, words in ((np.nan, "nan at incidence 20°, azimuth 30°, polar angle 10°"), (-1.0, "-1 at")):
            full.values[2, 3, 5] = value
            with pytest.raises(MistrayError, match=words):
                Samples("bad", "normal", ANGLES, AZIMUTH, full.polar_deg, full.values)
        grid = np.ones((1, 2, 2))
        ends = np.array([0.0, 180.0])
        with pytest.raises(MistrayError, match="the polar angles do not ascend"):
            Samples("x", "normal", np.zeros(1), ends, np.array([90.0, 0.0]), grid)
        with pytest.raises(MistrayError, match="polar angles begin at 5°"):
            Samples("x", "normal", np.zeros(1), ends, np.array([5.0, 90.0]), grid)
        with pytest.raises(MistrayError, match="incidence angles from 95 to 95°"):
            Samples("x", "normal", np.array([95.0]), ends, np.array([0.0, 90.0]), grid)
        with pytest.raises(MistrayError, match="light at 90° does not meet the surface"):
            Samples("x", "normal", np.array([90.0]), ends, np.array([0.0, 90.0]), grid)
        with pytest.raises(MistrayError, match="4 values for 1 × 2 × 3 angles"):
            Samples("x", "normal", np.zeros(1), ends, np.array([0.0, 45.0, 90.0]), grid)


class TestPlacement:
    def test_event_of_the_file(self) -> None:
        both = samples("normal", lambda d: np.full(d.shape[:-1], 0.1))
        brdf = samples("normal", lambda d: np.full(d.shape[:-1], 0.1), "reflection")
        assert [lobe.event for lobe in Tabulated(both).lobes(550, 1, 1.5, True)] == ["reflection", "transmission"]
        assert [lobe.event for lobe in Tabulated(brdf).lobes(550, 1, 1.5, True)] == ["reflection"]
        with pytest.raises(MistrayError, match="the table holds reflection, the event is 'transmission'"):
            Tabulated(brdf, event="transmission")
        assert Tabulated(brdf, side="back").lobes(550, 1, 1.5, True) == ()

    def test_equal_by_content(self) -> None:
        """Models are keys of caches: two tables with the same options are two models."""
        level, other = (samples("normal", lambda d, v=v: np.full(d.shape[:-1], v)) for v in (0.1, 0.2))
        again = samples("normal", lambda d: np.full(d.shape[:-1], 0.1))
        assert Tabulated(level) != Tabulated(other)
        assert Tabulated(level) == Tabulated(again)
        assert hash(Tabulated(level)) == hash(Tabulated(again))
        assert Tabulated(level, cosine_corrected=False) != Tabulated(level, side="back")

    def test_read_by_ending(self, tmp_path: Path) -> None:
        with pytest.raises(MistrayError, match=r"'a.txt': its name must end in .bsdf"):
            Tabulated.read("a.txt")
        with pytest.raises(MistrayError, match="No such file or directory; check the path"):
            Tabulated.read(tmp_path / "none.csv")

"""Tables of anisotropic samples: their conventions, what is refused, their totals, and files written and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from oracles import brushed

from mistray.errors import MistrayError
from mistray.scatter.evaluate import bsdf
from mistray.scatter.measured.rotations import RotatedSamples, by_rotation, whole_circle
from mistray.scatter.measured.samples import Samples
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.measured.zemax_bsdf import read_zemax_bsdf, write_zemax_bsdf
from mistray.scatter.total import lobe_total

ROTATIONS, INCIDENCE = np.arange(0.0, 361.0, 15.0), np.array([0.0, 20.0, 40.0, 60.0, 80.0])
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return brushed.write_asymmetrical_4d(tmp_path_factory.mktemp("bsdf") / "brushed.bsdf", ROTATIONS, INCIDENCE)


@pytest.fixture(scope="module")
def model(file: Path) -> Tabulated:
    return Tabulated.read(file, anisotropy="keep")


class TestZemax:
    """An Asymmetrical4D file by a writer of its own, against the closed form behind it."""

    def test_values(self, model: Tabulated) -> None:
        """Any directions of incidence and scatter, any rotation: 0.5 % of A rms is what linear interpolation leaves."""
        rng = np.random.default_rng(1)
        lobes = model.lobes(550.0, 1.0, 1.5, True)
        wrong = []
        for theta_i, theta_s, phi, rho in rng.random((300, 4)) * [1.35, 1.5, 2 * np.pi, 2 * np.pi]:
            out = np.array([[np.sin(theta_s) * np.cos(phi), np.sin(theta_s) * np.sin(phi), np.cos(theta_s)]])
            found = bsdf(lobes, "reflection", np.cos(theta_i), out, 1.0, 1.5, 1.0, rho)
            specular = np.array([np.sin(theta_i), 0.0, np.cos(theta_i)])
            exact = brushed.bsdf(specular, out[0], np.array([np.cos(rho), np.sin(rho), 0.0]), Z)
            wrong.append((found[0] - exact) / brushed.A)
        assert np.max(np.abs(wrong)) < 0.02
        assert np.sqrt(np.mean(np.square(wrong))) < 0.006

    @pytest.mark.parametrize("rotation", [0.0, 37.0, 90.0, 200.0])
    def test_total(self, model: Tabulated, rotation: float) -> None:
        """The TIS by the azimuth of incidence in closed form; 0.5 % is linear interpolation between 195 and 210°."""
        angles = np.radians([0.0, 20.0, 40.0, 60.0, 80.0])
        (lobe,) = model.lobes(550.0, 1.0, 1.5, True)
        found = lobe_total(lobe, np.cos(angles), 1.0, 1.5, rotation=np.radians(rotation))
        x = np.array([np.cos(np.radians(rotation)), np.sin(np.radians(rotation)), 0.0])
        exact = [brushed.total(np.array([np.sin(t), 0.0, np.cos(t)]), x, Z) for t in angles]
        np.testing.assert_allclose(found, exact, rtol=6e-3)

    def test_written_again(self, file: Path, tmp_path: Path) -> None:
        read = read_zemax_bsdf(file, "keep")
        assert isinstance(read, RotatedSamples)
        np.testing.assert_allclose(read.rotation_deg, np.sort(np.mod(ROTATIONS[:-1] + 90, 360)))
        write_zemax_bsdf(read, tmp_path / "again.bsdf")
        assert "Symmetry Asymmetrical4D" in (tmp_path / "again.bsdf").read_text(encoding="utf-8")
        again = read_zemax_bsdf(tmp_path / "again.bsdf", "keep")
        assert isinstance(again, RotatedSamples)
        np.testing.assert_allclose(again.rotation_deg, read.rotation_deg)
        for one, other in zip(read.tables, again.tables, strict=True):
            np.testing.assert_allclose(other.values, one.values, rtol=1e-6)

    def test_mean(self, file: Path) -> None:
        """Over all rotations A is left."""
        mean = Tabulated.read(file, anisotropy="mean")
        assert not mean.anisotropic
        out = np.array([[0.3, 0.2, np.sqrt(0.87)]])
        found = bsdf(mean.lobes(550.0, 1.0, 1.5, True), "reflection", 0.8, out, 1.0, 1.5, 1.0)
        assert found[0] == pytest.approx(brushed.A, rel=2e-3)


class TestCsv:
    def test_two_fold(self, tmp_path: Path) -> None:
        """a + b cos 2(φ - ρ) at its nodes, and between two rotations, where it turns with the sample."""
        model = Tabulated.read(brushed.write_two_fold(tmp_path / "two.csv", 0.1, 0.06), anisotropy="keep")
        lobes = model.lobes(550.0, 1.0, 1.5, True)
        for rotation in (0.0, 30.0, 45.0, 110.0):
            for phi in (0.0, 40.0, 95.0, 270.0):
                azimuth = np.radians(phi + rotation)
                out = np.array([[0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), 0.8]])
                found = bsdf(lobes, "reflection", 0.8, out, 1.0, 1.5, 1.0, np.radians(rotation))
                assert found[0] == pytest.approx(0.1 + 0.06 * np.cos(2 * np.radians(phi)), rel=2e-3)


def reduced(rotations: list[float], function: object, anisotropy: str = "keep") -> Samples | RotatedSamples:
    """The table of a function of the rotation, the same in all directions."""
    azimuth, rho = np.array([0.0, 90, 180, 270]), np.array(rotations)
    values = np.broadcast_to(function(rho)[:, None, None, None], (len(rho), 1, 4, 2))  # type: ignore[operator]

    def table_of(azimuth: np.ndarray, values: np.ndarray) -> Samples:
        return Samples("test", "normal", np.zeros(1), azimuth, np.array([0.0, 90.0]), values)

    return by_rotation("test", rho, azimuth, np.array(values), anisotropy, table_of)


def two_fold(rho: np.ndarray) -> np.ndarray:
    return 0.1 + 0.05 * np.cos(2 * np.radians(rho))


class TestRotations:
    def test_what_is_isotropic_is_read_so(self) -> None:
        assert isinstance(reduced([0, 90, 180, 270], lambda rho: np.full(len(rho), 0.1)), Samples)

    @pytest.mark.parametrize(
        ("given", "kept"),
        [
            ([0, 90, 180, 270], [0, 90, 180, 270]),
            ([0, 90, 180, 270, 360], [0, 90, 180, 270]),
            ([0, 45, 90, 135], [0, 45, 90, 135, 180, 225, 270, 315]),
            ([0, 60, 120, 180], [0, 60, 120, 180, 240, 300]),
            ([0, 90], [0, 90, 180, 270]),
        ],
    )
    def test_all_round(self, given: list[float], kept: list[float]) -> None:
        """All round, or over half the circle of a surface that is the same after half a turn."""
        found = reduced(given, two_fold)
        assert isinstance(found, RotatedSamples)
        np.testing.assert_allclose(found.rotation_deg, kept)
        np.testing.assert_allclose([table.values[0, 0, 0] for table in found.tables], two_fold(np.array(kept)))
        assert all(table.azimuth_deg[-1] == 360 for table in found.tables)

    def test_refused(self, file: Path) -> None:
        with pytest.raises(MistrayError, match="anisotropy is 'maen'"):
            read_zemax_bsdf(file, "maen")
        with pytest.raises(MistrayError, match="rotations from 0 to 90° leave 270° open"):
            reduced([0, 45, 90], two_fold)
        with pytest.raises(MistrayError, match=r"rotations 0 and 180° differ by 0\.2"):
            reduced([0, 90, 180], lambda rho: 0.1 + 0.1 * np.cos(np.radians(rho)))
        with pytest.raises(MistrayError, match="rotations do not ascend"):
            reduced([90, 0], two_fold)
        with pytest.raises(MistrayError, match=r"rotations 0 and 90° differ by 0\.1 1/sr"):
            reduced([0, 90, 180, 270], two_fold, "error")
        with pytest.raises(MistrayError, match="azimuths from 0 to 200° do not cover"):
            whole_circle("test", np.array([0.0, 100, 200]), np.ones((1, 3, 2)))
        table = Samples("test", "normal", np.zeros(1), np.array([0.0, 180]), np.array([0.0, 90.0]), np.ones((1, 2, 2)))
        with pytest.raises(MistrayError, match="1 BSDF tables for 2 sample rotations"):
            RotatedSamples(np.array([0.0, 180.0]), (table,))

    def test_more_than_all_light_at_one_rotation(self) -> None:
        samples = reduced([0, 90, 180, 270], lambda rho: 0.3 + 0.1 * np.cos(2 * np.radians(rho)))
        with pytest.raises(MistrayError, match=r"TIS = 1.2\d* at 0° and rotation 0°, more than all light"):
            Tabulated(samples)

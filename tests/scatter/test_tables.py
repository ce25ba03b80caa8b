"""Tables and files of scatter: what they hold comes back; a polish, Speos, ABg catalogues; and what is wrong."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from command_line import fails, succeeds
from oracles import brushed
from oracles.small_scenes import write
from refusals import each_refused, refused

import mistray  # noqa: F401
from mistray.prescription import Scatter
from mistray.scatter.abg import ABg
from mistray.scatter.evaluate import bsdf
from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.measured.bsdf_csv import read_bsdf_csv, write_bsdf_csv
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.measured.rotations import RotatedSamples, by_rotation, whole_circle
from mistray.scatter.measured.samples import BsdfSamples, half_circle
from mistray.scatter.measured.speos_bsdf import read_speos_bsdf
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.measured.zemax_abg import abg_from_catalogue, read_abg_data
from mistray.scatter.measured.zemax_bsdf import read_zemax_bsdf, write_zemax_bsdf
from mistray.scatter.phong import Phong
from mistray.scatter.scan import IncidentLight, scan, table
from mistray.scatter.total import lobe_total

ANGLES = np.arange(0.0, 85.0, 10.0)
AZIMUTH = np.linspace(0.0, 180.0, 19)
POLAR = {"specular": np.concatenate([[0.0], np.geomspace(0.1, 170.0, 50)]), "normal": np.linspace(0.0, 90.0, 46)}
FRAMES = tuple(POLAR)


def samples(frame: str, function: Callable[[np.ndarray], np.ndarray], event: str | None = None) -> BsdfSamples:
    shape = (len(ANGLES), len(AZIMUTH), len(POLAR[frame]))
    empty = BsdfSamples("test", frame, ANGLES, AZIMUTH, POLAR[frame], np.zeros(shape), event)
    return BsdfSamples("test", frame, ANGLES, AZIMUTH, POLAR[frame], function(empty.directions()), event)


def values(model: Tabulated, angle_deg: float, directions: np.ndarray) -> np.ndarray:
    lobes = model.lobes(550, 1.0, 1.5, True)
    return bsdf(lobes, "reflection", float(np.cos(np.radians(angle_deg))), directions, 1.0, 1.5, 0.2)


def directions(count: int = 500) -> np.ndarray:
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

    @pytest.mark.parametrize("frame", FRAMES)
    def test_peaked(self, frame: str) -> None:
        """An ABg model from its own table, at angles of incidence that are not in it: median error, and total."""
        truth = ABg(0.0025, 0.001, 1.8)
        model = Tabulated(table(truth, np.arange(0, 81, 5), frame))
        there = directions()
        for angle in (0.0, 23.0, 47.0, 71.0):
            r = np.hypot(there[:, 0] - np.sin(np.radians(angle)), there[:, 1])
            assert np.percentile(np.abs(values(model, angle, there) / (0.0025 / (0.001 + r**1.8)) - 1), 90) < 0.02
            cosine = np.cos(np.radians([angle]))
            found, expected = (lobe_total(one.lobes(550, 1, 1.5, True)[0], cosine, 1, 1.5) for one in (model, truth))
            np.testing.assert_allclose(found, expected, rtol=0.02)

    def test_follows_the_angle_of_incidence(self) -> None:
        empty = samples("normal", lambda d: np.full(d.shape[:-1], 1.0))
        growing = empty.values * (0.1 + ANGLES / 100)[:, None, None] / np.pi
        model = Tabulated(BsdfSamples("test", "normal", ANGLES, AZIMUTH, POLAR["normal"], growing))
        for angle, tolerance in ((0.0, 1e-9), (35.0, 0.02), (65.0, 0.02)):
            np.testing.assert_allclose(values(model, angle, directions()), (0.1 + angle / 100) / np.pi, rtol=tolerance)
        np.testing.assert_allclose(values(model, 89.0, directions()), (0.1 + 0.8) / np.pi, rtol=1e-9)  # held


def short(frame: str) -> BsdfSamples:
    full = samples(frame, lambda d: np.full(d.shape[:-1], 0.1))
    keep = full.polar_deg <= 60
    return BsdfSamples("short", frame, ANGLES, AZIMUTH, full.polar_deg[keep], full.values[..., keep])


@pytest.mark.parametrize(("beyond", "value"), [("hold", 0.1), ("zero", 0.0)])
def test_beyond_the_last_polar_angle(beyond: str, value: float) -> None:
    grazing = np.array([[np.sin(1.3), 0.0, np.cos(1.3)], [np.sin(0.8), 0.0, np.cos(0.8)]])
    model = Tabulated(short("normal"), beyond=beyond)
    np.testing.assert_allclose(values(model, 0.0, grazing), [value, 0.1], rtol=1e-9, atol=1e-9)
    # One polar angle that is held is a Lambertian
    samples = BsdfSamples("one", "normal", np.zeros(1), np.array([0.0, 180.0]), np.zeros(1), np.full((1, 2, 1), 0.1))
    assert samples.totals(beyond="hold") == pytest.approx([0.1 * math.pi], rel=1e-3)


def test_a_full_circle_is_halved_if_both_halves_are_the_same() -> None:
    azimuth = np.array([0.0, 90.0, 180.0, 270.0, 360.0])
    grid = np.ones((1, 5, 2)) * np.array([3.0, 2.0, 1.0, 2.0, 3.0])[:, None]
    half, kept = half_circle("test", azimuth, grid)
    np.testing.assert_array_equal(half, [0, 90, 180])
    np.testing.assert_array_equal(kept, grid[:, :3])
    with refused("azimuths 90 and 270° differ by 1 1/sr"):
        half_circle("test", azimuth, grid * np.array([1, 1.5, 1, 1, 1])[:, None])
    with refused(r"azimuth 90° has no mirror image 270°"):
        half_circle("test", azimuth[[0, 1, 2, 4]], grid[:, [0, 1, 2, 4]])


def level(value: float = 0.1, event: str | None = None) -> BsdfSamples:
    return samples("normal", lambda d: np.full(d.shape[:-1], value), event)


def grid(specular: float = 0.0, azimuth: float = 180.0, polar: tuple[float, ...] = (0.0, 90.0)) -> BsdfSamples:
    azimuths, angles = np.array([0.0, azimuth]), np.array([specular])
    return BsdfSamples("x", "normal", angles, azimuths, np.array(polar), np.ones((1, 2, 2)))


def with_one(value: float) -> BsdfSamples:
    full = level()
    full.values[2, 3, 5] = value
    return BsdfSamples("bad", "normal", ANGLES, AZIMUTH, full.polar_deg, full.values)


def bright(rho: np.ndarray) -> np.ndarray:
    return 0.1 + 2 * two_fold(rho)


def test_refused() -> None:
    each_refused(
        (lambda: Tabulated(level(1.5 / np.pi)), r"TIS = 1\.5 at \d+°, more than all light"),
        (lambda: Tabulated(level(0.0)), "all values are 0"),
        (lambda: Tabulated(level(), beyond="last"), "beyond is 'last'"),
        (lambda: Tabulated(level(event="reflection"), event="transmission"), "holds reflection, the event is 'trans"),
        (lambda: Tabulated.read("a.txt"), r"'a.txt': its name must end in .bsdf"),
        (lambda: Tabulated.read("none.csv"), "No such file or directory; check the path"),
        (lambda: with_one(np.nan), "nan at incidence 20°, azimuth 30°, polar angle 10°"),
        (lambda: with_one(-1.0), "-1 at"),
        (lambda: grid(polar=(90.0, 0.0)), "the polar angles do not ascend"),
        (lambda: grid(polar=(5.0, 90.0)), "polar angles begin at 5°"),
        (lambda: grid(polar=(0.0, 45.0, 90.0)), "4 values for 1 × 2 × 3 angles"),
        (lambda: grid(95.0), "incidence angles from 95 to 95°"),
        (lambda: grid(90.0), "light at 90° does not meet the surface"),
        (lambda: grid(azimuth=90.0), "azimuths from 0 to 90° do not cover the hemisphere"),
        (lambda: Tabulated(short("normal")), "'short': its polar angles end at 60°.*the hemisphere reaches to 90°"),
        (lambda: Tabulated(short("specular")), "at incidence 80° the hemisphere reaches to 170°"),
        (lambda: write_zemax_bsdf(random_samples("specular", None), Path("a.bsdf")), "frame 'specular' with an event"),
        (lambda: write_bsdf_csv(random_samples("specular", None), Path("a.csv")), "counts angles from the normal"),
        (lambda: reduced([0, 45, 90], two_fold), "rotations from 0 to 90° leave 270° open"),
        (lambda: reduced([0, 90, 180], lambda rho: 0.1 + 0.1 * np.cos(np.radians(rho))), r"0 and 180° differ by 0\.2"),
        (lambda: reduced([90, 0], two_fold), "rotations do not ascend"),
        (lambda: reduced([0, 90, 180, 270], two_fold, "error"), r"rotations 0 and 90° differ by 0\.1 1/sr"),
        (lambda: whole_circle("test", np.array([0.0, 100, 200]), np.ones((1, 3, 2))), "azimuths from 0 to 200° do not"),
        (lambda: RotatedSamples(np.array([0.0, 180.0]), (grid(),)), "1 BSDF tables for 2 sample rotations"),
        (
            lambda: Tabulated(reduced([0, 90, 180, 270], bright)),
            r"TIS = 1.2\d* at 0° and rotation 0°, more than all light",
        ),
    )


def test_events_and_equality() -> None:
    """The event of the file; models are keys of caches, equal by content and options."""
    one, brdf = Tabulated(level()), level(event="reflection")
    assert [lobe.event for lobe in one.lobes(550, 1, 1.5, True)] == ["reflection", "transmission"]
    assert [lobe.event for lobe in Tabulated(brdf).lobes(550, 1, 1.5, True)] == ["reflection"]
    assert Tabulated(brdf, side="back").lobes(550, 1, 1.5, True) == ()
    assert one not in (Tabulated(level(0.2)), Tabulated(level(), side="back"))
    assert (one, hash(one)) == (Tabulated(level()), hash(Tabulated(level())))


DENSE = np.concatenate([[0.0], np.geomspace(0.05, 150, 60)])


def random_samples(frame: str, event: str | None) -> BsdfSamples:
    rng = np.random.default_rng(5)
    angles, azimuth = np.array([0.0, 20.0, 55.0]), np.linspace(0, 180, 7)
    polar = np.linspace(0, 90 if frame == "normal" else 150, 12)
    return BsdfSamples("random", frame, angles, azimuth, polar, rng.random((3, 7, 12)) * 0.1, event)


class TestZemax:
    def test_lambertian(self, tmp_path: Path) -> None:
        model = Tabulated.read(write(tmp_path, vectors.text("lambert.bsdf"), "lambert.BSDF"))
        rng = np.random.default_rng(1)
        for theta_i, theta_s, phi in rng.random((200, 3)) * [1.5, 1.55, np.pi]:
            d = np.array([[np.sin(theta_s) * np.cos(phi), np.sin(theta_s) * np.sin(phi), np.cos(theta_s)]])
            value = bsdf(model.lobes(550, 1, 1.5, True), "reflection", np.cos(theta_i), d, 1, 1.5, 0.5)
            assert value[0] == pytest.approx(0.3 / np.pi, rel=1e-6)

    @pytest.mark.parametrize("event", ["reflection", "transmission"])
    def test_round_trip(self, tmp_path: Path, event: str) -> None:
        samples = random_samples("specular", event)
        write_zemax_bsdf(samples, tmp_path / "a.bsdf", "made by a test\nof two lines")
        assert (tmp_path / "a.bsdf").read_text().startswith("# made by a test\n# of two lines\nSource Measured\n")
        read = read_zemax_bsdf(tmp_path / "a.bsdf")
        assert read.event == event
        for key in ("specular_deg", "azimuth_deg", "polar_deg"):
            np.testing.assert_allclose(getattr(read, key), getattr(samples, key), rtol=1e-9)
        np.testing.assert_allclose(read.values, samples.values, rtol=1e-6)

    def test_total_in_the_file(self, tmp_path: Path) -> None:
        angles, azimuth = np.array([0.0, 60.0]), np.array([0.0, 90.0, 180.0])
        values = np.full((2, 3, len(DENSE)), 0.3 / np.pi)
        level = BsdfSamples("x", "specular", angles, azimuth, DENSE, values, "reflection")
        write_zemax_bsdf(level, tmp_path / "a.bsdf")
        totals = [float(line.split()[1]) for line in (tmp_path / "a.bsdf").read_text().splitlines() if "TIS" in line]
        assert totals == pytest.approx([0.3, 0.3], rel=1e-3)


class TestCsv:
    def test_round_trip_and_rows_in_any_order(self, tmp_path: Path) -> None:
        samples = random_samples("normal", None)
        write_bsdf_csv(samples, tmp_path / "a.csv", "made by a test")
        _, head, *rows = (tmp_path / "a.csv").read_text().splitlines()
        np.random.default_rng(2).shuffle(rows)
        shuffled = [",".join(line.split(",")[k] for k in (3, 1, 0, 2)) for line in (head, *rows)]
        (tmp_path / "b.csv").write_text("# a comment\n\n" + "\n".join(shuffled))
        for read in (read_bsdf_csv(tmp_path / name) for name in ("a.csv", "b.csv")):
            np.testing.assert_allclose(read.values, samples.values, rtol=1e-8)
            np.testing.assert_allclose(read.polar_deg, samples.polar_deg, rtol=1e-9)


ROTATIONS, INCIDENCE = np.arange(0.0, 361.0, 15.0), np.array([0.0, 20.0, 40.0, 60.0, 80.0])
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return brushed.write_asymmetrical_4d(tmp_path_factory.mktemp("bsdf") / "brushed.bsdf", ROTATIONS, INCIDENCE)


@pytest.fixture(scope="module")
def model(file: Path) -> Tabulated:
    return Tabulated.read(file, anisotropy="keep")


class TestRotatedZemax:
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
        mean = Tabulated.read(file, anisotropy="mean")
        assert not mean.anisotropic
        out = np.array([[0.3, 0.2, np.sqrt(0.87)]])
        found = bsdf(mean.lobes(550.0, 1.0, 1.5, True), "reflection", 0.8, out, 1.0, 1.5, 1.0)
        assert found[0] == pytest.approx(brushed.A, rel=2e-3)
        with refused("anisotropy is 'maen'"):
            read_zemax_bsdf(file, "maen")


def test_two_fold_csv(tmp_path: Path) -> None:
    """a + b cos 2(φ - ρ) at its nodes, and between two rotations, where it turns with the sample."""
    model = Tabulated.read(brushed.write_two_fold(tmp_path / "two.csv", 0.1, 0.06), anisotropy="keep")
    lobes = model.lobes(550.0, 1.0, 1.5, True)
    for rotation in (0.0, 30.0, 45.0, 110.0):
        for phi in (0.0, 40.0, 95.0, 270.0):
            azimuth = np.radians(phi + rotation)
            out = np.array([[0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), 0.8]])
            found = bsdf(lobes, "reflection", 0.8, out, 1.0, 1.5, 1.0, np.radians(rotation))
            assert found[0] == pytest.approx(0.1 + 0.06 * np.cos(2 * np.radians(phi)), rel=2e-3)


def reduced(rotations: list[float], function: object, anisotropy: str = "keep") -> BsdfSamples | RotatedSamples:
    azimuth, rho = np.array([0.0, 90, 180, 270]), np.array(rotations)
    values = np.broadcast_to(function(rho)[:, None, None, None], (len(rho), 1, 4, 2))  # type: ignore[operator]

    def table_of(azimuth: np.ndarray, values: np.ndarray) -> BsdfSamples:
        return BsdfSamples("test", "normal", np.zeros(1), azimuth, np.array([0.0, 90.0]), values)

    return by_rotation("test", rho, azimuth, np.array(values), anisotropy, table_of)


def two_fold(rho: np.ndarray) -> np.ndarray:
    return 0.1 + 0.05 * np.cos(2 * np.radians(rho))


@pytest.mark.parametrize(("given", "kept"), vectors.toml("tables.toml")["rotations"])
def test_rotations_all_round(given: list[float], kept: list[float]) -> None:
    """Or over half the circle of a surface that is the same after half a turn; what is isotropic is read so."""
    found = reduced(given, two_fold)
    assert isinstance(found, RotatedSamples)
    np.testing.assert_allclose(found.rotation_deg, kept)
    np.testing.assert_allclose([table.values[0, 0, 0] for table in found.tables], two_fold(np.array(kept)))
    assert all(table.azimuth_deg[-1] == 360 for table in found.tables)
    assert isinstance(reduced(given, lambda rho: np.full(len(rho), 0.1)), BsdfSamples)
    mean = reduced(given, two_fold, "mean")
    np.testing.assert_allclose(mean.tables[0].values, 0.1 + 0.05 * np.cos(2 * np.radians(kept)).mean(), rtol=1e-9)


DARK_AT_THE_HORIZON = KCorrelation(
    2.0, 20.0, 2.0, band_limited=True, theory="rayleigh_rice_vector", substrate=1 + 6j, event="reflection"
)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    ("model", "angles"),
    [
        (DARK_AT_THE_HORIZON, [0.0, 20.0, 40.0, 60.0, 80.0]),
        (KCorrelation(2.0, 10.0, 2.5, event="reflection"), [0.0, 89.0]),
        (Phong(0.7, 3.0), [0.0, 60.0]),
        (Phong(1.0, 20.0), [0.0]),
    ],
    ids=["dark at the horizon", "grazing", "cosine", "one incidence"],
)
def test_a_table_scatters_as_its_model(model: Any, angles: list[float], frame: str) -> None:
    """Also if its values fall to 1e-17 at the horizon, or by a thousand from one incidence to another."""
    expected = [found.scattered for found in scan(model, angles)]
    tabulated = Tabulated(table(model, angles, frame), event="reflection", relative_to="specular")
    assert [found.scattered for found in scan(tabulated, angles)] == pytest.approx(expected, rel=0.04)


def test_a_peak_on_few_nodes_decides_the_frame_of_the_ratio() -> None:
    """Nodes about the normal have steps of 7° there, too wide for this peak, though they fit the rest better."""
    angles, azimuth, polar = np.array([0.0, 30.0, 60.0]), np.linspace(0, 180, 19), np.linspace(0, 85, 171)
    shape = (len(angles), len(azimuth), len(polar))
    empty = BsdfSamples("peak", "normal", angles, azimuth, polar, np.zeros(shape), "reflection")
    x, y, _ = np.moveaxis(empty.directions(), -1, 0)
    r2 = (x - np.sin(np.radians(angles))[:, None, None]) ** 2 + y**2
    (found,) = scan(Tabulated(replace(empty, values=1e-3 / (1e-4 + r2)), beyond="zero"), [0.0])
    assert found.scattered == pytest.approx(np.pi * 1e-3 * np.log1p(np.sin(np.radians(85)) ** 2 / 1e-4), rel=0.03)


def test_a_smooth_lobe_between_coarse_azimuths() -> None:
    """A lobe that is as wide across as along the plane of incidence: total by fine steps, within 4 %."""

    def lobe(d: np.ndarray, specular_deg: float) -> np.ndarray:
        angle = np.radians(specular_deg)
        return 2e-3 + np.exp(33 * (d[..., 0] * np.sin(angle) + d[..., 2] * np.cos(angle) - 1))

    angles = np.array([0.0, 30.0, 60.0, 75.0])
    empty = BsdfSamples("test", "normal", angles, np.arange(0, 181, 10.0), np.arange(0, 91, 1.0), np.zeros((4, 19, 91)))
    values = np.array([lobe(d, angle) for d, angle in zip(empty.directions(), angles, strict=True)])
    found = [one.scattered for one in scan(Tabulated(replace(empty, values=values)), angles.tolist())]
    theta, phi = (np.radians(np.arange(0.05, end, 0.1)) for end in (90, 180))
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    d = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine), axis=-1)
    step = 2 * np.radians(0.1) ** 2
    expected = [step * float(np.sum(lobe(d, angle) * sine * cosine)) for angle in angles]
    assert found == pytest.approx(expected, rel=0.04)


TABLE = 2e-3  # relative: power laws between 600 frequencies, and a constant below the first


@pytest.mark.parametrize("theory", ["ghs", "rayleigh_rice", "rayleigh_rice_vector"])
def test_is_the_model_that_was_tabulated(theory: str) -> None:
    event = "reflection" if theory == "rayleigh_rice" else "both"
    known = KCorrelation(4.0, 20.0, 2.5, theory=theory, event=event)
    r = np.geomspace(1e-5, 2, 200)
    for wavelength, n_in, n_out in ((550.0, 1.0, 1.5), (550.0, 1.5, 1.0), (1064.0, 1.0, 1.7)):
        table = PsdTable.read(vectors.DATA / "psd_polish.csv", theory=theory, event=event, beyond="slope")
        ours, theirs = (m.lobes(wavelength, n_in, n_out, True) for m in (table, known))
        for a, b in zip(ours, theirs, strict=True):
            assert (a.event, a.factor) == (b.event, b.factor)
            np.testing.assert_allclose(a.profile(r), b.profile(r), rtol=TABLE)
            cos_i = np.array([1.0, 0.9])
            np.testing.assert_allclose(lobe_total(a, cos_i, n_in, n_out), lobe_total(b, cos_i, n_in, n_out), rtol=TABLE)


def test_total_of_a_smooth_surface() -> None:
    """(4π σ/λ)² times the mean of ((1 + cos θs)/2)², with σ of the frequencies up to 1/λ; a flat spectrum."""
    flat = PsdTable((1e-3, 100.0), (1e-6, 1e-6), event="reflection")
    (lobe,) = flat.lobes(500.0, 1.0, 1.5, True)
    assert flat.relevant_rms_um(500.0, 1.0) ** 2 == pytest.approx(np.pi * 1e-6 * 2.0**2, rel=1e-3)
    exact = (4 * np.pi / 0.5) ** 2 * np.pi * 1e-6 * 4.0 * 0.25 * (1 + 4 / 3 + 0.5)
    assert lobe_total(lobe, np.array([1.0]), 1.0, 1.5)[0] == pytest.approx(exact, rel=1e-3)


def test_units_and_scale(tmp_path: Path) -> None:
    mm = write(tmp_path, "frequency_1_mm,psd_nm2_mm2\n1,1e-3\n10000,1e-7\n", "mm.csv")
    um = write(tmp_path, "# the same\nfrequency_1_um,psd_um4\n0.001,1e-3\n10,1e-7\n", "um.csv")
    f = np.array([1e-4, 1e-3, 0.03, 10.0])
    a, b, twice = PsdTable.read(mm), PsdTable.read(um), PsdTable.read(um, scale=2.0)
    np.testing.assert_allclose(a.psd(550.0)(f), b.psd(550.0)(f), rtol=1e-12)
    np.testing.assert_allclose(b.psd(550.0)(f), [1e-3, 1e-3, 1e-3 / 30, 1e-7], rtol=1e-12)
    np.testing.assert_allclose(twice.psd(550.0)(f), 2 * b.psd(550.0)(f))
    assert PsdTable.read(um, scale=0.0).lobes(550.0, 1.0, 1.5, True) == ()


def test_above_the_last_frequency() -> None:
    values: tuple[Any, ...] = ((0.01, 1.0), (1e-4, 1e-8))
    with refused(r"it ends at 1 1/µm, but light of 550 nm meets frequencies up to 3\.63636"):
        PsdTable(*values).lobes(550.0, 1.0, 1.5, True)
    f = np.array([0.5, 2.0])
    np.testing.assert_allclose(PsdTable(*values, beyond="slope").psd(550.0)(f), [4e-8, 2.5e-9], rtol=1e-12)
    np.testing.assert_allclose(PsdTable(*values, beyond="zero").psd(550.0)(f), [4e-8, 0.0], rtol=1e-12)
    assert PsdTable(*values).lobes(2001.0, 1.0, 1.0, True)


THETAS, PHIS = np.arange(0.0, 90.5, 0.5), np.arange(0.0, 361.0, 30.0)
INCIDENCES = (0.0, 30.0, 60.0)


def speos(
    path: Path, values, *, of_bsdf: bool = True, total: str = "350\t30\n850\t30", text: str = "", phis=PHIS, at="0.0\t0"
) -> Path:
    head = "OPTIS - Anisotropic BSDF surface file v8.0\n0\nComment\n23\nMeasurement description\n0\t1\t0\n1\t0\n"
    head += f"{int(of_bsdf)}\n1\n0.0\n{len(INCIDENCES)}\n" + "\t".join(map(str, INCIDENCES))
    blocks = []
    for incidence in INCIDENCES:
        rows = ["\t".join(map(str, phis))]
        rows += ["\t".join(map(str, [t, *(values(incidence, t, p) for p in phis)])) for t in THETAS]
        blocks.append(f"{len(THETAS)} {len(phis)}\n" + "\n".join(rows))
    lines = total.count("\n") + 1
    path.write_text(f"{head}\t\n{at}\n\n{lines}\n{total}\n" + "\n".join(blocks) + "\n" + text, encoding="utf-8")
    return path


@pytest.mark.parametrize("of_bsdf", [True, False])
def test_a_lambertian_of_any_scale(tmp_path, of_bsdf):
    """30 % in all: f = 0.3/π, whether the file holds f or f cos θs, in whatever unit."""
    file = tmp_path / "a.anisotropicbsdf"
    speos(file, lambda _, t, __: 17.0 * (1.0 if of_bsdf else math.cos(math.radians(t))), of_bsdf=of_bsdf)
    samples = read_speos_bsdf(file)
    inside = samples.polar_deg < 89
    # The trapezoids of the integral, 0.5° wide, are exact to 1e-5
    assert samples.values[..., inside] == pytest.approx(0.3 / math.pi, rel=1e-4)
    assert Tabulated.read(file).samples == samples
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("23\nMeasurement description", "26\n Measurement description  "), encoding="utf-8")
    assert read_speos_bsdf(file) == samples, "spaces count"


def test_incidences_and_azimuths_of_speos(tmp_path):
    """The total is that at the first incidence; azimuth 0 is that of the specular direction."""
    file = tmp_path / "a.anisotropicbsdf"
    samples = read_speos_bsdf(speos(file, lambda i, t, p: 2.0 if i == 60 else 1.0))
    assert samples.values[2] == pytest.approx(2 * samples.values[0])
    assert list(samples.specular_deg) == list(INCIDENCES)
    speos(file, lambda i, t, p: math.exp(-((t - i) ** 2 + (180 - abs(p - 180)) ** 2 / 4) / 50))
    samples = read_speos_bsdf(file)
    azimuth, polar = np.unravel_index(np.argmax(samples.values[2]), samples.values[2].shape)
    assert (samples.frame, samples.azimuth_deg[azimuth], samples.polar_deg[polar]) == ("normal", 0.0, 60.0)


@pytest.mark.parametrize("of_bsdf", [True, False])
@pytest.mark.parametrize("incidence", [0, 30])
def test_total_of_speos(tmp_path, incidence, of_bsdf):
    """
    A trace scatters what the file states, whatever its grid.

    It does so for a narrow peak at the pole, a last azimuth before 360°, and noise of the intensity at the horizon.
    """

    def values(i: float, t: float, p: float) -> float:
        theta, phi, specular = np.radians([t, p, i])
        x, y = np.sin(theta) * np.cos(phi) - np.sin(specular), np.sin(theta) * np.sin(phi)
        return np.exp(-(x * x + y * y) / 0.04**2) * (1.0 if of_bsdf else np.cos(theta)) + 1e-4

    grid = {"phis": np.arange(0.0, 360.0, 20.0), "at": f"{incidence}\t0"}
    (found,) = scan(Tabulated.read(speos(tmp_path / "a.anisotropicbsdf", values, of_bsdf=of_bsdf, **grid)), [incidence])
    assert found.scattered == pytest.approx(0.3, rel=1e-3)


def test_rotation_of_the_total_of_speos(tmp_path):
    """The last two of three rotations scatter twice as much as the first; the total is that of the second."""
    file = tmp_path / "a.anisotropicbsdf"
    content = speos(file, lambda i, t, p: 1.0 + (p < 1), at="0.0\t120").read_text(encoding="utf-8")
    head, data = content.split("850\t30\n")
    one = f"{len(INCIDENCES)}\n" + "\t".join(map(str, INCIDENCES))
    head = head.replace(f"1\n0.0\n{one}", f"3\n0.0\t120.0\t240.0\n{one}\n{one}\n{one}")
    twice = re.sub(r"\t([12])\.0", lambda match: f"\t{2 * int(match[1])}.0", data)
    file.write_text(f"{head}850\t30\n{data}{twice}{twice}", encoding="utf-8")
    model = Tabulated.read(file, anisotropy="keep")
    found = [scan(model, [0.0], light=IncidentLight(rotation_deg=angle))[0].scattered for angle in (0.0, 120.0)]
    assert found == pytest.approx([0.15, 0.3], rel=0.01)


def test_totals_of_a_narrow_peak():
    """The TIS in a written file is that of the model, within the straight lines of its table."""
    polish = HarveyShack(b0=1e4, l=3e-4, s=-2.2, event="reflection")
    expected = [found.scattered for found in scan(polish, [0.0, 60.0])]
    assert table(polish, [0.0, 60.0], "specular").totals() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("old", "new", "message"), vectors.toml("refusals.toml")["files of Speos"])
def test_wrong_speos_files(tmp_path, old, new, message):
    file = speos(tmp_path / "a.anisotropicbsdf", lambda i, t, p: 1.0)
    content = file.read_text(encoding="utf-8")
    assert old in content
    file.write_text(content.replace(old, new, 1), encoding="utf-8")
    with refused("", message, str(file)):
        read_speos_bsdf(file)
    file.write_text(content[:3000], encoding="utf-8")
    with refused(r"copy it again|are needed"):
        read_speos_bsdf(file)


@pytest.fixture
def catalogue(tmp_path: Path) -> Path:
    return write(tmp_path, vectors.text("abg_catalogue.dat"), "ABG_DATA.DAT")


def test_entries(catalogue: Path) -> None:
    found = [(entry.name, entry.line, len(entry.rows)) for entry in read_abg_data(catalogue).values()]
    assert found == [("Polish 1", 2, 1), ("LAMBERT", 6, 2), ("steep", 10, 2)]
    model = abg_from_catalogue(f"{catalogue}:polish 1", side="front")
    assert (model.A, model.B, model.g, model.side) == (2e-5, 1e-6, 2.0, "front")
    assert model.reference_nm == pytest.approx(632.8, rel=1e-12)
    assert abg_from_catalogue(f"{catalogue}:Lambert") == ABg(0.1, 0.0, 0.0)
    for name, words in (
        ("ABG_DATA.DAT", "which entry? Write ABG_DATA.DAT:NAME"),
        (f"{catalogue}:polsh 1", "no entry 'polsh 1'; did you mean 'Polish 1'"),
        (f"{catalogue}:steep", f"{catalogue}', line 10: A, B and g of 'steep' change with the angle"),
    ):
        with refused("", words):
            abg_from_catalogue(name)


def test_in_a_scene_and_on_the_command_line(catalogue: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The numbers of the entry are the plugin's, with derivatives."""
    bsdf = mi.load_dict({"type": "interface", "R": 0.9, "s": {"type": "abg", "file": f"{catalogue}:POLISH 1"}})
    (model,) = bsdf.scatter
    assert (model.A, model.B, model.g) == pytest.approx((2e-5, 1e-6, 2.0), rel=1e-6)
    assert model.reference_nm == pytest.approx(632.8, rel=1e-12)
    assert float(mi.traverse(bsdf)["abg.B"][0]) == pytest.approx(1e-6)
    assert Scatter("abg", {"file": "ABG_DATA.DAT:POLISH 1", "event": "reflection"}).model() is None
    with pytest.raises(RuntimeError, match="file and B given"):
        mi.load_dict({"type": "abg", "file": f"{catalogue}:POLISH 1", "B": 1.0})
    command = ("bsdf", f"{catalogue}:polish 1", "--angles-deg", 0)
    assert "0.08681" in succeeds(capsys, *command, "--wavelength-nm", 632.8)  # π A ln(1 + 1/B), percent
    assert "A given" in fails(capsys, *command, "--A", 1)

"""Tables of scatter: what they hold comes back, files of isotropic and turned samples, and what is wrong with one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from oracles import brushed

from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.evaluate import bsdf
from mistray.scatter.measured.bsdf_csv import read_bsdf_csv, write_bsdf_csv
from mistray.scatter.measured.rotations import RotatedSamples, by_rotation, whole_circle
from mistray.scatter.measured.samples import BsdfSamples, half_circle
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.measured.zemax_bsdf import read_zemax_bsdf, write_zemax_bsdf
from mistray.scatter.scan import table
from mistray.scatter.total import lobe_total

ANGLES = np.arange(0.0, 85.0, 10.0)
AZIMUTH = np.linspace(0.0, 180.0, 19)
POLAR = {"specular": np.concatenate([[0.0], np.geomspace(0.1, 170.0, 50)]), "normal": np.linspace(0.0, 90.0, 46)}
FRAMES = tuple(POLAR)


def samples(frame: str, function: Callable[[np.ndarray], np.ndarray], event: str | None = None) -> BsdfSamples:
    """A table of a function of the directions, (…, 3)."""
    shape = (len(ANGLES), len(AZIMUTH), len(POLAR[frame]))
    empty = BsdfSamples("test", frame, ANGLES, AZIMUTH, POLAR[frame], np.zeros(shape), event)
    return BsdfSamples("test", frame, ANGLES, AZIMUTH, POLAR[frame], function(empty.directions()), event)


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
        model = Tabulated(BsdfSamples("test", "normal", ANGLES, AZIMUTH, POLAR["normal"], growing))
        for angle, tolerance in ((0.0, 1e-9), (35.0, 0.02), (65.0, 0.02)):
            np.testing.assert_allclose(values(model, angle, directions()), (0.1 + angle / 100) / np.pi, rtol=tolerance)
        np.testing.assert_allclose(values(model, 89.0, directions()), (0.1 + 0.8) / np.pi, rtol=1e-9)  # held


class TestCover:
    def short(self, frame: str) -> BsdfSamples:
        full = samples(frame, lambda d: np.full(d.shape[:-1], 0.1))
        keep = full.polar_deg <= 60
        return BsdfSamples("short", frame, ANGLES, AZIMUTH, full.polar_deg[keep], full.values[..., keep])

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


def level(value: float = 0.1, event: str | None = None) -> BsdfSamples:
    """The same in all directions."""
    return samples("normal", lambda d: np.full(d.shape[:-1], value), event)


def grid(specular: float = 0.0, azimuth: float = 180.0, polar: tuple[float, ...] = (0.0, 90.0)) -> BsdfSamples:
    """1 at every pair of angles; the values are always four."""
    return BsdfSamples(
        "x", "normal", np.array([specular]), np.array([0.0, azimuth]), np.array(polar), np.ones((1, 2, 2))
    )


def with_one(value: float) -> BsdfSamples:
    full = level()
    full.values[2, 3, 5] = value
    return BsdfSamples("bad", "normal", ANGLES, AZIMUTH, full.polar_deg, full.values)


@pytest.mark.parametrize(
    ("made", "words"),
    [
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
    ],
)
def test_refused(made: Callable[[], object], words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        made()


class TestPlacement:
    def test_event_of_the_file(self) -> None:
        both, brdf = level(), level(event="reflection")
        assert [lobe.event for lobe in Tabulated(both).lobes(550, 1, 1.5, True)] == ["reflection", "transmission"]
        assert [lobe.event for lobe in Tabulated(brdf).lobes(550, 1, 1.5, True)] == ["reflection"]
        assert Tabulated(brdf, side="back").lobes(550, 1, 1.5, True) == ()

    def test_equal_by_content(self) -> None:
        """Models are keys of caches: two tables with the same options are two models."""
        one = Tabulated(level())
        assert one != Tabulated(level(0.2))
        assert one == Tabulated(level())
        assert hash(one) == hash(Tabulated(level()))
        assert one != Tabulated(level(), side="back")


LAMBERT = """# a comment
Source  Measured
Symmetry  PlaneSymmetrical
SpectralContent  Monochrome
ScatterType  BRDF
SampleRotation  1
0
AngleOfIncidence  2
0\t60
ScatterAzimuth 3
0 90 180
ScatterRadial 4
0 10 90
150

Monochrome
DataBegin
TIS 0.3
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
TIS 0.3
0.0954929658551372 0.0954929658551372 0.0954929658551372 0.0954929658551372
0.0954929658551372 0.0954929658551372 0.0954929658551372 0
0.0954929658551372 0.0954929658551372 0 0
DataEnd
"""
DENSE = np.concatenate([[0.0], np.geomspace(0.05, 150, 60)])


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def random_samples(frame: str, event: str | None) -> BsdfSamples:
    rng = np.random.default_rng(5)
    angles, azimuth = np.array([0.0, 20.0, 55.0]), np.linspace(0, 180, 7)
    polar = np.linspace(0, 90 if frame == "normal" else 150, 12)
    return BsdfSamples("random", frame, angles, azimuth, polar, rng.random((3, 7, 12)) * 0.1, event)


class TestZemax:
    def test_lambertian(self, tmp_path: Path) -> None:
        """What lies below the horizon in the file, here 0, does not matter."""
        model = Tabulated.read(write(tmp_path / "lambert.BSDF", LAMBERT))
        rng = np.random.default_rng(1)
        for theta_i, theta_s, phi in rng.random((200, 3)) * [1.5, 1.55, np.pi]:
            d = np.array([[np.sin(theta_s) * np.cos(phi), np.sin(theta_s) * np.sin(phi), np.cos(theta_s)]])
            value = bsdf(model.lobes(550, 1, 1.5, True), "reflection", np.cos(theta_i), d, 1, 1.5, 0.5)
            assert value[0] == pytest.approx(0.3 / np.pi, rel=1e-6)

    def test_azimuth_0_points_to_the_normal(self) -> None:
        """At 60° the direction 60° off the specular one at azimuth 0 is the normal; 30° off at 180° it is grazing."""
        polar = np.array([0.0, 30.0, 60.0, 150.0])
        grid = BsdfSamples("x", "specular", np.array([60.0]), np.array([0.0, 180.0]), polar, np.zeros((1, 2, 4)))
        d = grid.directions()[0]
        np.testing.assert_allclose(d[0, 2], [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(d[1, 1], [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(d[0, 0], [np.sin(np.pi / 3), 0, 0.5], atol=1e-12)
        polar, azimuth = grid.angles_of(60.0, grid.directions()[0, :, 1:3])
        np.testing.assert_allclose(polar, [[30, 60], [30, 60]], atol=1e-9)
        np.testing.assert_allclose(azimuth, [[0, 0], [180, 180]], atol=1e-9)

    @pytest.mark.parametrize("event", ["reflection", "transmission"])
    def test_round_trip(self, tmp_path: Path, event: str) -> None:
        samples = random_samples("specular", event)
        write_zemax_bsdf(samples, tmp_path / "a.bsdf", "made by a test\nof two lines")
        text = (tmp_path / "a.bsdf").read_text()
        assert text.startswith("# made by a test\n# of two lines\nSource Measured\n")
        read = read_zemax_bsdf(tmp_path / "a.bsdf")
        assert read.event == event
        for key in ("specular_deg", "azimuth_deg", "polar_deg"):
            np.testing.assert_allclose(getattr(read, key), getattr(samples, key), rtol=1e-9)
        np.testing.assert_allclose(read.values, samples.values, rtol=1e-6)

    def test_total_in_the_file(self, tmp_path: Path) -> None:
        shape = (2, 3, len(DENSE))
        level = BsdfSamples("x", "specular", np.array([0.0, 60.0]), np.array([0.0, 90.0, 180.0]), DENSE,
                        np.full(shape, 0.3 / np.pi), "reflection")  # fmt: skip
        write_zemax_bsdf(level, tmp_path / "a.bsdf")
        totals = [float(line.split()[1]) for line in (tmp_path / "a.bsdf").read_text().splitlines() if "TIS" in line]
        assert totals == pytest.approx([0.3, 0.3], rel=1e-3)

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("SampleRotation  1\n0", "SampleRotation 2\n0 90", "DataEnd after 0 of"),
            ("PlaneSymmetrical", "Round", "line 3: Symmetry is Round; use PlaneSymmetrical or"),
            ("SpectralContent  Monochrome", "SpectralContent XYZ", "line 4: XYZ are colours"),
            ("ScatterType  BRDF", "ScatterType BSSRDF", "line 5: ScatterType is BSSRDF; use BRDF or BTDF"),
            ("AngleOfIncidence  2", "AngleOfIncidence two", "line 8: 'AngleOfIncidence two'; expected"),
            ("0 90 180", "0 ninety 180", "line 11: could not convert string to float: 'ninety'"),
            ("Monochrome\nDataBegin", "DataBegin", "line 16: 'DataBegin'; expected Monochrome"),
            ("0.0954929658551372 0\nTIS", "0.0954929658551372 -1\nTIS", "line 21: -1; a BSDF is not negative"),
            ("0.0954929658551372 0\nTIS", "0.0954929658551372\nTIS", "line 22: TIS after 11 of 12 values at 0°"),
            ("0 0\nDataEnd", "0\nDataEnd", "line 26: DataEnd after 11 of 12 values at 60°; the file is incomplete"),
            ("0 0\nDataEnd", "0 0\n", "it ends before DataEnd; the file is incomplete"),
            ("DataEnd", "1 1 1 1\nDataEnd", "line 26: '1 1 1 1'; expected DataEnd, there are more data than angles"),
            ("\n150\n", "\n90\n", "polar angles do not ascend"),
        ],
    )
    def test_malformed(self, tmp_path: Path, old: str, new: str, words: str) -> None:
        assert LAMBERT.count(old) >= 1
        with pytest.raises(MistrayError) as error:
            read_zemax_bsdf(write(tmp_path / "bad.bsdf", LAMBERT.replace(old, new, 1)))
        assert words in str(error.value)
        assert "bad.bsdf" in str(error.value)
        assert "\n" not in str(error.value)

    def test_only_its_own_frame(self, tmp_path: Path) -> None:
        with pytest.raises(MistrayError, match="give a table in the frame 'specular' with an event"):
            write_zemax_bsdf(random_samples("specular", None), tmp_path / "a.bsdf")
        with pytest.raises(MistrayError, match="counts angles from the normal"):
            write_bsdf_csv(random_samples("specular", None), tmp_path / "a.csv")


class TestCsv:
    def test_round_trip(self, tmp_path: Path) -> None:
        samples = random_samples("normal", None)
        write_bsdf_csv(samples, tmp_path / "a.csv", "made by a test")
        read = read_bsdf_csv(tmp_path / "a.csv")
        np.testing.assert_allclose(read.values, samples.values, rtol=1e-8)
        np.testing.assert_allclose(read.polar_deg, samples.polar_deg, rtol=1e-9)

    def test_rows_in_any_order(self, tmp_path: Path) -> None:
        samples = random_samples("normal", None)
        write_bsdf_csv(samples, tmp_path / "a.csv")
        head, *rows = (tmp_path / "a.csv").read_text().splitlines()
        np.random.default_rng(2).shuffle(rows)
        columns = [3, 1, 0, 2]
        shuffled = [",".join(line.split(",")[k] for k in columns) for line in (head, *rows)]
        write(tmp_path / "b.csv", "# a comment\n\n" + "\n".join(shuffled))
        np.testing.assert_allclose(read_bsdf_csv(tmp_path / "b.csv").values, samples.values, rtol=1e-8)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "its columns are missing; give theta_i_deg, theta_s_deg, phi_deg, bsdf"),
            ("theta_i_deg,theta_s_deg,bsdf\n0,0,1\n", "its columns are theta_i_deg, theta_s_deg, bsdf; give"),
            ("{head}0,0,0,x\n", "line 2: could not convert string to float: 'x'"),
            ("{head}0,0,0\n", "line 2: 3 values where 4 are needed"),
            ("{head}", "0 rows for 0 theta_i"),
            ("{head}0,0,0,1\n0,90,0,1\n0,0,180,1\n", "3 rows for 1 theta_i × 2 theta_s × 2 phi"),
            ("{head}0,0,0,1\n0,90,0,1\n0,0,180,1\n0,0,180,1\n", "a combination of angles is there twice"),
        ],
    )
    def test_malformed(self, tmp_path: Path, text: str, words: str) -> None:
        path = write(tmp_path / "bad.csv", text.format(head="theta_i_deg,theta_s_deg,phi_deg,bsdf\n"))
        with pytest.raises(MistrayError) as error:
            read_bsdf_csv(path)
        assert words in str(error.value)
        assert "bad.csv" in str(error.value)

    def test_no_text(self, tmp_path: Path) -> None:
        (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
        with pytest.raises(MistrayError, match="it is no text file"):
            read_bsdf_csv(tmp_path / "a.csv")


ROTATIONS, INCIDENCE = np.arange(0.0, 361.0, 15.0), np.array([0.0, 20.0, 40.0, 60.0, 80.0])
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return brushed.write_asymmetrical_4d(tmp_path_factory.mktemp("bsdf") / "brushed.bsdf", ROTATIONS, INCIDENCE)


@pytest.fixture(scope="module")
def model(file: Path) -> Tabulated:
    return Tabulated.read(file, anisotropy="keep")


class TestRotatedZemax:
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


class TestRotatedCsv:
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


def reduced(rotations: list[float], function: object, anisotropy: str = "keep") -> BsdfSamples | RotatedSamples:
    """The table of a function of the rotation, the same in all directions."""
    azimuth, rho = np.array([0.0, 90, 180, 270]), np.array(rotations)
    values = np.broadcast_to(function(rho)[:, None, None, None], (len(rho), 1, 4, 2))  # type: ignore[operator]

    def table_of(azimuth: np.ndarray, values: np.ndarray) -> BsdfSamples:
        return BsdfSamples("test", "normal", np.zeros(1), azimuth, np.array([0.0, 90.0]), values)

    return by_rotation("test", rho, azimuth, np.array(values), anisotropy, table_of)


def two_fold(rho: np.ndarray) -> np.ndarray:
    return 0.1 + 0.05 * np.cos(2 * np.radians(rho))


class TestRotations:
    def test_what_is_isotropic_is_read_so(self) -> None:
        assert isinstance(reduced([0, 90, 180, 270], lambda rho: np.full(len(rho), 0.1)), BsdfSamples)

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
        table = BsdfSamples(
            "test", "normal", np.zeros(1), np.array([0.0, 180]), np.array([0.0, 90.0]), np.ones((1, 2, 2))
        )
        with pytest.raises(MistrayError, match="1 BSDF tables for 2 sample rotations"):
            RotatedSamples(np.array([0.0, 180.0]), (table,))

    def test_more_than_all_light_at_one_rotation(self) -> None:
        samples = reduced([0, 90, 180, 270], lambda rho: 0.3 + 0.1 * np.cos(2 * np.radians(rho)))
        with pytest.raises(MistrayError, match=r"TIS = 1.2\d* at 0° and rotation 0°, more than all light"):
            Tabulated(samples)

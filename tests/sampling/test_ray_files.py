"""Rays of files as a source: bit by bit round trips, the light of a trace traced on, files that are none."""

from __future__ import annotations

import struct
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, square
from oracles.statistics import assert_z
from refusals import refused

import mistray
from mistray.files.ray_sets import RaySet, read_ray_set, save_ray_set

pytestmark = pytest.mark.quick

SUFFIXES = (".csv", ".parquet", ".dat")


def rays(count: int = 500, known: bool = True) -> RaySet:
    rng = np.random.default_rng(4)
    o, d = rng.normal(size=(2, count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    wavelength = rng.choice([450.0, 550.0, 632.8], count) if known else np.full(count, np.nan)
    return RaySet(o * 1e3, d, rng.exponential(size=count), wavelength)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip(suffix: str, known: bool, tmp_path: Path) -> None:
    given, file = rays(known=known), tmp_path / f"a lamp{suffix}"
    save_ray_set(file, given)
    found = read_ray_set(file)
    for key in ("origins", "directions", "flux_W", "wavelength_nm"):
        one, other = getattr(given, key), getattr(found, key)
        if suffix == ".dat":  # 32-bit floats
            np.testing.assert_allclose(other, one, rtol=2e-6, atol=1e-6)
        else:
            assert one.tobytes() == other.tobytes(), key


def test_zemax_file_by_hand(tmp_path: Path) -> None:
    """Written byte by byte: two rays in inches, spectral; then as text in cm, flux only."""
    head = struct.pack("<iI100s3f4fi9f4f4i", 1010, 2, b"by hand", 3.0, 3.0, 0.0, *[0.0] * 4, 1, *[0.0] * 13, 2, 0, 0, 0)
    assert len(head) == 208
    body = struct.pack("<16f", 1, 2, 3, 0, 0, 1, 1.0, 0.5, -1, 0, 0, 0, 0.6, 0.8, 2.0, 0.7)
    (tmp_path / "binary.dat").write_bytes(head + body)
    found = read_ray_set(tmp_path / "binary.dat")
    np.testing.assert_allclose(found.origins, [[25.4, 50.8, 76.2], [-25.4, 0, 0]])
    np.testing.assert_allclose(found.directions, [[0, 0, 1], [0, 0.6, 0.8]], atol=1e-7)
    np.testing.assert_allclose(found.wavelength_nm, [500, 700], rtol=1e-6)
    assert found.flux_W.tolist() == [1.0, 2.0]
    (tmp_path / "text.dat").write_text("1 2\n1 2 3 0 0 1 5.5\n")
    found = read_ray_set(tmp_path / "text.dat")
    assert found.origins.tolist() == [[10, 20, 30]]
    assert found.flux_W.tolist() == [5.5]
    (tmp_path / "no_unit.dat").write_text("1\n1 2 3 0 0 1 5.5\n")
    assert read_ray_set(tmp_path / "no_unit.dat", unit="m").origins.tolist() == [[1000, 2000, 3000]]


@pytest.mark.long
def test_light_of_a_trace_goes_on(tmp_path: Path) -> None:
    """Rays at a plane, in a file, traced on: the image behind it is that of the whole trace. False alarms 0.1 %."""
    lamp = {"type": "surface_source", "radius": 2.0, "z": -30.0, "half_angle_deg": 20.0, "wavelength_nm": "450, 600"}
    plane = lit(lamp, detector=square(200.0, 8))
    t = mistray.trace(plane, rays=100_000)
    file = tmp_path / "plane.csv"
    t.rays(n=None).to_csv(file, index=False)
    stop = {"type": "asphere", "semi_diameter": 300.0, "inner_semi_diameter": 4.0, "z": 10.0, "bsdf": BLACK}
    onward = {"type": "scene", "stop": stop, "detector": square(10.0, 8, z=30.0)}
    whole = mistray.trace(mistray.load({**onward, "lamp": lamp}), rays=100_000)
    again = mistray.trace(mistray.load(onward, f"rays:filename={file}"), rays=100_000)
    assert again.wavelengths_nm == [450.0, 600.0]
    assert again.energy.launched_W == pytest.approx(t.energy.detected_W, rel=1e-9)
    assert abs(again.energy.closure) < 1e-6
    # The rays of the file stand for all of them: their number is in the error as well
    error = np.sqrt(whole.irradiance_se**2 + 2 * again.irradiance_se**2)
    known = np.isfinite(error)
    assert known.sum() >= 30
    assert_z("image", again.irradiance[known], whole.irradiance[known], error[known], false_alarm=1e-3)


def test_flux_and_wavelengths(tmp_path: Path) -> None:
    """Rays are drawn by their flux; more wavelengths than 32 are put together; the power may be another."""
    o = np.zeros((2, 3))
    o[:, 2] = -5
    d = np.array([[0, 0, 1.0], [0.5, 0, np.sqrt(0.75)]])
    save_ray_set(tmp_path / "two.parquet", RaySet(o, d, np.array([1.0, 3.0]), np.full(2, np.nan)))
    lamp = {"type": "ray_file", "filename": str(tmp_path / "two.parquet"), "wavelength_nm": 633.0}
    t = mistray.trace(lit(lamp, detector=square(10.0, 8)), rays=10_000)
    share = t.irradiance[:, 4:5].sum() / t.irradiance.sum()  # the first ray lands in this column, the other does not
    assert_z("share", share, 0.25, np.sqrt(0.25 * 0.75 / 10_000), false_alarm=1e-3)
    assert t.energy.launched_W == pytest.approx(4.0)
    assert t.wavelengths_nm == [633.0]
    many = rays(2000)
    rng = np.random.default_rng(1)
    save_ray_set(tmp_path / "many.csv", RaySet(many.origins, many.directions, many.flux_W, rng.uniform(400, 700, 2000)))
    made = mi.load_dict({"type": "ray_file", "filename": str(tmp_path / "many.csv"), "power": 2.0})
    assert len(made.wavelengths_nm) == 32
    assert made.power() == 2.0
    assert np.all(np.diff(made.wavelengths_nm) > 0)
    assert made.weights == pytest.approx(np.full(32, 1 / 32), rel=0.2)


def tm25(
    rows: list[list[float]],
    flags: tuple[int, ...] = (1, 1, 1, 0, 0, 0, 0, 0),
    *,
    watts: float = float("nan"),
    lumens: float = float("nan"),
    spectrum: int = 0,
    nm: float = float("nan"),
    tables: tuple[tuple[float, ...], ...] = (),
    names: tuple[str, ...] = (),
    text: str = "",
) -> bytes:
    """A TM-25 file, byte by byte as the sections 4.7.1 to 4.7.7 of IES TM-25-13 have it."""
    note = text.encode("utf-32-le")
    note += bytes(-len(note) % 32)
    head = struct.pack("<4siiffQ28s", b"TM25", 2013, 0, lumens, watts, len(rows), b"2026-11-28T00:00:00+00:00")
    head += struct.pack("<iifffiii", 0, spectrum, nm, nm, nm, len(tables), len(names), len(note)) + bytes(168)
    body = struct.pack("<8i", *flags) + b"".join(f"line {k}".encode("utf-32-le").ljust(4000, b"\0") for k in range(9))
    block = b"".join(struct.pack(f"<i{len(t)}f", len(t) // 2, *t) for t in tables)
    block += bytes(-len(block) % 32)
    columns = b"".join(name.encode("utf-32-le").ljust(512, b"\0") for name in names)
    assert len(head) == 256
    return head + body + block + columns + note + np.array(rows, dtype="<f4").tobytes()


class TestTM25:
    def test_watts_wavelengths_and_further_columns(self, tmp_path: Path) -> None:
        file = tmp_path / "lamp.TM25RAY"
        file.write_bytes(tm25([[1, 2, 3, 0, 0, 1, 0.5], [4, 5, 6, 0, 0.6, 0.8, 1.5]], watts=8.0, spectrum=1, nm=632.8))
        found = read_ray_set(file)
        np.testing.assert_allclose(found.origins, [[1, 2, 3], [4, 5, 6]])
        np.testing.assert_allclose(found.directions, [[0, 0, 1], [0, 0.6, 0.8]], atol=1e-7)
        np.testing.assert_allclose(found.flux_W, [2.0, 6.0])
        np.testing.assert_allclose(found.wavelength_nm, 632.8)
        rows = [[0, 0, 0, 0, 0, 1, 1.0, 450.0, 0.1, 0.2, 0.3, 7.0], [1, 0, 0, 0, 0, -1, 3.0, 650.0, 0, 0, 0, 8.0]]
        file.write_bytes(tm25(rows, (1, 1, 1, 1, 0, 1, 0, 0), spectrum=2, names=("chip",), text="of the bench"))
        found = read_ray_set(file)
        assert found.flux_W.tolist() == [1.0, 3.0]  # the header states no total
        assert found.wavelength_nm.tolist() == [450.0, 650.0]
        assert found.directions[1].tolist() == [0, 0, -1]

    def test_lumens(self, tmp_path: Path) -> None:
        """337 lm that are 0.694 W; without the watts, only with the power of all."""
        rows = [[0, 0, 0, 0, 0, 1, 1.0], [1, 0, 0, 0, 0, 1, 3.0]]
        flags = (1, 1, 0, 0, 1, 0, 0, 0)
        (tmp_path / "both.tm25ray").write_bytes(tm25(rows, flags, watts=0.694, lumens=337.0))
        np.testing.assert_allclose(read_ray_set(tmp_path / "both.tm25ray").flux_W, [0.1735, 0.5205], rtol=1e-6)
        (tmp_path / "lumens.tm25ray").write_bytes(tm25(rows, flags, lumens=337.0))
        with refused("lumens"):
            read_ray_set(tmp_path / "lumens.tm25ray")
        np.testing.assert_allclose(read_ray_set(tmp_path / "lumens.tm25ray", power_W=2.0).flux_W, [0.5, 1.5])
        lamp = mi.load_dict({"type": "ray_file", "filename": str(tmp_path / "lumens.tm25ray"), "power": 2.0})
        assert lamp.power() == 2.0

    @pytest.mark.parametrize("each", [False, True])
    def test_a_spectrum_keeps_its_moments(self, each: bool, tmp_path: Path) -> None:
        """Weights 1 to 3 from 500 to 600 nm, linear: mean 500 + 100 · (1/2 + 2/3)/2 nm, second moment likewise."""
        wedge = (500.0, 1.0, 600.0, 3.0)
        rows = [[0.0, 0, 0, 0, 0, 1, 1] + ([2.0] if each else []) for _ in range(4000)]
        tables = ((400.0, 1.0), wedge) if each else (wedge,)
        flags = (1, 1, 1, 0, 0, 0, 0, int(each))
        (tmp_path / "lamp.tm25ray").write_bytes(tm25(rows, flags, spectrum=4 if each else 3, tables=tables))
        t = (read_ray_set(tmp_path / "lamp.tm25ray").wavelength_nm - 500) / 100
        assert 0 <= t.min() < t.max() <= 1
        # p(t) = (1 + 2 t)/2
        assert t.mean() == pytest.approx(1 / 4 + 1 / 3, abs=1e-3)
        assert (t**2).mean() == pytest.approx(1 / 6 + 1 / 4, abs=1e-3)


GOOD = "x_mm,y_mm,z_mm,dx,dy,dz,flux_W\n"
ONE = [[0, 0, 0, 0, 0, 1, 1]]
NO_SUCH_TABLE = tm25([[*ONE[0], 2]], (1, 1, 1, 0, 0, 0, 0, 1), spectrum=4, tables=((500.0, 1.0),))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.csv", b""),
        ("header.csv", GOOD),
        ("no_flux.csv", "x_mm,y_mm,z_mm,dx,dy,dz\n0,0,0,0,0,1\n"),
        ("inf.csv", GOOD + "0,0,0,0,0,1,inf\n"),
        ("text.csv", GOOD + "0,0,a,0,0,1,1\n"),
        ("negative.csv", GOOD + "0,0,0,0,0,1,-1\n"),
        ("dark.csv", GOOD + "0,0,0,0,0,1,0\n"),
        ("still.csv", GOOD + "0,0,0,0,0,0,1\n"),
        ("far.csv", GOOD + "0,0,1e308,0,0,1,1\n"),
        ("ragged.csv", GOOD + "0,0,0,0,0,1,1,1,1,1,1\n0,0\n"),
        ("colour.csv", GOOD.replace("\n", ",wavelength_nm\n") + "0,0,0,0,0,1,1,-5\n"),
        ("cut.dat", struct.pack("<iI100s", 1010, 5, b"cut") + bytes(100)),
        ("short.dat", "3 4\n1 2 3 0 0 1 1\n"),
        ("words.dat", "hello\n"),
        ("lamp.txt", GOOD),
        ("none.parquet", "PAR1"),
        ("empty.tm25ray", b""),
        ("short.tm25ray", b"TM25"),
        ("other.tm25ray", b"TM26" + bytes(40000)),
        ("cut.tm25ray", tm25(ONE)[:-4]),
        ("version.tm25ray", tm25(ONE)[:4] + struct.pack("<i", 2031) + tm25(ONE)[8:]),
        ("no_wavelengths.tm25ray", tm25(ONE, spectrum=2)),
        ("kind.tm25ray", tm25(ONE, spectrum=5)),
        ("no_table.tm25ray", tm25(ONE, spectrum=3)),
        ("falling.tm25ray", tm25(ONE, spectrum=3, tables=((600.0, 1.0, 500.0, 1.0),))),
        ("negative.tm25ray", tm25(ONE, spectrum=3, tables=((500.0, -1.0, 600.0, 1.0),))),
        ("no_such_table.tm25ray", NO_SUCH_TABLE),
        ("no_directions.tm25ray", tm25(ONE, (1, 0, 1, 0, 0, 0, 0, 0))),
        ("no_flux.tm25ray", tm25([[0, 0, 0, 0, 0, 1]], (1, 1, 0, 0, 0, 0, 0, 0))),
        ("no_rays.tm25ray", tm25([])),
        ("nan.tm25ray", tm25([[float("nan"), 0, 0, 0, 0, 1, 1]])),
    ],
)
def test_files_that_are_none(name: str, content: str | bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(name):
        read_ray_set(tmp_path / name)

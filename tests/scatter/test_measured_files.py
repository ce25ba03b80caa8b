"""Files of measured scatter: spectra of a polish, BSDFs of Speos, ABg catalogues of OpticStudio."""

import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from command_line import fails, succeeds
from refusals import refused

import mistray  # noqa: F401
from mistray.prescription import Scatter
from mistray.scatter.abg import ABg
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.measured.speos_bsdf import read_speos_bsdf
from mistray.scatter.measured.tabulated import Tabulated
from mistray.scatter.measured.zemax_abg import abg_from_catalogue, read_abg_data
from mistray.scatter.total import lobe_total

POLISH = Path(__file__).parents[1] / "data" / "psd_polish.csv"
TABLE = 2e-3  # relative: power laws between 600 frequencies, and a constant below the first


@pytest.mark.parametrize("theory", ["ghs", "rayleigh_rice", "rayleigh_rice_vector"])
def test_is_the_model_that_was_tabulated(theory: str) -> None:
    event = "reflection" if theory == "rayleigh_rice" else "both"
    known = KCorrelation(4.0, 20.0, 2.5, theory=theory, event=event)
    r = np.geomspace(1e-5, 2, 200)
    for wavelength, n_in, n_out in ((550.0, 1.0, 1.5), (550.0, 1.5, 1.0), (1064.0, 1.0, 1.7)):
        table = PsdTable.read(POLISH, theory=theory, event=event, beyond="slope")
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
    mm, um = tmp_path / "mm.csv", tmp_path / "um.csv"
    mm.write_text("frequency_1_mm,psd_nm2_mm2\n1,1e-3\n10000,1e-7\n")
    um.write_text("# the same\nfrequency_1_um,psd_um4\n0.001,1e-3\n10,1e-7\n")
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


POLAR, AZIMUTH = np.arange(0.0, 90.5, 0.5), np.arange(0.0, 361.0, 30.0)
INCIDENCE = (0.0, 30.0, 60.0)


def speos(path: Path, values, *, of_bsdf: bool = True, total: str = "350\t30\n850\t30", text: str = "") -> Path:
    head = "OPTIS - Anisotropic BSDF surface file v8.0\n0\nComment\n23\nMeasurement description\n0\t1\t0\n1\t0\n"
    head += f"{int(of_bsdf)}\n1\n0.0\n{len(INCIDENCE)}\n" + "\t".join(map(str, INCIDENCE))
    blocks = []
    for incidence in INCIDENCE:
        rows = ["\t".join(map(str, AZIMUTH))]
        rows += ["\t".join(map(str, [t, *(values(incidence, t, p) for p in AZIMUTH)])) for t in POLAR]
        blocks.append(f"{len(POLAR)} {len(AZIMUTH)}\n" + "\n".join(rows))
    lines = total.count("\n") + 1
    path.write_text(f"{head}\t\n0.0\t0\n\n{lines}\n{total}\n" + "\n".join(blocks) + "\n" + text, encoding="utf-8")
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


def test_incidences_and_azimuths_of_speos(tmp_path):
    """The total is that at the first incidence; azimuth 0 is that of the specular direction."""
    file = tmp_path / "a.anisotropicbsdf"
    samples = read_speos_bsdf(speos(file, lambda i, t, p: 2.0 if i == 60 else 1.0))
    assert samples.values[2] == pytest.approx(2 * samples.values[0])
    assert list(samples.specular_deg) == list(INCIDENCE)
    speos(file, lambda i, t, p: math.exp(-((t - i) ** 2 + (180 - abs(p - 180)) ** 2 / 4) / 50))
    samples = read_speos_bsdf(file)
    assert samples.frame == "normal"
    azimuth, polar = np.unravel_index(np.argmax(samples.values[2]), samples.values[2].shape)
    assert (samples.azimuth_deg[azimuth], samples.polar_deg[polar]) == (0.0, 60.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v8.0", "v5.0", "line 1: not an 'OPTIS"),
        ("v8.0\n0\n", "v8.0\n1\n", "line 2: it is in binary mode; save it as text"),
        ("\n1\t0\n1\n", "\n1\t1\n1\n", "line 7: it holds transmission"),
        ("850\t30", "850\t31", "keep one of them"),
        ("\n0.5\t", "\n0.5\tx", "line 21: could not convert"),
        ("0.0\t30.0\t60.0", "0.0\t30.0", "line 12: 2 numbers; 3 are needed"),
    ],
)
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


CATALOGUE = vectors.text("abg_catalogue.dat")


@pytest.fixture
def catalogue(tmp_path: Path) -> Path:
    file = tmp_path / "ABG_DATA.DAT"
    file.write_text(CATALOGUE, encoding="utf-8")
    return file


def test_entries(catalogue: Path) -> None:
    entries = read_abg_data(catalogue)
    assert [(entry.name, entry.line, len(entry.rows)) for entry in entries.values()] == [
        ("Polish 1", 2, 1),
        ("LAMBERT", 6, 2),
        ("steep", 10, 2),
    ]
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

"""Anisotropic BSDF files of Speos: scaled to the total that they state, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.scatter.measured.speos_bsdf import read_speos_bsdf
from mistray.scatter.measured.tabulated import Tabulated

POLAR, AZIMUTH = np.arange(0.0, 90.5, 0.5), np.arange(0.0, 361.0, 30.0)
INCIDENCE = (0.0, 30.0, 60.0)


def speos(path: Path, values, *, of_bsdf: bool = True, total: str = "350\t30\n850\t30", text: str = "") -> Path:
    """A file whose values are a function of the incidence, the polar angle and the azimuth, in degrees."""
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
    file = speos(
        tmp_path / "a.anisotropicbsdf",
        lambda _, t, __: 17.0 * (1.0 if of_bsdf else math.cos(math.radians(t))),
        of_bsdf=of_bsdf,
    )
    samples = read_speos_bsdf(file)
    inside = samples.polar_deg < 89
    # The trapezoids of the integral, 0.5° wide, are exact to 1e-5
    assert samples.values[..., inside] == pytest.approx(0.3 / math.pi, rel=1e-4)
    assert Tabulated.read(file).samples == samples


def test_other_incidences_keep_their_ratio(tmp_path):
    """The total is that at the first incidence; twice the values at 60° are twice the light."""
    samples = read_speos_bsdf(speos(tmp_path / "a.anisotropicbsdf", lambda i, t, p: 2.0 if i == 60 else 1.0))
    assert samples.values[2] == pytest.approx(2 * samples.values[0])
    assert list(samples.specular_deg) == list(INCIDENCE)


def test_azimuth_0_is_that_of_the_specular_direction(tmp_path):
    file = speos(
        tmp_path / "a.anisotropicbsdf",
        lambda i, t, p: math.exp(-((t - i) ** 2 + (180 - abs(p - 180)) ** 2 / 4) / 50),
    )
    samples = read_speos_bsdf(file)
    assert samples.frame == "normal"
    azimuth, polar = np.unravel_index(np.argmax(samples.values[2]), samples.values[2].shape)
    assert (samples.azimuth_deg[azimuth], samples.polar_deg[polar]) == (0.0, 60.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v8.0", "v5.0", "line 1: it is no 'OPTIS"),
        ("v8.0\n0\n", "v8.0\n1\n", "line 2: it is in binary mode; save it as text"),
        ("\n1\t0\n1\n", "\n1\t1\n1\n", "line 7: it holds transmission"),
        ("850\t30", "850\t31", "keep one of them"),
        ("\n0.5\t", "\n0.5\tx", "line 21: could not convert"),
        ("0.0\t30.0\t60.0", "0.0\t30.0", "line 12: 2 numbers; 3 are needed"),
    ],
)
def test_what_is_refused(tmp_path, old, new, message):
    file = speos(tmp_path / "a.anisotropicbsdf", lambda i, t, p: 1.0)
    content = file.read_text(encoding="utf-8")
    assert old in content
    file.write_text(content.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(MistrayError) as found:
        read_speos_bsdf(file)
    assert message in str(found.value)
    assert str(file) in str(found.value)


def test_half_a_file(tmp_path):
    file = speos(tmp_path / "a.anisotropicbsdf", lambda i, t, p: 1.0)
    file.write_text(file.read_text(encoding="utf-8")[:3000], encoding="utf-8")
    with pytest.raises(MistrayError, match=r"copy it again|are needed"):
        read_speos_bsdf(file)

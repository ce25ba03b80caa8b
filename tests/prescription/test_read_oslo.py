"""OSLO files: a doublet by its own numbers, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import peers
import pytest

from mistray.errors import MistrayError
from mistray.io import from_oslo, read_oslo
from mistray.io.optiland import from_optiland
from mistray.materials import refractive_index
from mistray.prescription.sequential.first_order import first_order
from mistray.prescription.sequential.rays import to_world, trace

pytestmark = pytest.mark.quick
DOUBLET = (Path(__file__).parents[1] / "data" / "doublet.len").read_text(encoding="utf-8")


@pytest.fixture
def read(tmp_path: Path) -> Any:
    peers.optiland("fileio.oslo")

    def reader(text: str) -> Any:
        path = tmp_path / "lens of mine.len"
        path.write_text(text, encoding="utf-8")
        return read_oslo(path)

    return reader


def test_a_doublet(read: Any) -> None:
    lens = read(DOUBLET)
    assert lens.source == "OSLO file lens of mine.len"
    assert [row.radius for row in lens.rows[:3]] == pytest.approx([61.47, -44.64, -129.94])
    assert [row.thickness for row in lens.rows[:3]] == pytest.approx([6.0, 2.5, 95.0])
    assert lens.rows[2].conic == -0.5
    assert lens.rows[2].coefficients[0] == pytest.approx(1e-7)
    assert [row.stop for row in lens.rows[:3]] == [True, False, False]
    assert lens.aperture == pytest.approx(25.0)
    assert np.max(lens.fields) == pytest.approx(1.0)
    assert lens.wavelengths_nm == pytest.approx((587.56, 486.13, 656.27))
    assert lens.primary == 0
    assert [row.material for row in lens.rows[:3]] == ["schott/N-BK7", "schott/SF5", "air"]
    n1, n2 = (refractive_index(row.material, 587.56) for row in lens.rows[:2])
    # Thick doublet by hand: the ray at height 1 parallel to the axis
    y, u = 1.0, 0.0
    for row, before, behind in zip(lens.rows, (1.0, n1, n2), (n1, n2, 1.0), strict=False):
        u = (before * u - y * (behind - before) / row.radius) / behind
        y += row.thickness * u
    assert first_order(lens).efl == pytest.approx(-1 / u, rel=1e-9)
    assert 95 < -1 / u < 105


def test_what_is_not_understood_is_one_line(read: Any) -> None:
    for change, message in (
        (("CC -0.5", "GSP 1.0"), "lens of mine.len'"),
        (("GLA N-BK7", "GLA NO-SUCH-GLASS"), "glass 'NO-SUCH-GLASS' is not in"),
        ((DOUBLET, ""), "lens of mine.len'"),
    ):
        with pytest.raises(MistrayError, match=message) as caught:
            read(DOUBLET.replace(*change))
        assert "\n" not in str(caught.value)


def test_without_optiland(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "lens.len"
    path.write_text(DOUBLET)
    with pytest.raises(MistrayError, match="check the path"):
        read_oslo(tmp_path / "none.len")
    monkeypatch.setitem(sys.modules, "optiland.fileio.oslo.reader.converter", None)
    with pytest.raises(MistrayError, match=r"pip install 'optiland>=0\.6\.3'"):
        from_oslo(path)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["CookeTriplet", "DoubleGauss", "HeliarLens", "Telephoto"])
def test_lenses_that_optiland_wrote(name: str, tmp_path: Path) -> None:
    samples, writer = peers.optiland("samples.objectives"), peers.optiland("fileio.oslo")
    path = tmp_path / f"{name} of optiland.len"
    optic = getattr(samples, name)()
    writer.save_oslo_file(optic, str(path))
    found, exact = read_oslo(path), from_optiland(optic)
    start = np.column_stack([*np.random.default_rng(1).uniform(-1, 1, (2, 30)), np.full(30, -1.0)])
    along = np.tile([0.0, 0.01, 1.0], (30, 1))
    last, wanted = (to_world(lens, trace(lens, start, along)[0])[-1] for lens in (found, exact))
    assert np.isfinite(wanted).all()
    assert last == pytest.approx(wanted, abs=2e-6)

"""Report of thermal self-emission: text, CSV, JSON, picture, page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import html_pages
import pandas as pd
import pytest

from mistray.analyses.thermal.figures import narcissus_figure, thermal_figure
from mistray.analyses.thermal.narcissus import NarcissusReturn
from mistray.analyses.thermal.page import page as thermal_page
from mistray.analyses.thermal.page import thermal_text, write_thermal
from mistray.analyses.thermal.result import Emitter, ThermalReport
from mistray.analysis.estimate import UNKNOWN, Estimate
from mistray.report.html.render import html_page


def emitter(name: str, part: str, watts: float, kelvin: float = 293.0, kind: str = "surface") -> Emitter:
    share = Estimate(0.2, 0.01) if part else UNKNOWN
    percent = 100 * watts / 5.01e-6
    return Emitter(name, part, kind, kelvin, 100, share, Estimate(0.1, 0.002), Estimate(watts, 0.02 * watts), percent)


EMITTERS = [emitter(f"tube_{k}", "tube", 1e-6 / 2**k) for k in range(14)]
REPORT = ThermalReport(
    emitters=[
        emitter("lens_<rear>", "lens", 3e-6),
        *EMITTERS,
        emitter("ZnSe", "", 1e-8, kind="medium"),
        emitter("detector", "detector", 0.0, 77.0),
    ],
    total_W_mm2=Estimate(5.01e-6, 4e-8),
    scene_W_mm2=Estimate(7e-6, 3e-8),
    image_W_mm2=Estimate(6e-6, 2e-8),
    to_image=Estimate(0.835, 0.007),
    lost_W_mm2=1e-9,
    self_view=Estimate(0.002, 1e-4),
    nitd_K=Estimate(0.31, 0.02),
    temperature_K=293.0,
    detector_K=77.0,
    scene_K=300.0,
    band_um=(8.0, 12.0),
    wavelengths_um=(8.0, 10.0, 12.0),
    band_error=0.004,
    detector="detector",
    returned=[
        NarcissusReturn(
            "lens_<rear>", "lens", Estimate(0.0015, 1e-4), Estimate(0.25, 0.02), Estimate(0.4, 0.03),
            (Estimate(0.5, 0.03), Estimate(0.3, 0.04)),
        ),
        NarcissusReturn(
            "(total reflection)", "", Estimate(0.0004, 1e-4), Estimate(0.06, 0.02), Estimate(0.06, 0.02),
            (Estimate(0.06, 0.03), Estimate(0.06, 0.04)),
        ),
    ],
    zones_mm=(0.0, 2.0, 3.0),
    facts={"rays": 400000, "seconds": 1.5, "detector_area_mm2": 4.0, "settings": {"max_scatters": 3}},
    notes=["a <note>"],
)  # fmt: skip
ZERO = Estimate(0.0, 0.0)
NOTHING = replace(
    REPORT, emitters=[], total_W_mm2=ZERO, image_W_mm2=ZERO, to_image=UNKNOWN, nitd_K=UNKNOWN, notes=[], returned=[],
    zones_mm=(),
)  # fmt: skip


def test_text() -> None:
    many = thermal_text(replace(REPORT, wavelengths_um=tuple(8 + k / 8 for k in range(33))))
    assert "traced at 33 wavelengths from 8 to 12 µm" in many
    lines = thermal_text(REPORT).splitlines()
    first = next(line for line in lines if line.startswith("lens_<rear>"))
    assert "3.000e-06 ± 6.0e-08" in first
    assert first.endswith("59.9")
    assert any(line.startswith("… and 5 more") for line in lines)
    assert any("NITD" in line and line.endswith("0.310 ± 0.020") for line in lines)
    (back,) = (line.split() for line in lines if line.startswith("lens_<rear>") and line.endswith("0.050"))
    assert " ".join(back) == "lens_<rear> lens 0.00150 ± 0.00010 0.250 ± 0.020 0.400 ± 0.030 0.200 ± 0.050"
    assert "nothing emits" in thermal_text(NOTHING)
    # Sums by part
    parts = REPORT.by_part()
    assert list(parts) == ["lens", "tube", "(ZnSe)", "detector"]
    assert parts["tube"].value == pytest.approx(sum(e.irradiance_W_mm2.value for e in EMITTERS))
    assert parts["tube"].se == pytest.approx(sum(e.irradiance_W_mm2.se for e in EMITTERS)), "a bound"


def test_files(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    files = write_thermal(REPORT, out, "a & b", "mistray thermal system")
    assert {file.name for file in files} == {
        "thermal.csv", "narcissus.csv", "narcissus_field.csv", "thermal.json", "thermal.png", "report.html",
    }  # fmt: skip
    table = pd.read_csv(out / "thermal.csv")
    assert list(table.name) == [e.name for e in REPORT.emitters]
    assert table.irradiance_W_mm2[0] == 3e-6
    assert table.percent[0] == pytest.approx(100 * 3 / 5.01)
    assert list(pd.read_csv(out / "narcissus.csv").nitd_K) == [0.25, 0.06]
    record = json.loads((out / "thermal.json").read_text(encoding="utf-8"))
    assert record["nitd_K"] == 0.31
    assert record["returned"][1]["surface"] == "(total reflection)"
    assert record["narcissus_field"][1] == {
        "surface": "lens_<rear>", "low_mm": 2.0, "high_mm": 3.0, "nitd_K": 0.3, "nitd_K_se": 0.04,
    }  # fmt: skip
    assert record["emitters"][-2]["share"] is None
    assert record == {"title": "a & b", "command": "mistray thermal system"} | record(REPORT)
    text = (out / "report.html").read_text(encoding="utf-8")
    for words in ("a &amp; b", "a &lt;note&gt;", "lens_&lt;rear&gt;"):
        assert words in text
    html_pages.check(text)
    html_pages.check(html_page(thermal_page(NOTHING, "a & b", "mistray thermal a")))


def test_pictures() -> None:
    axes = thermal_figure(REPORT).axes[0]
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert (names[0], len(names)) == ("lens_<rear>", 12)
    assert axes.get_xscale() == "log"
    assert axes.patches[0].get_width() == 3e-6
    assert all(patch.get_width() > axes.get_xlim()[0] for patch in axes.patches)
    lines = [line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1]
    assert {5.01e-6, 6e-6} <= set(lines)
    thermal_figure(NOTHING)
    faint = thermal_figure(replace(REPORT, emitters=[*EMITTERS[:2], emitter("cold", "shield", 1e-18, 4.0)]))
    assert [label.get_text() for label in faint.axes[0].get_yticklabels()] == ["tube_0", "tube_1"], "no empty row"
    (axes,) = narcissus_figure(REPORT).axes
    assert axes.get_xlim() == (0.0, 3.0)
    assert [stairs.get_data().values.tolist() for stairs in axes.patches] == [[500.0, 300.0], [60.0, 60.0]]

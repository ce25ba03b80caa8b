"""Reports of objects, of thermal emission, and of images with stray light."""

import inspect
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import html_pages
import numpy as np
import pandas as pd
import pytest
from oracles.rough_paraboloid import paraboloid_text
from oracles.scatter_scenes import bsdf_xml
from PIL import Image

import mistray
from mistray.analyses.objects import page as output
from mistray.analyses.objects.figures import STYLES, groups, objects_layout
from mistray.analyses.objects.run import objects
from mistray.analyses.thermal.figures import narcissus_figure, thermal_figure
from mistray.analyses.thermal.narcissus import NarcissusReturn
from mistray.analyses.thermal.page import page, thermal_text, write_thermal
from mistray.analyses.thermal.page import record as record_of
from mistray.analyses.thermal.result import Emitter, ThermalReport
from mistray.analyses.transfer.figures import image_figure, mtf_figure, spread_figure
from mistray.analyses.transfer.page import transfer_parts
from mistray.estimate import UNKNOWN, Estimate
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart
from mistray.toolkit.pages.render import html_page
from mistray.toolkit.tables.text import table_text


@pytest.fixture(scope="module")
def found() -> Any:
    return objects(mistray.load("phone_camera_scatter"), rays=20_000, field_deg=[0.0, 30.0])


@pytest.fixture(scope="module")
def estimates(found: Any) -> pd.DataFrame:
    return found.estimates()


def test_text_holds_the_lists(found: Any, estimates: pd.DataFrame) -> None:
    text = output.objects_text(found, estimates, 5)
    for part in ("barrel_6_cone", f"… and {len(found.critical) - 5} more", "aperture stop: stop"):
        assert part in text
    lines = table_text(output.object_table(found.critical, 3)).splitlines()
    assert lines[-1].split()[0] == str(sum(row.rays for row in found.critical[3:]))
    assert table_text(output.object_table([])) == table_text(output.common_table([])) == "none"
    text = table_text(output.estimate_table(found.products, 2))
    assert text.count("… and") == 2
    np.testing.assert_allclose(estimates.groupby("angle_deg").percent.sum(), 100, rtol=1e-12)
    dark = [replace(row, pst=ZERO) for row in found.products]
    assert "no common object scatters" in table_text(output.estimate_table(dark))
    of_shape = groups(found)
    assert set(of_shape.values()) <= set(STYLES)
    expected = {"L1_front": "optics", "barrel_3_cone": "common", "barrel_0_front_face": "illuminated"}
    expected["barrel_7_plane"] = "apart"  # its back is seen, its front is lit
    assert expected.items() <= of_shape.items()
    assert of_shape["L4_edge"] in ("critical", "common")
    (axes,) = objects_layout(found, "camera").axes
    shown = {text.get_text().strip() for text in axes.texts}
    assert shown <= {row.id for row in found.common}
    assert len(shown) >= min(10, len(found.common))


def test_files(found: Any, estimates: pd.DataFrame, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    output.write_objects(found, estimates, out, "a <camera>", "mistray objects x")
    assert list(pd.read_csv(out / "objects_critical.csv").id) == [row.id for row in found.critical]
    tables = output.csv_tables(found)
    assert len(tables["objects_optics.csv"]) == 15
    assert set(tables) == {file.name for file in out.glob("*.csv")}
    record = json.loads(json.dumps(output.record(found), allow_nan=False))
    assert (record["stop"], record["angles_deg"]) == ("stop", [0.0, 30.0])
    assert record["critical"][0]["id"] == found.critical[0].id
    html = (out / "objects.html").read_text(encoding="utf-8")
    html_pages.check(html)
    assert ("a &lt;camera&gt;" in html, "<camera>" in html) == (True, False)


Pair = tuple[float, float]


def emitter(name: str, part: str, watts: float, kelvin: float = 293.0, kind: str = "surface") -> Emitter:
    share = Estimate(0.2, 0.01) if part else UNKNOWN
    percent = 100 * watts / 5.01e-6
    return Emitter(name, part, kind, kelvin, 100, share, Estimate(0.1, 0.002), Estimate(watts, 0.02 * watts), percent)


def back(name: str, part: str, share: float, nitd: Pair, shielded: Pair, zones: Pair) -> NarcissusReturn:
    by_zone = tuple(Estimate(kelvin, se) for kelvin, se in zip(zones, (0.03, 0.04), strict=True))
    return NarcissusReturn(name, part, Estimate(share, 1e-4), Estimate(*nitd), Estimate(*shielded), by_zone)


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
        back("lens_<rear>", "lens", 0.0015, (0.25, 0.02), (0.4, 0.03), (0.5, 0.3)),
        back("(total reflection)", "", 0.0004, (0.06, 0.02), (0.06, 0.02), (0.06, 0.06)),
    ],
    zones_mm=(0.0, 2.0, 3.0),
    facts={"rays": 400000, "seconds": 1.5, "detector_area_mm2": 4.0, "settings": {"max_scatters": 3}},
    notes=["a <note>"],
)
ZERO = Estimate(0.0, 0.0)
DARK = {"total_W_mm2": ZERO, "image_W_mm2": ZERO, "to_image": UNKNOWN, "nitd_K": UNKNOWN, "zones_mm": ()}
NOTHING = replace(REPORT, emitters=[], notes=[], returned=[], **DARK)


def test_thermal_text_and_pictures() -> None:
    lines = thermal_text(REPORT).splitlines()
    assert "3.000e-06 ± 6.0e-08" in next(line for line in lines if line.startswith("lens_<rear>"))
    assert any("NITD" in line and line.endswith("0.310 ± 0.020") for line in lines)
    (back,) = (line.split() for line in lines if line.startswith("lens_<rear>") and line.endswith("0.050"))
    assert " ".join(back) == "lens_<rear> lens 1.50e-03 ± 1.0e-04 0.250 ± 0.020 0.400 ± 0.030 0.200 ± 0.050"
    assert "nothing emits" in thermal_text(NOTHING)
    parts = REPORT.by_part()
    assert list(parts) == ["lens", "tube", "(ZnSe)", "detector"]
    assert parts["tube"].value == pytest.approx(sum(e.irradiance_W_mm2.value for e in EMITTERS))
    assert parts["tube"].se == pytest.approx(sum(e.irradiance_W_mm2.se for e in EMITTERS)), "a bound"
    axes = thermal_figure(REPORT).axes[0]
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert (names[0], len(names)) == ("lens_<rear>", 12)
    assert axes.patches[0].get_width() == 3e-6
    assert all(patch.get_width() > axes.get_xlim()[0] for patch in axes.patches)
    lines = [line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1]
    assert {5.01e-6, 6e-6} <= set(lines)
    assert thermal_figure(REPORT).get_supxlabel().endswith("; 4 more emitters are not drawn")
    eight = narcissus_figure(replace(REPORT, returned=4 * REPORT.returned))
    assert eight.get_supxlabel().endswith("; 2 more surfaces are not drawn")
    assert "drawn" not in thermal_figure(NOTHING).get_supxlabel() + narcissus_figure(REPORT).get_supxlabel()
    (axes,) = narcissus_figure(REPORT).axes
    assert [stairs.get_data().values.tolist() for stairs in axes.patches] == [[500.0, 300.0], [60.0, 60.0]]


def test_thermal_files(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    files = write_thermal(REPORT, out, "a & b", "mistray thermal system")
    assert {"thermal.png", "narcissus_field.csv"} <= {file.name for file in files}
    table = pd.read_csv(out / "thermal.csv")
    assert list(table.name) == [e.name for e in REPORT.emitters]
    assert (table.irradiance_W_mm2[0], table.percent[0]) == (3e-6, pytest.approx(100 * 3 / 5.01))
    assert list(pd.read_csv(out / "narcissus.csv").nitd_K) == [0.25, 0.06]
    record = json.loads((out / "thermal.json").read_text(encoding="utf-8"))
    assert (record["nitd_K"], record["emitters"][-2]["share"]) == (0.31, None)
    zone = {"surface": "lens_<rear>", "low_mm": 2.0, "high_mm": 3.0, "nitd_K": 0.3, "nitd_K_se": 0.04}
    assert record["narcissus_field"][1] == zone
    assert record == {"title": "a & b", "command": "mistray thermal system"} | record_of(REPORT)
    text = (out / "report.html").read_text(encoding="utf-8")
    for words in ("a &amp; b", "a &lt;note&gt;", "lens_&lt;rear&gt;"):
        assert words in text
    html_pages.check(text)
    html_pages.check(html_page(page(NOTHING, "a & b", "mistray thermal a")))


def test_curves_are_those_of_the_result(load_scene, monkeypatch):
    halo = bsdf_xml("abg", A=1e-3, B=1e-6, g=2.0, event="reflection")
    (one,) = mistray.transfer(load_scene(paraboloid_text(halo, detector=5.0)), rays=3000, pixel_mm=0.004)
    left, right = mtf_figure(one, "mirror").axes
    drawn = {line.get_label(): line.get_ydata() for line in left.lines}
    np.testing.assert_allclose(drawn["lens alone, tangential"], one.lens())
    np.testing.assert_allclose(drawn["with stray light and detector, sagittal"], one.composite("sagittal").value)
    lost = {line.get_label(): line.get_ydata() for line in right.lines}
    assert lost["scatter"][-1] == pytest.approx(100 * (1 - one.veiling_floor.value), rel=0.2)
    np.testing.assert_allclose(lost["ghosts"], 0, atol=1e-9)
    irradiance, *rings = spread_figure(one).axes
    assert [line.get_label() for line in irradiance.lines] == ["all light", "direct", "scatter"]
    within, outside = ({line.get_label(): line.get_ydata() for line in axes.lines} for axes in rings)
    np.testing.assert_allclose(within["with stray light"] + outside["with stray light"], 1)
    # An image is drawn as far as the pupil resolves it
    monkeypatch.setattr("mistray.analyses.transfer.figures.WIDTHS", (1e5, 1e6))
    for axes in image_figure(one).axes[:2]:
        left, right, *_ = axes.images[0].get_extent()
        assert right - left == pytest.approx(2e3 * one.image.largest_radius_mm, rel=2e-3)


@pytest.mark.parametrize("options", [{}, {"frequencies_per_mm": [3.0]}, {"frequencies_per_mm": [0.0]}])
def test_no_stray_light_and_few_frequencies(load_scene, options):
    (one,) = mistray.transfer(load_scene(paraboloid_text()), rays=200, **options)
    for draw in (mtf_figure, spread_figure, image_figure):
        picture = Image.open(io.BytesIO(as_png(draw(one, "a $ mirror"))))
        assert np.asarray(picture.convert("L")).std() > 5


def test_an_image_far_out_of_focus_has_words_instead_of_pictures():
    """Of a point 500 mm before a lens for distant objects the wavefront is steeper than any grid of the default."""
    parts = transfer_parts(mistray.transfer(mistray.load("cooke_triplet", "point:0,0,-500"), rays=1000), "triplet")
    assert not any(isinstance(part, FigurePart) for part in parts)
    assert any("wavefront" in str(part) and "focus" in str(part) for part in parts)


def test_reports_of_all_analyses_are_written_alike() -> None:
    """By a function of the result, the folder, and the command line that the page quotes."""
    report = mistray.report
    for write in (report.write_objects, report.write_study, report.write_thermal, report.write_quality):
        assert {"directory", "command"} <= set(list(inspect.signature(write).parameters)[1:])
    for text in (report.objects_text, report.study_text, report.thermal_text, report.quality_text):
        assert not {"directory", "command"} & set(inspect.signature(text).parameters)

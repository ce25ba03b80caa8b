"""A known PST: its saved state, paths, causes, breaks, and tables, pictures and files that say what it holds."""

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import html_pages
import numpy as np
import pandas as pd
import pytest
from analyses.fake_pst import FACTS, fake_pst
from matplotlib.collections import PolyCollection, QuadMesh
from refusals import each_refused, refused
from scene_dicts import detector, load

import mistray
from mistray.analyses.pst import causes, tables
from mistray.analyses.pst.causes import breaks, cause_frame, field_edge, main_cause, stray_paths
from mistray.analyses.pst.figures import pst_causes, pst_curve, pst_irradiance, pst_map
from mistray.analyses.pst.found_paths import PATHS_LISTED
from mistray.analyses.pst.metrics.first_light import first_light
from mistray.analyses.pst.page import pst_report, pst_verdict, write_pst
from mistray.analyses.pst.progress import PstProgress
from mistray.analyses.pst.result import CLASSES, Pst
from mistray.files.saved_state import load_state, require_same, save_state
from mistray.recorders.directions import DirectionGrid
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.render import html_page

GRID = {"angles_deg": list(range(0, 81, 2)), "azimuth_cell_deg": 360.0}
LIMITS = {"max_scatters": 1, "seed": 0, "aim": "auto"}
SIGNATURE = {"scene": "0123456789abcdef" * 4, "grid": GRID, "wavelength_nm": [550.0], "settings": LIMITS}
ARRAYS = {
    "sums": np.arange(24.0).reshape(2, 3, 4),
    "events": np.array([["L1_front:T", "détecteur:A"]]),
    "file": np.array([1, 2], dtype=np.uint32),  # also an argument of numpy.savez
    "facts": np.zeros((0, 3)),
}


def test_all_comes_back_and_progress(tmp_path: Path) -> None:
    path = tmp_path / "new" / "state.npz"
    facts = {"signature": SIGNATURE, "rays": np.int64(7), "worst": np.float64(math.inf), "sizes": np.array([1, 2])}
    assert save_state(path, ARRAYS, facts) == path
    arrays, found = load_state(path)
    assert set(arrays) == set(ARRAYS)
    for name, values in ARRAYS.items():
        assert arrays[name].dtype == values.dtype
        np.testing.assert_array_equal(arrays[name], values)
    assert found == {"signature": SIGNATURE, "rays": 7, "worst": math.inf, "sizes": [1, 2]}
    assert [entry.name for entry in path.parent.iterdir()] == ["state.npz"]
    with np.load(path, allow_pickle=False) as archive:  # a plain one of NumPy
        np.testing.assert_array_equal(archive["array_sums"], ARRAYS["sums"])
        assert json.loads(str(archive["facts"]))["facts"]["rays"] == 7
    # Tuples and NumPy's numbers are what they are after a while in a file
    save_state(path, {}, {"signature": SIGNATURE | {"size": (3, 4), "gap": math.nan}})
    same = SIGNATURE | {"size": np.array([3, 4]), "wavelength_nm": (np.float64(550),), "gap": np.float64(math.nan)}
    require_same("s.npz", load_state(path)[1], same)
    for now, seconds_left, share_done in (
        # Error 4 % after 1e6 rays in 10 s: 2 % needs 4e6 rays, three times as many again
        (PstProgress.after(1_000_000, 10_000_000, 0.04, 0.02, 10.0), 30.0, 0.25),
        (PstProgress.after(1_000_000, 2_000_000, 0.04, 0.001, 10.0), 10.0, 0.5),  # ends with the rays planned
        (PstProgress.after(1_000_000, 5_000_000, 0.04, None, 10.0), 40.0, 0.2),
        (PstProgress.after(1_000_000, 5_000_000, math.inf, 0.02, 10.0), 40.0, 0.2),  # a dark angle
        # 3e6 rays came from the saved run; the 1e6 since then took 10 s
        (PstProgress.after(4_000_000, 6_000_000, 0.04, None, 10.0, rays_before=3_000_000), 20.0, 2 / 3),
        (PstProgress.after(3_000_000, 6_000_000, 0.04, None, 0.1, rays_before=3_000_000), math.nan, 0.5),
        (PstProgress.after(4_000_000, 9_000_000, 0.019, 0.02, 10.0), 0.0, 1.0),
    ):
        assert (now.seconds_left, now.share_done) == pytest.approx((seconds_left, share_done), nan_ok=True)


def test_files_that_are_none_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "s.npz"
    with refused("array 'names' holds objects"):
        save_state(path, {"names": np.array([object()])}, {})
    assert list(tmp_path.iterdir()) == []
    with refused("no such file; run once without resuming"):
        load_state(path)
    save_state(path, ARRAYS, {"rays": 1})
    with refused(r"state '.*s\.npz': .*choose another folder"):
        save_state(path / "s.npz", ARRAYS, {})
    whole = path.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(sys.modules[load_state.__module__], "FORM", 99)
        with refused("another version of mistray"):
            load_state(path)
    flipped = bytearray(whole)
    flipped[whole.index(ARRAYS["sums"].tobytes()[8:64])] ^= 0xFF
    np.savez(path, a=np.zeros(3))
    for content in (b"", whole[: len(whole) // 2], bytes(flipped), path.read_bytes(), b"\x80\x04N."):
        path.write_bytes(content)
        with refused("is damaged or no state; remove it and run without resuming"):
            load_state(path)
    each_refused(
        ({"settings": {"max_scatters": 1, "seed": 0}}, "settings.aim was auto and is absent;"),
        ({"grid": GRID | {"angles_deg": [0, 2, 5, *range(6, 81, 2)]}}, "value 3 of grid.angles_deg"),
        by=lambda change: require_same("s.npz", {"signature": SIGNATURE}, SIGNATURE | change),
        pattern=r"^state 's\.npz' belongs to another run: .*{}",
    )
    places = [math.nan, *range(7)]  # none differs from none
    require_same("s.npz", {"signature": {"places": places}}, {"places": [math.nan, *np.arange(7.0)]})
    with refused("value 8 of places was 6 and is 9;"):
        require_same("s.npz", {"signature": {"places": places}}, {"places": [math.nan, *np.arange(6.0), 9]})


BATCHES = 32
ANGLES = np.arange(0.0, 81.0, 2.0)


def curve(level: np.ndarray, noise: float = 0.02, seed: int = 5) -> Pst:
    """A PST of single scatter with given levels at `ANGLES`; `noise` is the relative error of a point."""
    rng = np.random.default_rng(seed)
    samples = level[:, None] * (1 + noise * np.sqrt(BATCHES) * rng.standard_normal((len(level), BATCHES)))
    by_batch = np.zeros((len(CLASSES), len(level), 1, BATCHES))
    by_batch[CLASSES.index("single_scatter"), :, 0] = samples
    return Pst(DirectionGrid.of(ANGLES), by_batch, np.full(BATCHES, 1 / BATCHES))


def bent(angles: np.ndarray) -> np.ndarray:
    """log10: -0.02 per degree to 20°, -0.2 to 30°, then -0.01."""
    return -3 - np.interp(angles, [0, 20, 30, 80], [0, 0.4, 2.4, 2.9])


@pytest.mark.long
def test_errors_of_pixels_count_all_rays_of_unscattered_light() -> None:
    """Direct light that most of its many rays of a sixteenth of the weight bring, as one path and as one pixel."""
    paint = {"type": "interface", "R": 0.0, "scatter": {"type": "paint", "reflectance": 0.1}}
    scene = load(
        source={"type": "collimated", "radius": 5.0},
        tube={"type": "frustum", "r0": 6.0, "z0": 0.0, "r1": 6.0, "z1": 20.0, "bsdf": paint},
        detector=detector(20.0, half_width=4.0, half_height=4.0),
    )
    found = mistray.pst(scene, [5], rays=1 << 14, cell_deg=4.0, max_scatters=1, map_pixels=1)
    direct, (value, se) = found.paths(5).iloc[0], found.curve("direct")
    assert (direct.kind, direct.pst) == ("direct", pytest.approx(value[0], rel=1e-6))
    assert direct.pst_se == pytest.approx(se[0], rel=1e-6)
    # Stratified rays have smaller errors than those of a pixel, which takes them for independent
    assert se[0] < found.maps[1].item() < 3 * se[0]


def test_breaks_are_where_the_slope_changes():
    """A false alarm is a smooth point 4 standard errors off: 39 points, t of 31 degrees of freedom, below 0.02."""
    found = breaks(curve(10.0 ** bent(ANGLES)))
    assert [b.field_deg for b in found] == [20.0, 30.0]
    first, second = found
    assert (first.slope_before, first.slope_after) == pytest.approx((-0.02, -0.2), abs=0.03)
    assert first.change < 0 < second.change
    # Three independent points of 2 %: sqrt(1 + 4 + 1) · 0.02 / ln(10) / 2°
    assert first.change_se == pytest.approx(np.sqrt(6) * 0.02 / np.log(10) / 2, rel=0.4)
    assert first.before == ()
    # One factor on all angles of a batch changes no slope: the error of a change vanishes, that of the curve stays
    pst = curve((10.0 ** bent(ANGLES)), 0.0)
    pst.by_batch[:] *= 1 + 0.5 * np.random.default_rng(3).standard_normal(BATCHES)
    found = breaks(pst)
    assert pst.standard_error[0] > 0.05 * pst.value[0]
    assert [b.field_deg for b in found] == [20.0, 30.0]
    assert found[0].change_se < 1e-9
    # Points of 20 % error change the slope by more than the least change, but not by four standard errors
    for noise in (0.02, 0.2):
        assert breaks(curve(10.0 ** (-3 - 2.9 * ANGLES / 80), noise)) == []


def test_causes_add_up_and_are_named():
    pst = fake_pst()
    table = cause_frame(pst)
    named = {"ghosts", "window_front", "barrel_1", "stop_wall", "barrel_1 (reflects)", "straight shots"}
    assert set(table.columns) == named
    np.testing.assert_allclose(table.sum(axis=1), 100)
    assert causes.strongest(pst, 10.0, 1)[0][0].startswith("ghosts such as detector → L1_rear")
    shares = pd.DataFrame({"a": [60.0, 70.0, 10.0, 0.0, 51.0], "b": [40.0, 30.0, 90.0, 0.0, 49.0]}, [0, 2, 4, 6, 8])
    assert causes.reigns(shares) == [(0, 2, "a", 60, 70), (4, 4, "b", 90, 90), (8, 8, "a", 51, 51)]
    (name, share), *_ = next(b for b in breaks(pst) if b.field_deg == 22.0).before
    rows = pst.paths(20.0)
    assert name == "barrel_1 (reflects)"
    stray = rows[rows.kind != "direct"].pst.sum()
    assert share == pytest.approx(100 * rows.pst[rows.kind == "structure"].sum() / stray)
    pst = fake_pst(field_deg=(0, 30))
    table = causes.first_level_scatter(pst)
    at_30 = table[table.angle_deg == 30].set_index("surface")
    assert at_30.index[0] == "barrel_1"
    paths = pst.paths(30.0).set_index("events")
    alone = paths.pst["L1_front:T barrel_1:r detector:A"]
    assert at_30.pst["barrel_1"] == alone  # the path scattered twice, whose first is barrel_1 too, is left out
    assert at_30.percent_of_first_level.sum() == pytest.approx(100)
    assert at_30.percent_of_stray.sum() < 100


def test_the_main_cause_brings_most_of_the_light_of_a_uniform_sky():
    pst = fake_pst()
    light: dict[str, dict[float, float]] = {}
    for angle, (first, last) in zip(pst.field_deg, np.radians(pst.grid.edges_deg), strict=True):
        for row in stray_paths(pst, angle).itertuples():
            name = row.scatter_1 if row.scatters else row.kind
            at = light.setdefault(name, {})
            at[angle] = at.get(angle, 0.0) + row.pst * (np.cos(first) - np.cos(last))
    sums = {name: sum(at.values()) for name, at in light.items()}
    name = max(sums, key=lambda cause: sums[cause])
    found = main_cause(pst)
    assert (name, found.cause) == ("ghost", "ghosts")
    assert found.percent.value == pytest.approx(100 * sums[name] / sum(sums.values()))
    assert 0 < found.percent.se < 5
    assert found.field_deg == max(light[name], key=lambda angle: light[name][angle])
    k = int(np.flatnonzero(pst.field_deg == found.field_deg)[0])
    assert found.stray.value == pytest.approx(pst.stray[k], rel=0.05)
    own = sum(row.pst for row in stray_paths(pst, found.field_deg).itertuples() if row.kind == name)
    assert found.left.value == pytest.approx(found.stray.value - own)
    # The sky is the same for either convention of the PST; PST_projected cos θ = PST_normal
    projected = main_cause(pst.to("projected"))
    assert (projected.cause, projected.field_deg) == (found.cause, found.field_deg)
    assert projected.percent == pytest.approx(found.percent, rel=1e-12)
    for one in ("stray", "left"):
        value = pst.grid.mean_cosine[k] * getattr(projected, one).value
        assert value == pytest.approx(getattr(found, one).value, rel=1e-12)
    assert main_cause(fake_pst(paths=False)) is main_cause(fake_pst(dark_from_deg=-1.0)) is None


def test_a_new_first_surface_in_many_azimuths() -> None:
    """A path ten times as strong as the weakest listed one was not left out before, whatever the number of azimuths."""
    azimuths, front, hood = 36, "front:T detector:A", "hood:r detector:A"
    bare = fake_pst([10.0], np.arange(0.0, 360.0, 360 / azimuths), paths=False)

    def of(*paths: tuple[str, float]) -> Pst:
        rows = [(0, j, events, "single_scatter", value, 0.0) for j in range(azimuths) for events, value in paths]
        columns = ["cell", "azimuth_cell", "events", "kind", "pst_normal", "pst_normal_se"]
        return replace(bare, path_rows=pd.DataFrame(rows, columns=columns))

    before, weaker = [(front, 1.0), *[(front, 0.01)] * (PATHS_LISTED - 1)], [(hood, 0.009)] * 10
    (one,) = first_light(of(*before, (hood, 0.1)), 0).since(first_light(of(*before), 0))
    assert one.surface == "hood"
    assert first_light(of(*before, *weaker), 0).since(first_light(of(*before), 0)) == ()


@pytest.fixture(scope="module")
def pst() -> Pst:
    return fake_pst()


@pytest.fixture(scope="module")
def around() -> Pst:
    return fake_pst(field_deg=(0, 20, 40), azimuths_deg=(0, 90, 180, 270), map_pixels=8)


def rows(text: str) -> list[list[str]]:
    """Cells of the rows below the rule of a table."""
    lines = text.splitlines()
    rule = next(k for k, line in enumerate(lines) if set(line) <= {"-", " "} and line.strip())
    return [[cell.strip() for cell in line.split("  ") if cell.strip()] for line in lines[rule + 1 :]]


def test_curve_frame_holds_the_means_of_the_batches(pst: Pst, around: Pst) -> None:
    frame = tables.curve_frame(pst)
    batches = pst.by_batch[:, :, 0]  # (c, n, b)
    total, stray = batches.sum(axis=0), batches[1:].sum(axis=0)
    np.testing.assert_allclose(frame.pst_total, total.mean(axis=-1), rtol=1e-12)
    np.testing.assert_allclose(frame.pst_stray_se, stray.std(axis=-1, ddof=1) / np.sqrt(32), rtol=1e-9)
    for k, name in enumerate(CLASSES):
        np.testing.assert_allclose(frame[f"pst_{name}"], batches[k].mean(axis=-1), rtol=1e-12)
    assert [*frame.largest_share[[0, 40]], *frame.angle_from_deg[:2]] == [0.002, 0.31, 0.0, 1.0]
    low, high = np.radians(pst.grid.edges_deg).T
    ratio = tables.curve_frame(pst.to("projected")).pst_total / frame.pst_total
    np.testing.assert_allclose(ratio, 2 / (np.cos(low) + np.cos(high)), rtol=1e-12)
    # The edge of the field is where direct light is half
    edge = field_edge(fake_pst(field_deg=np.arange(0, 40, 0.5), noise=1e-3))
    assert edge == pytest.approx(26.0, abs=0.05)  # of the logistic edge that the camera has
    assert field_edge(fake_pst(field_deg=(0, 5, 10))) is field_edge(fake_pst(field_deg=(40, 50))) is None
    assert fake_pst().notes == FACTS["notes"]
    (noisy,) = fake_pst(field_deg=(0, 70, 80), noise=0.5, notes=[]).notes
    assert re.match("standard error up to .* at 70, 80°", noisy)
    assert "angles from" in fake_pst(noise=1.0, notes=[]).notes[0]
    cells = tables.cell_frame(around)
    means = cells.pst_total.to_numpy().reshape(3, 4).mean(axis=1)
    np.testing.assert_allclose(means, tables.curve_frame(around).pst_total, rtol=1e-12)
    assert set(cells.largest_share) == {0.002}
    frame = tables.path_frame(around)
    of_cells = frame.groupby(["angle_deg", "azimuth_deg"])
    assert len(of_cells) == 12
    for _, part in of_cells:
        assert list(part["rank"]) == list(range(1, len(part) + 1))
        assert part.pst.is_monotonic_decreasing
    np.testing.assert_allclose(of_cells.percent_of_stray.sum(), 100, rtol=1e-6)
    assert frame.percent_of_stray.isna().sum() == (frame.kind == "direct").sum()
    merged = stray_paths(around, 40.0).set_index("events")
    each = [around.paths(40.0, azimuth).set_index("events") for azimuth in (0, 90, 180, 270)]
    name = "L1_front:T barrel_1:r detector:A"
    np.testing.assert_allclose(merged.pst[name], np.mean([part.pst[name] for part in each]), rtol=1e-12)
    np.testing.assert_allclose(merged.pst_se[name], np.linalg.norm([part.pst_se[name] for part in each]) / 4)
    assert merged.rays[name] == sum(part.rays[name] for part in each)
    assert merged.percent_of_stray.sum() == pytest.approx(100)
    opposite = fake_pst(field_deg=(-40, -20), azimuths_deg=(0,))  # whose cells are at an azimuth of 180°
    assert stray_paths(opposite, -40.0).equals(stray_paths(opposite, 40.0))


def test_text_with_the_numbers_and_their_errors(pst: Pst) -> None:
    text = tables.curve_text(pst)
    table = rows(text)
    assert len(table) == 41
    angle, total, stray, *classes, share = table[20]
    value, _, error = stray.partition(" ± ")
    assert (angle, total, classes[0], float(share)) == ("40", stray, "–", 0.2)  # no direct light there
    assert float(value) == pytest.approx(pst.stray[20], rel=0.02)
    assert float(error) == pytest.approx(pst.stray_se[20], rel=0.1)
    assert stray_paths(pst, 44.0).label.isin(["straight shot"]).sum() == 1
    assert rows(tables.curve_text(fake_pst(dark_from_deg=50)))[-1][:-1] == ["80", *["–"] * 7]
    expected = stray_paths(pst, 20.0, 2)
    angle, *both = rows(tables.top_paths_text(pst, 2))[10]
    assert (angle, both[::2]) == ("20", ["barrel_1 (structure)", "detector → L1_rear"])
    assert both[::2] == list(expected.label)
    assert [float(share) for share in both[1::2]] == pytest.approx(list(expected.percent_of_stray), rel=5e-3)
    text = tables.pst_text(pst)
    assert "edge of the field, half of the direct light at 0°, interpolated: 26.1°" in text
    assert "Strongest stray paths" not in tables.pst_text(fake_pst(paths=False))
    assert "Strongest stray paths" not in tables.pst_text(pst, 0)
    breaks = rows(text[text.index("Breaks of the curve") : text.index("±: one standard error")])
    assert any("ghosts" in row[3] and "barrel_1 (reflects)" in row[4] for row in breaks if len(row) == 5)
    dark = fake_pst(dark_from_deg=0, notes=["PST is 0: it sees no opening"])
    assert dark.is_dark
    assert "no stray light was seen" in tables.pst_text(dark)
    record = tables.pst_record(dark)
    assert record["field_edge_deg"] is None
    assert all(row["pst_total"] == 0 for row in record["curve"])
    assert "it sees no opening" in html_page(pst_report(dark))


def test_a_run_whose_time_was_up_at_an_azimuth_of_every_angle(around: Pst) -> None:
    """Means over the azimuths are unknown then, while the cells that were traced are drawn in the map."""
    by_batch, rows = around.by_batch.copy(), around.path_rows
    by_batch[:, :, 1] = np.nan
    cut = replace(around, by_batch=by_batch, path_rows=rows[rows.azimuth_cell != 1], maps=None)
    assert field_edge(cut) is None
    assert texts(pst_curve(cut).axes[0]) == ["no angle with light was traced at all azimuths"]
    assert "no stray light was seen at angles that were traced at all azimuths" in tables.pst_text(cut)
    record = tables.pst_record(cut)
    assert (record["field_edge_deg"], record["curve"][0]["pst_total"]) == (None, None)
    assert record["cells"][0]["pst_total"] == pytest.approx(around.map()[0][0, 0])
    assert pst_verdict(cut) == ["PST(0°) = <b>–</b>."]
    # Of an azimuth that lacks the smallest angle alone the edge is unknown, as it is relative to that
    by_batch = around.by_batch.copy()
    by_batch[:, 0, 1] = np.nan
    assert field_edge(replace(around, by_batch=by_batch)) is None


def test_files(around: Pst, tmp_path: Path) -> None:
    written = tmp_path / "new" / "out"
    files = write_pst(around, written, "a <b> & c", "mistray pst 'a <b> & c'", 3, [(20.0, 90.0), (40.0, 0.0)])
    assert {file.name for file in files} == {entry.name for entry in written.iterdir()}
    assert {file.name for file in written.iterdir()} == {
        "pst.csv", "pst_cells.csv", "pst_paths.csv", "pst.png", "pst_causes.png", "pst_map.png",
        "irradiance_20deg_90deg.png", "irradiance_40deg_0deg.png", "pst.json", "report.html",
    }  # fmt: skip
    curve = pd.read_csv(written / "pst.csv")
    assert curve.pst_stray.to_list() == pytest.approx(list(around.stray), rel=1e-8)
    assert len(pd.read_csv(written / "pst_cells.csv")) == 12
    assert len(pd.read_csv(written / "pst_paths.csv")) == len(around.path_rows)
    files = write_pst(fake_pst(field_deg=(0, 20), paths=False), tmp_path)
    assert {file.name for file in files} == {"pst.csv", "pst.png", "pst.json", "report.html"}
    record = json.loads((written / "pst.json").read_text(encoding="utf-8"))
    assert (record["title"], record["convention"]) == ("a <b> & c", "normal")
    assert record["curve"][1]["pst_total"] == pytest.approx(around.value[1])
    assert [len(row["paths"]) for row in record["curve"]] == [3, 3, 3]
    assert (len(record["cells"]), record["facts"]["seed"]) == (12, 0)
    assert "cells" not in tables.pst_record(fake_pst(field_deg=(0, 20)))
    text = (written / "report.html").read_text(encoding="utf-8")
    html_pages.check(text)
    assert "a <b> & c" not in text
    assert "Point source transmittance: a &lt;b&gt; &amp; c" in text
    assert "single rays carry more than 10\xa0%" in text
    assert html_pages.table_of(text, "t-paths").count("<tr>") == 1 + 3 * len(around.field_deg)


@pytest.fixture(scope="module")
def mapped() -> Pst:
    return fake_pst(map_pixels=16, relative_error=0.02, error_up_to_deg=60)


def lines(axes: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axes.get_lines()}


def texts(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_curve_shows_every_class_with_its_error(mapped: Pst) -> None:
    above, below = pst_curve(mapped, "camera").axes
    names = {"all light": "total", "stray light: all but direct": "stray", "direct image": "direct", "ghosts": "ghost",
             "single scatter": "single_scatter", "multiple scatter": "multiple_scatter",
             "straight shots": "straight_shot"}  # fmt: skip
    for label, group in names.items():
        value = mapped.curve(group)[0]
        np.testing.assert_array_equal(lines(above)[label].get_ydata(), np.where(value > 0, value, np.nan))
    assert "edge of the field, 26.1°" in texts(above)
    # Bands are one standard error, which stands below with the one that was asked for
    bands = [item for item in above.collections if isinstance(item, PolyCollection)]
    for band, group in zip(bands, ("stray", "total"), strict=False):
        value, se = mapped.curve(group)
        vertices = band.get_paths()[0].vertices
        at_40 = vertices[np.isclose(vertices[:, 0], 40.0)][:, 1]
        np.testing.assert_allclose([at_40.min(), at_40.max()], [value[20] - se[20], value[20] + se[20]], rtol=1e-9)
    errors = lines(below)
    np.testing.assert_allclose(errors["standard error, all light"].get_ydata(), 100 * se / value)
    np.testing.assert_allclose(errors["requested error"].get_xydata(), [[0, 2], [60, 2]])
    np.testing.assert_allclose(errors["largest ray of scatter"].get_ydata()[[0, -1]], [0.2, 31])
    # A point without neighbours has its error, too
    few = fake_pst(field_deg=(0, 10, 45, 60))  # straight shots at 45° only
    value, se = few.curve("straight_shot")
    segments = [line for item in pst_curve(few).axes[0].collections for line in getattr(item, "get_segments", list)()]
    (bar,) = [line for line in segments if line[0][0] == 45.0]
    np.testing.assert_allclose(bar[:, 1], [value[2] - se[2], value[2] + se[2]])


def test_dark_angles_and_deep_curves() -> None:
    """Angles without light are marked at the bottom; ten decades between the field and 80° are within the axis."""
    above = pst_curve(fake_pst(dark_from_deg=55)).axes[0]
    marks = lines(above)["no light found"]
    np.testing.assert_array_equal(marks.get_xdata(), np.arange(56, 81, 2))
    assert np.all(marks.get_ydata() < 10 * above.get_ylim()[0])
    deep = fake_pst()
    deep.by_batch[:, 20:] *= 1e-6
    low, high = pst_curve(deep).axes[0].get_ylim()
    assert low < deep.value.min() < deep.value.max() < high
    dark = fake_pst(azimuths_deg=(0, 90), dark_from_deg=0)
    assert texts(pst_curve(dark).axes[0]) == ["no light was seen"]
    for draw in (pst_causes, pst_map):
        assert as_png(draw(dark)).startswith(b"\x89PNG")


def test_causes_are_stacked_shares_and_irradiance_a_log_map(mapped: Pst) -> None:
    axes, table, tops = pst_causes(mapped).axes[0], cause_frame(mapped), np.zeros(41)
    for bars, name in zip(axes.containers, table.columns, strict=True):
        assert bars.get_label() == name
        np.testing.assert_allclose([bar.get_y() for bar in bars], tops)
        np.testing.assert_allclose([bar.get_height() for bar in bars], table[name], atol=1e-12)
        tops += table[name]
    np.testing.assert_allclose(tops, 100, rtol=1e-6)
    few = fake_pst(field_deg=(0, 20, 40))
    walls = ({"scatter_1": f"wall_{k}", "events": f"wall_{k}:r detector:A"} for k in range(12))
    many = replace(few, path_rows=pd.concat([few.path_rows.assign(**wall) for wall in walls], ignore_index=True))
    labels = [bars.get_label() for bars in pst_causes(many).axes[0].containers]
    assert len(labels) == 10
    assert labels[-1].endswith(" more")
    axes, _ = pst_irradiance(mapped, 40.0).axes
    (image,) = axes.get_images()
    np.testing.assert_allclose(image.get_array(), np.log10(mapped.irradiance(40.0)[0]))
    assert tuple(image.get_extent()) == mapped.extent_mm
    several = fake_pst(field_deg=(0, 60), azimuths_deg=(0, 90), map_pixels=4, dark_from_deg=50)
    assert texts(pst_irradiance(several, 60.0, 90.0).axes[0]) == ["no light"]


def test_map_shows_the_cells_where_they_are(mapped: Pst) -> None:
    around = fake_pst(field_deg=(10, 20, 40), azimuths_deg=(0, 90, 200))
    panels = [axes for axes in pst_map(around).axes if axes.name == "polar"]
    for axes, group in zip(panels, ("total", "stray"), strict=True):
        (mesh,) = [item for item in axes.collections if isinstance(item, QuadMesh)]
        corners, shown = mesh.get_coordinates(), mesh.get_array()
        middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
        value = around.map(group)[0]
        for i, angle in enumerate(around.field_deg):
            for j, azimuth in enumerate(around.grid.azimuths_deg):
                turned = np.degrees(middle[..., 0]) - azimuth
                here = (np.abs((turned + 180) % 360 - 180) < 1.0) & np.isclose(middle[..., 1], angle)
                assert here.any()
                np.testing.assert_allclose(shown[here], np.log10(value[i, j]))
        between = np.isclose(middle[..., 1], 15.0)
        assert between.any()
        assert np.ma.getmaskarray(shown)[between].all()
    with refused("two azimuths or more"):
        pst_map(mapped)

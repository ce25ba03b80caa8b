"""The saved state of a run, and paths, causes and breaks of a PST that is known."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from analyses.fake_pst import fake_pst

from mistray.analyses.pst import causes
from mistray.analyses.pst.causes import breaks, main_cause, stray_paths
from mistray.analyses.pst.result import CLASSES, Pst
from mistray.analyses.pst.state import PstProgress
from mistray.errors import MistrayError
from mistray.files.saved_state import load_state, require_same, save_state
from mistray.recorders.directions import DirectionGrid

SIGNATURE = {
    "scene": "0123456789abcdef" * 4,
    "grid": {"angles_deg": list(range(0, 81, 2)), "azimuth_cell_deg": 360.0},
    "wavelength_nm": [550.0],
    "settings": {"max_scatters": 1, "seed": 0, "aim": "auto"},
}
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
    with pytest.raises(MistrayError, match="array 'names' holds objects"):
        save_state(path, {"names": np.array([object()])}, {})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(MistrayError, match="no such file; run once without resuming"):
        load_state(path)
    save_state(path, ARRAYS, {"rays": 1})
    with pytest.raises(MistrayError, match=r"state '.*s\.npz': .*choose another folder"):
        save_state(path / "s.npz", ARRAYS, {})
    whole = path.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(sys.modules[load_state.__module__], "FORM", 99)
        with pytest.raises(MistrayError, match="another version of mistray"):
            load_state(path)
    flipped = bytearray(whole)
    flipped[whole.index(ARRAYS["sums"].tobytes()[8:64])] ^= 0xFF
    np.savez(path, a=np.zeros(3))
    for content in (b"", whole[: len(whole) // 2], bytes(flipped), path.read_bytes(), b"\x80\x04N."):
        path.write_bytes(content)
        with pytest.raises(MistrayError, match="is damaged or no state; remove it and run without resuming"):
            load_state(path)

    grid = {"angles_deg": [0, 2, 5, *range(6, 81, 2)], "azimuth_cell_deg": 360.0}
    absent = {"settings": {"max_scatters": 1, "seed": 0}}
    for change, text in (
        (absent, "settings.aim was auto and is absent;"),
        ({"grid": grid}, "value 3 of grid.angles_deg"),
    ):
        with pytest.raises(MistrayError, match=rf"^state 's\.npz' belongs to another run: .*{text}"):
            require_same("s.npz", {"signature": SIGNATURE}, SIGNATURE | change)


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


def test_breaks_are_where_the_slope_changes():
    """A false alarm is a smooth point 4 standard errors off: 39 points, t of 31 degrees of freedom, below 0.02."""
    found = breaks(curve(10.0 ** bent(ANGLES)))
    assert [b.field_deg for b in found] == [20.0, 30.0]
    first, second = found
    assert first.slope_before == pytest.approx(-0.02, abs=0.03)
    assert first.slope_after == pytest.approx(-0.2, abs=0.03)
    assert first.change < 0 < second.change
    # Three independent points of 2 %: sqrt(1 + 4 + 1) · 0.02 / ln(10) / 2°
    assert first.change_se == pytest.approx(np.sqrt(6) * 0.02 / np.log(10) / 2, rel=0.4)
    assert first.before == ()
    # One factor on all angles of a batch changes no slope: the error of a change vanishes, that of the curve stays
    rng = np.random.default_rng(3)
    shared = 1 + 0.5 * rng.standard_normal(BATCHES)
    pst = curve((10.0 ** bent(ANGLES)), 0.0)
    pst.by_batch[:] *= shared
    found = breaks(pst)
    assert pst.standard_error[0] > 0.05 * pst.value[0]
    assert [b.field_deg for b in found] == [20.0, 30.0]
    assert found[0].change_se < 1e-9

    # Points of 20 % error change the slope by more than the least change, but not by four standard errors
    for noise in (0.02, 0.2):
        assert breaks(curve(10.0 ** (-3 - 2.9 * ANGLES / 80), noise)) == []


def test_causes_add_up_and_are_named():
    table = causes.cause_frame(fake_pst())
    named = {"ghosts", "window_front", "barrel_1", "stop_wall", "barrel_1 (reflects)", "straight shots"}
    assert set(table.columns) == named
    np.testing.assert_allclose(table.sum(axis=1), 100)
    words = causes.strongest(fake_pst(), 10.0, 1)
    assert words[0][0].startswith("ghosts such as detector → L1_rear")
    shares = pd.DataFrame({"a": [60.0, 70.0, 10.0, 0.0, 51.0], "b": [40.0, 30.0, 90.0, 0.0, 49.0]}, [0, 2, 4, 6, 8])
    assert causes.reigns(shares) == [(0, 2, "a", 60, 70), (4, 4, "b", 90, 90), (8, 8, "a", 51, 51)]
    pst = fake_pst()
    found = next(b for b in breaks(pst) if b.field_deg == 22.0)
    (name, share), *_ = found.before
    rows = pst.paths(20.0)
    assert name == "barrel_1 (reflects)"
    stray = rows[rows.kind != "direct"].pst.sum()
    assert share == pytest.approx(100 * rows.pst[rows.kind == "structure"].sum() / stray)
    pst = fake_pst(field_deg=(0, 30))
    table = causes.first_level_scatter(pst)
    at_30 = table[table.angle_deg == 30].set_index("surface")
    assert next(iter(at_30.index)) == "barrel_1"
    paths = pst.paths(30.0).set_index("events")
    alone = paths.pst["L1_front:T barrel_1:r detector:A"]
    assert at_30.pst["barrel_1"] == alone  # the path scattered twice, whose first is barrel_1 too, is left out
    assert at_30.percent_of_first_level.sum() == pytest.approx(100)
    assert at_30.percent_of_stray.sum() < 100


@pytest.mark.long
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
    assert main_cause(fake_pst(paths=False)) is None
    assert main_cause(fake_pst(dark_from_deg=-1.0)) is None

"""The saved state of a run: whole or not at all, and only for the run that it belongs to; the estimate of the time."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from mistray.analysis.pst.state import PstProgress, load_state, require_same, save_state
from mistray.errors import MistrayError

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


def test_all_comes_back(tmp_path: Path) -> None:
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

    # Another run is named by what differs
    grid = {"angles_deg": [0, 2, 5, *range(6, 81, 2)], "azimuth_cell_deg": 360.0}
    for change, text in (
        ({"settings": {"max_scatters": 2, "seed": 0, "aim": "auto"}}, "settings.max_scatters was 1 and is 2;"),
        ({"settings": {"max_scatters": 1, "seed": 0}}, "settings.aim was auto and is absent;"),
        ({"scene": "f" * 64, "wavelength_nm": [600.0]}, r"wavelength_nm was \[550\] and is \[600\];"),
        ({"scene": "f" * 64}, "the scene is another one or has changed;"),
        ({"grid": grid}, "value 3 of grid.angles_deg"),
    ):
        with pytest.raises(MistrayError, match=rf"^state 's\.npz' belongs to another run: .*{text}"):
            require_same("s.npz", {"signature": SIGNATURE}, SIGNATURE | change)


def test_progress() -> None:
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

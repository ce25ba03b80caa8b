"""The brightest pixel of every path."""

import math

import numpy as np
import pytest
from report.ranked_paths import ORDERS, ROUND, TWIN, WIDE, ranked_report

from mistray.analysis import peaks
from mistray.analysis.peaks import with_peaks
from mistray.errors import MistrayError


@pytest.mark.parametrize("rank", ORDERS)
def test_each_rank_has_its_order(rank):
    assert tuple(ranked_report(rank).top(0.0).events) == ORDERS[rank]
    assert tuple(ranked_report().top(0.0, rank=rank).events) == ORDERS[rank]


@pytest.mark.parametrize("rank", ORDERS)
@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_every_list_has_the_strongest_path(rank, count):
    listed = ranked_report(rank).listed(0.0, count)
    assert tuple(listed.events[:count]) == ORDERS[rank][:count]
    assert list(listed.events).count(WIDE) == 1
    assert len(listed) <= count + 1


def test_a_list_of_none_is_empty():
    assert ranked_report().listed(0.0, 0).empty


def test_a_peak_is_the_brightest_pixel_of_all_wavelengths():
    """The wide disc covers 628 pixels of 318 rays each: 3.8 σ of the brightest is 21 %, whose spread is below 10 %."""
    report = ranked_report("peak")
    table = report.table(0.0).set_index("events")
    for events, peak in (
        (WIDE, 1e-3 / (math.pi * 0.5)),
        (ROUND, 2e-4 / (math.pi * 0.04)),
        (TWIN, 1e-4 / (math.pi * 0.01)),
    ):
        image, se = report[0.0].irradiance_of(table.path_ids[events])
        at = np.unravel_index(np.argmax(image), image.shape)
        assert table.peak_W_mm2[events] == image[at]
        assert table.peak_se_W_mm2[events] == se[at]
        assert 1.0 < table.peak_W_mm2[events] / peak < 1.4
    assert table.rank_peak[table.kind == "direct"].tolist() == [0]


def test_maps_that_do_not_fit_come_from_several_runs(monkeypatch):
    report = ranked_report()
    whole = with_peaks(report.table(0.0), report[0.0])
    monkeypatch.setattr(peaks, "MAP_BYTES", 1.0)  # room for one path
    single = with_peaks(report.table(0.0), report[0.0])
    for column in ("peak_W_mm2", "peak_se_W_mm2", "rank_peak"):
        np.testing.assert_array_equal(single[column], whole[column])


def test_the_runs_end_when_no_other_path_can_be_brighter(monkeypatch):
    """The direct image is brighter than all others together, so that its map is enough for the brightest path."""
    monkeypatch.setattr(peaks, "MAP_BYTES", 1.0)
    monkeypatch.setattr(peaks, "SURE", 1)
    report = ranked_report()
    found = with_peaks(report.table(0.0), report[0.0])
    assert found.peak_W_mm2.notna().tolist() == [True, False, False, False]
    assert found.rank_peak.tolist() == [0, 1, 2, 3]  # by power, as nothing else is known


def test_an_unknown_rank_is_refused_before_anything_is_traced():
    with pytest.raises(MistrayError, match=r"'rays'.*rms, power, peak"):
        ranked_report("rays")
    with pytest.raises(MistrayError, match=r"'rms_irradiance'.*rms, power, peak"):
        ranked_report().top(0.0, rank="rms_irradiance")

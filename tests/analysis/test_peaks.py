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
    assert tuple(ranked_report().top(0.0, rank=rank).events) == ORDERS[rank]
    report = ranked_report(rank)
    assert tuple(report.top(0.0).events) == ORDERS[rank]
    for count in (0, 1, 2, 9):  # every list has the strongest path
        events = list(report.listed(0.0, count).events)
        assert tuple(events[:count]) == ORDERS[rank][:count]
        assert events.count(WIDE) == min(count, 1)
        assert len(events) <= count + 1


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
    """Until no other path can be brighter than the direct image, whose map alone is enough for the brightest path."""
    report = ranked_report()
    whole = with_peaks(report.table(0.0), report[0.0])
    monkeypatch.setattr(peaks, "MAP_BYTES", 1.0)  # room for one path
    single = with_peaks(report.table(0.0), report[0.0])
    for column in ("peak_W_mm2", "peak_se_W_mm2", "rank_peak"):
        np.testing.assert_array_equal(single[column], whole[column])
    monkeypatch.setattr(peaks, "SURE", 1)
    found = with_peaks(report.table(0.0), report[0.0])
    assert found.peak_W_mm2.notna().tolist() == [True, False, False, False]
    assert found.rank_peak.tolist() == [0, 1, 2, 3]  # by power, as nothing else is known


def test_an_unknown_rank_is_refused_before_anything_is_traced():
    for call in (lambda: ranked_report("rms_irradiance"), lambda: ranked_report().top(0.0, rank="rms_irradiance")):
        with pytest.raises(MistrayError, match=r"'rms_irradiance'.*rms, power, peak"):
            call()

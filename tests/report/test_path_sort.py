"""The path-sort file and its parser."""

import pytest
from report.fake_trace import trace_at

from mistray.errors import MistrayError
from mistray.report.rays.path_sort import parse_path_sort, path_sort_text, sorted_paths


@pytest.fixture(scope="module")
def trace():
    return trace_at(10.0)


def test_round_trip_in_the_order_of_the_flux(trace):
    written, read = sorted_paths(trace), parse_path_sort(path_sort_text(trace))
    assert len(read) == len(written) == 5
    for a, b in zip(written, read, strict=True):
        assert (a.path_id, a.rays, a.events) == (b.path_id, b.rays, b.events)
        assert (b.absorbed_W, b.percent) == pytest.approx((a.absorbed_W, a.percent), rel=1e-8)
    flux = [path.absorbed_W for path in read]
    assert flux == sorted(flux, reverse=True)
    assert sum(path.percent for path in read) == pytest.approx(100, abs=1e-6)
    assert [path.path_id for path in parse_path_sort(path_sort_text(trace, count=2))] == [0, 1]
    direct, ghost = sorted_paths(trace)[:2]
    assert direct.intercepts == "(4 SpecTran)"
    assert ghost.intercepts == "(8 SpecTran)(2 SpecRefl)"
    assert ghost.events[:2] == (("Emitted", "", ""), ("SpecTran", "window", "window_front"))
    assert ghost.events[-1] == ("Absorbed", "detector", "detector")
    text = path_sort_text(trace)
    title = "the title or the column line is missing"
    cut = text[: text.index("Path 4: ")]
    for wrong, words in ((cut, "path 4 has no representative ray"), ("", title), ("something else\n", title)):
        with pytest.raises(MistrayError, match=words):
            parse_path_sort(wrong)

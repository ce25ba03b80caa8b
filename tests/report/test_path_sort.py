"""The path-sort file and its parser."""

import pytest
from report.fake_trace import trace_at

from mistray.errors import MistrayError
from mistray.report.rays.path_sort import parse_path_sort, path_sort_text, sorted_paths


@pytest.fixture(scope="module")
def trace():
    return trace_at(10.0)


def test_round_trip(trace):
    written, read = sorted_paths(trace), parse_path_sort(path_sort_text(trace))
    assert len(read) == len(written) == 5
    for a, b in zip(written, read, strict=True):
        assert (a.path_id, a.rays, a.events) == (b.path_id, b.rays, b.events)
        assert b.absorbed_W == pytest.approx(a.absorbed_W, rel=1e-8)
        assert b.percent == pytest.approx(a.percent, rel=1e-8)


def test_sorted_by_absorbed_flux_and_complete(trace):
    read = parse_path_sort(path_sort_text(trace))
    flux = [path.absorbed_W for path in read]
    assert flux == sorted(flux, reverse=True)
    assert sum(path.percent for path in read) == pytest.approx(100, abs=1e-6)


def test_summary_of_intercepts(trace):
    direct, ghost = sorted_paths(trace)[:2]
    assert direct.intercepts == "(4 SpecTran)"
    assert ghost.intercepts == "(8 SpecTran)(2 SpecRefl)"


def test_representative_ray_runs_from_source_to_detector(trace):
    ghost = sorted_paths(trace)[1]
    assert ghost.events[0] == ("Emitted", "", "")
    assert ghost.events[1] == ("SpecTran", "window", "window_front")
    assert ghost.events[-1] == ("Absorbed", "detector", "detector")


def test_count_limits_the_file(trace):
    assert [path.path_id for path in parse_path_sort(path_sort_text(trace, count=2))] == [0, 1]


def test_a_file_that_is_cut_off_is_an_error(trace):
    text = path_sort_text(trace)
    with pytest.raises(MistrayError, match="path 4 has no representative ray"):
        parse_path_sort(text[: text.index("Path 4: ")])


@pytest.mark.parametrize("text", ["", "something else\n"])
def test_another_text_is_an_error(text):
    with pytest.raises(MistrayError, match="the title or the column line is missing"):
        parse_path_sort(text)

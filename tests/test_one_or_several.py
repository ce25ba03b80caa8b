"""Arguments that take several ids, names or numbers take one, too."""

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray import optimize, report
from mistray.analysis import path_analysis
from mistray.coatings import preset, write_table
from mistray.prescription import prism
from mistray.ranges import several


@pytest.fixture(scope="module")
def t() -> Any:
    return mistray.trace(mistray.load("plate"), rays=256)


@pytest.fixture(scope="module")
def ghosts() -> Any:
    return mistray.ghosts(mistray.load("plate"), 0, rays=256)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (3, [3]),
        (0, [0]),
        ("ab", ["ab"]),
        ("", [""]),
        ([], []),
        ((1, 2), [1, 2]),
        (np.int64(4), [4]),
        (np.array(5), [5]),
    ],
)
def test_several(given: Any, expected: list[Any]) -> None:
    assert several(given) == expected
    assert several(iter(expected)) == expected


def test_paths_of_a_trace(t: Any) -> None:
    for one in (1, np.int64(1)):
        for found, same in zip(t.irradiance_of(one), t.irradiance_of([1]), strict=True):
            np.testing.assert_array_equal(found, same)
    (first, _), (second, _) = t.maps([0, [1]])
    np.testing.assert_array_equal(first, t.irradiance_of(0)[0])
    np.testing.assert_array_equal(second, t.irradiance_of(1)[0])
    assert t.paths.power(1) == t.paths.power([1])
    assert t.paths.light(1).whole == t.paths.light([1]).whole
    assert t.sampled_rays(0).keys() == t.sampled_rays([0]).keys() == {0}
    assert t.light_cones(0).keys() == t.light_cones([0]).keys()
    assert len(report.rays_of_paths(t, 0)) == len(report.rays_of_paths(t, [0])) > 0
    assert len(path_analysis(t, path_ids=0)) == len(path_analysis(t, path_ids=[0]))
    for wrong in (99, -1):
        with pytest.raises(
            mistray.MistrayError, match=f"^path_id {wrong} does not exist; this trace has the paths 0 … "
        ):
            t.irradiance_of(wrong)


def test_paths_of_a_report(ghosts: Any) -> None:
    stray = int(ghosts.top(0.0, 1).path_id.iloc[0])
    assert [*ghosts.rays_of_paths(0.0, stray)] == [stray]
    assert ghosts.path_maps(0.0, stray) is ghosts.path_maps(0.0, [stray])
    ghosts.map_light("ghost")
    assert len(ghosts.light_maps[0.0]) == 1
    assert report.layout(ghosts, 0.0, path_ids=stray).axes


def test_keys_of_parameters() -> None:
    scene = mistray.load("plate")
    known = optimize.parameters(scene)
    key = next(iter(known))
    assert optimize.match(known, key) == [key]
    found = optimize.gradient(optimize.transmission(scene, rays=256), mi.traverse(scene), keys=key)
    assert [*found.gradient] == [key]
    assert found.covariance(key).shape == found.covariance([key]).shape
    found.require(key)


@pytest.mark.quick
def test_wavelengths_angles_and_faces(tmp_path: Path) -> None:
    for name, numbers in (("one", (550.0, 0.0)), ("several", ([550.0], [0.0]))):
        write_table(preset("mgf2_quarter_wave"), tmp_path / name, *numbers)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "several").read_bytes()
    corners = [(0, 0), (10, 0), (0, 10)]
    faces = [prism("p", corners, 10, material="N-BK7", mirrors=mirrors) for mirrors in ("1", ["1"])]
    assert faces[0] == faces[1]

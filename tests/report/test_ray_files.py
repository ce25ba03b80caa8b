"""Files of rays: what is read is what was written, bit by bit; other files are refused in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from report.fake_trace import paths_at, scatter_trace_at
from report.view_scene import RayTrace

from mistray.errors import MistrayError
from mistray.report.rays.path_rays import RayLine, rays_of_paths, row_name
from mistray.report.rays.ray_files import read_rays, write_rays

ENDINGS = ("ply", "obj", "json")


@pytest.fixture(scope="module")
def trace():
    return RayTrace(paths_at(10.0), 10.0)


@pytest.fixture(scope="module")
def rays(trace):
    return rays_of_paths(trace, [0, 2, 1], n=3)


def test_rays_are_those_of_the_history(trace, rays):
    assert [ray.path_id for ray in rays] == [0] * 3 + [2] * 3 + [1] * 3
    for ray in rays:
        row = trace.paths[ray.path_id]
        assert (ray.events, ray.wavelength_nm) == (row.events, row.wavelength_nm)
        assert len(ray.points) == len(ray.flux_W) == len(row.event_list) + 1
    for ray, exact in zip(rays[3:6], trace.history(2, 3).rays, strict=True):
        np.testing.assert_array_equal(ray.points, exact)
    assert {ray.path_id for ray in rays_of_paths(trace, n=1)} == set(range(len(trace.paths)))
    # Light that is aimed has a name of its own
    names = {row_name(row) for row in trace.paths}
    ghost = next(row for row in trace.paths if row.ghost_2 == "window_rear")
    assert {"0 direct image, 3 W", f"{ghost.path_id} detector → window_rear, 0.0002 W"} <= names
    labels = [row.label for row in scatter_trace_at(0.0).paths if row.kind == "single scatter"]
    assert labels.count("scatter at window_rear") == labels.count("window_rear:i") == 1
    assert len(set(labels)) == len(labels)


@pytest.mark.parametrize("ending", ENDINGS)
def test_round_trip_is_exact(rays, ending, tmp_path):
    again = read_rays(write_rays(rays, tmp_path / f"rays.{ending}"))
    assert again == rays
    assert [ray.start_ray for ray in again] == [0, 1, 2, 200, 201, 202, 100, 101, 102]
    assert read_rays(write_rays([], tmp_path / f"none.{ending}")) == []
    # Numbers that decimals do not hold
    odd = np.array([[1 / 3, -0.0, 5e-324], [np.pi * 1e300, np.nextafter(1.0, 2.0), -1e-17]])
    ray = RayLine(7, "gläserne_Platte:T detector:A", 632.8, 2**31 - 1, odd, np.array([1e-300, 0.1 + 0.2]))
    (again,) = read_rays(write_rays([ray], tmp_path / f"odd.{ending}"))
    assert again == ray
    assert np.signbit(again.points[0, 1])


def test_ply_is_as_viewers_read_it(rays, tmp_path):
    content = write_rays(rays, tmp_path / "rays.ply").read_bytes()
    head, _, body = content.partition(b"end_header\n")
    lines = head.decode().splitlines()
    vertices = sum(len(ray.points) for ray in rays)
    at = lines.index(f"element vertex {vertices}")
    assert lines[at + 1 : at + 4] == ["property double x", "property double y", "property double z"]
    at = lines.index(f"element edge {vertices - len(rays)}")
    assert lines[at + 1 :] == ["property int vertex1", "property int vertex2"]
    edges = np.frombuffer(body[-8 * (vertices - len(rays)) :], dtype="<i4").reshape(-1, 2)
    ray_of = np.repeat(np.arange(len(rays)), [len(ray.points) for ray in rays])
    assert (ray_of[edges[:, 0]] == ray_of[edges[:, 1]]).all()
    assert len(set(map(tuple, edges.tolist()))) == len(edges)
    text = write_rays(rays, tmp_path / "rays.obj").read_text(encoding="utf-8")
    words = [line.split() for line in text.splitlines()]
    points = np.array([[float(x) for x in line[1:]] for line in words if line[0] == "v"])
    polylines = [points[np.array(line[1:], dtype=int) - 1] for line in words if line[0] == "l"]
    assert [line[1] for line in words if line[0] == "g"] == ["path_0", "path_2", "path_1"]
    for polyline, ray in zip(polylines, rays, strict=True):
        np.testing.assert_array_equal(polyline, ray.points)
    with pytest.raises(MistrayError, match="check the folder and its permissions"):
        write_rays(rays, tmp_path / "nowhere" / "rays.json")
    with pytest.raises(MistrayError, match=r"ray file .*none.ply': No such file or directory"):
        read_rays(tmp_path / "none.ply")


BROKEN = {
    "ply": [b"", b"ply\nformat ascii 1.0\n", b"\x00\xff"],
    "obj": [b"", b"v 1 2 3\n", b"\xff\xfe", b"# mistray rays 1, mm\nl 1 2\n", b"# mistray rays 1, mm\nv a\n"],
    "json": [b"", b"[]", b"{", b'{"format": "mistray rays 1"}', b'{"format": "mistray rays 1", "rays": [{}]}'],
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_other_files_are_refused_in_one_line(ending, rays, tmp_path):
    path = tmp_path / f"broken.{ending}"
    whole = write_rays(rays, path).read_bytes()
    for content in [*BROKEN[ending], whole[: len(whole) // 2 - 3]]:
        path.write_bytes(content)
        with pytest.raises(MistrayError, match=r"^ray file .*write_rays wrote$") as caught:
            read_rays(path)
        assert str(path) in str(caught.value)
    if ending == "json":
        data = json.loads(whole)
        data["rays"][0]["flux_W"].pop()
        path.write_text(json.dumps(data), encoding="utf-8")
        with pytest.raises(MistrayError, match="a ray of path 0 has 6 points and 5 fluxes"):
            read_rays(path)

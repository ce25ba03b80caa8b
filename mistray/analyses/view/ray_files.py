"""Readers and writers of drawn rays in PLY, OBJ and JSON files.

All three hold every number in full, so that rays are read back bit by bit:

- PLY (G. Turk, "The PLY Polygon File Format", 1994), binary, little endian: points are the element ``vertex`` with the
  properties x, y, z (mm), flux_W, wavelength_nm, path_id, ray and start_ray; the segments between them are the element
  ``edge`` (vertex1, vertex2), which viewers draw; comments hold the events of each ray.
- OBJ (Wavefront, Advanced Visualizer manual, appendix B1): ``v`` lines in mm, one ``l`` line for each ray in a group
  ``path_<id>``; comments hold flux, wavelength and events, for which OBJ has no keyword.
- JSON: one object for each ray.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import OfType, Several
from mistray.read_file import read_file
from mistray.replace_file import replace_file
from mistray.toolkit.drawings.path_polylines import RayLine

VERTEX = np.dtype(
    [(name, "<f8") for name in ("x", "y", "z", "flux_W", "wavelength_nm")]
    + [(name, "<i4") for name in ("path_id", "ray", "start_ray")]
)
EDGE = np.dtype([("vertex1", "<i4"), ("vertex2", "<i4")])
PLY_TYPES = {"<f8": "double", "<i4": "int"}
JSON_FORMAT = "mistray rays 1"
OBJ_TITLE = "# mistray rays 1, mm"


def write_rays(rays: RayLine | Sequence[RayLine], path: str | Path) -> Path:
    """
    Write rays to a file, complete or not at all, and return its path.

    Parameters
    ----------
    rays : RayLine or sequence of RayLine
        Rays to write.
    path : str or Path
        File, whose ending chooses the format: ``.ply``, ``.obj`` or ``.json``.

    Returns
    -------
    Path
        File that was written.

    Raises
    ------
    MistrayError
        If the ending is another one, or the file cannot be written.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> rays = mistray.report.rays_of_paths(t, [1], n=3)
    >>> mistray.report.write_rays(rays, "ghost.ply").name
    'ghost.ply'
    """
    write, _ = format_of(path)
    lines = Several(OfType(RayLine, "must be a ray, as from mistray.report.rays_of_paths"), least=0).check("rays", rays)
    return replace_file(path, write(lines), "ray file")


def read_rays(path: str | Path) -> list[RayLine]:
    """
    Return the rays in a file that `write_rays` has written.

    Raises
    ------
    MistrayError
        If the ending is another one, or the file is missing or not in the form that `write_rays` gives it.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> _ = mistray.report.write_rays(mistray.report.rays_of_paths(t, [1], n=3), "ghost.json")
    >>> [ray.path_id for ray in mistray.report.read_rays("ghost.json")]
    [1, 1, 1]
    """
    _, read = format_of(path)
    data = read_file(path, "ray file")
    try:
        return read(data)
    except (ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise MistrayError(f"ray file '{path}': {error}; give a file that mistray.report.write_rays wrote") from None


def format_of(path: str | Path) -> tuple[Callable[..., str | bytes], Callable[[bytes], list[RayLine]]]:
    """Return the functions that write and read rays for a file suffix; raise `MistrayError` if it is unknown."""
    found = _FORMATS.get(Path(path).suffix.lower())
    if found is None:
        raise MistrayError(f"ray file '{path}': rays are written as {', '.join(_FORMATS)}; choose one of these endings")
    return found


def _json(rays: Sequence[RayLine]) -> str:
    rows = [
        {
            "path_id": ray.path_id,
            "events": ray.events,
            "wavelength_nm": ray.wavelength_nm,
            "start_ray": ray.start_ray,
            "points_mm": ray.points.tolist(),
            "flux_W": ray.flux_W.tolist(),
        }
        for ray in rays
    ]
    body = ",\n".join(json.dumps(row, allow_nan=False) for row in rows)
    return f'{{"format": "{JSON_FORMAT}", "rays": [\n{body}\n]}}\n'


def _from_json(content: bytes) -> list[RayLine]:
    data = json.loads(content)
    if not isinstance(data, dict) or data.get("format") != JSON_FORMAT:
        raise ValueError(f'its format is not "{JSON_FORMAT}"')
    return [
        _ray(row["path_id"], row["events"], row["wavelength_nm"], row["start_ray"], row["points_mm"], row["flux_W"])
        for row in data["rays"]
    ]


def _obj(rays: Sequence[RayLine]) -> str:
    lines, first = [OBJ_TITLE], 1
    group = None
    for ray in rays:
        if ray.path_id != group:
            group = ray.path_id
            lines.append(f"g path_{group}")
        lines.append(f"# ray {ray.path_id} {ray.wavelength_nm!r} {ray.start_ray} {ray.events}")
        lines.append("# flux_W " + " ".join(map(repr, ray.flux_W.tolist())))
        lines += ["v " + " ".join(map(repr, point)) for point in ray.points.tolist()]
        lines.append("l " + " ".join(map(str, range(first, first + len(ray.points)))))
        first += len(ray.points)
    return "\n".join([*lines, f"# end of {len(rays)} rays"]) + "\n"


def _from_obj(content: bytes) -> list[RayLine]:
    lines = content.decode("utf-8").splitlines()
    if not lines or lines[0] != OBJ_TITLE:
        raise ValueError(f"its first line is not '{OBJ_TITLE}'")
    points: list[list[float]] = []
    rays: list[RayLine] = []
    head: list[str] = []
    flux: list[float] = []
    for line in lines[1:]:
        word, _, rest = line.partition(" ")
        if word == "#":
            kind, _, values = rest.partition(" ")
            if kind == "ray":
                head = values.split(" ", 3)
            elif kind == "flux_W":
                flux = [float(value) for value in values.split()]
        elif word == "v":
            points.append([float(value) for value in rest.split()])
        elif word == "l":
            numbers = [int(value) - 1 for value in rest.split()]
            if min(numbers) < 0:
                raise ValueError(f"'{line}' has a number below 1")
            path_id, wavelength, start_ray, events = head
            own = [points[number] for number in numbers]
            rays.append(_ray(int(path_id), events, float(wavelength), int(start_ray), own, flux))
    if lines[-1] != f"# end of {len(rays)} rays":
        raise ValueError("it ends before its last line")
    return rays


def _ply(rays: Sequence[RayLine]) -> bytes:
    lengths = [len(ray.points) for ray in rays]
    vertices = np.zeros(sum(lengths), dtype=VERTEX)
    starts = np.cumsum([0, *lengths])
    for number, (ray, start) in enumerate(zip(rays, starts[:-1], strict=True)):
        own = vertices[start : start + len(ray.points)]
        own["x"], own["y"], own["z"] = ray.points.T
        own["flux_W"], own["wavelength_nm"] = ray.flux_W, ray.wavelength_nm
        own["path_id"], own["ray"], own["start_ray"] = ray.path_id, number, ray.start_ray
    edges = np.zeros(len(vertices) - len(rays), dtype=EDGE)
    edges["vertex1"] = np.delete(np.arange(len(vertices)), starts[1:] - 1)
    edges["vertex2"] = edges["vertex1"] + 1
    header = ["ply", "format binary_little_endian 1.0", "comment mistray rays 1, mm"]
    header += [f"comment ray {number} {ray.events}" for number, ray in enumerate(rays)]
    for name, table in (("vertex", vertices), ("edge", edges)):
        header.append(f"element {name} {len(table)}")
        header += [f"property {PLY_TYPES[table.dtype[field].str]} {field}" for field in table.dtype.names or ()]
    return ("\n".join([*header, "end_header"]) + "\n").encode() + vertices.tobytes() + edges.tobytes()


def _from_ply(content: bytes) -> list[RayLine]:
    head, found, body = content.partition(b"\nend_header\n")
    header = head.decode("utf-8", errors="replace").split("\n")
    if not found or header[:3] != ["ply", "format binary_little_endian 1.0", "comment mistray rays 1, mm"]:
        raise ValueError("its header is not that of a PLY file of rays")
    events = {}
    for line in header:
        kind, _, rest = line.removeprefix("comment ").partition(" ")
        if kind in ("ray", "path"):  # mistray 0.2 wrote a comment for each path
            number, _, text = rest.partition(" ")
            events[kind, int(number)] = text
    counts = [int(line.split()[2]) for line in header if line.startswith("element ")]
    if len(body) != counts[0] * VERTEX.itemsize + counts[1] * EDGE.itemsize:
        raise ValueError(f"it has {len(body)} bytes of data, not those of {counts[0]} points and {counts[1]} segments")
    vertices = np.frombuffer(body, dtype=VERTEX, count=counts[0])
    starts = np.flatnonzero(np.diff(vertices["ray"], prepend=-1))
    rays = []
    for own in np.split(vertices, starts[1:]) if len(vertices) else []:
        first = own[0]
        points = np.column_stack([own["x"], own["y"], own["z"]])
        path_id, ray = int(first["path_id"]), ("ray", int(first["ray"]))
        text = events[ray if ray in events else ("path", path_id)]
        wavelength, start_ray = float(first["wavelength_nm"]), int(first["start_ray"])
        rays.append(_ray(path_id, text, wavelength, start_ray, points, own["flux_W"]))
    return rays


def _ray(path_id: int, events: str, wavelength_nm: float, start_ray: int, points: Any, flux: Any) -> RayLine:
    """Return a ray from its values in a file; raise `ValueError` if points (k, 3) and fluxes (k,) do not agree."""
    xyz, arriving = np.array(points, dtype=np.float64), np.array(flux, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or arriving.shape != xyz.shape[:1]:
        raise ValueError(f"a ray of path {path_id} has {len(xyz)} points and {arriving.size} fluxes")
    return RayLine(int(path_id), str(events), float(wavelength_nm), int(start_ray), xyz, arriving)


_FORMATS: dict[str, tuple[Callable[..., str | bytes], Callable[[bytes], list[RayLine]]]] = {
    ".ply": (_ply, _from_ply),
    ".obj": (_obj, _from_obj),
    ".json": (_json, _from_json),
}

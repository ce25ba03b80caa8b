"""Scenes of many shapes: what loading them takes grows in proportion to their number."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import mistray

# Painted walls, each with a paint of its own, and tiles on axes of their own: overlaps had been looked for pair by pair
WALL = """<shape type="frustum" id="wall_{k}"><float name="r0" value="20"/><float name="z0" value="{k}"/>
<float name="r1" value="20"/><float name="z1" value="{k}.9"/>
<bsdf type="paint"><float name="reflectance" value="0.05"/></bsdf></shape>"""
TILE = """<shape type="asphere" id="tile_{k}"><float name="half_width" value="0.4"/>
<float name="half_height" value="0.4"/><transform name="to_world"><translate x="{k}"/></transform>
<bsdf type="interface"><float name="R" value="0"/></bsdf></shape>"""


def row(folder: Path, shape: str, count: int) -> Path:
    path = folder / f"{count}.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(shape.format(k=k) for k in range(count))}</scene>')
    return path


def seconds(path: Path) -> float:
    """Processor time of this thread's process, which other programs on the machine do not lengthen."""
    begun = time.process_time()
    mistray.load(path)
    return time.process_time() - begun


@pytest.mark.parametrize(("shape", "count"), [(WALL, 60), (TILE, 150)])
def test_loading_grows_in_proportion_to_the_number_of_shapes(tmp_path: Path, shape: str, count: int) -> None:
    few, many = row(tmp_path, shape, count), row(tmp_path, shape, 4 * count)
    mistray.load(few)
    assert min(seconds(many) for _ in range(2)) < 1.6 * 4 * min(seconds(few) for _ in range(3))


def test_walls_of_one_paint_share_what_it_takes_milliseconds_to_tabulate(tmp_path: Path) -> None:
    from mistray.scatter.radial import _table

    _table.cache_clear()
    mistray.load(row(tmp_path, WALL, 20))
    assert _table.cache_info().misses <= 1

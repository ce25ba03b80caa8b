"""Scenes of many shapes: what loading them takes grows in proportion to their number."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import mistray

FEW, MANY = 60, 240
SOURCE = '<emitter type="collimated"><float name="radius" value="5"/></emitter>'
HEAD = f'<scene version="3.0.0"><integrator type="straylight"/>{SOURCE}'
WALL = """<shape type="frustum" id="wall_{k}"><float name="r0" value="20"/><float name="z0" value="{k}"/>
<float name="r1" value="20"/><float name="z1" value="{end}"/>
<bsdf type="paint"><float name="reflectance" value="0.05"/></bsdf></shape>"""


def tube(path: Path, walls: int) -> Path:
    """A tube of painted walls, each with a paint of its own."""
    path.write_text(f"{HEAD}{''.join(WALL.format(k=k, end=k + 1) for k in range(walls))}</scene>")
    return path


def seconds(path: Path) -> float:
    """Processor time of this thread's process, which other programs on the machine do not lengthen."""
    begun = time.process_time()
    mistray.load(path)
    return time.process_time() - begun


def test_loading_grows_in_proportion_to_the_number_of_walls(tmp_path: Path) -> None:
    few, many = tube(tmp_path / "few.xml", FEW), tube(tmp_path / "many.xml", MANY)
    mistray.load(few)
    best_few, best_many = min(seconds(few) for _ in range(3)), min(seconds(many) for _ in range(2))
    assert best_many < 1.6 * MANY / FEW * best_few


def test_walls_of_one_paint_share_what_it_takes_milliseconds_to_tabulate(tmp_path: Path) -> None:
    from mistray.scatter.radial import _table

    _table.cache_clear()
    mistray.load(tube(tmp_path / "tube.xml", 20))
    assert _table.cache_info().misses <= 1


@pytest.mark.slow
def test_a_thousand_walls_load_in_bounded_time_and_memory(tmp_path: Path) -> None:
    def resident_mb() -> float:
        (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS")]
        return int(line.split()[1]) / 1024

    mistray.load(tube(tmp_path / "few.xml", 10))
    before = resident_mb()
    assert seconds(tube(tmp_path / "many.xml", 1000)) < 5
    assert resident_mb() - before < 400


def test_loading_shapes_on_axes_of_their_own_grows_in_proportion_too(tmp_path: Path) -> None:
    """Tiles side by side: the search for surfaces that overlap compared every tile with every other."""
    tile = """<shape type="asphere" id="tile_{k}"><float name="half_width" value="0.4"/>
<float name="half_height" value="0.4"/><transform name="to_world"><translate x="{k}"/></transform>
<bsdf type="interface"><float name="R" value="0"/></bsdf></shape>"""

    def row(name: str, tiles: int) -> Path:
        path = tmp_path / name
        path.write_text(f"{HEAD}{''.join(tile.format(k=k) for k in range(tiles))}</scene>")
        return path

    few, many = row("few.xml", 150), row("many.xml", 600)
    mistray.load(few)
    assert min(seconds(many) for _ in range(2)) < 1.6 * 4 * min(seconds(few) for _ in range(3))

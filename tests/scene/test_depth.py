"""Scene files that are nested too deeply are refused before Mitsuba reads them, which would end the process."""

from __future__ import annotations

from pathlib import Path

import pytest

import mistray
from mistray.errors import MistrayError
from mistray.scene.depth import check_depth
from mistray.scene.xml_file import DEEPEST


def nested(levels: int) -> str:
    """A scene with elements within each other, the outermost included."""
    return '<scene version="3.0.0">\n' + "<bsdf>" * (levels - 1) + "</bsdf>" * (levels - 1) + "\n</scene>"


@pytest.mark.parametrize("levels", [DEEPEST + 1, 20_000])
def test_deep_files_are_refused(tmp_path: Path, levels: int) -> None:
    path = tmp_path / "deep.xml"
    path.write_text(nested(levels))
    with pytest.raises(MistrayError) as caught:
        mistray.load(path)
    assert str(caught.value) == f"scene '{path}', line 2: <bsdf> lies within 100 other elements; close them first"


def test_included_files_are_looked_at(tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text(nested(500))
    path = tmp_path / "scene.xml"
    path.write_text('<scene version="3.0.0"><include filename="part.xml"/><include filename="scene.xml"/></scene>')
    with pytest.raises(MistrayError, match=r"part\.xml', line 2"):
        check_depth(path)


@pytest.mark.parametrize("data", [nested(DEEPEST).encode(), b"<scene", b"", b"\x00\xff", b'<?xml encoding="?"?><a/>'])
def test_other_files_are_left_to_the_reader(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "scene.xml"
    path.write_bytes(data)
    check_depth(path)


def test_every_shipped_scene_is_far_from_the_limit() -> None:
    from mistray.scene.load import shipped_scenes

    for path in shipped_scenes().values():
        check_depth(path)

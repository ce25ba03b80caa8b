"""The files that a scene depends on."""

from __future__ import annotations

from pathlib import Path

import pytest

from mistray.scene.files import scene_files
from mistray.scene.load import shipped_scenes


def named(tmp_path: Path, body: str, *files: str) -> list[str]:
    """Files of a scene with this body, relative to its folder; `files` exist."""
    for name in files:
        path = tmp_path / "scene" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("<scene version='3.0.0'/>")
    scene = tmp_path / "scene" / "scene.xml"
    scene.parent.mkdir(exist_ok=True)
    scene.write_text(f"<scene version='3.0.0'>{body}</scene>", encoding="utf-8")
    first, *others = scene_files(scene)
    assert first == scene.resolve()
    return [path.relative_to(scene.parent.resolve()).as_posix() for path in others]


@pytest.mark.parametrize(
    ("value", "file"),
    [
        ("part.ply", "part.ply"),
        ("./glass.agf:F2", "glass.agf"),
        ("parts/my lens part.ply", "parts/my lens part.ply"),
        ("MgF2 99.6, my film.csv 20.5, coating.dat:TIO2 0.25w", "my film.csv coating.dat"),
        ("glass.agf:F2 k=0 shift=1e-4", "glass.agf"),
        ("data=table.csv", "table.csv"),
        ("a:b.csv", "a:b.csv"),
        ("no_such_file.csv", ""),
        (".", ""),
        ("1.5 " * 500, ""),
    ],
)
def test_values(tmp_path: Path, value: str, file: str) -> None:
    files = {"my film.csv coating.dat": ["coating.dat", "my film.csv"], "": []}.get(file, [file])
    assert sorted(named(tmp_path, f'<string name="front" value="{value}"/>', *files, "other.csv")) == files


def test_includes_paths_and_parameters(tmp_path: Path) -> None:
    body = """<default name="where" value="data"/><default name="where_else" value="more"/>
              <path value="found"/><include filename="inner/part.xml"/>
              <string name="a" value="$where/one.csv"/><string name="b" value="$where_else/two.csv"/>
              <string name="c" value="three.csv"/>"""
    files = ["data/one.csv", "more/two.csv", "found/three.csv", "inner/part.xml", "inner/four.csv", "inner/five.xml"]
    (tmp_path / "scene" / "inner").mkdir(parents=True)
    named(tmp_path, "", *files)
    inner = "<scene version='3.0.0'><string name='d' value='four.csv'/><include filename='inner/five.xml'/></scene>"
    (tmp_path / "scene" / "inner" / "part.xml").write_text(inner)
    assert sorted(named(tmp_path, body)) == sorted(files)


def test_parameters_hold_in_all_scenes(tmp_path: Path) -> None:
    """As in Mitsuba: in a scene that is included, behind it, and the first of a name wins; also all round."""
    (tmp_path / "scene").mkdir()
    part = """<scene version='3.0.0'><default name='where' value='other'/><default name='more' value='$where'/>
              <string name='a' value='$where/one.csv'/></scene>"""
    (tmp_path / "scene" / "part.xml").write_text(part.replace("</scene>", "<include filename='scene.xml'/></scene>"))
    body = """<default name="where" value="data"/><include filename="part.xml"/>
              <string name="b" value="$more/two.csv"/>"""
    found = named(tmp_path, body, "data/one.csv", "other/one.csv", "data/two.csv", "other/two.csv")
    assert found == ["part.xml", "data/one.csv", "data/two.csv"]


def test_an_absolute_name(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere.csv"
    elsewhere.write_text("1")
    scene = tmp_path / "scene" / "scene.xml"
    scene.parent.mkdir()
    scene.write_text(f"<scene version='3.0.0'><string name='a' value='{elsewhere}:entry'/></scene>")
    assert scene_files(scene)[1:] == [elsewhere.resolve()]


def test_shipped_scenes() -> None:
    """Those of which the files are known: the phone camera and most others stand in one file each."""
    for name, path in shipped_scenes().items():
        found = scene_files(path)
        assert found[0] == path.resolve(), name
        meshes = {file for file in path.parent.iterdir() if file.suffix in (".ply", ".obj")}
        assert meshes <= set(found), name

"""Every reader of a user's file opens regular files only, and what makes no sense is named at once."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import os
import re
import signal
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest
from refusals import refused
from test_cli_import import SEQ, ZMX

import mistray
from mistray.analyses.optimize.study.checkpoint import Checkpoint
from mistray.cache import Cache, file_fingerprint
from mistray.coatings.files import read_coating
from mistray.errors import MistrayError
from mistray.files.sky_picture import read_healpix
from mistray.materials import refractive_index
from mistray.prescription import from_batoid, from_codev, from_zemax
from mistray.read_file import read_text

PATIENCE_S = 5  # of a reader, by the clock of the processor, which does not run while others have it
WAITING_S = 60  # until one that uses no time of it waits for ever

SCENE = '<scene version="3.0.0">{}</scene>'
SPHERE = '<shape type="sphere" id="wall">{}</shape>'


def with_glasses(read: Callable[..., Any], ending: str, text: str) -> Callable[[Path], Any]:
    def run(file: Path) -> Any:
        lens = file.with_name(f"lens{ending}")
        lens.write_text(text)
        return read(lens, glass_catalogues=[file])

    return run


def scene(body: str) -> Callable[[Path], Any]:
    def load(file: Path) -> Any:
        path = file.with_name("scene.xml")
        path.write_text(SCENE.format(body.format(file=file.name)))
        return mistray.load(path)

    return load


TEXTURE = SPHERE.format('<bsdf type="diffuse"><texture type="bitmap" name="reflectance">{}</texture></bsdf>')
NAME = '<string name="filename" value="{file}"/>'
BSDF = SPHERE.format('<bsdf type="{kind}">{inside}</bsdf>')
# What a module of the package reads a file with, and the endings of the file
FUNCTIONS = {
    "prescription:from_json": ".json", "io.zemax.read:read_zemax": ".zmx", "io.codev.read:read_codev": ".seq",
    "materials.agf:glass_names": ".agf", "scatter.measured.bsdf_csv:read_bsdf_csv": ".csv",
    "scatter.measured.zemax_bsdf:read_zemax_bsdf": ".bsdf", "scatter.measured.psd_table:PsdTable.read": ".csv",
    "analyses.view.ray_files:read_rays": ".ply .obj .json", "files.ray_sets:read_ray_set": ".csv .dat .parquet",
    "files.irradiance_files:read_irradiance": ".npy .fits .exr", "spectra.spectrum:read_table": ".csv",
    "files.intensities:read_intensities": ".ies .csv", "files.saved_state:load_state": ".npz",
    "prescription:read_grid": ".npz .dat", "analyses.sweep.read_configurations:read_configurations": ".toml",
    "analyses.optimize.toml.read_study:read_study": ".toml", "analyses.budget.read_budget:read_budget": ".toml",
    "mechanics:read_mechanics": ".step .stl .obj .ply", "scene:load": ".xml", "scene.xml_file:SceneFile": ".xml",
    "scene.unshared:SceneText": ".xml", "scene.files:scene_files": ".xml",
}  # fmt: skip


def reader(name: str) -> Callable[[Path], Any]:
    module, _, name = name.partition(":")
    return lambda file: attrgetter(name)(importlib.import_module(f"mistray.{module}"))(file)


# Reader by name: the ending of the file and the reader
READERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    f"{name} {ending}": (ending, reader(name)) for name, endings in FUNCTIONS.items() for ending in endings.split()
} | {
    "zemax glasses": (".agf", with_glasses(from_zemax, ".zmx", ZMX.replace("N-BK7", "ODD"))),
    "codev glasses": (".agf", with_glasses(from_codev, ".seq", SEQ.replace("NBK7_SCHOTT", "ODD"))),
    "material table": (".csv", lambda file: refractive_index(str(file), 550.0)),
    "material of a catalogue": (".agf", lambda file: refractive_index(f"{file}:ODD", 550.0)),
    "material of a coating file": (".dat", lambda file: refractive_index(f"{file}:ODD", 550.0)),
    "coating table": (".csv", lambda file: read_coating(str(file))),
    "coating of a file": (".dat", lambda file: read_coating(f"{file}:AR")),
    "ABg catalogue": (".dat", lambda file: reader("scatter.measured.zemax_abg:abg_from_catalogue")(f"{file}:ODD")),
    "sky in healpix": (".fits", lambda file: read_healpix(str(file), "sky")),
    "checkpoint": (".json", lambda file: Checkpoint(file, mistray.scene.find("plate"), "x").read()),
    "include": (".xml", scene('<include filename="{file}"/>')),
    "include by parameter": (".xml", scene('<default name="f" value="{file}"/><include filename="$f"/>')),
    "spectrum": (".spd", scene(BSDF.format(kind="diffuse", inside='<spectrum name="reflectance" filename="{file}"/>'))),
    "ply shape": (".ply", scene(f'<shape type="ply">{NAME}</shape>')),
    "obj shape": (".obj", scene(f'<shape type="obj">{NAME}</shape>')),
    "part mesh": (".ply", scene(f'<shape type="part_mesh" id="p">{NAME}</shape>')),
    "bitmap": (".png", scene(TEXTURE.format(NAME))),
    "measured": (".bsdf", scene(BSDF.format(kind="measured", inside=NAME))),
    "dict shape": (".ply", lambda file: mistray.load({"type": "scene", "a": {"type": "ply", "filename": str(file)}})),
    "tabulated": (".csv", scene(BSDF.format(kind="tabulated", inside='<string name="file" value="{file}"/>'))),
}
if importlib.util.find_spec("batoid"):
    READERS["batoid lens"] = (".yaml", lambda file: from_batoid(file, wavelength_nm=550.0))


def nest(file: Path, levels: int) -> None:
    opening, closing = ("<a>", "</a>") if file.suffix == ".xml" else ("[", "")
    file.write_text(("a = " if file.suffix == ".toml" else "") + opening * levels + closing * levels)


KINDS: dict[str, Callable[[Path], object]] = {
    "pipe": lambda file: os.mkfifo(file),
    "device": lambda file: file.symlink_to("/dev/zero"),
    "terminal": lambda file: file.symlink_to("/dev/null"),
    "folder": lambda file: file.mkdir(),
    "garbage": lambda file: file.write_bytes(bytes(range(256)) * 40),
    "nest": lambda file: nest(file, 2000),
    "deep_nest": lambda file: nest(file, 100_000),
    "empty": lambda file: file.write_bytes(b""),
}
LIBRARIES = {".parquet": "pyarrow", ".fits": "astropy", ".exr": "OpenEXR", ".step": "cascadio", ".stl": "trimesh"}


@pytest.fixture
def patience() -> Iterator[None]:
    """Ends what reads, or waits, without end."""

    def stop(number: int, _: Any) -> None:
        raise TimeoutError("still waiting" if number == signal.SIGALRM else f"still reading after {PATIENCE_S} s")

    before = {number: signal.signal(number, stop) for number in (signal.SIGALRM, signal.SIGPROF)}
    signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
    signal.alarm(WAITING_S)
    yield
    signal.alarm(0)
    signal.setitimer(signal.ITIMER_PROF, 0)
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_such_file_is_named_at_once(
    tmp_path: Path, monkeypatch: Any, patience: None, name: str, kind: str
) -> None:
    ending, read = READERS[name]
    if ending in LIBRARIES or name == "mechanics:read_mechanics .ply":
        pytest.importorskip(LIBRARIES.get(ending, "trimesh"))
    file = tmp_path / f"odd one{ending}"
    KINDS[kind](file)
    monkeypatch.chdir(tmp_path)
    with refused(f"odd one|{re.escape(str(file.resolve()))}"):
        read(file)


OPENING = {"open", "read_text", "read_bytes", "fromfile", "memmap", "loadtxt", "genfromtxt", "read_csv", "read_parquet"}
OPENING |= {"load_file", "parse_file", "load_scene", "parse", "iterparse", "Bitmap", "ZipFile", "File", "FileIO"}
# What opens a file by itself, and why that is no input that has not been looked at
ELSEWHERE = {
    "mistray/read_file.py: os.open": "the one place",
    "mistray/cache/fingerprint.py: path.read_bytes": "mistray's own code",
    "mistray/toolkit/saved_result.py: zipfile.ZipFile": "in memory: what the one place has read, or what is written",
    "mistray/toolkit/saved_result.py: archive.open": "an entry of the archive that is written",
    "mistray/cache/store.py: draft.open": "a file that is written",
    "mistray/cli/__init__.py: open": "the null device, in place of a closed stderr",
    "mistray/cli/__init__.py: os.open": "the null device, in place of what is closed",
    "mistray/replace_file.py: os.open": "a folder, to sync",
    "mistray/cli/program.py: os.open": "the null device, to write to",
    "mistray/replace_file.py: open": "what is open already, to write to",
    "mistray/analyses/explorer/command.py: webbrowser.open": "the browser",
    "mistray/analyses/explorer/assets.py: read_text": "a part of mistray",
    "mistray/toolkit/pages/render.py: read_text": "a part of mistray",
    "mistray/toolkit/pages/parts.py: read_text": "a part of mistray",
    "mistray/entry_points.py: open": "entry points of distributions",
    "mistray/files/irradiance_files.py: fits.open": "bytes of read_file",
    "mistray/files/sky_picture.py: fits.open": "bytes of read_file",
    "mistray/files/ray_sets.py: pd.read_csv": "text of read_text",
    "mistray/files/irradiance_files.py: openexr.File": "a file to write; after require_file",
    "mistray/files/irradiance_files.py: draft.read_bytes": "a file that was written just now",
    "mistray/files/arrays.py: zipfile.ZipFile": "bytes of open_input or read_file",
    "mistray/files/arrays.py: archive.open": "an entry of those",
    "mistray/io/cad/mesh.py: trimesh.load_scene": "bytes of read_file",
    "mistray/io/oslo.py: parse": "optiland's reader; after require_file",
    "mistray/scene/load.py: mi.parser.parse_file": "after check_source",
}


def test_nothing_else_opens_a_file() -> None:
    """Inputs go through `mistray.read_file`; scenes, whose files Mitsuba opens by name, are looked at before."""
    root = Path(mistray.__file__).parents[1]
    found = set()
    for file in sorted(file for place in ("mistray", "plugins") for file in (root / place).rglob("*.py")):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call):
                name = ast.unparse(call.func)
                if isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Call):
                    name = call.func.attr
                if name == "open" or (isinstance(call.func, ast.Attribute) and call.func.attr in OPENING):
                    found.add(f"{file.relative_to(root)}: {name}")
    assert found == set(ELSEWHERE)


def test_a_text_is_read_with_a_mark_and_any_line_ends(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_bytes("\ufeffµ\r\nb\rc\n".encode())
    assert read_text(file) == "µ\nb\nc\n"
    file.write_bytes(b"\xff")
    for name, words in ((file, "text"), ("a\0b", "a.*b"), ("a" * 5000, "aaa")):
        with pytest.raises(MistrayError, match=words):
            read_text(name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_an_entry_of_the_cache_that_is_a_pipe_is_none(tmp_path: Path, patience: None) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(MistrayError, match="pipe"):
        file_fingerprint(tmp_path / "pipe")
    cache = Cache(tmp_path / "cache", 1 << 20)
    cache.put("0" * 64, b"content")
    (entry,) = (file for file in (tmp_path / "cache").iterdir() if "0" * 64 in file.name)
    entry.unlink()
    os.mkfifo(entry)
    assert cache.get("0" * 64, bytes) is None
    assert len(cache.problems) == 1

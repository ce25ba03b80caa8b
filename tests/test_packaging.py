"""The wheel, the sdist's wheel and the editable install hold the files that are in the repository, and nothing else."""

import ast
import importlib
import pkgutil
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
import yaml

ROOT = Path(__file__).parents[1]
# Folder in the repository → folder in the wheel
SOURCES = {"mistray": "mistray", "plugins": "mistray/plugins", "scenes": "mistray/scenes"}


def repository_files() -> list[Path]:
    """Every file that git tracks or would track, relative to the root; without git, every file of the folders."""
    names = []
    if shutil.which("git"):
        command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout.split("\0")
    if not any(names):
        names = [str(file.relative_to(ROOT)) for folder in (*SOURCES, "tests") for file in (ROOT / folder).rglob("*")]
        names = [name for name in names if "__pycache__" not in name]
        names += ["pyproject.toml", "README.md", "LICENSE"]
    return sorted(Path(name) for name in names if name and (ROOT / name).is_file())


def expected_files() -> set[str]:
    parts = [(file.parts[0], "/".join(file.parts[1:])) for file in repository_files()]
    return {f"{SOURCES[top]}/{rest}" for top, rest in parts if top in SOURCES and rest}


def run(*command: str, cwd: Path) -> None:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A copy of the repository to build in: a build in place would pick up stale files of an earlier one."""
    folder = tmp_path_factory.mktemp("clone")
    for file in repository_files():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / file, folder / file)
    return folder


@pytest.mark.parametrize("sdist", [False, pytest.param(True, marks=pytest.mark.long)])
def test_wheel(clone, tmp_path, sdist):
    wheel = ("pip", "wheel", "--no-deps", "--no-build-isolation", "-w", tmp_path, ".")
    command = ("build", "--no-isolation", "--outdir", tmp_path, ".") if sdist else wheel
    run(sys.executable, "-m", *map(str, command), cwd=clone)
    (made,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(made).namelist()
    assert {name for name in names if not re.match(r"mistray-[^/]*\.dist-info/", name)} == expected_files()
    if sdist:
        (made,) = tmp_path.glob("*.tar.gz")
        with tarfile.open(made) as archive:
            held = {name.partition("/")[2] for name in archive.getnames()}
        assert {file.as_posix() for file in repository_files()} <= held


def test_editable_install(clone, tmp_path):
    build = f"from setuptools.build_meta import build_editable; build_editable({str(tmp_path)!r})"
    run(sys.executable, "-c", build, cwd=clone)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path)
    (finder,) = tmp_path.glob("__editable___mistray_*_finder.py")
    statement = next(
        node for node in ast.parse(finder.read_text()).body if "MAPPING" in ast.unparse(node).split("=")[0]
    )
    mapping = {name.replace(".", "/"): Path(folder) for name, folder in ast.literal_eval(statement.value).items()}
    assert mapping == {inside: clone / outside for outside, inside in SOURCES.items()}


def test_nobody_imports_the_mapped_folders_directly():
    """From the root of the repository, `import plugins` is a second copy of `mistray.plugins`."""
    wrong = []
    for file in repository_files():
        for node in ast.walk(ast.parse((ROOT / file).read_text())) if file.suffix == ".py" else ():
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            wrong += [f"{file}:{node.lineno}" for name in names if name.split(".")[0] in ("plugins", "scenes")]
    assert not wrong


PUBLIC = sorted(
    ".".join(file.parent.relative_to(ROOT).parts)
    for file in (ROOT / "mistray").rglob("__init__.py")
    if "__all__" in file.read_text(encoding="utf-8")
)


# A module of these may be called as its function, which is what a prompt offers
LAZY = [f"mistray.{name}" for name in ("analysis", "io", "mechanics", "optimize", "report")]


@pytest.mark.quick
@pytest.mark.parametrize("name", [*PUBLIC, "mistray.scenes"])
def test_public_names(name):
    """A prompt offers what a package means to offer: each name is there, nothing private or imported."""
    package = importlib.import_module(name)
    for found in pkgutil.iter_modules(package.__path__, f"{name}.") if name in LAZY else ():
        importlib.import_module(found.name)
    assert dir(package) == sorted(package.__all__) != []
    for public in package.__all__:
        assert not public.startswith("_") or public == "__version__"
        assert name not in LAZY or not isinstance(getattr(package, public), ModuleType)
        assert hasattr(package, public)
    with pytest.raises(AttributeError, match=f"module '{name}' has no attribute 'nothing'"):
        _ = package.nothing


@pytest.mark.quick
def test_citation_is_of_this_version():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    newest = re.search(r"^## \[(\d.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited["version"] == project["version"] == newest[1]
    assert cited["license"] == project["license"]
    assert cited["keywords"] == project["keywords"]
    assert [author["name"] for author in cited["authors"]] == [author["name"] for author in project["authors"]]
    assert set(cited) >= {"cff-version", "message", "title"}, "what the format requires"


def test_scenes_say_where_their_numbers_come_from_and_files_stay_readable():
    """Files of more than about 500 lines are hard to read."""
    for folder in (folder for folder in (ROOT / "scenes").iterdir() if folder.is_dir() and folder.name[0] != "_"):
        assert (folder / "scene.xml").is_file(), folder.name
        assert (folder / "SOURCE.md").is_file(), folder.name
    sources = [file for file in repository_files() if file.suffix == ".py" and file.parts[0] in SOURCES]
    lengths = {str(file): len((ROOT / file).read_text().splitlines()) for file in sources}
    assert {name: length for name, length in lengths.items() if length > 600} == {}

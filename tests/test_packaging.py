"""Wheel, sdist and editable install hold the files of the repository, which keep to what pages say."""

import ast
import importlib
import importlib.metadata
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
from example_scripts import DOCS, ROOT, script
from packaging.requirements import Requirement
from packaging.version import Version

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
    parts = [(file.parts[0], "/".join(file.parts[1:])) for file in repository_files()]
    expected = {f"{SOURCES[top]}/{rest}" for top, rest in parts if top in SOURCES and rest}
    assert {name for name in names if not re.match(r"mistray-[^/]*\.dist-info/", name)} == expected
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
    body = ast.parse(finder.read_text()).body
    statement = next(node for node in body if "MAPPING" in ast.unparse(node).split("=")[0])
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
    cited = loaded("CITATION.cff")
    newest = re.search(r"^## \[(\d.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited["version"] == PROJECT["version"] == newest[1]
    assert cited["license"] == PROJECT["license"]
    assert cited["keywords"] == PROJECT["keywords"]
    assert [author["name"] for author in cited["authors"]] == [author["name"] for author in PROJECT["authors"]]
    assert set(cited) >= {"cff-version", "message", "title"}, "what the format requires"


def test_scenes_say_where_their_numbers_come_from_and_files_stay_readable():
    """Files of more than about 500 lines are hard to read."""
    for folder in (folder for folder in (ROOT / "scenes").iterdir() if folder.is_dir() and folder.name[0] != "_"):
        assert (folder / "scene.xml").is_file(), folder.name
        assert (folder / "SOURCE.md").is_file(), folder.name
    sources = [file for file in repository_files() if file.suffix == ".py" and file.parts[0] in SOURCES]
    lengths = {str(file): len((ROOT / file).read_text().splitlines()) for file in sources}
    assert {name: length for name, length in lengths.items() if length > 600} == {}


PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
release_check = script("release_check", ROOT / ".ci")
VERSION = Version(PYPROJECT["project"]["version"])
ADDRESS = re.compile(r"[\w.+-]+@[\w-]+\.[a-z]{2,}|git(?:hub|lab)\.com/[\w.-]+/mistray\b|doi\.org/10\.\d+/zenodo")


def loaded(name: str) -> dict:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_the_workflow_runs_the_command_of_the_repository() -> None:
    (job,) = loaded(".github/workflows/tests.yml")["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]
    limit = re.search(r"(\d+) \* 60", (ROOT / ".ci" / "run").read_text(encoding="utf-8"))
    assert limit
    assert job["timeout-minutes"] >= int(limit[1])  # else .ci/run cannot say what was too long
    assert job["container"].startswith(f"python:{PYPROJECT['project']['requires-python'].removeprefix('>=')}")


def test_actions_are_held_to_a_commit_and_hooks_format_as_make_lint() -> None:
    (job,) = loaded(".github/workflows/tests.yml")["jobs"].values()
    used = [step["uses"] for step in job["steps"] if "uses" in step]
    assert used
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", one) for one in used)
    repos = {one["repo"].rpartition("/")[2]: one for one in loaded(".pre-commit-config.yaml")["repos"]}
    (ruff,) = [one for one in map(Requirement, PYPROJECT["dependency-groups"]["lint"]) if one.name == "ruff"]
    assert ruff.specifier.contains(repos["ruff-pre-commit"]["rev"].removeprefix("v"))


@pytest.mark.parametrize("name", ["bug", "own_numbers", "wrong_number", "wish"])
def test_templates_ask_for_what_the_page_of_support_names(name: str) -> None:
    title = loaded(f".github/ISSUE_TEMPLATE/{name}.yml")["name"]
    assert f'"{title}"' in (ROOT / "docs" / "support.md").read_text(encoding="utf-8")


def test_addresses_stand_in_one_place_and_what_the_owner_says() -> None:
    """Only pyproject.toml says where the project is and who keeps it, and CITATION.cff its DOI."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True).stdout.split("\0")
    names = [name for name in names if name.endswith((".md", ".yml", ".yaml", ".cff")) and "/data/" not in name]
    pages = names or ["README.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md"]  # without git
    stated = {name: ADDRESS.findall((ROOT / name).read_text(encoding="utf-8")) for name in pages if name}
    assert {name: found for name, found in stated.items() if found and name != "CITATION.cff"} == {}
    doi = PYPROJECT["project"].get("urls", {}).get("DOI", "").removeprefix("https://doi.org/")
    assert loaded("CITATION.cff").get("doi", "") == doi
    assert len(release_check.missing({})) == 5
    urls = dict.fromkeys(release_check.URLS, "https://example.org")
    assert release_check.missing({"urls": urls, "maintainers": [{"name": "A", "email": "a@example.org"}]}) == []
    page = (ROOT / "docs" / "releases.md").read_text(encoding="utf-8")
    assert all(f"`{word}`" in page for word in release_check.URLS)
    assert "`maintainers = " in page


@pytest.mark.long
def test_the_page_of_support_says_how_to_read_addresses() -> None:
    """What pip prints has the addresses of pyproject.toml, once they are there."""
    (command,) = re.findall(r"(?m)^pip (.*)$", (ROOT / "docs" / "support.md").read_text(encoding="utf-8"))
    done = subprocess.run([sys.executable, "-m", "pip", *command.split()], capture_output=True, text=True)
    assert "Name: mistray" in done.stdout, done.stderr
    assert "Project-URLs:" in done.stdout


@pytest.mark.slow
def test_make_release_check_says_what_is_missing() -> None:
    """Installs its tools, and the wheel with all that it needs: minutes, and the package index."""
    if shutil.which("make") is None or Path(sys.prefix) != ROOT / ".venv":
        pytest.skip("not run by make in its own environment")
    done = subprocess.run(["make", "release-check"], cwd=ROOT, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert all(one in done.stdout for one in release_check.missing(PYPROJECT["project"]))
    assert {file.suffix for file in release_check.OUT.iterdir()} == {".whl", ".gz"}


def ended(call: str) -> bool:
    """Whether a call that warns of a deprecation names no version in which the old name goes, or one that has come."""
    named = re.search(r"goes in mistray (\d+\.\d+)", call)
    return named is None or Version(named[1]) <= VERSION


def test_deprecations_end_when_they_say() -> None:
    """docs/releases.md: each names the version in which it goes, two minor versions on."""
    assert ended("warnings.warn('old is new now', DeprecationWarning)")
    assert ended(f"warnings.warn('old is new now, and goes in mistray {VERSION}', DeprecationWarning)")
    assert not ended("warnings.warn('old is new now, and goes in mistray 99.0', DeprecationWarning)")
    found = [
        f"{file.relative_to(ROOT)}: {ast.unparse(node)}"
        for top in ("mistray", "plugins")
        for file in sorted((ROOT / top).rglob("*.py"))
        if "DeprecationWarning" in (text := file.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and "DeprecationWarning" in [ast.unparse(one) for one in node.args]
    ]
    assert [one for one in found if ended(one)] == []


MATRIX = script("make_support_matrix", DOCS)
PROJECT = PYPROJECT["project"]


def size_bytes(name: str, seen: dict[str, int]) -> None:
    """Adds what the files of a distribution, and of those that it needs, take on the disk."""
    if name.lower() in seen:
        return
    found = importlib.metadata.distribution(name)
    paths = [found.locate_file(file) for file in found.files or ()]
    seen[name.lower()] = sum(512 * path.stat().st_blocks for path in paths if path.is_file())
    for needed in map(Requirement, found.requires or ()):
        if needed.marker is None or needed.marker.evaluate({"extra": ""}):
            size_bytes(needed.name, seen)


def test_the_table_of_packages_is_current() -> None:
    """After a change of a version: PYTHONPATH=tests python docs/make_support_matrix.py."""
    assert MATRIX.PAGE.read_text(encoding="utf-8") == MATRIX.page()
    assert MATRIX.table().count("\n") > 20


def test_lowest_versions_are_allowed_by_what_the_tests_ran_with() -> None:
    tested = MATRIX.tested()
    for text in PROJECT["dependencies"]:
        needed = Requirement(text)
        assert needed.specifier.contains(tested[needed.name.lower()]), text


@pytest.mark.parametrize("page", [ROOT / "README.md", MATRIX.PAGE], ids=lambda page: page.stem)
def test_the_environment_is_as_large_as_the_page_says(page) -> None:
    """Of what pip installs without extras; another file system or Python changes it by some per cent."""
    seen: dict[str, int] = {}
    for text in PROJECT["dependencies"]:
        size_bytes(Requirement(text).name, seen)
    (stated,) = re.findall(r"about (\d+) MB", page.read_text(encoding="utf-8"))
    assert sum(seen.values()) / 1e6 == pytest.approx(int(stated), rel=0.1)


def test_pythons_of_the_page_are_those_of_the_classifiers() -> None:
    named = [text.rpartition(" ")[2] for text in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", text)]
    assert named == re.findall(r"(?m)^\| (3\.\d+) \| tested", MATRIX.PAGE.read_text(encoding="utf-8"))
    assert f">={named[0]}" == PROJECT["requires-python"]

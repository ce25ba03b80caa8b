"""Files around the program keep to what pages say: workflow, hooks, templates, addresses, deprecations."""

import ast
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from example_scripts import ROOT, script
from packaging.requirements import Requirement
from packaging.version import Version

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


def test_actions_are_held_to_a_commit() -> None:
    (job,) = loaded(".github/workflows/tests.yml")["jobs"].values()
    used = [step["uses"] for step in job["steps"] if "uses" in step]
    assert used
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", one) for one in used)


def test_hooks_format_as_make_lint_does() -> None:
    repos = {one["repo"].rpartition("/")[2]: one for one in loaded(".pre-commit-config.yaml")["repos"]}
    (ruff,) = [one for one in map(Requirement, PYPROJECT["dependency-groups"]["lint"]) if one.name == "ruff"]
    assert ruff.specifier.contains(repos["ruff-pre-commit"]["rev"].removeprefix("v"))


@pytest.mark.parametrize("name", ["bug", "own_numbers", "wrong_number", "wish"])
def test_templates_ask_for_what_the_page_of_support_names(name: str) -> None:
    title = loaded(f".github/ISSUE_TEMPLATE/{name}.yml")["name"]
    assert f'"{title}"' in (ROOT / "docs" / "support.md").read_text(encoding="utf-8")


def test_addresses_stand_in_one_place() -> None:
    """Only pyproject.toml says where the project is and who keeps it, and CITATION.cff its DOI."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True).stdout.split("\0")
    names = [name for name in names if name.endswith((".md", ".yml", ".yaml", ".cff")) and "/data/" not in name]
    pages = names or ["README.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md"]  # without git
    stated = {name: ADDRESS.findall((ROOT / name).read_text(encoding="utf-8")) for name in pages if name}
    assert {name: found for name, found in stated.items() if found and name != "CITATION.cff"} == {}
    doi = PYPROJECT["project"].get("urls", {}).get("DOI", "").removeprefix("https://doi.org/")
    assert loaded("CITATION.cff").get("doi", "") == doi


def test_what_only_the_owner_can_say() -> None:
    assert len(release_check.missing({})) == 5
    urls = dict.fromkeys(release_check.URLS, "https://example.org")
    assert release_check.missing({"urls": urls, "maintainers": [{"name": "A", "email": "a@example.org"}]}) == []
    page = (ROOT / "docs" / "releases.md").read_text(encoding="utf-8")
    assert all(f"`{word}`" in page for word in release_check.URLS)
    assert "`maintainers = " in page


@pytest.mark.long
def test_the_page_of_support_says_how_to_read_addresses() -> None:
    """What pip prints has the addresses of pyproject.toml, once they are there."""
    page = (ROOT / "docs" / "support.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"(?m)^pip (.*)$", page)
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


def deprecations(text: str) -> Iterator[str]:
    """Sources of the calls that warn of a deprecation."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and "DeprecationWarning" in [ast.unparse(one) for one in node.args]:
            yield ast.unparse(node)


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
        f"{file.relative_to(ROOT)}: {call}"
        for top in ("mistray", "plugins")
        for file in sorted((ROOT / top).rglob("*.py"))
        if "DeprecationWarning" in (text := file.read_text(encoding="utf-8"))
        for call in deprecations(text)
    ]
    assert [one for one in found if ended(one)] == []

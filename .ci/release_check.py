"""Checks a release before it is published, and lists what only the owner can fill in: ``make release-check``.

Builds the wheel and the source distribution into out/release, installs the wheel into an empty environment, and checks
the files that others read by their schemas. The tools come from the environment that runs this.
"""

import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out" / "release"
URLS = ("Repository", "Issues", "DOI")
LEFT_OUT = (".git", ".venv*", ".nox", "out", "build", "dist", "*.egg-info", "__pycache__", ".*_cache")
# Files that others read, and the schemas, as check-jsonschema calls them, that they follow
SCHEMAS = {
    "CITATION.cff": "vendor.citation-file-format",
    ".github/workflows/*.yml": "vendor.github-workflows",
    ".github/dependabot.yml": "vendor.dependabot",
    ".github/ISSUE_TEMPLATE/config.yml": "vendor.github-issue-config",
    ".github/ISSUE_TEMPLATE/[!c]*.yml": "vendor.github-issue-forms",
}


def missing(project: dict) -> list[str]:
    """What only the owner can say, and the table [project] of pyproject.toml does not."""
    urls = project.get("urls", {})
    maintainers = project.get("maintainers", [])
    found = [f"pyproject.toml, [project.urls]: {name}" for name in URLS if not urls.get(name)]
    if not any(one.get("name") for one in maintainers):
        found.append("pyproject.toml, [project]: maintainers, each with a name")
    if not any(one.get("email") for one in maintainers):
        found.append("pyproject.toml, [project]: email of a maintainer, for what is private")
    return found


def run(*command: str | Path, cwd: Path = ROOT) -> None:
    """Run a command and print it; end with its status if it fails."""
    words = [str(word) for word in command]
    print("$", *(Path(word).name if Path(word).is_absolute() else word for word in words), flush=True)
    status = subprocess.run(words, cwd=cwd).returncode
    if status:
        raise SystemExit(f"release-check: {Path(words[0]).name} {' '.join(words[1:4])} failed with status {status}")


def tool(*words: str | Path) -> None:
    """Run a module of the environment that runs this."""
    run(sys.executable, "-m", *words)


def check_files() -> None:
    """Check what others read, by schemas, by the validator of the hooks, and by the guide of Scientific Python."""
    for pattern, schema in SCHEMAS.items():
        tool("check_jsonschema", "--builtin-schema", schema, *sorted(ROOT.glob(pattern)))
    tool("pre_commit", "validate-config")
    tool("repo_review", ".", "--show", "err")


def check_packages() -> None:
    """Build both distributions, check them, and try the wheel in an empty environment."""
    shutil.rmtree(OUT, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:  # a build in place would pick up stale files, and leave some
        copy = Path(folder) / "mistray"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_OUT))
        tool("build", "--quiet", "--outdir", OUT, copy)
    tool("twine", "check", "--strict", *sorted(OUT.iterdir()))
    (wheel,) = OUT.glob("*.whl")
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = Path(folder) / "bin" / "python"
        run(python, "-m", "pip", "install", "--quiet", wheel, cwd=Path(folder))
        run(python, "-m", "pip", "check", cwd=Path(folder))
        run(python.with_name("mistray"), "--version", cwd=Path(folder))


if __name__ == "__main__":
    check_files()
    check_packages()
    print("\n".join(["", "made:", *(f"  {file.relative_to(ROOT)}" for file in sorted(OUT.iterdir()))]))
    if owed := missing(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]):
        print("\n".join(["", "only the owner can fill in (docs/releases.md):", *(f"  {one}" for one in owed)]))

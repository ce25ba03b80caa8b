"""Faults that are put into a copy of the program, one at a time: `python tests/mutations.py [NAME ...]`.

A fault is caught if a test fails that `make test` runs, in the files named beside it. The run says which, and ends with
exit code 1 if a fault is not caught.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import vectors

ROOT = Path(__file__).parents[1]


class Fault(NamedTuple):
    """One line of the program, and what it becomes."""

    file: str
    right: str
    wrong: str
    tests: str  # files or folders where it should show, below tests


FAULTS = {name: Fault(**fault) for name, fault in vectors.toml("faults.toml").items()}


def caught(fault: Fault) -> str:
    """The test that fails, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mistray"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv*", "out", "__pycache__", ".*_cache"))
        for package in ("plugins", "scenes"):  # installed from beside the package; those of the copy count
            (copy / "mistray" / package).symlink_to(copy / package)
        path = copy / fault.file
        text = path.read_text(encoding="utf-8")
        if text.count(fault.right) != 1:
            raise SystemExit(
                f"'{fault.right}' is {text.count(fault.right)} times in {fault.file}; mend tests/data/faults.toml"
            )
        path.write_text(text.replace(fault.right, fault.wrong), encoding="utf-8")
        options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "-n", "2", "--dist", "loadfile"]
        tests = [f"tests/{name}" for name in fault.tests.split()]
        command = [sys.executable, "-m", "pytest", *options, "-m", "not (gpu or slow or long)", *tests]
        done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1, 2):
        raise SystemExit(done.stdout + done.stderr)
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    return found[1] if found else ""


def main(names: list[str]) -> int:
    survived = 0
    for name in names or FAULTS:
        by = caught(FAULTS[name])
        survived += not by
        print(f"{name}: {'caught by ' + by if by else 'NOT CAUGHT'}", flush=True)
    return min(survived, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Arguments that are none, closed streams, places without UTF-8 or home: a line says what to do, or all is well."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from attack.processes import MISTRAY
from command_line import Captured, Patch, fails
from oracles.small_scenes import plates_text

from mistray.cli.program import COMMANDS
from mistray.errors import MistrayWarning
from mistray.report import writable_directory
from mistray.toolkit.figures.figure import Figure

CONTENTS = [bytes([letter]) * 300_000 for letter in b"abcd"]
# An option of every kind
KINDS = {
    (str(option.type), option.nargs): (module.COMMAND.name, word)
    for module in COMMANDS
    for option in module.COMMAND.options
    for word in option.name.split()
    if word.startswith("--") and option.type is not bool
}


@pytest.mark.quick
def test_arguments_that_are_none(capsys: Captured, tmp_path: Path, monkeypatch: Patch) -> None:
    """Two dashes, of which argparse of Python 3.11 makes an empty list; a name that is empty; a filter too deep."""
    monkeypatch.chdir(tmp_path)
    assert len(KINDS) > 30
    for command, option in KINDS.values():
        line = fails(capsys, command, f"{option}=--")
        assert option in line
        assert "'--' is no value" in line or "expected" in line
    for words in (("ghosts", "plate", "--out", ""), ("import", "a.zmx", "-o", " "), ("view", "plate", "--layout=")):
        assert "names nothing" in fails(capsys, *words)
    with pytest.raises(ValueError, match="no name"):
        writable_directory("")
    for text in ("(" * 5000 + "H" + ")" * 5000, "!" * 20_000 + "H", "(" * 101 + "H" + ")" * 101):
        line = fails(capsys, "ghosts", "plate", "--filter", text)
        assert "filter '" in line
        assert "100 are the most" in line
        assert len(line) < 400
    assert not list(tmp_path.iterdir())


def test_letters_that_a_font_does_not_have() -> None:
    figure = Figure()
    figure.headed("L\N{COLLISION SYMBOL}_front", "\N{COLLISION SYMBOL}")
    with pytest.warns(MistrayWarning, match="COLLISION SYMBOL") as caught:
        figure.savefig(io.BytesIO(), format="png", bbox_inches="tight")
    assert len(caught) == 1


WRITER = """
import sys
sys.argv, out = ["mistray"], sys.argv[1]
from mistray.toolkit.pages.output import write_files
print(flush=True)
while True:
    for letter in b"abcd":
        data = bytes([letter]) * 300_000
        write_files({"paths.csv": data, "report.html": data}, out)
"""


def test_two_processes_write_the_same_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", WRITER, str(out)]
    with ExitStack() as stack:
        both = [stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True)) for _ in range(2)]
        for process in both:
            stack.callback(process.kill)
        for process in both:
            assert process.stdout is not None
            process.stdout.readline()
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            # Drafts end in .part; the record of a set that is being replaced starts with a dot
            for name in ("paths.csv", "report.html"):
                assert not (out / name).exists() or (out / name).read_bytes() in CONTENTS
        ends = [process.poll() for process in both]
    assert ends == [None, None]  # neither has met a draft of the other
    assert {"paths.csv", "report.html"} <= {path.name for path in out.iterdir()}


def test_nobody_reads_the_output() -> None:
    full = "mistray: error: No space left on device; "
    for command, code, told in (
        ("--help | true", 0, ""), ("ghosts --help | true", 0, ""), ("completion bash | head -1", 0, ""),
        ("--version >&-", 0, ""), ("--version > /dev/full", 2, full),
    ):  # fmt: skip
        line = f"set -o pipefail; {' '.join(MISTRAY)} {command}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60)
        assert done.returncode == code
        assert done.stderr[: len(full)] == told
        assert done.stderr.count("\n") == bool(told)


@pytest.mark.long
def test_strange_surroundings(tmp_path: Path) -> None:
    """A scene whose name is no ASCII: no UTF-8, no home for the cache of kernels, no asserts and docstrings."""
    scene, out = tmp_path / "Höhe.xml", tmp_path / "out"
    scene.write_text(plates_text(1), encoding="utf-8")
    surroundings = {
        "LC_ALL": "C", "LANG": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": "",
        "HOME": "/proc/nobody", "XDG_CACHE_HOME": "/proc/nobody/cache", "MPLCONFIGDIR": str(tmp_path / "mpl"),
        "PYTHONOPTIMIZE": "2",
    }  # fmt: skip
    command = [*MISTRAY, "ghosts", str(scene), "--rays", "200", "--json", "--out", str(out)]
    done = subprocess.run(command, env={**os.environ, **surroundings}, capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert b"the disk cache is disabled." in done.stderr  # of Dr.Jit
    assert json.loads(done.stdout)["fields"]
    assert "Höhe" in (out / "report.html").read_text(encoding="utf-8")

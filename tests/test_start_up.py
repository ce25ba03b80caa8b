"""Starting costs what the task needs and no more: what is imported when, and how much CPU time, best of several.

That of the package grows with the load of the machine, and is compared with that of NumPy and Mitsuba alone.
"""

import resource
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

HELP_S = 0.3  # three times what it takes
OF_MITSUBA = 3.0  # 0.9 s over 0.4 s is usual, the tables and pictures of a report would add 1.5 s
REPEATS = 3
BARE = "import numpy, mitsuba; mitsuba.set_variant('llvm_ad_rgb')"


def run(*command: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """A process that has ended well, and its CPU time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode == 0, done.stderr
    return done, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def imported(*command: str) -> set[str]:
    done, _ = run(sys.executable, "-X", "importtime", *command)
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines() if "|" in line}


@pytest.fixture
def byte_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where an environment writes none, Python's compiler would be timed."""
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    monkeypatch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path))


@pytest.mark.usefixtures("byte_code")
def test_help_is_fast_and_imports_nothing_that_traces() -> None:
    heavy = {"mitsuba", "drjit", "numpy", "scipy", "pandas", "matplotlib", "pyarrow"}
    for arguments in (("--help",), ("ghosts", "--help"), ("--version",)):
        assert not imported("-m", "mistray", *arguments) & heavy
    assert min(run(sys.executable, "-m", "mistray", "--help")[1] for _ in range(REPEATS)) < HELP_S


def test_the_list_of_commands_needs_no_request(tmp_path: Path) -> None:
    """The options of a command, and what says them, are made when it is used."""
    script = tmp_path / "mistray"
    lines = "import sys\nfrom mistray.cli import main\nmain(['--help'])\nprint(*sys.modules, sep='\\n')\n"
    script.write_text(lines, encoding="utf-8")
    done, _ = run(sys.executable, str(script))
    found = {name for name in done.stdout.split() if name.startswith("mistray.analyses.")}
    assert "mistray.analyses.ghosts.command" in found
    assert {name.rpartition(".")[2] for name in found if name.count(".") > 2} == {"command"}


@pytest.mark.usefixtures("byte_code")
def test_the_package_is_fast() -> None:
    run(sys.executable, "-c", "import mistray")
    programs = "import mistray", BARE
    package, bare = (min(run(sys.executable, "-c", code)[1] for _ in range(REPEATS)) for code in programs)
    assert package < OF_MITSUBA * bare


def test_a_program_gets_a_variant_and_the_command_does_not(tmp_path: Path) -> None:
    """The same lines as a script called mistray, which is what pip installs, and called otherwise."""
    lines = """
        import sys
        import mistray
        print("mitsuba" in sys.modules, end=" ")
        print(callable(mistray.trace), sys.modules["mitsuba"].variant())
    """
    for name, eager in (("mistray", False), ("program.py", True)):
        script = tmp_path / name
        script.write_text(textwrap.dedent(lines), encoding="utf-8")
        done, _ = run(sys.executable, str(script))
        assert done.stdout.split() == [str(eager), "True", "llvm_ad_rgb"]


@pytest.mark.quick
def test_a_table_needs_no_pictures() -> None:
    """Matplotlib is for --out, SciPy for searches and statistics; the package alone needs no pandas either."""
    assert not imported("-c", "import mistray") & {"scipy", "pandas", "matplotlib", "pyarrow", "colour", "plotly"}
    found = imported("-m", "mistray", "ghosts", "plate", "--rays", "1000")
    assert "mitsuba" in found
    assert not found & {"matplotlib", "scipy", "colour", "plotly"}


def test_every_module_can_be_the_first_that_the_command_imports(tmp_path: Path) -> None:
    """In the command's process nothing is active before: whoever uses types of a variant makes one active."""
    script = tmp_path / "mistray"
    script.write_text("import sys, importlib\nfor name in sys.argv[1:]:\n    importlib.import_module(name)\n")
    run(sys.executable, str(script), "mistray.toolkit.figures.plots")
    run(sys.executable, str(script), "mistray.scene", "mistray.mechanics", "mistray.kernel.lobes")

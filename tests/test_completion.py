"""`mistray completion`: what the shells propose is what the parsers take."""

import argparse
import shutil
import subprocess

import pytest
import vectors
from command_line import succeeds

from mistray.cli import program
from mistray.cli.commands import completion

BASH = shutil.which("bash")


@pytest.fixture(scope="module")
def commands():
    return completion.described(module.COMMAND for module in program.COMMANDS)


@pytest.fixture(scope="module")
def bash(commands, tmp_path_factory):
    """Proposals of bash for a line with the cursor at its end, by the script itself."""
    if BASH is None:
        pytest.skip("there is no bash")
    folder = tmp_path_factory.mktemp("bash")
    (folder / "mistray.bash").write_text(completion.script("bash", commands), encoding="utf-8")
    (folder / "lens.xml").write_text("")
    (folder / "my lens.zmx").write_text("")
    (folder / "out").mkdir()

    def proposals(*words: str) -> list[str]:
        code = (
            'source mistray.bash; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _mistray; printf "%s\\n" "${COMPREPLY[@]}"'
        )
        done = subprocess.run(
            [BASH, "--norc", "-c", code, "bash", "mistray", *words],
            cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert done.stderr == ""
        return [line for line in done.stdout.splitlines() if line]

    return proposals


def test_bash_proposes_what_the_parsers_take(bash, commands):
    choices = program._parser()._subparsers._group_actions[0].choices
    assert [command.name for command in commands] == list(choices)
    assert set(bash("")) == {"-h", "--help", "--version", *choices}
    for command in commands:
        choices[command.name].declare_all()
        shown = [action for action in choices[command.name]._actions if action.help != argparse.SUPPRESS]
        flags = {flag for action in shown for flag in action.option_strings}
        assert {flag for value in command.options for flag in value.flags} == flags == set(bash(command.name, "-"))
        assert command.help


# Words of a line, its last one unfinished, and all that is proposed
PROPOSALS = vectors.toml("tables.toml")["completion"]  # fmt: skip


@pytest.mark.parametrize("line", PROPOSALS)
def test_bash_proposes(bash, line):
    assert set(bash(*line.split(" "))) == set(PROPOSALS[line].split())


def test_bash_proposes_scenes_models_and_files(bash):
    assert {"phone_camera", "phone_camera_scatter", "lens.xml"} <= set(bash("ghosts", ""))
    assert "phone_camera" in bash("ghosts", "--splitting", "one", "ph")  # which has a single value
    assert {"abg", "paint"} <= set(bash("bsdf", ""))
    assert "bbar3" in bash("coating", "bb")
    assert bash("import", "my") == ["my lens.zmx"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts(capsys, shell, commands, tmp_path):
    """Each holds every command and option, describes them as the help does, and the shell, if there, can read it."""
    out = succeeds(capsys, "completion", shell)
    assert out == completion.script(shell, commands)
    for command in commands:
        assert command.name in out
        for flag in (flag for value in command.options for flag in value.flags):
            fish = f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}"
            assert (fish if shell == "fish" else flag) in out
    if shell != "bash":
        assert " 5 %," in out
        assert "%%" not in out  # doubled for argparse alone
    if program_ := shutil.which(shell):
        (tmp_path / "script").write_text(out, encoding="utf-8")
        done = subprocess.run([program_, "-n", str(tmp_path / "script")], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")


def test_zsh_and_fish_escape_what_they_would_read():
    value = completion.Value("N", "a [b]: 'c' \\", ("--n",), ("x", "y"), many=True)
    assert completion._zsh_option(value, "--n") == "--n[a \\[b\\]\\: 'c' \\\\]:*-*:N:(x y)"
    both = completion.Value("SCENE", "", names=("plate",), files=True)
    assert completion._zsh_value(both, "1:") == ("1:SCENE:{_alternative 'names:name:(plate)' 'files:file:_files'}")
    assert completion._fish_text("it's a \\") == "'it\\'s a \\\\'"

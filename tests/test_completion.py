"""`mistray completion`: what the shells propose is what the parsers take."""

from __future__ import annotations

import argparse
import shutil
import subprocess
from pathlib import Path

import pytest

from mistray import cli
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


def test_every_command_and_option_is_described(commands):
    choices = program._parser()._subparsers._group_actions[0].choices
    assert [command.name for command in commands] == list(choices)
    for command in commands:
        choices[command.name].declare_all()
        shown = [action for action in choices[command.name]._actions if action.help != argparse.SUPPRESS]
        given = {flag for action in shown for flag in action.option_strings}
        assert {flag for value in command.options for flag in value.flags} == given
        assert command.help


@pytest.mark.parametrize("shell", ["fish", "zsh"])
def test_shells_describe_options_as_their_help_does(shell, commands):
    """A percent sign is doubled for argparse alone."""
    text = completion.script(shell, commands)
    assert " 5 %," in text
    assert "%%" not in text


def test_bash_proposes_commands(bash, commands):
    assert set(bash("")) == {"-h", "--help", "--version", *(command.name for command in commands)}
    assert bash("gh") == ["ghosts"]
    assert bash("--v") == ["--version"]
    assert bash("xyz") == []


def test_bash_proposes_the_options_of_a_command(bash, commands):
    for command in commands:
        flags = {flag for value in command.options for flag in value.flags}
        assert set(bash(command.name, "-")) == flags
    assert bash("ghosts", "plate", "--max-ref") == ["--max-reflections"]
    assert set(bash("pst", "plate", "--field-deg", "0", "10", "--map-")) == {
        "--map-field-deg", "--map-azimuth-deg", "--map-pixels",
    }  # fmt: skip


def test_bash_proposes_choices(bash):
    assert bash("ghosts", "plate", "--splitting", "") == ["split", "one"]
    assert bash("ghosts", "plate", "--aim", "ta") == ["targets"]
    assert bash("ghosts", "plate", "--rays", "") == []
    assert bash("completion", "") == ["bash", "zsh", "fish"]
    # an option of several values goes on, one of a single value does not
    assert set(bash("ghosts", "plate", "--formats", "parquet", "")) == {"parquet", "exr", "fits", "npy", "dat", "pdf"}
    assert "phone_camera" in bash("ghosts", "--splitting", "one", "ph")


def test_bash_proposes_scenes_models_and_files(bash):
    assert {"phone_camera", "phone_camera_scatter", "lens.xml"} <= set(bash("ghosts", ""))
    assert bash("ghosts", "le") == ["lens_and_reflector", "lens_and_screen", "lens_and_window", "lens.xml"]
    assert bash("ghosts", "plate", "--out", "o") == ["out"]
    assert {"abg", "paint"} <= set(bash("bsdf", ""))
    assert "bbar3" in bash("coating", "bb")
    assert bash("import", "len") == ["lens.xml"]
    assert bash("import", "my") == ["my lens.zmx"]


def test_proposals_are_taken(capsys, bash):
    """Commands that are proposed exist: their help is printed."""
    for name in bash(""):
        if not name.startswith("-"):
            assert cli.main([name, "--help"]) == 0
            assert f"mistray {name}" in capsys.readouterr().out


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_hold_every_command_and_option(capsys, shell, commands):
    assert cli.main(["completion", shell]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out == completion.script(shell, commands)
    for command in commands:
        assert command.name in out
        for value in command.options:
            for flag in value.flags:
                fish = f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}"
                assert (fish if shell == "fish" else flag) in out


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_can_read_its_script(shell, commands, tmp_path):
    program_ = shutil.which(shell)
    if program_ is None:
        pytest.skip(f"there is no {shell}")
    path = Path(tmp_path / "script")
    path.write_text(completion.script(shell, commands), encoding="utf-8")
    done = subprocess.run([program_, "-n", str(path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_zsh_escapes_what_it_would_read():
    value = completion.Value("N", "a [b]: 'c' \\", ("--n",), ("x", "y"), many=True)
    assert completion._zsh_option(value, "--n") == "--n[a \\[b\\]\\: 'c' \\\\]:*-*:N:(x y)"
    both = completion.Value("SCENE", "", names=("plate",), files=True)
    assert completion._zsh_value(both, "1:") == ("1:SCENE:{_alternative 'names:name:(plate)' 'files:file:_files'}")


def test_fish_quotes():
    assert completion._fish_text("it's a \\") == "'it\\'s a \\\\'"


def test_unknown_shell(capsys):
    assert cli.main(["completion", "tcsh"]) == 2
    assert "invalid choice: 'tcsh'" in capsys.readouterr().err

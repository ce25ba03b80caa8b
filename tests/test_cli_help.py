"""What `--help` says is true: examples are commands, defaults are those that hold."""

import argparse
import inspect
import re
import shlex
from dataclasses import fields

import pytest

from mistray.cli import program
from mistray.settings import NO_LIMIT
from mistray.toolkit.command import AnalysisCommand
from mistray.trace import Settings

pytestmark = pytest.mark.quick

COMMANDS: dict[str, argparse.ArgumentParser] = program._parser()._subparsers._group_actions[0].choices
for _parser in COMMANDS.values():
    _parser.declare_all()
OPTIONS = {
    name: [
        action
        for action in parser._actions
        if not isinstance(action, argparse._HelpAction) and action.help != argparse.SUPPRESS
    ]
    for name, parser in COMMANDS.items()
}
SETTINGS = {setting.name: setting.default for setting in fields(Settings)}


def examples(parser: argparse.ArgumentParser) -> list[str]:
    """Commands in the epilog, without remarks."""
    lines = (parser.epilog or "").splitlines()
    return [line.partition("    #")[0].strip() for line in lines if line.startswith("  ")]


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_examples_are_commands(name: str) -> None:
    """Those of a command, and of the program, some of which ask for help."""
    lines = examples(COMMANDS[name] if name else program._parser())
    assert lines
    for line in lines:
        inner = re.search(r"<\((.*)\)", line)  # the shell reads what a command prints
        words = shlex.split(inner[1] if inner else line)
        assert words[: 2 if name else 1] == ["mistray", *([name] if name else [])], line
        if name or "--help" not in words:
            program._parser().parse_args(words[1 : words.index(">") if ">" in words else None])


@pytest.mark.parametrize("name", COMMANDS)
def test_defaults_are_those_that_hold(name: str) -> None:
    """A setting of the trace: that of `Settings`. Any other number that argparse fills in: that number."""
    for action in OPTIONS[name]:
        told = (re.findall(r"\(([^()]+)\)", action.help or "") or [None])[-1]
        if action.dest in SETTINGS and action.default is None and action.dest not in ("rays", "ray_control"):
            default = SETTINGS[action.dest]
            if isinstance(default, str):
                assert told == default, action.dest
            elif isinstance(default, tuple):
                assert told == "none", action.dest
                assert not any(default), action.dest
            elif told != "no limit":
                assert float(told or "nan") == default, action.dest
            else:
                assert default == NO_LIMIT, action.dest
        elif isinstance(action.default, (int, float)) and not isinstance(action.default, bool):
            assert told is not None, f"{action.dest}: the default {action.default:g} is not named"
            assert action.default in [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", told)]


def test_commands_that_trace_have_a_variant_and_threads_and_those_that_write_reports_can_be_quiet() -> None:
    flags = {name: {flag for action in of for flag in action.option_strings} for name, of in OPTIONS.items()}
    assert {"--variant", "--threads"} <= flags["ghosts"]
    for module in program.COMMANDS:
        name = module.COMMAND.name
        found = flags[name]
        starts = isinstance(module.COMMAND, AnalysisCommand) or "options.start()" in inspect.getsource(module)
        assert starts == ({"--variant", "--threads"} <= found), name
        assert "--out" not in found or "--quiet" in found, name

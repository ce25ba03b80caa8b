"""Command `mistray completion`, which prints a script by which a shell completes commands, options and names."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mistray.cli.parsed_options import Options
from mistray.toolkit.command import Command, Option

# Placeholders of file names
FILES = ("AGF", "BUDGET", "COATING", "DIR", "FILE", "MODEL", "SCENE", "STUDY", "XML", "ZMX")
MANY = ("*", "+")


# fmt: off
COMMAND = Command(
    "completion",
    "print a script with which the shell completes mistray's commands and options",
    "Print a script for bash, zsh or fish that completes commands, options, choices, the names of\n"
    "shipped scenes, scatter models and coatings, and files. It is made from the options of this version.",
    (
        "mistray completion bash > ~/.local/share/bash-completion/completions/mistray",
        "mistray completion zsh > ~/.zfunc/_mistray    # a folder of fpath, before compinit",
        "mistray completion fish > ~/.config/fish/completions/mistray.fish",
    ),
    (Option("shell", "for which shell", ("bash", "zsh", "fish")),),
)
# fmt: on


def run(options: Options) -> int:
    """Print the completion script for a shell; return the exit code 0."""
    from mistray.cli.program import COMMANDS

    print(script(options.shell, described(module.COMMAND for module in COMMANDS)), end="")
    return 0


@dataclass(frozen=True)
class Value:
    """
    Option or positional argument of a command, with the values that a shell proposes for it.

    Attributes
    ----------
    label : str
        Placeholder in the help; "" for a flag, which takes no value.
    help : str
        Help text.
    flags : tuple of str
        Forms of the option, such as "-o" and "--output"; empty for a positional argument.
    names : tuple of str
        Names that are proposed as values.
    files : bool
        Whether files are proposed as well.
    many : bool
        Whether it takes several values.
    """

    label: str
    help: str
    flags: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    files: bool = False
    many: bool = False


@dataclass(frozen=True)
class Described:
    """Command as the shell completes it: name, line of help, options and positional arguments."""

    name: str
    help: str
    options: tuple[Value, ...]
    positional: tuple[Value, ...]


HELP = Value("", "show this help message and exit", ("-h", "--help"))


def described(commands: Iterable[Command]) -> list[Described]:
    """Return a description of each command with its options and positional arguments, for `script`."""
    names = _names()
    found = []
    for command in commands:
        values = [HELP, *(_value(option, names) for option in command.options)]
        options = tuple(value for value in values if value.flags)
        positional = tuple(value for value in values if not value.flags)
        found.append(Described(command.name, command.help, options, positional))
    return found


def _names() -> dict[str, tuple[str, ...]]:
    """Return names to propose for arguments that also take a file, by the arguments' placeholder."""
    from mistray.coatings import PRESETS
    from mistray.scatter.kinds import KINDS
    from mistray.scene.load import shipped_scenes

    scenes = tuple(shipped_scenes())
    return {"SCENE": scenes, "MODEL": tuple(KINDS), "COATING": (*PRESETS, "bare", *scenes)}


def _value(option: Option, names: Mapping[str, tuple[str, ...]]) -> Value:
    label = option.metavar if isinstance(option.metavar, str) else option.dest
    flags = tuple(option.name.split()) if option.name.startswith("-") else ()
    if option.type is bool:
        return Value("", option.help, flags)
    proposed = option.type if isinstance(option.type, tuple) else names.get(label, ())
    files = option.type is Path or label in FILES
    many = option.nargs in MANY or (isinstance(option.nargs, int) and option.nargs > 1)
    return Value(label, option.help, flags, proposed, files, many)


def script(shell: str, commands: list[Described]) -> str:
    """
    Return the completion script for a shell.

    Parameters
    ----------
    shell : {"bash", "zsh", "fish"}
        Shell that will read the script.
    commands : list of Described
        Commands with their options and arguments.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("mistray.cli"), trim_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined
    )
    made.filters |= {
        "quoted": shlex.quote,
        "bash_values": _bash_values,
        "zsh_text": _zsh_text,
        "zsh_specs": _zsh_specs,
        "fish_text": _fish_text,
        "fish_value": _fish_value,
    }
    return made.get_template(f"{shell}.jinja").render(commands=commands)


def _bash_values(values: Sequence[Value]) -> str:
    """Return bash code that sets `names` to the names proposed for some arguments, and `files` to yes or no."""
    names = shlex.quote(" ".join(name for value in values for name in value.names))
    return f"names={names} files={'yes' if any(value.files for value in values) else 'no'}"


def _zsh_specs(command: Described) -> list[str]:
    """Return the specifications that `_arguments` of zsh takes, one string for each option and argument."""
    specs = [_zsh_option(value, flag) for value in command.options for flag in value.flags]
    return specs + [_zsh_value(value, f"{number}:") for number, value in enumerate(command.positional, start=1)]


def _zsh_option(value: Value, flag: str) -> str:
    head = f"{flag}[{_zsh_text(value.help)}]"
    if not value.label:
        return head
    return head + _zsh_value(value, ":*-*:" if value.many else ":")


def _zsh_value(value: Value, start: str) -> str:
    """Return the specification of a value for zsh: `start`, its placeholder, and the proposed names and files."""
    label, names = _zsh_text(value.label), " ".join(value.names)
    if value.files and names:
        return f"{start}{label}:{{_alternative 'names:name:({names})' 'files:file:_files'}}"
    if value.files:
        return f"{start}{label}:_files"
    return f"{start}{label}:({names})" if names else f"{start}{label}: "


def _zsh_text(text: str) -> str:
    """Return `text` escaped for use between brackets or colons in a specification for zsh."""
    for character in "\\[]:":
        text = text.replace(character, f"\\{character}")
    return text


def _fish_value(value: Value, exclusive: str) -> str:
    if not value.label:
        return ""
    names = f" -a {_fish_text(' '.join(value.names))}" if value.names else ""
    if value.files:
        return f" -r -F{names}" if exclusive else f" -F{names}"
    return f"{exclusive}{names}"


def _fish_text(text: str) -> str:
    """Return `text` quoted for fish, with backslashes and quotes escaped."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"

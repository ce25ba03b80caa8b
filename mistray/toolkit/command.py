"""Description of a command as data: texts and options, from which parser and shell completion are made."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from mistray.toolkit.arguments import Angles, Help, InsteadOfArguments, Joined, OrAlone, Parser, place


@dataclass(frozen=True)
class Option:
    """
    Option, or positional argument, of a command.

    Attributes
    ----------
    name : str
        Name or names, such as "--out" or "-o --output"; without dashes for a positional argument.
    help : str
        Description in the help.
    type : callable or tuple of str, optional
        Type of each value, or its choices; bool for a flag.
    metavar : str or tuple of str, optional
        Placeholder of the values in the help.
    nargs : int or str, optional
        Number of values, in the notation of argparse.
    default
        Value if the option is not given; of a flag it is False.
    extends : bool
        Whether values given later are added to those given before.
    writes : tuple of str, optional
        Patterns of the files written in the folder that the value names; empty if it names one file, None if no output.
    of : dataclasses.Field, optional
        Field of a request from which the option is made.
    within : dataclasses.Field, optional
        Field of the request whose object has that field.
    alone : bool
        Whether the positional arguments of the command may be left out with it.
    """

    name: str
    help: str
    type: Any = None
    metavar: str | tuple[str, ...] | None = None
    nargs: int | str | None = None
    default: Any = None
    extends: bool = False
    writes: tuple[str, ...] | None = None
    of: dataclasses.Field[Any] | None = None
    within: dataclasses.Field[Any] | None = None
    alone: bool = False

    @property
    def dest(self) -> str:
        """Name under which the parsed value is stored, without dashes."""
        return self.name.split()[-1].removeprefix("--").replace("-", "_")

    def declare(self, target: Any) -> None:
        """Add the option to an argparse parser or to a group of one."""
        how: dict[str, Any] = {"metavar": self.metavar, "nargs": self.nargs, "default": self.default}
        if self.type is bool:
            how = {"action": "store_true"}
        elif self.nargs == "*" and self.name.startswith("-"):
            how["action"] = OrAlone
        elif self.alone:
            how |= {"action": InsteadOfArguments, "type": place if self.type is Path else None}
            how |= {"choices": self.type, "const": self.type[0]} if isinstance(self.type, tuple) else {}
        elif isinstance(self.type, tuple):
            how["choices"] = self.type
        elif isinstance(self.type, Angles):
            how |= {"type": self.type, "action": Joined}
        elif self.type is not None:
            how |= {"type": place if self.type is Path else self.type, "action": "extend" if self.extends else "store"}
        # argparse takes a help for a format
        target.add_argument(*self.name.split(), help=self.help.replace("%", "%%"), **how)


@dataclass(frozen=True)
class Group:
    """Options listed under a common heading in the help."""

    title: str
    options: tuple[Option, ...]


RECORDED = "request"  # key of what a command prints and writes as JSON that holds its request
REQUEST = Group("request as JSON (docs/drive.md)", (
    Option("--request", "take arguments and options from a file, JSON or TOML; those given beside it go before",
           Path, "FILE", alone=True),
    Option("--schema", "print the JSON schema of such a file, or with result that of what --json prints, and exit",
           ("request", "result"), nargs="?", alone=True),
))  # fmt: skip


@dataclass(frozen=True)
class Command:
    """
    Command of the program: its texts and options.

    Attributes
    ----------
    name, help, description : str
        Name, line in the list of commands, and beginning of the command's own help.
    examples : tuple of str
        Command lines shown at the end of the help.
    parts : tuple of Option or Group, or callable
        Options and groups in the order of the help, or a function that makes them from the module ``request`` of the
        package; it is called only when the command is used.
    package : str
        Package of the analysis.
    """

    name: str
    help: str
    description: str
    examples: tuple[str, ...]
    parts: tuple[Option | Group, ...] | Callable[[Any], tuple[Option | Group, ...]]
    package: str = ""

    @property
    def options(self) -> Iterator[Option]:
        """All options of the command, from every group, in the order of the help."""
        for part in self._made:
            yield from part.options if isinstance(part, Group) else (part,)

    @property
    def requests(self) -> Any:
        """Module ``request`` of the analysis package, which holds its request classes."""
        return importlib.import_module(f"{self.package}.request")

    @cached_property
    def _made(self) -> tuple[Option | Group, ...]:
        return *(self.parts(self.requests) if callable(self.parts) else self.parts), REQUEST

    def declare(self, commands: Any, run: Callable[[Any], int]) -> None:
        """Add the parser of the command to those of argparse; `run` carries out the command."""
        lines = [f"example{'s' if len(self.examples) > 1 else ''}:", *self.examples]
        texts = {"help": self.help, "description": self.description, "epilog": "\n  ".join(lines)}
        parser: Parser = commands.add_parser(self.name, formatter_class=Help, **texts)
        parser.set_defaults(run=run, command=self)
        parser.declare_when_used(self._declare_arguments)

    def _declare_arguments(self, parser: Parser) -> None:
        for part in self._made:
            if isinstance(part, Group):
                group = parser.add_argument_group(part.title)
                for option in part.options:
                    option.declare(group)
            else:
                part.declare(parser)
        written = {option.dest: option.writes for option in self.options if option.writes is not None}
        parser.set_defaults(outputs=tuple(written), folder_files=sum(written.values(), ()))


@dataclass(frozen=True)
class AnalysisCommand(Command):
    """
    Command of an analysis, which runs the function of its package with a scene and a request.

    Attributes
    ----------
    request : str
        Name of the request.
    package : str
        Package whose ``run.run(scene, request, *, progress)`` returns the result; a keyword ``seconds`` limits its
        time, if there is one. In its module ``page``, ``text(result)`` is printed, ``record(result)`` is the JSON, and
        ``page(result, title, command)`` the report.
    shown : str, optional
        Name of the request that selects what is shown of the result; these functions then take it after the result.
    """

    request: str = field(kw_only=True)
    shown: str = field(default="", kw_only=True)

"""A command as data: its texts and its options, from which its parser and its completion are made."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from mistray.toolkit.arguments import Angles, Help, Joined, OrAlone, Parser, place


@dataclass(frozen=True)
class Option:
    """
    An option, or an argument that stands without a name.

    Attributes
    ----------
    name : str
        Such as "--out", or "-o --output"; without dashes for what stands without a name.
    help : str
    type : callable or tuple of str, optional
        Of each value, or its choices; bool for a flag.
    metavar : str or tuple of str, optional
        What stands for its values in the help.
    nargs : int or str, optional
        How many values there are, as argparse says it.
    default
    extends : bool
        Whether values given later are added to those given before.
    writes : tuple of str, optional
        Given if it names what the command writes: patterns of the files in a folder, empty for a file.
    """

    name: str
    help: str
    type: Any = None
    metavar: str | tuple[str, ...] | None = None
    nargs: int | str | None = None
    default: Any = None
    extends: bool = False
    writes: tuple[str, ...] | None = None

    @property
    def dest(self) -> str:
        """Its name among the options that were read."""
        return self.name.split()[-1].removeprefix("--").replace("-", "_")

    def declare(self, target: Any) -> None:
        """Add it to a parser, or to a group of one."""
        how: dict[str, Any] = {"metavar": self.metavar, "nargs": self.nargs, "default": self.default}
        if self.type is bool:
            how = {"action": "store_true"}
        elif self.nargs == "*" and self.name.startswith("-"):
            how["action"] = OrAlone
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
    """Options under a heading of the help."""

    title: str
    options: tuple[Option, ...]


@dataclass(frozen=True)
class Command:
    """
    A command.

    Attributes
    ----------
    name, help, description : str
        Its name, its line in the list of commands, and what its own help begins with.
    examples : tuple of str
        Command lines.
    parts : tuple of Option or Group, or callable
        In the order of the help. What requests say is made by a function of the module ``request`` of the package, so
        that it is imported when the command is used.
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
        """All options, whatever their group."""
        for part in self._made:
            yield from part.options if isinstance(part, Group) else (part,)

    @property
    def requests(self) -> Any:
        """The module ``request`` of the package."""
        return importlib.import_module(f"{self.package}.request")

    @cached_property
    def _made(self) -> tuple[Option | Group, ...]:
        return self.parts(self.requests) if callable(self.parts) else self.parts

    def declare(self, commands: Any, run: Callable[[Any], int]) -> None:
        """Add its parser to those of argparse; `run` is what it does."""
        lines = [f"example{'s' if len(self.examples) > 1 else ''}:", *self.examples]
        texts = {"help": self.help, "description": self.description, "epilog": "\n  ".join(lines)}
        parser: Parser = commands.add_parser(self.name, formatter_class=Help, **texts)
        parser.set_defaults(run=run)
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
    The command of an analysis, which does with a scene and a request what its package says.

    Attributes
    ----------
    request : str
        Name of the request.
    package : str
        Its ``run.run(scene, request, *, progress)`` gives the result, in the time of a keyword ``seconds`` where it has
        that; of ``page``, ``text(result)`` is printed, ``record(result)`` is the JSON, and
        ``page(result, title, command)`` the report.
    shown : str, optional
        Name of the request of what is shown of the result, which these functions take after it.
    """

    request: str = field(kw_only=True)
    shown: str = field(default="", kw_only=True)


def angles(name: str, help: str, within: Any = None) -> Option:
    """An option that takes angles in degrees and ranges of them, all in one list."""
    return Option(name, help, Angles(within) if within else Angles(), "DEG", "+")

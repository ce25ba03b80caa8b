"""Keyword form of an analysis for users: a function whose arguments are the fields of a request."""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from os import PathLike
from types import UnionType
from typing import Any, TypeVar, get_args

from mistray.errors import MistrayError
from mistray.known_arguments import known_arguments
from mistray.notes import warns
from mistray.ranges import FINITE, POSITIVE, Demand, Each, OfType, Range, Several, Words, demand_of, doc_of, type_of
from mistray.result import Result
from mistray.scene.check import require_scene
from mistray.scene.titles import scene_name
from mistray.toolkit.fields import FieldSubset, flat_fields, from_flat

Found = TypeVar("Found")
# Of arguments that are no fields: type, and what it is called in messages
_TYPES = {"Progress": (Callable, "a function"), "str | Path": (str | PathLike, "a path"), "str": (str, "text")}
Declared = tuple[dataclasses.Field[Any], FieldSubset | None]


def analysis(
    name: str, request: type, run: Callable[..., Found], positional: Sequence[str] = ()
) -> Callable[..., Found]:
    """
    Return the function of an analysis for users, with keywords instead of a request.

    It checks all keywords and issues the notes of the result as warnings. Other code calls `run`.

    Parameters
    ----------
    name : str
        Name of the function in the module of `run`, where it must be kept under this name: it is pickled by reference.
    request : type
        Class of the request. Its fields are arguments; those declared before ``KW_ONLY`` also by position.
    run : callable
        Function of the analysed object (mostly a scene), of a request, and of keywords that are not fields of the
        request. Its docstring describes them under Parameters and becomes that of the returned function, with its
        Examples.
    positional : sequence of str
        Arguments after the scene that may be given by position, in this order, if the fields and the function do not
        determine it.
    """
    declared = list(flat_fields(request))
    subject, _, *further = inspect.signature(run).parameters.values()
    loaded = subject.name == "scene" and "Path" not in str(subject.annotation)  # not by its file
    subject = inspect.Parameter("scene", subject.kind, annotation="mi.Scene") if loaded else subject
    arguments = _in_order(_arguments(subject, declared, further), (subject.name, *positional) if positional else ())
    signature = inspect.Signature(arguments, return_annotation=inspect.signature(run).return_annotation)
    known = [parameter for parameter in signature.parameters if parameter != subject.name]

    def call(*args: Any, **keywords: Any) -> Found:
        if loaded and (args or "scene" in keywords):
            require_scene(args[0] if args else keywords["scene"], name)
        try:
            given = signature.bind(*args, **keywords).arguments
        except TypeError as error:
            raise MistrayError(f"{name}: {error}; its arguments are {', '.join(known)}") from None
        own = {parameter.name: given[parameter.name] for parameter in further if parameter.name in given}
        for parameter in (subject, *further):
            _check_type(parameter, given.get(parameter.name), vars(sys.modules[run.__module__]))
        found = run(given[subject.name], request(**from_flat(request, given)), **own)
        if isinstance(found, Result):
            found.of_scene(scene_name(given[subject.name]))
        return found

    call.__name__ = call.__qualname__ = name
    call.__module__ = run.__module__
    if run.__doc__:  # python -OO has none
        call.__doc__ = _docstring(run.__doc__, declared, signature)
    call.__signature__ = signature  # type: ignore[attr-defined]  # functions have it, see inspect.signature
    found = known_arguments(warns(call))
    found.request, found.run = request, run  # type: ignore[attr-defined]  # for who asks what may be given
    return found


def _check_type(parameter: inspect.Parameter, value: Any, names: Mapping[str, Any]) -> None:
    """
    Raise `MistrayError` if the value of a parameter of `run`, such as a path, has the wrong type.

    Fields of the request are not checked here. None is allowed. `names` maps annotations to classes.
    """
    text = type_of(parameter.annotation).replace(" | None", "")
    kind, words = _TYPES.get(text) or (names.get(text), f"a {text}")
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    plain = [one for one in kinds if isinstance(one, type)]
    if value is not None and len(plain) == len(kinds) and not isinstance(value, tuple(plain)):
        raise MistrayError(f"{parameter.name} is of type {type(value).__name__}; it must be {words}")


def _arguments(
    subject: inspect.Parameter, declared: list[Declared], further: list[inspect.Parameter]
) -> list[inspect.Parameter]:
    """
    Return the parameters of the signature: analysed object, fields, further keywords, and fields of parts.

    `declared` is from `flat_fields`. Fields of parts are keywords with None for the default.
    """
    kinds = inspect.Parameter
    parameters = [subject]
    settings: list[inspect.Parameter] = []
    for field, part in declared:
        kind = kinds.KEYWORD_ONLY if field.kw_only or part else kinds.POSITIONAL_OR_KEYWORD
        default = None if part else kinds.empty if field.default is dataclasses.MISSING else field.default
        annotation = annotation_of(field, optional=part is not None)
        (settings if part else parameters).append(kinds(field.name, kind, default=default, annotation=annotation))
    return [*parameters, *further, *settings]


def _in_order(known: list[inspect.Parameter], positional: Sequence[str]) -> list[inspect.Parameter]:
    """Return the arguments with those of `positional` first and all others keyword-only; unchanged if it is empty."""
    if not positional:
        return known
    kinds, by_name = inspect.Parameter, {one.name: one for one in known}
    first = [by_name[name].replace(kind=kinds.POSITIONAL_OR_KEYWORD) for name in positional]
    return [*first, *(one.replace(kind=kinds.KEYWORD_ONLY) for one in known if one.name not in positional)]


def _docstring(doc: str, declared: list[Declared], signature: inspect.Signature) -> str:
    """
    Return the docstring `doc` of `run` with the fields of the request as parameters instead of the request.

    `declared` is from `flat_fields`; the parameters have the order of `signature`.
    """
    lines = inspect.cleandoc(doc).splitlines()
    first = lines.index("Parameters") + 2
    last = next((k - 1 for k in range(first, len(lines)) if lines[k].startswith("---")), len(lines))
    starts = [k for k in range(first, last) if lines[k] and not lines[k].startswith(" ")]
    entries = {lines[k].split(" : ")[0]: lines[k:end] for k, end in pairwise([*starts, last])}
    known = {name: "\n".join(text).rstrip() for name, text in entries.items() if name != "request"}
    known |= {field.name: entry(field) for field, _ in declared}
    texts = [known[name] for name in signature.parameters if name in known]
    rest = ["", *lines[last:]] if last < len(lines) else []
    return "\n".join([*lines[:first], *texts, *rest])


def annotation_of(field: dataclasses.Field[Any], optional: bool = False) -> str:
    """
    Return the type annotation, a string, of the argument that a field becomes.

    It may be wider than the type of the field; with `optional`, or if the field's default is None, it allows None.
    """
    demand = demand_of(field)
    kind = type_of(field.type).replace(" | None", "")
    if isinstance(demand, OfType) and demand.kind is str:
        kind = "str"
    elif isinstance(demand, Each) and not demand.count:
        kind = "float | Iterable[float]"  # an array is no sequence
    elif isinstance(demand, Several):
        kind = re.sub(r"^(?:tuple\[([\w |]+), \.\.\.\]|Sequence\[([\w |]+)\])$", r"\1\2 | Sequence[\1\2]", kind)
    return f"{kind} | None" if optional or field.default is None else kind


def range_text(demand: Demand | None) -> str:
    """
    Return the allowed range of the numbers of a demand with its unit, such as "0 … 90 degrees".

    It is empty if there is no range, no lower limit, or only the condition that numbers are positive.
    """
    numbers = getattr(demand, "of", demand)
    if not isinstance(numbers, Range) or not math.isfinite(numbers.low) or numbers in (FINITE, POSITIVE):
        return ""
    return f"{numbers} {numbers.unit}".rstrip()


def entry(field: dataclasses.Field[Any]) -> str:
    """Return a field's numpydoc entry for the section Parameters: name, type, allowed values and description."""
    kind = annotation_of(field).replace(" | None", "").replace("Any", "object")
    demand = demand_of(field)
    if isinstance(demand, Words):
        kind = "{" + ", ".join(f'"{word}"' for word in demand.choices) + "}"
    text, told = doc_of(field), range_text(demand)
    sentence = f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}{f' {told}.' if told else ''}"
    optional = "" if field.default is dataclasses.MISSING else ", optional"
    lines = textwrap.wrap(sentence, 112, initial_indent="    ", subsequent_indent="    ")
    return "\n".join([f"{field.name} : {kind}{optional}", *lines])

"""Translation of Mitsuba's loading errors to one line that names the object, the value and the remedy."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mistray._variant import PLUGIN_ROOT
from mistray.errors import MistrayError, printable
from mistray.scene.xml_file import Element, SceneFile

FILE = "filename"  # by which elements, and all of Mitsuba's plugins, name a file
VALUE_TAGS = ("float", "integer", "boolean", "string", "point", "vector", "rgb", "spectrum", "transform")
NUMBERS = {"floating point": "a number", "integer": "a whole number", "boolean": "'true' or 'false'"}

TEXT = "string"  # what Mitsuba calls a scene that comes as a text
LONGEST_REASON = 600  # characters of a message
NAMES_OFFERED = 5  # nearest to one that does not exist
WORD_SHOWN = 80  # characters of a value without spaces that a message repeats

_LONG_WORD = re.compile(rf"[^\s']{{{2 * WORD_SHOWN},}}")
_PLACE = re.compile(r"(?:While loading|while loading|At) (?P<file>[^\n]+?) \(line (?P<line>\d+), col (?P<column>\d+)\)")
_SYNTAX = re.compile(
    r"XML file \"(?P<file>[^\n]+?)\" failed: (?P<what>.+?) \(line (?P<line>\d+), col (?P<column>\d+)\)"
)
_NODE = re.compile(r"dictionary node \"(?P<path>[^\"]+)\"")
_TRACEBACK = "Traceback (most recent call last)"
_INTERRUPT = re.compile(r"^KeyboardInterrupt\b", re.MULTILINE)
_RAISED = re.compile(r"^\s*(\w+(?:Error|Warning|Exception): [^\n]*)", re.MULTILINE)  # the last line of a traceback
_PREFIX = re.compile(r"\[\w+\.(?:cpp|h):\d+\] |\[\w+\] ")
_LOADING = re.compile(r"(Error while loading|While loading|At) (XML file )?\S+( \(line \d+, col \d+\))?: ")


@dataclass
class SceneElement:
    """
    One object or value in a scene description.

    Attributes
    ----------
    tag, plugin, id : str
        Tag, type and id as in ``<shape type="asphere" id="L1_front">``; empty if missing. Elements of a dict have no
        tag.
    name : str
        Name of a value, or key in a dict.
    values : dict
        Values of the object by name, as written.
    parent : SceneElement or None
        Enclosing element; None for the outermost.
    """

    tag: str = ""
    plugin: str = ""
    id: str = ""
    name: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    parent: SceneElement | None = None

    @property
    def owner(self) -> SceneElement:
        """Object that a value belongs to, or the object itself."""
        return self.parent if self.parent is not None and self.tag in VALUE_TAGS else self

    def __str__(self) -> str:
        if self.id:
            return f"{self.tag or self.plugin or 'object'} '{self.id}'"
        what = self.plugin or (f"<{self.tag}>" if self.tag else "the scene")
        return f"{what} of {self.parent}" if self.parent is not None and self.parent.tag != "scene" else what


def explain(error: Exception, source: Path | dict[str, Any], content: str | None = None) -> str:
    """
    Return a one-line explanation of why Mitsuba could not load a scene.

    Parameters
    ----------
    error : Exception
        Exception that Mitsuba or a check raised while loading.
    source : Path or dict
        Scene that was loaded.
    content : str, optional
        Text that replaced the content of the file.

    Returns
    -------
    str
        Message of one line.
    """
    text = str(error) or type(error).__name__
    where, element = "scene", SceneElement()
    place = _SYNTAX.search(text) or next(reversed(list(_PLACE.finditer(text))), None)  # the innermost of included files
    if isinstance(source, dict):
        node = _NODE.search(text)
        element = _in_dict(source, node["path"].split(".")) if node else element
    else:
        where = f"scene '{source}'"
        if place is not None:
            line, column = int(place["line"]), int(place["column"])
            of_text = content is not None and place["file"] == TEXT  # its lines are not those of the file
            data = content.encode() if content is not None and of_text else None
            where = where if of_text else f"scene '{place['file']}', line {line}"
            element = _in_file(Path(place["file"]), line, column, data) or element
    reason = _LONG_WORD.sub(lambda word: f"{word[0][:WORD_SHOWN]}…", " ".join(_reason(text, element, source).split()))
    return f"{where}: {_short(printable(reason), LONGEST_REASON)}"


def is_interrupt(error: Exception) -> bool:
    """
    True if Ctrl-C was pressed while a plugin was built.

    Mitsuba then raises an error of its own, whose text is the traceback.
    """
    text = str(error)
    return _TRACEBACK in text and _INTERRUPT.search(text) is not None


def _reason(text: str, element: SceneElement, source: Path | dict[str, Any]) -> str:
    """
    Return what is wrong with an element and how to correct it, from the text of an error.

    `source` is that of `explain`.
    """
    own = text.rpartition("MistrayError: ")[2].strip() if "MistrayError: " in text else ""
    unknown = dict(re.findall(r"- \w+ \"([^\"]+)\": (.*)", text)) if "unreferenced" in text else {}
    known = parameters(element.plugin)
    if not unknown and known:
        forms = {_numbered(name) for name in known}
        strange = {key: value for key, value in element.values.items() if _numbered(key) not in forms}
        unknown = {key: value for key, value in strange.items() if difflib.get_close_matches(key, known)}
    if unknown:
        key, value = next(iter(unknown.items()))
        written = str(value).strip('"')
        # Of a matrix the text has the first line
        of_value = "" if written.startswith("[[") else f" = {_short(written, WORD_SHOWN)}"
        return f"unknown parameter '{key}'{of_value} of {element}; {_choose(key, known, 'remove it')}"
    if own:
        kind = re.match(r"(\w+)( '(bsdf|coating)?')?: ", own)  # a nested bsdf has no name of its own
        if kind and (kind[1] in ("interface", "thinfilm") or _is_model(kind[1], element.plugin)):
            return f"{element}: {own.partition(': ')[2]}"
        name = element.id or element.plugin
        named = bool(name) and f"'{name}'" in own
        return own if named else f"{element}: {own}"
    for pattern, remedy in _REASONS:
        match = re.search(pattern, text)
        if match:
            return remedy(match, element)
    plain = _RAISED.findall(text)[-1] if _TRACEBACK in text and _RAISED.search(text) else text
    for noise in (_PREFIX, _LOADING):
        plain = noise.sub("", plain)
    plain, file = plain.strip(), str(element.values.get(FILE, ""))
    if file and file not in plain:
        return f"{element}: file '{file}': {plain}; give another one"
    subject = f"{element}: " if element.tag or element.plugin else ""
    return f"{subject}{plain}; correct {'the dict' if isinstance(source, dict) else 'the file'}"


def _is_model(name: str, plugin: str) -> bool:
    """True if a class name of a scatter model belongs to a plugin name, as HarveyShack to harvey_shack."""
    return plugin.replace("_", "").startswith(name.lower().replace("_", ""))


def _number(match: re.Match[str], element: SceneElement) -> str:
    subject = f"{element.owner}: {element.name}" if element.name else "a value"
    return f"{subject} is '{match[2]}'; it must be {NUMBERS.get(match[1], 'a ' + match[1])}"


def _plugin(match: re.Match[str], element: SceneElement) -> str:
    # Base classes have no table of parameters; in a file the tag says the kind
    known = [
        name
        for name, module in _plugins().items()
        if parameters(name) and (not element.tag or f".{element.tag}s." in module.__name__)
    ]
    return f"{element}: there is no plugin '{match[1]}'; {_choose(match[1], known, 'correct the type')}"


_REASONS: list[tuple[str | re.Pattern[str], Callable[[re.Match[str], SceneElement], str]]] = [
    (
        _SYNTAX,
        lambda m, _: f"broken XML, {m['what'].lower()} in column {m['column']}; close or correct the tag there",
    ),
    (r"could not parse ([\w ]+?)(?: value)? \"(.*?)\"", _number),
    (r"Plugin \"(\w+)\" not found", _plugin),
    (
        r"unsupported XML element: <(\w+)>",
        lambda m, _: f"<{m[1]}> is not an element of a scene; use shape, bsdf, emitter, sensor or integrator",
    ),
    (
        r"duplicate ID: \"(.+?)\" \(previous was .*line (\d+)",
        lambda m, _: f"the id '{m[1]}' is taken by line {m[2]}; give each object its own",
    ),
    (
        r"undefined parameter: \$(\w*)",
        lambda m, e: (
            f"{e.owner}: '${m[1]}' is not defined; add a <default name=\"{m[1]}\"> or write the value"
            if m[1]
            else f"{e.owner}: a value holds $, by which scene files know parameters, and no name after it; take it out"
        ),
    ),
    (
        r"The property \"(\w+)\" has the wrong type \(expected (\w+), got (\w+)\)",
        lambda m, e: f"{e}: {m[1]} is given as {m[3]}; it must be of the type {m[2]}",
    ),
    (
        r"Property \"(\w+)\": (.+?)!?$",
        lambda m, e: f"{e}: {m[1]}: {m[2]}; correct it",
    ),
    (
        r"unresolved reference to \"(.+?)\"",
        lambda m, e: f"{e} refers to '{m[1]}', which does not exist; correct the id of the reference",
    ),
    (
        r"file \"(.+?)\"(?: not found|: file not found)",
        lambda m, e: f"{e}: no file '{m[1]}'; check the path, relative to the scene file",
    ),
    (
        r"missing version attribute",
        lambda *_: 'the element <scene> has no version; write <scene version="3.0.0">',
    ),
    (r"\[([\w.]+)\] missing 'type' attribute", lambda m, _: f"'{m[1]}' has no type; add \"type\": … to it"),
    (
        r"\[([\w.]+)\.(\w+)\] could not assign an object of type '(\w+)'",
        lambda m, _: f"'{m[1]}': {m[2]} is a {m[3]}; give a number or a string",
    ),
]


def parameters(plugin: str) -> list[str]:
    """Return the parameter names of one of mistray's plugins; empty for other plugins."""
    module = _plugins().get(plugin)
    owners = (
        [one for one in vars(module).values() if getattr(one, "__module__", "") == module.__name__] if module else []
    )
    known = [vars(owner).get("properties", {}) for owner in owners if isinstance(owner, type)]
    return [name for properties in known for name in properties if not name.startswith("(")]


def _numbered(name: str) -> str:
    """Return a parameter name with # for each number or index letter, such as ``xy_#_#``, to compare names."""
    return re.sub(r"\d+", "#", re.sub(r"_[ijkmn](?=_|$)", "_#", name))


def _plugins() -> dict[str, Any]:
    """Return the modules of mistray's plugins that are registered with Mitsuba, by plugin name."""
    return {
        name.rpartition(".")[2]: module
        for name, module in sys.modules.items()
        if name.startswith(f"{PLUGIN_ROOT}.") and name.count(".") == PLUGIN_ROOT.count(".") + 2
    }


def _choose(word: str, known: list[str], otherwise: str) -> str:
    same = [name for name in known if name.casefold() == word.casefold()]
    if close := same or difflib.get_close_matches(word, known, n=1):
        return f"did you mean '{close[0]}'?"
    nearest = difflib.get_close_matches(word, known, n=NAMES_OFFERED, cutoff=0.0)
    return f"{otherwise}, or use one such as {', '.join(nearest)}" if known else otherwise


def _short(text: str, most: int) -> str:
    """Return a string cut to about `most` characters, keeping its beginning and its end."""
    return text if len(text) <= most else f"{text[: most * 2 // 3]} … {text[-most // 3 :]}"


def _in_file(path: Path, line: int, column: int, data: bytes | None) -> SceneElement | None:
    """
    Return the element at a line and column of an XML file, None if there is none or the file cannot be read.

    `data` replaces the content of the file. Mitsuba counts columns from the name of the tag.
    """
    try:
        file = SceneFile(path, data)
    except MistrayError:  # the message then does without the object's name
        return None
    for found in file.root.walk():
        begin = file.data.rfind(b"\n", 0, found.start) + 1
        if (file.data.count(b"\n", 0, begin) + 1, found.start - begin + 2) == (line, column):
            return _of_file(found)
    return None


def _of_file(found: Element) -> SceneElement:
    """Return an element of a scene file as a `SceneElement`, with its values and parents."""
    get = found.values.get
    parent = _of_file(found.parent) if found.parent is not None else None
    element = SceneElement(found.tag, get("type", ""), get("id", ""), get("name", ""), {}, parent)
    for child in found.children:
        if child.tag in VALUE_TAGS and "name" in child.values:
            element.values.setdefault(child.values["name"], child.values.get("value", ""))
    return element


def _in_dict(scene: dict[str, Any], path: list[str]) -> SceneElement:
    """Return the element of a scene dict that a path of keys leads to; the scene itself for ``root``."""
    element, here = SceneElement(tag="scene", plugin="scene"), scene
    for key in path if path != ["root"] else []:
        here = here.get(key, {})
        values = {name: value for name, value in here.items() if name not in ("type", "id")}
        plain = {name: value for name, value in values.items() if isinstance(value, int | float | str)}
        id_ = key if element.tag == "scene" else ""
        element = SceneElement("", str(here.get("type", "")), id_, key, plain, element)
    return element

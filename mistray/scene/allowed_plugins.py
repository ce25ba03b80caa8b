"""
Checks that a scene names only safe plugins: listed ones of Mitsuba, mistray's, and ones registered in Python.

Mitsuba takes an unknown type as the name of a library, ``plugins/TYPE.so``, and runs the code in it. It looks in the
current folder, beside the scene, or wherever a path in the type leads. So mistray checks the types first, and puts
Mitsuba's own folder first in the search path.
"""

from __future__ import annotations

import os.path
import re
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.materials.mate import shown
from mistray.read_file import require_file
from mistray.scene.check import property_of
from mistray.scene.messages import FILE
from mistray.scene.xml_file import DEEPEST

# The plugins that come with Mitsuba, without `blender`, which reads memory at addresses that the scene gives
STOCK: Mapping[str, frozenset[str]] = {
    kind: frozenset(names.split())
    for kind, names in {
        "bsdf": "blendbsdf bumpmap circular conductor dielectric diffuse hair mask measured measured_polarized "
        "normalmap null plastic polarizer pplastic principled principledthin retarder roughconductor roughdielectric "
        "roughplastic thindielectric twosided",
        "emitter": "area constant directional directionalarea envmap point projector spot sunsky timed_sunsky",
        "film": "hdrfilm specfilm",
        "integrator": "aov depth direct moment path ptracer stokes volpath volpathmis",
        "medium": "heterogeneous homogeneous",
        "phase": "blendphase hg isotropic rayleigh sggx tabphase",
        "rfilter": "box catmullrom gaussian lanczos mitchell tent",
        "sampler": "independent ldsampler multijitter orthogonal stratified",
        "scene": "scene",
        "sensor": "batch distant irradiancemeter orthographic perspective radiancemeter thinlens",
        "shape": "bsplinecurve cube cylinder disk ellipsoids ellipsoidsmesh instance linearcurve merge obj ply "
        "rectangle sdfgrid serialized shapegroup sphere",
        "texture": "bitmap blackbody checkerboard d65 irregular mesh_attribute rawconstant regular srgb uniform volume",
        "volume": "constvolume gridvolume",
    }.items()
}
KINDS = {"PhaseFunction": "phase", "ReconstructionFilter": "rfilter"}  # where Mitsuba's word is not the element's
VALUES = ("ref", "rgb", "spectrum")  # what a dict gives a type although it is no plugin
RESOURCES = "resources"  # the type of an entry of a dict that says where to look for files
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")  # of a library
BLENDER = "blender"

_NAME = re.compile(r"[A-Za-z0-9_-]+")


def check_file(state: Any) -> None:
    """
    Check the plugins of a scene file that Mitsuba has read and not yet built.

    Parameters
    ----------
    state : mi.parser.ParserState
        Parsed scene, with includes and parameters ``$name`` resolved.

    Raises
    ------
    MistrayError
        If a type is not allowed, or a file name is blank or that of a folder, a pipe or a device. The message names the
        place as Mitsuba's own errors do.
    """
    for node in state.nodes:
        name, kind = node.props.plugin_name(), KINDS.get(node.type.name, node.type.name.lower())
        reason = _special(property_of(node, FILE)) if FILE in node.props else ""
        if not reason and name not in STOCK.get(kind, ()):
            reason = _refusal(name)
        if reason:
            raise MistrayError(f"While loading {mi.parser.file_location(state, node)}: MistrayError: {reason}")


def check_dict(given: Mapping[str, Any]) -> None:
    """
    Check the plugins of a scene dict.

    Raises
    ------
    MistrayError
        For the reasons of `check_file`, if a value would crash Mitsuba (None, half of a character), or if the dict is
        nested deeper than `mistray.scene.xml_file.DEEPEST`. The message names the place as Mitsuba's own errors do.
    """
    for path, name, file in _types(given):
        reason = _special(file)
        if not reason and name not in VALUES and not any(name in names for names in STOCK.values()):
            reason = _refusal(name)
        if reason:
            raise MistrayError(f'While loading dictionary node "{path}": MistrayError: {reason}')


def _types(given: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """
    Yield every nested dict that has a type: its path of keys, its type, and its value ``filename``, None without one.

    An entry that would crash Mitsuba, or dicts nested too deeply, raise `MistrayError`.
    """
    waiting: list[tuple[tuple[str, ...], Mapping[str, Any]]] = [((), given)]
    while waiting:
        path, item = waiting.pop()
        if len(path) > DEEPEST:
            raise MistrayError(f"scene: '{path[0]}' holds dicts {DEEPEST} deep within each other; correct the dict")
        name = item.get("type")
        where = ".".join(path) or "root"
        for key, value in item.items():
            reason = _crashes(str(key), value)
            if reason:
                raise MistrayError(f'While loading dictionary node "{where}": MistrayError: {reason}')
        if isinstance(name, str):
            yield where, name, item.get(FILE)
        waiting += [((*path, str(key)), value) for key, value in item.items() if isinstance(value, dict)]


def _crashes(key: str, value: Any) -> str:
    """Return why a dict entry would crash Mitsuba's reader, or hide its name in errors; "" if it is harmless."""
    if value is None:
        return f"{key} is None; give a value, or leave it out"
    for text in (key, value):
        if isinstance(text, str) and any("\ud800" <= letter <= "\udfff" for letter in text):
            return f"{text!a} holds half of a character; take it out"
    return ""


def _special(name: Any) -> str:
    """
    Return the reason why the file that a Mitsuba plugin names must not be opened; "" if it may.

    It is a folder, a pipe or a device, or its name is blank. A missing file is left to Mitsuba.
    """
    if isinstance(name, str) and not name.strip():  # Mitsuba finds its own folder by it
        return f"{FILE} is {name!r}; name a file"
    file = str(mi.file_resolver().resolve(name)) if isinstance(name, str) else ""
    if not os.path.exists(file):
        return ""
    try:
        require_file(file, FILE)
    except MistrayError as error:
        return str(error)
    return ""


def _refusal(name: str) -> str:
    """
    Return why a plugin type that is not listed for its kind is refused; "" if it is not.

    A type that is registered in Python, or that Mitsuba does not know either, is not refused.
    """
    remedy = "use a plugin of Mitsuba or of mistray, or one that you registered in Python"
    for kind, names in STOCK.items():
        if name in names:
            return f"the type '{name}' is a {kind}; write it as one, or use a plugin of the right kind"
    if name == BLENDER:
        return f"the type '{name}' reads memory at any address; export a .ply file instead"
    if not _NAME.fullmatch(name):
        return f"the type '{shown(name.split())}' is not the name of a plugin; {remedy}"
    library = str(mi.file_resolver().resolve(f"plugins/{name}{SUFFIX}"))
    if os.path.exists(library):
        return f"the type '{name}' would run the library '{library}'; {remedy}"
    return ""

"""Conversion of a prescription to a Mitsuba scene: a dictionary or a readable XML file, from one tree of nodes."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from mistray._variant import ensure_variant
from mistray.errors import MistrayError
from mistray.ids import free_name, plain_name
from mistray.materials import resolved
from mistray.physics.geometry.outline import Outline
from mistray.physics.sags.terms import GRID
from mistray.prescription.coating import Coating
from mistray.prescription.grid_file import grid_bytes
from mistray.prescription.mesh_structure import MeshStructure
from mistray.prescription.model import Detector, Placed, Structure, Surface
from mistray.prescription.naming import each_shape, shared_coatings, shared_scatter
from mistray.prescription.scatter import Scatter, Value
from mistray.prescription.sources import ObjectPoint, Source
from mistray.prescription.spectral import list_text
from mistray.replace_file import replace_files

if TYPE_CHECKING:
    from mistray.prescription.model import Prescription

Shape = Surface | Structure | MeshStructure

# Values of a coating and of a beam that a scene states where they are not the defaults
_RECIPE = ("R", "T", "table", "layers", "preset", "first", "design_nm", "n_shift", "k_shift")
_BEAM = (
    *("radius", "inner_radius", "half_width", "half_height", "field_deg", "azimuth_deg", "distance", "pupil_area"),
    *("plane", "pattern"),
)


@dataclass(frozen=True)
class _Node:
    """
    Node of a scene tree: a plugin or a reference to one.

    Attributes
    ----------
    kind, plugin : str
        XML tag, and type of the plugin, "" for a reference.
    id : str or None
        Id of the plugin, or of the one referred to; None without one.
    properties : dict of str to Value
        Parameters by name.
    place : Placed or None
        Object whose frame gives ``to_world``; None without one.
    children : tuple of _Node
        Nested nodes.
    """

    kind: str
    plugin: str
    id: str | None = None
    properties: dict[str, Value] = field(default_factory=dict)
    place: Placed | None = None
    children: tuple[_Node, ...] = ()


def _interface(shape: Shape) -> _Node:
    in_air = shape.front == shape.back == "air"
    properties: dict[str, Value] = {} if in_air else {"front": shape.front, "back": shape.back}
    finish, children = _finish(shape.coating, shape.scatter)
    properties |= finish | _stated(shape, "mirror", "design_path")
    return _Node("bsdf", "interface", properties=properties, children=children)


def _finish(coating: Coating | None, scatter: Iterable[Scatter]) -> tuple[dict[str, Value], tuple[_Node, ...]]:
    """Return the properties, by name, and nested nodes of an interface that state its coating and scatter models."""
    properties: dict[str, Value] = {}
    children: tuple[_Node, ...] = ()
    if coating is not None and coating.name is not None:
        children = (_Node("ref", "", coating.name),)
    elif coating is not None and coating.layered:
        children = (_thinfilm(coating),)
    elif coating is not None:
        properties = _stated(coating, *_RECIPE)
    children += tuple(_Node("ref", "", model.name) if model.name else _scatter(model) for model in scatter)
    return properties, children


def _thinfilm(coating: Coating) -> _Node:
    opaque: dict[str, Value] = {"opaque": True} if coating.mirror else {}
    return _Node("bsdf", "thinfilm", coating.name, _stated(coating, *_RECIPE) | opaque)


def _scatter(model: Scatter) -> _Node:
    return _Node("bsdf", model.kind, model.name, dict(model.properties))


def _stated(part: Any, *names: str) -> dict[str, Value]:
    """Return those attributes of a part, by name, whose values differ from the defaults."""
    defaults = {known.name: known.default for known in fields(part)}
    found = {name: getattr(part, name) for name in names if name in defaults}
    return {
        name: list_text(value) if isinstance(value, tuple) else value
        for name, value in found.items()
        if value != defaults[name] and (not isinstance(value, tuple) or any(value))
    }


def _surface(s: Surface, mechanics: bool = False) -> _Node:
    properties: dict[str, Value] = {"radius": s.radius} if s.curvature else {}
    properties |= _stated(s, "conic") | {f"a{2 * i}": a for i, a in enumerate(s.coefficients, start=2) if a}
    properties |= _stated(s, "semi_diameter", "inner_semi_diameter", "half_width", "half_height")
    if s.freeform:
        properties |= {key: _sag_value(s, key, value) for key, value in s.sag.items()} | _outline(s.outline)
        properties |= {"mechanics": True} if mechanics else {}
        properties |= _stated(s, "meets")
    children: tuple[_Node, ...] = (_interface(s),)
    if isinstance(s, Detector):
        film: dict[str, Value] = {"width": s.pixels[0], "height": s.pixels[1], "component_format": "float32"}
        box = _Node("rfilter", "box")
        children += (
            _Node("sensor", "irradiancemeter", children=(_Node("film", "hdrfilm", None, film, None, (box,)),)),
        )
    return _Node(
        "shape", "freeform" if s.freeform else "asphere", s.name, properties | _stated(s, "part", "space"), s, children
    )


def _sag_value(s: Surface, key: str, value: Any) -> Value:
    if key != GRID:
        return float(value)
    if not value.path:
        raise MistrayError(f"surface '{s.name}': its grid lies in no file; save it first (save_grid)")
    return str(value.path)


def _outline(outline: Outline | None) -> dict[str, Value]:
    """Return the plugin properties for the figures of an outline (mm and degrees), without zeros that are defaults."""
    found: dict[str, Value] = {}
    for k, figure in enumerate(outline.figures if outline else (), start=1):
        found[f"clip_{k}"] = figure.sign + figure.kind
        for name, value in zip(figure.names, figure.values, strict=True):
            if value or name not in ("x", "y", "angle_deg"):
                found[f"clip_{k}_{name}"] = float(value)
    return found


def _shape(s: Shape) -> _Node:
    if isinstance(s, MeshStructure):
        properties: dict[str, Value] = {"filename": s.file}
        return _Node("shape", "part_mesh", s.name, properties | _stated(s, "part", "space"), None, (_interface(s),))
    return _surface(s, mechanics=True) if isinstance(s, Surface) else _structure(s)


def _structure(s: Structure) -> _Node:
    properties: dict[str, Value] = {"r0": s.r0, "z0": s.z0, "r1": s.r1, "z1": s.z1}
    return _Node("shape", "frustum", s.name, properties | _stated(s, "part", "space"), s, (_interface(s),))


def _source(s: Source | ObjectPoint) -> _Node:
    properties: dict[str, Value] = {}
    if isinstance(s, ObjectPoint):
        properties = {"z": -s.distance, "intensity": s.intensity, "half_angle_deg": s.half_angle_deg}
        properties |= _stated(s, "field_deg", "azimuth_deg")
    else:
        properties = _stated(s, *_BEAM) | {"irradiance": s.irradiance}
    kind = "point_source" if isinstance(s, ObjectPoint) else "collimated"
    return _Node("emitter", kind, "source", properties | s.spectral_properties | s.polarization_properties, s)


def _sections(prescription: Prescription) -> Iterator[tuple[str, list[_Node]]]:
    """
    Yield each section of the scene file, its comment and its nodes, in the order of the file.

    Raise `MistrayError` if the prescription lacks its detector or source, or a shape, coating or scatter model has the
    name of an entry of every scene: "integrator", "source" or "type".
    """
    for key, remedy in (("detector", "Detector(half_width=…, half_height=…)"), ("source", "Source(radius=…)")):
        if getattr(prescription, key) is None:
            raise MistrayError(f"prescription '{prescription.name}': it has no {key}; add {key}={remedy}")
    assert prescription.source is not None
    own = [_Node("integrator", "straylight", "integrator"), _source(prescription.source)]
    shared = prescription.shared_coatings().keys() | prescription.shared_scatter().keys()
    names = map(str, (*shared, *(shape.name for shape in prescription.shapes())))
    if taken := sorted({"type", *(str(node.id) for node in own)}.intersection(names)):
        raise MistrayError(f"prescription '{prescription.name}': '{taken[0]}' is a name of the scene's own; rename it")
    yield "", own[:1]
    yield "Light", own[1:]
    yield "Coatings of several surfaces", [_thinfilm(coating) for coating in prescription.shared_coatings().values()]
    yield "Scatter of several surfaces", [_scatter(model) for model in prescription.shared_scatter().values()]
    yield "Optical surfaces", [_surface(s) for s in prescription.surfaces]
    yield "Structure", [_shape(s) for s in prescription.structures]
    yield "Aperture stop", [_structure(s) for s in (prescription.stop.faces() if prescription.stop else ())]
    yield "Detector" if len(prescription.detectors) == 1 else "Detectors", [_surface(s) for s in prescription.detectors]


def scene_dict(prescription: Prescription) -> dict[str, Any]:
    """
    Return a scene dictionary for `mi.load_dict` with the objects of the file from `write_xml`, in its order.

    Raises
    ------
    MistrayError
        If the prescription has no detector or no source, the grid of a sag lies in no file, or a name is that of an
        entry of every scene.
    """
    ensure_variant()
    scene: dict[str, Any] = {"type": "scene"}
    for _, nodes in _sections(prescription):
        scene |= {str(node.id): _node_dict(node) for node in nodes}
    return scene


def _node_dict(node: _Node) -> dict[str, Any]:
    if node.kind == "ref":
        return {"type": "ref", "id": node.id}
    result: dict[str, Any] = {"type": node.plugin, **node.properties}
    if node.place is not None and not _at_origin(node.place):
        import mitsuba as mi

        result["to_world"] = mi.ScalarTransform4d(node.place.to_world())
    kinds = [child.kind for child in node.children]
    for place, child in enumerate(node.children):
        before = kinds[:place].count(child.kind)
        result[f"{child.kind}_{before + 1}" if before else child.kind] = _node_dict(child)
    return result


def write_xml(prescription: Prescription, path: str | Path) -> None:
    """
    Write the scene as Mitsuba 3 XML to `path`, and sag grids that have no file beside it; on an error old files stay.

    Raises
    ------
    MistrayError
        If the prescription has no detector or no source, a name is that of an entry of every scene, or the file cannot
        be written.
    """
    whole, grids = _with_grid_files(prescription, Path(path))
    replace_files({**grids, path: xml_text(whole)}, "scene file")


def xml_text(prescription: Prescription) -> str:
    """Return the text of the scene's XML file, ending in a newline; raise `MistrayError` as `scene_dict` does."""
    lines = ["<?xml version='1.0' encoding='utf-8'?>", f"<!-- {comment_text(prescription.name)}"]
    lines += [f"     {comment_text(line)}".rstrip() for line in prescription.provenance.strip().splitlines()]
    lines += [
        "     Units: mm, nm, W. Light travels +z; front is the -z side of a surface. -->",
        '<scene version="3.0.0">',
    ]
    for title, nodes in _sections(prescription):
        if nodes and title:
            lines += ["", f"    <!-- {title} -->"]
        for node in nodes:
            lines += _node_lines(node, 1)
    return "\n".join([*lines, "</scene>", ""])


def structure_text(structures: Iterable[Structure | Surface | MeshStructure], known: Container[str] = ()) -> str:
    """
    Return the XML of structures to insert into a scene, after the coatings and scatter models that they share.

    Parameters
    ----------
    structures : iterable of Structure, Surface or MeshStructure
        Structures to write.
    known : container of str
        Ids that the scene already has; shared objects with these names are only referred to.

    Raises
    ------
    MistrayError
        If two coatings or two models of the same name differ, or one name belongs to objects of two kinds.
    """
    structures = list(structures)
    nodes = {name: _thinfilm(coating) for name, coating in shared_coatings("structures", structures).items()}
    nodes |= {name: _scatter(model) for name, model in shared_scatter("structures", structures).items()}
    shared = [node for name, node in nodes.items() if name not in known]
    return "\n".join(line for node in [*shared, *map(_shape, structures)] for line in _node_lines(node, 1))


def finish_lines(coating: Coating | None, scatter: Iterable[Scatter]) -> list[str]:
    """Return the XML lines for coating and scatter models in an interface, not indented; named ones are references."""
    properties, children = _finish(coating, scatter)
    lines = [_property_line(key, value, 0) for key, value in properties.items()]
    return lines + [line for child in children for line in _node_lines(child, 0)]


def shared_lines(item: Coating | Scatter) -> list[str]:
    """Return the XML lines that define a named coating or scatter model, which a scene needs once."""
    return _node_lines(_thinfilm(item) if isinstance(item, Coating) else _scatter(item), 0)


def _node_lines(node: _Node, depth: int) -> list[str]:
    pad = "    " * depth
    if node.kind == "ref":
        return [f"{pad}<ref id={quoteattr(str(node.id))}/>"]
    head = f'{pad}<{node.kind} type="{node.plugin}"' + (f" id={quoteattr(node.id)}" if node.id else "")
    body = [_property_line(key, value, depth + 1) for key, value in node.properties.items()]
    if node.place is not None and not _at_origin(node.place):
        body += _place_lines(node.place, depth + 1)
    for child in node.children:
        body += _node_lines(child, depth + 1)
    return [head + "/>"] if not body else [head + ">", *body, f"{pad}</{node.kind}>"]


def _property_line(key: str, value: Value, depth: int) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        tag, text = "boolean", "true" if value else "false"
    elif isinstance(value, int):
        tag, text = "integer", str(value)
    elif isinstance(value, float):
        tag, text = "float", _number(value)
    else:
        tag, text = "string", value
    return f'{"    " * depth}<{tag} name="{key}" value={quoteattr(text)}/>'


def _place_lines(place: Placed, depth: int) -> list[str]:
    pad = "    " * depth
    lines = [
        f'{pad}    <rotate {axis}="1" angle="{_number(angle)}"/>'
        for axis, angle in zip("xyz", place.tilt_deg, strict=True)
        if angle
    ]
    moves = " ".join(
        f'{axis}="{_number(value)}"' for axis, value in zip("xyz", (place.x, place.y, place.z), strict=True) if value
    )
    if moves:
        lines.append(f"{pad}    <translate {moves}/>")
    return [f'{pad}<transform name="to_world">', *lines, f"{pad}</transform>"]


def _at_origin(place: Placed) -> bool:
    return place.x == place.y == place.z == 0 and not any(place.tilt_deg)


def _number(value: float) -> str:
    """Return the shortest string that reads back as the same double; raise `MistrayError` if it is not finite."""
    if not math.isfinite(value):
        raise MistrayError(f"scene file: {value} cannot be written as a number; use a finite value")
    return repr(float(value)).removesuffix(".0")


def comment_text(text: str) -> str:
    """Return a string escaped so that it is valid within an XML comment."""
    return re.sub("-(?=-)", "- ", escape(text))


def seen_from(folder: str | Path) -> Callable[[str], str]:
    """Return a function that makes paths relative to the current folder relative to `folder`; absolute ones stay."""
    return lambda path: path if os.path.isabs(path) else Path(os.path.relpath(path, folder)).as_posix()


def beside(prescription: Prescription, folder: str | Path) -> Prescription:
    """
    Return the system with the paths of its coating, glass, scatter and grid files made relative to a scene's folder.

    Parameters
    ----------
    prescription : Prescription
        System whose relative paths start from the current folder.
    folder : str or Path
        Folder of the scene file.
    """
    seen = seen_from(folder)

    def moved(shape: Any) -> Any:
        changes: dict[str, Any] = {}
        for side in ("front", "back"):
            changes[side] = resolved(getattr(shape, side), seen)
        if shape.coating is not None:
            changes["coating"] = shape.coating.moved(seen)
        changes["scatter"] = tuple(model.moved(seen) for model in shape.scatter)
        grid = getattr(shape, "sag", {}).get(GRID)
        if grid is not None and grid.path:
            changes["sag"] = {**shape.sag, GRID: replace(grid, path=seen(grid.path))}
        return replace(shape, **changes)

    return each_shape(prescription, moved)


def _with_grid_files(prescription: Prescription, path: Path) -> tuple[Prescription, dict[Path, bytes]]:
    """Return a copy in which every sag grid has a file beside the scene, and the contents of new files by path."""
    files: dict[Path, bytes] = {}

    def stored(shape: Any) -> Any:
        grid = getattr(shape, "sag", {}).get(GRID)
        if grid is None or grid.path:
            return shape
        # By $ a scene file knows its parameters, also in the name of a file
        base = f"{path.stem.replace('$', '_')}_{plain_name(shape.name)}"
        file = path.with_name(free_name(base, "_grid.npz", {file.name for file in files}))
        files[file] = grid_bytes(grid)
        return replace(shape, sag={**shape.sag, GRID: replace(grid, path=file.name)})

    return each_shape(prescription, stored), files

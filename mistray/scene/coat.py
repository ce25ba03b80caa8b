"""Putting coatings, paint and scatter models on the surfaces of a scene or prescription, by patterns of names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, overload

from mistray.coatings import PRESETS, read_coating
from mistray.errors import MistrayError
from mistray.named_values import number_of
from mistray.prescription import Prescription
from mistray.prescription.coating import Coating
from mistray.prescription.geometry import is_gas
from mistray.prescription.naming import each_shape
from mistray.prescription.scatter import Scatter
from mistray.prescription.scene_file import finish_lines, seen_from, shared_lines
from mistray.replace_file import replace_file
from mistray.scene.add_structures import shared_objects
from mistray.scene.depth import check_source
from mistray.scene.files import with_includes
from mistray.scene.load import Parts, find, load_text
from mistray.scene.read_optics import light_nm
from mistray.scene.recoat import COATED, Refit, refitted
from mistray.scene.surface_rules import (
    Change,
    CoatingRules,
    Face,
    Left,
    Painter,
    PaintRules,
    Rules,
    ScatterRules,
)
from mistray.scene.xml_file import SceneFile, is_true

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class Coated:
    """
    Record of the coatings, paint and scatter models that were put on a system.

    Attributes
    ----------
    changes : dict of str to Change
        Changes, keyed by the name of the surface.
    left : tuple of Left
        Surfaces that a rule leaves as they are although they match its pattern.
    notes : tuple of str
        Notes on the reflectance of coating presets on the substrates that they are put on.

    Examples
    --------
    >>> rules = mistray.scene.Rules(coatings={"L1": "bbar3"})
    >>> coated = mistray.scene.write_coated("cooke_triplet", "coated.xml", rules)
    >>> list(coated.changes)
    ['L1_front', 'L1_rear']
    >>> [left for left in coated.left]
    [Left(surface='L1_edge', pattern='L1', why='is opaque'), Left(surface='L1_flange_2', pattern='L1', why='is opaque')]
    """

    changes: Mapping[str, Change]
    left: tuple[Left, ...]
    notes: tuple[str, ...] = ()


@overload
def coat(
    system: Prescription,
    coatings: CoatingRules | None = None,
    *,
    paint: PaintRules | None = None,
    scatter: ScatterRules | None = None,
) -> Prescription: ...


@overload
def coat(
    system: str | Path | ModuleType,
    coatings: CoatingRules | None = None,
    *,
    paint: PaintRules | None = None,
    scatter: ScatterRules | None = None,
    sources: Parts = None,
    sensors: Parts = None,
) -> mi.Scene: ...


def coat(
    system: str | Path | ModuleType | Prescription,
    coatings: CoatingRules | None = None,
    *,
    paint: PaintRules | None = None,
    scatter: ScatterRules | None = None,
    sources: Parts = None,
    sensors: Parts = None,
) -> Any:
    """
    Return a system with coatings, paint and scatter models put on surfaces by name.

    A pattern is the name of a surface, or of a part with all its surfaces, or has ``*``, ``?`` and ``[…]``. Later
    patterns override earlier ones, paint overrides coatings, and scatter models come last. A coating given for a
    pattern or a part goes on its clear surfaces and, if the coating is opaque, on its mirrors. Black edges and cemented
    faces then stay as they are. The name of a single surface selects exactly that surface.

    Parameters
    ----------
    system : str, Path, module or Prescription
        A scene XML file, a shipped scene as in `mistray.load`, or a prescription.
    coatings : mapping of str to str or Coating
        Pattern → coating: a preset such as ``"bbar3"``, layers such as ``"MgF2 99.64, 2.1 0.5w"``, a table.csv,
        ``"COATING.DAT:NAME"``, ``"R=0.01 T=0.99"``, ``"bare"``, or the name of a coating of the system; see
        docs/coatings.md.
    paint : mapping of str to str, float or Finish
        Pattern → paint as in `mistray.mechanics.finish`, or the reflectance of a Lambertian paint, 0 … 1. It replaces
        the coating and the scatter models of the surface.
    scatter : mapping of str to str, Scatter or sequence of them
        Pattern → plugin with its properties, such as ``"harvey_shack rms_nm=4"``, the name of a model of the system,
        or ``"none"``, which takes all models off. A model replaces those of its kind and adds to the others.
    sources, sensors
        Other sources and further sensors of a scene, see `mistray.load`; not for a prescription.

    Returns
    -------
    mi.Scene or Prescription
        A prescription if `system` is one, else a scene. A scene file stays as it is; `mistray.scene.write_coated`
        writes one.

    Raises
    ------
    MistrayError
        If a pattern matches no surface, or none that can take the coating, paint or model; if one of these is unknown
        or not valid; or if `mistray.load` raises.

    Examples
    --------
    >>> coated = mistray.coat("cooke_triplet", {"L1": "bbar3", "L2_front": "R=0.01 T=0.99"}, paint={"barrel": 0.03})
    >>> for scene in mistray.load("cooke_triplet"), coated:
    ...     ghosts = mistray.optimize.path_power(scene, "ghost", rays=5000)
    ...     print(f"{ghosts.value():.4f} of the light comes as ghosts")
    0.0042 of the light comes as ghosts
    0.0017 of the light comes as ghosts
    """
    given = {"coatings": coatings, "paint": paint, "scatter": scatter}
    rules = Rules(**{name: rule for name, rule in given.items() if rule is not None})  # type: ignore[arg-type]
    if isinstance(system, Prescription):
        if sources is not None or sensors is not None:
            raise MistrayError("coat: sources and sensors are for scenes; a prescription has its own, see with_source")
        return coated_prescription(system, rules)[0]
    if not isinstance(system, str | Path | ModuleType):
        raise MistrayError(
            f"coat: {type(system).__name__} is given; give a scene file, the name of a shipped scene, or a "
            "Prescription; mistray.coat(file, …) loads the scene"
        )
    return coated_scene(system, rules, sources, sensors)[0]


def coated_scene(
    system: str | Path | ModuleType, rules: Rules, sources: Parts = None, sensors: Parts = None
) -> tuple[mi.Scene, Coated]:
    """
    Return the scene of `coat`, with its sources and sensors, and the changes to its surfaces.

    Raise as `coat` does.
    """
    path = find(system)
    text, found = coated_text(path, rules, path.parent)
    return load_text(path, text, sources, sensors), found


def write_coated(source: str | Path, target: str | Path, rules: Rules) -> Coated:
    """
    Write a scene with coatings, paint and scatter models put on surfaces; everything else in the file stays.

    Parameters
    ----------
    source : str or Path
        Scene XML file, or the name of a shipped scene.
    target : str or Path
        File to write; may be `source` itself.
    rules : Rules
        Coatings, paint and scatter models by patterns of names.

    Returns
    -------
    Coated
        Changes to the surfaces, and surfaces that rules leave as they are.

    Raises
    ------
    MistrayError
        If `coat` would raise, or the file cannot be written; an old file then stays.

    Examples
    --------
    >>> rules = mistray.scene.Rules(coatings={"L*": "bbar3"}, paint={"barrel": 0.03})
    >>> coated = mistray.scene.write_coated("cooke_triplet", "coated.xml", rules)
    >>> len(coated.changes)
    10
    >>> scene = mistray.load("coated.xml")
    """
    target = Path(target)
    text, found = coated_text(find(source), rules, target.parent)
    load_text(target, text)
    replace_file(target, text, "scene file")
    return found


def coated_text(path: Path, rules: Rules, folder: Path) -> tuple[str, Coated]:
    """
    Return the text of a scene file with rules applied, to be stored in `folder`, and the changes to its surfaces.

    Raise `MistrayError` as `check_source` and `Painter.apply` do.
    """
    check_source(path)
    file = SceneFile(path)
    shared = dict(shared_objects(file))
    comments = "\n".join(file.data[start:end].decode() for start, end in file.comments)
    taken = with_includes(path).ids
    painter = Painter(f"scene '{path}'", list(faces_of(file)), shared, taken, file.beside, light_nm(path), comments)
    painter.apply(rules)
    seen = seen_from(folder)
    refits: dict[str, Refit] = {}
    new: dict[str, Coating | Scatter] = {}
    for name, change in painter.changes.items():
        coating = change.coating
        if coating is not None and coating.name not in shared:
            coating = coating.moved(seen)
        models = [model if model.name in shared else model.moved(seen) for model in change.scatter]
        refits[name] = Refit(tuple(finish_lines(coating, models)), change.recoated, change.drops)
        named = [item for item in (coating, *models) if item is not None and item.name is not None]
        new |= {str(item.name): item for item in named if item.name not in shared}
    lines = [line for item in new.values() for line in shared_lines(item)]
    kept = {str(change.coating.name) for change in painter.changes.values() if change.coating is not None}
    text = refitted(file, refits, lines, folder, kept=kept)
    return text, Coated(painter.changes, tuple(painter.left), tuple(painter.notes))


def coated_prescription(system: Prescription, rules: Rules) -> tuple[Prescription, Coated]:
    """
    Return the prescription of `coat`, and the changes to its surfaces.

    Raise `MistrayError` as `Painter.apply` does.
    """
    shapes = list(system.shapes())
    shared: dict[str, Coating | Scatter] = {**system.shared_coatings(), **system.shared_scatter()}

    def opaque(shape: Any) -> bool:
        ruled = any(Face(shape.name, shape.part).fits(pattern) for pattern in rules.coatings)  # others need no table
        return shape.coating is not None and (shape.coating.blocks() if ruled else shape.coating.opaque)

    faces = [
        Face(
            shape.name,
            shape.part,
            opaque=opaque(shape),
            mirror=bool(getattr(shape, "mirror", False)),
            cemented=not (is_gas(shape.front) or is_gas(shape.back)),
            front=shape.front,
            back=shape.back,
        )
        for shape in shapes
    ]
    names = [shape.name for shape in shapes]
    light = () if system.source is None else tuple(map(float, system.source.light.wavelengths_nm))
    painter = Painter(
        f"prescription '{system.name}'", faces, shared, names, light_nm=light, provenance=system.provenance
    )
    painter.apply(rules)

    def changed(shape: Any) -> Any:
        change = painter.changes.get(shape.name)
        if change is None:
            return shape
        kept = tuple(model for model in shape.scatter if model.kind not in change.drops)
        coating = change.coating if change.recoated else shape.coating
        return replace(shape, coating=coating, scatter=(*kept, *change.scatter))

    made = each_shape(system, changed)
    found = Coated(painter.changes, tuple(painter.left), tuple(painter.notes))
    # Without the notes on a detector that the rules answer, with what presets reach
    answered = set(system.detector.notes() if system.detector else ())
    answered -= set(made.detector.notes() if made.detector else ())
    lines = [line for line in made.provenance.splitlines() if not any(note in line for note in answered)]
    return replace(made, provenance="\n".join([*lines, *found.notes])), found


def faces_of(file: SceneFile) -> list[Face]:
    """
    Return a `Face` for each shape that has an id in a scene file.

    The face of a shape without an ``interface`` or ``thinfilm`` states this as its fault.
    """
    found = []
    for name, shape in file.ids.items():
        if shape.tag != "shape":
            continue
        part, surface = file.values(shape).get("part"), file.surface(shape)
        kind = "" if surface is None else surface[1].values.get("type", "")
        if surface is None or kind not in COATED:
            fault = f"has the BSDF '{kind}', not an 'interface'" if kind else "has no BSDF in this file"
            found.append(Face(name, part, fault=fault))
            continue
        values = file.values(surface[1])
        nested = (file.meant(child) for child in surface[1].children)
        films = [film for film in nested if film is not None and film.values.get("type") == "thinfilm"]
        coating = values | {key: value for film in films for key, value in file.values(film).items()}
        found.append(
            Face(
                name,
                part,
                opaque=_is_opaque(coating, file.beside),
                mirror=is_true(values.get("mirror", "")),
                cemented=not any(is_gas(values.get(side, "air")) for side in ("front", "back")),
                front=values.get("front", "air"),
                back=values.get("back", "air"),
            )
        )
    return found


def _is_opaque(coating: Mapping[str, str], beside: Callable[[str], str]) -> bool:
    """True if the properties of a coating in a scene file, or its table, found by `beside`, let no light through."""
    if is_true(coating.get("opaque", "")) or getattr(PRESETS.get(coating.get("preset", "")), "metal", None) is not None:
        return True
    if "table" in coating:
        design_nm = number_of(coating.get("design_nm", "")) or Coating.design_nm
        return read_coating(coating["table"], design_nm, resolve=beside).opaque
    return "R" in coating and number_of(coating.get("T", "0")) == 0

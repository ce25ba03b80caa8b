"""Coatings and scatter models that shapes of a prescription share by name, and changes to shapes by name patterns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.ids import fits
from mistray.prescription.coating import Coating
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import ByName

if TYPE_CHECKING:
    from mistray.prescription.model import Prescription

RULES = ByName(SCATTER, "{'barrel_*': mistray.Scatter(…)}")


def shared_coatings(where: str, shapes: Iterable[Any]) -> dict[str, Coating]:
    """
    Return the named coatings of shapes, keyed by the names of the coatings.

    Parameters
    ----------
    where : str
        Owner of the shapes, such as "prescription 'lens'", for messages.
    shapes : iterable of Surface, Structure or MeshStructure
        Shapes to search.

    Raises
    ------
    MistrayError
        If two different coatings have the same name, or a coating has the name of a shape.
    """
    return _shared(where, "coating", shapes, lambda shape: (shape.coating,) if shape.coating else ())


def shared_scatter(where: str, shapes: Iterable[Any]) -> dict[str, Scatter]:
    """
    Return the named scatter models of shapes, keyed by name; parameters as in `shared_coatings`.

    Raises
    ------
    MistrayError
        If two models of the same name differ, or a shape or a coating has that name.
    """
    shapes = list(shapes)
    shared = _shared(where, "scatter model", shapes, lambda shape: shape.scatter)
    for name in shared.keys() & shared_coatings(where, shapes).keys():
        raise MistrayError(f"{where}: a coating and a scatter model are called '{name}'; rename one")
    return shared


def _shared(where: str, what: str, shapes: Iterable[Any], items: Callable[[Any], Iterable[Any]]) -> dict[str, Any]:
    """
    Return the named coatings or scatter models of shapes, by name; `items` is a function from a shape to its own.

    Raise `MistrayError` if different ones share a name, or a shape has it; `where` and `what` are for its message.
    """
    shapes = list(shapes)
    shared: dict[str, Any] = {}
    names = {shape.name for shape in shapes}
    for shape in shapes:
        for item in items(shape):
            if item.name is None:
                continue
            if shared.setdefault(item.name, item) != item:
                raise MistrayError(
                    f"{where}: two different {what}s are called '{item.name}', that of '{shape.name}' is one; give "
                    "each its own name"
                )
            if item.name in names:
                raise MistrayError(f"{where}: a shape and a {what} are called '{item.name}'; rename one")
    return shared


def scattering(prescription: Prescription, rules: Mapping[str, Scatter | Sequence[Scatter]]) -> Prescription:
    """Return a copy of a system with scatter models added to shapes by name; see `Prescription.with_scatter`."""
    names = [shape.name for shape in prescription.shapes()]
    models_of = RULES.check("rules", rules, f"prescription '{prescription.name}'")
    for pattern in models_of:
        if not any(fits(name, pattern) for name in names):
            raise MistrayError(
                f"prescription '{prescription.name}': no shape is called '{pattern}'; correct the pattern"
            )

    def added(shape: Any) -> Any:
        more = tuple(model for pattern, models in models_of.items() if fits(shape.name, pattern) for model in models)
        return replace(shape, scatter=shape.scatter + more)

    return each_shape(prescription, added)


def each_shape(prescription: Prescription, change: Callable[[Any], Any]) -> Prescription:
    """
    Return the system with the function `change` applied to every shape; a stop takes coating and scatter of its faces.

    Raises
    ------
    MistrayError
        If the faces of a stop, which share their finish, would differ.
    """
    stop = prescription.stop
    if stop is not None:
        faces = {(face.coating, face.scatter) for face in map(change, stop.faces())}
        if len(faces) > 1:
            raise MistrayError(
                f"prescription '{prescription.name}': a pattern matches some faces of stop '{stop.part}'; match all"
            )
        coating, scatter = faces.pop()
        stop = replace(stop, coating=coating, scatter=scatter)
    return replace(
        prescription,
        surfaces=tuple(map(change, prescription.surfaces)),
        structures=tuple(map(change, prescription.structures)),
        stop=stop,
        detector=prescription.detector and change(prescription.detector),
        more_detectors=tuple(map(change, prescription.more_detectors)),
    )

"""What shapes of a prescription have by their names: coatings and scatter models that they share, and rules."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.ids import fits
from mistray.prescription.coating import Coating
from mistray.prescription.scatter import Scatter

if TYPE_CHECKING:
    from mistray.prescription.model import Prescription


def shared_coatings(where: str, shapes: Iterable[Any]) -> dict[str, Coating]:
    """
    The coatings of shapes that have a name, by it.

    Parameters
    ----------
    where : str
        What the shapes belong to, such as "prescription 'lens'", for messages.
    shapes : iterable of Surface, Structure or MeshStructure

    Raises
    ------
    MistrayError
        If two coatings of one name differ, or a shape has that name.
    """
    return _shared(where, "coating", shapes, lambda shape: (shape.coating,) if shape.coating else ())


def shared_scatter(where: str, shapes: Iterable[Any]) -> dict[str, Scatter]:
    """
    The scatter models of shapes that have a name, by it; parameters as in `shared_coatings`.

    Raises
    ------
    MistrayError
        If two models of one name differ, or a shape or a coating has that name.
    """
    shapes = list(shapes)
    shared = _shared(where, "scatter model", shapes, lambda shape: shape.scatter)
    for name in shared.keys() & shared_coatings(where, shapes).keys():
        raise MistrayError(f"{where}: a coating and a scatter model are called '{name}'; rename one")
    return shared


def _shared(where: str, what: str, shapes: Iterable[Any], items: Callable[[Any], Iterable[Any]]) -> dict[str, Any]:
    """The items that have a name; `what` they are called in messages."""
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


def scattering(prescription: Prescription, rules: Mapping[str, Sequence[Scatter]]) -> Prescription:
    """A copy with scatter added to shapes by name; see `Prescription.with_scatter`."""
    names = [shape.name for shape in prescription.shapes()]
    for pattern in rules:
        if not any(fits(name, pattern) for name in names):
            raise MistrayError(
                f"prescription '{prescription.name}': no shape is called '{pattern}'; correct the pattern"
            )

    def added(name: str) -> tuple[Scatter, ...]:
        return tuple(model for pattern, models in rules.items() if fits(name, pattern) for model in models)

    def with_more(shape: Any) -> Any:
        return replace(shape, scatter=shape.scatter + added(shape.name))

    stop = prescription.stop
    if stop is not None:
        faces = {added(face.name) for face in stop.faces()}
        if len(faces) > 1:
            raise MistrayError(
                f"prescription '{prescription.name}': a pattern matches some faces of stop '{stop.part}'; match all"
            )
        stop = replace(stop, scatter=stop.scatter + faces.pop())
    return replace(
        prescription,
        surfaces=tuple(with_more(shape) for shape in prescription.surfaces),
        structures=tuple(with_more(shape) for shape in prescription.structures),
        stop=stop,
        detector=prescription.detector and with_more(prescription.detector),
        more_detectors=tuple(with_more(shape) for shape in prescription.more_detectors),
    )

"""Warnings about allowed but improbable numbers in a scene, as by a misplaced decimal point or a wrong unit."""

from __future__ import annotations

import mitsuba as mi

MOST_NAMED = 3  # surfaces of one model in a message


def improbable(scene: mi.Scene) -> list[str]:
    """
    Return advice on unusual numbers of the scatter models and the sources of a scene.

    Each model or source reports this through its method `advice`; a model that several surfaces share is reported once.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.

    Returns
    -------
    list of str
        One line for each unusual model or source: its name, its values and the usual range. For a model it begins with
        the surfaces that have it.
    """
    found: dict[int, tuple[str, list[str]]] = {}
    for shape in scene.shapes():
        for plugin in getattr(shape.bsdf(), "scatterers", ()):
            advice = getattr(plugin.model, "advice", lambda: None)()
            if advice is not None:
                found.setdefault(id(plugin), (advice, []))[1].append(shape.id())
    sources = (getattr(emitter, "advice", lambda: None)() for emitter in scene.emitters())
    return [
        *(f"{_surfaces(names)}: {advice}" for advice, names in found.values()),
        *(advice for advice in sources if advice is not None),
    ]


def _surfaces(names: list[str]) -> str:
    named = ", ".join(f"'{name}'" for name in names[:MOST_NAMED])
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return f"surface{'s' if len(names) > 1 else ''} {named}{more}"

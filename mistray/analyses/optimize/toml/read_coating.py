"""Reader of the sections ``[[coating]]`` of a design study."""

from __future__ import annotations

from pathlib import Path

from mistray.analyses.optimize.study.model import CoatingGroup, CoatingKeys
from mistray.coatings import Stack, parse_layers, preset
from mistray.errors import MistrayError, errors_of
from mistray.ids import check_written_id
from mistray.toolkit.toml_section import TomlSection, keys_of

ALL = "all"
FORM = f'a list of shape ids, or "{ALL}"'


def read_coating(section: TomlSection, number: int) -> CoatingGroup:
    """
    Return the coating in a section ``[[coating]]``; without a name it is called ``coating_`` and its number.

    Raises
    ------
    MistrayError
        If a key is unknown, a value is impossible, or a layer of the start design lies outside its bounds.
    """
    section.known(keys_of(CoatingKeys))
    surfaces = None if section.content.get("surfaces") == ALL else section.texts("surfaces", FORM)
    if surfaces is not None and len(set(surfaces)) < len(surfaces):
        raise section.fail("surfaces", f"is {list(surfaces)}; name every surface once")
    read = {"surfaces": surfaces, "thickness_nm": section.content.get("thickness_nm")}
    given = section.make(CoatingKeys, read, name=f"coating_{number}")
    check_written_id(given.name, "coating")
    start = _start(section, given)
    bounds = _bounds(section, len(start.layers))
    with errors_of(f"{section.title}: {section.place.removesuffix('.')}"):
        return CoatingGroup(given.name, surfaces, start, bounds, given.design_nm)


def _start(section: TomlSection, given: CoatingKeys) -> Stack:
    designs = [key for key in ("layers", "preset") if key in section]
    if len(designs) != 1:
        raise section.fail("", f"has {' and '.join(designs) or 'no start design'}; give layers or preset")
    try:
        if given.layers is not None:

            def resolve(path: str) -> str:  # a file of materials is named relative to the study
                return path if Path(path).is_absolute() else str((section.folder / path).resolve())

            layers = parse_layers(given.layers, given.design_nm, given.name, resolve)
            return Stack(layers, given.first or "outside", given.name)
        stack = preset(str(given.preset), given.design_nm)
    except MistrayError as error:
        raise section.fail(f"{designs[0]}:", str(error)) from None
    if stack.opaque:
        raise section.fail("preset", f"is '{given.preset}', a mirror; give a coating that transmits")
    if given.first is not None:
        raise section.fail("first", "stands beside a preset, which knows its order; remove it or write layers")
    return Stack(stack.layers, stack.first, given.name)


def _bounds(section: TomlSection, layers: int) -> tuple[tuple[float, float], ...]:
    value = section.content.get("thickness_nm")
    pairs = value if isinstance(value, list) and value and isinstance(value[0], list) else [value] * layers
    form = "give [low, high] in nm, or one such pair for each layer"
    if len(pairs) != layers:
        raise section.fail("thickness_nm", f"has {len(pairs)} pairs for {layers} layers; {form}")
    result = []
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2:
            raise section.fail("thickness_nm", f"is {value!r}; {form}")
        low, high = section.numbers("thickness_nm", pair)
        if not 0 <= low < high:
            raise section.fail("thickness_nm", f"is {pair}; low must be at least 0 and less than high")
        result.append((low, high))
    return tuple(result)

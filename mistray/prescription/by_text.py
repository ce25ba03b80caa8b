"""Coatings and scatter models from short texts such as "bbar3" or "R=0.01 T=0.99"."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from mistray.coatings import PRESETS, Stack, coating_from_text
from mistray.errors import MistrayError
from mistray.ids import plain_name
from mistray.named_values import as_number, name_and_value, named_values, number_of
from mistray.prescription.coating import Coating
from mistray.prescription.scatter import Scatter, Value
from mistray.scatter.kinds import KINDS

BARE, CLEAN = "bare", "none"
SHARES = ("R", "T")
IN_WAVES = re.compile(r"\dw\s*(,|$)|\.dat:", re.IGNORECASE)  # thicknesses in waves, and a file that may have some
OF_LAYERS = ("design_nm", "first")  # words that may follow layers, a preset or a file


def coating_of(
    text: str, known: Mapping[str, Coating] = MappingProxyType({}), design_nm: float = Coating.design_nm
) -> Coating | None:
    """
    Return the coating that a short text names or describes; None for "bare".

    Parameters
    ----------
    text : str
        A name in `known`, "bare", a preset such as "bbar3", layers such as "MgF2 99.64, 2.1 0.5w", a file (table.csv,
        COATING.DAT:NAME; relative to the current folder), or "R=0.01 T=0.99". ``design_nm=850`` and ``first=back`` may
        follow layers, a preset or a file.
    known : mapping of str to Coating
        Further coatings by name, such as those of a scene.
    design_nm : float
        Wavelength that thicknesses in waves (``0.5w``, and those of a COATING.DAT) refer to, nm, if the text gives
        none.

    Returns
    -------
    Coating or None
        Coating; None for a bare surface. A coating with layers, a preset or a file gets a name, so that surfaces can
        share it.

    Raises
    ------
    MistrayError
        If the text has none of these forms, or a value is out of range.
    """
    text = text.strip()
    owner = f"coating '{text}'"
    if text in known:
        return known[text]
    if text == BARE:
        return None
    words = text.split()
    shares = _values(words, SHARES)
    if words and len(shares) == len(words):
        r, t = (as_number(shares[key], key, owner) if key in shares else None for key in SHARES)
        return Coating(R=r, T=t)
    more = _values(words[1:], OF_LAYERS)
    recipe = text
    for _ in more:
        recipe = recipe.rpartition(" ")[0].rstrip()
    own: dict[str, Any] = dict(more)
    if "design_nm" in more:
        own["design_nm"] = as_number(more["design_nm"], "design_nm", owner)
    elif recipe not in PRESETS and IN_WAVES.search(recipe) and design_nm != Coating.design_nm:
        own["design_nm"] = design_nm
    try:
        design_nm = own.get("design_nm", Coating.design_nm)
        found = coating_from_text(recipe, design_nm)
        if isinstance(found, Stack):
            found.indices(design_nm, nearest=True)
    except MistrayError as error:
        near = difflib.get_close_matches(recipe, known, n=1)
        hint = f"; or did you mean '{near[0]}' of the scene?" if near else ""
        raise MistrayError(f"coating '{text}': {error}{hint}") from None
    if recipe in PRESETS:
        return Coating(preset=recipe, name=_name(recipe, own), **own)
    if " " not in recipe:
        return Coating(table=recipe, name=_name(re.sub(r"\.\w+$", "", recipe.rpartition("/")[2]), own), **own)
    return Coating(layers=recipe, name="coating", **own)


def scatter_of(text: str, known: Mapping[str, Scatter] = MappingProxyType({})) -> Scatter | None:
    """
    Return the scatter model that a short text names or describes.

    Parameters
    ----------
    text : str
        A name in `known`, or a scatter plugin with its properties, such as "harvey_shack rms_nm=4 l=0.01 s=-1.5".
        Files are relative to the current folder.
    known : mapping of str to Scatter
        Further models by name, such as those of a scene.

    Returns
    -------
    Scatter or None
        Model with a name, so that surfaces can share it; None if the text has neither form.

    Raises
    ------
    MistrayError
        If a property is given twice, or the model refuses a property or its value.
    """
    if text in known:
        return known[text]
    words = text.split()
    if not words or words[0] not in KINDS or not all("=" in word for word in words[1:]):
        return None
    given = named_values(words[1:], f"scatter '{text}'")
    properties: dict[str, Value] = {key: _value(value) for key, value in given.items()}
    return Scatter(words[0], properties, name=_name(words[0], properties))


def _values(words: list[str], keys: tuple[str, ...]) -> dict[str, str]:
    """Return KEY=VALUE words at the end of `words` as a dict, back to one whose key is not in `keys` or repeated."""
    found: dict[str, str] = {}
    for word in reversed(words):
        pair = name_and_value(word)
        if pair is None or pair[0] not in keys or pair[0] in found:
            break
        found[pair[0]] = pair[1]
    return found


def _value(text: str) -> Value:
    if text in ("true", "false"):
        return text == "true"
    found = number_of(text)
    return text if found is None else found


def _name(kind: str, properties: Mapping[str, Value]) -> str:
    """Return an id made of a kind of model and its values; equal values such as .1 and 0.1 give equal ids."""
    words = [kind, *(f"{key}_{value}".removesuffix(".0") for key, value in properties.items())]
    return plain_name("_".join(words))

"""Paint on the faces of a mechanical part, and its form as a short string."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from mistray.errors import MistrayError
from mistray.named_values import number_of
from mistray.prescription.by_text import scatter_of
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import TEXT, ByName, OfType, check_fields
from mistray.scatter.paint import PRESETS

OTHER_SIDE = {"front": "back", "back": "front"}


@dataclass(frozen=True)
class Finish:
    """
    Paint of a face: its coating and scatter models.

    Attributes
    ----------
    coating : Coating or None
        Coating as in `Structure`; by default a perfect absorber. ``None``: bare Fresnel interface.
    scatter : tuple of Scatter
        Scatter models. Their ``side``, like the ``first`` layer of the coating, refers to a body whose outside is the
        back.

    Examples
    --------
    >>> black = mistray.mechanics.Finish()
    >>> black.coating.R, black.scatter
    (0.0, ())
    >>> white = mistray.mechanics.finish("0.9")
    >>> white.scatter[0].properties["reflectance"]
    0.9
    """

    coating: Coating | None = BLACK
    scatter: tuple[Scatter, ...] = SCATTER.field(())

    def __post_init__(self) -> None:
        check_fields(self, "finish")

    def turned(self) -> Finish:
        """Return the finish for a surface whose front is the outside of the body."""
        coating = self.coating
        if coating is not None and coating.first in OTHER_SIDE:
            coating = replace(coating, first=OTHER_SIDE[coating.first], name=_turned_name(coating.name))
        return Finish(coating, tuple(_turned(model) for model in self.scatter))


ABSORBER = Finish()
FINISHES = ByName(OfType(Finish, "must be a mistray.mechanics.Finish"), "{'paint': mistray.mechanics.Finish(…)}")


def finish(text: str, known: Mapping[str, Finish] = MappingProxyType({})) -> Finish:
    """
    Return a finish from its name, or from its values as a string.

    Parameters
    ----------
    text : str
        A name in `known`, "black" (absorbs everything), a preset of the plugin `paint` such as "flat_black", "0.05"
        (Lambertian with this reflectance), "R=0.05" (reflects this fraction specularly), or a scatter plugin with its
        properties, such as "paint reflectance=0.05 side=back" or "harvey_shack rms_nm=4 l=0.01 s=-1.5".
    known : mapping of str to Finish
        Further finishes by name, such as those of a scene.

    Raises
    ------
    MistrayError
        If the string is none of these, or a model refuses its values.

    Examples
    --------
    >>> paint = mistray.mechanics.finish("0.05")
    >>> paint.scatter[0].kind
    'paint'
    >>> mistray.mechanics.finish("R=0.05").coating.R
    0.05
    """
    TEXT.check("finish", text)
    if text in FINISHES.check("known", known):
        return known[text]
    if text == "black":
        return ABSORBER
    if text in PRESETS:
        return Finish(BLACK, (Scatter("paint", {"preset": text}, name=text),))
    reflectance = number_of(text)
    if reflectance == 0:
        return ABSORBER
    model = scatter_of(text if reflectance is None else f"paint reflectance={text}")
    if model is not None:
        return Finish(BLACK, (model,))
    share = number_of(text[2:]) if text.startswith("R=") else None
    if share is not None:
        return Finish(Coating(R=share))
    offered = [*known, "black", *PRESETS]
    close = difflib.get_close_matches(text, offered, n=3)
    hint = (
        f"did you mean {' or '.join(close)}?"
        if close
        else f"give {', '.join(offered)}, 0.05, R=0.05, or a scatter plugin"
    )
    raise MistrayError(f"paint '{text}': there is none of this name; {hint}")


def known_finishes(shared: Iterable[Coating | Scatter]) -> dict[str, Finish]:
    """Return a finish, by name, for each named coating and scatter model of a scene."""
    return {str(item.name): Finish(item) if isinstance(item, Coating) else Finish(scatter=(item,)) for item in shared}


def _turned(model: Scatter) -> Scatter:
    side = OTHER_SIDE.get(str(model.properties.get("side")))
    if side is None:
        return model
    return Scatter(model.kind, {**model.properties, "side": side}, name=_turned_name(model.name))


def _turned_name(name: str | None) -> str | None:
    return None if name is None else f"{name}_turned"

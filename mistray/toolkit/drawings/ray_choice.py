"""Request for the rays to draw in pictures of traces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.ranges import PLACE_MM, RAYS_DRAWN, ROWS, TEXT, Demand, Each, Several
from mistray.toolkit.fields import Request, field

ELSEWHERE = -1
BACKWARD = "backward"  # rays from the detector


class ChosenRow(Demand):
    """Condition on a value that selects rows of the path table: an index for one, a name or filter for all that fit."""

    demand = ROWS.demand
    metavar = "ID"
    also = ({"type": "integer", "minimum": ROWS.low, "maximum": ROWS.high}, {"type": "string"})

    def check(self, name: str, value: Any, owner: str = "") -> int | str:
        """Return a value if it is a row index or a string; otherwise raise `MistrayError`."""
        found: int | str = value if isinstance(value, str) else ROWS.check(name, value, owner)
        return found

    def __call__(self, text: str) -> int | str:
        """Return the value of a word of the command line: a row index, or else a name or filter."""
        return int(ROWS(text)) if text.strip().lstrip("+-").isdigit() else text


@dataclass(frozen=True)
class RayChoice(Request):
    """
    Choice of the rays to draw from traces: those of the strongest paths, of chosen paths, or of classes of light.

    Fields that exclude each other raise `MistrayError`.
    """

    _: KW_ONLY
    paths: int = field(ROWS, 8, "paths to draw, strongest first, each at its strongest wavelength")
    path_ids: Sequence[int | str] | None = field(
        Several(ChosenRow(), 0),
        None,
        "these rows instead, by number, by name, as 'L2_rear -> L1_front', or by a filter (docs/rays.md)",
    )
    classes: Sequence[str] | None = field(
        Several(TEXT, 0),
        None,
        "rays by class instead of paths: direct, ghost, stray, all … on the detector; blocked, escaped, returned, or "
        "surfaces at which they arrive; backward: from the detector (docs/view.md)",
        metavar="CLASS",
    )
    selection: str = field(
        TEXT,
        "",
        "strongest rows, or rays by class, that pass a filter, as 'G(lens*) & !S' (docs/rays.md)",
        option="--filter",
        metavar="EXPR",
    )
    box: Sequence[float] | None = field(
        Each(PLACE_MM, 4),
        None,
        "of rays by class only those that land there on the detector, x0, x1, y0, y1, mm",
        metavar=("X0", "X1", "Y0", "Y1"),
    )
    rays: int = field(RAYS_DRAWN, 10, "most rays of each path or class", option="--rays-per-path")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path_ids is not None and self.selection:
            raise MistrayError("path_ids=… has no effect beside selection=…; give one of them")
        if self.classes is None:
            if self.box is not None:
                raise MistrayError("box=… is about rays by class; add classes=all, or leave it out")
            return
        if self.path_ids is not None:
            raise MistrayError("path_ids=… is about paths, and classes=… draws rays by class; give one")
        if BACKWARD in self.classes and (self.box is not None or self.selection):
            what = "selection" if self.box is None else "box"
            raise MistrayError(f"{what}=… is about light of the sources, not about {BACKWARD} rays; give one")

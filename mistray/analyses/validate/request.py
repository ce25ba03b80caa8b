"""Request for a validation: rows of reference numbers to compare, or a user's file, and the start rays per trace."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from mistray.ranges import RAYS, SEED, TEXT, Several
from mistray.toolkit.fields import Request, field


@dataclass(frozen=True)
class ValidateRequest(Request):
    """Rows of reference numbers to compare with mistray's, and the start rays of their traces."""

    only: tuple[str, ...] | None = field(
        Several(TEXT), None, "packs, or rows as 'pack/row', with * for any letters and ? for one", metavar="PATTERN"
    )
    _: KW_ONLY
    own: tuple[str, ...] | None = field(
        Several(TEXT), None, "files with numbers of your own instead (docs/validation/index.md)", metavar="FILE"
    )
    rays: int | None = field(RAYS, None, "start rays of each trace (as each pack says)")
    seed: int = field(SEED, 0, "seed of the random numbers")

"""Request of a validation: the rows that are compared, or a file with one's own, and the rays of their traces."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from mistray.ranges import RAYS, SEED, TEXT
from mistray.toolkit.fields import Request, Several, field


@dataclass(frozen=True)
class ValidateRequest(Request):
    """Rows that are compared, and the rays of their traces."""

    only: tuple[str, ...] | None = field(
        Several(TEXT), None, "packs, or rows as 'pack/row', with * for any letters and ? for one", metavar="PATTERN"
    )
    _: KW_ONLY
    own: tuple[str, ...] | None = field(
        Several(TEXT), None, "files with numbers of your own instead (docs/validation/index.md)", metavar="FILE"
    )
    rays: int | None = field(RAYS, None, "start rays of each trace (as each pack says)")
    seed: int = field(SEED, 0, "seed of the random numbers")

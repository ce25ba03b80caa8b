"""Request for an optimisation: settings besides those of its study."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from mistray.ranges import FLAG, Range
from mistray.ranges import SEEDS as SEED_COUNT
from mistray.toolkit.fields import Request, field

SEEDS = 8
STEPS = Range(0, 10_000, whole=True)


@dataclass(frozen=True)
class DesignRequest(Request):
    """
    Request for an optimisation, besides its study: the most steps of each search, and how the result is verified.

    It is verified on a number of random seeds and, if `next_order`, also with one more scatter event or reflection.
    """

    _: KW_ONLY
    steps: int | None = field(STEPS, None, "most steps of each search, instead of those of the study")
    verification_seeds: int = field(
        SEED_COUNT, SEEDS, "seeds on which the result is compared with the given design, at least 2"
    )
    next_order: bool = field(
        FLAG,
        True,
        "measure both designs again with one more scatter event and, apart from that, with one more reflection",
    )

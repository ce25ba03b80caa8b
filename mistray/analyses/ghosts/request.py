"""Requests for a ghost analysis: its arguments, and its optional tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.light import Light
from mistray.ranges import (
    BLOCK,
    CONTESTED_RAYS,
    FIELD_DEG,
    FLAG,
    PART,
    PLACE_MM,
    ROWS,
    STOPS,
    TEXT,
    Demand,
    Each,
    Several,
    Words,
    check_fields,
)
from mistray.settings import Settings
from mistray.toolkit.arguments import Pairs
from mistray.toolkit.fields import FieldSubset, Nested, Request, field

# What paths are ranked by, and the column of a path table with that rank
RANKS = {"rms": "rank_rms_irradiance", "power": "rank_power", "peak": "rank_peak"}
# Of a path analysis: whether the largest comes first
SORT_KEYS = {
    "power_W": True,
    "objects": True,
    "branches": True,
    "last_object": False,
    "unique_objects": True,
    "opl_mm": True,
    "diffractions": True,
}
CONTESTED_FACTOR = 4  # more rays where which path is the worst is open: half the errors
MOST_RAYS = 10_000
ALL_SURFACES = ("part", "space")  # aliases of all surfaces


@dataclass(frozen=True)
class GhostsRequest(Request):
    """Arguments of a ghost analysis: fields, light, ranking and limits of the ray tree."""

    field_deg: tuple[float, ...] | None = field(
        Each(FIELD_DEG), None, "field angles, degrees; without them that of the scene's source"
    )
    _: KW_ONLY
    field_mm: tuple[float, ...] | None = field(
        Each(PLACE_MM), None, "object heights of a near source instead, mm", metavar="MM"
    )
    light: Mapping[str, Any] = field(
        FieldSubset(Light, ("azimuth_deg", "wavelength_nm", "weights", "detector")),
        None,
        "light of all fields; its rays are shared by the wavelengths",
    )
    rank: str = field(
        Words(tuple(RANKS)),
        "rms",
        "what the list of worst paths goes by: RMS irradiance, power, or peak, the brightest pixel, for which the rays "
        "are traced again",
    )
    contested_rays: int | None = field(
        CONTESTED_RAYS,
        None,
        "start rays of a field where by RMS irradiance another path may be as bright as the worst: it is traced again; "
        f"without them {CONTESTED_FACTOR} times its rays; 0: never",
    )
    settings: Mapping[str, Any] = field(FieldSubset.but(Settings), None, "settings of the trace")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.field_mm is not None and self.field_deg is not None:
            raise MistrayError("field_deg and field_mm are given; give one of them")


@dataclass(frozen=True)
class Look:
    """
    Settings of colour pictures; see the head of `mistray.analyses.ghosts.colour`.

    Attributes
    ----------
    stops : float
        Exposure in stops (factors of two) above `reference`.
    reference : {"ghosts", "direct"}
        Light whose brightest channel is just filled at 0 stops: stray light, or the direct image on axis.
    white : {"source", "D65"}
        Light that appears grey.
    block : int
        Number of pixels averaged along each side; a divisor of height and width. 0: as many as the noise requires.

    Examples
    --------
    >>> look = mistray.report.Look(stops=2.0, white="D65")
    >>> look.reference
    'ghosts'
    """

    stops: float = field(STOPS, 0.0, "exposure, stops over the one that just fills the brightest channel", metavar="S")
    reference: str = field(
        Words(("ghosts", "direct")), "ghosts", "brightest pixel of the stray light, or of the direct image on axis"
    )
    white: str = field(Words(("source", "D65")), "source", "what comes out as grey: the light of the source, or D65")
    block: int = field(BLOCK, 0, "pixels averaged along each side; 0: as many as the noise asks for")

    def __post_init__(self) -> None:
        check_fields(self, "colour")


class Alias(Demand):
    """Parameter check for an alias of surfaces in path tables: "part", "space", or a pair of pattern and name."""

    metavar = "PATTERN=NAME"
    demand = f"must be {', '.join(ALL_SURFACES)}, or a pattern and a name"
    also = (
        {"enum": [*ALL_SURFACES]},
        {"type": "array", "items": {"type": "string", "minLength": 1}, "minItems": 2, "maxItems": 2},
    )
    _pair = Pairs("not an alias; give PATTERN=NAME, part or space")

    def __call__(self, text: str) -> str | tuple[str, str]:
        """Return the alias that a text of the command line stands for: a word, or a pair of pattern and name."""
        return text if text in ALL_SURFACES else self._pair(text)

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return an alias of surfaces, a pair as a tuple; raise `MistrayError` if the value is not an alias."""
        if isinstance(value, str) and value in ALL_SURFACES:
            return value
        if isinstance(value, tuple | list) and len(value) == 2 and all(isinstance(one, str) and one for one in value):
            return tuple(value)
        raise MistrayError(f"{name} is {value!r}; it {self.demand}")


@dataclass(frozen=True, kw_only=True)
class GhostTables(Request):
    """Optional tables and pictures of a ghost analysis, besides the main ones."""

    per_wavelength: bool = field(FLAG, False, "add paths and ledgers at each wavelength")
    levels: bool = field(FLAG, False, "print stray light by level of scatter or splitting and by critical surface")
    alias: Sequence[str | tuple[str, str]] | None = field(
        Several(Alias()),
        None,
        "add the paths with surfaces under other names, such as 'L1_*=L1'; or part or space: by part, by optical "
        "space; with --out aliased_paths.csv",
    )
    path_analysis: str | None = field(
        Words(tuple(SORT_KEYS)),
        None,
        f"add the paths sorted by a key: {', '.join(SORT_KEYS)}; with --out path_analysis.csv",
        metavar="KEY",
    )
    least_share: float | None = field(
        PART,
        None,
        "in the path analysis paths below this share of all light stand together; without it none",
        metavar="S",
    )
    filter: str | None = field(
        TEXT,
        None,
        "add the paths that pass a filter, such as 'G(lens*) & !S', or have a name, such as 'L2_rear -> L1_front' "
        "(docs/rays.md); with --out filtered_paths.csv and filtered_rays.csv",
        metavar="EXPR",
    )
    photometric: bool = field(FLAG, False, "add lm, lx, cd and cd/m², of visible wavelengths (docs/detectors.md)")
    rays_at: Sequence[str] | None = field(
        Several(TEXT),
        None,
        "write rays_at.csv: rays that arrive at surfaces or parts, or that are blocked, escaped or returned, and pass "
        "--filter (docs/rays.md); with --formats dat as Zemax files too",
        metavar="WHERE",
    )
    most_rays: int = field(ROWS, MOST_RAYS, "rays of --rays-at at each field, spread over the beams; 0: all")
    maps: Sequence[str] | None = field(
        Several(TEXT),
        None,
        "map parts of the light on the detector, and on surfaces of --surface-maps: kinds such as ghost or stray, "
        "filters or names of paths (docs/surface_maps.md)",
        metavar="LIGHT",
    )
    colour: bool = field(FLAG, False, "draw the ghosts as a photograph would show them")
    look: Look | None = field(Nested(Look), None, "how colour pictures are developed")

    def __post_init__(self) -> None:
        super().__post_init__()
        words = [word for word in self.alias or () if isinstance(word, str)]
        if words and len(self.alias or ()) > 1:
            raise MistrayError(f"alias '{words[0]}' stands for all surfaces; give it alone")

    @property
    def aliases(self) -> Mapping[str, str] | str | None:
        """Aliases in the form that `mistray.trace.PathTable.by_way` takes; None if none are requested."""
        words = [word for word in self.alias or () if isinstance(word, str)]
        return words[0] if words else dict(self.alias) if self.alias else None  # type: ignore[arg-type]  # pairs

    @property
    def sorted_by(self) -> tuple[str, float]:
        """Sort key of the path analysis, and the fraction of power, 0 … 1, below which paths are combined."""
        return self.path_analysis or "power_W", self.least_share or 0.0

    @property
    def developed(self) -> Look | None:
        """Settings of the colour pictures; None if none are requested."""
        return (self.look or Look()) if self.colour else None


MAIN_TABLES = GhostTables()


def rank_column(rank: str) -> str:
    """Return the column of a path table that holds a rank; raises `MistrayError` for an unknown one."""
    if rank not in RANKS:
        raise MistrayError(f"rank is '{rank}'; paths are ranked by {', '.join(RANKS)}")
    return RANKS[rank]

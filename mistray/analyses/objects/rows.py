"""Rows of the lists of objects: what is seen or lit, what is both, and ways past the optics."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """
    Which object it is, and where it stands.

    Attributes
    ----------
    id, part : str
        Shape and the part that it belongs to.
    side : str
        "front" or "back" of an opaque surface, "both" of one that transmits.
    space : int
        Optical space that the scene gives it; -1: none.
    between : str
        The surfaces of the design path between which it stands, as most of the rays that meet it have it.
    stop : str
        "before", "stop" or "after": where it stands along the design path; "" where that is not known.
    optic : bool
        On the design path.
    """

    id: str
    part: str
    side: str
    space: int
    between: str
    stop: str
    optic: bool


@dataclass(frozen=True, kw_only=True)
class SceneObject(_Placed):
    """
    A surface, or one side of it, as the detector or the outside sees it.

    Attributes
    ----------
    rays : int
        Rays that meet it.
    power, power_se : float
        Their flux, W for each W that starts.
    """

    rays: int
    power: float
    power_se: float


@dataclass(frozen=True, kw_only=True)
class CommonObject(_Placed):
    """An object that is critical and illuminated, with the rays and the flux of both views, see `SceneObject`."""

    critical_rays: int
    critical_power: float
    critical_power_se: float
    illuminated_rays: int
    illuminated_power: float
    illuminated_power_se: float


LISTS = {
    "critical": SceneObject,
    "illuminated": SceneObject,
    "common": CommonObject,
    "optics": CommonObject,
    "apart": CommonObject,
}


@dataclass(frozen=True)
class StraightShot:
    """
    A way by which the detector sees the outside that is not over the optics: neither reflection nor scatter is on it.

    Attributes
    ----------
    surfaces : tuple of str
        Shapes that the light goes through, in its order; empty: the outside is seen directly.
    missed : tuple of str
        Surfaces of the design path that it goes past.
    beside : tuple of str
        Surfaces on the way that are not on the design path.
    rays : int
    share, share_se : float
        Of the flux that starts at the detector.
    field_deg : tuple of float
        Smallest and largest field angle of such light.
    """

    surfaces: tuple[str, ...]
    missed: tuple[str, ...]
    beside: tuple[str, ...]
    rays: int
    share: float
    share_se: float
    field_deg: tuple[float, float]


def describe(shot: StraightShot) -> str:
    """A straight shot in words."""
    if not shot.surfaces:
        return "with no surface in between"
    past = f"past {', '.join(shot.missed)}" if shot.missed else ""
    through = f"through {', '.join(shot.beside)}" if shot.beside else ""
    return " ".join(text for text in (past, through) if text) or "through the optics in another order"


def strongest(rows: list[SceneObject]) -> list[SceneObject]:
    """The rows by flux."""
    return sorted(rows, key=lambda row: -row.power)


def both_views(seen: SceneObject, lit: SceneObject) -> CommonObject:
    """One row for what the detector and the outside see of an object."""
    place = {f.name: getattr(seen, f.name) for f in fields(_Placed)}
    views = {
        f"{view}_{name}": getattr(one, name)
        for view, one in (("critical", seen), ("illuminated", lit))
        for name in ("rays", "power", "power_se")
    }
    return CommonObject(**place, **views)

"""Rows of the lists of objects: seen, lit or both, paths past the optics, and scatter estimates."""

from __future__ import annotations

from dataclasses import dataclass, fields

from mistray.estimate import Estimate
from mistray.toolkit.rows import column, derived

POWER_UNIT = "W per W started"


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """Surface or side with its place along the design path: gap between design surfaces, and side of the stop."""

    id: str = column("Shape", head="object")
    part: str = column("Part that the shape belongs to")
    side: str = column('"front" or "back" of an opaque surface, "both" of one that transmits')
    space: int = column("Optical space that the scene gives it; -1: none", absent=-1)
    between: str = column(
        "The surfaces of the design path between which it stands, as most of the rays that meet it have it",
        head="stands between",
    )
    stop: str = column('"before", "stop" or "after": where it stands along the design path; "" where that is not known')
    optic: bool = column("On the design path")


@dataclass(frozen=True, kw_only=True)
class SceneObject(_Placed):
    """Surface or one side of it, with the rays that reach it from the detector or outside; flux in W per W started."""

    rays: int = column("Rays that meet it")
    power: float = column("Their flux, W for each W that starts", head=f"power [{POWER_UNIT}]")
    power_se: float = column("Its standard error")


@dataclass(frozen=True, kw_only=True)
class CommonObject(_Placed):
    """Object with the rays and flux that reach it from the detector and from outside, see `SceneObject`."""

    critical_rays: int = column("Rays from the detector that meet it", head="rays")
    critical_power: float = column("Their flux", head=f"critical [{POWER_UNIT}]")
    critical_power_se: float = column("Its standard error")
    illuminated_rays: int = column("Rays from outside that meet it", head="rays")
    illuminated_power: float = column("Their flux", head=f"illuminated [{POWER_UNIT}]")
    illuminated_power_se: float = column("Its standard error")

    @classmethod
    def of(cls, seen: SceneObject, lit: SceneObject) -> CommonObject:
        """Return one row for an object from its row as `seen` by the detector and its row as `lit` from outside."""
        place = {f.name: getattr(seen, f.name) for f in fields(_Placed)}
        views = {
            f"{view}_{name}": getattr(one, name)
            for view, one in (("critical", seen), ("illuminated", lit))
            for name in ("rays", "power", "power_se")
        }
        return cls(**place, **views)


LISTS = {
    "critical": SceneObject,
    "illuminated": SceneObject,
    "common": CommonObject,
    "optics": CommonObject,
    "apart": CommonObject,
}


@dataclass(frozen=True, kw_only=True)
class StraightShot:
    """
    Path from outside to the detector, other than the design path, without scatter and reflected by mirrors at most.

    Attributes
    ----------
    missed : tuple of str
        Surfaces of the design path that it bypasses.
    beside : tuple of str
        Surfaces that it passes through and that are not on the design path.
    field_deg : tuple of float
        Smallest and largest field angle of such light, degrees.
    """

    way: str = column("It in words")
    surfaces: tuple[str, ...] = column(
        "Shapes that the light goes through, in its order; empty: the outside is seen directly"
    )
    missed: tuple[str, ...]
    beside: tuple[str, ...]
    rays: int = column("Rays that go it")
    share: float = column("Share of the flux that starts at the detector", head="share [of the view of the detector]")
    share_se: float = column("Its standard error")
    field_deg: tuple[float, float]

    @derived.column("Smallest field angle of such light, degrees")
    def angle_from_deg(self) -> float:
        """Smallest field angle of light that takes this path, degrees."""
        return self.field_deg[0]

    @derived.column("Largest field angle of such light, degrees")
    def angle_to_deg(self) -> float:
        """Largest field angle of light that takes this path, degrees."""
        return self.field_deg[1]


@dataclass(frozen=True, kw_only=True)
class ScatterEstimate:
    """
    Estimate of the flux that one side of an object scatters to the detector, W, for a beam of 1 W/mm².

    It is Φ · BSDF · π · GCF, with the incident flux Φ, W, and the geometric configuration factor GCF: the projected
    solid angle of the detector over π. `gcf` and `pst` are dimensionless, `percent` is in %.
    """

    angle_deg: float = column(
        "Angle of the source, degrees; NaN for the mean over a cone or a disc", head="angle [deg]", digits="g"
    )
    id: str = column("Shape", head="object")
    part: str = column("Part that the shape belongs to")
    side: str = column("Side from which it is seen; one that transmits has a row for either")
    between: str = column("As of `SceneObject`")
    stop: str = column("As of `SceneObject`")
    optic: bool = column("On the design path")
    scatters: bool = column("It has a scatter model")
    flux_W: Estimate = column("Flux that lights it, W", head="Φ [W for 1 W/mm²]")
    bsdf_1_sr: float = column("BSDF from that light to the detector, 1/sr", head="BSDF [1/sr]", digits=".3g")
    gcf: float = column("Geometrical configuration factor of the detector", head="GCF", digits=".3g")
    detector_W: Estimate = column("Flux that meets the detector, for 1 W/mm² across the beam, W")
    pst: Estimate = column("`detector_W` over the area of the detector, normal convention", head="PST")
    percent: float = column(
        "Share of `detector_W` of all objects at this angle, %", 0.0, head="share [%]", digits=".3g"
    )

"""Rays of a telescope's design beam in batoid, from which the openings and outer radii of baffle plates are found.

batoid applies a baffle at its own place in the sequence and nowhere else. For example, a camera that shades the primary
mirror is a full disc in batoid; light on its way to the camera ignores the disc. A plate in space meets all light. So
the plate gets a hole where light that reaches the detector crosses its plane out of turn. If batoid states only the
opening of a baffle, its plate extends as far as the beam that it must shade.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from mistray.errors import MistrayError

RADII, RAYS_AROUND = 40, 60  # of the bundles, as batoid lays them out
SMALL_ANGLE, LARGEST_FIELD, UNKNOWN_FIELD = 1e-4, math.radians(10.0), math.radians(1.0)
FIELDS = (0.25, 0.5, 0.7, 0.8, 0.85, 0.9, 0.95, 1.0)  # of the edge, close to which light is vignetted
GAP = 0.15  # of the radius of a hole: what is left within it by chance, between the bundles
SAME_PLANE = 1e-9  # distance of a ray's point from a plane that it lies on, m
MARGIN = 1e-3  # by which holes are wider than the rays that were traced, and plates than their beam

Rings = list[tuple[float, float]]


class BatoidLight:
    """
    Rays from the centre and the edge of batoid's field through an optic, segment by segment.

    Parameters
    ----------
    batoid : module
        Imported package batoid.
    optic : batoid.Optic
        Telescope to trace.
    wavelength_nm : float
        Vacuum wavelength of the rays, nm.
    edge : float, optional
        Field angle of the edge of the field, rad; by default the angle at which the centroid lies on the rim of the
        detector, 10° at most. It is 1° if the detector states no radius, and 0 if no ray arrives.

    Notes
    -----
    Lengths are in metres.
    """

    def __init__(self, batoid: Any, optic: Any, wavelength_nm: float, edge: float | None = None) -> None:
        self._batoid, self._optic, self._wavelength = batoid, optic, wavelength_nm * 1e-9
        edge = self._edge_of_field() if edge is None else edge
        steps = [sign * edge * share for share in FIELDS for sign in (-1, 1)]
        fields = {(0.0, 0.0), *((step, 0.0) for step in steps), *((0.0, step) for step in steps)}
        # Points (stations, rays, 3) of the bundles on one interface after the other, and whether they arrive
        traced = [self._trace(*field) for field in sorted(fields)]
        self._interfaces = traced[0][2]
        self._points = np.concatenate([points for points, *_ in traced], axis=1)
        self._arrives = np.concatenate([arrives for _, arrives, *_ in traced])
        self._free = np.concatenate([free for *_, free in traced], axis=1)  # (stations, rays): nothing has shaded them

    def _edge_of_field(self) -> float:
        theta = SMALL_ANGLE
        for _ in range(4):  # distortion is a small matter
            points, arrives, interfaces, _ = self._trace(0.0, theta)
            radius = getattr(interfaces[-1], "outRadius", None) or _opening(interfaces[-1].obscuration)
            if not radius or not arrives.any():
                return 0.0 if radius else UNKNOWN_FIELD
            height = abs(float(np.mean(_local(interfaces[-1], points[-1])[arrives, 1])))
            theta = min(theta * float(radius) / height if height > 0 else math.inf, LARGEST_FIELD)
        return theta

    def _trace(self, theta_x: float, theta_y: float) -> tuple[np.ndarray, np.ndarray, list[Any], np.ndarray]:
        batoid, optic = self._batoid, self._optic
        outer, inner = pupil(optic)
        rays = batoid.RayVector.asPolar(
            backDist=getattr(optic, "backDist", None),
            medium=getattr(optic, "inMedium", None),
            stopSurface=getattr(optic, "stopSurface", None),
            coordSys=optic.coordSys,
            outer=outer,
            inner=inner,
            wavelength=self._wavelength,
            theta_x=theta_x,
            theta_y=theta_y,
            nrad=RADII,
            naz=RAYS_AROUND,
        )
        world = batoid.CoordSys()
        points, interfaces = [_points(rays, world)], list[Any]([None])
        arrives = np.ones(len(rays), dtype=bool)
        free = [arrives]
        for step in optic.traceFull(rays).values():
            out = step["out"]
            points.append(_points(out, world))
            free.append(~np.array(step["in"].vignetted))
            interfaces.append(optic[str(step["name"])] if hasattr(optic, "items") else optic)
            # What arrives may miss the detector: the edge of the field is on its rim
            arrives = ~(np.array(step["in"].vignetted) | np.array(out.failed))
        return np.array(points), arrives, interfaces, np.array(free)

    def beam_radius(self, interface: Any) -> float:
        """Return the largest distance from an interface's axis, m, at which rays meet it, enlarged by `MARGIN`."""
        return (1 + MARGIN) * self.beam_ring(interface)[1]

    def beam_ring(self, interface: Any) -> tuple[float, float]:
        """Return the smallest and largest distance from an interface's axis, m, at which rays meet it, in any pass."""
        local = _local(interface, self._points)
        there = [step is not None and step.name == interface.name for step in self._interfaces]
        if type(interface.surface).__name__ == "Plane":  # as one of several names
            there = list(np.nanmax(np.abs(local[..., 2]), axis=1) < SAME_PLANE)
        at = local[np.array(there)]
        radius = np.hypot(at[..., 0], at[..., 1])
        return float(np.nanmin(radius)), float(np.nanmax(radius))

    def _turn(self, interface: Any) -> int:
        """Return the index of the station at which the design beam first meets an interface; the start is station 0."""
        return next(k for k, step in enumerate(self._interfaces) if step is not None and step.name == interface.name)

    def way(self, interface: Any) -> int:
        """Return the direction of light just before it first meets a baffle: +1 or -1 along the baffle's z axis."""
        number = self._turn(interface)
        before = _local(interface, self._points[number - 1])[:, 2]
        return -1 if float(np.nanmean(before)) > 0 else 1

    def shaded(self, interface: Any, rings: Rings) -> float:
        """Return the fraction of the rays, not blocked so far, that centred rings (radii, m) meet in the first pass."""
        number = self._turn(interface)
        at = _local(interface, self._points[number][self._free[number]])
        radius = np.hypot(at[:, 0], at[:, 1])
        met = np.any([(radius > a) & (radius < b) for a, b in rings], axis=0) if rings else np.zeros(1, dtype=bool)
        return float(np.mean(met)) if met.size else 0.0

    def crossings(self, interface: Any, way: int = 0) -> Rings:
        """
        Return rings in a baffle's plane that light on its way to the detector crosses without meeting the baffle.

        Parameters
        ----------
        interface : batoid.Baffle
            Baffle whose plane is examined.
        way : int
            Direction of light along the baffle's z axis, +1 or -1, to which the search is limited. Light between lenses
            always counts; 0 counts all light.

        Returns
        -------
        list of (float, float)
            Inner and outer radius of each ring, m, with the margin `MARGIN`. Light between lenses gives a disc, inner
            radius 0, that reaches at least to their outer radii. The list is empty if no light crosses.
        """
        found = []
        for number in range(len(self._points) - 1):
            a, b = (_local(interface, self._points[k][self._arrives]) for k in (number, number + 1))
            with np.errstate(invalid="ignore", divide="ignore"):
                t = a[:, 2] / (a[:, 2] - b[:, 2])
                through = (a[:, 2] * b[:, 2] < 0) & (np.minimum(abs(a[:, 2]), abs(b[:, 2])) > SAME_PLANE)
            ends = self._interfaces[number : number + 2]
            tube = all(type(end).__name__ in ("RefractiveInterface", "Detector") for end in ends)
            through &= tube | ((b[:, 2] - a[:, 2]) * way >= 0)
            if not through.any():
                continue
            at = (a + t[:, None] * (b - a))[through]
            radius = np.hypot(at[:, 0], at[:, 1])
            inner, outer = (1 - MARGIN) * float(radius.min()), (1 + MARGIN) * float(radius.max())
            inner = inner if inner > GAP * outer else 0.0
            if tube:  # the plate must not reach into it
                inner, outer = 0.0, max(outer, *(float(end.outRadius) for end in ends))
            found.append((inner, outer))
        return found


def _opening(obscuration: Any) -> float | None:
    """Return the radius of the round opening that an obscuration leaves, m; None if its opening has another shape."""
    original: Any = getattr(obscuration, "original", None)
    if type(original).__name__ not in ("ObscCircle", "ObscAnnulus"):
        return None
    return float(getattr(original, "radius", None) or original.outer)


def pupil(optic: Any) -> tuple[float, float]:
    """
    Return the outer and the inner radius of the beam at the entrance pupil, m.

    If an optic has no pupilSize, such as a projector, the beam fills its narrowest round aperture ahead of the first
    mirror, and the inner radius is 0.

    Raises
    ------
    MistrayError
        If there is neither a pupilSize nor such an aperture.
    """
    size = getattr(optic, "pupilSize", None)
    if size:
        return size / 2, size / 2 * (getattr(optic, "pupilObscuration", None) or 0.0)
    radii = []
    for interface in interfaces(optic):
        if type(interface).__name__ == "Mirror":
            break
        if radius := _opening(interface.obscuration):
            radii.append(radius)
    if not radii:
        raise MistrayError(f"batoid element '{optic.name}': it has no pupilSize; set it, in metres")
    return min(radii), 0.0


def interfaces(optic: Any) -> Iterator[Any]:
    """Yield all interfaces of an optic, nested ones too, in the order in which light meets them."""
    for item in getattr(optic, "items", (optic,)):
        if hasattr(item, "items"):
            yield from interfaces(item)
        else:
            yield item


def without(rings: Iterable[tuple[float, float]], holes: Rings) -> Rings:
    """Return the parts of rings, (inner, outer) radius, m, that lie outside all `holes`."""
    left = list(rings)
    for low, high in holes:
        cut: Rings = []
        for inner, outer in left:
            cut += [(inner, min(outer, low))] if inner < min(outer, low) else []
            cut += [(max(inner, high), outer)] if max(inner, high) < outer else []
        left = cut
    return left


def _points(rays: Any, world: Any) -> np.ndarray:
    there = rays.toCoordSys(world) if hasattr(rays, "toCoordSys") else rays
    return np.array(there.r, dtype=np.float64)


def _local(interface: Any, points: np.ndarray) -> np.ndarray:
    """Return world points, (…, 3), m, in the frame of an interface, m."""
    frame = interface.coordSys
    return np.asarray((points - np.asarray(frame.origin)) @ np.asarray(frame.rot))

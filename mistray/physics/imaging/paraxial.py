"""First-order optics: ray trace, focal lengths and the table of two-reflection ghosts, in float64.

Heights are in mm; slopes u = dy/dz are dimensionless; indices are positive. Refraction: n'u' = nu - y c (n' - n) (W. J.
Smith, *Modern Optical Engineering*, 4th ed., section 3.2); a reflection is a refraction into -n.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.ranges import COEFFICIENTS, SHARE

COLLIMATED = 1e-12  # slope per mm of height, 1/mm, below which a marginal ray is taken for parallel to the axis


@dataclass(frozen=True)
class Ghost:
    """
    Two-reflection ghost of an on-axis collimated beam, in first order.

    Attributes
    ----------
    first, second : int
        Indices of the surfaces of the first and the second reflection, from 0; ``second < first``. A detector that
        reflects comes after the last surface.
    spot_radius_mm : float
        Radius of the beam's marginal ray in the image plane, mm.
    focus_mm : float
        Distance from the image plane to the ghost's focus along +z; ``inf`` if it leaves collimated.
    power : float
        Fraction of the launched power that arrives at the detector, before the detector's own loss.
    """

    first: int
    second: int
    spot_radius_mm: float
    focus_mm: float
    power: float

    def irradiance(self, beam_radius_mm: float) -> float:
        """
        Return the irradiance of the ghost's uniform disc per unit irradiance of a beam of the given radius, mm.

        It is ``inf`` for a ghost in focus on the image plane, or 0 if such a ghost has no power.
        """
        if self.spot_radius_mm == 0:
            return math.inf if self.power > 0 else 0.0
        return self.power * (beam_radius_mm / self.spot_radius_mm) ** 2


class ParaxialSystem:
    """
    System of coaxial refracting surfaces in first order.

    Parameters
    ----------
    curvature : float or sequence of float
        Curvature of each surface, 1/mm, positive if its centre of curvature is on the +z side.
    z : float or sequence of float
        Positions of the vertices along the axis, mm.
    index : sequence of float
        Refractive indices, one more than surfaces: before the first, between, after the last. They are positive,
        except where light travels along -z in a system unfolded at its mirrors.

    Raises
    ------
    MistrayError
        If the numbers of curvatures, positions and indices do not match.
    """

    def __init__(
        self,
        curvature: float | Sequence[float],
        z: float | Sequence[float],
        index: Sequence[float],
    ) -> None:
        curvature, z, index = (
            COEFFICIENTS.check(name, given, "paraxial system")
            for name, given in (("curvature", curvature), ("z", z), ("index", index))
        )
        if not len(curvature) == len(z) == len(index) - 1:
            raise MistrayError(
                f"paraxial system: curvature has {len(curvature)} numbers, z {len(z)}, index {len(index)}; "
                "give one z for each curvature, and one more index"
            )
        self.curvature: npt.NDArray[np.float64] = np.asarray(curvature, dtype=np.float64)
        self.z: npt.NDArray[np.float64] = np.asarray(z, dtype=np.float64)
        self.index: npt.NDArray[np.float64] = np.asarray(index, dtype=np.float64)

    def __len__(self) -> int:
        return len(self.z)

    def trace(self, y: float, u: float) -> npt.NDArray[np.float64]:
        """
        Return the heights and slopes of a ray through all surfaces.

        Parameters
        ----------
        y, u : float
            Height at the first vertex, mm, and slope dy/dz before it.

        Returns
        -------
        (n, 2) float64
            Height at each surface, mm, and slope after it.
        """
        rows = []
        for k in range(len(self)):
            if k:
                y += u * (self.z[k] - self.z[k - 1])
            u = (self.index[k] * u - y * self.curvature[k] * (self.index[k + 1] - self.index[k])) / self.index[k + 1]
            rows.append((y, u))
        return np.array(rows)

    @property
    def efl(self) -> float:
        """Rear effective focal length, mm, > 0 if a collimated beam is focused; ``inf`` if afocal."""
        u = self.trace(1.0, 0.0)[-1, 1]
        return math.inf if u == 0 else -1.0 / u

    @property
    def bfl(self) -> float:
        """Distance along +z from the last vertex to the rear focus, mm; ``inf`` if afocal."""
        y, u = self.trace(1.0, 0.0)[-1]
        return math.inf if u == 0 else -y / u

    def chief_ray(self, field_deg: float, stop_z: float) -> npt.NDArray[np.float64]:
        """
        Return the heights and slopes of the ray of a field angle through the centre of the stop.

        The vertices must ascend along the axis, so that light meets no mirror before the stop.

        Parameters
        ----------
        field_deg : float
            Angle to the axis before the first surface, degrees, of the sign of the ray's slope dy/dz there.
        stop_z : float
            Axial position of the stop, mm; it may lie before, between or after the surfaces.

        Returns
        -------
        (n, 2) float64
            Height at each surface, mm, and slope after it.

        Raises
        ------
        MistrayError
            If the stop lies in a focus of the surfaces before it.
        """
        u = math.tan(math.radians(field_deg))
        height_from_u = self._height_at(stop_z, 0.0, u)
        height_from_y = self._height_at(stop_z, 1.0, 0.0)
        if height_from_y == 0:
            raise MistrayError(f"stop at z = {stop_z:g} mm: it lies in a focus; no chief ray is defined there")
        return self.trace(-height_from_u / height_from_y, u)

    def _height_at(self, z: float, y: float, u: float) -> float:
        """Return the height, mm, at ``z``, mm, of the ray with height y, mm, and slope u at the first vertex."""
        k = int(np.searchsorted(self.z, z, side="left")) - 1
        if k < 0:
            return float(y + u * (z - self.z[0]))
        y_k, u_k = self.trace(y, u)[k]
        return float(y_k + u_k * (z - self.z[k]))

    def ghosts(
        self,
        image_z: float,
        beam_radius_mm: float,
        reflectance: float | Sequence[float],
        image_reflectance: float | None = None,
    ) -> list[Ghost]:
        """
        Return all ghosts of two reflections of a collimated on-axis beam.

        Parameters
        ----------
        image_z : float
            Position of the image plane, mm.
        beam_radius_mm : float
            Radius of the beam at the first surface, mm.
        reflectance : float or sequence of float
            Reflectance R of each surface; T = 1 - R.
        image_reflectance : float or None
            Reflectance of the detector, which then counts as one more surface, behind the others; None: it does not
            reflect.

        Returns
        -------
        list of Ghost
            Ghosts, n(n-1)/2 for n surfaces; those of a surface without reflectance have no power.

        Raises
        ------
        MistrayError
            If the number of reflectances is not that of the surfaces.
        """
        curvature, z, index = list(self.curvature), list(self.z), list(self.index)
        r = SHARE.check_each("reflectance", reflectance, "paraxial ghosts")
        if len(r) != len(self):
            raise MistrayError(f"paraxial ghosts: {len(r)} reflectances for {len(self)} surfaces; give one each")
        if image_reflectance is not None:
            curvature, z, index, r = [*curvature, 0.0], [*z, image_z], [*index, index[-1]], [*r, image_reflectance]
        last = len(self)
        ghosts = []
        for second in range(len(r)):
            for first in range(second + 1, len(r)):
                order = [*range(first + 1), *range(first - 1, second - 1, -1), *range(second + 1, last)]
                y, u, n, power, at = beam_radius_mm, 0.0, index[0], 1.0, z[0]
                for step, k in enumerate(order):
                    y, at = y + u * (z[k] - at), z[k]
                    bounce = step == first or step == 2 * first - second
                    onward = index[k + 1] if n > 0 else -index[k]
                    n_next = -n if bounce else onward
                    u = (n * u - y * curvature[k] * (n_next - n)) / n_next
                    power *= r[k] if bounce else 1 - r[k]
                    n = n_next
                y += u * (image_z - at)
                focus = math.inf if u == 0 else -y / u
                ghosts.append(Ghost(first, second, abs(y), focus, power))
        return ghosts


def chief_ray_angle(image_height: npt.ArrayLike, focal_length: float) -> npt.NDArray[np.float64]:
    """
    Return the field angle arctan(h'/f) of an image height without distortion, rad, -π/2 … π/2.

    Parameters
    ----------
    image_height : array_like
        Image height h', mm; the result has its shape.
    focal_length : float
        Focal length f ≠ 0, mm.
    """
    return np.arctan(np.asarray(image_height, dtype=np.float64) / focal_length)


def natural_illumination(angle: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """
    Return the relative illumination cos⁴θ of a thin lens with its stop: 0.83384 at 17.14°.

    The cosine-fourth law leaves out distortion, vignetting and aberrations of the pupil;
    `mistray.optimize.relative_illumination` includes them.

    Parameters
    ----------
    angle : array_like
        Field angle θ in object space, rad; the result has its shape.
    """
    return np.cos(np.asarray(angle, dtype=np.float64)) ** 4


def image_seen(
    y: npt.ArrayLike, u: npt.ArrayLike, chief_y: npt.ArrayLike, chief_u: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """
    Return distance and size of the detector's image as seen from surfaces, ISL and ISH, mm.

    Importance sampling aims at this image. ISL = -y/u' is the distance at which the marginal ray *after* the surface
    crosses the axis. ISH = |ȳ + ū' ISL| is the height of the chief ray there. The distance is negative for a virtual
    image.

    Parameters
    ----------
    y, u : (n,) array_like
        Marginal ray: height at each surface, mm, and slope after it.
    chief_y, chief_u : (n,) array_like
        Chief ray of the edge of the field: height at each surface, mm, and slope after it.

    Returns
    -------
    length, height : (n,) float64
        Distance from the vertex of each surface, and half size of the image, mm; ``inf`` for an image at infinity.
    """
    y, u, chief_y, chief_u = (np.asarray(values, dtype=np.float64) for values in (y, u, chief_y, chief_u))
    at_infinity = np.abs(u) <= COLLIMATED * np.abs(y)
    length = np.where(at_infinity, np.inf, -y / np.where(at_infinity, 1.0, u))
    height = np.where(at_infinity, np.inf, np.abs(chief_y + chief_u * np.where(at_infinity, 0.0, length)))
    return length, height

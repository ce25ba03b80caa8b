"""Plugin `sky`: a sky of uniform radiance, in all directions or within a cone, or with the radiance of a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.files.sky_picture import check_picture, is_healpix, read_healpix
from mistray.param import documented, fixed, take
from mistray.physics.geometry.healpix import pixel, sides
from mistray.plugins.emitters.distant_source import DistantSource
from mistray.plugins.emitters.light_source import LIGHT
from mistray.plugins.emitters.point_source import HALF_ANGLE_DEG
from mistray.ranges import POSITIVE, TEXT
from mistray.sampling.emission_laws import cone_height, cosine_power, direction, polar
from mistray.sampling.sky_map import SkyMap, environment

HEALPIX_ROWS = 4  # rings of a HEALPix map for each N
FINER = 2  # cells for each pixel of a picture, which is interpolated


@documented
class Sky(DistantSource):
    r"""
    Sky of given radiance (:monosp:`sky`): zodiacal light, a lit room or the inside of an integrating sphere.

    The radiance is uniform in all directions within ``half_angle_deg`` of the axis; 180 is a full sky, 90 half of it.
    The light in the middle travels along the axis, as for `collimated`.

    A picture of the whole sky, ``filename``, may replace it, around the scene as with Mitsuba's ``envmap``. Its width
    is the azimuth about y, its height the angle from +y. Its luminance times ``radiance`` is the radiance. Field angles
    do not rotate it; ``to_world`` does. A FITS file is a map in HEALPix. Its north is the z axis of ``to_world``, and
    its azimuth 0 the x axis.

    .. parameters::

    The flux of a trace is that through the sphere of radius R around the scene, radiance · Ω · π R² for a solid angle
    Ω. Mitsuba's ``constant`` is the same full sky, for Mitsuba's own integrators as well.

    .. code-block:: xml

        <emitter type="sky">
            <float name="radiance" value="1e-6"/>
            <float name="half_angle_deg" value="90"/>
        </emitter>

    .. code-block:: python

        {"type": "sky", "radiance": 2.5e-9}
    """

    numbers = {"half_angle_deg": fixed("degree", HALF_ANGLE_DEG, "half angle of the cone that it fills", 180.0)}
    properties = {
        "filename": fixed(
            "string",
            TEXT,
            "picture of the sky, such as an .exr, twice as wide as high; or a HEALPix map, .fits",
            None,
            within="a picture",
        ),
        "radiance": fixed("W/mm²/sr", POSITIVE, "radiance of the sky, or of a picture where it is 1", 1.0),
        **numbers,
        **LIGHT,
    }
    densities = ("radiance",)

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.picture: SkyMap | None = None
        if "filename" not in props:
            return
        if "half_angle_deg" in props or "field_deg" in props or "azimuth_deg" in props:
            self._fail("filename is given with half_angle_deg, field_deg or azimuth_deg; turn a picture by to_world")
        file = str(mi.file_resolver().resolve(take(self, props, "filename")))
        if is_healpix(file):
            values, nested = read_healpix(file, self.owner)
            side = sides(len(values))
            if not side or (nested and side & (side - 1)):
                self._fail(f"filename '{file}' has {len(values)} pixels; 12 N² are a whole sky")
            # Light comes from the pixels in the opposite direction
            self.lay(lambda d: values[pixel(side, -d, nested)], HEALPIX_ROWS * side)
            return
        check_picture(file, self.owner)
        try:
            around = mi.load_dict({"type": "envmap", "filename": file})
        except RuntimeError:
            self._fail(f"filename '{file}' is not a picture; give an .exr, .hdr or .png")
        height = mi.traverse(around)["data"].shape[0]
        self.lay(environment(around), height)

    def lay(self, radiance: Callable[[np.ndarray], np.ndarray], height: int) -> None:
        """
        Set the relative radiance of the sky from a picture of `height` rows.

        `radiance` maps unit vectors along which the light travels, (n, 3), in the frame of ``to_world``, to relative
        radiances, (n,). Raise `MistrayError` if the picture is dark.
        """
        self.picture = SkyMap(radiance, FINER * height)
        if not 0 < self.picture.irradiance < np.inf:
            self._fail(f"the picture has a mean radiance of {self.picture.irradiance:g}; give one with light")

    def frame(self, field_deg: float | None = None, azimuth_deg: float | None = None) -> tuple[np.ndarray, ...]:
        """Return the position and axes of the sky, see `LightSource.frame`; a picture does not turn with the field."""
        return super().frame(field_deg, azimuth_deg) if self.picture is None else super().frame(0.0, 0.0)

    @property
    def solid_angle(self) -> float:
        """Solid angle of the cone, sr; for a picture the integral ∫ L dΩ at ``radiance`` 1."""
        if self.picture is not None:
            return self.picture.irradiance
        return float(4 * np.pi * np.sin(np.radians(self.values["half_angle_deg"]) / 2) ** 2)

    def directions(self, sample: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        if self.picture is not None:
            return self.picture.directions(sample)
        square, cosine, sine = polar(sample)
        edge = cone_height(dr.deg2rad(n["half_angle_deg"]))
        return direction(cosine_power(square, mi.Float64(0), edge), cosine, sine)


mi.register_emitter("sky", lambda props: Sky(props))

"""Plugin `probe`: light that crosses a rectangle anywhere in a scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.param import OBJECT, documented, fixed, take
from mistray.plugins.sensors.passing_sensor import FRAME, PassingSensor
from mistray.ranges import FILM_SIDE, SIZE_MM
from mistray.recorders.flux_maps.probe import Probe
from mistray.surfaces.surfaces import film_size

PIXELS = 64  # pixels along each side without a film


@documented
class ProbeSensor(PassingSensor):
    r"""
    Probe (:monosp:`probe`): records the light that crosses a rectangle, and lets it pass.

    It belongs at the top level of the scene, not in a shape. The rectangle is in the plane of x and y of its frame, and
    light that travels towards its +z counts. A second probe with its frame reversed records light in the other
    direction. Each `mistray.trace` of the scene has a `mistray.recorders.Probe` under the id of the sensor, with
    irradiance and radiance. ``mi.render`` with the ``straylight`` integrator gives the irradiance (height, width, 1) in
    W/mm², row 0 at the smallest y. With Mitsuba's own integrators the probe is like an irradiance meter at its
    position.

    .. parameters::

    None of these is differentiable. Traces by workers refuse scenes with probes.

    .. code-block:: xml

        <sensor type="probe" id="behind the stop">
            <float name="half_width" value="20"/>
            <float name="half_height" value="20"/>
            <film type="hdrfilm">
                <integer name="width" value="32"/>
                <integer name="height" value="32"/>
            </film>
            <transform name="to_world"><translate z="17"/></transform>
        </sensor>

    .. code-block:: python

        {"type": "probe", "half_width": 20.0, "to_world": mi.ScalarTransform4f().translate([0, 0, 17])}
    """

    what = "probe"
    filmed = True
    properties = {
        "half_width": fixed("mm", SIZE_MM, "half of the rectangle along x", 1.0),
        "half_height": fixed("mm", SIZE_MM, "half of the rectangle along y", 1.0),
        "directions": fixed(
            "1", FILM_SIDE, "cells along x and y, uniform in the direction cosines, for the radiance; 1: no radiance", 1
        ),
        **FRAME,
        "(nested) film": fixed("film", OBJECT, "pixels of the rectangle", otherwise=f"{PIXELS} × {PIXELS}"),
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.half = take(self, props, "half_width"), take(self, props, "half_height")
        self.directions = take(self, props, "directions")
        self.pixels = film_size(self.film(), self.owner) if self.has_film else (PIXELS, PIXELS)
        self.recorder()  # refuses what a probe cannot be

    def recorder(self) -> Probe:
        """Return a new recorder of the probe, see `PassingSensor.recorder`."""
        return Probe(
            self.name,
            self.matrix[:3, 3].tolist(),
            normal=self.matrix[:3, 2].tolist(),
            half_width=self.half[0],
            half_height=self.half[1],
            pixels=self.pixels,
            directions=self.directions,
            up=self.matrix[:3, 1].tolist(),
        )

    def sample_ray(
        self,
        time: mi.Float,
        wavelength_sample: mi.Float,
        position_sample: mi.Point2f,
        aperture_sample: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Color3f]:
        """
        Return a ray from a random point of the rectangle back along its light, and its weight.

        Directions follow the cosine law. The weight is π times that of the sampled wavelengths.
        """
        right, up, normal = (mi.Vector3f(*map(float, axis)) for axis in self.matrix[:3, :3].T)
        centre = mi.Point3f(*map(float, self.matrix[:3, 3]))
        x, y = ((2 * s - 1) * half for s, half in zip(position_sample, self.half, strict=True))
        back = mi.warp.square_to_cosine_hemisphere(aperture_sample)
        wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength_sample, active)
        ray = mi.Ray3f(centre + x * right + y * up, back.x * right + back.y * up - back.z * normal, time, wavelengths)
        return ray, weight * dr.pi

    def sample_ray_differential(self, *samples: Any, **more: Any) -> tuple[mi.RayDifferential3f, mi.Color3f]:
        """Return the ray of `sample_ray`, without differentials."""
        ray, weight = self.sample_ray(*samples, **more)
        return mi.RayDifferential3f(ray), weight


mi.register_sensor("probe", lambda props: ProbeSensor(props))

"""
Conversion of Mitsuba's own emitters into sources of a trace that emit the same light.

A colour stands for its luminance, which for a plain number is that number. It is in W/sr of a ``point`` and on the axis
of a ``spot``, in W/mm²/sr of an ``area`` or ``constant``, and in W/mm² across a ``directional``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.kernel.lobes import from_local
from mistray.sampling.emission_laws import cosine_power, direction, polar
from mistray.sampling.outlines import area_of
from mistray.sampling.sky_map import environment
from mistray.sampling.source import EmittedRays, SceneSource, SourceRequest
from mistray.spectra.spectrum import DEFAULT_NM

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])  # of linear sRGB, as `mi.luminance`
DISTANT_DEG = 1e-9  # angular diameter that stands for that of a single direction


class AreaLight:
    """
    Source for Mitsuba's ``area`` emitter: a shape whose outside is Lambertian and of uniform radiance.

    It has the attributes and methods of `mistray.plugins.emitters.light_source.LightSource` that a trace uses. Its
    `radiance` is in W/mm²/sr.
    """

    extended: ClassVar[bool] = True
    precise: ClassVar[bool] = False
    states_light: ClassVar[bool] = False
    differentiable: ClassVar[tuple[str, ...]] = ()
    values: ClassVar[Mapping[str, float]] = {}
    parameters: ClassVar[Mapping[str, mi.Float]] = {}

    def __init__(self, emitter: mi.Emitter) -> None:
        self.shape = emitter.get_shape()
        self.name = self.shape.id()
        self.radiance = _value(mi.traverse(emitter), "radiance", f"shape '{self.name}', its area emitter")
        self.field_deg = self.azimuth_deg = 0.0
        self.matrix = np.eye(4)
        self.wavelengths_nm, self.weights = np.array([DEFAULT_NM]), np.ones(1)

    def power(self, field_deg: float | None = None) -> float:
        """Return the emitted flux, W: π · radiance · area. The field angle has no effect."""
        return np.pi * self.radiance * area_of(self.shape)

    def field_of(self, height_mm: float) -> float:
        """Raise `MistrayError`: there is no object plane, in which heights would be field angles."""
        raise MistrayError(f"shape '{self.name}': its area emitter has no object plane; leave field_mm out")

    def edge_samples(self, count: int, within: float) -> np.ndarray | None:
        """Return None: the light has no edge."""
        return None

    def sources(self, request: SourceRequest) -> Sequence[SceneSource]:
        """Return the sources of start rays of a trace, one for each wavelength."""
        # The rays are in the world already, so that the axes are those of the world
        axes = np.eye(3)
        return [
            EmittedRays(
                emitter=self,
                name=request.name,
                wavelength_nm=float(wavelength),
                power=self.power() * share,
                pivot=np.zeros(3),
                direction=axes[2],
                u=axes[0],
                v=axes[1],
                scene=request.scene,
                shape=self.name,
            )
            for wavelength, share in zip(request.wavelengths_nm, request.weights, strict=True)
        ]

    def rays_from(
        self, place: mi.Point2f, sample: mi.Point2f, rng: mi.PCG32, n: Mapping[str, mi.Float]
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """
        Return ray origins, mm, uniform over the shape, and Lambertian unit directions, in the world.

        They follow from the points `place` and `sample` of the unit square; `rng` and `n` are ignored.
        """
        found = self.shape.sample_position(0.0, place)
        square, cosine, sine = polar(sample)
        local = direction(cosine_power(square, mi.Float(1), mi.Float(1)), cosine, sine)
        return mi.Vector3f(found.p), from_local(local, mi.Vector3f(found.n))

    def density(self, place: mi.Point2f, d: mi.Vector3d, n: Mapping[str, mi.Float]) -> mi.Float64:
        """Return the pdf cos θ/π, 1/sr, of emission along d from the origin of `place`, see `rays_from`; 0 inward."""
        # Lambertian: cos θ/π; the same place gives the point that `rays_from` starts at
        normal = mi.Vector3d(self.shape.sample_position(0.0, place).n)
        return dr.maximum(dr.dot(d, normal), 0) / dr.pi


def _value(params: Any, key: str, owner: str) -> float:
    """Return a parameter of one of Mitsuba's own emitters, a colour as its luminance; `MistrayError` for a texture."""
    found = np.array(params.get(f"{key}.value", np.nan), dtype=np.float64).ravel()
    value = float(LUMINANCE @ found) if len(found) == len(LUMINANCE) else float(found[0])
    if len(found) not in (1, len(LUMINANCE)) or not np.isfinite(value):
        raise MistrayError(f"{owner}: {key} is a texture or a spectrum with many values; give one number")
    return value


def _point(params: Any, owner: str) -> dict[str, Any]:
    """Return the parameters of a ``point_source`` that replaces Mitsuba's ``point``; intensity, W/sr, position, mm."""
    place = dict(zip("xyz", np.array(params["position"], dtype=np.float64).ravel().tolist(), strict=True))
    return {"type": "point_source", **place, "intensity": _value(params, "intensity", owner)}


def _spot(params: Any, owner: str) -> dict[str, Any]:
    """Return parameters of a ``point_source`` with the intensity, W/sr, of a ``spot``; `MistrayError` for a texture."""
    cutoff, beam = (float(np.array(params[key]).ravel()[0]) for key in ("cutoff_angle", "beam_width"))
    if not np.allclose(np.array(params["texture.value"]), 1.0):
        raise MistrayError(f"{owner}: it has a texture; leave it out")
    # Mitsuba's falloff is linear in the angle from the beam width to the cutoff. The light may also have a sharp edge,
    # or fall off from its axis
    profile = ["0:1"] + [f"{beam!r}:1"] * (beam > 0) + [f"{cutoff!r}:0"] * (cutoff > beam)
    return {
        "type": "point_source",
        "to_world": params["to_world"],
        "intensity": _value(params, "intensity", owner),
        "profile": ", ".join(profile),
    }


def _constant(params: Any, owner: str) -> dict[str, Any]:
    """Return the parameters of a ``sky`` that replaces Mitsuba's ``constant`` emitter; its radiance is in W/mm²/sr."""
    return {"type": "sky", "radiance": _value(params, "radiance", owner)}


def _directional(params: Any, owner: str) -> dict[str, Any]:
    """Return parameters of a ``distant_disc``, practically a point, for ``directional``; irradiance in W/mm²."""
    irradiance = _value(params, "irradiance", owner)
    return {
        "type": "distant_disc",
        "diameter_deg": DISTANT_DEG,
        "irradiance": irradiance,
        "to_world": params["to_world"],
    }


# By the name of Mitsuba's class
KNOWN: Mapping[str, Callable[[Any, str], dict[str, Any]]] = {
    "PointLight": _point,
    "SpotLight": _spot,
    "ConstantBackgroundEmitter": _constant,
    "DirectionalEmitter": _directional,
}


def mitsuba_source(emitter: mi.Emitter, number: int) -> Any:
    """
    Return a source that emits the same light as one of Mitsuba's own emitters.

    Messages call an emitter without an id by its `number` in the scene.

    Raises
    ------
    MistrayError
        If there is no such source, or the emitter has a texture.
    """
    # Kinds that need the emitter itself. Its class, or the name that it prints where Python sees the base class only
    kind = type(emitter).__name__ if type(emitter).__name__ in KNOWN else str(emitter).split("[")[0].strip()
    if kind == "AreaLight":
        return AreaLight(emitter)
    owner = f"source '{emitter.id()}'" if emitter.id() else f"source {number}"
    if kind == "EnvironmentMapEmitter":
        # A sky in the frame of the world
        sky = mi.load_dict({"type": "sky"})
        sky.owner, sky.name = owner, emitter.id()
        sky.lay(environment(emitter), mi.traverse(emitter)["data"].shape[0])
        return sky
    if kind not in KNOWN:
        raise MistrayError(
            f"{owner}: a trace takes no {kind} of Mitsuba; use point, spot, area, constant, envmap or directional, or "
            "a source of mistray (docs/sources.md)"
        )
    # Others by their parameters; `load_dict` takes scalar transforms only
    given = KNOWN[kind](mi.traverse(emitter), owner)
    matrix = given.get("to_world")
    if matrix is not None:
        given["to_world"] = mi.ScalarTransform4f(np.array(matrix.matrix, dtype=np.float64).reshape(4, 4))
    if emitter.id():
        given["id"] = emitter.id()
    # An emitter without an id keeps an empty name, so that tables number it
    source = mi.load_dict(given)
    source.name = emitter.id()
    return source

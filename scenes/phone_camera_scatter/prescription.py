"""Phone camera with scatter: polish of the optics, particles on everything, black structure."""

from __future__ import annotations

from dataclasses import replace

from mistray.prescription import Prescription, Scatter, Structure, Surface
from mistray.scenes.phone_camera.prescription import build as build_camera

POLISH = Scatter("harvey_shack", {"rms_nm": 4.0, "l": 0.01, "s": -1.5}, name="polish_4nm")
BLACK = Scatter("paint", {"preset": "flat_black"}, name="flat_black")
INSIDE = Scatter("particulate", {"level": 300.0}, name="particles_300")
OUTSIDE = Scatter("particulate", {"level": 400.0}, name="particles_400")
OUTER_FACES = ("window_front", "barrel_0_recess", "barrel_0_front_face")


def build() -> Prescription:
    """The camera of `mistray.scenes.phone_camera` with the scatter models of the study's Tables 12 and 13."""
    camera = build_camera()
    scattering = camera.with_scatter({shape.name: _models(shape) for shape in camera.shapes()})
    return replace(
        scattering,
        name=f"{camera.name}, with scatter",
        provenance="The scene phone_camera and its scatter; see SOURCE.md.",
    )


def _models(shape: Surface | Structure) -> tuple[Scatter, ...]:
    """Particles on every face; polish on those that light crosses, black on the structure, nothing on the detector."""
    particles = OUTSIDE if shape.name in OUTER_FACES else INSIDE
    if shape.name == "detector":
        return (particles,)
    opaque = shape.coating is not None and shape.coating.opaque
    return (BLACK if opaque else POLISH, particles)

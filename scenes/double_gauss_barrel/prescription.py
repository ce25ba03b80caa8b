"""Double Gauss in a blackened barrel with a hood; surfaces scatter."""

from __future__ import annotations

from dataclasses import replace

from mistray.prescription import Coating, Prescription, Scatter, Structure, Surface
from mistray.scenes.double_gauss.prescription import build as build_lens

HOOD_RADIUS, HOOD_Z = 18.0, -12.0

AR = Coating(R=0.005, T=0.995)
BLACK = Coating(R=0.0)
POLISH = Scatter("harvey_shack", {"rms_nm": 2.0, "l": 0.01, "s": -1.5}, name="polish_2nm")
PAINT = Scatter("paint", {"reflectance": 0.05}, name="black_paint")
PAINT_INSIDE = Scatter("paint", {"reflectance": 0.05, "side": "front"}, name="black_paint_inside")


def build() -> Prescription:
    """The lens of `mistray.scenes.double_gauss`, coated, every opaque face Lambertian, behind a short hood."""
    bare = build_lens()
    inside = {"coating": BLACK, "scatter": (PAINT_INSIDE,), "space": 0}
    hood = Structure("hood", HOOD_RADIUS, HOOD_Z, HOOD_RADIUS, bare.surfaces[0].rim[1], **inside)
    assert bare.stop is not None
    return replace(
        bare,
        name=f"{bare.name}, in a black barrel",
        surfaces=tuple(_glass(surface) for surface in bare.surfaces),
        structures=(hood, *(_black(shape) for shape in bare.structures)),
        stop=replace(bare.stop, coating=BLACK, scatter=(PAINT,)),
        provenance="The scene double_gauss, its coatings and scatter; see SOURCE.md.",
    )


def _glass(surface: Surface) -> Surface:
    """With polish, and with a coating where it bounds air; cemented faces stay bare and scatter little."""
    in_air = "air" in (surface.front, surface.back)
    return replace(surface, coating=AR if in_air else None, scatter=(POLISH,))


def _black(shape: Structure | Surface) -> Structure | Surface:
    """With the paint: on the inside only of a wall, whose outside nothing meets."""
    return replace(shape, coating=BLACK, scatter=(PAINT_INSIDE if _is_wall(shape) else PAINT,))


def _is_wall(shape: Structure | Surface) -> bool:
    return isinstance(shape, Structure) and shape.z0 != shape.z1

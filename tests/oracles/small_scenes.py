"""XML texts of small scenes, for the oracles and for the program under test alike."""

from pathlib import Path
from typing import Any

from .geometry import Asphere

# rear of the second lens of the phone camera: rim slope 2.07, the conic part ends at r = 1.118 mm
STEEP_REAR = Asphere(
    1 / 3.482, 8.701, ((2, 0.00521579), (3, 0.0715829), (4, -0.0460926), (5, 0.012431), (6, 0.0332216)), 1.06523826
)

TAGS = {float: "float", int: "integer", bool: "boolean", str: "string"}


def interface_xml(front: str = "air", back: str = "air", **more: float | str) -> str:
    """A nested ``interface`` with the materials of its two sides and R, T, table or mirror."""
    values = {"front": front, "back": back, **more}
    items = [f'<{TAGS[type(v)]} name="{k}" value="{str(v).lower() if v is True else v}"/>' for k, v in values.items()]
    return f'<bsdf type="interface">{"".join(items)}</bsdf>'


def meter_xml(pixels: int) -> str:
    film = f'<film type="hdrfilm"><integer name="width" value="{pixels}"/><integer name="height" value="{pixels}"/>'
    return f'<sensor type="irradiancemeter">{film}<rfilter type="box"/></film></sensor>'


def shape_xml(
    kind: str, shape_id: str, z: float = 0.0, bsdf: str | None = None, sensor: bool = False, **numbers: float
) -> str:
    """A shape at z mm with float parameters, an interface (opaque and black by default) and perhaps the detector."""
    floats = "".join(f'<float name="{key}" value="{value!r}"/>' for key, value in numbers.items())
    place = f'<transform name="to_world"><translate z="{z!r}"/></transform>'
    meter = meter_xml(64) if sensor else ""
    surface = interface_xml(R=0.0) if bsdf is None else bsdf
    return f'<shape type="{kind}" id="{shape_id}">{floats}{place}{surface}{meter}</shape>'


def scene_text(*shapes: str, radius: float = 1.0, **light: float | str) -> str:
    """A scene with an on-axis collimated source of the given radius (mm) about the origin and 1 W/mm^2."""
    items = "".join(f'<{TAGS[type(v)]} name="{k}" value="{v}"/>' for k, v in {"radius": radius, **light}.items())
    source = f'<emitter type="collimated">{items}</emitter>'
    return f'<scene version="3.0.0"><integrator type="straylight"/>{source}{"".join(shapes)}</scene>'


def plates_text(number: int, index: str = "1.5", **coating: Any) -> str:
    """N plates p0 … in air, 5 mm thick, 10 mm apart, with a black detector behind; surfaces p0_front, p0_rear, …"""
    shapes = []
    for i in range(number):
        for face, dz, before, behind in (("front", 0.0, "air", index), ("rear", 5.0, index, "air")):
            bsdf = interface_xml(before, behind, **coating)
            shapes.append(shape_xml("asphere", f"p{i}_{face}", 10.0 * i + dz, bsdf, semi_diameter=50.0))
    shapes.append(shape_xml("asphere", "detector", 10.0 * number, sensor=True, half_width=50.0, half_height=50.0))
    return scene_text(*shapes)


def write(folder: Path, content: str | bytes, name: str = "scene.xml") -> Path:
    """A file of a folder, which is made where there is none."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path

"""XML texts of surfaces that scatter, of targets, and of small scenes with them."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence

from .scene_xml import SceneModel
from .small_scenes import TAGS, interface_xml, meter_xml

Vector = Sequence[float]


def bsdf_xml(kind: str, **values: float | str) -> str:
    items = "".join(f'<{TAGS[type(v)]} name="{k}" value="{v!s}"/>' for k, v in values.items())
    return f'<bsdf type="{kind}">{items}</bsdf>'


def scattering_xml(models: Sequence[str], front: str = "air", back: str = "air", **more: float | str) -> str:
    return interface_xml(front, back, **more).removesuffix("</bsdf>") + "".join(models) + "</bsdf>"


def diffuser_xml(share: float = 1.0) -> str:
    """A thin sheet that scatters a share of the light from the front as a Lambertian and passes the rest."""
    return scattering_xml(
        [bsdf_xml("paint", reflectance=share, side="front", event="transmission", relative_to="specular")], R=0.0, T=1.0
    )


def wall_xml(rho: float) -> str:
    return scattering_xml([bsdf_xml("paint", reflectance=rho)], R=0.0)


def placed_xml(
    kind: str,
    shape_id: str,
    bsdf: str | None = None,
    *,
    at: Vector = (0.0, 0.0, 0.0),
    facing: Vector = (0.0, 0.0, 1.0),
    scale: Vector | None = None,
    pixels: int = 0,
    **numbers: float,
) -> str:
    """A shape at a point in mm with its local z along ``facing``; with ``pixels`` it is the detector."""
    floats = "".join(f'<float name="{key}" value="{value!r}"/>' for key, value in numbers.items())
    up = "1, 0, 0" if abs(facing[1]) > 0.9 * sum(c * c for c in facing) ** 0.5 else "0, 1, 0"
    size = "" if scale is None else f'<scale value="{_list(scale)}"/>'
    surface = interface_xml(R=0.0) if bsdf is None else bsdf
    meter = meter_xml(pixels) if pixels else ""
    return f'<shape type="{kind}" id="{shape_id}">{floats}{_look(at, facing, up, size)}{surface}{meter}</shape>'


def _list(numbers: Vector) -> str:
    return ", ".join(repr(float(number)) for number in numbers)


def _look(at: Vector, along: Vector, up: str, before: str = "") -> str:
    target = _list([float(a) + float(b) for a, b in zip(at, along, strict=True)])
    return f'<transform name="to_world">{before}<lookat origin="{_list(at)}" target="{target}" up="{up}"/></transform>'


def target_xml(shape_id: str, surfaces: str, kind: str = "disk", **place: object) -> str:
    return placed_xml(kind, shape_id, bsdf_xml("target", surfaces=surfaces), **place)  # type: ignore[arg-type]


def beam_xml(
    radius: float,
    *,
    power: float | None = None,
    at: Vector = (0.0, 0.0, 0.0),
    along: Vector = (0.0, 0.0, 1.0),
    **numbers: float,
) -> str:
    """A collimated source whose axis passes through ``at``; of 1 W/mm^2 or of ``power`` in W."""
    values = dict(numbers)
    if power is not None:
        values["irradiance"] = power / (3.141592653589793 * radius**2)
    floats = "".join(f'<float name="{key}" value="{value!r}"/>' for key, value in (("radius", radius), *values.items()))
    return f'<emitter type="collimated">{floats}{_look(at, along, "0, 1, 0")}</emitter>'


def scatter_scene(*parts: str) -> str:
    return f'<scene version="3.0.0"><integrator type="straylight"/>{"".join(parts)}</scene>'


def without_scatter(text: str) -> str:
    """A scene's XML less the models of scatter in its interfaces, nested or by reference."""
    root = ElementTree.fromstring(text)
    kinds = {node.attrib["id"]: node.attrib["type"] for node in root.iter("bsdf") if "id" in node.attrib}
    for interface in list(root.iter("bsdf")):
        for part in list(interface):
            kind = part.attrib["type"] if part.tag == "bsdf" else kinds.get(part.attrib.get("id", ""))
            if part.tag in ("bsdf", "ref") and kind is not None and kind != "thinfilm":
                interface.remove(part)
    return ElementTree.tostring(root, encoding="unicode")


def with_scatter(text: str, models: Mapping[str, Sequence[str]]) -> str:
    """A scene's XML with models of scatter added to the interfaces of some shapes, by shape id."""
    root = ElementTree.fromstring(text)
    for shape in root.iter("shape"):
        added = models.get(shape.attrib["id"], ())
        own = shape.find("bsdf")
        if added and (own is None or own.attrib["type"] != "interface"):
            raise ValueError(f"{shape.attrib['id']} has no interface of its own")
        for model in added:
            own.append(ElementTree.fromstring(model))
    return ElementTree.tostring(root, encoding="unicode")


def rough_and_painted(text: str, model: SceneModel, optics: Sequence[str], structure: Sequence[str]) -> str:
    """A shipped scene with these models on its optical surfaces (what transmits, and mirrors) and on all others."""
    models = {}
    for shape in model.shapes:
        optical = shape.interface.mirror or not shape.interface.opaque
        models[shape.shape_id] = optics if optical else structure
    return with_scatter(without_scatter(text), models)


def tube_text(length: float, rho: float) -> str:
    """A diffuse tube of radius 1 between a diffuser with pi W, its entrance, and a black detector, its end."""
    return scatter_scene(
        beam_xml(1.0),
        placed_xml("asphere", "entrance", diffuser_xml(), semi_diameter=1.0),
        placed_xml("frustum", "wall", wall_xml(rho), r0=1.0, z0=0.0, r1=1.0, z1=length),
        placed_xml("asphere", "detector", at=(0.0, 0.0, length), pixels=16, semi_diameter=1.0),
    )


def sphere_text(rho: float, port: float) -> str:
    """A diffuse sphere of radius 10, the detector before a cap of this area fraction; pi W hit the wall first."""
    cosine = 1 - 2 * port
    disc = {"semi_diameter": 10 * (1 - cosine**2) ** 0.5}
    return scatter_scene(
        beam_xml(1.0, along=(0.0, 0.0, -1.0), distance=0.5),
        placed_xml("sphere", "wall", wall_xml(rho), radius=10.0),
        placed_xml("asphere", "detector", at=(0.0, 0.0, 10 * cosine), pixels=16, **disc),
    )


def discs_text(r1: float, r2: float, distance: float, offset: float = 0.0, half_size: float = 0.0) -> str:
    """A diffuser of radius r1, 1 W/mm^2, and behind it a disc of radius r2 or a square off the axis, the detector."""
    shape = {"half_width": half_size, "half_height": half_size} if half_size else {"semi_diameter": r2}
    return scatter_scene(
        beam_xml(r1),
        placed_xml("asphere", "source", diffuser_xml(), semi_diameter=r1),
        placed_xml("asphere", "detector", at=(offset, 0.0, distance), pixels=16, **shape),
    )


def lenses_text(*models: str, wall: str | None = None) -> str:
    """Two coated lenses with models of scatter on all their surfaces in a tube (black by default), a wide detector."""
    faces = [("a_front", 0.0, 30.0, "air", "1.6"), ("a_rear", 4.0, -40.0, "1.6", "air")]
    faces += [("b_front", 8.0, -50.0, "air", "1.7"), ("b_rear", 10.0, 60.0, "1.7", "air")]
    shapes = []
    for name, z, radius, *media in faces:
        coated = scattering_xml(models, *media, R=0.1, T=0.85)
        shapes.append(placed_xml("asphere", name, coated, at=(0.0, 0.0, z), radius=radius, semi_diameter=6.0))
    return scatter_scene(
        beam_xml(4.0, field_deg=4.0),
        *shapes,
        placed_xml("frustum", "tube", wall, r0=6.5, z0=-3.0, r1=6.5, z1=30.0),
        placed_xml("asphere", "detector", at=(0.0, 0.0, 30.0), pixels=16, half_width=4.0, half_height=4.0),
    )

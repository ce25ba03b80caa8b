"""Generators of the mechanical faces that close a system: lens edges, bevels, barrels, and detector frames.

In a closed system no ray can leave a lens body sideways or slip past a lens. An opaque wall, of the mount or of the
barrel, stands between the rims of consecutive surfaces. Closing a lens group in this way has the same effect as
clipping at the rims, and the clipped light is recorded on a named surface. All generators expect coaxial surfaces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from mistray.errors import MistrayError
from mistray.materials.spec import GAS_INDEX
from mistray.named_values import number_of
from mistray.physics.geometry.outline import Outline, circle, rectangle
from mistray.physics.geometry.sag import conic_end
from mistray.prescription.coating import Coating
from mistray.prescription.model import Detector, Stop, Structure, Surface
from mistray.ranges import PLACE_MM, RADIUS_MM, Each, OfType, Several, several, shown

Point = tuple[float, float]
"""(r, z) of a profile, mm."""
POINT = Each(PLACE_MM, 2)
ITEMS = Several(OfType(Surface | Stop, "must be a Surface or a Stop, or several"), least=0)

ABSORBER = Coating(R=0.0)

_SAMPLES = 257
_TOLERANCE_MM = 1e-9
_AROUND = 1.001  # radius of a face around its outline by that of the outline, so that corners lie within


def wall(
    name: str,
    points: Sequence[Point],
    *,
    coating: Coating | None = ABSORBER,
    part: str | None = None,
    space: int = -1,
    front: str = "air",
    back: str = "air",
) -> tuple[Structure, ...]:
    """
    Return frusta along a profile; zero-length pieces are left out.

    Parameters
    ----------
    name : str
        Name of the only piece; several are numbered from 1: ``name_1``, ``name_2``, ….
    points : sequence of (r, z)
        Points (r, z) of the profile, at least two, mm.
    coating, part, space, front, back
        Attributes of each piece, as in `Structure`.

    Returns
    -------
    tuple of Structure
        Frusta in the order of the profile.

    Raises
    ------
    MistrayError
        If there are fewer than two points, a piece has no area, such as one along the axis, or a value is not allowed.

    Examples
    --------
    >>> paint = mistray.Coating(R=0.03)
    >>> wall = mistray.prescription.wall("tube", [(30, -100), (30, 0), (25, 0)], coating=paint)
    >>> [(face.name, face.r1) for face in wall]
    [('tube_1', 30), ('tube_2', 25)]
    """
    profile = several(points)
    Several(POINT).check("points", profile, f"wall '{name}'")
    if len(profile) < 2:
        raise MistrayError(f"wall '{name}': points are {shown(profile)}; give two at least, (r, z) each, mm")
    pieces = [(a, b) for a, b in pairwise(map(tuple, profile)) if a != b]
    return tuple(
        Structure(
            name if len(pieces) == 1 else f"{name}_{k}",
            *a,
            *b,
            coating=coating,
            part=part,
            space=space,
            front=front,
            back=back,
        )
        for k, (a, b) in enumerate(pieces, start=1)
    )


def lens_edge(
    first: Surface,
    second: Surface,
    rim_radius: float | None = None,
    *,
    part: str | None = None,
    coating: Coating | None = ABSORBER,
    bevel_coating: Coating | None = None,
    contact_radii: tuple[float | None, float | None] = (None, None),
    outside: str | None = None,
) -> tuple[Structure, ...]:
    """
    Return the edge cylinder and the flat rings that close a lens body between its two surfaces.

    Each ring is split where the mount begins to touch it. Inside this radius it is a bevel between the glass and the
    medium outside; beyond it is a flange in contact, with the coating of the edge. If a `sag` makes a rim uneven, the
    edge reaches from the lowest point of the first rim to the highest of the second.

    Parameters
    ----------
    first, second : Surface
        Front and rear of the body; ``first.back`` is its glass.
    rim_radius : float or None
        Radius of the edge, mm; ``None``: the larger clear radius.
    part : str or None
        Name of the lens body; ``None``: that of ``first``.
    coating : Coating or None
        Coating of the edge and the flanges, which touch the mount; by default a perfect absorber. ``None``: bare
        Fresnel interface.
    bevel_coating : Coating or None
        Coating of the visible bevels; ``None``: bare Fresnel interface.
    contact_radii : tuple of two float or None
        Radii at which the mount begins on the front and on the rear ring, mm; ``None``: at the clear radius, so that no
        bevel is visible.
    outside : str or None
        Material around the edge; ``None``: the gas in front of the body or behind it, air if there is none.

    Returns
    -------
    tuple of Structure
        Faces ``<part>_bevel_1``, ``<part>_flange_1``, ``<part>_edge``, ``<part>_flange_2`` and ``<part>_bevel_2``,
        without faces of zero width. Between a ring and an uneven rim is a cylinder ``<part>_step_1`` or ``_step_2``.

    Raises
    ------
    MistrayError
        If the materials of the two surfaces differ, a contact radius does not lie between clear radius and edge, the
        edge has no thickness, or a ring would cut into a surface.

    Examples
    --------
    >>> front = mistray.Surface("L1_front", radius=50, semi_diameter=10, back="N-BK7", part="L1")
    >>> rear = mistray.Surface("L1_rear", z=5, radius=-50, semi_diameter=9, front="N-BK7", part="L1")
    >>> [face.name for face in mistray.prescription.lens_edge(front, rear, 10.5)]
    ['L1_flange_1', 'L1_edge', 'L1_flange_2']
    """
    part = part or first.part or first.name
    glass = _shared_material(first, second)
    rim = max(first.outer_radius, second.outer_radius) if rim_radius is None else rim_radius
    ends = []
    contacts = several(contact_radii)
    if len(contacts) != 2:
        raise MistrayError(f"part '{part}': contact_radii is {shown(contact_radii)}; give two, each a number or None")
    for contact in contacts:
        RADIUS_MM.check_all(f"part '{part}'", contact_radii=contact)
    steps: list[Structure] = []
    # Of an uneven rim the end that makes the body longer, so that no light gets out between
    for number, (surface, contact) in enumerate(zip((first, second), contacts, strict=True), start=1):
        clear, heights = surface.outer_radius, surface.rim_heights
        z = heights[number - 1]
        touch = clear if contact is None else contact
        if not clear <= touch <= rim:
            raise MistrayError(
                f"part '{part}': contact radius {touch:g} mm at surface '{surface.name}'; it must lie between "
                f"the clear radius {clear:g} mm and the edge radius {rim:g} mm"
            )
        ends.append((clear, touch, z))
        if clear < rim:
            points = [(clear, height) for height in heights]
            steps += wall(f"{part}_step_{number}", points, coating=coating, part=part, front=glass, back=glass)
    (clear_1, touch_1, z_1), (clear_2, touch_2, z_2) = ends
    if z_2 <= z_1:
        raise MistrayError(
            f"part '{part}': edge thickness {z_2 - z_1:.4g} mm between '{first.name}' and '{second.name}'; make it "
            "thicker or smaller"
        )
    _check_clear(first, second.name, (clear_2, z_2), (rim, z_2), above=True)
    _check_clear(second, first.name, (clear_1, z_1), (rim, z_1), above=False)

    def ring(
        face: str, inner: float, outer: float, z: float, sides: tuple[str, str], own: Coating | None
    ) -> tuple[Structure, ...]:
        return wall(f"{part}_{face}", [(inner, z), (outer, z)], coating=own, part=part, front=sides[0], back=sides[1])

    before, after = (first.front, glass), (glass, second.back)
    around = gas_of(first.front, second.back) if outside is None else outside
    return (
        *ring("bevel_1", clear_1, touch_1, z_1, before, bevel_coating),
        *ring("flange_1", touch_1, rim, z_1, before, coating),
        *wall(f"{part}_edge", [(rim, z_1), (rim, z_2)], coating=coating, part=part, front=glass, back=around),
        *ring("flange_2", touch_2, rim, z_2, after, coating),
        *ring("bevel_2", clear_2, touch_2, z_2, after, bevel_coating),
        *steps,
    )


def barrel(
    items: Surface | Stop | Iterable[Surface | Stop],
    *,
    coating: Coating = ABSORBER,
    edge_coating: Coating = ABSORBER,
    name: str = "barrel",
    first_space: int = 1,
) -> tuple[Structure | Surface, ...]:
    """
    Return the faces that close a coaxial group: lens edges in glass, opaque barrel walls in gas, from rim to rim.

    Around a rectangle or another outline about the axis, the face of a lens goes on, black, to the circle around it.
    Around them is the gas in front of the group; if that is a glass, the first gas in the group.

    Parameters
    ----------
    items : Surface, Stop or iterable of them
        Surfaces and stops in the order of light; surfaces of a body follow each other. A `Detector` may end it; fill
        its frame with `detector_frame`.
    coating : Coating
        Coating of the walls in gas; black by default, as are the edges.
    edge_coating : Coating
        Coating of the lens edges, see `lens_edge`.
    name : str
        Start of the names: the wall in the air space of index k is ``<name>_<k>_wall``. A stop divides its space in
        two. If a straight cone would cut into a surface, the wall is a cylinder and a flat ring.
    first_space : int
        Index of the first air space.

    Returns
    -------
    tuple of Structure or Surface
        Edges and walls, from the first rim to the last, and the black rests of faces, ``<surface>_aperture``.

    Raises
    ------
    MistrayError
        If the materials that two neighbours state for their space differ, or an edge or a wall would cut into a
        surface.

    Examples
    --------
    >>> front = mistray.Surface("L1_front", radius=50, semi_diameter=10, back="N-BK7", part="L1")
    >>> rear = mistray.Surface("L1_rear", z=5, radius=-50, semi_diameter=10, front="N-BK7", part="L1")
    >>> detector = mistray.Detector(z=51, half_width=4, half_height=3)
    >>> [face.name for face in mistray.prescription.barrel([front, rear, detector])]
    ['L1_edge', 'barrel_1_wall']
    """
    result: list[Structure | Surface] = []
    space = first_space
    given = ITEMS.check("items", items, f"barrel '{name}'")
    whole = [whole_face(item) if isinstance(item, Surface) and not item.mirror else (item, None) for item in given]
    pairs = [(a, b, _shared_material(a, b)) for (a, _), (b, _) in pairwise(whole)]
    ahead = [a.front if isinstance(a, Surface) else "air" for a, _, _ in pairs[:1]]
    outside = gas_of(*ahead, *(material for _, _, material in pairs))
    for a, b, material in pairs:
        if isinstance(a, Surface) and isinstance(b, Surface) and not is_gas(material):
            result += lens_edge(a, b, coating=edge_coating, outside=outside)
        else:
            own, points = f"{name}_{space}_wall", _profile(a, b)
            result += wall(own, points, coating=coating, part=name, space=space, front=material, back=outside)
            space += 1
    return (*result, *(rest for _, rest in whole if rest is not None))


def detector_frame(
    detector: Detector,
    outer_radius: float | None = None,
    *,
    coating: Coating = ABSORBER,
    name: str = "board",
    space: int = -1,
) -> tuple[Surface, ...]:
    """
    Return four rectangles around a rectangular detector, in its plane, that cover a tube of a given radius.

    They tile the plane without overlap, so that no face coincides with the detector.

    Parameters
    ----------
    detector : Detector
        Plane detector with half_width and half_height.
    outer_radius : float or None
        Radius about its middle to cover, mm; ``None``: up to the corners of the detector.
    coating, space
        Coating and space of the rectangles, as in `Surface`.
    name : str
        Name of the part, and start of the names ``<name>_left``, ``_right``, ``_bottom``, ``_top``.

    Returns
    -------
    tuple of Surface
        Rectangles left, right, below and above.

    Raises
    ------
    MistrayError
        If the detector is not rectangular, or `outer_radius` does not reach its corners.

    Examples
    --------
    >>> detector = mistray.Detector(z=51, half_width=4, half_height=3)
    >>> board = mistray.prescription.detector_frame(detector, outer_radius=10)
    >>> [face.name for face in board]
    ['board_left', 'board_right', 'board_bottom', 'board_top']
    """
    w, h = detector.half_width, detector.half_height
    if w is None or h is None:
        raise MistrayError(f"detector '{detector.name}': it is round; only a rectangular detector needs a frame")
    outer = detector.outer_radius if outer_radius is None else outer_radius
    if outer < detector.outer_radius:
        raise MistrayError(
            f"detector '{detector.name}': frame radius {outer:g} mm; it must reach the corners at "
            f"{detector.outer_radius:g} mm"
        )
    side, cap = (outer - w) / 2, (outer - h) / 2
    pieces = {
        "left": (-(w + side), 0.0, side, outer),
        "right": (w + side, 0.0, side, outer),
        "bottom": (0.0, -(h + cap), w, cap),
        "top": (0.0, h + cap, w, cap),
    }
    frame = detector.to_world()
    return tuple(
        Surface(
            f"{name}_{key}",
            **dict(zip("xyz", (frame @ (x, y, 0.0, 1.0))[:3].tolist(), strict=True)),
            tilt_deg=detector.tilt_deg,
            half_width=half_width,
            half_height=half_height,
            front=detector.front,
            back=detector.back,
            coating=coating,
            part=name,
            space=space,
        )
        for key, (x, y, half_width, half_height) in pieces.items()
    )


def whole_face(surface: Surface) -> tuple[Surface, Surface | None]:
    """
    Return the round face of which a surface is the clear part, and the black rest of this face, None if there is none.

    The face ends in the circle around an outline about the axis. Round surfaces and detectors are returned as they are,
    and so are those that have no such face.
    """
    if surface.semi_diameter is not None or isinstance(surface, Detector):
        return surface, None
    clear = surface.outline or rectangle(surface.half_width or 0.0, surface.half_height or 0.0)
    first, *more = clear.figures
    if first.sign == "&":  # of the whole plane
        first = replace(first, sign="+")
        clear = Outline((first, *more))
    reach = max((figure.reach for figure in clear.figures if figure.sign == "+"), default=surface.outer_radius)
    end = conic_end(surface.curvature, surface.conic)
    radius = min(_AROUND * reach, 0.5 * (reach + end))
    if more and more[0].sign == "&" and first == circle(first.sizes[0]).figures[0]:  # cut at this circle
        clear = Outline((replace(more[0], sign="+"), *(f for f in more[1:] if f != replace(first, sign="&"))))
        radius = reach = first.sizes[0]
    x0, x1, y0, y1 = clear.bounds()
    rest = clear.around(reach) if max(abs(x0 + x1), abs(y0 + y1)) <= _TOLERANCE_MM * (1 + reach) else None
    if rest is None or reach >= end:
        return surface, None
    if rest.empty:
        return replace(surface, half_width=None, half_height=None, outline=None, semi_diameter=reach), None
    face = replace(surface, half_width=None, half_height=None, outline=None, semi_diameter=radius)
    name, own = f"{surface.name}_aperture", clear.around(radius)
    return face, replace(face, name=name, semi_diameter=None, outline=own, coating=ABSORBER, scatter=(), mirror=False)


def is_gas(material: str) -> bool:
    """True if a material is air, vacuum or a constant index below 1.01, by which some programs describe air."""
    index = number_of(material)
    return material.strip().lower() in ("air", "vacuum") if index is None else index < GAS_INDEX


def gas_of(*materials: str) -> str:
    """Return the first gas among materials, air if there is none."""
    return next(filter(is_gas, materials), "air")


def _shared_material(a: Surface | Stop, b: Surface | Stop) -> str:
    behind = a.back if isinstance(a, Surface) else "air"
    ahead = b.front if isinstance(b, Surface) else "air"
    if behind.strip().lower() != ahead.strip().lower():
        raise MistrayError(
            f"'{_name(a)}' and '{_name(b)}': the material between them is '{behind}' for one and '{ahead}' for the "
            "other; "
            "make them equal"
        )
    return behind


def _name(item: Surface | Stop) -> str:
    return item.name if isinstance(item, Surface) else item.part


def _profile(a: Surface | Stop, b: Surface | Stop) -> list[Point]:
    """
    Return wall points (r, z), mm, from one rim to the next: a cone, or cylinder and ring if a cone would cut a surface.

    Raise `MistrayError` if neither clears the surfaces.
    """
    start = (a.outer_radius, a.rim_heights[1]) if isinstance(a, Surface) else (a.outer_rear, a.z_rear)
    end = (b.outer_radius, b.rim_heights[0]) if isinstance(b, Surface) else (b.outer_front, b.z_front)
    corner = (start[0], end[1]) if start[0] > end[0] else (end[0], start[1])
    failure: MistrayError | None = None
    for points in ([start, end], [start, corner, end]):
        try:
            for p, q in pairwise(points):
                if isinstance(a, Surface):
                    _check_clear(a, _name(b), p, q, above=True)
                if isinstance(b, Surface):
                    _check_clear(b, _name(a), p, q, above=False)
            return points
        except MistrayError as error:
            failure = error
    assert failure is not None
    raise failure


def _check_clear(surface: Surface, other: str, p: Point, q: Point, *, above: bool) -> None:
    """
    Raise `MistrayError` if the segment p q, (r, z) in mm, cuts a surface.

    With `above` it should lie on the +z side, else on the -z side. `other` names the wall's other end in the message.
    """
    t = np.linspace(0.0, 1.0, _SAMPLES)
    r, z = p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])
    inside = (r <= surface.outer_radius) & (r >= surface.inner_semi_diameter)
    gap = (z - surface.z_at(r))[inside] * (1 if above else -1)
    if gap.size and gap.min() < -_TOLERANCE_MM:
        raise MistrayError(
            f"surface '{surface.name}': the wall towards '{other}' would cut into it at r = "
            f"{r[inside][gap.argmin()]:.4g} mm; "
            "move them apart or change a clear radius"
        )

"""Conversion of a sequential lens to a closed non-sequential system in the world.

Stray light does not follow the order of the table, so mechanical parts are added to its surfaces. These are edges of
the lens bodies, walls between lenses, a stop plate with a hole, the rear and the rim of mirrors, holes in mirrors and
lenses that the beam passes through, and a frame around the detector. The notes list the assumptions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mistray.errors import MistrayError
from mistray.materials.mate import shown
from mistray.physics.geometry.crossing import meeting
from mistray.physics.geometry.outline import Outline, circle, rectangle
from mistray.physics.sags.terms import sag
from mistray.prescription.closing.apertures import aperture_pieces
from mistray.prescription.closing.bores import add_bores
from mistray.prescription.closing.edges import EDGES, Closing, Edges, Item, StopPlane, mirror_back, on_axis, placed
from mistray.prescription.closing.mirrors import cut_holes
from mistray.prescription.closing.shadows import met_at, shadowing_spaces
from mistray.prescription.closing.source import source_of
from mistray.prescription.closing.surfaces import COVER_MM, OpticalSurfaces
from mistray.prescription.coating import COATINGS, Coating
from mistray.prescription.geometry import is_gas
from mistray.prescription.imported_beam import Beam, check_beam
from mistray.prescription.model import Detector, Prescription, Structure, Surface
from mistray.prescription.sequential.first_order import SequentialFirstOrder
from mistray.prescription.sequential.rays import curvature
from mistray.prescription.sequential.table import Sequential
from mistray.ranges import MARGIN as MARGIN_RANGE
from mistray.ranges import SIZE_MM, Each

MARGIN = 0.02
MOST_SURFACES = 500  # of a lens: with its edges and walls a trace has some three times as many shapes

_PIXELS = (512, 512)
_MIRROR_THICKNESS = 0.05  # of the clear radius
HALVES = Each(SIZE_MM, 2)  # of a detector
_SAMPLES = 61  # each way, of what two outlines share
_POINT = 1e-3  # of the focal length: all fields fall on one point
_SMALLEST_DETECTOR = 0.01  # of the focal length: half size of the detector then


@dataclass(frozen=True)
class Built:
    """
    Closed system made from a lens, with the lens's first-order data and notes on assumptions.

    Attributes
    ----------
    prescription : Prescription
        Closed system.
    lens : Sequential
        Lens that the prescription was made of; ``lens.unread`` lists content of the file that had no effect.
    first_order : SequentialFirstOrder
        First-order data of the lens.
    notes : tuple of str
        Assumptions of the file's reader and of the closing.

    Examples
    --------
    >>> from mistray.prescription.closing.system import build
    >>> from mistray.scenes.cooke_triplet.prescription import build as triplet
    >>> built = build(mistray.prescription.to_sequential(triplet()), edges="ground")
    >>> print(f"f = {built.first_order.efl:.2f} mm, {len(built.prescription.structures)} structures")
    f = 50.00 mm, 13 structures
    """

    prescription: Prescription
    lens: Sequential
    first_order: SequentialFirstOrder
    notes: tuple[str, ...]


def to_prescription(
    sequential: Sequential,
    *,
    edges: Edges = "blackened",
    coatings: Mapping[str, Coating] | None = None,
    margin: float = MARGIN,
    ground_reflectance: float = 0.5,
    beam: Beam = "pupil",
    detector_half_mm: tuple[float, float] | None = None,
) -> Prescription:
    """
    Return a closed optical system made from a sequential lens.

    Parameters
    ----------
    sequential : Sequential
        Lens from `read_zemax`, `read_codev` or another reader.
    edges : {"blackened", "ground", "open"}
        Lens edges: absorbing, diffusely reflecting a part of the light, or polished without any barrel around them. For
        the first two, absorbing walls join the rims of neighbours in air.
    coatings : mapping of str to Coating, optional
        Coatings, keyed by their names in the lens file; they override coatings that the reader found. A surface with
        another name or none is bare glass, or a mirror that reflects all light. Notes say so, but for glass without a
        name.
    margin : float
        Fraction, ≥ 0, by which clear radii exceed the rays of all fields if the lens file gives none.
    ground_reflectance : float
        Reflectance of ground edges, 0 … 1.
    beam : {"pupil", "front", "exact"}
        Size of the source. "pupil": it overfills the entrance pupils of all fields by a twentieth of the radius.
        "front": it overfills the first surface, as a distant source of stray light does. "exact": it just fills the
        entrance pupil of the axis, so that the stop has no derivatives. See `mistray.prescription.imported_beam`.
    detector_half_mm : tuple of two float or None
        Half width and half height of the detector, mm. ``None``: half sizes of a centred rectangle that the image
        states as its aperture, else of the image of all fields.

    Returns
    -------
    Prescription
        System in the frame of the first surface: its vertex is the origin, and light travels along +z. `provenance`
        holds the notes and every line of the file that had no effect.

    Raises
    ------
    MistrayError
        If an option is invalid, a material is unknown, no ray gets through, surfaces cross, or there are more than
        `MOST_SURFACES`.

    Examples
    --------
    >>> row = mistray.prescription.Row
    >>> glass = row(1, radius=50, thickness=5, material="N-BK7", stop=True)
    >>> rows = glass, row(2, radius=-50, thickness=46), row(3, kind="image")
    >>> lens = mistray.prescription.Sequential("singlet", rows, aperture=8)
    >>> system = mistray.prescription.to_prescription(lens, edges="ground")
    >>> [structure.name for structure in system.structures[:3]]
    ['L1_edge', 'L1_flange_2', 'barrel_1_wall']
    """
    built = build(
        sequential,
        edges=edges,
        coatings=coatings,
        margin=margin,
        ground_reflectance=ground_reflectance,
        beam=beam,
        detector_half_mm=detector_half_mm,
    )
    return built.prescription


def build(
    sequential: Sequential,
    *,
    edges: Edges = "blackened",
    coatings: Mapping[str, Coating] | None = None,
    margin: float = MARGIN,
    ground_reflectance: float = 0.5,
    beam: Beam = "pupil",
    detector_half_mm: tuple[float, float] | None = None,
) -> Built:
    """
    Return the closed system of `to_prescription` with first-order data and notes.

    Parameters and errors are those of that function.
    """
    if edges not in EDGES:
        raise MistrayError(f"edges = '{edges}'; they are {', '.join(EDGES[:-1])} or {EDGES[-1]}")
    check_beam(beam, ("pupil", "front", "exact"))
    MARGIN_RANGE.check("margin", margin)
    COATINGS.check_all("", coatings=coatings)
    half = None if detector_half_mm is None else HALVES.check("detector_half_mm", detector_half_mm)
    if len(sequential.rows) > MOST_SURFACES:
        raise MistrayError(
            f"lens '{sequential.name}' has {len(sequential.rows)} surfaces, more than {MOST_SURFACES}; leave out those "
            "that do nothing, or import its parts one by one"
        )
    table = OpticalSurfaces(sequential, coatings, margin)
    cut_holes(table)
    return _structured(table, Closing(edges, ground_reflectance), beam, half)


def _structured(table: OpticalSurfaces, closing: Closing, beam: Beam, detector_half: tuple[float, ...] | None) -> Built:
    """
    Return the closed system: the optical surfaces with mechanical parts, source and detector added.

    `detector_half` is ``detector_half_mm`` of `to_prescription`, and `beam` its beam.
    """
    lens, surfaces = table.lens, table.surfaces
    detector = _detector(table, detector_half)
    items: list[Item] = []
    ahead: list[bool] = []
    plates: list[Structure | Surface] = []
    widest = max((surface.outer_radius for surface in surfaces.values()), default=0.0)
    for k in range(len(lens.rows) - 1):
        stop = table.is_stop_plane(k)
        if k in surfaces or stop:
            items.append(surfaces[k] if k in surfaces else _stop(table, k))
            ahead.append(table.aheads[k])
        plates += _plates(table, k, widest)
    closing.close([*items, detector], [*ahead, table.aheads[-1]])
    closing.structures = _without_shadows(table, closing.structures, detector)
    add_bores(table, closing)
    plates += _mirror_backs(table, detector)
    source = source_of(table, beam)
    notes = tuple(dict.fromkeys([*table.notes, *closing.notes, *detector.notes()]))
    prescription = Prescription(
        name=shown([lens.name]),
        surfaces=tuple({surface.name: surface for surface in surfaces.values()}.values()),
        structures=(*closing.structures, *plates),
        stop=closing.stop,
        detector=detector,
        source=source,
        provenance=_provenance(lens, notes),
    )
    return Built(prescription, lens, table.rays.data, notes)


def _without_shadows(
    table: OpticalSurfaces, structures: list[Structure | Surface], detector: Detector
) -> list[Structure | Surface]:
    """
    Return the structures except the walls and boards of spaces whose walls the folded beam would have to cross.

    A lens without mirrors keeps all of them. Notes on what is left out, and on a detector in the beam, are added to
    `table`.
    """
    if not any(row.mirror for row in table.lens.rows):
        return structures
    segments = []
    for begin, end in table.segments():
        start, stop = table.beam[begin], table.beam[end].copy()
        ends = [table.surfaces.get(k - 1) for k in (begin, end)]
        for k, surface in table.surfaces.items():
            if surface not in ends:
                # A lens that stands in the beam shades its own mount
                stop[np.isfinite(met_at(table.lens.rows[k], surface, start, stop))] = np.nan
        segments.append((start, stop))
        row = table.lens.rows[end - 1]
        if row.kind != "image" and np.any(
            np.isfinite(
                met_at(replace(table.lens.rows[-1], radius=math.inf, coefficients=(), sag={}), detector, start, stop)
            )
        ):
            table.notes.append(f"the detector stands in the beam on its way to surface {row.number}")
    spaces = shadowing_spaces(structures, segments)
    table.notes += [f"there is no wall in space {space}: it would stand in the beam" for space in sorted(spaces)]
    return [piece for piece in structures if piece.part not in ("barrel", "board") or piece.space not in spaces]


def _stop(table: OpticalSurfaces, k: int) -> StopPlane:
    row = table.lens.rows[k]
    if curvature(row):
        table.notes.append(f"surface {row.number}: the stop is curved in the file and flat here")
    return StopPlane(table.rays.stop_radius, table.frames[k], table.before[k])


def _plates(table: OpticalSurfaces, k: int, widest: float) -> list[Surface | Structure]:
    """
    Return opaque faces, in the world, for stated apertures of row `k` that the clip of its surface leaves out.

    Those around an opening extend to the radius `widest`, mm, at least. A coordinate break has none. Notes are added to
    `table`.
    """
    row = table.lens.rows[k]
    if row.kind == "coordinate_break":
        return []
    if table.is_stop_plane(k):  # its round opening is that of the stop
        own = row.aperture
        if own is not None and own.annulus:
            own = Outline(own.figures[1:]) if own.figures[1:] else None
        row = replace(row, semi_diameter_fixed=False, aperture=own)
    pieces, notes = aperture_pieces(row, table.names[k], k in table.surfaces, table.aheads[k], widest, table.before[k])
    table.notes += notes
    plates = [placed(piece, table.frames[k]) for piece in pieces]
    return [face for plate in plates for face in _for_its_leg(table, k, plate)]


def _for_its_leg(table: OpticalSurfaces, k: int, plate: Surface | Structure) -> list[Surface | Structure]:
    """
    Return a plate of row `k`, restricted to the section of the beam that it belongs to, as a list of one or none.

    A file states an aperture for light that arrives at its row in sequence. In a folded system other legs may cross the
    same plane. If they cross it in the opposite direction, the plate meets only light of its own direction. If they
    cross it in the same direction, there is no plate.
    """
    face = plate
    if isinstance(plate, Structure):
        ring = circle(max(plate.r0, plate.r1), inner=min(plate.r0, plate.r1))
        face = Surface(
            plate.name, outline=ring, coating=plate.coating, part=plate.part, front=plate.front, back=plate.back,
            x=plate.x, y=plate.y, z=plate.z, tilt_deg=plate.tilt_deg,
        )  # fmt: skip
    assert isinstance(face, Surface)
    figure = table.lens.rows[k]
    if isinstance(plate, Structure):
        figure = replace(figure, radius=math.inf, conic=0.0, coefficients=(), sag={})
    axis, way = face.to_world()[:3, 2], 1 if table.aheads[k] else -1
    ways = set()
    for begin, end in table.segments():
        if not begin < k + 1 <= end:
            start, stop = table.beam[begin], table.beam[end]
            crossed = np.isfinite(met_at(figure, face, start, stop))
            ways |= set(np.sign((stop - start)[crossed] @ axis))
    number = table.lens.rows[k].number
    if not ways:
        return [plate]
    if way in ways:
        table.notes.append(f"surface {number}: no plate of its aperture; it would stand in the beam to another surface")
        return []
    table.notes.append(f"surface {number}: the plate of its aperture shades only light that goes as the design's there")
    return [replace(face, meets="+z" if way > 0 else "-z")]


def _mirror_backs(table: OpticalSurfaces, detector: Detector) -> list[Surface | Structure]:
    result: list[Surface | Structure] = []
    others = [*table.surfaces.values(), detector]
    for k, mirror in table.surfaces.items():
        known = any(piece.part == mirror.part for piece in result)
        if mirror.mirror and is_gas(mirror.front) and not known and mirror.name not in table.patches:
            body = mirror_back(mirror, table.aheads[k], _MIRROR_THICKNESS * _half_size(mirror))
            cut = next((other for other in (*others, *result) if _cross(body[0], other)), None)
            if cut is None:
                result += body
            else:
                table.notes.append(f"mirror '{mirror.name}' has no rear: it would cut '{cut.name}'")
    return result


def _outline(surface: Surface) -> Outline:
    """Return the clear area of a surface as an outline in mm."""
    if surface.outline is not None:
        return surface.outline
    if surface.semi_diameter is not None:
        return circle(surface.semi_diameter, surface.inner_semi_diameter)
    assert surface.half_width is not None
    assert surface.half_height is not None
    return rectangle(surface.half_width, surface.half_height)


def _half_size(surface: Surface) -> float:
    """Return the clear radius of a surface, mm; without one, half the diagonal of its rectangle or bounding box."""
    if surface.outline is None:
        return surface.outer_radius
    x0, x1, y0, y1 = surface.outline.bounds()
    return 0.5 * math.hypot(x1 - x0, y1 - y0)


def _cross(a: Surface | Structure, b: Surface | Structure) -> bool:
    """
    True if two surfaces on a common axis cross, or coincide without outlines, within their clear areas.

    A rectangle counts as its circumscribed circle, unless one surface has an outline. False for other pairs.
    """
    if not (isinstance(a, Surface) and isinstance(b, Surface) and on_axis(a.to_world(), b.to_world())):
        return False
    gap = float((np.linalg.inv(a.to_world()) @ b.to_world())[2, 3])
    here, there = (replace(s, x=0.0, y=0.0, z=z, tilt_deg=(0.0, 0.0, 0.0)) for s, z in ((a, 0.0), (b, gap)))
    if a.outline is not None or b.outline is not None:
        x, y = _outline(a).sample(_SAMPLES)
        some = _outline(b).contains(x, y)
        apart = sag(x[some], y[some], a.sag_numbers) - sag(x[some], y[some], b.sag_numbers) - gap
        return bool(np.nanmin(apart, initial=np.inf) < 0 < np.nanmax(apart, initial=-np.inf))
    inner = max(a.inner_semi_diameter, b.inner_semi_diameter)
    return meeting(here.z_at, there.z_at, inner, min(a.outer_radius, b.outer_radius)) is not None


def _detector(table: OpticalSurfaces, half: tuple[float, ...] | None) -> Detector:
    row, frame, data = table.lens.rows[-1], table.frames[-1], table.rays.data
    if half is None and row.aperture is not None:
        half = row.aperture.sides
        if half is None:
            table.notes.append(
                "the aperture of the image is not a rectangle about its middle: the detector is a square"
            )
    if half is None:
        scale = data.epd / _SMALLEST_DETECTOR if math.isinf(data.efl) else abs(data.efl)
        size = max(float(table.rays.reach[-1]), row.semi_diameter or 0.0) * (1 + table.margin)
        if size < _POINT * scale:
            size = _SMALLEST_DETECTOR * scale
            table.notes.append(f"the image is a point: the detector is made {2 * size:.4g} mm wide")
        half = (size, size)
    if curvature(row) or row.coefficients or row.sag:
        table.notes.append(f"the image surface is curved (radius {row.radius:g} mm) in the file, the detector is flat")
    last = max(table.surfaces, default=-1)
    if last >= 0 and np.allclose(table.frames[last][:3, 3], frame[:3, 3], rtol=0, atol=COVER_MM / 10):
        frame = frame.copy()
        frame[:3, 3] += frame[:3, 2] * (COVER_MM if table.aheads[-1] else -COVER_MM)
        table.notes.append(f"the image lies on surface {table.lens.rows[last].number}: the detector is put 1 µm behind")
    material = table.before[-1]
    return placed(
        Detector(half_width=half[0], half_height=half[1], front=material, back=material, pixels=_PIXELS), frame
    )


def _provenance(lens: Sequential, notes: tuple[str, ...]) -> str:
    lines = [f"From {lens.source or 'a sequential lens'}."]
    lines += [f"Note: {note}." for note in notes]
    for item in lens.unread:
        place = f", line {item.line}" if item.line else ""
        lines.append(f"Without effect{place}: {shown([item.text.strip()])} ({item.reason})")
    return "\n".join(lines)

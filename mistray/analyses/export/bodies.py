"""Bodies of a scene for a STEP file: closed volumes as solids, everything else as sheets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray.analyses.export.faces import Patch, Turner, loops_of, polyhedron, polyhedron_faces
from mistray.analyses.export.profiles import Profile, profile_of
from mistray.errors import MistrayError
from mistray.io.cad.write_step import StepFile
from mistray.physics.geometry.outline import rectangle
from mistray.prescription.geometry import is_gas
from mistray.toolkit.drawings.chains import route
from mistray.toolkit.drawings.cut_open import primitive, role_of, surface_names

Array = npt.NDArray[np.float64]

# A transform in single precision turns and moves an axis by this: a distance in units of the size, and 1 - cosine
SAME_AXIS, PARALLEL = 2e-7, 1e-13
JOINED_MM, CONNECTED = 1e-7, 1e-6  # ends nearer than this are one point: mm, and of the size
OPTICS, MECHANICS, DETECTORS = "optics", "mechanics", "detectors"
GROUPS = {"glass": OPTICS, "mirror": OPTICS, "structure": MECHANICS, "detector": DETECTORS}


@dataclass(frozen=True, eq=False)
class Ring:
    """
    Surface of revolution about an axis, in the axis's frame.

    `minus` and `plus` are the materials on the sides of lower and higher z. `refracts` is True for a transparent sag
    surface of glass or a detector. `mirror_side` is the side of a mirror that light comes from, -1 that of lower z and
    1 that of higher; it is 0 for other surfaces, and if no light to the detector meets the mirror.
    """

    name: str
    part: str
    role: str
    profile: Profile
    minus: str
    plus: str
    refracts: bool
    mirror_side: int


@dataclass(frozen=True, eq=False)
class Axis:
    """Group of surfaces of revolution about one axis; `matrix`, (4, 4), transforms its frame to the world, mm."""

    matrix: Array
    rings: list[Ring] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class StepBody:
    """
    Body that becomes one product in a STEP file.

    Attributes
    ----------
    name, group, role : str
        Name of the product, its group in the assembly, and the role of its surfaces.
    solid : bool
        Whether its faces close a volume.
    turned : list of (matrix, list of Profile)
        Profiles about an axis, mm, with the transform of its frame to the world, (4, 4); for a solid one closed chain.
    patches : list of Patch
        Sags within outlines; for a solid its flat polygons.
    ring : bool
        Whether a closed chain does not touch the axis.
    """

    name: str
    group: str
    role: str
    solid: bool
    turned: list[tuple[Array, list[Profile]]] = field(default_factory=list)
    patches: list[Patch] = field(default_factory=list)
    ring: bool = False

    def faces(self, file: StepFile) -> list[int]:
        """Add the faces of the body to a file and return their entity numbers."""
        if self.solid and self.patches:
            polygons = [patch.polygon for patch in self.patches]
            known = [polygon for polygon in polygons if polygon is not None]
            rings = polyhedron(known)
            assert rings is not None
            return polyhedron_faces(file, known, [patch.name for patch in self.patches], rings)
        found = []
        for matrix, profiles in self.turned:
            turner = Turner(file, matrix)
            chains = [profiles] if self.solid else [[profile] for profile in profiles]
            found += [face for chain in chains for face in turner.faces(chain, self.ring)]
        return found + [patch.face(file) for patch in self.patches]

    @property
    def error_mm(self) -> float:
        """
        Largest distance of its B-splines from the surfaces, mm, once its faces are made.

        It is 0 if the body has no B-spline.
        """
        profiles = [profile.error_mm for _, own in self.turned for profile in own]
        return max([*profiles, *(patch.error_mm for patch in self.patches)], default=0.0)


@dataclass
class Found:
    """Bodies found in a scene, notes on them, and the reason for each shape that is left out, by its id."""

    bodies: list[StepBody] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def bodies_of(
    scene: Any, lit: Mapping[str, int], mirror_thickness_mm: float | None, freeform_tolerance_mm: float
) -> Found:
    """
    Return the bodies of a scene that STEP can hold, notes on them, and reasons for omitted shapes.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    lit : mapping of str to int
        Side of each mirror that light comes from: -1 the front, 1 the back, in the frame of the shape.
    mirror_thickness_mm : float or None
        Thickness of a substrate behind mirrors that no body of the scene closes, mm; None: such mirrors stay sheets.
    freeform_tolerance_mm : float
        Largest distance of a B-spline from a freeform, mm.
    """
    found = Found()
    axes: list[Axis] = []
    patches: list[tuple[str, str, Patch]] = []  # part, role
    for name, shape in surface_names(scene):
        part, role = getattr(shape, "part", "") or name, role_of(shape)
        try:
            turned = _turned(name, shape)
            if turned is not None:
                _add(axes, name, part, role, shape, *turned, lit.get(name, 0))
                continue
            patch = _patch(name, shape, freeform_tolerance_mm)
        except MistrayError as error:
            found.left_out[name] = str(error)
            continue
        if isinstance(patch, str):
            found.left_out[name] = patch
        else:
            patches.append((part, role, patch))
    left: dict[str, StepBody] = {}
    for axis in axes:
        used = _lenses(axis, found)
        rest = [ring for ring in axis.rings if ring.name not in used]
        for part in dict.fromkeys(ring.part for ring in rest):
            own = [ring for ring in rest if ring.part == part]
            loops, sheets = _closed(own)
            for loop in loops:
                found.bodies.append(_solid(own[0].part, own[0].role, axis, loop))
            for ring in sheets:
                body = None
                if ring.role == "mirror" and mirror_thickness_mm is not None:
                    body = _mirror(axis, ring, mirror_thickness_mm, found)
                if body is not None:
                    found.bodies.append(body)
                else:
                    _sheets(left, part, ring.role).turned.append((axis.matrix, [ring.profile]))
    for part in dict.fromkeys(part for part, _, _ in patches):
        own_patches = [(role, patch) for owner, role, patch in patches if owner == part]
        polygons = [patch.polygon for _, patch in own_patches]
        flat = [polygon for polygon in polygons if polygon is not None]
        if len(flat) == len(polygons) > 3 and polyhedron(flat) is not None:
            role = Counter(role for role, _ in own_patches).most_common(1)[0][0]
            found.bodies.append(StepBody(part, GROUPS[role], role, True, patches=[patch for _, patch in own_patches]))
            continue
        for role, patch in own_patches:
            _sheets(left, part, role).patches.append(patch)
    found.bodies += left.values()
    return found


def _sheets(left: dict[str, StepBody], part: str, role: str) -> StepBody:
    return left.setdefault(f"{part} {GROUPS[role]}", StepBody(part, GROUPS[role], role, False))


def _solid(name: str, role: str, axis: Axis, loop: list[Profile]) -> StepBody:
    return StepBody(name, GROUPS[role], role, True, [(axis.matrix, loop)], ring=loop[0].start[0] > 0)


# ---- shapes


def _turned(name: str, shape: Any) -> tuple[Array, Profile] | None:
    """Return transform, (4, 4), and profile (mm) of a shape that is a surface of revolution; None for other shapes."""
    if hasattr(shape, "profile"):
        if getattr(shape, "rectangular", False):
            return None
        return np.asarray(shape.matrix, dtype=np.float64), profile_of(name, shape)
    kind, rigid, size = primitive(shape)
    if kind == "Sphere":
        ends = np.array([[0.0, -size[0]], [0.0, size[0]]])
        return rigid, Profile(name, "circle", ends, radius=float(size[0]))
    if kind in ("Disk", "Cylinder"):
        poles = [[0.0, 0.0], [size[0], 0.0]] if kind == "Disk" else [[size[0], 0.0], [size[0], size[2]]]
        return rigid, Profile(name, "line", np.array(poles))
    return None


def _patch(name: str, shape: Any, tolerance: float) -> Patch | str:
    """
    Return a non-rotational surface within an outline as a patch, or the reason why it cannot be written.

    `tolerance` is that of `Patch`, mm.
    """
    if getattr(shape, "rectangular", False):
        outline = rectangle(shape.values["half_width"], shape.values["half_height"])
        return Patch(name, lambda x, y: shape.sag(np.hypot(x, y)), outline.figures, shape.matrix, tolerance)
    if hasattr(shape, "outline") and hasattr(shape, "height"):
        figures = loops_of(shape.outline)
        if figures is None:
            return "the figures of its outline meet each other; only separate holes are written"
        return Patch(name, shape.height, figures, np.asarray(shape.matrix), tolerance)
    kind, rigid, size = primitive(shape)
    if kind == "Rectangle":
        return Patch(name, lambda x, y: 0.0 * x, rectangle(size[0], size[1]).figures, rigid, tolerance)
    return "it is a mesh; take it from its CAD file"


# More than 8 parameters: the facts of one shape
def _add(
    axes: list[Axis], name: str, part: str, role: str, shape: Any, matrix: Array, profile: Profile, lit: int
) -> None:
    """
    Add a surface of revolution to the list of surfaces about its axis, or start a list for a new axis.

    `matrix` and `profile` are those of `_turned`. `lit` is the side of a mirror as in `bodies_of`, 0 for none.
    """
    size = float(np.abs(profile.poles).max())
    bsdf = shape.bsdf()
    front, back = getattr(bsdf, "front", "air"), getattr(bsdf, "back", "air")  # one of Mitsuba has none
    for axis in axes:
        along = float(matrix[:3, 2] @ axis.matrix[:3, 2])
        away = matrix[:3, 3] - axis.matrix[:3, 3]
        shift = float(away @ axis.matrix[:3, 2])
        aside = np.linalg.norm(away - shift * axis.matrix[:3, 2])
        if 1 - abs(along) <= PARALLEL and aside <= SAME_AXIS * (size + float(np.abs(matrix[:3, 3]).max())):
            sign = float(np.sign(along))
            profile = profile.moved(sign, shift)
            break
    else:
        axis, sign = Axis(matrix), 1.0
        axes.append(axis)
    minus, plus = (front, back) if sign > 0 else (back, front)
    sheet = hasattr(shape, "sag")
    refracts = sheet and role in ("glass", "detector") and not getattr(bsdf, "opaque", True)
    axis.rings.append(Ring(name, part, role, profile, minus, plus, refracts, int(sign * lit)))


# ---- lenses and mirrors


def _lenses(axis: Axis, found: Found) -> set[str]:
    """Add the lenses about an axis to `found`, and notes on those not closed; return the ids of surfaces used."""
    faces = sorted((ring for ring in axis.rings if ring.refracts), key=lambda ring: float(ring.profile.points(3)[0, 1]))
    used: set[str] = set()
    for k, face in enumerate(faces):
        glass = face.plus
        partner = next((other for other in faces[k + 1 :] if other.minus == glass), None)
        if is_gas(glass) or partner is None:
            continue
        if (face.profile.start[0] > 0) != (partner.profile.start[0] > 0):
            found.notes.append(f"{face.part}: one of its faces has a hole and the other has none; they are sheets")
            continue
        rims = [ring for ring in axis.rings if not ring.refracts and glass in (ring.minus, ring.plus)]
        loop, names, straight = [face.profile], [face, partner], False
        for outer, (a, b) in ((True, (face, partner)), (False, (partner, face))):
            start, end = (a.profile.end, b.profile.end) if outer else (a.profile.start, b.profile.start)
            if not outer:
                loop.append(partner.profile.reversed())
                if start[0] == end[0] == 0:
                    break
            way = route(start, end, [ring.profile.poles[[0, -1]] for ring in rims])
            if way is None:
                straight = True
                loop.append(Profile(f"{face.part}_edge", "line", np.array([start, end])))
                continue
            for number, forwards in way:
                profile = rims[number].profile
                loop.append(profile if forwards else profile.reversed())
                names.append(rims[number])
        votes = Counter(ring.part for ring in names)
        votes[face.part] += 1
        part = votes.most_common(1)[0][0]
        whole = _tidy(loop)
        if whole is None:
            found.notes.append(f"{part}: its surfaces cross each other; they are sheets")
            continue
        if straight:
            found.notes.append(
                f"{part}: the scene has no edge for it; the rims of its faces are joined by a straight line"
            )
        found.bodies.append(_solid(part, "glass", axis, whole))
        used |= {ring.name for ring in names if ring.part in (face.part, partner.part)}
    return used


def _mirror(axis: Axis, ring: Ring, thickness: float, found: Found) -> StepBody | None:
    """
    Return a mirror with a substrate behind it, at least `thickness` thick, mm, as a body; None if no volume closes.

    If the light to the detector does not meet it, add a note to `found` and return None.
    """
    if not ring.mirror_side:
        found.notes.append(f"{ring.name}: the light to the detector does not meet it; it stays a sheet")
        return None
    profile, side = ring.profile, -float(ring.mirror_side)
    back = float(side * (side * profile.points(257)[:, 1]).max() + side * thickness)
    (r0, z0), (r1, z1) = profile.start, profile.end
    loop = [
        profile,
        Profile(f"{ring.name}_edge", "line", np.array([[r1, z1], [r1, back]])),
        Profile(f"{ring.name}_back", "line", np.array([[r1, back], [r0, back]])),
    ]
    if r0 > 0:
        loop.append(Profile(f"{ring.name}_bore", "line", np.array([[r0, back], [r0, z0]])))
    whole = _tidy(loop)
    return None if whole is None else _solid(ring.part, "mirror", axis, whole)


# ---- closed chains


def _closed(rings: Sequence[Ring]) -> tuple[list[list[Profile]], list[Ring]]:
    """Return closed chains of surface profiles, one for each body, and the surfaces that no chain closes."""
    profiles = [ring.profile for ring in rings]
    ends = np.array([[profile.start, profile.end] for profile in profiles])
    near = _near(profiles)
    nodes: list[Array] = []
    numbers = np.zeros((len(rings), 2), dtype=int)
    for k, end in np.ndindex(len(rings), 2):
        same = [n for n, node in enumerate(nodes) if np.abs(node - ends[k, end]).max() <= near]
        numbers[k, end] = same[0] if same else len(nodes)
        if not same:
            nodes.append(ends[k, end])
    loops, used = [], set()
    for chain in _components(numbers):
        degrees = Counter(numbers[chain].ravel().tolist())
        if any(degree != (1 if nodes[node][0] <= near else 2) for node, degree in degrees.items()):
            continue
        loop = _tidy(_in_turn(chain, numbers, profiles, [n for n in degrees if degrees[n] == 1]))
        if loop is not None:
            loops.append(loop)
            used.update(chain)
    return loops, [ring for k, ring in enumerate(rings) if k not in used]


def _components(numbers: npt.NDArray[np.int_]) -> Iterator[list[int]]:
    """
    Yield groups of profiles connected at their ends, as lists of indices.

    `numbers`, (n, 2): index of the point where each profile starts, and of that where it ends.
    """
    left = set(range(len(numbers)))
    while left:
        group = [left.pop()]
        for k in group:
            touching = [n for n in left if set(numbers[n]) & set(numbers[k])]
            left.difference_update(touching)
            group += touching
        yield sorted(group)


def _in_turn(
    chain: list[int], numbers: npt.NDArray[np.int_], profiles: list[Profile], free: list[int]
) -> list[Profile]:
    """
    Return the profiles of the indices `chain`, which are connected, in sequence, reversed where needed.

    They begin at the first free end, of the point indices `free`, or with the first profile if there is none. `numbers`
    are those of `_components`.
    """
    left = list(chain)
    here = free[0] if free else int(numbers[chain[0], 0])
    ordered = []
    while left:
        k = next((k for k in left if here in numbers[k]), None)
        if k is None:
            break
        left.remove(k)
        forwards = numbers[k, 0] == here
        ordered.append(profiles[k] if forwards else profiles[k].reversed())
        here = int(numbers[k, 1 if forwards else 0])
    return ordered


def _near(profiles: Sequence[Profile]) -> float:
    return min(JOINED_MM, CONNECTED * max(float(np.abs(profile.poles).max()) for profile in profiles))


def _tidy(loop: Sequence[Profile]) -> list[Profile] | None:
    """
    Return a chain of profiles as the closed border of a body to its left.

    Ends of lines are moved to join the next profile, and lines of no length are left out. None if a gap is left, the
    border crosses itself, or it encloses no volume.
    """
    ring = loop[0].start[0] > 0
    joined = list(loop)
    near = _near(joined)
    joined = [p for p in joined if p.kind != "line" or np.abs(p.end - p.start).max() > near]
    for k in range(len(joined) - (0 if ring else 1)):
        n = (k + 1) % len(joined)
        if np.abs(joined[k].end - joined[n].start).max() <= near:
            continue
        if joined[n].kind == "line":
            joined[n] = replace(joined[n], poles=np.array([joined[k].end, joined[n].end]))
        elif joined[k].kind == "line":
            joined[k] = replace(joined[k], poles=np.array([joined[k].start, joined[n].start]))
        else:
            return None
    if not ring and max(joined[0].start[0], joined[-1].end[0]) > near:
        return None
    border = [profile.points(2 if profile.kind == "line" else 33) for profile in joined]
    points = np.concatenate([own[:-1] for own in border] + [border[-1][-1:]])
    r, z = points.T
    area = 0.5 * float(np.sum(r * np.roll(z, -1) - np.roll(r, -1) * z))
    if not abs(area) > 0 or _crosses(points, ring):
        return None
    return joined if area > 0 else [profile.reversed() for profile in joined[::-1]]


def _crosses(points: Array, ring: bool) -> bool:
    """True if a polyline, (n, 2), crosses itself; with `ring` its ends coincide."""
    a, b = points[:-1], points[1:]
    k, n = np.triu_indices(len(a), 2)
    if ring:
        apart = (k != 0) | (n != len(a) - 1)
        k, n = k[apart], n[apart]

    def side(p: Array, q: Array, r: Array) -> Array:
        return np.asarray((q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0]))

    one = side(a[k], b[k], a[n]) * side(a[k], b[k], b[n]) < 0
    two = side(a[n], b[n], a[k]) * side(a[n], b[n], b[k]) < 0
    return bool(np.any(one & two))

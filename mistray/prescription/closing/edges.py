"""Edges, walls and stops that close a lens whose surfaces are placed anywhere in the world.

Neighbours on a common axis are moved to a frame of that axis, closed there by the generators of
`mistray.prescription.geometry`, and moved back to the world. Lenses in the beam between two mirrors are closed in the
same way; a space that ends at a mirror stays open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, TypeVar

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.pose import fixed_angles_deg
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.geometry import barrel, detector_frame, gas_of, is_gas, lens_edge, wall, whole_face
from mistray.prescription.model import Detector, Stop, Structure, Surface
from mistray.prescription.scatter import Scatter

Edges = Literal["blackened", "ground", "open"]
EDGES: tuple[Edges, ...] = ("blackened", "ground", "open")
Piece = TypeVar("Piece", bound=Surface | Structure)

_DIGITS_MM, _DIGITS_DEG = 10, 11  # of places in the world
_ROUND_OFF_MM = 1e-9
_ROUND_OFF_COSINE = 1e-13
_FLANGE = 1.02  # radius of a wall outside of both rims, by the larger one
_STOP_WIDTH = 1.25  # outer by inner radius of a stop that stands alone
_INSIDE = 0.999  # of the radius at which a stop's plane meets a surface
_SAMPLES = 513


@dataclass(frozen=True)
class StopPlane:
    """
    Aperture stop in a plane, without glass.

    Attributes
    ----------
    radius : float
        Radius of the opening, mm.
    frame : (4, 4) float64
        Transform from the frame of the stop to the world, mm.
    material : str
        Material around the stop.
    """

    radius: float
    frame: np.ndarray
    material: str = "air"


Item = Surface | StopPlane


def placed(piece: Piece, frame: np.ndarray) -> Piece:
    """Return a shape moved from a local frame, (4, 4), mm, to the world, rounded to 1e-10 mm and 1e-11 degrees."""
    world = frame @ piece.to_world()
    x, y, z = (round(float(v), _DIGITS_MM) + 0.0 for v in world[:3, 3])
    about_x, about_y, about_z = (round(angle, _DIGITS_DEG) + 0.0 for angle in fixed_angles_deg(world[:3, :3]))
    return replace(piece, x=x, y=y, z=z, tilt_deg=(about_x, about_y, about_z))


@dataclass
class Closing:
    """
    Builder of the mechanical faces that close a lens.

    Attributes
    ----------
    edges : str
        Kind of edges. "blackened": edges and the walls between lenses absorb. "ground": edges scatter a part of the
        light diffusely back into the glass and absorb the rest; walls absorb. "open": edges are polished, light leaves
        through them, and there are no walls.
    ground_reflectance : float
        Reflectance of ground edges, 0 … 1.
    structures : list of Structure or Surface
        Faces made so far.
    stop : Stop or None
        Stop on the world's axis; other stops are among the structures.
    spaces : int
        Number of air spaces so far that got a wall or a note that they have none.
    notes : list of str
        Notes on parts that could not be closed as usual.
    """

    edges: Edges
    ground_reflectance: float
    structures: list[Structure | Surface] = field(default_factory=list)
    stop: Stop | None = None
    notes: list[str] = field(default_factory=list)
    spaces: int = 0

    def close(self, items: Sequence[Item], ahead: Sequence[bool]) -> None:
        """
        Close all lens bodies and the spaces between neighbours with edges and walls.

        Parameters
        ----------
        items : sequence of Surface or StopPlane
            Surfaces and stops in the order of light, the detector last.
        ahead : sequence of bool
            Whether light arrives at each item along +z of its frame.
        """
        chain = list(zip(items, ahead, strict=True))
        self._bodies(chain)
        self._stops(chain)
        solids = [link for link in chain if isinstance(link[0], Surface)]
        for (one, forward), (other, _) in pairwise(solids):
            assert isinstance(one, Surface)
            assert isinstance(other, Surface)
            (a, _), (b, _) = map(whole_face, (one, other))
            if self._walled(a, b, forward):
                self._wall(a, b, forward)

    def _bodies(self, chain: list[tuple[Item, bool]]) -> None:
        """
        Add the edges of lens bodies; cemented bodies share a rim.

        `chain` pairs the items of `close` with their `ahead`. Glass between surfaces without a common axis gets a note
        instead.
        """
        run: list[Surface] = []
        forward = True
        done: set[tuple[str, str]] = set()
        solids = [(item, ahead) for item, ahead in chain if isinstance(item, Surface)]
        for k, (item, ahead) in enumerate(solids):
            follower = solids[k + 1][0] if k + 1 < len(solids) else None
            linked = follower is not None and not is_gas(_behind(item, ahead))
            if not run:
                forward = ahead
            run.append(item)
            if linked and follower is not None and _coaxial(item, follower) and not (item.mirror and len(run) > 1):
                continue
            if linked and follower is not None and not item.mirror:
                self.notes.append(
                    f"glass between '{item.name}' and '{follower.name}' has no common axis: it has no edges"
                )
            names = (run[0].name, run[-1].name)
            if len(run) > 1 and names not in done and names[::-1] not in done:
                self._body(run if forward else run[::-1], forward)
                done.add(names)
            # A mirror on the back of its glass begins the way back through it
            run = [item] if linked and item.mirror and len(run) > 1 else []
            forward = ahead if not item.mirror else not ahead

    def _body(self, run: list[Surface], forward: bool) -> None:
        """
        Add the edges of a lens body or of cemented bodies; `run` has their surfaces in the order of +z.

        `forward` says whether light goes through them in this order. A body of which a surface has an `outline` gets a
        note instead.
        """
        part = run[0].part or run[0].name
        whole = [whole_face(surface) for surface in run]
        if not all(_rimmed(surface) for surface, _ in whole):
            self.notes.append(f"part '{part}': it has no edges, for a circle about its axis would not go round it")
            return
        known = {piece.name for piece in self.structures}
        self.structures += [rest for _, rest in whole if rest is not None and rest.name not in known]
        frame, local = _local([surface for surface, _ in whole])
        rim = max(surface.outer_radius for surface in local)
        outside = gas_of(local[0].front, local[-1].back)
        coating = None if self.edges == "open" else BLACK
        faces: list[Structure] = []
        freeform = any(surface.sag for surface in local)
        try:
            for k, (first, second) in enumerate([] if freeform else pairwise(local)):
                own_part = (first if forward else second).part
                own = lens_edge(first, second, rim, part=own_part, coating=coating, outside=outside)
                # The ring in a cemented plane belongs to the lens before it
                faces += [face for face in own if k == 0 or not face.name.endswith("_flange_1")]
        except MistrayError:
            faces = []
            self.notes.append(f"part '{part}': its edge is a cone from rim to rim, a cylinder would cut into a surface")
        for k, (first, second) in enumerate([] if faces else pairwise(local)):
            # From the lowest point of the first rim to the highest of the second, so that no light gets out between;
            # the edge before has the first rim of a cemented body
            (low, high), ends = first.rim_heights, second.rim_heights
            points = [(first.outer_radius, z) for z in (high if k else low, high)]
            points += [(second.outer_radius, z) for z in ends]
            if first.outer_radius == second.outer_radius:
                points = [points[0], points[-1]]
            own_part = (first if forward else second).part
            name = f"{own_part}_edge"
            faces += wall(name, points, coating=coating, part=own_part, front=first.back, back=outside)
        self._put(faces, frame, self.edge_scatter)

    def _stops(self, chain: list[tuple[Item, bool]]) -> None:
        for k, (item, ahead) in enumerate(chain):
            if not isinstance(item, StopPlane):
                continue
            limit, outer = np.inf, item.radius * _STOP_WIDTH
            for i, above in ((k - 1, not ahead), (k + 1, ahead)):
                surface = chain[i][0] if 0 <= i < len(chain) else None
                if isinstance(surface, Surface) and on_axis(surface.to_world(), item.frame):
                    outer = max(outer, surface.outer_radius)
                    limit = min(limit, meets_plane(surface, item.frame, above))
            outer = min(outer, limit * _INSIDE)
            if outer <= item.radius:
                self.notes.append("the stop lies inside the bulge of a lens: the clear radius of that surface limits")
                continue
            upright = on_axis(np.eye(4), item.frame)
            if upright and is_gas(item.material):
                z = float(item.frame[2, 3])
                self.stop = Stop(item.radius, z, z, outer, outer)
            else:
                glass = item.material
                ring = Structure("stop_front", outer, 0.0, item.radius, 0.0, front=glass, back=glass, part="stop")
                self.structures.append(placed(ring, item.frame))

    def _walled(self, a: Surface, b: Surface, forward: bool) -> bool:
        both = self.edges != "open" and not a.mirror and not b.mirror and _rimmed(a) and _rimmed(b)
        return both and is_gas(_behind(a, forward)) and _coaxial(a, b)

    def _wall(self, a: Surface, b: Surface, forward: bool) -> None:
        frame, local = _local([a, b] if forward else [b, a])
        first, second = local
        self.spaces += 1
        try:
            faces = barrel((first, second), first_space=self.spaces)
        except MistrayError as error:
            r_1, r_2, z_1, z_2 = first.outer_radius, second.outer_radius, first.rim_heights[1], second.rim_heights[0]
            if z_2 <= z_1:
                self.notes.append(f"the space between '{a.name}' and '{b.name}' is open: {error}")
                return
            outside = max(r_1, r_2) * _FLANGE
            points = [(r_1, z_1), (outside, z_1), (outside, z_2), (r_2, z_2)]
            material = first.back
            name = f"barrel_{self.spaces}_wall"
            faces = wall(name, points, coating=BLACK, part="barrel", space=self.spaces, front=material, back=material)
        self._put(faces, frame)
        for surface in local:
            if isinstance(surface, Detector) and surface.half_width is not None:
                board = detector_frame(surface, space=self.spaces)
                self._put(board, frame)

    def _put(self, faces: Sequence[Structure | Surface], frame: np.ndarray, scatter: tuple[Scatter, ...] = ()) -> None:
        for face in faces:
            own = replace(face, scatter=scatter) if scatter else face
            self.structures.append(own if np.array_equal(frame, np.eye(4)) else placed(own, frame))

    @property
    def edge_scatter(self) -> tuple[Scatter, ...]:
        """Scatter models for ground lens edges; () for other kinds of edges."""
        if self.edges != "ground":
            return ()
        return (Scatter("paint", {"reflectance": self.ground_reflectance}, name="ground_edge"),)


def mirror_back(
    mirror: Surface, ahead: bool, thickness: float, coating: Coating = BLACK
) -> tuple[Surface | Structure, ...]:
    """
    Return a rear face and a rim that turn a mirror into a body, so that light from behind is absorbed.

    Parameters
    ----------
    mirror : Surface
        Mirror in the world.
    ahead : bool
        Whether light arrives along +z of the mirror's frame, so that its rear lies on the +z side.
    thickness : float
        Thickness of the body, mm, > 0.
    coating : Coating
        Coating of the rear and of the walls.

    Returns
    -------
    tuple of Surface or Structure
        Face ``<mirror>_rear``, in the world. A mirror with a semi-diameter also has the wall ``<mirror>_rim`` and,
        around a hole, ``<mirror>_bore``.
    """
    step = thickness if ahead else -thickness
    frame = mirror.to_world()
    here = replace(mirror, x=0.0, y=0.0, z=0.0, tilt_deg=(0.0, 0.0, 0.0))
    part = mirror.part or mirror.name
    rear = replace(here, name=f"{mirror.name}_rear", z=step, coating=coating, mirror=False, part=part)
    if mirror.semi_diameter is None:
        return (placed(rear, frame),)
    walls = [("rim", here.outer_radius)]
    if here.inner_semi_diameter > 0:
        walls.append(("bore", here.inner_semi_diameter))
    result: list[Surface | Structure] = [placed(rear, frame)]
    for name, r in walls:
        z = float(here.z_at(r))
        wall = Structure(
            f"{mirror.name}_{name}", r, z, r, z + step,
            front=mirror.front, back=mirror.front, coating=coating, part=part,
        )  # fmt: skip
        result.append(placed(wall, frame))
    return tuple(result)


def _rimmed(surface: Surface) -> bool:
    """True if walls can join a surface in a circle about its axis."""
    return surface.outline is None and bool(np.isfinite(surface.rim_heights).all())


def _behind(surface: Surface, ahead: bool) -> str:
    """Return the material behind a surface, as seen by light along +z if `ahead`, else -z; for a mirror its back."""
    return surface.back if ahead or surface.mirror else surface.front


def on_axis(a: np.ndarray, b: np.ndarray) -> bool:
    """True if the origin of frame `b` lies on the z axis of frame `a`, (4, 4), mm, and their z axes agree."""
    turn = a[:3, :3]
    offset = turn.T @ (b[:3, 3] - a[:3, 3])
    same_way = turn[:, 2] @ b[:3, 2] > 1 - _ROUND_OFF_COSINE
    return bool(np.hypot(offset[0], offset[1]) < _ROUND_OFF_MM * (1 + abs(offset[2])) and same_way)


def _coaxial(a: Surface, b: Surface) -> bool:
    return on_axis(a.to_world(), b.to_world())


def _local(run: Sequence[Surface]) -> tuple[np.ndarray, list[Surface]]:
    """Return the frame of the surfaces' common axis, a transform to the world, (4, 4), mm, and the surfaces in it."""
    if all(surface.coaxial for surface in run):
        return np.eye(4), list(run)
    frame = run[0].to_world()
    places = [np.linalg.inv(frame) @ surface.to_world() for surface in run]
    return frame, [
        replace(surface, x=0.0, y=0.0, z=float(own[2, 3]), tilt_deg=(0.0, 0.0, fixed_angles_deg(own[:3, :3])[2]))
        for surface, own in zip(run, places, strict=True)
    ]


def meets_plane(surface: Surface, plane: np.ndarray, above: bool) -> float:
    """
    Return the smallest radius, mm, at which a surface lies on the wrong side of a plane; infinite if nowhere.

    `plane` is a frame coaxial with the surface, (4, 4), mm. With `above` the surface should lie on its +z side, else on
    its -z side.
    """
    z = float((np.linalg.inv(surface.to_world()) @ plane)[2, 3])
    r = np.linspace(0.0, surface.outer_radius, _SAMPLES)
    gap = replace(surface, x=0.0, y=0.0, z=0.0, tilt_deg=(0.0, 0.0, 0.0)).z_at(r) - z
    wrong = (gap if above else -gap) < -_ROUND_OFF_MM
    return float(r[np.argmax(wrong)]) if np.any(wrong) else np.inf

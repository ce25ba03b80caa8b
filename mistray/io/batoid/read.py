"""Reader of telescopes from batoid (https://github.com/jmeyers314/batoid): mirrors, lenses, baffles, detector.

batoid works in metres and its light comes from above, along -z. The world frame is kept and lengths are converted to
mm, so positions on the detector compare directly. The source is turned by 180° about the y axis of the optic's frame,
which is that of the world for a telescope that is not turned. Its ``field_deg`` is batoid's ``theta_y``; with
``azimuth_deg`` φ, theta_x = θ sin φ and theta_y = θ cos φ (projection "postel").

batoid traces sequentially and drops light that falls outside a clear aperture. Here every consecutive run of refracting
surfaces, the detector included, is closed into one black tube (`barrel`), so that light clipped in the camera is
absorbed, as in batoid. Light that misses a mirror escapes. A non-sequential ray may also meet a surface out of turn,
for example the outside of the camera's tube on its way from the secondary to the tertiary; batoid cannot see that.
Baffles are open where the light of the design crosses them out of turn, see `mistray.io.batoid.design_light`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.errors import MistrayError
from mistray.files.packages import package
from mistray.io.batoid.design_light import MARGIN, BatoidLight, pupil, without
from mistray.io.batoid.file import read_optic
from mistray.io.batoid.obscurations import clear_outline, is_open, opaque_outlines
from mistray.physics.geometry.outline import Outline, OutlineFigure
from mistray.physics.geometry.pose import fixed_angles_deg
from mistray.physics.sags.grid import Grid
from mistray.prescription.bodies.placing import moved_as_one
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.geometry import barrel
from mistray.prescription.imported_beam import Fill, beam_size, check_beam
from mistray.prescription.model import Detector, Placed, Prescription, Structure, Surface
from mistray.prescription.sources import Source

if TYPE_CHECKING:
    import batoid

M_TO_MM = 1e3
_PIXELS = (512, 512)
SAME_AXIS = 1e-9  # by which surfaces of a tube may lie beside its axis, in units of their radius
NEEDED = 1e-3  # share of the light in its turn that a plate must shade
LARGEST_HOLE = 0.8  # in a mirror, in units of its radius
SEEN = 400  # points each way at which a plate is looked for


def from_batoid(
    optic: batoid.Optic | str | Path,
    *,
    wavelength_nm: float,
    reflectance: float | None = None,
    baffle_radius: float | None = None,
    field_deg: float | None = None,
    beam: Fill = "pupil",
) -> Prescription:
    """
    Return a batoid telescope as a prescription, in mm.

    Parameters
    ----------
    optic : batoid.Optic, str or Path
        Usually a CompoundOptic, for example ``batoid.Optic.fromYaml("LSST_r.yaml")``, or a YAML file of one. A file is
        checked before batoid reads it, see `mistray.io.batoid.file`. Pass the path if you do not trust the author of
        the file, because ``fromYaml`` runs code in it. The elements Mirror, RefractiveInterface, Detector and Baffle
        are read, alone or in a Lens or a CompoundOptic. So are the surfaces Plane, Sphere, Paraboloid, Quadric,
        Asphere, Zernike over a full disc, Bicubic, Tilted, and sums of them with one conic and one Bicubic at most, and
        Zernikes over one disc. Obscurations of every kind are read.
    wavelength_nm : float
        Vacuum wavelength, nm, at which media become constant indices.
    reflectance : float or None
        Reflectance R of every refracting surface (T = 1 - R) and of the detector. ``None``: batoid's own coatings,
        which by default reflect nothing, so that there are no ghosts.
    baffle_radius : float or None
        Outer radius in mm of baffles that batoid describes by their opening alone. ``None``: they extend as far as the
        beam that they shade.
    field_deg : float or None
        Field angle of the edge of the field, degrees. Light from there decides how large surfaces without an aperture
        are and where baffles are open. ``None``: the angle at which the centroid lies on the rim of the detector, 10°
        at most, or 1° if the detector has no known radius.
    beam : {"pupil", "exact"}
        Whether the source is wider than the pupil by a twentieth of its radii, or exactly as wide; see docs/import.md.

    Returns
    -------
    Prescription
        Telescope with a round or annular source that fills the pupil. The pupil has the radii ``pupilSize/2`` and
        ``pupilSize * pupilObscuration/2`` in the plane of the stop surface, as in `batoid.RayVector.asPolar`.
        `provenance` names the baffles that got a hole or an outer radius on import.

    Raises
    ------
    MistrayError
        If batoid is missing, the file cannot be read, an element, surface or coating has no counterpart, or
        `baffle_radius` is not greater than the opening of a baffle. The message names the element.

    Examples
    --------
    >>> import batoid
    >>> hsc = batoid.Optic.fromYaml("HSC.yaml")
    >>> telescope = mistray.prescription.from_batoid(hsc, wavelength_nm=750)
    >>> telescope.surfaces[0].name, telescope.surfaces[0].mirror
    ('PM', True)
    """
    batoid = package("batoid files need batoid", "batoid", "batoid")
    check_beam(beam)
    if isinstance(optic, str | Path):
        optic = read_optic(optic)
    source, notes = _source(optic, wavelength_nm, beam)
    reader = _Reader(batoid, optic, wavelength_nm, reflectance, baffle_radius, field_deg)
    for element in _elements(optic):
        reader.add(element)
    reader.close_group()
    return Prescription(
        name=str(optic.name),
        surfaces=tuple(reader.surfaces),
        structures=tuple(reader.structures),
        detector=reader.detector,
        source=source,
        provenance="\n".join(
            [
                f"From batoid {batoid.__version__}, optic '{optic.name}', at {wavelength_nm:g} nm.",
                *notes,
                *reader.notes,
                *(reader.detector.notes() if reader.detector else ()),
            ]
        ),
    )


def _elements(optic: Any) -> Iterator[tuple[str, Any]]:
    """Yield pairs (part, interface) in the order of light; surfaces of a lens have the lens's name as their part."""
    for item in getattr(optic, "items", ()):
        if hasattr(item, "items"):
            is_lens = type(item).__name__ == "Lens"
            for part, interface in _elements(item):
                yield (item.name if is_lens else part), interface
        else:
            yield item.name, item
    if not hasattr(optic, "items"):
        yield optic.name, optic


def _source(optic: Any, wavelength_nm: float, beam: Fill) -> tuple[Source, list[str]]:
    outer, inner = pupil(optic)
    stop = getattr(optic, "stopSurface", None)
    origin = np.zeros(3) if stop is None else np.asarray(stop.coordSys.origin)
    x, y, z = (float(value) * M_TO_MM for value in origin)
    size, notes = beam_size(beam, outer * M_TO_MM, inner=inner * M_TO_MM)
    about_x, about_y, about_z = fixed_angles_deg(np.asarray(optic.coordSys.rot))
    tilt = (0.0 - about_x, about_y + 180.0, about_z)  # Rz Ry Rx Ry(180°) = Rz Ry(180°) Ry Rx⁻¹
    place: Any = {"x": x, "y": y, "z": z, "tilt_deg": tilt}
    return Source(**place, **size, plane="axis", wavelength_nm=(float(wavelength_nm),)), notes


@dataclass
class _Reader:
    """
    Converter of batoid's optics to surfaces and structures, element by element in the order of light.

    Attributes
    ----------
    batoid, optic
        The package, and the telescope to convert.
    wavelength_nm, reflectance, baffle_radius, field_deg
        Arguments of `from_batoid`, in nm, mm and degrees.
    surfaces, structures, detector
        Surfaces, structures and detector converted so far; the detector is None at first.
    direction : (3,) float64
        Unit vector, in the world, along the light behind the last mirror so far; -z of the optic's frame at first.
    group : list of Surface
        Refracting surfaces since the last mirror, and the detector, which get walls from `close_group`.
    notes : list of str
        Assumptions, one sentence or phrase each.
    """

    batoid: Any
    optic: Any
    wavelength_nm: float
    reflectance: float | None
    baffle_radius: float | None
    field_deg: float | None
    surfaces: list[Surface] = field(default_factory=list)
    structures: list[Structure | Surface] = field(default_factory=list)
    detector: Detector | None = None
    direction: np.ndarray = field(init=False)
    group: list[Surface] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.direction = -np.asarray(self.optic.coordSys.rot)[:, 2]

    @cached_property
    def light(self) -> BatoidLight:
        """Design beam of the telescope, from which the shapes of baffles are found."""
        edge = None if self.field_deg is None else math.radians(self.field_deg)
        return BatoidLight(self.batoid, self.optic, self.wavelength_nm, edge)

    def add(self, element: tuple[str, Any]) -> None:
        """
        Convert one pair (part, interface) to surfaces or structures, and add them to the telescope.

        An interface without optical effect adds nothing. Raise `MistrayError` if the kind of an element has no
        counterpart.
        """
        part, interface = element
        kind = type(interface).__name__
        name = _id(interface.name)
        if kind == "Baffle":
            self.structures += self._baffle(name, interface)
        elif kind == "Mirror":
            self.close_group()
            shape = self._with_hole(interface, self._shape(interface)) | self._placing(interface)
            index = self._index(interface.inMedium)
            self.surfaces.append(
                Surface(name, **shape, front=index, back=index, coating=self._mirror_coating(interface), mirror=True)
            )
            axis = np.asarray(interface.coordSys.rot)[:, 2]
            self.direction = self.direction - 2 * (self.direction @ axis) * axis
        elif kind in ("RefractiveInterface", "Detector"):
            shape = self._shape(interface) | self._placing(interface)
            ahead = self.direction @ np.asarray(interface.coordSys.rot)[:, 2] > 0
            media = [self._index(interface.inMedium), self._index(interface.outMedium or interface.inMedium)]
            front, back = media if ahead else media[::-1]
            sides: dict[str, Any] = {"front": front, "back": back}
            if kind == "Detector":
                r = self._refracting_coating(interface).R
                self.detector = Detector(name, **shape, **sides, coating=Coating(R=r), pixels=_PIXELS)
                self.group.append(self.detector)
                self.close_group()
            else:
                coating = self._refracting_coating(interface)
                surface = Surface(name, **shape, **sides, coating=coating, part=_id(part))
                self.surfaces.append(surface)
                self.group.append(surface)
        elif kind != "Interface" or interface.obscuration is not None:
            raise MistrayError(
                f"batoid element '{interface.name}': {kind} has no counterpart; remove it from the optic"
            )

    def close_group(self) -> None:
        """
        Add walls between the refracting surfaces of the current group of lenses, and end the group.

        A group without a common axis gets a note instead of walls. A single surface gets neither.
        """
        group, self.group = self.group, []
        if len(group) < 2:
            return
        taken = sum(piece.part == "barrel" for piece in self.structures)
        if all(surface.coaxial for surface in group):
            if self.direction[2] < 0:
                group.reverse()
            self.structures += barrel(group, first_space=taken + 1)
            return
        frame = group[0].to_world()
        local = []
        for surface in group:
            matrix = np.linalg.inv(frame) @ surface.to_world()
            if max(np.abs(matrix[:2, 3]).max(), np.abs(matrix[:2, 2]).max()) > SAME_AXIS * surface.outer_radius:
                self._note(f"lens group of '{surface.name}': its surfaces have no common axis; it has no tube")
                return
            local.append(replace(surface, x=0.0, y=0.0, z=float(matrix[2, 3]), tilt_deg=(0.0, 0.0, 0.0)))
        if self.direction @ frame[:3, 2] < 0:
            local.reverse()
        place = {key: getattr(group[0], key) for key in ("x", "y", "z", "tilt_deg")}
        self.structures += moved_as_one(barrel(local, first_space=taken + 1), **place)

    def _shape(self, interface: Any) -> dict[str, Any]:
        """Return the figure and clear aperture of an optical surface as arguments of `Surface`, in mm."""
        return self._figure(interface) | self._aperture(interface)

    def _figure(self, interface: Any) -> dict[str, Any]:
        """
        Return radius, conic and sag of a surface as arguments of `Surface`, mm.

        Raise `MistrayError` for a surface that has no counterpart.
        """
        shape: dict[str, Any] = {}
        sag: dict[str, Any] = {}
        radii: set[float] = set()  # of the discs of Zernikes, m
        surface = interface.surface
        for part in surface.surfaces if type(surface).__name__ == "Sum" else (surface,):
            kind = type(part).__name__
            if kind in ("Sphere", "Paraboloid", "Quadric", "Asphere") and "radius" not in shape:
                shape["radius"] = float(part.R) * M_TO_MM
                shape["conic"] = -1.0 if kind == "Paraboloid" else float(getattr(part, "conic", 0.0))
            elif kind == "Tilted":
                _add(sag, {"slope_x": float(part.tanx), "slope_y": float(part.tany)})
            elif kind == "Zernike" and not part.R_inner and radii <= {part.R_outer}:
                _add(sag, {f"zernike_{j}": float(c) * M_TO_MM for j, c in enumerate(part.coef) if j and c})
                radii.add(part.R_outer)
                sag["zernike_radius"] = float(part.R_outer) * M_TO_MM
            elif kind == "Bicubic" and "grid" not in sag:
                sag["grid"] = _grid(part)
            elif kind != "Plane":
                raise MistrayError(
                    f"batoid element '{interface.name}': surface {kind} has no counterpart here; use one conic, "
                    "Zernikes over one full disc, one Bicubic and Tilted"
                )
            if kind == "Asphere":
                coefficients = dict(enumerate((float(a) for a in part.coefs), start=part.imin))
                if first := coefficients.pop(1, 0.0):
                    sag["a2"] = first / M_TO_MM
                orders = range(2, max(coefficients, default=1) + 1)
                shape["coefficients"] = tuple(coefficients.get(i, 0.0) * M_TO_MM ** (1 - 2 * i) for i in orders)
        return shape | ({"sag": sag} if sag else {})

    def _with_hole(self, interface: Any, shape: dict[str, Any]) -> dict[str, Any]:
        """
        Return a mirror's shape, mm, with a central hole if it is round and light passes there to the detector.

        A mirror that has a hole keeps it. No hole is made if it would take most of the mirror.
        """
        if "semi_diameter" not in shape or shape.get("inner_semi_diameter"):
            return shape
        hole = max((outer for _, outer in self.light.crossings(interface)), default=0.0) * M_TO_MM
        if not 0 < hole < LARGEST_HOLE * shape["semi_diameter"]:
            return shape
        self._note(f"mirror '{interface.name}': light goes through its middle; it has a hole of {hole:.6g} mm radius")
        return shape | {"inner_semi_diameter": hole}

    def _aperture(self, interface: Any) -> dict[str, Any]:
        o = self.batoid.obscuration
        obscuration = interface.obscuration
        original = obscuration.original if isinstance(obscuration, o.ObscNegation) else None
        if isinstance(original, o.ObscCircle) and original.x == original.y == 0:
            return {"semi_diameter": original.radius * M_TO_MM}
        if isinstance(original, o.ObscAnnulus) and original.x == original.y == 0:
            return {"semi_diameter": original.outer * M_TO_MM, "inner_semi_diameter": original.inner * M_TO_MM}
        radius = self.light.beam_radius(interface)
        if obscuration is None:
            inner = (1 - MARGIN) * self.light.beam_ring(interface)[0] * M_TO_MM
            mirror = type(interface).__name__ == "Mirror"
            hole = {"inner_semi_diameter": inner} if mirror and inner > 0 else {}
            self._note(
                f"surface '{interface.name}': no aperture is known; it ends with the beam, at {radius * M_TO_MM:.6g} mm"
            )
            return {"semi_diameter": radius * M_TO_MM} | hole
        return {"outline": clear_outline(obscuration, radius, f"batoid element '{interface.name}'")}

    def _placing(self, interface: Any) -> dict[str, Any]:
        x, y, z = (float(value) * M_TO_MM for value in interface.coordSys.origin)
        return {"x": x, "y": y, "z": z, "tilt_deg": fixed_angles_deg(np.asarray(interface.coordSys.rot))}

    def _index(self, medium: Any) -> str:
        n = float(medium.getN(self.wavelength_nm * 1e-9))
        return "vacuum" if n == 1 else repr(n)

    def _mirror_coating(self, interface: Any) -> Coating:
        r, t = interface.forwardCoating.getCoefs(self.wavelength_nm * 1e-9, 1.0)
        return Coating(R=float(r), T=float(t)) if t else Coating(R=float(r))

    def _refracting_coating(self, interface: Any) -> Coating:
        if self.reflectance is not None:
            return Coating(R=self.reflectance, T=1 - self.reflectance)
        both = [interface.forwardCoating, interface.reverseCoating or interface.forwardCoating]
        if not all(isinstance(coating, self.batoid.SimpleCoating) for coating in both) or both[0] != both[1]:
            raise MistrayError(
                f"batoid element '{interface.name}': only one SimpleCoating for both sides has a counterpart; pass "
                "reflectance="
            )
        return Coating(R=float(both[0].reflectivity), T=float(both[0].transmissivity))

    def _baffle(self, name: str, interface: Any) -> list[Structure | Surface]:
        """
        Return opaque plates, mm, of a baffle, without those already made for an earlier pass of light.

        The list is empty if the baffle has no obscuration, or is the central hole of a flat mirror.
        """
        if interface.obscuration is None:
            return []
        placing = self._placing(interface)
        if self._is_hole(interface, placing):
            return []
        flat = type(interface.surface).__name__ == "Plane"
        plates = self._rings(name, interface, placing) if flat else None
        if plates is None:
            plates = self._plates(name, interface, placing)
        return [
            plate
            for k, plate in enumerate(plates)
            if not any(_same_place(plate, other) for other in (*self.structures, *plates[:k]))
        ]

    def _is_hole(self, interface: Any, placing: dict[str, Any]) -> bool:
        """True if a baffle in the plane of a flat mirror is that mirror's central hole; the mirror then gets it."""
        original = getattr(interface.obscuration, "original", None)
        if not isinstance(original, self.batoid.obscuration.ObscCircle) or original.x or original.y:
            return False
        here = Placed(**placing).to_world()
        for number, mirror in enumerate(self.surfaces):
            apart = np.linalg.inv(mirror.to_world()) @ here
            same = np.linalg.norm(apart[:3, 3]) < SAME_AXIS * mirror.outer_radius and abs(apart[2, 2]) > 1 - SAME_AXIS
            if same and mirror.mirror and not mirror.curvature and not mirror.freeform:
                hole = original.radius * M_TO_MM
                self.surfaces[number] = replace(mirror, inner_semi_diameter=hole)
                self._note(f"baffle '{interface.name}': it is the hole of {hole:.6g} mm radius in '{mirror.name}'")
                return True
        return False

    def _rings(self, name: str, interface: Any, placing: dict[str, Any]) -> list[Structure | Surface] | None:
        """
        Return the centred rings of a baffle as structures, mm, less the parts that light crosses out of turn.

        The result is empty if nothing is left, or if the baffle's opening is wider than the beam. It is None if the
        obscuration has other parts, or if a part to be cut away shades light in its turn. `placing` has the position,
        mm, and the angles of the baffle.
        """
        whole = self._centred(interface, interface.obscuration)
        if whole is None:
            return None
        rings = without(whole, self.light.crossings(interface))
        if self.light.shaded(interface, whole) - self.light.shaded(interface, rings) > NEEDED:
            return None  # what would be cut away shades light in its turn: a plate that shades one way
        if rings != whole:
            left = " and ".join(f"{inner * M_TO_MM:.6g} … {outer * M_TO_MM:.6g} mm" for inner, outer in rings)
            self._note_cut(interface, f"what is left of its plate is {left}" if rings else "it is left out")
        return [
            Structure(
                name if len(rings) == 1 else f"{name}_{number}",
                outer * M_TO_MM,
                0.0,
                inner * M_TO_MM,
                0.0,
                part=name,
                **placing,
            )
            for number, (inner, outer) in enumerate(rings, start=1)
        ]

    def _plates(self, name: str, interface: Any, placing: dict[str, Any]) -> list[Structure | Surface]:
        """
        Return a plate, a surface in mm, for each opaque outline of a baffle.

        If light also crosses the plates in the opposite direction, they shade only light in the direction of the first
        pass.
        """
        owner = f"batoid element '{interface.name}'"
        end = self.light.beam_radius(interface)
        if is_open(interface.obscuration):
            self._note(f"baffle '{interface.name}': it ends with the beam, at {end * M_TO_MM:.6g} mm")
        outlines = opaque_outlines(interface.obscuration, end, owner)
        # It shades as in its turn: light that comes the other way goes through
        way = self.light.way(interface)
        holes = self.light.crossings(interface, way)
        if holes:
            text = " and ".join(f"{inner * M_TO_MM:.6g} … {outer * M_TO_MM:.6g} mm" for inner, outer in holes)
            self._note_cut(interface, f"its parts are open at {text}")
        if len(self.light.crossings(interface)) > len(holes):
            self._note(f"baffle '{interface.name}': light comes through it the other way; it shades one way only")
        else:
            way = 0
        shape = {key: value for key, value in self._figure(interface).items()}
        for inner, outer in holes:
            outlines = [cut for outline in outlines for cut in _without_ring(outline, inner, outer)]
        outlines = [outline for outline in outlines if outline.sample(SEEN)[0].size]
        return [
            Surface(
                name if len(outlines) == 1 else f"{name}_{number}",
                outline=outline,
                meets={0: "both", 1: "+z", -1: "-z"}[way],
                coating=BLACK,
                **shape,
                part=name,
                **placing,
            )
            for number, outline in enumerate(outlines, start=1)
        ]

    def _note_cut(self, interface: Any, what: str) -> None:
        self._note(f"baffle '{interface.name}': light that reaches the detector crosses it out of turn; {what}")

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _centred(self, interface: Any, obscuration: Any) -> list[tuple[float, float]] | None:
        """
        Return opaque rings as (inner, outer) radii, m; None if the obscuration is not made of centred rings.

        The list is empty if a baffle that is known by its opening alone reaches no further than this opening.
        Raise `MistrayError` if `baffle_radius` is not greater than the opening.
        """
        o = self.batoid.obscuration
        if isinstance(obscuration, o.ObscUnion):
            parts = [self._centred(interface, item) for item in obscuration.items]
            return None if None in parts else [ring for part in parts for ring in part or ()]
        clear = isinstance(obscuration, o.ObscNegation)
        circle = obscuration.original if clear else obscuration
        if not isinstance(circle, o.ObscCircle | o.ObscAnnulus) or circle.x or circle.y:
            return None
        inner, outer = (0.0, circle.radius) if isinstance(circle, o.ObscCircle) else (circle.inner, circle.outer)
        if not clear:
            return [(inner, outer)]
        if self.baffle_radius is not None and self.baffle_radius <= outer * M_TO_MM:
            raise MistrayError(
                f"batoid element '{interface.name}': its opening is {outer * M_TO_MM:g} mm; pass a baffle_radius= "
                "greater than that"
            )
        if self.baffle_radius is None:
            end = self.light.beam_radius(interface)
            what = f"its plate ends with the beam, at {end * M_TO_MM:.6g} mm" if end > outer else "it shades no beam"
            self._note(f"baffle '{interface.name}': only its opening of {outer * M_TO_MM:.6g} mm is known; {what}")
        else:
            end = self.baffle_radius / M_TO_MM
        return [(0.0, inner)] * (inner > 0) + [(outer, end)] * (end > outer)


def _without_ring(outline: Outline, inner: float, outer: float) -> list[Outline]:
    """Return the outlines (mm) outside and, if any, inside a centred ring (m) that is cut out of an outline."""
    parts = [Outline((*outline.figures, OutlineFigure("circle", "-", sizes=(outer * M_TO_MM,))))]
    if inner > 0:
        parts.append(Outline((*outline.figures, OutlineFigure("circle", "&", sizes=(inner * M_TO_MM,)))))
    return parts


def _add(sag: dict[str, Any], terms: dict[str, float]) -> None:
    """Add terms to those of the same names in a sag."""
    sag |= {name: sag.get(name, 0.0) + value for name, value in terms.items()}


def _id(name: str) -> str:
    return str(name).replace(".", "_")


def _same_place(a: Any, b: Any) -> bool:
    keys = ("r0", "z0", "r1", "z1") if isinstance(a, Structure) else ("outline",)
    return type(a) is type(b) and all(getattr(a, key) == getattr(b, key) for key in (*keys, "x", "y", "z", "tilt_deg"))


def _grid(part: Any) -> Grid:
    """Return a bicubic surface of batoid as a grid of sags, mm."""
    corners = np.stack([part.zs * M_TO_MM, part.dzdxs, part.dzdys, part.d2zdxdys / M_TO_MM], axis=-1)
    step = float(part.xs[1] - part.xs[0]) * M_TO_MM, float(part.ys[1] - part.ys[0]) * M_TO_MM
    middle = 0.5 * float(part.xs[0] + part.xs[-1]) * M_TO_MM, 0.5 * float(part.ys[0] + part.ys[-1]) * M_TO_MM
    return Grid(corners, step, middle)

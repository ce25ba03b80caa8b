"""Telescopes from batoid (https://github.com/jmeyers314/batoid): mirrors, lenses, baffles, detector.

batoid works in metres and its light comes from above, along -z. The world frame is kept, only metres become mm, so
positions on the detector compare directly; the source is turned by 180° about y. Its ``field_deg`` is batoid's
``theta_y``; with ``azimuth_deg`` φ, theta_x = θ sin φ and theta_y = θ cos φ (projection "postel").

batoid traces sequentially and drops what falls outside of a clear aperture. Here every consecutive run of refracting
surfaces, the detector included, is closed into one black tube (`barrel`), so that light clipped in the camera is
absorbed as it is there. Light that misses a mirror escapes. A non-sequential ray may also meet a surface out of turn,
for example the outside of the camera's tube on its way from the secondary to the tertiary; batoid cannot see that.
Baffles are open where the light of the design crosses them out of turn, see `batoid_baffles`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.errors import MistrayError
from mistray.io.batoid.design_light import DesignLight, without
from mistray.io.batoid.file import read_optic
from mistray.physics.geometry.pose import fixed_angles_deg
from mistray.prescription.coating import Coating
from mistray.prescription.geometry import barrel
from mistray.prescription.model import Detector, Prescription, Source, Structure, Surface

if TYPE_CHECKING:
    import batoid

M_TO_MM = 1e3
_PIXELS = (512, 512)


def from_batoid(
    optic: batoid.Optic | str | Path,
    *,
    wavelength_nm: float,
    reflectance: float | None = None,
    baffle_radius: float | None = None,
) -> Prescription:
    """Read a batoid telescope.

    Parameters
    ----------
    optic : batoid.Optic, str or Path
        Usually a CompoundOptic, for example ``batoid.Optic.fromYaml("LSST_r.yaml")``, or a YAML file of one. A file is
        checked before batoid reads it, see `mistray.io.batoid.file`: use the path where you do not know who
        wrote the file, because ``fromYaml`` runs what it finds there. Understood: Mirror,
        RefractiveInterface, Lens, CompoundOptic, Detector, Baffle; Plane, Sphere, Paraboloid, Quadric, Asphere;
        ClearCircle, ClearAnnulus, ObscCircle, ObscAnnulus and unions of the last two on baffles.
    wavelength_nm : float
        Vacuum wavelength; media become constant indices.
    reflectance : float or None
        R of every refracting surface (T = 1 - R) and of the detector; ``None``: batoid's own coatings, which by default
        reflect nothing, so that there are no ghosts.
    baffle_radius : float or None
        Outer radius in mm of baffles that batoid describes by their opening alone. ``None``: they reach as far as the
        beam that they shade.

    Returns
    -------
    Prescription
        With a round or annular source that fills the pupil as `batoid.RayVector.asPolar` does by default: radii
        ``pupilSize/2`` and ``pupilSize * pupilObscuration/2`` in the plane of the stop surface. `provenance` names the
        baffles that got a hole or an outer radius here.

    Raises
    ------
    MistrayError
        If batoid is missing, the file cannot be read or an element is of a kind that has no counterpart; the message
        names the element.
    """
    try:
        import batoid
    except ImportError:
        raise MistrayError("batoid is not installed; run: pip install 'mistray[batoid]'") from None
    if isinstance(optic, str | Path):
        optic = read_optic(optic)
    source = _source(optic, wavelength_nm)
    reader = _Reader(batoid, optic, wavelength_nm, reflectance, baffle_radius)
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
            [f"From batoid {batoid.__version__}, optic '{optic.name}', at {wavelength_nm:g} nm.", *reader.notes]
        ),
    )


def _elements(optic: Any) -> Iterator[tuple[str, Any]]:
    """Interfaces in the order of light; each lens passes its name on to its surfaces as ``(part, interface)``."""
    for item in getattr(optic, "items", ()):
        if hasattr(item, "items"):
            is_lens = type(item).__name__ == "Lens"
            for part, interface in _elements(item):
                yield (item.name if is_lens else part), interface
        else:
            yield item.name, item
    if not hasattr(optic, "items"):
        yield optic.name, optic


def _source(optic: Any, wavelength_nm: float) -> Source:
    size = getattr(optic, "pupilSize", None)
    if not size:
        raise MistrayError(f"batoid element '{optic.name}': it has no pupilSize; set it, in metres")
    stop = getattr(optic, "stopSurface", None)
    origin = np.zeros(3) if stop is None else np.asarray(stop.coordSys.origin)
    x, y, z = (float(value) * M_TO_MM for value in origin)
    return Source(
        x=x,
        y=y,
        z=z,
        tilt_deg=(0.0, 180.0, 0.0),
        radius=size / 2 * M_TO_MM,
        inner_radius=size * (getattr(optic, "pupilObscuration", None) or 0.0) / 2 * M_TO_MM,
        plane="axis",
        wavelength_nm=(float(wavelength_nm),),
    )


@dataclass
class _Reader:
    """Collects surfaces and structures; knows the direction of light and the open group of refracting surfaces."""

    batoid: Any
    optic: Any
    wavelength_nm: float
    reflectance: float | None
    baffle_radius: float | None
    surfaces: list[Surface] = field(default_factory=list)
    structures: list[Structure | Surface] = field(default_factory=list)
    detector: Detector | None = None
    direction: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    group: list[Surface] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @cached_property
    def light(self) -> DesignLight:
        """The light of the design, for the baffles."""
        return DesignLight(self.batoid, self.optic, self.wavelength_nm)

    def add(self, element: tuple[str, Any]) -> None:
        """Convert one interface."""
        part, interface = element
        kind = type(interface).__name__
        name = _id(interface.name)
        if kind == "Baffle":
            self.structures += self._baffle(name, interface)
        elif kind == "Mirror":
            self.close_group()
            shape = self._shape(interface) | self._placing(interface)
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
        """Put walls between the refracting surfaces collected so far."""
        group, self.group = self.group, []
        if len(group) < 2:
            return
        for surface in group:
            if not surface.coaxial:
                raise MistrayError(
                    f"batoid element '{surface.name}': its lens group is off the z axis or tilted; only coaxial "
                    "groups can be closed"
                )
        if self.direction[2] < 0:
            group.reverse()
        taken = sum(piece.part == "barrel" for piece in self.structures)
        self.structures += barrel(group, first_space=taken + 1)

    def _shape(self, interface: Any) -> dict[str, Any]:
        """Figure and clear aperture of an optical surface, mm."""
        surface = interface.surface
        kind = type(surface).__name__
        shape: dict[str, Any] = {}
        if kind in ("Sphere", "Paraboloid", "Quadric", "Asphere"):
            shape["radius"] = float(surface.R) * M_TO_MM
            shape["conic"] = -1.0 if kind == "Paraboloid" else float(getattr(surface, "conic", 0.0))
        elif kind != "Plane":
            raise MistrayError(
                f"batoid element '{interface.name}': surface {kind} has no counterpart; use Plane, Sphere, "
                "Paraboloid, Quadric or Asphere"
            )
        if kind == "Asphere":
            coefficients = dict(enumerate((float(a) for a in surface.coefs), start=surface.imin))
            if coefficients.pop(1, 0.0):
                raise MistrayError(
                    f"batoid element '{interface.name}': its r² coefficient has no counterpart; fold it into R"
                )
            orders = range(2, max(coefficients, default=1) + 1)
            shape["coefficients"] = tuple(coefficients.get(i, 0.0) * M_TO_MM ** (1 - 2 * i) for i in orders)
        return shape | self._aperture(interface)

    def _aperture(self, interface: Any) -> dict[str, float]:
        o = self.batoid.obscuration
        obscuration = interface.obscuration
        original = obscuration.original if isinstance(obscuration, o.ObscNegation) else None
        if isinstance(original, o.ObscCircle) and original.x == original.y == 0:
            return {"semi_diameter": original.radius * M_TO_MM}
        if isinstance(original, o.ObscAnnulus) and original.x == original.y == 0:
            return {"semi_diameter": original.outer * M_TO_MM, "inner_semi_diameter": original.inner * M_TO_MM}
        raise MistrayError(
            f"batoid element '{interface.name}': obscuration {_kind(obscuration)} has no counterpart; use a centred "
            "ClearCircle or ClearAnnulus"
        )

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

    def _baffle(self, name: str, interface: Any) -> list[Structure]:
        """Opaque rings of a baffle, less those that stand there already: batoid lists one per passage of light."""
        if type(interface.surface).__name__ != "Plane":
            raise MistrayError(f"batoid element '{interface.name}': only plane baffles have a counterpart; remove it")
        whole = self._rings(interface, interface.obscuration)
        rings = without(whole, self.light.crossings(interface))
        placing = self._placing(interface)
        if rings != whole:
            left = " and ".join(f"{inner * M_TO_MM:.6g} … {outer * M_TO_MM:.6g} mm" for inner, outer in rings)
            self._note(
                f"baffle '{interface.name}': light that reaches the detector crosses it out of turn; "
                + (f"what is left of its plate is {left}" if rings else "it is left out")
            )
        result: list[Structure] = []
        for number, (inner, outer) in enumerate(rings, start=1):
            ring_name = name if len(rings) == 1 else f"{name}_{number}"
            ring = Structure(ring_name, outer * M_TO_MM, 0.0, inner * M_TO_MM, 0.0, part=name, **placing)
            if not any(
                _same_place(ring, other) for other in (*self.structures, *result) if isinstance(other, Structure)
            ):
                result.append(ring)
        return result

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _rings(self, interface: Any, obscuration: Any) -> list[tuple[float, float]]:
        """(inner, outer) radii in metres of what is opaque."""
        o = self.batoid.obscuration
        if isinstance(obscuration, o.ObscUnion):
            return [ring for item in obscuration.items for ring in self._rings(interface, item)]
        clear = isinstance(obscuration, o.ObscNegation)
        circle = obscuration.original if clear else obscuration
        if not isinstance(circle, o.ObscCircle | o.ObscAnnulus) or circle.x or circle.y:
            raise MistrayError(
                f"batoid element '{interface.name}': obscuration {_kind(obscuration)} has no counterpart; use "
                "centred circles and annuli"
            )
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


def _kind(obscuration: Any) -> str:
    """Class names of an obscuration, short enough for a message."""
    original = getattr(obscuration, "original", None)
    return type(obscuration).__name__ + (f" of {_kind(original)}" if original is not None else "")


def _id(name: str) -> str:
    return str(name).replace(".", "_")


def _same_place(a: Structure, b: Structure) -> bool:
    return all(getattr(a, key) == getattr(b, key) for key in ("r0", "z0", "r1", "z1", "x", "y", "z", "tilt_deg"))

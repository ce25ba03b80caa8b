"""Reader of camera lenses in JSON: surfaces, lens bodies, stop, barrel by optical spaces, coatings, source.

The file holds sequential surfaces (``surfaces``), the bodies with their rims (``lens_bodies``), the stop
(``aperture_stop``), the inside of the barrel piece by piece (``barrel.optical_spaces``), ``detector``, ``coatings``,
``sources.stray_light`` and ``variants``; ``scenes/phone_camera/prescription.json`` is the example.

Rules that give each face exactly one place:

- A flat ring of a lens body is a bevel between glass and air up to the visible radius. Beyond it the ring is a flange
  in contact with the barrel. A barrel ring in the same plane (a seat) replaces the part of the ring that it covers.
- Faces in contact, edges included, are opaque with the reflectance of the structure.
- The stop comes from ``aperture_stop``; pieces of the barrel that repeat it (labels with "AS") are left out.
- The board behind the detector becomes a frame of four rectangles around it.
- Points of the barrel with rounded coordinates are moved onto the rims that they meet (within 2 nm).
- A coating is R and T, or a recipe of `Coating`: ``layers``, ``preset`` or ``table`` with its options.
- Scatter is a list (``scatter``). An entry holds the plugin (``kind``), its properties, a ``name`` if the surfaces
  share the model, and the ``shapes``: names of faces or patterns such as ``barrel_*``.
- A material may have a ``k``. If it has none, the lens is assumed to be lossless, and the scene states ``k=0``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError, foreign_errors
from mistray.physics.geometry.sag import trimmed
from mistray.prescription.coating import Coating
from mistray.prescription.geometry import Point, detector_frame, lens_edge
from mistray.prescription.imported_beam import Fill, beam_size, check_beam
from mistray.prescription.model import Detector, Prescription, Stop, Structure, Surface
from mistray.prescription.scatter import Scatter
from mistray.prescription.sources import Source
from mistray.read_file import read_text

_ROUNDING_MM = 2e-6
_SURFACE_NAME = re.compile(r"S\d+\s+(\S+)\s+(front|rear)")
_PART_NAMES = {"IR": "filter", "IR filter": "filter", "Window": "window"}
_PIECE_LABEL = re.compile(r"Space \d+: (\w+)[^(]*(?:\((.*)\))?")
_COEFFICIENT = re.compile(r"A(\d{1,2})")
_CHANGED = ("z", "radius", "conic", "semi_diameter", "edge_z")  # what a variant may change of a surface
_MOST_DIGITS = 300  # of a whole number: no float is longer
_PIXELS = (512, 512)


def from_json(path: str | Path, *, variant: str | None = None, beam: Fill = "pupil") -> Prescription:
    """
    Read a camera lens from a JSON file.

    Parameters
    ----------
    path : str or Path
        JSON file.
    variant : str or None
        Name in the file's ``variants`` block whose changes are applied, for example ``"R13=5.272"``. ``None``: no
        changes.
    beam : {"pupil", "exact"}
        Whether the source is wider than that of the file by a twentieth of its radius, or exactly as wide; see
        docs/import.md.

    Returns
    -------
    Prescription
        Lens with detector and source.

    Raises
    ------
    MistrayError
        If the file is missing or broken, a key is missing, a name has another form, or the variant is unknown.

    Examples
    --------
    >>> file = mistray.scene.find("phone_camera").with_name("prescription.json")
    >>> camera = mistray.prescription.from_json(file)
    >>> len(camera.surfaces), camera.detector.pixels
    (14, (512, 512))
    """
    path = Path(path)
    text = read_text(path, "prescription")
    with foreign_errors(f"prescription '{path}'", "it must be a JSON file"):
        data = json.loads(text, parse_int=lambda digits: _whole(digits, path))
    with foreign_errors(f"prescription '{path}'", "compare with scenes/phone_camera"):
        try:
            return _Reader(data, path, variant, beam).prescription()
        except KeyError as error:
            raise MistrayError(
                f"prescription '{path}': key {error} is missing; compare with scenes/phone_camera"
            ) from None


class _Reader:
    def __init__(self, data: Mapping[str, Any], path: Path, variant: str | None, beam: Fill) -> None:
        check_beam(beam)
        self.data, self.beam = data, beam
        self.path = path
        self.coatings = {
            "window": _coating(data["coatings"]["window, IR filter"]),
            "filter": _coating(data["coatings"]["window, IR filter"]),
            "lens": _coating(data["coatings"]["lenses"]),
        }
        self.structure_coating = Coating(R=float(data["coatings"]["structure"]["R"]))
        self.changes = self._changes(variant)
        self.surfaces = self._surfaces()
        self.stop = self._stop()

    def prescription(self) -> Prescription:
        pieces = self._barrel()
        bodies = self._bodies(pieces)
        detector = self._detector()
        board = [key for key, piece in pieces.items() if piece.r0 == 0 or piece.r1 == 0]
        frame: tuple[Surface, ...] = ()
        for key in board:
            piece = pieces.pop(key)
            frame += detector_frame(
                detector, max(piece.r0, piece.r1), coating=self.structure_coating, name="board", space=piece.space
            )
        source, notes = self._source()
        result = Prescription(
            name=str(self.data["title"]),
            surfaces=self.surfaces,
            structures=(*bodies, *pieces.values(), *frame),
            stop=self.stop,
            detector=detector,
            source=source,
            provenance="\n".join([f"Generated from {self.path.name}; see SOURCE.md.", *notes, *detector.notes()]),
        )
        for row in self.data.get("scatter", []):
            model = _scatter(row)
            result = result.with_scatter({pattern: (model,) for pattern in row["shapes"]})
        return result

    def _changes(self, variant: str | None) -> dict[str, dict[str, float]]:
        """
        Return the changed values of a variant by surface label and quantity, such as S13, radius → 5.272 mm.

        Without a variant there are none. Raise `MistrayError` if the file does not have the variant, or a change has
        another form.
        """
        if variant is None:
            return {}
        known = self.data.get("variants", {})
        if variant not in known:
            raise MistrayError(
                f"prescription '{self.path}': variant '{variant}' is unknown; it has {', '.join(known) or 'none'}"
            )
        changes: dict[str, dict[str, float]] = {}
        for key, value in known[variant]["change"].items():
            label, _, quantity = key.partition(".")
            if quantity not in _CHANGED:
                raise MistrayError(
                    f"prescription '{self.path}': variant '{variant}' changes '{key}'; name surface and quantity, as "
                    f"in S13.radius; quantities are {', '.join(_CHANGED)}"
                )
            changes.setdefault(label, {})[quantity] = float(value)
        return changes

    def _surfaces(self) -> tuple[Surface, ...]:
        """
        Return the optical surfaces of the camera, one wherever the medium changes.

        Store in `moves` pairs of rims (r, z), as printed and exact, mm. Raise `MistrayError` if a name does not follow
        the scheme of the file, or the variant changes a surface that is not there.
        """
        self.moves: list[tuple[Point, Point]] = []
        materials = {key: _material(key, value) for key, value in self.data["materials"].items()}
        result = []
        changes = dict(self.changes)
        before = "AIR"
        for row in self.data["surfaces"]:
            after = row["medium_after"]
            if after == before:
                continue
            match = _SURFACE_NAME.match(row["name"])
            if match is None:
                raise MistrayError(
                    f"prescription '{self.path}': surface '{row['name']}' is not named 'S<number> <part> front' or "
                    "'… rear'; rename it"
                )
            part, face = _PART_NAMES.get(match[1], match[1]), match[2]
            row = {**row, **changes.pop(row["name"].split()[0], {})}
            surface = Surface(
                f"{part}_{face}",
                z=float(row["z"]),
                radius=float(row["radius"] or 0.0),
                conic=float(row.get("conic") or 0.0),
                coefficients=self._coefficients(row),
                semi_diameter=float(row["semi_diameter"]),
                front=materials[before],
                back=materials[after],
                coating=self.coatings.get(part, self.coatings["lens"]),
                part=part,
            )
            self.moves.append(((surface.outer_radius, float(row.get("edge_z", row["z"]))), surface.rim))
            result.append(surface)
            before = after
        if changes:
            raise MistrayError(
                f"prescription '{self.path}': the variant changes '{next(iter(changes))}', which is no surface between "
                "two media of this file; name one that is, as in S13.radius"
            )
        return tuple(result)

    def _coefficients(self, row: Mapping[str, Any]) -> tuple[float, ...]:
        """
        Return the coefficients (a4, a6, …) of a surface, mm⁻³, mm⁻⁵, …; those that the file leaves out are 0.

        Raise `MistrayError` for another name than A4, A6, …
        """
        found: dict[int, float] = {}
        for key, value in row.get("coefficients", {}).items():
            match = _COEFFICIENT.fullmatch(key)
            if match is None or int(match[1]) % 2 or int(match[1]) < 4:
                raise MistrayError(
                    f"prescription '{self.path}': surface '{row['name']}' has a coefficient '{key}'; they are A4, A6, …"
                )
            found[int(match[1])] = float(value)
        return trimmed(found.get(order, 0.0) for order in range(4, max(found, default=0) + 1, 2))

    def _stop(self) -> Stop:
        stop = self.data["aperture_stop"]
        rear, spaces = None, self.data["barrel"]["optical_spaces"]
        for space, pieces in spaces.items():
            for piece in pieces:
                if "(AS rear)" in piece["label"]:
                    rear = int(space), max(piece["r1"], piece["r2"])
        if rear is None:
            raise MistrayError(
                f"prescription '{self.path}': no barrel piece is labelled '(AS rear)'; add it, it ends the stop"
            )
        return Stop(
            radius=float(stop["radius"]),
            z_front=float(stop["z_front"]),
            z_rear=float(stop["z_rear"]),
            outer_front=float(stop["outer_radius_front_face"]),
            outer_rear=float(rear[1]),
            coating=self.structure_coating,
            space=rear[0],
        )

    def _barrel(self) -> dict[str, Structure]:
        """
        Return the pieces of the barrel by name, fitted to the lens rims, without the faces of the stop.

        Further pieces of one name in a space are numbered from 2 on. Raise `MistrayError` if a label does not follow
        the scheme of the file.
        """
        pieces: dict[str, Structure] = {}
        for space, rows in self.data["barrel"]["optical_spaces"].items():
            for row in rows:
                match = _PIECE_LABEL.match(row["label"])
                if "AS" in row["label"]:
                    continue
                if match is None:
                    raise MistrayError(
                        f"prescription '{self.path}': barrel piece '{row['label']}' is not named 'Space <number>: "
                        "…'; rename it"
                    )
                name = f"barrel_{space}_{(match[2] or match[1]).replace(' ', '_')}"
                name = next(key for k in count(1) if (key := name if k == 1 else f"{name}_{k}") not in pieces)
                ends = (*self._on_rim(row["r1"], row["z1"]), *self._on_rim(row["r2"], row["z2"]))
                pieces[name] = Structure(name, *ends, coating=self.structure_coating, part="barrel", space=int(space))
        return pieces

    def _on_rim(self, r: float, z: float) -> Point:
        """
        Return a barrel point (r, z), mm, moved to the exact lens rim if the file gives that rim rounded.

        If only its z is that of a rim, only z is moved.
        """
        for (printed_r, printed_z), (rim_r, rim_z) in self.moves:
            if abs(z - printed_z) <= _ROUNDING_MM:
                return (rim_r if abs(r - printed_r) <= _ROUNDING_MM else float(r)), rim_z
        return float(r), float(z)

    def _bodies(self, pieces: dict[str, Structure]) -> list[Structure]:
        """
        Return the edges, flanges and bevels of the lens bodies as structures.

        Barrel pieces in contact with a lens get glass on one side.
        """
        result: list[Structure] = []
        by_name = {surface.name: surface for surface in self.surfaces}
        for row in self.data["lens_bodies"]:
            part = _PART_NAMES.get(row["name"], row["name"])
            first, second = by_name[f"{part}_front"], by_name[f"{part}_rear"]
            contact: list[float | None] = []
            seats = []
            for number, surface in ((1, first), (2, second)):
                clear, z = surface.rim
                visible = row.get(f"visible_bevel_{number}")
                touch = float(visible[1]) if visible else None
                for key, piece in pieces.items():
                    if piece.z0 == piece.z1 == z and min(piece.r0, piece.r1) == clear:
                        touch = min(max(piece.r0, piece.r1), float(row["rim_radius"]))
                        glass = first.back
                        pieces[key] = replace(piece, back=glass) if number == 1 else replace(piece, front=glass)
                        seats.append(f"{part}_bevel_{number}")
                contact.append(touch)
            faces = lens_edge(
                first,
                second,
                float(row["rim_radius"]),
                part=part,
                coating=self.structure_coating,
                bevel_coating=first.coating,
                contact_radii=(contact[0], contact[1]),
            )
            result += [face for face in faces if face.name not in seats]
        return result

    def _detector(self) -> Detector:
        row = self.data["detector"]
        half = float(row["half_width"])
        coating = Coating(R=float(self.data["coatings"]["detector"]["R"]))
        return Detector(half_width=half, half_height=half, z=float(row["z"]), coating=coating, pixels=_PIXELS)

    def _source(self) -> tuple[Source, list[str]]:
        row = self.data["sources"]["stray_light"]
        stop_plane = [surface["z"] for surface in self.data["surfaces"] if surface.get("stop")]
        z = float(stop_plane[0]) if stop_plane else self.stop.z_rear
        size, notes = beam_size(self.beam, float(row["radius"]), of="that of the file")
        return Source(**size, z=z, wavelength_nm=(round(1e3 * float(row["wavelength_um"]), 6),)), notes


def _whole(digits: str, path: Path) -> int:
    """Return a whole number of the JSON file; more than `_MOST_DIGITS` digits raise `MistrayError`."""
    if len(digits) > _MOST_DIGITS:
        raise MistrayError(
            f"prescription '{path}': number {digits[:12]}… has {len(digits)} digits; give one of {_MOST_DIGITS} at most"
        )
    return int(digits)


def _coating(row: Mapping[str, Any]) -> Coating:
    """Return a coating given by R and T, or by layers, a preset or a table with options; see `Coating`."""
    recipe = [key for key in ("layers", "preset", "table", "first", "design_nm", "name") if key in row]
    if recipe:
        return Coating(**{key: row[key] for key in recipe})
    return Coating(R=float(row["R"]), T=float(row["T"]))


def _scatter(row: Mapping[str, Any]) -> Scatter:
    properties = {key: value for key, value in row.items() if key not in ("kind", "name", "shapes")}
    return Scatter(row["kind"], properties, name=row.get("name"))


def _material(key: str, row: Mapping[str, Any]) -> str:
    if key == "AIR":
        return "air"
    if row.get("Vd"):
        return f"nd={row['nd']} Vd={row['Vd']} k={row.get('k', 0)}"
    return str(row["nd"]) + (f" k={row['k']}" if "k" in row else "")

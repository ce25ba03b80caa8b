"""Reader of FlareSim lens files (.lens), https://github.com/petermercell/flaresim_nuke.

A file has a line `name:`, a line `focal_length:`, and after `surfaces:` one line for each surface. Its columns are the
radius (0 is a plane, `stop` the aperture stop), the thickness, index nd and Abbe number behind the surface, the size of
the clear aperture, and the number of coating layers. The column of sizes is called `semi_ap`, but files converted from
the Optical Bench of photonstophotos.net, nearly all of them, hold full diameters. For other files the stated F-number
decides.

A file states no fields, and its image plane is rounded or belongs to another object distance. So the reader finds both
with real rays, and notes this.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.materials.mate import shown
from mistray.named_values import finite_of
from mistray.prescription.sequential.first_order import first_order, paraxial_system
from mistray.prescription.sequential.rays import Array, passes, trace
from mistray.prescription.sequential.table import Row, Sequential, Unread
from mistray.read_file import read_text

LINE_NM = 587.5618
"""Wavelength of the index nd, at which the lens is traced."""
COATINGS = ("", "mgf2_quarter_wave", "v_coat", "bbar3", "bbar4")
"""Names of coating presets, indexed by the number of coating layers in the file."""
FOCAL_TOLERANCE = 0.02
"""Relative difference from the focal length in the file above which a note is made."""

_COLUMNS = ("radius", "thickness", "index", "Abbe number", "aperture", "coating")
_F_NUMBER = (re.compile(r"\bf/(\d+(?:\.\d+)?)", re.IGNORECASE), re.compile(r"\bf ?(\d+(?:\.\d+)?)", re.IGNORECASE))
_BENCH = "photonstophotos"  # a file of the Optical Bench holds full diameters
_GLASS = 1.0005  # index from which on a medium is no air
_SMALL = 0.02  # relative: sizes of patents are no more exact
_LARGER = 0.15  # relative, at most: by which clear apertures may be too small for the light on the axis
_INSIDE = 0.005  # of the focal length: an image so far inside of the last surface lies on it
_AXIS_RAYS = 64  # of the pupil on the axis
_WIDEST_DEG, _STEP_DEG = 80.0, 4.0  # of the fields that are looked at, first in these steps
_FAN = 101  # rays of a fan through the first surface
_KEPT = 0.5  # of the width of the fan on the axis: at the edge of the field as much is left
_INNER = 0.7  # of the edge of the field: the field between


@dataclass(frozen=True)
class _Line:
    """
    Surface in a FlareSim file, lengths in mm.

    Attributes
    ----------
    number, line : int
        Position in the table, from 1, and line number in the file.
    radius, thickness : float
        Radius of curvature, ``inf`` for a plane, and distance to the next surface.
    index, abbe : float
        Index and Abbe number behind the surface.
    size : float
        Diameter or semi-diameter; the format leaves open which.
    layers : int
        Index in `COATINGS`, by number of coating layers.
    stop : bool
        Whether it is marked as the stop.
    """

    number: int
    line: int
    radius: float
    thickness: float
    index: float
    abbe: float
    size: float
    layers: int
    stop: bool


@dataclass
class _File:
    """
    Content of a FlareSim lens file.

    Attributes
    ----------
    what : str
        Name of the file, for error messages.
    name : str
        Name of the lens, or of the file if it states none.
    focal_mm : float
        Stated focal length, mm; 0 if there is none or it is infinite.
    remarks : list of str
        Comments in front of the surfaces.
    lines : list of _Line
        Surfaces from front to rear.
    unread : list of Unread
        Lines that have no effect.
    """

    what: str
    name: str
    focal_mm: float
    remarks: list[str]
    lines: list[_Line]
    unread: list[Unread]

    @property
    def f_number(self) -> float | None:
        """F-number stated in a remark or in the name, for a zoom the first one; None if there is none."""
        for pattern in _F_NUMBER:
            for text in (*reversed(self.remarks), self.name):
                if match := pattern.search(text):
                    return float(match[1]) or None
        return None

    @property
    def patent(self) -> str:
        """Patent number; empty if there is none."""
        found = [text.partition(":")[2].strip() for text in self.remarks if text.lower().startswith("patent:")]
        return found[0] if found else ""


def read_flaresim(path: str | Path) -> Sequential:
    r"""
    Read a lens file of FlareSim.

    Parameters
    ----------
    path : str or Path
        The .lens file.

    Returns
    -------
    Sequential
        Lens in mm, at 587.56 nm. Its `notes` say how the apertures were read, where the stop is if none is marked, how
        far the image plane was moved to the focus, and how large the field is assumed to be.

    Raises
    ------
    MistrayError
        If the file holds no surfaces or cannot be read, or if the lens has no real focus. This concerns converters,
        close-up lenses, and mirror lenses written without their mirrors.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = "50 5 1.5168 64.17 10 1; -50 1 1 0 10 0; stop 46 1 0 4.5 0"
    >>> _ = Path("singlet.lens").write_text("name: Singlet\nfocal_length: 49.2\nsurfaces:\n" + rows.replace("; ", "\n"))
    >>> lens = mistray.prescription.read_flaresim("singlet.lens")
    >>> [row.stop for row in lens.rows]
    [False, False, True, False]
    """
    path = Path(path)
    file = _read(path)
    notes: list[str] = []
    lens = _with_stop(file, _table(file, notes), notes)
    lens = _with_sizes(file, lens, notes)
    lens = _opened(_narrowed(file, lens, notes), notes)
    data = first_order(lens)
    _check_focus(file, data.efl, data.bfl)
    off = data.efl / file.focal_mm - 1 if file.focal_mm > 0 else 0.0
    if abs(off) > FOCAL_TOLERANCE:
        notes.append(f"focal length {data.efl:.5g} mm, the file says {file.focal_mm:g} mm ({100 * off:+.3g} %)")
    lens = _focused(file, lens, notes)
    lens = _with_field(lens, notes)
    return replace(lens, notes=tuple(notes))


def _read(path: Path) -> _File:
    what = f"FlareSim file '{path.name}'"
    file = _File(what, path.stem, 0.0, [], [], [])
    inside = False
    for number, text in enumerate(read_text(path, "lens").split("\n"), 1):
        content, _, remark = text.partition("#")
        if remark.strip() and not inside:
            file.remarks.append(remark.strip())
        words = content.split()
        if not words:
            continue
        key, colon, value = (part.strip() for part in content.partition(":"))
        if inside:
            file.lines.append(_surface(f"{what}, line {number}", number, len(file.lines) + 1, words))
        elif key == "surfaces" and colon:
            inside = True
        elif key == "name" and colon:
            file.name = shown(value.split()) or path.stem
        elif key == "focal_length" and colon:
            if value.lower() != "inf":
                (file.focal_mm,) = _numbers(f"{what}, line {number}", [value], ("focal length",))
        else:
            file.unread.append(Unread(number, text, "not a line of a FlareSim file"))
    if not file.lines:
        raise MistrayError(f"{what}: it holds no surfaces; give a file with lines behind 'surfaces:'")
    return file


def _surface(where: str, line: int, number: int, words: Sequence[str]) -> _Line:
    stop = words[0].lower() == "stop"
    radius = "0" if stop or words[0].lower() == "inf" else words[0]
    if len(words) < len(_COLUMNS):
        raise MistrayError(f"{where}: {len(words)} columns; give {', '.join(_COLUMNS)}")
    if len(words) > len(_COLUMNS) and words[6].lower() not in ("sph", "spherical"):
        raise MistrayError(f"{where}: surface of type '{shown([words[6]])}'; only spheres are read")
    values = _numbers(where, [radius, *words[1:6]], _COLUMNS)
    if values[2] < 1:
        raise MistrayError(f"{where}: index {values[2]:g}; it must be 1 or more")
    layers = min(max(round(values[5]), 0), len(COATINGS) - 1)
    bent, thickness, index, abbe, size, _ = values
    return _Line(number, line, bent or math.inf, thickness, index, abbe, size, layers, stop)


def _numbers(where: str, words: Sequence[str], names: Sequence[str]) -> list[float]:
    result = []
    for word, name in zip(words, names, strict=True):
        value = finite_of(word)
        if value is None:
            raise MistrayError(f"{where}: {name} is '{shown([word])}'; give a number")
        result.append(value)
    return result


def _cemented(file: _File, notes: list[str]) -> list[_Line]:
    """Return the surfaces, with facing surfaces of equal shape and no air between merged into one cemented surface."""
    lines: list[_Line] = []
    pairs = []
    for item in file.lines:
        stop = bool(lines) and lines[-1].stop and lines[-1].thickness == 0  # it may lie in the cement
        before = lines[-2 if stop else -1 :]
        empty = bool(before) and before[0].thickness == 0 and before[0].index <= _GLASS and not before[0].stop
        if empty and not item.stop and before[0].radius == item.radius:
            pairs.append(f"{before[0].number} and {item.number}")
            sizes = [line.size for line in (*before, item) if line.size > 0]
            lines[-len(before) :] = [
                replace(item, number=before[0].number, size=min(sizes, default=0.0), stop=stop),
            ]
        else:
            lines.append(item)
    if pairs:
        notes.append(f"equal faces without a space between them are taken for one, in cement: {', '.join(pairs)}")
    return lines


def _table(file: _File, notes: list[str]) -> Sequential:
    """
    Return the lens table with the file's aperture column read as semi-diameters, mm; a later step verifies that.

    Raise `MistrayError` if a thickness in glass or behind a curved surface is negative, or glass extends from the last
    surface to the image.
    """
    rows: list[Row] = []
    before, bare, coated = "air", 0, 0
    lines = _cemented(file, notes)
    for k, item in enumerate(lines):
        glass = item.index > _GLASS
        # A dummy plane may stand before a bulge; light that went back through glass or from a curved face did so behind
        # a mirror, of which the file says nothing
        if item.thickness < 0 and (glass or not math.isinf(item.radius)):
            raise MistrayError(
                f"{file.what}, line {item.line}: thickness {item.thickness:g} mm; light does not go back in a lens: a "
                "mirror lens without its mirrors cannot be read"
            )
        material = "air"
        if glass:
            material = f"nd={item.index!r} Vd={item.abbe!r} k=0" if item.abbe > 0 else f"{item.index!r} k=0"
        in_air = (before == "air") != (material == "air")
        coated += in_air and item.layers > 0
        bare += in_air and item.layers == 0
        rows.append(
            Row(
                item.number,
                radius=item.radius,
                thickness=item.thickness,
                material=material,
                stop=item.stop and not any(row.stop for row in rows),
                semi_diameter=item.size if item.size > 0 else None,
                coating=COATINGS[item.layers] if in_air else "",
                line=item.line,
            )
        )
        before = material
        if k and item.stop and any(row.stop for row in rows[:-1]):
            notes.append(f"line {item.line}: a second stop has no effect")
    while len(rows) > 1 and not rows[-1].stop and rows[-1].material == rows[-2].material == "air":
        # A plane before the image, or in it, bends nothing
        rows[-2:] = [replace(rows[-2], thickness=rows[-2].thickness + rows[-1].thickness)]
    if before != "air":
        raise MistrayError(
            f"{file.what}, line {file.lines[-1].line}: the last surface has glass behind it up to the image; the file "
            "is not whole"
        )
    without = [str(item.number) for item in lines if item.index > _GLASS and item.abbe <= 0]
    if without:
        notes.append(f"no Abbe number behind surfaces {', '.join(without)}: their indices are the same for all colours")
    if coated:
        rest = f", {bare} are bare: the file coats faces with glass behind them alone" if bare else ""
        notes.append(f"{coated} faces between glass and air are coated as their numbers of layers say{rest}")
    if any("asph" in text.lower() for text in (file.name, *file.remarks)):
        notes.append("the lens has aspheres, of which the file gives the spheres alone: its image is worse than it was")
    patent = f", patent {file.patent}" if file.patent else ""
    return Sequential(
        file.name,
        (*rows, Row(file.lines[-1].number + 1, kind="image")),
        source=f"{file.what}{patent}",
        aperture_kind="stop_diameter",
        aperture=1.0,
        wavelengths_nm=(LINE_NM,),
        unread=tuple(file.unread),
    )


def _with_stop(file: _File, lens: Sequential, notes: list[str]) -> Sequential:
    """
    Return the lens with a stop, chosen if the file marks none; its diameter is the aperture, mm.

    Raise `MistrayError` if there is nothing to choose a stop from, or the stop has no aperture.
    """
    place = next((k for k, row in enumerate(lens.rows) if row.stop), None)
    if place is None:
        heights = np.abs(paraxial_system(lens)[0].trace(1.0, 0.0)[:-1, 0])
        sizes = np.array([row.semi_diameter or math.inf for row in lens.rows[:-1]])
        place = int(np.argmax(heights / sizes))
        if not math.isfinite(sizes[place]) or heights[place] <= 0:
            raise MistrayError(f"{file.what}: it marks no stop and gives no apertures; write 'stop' for a radius")
        rows = [replace(row, stop=k == place) for k, row in enumerate(lens.rows)]
        lens = lens.with_rows(rows)
        notes.append(
            f"the file marks no stop: surface {lens.rows[place].number} is it, whose clear aperture limits the light "
            "on the axis"
        )
    size = lens.rows[place].semi_diameter
    if not size:
        raise MistrayError(f"{file.what}, line {lens.rows[place].line}: the stop has no aperture; give its diameter")
    return replace(lens, aperture=2 * size)


def _with_sizes(file: _File, lens: Sequential, notes: list[str]) -> Sequential:
    """
    Return the lens with semi-diameters, mm, after deciding whether the file holds full or semi-diameters.

    A dummy plane in air stops no light. A note says what was decided, and why.
    """
    as_semi, stated = first_order(lens).f_number, file.f_number
    if any(_BENCH in text for text in file.remarks):
        full, why = True, "as of all files of the Optical Bench"
    elif stated is not None and math.isfinite(as_semi):
        full, why = (
            abs(math.log(2 * as_semi / stated)) < abs(math.log(as_semi / stated)),
            "this fits the F-number better",
        )
    else:
        full = any(row.semi_diameter and row.semi_diameter > abs(row.radius) for row in lens.rows)
        why = "half of a sphere is not larger" if full else "no F-number tells it"
    if stated is not None:
        why += f"; F/{(2 if full else 1) * as_semi:.3g}, the file says F/{stated:g}"
    notes.append(f"apertures are read as {'full ' if full else 'semi-'}diameters, {why}")
    factor = 0.5 if full else 1.0
    rows = [
        replace(
            row,
            semi_diameter=row.semi_diameter and row.semi_diameter * factor,
            # What a dummy plane in air states shades nothing
            semi_diameter_fixed=bool(row.semi_diameter) and {before, row.material} != {"air"},
        )
        for before, row in zip(["air", *(row.material for row in lens.rows)], lens.rows, strict=False)
    ]
    return replace(lens.with_rows(rows), aperture=lens.aperture * factor)


def _narrowed(file: _File, lens: Sequential, notes: list[str]) -> Sequential:
    """Return the lens with the stop reduced to the beam that passes, unless a stated F-number fits worse then."""
    heights = np.abs(paraxial_system(lens)[0].trace(1.0, 0.0)[:-1, 0])
    place = next(k for k, row in enumerate(lens.rows) if row.stop)
    free = [row.semi_diameter / y for row, y in zip(lens.rows, heights, strict=False) if row.semi_diameter and y > 0]
    diameter = 2 * min(free) * heights[place]
    if not 0 < diameter < (1 - _SMALL) * lens.aperture:
        return lens
    before, after = (first_order(replace(lens, aperture=size)).f_number for size in (lens.aperture, diameter))
    stated = file.f_number
    if stated is not None and abs(math.log(after / stated)) >= abs(math.log(before / stated)):
        return lens
    notes.append(
        f"the stop of {lens.aperture:.5g} mm is wider than the clear apertures let light through, and is made "
        f"{diameter:.5g} mm wide: F/{after:.3g} instead of F/{before:.3g}"
    )
    rows = [replace(row, semi_diameter=diameter / 2) if row.stop else row for row in lens.rows]
    return replace(lens.with_rows(rows), aperture=diameter)


def _opened(lens: Sequential, notes: list[str]) -> Sequential:
    """Return the lens with clear apertures widened, by 15 % at most, for axial light that passes the stop."""
    data = first_order(lens)
    start = np.zeros((_AXIS_RAYS, 3))
    start[:, 1], start[:, 2] = np.linspace(0.0, 0.5 * (1 + _LARGER) * data.epd, _AXIS_RAYS), data.entrance_pupil_z
    hits, _ = trace(lens, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    place = next(k for k, row in enumerate(lens.rows) if row.stop)
    inside = np.abs(hits[place, :, 1]) <= lens.aperture / 2
    rows, grown = list(lens.rows), {}
    for k, row in enumerate(lens.rows[:-1]):
        reach = float(np.max(np.abs(hits[k, :, 1]), where=inside & np.isfinite(hits[k, :, 1]), initial=0.0))
        if row.semi_diameter and row.semi_diameter < reach <= (1 + _LARGER) * row.semi_diameter and not row.stop:
            rows[k] = replace(row, semi_diameter=reach)
            grown[row.number] = reach / row.semi_diameter - 1
    if max(grown.values(), default=0.0) > _SMALL:
        notes.append(
            f"clear apertures are made larger, by up to {100 * max(grown.values()):.2g} %, for the light on the axis "
            f"that passes the stop: surfaces {', '.join(map(str, grown))}"
        )
    return lens.with_rows(rows)


def _check_focus(file: _File, efl: float, bfl: float) -> None:
    if math.isinf(efl):
        raise MistrayError(f"{file.what}: it is afocal and has no image; only lenses with a real focus are read")
    if efl < 0 or bfl < -_INSIDE * efl:
        what = f"focal length {efl:.5g} mm, back focus {bfl:.5g} mm"
        raise MistrayError(
            f"{file.what}: it has no real focus ({what}); a converter, or a mirror lens without its mirrors, cannot be "
            "read alone"
        )


def _focused(file: _File, lens: Sequential, notes: list[str]) -> Sequential:
    """
    Return the lens with its image at the least axial rms spot, or else at the paraxial focus.

    The latter is taken if they differ much, or if the spot lies before the last surface. If the chosen focus lies just
    before that surface, the image lies on the surface. Raise `MistrayError` if no axial ray reaches the image, or the
    focus lies farther inside.
    """
    data = first_order(lens)
    height = 0.5 * data.epd * np.sqrt((np.arange(_AXIS_RAYS) + 0.5) / _AXIS_RAYS)  # equal shares of the light
    start = np.column_stack([np.zeros(_AXIS_RAYS), height, np.full(_AXIS_RAYS, data.entrance_pupil_z)])
    hits, along = _clipped(lens, start, np.broadcast_to([0.0, 0.0, 1.0], start.shape))
    y, slope = hits[-1, :, 1], along[-1, :, 1] / along[-1, :, 2]
    some = np.isfinite(y)
    if not np.any(some):
        raise MistrayError(f"{file.what}: no ray on the axis reaches the image; look for wrong radii and apertures")
    best = -float(np.sum(y[some] * slope[some]) / np.sum(slope[some] ** 2))
    *rows, last, image = lens.rows
    paraxial = data.bfl - last.thickness
    aberrated = abs(best - paraxial) > FOCAL_TOLERANCE * data.efl or last.thickness + best < 0
    shift = paraxial if aberrated else best
    if 0 > last.thickness + shift >= -_INSIDE * data.efl:
        shift = -last.thickness  # the image lies on a cover glass
    if last.thickness + shift < 0:
        raise MistrayError(
            f"{file.what}: its focus lies {-last.thickness - shift:.5g} mm before the last surface, inside the lens; "
            "only lenses with a real focus are read"
        )
    spot = float(np.sqrt(np.mean((y + shift * slope)[some] ** 2)))
    where = "to the paraxial focus, as the spheres alone do not focus" if aberrated else "to the focus of"
    notes.append(
        f"the image plane is moved by {shift:+.4g} mm ({100 * shift / data.efl:+.3g} % of the focal length) {where} "
        f"the light on the axis, whose spot has {1e3 * spot:.3g} µm rms there"
    )
    return lens.with_rows([*rows, replace(last, thickness=last.thickness + shift), image])


def _with_field(lens: Sequential, notes: list[str]) -> Sequential:
    """
    Return the lens with fields, degrees, up to the angle where half of a fan of rays passes, and a fitting image.

    The rays that pass on the axis are the whole. If less than half of them passes even at 0.5°, the axis is the only
    field.
    """
    widest = max(row.semi_diameter or 0.0 for row in lens.rows)
    fan = np.linspace(-widest, widest, _FAN)

    def images(angles_deg: Array) -> Array:
        """Trace a fan of rays at each angle, degrees; return image heights, mm, (angles, rays), NaN for lost rays."""
        start, heading = np.zeros((2, len(angles_deg), _FAN, 3))
        start[..., 1] = fan
        heading[..., 1], heading[..., 2] = np.tan(np.radians(angles_deg))[:, None], 1.0
        hits, _ = _clipped(lens, start.reshape(-1, 3), heading.reshape(-1, 3))
        return hits[-1, :, 1].reshape(-1, _FAN)

    def last(angles_deg: Array, whole: float) -> float:
        """Return the largest angle, degrees, up to which at least half as many rays pass as on the axis, `whole`."""
        through = np.sum(np.isfinite(images(angles_deg)), axis=1)
        dark = np.flatnonzero(through < _KEPT * whole)
        return float(angles_deg[dark[0] - 1 if len(dark) else -1])

    whole = float(np.sum(np.isfinite(images(np.zeros(1)))))
    coarse = last(np.arange(0.0, _WIDEST_DEG + 1, _STEP_DEG), whole)
    angle = last(coarse + np.linspace(0.0, _STEP_DEG, 2 * int(_STEP_DEG) + 1)[:-1], whole)
    if angle <= 0:
        notes.append("the file states no field: the lens is traced on the axis alone")
        return lens
    size = float(np.abs(np.nanmean(images(np.array([angle])))))
    notes.append(
        f"the file states no field: it is taken up to {angle:g}°, where the apertures let half of a fan of rays "
        f"through. The detector is as large as that image: {size:.4g} mm from the axis"
    )
    *rows, image = lens.rows
    fields = ((0.0, 0.0), (0.0, round(_INNER * angle, 2)), (0.0, angle))
    return replace(lens, rows=(*rows, replace(image, semi_diameter=size)), fields=fields)


def _clipped(lens: Sequential, start: Array, heading: Array) -> tuple[Array, Array]:
    """
    Return positions, mm, and directions of rays, (n_rows, n, 3) each, as `trace` does.

    Positions at the image are NaN for rays that an aperture or the stop blocks.
    """
    hits, along = trace(lens, start, heading)
    for row, place in zip(lens.rows, hits, strict=True):
        through = passes(row, place)
        if row.stop:
            through &= np.hypot(place[:, 0], place[:, 1]) <= lens.aperture / 2
        hits[-1, ~through] = np.nan
    return hits, along

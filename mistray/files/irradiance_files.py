"""Irradiance maps with standard errors in the formats FITS, OpenEXR and NumPy.

All three hold the irradiance (W/mm²) or the illuminance (lx), its standard error, the extent of the map in mm, and
facts about its origin.

.fits
    Primary HDU: irradiance, 64-bit floats, BUNIT "W mm-2" or "lx"; image extension STDERR: standard error. Both carry a
    linear WCS in mm: the outer edge of the first pixel, FITS coordinate 0.5, lies at CRVAL, a pixel is CDELT wide. Row
    0 is at the smallest y, which FITS viewers draw at the bottom. A card has room for 15 digits, to which the extent is
    rounded. FACTS holds the facts as JSON. Source: FITS standard 4.0, sections 4.3 (units), 4.4.2.5 (EXTNAME) and
    8.2 (WCS).
.exr
    Channels "Y" (irradiance, which viewers show as grey) and "standard_error.Y", 32-bit floats, the widest that OpenEXR
    has: values are rounded to seven digits. Row 0 of the file is at the largest y, because EXR is drawn from the top.
    Attributes: unit, extent_mm ("x0 x1 y0 y1"), facts (JSON). Source: openexr.com, "Technical Introduction".
.npy
    One record with the fields irradiance_W_mm2 and irradiance_se_W_mm2, (height, width) float64, extent_mm (4,), and
    facts (JSON): ``np.load("map.npy")["irradiance_W_mm2"]``; of an illuminance illuminance_lx and illuminance_se_lx.
"""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError, errors_of, foreign_errors
from mistray.files.arrays import check_arrays
from mistray.files.json_values import plain
from mistray.files.packages import format_package
from mistray.ranges import ANYTHING, FILM_PIXELS, ByName
from mistray.read_file import read_file, require_file
from mistray.replace_file import replace_file

Map = npt.NDArray[np.float64]
Extent = tuple[float, float, float, float]
WATTS, LUX = "W/mm²", "lx"
ERROR_HDU, ERROR_CHANNEL = "STDERR", "standard_error.Y"
AXES = ("x", "y")
WHAT = "irradiance map"  # for messages
MOST_BYTES = 4 << 30  # of a map in memory: the two images of the largest film, and as much again
LARGEST = float(np.finfo(np.float32).max)


class _Words(NamedTuple):
    """Names for a unit: its quantity, the unit in FITS and in EXR, and NPY field names of value and error."""

    quantity: str
    fits: str
    exr: str
    npy: tuple[str, str]


UNITS = {
    WATTS: _Words("irradiance", "W mm-2", "W/mm^2", ("irradiance_W_mm2", "irradiance_se_W_mm2")),
    LUX: _Words("illuminance", "lx", "lx", ("illuminance_lx", "illuminance_se_lx")),
}
FACTS = ByName(ANYTHING, "{'scene': 'plate'}")


@dataclass(frozen=True)
class IrradianceMap:
    """
    Irradiance or illuminance on a detector, with its standard error.

    Attributes
    ----------
    irradiance, irradiance_se : (height, width) float64
        Irradiance and its standard error, in `unit`, row 0 at the smallest y.
    extent : tuple of float
        Edges x0, x1, y0, y1 in the detector's frame, mm.
    facts : mapping of str to JSON-serialisable values
        Origin of the map and settings of the trace.
    unit : {"W/mm²", "lx"}
        Unit; the map is an illuminance if it is lx.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> image = mistray.report.IrradianceMap(t.irradiance, t.irradiance_se, t.extent)
    >>> image.unit, image.irradiance.shape
    ('W/mm²', (380, 380))
    """

    irradiance: Map
    irradiance_se: Map
    extent: Extent
    facts: Mapping[str, Any] = field(default_factory=dict)
    unit: str = WATTS

    def __post_init__(self) -> None:
        shapes = np.shape(self.irradiance), np.shape(self.irradiance_se)
        if len(shapes[0]) != 2 or shapes[0] != shapes[1] or 0 in shapes[0]:
            raise MistrayError(f"irradiance map: shapes {shapes[0]} and {shapes[1]}; give two arrays (height, width)")
        FACTS.check("facts", self.facts, "irradiance map")
        if self.unit not in UNITS:
            raise MistrayError(f"irradiance map: unit is '{self.unit}'; use {' or '.join(UNITS)}")

    @classmethod
    def of(cls, trace: Any, unit: str = WATTS) -> IrradianceMap:
        """Return the map of a trace, a `mistray.Trace`, in W/mm² or lx, with the settings of the trace as facts."""
        value, se = (trace.irradiance, trace.irradiance_se) if unit == WATTS else trace.illuminance
        return cls(value, se, tuple(trace.extent), plain(dict(trace.settings)), unit)


def write_irradiance(irradiance_map: IrradianceMap, path: str | Path) -> Path:
    """
    Write a map as .fits, .exr or .npy, depending on the ending of the path; the module describes the formats.

    Parameters
    ----------
    irradiance_map : IrradianceMap
        Map to write.
    path : str or Path
        File to write; an existing file is replaced atomically.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    MistrayError
        If the path has another ending, the package for the format is not installed, the file cannot be written, or a
        value is too large for EXR.

    Examples
    --------
    >>> edges = -1.5, 1.5, -1, 1
    >>> image = mistray.report.IrradianceMap(np.ones((2, 3)), np.zeros((2, 3)), edges, {"made by": "hand"})
    >>> mistray.report.write_irradiance(image, "even.npy").name
    'even.npy'
    """
    writer, _ = _format(Path(path))
    return replace_file(path, writer(irradiance_map), "irradiance map")


def read_irradiance(path: str | Path) -> IrradianceMap:
    """
    Return the map in a file that `write_irradiance` has written.

    Returns
    -------
    IrradianceMap
        Map equal to the written one, except that facts are JSON values, EXR rounds to 32-bit floats, and FITS rounds
        the extent to 15 digits.

    Raises
    ------
    MistrayError
        If the path has another ending, the package for the format is not installed, or the file does not hold such a
        map.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> t.write_irradiance("image.npy")
    >>> image = mistray.report.read_irradiance("image.npy")
    >>> [round(float(edge), 1) for edge in image.extent]
    [-19.0, 19.0, -19.0, 19.0]
    """
    path = Path(path)
    _, reader = _format(path)
    with foreign_errors(f"irradiance map '{path}'", "give a file that mistray wrote"):
        return reader(path)


def _format(path: Path) -> tuple[Callable[[IrradianceMap], bytes], Callable[[Path], IrradianceMap]]:
    try:
        return FORMATS[path.suffix.lower().removeprefix(".")]
    except KeyError:
        endings = ", ".join(f".{name}" for name in FORMATS)
        raise MistrayError(f"irradiance map '{path}': its name must end in {endings}") from None


def _unit(path: Path, name: Any) -> str:
    """Return the unit of a map from its name in a FITS or EXR file; raise `MistrayError` for an unknown name."""
    found = next((unit for unit, words in UNITS.items() if name in (words.fits, words.exr)), None)
    if found is None:
        raise MistrayError(f"irradiance map '{path}': its unit is '{name}'; give a file that mistray wrote")
    return found


def _facts_text(m: IrradianceMap) -> str:
    """Return the facts about a map's origin as JSON in ASCII, the only encoding that FITS headers accept."""
    return json.dumps(plain(dict(m.facts)), allow_nan=False)


def _write_fits(m: IrradianceMap) -> bytes:
    fits = format_package("fits")
    hdus = [fits.PrimaryHDU(np.asarray(m.irradiance, dtype=np.float64))]
    hdus.append(fits.ImageHDU(np.asarray(m.irradiance_se, dtype=np.float64), name=ERROR_HDU))
    words = UNITS[m.unit]
    for hdu, meaning in zip(hdus, (words.quantity, f"standard error of the {words.quantity}"), strict=True):
        header = hdu.header
        header["BUNIT"] = (words.fits, meaning)
        for axis, low, high, name in zip((1, 2), m.extent[::2], m.extent[1::2], AXES, strict=True):
            pixels = m.irradiance.shape[2 - axis]
            header[f"CTYPE{axis}"] = (name.upper(), f"{name} in the frame of the detector")
            header[f"CUNIT{axis}"] = "mm"
            header[f"CRPIX{axis}"] = (0.5, "outer edge of the first pixel")
            header[f"CRVAL{axis}"] = (float(low), "[mm]")
            header[f"CDELT{axis}"] = ((high - low) / pixels, "[mm] per pixel")
            header[f"{name.upper()}END"] = (float(high), "[mm] outer edge of the last pixel")
        header["FACTS"] = _facts_text(m)
    stream = io.BytesIO()
    fits.HDUList(hdus).writeto(stream, checksum=True)
    return stream.getvalue()


def _read_fits(path: Path) -> IrradianceMap:
    fits = format_package("fits")
    with fits.open(io.BytesIO(read_file(path, WHAT)), memmap=False) as hdus:
        if ERROR_HDU not in hdus:
            raise MistrayError(f"irradiance map '{path}': no extension {ERROR_HDU}; give a file that mistray wrote")
        header = hdus[0].header
        extent = tuple(float(header[key]) for key in ("CRVAL1", "XEND", "CRVAL2", "YEND"))
        value, se = (np.asarray(hdu.data, dtype=np.float64) for hdu in (hdus[0], hdus[ERROR_HDU]))
        unit = _unit(path, header["BUNIT"])
        return IrradianceMap(value, se, (extent[0], extent[1], extent[2], extent[3]), json.loads(header["FACTS"]), unit)


def _write_exr(m: IrradianceMap) -> bytes:
    openexr = format_package("exr")
    channels = {}
    for name, values in (("Y", m.irradiance), (ERROR_CHANNEL, m.irradiance_se)):
        most = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
        if most > LARGEST:
            raise MistrayError(f"irradiance map: {most:g} {m.unit} is too large for EXR; write .fits or .npy")
        channels[name] = np.ascontiguousarray(np.asarray(values, dtype=np.float64)[::-1].astype(np.float32))
    header = {
        "compression": openexr.ZIP_COMPRESSION,
        "type": openexr.scanlineimage,
        "unit": UNITS[m.unit].exr,
        "extent_mm": " ".join(repr(float(value)) for value in m.extent),
        "facts": _facts_text(m),
    }
    with tempfile.TemporaryDirectory() as folder:  # OpenEXR writes to names only
        draft = Path(folder) / "map.exr"
        with openexr.File(header, channels) as file:
            file.write(str(draft))
        return draft.read_bytes()


def _read_exr(path: Path) -> IrradianceMap:
    openexr = format_package("exr")
    require_file(path, WHAT)  # OpenEXR reads from names only
    with openexr.File(str(path), header_only=True) as file:  # pixels take memory before they are read
        (x0, y0), (x1, y1) = file.header()["dataWindow"]
        pixels = (int(x1) - int(x0) + 1) * (int(y1) - int(y0) + 1)
    if pixels > FILM_PIXELS.high:
        raise MistrayError(f"irradiance map '{path}': its {pixels} pixels are more than {FILM_PIXELS.high:g}; bin it")
    with openexr.File(str(path), separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        missing = [name for name in ("Y", ERROR_CHANNEL) if name not in channels] + [
            name for name in ("extent_mm", "facts", "unit") if name not in header
        ]
        if missing:
            raise MistrayError(f"irradiance map '{path}': no {missing[0]}; give a file that mistray wrote")
        value, se = (np.array(channels[name].pixels[::-1], dtype=np.float64) for name in ("Y", ERROR_CHANNEL))
        left, right, low, high = (float(word) for word in header["extent_mm"].split())
        unit = _unit(path, header["unit"])
        return IrradianceMap(value, se, (left, right, low, high), json.loads(header["facts"]), unit)


def _write_npy(m: IrradianceMap) -> bytes:
    facts, shape = _facts_text(m), m.irradiance.shape
    record = np.zeros(
        (),
        dtype=[
            *((name, "<f8", shape) for name in UNITS[m.unit].npy),
            ("extent_mm", "<f8", (4,)),
            ("facts", f"<U{len(facts)}"),
        ],
    )
    for name, values in zip(UNITS[m.unit].npy, (m.irradiance, m.irradiance_se), strict=True):
        record[name] = values
    record["extent_mm"], record["facts"] = m.extent, facts
    stream = io.BytesIO()
    np.save(stream, record, allow_pickle=False)
    return stream.getvalue()


def _read_npy(path: Path) -> IrradianceMap:
    with errors_of(f"irradiance map '{path}'"):
        stream = check_arrays(read_file(path, WHAT), MOST_BYTES)
    record = np.load(stream, allow_pickle=False)
    unit = next((unit for unit, words in UNITS.items() if {*words.npy} <= {*(record.dtype.names or ())}), None)
    if unit is None:
        raise MistrayError(f"irradiance map '{path}': no field irradiance_se_W_mm2; give a file that mistray wrote")
    x0, x1, y0, y1 = (float(value) for value in record["extent_mm"])
    value, se = (np.array(record[name], dtype=np.float64) for name in UNITS[unit].npy)
    return IrradianceMap(value, se, (x0, x1, y0, y1), json.loads(str(record["facts"])), unit)


FORMATS: Mapping[str, tuple[Callable[[IrradianceMap], bytes], Callable[[Path], IrradianceMap]]] = MappingProxyType(
    {"fits": (_write_fits, _read_fits), "exr": (_write_exr, _read_exr), "npy": (_write_npy, _read_npy)}
)
"""Writer and reader of each format, keyed by the ending of the file's name."""

"""Reader of STEP files (ISO 10303-21) by OpenCASCADE through cascadio, in a separate process with a time limit."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from mistray.errors import MistrayError
from mistray.io.cad.glb import Glb, Instance
from mistray.io.cad.part import CadPart, checked, unique_names
from mistray.materials.mate import shown
from mistray.prescription.sequential.table import Unread
from mistray.read_file import read_file

PROGRAM = Path(__file__).with_name("step_process.py")
START, END = b"ISO-10303-21;", b"END-ISO-10303-21;"
SECONDS, SECONDS_PER_MB = 5.0, 30.0
PATIENCE = 4.0  # times its processor time may pass on a busy machine, or where a system has no limit of that
ANGLE_RAD = 0.1
"""Largest angle between neighbouring facets of a curved face: a full circle has at least 63."""
OUT_OF_TIME = (-24, 152)  # SIGXCPU, as Python and as shells give it
# Names that programs give to instances nobody has named
NAMELESS = re.compile(r"(NAUO|=>\[)?[\d:\]]*|NONE", re.IGNORECASE)
CRASHED = "OpenCASCADE gives up on it; it is damaged or too large, export the part again"
STATUS = {
    3: "cascadio is not installed; run: pip install 'mistray[cad]'",
    4: "OpenCASCADE finds no shape in it; export the part again as STEP AP203, AP214 or AP242 with solids",
}


def read_step(
    path: Path, *, tolerance_mm: float, time_limit_s: float | None = None
) -> tuple[list[CadPart], list[Unread]]:
    """
    Read the parts of a STEP file in mm, whatever its unit, each instance of an assembly at its place.

    Parameters
    ----------
    path : Path
        STEP file.
    tolerance_mm : float
        Largest distance between a facet and its face, mm.
    time_limit_s : float, optional
        Limit of processor time, s; the limit of wall-clock time is four times as long. The default is 5 s plus 30 s for
        each MB.

    Returns
    -------
    parts : list of CadPart
        Parts with vertices in mm.
    unread : list of Unread
        Content of the file that is not in the parts.

    Raises
    ------
    MistrayError
        If the file is not a STEP file, is cut off, holds no faces or takes too long, or if cascadio is missing.
    """
    data = read_file(path, "STEP file")
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(START):
        raise MistrayError(f"STEP file '{path}': it does not begin with 'ISO-10303-21;'; give a STEP file in text form")
    if END not in data[-4096:]:
        raise MistrayError(
            f"STEP file '{path}': it is cut off, 'END-ISO-10303-21;' is missing; export or copy it again"
        )
    if time_limit_s is None:
        time_limit_s = SECONDS + SECONDS_PER_MB * len(data) / 1e6
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "part.glb"
        _convert(path, target, tolerance_mm, time_limit_s)
        try:
            parts, faces, unread = _parts(Glb(target))
        except (ValueError, KeyError, IndexError, TypeError, struct.error) as error:
            if isinstance(error, MistrayError):
                raise
            reason = shown(str(error).split())
            raise MistrayError(
                f"STEP file '{path}': what OpenCASCADE makes of it cannot be read ({reason}); export the part again"
            ) from None
    if not parts and unread:
        raise MistrayError(f"STEP file '{path}': {unread[0].reason}")
    if not parts:
        raise MistrayError(f"STEP file '{path}': it holds no faces; export the part with solids or surfaces")
    missing = _missing(data)
    if missing:
        shown_ones = ", ".join(f"#{number}" for number in missing[:5]) + (", …" if len(missing) > 5 else "")
        what = f"{len(missing)} entities that others refer to ({shown_ones})"
        unread.append(Unread(0, what, "they are missing in the file; what depends on them is in no part"))
    written = len(re.findall(rb"=\s*(?:ADVANCED_FACE|FACE_SURFACE)\s*\(", data))
    if faces < written:
        lost = f"{written - faces} of {written} faces of the file"
        unread.append(Unread(0, lost, "OpenCASCADE cannot read them; they are in no part"))
    tessellated = len(re.findall(rb"=\s*(?:COMPLEX_)?TRIANGULATED_FACE\s*\(", data))
    if tessellated:
        unread.append(Unread(0, f"{tessellated} tessellated faces", "only faces with exact surfaces are read"))
    return parts, unread


def _missing(data: bytes) -> list[int]:
    """Return the numbers of entities that a STEP file refers to but does not define."""
    data = re.sub(rb"'[^']*'", b"''", data)  # a name may hold anything; two quotes within one are two strings here
    defined = set(re.findall(rb"#(\d{1,18})\s*=", data))
    return sorted(int(number) for number in set(re.findall(rb"#(\d{1,18})", data)) - defined)


def _convert(path: Path, target: Path, tolerance_mm: float, time_limit_s: float) -> None:
    command = [sys.executable, str(PROGRAM)]
    command += [str(path.resolve()), str(target), repr(tolerance_mm), repr(ANGLE_RAD), repr(time_limit_s)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE * time_limit_s, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode in OUT_OF_TIME:
        raise MistrayError(
            f"STEP file '{path}': not read within {time_limit_s:.3g} s; simplify it, or give a larger time_limit_s"
        )
    if done.returncode or not target.is_file():
        raise MistrayError(f"STEP file '{path}': {STATUS.get(done.returncode, CRASHED)}")


def _parts(file: Glb) -> tuple[list[CadPart], int, list[Unread]]:
    """
    Return the parts, the number of CAD faces that they come from, and the content that could not be read.

    Faces of a product that stands in several places count once.
    """
    found: list[tuple[Instance, CadPart, str, str]] = []
    unread: list[Unread] = []
    faces: dict[tuple[str, int], int] = {}  # a product that stands in several places is in the file once
    for instance in file.instances():
        product = file.mesh_name(instance.mesh)
        title = instance.names[-1]
        if len(instance.names) == 1 or NAMELESS.fullmatch(title):
            title = product or title
        part, count = file.mesh(instance.mesh)
        try:
            part, _ = checked(replace(part, title=title))
        except MistrayError as error:
            unread.append(Unread(0, f"part '{shown([title])}'", str(error)))
            continue
        empty = sorted(set(range(count)) - set(part.faces.tolist()))
        if empty:
            numbers = ", ".join(map(str, empty[:10])) + (", …" if len(empty) > 10 else "")
            what = f"part '{shown([title])}', {len(empty)} faces ({numbers})"
            unread.append(Unread(0, what, "OpenCASCADE finds no area in them; they are left out"))
        faces[product, hash(part.vertices.tobytes())] = count
        found.append((instance, part, title, product))
    parts = []
    for name, (instance, part, title, product) in zip(unique_names(f[2] for f in found), found, strict=True):
        named = replace(part, name=name, title=title, product=product, path="/".join(instance.names))
        parts.append(named.moved(instance.matrix))
    return parts, sum(faces.values()), unread

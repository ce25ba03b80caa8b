"""Lenses that are written as .zmx files, and rays of optiland through those files.

    python tests/exported_lenses.py

writes tests/data/zemax_export_rays.csv: rays that start at the given points and directions before the first surface of
the exported file, as optiland 0.6.3 traces it, and where they meet the image; in the frame of the first surface, mm.
optiland's Newton iteration for aspheres is told to go on to 1e-14 mm.
"""

import csv
import importlib
import tempfile
from pathlib import Path

import numpy as np
import peers

from mistray.prescription import Decentre, Row, Sequential, to_sequential, write_zemax

CSV = Path(__file__).parent / "data" / "zemax_export_rays.csv"
COLUMNS = ("lens", "wavelength_nm", "x0", "y0", "z0", "l0", "m0", "n0", "x", "y", "z")
D_LINE_NM = 587.5618
SCENES = ("cooke_triplet", "double_gauss", "phone_camera", "newtonian", "singlet_window_detector", "cassegrain")
START_Z = -30.0


def exported(name: str) -> Sequential:
    """A shipped scene, or a lens that is tilted in all ways."""
    if name == "tilted":
        return tilted()
    prescription = importlib.import_module(f"mistray.scenes.{name}.prescription").build()
    if name == "phone_camera":  # off the d line programs disagree on what nd and Vd mean
        prescription = prescription.with_source(wavelength_nm=(D_LINE_NM,))
    return to_sequential(prescription)


def tilted() -> Sequential:
    """Decentres of one surface and of all that follow, in both orders, tilts about three axes, a fold mirror."""
    alone = Decentre(x=0.3, y=-0.2, z=0.15, tilt_deg=(2.0, -3.0, 4.0), returns=True)
    tilt_first = Decentre(x=-0.4, y=0.1, z=-0.25, tilt_deg=(-1.0, 2.5, 7.0), tilt_first=True)
    both_ways = Decentre(x=0.5, tilt_deg=(3.0, 0.0, 2.0), tilt_first=True, returns=True)
    rows = (
        Row(1, radius=40.0, conic=-0.4, coefficients=(1e-6,), thickness=4.0, material="N-BK7", decentre=alone),
        Row(2, radius=-60.0, thickness=20.0, decentre=tilt_first),
        Row(3, kind="coordinate_break", thickness=1.0, decentre=Decentre(tilt_deg=(30.0, 5.0, -8.0), tilt_first=True)),
        Row(4, radius=-300.0, mirror=True, decentre=both_ways),
        Row(5, kind="coordinate_break", thickness=-15.0, decentre=Decentre(tilt_deg=(30.0, 5.0, 0.0))),
        Row(6, kind="image", decentre=Decentre(y=0.5, tilt_deg=(1.0, 2.0, 3.0))),
    )
    return Sequential("tilted", rows, aperture=8.0, wavelengths_nm=(D_LINE_NM,))


LENSES = (*SCENES, "tilted")


def rays(lens: Sequential) -> tuple[np.ndarray, np.ndarray]:
    """Points and directions of six rays inside of the beam, two of them skew."""
    half = lens.aperture / 2
    aim = np.array([(0.0, 0.7), (0.0, -0.8), (0.6, 0.45), (-0.7, 0.3), (0.45, -0.6), (-0.5, -0.55)]) * half
    theta = np.radians([0.0, 0.0, 0.0, 0.4, 0.4, -0.4])
    directions = np.stack([0.3 * np.sin(theta), np.sin(theta), np.ones_like(theta)], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.column_stack([aim, np.zeros(len(aim))]) + directions * (START_Z / directions[:, 2:]), directions


def optiland_image_points(path: Path, points: np.ndarray, directions: np.ndarray, wavelength_nm: float) -> np.ndarray:
    """Where optiland's rays through a .zmx file meet the image, (n, 3) in the frame of the first surface, mm."""
    real_rays = peers.optiland("rays").RealRays
    optic = peers.optiland("fileio").load_zemax_file(str(path))
    for surface in optic.surfaces:
        if hasattr(surface.geometry, "tol"):
            surface.geometry.tol = 1e-14
    count = len(points)
    start = real_rays(*points.T.copy(), *directions.T.copy(), np.ones(count), np.full(count, wavelength_nm / 1e3))
    optic.surfaces.trace(start)
    found = optic.surfaces
    return np.stack([np.asarray(getattr(found, axis))[-1] for axis in "xyz"], axis=1)


def main() -> None:
    with CSV.open("w", newline="") as file, tempfile.TemporaryDirectory() as folder:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for name in LENSES:
            lens = exported(name)
            path = Path(folder) / f"{name}.zmx"
            write_zemax(lens, path)
            points, directions = rays(lens)
            ends = optiland_image_points(path, points, directions, lens.wavelength_nm)
            for row in np.hstack([points, directions, ends]):
                table.writerow([name, lens.wavelength_nm, *(repr(float(value)) for value in row)])


if __name__ == "__main__":
    main()

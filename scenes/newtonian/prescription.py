"""Newtonian telescope: tube with vanes, primary, diagonal, eyepiece tube, image."""

from __future__ import annotations

import math

from mistray.prescription import Coating, Detector, Prescription, Source, Structure, Surface, wall

INCH = 25.4
TUBE_RADIUS = 4.0 * INCH
OPENING_Z = -50.0 * INCH
EYEPIECE_Z = -45.0 * INCH
EYEPIECE_RADIUS = 0.5 * INCH
EYEPIECE_START, IMAGE_DISTANCE = 3.0 * INCH, 5.0 * INCH
FOCAL_LENGTH = 50.0 * INCH
PRIMARY_RADIUS = 3.75 * INCH
DIAGONAL_HALF_WIDTH = 0.6 * INCH
VANE_RADIUS = 3.8 * INCH
VANES_Z = tuple(z * INCH for z in (-42.0, -36.0, -28.0, -18.0, -8.0))
FOCUSER_RADIUS, FOCUSER_HALF_LENGTH = 5.15 * INCH, 0.6 * INCH

MIRROR = Coating(R=0.92)
BLACK = Coating(R=0.1)
TOWARDS_IMAGE = (90.0, 0.0, 0.0)
"""Tilt of frames whose z axis points from the diagonal to the image, along -y."""


def build() -> Prescription:
    """Main tube with vanes and a focuser housing, paraboloid, flat diagonal, eyepiece tube that ends at the image."""
    primary = Surface(
        "primary", radius=-2 * FOCAL_LENGTH, conic=-1.0, semi_diameter=PRIMARY_RADIUS, coating=MIRROR, mirror=True
    )
    flat = {"half_width": DIAGONAL_HALF_WIDTH, "half_height": DIAGONAL_HALF_WIDTH * math.sqrt(2)}
    diagonal = Surface("diagonal", z=EYEPIECE_Z, tilt_deg=(45.0, 0.0, 0.0), coating=MIRROR, mirror=True, **flat)
    # 3 mm behind the mirror, on its sky side
    offset = 3.0 / math.sqrt(2)
    holder = Surface(
        "diagonal_back",
        y=offset,
        z=EYEPIECE_Z - offset,
        tilt_deg=(45.0, 0.0, 0.0),
        coating=BLACK,
        part="diagonal",
        **flat,
    )
    return Prescription(
        name="Newtonian telescope, f = 1270 mm, f/6.7",
        surfaces=(primary, diagonal),
        structures=(*_tube(primary), holder, _eyepiece_tube()),
        detector=Detector(
            "image",
            y=-IMAGE_DISTANCE,
            z=EYEPIECE_Z,
            tilt_deg=TOWARDS_IMAGE,
            semi_diameter=EYEPIECE_RADIUS,
            pixels=(254, 254),
        ),
        source=Source(radius=TUBE_RADIUS, z=OPENING_Z, plane="axis", wavelength_nm=(546.1,)),
        provenance="After the Newtonian model of a TracePro webinar; partly invented, see SOURCE.md.",
    )


def _tube(primary: Surface) -> tuple[Structure, ...]:
    """Inside of the main tube from the opening to the mirror cell, and the vanes."""
    rim_radius, rim_z = primary.rim
    low, high = EYEPIECE_Z - FOCUSER_HALF_LENGTH, EYEPIECE_Z + FOCUSER_HALF_LENGTH
    front = wall("tube_front", [(TUBE_RADIUS, OPENING_Z), (TUBE_RADIUS, low)], coating=BLACK, part="tube")
    focuser = wall(
        "focuser",
        [(TUBE_RADIUS, low), (FOCUSER_RADIUS, low), (FOCUSER_RADIUS, high), (TUBE_RADIUS, high)],
        coating=BLACK,
        part="focuser",
    )
    rear = wall("tube_rear", [(TUBE_RADIUS, high), (TUBE_RADIUS, rim_z)], coating=BLACK, part="tube")
    cell = wall("mirror_cell", [(TUBE_RADIUS, rim_z), (rim_radius, rim_z)], coating=BLACK, part="mirror_cell")
    vanes = tuple(
        Structure(f"vane_{k}", TUBE_RADIUS, z, VANE_RADIUS, z, coating=BLACK) for k, z in enumerate(VANES_Z, start=1)
    )
    return (*front, *focuser, *rear, *cell, *vanes)


def _eyepiece_tube() -> Structure:
    return Structure(
        "eyepiece_tube",
        EYEPIECE_RADIUS,
        EYEPIECE_START,
        EYEPIECE_RADIUS,
        IMAGE_DISTANCE,
        z=EYEPIECE_Z,
        tilt_deg=TOWARDS_IMAGE,
        coating=BLACK,
    )

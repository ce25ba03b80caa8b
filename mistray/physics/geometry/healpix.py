"""HEALPix pixels of a sky: 12 N² parts of the sphere of equal area, indexed along rings or nested.

K. M. Górski et al., "HEALPix: a framework for high-resolution discretization and fast analysis of data distributed on
the sphere", Astrophys. J. 622, 759-771 (2005), sections 4 and 5.
"""

from __future__ import annotations

import numpy as np

FACES = 12
BELT = 2 / 3  # |cos θ| up to which pixels lie in the belt around the equator


def sides(pixels: int) -> int:
    """Return N, the divisions of a base pixel's side, of a HEALPix map with 12 N² pixels; 0 if no N fits."""
    side = round((pixels / FACES) ** 0.5)
    return side if side > 0 and FACES * side * side == pixels else 0


def pixel(side: int, directions: np.ndarray, nested: bool) -> np.ndarray:
    """
    Return the indices, from 0, of the HEALPix pixels in which directions lie.

    Parameters
    ----------
    side : int
        Number N of divisions of a base pixel's side; a power of 2 for nested indices.
    directions : (n, 3) float64
        Unit vectors; z points to the north, and the longitude is counted from x towards y.
    nested : bool
        Whether the four parts of a pixel have consecutive indices; otherwise indices count along rings.

    Returns
    -------
    (n,) int64
        Indices of the pixels.
    """
    z, turn = directions[:, 2], np.arctan2(directions[:, 1], directions[:, 0])
    quarters = np.mod(turn, 2 * np.pi) / (0.5 * np.pi) % 4.0
    belt = np.abs(z) <= BELT
    # Numbers of the lines that rise and fall across the pixels: in the belt, then in the quarters of the caps
    middle, tilt = side * (0.5 + quarters), side * z * 0.75
    rising, falling = np.floor(middle - tilt).astype(np.int64), np.floor(middle + tilt).astype(np.int64)
    within = quarters - np.floor(quarters)
    reach = side * np.sqrt(3 * (1 - np.minimum(np.abs(z), 1.0)))
    up = np.minimum(np.floor(within * reach), side - 1).astype(np.int64)
    down = np.minimum(np.floor((1 - within) * reach), side - 1).astype(np.int64)
    if nested:
        return _nested(side, z, belt, (rising, falling), (np.floor(quarters).astype(np.int64), up, down))
    ring = side + 1 + rising - falling
    place = (rising + falling - side + 1 - (ring & 1) + 1) // 2 % (4 * side)
    of_belt = 2 * side * (side - 1) + (ring - 1) * 4 * side + place
    ring = up + down + 1
    place = np.floor(quarters * ring).astype(np.int64) % (4 * ring)
    of_cap = np.where(z > 0, 2 * ring * (ring - 1) + place, FACES * side * side - 2 * ring * (ring + 1) + place)
    return np.where(belt, of_belt, of_cap)


def _nested(
    side: int,
    z: np.ndarray,
    belt: np.ndarray,
    lines: tuple[np.ndarray, np.ndarray],
    cap: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """
    Return indices of HEALPix pixels in the nested scheme, in the shape of `z`; names are those of `pixel`.

    `z` is the cosine of the angle to the north. In the `belt` indices follow from the rising and falling `lines`, in
    the caps from `cap`: the quarter of the cap and the counts of lines up and down in it.
    """
    (rising, falling), (quarter, up, down) = lines, cap
    first, second = rising // side, falling // side
    face = np.where(first == second, first % 4 + 4, np.where(first < second, first % 4, second % 4 + 8))
    x, y = falling % side, side - rising % side - 1
    north = z > 0
    face = np.where(belt, face, np.where(north, quarter, quarter + 8))
    x = np.where(belt, x, np.where(north, side - down - 1, up))
    y = np.where(belt, y, np.where(north, side - up - 1, down))
    number = np.zeros_like(x)
    for bit in range(max(side.bit_length() - 1, 0)):
        number |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return face * side * side + number
